"""Functions that write calibrated tool files beside the old ones, which stay unchanged."""

import re
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

import tomlkit
from tomlkit.items import Table

from config import atomic_write
from config.errors import GraspwatchError, build_write_error
from config.load import TEXT_ENCODING, FileKind, find_file, parse_file
from config.schema import ConstantMeasurement, ForceScale, Tool

DATE_SUFFIX = re.compile(r"-\d{4}-\d{2}-\d{2}(-\d+)?$")
MAX_FILES_PER_DAY = 1000
SIGNIFICANT_DIGITS = 6


def write_calibrated_tool(
    tool: str,
    values: Mapping[str, float | ForceScale],
    measured: Sequence[ConstantMeasurement],
    today: date,
    into: Path,
) -> Path:
    """Write a copy of a tool file with other constants; return the copy's path.

    Args:
        tool: name or path of the old file.
        values: new constants by their place in the file, `table.key`, e.g. `calibration.newton_per_volt`. A force
            scale brings its own date and expiry.
        measured: measurements of these constants. Other constants keep their dates and expiries.
        today: date in the new file's name.
        into: folder of the new file, which never overwrites another.

    Raises:
        ConfigurationError: the folder is not writable, or the result is not a valid tool file; no file is left then.
        ServiceError: the disk is full.
    """
    old = find_file(tool, FileKind.TOOL)
    document = tomlkit.parse(old.read_text(encoding=TEXT_ENCODING))
    for place, value in values.items():
        table, key = place.split(".")
        if isinstance(value, ForceScale):
            content = {name: _round_value(each) for name, each in value.model_dump(exclude_none=True).items()}
            document[table].pop(key, None)  # a table must stand after the keys of the table around it
            document[table][key] = tomlkit.item(content)
        else:
            document[table][key] = _round_value(value)
    calibration: Table = document["calibration"]
    anew = {how.constant for how in measured}
    kept = [table for table in calibration.pop("measured", []) if table["constant"] not in anew]
    tables = tomlkit.aot()
    for table in [*kept, *(how.model_dump() for how in measured)]:
        tables.append(tomlkit.item({name: _round_value(value) for name, value in table.items()}))
    calibration["measured"] = tables
    stem, text = DATE_SUFFIX.sub("", old.stem) + f"-{today.isoformat()}", _separate_tables(tomlkit.dumps(document))
    parse_file(text, Tool, str(into / f"{stem}.toml"))
    try:
        return _write_new(into, stem, text)
    except OSError as error:
        raise _create_unwritable_error(into, error) from None


def _round_value(value: object) -> object:
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}") if isinstance(value, float) else value


def _separate_tables(text: str) -> str:
    """Put an empty line before each table."""
    return re.sub(r"(?<!\n)\n\[", "\n\n[", text)


def check_writable(folder: Path) -> None:
    """Check before a calibration that tool files can be written to a folder.

    Raises:
        ConfigurationError: the folder is not writable.
        ServiceError: the disk is full.
    """
    try:
        atomic_write.check_writable(folder)
    except OSError as error:
        raise _create_unwritable_error(folder, error) from None


def _create_unwritable_error(folder: Path, error: OSError) -> GraspwatchError:
    text = (
        f"{folder}: no tool file can be written there ({error.strerror}). Mend that, or name another folder (--into)."
    )
    return build_write_error(text, error)


def _write_new(folder: Path, stem: str, text: str) -> Path:
    for n in range(1, MAX_FILES_PER_DAY):
        path = folder / (f"{stem}.toml" if n == 1 else f"{stem}-{n}.toml")
        try:
            atomic_write.write_atomically(path, text, overwrite=False)
        except FileExistsError:
            continue
        return path
    raise FileExistsError(0, "a thousand of one day are there already")
