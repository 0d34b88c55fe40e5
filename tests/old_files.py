"""Rewrite recordings into the format of earlier versions."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import Writer

from acquisition.recordings import mcap_layout
from acquisition.recordings.protobuf_rows import RowLayout

RAW_BEFORE = RowLayout(
    "Raw", [column for column in mcap_layout.RAW_LAYOUT.columns if column.name not in mcap_layout.OPTIONAL_COLUMNS]
)


def without_limit(
    source: Path, target: Path, change_tool: Callable[[dict[str, Any]], None] = lambda tool: None
) -> Path:
    """Copy a run's file to the format without the limit in every sample.

    `change_tool` converts its tool file to one of that time.
    """
    with source.open("rb") as read, target.open("wb") as write:
        reader, writer = make_reader(read), Writer(write)
        writer.start(mcap_layout.PROFILE, "graspwatch")
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for each in reader.iter_attachments():
            data = each.data
            if each.name == mcap_layout.TOOL_ATTACHMENT:
                tool = json.loads(data)
                change_tool(tool)
                data = json.dumps(tool).encode()
            writer.add_attachment(each.log_time, each.create_time, each.name, each.media_type, data)
        channels: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            is_raw = channel.topic == mcap_layout.RAW_TOPIC
            if channel.topic not in channels:
                definition = RAW_BEFORE.descriptor_set if is_raw else schema.data
                of = writer.register_schema(schema.name, schema.encoding, definition)
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, of)
            data = RAW_BEFORE.encode_rows(mcap_layout.RAW_LAYOUT.decode(message.data)) if is_raw else message.data
            writer.add_message(channels[channel.topic], message.log_time, data, message.publish_time, message.sequence)
        writer.finish()
    return target
