"""The simulated grasper: motor command in, raw sensor volts and degrees out, one sample a call."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from acquisition.calibration import from_jaw, to_jaw
from config.errors import ConfigurationError
from config.schema import TissueLibrary, Tool

SUBSTEPS = 5  # stable up to 1e6 N/m on 5 g
TOUCHED_V = 5.0
SHUT_SHARE = 0.98  # of the thickness, or of what the linkage can reach: the jaws are shut
OPENING_BELOW_N = 0.02
REST_SCATTER_V = 0.005  # rest voltages of the recordings differ by this much


@dataclass(frozen=True, slots=True)
class Specimen:
    """One piece of tissue: u = m x'' + d x' + alpha (exp(beta x) - 1), Eq. (7)."""

    tissue: str
    alpha_n: float
    beta_per_m: float
    damping_kg_per_s: float
    mass_kg: float
    thickness_m: float


@njit(cache=True)
def squeeze(x_m, v_m_per_s, begin_n, end_n, dt_s, alpha_n, beta_per_m, damping_kg_per_s, mass_kg):
    """Displacement and velocity of tissue after `dt_s` under a force that goes straight from `begin_n` to `end_n`.

    Runge-Kutta, 4th order, of Eq. (7): another method than the estimator's on purpose.
    """
    step_s, half_s = dt_s / SUBSTEPS, 0.5 * dt_s / SUBSTEPS
    for k in range(SUBSTEPS):
        first_n = begin_n + (end_n - begin_n) * k / SUBSTEPS
        last_n = begin_n + (end_n - begin_n) * (k + 1) / SUBSTEPS
        middle_n = 0.5 * (first_n + last_n)
        v1, a1 = v_m_per_s, _acceleration(x_m, v_m_per_s, first_n, alpha_n, beta_per_m, damping_kg_per_s, mass_kg)
        v2 = v1 + half_s * a1
        a2 = _acceleration(x_m + half_s * v1, v2, middle_n, alpha_n, beta_per_m, damping_kg_per_s, mass_kg)
        v3 = v1 + half_s * a2
        a3 = _acceleration(x_m + half_s * v2, v3, middle_n, alpha_n, beta_per_m, damping_kg_per_s, mass_kg)
        v4 = v1 + step_s * a3
        a4 = _acceleration(x_m + step_s * v3, v4, last_n, alpha_n, beta_per_m, damping_kg_per_s, mass_kg)
        x_m += step_s / 6 * (v1 + 2 * (v2 + v3) + v4)
        v_m_per_s += step_s / 6 * (a1 + 2 * (a2 + a3) + a4)
    return x_m, v_m_per_s


@njit(cache=True)
def _acceleration(x_m, v_m_per_s, force_n, alpha_n, beta_per_m, damping_kg_per_s, mass_kg):
    elastic_n = alpha_n * math.expm1(min(beta_per_m * x_m, 50.0))
    return (force_n - damping_kg_per_s * v_m_per_s - elastic_n) / mass_kg


