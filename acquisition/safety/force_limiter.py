"""What stops the motor, and what holds it back, judged at every block from unfiltered force; nobody is waited for."""

import math
from collections import deque
from collections.abc import Collection

import numpy as np

from acquisition.sample_block import SampleFlag
from acquisition.signals.grasp_tracker import COMMAND_ON_V
from config.schema import LimiterSettings, TissueLibrary, Tool

INVALID, SATURATED, IN_GRASP = SampleFlag.INVALID.value, SampleFlag.SATURATED.value, SampleFlag.IN_GRASP.value
LIMITED, RELEASED = SampleFlag.LIMITED.value, SampleFlag.RELEASED.value

LAG_TIME_CONSTANT_S = (
    0.009  # each of two lags in a row from command to force: 8 ms of drive, 10 ms of cable and tissue in simulation
)
GAIN_INCREASE_TIME_CONSTANT_S = 0.003  # how fast more force than the map tells is believed: most of it within a block
GAIN_DECREASE_TIME_CONSTANT_S = 0.2  # and less force: slowly, for it may only be late
RATIO_REGULARIZATION_SHARE = (
    0.08  # of the limit, that is added to both forces before they are compared: small ones are all noise
)
LIMIT_RISE_N_PER_S = 10.0  # a limit that rises is followed so fast: in the 25 ms until an error is felt, 0.25 N at most
THRESHOLD_SETTLING_S = (
    0.1  # that the force gets to follow a threshold that falls, five times what drive and tissue take; and that
)
# one that rises has to hold before it is followed: answers that come too late now and then do not shake the motor
ROUNDING_TOLERANCE = 1e-9
SETPOINT_SHARE = 0.93  # of the limit: noise, friction of the cable and a gage that reads 3 % short stay below it
RELEASE_SHARE = 1.05  # of the limit: the grasp is let go
MIN_LIMITED_COMMAND_V = 0.05  # a grasp that is held back goes on: at 0 V the jaws would open


def find_stop_reason(tool: Tool, samples: np.ndarray) -> str | None:
    """Why the motor must not go on after these samples, or None.

    The upper end of the force scale decides whether the ceiling is reached. The mean of a block is judged, so that one
    spike of the strain gage does not end a grasp; a force that cannot be known (strain gage saturated, jaws in a grasp
    outside the domain of Eqs. (1) to (6)) counts as too large.
    """
    flags, force_n, ceiling_n = (
        samples["flags"],
        samples["jaw_force_n"],
        tool.to_displayed_n(tool.limits.force_ceiling_n),
    )
    mean_n = float(np.add.reduce(force_n)) / len(samples)
    if mean_n <= ceiling_n and not (flags & SATURATED).any():
        return None
    if (flags & SATURATED).all():
        return "the strain gage is saturated: the force is not known"
    if (flags & (INVALID | IN_GRASP) == INVALID | IN_GRASP).all():
        return "the jaws are outside the range of Eqs. (1) to (6): the force is not known"
    known = np.isfinite(force_n)
    mean_n = float(force_n[known].mean()) if known.any() else 0.0
    if mean_n > ceiling_n:
        return f"force {mean_n:.2f} N is over the ceiling of {ceiling_n:.2f} N"
    return None


def compute_max_next_command(command_v: float, tool: Tool) -> float:
    """The highest command that may follow a block under `command_v`, V: the tool's bound on how fast it rises."""
    block_s = tool.board.block_samples / tool.board.sample_rate_hz
    return command_v + tool.limits.max_command_v_per_s * block_s * (1 + ROUNDING_TOLERANCE)


class ActiveThreshold:
    """The injury threshold that counts, N: the one told of the grasp under way while it is fresh, else the lowest."""

    def __init__(self, thresholds_n: Collection[float], expires_ticks: int) -> None:
        """`thresholds_n`: those of the library's tissues, in the newtons that the tool shows."""
        self._lowest_n, self._highest_n = min(thresholds_n), max(thresholds_n)
        self._expires_ticks = expires_ticks
        self._reported_n, self._reported_tick = self._lowest_n, -1

    def update(self, threshold_n: float, tick: int) -> None:
        """What the samples up to `tick` say. A number that no tissue of the library can have is not followed."""
        self._reported_n, self._reported_tick = threshold_n, tick

    def value_at(self, tick: int, grasp_start_tick: int) -> float:
        """At a sample of the grasp that began at `grasp_start_tick`."""
        is_fresh = grasp_start_tick <= self._reported_tick <= tick <= self._reported_tick + self._expires_ticks
        return (
            self._reported_n if is_fresh and self._lowest_n <= self._reported_n <= self._highest_n else self._lowest_n
        )


