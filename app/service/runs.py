"""The class RunRegistry: the run under way, earlier runs, the grasps of each, and the demonstration they belong to."""

import secrets
from dataclasses import dataclass, field
from datetime import UTC, datetime

from app.messages.grasps import Grasp
from app.messages.runs import Run, RunState
from config.errors import RefusedError
from config.schema import ToolKind
from config.service_plan import ServicePlan

MAX_RUNS = 1_000


class RunUnderWayError(RefusedError):
    """A start is refused because `run` is under way."""

    def __init__(self, run: Run) -> None:
        by = f", started by {run.by}" if run.by else ""
        super().__init__(f"A run is under way: {run.protocol}{by} (run {run.id}). Stop it first, or wait for its end.")
        self.run = run


@dataclass(slots=True)
class _RunEntry:
    run: Run
    start_tick: int
    tick_epoch: int
    grasps: list[Grasp] = field(default_factory=list)


class RunRegistry:
    """The last runs of this service, oldest first."""

    def __init__(self, plan: ServicePlan) -> None:
        self.demo_text: str | None = (
            "The demonstration begins as soon as the tool is ready" if plan.demo_enabled else None
        )
        self.simulated_tissue = plan.simulated_tissue if plan.tool.kind is ToolKind.SIMULATED else None
        self._entries: dict[str, _RunEntry] = {}
        self._run_count = 0
        self._service_id = secrets.token_hex(2)  # two services that share an index may start a run in the same second
        self._tick_epoch = 0
        self.current_id: str | None = None

    @property
    def current(self) -> Run | None:
        return self._entries[self.current_id].run if self.current_id else None

    @property
    def last(self) -> Run | None:
        return next((entry.run for entry in reversed(self._entries.values())), None)

    def list_runs(self) -> list[Run]:
        return [entry.run for entry in self._entries.values()]

    def get(self, run_id: str) -> Run | None:
        entry = self._entries.get(run_id)
        return entry.run if entry else None

    def get_start_tick(self, run_id: str) -> int:
        """Return the sample at or after which a run's samples begin."""
        return self._entries[run_id].start_tick

    def list_grasps(self, run_id: str) -> list[Grasp]:
        return self._entries[run_id].grasps

    def begin(
        self,
        protocol: str,
        cycles: int,
        tissue: str | None,
        by: str | None,
        start_tick: int,
        prefix: str = "",
        session: str | None = None,
    ) -> Run:
        """Register a new run and return it. Its grasps begin at `start_tick` or later; its id begins with `prefix`."""
        self._run_count += 1
        now = datetime.now(UTC)
        run = Run(
            id=f"{prefix}{now:%Y%m%d-%H%M%S}-{self._service_id}-{self._run_count:03d}",
            protocol=protocol,
            cycles=cycles,
            tissue=tissue,
            by=by,
            state=RunState.RUNNING,
            started_at=now.isoformat(),
            ended_at=None,
            why=None,
            grasps=0,
            session=session,
        )
        self._entries[run.id] = _RunEntry(run, start_tick, self._tick_epoch)
        self.current_id = run.id
        while len(self._entries) > MAX_RUNS:
            del self._entries[next(iter(self._entries))]
        return run

    def discard(self, run_id: str) -> None:
        """Remove a run that the acquisition did not start."""
        self._entries.pop(run_id, None)
        if self.current_id == run_id:
            self.current_id = None

    def end(self, run_id: str, state: RunState, why: str) -> bool:
        """Mark a run as ended in `state`; return False if it is not the one under way."""
        if run_id != self.current_id:
            return False
        entry = self._entries[run_id]
        entry.run = entry.run.model_copy(update={"state": state, "why": why, "ended_at": datetime.now(UTC).isoformat()})
        self.current_id = None
        return True

    def add_grasp(self, grasp: Grasp, start_tick: int) -> tuple[str | None, Grasp]:
        """Add a finished grasp to the run in which it began; return the run's id, if any, and the renumbered grasp."""
        for run_id, entry in reversed(self._entries.items()):
            if entry.tick_epoch == self._tick_epoch and entry.start_tick <= start_tick:
                grasp = grasp.model_copy(update={"index": len(entry.grasps) + 1})
                entry.grasps.append(grasp)
                entry.run = entry.run.model_copy(update={"grasps": len(entry.grasps)})
                return run_id, grasp
        return None, grasp

    def reset_ticks(self) -> None:
        """Note that the acquisition was restarted, and its ticks count from zero again."""
        self._tick_epoch += 1
