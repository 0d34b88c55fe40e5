"""The live stream for Foxglove and Lichtblick, received by the protocol's own reference client."""

import base64
import json
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from service import PROGRAM, Service, until

FRONTEND = Path(__file__).parents[2] / "frontend"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return taken.getsockname()[1]


@pytest.fixture(scope="module")
def streaming() -> Iterator[tuple[Service, int]]:
    port = free_port()
    with Service("serve", "--foxglove", str(port)) as running:
        yield running, port


def client(port: int, seconds: float) -> subprocess.Popen[str]:
    command = [FRONTEND / "npm.sh", "run", "--silent", "--prefix", FRONTEND, "foxglove", "--"]
    return subprocess.Popen([*command, f"ws://127.0.0.1:{port}", str(seconds)], stdout=subprocess.PIPE, text=True)


def rows(channel: dict[str, Any]) -> tuple[np.ndarray, list[Any]]:
    """Log times, ns, and the messages as protobuf's own reader decodes them."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
    messages = channel["messages"]
    return np.array([int(at) for at, _ in messages]), [kind.FromString(base64.b64decode(data)) for _, data in messages]


def recorded(path: Path, topic: str) -> list[bytes]:
    with path.open("rb") as file:
        return [message.data for _, _, message in make_reader(file).iter_messages([topic])]


@pytest.mark.long
def test_the_reference_client_receives_every_channel(streaming: tuple[Service, int]) -> None:
    service, port = streaming
    receiving = client(port, 5.0)
    run = service.run(protocol="trapezoid_4hz", cycles=3, tissue="liver")
    service.finished(run["id"])
    received = json.loads(receiving.communicate(timeout=60)[0])
    assert received["server"] == "Simulated grasper"
    topics = received["topics"]
    assert set(topics) == {
        "/raw",
        "/conditioned",
        "/estimates",
        "/identification",
        "/grasp",
        "/alarm",
        "/run",
        "/journal",
    }
    at_ns, samples = rows(topics["/conditioned"])
    ticks = np.array([each.tick for each in samples])
    assert (np.diff(ticks) == 1).all()
    assert (np.abs(np.diff(at_ns) - 1_000_000) <= 1).all()
    grasps = service.http.get(f"/api/runs/{run['id']}/grasps").json()
    told = [json.loads(base64.b64decode(data))["grasp"] for _, data in topics["/grasp"]["messages"]]
    assert told[-1]["label"] == grasps[-1]["label"]
    _, estimates = rows(topics["/estimates"])
    assert np.nanmax([each.liver.probability for each in estimates]) > 0.9
    path = service.data / "recordings" / f"{run['id']}.mcap"
    for topic in ("/raw", "/conditioned", "/estimates"):
        kept = set(recorded(path, topic))
        shown = [base64.b64decode(data) for _, data in topics[topic]["messages"]]
        assert len(kept.intersection(shown)) > 1000, "live and recorded are the same bytes"


def test_its_end_disturbs_nobody_and_it_comes_back(streaming: tuple[Service, int]) -> None:
    service, port = streaming
    run = service.run(protocol="trapezoid_4hz", cycles=4, tissue="liver")
    before = service.worker("foxglove")
    os.kill(before, signal.SIGKILL)
    alarms = until(lambda: service.http.get("/api/alarms").json())
    assert [each["priority"] for each in alarms] == ["low"]
    assert "The foxglove worker died (signal 9)" in alarms[0]["text"]
    until(lambda: service.worker("foxglove") != before and service.conditions()["foxglove"] == "running")
    assert service.finished(run["id"])["state"] == "finished"
    assert json.loads(client(port, 1.0).communicate(timeout=60)[0])["topics"]["/raw"]["messages"]


def test_a_port_that_is_taken_is_told_at_once(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        command = [PROGRAM, "serve", "--port", "0", "--foxglove", str(port), "--data", tmp_path]
        refused = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert refused.returncode == 6
    assert f"Cannot listen on 127.0.0.1, port {port}" in refused.stderr
