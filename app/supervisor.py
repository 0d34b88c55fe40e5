"""Starts the workers, notices their death within milliseconds, and restarts them a bounded number of times."""

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

from acquisition import guard
from acquisition import worker as acquisition_worker
from acquisition.bus import Endpoints
from acquisition.nidaq import reset_device
from acquisition.process import LAST_RESORT_S, Activity, activity_of, start_child
from app.plan import ServicePlan
from app.record import worker as recorder_worker
from app.record.run_file import Rig
from config.errors import ToolError
from config.schema import ToolKind
from estimator import worker as estimator_worker

RESTARTS_A_MINUTE = 3
ENDING_S = 1.5
RESET_S = 3.0
RESET_AGAIN_S = 0.05
ZERO_FIRST_S = 0.1
"""So long a reset may take before the death of the worker is told; usual are 10 ms."""


class Condition(StrEnum):
    """How a worker is."""

    STARTING = "starting"
    RUNNING = "running"
    FAULTED = "faulted"


@dataclass(slots=True)
class Worker:
    name: str
    main: Callable[[Any], None]
    setup: Any
    process: BaseProcess | None = None
    condition: Condition = Condition.STARTING
    has_run: bool = False
    hung: BaseProcess | None = None
    activity: Activity | None = None
    deaths: deque[float] = field(default_factory=lambda: deque(maxlen=RESTARTS_A_MINUTE + 1))


