"""`graspwatch study limiter`: is the force held under the limit in force, and does the grasp still hold?"""

from collections.abc import Callable, Iterable
from dataclasses import asdict, replace

import numpy as np
import plotly.graph_objects as go

from estimator.studies.course import Bench, Lab, set_up
from estimator.studies.limited import LEAD_IN_S, force_without, play
from estimator.studies.limited_cases import FAST_V_PER_S, LimitedCase, Told, beyond, draw
from estimator.studies.limited_measures import Outcome, measure
from estimator.studies.report import PALETTE, Figure, Study, Table
from estimator.studies.runner import Progress, run_cases

BOARD_V = 10.0  # what the board can give: commands up to 5 N by the map need 8.9 V
MOST_OVER, FURTHEST_OVER, LEAST_HELD = 0.1, 5.0, 99.0  # %
HOLDS = 0.6  # of what is allowed
BEYOND_SHARE = 40  # one grasp in so many is played again with each thing that no limiter can know
EXAMPLE = LimitedCase("liver", 1, Told.DEAD, "liver", 0.3, 4.0, 40.0)  # the estimator dies within the hold
STRENGTH_BANDS = ((0.0, 0.9), (0.9, 1.1), (1.1, 1.3), (1.3, 9.0))
EXPLANATION = """Each grasp is played twice on the same specimen, with the limiter and without it, by the acquisition
as it runs live: tissues in turn, the spreads of their specimens once and twice, strain noise once and three times the
usual, commands for 0.5 to 5 N, ramps up to the fastest that the tool allows, and a tool that differs from its file in
its strength, its strain gage, friction and backlash. The limit in force is margin times the threshold in force as the
limiter is told it, also where that is wrong. Forces are the true ones at the jaws. A limit that falls below the force
counts 0.1 s later; how long the force took is told by itself.

Every grasp is the tool's first: nothing has been learned of its strength. What is beyond these bounds has a table of
its own."""


