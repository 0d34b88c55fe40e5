"""The class Frame: measurements and estimates of consecutive samples, at the full sample rate."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from app.messages.live import FRAME_HEADER, FRAME_KINDS, FRAME_MAGIC, ChannelInfo, FrameKind

KINDS = {number: kind for kind, number in FRAME_KINDS.items()}


@dataclass(frozen=True, eq=False)
class Frame:
    """Consecutive samples of all channels.

    `columns` is float32 with one row per channel and one column per sample; NaN means no value. `frame["jaw_force_n"]`
    and `frame["probability", "liver"]` return one channel, 1-D. `channels` holds names and units. A tick is the number
    of a sample. `newest_ms` is the time of the newest sample by the service's monotonic clock.
    """

    kind: FrameKind
    sequence: int
    first_tick: int
    newest_ms: float
    columns: NDArray[np.float32]
    channels: Sequence[ChannelInfo]

    @classmethod
    def unpack(cls, data: bytes, channels: Sequence[ChannelInfo]) -> Self:
        """Decode a binary message; `channels` come from the `Hello` before it.

        Raises:
            ValueError: the message is not a frame of these channels.
        """
        magic, kind, _, columns, rows, sequence, first_tick, newest_ms = FRAME_HEADER.unpack_from(data)
        if magic != FRAME_MAGIC or columns != len(channels):
            raise ValueError(f"no frame of {len(channels)} channels")
        values = np.frombuffer(data, "<f4", offset=FRAME_HEADER.size).reshape(columns, rows)
        return cls(KINDS[kind], sequence, int(first_tick), newest_ms, values, channels)

    @property
    def ticks(self) -> NDArray[np.int64]:
        return np.arange(self.first_tick, self.first_tick + self.columns.shape[1])

    def __len__(self) -> int:
        return self.columns.shape[1]

    def __getitem__(self, channel: str | tuple[str, str]) -> NDArray[np.float32]:
        """Return one channel by its name, or by its name and tissue.

        Raises:
            KeyError: there is no such channel.
        """
        return self.columns[self._column_indices[channel]]

    @cached_property
    def _column_indices(self) -> dict[str | tuple[str, str], int]:
        return {(each.name, each.tissue) if each.tissue else each.name: i for i, each in enumerate(self.channels)}
