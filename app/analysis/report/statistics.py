"""Functions that compute statistics of a set of grasps as in the paper: Tables VI and VII, Fig. 8, Tukey's test."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations

import numpy as np
from scipy.stats import tukey_hsd

from estimator.decision import NOT_NAMED, UNKNOWN
from estimator.estimate_block import GraspRecord

SIGNIFICANCE_LEVEL = 0.05  # the paper's p
DIVERGENCE_FACTOR = 100.0  # force error by peak force from which a filter has diverged
MIN_GROUP_GRASPS = 2  # fewer grasps have no spread
PARAMETERS = {
    "alpha": "alpha_n",
    "beta": "beta_per_m",
    "d": "damping_kg_per_s",
}  # the paper's name: field of `GraspRecord`


class TruthSource(StrEnum):
    """The source that states which tissue was held."""

    LABEL = "the label given with the file"
    RECORDING = "the recording"
    VERDICT = "the verdict"


@dataclass(frozen=True, slots=True)
class Observation:
    """One grasp for the statistics. `truth`: the tissue that was held, None where only the verdict tells it.

    `force_errors_n`: each filter's lowest and highest force error (estimated less measured), N.
    """

    source: str
    record: GraspRecord
    truth: str | None
    truth_source: TruthSource
    force_errors_n: dict[str, tuple[float, float] | None]

    @property
    def group(self) -> str:
        return self.truth or self.record.label

    @property
    def filter_tissue(self) -> str:
        """The tissue whose filter the paper's criteria use: the group itself, or else the likeliest tissue."""
        likely = {name: self.record.probabilities.get(name, 0.0) for name in self.record.convergence_s}
        return self.group if self.group in likely else max(likely, key=likely.__getitem__)

    @property
    def convergence_s(self) -> float | None:
        return self.record.convergence_s[self.filter_tissue]

    @property
    def diverged(self) -> bool:
        """Whether the filter's force error is so large that its values mean nothing."""
        errors = [self.record.force_error_n[self.filter_tissue], *(self.force_errors_n.get(self.filter_tissue) or ())]
        most_n = DIVERGENCE_FACTOR * (self.record.peak_force_n or 0.0)
        return any(abs(error) > most_n for error in errors if error is not None)

    @property
    def force_error_n(self) -> float | None:
        """Mean force error over the grasp, N; None where the filter diverged."""
        return None if self.diverged else self.record.force_error_n[self.filter_tissue]

    @property
    def sample_errors_n(self) -> tuple[float, float] | None:
        """Lowest and highest force error of a sample, N; None where the filter diverged."""
        return None if self.diverged else self.force_errors_n.get(self.filter_tissue)

    @property
    def parameters(self) -> tuple[float, float, float] | None:
        """Parameters alpha N, beta 1/m, d kg/s at the grasp's end; None unless all three are known and positive."""
        values = tuple(getattr(self.record, name) for name in PARAMETERS.values())
        return None if None in values or min(values) <= 0 else values

    def exclusion_reason(self) -> str | None:
        """Return why the statistics leave the grasp out, or None."""
        if not self.record.valid:
            return f"invalid: {self.record.why_invalid or 'not said why'}"
        if self.parameters is None:
            return "no filter had an estimate at its end"
        if self.group in NOT_NAMED:
            return "no tissue was named, and none is told"
        return None


@dataclass(frozen=True, slots=True)
class ValueSummary:
    """Largest, mean and smallest of some values; None if there are no values."""

    largest: float | None
    mean: float | None
    smallest: float | None
    count: int

    @classmethod
    def from_values(cls, values: Iterable[float | None]) -> "ValueSummary":
        """Summarize the values that are not None."""
        there = [value for value in values if value is not None]
        return cls(max(there), float(np.mean(there)), min(there), len(there)) if there else cls(None, None, None, 0)


@dataclass(frozen=True, slots=True)
class ConvergenceSummary:
    """A group's row of Table VI. `error_n` is over the grasps' means, `sample_error_n` over single samples."""

    grasps: int
    convergence_s: ValueSummary
    error_n: ValueSummary
    sample_error_n: ValueSummary


@dataclass(frozen=True, slots=True)
class ParameterSummary:
    """A group's cell of Table VII. `log_sd`: SD of the logarithm, None for a single grasp."""

    mean: float
    geometric_mean: float
    log_sd: float | None


@dataclass(frozen=True, slots=True)
class GroupComparison:
    """One parameter compared between two groups: ratio of geometric means with its 95 % interval, and p."""

    ratio: float
    low: float
    high: float
    p: float

    @property
    def differs(self) -> bool:
        return self.p < SIGNIFICANCE_LEVEL


