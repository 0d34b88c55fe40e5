"""Layout of Graspwatch's MCAP files (topics, columns, version, names), and functions between samples and columns."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from acquisition.recordings.protobuf_rows import ColumnSpec, RowLayout
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock, SampleFlag
from acquisition.signal_table import SIGNALS, list_numbered_names

PROFILE = "graspwatch"
FORMAT_VERSION = 1
RECORDED_AT_METADATA = "recorded_at"  # of an import: the time of its first sample by its log, ISO 8601
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
SESSION_ATTACHMENT = "session.json"
MANIFEST_ATTACHMENT = "manifest.json"
REFERENCE_ATTACHMENT = "reference.json"  # the reference grasp of the day; a file without one lacks it

RAW_TOPIC, CONDITIONED_TOPIC, ESTIMATES_TOPIC = "/raw", "/conditioned", "/estimates"

# Not a function of the signals, so they are recorded.
LIMITER_FLAGS = SampleFlag.LIMITED | SampleFlag.RELEASED | SampleFlag.NEW_SPOT
_RAW_FIELDS = {"limiter_flags": 7, "lost_samples": 8}  # beside the signals

_TYPE_CODES = {signal.name: signal.dtype.replace("u2", "u4") for signal in SIGNALS} | dict.fromkeys(_RAW_FIELDS, "u4")
_RAW_NUMBERS = [(signal.raw, signal.name) for signal in SIGNALS] + [(n, name) for name, n in _RAW_FIELDS.items()]
_CONDITIONED_NUMBERS = [(signal.conditioned, signal.name) for signal in SIGNALS]
RAW_LAYOUT = RowLayout(
    "Raw", [ColumnSpec(name, _TYPE_CODES[name]) for name in list_numbered_names("raw", _RAW_NUMBERS)]
)
CONDITIONED_COLUMNS = list_numbered_names("conditioned", _CONDITIONED_NUMBERS)
CONDITIONED_LAYOUT = RowLayout("Conditioned", [ColumnSpec(name, _TYPE_CODES[name]) for name in CONDITIONED_COLUMNS])
RAW_SIGNALS = tuple(signal for signal in SIGNALS if signal.raw is not None)
OPTIONAL_COLUMNS = {signal.name for signal in RAW_SIGNALS if signal.optional}


def raw_columns(samples: np.ndarray, lost_samples: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of `RAW_LAYOUT`; `lost_samples`, (n,), counts those lost right before each sample."""
    flags = samples["flags"] & np.uint16(LIMITER_FLAGS)
    of_limiter = {"limiter_flags": flags, "lost_samples": lost_samples}
    return {signal.name: samples[signal.name] for signal in RAW_SIGNALS} | of_limiter


def conditioned_columns(samples: np.ndarray) -> dict[str, np.ndarray]:
    """Return the conditioned signals by name: the values for rows of `CONDITIONED_LAYOUT`."""
    return {name: samples[name] for name in CONDITIONED_COLUMNS}


def count_lost_before(blocks: Sequence[SampleBlock]) -> np.ndarray:
    """Return for each sample of consecutive blocks how many were lost right before it, (n,)."""
    lengths = [len(block.samples) for block in blocks]
    lost_samples = np.zeros(sum(lengths), "u4")
    lost_samples[np.cumsum([0, *lengths[:-1]])] = [block.lost_samples for block in blocks]
    return lost_samples


def samples_from_columns(raw: Mapping[str, np.ndarray], conditioned: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return samples of dtype SAMPLE_DTYPE from both kinds of rows; an optional signal that they lack is NaN."""
    samples = np.empty(len(raw["tick"]), SAMPLE_DTYPE)
    for signal in RAW_SIGNALS:
        samples[signal.name] = raw.get(signal.name, math.nan) if signal.optional else raw[signal.name]
    for name in CONDITIONED_COLUMNS:
        samples[name] = conditioned[name]
    return samples
