"""Functions that open the workers' ZeroMQ sockets, and pack and unpack samples, notices, thresholds and commands.

PUB/SUB loses messages silently once the queue of a slow subscriber is full. Therefore every block carries a sequence
number, and `SequenceTracker` counts the missing blocks.
"""

import json
import secrets
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
import zmq
from pydantic import TypeAdapter

from acquisition.notices import Notice
from acquisition.safety_state_machine import Safety
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock
from config.errors import ServiceError

SocketT = TypeVar("SocketT", bound=zmq.Socket)

HIGH_WATER_MARK = 12_000  # messages; 200 blocks a second for a minute

SAMPLES_TOPIC, ESTIMATES_TOPIC, NOTICE_TOPIC, SERVER_MESSAGE_TOPIC = b"samples", b"estimates", b"notice", b"message"

_BLOCK_HEADER_NAMES = tuple(field.name for field in fields(SampleBlock) if field.name != "samples")


@dataclass(frozen=True, slots=True)
class Endpoints:
    """ZeroMQ addresses of one service's bus."""

    samples: str
    estimates: str
    thresholds: str
    commands: str
    events: str
    recorder: str
    safety_monitor: str
    foxglove: str
    server_heartbeat: str

    @classmethod
    def in_folder(cls, folder: Path) -> "Endpoints":
        tag = secrets.token_hex(4)
        return cls(*(f"ipc://{folder}/{each.name}-{tag}" for each in fields(cls)))


def open_publisher(context: zmq.Context[SocketT], address: str) -> SocketT:
    socket = context.socket(zmq.PUB)
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.LINGER, 200)
    socket.bind(address)
    return socket


def open_subscriber(context: zmq.Context, *addresses: str) -> Any:
    """Open a socket that receives everything published at the addresses (also with a context of `zmq.asyncio`)."""
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.SUBSCRIBE, b"")
    for address in addresses:
        socket.connect(address)
    return socket


def pack_samples(block: SampleBlock) -> list[bytes]:
    header = {name: getattr(block, name) for name in _BLOCK_HEADER_NAMES}
    return [SAMPLES_TOPIC, json.dumps(header).encode(), block.samples.tobytes()]


def unpack_samples(parts: list[bytes]) -> SampleBlock:
    header = json.loads(parts[1])
    safety = Safety(header.pop("safety"))
    return SampleBlock(**header, safety=safety, samples=np.frombuffer(parts[2], SAMPLE_DTYPE))


def unpack_safety(parts: list[bytes]) -> Safety:
    """Return the tool's safety state from a packed block."""
    return Safety(json.loads(parts[1])["safety"])


def pack_server_message(topic: str, content: bytes) -> list[bytes]:
    """Pack a message that the server sent to its viewers, for the recorder and the Foxglove server."""
    return [SERVER_MESSAGE_TOPIC, topic.encode(), content]


def unpack_server_message(parts: list[bytes]) -> tuple[str, bytes]:
    return parts[1].decode(), parts[2]


_NOTICE_TYPES = {kind.__name__: TypeAdapter(kind) for kind in get_args(Notice)}


def pack_notice(notice: Notice) -> list[bytes]:
    return [NOTICE_TOPIC, json.dumps({"kind": type(notice).__name__, **asdict(notice)}).encode()]


def unpack_notice(parts: list[bytes]) -> Notice:
    """Return the notice.

    Raises:
        ServiceError: another version of the program sent it.
    """
    content = json.loads(parts[1])
    return _find_type(_NOTICE_TYPES, content.pop("kind")).validate_python(content)


def _find_type(types: dict[str, TypeAdapter[Any]], name: str) -> TypeAdapter[Any]:
    if name not in types:
        raise ServiceError(
            f"A process of the service sent {name!r}, which this one does not know: they are of different versions. "
            "Start the service again."
        )
    return types[name]


