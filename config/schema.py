"""Typed models of every configuration file. Names contain the units; unknown keys are refused."""

import datetime
import hashlib
import ipaddress
import json
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

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
NameTuple = Annotated[tuple[str, ...], Field(strict=False)]  # accepts a list, also after a `before` validator
GrpcAddress = Annotated[str, Field(pattern=r"^([A-Za-z0-9.-]+|\[[0-9a-fA-F:]+\]):\d{1,5}$")]


class ConfigModel(BaseModel):
    """Base of all configuration models: immutable, no unknown keys, no silent conversion of text to numbers."""

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
    """Required product name of the board; `graspwatch check` compares it."""
    sample_rate_hz: Positive = 1000.0
    """Samples a second of every channel; the estimator is tuned for 1000."""
    block_samples: Annotated[int, Field(ge=1, le=100)] = 5
    """Samples that are read and processed together."""
    grpc_address: GrpcAddress | None = None
    """`host:port` of an NI gRPC device server with the board, instead of this computer's driver. A connection to
    another computer must be encrypted: set `grpc_ca`."""
    grpc_ca: str | None = None
    """Certificate (PEM file) for checking the device server's certificate; it encrypts the connection."""
    grpc_cert: str | None = None
    """This computer's own certificate (PEM file), if the server asks for one; needs `grpc_key`."""
    grpc_key: str | None = None
    """Private key (PEM file) of `grpc_cert`."""

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


class OtherInput(ConfigModel):
    """An analog input beside those that every tool has."""

    signal: Slug
    """Its signal, one of `acquisition/signal_table.py`."""
    input: str
    """Its physical channel, e.g. `ai4`."""


class Channels(ConfigModel):
    """Physical channels without the device name, e.g. `ai0`."""

    strain: str = "ai0"
    """Amplified strain gage."""
    motor_command_readback: str = "ai2"
    """Motor command, wired back from `motor_command`."""
    touch: tuple[str, str] = ("ai3", "ai1")
    """Touch sensors of the two jaws; on analog inputs, because the digital lines of the PCI-6230 have no clock."""
    encoder: str = "ctr0"
    """Counter with the quadrature encoder."""
    motor_command: str = "ao0"
    """Motor command to the amplifier."""
    other: tuple[OtherInput, ...] = Field(default=(), exclude_if=lambda other: not other)
    """Further analog inputs; none is needed."""
    analog_range_v: Positive = 10.0
    """Input range of ± this, V; one of the board's ranges."""


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
    """Distance from the jaw's axis to the grasping point, m."""
    beta0_deg: Positive
    """Angle of the linkage with the jaws open, degrees."""
    opening_m: Positive | None = None
    """Gap between the open jaws (encoder at zero), m. Without it thickness is no evidence. `calibrate geometry`."""


class ConstantMeasurement(ConfigModel):
    """Measurement of a constant of the tool file by `graspwatch calibrate`."""

    constant: Slug
    """Key of the constant in the file."""
    value: Finite
    """Value of the constant, in `unit`."""
    low: Finite
    """Lower end of its 95 % confidence interval, in `unit`."""
    high: Finite
    """Upper end of its 95 % confidence interval, in `unit`."""
    unit: str
    """Unit of `value`, `low` and `high`."""
    residual: NonNegative
    """RMS residual of the fit, in `residual_unit`."""
    residual_unit: str
    """Unit of `residual`."""
    readings: Annotated[int, Field(ge=1)]
    """Number of fitted readings."""
    date: datetime.date
    """Day of the measurement."""
    person: str
    """Name of the person who measured."""
    expires: datetime.date
    """Day from which the constant must be measured again."""


EQ2_MIN_SCALE, EQ2_MAX_SCALE = 0.05, 1.0
"""Range of scales that the paper allows: from 0.59 N/V, where Eq. (2) gives 12 N/V, to Eq. (2) as printed."""


