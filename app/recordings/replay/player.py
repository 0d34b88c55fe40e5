"""The class ReplayPlayer, which plays a replay cache to one viewer with pause, seek and speed, and its connection."""

import asyncio
import time

from fastapi import WebSocket
from pydantic import BaseModel

from acquisition.safety_state_machine import Safety
from app.host.disk import free_bytes
from app.messages.live import RECORDER_OFF, EventMessage, FrameKind, Phase, ReplayControl, ReplayState, State
from app.recordings.replay.cache_store import ReplayCacheEntry
from app.recordings.replay.playhead import Playhead
from app.recordings.replay.replay_cache import ReplayCache
from app.stream.descriptions import build_hello
from app.stream.frames import pack_frame
from app.stream.viewers import Viewer
from config.errors import GraspwatchError
from config.service_plan import ServicePlan

POSITION_PERIOD_S = 0.1
STATE_PERIOD_S = 1.0
MAX_CATCH_UP_S = 0.25  # a longer delay, of the viewer or the server, is not made up for
NO_CONTROL = ReplayControl()
REFUSED_CLOSE_CODE, FAILED_CLOSE_CODE = 1008, 1011  # WebSocket close codes
MAX_REASON_BYTES = 120  # of a close; the protocol allows 123


class ReplayPlayer:
    """Player of a replay cache for one viewer, never faster than the viewer receives."""

    def __init__(
        self, plan: ServicePlan, name: str, cache_entry: ReplayCacheEntry, cache: ReplayCache, viewer: Viewer
    ) -> None:
        self._plan, self._name, self._cache_entry, self._cache, self._viewer = plan, name, cache_entry, cache, viewer
        self._playhead = Playhead(cache.end_tick, cache.rate_hz)
        self._seek_pending = True
        self._unplayed_s = 0.0  # elapsed time that is not played yet
        self._position_due_s = self._state_due_s = 0.0
        self._sequence = 0
        self._hello = build_hello(plan, cache.tool, recording=True)

    def step(self, now_s: float, elapsed_s: float, control: ReplayControl) -> None:
        """Apply the control and send the data due; `now_s` by `time.monotonic`, `elapsed_s` since the last call."""
        reads, changed = self._viewer.has_sent_all_messages, control != NO_CONTROL
        if changed:
            self._seek_pending |= self._playhead.apply_control(control)
        self._unplayed_s = min(self._unplayed_s + elapsed_s, MAX_CATCH_UP_S) if self._playhead.playing else 0.0
        if self._seek_pending and reads:
            self._send_initial_messages()
            self._seek_pending, self._unplayed_s, changed = False, 0.0, True
        elif not self._seek_pending and self._viewer.has_sent_everything and self._playhead.playing:
            self._send_range(*self._playhead.advance(self._unplayed_s))
            self._unplayed_s = 0.0
            changed |= not self._playhead.playing
        if reads and (changed or now_s >= self._position_due_s):
            self._position_due_s = now_s + POSITION_PERIOD_S
            self._send(self._build_replay_state())
        if reads and now_s >= self._state_due_s:
            self._state_due_s = now_s + STATE_PERIOD_S
            self._send(self._build_state())

    def _send_initial_messages(self) -> None:
        """Send the messages and frames that a viewer needs at this position."""
        shown, cache = self._playhead.shown_tick, self._cache
        self._viewer.drop_frames()
        self._send(self._hello.model_copy(update={"server_time_ms": self._position_ms}))
        self._send(self._build_state())
        for message in cache.initial_messages(shown):
            self._viewer.send(message)
        history = int(self._plan.settings.server.history_s * cache.rate_hz)
        self._send_samples(FrameKind.HISTORY, max(shown - history, 0), shown)

    def _send_range(self, begin: int, end: int) -> None:
        for message in self._cache.messages(begin, end):
            self._viewer.send(message)
        self._send_samples(FrameKind.LIVE, begin, end)

    def _send_samples(self, kind: FrameKind, begin: int, end: int) -> None:
        for first_tick, columns in self._cache.samples(begin, end):
            self._sequence += 1
            newest_ms = 1e3 * (first_tick + columns.shape[1] - 1) / self._cache.rate_hz
            self._viewer.send_frame(pack_frame(kind, self._sequence, first_tick, newest_ms, columns))

    def _send(self, message: BaseModel) -> None:
        self._viewer.send(message.model_dump_json())

    @property
    def _position_ms(self) -> float:
        """Time of the replay: its position, ms."""
        return self._playhead.position_s * 1e3

    def _build_replay_state(self) -> ReplayState:
        return ReplayState(
            name=self._name,
            prepared=1.0,
            playing=self._playhead.playing,
            position_s=self._playhead.position_s,
            duration_s=self._cache.duration_s,
            speed=self._playhead.speed,
            grasps=self._cache.grasp_starts_s,
            start_s=self._cache.start_s,
        )

    def _build_state(self) -> State:
        return State(
            server_time_ms=self._position_ms,
            phase=Phase.REPLAY,
            safety=Safety.DISARMED,
            safety_why=None,
            run=None,
            last_run=None,
            limit_n=None,
            simulated_tissue=None,
            demo=None,
            control=None,
            rate_hz=self._cache.rate_hz,
            lost_samples=self._cache.lost_samples(self._playhead.shown_tick),
            estimator_latency_ms=None,
            viewers=self._cache_entry.viewers,
            recording=RECORDER_OFF,
            free_disk_bytes=free_bytes(self._plan.data_folder),
            faults=self._cache.technical_alarm_texts(self._playhead.shown_tick),
        )


