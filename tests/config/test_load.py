"""Configuration files: what is shipped, and what a person is told who gets one wrong."""

import codecs
import math
import typing
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from config.errors import ConfigurationError
from config.load import (
    CONFIG_DIR,
    FileKind,
    build_graspable_library,
    find_file,
    list_faults,
    list_names,
    list_shipped_names,
    load_grasp_protocol,
    load_library,
    load_own_file,
    load_settings,
    load_tool,
    parse_file,
)
from config.schema import GraspProtocol, Settings, TissueLibrary, Tool
from config.writing import write_calibrated_tool

LOADERS = {"tools": load_tool, "tissues": load_library, "protocols": load_grasp_protocol}
SHIPPED = [(folder, name) for folder in LOADERS for name in list_shipped_names(folder)]
TISSUES = ("liver", "small_bowel", "bladder", "gallbladder")
TWO_N_MM = {"liver": "1.97", "small_bowel": "1.96", "bladder": "20.0", "gallbladder": "10.5"}
TWO_N_STRAIN = {"liver": "0.26", "small_bowel": "0.36", "bladder": "0.77", "gallbladder": "0.40"}
MODULUS_KPA = {"liver": "12.2", "small_bowel": "6.2", "bladder": "0.0", "gallbladder": "4.3"}
THRESHOLD_N = {"liver": "3.38", "small_bowel": "5.63", "bladder": "2.25", "gallbladder": "2.25"}

TRAPEZOID = """
name = "mine"
title = "Mine"
[waveform]
shape = "trapezoid"
peak_v = 2.0
ramp_up_s = 0.1
hold_s = 0.5
ramp_down_s = 0.1
rest_s = 0.5
"""


def as_printed(value: float, printed: str) -> bool:
    """Whether `value` rounds to the number as it is printed."""
    return f"{value:.{len(printed.partition('.')[2])}f}" == printed


def fault_of(load: Callable[..., object], path: Path | str, *data_folder: Path) -> str:
    with pytest.raises(ConfigurationError) as caught:
        load(str(path), *data_folder)
    return str(caught.value)


def edited(path: Path, text: str, *changes: tuple[str, str]) -> Path:
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    return path


def displacement_m(library: TissueLibrary, tissue: str, force_n: float) -> float:
    """Eq. (7) at rest, solved for the displacement."""
    profile = library.tissues[tissue]
    return math.log1p(force_n / profile.alpha_n) / profile.beta_per_m


# --- what is shipped -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("folder", "name"), SHIPPED)
def test_every_shipped_file_loads_under_its_own_name(folder: str, name: str) -> None:
    assert LOADERS[folder](name).name == name


@pytest.mark.parametrize(("folder", "name"), SHIPPED)
def test_a_shipped_file_is_the_same_by_name_and_by_path(folder: str, name: str) -> None:
    assert LOADERS[folder](str(CONFIG_DIR / folder / f"{name}.toml")) == LOADERS[folder](name)


def test_the_shipped_settings_say_what_the_defaults_are_and_name_files_that_exist(settings: Settings) -> None:
    assert settings == Settings()
    assert load_tool(settings.tool).kind == "simulated"
    assert set(load_library(settings.library).tissues) == set(TISSUES)


def test_porcine_is_table_2_read_as_a_stress_over_strain(library: TissueLibrary) -> None:
    """Eq. (21): alpha is alpha-bar times the jaw area, and beta is beta-bar over the thickness, for every tissue."""
    printed = load_library("paper_table2")
    assert set(printed.tissues) == set(library.tissues) == set(TISSUES)
    assert (printed.mass_kg, printed.jaw_area_m2) == (library.mass_kg, library.jaw_area_m2) == (0.005, 56.3e-6)
    for name in TISSUES:
        table, profile = printed.tissues[name], library.tissues[name]
        assert (profile.alpha_pa, profile.beta_per_strain) == (table.alpha_n, table.beta_per_m)  # the printed numbers
        assert profile.alpha_n == pytest.approx(table.alpha_n * 56.3e-6, rel=1e-12)
        assert profile.beta_per_m == pytest.approx(table.beta_per_m / table.thickness_m, rel=1e-12)
        for same in ("damping_kg_per_s", "thickness_m", "threshold_pa"):
            assert getattr(profile, same) == getattr(table, same)


