"""The function that builds a report's table of grasps: verdict, probability, time to decision, parameters, warnings."""

from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from app.analysis.report.recording_analyzer import AnalyzedRecording
from app.analysis.report.report import Report
from app.analysis.report.sparkline import render_sparkline
from app.analysis.report.statistics import Observation
from app.analysis.report.tissue_styles import TissueStyle
from estimator.decision import UNDECIDED
from estimator.estimate_block import GraspRecord

COLUMNS = [
    "grasp",
    "force",
    "start, s",
    "verdict",
    "probability",
    "decided after, ms",
    "peak force, N",
    "of the limit",
    "force × time, N s",
    "peak displacement, mm",
    "α, N",
    "β, 1/m",
    "d, kg/s",
    "convergence, s",
    "force error, N",
    "warnings",
    "remarks",
]
TEXT_COLUMNS = {"force", "start, s", "verdict", "probability", "warnings", "remarks"}

# Texts that are put into these are escaped.
BUTTON = Markup('<button type="button" data-grasp="{}" aria-label="Grasp {} of {}">{}</button>')
VERDICT = Markup('<span class="mark" style="background: {}; color: {}">{}</span> {}')


@dataclass(frozen=True, slots=True)
class GraspTable:
    """The table's columns, those of them that hold words, and each recording's title with its rows."""

    columns: list[str]
    text_columns: set[str]
    groups: list[tuple[str, list[list[Any]]]]


def build_grasp_table(report: Report, drawn_count: int) -> GraspTable:
    """Build the table; the first `drawn_count` grasps have a button that draws them."""
    groups, number = [], 0
    for analyzed in report.recordings:
        own = [(record, observation) for told_by, record, observation in report.grasps if told_by is analyzed]
        most_n = max((record.peak_force_n or 0.0 for record, _ in own), default=0.0)
        rows = []
        for record, observation in own:
            name = BUTTON.format(number, record.index, analyzed.title, record.index)
            heading = name if number < drawn_count else record.index
            rows.append([heading, *_build_cells(report, analyzed, record, observation, most_n)])
            number += 1
        groups.append((analyzed.title, rows))
    return GraspTable(COLUMNS, TEXT_COLUMNS, groups)


def _build_cells(
    report: Report, recording: AnalyzedRecording, record: GraspRecord, observation: Observation, max_force_n: float
) -> list[Any]:
    traces = recording.grasp_traces(record)
    decided, moved = record.time_to_decision_s, record.peak_displacement_m
    return [
        render_sparkline(traces["tick"], traces["jaw_force_filtered_n"], traces["limit_n"], max_force_n),
        f"{record.start_s:.3f}",
        _render_verdict(report.tissue_styles[record.label]),
        format_percent(record.probability),
        None if decided is None else round(1e3 * decided),
        record.peak_force_n,
        _format_percent_of_limit(record.peak_share_of_limit),
        record.dose_n_s,
        None if moved is None else 1e3 * moved,
        record.alpha_n,
        record.beta_per_m,
        record.damping_kg_per_s,
        observation.convergence_s,
        observation.force_error_n,
        _format_warnings(recording, record),
        _format_remarks(report, recording, record, observation),
    ]


def _render_verdict(tissue_style: TissueStyle) -> Markup:
    return VERDICT.format(tissue_style.color, tissue_style.text_color, tissue_style.abbreviation, tissue_style.title)


def format_likeliest(report: Report, probabilities: dict[str, float]) -> str:
    """Format the likeliest answer: its title and probability."""
    top, share = max(probabilities.items(), key=lambda each: each[1])
    return f"{report.tissue_styles[top].title}, {format_percent(share)}"


def format_percent(share: float | None) -> str | None:
    """Format a share so that one below 1 is never rounded to 100 %."""
    if share is None:
        return None
    return "> 99 %" if 0.99 < share < 1 else f"{100 * share:.0f} %"


def _format_percent_of_limit(share: float | None) -> str | None:
    return None if share is None else f"{100 * share:.0f} %"


def _format_warnings(recording: AnalyzedRecording, record: GraspRecord) -> str:
    return ", ".join(f"{alarm.priority} ({alarm.force_n:.2f} N)" for alarm in recording.grasp_alarms(record))


def _format_remarks(report: Report, recording: AnalyzedRecording, record: GraspRecord, observation: Observation) -> str:
    said = [record.why_invalid] if record.why_invalid else []
    if record.label == UNDECIDED and record.probabilities:
        said.append(f"likeliest: {format_likeliest(report, record.probabilities)}")
    for one in recording.withdrawals:
        if one.grasp == record.index:
            after_s = one.tick / recording.rate_hz - record.start_s
            said.append(f"{report.tissue_styles[one.label].title} withdrawn {after_s:.2f} s after its start")
    if observation.diverged:
        said.append(f"filter of {report.tissue_styles[observation.filter_tissue].title} diverged")
    return "; ".join(said)
