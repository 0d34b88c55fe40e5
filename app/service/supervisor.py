"""The supervisor: starts the workers, notices deaths within milliseconds, and restarts a bounded number of times."""

import asyncio
import multiprocessing
import os
import signal
import tempfile
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from acquisition import worker as acquisition_worker
from acquisition.bus import Endpoints
from acquisition.drivers.nidaq import reset_device
from acquisition.safety import safety_monitor
from acquisition.worker_process import HARD_CPU_LIMIT_S, ProcessActivity, read_activity, start_child_process
from app.recordings import recorder_worker
from app.recordings.mcap_writer import RecordingContext
from config.errors import ToolError
from config.schema import ToolKind
from config.service_plan import ServicePlan
from estimator import worker as estimator_worker

MAX_RESTARTS_PER_MINUTE = 3
SHUTDOWN_TIMEOUT_S = 1.5
RESET_TIMEOUT_S = 3.0
RESET_RETRY_S = 0.05
ZERO_WAIT_S = 0.1
"""Time to wait for a reset of the board before the worker's death is reported; a reset usually takes 10 ms."""


class WorkerCondition(StrEnum):
    """The condition of a worker."""

    STARTING = "starting"
    RUNNING = "running"
    FAULTED = "faulted"


@dataclass(slots=True)
class Worker:
    name: str
    main: Callable[[Any], None]
    setup: Any
    process: BaseProcess | None = None
    condition: WorkerCondition = WorkerCondition.STARTING
    has_run: bool = False
    hung_process: BaseProcess | None = None
    activity: ProcessActivity | None = None
    death_times_s: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_RESTARTS_PER_MINUTE + 1))


