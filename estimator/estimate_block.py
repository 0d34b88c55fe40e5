"""The estimator's output: estimates for each sample, the identification so far, and finished grasps."""

import functools
import math
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from acquisition.sample_block import dtype_field_names
from estimator.force_alarms import ForceAlarm


@functools.cache
def estimate_dtype(tissues: int) -> np.dtype:
    """Return the dtype of one sample's estimates for all tissues.

    A value is NaN without an estimate: no tissue held, jaws shut, or filter diverged.
    """
    each = (tissues,)
    return np.dtype(
        [
            ("tick", "i8"),
            ("probability", "f8", each),
            ("probability_unknown", "f8"),
            ("threshold_n", "f8"),  # threshold in force, for the force alarms
            ("force_n", "f8", each),  # alpha (exp(beta x) - 1) of each tissue's likelier filter
            ("alpha_n", "f8", each),
            ("beta_per_m", "f8", each),
            ("damping_kg_per_s", "f8", each),
            ("log_sd", "f8", (tissues, 3)),  # SD of log alpha, log beta, log d
            ("nis", "f8", each),  # running mean normalized innovation squared of the likelier filter; 1 if it fits
        ]
    )


def blank_estimates(dtype: np.dtype, ticks: np.ndarray) -> np.ndarray:
    """Return rows for these ticks with NaN in every other column."""
    rows = np.empty(len(ticks), dtype)
    rows["tick"] = ticks
    for name in dtype_field_names(dtype)[1:]:
        rows[name] = np.nan
    return rows


class SpotVerdict(BaseModel):
    """The answer for a spot, from the finished grasps on it; None means no value."""

    model_config = ConfigDict(frozen=True)

    index: int = Field(description="1, 2, ... in a run")
    grasps: tuple[int, ...] = Field(description="Grasps that the answer is from; those without an answer are left out")
    label: str = Field(description="A tissue's name, `unknown`, `undecided` or `no_answer`")
    probability: float | None
    probabilities: dict[str, float]
    began_s: float = Field(description="Seconds since the first sample of the run or recording")
    dose_n_s: float | None = Field(
        default=None, description="Displayed force over time, N s, summed over all finished grasps on it"
    )


class IdentificationResult(BaseModel):
    """The answer for the current grasp at `tick`; None means no value."""

    model_config = ConfigDict(frozen=True)

    tick: int
    grasp: int = Field(description="0 before the first grasp")
    in_grasp: bool
    in_contact: bool
    label: str = Field(description="A tissue's name, `unknown`, `undecided` or `no_answer`")
    probability: float | None
    probabilities: dict[str, float]
    time_to_decision_s: float | None
    force_n: float | None
    peak_force_n: float | None
    threshold_n: float = Field(description="Injury threshold in force, for force alarms; no limit of the motor")
    threshold_tissue: str | None = Field(description="Tissue of this threshold; null: the library's lowest one applies")
    limit_n: float | None = Field(description="Limit that the limiter enforces; null: no limit is enforced")
    holding_back: bool = Field(description="Whether the limiter keeps the command lower than the protocol asks for")
    time_to_limit_s: float | None = Field(description="Until the force reaches the limit; null unless it rises")
    thickness_m: float | None = Field(description="Thickness of the tissue, where the tool can measure it at contact")
    convergence_s: dict[str, float | None]
    force_error_n: dict[str, float | None]
    spots: tuple[SpotVerdict, ...] = Field(
        default=(), description="Verdicts of the spots so far; the last one may be of a spot without a grasp yet"
    )
    nis: dict[str, float | None] = Field(
        default_factory=dict,
        description="Normalized innovation squared of each tissue's filter, mean of its last 20 samples: about 1 where "
        "it follows the grasp; null: no estimate",
    )
    dose_n_s: float | None = Field(
        default=None, description="Displayed force over the time in contact, N s, of the grasp under way or the last"
    )
    spot_dose_n_s: float | None = Field(
        default=None, description="The same of all grasps on this spot, with the one under way"
    )


class GraspRecord(BaseModel):
    """A finished grasp. Times are in seconds since the source's first sample; None means no value."""

    model_config = ConfigDict(frozen=True)

    index: int
    start_s: float
    contact_s: float | None
    end_s: float
    label: str = Field(description="A tissue's name, `unknown`, `undecided` or `no_answer`")
    probability: float | None
    probabilities: dict[str, float]
    time_to_decision_s: float | None
    alpha_n: float | None
    beta_per_m: float | None
    damping_kg_per_s: float | None
    peak_force_n: float | None
    peak_displacement_m: float | None
    convergence_s: dict[str, float | None]
    force_error_n: dict[str, float | None]
    valid: bool
    why_invalid: str | None
    held_back: bool = Field(description="Whether the limiter kept the command lower than the protocol asks for")
    peak_share_of_limit: float | None = Field(
        default=None,
        description="Highest ratio of the force to the limit enforced at that time; null: no limit was enforced",
    )
    dose_n_s: float | None = Field(
        default=None,
        description="Displayed force over the time in contact, N s; null: no contact, or an earlier version",
    )
    time_above_s: dict[str, float] = Field(
        default_factory=dict,
        description="Time for which the force was at or above each warning's share of the threshold in force, s",
    )
    log_sd: dict[str, float] = Field(
        default_factory=dict, description="Standard deviation of log alpha, log beta and log d; empty: no estimate"
    )
    nis: dict[str, float | None] = Field(
        default_factory=dict, description="Normalized innovation squared of each tissue's filter at the grasp's end"
    )


@dataclass(frozen=True, slots=True)
class LabelWithdrawal:
    """Withdrawal of a grasp's label. `probability` is the label's present probability.

    `why` is the reason why the grasp is invalid; None if further samples changed the answer.
    """

    tick: int
    grasp: int
    label: str
    probability: float
    why: str | None


@dataclass(frozen=True, slots=True)
class EstimateBlock:
    """Estimates for one sample block; `estimates` has one row for each of its samples."""

    sequence: int
    t_mono_ns: int
    lost_samples: int
    estimates: np.ndarray
    identification: IdentificationResult
    ended: tuple[GraspRecord, ...]
    alarms: tuple[ForceAlarm, ...]
    withdrawn: tuple[LabelWithdrawal, ...] = ()


def finite_or_none(value: float) -> float | None:
    """Return the value, or None for NaN and infinity."""
    return float(value) if math.isfinite(value) else None
