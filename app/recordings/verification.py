"""The function behind `graspwatch verify`: whether a recording, its manifest and the journal fit each other."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from acquisition.recordings.mcap_layout import CONDITIONED_TOPIC, MANIFEST_ATTACHMENT, RAW_TOPIC
from acquisition.recordings.mcap_reader import McapFile, RowBlock
from app.audit.chain_check import ChainCheckpoint, check_journal
from app.audit.hash_chain import parse_link, sha256_hex
from app.audit.journal_file import find_journals, read_journal_lines
from app.messages.journal import JournalEntry
from app.messages.recordings import CompletedFile, RunManifest
from app.messages.stored import read_stored
from app.recordings.index_reader import read_recorded_messages
from app.recordings.manifest import digest_file
from config.errors import JournalError, RecordingError


class Outcome(StrEnum):
    """The outcome of one check."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, slots=True)
class Finding:
    """What one check found. `subject`: the file, its samples, its manifest, or the journal."""

    subject: str
    outcome: Outcome
    text: str


def verify_recording(path: Path, data: Path | None) -> list[Finding]:
    """Check a recording of this program against itself, its manifest, and the journal of the data folder `data`.

    Raises:
        RecordingError: it cannot be read at all.
    """
    container = McapFile(path)
    findings = [*_check_samples(container), _check_manifest(container)]
    return [*findings, *_check_by_journal(container, data)]


def _check_samples(container: McapFile) -> Iterator[Finding]:
    """Read the whole file, whose chunks have checksums, and compare its samples with what its end states."""
    try:
        rows = [each for each in container.iter_content(RAW_TOPIC, CONDITIONED_TOPIC) if isinstance(each, RowBlock)]
    except RecordingError as error:
        yield Finding("file", Outcome.FAILED, str(error))
        return
    if not container.complete:
        why = "it was cut off, or is being written. A service of its data folder makes it whole when it starts."
        yield Finding("file", Outcome.FAILED, why)
    elif container.end_metadata.get("cut_off"):
        yield Finding("file", Outcome.PASSED, "it had been cut off, and was made whole: its last samples are missing")
    else:
        yield Finding("file", Outcome.PASSED, "every chunk matches its checksum")
    ticks, other = _join_ticks(rows, RAW_TOPIC), _join_ticks(rows, CONDITIONED_TOPIC)
    steps = np.diff(ticks)
    absent = int((steps - 1).sum())
    lost = sum(int(each.columns["lost_samples"].sum()) for each in rows if each.topic == RAW_TOPIC)
    end = container.end_metadata
    if (steps < 1).any():
        yield Finding("samples", Outcome.FAILED, "they are not in the order of time")
    elif not np.array_equal(ticks, other):
        yield Finding("samples", Outcome.FAILED, "raw and conditioned samples have different ticks")
    elif end.get("samples", str(len(ticks))) != str(len(ticks)):
        why = f"there are {len(ticks)}, and the end of the file states {end['samples']}"
        yield Finding("samples", Outcome.FAILED, why)
    elif "absent_samples" in end and end["absent_samples"] != str(absent):
        why = f"{absent} are absent between the others, and the end of the file states {end['absent_samples']}"
        yield Finding("samples", Outcome.FAILED, why)
    else:
        unrecorded = f", {absent - lost} more absent" if absent > lost else ""
        yield Finding("samples", Outcome.PASSED, f"{len(ticks)}, {lost} lost{unrecorded}")


def _join_ticks(rows: list[RowBlock], topic: str) -> np.ndarray:
    return np.concatenate([np.zeros(0, np.int64), *(each.columns["tick"] for each in rows if each.topic == topic)])


