"""The acquisition worker: a process that owns the tool, conditions its samples and commands its motor."""

from dataclasses import asdict, dataclass
from multiprocessing.synchronize import Event

import zmq

from acquisition import bus
from acquisition.control import Acquisition, let_go_text
from acquisition.limiter import HoldBack
from acquisition.process import StopFlag, become_worker, take_realtime
from acquisition.safety import Safety
from acquisition.tools import open_tool
from config.errors import GraspwatchError, RefusedError
from config.schema import Conditioning, Limiter, Protocol, Realtime, TissueLibrary, Tool

REALTIME_PRIORITY = 80
LOOKS_EVERY_S = 0.1
MOST_COMMANDS = 20  # after one block: a stop does not queue behind what others ask for


@dataclass(frozen=True, slots=True)
class Setup:
    """All that the worker needs to know."""

    parent_pid: int
    endpoints: bus.Endpoints
    tool: Tool
    library: TissueLibrary
    conditioning: Conditioning
    tissue: str
    seed: int
    limiter: Limiter
    realtime: Realtime
    begin: Event  # set once the tool may be opened
    fault: str = ""  # that a worker before this one died of, with the motor armed


def main(setup: Setup) -> None:
    """Run until a signal or a fault; exits with an error's code after telling it."""
    stop = become_worker("acquisition", setup.parent_pid)
    context = zmq.Context()
    publisher = bus.publisher(context, setup.endpoints.samples)
    try:
        _drive(setup, publisher, context, stop)
    except GraspwatchError as error:
        publisher.send_multipart(bus.pack_notice("fault", worker="acquisition", text=str(error)))
        raise SystemExit(error.exit_code) from None
    finally:
        publisher.close()
        context.destroy(linger=200)


def _drive(setup: Setup, publisher: zmq.Socket, context: zmq.Context, stop: StopFlag) -> None:
    """Read the tool for as long as the service lives; between blocks, take force limits and obey commands."""
    source, grasper = open_tool(setup.tool, setup.library, setup.tissue, setup.seed)
    limits = bus.newest_of(context, setup.endpoints.limits)
    commands = context.socket(zmq.REP)
    commands.bind(setup.endpoints.commands)
    hold_back = HoldBack(setup.tool, setup.library, setup.limiter)
    safety = Safety.FAULTED if setup.fault else Safety.DISARMED
    acquisition = Acquisition(source, setup.tool, setup.conditioning, hold_back, safety, setup.fault)
    while not setup.begin.wait(LOOKS_EVERY_S):
        if stop.set:
            return
    with source:
        granted = take_realtime(setup.realtime, REALTIME_PRIORITY, place=0)
        publisher.send_multipart(bus.pack_notice("acquiring", realtime=str(granted)))
        while not stop.set and (block := acquisition.turn()) is not None:
            publisher.send_multipart(bus.pack_samples(block))
            _tell_news(acquisition, publisher)
            if limits.poll(0):
                limit = bus.unpack_limit(limits.recv())
                acquisition.allow(limit.threshold_n, limit.tick)
            for _ in range(MOST_COMMANDS):
                if not commands.poll(0):
                    break
                command = bus.unpack_command(commands.recv())
                answer = _obey(command, acquisition)
                if isinstance(command, bus.Start) and command.tissue and grasper and not answer.refused:
                    grasper.hold(command.tissue)
                if isinstance(command, bus.Put) and grasper:
                    grasper.hung_n, grasper.gauge_m = command.pull_n, command.gauge_m
                commands.send(bus.pack_answer(answer))
        acquisition.stop("the service was ended")
        _tell_news(acquisition, publisher)


def _tell_news(acquisition: Acquisition, publisher: zmq.Socket) -> None:
    """Grasps that were let go, and runs that ended."""
    for why in acquisition.take_let_go():
        publisher.send_multipart(bus.pack_notice("let_go", text=let_go_text(why)))
    for ended in acquisition.take_ended():
        publisher.send_multipart(bus.pack_notice("run_ended", **asdict(ended)))


def _obey(command: bus.Command | None, acquisition: Acquisition) -> bus.Answer:
    try:
        match command:
            case None:
                return bus.Answer(refused="The request came too late and was not obeyed. Try again.")
            case bus.Start():
                protocol = Protocol.model_validate_json(command.protocol)
                acquisition.start(command.run_id, protocol, command.cycles)
            case bus.Stop():
                return bus.Answer(effect=acquisition.stop(command.why))
            case bus.Arm():
                acquisition.arm()
            case bus.Disarm():
                acquisition.disarm()
            case bus.Acknowledge():
                acquisition.acknowledge()
        return bus.Answer()
    except RefusedError as error:
        return bus.Answer(refused=str(error))
