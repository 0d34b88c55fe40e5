"""A calibrated tool file: a new one, in which nothing else has changed, beside the old one."""

import datetime
import tomllib
from pathlib import Path

import pytest

from config.errors import ConfigurationError
from config.load import file_of_tool, load_tool
from config.schema import Measured
from config.writing import write_calibrated

DAY = datetime.date(2026, 11, 28)
EXPIRES = DAY + datetime.timedelta(days=90)


def measured(constant: str, value: float, expires: datetime.date = EXPIRES) -> Measured:
    return Measured(
        constant=constant, value=value, low=value, high=value, unit="N/V", residual=0.001, residual_unit="V",
        readings=8, date=DAY, person="a test", expires=expires,
    )  # fmt: skip


def write(into: Path, tool: str = "nidaq", value: float = 12.3456789) -> Path:
    values = {"calibration.newton_per_volt": value, "geometry.opening_m": 0.0102}
    return write_calibrated(tool, values, [measured("newton_per_volt", value)], DAY, "a test", into)


def test_only_what_was_measured_is_another(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert path.name == "nidaq-2026-11-28.toml"
    old, new = tomllib.loads(file_of_tool("nidaq").read_text()), tomllib.loads(path.read_text())
    assert new["calibration"].pop("newton_per_volt") == 12.3457
    assert new["geometry"].pop("opening_m") == 0.0102
    [how] = new["calibration"].pop("measured")
    assert (how["constant"], how["value"]) == ("newton_per_volt", 12.3457)
    assert new["calibration"].pop("expires") == datetime.date(2027, 2, 26)
    assert (new["calibration"].pop("date"), new["calibration"].pop("person")) == ("2026-11-28", "a test")
    for key in ("newton_per_volt", "date", "person"):
        del old["calibration"][key]
    assert new == old
    comments = [line.partition("#")[2] for line in file_of_tool("nidaq").read_text().splitlines()]
    assert all(comment in path.read_text() for comment in comments)


def test_the_old_one_stays_and_the_next_one_follows_it(tmp_path: Path) -> None:
    first = write(tmp_path)
    content = first.read_text()
    second = write(tmp_path, str(first), 13.0)
    third = write(tmp_path, str(second), 14.0)
    assert [path.name for path in (second, third)] == ["nidaq-2026-11-28-2.toml", "nidaq-2026-11-28-3.toml"]
    assert first.read_text() == content
    assert load_tool(str(third)).calibration.newton_per_volt == 14.0
    assert len(load_tool(str(third)).calibration.measured) == 1  # the newest
    hash(load_tool(str(third)))  # it is a key of caches
    assert load_tool(str(third)).calibration.is_expired(datetime.date(2027, 2, 26))
    assert not load_tool(str(third)).calibration.is_expired(datetime.date(2027, 2, 25))


def test_a_new_tare_makes_no_old_gain_newer(tmp_path: Path) -> None:
    later = measured("rest_offset_v", 0.8, EXPIRES + datetime.timedelta(days=300))
    first = write(tmp_path)
    second = write_calibrated(str(first), {"calibration.rest_offset_v": 0.8}, [later], DAY, "a test", tmp_path)
    assert load_tool(str(second)).calibration.expires == EXPIRES
    third = write_calibrated(
        str(second), {"calibration.newton_per_volt": 12.0}, [measured("newton_per_volt", 12.0, later.expires)], DAY,
        "a test", tmp_path,
    )  # fmt: skip
    assert load_tool(str(third)).calibration.expires == later.expires


def test_a_folder_that_cannot_be_written_to_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match=r"no tool file can be written .* \(--into\)"):
        write(tmp_path / "file" / "folder")
