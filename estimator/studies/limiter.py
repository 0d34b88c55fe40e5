"""`graspwatch study limiter`: whether the limiter keeps the force under the limit while the grasp still holds."""

from collections.abc import Callable, Iterable
from dataclasses import asdict, replace

import numpy as np
import plotly.graph_objects as go

from estimator.studies.answer_course import StudyConditions, StudySetup, load_study_setup
from estimator.studies.case_runner import Progress, run_cases
from estimator.studies.limiter_cases import (
    FAST_RAMP_V_PER_S,
    LimitedCase,
    ThresholdScenario,
    build_out_of_bounds_cases,
    draw_cases,
)
from estimator.studies.limiter_measures import LimiterOutcome, measure_outcome
from estimator.studies.limiter_simulation import LEAD_IN_S, simulate_limited, simulate_unlimited_force
from estimator.studies.study_report import PALETTE, KeyFigure, StudyResult, Table

MAX_BOARD_COMMAND_V = 10.0  # highest output of the board: commands up to 5 N by the map need 8.9 V
MAX_OVER_LIMIT_PERCENT, MAX_OVERSHOOT_PERCENT, MIN_HOLDING_PERCENT = 0.1, 5.0, 99.0
MIN_HOLD_SHARE = 0.6  # share of the allowed force
OUT_OF_BOUNDS_INTERVAL = 40  # one grasp in so many is repeated with each of OUT_OF_BOUNDS
# the estimator dies within the hold
EXAMPLE_CASE = LimitedCase("liver", 1, ThresholdScenario.DEAD, "liver", 0.3, 4.0, 40.0)
GAIN_RATIO_BANDS = ((0.0, 0.9), (0.9, 1.1), (1.1, 1.3), (1.3, 9.0))
EXPLANATION = """Each grasp is played twice on the same specimen, with the limiter and without it, by the acquisition
as it runs live: tissues in turn, the spreads of their specimens once and twice, strain noise once and three times the
usual, commands for 0.5 to 5 N, ramps up to the fastest that the tool allows, and a tool that differs from its file in
its strength, its strain gage, friction and backlash. The limit in force is margin times the threshold in force as the
limiter is told it, also where that is wrong. Forces are the true ones at the jaws. A limit that falls below the force
counts 0.1 s later; how long the force took is told by itself.

Every grasp is the tool's first: nothing has been learned of its strength. What is beyond these bounds has a table of
its own."""


