"""The acquisition worker: a process that owns the tool, conditions its samples and commands its motor."""

import time
from dataclasses import asdict, dataclass
from pathlib import Path

import zmq

from acquisition import bus
from acquisition.control import Acquisition, RunEnd
from acquisition.process import StopFlag, ask_for_realtime, become_worker, calm_garbage_collector
from acquisition.recording import Recording
from acquisition.tools import open_tool
from config.errors import GraspwatchError, RefusedError
from config.schema import Conditioning, Protocol, TissueLibrary, Tool

REALTIME_PRIORITY = 80


@dataclass(frozen=True, slots=True)
class Setup:
    """All that the worker needs to know. `recordings` are played instead of a tool, at `speed` times real time."""

    parent_pid: int
    endpoints: bus.Endpoints
    tool: Tool
    library: TissueLibrary
    conditioning: Conditioning
    tissue: str
    seed: int
    recordings: tuple[Path, ...] = ()
    speed: float = 1.0


def main(setup: Setup) -> None:
    """Run until a signal, the end of the recording, or a fault; exits with an error's code after telling it."""
    stop = become_worker("acquisition", setup.parent_pid)
    context = zmq.Context()
    publisher = bus.publisher(context, setup.endpoints.samples)
    try:
        if setup.recordings:
            _play(setup, publisher, stop)
        else:
            _drive(setup, publisher, context, stop)
    except GraspwatchError as error:
        publisher.send_multipart(bus.pack_notice("fault", worker="acquisition", text=str(error)))
        raise SystemExit(error.exit_code) from None
    finally:
        publisher.close()
        context.destroy(linger=200)


def _play(setup: Setup, publisher: zmq.Socket, stop: StopFlag) -> None:
    """Publish recordings one after the other, each from a fresh start."""
    for path in setup.recordings:
        with Recording(path, setup.tool, setup.speed) as recording:
            publisher.send_multipart(bus.pack_notice("recording", name=path.name))
            acquisition = Acquisition(recording, setup.tool, setup.conditioning)
            while not stop.set and (block := acquisition.turn()) is not None:
                publisher.send_multipart(bus.pack_samples(block))
    publisher.send_multipart(bus.pack_notice("ended", text="the recording has ended"))


def _drive(setup: Setup, publisher: zmq.Socket, context: zmq.Context, stop: StopFlag) -> None:
    """Read the tool for as long as the service lives; obey commands between blocks."""
    source, grasper = open_tool(setup.tool, setup.library, setup.tissue, setup.seed)
    commands = context.socket(zmq.REP)
    commands.bind(setup.endpoints.commands)
    with source:
        acquisition = Acquisition(source, setup.tool, setup.conditioning)
        calm_garbage_collector()
        realtime = ask_for_realtime(REALTIME_PRIORITY)
        publisher.send_multipart(bus.pack_notice("acquiring", realtime=realtime))
        while not stop.set and (block := acquisition.turn()) is not None:
            publisher.send_multipart(bus.pack_samples(block))
            _tell_ended(acquisition, publisher)
            if commands.poll(0):
                command = bus.unpack_command(commands.recv())
                answer = _obey(command, acquisition)
                if isinstance(command, bus.Start) and command.tissue and grasper and not answer.refused:
                    grasper.hold(command.tissue)
                commands.send(bus.pack_answer(answer))
        acquisition.stop(RunEnd.STOPPED, "the service was ended")
        _tell_ended(acquisition, publisher)


def _tell_ended(acquisition: Acquisition, publisher: zmq.Socket) -> None:
    for ended in acquisition.take_ended():
        publisher.send_multipart(bus.pack_notice("run_ended", **asdict(ended)))


def _obey(command: bus.Command, acquisition: Acquisition) -> bus.Answer:
    try:
        match command:
            case bus.Start():
                if time.monotonic_ns() > command.deadline_ns:
                    return bus.Answer(refused="The request to start came too late and was not obeyed. Try again.")
                protocol = Protocol.model_validate_json(command.protocol)
                acquisition.start(command.run_id, protocol, command.cycles)
                return bus.Answer()
            case bus.Stop():
                return bus.Answer(effect=acquisition.stop(RunEnd.STOPPED, command.why))
    except RefusedError as error:
        return bus.Answer(refused=str(error))
