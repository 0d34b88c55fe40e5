"""One viewer's replay of a recording: plays its film, with pause, seek and speed, apart from everybody else's."""

import asyncio
import time

from fastapi import WebSocket
from pydantic import BaseModel

from acquisition.safety import Safety
from app.describe import hello
from app.disk import free_bytes
from app.frames import pack
from app.live import Viewer
from app.plan import ServicePlan
from app.record.link import NO_RECORDER
from app.replay.film import Film
from app.replay.films import Showing
from app.replay.playhead import Playhead
from app.wire import EventMessage, FrameKind, Phase, ReplayControl, ReplayState, State
from config.errors import GraspwatchError

POSITION_PERIOD_S = 0.1
STATE_PERIOD_S = 1.0
HELD_UP_S = 0.25  # a replay does not make up for more, whether the viewer or the server was slow
NOTHING = ReplayControl()
REFUSED, FAILED = 1008, 1011  # codes of a close
REASON_BYTES = 120  # of a close; the protocol allows 123


class Player:
    """Shows a film to a viewer, turn by turn, and no faster than it follows."""

    def __init__(self, plan: ServicePlan, name: str, showing: Showing, film: Film, viewer: Viewer) -> None:
        self._plan, self._name, self._showing, self._film, self._viewer = plan, name, showing, film, viewer
        self._head = Playhead(film.end_tick, film.rate_hz)
        self._jumped = True
        self._owed_s = 0.0  # time that has passed and was not played yet
        self._position_due_s = self._state_due_s = 0.0
        self._sequence = 0

    def turn(self, now_s: float, elapsed_s: float, wanted: ReplayControl) -> None:
        """Obey, then show what is due; `now_s` is of `time.monotonic`, `elapsed_s` since the last turn."""
        reads, changed = self._viewer.reads, wanted != NOTHING
        if changed:
            self._jumped |= self._head.obey(wanted)
        self._owed_s = min(self._owed_s + elapsed_s, HELD_UP_S) if self._head.playing else 0.0
        if self._jumped and reads:
            self._begin()
            self._jumped, self._owed_s, changed = False, 0.0, True
        elif not self._jumped and self._viewer.follows and self._head.playing:
            self._show(*self._head.advance(self._owed_s))
            self._owed_s = 0.0
            changed |= not self._head.playing
        if reads and (changed or now_s >= self._position_due_s):
            self._position_due_s = now_s + POSITION_PERIOD_S
            self._tell(self._position())
        if reads and now_s >= self._state_due_s:
            self._state_due_s = now_s + STATE_PERIOD_S
            self._tell(self._state())

    def _begin(self) -> None:
        """What somebody gets who comes at this moment."""
        shown, film = self._head.shown, self._film
        self._viewer.drop_frames()
        greeting = hello(self._plan, self._film.tool, recording=True)
        self._tell(greeting.model_copy(update={"server_time_ms": self._at_ms}))
        self._tell(self._state())
        for message in film.so_far(shown):
            self._viewer.send(message)
        history = int(self._plan.settings.server.history_s * film.rate_hz)
        self._send_samples(FrameKind.HISTORY, max(shown - history, 0), shown)

    def _show(self, begin: int, end: int) -> None:
        for message in self._film.told(begin, end):
            self._viewer.send(message)
        self._send_samples(FrameKind.LIVE, begin, end)

    def _send_samples(self, kind: FrameKind, begin: int, end: int) -> None:
        for first_tick, columns in self._film.samples(begin, end):
            self._sequence += 1
            newest_ms = 1e3 * (first_tick + columns.shape[1] - 1) / self._film.rate_hz
            self._viewer.send_frame(pack(kind, self._sequence, first_tick, newest_ms, columns))

    def _tell(self, message: BaseModel) -> None:
        self._viewer.send(message.model_dump_json())

    @property
    def _at_ms(self) -> float:
        """The clock of a replay is its position."""
        return self._head.position_s * 1e3

    def _position(self) -> ReplayState:
        return ReplayState(
            name=self._name,
            prepared=1.0,
            playing=self._head.playing,
            position_s=self._head.position_s,
            duration_s=self._film.duration_s,
            speed=self._head.speed,
            grasps=self._film.grasp_starts_s,
        )

    def _state(self) -> State:
        return State(
            server_time_ms=self._at_ms,
            phase=Phase.REPLAY,
            safety=Safety.DISARMED,
            safety_why=None,
            run=None,
            last_run=None,
            limit_n=None,
            simulated_tissue=None,
            demo=None,
            control=None,
            rate_hz=self._film.rate_hz,
            lost_samples=self._film.lost_samples(self._head.shown),
            estimator_latency_ms=None,
            viewers=self._showing.viewers,
            recording=NO_RECORDER,
            free_disk_bytes=free_bytes(self._plan.data),
            faults=self._film.faults(self._head.shown),
        )


class Replay:
    """A connection that waits for a film and then plays it."""

    def __init__(self, plan: ServicePlan, name: str, showing: Showing, socket: WebSocket) -> None:
        self._plan, self._name, self._showing = plan, name, showing
        self._viewer = Viewer(socket, plan.settings.server.chart_window_frames, self._obey)
        self._wanted = NOTHING

    def _obey(self, control: ReplayControl) -> None:
        """Keep what is wanted until the next turn; of two wishes for the same thing the later one counts."""
        self._wanted = self._wanted.model_copy(update=control.model_dump(exclude_none=True))

    async def serve(self) -> None:
        """Until the viewer leaves."""
        playing = asyncio.create_task(self._run())
        try:
            await self._viewer.serve()
        finally:
            playing.cancel()
            await asyncio.wait([playing])
        if not playing.cancelled():
            playing.result()

    async def _run(self) -> None:
        try:
            await self._play(await self._prepared())
        except GraspwatchError as error:
            refuse(self._viewer, error)
        finally:
            self._viewer.close(FAILED, "the replay failed inside")

    async def _prepared(self) -> Film:
        """The film, once it is there; the viewer is told how far it is."""
        while not self._showing.film.done():
            state = ReplayState(
                name=self._name,
                prepared=min(self._showing.prepared, 0.99),
                playing=False,
                position_s=0.0,
                duration_s=None,
                speed=1.0,
                grasps=[],
            )
            if self._viewer.reads:
                self._viewer.send(state.model_dump_json())
            await asyncio.wait([self._showing.film], timeout=POSITION_PERIOD_S)
        return self._showing.film.result()

    async def _play(self, film: Film) -> None:
        player = Player(self._plan, self._name, self._showing, film, self._viewer)
        period_s = 1.0 / self._plan.settings.server.frame_rate_hz
        due_s = turned_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            wanted, self._wanted = self._wanted, NOTHING
            player.turn(now_s, now_s - turned_s, wanted)
            turned_s = now_s
            due_s = max(due_s + period_s, now_s)  # what was missed is not made up for turn by turn
            await asyncio.sleep(due_s - time.monotonic())


def refuse(viewer: Viewer, error: GraspwatchError) -> None:
    """Say what is wrong, and close: with as much of the text as a close can carry."""
    viewer.send(EventMessage(server_time_ms=0.0, text=str(error)).model_dump_json())
    viewer.close(REFUSED, str(error).encode()[:REASON_BYTES].decode(errors="ignore"))
