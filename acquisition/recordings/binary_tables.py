"""Functions that read columns of numbers from TDMS, MAT and Parquet files."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.recordings.column_table import ColumnTable, Wanted, build_table, find_positions
from config.errors import RecordingError

MAX_FILE_BYTES = 1024 * 2**20


def _read_tdms(path: Path, wanted: Wanted) -> ColumnTable:
    """Read channels of a TDMS file, named `channel` or `group/channel`; numbers count through all groups."""
    from nptdms import TdmsFile

    file = TdmsFile.read(path)
    channels: list[Any] = [channel for group in file.groups() for channel in group.channels()]
    own, full = [each.name for each in channels], [f"{each.group_name}/{each.name}" for each in channels]
    names = [
        name if own.count(name) == 1 and not _is_among(wanted, long) else long
        for name, long in zip(own, full, strict=True)
    ]
    at = find_positions(path, "", names, len(channels), wanted)
    found = [channels[index] for index in at]
    steps = {float(each.properties["wf_increment"]) for each in found if each.properties.get("wf_increment")}
    if len(steps) > 1:
        raise RecordingError(
            f"{path}: its channels have different steps between samples, {', '.join(f'{step:g}' for step in steps)} s. "
            "Name channels that were sampled together in [table] of the tool file."
        )
    start = found[0].properties.get("wf_start_time")
    start_ns = int(np.datetime64(start, "ns").astype(np.int64)) if start is not None else None
    columns = [_to_floats(path, each.name, each[:]) for each in found]
    return build_table(path, columns, at, [names[index] for index in at], next(iter(steps), None), start_ns)


def _is_among(wanted: Wanted, name: str) -> bool:
    return any(isinstance(each, str) and each.strip().casefold() == name.strip().casefold() for each in wanted or ())


def _read_mat(path: Path, wanted: Wanted) -> ColumnTable:
    """Read variables of a MAT file; the columns of a matrix are named as in `data(:,2)`."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path)
    except NotImplementedError:
        raise RecordingError(f"{path}: is a MAT file of version 7.3. Save it in MATLAB with '-v7'.") from None
    except MatReadError as error:
        raise RecordingError(f"{path}: cannot be read as a MAT file ({error}).") from None
    columns = dict(_list_vectors(content))
    names = list(columns)
    at = find_positions(path, "", names, len(names), wanted)
    found = [names[index] for index in at]
    return build_table(path, [_to_floats(path, name, columns[name]) for name in found], at, found)


def _list_vectors(content: dict[str, Any]) -> Iterator[tuple[str, np.ndarray]]:
    for name, value in content.items():
        if not isinstance(value, np.ndarray) or value.ndim != 2 or name.startswith("__"):
            continue
        if 1 in value.shape:
            yield name, value.ravel()
        else:
            yield from ((f"{name}(:,{at + 1})", value[:, at]) for at in range(value.shape[1]))


def _read_parquet(path: Path, wanted: Wanted) -> ColumnTable:
    import pyarrow.parquet as parquet

    file = parquet.ParquetFile(path)
    names = file.schema_arrow.names
    at = find_positions(path, "", names, len(names), wanted)
    found = [names[index] for index in at]
    table = file.read(columns=list(dict.fromkeys(found)))
    columns = [_to_floats(path, name, table[name].to_numpy(zero_copy_only=False)) for name in found]
    return build_table(path, columns, at, found)


def _to_floats(path: Path, name: str, values: Any) -> np.ndarray:
    """Return a column as floats; times of day and dates become seconds since 1970."""
    column = np.asarray(values)
    if column.dtype.kind == "M":
        seconds = column.astype("datetime64[ns]").astype(np.int64) / 1e9
        return np.where(np.isnat(column), np.nan, seconds)
    try:
        return column.astype(float)
    except (TypeError, ValueError):
        raise RecordingError(f"{path}: column {name!r} holds no numbers. Correct [table] of the tool file.") from None


_READERS = {".tdms": _read_tdms, ".mat": _read_mat, ".parquet": _read_parquet, ".pq": _read_parquet}


def is_binary_table(path: Path) -> bool:
    """Return whether the file's name has the ending of a TDMS, MAT or Parquet file."""
    return path.suffix.lower() in _READERS


def read_binary_table(path: Path, wanted: Wanted) -> ColumnTable:
    """Read the wanted columns of a TDMS, MAT or Parquet file, by the ending of its name.

    Raises:
        RecordingError: the file cannot be read, or a column is missing or holds no numbers.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror}). Check the path.") from None
    if size > MAX_FILE_BYTES:
        raise RecordingError(f"{path}: has more than {MAX_FILE_BYTES // 2**20} MiB. Split it.")
    try:
        return _READERS[path.suffix.lower()](path, wanted)
    except RecordingError:
        raise
    except Exception as error:  # noqa: BLE001 - the three libraries raise errors of any kind for a damaged file
        kind = path.suffix.lower().removeprefix(".")
        raise RecordingError(
            f"{path}: is damaged, or no {kind} file ({str(error).partition(chr(10))[0][:100]})."
        ) from None
