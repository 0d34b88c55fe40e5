"""The supervisor: starts the workers, notices deaths within milliseconds, and restarts a bounded number of times."""

import asyncio
import multiprocessing
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path

from acquisition.bus import Endpoints
from acquisition.worker_process import HARD_CPU_LIMIT_S, read_activity, start_child_process
from app.service.motor_reset import zero_motor
from app.service.workers import MAX_RESTARTS_PER_MINUTE, START_ORDER, Worker, WorkerCondition, build_workers
from config.errors import ToolError
from config.service_plan import ServicePlan

SHUTDOWN_TIMEOUT_S = 1.5
ZERO_WAIT_S = 0.1
"""Time to wait for a reset of the board before the worker's death is reported; a reset usually takes 10 ms."""


class Supervisor:
    """The owner of one service's worker processes."""

    def __init__(self, plan: ServicePlan) -> None:
        """Prepare the workers; `start` starts them."""
        self._plan = plan
        self._socket_folder = tempfile.TemporaryDirectory(prefix="graspwatch-")
        self.endpoints = Endpoints.in_folder(Path(self._socket_folder.name))
        self._context = multiprocessing.get_context("spawn")
        self._tool_may_open = self._context.Event()
        self.tool_may_open = False  # the same, without the lock that a killed worker may hold
        self._shutting_down = False
        self._restart_tasks: set[asyncio.Task[None]] = set()
        self.workers = build_workers(plan, self.endpoints, self._tool_may_open)

    def start(
        self,
        on_death: Callable[[str, str], None],
        on_motor_fault: Callable[[str | None], None],
        watch_task: Callable[[asyncio.Task[None]], None],
    ) -> None:
        """Start the workers; the acquisition prepares itself and waits for `open_tool`.

        All callbacks are called in the event loop. `on_death(worker, text)`: a worker died unasked.
        `on_motor_fault(text)`: the motor of a dead worker could not be brought to zero; with None: it is at zero.
        `watch_task(task)`: watches a task that must not end unnoticed.
        """
        self._on_death, self._on_motor_fault, self._watch_task = on_death, on_motor_fault, watch_task
        for name in START_ORDER:
            if name in self.workers:
                self._start(self.workers[name])

    def open_tool(self) -> None:
        """Let the acquisition open the tool: the filters are ready."""
        self.tool_may_open = True
        self._tool_may_open.set()

    def set_initial_fault(self, why: str) -> None:
        """Set the fault that the next acquisition worker begins with; empty for none."""
        acquisition = self.workers["acquisition"]
        acquisition.setup = replace(acquisition.setup, previous_fault=why)

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
        self._watch_task(replacing)

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
            zeroing = asyncio.create_task(zero_motor(self._plan.tool, self._on_motor_fault))
            await asyncio.wait({zeroing}, timeout=ZERO_WAIT_S)
        worker.condition = WorkerCondition.FAULTED if final else WorkerCondition.STARTING
        if not self._shutting_down:
            what = "it stays down: mend the cause and start the service again" if final else "it is being restarted"
            self._on_death(worker.name, f"The {worker.name} worker {self._describe_exit(worker, process)}; {what}.")
        if zeroing:
            await zeroing
        if not final and not self._shutting_down:
            self._start(worker)

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
            await zero_motor(self._plan.tool, self._on_motor_fault)
        self._socket_folder.cleanup()

    @staticmethod
    def _join(processes: list[BaseProcess]) -> None:
        deadline = time.monotonic() + SHUTDOWN_TIMEOUT_S
        for process in processes:
            process.join(max(deadline - time.monotonic(), 0.0))
            if process.is_alive():
                process.kill()
                process.join()
