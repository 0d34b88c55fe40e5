"""Who may do what. Today one role is told apart: `admin`, who may delete."""

import hmac
import ipaddress
import stat
from enum import StrEnum
from pathlib import Path

from fastapi import Request

from config.errors import ConfigurationError

SHORTEST = 16  # characters of a token: a shorter one can be guessed
FORWARDED = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip", "via")
HOW_BY_TOKEN = "Only an admin may do this: send `Authorization: Bearer` with the token of server.admin_token_file."
HOW_HERE = (
    "Only an admin may do this. Set server.admin_token_file and send its token as `Authorization: Bearer`; or do it on "
    "the machine itself, with a service that listens on 127.0.0.1 alone."
)


class Role(StrEnum):
    VIEWER = "viewer"
    OPERATOR = "operator"
    ADMIN = "admin"


class Admin:
    """Tells an admin: by the token of a file or, without one, by being a program on this machine."""

    def __init__(self, token_file: str | None) -> None:
        """Raises ConfigurationError: the file cannot be read, can be read by others, or its token is too short."""
        self._token = _read_token(Path(token_file)) if token_file else None
        self.only_this_machine = False
        """Whether the service listens on the loopback address alone."""

    @property
    def how(self) -> str:
        """What somebody who is none has to do."""
        return HOW_BY_TOKEN if self._token else HOW_HERE

    def role(self, request: Request) -> Role:
        """Of whoever sends a request."""
        if self._token:
            scheme, _, token = request.headers.get("authorization", "").partition(" ")
            known = hmac.compare_digest(token.strip().encode(), self._token.encode())
            return Role.ADMIN if known and scheme.lower() == "bearer" else Role.OPERATOR
        return Role.ADMIN if self.only_this_machine and _comes_from_here(request) else Role.OPERATOR


def _comes_from_here(request: Request) -> bool:
    """By its address; not through a proxy, and not from a page that only gave itself the name of this machine."""
    if any(header in request.headers for header in FORWARDED):
        return False
    return request.client is not None and is_loopback(request.client.host) and is_loopback(request.url.hostname or "")


def is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _read_token(path: Path) -> str:
    try:
        mode, token = path.stat().st_mode, path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"server.admin_token_file: {path} cannot be read ({error}). Check the path.") from None
    if stat.S_IMODE(mode) & 0o077:
        raise ConfigurationError(f"server.admin_token_file: others may read {path}. Run `chmod 600 {path}`.")
    if len(token) < SHORTEST:
        raise ConfigurationError(
            f"server.admin_token_file: the token in {path} is shorter than {SHORTEST} characters. Make one with "
            f"`openssl rand -hex 32 > {path}`."
        )
    return token
