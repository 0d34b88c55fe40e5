"""The class Commander, which sends commands to the acquisition worker and waits for its answers."""

import asyncio
import time

import zmq
import zmq.asyncio

from acquisition import bus
from config.errors import RefusedError, ServiceError

ANSWER_TIMEOUT_S = 0.5
MAX_LATE_STOPS, LATE_STOP_TIMEOUT_S = 20, 10.0
"""Limits for stops that wait for a worker that is held up; it obeys them even after their callers gave up."""


class Commander:
    """A sender of commands, each with a socket of its own, so that none waits for another's answer."""

    def __init__(self, context: zmq.asyncio.Context, address: str) -> None:
        self._context, self._address = context, address
        self._pending: set[asyncio.Task[bus.CommandReply]] = set()
        self.last_reply_tick = -1  # last sample before the last command: later blocks show what it has changed

    async def send(self, command: bus.AnyCommand) -> bool:
        """Send a command, and return whether it changed anything.

        Raises:
            RefusedError: the acquisition refuses the command; the text says why.
            ServiceError: the acquisition does not answer in time.
        """
        asked = asyncio.create_task(self._request(command))
        self._pending.add(asked)
        asked.add_done_callback(self._on_request_done)
        if not (await asyncio.wait({asked}, timeout=ANSWER_TIMEOUT_S))[0]:
            if not isinstance(command, bus.StopCommand) or len(self._pending) > MAX_LATE_STOPS:
                asked.cancel()
            raise ServiceError("The acquisition worker does not answer. See the alarms, then try again.")
        answer = asked.result()
        self.last_reply_tick = answer.tick
        if answer.refused:
            raise RefusedError(answer.refused)
        return answer.effect

    def _on_request_done(self, request: asyncio.Task[bus.CommandReply]) -> None:
        self._pending.discard(request)
        if not request.cancelled():
            request.exception()  # marks the error of a late stop as seen: its caller has left

    async def _request(self, command: bus.AnyCommand) -> bus.CommandReply:
        socket = self._context.socket(zmq.REQ)
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(self._address)
        try:
            async with asyncio.timeout(LATE_STOP_TIMEOUT_S):
                await socket.send(bus.pack_command(command, time.monotonic_ns() + int(ANSWER_TIMEOUT_S * 1e9)))
                return bus.unpack_reply(await socket.recv())
        finally:
            socket.close()

    async def aclose(self) -> None:
        """Cancel all commands without an answer."""
        for asked in self._pending:
            asked.cancel()
        await asyncio.gather(*self._pending, return_exceptions=True)
