"""A report as one self-contained HTML page."""

import html
import json
from collections import Counter
from pathlib import Path
from typing import Any

from plotly.offline import get_plotlyjs

from app.analysis.report.grasp_table import render_grasp_table
from app.analysis.report.plot_data import MAX_TIME_PLOTS, build_plot_data, curve_stride
from app.analysis.report.report import Progress, Report, collect_versions
from app.analysis.report.statistics_tables import build_statistics_tables
from app.analysis.report.stylesheet import REPORT_CSS
from estimator.studies.html_page import Table, format_value, render_page, render_table

PAGE_KIND = "Graspwatch report"


def render_report_page(report: Report, progress: Progress) -> str:
    """Render a report as one self-contained HTML page; `progress` receives the share done."""
    data = build_plot_data(report, progress)
    body = "".join(
        [
            _render_summary(report),
            _render_grasps(report, data),
            _render_time_plots(report, data),
            _render_stress(report),
            _render_statistics(report),
            _render_method(report, data),
            _render_scripts(data),
        ]
    )
    return render_page(report.title, body, REPORT_CSS, kind=PAGE_KIND)


def _render_summary(report: Report) -> str:
    links = [
        ("grasps", "Grasps"),
        ("courses", "Courses"),
        ("stress", "Stress over strain"),
        ("statistics", "Statistics"),
        ("how", "How it was made"),
    ]
    menu = "".join(f'<li><a href="#{name}">{title}</a></li>' for name, title in links)
    rows = []
    for analyzed in report.recordings:
        verdicts = Counter(report.tissue_styles[grasp.label].title for grasp in analyzed.grasps)
        alarms = sum(bool(analyzed.grasp_alarms(grasp)) for grasp in analyzed.grasps)
        rows.append(
            [
                analyzed.title,
                f"{analyzed.duration_s:.1f} s",
                analyzed.lost_samples,
                _group_title(report, report.labels.get(analyzed.title) or analyzed.tissue),
                len(analyzed.grasps),
                sum(not grasp.valid for grasp in analyzed.grasps),
                ", ".join(f"{count} {name}" for name, count in verdicts.most_common()) or "none",
                alarms,
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
    facts = "".join(
        f"<li>{html.escape(key)}: {html.escape(format_value(value))}</li>"
        for key, value in (report.recordings[0].facts.items() if len(report.recordings) == 1 else ())
    )
    tools = ", ".join(dict.fromkeys(story.tool.title for story in report.recordings))
    scales = "; ".join(dict.fromkeys(story.tool.scale_text for story in report.recordings))
    return (
        f'<nav class="screen-only" aria-label="Sections"><ul class="menu">{menu}</ul></nav>'
        f'<ul class="facts">{facts}<li>tool: {html.escape(tools)}</li>'
        f"<li>forces: {html.escape(scales)}</li>"
        f"<li>library: {html.escape(report.library.title)}</li></ul>"
        + render_table(Table("What was recorded and found", columns, rows), heading=False)
    )


def _group_title(report: Report, name: str | None) -> str | None:
    look = report.tissue_styles.get(name) if name else None
    return look.title if look else name


def _render_grasps(report: Report, data: dict[str, Any]) -> str:
    if not report.grasps:
        return '<section id="grasps"><h2>Grasps</h2><p>No grasp was found: the command never left zero.</p></section>'
    drawn = len(data["grasps"])
    more = f"The first {drawn} grasps can be looked at one by one. " if drawn < len(report.grasps) else ""
    return (
        '<section id="grasps"><h2>Grasps</h2><p class="screen-only">Choose a grasp to see it below at full sharpness. '
        f"{more}</p>{render_grasp_table(report, drawn)}</section>"
        '<section id="grasp"><div class="row"><h2 id="grasp-title" aria-live="polite">Grasp</h2>'
        '<div class="screen-only"><button type="button" id="grasp-before">Previous grasp</button> '
        '<button type="button" id="grasp-after">Next grasp</button></div></div>'
        + _render_figure("grasp-course", "Force, displacement, probabilities and parameters of the grasp over time")
        + _render_figure("grasp-stress", "Stress over strain of the grasp, on the library's curves with their spread")
        + "</section>"
    )


def _render_time_plots(report: Report, data: dict[str, Any]) -> str:
    if not data["courses"]:
        why = f"There are more than {MAX_TIME_PLOTS} recordings: only their grasps are drawn, one by one."
        return f'<section id="courses"><h2>Courses</h2><p>{why}</p></section>'
    parts = "".join(
        f"<h3>{html.escape(analyzed.title)}</h3>"
        + _render_figure(f"course-{number}", f"The whole of {analyzed.title} over time", course=number)
        for number, analyzed in enumerate(report.recordings)
    )
    return f'<section id="courses"><h2>Courses</h2>{parts}</section>'


def _render_stress(report: Report) -> str:
    every = curve_stride(len(report.grasps))
    which = f"One grasp in {every}" if every > 1 else "Every grasp"
    words = (
        f"Thick lines: the library, with a band of one standard deviation between specimens. {which} while it closed: "
        "thin, in the colour of what was held, damping taken off. The axes end where the highest injury threshold "
        "does; double-click to see everything."
    )
    drawn = _render_figure("stress-all", "Stress over strain of the grasps, on the library's curves", figure="stress")
    return (
        f'<section id="stress"><h2>Stress over strain</h2><p class="note">{words}</p>'
        f"{drawn if report.grasps else '<p>There is no grasp to draw.</p>'}</section>"
    )


def _render_statistics(report: Report) -> str:
    found = report.statistics
    if not found.groups:
        said = "There is no valid grasp to count." if report.grasps else "There is no grasp to count."
        return f'<section id="statistics"><h2>Statistics</h2><p>{said}</p>{_render_excluded_grasps(report)}</section>'
    tables = build_statistics_tables(found, report.library, report.tissue_styles)
    told = " or ".join(found.truth_sources)
    intro = f"Grasps are grouped by what was held, as told by {told}. "
    if found.excluded:
        intro += f"Of {len(report.grasps)} grasps {len(found.excluded)} are left out; they are listed at the end."
    boxes = _render_figure("boxes", "Box plots of α, β and d at the end of each grasp, by group", figure="boxes")
    return (
        f'<section id="statistics"><h2>Statistics</h2><p>{intro}</p>'
        + "".join(render_table(one, level=3) for one in tables[:2])
        + f'<h3>Figure 8: parameters at the end of each grasp</h3>{boxes}<p class="note">Box: quartiles and median; '
        "whiskers reach to the last grasp within 1.5 times the quartiles' distance; every grasp beyond is a dot. "
        "Diamond: the library's own value.</p>"
        + "".join(render_table(one, level=3) for one in tables[2:])
        + _render_tukey_notes(report)
        + _render_excluded_grasps(report)
        + "</section>"
    )


def _render_tukey_notes(report: Report) -> str:
    """Render a sentence for each reason why Tukey's test left something out."""
    said: list[str] = []
    for one in report.statistics.tukey.values():
        said += [one.skip_reason] if one.skip_reason else []
        if one.too_small_groups and one.pairs:
            names = ", ".join(report.tissue_styles[name].title for name in one.too_small_groups)
            said.append(f"Not compared, because a single grasp has no spread: {names}.")
    return "".join(f"<p>{html.escape(text)}</p>" for text in dict.fromkeys(said))


def _render_excluded_grasps(report: Report) -> str:
    numbers: dict[tuple[str, str], list[int]] = {}
    for one, why in report.statistics.excluded:
        numbers.setdefault((why, one.source), []).append(one.record.index)
    if not numbers:
        return ""
    rows = [[why, source, len(own), _format_ranges(own)] for (why, source), own in numbers.items()]
    return render_table(Table("Left out of the statistics", ["why", "recording", "grasps", "which"], rows), level=3)


def _format_ranges(numbers: list[int]) -> str:
    """Format rising numbers as ranges, such as 1 to 3, 5."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)


def _render_method(report: Report, data: dict[str, Any]) -> str:
    rate_hz = report.recordings[0].rate_hz

    def describe_thinning(courses: list[dict[str, Any]]) -> str:
        coarsest = max((one["step_s"] for one in courses), default=1 / rate_hz)
        if coarsest <= 1.001 / rate_hz:
            return "are drawn sample by sample"
        return f"are thinned: each pair of points is the least and the greatest of up to {2e3 * coarsest:.0f} ms"

    parts = [f"Courses {describe_thinning(data['courses'])}."] if data["courses"] else []
    if data["grasps"]:
        parts.append(f"Single grasps {describe_thinning([grasp['course'] for grasp in data['grasps']])}.")
    made = ", ".join(f"{name} {version}" for name, version in collect_versions().items())
    return (
        f'<section id="how"><h2>How it was made</h2><p>{" ".join(parts)} No peak is lost by thinning. Everything '
        "else is computed from all samples. Grey: the force as the filters take it, and how far the jaws moved; black "
        "force: after the 10 Hz low-pass. Dotted lines: the library's own parameters; a filter "
        "that runs away from them leaves the picture, and a double-click shows where to.</p>"
        f'<p class="settings">{html.escape(made)}</p></section>'
    )


def _render_figure(name: str, label: str, **what: Any) -> str:
    data = "".join(f' data-{key}="{value}"' for key, value in what.items())
    return f'<figure aria-label="{html.escape(label)}"><div class="plotly-graph-div" id="{name}"{data}></div></figure>'


def _render_scripts(data: dict[str, Any]) -> str:
    packed = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    ours = Path(__file__).with_name("viewer.js").read_text(encoding="utf-8")
    return (
        "<noscript><p>The plots need JavaScript; the tables do not.</p></noscript>"
        f"<script>{get_plotlyjs()}</script>"
        f'<script type="application/json" id="report-data">{packed}</script><script>{ours}</script>'
    )