class ForceScale(ConfigModel):
    """The force scale, with an interval: jaw force is Eq. (2) times this factor."""

    value: Positive
    """Factor for forces on the screen, in files and in reports."""
    low: Positive
    """Lower end of the scale's interval."""
    high: Positive
    """Upper end of the scale's interval; limiter, force ceiling and force alarms calculate with it."""
    measured: bool
    """Whether the scale was measured on this tool, against a reference between the jaws. If not, only an admin's
    override can arm a real tool."""
    source: Annotated[str, Field(min_length=1)]
    """Method of the measurement, or author of the assumption."""
    date: datetime.date | None = None
    """Day of the measurement."""
    expires: datetime.date | None = None
    """Day from which the scale must be measured again."""

    @model_validator(mode="after")
    def _is_an_interval(self) -> Self:
        if not self.low <= self.value <= self.high:
            raise ValueError(f"low <= value <= high must hold (found {self.low:g}, {self.value:g}, {self.high:g})")
        if self.measured and self.date is None:
            raise ValueError("a measured scale needs the date of its measurement")
        return self


def _add_default_interval(scale: ForceScale | float) -> ForceScale:
    """Return the scale; a number alone becomes a scale that was not measured, with the widest interval."""
    if isinstance(scale, ForceScale):
        return scale
    return ForceScale(
        value=scale,
        low=min(scale, EQ2_MIN_SCALE),
        high=max(scale, EQ2_MAX_SCALE),
        measured=False,
        source="a tool file that states no interval",
    )


EQ2_AS_PRINTED = _add_default_interval(1.0)
"""The force scale of a tool file that states none."""


def _choose_scale_tag(given: Any) -> str:
    return "number" if isinstance(given, int | float) and not isinstance(given, bool) else "table"


if TYPE_CHECKING:
    ForceScaleOrNumber = ForceScale  # what a file's number has become once it is loaded
else:
    ForceScaleOrNumber = Annotated[
        Annotated[ForceScale, Tag("table")] | Annotated[Positive, Tag("number")],
        Discriminator(_choose_scale_tag),
        AfterValidator(_add_default_interval),
    ]


class ToolCalibration(ConfigModel):
    """Constants of Eqs. (1), (3) and (5), and the strain gage's voltage at rest.

    Date, person and expiry apply to constants without a table of their own in `measured`.
    """

    newton_per_volt: Positive
    """Pull on the handle per volt of the strain gage over rest, Eq. (1). `calibrate strain`."""
    encoder_deg_per_volt: NonNegative
    """Turn of the encoder by the cable's stretch, degrees per volt, Eq. (3). `calibrate stretch`."""
    handle_per_encoder: Positive
    """Degrees of the handle per degree of the encoder, Eq. (5). `calibrate geometry`."""
    jaw_force_scale: ForceScaleOrNumber = EQ2_AS_PRINTED
    """Jaw force is Eq. (2) times this. A number alone counts as not measured. `calibrate force`."""
    rest_offset_v: Finite
    """Voltage of the strain gage at rest, V. `calibrate tare`."""
    rest_tolerance_v: Positive
    """Largest distance of a tare from `rest_offset_v`, V."""
    encoder_counts_per_rev: Annotated[int, Field(gt=0)]
    """Pulses of the encoder per turn of its shaft; each gives four counts."""
    encoder_gear_ratio: Positive
    """Turns of the encoder's shaft per turn of the gearbox."""
    date: str
    """Day of the measurement of the constants that are not in `measured`."""
    person: str
    """Name of the person who measured them."""
    expires: datetime.date | None = None
    """Day from which they must be measured again."""
    measured: tuple[ConstantMeasurement, ...] = ()
    """Measurements of constants: one table each, with its own date and expiry."""

    def is_rest_voltage(self, strain_v: float) -> bool:
        """Return whether the voltage is plausible for a gage at rest; False for NaN."""
        return abs(strain_v - self.rest_offset_v) <= self.rest_tolerance_v

    @property
    def encoder_resolution_deg(self) -> float:
        """Degrees after the gearbox per quadrature count."""
        return 360.0 / (self.encoder_counts_per_rev * 4 * self.encoder_gear_ratio)


class SensorNoise(ConfigModel):
    """Noise of one raw sample, for the estimator's noise model and for the simulated board."""

    strain_sd_v: Positive
    """Standard deviation of the strain gage at rest, V. `calibrate tare`."""
    strain_lsb_v: NonNegative
    """Step of the converter, V."""

    @property
    def strain_var_v2(self) -> float:
        """Variance of one sample, V²: noise and rounding to the converter's step."""
        return self.strain_sd_v**2 + self.strain_lsb_v**2 / 12


