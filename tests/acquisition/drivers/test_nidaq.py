"""The driver over the simulated board: what reaches the rest of the program, and where the motor is left."""

import time
from contextlib import suppress
from pathlib import Path

import grpc
import nidaqmx
import numpy as np
import pytest
from boards import HAS_DRIVER
from certificates import self_signed
from grpc import insecure_channel
from nidaqmx.constants import AcquisitionType, TriggerType
from nidaqmx.errors import DaqError
from nidaqmx.stream_readers import CounterReader
from nidaqmx.stream_writers import AnalogSingleChannelWriter
from proxy import HttpProxy
from pydantic import ValidationError

from acquisition.drivers.nidaq import NidaqSource, create_session_options, reset_device
from acquisition.simulation.board import RealClock, SimulatedBoard, VirtualClock
from acquisition.simulation.service import create_in_process_options, serve_tcp
from config.errors import RefusedError, ToolError
from config.load import load_tool
from config.schema import Board, ToolKind

TOOL = load_tool("simulated")
COUNT_DEG = TOOL.calibration.encoder_resolution_deg


class Ramp:
    """Sample k: strain k mV, encoder k counts; remembers the command of every sample."""

    def __init__(self) -> None:
        self.commands_v: list[float] = []

    def step(self, command_v: float) -> dict[str, float]:
        self.commands_v.append(command_v)
        k = len(self.commands_v)
        return {"strain_v": k * 1e-3, "encoder_deg": k * COUNT_DEG, "touch_1_v": 0.25, "touch_2_v": 5.0}


class Rig:
    """A tool on a simulated board, both clocks at hand."""

    def __init__(self, clock: VirtualClock | RealClock | None = None, buffer_samples: int = 10_000) -> None:
        self.clock = clock or VirtualClock()
        self.plant = Ramp()
        self.board = SimulatedBoard(TOOL, self.plant, self.clock, buffer_samples)
        self.options = create_in_process_options(self.board)

    def tool(self) -> NidaqSource:
        return NidaqSource(TOOL, self.options, self.clock.now_ns)

    def pass_time(self, seconds: float) -> None:
        self.clock.sleep_until_ns(self.clock.now_ns() + round(seconds * 1e9))


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_every_sample_arrives_once_in_order_with_its_encoder_angle(rig: Rig) -> None:
    with rig.tool() as tool:
        blocks = [tool.read_block() for _ in range(1000)]
    k = np.arange(1, 5001)
    assert [block.first_tick for block in blocks] == list(range(0, 5000, 5))
    assert not any(block.lost_samples for block in blocks)
    np.testing.assert_allclose(np.concatenate([block.signals["strain_v"] for block in blocks]), k * 1e-3, rtol=1e-12)
    np.testing.assert_allclose(
        np.concatenate([block.signals["encoder_deg"] for block in blocks]), k * COUNT_DEG, rtol=1e-12
    )
    assert set(blocks[-1].signals["touch_1_v"]) == {0.25}
    assert set(blocks[-1].signals["touch_2_v"]) == {5.0}
    assert [block.t_mono_ns for block in blocks[:2]] == [5_000_000, 10_000_000]


def test_a_late_reader_still_gets_every_sample(rig: Rig) -> None:
    with rig.tool() as tool:
        rig.pass_time(3.0)
        strain_v = np.concatenate([tool.read_block().signals["strain_v"] for _ in range(700)])
    np.testing.assert_allclose(strain_v, np.arange(1, 3501) * 1e-3, rtol=1e-12)


def test_readback_and_plant_follow_the_command_from_its_moment_on(rig: Rig) -> None:
    with rig.tool() as tool:
        tool.read_block()
        rig.pass_time(0.010)
        tool.write_command(1.5)
        readback_v = np.concatenate([tool.read_block().signals["motor_command_v"] for _ in range(4)])
    assert list(readback_v) == [0.0] * 10 + [1.5] * 10
    assert rig.plant.commands_v == [0.0] * 15 + [1.5] * 10


def test_on_the_real_clock_samples_come_at_their_rate_under_the_command_of_their_time() -> None:
    rig = Rig(RealClock())
    with rig.tool() as tool:
        begin_ns = time.monotonic_ns()
        rig.pass_time(0.05)
        tool.write_command(1.0)
        blocks = [tool.read_block() for _ in range(20)]
    assert time.monotonic_ns() - begin_ns > 98e6
    readback_v = np.concatenate([block.signals["motor_command_v"] for block in blocks])
    changed_at = int(np.argmax(readback_v > 0))
    assert changed_at >= 50
    assert set(readback_v[:changed_at]) == {0.0}
    assert set(readback_v[changed_at:]) == {1.0}


