"""The class Graspwatch: REST interface and live stream of a service, with the messages of `app/messages/`."""

import asyncio
import contextlib
import ssl
from collections.abc import AsyncGenerator
from http import HTTPStatus
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import httpx
from pydantic import BaseModel

from app.messages.alarms import AcknowledgeRequest, Alarm
from app.messages.annotations import (
    GraspRemark,
    GraspTruth,
    Mark,
    MarkRequest,
    TruthCorrection,
    TruthRequest,
    TruthStatement,
)
from app.messages.calibration import Calibration
from app.messages.grasps import Grasp, Identification
from app.messages.journal import JournalEntry
from app.messages.lab_sessions import LabSession, LabSessionRequest, SpecimenCondition
from app.messages.people import ControlInfo, ControlRequest, SessionInfo
from app.messages.recordings import Recordings
from app.messages.runs import Run, RunRequest, RunState, SpotRequest, StopAnswer, StopRequest
from app.messages.system import Health, System
from app.messages.tool import ArmRequest, LibraryInfo, ProtocolInfo, SafetyReport, ToolInfo
from config.network import is_this_computer
from graspwatch.errors import ClientError
from graspwatch.frames import Frame
from graspwatch.live_client import messages
from graspwatch.rest_client import RestClient

if TYPE_CHECKING:
    import pyarrow

ASK_AGAIN_S = 0.1
TABLE_TIMEOUT_S = 600.0  # the service reads all recordings for it


