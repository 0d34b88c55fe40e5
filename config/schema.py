"""Typed shape of every configuration file. Units stand in the names; unknown keys are refused."""

import datetime
import hashlib
import ipaddress
import json
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    SecretStr,
    Tag,
    field_validator,
    model_validator,
)

from config.errors import ConfigurationError
from config.network import is_loopback, parse_authority

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Probability = Annotated[float, Field(gt=0, lt=1)]
Slug = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_]*$")]
NameTuple = Annotated[tuple[str, ...], Field(strict=False)]  # an array, also behind a validator that comes before
GrpcAddress = Annotated[str, Field(pattern=r"^([A-Za-z0-9.-]+|\[[0-9a-fA-F:]+\]):\d{1,5}$")]


class ConfigModel(BaseModel):
    """Base of all configuration: immutable, no unknown keys, no silent conversion of text to numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


# --- tools -----------------------------------------------------------------------------------------------------------


class ToolKind(StrEnum):
    SIMULATED = "simulated"
    NIDAQ = "nidaq"
    RECORDING = "recording"


class Board(ConfigModel):
    """The NI board: one hardware-timed clock for the analog inputs and the encoder."""

    device: str = "Dev1"
    """The board's name in NI MAX."""
    product: str = "PCI-6230"
    """What the board has to be; `graspwatch check` compares."""
    sample_rate_hz: Positive = 1000.0
    """Samples a second of every channel; the estimator is tuned for 1000."""
    block_samples: Annotated[int, Field(ge=1, le=100)] = 5
    """Samples that are read, judged and answered together."""
    grpc_address: GrpcAddress | None = None
    """`host:port` of an NI gRPC device server that has the board, instead of the driver of this computer. On another
    computer the connection has to be encrypted: name `grpc_ca`."""
    grpc_ca: str | None = None
    """Certificate (PEM file) that the device server's is checked against; with it the connection is encrypted."""
    grpc_cert: str | None = None
    """This computer's own certificate (PEM file), where the server asks for one; with `grpc_key`."""
    grpc_key: str | None = None
    """Key (PEM file) of `grpc_cert`."""

    @model_validator(mode="after")
    def _is_encrypted(self) -> Self:
        if bool(self.grpc_cert) != bool(self.grpc_key):
            raise ValueError("grpc_cert and grpc_key belong together: name both or none")
        if (self.grpc_ca or self.grpc_cert) and not self.grpc_address:
            raise ValueError("certificates are for a board that is reached by grpc_address: name it, or leave them out")
        if self.grpc_cert and not self.grpc_ca:
            raise ValueError("grpc_cert is shown to a server that grpc_ca vouches for: name that, too")
        if self.grpc_address and not self.grpc_ca and not is_loopback(self.grpc_address.rpartition(":")[0]):
            raise ValueError(
                "anybody on the way could drive the motor of a board that is reached in the clear: name the server's "
                "certificate in grpc_ca, or use an address of this computer"
            )
        return self


class Channels(ConfigModel):
    """Physical channels without the device name, e.g. `ai0`."""

    strain: str = "ai0"
    """Amplified strain gage."""
    motor_command_readback: str = "ai2"
    """The motor command, wired back from `motor_command`."""
    touch: tuple[str, str] = ("ai3", "ai1")
    """Touch sensors of the two jaws; on analog inputs, as the digital lines of the PCI-6230 have no clock."""
    encoder: str = "ctr0"
    """Counter with the quadrature encoder."""
    motor_command: str = "ao0"
    """Motor command to the amplifier."""
    analog_range_v: Positive = 10.0
    """Inputs span ± this, V; one of the board's ranges."""


class Geometry(ConfigModel):
    """Link lengths and angle of the grasper, Table I of the paper."""

    r_pp_m: Positive
    """Pitch radius of the pulley, m."""
    a_m: Positive
    """Lever from the handle's axis to the push rod, m."""
    l0_m: Positive
    """L0 of the linkage with the jaws open, m."""
    l1_m: Positive
    """L1 of the linkage, m."""
    l2_m: Positive
    """L2 of the linkage, m."""
    l_jaw_m: Positive
    """From the jaw's axis to where it grasps, m."""
    beta0_deg: Positive
    """Angle of the linkage with the jaws open, degrees."""
    opening_m: Positive | None = None
    """Gap between the open jaws, m: the encoder's zero. Without it thickness is no evidence. `calibrate geometry`."""


