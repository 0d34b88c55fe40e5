"""Functions that compute the share of right answers that a grasp's samples allow, from their Fisher information.

An ideal observer knows each specimen's log alpha, log beta and log d up to the Cramér-Rao bound of the samples so far.
It combines this estimate with the library's spreads. The contact is known where a sensor detects it. If it is not, the
zero of the displacement is one more unknown without a prior, whose uncertainty the bound contains. A fold's preload has
its stated prior in either case. Thickness counts for tissue that the jaws take whole.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from acquisition.simulation.tissue import NO_DEVIATION
from config.schema import TissueLibrary, Tool
from estimator.constants import GRASP_SCATTER_LOG_SD
from estimator.filter_bank import ContactStart, FilterBank, TissuePriors, bank_columns, build_filter_tunings
from estimator.kalman_filter import LOG_ALPHA, LOG_MASS, OFFSET, PARAMETERS, FilterNoise, X
from estimator.studies.answer_course import StudyConditions, StudySetup, load_study_setup
from estimator.studies.posterior_mode import compute_innovations
from estimator.studies.simulated_grasps import GraspCase, SimulatedGrasp, extract_contact_samples, simulate_grasp
from estimator.studies.study_report import KeyFigure

DIFFERENCE_STEPS = np.array([1e-4, 1e-4, 1e-4, 1e-8])  # of log alpha, log beta, log d, and of the zero, m
NO_INFORMATION = np.diag([1e-6, 1e-6, 1e-6, 1.0 / 0.02**2])  # the zero lies within the jaws' travel
FIRST_COMPRESSION_M = 15e-6  # the jaws move by 30 µm between two samples, so contact is half of that away
OBSERVATIONS = 64  # noisy estimates drawn for each specimen, so that the limit scatters by the specimens alone
_OBSERVATION_NOISE = np.random.default_rng(20261130).standard_normal((OBSERVATIONS, 3))


@dataclass(frozen=True, slots=True)
class KnowledgeLimit:
    """Probability that an ideal observer names one grasp's tissue right.

    `exact` is for exactly known parameters. `sensed` and `unsensed`, (times,), are for the samples up to each time,
    with contact sensed and not.
    """

    exact: float
    sensed: np.ndarray
    unsensed: np.ndarray


def compute_case_limit(
    bench: StudyConditions, case: GraspCase, times_s: tuple[float, ...], grasp: SimulatedGrasp | None = None
) -> KnowledgeLimit:
    """Return the limits of one simulated grasp at times after contact.

    `grasp` is the case's if its contact is sensed and nothing deviates; otherwise it is simulated anew so.
    """
    touching = replace(bench, touch=True)
    lab = load_study_setup(touching)
    if grasp is None or bench != touching or case.deviation != NO_DEVIATION:
        case = replace(case, deviation=NO_DEVIATION)
        grasp = simulate_grasp(lab.tool, lab.library, lab.settings.conditioning, lab.protocol, case)
    information = _compute_grasp_information(lab, grasp)
    at = [min(round(time * lab.tool.board.sample_rate_hz), len(information)) - 1 for time in times_s]
    thickness_m = _find_thickness_evidence(bench, case, grasp)
    common = lab.library, case.tissue, grasp.specimen.log_parameters
    return KnowledgeLimit(
        exact=_share_right(*common, np.zeros((3, 3)), thickness_m if bench.touch else None),
        sensed=np.array([_share_right(*common, _bound(each[:3, :3]), thickness_m) for each in information[at]]),
        unsensed=np.array([_share_right(*common, _bound(each)[:3, :3], None) for each in information[at]]),
    )


def compute_spot_limit(
    bench: StudyConditions, case: GraspCase, grasps: list[SimulatedGrasp], decide_at: float
) -> float:
    """Return the probability that an ideal observer names the tissue of a spot from all grasps on it.

    It knows that grasps scatter about the spot by `GRASP_SCATTER_LOG_SD`. Contact is sensed, and nothing deviates.
    """
    lab = load_study_setup(bench)
    held = np.array([grasp.specimen.log_parameters for grasp in grasps])
    scatter = np.diag(GRASP_SCATTER_LOG_SD**2)
    bounds = [_bound(_compute_grasp_information(lab, grasp)[-1, :3, :3]) for grasp in grasps]
    of_spot = np.linalg.inv(sum(np.linalg.inv(bound + scatter) for bound in bounds))
    about_held = of_spot - scatter / len(grasps)  # the mean of what was held deviates from the spot by the rest
    seen = held.mean(axis=0) + _OBSERVATION_NOISE @ np.linalg.cholesky(about_held).T
    thickness_m = _find_thickness_evidence(bench, case, grasps[0])
    densities = compute_log_densities(lab.library, seen, of_spot - scatter, thickness_m)
    share = np.exp(densities - np.logaddexp.reduce(densities, axis=1, keepdims=True))
    return float((share[:, [*lab.library.tissues].index(case.tissue)] >= decide_at).mean())


def build_limit_figures(
    limits: list[KnowledgeLimit], times_s: tuple[float, ...], shown_s: tuple[float, ...]
) -> list[KeyFigure]:
    """Return the limits' means over all grasps, for some of their times, %."""
    exact = float(np.mean([limit.exact for limit in limits]))
    figures = [KeyFigure("Bayes limit", 100 * exact, "%", note="of exactly known parameters")]
    for what, all_times in (
        ("contact sensed", [limit.sensed for limit in limits]),
        ("contact not sensed", [limit.unsensed for limit in limits]),
    ):
        mean = dict(zip(times_s, np.mean(all_times, axis=0), strict=True))
        figures += [
            KeyFigure(f"limit of the samples until {time:g} s, {what}", 100 * float(mean[time]), "%")
            for time in shown_s
        ]
    return figures


