"""What the page's script draws: courses and grasps, packed, and figures as they are; within a page's size."""

from typing import Any

import numpy as np

from app.report.plots import Channel, alarm_marks, bare, box_plots, channels, course, course_template, verdict_bars
from app.report.report import READING, Progress, Report
from app.report.stress import add_grasp, curve_of, references
from estimator.studies.page import plain

COURSES_SHOWN = 24  # recordings; the grasps of more are shown one by one only
GRASPS_DRAWN = 1000  # more are in the table only
COURSE_BYTES, GRASP_BYTES = 2_500_000, 4_000_000  # of all courses together, and of all grasps' own
COURSE_POINTS, GRASP_POINTS, LEAST_POINTS = 3000, 2000, 80
BYTES_A_POINT = 8 / 3  # 16 bits in base64
CURVES_TOGETHER = 60  # in the plot of all grasps


def drawn_by_script(report: Report, progress: Progress) -> dict[str, Any]:
    """Ready for JSON; `viewer.js` knows the names."""
    library, looks = report.library, report.looks
    lines = channels(library, looks)
    figures = {"references": bare(references(library, looks))}
    if report.grasps:
        figures["stress"] = _all_curves(report)
    if report.statistics.groups:
        figures["boxes"] = box_plots(report.statistics, library, looks)
    return {
        "course": course_template(library, looks, lines),
        "logarithmic": [line.logarithmic for line in lines],
        "courses": _courses(report, lines) if len(report.stories) <= COURSES_SHOWN else [],
        "grasps": _grasps(report, lines, progress),
        "figures": figures,
    }


def _grasps(report: Report, lines: list[Channel], progress: Progress) -> list[dict[str, Any]]:
    drawn, looks = report.grasps[:GRASPS_DRAWN], report.looks
    most = _points(GRASP_BYTES, len(drawn), len(lines), GRASP_POINTS)
    grasps = []
    for number, (story, grasp, _) in enumerate(drawn, 1):
        marks = verdict_bars([grasp], looks) + alarm_marks(story.alarms_of(grasp), story.rate_hz)
        curve = curve_of(story, grasp)
        grasps.append(
            {
                "title": f"Grasp {grasp.index} of {story.title}: {looks[grasp.label].title}",
                "course": course(story, story.during(grasp), lines, most, marks),
                "strain": _list(curve and curve.strain),
                "measured_kpa": _list(curve and curve.measured_kpa),
                "estimated_kpa": _list(curve and curve.estimated_kpa),
            }
        )
        progress(READING + (1 - READING) * 0.8 * number / len(drawn))
    return grasps


def _courses(report: Report, lines: list[Channel]) -> list[dict[str, Any]]:
    most = _points(COURSE_BYTES, len(report.stories), len(lines), COURSE_POINTS)
    courses = []
    for story in report.stories:
        alarms = [alarm for grasp in story.grasps for alarm in story.alarms_of(grasp)]
        marks = verdict_bars(story.grasps, report.looks) + alarm_marks(alarms, story.rate_hz)
        courses.append(course(story, story.traces, lines, most, marks))
    return courses


def _points(room_bytes: int, of: int, lines: int, most: int) -> int:
    return int(min(max(room_bytes / max(of, 1) / lines / BYTES_A_POINT, LEAST_POINTS), most))


def _all_curves(report: Report) -> dict[str, Any]:
    figure = references(report.library, report.looks)
    for story, grasp, observation in report.grasps[:: one_in(len(report.grasps))]:
        if curve := curve_of(story, grasp):
            look = report.looks.get(observation.group, report.looks[grasp.label])
            add_grasp(figure, curve, f"{story.title}, {grasp.index}", look)
    return bare(figure)


def one_in(grasps: int) -> int:
    """Which share of so many grasps is drawn together: one in this number."""
    return max(1, -(-grasps // CURVES_TOGETHER))


def _list(values: np.ndarray | None) -> list[float] | None:
    return None if values is None else plain([round(float(value), 4) for value in values])
