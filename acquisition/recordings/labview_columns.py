"""The function that finds the tool's channels among a LabVIEW file's columns, with their units and times."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from acquisition.recordings import labview_time, labview_units
from acquisition.recordings.labview_header import (
    COMMENT_HEADING,
    SEPARATORS,
    X_HEADING,
    LabviewHeader,
    Segment,
    XColumns,
)
from acquisition.signal_table import SENSOR_SIGNALS, find_analog_inputs
from config.errors import RecordingError
from config.schema import Tool

UNTITLED = "Untitled"  # LabVIEW's heading of a signal without a name, such as the counter in the lab's program
COUNTER_PREFIX = "ctr"  # of the physical channels of counters
UNSET_STEP = 1.0  # LabVIEW's step of a signal without timing
MAX_STEP_ERROR = 0.01
MAX_SKEW = 0.5  # samples between the start of two channels in one table, such as the converter's own
UNSET_DIMENSIONS = ("", "electric_potential")  # the second is LabVIEW's default and says nothing
X_FIELDS = ("Y_Unit_Label", "X_Dimension", "X_Unit_Label", "X_Unit", "X0", "Delta_X", "Date", "Time")


class _Quantity(Enum):
    """What a channel measures: its unit here, examples of units, and the dimensions that may be stated."""

    VOLTAGE = (labview_units.VOLT, "V or mV", UNSET_DIMENSIONS)
    ANGLE = (labview_units.DEGREE, "deg or rad", (*UNSET_DIMENSIONS, "angle", "plane_angle"))


class _Channel(NamedTuple):
    """A channel of the tool: what it is, its name in messages, the headings that may name it, and what it measures."""

    what: str
    name: str
    names: tuple[str, ...]
    quantity: _Quantity


@dataclass(frozen=True, slots=True)
class ChannelColumn:
    """The column of a channel, and how its numbers become values and times.

    `factor` converts its values to V or degrees. `x_at` is the column of its times, None if the file has none;
    `x_factor` converts these to seconds. `x0` and `step` are the first time and the step that the header states, s;
    0 where it states none. `start_offset_s` is the start of its times after that of the strain gage's.
    """

    heading: str
    at: int
    factor: float
    x_at: int | None
    x_factor: float
    x0: float
    step: float
    has_no_timing: bool
    start_offset_s: float
    remarks: tuple[str, ...]


def find_columns(path: Path, header: LabviewHeader, segment: Segment, tool: Tool) -> tuple[ChannelColumn, ...]:
    """Return the columns of the analog inputs that the tool has, in the order of the signal table, and of the encoder.

    Raises:
        RecordingError: a column is missing or stands twice, or the header states a unit or times that cannot be
            converted; the text names line, column and unit.
    """
    if header.x_columns is XColumns.MULTI:
        _check_alignment(path, segment)
    places, rate_hz = _find_places(path, header, segment, tool), tool.board.sample_rate_hz
    columns: list[ChannelColumn] = []
    for channel, at in places:
        columns.append(_read_column(path, header, segment, channel, at, columns[0] if columns else None, rate_hz))
    return tuple(columns)


def _list_channels(tool: Tool) -> tuple[_Channel, ...]:
    channels, device = tool.channels, tool.board.device
    titles = {signal.name: signal.title for signal in SENSOR_SIGNALS}
    analog = [(titles[name], terminal) for name, terminal in find_analog_inputs(channels).items()]
    is_counter = channels.encoder.casefold().startswith(COUNTER_PREFIX)  # LabVIEW logs it without its name
    encoder = (f"{device}/{channels.encoder}", channels.encoder, *((UNTITLED,) if is_counter else ()))
    angle = [] if channels.position else [_Channel(titles["encoder_deg"], encoder[-1], encoder, _Quantity.ANGLE)]
    return (
        *(_Channel(what, f"{device}/{name}", (f"{device}/{name}", name), _Quantity.VOLTAGE) for what, name in analog),
        *angle,
    )


def _find_places(path: Path, header: LabviewHeader, segment: Segment, tool: Tool) -> list[tuple[_Channel, int]]:
    """Return each channel with the index of its column."""
    headings, line = segment.headings, segment.headings_line
    if len(headings) == 1 and any(mark in headings[0] for mark in SEPARATORS.values()):
        raise RecordingError(
            f"{path}, line {line}: the separator of this file is {header.separator_name}, but the headings hold none. "
            "Correct the line `Separator` of the header to the one that stands between the columns."
        )
    places, missing = [], []
    if header.x_columns is not XColumns.NO and X_HEADING not in headings:
        missing.append(X_HEADING)
    for channel in _list_channels(tool):
        found = next(filter(None, (_find_heading(headings, name) for name in channel.names)), [])
        if len(found) > 1:
            raise RecordingError(
                f"{path}, line {line}: the heading {headings[found[0]]!r} of {channel.what} stands "
                f"{'twice' if len(found) == 2 else f'{len(found)} times'}, in columns "
                f"{', '.join(str(at + 1) for at in found)}. Rename the columns that are not meant."
            )
        if found:
            places.append((channel, found[0]))
        else:
            missing.append(channel.name)
    if missing:
        raise RecordingError(
            f"{path}, line {line}: column {', '.join(map(repr, missing))} is missing; found "
            f"{', '.join(name for name in headings if name)}. The tool file {tool.name!r} names the channels: name "
            "another one with --tool, or write the headings of this file under [channels] in a copy of it."
        )
    return places


def _find_heading(headings: Sequence[str], name: str) -> list[int]:
    return [
        at
        for at, heading in enumerate(headings)
        if heading.casefold() == name.casefold() and heading not in (X_HEADING, COMMENT_HEADING)
    ]


def _check_alignment(path: Path, segment: Segment) -> None:
    """Check that no header cell stands under a column of times, where it would be taken for no column's."""
    times = [at for at, heading in enumerate(segment.headings) if heading == X_HEADING and at > 0]
    for name in X_FIELDS:
        shifted = next((at for at in times if segment.cell(name, at)), None)
        if shifted is not None:
            raise RecordingError(
                f"{path}, line {segment.line_number(name)}, column {shifted + 1}: {name} "
                f"{segment.cell(name, shifted)!r} "
                "stands over a column of times; with X_Columns Multi it belongs over the values. Correct the line."
            )


