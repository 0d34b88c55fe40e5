"""Long work in a process of its own, niced, so that neither the event loop nor a live tool is disturbed by it."""

import asyncio
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable
from multiprocessing.connection import Connection
from typing import Any

from acquisition.process import become_worker
from config.errors import GraspwatchError, ServiceError

NICE = 10
CLOSED = None  # a process's last word: all is done


async def run_aside(
    name: str, work: Callable[..., Iterable[Any]], *arguments: Any, told: Callable[[Any], None]
) -> None:
    """Run the generator `work(*arguments)` in a process called `name`; hand what it yields to `told` as it comes.

    Cancelling ends the process.

    Raises:
        GraspwatchError: the same that `work` raised.
        ServiceError: the process failed or died.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    asked = name, os.getpid(), theirs, work, arguments
    process = context.Process(target=_main, args=asked, name=f"graspwatch-{name}")
    process.start()
    theirs.close()
    loop, arrived = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(ours.fileno(), arrived.set)
    try:
        while (report := await _next(ours, arrived)) is not CLOSED:
            if isinstance(report, GraspwatchError):
                raise report
            told(report)
    except EOFError:
        await asyncio.to_thread(process.join)
        code = process.exitcode
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        raise ServiceError(f"The process {name!r} died ({how}). Is there enough memory and disk? Try again.") from None
    finally:
        loop.remove_reader(ours.fileno())
        ours.close()
        process.kill()
        await asyncio.to_thread(process.join)


async def _next(pipe: Connection, arrived: asyncio.Event) -> Any:
    while not pipe.poll():
        arrived.clear()
        await arrived.wait()
    return pipe.recv()


def _main(
    name: str, parent_pid: int, pipe: Connection, work: Callable[..., Iterable[Any]], arguments: tuple[Any, ...]
) -> None:
    stop = become_worker(name, parent_pid)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # there is no motor here to be brought to zero first
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal tells the whole group; the service ends its own
    if stop.set:
        return
    os.nice(NICE)
    try:
        for report in work(*arguments):
            pipe.send(report)
        pipe.send(CLOSED)
    except GraspwatchError as error:
        pipe.send(error)
    except OSError as error:
        pipe.send(ServiceError(f"{error.strerror or error} ({error.filename or name})."))
