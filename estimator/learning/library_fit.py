"""Functions that fit a tissue library to the loading curves of labeled recordings."""

import math
from collections.abc import Sequence

import numpy as np

from config.errors import ConfigurationError
from config.schema import (
    LearnedLibrary,
    LearnedRecording,
    LearnedTissue,
    ParameterSpread,
    TissueLibrary,
    TissueProfile,
    Tool,
)
from estimator.learning.recorded_grasps import (
    LabeledRecording,
    LoadingCurves,
    estimate_usual_peak_v,
    extract_loading_curves,
)
from estimator.loading.between_spots import estimate_spot_spread
from estimator.loading.constants import BETWEEN_SD, FEATURES, PARAMETER_FLOOR_LOG_SD, PRIOR_UNKNOWN, WITHIN_FLOOR_SHARE
from estimator.loading.robust_covariance import robust_scatter, shrunk_scatter

SIGNIFICANT_DIGITS = 6


def fit_library(
    curves: Sequence[LoadingCurves],
    tool: Tool,
    base: TissueLibrary,
    base_name: str,
    peak_v: float,
    *,
    name: str,
    date: str,
) -> TissueLibrary:
    """Return the library learned from recordings, independent of their order.

    Args:
        curves: of at least one recording for each tissue, each with at least one grasp.
        base: library that injury thresholds, mass and jaw area come from.
        peak_v: usual peak of the strain gage over rest, V.
        date: date of learning, YYYY-MM-DD.

    Raises:
        ConfigurationError: no filter could follow any grasp of some tissue.
    """
    curves = sorted(
        (each for each in curves if len(each.features)), key=lambda c: (c.recording.label, c.recording.sha256)
    )
    labels = sorted({each.recording.label for each in curves})
    tissue = np.array([labels.index(each.recording.label) for each in curves])
    loading = robust_scatter([each.features for each in curves], WITHIN_FLOOR_SHARE * BETWEEN_SD**2)
    centre, ramp = np.array(loading[0]), np.array([each.ramp_log for each in curves])
    spot_sd, pairs = estimate_spot_spread(tissue, ramp, centre)
    parameters = _fit_parameter_scatter(curves, labels)
    tissues = {}
    for i, label in enumerate(labels):
        own = np.flatnonzero(tissue == i)
        features, centres, weights = ([part[k] for k in own] for part in _groups(curves, loading))
        within = shrunk_scatter(features, centres, weights, loading[2])
        learned = LearnedTissue(
            grasps=sum(len(curves[k].features) for k in own),
            log_covariance=_round_matrix(parameters[label][1]),
            contact_measured=math.isfinite(parameters[label][0][3]),
            loading_covariance=_round_matrix(within),
            recordings=tuple(_build_recording(curves[k], centre[k]) for k in own),
        )
        tissues[label] = _build_profile(label, base, parameters[label], learned)
    lowest = [label for label in labels if find_base_tissue(label, base) is None]
    return TissueLibrary(
        name=name,
        title=f"Learned from {len(curves)} recordings with {tool.title}",
        source=_describe_source(curves, base_name, base, lowest),
        mass_kg=base.mass_kg,
        jaw_area_m2=base.jaw_area_m2,
        spread=base.spread,
        learned=LearnedLibrary(
            date=date,
            base=base_name,
            tool=tool.name,
            calibration=tool.calibration_fingerprint,
            features=FEATURES,
            usual_peak_v=peak_v,
            spot_sd=tuple(_round_significant(value) for value in spot_sd),
            spot_pairs=pairs,
            prior_unknown=PRIOR_UNKNOWN,
        ),
        tissues=tissues,
    )


def fit_recordings(
    recordings: Sequence[LabeledRecording], *, tool: Tool, base: TissueLibrary, base_name: str, date: str
) -> TissueLibrary:
    """Return the library learned from recordings alone, their usual peak included; raises as `fit_library`."""
    peak_v = estimate_usual_peak_v(recordings)
    curves = [extract_loading_curves(each, tool, peak_v) for each in recordings]
    return fit_library(curves, tool, base, base_name, peak_v, name="validated", date=date)


def find_base_tissue(label: str, base: TissueLibrary) -> str | None:
    """Return the base library's name for a label, ignoring case and separators; None if it has none."""
    wanted = _normalize_name(label)
    return next((name for name in base.tissues if _normalize_name(name) == wanted), None)


def _normalize_name(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())


