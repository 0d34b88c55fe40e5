"""Whatever stands in an MCAP file: it is read, or what is wrong with it is told in one message, within bounds."""

import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from bounded import fault_within
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata

from acquisition.recordings.mcap_chunks import decompress_chunk
from acquisition.recordings.mcap_reader import MAGIC, McapFile
from acquisition.recordings.recording import RecordingSource
from app.recordings.file_repair import recover_file
from app.recordings.index_reader import read_file_record, read_recorded_messages
from app.recordings.run_reader import read_run
from config.errors import RecordingError
from config.load import load_tool

RIG = load_tool("smart_tool_2013")
ANY_FILE = settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
Record = tuple[int, bytes]


def played(path: Path) -> None:
    recording = RecordingSource(path, RIG)
    assert recording.duration_s <= 86_400
    while recording.read_block() is not None:
        pass


READERS: tuple[Callable[[Path], object], ...] = (
    read_run,
    played,
    read_file_record,
    recover_file,
    lambda path: list(read_recorded_messages(path)),
)


def read_or_told(path: Path, content: bytes) -> None:
    for reader in READERS:
        path.write_bytes(content)
        try:
            reader(path)
        except RecordingError as error:
            assert path.name in str(error)


def records_in(data: bytes) -> list[Record]:
    found, at = [], 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def joined(records: list[Record]) -> bytes:
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in records)


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def chunk(data: bytes, compression: str = "", packed: bytes | None = None, claimed: int | None = None) -> Record:
    """Without a check sum, as the format allows: whoever makes such a file can make a sum, too."""
    packed = data if packed is None else packed
    size = len(data) if claimed is None else claimed
    head = struct.pack("<QQQI", 0, 0, size, 0) + text(compression) + struct.pack("<Q", len(packed))
    return Opcode.CHUNK, head + packed


@pytest.fixture(scope="module")
def parts(recorded: Path) -> tuple[list[Record], list[Record]]:
    """The file's records with one chunk, and what is in that chunk."""
    outside, inside = [], []
    for opcode, content in records_in(recorded.read_bytes()[len(MAGIC) : -len(MAGIC)]):
        if opcode == Opcode.CHUNK and inside:
            continue
        if opcode == Opcode.CHUNK:
            inside = records_in(decompress_chunk(Chunk.read(ReadDataStream(BytesIO(content)))))
        if opcode != Opcode.MESSAGE_INDEX:
            outside.append((opcode, content))
    return outside, inside


def file_of(outside: list[Record], inside: list[Record], whole: bool = True) -> bytes:
    """With the footer that fits; not `whole`: without an end, as a recorder leaves it that was killed."""
    written, summary_at = [], 0
    for opcode, content in outside:
        at = len(MAGIC) + len(joined(written))
        if opcode == Opcode.CHUNK:
            opcode, content = chunk(joined(inside))
        elif opcode == Opcode.FOOTER and len(content) == 20:
            content = struct.pack("<QQI", summary_at, 0, 0)
        written.append((opcode, content))
        if opcode == Opcode.DATA_END:
            summary_at = at + 9 + len(content)
    return MAGIC + joined(written) + (MAGIC if whole else b"")


SPLINTERS = st.binary(max_size=12) | st.sampled_from(
    [struct.pack("<Q", value) for value in (0, 2**31, 2**40, 2**63, 2**64 - 1)]
    + [b"null", b"[]", b"{}", b'""', b"1e999", b"[" * 5000, b'{"a":' * 5000]
)


def changed(chance: st.DataObject, content: bytes) -> bytes:
    if chance.draw(st.integers(0, 3)) == 0:
        return chance.draw(SPLINTERS)
    begin = chance.draw(st.integers(0, len(content)))
    end = min(begin + chance.draw(st.sampled_from([0, 1, 8, len(content)])), len(content))
    return content[:begin] + chance.draw(SPLINTERS) + content[end:]


