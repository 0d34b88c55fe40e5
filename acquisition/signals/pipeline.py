"""The class ConditioningPipeline: tare, filter, grasp tracking and calibration of raw blocks."""

import numpy as np

from acquisition.drivers.source import RawBlock
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock, SampleFlag
from acquisition.signal_table import SENSOR_SIGNALS
from acquisition.signals.calibration import compute_jaw_signals
from acquisition.signals.grasp_tracker import BACKDATING_SAMPLES, COMMAND_ON_V, GraspTracker
from acquisition.signals.low_pass import LowPassFilter
from config.schema import ConditioningSettings, Tool, ToolCalibration

TARE_SAMPLES = 200
MIN_TARE_SAMPLES = 50  # with fewer there is no tare, and the motor must not move
TRACKED_COLUMNS = ("grasp", "grasp_start_tick", "contact_tick", "wall_tick", "flags")
NO_FLAGS, INVALID, SATURATED = np.uint16(0), np.uint16(SampleFlag.INVALID), np.uint16(SampleFlag.SATURATED)
FILTERED_INVALID = np.uint16(SampleFlag.FILTERED_INVALID)
DISPLACEMENT_HISTORY_SAMPLES = BACKDATING_SAMPLES


class TareEstimator:
    """Estimator of the rest voltage: mean of the first samples at rest, and before them the tool file's value."""

    def __init__(self, calibration: ToolCalibration) -> None:
        self._nominal_v = calibration.rest_offset_v
        self._tolerance_v = calibration.rest_tolerance_v
        self._sum_v, self._sample_count, self._fixed = 0.0, 0, False

    @property
    def rest_v(self) -> float:
        return self._sum_v / self._sample_count if self._sample_count else self._nominal_v

    @property
    def measured(self) -> bool:
        return self._sample_count >= MIN_TARE_SAMPLES

    def update(self, strain_v: np.ndarray, command_v: np.ndarray) -> np.ndarray:
        """Process a block; return the rest voltage known at each of its samples, V.

        The tare is fixed once there are enough samples or the command has left zero.
        """
        if self._fixed:
            return np.full(len(strain_v), self.rest_v)
        moving = np.flatnonzero(command_v > COMMAND_ON_V)
        plausible = np.abs(strain_v - self._nominal_v) <= self._tolerance_v
        if len(moving):
            plausible[moving[0] :] = False
        counts = self._sample_count + np.cumsum(plausible)
        plausible &= counts <= TARE_SAMPLES
        counts = self._sample_count + np.cumsum(plausible)
        sums = np.cumsum(np.concatenate([[self._sum_v], np.where(plausible, strain_v, 0.0)]))[1:]
        self._sum_v, self._sample_count = float(sums[-1]), int(counts[-1])
        self._fixed = len(moving) > 0 or self._sample_count >= TARE_SAMPLES
        return np.where(counts > 0, sums / np.maximum(counts, 1), self._nominal_v)


