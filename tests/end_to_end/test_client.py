"""The Python client against a real service: what a program sees, and what it is told when something is wrong."""

import asyncio
import ssl
from collections.abc import AsyncGenerator, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest
from certificates import self_signed
from proxy import Line
from service import Service

from app.messages.alarms import Alarm
from app.messages.grasps import GraspEnded, Identification
from app.messages.live import EventMessage, Hello, State
from app.messages.people import Role
from app.messages.runs import RunState
from app.people import tokens
from graspwatch import ConnectionLostError, Frame, Graspwatch, RefusedError, UnreachableError

Returned = TypeVar("Returned")


def run(program: Coroutine[Any, Any, Returned]) -> Returned:
    """In a thread, as another test's browser may keep a loop in this one."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, program).result()


@pytest.fixture(scope="module")
def service():
    with Service("serve") as running:
        yield running


def test_a_program_starts_a_run_watches_it_and_reads_its_grasps(service: Service) -> None:
    async def program() -> tuple[list[Identification], list[str]]:
        seen = []
        async with Graspwatch(service.url, by="Ada") as tool:
            run = await tool.start("trapezoid_2hz", cycles=3, tissue="bladder")
            assert (run.state, run.by, run.tissue) == (RunState.RUNNING, "Ada", "bladder")
            async for estimate in tool.live():
                seen.append(estimate)
                if estimate.grasp >= 2 and estimate.label == "bladder":
                    break
            ended = await tool.finished(run, timeout_s=30)
            assert ended.state is RunState.FINISHED
            return seen, [grasp.label for grasp in await tool.grasps(ended)]

    seen, labels = run(program())
    assert {each.in_contact for each in seen} == {True, False}
    assert len(labels) == 3
    assert "bladder" in labels


def test_a_program_says_whom_it_examines_what_it_holds_and_what_happens(service: Service) -> None:
    async def program() -> None:
        async with Graspwatch(service.url, by="Ada") as tool:
            session = await tool.begin_session("P-12", "ex vivo", species="pig")
            assert (await tool.state_truth("spleen")).held == "spleen"
            started = await tool.start("trapezoid_4hz", cycles=2, tissue="liver")
            mark = await tool.mark("irrigation on")
            ended = await tool.finished(started, timeout_s=30)
            assert (ended.session, mark.run_id) == (session.id, ended.id)
            while len(stated := await tool.truth(ended)) < 2:
                await asyncio.sleep(0.05)
            assert [(each.grasp, each.held, each.by) for each in stated] == [(1, "spleen", "Ada"), (2, "spleen", "Ada")]
            corrected = await tool.correct_truth(ended, 2, "liver", version=1, why="seen on the video")
            assert (corrected.held, corrected.version) == ("liver", 2)
            assert [each.text for each in await tool.marks(ended)] == ["irrigation on"]
            assert (await tool.end_session()).ended_at
            assert [each.subject for each in await tool.sessions(subject="P-12")] == ["P-12"]

    run(program())


def test_every_sample_arrives_and_a_channel_is_found_by_name_and_tissue(service: Service) -> None:
    async def program() -> tuple[Hello, list[Frame]]:
        frames: list[Frame] = []
        async with Graspwatch(service.url) as tool, tool.running("trapezoid_4hz", cycles=2, tissue="liver"):
            async for message in tool.messages():
                if isinstance(message, Hello):
                    hello = message
                if isinstance(message, Frame):
                    frames.append(message)
                if frames and np.nanmax(frames[-1]["jaw_force_n"]) > 0.5:  # the run has been reached
                    return hello, frames
        raise AssertionError("the stream ended")

    hello, frames = run(program())
    ticks = np.concatenate([frame.ticks for frame in frames])
    assert (np.diff(ticks) == 1).all()
    column = [(each.name, each.tissue) for each in hello.channels].index(("probability", "liver"))
    assert np.array_equal(frames[0]["probability", "liver"], frames[0].columns[column], equal_nan=True)
    with pytest.raises(KeyError):
        frames[0]["probability", "moon"]


def test_a_run_does_not_outlive_its_block(service: Service) -> None:
    class Unforeseen(Exception):
        pass

    async def program() -> None:
        async with Graspwatch(service.url) as tool:
            with pytest.raises(Unforeseen):
                async with tool.running("trapezoid_025hz", cycles=5, tissue="liver") as run:
                    raise Unforeseen
            assert (await tool.run(run.id)).state is RunState.STOPPED
            async with tool.running("trapezoid_4hz", cycles=1, tissue="liver") as run:
                assert (await tool.finished(run, 20)).state is RunState.FINISHED
            assert (await tool.run(run.id)).state is RunState.FINISHED

    run(program())


def test_a_refusal_says_what_is_wrong_and_which_field(service: Service) -> None:
    async def program() -> None:
        async with Graspwatch(service.url) as tool:
            with pytest.raises(RefusedError, match=r"There is no tissue 'livver'. Did you mean 'liver'") as refused:
                await tool.start("trapezoid_2hz", tissue="livver")
            assert refused.value.status == 422
            assert set(refused.value.fields) == {"tissue"}
            with pytest.raises(RefusedError, match="There is no run 'none'") as refused:
                await tool.run("none")
            assert refused.value.status == 404

    run(program())


def test_a_start_with_a_key_is_carried_out_once(service: Service) -> None:
    async def program() -> tuple[str, str]:
        async with Graspwatch(service.url) as tool:
            runs = [await tool.start("trapezoid_025hz", tissue="liver", idempotency_key="one") for _ in range(2)]
            await tool.stop()
            return runs[0].id, runs[1].id

    first, second = run(program())
    assert first == second


def test_a_program_that_lost_the_stream_goes_on_where_it_was(service: Service) -> None:
    async def events(tool: Graspwatch, after: int | None, last: str) -> AsyncGenerator[int, None]:
        """Yield the numbers of events up to one whose text begins with `last`, without those from before."""
        in_step = after is not None
        async for message in tool.messages(frames=False, after=after):
            if isinstance(message, Hello):
                assert message.resumed is (None if after is None else True)
            if isinstance(message, State) and message.event_number:
                in_step = True
            if isinstance(message, EventMessage | GraspEnded | Alarm) and message.number and in_step:
                yield message.number
                if isinstance(message, EventMessage) and message.text.startswith(last):
                    return

    async def program(line: Line) -> list[int]:
        seen: list[int] = []
        async with Graspwatch(line.url) as tool, Graspwatch(service.url) as other:
            watching = events(tool, None, "no such event")
            start = asyncio.create_task(other.start("trapezoid_4hz", cycles=1, tissue="liver"))
            seen.append(await anext(watching))
            line.cut()
            with pytest.raises(ConnectionLostError) as lost:
                async for number in watching:
                    seen.append(number)  # noqa: PERF401  a comprehension would lose them
            assert lost.value.last_event == seen[-1]
            await other.finished(await start, 20)
            line.mend()
            seen.extend([number async for number in events(tool, lost.value.last_event, "Run finished")])
        return seen

    with Line(service.port) as line:
        seen = run(program(line))
    assert seen == list(range(seen[0], seen[0] + len(seen)))
    assert len(seen) > 3


def test_a_recording_is_saved_once_and_never_over_another(service: Service, tmp_path: Path) -> None:
    async def program() -> None:
        async with Graspwatch(service.url) as tool:
            run = await tool.finished(await tool.start("trapezoid_4hz", cycles=1, tissue="liver"), 20)
            while f"{run.id}.mcap" not in {each.name for each in (await tool.recordings()).recordings if each.whole}:
                await asyncio.sleep(0.1)
            path = await tool.download(f"{run.id}.mcap", tmp_path)
            assert path.read_bytes() == (service.data / "recordings" / path.name).read_bytes()
            with pytest.raises(FileExistsError):
                await tool.download(path.name, tmp_path)
            with pytest.raises(RefusedError, match=r"none\.mcap"):
                await tool.download("none.mcap", tmp_path)
            assert [each.name for each in tmp_path.iterdir()] == [path.name]

    run(program())


def test_nobody_at_the_address_is_told() -> None:
    async def program() -> None:
        async with Graspwatch("http://127.0.0.1:9") as tool:
            with pytest.raises(UnreachableError, match=r"Nobody answers at http://127\.0\.0\.1:9"):
                await tool.health()
            with pytest.raises(UnreachableError, match="Nobody answers"):
                async for _ in tool.live():
                    pass

    run(program())


def test_the_end_of_the_service_ends_the_stream_with_an_error() -> None:
    async def program(running: Service) -> None:
        async with Graspwatch(running.url) as tool:
            with pytest.raises(ConnectionLostError):
                async for message in tool.messages():
                    if isinstance(message, Hello):
                        await asyncio.to_thread(running.end)

    with Service("serve") as running:
        run(program(running))


def test_with_tokens_and_tls_a_program_is_somebody(tmp_path: Path) -> None:
    cert, key = self_signed(tmp_path / "tls")
    trust = ssl.create_default_context(cafile=cert)
    viewer = tokens.add_token(tmp_path, "Ward", Role.VIEWER, None)

    async def program(running: Service) -> None:
        url = f"https://localhost:{running.port}"
        async with Graspwatch(url, token=viewer, trust=trust) as tool:
            session = await tool.session()
            assert (session.name, session.role) == ("Ward", Role.VIEWER)
            with pytest.raises(RefusedError) as refused:
                await tool.start("trapezoid_2hz", tissue="liver")
            assert refused.value.status == 403
            assert isinstance(await anext(tool.messages()), Hello)
            assert not (await tool.stop()).stopped
        async with Graspwatch(url, trust=trust) as stranger:
            with pytest.raises(RefusedError) as refused:
                await anext(stranger.messages())
            assert refused.value.status == 401
        async with Graspwatch(url, token=viewer) as distrustful:
            with pytest.raises(UnreachableError, match="certificate"):
                await distrustful.health()

    with Service("serve", "--tls-cert", str(cert), "--tls-key", str(key), data=tmp_path, trust=trust) as running:
        run(program(running))


def test_a_new_spot_begins_by_request_and_is_refused_without_a_run(service: Service) -> None:
    async def program() -> tuple[str, Identification]:
        async with Graspwatch(service.url) as tool:
            with pytest.raises(RefusedError) as refused:
                await tool.begin_spot()
            async with tool.running("trapezoid_4hz", cycles=4, tissue="bladder"):
                async for answer in tool.live():
                    if answer.grasp == 2 and answer.in_grasp and len(answer.spots) == 1:
                        await tool.begin_spot()
                    if len(answer.spots) > 1 and answer.spots[-1].grasps:
                        return str(refused.value), answer
        raise AssertionError("the stream ended")

    why, answer = run(program())
    assert "Each run begins a new spot" in why
    first, second = answer.spots
    assert (first.grasps, second.grasps) == ((1, 2), (3,))  # the grasp under way belonged to the spot before
