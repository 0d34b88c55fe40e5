"""Typed models of every configuration file. Names contain the units; unknown keys are refused."""

import datetime
import hashlib
import ipaddress
import json
import math
import re
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Self, TypeGuard

import numpy as np
from pydantic import (
    AfterValidator,
    AwareDatetime,
    Discriminator,
    Field,
    SecretStr,
    Tag,
    field_validator,
    model_validator,
)

from config.config_model import ConfigModel, Finite, NonNegative, NonZero, Positive, Probability, Slug
from config.errors import ConfigurationError
from config.home_folder import expand_home
from config.network import is_loopback, parse_authority
from config.table_layout import TableLayout

HomePath = Annotated[str, AfterValidator(expand_home)]
NameTuple = Annotated[tuple[str, ...], Field(strict=False)]  # accepts a list, also after a `before` validator
GrpcAddress = Annotated[str, Field(pattern=r"^([A-Za-z0-9.-]+|\[[0-9a-fA-F:]+\]):\d{1,5}$")]


# --- tools -----------------------------------------------------------------------------------------------------------


def _refuse_unordered(values: tuple[float, ...]) -> tuple[float, ...]:
    if any(np.diff(values) <= 0):
        raise ValueError("must rise from value to value")
    return values


class ToolKind(StrEnum):
    SIMULATED = "simulated"
    NIDAQ = "nidaq"
    SERIAL = "serial"
    RECORDING = "recording"


class Board(ConfigModel):
    """The NI board: one hardware-timed clock for the analog inputs and the encoder."""

    device: str = "Dev1"
    """The board's name in NI MAX."""
    product: str = "PCI-6230"
    """Required product name of the board; `graspwatch check` compares it."""
    sample_rate_hz: Positive = 1000.0
    """Samples a second of every channel; the estimator is tuned for 1000."""
    averaged_samples: Annotated[int, Field(ge=1, le=100, exclude_if=lambda averaged: averaged == 1)] = 1
    """Readings of a real board that are averaged to one sample: with 10, its clock runs ten times as fast."""
    block_samples: Annotated[int, Field(ge=1, le=100)] = 5
    """Samples that are read and processed together."""
    grpc_address: GrpcAddress | None = None
    """`host:port` of an NI gRPC device server with the board, instead of this computer's driver. A connection to
    another computer must be encrypted: set `grpc_ca`."""
    grpc_ca: HomePath | None = None
    """Certificate (PEM file) for checking the device server's certificate; it encrypts the connection."""
    grpc_cert: HomePath | None = None
    """This computer's own certificate (PEM file), if the server asks for one; needs `grpc_key`."""
    grpc_key: HomePath | None = None
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


class SerialPort(ConfigModel):
    """The serial port of a device that prints a line of numbers for each sample, such as an Arduino."""

    port: Annotated[str, Field(min_length=1)]
    """Name of the port, such as `/dev/ttyACM0`."""
    baud: Annotated[int, Field(ge=300, le=12_000_000)] = 115_200
    """Bits a second, as in the device's program."""


class OtherInput(ConfigModel):
    """An analog input beside those that every tool has."""

    signal: Slug
    """Its signal, one of `acquisition/signal_table.py`."""
    input: str
    """Its physical channel, e.g. `ai4`."""


class PositionInput(ConfigModel):
    """An analog position sensor, such as a potentiometer, in the place of the encoder."""

    input: Annotated[str, Field(min_length=1)]
    """Its physical channel, e.g. `ai1`."""
    degree_per_volt: NonZero
    """Degrees a volt; negative if the voltage falls while the jaws close."""


class Channels(ConfigModel):
    """Physical channels without the device name, e.g. `ai0`. An empty name: the tool has none."""

    strain: str = "ai0"
    """Amplified strain gage."""
    motor_command_readback: str = "ai2"
    """Motor command, wired back from `motor_command`."""
    touch: tuple[str, str] = ("ai3", "ai1")
    """Touch sensors of the two jaws; on analog inputs, because the digital lines of the PCI-6230 have no clock."""
    encoder: str = "ctr0"
    """Counter with the quadrature encoder."""
    position: PositionInput | None = Field(default=None, exclude_if=lambda position: position is None)
    """Of a tool with an analog position sensor; then `encoder` is empty."""
    motor_command: str = "ao0"
    """Motor command to the amplifier. A tool without one is closed by hand: it needs `[hand_driven]`."""
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


RisingTable = Annotated[tuple[Finite, ...], Field(min_length=3), AfterValidator(_refuse_unordered)]