def _check_manifest(container: McapFile) -> Finding:
    content = container.attachments.get(MANIFEST_ATTACHMENT)
    if content is None:
        return Finding("manifest", Outcome.NOT_CHECKED, "it has none: an earlier version recorded it")
    try:
        manifest = read_stored(RunManifest, content)
    except ValueError as error:
        return Finding("manifest", Outcome.FAILED, f"it cannot be read ({error})")
    others = {name: each for name, each in container.attachments.items() if name != MANIFEST_ATTACHMENT}
    changed = {name for name, each in others.items() if manifest.sha256.get(name) != sha256_hex(each)}
    changed |= manifest.sha256.keys() - others.keys()
    if manifest.metadata != container.metadata:
        changed.add("the description of the run")
    if changed:
        return Finding("manifest", Outcome.FAILED, f"changed since the recording: {', '.join(sorted(changed))}")
    commit = f", commit {manifest.commit}" if manifest.commit else ""
    made_by = f"graspwatch {manifest.versions.get('graspwatch', '?')}{commit}"
    return Finding("manifest", Outcome.PASSED, f"{made_by}; tool, library, settings and protocol are those of the run")


def _check_by_journal(container: McapFile, data: Path | None) -> Iterator[Finding]:
    """Compare the file with its SHA-256 in the journal, and the journal with its lines in the file."""
    if data is None or not find_journals(data):
        yield Finding("journal", Outcome.NOT_CHECKED, "there is none. --data names the data folder it was recorded in")
        return
    try:
        yield _check_digest(container, data)
        yield _check_chain(container, data)
    except (JournalError, RecordingError) as error:
        yield Finding("journal", Outcome.FAILED, str(error))


def _check_digest(container: McapFile, data: Path) -> Finding:
    name, own = container.path.name, digest_file(container.path)
    known = list(dict.fromkeys(each.sha256 for each in _read_completed(data) if each.name == name))
    if not known:
        return Finding("journal", Outcome.NOT_CHECKED, f"no line says that {name} was completed")
    if known == [own]:
        return Finding("journal", Outcome.PASSED, f"the file is the one that was completed (SHA-256 {own})")
    why = f"the file is not the one that was completed: its SHA-256 is {own}, the journal has {', '.join(known)}"
    return Finding("journal", Outcome.FAILED, why)


def _check_chain(container: McapFile, data: Path) -> Finding:
    lines = _read_checkpoints(container.path)
    found = check_journal(data, (), lines)
    if found.problem:
        return Finding("journal", Outcome.FAILED, f"it is not as it was written: {found.problem}")
    chain = _read_chain_id(data)
    others = [each for each in lines if each.chain != chain]
    if others:
        why = f"{len(others)} of the {len(lines)} journal lines in the recording are of another journal"
        return Finding("journal", Outcome.NOT_CHECKED, why)
    held = f", and holds the {len(lines)} lines that the recording holds" if lines else ""
    return Finding("journal", Outcome.PASSED, f"it is whole{held}")


def _read_chain_id(data: Path) -> str | None:
    """Return the id of the newest chain in the journal of a data folder; None if it has none.

    Raises:
        JournalError: a file cannot be read.
    """
    links = (parse_link(line) for path in reversed(find_journals(data)) for line in read_journal_lines(path))
    return next((link.chain for link in links if link), None)


def _read_completed(data: Path) -> Iterator[CompletedFile]:
    """Yield what the journal says of completed recordings.

    Raises:
        JournalError: a file cannot be read.
    """
    for path in find_journals(data):
        for line in read_journal_lines(path):
            if b'"completed"' not in line:
                continue
            with contextlib.suppress(ValueError):  # the check of the chain reports such a line
                entry = read_stored(JournalEntry, line)
                if entry.completed:
                    yield entry.completed


def _read_checkpoints(path: Path) -> list[ChainCheckpoint]:
    """Return the journal lines that a recording holds.

    Raises:
        RecordingError: the file is damaged.
    """
    messages = (message for _, message in read_recorded_messages(path))
    source = f"the recording {path.name}"
    found = (ChainCheckpoint.from_entry(source, each) for each in messages if isinstance(each, JournalEntry))
    return [each for each in found if each]
