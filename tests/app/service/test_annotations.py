"""Which statement belongs to which grasp, whatever the order of statements, spots and grasps."""

from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st
from reports import record

from app.messages.annotations import NO_STATEMENT, GraspRemark, TruthStatement
from app.messages.grasps import Grasp
from app.service.annotations import Annotations

RATE_HZ = 1000.0


def annotations() -> tuple[Annotations, SimpleNamespace, list]:
    told: list = []
    samples = SimpleNamespace(last_tick=-1)
    publisher = SimpleNamespace(
        journal=SimpleNamespace(write=lambda kind, text, by, truth: told.append((truth.held, truth.remark))),
        viewer_hub=SimpleNamespace(broadcast=lambda message: None),
    )
    return Annotations(publisher, SimpleNamespace(last=None), samples, RATE_HZ), samples, told


def ended(index: int, start: int, end: int) -> Grasp:
    return Grasp.from_record(record(index=index, start_s=start / RATE_HZ, end_s=end / RATE_HZ), [])


@given(st.lists(st.sampled_from(["liver", "spleen", "slipped", "spot", "grasp", "pause"]), max_size=40))
def test_a_grasp_has_the_last_statement_before_its_end_and_none_of_another_spot(steps: list[str]) -> None:
    kept, samples, told = annotations()
    held, remark, wanted, grasps = None, None, [], 0
    for at, step in enumerate(steps):
        samples.last_tick = 100 * at
        if step in ("liver", "spleen"):
            kept.state_truth(TruthStatement(held=step, remark=None, by="Ada"))
            held, remark = step, None
        elif step == "slipped":
            kept.state_truth(TruthStatement(held=held, remark=GraspRemark.SLIPPED, by="Ada"))
            remark = GraspRemark.SLIPPED
        elif step == "spot":
            kept.on_new_spot()
            held = remark = None
        elif step == "grasp":
            grasps += 1
            kept.on_grasp_end("run", ended(grasps, 100 * at + 10, 100 * at + 90))
            if held or remark:
                wanted.append((held, remark))
            remark = None
    assert told == wanted
    now = kept.statement
    assert (now.held, now.remark) == (held, remark)


def test_a_spot_that_begins_during_a_grasp_leaves_that_grasp_its_statement() -> None:
    kept, samples, told = annotations()
    kept.state_truth(TruthStatement(held="liver", remark=None, by="Ada"))
    samples.last_tick = 500
    kept.on_new_spot()
    samples.last_tick = 600
    kept.state_truth(TruthStatement(held="spleen", remark=None, by="Ada"))
    kept.on_grasp_end("run", ended(1, 400, 700))
    kept.on_grasp_end("run", ended(2, 800, 900))
    assert told == [("liver", None), ("spleen", None)]


def test_a_restart_of_the_acquisition_keeps_the_statement() -> None:
    kept, samples, told = annotations()
    samples.last_tick = 100_000
    kept.state_truth(TruthStatement(held="liver", remark=None, by="Ada"))
    kept.on_acquisition_restart()
    samples.last_tick = 10
    kept.on_grasp_end("run", ended(1, 2, 9))
    assert told == [("liver", None)]
    assert annotations()[0].statement == NO_STATEMENT