class SmartToolKinematics(ConfigModel):
    """The linkage of the Smart Tool, Eqs. (1) to (6), with the constants of [geometry] and [calibration]."""

    kind: Literal["smart_tool"] = "smart_tool"
    """Which kinematics these are."""


class _SensorKinematics(ConfigModel):
    """What all kinematics but the Smart Tool's have. Both sensors must rise while the jaws close and press."""

    opening_m: Positive | None = None
    """Gap between the open jaws, m. Without it thickness is no evidence."""
    stretch_deg_per_volt: NonNegative = 0.0
    """Turn of the position sensor by the elasticity of what is between it and the jaws, degrees per volt."""


class DirectKinematics(_SensorKinematics):
    """Sensors that measure force and displacement of the jaws themselves."""

    kind: Literal["direct"]
    """Which kinematics these are."""
    newton_per_volt: Positive
    """Jaw force per volt of the force sensor over rest, N/V."""
    metre_per_degree: Positive
    """Jaw displacement per degree of the position sensor, m."""


class LeverKinematics(_SensorKinematics):
    """A lever at the handle or drive that turns the jaws by a fixed ratio, without friction.

    Jaw force is perpendicular to the jaw, and jaw displacement is the arc of the grasping point. So the jaws do as much
    work as the handle.
    """

    kind: Literal["lever"]
    """Which kinematics these are."""
    newton_per_volt: Positive
    """Force at the handle or drive per volt of the force sensor over rest, N/V."""
    handle_arm_m: Positive
    """Distance from the handle's axis to where its force acts, m."""
    jaw_arm_m: Positive
    """Distance from the jaws' axis to the grasping point, m."""
    jaw_per_handle: Positive
    """Turn of the jaws per turn of the handle, which the position sensor measures."""


class TableKinematics(_SensorKinematics):
    """Measured pairs, with a monotone curve through them (PCHIP). A reading beyond the pairs is invalid.

    The pair 0, 0 is the open tool at rest; noise needs a pair below it.
    """

    kind: Literal["table"]
    """Which kinematics these are."""
    strain_v: RisingTable
    """Readings of the force sensor over rest, V, rising."""
    force_n: RisingTable
    """Jaw force at each, N, rising."""
    encoder_deg: RisingTable
    """Readings of the position sensor since the jaws were open, degrees, rising."""
    displacement_m: RisingTable
    """Jaw displacement at each, m, rising."""

    @model_validator(mode="after")
    def _passes_rest(self) -> Self:
        for readings, values in (("strain_v", "force_n"), ("encoder_deg", "displacement_m")):
            own, its = getattr(self, readings), getattr(self, values)
            if len(own) != len(its):
                raise ValueError(f"{readings} and {values} need the same number of values")
            if (0.0, 0.0) not in zip(own[1:], its[1:], strict=True):
                raise ValueError(
                    f"{readings} and {values} need the pair 0, 0 (the open tool at rest), and a pair below it for noise"
                )
        return self


Kinematics = SmartToolKinematics | DirectKinematics | LeverKinematics | TableKinematics


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


class ForceLaw(StrEnum):
    """How the jaw force is computed from the strain gage's voltage: by Eq. (2), or as a constant N/V."""

    EQUATION_2 = "eq2"
    CONSTANT = "constant"


class ForceScale(ConfigModel):
    """The force scale, with an interval. By `law` it is a factor of Eq. (2), or newtons per volt of the strain gage."""

    law: ForceLaw = ForceLaw.EQUATION_2
    """`eq2`: jaw force is Eq. (2) times `value`. `constant`: it is the strain over rest times `value`, N/V."""
    value: Positive
    """Factor, or N/V, for forces on the screen, in files and in reports."""
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
    return "number" if isinstance(given, int | float) and not isinstance(given, bool) else "interval"


if TYPE_CHECKING:
    ForceScaleOrNumber = ForceScale  # what a file's number has become once it is loaded
else:
    ForceScaleOrNumber = Annotated[
        Annotated[ForceScale, Tag("interval")] | Annotated[Positive, Tag("number")],
        Discriminator(_choose_scale_tag),
        AfterValidator(_add_default_interval),
    ]


