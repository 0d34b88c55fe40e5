"""The class ReplayCache: all samples and messages of a recording for its viewers, written once, then only read.

It is a folder of four files. `columns.npy` is float32 of shape (samples, channels). `messages` holds JSON messages one
after the other. `index.npz` has the tick of each message, and the gaps in the samples. `tool.json` is the tool of the
recording.
"""

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Self

import numpy as np

from app.messages.alarms import Alarm, AlarmKind
from config.schema import Tool

COLUMNS_FILE, MESSAGES_FILE, INDEX_FILE, TOOL_FILE = "columns.npy", "messages", "index.npz", "tool.json"


class MessageKind(IntEnum):
    """Kind of a cached message."""

    IDENTIFICATION = 0
    EVENT = 1
    GRASP = 2
    ALARM = 3
    ALARM_OVER = 4


@dataclass(frozen=True, slots=True)
class ReplayCacheIndex:
    """Index arrays of shape (pieces,), (messages,) and (grasps,); a piece has no gap between its samples."""

    rate_hz: np.ndarray  # of shape ()
    first_tick: np.ndarray  # of shape (); tick of the first sample when it was recorded
    first_ticks: np.ndarray
    first_rows: np.ndarray
    ticks: np.ndarray  # of the sample at which a message became known; never decreases
    kinds: np.ndarray
    ends: np.ndarray  # of messages, bytes from the beginning
    alarms: np.ndarray  # an alarm's id; empty for other messages
    grasp_starts_s: np.ndarray


class ReplayCache:
    """An opened replay cache. Its files stay open, so that their folder may be deleted."""

    def __init__(self, columns: np.ndarray, messages: np.ndarray, index: ReplayCacheIndex, tool: Tool) -> None:
        """`columns`: float32 of shape (samples, channels); `messages`: uint8 of shape (bytes,)."""
        self._columns, self._messages, self._index, self.tool = columns, messages, index, tool
        self._message_starts = np.concatenate([[0], index.ends[:-1]])
        self.rate_hz = float(index.rate_hz)
        self.start_s = int(index.first_tick) / self.rate_hz
        """Time of the first sample by the clock of the service that recorded it, as in the times of marks, s."""
        self.grasp_starts_s: list[float] = index.grasp_starts_s.tolist()
        self.end_tick = int(index.first_ticks[-1] + len(columns) - index.first_rows[-1])

    @classmethod
    def open(cls, folder: Path) -> Self:
        with np.load(folder / INDEX_FILE) as index:
            return cls(
                np.load(folder / COLUMNS_FILE, mmap_mode="r"),
                np.memmap(folder / MESSAGES_FILE, np.uint8, "r"),
                ReplayCacheIndex(**index),
                Tool.model_validate_json((folder / TOOL_FILE).read_bytes()),
            )

    @property
    def duration_s(self) -> float:
        return self.end_tick / self.rate_hz

    def _find_row(self, tick: int) -> int:
        """Return the row of the first sample at this tick or later."""
        index = self._index
        piece = int(np.searchsorted(index.first_ticks, tick, "right")) - 1
        end = index.first_rows[piece + 1] if piece + 1 < len(index.first_rows) else len(self._columns)
        return int(min(index.first_rows[piece] + tick - index.first_ticks[piece], end))

    def lost_samples(self, tick: int) -> int:
        """Return the number of samples missing before this tick."""
        return tick - self._find_row(tick)

    def samples(self, begin: int, end: int) -> list[tuple[int, np.ndarray]]:
        """Return samples at ticks from `begin` before `end` as pieces: first tick, and columns (channels, n)."""
        index, first, last = self._index, self._find_row(begin), self._find_row(end)
        inner = index.first_rows[(index.first_rows > first) & (index.first_rows < last)].tolist()
        pieces = []
        for row, until in zip([first, *inner], [*inner, last], strict=True):
            piece = int(np.searchsorted(index.first_rows, row, "right")) - 1
            tick = int(index.first_ticks[piece] + row - index.first_rows[piece])
            if until > row:
                pieces.append((tick, self._columns[row:until].T))
        return pieces

    def messages(self, begin: int, end: int) -> list[str]:
        """Return the messages that became known at ticks from `begin` on before `end`."""
        first, last = np.searchsorted(self._index.ticks, [begin, end]).tolist()
        return [self._message(i) for i in range(first, last)]

    def _message(self, i: int) -> str:
        return self._messages[self._message_starts[i] : self._index.ends[i]].tobytes().decode()

    def initial_messages(self, tick: int) -> list[str]:
        """Return what a viewer needs at this tick: active alarms, finished grasps, the last identification."""
        kinds = self._index.kinds[: np.searchsorted(self._index.ticks, tick)]
        grasps = np.flatnonzero(kinds == MessageKind.GRASP).tolist()
        identified = np.flatnonzero(kinds == MessageKind.IDENTIFICATION).tolist()[-1:]
        return [self._message(i) for i in (*self._find_active_alarms(kinds), *grasps, *identified)]

    def _find_active_alarms(self, kinds: np.ndarray) -> list[int]:
        on: dict[str, int] = {}
        for i in np.flatnonzero(kinds >= MessageKind.ALARM).tolist():
            on.pop(str(self._index.alarms[i]), None)
            if kinds[i] == MessageKind.ALARM:
                on[str(self._index.alarms[i])] = i
        return list(on.values())

    def technical_alarm_texts(self, tick: int) -> list[str]:
        """Return the texts of the technical alarms that are on at this tick."""
        kinds = self._index.kinds[: np.searchsorted(self._index.ticks, tick)]
        alarms = [Alarm.model_validate_json(self._message(i)) for i in self._find_active_alarms(kinds)]
        return [alarm.text for alarm in alarms if alarm.kind is AlarmKind.TECHNICAL]
