"""Classes of recorded grasps for learning, with the reasons why some are left out, and of their loading curves."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from acquisition.sample_block import SampleFlag
from config.schema import UNKNOWN_CONDITIONS, SourceConditions, Tool
from estimator.loading.constants import FEATURES, MEAN_SAMPLES, MIN_PEAK_SHARE
from estimator.loading.loading_curve import LoadingCurve, find_travel_scale

IN_GRASP = SampleFlag.IN_GRASP.value
ENCODER_SLIPS, SATURATED = SampleFlag.ENCODER_SLIPS.value, SampleFlag.SATURATED.value


@dataclass(frozen=True, slots=True)
class RecordedGrasp:
    """One grasp of a recording, from the command leaving zero to its return."""

    index: int
    samples: np.ndarray  # dtype SAMPLE
    log_parameters: np.ndarray  # ln of alpha (N), beta (1/m), d (kg/s), (3,); NaN without a fit
    thickness_m: float | None  # None without sensed contact

    @property
    def peak_v(self) -> float:
        """Highest smoothed strain voltage minus the lowest before it, V."""
        volt = np.convolve(self.samples["strain_v"], np.full(MEAN_SAMPLES, 1 / MEAN_SAMPLES), "valid")
        top = int(np.argmax(volt)) if len(volt) else 0
        return float(volt[top] - volt[: top + 1].min()) if len(volt) else 0.0

    def find_fault(self) -> str | None:
        """Return the reason why nothing can be learned from this grasp; None if it is usable."""
        flags = int(np.bitwise_or.reduce(self.samples["flags"])) if len(self.samples) else 0
        if flags & ENCODER_SLIPS:
            return "encoder slips or walks"
        if flags & SATURATED:
            return "the strain gage is saturated"
        if len(self.samples) and np.any(np.diff(self.samples["tick"]) != 1):
            return "samples are missing"
        return None


@dataclass(frozen=True, slots=True)
class LabeledRecording:
    """A recording with its tissue's label."""

    label: str
    file: str
    sha256: str
    grasps: tuple[RecordedGrasp, ...]
    conditions: SourceConditions = UNKNOWN_CONDITIONS


@dataclass(slots=True)
class LoadingCurves:
    """Features and parameters of a recording's N usable grasps, F features each."""

    recording: LabeledRecording
    features: np.ndarray  # (N, F)
    log_parameters: np.ndarray  # (N, 3)
    log_thickness: np.ndarray  # (N,), NaN where it is not measured
    ramp_log: float
    grasp_indices: list[int] = field(default_factory=list)  # from 1
    left_out: list[str] = field(default_factory=list)  # other grasps, with the reason


def split_grasps(samples: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the index, from 1, and the samples of each grasp in a recording's samples, dtype SAMPLE."""
    for index in range(1, int(samples["grasp"].max(initial=0)) + 1):
        yield index, samples[(samples["grasp"] == index) & ((samples["flags"] & IN_GRASP) != 0)]


def estimate_usual_peak_v(recordings: Sequence[LabeledRecording]) -> float:
    """Return the peak strain voltage that grasps of all recordings reach, V, to a millivolt; NaN without usable grasps.

    It is the lowest of the recordings' medians, but at least `MIN_PEAK_SHARE` of the median recording.
    """
    peaks = [
        np.median(sound) for each in recordings if (sound := [g.peak_v for g in each.grasps if not g.find_fault()])
    ]
    return round(float(max(min(peaks), MIN_PEAK_SHARE * np.median(peaks))), 3) if peaks else math.nan


def extract_loading_curves(recording: LabeledRecording, tool: Tool, peak_v: float) -> LoadingCurves:
    """Return the features of each usable grasp. The first grasp is left out: its tissue is not preconditioned."""
    dt_s, stretch, scale = 1.0 / tool.board.sample_rate_hz, tool.stretch_deg_per_volt, find_travel_scale(tool)
    features, ramps, kept, left_out = [], [], [], []
    for position, grasp in enumerate(recording.grasps):
        loading = LoadingCurve(
            stretch, peak_v, dt_s, first=position == 0, travel_scale=scale, hand_driven=tool.hand_driven is not None
        )
        loading.append(grasp.samples)
        seen = loading.observe_features()
        why = grasp.find_fault() or ("first grasp: the tissue is not preconditioned" if position == 0 else None)
        if why is None and not np.isfinite(seen.features).all():
            missing = ", ".join(np.array(FEATURES)[~np.isfinite(seen.features)])
            why = f"the force never came far enough to tell {missing}"
        if why:
            left_out.append(f"{grasp.index}: {why}")
            continue
        features.append(seen.features)
        ramps.append(seen.ramp_log)
        kept.append(grasp)
    thickness = [math.nan if grasp.thickness_m is None else math.log(grasp.thickness_m) for grasp in kept]
    return LoadingCurves(
        recording,
        np.array(features).reshape(-1, len(FEATURES)),
        np.array([grasp.log_parameters for grasp in kept]).reshape(-1, 3),
        np.array(thickness),
        float(np.median(ramps)) if ramps else math.nan,
        [grasp.index for grasp in kept],
        left_out,
    )
