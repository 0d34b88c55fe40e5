"""A map from the signals at a drive to the force at the jaws, through a transmission with friction of both directions.

While the drive moves in direction s (+1 or -1), all friction opposes it, and the jaw force F follows from the drive
force D and the drive position p:

    F = f_s(D, p) = a_s + b_s D + c_s p

Both directions have coefficients of their own, because friction grows with the load. After a reversal the drive force
crosses the friction band, which the jaws do not feel: F keeps its value between f_-1 and f_+1. That is a play operator
with moving limits (M. Brokate, J. Sprekels: Hysteresis and Phase Transitions, 1996). A new direction counts once the
drive has traveled r in it. From then on F approaches f_s, the faster the longer the travel q, which is a variant of the
friction of P. Dahl (A solid friction model, 1968). So F follows a load that changes while the drive moves on:

    F_i = clip(F_(i-1), min(f_-1, f_+1), max(f_-1, f_+1)), and then, for each step dp in direction s,
    F_i += (f_s - F_i)(1 - exp(-|dp| q_i / r^2))

Before the first travel of r the direction is unknown, and F only known to lie in the band. The map takes past samples
only, no velocity and no sampling rate. Forces and positions have the units of the signals that it was fitted to.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of the drive at each sample, (n,) each.

    Attributes:
        direction: +1 or -1; 0 until the first travel of r.
        travel: distance in this direction since it counts, in units of the position; it never falls before a reversal.
        gain: share 1 - exp(-|dp| q / r^2) by which the force approaches its branch; 0 without motion.
    """

    direction: np.ndarray
    travel: np.ndarray
    gain: np.ndarray


@dataclass(frozen=True, slots=True)
class ForceEstimate:
    """Jaw force and its standard uncertainty, (n,) each, and whether it lies in the range of forces that was fitted."""

    force: np.ndarray
    sd: np.ndarray
    in_range: np.ndarray


@dataclass(frozen=True, slots=True)
class DriveMap:
    """A fitted map from drive to jaws.

    Attributes:
        coefficients: a, b, c of the forward direction (position rises), then of the backward direction, (6,).
        reversal_travel: r, the travel after which a new direction counts, in units of the drive position.
        residual_sd: standard uncertainty of the force once the direction is known, in units of the jaw force.
        lowest: lowest jaw force that was fitted.
        highest: highest one.
    """

    coefficients: np.ndarray
    reversal_travel: float
    residual_sd: float
    lowest: float
    highest: float

    def predict(self, drive_force: np.ndarray, drive_position: np.ndarray) -> ForceEstimate:
        """Return the jaw force for (n,) drive forces and positions in the order of time.

        Before the direction is known, the force is the middle of the friction band within the fitted range, and the
        uncertainty contains the width of the band.
        """
        motion = follow_motion(drive_position, self.reversal_travel)
        forward, backward = compute_branches(self.coefficients, drive_force, drive_position)
        force = follow_friction(forward, backward, motion)
        start = motion.direction == 0
        ends = np.clip([forward[start], backward[start]], self.lowest, self.highest)
        force[start] = ends.mean(axis=0)
        sd = np.full(len(force), self.residual_sd)
        sd[start] = np.hypot(self.residual_sd, np.ptp(ends, axis=0) / sqrt(12.0))  # of a rectangular distribution
        in_range = (force >= self.lowest) & (force <= self.highest)
        in_range[start] = np.ptp(ends, axis=0) > 0.0  # else the whole band lies beyond
        return ForceEstimate(force, sd, in_range)


def compute_branches(
    coefficients: np.ndarray, drive_force: np.ndarray, drive_position: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the jaw force of sliding forward and backward, f_+1 and f_-1, (n,) each, for (6,) coefficients."""
    regressors = build_regressors(drive_force, drive_position)
    return regressors @ coefficients[:3], regressors @ coefficients[3:]


def build_regressors(drive_force: np.ndarray, drive_position: np.ndarray) -> np.ndarray:
    """Return 1, drive force and drive position in columns, (n, 3)."""
    return np.column_stack([np.ones(len(drive_force)), drive_force, drive_position])


def follow_motion(position: np.ndarray, reversal_travel: float) -> Motion:
    """Follow the direction of (n,) positions; motion back by less than `reversal_travel` is no reversal."""
    direction, travel, gain = np.zeros(len(position), int), np.zeros(len(position)), np.zeros(len(position))
    start = furthest = float(position[0]) if len(position) else 0.0
    sign, traveled = 0, 0.0
    for n, at in enumerate(position.tolist()):
        ahead = (at - furthest) * sign
        if (sign == 0 and abs(at - start) >= reversal_travel) or (sign and ahead <= -reversal_travel):
            sign, furthest, traveled = (1 if at > furthest else -1), at, 0.0
        elif ahead > 0.0:
            furthest, traveled = at, traveled + ahead
            gain[n] = ahead * traveled / reversal_travel**2
        direction[n], travel[n] = sign, traveled
    return Motion(direction, travel, -np.expm1(-gain))


def follow_friction(forward: np.ndarray, backward: np.ndarray, motion: Motion) -> np.ndarray:
    """Return the jaw force in the friction band between both branches, (n,); NaN while the direction is unknown."""
    lower, upper = np.minimum(forward, backward), np.maximum(forward, backward)
    branch = np.where(motion.direction > 0, forward, backward)
    found = np.full(len(branch), np.nan)
    known = np.flatnonzero(motion.direction)
    begin = int(known[0]) if len(known) else len(branch)
    rows = zip(*(each[begin:].tolist() for each in (lower, upper, branch, motion.gain)), strict=True)
    force = float(branch[begin]) if len(known) else 0.0
    for n, (low, high, target, gain) in enumerate(rows, begin):
        force = low if force < low else min(force, high)
        force += (target - force) * gain
        found[n] = force
    return found
