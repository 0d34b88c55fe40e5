"""Whether the journal is as it was written: by its own chain, and by what others know of it.

The chain alone gives away every change but one: its end may be missing. That is seen by who has heard the lines when
they were written: the index, and each recording, which holds those told while it was made.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from app.audit.hash_chain import NEW_LINE, ChainLink, parse_link, sha256_hex
from app.audit.journal_file import find_journals, read_journal_lines
from app.messages.wire import JournalCheck


@dataclass(frozen=True, slots=True)
class ChainCheckpoint:
    """Somebody who heard a line when it was written, and knows it still."""

    source: str
    chain: str
    number: int
    hash: str
    text: str


class _ChainBrokenError(Exception):
    """The first place that is not as it was written."""


@dataclass(slots=True)
class ChainVerifier:
    """Along all lines in order; what it has found so far."""

    last_link: ChainLink | None = None
    hashes: dict[int, str] = field(default_factory=dict)
    unchained_lines: int = 0
    notes: list[str] = field(default_factory=list)
    _unparsed_line: tuple[str, str, bool] | None = None  # a line that is none: where, its hash, whether it has an end

    def verify_file(self, path: Path) -> None:
        """
        Raises:
            _Broken: it is not as it was written.
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
        """Compare a line's place with the one that is due."""
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
        """
        Raises:
            _Broken: its last line is not as it was written.
        """
        if self._unparsed_line and self._unparsed_line[2]:
            raise _ChainBrokenError(_changed_line_text(self._unparsed_line[0]))
        if self._unparsed_line:
            self.notes.append(f"{self._unparsed_line[0]}: the last line was cut off while it was written")


def check_journal(
    data: Path, index_checkpoints: Iterable[ChainCheckpoint], recording_checkpoints: Iterable[ChainCheckpoint] = ()
) -> JournalCheck:
    """Follow the chain of a data folder's journal from its beginning to its end.

    Ask the witnesses before: what is written meanwhile stands in the journal first. Those of the index are of this
    journal; recordings may have been brought here from elsewhere.

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
    """
    Raises:
        _Broken: a line that somebody knows is missing, or is another one.
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