class ConstantMeasurement(ConfigModel):
    """How a constant of the tool file was measured: by `graspwatch calibrate`."""

    constant: Slug
    """Its key in the file."""
    value: Finite
    """The constant, in `unit`."""
    low: Finite
    """Lower end of its 95 % confidence interval."""
    high: Finite
    """Upper end of it."""
    unit: str
    """Of the three."""
    residual: NonNegative
    """What the fit leaves (RMS), in `residual_unit`."""
    residual_unit: str
    """Of the residual."""
    readings: Annotated[int, Field(ge=1)]
    """How many readings were fitted."""
    date: datetime.date
    """Day of the measurement."""
    person: str
    """Who measured."""
    expires: datetime.date
    """From this day on it is to be measured anew."""


EQ2_MIN_SCALE, EQ2_MAX_SCALE = 0.05, 1.0
"""Scales that the paper allows: a constant 0.59 N/V where Eq. (2) gives 12 N/V, and the equation as printed."""


class ForceScale(ConfigModel):
    """The scale of newtons: jaw force is Eq. (2) times this. A calibration value with an interval."""

    value: Positive
    """What forces on the screen, in files and in reports are Eq. (2) times."""
    low: Positive
    """Least that the scale may be."""
    high: Positive
    """Most that it may be: limiter, force ceiling and force alarms reckon with it."""
    measured: bool
    """Whether it was measured on this tool, against a reference between the jaws. Only then a real tool is armed, or by
    an admin's override."""
    source: Annotated[str, Field(min_length=1)]
    """How it was measured, or whose assumption it is."""
    date: datetime.date | None = None
    """Day of the measurement."""
    expires: datetime.date | None = None
    """From this day on it is to be measured anew."""

    @model_validator(mode="after")
    def _is_an_interval(self) -> Self:
        if not self.low <= self.value <= self.high:
            raise ValueError(f"low <= value <= high must hold (found {self.low:g}, {self.value:g}, {self.high:g})")
        if self.measured and self.date is None:
            raise ValueError("a measured scale needs the date of its measurement")
        return self


def _add_default_interval(scale: ForceScale | float) -> ForceScale:
    """The scale of a tool file that states a number alone: not measured, and nothing narrows its interval."""
    if isinstance(scale, ForceScale):
        return scale
    return ForceScale(
        value=scale,
        low=min(scale, EQ2_MIN_SCALE),
        high=max(scale, EQ2_MAX_SCALE),
        measured=False,
        source="a tool file that states no interval",
    )


def _choose_scale_tag(given: Any) -> str:
    return "number" if isinstance(given, int | float) and not isinstance(given, bool) else "table"


ForceScaleOrNumber = Annotated[
    Annotated[ForceScale, Tag("table")] | Annotated[Positive, Tag("number")],
    Discriminator(_choose_scale_tag),
    AfterValidator(_add_default_interval),
]


class ToolCalibration(ConfigModel):
    """Eqs. (1), (3) and (5), and the rest voltage that is tared away.

    Date, person and expiry are those of the constants that have no table of their own in `measured`.
    """

    newton_per_volt: Positive
    """Pull on the handle for each volt of the strain gage over rest, Eq. (1). `calibrate strain`."""
    encoder_deg_per_volt: NonNegative
    """How far the cable's stretch turns the encoder for each volt, Eq. (3). `calibrate stretch`."""
    handle_per_encoder: Positive
    """Degrees of the handle for each of the encoder, Eq. (5). `calibrate geometry`."""
    jaw_force_scale: ForceScaleOrNumber = _add_default_interval(1.0)
    """Jaw force is Eq. (2) times this. A number alone is one that was not measured."""
    rest_offset_v: Finite
    """What the strain gage reads at rest, V. `calibrate tare`."""
    rest_tolerance_v: Positive
    """A rest voltage further off is not taken for a tare, V."""
    encoder_counts_per_rev: Annotated[int, Field(gt=0)]
    """Pulses of the encoder for each turn of its shaft; each counts four times."""
    encoder_gear_ratio: Positive
    """Turns of the encoder's shaft for each of the gearbox."""
    date: str
    """Day on which the constants were measured that are not in `measured`."""
    person: str
    """Who measured them."""
    expires: datetime.date | None = None
    """From this day on they are to be measured anew."""
    measured: tuple[ConstantMeasurement, ...] = ()
    """How constants were measured: one table each, with its own date and expiry."""

    def is_rest_voltage(self, strain_v: float) -> bool:
        """Whether the gage may read that at rest; False for NaN."""
        return abs(strain_v - self.rest_offset_v) <= self.rest_tolerance_v

    @property
    def encoder_resolution_deg(self) -> float:
        """Degrees after the gearbox for one quadrature count."""
        return 360.0 / (self.encoder_counts_per_rev * 4 * self.encoder_gear_ratio)


