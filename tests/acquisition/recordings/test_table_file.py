"""Recordings of other programs: what is read from a table, and what a person is told of a wrong file or tool file."""

import csv
import gzip
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nptdms
import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from typer.testing import CliRunner

from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource, read_log
from acquisition.recordings.sample_log import SampleLog
from app.cli.main import app
from config.errors import ConfigurationError, RecordingError
from config.load import CONFIG_DIR, parse_file
from config.schema import Tool

TOOL_TEXT = (CONFIG_DIR / "tools" / "smart_tool_2013.toml").read_text(encoding="utf-8")
TWO_COLUMNS = """
[[table.columns]]
signal = "strain_v"
column = {strain}
unit = "V"
[[table.columns]]
signal = "encoder_deg"
column = {encoder}
unit = "deg"
"""
TIME_MS = '[table]\ntime = {column = 1, unit = "ms"}' + TWO_COLUMNS.format(strain=2, encoder=3)
BY_NAME = '[table]\ntime = {column = "time", unit = "s"}' + TWO_COLUMNS.format(strain='"force"', encoder='"angle"')

COUNT = 300
TIME_S = np.arange(COUNT) / 1000.0
STRAIN_V = 0.82 + np.round(np.sin(TIME_S * 20.0), 6)
ANGLE_DEG = np.round(30.0 * TIME_S - 2.0, 6)
ROWS = list(zip(TIME_S.tolist(), STRAIN_V.tolist(), ANGLE_DEG.tolist(), strict=True))


def tool_with(table: str, rate_hz: float = 1000.0) -> Tool:
    text = TOOL_TEXT.replace("sample_rate_hz = 1000.0", f"sample_rate_hz = {rate_hz}")
    return parse_file(f"{text}\n{table}", Tool, "tool.toml")


def written(path: Path, lines: list[str], end: str = "\n") -> Path:
    path.write_text(end.join(lines) + end, encoding="utf-8", newline="")
    return path


def in_ms(rows: list[tuple[float, float, float]] | None = None) -> list[str]:
    return [f"{time_s * 1e3:.3f}\t{strain:.6f}\t{angle:.6f}" for time_s, strain, angle in rows or ROWS]


def fault_of(path: Path, tool: Tool) -> str:
    with pytest.raises(RecordingError) as caught:
        read_log(path, tool)
    return str(caught.value).removeprefix(str(path))


def check_rows(log: SampleLog) -> None:
    np.testing.assert_array_equal(log.ticks, np.arange(COUNT))
    np.testing.assert_allclose(log.signals["strain_v"], STRAIN_V, atol=1e-9)
    np.testing.assert_allclose(log.signals["encoder_deg"], ANGLE_DEG, atol=1e-9)


# --- formats, written by the libraries that other people use ----------------------------------------------------------


def write_csv(path: Path, **form: Any) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, **form).writerows([("time", "force", "angle"), *ROWS])


def write_quoted_csv(path: Path) -> None:
    write_csv(path, quoting=csv.QUOTE_ALL)


def write_tsv(path: Path) -> None:
    write_csv(path, delimiter="\t")


def write_packed_csv(path: Path) -> None:
    plain = path.with_suffix("")
    write_csv(plain)
    path.write_bytes(gzip.compress(plain.read_bytes()))


def write_commented_blanks(path: Path) -> None:
    np.savetxt(path, ROWS, fmt="%10.6f", header="made by a test\ntime force angle", comments="# ")


def write_tdms(path: Path) -> None:
    columns = dict(zip(("time", "force", "angle"), np.array(ROWS).T, strict=True))
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("bench", name, values) for name, values in columns.items()])


def write_mat(path: Path) -> None:
    table = np.array(ROWS)
    scipy.io.savemat(path, {"time": table[:, 0], "force": table[:, [1]], "angle": table[:, 2], "note": "of a test"})


