"""A recorded run for other programs: CSV, Parquet, MATLAB, or its MCAP file as it is."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import scipy.io

from acquisition.recordings.container import Container
from app.exchange.formats import Format
from app.record.reading import RecordedRun, columns_of_run, read_run
from config.errors import RecordingError

MAT_MOST_BYTES = 2**31  # of one variable in MATLAB's format of version 5


def export(source: Path, target: Path, wanted: Format) -> list[Path]:
    """Write a run's file as another; returns what was written, complete or not at all.

    CSV and Parquet hold a row for each sample, and beside it a file `…-grasps` with a row for each grasp; a MATLAB file
    holds both as structures. Column names carry their units; there is no value where a cell is empty (CSV) or NaN.

    Raises:
        RecordingError: the source cannot be read, the target exists or cannot be written.
    """
    grasps = target.with_name(f"{target.stem}-grasps{target.suffix}")
    targets = [target, grasps] if wanted in (Format.CSV, Format.PARQUET) else [target]
    for path in targets:
        if path.exists():
            raise RecordingError(f"{path}: exists already, and is kept. Name another file with --out.")
    provisional = {path: path.with_name(f".{path.name}.part") for path in targets}
    try:
        if wanted is Format.MCAP:
            Container(source)  # says what is wrong with it
            shutil.copyfile(source, provisional[target])
        else:
            run = read_run(source)
            _WRITERS[wanted](run, *provisional.values())
        for path, part in provisional.items():
            part.rename(path)
    except OSError as error:
        raise RecordingError(f"{target}: cannot be written ({error.strerror}). Make room, or name another.") from None
    finally:
        for part in provisional.values():
            part.unlink(missing_ok=True)
    return targets


def _about(run: RecordedRun) -> dict[str, str]:
    tool, library = run.rig.tool, run.rig.library
    return run.about | {
        "force_scale": tool.scale_in_words,
        "tool_file": tool.model_dump_json(),
        "tissue_library": library.model_dump_json(),
    }


def _sample_table(run: RecordedRun) -> pa.Table:
    return pa.table(columns_of_run(run)).replace_schema_metadata(_about(run))


def _grasp_rows(run: RecordedRun) -> list[dict[str, object]]:
    """Grasps with one value a cell: what is told of each tissue gets a column of its own."""
    rows = []
    for grasp in run.grasps:
        row: dict[str, object] = {}
        for name, value in grasp.model_dump(mode="json").items():
            if isinstance(value, dict):
                row |= {f"{name}_{tissue}": each for tissue, each in value.items()}
            else:
                row[name] = "; ".join(value) if isinstance(value, list) else value
        rows.append(row)
    return rows


def _write_csv(run: RecordedRun, samples: Path, grasps: Path) -> None:
    table = _sample_table(run)
    columns = [_without_nan(column) for column in table.columns]
    pyarrow.csv.write_csv(pa.table(columns, names=table.column_names), samples)
    pyarrow.csv.write_csv(pa.Table.from_pylist(_grasp_rows(run)), grasps)


def _without_nan(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """An empty cell in place of NaN."""
    if not pa.types.is_floating(column.type):
        return column
    return pa.chunked_array([pa.array(chunk.to_numpy(), from_pandas=True) for chunk in column.chunks])


def _write_parquet(run: RecordedRun, samples: Path, grasps: Path) -> None:
    pyarrow.parquet.write_table(_sample_table(run), samples, compression="zstd")
    pyarrow.parquet.write_table(pa.Table.from_pylist(_grasp_rows(run)), grasps)


def _write_mat(run: RecordedRun, target: Path) -> None:
    columns = columns_of_run(run)
    if max(values.nbytes for values in columns.values()) >= MAT_MOST_BYTES:
        raise RecordingError(f"{run.path}: is too long for a MATLAB file. Export it as parquet.")
    rows = _grasp_rows(run)
    names = list(dict.fromkeys(name for row in rows for name in row))
    grasps = {name[:63]: _matlab([row.get(name) for row in rows]) for name in names}
    about = {key: value for key, value in _about(run).items() if value}
    with target.open("wb") as file:  # given a name, scipy would add an ending to it
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


def _matlab(values: list[object]) -> np.ndarray:
    """A column of numbers, NaN where there is none; or of texts, as cells."""
    if all(isinstance(value, int | float | None) for value in values):
        return np.array([np.nan if value is None else float(value) for value in values])
    cells = np.empty(len(values), object)
    cells[:] = ["" if value is None else str(value) for value in values]
    return cells


_WRITERS: dict[Format, Callable[..., None]] = {
    Format.CSV: _write_csv,
    Format.PARQUET: _write_parquet,
    Format.MAT: _write_mat,
}
