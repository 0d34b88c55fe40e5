"""Functions that build a report's plots over time, and its box plots of the parameters."""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io
from plotly.subplots import make_subplots

from app.analysis.report.downsampling import TimeGrid, pack_values
from app.analysis.report.recording_analyzer import AnalyzedRecording
from app.analysis.report.statistics import PARAMETERS, Statistics
from app.analysis.report.tissue_styles import ALARM_COLORS, TissueStyle
from config.schema import TissueLibrary
from estimator.decision import UNKNOWN
from estimator.estimate_block import GraspRecord
from estimator.force_alarms import ForceAlarm
from estimator.studies.html_page import MARK_COLOR

RAW_COLOR = "#8a96a0"
AXIS_HEIGHTS = {
    "verdict": 0.22,
    "force, N": 1.5,
    "displ., mm": 1.0,
    "probability": 1.0,
    "α, N": 0.8,
    "β, 1/m": 0.8,
    "d, kg/s": 0.8,
}
VERDICT_ROW, FORCE_ROW, DISPLACEMENT_ROW, PROBABILITY_ROW, ALPHA_ROW = 1, 2, 3, 4, 5  # rows of a time plot
PLOT_HEIGHT_PX = 700
AXIS_RANGE_FACTOR = 10.0  # parameter axes end at this multiple of the library's values: wrong filters run far away
LEGEND = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0, "font": {"size": 12}}


@dataclass(frozen=True, slots=True)
class PlotLine:
    """One line of a time plot: its row, its look, and how to extract its values from the traces."""

    name: str
    row: int
    extract: Callable[[np.ndarray], np.ndarray]
    line: dict[str, Any]
    legend_group: str | None = None  # a tissue's name
    logarithmic: bool = False


def build_plot_lines(library: TissueLibrary, tissue_styles: dict[str, TissueStyle]) -> list[PlotLine]:
    """Return the lines of force, displacement, probabilities, and the parameters of every filter."""

    def column(name: str, scale: float = 1.0) -> Callable[[np.ndarray], np.ndarray]:
        return lambda traces: scale * traces[name]

    def of_filter(name: str, k: int) -> Callable[[np.ndarray], np.ndarray]:
        return lambda traces: traces[name][:, k]

    found = [
        PlotLine("unfiltered", FORCE_ROW, column("jaw_force_n"), {"color": RAW_COLOR, "width": 1}),
        PlotLine("force", FORCE_ROW, column("jaw_force_filtered_n"), {"color": MARK_COLOR, "width": 1.8}),
        PlotLine("limit enforced", FORCE_ROW, column("limit_n"), {"color": MARK_COLOR, "width": 1.2, "dash": "dash"}),
        PlotLine(
            "alarm threshold", FORCE_ROW, column("threshold_n"), {"color": RAW_COLOR, "width": 1.2, "dash": "dot"}
        ),
        PlotLine(
            "jaws", DISPLACEMENT_ROW, column("jaw_displacement_filtered_m", 1e3), {"color": RAW_COLOR, "width": 1}
        ),
        PlotLine("tissue", DISPLACEMENT_ROW, column("tissue_displacement_m", 1e3), {"color": MARK_COLOR, "width": 1.8}),
    ]
    for k, name in enumerate(library.tissues):
        line = {"color": tissue_styles[name].color, "width": 1.8}
        found.append(PlotLine(name, PROBABILITY_ROW, of_filter("probability", k), line, name))
        found += [
            PlotLine(name, ALPHA_ROW + row, of_filter(parameter, k), line, name, logarithmic=True)
            for row, parameter in enumerate(PARAMETERS.values())
        ]
    unknown = {"color": tissue_styles[UNKNOWN].color, "width": 1.8, "dash": "dot"}
    return [*found, PlotLine(UNKNOWN, PROBABILITY_ROW, column("probability_unknown"), unknown, UNKNOWN)]


def build_time_plot_template(
    library: TissueLibrary, tissue_styles: dict[str, TissueStyle], plot_lines: list[PlotLine]
) -> dict[str, Any]:
    """Build a time plot without its data, as JSON; dotted lines are the library's own parameters."""
    figure = make_subplots(
        len(AXIS_HEIGHTS), 1, shared_xaxes=True, vertical_spacing=0.025, row_heights=[*AXIS_HEIGHTS.values()]
    )
    for line in plot_lines:
        named = line.row <= PROBABILITY_ROW
        title = tissue_styles[line.legend_group].title if line.legend_group else line.name
        figure.add_scatter(
            x=[],
            y=[],
            name=title,
            mode="lines",
            line=line.line,
            legendgroup=line.legend_group,
            showlegend=named,
            row=line.row,
            col=1,
        )
    for row, (title, _) in enumerate(AXIS_HEIGHTS.items(), 1):
        figure.update_yaxes(title={"text": title, "font": {"size": 12}}, row=row, col=1)
    figure.update_yaxes(range=[0, 1], showticklabels=False, title="", fixedrange=True, row=VERDICT_ROW, col=1)
    figure.update_yaxes(range=[-0.03, 1.03], row=PROBABILITY_ROW, col=1)
    for row, parameter in enumerate(PARAMETERS.values(), ALPHA_ROW):
        known = [getattr(profile, parameter) for profile in library.tissues.values()]
        reach = [np.log10(min(known) / AXIS_RANGE_FACTOR), np.log10(max(known) * AXIS_RANGE_FACTOR)]
        figure.update_yaxes(type="log", range=reach, dtick=1, exponentformat="power", row=row, col=1)
        for name, profile in library.tissues.items():
            line = {"color": tissue_styles[name].color, "width": 1, "dash": "dot"}
            figure.add_hline(
                y=getattr(profile, parameter),
                line=line,
                row=row,  # pyright: ignore[reportArgumentType]  plotly declares no type; its default is "all"
                col=1,  # pyright: ignore[reportArgumentType]  as row
            )
    figure.update_xaxes(tickfont={"size": 11})
    figure.update_yaxes(tickfont={"size": 11})
    figure.update_xaxes(title={"text": "time, s", "font": {"size": 12}}, row=len(AXIS_HEIGHTS), col=1)
    figure.update_layout(
        height=PLOT_HEIGHT_PX, hovermode="x", legend=LEGEND, uniformtext={"minsize": 9, "mode": "hide"}
    )
    return figure_to_json(figure)