def _read_column(
    path: Path,
    header: LabviewHeader,
    segment: Segment,
    channel: _Channel,
    at: int,
    lead: ChannelColumn | None,
    rate_hz: float,
) -> ChannelColumn:
    """Return a channel's column; `lead` is that of the strain gage, whose times count for all in one table."""
    factor, remarks = _read_unit(path, segment, channel, at)
    x_factor = _read_time_unit(path, segment, at)
    x0, step = (_read_number(path, header, segment, name, at) for name in ("X0", "Delta_X"))
    has_no_timing = step == UNSET_STEP and x_factor * rate_hz != 1.0
    x_at = _find_times(path, header, segment, at)
    if x_at is None and not lead and step <= 0:
        raise RecordingError(
            f"{path}, line {segment.end_line}: the header says X_Columns No, and no Delta_X says the time between the "
            f"samples of {segment.headings[at]!r}. Write the file with X_Columns One."
        )
    offset_s = _find_start_offset(path, segment, at, lead.at, rate_hz) if lead and not has_no_timing else 0.0
    column = ChannelColumn(
        segment.headings[at],
        at,
        factor,
        x_at,
        x_factor,
        x0 * x_factor,
        step * x_factor,
        has_no_timing,
        offset_s,
        remarks,
    )
    if header.x_columns is not XColumns.MULTI and lead:
        _check_common_times(path, segment, column, lead, rate_hz)
    return column


def _read_unit(path: Path, segment: Segment, channel: _Channel, at: int) -> tuple[float, tuple[str, ...]]:
    """Return the factor to the channel's unit, and a remark if it is not 1."""
    unit, examples, dimensions = channel.quantity.value
    heading, label = segment.headings[at], segment.cell("Y_Unit_Label", at)
    dimension = segment.cell("Y_Dimension", at)
    factor = labview_units.find_factor(label, unit)
    if factor is None or (not label and dimension.casefold().replace(" ", "_") not in dimensions):
        name = "Y_Unit_Label" if factor is None else "Y_Dimension"
        raise RecordingError(
            f"{path}, line {segment.line_number(name)}, column {at + 1}: {heading!r} is in {label or dimension!r}, but "
            f"{channel.what} is read in {unit}; expected a unit such as {examples}. Convert the column, or name the "
            "right one under [channels] in a copy of the tool file."
        )
    return factor, (f"{heading!r} (column {at + 1}) was converted from {label} to {unit}",) if factor != 1.0 else ()


