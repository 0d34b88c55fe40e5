"""The name of the computer's user."""

import os

import pytest

from app.host.computer_user import computer_user_name


def test_a_user_without_a_name_has_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container that runs with a number only."""
    for variable in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 54321)
    assert computer_user_name() == "user 54321"
