"""The simulated grasper: motor command in, raw sensor volts and degrees out, one sample a call."""

import math

import numpy as np

from acquisition.calibration import from_jaw, to_jaw
from acquisition.simulation.tissue import EXACT, Deviation, Material, Specimen, squeeze
from config.errors import ConfigurationError
from config.schema import TissueLibrary, Tool

TOUCHED_V = 5.0
SHUT_SHARE = 0.98  # of the thickness, or of what the linkage can reach: the jaws are shut
OPENING_BELOW_N = 0.02
REST_SCATTER_V = 0.005  # rest voltages of the recordings differ by this much
FRICTION_AT_M_PER_S = 1e-3  # jaw speed from which on the cable's friction is whole
BACKLASH_N = 0.1  # force that tightens the cable
SLIPPED_SHARE = 0.02  # of the tissue that stays between the jaws after it has slipped


class SimulatedGrasper:
    """Command → drive lag → free travel → contact → tissue → inverse of Eqs. (1) to (6) → noisy volts and counts.

    Every grasp holds a new specimen of the tissue, drawn from the profile and its spread with `seed`. `deviation` makes
    truth and sensors differ from what the estimator assumes.
    """

    def __init__(
        self, tool: Tool, library: TissueLibrary, tissue: str, seed: int, deviation: Deviation = EXACT
    ) -> None:
        if tool.simulation is None:
            raise ConfigurationError(f"The tool {tool.name!r} has no [simulation] table; it cannot be simulated.")
        self._tool, self._mechanics, self._library = tool, tool.simulation, library
        self._deviation = deviation
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
        self.gauge_m: float | None = None  # thickness of a rigid gauge instead of tissue; 0: the jaws are empty
        self.hung_n = 0.0  # pull of a weight on the handle
        self.specimen = self._draw()
        self.drive_n = 0.0
        self.force_n = 0.0
        self.jaw_m = 0.0
        self.x_m = 0.0
        self._v_m_per_s, self._relaxed_n = 0.0, 0.0
        self._held_s = 0.0
        self._phase = 2 * math.pi * float(np.random.default_rng([seed, 2]).random())  # of the tissue's own motion
        self.in_contact = False
        squeeze(0.0, 0.0, 0.0, 0.0, 0.0, self._dt_s, 0.0, self.specimen.material)  # compiled now, not in a grasp

    def hold(self, tissue: str) -> None:
        """What the next grasp finds between the jaws."""
        self.tissue = tissue

    def step(self, command_v: float) -> tuple[float, float, float, float]:
        """Advance one sample with the command held; returns strain V, encoder degrees, touch 1 V, touch 2 V."""
        if command_v != self._command_v:
            self._set_command(command_v)
        self._move()
        strain_v, encoder_deg = from_jaw(self._tool, *self._at_the_handle())
        touch_v = TOUCHED_V if self.in_contact and self.x_m >= self._deviation.touch_late_m else 0.0
        return self._read_strain(strain_v), self._read_encoder(encoder_deg), touch_v, touch_v

    def _at_the_handle(self) -> tuple[float, float]:
        """Force and displacement as strain gage and encoder see them through the cable."""
        off = self._deviation
        friction = off.friction_share * math.tanh(self._v_m_per_s / FRICTION_AT_M_PER_S)
        tightened_m = -off.backlash_m * math.expm1(-self.force_n / BACKLASH_N)
        return self.force_n * off.force_scale * (1.0 + friction), self.jaw_m + tightened_m

    def _draw(self) -> Specimen:
        scatter = np.random.default_rng([self._seed, 1, self._grasps]).standard_normal(4) * self._mechanics.spread_scale
        return Specimen.draw(self._library, self.tissue, scatter.tolist(), self._deviation)

    @property
    def _free_m(self) -> float:
        """How far the jaws move before they touch: thick tissue fills them; empty ones meet each other."""
        opening_m = self._tool.geometry.opening_m
        if self.gauge_m is not None:
            return min(self._reach_m, self._reach_m if opening_m is None else opening_m - self.gauge_m)
        least_m = self._mechanics.free_travel_m
        return least_m if opening_m is None else max(least_m, opening_m - self.specimen.thickness_m)

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
        free_m = self._free_m
        self.jaw_m += self.drive_n / self._mechanics.free_drag_kg_per_s * self._dt_s
        self.in_contact = self.jaw_m >= free_m
        self.x_m = max(self.jaw_m - free_m, 0.0)
        self._v_m_per_s, self._relaxed_n, self._held_s, self.force_n = 0.0, 0.0, 0.0, 0.0

    def _squeeze(self) -> None:
        """The drive's force reaches the tissue through the cable and deforms it; shut jaws take any force."""
        begin_n = self.force_n
        self.force_n += (self.drive_n - self.force_n) * self._contact_share
        self._held_s += self._dt_s
        x_m, v_m_per_s, self._relaxed_n = squeeze(
            self.x_m, self._v_m_per_s, self._relaxed_n, begin_n, self.force_n, self._dt_s, self._moved_m(), self._held()
        )
        rigid = self.gauge_m is not None
        shut_m = 0.0 if rigid else min(SHUT_SHARE * self.specimen.thickness_m, self._reach_m - self._free_m)
        if x_m > shut_m:
            x_m, v_m_per_s = shut_m, 0.0
        self.x_m, self._v_m_per_s = x_m, v_m_per_s
        self.jaw_m = self._free_m + x_m

    def _moved_m(self) -> float:
        """How far the body moves the tissue against the jaws."""
        off = self._deviation
        if not off.motion_m:
            return 0.0
        turn = 2 * math.pi * off.motion_hz * self._held_s
        return off.motion_m * (math.sin(turn + self._phase) - math.sin(self._phase))

    def _held(self) -> Material:
        """What is between the jaws now: less and less where the tissue slips."""
        material, off = self.specimen.material, self._deviation
        slipping = (self._held_s - off.slips_after_s) / off.slips_within_s
        if slipping <= 0:
            return material
        share = max(1.0 - slipping, SLIPPED_SHARE)
        return material._replace(alpha_n=material.alpha_n * share, damping_kg_per_s=material.damping_kg_per_s * share)

    def _open(self) -> None:
        """The return spring takes the jaws back; the tissue follows until they leave it."""
        self.jaw_m *= self._opening_share
        self.x_m = max(self.jaw_m - self._free_m, 0.0)
        self.in_contact = self.x_m > 0.0
        self.force_n, self._v_m_per_s, self._relaxed_n = 0.0, 0.0, 0.0

    def _read_strain(self, strain_v: float) -> float:
        if not self._noise_v:
            self._noise_v = (self._noise.standard_normal(1000) * self._tool.noise.strain_sd_v).tolist()
        hung_v = self.hung_n / self._tool.calibration.newton_per_volt
        volts = self._rest_v + strain_v + hung_v + self._noise_v.pop()
        lsb = self._tool.noise.strain_lsb_v
        return round(volts / lsb) * lsb if lsb else volts

    def _read_encoder(self, encoder_deg: float) -> float:
        count = self._tool.calibration.encoder_resolution_deg
        return math.floor(encoder_deg / count) * count
