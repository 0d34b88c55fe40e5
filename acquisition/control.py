"""One turn of the acquisition: read a block, condition it, judge the force, set the next motor command."""

from dataclasses import dataclass, replace
from enum import StrEnum

from acquisition.blocks import SampleBlock
from acquisition.limiter import HoldBack, most_after, why_stop
from acquisition.pipeline import Pipeline
from acquisition.protocol import ProtocolPlayer
from acquisition.source import Source
from config.errors import RefusedError
from config.schema import Conditioning, Protocol, Tool

ASTRAY_V = 0.25
ASTRAY_BLOCKS = 20  # 100 ms: a reader that lags behind the board sees its commands late


class RunEnd(StrEnum):
    """How a run ended."""

    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class RunEnded:
    run_id: str
    end: RunEnd
    why: str


def let_go_text(why: str) -> str:
    """What is told of a grasp that the limiter let go."""
    return f"The grasp was let go with the motor at zero: {why}."


class Acquisition:
    """Drives one source. The motor moves only while a run plays its protocol."""

    def __init__(
        self, source: Source, tool: Tool, conditioning: Conditioning, hold_back: HoldBack | None = None
    ) -> None:
        """`hold_back` limits the force of whatever a protocol asks for; a recording, which has no motor, needs none."""
        self._source = source
        self._tool = tool
        self._pipeline = Pipeline(tool, conditioning)
        self._player: ProtocolPlayer | None = None
        self._run_id = ""
        self._ended: list[RunEnded] = []
        self._hold_back = hold_back
        self._held = 0  # HELD_BACK and LET_GO, of the samples that come next
        self._let_go: list[str] = []
        self._command_v = 0.0
        self._astray = 0  # blocks in a row whose command was read back wrong

    @property
    def running(self) -> bool:
        return self._player is not None

    def start(self, run_id: str, protocol: Protocol, cycles: int) -> None:
        """Begin a run: everything is measured anew, and the strain gage is tared during the protocol's lead-in.

        Raises:
            RefusedError: a run is under way, or the protocol passes the tool's limits.
        """
        if self.running:
            raise RefusedError("A run is under way. Stop it first.")
        player = ProtocolPlayer(protocol, self._tool, cycles)
        self._run_id, self._player = run_id, player

    def allow(self, threshold_n: float, tick: int) -> None:
        """The injury threshold in force as the samples up to `tick` tell it, N; it counts until it expires."""
        if self._hold_back is not None:
            self._hold_back.allow(threshold_n, tick)

    def stop(self, end: RunEnd, why: str) -> bool:
        """Motor to zero at once, whatever else is the case; returns whether a run was ended by it."""
        self._write(0.0)
        self._held = 0
        if not self.running:
            return False
        self._player = None
        self._ended.append(RunEnded(self._run_id, end, why))
        return True

    def turn(self) -> SampleBlock | None:
        """Read and condition the next block and set the command that follows it; None at a recording's end.

        Raises:
            ToolError: the board failed; the motor has been commanded to zero.
        """
        raw = self._source.read_block()
        if raw is None:
            return None
        block = self._pipeline.process(replace(raw, limiter=self._held, run=self._run_id if self.running else ""))
        if self._player is not None:
            why = why_stop(self._tool.limits, block.samples) or self._why_not_move(block)
            if why:
                self.stop(RunEnd.FAILED, why)
            elif self._player.done:
                self.stop(RunEnd.FINISHED, "all cycles are done")
            else:
                self._move(block, self._player.advance(len(raw)))
        return block

    def _move(self, block: SampleBlock, wanted_v: float) -> None:
        """Write what the protocol asks for, or as much of it as the limiter allows."""
        if self._hold_back is None:
            self._write(wanted_v)
            return
        was_let_go = self._hold_back.why_let_go
        command_v, self._held = self._hold_back.judge(block.samples, wanted_v)
        self._write(command_v)
        if (why := self._hold_back.why_let_go) and not was_let_go:
            self._let_go.append(why)

    def _why_not_move(self, block: SampleBlock) -> str | None:
        """What forbids the motor to start or to go on: no tare, or a command that does not arrive."""
        tare, calibration = self._pipeline.tare, self._tool.calibration
        if self._player and not self._player.at_rest and not tare.measured:
            seen_v = float(block.samples["strain_v"].mean())
            return (
                f"the strain gage rests at {seen_v:.3f} V, the tool file expects {calibration.rest_offset_v:.3f} V "
                f"within {calibration.rest_tolerance_v:.3f} V: it was not tared"
            )
        off_v = abs(float(block.samples["motor_command_v"][-1]) - self._command_v)
        self._astray = self._astray + 1 if off_v > ASTRAY_V else 0
        if self._astray >= ASTRAY_BLOCKS:
            return f"the motor command of {self._command_v:.2f} V is read back {off_v:.2f} V off: check its wiring"
        return None

    def _write(self, command_v: float) -> None:
        """Set the command, or as much of it as may follow the last one; down it goes at once."""
        command_v = min(command_v, most_after(self._command_v, self._tool))
        if command_v != self._command_v or command_v == 0.0:
            self._source.write_command(command_v)
            self._command_v = command_v

    def take_ended(self) -> list[RunEnded]:
        """Runs that ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def take_let_go(self) -> list[str]:
        """Why grasps were let go since the last call, the motor at zero for the rest of each."""
        let_go, self._let_go = self._let_go, []
        return let_go