class ToolCalibration(ConfigModel):
    """Constants of Eqs. (1), (3) and (5), and the strain gage's voltage at rest.

    The constants of the equations belong to a tool with the kinematics `smart_tool`, and only there.
    Date, person and expiry apply to constants without a table of their own in `measured`.
    """

    newton_per_volt: Positive = 1.0
    """Pull on the handle per volt of the strain gage over rest, Eq. (1). `calibrate strain`."""
    encoder_deg_per_volt: NonNegative = 0.0
    """Turn of the encoder by the cable's stretch, degrees per volt, Eq. (3). `calibrate stretch`."""
    handle_per_encoder: Positive = 1.0
    """Degrees of the handle per degree of the encoder, Eq. (5). `calibrate geometry`."""
    jaw_force_scale: ForceScaleOrNumber = EQ2_AS_PRINTED
    """Jaw force is Eq. (2) times this. A number alone counts as not measured. `calibrate force`."""
    rest_offset_v: Finite
    """Voltage of the strain gage at rest, V. `calibrate tare`."""
    rest_tolerance_v: Positive
    """Largest distance of a tare from `rest_offset_v`, V."""
    encoder_counts_per_rev: Annotated[int, Field(gt=0)] = 500
    """Pulses of the encoder per turn of its shaft; each gives four counts."""
    encoder_gear_ratio: Positive = 19.0
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
    """Hard bounds of the tool, which the acquisition worker enforces. A tool without a motor needs none."""

    max_command_v: Positive
    """Highest motor command, V."""
    max_command_v_per_s: Positive = 60.0
    """Fastest rise of the motor command, V/s; its fall is not limited."""
    force_ceiling_n: Positive
    """Jaw force over which a run ends with a fault, N."""
    max_run_s: Positive
    """Longest run, s."""


class CommandToForce(ConfigModel):
    """Static map from motor command to jaw force, linear between the points and beyond the last.

    A tool for recordings needs none.
    """

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


class HandDrivenGrasps(ConfigModel):
    """Detection of grasps on a tool without a motor command, by the travel of its jaws."""

    closing_deg: Positive
    """Travel of the position sensor from the open jaws at which a grasp has begun, degrees. It must be above noise and
    hesitation."""
    open_share: Probability = 0.3
    """Share of a grasp's travel that is left when it counts as over."""


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


NO_MOTOR_LIMITS = ToolLimits(max_command_v=10.0, force_ceiling_n=100.0, max_run_s=3600.0)
NO_MOTOR_FORCE = CommandToForce(command_v=(0.0, 10.0), force_n=(0.0, 100.0))
"""Bounds of a tool without a motor, which bound nothing."""


