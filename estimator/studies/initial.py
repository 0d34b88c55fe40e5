"""`graspwatch study initial`: convergence from initial guesses of alpha and beta wrong by a factor of up to ten."""

from dataclasses import asdict, dataclass

import numpy as np
import plotly.graph_objects as go

from estimator.baselines.paper_filter import FILTERED_NOISE_SHARE, GUESS_SHARE_SD, PaperFilterBank, PaperNoise
from estimator.criteria import convergence_samples
from estimator.filter_bank import FilterBank, TissuePriors, bank_columns, build_contact_start, build_filter_tunings
from estimator.kalman_filter import PARAMETERS, X
from estimator.studies.answer_course import StudyConditions, load_study_setup
from estimator.studies.case_runner import Progress, run_cases
from estimator.studies.simulated_grasps import GraspCase, extract_contact_samples, simulate_grasp
from estimator.studies.study_report import KeyFigure, StudyResult, Table
from estimator.tissue_model import elastic_force_array

FACTORS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
MAX_CONVERGENCE_S = 0.3
STEP_SAMPLES = 5  # samples between two choices of the likeliest filter

# A guess that may be wrong by a factor of ten is a prior of that width; a fan of filters covers it, each a part.
LOG_GUESS_OFFSETS = np.log(10.0) * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
GUESS_LOG_SD = np.array([0.6, 0.6, 1.0])  # half of the fan's spacing, and damping within a factor of 2.7


@dataclass(frozen=True, slots=True)
class _Job:
    bench: StudyConditions
    case: GraspCase
    alpha_factor: float
    beta_factor: float


def run_initial_study(
    bench: StudyConditions, grasps: int, seed: int, progress: Progress, jobs: int | None = None
) -> StudyResult:
    """Run the study with `grasps` of every tissue from each pair of wrong guesses."""
    library = load_study_setup(bench).library
    names = [*library.tissues]
    work = [
        _Job(bench, GraspCase(name, seed * 1_000_000 + 700_000 + 1_000 * k + i), a, b)
        for k, name in enumerate(names)
        for a in FACTORS
        for b in FACTORS
        for i in range(grasps)
    ]
    # (jobs, 3): ours, paper's sure, paper's unsure
    times = np.array(run_cases(_measure_convergence, work, progress, jobs))
    shares = (times <= MAX_CONVERGENCE_S).reshape(len(names), len(FACTORS), len(FACTORS), grasps, 3)
    study = StudyResult(
        "initial",
        "Wrong initial guesses",
        {**asdict(bench), "grasps of each tissue and pair of factors": grasps, "seed": seed},
        "Guesses of alpha and beta are those of the tissue times the factors; damping as it is. A filter has "
        "converged where its elastic force stays within 15 % of the largest force of the measured one, from 0.3 s "
        "after contact at the latest until the jaws let go.\n\n"
        "Ours knows that the guess may be off by ten: a fan of filters covers that range, and the likeliest is "
        "believed. The paper's filter has one guess; it is tried with a small and with a large initial "
        "covariance.",
    )
    ours, sure, unsure = (100 * float(shares[..., i].mean()) for i in range(3))
    study.figures = [
        KeyFigure("converged within 0.3 s, ours", ours, "%", at_least=99.0),
        KeyFigure("the paper's filter, P0 as for close guesses", sure, "%"),
        KeyFigure("the paper's filter, P0 as large as the guesses", unsure, "%"),
        *(KeyFigure(f"ours, {name}", 100 * float(shares[k, ..., 0].mean()), "%") for k, name in enumerate(names)),
        KeyFigure("median convergence, ours", float(np.nanmedian(times[:, 0])), "s"),
    ]
    columns = ["tissue", "ours", "paper's filter, sure of its guess", "paper's filter, unsure"]
    study.parts.append(
        Table(
            "Share converged within 0.3 s",
            columns,
            [[name, *(float(shares[k, ..., i].mean()) for i in range(3))] for k, name in enumerate(names)],
        )
    )
    for title, i in (("ours", 0), ("the paper's filter, sure of its guess", 1)):
        study.parts.append((f"Share converged within 0.3 s: {title}", _plot_heatmap(shares[..., i].mean(axis=(0, 3)))))
    return study


