"""The class ForceLimiter, and the function that finds a reason to stop the motor, by each block's unfiltered force."""

import math
from collections import deque
from collections.abc import Collection

import numpy as np

from acquisition.sample_block import SampleFlag
from acquisition.signals.grasp_tracker import COMMAND_ON_V
from config.schema import LimiterSettings, TissueLibrary, Tool

INVALID, SATURATED, IN_GRASP = SampleFlag.INVALID.value, SampleFlag.SATURATED.value, SampleFlag.IN_GRASP.value
LIMITED, RELEASED = SampleFlag.LIMITED.value, SampleFlag.RELEASED.value

# The command reaches the force through two such lags. In simulation: 8 ms of drive, 10 ms of cable and tissue.
LAG_TIME_CONSTANT_S = 0.009
GAIN_INCREASE_TIME_CONSTANT_S = 0.003  # a higher gain ratio is followed mostly within a block
GAIN_DECREASE_TIME_CONSTANT_S = 0.2  # a lower one slowly, because the force may only be late
# Share of the limit, added to both forces before their ratio is taken, because small forces are mostly noise.
RATIO_REGULARIZATION_SHARE = 0.08
LIMIT_RISE_N_PER_S = 10.0  # rise of the limit: 0.25 N at most in the 25 ms until an error shows in the force
# Time that the force gets to follow a falling threshold: five times the lags of drive and tissue. A rising threshold
# must hold for as long before it is followed, so that late answers do not shake the motor.
THRESHOLD_SETTLING_S = 0.1
ROUNDING_TOLERANCE = 1e-9
SETPOINT_SHARE = 0.93  # of the limit: noise, cable friction and a gage that reads 3 % low stay below the limit
RELEASE_SHARE = 1.05  # of the limit: a force over it releases the grasp
MIN_LIMITED_COMMAND_V = 0.05  # a limited grasp goes on: at 0 V the jaws would open


def find_stop_reason(tool: Tool, samples: np.ndarray) -> str | None:
    """Return why the motor must stop after these samples, or None.

    The force is compared with the ceiling in the newtons of the force scale's upper end. The mean of a block counts, so
    that one spike of the strain gage does not end a grasp. A force that cannot be known counts as too large: the strain
    gage is saturated, or the sensors in a grasp are outside the domain of the kinematics.
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
        return "the sensors are outside the range of the tool's kinematics: the force is not known"
    known = np.isfinite(force_n)
    mean_n = float(force_n[known].mean()) if known.any() else 0.0
    if mean_n > ceiling_n:
        return f"force {mean_n:.2f} N is over the ceiling of {ceiling_n:.2f} N"
    return None


def compute_max_command_by_rise_limit(command_v: float, tool: Tool) -> float:
    """Return the highest command, V, that may follow a block under `command_v`, by the tool's limit on its rise."""
    block_s = tool.board.block_samples / tool.board.sample_rate_hz
    return command_v + tool.limits.max_command_v_per_s * block_s * (1 + ROUNDING_TOLERANCE)


class ActiveThreshold:
    """The injury threshold in force, N: the reported one while it is fresh and of this grasp, else the lowest."""

    def __init__(self, thresholds_n: Collection[float], expires_ticks: int) -> None:
        """The injury threshold in force, N: the reported one while it is fresh and of this grasp, else the lowest."""
        self._lowest_n, self._highest_n = min(thresholds_n), max(thresholds_n)
        self._expires_ticks = expires_ticks
        self._reported_n, self._reported_tick = self._lowest_n, -1

    def update(self, threshold_n: float, tick: int) -> None:
        """Store the threshold reported for sample `tick`; `value_at` ignores one outside the library's range."""
        self._reported_n, self._reported_tick = threshold_n, tick

    def value_at(self, tick: int, grasp_start_tick: int) -> float:
        """Return the threshold at sample `tick` of the grasp that began at `grasp_start_tick`."""
        is_fresh = grasp_start_tick <= self._reported_tick <= tick <= self._reported_tick + self._expires_ticks
        return (
            self._reported_n if is_fresh and self._lowest_n <= self._reported_n <= self._highest_n else self._lowest_n
        )