@dataclass(frozen=True, slots=True)
class TukeyTest:
    """Tukey's honestly significant differences for one parameter, by pair of groups.

    `skip_reason`: a sentence if there are no pairs. `too_small_groups`: groups that could not take part.
    """

    pairs: dict[tuple[str, str], GroupComparison]
    too_small_groups: tuple[str, ...] = ()
    skip_reason: str | None = None


@dataclass(frozen=True, slots=True)
class Statistics:
    """Statistics of a report's grasps. `groups` and `log_parameters` (n, 3) by name, in the library's order."""

    truth_sources: tuple[TruthSource, ...]
    groups: dict[str, list[Observation]]
    log_parameters: dict[str, np.ndarray]
    excluded: list[tuple[Observation, str]]
    convergence: dict[str, ConvergenceSummary]
    parameters: dict[str, dict[str, ParameterSummary]]
    tukey: dict[str, TukeyTest]

    def find_distinguishing_parameters(self) -> dict[tuple[str, str], list[str]]:
        """Return the parameters that differ significantly between the groups of each pair."""
        pairs = dict.fromkeys(pair for one in self.tukey.values() for pair in one.pairs)
        return {
            pair: [name for name, one in self.tukey.items() if pair in one.pairs and one.pairs[pair].differs]
            for pair in pairs
        }


def compute_statistics(observations: list[Observation], tissues: Iterable[str]) -> Statistics:
    """Return the statistics of grasps, grouped by what was held; the library's `tissues` come first, in their order."""
    left_out = [(one, why) for one in observations if (why := one.exclusion_reason())]
    kept = [one for one in observations if one.exclusion_reason() is None]
    names = {one.group for one in kept}
    order = [name for name in (*tissues, *sorted(names - {*tissues, UNKNOWN}), UNKNOWN) if name in names]
    groups = {name: [one for one in kept if one.group == name] for name in order}
    values = {name: np.log([one.parameters for one in group if one.parameters]) for name, group in groups.items()}
    return Statistics(
        tuple(dict.fromkeys(one.truth_source for one in kept)),
        groups,
        values,
        left_out,
        {name: _summarize_convergence(group) for name, group in groups.items()},
        {name: _summarize_parameters(logs) for name, logs in values.items()},
        {
            name: run_tukey_test({group: logs[:, k] for group, logs in values.items()})
            for k, name in enumerate(PARAMETERS)
        },
    )


def _summarize_convergence(group: list[Observation]) -> ConvergenceSummary:
    ranges = [errors for one in group if (errors := one.sample_errors_n)]
    means = ValueSummary.from_values(one.force_error_n for one in group)
    samples = ValueSummary.from_values([low for low, _ in ranges] + [high for _, high in ranges])
    return ConvergenceSummary(
        len(group),
        ValueSummary.from_values(one.convergence_s for one in group),
        means,
        ValueSummary(samples.largest, means.mean, samples.smallest, len(ranges)),
    )


def _summarize_parameters(logs: np.ndarray) -> dict[str, ParameterSummary]:
    several = len(logs) >= MIN_GROUP_GRASPS
    return {
        name: ParameterSummary(
            float(np.exp(logs[:, k]).mean()),
            float(np.exp(logs[:, k].mean())),
            float(logs[:, k].std(ddof=1)) if several else None,
        )
        for k, name in enumerate(PARAMETERS)
    }


def run_tukey_test(logs: dict[str, np.ndarray]) -> TukeyTest:
    """Return Tukey's test (Tukey-Kramer for unequal groups) of a parameter's logarithms, (n,) for each group.

    The test assumes that all groups scatter alike, and specimens scatter by factors, hence logarithms. Bladder's alpha
    is a hundredth of the others': as plain numbers, its whole spread would vanish in liver's.
    """
    large = {name: values for name, values in logs.items() if len(values) >= MIN_GROUP_GRASPS}
    too_small = tuple(name for name in logs if name not in large)
    if len(large) < 2:
        return TukeyTest({}, too_small, "Nothing to compare: it takes two groups of two grasps or more.")
    if not any(np.ptp(values) > 0 for values in large.values()):
        return TukeyTest({}, too_small, "Nothing to compare: within each group all values are the same.")
    result = tukey_hsd(*large.values())
    interval = result.confidence_interval(1 - SIGNIFICANCE_LEVEL)
    pairs = {}
    for (i, one), (j, other) in combinations(enumerate(large), 2):
        ratio, low, high = np.exp([result.statistic[i, j], interval.low[i, j], interval.high[i, j]]).tolist()
        pairs[one, other] = GroupComparison(ratio, low, high, float(result.pvalue[i, j]))
    return TukeyTest(pairs, too_small)