class SensorNoise(ConfigModel):
    """What one raw sample scatters by; the estimator's noise model and the simulated board's noise."""

    strain_sd_v: Positive
    """Standard deviation of the strain gage at rest, V. `calibrate tare`."""
    strain_lsb_v: NonNegative
    """Step of the converter, V."""

    @property
    def strain_var_v2(self) -> float:
        """Variance of one sample, V²: noise, and rounding to the converter's step."""
        return self.strain_sd_v**2 + self.strain_lsb_v**2 / 12


class ToolLimits(ConfigModel):
    """Hard bounds of the tool, kept by the acquisition worker itself."""

    max_command_v: Positive
    """Highest motor command, V."""
    max_command_v_per_s: Positive = 60.0
    """Fastest rise of it, V/s; down to zero nothing is ever slowed."""
    force_ceiling_n: Positive
    """Jaw force over which a run ends with a fault, N."""
    max_run_s: Positive
    """Longest run, s."""


class CommandToForce(ConfigModel):
    """Static map from motor command to jaw force, linear between the points and beyond the last."""

    command_v: tuple[NonNegative, ...]
    """Motor commands, V, rising from 0."""
    force_n: tuple[NonNegative, ...]
    """Jaw force at each, N, rising from 0."""

    @model_validator(mode="after")
    def _rises_from_zero(self) -> Self:
        if len(self.command_v) != len(self.force_n) or len(self.command_v) < 2:
            raise ValueError("command_v and force_n need the same number of points, at least two")
        if self.command_v[0] != 0 or self.force_n[0] != 0:
            raise ValueError("both maps must begin at 0")
        if any(np.diff(self.command_v) <= 0) or any(np.diff(self.force_n) <= 0):
            raise ValueError("both maps must rise strictly")
        return self

    def to_force_n(self, command_v: np.ndarray | float) -> np.ndarray:
        return _interpolate_beyond(command_v, self.command_v, self.force_n)

    def to_command_v(self, force_n: np.ndarray | float) -> np.ndarray:
        return _interpolate_beyond(force_n, self.force_n, self.command_v)


def _interpolate_beyond(at: np.ndarray | float, xs: tuple[float, ...], ys: tuple[float, ...]) -> np.ndarray:
    """Linear interpolation that goes on with the last slope beyond the last point."""
    slope = (ys[-1] - ys[-2]) / (xs[-1] - xs[-2])
    return np.interp(at, xs, ys) + slope * np.maximum(np.asarray(at, float) - xs[-1], 0.0)


class ContactDetection(ConfigModel):
    """How contact with tissue and shut jaws are told."""

    touch_trusted: bool
    """Whether the touch sensors tell contact; else the force does."""
    touch_threshold_v: Positive = 2.5
    """A touch sensor over this senses contact, V."""
    force_rise_v: Positive
    """Rise of the strain gage that tells contact, V."""
    force_rise_samples: Annotated[int, Field(ge=1)] = 8
    """So many samples in a row have to show it."""
    wall_above_v: Positive
    """Jaws are not taken for shut below this strain, V."""
    wall_span_v: Positive
    """Rise of strain over which the slope of shut jaws is measured, V."""
    wall_slack_deg_per_volt: Positive
    """Encoder travel beyond the cable's stretch that shut jaws may still show, degrees a volt."""
    slip_share: Probability
    """An encoder that moves by less than this share of the cable's stretch slips."""
    walk_deg: Positive
    """An encoder whose rest moves by more than this between grasps walks, degrees."""


class SensorPlausibility(ConfigModel):
    """What the sensors of a sound tool stay within: beyond it the force or the jaws are not known.

    The defaults are for the Smart Tool as recorded in 2013, whose own vibration comes to 0.25 V in 3 ms.
    """

    strain_step_v: Positive = 0.4
    """Jump between the medians of three samples and the next three, V."""
    strain_scatter_v: Positive = 0.35
    """Second difference of the noise, the median of ten, V."""
    strain_below_rest_v: Positive = 1.2
    """How far below rest the gage may read, V."""
    rest_drift_v: Positive = 0.8
    """How far the rest may move between grasps, V."""
    encoder_step_deg: Positive = 2.0
    """From sample to sample, degrees."""
    encoder_back_deg: Positive = 25.0
    """In a grasp, behind its beginning, without the cable's stretch, degrees."""
    encoder_stuck_v: Positive = 0.04
    """Change of strain while the encoder does not move by a count, V."""


