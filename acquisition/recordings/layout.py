"""What stands in an MCAP file of ours, beside its samples: topics, columns, version, the names of what is attached."""

import math
from collections.abc import Mapping

import numpy as np

from acquisition.blocks import SAMPLE, Flag, SampleBlock
from acquisition.recordings.rows import Column, RowLayout

PROFILE = "graspwatch"
FORMAT_VERSION = 1
ABOUT = "graspwatch"  # the metadata record that says what was recorded
ENDED = "graspwatch_end"  # the one that says how it ended; a file that was cut off has none
TOOL, LIBRARY, SETTINGS, PROTOCOL, VERSIONS = "tool.json", "library.json", "settings.json", "protocol.json", "versions"

RAW, CONDITIONED, ESTIMATES = "/raw", "/conditioned", "/estimates"

SIGNALS = ("strain_v", "encoder_deg", "motor_command_v", "touch_1_v", "touch_2_v")
LIMITER_FLAGS = Flag.HELD_BACK | Flag.LET_GO  # what the acquisition's limiter did is no function of the signals
LIMIT = "limit_n"  # nor is what it enforced; files of older versions do not say it

RAW_ROWS = RowLayout(
    "Raw",
    [
        Column("tick", "i8"),
        *(Column(name) for name in SIGNALS),
        Column("limiter_flags", "u4"),
        Column("lost_samples", "u4"),
        Column(LIMIT),
    ],
)
CONDITIONED_NAMES = tuple(name for name in SAMPLE.names if name not in (*SIGNALS, LIMIT))
CONDITIONED_ROWS = RowLayout(
    "Conditioned", [Column(name, "u4" if name == "flags" else SAMPLE[name].str[1:]) for name in CONDITIONED_NAMES]
)


def raw_columns(block: SampleBlock) -> dict[str, np.ndarray]:
    """The columns of `RAW_ROWS`; what was lost was lost before the block's first sample."""
    samples = block.samples
    lost_samples = np.zeros(len(samples), "u4")
    lost_samples[0] = block.lost_samples
    flags = samples["flags"] & np.uint16(LIMITER_FLAGS)
    of_limiter = {"limiter_flags": flags, "lost_samples": lost_samples}
    return {name: samples[name] for name in ("tick", *SIGNALS, LIMIT)} | of_limiter


def conditioned_columns(block: SampleBlock) -> Mapping[str, np.ndarray]:
    """The columns of `CONDITIONED_ROWS`."""
    return {name: block.samples[name] for name in CONDITIONED_NAMES}


def samples_of(raw: Mapping[str, np.ndarray], conditioned: Mapping[str, np.ndarray]) -> np.ndarray:
    """The samples, dtype SAMPLE, that both kinds of rows were made of; no limit where the rows do not say it."""
    samples = np.empty(len(raw["tick"]), SAMPLE)
    for name in SIGNALS:
        samples[name] = raw[name]
    samples[LIMIT] = raw.get(LIMIT, math.nan)
    for name in CONDITIONED_NAMES:
        samples[name] = conditioned[name]
    return samples
