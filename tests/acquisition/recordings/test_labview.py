"""LabVIEW recordings: what is read, and what a person is told whose file is damaged."""

import gzip
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bounded import fault_within
from hypothesis import given, settings
from hypothesis import strategies as st
from simulation import LVM_COLUMNS, SIGNALS, joined, lvm_text, raw_block, simulate_raw, write_lvm

from acquisition.drivers.source import RawBlock
from acquisition.recordings.labview import read_lvm
from acquisition.recordings.recording import RecordingSource
from acquisition.signals.pipeline import ConditioningPipeline
from config.errors import RecordingError
from config.load import load_tool
from config.schema import ConditioningSettings

RIG = load_tool("smart_tool_2013")
SIMULATED = joined(simulate_raw("bladder", cycles=1))
TEXT = lvm_text(SIMULATED)
LINES = TEXT.splitlines()
FIRST = 1 + next(i for i, line in enumerate(LINES) if line.startswith("X_Value")) + 1  # line of the first sample
PRINTED = 0.5e-6 + 1e-12  # six decimals


def blocks_of(path: Path, speed: float | None = None) -> list[RawBlock]:
    with RecordingSource(path, RIG, speed) as recording:
        return list(iter(recording.read_block, None))


def fault_of(path: Path) -> str:
    with pytest.raises(RecordingError) as caught:
        read_lvm(path, RIG)
    assert str(caught.value).startswith(str(path))
    return str(caught.value)[len(str(path)) :]


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", newline="")
    return path


def with_line(number: int, edit: Callable[[str], str]) -> str:
    """The file's text with one line edited; lines count from 1."""
    lines = list(LINES)
    lines[number - 1] = edit(lines[number - 1])
    return "\n".join(lines) + "\n"


# --- sound files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["simulated.lvm", "simulated.lvm.gz"])
def test_what_was_written_is_read_back_every_sample_once_and_in_order(tmp_path: Path, name: str) -> None:
    blocks = blocks_of(write_lvm(tmp_path / name, SIMULATED))
    assert [block.first_tick for block in blocks] == list(np.cumsum([0, *map(len, blocks[:-1])]))
    assert not any(block.lost_samples for block in blocks)
    whole = joined(blocks)
    for signal in SIGNALS:
        np.testing.assert_allclose(whole.signals[signal], SIMULATED.signals[signal], rtol=0, atol=PRINTED)


def test_it_says_how_many_samples_and_seconds_there_are(tmp_path: Path) -> None:
    recording = RecordingSource(write_lvm(tmp_path / "r.lvm", SIMULATED), RIG)
    assert recording.sample_count == len(SIMULATED)
    assert recording.duration_s == pytest.approx(len(SIMULATED) / 1000)


@pytest.mark.parametrize("ending", ["\r\n", "\n"])
def test_line_ends_of_either_system_and_blank_lines_at_the_end_do_no_harm(tmp_path: Path, ending: str) -> None:
    path = written(tmp_path / "r.lvm", TEXT.replace("\n", ending) + 2 * ending)
    assert len(read_lvm(path, RIG)) == len(SIMULATED)


def test_columns_are_found_by_their_names(tmp_path: Path) -> None:
    turned = written(tmp_path / "turned.lvm", lvm_text(SIMULATED, LVM_COLUMNS[::-1]))
    plain = write_lvm(tmp_path / "plain.lvm", SIMULATED)
    np.testing.assert_array_equal(read_lvm(turned, RIG), read_lvm(plain, RIG))


def test_a_remark_in_the_comment_column_is_no_fault(tmp_path: Path) -> None:
    path = written(tmp_path / "r.lvm", with_line(FIRST + 3, lambda line: line + "\tgrasp # 1, liver"))
    assert len(read_lvm(path, RIG)) == len(SIMULATED)


def test_time_may_begin_anywhere(tmp_path: Path) -> None:
    blocks = blocks_of(write_lvm(tmp_path / "late.lvm", replace(SIMULATED, first_tick=123_456)))
    assert blocks[0].first_tick == 0
    assert sum(map(len, blocks)) == len(SIMULATED)


def test_played_at_a_speed_it_gives_the_blocks_of_a_board_and_takes_its_time(tmp_path: Path) -> None:
    path = write_lvm(tmp_path / "r.lvm", raw_block(np.full(1000, 0.82)))
    begin = time.monotonic()
    blocks = blocks_of(path, speed=50.0)
    assert time.monotonic() - begin >= 1.0 / 50.0
    assert [len(block) for block in blocks] == [5] * 200


