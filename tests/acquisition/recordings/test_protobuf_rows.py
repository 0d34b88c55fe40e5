"""Rows of a recording are protobuf messages that any reader understands, and come back bit for bit."""

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.recordings.protobuf_rows import ColumnSpec, RowLayout

NAMES = st.lists(st.from_regex(r"[a-z][a-z0-9_]{0,6}[a-z0-9]", fullmatch=True), min_size=1, max_size=40, unique=True)


@st.composite
def layouts(draw: st.DrawFn) -> RowLayout:
    """Plain columns, then groups of columns."""
    names = draw(NAMES)
    plain = draw(st.integers(1, len(names)))
    columns = [ColumnSpec(name, draw(st.sampled_from(["f8", "i8", "u4"]))) for name in names[:plain]]
    inside = draw(st.lists(st.sampled_from(["alpha", "beta", "force"]), min_size=1, unique=True))
    columns += [ColumnSpec(name, group=group) for group in names[plain:] for name in inside]
    return RowLayout("Things", columns)


def filled(layout: RowLayout, rows: int, seed: int) -> dict[str, np.ndarray]:
    """Random bits, so NaNs of every kind, infinities and subnormal numbers among them."""
    rng = np.random.default_rng(seed)
    sizes = {column.path: np.dtype(column.type_code) for column in layout.columns}
    return {path: np.frombuffer(rng.bytes(rows * kind.itemsize), kind) for path, kind in sizes.items()}


@settings(max_examples=60, deadline=None)
@given(layouts(), st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_what_is_encoded_is_decoded_bit_for_bit_also_by_the_schema_alone(
    layout: RowLayout, rows: int, seed: int
) -> None:
    columns = filled(layout, rows, seed)
    data = layout.encode_rows(columns)
    assert len(data) == rows * layout.row_bytes
    for reader in (layout, RowLayout.from_schema("graspwatch.Things", layout.descriptor_set)):
        read = reader.decode(data)
        assert all(read[path].tobytes() == values.tobytes() for path, values in columns.items())


@settings(max_examples=30, deadline=None)
@given(layouts(), st.integers(0, 2**32 - 1))
def test_protobufs_own_reader_finds_every_number(layout: RowLayout, seed: int) -> None:
    columns = filled(layout, 2, seed)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(descriptor_pb2.FileDescriptorSet.FromString(layout.descriptor_set).file[0])
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("graspwatch.Things"))
    data = layout.encode_rows(columns)
    message = kind.FromString(data[layout.row_bytes :])
    for column in layout.columns:
        owner = getattr(message, column.group) if column.group else message
        np.testing.assert_equal(getattr(owner, column.name), columns[column.path][1].item())


def test_a_message_of_another_layout_is_refused() -> None:
    one = RowLayout("A", [ColumnSpec("a"), ColumnSpec("b", "u4")])
    other = RowLayout("A", [ColumnSpec("a", "u4"), ColumnSpec("b")])
    with pytest.raises(ValueError, match="another layout"):
        one.decode(other.encode_rows({"a": np.ones(1, "u4"), "b": np.ones(1)}))
