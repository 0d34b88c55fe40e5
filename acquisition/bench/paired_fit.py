"""Function that fits the map from drive to jaws (`acquisition.signals.drive_map`) to paired recordings.

Least squares over all samples whose direction is known. Samples of one stroke have a common error (a load, a cable that
settles), so the intervals come from the scatter from stroke to stroke, not from sample to sample: the covariance is the
cluster-robust one of K.-Y. Liang and S. Zeger (Biometrika 73, 1986) with Student's t of strokes - 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.signals.drive_map import (
    DriveMap,
    Motion,
    build_regressors,
    compute_branches,
    follow_friction,
    follow_motion,
)
from config.errors import CalibrationError

CONFIDENCE = 0.95
REVERSAL_TRAVEL_SHARE = 0.04  # of the stroke; 0.02 to 0.09 leave nearly the same residual
MIN_SAMPLES = 100
MAX_FITTED_SAMPLES = 2000  # of a recording: the fit visits each one hundreds of times
MAX_RESIDUAL_SHARE = 0.7  # of the standard deviation of the jaw force: with more, the drive hardly tells the force
MIN_STROKES = 3  # for an interval
MAX_CONDITION = 1e4  # of drive force and position while moving in one direction


@dataclass(frozen=True, slots=True)
class PairedSignals:
    """Signals of one recording, (n,) each, in the units of its columns; `name` is for messages."""

    name: str
    drive_force: np.ndarray
    drive_position: np.ndarray
    jaw_force: np.ndarray


@dataclass(frozen=True, slots=True)
class FileResidual:
    """Residual RMS over all samples of one recording: fitted on all of them, and on the others (None: not held out)."""

    name: str
    own_rms: float
    held_out_rms: float | None


@dataclass(frozen=True, slots=True)
class PairedFit:
    """Result of `fit_pairs`: the map, the ends of its coefficients' 95 % intervals, (6,) each, and the residuals."""

    drive_map: DriveMap
    low: np.ndarray
    high: np.ndarray
    strokes: int
    files: tuple[FileResidual, ...]

    @property
    def mean_held_out_rms(self) -> float | None:
        """Mean over the recordings of their residual RMS when held out; None if none was."""
        found = [each.held_out_rms for each in self.files if each.held_out_rms is not None]
        return float(np.mean(found)) if found else None


@dataclass(frozen=True, slots=True)
class _Scale:
    """Middle and spread of a signal, with which the fit computes."""

    middle: float
    spread: float

    def apply(self, values: np.ndarray) -> np.ndarray:
        return (values - self.middle) / self.spread


@dataclass(frozen=True, slots=True)
class _Sampled:
    """Scaled signals of one recording at the samples that are fitted, (n,) each, and the motion there."""

    drive_force: np.ndarray
    drive_position: np.ndarray
    jaw_force: np.ndarray
    motion: Motion

    @property
    def known(self) -> np.ndarray:
        return self.motion.direction != 0

    def compute_residuals(self, coefficients: np.ndarray) -> np.ndarray:
        branches = compute_branches(coefficients, self.drive_force, self.drive_position)
        return (follow_friction(*branches, self.motion) - self.jaw_force)[self.known]


def fit_pairs(pairs: Sequence[PairedSignals], hold_out: bool = True) -> PairedFit:
    """Fit the map to recordings; with `hold_out` and two or more, judge each one by a fit to the others.

    The map's `residual_sd` is the RMS of the residuals with known direction: of the recordings held out, if any are.

    Raises:
        CalibrationError: a signal is constant or no number, a direction is missing, force and position vary only
            together, or the drive does not tell the jaw force.
    """
    for pair in pairs:
        _check_pair(pair)
    fit = _fit_all(pairs)
    held_out: list[float | None] = [None] * len(pairs)
    if hold_out and len(pairs) > 1:
        squares: list[float] = []
        for n, pair in enumerate(pairs):
            try:
                others = _fit_all([*pairs[:n], *pairs[n + 1 :]], fit.drive_map)
            except CalibrationError as error:
                raise CalibrationError(f"Without {pair.name}: {error} Or add --no-hold-out.") from None
            left, known = _compute_residuals(others.drive_map, pair)
            held_out[n] = _compute_rms(left)
            squares.append(_compute_rms(left[known]) ** 2)
        fit = replace(fit, drive_map=replace(fit.drive_map, residual_sd=float(np.sqrt(np.mean(squares)))))
    files = (
        FileResidual(pair.name, _compute_rms(_compute_residuals(fit.drive_map, pair)[0]), rms)
        for pair, rms in zip(pairs, held_out, strict=True)
    )
    return replace(fit, files=tuple(files))