def _measure_convergence(job: _Job) -> np.ndarray:
    """Return seconds from contact to convergence, (3,): ours, the paper's with small and large P0; NaN if never."""
    lab = load_study_setup(job.bench)
    samples = extract_contact_samples(
        simulate_grasp(lab.tool, lab.library, lab.settings.conditioning, lab.protocol, job.case)
    )
    profile = lab.library.tissues[job.case.tissue]
    guess = np.array(
        [profile.alpha_n * job.alpha_factor, profile.beta_per_m * job.beta_factor, profile.damping_kg_per_s]
    )
    bound_n = lab.settings.identification.convergence_error * float(samples["jaw_force_filtered_n"].max())
    rate_hz = lab.tool.board.sample_rate_hz
    until = int(np.argmax(samples["jaw_force_filtered_n"])) + 1
    until = max(until, round(2 * MAX_CONVERGENCE_S * rate_hz))
    ours = _run_filter_fan(job, guess, samples) - samples["jaw_force_n"][1:]
    errors_n = [ours[:until]]
    first = samples[0]
    sensor_v = FILTERED_NOISE_SHARE * lab.tool.noise.strain_sd_v
    noise = PaperNoise(sensor_v * float(first["newton_per_volt"]), sensor_v * abs(float(first["metre_per_volt"])))
    force_n = np.ascontiguousarray(samples["jaw_force_filtered_n"])
    displacement_m = samples["jaw_displacement_filtered_m"] - first["jaw_displacement_filtered_m"]
    for share in (GUESS_SHARE_SD, np.ones(3)):
        paper = PaperFilterBank(guess[None], lab.library.mass_kg, 1 / rate_hz, noise, guess_share_sd=share)
        paper.start(float(force_n[0]))
        _, elastic_n = paper.advance(force_n[1:], displacement_m[1:])
        errors_n.append((elastic_n[:, 0] - force_n[1:])[:until])
    return convergence_samples(np.column_stack(errors_n), bound_n) / rate_hz


def _run_filter_fan(job: _Job, guess: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Return the elastic force of the fan's likeliest filter after each sample, N, (n - 1,)."""
    lab = load_study_setup(job.bench)
    around = np.array([[a, b, 0.0] for a in LOG_GUESS_OFFSETS for b in LOG_GUESS_OFFSETS])
    names = tuple(f"{i}" for i in range(len(around)))
    priors = TissuePriors(names, np.log(guess) + around, np.tile(GUESS_LOG_SD, (len(around), 1)), lab.library.mass_kg)
    bank = FilterBank(priors, build_filter_tunings(lab.tool), widening=1.0)
    contact = build_contact_start(samples[0], 0.0, contact_sensed=job.bench.touch)
    bank.start(contact)
    dt_s = 1.0 / lab.tool.board.sample_rate_hz
    columns = bank_columns(samples[1:], float(samples["jaw_displacement_m"][0]), int(samples["tick"][0]), dt_s)
    elastic_n = np.full(len(columns), np.nan)
    for begin in range(0, len(columns), STEP_SAMPLES):
        mean, _ = bank.advance(columns[begin : begin + STEP_SAMPLES])
        best = bank.find_likeliest_filter()
        if best >= 0:
            own = mean[:, best % len(names)]
            parameters = np.exp(own[:, PARAMETERS])
            elastic_n[begin : begin + STEP_SAMPLES] = elastic_force_array(parameters[:, 0], parameters[:, 1], own[:, X])
    return elastic_n


def _plot_heatmap(shares: np.ndarray) -> go.Figure:
    labels = [f"{factor:g}" for factor in FACTORS]
    figure = go.Figure(
        go.Heatmap(
            z=100 * shares, x=labels, y=labels, zmin=0, zmax=100, colorscale="Cividis", texttemplate="%{z:.0f} %"
        )
    )
    figure.update_layout(
        xaxis_title="beta times", yaxis_title="alpha times", xaxis_type="category", yaxis_type="category"
    )
    return figure