class ToolLimits(ConfigModel):
    """Hard bounds of the tool, which the acquisition worker enforces."""

    max_command_v: Positive
    """Highest motor command, V."""
    max_command_v_per_s: Positive = 60.0
    """Fastest rise of the motor command, V/s; its fall is not limited."""
    force_ceiling_n: Positive
    """Jaw force over which a run ends with a fault, N."""
    max_run_s: Positive
    """Longest run, s."""


class CommandToForce(ConfigModel):
    """Static map from motor command to jaw force, linear between the points and beyond the last."""

    command_v: tuple[NonNegative, ...]
    """Motor commands, V, rising from 0."""
    force_n: tuple[NonNegative, ...]
    """Jaw force at each command, N, rising from 0."""

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
    """Interpolate linearly, and extrapolate beyond the last point with the last slope."""
    slope = (ys[-1] - ys[-2]) / (xs[-1] - xs[-2])
    return np.interp(at, xs, ys) + slope * np.maximum(np.asarray(at, float) - xs[-1], 0.0)


class ContactDetection(ConfigModel):
    """Detection of contact with tissue and of jaw closure."""

    touch_trusted: bool
    """Whether the touch sensors detect contact; if not, the force does."""
    touch_threshold_v: Positive = 2.5
    """Voltage of a touch sensor over which it detects contact, V."""
    force_rise_v: Positive
    """Rise of the strain gage that shows contact, V."""
    force_rise_samples: Annotated[int, Field(ge=1)] = 8
    """Number of consecutive samples that must show the rise."""
    wall_above_v: Positive
    """Strain over rest below which the jaws never count as shut, V."""
    wall_span_v: Positive
    """Rise of strain over which the slope for jaw closure is measured, V."""
    wall_slack_deg_per_volt: Positive
    """Encoder travel beyond the cable's stretch that is allowed at jaw closure, degrees per volt."""
    slip_share: Probability
    """Share of the cable's stretch: an encoder that moves less slips."""
    walk_deg: Positive
    """Change of the encoder's rest position between grasps over which the encoder walks, degrees."""


class SensorPlausibility(ConfigModel):
    """Limits of plausible sensor signals; beyond them the force or the jaw position is not known.

    The defaults are for the Smart Tool as recorded in 2013, whose own vibration reaches 0.25 V in 3 ms.
    """

    strain_step_v: Positive = 0.4
    """Largest jump between the medians of three samples and of the next three, V."""
    strain_scatter_v: Positive = 0.35
    """Largest noise: median of seven second differences, V."""
    strain_below_rest_v: Positive = 1.2
    """Largest distance of the strain gage below rest, V."""
    rest_drift_v: Positive = 0.8
    """Largest distance of the rest voltage from the tare between grasps, V."""
    encoder_step_deg: Positive = 2.0
    """Largest step of the encoder from sample to sample, degrees."""
    encoder_back_deg: Positive = 25.0
    """Largest travel of the encoder behind the grasp's beginning, without the cable's stretch, degrees."""
    encoder_stuck_v: Positive = 0.04
    """Largest change of strain while the encoder does not move by a count, V."""


class GrasperMechanics(ConfigModel):
    """Mechanics of the simulated tool: drive lag, free travel, opening."""

    drive_lag_s: Positive
    """Time constant from motor command to drive force, s."""
    contact_lag_s: Positive
    """Time constant from drive force to the force on the tissue, s."""
    free_drag_kg_per_s: Positive
    """Drag of the jaws before contact, kg/s."""
    free_travel_m: Positive
    """Least travel of the jaws before contact, m."""
    opening_time_s: Positive
    """Time constant of the return spring, s."""
    spread_scale: NonNegative = 1.0
    """Scatter of the simulated specimens, as a multiple of the library's spread."""


CALIBRATION_UNIT_KEYS = ("newton_per_volt", "encoder_deg_per_volt", "handle_per_encoder")

