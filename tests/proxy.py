"""Intermediaries between a client and the service: a line that can be cut and restored, and an HTTP proxy."""

import socket
import threading
from types import TracebackType
from typing import Self


class Line:
    """A TCP forwarder from a free port of this machine to `port`."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._ends: list[socket.socket] = []
        self._whole = True
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.cut()
        self._listener.close()

    def cut(self) -> None:
        """End every connection, and refuse new ones until `mend`."""
        self._whole = False
        for end in self._ends:
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:  # already closed
                end.close()
        self._ends.clear()

    def mend(self) -> None:
        self._whole = True

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:  # closed: the test is over
                return
            if not self._whole:
                near.close()
                continue
            far = socket.create_connection(("127.0.0.1", self._target))
            self._ends += [near, far]
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=_forward, args=(source, sink), daemon=True).start()


class HttpProxy:
    """An HTTP proxy that leads every address to `port` of this machine; it keeps the first line of every request."""

    def __init__(self, port: int) -> None:
        self._target = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.asked: list[str] = []

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:  # closed: the test is over
                return
            threading.Thread(target=self._lead, args=(near,), daemon=True).start()

    def _lead(self, near: socket.socket) -> None:
        head = b""
        while b"\r\n\r\n" not in head and (data := near.recv(65_536)):
            head += data
        self.asked.append(head.partition(b"\r\n")[0].decode("latin-1"))
        try:
            far = socket.create_connection(("127.0.0.1", self._target))
        except OSError:  # the service has ended
            near.close()
            return
        if head.startswith(b"CONNECT "):
            near.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
        else:
            method, address, rest = head.split(b" ", 2)
            path = b"/" + address.split(b"/", 3)[3]
            far.sendall(b" ".join((method, path, rest.replace(b"\r\n", b"\r\nConnection: close\r\n", 1))))
        threading.Thread(target=_forward, args=(near, far), daemon=True).start()
        _forward(far, near)


def _forward(source: socket.socket, sink: socket.socket) -> None:
    try:
        while data := source.recv(65_536):
            sink.sendall(data)
    except OSError:  # cut
        pass
    finally:
        sink.close()
