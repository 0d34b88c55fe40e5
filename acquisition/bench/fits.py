"""Functions that fit a tool's constants to bench measurements, with confidence intervals; they refuse bad fits.

All are least squares with Student's t: the scatter comes from the readings, not from an assumed noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from acquisition.bench.checks import SATURATION_SHARE, RawSignals
from acquisition.safety.self_test import MAX_REST_MOTION_DEG, compute_noise_range_v
from acquisition.signals.calibration import compute_jaw_signals
from config.errors import CalibrationError
from config.schema import FORCE_SCALE_KEY, ForceLaw, ForceScale, SmartToolKinematics, Tool

CONFIDENCE = 0.95
REST_SEGMENTS = 20  # of a reading at rest: their means scatter as slowly as the offset drifts
MAX_REST_DRIFT_V = 0.005  # of the rest voltage within a reading
MIN_WEIGHTS, MIN_GAUGES, MIN_PASSES = 4, 3, 3
MAX_WEIGHT_RESIDUAL_SHARE = 0.02  # of the span, for the distance of a reading from the line
MAX_INTERVAL_SHARE = 0.02  # of a constant, for half of its confidence interval
MAX_CURVATURE_SHARE = 0.05
"""Change of the stretch from the lower to the upper half of the force; shut jaws yield along a line."""
MIN_STRETCH_SHARE = 0.6  # of the stretch that the tool file names
MAX_PASS_SCATTER_SHARE = 0.1  # of the stretch, for the standard deviation from pass to pass
MAX_GAUGE_RESIDUAL_M = 1e-4
MIN_JAW_FORCES = 5
MAX_SCALE_RESIDUAL_SHARE = 0.05  # of the span: a constant scale must describe the transmission
MAX_SCALE_INTERVAL_SHARE = 0.1  # of the scale, for half of its confidence interval


@dataclass(frozen=True, slots=True)
class FittedConstant:
    """One measured constant of a tool file with its confidence interval and the fit's residual (RMS)."""

    key: str  # in the tool file, e.g. `calibration.newton_per_volt`
    value: float
    low: float
    high: float
    unit: str
    residual: float
    residual_unit: str
    readings: int

    @property
    def interval_half_width_share(self) -> float:
        return (self.high - self.low) / 2 / abs(self.value)


@dataclass(frozen=True, slots=True)
class CalibrationFit:
    """Result of a calibration: the fitted constants, and the points and the line of its plot."""

    constants: tuple[FittedConstant, ...]
    points: tuple[np.ndarray, np.ndarray]
    line: tuple[np.ndarray, np.ndarray]
    axes: tuple[str, str]
    remarks: tuple[str, ...] = ()


def read_current_value(constant: FittedConstant, tool: Tool) -> float | None:
    """Return the value that the tool has for a fitted constant at present; None if it has none."""
    table, key = constant.key.split(".")
    found = getattr(getattr(tool, table), key)
    return found.value if isinstance(found, ForceScale) else found


