"""The class Annotations: what people say of the runs, the ground truth of each grasp and marks on the recording."""

import asyncio
from dataclasses import dataclass
from datetime import UTC, datetime

from app.host.clock import now_ms
from app.messages.annotations import NO_STATEMENT, GraspTruth, Mark, MarkRequest, TruthCorrection, TruthStatement
from app.messages.grasps import Grasp
from app.messages.journal import JournalKind
from app.service.publisher import Publisher
from app.service.runs import RunRegistry
from app.service.sample_monitor import SampleMonitor
from config.errors import ConfigurationError, RefusedError


@dataclass(frozen=True, slots=True)
class _Entry:
    """A statement at a sample; with None, a new spot or the end of the run, after which nothing is stated."""

    tick: int
    statement: TruthStatement | None


class Annotations:
    """The statements for the grasps of the run under way, and the changes of earlier ones.

    Each becomes a record in the journal, which recordings and the index receive. The estimator never does.
    """

    def __init__(
        self, publisher: Publisher, runs: RunRegistry, sample_monitor: SampleMonitor, sample_rate_hz: float
    ) -> None:
        self._publisher, self._runs, self._sample_monitor = publisher, runs, sample_monitor
        self._sample_rate_hz = sample_rate_hz
        self._entries: list[_Entry] = []
        self._last_end_tick = -1  # of a grasp
        self._marked: tuple[str, int] = "", 0  # run and number of the last mark
        self._last_run_id: str | None = None
        self._of_last_run: dict[str | int, GraspTruth | Mark] = {}  # by grasp and by mark
        self._changing = asyncio.Lock()  # a change is judged by the version before, which the index tells

    # --- ground truth ------------------------------------------------------------------------------------------------

    @property
    def statement(self) -> TruthStatement:
        """The statement for the grasp under way, or for the next one."""
        if not self._entries or (found := self._entries[-1].statement) is None:
            return NO_STATEMENT
        return self._without_used_remark(self._entries[-1].tick, found)

    def state_truth(self, statement: TruthStatement) -> None:
        """Take what the jaws hold from the grasp under way, or the next one, on."""
        self._entries.append(_Entry(self._sample_monitor.last_tick, statement))

    def on_new_spot(self) -> None:
        """State nothing for the grasps that begin from now on."""
        self._entries.append(_Entry(self._sample_monitor.last_tick, None))

    def on_run_end(self) -> None:
        """State nothing for the next run; a grasp that the run's end interrupts keeps its statement."""
        self.on_new_spot()

    def on_acquisition_restart(self) -> None:
        """Go on with the statement, although ticks count from zero again."""
        self._entries = [_Entry(-1, self.statement)]
        self._last_end_tick = -1

    def on_grasp_end(self, run_id: str | None, grasp: Grasp) -> None:
        """Publish the ground truth of a grasp, if any was stated for it."""
        start, end = round(grasp.start_s * self._sample_rate_hz), round(grasp.end_s * self._sample_rate_hz)
        stated = self._find_statement(start, end)
        self._last_end_tick = end
        self._drop_used_entries(end)
        if run_id and (stated.held or stated.remark or stated.place):
            self._publish_truth(
                GraspTruth(
                    run_id=run_id,
                    grasp=grasp.index,
                    held=stated.held,
                    remark=stated.remark,
                    place=stated.place,
                    version=1,
                    by=stated.by,
                    at=_now_iso(),
                    why=None,
                )
            )

    def _drop_used_entries(self, end_tick: int) -> None:
        """Drop what no later grasp needs: everything before the last entry up to the end of this one."""
        before = [i for i, entry in enumerate(self._entries) if entry.tick <= end_tick]
        del self._entries[: max(len(before) - 1, 0)]

    def _find_statement(self, start_tick: int, end_tick: int) -> TruthStatement:
        """Return the last statement before the end of a grasp, but none of a spot or run that began during it."""
        found = NO_STATEMENT
        for entry in self._entries:
            if entry.statement is None and entry.tick > start_tick:
                break
            if entry.tick <= end_tick:
                found = self._without_used_remark(entry.tick, entry.statement or NO_STATEMENT)
        return found

    def _without_used_remark(self, tick: int, statement: TruthStatement) -> TruthStatement:
        """Leave the remark out if a grasp has ended since: it was for that one alone."""
        return statement if tick >= self._last_end_tick else statement.model_copy(update={"remark": None})

    async def list_truths(self, run_id: str) -> list[GraspTruth]:
        """Return the stated ground truth of a run's grasps, in order.

        Raises:
            ServiceError: the index is at fault.
        """
        return await self._publisher.index_writer.query(self._publisher.index_writer.store.list_run_truths, run_id)

    async def correct(self, run_id: str, grasp: int, wanted: TruthCorrection, by: str | None) -> GraspTruth:
        """State or correct the ground truth of a finished grasp.

        Raises:
            RefusedError: somebody has changed it meanwhile.
            ConfigurationError: an earlier statement would change without a reason.
            ServiceError: the index is at fault.
        """
        async with self._changing:
            before = next((each for each in await self.list_truths(run_id) if each.grasp == grasp), None)
            _check_version(before, wanted.version)
            if before and wanted.why is None:
                raise ConfigurationError("The grasp has a statement already. Say why it is changed (`why`).")
            truth = GraspTruth(
                run_id=run_id,
                grasp=grasp,
                held=wanted.held,
                remark=wanted.remark,
                place=wanted.place,
                version=wanted.version + 1,
                by=by,
                at=_now_iso(),
                why=wanted.why,
            )
            self._publish_truth(truth)
            return truth

    def _publish_truth(self, truth: GraspTruth) -> None:
        self._publisher.journal.write(JournalKind.TRUTH, truth.describe(), by=truth.by, truth=truth)
        self._keep(truth.grasp, truth)

    # --- marks -------------------------------------------------------------------------------------------------------

    def add_mark(self, wanted: MarkRequest, by: str | None) -> Mark:
        """Set a mark on the run under way.

        Raises:
            RefusedError: no run is under way.
            ConfigurationError: the run has no such sample.
        """
        run = self._runs.current
        if run is None:
            raise RefusedError("No run is under way. A mark belongs to a running recording.")
        newest = self._sample_monitor.last_tick
        tick = newest if wanted.tick is None else wanted.tick
        if not self._runs.get_start_tick(run.id) <= tick <= newest:
            raise ConfigurationError(f"The run has no sample {tick}. Leave `tick` out to mark the newest one.")
        before, number = self._marked
        self._marked = run.id, number + 1 if before == run.id else 1
        at_ms = self._sample_monitor.compute_time_ms(tick)
        mark = Mark(
            id=f"{run.id}-mark{self._marked[1]}",
            run_id=run.id,
            at_s=tick / self._sample_rate_hz,
            at_ms=at_ms,
            uncertainty_s=max(now_ms() - at_ms, 0.0) / 1e3,
            text=wanted.text,
            version=1,
            by=by,
            changed_at=_now_iso(),
        )
        self._publish_mark(f"Mark at {mark.at_s:.3f} s: {mark.text}", mark)
        return mark

    async def list_marks(self, run_id: str) -> list[Mark]:
        """Return the marks of a run by their time.

        Raises:
            ServiceError: the index is at fault.
        """
        return await self._publisher.index_writer.query(self._publisher.index_writer.store.list_run_marks, run_id)

    async def change_mark(self, mark_id: str, version: int, text: str | None, by: str | None) -> Mark | None:
        """Change the text of a mark, or delete it if `text` is None; return it, or None if there is none of this id.

        Raises:
            RefusedError: somebody has changed it meanwhile.
            ServiceError: the index is at fault.
        """
        async with self._changing:
            writer = self._publisher.index_writer
            before = await writer.query(writer.store.get_mark, mark_id)
            if before is None or before.deleted:
                return None
            _check_version(before, version)
            changes = {"deleted": True} if text is None else {"text": text}
            mark = before.model_copy(
                update={**changes, "version": version + 1, "by": by, "changed_at": _now_iso(), "number": None}
            )
            what = "Deleted" if mark.deleted else "Changed"
            self._publish_mark(f"{what} mark at {mark.at_s:.3f} s of run {mark.run_id}: {mark.text}", mark)
            return mark

    def _publish_mark(self, text: str, mark: Mark) -> None:
        self._publisher.journal.write(JournalKind.MARK, text, by=mark.by, mark=mark)
        self._keep(mark.id, mark)

    # --- for viewers -------------------------------------------------------------------------------------------------

    def of_run(self, run_id: str) -> list[GraspTruth | Mark]:
        """Return the newest statements and marks of the run that was annotated last, if it is this one."""
        return list(self._of_last_run.values()) if run_id == self._last_run_id else []

    def _keep(self, key: str | int, annotation: GraspTruth | Mark) -> None:
        """Send an annotation to the viewers, and keep it for later ones if it belongs to the newest run."""
        run = self._runs.last
        if run and run.id == annotation.run_id:
            if run.id != self._last_run_id:
                self._last_run_id, self._of_last_run = run.id, {}
            self._of_last_run[key] = annotation
        self._publisher.viewer_hub.broadcast(annotation)


def _check_version(before: GraspTruth | Mark | None, version: int) -> None:
    """Check that a change is made to the newest version.

    Raises:
        RefusedError: somebody has changed it meanwhile.
    """
    newest = before.version if before else 0
    if version != newest:
        who = (before and before.by) or "Somebody"
        raise RefusedError(f"{who} has changed this meanwhile: it is at version {newest}. Look at it, then try again.")


def _now_iso() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
