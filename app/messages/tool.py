"""Messages about the tool, its library and its protocols."""

from pydantic import Field

from acquisition.safety_state_machine import Safety
from app.messages.base import Message, PersonName, Reason, Request
from config.schema import ForceLaw, ToolKind

UNMEASURED_SCALE_DESCRIPTION = (
    "Why a real tool may be armed although its force scale is not measured: an admin's reason, for the journal"
)


class HoldableInfo(Message):
    """A tissue that the simulated grasper can hold."""

    name: str
    title: str
    in_library: bool


class SpreadInfo(Message):
    """Standard deviations between specimens of a tissue, of natural logarithms."""

    log_alpha: float
    log_beta: float
    log_damping: float
    log_thickness: float


class TissueInfo(Message):
    """A tissue profile of the library in use."""

    name: str
    title: str
    alpha_n: float = Field(description="Of tissue held as a fold, with its preload")
    beta_per_m: float
    damping_kg_per_s: float
    thickness_m: float
    threshold_n: float
    threshold_pa: float
    spread: SpreadInfo


class LibraryInfo(Message):
    """The tissue library in use."""

    name: str
    title: str
    source: str
    mass_kg: float
    jaw_area_m2: float
    tissues: list[TissueInfo]


class ForceScaleInfo(Message):
    """The force scale, whose true value lies between `low` and `high`."""

    law: ForceLaw = Field(
        default=ForceLaw.EQUATION_2,
        description="`eq2`: jaw force is Eq. (2) times `value`; `constant`: strain over rest times `value`, N/V",
    )
    value: float
    low: float
    high: float
    measured: bool
    source: str
    date: str | None
    expires: str | None
    text: str = Field(description="The force scale in words, to show beside newtons")


class ConstantInfo(Message):
    """A calibrated constant of the tool file, with its measurement date."""

    constant: str = Field(description="Key of the constant in the tool file")
    value: float
    date: str
    by: str = Field(description="Person who measured the constant, or its source")
    expires: str | None = Field(description="Day from which a new measurement is due; null: not given")
    expired: bool


class ToolInfo(Message):
    name: str
    title: str
    kind: ToolKind
    has_motor: bool = Field(default=True, description="Without one nothing is held back: there are only warnings")
    sample_rate_hz: float
    max_command_v: float
    force_ceiling_n: float
    force_scale: ForceScaleInfo
    calibration_date: str = Field(description="Date of the constants that have no date of their own")
    calibrated_by: str


class ProtocolInfo(Message):
    """A protocol with its waveform for a preview: the motor command over one cycle."""

    name: str
    title: str
    cycles: int
    cycle_s: float
    peak_command_v: float
    refused: str | None = Field(description="Why this tool cannot play the protocol, whose waveform is then empty")
    time_s: list[float]
    command_v: list[float]


class ArmRequest(Request):
    """Request to arm or disarm the tool. The body is optional."""

    by: PersonName | None = None
    unmeasured_scale: Reason | None = Field(default=None, description=UNMEASURED_SCALE_DESCRIPTION)


class SafetyReport(Message):
    """The safety state of the tool after it was armed or disarmed."""

    safety: Safety