@pytest.mark.parametrize("tissue", TISSUES)
def test_each_tissue_is_as_stiff_as_living_tissue(library: TissueLibrary, tissue: str) -> None:
    """The modulus at small strains: 2 to 20 kPa in living liver. The former reading gave liver 216 kPa."""
    profile = library.tissues[tissue]
    modulus_pa = profile.alpha_n * profile.beta_per_m * profile.thickness_m / library.jaw_area_m2
    assert as_printed(modulus_pa / 1e3, MODULUS_KPA[tissue])


def test_tissue_thicker_than_the_jaws_open_is_held_as_a_fold(library: TissueLibrary) -> None:
    opening_m = load_tool("simulated").geometry.opening_m
    assert opening_m
    folds = {name for name, profile in library.tissues.items() if profile.preload_n}
    assert folds == {name for name, profile in library.tissues.items() if profile.thickness_m > opening_m}


def test_a_recorded_library_keeps_its_units(library: TissueLibrary) -> None:
    assert TissueLibrary.model_validate_json(library.model_dump_json()) == library
    before = library.model_dump()
    del before["units"]
    for profile in before["tissues"].values():
        for key in ("alpha_pa", "beta_per_strain", "preload_n"):
            del profile[key]
    assert TissueLibrary.model_validate(before).units is None  # as in recordings of earlier versions


@pytest.mark.parametrize("tissue", TISSUES)
def test_two_newton_compress_each_tissue_by_a_believable_share(library: TissueLibrary, tissue: str) -> None:
    x_m = displacement_m(library, tissue, 2.0)
    assert as_printed(x_m * 1e3, TWO_N_MM[tissue])
    assert as_printed(x_m / library.tissues[tissue].thickness_m, TWO_N_STRAIN[tissue])


def test_as_printed_two_newton_compress_a_bladder_to_ten_times_its_thickness() -> None:
    printed = load_library("paper_table2")
    assert as_printed(displacement_m(printed, "liver", 2.0) * 1e3, "0.16")
    assert as_printed(displacement_m(printed, "bladder", 2.0) * 1e3, "293")


@pytest.mark.parametrize("name", ["porcine", "paper_table2"])
def test_injury_thresholds_are_the_papers(name: str) -> None:
    thresholds = {tissue: load_library(name).threshold_n(tissue) for tissue in TISSUES}
    assert all(as_printed(thresholds[tissue], THRESHOLD_N[tissue]) for tissue in TISSUES)
    assert load_library(name).lowest_threshold_n == min(thresholds.values())


def test_a_library_in_the_old_units_is_refused_with_what_to_do(tmp_path: Path) -> None:
    text = (CONFIG_DIR / "tissues/out_of_library.toml").read_text(encoding="utf-8")
    fault = fault_of(load_library, edited(tmp_path / "old.toml", text, ('units = "newton and meter"\n', "")))
    assert "does not say in which units alpha and beta are" in fault
    assert "take `porcine`, or state alpha_pa and beta_per_strain" in fault
    assert 'add units = "newton and meter"' in fault


@pytest.mark.parametrize(
    ("units", "says"), [("", "does not say in which units"), ('units = "psi"', "units: Input should")]
)
def test_missing_or_misspelled_units_are_the_only_fault_that_is_told(units: str, says: str) -> None:
    text = (CONFIG_DIR / "tissues/porcine.toml").read_text(encoding="utf-8")
    with pytest.raises(ConfigurationError) as refused:
        parse_file(text.replace('units = "pascal and strain"', units), TissueLibrary, "a text")
    [fault] = list_faults(refused.value, "a text")
    assert says in fault