def write_parquet(path: Path) -> None:
    parquet.write_table(pa.table(dict(zip(("time", "force", "angle"), np.array(ROWS).T, strict=True))), path)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.csv", write_csv),
        ("quoted.csv", write_quoted_csv),
        ("a.tsv", write_tsv),
        ("A.CSV.GZ", write_packed_csv),
        ("a.dat", write_commented_blanks),
        ("a.tdms", write_tdms),
        ("a.mat", write_mat),
        ("a.parquet", write_parquet),
        ("without_known_ending", write_csv),
    ],
)
@pytest.mark.parametrize("places", ["names", "numbers"])
def test_each_format_is_read_by_name_and_by_number(
    tmp_path: Path, name: str, write: Callable[[Path], None], places: str
) -> None:
    write(tmp_path / name)
    numbered = BY_NAME.replace('"time"', "1").replace('"force"', "2").replace('"angle"', "3")
    log = read_log(tmp_path / name, tool_with(BY_NAME if places == "names" else numbered))
    check_rows(log)
    assert log.remarks == ()


def test_decimal_commas_and_headings_with_units_below_are_read(tmp_path: Path) -> None:
    lines = ["Time;Force;Angle", "s;V;deg", *(";".join(str(value).replace(".", ",") for value in row) for row in ROWS)]
    check_rows(
        read_log(
            written(tmp_path / "a.csv", lines), tool_with(BY_NAME.replace("[table]", '[table]\ndecimal = "comma"'))
        )
    )


def test_columns_of_a_matrix_are_named_as_in_matlab(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"data": np.array(ROWS)})
    table = BY_NAME.replace('"time"', '"data(:,1)"').replace('"force"', '"data(:,2)"').replace('"angle"', '"data(:,3)"')
    check_rows(read_log(tmp_path / "a.mat", tool_with(table)))


def test_a_waveform_of_labview_says_its_rate_and_start_itself(tmp_path: Path) -> None:
    about = {"wf_increment": 0.001, "wf_start_time": np.datetime64("2024-03-05T10:11:12.5")}
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        for name, values in (("force", STRAIN_V), ("angle", ANGLE_DEG)):
            writer.write_segment([nptdms.ChannelObject("bench", name, values, properties=about)])
    table = "[table]" + TWO_COLUMNS.format(strain='"force"', encoder='"bench/angle"')
    log = read_log(tmp_path / "a.tdms", tool_with(table))
    check_rows(log)
    assert log.find_start_ns()[0] == 1_709_633_472_500_000_000
    told = fault_of(tmp_path / "a.tdms", tool_with(table.replace("[table]", "[table]\nrate_hz = 500.0", 1), 500.0))
    assert "has 500 samples a second by its times, but 1000 are stated" in told