class Tool(ConfigModel):
    """A tool file: board, channels, geometry, calibration, noise, limits."""

    name: Slug
    """Short name, for recordings and the journal."""
    title: str
    """Name on screens and in reports."""
    kind: ToolKind
    """`simulated`; `nidaq`: a board with NI-DAQmx; `serial`: a device without a motor that prints its samples;
    `recording`: only for reading recordings."""
    board: Board = Board()
    serial: SerialPort | None = Field(default=None, exclude_if=lambda serial: serial is None)
    """Of a tool of kind `serial`; `[table]` says what stands in its lines."""
    channels: Channels = Channels()
    kinematics: Kinematics = Field(
        SmartToolKinematics(), discriminator="kind", exclude_if=lambda kinematics: kinematics.kind == "smart_tool"
    )
    """From the sensors to force and displacement of the jaws: one of four kinds."""
    geometry: Geometry | None = Field(None, exclude_if=lambda geometry: geometry is None)
    """Of a tool with the kinematics `smart_tool`."""
    calibration: ToolCalibration
    noise: SensorNoise
    limits: ToolLimits = NO_MOTOR_LIMITS
    command_to_force: CommandToForce = NO_MOTOR_FORCE
    contact: ContactDetection
    hand_driven: HandDrivenGrasps | None = Field(None, exclude_if=lambda hand_driven: hand_driven is None)
    """Of a tool without a motor command."""
    plausible: SensorPlausibility = SensorPlausibility()
    simulation: GrasperMechanics | None = None
    table: TableLayout | None = Field(default=None, exclude_if=lambda table: table is None)

    @property
    def has_motor(self) -> bool:
        """Whether Graspwatch drives the tool. Without a motor it warns, and nothing can be held back."""
        return self.has_board and bool(self.channels.motor_command)

    @property
    def has_real_motor(self) -> bool:
        """Whether the motor is one that holds its last command when the process that wrote it dies."""
        return self.has_motor and self.kind is ToolKind.NIDAQ

    @property
    def has_board(self) -> bool:
        """Whether it is on an NI board, a real or a simulated one."""
        return self.kind in (ToolKind.SIMULATED, ToolKind.NIDAQ)

    @property
    def why_no_motor(self) -> str:
        """What a tool without a motor is, for messages."""
        return "is for recordings" if self.kind is ToolKind.RECORDING else "has no motor"

    @property
    def linkage(self) -> Geometry:
        """Link lengths of the Smart Tool's kinematics.

        Raises:
            ConfigurationError: the tool has other kinematics.
        """
        if self.geometry is None:
            raise ConfigurationError(
                f"The tool {self.name!r} has the kinematics {self.kinematics.kind!r}, and this is for `smart_tool`."
            )
        return self.geometry

    @property
    def opening_m(self) -> float | None:
        """Gap between the open jaws, m; None if it is not known."""
        return self.linkage.opening_m if isinstance(self.kinematics, SmartToolKinematics) else self.kinematics.opening_m

    @property
    def stretch_deg_per_volt(self) -> float:
        """Turn of the encoder by the stretch of cable or drive, degrees per volt, Eq. (3)."""
        if isinstance(self.kinematics, SmartToolKinematics):
            return self.calibration.encoder_deg_per_volt
        return self.kinematics.stretch_deg_per_volt

    @property
    def calibration_fingerprint(self) -> str:
        """Hash (16 hexadecimal digits) of all constants that turn volts and degrees into forces and travel.

        It identifies the units of a learned library.
        """
        calibration = self.calibration.model_dump(include=set(CALIBRATION_UNIT_KEYS))
        scale = self.calibration.jaw_force_scale
        by_eq2 = scale.law is ForceLaw.EQUATION_2
        calibration[FORCE_SCALE_KEY] = scale.value if by_eq2 else [scale.law, scale.value]
        mechanics = self.geometry or self.kinematics
        simulated = self.kind is ToolKind.SIMULATED  # differs from a real tool even with equal constants
        constants = [simulated, calibration, mechanics.model_dump(exclude={"opening_m"}), self.board.sample_rate_hz]
        if self.table and not isinstance(self.kinematics, SmartToolKinematics):  # its scales convert to volts, degrees
            sensors = {each.signal: [each.unit, each.scale] for each in self.table.columns}
            constants.append([sensors.get(name) for name in ("strain_v", "encoder_deg")])
        content = json.dumps(constants, sort_keys=True)
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
        return not self.has_real_motor or self.calibration.jaw_force_scale.measured

    @property
    def scale_text(self) -> str:
        """Description of the force scale, for people."""
        scale = self.calibration.jaw_force_scale
        value, low, high = (float(f"{each:.3g}") for each in (scale.value, scale.low, scale.high))
        is_constant = scale.law is ForceLaw.CONSTANT
        by = "Eq. (2)" if isinstance(self.kinematics, SmartToolKinematics) else f"{self.kinematics.kind} kinematics"
        if self.kind is ToolKind.SIMULATED:
            law = f"a constant {value} N/V of strain" if is_constant else f"{by}, scale exactly {value}"
            return f"N by {law}: simulated"
        how = f"measured {scale.date}" if scale.measured else "not measured"
        law = f"a constant {value} N/V of strain" if is_constant else f"{by}, scale {value}"
        return f"N by {law} ({low} to {high}), {how}"

    @property
    def constant_origins(self) -> tuple[ConstantOrigin, ...]:
        """Origin of every constant that a calibration measures; without a measurement of its own, the file's."""
        calibration, scale = self.calibration, self.calibration.jaw_force_scale
        own = {how.constant: how for how in calibration.measured}
        values = calibration.model_dump(include=set(CALIBRATION_COMMANDS))
        values |= {"opening_m": self.opening_m, "strain_sd_v": self.noise.strain_sd_v}
        ages = []
        is_smart = isinstance(self.kinematics, SmartToolKinematics)
        for name in CALIBRATION_COMMANDS:
            if name in CALIBRATION_UNIT_KEYS and not is_smart:
                continue  # [kinematics] has constants of its own
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

    def find_differences_beside_constants(self, other: "Tool") -> list[str]:
        """Return the keys of the file, beside the tables that a calibration changes, in which another tool differs."""
        return [
            key
            for key in type(self).model_fields
            if key not in ("calibration", "geometry", "noise") and getattr(self, key) != getattr(other, key)
        ]

    @model_validator(mode="after")
    def _has_constants_of_its_kinematics(self) -> Self:
        is_smart, given = isinstance(self.kinematics, SmartToolKinematics), self.calibration.model_fields_set
        if is_smart and (missing := [key for key in CALIBRATION_UNIT_KEYS if key not in given]):
            raise ValueError(f"calibration lacks {', '.join(missing)}, which Eqs. (1) to (6) need")
        if is_smart and self.geometry is None:
            raise ValueError("[geometry] is missing: the link lengths of Table I, which Eqs. (2) and (6) need")
        fields = type(self.calibration).model_fields
        foreign = [key for key in CALIBRATION_UNIT_KEYS if getattr(self.calibration, key) != fields[key].default]
        if not is_smart and foreign:
            raise ValueError(f"{', '.join(foreign)} belong to the kinematics `smart_tool`; see [kinematics]")
        if not is_smart and self.geometry is not None:
            raise ValueError("[geometry] belongs to the kinematics `smart_tool`; see [kinematics]")
        if not is_smart and self.calibration.jaw_force_scale.law is ForceLaw.CONSTANT:
            raise ValueError(
                "a constant force law belongs to the kinematics `smart_tool`: [kinematics] says the newtons"
            )
        return self

    @model_validator(mode="after")
    def _table_reaches_far_enough(self) -> Self:
        table = self.kinematics
        if not isinstance(table, TableKinematics):
            return self
        if table.opening_m and table.displacement_m[-1] < table.opening_m:
            raise ValueError("displacement_m must reach opening_m, where the jaws are shut")
        highest_n = self.calibration.jaw_force_scale.value * table.force_n[-1]
        if self.has_motor and highest_n < self.to_displayed_n(self.limits.force_ceiling_n):
            raise ValueError("force_n must reach the force ceiling: beyond the table no force is known")
        return self

    @model_validator(mode="after")
    def _is_driven_by_one(self) -> Self:
        if self.hand_driven and self.has_motor:
            raise ValueError("[hand_driven] is for tools without a motor: with one, grasps are found by its command")
        return self

    @model_validator(mode="after")
    def _serial_has_its_tables(self) -> Self:
        is_serial = self.kind is ToolKind.SERIAL
        needed = {"serial": self.serial, "table": self.table, "hand_driven": self.hand_driven}
        if is_serial and (missing := [name for name, table in needed.items() if table is None]):
            raise ValueError(f"a tool of kind 'serial' needs a [{missing[0]}] table")
        if self.serial and not is_serial:
            raise ValueError("[serial] belongs to a tool of kind 'serial'")
        places = [each.column for each in self.table.columns] if self.table else []
        places += [self.table.time.column] if self.table and self.table.time else []
        if is_serial and (named := [place for place in places if isinstance(place, str)]):
            raise ValueError(f"the lines of a serial port have no headings: write the number of column {named[0]!r}")
        return self

    @model_validator(mode="after")
    def _channels_fit(self) -> Self:
        if self.has_motor and not self.channels.motor_command_readback:
            raise ValueError("motor_command_readback is missing: the motor's command must be read back")
        if self.kind is ToolKind.NIDAQ and not self.has_motor and self.hand_driven is None:
            raise ValueError("a tool without motor_command is closed by hand, and needs a [hand_driven] table")
        if self.has_motor and self.channels.position:
            raise ValueError("an analog position sensor is for jaws that are closed by hand: a motor needs an encoder")
        if self.has_board and not self.channels.strain:
            raise ValueError("channels.strain is empty: without the force nothing can be watched")
        if self.contact.touch_trusted and not all(self.channels.touch):
            raise ValueError("touch_trusted needs both touch sensors, and channels.touch has an empty name")
        if self.kind is ToolKind.SIMULATED and self.board.averaged_samples > 1:
            raise ValueError("averaged_samples is for a real board: the simulated one has no other noise")
        if self.kind is ToolKind.SIMULATED and not self.has_motor:
            raise ValueError("a simulated tool needs motor_command: it is not closed by hand")
        return self

    @model_validator(mode="after")
    def _motor_has_limits(self) -> Self:
        missing = [key for key in ("limits", "command_to_force") if key not in self.model_fields_set]
        if self.has_motor and missing:
            raise ValueError(f"[{missing[0]}] is missing, which a motor needs")
        return self

    @model_validator(mode="after")
    def _board_has_an_encoder(self) -> Self:
        needed = ("encoder_counts_per_rev", "encoder_gear_ratio")
        missing = [key for key in needed if key not in self.calibration.model_fields_set]
        if self.has_board and bool(self.channels.encoder) is bool(self.channels.position):
            raise ValueError('[channels] needs one position sensor: encoder, or encoder = "" and [channels.position]')
        if self.has_board and self.channels.encoder and missing:
            raise ValueError(f"calibration lacks {', '.join(missing)}, which the board's counter needs")
        return self

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


