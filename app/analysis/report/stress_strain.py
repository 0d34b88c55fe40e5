"""Functions that draw stress over strain, Eq. (21): the library's curves with their spread, and curves of grasps."""

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from app.analysis.report.plots import LEGEND
from app.analysis.report.recording_analyzer import AnalyzedRecording
from app.analysis.report.tissue_styles import TissueStyle
from config.schema import TissueLibrary
from estimator.estimate_block import GraspRecord

THRESHOLD_MARGIN = 1.15  # multiple of an injury threshold at which a library curve ends
CURVE_POINTS = 60
SMOOTHING_SAMPLES = 9  # length of the moving average applied before the speed is computed


@dataclass(frozen=True, slots=True)
class StressStrainCurve:
    """Strain, measured stress and a filter's estimated stress in kPa (NaN: no estimate), (n,) each."""

    strain: np.ndarray
    measured_kpa: np.ndarray
    estimated_kpa: np.ndarray


def build_curve(recording: AnalyzedRecording, grasp: GraspRecord) -> StressStrainCurve | None:
    """Build a grasp's curve while the jaws close on the tissue; None if no tissue was held.

    The damping force is subtracted, since the library's curves have none. The filter is that of the named tissue, or
    else of the likeliest; so is the thickness where none was measured at contact.
    """
    rows = recording.traces_before_jaw_closure(grasp)
    rows = rows[np.isfinite(rows["tissue_displacement_m"]) & np.isfinite(rows["jaw_force_n"])]
    if len(rows) < 2 * SMOOTHING_SAMPLES:
        return None
    tissues, evenly = recording.library.tissues, np.full(SMOOTHING_SAMPLES, 1 / SMOOTHING_SAMPLES)
    likeliest = max(tissues, key=lambda name: grasp.probabilities.get(name, 0.0))
    named = grasp.label if grasp.label in tissues else likeliest
    profile = tissues[named]
    x_m = np.convolve(rows["tissue_displacement_m"], evenly, "valid")
    force_n = np.convolve(rows["jaw_force_n"], evenly, "valid")
    estimated_n = np.convolve(rows["force_n"][:, [*tissues].index(named)], evenly, "valid")
    damping = grasp.damping_kg_per_s or profile.damping_kg_per_s
    elastic_n = force_n - damping * np.gradient(x_m) * recording.rate_hz
    closed = int(np.argmax(x_m)) + 1
    thin = slice(0, closed, max(1, closed // CURVE_POINTS))
    thickness_m = recording.thickness_m.get(grasp.index) or profile.thickness_m
    kpa_per_n = 1e-3 / recording.library.jaw_area_m2
    return StressStrainCurve(x_m[thin] / thickness_m, kpa_per_n * elastic_n[thin], kpa_per_n * estimated_n[thin])


def draw_library_curves(library: TissueLibrary, tissue_styles: dict[str, TissueStyle]) -> go.Figure:
    """Draw the library's curves to just above their injury thresholds, each with a band of one standard deviation."""
    figure = go.Figure()
    most_n = THRESHOLD_MARGIN * max(library.threshold_n(name) for name in library.tissues)
    reach = 0.0
    for name, profile in library.tissues.items():
        force_n = np.linspace(0.0, THRESHOLD_MARGIN * library.threshold_n(name), CURVE_POINTS)
        strain = (
            np.log1p(force_n / library.compute_apparent_alpha(name).median_n) / profile.beta_per_m / profile.thickness_m
        )
        stress_kpa = force_n / library.jaw_area_m2 / 1e3
        factor = np.exp(_log_strain_sd(library, name, force_n))
        colour, reach = tissue_styles[name].color, max(reach, float(strain[-1]))
        figure.add_scatter(
            x=np.concatenate([strain / factor, (strain * factor)[::-1]]),
            y=np.concatenate([stress_kpa, stress_kpa[::-1]]),
            fill="toself",
            mode="none",
            fillcolor=f"rgba({int(colour[1:3], 16)}, {int(colour[3:5], 16)}, {int(colour[5:], 16)}, 0.22)",
            legendgroup=name,
            showlegend=False,
            hoverinfo="skip",
        )
        figure.add_scatter(
            x=strain,
            y=stress_kpa,
            name=f"{tissue_styles[name].title}, library",
            legendgroup=name,
            line={"color": colour, "width": 2},
        )
    figure.update_xaxes(title="strain, compression by thickness", range=[0, 1.1 * reach])
    figure.update_yaxes(title="stress, kPa", range=[0, most_n / library.jaw_area_m2 / 1e3])
    figure.update_layout(height=460, legend=LEGEND)
    return figure


def _log_strain_sd(library: TissueLibrary, name: str, force_n: np.ndarray) -> np.ndarray:
    """Return the SD of log strain at a force, to first order, from the SDs of log alpha, beta and thickness."""
    spread, alpha = library.spread_of(name), library.compute_apparent_alpha(name)
    ratio = np.maximum(force_n / alpha.median_n, 1e-9)
    by_alpha = ratio / (1 + ratio) / np.log1p(ratio)
    return np.sqrt((by_alpha * alpha.log_sd) ** 2 + spread.log_beta**2 + spread.log_thickness**2)


def draw_grasp_curve(figure: go.Figure, curve: StressStrainCurve, title: str, tissue_style: TissueStyle) -> None:
    """Add a thin line for one of many grasps to `figure`."""
    figure.add_scatter(
        x=curve.strain.astype(np.float32),
        y=curve.measured_kpa.astype(np.float32),
        name=title,
        showlegend=False,
        legendgroup=tissue_style.name,
        line={"color": tissue_style.color, "width": 1},
        opacity=0.75,
    )
