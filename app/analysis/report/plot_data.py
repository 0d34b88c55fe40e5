"""The function that builds the data that a report's script draws: time plots and figures, within a limit of size."""

from typing import Any

import numpy as np

from app.analysis.report.plots import (
    PlotLine,
    build_alarm_markers,
    build_box_plots,
    build_plot_lines,
    build_time_plot,
    build_time_plot_template,
    build_verdict_bars,
    figure_to_json,
)
from app.analysis.report.report import READING_SHARE, Progress, Report
from app.analysis.report.stress_strain import build_curve, draw_grasp_curve, draw_library_curves
from estimator.studies.html_page import to_json_value

MAX_TIME_PLOTS = 24  # if there are more recordings, only their grasps are plotted, one by one
MAX_GRASP_PLOTS = 1000  # further grasps are in the table only
MAX_TIME_PLOT_BYTES, MAX_GRASP_PLOT_BYTES = 2_500_000, 4_000_000  # of all recordings together, and of all grasps
MAX_TIME_PLOT_POINTS, MAX_GRASP_PLOT_POINTS, MIN_POINTS = 3000, 2000, 80
BYTES_PER_POINT = 8 / 3  # 16 bits in base64
MAX_CURVES = 60  # in the stress plot of all grasps


def build_plot_data(report: Report, progress: Progress) -> dict[str, Any]:
    """Build the data, ready for JSON, under the names that `viewer.js` reads."""
    library, looks = report.library, report.tissue_styles
    lines = build_plot_lines(library, looks)
    figures = {"references": figure_to_json(draw_library_curves(library, looks))}
    if report.grasps:
        figures["stress"] = _build_curve_overview(report)
    if report.statistics.groups:
        figures["boxes"] = build_box_plots(report.statistics, library, looks)
    return {
        "course": build_time_plot_template(library, looks, lines),
        "logarithmic": [line.logarithmic for line in lines],
        "courses": _build_time_plots(report, lines) if len(report.recordings) <= MAX_TIME_PLOTS else [],
        "grasps": _build_grasp_plots(report, lines, progress),
        "figures": figures,
    }


def _build_grasp_plots(report: Report, plot_lines: list[PlotLine], progress: Progress) -> list[dict[str, Any]]:
    drawn, looks = report.grasps[:MAX_GRASP_PLOTS], report.tissue_styles
    most = _limit_points(MAX_GRASP_PLOT_BYTES, len(drawn), len(plot_lines), MAX_GRASP_PLOT_POINTS)
    grasps = []
    for number, (analyzed, grasp, _) in enumerate(drawn, 1):
        marks = build_verdict_bars([grasp], looks) + build_alarm_markers(analyzed.grasp_alarms(grasp), analyzed.rate_hz)
        curve = build_curve(analyzed, grasp)
        grasps.append(
            {
                "title": f"Grasp {grasp.index} of {analyzed.title}: {looks[grasp.label].title}",
                "course": build_time_plot(analyzed, analyzed.grasp_traces(grasp), plot_lines, most, marks),
                "strain": _to_rounded_list(curve and curve.strain),
                "measured_kpa": _to_rounded_list(curve and curve.measured_kpa),
                "estimated_kpa": _to_rounded_list(curve and curve.estimated_kpa),
            }
        )
        progress(READING_SHARE + (1 - READING_SHARE) * 0.8 * number / len(drawn))
    return grasps


def _build_time_plots(report: Report, plot_lines: list[PlotLine]) -> list[dict[str, Any]]:
    most = _limit_points(MAX_TIME_PLOT_BYTES, len(report.recordings), len(plot_lines), MAX_TIME_PLOT_POINTS)
    courses = []
    for analyzed in report.recordings:
        alarms = [alarm for grasp in analyzed.grasps for alarm in analyzed.grasp_alarms(grasp)]
        marks = build_verdict_bars(analyzed.grasps, report.tissue_styles) + build_alarm_markers(
            alarms, analyzed.rate_hz
        )
        courses.append(build_time_plot(analyzed, analyzed.traces, plot_lines, most, marks))
    return courses


def _limit_points(budget_bytes: int, plots: int, lines: int, max_points: int) -> int:
    return int(min(max(budget_bytes / max(plots, 1) / lines / BYTES_PER_POINT, MIN_POINTS), max_points))


def _build_curve_overview(report: Report) -> dict[str, Any]:
    figure = draw_library_curves(report.library, report.tissue_styles)
    for analyzed, grasp, observation in report.grasps[:: curve_stride(len(report.grasps))]:
        if curve := build_curve(analyzed, grasp):
            look = report.tissue_styles.get(observation.group, report.tissue_styles[grasp.label])
            draw_grasp_curve(figure, curve, f"{analyzed.title}, {grasp.index}", look)
    return figure_to_json(figure)


def curve_stride(grasps: int) -> int:
    """Return n such that every n-th grasp is drawn in the stress plot of all grasps."""
    return max(1, -(-grasps // MAX_CURVES))


def _to_rounded_list(values: np.ndarray | None) -> list[float] | None:
    return None if values is None else to_json_value([round(float(value), 4) for value in values])
