"""Puts samples and their estimates together, whichever came first."""

import time
from collections import deque

import numpy as np

from acquisition.blocks import SampleBlock
from app.clock import wall_ms
from app.frames import FrameBuffer, columns_of
from estimator.blocks import EstimateBlock, blank_estimates, estimate_dtype

ANSWERS_KEPT = 400  # blocks: two seconds
ESTIMATES_LATE_S = 0.1  # samples are shown without estimates when these take longer


class Joiner:
    """Fills a frame buffer; samples go without estimates when theirs are late."""

    def __init__(self, frames: FrameBuffer, tissues: int) -> None:
        self._frames = frames
        self._tissues = tissues
        self._waiting: deque[tuple[float, SampleBlock]] = deque()  # when it came, s; its estimates are still to come
        self._answers: dict[int, np.ndarray] = {}  # estimates whose samples are still to come

    def begin_anew(self) -> None:
        """The acquisition was restarted: its blocks are counted from the beginning again."""
        self._answers.clear()

    def take_samples(self, block: SampleBlock) -> None:
        self._waiting.append((time.monotonic(), block))

    def take_estimates(self, block: EstimateBlock) -> None:
        self._answers[block.sequence] = block.estimates
        self._answers.pop(block.sequence - ANSWERS_KEPT, None)
        self.join()

    def join(self) -> None:
        """Hand on what is complete, and what has waited too long."""
        while self._waiting:
            came_s, block = self._waiting[0]
            estimates = self._answers.pop(block.sequence, None)
            if estimates is None:
                overtaken = bool(self._answers) and block.sequence < min(self._answers)
                if not overtaken and time.monotonic() - came_s < ESTIMATES_LATE_S:
                    return
                estimates = blank_estimates(estimate_dtype(self._tissues), block.samples["tick"])
            self._waiting.popleft()
            columns = columns_of(block.samples, estimates, self._tissues)
            self._frames.add(int(block.samples["tick"][0]), columns, wall_ms(block.t_mono_ns))
