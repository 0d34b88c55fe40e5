"""The acquisition's output: blocks of calibrated, conditioned and segmented samples."""

from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from acquisition.safety_state_machine import Safety
from acquisition.signal_table import SIGNALS


class SampleFlag(IntFlag):
    """Properties of one sample, as bits."""

    INVALID = 1  # outside the domain of Eqs. (1) to (6): no jaw signals
    SATURATED = 2  # strain gage at the end of its range
    IN_GRASP = 4  # the command has left zero
    CONTACT = 8  # tissue is held
    CONTACT_SENSED = 16  # contact comes from a trusted touch sensor
    JAWS_CLOSED = 32  # the force rises without motion: the jaws are shut, and the tissue gives no more information
    ENCODER_SLIPS = 64  # the encoder lags behind the cable's stretch, or its zero drifts between grasps
    FILTERED_INVALID = 128  # as INVALID, for the filtered signals alone
    LIMITED = 256  # the limiter keeps the command lower than the protocol asks for
    RELEASED = 512  # the force passed the limit: the command is zero until the protocol's next grasp
    NEW_SPOT = 1024  # the operator begins a new spot at this sample


SAMPLE_DTYPE = np.dtype([(signal.name, signal.dtype) for signal in SIGNALS])


def dtype_field_names(dtype: np.dtype) -> tuple[str, ...]:
    """Return the names of a structured dtype's fields, in order."""
    assert dtype.names is not None
    return dtype.names


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples: `samples` of dtype SAMPLE_DTYPE and shape (n,).

    `sequence` numbers the blocks, so that a receiver detects gaps. `lost_samples` counts the samples lost right before
    the first one, `backlog` the samples after the last one that waited to be read. `run` names the run, empty between
    runs; the first block of a run resets every stage. `safety` is the state after the block, and `why` the reason for a
    fault or a failed self-test.
    """

    sequence: int
    t_mono_ns: int
    lost_samples: int
    samples: np.ndarray
    run: str = ""
    safety: Safety = Safety.DISARMED
    why: str = ""
    backlog: int = 0
