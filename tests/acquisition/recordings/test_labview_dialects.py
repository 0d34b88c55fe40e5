"""LabVIEW files of other laboratories: what their headers say of numbers and times is followed, or refused by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labview import ANGLE_UNITS, NAMES, TIME_UNITS, VOLTAGE_UNITS, Dialect, log_text, made_up_grasp, write_log

from acquisition.recordings.labview import read_labview_log, read_lvm
from acquisition.recordings.recording import RecordingSource
from config.errors import RecordingError
from config.load import load_tool

TOOL = load_tool("smart_tool_2013")
SAMPLES = made_up_grasp()
NOON_NS = 1_709_633_472_500_000_000  # 2024-03-05 10:11:12.5


def fault_of(path: Path, text: str, tool=TOOL) -> str:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RecordingError) as caught:
        read_lvm(path, tool)
    assert str(caught.value).startswith(f"{path}, line ")
    return str(caught.value)[len(str(path)) + 2 :]


def edited(name: str, cells: str, dialect: Dialect | None = None) -> tuple[str, int]:
    """The text of a file with other cells in a line of its segment's header, and the number of that line."""
    lines = log_text(SAMPLES, dialect or Dialect()).splitlines()
    at = max(i for i, line in enumerate(lines) if line.split("\t")[0] == name)
    lines[at] = f"{name}\t{cells}"
    return "\n".join(lines) + "\n", at + 1


def column(values: list[str]) -> str:
    return "\t".join(values)


separators = st.sampled_from([("\t", "."), ("\t", ","), (",", "."), (";", "."), (";", ",")])
namings = st.sampled_from(
    [
        NAMES,
        tuple(name.removeprefix("Dev1/") for name in NAMES),
        (*NAMES[:4], "ctr0"),
        (*NAMES[:4], "Dev1/ctr0"),
        ("dev1/AI0", *NAMES[1:]),
    ]
)


