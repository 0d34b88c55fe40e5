from pathlib import Path

import pytest
from starlette.requests import Request

from app.roles import Admin, Role
from config.errors import ConfigurationError

TOKEN = "0123456789abcdef0123"


def asked_by(address: str, **headers: str) -> Request:
    named = {"host": "localhost:8000", **headers}
    raw = [(name.replace("_", "-").encode(), value.encode()) for name, value in named.items()]
    scope = {
        "type": "http",
        "client": (address, 5000),
        "headers": raw,
        "path": "/",
        "scheme": "http",
        "query_string": b"",
    }
    return Request(scope)


@pytest.mark.parametrize(
    ("only_this_machine", "request_", "role"),
    [
        (True, asked_by("127.0.0.1"), Role.ADMIN),
        (True, asked_by("::1", host="[::1]:8000"), Role.ADMIN),
        (True, asked_by("127.0.0.1", host="127.0.0.1"), Role.ADMIN),
        (False, asked_by("127.0.0.1"), Role.OPERATOR),
        (True, asked_by("192.0.2.7"), Role.OPERATOR),
        (True, asked_by("127.0.0.1", host="rebound.example"), Role.OPERATOR),
        (True, asked_by("127.0.0.1", x_forwarded_for="127.0.0.1"), Role.OPERATOR),
        (True, asked_by("127.0.0.1", forwarded="for=127.0.0.1"), Role.OPERATOR),
    ],
)
def test_without_a_token_an_admin_is_who_sits_at_the_machine(
    only_this_machine: bool, request_: Request, role: Role
) -> None:
    admin = Admin(None)
    admin.only_this_machine = only_this_machine
    assert admin.role(request_) is role
    assert "admin_token_file" in admin.how


def test_with_a_token_an_admin_is_who_knows_it_wherever_he_is(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text(f"{TOKEN}\n")
    path.chmod(0o600)
    admin = Admin(str(path))
    admin.only_this_machine = True
    assert admin.role(asked_by("192.0.2.7", authorization=f"Bearer {TOKEN}")) is Role.ADMIN
    assert admin.role(asked_by("192.0.2.7", authorization=f"bearer {TOKEN}")) is Role.ADMIN
    for word in ("", "Bearer", "Bearer x", f"Basic {TOKEN}", TOKEN, f"Bearer {TOKEN}x"):
        assert admin.role(asked_by("127.0.0.1", authorization=word)) is Role.OPERATOR
    assert admin.role(asked_by("127.0.0.1")) is Role.OPERATOR


@pytest.mark.parametrize(
    ("content", "mode", "says"),
    [
        (TOKEN, 0o640, "chmod 600"),
        (TOKEN, 0o604, "chmod 600"),
        ("short", 0o600, "openssl rand"),
        ("", 0o600, "shorter"),
    ],
)
def test_a_token_that_is_none_is_refused(tmp_path: Path, content: str, mode: int, says: str) -> None:
    path = tmp_path / "token"
    path.write_text(content)
    path.chmod(mode)
    with pytest.raises(ConfigurationError, match=says) as refused:
        Admin(str(path))
    assert TOKEN not in str(refused.value)


def test_a_token_file_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="Check the path"):
        Admin(str(tmp_path / "nowhere"))
