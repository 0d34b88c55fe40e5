"""A report as one self-contained HTML page."""

import html
import json
from collections import Counter
from pathlib import Path
from typing import Any

from plotly.offline import get_plotlyjs

from app.report.drawing import COURSES_SHOWN, drawn_by_script, one_in
from app.report.grasp_table import grasp_table
from app.report.report import Progress, Report, versions
from app.report.style import STYLE
from app.report.tables import statistics_tables
from estimator.studies.page import Table, document, shown, table

KIND = "Graspwatch report"


def page(report: Report, progress: Progress) -> str:
    """The whole page."""
    data = drawn_by_script(report, progress)
    body = "".join(
        [
            _summary(report),
            _grasps(report, data),
            _courses(report, data),
            _stress(report),
            _statistics(report),
            _how(report, data),
            _script(data),
        ]
    )
    return document(report.title, body, STYLE, kind=KIND)


def _summary(report: Report) -> str:
    links = [
        ("grasps", "Grasps"),
        ("courses", "Courses"),
        ("stress", "Stress over strain"),
        ("statistics", "Statistics"),
        ("how", "How it was made"),
    ]
    menu = "".join(f'<li><a href="#{name}">{title}</a></li>' for name, title in links)
    rows = []
    for story in report.stories:
        verdicts = Counter(report.looks[grasp.label].title for grasp in story.grasps)
        alarms = sum(bool(story.alarms_of(grasp)) for grasp in story.grasps)
        rows.append(
            [
                story.title,
                f"{story.duration_s:.1f} s",
                story.lost_samples,
                _title(report, report.labels.get(story.title) or story.tissue),
                len(story.grasps),
                sum(not grasp.valid for grasp in story.grasps),
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
        f"<li>{html.escape(key)}: {html.escape(shown(value))}</li>"
        for key, value in (report.stories[0].facts.items() if len(report.stories) == 1 else ())
    )
    tools = ", ".join(dict.fromkeys(story.tool.title for story in report.stories))
    scales = "; ".join(dict.fromkeys(story.tool.scale_in_words for story in report.stories))
    return (
        f'<nav class="screen-only" aria-label="Sections"><ul class="menu">{menu}</ul></nav>'
        f'<ul class="facts">{facts}<li>tool: {html.escape(tools)}</li>'
        f"<li>forces: {html.escape(scales)}</li>"
        f"<li>library: {html.escape(report.library.title)}</li></ul>"
        + table(Table("What was recorded and found", columns, rows), heading=False)
    )


def _title(report: Report, name: str | None) -> str | None:
    look = report.looks.get(name) if name else None
    return look.title if look else name


def _grasps(report: Report, data: dict[str, Any]) -> str:
    if not report.grasps:
        return '<section id="grasps"><h2>Grasps</h2><p>No grasp was found: the command never left zero.</p></section>'
    drawn = len(data["grasps"])
    more = f"The first {drawn} grasps can be looked at one by one. " if drawn < len(report.grasps) else ""
    return (
        '<section id="grasps"><h2>Grasps</h2><p class="screen-only">Choose a grasp to see it below at full sharpness. '
        f"{more}</p>{grasp_table(report, drawn)}</section>"
        '<section id="grasp"><div class="row"><h2 id="grasp-title" aria-live="polite">Grasp</h2>'
        '<div class="screen-only"><button type="button" id="grasp-before">Previous grasp</button> '
        '<button type="button" id="grasp-after">Next grasp</button></div></div>'
        + _figure("grasp-course", "Force, displacement, probabilities and parameters of the grasp over time")
        + _figure("grasp-stress", "Stress over strain of the grasp, on the library's curves with their spread")
        + "</section>"
    )


def _courses(report: Report, data: dict[str, Any]) -> str:
    if not data["courses"]:
        why = f"There are more than {COURSES_SHOWN} recordings: only their grasps are drawn, one by one."
        return f'<section id="courses"><h2>Courses</h2><p>{why}</p></section>'
    parts = "".join(
        f"<h3>{html.escape(story.title)}</h3>"
        + _figure(f"course-{number}", f"The whole of {story.title} over time", course=number)
        for number, story in enumerate(report.stories)
    )
    return f'<section id="courses"><h2>Courses</h2>{parts}</section>'


def _stress(report: Report) -> str:
    every = one_in(len(report.grasps))
    which = f"One grasp in {every}" if every > 1 else "Every grasp"
    words = (
        f"Thick lines: the library, with a band of one standard deviation between specimens. {which} while it closed: "
        "thin, in the colour of what was held, damping taken off. The axes end where the highest injury threshold "
        "does; double-click to see everything."
    )
    drawn = _figure("stress-all", "Stress over strain of the grasps, on the library's curves", figure="stress")
    return (
        f'<section id="stress"><h2>Stress over strain</h2><p class="note">{words}</p>'
        f"{drawn if report.grasps else '<p>There is no grasp to draw.</p>'}</section>"
    )


def _statistics(report: Report) -> str:
    found = report.statistics
    if not found.groups:
        said = "There is no valid grasp to count." if report.grasps else "There is no grasp to count."
        return f'<section id="statistics"><h2>Statistics</h2><p>{said}</p>{_left_out(report)}</section>'
    tables = statistics_tables(found, report.library, report.looks)
    told = " or ".join(found.told)
    intro = f"Grasps are grouped by what was held, as told by {told}. "
    if found.left_out:
        intro += f"Of {len(report.grasps)} grasps {len(found.left_out)} are left out; they are listed at the end."
    boxes = _figure("boxes", "Box plots of α, β and d at the end of each grasp, by group", figure="boxes")
    return (
        f'<section id="statistics"><h2>Statistics</h2><p>{intro}</p>'
        + "".join(table(one, level=3) for one in tables[:2])
        + f'<h3>Figure 8: parameters at the end of each grasp</h3>{boxes}<p class="note">Box: quartiles and median; '
        "whiskers reach to the last grasp within 1.5 times the quartiles' distance; every grasp beyond is a dot. "
        "Diamond: the library's own value.</p>"
        + "".join(table(one, level=3) for one in tables[2:])
        + _cautions(report)
        + _left_out(report)
        + "</section>"
    )


def _cautions(report: Report) -> str:
    """What Tukey's test could not do, in a sentence each."""
    said: list[str] = []
    for one in report.statistics.tukey.values():
        said += [one.why_not] if one.why_not else []
        if one.too_small and one.pairs:
            names = ", ".join(report.looks[name].title for name in one.too_small)
            said.append(f"Not compared, because a single grasp has no spread: {names}.")
    return "".join(f"<p>{html.escape(text)}</p>" for text in dict.fromkeys(said))


def _left_out(report: Report) -> str:
    numbers: dict[tuple[str, str], list[int]] = {}
    for one, why in report.statistics.left_out:
        numbers.setdefault((why, one.source), []).append(one.record.index)
    if not numbers:
        return ""
    rows = [[why, source, len(own), _ranges(own)] for (why, source), own in numbers.items()]
    return table(Table("Left out of the statistics", ["why", "recording", "grasps", "which"], rows), level=3)


def _ranges(numbers: list[int]) -> str:
    """Rising numbers in words: 1 to 3, 5."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return ", ".join(str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)


def _how(report: Report, data: dict[str, Any]) -> str:
    rate_hz = report.stories[0].rate_hz

    def pairs(courses: list[dict[str, Any]]) -> str:
        coarsest = max((one["step_s"] for one in courses), default=1 / rate_hz)
        if coarsest <= 1.001 / rate_hz:
            return "are drawn sample by sample"
        return f"are thinned: each pair of points is the least and the greatest of up to {2e3 * coarsest:.0f} ms"

    parts = [f"Courses {pairs(data['courses'])}."] if data["courses"] else []
    if data["grasps"]:
        parts.append(f"Single grasps {pairs([grasp['course'] for grasp in data['grasps']])}.")
    made = ", ".join(f"{name} {version}" for name, version in versions().items())
    return (
        f'<section id="how"><h2>How it was made</h2><p>{" ".join(parts)} No peak is lost by thinning. Everything '
        "else is computed from all samples. Grey: the force as the filters take it, and how far the jaws moved; black "
        "force: after the 10 Hz low-pass. Dotted lines: the library's own parameters; a filter "
        "that runs away from them leaves the picture, and a double-click shows where to.</p>"
        f'<p class="settings">{html.escape(made)}</p></section>'
    )


def _figure(name: str, label: str, **what: Any) -> str:
    data = "".join(f' data-{key}="{value}"' for key, value in what.items())
    return f'<figure aria-label="{html.escape(label)}"><div class="plotly-graph-div" id="{name}"{data}></div></figure>'


def _script(data: dict[str, Any]) -> str:
    packed = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    ours = Path(__file__).with_name("viewer.js").read_text(encoding="utf-8")
    return (
        "<noscript><p>The plots need JavaScript; the tables do not.</p></noscript>"
        f"<script>{get_plotlyjs()}</script>"
        f'<script type="application/json" id="report-data">{packed}</script><script>{ours}</script>'
    )