@settings(deadline=None)
@given(
    marks=separators,
    names=namings,
    x_columns=st.sampled_from(["No", "One", "Multi"]),
    volts=st.sampled_from(sorted(VOLTAGE_UNITS)),
    angle=st.sampled_from(sorted(ANGLE_UNITS)),
    time=st.sampled_from(sorted(TIME_UNITS)),
    segments=st.integers(1, 3),
    line_end=st.sampled_from(["\n", "\r\n", "\r"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
    ending=st.sampled_from([".lvm", ".LVM", ".lvm.gz", ".LVM.GZ"]),
    special=st.booleans(),
    comment=st.sampled_from(["", "grasp 1", "Größe"]),
)
def test_the_same_samples_are_read_from_every_way_of_writing_them(
    tmp_path_factory,
    marks,
    names,
    x_columns,
    volts,
    angle,
    time,
    segments,
    line_end,
    encoding,
    ending,
    special,
    comment,
):
    dialect = Dialect(*marks, x_columns, names, volts, angle, time, segments=segments)
    dialect = replace(dialect, line_end=line_end, encoding=encoding, special=special, comment=comment)
    path = write_log(tmp_path_factory.getbasetemp() / f"log{ending}", SAMPLES, dialect)
    log = read_labview_log(path, TOOL)
    np.testing.assert_allclose(log.table[:, 0], np.arange(len(SAMPLES)) / 1000, atol=1e-9)
    np.testing.assert_allclose(log.table[:, 1:], SAMPLES, rtol=1e-9, atol=1e-9)
    assert log.find_start_ns()[0] == NOON_NS
    told = " ".join(log.remarks)
    assert ("converted from" in told) == (VOLTAGE_UNITS[volts] != 1.0 or ANGLE_UNITS[angle] != 1.0)
    assert ("separated by" in told) == (marks[0] != "\t")


@pytest.mark.parametrize(
    "unit", ["N", "kN", "mN", "g", "mm", "Ohm", "V/V", "mV/V", "Newtons", "deg", "A", "ticks", "%"]
)
def test_a_voltage_in_another_quantity_is_refused_with_line_column_and_unit(tmp_path: Path, unit: str) -> None:
    text, line = edited("Y_Unit_Label", column([unit, *["Volts"] * 3, "Degrees"]))
    told = fault_of(tmp_path / "r.lvm", text)
    assert told.startswith(f"line {line}, column 2: 'Dev1/ai0' is in {unit!r}")
    assert "V or mV" in told


@pytest.mark.parametrize("unit", ["V", "mm", "m", "counts", "Ticks", "N m", "Hz", "gon"])
def test_an_angle_in_another_quantity_is_refused_with_line_column_and_unit(tmp_path: Path, unit: str) -> None:
    text, line = edited("Y_Unit_Label", column([*["Volts"] * 4, unit]))
    told = fault_of(tmp_path / "r.lvm", text)
    assert told.startswith(f"line {line}, column 6: 'Untitled' is in {unit!r}")
    assert "deg or rad" in told


def test_a_dimension_without_a_unit_is_followed_too(tmp_path: Path) -> None:
    text, line = edited("Y_Unit_Label", column([""] * 5))
    lines = text.splitlines()
    lines.insert(line, "Y_Dimension\t" + column(["Force", *["Electric_Potential"] * 3, "Angle"]))
    told = fault_of(tmp_path / "r.lvm", "\n".join(lines) + "\n")
    assert told.startswith(f"line {line + 1}, column 2: 'Dev1/ai0' is in 'Force'")


@pytest.mark.parametrize(
    ("name", "cells", "told"),
    [
        ("X_Dimension", ["Frequency", *["Time"] * 4], "column 2: 'Dev1/ai0' is over 'Frequency'"),
        ("X_Dimension", [*["Time"] * 4, "Length"], "column 6: 'Untitled' is over 'Length'"),
        ("Delta_X", ["0.002", *["0.001"] * 4], "column 3: 'Dev1/ai2' has another step"),
        ("Delta_X", [*["0.001"] * 4, "0.01"], "column 6: 'Untitled' has another step (0.01 s"),
        ("Delta_X", ["0.002"] * 5, "column 2: says 0.002 s between samples, but the times advance by 0.001 s"),
        ("Delta_X", ["often", *["0.001"] * 4], "column 2: expected Delta_X as a number, found 'often'"),
        ("X0", [*["0"] * 4, "0.5"], "column 6: 'Untitled' has another first time"),
        ("Time", [*["10:11:12.5"] * 4, "10:11:13.5"], "column 6: 'Untitled' has a start that is 1 s later"),
    ],
)
def test_times_that_contradict_each_other_are_refused_with_line_and_column(
    tmp_path: Path, name: str, cells: list[str], told: str
) -> None:
    text, line = edited(name, column(cells))
    assert fault_of(tmp_path / "r.lvm", text).startswith(f"line {line}, {told}")


def test_a_counter_without_timing_counts_row_by_row_as_in_the_labs_own_files(tmp_path: Path) -> None:
    text, _ = edited("Delta_X", column([*["0.001"] * 4, "1.000000"]))
    text = text.replace("Time\t" + column(["10:11:12.5"] * 5), "Time\t" + column([*["10:11:12.5"] * 4, "10:11:13.5"]))
    (tmp_path / "r.lvm").write_text(text, encoding="utf-8")
    np.testing.assert_allclose(read_lvm(tmp_path / "r.lvm", TOOL)[:, 1:], SAMPLES, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("late", [1, 7, 30])
def test_a_channel_that_begins_later_is_aligned_by_its_own_times(tmp_path: Path, late: int) -> None:
    lines = log_text(SAMPLES, Dialect(x_columns="Multi")).splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("X_Value")) + 1
    for i in range(len(SAMPLES)):
        cells = lines[first + i].split("\t")
        cells[8] = f"{(i + late) / 1000:.6f}"
        lines[first + i] = "\t".join(cells)
    path = tmp_path / "r.lvm"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    log = read_labview_log(path, TOOL)
    np.testing.assert_allclose(log.table[:, 0], np.arange(late, len(SAMPLES)) / 1000, atol=1e-9)
    np.testing.assert_allclose(log.table[:, 1], SAMPLES[late:, 0], rtol=1e-9)
    np.testing.assert_allclose(log.table[:, 5], SAMPLES[:-late, 4], rtol=1e-9, atol=1e-9)
    assert f"{len(SAMPLES) - late} samples have a value of each" in " ".join(log.remarks)


def test_a_channel_that_ends_earlier_leaves_its_cells_empty(tmp_path: Path) -> None:
    lines = log_text(SAMPLES, Dialect(x_columns="Multi")).splitlines()
    for i in range(1, 11):
        cells = lines[-i].split("\t")
        cells[2] = cells[3] = ""
        lines[-i] = "\t".join(cells)
    path = tmp_path / "r.lvm"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    np.testing.assert_allclose(read_lvm(path, TOOL)[:, 1:], SAMPLES[:-10], rtol=1e-9, atol=1e-9)


def test_times_between_two_samples_are_refused(tmp_path: Path) -> None:
    lines = log_text(SAMPLES, Dialect(x_columns="Multi")).splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("X_Value")) + 1
    for i in range(len(SAMPLES)):
        cells = lines[first + i].split("\t")
        cells[8] = f"{(i + 0.4) / 1000:.6f}"
        lines[first + i] = "\t".join(cells)
    told = fault_of(tmp_path / "r.lvm", "\n".join(lines) + "\n")
    assert told.startswith(f"line {first + 1}, column 10: 'Untitled' was sampled 0.400 samples after 'Dev1/ai0'")


@pytest.mark.parametrize("at", range(5))
def test_a_heading_that_stands_twice_is_refused_with_its_columns(tmp_path: Path, at: int) -> None:
    names, samples = (*NAMES[: at + 1], NAMES[at], *NAMES[at + 1 :]), np.insert(SAMPLES, at, 9.9, axis=1)
    text = log_text(samples, Dialect(names=names, angle="", volts=""))
    told = fault_of(tmp_path / "r.lvm", text)
    assert f"the heading {NAMES[at]!r} of " in told
    assert f"stands twice, in columns {at + 2}, {at + 3}" in told


@pytest.mark.parametrize("heading", ["Encoder", "Motor angle (deg)", "Winkel", "a,b", "[enc]"])
def test_a_tool_file_may_name_any_column(tmp_path: Path, heading: str) -> None:
    tool = TOOL.model_copy(update={"channels": TOOL.channels.model_copy(update={"encoder": heading, "strain": "F x"})})
    path = write_log(tmp_path / "r.lvm", SAMPLES, Dialect(names=("F x", *NAMES[1:4], heading)))
    np.testing.assert_allclose(read_lvm(path, tool)[:, 1:], SAMPLES, rtol=1e-9, atol=1e-9)
    told = fault_of(tmp_path / "other.lvm", log_text(SAMPLES, Dialect()), tool)
    assert f"'Dev1/F x', {heading!r} is missing" in told, "a name that is given is not replaced by LabVIEW's own"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("Separator\tTab", "Separator\tComma", "line 3: says that the separator is Comma, but Tab separates"),
        ("Separator\tTab", "Separator\tSpace", "line 3: the separator 'Space' is not known; expected Tab, Comma"),
        ("Decimal_Separator\t.", "Decimal_Separator\t'", "line 4: expected . or , as decimal separator"),
        ("Decimal_Separator\t.", "Decimal_Separator\t,", "the decimal separator of this file is ','"),
        ("X_Columns\tOne", "X_Columns\tTwo", "line 6: X_Columns 'Two' is not known; expected No, One or Multi"),
        ("X_Columns\tOne", "X_Columns\tMulti", "column 3: expected X_Value before 'Dev1/ai2'"),
        ("X_Columns\tOne", "X_Columns\tNo", "column 1: expected an empty cell, as the header says X_Columns No"),
    ],
)
def test_a_header_that_does_not_fit_its_columns_is_named(tmp_path: Path, old: str, new: str, told: str) -> None:
    text = log_text(SAMPLES, Dialect())
    assert old in text
    assert told in fault_of(tmp_path / "r.lvm", text.replace(old, new, 1))