SAME_DAY = datetime.timedelta(hours=12)
"""Two times that differ by less belong to one day's work."""


def is_same_day(one: datetime.datetime | None, other: datetime.datetime | None) -> bool:
    """Return whether both times are known and belong to one day's work."""
    return one is not None and other is not None and abs(one - other) <= SAME_DAY


class ReferenceGrasp(ConfigModel):
    """Grasps of a tool that close on nothing: where the drive stalls and both stops are on that day."""

    tool: Slug  # name of the tool
    calibration: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]  # `Tool.calibration_fingerprint`
    taken_at: AwareDatetime
    person: str | None = None  # who took it, if that is known
    grasps: Annotated[int, Field(ge=1)]  # number of grasps whose medians the values below are
    command_v: Positive  # highest motor command, V
    stall_v: Positive  # strain over rest at which the drive stalls on empty jaws, V
    stretch_deg_per_volt: Finite  # turn of the encoder by the cable's stretch with shut jaws, Eq. (3)
    shut_deg: Finite  # encoder angle of the shut jaws, without the cable's stretch
    open_deg: Finite  # encoder angle of the open jaws, without the cable's stretch

    @property
    def opening_deg(self) -> float:
        """Travel of the encoder between both stops, degrees."""
        return self.shut_deg - self.open_deg

    def belongs_to(self, tool: Tool, at: datetime.datetime | None) -> bool:
        """Return whether it is a reference for this tool as it is calibrated, on the day of `at`."""
        is_this_tool = (self.tool, self.calibration) == (tool.name, tool.calibration_fingerprint)
        return is_this_tool and is_same_day(self.taken_at, at)

    def is_comparable(self, other: "ReferenceGrasp") -> bool:
        """Return whether both were taken alike: with the same calibration and the same motor command."""
        return self.calibration == other.calibration and math.isclose(self.command_v, other.command_v, rel_tol=0.02)

    def __str__(self) -> str:
        return (
            f"stall {self.stall_v:.2f} V, stretch {self.stretch_deg_per_volt:.1f} deg/V, jaws shut at "
            f"{self.shut_deg:.1f} and open at {self.open_deg:.1f} deg, {self.grasps} grasps"
        )


