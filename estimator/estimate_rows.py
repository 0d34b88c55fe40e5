"""Layouts of recorded estimates, a column for each number, and functions that convert estimates to them and back."""

import numpy as np

from acquisition.recordings import mcap_layout
from acquisition.recordings.protobuf_rows import ColumnSpec, RowLayout
from acquisition.sample_block import dtype_field_names
from estimator.estimate_block import estimate_dtype

# estimate fields with one number for each parameter, and their columns
PARAMETER_COLUMNS = {"log_sd": ("log_alpha_sd", "log_beta_sd", "log_damping_sd")}


def estimate_layout(tissues: list[str]) -> RowLayout:
    """Return the row layout of the estimates for a library with these tissues."""
    dtype = estimate_dtype(len(tissues))
    common = [name for name in dtype_field_names(dtype) if not dtype[name].shape]
    columns = [ColumnSpec(name, dtype[name].str[1:]) for name in common]
    for tissue in tissues:
        for name in dtype_field_names(dtype):
            if name not in common:
                columns += [ColumnSpec(each, group=tissue) for each in PARAMETER_COLUMNS.get(name, (name,))]
    return RowLayout("Estimates", columns)


def row_layouts(tissues: list[str]) -> dict[str, RowLayout]:
    """Return the row layout of each topic in a recording for a library with these tissues."""
    return {
        mcap_layout.RAW_TOPIC: mcap_layout.RAW_LAYOUT,
        mcap_layout.CONDITIONED_TOPIC: mcap_layout.CONDITIONED_LAYOUT,
        mcap_layout.ESTIMATES_TOPIC: estimate_layout(tissues),
    }


def estimate_columns(estimates: np.ndarray, tissues: list[str]) -> dict[str, np.ndarray]:
    """Return the estimates as columns of shape (n,) by name; a tissue's own are named `<tissue>.<name>`."""
    columns = {}
    for name in dtype_field_names(estimates.dtype):
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


def estimates_from_columns(columns: dict[str, np.ndarray], tissues: list[str]) -> np.ndarray:
    """Return the estimates, (n,) of `estimate_dtype`, from their columns; the inverse of `estimate_columns`.

    The NIS is NaN in recordings from before it was recorded.

    Raises:
        KeyError: a column is missing.
    """
    estimates = np.empty(len(columns["tick"]), estimate_dtype(len(tissues)))
    for path, values in estimate_columns(estimates, tissues).items():  # views into the new array
        recorded = path in columns or not path.endswith(".nis")
        values[:] = columns[path] if recorded else np.nan
    return estimates