@given(at=st.integers(1, 200), lost=st.integers(1, 150), again=st.integers(1, 50))
def test_samples_missing_from_the_file_are_counted_as_lost_where_they_are_missing(
    tmp_path_factory: pytest.TempPathFactory, at: int, lost: int, again: int
) -> None:
    head, body = LINES[: FIRST - 1], LINES[FIRST - 1 : FIRST + 500]
    resumes = at + lost
    kept = body[:at] + body[resumes : resumes + again] + body[resumes + again + 2 :]
    path = written(tmp_path_factory.getbasetemp() / "gap.lvm", "\n".join([*head, *kept]) + "\n")
    blocks = blocks_of(path)
    gaps = {block.first_tick: block.lost_samples for block in blocks if block.lost_samples}
    assert gaps == {resumes: lost, resumes + again + 2: 2}
    ticks = np.concatenate([block.first_tick + np.arange(len(block)) for block in blocks])
    expected = [round(float(line.split("\t")[0]) * 1000) for line in kept]
    np.testing.assert_array_equal(ticks, expected)


# --- damaged files ----------------------------------------------------------------------------------------------------


def test_a_missing_file_and_a_folder_are_told(tmp_path: Path) -> None:
    assert "there is no such file" in fault_of(tmp_path / "none.lvm")
    assert "cannot be read" in fault_of(tmp_path)


@pytest.mark.parametrize("content", ["", "\n\n", " \t\n"])
def test_an_empty_file_is_told(tmp_path: Path, content: str) -> None:
    assert "is empty" in fault_of(written(tmp_path / "r.lvm", content))


@pytest.mark.parametrize("share", [0.05, 0.5, 0.99])
def test_a_compressed_file_that_is_cut_off_is_told(tmp_path: Path, share: float) -> None:
    path = write_lvm(tmp_path / "r.lvm.gz", SIMULATED)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    assert "cut off before its end" in fault_of(path)


PACKED = gzip.compress(TEXT.encode(), mtime=0)
GZIP_HEADER = 10  # bytes, of which time and system mean nothing


