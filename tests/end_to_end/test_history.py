"""What happened is still there after the service: over REST, with roles, and from the files."""

import contextlib
import json
import os
import subprocess
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
from service import PROGRAM, Service, until
from simulation import joined, simulate_raw, write_lvm

from app.index.database import index_url_from_settings
from app.index.queries import FileQuery
from app.index.store import Store
from config.load import CONFIG_DIR, load_settings

SIMULATED = joined(simulate_raw("bladder", cycles=1))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder in which an earlier service has run twice, and was killed in a third run."""
    folder = tmp_path_factory.mktemp("data")
    with Service("serve", data=folder) as before:
        for tissue in ("liver", "bladder"):
            before.finished(before.run(protocol="trapezoid_4hz", cycles=2, tissue=tissue, by="Ada")["id"])
        before.run(protocol="trapezoid_025hz", cycles=50, tissue="liver", by="Grace")
        until(lambda: len(before.http.get("/api/runs").json()) == 3)
        before.process.kill()
        before.process.wait()
    return folder


@pytest.fixture(scope="module")
def service(data: Path) -> Iterator[Service]:
    with Service("serve", data=data) as running:
        yield running


def get(service: Service, path: str, **asked: object) -> httpx.Response:
    response = service.http.get(path, params=asked)
    assert response.status_code == 200, response.text
    return response


def test_runs_of_earlier_services_are_there_and_one_that_was_cut_short_says_so(service: Service) -> None:
    runs = get(service, "/api/runs").json()
    assert [run["state"] for run in runs] == ["finished", "finished", "failed"]
    assert [run["by"] for run in runs] == ["Ada", "Ada", "Grace"]
    assert "ended from outside" in runs[2]["why"]
    assert get(service, f"/api/runs/{runs[0]['id']}").json() == runs[0]
    grasps = get(service, f"/api/runs/{runs[1]['id']}/grasps").json()
    assert [grasp["label"] for grasp in grasps] == ["bladder", "bladder"]
    assert service.http.post(f"/api/runs/{runs[2]['id']}/stop").json()["stopped"] is False


def test_lists_are_filtered_and_come_in_pages(service: Service) -> None:
    everything = get(service, "/api/runs").json()
    first = get(service, "/api/runs", limit=1, order="newest", by="Ada")
    assert first.json() == [everything[1]]
    assert first.headers["x-total-count"] == "2"
    assert set(first.links) == {"first", "last", "next"}
    second = service.http.get(first.links["next"]["url"])
    assert second.json() == [everything[0]]
    assert set(second.links) == {"first", "last", "prev"}
    assert get(service, "/api/runs", label="bladder").json() == [everything[1]]
    assert get(service, "/api/runs", since=everything[1]["started_at"], q="ADA").json() == [everything[1]]
    assert get(service, "/api/runs", offset=100).json() == []
    assert get(service, "/api/grasps", label="bladder", valid=True).headers["x-total-count"] == "2"
    run = everything[0]["id"]
    assert {each["run_id"] for each in get(service, "/api/grasps", run=run).json()} == {run}
    texts = [line["text"] for line in get(service, "/api/audit", kind="run", by="Grace", order="oldest").json()]
    assert texts[0].startswith("Run started")
    assert get(service, "/api/alarms/history", kind="force").status_code == 200
    runs = {each["id"] for each in everything}
    assert {each["run_id"] for each in get(service, "/api/files").json()} <= runs


@pytest.mark.parametrize(
    ("path", "field"),
    [
        ("/api/runs?limit=501", "limit"),
        ("/api/runs?offset=-1", "offset"),
        ("/api/runs?since=yesterday", "since"),
        ("/api/runs?since=2026-01-01T00:00:00", "since"),
        ("/api/runs?stat=failed", "stat"),
        ("/api/grasps?label=%00", "label"),
        ("/api/audit?kind=nonsense", "kind"),
        ("/api/recordings?limit=0", "limit"),
    ],
)
def test_a_wrong_question_names_its_field(service: Service, path: str, field: str) -> None:
    response = service.http.get(path)
    assert (response.status_code, response.headers["content-type"]) == (422, "application/problem+json")
    assert [fault["field"] for fault in response.json()["errors"]] == [field]


def test_a_run_is_in_the_list_as_soon_as_it_was_started(service: Service) -> None:
    run = service.run(protocol="trapezoid_4hz", cycles=1, by="Ada")
    assert get(service, "/api/runs", order="newest", limit=1).json()[0]["id"] == run["id"]
    over = service.finished(run["id"])
    assert get(service, "/api/runs", order="newest", limit=1).json() == [over]


def recording(service: Service, name: str) -> Path:
    folder = service.data / "recordings"
    path = write_lvm(folder / name, SIMULATED)
    assert name in [each["name"] for each in get(service, "/api/recordings").json()["recordings"]]
    return path


def test_a_recording_is_downloaded_in_parts(service: Service) -> None:
    content = recording(service, "parts.lvm").read_bytes()
    address = "/api/recordings/parts.lvm/file"
    whole = service.http.get(address)
    assert (whole.status_code, whole.content) == (200, content)
    assert whole.headers["accept-ranges"] == "bytes"
    part = service.http.get(address, headers={"Range": "bytes=100-199"})
    assert (part.status_code, part.content) == (206, content[100:200])
    assert part.headers["content-range"] == f"bytes 100-199/{len(content)}"
    rest = service.http.get(address, headers={"Range": f"bytes={len(content) - 5}-", "If-Range": whole.headers["etag"]})
    assert (rest.status_code, rest.content) == (206, content[-5:])
    changed = service.http.get(address, headers={"Range": "bytes=0-9", "If-Range": '"another"'})
    assert (changed.status_code, changed.content) == (200, content)
    beyond = service.http.get(address, headers={"Range": f"bytes={len(content)}-"})
    assert (beyond.status_code, beyond.headers["content-range"]) == (416, f"bytes */{len(content)}")


def test_recordings_are_found_and_come_in_pages(service: Service) -> None:
    for name in ("one.lvm", "two.lvm", "Three.lvm"):
        recording(service, name)
    page = get(service, "/api/recordings", q="t", limit=1)
    assert len(page.json()["recordings"]) == 1
    assert int(page.headers["x-total-count"]) >= 2
    assert "next" in page.links
    assert get(service, "/api/recordings", until="2020-01-01T00:00:00Z").json()["recordings"] == []


def test_an_admin_deletes_a_recording_and_it_is_written_down(service: Service) -> None:
    path = recording(service, "gone.lvm")
    size_bytes = path.stat().st_size
    response = service.http.delete("/api/recordings/gone.lvm", params={"by": "Ada"})
    assert (response.status_code, response.content) == (204, b"")
    assert not path.exists()
    again = service.http.delete("/api/recordings/gone.lvm", params={"by": "Ada"})
    assert (again.status_code, again.headers["content-type"]) == (404, "application/problem+json")
    [line] = get(service, "/api/audit", kind="deleted", q="gone.lvm").json()
    assert (line["by"], line["file"]["name"], line["file"]["size_bytes"]) == ("Ada", "gone.lvm", size_bytes)
    [file] = get(service, "/api/files", deleted=True).json()
    assert (file["name"], file["deleted_by"]) == ("gone.lvm", "Ada")
    written = (service.data / "journal.jsonl").read_text().splitlines()
    assert any(json.loads(each)["kind"] == "deleted" for each in written if "gone.lvm" in each)


def test_a_deleted_recording_is_in_the_bin_and_comes_back(service: Service) -> None:
    path = recording(service, "back.lvm")
    content = path.read_bytes()
    page = until(lambda: reported(service, "back.lvm"), 60.0)
    assert "back.lvm" in page.text
    assert len(list((service.data / "reports").glob("*.html"))) == 1
    service.http.delete("/api/recordings/back.lvm", params={"by": "Ada"})
    assert not list((service.data / "reports").glob("*.html"))
    listed = get(service, "/api/bin").json()
    [binned] = [each for each in listed["recordings"] if each["name"] == "back.lvm"]
    assert (binned["size_bytes"], binned["deleted_by"], listed["keep_days"]) == (len(content), "Ada", 30.0)
    assert listed["size_bytes"] == sum(each["size_bytes"] for each in listed["recordings"])
    age = datetime.fromisoformat(binned["expires_at"]) - datetime.fromisoformat(binned["deleted_at"])
    assert age == timedelta(days=30)

    restore = f"/api/bin/{binned['entry']}/restore"
    assert service.http.post(restore).status_code == 422  # nobody signs for it
    path.write_text("another one by now\n")
    taken = service.http.post(restore, params={"by": "Grace"})
    assert (taken.status_code, path.read_text()) == (409, "another one by now\n")
    path.unlink()
    back = service.http.post(restore, params={"by": "Grace"})
    assert (back.status_code, back.json()["deleted_at"], path.read_bytes()) == (200, None, content)
    assert service.http.post(restore, params={"by": "Grace"}).status_code == 404
    assert "back.lvm" in [each["name"] for each in get(service, "/api/recordings").json()["recordings"]]
    assert [each["deleted_at"] for each in get(service, "/api/files", q="back.lvm").json()] == [None]
    [line] = get(service, "/api/audit", kind="restored", q="back.lvm").json()
    assert line["by"] == "Grace"


def reported(service: Service, name: str) -> httpx.Response | None:
    answer = service.http.get(f"/api/recordings/{name}/report")
    return answer if answer.status_code == 200 else None


@pytest.mark.parametrize("entry", ["..", "%2e%2e%2frecordings", "20260101T000000000000Z", "bin", "x" * 300, "%00"])
def test_no_other_name_is_an_entry_of_the_bin(service: Service, entry: str) -> None:
    answer = service.http.post(f"/api/bin/{entry}/restore", params={"by": "Ada"})
    assert answer.status_code in (404, 405)


@pytest.mark.long
def test_a_run_that_was_deleted_and_restored_is_whole_also_after_a_rebuild_meanwhile(tmp_path: Path) -> None:
    with Service("serve", data=tmp_path) as before:
        run = before.run(protocol="trapezoid_4hz", cycles=1, tissue="liver")["id"]
        before.finished(run)
        until(lambda: before.http.get("/api/files", params={"run": run}).json())
        grasps = before.http.get(f"/api/runs/{run}/grasps").json()
        assert before.http.delete(f"/api/recordings/{run}.mcap", params={"by": "Ada"}).status_code == 204
        deleted = before.http.get("/api/files").json()
        assert deleted[0]["deleted_by"] == "Ada"
    rebuild_index(tmp_path)
    with Service("serve", data=tmp_path) as after:
        assert after.http.get("/api/files").json() == deleted
        assert after.http.get(f"/api/runs/{run}/grasps").json() == grasps
        [binned] = after.http.get("/api/bin").json()["recordings"]
        assert binned["deleted_by"] == "Ada"
        restored = after.http.post(f"/api/bin/{binned['entry']}/restore", params={"by": "Ada"})
        assert restored.json() == deleted[0] | {"deleted_at": None, "deleted_by": None}
        assert after.http.get("/api/files").json() == [restored.json()]
    rebuild_index(tmp_path)
    with contextlib.closing(Store(index_url_from_settings(load_settings(), tmp_path))) as index:
        assert [each.model_dump(mode="json") for each in index.find_files(FileQuery()).items] == [restored.json()]


def rebuild_index(data: Path) -> None:
    done = subprocess.run([PROGRAM, "index", "--rebuild", "--data", data], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_what_is_too_old_or_emptied_is_gone_for_good_and_written_down(tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    for entry, name in (("20200101T000000000000Z", "old.lvm"), (f"{datetime.now(UTC):%Y%m%dT%H%M%S%fZ}", "new.lvm")):
        write_lvm(make(folder / "bin" / entry) / name, SIMULATED)
    with Service("serve", data=tmp_path) as running:
        until(lambda: not (folder / "bin" / "20200101T000000000000Z").exists())
        assert [each["name"] for each in running.http.get("/api/bin").json()["recordings"]] == ["new.lvm"]
        size_bytes = running.http.get("/api/bin").json()["size_bytes"]
        assert running.http.delete("/api/bin").status_code == 422  # nobody signs for it
        emptied = running.http.delete("/api/bin", params={"by": "Ada"})
        assert emptied.json() == {"removed": 1, "freed_bytes": size_bytes}
        assert running.http.get("/api/bin").json()["recordings"] == []
        assert not list((folder / "bin").iterdir())
        lines = running.http.get("/api/audit", params={"kind": "emptied", "order": "oldest"}).json()
        assert [("old.lvm" in line["text"], line["by"]) for line in lines] == [(True, None), (False, "Ada")]
        assert "after 30 days" in lines[0]["text"]
        [deed] = running.http.get("/api/audit", params={"kind": "request", "q": "empty"}).json()[:1]
        assert (deed["by"], deed["result"]) == ("Ada", "done")


def make(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return folder


@pytest.mark.parametrize("headers", [{"X-Forwarded-For": "192.0.2.7"}, {"Host": "evil.example"}, {"Via": "1.1 proxy"}])
def test_who_does_not_come_from_this_machine_may_not_delete(service: Service, headers: dict[str, str]) -> None:
    path = recording(service, "kept.lvm")
    response = service.http.delete("/api/recordings/kept.lvm", params={"by": "Eve"}, headers=headers)
    assert (response.status_code, response.headers["content-type"]) == (403, "application/problem+json")
    assert "graspwatch token add" in response.json()["detail"]
    assert path.exists()


def test_a_recording_that_somebody_watches_or_nobody_signs_for_stays(service: Service) -> None:
    from websockets.sync.client import connect

    path = recording(service, "watched.lvm")
    address = "/api/recordings/watched.lvm"
    assert service.http.delete(address).status_code == 422
    assert service.http.delete(address, params={"by": "  "}).status_code == 422
    with connect(f"ws://127.0.0.1:{service.port}{address}/replay", max_size=None) as viewer:
        viewer.recv(timeout=10)
        response = service.http.delete(address, params={"by": "Ada"})
        assert response.status_code == 409
        assert "watching" in response.json()["detail"]
    assert path.exists()
    until(lambda: service.http.delete(address, params={"by": "Ada"}).status_code == 204)


def test_a_recording_of_the_command_line_stays(tmp_path: Path) -> None:
    path = write_lvm(tmp_path / "opened.lvm", SIMULATED)
    with Service("replay", str(path), "--serve") as running:
        response = running.http.delete("/api/recordings/opened.lvm", params={"by": "Ada"})
        assert response.status_code == 409
        assert "command line" in response.json()["detail"]
    assert path.exists()


def settings_with(folder: Path, **changes: str) -> str:
    """A settings file."""
    text = (CONFIG_DIR / "graspwatch.toml").read_text()
    for key, value in changes.items():
        text = text.replace("[server]\n", f'{key} = "{value}"\n[server]\n', 1)
    path = folder / "settings.toml"
    path.write_text(text)
    return str(path)


def refused(*arguments: str) -> tuple[int, str]:
    """How the program ends that must not start."""
    done = subprocess.run(
        [PROGRAM, *arguments, "--port", "0"],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, "COLUMNS": "300"},
    )
    assert "Dashboard" not in done.stdout
    assert "Traceback" not in done.stderr
    return done.returncode, done.stderr


def test_a_service_that_cannot_keep_an_index_does_not_start(tmp_path: Path) -> None:
    (tmp_path / "index.sqlite").write_bytes(b"rubbish" * 1000)
    code, text = refused("serve", "--data", str(tmp_path))
    assert code == 6
    assert "graspwatch index --rebuild" in text
    nowhere = settings_with(tmp_path, index_url="postgresql://ada:hushhush@127.0.0.1:1/x")
    code, text = refused("serve", "--config", nowhere, "--data", str(tmp_path))
    assert code == 6
    assert "nothing listens there" in text
    assert "hushhush" not in text


def test_the_index_is_rebuilt_from_the_command_line(service: Service, data: Path) -> None:
    """The last test of this service: it ends it."""
    before = get(service, "/api/runs").json()
    busy = subprocess.run([PROGRAM, "index", "--rebuild", "--data", data], capture_output=True, text=True, timeout=60)
    assert (busy.returncode, "Stop the service" in busy.stderr) == (6, True)
    service.end()
    shown = subprocess.run([PROGRAM, "index", "--json", "--data", data], capture_output=True, text=True, timeout=60)
    held = json.loads(shown.stdout)
    assert (held["counts"]["runs"], held["behind"]) == (len(before), [])
    (data / "index.sqlite").write_bytes(b"rubbish" * 1000)
    done = subprocess.run([PROGRAM, "index", "--rebuild", "--data", data], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "set aside" in done.stderr
    with Service("serve", data=data) as after:
        assert get(after, "/api/runs").json() == before