CALIBRATION_COMMANDS = {
    "newton_per_volt": "strain",
    "encoder_deg_per_volt": "stretch",
    "handle_per_encoder": "geometry",
    "opening_m": "geometry",
    "rest_offset_v": "tare",
    "strain_sd_v": "tare",
}
"""Constants of a tool file, and the `graspwatch calibrate` command that measures each."""
FORCE_SCALE_KEY = "jaw_force_scale"


@dataclass(frozen=True, slots=True)
class ConstantOrigin:
    """Origin of a constant of the tool file: date and person of its measurement, and the day of its expiry."""

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
    """Short name, for recordings and the journal."""
    title: str
    """Name on screens and in reports."""
    kind: ToolKind
    """`simulated`; `nidaq`: a board with NI-DAQmx; `recording`: only for reading recordings."""
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
        """Hash (16 hexadecimal digits) of all constants that turn volts and degrees into forces and travel.

        It identifies the units of a learned library.
        """
        calibration = self.calibration.model_dump(include=set(CALIBRATION_UNIT_KEYS))
        calibration[FORCE_SCALE_KEY] = self.calibration.jaw_force_scale.value
        geometry = self.geometry.model_dump(exclude={"opening_m"})
        simulated = self.kind is ToolKind.SIMULATED  # differs from a real tool even with equal constants
        content = json.dumps([simulated, calibration, geometry, self.board.sample_rate_hz], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    @property
    def max_force_factor(self) -> float:
        """Highest ratio of true to displayed force: upper end of the force scale's interval over its value.

        It is 1 for a simulated tool, whose jaws and sensors use the same scale.
        """
        scale = self.calibration.jaw_force_scale
        return 1.0 if self.kind is ToolKind.SIMULATED else scale.high / scale.value

    def to_displayed_n(self, jaw_force_n: float) -> float:
        """Return the displayed force at which the true force may be `jaw_force_n`, N; protection acts there."""
        return jaw_force_n / self.max_force_factor

    @property
    def has_known_scale(self) -> bool:
        """Whether the force scale permits arming: it is measured, or the tool has no real motor."""
        return self.kind is not ToolKind.NIDAQ or self.calibration.jaw_force_scale.measured

    @property
    def scale_text(self) -> str:
        """Description of the force scale, for people."""
        scale = self.calibration.jaw_force_scale
        value, low, high = (float(f"{each:.3g}") for each in (scale.value, scale.low, scale.high))
        if self.kind is ToolKind.SIMULATED:
            return f"N by Eq. (2), scale exactly {value}: simulated"
        how = f"measured {scale.date}" if scale.measured else "not measured"
        return f"N by Eq. (2), scale {value} ({low} to {high}), {how}"

    @property
    def constant_origins(self) -> tuple[ConstantOrigin, ...]:
        """Origin of every constant that a calibration measures; without a measurement of its own, the file's."""
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
        """Return the constants that must be measured again."""
        return [each for each in self.constant_origins if each.is_expired(today)]

    @model_validator(mode="after")
    def _simulated_has_mechanics(self) -> Self:
        if self.kind is ToolKind.SIMULATED and self.simulation is None:
            raise ValueError("a tool of kind 'simulated' needs a [simulation] table")
        return self


# --- tissues ---------------------------------------------------------------------------------------------------------


class ParameterSpread(ConfigModel):
    """Standard deviations of the parameters' natural logarithms from specimen to specimen."""

    log_alpha: Positive
    log_beta: Positive
    log_damping: Positive
    log_thickness: Positive = 0.2


class LearnedRecording(ConfigModel):
    """One recording that a tissue was learned from."""

    file: str
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    grasps: Annotated[int, Field(ge=1)]  # number of grasps that were learned from
    left_out: tuple[str, ...] = ()  # other grasps, with the reason
    ramp_v_per_s: Positive
    centre: tuple[Finite, ...] = Field(min_length=1)  # of `LearnedLibrary.features`


class LearnedTissue(ConfigModel):
    """A tissue's statistics from recordings, in the units of their tool's calibration."""

    grasps: Annotated[int, Field(ge=1)]
    log_covariance: tuple[tuple[Finite, ...], ...]  # of log alpha, log beta, log d, log thickness between grasps
    contact_measured: bool  # False: thickness and its spread are the base library's
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


EARLIER_SPREAD_OF_FEATURES = (1.5, 0.2, 0.2, 0.35, 0.35, 0.024, 0.12, 0.5)  # times `session_scale`
LOADING_FEATURES = ("opening", "force_40deg", "force_5deg", "knee", "lean", "stall", "yield", "give")


class LearnedLibrary(ConfigModel):
    """Origin of a learned library, and the values common to its tissues."""

    date: str
    base: str  # library that injury thresholds, mass and jaw area come from
    tool: str
    calibration: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]  # `Tool.calibration_fingerprint`
    features: Annotated[NameTuple, Field(min_length=1)]
    usual_peak_v: Positive  # of the strain gage over rest; shares of force refer to it
    # of `features` between spots of one tissue at one ramp; see docs/learning.md
    spot_sd: Annotated[tuple[Positive, ...], Field(strict=False)]
    spot_pairs: Annotated[int, Field(ge=0)]  # pairs of spots that this spread was learned from
    prior_unknown: Probability  # that the tissue is none of the library's, before a grasp
    session_scale: Positive | None = None  # only of earlier versions, which had it instead of the three above

    @model_validator(mode="before")
    @classmethod
    def _read_earlier_version(cls, given: Any) -> Any:
        """Give a library in a recording of an earlier version the spread that it had, so that it can be read."""
        scale = given.get("session_scale") if isinstance(given, dict) else None
        if isinstance(scale, float) and "spot_sd" not in given:
            spread = [scale * sd for sd in EARLIER_SPREAD_OF_FEATURES]
            return {**given, "spot_sd": spread, "spot_pairs": 4, "prior_unknown": 0.05}
        return given

    @model_validator(mode="after")
    def _are_the_features(self) -> Self:
        if self.features != LOADING_FEATURES:
            raise ValueError(
                f"features are not {', '.join(LOADING_FEATURES)}: another version learned this library; learn it anew"
            )
        if len(self.spot_sd) != len(self.features):
            raise ValueError("spot_sd needs one number for each of features; learn the library anew")
        return self


