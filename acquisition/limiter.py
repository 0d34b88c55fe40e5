"""What stops the motor, judged at every block from unfiltered force; nobody is waited for."""

import numpy as np

from acquisition.blocks import Flag
from config.schema import ToolLimits

INVALID, SATURATED, IN_GRASP = Flag.INVALID.value, Flag.SATURATED.value, Flag.IN_GRASP.value


def why_stop(limits: ToolLimits, samples: np.ndarray) -> str | None:
    """Why the motor must not go on after these samples, or None.

    The mean of a block is judged, so that one spike of the strain gage does not end a grasp; a force that cannot be
    known (strain gage saturated, jaws in a grasp outside the domain of Eqs. (1) to (6)) counts as too large.
    """
    flags, force_n = samples["flags"], samples["jaw_force_n"]
    mean_n = float(np.add.reduce(force_n)) / len(samples)
    if mean_n <= limits.force_ceiling_n and not (flags & SATURATED).any():
        return None
    if (flags & SATURATED).all():
        return "the strain gage is saturated: the force is not known"
    if (flags & (INVALID | IN_GRASP) == INVALID | IN_GRASP).all():
        return "the jaws are outside the range of Eqs. (1) to (6): the force is not known"
    known = np.isfinite(force_n)
    mean_n = float(force_n[known].mean()) if known.any() else 0.0
    if mean_n > limits.force_ceiling_n:
        return f"force {mean_n:.2f} N is over the ceiling of {limits.force_ceiling_n:.2f} N"
    return None