def test_a_table_without_times_has_those_of_its_rate(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", [f"{strain},{angle}" for _, strain, angle in ROWS])
    check_rows(read_log(path, tool_with("[table]\nrate_hz = 1000.0" + TWO_COLUMNS.format(strain=1, encoder=2))))


def test_times_since_1970_say_when_it_was_recorded(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", [f"{1_709_633_472.5 + row[0]:.6f},{row[1]},{row[2]}" for row in ROWS])
    log = read_log(path, tool_with(TIME_MS.replace('"ms"', '"s"')))
    check_rows(log)
    assert log.find_start_ns()[0] == 1_709_633_472_500_000_000


# --- units ------------------------------------------------------------------------------------------------------------


def scaled_table(strain: str, encoder: str) -> str:
    return TIME_MS.replace('unit = "V"', strain).replace('unit = "deg"', encoder)


@pytest.mark.parametrize(
    ("how", "value"),
    [
        ('unit = "mV"', 0.001),
        ('unit = "uV"\nscale = 1000.0', 0.001),
        ('unit = ""\nscale = 0.005\noffset = -0.5', 0.005 - 0.5),
        ('unit = "V"\nscale = -1.0', -1.0),
    ],
)
def test_a_value_is_converted_then_scaled_then_shifted(tmp_path: Path, how: str, value: float) -> None:
    path = written(tmp_path / "a.csv", ["0,1,0", "1,1,0", "2,1,0"])
    assert read_log(path, tool_with(scaled_table(how, 'unit = "rad"'))).signals["strain_v"] == pytest.approx(value)


@pytest.mark.parametrize(
    ("unit", "degrees"), [("rad", 57.29577951), ("rev", 360.0), ("turn", 360.0), ("mrad", 0.05729577951)]
)
def test_angles_are_converted(tmp_path: Path, unit: str, degrees: float) -> None:
    path = written(tmp_path / "a.csv", ["0,1,1", "1,1,1", "2,1,1"])
    log = read_log(path, tool_with(scaled_table('unit = "V"', f'unit = "{unit}"')))
    assert log.signals["encoder_deg"] == pytest.approx(degrees)


@pytest.mark.parametrize(
    ("strain", "encoder", "told"),
    [
        ('unit = "N"', 'unit = "deg"', "the unit of column 2 does not fit strain_v: 'N' cannot be converted to 'V'"),
        ('unit = "V"', 'unit = "count"', "the unit of column 3 does not fit encoder_deg: 'count' cannot be converted"),
        ('unit = "V"', 'unit = "percent"', "does not fit encoder_deg"),
    ],
)
def test_units_that_do_not_fit_are_refused(tmp_path: Path, strain: str, encoder: str, told: str) -> None:
    message = fault_of(written(tmp_path / "a.txt", in_ms()), tool_with(scaled_table(strain, encoder)))
    assert told in message
    assert 'write unit = "", and as `scale` how many' in message


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('unit = "V"', 'unit = "voltz"', "table.columns.0.unit: Value error, 'voltz' is no known unit"),
        ('unit = "ms"', 'unit = "mV"', "table.time.unit: Value error, 'mV' cannot be converted to 's'"),
        ("column = 2", "column = 0", "table.columns.0.column: Value error, columns count from 1"),
        ('unit = "V"', 'unit = "V"\nscale = 0.0', "table.columns.0.scale: Value error, a factor of 0"),
        ('"encoder_deg"', '"strain_v"', "strain_v has two columns"),
        (
            "[table]",
            '[table]\nseparator = "comma"\ndecimal = "comma"',
            "the comma cannot separate columns and decimals",
        ),
    ],
)
def test_faults_of_the_layout_are_told_when_the_tool_file_is_loaded(old: str, new: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        tool_with(TIME_MS.replace(old, new))
    assert told in str(caught.value)


# --- times ------------------------------------------------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(
    steps_ms=hnp.arrays(int, st.integers(100, 400), elements=st.integers(2, 4)),
    first_ms=st.integers(0, 10**7),
    rate_hz=st.sampled_from([370.0, 400.0, 500.0, 1000.0, 2000.0]),
)
def test_a_smooth_signal_at_jittering_times_comes_back(
    tmp_path_factory: pytest.TempPathFactory, steps_ms: np.ndarray, first_ms: int, rate_hz: float
) -> None:
    time_ms = first_ms + np.cumsum([2, 3, *steps_ms])  # 3: not all times are those of a clock of 500 Hz
    time_s = (time_ms - time_ms[0]) / 1e3
    omega = 2.0 * np.pi * 3.0
    lines = [f"{t},{np.sin(omega * s):.9f},{s:.9f}" for t, s in zip(time_ms, time_s, strict=True)]
    path = written(tmp_path_factory.getbasetemp() / "jitter.csv", lines)
    log = read_log(path, tool_with(TIME_MS, rate_hz))
    at_s = log.ticks / rate_hz
    np.testing.assert_array_equal(log.ticks, np.arange(int(np.floor(time_s[-1] * rate_hz + 1e-6)) + 1))
    # linear interpolation errs by at most (largest step)² / 8 times the second derivative
    error = (0.004**2 / 8.0) * omega**2
    np.testing.assert_allclose(log.signals["strain_v"], np.sin(omega * at_s), atol=error + 1e-8)
    np.testing.assert_allclose(log.signals["encoder_deg"], at_s, atol=1e-8)


def test_a_gap_among_jittering_times_stays_a_gap(tmp_path: Path) -> None:
    time_ms = np.cumsum([0, *random.Random(1).choices([2, 3, 4], k=400)])
    time_ms[200:] += 5000
    path = written(tmp_path / "a.csv", [f"{t},1.0,2.0" for t in time_ms])
    recording = RecordingSource(path, tool_with(TIME_MS))
    lost = [block.lost_samples for block in iter(recording.read_block, None)]
    assert [each for each in lost if each] == [time_ms[200] - time_ms[199] - 1]
    assert recording.duration_s == pytest.approx((time_ms[-1] + 1) / 1000)
    assert any("have 1 gap of more than 10 usual steps" in remark for remark in recording.remarks)
    assert any("were interpolated at 1000 a second" in remark for remark in recording.remarks)


