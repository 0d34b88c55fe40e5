"""The class GraspTracker, which detects grasps, contact, jaw closure and encoder slip."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from acquisition.sample_block import SampleFlag
from config.schema import ContactDetection, HandDrivenGrasps

COMMAND_ON_V = 0.02  # above the spikes of one sample (17 mV) of a command line read back at rest
COMMAND_ZERO_V = 0.002  # noise of the read-back
COMMAND_CONFIRM_SAMPLES = 5
BACKDATING_SAMPLES = 64
MEDIAN_SAMPLES = 8
TOUCH_CONFIRM_SAMPLES = 2

# plain integers: combining enum members takes longer than the rest of a sample's processing
IN_GRASP, CONTACT, CONTACT_SENSED = SampleFlag.IN_GRASP.value, SampleFlag.CONTACT.value, SampleFlag.CONTACT_SENSED.value
JAWS_CLOSED, ENCODER_SLIPS = SampleFlag.JAWS_CLOSED.value, SampleFlag.ENCODER_SLIPS.value


@dataclass(slots=True)
class _LoadingPoint:
    tick: int
    strain_v: float
    encoder_deg: float


@dataclass(slots=True)
class _GraspState:
    """State of the grasp under way."""

    index: int
    start_tick: int
    encoder_zero_deg: float
    detected_tick: int  # first sample whose encoder angle counts from `encoder_zero_deg`
    contact_tick: int = -1
    jaw_closure_tick: int = -1
    baseline_v: float = np.inf
    encoder_slips: bool = False
    rising_samples: int = 0
    touching_samples: int = 0
    loading_points: list[_LoadingPoint] = field(default_factory=list)


class GraspTracker:
    """Tracker of grasps, sample by sample.

    A grasp begins where the command leaves zero (detected a few samples later and back-dated) and ends where it
    returns to zero. Contact comes from the touch sensors if the tool trusts them, else from a rise of the strain over
    its lowest level in the grasp. The jaws are shut where the strain rises while the encoder advances no more than the
    cable stretches.

    Without a motor command (`hand_driven`), a grasp begins where the encoder has travelled far enough from its last
    open position, and ends where it has come back most of the way. The encoder's zero is that position, and the strain
    of the open jaws is the level over which it must rise.
    """

    def __init__(
        self, detection: ContactDetection, stretch_deg_per_volt: float, hand_driven: HandDrivenGrasps | None = None
    ) -> None:
        self._detection, self._hand_driven = detection, hand_driven
        self._open_travel_deg, self._shut_travel_deg = np.inf, -np.inf  # of the last open and shut positions
        self._open_strain_v = np.inf  # lowest since the last grasp
        self._stretch_deg_per_volt = stretch_deg_per_volt
        self._recent_samples: deque[tuple[float, float, float]] = deque(
            maxlen=BACKDATING_SAMPLES
        )  # command, strain, encoder
        self._last_strain_v: deque[float] = deque(maxlen=MEDIAN_SAMPLES)
        self._last_encoder_deg: deque[float] = deque(maxlen=MEDIAN_SAMPLES)
        self._on_samples = 0
        self._off_samples = 0
        self.in_grasp = False
        self.grasp = _GraspState(index=0, start_tick=-1, encoder_zero_deg=0.0, detected_tick=0)

    def update(self, tick: int, command_v: float, strain_v: float, encoder_deg: float, touched: bool) -> int:
        """Process one sample, with the strain tared, and return its flags."""
        if not self._recent_samples:
            self.grasp.encoder_zero_deg = encoder_deg
        self._recent_samples.append((command_v, strain_v, encoder_deg))
        self._last_strain_v.append(strain_v)
        self._last_encoder_deg.append(encoder_deg)
        if self._hand_driven is None:
            self._track_command(tick, command_v)
        else:
            self._track_travel(tick, self._hand_driven)
        if not self.in_grasp:
            return 0
        grasp = self.grasp
        if grasp.contact_tick < 0:
            self._detect_contact(tick, touched)
        if grasp.contact_tick >= 0 and grasp.jaw_closure_tick < 0 and not grasp.encoder_slips:
            self._detect_jaw_closure(tick)
        flags = IN_GRASP
        if grasp.contact_tick >= 0:
            flags |= CONTACT | (CONTACT_SENSED if self._detection.touch_trusted else 0)
        if grasp.jaw_closure_tick >= 0:
            flags |= JAWS_CLOSED
        if grasp.encoder_slips:
            flags |= ENCODER_SLIPS
        return flags

    def _track_command(self, tick: int, command_v: float) -> None:
        on = command_v > COMMAND_ON_V
        self._on_samples = self._on_samples + 1 if on else 0
        self._off_samples = 0 if on else self._off_samples + 1
        if not self.in_grasp and self._on_samples >= COMMAND_CONFIRM_SAMPLES:
            self._begin_grasp(tick)
        elif self.in_grasp and self._off_samples >= COMMAND_CONFIRM_SAMPLES:
            self.in_grasp = False

    def _begin_grasp(self, tick: int) -> None:
        """Start the grasp at the sample after the last one at zero command, and set the encoder's zero there."""
        start, encoder_zero = 0, self._recent_samples[-1][2]  # samples to go back, and the encoder there
        for command_v, _, encoder_deg in reversed(self._recent_samples):
            if command_v <= COMMAND_ZERO_V:
                break
            start, encoder_zero = start + 1, encoder_deg
        start -= 1
        self._start_grasp(tick - start, encoder_zero, tick)

    def _start_grasp(self, start_tick: int, encoder_zero_deg: float, detected_tick: int) -> None:
        walk = abs(encoder_zero_deg - self.grasp.encoder_zero_deg)
        walked = self.grasp.index > 0 and walk > self._detection.walk_deg
        index = self.grasp.index + 1
        self.grasp = _GraspState(index, start_tick, encoder_zero_deg, detected_tick, encoder_slips=walked)
        self.in_grasp = True

    def _track_travel(self, tick: int, hand_driven: HandDrivenGrasps) -> None:
        """Begin or end a grasp by the encoder alone, whose travel counts from the last open position."""
        strain_v, travel_deg = self._compute_medians()
        if self.in_grasp:
            self._shut_travel_deg = max(self._shut_travel_deg, travel_deg)
            left_deg = hand_driven.open_share * (self._shut_travel_deg - self._open_travel_deg)
            if travel_deg < self._open_travel_deg + left_deg:
                self.in_grasp, self._open_travel_deg, self._open_strain_v = False, travel_deg, strain_v
            return
        self._open_travel_deg = min(self._open_travel_deg, travel_deg)
        self._open_strain_v = min(self._open_strain_v, strain_v)
        if travel_deg > self._open_travel_deg + hand_driven.closing_deg:
            self._shut_travel_deg = travel_deg
            self._start_grasp(tick, self._open_travel_deg, tick)
            self.grasp.baseline_v = self._open_strain_v

    def _detect_contact(self, tick: int, touched: bool) -> None:
        grasp, detection = self.grasp, self._detection
        if detection.touch_trusted:
            grasp.touching_samples = grasp.touching_samples + 1 if touched else 0
            if grasp.touching_samples >= TOUCH_CONFIRM_SAMPLES:
                grasp.contact_tick = max(tick - TOUCH_CONFIRM_SAMPLES + 1, grasp.detected_tick)
            return
        strain_v, _ = self._compute_medians()
        grasp.baseline_v = min(grasp.baseline_v, strain_v)
        rises = self._recent_samples[-1][1] > grasp.baseline_v + detection.force_rise_v
        grasp.rising_samples = grasp.rising_samples + 1 if rises else 0
        if grasp.rising_samples >= detection.force_rise_samples:
            grasp.contact_tick = max(tick - self._count_samples_since_onset(), grasp.detected_tick)

    def _count_samples_since_onset(self) -> int:
        """Count the latest consecutive samples above half of the rise that detects contact."""
        onset_v = self.grasp.baseline_v + self._detection.force_rise_v / 2
        count = 0
        for _, strain_v, _ in reversed(self._recent_samples):
            if strain_v <= onset_v:
                break
            count += 1
        return count

    def _detect_jaw_closure(self, tick: int) -> None:
        """Compare the encoder's advance with the cable's stretch over the last rise of strain."""
        grasp, detection = self.grasp, self._detection
        strain_v, encoder_deg = self._compute_medians()
        step_v = detection.wall_span_v / 4
        points = grasp.loading_points
        if points and strain_v < points[-1].strain_v - step_v:
            points.clear()  # unloading
        if points and strain_v < points[-1].strain_v + step_v:
            return
        points.append(_LoadingPoint(tick, strain_v, encoder_deg))
        if len(points) < 5 or points[-5].strain_v < detection.wall_above_v:
            return
        first = points[-5]
        slope = (encoder_deg - first.encoder_deg) / (strain_v - first.strain_v)
        if self._stretch_deg_per_volt and slope < self._stretch_deg_per_volt * detection.slip_share:
            grasp.encoder_slips = True  # without stretch nothing tells an encoder that slips from shut jaws
        elif slope < self._stretch_deg_per_volt + detection.wall_slack_deg_per_volt:
            grasp.jaw_closure_tick = first.tick

    def _compute_medians(self) -> tuple[float, float]:
        """Return the medians of the last strain and encoder samples, which ignore spikes of one sample."""
        middle = len(self._last_strain_v) // 2
        return sorted(self._last_strain_v)[middle], sorted(self._last_encoder_deg)[middle]
