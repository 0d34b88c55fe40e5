"""The scale of newtons in a tool file: an interval, by whom, and what it means for what protects tissue."""

import re
from pathlib import Path

import numpy as np
import pytest

from acquisition.signals.calibration import compute_jaw_signals
from config.errors import ConfigurationError
from config.load import FileKind, find_file, load_library, load_tool
from config.schema import ForceLaw

LIBRARY = load_library("porcine")
MEASURED = """jaw_force_scale = { value = 0.1, low = 0.08, high = 0.12, measured = true, source = "load cell", \
date = 2026-11-20, expires = 2027-11-20 }"""


def tool_with(folder: Path, scale: str, name: str = "nidaq"):
    """A shipped tool file with another line for the scale."""
    text = re.sub(r"\[calibration\.jaw_force_scale\](\n|.)*?\n\n", "\n", find_file(name, FileKind.TOOL).read_text())
    path = folder / "tool.toml"
    path.write_text(text.replace("rest_offset_v", f"{scale}\nrest_offset_v", 1))
    return load_tool(str(path))


def test_shipped_tools_say_by_which_scale_newtons_are() -> None:
    assert load_tool("nidaq").scale_text == "N by Eq. (2), scale 1.0 (0.05 to 1.0), not measured"
    rig, printed = load_tool("smart_tool_2013"), load_tool("smart_tool_2013_eq2")
    assert rig.scale_text == "N by a constant 0.75 N/V of strain (0.6 to 0.9), not measured"
    assert printed.scale_text == "N by Eq. (2), scale 1.0 (0.05 to 1.0), not measured"
    assert rig.calibration_fingerprint != printed.calibration_fingerprint
    assert load_tool("simulated").scale_text == "N by Eq. (2), scale exactly 1.0: simulated"
    assert not load_tool("nidaq").has_known_scale, "a motor, and newtons that nobody measured"
    assert all(load_tool(name).has_known_scale for name in ("smart_tool_2013", "simulated"))
    assert load_tool("simulated").to_displayed_n(1 / 3) == 1 / 3


def test_what_protects_tissue_reckons_with_the_upper_end(tmp_path: Path) -> None:
    tool = tool_with(tmp_path, MEASURED)
    assert tool.scale_text == "N by Eq. (2), scale 0.1 (0.08 to 0.12), measured 2026-11-20"
    assert tool.has_known_scale
    assert tool.to_displayed_n(1.2) == pytest.approx(1.0)
    for tissue, shown_n in LIBRARY.convert_thresholds_to_displayed_n(tool).items():
        assert shown_n == pytest.approx(LIBRARY.threshold_n(tissue) / 1.2)
    assert tool.constant_origins[-1].expires.isoformat() == "2027-11-20"


@pytest.mark.parametrize("line", ["", "jaw_force_scale = 1.0", "jaw_force_scale = 0.2", "jaw_force_scale = 7"])
def test_a_number_alone_is_not_measured_and_nothing_narrows_its_interval(tmp_path: Path, line: str) -> None:
    tool = tool_with(tmp_path, line)
    scale = tool.calibration.jaw_force_scale
    assert not tool.has_known_scale
    assert (scale.low, scale.high) == (0.05, max(scale.value, 1.0))
    assert tool.calibration_fingerprint == tool_with(tmp_path, line).calibration_fingerprint


def test_a_constant_scale_is_newtons_per_volt_at_every_angle_of_the_jaws() -> None:
    strain_v, encoder_deg = np.array([0.1, 1.0, 2.5]), np.array([100.0, 150.0, 300.0])
    jaw = compute_jaw_signals(load_tool("smart_tool_2013"), strain_v, encoder_deg)
    printed = compute_jaw_signals(load_tool("smart_tool_2013_eq2"), strain_v, encoder_deg)
    assert jaw.valid.all()
    np.testing.assert_allclose(jaw.force_n, 0.75 * strain_v, rtol=1e-12)
    np.testing.assert_allclose(jaw.newton_per_volt, 0.75, rtol=1e-12)
    np.testing.assert_array_equal(jaw.displacement_m, printed.displacement_m)
    assert (printed.force_n > 6 * strain_v).all()  # Eq. (2): 6.2 N/V with open jaws


def test_a_simulated_tool_of_before_is_exact(tmp_path: Path) -> None:
    tool = tool_with(tmp_path, "jaw_force_scale = 0.5", "simulated")
    assert (tool.max_force_factor, tool.has_known_scale) == (1.0, True)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (MEASURED.replace("low = 0.08", "low = 0.11"), "low <= value <= high"),
        (MEASURED.replace("high = 0.12", "high = 0.09"), "low <= value <= high"),
        (MEASURED.replace("low = 0.08", "low = 0.0"), "jaw_force_scale.low: Input should be greater than 0"),
        (MEASURED.replace("date = 2026-11-20, ", ""), "needs the date"),
        (MEASURED.replace(', source = "load cell"', ""), "jaw_force_scale.source: Field required"),
        ("jaw_force_scale = 0.0", "calibration.jaw_force_scale: Input should be greater than 0"),
        ("jaw_force_scale = nan", "jaw_force_scale"),
        ("jaw_force_scale = true", "jaw_force_scale: Input should be an object"),
    ],
)
def test_an_impossible_scale_is_refused(tmp_path: Path, line: str, says: str) -> None:
    with pytest.raises(ConfigurationError, match=re.escape(says)):
        tool_with(tmp_path, line)


def test_the_smart_tool_by_equation_2_differs_in_its_scale_alone() -> None:
    constant, eq2 = (
        load_tool(name).model_dump(exclude={"name", "title"}) for name in ("smart_tool_2013", "smart_tool_2013_eq2")
    )
    scales = [each["calibration"].pop("jaw_force_scale") for each in (constant, eq2)]
    assert constant == eq2
    assert [scale["law"] for scale in scales] == [ForceLaw.CONSTANT, ForceLaw.EQUATION_2]