def test_a_missing_sample_of_a_clock_stays_a_lost_sample(tmp_path: Path) -> None:
    log = read_log(written(tmp_path / "a.txt", in_ms([*ROWS[:100], *ROWS[101:]])), tool_with(TIME_MS))
    np.testing.assert_array_equal(log.ticks, np.delete(np.arange(COUNT), 100))
    np.testing.assert_allclose(log.signals["strain_v"], np.delete(STRAIN_V, 100), atol=1e-6)


def test_times_in_whole_milliseconds_of_about_one_kilohertz_are_no_lost_samples(tmp_path: Path) -> None:
    time_ms = np.floor(np.arange(2000) * 1.07)
    log = read_log(written(tmp_path / "a.csv", [f"{t},{t},0.0" for t in time_ms]), tool_with(TIME_MS))
    np.testing.assert_array_equal(log.ticks, np.arange(time_ms[-1] + 1))
    np.testing.assert_allclose(log.signals["strain_v"], log.ticks)


def test_samples_of_one_time_are_averaged(tmp_path: Path) -> None:
    lines = [f"{t // 2 * 2},{t % 2},0.0" for t in range(200)]
    log = read_log(written(tmp_path / "a.csv", lines), tool_with(TIME_MS, 500.0))
    np.testing.assert_allclose(log.signals["strain_v"], 0.5)
    assert "100 samples have the time of the one before" in log.remarks[0]


@pytest.mark.parametrize(
    ("rate_hz", "stated", "told"),
    [
        (1000.0, "rate_hz = 500.0", "has 1000 samples a second by its times, but 500 are stated"),
        (20_000.0, "", "set `board.sample_rate_hz` in the tool file to 1000"),
    ],
)
def test_a_rate_that_the_times_contradict_is_refused(tmp_path: Path, rate_hz: float, stated: str, told: str) -> None:
    tool = tool_with(TIME_MS.replace("[table]", f"[table]\n{stated}"), rate_hz)
    assert told in fault_of(written(tmp_path / "a.txt", in_ms()), tool)


@given(
    share=st.integers(1, 10).map(lambda half: 2 * half + 1),  # odd: no sample is halfway between two ticks
    rate_hz=st.sampled_from([100.0, 370.0, 1000.0]),
    count=st.integers(20, 100),
    lost=st.booleans(),
)
def test_faster_samples_are_averaged_around_each_tick(
    tmp_path_factory: pytest.TempPathFactory, share: int, rate_hz: float, count: int, lost: bool
) -> None:
    time_s = np.arange(count * share) / (share * rate_hz)
    force = np.random.default_rng(count).normal(0.0, 1.0, len(time_s))
    ticks = np.round(time_s * rate_hz).astype(int)
    kept = ~((ticks >= 10) & (ticks < 10 + 12 * lost))  # a gap in the middle
    rows = [f"{1e3 * t:.9f}\t{f:.9f}\t0.0" for t, f in zip(time_s[kept], force[kept], strict=True)]
    path = written(tmp_path_factory.mktemp("fast") / "a.txt", rows)
    log = read_log(path, tool_with(TIME_MS, rate_hz))
    groups = sorted({*ticks[kept].tolist()})
    assert log.ticks.tolist() == groups
    means = [force[kept & (ticks == tick)].mean() for tick in groups]
    np.testing.assert_allclose(log.signals["strain_v"], means, atol=1e-6)
    assert f"were averaged to {rate_hz:g} a second" in log.remarks[-1]


def test_time_that_goes_back_is_refused_with_its_line(tmp_path: Path) -> None:
    rows = [*ROWS[:150], *ROWS[100:]]
    told = fault_of(written(tmp_path / "a.txt", ["% a comment", *in_ms(rows)]), tool_with(TIME_MS))
    assert told.startswith(", line 152: time goes back from 0.149000 to 0.100000 s.")


