"""The class BusListener, which listens to the workers' sockets in the event loop."""

import asyncio
from collections.abc import Callable

import zmq

from acquisition import bus

MAX_MESSAGES_PER_TURN = 10  # of one bus socket, before other tasks of the event loop run
READ_PERIOD_S = 0.01
"""Messages are read together at this interval: waking up for each of them costs as much time as handling it."""


class BusListener:
    """Listener that passes each message of a worker on, in the event loop."""

    def __init__(self) -> None:
        self._context = zmq.Context()

    async def listen(self, address: str, on_message: Callable[[list[bytes]], None]) -> None:
        """Pass each message published at `address` to `on_message`.

        All sockets are read at the same times, so that the event loop wakes up once for all of them.
        """
        loop, socket = asyncio.get_running_loop(), bus.open_subscriber(self._context, address)
        try:
            while True:
                for _ in range(MAX_MESSAGES_PER_TURN):
                    if not socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
                        await asyncio.sleep(READ_PERIOD_S - loop.time() % READ_PERIOD_S)
                        break
                    on_message(socket.recv_multipart(zmq.NOBLOCK))
                else:
                    await asyncio.sleep(0)
        finally:
            socket.close()

    def close(self) -> None:
        """Close the sockets, once no task listens any more."""
        self._context.destroy(linger=0)
