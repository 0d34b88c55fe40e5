"""The recorder worker: a process that writes what the bus carries, run by run."""

import gc
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import zmq

from acquisition import bus
from acquisition.process import StopFlag, become_worker, bound_memory, serving_priority
from app.record.mend import mend_folder
from app.record.recorder import Brief, Estimated, Recorder, RecordingStoppedError
from app.record.run_file import Rig
from app.wire import RunState
from estimator.blocks import estimate_dtype

POLL_MS = 100
SAYS_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class Setup:
    """All that the worker needs to know."""

    parent_pid: int
    endpoints: bus.Endpoints
    folder: Path
    rig: Rig
    priority: bool  # real-time, as the server's


def main(setup: Setup) -> None:
    """Run until a signal; first mends what a predecessor left cut off."""
    stop = become_worker("recorder", setup.parent_pid)
    bound_memory()
    gc.freeze()  # else it takes all modules apart before it is seen to have failed, which took half a second
    context = zmq.Context()
    publisher = bus.publisher(context, setup.endpoints.recorder)
    sources = bus.subscriber(context, setup.endpoints.samples, setup.endpoints.estimates, setup.endpoints.events)
    _Work(setup, publisher).follow(sources, stop)
    context.destroy(linger=100)


class _Work:
    """Hands what arrives to the recorder, and tells the server how that goes."""

    def __init__(self, setup: Setup, publisher: zmq.Socket) -> None:
        self._setup, self._publisher = setup, publisher
        self._priority = serving_priority(setup.priority)
        self._recorder = Recorder(setup.folder, setup.rig)
        self._dtype = estimate_dtype(len(setup.rig.library.tissues))
        self._samples = bus.SequenceCounter()
        self._said_s = 0.0

    def follow(self, sources: zmq.Socket, stop: StopFlag) -> None:
        """Until told to stop; then the file is made whole."""
        for path in mend_folder(self._setup.folder):
            self._tell("mended", file=path.name)
        while not stop.set:
            if sources.poll(POLL_MS):
                self._attempt(lambda: self._take(sources.recv_multipart()))
            if time.monotonic() - self._said_s > SAYS_EVERY_S:
                self._priority.renew()
                self._say()
        self._attempt(lambda: self._recorder.end("the service was ended"))
        self._say()

    def _attempt(self, work) -> None:
        file = self._recorder.file
        try:
            work()
        except RecordingStoppedError as stopped:
            self._tell("recording_stopped", text=str(stopped))
        if self._recorder.finished or self._recorder.file is not file:
            self._say()

    def _take(self, parts: list[bytes]) -> None:
        match parts[0]:
            case bus.SAMPLES:
                block = bus.unpack_samples(parts)
                if self._samples.is_out_of_turn(block):
                    return
                if self._samples.begins_anew(block.sequence):
                    self._samples = bus.SequenceCounter()
                self._samples.take(block.sequence, block.t_mono_ns)
                self._recorder.take_samples(block)
            case bus.ESTIMATES:
                header = json.loads(parts[1])
                estimates = np.frombuffer(parts[2], self._dtype)
                self._recorder.take_estimates(Estimated(header["sequence"], header["published_ns"], estimates))
            case bus.TOLD:
                self._recorder.tell(*bus.unpack_told(parts))
            case bus.NOTICE:
                notice = bus.unpack_notice(parts)
                match notice.pop("kind"):
                    case "brief":
                        self._recorder.brief(Brief(**notice))
                    case "run_ended":
                        self._recorder.run_ended(notice["run_id"], RunState(notice["end"]), notice["why"])

    def _say(self) -> None:
        """How it stands, which also says that this process is alive."""
        self._said_s = time.monotonic()
        for path in self._recorder.finished:
            self._tell("recorded", file=path.name)
        self._recorder.finished.clear()
        file = self._recorder.file
        self._tell(
            "recording",
            file=file.path.name if file else None,
            samples=file.samples if file else 0,
            missing_blocks=self._samples.missing,
            realtime=str(self._priority),
        )

    def _tell(self, kind: str, **content: object) -> None:
        self._publisher.send_multipart(bus.pack_notice(kind, **content))


def pack_brief(brief: Brief) -> list[bytes]:
    """What the server tells before it starts a run."""
    return bus.pack_notice("brief", **asdict(brief))
