"""The simulated grasper: motor command in, raw sensor volts and degrees out, one sample a call."""

import math
from dataclasses import dataclass

import numpy as np

from acquisition.calibration import from_jaw
from config.errors import ConfigurationError
from config.schema import TissueLibrary, Tool

SUBSTEPS = 5  # stable up to 1e6 N/m on 5 g
TOUCHED_V = 5.0
SHUT_SHARE = 0.98  # of the thickness: the jaws meet
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

    def advance(
        self, x_m: float, v_m_per_s: float, begin_n: float, end_n: float, dt_s: float
    ) -> tuple[float, float]:
        """One Runge-Kutta step (4th order) under a force that goes straight from `begin_n` to `end_n`."""
        middle_n, half_s = 0.5 * (begin_n + end_n), 0.5 * dt_s
        v1, a1 = v_m_per_s, self._acceleration(x_m, v_m_per_s, begin_n)
        v2 = v_m_per_s + half_s * a1
        a2 = self._acceleration(x_m + half_s * v1, v2, middle_n)
        v3 = v_m_per_s + half_s * a2
        a3 = self._acceleration(x_m + half_s * v2, v3, middle_n)
        v4 = v_m_per_s + dt_s * a3
        a4 = self._acceleration(x_m + dt_s * v3, v4, end_n)
        return x_m + dt_s / 6 * (v1 + 2 * v2 + 2 * v3 + v4), v_m_per_s + dt_s / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    def _acceleration(self, x_m: float, v_m_per_s: float, force_n: float) -> float:
        elastic = self.alpha_n * math.expm1(min(self.beta_per_m * x_m, 50.0))
        return (force_n - self.damping_kg_per_s * v_m_per_s - elastic) / self.mass_kg


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
        self._noise = np.random.default_rng([seed, 0])
        self._rest_v = tool.calibration.rest_offset_v + REST_SCATTER_V * float(self._noise.standard_normal())
        self._noise_v: list[float] = []
        self._grasps = 0
        self._closing = False
        self.tissue = tissue
        self.specimen = self._draw()
        self.drive_n = 0.0
        self.force_n = 0.0
        self.jaw_m = 0.0
        self.x_m = 0.0
        self._v_m_per_s = 0.0
        self.in_contact = False

    def hold(self, tissue: str) -> None:
        """What the next grasp finds between the jaws."""
        self.tissue = tissue

    def step(self, command_v: float) -> tuple[float, float, float, float]:
        """Advance one sample with the command held; returns strain V, encoder degrees, touch 1 V, touch 2 V."""
        if command_v > 0 and not self._closing:
            self._grasps += 1
            self.specimen = self._draw()
        self._closing = command_v > 0
        self._move(command_v)
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

    def _move(self, command_v: float) -> None:
        mechanics, dt_s = self._mechanics, self._dt_s
        target_n = float(self._tool.command_to_force.force(command_v))
        self.drive_n += (target_n - self.drive_n) * -math.expm1(-dt_s / mechanics.drive_lag_s)
        if command_v <= 0 and self.drive_n < OPENING_BELOW_N:
            self._open()
        elif self.in_contact:
            self._squeeze()
        else:
            self.jaw_m += self.drive_n / mechanics.free_drag_kg_per_s * dt_s
            self.in_contact = self.jaw_m >= mechanics.free_travel_m
            self.x_m = max(self.jaw_m - mechanics.free_travel_m, 0.0)
            self._v_m_per_s, self.force_n = 0.0, 0.0

    def _squeeze(self) -> None:
        """The drive's force reaches the tissue through the cable and deforms it; shut jaws take any force."""
        mechanics, specimen = self._mechanics, self.specimen
        begin_n = self.force_n
        self.force_n += (self.drive_n - self.force_n) * -math.expm1(-self._dt_s / mechanics.contact_lag_s)
        step_n = (self.force_n - begin_n) / SUBSTEPS
        for k in range(SUBSTEPS):
            self.x_m, self._v_m_per_s = specimen.advance(
                self.x_m, self._v_m_per_s, begin_n + k * step_n, begin_n + (k + 1) * step_n, self._dt_s / SUBSTEPS
            )
        shut_m = SHUT_SHARE * specimen.thickness_m
        if self.x_m > shut_m:
            self.x_m, self._v_m_per_s = shut_m, 0.0
        self.jaw_m = mechanics.free_travel_m + self.x_m

    def _open(self) -> None:
        """The return spring takes the jaws back; they leave the tissue."""
        self.in_contact, self.force_n = False, 0.0
        self.x_m, self._v_m_per_s = 0.0, 0.0
        self.jaw_m *= math.exp(-self._dt_s / self._mechanics.opening_time_s)

    def _read_strain(self, strain_v: float) -> float:
        if not self._noise_v:
            self._noise_v = (self._noise.standard_normal(1000) * self._tool.noise.strain_sd_v).tolist()
        volts = self._rest_v + strain_v + self._noise_v.pop()
        lsb = self._tool.noise.strain_lsb_v
        return round(volts / lsb) * lsb if lsb else volts

    def _read_encoder(self, encoder_deg: float) -> float:
        count = self._tool.calibration.encoder_resolution_deg
        return math.floor(encoder_deg / count) * count
