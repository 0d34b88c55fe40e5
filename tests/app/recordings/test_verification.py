"""`graspwatch verify`: a recording as it was made, and any change of it."""

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.recordings.mcap_layout import MANIFEST_ATTACHMENT, TOOL_ATTACHMENT
from acquisition.recordings.mcap_reader import McapFile
from app.audit.journal import Journal
from app.messages.journal import JournalKind
from app.messages.recordings import CompletedFile, RunManifest
from app.messages.stored import read_stored
from app.recordings.verification import Finding, Outcome, verify_recording
from config.errors import RecordingError


@pytest.fixture(scope="module")
def kept(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in a data folder whose journal knows it."""
    data = tmp_path_factory.mktemp("kept")
    (data / "recordings").mkdir()
    path = data / "recordings/a.mcap"
    content = recorded.read_bytes()
    path.write_bytes(content)
    completed = CompletedFile(name=path.name, sha256=hashlib.sha256(content).hexdigest())
    journal = Journal(data, lambda fault: None, lambda entry: None)
    journal.write(JournalKind.EVENT, "before")
    journal.write(JournalKind.EVENT, "complete", completed=completed)
    return path


def wrong(findings: list[Finding]) -> list[str]:
    return [each.subject for each in findings if each.outcome is Outcome.FAILED]


def test_a_recording_as_it_was_made_is_right_in_all_that_is_known(kept: Path) -> None:
    findings = verify_recording(kept, kept.parents[1])
    assert [(each.subject, each.outcome) for each in findings] == [
        (subject, Outcome.PASSED) for subject in ("file", "samples", "manifest", "journal", "journal")
    ]
    alone = verify_recording(kept, None)
    assert (wrong(alone), alone[-1].outcome) == ([], Outcome.NOT_CHECKED)


def test_the_manifest_says_what_it_was_recorded_with(kept: Path) -> None:
    container = McapFile(kept)
    manifest = read_stored(RunManifest, container.attachments[MANIFEST_ATTACHMENT])
    assert manifest.metadata == container.metadata
    assert manifest.sha256[TOOL_ATTACHMENT] == hashlib.sha256(container.attachments[TOOL_ATTACHMENT]).hexdigest()
    assert manifest.sha256.keys() == container.attachments.keys() - {MANIFEST_ATTACHMENT}
    assert manifest.versions["graspwatch"]


@given(place=st.floats(0.0, 1.0, exclude_max=True), other=st.integers(1, 255))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_byte_can_be_changed_unnoticed(kept: Path, tmp_path: Path, place: float, other: int) -> None:
    content = bytearray(kept.read_bytes())
    content[int(place * len(content))] ^= other
    path = tmp_path / kept.name
    path.write_bytes(content)
    try:
        findings = verify_recording(path, kept.parents[1])
    except RecordingError:
        return
    assert "journal" in wrong(findings)


@pytest.mark.parametrize(
    ("damage", "subject"),
    [
        (lambda content: content[: len(content) * 3 // 4], "file"),
        (lambda content: content.replace(b'"Dev1"', b'"Dev2"', 1), "manifest"),
    ],
    ids=["cut off", "another tool"],
)
def test_a_change_is_told_by_what_it_concerns(
    kept: Path, tmp_path: Path, damage: Callable[[bytes], bytes], subject: str
) -> None:
    content = kept.read_bytes()
    path = tmp_path / kept.name
    path.write_bytes(damage(content))
    assert path.read_bytes() != content
    assert subject in wrong(verify_recording(path, None))


def test_a_changed_journal_is_told(kept: Path, tmp_path: Path) -> None:
    journal = kept.parents[1] / "journal.jsonl"
    (tmp_path / "journal.jsonl").write_bytes(journal.read_bytes().replace(b'"before"', b'"after!"'))
    findings = verify_recording(kept, tmp_path)
    assert wrong(findings) == ["journal"]
    assert "not as it was written" in findings[-1].text


def test_a_later_line_about_the_same_file_does_not_make_another_file_right(kept: Path, tmp_path: Path) -> None:
    (tmp_path / "journal.jsonl").write_bytes((kept.parents[1] / "journal.jsonl").read_bytes())
    forged = CompletedFile(name=kept.name, sha256="0" * 64)
    Journal(tmp_path, lambda fault: None, lambda entry: None).write(JournalKind.EVENT, "complete", completed=forged)
    assert wrong(verify_recording(kept, tmp_path)) == ["journal"]