def _groups(
    curves: Sequence[LoadingCurves], loading: tuple[list[np.ndarray], list[np.ndarray], np.ndarray]
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    return [each.features for each in curves], loading[0], loading[1]


def _fit_parameter_scatter(
    curves: Sequence[LoadingCurves], labels: list[str]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return each tissue's mean (4,) and covariance (4, 4) of log alpha, log beta, log d and log thickness.

    Without sensed contact the mean log thickness is NaN and its variance 1; the caller replaces both.
    """
    rows = {label: [] for label in labels}
    for each in curves:
        rows[each.recording.label].append(np.column_stack([each.log_parameters, each.log_thickness]))
    groups = []
    for label in labels:
        table = np.concatenate(rows[label])
        table = table[np.isfinite(table[:, :3]).all(axis=1)]
        if not len(table):
            raise ConfigurationError(
                f"{label}: no filter could follow any of its grasps, so alpha, beta and d are not known. Check that "
                "--tool names the tool that it was recorded with."
            )
        groups.append(table)
    floor = PARAMETER_FLOOR_LOG_SD**2
    centres, weights, pooled = robust_scatter([table[:, :3] for table in groups], np.full(3, floor))
    result = {}
    for label, table, mean, weight in zip(labels, groups, centres, weights, strict=True):
        cov = np.zeros((4, 4))
        cov[:3, :3] = shrunk_scatter([table[:, :3]], [mean], [weight], pooled)
        felt = table[np.isfinite(table[:, 3]), 3]
        middle = float(np.median(felt)) if len(felt) else math.nan
        cov[3, 3] = floor + (1.4826 * float(np.median(np.abs(felt - middle)))) ** 2 if len(felt) else 1.0
        result[label] = np.append(mean, middle), cov
    return result


def _build_profile(
    label: str, base: TissueLibrary, parameters: tuple[np.ndarray, np.ndarray], learned: LearnedTissue
) -> TissueProfile:
    (log_alpha, log_beta, log_damping, log_thickness), cov = parameters
    known = find_base_tissue(label, base)
    like = base.tissues[known] if known else min(base.tissues.values(), key=lambda each: each.threshold_pa)
    sd = np.sqrt(np.diag(cov))
    log_thickness_sd = float(sd[3])
    if not learned.contact_measured:
        log_thickness_sd = base.spread_of(known).log_thickness if known else 1.0
        covariance = np.array(learned.log_covariance)
        covariance[3, 3] = log_thickness_sd**2
        learned = learned.model_copy(update={"log_covariance": _round_matrix(covariance)})
    return TissueProfile(
        title=like.title if known else label.replace("_", " ").capitalize(),
        alpha_n=_round_significant(math.exp(log_alpha)),
        beta_per_m=_round_significant(math.exp(log_beta)),
        damping_kg_per_s=_round_significant(math.exp(log_damping)),
        thickness_m=_round_significant(math.exp(log_thickness)) if learned.contact_measured else like.thickness_m,
        threshold_pa=like.threshold_pa,
        spread=ParameterSpread(
            log_alpha=_round_significant(sd[0]),
            log_beta=_round_significant(sd[1]),
            log_damping=_round_significant(sd[2]),
            log_thickness=_round_significant(log_thickness_sd),
        ),
        learned=learned,
    )


def _build_recording(curves: LoadingCurves, centre: np.ndarray) -> LearnedRecording:
    return LearnedRecording(
        file=curves.recording.file,
        sha256=curves.recording.sha256,
        grasps=len(curves.features),
        left_out=tuple(curves.left_out),
        ramp_v_per_s=_round_significant(math.exp(curves.ramp_log)),
        centre=tuple(_round_significant(value) for value in centre),
        recorded_at=curves.recording.conditions.recorded_at,
        reference=curves.recording.conditions.reference,
    )


def _describe_source(curves: Sequence[LoadingCurves], base_name: str, base: TissueLibrary, lowest: list[str]) -> str:
    grasps = sum(len(each.features) for each in curves)
    text = (
        f"learned from {grasps} grasps in {', '.join(sorted(each.recording.file for each in curves))}; "
        f"injury thresholds, mass and jaw area from the library {base_name!r}"
    )
    if lowest:
        pressure = min(each.threshold_pa for each in base.tissues.values())
        text += (
            f", which does not know {', '.join(lowest)}: its lowest threshold ({pressure / 1e3:g} kPa) is taken there"
        )
    return text


def _round_matrix(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(_round_significant(value) for value in row) for row in (matrix + matrix.T) / 2)


def _round_significant(value: float) -> float:
    """Round to six significant digits: readable files, and the same bits on every machine."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}")
