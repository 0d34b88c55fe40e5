"""The class RowLayout, which encodes and decodes rows of numbers as protobuf messages of a fixed layout.

Every field has a fixed width and is always written. So all messages of a channel have the same length, and numpy
encodes and decodes thousands at a time. Any protobuf reader can read them. Encoding:
https://protobuf.dev/programming-guides/encoding/
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

PACKAGE = "graspwatch"
_FIXED32, _FIXED64, _GROUP = 5, 1, 2  # wire types
_WIRE_TYPES = {
    "<f8": (FieldDescriptorProto.TYPE_DOUBLE, _FIXED64),
    "<i8": (FieldDescriptorProto.TYPE_SFIXED64, _FIXED64),
    "<u4": (FieldDescriptorProto.TYPE_FIXED32, _FIXED32),
}
_DTYPES = {field_type: dtype for dtype, (field_type, _) in _WIRE_TYPES.items()}
TAG_PREFIX = "tag_"

Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True, slots=True)
class ColumnSpec:
    """Definition of one number of a row: its name and type, `f8`, `i8` or `u4`; it holds no values.

    With `group`, the number is in a nested message of that name.
    """

    name: str
    type_code: str = "f8"
    group: str = ""

    @property
    def path(self) -> str:
        return f"{self.group}.{self.name}" if self.group else self.name


class RowLayout:
    """Layout of a kind of row: its columns, its protobuf schema and its dtype in memory."""

    def __init__(self, name: str, columns: Sequence[ColumnSpec]) -> None:
        """Columns of one group are adjacent; names are identifiers."""
        self.name, self.columns = name, tuple(columns)
        file = FileDescriptorProto(name=f"{PACKAGE}/{name.lower()}.proto", package=PACKAGE, syntax="proto3")
        message = file.message_type.add(name=name)
        self._dtype, template = _build_layout(self.columns, message)
        self._template = template.view(self._dtype)[0]
        self.descriptor_set = FileDescriptorSet(file=[file]).SerializeToString()

    @classmethod
    def from_schema(cls, name: str, descriptor_set: bytes) -> Self:
        """Return the layout of messages that were written with this schema.

        Raises:
            ValueError: the schema is not one of rows of fixed layout.
        """
        message = FileDescriptorSet.FromString(descriptor_set).file[0].message_type[0]
        inner = {nested.name: nested for nested in message.nested_type}
        columns = []
        for field in message.field:
            if field.type == FieldDescriptorProto.TYPE_MESSAGE:
                nested = inner[field.type_name.rpartition(".")[2]]
                columns += [ColumnSpec(each.name, _DTYPES[each.type][1:], field.name) for each in nested.field]
            else:
                columns.append(ColumnSpec(field.name, _DTYPES[field.type][1:]))
        layout = cls(name.removeprefix(f"{PACKAGE}."), columns)
        if layout.descriptor_set != descriptor_set:
            raise ValueError(f"{name}: not a schema of rows of fixed layout")
        return layout

    @property
    def schema_name(self) -> str:
        return f"{PACKAGE}.{self.name}"

    @property
    def row_bytes(self) -> int:
        return self._dtype.itemsize

    def encode_rows(self, columns: Columns) -> bytes:
        """Encode arrays of shape (n,) by `ColumnSpec.path` as consecutive rows of `row_bytes` each."""
        rows = np.full(len(next(iter(columns.values()))), self._template)
        for column in self.columns:
            rows[column.path] = columns[column.path]
        return rows.tobytes()

    def decode(self, data: bytes) -> dict[str, np.ndarray]:
        """Decode rows to arrays of shape (n,) by `ColumnSpec.path`.

        Raises:
            ValueError: the data are not rows of this layout.
        """
        rows = np.frombuffer(data, self._dtype)
        for name in self._dtype.names or ():
            if name.startswith(TAG_PREFIX) and (rows[name] != self._template[name]).any():
                raise ValueError(f"{self.name}: a message has another layout than its schema says")
        return {column.path: rows[column.path] for column in self.columns}


def _build_layout(columns: tuple[ColumnSpec, ...], message: DescriptorProto) -> tuple[np.dtype, np.ndarray]:
    """Return the dtype of a row and a row with all tags and zero values; add the fields to `message`."""
    fields: list[tuple[str, str]] = []
    template = b""
    groups: dict[str, DescriptorProto] = {}
    for column in columns:
        owner = message
        if column.group:
            if column.group not in groups:
                inner = [each for each in columns if each.group == column.group]
                head = _declare_submessage(
                    message, column.group, sum(_compute_encoded_size(each, n) for n, each in enumerate(inner, 1))
                )
                fields.append((f"{TAG_PREFIX}{column.group}", f"V{len(head)}"))
                template += head
                groups[column.group] = message.nested_type[-1]
            owner = groups[column.group]
        field_type, wire_type = _WIRE_TYPES[f"<{column.type_code}"]
        number = len(owner.field) + 1
        tag = _encode_varint(number << 3 | wire_type)
        owner.field.add(name=column.name, number=number, type=field_type, label=FieldDescriptorProto.LABEL_OPTIONAL)
        fields += [(f"{TAG_PREFIX}{column.path}", f"V{len(tag)}"), (column.path, f"<{column.type_code}")]
        template += tag + bytes(np.dtype(column.type_code).itemsize)
    return np.dtype(fields), np.frombuffer(template, np.uint8)


def _declare_submessage(message: DescriptorProto, group: str, size: int) -> bytes:
    """Declare a message inside `message`; return its tag and length."""
    kind = "".join(part.capitalize() for part in group.split("_"))
    message.nested_type.add(name=kind)
    number = len(message.field) + 1
    message.field.add(
        name=group,
        number=number,
        type=FieldDescriptorProto.TYPE_MESSAGE,
        type_name=f".{PACKAGE}.{message.name}.{kind}",
        label=FieldDescriptorProto.LABEL_OPTIONAL,
    )
    return _encode_varint(number << 3 | _GROUP) + _encode_varint(size)


def _compute_encoded_size(column: ColumnSpec, number: int) -> int:
    return len(_encode_varint(number << 3)) + np.dtype(column.type_code).itemsize


def _encode_varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)