class GrasperMechanics(ConfigModel):
    """Mechanics that the simulated tool adds to the tissue: drive lag, free travel, opening."""

    drive_lag_s: Positive
    """Time constant from motor command to drive force, s."""
    contact_lag_s: Positive
    """Time constant from drive force to the force on the tissue, s."""
    free_drag_kg_per_s: Positive
    """Drag of the jaws that touch nothing, kg/s."""
    free_travel_m: Positive
    """The jaws move at least so far before they touch, m."""
    opening_time_s: Positive
    """Time constant of the return spring, s."""
    spread_scale: NonNegative = 1.0
    """Scatter of the specimens, times the library's."""


CALIBRATION_UNIT_KEYS = ("newton_per_volt", "encoder_deg_per_volt", "handle_per_encoder")

CALIBRATION_COMMANDS = {
    "newton_per_volt": "strain",
    "encoder_deg_per_volt": "stretch",
    "handle_per_encoder": "geometry",
    "opening_m": "geometry",
    "rest_offset_v": "tare",
    "strain_sd_v": "tare",
}
"""Constants of a tool file, and which `graspwatch calibrate` measures each."""
FORCE_SCALE_KEY = "jaw_force_scale"


@dataclass(frozen=True, slots=True)
class ConstantOrigin:
    """When a constant of the tool file was measured, by whom, and from which day on it is to be measured anew."""

    constant: str
    value: float
    date: str
    person: str
    expires: datetime.date | None

    def is_expired(self, today: datetime.date) -> bool:
        return self.expires is not None and today >= self.expires