class SequenceTracker:
    """Counter of blocks that never arrived, and detector of blocks that arrived out of order."""

    def __init__(self) -> None:
        self._last_sequence: int | None = None
        self._last_ns = 0
        self.missing = 0

    def is_out_of_order(self, block: SampleBlock) -> bool:
        """Return whether a later block of the same sender came first; `update` then counted this one as missing."""
        return (
            self._last_sequence is not None
            and block.sequence <= self._last_sequence
            and block.t_mono_ns <= self._last_ns
        )

    def is_restart(self, sequence: int) -> bool:
        """Return whether the sender was restarted: its sequence numbers begin anew."""
        return self._last_sequence is not None and sequence <= self._last_sequence

    def update(self, sequence: int, t_mono_ns: int = 0) -> int:
        """Count and return the blocks missing between the last one and this one, published at `t_mono_ns`."""
        self._last_ns = t_mono_ns
        missing = 0
        if self._last_sequence is not None and not self.is_restart(sequence):
            missing = sequence - self._last_sequence - 1
        self._last_sequence = sequence
        self.missing += missing
        return missing


# --- force limits ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ThresholdUpdate:
    """The injury threshold in force, N, as known at sample `tick`, and the tissue that it is of.

    `tissue` is None if the threshold is the lowest one of the library.
    """

    threshold_n: float
    tissue: str | None
    tick: int


def pack_threshold(limit: ThresholdUpdate) -> bytes:
    return json.dumps(asdict(limit)).encode()


def unpack_threshold(message: bytes) -> ThresholdUpdate:
    return ThresholdUpdate(**json.loads(message))


def open_latest_subscriber(context: zmq.Context, address: str) -> zmq.Socket:
    """Open a socket that keeps only the newest message published at the address; messages must have one part."""
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.CONFLATE, 1)
    socket.setsockopt(zmq.SUBSCRIBE, b"")
    socket.connect(address)
    return socket


# --- commands --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ArmCommand:
    """Command to begin the self-test at rest; later blocks report whether the tool is armed.

    `unmeasured_scale_reason`: why the tool may be armed although its force scale is not measured.
    """

    unmeasured_scale_reason: str = ""


@dataclass(frozen=True, slots=True)
class DisarmCommand:
    """Command to set the motor to zero and forbid runs until the tool is armed again."""


@dataclass(frozen=True, slots=True)
class AcknowledgeCommand:
    """Command to clear the latched fault, which a person has seen."""


@dataclass(frozen=True, slots=True)
class StartCommand:
    """Command to begin a run of `cycles` cycles of a protocol (as JSON); `tissue` sets that of a simulated tool."""

    run_id: str
    protocol: str
    cycles: int
    tissue: str | None


@dataclass(frozen=True, slots=True)
class StopCommand:
    """Command to set the motor to zero now and end the run, if there is one."""

    why: str


@dataclass(frozen=True, slots=True)
class SimulatedPullAndGaugeCommand:
    """Command to set a simulated tool's pull on the handle, N, and gauge in the jaws, m (0: empty, None: tissue)."""

    pull_n: float
    gauge_m: float | None


@dataclass(frozen=True, slots=True)
class BeginSpotCommand:
    """Command to begin a new spot with the next sample; a grasp under way belongs to the spot before."""


AnyCommand = (
    ArmCommand
    | DisarmCommand
    | AcknowledgeCommand
    | StartCommand
    | StopCommand
    | BeginSpotCommand
    | SimulatedPullAndGaugeCommand
)
_COMMAND_TYPES = {kind.__name__: TypeAdapter(kind) for kind in get_args(AnyCommand)}


def pack_command(command: AnyCommand, expires_ns: int) -> bytes:
    """Pack a command whose sender waits until `expires_ns` of the monotonic clock."""
    content = {"command": type(command).__name__, "until_ns": expires_ns, **asdict(command)}
    return json.dumps(content).encode()


def unpack_command(message: bytes) -> AnyCommand | None:
    """Return the command, or None if it has expired. A stop never expires.

    Raises:
        ServiceError: another version of the program sent it.
    """
    content = json.loads(message)
    command_type, until_ns = _find_type(_COMMAND_TYPES, content.pop("command")), content.pop("until_ns")
    command = command_type.validate_python(content)
    return None if not isinstance(command, StopCommand) and time.monotonic_ns() > until_ns else command


@dataclass(frozen=True, slots=True)
class CommandReply:
    """Answer to a command: `refused` is the reason or None; `effect` says whether the command changed anything.

    `tick` is that of the last sample before it: blocks up to there show the safety state before the command.
    """

    refused: str | None = None
    effect: bool = True
    tick: int = -1


def pack_reply(answer: CommandReply) -> bytes:
    return json.dumps(asdict(answer)).encode()


def unpack_reply(message: bytes) -> CommandReply:
    return CommandReply(**json.loads(message))