def run_limiter_study(
    bench: StudyConditions, grasps: int, seed: int, progress: Progress, jobs: int | None = None
) -> StudyResult:
    """Run the study with `grasps` of each tissue."""
    lab = _load_setup(bench)
    cases = draw_cases(lab.library, lab.tool, grasps, seed)
    further = build_out_of_bounds_cases(cases, max(len(cases) // OUT_OF_BOUNDS_INTERVAL, 1))
    jobs_to_do = [(bench, case) for case in [*cases, *(case for those in further.values() for case in those)]]
    outcomes = run_cases(_evaluate_case, jobs_to_do, progress, jobs)
    own, each = outcomes[: len(cases)], len(outcomes[len(cases) :]) // len(further)
    beyond_them = {kind: outcomes[len(cases) + k * each :][:each] for k, kind in enumerate(further)}
    used = {key: value for key, value in asdict(bench).items() if key not in ("protocol", "thickness")}
    study = StudyResult(
        "limiter",
        "Force held under the limit",
        {**used, "grasps": len(cases), "margin": lab.settings.limiter.margin, "seed": seed},
        EXPLANATION,
    )
    study.figures = _figures(own)
    study.parts = [
        _build_table_by(
            "What the limiter is told", own, [told.value for told in ThresholdScenario], lambda o: o.case.scenario.value
        ),
        _build_table_by("Tissue", own, [*lab.library.tissues], lambda o: o.case.tissue),
        _build_table_by(
            "Strength of the tool, times its map",
            own,
            [_format_band(low) for low, _ in GAIN_RATIO_BANDS],
            lambda o: next(_format_band(low) for low, high in GAIN_RATIO_BANDS if low <= o.case.gain_ratio < high),
        ),
        _build_table_by(
            "Ramp",
            own,
            ["slower than 20 V/s", "faster"],
            lambda o: "faster" if o.case.ramp_v_per_s >= FAST_RAMP_V_PER_S else "slower than 20 V/s",
        ),
        _build_out_of_bounds_table(beyond_them),
        ("Highest force, as a share of the limit in force", _plot_peaks(own)),
        ("A liver that is named, until the estimator dies", _plot_example(lab)),
    ]
    return study


def _load_setup(bench: StudyConditions) -> StudySetup:
    lab = load_study_setup(bench)
    limits = lab.tool.limits.model_copy(update={"max_command_v": MAX_BOARD_COMMAND_V})
    return replace(lab, tool=lab.tool.model_copy(update={"limits": limits}))


def _evaluate_case(job: tuple[StudyConditions, LimitedCase]) -> LimiterOutcome:
    bench, case = job
    lab = _load_setup(bench)
    with_it = simulate_limited(case, lab.tool, lab.library, lab.settings)
    without_n = simulate_unlimited_force(case, lab.tool, lab.library)
    return measure_outcome(case, lab.tool, lab.library, lab.settings.limiter.margin, with_it, without_n)


def _figures(outcomes: list[LimiterOutcome]) -> list[KeyFigure]:
    touched = [o for o in outcomes if o.made_contact]
    return [
        KeyFigure(
            "over the limit in force",
            _compute_percent(o.peak_share > 1 for o in outcomes),
            "%",
            at_most=MAX_OVER_LIMIT_PERCENT,
        ),
        KeyFigure(
            "furthest over it",
            _compute_max_excess_percent(o.peak_share for o in outcomes),
            "%",
            at_most=MAX_OVERSHOOT_PERCENT,
        ),
        KeyFigure("without the limiter: over it", _compute_percent(o.unlimited_peak_share > 1 for o in outcomes), "%"),
        KeyFigure(
            "without the limiter: furthest over it",
            _compute_max_excess_percent(o.unlimited_peak_share for o in outcomes),
            "%",
        ),
        KeyFigure(
            "hold at least 60 % of the allowed force",
            _compute_percent(o.allowed_force_share >= MIN_HOLD_SHARE for o in touched),
            "%",
            at_least=MIN_HOLDING_PERCENT,
        ),
        KeyFigure(
            "allowed force that is held, median of those held back",
            _compute_quantile(100 * o.allowed_force_share for o in touched if o.limited),
            "%",
        ),
        KeyFigure(
            "allowed force that is held, least", 100 * min((o.allowed_force_share for o in touched), default=0.0), "%"
        ),
        KeyFigure(
            "overshoot over what is held, median",
            _compute_quantile(_drop_missing(o.overshoot for o in outcomes), 100),
            "%",
        ),
        KeyFigure(
            "overshoot over what is held, 99 in 100 below",
            _compute_quantile(_drop_missing(o.overshoot for o in outcomes), 100, 0.99),
            "%",
        ),
        KeyFigure(
            "settling time since contact, median",
            _compute_quantile(_drop_missing(o.settling_s for o in outcomes), 1e3),
            "ms",
        ),
        KeyFigure(
            "settling time since contact, fast ramps, median",
            _compute_quantile(
                _drop_missing(o.settling_s for o in outcomes if o.case.ramp_v_per_s >= FAST_RAMP_V_PER_S), 1e3
            ),
            "ms",
        ),
        KeyFigure("command reversals a second while held", float(np.mean([o.reversals_per_s for o in outcomes])), ""),
        KeyFigure(
            "over a limit that fell, 99 in 100 shorter",
            _compute_quantile(_drop_missing(o.over_lowered_limit_s for o in outcomes), 1e3, 0.99),
            "ms",
        ),
        KeyFigure("let go", _compute_percent(o.released for o in outcomes), "%"),
        KeyFigure(
            "ended as a fault: sound sensors taken for lost", _compute_percent(bool(o.fault) for o in outcomes), "%"
        ),
        KeyFigure(
            "over the held tissue's own threshold",
            _compute_percent(o.exceeds_threshold for o in outcomes),
            "%",
            note="only where another tissue's threshold is told",
        ),
        KeyFigure(
            "without the limiter: over the held tissue's own threshold",
            _compute_percent(o.unlimited_exceeds_threshold for o in outcomes),
            "%",
        ),
    ]


def _build_table_by(
    title: str, outcomes: list[LimiterOutcome], kinds: list[str], kind_of: Callable[[LimiterOutcome], str]
) -> Table:
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


def _row(those: list[LimiterOutcome]) -> list[float | int | None]:
    if not those:
        return [0, *[None] * 8]
    return [
        len(those),
        _compute_percent(o.peak_share > 1 for o in those),
        _compute_max_excess_percent(o.peak_share for o in those),
        _compute_percent(o.unlimited_peak_share > 1 for o in those),
        _compute_max_excess_percent(o.unlimited_peak_share for o in those),
        _compute_percent(o.exceeds_threshold for o in those),
        _compute_percent(o.unlimited_exceeds_threshold for o in those),
        _compute_percent(o.allowed_force_share >= MIN_HOLD_SHARE for o in those if o.made_contact),
        _compute_quantile(100 * o.allowed_force_share for o in those if o.made_contact and o.limited),
    ]


def _build_out_of_bounds_table(outcomes: dict[str, list[LimiterOutcome]]) -> Table:
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
            _compute_percent(o.peak_share > 1 for o in those),
            _compute_max_excess_percent(o.peak_share for o in those),
            _compute_percent(o.released for o in those),
            _compute_percent(o.later_peak_share > 1 for o in those),
            _compute_max_excess_percent(o.later_peak_share for o in those),
            _compute_percent(o.released_later for o in those),
            _compute_percent(o.allowed_force_share >= MIN_HOLD_SHARE for o in those if o.made_contact),
        ]
        for kind, those in outcomes.items()
    ]
    note = "Two grasps in a row on fast ramps, another tissue's threshold told; all else as above but the strength."
    return Table("Beyond what a limiter can know", columns, rows, note)