def test_a_text_may_begin_with_a_byte_order_mark() -> None:
    text = (CONFIG_DIR / "protocols/trapezoid_2hz.toml").read_text(encoding="utf-8")
    assert parse_file(f"\ufeff{text}", GraspProtocol, "a text") == load_grasp_protocol("trapezoid_2hz")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "alpha_pa = 849.2",
            "alpha_pa = 849.2\nalpha_n = 0.8492",
            "liver: alpha_n and beta_per_m are not the 0.04781 N",
        ),
        ("beta_per_strain = 14.32", "beta_per_m = 1909.333333333", "liver: a library in pascal and strain states"),
        ("alpha_pa = 849.2", "", "liver: a library in pascal and strain states alpha_pa"),
        ("preload_n = [0.01, 0.05]", "preload_n = [0.05, 0.01]", "its lower end first"),
    ],
)
def test_parameters_that_contradict_each_other_or_are_missing_are_faults(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    text = (CONFIG_DIR / "tissues/porcine.toml").read_text(encoding="utf-8")
    assert says in fault_of(load_library, edited(tmp_path / "library.toml", text, (old, new)))


def test_a_simulated_grasper_can_hold_more_than_the_library_has() -> None:
    library = load_library("porcine")
    wider = build_graspable_library(library)
    assert set(wider.tissues) == set(library.tissues) | set(load_library("out_of_library").tissues)
    assert all(wider.tissues[name] == profile for name, profile in library.tissues.items())
    assert wider.spread_of("spleen") == load_library("out_of_library").spread_of("spleen")


@pytest.mark.parametrize("name", ["nidaq", "simulated", "smart_tool_2013", "smart_tool_2013_eq2"])
def test_every_smart_tool_has_the_papers_geometry_and_calibration(name: str) -> None:
    tool = load_tool(name)
    calibration, geometry = tool.calibration, tool.geometry
    millimetres = [geometry.r_pp_m, geometry.a_m, geometry.l0_m, geometry.l1_m, geometry.l2_m, geometry.l_jaw_m]
    np.testing.assert_allclose(np.array(millimetres) * 1e3, [73.15, 10.1, 9.93, 4.9, 5.7, 27.88], rtol=1e-12)  # Table I
    assert geometry.beta0_deg == 18.939
    assert (calibration.newton_per_volt, calibration.encoder_deg_per_volt) == (11.89, 52.189)  # Eqs. (1), (3)
    assert calibration.handle_per_encoder == pytest.approx(18 / 188, rel=1e-15)  # Eq. (5)
    assert as_printed(calibration.encoder_resolution_deg, "0.009474")  # the step seen in the recordings
    assert tool.limits.force_ceiling_n > float(THRESHOLD_N["small_bowel"])


@given(st.floats(0, 10))
def test_command_and_force_maps_undo_each_other_and_pass_the_papers_points(command_v: float) -> None:
    mapping = load_tool("simulated").command_to_force
    assert float(mapping.to_command_v(mapping.to_force_n(command_v))) == pytest.approx(command_v, abs=1e-12)
    np.testing.assert_allclose(mapping.to_force_n(np.array([0.0, 0.5, 2.0])), [0.0, 0.8, 1.55], rtol=1e-12)
    slope_n_per_v = (1.55 - 0.8) / 1.5
    if command_v > 0.5:  # the last line goes on beyond its end
        assert float(mapping.to_force_n(command_v)) == pytest.approx(0.8 + slope_n_per_v * (command_v - 0.5), rel=1e-12)


# --- own files of the data folder ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", FileKind)
def test_an_own_file_is_chosen_by_its_name_and_a_shipped_one_comes_first(kind: FileKind, tmp_path: Path) -> None:
    load, shipped = LOADERS[kind.folder], list_shipped_names(kind.folder)[0]
    text = (CONFIG_DIR / kind.folder / f"{shipped}.toml").read_text(encoding="utf-8")
    folder = tmp_path / kind.folder
    folder.mkdir()
    own = edited(folder / "mine.toml", text, (f'name = "{shipped}"', 'name = "mine"'))
    assert (load("mine", tmp_path).name, find_file("mine", kind, str(tmp_path))) == ("mine", own)
    assert list_names(kind, tmp_path) == sorted([*list_shipped_names(kind.folder), "mine"])
    with pytest.raises(ConfigurationError, match="'mine'"):
        load("mine")  # without the data folder there is no such name
    (folder / f"{shipped}.toml").write_text("no file at all")
    assert load(shipped, tmp_path) == load(shipped)
    with pytest.raises(ConfigurationError, match=r"there is a shipped .*Rename the file"):
        load_own_file(edited(folder / f"{shipped}.toml", text), kind)
    (folder / ".hidden.toml").write_text(text)
    (folder / "faulty.toml").write_text("name = ")
    assert "is not valid TOML" in fault_of(load, "faulty", tmp_path)
    assert {"hidden", ".hidden"}.isdisjoint(list_names(kind, tmp_path))


def test_an_own_file_has_the_name_that_stands_in_it_but_calibrations_add_their_day(tmp_path: Path) -> None:
    for folder, name, other in (
        ("protocols", "sine", "renamed"),
        ("tissues", "porcine", "renamed"),
        ("tools", "simulated", "simulated-2026-11-30"),
    ):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / f"{other}.toml").write_text((CONFIG_DIR / folder / f"{name}.toml").read_text())
    for load in (load_grasp_protocol, load_library):
        assert "Give both the same name" in fault_of(load, "renamed", tmp_path)
    assert load_tool("simulated-2026-11-30", tmp_path).name == "simulated"