class ForceLimiter:
    """Limiter that lowers a protocol's command so that the jaw force settles under the limit, a share of the threshold.

    From the commands so far, the tool's map and the drive's lag predict the force. The ratio of measured to predicted
    force is the gain ratio, which says how strong the tool is. With it the limiter predicts the force of the next
    command. So it accounts for commands that have not taken effect yet, and soon corrects a wrong map. If the drive
    alone already exceeds the limit, the command drops below the settling one until it does not.

    All forces are those that the tool shows; the upper end of the force scale converts thresholds to them.

    If the force passes the limit by more than noise, or stays over it, the limiter releases the grasp. Then the command
    stays at zero until the protocol asks for zero, too.
    """

    def __init__(self, tool: Tool, library: TissueLibrary, settings: LimiterSettings) -> None:
        rate_hz = tool.board.sample_rate_hz
        self._tool = tool
        self._block_s = tool.board.block_samples / rate_hz
        self._command_to_force = tool.command_to_force
        self._margin = settings.margin
        thresholds_n = library.convert_thresholds_to_displayed_n(tool).values()
        self._threshold = ActiveThreshold(thresholds_n, round(settings.limit_expires_s * rate_hz))
        self._recent_thresholds_n: deque[float] = deque(
            maxlen=1 + round(THRESHOLD_SETTLING_S / self._block_s)
        )  # one a block
        self._lowest_limit_n = self._limit_n = settings.margin * min(thresholds_n)
        self._predictor = ForcePredictor(tool)
        self._gain_ratio = 1.0  # measured force in proportion to the map's
        # Gain ratio with which the next grasp begins, learned from the last one.
        self._initial_gain_ratio = 1.0
        self._gain_increase_weight = -math.expm1(-self._block_s / GAIN_INCREASE_TIME_CONSTANT_S)
        self._gain_decrease_weight = -math.expm1(-self._block_s / GAIN_DECREASE_TIME_CONSTANT_S)
        self._in_grasp = self._made_contact = False  # whether a grasp is under way, and has met tissue
        self._blocks_over_limit = 0  # consecutive blocks with a force over the limit
        self._command_v = 0.0
        # If not None, the command stays at zero until the protocol asks for zero, too.
        self.release_reason: str | None = None

    @property
    def limit_n(self) -> float:
        """The limit enforced since the last call of `limit_command`, N."""
        return self._limit_n

    def reset_limit(self) -> None:
        """Reset the limit to the lowest, under which the next protocol begins."""
        self._limit_n = self._lowest_limit_n

    def set_threshold(self, threshold_n: float, tick: int) -> None:
        """Set the injury threshold in force, N, as known at sample `tick`; it counts until it expires."""
        self._threshold.update(threshold_n, tick)

    def limit_command(self, samples: np.ndarray, applied_v: list[float], requested_v: float) -> tuple[float, int]:
        """Return the command to write after a block, V, and its flags.

        `samples` (dtype SAMPLE_DTYPE) are those since the last call, `applied_v` the commands under which they were
        taken, V. The protocol asks for `requested_v`, V. Flags: LIMITED if the command is lower than requested, and
        RELEASED if it is zero because the force was over the limit.
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
            compute_max_command_by_rise_limit(self._command_v, self._tool),
        )
        return (self._store_command(most_v), LIMITED) if most_v < requested_v else (self._store_command(requested_v), 0)

    def _compute_max_command_v(self, gain_ratio: float, regularization_n: float) -> float:
        """Return the command that settles at the setpoint, V; less while the drive's force exceeds the limit."""
        aim_n = SETPOINT_SHARE * self._limit_n + regularization_n
        by_map_n = aim_n / self._gain_ratio - regularization_n
        if gain_ratio * (self._predictor.actuator_force_n + regularization_n) - regularization_n > self._limit_n:
            by_map_n = min(by_map_n, self._predictor.compute_required_force_n(aim_n / gain_ratio - regularization_n))
        return max(float(self._command_to_force.to_command_v(max(by_map_n, 0.0))), MIN_LIMITED_COMMAND_V)

    def _release_if_over_limit(self, force_n: float) -> None:
        """Release the grasp if the force passes the limit by too much or stays over it for too long."""
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
        """Keep the finished grasp's gain ratio for the next one; without contact, halve its excess over 1."""
        if self._in_grasp and self.release_reason is None:
            learned = max(self._gain_ratio, 1.0)
            self._initial_gain_ratio = learned if self._made_contact else 0.5 * (learned + 1.0)
        self._in_grasp = self._made_contact = False

    def _store_command(self, command_v: float) -> float:
        self._command_v = command_v
        return command_v

    def _update_gain_ratio(self, measured_ratio: float, *, in_contact: bool) -> None:
        """Follow the gain ratio. A low ratio without contact says nothing of the map, because there is no force yet."""
        if measured_ratio > self._gain_ratio:
            self._gain_ratio += (measured_ratio - self._gain_ratio) * self._gain_increase_weight
        elif in_contact:
            self._gain_ratio += (measured_ratio - self._gain_ratio) * self._gain_decrease_weight


class ForcePredictor:
    """Prediction of the force of the commands so far: the map, then two lags in series, drive and tissue."""

    def __init__(self, tool: Tool) -> None:
        # Weights of a lag's update in one sample and in one block.
        self._sample_weight = -math.expm1(-1.0 / (tool.board.sample_rate_hz * LAG_TIME_CONSTANT_S))
        self._block_weight = -math.expm1(-tool.board.block_samples / (tool.board.sample_rate_hz * LAG_TIME_CONSTANT_S))
        self._command_to_force = tool.command_to_force
        self._command_v, self._commanded_force_n = 0.0, 0.0  # last command, and its force by the map
        self.actuator_force_n, self._measured_force_n = 0.0, 0.0  # after the first lag and after both
        self._contact_tick = -1

    def predict_block_middle(self, first_tick: int, commands_v: list[float], contact_tick: int) -> float:
        """Follow a block taken under these commands, V; return the predicted force at its middle, N.

        Jaws that closed freely begin at zero force at `contact_tick`, which is -1 before contact.
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
        """Return the force to command, N, so that the drive reaches the target in a block; may be negative."""
        return self.actuator_force_n + (target_force_n - self.actuator_force_n) / self._block_weight


def compute_finite_median(values: list[float]) -> float | None:
    """Return the median of a block's finite values, which a single spike does not move; None without one."""
    known = sorted(value for value in values if math.isfinite(value))
    return known[len(known) // 2] if known else None