def _fit_all(pairs: Sequence[PairedSignals], start: DriveMap | None = None) -> PairedFit:
    from scipy.optimize import least_squares  # slow imports
    from scipy.special import stdtrit

    force, position, jaw = (
        _compute_scale([getattr(pair, name) for pair in pairs])
        for name in ("drive_force", "drive_position", "jaw_force")
    )
    stroke = float(np.median([np.ptp(pair.drive_position) for pair in pairs]))
    travel = start.reversal_travel if start else REVERSAL_TRAVEL_SHARE * stroke
    sampled = [_sample(pair, force, position, jaw, travel) for pair in pairs]
    to_scaled, offset = _build_scaling(force, position, jaw)

    def compute_residuals(unknown: np.ndarray) -> np.ndarray:
        return np.concatenate([each.compute_residuals(unknown) for each in sampled])

    begin = to_scaled @ start.coefficients - offset if start else _guess(sampled)
    solved = least_squares(compute_residuals, begin)
    left = solved.fun
    share = _compute_rms(left) / float(np.concatenate([each.jaw_force[each.known] for each in sampled]).std())
    if share > MAX_RESIDUAL_SHARE:
        raise CalibrationError(
            f"The map leaves {share:.0%} of the jaw force's variation, more than {MAX_RESIDUAL_SHARE:.0%}: the "
            "columns are other signals than named, or the sensors were not read at the same time. Look at the columns, "
            "and name them again."
        )
    strokes = _number_strokes(sampled)
    count = int(strokes[-1]) + 1
    if count < MIN_STROKES:
        raise CalibrationError(
            f"{count} strokes of the drive are too few for an interval: record at least {MIN_STROKES}, forward and "
            "backward."
        )
    scores = np.array([solved.jac[strokes == n].T @ left[strokes == n] for n in range(count)])
    inverse = np.linalg.pinv(solved.jac.T @ solved.jac)
    from_scaled = np.linalg.inv(to_scaled)
    spread = from_scaled @ inverse
    variance = np.diag(spread @ (scores.T @ scores) @ spread.T) * count / (count - 1)
    coefficients = from_scaled @ (solved.x + offset)
    half = float(stdtrit(count - 1, (1 + CONFIDENCE) / 2)) * np.sqrt(variance)
    jaw_forces = np.concatenate([pair.jaw_force for pair in pairs])
    sd = jaw.spread * float(np.sqrt(left @ left / max(len(left) - 6, 1)))
    found = DriveMap(coefficients, travel, sd, float(jaw_forces.min()), float(jaw_forces.max()))
    return PairedFit(found, coefficients - half, coefficients + half, count, ())


def _check_pair(pair: PairedSignals) -> None:
    signals = {"drive-force": pair.drive_force, "drive-position": pair.drive_position, "jaw-force": pair.jaw_force}
    lengths = {len(each) for each in signals.values()}
    if len(lengths) > 1 or min(lengths) < MIN_SAMPLES:
        raise CalibrationError(f"{pair.name}: at least {MIN_SAMPLES} samples of each signal are needed: record longer.")
    for name, values in signals.items():
        if not np.isfinite(values).all():
            raise CalibrationError(f"{pair.name}: {name} is not a number in every sample: leave these rows out.")
        if np.ptp(values) == 0:
            raise CalibrationError(
                f"{pair.name}: {name} is {values[0]:g} all the time: check the sensor, or name another column."
            )


def _compute_scale(signals: Sequence[np.ndarray]) -> _Scale:
    values = np.concatenate(signals)
    return _Scale(float(values.mean()), float(values.std()))


def _build_scaling(force: _Scale, position: _Scale, jaw: _Scale) -> tuple[np.ndarray, np.ndarray]:
    """Return matrix (6, 6) and offset (6,) of the scaled coefficients: scaled = matrix @ coefficients - offset."""
    one = np.array([[1.0, force.middle, position.middle], [0.0, force.spread, 0.0], [0.0, 0.0, position.spread]])
    return np.kron(np.eye(2), one) / jaw.spread, np.tile([jaw.middle / jaw.spread, 0.0, 0.0], 2)


def _sample(pair: PairedSignals, force: _Scale, position: _Scale, jaw: _Scale, travel: float) -> _Sampled:
    every = slice(None, None, -(-len(pair.jaw_force) // MAX_FITTED_SAMPLES))
    at = pair.drive_position[every]
    return _Sampled(
        force.apply(pair.drive_force[every]),
        position.apply(at),
        jaw.apply(pair.jaw_force[every]),
        follow_motion(at, travel),
    )


def _guess(sampled: Sequence[_Sampled]) -> np.ndarray:
    """Return scaled coefficients (6,) to begin with: a plane for each direction, from the second halves of strokes."""
    found: list[np.ndarray] = []
    for direction, name in ((1, "rises"), (-1, "falls")):
        rows: list[np.ndarray] = []
        jaw: list[np.ndarray] = []
        for each in sampled:
            settled = (each.motion.direction == direction) & (each.motion.travel > each.motion.travel.max() / 2)
            rows.append(build_regressors(each.drive_force[settled], each.drive_position[settled]))
            jaw.append(each.jaw_force[settled])
        regressors = np.vstack(rows)
        if len(regressors) < MIN_SAMPLES // 4:
            raise CalibrationError(
                f"The drive position hardly ever {name}: record full strokes in both directions, forward and backward."
            )
        if not np.linalg.cond(regressors) < MAX_CONDITION:
            raise CalibrationError(
                f"Drive force and drive position vary only together while the position {name}: add recordings "
                "with another load."
            )
        found.append(np.linalg.lstsq(regressors, np.concatenate(jaw))[0])
    return np.concatenate(found)


def _number_strokes(sampled: Sequence[_Sampled]) -> np.ndarray:
    """Return the number of each fitted sample's stroke, from 0 on, through all recordings."""
    numbers: list[np.ndarray] = []
    after = 0
    for each in sampled:
        turns = np.cumsum(np.diff(each.motion.direction[each.known], prepend=0) != 0)
        if len(turns):
            numbers.append(turns - 1 + after)
            after += int(turns[-1])
    return np.concatenate(numbers)


def _compute_residuals(drive_map: DriveMap, pair: PairedSignals) -> tuple[np.ndarray, np.ndarray]:
    known = follow_motion(pair.drive_position, drive_map.reversal_travel).direction != 0
    return drive_map.predict(pair.drive_force, pair.drive_position).force - pair.jaw_force, known


def _compute_rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
