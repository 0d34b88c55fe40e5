"""The table of signals: the name, unit, type, source and meaning of each channel of a sample.

What follows from it: the channels and their order in the driver (`drivers/nidaq.py`), in the simulated board and in
LabVIEW logs; the dtype of samples (`sample_block.py`); the rows of a recording (`recordings/mcap_layout.py`) and the
columns of an export; the channels on the wire (`app/stream/frames.py`) and the lines of the dashboard's charts.
`docs/extending.md` shows how to add a channel.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

from config.errors import ConfigurationError
from config.schema import Channels


class Source(StrEnum):
    """Where a signal comes from."""

    COUNT = "count"
    """Count of the samples."""
    INPUT = "analog input"
    """Analog input of the board."""
    ENCODER = "encoder"
    """Counter of the board with the motor's encoder."""
    COMPUTED = "computed"
    """Computed from the inputs (`signals/pipeline.py`)."""
    LIMITER = "limiter"
    """Set by the force limiter."""


class LineStyle(StrEnum):
    """Look of a line in a chart. Later ones are drawn over earlier ones."""

    RAW = "raw"
    MEASURED = "measured"
    SECOND = "second"
    LIMIT = "limit"


@dataclass(frozen=True, slots=True)
class Trace:
    """A signal's line on the dashboard. A chart other than `force` and `displacement` gets a strip of its own."""

    chart: str
    line: LineStyle
    label: str


@dataclass(frozen=True, slots=True)
class Signal:
    """One channel.

    `raw` and `conditioned` are its field numbers in the rows `/raw` and `/conditioned` of a recording, `frame` is its
    place among the columns of a frame; None: the signal is not there. A new signal takes the next free number, so that
    the others keep theirs. Fields 7 and 8 of `/raw` are no signals (`recordings/mcap_layout.py`). `wired` returns the
    terminal of an analog input; without it, the tool file names the terminal in `channels.other`. An `optional` signal
    is NaN if the tool or the recording lacks it.
    """

    name: str
    unit: str  # SI symbols; empty: a number without a unit
    dtype: str
    source: Source
    meaning: str
    title: str = ""  # of a sensor, in messages
    raw: int | None = None
    conditioned: int | None = None
    frame: int | None = None
    wired: Callable[[Channels], str] | None = None
    optional: bool = False
    trace: Trace | None = None