def test_columns_and_decimals_cannot_both_have_commas(tmp_path: Path) -> None:
    text = log_text(SAMPLES, Dialect(separator=",", decimal=","))
    assert "the comma separates columns and decimals" in fault_of(tmp_path / "r.lvm", text)


def test_a_log_without_header_and_one_of_another_rate_say_what_to_do(tmp_path: Path) -> None:
    assert "write it with headers" in fault_of(tmp_path / "r.lvm", "0.000000\t0.82\t0\n0.001000\t0.82\t0\n")
    fast = fault_of(tmp_path / "r.lvm", log_text(SAMPLES, Dialect(), rate_hz=1024.0))
    assert "recorded at 1024 samples a second; the tool file says 1000" in fast
    untimed = log_text(SAMPLES, Dialect(x_columns="No"), rate_hz=1.0)
    assert "recorded at 1 samples a second" in fault_of(tmp_path / "r.lvm", untimed)


# --- dates and times ---


def start_of(path: Path, dialect: Dialect) -> tuple[int | None, str]:
    return read_labview_log(write_log(path, SAMPLES, dialect), TOOL).find_start_ns()


@pytest.mark.parametrize(
    ("date", "clock", "start"),
    [
        ("2024/03/05", "10:11:12.5", "2024-03-05T10:11:12.500000"),
        ("2024/03/05", "10:11:12", "2024-03-05T10:11:12"),
        ("2024/03/05", "10:11:12,5", "2024-03-05T10:11:12.500000"),
        ("2024/03/05", "10:11:12.3172713499427707289", "2024-03-05T10:11:12.317271"),
        ("2024-03-05", "10:11", "2024-03-05T10:11:00"),
        ("2024.3.5", "1:02:03", "2024-03-05T01:02:03"),
        ("05.03.2024", "10:11:12.5 PM", "2024-03-05T22:11:12.500000"),
        ("2024/03/05", "12:00:00 a.m.", "2024-03-05T00:00:00"),
        ("1970/01/01", "00:00:00", "1970-01-01T00:00:00"),
        ("2261/12/31", "23:59:59", "2261-12-31T23:59:59"),
    ],
)
def test_a_date_and_time_are_read_in_each_spelling(tmp_path: Path, date: str, clock: str, start: str) -> None:
    _, told = start_of(tmp_path / "r.lvm", Dialect(date=date, clock=clock))
    assert told.startswith(f"{start}, in a zone that it does not say")


