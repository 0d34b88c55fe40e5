"""The class Worker, and the function that builds a service's workers: what each is started with, and its condition."""

import os
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from acquisition import worker as acquisition_worker
from acquisition.bus import Endpoints
from acquisition.safety import safety_monitor
from acquisition.worker_process import ProcessSnapshot
from app.recordings import recorder_worker
from app.recordings.mcap_writer import RecordingContext
from config.service_plan import ServicePlan
from estimator import worker as estimator_worker

MAX_RESTARTS_PER_MINUTE = 3
DISPLAY_NAMES = {"guard": "safety monitor"}  # "guard" is its key in the REST interface and the metrics
START_ORDER = ("recorder", "guard", "estimator", "acquisition", "foxglove")


class WorkerCondition(StrEnum):
    """The condition of a worker."""

    STARTING = "starting"
    RUNNING = "running"
    FAULTED = "faulted"


def display_worker_name(name: str) -> str:
    """Return the name of a worker in messages to people."""
    return DISPLAY_NAMES.get(name, name)


@dataclass(slots=True)
class Worker:
    """One worker process: its key, what it is started with, and its present state."""

    name: str
    main: Callable[[Any], None]
    setup: Any
    process: BaseProcess | None = None
    condition: WorkerCondition = WorkerCondition.STARTING
    has_run: bool = False
    hung_process: BaseProcess | None = None
    replaced_process: BaseProcess | None = None  # ended on purpose; its death is no fault
    activity: ProcessSnapshot | None = None
    death_times_s: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_RESTARTS_PER_MINUTE + 1))


def build_workers(plan: ServicePlan, endpoints: Endpoints, tool_may_open: Connection) -> dict[str, Worker]:
    """Return the workers that a plan needs, by name; none is started yet."""
    acquisition = acquisition_worker.AcquisitionSetup(
        os.getpid(),
        endpoints,
        plan.tool,
        plan.library,
        plan.settings.conditioning,
        plan.simulated_tissue,
        plan.seed,
        plan.settings.limiter,
        plan.settings.realtime,
        tool_may_open,
        plan.settings.safety.server_silence_s,
    )
    estimator = estimator_worker.EstimatorSetup(os.getpid(), endpoints, plan.tool, plan.library, plan.settings)
    context = RecordingContext(plan.tool, plan.library, plan.settings)
    recorder = recorder_worker.RecorderSetup(
        os.getpid(), endpoints, plan.recordings_folder, context, plan.settings.realtime.priority
    )
    workers = {
        "acquisition": Worker("acquisition", acquisition_worker.main, acquisition),
        "estimator": Worker("estimator", estimator_worker.main, estimator),
        "recorder": Worker("recorder", recorder_worker.main, recorder),
    }
    if plan.tool.has_real_motor:  # a simulated tool's motor ends with its worker
        setup = safety_monitor.SafetyMonitorSetup(os.getpid(), endpoints, plan.tool, plan.settings.realtime)
        workers["guard"] = Worker("guard", safety_monitor.main, setup)
    if plan.settings.foxglove.port:
        from app.service import foxglove_worker  # imports its library only where it is needed

        setup = foxglove_worker.FoxgloveSetup(
            os.getpid(),
            endpoints,
            plan.settings.foxglove.port,
            plan.tool.title,
            plan.library,
            plan.tool.board.sample_rate_hz,
        )
        workers["foxglove"] = Worker("foxglove", foxglove_worker.main, setup)
    return workers
