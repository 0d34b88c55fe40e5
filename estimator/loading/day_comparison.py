"""Compare a source with the recordings of a learned library, which may be of other days."""

import math
from collections.abc import Sequence

import numpy as np

from config.schema import LearnedRecording, SourceConditions, TissueLibrary, is_same_day
from estimator.loading.constants import FEATURES, OPENING_UNIT_DEG, REFERENCE_STALL_SD
from estimator.loading.loading_curve import OPENING, STALL


def compute_shift(source: SourceConditions, learned: SourceConditions) -> np.ndarray | None:
    """Return what to add to a learned center, (F,), so that it describes grasps of the source's day.

    Reference grasps of both days give it. Without them, nothing changes within one day. None: other days, whose stalls
    cannot be compared.
    """
    now, then = source.reference, learned.reference
    shift = np.zeros(len(FEATURES))
    if now and then and now.is_comparable(then):
        shift[STALL] = math.log(now.stall_v / then.stall_v)
        shift[OPENING] = (now.opening_deg - then.opening_deg) / OPENING_UNIT_DEG
        return shift
    return shift if is_same_day(source.recorded_at, learned.recorded_at) else None


def find_incomparable(source: SourceConditions, library: TissueLibrary) -> list[LearnedRecording]:
    """Return the learned recordings of other days that no reference grasps link with the source."""
    learned = (r for t in library.tissues.values() if t.learned for r in t.learned.recordings)
    return [each for each in learned if compute_shift(source, each.conditions) is None]


def align_centers(source: SourceConditions, recordings: Sequence[LearnedRecording]) -> tuple[np.ndarray, np.ndarray]:
    """Return the centers (R, F) for the source's day, and the variance (F,) that each prediction has in addition.

    The variance is that of the stall between days, unless it is comparable with all recordings.
    """
    shifts = [compute_shift(source, each.conditions) for each in recordings]
    variance = np.zeros(len(FEATURES))
    if any(each is None for each in shifts):
        variance[STALL] = REFERENCE_STALL_SD**2
    pairs = zip(recordings, shifts, strict=True)
    return np.array([np.add(each.centre, 0.0 if shift is None else shift) for each, shift in pairs]), variance
