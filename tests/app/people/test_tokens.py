import codecs
import json
import stat
from pathlib import Path

import pytest

from app.messages.people import Role
from app.people.tokens import TOKEN_FILE, TokenStore, add_token, read_tokens, revoke_token
from config.errors import ConfigurationError


def test_a_token_is_found_by_its_hash_and_stands_nowhere(tmp_path: Path) -> None:
    token = add_token(tmp_path, "Ada", Role.ADMIN)
    people = TokenStore(tmp_path)
    found = people.find_by_token(token)
    assert found
    assert (found.name, found.role) == ("Ada", Role.ADMIN)
    for wrong in ("", token[:-1], token + "x", found.sha256):
        assert people.find_by_token(wrong) is None
    assert stat.S_IMODE((tmp_path / "people.json").stat().st_mode) == 0o600
    assert all(token not in path.read_text() for path in tmp_path.iterdir())


def test_two_tokens_are_never_alike(tmp_path: Path) -> None:
    made = [add_token(tmp_path, f"P{number}", Role.VIEWER) for number in range(20)]
    assert len(set(made)) == 20
    assert all(len(token) > 40 for token in made)


def test_a_revoked_token_is_good_for_nothing_and_its_owner_can_have_another(tmp_path: Path) -> None:
    first = add_token(tmp_path, "Ada", Role.ADMIN)
    people = TokenStore(tmp_path)
    revoke_token(tmp_path, "Ada")
    second = add_token(tmp_path, "Ada", Role.VIEWER)
    assert people.find_by_token(first)  # not looked yet
    assert people.reload_if_changed()
    found = people.find_by_token(second)
    assert people.find_by_token(first) is None
    assert found
    assert found.role is Role.VIEWER
    assert not people.reload_if_changed()


def test_a_token_ends_by_itself(tmp_path: Path) -> None:
    token = add_token(tmp_path, "Ada", Role.ADMIN, expires_days=1.0)
    content = json.loads((tmp_path / "people.json").read_text())
    assert TokenStore(tmp_path).find_by_token(token)
    content["people"][0]["expires_at"] = "2020-01-01T00:00:00Z"
    (tmp_path / "people.json").write_text(json.dumps(content))
    assert TokenStore(tmp_path).find_by_token(token) is None
    assert "expired" in read_tokens(tmp_path)[0].state_text


@pytest.mark.parametrize("name", ["", "  ", " Ada", "A" * 41, "A\nda", "\x1b[31m"])
def test_a_name_that_is_none_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigurationError, match="printable"):
        add_token(tmp_path, name, Role.VIEWER)
    assert not (tmp_path / "people.json").exists()


def test_nobody_has_two_tokens_and_who_has_none_loses_none(tmp_path: Path) -> None:
    add_token(tmp_path, "Ada", Role.VIEWER)
    with pytest.raises(ConfigurationError, match="token revoke"):
        add_token(tmp_path, "ADA", Role.ADMIN)
    with pytest.raises(ConfigurationError, match="Who has one: Ada"):
        revoke_token(tmp_path, "Eve")


@pytest.mark.parametrize(
    ("content", "mode", "says"),
    [
        (None, 0o640, "chmod 600"),
        (None, 0o604, "chmod 600"),
        (None, 0o622, "chmod 600"),
        ("", 0o600, "broken"),
        ('{"people": [{"name": "Eve", "role": "king"}]}', 0o600, "broken"),
        ('{"people": []', 0o600, "broken"),
    ],
)
def test_a_file_that_cannot_be_trusted_stops_the_start_and_lets_nobody_in(
    tmp_path: Path, content: str | None, mode: int, says: str
) -> None:
    token = add_token(tmp_path, "Ada", Role.ADMIN)
    people, path = TokenStore(tmp_path), tmp_path / "people.json"
    path.write_text(path.read_text() if content is None else content)
    path.chmod(mode)
    with pytest.raises(ConfigurationError, match=says) as refused:
        TokenStore(tmp_path)
    assert token not in str(refused.value)
    people.reload_if_changed()
    assert people.requires_token
    assert people.find_by_token(token) is None
    assert says in (people.fault or "")


def test_a_file_that_is_gone_lets_nobody_in_either(tmp_path: Path) -> None:
    token = add_token(tmp_path, "Ada", Role.ADMIN)
    people = TokenStore(tmp_path)
    kept = (tmp_path / "people.json").read_bytes()
    (tmp_path / "people.json").unlink()
    people.reload_if_changed()
    assert (people.requires_token, people.find_by_token(token)) == (True, None)
    (tmp_path / "people.json").write_bytes(kept)
    (tmp_path / "people.json").chmod(0o600)
    people.reload_if_changed()
    assert people.find_by_token(token)
    assert people.fault is None


def test_the_first_token_closes_a_service_that_had_none(tmp_path: Path) -> None:
    people = TokenStore(tmp_path)
    assert not people.requires_token
    add_token(tmp_path, "Ada", Role.ADMIN)
    people.reload_if_changed()
    assert people.requires_token


def test_a_byte_order_mark_is_no_content(tmp_path: Path) -> None:
    add_token(tmp_path, "Ada", Role.VIEWER)
    tokens, path = read_tokens(tmp_path), tmp_path / TOKEN_FILE
    path.write_bytes(codecs.BOM_UTF8 + path.read_bytes())
    assert read_tokens(tmp_path) == tokens
