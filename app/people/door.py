"""Where the service listens: whether it may without tokens, TLS, and how many connections it keeps."""

import asyncio
import resource
import ssl
import time
from asyncio import BaseTransport
from collections import Counter
from pathlib import Path
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from app.people.tokens import TOKEN_FILE, read_tokens
from config.errors import ConfigurationError
from config.network import is_loopback

TLS_HANDSHAKE_TIMEOUT_S = 3.0
CLOSE_LINGER_S = 1.0
BAD_HANDSHAKE_RESPONSE = b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
UNENCRYPTED_WARNING = (
    "Warning: tokens and all else travel unencrypted to other machines. Set --tls-cert and --tls-key, or put a proxy "
    "with TLS before a service that listens on 127.0.0.1."
)


def check_listen_address(host: str, data: Path, tls: bool) -> str | None:
    """Whether a service may listen on `host`; returns what has to be said about it.

    Raises:
        ConfigurationError: not without tokens.
    """
    people = read_tokens(data)
    if is_loopback(host):
        return None
    if not any(entry.is_valid for entry in people):
        raise ConfigurationError(
            f"On {host} others can reach the tool, and nobody has a good token in {data / TOKEN_FILE}. Make one with "
            f"`graspwatch token add NAME --role admin --data {data}`, or listen on 127.0.0.1."
        )
    return None if tls else UNENCRYPTED_WARNING


def check_certificate(cert: str | None, key: str | None) -> None:
    """Raises ConfigurationError: the two are not what TLS needs."""
    if cert is None and key is None:
        return
    if cert is None or key is None:
        raise ConfigurationError("--tls-cert and --tls-key go together: set both or neither.")
    for path in (cert, key):
        if not Path(path).is_file():
            raise ConfigurationError(f"{path}: there is no such file. Check --tls-cert and --tls-key.")
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(cert, key, password=_no_password)
    except (ssl.SSLError, OSError) as error:
        raise ConfigurationError(
            f"{cert} and {key}: are no certificate with its key ({error.strerror or error}). Both are PEM files, the "
            "key without a password."
        ) from None


def _no_password() -> str:
    """Else OpenSSL asks at the terminal."""
    return ""


class TlsTimeoutEventLoop(asyncio.SelectorEventLoop):
    """Whoever connects and does not end the handshake of TLS is not waited for: he is in no list of connections yet."""

    async def create_server(self, *arguments: Any, ssl: Any = None, **options: Any) -> asyncio.Server:
        timeout_s = TLS_HANDSHAKE_TIMEOUT_S if ssl else None
        return await super().create_server(*arguments, ssl=ssl, ssl_handshake_timeout=timeout_s, **options)


def raise_open_file_limit() -> None:
    """As many as the system lets this process open: those in handshakes are to leave room for others."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


class LingeringWebSocketProtocol(WebSocketsSansIOProtocol):
    """Lets the reason of a close arrive: with input unread, a connection that is closed is reset, and the peer sees
    only that. What still comes is thrown away for a moment."""

    def data_received(self, data: bytes) -> None:
        if self.conn.parser_exc is not None:
            return
        super().data_received(data)
        if not self.handshake_initiated and self.conn.handshake_exc is not None:  # else it would never be answered
            self.transport.write(BAD_HANDSHAKE_RESPONSE)
            self.transport.close()

    def handle_parser_exception(self) -> None:
        why = self.conn.close_sent
        self.queue.put_nowait({"type": "websocket.disconnect", "code": why.code, "reason": why.reason})
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.close_timer = self.loop.call_later(CLOSE_LINGER_S, self.transport.close)


def make_connection_limiter(max_connections: int) -> type:
    """A protocol of connections of which no more than `most` are open.

    Beyond that, whoever has most of them loses one: first one without a request, then the oldest. So somebody who opens
    thousands hurts himself, and a STOP gets through. WebSockets stay; the viewers have a bound of their own.
    """

    class ConnectionLimiter(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
        def connection_made(self, transport: BaseTransport) -> None:
            self.opened_s = time.monotonic()
            if len(self.connections) >= max_connections:
                _close_excess_connection(self.connections)
            super().connection_made(transport)

    def _close_excess_connection(connections: set[Any]) -> None:
        mine = [each for each in connections if isinstance(each, ConnectionLimiter) and each.client]
        if mine:
            [(busiest, _)] = Counter(each.client[0] for each in mine).most_common(1)
            its = [each for each in mine if each.client[0] == busiest]
            victim = min(its, key=lambda each: (_is_busy(each), each.opened_s))
            connections.discard(victim)
            victim.transport.abort()

    return ConnectionLimiter


def _is_busy(connection: Any) -> bool:
    """Whether a request is being answered."""
    return connection.cycle is not None and not connection.cycle.response_complete