@settings(max_examples=50)
@given(at=st.integers(GZIP_HEADER, len(PACKED) - 1), wrong=st.integers(1, 255))
def test_a_wrong_byte_in_a_compressed_file_is_told_and_never_gives_other_numbers(
    tmp_path_factory: pytest.TempPathFactory, at: int, wrong: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "wrong.lvm.gz"
    path.write_bytes(PACKED[:at] + bytes([PACKED[at] ^ wrong]) + PACKED[at + 1 :])
    try:
        table = read_lvm(path, RIG)
    except RecordingError as error:
        assert str(error).startswith(str(path))
        assert str(error).endswith("Copy it again.")
    else:  # the same text can be packed in two ways that differ by one byte
        np.testing.assert_array_equal(table[:, 1], np.loadtxt(LINES[FIRST - 1 :], usecols=1))


def test_a_file_that_only_calls_itself_compressed_is_told(tmp_path: Path) -> None:
    assert "is not a sound gzip file" in fault_of(written(tmp_path / "r.lvm.gz", TEXT))


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_a_binary_file_is_told_with_the_line_where_it_is_binary(tmp_path: Path, pack: Callable[[bytes], bytes]) -> None:
    content = TEXT.encode().split(b"\n")
    content[FIRST + 9] = b"0.010000\t\xff\x00\x80"
    path = tmp_path / ("r.lvm" if pack is bytes else "r.lvm.gz")
    path.write_bytes(pack(b"\n".join(content)))
    assert f", line {FIRST + 10}: is binary" in fault_of(path)


def test_another_kind_of_text_is_told_at_its_first_line(tmp_path: Path) -> None:
    told = fault_of(written(tmp_path / "r.csv", "time,force\n0,1\n"))
    assert told.startswith(", line 1: expected 'LabVIEW Measurement', found 'time,force'")


@pytest.mark.parametrize("lines", [1, 8, 12, 15, 22, 23])
def test_a_file_that_ends_inside_its_header_is_told_with_its_last_line(tmp_path: Path, lines: int) -> None:
    path = written(tmp_path / "r.lvm", "\n".join(LINES[:lines]) + "\n")
    assert f", line {lines}: the file ends inside its header" in fault_of(path)


def test_a_file_without_samples_is_told(tmp_path: Path) -> None:
    path = written(tmp_path / "r.lvm", "\n".join(LINES[: FIRST - 1]) + "\n")
    assert f"holds no samples: line {FIRST} should be the first one" in fault_of(path)


def cut_off(path: Path, last: int, characters: int) -> Path:
    return written(path, "\n".join([*LINES[: last - 1], LINES[last - 1][:characters]]))


@pytest.mark.parametrize("characters", [1, 12, 30])
def test_a_file_cut_off_in_the_midst_of_a_line_is_told_with_that_line(tmp_path: Path, characters: int) -> None:
    last = FIRST + 500
    columns = LINES[last - 1][:characters].count("\t") + 1
    told = fault_of(cut_off(tmp_path / "r.lvm", last, characters))
    assert told.startswith(f", line {last}: expected 6 columns, found {columns}; the file may be cut off")


def test_a_file_cut_off_in_its_very_last_number_is_told(tmp_path: Path) -> None:
    last = FIRST + 500
    assert f", line {last}: " in fault_of(cut_off(tmp_path / "r.lvm", last, len(LINES[last - 1]) - 4))


@pytest.mark.parametrize("missing", LVM_COLUMNS)
def test_a_missing_channel_is_told_with_what_there_is_instead(tmp_path: Path, missing: str) -> None:
    told = fault_of(written(tmp_path / "r.lvm", TEXT.replace(f"\t{missing}\t", "\tDev1/ai7\t")))
    assert f", line {FIRST - 1}: column '{missing}' is missing" in told
    assert "Dev1/ai7" in told
    assert "'smart_tool_2013'" in told


@pytest.mark.parametrize("cell", ["abc", "", "0,81", "NaN", "inf", "0.8\x00", "1.2.3", "--"])
@pytest.mark.parametrize("column", [1, 2, 6])
def test_a_cell_that_is_no_number_is_told_with_line_and_column(tmp_path: Path, cell: str, column: int) -> None:
    def replaced(line: str) -> str:
        cells = line.split("\t")
        cells[column - 1] = cell
        return "\t".join(cells)

    told = fault_of(written(tmp_path / "r.lvm", with_line(FIRST + 7, replaced)))
    assert told.startswith(f", line {FIRST + 7}, column {column}: expected a number, found {cell!r}")


@pytest.mark.parametrize("time_s", ["0.005000", "0.007500", "-1.000000", "0.006000"])
def test_time_that_runs_backwards_stands_still_or_stumbles_is_told_with_its_line(tmp_path: Path, time_s: str) -> None:
    text = with_line(FIRST + 7, lambda line: "\t".join([time_s, *line.split("\t")[1:]]))
    told = fault_of(written(tmp_path / "r.lvm", text))
    assert told.startswith(f", line {FIRST + 7}: time goes from 0.006000 to {time_s} s; expected steps of 0.001 s")


def test_blank_lines_do_not_shift_the_line_that_is_told(tmp_path: Path) -> None:
    body = [*LINES[: FIRST + 1], "", "", *LINES[FIRST + 1 : FIRST + 5], LINES[FIRST - 1]]
    assert f", line {len(body)}: time goes" in fault_of(written(tmp_path / "r.lvm", "\n".join(body) + "\n"))


def test_a_second_measurement_in_the_file_is_told_with_its_line(tmp_path: Path) -> None:
    second_header = next(i for i, line in enumerate(LINES) if line.startswith("Channels"))
    text = TEXT + "\n".join(LINES[second_header:]) + "\n"
    ends = [i for i, line in enumerate(text.splitlines(), 1) if line.startswith("***End_of_Header***")]
    told = fault_of(written(tmp_path / "r.lvm", text))
    assert told.startswith(f", line {ends[2]}: a second measurement begins here")


# --- whatever it is ---------------------------------------------------------------------------------------------------

SHORT = LINES[: FIRST + 40]
SPLINTERS = st.sampled_from(
    [
        "\t",
        "\n",
        "\r",
        "\0",
        "1e308",
        "1e999",
        "-",
        "nan",
        "9" * 400,
        "1_0",
        "٣",
        "\x1c",
        "\u2028",
        "0.001",
        "1e15",
        "0x10",
        "***End_of_Header***",
        "LabVIEW Measurement",
        "X_Value",
        " ",
        ",",
        "\ud800",
    ]
) | st.text(max_size=5)


@given(chance=st.data())
def test_whatever_stands_in_a_file_it_is_read_or_told(
    tmp_path_factory: pytest.TempPathFactory, chance: st.DataObject
) -> None:
    """Nothing is read that is no number, and no gap is believed that no recording can have."""
    lines = list(SHORT)
    for _ in range(chance.draw(st.integers(1, 4))):
        place = chance.draw(st.integers(0, len(lines) - 1))
        cells = lines[place].split("\t")
        match chance.draw(st.sampled_from(["cell", "splinter", "remove", "repeat"])):
            case "cell":
                cells[chance.draw(st.integers(0, len(cells) - 1))] = chance.draw(SPLINTERS)
                lines[place] = "\t".join(cells)
            case "splinter":
                at = chance.draw(st.integers(0, len(lines[place])))
                lines[place] = lines[place][:at] + chance.draw(SPLINTERS) + lines[place][at:]
            case "remove" if len(lines) > 1:
                del lines[place]
            case "repeat":
                lines.insert(place, chance.draw(st.sampled_from(SHORT)))
    path = tmp_path_factory.getbasetemp() / "any.lvm"
    path.write_bytes("\n".join(lines).encode(errors="surrogatepass"))
    try:
        blocks = blocks_of(path)
    except RecordingError as error:
        assert str(error).startswith(str(path))
    else:
        assert all(np.isfinite(block.signals[name]).all() for block in blocks for name in SIGNALS)
        assert sum(block.lost_samples for block in blocks) < 86_400_000


def zeros(path: Path) -> None:
    with gzip.open(path, "wb", 1) as file:
        for _ in range(300):
            file.write(bytes(2**20))


def blank_lines(path: Path) -> None:
    head = "\n".join(LINES[: FIRST - 1]).encode()
    with gzip.open(path, "wb", 1) as file:
        file.write(head + b"\n")
        for _ in range(100):
            file.write(b"\n" * 2**20)


@pytest.mark.parametrize(("fill", "says"), [(zeros, "more than 256 MiB"), (blank_lines, "more than 5000000 lines")])
def test_a_small_file_that_becomes_a_huge_one_is_told_before_it_takes_the_memory(
    tmp_path: Path, fill: Callable[[Path], None], says: str
) -> None:
    path = tmp_path / "huge.lvm.gz"
    fill(path)
    assert path.stat().st_size < 2_000_000
    assert says in fault_within(1200 * 2**20, read_lvm, path, RIG)


@pytest.mark.parametrize(
    ("hours", "says"),
    [([30], "line 65: time goes from 0.039000 to 108000"), ([10, 20, 30], "spans more than 24 hours")],
)
def test_times_that_no_recording_can_have_are_told(tmp_path: Path, hours: list[int], says: str) -> None:
    rest = SHORT[-1].split("\t")[1:]
    late = ["\t".join([f"{3600 * hour}.000000", *rest]) for hour in hours]
    path = written(tmp_path / "r.lvm", "\n".join([*SHORT[:-1], *late]) + "\n")
    with pytest.raises(RecordingError, match=says):
        RecordingSource(path, RIG)


# --- the real ones ----------------------------------------------------------------------------------------------------


@pytest.mark.recordings
def test_every_sample_of_the_real_recordings_is_accounted_for(recordings: list[Path]) -> None:
    for path in recordings:
        content = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        lines = len(re.findall(rb"^-?\d+\.\d+\t", content, re.MULTILINE))
        with RecordingSource(path, RIG) as recording:
            blocks = list(iter(recording.read_block, None))
        assert sum(map(len, blocks)) == recording.sample_count == lines
        assert recording.duration_s == pytest.approx(lines / 1000)
        assert not any(block.lost_samples for block in blocks)


@pytest.mark.recordings
@pytest.mark.parametrize(("name", "grasps"), [("liver025Hz1", 9), ("liver4Hz1", 19)])
def test_the_grasps_of_a_real_recording_are_counted(recordings: list[Path], name: str, grasps: int) -> None:
    path = next(path for path in recordings if path.name.startswith(name))
    pipeline = ConditioningPipeline(RIG, ConditioningSettings())
    samples = np.concatenate([pipeline.process(block).samples for block in blocks_of(path)])
    assert samples["grasp"][-1] == grasps
    starts = np.unique(samples["grasp_start_tick"][samples["grasp"] > 0])
    assert len(starts) == grasps
    # the lab's program repeats each grasp at the same distance; a start is told to a few samples
    assert np.ptp(np.diff(starts)) <= 3