@pytest.mark.parametrize("error", [None, ValueError, KeyboardInterrupt, SystemExit])
def test_leaving_it_however_puts_the_motor_to_zero_and_frees_the_board(
    rig: Rig, error: type[BaseException] | None
) -> None:
    with suppress(*([error] if error else [])), rig.tool() as tool:
        tool.write_command(2.0)
        assert rig.board.output_v == 2.0
        if error:
            raise error
    assert rig.board.output_v == 0.0
    with rig.tool() as tool:
        assert len(tool.read_block()) == 5


def test_opening_clears_what_another_program_left_on_the_output(rig: Rig) -> None:
    with nidaqmx.Task(grpc_options=rig.options) as other:
        other.ao_channels.add_ao_voltage_chan("Dev1/ao0")
        AnalogSingleChannelWriter(other.out_stream).write_one_sample(2.0)
    assert rig.board.output_v == 2.0
    with rig.tool() as tool:
        assert rig.board.output_v == 0.0
        tool.read_block()
    assert rig.plant.commands_v == [0.0] * 5


def test_the_output_holds_when_the_client_vanishes_until_the_device_is_reset(rig: Rig) -> None:
    vanished = rig.tool().__enter__()
    vanished.write_command(2.0)
    del vanished
    rig.pass_time(5.0)
    assert rig.board.output_v == 2.0
    with pytest.raises(ToolError, match="Another program uses Dev1"), rig.tool():
        pass
    reset_device(TOOL, rig.options)
    assert rig.board.output_v == 0.0
    with rig.tool() as tool:
        assert set(tool.read_block().signals["motor_command_v"]) == {0.0}


def test_a_reset_underneath_a_running_tool_ends_it_at_zero(rig: Rig) -> None:
    with rig.tool() as tool:
        tool.write_command(2.0)
        reset_device(TOOL, rig.options)
        with pytest.raises(ToolError, match=r"Dev1 failed.*The motor is at zero"):
            tool.write_command(2.0)
    assert rig.board.output_v == 0.0


def test_an_overrun_ends_the_tool_at_zero_and_says_what_to_do() -> None:
    rig = Rig(buffer_samples=100)
    with rig.tool() as tool:
        tool.write_command(2.0)
        rig.pass_time(0.100)
        tool.read_block()
        rig.pass_time(0.006)
        with pytest.raises(ToolError, match=r"overwritten .* close other programs, .* The motor is at zero"):
            tool.read_block()
        assert rig.board.output_v == 0.0
        with pytest.raises(ToolError, match="not open"):
            tool.read_block()
        with pytest.raises(ToolError, match="not open"):
            tool.write_command(2.0)
    assert rig.board.output_v == 0.0


@pytest.mark.parametrize("arrived", [0, 3])
def test_a_short_read_ends_the_tool_at_zero_and_counts_what_came(rig: Rig, arrived: int) -> None:
    with rig.tool() as tool:
        tool.read_block()
        tool.write_command(2.0)
        rig.board.stop_sample_clock(after=arrived)
        waited_from_ns = rig.clock.now_ns()
        with pytest.raises(ToolError, match=f"only {arrived} of 5 samples .*The motor is at zero"):
            tool.read_block()
        assert rig.board.output_v == 0.0
        assert rig.clock.now_ns() - waited_from_ns == 13e6  # 8 ms after the block is due


def test_a_failure_between_the_two_reads_ends_the_tool_at_zero(rig: Rig) -> None:
    def breaks(command_v: float) -> dict[str, float]:
        return {"strain_v": 0.0, "encoder_deg": float("nan"), "touch_1_v": 0.0, "touch_2_v": 0.0}

    with rig.tool() as tool:
        tool.write_command(2.0)
        rig.plant.step = breaks  # type: ignore[method-assign]
        with pytest.raises(ValueError, match="NaN"):
            tool.read_block()
        assert rig.board.output_v == 0.0
        with pytest.raises(ToolError, match="not open"):
            tool.read_block()


@pytest.mark.parametrize("command_v", [3.6, -0.1, float("nan"), float("inf"), -float("inf")])
def test_a_command_beyond_the_limits_is_refused_with_the_motor_at_zero(rig: Rig, command_v: float) -> None:
    with rig.tool() as tool:
        tool.write_command(TOOL.limits.max_command_v)
        with pytest.raises(RefusedError, match=r"between 0 and 3\.5 V; the motor is at zero: correct"):
            tool.write_command(command_v)
        assert rig.board.output_v == 0.0
        tool.write_command(1.0)
        assert set(tool.read_block().signals["motor_command_v"]) == {1.0}


