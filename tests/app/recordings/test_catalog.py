"""The shelf of recordings, and the processes that read them."""

import asyncio
import contextlib
import os
import signal
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest
from simulation import joined, simulate_raw, write_lvm

from app.host.background_process import SendMessage, run_in_background_process
from app.messages.recordings import RecordingInfo
from app.recordings.catalog import RecordingCatalog
from app.recordings.replay import cache_store
from app.recordings.replay.cache_store import ReplayCacheStore
from config.errors import RecordingError, RefusedError, ServiceError
from config.load import load_library, load_settings, load_tool
from config.service_plan import ServicePlan

SIMULATED = joined(simulate_raw("bladder", cycles=1))


@pytest.fixture
def plan(tmp_path: Path) -> ServicePlan:
    """With one sound recording on the shelf, and a file beside the folder."""
    tool = load_tool("simulated")
    plan = ServicePlan(tool, load_library("porcine"), load_settings(), "liver", 0, tmp_path, tool)
    plan.recordings_folder.mkdir()
    write_lvm(plan.recordings_folder / "sound.lvm.gz", SIMULATED)
    write_lvm(tmp_path / "outside.lvm", SIMULATED)
    return plan


def with_shelf(plan: ServicePlan, use: Callable[[RecordingCatalog], Awaitable[None]]) -> None:
    async def used() -> None:
        async with contextlib.aclosing(RecordingCatalog(plan)) as shelf:
            await use(shelf)

    asyncio.run(used())


async def read(shelf: RecordingCatalog) -> dict[str, RecordingInfo]:
    """The list once everything on it has been read."""
    while True:
        recordings = (await shelf.list_recordings()).recordings
        if all(recording.duration_s or recording.problem for recording in recordings):
            return {recording.name: recording for recording in recordings}
        await asyncio.sleep(0.05)


def test_the_list_comes_at_once_and_knows_more_when_it_is_asked_again(plan: ServicePlan) -> None:
    broken = plan.recordings_folder / "broken.lvm"
    broken.write_text("no recording\n")
    (plan.recordings_folder / "notes.txt").write_text("no recording either\n")

    async def use(shelf: RecordingCatalog) -> None:
        first = await shelf.list_recordings()
        assert first.folder == str(plan.recordings_folder)
        assert {(r.name, r.duration_s, r.problem) for r in first.recordings} == {
            ("broken.lvm", None, None),
            ("sound.lvm.gz", None, None),
        }
        found = await read(shelf)
        assert found["sound.lvm.gz"].duration_s == pytest.approx(1.75, abs=0.05)
        assert found["sound.lvm.gz"].size_bytes == (plan.recordings_folder / "sound.lvm.gz").stat().st_size
        problem = "broken.lvm, line 1: expected 'LabVIEW Measurement', found 'no recording'."
        assert found["broken.lvm"].problem == problem
        write_lvm(broken, SIMULATED)
        assert (await read(shelf))["broken.lvm"].problem is None

    with_shelf(plan, use)


@pytest.mark.parametrize(
    "name",
    [
        "nope.lvm",
        "",
        ".",
        "..",
        "../outside.lvm",
        "/etc/passwd",
        "sub/inner.lvm",
        "out.lvm",
        "folder.lvm",
        "a\0.lvm",
        "x" * 5000 + ".lvm",
    ],
)
def test_a_name_never_leaves_the_folder(plan: ServicePlan, name: str) -> None:
    folder = plan.recordings_folder
    (folder / "sub").mkdir()
    write_lvm(folder / "sub" / "inner.lvm", SIMULATED)
    (folder / "folder.lvm").mkdir()
    (folder / "out.lvm").symlink_to(plan.data_folder / "outside.lvm")

    async def use(shelf: RecordingCatalog) -> None:
        assert await shelf.find_path("sound.lvm.gz") == folder / "sound.lvm.gz"
        assert [recording.name for recording in (await shelf.list_recordings()).recordings] == ["sound.lvm.gz"]
        with pytest.raises(RefusedError, match="There is no recording"):
            await shelf.find_path(name)

    with_shelf(plan, use)


def test_files_of_the_command_line_come_first_wherever_they_are_and_equal_names_are_numbered(
    plan: ServicePlan, tmp_path: Path
) -> None:
    paths = tmp_path / "outside.lvm", write_lvm(tmp_path / "sound.lvm.gz", SIMULATED), tmp_path / "day" / "outside.lvm"
    paths[-1].parent.mkdir()
    write_lvm(paths[-1], SIMULATED)

    async def use(shelf: RecordingCatalog) -> None:
        names = [recording.name for recording in (await shelf.list_recordings()).recordings]
        assert names == ["outside.lvm", "sound.lvm.gz", "outside (2).lvm"]
        assert [await shelf.find_path(name) for name in names] == [path.resolve() for path in paths]

    with_shelf(replace(plan, opened_recordings=paths), use)