@dataclass(frozen=True, slots=True)
class SourceConditions:
    """When samples were taken, and the reference grasp of that day; None where it is not known."""

    recorded_at: datetime.datetime | None = None
    reference: ReferenceGrasp | None = None


UNKNOWN_CONDITIONS = SourceConditions()


class LearnedRecording(ConfigModel):
    """One recording that a tissue was learned from."""

    file: str
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    grasps: Annotated[int, Field(ge=1)]  # number of grasps that were learned from
    left_out: tuple[str, ...] = ()  # other grasps, with the reason
    ramp_v_per_s: Positive
    centre: tuple[Finite, ...] = Field(min_length=1)  # of `LearnedLibrary.features`
    recorded_at: AwareDatetime | None = None  # None: not known, or learned by a version that did not keep it
    reference: ReferenceGrasp | None = None  # of the recording's day and tool

    @property
    def conditions(self) -> SourceConditions:
        return SourceConditions(self.recorded_at, self.reference)


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
    """Parameters of u = m x'' + d x' + alpha (exp(beta x) - 1), Eq. (7), thickness, and injury threshold.

    A library in pascal and strain states `alpha_pa` and `beta_per_strain`; `alpha_n` and `beta_per_m` are derived from
    them, Eq. (21). `preload_n` is for tissue that is thicker than the jaws open, of which they take a fold: the range
    of the force (N) at which the fold is held when its displacement begins to count. Every value within it is as likely
    as its double. The fold follows Eq. (7) with alpha plus preload in place of alpha.
    """

    title: str
    alpha_pa: Positive | None = None
    beta_per_strain: Positive | None = None
    alpha_n: Positive
    beta_per_m: Positive
    damping_kg_per_s: Positive
    thickness_m: Positive
    threshold_pa: Positive
    preload_n: tuple[Positive, Positive] | None = None
    spread: ParameterSpread | None = None
    learned: LearnedTissue | None = None

    @model_validator(mode="after")
    def _preload_is_a_range(self) -> Self:
        if self.preload_n and not self.preload_n[0] < self.preload_n[1]:
            raise ValueError("preload_n needs its lower end first, then its upper end")
        return self


class LibraryUnits(StrEnum):
    """Units in which a library states the tissues' parameters."""

    PASCAL_AND_STRAIN = "pascal and strain"
    NEWTON_AND_METER = "newton and meter"


class ApparentAlpha(NamedTuple):
    """Distribution of alpha in grasps of a tissue: its median, N, and the SD of its logarithm."""

    median_n: float
    log_sd: float


QUADRATURE_POINTS = 20  # for the spread of alpha plus preload
UNIT_TOLERANCE = 1e-6  # relative difference of a derived parameter that is stated as well


