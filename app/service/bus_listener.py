"""The class BusListener, which listens to the workers' sockets in the event loop."""

import asyncio
from collections.abc import Callable

import zmq

from acquisition import bus

MAX_MESSAGES_PER_TURN = 10  # of one bus socket, before other tasks of the event loop run


class BusListener:
    """Listener that passes each message of a worker on, in the event loop."""

    def __init__(self) -> None:
        self._context = zmq.Context()

    async def listen(self, address: str, on_message: Callable[[list[bytes]], None]) -> None:
        """Pass each message published at `address` to `on_message`.

        The event loop watches the socket itself: a future for each message cost as much time as handling it.
        """
        loop, readable = asyncio.get_running_loop(), asyncio.Event()
        socket = bus.open_subscriber(self._context, address)
        loop.add_reader(socket.FD, readable.set)
        readable.set()  # messages that came before the line above do not wake the loop
        try:
            while True:
                await readable.wait()
                readable.clear()
                for _ in range(MAX_MESSAGES_PER_TURN):
                    if not socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
                        break
                    on_message(socket.recv_multipart(zmq.NOBLOCK))
                else:
                    readable.set()
                    await asyncio.sleep(0)
        finally:
            loop.remove_reader(socket.FD)
            socket.close()

    def close(self) -> None:
        """Close the sockets, once no task listens any more."""
        self._context.destroy(linger=0)
