"""Estimates as rows of a recording: one column for each number, those of a tissue's filter under its name."""

import numpy as np

from acquisition.recordings import mcap_layout
from acquisition.recordings.protobuf_rows import Column, RowLayout
from estimator.estimate_block import estimate_dtype

PARAMETER_COLUMNS = {
    "log_sd": ("log_alpha_sd", "log_beta_sd", "log_damping_sd")
}  # fields with a number for each parameter


def estimate_layout(tissues: list[str]) -> RowLayout:
    """How the estimates of a library with these tissues are recorded."""
    dtype = estimate_dtype(len(tissues))
    common = [name for name in dtype.names if not dtype[name].shape]
    columns = [Column(name, dtype[name].str[1:]) for name in common]
    for tissue in tissues:
        for name in dtype.names:
            if name not in common:
                columns += [Column(each, group=tissue) for each in PARAMETER_COLUMNS.get(name, (name,))]
    return RowLayout("Estimates", columns)


def row_layouts(tissues: list[str]) -> dict[str, RowLayout]:
    """By topic, all rows of a recording made with a library of these tissues."""
    return {
        mcap_layout.RAW_TOPIC: mcap_layout.RAW_LAYOUT,
        mcap_layout.CONDITIONED_TOPIC: mcap_layout.CONDITIONED_LAYOUT,
        mcap_layout.ESTIMATES_TOPIC: estimate_layout(tissues),
    }


def estimate_columns(estimates: np.ndarray, tissues: list[str]) -> dict[str, np.ndarray]:
    """Columns, each of shape (n,), by their path."""
    columns = {}
    for name in estimates.dtype.names:
        values = estimates[name]
        if values.ndim == 1:
            columns[name] = values
            continue
        for k, tissue in enumerate(tissues):
            if name in PARAMETER_COLUMNS:
                columns |= {f"{tissue}.{each}": values[:, k, i] for i, each in enumerate(PARAMETER_COLUMNS[name])}
            else:
                columns[f"{tissue}.{name}"] = values[:, k]
    return columns


def from_estimate_columns(columns: dict[str, np.ndarray], tissues: list[str]) -> np.ndarray:
    """What `estimate_columns` was given.

    Raises:
        KeyError: a column is missing.
    """
    estimates = np.empty(len(columns["tick"]), estimate_dtype(len(tissues)))
    for path, values in estimate_columns(estimates, tissues).items():  # views into the new array
        values[:] = columns[path]
    return estimates