def test_time_that_stands_still_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", ["5,1.0,2.0"] * 20)
    assert "time does not advance" in fault_of(path, tool_with(TIME_MS))


def test_a_wrong_unit_of_time_is_told_before_it_takes_the_memory(tmp_path: Path) -> None:
    path = written(tmp_path / "a.txt", in_ms())
    assert "has 1 samples a second" in fault_of(path, tool_with(TIME_MS.replace('"ms"', '"s"')))
    assert "spans more than 24 hours" in fault_of(path, tool_with(TIME_MS.replace('"ms"', '"day"')))


# --- damaged lines ----------------------------------------------------------------------------------------------------


def test_a_log_that_begins_and_ends_in_mid_line_is_read(tmp_path: Path) -> None:
    lines = ["3.0\t0.1", *in_ms(), "300.000\t0.8}"]
    log = read_log(written(tmp_path / "a.txt", lines), tool_with(TIME_MS))
    check_rows(log)
    assert log.remarks == ("2 lines are damaged and were left out, first line 1",)


@pytest.mark.parametrize("last", ["300.000\t0.820000\t7.0", "3\t0.820000\t7.000000"])
def test_a_last_line_that_is_cut_off_in_a_number_is_left_out(tmp_path: Path, last: str) -> None:
    path = tmp_path / "a.txt"
    path.write_text("\n".join([*in_ms(), last]))
    log = read_log(path, tool_with(TIME_MS))
    check_rows(log)
    assert log.remarks == ("line 301 is damaged and was left out",)


def test_a_first_line_that_is_cut_off_in_its_time_is_left_out(tmp_path: Path) -> None:
    late = [(row[0] + 200.0, *row[1:]) for row in ROWS]
    lines = in_ms(late)
    log = read_log(written(tmp_path / "a.txt", ["99.000\t0.8\t1.0", *lines]), tool_with(TIME_MS))
    check_rows(log)


def test_a_few_damaged_lines_are_left_out_and_many_refused(tmp_path: Path) -> None:
    lines = in_ms()
    lines[100], lines[200] = "garbage", lines[200] + lines[201]
    log = read_log(written(tmp_path / "a.txt", lines), tool_with(TIME_MS))
    np.testing.assert_array_equal(log.ticks, np.delete(np.arange(COUNT), [100, 200]))
    assert log.remarks == ("2 lines are damaged and were left out, first line 101",)
    for at in range(50, 60):
        lines[at] = "1\t2\tthree"
    told = fault_of(written(tmp_path / "a.txt", lines), tool_with(TIME_MS))
    assert told.startswith(", line 51: expected a number in column 3, found 'three'.")
    assert "12 of 300 lines are damaged, which is more than 1 %" in told


def test_junk_and_blank_lines_and_carriage_returns_are_ignored(tmp_path: Path) -> None:
    table = TIME_MS.replace("[table]", '[table]\nignore_at_line_end = "\\\\"')
    check_rows(read_log(written(tmp_path / "a.txt", in_ms(), "\t\r\\\n\n"), tool_with(table)))


# --- wrong files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "told"),
    [
        (BY_NAME.replace('"force"', '"pull"'), ", line 1: there is no column 'pull'; found time, force, angle."),
        (TIME_MS.replace("column = 3", "column = 7"), ", line 1: has 3 columns, but [table]"),
        (BY_NAME.replace('"encoder_deg"', '"touch_1_v"').replace('"deg"', '"V"'), "names no column for encoder_deg"),
        (BY_NAME.replace('"strain_v"', '"touch_1_v"'), "names no column for strain_v, the force sensor"),
        (
            BY_NAME + '[[table.columns]]\nsignal = "torque"\ncolumn = 2\nunit = ""',
            "there is no signal 'torque'. There is",
        ),
        ("[table]" + TWO_COLUMNS.format(strain=2, encoder=3), "says no times"),
        (TIME_MS.replace("[table]", '[table]\nseparator = "semicolon"'), "numbers that are separated by semicolon"),
    ],
)
def test_a_layout_that_does_not_fit_is_told(tmp_path: Path, table: str, told: str) -> None:
    write_csv(tmp_path / "a.csv")
    assert told in fault_of(tmp_path / "a.csv", tool_with(table))


