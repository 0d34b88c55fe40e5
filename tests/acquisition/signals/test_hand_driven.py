"""Grasps of a tool without a motor command: found by the travel of its jaws, each once."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.drivers.source import RawBlock
from acquisition.recordings.conditioned_blocks import read_conditioned_blocks
from acquisition.recordings.recording import RecordingSource
from acquisition.sample_block import SampleFlag
from acquisition.signals.grasp_tracker import GraspTracker
from acquisition.signals.pipeline import ConditioningPipeline
from config.load import load_settings, load_tool

PUNCH = load_tool("arthroscopic_punch")
FOLDER = Path(os.environ.get("GRASPWATCH_RECORDINGS", Path(__file__).parents[3] / "../shared/recordings")) / "punch"
NOISE_DEG = 0.26  # one step of the potentiometer
CLOSINGS = {  # counted by eye; the last one of five files is the tool that is laid down
    "empty": 11,
    "medial_collateral_ligament": 24,
    "meniscus_in_knee": 10,
    "meniscus_removed": 20,
    "muscle": 15,
    "patellar_ligament": 16,
    "skin": 12,
}


def follow(encoder_deg: np.ndarray, strain_v: np.ndarray) -> list[tuple[int, int, int]]:
    """Return number, first sample and last sample of each grasp."""
    tracker = GraspTracker(PUNCH.contact, 0.0, PUNCH.hand_driven)
    numbers = []
    for tick, (degrees, volts) in enumerate(zip(encoder_deg.tolist(), strain_v.tolist(), strict=True)):
        flags = tracker.update(tick, float("nan"), volts, degrees, touched=False)
        numbers.append(tracker.grasp.index if flags & SampleFlag.IN_GRASP else 0)
    found = np.array(numbers)
    return [(n, int(np.argmax(found == n)), int(np.flatnonzero(found == n)[-1])) for n in sorted({*numbers} - {0})]


@given(
    depths=st.lists(st.floats(5.0, 12.0), min_size=1, max_size=6),
    duration=st.integers(60, 500),
    left_deg=st.floats(0.0, 0.9),
    squeezes_again=st.booleans(),
    seed=st.integers(0, 99),
)
def test_each_closing_is_one_grasp_however_fast_and_also_if_the_hand_squeezes_twice(
    depths, duration, left_deg, squeezes_again, seed
):
    up = np.linspace(0.0, 1.0, duration)
    again = np.concatenate([1.0 - 0.5 * up, 0.5 + 0.5 * up]) if squeezes_again else np.ones(duration)
    shape = np.concatenate([np.zeros(100), up, again, 1.0 - up, np.zeros(100)])
    travel = np.concatenate([left_deg + (depth - left_deg) * shape for depth in depths])
    travel = np.round((travel + np.random.default_rng(seed).normal(0.0, 0.1, len(travel))) / NOISE_DEG) * NOISE_DEG
    grasps = follow(travel, np.zeros(len(travel)))
    assert [number for number, _, _ in grasps] == [*range(1, len(depths) + 1)]
    for i, (_, begin, end) in enumerate(grasps):
        assert i * len(shape) + 100 < begin < i * len(shape) + 100 + duration
        assert i * len(shape) + 100 + 2 * duration < end < (i + 1) * len(shape)


def test_open_jaws_that_creep_and_tremble_are_no_grasp():
    time = np.arange(4000)
    travel = 1.0 * time / 4000 + 0.5 * np.sin(time / 30.0) + np.random.default_rng(1).normal(0.0, 0.2, len(time))
    assert follow(travel, np.zeros(4000)) == []


def test_the_first_grasp_ends_the_tare():
    travel = np.concatenate([np.zeros(60), np.linspace(0.0, 10.0, 60), np.full(400, 10.0)])
    strain_v = np.concatenate([np.zeros(120), np.full(400, 0.08)])  # a grasp so light that it might be taken for rest
    nothing = np.full(len(travel), np.nan)
    touch = {"touch_1_v": nothing, "touch_2_v": nothing}
    signals = {"strain_v": strain_v, "encoder_deg": travel, "motor_command_v": nothing, **touch}
    pipeline = ConditioningPipeline(PUNCH, load_settings(None).conditioning)
    blocks = [
        pipeline.process(RawBlock(at, 0, {name: values[at : at + 10] for name, values in signals.items()}))
        for at in range(0, len(travel), 10)
    ]
    assert blocks[-1].samples["grasp"][-1] == 1
    assert blocks[-1].samples["jaw_force_n"][-1] == pytest.approx(0.08 * 0.980665, rel=1e-6)


@pytest.mark.parametrize("name", CLOSINGS)
def test_every_closing_of_the_punch_is_found_once(name):
    path = FOLDER / f"{name}_slow.txt.gz"
    if not path.exists():
        pytest.skip(f"no recordings of the punch in {FOLDER}; set GRASPWATCH_RECORDINGS to their folder")
    recording, conditioning = RecordingSource(path, PUNCH), load_settings(None).conditioning
    blocks = read_conditioned_blocks(recording, PUNCH, conditioning, lambda share: None)
    samples = np.concatenate([block.samples for block in blocks])
    assert samples["grasp"].max() == CLOSINGS[name]
    shut = [samples["encoder_deg"][samples["grasp"] == n].max() for n in range(1, CLOSINGS[name] + 1)]
    assert min(shut) > PUNCH.hand_driven.closing_deg