def test_a_text_is_checked_as_a_file_with_one_message_for_each_fault() -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_file('name = "A B"\ntitle = "x"\n[waveform]\nshape = "sine"', GraspProtocol, "protocol")
    faults = list_faults(caught.value, "protocol")
    assert len(faults) == 6
    assert not any(fault.startswith("protocol") for fault in faults)


@pytest.mark.parametrize(
    ("key", "differs"), [("calibration", []), ("geometry", []), ("noise", []), ("limits", ["limits"])]
)
def test_only_constants_of_a_calibration_may_differ(tool: Tool, key: str, differs: list[str]) -> None:
    other = tool.model_copy(update={key: None})
    assert tool.find_differences_beside_constants(other) == differs


# --- files with faults -----------------------------------------------------------------------------------------------


def test_all_faults_of_a_file_are_told_at_once_each_with_its_place(tmp_path: Path) -> None:
    path = edited(
        tmp_path / "tool.toml",
        (CONFIG_DIR / "tools/simulated.toml").read_text(),
        ("sample_rate_hz = 1000.0", 'sample_rate_hz = "fast"'),
        ("l_jaw_m = 0.02788\n", ""),
        ("max_command_v = 3.5", "max_command_v = -3.5"),
        ("strain_sd_v", "strain_sd_mv"),
    )
    told = fault_of(load_tool, path).splitlines()
    places = (
        "board.sample_rate_hz",
        "geometry.l_jaw_m",
        "limits.max_command_v",
        "noise.strain_sd_v",
        "noise.strain_sd_mv",
    )
    assert told[0] == f"{len(places)} faults to mend:"
    assert len(told) == 1 + len(places)
    for place in places:
        assert sum(line.startswith(f"{path}: {place}: ") for line in told) == 1
    assert any("'fast'" in line for line in told)
    assert any("-3.5" in line for line in told)