class TissueLibrary(ConfigModel):
    """The tissue profiles among which Graspwatch decides.

    `units` is None in recordings from before units were stated, and in learned libraries, whose tool gives the units.
    """

    name: Slug
    title: str
    source: str
    units: LibraryUnits | None = None
    mass_kg: Positive
    jaw_area_m2: Positive
    spread: ParameterSpread
    learned: LearnedLibrary | None = None
    tissues: dict[Slug, TissueProfile] = Field(min_length=1)

    @classmethod
    def complete(cls, content: dict[str, Any]) -> dict[str, Any]:
        """Derive alpha (N) and beta (1/m) from alpha-bar (Pa), beta-bar (per strain), jaw area and thickness.

        With missing or misspelled units, too: the units are then the fault that is reported.
        """
        tissues = content.get("tissues")
        units = content.get("units", LibraryUnits.NEWTON_AND_METER if "learned" in content else None)
        if units == LibraryUnits.NEWTON_AND_METER or not isinstance(tissues, dict):
            return content
        return {**content, "tissues": {name: _derive_parameters(content, each) for name, each in tissues.items()}}

    @model_validator(mode="after")
    def _parameters_agree(self) -> Self:
        if self.units is not LibraryUnits.PASCAL_AND_STRAIN:
            return self
        for name, tissue in self.tissues.items():
            if tissue.alpha_pa is None or tissue.beta_per_strain is None:
                raise ValueError(f"{name}: a library in pascal and strain states alpha_pa and beta_per_strain")
            derived = tissue.alpha_pa * self.jaw_area_m2, tissue.beta_per_strain / tissue.thickness_m
            if not np.allclose((tissue.alpha_n, tissue.beta_per_m), derived, rtol=UNIT_TOLERANCE):
                raise ValueError(
                    f"{name}: alpha_n and beta_per_m are not the {derived[0]:.6g} N and {derived[1]:.6g} 1/m that "
                    "alpha_pa, beta_per_strain, thickness_m and jaw_area_m2 give; leave them out"
                )
        return self

    def check_units(self, where: str) -> None:
        """Refuse a library file that does not say in which units its parameters are.

        Raises:
            ConfigurationError: the units are not stated; the text begins with `where`.
        """
        if self.units is None and self.learned is None:
            raise ConfigurationError(
                f"{where}: the library does not say in which units alpha and beta are. Earlier versions took alpha of "
                "the paper's Table II for mN, which makes liver twenty times too stiff. If this one was copied from "
                "such a library, take `porcine`, or state alpha_pa and beta_per_strain of each tissue with "
                'units = "pascal and strain". If alpha was measured in newtons on your tool, add '
                'units = "newton and meter".'
            )

    def check_learned(self, where: str) -> None:
        """Refuse a learned library of a version that judged spots otherwise.

        Raises:
            ConfigurationError: an earlier version learned it; the text begins with `where`.
        """
        if self.learned and self.learned.session_scale is not None:
            raise ConfigurationError(
                f"{where}: an earlier version learned this library, and took spots of one tissue for more alike than "
                "they are. Learn it anew with `graspwatch learn`."
            )

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

    def compute_apparent_alpha(self, tissue: str) -> ApparentAlpha:
        """Return the alpha that a grasp of the tissue shows: of a fold, alpha plus preload."""
        profile, spread = self.tissues[tissue], self.spread_of(tissue)
        if profile.preload_n is None:
            return ApparentAlpha(profile.alpha_n, spread.log_alpha)
        at, weight = np.polynomial.legendre.leggauss(QUADRATURE_POINTS)
        preload_n = np.exp(np.interp(at, (-1.0, 1.0), np.log(profile.preload_n)))
        deviation, density = np.polynomial.hermite_e.hermegauss(QUADRATURE_POINTS)
        alpha_n = profile.alpha_n * np.exp(spread.log_alpha * deviation)
        held = np.log(alpha_n[:, None] + preload_n)
        share = np.outer(density, weight) / (density.sum() * weight.sum())
        mean = float(np.sum(share * held))
        return ApparentAlpha(math.exp(mean), math.sqrt(float(np.sum(share * (held - mean) ** 2))))

    def threshold_n(self, tissue: str) -> float:
        """Return the force at which injury begins, N: threshold pressure times jaw area."""
        return self.tissues[tissue].threshold_pa * self.jaw_area_m2

    def convert_thresholds_to_displayed_n(self, tool: Tool) -> dict[str, float]:
        """Return the displayed force of `tool` at which each tissue may be injured, N."""
        return {name: tool.to_displayed_n(self.threshold_n(name)) for name in self.tissues}

    @property
    def lowest_threshold_n(self) -> float:
        return min(self.threshold_n(name) for name in self.tissues)