class SimulatedGrasper:
    """Command → drive lag → free travel → contact → tissue → inverse of Eqs. (1) to (6) → noisy volts and counts.

    Every grasp holds a new specimen of the tissue, drawn from the profile and its spread with `seed`.
    """

    def __init__(self, tool: Tool, library: TissueLibrary, tissue: str, seed: int) -> None:
        if tool.simulation is None:
            raise ConfigurationError(f"The tool {tool.name!r} has no [simulation] table; it cannot be simulated.")
        self._tool, self._mechanics, self._library = tool, tool.simulation, library
        self._dt_s = 1.0 / tool.board.sample_rate_hz
        self._seed = seed
        sweep = to_jaw(tool, np.zeros(400), np.arange(400.0))
        self._reach_m = SHUT_SHARE * float(np.nanmax(sweep.displacement_m))
        self._noise = np.random.default_rng([seed, 0])
        self._rest_v = tool.calibration.rest_offset_v + REST_SCATTER_V * float(self._noise.standard_normal())
        self._noise_v: list[float] = []
        self._grasps = 0
        self._command_v, self._target_n = 0.0, 0.0
        self._drive_share = -math.expm1(-self._dt_s / self._mechanics.drive_lag_s)
        self._contact_share = -math.expm1(-self._dt_s / self._mechanics.contact_lag_s)
        self._opening_share = math.exp(-self._dt_s / self._mechanics.opening_time_s)
        self.tissue = tissue
        self.specimen = self._draw()
        self.drive_n = 0.0
        self.force_n = 0.0
        self.jaw_m = 0.0
        self.x_m = 0.0
        self._v_m_per_s = 0.0
        self.in_contact = False
        squeeze(0.0, 0.0, 0.0, 0.0, self._dt_s, 1.0, 1.0, 1.0, 1.0)  # compiled now, not in the first grasp

    def hold(self, tissue: str) -> None:
        """What the next grasp finds between the jaws."""
        self.tissue = tissue

    def step(self, command_v: float) -> tuple[float, float, float, float]:
        """Advance one sample with the command held; returns strain V, encoder degrees, touch 1 V, touch 2 V."""
        if command_v != self._command_v:
            self._set_command(command_v)
        self._move()
        strain_v, encoder_deg = from_jaw(self._tool, self.force_n, self.jaw_m)
        touch_v = TOUCHED_V if self.in_contact else 0.0
        return self._read_strain(strain_v), self._read_encoder(encoder_deg), touch_v, touch_v

    def _draw(self) -> Specimen:
        profile, spread = self._library.tissues[self.tissue], self._library.spread_of(self.tissue)
        scatter = np.random.default_rng([self._seed, 1, self._grasps]).standard_normal(3) * self._mechanics.spread_scale
        return Specimen(
            self.tissue,
            profile.alpha_n * math.exp(spread.log_alpha * scatter[0]),
            profile.beta_per_m * math.exp(spread.log_beta * scatter[1]),
            profile.damping_kg_per_s * math.exp(spread.log_damping * scatter[2]),
            self._library.mass_kg,
            profile.thickness_m,
        )

    def _set_command(self, command_v: float) -> None:
        if self._command_v <= 0 and not self.in_contact:  # the jaws close anew
            self._grasps += 1
            self.specimen = self._draw()
        self._command_v = command_v
        self._target_n = float(self._tool.command_to_force.force(command_v))

    def _move(self) -> None:
        self.drive_n += (self._target_n - self.drive_n) * self._drive_share
        if self._command_v <= 0 and self.drive_n < OPENING_BELOW_N:
            self._open()
        elif self.in_contact:
            self._squeeze()
        else:
            self._approach()

    def _approach(self) -> None:
        """Jaws move freely until they touch."""
        free_m = self._mechanics.free_travel_m
        self.jaw_m += self.drive_n / self._mechanics.free_drag_kg_per_s * self._dt_s
        self.in_contact = self.jaw_m >= free_m
        self.x_m = max(self.jaw_m - free_m, 0.0)
        self._v_m_per_s, self.force_n = 0.0, 0.0

    def _squeeze(self) -> None:
        """The drive's force reaches the tissue through the cable and deforms it; shut jaws take any force."""
        begin_n = self.force_n
        self.force_n += (self.drive_n - self.force_n) * self._contact_share
        held = self.specimen
        x_m, v_m_per_s = squeeze(
            self.x_m, self._v_m_per_s, begin_n, self.force_n, self._dt_s,
            held.alpha_n, held.beta_per_m, held.damping_kg_per_s, held.mass_kg,
        )  # fmt: skip
        shut_m = min(SHUT_SHARE * held.thickness_m, self._reach_m - self._mechanics.free_travel_m)
        if x_m > shut_m:
            x_m, v_m_per_s = shut_m, 0.0
        self.x_m, self._v_m_per_s = x_m, v_m_per_s
        self.jaw_m = self._mechanics.free_travel_m + x_m

    def _open(self) -> None:
        """The return spring takes the jaws back; the tissue follows until they leave it."""
        self.jaw_m *= self._opening_share
        self.x_m = max(self.jaw_m - self._mechanics.free_travel_m, 0.0)
        self.in_contact = self.x_m > 0.0
        self.force_n, self._v_m_per_s = 0.0, 0.0

    def _read_strain(self, strain_v: float) -> float:
        if not self._noise_v:
            self._noise_v = (self._noise.standard_normal(1000) * self._tool.noise.strain_sd_v).tolist()
        volts = self._rest_v + strain_v + self._noise_v.pop()
        lsb = self._tool.noise.strain_lsb_v
        return round(volts / lsb) * lsb if lsb else volts

    def _read_encoder(self, encoder_deg: float) -> float:
        count = self._tool.calibration.encoder_resolution_deg
        return math.floor(encoder_deg / count) * count
