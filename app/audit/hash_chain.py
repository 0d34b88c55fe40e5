"""The chain of the journal: each line ends with its own hash and names that of the line before.

So nothing in between can be changed, removed or put in without every later line giving it away. The hash is of the
bytes as they stand in the file; nobody has to write a line anew to check it.
"""

import hashlib
import json
from dataclasses import dataclass

from app.messages.wire import JournalEntry

NEW_LINE = b"\n"
_HASH_SUFFIX = b',"hash":"%s"}'
_HASH_SUFFIX_BYTES = len(_HASH_SUFFIX % bytes(64))


@dataclass(frozen=True, slots=True)
class ChainLink:
    """A line's place in a chain; `begins` and `torn` as in `JournalEntry`."""

    chain: str
    number: int
    after: str | None
    begins: str | None
    torn: str | None
    hash: str


def sha256_hex(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def seal_entry(entry: JournalEntry, chain: str, number: int, after: str | None) -> tuple[bytes, JournalEntry]:
    """The line of an entry at its place, without its end of line, and the entry as it stands there."""
    placed = entry.model_copy(update={"chain": chain, "number": number, "after": after})
    body = placed.to_line().encode()[:-1]
    own = sha256_hex(body)
    return body + _HASH_SUFFIX % own.encode(), placed.model_copy(update={"hash": own})


def parse_link(line: bytes) -> ChainLink | None:
    """A line's place; None for what is no line of a chain, or was changed."""
    line = line.removesuffix(NEW_LINE)
    body, own = line[:-_HASH_SUFFIX_BYTES], sha256_hex(line[:-_HASH_SUFFIX_BYTES])
    if line[len(body) :] != _HASH_SUFFIX % own.encode():
        return None
    try:
        said = json.loads(body + b"}")
        return ChainLink(said["chain"], said["number"], said.get("after"), said.get("begins"), said.get("torn"), own)
    except (ValueError, LookupError, TypeError, RecursionError):  # somebody has hashed something else
        return None
