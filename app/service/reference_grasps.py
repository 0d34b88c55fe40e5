"""The day's reference grasp: measured after its run, kept in the data folder, and announced with later runs."""

import asyncio
from datetime import UTC, datetime

import numpy as np

from acquisition.recordings.file_names import is_reference_run
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock
from app.host.background_process import SendMessage, run_in_background_process
from app.messages.journal import JournalKind
from app.messages.live import ReferenceState
from app.messages.runs import Run, RunState
from app.service.publisher import Publisher
from config.atomic_write import write_atomically
from config.errors import GraspwatchError
from config.schema import ReferenceGrasp, Tool, is_same_day
from config.service_plan import ServicePlan

RETRY_ADVICE = "Take the reference grasp again."


class ReferenceGrasps:
    """The newest reference grasp of the tool, in a file of the folder `references`. It is valid on its own day."""

    def __init__(self, plan: ServicePlan, publisher: Publisher) -> None:
        self._plan, self._publisher = plan, publisher
        self._samples: list[np.ndarray] = []  # of the reference run under way
        self._declined_at: datetime | None = None
        self._problem: str | None = None
        self._measuring: set[asyncio.Task[None]] = set()
        self._newest = self._read()

    def _read(self) -> ReferenceGrasp | None:
        path = self._plan.references_folder / f"{self._plan.tool.name}.json"
        try:
            return ReferenceGrasp.model_validate_json(path.read_bytes(), extra="ignore")
        except FileNotFoundError:
            return None
        except (OSError, ValueError):
            self._problem = f"The reference grasp in {path} cannot be read. {RETRY_ADVICE}"
            return None

    def find_valid(self) -> ReferenceGrasp | None:
        """Return the reference grasp of this day and of the tool as it is calibrated now; None without one."""
        newest = self._newest
        return newest if newest and newest.belongs_to(self._plan.tool, datetime.now(UTC)) else None

    def build_state(self) -> ReferenceState:
        """Build the part of the state that describes the day's reference grasp."""
        valid, plan = self.find_valid(), self._plan
        declined = is_same_day(self._declined_at, datetime.now(UTC))
        is_needed = plan.tool.has_real_motor and plan.library.learned is not None
        return ReferenceState(
            taken_at=valid.taken_at.isoformat(timespec="seconds") if valid else None,
            stall_v=valid.stall_v if valid else None,
            declined=declined,
            wanted=is_needed and valid is None and not declined and not self._measuring,
            problem=self._problem,
        )

    def decline(self, by: str | None) -> None:
        """Go on without a reference grasp for this day."""
        self._declined_at = datetime.now(UTC)
        self._publisher.publish_event("No reference grasp today: the stall counts less", JournalKind.RUN, by)

    def on_block(self, block: SampleBlock) -> None:
        """Keep the samples of a reference run."""
        if is_reference_run(block.run):
            self._samples.append(block.samples)

    def on_run_end(self, run: Run) -> None:
        """Measure a reference run that has finished; another end of it gives no reference."""
        if not is_reference_run(run.id):
            return
        samples, self._samples = np.concatenate([np.zeros(0, SAMPLE_DTYPE), *self._samples], dtype=SAMPLE_DTYPE), []
        if run.state is not RunState.FINISHED:
            self._problem = f"The reference grasp was {run.state.value} ({run.why}). {RETRY_ADVICE}"
            return
        measuring = asyncio.create_task(self._measure(samples, run))
        self._measuring.add(measuring)
        measuring.add_done_callback(self._measuring.discard)

    async def _measure(self, samples: np.ndarray, run: Run) -> None:
        tool, taken_at = self._plan.tool, datetime.fromisoformat(run.started_at)
        found: list[ReferenceGrasp] = []
        wanted = samples, tool, taken_at, run.by
        try:
            await run_in_background_process(
                "reference", measure_and_send_reference, *wanted, on_message=found.append, advice=RETRY_ADVICE
            )
            await asyncio.to_thread(self._write, found[0])
        except GraspwatchError as error:
            self._problem = str(error)
            self._publisher.publish_event(f"No reference grasp: {error}", JournalKind.RUN, run.by, run)
        except OSError as error:
            folder = self._plan.references_folder
            self._problem = f"The reference grasp cannot be written to {folder} ({error.strerror}). {RETRY_ADVICE}"
            self._publisher.publish_event(self._problem, JournalKind.RUN, run.by, run)
        else:
            self._newest, self._problem = found[0], None
            self._publisher.publish_event(f"Reference grasp taken: {found[0]}", JournalKind.RUN, run.by, run)

    def _write(self, reference: ReferenceGrasp) -> None:
        folder = self._plan.references_folder
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / f"{reference.tool}.json", reference.model_dump_json(indent=2) + "\n")

    async def aclose(self) -> None:
        """End a measurement that is under way."""
        for measuring in self._measuring:
            measuring.cancel()
        await asyncio.gather(*self._measuring, return_exceptions=True)


# --- in the background process ------------------------------------------------------------------------------------


def measure_and_send_reference(
    send: SendMessage, samples: np.ndarray, tool: Tool, taken_at: datetime, person: str | None
) -> None:
    """Measure the reference grasp and send it.

    Raises:
        CalibrationError: it is none; the text says why.
    """
    from estimator.learning.reference_measurement import measure_reference  # modules that the server does not need

    send(measure_reference(samples, tool, taken_at, person))