class Supervisor:
    """The owner of one service's worker processes."""

    def __init__(
        self,
        plan: ServicePlan,
        on_death: Callable[[str, str], None],
        on_motor_fault: Callable[[str | None], None],
        supervise_task: Callable[[asyncio.Task[None]], None],
    ) -> None:
        """Prepare the workers. All callbacks are called in the event loop.

        `on_death(worker, text)`: a worker died unasked. `on_motor_fault(text)`: the motor of a dead worker could not be
        brought to zero; with None: it is at zero. `supervise_task(task)`: watches a task that must not end unnoticed.
        """
        self._plan = plan
        self._on_death, self._on_motor_fault, self._supervise_task = on_death, on_motor_fault, supervise_task
        self._socket_folder = tempfile.TemporaryDirectory(prefix="graspwatch-")
        self.endpoints = Endpoints.in_folder(Path(self._socket_folder.name))
        self._context = multiprocessing.get_context("spawn")
        self._tool_may_open = self._context.Event()
        self._shutting_down = False
        self._restart_tasks: set[asyncio.Task[None]] = set()
        acquisition = acquisition_worker.AcquisitionSetup(
            os.getpid(),
            self.endpoints,
            plan.tool,
            plan.library,
            plan.settings.conditioning,
            plan.simulated_tissue,
            plan.seed,
            plan.settings.limiter,
            plan.settings.realtime,
            self._tool_may_open,
            plan.settings.safety.server_silence_s,
        )
        estimator = estimator_worker.EstimatorSetup(os.getpid(), self.endpoints, plan.tool, plan.library, plan.settings)
        context = RecordingContext(plan.tool, plan.library, plan.settings)
        recorder = recorder_worker.RecorderSetup(
            os.getpid(), self.endpoints, plan.recordings_folder, context, plan.settings.realtime.priority
        )
        self.workers = {
            "acquisition": Worker("acquisition", acquisition_worker.main, acquisition),
            "estimator": Worker("estimator", estimator_worker.main, estimator),
            "recorder": Worker("recorder", recorder_worker.main, recorder),
        }
        if plan.tool.kind is ToolKind.NIDAQ:  # a simulated tool's motor ends with its worker
            setup = safety_monitor.SafetyMonitorSetup(os.getpid(), self.endpoints, plan.tool, plan.settings.realtime)
            self.workers["guard"] = Worker("guard", safety_monitor.main, setup)
        if plan.settings.foxglove.port:
            from app.service import foxglove_worker  # imports its library only where it is needed

            setup = foxglove_worker.FoxgloveSetup(
                os.getpid(),
                self.endpoints,
                plan.settings.foxglove.port,
                plan.tool.title,
                plan.library,
                plan.tool.board.sample_rate_hz,
            )
            self.workers["foxglove"] = Worker("foxglove", foxglove_worker.main, setup)

    def set_initial_fault(self, why: str) -> None:
        """Set the fault that the next acquisition worker begins with; empty for none."""
        acquisition = self.workers["acquisition"]
        acquisition.setup = replace(acquisition.setup, previous_fault=why)

    def start_estimator(self) -> None:
        self._start(self.workers["estimator"])

    def start_safety_monitor(self) -> None:
        if "guard" in self.workers:
            self._start(self.workers["guard"])

    def start_foxglove(self) -> None:
        if "foxglove" in self.workers:
            self._start(self.workers["foxglove"])

    @property
    def has_safety_monitor(self) -> bool:
        """Whether the safety monitor runs, or the tool is simulated and needs none."""
        return "guard" not in self.workers or self.workers["guard"].condition is WorkerCondition.RUNNING

    def mark_running(self, name: str) -> bool:
        """Mark a worker as running after a message from it; return whether that is a change.

        Late messages of a worker that has died are ignored.
        """
        worker = self.workers[name]
        if worker.condition is not WorkerCondition.STARTING or not (worker.process and worker.process.is_alive()):
            return False
        worker.condition, worker.has_run = WorkerCondition.RUNNING, True
        return True

    def start_recorder(self) -> None:
        self._start(self.workers["recorder"])

    def start_acquisition(self) -> None:
        """Start the acquisition, which prepares itself and waits for `open_tool`."""
        self._start(self.workers["acquisition"])

    def open_tool(self) -> None:
        self._tool_may_open.set()

    def _start(self, worker: Worker) -> None:
        process = self._context.Process(target=worker.main, args=(worker.setup,), name=f"graspwatch-{worker.name}")
        start_child_process(process)
        worker.process, worker.condition = process, WorkerCondition.STARTING
        asyncio.get_running_loop().add_reader(process.sentinel, self._on_process_exit, worker, process)

    def _on_process_exit(self, worker: Worker, process: BaseProcess) -> None:
        asyncio.get_running_loop().remove_reader(process.sentinel)
        process.join()
        replacing = asyncio.create_task(self._restart(worker, process))
        self._restart_tasks.add(replacing)
        replacing.add_done_callback(self._restart_tasks.discard)
        self._supervise_task(replacing)

    async def _restart(self, worker: Worker, process: BaseProcess) -> None:
        """Zero the motor of a dead acquisition, report the death, and start a new worker unless that is hopeless."""
        worker.death_times_s.append(time.monotonic())
        often = (
            len(worker.death_times_s) > MAX_RESTARTS_PER_MINUTE
            and worker.death_times_s[-1] - worker.death_times_s[0] < 60.0
        )
        final = often or (process.exitcode == ToolError.exit_code and not worker.has_run)
        worker.condition, zeroing = WorkerCondition.STARTING, None
        if worker.name == "acquisition" and process.exitcode != 0:
            zeroing = asyncio.create_task(self._zero_motor())
            await asyncio.wait({zeroing}, timeout=ZERO_WAIT_S)
        worker.condition = WorkerCondition.FAULTED if final else WorkerCondition.STARTING
        if not self._shutting_down:
            what = "it stays down: mend the cause and start the service again" if final else "it is being restarted"
            self._on_death(worker.name, f"The {worker.name} worker {self._describe_exit(worker, process)}; {what}.")
        if zeroing:
            await zeroing
        if not final and not self._shutting_down:
            self._start(worker)

    async def _zero_motor(self) -> None:
        """Reset the board: it holds its last output when its owner dies, and only a reset brings it to zero."""
        if self._plan.tool.kind is not ToolKind.NIDAQ:
            return
        try:
            async with asyncio.timeout(RESET_TIMEOUT_S):
                while not await self._reset_board():
                    await asyncio.sleep(RESET_RETRY_S)
        except TimeoutError:
            self._on_motor_fault("The board does not answer to a reset: switch off the motor's amplifier NOW.")

    async def _reset_board(self) -> bool:
        try:
            await asyncio.to_thread(reset_device, self._plan.tool)
        except ToolError as error:
            self._on_motor_fault(str(error))
            return False
        self._on_motor_fault(None)
        return True

    @staticmethod
    def _describe_exit(worker: Worker, process: BaseProcess) -> str:
        if worker.hung_process is process:
            return "did not answer and was ended"
        if process.exitcode == -signal.SIGKILL:
            return (
                "died (signal 9), because the machine ran out of memory, somebody ended it, or one call of a library "
                f"computed for {HARD_CPU_LIMIT_S} s at real-time priority"
            )
        assert process.exitcode is not None
        return f"died (signal {-process.exitcode})" if process.exitcode < 0 else f"died (exit code {process.exitcode})"

    def is_blocked(self, name: str) -> bool:
        """Return whether a worker cannot run: it is stopped, waits for the disk, or gets no processor."""
        worker = self.workers[name]
        if not worker.process or worker.process.pid is None:
            return False
        before, worker.activity = worker.activity, read_activity(worker.process.pid)
        return worker.activity.is_suspended or (worker.activity.is_runnable and worker.activity == before)

    def kill(self, name: str) -> None:
        """Kill a worker that does not answer; its death is then handled like any other."""
        worker = self.workers[name]
        if worker.process and worker.process.is_alive():
            worker.hung_process = worker.process
            worker.process.kill()

    async def stop(self) -> None:
        """Terminate the workers, kill those that hang, and zero the motor if the acquisition did not end in order."""
        self._shutting_down = True
        processes = [worker.process for worker in self.workers.values() if worker.process]
        for process in processes:
            if process.is_alive():
                process.terminate()
        await asyncio.to_thread(self._join, processes)
        acquisition = self.workers["acquisition"].process
        if acquisition and acquisition.exitcode != 0:
            await self._zero_motor()
        self._socket_folder.cleanup()

    @staticmethod
    def _join(processes: list[BaseProcess]) -> None:
        deadline = time.monotonic() + SHUTDOWN_TIMEOUT_S
        for process in processes:
            process.join(max(deadline - time.monotonic(), 0.0))
            if process.is_alive():
                process.kill()
                process.join()
