"""The function that reads one recorded run: samples, estimates, grasps, messages."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.recordings import mcap_layout
from acquisition.recordings.mcap_reader import JsonMessage, McapFile, RowBlock, concatenate_rows
from acquisition.sample_block import dtype_field_names
from app.messages.grasps import Grasp, GraspEnded
from app.messages.runs import Run
from app.recordings.mcap_writer import RecordingContext
from app.recordings.topics import GRASP_TOPIC, RUN_TOPIC, decode_message
from config.errors import RecordingError
from estimator.estimate_block import blank_estimates, estimate_dtype
from estimator.estimate_rows import estimate_columns, estimates_from_columns


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """A run's file in memory: `samples` of dtype SAMPLE_DTYPE, each with estimates and a time, `log_ns`."""

    path: Path
    metadata: dict[str, str]
    recording_context: RecordingContext
    samples: np.ndarray
    estimates: np.ndarray
    log_ns: np.ndarray
    run: Run | None
    grasps: tuple[Grasp, ...]

    @property
    def time_s(self) -> np.ndarray:
        """Time since the first sample, s, shape (n,)."""
        return (self.samples["tick"] - self.samples["tick"][0]) / self.recording_context.tool.board.sample_rate_hz


def read_run(path: Path) -> RecordedRun:
    """Read a run's recording file into memory.

    Raises:
        RecordingError: it is no recording of a run, or is damaged.
    """
    container = McapFile(path)
    context = RecordingContext.from_recording(container)
    rows: dict[str, list[RowBlock]] = {
        mcap_layout.RAW_TOPIC: [],
        mcap_layout.CONDITIONED_TOPIC: [],
        mcap_layout.ESTIMATES_TOPIC: [],
    }
    run: Run | None = None
    grasps: list[Grasp] = []
    try:
        for each in container.iter_content(*rows, GRASP_TOPIC, RUN_TOPIC):
            match each:
                case RowBlock():
                    rows[each.topic].append(each)
                case JsonMessage():
                    message = decode_message(each.topic, each.content)
                    if isinstance(message, GraspEnded) and message.run_id == container.metadata["run_id"]:
                        grasps.append(message.grasp)
                    elif isinstance(message, Run) and message.id == container.metadata["run_id"]:
                        run = message
        if not all(rows.values()):
            raise RecordingError(f"{path}: holds no samples; it was cut off before the first second.")
        raw, conditioned, estimated = (concatenate_rows(pieces) for pieces in rows.values())
        whole = min(len(raw), len(conditioned))  # a file that was cut off may have lost one before the other
        samples = mcap_layout.samples_from_columns(
            {name: values[:whole] for name, values in raw.columns.items()},
            {name: values[:whole] for name, values in conditioned.columns.items()},
        )
        estimates = _align_estimates(
            samples,
            estimates_from_columns(estimated.columns, list(context.library.tissues)),
            len(context.library.tissues),
        )
    except (KeyError, ValueError) as error:
        raise RecordingError(f"{path}: does not hold what a run's file holds ({error}).") from None
    return RecordedRun(path, container.metadata, context, samples, estimates, raw.log_ns[:whole], run, tuple(grasps))


def _align_estimates(samples: np.ndarray, estimates: np.ndarray, tissues: int) -> np.ndarray:
    """Return a row for each sample, blank where its estimates were lost."""
    if len(samples) == len(estimates) and (samples["tick"] == estimates["tick"]).all():
        return estimates
    rows = blank_estimates(estimate_dtype(tissues), samples["tick"])
    _, here, there = np.intersect1d(samples["tick"], estimates["tick"], return_indices=True)
    rows[here] = estimates[there]
    return rows


def build_run_columns(run: RecordedRun) -> dict[str, np.ndarray]:
    """Return all columns by name, each of shape (n,): time, signals, estimates; SI units, in the names."""
    columns: dict[str, np.ndarray] = {"time_s": run.time_s, "utc_ns": run.log_ns}
    columns |= {name: run.samples[name] for name in dtype_field_names(run.samples.dtype)}
    estimated = estimate_columns(run.estimates, list(run.recording_context.library.tissues))
    return columns | {name.replace(".", "_"): values for name, values in estimated.items() if name != "tick"}