class ReplayConnection:
    """A connection that waits for a replay cache and then plays it."""

    def __init__(self, plan: ServicePlan, name: str, cache_entry: ReplayCacheEntry, socket: WebSocket) -> None:
        self._plan, self._name, self._cache_entry = plan, name, cache_entry
        self._viewer = Viewer(socket, plan.settings.server.chart_window_frames, self._on_control)
        self._pending_control = NO_CONTROL

    def _on_control(self, control: ReplayControl) -> None:
        """Merge the control into that of the next turn; of two values for one field the later one counts."""
        self._pending_control = self._pending_control.model_copy(update=control.model_dump(exclude_none=True))

    async def serve(self) -> None:
        """Serve the viewer until it leaves."""
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
            await self._play(await self._wait_for_cache())
        except GraspwatchError as error:
            close_with_error(self._viewer, error)
        finally:
            self._viewer.close(FAILED_CLOSE_CODE, "the replay failed inside")

    async def _wait_for_cache(self) -> ReplayCache:
        """Return the cache once it is built; meanwhile, send the viewer the share done."""
        while not self._cache_entry.build_task.done():
            state = ReplayState(
                name=self._name,
                prepared=min(self._cache_entry.prepared_share, 0.99),
                playing=False,
                position_s=0.0,
                duration_s=None,
                speed=1.0,
                grasps=[],
            )
            if self._viewer.has_sent_all_messages:
                self._viewer.send(state.model_dump_json())
            await asyncio.wait([self._cache_entry.build_task], timeout=POSITION_PERIOD_S)
        return self._cache_entry.build_task.result()

    async def _play(self, cache: ReplayCache) -> None:
        player = ReplayPlayer(self._plan, self._name, self._cache_entry, cache, self._viewer)
        period_s = 1.0 / self._plan.settings.server.frame_rate_hz
        due_s = turned_s = time.monotonic()
        while True:
            now_s = time.monotonic()
            wanted, self._pending_control = self._pending_control, NO_CONTROL
            player.step(now_s, now_s - turned_s, wanted)
            turned_s = now_s
            due_s = max(due_s + period_s, now_s)  # late turns are skipped
            await asyncio.sleep(due_s - time.monotonic())


def close_with_error(viewer: Viewer, error: GraspwatchError) -> None:
    """Send the error's text and close, with as much of the text as a close can carry."""
    viewer.send(EventMessage(server_time_ms=0.0, text=str(error)).model_dump_json())
    viewer.close(REFUSED_CLOSE_CODE, str(error).encode()[:MAX_REASON_BYTES].decode(errors="ignore"))