def mean_limit(limits: list[KnowledgeLimit], *, sensed: bool) -> np.ndarray:
    """Return the limit's mean over all grasps at each of its times, (times,)."""
    return np.mean([limit.sensed if sensed else limit.unsensed for limit in limits], axis=0)


def _compute_grasp_information(lab: StudySetup, grasp: SimulatedGrasp) -> np.ndarray:
    samples, log_parameters = extract_contact_samples(grasp), grasp.specimen.log_parameters
    return compute_information(lab.tool, lab.library, samples, FIRST_COMPRESSION_M, log_parameters)


def _find_thickness_evidence(bench: StudyConditions, case: GraspCase, grasp: SimulatedGrasp) -> float | None:
    """Return the thickness, m, if it is evidence: of tissue that the jaws take whole."""
    is_fold = load_study_setup(bench).library.tissues[case.tissue].preload_n is not None
    return None if is_fold or not bench.thickness else grasp.specimen.thickness_m


def compute_information(
    tool: Tool, library: TissueLibrary, samples: np.ndarray, compression_m: float, log_parameters: np.ndarray
) -> np.ndarray:
    """Return the Fisher information of the samples up to each one, (n, 4, 4), for log alpha, beta, d and the zero.

    Args:
        samples: of dtype SAMPLE, from contact on.
        compression_m: compression of the tissue at the first sample, m.
        log_parameters: the specimen's log alpha, log beta and log d, (3,).
    """
    tuning = build_filter_tunings(tool)[0]
    noise = tuning.noise._replace(force_var=0.0, dynamic_share=0.0, walk_alpha=0.0, walk_beta=0.0, walk_damping=0.0)
    columns = bank_columns(
        samples, float(samples["jaw_displacement_m"][0]), int(samples["tick"][0]), 1.0 / tool.board.sample_rate_hz
    )
    priors = TissuePriors(("specimen",), log_parameters[None], np.ones((1, 3)), library.mass_kg)
    bank = FilterBank(priors, (tuning,))
    bank.start(ContactStart(columns[0], initial_compression_m=compression_m, initial_compression_sd_m=0.0))
    slopes, log_slopes, variance = [], [], np.empty(0)
    for j, step in enumerate(DIFFERENCE_STEPS):
        (up, up_var), (down, down_var) = (
            _innovations(bank, noise, columns, log_parameters, j, shift) for shift in (step, -step)
        )
        variance = up_var
        slopes.append((up - down) / (2 * step))
        log_slopes.append((np.log(up_var) - np.log(down_var)) / (2 * step))
    scaled, of_variance = np.array(slopes) / np.sqrt(variance), np.array(log_slopes)
    each = np.einsum("in,jn->nij", scaled, scaled) + 0.5 * np.einsum("in,jn->nij", of_variance, of_variance)
    return np.cumsum(each, axis=0)


def _innovations(
    bank: FilterBank, noise: FilterNoise, columns: np.ndarray, log_parameters: np.ndarray, which: int, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return innovations and variances, (n - 1,) each, with one of the four unknowns shifted."""
    mean, cov, _ = bank.initial_state(0)
    cov[LOG_ALPHA : LOG_MASS + 1, :] = cov[:, LOG_ALPHA : LOG_MASS + 1] = 0.0
    mean[PARAMETERS] = log_parameters
    if which < len(log_parameters):
        mean[LOG_ALPHA + which] += shift
    else:
        mean[X] += shift
        mean[OFFSET] -= shift
    return compute_innovations(mean, cov, columns, noise)


def _bound(information: np.ndarray) -> np.ndarray:
    """Return the Cramér-Rao bound, (n, n), of the first n unknowns."""
    n = len(information)
    return np.linalg.inv(information + NO_INFORMATION[:n, :n])


def compute_log_densities(
    library: TissueLibrary, log_parameters: np.ndarray, bound: np.ndarray, thickness_m: np.ndarray | float | None
) -> np.ndarray:
    """Return the log density of estimates, (n, 3), under each tissue's spread and the estimates' covariance, (n, M).

    `thickness_m`: of tissue that the jaws take whole, (n,) or one for all; None if it is no evidence.
    """
    priors = TissuePriors.from_library(library)
    result = np.empty((len(log_parameters), len(priors.names)))
    for k, name in enumerate(priors.names):
        cov, off = np.diag(priors.sd[k] ** 2) + bound, log_parameters - priors.mean[k]
        result[:, k] = (
            -0.5 * np.einsum("ni,ni->n", off, np.linalg.solve(cov, off.T).T) - 0.5 * np.linalg.slogdet(cov)[1]
        )
        if thickness_m is not None:
            sd = library.spread_of(name).log_thickness
            result[:, k] -= 0.5 * (np.log(thickness_m / library.tissues[name].thickness_m) / sd) ** 2 + math.log(sd)
    return result


def _share_right(
    library: TissueLibrary, tissue: str, log_parameters: np.ndarray, bound: np.ndarray, thickness_m: float | None
) -> float:
    """Return the probability that the likeliest tissue is right, for estimates that scatter as the bound says."""
    seen = log_parameters[None]
    if bound.any():
        seen = seen + _OBSERVATION_NOISE @ np.linalg.cholesky(bound).T
    densities = compute_log_densities(library, seen, bound, thickness_m)
    return float((densities.argmax(axis=1) == [*library.tissues].index(tissue)).mean())
