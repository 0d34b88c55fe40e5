"""`graspwatch study initial`: guesses of alpha and beta that are off by a factor of up to ten, either way."""

from dataclasses import asdict, dataclass

import numpy as np
import plotly.graph_objects as go

from estimator.bank import Bank, Priors, strict_and_lenient
from estimator.criteria import convergence_samples
from estimator.filter import PARAMETERS, X
from estimator.identifier import bank_columns, contact_of
from estimator.model import force_curve
from estimator.rivals.printed import FILTERED_NOISE, GUESS_SHARE_SD, PrintedBank, PrintedNoise
from estimator.studies.course import Bench, set_up
from estimator.studies.grasps import Case, held_samples, simulate
from estimator.studies.report import Figure, Study, Table
from estimator.studies.runner import Progress, run_cases

FACTORS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
WITHIN_S = 0.3
STEP = 5  # samples after which the likeliest filter is chosen anew

# A guess that may be off by ten either way is a prior as wide as that; a fan of filters covers it, each a part.
FAN = np.log(10.0) * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
FAN_LOG_SD = np.array([0.6, 0.6, 1.0])  # half of the fan's spacing, and damping within a factor of 2.7


@dataclass(frozen=True, slots=True)
class _Job:
    bench: Bench
    case: Case
    alpha_factor: float
    beta_factor: float


def initial(bench: Bench, grasps: int, seed: int, progress: Progress, jobs: int | None = None) -> Study:
    """Run the study: `grasps` of every tissue from each pair of wrong guesses."""
    library = set_up(bench).library
    names = [*library.tissues]
    work = [
        _Job(bench, Case(name, seed * 1_000_000 + 700_000 + 1_000 * k + i), a, b)
        for k, name in enumerate(names)
        for a in FACTORS
        for b in FACTORS
        for i in range(grasps)
    ]
    times = np.array(run_cases(_convergence, work, progress, jobs))  # (jobs, 3): ours, paper's sure, paper's unsure
    shares = (times <= WITHIN_S).reshape(len(names), len(FACTORS), len(FACTORS), grasps, 3)
    study = Study(
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
        Figure("converged within 0.3 s, ours", ours, "%", at_least=99.0),
        Figure("the paper's filter, P0 as for close guesses", sure, "%"),
        Figure("the paper's filter, P0 as large as the guesses", unsure, "%"),
        *(Figure(f"ours, {name}", 100 * float(shares[k, ..., 0].mean()), "%") for k, name in enumerate(names)),
        Figure("median convergence, ours", float(np.nanmedian(times[:, 0])), "s"),
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
        study.parts.append((f"Share converged within 0.3 s: {title}", _map(shares[..., i].mean(axis=(0, 3)))))
    return study


def _convergence(job: _Job) -> np.ndarray:
    """Seconds from contact to convergence, (3,): ours, the paper's filter with a small and a large P0; NaN if never."""
    lab = set_up(job.bench)
    samples = held_samples(simulate(lab.tool, lab.library, lab.settings.conditioning, lab.protocol, job.case))
    profile = lab.library.tissues[job.case.tissue]
    guess = np.array(
        [profile.alpha_n * job.alpha_factor, profile.beta_per_m * job.beta_factor, profile.damping_kg_per_s]
    )
    bound_n = lab.settings.identification.convergence_error * float(samples["jaw_force_filtered_n"].max())
    rate_hz = lab.tool.board.sample_rate_hz
    until = int(np.argmax(samples["jaw_force_filtered_n"])) + 1
    until = max(until, round(2 * WITHIN_S * rate_hz))
    ours = _ours(job, guess, samples) - samples["jaw_force_n"][1:]
    errors_n = [ours[:until]]
    first = samples[0]
    sensor_v = FILTERED_NOISE * lab.tool.noise.strain_sd_v
    noise = PrintedNoise(sensor_v * float(first["newton_per_volt"]), sensor_v * abs(float(first["metre_per_volt"])))
    force_n = np.ascontiguousarray(samples["jaw_force_filtered_n"])
    displacement_m = samples["jaw_displacement_filtered_m"] - first["jaw_displacement_filtered_m"]
    for share in (GUESS_SHARE_SD, np.ones(3)):
        paper = PrintedBank(guess[None], lab.library.mass_kg, 1 / rate_hz, noise, guess_share_sd=share)
        paper.start(float(force_n[0]))
        _, elastic_n = paper.advance(force_n[1:], displacement_m[1:])
        errors_n.append((elastic_n[:, 0] - force_n[1:])[:until])
    return convergence_samples(np.column_stack(errors_n), bound_n) / rate_hz


def _ours(job: _Job, guess: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Elastic force of the likeliest filter of the fan after each sample, N, (n - 1,)."""
    lab = set_up(job.bench)
    around = np.array([[a, b, 0.0] for a in FAN for b in FAN])
    names = tuple(f"{i}" for i in range(len(around)))
    priors = Priors(names, np.log(guess) + around, np.tile(FAN_LOG_SD, (len(around), 1)), lab.library.mass_kg)
    bank = Bank(priors, strict_and_lenient(lab.tool), widening=1.0)
    contact = contact_of(samples[0], 0.0, sensed=job.bench.touch)
    bank.start(contact)
    dt_s = 1.0 / lab.tool.board.sample_rate_hz
    columns = bank_columns(samples[1:], float(samples["jaw_displacement_m"][0]), int(samples["tick"][0]), dt_s)
    elastic_n = np.full(len(columns), np.nan)
    for begin in range(0, len(columns), STEP):
        mean, _ = bank.advance(columns[begin : begin + STEP])
        best = bank.best()
        if best >= 0:
            own = mean[:, best % len(names)]
            parameters = np.exp(own[:, PARAMETERS])
            elastic_n[begin : begin + STEP] = force_curve(parameters[:, 0], parameters[:, 1], own[:, X])
    return elastic_n


def _map(shares: np.ndarray) -> go.Figure:
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
