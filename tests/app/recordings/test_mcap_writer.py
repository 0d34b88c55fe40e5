"""A run's file: read by the plain mcap package, cut off, damaged, foreign, and from the future."""

import errno
import json
import os
import shutil
import threading
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from old_files import without_limit

from acquisition.recordings import mcap_layout
from acquisition.recordings.mcap_reader import McapFile
from acquisition.recordings.recording import RecordingSource
from app.recordings.file_repair import recover_file, recover_folder
from app.recordings.mcap_writer import McapRunWriter, RecordingContext
from app.recordings.run_reader import read_run
from app.recordings.topics import TOPIC_MODELS
from config.errors import RecordingError
from config.load import load_library, load_settings, load_tool

RIG = load_tool("smart_tool_2013")
ANY_BYTE = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def test_the_plain_mcap_package_reads_every_sample_with_its_schema(recorded: Path) -> None:
    run = read_run(recorded)
    with recorded.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        counts = {channel.topic: 0 for channel in reader.get_summary().channels.values()}
        wanted = {"/raw": "strain_v", "/conditioned": "jaw_force_n", "/estimates": "threshold_n"}
        values: dict[str, list[float]] = {topic: [] for topic in wanted}
        log_ns = []
        for schema, channel, message, decoded in reader.iter_decoded_messages(topics=list(wanted)):
            counts[channel.topic] += 1
            assert schema.encoding == "protobuf"
            values[channel.topic].append(getattr(decoded, wanted[channel.topic]))
            if channel.topic == "/raw":
                log_ns.append(message.log_time)
    assert counts["/raw"] == counts["/conditioned"] == counts["/estimates"] == len(run.samples)
    np.testing.assert_array_equal(values["/raw"], run.samples["strain_v"])
    np.testing.assert_array_equal(values["/conditioned"], run.samples["jaw_force_n"])
    np.testing.assert_array_equal(values["/estimates"], run.estimates["threshold_n"])
    assert set(np.diff(log_ns)) == {1_000_000}


def test_it_says_the_limit_that_was_enforced_and_so_does_a_replay(recorded: Path) -> None:
    run = read_run(recorded)
    assert run.samples["limit_n"].min() == pytest.approx(1.80, abs=0.005)
    with RecordingSource(recorded, RIG) as replayed:
        blocks = list(iter(replayed.read_block, None))
    np.testing.assert_array_equal(np.concatenate([block.limit_n for block in blocks]), run.samples["limit_n"])
    assert all(0.5 < grasp.peak_share_of_limit < 1.02 for grasp in run.grasps)


def test_a_file_of_the_time_before_opens_and_says_no_limit(recorded: Path, tmp_path: Path) -> None:
    old = without_limit(recorded, tmp_path / "old.mcap")
    run, now = read_run(old), read_run(recorded)
    assert np.isnan(run.samples["limit_n"]).all()
    for name in set(run.samples.dtype.names) - {"limit_n"}:
        np.testing.assert_array_equal(run.samples[name], now.samples[name])
    with RecordingSource(old, RIG) as replayed:
        assert all(np.isnan(block.limit_n).all() for block in iter(replayed.read_block, None))


def test_its_messages_fit_schemas_without_references_and_alternatives(recorded: Path) -> None:
    seen = set()
    with recorded.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(topics=list(TOPIC_MODELS)):
            rules = json.loads(schema.data)
            jsonschema.Draft202012Validator.check_schema(rules)
            jsonschema.validate(json.loads(message.data), rules)
            assert not {"$ref", "anyOf", "oneOf"} & set(json.dumps(rules).replace('"', " ").split())
            seen.add(channel.topic)
    assert {"/run", "/grasp", "/identification", "/alarm"} <= seen


def test_it_says_how_it_came_to_be(recorded: Path) -> None:
    container = McapFile(recorded)
    kept = {"tool.json", "library.json", "settings.json", "protocol.json", "versions", "manifest.json"}
    assert set(container.attachments) == kept
    assert container.metadata["protocol"] == "strong_2hz"
    assert container.metadata["tissue"] == "liver"
    assert container.complete
    run = read_run(recorded)
    assert [grasp.index for grasp in run.grasps] == [1, 2]
    assert run.run.state == "finished"
    assert any(grasp.held_back for grasp in run.grasps)


