"""Where a grasp begins and ends, where tissue is touched, where the jaws are shut, and whether the encoder slips."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from acquisition.blocks import Flag
from config.schema import ContactDetection

COMMAND_ON_V = 0.02  # above the single-sample spikes (17 mV) of a command line read back at rest
COMMAND_ZERO_V = 0.002  # noise of the read-back
COMMAND_SAMPLES = 5
BACKDATE_SAMPLES = 64
SMOOTH_SAMPLES = 8
TOUCH_SAMPLES = 2

# plain integers: combining enum members costs more than the rest of a sample
IN_GRASP, CONTACT, CONTACT_SENSED = Flag.IN_GRASP.value, Flag.CONTACT.value, Flag.CONTACT_SENSED.value
JAWS_SHUT, ENCODER_SLIPS = Flag.JAWS_SHUT.value, Flag.ENCODER_SLIPS.value


@dataclass(slots=True)
class _LoadingPoint:
    tick: int
    strain_v: float
    encoder_deg: float


@dataclass(slots=True)
class _Grasp:
    """What is known of the grasp under way."""

    index: int
    start_tick: int
    encoder_zero_deg: float
    known_tick: int  # first sample that is measured from this zero
    contact_tick: int = -1
    wall_tick: int = -1
    baseline_v: float = np.inf
    slips: bool = False
    rising: int = 0
    touching: int = 0
    loading: list[_LoadingPoint] = field(default_factory=list)


class GraspTracker:
    """Follows the grasps sample by sample.

    A grasp begins where the command leaves zero (known a few samples later, back-dated) and ends where it returns.
    Contact comes from the touch sensors where the tool trusts them, else from the strain rising over its lowest level
    since the grasp began. Shut jaws show as strain that rises while the encoder advances no more than the cable
    stretches.
    """

    def __init__(self, detection: ContactDetection, stretch_deg_per_volt: float) -> None:
        self._detection = detection
        self._stretch = stretch_deg_per_volt
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=BACKDATE_SAMPLES)  # command, strain, encoder
        self._last_strain_v: deque[float] = deque(maxlen=SMOOTH_SAMPLES)
        self._last_encoder_deg: deque[float] = deque(maxlen=SMOOTH_SAMPLES)
        self._on = 0
        self._off = 0
        self.in_grasp = False
        self.grasp = _Grasp(index=0, start_tick=-1, encoder_zero_deg=0.0, known_tick=0)

    def update(self, tick: int, command_v: float, strain_v: float, encoder_deg: float, touched: bool) -> int:
        """Take one sample (strain tared); returns its flags."""
        if not self._recent:
            self.grasp.encoder_zero_deg = encoder_deg
        self._recent.append((command_v, strain_v, encoder_deg))
        self._last_strain_v.append(strain_v)
        self._last_encoder_deg.append(encoder_deg)
        self._follow_command(tick, command_v)
        if not self.in_grasp:
            return 0
        grasp = self.grasp
        if grasp.contact_tick < 0:
            self._look_for_contact(tick, touched)
        if grasp.contact_tick >= 0 and grasp.wall_tick < 0 and not grasp.slips:
            self._watch_loading(tick)
        flags = IN_GRASP
        if grasp.contact_tick >= 0:
            flags |= CONTACT | (CONTACT_SENSED if self._detection.touch_trusted else 0)
        if grasp.wall_tick >= 0:
            flags |= JAWS_SHUT
        if grasp.slips:
            flags |= ENCODER_SLIPS
        return flags

    def _follow_command(self, tick: int, command_v: float) -> None:
        on = command_v > COMMAND_ON_V
        self._on = self._on + 1 if on else 0
        self._off = 0 if on else self._off + 1
        if not self.in_grasp and self._on >= COMMAND_SAMPLES:
            self._begin(tick)
        elif self.in_grasp and self._off >= COMMAND_SAMPLES:
            self.in_grasp = False

    def _begin(self, tick: int) -> None:
        """Back-date the grasp to the sample after the last one at zero, and zero the encoder there."""
        start = 0  # samples back
        for command_v, _, encoder_deg in reversed(self._recent):
            if command_v <= COMMAND_ZERO_V:
                break
            start, encoder_zero = start + 1, encoder_deg
        start -= 1
        walk = abs(encoder_zero - self.grasp.encoder_zero_deg)
        walked = self.grasp.index > 0 and walk > self._detection.walk_deg
        self.grasp = _Grasp(self.grasp.index + 1, tick - start, encoder_zero, tick, slips=walked)
        self.in_grasp = True

    def _look_for_contact(self, tick: int, touched: bool) -> None:
        grasp, detection = self.grasp, self._detection
        if detection.touch_trusted:
            grasp.touching = grasp.touching + 1 if touched else 0
            if grasp.touching >= TOUCH_SAMPLES:
                grasp.contact_tick = max(tick - TOUCH_SAMPLES + 1, grasp.known_tick)
            return
        strain_v, _ = self._smoothed()
        grasp.baseline_v = min(grasp.baseline_v, strain_v)
        rises = self._recent[-1][1] > grasp.baseline_v + detection.force_rise_v
        grasp.rising = grasp.rising + 1 if rises else 0
        if grasp.rising >= detection.force_rise_samples:
            grasp.contact_tick = max(tick - self._samples_since_onset(), grasp.known_tick)

    def _samples_since_onset(self) -> int:
        """How many of the last samples lie above half the rise that tells contact."""
        onset_v = self.grasp.baseline_v + self._detection.force_rise_v / 2
        count = 0
        for _, strain_v, _ in reversed(self._recent):
            if strain_v <= onset_v:
                break
            count += 1
        return count

    def _watch_loading(self, tick: int) -> None:
        """Compare the encoder's advance with the cable's stretch over the last rise of strain."""
        grasp, detection = self.grasp, self._detection
        strain_v, encoder_deg = self._smoothed()
        step_v = detection.wall_span_v / 4
        points = grasp.loading
        if points and strain_v < points[-1].strain_v - step_v:
            points.clear()  # unloading
        if points and strain_v < points[-1].strain_v + step_v:
            return
        points.append(_LoadingPoint(tick, strain_v, encoder_deg))
        if len(points) < 5 or points[-5].strain_v < detection.wall_above_v:
            return
        first = points[-5]
        slope = (encoder_deg - first.encoder_deg) / (strain_v - first.strain_v)
        if slope < self._stretch * detection.slip_share:
            grasp.slips = True
        elif slope < self._stretch + detection.wall_slack_deg_per_volt:
            grasp.wall_tick = first.tick

    def _smoothed(self) -> tuple[float, float]:
        """Medians of the last few strain and encoder samples: single-sample spikes do not count."""
        middle = len(self._last_strain_v) // 2
        return sorted(self._last_strain_v)[middle], sorted(self._last_encoder_deg)[middle]
