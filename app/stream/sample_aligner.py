"""The class SampleAligner, which aligns samples and their estimates, in whichever order they arrive."""

import time
from collections import deque
from collections.abc import Iterator

import numpy as np

from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock
from app.host.clock import monotonic_to_wall_ms
from app.stream.frames import FrameBuffer, build_frame_columns
from estimator.estimate_block import EstimateBlock, blank_estimates, estimate_dtype

MAX_PENDING_ESTIMATES = 400  # blocks: two seconds
ESTIMATES_TIMEOUT_S = 0.1  # after it, samples are shown without estimates


class SampleAligner:
    """Aligner that fills a frame buffer; samples whose estimates are late go without them."""

    def __init__(self, frames: FrameBuffer, tissues: int) -> None:
        self._frames = frames
        self._tissues = tissues
        # Blocks that wait for their estimates, with their time of arrival, s.
        self._pending_blocks: deque[tuple[float, SampleBlock]] = deque()
        self._pending_estimates: dict[int, np.ndarray] = {}  # estimates that wait for their samples

    def reset(self) -> None:
        """Forget waiting estimates after a restart of the acquisition, whose block numbers begin anew."""
        self._pending_estimates.clear()

    def add_samples(self, block: SampleBlock) -> None:
        self._pending_blocks.append((time.monotonic(), block))

    def add_estimates(self, block: EstimateBlock) -> None:
        self._pending_estimates[block.sequence] = block.estimates
        self._pending_estimates.pop(block.sequence - MAX_PENDING_ESTIMATES, None)
        if len(self._pending_estimates) > MAX_PENDING_ESTIMATES // 2:  # after a delay of the server
            self.align()

    def align(self) -> None:
        """Pass on blocks with their estimates, and blocks that have waited too long.

        Blocks without a gap between them are passed on together, which costs no more than one of them.
        """
        joined: list[tuple[SampleBlock, np.ndarray]] = []
        for block, estimates in self._pop_aligned():
            if joined and int(block.samples["tick"][0]) != int(joined[-1][0].samples["tick"][-1]) + 1:
                self._pass_on(joined)
                joined = []
            joined.append((block, estimates))
        if joined:
            self._pass_on(joined)

    def _pop_aligned(self) -> Iterator[tuple[SampleBlock, np.ndarray]]:
        while self._pending_blocks:
            came_s, block = self._pending_blocks[0]
            estimates = self._pending_estimates.pop(block.sequence, None)
            if estimates is None:
                overtaken = bool(self._pending_estimates) and block.sequence < min(self._pending_estimates)
                if not overtaken and time.monotonic() - came_s < ESTIMATES_TIMEOUT_S:
                    return
                estimates = blank_estimates(estimate_dtype(self._tissues), block.samples["tick"])
            self._pending_blocks.popleft()
            yield block, estimates

    def _pass_on(self, joined: list[tuple[SampleBlock, np.ndarray]]) -> None:
        samples = np.concatenate([block.samples for block, _ in joined], dtype=SAMPLE_DTYPE)
        estimates = np.concatenate([each for _, each in joined], dtype=estimate_dtype(self._tissues))
        columns = build_frame_columns(samples, estimates, self._tissues)
        self._frames.add(int(samples["tick"][0]), columns, monotonic_to_wall_ms(joined[-1][0].t_mono_ns))