def test_a_thousand_files_do_not_hold_the_service_up(plan: ServicePlan) -> None:
    for i in range(1000):
        os.link(plan.data_folder / "outside.lvm", plan.recordings_folder / f"{i}.lvm")

    async def use(shelf: RecordingCatalog) -> None:
        listing, turns = asyncio.create_task(shelf.list_recordings()), 0
        while not listing.done():
            await asyncio.sleep(0.0)
            turns += 1
        assert len(listing.result().recordings) == 1001
        assert turns > 3
        await shelf.find_path("999.lvm")

    with_shelf(plan, use)


# --- films -----------------------------------------------------------------------------------------------------------


def test_a_film_is_made_once_for_all_its_viewers_and_kept_for_a_while(
    plan: ServicePlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache_store, "MAX_CACHES", 1)
    path, other = plan.recordings_folder / "sound.lvm.gz", plan.data_folder / "outside.lvm"

    async def use() -> None:
        async with contextlib.aclosing(ReplayCacheStore(plan)) as kept:
            with kept.open_entry(path) as one, kept.open_entry(path) as two:
                assert one is two
                assert kept.viewers == 2
                film = await one.build_task
            with kept.open_entry(path) as three:
                assert await three.build_task is film
            with kept.open_entry(other) as another:
                await another.build_task
            with kept.open_entry(other) as again, kept.open_entry(path) as four:
                assert again is another
                assert not four.build_task.done()  # it had to give way
            os.utime(other, ns=(0, 0))
            with kept.open_entry(other) as changed:
                assert changed is not another
        assert kept.viewers == 0

    asyncio.run(use())
    assert not list(plan.data_folder.glob(".film-*"))


def test_a_film_of_what_is_gone_is_refused(plan: ServicePlan) -> None:
    async def use() -> None:
        with ReplayCacheStore(plan).open_entry(plan.recordings_folder / "gone.lvm"):
            pass

    with pytest.raises(RecordingError, match=r"^gone\.lvm: cannot be read \(No such file"):
        asyncio.run(use())


def test_what_a_killed_service_left_behind_is_removed(plan: ServicePlan) -> None:
    left, fresh = plan.data_folder / ".film-old", plan.data_folder / ".film-new"
    left.mkdir()
    fresh.mkdir()
    os.utime(left, (0, 0))
    ReplayCacheStore(plan)
    assert (left.exists(), fresh.exists()) == (False, True)


# --- processes --------------------------------------------------------------------------------------------------------


def say_who(tell: SendMessage, count: int) -> None:
    for _ in range(count):
        tell(os.getpid())


def say_how_nice(tell: SendMessage) -> None:
    tell(os.getpriority(os.PRIO_PROCESS, 0))


def fail(tell: SendMessage) -> None:
    tell(1)
    raise RecordingError("line 7 is at fault")


def fill_the_disk(tell: SendMessage) -> None:
    raise OSError(28, "No space left on device", "columns.npy")


def be_killed(tell: SendMessage) -> None:
    tell(1)
    os.kill(os.getpid(), signal.SIGKILL)


def sleep(tell: SendMessage) -> None:
    tell(os.getpid())
    time.sleep(60)


def test_work_aside_is_done_in_another_process_that_gives_way_and_then_ends() -> None:
    said: list[int] = []
    asyncio.run(run_in_background_process("aside", say_who, 3, on_message=said.append, advice="Try again."))
    assert len(said) == 3
    assert len({*said, os.getpid()}) == 2
    assert not os.path.exists(f"/proc/{said[0]}")
    asyncio.run(run_in_background_process("aside", say_how_nice, on_message=said.append, advice="Try again."))
    assert said[-1] == min(os.getpriority(os.PRIO_PROCESS, 0) + 10, 19)


@pytest.mark.parametrize(
    ("work", "error", "text"),
    [
        (fail, RecordingError, "line 7 is at fault"),
        (fill_the_disk, ServiceError, r"No space left on device \(columns\.npy\)"),
        (be_killed, ServiceError, r"'aside' died \(signal 9\)"),
    ],
)
def test_what_goes_wrong_aside_is_one_clear_error(
    work: Callable[[SendMessage], None], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        asyncio.run(run_in_background_process("aside", work, on_message=lambda _: None, advice="Try again."))


def test_work_that_nobody_waits_for_any_more_is_ended() -> None:
    async def give_up() -> int:
        said: asyncio.Queue[int] = asyncio.Queue()
        task = asyncio.create_task(
            run_in_background_process("aside", sleep, on_message=said.put_nowait, advice="Try again.")
        )
        pid = await said.get()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        return pid

    assert not os.path.exists(f"/proc/{asyncio.run(give_up())}")
