"""Whether the journal is as it was written: by its own chain, and by what others know of it.

The chain alone gives away every change but one: its end may be missing. That is seen by who has heard the lines when
they were written: the index, and each recording, which holds those told while it was made.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from app.audit.chain import NEW_LINE, Link, digest, link_of
from app.audit.file import journals_in, lines_of
from app.wire import JournalCheck


@dataclass(frozen=True, slots=True)
class Witness:
    """Somebody who heard a line when it was written, and knows it still."""

    who: str
    chain: str
    number: int
    hash: str
    text: str


class _Broken(Exception):
    """The first place that is not as it was written."""


@dataclass(slots=True)
class Walk:
    """Along all lines in order; what it has found so far."""

    last: Link | None = None
    hashes: dict[int, str] = field(default_factory=dict)
    unchained: int = 0
    notes: list[str] = field(default_factory=list)
    _odd: tuple[str, str, bool] | None = None  # a line that is none: where, its hash, whether it has an end

    def file(self, path: Path) -> None:
        """
        Raises:
            _Broken: it is not as it was written.
        """
        before = hashlib.sha256()
        for number, line in enumerate(lines_of(path), 1):
            self._take(line, f"{path.name}, line {number}", before.hexdigest())
            before.update(line)

    def _take(self, line: bytes, place: str, before: str) -> None:
        link = link_of(line)
        if link is None:
            if self._odd:
                raise _Broken(_changed(self._odd[0]))
            if self.last is None:
                self.unchained += 1
            else:
                self._odd = place, digest(line.removesuffix(NEW_LINE)), line.endswith(NEW_LINE)
            return
        self._place(link, place, before)
        self.last, self._odd = link, None
        self.hashes[link.number] = link.hash

    def _place(self, link: Link, place: str, before: str) -> None:
        """Compare a line's place with the one that is due."""
        if self._odd and (link.torn != self._odd[1] or link.begins):
            raise _Broken(_changed(self._odd[0]))
        if link.torn and not self._odd:
            raise _Broken(f"{place}: the cut-off line that stood before this one is gone")
        if link.torn:
            self.notes.append(f"{place}: the line before was cut off while it was written")
        if link.begins:
            if self.last:
                raise _Broken(f"{place}: the chain begins anew here, although it had begun before")
            if link.begins != before:
                raise _Broken(f"{place}: the lines before the chain's beginning were changed")
            return
        due = self.last.number + 1 if self.last else 1
        if self.last is None:
            raise _Broken(f"{place}: the chain's beginning is missing or was changed")
        if link.number > due or link.chain != self.last.chain:
            raise _Broken(f"{place}: lines are missing before it: number {due} is due, and this is {link.number}")
        if link.number < due:
            raise _Broken(f"{place}: it is in the wrong place: number {due} is due, and this is {link.number}")
        if link.after != self.last.hash:
            raise _Broken(f"{place}: the line before was exchanged for another one")

    def end(self) -> None:
        """
        Raises:
            _Broken: its last line is not as it was written.
        """
        if self._odd and self._odd[2]:
            raise _Broken(_changed(self._odd[0]))
        if self._odd:
            self.notes.append(f"{self._odd[0]}: the last line was cut off while it was written")


def check(data: Path, index: Iterable[Witness], recordings: Iterable[Witness] = ()) -> JournalCheck:
    """Follow the chain of a data folder's journal from its beginning to its end.

    Ask the witnesses before: what is written meanwhile stands in the journal first. Those of the index are of this
    journal; recordings may have been brought here from elsewhere.

    Raises:
        JournalError: a file cannot be read.
    """
    walk, problem = Walk(), None
    try:
        for path in journals_in(data):
            walk.file(path)
        walk.end()
        _compare(walk, [*index], [*recordings])
    except _Broken as broken:
        problem = str(broken)
    if walk.unchained and walk.last:
        walk.notes.append(
            f"{walk.unchained} lines of an older version stand before the chain: nothing vouches for them"
        )
    elif not walk.last and not problem:
        walk.notes.append("there is no chain yet: it begins with the next line")
    last = walk.last
    return JournalCheck(
        whole=problem is None,
        problem=problem,
        notes=walk.notes,
        lines=len(walk.hashes),
        unchained=walk.unchained,
        newest=last.number if last else None,
        newest_hash=last.hash if last else None,
        checked_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _compare(walk: Walk, index: list[Witness], recordings: list[Witness]) -> None:
    """
    Raises:
        _Broken: a line that somebody knows is missing, or is another one.
    """
    ours = [each for each in recordings if walk.last and each.chain == walk.last.chain]
    for known in sorted([*index, *ours], key=lambda each: each.number):
        stands = walk.hashes.get(known.number)
        if stands is None:
            raise _Broken(f"line number {known.number} is missing, which {known.who} knows ({known.text!r})")
        if stands != known.hash:
            raise _Broken(f"line number {known.number} is not the one that {known.who} knows ({known.text!r})")
    if others := len(recordings) - len(ours):
        walk.notes.append(
            f"recordings hold {others} lines of another journal: if none was brought here from elsewhere, this journal "
            "was put in the place of that one"
        )


def _changed(place: str) -> str:
    return f"{place}: it was changed, or is no line of the journal"