@ANY_BYTE
@given(share=st.floats(0, 1))
def test_cut_off_anywhere_it_is_read_up_to_its_last_whole_piece_or_refused(
    recorded: Path, tmp_path: Path, share: float
) -> None:
    content = recorded.read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[: int(share * len(content))])
    whole = read_run(recorded).samples
    try:
        samples = read_run(path).samples
    except RecordingError as error:
        assert str(path) in str(error)
        assert share < 0.5
    else:
        assert samples.tobytes() == whole[: len(samples)].tobytes()
        assert len(samples) >= (share * len(content) - 300_000) / len(content) * len(whole)


@ANY_BYTE
@given(at=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_damaged_file_is_never_believed(recorded: Path, tmp_path: Path, at: float, bit: int) -> None:
    """Beyond the names of what is in it, which no sum protects, a flipped bit is found or does no harm."""
    content = bytearray(recorded.read_bytes())
    content[int(at * len(content))] ^= 1 << bit
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    whole = read_run(recorded).samples
    try:
        samples = read_run(path).samples
    except RecordingError as error:
        assert str(path) in str(error)
    else:
        assert samples.tobytes() == whole[: len(samples)].tobytes()


def test_what_was_cut_off_is_made_whole_once(recorded: Path, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(recorded.read_bytes()[:-200_000])
    before = read_run(path)
    assert [mended.name for mended in recover_folder(tmp_path)] == ["cut.mcap"]
    after = read_run(path)
    assert after.samples.tobytes() == before.samples.tobytes()
    assert after.estimates.tobytes() == before.estimates.tobytes()
    assert after.grasps == before.grasps
    container = McapFile(path)
    assert container.complete
    assert container.end_metadata["cut_off"] == "true"
    assert not recover_file(path)
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_made_whole_stays_as_it_is(recorded: Path, tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    path.write_bytes(b"no recording at all")
    assert list(recover_folder(tmp_path)) == []
    assert path.read_bytes() == b"no recording at all"


def written(path: Path, profile: str, about: dict[str, str] | None = None) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile)
        if about is not None:
            writer.add_metadata(mcap_layout.METADATA_NAME, about)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("profile", "about", "says"),
    [
        ("ros2", None, "no recording of Graspwatch (its profile is 'ros2')"),
        ("", None, "it names no profile"),
        ("graspwatch", {}, "no description"),
        ("graspwatch", {"format_version": "2", "graspwatch": "9.1"}, "later Graspwatch (9.1, format 2"),
        ("graspwatch", {"format_version": "1"}, "tool it was recorded with cannot be read"),
    ],
)
def test_a_foreign_or_later_file_is_refused_with_its_reason(
    tmp_path: Path, profile: str, about: dict[str, str] | None, says: str
) -> None:
    path = written(tmp_path / "other.mcap", profile, about)
    with pytest.raises(RecordingError) as caught:
        RecordingSource(path, RIG)
    assert str(path) in str(caught.value)
    assert says in str(caught.value)


@pytest.mark.parametrize(("content", "says"), [(b"", "is empty"), (b"LabVIEW Measurement", "no MCAP file")])
def test_what_is_no_mcap_file_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=says):
        RecordingSource(path, RIG)


def test_a_recording_named_otherwise_is_known_by_its_content(recorded: Path, tmp_path: Path) -> None:
    path = tmp_path / "renamed.lvm"
    shutil.copyfile(recorded, path)
    assert RecordingSource(path, RIG).tool.name == "simulated"


@pytest.fixture
def run_file(tmp_path: Path) -> McapRunWriter:
    rig = RecordingContext(load_tool("simulated"), load_library("porcine"), load_settings())
    return McapRunWriter(tmp_path / "a.mcap", rig, {"run_id": "a"}, {}, 0)


def test_a_disk_that_takes_its_time_holds_nobody_up(run_file: McapRunWriter, monkeypatch: pytest.MonkeyPatch) -> None:
    goes_on, asked = threading.Event(), []
    monkeypatch.setattr(os, "fdatasync", lambda fd: asked.append(fd) or goes_on.wait(30))
    while not asked:
        run_file.flush()
    run_file.flush()  # would wait for 30 s
    assert len(asked) == 1
    goes_on.set()
    run_file.close()
    assert McapFile(run_file.path).complete


def test_what_the_disk_refuses_later_is_told_by_a_later_flush(
    run_file: McapRunWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(fd: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(os, "fdatasync", refuse)
    with pytest.raises(OSError, match="Input/output error"):
        while True:
            run_file.flush()
    with pytest.raises(OSError, match="Input/output error"):
        run_file.close()