@pytest.mark.parametrize(
    ("heading", "told"),
    [
        ("time force angle N", ", line 2: there is no column 'force'; found no headings"),
        ("# time of day, force, angle", ", line 1: there is no column 'time'; found time of day, force, angle"),
        ("time,angle,note,force", ", line 1: the heading 'force' stands in column 4, but the samples have 3 columns"),
    ],
)
def test_headings_that_do_not_fit_the_samples_are_told(tmp_path: Path, heading: str, told: str) -> None:
    mark = "," if "," in heading else " "
    path = written(tmp_path / "a.txt", [heading, *(mark.join(map(str, row)) for row in ROWS)])
    assert told in fault_of(path, tool_with(BY_NAME))


def test_an_empty_last_cell_and_a_separator_behind_the_comment_mark_are_no_fault(tmp_path: Path) -> None:
    lines = [f"{t}\t{f}\t{a}\t{'grasp' if at % 50 == 0 else ''}" for at, (t, f, a) in enumerate(ROWS)]
    log = read_log(written(tmp_path / "a.txt", ["%\ttime\tforce\tangle\tnote", *lines]), tool_with(BY_NAME))
    check_rows(log)
    assert log.remarks == ()


def test_a_heading_that_stands_twice_is_told(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", ["time,force,angle,force", *(f"{t},{f},{a},0" for t, f, a in ROWS)])
    assert "the heading 'force' stands in columns 2, 4" in fault_of(path, tool_with(BY_NAME))


@pytest.mark.parametrize(
    ("content", "told"), [("", "is empty"), ("\n\n# nothing\n", "all lines are blank or comments")]
)
def test_a_file_without_samples_is_told(tmp_path: Path, content: str, told: str) -> None:
    (tmp_path / "a.txt").write_text(content)
    assert told in fault_of(tmp_path / "a.txt", tool_with(TIME_MS))


@pytest.mark.parametrize("name", ["a.csv", "a.txt.gz", "a.tdms", "a.mat", "a.parquet", "a"])
@settings(max_examples=25, deadline=None)
@given(content=st.binary(max_size=300))
def test_binary_junk_is_one_clear_message(tmp_path_factory: pytest.TempPathFactory, name: str, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(content)
    assert fault_of(path, tool_with(TIME_MS))


@pytest.mark.parametrize("write", [write_tdms, write_mat, write_parquet])
def test_a_file_that_is_cut_off_is_told(tmp_path: Path, write: Callable[[Path], None]) -> None:
    path = tmp_path / f"a.{write.__name__.removeprefix('write_')}"
    write(path)
    path.write_bytes(path.read_bytes()[:1000])
    assert fault_of(path, tool_with(BY_NAME)).startswith(": ")


def test_columns_of_different_lengths_are_told(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"time": TIME_S, "force": STRAIN_V[:-5], "angle": ANGLE_DEG})
    assert "its columns have between 295 and 300 values" in fault_of(tmp_path / "a.mat", tool_with(BY_NAME))


# --- through the commands ---------------------------------------------------------------------------------------------


def called(*words: object) -> str:
    """Run a command in this process; an error is raised as `main` gets it."""
    result = CliRunner().invoke(app, [*map(str, words)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output


def test_a_table_is_imported_and_replayed_like_any_recording(tmp_path: Path) -> None:
    lines = [f"{t},{f},{a},{2.0 if 0.05 < t < 0.25 else 0.0}" for t, f, a in ROWS]
    path = written(tmp_path / "bench run.csv", ["time,force,angle,motor", *lines])
    motor = '[[table.columns]]\nsignal = "motor_command_v"\ncolumn = "motor"\nunit = "V"\n'
    (tmp_path / "bench.toml").write_text(f"{TOOL_TEXT}\n{BY_NAME}{motor}")
    called("import", path, "--tool", tmp_path / "bench.toml", "--data", tmp_path / "data", "--tissue", "liver")
    imported = tmp_path / "data" / "recordings" / "bench run.mcap"
    again = RecordingSource(imported, tool_with(BY_NAME))
    assert (again.sample_count, McapFile(imported).metadata["imported_from"]) == (COUNT, "bench run.csv")
    assert again.tool.table is not None
    assert '"samples": 300' in called("replay", path, "--tool", tmp_path / "bench.toml", "--json")


def test_the_example_of_the_documentation_is_read(tmp_path: Path) -> None:
    page = (CONFIG_DIR.parent / "docs" / "recordings.md").read_text(encoding="utf-8")
    blocks = page.partition("## Recordings of other programs")[2].split("```")
    text, layout = (block.partition("\n")[2] for block in (blocks[1], blocks[3]))
    path = written(tmp_path / "bench.txt", [*text.splitlines(), "104;1,30;1383804", "104;1,32;1383806"])
    log = read_log(path, tool_with(layout, 370.0))
    assert log.signals["strain_v"][0] == pytest.approx(102 * 0.0048876)
    assert log.signals["encoder_deg"][0] == 1.25
    assert log.ticks.tolist() == [0, 1, 2]


def test_without_a_layout_the_message_says_what_is_needed(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv")
    with pytest.raises(RecordingError, match=r"a\.csv: is neither .* Add \[table\] to a copy of the tool file"):
        called("replay", tmp_path / "a.csv")


# --- real recordings of other laboratories ----------------------------------------------------------------------------


def recordings_in(folder: str) -> list[Path]:
    root = Path(os.environ.get("GRASPWATCH_RECORDINGS", Path(__file__).parents[3] / "../shared/recordings")).resolve()
    found = sorted((root / folder).glob("*.txt.gz"))
    if not found:
        pytest.skip(
            f"no recordings of other tools in {root / folder}; set GRASPWATCH_RECORDINGS to their folder's parent"
        )
    return found


@pytest.mark.recordings
def test_a_punch_on_an_arduino_is_read() -> None:
    table = """[table]
ignore_at_line_end = "\\\\"
time = {column = 5, unit = "ms"}
[[table.columns]]
signal = "strain_v"
column = 1
unit = ""
scale = 0.005
[[table.columns]]
signal = "encoder_deg"
column = 4
unit = "deg"
"""
    lines = {}
    for path in recordings_in("punch"):
        log = read_log(path, tool_with(table))
        text = gzip.decompress(path.read_bytes()).decode()
        rows = [cells for line in text.splitlines() if len(cells := line.strip("\\\t ").split("\t")) == 5]
        sound = np.array([row for row in rows if not any("}" in cell for cell in row)], float)
        time_s = (sound[:, 4] - sound[0, 4]) / 1e3
        lines[path.name] = len(sound)
        assert log.ticks[-1] == round(time_s[-1] * 1e3)
        at = np.round(time_s * 1e3).astype(int)  # ticks at which a sample was taken: nothing is interpolated there
        np.testing.assert_allclose(log.signals["strain_v"][at], sound[:, 0] * 0.005, atol=1e-6)
        np.testing.assert_allclose(log.signals["encoder_deg"][at], sound[:, 3], atol=1e-6)
        assert len(log.remarks) == 2
        assert "damaged" in log.remarks[0]
    assert lines["muscle_slow.txt.gz"] == 21_246
    assert lines["empty_slow.txt.gz"] == 17_421


@pytest.mark.recordings
def test_an_instrument_on_a_bench_is_read_by_its_headings() -> None:
    table = """[table]
time = {column = "Back-end Time [ms]", unit = "s"}
[[table.columns]]
signal = "strain_v"
column = "Back-end Futek Torque [counts]"
unit = ""
scale = 0.001
[[table.columns]]
signal = "encoder_deg"
column = "Back-end CUI Encoder [counts]"
unit = ""
scale = 0.0439453125
"""
    for path in recordings_in("davinci"):
        log = read_log(path, tool_with(table))
        with gzip.open(path, "rt") as file:
            own = np.loadtxt(file, delimiter=",", comments="%")
        np.testing.assert_array_equal(log.ticks, np.arange(len(own)))
        np.testing.assert_allclose(log.signals["strain_v"], own[:, 2] / 1e3)
        np.testing.assert_allclose(log.signals["encoder_deg"], own[:, 1] * 360 / 8192)
        assert log.remarks == ()