class TissueProfile(ConfigModel):
    """Parameters of u = m x'' + d x' + alpha (exp(beta x) - 1), Eq. (7), thickness, and injury threshold."""

    title: str
    alpha_n: Positive
    beta_per_m: Positive
    damping_kg_per_s: Positive
    thickness_m: Positive
    threshold_pa: Positive
    spread: ParameterSpread | None = None
    learned: LearnedTissue | None = None


class TissueLibrary(ConfigModel):
    """The tissue profiles among which Graspwatch decides."""

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
        taken = {"unknown", "undecided", "no_answer"} & set(self.tissues)
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
        """Refuse a tool with another calibration than the one that the library was learned with.

        Raises:
            ConfigurationError: the calibrations differ, so the library has other units.
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
        """Return the force at which injury begins, N: threshold pressure times jaw area."""
        return self.tissues[tissue].threshold_pa * self.jaw_area_m2

    def convert_thresholds_to_displayed_n(self, tool: Tool) -> dict[str, float]:
        """Return the displayed force of `tool` at which each tissue may be injured, N."""
        return {name: tool.to_displayed_n(self.threshold_n(name)) for name in self.tissues}

    @property
    def lowest_threshold_n(self) -> float:
        return min(self.threshold_n(name) for name in self.tissues)


# --- protocols -------------------------------------------------------------------------------------------------------


class TrapezoidWaveform(ConfigModel):
    """Motor command with ramp up, hold, ramp down and rest."""

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
    """Raised cosine of force, A/2 (1 - cos 2 pi f t): one slow cycle, then fast cycles, then rest."""

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
    """Motor command as straight lines between points in time; it begins and ends at 0 V."""

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
    """A named waveform and its default number of repetitions."""

    name: Slug
    title: str
    lead_in_s: Annotated[float, Field(ge=0.25, le=60)] = 0.5
    cycles: Annotated[int, Field(ge=1, le=10_000)] = 1
    waveform: Annotated[TrapezoidWaveform | SineWaveform | CustomWaveform, Field(discriminator="shape")]


# --- the service -----------------------------------------------------------------------------------------------------


class ServerSettings(ConfigModel):
    """The server's address, host names and capacity limits.

    `hosts` are names beside localhost, 127.0.0.1, [::1] and the address that it listens on. With tokens and without
    `hosts`, every name is accepted. `trusted_proxies` are addresses or networks whose `X-Forwarded-Proto` counts.
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
                    "admin_token_file is no longer supported: leave it out, and give each admin a token of their own "
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
    """Expiry of a browser's sign-in without a sign of life, and of an operator's control without an action."""

    session_idle_s: Positive = 3600.0
    control_expires_s: Positive = 600.0


