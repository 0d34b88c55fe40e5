"""`graspwatch study unknown`: things outside the library are to be called unknown, and the library's tissues not."""

from dataclasses import asdict, dataclass

import numpy as np
import plotly.graph_objects as go

from acquisition.simulation.tissue import EXACT
from estimator.decision import UNKNOWN
from estimator.studies.course import Bench, follow, same_number_of_each, set_up
from estimator.studies.grasps import Case
from estimator.studies.report import PALETTE, Figure, Study, Table
from estimator.studies.runner import Progress, run_cases
from estimator.studies.truths import DEVIATION_OF, SLIPPING, STRANGERS


@dataclass(frozen=True, slots=True)
class _Answer:
    """How one grasp was answered: probability of unknown at its end, whether named so then, and whether ever."""

    probability: float
    at_end: bool
    ever: bool
    label: str


def unknown(bench: Bench, grasps: int, seed: int, progress: Progress, jobs: int | None = None) -> Study:
    """Run the study: `grasps` of each thing."""
    library = set_up(bench).library
    kinds: dict[str, list[Case]] = {
        profile.title: [
            Case(name, seed * 1_000_000 + 500_000 + 10_000 * number + i, DEVIATION_OF.get(name, EXACT), STRANGERS)
            for i in range(grasps)
        ]
        for number, (name, profile) in enumerate(STRANGERS.tissues.items())
    }
    slipping = same_number_of_each(library, grasps, seed + 1, deviation=SLIPPING)
    for i, profile in enumerate(library.tissues.values()):
        kinds[f"{profile.title} that slips out"] = slipping[i * grasps : (i + 1) * grasps]
    own = same_number_of_each(library, grasps, seed)
    cases = [(bench, case) for those in [*kinds.values(), own] for case in those]
    answers = run_cases(_answer, cases, progress, jobs)
    strangers, known = answers[: -len(own)], answers[-len(own) :]
    study = Study(
        "unknown",
        "Things outside the library",
        {**asdict(bench), "grasps of each thing": grasps, "seed": seed},
        "Unknown is a hypothesis of its own: parameters spread over orders of magnitude about the library's mean, "
        "any thickness, and a curve that the model does not fit. A grasp counts as called unknown where that name "
        "was given by the rule that names tissues, with the same bound.",
    )
    by_kind = {kind: strangers[i * grasps : (i + 1) * grasps] for i, kind in enumerate(kinds)}
    least = min(by_kind, key=lambda kind: _share(by_kind[kind]))
    study.figures = [
        Figure("strangers called unknown within the grasp", _share(strangers), "%", at_least=95.0),
        Figure("strangers still called unknown at its end", 100 * np.mean([a.at_end for a in strangers]), "%"),
        Figure("tissues of the library called unknown, ever", _share(known), "%", at_most=3.0),
        Figure("the same, at the grasp's end", 100 * np.mean([a.at_end for a in known]), "%", at_most=3.0),
        Figure(
            "strangers named as a tissue at the grasp's end",
            100 * np.mean([a.label in library.tissues for a in strangers]),
            "%",
        ),
        Figure("least: share called unknown", _share(by_kind[least]), "%", note=least),
        Figure("area under the ROC curve", _area(strangers, known), ""),
    ]
    rows = [
        [
            kind,
            _share(those) / 100,
            np.mean([a.at_end for a in those]),
            np.mean([a.probability for a in those]),
            np.mean([a.label in library.tissues for a in those]),
        ]
        for kind, those in [*by_kind.items(), ("the library's tissues", known)]
    ]
    columns = [
        "thing",
        "called unknown within the grasp",
        "at its end",
        "mean probability of unknown",
        "named a tissue",
    ]
    study.parts = [
        Table("Called unknown", columns, [[name, *map(float, values)] for name, *values in rows]),
        ("ROC of the probability of unknown at the grasp's end", _roc_figure(strangers, known)),
    ]
    return study


def _answer(job) -> _Answer:
    course = follow(*job)
    label = course.record.label
    ever = UNKNOWN in course.labels or label == UNKNOWN
    return _Answer(float(course.probabilities[-1][-1]), label == UNKNOWN, ever, label)


def _share(answers: list[_Answer]) -> float:
    return 100 * float(np.mean([answer.ever for answer in answers]))


def _roc(strangers: list[_Answer], known: list[_Answer]) -> tuple[np.ndarray, np.ndarray]:
    bounds = np.unique([a.probability for a in [*strangers, *known]])[::-1]
    found = [np.mean([a.probability >= bound for a in strangers]) for bound in bounds]
    wrong = [np.mean([a.probability >= bound for a in known]) for bound in bounds]
    return np.array([0.0, *wrong]), np.array([0.0, *found])


def _area(strangers: list[_Answer], known: list[_Answer]) -> float:
    return float(np.trapezoid(*_roc(strangers, known)[::-1]))


def _roc_figure(strangers: list[_Answer], known: list[_Answer]) -> go.Figure:
    wrong, found = _roc(strangers, known)
    figure = go.Figure()
    figure.add_scatter(x=wrong, y=found, mode="lines+markers", line={"color": PALETTE[0], "shape": "hv"}, name="ours")
    figure.update_layout(
        xaxis_title="library's tissues called unknown",
        yaxis_title="strangers called unknown",
        xaxis_range=[-0.01, 1],
        yaxis_range=[0, 1.01],
    )
    return figure
