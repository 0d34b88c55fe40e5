"""The function that checks whether the journal is as it was written, by its own chain and checkpoints elsewhere.

The chain alone reveals every change except a missing end. Checkpoints reveal that too: the index holds the lines as
they were written, and each recording holds those written while it was made.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from app.audit.hash_chain import NEW_LINE, ChainLink, parse_link, sha256_hex
from app.audit.journal_file import find_journals, read_journal_lines
from app.messages.journal import JournalCheck, JournalEntry


@dataclass(frozen=True, slots=True)
class ChainCheckpoint:
    """A journal line as the index or a recording (`source`) stored it when it was written."""

    source: str
    chain: str
    number: int
    hash: str
    text: str

    @classmethod
    def from_entry(cls, source: str, entry: JournalEntry) -> "ChainCheckpoint | None":
        """Return the checkpoint of a line that `source` stored; None if the line had no place in a chain."""
        if not (entry.chain and entry.number and entry.hash):
            return None
        return cls(source, entry.chain, entry.number, entry.hash, entry.text)


class _ChainBrokenError(Exception):
    """The first place in the journal that is not as it was written."""


@dataclass(slots=True)
class ChainVerifier:
    """Verifier of all journal lines in order, with its findings so far."""

    last_link: ChainLink | None = None
    hashes: dict[int, str] = field(default_factory=dict)
    unchained_lines: int = 0
    notes: list[str] = field(default_factory=list)
    _unparsed_line: tuple[str, str, bool] | None = None  # place, hash, whether it ends with a newline

    def verify_file(self, path: Path) -> None:
        """Check the lines of the next file.

        Raises:
            _ChainBrokenError: a line is not as it was written.
        """
        before = hashlib.sha256()
        for number, line in enumerate(read_journal_lines(path), 1):
            self._verify_line(line, f"{path.name}, line {number}", before.hexdigest())
            before.update(line)

    def _verify_line(self, line: bytes, place: str, before: str) -> None:
        link = parse_link(line)
        if link is None:
            if self._unparsed_line:
                raise _ChainBrokenError(_changed_line_text(self._unparsed_line[0]))
            if self.last_link is None:
                self.unchained_lines += 1
            else:
                self._unparsed_line = place, sha256_hex(line.removesuffix(NEW_LINE)), line.endswith(NEW_LINE)
            return
        self._verify_link(link, place, before)
        self.last_link, self._unparsed_line = link, None
        self.hashes[link.number] = link.hash

    def _verify_link(self, link: ChainLink, place: str, before: str) -> None:
        """Compare a line's place in the chain with the place that is due."""
        if self._unparsed_line and (link.torn != self._unparsed_line[1] or link.begins):
            raise _ChainBrokenError(_changed_line_text(self._unparsed_line[0]))
        if link.torn and not self._unparsed_line:
            raise _ChainBrokenError(f"{place}: the cut-off line that stood before this one is gone")
        if link.torn:
            self.notes.append(f"{place}: the line before was cut off while it was written")
        if link.begins:
            if self.last_link:
                raise _ChainBrokenError(f"{place}: the chain begins anew here, although it had begun before")
            if link.begins != before:
                raise _ChainBrokenError(f"{place}: the lines before the chain's beginning were changed")
            return
        due = self.last_link.number + 1 if self.last_link else 1
        if self.last_link is None:
            raise _ChainBrokenError(f"{place}: the chain's beginning is missing or was changed")
        if link.number > due or link.chain != self.last_link.chain:
            raise _ChainBrokenError(
                f"{place}: lines are missing before it: number {due} is due, and this is {link.number}"
            )
        if link.number < due:
            raise _ChainBrokenError(
                f"{place}: it is in the wrong place: number {due} is due, and this is {link.number}"
            )
        if link.after != self.last_link.hash:
            raise _ChainBrokenError(f"{place}: the line before was exchanged for another one")

    def finish(self) -> None:
        """Check the end of the last file.

        Raises:
            _ChainBrokenError: its last line is not as it was written.
        """
        if self._unparsed_line and self._unparsed_line[2]:
            raise _ChainBrokenError(_changed_line_text(self._unparsed_line[0]))
        if self._unparsed_line:
            self.notes.append(f"{self._unparsed_line[0]}: the last line was cut off while it was written")


def check_journal(
    data: Path, index_checkpoints: Iterable[ChainCheckpoint], recording_checkpoints: Iterable[ChainCheckpoint] = ()
) -> JournalCheck:
    """Check the whole journal of a data folder, and return the findings.

    Read the checkpoints before this call: a line written later is in the journal before it is in a checkpoint. The
    checkpoints of the index belong to this journal; recordings may come from elsewhere.

    Raises:
        JournalError: a file cannot be read.
    """
    walk, problem = ChainVerifier(), None
    try:
        for path in find_journals(data):
            walk.verify_file(path)
        walk.finish()
        _compare_checkpoints(walk, [*index_checkpoints], [*recording_checkpoints])
    except _ChainBrokenError as broken:
        problem = str(broken)
    if walk.unchained_lines and walk.last_link:
        walk.notes.append(
            f"{walk.unchained_lines} lines of an older version stand before the chain: nothing vouches for them"
        )
    elif not walk.last_link and not problem:
        walk.notes.append("there is no chain yet: it begins with the next line")
    last = walk.last_link
    return JournalCheck(
        whole=problem is None,
        problem=problem,
        notes=walk.notes,
        lines=len(walk.hashes),
        unchained=walk.unchained_lines,
        newest=last.number if last else None,
        newest_hash=last.hash if last else None,
        checked_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _compare_checkpoints(
    verifier: ChainVerifier, index_checkpoints: list[ChainCheckpoint], recording_checkpoints: list[ChainCheckpoint]
) -> None:
    """Compare the journal with the checkpoints.

    Raises:
        _ChainBrokenError: the line of a checkpoint is missing or different.
    """
    ours = [each for each in recording_checkpoints if verifier.last_link and each.chain == verifier.last_link.chain]
    for known in sorted([*index_checkpoints, *ours], key=lambda each: each.number):
        stands = verifier.hashes.get(known.number)
        if stands is None:
            raise _ChainBrokenError(
                f"line number {known.number} is missing, which {known.source} knows ({known.text!r})"
            )
        if stands != known.hash:
            raise _ChainBrokenError(
                f"line number {known.number} is not the one that {known.source} knows ({known.text!r})"
            )
    if others := len(recording_checkpoints) - len(ours):
        verifier.notes.append(
            f"recordings hold {others} lines of another journal: if none was brought here from elsewhere, this journal "
            "was put in the place of that one"
        )


def _changed_line_text(place: str) -> str:
    return f"{place}: it was changed, or is no line of the journal"
