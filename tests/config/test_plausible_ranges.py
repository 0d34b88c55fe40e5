"""Values of a tool file in another unit are refused, with the unit that they are likely in."""

from pathlib import Path

import pytest
import tomlkit

from config.errors import ConfigurationError
from config.load import CONFIG_DIR, list_shipped_names, load_tool
from config.plausible_ranges import RANGES
from config.schema import Tool
from config.writing import write_calibrated_tool

ENDINGS = ("_m", "_deg", "_v", "_s", "_hz", "_n", "_per_volt", "_per_encoder", "_ratio", "_per_s")
SIMULATED = CONFIG_DIR / "tools" / "simulated.toml"

MISTAKES = [
    ("geometry.r_pp_m", 73.15, "mm", 0.07315),
    ("geometry.a_m", 1.01, "cm", 0.0101),
    ("geometry.l0_m", 9.93, "mm", 0.00993),
    ("geometry.l1_m", 4.9, "mm", 0.0049),
    ("geometry.l2_m", 5.7, "mm", 0.0057),
    ("geometry.l_jaw_m", 27.88, "mm", 0.02788),
    ("geometry.l_jaw_m", 1.0976, "inches", 0.02788),
    ("geometry.opening_m", 10.0, "mm", 0.01),
    ("geometry.beta0_deg", 0.33055, "rad", 18.939),
    ("calibration.newton_per_volt", 0.01189, "N/mV", 11.89),
    ("calibration.newton_per_volt", 11890.0, "mN/V", 11.89),
    ("calibration.newton_per_volt", 0.0841, "V/N", 11.89),
    ("calibration.encoder_deg_per_volt", 0.91087, "rad/V", 52.189),
    ("calibration.encoder_deg_per_volt", 0.052189, "deg/mV", 52.189),
    ("calibration.encoder_deg_per_volt", 0.144969, "turns/V", 52.189),
    ("calibration.handle_per_encoder", 10.4444, "degrees of the encoder per degree of the handle", 0.0957447),
    ("calibration.handle_per_encoder", 9.57447, "percent", 0.0957447),
    ("calibration.rest_offset_v", 820.0, "mV", 0.82),
    ("calibration.rest_tolerance_v", 50.0, "mV", 0.05),
    ("calibration.encoder_gear_ratio", 0.0526316, "turns of the gearbox per turn of the encoder", 19.0),
    ("calibration.jaw_force_scale.high", 100.0, "percent", 1.0),
    ("board.sample_rate_hz", 1.0, "kHz", 1000.0),
    ("board.sample_rate_hz", 0.001, "the period in s", 1000.0),
    ("channels.analog_range_v", 10000.0, "mV", 10.0),
    ("noise.strain_sd_v", 2.0, "mV", 0.002),
    ("noise.strain_lsb_v", 0.161, "mV", 0.000161),
    ("limits.max_command_v", 3500.0, "mV", 3.5),
    ("limits.max_command_v_per_s", 0.06, "V/ms", 60.0),
    ("limits.force_ceiling_n", 6000.0, "mN", 6.0),
    ("limits.force_ceiling_n", 612.0, "grams-force", 6.0),
    ("limits.force_ceiling_n", 0.006, "kN", 6.0),
    ("contact.force_rise_v", 5.0, "mV", 0.005),
    ("contact.wall_above_v", 300.0, "mV", 0.3),
    ("contact.wall_slack_deg_per_volt", 0.08727, "rad/V", 5.0),
    ("contact.walk_deg", 2.618, "rad", 150.0),
    ("plausible.strain_step_v", 100.0, "mV", 0.1),
    ("plausible.encoder_step_deg", 0.0556, "turns", 20.0),
    ("simulation.drive_lag_s", 8.0, "ms", 0.008),
    ("simulation.free_travel_m", 0.5, "mm", 0.0005),
    ("simulation.opening_time_s", 50.0, "ms", 0.05),
]


def written(folder: Path, key: str, value: object) -> Path:
    """The shipped simulated tool with another value."""
    document = tomlkit.parse(SIMULATED.read_text(encoding="utf-8"))
    place: dict[str, object] = document
    *tables, name = key.split(".")
    for table in tables:
        place = place[table]  # pyright: ignore[reportAssignmentType]
    place[name] = value
    path = folder / "mine.toml"
    path.write_text(tomlkit.dumps(document), encoding="utf-8")
    return path


@pytest.mark.parametrize(("key", "value", "unit", "meant"), MISTAKES)
def test_a_value_in_another_unit_is_refused_with_the_unit_it_is_likely_in(
    tmp_path: Path, key: str, value: float, unit: str, meant: float
) -> None:
    path = written(tmp_path, key, value)
    with pytest.raises(ConfigurationError) as refused:
        load_tool(str(path))
    told = str(refused.value)
    assert f"{path}: {key}: {value:g} " in told
    assert unit in told
    advised = [float(words.split()[0].rstrip(";")) for words in told.split("write ")[1:]]
    assert any(number == pytest.approx(meant, rel=0.01) for number in advised), told


def test_a_map_in_millivolts_is_refused_too(tmp_path: Path) -> None:
    path = written(tmp_path, "command_to_force.command_v", [0.0, 500.0, 2000.0])
    with pytest.raises(ConfigurationError, match=r"command_to_force\.command_v: 500 V is not plausible.*write 0\.5"):
        load_tool(str(path))


def test_all_faults_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    path = written(tmp_path, "geometry.a_m", 10.1)
    path.write_text(path.read_text().replace("l1_m = 0.0049", "l1_m = 4.9"))
    with pytest.raises(ConfigurationError) as refused:
        load_tool(str(path))
    assert str(refused.value).startswith("2 faults to mend:\n")


@pytest.mark.parametrize("name", list_shipped_names("tools"))
def test_shipped_tools_are_plausible(name: str) -> None:
    load_tool(name)


def test_every_length_gain_and_rate_of_a_tool_file_has_a_range() -> None:
    def numbers(model: type, prefix: str) -> list[str]:
        found = []
        for name, field in model.model_fields.items():
            inner = field.annotation
            nested = [each for each in (inner, *getattr(inner, "__args__", ())) if hasattr(each, "model_fields")]
            if nested and name != "measured":
                found += [key for each in nested for key in numbers(each, f"{prefix}{name}.")]
            elif name.endswith(
                ("_m", "_deg", "_v", "_s", "_hz", "_n", "_per_volt", "_per_encoder", "_ratio", "_per_s")
            ):
                found.append(prefix + name)
        return found

    assert set(numbers(Tool, "")) <= set(RANGES)


def test_a_calibration_that_gives_no_plausible_tool_leaves_no_file(tmp_path: Path) -> None:
    import datetime

    with pytest.raises(ConfigurationError, match="newton_per_volt"):
        write_calibrated_tool(
            "simulated", {"calibration.newton_per_volt": 11890.0}, [], datetime.date(2026, 1, 1), tmp_path
        )
    assert not list(tmp_path.iterdir())
