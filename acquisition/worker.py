"""The acquisition worker: a process that owns the tool, conditions its samples and commands its motor."""

import time
from dataclasses import asdict, dataclass
from multiprocessing.synchronize import Event

import zmq

from acquisition import bus
from acquisition.blocks import SampleBlock
from acquisition.control import Acquisition, let_go_text
from acquisition.limiter import HoldBack
from acquisition.nidaq import NidaqTool
from acquisition.process import StopFlag, become_worker, take_realtime
from acquisition.safety import Safety
from acquisition.server_watch import ServerWatch
from acquisition.tools import open_tool
from config.errors import GraspwatchError, RefusedError, ToolError
from config.schema import Conditioning, Limiter, Protocol, Realtime, TissueLibrary, Tool

REALTIME_PRIORITY = 80
LOOKS_EVERY_S = 0.1
RENEW_PRIORITY_S = 1.0
STALLED_S = 0.5
"""A turn takes 5 ms, or 20 if samples fail to come: after so long this process itself was held up."""
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
    server_silence_s: float
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
    signs_of_life = bus.newest_of(context, setup.endpoints.server)
    commands = context.socket(zmq.REP)
    commands.bind(setup.endpoints.commands)
    hold_back = HoldBack(setup.tool, setup.library, setup.limiter)
    safety = Safety.FAULTED if setup.fault else Safety.DISARMED
    acquisition = Acquisition(source, setup.tool, setup.conditioning, hold_back, safety, setup.fault)
    server = ServerWatch(setup.server_silence_s)
    while not setup.begin.wait(LOOKS_EVERY_S):
        if stop.set:
            return
    with source:
        granted = take_realtime(setup.realtime, REALTIME_PRIORITY, place=0)
        publisher.send_multipart(bus.pack_notice("acquiring", realtime=str(granted)))
        stalls, renewed_s = _Stalls(source, acquisition, publisher), time.monotonic()
        while not stop.set and (block := stalls.turn()) is not None:
            publisher.send_multipart(bus.pack_samples(block))
            _tell_news(acquisition, publisher)
            if time.monotonic() - renewed_s > RENEW_PRIORITY_S:
                granted.priority.renew()
                renewed_s = time.monotonic()
            if limits.poll(0):
                limit = bus.unpack_limit(limits.recv())
                acquisition.allow(limit.threshold_n, limit.tick)
            if signs_of_life.poll(0):
                signs_of_life.recv()
                server.heard()
            for _ in range(MOST_COMMANDS):
                if not commands.poll(0):
                    break
                command = bus.unpack_command(commands.recv())
                server.heard()
                answer = _obey(command, acquisition)
                if isinstance(command, bus.Start) and command.tissue and grasper and not answer.refused:
                    grasper.hold(command.tissue)
                if isinstance(command, bus.Put) and grasper:
                    grasper.hung_n, grasper.gauge_m = command.pull_n, command.gauge_m
                commands.send(bus.pack_answer(answer))
            if (why := server.look(time.monotonic())) and acquisition.running:
                acquisition.fail(why)
        acquisition.stop("the service was ended")
        _tell_news(acquisition, publisher)


class _Stalls:
    """Takes turns, and notices when this process was held up: stopped, swapped out or suspended with the machine.

    Samples that the board kept meanwhile (10 s) are read and published late; past that, or after the guard's reset, the
    board is opened again, and the samples in between are counted as lost.
    """

    def __init__(self, source: NidaqTool, acquisition: Acquisition, publisher: zmq.Socket) -> None:
        self._source, self._acquisition, self._publisher = source, acquisition, publisher
        self._turned_s = time.monotonic()

    def turn(self) -> SampleBlock | None:
        """The next block.

        Raises:
            ToolError: the board failed, and not because of a stall.
        """
        try:
            block = self._acquisition.turn()
        except ToolError:
            if not (stalled := self._stalled()):
                raise
            self._source.reopen()
            why = f"{stalled}; the board had to be opened again: arm the tool again"
            self._acquisition.begin_anew(why)
            self._tell(why)
            return self.turn()
        if stalled := self._stalled():
            self._tell(stalled)
        return block

    def _stalled(self) -> str | None:
        before_s, self._turned_s = self._turned_s, time.monotonic()
        stalled_s = self._turned_s - before_s
        return f"The acquisition was held up for {stalled_s:.1f} s" if stalled_s > STALLED_S else None

    def _tell(self, text: str) -> None:
        self._publisher.send_multipart(bus.pack_notice("stalled", text=text))


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
                acquisition.arm(command.unmeasured)
            case bus.Disarm():
                acquisition.disarm()
            case bus.Acknowledge():
                acquisition.acknowledge()
        return bus.Answer()
    except RefusedError as error:
        return bus.Answer(refused=str(error))
