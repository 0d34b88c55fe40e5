"""Functions for the journal's hash chain: each line ends with its own hash and holds the hash of the line before.

So no line can be changed, removed or inserted without a mismatch in a later line. The hash covers the bytes in the
file, so that a check need not serialize a line again.
"""

import hashlib
import json
from dataclasses import dataclass

from app.messages.journal import JournalEntry

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
    """Return an entry's line at its place in the chain, without newline, and the entry with its chain fields."""
    placed = entry.model_copy(update={"chain": chain, "number": number, "after": after})
    body = placed.to_line().encode()[:-1]
    own = sha256_hex(body)
    return body + _HASH_SUFFIX % own.encode(), placed.model_copy(update={"hash": own})


def parse_link(line: bytes) -> ChainLink | None:
    """Return a line's place in its chain; None if it is not chained or was changed."""
    line = line.removesuffix(NEW_LINE)
    body, own = line[:-_HASH_SUFFIX_BYTES], sha256_hex(line[:-_HASH_SUFFIX_BYTES])
    if line[len(body) :] != _HASH_SUFFIX % own.encode():
        return None
    try:
        said = json.loads(body + b"}")
        return ChainLink(said["chain"], said["number"], said.get("after"), said.get("begins"), said.get("torn"), own)
    except (
        ValueError,
        LookupError,
        TypeError,
        RecursionError,
    ):  # the hash is right, but the content is no journal line
        return None
