"""The force limit's way back, over real sockets."""

import time
from pathlib import Path

import zmq

from acquisition import bus


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
