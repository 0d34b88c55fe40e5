"""The table of signals: how a tool's further inputs are found, and what a mistake in it says."""

import pytest

from acquisition import signal_table
from acquisition.signal_table import SIGNALS, Signal, Source, find_wired_inputs, list_numbered_names
from config.errors import ConfigurationError
from config.schema import Channels, OtherInput

SPARE = Signal("spare_v", "V", "f8", Source.INPUT, "For these tests", optional=True)
WIRED = Channels(other=(OtherInput(signal="spare_v", input="ai7"),))


def test_a_further_input_comes_from_the_tool_file_and_only_if_it_is_wired(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signal_table, "SIGNALS", (*SIGNALS, SPARE))
    plain = {"strain_v": "ai0", "motor_command_v": "ai2", "touch_1_v": "ai3", "touch_2_v": "ai1"}
    assert find_wired_inputs(Channels()) == plain
    assert find_wired_inputs(WIRED) == plain | {"spare_v": "ai7"}


@pytest.mark.parametrize("name", ["spare_v", "strain_v", "jaw_force_n"])
def test_a_name_that_is_no_further_input_is_refused_by_its_name(name: str) -> None:
    with pytest.raises(ConfigurationError, match=f"channels.other: {name} is no further analog input"):
        find_wired_inputs(Channels(other=(OtherInput(signal=name, input="ai7"),)))


def test_a_tool_file_without_further_inputs_is_kept_as_it_was_and_every_tool_can_be_the_key_of_a_cache() -> None:
    assert "other" not in Channels().model_dump_json()
    assert Channels.model_validate_json(WIRED.model_dump_json()) == WIRED
    assert hash(WIRED) != hash(Channels())


def test_a_number_that_is_missing_or_given_twice_is_told() -> None:
    assert list_numbered_names("frame", [(2, "b"), (None, "c"), (1, "a")]) == ["a", "b"]
    for numbers in ([(1, "a"), (3, "b")], [(1, "a"), (1, "b")]):
        with pytest.raises(RuntimeError, match="frame: the numbers"):
            list_numbered_names("frame", numbers)
