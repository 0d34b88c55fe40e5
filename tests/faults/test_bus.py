"""Blocks that are dropped, late or out of order on their way to a real estimator process."""

import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import zmq
from faulty import LIBRARY, PROTOCOL, SETTINGS, TOOL

from acquisition import bus
from acquisition.acquisition_loop import AcquisitionController
from acquisition.bench.jitter import keep_cores_busy
from acquisition.drivers.nidaq import NidaqSource
from acquisition.notices import Estimating
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SampleBlock
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import create_in_process_options
from estimator import worker as estimator_worker
from estimator.estimate_messages import ReceivedEstimates, unpack_estimates

TISSUE = "gallbladder"
HALF_A_MINUTE = 6_000  # blocks


@pytest.fixture(scope="module")
def blocks() -> list[SampleBlock]:
    """Two grasps, as the acquisition publishes them."""
    board = SimulatedBoard(TOOL, SimulatedGrasper(TOOL, LIBRARY, TISSUE, seed=1), VirtualClock())
    published = []
    with NidaqSource(TOOL, create_in_process_options(board), board.clock.now_ns) as source:
        acquisition = AcquisitionController(source, TOOL, SETTINGS.conditioning, safety=Safety.ARMED)
        acquisition.start("run", PROTOCOL, 2)
        while acquisition.running:
            published.append(acquisition.process_block())
    return published


class Estimator:
    """A real estimator process, what is sent to it and what it answers."""

    def __init__(self, endpoints: bus.Endpoints) -> None:
        self._context = zmq.Context()
        self._publisher = bus.open_publisher(self._context, endpoints.samples)
        self._answers = bus.open_subscriber(self._context, endpoints.estimates)
        setup = estimator_worker.EstimatorSetup(os.getpid(), endpoints, TOOL, LIBRARY, SETTINGS)
        context = multiprocessing.get_context("spawn")
        self._process = context.Process(target=estimator_worker.main, args=(setup,), daemon=True)
        self._process.start()
        while not isinstance(bus.unpack_notice(self._answers.recv_multipart()), Estimating):
            pass
        time.sleep(0.3)  # its subscription travels

    def estimate(self, blocks: list[SampleBlock]) -> list[ReceivedEstimates]:
        """Send the blocks in that order; what was made of them, up to the last."""
        received = []
        for block in blocks:
            self._publisher.send_multipart(bus.pack_samples(block))
        last = max(block.sequence for block in blocks)
        while not received or received[-1].block.sequence < last:
            assert self._answers.poll(20_000), "no answer"
            parts = self._answers.recv_multipart()
            if parts[0] == bus.ESTIMATES_TOPIC:
                received.append(unpack_estimates(parts, len(LIBRARY.tissues)))
        return received

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Meanwhile, as on a machine that is paused or swaps."""
        os.kill(self._process.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self._process.pid, signal.SIGCONT)

    def estimate_backlog(self, blocks: list[SampleBlock]) -> tuple[int, int]:
        """Send the blocks while the process is stopped; how many it answered afterwards, and called missing."""
        with self.stopped():
            for block in blocks:
                self._publisher.send_multipart(bus.pack_samples(block))
            time.sleep(0.2)
        answered = missing = 0
        until_s = time.monotonic() + 20.0
        while time.monotonic() < until_s and answered < len(blocks):
            parts = self._answers.recv_multipart()
            if parts[0] == bus.ESTIMATES_TOPIC:
                answered, missing = answered + 1, unpack_estimates(parts, len(LIBRARY.tissues)).missing_blocks
                until_s = time.monotonic() + 3.0
        assert self._process.is_alive()
        return answered, missing

    def close(self) -> None:
        self._process.terminate()
        self._process.join(10)
        self._context.destroy(linger=0)


@contextmanager
def running(folder) -> Iterator[Estimator]:
    estimator = Estimator(bus.Endpoints.in_folder(folder))
    try:
        yield estimator
    finally:
        estimator.close()


def grasps_of(received):
    return [grasp for estimates in received for grasp in estimates.block.ended]


def test_what_is_dropped_is_counted_and_names_nothing_wrong(blocks, tmp_path):
    dropped = {40 + 13 * i for i in range(25)}
    with running(tmp_path) as estimator:
        received = estimator.estimate([block for block in blocks if block.sequence not in dropped])
    assert received[-1].missing_blocks == len(dropped)
    assert len(received) == len(blocks) - len(dropped)
    grasps = grasps_of(received)
    assert len(grasps) == 2
    assert {grasp.label for grasp in grasps} <= {TISSUE, "undecided", "unknown"}
    assert any(grasp.why_invalid for grasp in grasps)


def test_blocks_that_are_overtaken_are_counted_as_missing_and_end_no_grasp(blocks, tmp_path):
    mixed = list(blocks)
    for i in range(150, len(mixed) - 10, 20):
        mixed[i], mixed[i + 3] = mixed[i + 3], mixed[i]
    with running(tmp_path) as estimator:
        received = estimator.estimate(mixed)
    sequences = [estimates.block.sequence for estimates in received]
    assert sequences == sorted(sequences)
    assert received[-1].missing_blocks == len(blocks) - len(received) > 0
    assert len(grasps_of(received)) >= 1
    assert {grasp.label for grasp in grasps_of(received)} <= {TISSUE, "undecided", "unknown"}


def test_a_sender_that_was_restarted_is_not_taken_for_one_that_is_late(blocks, tmp_path):
    later = [
        SampleBlock(block.sequence, block.t_mono_ns + 10**12, 0, block.samples, "another", block.safety)
        for block in blocks
    ]
    with running(tmp_path) as estimator:
        first = estimator.estimate(blocks)
        estimator.estimate(later[:1])
        again = estimator.estimate(later[1:])
    assert again[-1].missing_blocks == 0
    assert len(again) == len(first) - 1


def repeated(blocks: list[SampleBlock], number: int) -> Iterator[SampleBlock]:
    """So many blocks of grasps that follow each other."""
    for i in range(number):
        block, round_ = blocks[i % len(blocks)], i // len(blocks)
        samples = block.samples.copy()
        ticks = round_ * 5 * len(blocks)
        for name in ("tick", "grasp_start_tick", "contact_tick", "wall_tick"):
            samples[name] += np.where(samples[name] >= 0, ticks, 0).astype(samples[name].dtype)
        samples["grasp"] += round_ * 2
        yield SampleBlock(i + 1, block.t_mono_ns + ticks * 10**6, 0, samples, block.run, block.safety)


@pytest.mark.parametrize("busy", [False, pytest.param(True, marks=pytest.mark.long)], ids=["alone", "busy machine"])
def test_a_backlog_of_half_a_minute_is_worked_off_without_a_loss(blocks, tmp_path, busy):
    backlog = list(repeated(blocks, HALF_A_MINUTE))
    with running(tmp_path) as estimator, keep_cores_busy(busy):
        assert estimator.estimate_backlog(backlog) == (HALF_A_MINUTE, 0)


@pytest.mark.long
def test_of_a_backlog_that_is_too_long_the_newest_blocks_are_dropped_and_counted(blocks, tmp_path):
    backlog = list(repeated(blocks, 3 * bus.HIGH_WATER_MARK))
    after = list(repeated(blocks, len(backlog) + 5))[-5:]
    with running(tmp_path) as estimator:
        answered, _ = estimator.estimate_backlog(backlog)
        missing = estimator.estimate(after)[-1].missing_blocks
    assert bus.HIGH_WATER_MARK <= answered < len(backlog)
    assert missing == len(backlog) - answered