class Tool(ConfigModel):
    """A tool file: board, channels, geometry, calibration, noise, limits."""

    name: Slug
    """Short name, in recordings and in the journal."""
    title: str
    """Name for people."""
    kind: ToolKind
    """`simulated`; `nidaq`: a board behind NI-DAQmx; `recording`: only for reading recordings."""
    board: Board = Board()
    channels: Channels = Channels()
    geometry: Geometry
    calibration: ToolCalibration
    noise: SensorNoise
    limits: ToolLimits
    command_to_force: CommandToForce
    contact: ContactDetection
    plausible: SensorPlausibility = SensorPlausibility()
    simulation: GrasperMechanics | None = None

    @property
    def calibration_fingerprint(self) -> str:
        """16 hexadecimal digits of what turns volts and degrees into forces and travel: a learned library's units."""
        calibration = self.calibration.model_dump(include=set(CALIBRATION_UNIT_KEYS))
        calibration[FORCE_SCALE_KEY] = self.calibration.jaw_force_scale.value
        geometry = self.geometry.model_dump(exclude={"opening_m"})
        simulated = self.kind is ToolKind.SIMULATED  # its drive and jaws are no real tool's, whatever its constants
        content = json.dumps([simulated, calibration, geometry, self.board.sample_rate_hz], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    @property
    def max_force_factor(self) -> float:
        """How many times the shown force the true one may be: upper end of the scale's interval over its value.

        Exactly 1 for a simulated tool, whose jaws and sensors are made with the same scale.
        """
        scale = self.calibration.jaw_force_scale
        return 1.0 if self.kind is ToolKind.SIMULATED else scale.high / scale.value

    def to_displayed_n(self, jaw_force_n: float) -> float:
        """The shown force at which the true one may be `jaw_force_n` already, N: what protects tissue acts there."""
        return jaw_force_n / self.max_force_factor

    @property
    def has_known_scale(self) -> bool:
        """Whether the motor may be armed: newtons are measured, simulated, or move nothing."""
        return self.kind is not ToolKind.NIDAQ or self.calibration.jaw_force_scale.measured

    @property
    def scale_text(self) -> str:
        """By which scale newtons are told, for people."""
        scale = self.calibration.jaw_force_scale
        value, low, high = (float(f"{each:.3g}") for each in (scale.value, scale.low, scale.high))
        if self.kind is ToolKind.SIMULATED:
            return f"N by Eq. (2), scale exactly {value}: simulated"
        how = f"measured {scale.date}" if scale.measured else "not measured"
        return f"N by Eq. (2), scale {value} ({low} to {high}), {how}"

    @property
    def constant_origins(self) -> tuple[ConstantOrigin, ...]:
        """The age of every constant that a calibration measures; what has no date of its own has the file's."""
        calibration, scale = self.calibration, self.calibration.jaw_force_scale
        own = {how.constant: how for how in calibration.measured}
        values = calibration.model_dump(include=set(CALIBRATION_COMMANDS))
        values |= {"opening_m": self.geometry.opening_m, "strain_sd_v": self.noise.strain_sd_v}
        ages = []
        for name in CALIBRATION_COMMANDS:
            how = own.get(name)
            date, person, expires = (
                (how.date.isoformat(), how.person, how.expires)
                if how
                else (calibration.date, calibration.person, calibration.expires)
            )
            if values[name] is not None:
                ages.append(ConstantOrigin(name, values[name], date, person, expires))
        date = scale.date.isoformat() if scale.date else calibration.date
        expires = None if self.kind is ToolKind.SIMULATED else scale.expires or calibration.expires
        ages.append(ConstantOrigin(FORCE_SCALE_KEY, scale.value, date, scale.source, expires))
        return tuple(ages)

    def find_expired_constants(self, today: datetime.date) -> list[ConstantOrigin]:
        """Constants that are to be measured anew."""
        return [each for each in self.constant_origins if each.is_expired(today)]

    @model_validator(mode="after")
    def _simulated_has_mechanics(self) -> Self:
        if self.kind is ToolKind.SIMULATED and self.simulation is None:
            raise ValueError("a tool of kind 'simulated' needs a [simulation] table")
        return self


# --- tissues ---------------------------------------------------------------------------------------------------------


class ParameterSpread(ConfigModel):
    """Standard deviations of the natural logarithms of the parameters from specimen to specimen."""

    log_alpha: Positive
    log_beta: Positive
    log_damping: Positive
    log_thickness: Positive = 0.2


class LearnedRecording(ConfigModel):
    """One recording that a tissue was learned from."""

    file: str
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    grasps: Annotated[int, Field(ge=1)]  # that were learned from
    left_out: tuple[str, ...] = ()  # grasps that were not, and why
    ramp_v_per_s: Positive
    centre: tuple[Finite, ...] = Field(min_length=1)  # of `Learned.features`


class LearnedTissue(ConfigModel):
    """What recordings say of a tissue, in the units of their tool's calibration."""

    grasps: Annotated[int, Field(ge=1)]
    log_covariance: tuple[tuple[Finite, ...], ...]  # of log alpha, log beta, log d, log thickness from grasp to grasp
    contact_measured: bool  # whether thickness is; else it is the base library's, and so is its spread
    loading_covariance: tuple[tuple[Finite, ...], ...]  # of the loading curve's features within a recording
    recordings: tuple[LearnedRecording, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _are_covariances(self) -> Self:
        for name, size in (("log_covariance", 4), ("loading_covariance", len(self.recordings[0].centre))):
            _check_covariance(name, getattr(self, name), size)
        return self


def _check_covariance(name: str, rows: tuple[tuple[float, ...], ...], size: int) -> None:
    if len(rows) != size or any(len(row) != size for row in rows):
        raise ValueError(f"{name} needs {size} rows of {size} numbers")
    matrix = np.array(rows)
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-12):
        raise ValueError(f"{name} is not symmetric, so it is no covariance; learn the library anew")
    scale = np.sqrt(np.abs(np.diag(matrix)))
    if not np.all(scale > 0) or np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min() < 1e-9:
        raise ValueError(
            f"{name} is singular or not positive definite: some combination of its quantities would be known without "
            "error; learn the library anew, from more grasps"
        )


LOADING_FEATURES = ("opening", "force_40deg", "force_5deg", "knee", "lean", "stall", "yield", "give")


class LearnedLibrary(ConfigModel):
    """Where a library was learned, and what all of its tissues share."""

    date: str
    base: str  # library that injury thresholds, mass and jaw area come from
    tool: str
    calibration: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]  # of the tool, see `Tool.calibration_fingerprint`
    features: tuple[str, ...] = Field(min_length=1)
    usual_peak_v: Positive  # of the strain gage over rest; shares of force refer to it
    session_scale: Positive  # from recording to recording of one tissue, in stated units; see docs/learning.md

    @model_validator(mode="after")
    def _are_the_features(self) -> Self:
        if self.features != LOADING_FEATURES:
            raise ValueError(
                f"features are not {', '.join(LOADING_FEATURES)}: another version learned this library; learn it anew"
            )
        return self


