"""A service's REST interface and live stream as Python: httpx and websockets, with the messages of `app/wire.py`."""

import asyncio
import contextlib
import ssl
from collections.abc import AsyncGenerator, AsyncIterator
from http import HTTPStatus
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import httpx
from pydantic import BaseModel, TypeAdapter, ValidationError
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from app.wire import (
    SCHEMA_VERSION,
    AcknowledgeRequest,
    Alarm,
    ArmRequest,
    Calibration,
    ControlInfo,
    ControlRequest,
    FrameReceived,
    Grasp,
    Health,
    Hello,
    Identification,
    JournalEntry,
    LibraryInfo,
    Problem,
    ProtocolInfo,
    Recordings,
    Run,
    RunRequest,
    RunState,
    SafetyReport,
    ServerMessage,
    SessionInfo,
    StopAnswer,
    StopRequest,
    System,
    ToolInfo,
)
from graspwatch.errors import ConnectionLostError, RefusedError, UnreachableError
from graspwatch.frames import Frame

Answer = TypeVar("Answer")
ASK_AGAIN_S = 0.1
MESSAGE: TypeAdapter[ServerMessage] = TypeAdapter(ServerMessage)


class Graspwatch:
    """One service. Use it as `async with Graspwatch(url) as tool`.

    Every method may raise `UnreachableError` (nobody answers) and `RefusedError` (the service says why not).
    """

    def __init__(
        self, url: str = "http://localhost:8000", *, token: str | None = None, trust: ssl.SSLContext | None = None,
        by: str | None = None, timeout_s: float = 10.0,
    ) -> None:  # fmt: skip
        """`token` is what `graspwatch token add` printed; `trust` knows the certificate of a service at https (None:
        as this computer does); `by` is a name for the journal where the service knows nobody by a token."""
        self._url = httpx.URL(url)
        self._by, self._timeout_s = by, timeout_s
        self._trust = trust or ssl.create_default_context()
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._http = httpx.AsyncClient(base_url=url, headers=self._headers, verify=self._trust, timeout=timeout_s)

    async def __aenter__(self) -> Self:
        await self._http.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._http.__aexit__(kind, error, trace)

    # --- what there is -----------------------------------------------------------------------------------------------

    async def health(self) -> Health:
        """Whether it is ready; also while it is not."""
        return await self._ask(Health, "GET", "/api/health", fine=(HTTPStatus.SERVICE_UNAVAILABLE,))

    async def system(self) -> System:
        """Versions, machine, and the configuration in use."""
        return await self._ask(System, "GET", "/api/system")

    async def session(self) -> SessionInfo:
        """Who one is to the service, and what one may do."""
        return await self._ask(SessionInfo, "GET", "/api/session")

    async def tool(self) -> ToolInfo:
        return await self._ask(ToolInfo, "GET", "/api/tool")

    async def tissues(self) -> LibraryInfo:
        """The tissue library in use, with injury thresholds in N."""
        return await self._ask(LibraryInfo, "GET", "/api/tissues")

    async def protocols(self) -> list[ProtocolInfo]:
        return await self._ask(list[ProtocolInfo], "GET", "/api/protocols")

    async def alarms(self) -> list[Alarm]:
        """Those whose cause is there, and those that wait for somebody to acknowledge them."""
        return await self._ask(list[Alarm], "GET", "/api/alarms")

    async def journal(self, most: int = 200) -> list[JournalEntry]:
        """What happened, newest first."""
        return await self._ask(list[JournalEntry], "GET", "/api/journal", params={"most": most})

    async def calibration(self) -> Calibration:
        return await self._ask(Calibration, "GET", "/api/calibration")

    async def metrics(self) -> str:
        """As Prometheus reads them."""
        return (await self._request("GET", "/metrics")).text

    # --- grasping ----------------------------------------------------------------------------------------------------

    async def start(self, protocol: str, *, cycles: int | None = None, tissue: str | None = None) -> Run:
        """Start a protocol; a tool that is not armed is armed first. `tissue` is for the simulated grasper."""
        wanted = RunRequest(protocol=protocol, cycles=cycles, tissue=tissue, by=self._by)
        return await self._ask(Run, "POST", "/api/runs", wanted)

    async def stop(self) -> StopAnswer:
        """Motor to zero at once, whatever runs."""
        return await self._ask(StopAnswer, "POST", "/api/stop", StopRequest(by=self._by))

    @contextlib.asynccontextmanager
    async def running(
        self, protocol: str, *, cycles: int | None = None, tissue: str | None = None
    ) -> AsyncGenerator[Run, None]:
        """A run that does not outlive the block: when that is left, however it is, a run under way is stopped."""
        run = await self.start(protocol, cycles=cycles, tissue=tissue)
        try:
            yield run
        finally:
            await self._ask(StopAnswer, "POST", f"/api/runs/{run.id}/stop", StopRequest(by=self._by))

    async def finished(self, run: Run | str, timeout_s: float | None = None) -> Run:
        """Wait until a run is over; how it ended stands in its `state`.

        Raises:
            TimeoutError: it is not over within `timeout_s`; it goes on.
        """
        run_id = run if isinstance(run, str) else run.id
        async with asyncio.timeout(timeout_s):
            while (now := await self.run(run_id)).state is RunState.RUNNING:
                await asyncio.sleep(ASK_AGAIN_S)
        return now

    async def runs(self, **question: Any) -> list[Run]:
        """Of this service and earlier ones, oldest first; `question` as in `GET /api/runs`."""
        return await self._ask(list[Run], "GET", "/api/runs", params=question)

    async def run(self, run_id: str) -> Run:
        return await self._ask(Run, "GET", f"/api/runs/{run_id}")

    async def grasps(self, run: Run | str) -> list[Grasp]:
        """The finished grasps of a run: label, probability, forces in N, times in s."""
        run_id = run if isinstance(run, str) else run.id
        return await self._ask(list[Grasp], "GET", f"/api/runs/{run_id}/grasps")

    async def arm(self) -> SafetyReport:
        """Tare the tool and test it at rest; a start does so by itself unless the settings forbid it."""
        return await self._ask(SafetyReport, "POST", "/api/arm", ArmRequest(by=self._by))

    async def disarm(self) -> SafetyReport:
        return await self._ask(SafetyReport, "POST", "/api/disarm", ArmRequest(by=self._by))

    async def acknowledge(self, alarm: Alarm) -> Alarm:
        """Somebody has seen it; refused if it became worse since."""
        seen = AcknowledgeRequest(by=self._by, priority=alarm.priority)
        return await self._ask(Alarm, "POST", f"/api/alarms/{alarm.id}/acknowledge", seen)

    async def take_control(self, *, over: bool = False) -> ControlInfo:
        """Be the only one who may start; `over` takes it from somebody else, which is told and logged."""
        return await self._ask(ControlInfo, "POST", "/api/control", ControlRequest(take_over=over))

    async def give_back_control(self) -> ControlInfo:
        return await self._ask(ControlInfo, "DELETE", "/api/control")

    # --- recordings --------------------------------------------------------------------------------------------------

    async def recordings(self, **question: Any) -> Recordings:
        """What is in the recordings folder; `question` as in `GET /api/recordings`."""
        return await self._ask(Recordings, "GET", "/api/recordings", params=question)

    async def download(self, recording: str, into: Path) -> Path:
        """Save a recording as a file of its name in the folder `into`; one that is there is not overwritten.

        Raises:
            FileExistsError: there is one.
        """
        path = into / recording
        with path.open("xb") as file:
            try:
                async with self._http.stream("GET", f"/api/recordings/{recording}/file") as answer:
                    if answer.is_error:
                        await answer.aread()
                    self._check(answer)
                    async for part in answer.aiter_bytes():
                        file.write(part)
            except httpx.TransportError as error:
                path.unlink()
                raise self._unreachable(error) from error
            except RefusedError:
                path.unlink()
                raise
        return path

    # --- live --------------------------------------------------------------------------------------------------------

    async def live(self) -> AsyncGenerator[Identification, None]:
        """What is held, how sure that is, and how near the force is to its limit: at every change, and ten times a
        second during a grasp. Begins with what is known already, and never ends by itself.

        Raises:
            ConnectionLostError: the service was ended, or the connection broke.
        """
        async with contextlib.aclosing(self.messages(frames=False)) as messages:
            async for message in messages:
                if isinstance(message, Identification):
                    yield message

    async def messages(self, *, frames: bool = True) -> AsyncGenerator[BaseModel | Frame, None]:
        """Everything that is told, in order: first a `Hello`, then `State`, `Identification`, `GraspEnded`, `Alarm`,
        `EventMessage`; and `Frame`s with every sample, first those of the last seconds. A program that is slow misses
        frames, and never a message.

        Raises:
            ConnectionLostError: the service was ended, or the connection broke.
        """
        hello: Hello | None = None
        async with self._connected() as socket:
            try:
                async for received in socket:
                    if isinstance(received, str):
                        message = self._message(received)
                        hello = message if isinstance(message, Hello) else hello
                        yield message
                    elif frames and hello:  # frames that nobody answers stop coming
                        frame = Frame.unpack(received, hello.channels)
                        await socket.send(FrameReceived(sequence=frame.sequence).model_dump_json())
                        yield frame
            except ConnectionClosed as error:
                raise ConnectionLostError(f"The stream of {self._url} broke: {error}.") from error
        raise ConnectionLostError(f"The service at {self._url} ended the stream.")

    @contextlib.asynccontextmanager
    async def _connected(self) -> AsyncIterator[ClientConnection]:
        secure = self._url.scheme == "https"
        url = self._url.copy_with(scheme="wss" if secure else "ws", path="/api/live")
        trust = self._trust if secure else None
        try:
            socket = await connect(
                str(url), additional_headers=self._headers, ssl=trust, max_size=None, open_timeout=self._timeout_s
            )
        except InvalidStatus as error:
            answer = error.response
            raise self._refused(answer.status_code, answer.body or b"") from error
        except (OSError, InvalidHandshake, TimeoutError) as error:
            raise self._unreachable(error) from error
        try:
            yield socket
        finally:
            await socket.close()

    def _message(self, text: str) -> BaseModel:
        try:
            message = MESSAGE.validate_json(text)
        except ValidationError as error:
            raise ConnectionLostError(
                f"The service at {self._url} speaks another version than this client: install the same. ({error})"
            ) from error
        if isinstance(message, Hello) and message.schema_version != SCHEMA_VERSION:
            raise ConnectionLostError(
                f"The service at {self._url} is Graspwatch {message.version}, whose messages are others: install it."
            )
        return message

    # --- asking ------------------------------------------------------------------------------------------------------

    async def _ask(
        self, answer: type[Answer], method: str, path: str, body: BaseModel | None = None, *,
        params: dict[str, Any] | None = None, fine: tuple[int, ...] = (),
    ) -> Answer:  # fmt: skip
        content = body.model_dump(mode="json", exclude_none=True) if body else None
        response = await self._request(method, path, fine=fine, json=content, params=params)
        return TypeAdapter(answer).validate_json(response.content)

    async def _request(self, method: str, path: str, *, fine: tuple[int, ...] = (), **request: Any) -> httpx.Response:
        try:
            response = await self._http.request(method, path, **request)
        except httpx.TransportError as error:
            raise self._unreachable(error) from error
        if response.status_code not in fine:
            self._check(response)
        return response

    def _check(self, response: httpx.Response) -> None:
        if response.is_error:
            raise self._refused(response.status_code, response.content)

    def _refused(self, status: int, content: bytes) -> RefusedError:
        try:
            problem = Problem.model_validate_json(content)
        except ValidationError:
            return RefusedError(status, HTTPStatus(status).phrase, {})
        return RefusedError(status, problem.detail, {each["field"]: each["message"] for each in problem.errors or []})

    def _unreachable(self, error: Exception) -> UnreachableError:
        why = str(error) or type(error).__name__
        return UnreachableError(f"Nobody answers at {self._url} ({why}): is it running there?")