def _format_band(low: float) -> str:
    high = next(high for begin, high in GAIN_RATIO_BANDS if begin == low)
    return f"below {high:g}" if low == 0 else f"from {low:g}" if high > 2 else f"{low:g} to {high:g}"


def _drop_missing(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _compute_percent(each: Iterable[bool]) -> float:
    found = list(each)
    return 100 * sum(found) / max(len(found), 1)


def _compute_max_excess_percent(peaks: Iterable[float]) -> float:
    """Return how far the highest peak is over the limit, %; 0 if none is."""
    return 100 * max(0.0, *(peak - 1.0 for peak in peaks))


def _compute_quantile(values: Iterable[float], times: float = 1.0, quantile: float = 0.5) -> float | None:
    found = list(values)
    return times * float(np.quantile(found, quantile)) if found else None


def _plot_peaks(outcomes: list[LimiterOutcome]) -> go.Figure:
    figure = go.Figure()
    shares = np.arange(1, len(outcomes) + 1) / len(outcomes)
    for name, peaks, colour in (
        ("with the limiter", [o.peak_share for o in outcomes], PALETTE[0]),
        ("without", [o.unlimited_peak_share for o in outcomes], PALETTE[1]),
    ):
        figure.add_scatter(x=np.sort(peaks), y=shares, name=name, line={"color": colour, "shape": "hv"})
    figure.add_vline(x=1.0, line={"color": "#000000", "dash": "dash", "width": 1})
    figure.update_layout(xaxis_title="highest force / limit in force", yaxis_title="share of grasps")
    return figure


def _plot_example(lab: StudySetup) -> go.Figure:
    figure = go.Figure()
    with_it, without_n = (
        simulate_limited(EXAMPLE_CASE, lab.tool, lab.library, lab.settings),
        simulate_unlimited_force(EXAMPLE_CASE, lab.tool, lab.library),
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
