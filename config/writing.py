"""Writes tool files: a new one with what was measured, beside the old one, which stays as it is."""

import re
import tempfile
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path

import tomlkit
from tomlkit.items import Table

from config.errors import ConfigurationError
from config.load import find_tool_file, load_tool
from config.schema import ConstantMeasurement

DATE_SUFFIX = re.compile(r"-\d{4}-\d{2}-\d{2}(-\d+)?$")
MAX_FILES_PER_DAY = 1000
SIGNIFICANT_DIGITS = 6


def write_calibrated_tool(
    tool: str, values: Mapping[str, float], measured: Sequence[ConstantMeasurement], today: date, into: Path
) -> Path:
    """A tool file like that of `tool` (a name or a path), with other constants.

    Args:
        values: by their place in the file, `table.key`, e.g. `calibration.newton_per_volt`.
        measured: how each of them came about. Constants that are not among them keep their dates and expiries.
        into: folder of the new file; it is called like the old one, with the day, and never overwrites any.

    Raises:
        ConfigurationError: the folder cannot be written to, or the outcome is no valid tool file.
    """
    old = find_tool_file(tool)
    document = tomlkit.parse(old.read_text(encoding="utf-8"))
    for place, value in values.items():
        table, key = place.split(".")
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
    load_tool(str(path))
    return path


def _round_value(value: object) -> object:
    """A number as it stands in a file."""
    return float(f"{value:.{SIGNIFICANT_DIGITS}g}") if isinstance(value, float) else value


def _separate_tables(text: str) -> str:
    """With an empty line before each table."""
    return re.sub(r"(?<!\n)\n\[", "\n\n[", text)


def check_writable(folder: Path) -> None:
    """Whether tool files can be written there; before anybody measures in vain.

    Raises:
        ConfigurationError: they cannot.
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