@pytest.mark.parametrize("order", ["encoder first", "analog first"])
def test_an_encoder_started_after_the_analog_inputs_never_delivers(rig: Rig, order: str) -> None:
    with nidaqmx.Task(grpc_options=rig.options) as analog, nidaqmx.Task(grpc_options=rig.options) as encoder:
        analog.ai_channels.add_ai_voltage_chan("Dev1/ai0")
        analog.timing.cfg_samp_clk_timing(1000.0, sample_mode=AcquisitionType.CONTINUOUS)
        encoder.ci_channels.add_ci_ang_encoder_chan("Dev1/ctr0", pulses_per_rev=9500)
        encoder.timing.cfg_samp_clk_timing(1000.0, "/Dev1/ai/SampleClock", sample_mode=AcquisitionType.CONTINUOUS)
        encoder.triggers.arm_start_trigger.trig_type = TriggerType.DIGITAL_EDGE
        encoder.triggers.arm_start_trigger.dig_edge_src = "/Dev1/ai/StartTrigger"
        for task in (encoder, analog) if order == "encoder first" else (analog, encoder):
            task.start()
        reader, angle_deg = CounterReader(encoder.in_stream), np.empty(5)
        if order == "encoder first":
            assert reader.read_many_sample_double(angle_deg, 5, 1.0) == 5
            np.testing.assert_allclose(angle_deg, np.arange(1, 6) * COUNT_DEG)
        else:
            with pytest.raises(DaqError) as caught:
                reader.read_many_sample_double(angle_deg, 5, 1.0)
            assert caught.value.error_code == -200284


def test_a_wrong_pulse_count_gives_wrong_degrees_as_on_a_real_counter(rig: Rig) -> None:
    halved = TOOL.calibration.model_copy(update={"encoder_counts_per_rev": 250})
    with NidaqSource(TOOL.model_copy(update={"calibration": halved}), rig.options) as tool:
        np.testing.assert_allclose(tool.read_block().signals["encoder_deg"], np.arange(1, 6) * 2 * COUNT_DEG)


@pytest.mark.skipif(HAS_DRIVER, reason="NI-DAQmx is installed: this would open a real board")
def test_without_the_driver_it_says_what_to_install_and_what_needs_none() -> None:
    with pytest.raises(ToolError, match=r"install NI-DAQmx .*`--tool simulated`"), NidaqSource(TOOL):
        pass
    with pytest.raises(ToolError, match=r"install NI-DAQmx .*amplifier NOW"):
        reset_device(TOOL)


@pytest.mark.parametrize(
    ("section", "name", "value", "told"),
    [
        ("board", "device", "Dev7", "no board named Dev7"),
        ("channels", "strain", "ai9", r"lacks a channel .*Dev1/ai9"),
        ("channels", "encoder", "ctr9", r"lacks a channel .*Dev1/ctr9"),
    ],
)
def test_a_board_or_channel_that_is_not_there_is_named(
    rig: Rig, section: str, name: str, value: str, told: str
) -> None:
    wrong = getattr(TOOL, section).model_copy(update={name: value})
    with pytest.raises(ToolError, match=told), NidaqSource(TOOL.model_copy(update={section: wrong}), rig.options):
        pass
    assert rig.board.output_v == 0.0


def test_over_tcp_it_is_the_same_board_and_a_lost_server_is_told() -> None:
    board = SimulatedBoard(TOOL, Ramp(), VirtualClock())
    server, port = serve_tcp(board)
    with insecure_channel(f"127.0.0.1:{port}") as channel:
        tool = NidaqSource(TOOL, nidaqmx.GrpcSessionOptions(channel, "")).__enter__()
        tool.write_command(1.0)
        block = tool.read_block()
        assert list(block.signals["motor_command_v"]) == [1.0] * 5
        np.testing.assert_allclose(block.signals["encoder_deg"], np.arange(1, 6) * COUNT_DEG)
        with pytest.raises(RefusedError):
            tool.write_command(9.0)
        server.stop(grace=None).wait()
        with pytest.raises(ToolError, match=r"server of Dev1 is lost .* switch off the motor's amplifier NOW"):
            tool.read_block()


# --- over the network -------------------------------------------------------------------------------------------------