@ANY_FILE
@given(chance=st.data())
def test_any_record_may_be_anything(parts, tmp_path: Path, chance: st.DataObject) -> None:
    outside, inside = list(parts[0]), list(parts[1])
    for _ in range(chance.draw(st.integers(1, 3))):
        records = chance.draw(st.sampled_from([outside, inside]))
        rare = [i for i, (opcode, content) in enumerate(records) if opcode != Opcode.MESSAGE or content[22:23] == b"{"]
        place = chance.draw(st.sampled_from(rare) | st.integers(0, len(records) - 1))
        opcode, content = records[place]
        match chance.draw(st.sampled_from(["content", "content", "message", "kind", "remove"])):
            case "content":
                records[place] = opcode, changed(chance, content)
            case "message":
                records[place] = opcode, content[:22] + changed(chance, content[22:])
            case "kind":
                records[place] = chance.draw(st.integers(0, 255)), content
            case "remove" if len(records) > 1:
                del records[place]
    read_or_told(tmp_path / "any.mcap", file_of(outside, inside, chance.draw(st.booleans())))


@ANY_FILE
@given(chance=st.data())
def test_what_it_says_of_itself_may_be_anything(parts, tmp_path: Path, chance: st.DataObject) -> None:
    values = st.text(st.characters(exclude_categories=["Cs"]), max_size=5) | st.sampled_from(
        ["0", "-1", "nan", "inf", "1e999", "²", "9" * 400, "9" * 5000, "18446744073709551616"]
    )
    outside = []
    for opcode, content in parts[0]:
        if opcode == Opcode.METADATA:
            said = Metadata.read(ReadDataStream(BytesIO(content)))
            others = chance.draw(
                st.dictionaries(st.sampled_from(sorted(said.metadata)), st.none() | values, max_size=2)
            )
            pairs = {name: value for name, value in (said.metadata | others).items() if value is not None}
            body = b"".join(text(name) + text(value) for name, value in pairs.items())
            content = text(said.name) + struct.pack("<I", len(body)) + body
        outside.append((opcode, content))
    read_or_told(tmp_path / "any.mcap", file_of(outside, parts[1]))


ZEROS = bytes(400 * 2**20)
UNSIZED = zstandard.ZstdCompressor(write_content_size=False)


@pytest.mark.parametrize(
    ("compression", "pack", "claimed"),
    [
        ("zstd", zstandard.compress, None),
        ("zstd", zstandard.compress, 1000),
        ("zstd", UNSIZED.compress, None),
        ("zstd", UNSIZED.compress, 2**60),
        ("zstd", UNSIZED.compress, 1000),
        ("lz4", lz4.frame.compress, 1000),
        ("lz4", lz4.frame.compress, 0),
        ("bz2", lambda _: b"", 1000),
    ],
)
def test_a_chunk_that_becomes_huge_is_told_before_it_takes_the_memory(
    parts, tmp_path: Path, compression: str, pack: Callable[[bytes], bytes], claimed: int | None
) -> None:
    packed = pack(ZEROS)
    record = chunk(ZEROS, compression, packed, claimed)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + joined([record if each[0] == Opcode.CHUNK else each for each in parts[0]]))
    assert path.stat().st_size < 4_000_000
    for reader in (read_run, played):
        assert "piece 1 of its samples is damaged" in fault_within(150 * 2**20, reader, path)


@pytest.mark.parametrize("length", [2**27, 2**32, 2**63, 2**64 - 1])
@pytest.mark.parametrize("opcode", [Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA])
def test_a_record_that_claims_a_huge_length_is_told_or_is_where_the_file_ends(
    parts, tmp_path: Path, opcode: Opcode, length: int
) -> None:
    path = tmp_path / "claims.mcap"
    path.write_bytes(MAGIC + joined(parts[0][:1]) + struct.pack("<BQ", opcode, length) + b"x" * 100)
    for reader in (read_run, played):
        assert "claims.mcap" in fault_within(400 * 2**20, reader, path)


def test_the_shipped_way_of_packing_is_read_in_any_size(recorded: Path) -> None:
    assert all(
        len(decompress_chunk(each)) == each.uncompressed_size
        for each in McapFile(recorded).iter_records()
        if isinstance(each, Chunk)
    )