@pytest.mark.parametrize(
    ("date", "clock", "told"),
    [
        ("1904/01/01", "00:00:01.5", "so it was never set"),
        ("1903/12/31", "18:00:00", "so it was never set"),
        ("1969/12/31", "23:59:59", "before 1970 or after 2261"),
        ("2262/01/01", "00:00:00", "before 1970 or after 2261"),
        ("9999/12/31", "00:00:00", "before 1970 or after 2261"),
        ("03/05/2024", "10:11:12", "expected a date as 2024/03/05, year first"),
        ("2024/02/30", "10:11:12", "there is no day '2024/02/30'"),
        ("2024/03/05", "25:00:00", "there is no time of day '25:00:00'"),
        ("2024/03/05", "noon", "expected a time of day"),
    ],
)
def test_a_date_that_cannot_be_kept_is_refused_with_its_line(tmp_path: Path, date: str, clock: str, told: str) -> None:
    with pytest.raises(RecordingError, match=r"line 1[4-6]") as caught:
        start_of(tmp_path / "r.lvm", Dialect(date=date, clock=clock))
    assert told in str(caught.value)


def test_the_samples_own_time_counts_before_the_files_unless_it_was_never_set(tmp_path: Path) -> None:
    path = tmp_path / "r.lvm"
    text = log_text(SAMPLES, Dialect())

    def told(own: tuple[str, str], of_file: tuple[str, str]) -> str:
        lines = text.splitlines()
        for (day, clock), start in ((of_file, 0), (own, 10)):
            count = 5 if start else 1
            for name, value in (("Date", day), ("Time", clock)):
                at = next(i for i in range(start, len(lines)) if lines[i].startswith(f"{name}\t"))
                lines[at] = f"{name}\t" + "\t".join([value] * count)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return read_labview_log(path, TOOL).find_start_ns()[1]

    good, never = ("2017/04/18", "17:15:55.9"), ("1903/12/31", "18:00:00")
    assert told(good, never).startswith("2017-04-18T17:15:55.900000, in a zone")
    assert told(never, good) == "2017-04-18T17:15:55.900000, in a zone that it does not say, from the file's header"
    assert told(good, ("2024/03/05", "10:11:12")).startswith("2017-04-18T17:15:55.900000")


def test_a_start_at_a_later_first_time_is_that_of_the_first_sample(tmp_path: Path) -> None:
    lines = log_text(SAMPLES, Dialect()).splitlines()
    del lines[-len(SAMPLES) : -len(SAMPLES) + 20]
    path = tmp_path / "r.lvm"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert read_labview_log(path, TOOL).find_start_ns()[0] == NOON_NS + 20_000_000


def test_absolute_times_of_the_samples_are_their_own_date(tmp_path: Path) -> None:
    text = log_text(SAMPLES, Dialect()).replace("Time_Pref\tRelative", "Time_Pref\tAbsolute")
    lines = text.splitlines()
    first = len(lines) - len(SAMPLES)
    for i in range(first, len(lines)):
        _, _, rest = lines[i].partition("\t")
        lines[i] = f"{3_792_478_272.5 + (i - first) / 1000:.3f}\t{rest}"  # since 1904
    path = tmp_path / "r.lvm"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    start_ns, told = read_labview_log(path, TOOL).find_start_ns()
    assert (start_ns, told) == (NOON_NS, "2024-03-05T10:11:12.500000, UTC, from the times of the samples")


def test_a_log_that_says_no_date_says_so(tmp_path: Path) -> None:
    lines = [line for line in log_text(SAMPLES, Dialect()).splitlines() if not line.startswith(("Date\t", "Time\t"))]
    path = tmp_path / "r.lvm"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert read_labview_log(path, TOOL).find_start_ns() == (None, "not said")


def test_segments_follow_by_their_dates_with_the_gap_between_them(tmp_path: Path) -> None:
    first, second = (log_text(part, Dialect()).splitlines() for part in np.split(SAMPLES, 2))
    header = next(i for i, line in enumerate(second) if line.startswith("Channels")) - 1
    tail = "\n".join(second[header:]).replace("10:11:12.5", "10:11:12.55")
    path = tmp_path / "r.lvm"
    path.write_text("\n".join(first) + "\n" + tail + "\n", encoding="utf-8")
    recording = RecordingSource(path, TOOL)
    blocks = list(iter(recording.read_block, None))
    assert [(block.first_tick, len(block), block.lost_samples) for block in blocks] == [(0, 30, 0), (50, 30, 20)]