def _read_time_unit(path: Path, segment: Segment, at: int) -> float:
    """Return the factor from the unit of a column's times to seconds."""
    dimension = segment.cell("X_Dimension", at)
    if dimension.casefold() not in ("", "time"):
        raise RecordingError(
            f"{path}, line {segment.line_number('X_Dimension')}, column {at + 1}: {segment.headings[at]!r} is over "
            f"{dimension!r}; expected Time. Write the signal over time."
        )
    for name in ("X_Unit_Label", "X_Unit"):
        label = segment.cell(name, at)
        factor = labview_units.find_factor(label, labview_units.SECOND)
        if factor is None:
            raise RecordingError(
                f"{path}, line {segment.line_number(name)}, column {at + 1}: the times of {segment.headings[at]!r} "
                "are in "
                f"{label!r}; expected a unit such as s or ms. Convert them."
            )
        if label:
            return factor
    return 1.0


def _read_number(path: Path, header: LabviewHeader, segment: Segment, name: str, at: int) -> float:
    """Return the number that a header line states for a column; 0 if it states none."""
    text = segment.cell(name, at)
    try:
        return header.parse_number(text) if text else 0.0
    except ValueError:
        raise RecordingError(
            f"{path}, line {segment.line_number(name)}, column {at + 1}: expected {name} as a number, found "
            f"{text[:40]!r}; "
            f"{header.decimal_text}."
        ) from None


def _find_times(path: Path, header: LabviewHeader, segment: Segment, at: int) -> int | None:
    """Return the column of a channel's times."""
    match header.x_columns:
        case XColumns.NO:
            return None
        case XColumns.ONE:
            return segment.headings.index(X_HEADING)
        case XColumns.MULTI:
            if at == 0 or segment.headings[at - 1] != X_HEADING:
                raise RecordingError(
                    f"{path}, line {segment.headings_line}, column {at + 1}: expected {X_HEADING} before "
                    f"{segment.headings[at]!r}, as the header says X_Columns Multi. If all channels have the same "
                    "times, correct the header to X_Columns One."
                )
            return at - 1


def _find_start_offset(path: Path, segment: Segment, at: int, lead_at: int, rate_hz: float) -> float:
    """Return how much later than the strain gage's a channel's times start by its own date and time, s."""
    stamps = [(segment.cell("Date", each), segment.cell("Time", each)) for each in (at, lead_at)]
    if stamps[0] == stamps[1] or not all(all(stamp) for stamp in stamps):
        return 0.0
    own_ns, lead_ns = (labview_time.read_stamp_ns(path, segment, each) for each in (at, lead_at))
    if any(labview_time.is_never_set(each) for each in (own_ns, lead_ns)):
        return 0.0
    offset_s = (own_ns - lead_ns) / labview_time.NS_PER_S
    return offset_s if abs(offset_s) * rate_hz > MAX_SKEW else 0.0


def _check_common_times(
    path: Path, segment: Segment, column: ChannelColumn, lead: ChannelColumn, rate_hz: float
) -> None:
    """Check that a channel in one table with the strain gage was sampled at the same times.

    A channel without timing, such as a counter that is read one by one, has LabVIEW's step of 1 and no times.
    """
    if column.x_factor != lead.x_factor:
        name, told = next(n for n in ("X_Unit_Label", "X_Unit") if n in segment.fields), "another unit of time"
    elif column.has_no_timing or lead.has_no_timing or not column.step or not lead.step:
        return
    elif abs(column.step / lead.step - 1.0) > MAX_STEP_ERROR:
        name, told = "Delta_X", f"another step ({column.step:g} s, not {lead.step:g} s)"
    elif abs(column.x0 - lead.x0) * rate_hz > MAX_SKEW:
        name, told = "X0", f"another first time ({column.x0:g} s, not {lead.x0:g} s)"
    elif column.start_offset_s:
        name, told = "Time", f"a start that is {column.start_offset_s:g} s later"
    else:
        return
    raise RecordingError(
        f"{path}, line {segment.line_number(name)}, column {column.at + 1}: {column.heading!r} has {told} than "
        f"{lead.heading!r}, but one column of times. Sample them together, or write the file with X_Columns Multi."
    )
