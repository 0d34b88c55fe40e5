"""A service's REST interface and live stream as Python, with the messages of `app/messages/wire.py`."""

import asyncio
import contextlib
import ssl
from collections.abc import AsyncGenerator
from http import HTTPStatus
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx
from pydantic import BaseModel

from app.messages.wire import (
    AcknowledgeRequest,
    Alarm,
    ArmRequest,
    Calibration,
    ControlInfo,
    ControlRequest,
    Grasp,
    Health,
    Identification,
    JournalEntry,
    LibraryInfo,
    ProtocolInfo,
    Recordings,
    Run,
    RunRequest,
    RunState,
    SafetyReport,
    SessionInfo,
    StopAnswer,
    StopRequest,
    System,
    ToolInfo,
)
from config.network import is_this_computer
from graspwatch.asking import Asking
from graspwatch.errors import ClientError
from graspwatch.frames import Frame
from graspwatch.stream import messages

ASK_AGAIN_S = 0.1


class Graspwatch:
    """One service. Use it as `async with Graspwatch(url) as tool`.

    Every method may raise `UnreachableError` (nobody answers) and `RefusedError` (the service says why not).
    """

    def __init__(
        self,
        url: str = "http://localhost:8000",
        *,
        token: str | None = None,
        trust: ssl.SSLContext | None = None,
        by: str | None = None,
        timeout_s: float = 10.0,
    ) -> None:
        """`token` is what `graspwatch token add` printed; `trust` knows the certificate of a service at https (None:
        as this computer does); `by` is a name for the journal where the service knows nobody by a token. A service on
        this computer is asked directly, others through the proxy that `HTTPS_PROXY` and the like name."""
        self._by, self._timeout_s = by, timeout_s
        self._ssl_context = trust or ssl.create_default_context()
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._http = httpx.AsyncClient(
            base_url=url,
            headers=self._headers,
            verify=self._ssl_context,
            timeout=timeout_s,
            trust_env=not is_this_computer(httpx.URL(url).host),  # its proxy variables are for other computers
        )
        self._rest_client = Asking(self._http)

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
        return await self._rest_client.ask(Health, "GET", "/api/health", fine=(HTTPStatus.SERVICE_UNAVAILABLE,))

    async def system(self) -> System:
        """Versions, machine, and the configuration in use."""
        return await self._rest_client.ask(System, "GET", "/api/system")

    async def session(self) -> SessionInfo:
        """Who one is to the service, and what one may do."""
        return await self._rest_client.ask(SessionInfo, "GET", "/api/session")

    async def tool(self) -> ToolInfo:
        return await self._rest_client.ask(ToolInfo, "GET", "/api/tool")

    async def tissues(self) -> LibraryInfo:
        """The tissue library in use, with injury thresholds in N."""
        return await self._rest_client.ask(LibraryInfo, "GET", "/api/tissues")

    async def protocols(self) -> list[ProtocolInfo]:
        return await self._rest_client.ask(list[ProtocolInfo], "GET", "/api/protocols")

    async def alarms(self) -> list[Alarm]:
        """Those whose cause is there, and those that wait for somebody to acknowledge them."""
        return await self._rest_client.ask(list[Alarm], "GET", "/api/alarms")

    async def journal(self, most: int = 200) -> list[JournalEntry]:
        """What happened, newest first."""
        return await self._rest_client.ask(list[JournalEntry], "GET", "/api/journal", params={"most": most})

    async def calibration(self) -> Calibration:
        return await self._rest_client.ask(Calibration, "GET", "/api/calibration")

    async def metrics(self) -> str:
        """As Prometheus reads them."""
        return (await self._rest_client.request("GET", "/metrics")).text

    # --- grasping ----------------------------------------------------------------------------------------------------

    async def start(self, protocol: str, *, cycles: int | None = None, tissue: str | None = None) -> Run:
        """Start a protocol; a tool that is not armed is armed first. `tissue` is for the simulated grasper."""
        wanted = RunRequest(protocol=protocol, cycles=cycles, tissue=tissue, by=self._by)
        return await self._rest_client.ask(Run, "POST", "/api/runs", wanted)

    async def stop(self) -> StopAnswer:
        """Motor to zero at once, whatever runs."""
        return await self._rest_client.ask(StopAnswer, "POST", "/api/stop", StopRequest(by=self._by))

    @contextlib.asynccontextmanager
    async def running(
        self, protocol: str, *, cycles: int | None = None, tissue: str | None = None
    ) -> AsyncGenerator[Run, None]:
        """A run that does not outlive the block: when that is left, however it is, a run under way is stopped."""
        run = await self.start(protocol, cycles=cycles, tissue=tissue)
        try:
            yield run
        finally:
            await self._rest_client.ask(StopAnswer, "POST", f"/api/runs/{run.id}/stop", StopRequest(by=self._by))

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
        return await self._rest_client.ask(list[Run], "GET", "/api/runs", params=question)

    async def run(self, run_id: str) -> Run:
        return await self._rest_client.ask(Run, "GET", f"/api/runs/{run_id}")

    async def grasps(self, run: Run | str) -> list[Grasp]:
        """The finished grasps of a run: label, probability, forces in N, times in s."""
        run_id = run if isinstance(run, str) else run.id
        return await self._rest_client.ask(list[Grasp], "GET", f"/api/runs/{run_id}/grasps")

    async def arm(self) -> SafetyReport:
        """Tare the tool and test it at rest; a start does so by itself unless the settings forbid it."""
        return await self._rest_client.ask(SafetyReport, "POST", "/api/arm", ArmRequest(by=self._by))

    async def disarm(self) -> SafetyReport:
        return await self._rest_client.ask(SafetyReport, "POST", "/api/disarm", ArmRequest(by=self._by))

    async def acknowledge(self, alarm: Alarm) -> Alarm:
        """Somebody has seen it; refused if it became worse since."""
        seen = AcknowledgeRequest(by=self._by, priority=alarm.priority)
        return await self._rest_client.ask(Alarm, "POST", f"/api/alarms/{alarm.id}/acknowledge", seen)

    async def take_control(self, *, over: bool = False) -> ControlInfo:
        """Be the only one who may start; `over` takes it from somebody else, which is told and logged."""
        return await self._rest_client.ask(ControlInfo, "POST", "/api/control", ControlRequest(take_over=over))

    async def give_back_control(self) -> ControlInfo:
        return await self._rest_client.ask(ControlInfo, "DELETE", "/api/control")

    # --- recordings --------------------------------------------------------------------------------------------------

    async def recordings(self, **question: Any) -> Recordings:
        """What is in the recordings folder; `question` as in `GET /api/recordings`."""
        return await self._rest_client.ask(Recordings, "GET", "/api/recordings", params=question)

    async def download(self, recording: str, into: Path) -> Path:
        """Save a recording as a file of its name in the folder `into`; one that is there is not overwritten.

        Raises:
            FileExistsError: there is one.
        """
        path = into / recording
        with path.open("xb") as file:
            try:
                async for part in self._rest_client.parts(f"/api/recordings/{recording}/file"):
                    file.write(part)
            except ClientError:
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
        stream = messages(self._http.base_url, self._headers, self._ssl_context, self._timeout_s, with_frames=frames)
        async with contextlib.aclosing(stream) as told:
            async for message in told:
                yield message