@pytest.mark.parametrize(
    ("load", "shipped", "right", "wrong"),
    [
        (load_grasp_protocol, "protocols/trapezoid_2hz", "peak_v", "peak_mv"),
        (load_library, "tissues/porcine", "beta_per_strain", "beta_strain"),
        (load_tool, "tools/nidaq", "force_ceiling_n", "force_ceiling"),
        (lambda path: load_settings(Path(path)), "graspwatch", "frame_rate_hz", "framerate_hz"),
    ],
)
def test_a_misspelt_or_wrongly_scaled_key_is_refused_and_the_right_one_suggested(
    tmp_path: Path, load: Callable[[str], object], shipped: str, right: str, wrong: str
) -> None:
    text = (CONFIG_DIR / f"{shipped}.toml").read_text()
    told = fault_of(load, edited(tmp_path / "file.toml", text, (right, wrong)))
    line = next(line for line in told.splitlines() if "unknown key" in line)
    assert f".{wrong}: " in line
    assert f"did you mean '{right}'?" in line


def test_a_key_like_no_other_gets_no_suggestion(tmp_path: Path) -> None:
    told = fault_of(load_grasp_protocol, edited(tmp_path / "p.toml", TRAPEZOID, ("title", "zzzzz = 1\ntitle")))
    assert "zzzzz: unknown key" in told
    assert "did you mean" not in told


@pytest.mark.parametrize("value", ['"2.0"', "true", "[2.0]", "nan", "inf", "-1.0", "0.0"])
def test_a_value_of_the_wrong_kind_or_outside_its_range_is_told_with_its_key(tmp_path: Path, value: str) -> None:
    told = fault_of(load_grasp_protocol, edited(tmp_path / "p.toml", TRAPEZOID, ("peak_v = 2.0", f"peak_v = {value}")))
    assert told.startswith("1 fault to mend:")
    assert "waveform" in told
    assert "peak_v" in told


def test_whole_numbers_do_for_decimal_ones(tmp_path: Path) -> None:
    path = edited(tmp_path / "p.toml", TRAPEZOID, ("peak_v = 2.0", "peak_v = 2"))
    assert load_grasp_protocol(str(path)).waveform.peak_v == 2.0


@pytest.mark.parametrize("cycles", ["0", "10001", "1.5", '"3"'])
def test_cycles_are_whole_and_bounded(tmp_path: Path, cycles: str) -> None:
    path = edited(tmp_path / "p.toml", TRAPEZOID, ('title = "Mine"', f'title = "Mine"\ncycles = {cycles}'))
    assert f"{path}: cycles: " in fault_of(load_grasp_protocol, path)


@pytest.mark.parametrize(
    ("table", "told"),
    [
        ('shape = "triangle"', "triangle"),
        ("peak_v = 1.0", "shape"),
        ('shape = "custom"\ntime_s = [0, 1, 2]\ncommand_v = [0, 1]\nrest_s = 1', "command_v"),
        ('shape = "custom"\ntime_s = [0, 1, 2]\ncommand_v = [0, 1, 0.5]\nrest_s = 1', "end at 0"),
        ('shape = "custom"\ntime_s = [0, 2, 1]\ncommand_v = [0, 1, 0]\nrest_s = 1', "rise strictly"),
        ('shape = "custom"\ntime_s = [1, 2, 3]\ncommand_v = [0, 1, 0]\nrest_s = 1', "begin at 0"),
    ],
)
def test_a_waveform_that_is_none_is_refused_with_what_it_lacks(tmp_path: Path, table: str, told: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'name = "mine"\ntitle = "Mine"\n[waveform]\n{table}\n')
    assert told in fault_of(load_grasp_protocol, path)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("force_n = [0.0, 0.8, 1.55]", "force_n = [0.0, 0.8]"), "same number of points"),
        (("force_n = [0.0, 0.8, 1.55]", "force_n = [0.0, 0.8, 0.8]"), "rise strictly"),
        (("command_v = [0.0, 0.5, 2.0]", "command_v = [0.1, 0.5, 2.0]"), "begin at 0"),
        (('kind = "simulated"', 'kind = "real"'), "'serial' or 'recording'"),
    ],
)
def test_a_tool_whose_parts_contradict_each_other_is_refused(
    tmp_path: Path, change: tuple[str, str], told: str
) -> None:
    text = (CONFIG_DIR / "tools/simulated.toml").read_text()
    assert told in fault_of(load_tool, edited(tmp_path / "tool.toml", text, change))


