"""Functions for tokens of people, and TokenStore: `people.json` holds names, roles and hashes, never a token.

A token is 32 random bytes, so one round of SHA-256 is as good as a slow hash: a token cannot be guessed.
"""

import codecs
import contextlib
import fcntl
import hmac
import os
import secrets
import stat
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError, field_validator

from app.messages.people import Role
from config.atomic_write import write_atomically
from config.errors import ConfigurationError, build_write_error

TOKEN_FILE = "people.json"
TOKEN_PREFIX = "gw_"  # lets secret scanners find tokens in wrong places
TOKEN_BYTES = 32
MAX_NAME_LENGTH = 40


class TokenEntry(BaseModel):
    """A token that was given to a person. Times are UTC; `state_text` shows the local day."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    role: Role
    sha256: str
    created_at: datetime
    expires_at: datetime | None = None
    revoked_at: datetime | None = None

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        if not name.strip() or name != name.strip() or len(name) > MAX_NAME_LENGTH or not name.isprintable():
            raise ValueError(f"a name has 1 to {MAX_NAME_LENGTH} printable characters, and no space before or after")
        return name

    @property
    def is_valid(self) -> bool:
        """Whether the token is neither revoked nor expired."""
        return self.revoked_at is None and (self.expires_at is None or datetime.now(UTC) < self.expires_at)

    @property
    def state_text(self) -> str:
        if self.revoked_at:
            return f"revoked {self.revoked_at.astimezone():%Y-%m-%d}"
        if self.expires_at is None:
            return "good"
        return f"{'good until' if self.is_valid else 'expired'} {self.expires_at.astimezone():%Y-%m-%d}"


class _TokenFileContent(BaseModel):
    model_config = ConfigDict(extra="forbid")

    people: list[TokenEntry]


def hash_secret(token: str) -> str:
    return sha256(token.encode()).hexdigest()


def read_tokens(data: Path) -> list[TokenEntry]:
    """Read the entries of all tokens, revoked and expired ones included; empty if the file is missing.

    Raises:
        ConfigurationError: other users may access the file, or it cannot be read.
    """
    path = data / TOKEN_FILE
    try:
        with path.open("rb") as file:
            mode, content = stat.S_IMODE(os.fstat(file.fileno()).st_mode), file.read()
    except FileNotFoundError:
        return []
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}). Mend its owner and mode.") from None
    if mode & 0o077:
        raise ConfigurationError(f"{path}: others may read or change it. Run `chmod 600 {path}`.")
    try:
        return _TokenFileContent.model_validate_json(content.removeprefix(codecs.BOM_UTF8)).people
    except ValidationError as error:
        where = ".".join(str(part) for part in error.errors()[0]["loc"]) or "the whole file"
        raise ConfigurationError(
            f"{path}: is broken ({where}: {error.errors()[0]['msg']}). Put a good copy in its place, or delete it "
            "and give everybody a new token with `graspwatch token add`."
        ) from None


def add_token(data: Path, name: str, role: Role, expires_days: float | None = None) -> str:
    """Make a token for a person and return it; the file keeps only its hash.

    Raises:
        ConfigurationError: the name is invalid or has a valid token, or the file cannot be read or written.
    """
    now = datetime.now(UTC)
    token = TOKEN_PREFIX + secrets.token_urlsafe(TOKEN_BYTES)
    expires = now + timedelta(days=expires_days) if expires_days else None
    try:
        entry = TokenEntry(name=name, role=role, sha256=hash_secret(token), created_at=now, expires_at=expires)
    except ValidationError as error:
        raise ConfigurationError(f"{name!r}: {error.errors()[0]['msg'].removeprefix('Value error, ')}.") from None
    with _edit_tokens(data) as people:
        if any(other.is_valid and other.name.casefold() == name.casefold() for other in people):
            raise ConfigurationError(f"{name} has a token. Take it back first: `graspwatch token revoke {name!r}`.")
        people.append(entry)
    return token


def revoke_token(data: Path, name: str) -> None:
    """Revoke a person's tokens; a running service notices within a second.

    Raises:
        ConfigurationError: the person has none, or the file cannot be read or written.
    """
    with _edit_tokens(data) as people:
        held = [at for at, entry in enumerate(people) if entry.name == name and entry.revoked_at is None]
        if not held:
            has = ", ".join(sorted({entry.name for entry in people if entry.revoked_at is None})) or "nobody"
            raise ConfigurationError(f"{name!r} has no token to take back. Who has one: {has}.")
        for at in held:
            people[at] = people[at].model_copy(update={"revoked_at": datetime.now(UTC)})


@contextlib.contextmanager
def _edit_tokens(data: Path) -> Iterator[list[TokenEntry]]:
    """Lock the file, yield its entries, and write them back unless an error was raised."""
    folder = os.open(data, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        people = read_tokens(data)
        yield people
        write_atomically(
            data / TOKEN_FILE, _TokenFileContent(people=people).model_dump_json(indent=2) + "\n", private=True
        )
    except OSError as error:
        text = f"{data / TOKEN_FILE}: cannot be written ({error.strerror}). Make room or mend it."
        raise build_write_error(text, error) from None
    finally:
        os.close(folder)  # releases the lock


class TokenStore:
    """The tokens that a service accepts: none if the file is broken, or missing after it existed."""

    def __init__(self, data: Path) -> None:
        """Raise ConfigurationError if other users may access the file, or it cannot be read."""
        self._data = data
        self.entries = read_tokens(data)
        self.fault: str | None = None
        """Why the file can no longer be read; None if it can."""
        self.requires_token = (data / TOKEN_FILE).exists()
        """Whether requests need a token; once True, it stays True until the service ends."""
        self._known_file_stamp = self._read_file_stamp()

    def reload_if_changed(self) -> bool:
        """Reload a changed file, or one that could not be read; return whether entries or fault changed."""
        mark = self._read_file_stamp()
        if mark == self._known_file_stamp and not self.fault:
            return False
        before = self.entries, self.fault
        self._known_file_stamp = mark
        self.requires_token |= mark is not None
        try:
            self.entries, self.fault = read_tokens(self._data), None
            if mark is None:
                self.fault = (
                    f"{self._data / TOKEN_FILE} is gone: nobody is let in. Put it back, or start the service again."
                )
        except ConfigurationError as error:
            self.entries, self.fault = [], f"Nobody is let in. {error}"
        return before != (self.entries, self.fault)

    def find_by_token(self, token: str) -> TokenEntry | None:
        """Return the entry of a valid token. All entries are compared, so that the time reveals nothing."""
        asked, found = hash_secret(token), None
        for entry in self.entries:
            if hmac.compare_digest(entry.sha256, asked) and entry.is_valid:
                found = entry
        return found

    def find_by_hash(self, token_hash: str) -> TokenEntry | None:
        """Return the entry with this token hash if it is still valid."""
        return next((entry for entry in self.entries if entry.sha256 == token_hash and entry.is_valid), None)

    def _read_file_stamp(self) -> tuple[int, int, int, int] | None:
        try:
            found = (self._data / TOKEN_FILE).stat()
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns, found.st_ctime_ns, found.st_size
