"""Long work in a process of its own: it gives way to a live tool, and ends with all its children when it is told to and
when the service ends, however that ends."""

import asyncio
import contextlib
import multiprocessing
import os
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any

from acquisition.worker_process import initialize_worker, start_child_process
from config.errors import GraspwatchError, ServiceError

NICENESS = 10
DONE_MESSAGE = None  # a process's last word

SendMessage = Callable[[Any], None]


async def run_in_background_process(
    name: str, work: Callable[..., None], *arguments: Any, on_message: SendMessage, advice: str
) -> None:
    """Run `work(tell, *arguments)` in a process called `name`; hand what it tells to `told` as it comes.

    Cancelling ends the process and its children at once; nothing they hold needs an orderly end.

    Raises:
        GraspwatchError: the same that `work` raised.
        ServiceError: the process failed or died; the text closes with `advice`.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(
        target=_process_main, args=(name, os.getpid(), theirs, work, arguments), name=f"graspwatch-{name}"
    )
    with theirs:
        start_child_process(process)
    loop, arrived = asyncio.get_running_loop(), asyncio.Event()
    for source in (ours.fileno(), process.sentinel):
        loop.add_reader(source, arrived.set)
    try:
        while (report := await _receive(ours, process, arrived)) is not DONE_MESSAGE:
            if isinstance(report, GraspwatchError):
                raise report
            on_message(report)
    except EOFError:
        await asyncio.to_thread(process.join)
        code = process.exitcode or 0
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        raise ServiceError(
            f"The process {name!r} died ({how}); the machine may have run out of memory. {advice}"
        ) from None
    finally:
        for source in (ours.fileno(), process.sentinel):
            loop.remove_reader(source)
        ours.close()
        process.kill()  # it may not have become a group yet: then it has no children either
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # also children that outlived it
        await asyncio.to_thread(process.join)


async def _receive(pipe: Connection, process: BaseProcess, arrived: asyncio.Event) -> Any:
    """Raises EOFError once the process is dead; its children may keep the pipe open beyond that."""
    while not pipe.poll():
        if not process.is_alive() and not pipe.poll():
            raise EOFError
        arrived.clear()
        await arrived.wait()
    return pipe.recv()


# --- in the process -----------------------------------------------------------------------------------------------


def _process_main(
    name: str, service_pid: int, pipe: Connection, work: Callable[..., None], arguments: tuple[Any, ...]
) -> None:
    _lower_priority(name, service_pid)
    try:
        work(pipe.send, *arguments)
        pipe.send(DONE_MESSAGE)
    except GraspwatchError as error:
        pipe.send(error)
    except OSError as error:
        pipe.send(ServiceError(f"{error.strerror or error} ({error.filename or name}). Make room or mend it."))


def _lower_priority(name: str, service_pid: int) -> None:
    """Low priority, and one group with all children to come, which ends when the service has ended.

    A group and not a session: between sessions Linux may share the processor evenly, whatever their niceness
    (autogroups, sched(7)). Of its own: a terminal's Ctrl+C is for the service, which ends this process itself.
    """
    os.setpgid(0, 0)
    os.nice(NICENESS)
    flag = initialize_worker(name, service_pid)
    signal.signal(signal.SIGTERM, _kill_process_group)
    if flag.is_set:  # it was to end before the line above
        _kill_process_group()


def _kill_process_group(number: int = 0, frame: FrameType | None = None) -> None:
    os.killpg(0, signal.SIGKILL)