def test_a_simulated_tool_needs_its_mechanics(tmp_path: Path) -> None:
    text = (CONFIG_DIR / "tools/nidaq.toml").read_text()
    path = edited(tmp_path / "tool.toml", text, ('kind = "nidaq"', 'kind = "simulated"'))
    assert "needs a [simulation] table" in fault_of(load_tool, path)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("withdraw_below = 0.85", "withdraw_below = 0.95"), "withdraw_below must be lower than decide_at"),
        (("low = 0.7", "low = 0.95"), "low < medium < high"),
        (("port = 8000", "port = 70000"), "server.port"),
        (("prior_unknown = 0.05", "prior_unknown = 0.0"), "identification.prior_unknown"),
        (("margin = 0.8", "margin = 1.0"), "limiter.margin"),
        (("limit_expires_s = 0.1", "limit_expires_s = 0.0"), "limiter.limit_expires_s"),
    ],
)
def test_settings_that_make_no_sense_are_refused(tmp_path: Path, change: tuple[str, str], told: str) -> None:
    path = edited(tmp_path / "mine.toml", (CONFIG_DIR / "graspwatch.toml").read_text(), change)
    assert told in fault_of(lambda name: load_settings(Path(name)), path)


@pytest.mark.parametrize("reserved", ["unknown", "undecided"])
def test_a_tissue_cannot_be_called_what_the_program_says_when_it_does_not_know(tmp_path: Path, reserved: str) -> None:
    text = (CONFIG_DIR / "tissues/porcine.toml").read_text()
    path = edited(tmp_path / "library.toml", text, ("[tissues.liver]", f"[tissues.{reserved}]"))
    assert f"{reserved}: reserved" in fault_of(load_library, path)


def test_a_library_needs_a_tissue(tmp_path: Path) -> None:
    text = (CONFIG_DIR / "tissues/porcine.toml").read_text()
    path = tmp_path / "library.toml"
    path.write_text(text[: text.index("[tissues.liver]")] + "[tissues]\n")
    assert f"{path}: tissues: " in fault_of(load_library, path)


def test_a_tissue_may_spread_otherwise_than_its_library(tmp_path: Path) -> None:
    text = (CONFIG_DIR / "tissues/porcine.toml").read_text()
    own = "[tissues.liver.spread]\nlog_alpha = 0.5\nlog_beta = 0.2\nlog_damping = 0.1\n\n[tissues.small_bowel]"
    library = load_library(str(edited(tmp_path / "library.toml", text, ("[tissues.small_bowel]", own))))
    assert library.spread_of("liver").log_alpha == 0.5
    assert library.spread_of("bladder") == library.spread


# --- files that are none ---------------------------------------------------------------------------------------------


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert fault_of(load_tool, tmp_path / "none.toml").startswith(f"{tmp_path / 'none.toml'}: there is no such file")


def test_broken_toml_is_told_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text('name = "mine"\ntitle = \n')
    told = fault_of(load_grasp_protocol, path)
    assert told.startswith(f"{path}: is not valid TOML")
    assert "line 2" in told


