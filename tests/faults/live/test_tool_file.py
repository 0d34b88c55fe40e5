"""A tool file that is put to use on a board: armed, with a fault, with a hung acquisition, and when it fails."""

import os
import signal
from datetime import date

import pytest
from boards import HAS_DRIVER, ServedBoard
from nidaqmx.error_codes import DAQmxErrors
from service import Service, until

from acquisition.simulation.faults import SensorFault
from config.writing import write_calibrated_tool

pytestmark = [
    pytest.mark.alone,
    pytest.mark.long,
    pytest.mark.skipif(HAS_DRIVER, reason="the driver of a real board is installed"),
]
READ_ERROR = DAQmxErrors.SAMPLES_NO_LONGER_AVAILABLE
LONG = {"protocol": "trapezoid_025hz", "cycles": 20}


def texts(service, key):
    return [each["text"] for each in service.http.get("/api/alarms").json() if each["id"].startswith(key)]


def newton_per_volt(service):
    return service.http.get("/api/system").json()["tool"]["calibration"]["newton_per_volt"]


def test_it_is_used_at_rest_alone_and_the_one_before_is_used_again_if_it_fails(tmp_path):
    with ServedBoard(tmp_path) as board:
        data = tmp_path / "data"
        (data / "tools").mkdir(parents=True)
        files = [
            write_calibrated_tool(
                str(board.tool_file), {"calibration.newton_per_volt": value}, [], date.today(), data / "tools"
            )
            for value in (12.4, 12.5)
        ]
        with Service("serve", "--tool", str(board.tool_file), data=data) as service:

            def use(file):
                return service.http.post(f"/api/configuration/tool/{file.stem}/use")

            def use_with_hung(worker, file):
                """Whether the file is used before the service has noticed that the worker hangs."""
                os.kill(worker, signal.SIGSTOP)
                if not (used := use(file).status_code == 200):
                    os.kill(worker, signal.SIGCONT)
                return used

            def at_rest():
                return service.http.get("/api/health").json()["detail"] == "idle" and board.output_v == 0.0

            first, second = files
            [newer] = texts(service, "newer-calibration")
            assert f"as served says, though there is a newer calibration of it, {second.stem}" in newer

            service.run(**LONG)  # which arms it
            board.wait_for_force()
            assert use(first).status_code == 409
            service.http.post("/api/stop")
            until(lambda: use(first).status_code == 200)  # once the recording is complete
            assert board.output_v == 0.0
            until(at_rest)
            assert newton_per_volt(service) == 12.4
            assert second.stem in texts(service, "newer-calibration")[0]
            assert service.http.post("/api/runs", json=LONG).status_code == 201, "the new constants fit this tool"
            board.wait_for_force()

            board.break_now(SensorFault.STRAIN_SATURATED)
            until(lambda: texts(service, "fault-"))
            board.tell("mend")
            assert "A fault is latched" in use(second).json()["detail"]
            service.acknowledge_fault()

            assert service.http.post("/api/arm", json={}).status_code == 200
            until(lambda: service.http.get("/api/health").json()["detail"] == "idle")
            acquisition = service.worker("acquisition")
            os.kill(acquisition, signal.SIGSTOP)
            assert use(second).status_code in (409, 503)  # an armed tool that cannot be disarmed
            os.kill(acquisition, signal.SIGCONT)
            until(at_rest)
            assert newton_per_volt(service) == 12.4
            service.http.post("/api/disarm")

            until(lambda: use_with_hung(acquisition, second))
            assert newton_per_volt(service) == 12.5
            board.tell("fail_next_read", READ_ERROR)  # that of the new worker, once the hung one is ended
            [failed] = until(lambda: texts(service, "tool-file"))
            assert failed.startswith(f"The tool file {second.name} could not be used")
            assert f"returns to {first.name}" in failed
            until(at_rest)
            assert newton_per_volt(service) == 12.4
            service.run(**LONG)
            board.wait_for_force()
            service.http.post("/api/stop")
            assert board.output_v == 0.0
