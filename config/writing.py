"""Write calibrated tool files beside the old ones, which stay unchanged."""

import re
import tempfile
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

import tomlkit
from tomlkit.items import Table

from config.errors import ConfigurationError
from config.load import find_tool_file, load_tool
from config.schema import ConstantMeasurement, ForceScale

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
    """Write a copy of a tool file with other constants and return its path.

    Args:
        tool: name or path of the old file.
        values: new constants by their place in the file, `table.key`, e.g. `calibration.newton_per_volt`. A force
            scale brings its own date and expiry.
        measured: measurements of these constants. Other constants keep their dates and expiries.
        today: date in the new file's name.
        into: folder of the new file, which never overwrites another.

    Raises:
        ConfigurationError: the folder is not writable, or the result is not a valid tool file.
    """
    old = find_tool_file(tool)
    document = tomlkit.parse(old.read_text(encoding="utf-8"))
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
    try:
        path = _write_new(
            into, DATE_SUFFIX.sub("", old.stem) + f"-{today.isoformat()}", _separate_tables(tomlkit.dumps(document))
        )
    except OSError as error:
        raise _create_unwritable_error(into, error) from None
    try:
        load_tool(str(path))
    except ConfigurationError:
        path.unlink()
        raise
    return path


def _round_value(value: object) -> object:
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}") if isinstance(value, float) else value


def _separate_tables(text: str) -> str:
    """Put an empty line before each table."""
    return re.sub(r"(?<!\n)\n\[", "\n\n[", text)


def check_writable(folder: Path) -> None:
    """Check before a calibration that tool files can be written to a folder.

    Raises:
        ConfigurationError: the folder is not writable.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise _create_unwritable_error(folder, error) from None


def _create_unwritable_error(folder: Path, error: OSError) -> ConfigurationError:
    return ConfigurationError(
        f"{folder}: no tool file can be written there ({error.strerror}). Mend that, or name another folder (--into)."
    )


def _write_new(folder: Path, stem: str, text: str) -> Path:
    for n in range(1, MAX_FILES_PER_DAY):
        path = folder / (f"{stem}.toml" if n == 1 else f"{stem}-{n}.toml")
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text)
        except FileExistsError:
            continue
        return path
    raise FileExistsError(0, "a thousand of one day are there already")
