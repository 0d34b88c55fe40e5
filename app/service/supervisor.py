"""The class Supervisor: starts the workers, notices deaths within milliseconds, restarts a bounded number of times."""

import asyncio
import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.process import BaseProcess
from pathlib import Path

from acquisition.bus import Endpoints
from acquisition.worker_process import HARD_CPU_LIMIT_S, read_process_snapshot, start_child_process
from app.service.motor_reset import zero_motor
from app.service.workers import (
    MAX_RESTARTS_PER_MINUTE,
    START_ORDER,
    Worker,
    WorkerCondition,
    build_workers,
    display_worker_name,
)
from config.errors import ConfigurationError, ServiceError, ToolError
from config.home_folder import expand_home
from config.schema import Tool
from config.service_plan import ServicePlan

SHUTDOWN_TIMEOUT_S = 1.5
SOCKET_PLACES = ("/tmp", "/var/tmp", "/dev/shm")
MAX_SOCKET_FOLDER_BYTES = 60
"""The path of a socket has at most 107 bytes (unix(7)); the names in the folder need 46."""
TOOL_WORKERS = ("recorder", "estimator", "acquisition")
"""The workers that compute with the tool's calibration, in the order of their replacement."""
MAX_IDLE_TICKS = 1
"""Clock ticks (10 ms) between two checks, 33 ms apart, that an idle process may take: its sockets have a thread."""
ZERO_WAIT_S = 0.1
"""Time to wait for a reset of the board before the worker's death is reported; a reset usually takes 10 ms."""


def make_socket_folder(data: Path) -> tempfile.TemporaryDirectory[str]:
    """Make the private folder of the workers' sockets, in the first place that takes one and has a short path.

    Raises:
        ServiceError: there is no such place.
    """
    places = (os.environ.get("TMPDIR"), os.environ.get("XDG_RUNTIME_DIR"), *SOCKET_PLACES, str(data))
    refused = []
    for named in dict.fromkeys(place for place in places if place):
        try:
            place = os.path.abspath(expand_home(named))
        except ConfigurationError:
            refused.append(f"{named} (no such home folder)")
            continue
        if len(os.fsencode(place)) > MAX_SOCKET_FOLDER_BYTES:
            refused.append(f"{place} (longer than {MAX_SOCKET_FOLDER_BYTES} bytes)")
            continue
        try:
            return tempfile.TemporaryDirectory(prefix="graspwatch-", dir=place)
        except OSError as error:
            refused.append(f"{place} ({error.strerror})")
    raise ServiceError(
        f"There is no folder for the workers' sockets: {', '.join(refused)}. Set TMPDIR to a folder with a short path "
        "that can be written to."
    )


