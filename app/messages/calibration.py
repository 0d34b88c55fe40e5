"""Messages about the calibration of the tool."""

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from app.messages.base import Message, Request


class CalibrationKind(StrEnum):
    """The kind of a calibration."""

    TARE = "tare"
    STRAIN = "strain"
    FORCE = "force"
    STRETCH = "stretch"
    GEOMETRY = "geometry"


class CalibrationRequest(Request):
    """Request to begin a calibration of the tool, without tissue."""

    what: CalibrationKind
    values: Annotated[list[Annotated[float, Field(ge=0, le=1000)]], Field(max_length=50)] = Field(
        default_factory=list,
        description="Pulls on the handle, N (strain), forces on a load cell between the jaws, N (force), or gauge "
        "blocks between the jaws, mm (geometry)",
    )
    person: Annotated[str, Field(max_length=60)] | None = None
    valid_days: Annotated[int, Field(ge=1, le=3650)] = 90
    load_cell_error: Annotated[float, Field(ge=0, le=0.2)] = Field(
        default=0.01, description="Error of the load cell as a share of its reading (force). It widens the interval"
    )


class CalibrationReading(Message):
    """One reading: its weight or gauge block, and the mean signals; in motion, relative to rest and open jaws."""

    value: float
    strain_v: float
    encoder_deg: float


class Constant(Message):
    """A constant of the tool file as measured, with its 95 % confidence interval."""

    key: str
    value: float
    low: float
    high: float
    unit: str
    residual: float = Field(description="RMS of the residuals of the fit")
    residual_unit: str
    readings: int
    before: float | None


class CalibrationResult(Message):
    """The fitted constants, the tool file that holds them, and the plot."""

    file: str
    constants: list[Constant]
    remarks: list[str]
    axes: list[str]
    x: list[float]
    y: list[float]
    line_x: list[float]
    line_y: list[float]


class Calibration(Message):
    """State of the calibration under way, or of the last one."""

    what: CalibrationKind | None
    values: list[float] = Field(description="Values of all readings, in order")
    readings: list[CalibrationReading]
    reading: bool = Field(description="Whether a reading is being taken")
    problem: str | None = Field(description="Why the last reading or the fit was refused")
    result: CalibrationResult | None