class Supervisor:
    """Owns the worker processes of one service."""

    def __init__(
        self,
        plan: ServicePlan,
        on_death: Callable[[str, str], None],
        on_motor: Callable[[str | None], None],
        watch_over: Callable[[asyncio.Task[None]], None],
    ) -> None:
        """`on_death(worker, text)` is called in the event loop when a worker has died unasked, `on_motor(text)` when
        the motor of a dead one could not be brought to zero, and `on_motor(None)` when it is there. `watch_over` takes
        each task that must not end unnoticed."""
        self._plan = plan
        self._on_death, self._on_motor, self._watch_over = on_death, on_motor, watch_over
        self._folder = tempfile.TemporaryDirectory(prefix="graspwatch-")
        self.endpoints = Endpoints.in_folder(Path(self._folder.name))
        self._context = multiprocessing.get_context("spawn")
        self._begin = self._context.Event()
        self._ending = False
        self._replacing: set[asyncio.Task[None]] = set()
        acquisition = acquisition_worker.Setup(
            os.getpid(),
            self.endpoints,
            plan.tool,
            plan.library,
            plan.settings.conditioning,
            plan.tissue,
            plan.seed,
            plan.settings.limiter,
            plan.settings.realtime,
            self._begin,
            plan.settings.safety.server_silence_s,
        )
        estimator = estimator_worker.Setup(os.getpid(), self.endpoints, plan.tool, plan.library, plan.settings)
        rig = Rig(plan.tool, plan.library, plan.settings)
        recorder = recorder_worker.Setup(
            os.getpid(), self.endpoints, plan.recordings_folder, rig, plan.settings.realtime.priority
        )
        self.workers = {
            "acquisition": Worker("acquisition", acquisition_worker.main, acquisition),
            "estimator": Worker("estimator", estimator_worker.main, estimator),
            "recorder": Worker("recorder", recorder_worker.main, recorder),
        }
        if plan.tool.kind is ToolKind.NIDAQ:  # a simulated tool's motor is gone with its worker
            setup = guard.Setup(os.getpid(), self.endpoints, plan.tool, plan.settings.realtime)
            self.workers["guard"] = Worker("guard", guard.main, setup)
        if plan.settings.foxglove.port:
            from app import foxglove as foxglove_worker  # with its library, only where it is asked for

            setup = foxglove_worker.Setup(
                os.getpid(),
                self.endpoints,
                plan.settings.foxglove.port,
                plan.tool.title,
                plan.library,
                plan.tool.board.sample_rate_hz,
            )
            self.workers["foxglove"] = Worker("foxglove", foxglove_worker.main, setup)

    def begin_with_fault(self, why: str) -> None:
        """What the next acquisition worker begins with; empty: nothing is at fault."""
        acquisition = self.workers["acquisition"]
        acquisition.setup = replace(acquisition.setup, fault=why)

    def start_estimator(self) -> None:
        self._start(self.workers["estimator"])

    def start_guard(self) -> None:
        if "guard" in self.workers:
            self._start(self.workers["guard"])

    def start_foxglove(self) -> None:
        if "foxglove" in self.workers:
            self._start(self.workers["foxglove"])

    @property
    def is_guarded(self) -> bool:
        """Whether a motor that outlives its worker has its guard."""
        return "guard" not in self.workers or self.workers["guard"].condition is Condition.RUNNING

    def runs(self, name: str) -> bool:
        """A worker has shown that it does its work; returns whether that is news. A dead one's last words are none."""
        worker = self.workers[name]
        if worker.condition is not Condition.STARTING or not (worker.process and worker.process.is_alive()):
            return False
        worker.condition, worker.has_run = Condition.RUNNING, True
        return True

    def start_recorder(self) -> None:
        self._start(self.workers["recorder"])

    def start_acquisition(self) -> None:
        """It makes itself ready, and waits until the tool may be opened."""
        self._start(self.workers["acquisition"])

    def open_tool(self) -> None:
        self._begin.set()

    def _start(self, worker: Worker) -> None:
        process = self._context.Process(target=worker.main, args=(worker.setup,), name=f"graspwatch-{worker.name}")
        start_child(process)
        worker.process, worker.condition = process, Condition.STARTING
        asyncio.get_running_loop().add_reader(process.sentinel, self._died, worker, process)

    def _died(self, worker: Worker, process: BaseProcess) -> None:
        asyncio.get_running_loop().remove_reader(process.sentinel)
        process.join()
        replacing = asyncio.create_task(self._replace(worker, process))
        self._replacing.add(replacing)
        replacing.add_done_callback(self._replacing.discard)
        self._watch_over(replacing)

    async def _replace(self, worker: Worker, process: BaseProcess) -> None:
        """Bring the motor of a dead worker to zero, tell its death, and start another one unless that is hopeless."""
        worker.deaths.append(time.monotonic())
        often = len(worker.deaths) > RESTARTS_A_MINUTE and worker.deaths[-1] - worker.deaths[0] < 60.0
        final = often or (process.exitcode == ToolError.exit_code and not worker.has_run)
        worker.condition, zeroing = Condition.STARTING, None
        if worker.name == "acquisition" and process.exitcode != 0:
            zeroing = asyncio.create_task(self._zero_motor())
            await asyncio.wait({zeroing}, timeout=ZERO_FIRST_S)
        worker.condition = Condition.FAULTED if final else Condition.STARTING
        if not self._ending:
            what = "it stays down: mend the cause and start the service again" if final else "it is being restarted"
            self._on_death(worker.name, f"The {worker.name} worker {self._how_it_ended(worker, process)}; {what}.")
        if zeroing:
            await zeroing
        if not final and not self._ending:
            self._start(worker)

    async def _zero_motor(self) -> None:
        """The board holds its last output when its owner dies; only a reset brings it to zero."""
        if self._plan.tool.kind is not ToolKind.NIDAQ:
            return
        try:
            async with asyncio.timeout(RESET_S):
                while not await self._reset():
                    await asyncio.sleep(RESET_AGAIN_S)
        except TimeoutError:
            self._on_motor("The board does not answer to a reset: switch off the motor's amplifier NOW.")

    async def _reset(self) -> bool:
        try:
            await asyncio.to_thread(reset_device, self._plan.tool)
        except ToolError as error:
            self._on_motor(str(error))
            return False
        self._on_motor(None)
        return True

    @staticmethod
    def _how_it_ended(worker: Worker, process: BaseProcess) -> str:
        if worker.hung is process:
            return "did not answer and was ended"
        if process.exitcode == -signal.SIGKILL:
            return (
                "died (signal 9), because the machine ran out of memory, somebody ended it, or one call of a library "
                f"computed for {LAST_RESORT_S} s at real-time priority"
            )
        return f"died (signal {-process.exitcode})" if process.exitcode < 0 else f"died (exit code {process.exitcode})"

    def is_held_up(self, name: str) -> bool:
        """Whether something keeps a worker from running: it is stopped, waits for the disk, or gets no processor."""
        worker = self.workers[name]
        if not worker.process:
            return False
        before, worker.activity = worker.activity, activity_of(worker.process.pid)
        return worker.activity.is_suspended or (worker.activity.is_runnable and worker.activity == before)

    def kill(self, name: str) -> None:
        """End a worker that does not answer any more; its death is then handled like any other."""
        worker = self.workers[name]
        if worker.process and worker.process.is_alive():
            worker.hung = worker.process
            worker.process.kill()

    async def stop(self) -> None:
        """End the workers in order; what does not end is killed."""
        self._ending = True
        processes = [worker.process for worker in self.workers.values() if worker.process]
        for process in processes:
            if process.is_alive():
                process.terminate()
        await asyncio.to_thread(self._join, processes)
        acquisition = self.workers["acquisition"].process
        if acquisition and acquisition.exitcode != 0:
            await self._zero_motor()
        self._folder.cleanup()

    @staticmethod
    def _join(processes: list[BaseProcess]) -> None:
        deadline = time.monotonic() + ENDING_S
        for process in processes:
            process.join(max(deadline - time.monotonic(), 0.0))
            if process.is_alive():
                process.kill()
                process.join()
