"""A tool without a motor, live: a device that prints lines to a serial port, driven by hand."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from serial_device import SerialDevice
from service import Listener, Service, until

from acquisition.recordings.recording import RecordingSource
from config.load import load_tool

STEP_MS, CLOSING_S = 3, 2.0


class ClosingDevice:
    """A device whose jaws close every two seconds and press with 2 N, as seen by a hand's sensors."""

    def __init__(self, device: SerialDevice) -> None:
        self._device, self._plugged_in = device, threading.Lock()
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._print_lines)

    def __enter__(self) -> "ClosingDevice":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()

    def unplug(self) -> None:
        self._plugged_in.acquire()
        self._device.unplug()

    def plug_in(self) -> None:
        self._device.plug_in()
        self._plugged_in.release()

    def _print_lines(self) -> None:
        begin_s, count = time.monotonic(), 0
        random = np.random.default_rng(1)
        while not self._ends.is_set():
            late = int((time.monotonic() - begin_s) * 1e3 / STEP_MS) - count
            with self._plugged_in:
                for _ in range(late):
                    shut = max(0.0, np.sin(np.pi * count * STEP_MS * 1e-3 / (CLOSING_S / 2)))
                    grams = 200.0 * max(shut - 0.5, 0.0) + abs(random.normal(0.0, 0.5))
                    angle = 12.0 * shut + random.normal(0.0, 0.05)
                    self._device.print(f"0\t{grams:.2f}\t0\t{angle:.2f}\t{count * STEP_MS}.00\t\\\r\n")
                    count += 1
            time.sleep(0.005)


@pytest.fixture
def device(tmp_path: Path) -> Iterator[ClosingDevice]:
    with SerialDevice(tmp_path / "port") as port, ClosingDevice(port) as running:
        yield running


@pytest.fixture
def tool_file(tmp_path: Path) -> Path:
    shipped = Path(__file__).parents[2] / "config/tools/arthroscopic_punch.toml"
    text = shipped.read_text().replace("arthroscopic_punch", "my_punch", 2).replace('"recording"', '"serial"', 1)
    path = tmp_path / "my_punch.toml"
    path.write_text(f'{text}\n[serial]\nport = "{tmp_path / "port"}"\n')
    return path


def alarm_texts(service: Service) -> list[str]:
    return [alarm["text"] for alarm in service.http.get("/api/alarms").json() if alarm["active"]]


def test_a_tool_driven_by_hand_is_watched_recorded_and_waited_for(device: ClosingDevice, tool_file: Path) -> None:
    with Service("serve", "--tool", str(tool_file)) as service, Listener(service) as viewer:
        assert service.http.get("/api/tool").json()["has_motor"] is False
        assert [each["name"] for each in service.http.get("/api/protocols").json()] == ["by_hand"]
        refused = service.http.post("/api/runs", json={"protocol": "trapezoid_2hz"})
        assert refused.status_code == 422
        assert "drives a motor, which this tool lacks" in refused.json()["detail"]

        run = service.run(protocol="by_hand", by="Ada")
        until(lambda: service.http.get(f"/api/runs/{run['id']}").json()["grasps"] >= 2)
        device.unplug()
        until(
            lambda: any(
                "No samples arrive from the tool: there is no serial port" in text for text in alarm_texts(service)
            )
        )
        acquisition = service.worker("acquisition")
        time.sleep(3.0)  # longer than a worker may be silent
        device.plug_in()
        until(lambda: not any("No samples" in text for text in alarm_texts(service)))
        assert service.worker("acquisition") == acquisition  # it waited; it was not replaced
        grasps = service.http.get(f"/api/runs/{run['id']}").json()["grasps"]
        until(lambda: service.http.get(f"/api/runs/{run['id']}").json()["grasps"] > grasps)
        assert service.http.post("/api/stop").json()["stopped"]
        path = service.recorded(run["id"])
        viewer.listen(lambda: viewer.of("hello") and viewer.of("state"))
        assert viewer.of("hello")[0]["tool"]["kind"] == "serial"
        refused = service.http.post("/api/arm", json={})
        assert (refused.status_code, "has no motor" in refused.json()["detail"]) == (409, True)
        again = service.run(protocol="by_hand")  # nothing has to be armed after a stop
        assert service.http.post("/api/stop").json()["run"]["id"] == again["id"]

        with RecordingSource(path, load_tool(str(tool_file))) as source:
            blocks = list(iter(source.read_block, None))
    force_v = np.concatenate([block.signals["strain_v"] for block in blocks])
    assert float(force_v.max()) == pytest.approx(1.0, abs=0.05)
    assert sum(block.lost_samples for block in blocks) > 2.5 * 370.0
