"""The function that runs long work in a background process, with low priority so that it does not slow a live tool.

Such a process ends with its children when its task is canceled, or when the service ends in any way.
"""

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
DONE_MESSAGE = None  # a process's last message

SendMessage = Callable[[Any], None]


async def run_in_background_process(
    name: str, work: Callable[..., None], *arguments: Any, on_message: SendMessage, advice: str
) -> None:
    """Run `work(send, *arguments)` in a process called `name`, and pass each message that it sends to `on_message`.

    Cancellation kills the process and its children at once, because none of them needs an orderly end.

    Raises:
        GraspwatchError: the error that `work` raised.
        ServiceError: the process died (the text ends with `advice`), or a file could not be read or written.
    """
    ours, theirs = multiprocessing.Pipe(duplex=False)
    with theirs:
        process = start_child_process(f"graspwatch-{name}", _process_main, name, os.getpid(), theirs, work, arguments)
    assert process.pid is not None  # it is started
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
        process.kill()  # in case it has no group of its own yet, and so no children
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # also children that outlived it
        await asyncio.to_thread(process.join)
        ours.close()


async def _receive(pipe: Connection, process: BaseProcess, arrived: asyncio.Event) -> Any:
    """Wait for a message; raise EOFError once the process is dead, even if its children keep the pipe open."""
    while not pipe.poll():
        if not process.is_alive() and not pipe.poll():
            raise EOFError
        arrived.clear()
        await arrived.wait()
    return await asyncio.to_thread(pipe.recv)  # of a large message the rest may be late


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
    """Lower the priority, and form a process group with all future children, which ends when the service ends.

    It is a group and not a session, because Linux may share the processor evenly between sessions, whatever their
    niceness (autogroups, sched(7)). A terminal's Ctrl+C does not reach the group: the service itself kills it.
    """
    os.setpgid(0, 0)
    os.nice(NICENESS)
    flag = initialize_worker(name, service_pid)
    signal.signal(signal.SIGTERM, _kill_process_group)
    if flag.is_set:  # the signal came before the line above
        _kill_process_group()


def _kill_process_group(number: int = 0, frame: FrameType | None = None) -> None:
    os.killpg(0, signal.SIGKILL)
