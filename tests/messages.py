"""Wire messages for the index's tests."""

from datetime import UTC, datetime, timedelta
from typing import Any

from app.messages.alarms import Alarm, AlarmKind
from app.messages.annotations import GraspTruth, Mark
from app.messages.grasps import Grasp, GraspEnded
from app.messages.journal import JournalEntry, JournalKind
from app.messages.recordings import FileCondition, FileRecord
from app.messages.runs import Run, RunState
from estimator.force_alarms import Priority

BEGIN = datetime(2026, 11, 1, 8, tzinfo=UTC)


def at(second: float) -> str:
    return (BEGIN + timedelta(seconds=second)).isoformat()


def run(number: int = 1, **facts: Any) -> Run:
    """Return run `number`, which begins `number` minutes after `BEGIN` and is over unless `state` is running."""
    state = facts.setdefault("state", RunState.RUNNING)
    over = state is not RunState.RUNNING
    started = 60.0 * number
    return Run.model_validate(
        {
            "id": f"run-{number:03d}",
            "protocol": "sine",
            "cycles": 3,
            "tissue": "liver",
            "by": "Ada",
            "started_at": at(started),
            "ended_at": at(started + 30) if over else None,
            "why": "done" if over else None,
            "grasps": 0,
            **facts,
        }
    )


def grasp(run_number: int = 1, index: int = 1, **facts: Any) -> GraspEnded:
    content = {
        "index": index,
        "start_s": index * 1.0,
        "contact_s": None,
        "end_s": index + 0.5,
        "label": "liver",
        "probability": 0.97,
        "probabilities": {"liver": 0.97},
        "time_to_decision_s": 0.1,
        "alpha_n": 0.02,
        "beta_per_m": 900.0,
        "damping_kg_per_s": 1.5,
        "peak_force_n": 1.5,
        "peak_displacement_m": 0.004,
        "convergence_s": {},
        "force_error_n": {},
        "valid": True,
        "why_invalid": None,
        "alarms": [],
        "held_back": False,
        **facts,
    }
    return GraspEnded(run_id=f"run-{run_number:03d}", grasp=Grasp.model_validate(content))


def alarm(change: int = 1, **facts: Any) -> Alarm:
    return Alarm.model_validate(
        {
            "id": "force-1",
            "kind": AlarmKind.FORCE,
            "priority": Priority.LOW,
            "active": True,
            "latched": False,
            "text": "Force near the injury threshold",
            "value": 1.0,
            "limit": 2.0,
            "unit": "N",
            "began_ms": BEGIN.timestamp() * 1e3 + 61_000,
            "ended_ms": None,
            "acknowledged_by": None,
            "change": change,
            **facts,
        }
    )


def truth(grasp_index: int = 1, version: int = 1, **facts: Any) -> GraspTruth:
    known = {"held": "liver", "remark": None, "by": "Ada", "at": at(1.0), "why": None}
    return GraspTruth(run_id=run().id, grasp=grasp_index, version=version, **known | facts)


def mark(version: int = 1, **facts: Any) -> Mark:
    known = {"text": "smoke", "by": "Ada", "changed_at": at(1.0), "at_s": 1.5, "at_ms": 1.5e12, "uncertainty_s": 0.02}
    return Mark(id=f"{run().id}-mark1", run_id=run().id, version=version, **known | facts)


def line(second: float = 0.0, text: str = "The tool is acquiring", **facts: Any) -> JournalEntry:
    return JournalEntry.model_validate({"at": at(second), "kind": JournalKind.EVENT, "text": text, **facts})


def record(number: int = 1, **facts: Any) -> FileRecord:
    return FileRecord.model_validate(
        {
            "name": f"run-{number:03d}.rec",
            "run_id": f"run-{number:03d}",
            "size_bytes": 1000 * number,
            "made_at": at(60.0 * number),
            "duration_s": 30.0,
            "samples": 30_000,
            "lost_samples": 0,
            "format_version": "1",
            "condition": FileCondition.COMPLETE,
            "problem": None,
            **facts,
        }
    )
