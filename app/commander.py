"""Commands to the acquisition worker, and its answers."""

import asyncio

import zmq
import zmq.asyncio

from acquisition import bus
from config.errors import RefusedError, ServiceError

ANSWER_S = 0.5


class Commander:
    """Passes commands on, one at a time."""

    def __init__(self, context: zmq.asyncio.Context, address: str) -> None:
        self._context, self._address = context, address

    async def send(self, command: bus.Command) -> bool:
        """Returns whether the command changed anything.

        Raises:
            RefusedError: it is refused; the text says why.
            ServiceError: nobody answers.
        """
        answer = await self._ask(command)
        if answer.refused:
            raise RefusedError(answer.refused)
        return answer.effect

    async def _ask(self, command: bus.Command) -> bus.Answer:
        socket = self._context.socket(zmq.REQ)
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(self._address)
        try:
            await socket.send(bus.pack_command(command))
            return bus.unpack_answer(await asyncio.wait_for(socket.recv(), ANSWER_S))
        except TimeoutError:
            text = "The acquisition worker does not answer. See the alarms, then try again."
            raise ServiceError(text) from None
        finally:
            socket.close()
