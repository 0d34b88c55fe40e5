"""One turn of the acquisition: read a block, condition it, judge sensors and force, set the next motor command."""

import math
from dataclasses import dataclass, replace
from enum import StrEnum

from acquisition.blocks import Flag, SampleBlock
from acquisition.commands import CommandHistory, Commands
from acquisition.limiter import HoldBack, middle_of, most_after, why_stop
from acquisition.pipeline import Pipeline
from acquisition.protocol import ProtocolPlayer
from acquisition.safety import IN_RUN, MOVING, WATCHED, Event, Safety, after
from acquisition.selftest import SelfTest
from acquisition.source import Source
from acquisition.watch import SensorWatch
from config.errors import RefusedError
from config.schema import Conditioning, Protocol, Tool

ASTRAY_V = 0.25
ASTRAY_S = 0.09  # by the board's clock; less may be a line that settles, or a driver that counts in bursts
PROMPT_S = 0.01  # a reader this far behind its board is none that lags
MOST_BEHIND_S = 1.0  # further behind, nobody knows the force
HELD_BACK, LET_GO = Flag.HELD_BACK.value, Flag.LET_GO.value


SCALE_UNKNOWN = (
    "The tool's force scale is not measured, so its newtons may be wrong by a large factor. Measure it and state it "
    "under [calibration.jaw_force_scale] in the tool file, or have an admin arm the tool with a reason "
    "(`unmeasured_scale`)."
)


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
    """Drives one source. The motor moves only while a run plays its protocol; `safety` says where the tool stands."""

    def __init__(
        self,
        source: Source,
        tool: Tool,
        conditioning: Conditioning,
        hold_back: HoldBack | None = None,
        safety: Safety = Safety.DISARMED,
        why: str = "",
    ) -> None:
        """`hold_back` limits the force of whatever a protocol asks for; a recording, which has no motor, needs none.

        `safety` is where the tool stood before, and `why` it is faulted: a fault outlives the process that had it. A
        simulated tool in virtual time, which hurts nobody, may begin armed.
        """
        self._source = source
        self._tool = tool
        self._pipeline = Pipeline(tool, conditioning)
        self._watch = SensorWatch(tool)
        self._self_test = SelfTest(tool)
        self.safety, self.why = safety, why
        self._player: ProtocolPlayer | None = None
        self._run_id = ""
        self._ended: list[RunEnded] = []
        self._untested = "the tool did not stay at rest for long enough: try again"  # why not, when it was last judged
        self._hold_back = hold_back
        self._held = 0  # HELD_BACK and LET_GO, of the command that is written next
        self._let_go: list[str] = []
        rate_hz = tool.board.sample_rate_hz
        self._prompt_samples, self._most_backlog = round(PROMPT_S * rate_hz), round(MOST_BEHIND_S * rate_hz)
        self._commands = CommandHistory()
        self._behind = 0  # samples that the reader has to catch up
        self._astray_most = round(ASTRAY_S * rate_hz)
        self._astray = 0  # samples in a row whose command was read back wrong

    @property
    def running(self) -> bool:
        return self._player is not None

    def arm(self, unmeasured: str = "") -> None:
        """Begin the self-test; the tool is armed by one of the next turns, or disarmed again for the reason in `why`.

        The strain gage is tared anew with it. A tool that is armed stays so. `unmeasured` is the reason for which a
        real tool may move although its force scale is not measured.

        Raises:
            RefusedError: a run is under way, a fault is latched, or the force scale is not measured.
        """
        if not (self._tool.has_known_scale or unmeasured):
            raise RefusedError(SCALE_UNKNOWN)
        if self._happens(Event.ARM):
            self._self_test.begin()
            self._tare_anew()

    def disarm(self) -> None:
        """Motor to zero; nothing starts before the tool is armed again."""
        self._end_run(Event.DISARM, RunEnd.STOPPED, "the tool was disarmed")

    def acknowledge(self) -> None:
        """Somebody has seen the fault.

        Raises:
            RefusedError: there is none.
        """
        self._happens(Event.ACKNOWLEDGE)

    def start(self, run_id: str, protocol: Protocol, cycles: int) -> None:
        """Begin a run: everything is measured anew, and the strain gage is tared during the protocol's lead-in.

        Raises:
            RefusedError: the tool is not armed, a run is under way, or the protocol passes the tool's limits.
        """
        after(self.safety, Event.START)  # a tool that is not armed is the first thing to know of
        player = ProtocolPlayer(protocol, self._tool, cycles)
        self._happens(Event.START)
        self._run_id, self._player = run_id, player

    def allow(self, threshold_n: float, tick: int) -> None:
        """The injury threshold in force as the samples up to `tick` tell it, N; it counts until it expires."""
        if self._hold_back is not None:
            self._hold_back.allow(threshold_n, tick)

    def stop(self, why: str) -> bool:
        """Motor to zero at once, whatever else is the case; returns whether a run was ended by it."""
        return self._end_run(Event.STOP, RunEnd.STOPPED, why)

    def begin_anew(self, why: str) -> None:
        """Go on with a board that had to be opened again: a run has failed, and the tool has to be armed again."""
        self._commands, self._behind = CommandHistory(), 0
        if self.running:
            self.fail(why)
        self.disarm()
        if self.safety is Safety.DISARMED:
            self.why = why
        self._tare_anew()

    def fail(self, why: str) -> None:
        """Motor to zero at once; nothing starts before somebody has acknowledged this fault."""
        self._end_run(Event.FAULT, RunEnd.FAILED, why)
        self.why = why

    def _end_run(self, event: Event, end: RunEnd, why: str) -> bool:
        self._held = 0
        if self._hold_back is not None:
            self._hold_back.rest()
        self._write(0.0)
        self._happens(event)
        if not self.running:
            return False
        self._player = None
        self._ended.append(RunEnded(self._run_id, end, why))
        return True

    def _happens(self, event: Event) -> bool:
        """Returns whether the tool stands elsewhere now."""
        before, self.safety = self.safety, after(self.safety, event)
        if before is not self.safety and event is not Event.FAULT:
            self.why = ""
        return before is not self.safety

    def turn(self) -> SampleBlock | None:
        """Read and condition the next block and set the command that follows it; None at a recording's end.

        Raises:
            ToolError: the board failed; the motor has been commanded to zero.
        """
        raw = self._source.read_block()
        if raw is None:
            return None
        if self.running and self._player.begins:
            self._watch.begin_anew()  # with the tare
        commands = self._commands.during(raw.first_tick, len(raw))
        limit_n = self._hold_back.limit_n if self._hold_back else math.nan
        run_id = self._run_id if self.running else ""
        block = self._pipeline.process(replace(raw, limiter=commands.flags, limit_n=limit_n, run=run_id))
        caught_up = self._caught_up(raw.backlog)
        self._self_test.take(block.samples)
        tare = self._pipeline.tare
        lost = self._watch.judge(block.samples, tare.rest_v if tare.measured else math.nan)
        if self.safety is Safety.TESTING:
            self._test(lost)
        elif self.safety in WATCHED and (why := lost or self._why_stop(block, commands)):
            self.fail(why)
        elif self._player is not None:
            if self._player.done:
                self._end_run(Event.FINISH, RunEnd.FINISHED, "all cycles are done")
            else:
                self._move(block, commands.likely_v, self._player.advance(len(raw) - caught_up))
        return replace(block, safety=self.safety, why=self.why)

    def _test(self, lost: str | None) -> None:
        """Pass once a tare was taken while the tool was sound and at rest; fail when that takes too long."""
        if why := self._self_test.fault() or lost:
            self._untested = why
            self._tare_anew()
        elif self._pipeline.tare.measured:
            self._happens(Event.TEST_PASSED)
        if self.safety is Safety.TESTING and self._self_test.over:
            self._happens(Event.TEST_FAILED)
            self.why = self._untested

    def _tare_anew(self) -> None:
        self._pipeline.tare_anew()
        self._watch.begin_anew()

    def _caught_up(self, backlog: int) -> int:
        """Samples of the last block, at most, that only made up for a delay of the reader.

        The protocol stands still for as many: it goes no faster than time, whatever was held up.
        """
        before, self._behind = self._behind, max(backlog - self._prompt_samples, 0)
        return min(max(before - self._behind, 0), self._tool.board.block_samples)

    def _why_stop(self, block: SampleBlock, commands: Commands) -> str | None:
        """What forbids the motor to go on, of a run."""
        if self.safety not in IN_RUN:
            return None
        return why_stop(self._tool, block.samples) or self._why_not_move(block, commands)

    def _move(self, block: SampleBlock, commands_v: list[float], wanted_v: float) -> None:
        """Write what the protocol asks for, or as much as the limiter allows after a block taken under `commands_v`."""
        if self._hold_back is None:
            self._write(wanted_v)
            return
        was_let_go = self._hold_back.why_let_go
        command_v, self._held = self._hold_back.judge(block.samples, commands_v, wanted_v)
        self._happens(_event_of(self._held))
        self._write(command_v)
        if (why := self._hold_back.why_let_go) and not was_let_go:
            self._let_go.append(why)

    def _why_not_move(self, block: SampleBlock, commands: Commands) -> str | None:
        """What forbids the motor to start or to go on: no tare, samples read too late, a command not read back."""
        tare, calibration = self._pipeline.tare, self._tool.calibration
        if self._player and not self._player.at_rest and not tare.measured:
            seen_v = float(block.samples["strain_v"].mean())
            return (
                f"the strain gage rests at {seen_v:.3f} V, the tool file expects {calibration.rest_offset_v:.3f} V "
                f"within {calibration.rest_tolerance_v:.3f} V: it was not tared"
            )
        if block.backlog > self._most_backlog:
            late_s = block.backlog / self._tool.board.sample_rate_hz
            return f"the samples were read {late_s:.1f} s late: the force is not known; end other programs"
        off_v = middle_of(commands.off_by(block.samples["motor_command_v"].tolist()))
        is_astray = off_v is None or off_v > ASTRAY_V
        self._astray = self._astray + len(block.samples) if is_astray else 0
        if self._astray >= self._astray_most:
            off = "as no number" if off_v is None else f"{off_v:.2f} V off"
            return f"the motor command of {commands.likely_v[-1]:.2f} V is read back {off}: check its wiring"
        return None

    def _write(self, command_v: float) -> None:
        """Set the command, or as much of it as may follow the last one; down it goes at once."""
        most_v = most_after(self._commands.last_v, self._tool) if self.safety in MOVING else 0.0
        command_v = min(command_v, most_v)
        if (command_v, self._held) != (self._commands.last_v, self._commands.last_flags) or command_v == 0.0:
            self._commands.add(self._source.write_command(command_v), self._held)

    def take_ended(self) -> list[RunEnded]:
        """Runs that ended since the last call."""
        ended, self._ended = self._ended, []
        return ended

    def take_let_go(self) -> list[str]:
        """Why grasps were let go since the last call, the motor at zero for the rest of each."""
        let_go, self._let_go = self._let_go, []
        return let_go


def _event_of(held: int) -> Event:
    """What the limiter's flags mean."""
    if held & LET_GO:
        return Event.LET_GO
    return Event.HOLD_BACK if held & HELD_BACK else Event.RELEASE
