"""Classes and functions that limit the number of connections and the time of their handshakes."""

import asyncio
import resource
import time
from asyncio import BaseTransport
from collections import Counter
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from config.errors import ServiceError

TLS_HANDSHAKE_TIMEOUT_S = 3.0
CLOSE_LINGER_S = 1.0
RESERVED_FILES, MIN_CONNECTIONS = 160, 10
"""Open files that are no connections: 50 of a service at rest, and those of reports, downloads and starting workers."""
BAD_HANDSHAKE_RESPONSE = b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


class TlsTimeoutEventLoop(asyncio.SelectorEventLoop):
    """An event loop that ends slow TLS handshakes: those connections are in no list that can be limited."""

    async def create_server(self, *arguments: Any, ssl: Any = None, **options: Any) -> asyncio.Server:
        timeout_s = TLS_HANDSHAKE_TIMEOUT_S if ssl else None
        return await super().create_server(*arguments, ssl=ssl, ssl_handshake_timeout=timeout_s, **options)


def reserve_open_files(max_connections: int) -> int:
    """Raise the limit of open files to the system's maximum, and return how many connections it leaves room for.

    At most `max_connections`, so that handshakes leave room for other connections.

    Raises:
        ServiceError: the limit is too low for a service.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most == resource.RLIM_INFINITY:
        return max_connections
    if most < RESERVED_FILES + MIN_CONNECTIONS:
        raise ServiceError(
            f"The system allows {most} open files, and a service needs {RESERVED_FILES + MIN_CONNECTIONS}. Raise the "
            "limit (`ulimit -Hn`, LimitNOFILE= of systemd), then start again."
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    return min(max_connections, most - RESERVED_FILES)


class LingeringWebSocketProtocol(WebSocketsSansIOProtocol):
    """A WebSocket protocol that lets the reason of a close reach the peer.

    A connection that is closed with unread input is reset, and the peer sees only the reset. Therefore the protocol
    discards further input for a moment before it closes.
    """

    def data_received(self, data: bytes) -> None:
        if self.conn.parser_exc is not None:
            return
        super().data_received(data)
        if not self.handshake_initiated and self.conn.handshake_exc is not None:  # would otherwise never be answered
            self.transport.write(BAD_HANDSHAKE_RESPONSE)
            self.transport.close()

    def handle_parser_exception(self) -> None:
        why = self.conn.close_sent
        assert why is not None
        self.queue.put_nowait({"type": "websocket.disconnect", "code": why.code, "reason": why.reason})
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.close_timer = self.loop.call_later(CLOSE_LINGER_S, self.transport.close)


def make_connection_limiter(max_connections: int) -> type:
    """Return an HTTP protocol class that keeps at most `max_connections` open.

    Beyond that, the client with the most connections loses one: an idle one first, then the oldest. So a client that
    opens thousands only hurts itself, and a STOP gets through. WebSockets stay; viewers have a limit of their own.
    """

    class ConnectionLimiter(AutoHTTPProtocol):
        connections: set[Any]  # as all but `opened_s` set by uvicorn's protocols, whose common type declares nothing
        client: tuple[str, int] | None
        transport: asyncio.Transport
        opened_s: float

        def connection_made(self, transport: BaseTransport) -> None:
            self.opened_s = time.monotonic()
            if len(self.connections) >= max_connections:
                _close_excess_connection(self.connections)
            super().connection_made(transport)

    def _close_excess_connection(connections: set[Any]) -> None:
        mine = [(each.client[0], each) for each in connections if isinstance(each, ConnectionLimiter) and each.client]
        if mine:
            [(busiest, _)] = Counter(host for host, _ in mine).most_common(1)
            its = [each for host, each in mine if host == busiest]
            victim = min(its, key=lambda each: (_is_busy(each), each.opened_s))
            connections.discard(victim)
            victim.transport.abort()

    return ConnectionLimiter


def _is_busy(connection: Any) -> bool:
    """Return whether the connection is answering a request."""
    return connection.cycle is not None and not connection.cycle.response_complete