class ForceLimiter:
    """Lowers the command that a protocol asks for, so that the jaw force settles under the limit: a share of the
    threshold.

    The tool's map from command to force tells, through the drive's lag, what force the commands so far should have come
    to by now. The force felt in proportion to that is how strong the tool is, and so tells what the next command would
    come to: commands still on their way are counted, and a map that is wrong is soon put right. Where the
    drive by itself is beyond the limit already, the command drops below what holds, until it is not.

    All forces are those that the tool shows; thresholds are brought to them with the upper end of the force scale.

    Where the force passes the limit by more than noise does, or stays over it, all the same, the grasp is let go: the
    command stays at zero until the protocol asks for zero, too.
    """

    def __init__(self, tool: Tool, library: TissueLibrary, settings: LimiterSettings) -> None:
        rate_hz = tool.board.sample_rate_hz
        self._tool = tool
        self._block_s = tool.board.block_samples / rate_hz
        self._command_to_force = tool.command_to_force
        self._margin = settings.margin
        thresholds_n = library.displayed_thresholds_n(tool).values()
        self._threshold = ActiveThreshold(thresholds_n, round(settings.limit_expires_s * rate_hz))
        self._recent_thresholds_n: deque[float] = deque(
            maxlen=1 + round(THRESHOLD_SETTLING_S / self._block_s)
        )  # thresholds, by block
        self._lowest_limit_n = self._limit_n = settings.margin * min(thresholds_n)
        self._predictor = ForcePredictor(tool)
        self._gain_ratio = 1.0  # of the tool, in proportion to its map
        self._initial_gain_ratio = (
            1.0  # a grasp that had to be let go teaches the following ones how strong the tool is
        )
        self._gain_increase_weight = -math.expm1(-self._block_s / GAIN_INCREASE_TIME_CONSTANT_S)
        self._gain_decrease_weight = -math.expm1(-self._block_s / GAIN_DECREASE_TIME_CONSTANT_S)
        self._in_grasp = self._made_contact = False  # whether a grasp is under way, and has met tissue
        self._blocks_over_limit = 0  # in a row whose force was over the limit
        self._command_v = 0.0
        self.release_reason: str | None = (
            None  # not None: the command stays at zero until the protocol asks for that, too
        )

    @property
    def limit_n(self) -> float:
        """The limit under which the force is held from the last judgement to the next, N."""
        return self._limit_n

    def reset_limit(self) -> None:
        """No protocol plays: the next one begins under the lowest limit."""
        self._limit_n = self._lowest_limit_n

    def set_threshold(self, threshold_n: float, tick: int) -> None:
        """The injury threshold, N, that the samples up to `tick` speak for; it counts until it expires."""
        self._threshold.update(threshold_n, tick)

    def limit_command(self, samples: np.ndarray, applied_v: list[float], requested_v: float) -> tuple[float, int]:
        """The command to write after a block where the protocol asks for `wanted_v`, V, and the flags that go with it.

        `samples` (dtype SAMPLE) are those since the last call, and `commands_v` the commands under which they were
        taken, V. Flags: HELD_BACK where the command is lower than wanted, LET_GO where it is zero because the force was
        over the limit.
        """
        last = samples[-1]
        threshold_n = self._threshold.value_at(int(last["tick"]), int(last["grasp_start_tick"]))
        self._recent_thresholds_n.append(threshold_n)
        force_n = compute_finite_median(samples["jaw_force_n"].tolist())
        expected_n = self._predictor.predict_block_middle(int(samples["tick"][0]), applied_v, int(last["contact_tick"]))
        self._made_contact |= bool(last["contact_tick"] >= 0)
        if requested_v <= COMMAND_ON_V:  # between grasps
            self._learn_gain_ratio()
            self._gain_ratio, self._limit_n, self.release_reason = (
                self._initial_gain_ratio,
                self._margin * threshold_n,
                None,
            )
            self._blocks_over_limit = 0
            return self._store_command(requested_v), 0
        self._in_grasp = True
        self._limit_n = min(
            self._margin * min(self._recent_thresholds_n), self._limit_n + LIMIT_RISE_N_PER_S * self._block_s
        )
        trusted_n = RATIO_REGULARIZATION_SHARE * self._limit_n
        seen = self._gain_ratio
        if force_n is not None:
            seen = (force_n + trusted_n) / (expected_n + trusted_n)
            self._update_gain_ratio(seen, in_contact=last["contact_tick"] >= 0)
            self._release_if_over_limit(force_n)
        if self.release_reason:
            return self._store_command(0.0), LIMITED | RELEASED
        most_v = min(
            self._compute_max_command_v(max(seen, self._gain_ratio), trusted_n),
            compute_max_next_command(self._command_v, self._tool),
        )
        return (self._store_command(most_v), LIMITED) if most_v < requested_v else (self._store_command(requested_v), 0)

    def _compute_max_command_v(self, gain_ratio: float, regularization_n: float) -> float:
        """The command that comes to the aim in the end, or what slows a drive down that is beyond the limit by now."""
        aim_n = SETPOINT_SHARE * self._limit_n + regularization_n
        by_map_n = aim_n / self._gain_ratio - regularization_n
        if gain_ratio * (self._predictor.actuator_force_n + regularization_n) - regularization_n > self._limit_n:
            by_map_n = min(by_map_n, self._predictor.compute_required_force_n(aim_n / gain_ratio - regularization_n))
        return max(float(self._command_to_force.to_command_v(max(by_map_n, 0.0))), MIN_LIMITED_COMMAND_V)

    def _release_if_over_limit(self, force_n: float) -> None:
        """Where the force passes the limit all the same, or does not come under it."""
        most_n = max(self._recent_thresholds_n)
        limit_n = self._margin * most_n
        self._blocks_over_limit = self._blocks_over_limit + 1 if force_n > limit_n else 0
        if self.release_reason:
            return
        if force_n > most_n:
            self.release_reason = f"the force of {force_n:.2f} N passed the injury threshold of {most_n:.2f} N"
        elif force_n > RELEASE_SHARE * limit_n:
            self.release_reason = f"the force of {force_n:.2f} N passed the limit of {limit_n:.2f} N"
        elif self._blocks_over_limit * self._block_s > THRESHOLD_SETTLING_S:
            self.release_reason = f"the force stayed over the limit of {limit_n:.2f} N, at {force_n:.2f} N"
        if self.release_reason:
            self._initial_gain_ratio = max(self._gain_ratio, 1.0)

    def _learn_gain_ratio(self) -> None:
        """What the grasp that is over says of the next one; without contact it says nothing, and a doubt is halved."""
        if self._in_grasp and self.release_reason is None:
            learned = max(self._gain_ratio, 1.0)
            self._initial_gain_ratio = learned if self._made_contact else 0.5 * (learned + 1.0)
        self._in_grasp = self._made_contact = False

    def _store_command(self, command_v: float) -> float:
        self._command_v = command_v
        return command_v

    def _update_gain_ratio(self, measured_ratio: float, *, in_contact: bool) -> None:
        """Follow how strong the tool is. Without contact there is no force yet, which says nothing of the map."""
        if measured_ratio > self._gain_ratio:
            self._gain_ratio += (measured_ratio - self._gain_ratio) * self._gain_increase_weight
        elif in_contact:
            self._gain_ratio += (measured_ratio - self._gain_ratio) * self._gain_decrease_weight


