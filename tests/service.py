"""The real program as a subprocess, for tests and benchmarks."""

import contextlib
import json
import os
import re
import signal
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx
import numpy as np
from websockets.sync.client import connect

from acquisition.recordings.mcap_reader import McapFile
from app.messages.live import FRAME_HEADER

PROGRAM = Path(sys.executable).with_name("graspwatch")


def until(condition: Callable[[], Any], timeout_s: float = 30.0) -> Any:
    """Return the first true value of `condition`.

    Raises:
        AssertionError: no true value within `timeout_s`.
    """
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        if value := condition():
            return value
        time.sleep(0.02)
    raise AssertionError(f"not true within {timeout_s} s: {condition}")


class Service:
    """`graspwatch serve` (or `replay --serve`) on a free port with its own data folder, until the `with` block ends.

    `trust` is for a service with `--tls-cert`.
    """

    def __init__(
        self,
        *arguments: str,
        data: Path | None = None,
        trust: ssl.SSLContext | None = None,
        within: tuple[str, ...] = (),
    ) -> None:
        """Prepare the service; `within` is a command that runs the program, such as `unshare`."""
        self._arguments, self._within = arguments or ("serve",), within
        self._trust = trust
        self._folder = tempfile.TemporaryDirectory(prefix="graspwatch-data-")
        self.data = data or Path(self._folder.name)

    def __enter__(self) -> Self:
        self.process = subprocess.Popen(
            [*self._within, PROGRAM, *self._arguments, "--port", "0", "--data", self.data],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "COLUMNS": "200"},
        )
        line = self.process.stdout.readline()
        found = re.search(r"(https?)://localhost:(\d+)/", line)
        if not found:
            error = AssertionError(f"no address: {line!r}; {self.process.communicate()[1]}")
            self._folder.cleanup()
            raise error
        self.port = int(found[2])
        self.printed_address = line.split()[1]
        self.url = f"{found[1]}://127.0.0.1:{self.port}"
        self.live_url = f"{found[1].replace('http', 'ws')}://127.0.0.1:{self.port}/api/live"
        self.http = httpx.Client(base_url=self.url, timeout=5.0, verify=self._trust or True)
        try:
            until(self.ready, 90.0)
        except AssertionError:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.http.close()
        try:
            self.end()
        finally:  # a service that hangs must not slow all tests that follow
            self.process.kill()
            self.process.communicate(timeout=15)
            self._folder.cleanup()

    def ready(self) -> bool:
        try:
            return self.http.get("/api/health").status_code == 200
        except httpx.TransportError:
            return False

    def end(self) -> int:
        """Send SIGTERM and return the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(15)

    def worker(self, name: str) -> int:
        """Return a worker's process id; wait until it has started."""

        def found() -> int | None:
            children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
            for pid in children:
                with contextlib.suppress(OSError):  # the process has ended
                    if Path(f"/proc/{pid}/comm").read_text().strip() == name:
                        return int(pid)
            return None

        return until(found)

    def conditions(self) -> dict[str, str]:
        """Return the condition of each worker."""
        return self.http.get("/api/health").json()["workers"]

    def run(self, **body: Any) -> dict[str, Any]:
        response = self.http.post("/api/runs", json=body)
        assert response.status_code == 201, response.text
        return response.json()

    def acknowledge_fault(self) -> str:
        """Acknowledge the latched fault and return its text."""
        [alarm] = [alarm for alarm in self.http.get("/api/alarms").json() if alarm["id"].startswith("fault-")]
        seen = {"by": "a test", "priority": alarm["priority"]}
        response = self.http.post(f"/api/alarms/{alarm['id']}/acknowledge", json=seen)
        assert response.status_code == 200, response.text
        return alarm["text"]

    def finished(self, run_id: str, timeout_s: float = 30.0) -> dict[str, Any]:
        def over() -> dict[str, Any] | None:
            run = self.http.get(f"/api/runs/{run_id}").json()
            return run if run["state"] != "running" else None

        return until(over, timeout_s)

    def recording_file(self, run_id: str) -> Path:
        return self.data / "recordings" / f"{run_id}.mcap"

    def recorded(self, run_id: str) -> Path:
        """The run's file once it is whole."""
        path = self.recording_file(run_id)
        until(lambda: path.exists() and McapFile(path).complete)
        return path


class Listener:
    """A client of `/api/live` or a replay that collects messages, and frames as header and columns."""

    def __init__(self, service: Service, path: str = "/api/live") -> None:
        self._connection = connect(f"ws://127.0.0.1:{service.port}{path}", max_size=None, close_timeout=0.5)
        self.messages: list[dict[str, Any]] = []
        self.frames: list[tuple[tuple[Any, ...], np.ndarray]] = []

    def __enter__(self) -> Self:
        self._socket = self._connection.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.__exit__(None, None, None)

    def listen(self, done: Callable[[], Any], timeout_s: float = 20.0, answer: bool = True) -> float:
        """Read until `done()` is true; return the elapsed time, s."""
        begin = time.monotonic()
        while not done():
            if time.monotonic() - begin > timeout_s:
                raise AssertionError(f"{[m['type'] for m in self.messages]}")
            received = self._socket.recv(timeout=timeout_s)
            if isinstance(received, str):
                self.messages.append(json.loads(received))
            else:
                header = FRAME_HEADER.unpack_from(received)
                columns = np.frombuffer(received, "<f4", offset=FRAME_HEADER.size).reshape(header[3], header[4])
                self.frames.append((header, columns))
                if answer:
                    self.send(type="received", sequence=header[5])
        return time.monotonic() - begin

    def send(self, **message: Any) -> None:
        self._socket.send(json.dumps(message))

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [message for message in self.messages if message["type"] == kind]