class ConditioningPipeline:
    """Conditioning of one source's blocks in order; the result does not depend on how samples are cut into blocks."""

    def __init__(self, tool: Tool, conditioning: ConditioningSettings) -> None:
        self._tool, self._conditioning = tool, conditioning
        self._saturated_v = 0.999 * tool.channels.analog_range_v
        compute_jaw_signals(tool, np.zeros(1), np.zeros(1))  # imports what it needs before the first block
        self._sequence = 0
        self._run = ""
        self._reset()

    def _reset(self) -> None:
        """Reset all state, so that a run's result does not depend on samples before it and can be repeated."""
        tool = self._tool
        self._low_pass = LowPassFilter(self._conditioning, tool.board.sample_rate_hz)
        self._tracker = GraspTracker(tool.contact, tool.stretch_deg_per_volt, tool.hand_driven)
        self.restart_tare()
        self._recent_displacements_m = np.full(DISPLACEMENT_HISTORY_SAMPLES, np.nan)
        self._contact_grasp = 0
        self._contact_m = np.nan

    def restart_tare(self) -> None:
        """Tare the strain gage anew from the next samples at rest."""
        self.tare = TareEstimator(self._tool.calibration)

    def process(self, raw: RawBlock) -> SampleBlock:
        """Return the calibrated, conditioned and segmented samples of one raw block."""
        n = len(raw)
        if raw.run and raw.run != self._run:
            self._reset()
        self._run = raw.run
        raw_strain_v, raw_encoder_deg = raw.signals["strain_v"], raw.signals["encoder_deg"]
        command_v = raw.signals["motor_command_v"]
        if self._tool.hand_driven:  # the first grasp ends the tare, as the first command does
            command_v = np.full(n, np.inf if self._tracker.grasp.index else 0.0)
        rest_v = self.tare.update(raw_strain_v, command_v)
        samples = np.zeros(n, SAMPLE_DTYPE)
        samples["tick"] = raw.first_tick + np.arange(n)
        for signal in SENSOR_SIGNALS:
            samples[signal.name] = raw.signals[signal.name]

        encoder_zero = self._track_grasp(samples, rest_v)
        both = np.empty((2, 2, n))  # unfiltered and filtered; strain and encoder
        both[0, 0], both[0, 1] = raw_strain_v, raw_encoder_deg
        both[1] = self._low_pass(both[0])
        strain_v, encoder_deg = both[:, 0] - rest_v, both[:, 1] - encoder_zero
        jaw = compute_jaw_signals(self._tool, strain_v, encoder_deg)
        samples["jaw_force_n"], samples["jaw_force_filtered_n"] = jaw.force_n
        samples["jaw_displacement_m"], samples["jaw_displacement_filtered_m"] = jaw.displacement_m
        samples["newton_per_volt"], samples["metre_per_volt"] = jaw.newton_per_volt[0], jaw.metre_per_volt[0]
        samples["flags"] |= np.where(jaw.valid[0], NO_FLAGS, INVALID)
        samples["flags"] |= np.where(jaw.valid[1], NO_FLAGS, FILTERED_INVALID)
        samples["flags"] |= np.asarray(raw.limiter_flags, np.uint16)
        samples["limit_n"] = raw.limit_n
        samples["flags"] |= np.where(np.abs(raw_strain_v) < self._saturated_v, NO_FLAGS, SATURATED)
        samples["tissue_displacement_m"] = self._compute_tissue_displacement(samples)

        self._sequence += 1
        return SampleBlock(self._sequence, raw.t_mono_ns, raw.lost_samples, samples, raw.run, backlog=raw.backlog)

    def _track_grasp(self, samples: np.ndarray, rest_v: np.ndarray) -> np.ndarray:
        """Track the grasp sample by sample; return the encoder's zero for each sample, degrees."""
        threshold_v = self._tool.contact.touch_threshold_v
        touched = ((samples["touch_1_v"] > threshold_v) | (samples["touch_2_v"] > threshold_v)).tolist()
        strain_v = (samples["strain_v"] - rest_v).tolist()
        command_v, encoder_deg = samples["motor_command_v"].tolist(), samples["encoder_deg"].tolist()
        first_tick = int(samples["tick"][0])
        rows = []
        for i in range(len(samples)):
            flags = self._tracker.update(first_tick + i, command_v[i], strain_v[i], encoder_deg[i], touched[i])
            grasp = self._tracker.grasp
            contact, wall = (grasp.contact_tick, grasp.jaw_closure_tick) if flags else (-1, -1)
            rows.append((grasp.index, grasp.start_tick, contact, wall, flags, grasp.encoder_zero_deg))
        *columns, encoder_zero = np.array(rows).T
        for name, column in zip(TRACKED_COLUMNS, columns, strict=True):
            samples[name] = column
        return encoder_zero

    def _compute_tissue_displacement(self, samples: np.ndarray) -> np.ndarray:
        """Return the jaw displacement since first contact in the grasp under way, m; NaN before contact."""
        displacement = np.concatenate([self._recent_displacements_m, samples["jaw_displacement_m"]])
        self._recent_displacements_m = displacement[-DISPLACEMENT_HISTORY_SAMPLES:]
        held = samples["contact_tick"] >= 0
        result = np.full(len(samples), np.nan)
        for grasp in sorted({*samples["grasp"][held].tolist()}):
            own = held & (samples["grasp"] == grasp)
            if grasp != self._contact_grasp:
                first = int(np.argmax(own))
                back = int(samples["tick"][first] - samples["contact_tick"][first])
                self._contact_grasp, self._contact_m = (
                    grasp,
                    float(displacement[DISPLACEMENT_HISTORY_SAMPLES + first - back]),
                )
            result[own] = samples["jaw_displacement_m"][own] - self._contact_m
        return result
