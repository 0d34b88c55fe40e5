"""The recorder, given what the bus carries in any order that a busy machine may bring."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.notices import RunMetadata
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock
from app.messages.runs import Run, RunState
from app.recordings.mcap_writer import RecordingContext
from app.recordings.recorder import Recorder
from app.recordings.run_reader import read_run
from app.recordings.topics import RUN_TOPIC as RUN_TOPIC
from app.recordings.topics import encode_message
from config.load import load_grasp_protocol, load_library, load_settings, load_tool
from estimator.estimate_block import estimate_dtype
from estimator.estimate_messages import PublishedEstimates

PROTOCOL = load_grasp_protocol("trapezoid_4hz")
RIG = RecordingContext(load_tool("simulated"), load_library("porcine"), load_settings())
BLOCK, BEFORE, RUN, AFTER = 5, 40, 60, 300  # blocks; recording ends with the second after the run, and a grace
TISSUES = len(RIG.library.tissues)


def block(number: int) -> SampleBlock:
    samples = np.zeros(BLOCK, SAMPLE_DTYPE)
    samples["tick"] = np.arange(BLOCK) + (number - 1) * BLOCK
    run = "20261128-120000-001" if BEFORE < number <= BEFORE + RUN else ""
    return SampleBlock(number, number * BLOCK * 1_000_000, 0, samples, run)


def estimated(number: int) -> PublishedEstimates:
    estimates = np.zeros(BLOCK, estimate_dtype(TISSUES))
    estimates["tick"] = block(number).samples["tick"]
    estimates["threshold_n"] = number
    return PublishedEstimates(number, number * BLOCK * 1_000_000, estimates)


@settings(max_examples=25, deadline=None)
@given(leads=st.lists(st.integers(-20, 20), min_size=1, max_size=40))
def test_no_estimate_is_lost_whichever_comes_first(leads: list[int]) -> None:
    """`leads`: by how many blocks the estimates are ahead of the samples, or behind them, in turn."""
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder), RIG)
        recorder.announce_run(RunMetadata("20261128-120000-001", PROTOCOL.model_dump_json(), 1, "liver", None))
        last, told = BEFORE + RUN + AFTER, 0
        for number in range(1, last + 1):
            while told < min(number + leads[number % len(leads)], last):
                told += 1
                recorder.add_estimates(estimated(told))
            recorder.add_samples(block(number))
        assert recorder.file is None
        kept = read_run(Path(folder) / "20261128-120000-001.mcap")
    np.testing.assert_array_equal(kept.estimates["threshold_n"], 1 + kept.samples["tick"] // BLOCK)


RUN_ID = "20261128-120000-001"
BEGUN = Run(
    id=RUN_ID,
    protocol=PROTOCOL.name,
    cycles=1,
    tissue="liver",
    by=None,
    state=RunState.RUNNING,
    started_at="2026-11-28T12:00:00+00:00",
    ended_at=None,
    why=None,
    grasps=0,
)
PATIENCE = 2000  # blocks


@pytest.mark.parametrize("told_after", [None, 1000], ids=["never told", "told five seconds late"])
def test_a_server_that_hangs_leaves_the_end_of_its_run_in_the_file(tmp_path: Path, told_after: int | None) -> None:
    """The acquisition says how it ended; the server, once it is back, tells the grasps, too, and has the last word."""
    recorder = Recorder(tmp_path, RIG)
    recorder.announce_run(RunMetadata(RUN_ID, PROTOCOL.model_dump_json(), 1, "liver", None))
    recorder.add_message(RUN_TOPIC, encode_message(BEGUN))
    for number in range(1, BEFORE + RUN + AFTER + PATIENCE):
        recorder.add_samples(block(number))
        recorder.add_estimates(estimated(number))
        after = number - BEFORE - RUN
        if after == 0:
            recorder.on_run_ended(RUN_ID, RunState.FAILED, "the server was not heard")
        if after == told_after:
            ended = BEGUN.model_copy(update={"state": RunState.FAILED, "why": "told", "grasps": 3})
            recorder.add_message(RUN_TOPIC, encode_message(ended))
        assert (recorder.file is None) == (number <= BEFORE or after > (told_after or 200 + PATIENCE))
    kept = read_run(tmp_path / f"{RUN_ID}.mcap")
    assert kept.run.state is RunState.FAILED
    assert (kept.run.why, kept.run.grasps) == (("told", 3) if told_after else ("the server was not heard", 0))
    assert len(kept.samples) == BLOCK * (BEFORE + RUN + 200)