class ConditioningSettings(ConfigModel):
    """The paper's low-pass filter for displayed signals: 2nd-order Butterworth at 10 Hz."""

    butterworth_order: Annotated[int, Field(ge=1, le=4)] = 2
    butterworth_cutoff_hz: Positive = 10.0


class IdentificationSettings(ConfigModel):
    """Conditions for naming a tissue, and prior probabilities.

    Jaws that stay open for longer than `new_spot_after_s` between two grasps begin a new spot.
    """

    decide_at: Probability = 0.95
    withdraw_below: Probability = 0.85
    confirm_s: NonNegative = 0.03
    prior_unknown: Probability = 0.05
    use_thickness: bool = True
    new_spot_after_s: Positive = 5.0
    unknown_spread_log: Positive = 2.5
    convergence_error: Probability = 0.15

    @model_validator(mode="after")
    def _hysteresis(self) -> Self:
        if self.withdraw_below >= self.decide_at:
            raise ValueError("withdraw_below must be lower than decide_at")
        return self


class ArmingSettings(ConfigModel):
    """Arming, and the end of runs without a server.

    With `arm_with_start`, a start arms the tool if it is not armed. A run ends with the motor at zero once the server
    has been silent for `server_silence_s`, because STOP comes through the server.
    """

    arm_with_start: bool = True
    server_silence_s: Annotated[float, Field(ge=0.3, le=10.0)] = 1.0


class LimiterSettings(ConfigModel):
    """The force limit: `margin` times the threshold in force.

    The estimator's threshold counts for `limit_expires_s`; after that the library's lowest one counts.
    """

    margin: Probability = 0.8
    limit_expires_s: Positive = 0.1


class RecordingSettings(ConfigModel):
    """Recording of runs. Nothing is recorded if fewer than `least_free_bytes` are free.

    A deleted recording stays in the bin for `keep_deleted_days`.
    """

    enabled: bool = True
    before_s: Annotated[float, Field(ge=0, le=60)] = 5.0
    after_s: Annotated[float, Field(ge=0, le=60)] = 1.0
    least_free_bytes: Annotated[int, Field(ge=0)] = 200_000_000
    demonstrations_kept: Annotated[int, Field(ge=0)] = 12
    keep_deleted_days: Annotated[float, Field(ge=0, le=36_500)] = 30.0


class WarningSettings(ConfigModel):
    """Shares of the threshold in force at which low, medium and high force alarms begin, and their hysteresis."""

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
    """Real-time requests of acquisition, estimator and safety monitor; they run without a request that is refused."""

    priority: bool = True  # SCHED_FIFO; also for server and recorder
    lock_memory: bool = False  # mlockall: their memory is never paged out
    cores: tuple[Annotated[int, Field(ge=0)], ...] = ()  # acquisition on the first, estimator on the next, in turn
    freeze_garbage: bool = True  # keep Python's garbage collector from pausing them


class LogFormat(StrEnum):
    TEXT = "text"
    JSON = "json"


class LogSettings(ConfigModel):
    """Level and format of the error output; a fuller log is kept in `logs/` of the data folder, as JSON lines."""

    level: Literal["info", "warning", "error"] = "warning"
    format: LogFormat = LogFormat.TEXT
    keep: bool = True


class FoxgloveSettings(ConfigModel):
    """The live stream for Foxglove and Lichtblick on this computer only, because these programs cannot sign in."""

    port: Annotated[int, Field(ge=1, le=65535)] | None = None


class Settings(ConfigModel):
    """`graspwatch.toml`: all settings of the service except tools, libraries and protocols."""

    tool: str = "simulated"
    library: str = "porcine"
    data_folder: str = "graspwatch-data"
    index_url: SecretStr | None = None  # it may contain a password, so it is never shown
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
