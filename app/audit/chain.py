"""The chain of the journal: each line ends with its own hash and names that of the line before.

So nothing in between can be changed, removed or put in without every later line giving it away. The hash is of the
bytes as they stand in the file; nobody has to write a line anew to check it.
"""

import hashlib
import json
from dataclasses import dataclass

from app.wire import JournalEntry

NEW_LINE = b"\n"
_SEAL = b',"hash":"%s"}'
_SEAL_BYTES = len(_SEAL % bytes(64))


@dataclass(frozen=True, slots=True)
class Link:
    """A line's place in a chain; `begins` and `torn` as in `JournalEntry`."""

    chain: str
    number: int
    after: str | None
    begins: str | None
    torn: str | None
    hash: str


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def seal(entry: JournalEntry, chain: str, number: int, after: str | None) -> tuple[bytes, JournalEntry]:
    """The line of an entry at its place, without its end of line, and the entry as it stands there."""
    placed = entry.model_copy(update={"chain": chain, "number": number, "after": after})
    body = placed.line().encode()[:-1]
    own = digest(body)
    return body + _SEAL % own.encode(), placed.model_copy(update={"hash": own})


def link_of(line: bytes) -> Link | None:
    """A line's place; None for what is no line of a chain, or was changed."""
    line = line.removesuffix(NEW_LINE)
    body, own = line[:-_SEAL_BYTES], digest(line[:-_SEAL_BYTES])
    if line[len(body) :] != _SEAL % own.encode():
        return None
    try:
        said = json.loads(body + b"}")
        return Link(said["chain"], said["number"], said.get("after"), said.get("begins"), said.get("torn"), own)
    except (ValueError, LookupError, TypeError, RecursionError):  # somebody has hashed something else
        return None
