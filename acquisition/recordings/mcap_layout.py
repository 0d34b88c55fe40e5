"""Layout of Graspwatch's MCAP files: topics, columns, format version, names of attachments and metadata."""

import math
from collections.abc import Mapping

import numpy as np

from acquisition.recordings.protobuf_rows import Column, RowLayout
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock, SampleFlag, field_names

PROFILE = "graspwatch"
FORMAT_VERSION = 1
METADATA_NAME = "graspwatch"  # the metadata record that describes the run
END_METADATA_NAME = (
    "graspwatch_end"  # the metadata record that describes the run's end; a file that was cut off has none
)
TOOL_ATTACHMENT, LIBRARY_ATTACHMENT, SETTINGS_ATTACHMENT, PROTOCOL_ATTACHMENT, VERSIONS_METADATA_NAME = (
    "tool.json",
    "library.json",
    "settings.json",
    "protocol.json",
    "versions",
)

RAW_TOPIC, CONDITIONED_TOPIC, ESTIMATES_TOPIC = "/raw", "/conditioned", "/estimates"

SIGNAL_COLUMNS = ("strain_v", "encoder_deg", "motor_command_v", "touch_1_v", "touch_2_v")
# Not a function of the signals, so they are recorded.
LIMITER_FLAGS = SampleFlag.LIMITED | SampleFlag.RELEASED
LIMIT_COLUMN = "limit_n"  # as the flags, no function of the signals; files of older versions lack it

RAW_LAYOUT = RowLayout(
    "Raw",
    [
        Column("tick", "i8"),
        *(Column(name) for name in SIGNAL_COLUMNS),
        Column("limiter_flags", "u4"),
        Column("lost_samples", "u4"),
        Column(LIMIT_COLUMN),
    ],
)
CONDITIONED_COLUMNS = tuple(name for name in field_names(SAMPLE_DTYPE) if name not in (*SIGNAL_COLUMNS, LIMIT_COLUMN))
CONDITIONED_LAYOUT = RowLayout(
    "Conditioned",
    [Column(name, "u4" if name == "flags" else SAMPLE_DTYPE[name].str[1:]) for name in CONDITIONED_COLUMNS],
)


def raw_columns(block: SampleBlock) -> dict[str, np.ndarray]:
    """Return the columns of `RAW_LAYOUT`; the first row counts the samples lost before the block."""
    samples = block.samples
    lost_samples = np.zeros(len(samples), "u4")
    lost_samples[0] = block.lost_samples
    flags = samples["flags"] & np.uint16(LIMITER_FLAGS)
    of_limiter = {"limiter_flags": flags, "lost_samples": lost_samples}
    return {name: samples[name] for name in ("tick", *SIGNAL_COLUMNS, LIMIT_COLUMN)} | of_limiter


def conditioned_columns(block: SampleBlock) -> Mapping[str, np.ndarray]:
    """Return a block's conditioned signals by name: the values for rows of `CONDITIONED_LAYOUT`."""
    return {name: block.samples[name] for name in CONDITIONED_COLUMNS}


def from_columns(raw: Mapping[str, np.ndarray], conditioned: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return samples of dtype SAMPLE_DTYPE from both kinds of rows; the limit is NaN where the rows lack it."""
    samples = np.empty(len(raw["tick"]), SAMPLE_DTYPE)
    for name in SIGNAL_COLUMNS:
        samples[name] = raw[name]
    samples[LIMIT_COLUMN] = raw.get(LIMIT_COLUMN, math.nan)
    for name in CONDITIONED_COLUMNS:
        samples[name] = conditioned[name]
    return samples