def _derive_parameters(library: dict[str, Any], tissue: Any) -> Any:
    """Return a tissue's table with `alpha_n` and `beta_per_m`, unless it states them.

    Without the numbers for them they are 1: validation refuses such a table for the numbers that are missing.
    """
    if not isinstance(tissue, dict) or not ({"alpha_pa", "beta_per_strain"} & tissue.keys() or library.get("units")):
        return tissue
    area, alpha, beta, thickness = (
        library.get("jaw_area_m2"),
        *(tissue.get(key) for key in ("alpha_pa", "beta_per_strain", "thickness_m")),
    )
    derived = {
        "alpha_n": alpha * area if _is_positive(area) and _is_positive(alpha) else 1.0,
        "beta_per_m": beta / thickness if _is_positive(beta) and _is_positive(thickness) else 1.0,
    }
    return {**derived, **tissue}


def _is_positive(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and 0 < value < 1e300


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


class ByHandWaveform(ConfigModel):
    """No motor command: a person closes the jaws any number of times, until the run is stopped."""

    shape: Literal["by_hand"]
    duration_s: Annotated[float, Field(gt=0, le=3600)] = 1800.0
    """Time after which the run ends by itself, s."""

    @property
    def grasp_s(self) -> float:
        return self.duration_s

    @property
    def cycle_s(self) -> float:
        return self.duration_s


REFERENCE_PROTOCOL = "reference_grasp"
"""Name of the shipped protocol for reference grasps."""


class GraspProtocol(ConfigModel):
    """A named waveform and its default number of repetitions."""

    name: Slug
    title: str
    lead_in_s: Annotated[float, Field(ge=0.25, le=60)] = 0.5
    cycles: Annotated[int, Field(ge=1, le=10_000)] = 1
    waveform: Annotated[
        TrapezoidWaveform | SineWaveform | CustomWaveform | ByHandWaveform, Field(discriminator="shape")
    ]

    @property
    def is_reference_grasp(self) -> bool:
        """Whether a run of it is a reference grasp, with empty jaws; no own protocol can have this name."""
        return self.name == REFERENCE_PROTOCOL

    def is_for(self, tool: Tool) -> bool:
        """Whether it fits such a tool: one with a motor, or one without. A tool for recordings shows all."""
        by_hand = isinstance(self.waveform, ByHandWaveform)
        return tool.kind is ToolKind.RECORDING or by_hand is not tool.has_motor


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
    tls_cert: HomePath | None = None
    tls_key: HomePath | None = None
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
                raise ValueError(
                    f"{host!r} is no name: write it as in `grasp.example` or `[::1]`, without a port or a path"
                )
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


class LaboratorySettings(ConfigModel):
    """Form of the subjects' codes, the laboratory's own fields of a session, and whether a run needs a session.

    `subject_pattern` is a regular expression for the whole code, which must not be a name. With `session_required`, a
    real tool starts no run without a session.
    """

    subject_pattern: Annotated[str, Field(min_length=1, max_length=200)] = r"[A-Z]{1,4}-?[0-9]{1,6}"
    fields: tuple[Annotated[str, Field(min_length=1, max_length=40)], ...] = ()
    session_required: bool = False

    @field_validator("subject_pattern")
    @classmethod
    def _is_pattern(cls, pattern: str) -> str:
        try:
            re.compile(pattern)
        except re.error as error:
            raise ValueError(f"no regular expression: {error}") from None
        return pattern


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
    """Where warnings begin: shares of the threshold in force, with their hysteresis, and the dose on one spot."""

    low: Probability = 0.7
    medium: Probability = 0.9
    high: Annotated[float, Field(gt=0, le=1)] = 1.0
    hysteresis: Probability = 0.05
    # True force over time on one spot at which a warning begins, N s. Porcine colon in vivo showed changes under the
    # microscope above 300 N s (PMC6132882).
    spot_dose_n_s: Positive = 300.0

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

    tool: HomePath = "simulated"
    library: HomePath = "porcine"
    data_folder: HomePath = "graspwatch-data"
    index_url: SecretStr | None = None  # it may contain a password, so it is never shown
    server: ServerSettings = ServerSettings()
    people: PeopleSettings = PeopleSettings()
    laboratory: LaboratorySettings = LaboratorySettings()
    conditioning: ConditioningSettings = ConditioningSettings()
    identification: IdentificationSettings = IdentificationSettings()
    safety: ArmingSettings = ArmingSettings()
    realtime: RealtimeSettings = RealtimeSettings()
    limiter: LimiterSettings = LimiterSettings()
    warnings: WarningSettings = WarningSettings()
    recording: RecordingSettings = RecordingSettings()
    logs: LogSettings = LogSettings()
    foxglove: FoxgloveSettings = FoxgloveSettings()