class Supervisor:
    """The owner of one service's worker processes."""

    def __init__(self, plan: ServicePlan) -> None:
        """Prepare the workers; `start` starts them."""
        self._plan = plan
        self._socket_folder = make_socket_folder(plan.data_folder)
        self.endpoints = Endpoints.in_folder(Path(self._socket_folder.name))
        # A pipe and no `Event`: an `Event` needs shared memory, and a killed worker could hold its lock.
        self._start_signal, self._start_sender = multiprocessing.Pipe(duplex=False)
        self.tool_may_open = False
        self._shutting_down = False
        self._restart_tasks: set[asyncio.Task[None]] = set()
        self.workers = build_workers(plan, self.endpoints, self._start_signal)

    def start(
        self,
        on_death: Callable[[str, str], None],
        on_replacement: Callable[[str], None],
        on_motor_fault: Callable[[str | None], None],
        watch_task: Callable[[asyncio.Task[None]], None],
    ) -> None:
        """Start the workers; the acquisition prepares itself and waits for `open_tool`.

        All callbacks are called in the event loop. `on_death(worker, text)`: a worker died unasked.
        `on_replacement(worker)`: a worker ended for `use_tool`, and a new one starts.
        `on_motor_fault(text)`: the motor of a dead worker could not be brought to zero; with None: it is at zero.
        `watch_task(task)`: watches a task that must not end unnoticed.
        """
        self._on_death, self._on_motor_fault, self._watch_task = on_death, on_motor_fault, watch_task
        self._on_replacement = on_replacement
        for name in START_ORDER:
            if name in self.workers:
                self._start(self.workers[name])

    def open_tool(self) -> None:
        """Let the acquisition open the tool: the filters are ready."""
        self.tool_may_open = True
        self._start_sender.send(None)

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
        if self.is_being_replaced(name):
            return False
        worker.condition, worker.has_run = WorkerCondition.RUNNING, True
        return True

    def is_being_replaced(self, name: str) -> bool:
        """Return whether a worker has been asked to end by `use_tool`, and its successor has not started yet."""
        worker = self.workers[name]
        return worker.process is not None and worker.replaced_process is worker.process

    def use_tool(self, tool: Tool) -> None:
        """Replace the workers that compute with the tool's constants, so that the new ones begin with those of `tool`.

        Call this while the tool is disarmed. A worker that does not end in time is killed.
        """
        for name in TOOL_WORKERS:
            worker = self.workers[name]
            worker.setup = worker.setup.with_tool(tool)
            process = worker.replaced_process = worker.process
            if process is None:
                continue
            worker.condition = WorkerCondition.STARTING
            process.terminate()
            asyncio.get_running_loop().call_later(SHUTDOWN_TIMEOUT_S, _kill_if_alive, process)

    def _start(self, worker: Worker) -> None:
        process = start_child_process(f"graspwatch-{worker.name}", worker.main, worker.setup)
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
        is_planned = worker.replaced_process is process
        if not is_planned:
            worker.death_times_s.append(time.monotonic())
        often = not is_planned and (
            len(worker.death_times_s) > MAX_RESTARTS_PER_MINUTE
            and worker.death_times_s[-1] - worker.death_times_s[0] < 60.0
        )
        final = often or (not is_planned and process.exitcode == ToolError.exit_code and not worker.has_run)
        worker.condition, zeroing = WorkerCondition.STARTING, None
        if worker.name == "acquisition" and process.exitcode != 0:
            zeroing = asyncio.create_task(zero_motor(self._plan.tool, self._on_motor_fault))
            await asyncio.wait({zeroing}, timeout=ZERO_WAIT_S)
        worker.condition = WorkerCondition.FAULTED if final else WorkerCondition.STARTING
        if is_planned:
            self._on_replacement(worker.name)
        elif not self._shutting_down:
            what = "it stays down: mend the cause and start the service again" if final else "it is being restarted"
            name = display_worker_name(worker.name)
            self._on_death(worker.name, f"The {name} worker {self._describe_exit(worker, process)}; {what}.")
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

    def is_kept_from_running(self, name: str) -> bool:
        """Return whether the system keeps a worker from running: it is stopped, waits for a disk, or gets no core."""
        worker = self.workers[name]
        if not worker.process or worker.process.pid is None:
            return False
        before, worker.activity = worker.activity, read_process_snapshot(worker.process.pid)
        return worker.activity.is_suspended or (worker.activity.is_runnable and worker.activity == before)

    def is_idle_start(self, name: str) -> bool:
        """Return whether a worker that is starting has slept since the last call; its sockets may have had a turn."""
        worker = self.workers[name]
        if worker.condition is not WorkerCondition.STARTING or self.is_being_replaced(name):
            return False
        if not worker.process or worker.process.pid is None:
            return False
        before, worker.activity = worker.activity, read_process_snapshot(worker.process.pid)
        if before is None or worker.activity.state != "S":
            return False
        return worker.activity.cpu_ticks - before.cpu_ticks <= MAX_IDLE_TICKS

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


def _kill_if_alive(process: BaseProcess) -> None:
    if process.is_alive():
        process.kill()