class Graspwatch:
    """Client of one service. Use it as `async with Graspwatch(url) as tool`.

    Every method may raise `UnreachableError` (no answer) and `RefusedError` (the service refused the request).
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
        """Create a client; no connection is opened yet.

        Args:
            url: address of the service. A service on another computer is reached through the proxy that `HTTPS_PROXY`
                and similar variables name.
            token: token that `graspwatch token add` printed.
            trust: certificates that the client trusts; None for this computer's own.
            by: name for the journal, for a service without tokens.
            timeout_s: longest wait for a connection or an answer.
        """
        self._by, self._timeout_s = by, timeout_s
        self._ssl_context = trust or ssl.create_default_context()
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._http = httpx.AsyncClient(
            base_url=url,
            headers=self._headers,
            verify=self._ssl_context,
            timeout=timeout_s,
            trust_env=not is_this_computer(httpx.URL(url).host),  # proxy variables are for other computers
        )
        self._rest_client = RestClient(self._http)

    async def __aenter__(self) -> Self:
        await self._http.__aenter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._http.__aexit__(kind, error, trace)

    # --- state -------------------------------------------------------------------------------------------------------

    async def health(self) -> Health:
        """Return the service's health; does not raise if the service is not ready."""
        return await self._rest_client.ask(Health, "GET", "/api/health", fine=(HTTPStatus.SERVICE_UNAVAILABLE,))

    async def system(self) -> System:
        """Return versions, machine, and the configuration in use."""
        return await self._rest_client.ask(System, "GET", "/api/system")

    async def session(self) -> SessionInfo:
        """Return the caller's name and role."""
        return await self._rest_client.ask(SessionInfo, "GET", "/api/session")

    async def tool(self) -> ToolInfo:
        return await self._rest_client.ask(ToolInfo, "GET", "/api/tool")

    async def tissues(self) -> LibraryInfo:
        """Return the tissue library in use, with injury thresholds in N."""
        return await self._rest_client.ask(LibraryInfo, "GET", "/api/tissues")

    async def protocols(self) -> list[ProtocolInfo]:
        return await self._rest_client.ask(list[ProtocolInfo], "GET", "/api/protocols")

    async def alarms(self) -> list[Alarm]:
        """Return the alarms whose cause persists, and those that wait for an acknowledgment."""
        return await self._rest_client.ask(list[Alarm], "GET", "/api/alarms")

    async def journal(self, most: int = 200) -> list[JournalEntry]:
        """Return up to `most` entries of the journal, newest first."""
        return await self._rest_client.ask(list[JournalEntry], "GET", "/api/journal", params={"most": most})

    async def calibration(self) -> Calibration:
        return await self._rest_client.ask(Calibration, "GET", "/api/calibration")

    async def metrics(self) -> str:
        """Return the metrics in Prometheus format."""
        return (await self._rest_client.request("GET", "/metrics")).text

    # --- grasping ----------------------------------------------------------------------------------------------------

    async def start(
        self, protocol: str, *, cycles: int | None = None, tissue: str | None = None, idempotency_key: str | None = None
    ) -> Run:
        """Start a protocol, and arm the tool first if it is not armed. `tissue` is for the simulated grasper.

        If no answer comes (`UnreachableError`), the run may have started. A program that starts it again with the same
        `idempotency_key`, a text of its choice, gets that run, and no second one starts.
        """
        wanted = RunRequest(protocol=protocol, cycles=cycles, tissue=tissue, by=self._by)
        headers = {"Idempotency-Key": idempotency_key} if idempotency_key else None
        return await self._rest_client.ask(Run, "POST", "/api/runs", wanted, headers=headers)

    async def stop(self) -> StopAnswer:
        """Bring the motor to zero at once, in every state."""
        return await self._rest_client.ask(StopAnswer, "POST", "/api/stop", StopRequest(by=self._by))

    async def begin_spot(self) -> Run:
        """Begin a new spot in the run under way: the next grasp is on another place. Refused without a run."""
        return await self._rest_client.ask(Run, "POST", "/api/spots", SpotRequest(by=self._by))

    async def begin_session(self, subject: str, condition: SpecimenCondition | str, **facts: Any) -> LabSession:
        """Begin a laboratory session, to which runs belong from now on; the one before ends.

        `subject` is a code, never a name. `facts` are further fields of `LabSessionRequest`, such as `species`.
        """
        wanted = LabSessionRequest(subject=subject, condition=SpecimenCondition(condition), by=self._by, **facts)
        return await self._rest_client.ask(LabSession, "POST", "/api/lab-sessions", wanted)

    async def end_session(self) -> LabSession:
        """End the laboratory session under way. Refused if there is none."""
        by = {"by": self._by} if self._by else {}
        return await self._rest_client.ask(LabSession, "DELETE", "/api/lab-sessions/current", params=by)

    async def sessions(self, **question: Any) -> list[LabSession]:
        """Return laboratory sessions, newest first; `question` as in `GET /api/lab-sessions`."""
        return await self._rest_client.ask(list[LabSession], "GET", "/api/lab-sessions", params=question)

    async def state_truth(
        self, held: str | None, *, remark: GraspRemark | None = None, place: str | None = None
    ) -> TruthStatement:
        """State what the jaws hold, for the grasp under way or the next one; `remark` is for that grasp alone.

        A statement replaces the whole earlier one, with its place and remark.
        """
        wanted = TruthRequest(held=held, remark=remark, place=place, by=self._by)
        return await self._rest_client.ask(TruthStatement, "POST", "/api/truth", wanted)

    async def truth(self, run: Run | str) -> list[GraspTruth]:
        """Return the stated ground truth of a run's grasps."""
        run_id = run if isinstance(run, str) else run.id
        return await self._rest_client.ask(list[GraspTruth], "GET", f"/api/runs/{run_id}/truth")

    async def correct_truth(
        self,
        run: Run | str,
        grasp: int,
        held: str | None,
        *,
        remark: GraspRemark | None = None,
        place: str | None = None,
        version: int = 0,
        why: str | None = None,
    ) -> GraspTruth:
        """State or correct the ground truth of a finished grasp; `version` is that of the statement before, 0: none.

        A statement replaces the whole earlier one, with its place and remark.
        """
        run_id = run if isinstance(run, str) else run.id
        wanted = TruthCorrection(held=held, remark=remark, place=place, version=version, why=why, by=self._by)
        return await self._rest_client.ask(GraspTruth, "PUT", f"/api/runs/{run_id}/grasps/{grasp}/truth", wanted)

    async def mark(self, text: str) -> Mark:
        """Set a mark on the running recording, at its newest sample. Refused without a run."""
        return await self._rest_client.ask(Mark, "POST", "/api/marks", MarkRequest(text=text, by=self._by))

    async def marks(self, run: Run | str) -> list[Mark]:
        """Return the marks of a run by their time."""
        run_id = run if isinstance(run, str) else run.id
        return await self._rest_client.ask(list[Mark], "GET", f"/api/runs/{run_id}/marks")

    @contextlib.asynccontextmanager
    async def running(
        self, protocol: str, *, cycles: int | None = None, tissue: str | None = None
    ) -> AsyncGenerator[Run, None]:
        """Start a run, and stop it when the `async with` block is left, also by an exception."""
        run = await self.start(protocol, cycles=cycles, tissue=tissue)
        try:
            yield run
        finally:
            await self._rest_client.ask(StopAnswer, "POST", f"/api/runs/{run.id}/stop", StopRequest(by=self._by))

    async def finished(self, run: Run | str, timeout_s: float | None = None) -> Run:
        """Wait until a run is over, then return it; its `state` says how it ended.

        Raises:
            TimeoutError: the run is not over within `timeout_s`; it continues.
        """
        run_id = run if isinstance(run, str) else run.id
        async with asyncio.timeout(timeout_s):
            while (now := await self.run(run_id)).state is RunState.RUNNING:
                await asyncio.sleep(ASK_AGAIN_S)
        return now

    async def runs(self, **question: Any) -> list[Run]:
        """Return the runs of this service and earlier ones, oldest first; `question` as in `GET /api/runs`."""
        return await self._rest_client.ask(list[Run], "GET", "/api/runs", params=question)

    async def run(self, run_id: str) -> Run:
        return await self._rest_client.ask(Run, "GET", f"/api/runs/{run_id}")

    async def grasps(self, run: Run | str) -> list[Grasp]:
        """Return the finished grasps of a run: label, probability, forces in N, times in s."""
        run_id = run if isinstance(run, str) else run.id
        return await self._rest_client.ask(list[Grasp], "GET", f"/api/runs/{run_id}/grasps")

    async def grasp_table(self) -> "pyarrow.Table":
        """Return the grasps of all recordings, as recorded: a row a grasp, with the truths and sessions of today.

        `.to_pandas()` makes a data frame of it, if pandas is installed.
        """
        from pyarrow import BufferReader, parquet  # slow imports, which few programs need

        answer = await self._rest_client.request("GET", "/api/grasps.parquet", timeout=TABLE_TIMEOUT_S)
        return parquet.read_table(BufferReader(answer.content))

    async def arm(self) -> SafetyReport:
        """Tare the tool and test it at rest. A start does the same unless the settings forbid it."""
        return await self._rest_client.ask(SafetyReport, "POST", "/api/arm", ArmRequest(by=self._by))

    async def disarm(self) -> SafetyReport:
        return await self._rest_client.ask(SafetyReport, "POST", "/api/disarm", ArmRequest(by=self._by))

    async def acknowledge(self, alarm: Alarm) -> Alarm:
        """Acknowledge an alarm; refused if its priority has risen since."""
        seen = AcknowledgeRequest(by=self._by, priority=alarm.priority)
        return await self._rest_client.ask(Alarm, "POST", f"/api/alarms/{alarm.id}/acknowledge", seen)

    async def take_control(self, *, over: bool = False) -> ControlInfo:
        """Take control of the tool; `over` takes it from another operator, who is notified, and it is logged."""
        return await self._rest_client.ask(ControlInfo, "POST", "/api/control", ControlRequest(take_over=over))

    async def give_back_control(self) -> ControlInfo:
        return await self._rest_client.ask(ControlInfo, "DELETE", "/api/control")

    # --- recordings --------------------------------------------------------------------------------------------------

    async def recordings(self, **question: Any) -> Recordings:
        """Return the contents of the recordings folder; `question` as in `GET /api/recordings`."""
        return await self._rest_client.ask(Recordings, "GET", "/api/recordings", params=question)

    async def download(self, recording: str, into: Path) -> Path:
        """Save a recording under its name in the folder `into`, and return the path.

        Raises:
            FileExistsError: the file exists already; it is not overwritten.
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
        """Yield identifications: label, probabilities and forces.

        The first one is the present state. Further ones follow at every change, and ten times a second during a grasp.
        The stream has no end of its own.

        Raises:
            ConnectionLostError: the service ended, or the connection broke.
        """
        async with contextlib.aclosing(self.messages(frames=False)) as messages:
            async for message in messages:
                if isinstance(message, Identification):
                    yield message

    async def messages(
        self, *, frames: bool = True, after: int | None = None
    ) -> AsyncGenerator[BaseModel | Frame, None]:
        """Yield all messages in order, and frames with every sample, beginning with the last seconds.

        The first message is a `Hello`; then `State`, `Identification`, `GraspEnded`, `Alarm` and `EventMessage` follow.
        A slow program misses frames, but never a message.

        `after` is the number of the last event that the program has received, such as
        `ConnectionLostError.last_event`. The stream then goes on with the events after it; `Hello.resumed` is False if
        the service no longer has them all.

        Raises:
            ConnectionLostError: the service ended, or the connection broke.
        """
        connection = self._http.base_url, self._headers, self._ssl_context, self._timeout_s
        stream = messages(*connection, with_frames=frames, after=after)
        async with contextlib.aclosing(stream) as told:
            async for message in told:
                yield message