# The order is that of samples in memory, of the columns of exports, and of the inputs in the driver.
# fmt: off
SIGNALS = (
    Signal("tick", "", "i8", Source.COUNT, raw=1, conditioned=1,
           meaning="Samples since the source was opened, lost ones included"),

    # as the sensors give them
    Signal("strain_v", "V", "f8", Source.INPUT, wired=lambda channels: channels.strain, raw=2, frame=1,
           title="the strain gage", meaning="Strain gage of the drive, with its rest voltage"),
    Signal("encoder_deg", "deg", "f8", Source.ENCODER, raw=3, frame=2,
           title="the encoder", meaning="Encoder of the motor, after the gearbox"),
    Signal("motor_command_v", "V", "f8", Source.INPUT, wired=lambda channels: channels.motor_command_readback,
           raw=4, frame=3,
           title="the motor command", meaning="Motor command, read back"),
    Signal("touch_1_v", "V", "f8", Source.INPUT, wired=lambda channels: channels.touch[0], raw=5,
           title="touch sensor 1", meaning="Touch sensor of the first jaw"),
    Signal("touch_2_v", "V", "f8", Source.INPUT, wired=lambda channels: channels.touch[1], raw=6,
           title="touch sensor 2", meaning="Touch sensor of the second jaw"),

    # at the jaws
    Signal("jaw_force_n", "N", "f8", Source.COMPUTED, conditioned=2, frame=4,
           trace=Trace("force", LineStyle.RAW, "unfiltered"),
           meaning="Jaw force, unfiltered: input of estimator and limiter"),
    Signal("jaw_displacement_m", "m", "f8", Source.COMPUTED, conditioned=3, frame=6,
           trace=Trace("displacement", LineStyle.RAW, "unfiltered"),
           meaning="Jaw displacement since the encoder's zero, unfiltered"),
    Signal("newton_per_volt", "N/V", "f8", Source.COMPUTED, conditioned=4,
           meaning="Derivative of the jaw force by the strain voltage, for its noise"),
    Signal("metre_per_volt", "m/V", "f8", Source.COMPUTED, conditioned=5,
           meaning="Derivative of the jaw displacement by the strain voltage, for its noise"),
    Signal("jaw_force_filtered_n", "N", "f8", Source.COMPUTED, conditioned=6, frame=5,
           trace=Trace("force", LineStyle.MEASURED, "filtered"),
           meaning="Jaw force after the Butterworth filter, for display"),
    Signal("jaw_displacement_filtered_m", "m", "f8", Source.COMPUTED, conditioned=7, frame=7,
           trace=Trace("displacement", LineStyle.MEASURED, "filtered"),
           meaning="Jaw displacement after the Butterworth filter, for display"),
    Signal("tissue_displacement_m", "m", "f8", Source.COMPUTED, conditioned=8, frame=8,
           trace=Trace("displacement", LineStyle.SECOND, "in tissue"),
           meaning="Jaw displacement since contact; NaN before contact"),
    Signal("limit_n", "N", "f8", Source.LIMITER, raw=9, frame=9, optional=True,  # recordings of older versions lack it
           trace=Trace("force", LineStyle.LIMIT, "limit"),
           meaning="Limit that the limiter enforced at this sample; NaN without one"),

    # of the grasp
    Signal("grasp", "", "i8", Source.COMPUTED, conditioned=9,
           meaning="Number of the grasp: 1, 2, ...; 0 before the first"),
    Signal("grasp_start_tick", "", "i8", Source.COMPUTED, conditioned=10,
           meaning="Tick at which the command left zero; -1 before the first grasp"),
    Signal("contact_tick", "", "i8", Source.COMPUTED, conditioned=11,
           meaning="Tick of first contact; -1 before contact"),
    Signal("wall_tick", "", "i8", Source.COMPUTED, conditioned=12,
           meaning="Tick at which the jaws were shut; -1 before"),
    Signal("flags", "", "u2", Source.COMPUTED, conditioned=13,
           meaning="Bits of SampleFlag (acquisition/sample_block.py)"),
)
# fmt: on

SENSOR_SIGNALS = tuple(each for each in SIGNALS if each.source in (Source.INPUT, Source.ENCODER))
"""The signals that a board measures, and a `RawBlock` holds."""


def find_wired_inputs(channels: Channels) -> dict[str, str]:
    """Return the terminal of each analog input that the tool has, by signal, in the order of the table.

    Raises:
        ConfigurationError: the tool file names a signal that is no analog input, or has a place of its own.
    """
    inputs = [each for each in SIGNALS if each.source is Source.INPUT]
    free = [each.name for each in inputs if each.wired is None]
    other = {each.signal: each.input for each in channels.other}
    if unknown := [name for name in other if name not in free]:
        raise ConfigurationError(
            f"channels.other: {', '.join(unknown)} is no further analog input; there is {', '.join(free) or 'none'}. "
            "Correct the name, or add the signal to acquisition/signal_table.py (docs/extending.md)."
        )
    terminals = {each.name: each.wired(channels) if each.wired else other.get(each.name) for each in inputs}
    return {name: terminal for name, terminal in terminals.items() if terminal}


def find_analog_inputs(channels: Channels) -> dict[str, str]:
    """Return `find_wired_inputs`, and last the analog position sensor, if there is one, as `encoder_deg`.

    Raises:
        ConfigurationError: as `find_wired_inputs`.
    """
    position = {"encoder_deg": channels.position.input} if channels.position else {}
    return find_wired_inputs(channels) | position


def list_numbered_names(place: str, numbers: Iterable[tuple[int | None, str]]) -> list[str]:
    """Return the names that have a number, in the order of the numbers; leave out names whose number is None.

    Raises:
        RuntimeError: the numbers are not 1, 2, ... without a gap; `place` is where they are used.
    """
    numbered = sorted((number, name) for number, name in numbers if number is not None)
    if [number for number, _ in numbered] != list(range(1, len(numbered) + 1)):
        raise RuntimeError(
            f"{place}: the numbers in acquisition/signal_table.py must be 1, 2, ... without a gap; they are "
            f"{', '.join(f'{number} {name}' for number, name in numbered)}"
        )
    return [name for _, name in numbered]
