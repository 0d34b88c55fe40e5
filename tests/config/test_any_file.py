"""Whatever stands in a configuration file: it is taken, or its faults are told in one message, and soon."""

import copy
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.protocol_player import build_cycle_command
from config.errors import ConfigurationError, RefusedError
from config.load import (
    CONFIG_DIR,
    build_graspable_library,
    list_shipped_names,
    load_grasp_protocol,
    load_library,
    load_settings,
    load_tool,
)
from config.schema import GraspProtocol, TissueLibrary

LOADERS: dict[str, Callable[[str], Any]] = {
    "tools": load_tool,
    "tissues": load_library,
    "protocols": load_grasp_protocol,
    ".": lambda path: load_settings(Path(path)),
}
FILES = [
    (folder, name)
    for folder in LOADERS
    for name in ([*list_shipped_names(folder)] if folder != "." else ["graspwatch"])
]
TOOL = load_tool("simulated")
ANY_FILE = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])

NUMBERS = (
    st.floats()
    | st.integers(-(2**70), 2**70)
    | st.sampled_from([0.0, -0.0, 1e-320, 1e308, -1e308, 1e9, 1e-9, float("nan"), float("inf"), 10**30])
)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)
VALUES = st.recursive(
    NUMBERS | st.booleans() | TEXTS | st.dates() | st.datetimes(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4),
    max_leaves=8,
)


def load(folder: str, path: Path) -> Any:
    """None: it was refused, with a message that names it."""
    try:
        return LOADERS[folder](str(path))
    except ConfigurationError as error:
        assert str(path) in str(error)
        return None


def places(content: dict[str, Any], at: tuple = ()) -> Iterator[tuple]:
    for key, value in content.items():
        yield (*at, key)
        if isinstance(value, dict):
            yield from places(value, (*at, key))


@ANY_FILE
@given(chance=st.data())
def test_any_value_in_any_place_is_taken_or_told(tmp_path: Path, chance: st.DataObject) -> None:
    """What is taken can be used: a motor command is a number, and a library tells its thresholds."""
    folder, name = chance.draw(st.sampled_from(FILES))
    content = copy.deepcopy(tomllib.loads((CONFIG_DIR / folder / f"{name}.toml").read_text()))
    for _ in range(chance.draw(st.integers(1, 3))):
        *outer, last = chance.draw(st.sampled_from(sorted(places(content), key=str)))
        inside = content
        for key in outer:
            inside = inside[key]
        if chance.draw(st.integers(0, 9)) == 0:
            del inside[last]
        else:
            new_key = chance.draw(st.sampled_from([last, last, last, f"{last}_", ""]))
            inside[new_key] = chance.draw(VALUES)
    path = tmp_path / "any.toml"
    path.write_text(tomlkit.dumps(content), encoding="utf-8")
    match load(folder, path):
        case GraspProtocol() as protocol:
            try:
                assert np.isfinite(build_cycle_command(protocol, TOOL)).all()
            except RefusedError as error:
                assert protocol.name in str(error)
        case TissueLibrary() as library:
            assert all(library.threshold_n(tissue) > 0 for tissue in library.tissues)
            assert set(library.tissues) <= set(build_graspable_library(library).tissues)


@ANY_FILE
@given(content=st.binary(max_size=300) | st.text(alphabet="[]{}=\"'.,#\n\\a1-:T_", max_size=80).map(str.encode))
def test_any_bytes_are_taken_or_told(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "any.toml"
    path.write_bytes(content)
    for folder in LOADERS:
        assert load(folder, path) is None or folder == "."  # no setting has to be there


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("a = " + "[" * 9000, "tables within tables"),
        ("a = " + "{a=" * 9000, "tables within tables"),
        ("[" + "a." * 3000 + "a]", "tables within tables"),
        ("a = " + "9" * 5000, "not valid TOML"),
        ("a = 0x" + "f" * 5000, "not valid TOML"),
        ("".join(f"k{number} = 1\n" for number in range(3000)), "more"),
        ("# " + "x" * 2**24, "far too long"),
    ],
    ids=["arrays", "inline tables", "tables", "digits", "hexadecimal digits", "thousands of keys", "length"],
)
@pytest.mark.timeout(20)  # no single fault may take for ever to be described
@pytest.mark.parametrize("folder", LOADERS)
def test_a_file_that_asks_for_too_much_is_told_at_once(tmp_path: Path, folder: str, content: str, says: str) -> None:
    path = tmp_path / "large.toml"
    path.write_text(content)
    with pytest.raises(ConfigurationError, match=says) as caught:
        LOADERS[folder](str(path))
    assert len(str(caught.value)) < 20_000


def test_a_frequency_beyond_all_measure_is_no_motor_command(tmp_path: Path) -> None:
    """A command that is no number would pass every comparison with a limit."""
    path = tmp_path / "fast.toml"
    content = tomllib.loads((CONFIG_DIR / "protocols" / "sine.toml").read_text())
    content["waveform"] |= {"then_hz": 1e308, "then_cycles": 10**308}
    path.write_text(tomlkit.dumps(content))
    with pytest.raises(RefusedError, match="gives no motor command"):
        build_cycle_command(load_grasp_protocol(str(path)), TOOL)