def limiter(bench: Bench, grasps: int, seed: int, progress: Progress, jobs: int | None = None) -> Study:
    """Run the study: `grasps` of each tissue."""
    lab = _lab(bench)
    cases = draw(lab.library, lab.tool, grasps, seed)
    further = beyond(cases, max(len(cases) // BEYOND_SHARE, 1))
    jobs_to_do = [(bench, case) for case in [*cases, *(case for those in further.values() for case in those)]]
    outcomes = run_cases(_outcome, jobs_to_do, progress, jobs)
    own, each = outcomes[: len(cases)], len(outcomes[len(cases) :]) // len(further)
    beyond_them = {kind: outcomes[len(cases) + k * each :][:each] for k, kind in enumerate(further)}
    used = {key: value for key, value in asdict(bench).items() if key not in ("protocol", "thickness")}
    study = Study(
        "limiter",
        "Force held under the limit",
        {**used, "grasps": len(cases), "margin": lab.settings.limiter.margin, "seed": seed},
        EXPLANATION,
    )
    study.figures = _figures(own)
    study.parts = [
        _by("What the limiter is told", own, [told.value for told in Told], lambda o: o.case.told.value),
        _by("Tissue", own, [*lab.library.tissues], lambda o: o.case.tissue),
        _by(
            "Strength of the tool, times its map",
            own,
            [_band(low) for low, _ in STRENGTH_BANDS],
            lambda o: next(_band(low) for low, high in STRENGTH_BANDS if low <= o.case.strength < high),
        ),
        _by(
            "Ramp",
            own,
            ["slower than 20 V/s", "faster"],
            lambda o: "faster" if o.case.rise_v_per_s >= FAST_V_PER_S else "slower than 20 V/s",
        ),
        _beyond_table(beyond_them),
        ("Highest force, as a share of the limit in force", _peaks_figure(own)),
        ("A liver that is named, until the estimator dies", _course_figure(lab)),
    ]
    return study


def _lab(bench: Bench) -> Lab:
    lab = set_up(bench)
    limits = lab.tool.limits.model_copy(update={"max_command_v": BOARD_V})
    return replace(lab, tool=lab.tool.model_copy(update={"limits": limits}))


def _outcome(job: tuple[Bench, LimitedCase]) -> Outcome:
    bench, case = job
    lab = _lab(bench)
    with_it = play(case, lab.tool, lab.library, lab.settings)
    without_n = force_without(case, lab.tool, lab.library)
    return measure(case, lab.tool, lab.library, lab.settings.limiter.margin, with_it, without_n)


def _figures(outcomes: list[Outcome]) -> list[Figure]:
    touched = [o for o in outcomes if o.touched]
    return [
        Figure("over the limit in force", _share(o.peak > 1 for o in outcomes), "%", at_most=MOST_OVER),
        Figure("furthest over it", _furthest(o.peak for o in outcomes), "%", at_most=FURTHEST_OVER),
        Figure("without the limiter: over it", _share(o.peak_without > 1 for o in outcomes), "%"),
        Figure("without the limiter: furthest over it", _furthest(o.peak_without for o in outcomes), "%"),
        Figure(
            "hold at least 60 % of the allowed force",
            _share(o.held >= HOLDS for o in touched),
            "%",
            at_least=LEAST_HELD,
        ),
        Figure(
            "allowed force that is held, median of those held back",
            _middle(100 * o.held for o in touched if o.held_back),
            "%",
        ),
        Figure("allowed force that is held, least", 100 * min((o.held for o in touched), default=0.0), "%"),
        Figure("overshoot over what is held, median", _middle(_known(o.overshoot for o in outcomes), 100), "%"),
        Figure(
            "overshoot over what is held, 99 in 100 below",
            _middle(_known(o.overshoot for o in outcomes), 100, 0.99),
            "%",
        ),
        Figure("settling time since contact, median", _middle(_known(o.settled_s for o in outcomes), 1e3), "ms"),
        Figure(
            "settling time since contact, fast ramps, median",
            _middle(_known(o.settled_s for o in outcomes if o.case.rise_v_per_s >= FAST_V_PER_S), 1e3),
            "ms",
        ),
        Figure("command reversals a second while held", float(np.mean([o.reversals_per_s for o in outcomes])), ""),
        Figure(
            "over a limit that fell, 99 in 100 shorter",
            _middle(_known(o.over_fallen_s for o in outcomes), 1e3, 0.99),
            "ms",
        ),
        Figure("let go", _share(o.let_go for o in outcomes), "%"),
        Figure("ended as a fault: sound sensors taken for lost", _share(bool(o.fault) for o in outcomes), "%"),
        Figure(
            "over the held tissue's own threshold",
            _share(o.injures for o in outcomes),
            "%",
            note="only where another tissue's threshold is told",
        ),
        Figure(
            "without the limiter: over the held tissue's own threshold",
            _share(o.injures_without for o in outcomes),
            "%",
        ),
    ]


def _by(title: str, outcomes: list[Outcome], kinds: list[str], kind_of: Callable[[Outcome], str]) -> Table:
    columns = [
        title,
        "grasps",
        "over the limit, %",
        "furthest, %",
        "without, %",
        "furthest, %",
        "over the own threshold, %",
        "without, %",
        "hold 60 %, %",
        "median held, %",
    ]
    rows = [[kind, *_row([o for o in outcomes if kind_of(o) == kind])] for kind in kinds]
    return Table(title, columns, rows)


def _row(those: list[Outcome]) -> list[float | int | None]:
    if not those:
        return [0, *[None] * 8]
    return [
        len(those),
        _share(o.peak > 1 for o in those),
        _furthest(o.peak for o in those),
        _share(o.peak_without > 1 for o in those),
        _furthest(o.peak_without for o in those),
        _share(o.injures for o in those),
        _share(o.injures_without for o in those),
        _share(o.held >= HOLDS for o in those if o.touched),
        _middle(100 * o.held for o in those if o.touched and o.held_back),
    ]


def _beyond_table(outcomes: dict[str, list[Outcome]]) -> Table:
    columns = [
        "beyond",
        "first grasp over the limit, %",
        "furthest, %",
        "let go, %",
        "later ones over it, %",
        "furthest, %",
        "let go, %",
        "hold 60 %, %",
    ]
    rows = [
        [
            kind,
            _share(o.peak > 1 for o in those),
            _furthest(o.peak for o in those),
            _share(o.let_go for o in those),
            _share(o.peak_later > 1 for o in those),
            _furthest(o.peak_later for o in those),
            _share(o.let_go_later for o in those),
            _share(o.held >= HOLDS for o in those if o.touched),
        ]
        for kind, those in outcomes.items()
    ]
    note = "Two grasps in a row on fast ramps, another tissue's threshold told; all else as above but the strength."
    return Table("Beyond what a limiter can know", columns, rows, note)


def _band(low: float) -> str:
    high = next(high for begin, high in STRENGTH_BANDS if begin == low)
    return f"below {high:g}" if low == 0 else f"from {low:g}" if high > 2 else f"{low:g} to {high:g}"


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _share(each: Iterable[bool]) -> float:
    found = list(each)
    return 100 * sum(found) / max(len(found), 1)


def _furthest(peaks: Iterable[float]) -> float:
    """How far the highest is over the limit, %; 0 where none is."""
    return 100 * max(0.0, *(peak - 1.0 for peak in peaks))


def _middle(values: Iterable[float], times: float = 1.0, quantile: float = 0.5) -> float | None:
    found = list(values)
    return times * float(np.quantile(found, quantile)) if found else None


def _peaks_figure(outcomes: list[Outcome]) -> go.Figure:
    figure = go.Figure()
    shares = np.arange(1, len(outcomes) + 1) / len(outcomes)
    for name, peaks, colour in (
        ("with the limiter", [o.peak for o in outcomes], PALETTE[0]),
        ("without", [o.peak_without for o in outcomes], PALETTE[1]),
    ):
        figure.add_scatter(x=np.sort(peaks), y=shares, name=name, line={"color": colour, "shape": "hv"})
    figure.add_vline(x=1.0, line={"color": "#000000", "dash": "dash", "width": 1})
    figure.update_layout(xaxis_title="highest force / limit in force", yaxis_title="share of grasps")
    return figure


def _course_figure(lab: Lab) -> go.Figure:
    figure = go.Figure()
    with_it, without_n = (
        play(EXAMPLE, lab.tool, lab.library, lab.settings),
        force_without(EXAMPLE, lab.tool, lab.library),
    )
    since_ms = np.arange(len(with_it.force_n)) * 1e3 / lab.tool.board.sample_rate_hz - 1e3 * LEAD_IN_S
    limit_n = lab.settings.limiter.margin * with_it.threshold_n
    figure.add_scatter(x=since_ms, y=with_it.force_n, name="force with the limiter", line={"color": PALETTE[0]})
    figure.add_scatter(x=since_ms, y=without_n, name="without", line={"color": PALETTE[1]})
    figure.add_scatter(
        x=since_ms, y=limit_n, name="limit in force", line={"color": "#000000", "dash": "dash", "width": 1}
    )
    figure.update_layout(xaxis_title="since the ramp's start, ms", yaxis_title="force at the jaws, N")
    return figure
