"""`graspwatch study unknown`: how often unknown is said of things outside the library, and of its own tissues."""

from dataclasses import asdict, dataclass

import numpy as np
import plotly.graph_objects as go

from acquisition.simulation.tissue import NO_DEVIATION
from estimator.decision import UNKNOWN
from estimator.studies.answer_course import StudyConditions, build_balanced_cases, estimate_grasp, load_study_setup
from estimator.studies.case_runner import Progress, run_cases
from estimator.studies.out_of_library import DEVIATION_BY_TISSUE, OUT_OF_LIBRARY, SLIPPING_DEVIATION
from estimator.studies.simulated_grasps import GraspCase
from estimator.studies.study_report import PALETTE, KeyFigure, StudyResult, Table


@dataclass(frozen=True, slots=True)
class _UnknownAnswer:
    """Answer for one grasp: probability of unknown at its end, whether called unknown then, and whether ever."""

    probability: float
    unknown_at_end: bool
    unknown_ever: bool
    label: str


def run_unknown_study(
    bench: StudyConditions, grasps: int, seed: int, progress: Progress, jobs: int | None = None
) -> StudyResult:
    """Run the study with `grasps` of each thing and each tissue."""
    library = load_study_setup(bench).library
    kinds: dict[str, list[GraspCase]] = {
        profile.title: [
            GraspCase(
                name,
                seed * 1_000_000 + 500_000 + 10_000 * number + i,
                DEVIATION_BY_TISSUE.get(name, NO_DEVIATION),
                OUT_OF_LIBRARY,
            )
            for i in range(grasps)
        ]
        for number, (name, profile) in enumerate(OUT_OF_LIBRARY.tissues.items())
    }
    slipping = build_balanced_cases(library, grasps, seed + 1, deviation=SLIPPING_DEVIATION)
    for i, profile in enumerate(library.tissues.values()):
        kinds[f"{profile.title} that slips out"] = slipping[i * grasps : (i + 1) * grasps]
    own = build_balanced_cases(library, grasps, seed)
    cases = [(bench, case) for those in [*kinds.values(), own] for case in those]
    answers = run_cases(_evaluate_case, cases, progress, jobs)
    out_of_library, known = answers[: -len(own)], answers[-len(own) :]
    study = StudyResult(
        "unknown",
        "Things outside the library",
        {**asdict(bench), "grasps of each thing": grasps, "seed": seed},
        "Unknown is a hypothesis of its own: parameters spread over orders of magnitude about the library's mean, "
        "any thickness, and a curve that the model does not fit. A grasp counts as called unknown where that name "
        "was given by the rule that names tissues, with the same bound.",
    )
    by_kind = {kind: out_of_library[i * grasps : (i + 1) * grasps] for i, kind in enumerate(kinds)}
    least = min(by_kind, key=lambda kind: _compute_unknown_share(by_kind[kind]))
    study.figures = [
        KeyFigure(
            "out of the library: called unknown within the grasp",
            _compute_unknown_share(out_of_library),
            "%",
            at_least=95.0,
        ),
        KeyFigure(
            "out of the library: still called unknown at its end",
            100 * float(np.mean([a.unknown_at_end for a in out_of_library])),
            "%",
        ),
        KeyFigure("tissues of the library called unknown, ever", _compute_unknown_share(known), "%", at_most=3.0),
        KeyFigure(
            "the same, at the grasp's end", 100 * float(np.mean([a.unknown_at_end for a in known])), "%", at_most=3.0
        ),
        KeyFigure(
            "out of the library: named as a tissue at the grasp's end",
            100 * float(np.mean([a.label in library.tissues for a in out_of_library])),
            "%",
        ),
        KeyFigure("least: share called unknown", _compute_unknown_share(by_kind[least]), "%", note=least),
        KeyFigure("area under the ROC curve", _compute_roc_area(out_of_library, known), ""),
    ]
    rows = [
        [
            kind,
            _compute_unknown_share(those) / 100,
            np.mean([a.unknown_at_end for a in those]),
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
        ("ROC of the probability of unknown at the grasp's end", _plot_roc(out_of_library, known)),
    ]
    return study


def _evaluate_case(job: tuple[StudyConditions, GraspCase]) -> _UnknownAnswer:
    course = estimate_grasp(*job)
    label = course.record.label
    ever = UNKNOWN in course.labels or label == UNKNOWN
    return _UnknownAnswer(float(course.probabilities[-1][-1]), label == UNKNOWN, ever, label)


def _compute_unknown_share(answers: list[_UnknownAnswer]) -> float:
    return 100 * float(np.mean([answer.unknown_ever for answer in answers]))


def _roc(out_of_library: list[_UnknownAnswer], known: list[_UnknownAnswer]) -> tuple[np.ndarray, np.ndarray]:
    bounds = np.unique([a.probability for a in [*out_of_library, *known]])[::-1]
    found = [np.mean([a.probability >= bound for a in out_of_library]) for bound in bounds]
    wrong = [np.mean([a.probability >= bound for a in known]) for bound in bounds]
    return np.array([0.0, *wrong]), np.array([0.0, *found])


def _compute_roc_area(out_of_library: list[_UnknownAnswer], known: list[_UnknownAnswer]) -> float:
    wrong, found = _roc(out_of_library, known)
    return float(np.trapezoid(found, wrong))


def _plot_roc(out_of_library: list[_UnknownAnswer], known: list[_UnknownAnswer]) -> go.Figure:
    wrong, found = _roc(out_of_library, known)
    figure = go.Figure()
    figure.add_scatter(x=wrong, y=found, mode="lines+markers", line={"color": PALETTE[0], "shape": "hv"}, name="ours")
    figure.update_layout(
        xaxis_title="library's tissues called unknown",
        yaxis_title="out of the library, called unknown",
        xaxis_range=[-0.01, 1],
        yaxis_range=[0, 1.01],
    )
    return figure
