"""A simulated board in its own process over TCP: like a real board it outlives the programs that use it."""

import ctypes.util
import multiprocessing
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from acquisition.simulation.board import OutputChange, RealClock, SimulatedBoard
from acquisition.simulation.faults import FaultySensors, SensorFault
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import serve_tcp
from acquisition.worker_process import RealtimePriority, freeze_garbage_collector
from config.load import CONFIG_DIR, load_library, load_tool

HAS_DRIVER = any(ctypes.util.find_library(name) for name in ("nidaqmx", "nicaiu"))  # the driver of a real board
REALTIME_PRIORITY = 90  # a real board is never late
BOARD_STRETCH_US = 1_000_000


class PeakGrasper(SimulatedGrasper):
    """A simulated grasper that keeps the highest true jaw force, N."""

    peak_n = 0.0

    def step(self, command_v: float) -> dict[str, float]:
        readings = super().step(command_v)
        self.peak_n = max(self.peak_n, self.force_n)
        return readings


def _serve(tissue: str, seed: int, line: Connection) -> None:
    tool = load_tool("simulated")
    grasper = PeakGrasper(tool, load_library("porcine"), tissue, seed)
    sensors = FaultySensors(grasper, tool)
    board = SimulatedBoard(tool, sensors, RealClock())
    server, port = serve_tcp(board)
    RealtimePriority(True, REALTIME_PRIORITY, BOARD_STRETCH_US, hard_limit_s=None)
    freeze_garbage_collector()
    answers: dict[str, Callable[..., Any]] = {
        "output_v": lambda: board.output_v,
        "last_output": lambda: board.output_changes[-1] if board.output_changes else OutputChange(0, 0, 0.0),
        "peak_force_n": lambda: grasper.peak_n,
        "break": sensors.inject_fault,
        "mend": sensors.clear_fault,
        "be_mute": board.disconnect,
        "hold_samples": board.withhold_samples,
        "cut_sample_clock": board.stop_sample_clock,
        "fail_next_read": board.fail_next_read,
    }
    line.send(port)
    while question := line.recv():
        name, *arguments = question
        line.send((answers[name](*arguments), time.monotonic_ns()))
    server.stop(0.2).wait()


class ServedBoard:
    """A simulated board in its own process; `tool_file` describes a real tool with this board's address."""

    def __init__(self, folder: Path, tissue: str = "bladder", seed: int = 1, *, measured: bool = True) -> None:
        """Prepare the board; `measured`: whether the tool file's force scale counts as measured."""
        self._scale = "true\ndate = 2026-11-01" if measured else "false"
        context = multiprocessing.get_context("spawn")
        self._line, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(tissue, seed, theirs), daemon=True)
        self.tool_file = folder / "served.toml"

    def __enter__(self) -> Self:
        self._process.start()
        port = self._line.recv()
        text = (CONFIG_DIR / "tools/simulated.toml").read_text()
        text = text.replace('kind = "simulated"', 'kind = "nidaq"', 1)
        text = text.replace("measured = false\n", f"measured = {self._scale}\n", 1)
        self.tool_file.write_text(text.replace("[board]\n", f'[board]\ngrpc_address = "127.0.0.1:{port}"\n', 1))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._line.send(None)
        self._process.join(5)
        self._process.kill()

    def _ask(self, *question: Any) -> tuple[Any, int]:
        self._line.send(question)
        return self._line.recv()

    def tell(self, *question: Any) -> int:
        """Call a method of the board or its sensors; return the time of the call, ns of the monotonic clock."""
        return self._ask(*question)[1]

    def break_now(self, fault: SensorFault) -> int:
        return self.tell("break", fault)

    @property
    def output_v(self) -> float:
        return self._ask("output_v")[0]

    @property
    def peak_force_n(self) -> float:
        """Highest true jaw force so far, N."""
        return self._ask("peak_force_n")[0]

    def wait_for_force(self, timeout_s: float = 10.0) -> None:
        """Wait until the motor is driven in a grasp."""
        deadline = time.monotonic() + timeout_s
        while self.output_v < 1.0:
            assert time.monotonic() < deadline, "the motor was never driven"
            time.sleep(0.005)

    def zero_after_ms(self, since_ns: int, timeout_s: float = 5.0) -> float:
        """Return the time from `since_ns` of the monotonic clock until the motor output stays at zero, ms."""
        deadline = time.monotonic() + timeout_s
        while self.output_v != 0.0:
            assert time.monotonic() < deadline, f"the motor is still driven with {self.output_v} V"
            time.sleep(0.005)
        return max(0.0, (self._ask("last_output")[0].at_ns - since_ns) / 1e6)
