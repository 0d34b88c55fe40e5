"""The context manager begin_worker: a worker begins, publishes on the bus, and ends with its parent or on a signal."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

import zmq

from acquisition import bus
from acquisition.worker_process import START_HEADROOM_BYTES, ProcessEndFlag, initialize_worker, limit_memory

CLOSE_TIMEOUT_MS = 200  # for the last messages


@dataclass(frozen=True, slots=True)
class WorkerLife:
    """What each worker has: the flag of its end, the context of its sockets, and the socket on which it publishes."""

    stop: ProcessEndFlag
    context: zmq.Context
    publisher: zmq.Socket


@contextlib.contextmanager
def begin_worker(name: str, parent_pid: int, address: str) -> Iterator[WorkerLife]:
    """Begin a worker that publishes at `address`; send the last messages and close its sockets at the end."""
    stop = initialize_worker(name, parent_pid)
    limit_memory(START_HEADROOM_BYTES)
    context = zmq.Context()
    try:
        yield WorkerLife(stop, context, bus.open_publisher(context, address))
    finally:
        context.destroy(linger=CLOSE_TIMEOUT_MS)
