"""What the acquisition publishes: blocks of calibrated, conditioned and segmented samples."""

from dataclasses import dataclass
from enum import IntFlag

import numpy as np

from acquisition.safety_state_machine import Safety


class SampleFlag(IntFlag):
    """What is known of one sample."""

    INVALID = 1  # outside the domain of Eqs. (1) to (6): no jaw signals
    SATURATED = 2  # strain gage at the end of its range
    IN_GRASP = 4  # the command has left zero
    CONTACT = 8  # tissue is held
    CONTACT_SENSED = 16  # a trusted touch sensor says so
    JAWS_CLOSED = 32  # the force rises without motion: not tissue any more
    ENCODER_SLIPS = 64  # the encoder lags behind the cable's stretch or walks between grasps
    FILTERED_INVALID = 128  # as INVALID, of the filtered signals alone
    LIMITED = 256  # the limiter keeps the command lower than the protocol asks for
    RELEASED = 512  # the force passed the limit: no command until the protocol's next grasp


SAMPLE_DTYPE = np.dtype(
    [
        ("tick", "i8"),
        ("strain_v", "f8"),  # as read
        ("encoder_deg", "f8"),  # as read
        ("motor_command_v", "f8"),  # read back
        ("touch_1_v", "f8"),
        ("touch_2_v", "f8"),
        ("jaw_force_n", "f8"),  # unfiltered: what the filters and the limiter take
        ("jaw_displacement_m", "f8"),
        ("newton_per_volt", "f8"),  # how strain noise enters both
        ("metre_per_volt", "f8"),
        ("jaw_force_filtered_n", "f8"),  # after the Butterworth filter: what people look at
        ("jaw_displacement_filtered_m", "f8"),
        ("tissue_displacement_m", "f8"),  # since contact; NaN while nothing is held
        ("limit_n", "f8"),  # under which the limiter held the force meanwhile; NaN where nothing limits it
        ("grasp", "i8"),  # 1, 2, ...; 0 before the first
        ("grasp_start_tick", "i8"),  # where the command left zero; -1 before the first
        ("contact_tick", "i8"),  # -1 while nothing is held
        ("wall_tick", "i8"),  # where the jaws were shut; -1 while they are not
        ("flags", "u2"),
    ]
)


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples, `samples` of dtype SAMPLE and shape (n,).

    `lost_samples` went missing right before the first one; `sequence` counts blocks, so that a receiver sees gaps.
    `run` says which run they belong to; empty between runs. With a run's first block everything begins anew: nothing of
    the samples before it has part in what is made of it. `safety` says where the tool stands after them, and `why` it
    is faulted or was not armed. `backlog` counts the samples after these that waited to be read.
    """

    sequence: int
    t_mono_ns: int
    lost_samples: int
    samples: np.ndarray
    run: str = ""
    safety: Safety = Safety.DISARMED
    why: str = ""
    backlog: int = 0