class ForcePredictor:
    """What the commands should have come to by now, according to the map and through two lags: drive, then tissue."""

    def __init__(self, tool: Tool) -> None:
        self._sample_weight = -math.expm1(
            -1.0 / (tool.board.sample_rate_hz * LAG_TIME_CONSTANT_S)
        )  # of a lag, in one sample
        self._block_weight = -math.expm1(-tool.board.block_samples / (tool.board.sample_rate_hz * LAG_TIME_CONSTANT_S))
        self._command_to_force = tool.command_to_force
        self._command_v, self._commanded_force_n = 0.0, 0.0  # the command that was on last, and what it asks for
        self.actuator_force_n, self._measured_force_n = 0.0, 0.0  # after the first lag and after both
        self._contact_tick = -1

    def predict_block_middle(self, first_tick: int, commands_v: list[float], contact_tick: int) -> float:
        """Follow a block taken under these commands, V; returns the force, N, at its middle.

        Jaws that came freely begin at no force when they touch, at `contact_tick`; until then it is -1.
        """
        if contact_tick >= 0 and contact_tick != self._contact_tick:
            self._measured_force_n = self.actuator_force_n * (
                1.0 - (1.0 - self._sample_weight) ** max(first_tick - contact_tick, 0)
            )
        self._contact_tick = contact_tick
        middle_n = self._measured_force_n
        for i, command_v in enumerate(commands_v):
            if command_v != self._command_v:
                self._command_v, self._commanded_force_n = (
                    command_v,
                    float(self._command_to_force.to_force_n(command_v)),
                )
            self.actuator_force_n += (self._commanded_force_n - self.actuator_force_n) * self._sample_weight
            if first_tick + i >= contact_tick:
                self._measured_force_n += (self.actuator_force_n - self._measured_force_n) * self._sample_weight
            if i == len(commands_v) // 2:
                middle_n = self._measured_force_n
        return middle_n

    def compute_required_force_n(self, target_force_n: float) -> float:
        """What has to be asked for, so that the drive comes to a force within a block; may be less than nothing."""
        return self.actuator_force_n + (target_force_n - self.actuator_force_n) / self._block_weight


def compute_finite_median(values: list[float]) -> float | None:
    """The median of the known forces of a block, N, which a single spike does not move; None where none is known."""
    known = sorted(value for value in values if math.isfinite(value))
    return known[len(known) // 2] if known else None