class TissueProfile(ConfigModel):
    """u = m x'' + d x' + alpha (exp(beta x) - 1), Eq. (7), and the pressure that injures."""

    title: str
    alpha_n: Positive
    beta_per_m: Positive
    damping_kg_per_s: Positive
    thickness_m: Positive
    threshold_pa: Positive
    spread: ParameterSpread | None = None
    learned: LearnedTissue | None = None


class TissueLibrary(ConfigModel):
    """Tissue profiles that are told apart from each other."""

    name: Slug
    title: str
    source: str
    mass_kg: Positive
    jaw_area_m2: Positive
    spread: ParameterSpread
    learned: LearnedLibrary | None = None
    tissues: dict[Slug, TissueProfile] = Field(min_length=1)

    @model_validator(mode="after")
    def _reserved_names(self) -> Self:
        taken = {"unknown", "undecided"} & set(self.tissues)
        if taken:
            raise ValueError(f"{', '.join(sorted(taken))}: reserved, give the tissue another name")
        return self

    @model_validator(mode="after")
    def _learned_throughout(self) -> Self:
        told = [name for name, profile in self.tissues.items() if profile.learned]
        if self.learned is None and told:
            raise ValueError(f"{', '.join(told)}: learned, but the library has no [learned] table; learn it anew")
        if self.learned is None:
            return self
        missing = [name for name in self.tissues if name not in told]
        if missing:
            raise ValueError(f"{', '.join(missing)}: not learned as the others are; learn all tissues together")
        for name, profile in self.tissues.items():
            for recording in profile.learned.recordings if profile.learned else ():
                if len(recording.centre) != len(self.learned.features):
                    raise ValueError(f"{name}, {recording.file}: centre needs one number for each of learned.features")
        return self

    def check_tool(self, tool: Tool) -> None:
        """Refuse a tool with another calibration than the library was learned with.

        Raises:
            ConfigurationError: what was learned is in the units of another calibration.
        """
        if self.learned and self.learned.calibration != tool.calibration_fingerprint:
            raise ConfigurationError(
                f"The library {self.name!r} was learned with the tool {self.learned.tool!r} as it was calibrated then "
                f"({self.learned.calibration}); {tool.name!r} is calibrated otherwise ({tool.calibration_fingerprint}) "
                "and gives other numbers of the same tissue. Name that tool with --tool, or learn a library from "
                "recordings of this one."
            )

    def spread_of(self, tissue: str) -> ParameterSpread:
        return self.tissues[tissue].spread or self.spread

    def threshold_n(self, tissue: str) -> float:
        """Force at which injury begins: threshold pressure times jaw area, N."""
        return self.tissues[tissue].threshold_pa * self.jaw_area_m2

    def displayed_thresholds_n(self, tool: Tool) -> dict[str, float]:
        """The shown force of `tool` at which each tissue may be injured already, N."""
        return {name: tool.to_displayed_n(self.threshold_n(name)) for name in self.tissues}

    @property
    def lowest_threshold_n(self) -> float:
        return min(self.threshold_n(name) for name in self.tissues)


# --- protocols -------------------------------------------------------------------------------------------------------


class TrapezoidWaveform(ConfigModel):
    """Ramp up, hold, ramp down, rest, as motor command."""

    shape: Literal["trapezoid"]
    peak_v: Positive
    ramp_up_s: Positive
    hold_s: NonNegative
    ramp_down_s: Positive
    rest_s: Positive

    @property
    def grasp_s(self) -> float:
        return self.ramp_up_s + self.hold_s + self.ramp_down_s

    @property
    def cycle_s(self) -> float:
        return self.grasp_s + self.rest_s


class SineWaveform(ConfigModel):
    """Raised cosine of force, A/2 (1 - cos 2 pi f t): the first cycle slow, the rest fast, then rest."""

    shape: Literal["sine"]
    peak_n: Positive
    first_hz: Positive
    then_hz: Positive
    then_cycles: Annotated[int, Field(ge=0)]
    rest_s: Positive

    @property
    def grasp_s(self) -> float:
        return 1.0 / self.first_hz + self.then_cycles / self.then_hz

    @property
    def cycle_s(self) -> float:
        return self.grasp_s + self.rest_s