def fit_tare(rest: RawSignals, tool: Tool) -> CalibrationFit:
    """Fit the strain gage's rest voltage and noise, with the motor at zero and the jaws open.

    Raises:
        CalibrationError: the tool is not at rest, or its strain gage is not sound.
    """
    volts, rate_hz = rest.strain_v, tool.board.sample_rate_hz
    _check_numbers(volts, rest.encoder_deg)
    least_v, most_v = compute_noise_range_v(tool)
    sd_v = float(np.std(np.diff(volts))) / np.sqrt(2)  # of differences between neighbors, which exclude slow drift
    if np.abs(volts).max() > SATURATION_SHARE * tool.channels.analog_range_v:
        raise CalibrationError(
            f"The strain gage reads {volts[np.abs(volts).argmax()]:.2f} V, the end of its range: look for a broken "
            "wire, or balance the bridge."
        )
    if not least_v <= sd_v <= most_v:
        raise CalibrationError(
            f"The strain gage scatters by {sd_v * 1e3:.2f} mV, a sound one by {least_v * 1e3:.2f} to "
            f"{most_v * 1e3:.2f} mV: find out why with `graspwatch check`."
        )
    if (turned := float(np.ptp(rest.encoder_deg))) >= MAX_REST_MOTION_DEG:
        raise CalibrationError(f"The encoder turned by {turned:.1f} degrees meanwhile: let go of the tool, and repeat.")
    pieces_v = np.array([piece.mean() for piece in np.array_split(volts, REST_SEGMENTS)])
    at_s = (np.arange(REST_SEGMENTS) + 0.5) * len(volts) / REST_SEGMENTS / rate_hz
    drift_v = float(np.polyfit(at_s, pieces_v, 1)[0] * (at_s[-1] - at_s[0]))
    if abs(drift_v) > MAX_REST_DRIFT_V:
        raise CalibrationError(
            f"The rest voltage walked by {drift_v * 1e3:+.1f} mV while it was read: let the amplifier warm up for half "
            "an hour with nothing on the tool, and repeat."
        )
    mean_v = float(pieces_v.mean())
    half_v = _compute_student_quantile(REST_SEGMENTS - 1) * float(pieces_v.std(ddof=1)) / np.sqrt(REST_SEGMENTS)
    spread = _compute_student_quantile(len(volts) - 1) / np.sqrt(2 * len(volts))  # of a standard deviation
    constants = (
        FittedConstant(
            "calibration.rest_offset_v", mean_v, mean_v - half_v, mean_v + half_v, "V", sd_v, "V", len(volts)
        ),
        FittedConstant("noise.strain_sd_v", sd_v, sd_v * (1 - spread), sd_v * (1 + spread), "V", 0.0, "V", len(volts)),
    )
    return CalibrationFit(
        constants, (at_s, pieces_v), (at_s, np.full(REST_SEGMENTS, mean_v)), ("time, s", "strain gage at rest, V")
    )


def fit_strain(weights_n: Sequence[float] | np.ndarray, readings: Sequence[RawSignals], tool: Tool) -> CalibrationFit:
    """Fit Eq. (1) to known pulls on the handle, N, in the order of reading; rest (0 N) is one of them.

    Raises:
        CalibrationError: too few or impossible pulls, or readings that do not follow them.
    """
    pulls_n = check_pulls(weights_n)
    volts = np.array([float(reading.strain_v.mean()) for reading in readings])
    for pull_n, reading in zip(pulls_n, readings, strict=True):
        check_steady(reading, f"{pull_n:g} N", tool)
    by_pull = {pull_n: volts[pulls_n == pull_n].mean() for pull_n in sorted(set(pulls_n.tolist()))}
    levels_v = np.array(list(by_pull.values()))
    direction = np.sign(levels_v[-1] - levels_v[0])
    for (below_n, above_n), rise_v in zip(pairwise(by_pull), direction * np.diff(levels_v), strict=True):
        if rise_v <= 0:
            raise CalibrationError(
                f"The reading at {above_n:g} N is not above the one at {below_n:g} N: the weights were given in "
                "another order than they were hung, one of them rested on something, or the gage is loose. Repeat "
                "these two."
            )
    if direction < 0:
        raise CalibrationError(
            "The strain gage falls as the pull grows: exchange the two signal wires of the bridge, then repeat."
        )
    slope, intercept, slope_se = _fit_line(pulls_n, volts)  # V/N: the pulls are known, the volts scatter
    left_v = volts - (intercept + slope * pulls_n)
    worst = int(np.abs(left_v).argmax())
    span_v = float(np.ptp(volts))
    if abs(left_v[worst]) > MAX_WEIGHT_RESIDUAL_SHARE * span_v:
        raise CalibrationError(
            f"The reading at {pulls_n[worst]:g} N lies {left_v[worst] * 1e3:+.1f} mV off the line, more than "
            f"{MAX_WEIGHT_RESIDUAL_SHARE:.0%} of the span: a weight is named wrong, swings or rubs. Repeat it."
        )
    half = _compute_student_quantile(len(volts) - 2) * slope_se
    constant = _build_slope_constant(
        "calibration.newton_per_volt",
        1 / slope,
        1 / (slope + half),
        1 / (slope - half) if slope > half else np.inf,
        "N/V",
        left_v,
        "V",
        len(volts),
    )
    along_n = np.array([pulls_n.min(), pulls_n.max()])
    remarks = ()
    if not tool.calibration.is_rest_voltage(intercept):
        remarks = (f"Without any pull the line gives {intercept:.3f} V, which is no rest of this file: tare anew.",)
    return CalibrationFit(
        (constant,),
        (pulls_n, volts),
        (along_n, intercept + slope * along_n),
        ("pull on the handle, N", "strain gage, V"),
        remarks,
    )


