"""The function behind `graspwatch verify`: whether a recording, its manifest and the journal fit each other."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from acquisition.recordings.mcap_layout import CONDITIONED_TOPIC, MANIFEST_ATTACHMENT, RAW_TOPIC
from acquisition.recordings.mcap_reader import JsonMessage, McapFile, RowBlock
from app.audit.chain_check import ChainCheckpoint, check_journal
from app.audit.journal_file import find_journals, read_journal_lines
from app.messages.journal import JournalEntry
from app.messages.recordings import RunManifest
from app.messages.stored import read_stored
from app.recordings.manifest import sha256_hex
from app.recordings.topics import JOURNAL_TOPIC, decode_message
from config.errors import JournalError, RecordingError


class Outcome(StrEnum):
    """The outcome of one check."""

    RIGHT = "right"
    WRONG = "wrong"
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


def read_complete_file(path: Path) -> bytes | None:
    """Return the bytes of a recording that is complete; None if it is not, or not there."""
    try:
        return path.read_bytes() if McapFile(path).complete else None
    except (OSError, RecordingError):
        return None


def _check_samples(container: McapFile) -> Iterator[Finding]:
    """Read the whole file, whose pieces have check sums, and compare its samples with what its end says."""
    try:
        rows = [each for each in container.iter_content(RAW_TOPIC, CONDITIONED_TOPIC) if isinstance(each, RowBlock)]
    except RecordingError as error:
        yield Finding("file", Outcome.WRONG, str(error))
        return
    if not container.complete:
        why = "it was cut off, or is being written. A service of its data folder makes it whole when it starts."
        yield Finding("file", Outcome.WRONG, why)
    elif container.end_metadata.get("cut_off"):
        yield Finding("file", Outcome.RIGHT, "it had been cut off, and was made whole: its last samples are missing")
    else:
        yield Finding("file", Outcome.RIGHT, "every piece has the check sum that was written with it")
    ticks = np.concatenate([np.zeros(0, np.int64), *(each.columns["tick"] for each in rows if each.topic == RAW_TOPIC)])
    other = np.concatenate([np.zeros(0, np.int64), *(each.columns["tick"] for each in rows if each.topic != RAW_TOPIC)])
    steps = np.diff(ticks)
    gaps = int((steps - 1).sum())
    lost = sum(int(each.columns["lost_samples"].sum()) for each in rows if each.topic == RAW_TOPIC)
    told = container.end_metadata.get("samples")
    if (steps < 1).any():
        yield Finding("samples", Outcome.WRONG, "they are not in the order of time")
    elif not np.array_equal(ticks, other):
        yield Finding("samples", Outcome.WRONG, "raw and conditioned ones are not of the same times")
    elif told is not None and told != str(len(ticks)):
        yield Finding("samples", Outcome.WRONG, f"there are {len(ticks)}, and its end says {told}")
    elif gaps > lost:
        yield Finding("samples", Outcome.WRONG, f"{gaps} are missing, and {lost} are known to be lost")
    else:
        yield Finding("samples", Outcome.RIGHT, f"{len(ticks)}, {lost} lost")


def _check_manifest(container: McapFile) -> Finding:
    content = container.attachments.get(MANIFEST_ATTACHMENT)
    if content is None:
        return Finding("manifest", Outcome.NOT_CHECKED, "it has none: an earlier version recorded it")
    try:
        manifest = read_stored(RunManifest, content)
    except ValueError as error:
        return Finding("manifest", Outcome.WRONG, f"it cannot be read ({error})")
    others = {name: each for name, each in container.attachments.items() if name != MANIFEST_ATTACHMENT}
    changed = {name for name, each in others.items() if manifest.sha256.get(name) != sha256_hex(each)}
    changed |= manifest.sha256.keys() - others.keys()
    if manifest.metadata != container.metadata:
        changed.add("the description of the run")
    if changed:
        return Finding("manifest", Outcome.WRONG, f"not as it was recorded with: {', '.join(sorted(changed))}")
    commit = f", commit {manifest.commit}" if manifest.commit else ""
    made_by = f"graspwatch {manifest.versions.get('graspwatch', '?')}{commit}"
    return Finding("manifest", Outcome.RIGHT, f"{made_by}; tool, library, settings and protocol are those of the run")


def _check_by_journal(container: McapFile, data: Path | None) -> Iterator[Finding]:
    """Compare the file with its SHA-256 in the journal, and the journal with its lines in the file."""
    if data is None or not find_journals(data):
        yield Finding("journal", Outcome.NOT_CHECKED, "there is none. --data names the data folder it was recorded in")
        return
    name, own = container.path.name, sha256_hex(container.path.read_bytes())
    known = [entry.completed for entry in _read_journal(data) if entry.completed and entry.completed.name == name]
    if not known:
        yield Finding("journal", Outcome.NOT_CHECKED, f"no line says that {name} was completed")
    elif known[-1].sha256 == own:
        yield Finding("journal", Outcome.RIGHT, f"the file is the one that was completed (SHA-256 {own})")
    else:
        why = f"the file is not the one that was completed: its SHA-256 is {own}, then it was {known[-1].sha256}"
        yield Finding("journal", Outcome.WRONG, why)
    try:
        found = check_journal(data, (), _read_checkpoints(container))
    except (JournalError, RecordingError) as error:
        yield Finding("journal", Outcome.WRONG, str(error))
        return
    if found.problem:
        yield Finding("journal", Outcome.WRONG, f"it is not as it was written: {found.problem}")
    else:
        yield Finding("journal", Outcome.RIGHT, "it is whole, and holds the lines that the recording holds")


def _read_journal(data: Path) -> Iterator[JournalEntry]:
    for path in find_journals(data):
        for line in read_journal_lines(path):
            try:
                yield read_stored(JournalEntry, line)
            except ValueError:  # the check of the chain tells of it
                continue


def _read_checkpoints(container: McapFile) -> list[ChainCheckpoint]:
    known = []
    for message in container.iter_content(JOURNAL_TOPIC):
        assert isinstance(message, JsonMessage)
        try:
            entry = decode_message(message.topic, message.content)
        except ValueError as error:
            raise RecordingError(f"{container.path}: holds a message that cannot be read ({error}).") from None
        if isinstance(entry, JournalEntry) and entry.chain and entry.number and entry.hash:
            place = entry.chain, entry.number, entry.hash, entry.text
            known.append(ChainCheckpoint(f"the recording {container.path.name}", *place))
    return known
