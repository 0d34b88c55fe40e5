"""The function that renders a report as one HTML page; the template `report.html.jinja` holds its words."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

from markupsafe import Markup
from plotly.offline import get_plotlyjs

from app.analysis.report.grasp_table import build_grasp_table, format_likeliest
from app.analysis.report.plot_data import MAX_TIME_PLOTS, build_plot_data, curve_stride
from app.analysis.report.report import Progress, Report, collect_versions
from app.analysis.report.statistics_tables import build_statistics_tables
from app.recordings.answer_advice import explain_missing_answers
from estimator.studies.html_page import Table, render_template

PAGE_KIND = "Graspwatch report"
TEMPLATES = Path(__file__).with_name("templates")


def render_report_page(report: Report, progress: Progress) -> str:
    """Return a report as one self-contained HTML page; `progress` receives the share done."""
    data = build_plot_data(report, progress)
    drawn = len(data["grasps"])
    packed = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return render_template(
        "report.html.jinja",
        TEMPLATES,
        kind=PAGE_KIND,
        title=report.title,
        facts=_build_facts(report),
        summary=_build_summary(report),
        grasps=build_grasp_table(report, drawn) if report.grasps else None,
        grasp_count=len(report.grasps),
        advice=_build_advice(report),
        spots=_build_spots(report),
        drawn=drawn,
        courses=[each.title for each in report.recordings] if data["courses"] else [],
        max_time_plots=MAX_TIME_PLOTS,
        curve_stride=curve_stride(len(report.grasps)),
        statistics=_build_statistics(report) if report.statistics.groups else None,
        excluded=_build_excluded_grasps(report),
        excluded_count=len(report.statistics.excluded),
        course_thinning=_describe_thinning(report, data["courses"]),
        grasp_thinning=_describe_thinning(report, [grasp["course"] for grasp in data["grasps"]]),
        versions=collect_versions(),
        plotly=Markup(get_plotlyjs()),
        data=Markup(packed),
        viewer=Markup(Path(__file__).with_name("viewer.js").read_text(encoding="utf-8")),
    )


def _build_facts(report: Report) -> dict[str, Any]:
    """Return what the head of the page says; of a single recording also its own facts."""
    return {
        **(report.recordings[0].facts if len(report.recordings) == 1 else {}),
        "tool": ", ".join(dict.fromkeys(each.tool.title for each in report.recordings)),
        "forces": "; ".join(dict.fromkeys(each.tool.scale_text for each in report.recordings)),
        "library": report.library.title,
    }


def _build_summary(report: Report) -> Table:
    rows = []
    for analyzed in report.recordings:
        verdicts = Counter(report.tissue_styles[grasp.label].title for grasp in analyzed.grasps)
        rows.append(
            [
                analyzed.title,
                f"{analyzed.duration_s:.1f} s",
                analyzed.lost_samples,
                _find_group_title(report, report.labels.get(analyzed.title) or analyzed.tissue),
                len(analyzed.grasps),
                sum(not grasp.valid for grasp in analyzed.grasps),
                ", ".join(f"{count} {name}" for name, count in verdicts.most_common()) or "none",
                sum(bool(analyzed.grasp_alarms(grasp)) for grasp in analyzed.grasps),
            ]
        )
    columns = [
        "recording",
        "duration",
        "lost samples",
        "held",
        "grasps",
        "invalid",
        "verdicts",
        "grasps with a warning",
    ]
    return Table("What was recorded and found", columns, rows)


def _build_advice(report: Report) -> dict[str, str]:
    """Return why no grasp of a recording got a name, by the recording's title."""
    advice = ((one.title, explain_missing_answers(one.tool, one.library, one.grasps)) for one in report.recordings)
    return {title: text for title, text in advice if text}


def _build_spots(report: Report) -> Table:
    rows = [
        [
            analyzed.title,
            spot.index,
            f"{spot.began_s:.1f} s",
            ", ".join(map(str, spot.grasps)) or "none",
            report.tissue_styles[spot.label].title,
            format_likeliest(report, spot.probabilities) if spot.grasps else None,
            spot.dose_n_s,
        ]
        for analyzed in report.recordings
        for spot in analyzed.spots
    ]
    return Table(
        "One answer for each spot, from all its grasps together",
        ["recording", "spot", "began at", "grasps", "verdict", "likeliest", "force × time, N s"],
        rows,
    )


def _find_group_title(report: Report, name: str | None) -> str | None:
    look = report.tissue_styles.get(name) if name else None
    return look.title if look else name


def _build_statistics(report: Report) -> dict[str, Any]:
    found = report.statistics
    return {
        "truth_sources": found.truth_sources,
        "tables": build_statistics_tables(found, report.library, report.tissue_styles),
        "notes": _describe_missing_comparisons(report),
    }


def _describe_missing_comparisons(report: Report) -> list[str]:
    """Return a sentence for each reason why Tukey's test left something out."""
    said: list[str] = []
    for one in report.statistics.tukey.values():
        said += [one.skip_reason] if one.skip_reason else []
        if one.too_small_groups and one.pairs:
            names = ", ".join(report.tissue_styles[name].title for name in one.too_small_groups)
            said.append(f"Not compared, because a single grasp has no spread: {names}.")
    return list(dict.fromkeys(said))


def _build_excluded_grasps(report: Report) -> Table:
    numbers: dict[tuple[str, str], list[int]] = {}
    for one, why in report.statistics.excluded:
        numbers.setdefault((why, one.source), []).append(one.record.index)
    rows: list[list[Any]] = [[why, source, len(own), _format_ranges(own)] for (why, source), own in numbers.items()]
    return Table("Left out of the statistics", ["why", "recording", "grasps", "which"], rows)


def _format_ranges(numbers: list[int]) -> str:
    """Format rising numbers as ranges, such as 1 to 3, 5."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)


def _describe_thinning(report: Report, courses: list[dict[str, Any]]) -> str | None:
    """Return how courses are drawn, or None if there are none."""
    rate_hz = report.recordings[0].rate_hz
    coarsest = max((one["step_s"] for one in courses), default=None)
    if coarsest is None:
        return None
    if coarsest <= 1.001 / rate_hz:
        return "are drawn sample by sample"
    return f"are thinned: each pair of points is the least and the greatest of up to {2e3 * coarsest:.0f} ms"
