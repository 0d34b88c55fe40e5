"""The class LoadingCurve: one grasp's loading curve, sample by sample, and the features by which tissues differ.

Force is the strain voltage over its lowest value in the grasp, as a share of the usual peak. Travel is the encoder's
without the cable's stretch, Eq. (3). Tissues differ in the force needed to bring the jaws within some travel of jaw
closure. The jaw closure angle is known from the previous grasp within a few degrees, and exactly once this grasp has
reached it.

Another tool's travel is scaled so that full closure is that of the Smart Tool. Without a motor command the ramp is that
of the travel.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from acquisition.signals.calibration import compute_sensor_signals_from_jaws
from config.schema import SmartToolKinematics, Tool
from estimator.loading.constants import (
    CLOSURE_SHARES,
    CLOSURE_STEP_DEG,
    FEATURES,
    FORCE_FLOOR_SHARE,
    FORCE_GAPS_DEG,
    GIVE_SHARES,
    KNEE_SHARE,
    LEAN_SHARES,
    LOADING_LIMIT_SAMPLES,
    LOADING_START_SHARE,
    MEAN_SAMPLES,
    OPENING_UNIT_DEG,
    RAMP_SHARE,
    RAMP_STEP_LOG,
    SHUT_TRAVEL_DEG,
    STALLED_SAMPLES,
    TRAVEL_UNIT_DEG,
    YIELD_SHARES,
)

OPENING, FORCES = 0, slice(1, 1 + len(FORCE_GAPS_DEG))
KNEE, LEAN, STALL, YIELD, GIVE = range(1 + len(FORCE_GAPS_DEG), len(FEATURES))


def find_travel_scale(tool: Tool) -> float:
    """Return the degrees of the Smart Tool's encoder per degree of the tool's position sensor, by full closure.

    It is 1 for the Smart Tool, and for a tool whose opening is not known.
    """
    if isinstance(tool.kinematics, SmartToolKinematics) or tool.opening_m is None:
        return 1.0
    _, to_shut_deg = compute_sensor_signals_from_jaws(tool, 0.0, tool.opening_m)
    return SHUT_TRAVEL_DEG / to_shut_deg


@dataclass(frozen=True, slots=True)
class ObservedFeatures:
    """Features of a loading curve so far.

    `features` (F,) are NaN until reached. `closure_sensitivity` (F,) is their change per degree of the jaw closure
    angle, and 0 once that is known. `ramp_log` is the natural logarithm of the command's rate in V/s.
    """

    features: np.ndarray
    closure_sensitivity: np.ndarray
    ramp_log: float


class LoadingCurve:
    """Loading curve of one grasp, from the moment the command leaves zero."""

    def __init__(
        self,
        stretch_deg_per_volt: float,
        peak_v: float,
        dt_s: float,
        previous_closure_deg: float | None = None,
        *,
        first: bool = False,
        travel_scale: float = 1.0,
        hand_driven: bool = False,
    ) -> None:
        """Start at a grasp's first sample.

        Args:
            stretch_deg_per_volt: encoder angle per volt from the cable's stretch, Eq. (3).
            peak_v: usual peak of the strain voltage over rest, V, to which the shares of force refer.
            dt_s: sampling interval.
            previous_closure_deg: corrected encoder angle of the previous jaw closure; None if not known.
            first: whether this is the source's first grasp, whose jaw opening is no feature of the tissue.
            travel_scale: degrees of the Smart Tool's encoder per degree of this one (`find_travel_scale`).
            hand_driven: whether there is no motor command, so that the ramp is that of the travel.
        """
        self._stretch_deg_per_volt, self._peak_v, self._previous_closure_deg, self._is_first_grasp = (
            stretch_deg_per_volt,
            peak_v,
            previous_closure_deg,
            first,
        )
        self._dt_s, self._travel_scale, self._is_hand_driven = dt_s, travel_scale, hand_driven
        self._last_v: deque[float] = deque(maxlen=MEAN_SAMPLES)
        self._last_deg: deque[float] = deque(maxlen=MEAN_SAMPLES)
        self._smoothed = np.empty((3, 1024))  # smoothed strain, V; smoothed corrected travel, deg; command, V
        self._count = 0
        self._rest_v = np.inf
        self._is_loading = False
        self._peak_index, self._peak_strain_v = 0, -np.inf
        self.ended = False  # the drive has stalled: later samples are not loading

    def append(self, samples: np.ndarray) -> None:
        """Append samples of dtype SAMPLE, except samples without a reading."""
        columns = (samples[name].tolist() for name in ("strain_v", "encoder_deg", "motor_command_v"))
        for values in zip(*columns, strict=True):
            if self.ended:
                return
            if all(map(math.isfinite, values[:2] if self._is_hand_driven else values)):
                self._append_sample(*values)

    def _append_sample(self, strain_v: float, encoder_deg: float, command_v: float) -> None:
        self._last_v.append(strain_v)
        self._last_deg.append(encoder_deg)
        volt = sum(self._last_v) / len(self._last_v)
        if self._count == self._smoothed.shape[1]:
            self._smoothed = np.concatenate([self._smoothed, np.empty_like(self._smoothed)], axis=1)
        at, self._count = self._count, self._count + 1
        travel_deg = sum(self._last_deg) / len(self._last_deg) - self._stretch_deg_per_volt * volt
        travel_deg *= self._travel_scale
        if self._is_hand_driven:
            command_v = travel_deg - self.start_deg if at else 0.0
        self._smoothed[:, at] = volt, travel_deg, command_v
        if not self._is_loading and volt < self._rest_v:
            self._rest_v = self._peak_strain_v = volt
            self._peak_index = at
        if volt > self._peak_strain_v:
            self._peak_strain_v, self._peak_index = volt, at
        rise_v = self._peak_strain_v - self._rest_v
        self._is_loading = self._is_loading or rise_v > LOADING_START_SHARE * self._peak_v
        stalled = rise_v > CLOSURE_SHARES[0] * self._peak_v and at - self._peak_index >= STALLED_SAMPLES
        self.ended = stalled or self._count >= LOADING_LIMIT_SAMPLES

    @property
    def peak_v(self) -> float:
        """Highest smoothed strain voltage so far minus the lowest, V."""
        return self._peak_strain_v - self._rest_v if self._count else 0.0

    @property
    def start_deg(self) -> float:
        """Corrected encoder angle of the grasp's first sample; NaN before it."""
        return float(self._smoothed[1, 0]) if self._count else math.nan

    @property
    def jaw_closure_deg(self) -> float | None:
        """Corrected encoder angle of this grasp's jaw closure; None if the jaws have not been shut."""
        low_v, high_v = (self._rest_v + share * self._peak_v for share in CLOSURE_SHARES)
        if not self._count or self._peak_strain_v < high_v:
            return None
        volt, travel, _ = self._smoothed[:, : self._peak_index + 1]
        first = int(np.argmax(volt >= high_v))
        between = travel[:first][volt[:first] >= low_v]
        return float(np.median(between)) if len(between) else None

    def observe_features(self) -> ObservedFeatures:
        """Return the features so far."""
        if not self._is_loading:
            return ObservedFeatures(np.full(len(FEATURES), np.nan), np.zeros(len(FEATURES)), self.ramp_log)
        shut_deg, of_shut = self.jaw_closure_deg, np.zeros(len(FEATURES))
        at_deg = self._previous_closure_deg if shut_deg is None else shut_deg
        features = self._compute_features(at_deg)
        if shut_deg is None:
            features[OPENING] = np.nan  # before closure it would describe the previous grasp's tissue
        if shut_deg is None and at_deg is not None:
            later, sooner = (self._compute_features(at_deg + sign * CLOSURE_STEP_DEG) for sign in (1.0, -1.0))
            of_shut = (later - sooner) / (2 * CLOSURE_STEP_DEG)
            features[np.isnan(of_shut)] = np.nan
            of_shut = np.nan_to_num(of_shut)
        return ObservedFeatures(features, of_shut, self.ramp_log)

    @property
    def ramp_log(self) -> float:
        """Natural logarithm of the ramp's rate up to RAMP_SHARE of its maximum; 0 before it moves."""
        command = self._smoothed[2, : self._count]
        most = float(command.max(initial=0.0))
        after = int(np.argmax(command >= RAMP_SHARE * most)) if most > 0.0 else 0
        if after == 0:
            return 0.0
        ramp_log = math.log(float(command[after]) / (after * self._dt_s))
        return RAMP_STEP_LOG * round(ramp_log / RAMP_STEP_LOG)

    def _compute_features(self, jaw_closure_deg: float | None) -> np.ndarray:
        """Return FEATURES for jaws that close at `jaw_closure_deg`; NaN for those not reached yet."""
        result = np.full(len(FEATURES), np.nan)
        volt, travel, _ = self._smoothed[:, : self._peak_index + 1]
        force = (volt - self._rest_v) / self._peak_v
        lean = [_find_first(force >= share) for share in LEAN_SHARES]
        if lean[1] is not None and lean[0] is not None:
            result[LEAN] = _scale_travel(travel[lean[1]] - travel[lean[0]])
        begin, end = (_find_first(force >= share) for share in YIELD_SHARES)
        if begin is not None and end is not None:
            result[YIELD] = math.log((end - begin + 1) * self._dt_s)
        begin, end = (_find_first(force >= share) for share in GIVE_SHARES)
        if begin is not None and end is not None:
            result[GIVE] = _scale_travel(travel[end] - travel[begin])
        if self.ended:
            result[STALL] = math.log(force[-1])
        if jaw_closure_deg is None:
            return result
        if not self._is_first_grasp:
            result[OPENING] = (jaw_closure_deg - self.start_deg) / OPENING_UNIT_DEG
        for i, gap_deg in enumerate(FORCE_GAPS_DEG):
            at = _find_first(travel >= jaw_closure_deg - gap_deg)
            if at is not None:
                result[FORCES][i] = math.log(max(float(force[at]), 0.0) + FORCE_FLOOR_SHARE)
        knee = _find_first(force >= KNEE_SHARE)
        if knee is not None:
            result[KNEE] = _scale_travel(jaw_closure_deg - travel[knee])
        return result


def _find_first(condition: np.ndarray) -> int | None:
    at = int(np.argmax(condition)) if len(condition) else 0
    return at if len(condition) and condition[at] else None


def _scale_travel(travel_deg: float) -> float:
    return math.asinh(travel_deg / TRAVEL_UNIT_DEG)
