"""The function that receives the live stream for the Python client: messages and frames of `/api/live`, in order."""

import contextlib
import ssl
from collections.abc import AsyncGenerator, AsyncIterator, Mapping

import httpx
from pydantic import BaseModel, TypeAdapter, ValidationError
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from app.messages.base import SCHEMA_VERSION
from app.messages.live import FrameReceived, Hello, ServerMessage, State, StreamEvent
from config.network import is_this_computer
from graspwatch.errors import ConnectionLostError
from graspwatch.frames import Frame
from graspwatch.rest_client import build_refused_error, build_unreachable_error

MESSAGE: TypeAdapter[ServerMessage] = TypeAdapter(ServerMessage)


async def messages(
    url: httpx.URL,
    headers: Mapping[str, str],
    trust: ssl.SSLContext,
    timeout_s: float,
    *,
    with_frames: bool,
    after: int | None = None,
) -> AsyncGenerator[BaseModel | Frame, None]:
    """Connect to the live stream at `url`, and yield its messages and frames; with `after`, go on after that event.

    Raises:
        ConnectionLostError: the service ended, or the connection broke.
        UnreachableError: no service answers at `url`.
        RefusedError: the service refused the connection.
    """
    hello: Hello | None = None
    last_event = after
    async with _connect(url, headers, trust, timeout_s, after) as socket:
        try:
            async for received in socket:
                if isinstance(received, str):
                    message = _parse_message(received, url)
                    if isinstance(message, Hello):
                        hello = message
                        last_event = after if message.resumed else None
                    last_event = _event_number(message) or last_event
                    yield message
                elif with_frames and hello:  # the service stops sending frames that are not acknowledged
                    frame = Frame.unpack(received, hello.channels)
                    await socket.send(FrameReceived(sequence=frame.sequence).model_dump_json())
                    yield frame
        except ConnectionClosed as error:
            raise ConnectionLostError(f"The stream of {url} broke: {error}.", last_event) from error
    raise ConnectionLostError(f"The service at {url} ended the stream.", last_event)


def _event_number(message: BaseModel) -> int | None:
    """Return the number of the newest event that has been received with this message, if it says so."""
    if isinstance(message, State):
        return message.event_number
    return message.number if isinstance(message, StreamEvent) else None


@contextlib.asynccontextmanager
async def _connect(
    url: httpx.URL, headers: Mapping[str, str], trust: ssl.SSLContext, timeout_s: float, after: int | None
) -> AsyncIterator[ClientConnection]:
    secure = url.scheme == "https"
    address = url.copy_with(scheme="wss" if secure else "ws", path="/api/live")
    if after is not None:
        address = address.copy_set_param("after", after)
    try:
        socket = await connect(
            str(address),
            additional_headers=headers,
            ssl=trust if secure else None,
            max_size=None,
            open_timeout=timeout_s,
            proxy=None if is_this_computer(url.host) else True,
        )
    except InvalidStatus as error:
        raise build_refused_error(error.response.status_code, error.response.body or b"") from error
    except (OSError, InvalidHandshake, TimeoutError) as error:
        raise build_unreachable_error(url, error) from error
    try:
        yield socket
    finally:
        await socket.close()


def _parse_message(text: str, url: httpx.URL) -> BaseModel:
    try:
        message = MESSAGE.validate_json(text)
    except ValidationError as error:
        raise ConnectionLostError(
            f"The service at {url} speaks another version than this client: install the same. ({error})"
        ) from error
    if isinstance(message, Hello) and message.schema_version != SCHEMA_VERSION:
        raise ConnectionLostError(
            f"The service at {url} is Graspwatch {message.version} with version {message.schema_version} of the live "
            f"stream, and this client reads version {SCHEMA_VERSION}. Install the client of the service's version."
        )
    return message