class CustomWaveform(ConfigModel):
    """Straight lines between points of motor command over time; begins and ends at 0 V."""

    shape: Literal["custom"]
    time_s: tuple[NonNegative, ...] = Field(min_length=3)
    command_v: tuple[NonNegative, ...] = Field(min_length=3)
    rest_s: Positive

    @model_validator(mode="after")
    def _is_a_waveform(self) -> Self:
        if len(self.time_s) != len(self.command_v):
            raise ValueError("time_s and command_v need the same number of points")
        if self.time_s[0] != 0 or any(np.diff(self.time_s) <= 0):
            raise ValueError("time_s must begin at 0 and rise strictly")
        if self.command_v[0] != 0 or self.command_v[-1] != 0:
            raise ValueError("command_v must begin and end at 0")
        return self

    @property
    def grasp_s(self) -> float:
        return self.time_s[-1]

    @property
    def cycle_s(self) -> float:
        return self.grasp_s + self.rest_s


class GraspProtocol(ConfigModel):
    """A named waveform and how often it is repeated unless told otherwise."""

    name: Slug
    title: str
    lead_in_s: Annotated[float, Field(ge=0.25, le=60)] = 0.5
    cycles: Annotated[int, Field(ge=1, le=10_000)] = 1
    waveform: Annotated[TrapezoidWaveform | SineWaveform | CustomWaveform, Field(discriminator="shape")]


# --- the service -----------------------------------------------------------------------------------------------------


class ServerSettings(ConfigModel):
    """Where the service listens, by which names it is asked, and how much it takes.

    `hosts` are names beside localhost, 127.0.0.1, [::1] and the address that it listens on. Where there are tokens and
    no `hosts`, any name will do. `trusted_proxies` are addresses or networks whose `X-Forwarded-Proto` is believed.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8000
    hosts: NameTuple = ()
    trusted_proxies: NameTuple = ()
    frame_rate_hz: Annotated[float, Field(gt=0, le=100)] = 30.0
    max_viewers: Annotated[int, Field(ge=1)] = 100
    history_s: Positive = 10.0
    chart_window_frames: Annotated[int, Field(ge=1)] = 8
    tls_cert: str | None = None
    tls_key: str | None = None
    requests_per_s: Positive = 100.0
    burst_requests: Annotated[int, Field(ge=1)] = 500
    most_body_bytes: Annotated[int, Field(ge=1000)] = 65_536
    most_connections: Annotated[int, Field(ge=10)] = 500

    @model_validator(mode="before")
    @classmethod
    def _no_admin_token_file(cls, given: Any) -> Any:
        if isinstance(given, dict) and "admin_token_file" in given:
            if given["admin_token_file"] is not None:
                raise ValueError(
                    "admin_token_file is a thing of the past: leave it out, and give each admin a token of his own "
                    "with `graspwatch token add NAME --role admin`"
                )
            return {key: value for key, value in given.items() if key != "admin_token_file"}
        return given

    @field_validator("hosts")
    @classmethod
    def _names(cls, hosts: tuple[str, ...]) -> tuple[str, ...]:
        parsed = [parse_authority(host) for host in hosts]
        for host, each in zip(hosts, parsed, strict=True):
            if each is None or each.port is not None:
                raise ValueError(f"{host!r} is no name: write it as in `grasp.example` or `[::1]`, without a port")
        return tuple(each.host for each in parsed if each)

    @field_validator("trusted_proxies")
    @classmethod
    def _networks(cls, proxies: tuple[str, ...]) -> tuple[str, ...]:
        for proxy in proxies:
            try:
                ipaddress.ip_network(proxy)
            except ValueError:
                raise ValueError(f"{proxy!r} is no address: write it as in `10.0.0.5` or `10.0.0.0/24`") from None
        return proxies

    @model_validator(mode="after")
    def _certificate_and_key(self) -> Self:
        if (self.tls_cert is None) != (self.tls_key is None):
            raise ValueError("tls_cert and tls_key go together: set both or neither")
        return self


class PeopleSettings(ConfigModel):
    """How long a browser stays signed in without a sign of life, and an operator in control without doing anything."""

    session_idle_s: Positive = 3600.0
    control_expires_s: Positive = 600.0


class ConditioningSettings(ConfigModel):
    """The paper's low-pass for what people look at: 2nd-order Butterworth at 10 Hz."""

    butterworth_order: Annotated[int, Field(ge=1, le=4)] = 2
    butterworth_cutoff_hz: Positive = 10.0