def build_time_plot(
    recording: AnalyzedRecording,
    traces: np.ndarray,
    plot_lines: list[PlotLine],
    max_points: int,
    marks: list[dict[str, Any]],
) -> dict[str, Any]:
    """Build the data of one time plot: packed channels, and `marks`, which are Plotly traces to add."""
    grid = TimeGrid.from_ticks(traces["tick"], max_points)
    packed = []
    for line in plot_lines:
        values = line.extract(traces)
        if line.logarithmic:
            with np.errstate(invalid="ignore", divide="ignore"):
                values = np.log10(values)
        packed.append(pack_values(grid.downsample(traces["tick"], values)))
    at_s = grid.point_ticks()
    return {
        "begin_s": float(at_s[0]) / recording.rate_hz if len(at_s) else 0.0,
        "step_s": grid.step_ticks / recording.rate_hz,
        "channels": packed,
        "marks": marks,
    }


def build_verdict_bars(grasps: Iterable[GraspRecord], tissue_styles: dict[str, TissueStyle]) -> list[dict[str, Any]]:
    """Build a bar for each grasp, with the color and the letters of its verdict."""
    bars = []
    for name, look in tissue_styles.items():
        own = [grasp for grasp in grasps if grasp.label == name]
        if own:
            bars.append(
                {
                    "type": "bar",
                    "name": look.title,
                    "legendgroup": name,
                    "showlegend": False,
                    "x": [round((grasp.start_s + grasp.end_s) / 2, 4) for grasp in own],
                    "width": [round(grasp.end_s - grasp.start_s, 4) for grasp in own],
                    "y": [1] * len(own),
                    "marker": {"color": look.color, "line": {"width": 0}},
                    "text": [look.abbreviation] * len(own),
                    "textposition": "inside",
                    "insidetextanchor": "middle",
                    "textangle": 0,
                    "insidetextfont": {"color": look.text_color, "size": 12},
                    "hovertext": [f"Grasp {grasp.index}: {look.title}" for grasp in own],
                    "hoverinfo": "text",
                }
            )
    return bars


def build_alarm_markers(alarms: list[ForceAlarm], rate_hz: float) -> list[dict[str, Any]]:
    """Build a triangle on the force for each warning."""
    told = [(alarm, alarm.priority) for alarm in alarms if alarm.priority]
    if not told:
        return []
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "name": "warning",
            "xaxis": "x2",
            "yaxis": "y2",
            "x": [alarm.tick / rate_hz for alarm, _ in told],
            "y": [round(alarm.force_n, 3) for alarm, _ in told],
            "marker": {
                "symbol": "triangle-down",
                "size": 11,
                "color": [ALARM_COLORS[priority] for _, priority in told],
                "line": {"color": MARK_COLOR, "width": 1},
            },
            "hovertext": [
                f"{priority}: {alarm.force_n:.2f} N of {alarm.threshold_n:.2f} N" for alarm, priority in told
            ],
            "hoverinfo": "text",
            "showlegend": False,
        }
    ]


def build_box_plots(
    statistics: Statistics, library: TissueLibrary, tissue_styles: dict[str, TissueStyle]
) -> dict[str, Any]:
    """Build Fig. 8: alpha, beta and d of every grasp, by group; a diamond is the library's own value."""
    figure = make_subplots(1, 3, subplot_titles=("α, N", "β, 1/m", "d, kg/s"), horizontal_spacing=0.08)
    for k, parameter in enumerate(PARAMETERS.values()):
        for name, logs in statistics.log_parameters.items():
            figure.add_box(
                y=np.exp(logs[:, k]),
                name=tissue_styles[name].title,
                marker_color=tissue_styles[name].color,
                showlegend=False,
                boxpoints="all" if len(logs) <= 60 else "outliers",
                jitter=0.4,
                marker_size=4,
                line_width=1.5,
                row=1,
                col=k + 1,
            )
        known = [name for name in statistics.log_parameters if name in library.tissues]
        figure.add_scatter(
            x=[tissue_styles[name].title for name in known],
            y=[getattr(library.tissues[name], parameter) for name in known],
            mode="markers",
            marker={"symbol": "diamond-open", "size": 11, "color": MARK_COLOR, "line": {"width": 1.5}},
            name="library",
            showlegend=k == 0 and bool(known),
            row=1,
            col=k + 1,
        )
    ticks = [digit * 10.0**power for power in range(-9, 9) for digit in (1, 3)]
    figure.update_yaxes(type="log", tickvals=ticks, ticktext=[f"{tick:g}" for tick in ticks])
    figure.update_layout(height=430, legend={**LEGEND, "y": 1.1})
    return figure_to_json(figure)


def figure_to_json(figure: go.Figure) -> dict[str, Any]:
    """Convert a figure to JSON, in the style of the report."""
    figure.update_layout(template="plotly_white", margin={"l": 62, "r": 14, "t": 40, "b": 46}, autosize=True)
    text = plotly.io.to_json(figure, validate=False)
    return json.loads(text)  # pyright: ignore[reportArgumentType]  plotly declares no type; it is always a text