@pytest.mark.parametrize("content", [b"\x89PNG\r\n\x1a\n\x00\xff\xfe", "name = 'Größe'".encode("latin-1")])
def test_a_binary_or_wrongly_encoded_file_is_told(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "p.toml"
    path.write_bytes(content)
    assert fault_of(load_grasp_protocol, path).startswith(f"{path}: cannot be read as a text file")


def test_a_byte_order_mark_is_no_content(tmp_path: Path) -> None:
    """Editors on Windows write one; a calibrated copy of such a tool file has none."""
    for folder, name in (("tools", "simulated"), ("tissues", "porcine"), ("protocols", "trapezoid_2hz")):
        path = tmp_path / f"{name}.toml"
        path.write_bytes(codecs.BOM_UTF8 + (CONFIG_DIR / folder / f"{name}.toml").read_bytes())
        assert LOADERS[folder](str(path)) == LOADERS[folder](name)
    calibrated = write_calibrated_tool(
        str(tmp_path / "simulated.toml"), {"calibration.newton_per_volt": 5.0}, (), date(2026, 11, 30), tmp_path
    )
    assert not calibrated.read_bytes().startswith(codecs.BOM_UTF8)


def test_a_tilde_in_a_file_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    path = tmp_path / "settings.toml"
    path.write_text(
        'data_folder = "~/data"\ntool = "~/mine.toml"\nlibrary = "~/mine.toml"\n[server]\n'
        'tls_cert = "~/cert.pem"\ntls_key = "~/key.pem"\n'
    )
    settings = load_settings(path)
    named = (settings.data_folder, settings.tool, settings.library, settings.server.tls_cert, settings.server.tls_key)
    assert all(str(each).startswith(f"{tmp_path}/") for each in named)
    shipped = (CONFIG_DIR / "tools/simulated.toml").read_text()
    keys = 'grpc_address = "board:31763"\ngrpc_ca = "~/ca.pem"\ngrpc_cert = "~/c.pem"\ngrpc_key = "~/k.pem"\n'
    (tmp_path / "mine.toml").write_text(shipped.replace("[board]\n", f"[board]\n{keys}", 1))
    board = load_tool("~/mine.toml").board
    assert (board.grpc_ca, board.grpc_key) == (f"{tmp_path}/ca.pem", f"{tmp_path}/k.pem")
    path.write_text('data_folder = "~nobody-of-this-name/data"\n')
    with pytest.raises(ConfigurationError, match="there is no such home folder"):
        load_settings(path)


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    assert fault_of(load_library, tmp_path).startswith(f"{tmp_path}: cannot be read")


def test_an_empty_file_lacks_all_its_keys(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.touch()
    told = fault_of(load_grasp_protocol, path)
    assert all(f"{path}: {key}: " in told for key in ("name", "title", "waveform"))


@pytest.mark.parametrize(
    ("folder", "near", "meant"),
    [("tools", "simulate", "simulated"), ("tissues", "porcin", "porcine"), ("protocols", "sinus", "sine")],
)
def test_an_unknown_name_is_told_with_what_there_is(folder: str, near: str, meant: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        LOADERS[folder](near)
    assert f"Did you mean {meant!r}?" in str(caught.value)
    assert all(name in str(caught.value) for name in list_shipped_names(folder))
    with pytest.raises(ConfigurationError, match=r"There is no .* 'xyz'\. There is: "):
        LOADERS[folder]("xyz")


def test_what_was_loaded_cannot_be_changed(tool: Tool) -> None:
    with pytest.raises(ValidationError):
        tool.limits.max_command_v = 10.0


def models_in(annotation: object) -> Iterator[type[BaseModel]]:
    """All models that a value of this type may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
        for each in annotation.model_fields.values():
            yield from models_in(each.annotation)
    for part in typing.get_args(annotation):
        yield from models_in(part)


@pytest.mark.parametrize("model", [Tool, TissueLibrary, GraspProtocol, Settings])
def test_whatever_may_be_unknown_may_be_left_out_because_toml_has_no_null(model: type[BaseModel]) -> None:
    required = [
        (each.__name__, name)
        for each in set(models_in(model))
        for name, field in each.model_fields.items()
        if field.is_required() and type(None) in typing.get_args(field.annotation)
    ]
    assert required == []