def check_pulls(weights_n: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the pulls on the handle, N, as an array.

    Raises:
        CalibrationError: there are too few, or impossible ones.
    """
    pulls_n = np.array(weights_n, float)
    if not np.isfinite(pulls_n).all() or (pulls_n < 0).any():
        raise CalibrationError("A pull is a number of newtons that is not negative: correct the list.")
    if len(set(pulls_n.tolist())) < MIN_WEIGHTS:
        raise CalibrationError(
            f"{len(set(pulls_n.tolist()))} different pulls tell no line from a curve: give at least {MIN_WEIGHTS}, "
            "the unloaded gage (0) included."
        )
    return pulls_n


FORCE_SCALE_UNITS = {ForceLaw.EQUATION_2: "of Eq. (2)", ForceLaw.CONSTANT: "N/V"}
_FORCE_SCALE_AXES = {ForceLaw.EQUATION_2: "Eq. (2) as printed, N", ForceLaw.CONSTANT: "strain over rest, V"}


def fit_force_scale(
    forces_n: Sequence[float] | np.ndarray, readings: Sequence[RawSignals], tool: Tool, load_cell_error: float
) -> CalibrationFit:
    """Fit the force scale to known forces between the jaws, N, by the law of the tool file's scale.

    Args:
        forces_n: force that a load cell between the jaws showed at each reading. The first is 0, with open jaws.
        readings: at rest, with the motor at zero, in the same order.
        tool: its other constants must be calibrated before.
        load_cell_error: of the load cell, as a share of its reading. It widens the interval.

    Raises:
        CalibrationError: too few or impossible forces, or readings that are not in proportion to them.
    """
    known_n = check_jaw_forces(forces_n)
    for force_n, reading in zip(known_n, readings, strict=True):
        check_steady(reading, f"{force_n:g} N", tool)
    strain_v = np.array([float(reading.strain_v.mean()) for reading in readings])
    encoder_deg = np.array([float(reading.encoder_deg.mean()) for reading in readings])
    scale = tool.calibration.jaw_force_scale
    unit_scale = scale.model_copy(update={"value": 1.0, "low": 1.0, "high": 1.0})
    unscaled = tool.calibration.model_copy(update={FORCE_SCALE_KEY: unit_scale})
    jaws = compute_jaw_signals(
        tool.model_copy(update={"calibration": unscaled}), strain_v - strain_v[0], encoder_deg - encoder_deg[0]
    )
    if not jaws.valid.all():
        worst_n = known_n[int(np.argmin(jaws.valid))]
        raise CalibrationError(
            f"At {worst_n:g} N the linkage of the tool file cannot be where the encoder says: calibrate stretch and "
            "geometry before, and do not turn the tool off between the readings."
        )
    value, intercept_n, value_se = _fit_line(jaws.force_n, known_n)
    left_n = known_n - (intercept_n + value * jaws.force_n)
    worst = int(np.abs(left_n).argmax())
    if not value > 0 or abs(left_n[worst]) > MAX_SCALE_RESIDUAL_SHARE * float(np.ptp(known_n)):
        raise CalibrationError(
            f"The reading at {known_n[worst]:g} N is not in proportion to the others: the load cell shifted or was "
            "read wrong, or a joint rubs. Oil the joints, and repeat."
        )
    half = _compute_student_quantile(len(known_n) - 2) * value_se
    constant = FittedConstant(
        f"calibration.{FORCE_SCALE_KEY}",
        value,
        (value - half) * (1 - load_cell_error),
        (value + half) * (1 + load_cell_error),
        FORCE_SCALE_UNITS[scale.law],
        float(np.sqrt(np.mean(left_n**2))),
        "N",
        len(known_n),
    )
    _check_interval_width(constant, MAX_SCALE_INTERVAL_SHARE)
    along_n = np.array([jaws.force_n.min(), jaws.force_n.max()])
    return CalibrationFit(
        (constant,),
        (jaws.force_n, known_n),
        (along_n, intercept_n + value * along_n),
        (_FORCE_SCALE_AXES[scale.law], "force between the jaws by the load cell, N"),
    )


def check_jaw_forces(forces_n: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the forces between the jaws, N, as an array.

    Raises:
        CalibrationError: there are too few, or impossible ones, or the first one is not 0.
    """
    known_n = np.array(forces_n, float)
    if not np.isfinite(known_n).all() or (known_n < 0).any():
        raise CalibrationError("A force is a number of newtons that is not negative: correct the list.")
    if len(set(known_n.tolist())) < MIN_JAW_FORCES or known_n[0] != 0:
        raise CalibrationError(
            f"Give at least {MIN_JAW_FORCES} different forces, the first one 0: with open jaws and an untouched handle."
        )
    return known_n


@dataclass(frozen=True, slots=True)
class ForcePass:
    """Strain voltage, V, and encoder angle, degrees, while the force on shut jaws rose or fell; (n,) each."""

    strain_v: np.ndarray
    encoder_deg: np.ndarray


def fit_cable_stretch_lines(passes: Sequence[ForcePass], tool: Tool) -> list[tuple[float, float, float]]:
    """Fit the encoder's turn over the strain on shut jaws: slope (deg/V), value at zero, and its error, of each pass.

    Raises:
        CalibrationError: something yields between the jaws, the encoder slips, or the passes disagree.
    """
    if len(passes) < MIN_PASSES:
        raise CalibrationError(
            f"{len(passes)} passes with shut jaws are too few for a confidence interval: at least {MIN_PASSES}."
        )
    for each in passes:
        _check_numbers(each.strain_v, each.encoder_deg)
    lines = [_fit_line(each.strain_v, each.encoder_deg) for each in passes]
    slopes = np.array([slope for slope, _, _ in lines])
    value, sd = float(slopes.mean()), float(slopes.std(ddof=1))
    expected = tool.stretch_deg_per_volt
    found = f"The cable stretches by {value:.1f} deg/V"
    if expected and value < MIN_STRETCH_SHARE * expected:
        raise CalibrationError(
            f"{found}, the tool file says {expected:.1f}: the encoder slips on its shaft or loses counts. Fasten its "
            "coupling, see `graspwatch check`, and repeat."
        )
    if sd > MAX_PASS_SCATTER_SHARE * abs(value):
        raise CalibrationError(
            f"{found}, but scatters by {sd:.1f} from pass to pass: the jaws were not shut each time, or the encoder "
            "slips. Empty the jaws, and repeat."
        )
    bends = np.array([_compute_curvature_share(each) for each in passes])
    bend, bend_error = float(np.median(bends)), float(bends.std(ddof=1)) / np.sqrt(len(bends))
    if abs(bend) > MAX_CURVATURE_SHARE + 2.0 * bend_error:  # noise alone bends the line of a weak drive
        raise CalibrationError(
            f"{found}, and {abs(bend):.0%} {'less' if bend < 0 else 'more'} at the higher forces: something between "
            "the jaws yields, or they are not shut. Empty them, and repeat."
        )
    return lines


def fit_cable_stretch(passes: Sequence[ForcePass], tool: Tool) -> CalibrationFit:
    """Fit Eq. (3) on shut jaws: the encoder's turn per volt, as the mean of one slope a pass; raises as they do."""
    lines = fit_cable_stretch_lines(passes, tool)
    slopes = np.array([slope for slope, _, _ in lines])
    value, sd = float(slopes.mean()), float(slopes.std(ddof=1))
    half = _compute_student_quantile(len(passes) - 1) * sd / np.sqrt(len(passes))
    left_deg = np.concatenate(
        [each.encoder_deg - (at + slope * each.strain_v) for each, (slope, at, _) in zip(passes, lines, strict=True)]
    )
    constant = _build_slope_constant(
        "calibration.encoder_deg_per_volt", value, value - half, value + half, "deg/V", left_deg, "deg", len(passes)
    )
    strain_v = np.concatenate([each.strain_v for each in passes])
    turned_deg = np.concatenate([each.encoder_deg - at for each, (_, at, _) in zip(passes, lines, strict=True)])
    along_v = np.array([strain_v.min(), strain_v.max()])
    return CalibrationFit(
        (constant,),
        (strain_v, turned_deg),
        (along_v, value * along_v),
        ("strain gage over rest, V", "encoder beyond shut jaws, deg"),
    )


def check_has_linkage(tool: Tool, what: str) -> None:
    """Check that a tool has the constant that `calibrate strain`, `stretch` or `geometry` measures.

    Raises:
        CalibrationError: it has other kinematics than the Smart Tool's.
    """
    if not isinstance(tool.kinematics, SmartToolKinematics):
        raise CalibrationError(
            f"`calibrate {what}` is for the kinematics `smart_tool`; those of {tool.name!r} are "
            f"{tool.kinematics.kind!r}. Measure the constants of [kinematics] yourself, and write them into the file."
        )


def fit_geometry(gauges_m: Sequence[float] | np.ndarray, passes: Sequence[ForcePass], tool: Tool) -> CalibrationFit:
    """Fit the opening of the jaws and the ratio of handle to encoder, Eqs. (4) to (6), to gauges of known thickness.

    Args:
        gauges_m: thickness of each gauge; 0 for jaws shut on each other.
        passes: for each gauge the strain over rest and the encoder angle since open jaws, at several forces.

    Raises:
        CalibrationError: too few gauges, readings that do not follow them, or values outside the linkage's range.
    """
    from scipy.optimize import least_squares  # takes a while, and the service needs it only here

    thick_m = check_gauges(gauges_m)
    stretch_deg = tool.stretch_deg_per_volt
    turned_deg = np.array([float(np.mean(p.encoder_deg - stretch_deg * p.strain_v)) for p in passes])
    order = np.argsort(-thick_m, kind="stable")
    for thicker, thinner in pairwise(order):
        if thick_m[thicker] > thick_m[thinner] and not turned_deg[thicker] < turned_deg[thinner]:
            raise CalibrationError(
                f"The jaws shut no further on {thick_m[thinner] * 1e3:g} mm than on {thick_m[thicker] * 1e3:g} mm: a "
                "gauge was named wrong or lay askew. Repeat these two."
            )

    def travel_m(handle_per_encoder: float) -> np.ndarray:
        turning = tool.calibration.model_copy(update={"handle_per_encoder": handle_per_encoder})
        jaw = compute_jaw_signals(
            tool.model_copy(update={"calibration": turning}), np.zeros(len(turned_deg)), turned_deg.copy()
        )
        return jaw.displacement_m

    def left_m(unknown: np.ndarray) -> np.ndarray:
        return np.nan_to_num(unknown[1] * 1e-3 - thick_m - travel_m(unknown[0] * 1e-1), nan=1.0)

    begin = np.array(
        [
            tool.calibration.handle_per_encoder * 10,
            1e3 * float(thick_m.max() + travel_m(tool.calibration.handle_per_encoder).min()),
        ]
    )
    if not np.isfinite(begin).all():
        raise CalibrationError(
            "The encoder turned further than the linkage of the tool file can: check the scale of the encoder with "
            "`graspwatch check`."
        )
    solved = least_squares(left_m, begin)
    left, free = solved.fun, len(thick_m) - 2
    worst = int(np.abs(left).argmax())
    if abs(left[worst]) > MAX_GAUGE_RESIDUAL_M:
        raise CalibrationError(
            f"The gauge of {thick_m[worst] * 1e3:g} mm lies {left[worst] * 1e3:+.2f} mm off: it is named wrong, lay "
            "askew, or the linkage is not that of Table I. Repeat it."
        )
    variance = float(left @ left) / free * np.linalg.inv(solved.jac.T @ solved.jac)
    half = _compute_student_quantile(free) * np.sqrt(np.diag(variance)) * (1e-1, 1e-3)
    ratio, opening_m = solved.x * (1e-1, 1e-3)
    residual_m = float(np.sqrt(np.mean(left**2)))
    constants = tuple(
        FittedConstant(key, float(value), float(value - h), float(value + h), unit, residual_m, "m", len(thick_m))
        for key, value, h, unit in (
            ("calibration.handle_per_encoder", ratio, half[0], "deg/deg"),
            ("geometry.opening_m", opening_m, half[1], "m"),
        )
    )
    for each in constants:
        _check_interval_width(each)
    along = np.argsort(turned_deg)
    return CalibrationFit(
        constants,
        (turned_deg, thick_m * 1e3),
        (turned_deg[along], (opening_m - travel_m(ratio)[along]) * 1e3),
        ("encoder since open jaws, without stretch, deg", "gauge between the jaws, mm"),
    )


def check_gauges(gauges_m: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the thicknesses of the gauges, m, as an array.

    Raises:
        CalibrationError: there are too few, or impossible ones.
    """
    thick_m = np.array(gauges_m, float)
    if len(set(thick_m.tolist())) < MIN_GAUGES or (thick_m < 0).any() or not np.isfinite(thick_m).all():
        raise CalibrationError(f"At least {MIN_GAUGES} gauges of different thickness are needed, 0 for empty jaws.")
    return thick_m


def _build_slope_constant(
    key: str, value: float, low: float, high: float, unit: str, left: np.ndarray, residual_unit: str, readings: int
) -> FittedConstant:
    residual = float(np.sqrt(np.mean(left**2)))
    constant = FittedConstant(key, float(value), float(low), float(high), unit, residual, residual_unit, readings)
    _check_interval_width(constant)
    return constant


def _check_interval_width(constant: FittedConstant, max_share: float = MAX_INTERVAL_SHARE) -> None:
    if not constant.interval_half_width_share <= max_share:
        raise CalibrationError(
            f"`{constant.key}` comes out as {constant.value:.4g} {constant.unit}, known only to within "
            f"{constant.interval_half_width_share:.1%}, and more than {max_share:.0%} are too many: take more "
            "readings, over a wider range."
        )


def check_steady(reading: RawSignals, which: str, tool: Tool) -> None:
    """Check one reading under a known pull.

    Raises:
        CalibrationError: the gage is not still, or not sound.
    """
    _check_numbers(reading.strain_v, reading.encoder_deg)
    most_v = compute_noise_range_v(tool)[1]
    sd_v = float(reading.strain_v.std())
    if sd_v > most_v:
        raise CalibrationError(
            f"At {which} the strain gage scatters by {sd_v * 1e3:.1f} mV, a steady one by at most "
            f"{most_v * 1e3:.1f} mV: let the weight come to rest, check the cable, and repeat."
        )
    if np.abs(reading.strain_v).max() > SATURATION_SHARE * tool.channels.analog_range_v:
        raise CalibrationError(
            f"At {which} the strain gage is at the end of its range: a cable is loose, or the weight is too large."
        )


def _check_numbers(*signals: np.ndarray) -> None:
    if not all(np.isfinite(signal).all() for signal in signals):
        raise CalibrationError("A sensor gives no number: check its cable with `graspwatch check`, and repeat.")


def _compute_curvature_share(each: ForcePass) -> float:
    """Return the change of slope between the middles of both halves of the strain, as a share of the slope."""
    middle_v, half_v = (each.strain_v.max() + each.strain_v.min()) / 2, np.ptp(each.strain_v) / 2
    quadratic, slope, _ = np.polyfit((each.strain_v - middle_v) / half_v, each.encoder_deg, 2)
    return float(2 * quadratic / slope) if slope else 0.0


def _fit_line(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Return slope, value at zero, and standard error of the slope of the least-squares line."""
    centred = x - x.mean()
    slope = float(centred @ y / (centred @ centred))
    at_zero = float(y.mean() - slope * x.mean())
    left = y - (at_zero + slope * x)
    error = float(np.sqrt(left @ left / max(len(x) - 2, 1) / (centred @ centred)))
    return slope, at_zero, error


def _compute_student_quantile(freedom: int) -> float:
    """Return Student's t for a two-sided interval."""
    from scipy.special import stdtrit  # takes a while, and the service needs it only here

    return float(stdtrit(freedom, (1 + CONFIDENCE) / 2))
