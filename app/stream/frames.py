"""The class FrameBuffer, and functions that build sample frames: float32 columns at full rate, 30 frames a second."""

from collections import deque
from typing import NamedTuple

import numpy as np

from acquisition.signal_table import SIGNALS, list_numbered_names
from app.messages.live import FRAME_HEADER, FRAME_KINDS, FRAME_MAGIC, ChannelInfo, FrameKind


class FrameColumn(NamedTuple):
    """Unit and meaning of one column of a sample frame."""

    unit: str
    meaning: str


_BY_NAME = {signal.name: FrameColumn(signal.unit, signal.meaning) for signal in SIGNALS}
_ORDER = list_numbered_names("frame", ((signal.frame, signal.name) for signal in SIGNALS))
SAMPLE_COLUMNS = {name: _BY_NAME[name] for name in _ORDER}
ESTIMATE_COLUMNS = {
    "threshold_n": FrameColumn("N", "Injury threshold in force, for the force alarms"),
    "probability_unknown": FrameColumn("", "Probability that the tissue is like none of the library"),
}
TISSUE_COLUMNS = {
    "probability": FrameColumn("", "Probability of the tissue"),
    "force_n": FrameColumn("N", "Force of the tissue's model without damping, α(e^(βx) − 1)"),
    "alpha_n": FrameColumn("N", "Estimated stiffness α"),
    "beta_per_m": FrameColumn("1/m", "Estimated stiffening β"),
    "damping_kg_per_s": FrameColumn("kg/s", "Estimated damping d"),
    "nis": FrameColumn("", "Fit of the filter: its normalized innovation squared, 1 where it fits"),
}
SD_COLUMNS = {
    "log_alpha_sd": FrameColumn("", "Standard deviation of log α"),
    "log_beta_sd": FrameColumn("", "Standard deviation of log β"),
    "log_damping_sd": FrameColumn("", "Standard deviation of log d"),
}  # in the order of `log_sd`


def build_channels(tissues: list[str]) -> list[ChannelInfo]:
    """Return the columns of a frame in their order."""
    common, of_tissue = SAMPLE_COLUMNS | ESTIMATE_COLUMNS, TISSUE_COLUMNS | SD_COLUMNS
    return [ChannelInfo(name=name, unit=column.unit) for name, column in common.items()] + [
        ChannelInfo(name=name, unit=column.unit, tissue=tissue)
        for tissue in tissues
        for name, column in of_tissue.items()
    ]


def build_frame_columns(samples: np.ndarray, estimates: np.ndarray, tissues: int) -> np.ndarray:
    """Return float32 columns, (channels, n), of samples and their estimates."""
    rows = [samples[name] for name in SAMPLE_COLUMNS] + [estimates[name] for name in ESTIMATE_COLUMNS]
    for k in range(tissues):
        rows += [estimates[name][:, k] for name in TISSUE_COLUMNS]
        rows += [estimates["log_sd"][:, k, i] for i in range(len(SD_COLUMNS))]
    return np.array(rows, np.float32)


def pack_frame(kind: FrameKind, sequence: int, first_tick: int, newest_ms: float, columns: np.ndarray) -> bytes:
    """Pack one binary frame, see app/messages/live.py."""
    header = FRAME_HEADER.pack(
        FRAME_MAGIC, FRAME_KINDS[kind], 1, len(columns), columns.shape[1], sequence, float(first_tick), newest_ms
    )
    return header + columns.astype("<f4", copy=False).tobytes()


class FrameBuffer:
    """Buffer of columns until the next frame is cut, and of the last seconds for viewers that come later."""

    def __init__(self, history_samples: int) -> None:
        self._history_samples = history_samples
        self._pending: list[tuple[int, np.ndarray]] = []
        self._history: deque[tuple[int, np.ndarray]] = deque()
        self._history_frames: list[bytes] | None = None  # packed once for viewers that come together
        self._kept_samples = 0
        self._sequence = 0
        self._newest_ms = 0.0

    def add(self, first_tick: int, columns: np.ndarray, newest_ms: float) -> None:
        self._pending.append((first_tick, columns))
        self._newest_ms = newest_ms

    def cut_frames(self) -> list[bytes]:
        """Return packed frames of the columns since the last cut: one, or several around missing ticks."""
        joined, self._pending = _join_consecutive(self._pending), []
        if joined:
            self._history_frames = None
        for first_tick, columns in joined:
            if self._history and first_tick < self._history[-1][0]:  # a new source counts from zero again
                self._history.clear()
                self._kept_samples = 0
            self._history.append((first_tick, columns))
            self._kept_samples += columns.shape[1]
        while self._kept_samples > self._history_samples:
            self._kept_samples -= self._history.popleft()[1].shape[1]
        return [self._pack(FrameKind.LIVE, first_tick, columns) for first_tick, columns in joined]

    def history_frames(self) -> list[bytes]:
        """Return the samples of the last seconds as binary WebSocket messages, for a viewer that connects later."""
        if self._history_frames is None:
            joined = _join_consecutive(list(self._history))
            self._history_frames = [self._pack(FrameKind.HISTORY, tick, columns) for tick, columns in joined]
        return self._history_frames

    def _pack(self, kind: FrameKind, first_tick: int, columns: np.ndarray) -> bytes:
        self._sequence = (self._sequence + 1) % 2**32
        return pack_frame(kind, self._sequence, first_tick, self._newest_ms, columns)


def _join_consecutive(pieces: list[tuple[int, np.ndarray]]) -> list[tuple[int, np.ndarray]]:
    """Join pieces that follow each other without a gap."""
    groups: list[tuple[int, list[np.ndarray]]] = []
    expected = -1
    for first_tick, columns in pieces:
        if first_tick == expected:
            groups[-1][1].append(columns)
        else:
            groups.append((first_tick, [columns]))
        expected = first_tick + columns.shape[1]
    return [(tick, np.concatenate(parts, axis=1)) for tick, parts in groups]