class IdentificationSettings(ConfigModel):
    """When a tissue is named, and what is believed before any data."""

    decide_at: Probability = 0.95
    withdraw_below: Probability = 0.85
    confirm_s: NonNegative = 0.03
    prior_unknown: Probability = 0.05
    use_thickness: bool = True
    unknown_spread_log: Positive = 2.5
    convergence_error: Probability = 0.15

    @model_validator(mode="after")
    def _hysteresis(self) -> Self:
        if self.withdraw_below >= self.decide_at:
            raise ValueError("withdraw_below must be lower than decide_at")
        return self


class ArmingSettings(ConfigModel):
    """Arming takes a tare and a self-test at rest; with `arm_with_start` a start does it where nobody has before.

    A run ends with the motor at zero once its server has been silent for `server_silence_s`: STOP comes through it.
    """

    arm_with_start: bool = True
    server_silence_s: Annotated[float, Field(ge=0.3, le=10.0)] = 1.0


class LimiterSettings(ConfigModel):
    """Where the force is held: a share of the injury threshold in force.

    The threshold that the estimator tells counts for `limit_expires_s`; after that it is the library's lowest.
    """

    margin: Probability = 0.8
    limit_expires_s: Positive = 0.1


class RecordingSettings(ConfigModel):
    """What is kept of every run. Nothing is recorded where fewer than `least_free_bytes` are free.

    A deleted recording stays in the bin for `keep_deleted_days`.
    """

    enabled: bool = True
    before_s: Annotated[float, Field(ge=0, le=60)] = 5.0
    after_s: Annotated[float, Field(ge=0, le=60)] = 1.0
    least_free_bytes: Annotated[int, Field(ge=0)] = 200_000_000
    demonstrations_kept: Annotated[int, Field(ge=0)] = 12
    keep_deleted_days: Annotated[float, Field(ge=0, le=36_500)] = 30.0


class WarningSettings(ConfigModel):
    """Shares of the threshold in force at which low, medium and high warnings begin, and their hysteresis."""

    low: Probability = 0.7
    medium: Probability = 0.9
    high: Annotated[float, Field(gt=0, le=1)] = 1.0
    hysteresis: Probability = 0.05

    @model_validator(mode="after")
    def _rise(self) -> Self:
        if not self.low < self.medium < self.high:
            raise ValueError("low < medium < high must hold")
        return self


class RealtimeSettings(ConfigModel):
    """What acquisition, estimator and guard ask the system for; what it grants is told, and the rest goes without."""

    priority: bool = True  # SCHED_FIFO; for server and recorder, too
    lock_memory: bool = False  # mlockall: nothing of them is ever paged out
    cores: tuple[Annotated[int, Field(ge=0)], ...] = ()  # acquisition on the first, estimator on the next, in turn
    freeze_garbage: bool = True  # Python's collector stays out of the way


class LogFormat(StrEnum):
    TEXT = "text"
    JSON = "json"


class LogSettings(ConfigModel):
    """What is said on the error output; more of it is kept in `logs/` of the data folder, as JSON lines."""

    level: Literal["info", "warning", "error"] = "warning"
    format: LogFormat = LogFormat.TEXT
    keep: bool = True


class FoxgloveSettings(ConfigModel):
    """The live stream for Foxglove, Lichtblick and the like. They cannot sign in: this computer's programs only."""

    port: Annotated[int, Field(ge=1, le=65535)] | None = None


class Settings(ConfigModel):
    """`graspwatch.toml`: everything of the service that is not a tool, a library or a protocol."""

    tool: str = "simulated"
    library: str = "porcine"
    data_folder: str = "graspwatch-data"
    index_url: SecretStr | None = None  # it may hold a password: never shown
    server: ServerSettings = ServerSettings()
    people: PeopleSettings = PeopleSettings()
    conditioning: ConditioningSettings = ConditioningSettings()
    identification: IdentificationSettings = IdentificationSettings()
    safety: ArmingSettings = ArmingSettings()
    realtime: RealtimeSettings = RealtimeSettings()
    limiter: LimiterSettings = LimiterSettings()
    warnings: WarningSettings = WarningSettings()
    recording: RecordingSettings = RecordingSettings()
    logs: LogSettings = LogSettings()
    foxglove: FoxgloveSettings = FoxgloveSettings()
