"""A device that prints lines, read through a real pseudo-terminal."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from serial_device import SerialDevice

from acquisition.drivers.serial_lines import SerialSource
from acquisition.drivers.source import RawBlock
from config.errors import RefusedError, ToolError
from config.load import load_tool
from config.schema import SerialPort, Tool, ToolKind
from config.table_layout import DecimalMark

PUNCH = load_tool("arthroscopic_punch")


@pytest.fixture
def device(tmp_path: Path) -> Iterator[SerialDevice]:
    with SerialDevice(tmp_path / "port") as running:
        yield running


def tool_at(device: SerialDevice, **changes: object) -> Tool:
    content = PUNCH.model_dump() | {"kind": ToolKind.SERIAL, "serial": SerialPort(port=str(device.port))} | changes
    return Tool.model_validate(content)


def lines(first: int, count: int, step_ms: float = 2.0, form: str = "{i}\t{force}\t0\t{angle}\t{ms}\t\\\r\n") -> str:
    """Lines of the punch: force rises by 1 gram-force a line, the angle by 0.01 degrees."""
    return "".join(form.format(i=i, force=i, angle=0.01 * i, ms=i * step_ms) for i in range(first, first + count))


def fast_clock() -> int:
    return 5 * time.monotonic_ns()


def read(source: SerialSource, samples: int, until: Callable[[], bool] = lambda: False) -> list[RawBlock]:
    blocks: list[RawBlock] = []
    for _ in range(200):
        blocks.append(source.read_block())
        if sum(map(len, blocks)) >= samples or until():
            return [block for block in blocks if len(block)]
    raise AssertionError(f"{sum(map(len, blocks))} samples; {source.silence_reason}")


def test_lines_become_samples_at_the_tools_rate(device: SerialDevice) -> None:
    tool = tool_at(device, board={"sample_rate_hz": 1000.0, "block_samples": 5})
    with SerialSource(tool) as source:
        device.print("in the middle of a line\nReady.\n\n# a comment\n" + lines(0, 3) + "0\t1\t2\r\n" + lines(3, 97))
        blocks = read(source, 190)
    strain_v = np.concatenate([block.signals["strain_v"] for block in blocks])
    assert strain_v == pytest.approx(0.01 * np.arange(len(strain_v)) / 2, abs=1e-6)  # 1 gram-force is 0.01 V
    encoder_deg = np.concatenate([block.signals["encoder_deg"] for block in blocks])
    assert encoder_deg == pytest.approx(0.01 * np.arange(len(encoder_deg)) / 2, abs=1e-6)
    assert np.isnan(blocks[0].signals["motor_command_v"]).all()
    ticks = np.concatenate([block.first_tick + np.arange(len(block)) for block in blocks])
    assert ticks.tolist() == list(range(len(ticks)))
    assert {block.lost_samples for block in blocks} == {0}


@pytest.mark.parametrize(
    ("form", "table"),
    [
        ("{force},{angle}\n", {}),
        ("{force}; {angle}\r\n", {}),
        ("  {force}   {angle}\r\n", {}),
        ("{force};{angle}\n", {"decimal": DecimalMark.COMMA}),
    ],
)
def test_the_separator_is_found_and_lines_without_times_count_as_ticks(
    device: SerialDevice, form: str, table: dict[str, DecimalMark]
) -> None:
    assert PUNCH.table
    columns = tuple(each.model_copy(update={"column": at}) for at, each in enumerate(PUNCH.table.columns, 1))
    with SerialSource(tool_at(device, table=table | {"columns": columns})) as source:
        text = lines(0, 30, form=form)
        device.print("half\n" + (text.replace(".", ",") if table else text))
        blocks = read(source, 30)
    strain_v = np.concatenate([block.signals["strain_v"] for block in blocks])
    assert strain_v == pytest.approx(0.01 * np.arange(30))


def test_a_device_that_is_unplugged_is_waited_for_and_its_samples_are_lost(device: SerialDevice) -> None:
    tool = tool_at(device)
    with SerialSource(tool) as source:
        device.print("half\n" + lines(0, 50))
        before = read(source, 30)
        assert source.silence_reason == ""
        device.unplug()
        read(source, 10_000, until=lambda: "is gone" in source.silence_reason)
        read(source, 10_000, until=lambda: "there is no serial port" in source.silence_reason)
        assert "plug the device in" in source.silence_reason
        device.plug_in()
        read(source, 10_000, until=lambda: "prints nothing" in source.silence_reason)
        device.print("half\n" + lines(0, 50))  # it has restarted: its times begin anew
        after = read(source, 30)
    last = before[-1].first_tick + len(before[-1])
    assert after[0].lost_samples >= after[0].first_tick - last > 0.4 * 370.0
    assert after[0].signals["strain_v"][0] == pytest.approx(0.0)


def test_a_port_that_is_missing_or_in_use_is_told_and_used_as_soon_as_it_can_be(device: SerialDevice) -> None:
    device.unplug()
    with SerialSource(tool_at(device)) as source:
        assert len(source.read_block()) == 0
        assert source.silence_reason.startswith(f"there is no serial port {device.port}: plug the device in")
        device.plug_in()
        read(source, 10_000, until=lambda: "prints nothing" in source.silence_reason)
        with SerialSource(tool_at(device)) as second:
            assert second.silence_reason == f"another program uses {device.port}: close it"


def test_lines_with_other_columns_are_an_error(device: SerialDevice) -> None:
    with SerialSource(tool_at(device)) as source:
        device.print("half\n" + "force: high, angle: low\n" * 150)
        with pytest.raises(ToolError, match=r"one is 'force: high, angle: low'\. Correct the columns"):
            read(source, 1)


@pytest.mark.parametrize(
    ("rate_hz", "step_ms", "told"),
    [
        (1100.0, 0.9, r"gives 11\d\d(\.\d+)? lines a second, but the tool file .* says 370 samples"),
        (20.0, 50.0, "times of the device do not advance by 370 samples a second"),
        (370.0, 0.0027, "times of the device do not advance by 370 samples a second"),
    ],
)
def test_a_rate_that_contradicts_the_tool_file_is_an_error(
    device: SerialDevice, rate_hz: float, step_ms: float, told: str
) -> None:
    with SerialSource(tool_at(device), clock=fast_clock) as source:
        device.print("half\n")
        begin_ns, printed = fast_clock(), 0
        with pytest.raises(ToolError, match=told):
            while fast_clock() < begin_ns + 30e9:
                due = int(rate_hz * (fast_clock() - begin_ns) * 1e-9) - printed
                device.print(lines(printed, min(due, 100), step_ms))
                printed += min(due, 100)
                source.read_block()
                time.sleep(0.002)


def test_a_device_that_prints_what_it_has_kept_is_no_wrong_rate(device: SerialDevice) -> None:
    with SerialSource(tool_at(device), clock=fast_clock) as source:
        device.print("half\n")
        begin_ns, printed = fast_clock(), 0
        while fast_clock() < begin_ns + 12e9:  # twice the time after which the rate is judged
            device.print(lines(printed, 40, 2.7))
            printed += 40
            source.read_block()
            time.sleep(0.002)
    assert printed > 1.5 * 370.0 * 12


def test_a_damaged_time_and_glued_lines_cost_one_sample_each(device: SerialDevice) -> None:
    with SerialSource(tool_at(device)) as source:
        glued = lines(40, 1).removesuffix("\r\n") + lines(41, 1)
        device.print("half\n" + lines(0, 20) + lines(20, 1, 0.2) + lines(21, 19) + glued + lines(42, 60))
        blocks = read(source, 70)
    assert sum(block.lost_samples for block in blocks) == 0
    strain_v = np.concatenate([block.signals["strain_v"] for block in blocks])
    assert np.diff(strain_v) == pytest.approx(0.01 * 1000.0 / 370.0 / 2.0, abs=1e-6)  # a gram-force in 2 ms


def test_a_reader_that_was_held_up_loses_nothing(device: SerialDevice) -> None:
    with SerialSource(tool_at(device)) as source:
        device.print("half\n" + lines(0, 50))
        blocks = read(source, 30)
        device.print(lines(50, 100))
        time.sleep(0.7)
        blocks += read(source, 70)
    assert sum(block.lost_samples for block in blocks) == 0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"serial": None}, r"a tool of kind 'serial' needs a \[serial\] table"),
        ({"table": None}, r"a tool of kind 'serial' needs a \[table\] table"),
        ({"hand_driven": None}, r"a tool of kind 'serial' needs a \[hand_driven\] table"),
        ({"kind": ToolKind.RECORDING}, r"\[serial\] belongs to a tool of kind 'serial'"),
    ],
)
def test_a_tool_file_that_cannot_be_watched_is_refused(
    device: SerialDevice, changes: dict[str, object], told: str
) -> None:
    with pytest.raises(ValidationError, match=told):
        tool_at(device, **changes)


def test_a_column_needs_a_number_because_a_port_has_no_heading(device: SerialDevice) -> None:
    assert PUNCH.table
    columns = tuple(each.model_copy(update={"column": "force"}) for each in PUNCH.table.columns)
    with pytest.raises(ValidationError, match="have no headings: write the number of column 'force'"):
        tool_at(device, table={"columns": columns})


def test_it_has_no_motor(device: SerialDevice) -> None:
    with SerialSource(tool_at(device)) as source:
        assert source.write_command(0.0).command_v == 0.0
        with pytest.raises(RefusedError, match=r"has no motor\. Choose the protocol 'by_hand'"):
            source.write_command(0.5)
