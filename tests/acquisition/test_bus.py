"""The messages of the bus: what is packed arrives as it was, and the force limit's way back, over real sockets."""

import json
import time
from dataclasses import fields
from pathlib import Path
from typing import get_args

import pytest
import zmq

from acquisition import bus
from acquisition.notices import MotorZeroed, Notice, RunEnded, RunOutcome
from config.errors import ServiceError

SAMPLE_VALUES = {
    "run_id": "20261130-1",
    "end": RunOutcome.FAILED,
    "samples": 5,
    "missing_blocks": 0,
    "cycles": 3,
    "tissue": None,
    "pull_n": 1.5,
    "gauge_m": None,
}


def filled(kind: type) -> object:
    """A message with a value in each field."""
    return kind(**{field.name: SAMPLE_VALUES.get(field.name, f"Ärger: {field.name}") for field in fields(kind)})


@pytest.mark.parametrize("kind", get_args(Notice))
def test_a_notice_arrives_as_it_was_sent(kind: type[Notice]) -> None:
    notice = filled(kind)
    assert isinstance(notice, kind)
    arrived = bus.unpack_notice(bus.pack_notice(notice))
    assert arrived == notice
    assert type(arrived) is kind
    if isinstance(arrived, RunEnded):
        assert arrived.end is RunOutcome.FAILED


@pytest.mark.parametrize("kind", get_args(bus.AnyCommand))
def test_a_command_arrives_as_it_was_sent_unless_it_is_late(kind: type[bus.AnyCommand]) -> None:
    command = filled(kind)
    assert isinstance(command, kind)
    assert bus.unpack_command(bus.pack_command(command, time.monotonic_ns() + 10**10)) == command
    late = bus.unpack_command(bus.pack_command(command, time.monotonic_ns() - 1))
    assert late == (command if kind is bus.StopCommand else None)


def test_a_notice_or_command_of_another_version_is_refused_with_what_to_do() -> None:
    parts = bus.pack_notice(MotorZeroed("by a reset"))
    parts[1] = parts[1].replace(b"MotorZeroed", b"MotorMelted")
    with pytest.raises(ServiceError, match=r"'MotorMelted'.*different versions.*Start the service again"):
        bus.unpack_notice(parts)
    command = json.loads(bus.pack_command(bus.DisarmCommand(), 0)) | {"command": "OpenJaws"}
    with pytest.raises(ServiceError, match=r"'OpenJaws'.*Start the service again"):
        bus.unpack_command(json.dumps(command).encode())


def taken(socket: zmq.Socket) -> bus.ThresholdUpdate | None:
    return bus.unpack_threshold(socket.recv()) if socket.poll(0) else None


def until_taken(socket: zmq.Socket, publisher: zmq.Socket, limit: bus.ThresholdUpdate) -> None:
    """Publish until the subscription has reached the publisher."""
    deadline = time.monotonic() + 10
    while taken(socket) != limit:
        publisher.send(bus.pack_threshold(limit))
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_only_the_newest_limit_is_read_and_nobody_waits_for_one(tmp_path: Path) -> None:
    address = bus.Endpoints.in_folder(tmp_path).thresholds
    context = zmq.Context()
    try:
        socket = bus.open_latest_subscriber(context, address)  # before there is an estimator
        assert taken(socket) is None
        publisher = bus.open_publisher(context, address)
        until_taken(socket, publisher, bus.ThresholdUpdate(2.25, None, 0))
        for tick in range(1000):
            publisher.send(bus.pack_threshold(bus.ThresholdUpdate(3.38, "liver", tick)))
        newest = bus.ThresholdUpdate(3.38, "liver", 999)
        deadline = time.monotonic() + 10
        while (limit := taken(socket)) != newest:
            assert time.monotonic() < deadline, limit
        assert taken(socket) is None
    finally:
        context.destroy(linger=0)


def test_a_new_estimator_is_heard_at_the_same_address(tmp_path: Path) -> None:
    address = bus.Endpoints.in_folder(tmp_path).thresholds
    context = zmq.Context()
    try:
        socket = bus.open_latest_subscriber(context, address)
        for tick in (1, 2):
            publisher = bus.open_publisher(context, address)
            until_taken(socket, publisher, bus.ThresholdUpdate(2.25, None, tick))
            publisher.close(linger=0)
            time.sleep(0.05)  # the address is free again
    finally:
        context.destroy(linger=0)