@pytest.fixture
def encrypted(tmp_path: Path):
    """A board behind a server that knows its clients by their certificate; the tool that reaches it."""
    server_cert, server_key = self_signed(tmp_path / "server")
    own_cert, own_key = self_signed(tmp_path / "client")
    credentials = grpc.ssl_server_credentials(
        [(server_key.read_bytes(), server_cert.read_bytes())], own_cert.read_bytes(), require_client_auth=True
    )
    board = SimulatedBoard(TOOL, Ramp(), VirtualClock())
    server, port = serve_tcp(board, credentials=credentials)
    wiring = {
        "grpc_address": f"127.0.0.1:{port}",
        "grpc_ca": str(server_cert),
        "grpc_cert": str(own_cert),
        "grpc_key": str(own_key),
    }
    yield board, wiring, tmp_path
    server.stop(grace=None).wait()


def reached_by(wiring: dict[str, str]) -> NidaqSource:
    tool = TOOL.model_copy(update={"kind": ToolKind.NIDAQ, "board": Board(**wiring)})
    return NidaqSource(tool, create_session_options(tool))


def test_over_tls_the_board_is_driven_by_whoever_it_knows(encrypted) -> None:
    board, wiring, _ = encrypted
    with reached_by(wiring) as tool:
        tool.write_command(1.0)
        assert list(tool.read_block().signals["motor_command_v"]) == [1.0] * 5
        assert board.output_v == 1.0
    assert board.output_v == 0.0


def test_over_tls_nobody_else_reaches_it_nor_another_board_in_its_place(encrypted) -> None:
    board, wiring, folder = encrypted
    other_cert, other_key = self_signed(folder / "other")
    strangers = (
        wiring | {"grpc_ca": str(other_cert)},
        wiring | {"grpc_cert": str(other_cert), "grpc_key": str(other_key)},
        {name: value for name, value in wiring.items() if name not in ("grpc_cert", "grpc_key")},
    )
    for stranger in strangers:
        with pytest.raises(ToolError, match=r"server of Dev1 is lost .* `grpc_ca`"), reached_by(stranger):
            pass
    assert not board.output_changes


def test_a_certificate_that_is_not_there_is_named() -> None:
    with pytest.raises(ToolError, match=r"/no/ca\.pem: .* Correct its path"):
        reached_by({"grpc_address": "127.0.0.1:1", "grpc_ca": "/no/ca.pem"})


@pytest.mark.parametrize(
    ("wiring", "says"),
    [
        ({"grpc_address": "10.0.0.5:31763"}, "drive the motor of a board that is reached in the clear"),
        ({"grpc_address": "10.0.0.5"}, "should match pattern"),
        ({"grpc_address": "10.0.0.5:1", "grpc_ca": "a", "grpc_cert": "b"}, "belong together"),
        ({"grpc_ca": "a"}, "for a board that is reached by grpc_address"),
        ({"grpc_address": "localhost:1", "grpc_cert": "b", "grpc_key": "c"}, "grpc_ca vouches for"),
    ],
)
def test_a_board_in_the_clear_or_with_half_of_its_certificates_is_refused(wiring: dict[str, str], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        Board(**wiring)


@pytest.mark.parametrize("variable", ["grpc_proxy", "http_proxy", "https_proxy", "HTTP_PROXY", "all_proxy"])
@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.0.0.9", "[::1]"])
def test_a_board_on_this_computer_is_asked_directly_whatever_the_proxy_variables_say(
    monkeypatch: pytest.MonkeyPatch, host: str, variable: str
) -> None:
    server, port = serve_tcp(SimulatedBoard(TOOL, Ramp(), VirtualClock()), f"{host}:0")
    with HttpProxy(port) as proxy:
        monkeypatch.setenv(variable, proxy.url)
        with reached_by({"grpc_address": f"{host}:{port}"}) as tool:
            tool.read_block()
        assert proxy.asked == []
    server.stop(grace=None).wait()


def test_a_board_in_another_computer_is_asked_through_the_proxy(encrypted, monkeypatch: pytest.MonkeyPatch) -> None:
    _, wiring, _ = encrypted
    address, port = "board.example:31763", int(wiring["grpc_address"].rpartition(":")[2])
    with HttpProxy(port) as proxy:
        monkeypatch.setenv("grpc_proxy", proxy.url)
        other = pytest.raises(ToolError, match=r"server of Dev1 is lost")  # the certificate is not for that name
        with other, reached_by(wiring | {"grpc_address": address}):
            pass
        assert proxy.asked[0].startswith(f"CONNECT {address}")
