"""A real tool whose force scale nobody measured: it does not move unless an admin says why it may."""

import json
import subprocess

import pytest
from boards import HAS_DRIVER, ServedBoard
from people import bearer, give_tokens
from service import PROGRAM, Listener, Service, until

from acquisition.recordings.mcap_reader import McapFile
from app.messages.people import Role

pytestmark = pytest.mark.skipif(HAS_DRIVER, reason="the driver of a real board is installed")
START = {"protocol": "trapezoid_2hz", "cycles": 1}
WHY = {"unmeasured_scale": "foam in the jaws, to measure it"}
WORDS = "N by Eq. (2), scale 1.0 (1.0 to 1.0), not measured"


def test_it_moves_only_for_an_admins_reason_which_stands_in_the_journal(tmp_path):
    with ServedBoard(tmp_path, measured=False) as board:
        data = tmp_path / "data"
        data.mkdir()
        token = {role: bearer(each) for role, each in give_tokens(data).items()}
        with Service("serve", "--tool", str(board.tool_file), data=data) as service:
            service.http.headers.update(token[Role.ADMIN])
            until(lambda: service.http.get("/api/system").status_code == 200)
            ask = service.http.post
            for path, body in (("/api/arm", {}), ("/api/runs", START)):
                refused = ask(path, json=body)
                assert (refused.status_code, "force scale is not measured" in refused.json()["detail"]) == (409, True)
                operator = ask(path, json=body | WHY, headers=token[Role.OPERATOR])
                assert (operator.status_code, operator.json()["detail"]) == (
                    422,
                    "Only an admin may arm a tool whose force scale is not measured.",
                )
                assert board.output_v == 0.0
            assert board.peak_force_n == 0.0
            [alarm] = service.http.get("/api/alarms").json()
            assert alarm["text"].startswith(f"The tool's force scale is not measured ({WORDS})")
            run = ask("/api/runs", json=START | WHY).json()
            ended = service.finished(run["id"])
            assert ended["state"] == "finished", ended["why"]
            assert board.peak_force_n > 0.5
            again = ask("/api/runs", json=START)
            assert again.status_code == 201, "it is armed"
            ask("/api/stop")
            assert ask("/api/runs", json=START).status_code == 409, "and has to be armed again"
            texts = [line["text"] for line in service.http.get("/api/journal").json()]
            said = f"Armed: tare and self-test passed, without a measured force scale: {WHY['unmeasured_scale']}"
            assert [text for text in texts if text.startswith("Armed")] == [said]
            assert McapFile(service.recorded(run["id"])).metadata["force_scale"] == WORDS


@pytest.mark.long
def test_it_can_be_calibrated_with_empty_jaws_and_is_armed_for_nothing_else_by_that(tmp_path):
    with ServedBoard(tmp_path, tissue="liver", measured=False) as board:
        checked = subprocess.run(
            [PROGRAM, "check", "--tool", board.tool_file, "--no-move"], capture_output=True, text=True, timeout=90
        )
        assert checked.returncode == 4
        assert f"fail     force scale: {WORDS}" in checked.stdout
        assert "is not ready: force scale." in checked.stderr
        with Service("serve", "--tool", str(board.tool_file)) as service, Listener(service) as listener:
            listener.listen(lambda: listener.of("hello"))
            assert listener.of("hello")[0]["tool"]["force_scale"]["text"] == WORDS
            service.http.post("/api/calibration", json={"what": "stretch", "person": "a test"})
            read = service.http.post("/api/calibration/reading", timeout=60.0)
            assert board.peak_force_n > 0.1, read.text  # there is a liver in its jaws, which is no stretch of a cable
            assert read.status_code == 409
            refused = service.http.post("/api/runs", json=START)
            assert "force scale is not measured" in refused.json()["detail"]
            lines = [json.loads(line) for line in (service.data / "journal.jsonl").read_text().splitlines()]
            assert any("for a calibration with empty jaws" in line["text"] for line in lines)
