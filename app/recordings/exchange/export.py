"""The function behind `graspwatch export`: writes a recorded run as CSV, Parquet, MATLAB or unchanged MCAP file."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import scipy.io

from acquisition.recordings.mcap_reader import McapFile
from app.recordings.exchange.export_formats import ExportFormat
from app.recordings.grasp_rows import flatten_grasp
from app.recordings.run_reader import RecordedRun, build_run_columns, read_run
from config.errors import RecordingError, build_write_error

MAX_MAT_VARIABLE_BYTES = 2**31  # limit of MATLAB's format of version 5


def export_run(source: Path, target: Path, export_format: ExportFormat) -> list[Path]:
    """Write a run's file in another format, complete or not at all; return the written files.

    CSV and Parquet have a row for each sample, and a second file `…-grasps` with a row for each grasp. A MATLAB file
    holds both as structures. Column names carry their units; a missing value is an empty cell (CSV) or NaN.

    Raises:
        RecordingError: the source cannot be read, or the target exists or cannot be written.
        ServiceError: the disk is full.
    """
    grasps = target.with_name(f"{target.stem}-grasps{target.suffix}")
    targets = [target, grasps] if export_format in (ExportFormat.CSV, ExportFormat.PARQUET) else [target]
    for path in targets:
        try:
            exists = path.exists()
        except OSError as error:  # such as a name that is too long
            raise RecordingError(f"{path}: cannot be written ({error.strerror}). Name another with --out.") from None
        if exists:
            raise RecordingError(f"{path}: exists already, and is kept. Name another file with --out.")
    provisional = {path: path.with_name(f".{path.name}.part") for path in targets}
    try:
        if export_format is ExportFormat.MCAP:
            McapFile(source)  # raises if the file cannot be read
            shutil.copyfile(source, provisional[target])
        else:
            run = read_run(source)
            _WRITERS[export_format](run, *provisional.values())
        for path, part in provisional.items():
            part.rename(path)
    except OSError as error:
        text = f"{target}: cannot be written ({error.strerror}). Make room, or name another."
        raise build_write_error(text, error, RecordingError) from None
    finally:
        for part in provisional.values():
            part.unlink(missing_ok=True)
    return targets


def _build_metadata(run: RecordedRun) -> dict[str, str]:
    tool, library = run.recording_context.tool, run.recording_context.library
    return run.metadata | {
        "force_scale": tool.scale_text,
        "tool_file": tool.model_dump_json(),
        "tissue_library": library.model_dump_json(),
    }


def _build_sample_table(run: RecordedRun) -> pa.Table:
    return pa.table(build_run_columns(run)).replace_schema_metadata(_build_metadata(run))


def _build_grasp_rows(run: RecordedRun) -> list[dict[str, object]]:
    """Return the grasps with one value a cell: each tissue's value gets its own column, and so does the force scale."""
    scale: dict[str, object] = {"force_scale": run.recording_context.tool.scale_text}
    return [scale | flatten_grasp(grasp) for grasp in run.grasps]


def _write_csv(run: RecordedRun, samples: Path, grasps: Path) -> None:
    table = _build_sample_table(run)
    columns = [_nan_to_null(column) for column in table.columns]
    pyarrow.csv.write_csv(pa.table(columns, names=table.column_names), samples)
    pyarrow.csv.write_csv(pa.Table.from_pylist(_build_grasp_rows(run)), grasps)


def _nan_to_null(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Replace NaN by an empty cell."""
    if not pa.types.is_floating(column.type):
        return column
    return pa.chunked_array([pa.array(chunk.to_numpy(), from_pandas=True) for chunk in column.chunks])


def _write_parquet(run: RecordedRun, samples: Path, grasps: Path) -> None:
    pyarrow.parquet.write_table(_build_sample_table(run), samples, compression="zstd")
    pyarrow.parquet.write_table(pa.Table.from_pylist(_build_grasp_rows(run)), grasps)


def _write_mat(run: RecordedRun, target: Path) -> None:
    columns = build_run_columns(run)
    if max(values.nbytes for values in columns.values()) >= MAX_MAT_VARIABLE_BYTES:
        raise RecordingError(f"{run.path}: is too long for a MATLAB file. Export it as parquet.")
    rows = _build_grasp_rows(run)
    names = list(dict.fromkeys(name for row in rows for name in row))
    grasps = {name[:63]: _to_matlab_column([row.get(name) for row in rows]) for name in names}
    about = {key: value for key, value in _build_metadata(run).items() if value}
    with target.open("wb") as file:  # with a name instead, scipy would append a suffix
        scipy.io.savemat(
            file,
            {
                "samples": {name[:63]: values for name, values in columns.items()},
                "grasps": grasps,
                "about": json.dumps(about),
            },
            do_compression=True,
            long_field_names=True,
        )


def _to_matlab_column(values: list[Any]) -> np.ndarray:
    """Return a column of numbers, NaN where there is none, or of texts, as cells."""
    if all(isinstance(value, int | float | None) for value in values):
        return np.array([np.nan if value is None else float(value) for value in values])
    cells = np.empty(len(values), object)
    cells[:] = ["" if value is None else str(value) for value in values]
    return cells


_WRITERS: dict[ExportFormat, Callable[..., None]] = {
    ExportFormat.CSV: _write_csv,
    ExportFormat.PARQUET: _write_parquet,
    ExportFormat.MAT: _write_mat,
}
