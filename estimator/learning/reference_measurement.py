"""Measure a reference grasp: the drive's stall and both stops, from grasps that close on nothing."""

import math
from datetime import datetime

import numpy as np

from acquisition.bench.calibration_bench import extract_grasp_passes, select_raw_signals
from acquisition.bench.checks import RawSignals
from acquisition.bench.fits import fit_cable_stretch_lines
from acquisition.sample_block import SampleFlag
from config.errors import CalibrationError
from config.schema import ReferenceGrasp, Tool
from estimator.learning.recorded_grasps import RecordedGrasp, split_grasps
from estimator.loading.constants import (
    EMPTY_FORCE_SHARE,
    FORCE_FLOOR_SHARE,
    MIN_REFERENCE_GRASPS,
    REFERENCE_SMOOTHING_S,
    REFERENCE_STALL_SD,
)
from estimator.loading.loading_curve import FORCES, LoadingCurve

HELD_BACK = (SampleFlag.LIMITED | SampleFlag.RELEASED).value
ADVICE = "Empty the jaws, and take the reference grasp again."


def measure_reference(samples: np.ndarray, tool: Tool, taken_at: datetime, person: str | None) -> ReferenceGrasp:
    """Return the reference grasp from the samples of its run, dtype SAMPLE.

    Raises:
        CalibrationError: too few grasps can be used, something is between the jaws, or the grasps disagree.
    """
    grasps = [RecordedGrasp(index, own, np.full(3, math.nan), None) for index, own in split_grasps(samples)]
    faults = {grasp.index: fault for grasp in grasps if (fault := _find_fault(grasp))}
    sound = [grasp for grasp in grasps if grasp.index not in faults and len(grasp.samples)]
    if len(sound) < MIN_REFERENCE_GRASPS:
        reasons = f" ({'; '.join(sorted(set(faults.values())))})" if faults else ""
        raise CalibrationError(
            f"Of {len(grasps)} grasps {len(sound)} can be used{reasons}; a reference grasp needs "
            f"{MIN_REFERENCE_GRASPS}. Mend that, and take it again with the protocol `reference_grasp`."
        )
    peak_v = float(np.median([grasp.peak_v for grasp in sound]))
    signals = select_raw_signals(np.concatenate([grasp.samples for grasp in sound]))
    lines = fit_cable_stretch_lines(extract_grasp_passes(_smooth(signals, tool), tool), tool)
    stretch = float(np.mean([slope for slope, _, _ in lines]))
    with_own_stretch = [_load(grasp, tool, stretch, peak_v) for grasp in sound]
    forces = [np.exp(each.observe_features().features[FORCES]) - FORCE_FLOOR_SHARE for each in with_own_stretch]
    before = float(np.median([np.nanmax(force) for force in forces]))
    if not before <= EMPTY_FORCE_SHARE:
        raise CalibrationError(
            f"The force rises to {before:.0%} of the stall before the jaws are shut, in empty jaws to "
            f"{EMPTY_FORCE_SHARE:.0%} at most: something is between them. {ADVICE}"
        )
    # The features of grasps are computed with the stretch of the tool file, so the stops are, too.
    curves = [_load(grasp, tool, tool.stretch_deg_per_volt, peak_v) for grasp in sound]
    stalls_v = np.array([curve.peak_v for curve in curves])
    stall_v = float(np.median(stalls_v))
    if float(stalls_v.std(ddof=1)) > REFERENCE_STALL_SD * stall_v:
        raise CalibrationError(
            f"The drive stalls at {stalls_v.min():.2f} to {stalls_v.max():.2f} V: its grasps disagree by more than "
            f"{REFERENCE_STALL_SD:.0%}. Look for a slipping cable. {ADVICE}"
        )
    return ReferenceGrasp(
        tool=tool.name,
        calibration=tool.calibration_fingerprint,
        taken_at=taken_at,
        person=person,
        grasps=len(sound),
        command_v=max(float(grasp.samples["motor_command_v"].max()) for grasp in sound),
        stall_v=stall_v,
        stretch_deg_per_volt=stretch,
        shut_deg=float(np.median([each.jaw_closure_deg for each in curves if each.jaw_closure_deg is not None])),
        open_deg=float(np.median([curve.start_deg for curve in curves])),
    )


def _find_fault(grasp: RecordedGrasp) -> str | None:
    """Return why a grasp is no reference; None if it is usable."""
    held_back = len(grasp.samples) and int(np.bitwise_or.reduce(grasp.samples["flags"])) & HELD_BACK
    return "the force limiter held the motor back" if held_back else grasp.find_fault()


def _load(grasp: RecordedGrasp, tool: Tool, stretch_deg_per_volt: float, peak_v: float) -> LoadingCurve:
    """Return a grasp's loading curve to its end.

    Raises:
        CalibrationError: the drive did not stall, or the jaws were not shut.
    """
    curve = LoadingCurve(stretch_deg_per_volt, peak_v, 1.0 / tool.board.sample_rate_hz)
    curve.append(grasp.samples)
    if not curve.ended or curve.jaw_closure_deg is None:
        raise CalibrationError(
            f"Grasp {grasp.index} ended before the drive stalled. Take the reference grasp with the protocol "
            "`reference_grasp`."
        )
    return curve


def _smooth(signals: RawSignals, tool: Tool) -> RawSignals:
    """Return the signals with strain and encoder as running means; a line of one over the other stays the same."""
    count = max(round(REFERENCE_SMOOTHING_S * tool.board.sample_rate_hz), 1)
    strain_v, encoder_deg = (
        np.convolve(np.pad(each, (count // 2, count - 1 - count // 2), "edge"), np.full(count, 1 / count), "valid")
        for each in (signals.strain_v, signals.encoder_deg)
    )
    return RawSignals(strain_v, signals.readback_v, signals.touch_v, encoder_deg)
