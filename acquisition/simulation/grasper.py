"""The class SimulatedGrasper: motor command in, raw sensor volts and degrees out, one sample a call."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from acquisition.drivers.source import RawBlock
from acquisition.signal_table import SENSOR_SIGNALS
from acquisition.signals.calibration import compute_jaw_signals, compute_sensor_signals_from_jaws
from acquisition.simulation.tissue import (
    GRASP_SCATTER_LOG_SD,
    NO_DEVIATION,
    Material,
    ModelDeviation,
    Specimen,
    integrate_tissue,
)
from config.errors import ConfigurationError
from config.schema import TissueLibrary, Tool

TOUCH_ACTIVE_V = 5.0
FULL_CLOSURE_SHARE = 0.98  # of the thickness, or of the linkage's range: there the jaws are shut
OPENING_FORCE_N = 0.02
REST_OFFSET_SD_V = 0.005  # standard deviation of the rest voltage in the recordings
FRICTION_SATURATION_M_PER_S = 1e-3  # jaw speed from which on the cable's friction is complete
BACKLASH_TAKEUP_N = 0.1  # force that tightens the cable
NEW_SPOT_AFTER_S = 5.0  # jaws open for longer between two grasps: the next one is on another spot
REMAINING_TISSUE_SHARE = 0.02  # share of the tissue that stays between the jaws after slipping


class SimulatedGrasper:
    """Simulation: command, drive lag, free travel, contact, tissue, inverse of Eqs. (1) to (6), noisy volts and counts.

    Every spot is a new specimen of the tissue, drawn from the profile and its spread with `seed`; grasps on it differ a
    little. Another tissue, or jaws that were open for long, begin a spot. `deviation` makes truth and sensors differ
    from the estimator's assumptions.
    """

    def __init__(
        self, tool: Tool, library: TissueLibrary, tissue: str, seed: int, deviation: ModelDeviation = NO_DEVIATION
    ) -> None:
        if tool.simulation is None:
            raise ConfigurationError(f"The tool {tool.name!r} has no [simulation] table; it cannot be simulated.")
        self._tool, self._mechanics, self._library = tool, tool.simulation, library
        self._deviation = deviation
        self._dt_s = 1.0 / tool.board.sample_rate_hz
        self._seed = seed
        sweep = compute_jaw_signals(tool, np.zeros(800), np.arange(-400.0, 400.0))
        self._max_travel_m = FULL_CLOSURE_SHARE * float(np.nanmax(sweep.displacement_m))
        self._noise_rng = np.random.default_rng([seed, 0])
        self._rest_v = tool.calibration.rest_offset_v + REST_OFFSET_SD_V * float(self._noise_rng.standard_normal())
        self._noise_buffer_v: list[float] = []
        self._grasp_count = 0
        self._command_v, self._commanded_force_n = 0.0, 0.0
        self._drive_weight = -math.expm1(-self._dt_s / self._mechanics.drive_lag_s)
        self._contact_weight = -math.expm1(-self._dt_s / self._mechanics.contact_lag_s)
        self._opening_factor = math.exp(-self._dt_s / self._mechanics.opening_time_s)
        self.tissue = tissue
        self.gauge_m: float | None = None  # thickness of a rigid gauge instead of tissue; 0: the jaws are empty
        self.handle_pull_n = 0.0  # pull of a weight on the handle
        self._spot: tuple[str, np.ndarray] | None = None  # its tissue and deviations; None: a new one begins
        self._open_samples = math.inf
        self.specimen = self._draw_specimen()
        self.actuator_force_n = 0.0
        self.force_n = 0.0
        self.jaw_displacement_m = 0.0
        self.tissue_displacement_m = 0.0
        self._velocity_m_per_s, self._relaxed_force_n = 0.0, 0.0
        self._contact_time_s = 0.0
        self._motion_phase_rad = (
            2 * math.pi * float(np.random.default_rng([seed, 2]).random())
        )  # of the tissue's own motion
        self.in_contact = False
        integrate_tissue(
            0.0, 0.0, 0.0, 0.0, 0.0, self._dt_s, 0.0, self.specimen.material
        )  # compiles it before the first grasp

    def set_tissue(self, tissue: str) -> None:
        """Set the tissue that the simulated grasper holds from the next grasp on."""
        self.tissue = tissue

    def step(self, command_v: float) -> dict[str, float]:
        """Advance one sample with the command held, V; return the sensors' readings, V and degrees, by signal."""
        if command_v != self._command_v:
            self._set_command(command_v)
        self._open_samples = self._open_samples + 1 if self._command_v <= 0 and not self.in_contact else 0
        self._move_jaws()
        strain_v, encoder_deg = compute_sensor_signals_from_jaws(self._tool, *self._compute_handle_signals())
        touch_v = (
            TOUCH_ACTIVE_V if self.in_contact and self.tissue_displacement_m >= self._deviation.touch_late_m else 0.0
        )
        return {
            "strain_v": self._read_strain(strain_v),
            "encoder_deg": self._read_encoder(encoder_deg),
            "touch_1_v": touch_v,
            "touch_2_v": touch_v,
        }

    def _compute_handle_signals(self) -> tuple[float, float]:
        """Return force, N, and displacement, m, as strain gage and encoder sense them through the cable."""
        off = self._deviation
        friction = off.friction_share * math.tanh(self._velocity_m_per_s / FRICTION_SATURATION_M_PER_S)
        tightened_m = -off.backlash_m * math.expm1(-self.force_n / BACKLASH_TAKEUP_N)
        return self.force_n * off.force_scale * (1.0 + friction), self.jaw_displacement_m + tightened_m

    def _draw_specimen(self) -> Specimen:
        """Draw what the next grasp holds: on a new spot a specimen of the tissue, on the same spot nearly the same.

        Each grasp by itself has the spread of the library, also the first one on a spot.
        """
        scale, random = self._mechanics.spread_scale, np.random.default_rng([self._seed, 1, self._grasp_count])
        drawn = random.standard_normal(5)
        spread = self._library.spread_of(self.tissue)
        usual = np.maximum([spread.log_alpha, spread.log_beta, spread.log_damping], 1e-6)
        share = np.zeros(5)  # of the variance, between grasps on one spot; none of thickness and preload
        share[:3] = np.minimum(np.array(GRASP_SCATTER_LOG_SD) / usual, 1.0) ** 2
        if self._spot is None or self._spot[0] != self.tissue:
            of_spot = (1 - share) * drawn + np.sqrt(share * (1 - share)) * random.standard_normal(5)
            self._spot = self.tissue, of_spot
        else:
            drawn = self._spot[1] + np.sqrt(share) * drawn
        return Specimen.draw(self._library, self.tissue, (drawn * scale).tolist(), self._deviation)

    @property
    def _free_travel_m(self) -> float:
        """Travel of the jaws before contact: thick tissue fills them, and empty jaws meet each other."""
        opening_m = self._tool.opening_m
        if self.gauge_m is not None:
            return min(self._max_travel_m, self._max_travel_m if opening_m is None else opening_m - self.gauge_m)
        least_m = self._mechanics.free_travel_m
        return least_m if opening_m is None else max(least_m, opening_m - self.specimen.thickness_m)

    def _set_command(self, command_v: float) -> None:
        if self._command_v <= 0 and not self.in_contact:  # a new closing of the jaws
            self._grasp_count += 1
            if self._open_samples * self._dt_s > NEW_SPOT_AFTER_S:
                self._spot = None
            self.specimen = self._draw_specimen()
        self._command_v = command_v
        self._commanded_force_n = float(self._tool.command_to_force.to_force_n(command_v))

    def _move_jaws(self) -> None:
        self.actuator_force_n += (self._commanded_force_n - self.actuator_force_n) * self._drive_weight
        if self._command_v <= 0 and self.actuator_force_n < OPENING_FORCE_N:
            self._open_jaws()
        elif self.in_contact:
            self._compress_tissue()
        else:
            self._approach()

    def _approach(self) -> None:
        """Move the jaws freely until contact."""
        free_m = self._free_travel_m
        self.jaw_displacement_m += self.actuator_force_n / self._mechanics.free_drag_kg_per_s * self._dt_s
        self.in_contact = self.jaw_displacement_m >= free_m
        self.tissue_displacement_m = max(self.jaw_displacement_m - free_m, 0.0)
        self._velocity_m_per_s, self._relaxed_force_n, self._contact_time_s, self.force_n = 0.0, 0.0, 0.0, 0.0

    def _compress_tissue(self) -> None:
        """Deform the tissue by the drive's force, which the cable transmits; shut jaws hold any force."""
        begin_n = self.force_n
        self.force_n += (self.actuator_force_n - self.force_n) * self._contact_weight
        self._contact_time_s += self._dt_s
        x_m, v_m_per_s, self._relaxed_force_n = integrate_tissue(
            self.tissue_displacement_m,
            self._velocity_m_per_s,
            self._relaxed_force_n,
            begin_n,
            self.force_n,
            self._dt_s,
            self._compute_motion_m(),
            self._compute_held_material(),
        )
        rigid = self.gauge_m is not None
        shut_m = (
            0.0
            if rigid
            else min(FULL_CLOSURE_SHARE * self.specimen.thickness_m, self._max_travel_m - self._free_travel_m)
        )
        if x_m > shut_m:
            x_m, v_m_per_s = shut_m, 0.0
        self.tissue_displacement_m, self._velocity_m_per_s = x_m, v_m_per_s
        self.jaw_displacement_m = self._free_travel_m + x_m

    def _compute_motion_m(self) -> float:
        """Return how far the body moves the tissue against the jaws, m."""
        off = self._deviation
        if not off.motion_m:
            return 0.0
        turn = 2 * math.pi * off.motion_hz * self._contact_time_s
        return off.motion_m * (math.sin(turn + self._motion_phase_rad) - math.sin(self._motion_phase_rad))

    def _compute_held_material(self) -> Material:
        """Return the material between the jaws, of which less is left while the tissue slips."""
        material, off = self.specimen.material, self._deviation
        slipping = (self._contact_time_s - off.slips_after_s) / off.slips_within_s
        if slipping <= 0:
            return material
        share = max(1.0 - slipping, REMAINING_TISSUE_SHARE)
        return material._replace(alpha_n=material.alpha_n * share, damping_kg_per_s=material.damping_kg_per_s * share)

    def _open_jaws(self) -> None:
        """Open the jaws by the return spring; the tissue follows until they leave it."""
        self.jaw_displacement_m *= self._opening_factor
        self.tissue_displacement_m = max(self.jaw_displacement_m - self._free_travel_m, 0.0)
        self.in_contact = self.tissue_displacement_m > 0.0
        self.force_n, self._velocity_m_per_s, self._relaxed_force_n = 0.0, 0.0, 0.0

    def _read_strain(self, strain_v: float) -> float:
        if not self._noise_buffer_v:
            self._noise_buffer_v = (self._noise_rng.standard_normal(1000) * self._tool.noise.strain_sd_v).tolist()
        volts = self._rest_v + strain_v + self._pull_v + self._noise_buffer_v.pop()
        lsb = self._tool.noise.strain_lsb_v
        return round(volts / lsb) * lsb if lsb else volts

    def _read_encoder(self, encoder_deg: float) -> float:
        count = self._tool.calibration.encoder_resolution_deg
        stretched_deg = encoder_deg + self._tool.stretch_deg_per_volt * self._pull_v
        return math.floor(stretched_deg / count) * count

    @property
    def _pull_v(self) -> float:
        return self.handle_pull_n / self._tool.calibration.newton_per_volt


def collect_block(readings: Sequence[Mapping[str, float]], commands_v: Sequence[float], first_tick: int) -> RawBlock:
    """Return readings under these commands as a block; each command is read back without noise."""
    signals = dict.fromkeys((signal.name for signal in SENSOR_SIGNALS), np.full(len(commands_v), np.nan))
    signals |= {name: np.array([each[name] for each in readings]) for name in readings[0]}
    return RawBlock(first_tick, 0, signals | {"motor_command_v": np.array(commands_v)})
