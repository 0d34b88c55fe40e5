"""A calibrated tool file: a new one, in which nothing else has changed, beside the old one."""

import datetime
import tomllib
from pathlib import Path

import pytest

from config.errors import ConfigurationError
from config.load import FileKind, find_file, load_tool
from config.schema import ConstantMeasurement
from config.writing import write_calibrated_tool

DAY = datetime.date(2026, 11, 28)
EXPIRES = DAY + datetime.timedelta(days=90)


def measured(constant: str, value: float, expires: datetime.date = EXPIRES) -> ConstantMeasurement:
    return ConstantMeasurement(
        constant=constant,
        value=value,
        low=value,
        high=value,
        unit="N/V",
        residual=0.001,
        residual_unit="V",
        readings=8,
        date=DAY,
        person="a test",
        expires=expires,
    )


def write(into: Path, tool: str = "nidaq", value: float = 12.3456789) -> Path:
    values = {"calibration.newton_per_volt": value, "geometry.opening_m": 0.0102}
    return write_calibrated_tool(tool, values, [measured("newton_per_volt", value)], DAY, into)


def test_only_what_was_measured_is_another(tmp_path: Path) -> None:
    path = write(tmp_path)
    assert path.name == "nidaq-2026-11-28.toml"
    old, new = tomllib.loads(find_file("nidaq", FileKind.TOOL).read_text()), tomllib.loads(path.read_text())
    assert new["calibration"].pop("newton_per_volt") == 12.3457
    assert new["geometry"].pop("opening_m") == 0.0102
    [how] = new["calibration"].pop("measured")
    assert (how["constant"], how["value"]) == ("newton_per_volt", 12.3457)
    assert how["expires"] == datetime.date(2027, 2, 26)
    del old["calibration"]["newton_per_volt"]
    assert new == old
    comments = [line.partition("#")[2] for line in find_file("nidaq", FileKind.TOOL).read_text().splitlines()]
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
    assert expired(third, EXPIRES) == ["newton_per_volt"]
    assert expired(third, EXPIRES - datetime.timedelta(days=1)) == []


def expired(path: Path, day: datetime.date) -> list[str]:
    return [each.constant for each in load_tool(str(path)).find_expired_constants(day)]


def test_a_tare_leaves_an_expired_gain_expired_and_says_when_each_was_measured(tmp_path: Path) -> None:
    """Also where the old file states one day for all constants."""
    old = tmp_path / "old.toml"
    text = find_file("nidaq", FileKind.TOOL).read_text()
    old.write_text(text.replace('person = "paper"', 'person = "paper"\nexpires = 2026-11-01', 1))
    others = ["newton_per_volt", "encoder_deg_per_volt", "handle_per_encoder", "jaw_force_scale"]
    assert set(expired(old, DAY)) == {*others, "rest_offset_v", "strain_sd_v"}
    tared = [measured("rest_offset_v", 0.8), measured("strain_sd_v", 0.002)]
    path = write_calibrated_tool(str(old), {"calibration.rest_offset_v": 0.8}, tared, DAY, tmp_path)
    assert set(expired(path, DAY)) == {*others}
    dates = {each.constant: (each.date, each.expires) for each in load_tool(str(path)).constant_origins}
    assert dates["rest_offset_v"] == ("2026-11-28", EXPIRES)
    assert dates["newton_per_volt"] == ("2013-07-09", datetime.date(2026, 11, 1))
    assert set(expired(path, EXPIRES)) == {*others, "rest_offset_v", "strain_sd_v"}


def test_a_folder_that_cannot_be_written_to_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match=r"no tool file can be written .* \(--into\)"):
        write(tmp_path / "file" / "folder")
