"""Constants measured through the real driver on a simulated board, whose truth the tool file does not know."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.bench import fits
from acquisition.bench.calibration_bench import CalibrationBench, extract_recorded_force_passes
from acquisition.bench.checks import RawSignals
from acquisition.bench.fits import CalibrationFit, FittedConstant, ForcePass
from acquisition.drivers.nidaq import NidaqSource
from acquisition.recordings.recording import RecordingSource
from acquisition.signals.calibration import compute_jaw_signals
from acquisition.simulation.board import SimulatedBoard, VirtualClock
from acquisition.simulation.faults import FaultySensors, SensorFault
from acquisition.simulation.grasper import SimulatedGrasper
from acquisition.simulation.service import create_in_process_options
from config.errors import CalibrationError, ToolError
from config.load import load_library, load_tool
from config.schema import ForceLaw

TOOL, LIBRARY = load_tool("simulated"), load_library("porcine")
PULLS_N = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 5.0, 0.0)
GAUGES_M = (0.0, 0.003, 0.006)
Refusal = type[Exception] | tuple[type[Exception], ...]
FEW = settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)


class Laboratory:
    """A simulated tool with other constants than its file's, and somebody who hangs weights and puts gauges."""

    def __init__(self, tissue: str | None = None, seed: int = 1, **truth: float) -> None:
        opening_m = truth.pop("opening_m", TOOL.geometry.opening_m)
        self.truth = TOOL.model_copy(
            update={
                "calibration": TOOL.calibration.model_copy(update=truth),
                "geometry": TOOL.geometry.model_copy(update={"opening_m": opening_m}),
            }
        )
        self.grasper = SimulatedGrasper(self.truth, LIBRARY, tissue or "liver", seed)
        self.sensors = FaultySensors(self.grasper, self.truth)
        self.board = SimulatedBoard(self.truth, self.sensors, VirtualClock())
        self.tissue = tissue
        self.bench = CalibrationBench(TOOL, create_in_process_options(self.board), self.board.clock.now_ns, self._put)

    def _put(self, pull_n: float, gauge_m: float) -> None:
        self.grasper.handle_pull_n, self.grasper.gauge_m = pull_n, None if self.tissue else gauge_m

    def tare(self) -> CalibrationFit:
        return fits.fit_tare(self.bench.read_at_rest(), TOOL)

    def strain(self, pulls_n=PULLS_N) -> CalibrationFit:
        return fits.fit_strain(pulls_n, [self.bench.read_under_pull(pull_n) for pull_n in pulls_n], TOOL)

    def force_scale(self, pulls_n=PULLS_N, load_cell_error: float = 0.01) -> CalibrationFit:
        """The jaws are held open by a load cell, and pulls on the handle press them on it.

        The tool file has the law of the truth, and another scale.
        """
        readings = [self.bench.read_under_pull(pull_n) for pull_n in pulls_n]
        tensions_v = np.array(pulls_n) / self.truth.calibration.newton_per_volt
        shown = compute_jaw_signals(self.truth, tensions_v, tensions_v * self.truth.calibration.encoder_deg_per_volt)
        assumed = TOOL.calibration.jaw_force_scale.model_copy(
            update={"law": self.truth.calibration.jaw_force_scale.law}
        )
        calibration = TOOL.calibration.model_copy(update={"jaw_force_scale": assumed})
        return fits.fit_force_scale(
            shown.force_n, readings, TOOL.model_copy(update={"calibration": calibration}), load_cell_error
        )

    def stretch(self) -> CalibrationFit:
        return fits.fit_cable_stretch(self.bench.sweep_force_on_empty_jaws(), TOOL)

    def geometry(self, gauges_m=GAUGES_M) -> CalibrationFit:
        return fits.fit_geometry(gauges_m, [self.bench.sweep_force_on_gauge(gauge_m) for gauge_m in gauges_m], TOOL)


def refused(what: Callable[[], CalibrationFit], says: str, error: Refusal = CalibrationError) -> None:
    with pytest.raises(error, match=says):
        what()


def within(constant: FittedConstant, truth: float, share: float = 0.01) -> bool:
    return abs(constant.value / truth - 1) <= share


@given(newton_per_volt=st.floats(6.0, 25.0), seed=st.integers(0, 10**6))
@FEW
def test_the_strain_gain_comes_out_within_one_percent(newton_per_volt: float, seed: int) -> None:
    [gain] = Laboratory(newton_per_volt=newton_per_volt, seed=seed).strain().constants
    assert within(gain, newton_per_volt)
    assert gain.low < gain.value < gain.high


@pytest.mark.parametrize(("law", "unit"), [(ForceLaw.EQUATION_2, "of Eq. (2)"), (ForceLaw.CONSTANT, "N/V")])
@given(scale=st.floats(0.05, 1.0), seed=st.integers(0, 10**6))
@FEW
def test_the_force_scale_comes_out_within_one_percent_and_its_interval_holds_the_truth(
    law: ForceLaw, unit: str, scale: float, seed: int
) -> None:
    truth = TOOL.calibration.jaw_force_scale.model_copy(update={"law": law, "value": scale})
    [found] = Laboratory(jaw_force_scale=truth, seed=seed).force_scale().constants
    assert within(found, scale)
    assert found.low < scale < found.high
    assert found.unit == unit


def test_the_error_of_the_load_cell_widens_the_interval_of_the_force_scale() -> None:
    [exact], [coarse] = (Laboratory().force_scale(load_cell_error=error).constants for error in (0.0, 0.05))
    assert coarse.low == pytest.approx(exact.low * 0.95)
    assert coarse.high == pytest.approx(exact.high * 1.05)


def test_a_load_cell_that_was_read_wrong_is_named() -> None:
    laboratory = Laboratory()
    readings = [laboratory.bench.read_under_pull(pull_n) for pull_n in PULLS_N]
    refused(
        lambda: fits.fit_force_scale((0, 1, 2, 9, 4, 5, 2.5, 0), readings, TOOL, 0.01), "at 9 N is not in proportion"
    )


@pytest.mark.parametrize("forces_n", [(0, 1, 2, 3), (1, 2, 3, 4, 5), (0, 1, 2, -3, 4), (0, 1, 2, float("nan"), 4)])
def test_forces_that_tell_nothing_are_refused_before_one_is_read(forces_n: tuple[float, ...]) -> None:
    with pytest.raises(CalibrationError, match=r"Give at least 5 different forces|not negative"):
        fits.check_jaw_forces(forces_n)


@given(stretch=st.floats(35.0, 80.0), seed=st.integers(0, 10**6))
@FEW
def test_the_stretch_comes_out_within_one_percent(stretch: float, seed: int) -> None:
    laboratory = Laboratory(encoder_deg_per_volt=stretch, seed=seed)
    [found] = laboratory.stretch().constants
    assert within(found, stretch)
    assert laboratory.board.output_v == 0.0


@given(ratio=st.floats(0.085, 0.105), opening_m=st.floats(0.009, 0.012), seed=st.integers(0, 10**6))
@FEW
def test_ratio_and_opening_come_out_within_one_percent(ratio: float, opening_m: float, seed: int) -> None:
    found = Laboratory(handle_per_encoder=ratio, opening_m=opening_m, seed=seed).geometry().constants
    assert within(found[0], ratio)
    assert within(found[1], opening_m)


@given(rest_v=st.floats(0.3, 1.5), seed=st.integers(0, 10**6))
@FEW
def test_the_rest_voltage_comes_out_as_it_is(rest_v: float, seed: int) -> None:
    laboratory = Laboratory(rest_offset_v=rest_v, seed=seed)
    offset, noise = laboratory.tare().constants
    assert offset.value == pytest.approx(rest_v, abs=0.02)  # rests differ by 5 mV from day to day
    assert within(noise, TOOL.noise.strain_sd_v, 0.05)
    assert not laboratory.board.output_changes


# --- what is refused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tissue", LIBRARY.tissues)
def test_tissue_in_the_jaws_is_told_by_what_the_fit_leaves(tissue: str) -> None:
    laboratory = Laboratory(tissue)
    refused(laboratory.stretch, "something between the jaws yields")
    assert laboratory.board.output_v == 0.0


@pytest.mark.parametrize(
    ("pulls_n", "says"),
    [
        ((0.0, 2.0, 4.0), "3 different pulls tell no line from a curve"),
        ((0.0, 2.0, -4.0, 6.0), "not negative"),
        ((0.0, 2.0, float("nan"), 6.0), "not negative"),
    ],
)
def test_weights_that_tell_nothing_are_refused_before_one_is_hung(pulls_n: tuple[float, ...], says: str) -> None:
    refused(lambda: fits.check_pulls(pulls_n), says)


def test_weights_in_another_order_than_they_were_named_are_refused() -> None:
    bench = Laboratory().bench
    readings = [bench.read_under_pull(pull_n) for pull_n in (0.0, 2.0, 4.0, 8.0, 6.0)]
    refused(lambda: fits.fit_strain((0.0, 2.0, 4.0, 6.0, 8.0), readings, TOOL), "at 8 N is not above the one at 6 N")


def test_a_weight_that_is_named_wrong_lies_off_the_line() -> None:
    bench = Laboratory().bench
    readings = [bench.read_under_pull(pull_n) for pull_n in (0.0, 2.0, 4.0, 6.5, 8.0, 10.0)]
    refused(lambda: fits.fit_strain((0.0, 2.0, 4.0, 6.0, 8.0, 10.0), readings, TOOL), "at 6 N lies .* off the line")


def test_a_bridge_with_its_wires_exchanged_is_named() -> None:
    readings = [rest(1.0 - pull_n / 12) for pull_n in (0.0, 2.0, 4.0, 6.0)]
    refused(lambda: fits.fit_strain((0.0, 2.0, 4.0, 6.0), readings, TOOL), "exchange the two signal wires")


def test_an_encoder_that_slips_is_told_from_a_stretch() -> None:
    strain_v = np.linspace(0.1, 0.4, 6)
    passes = [ForcePass(strain_v, 100.0 + 20.0 * strain_v) for _ in range(6)]
    refused(lambda: fits.fit_cable_stretch(passes, TOOL), "20.0 deg/V, the tool file says 52.2: the encoder slips")


def test_passes_that_disagree_are_no_stretch() -> None:
    strain_v = np.linspace(0.1, 0.4, 6)
    passes = [ForcePass(strain_v, 100.0 + slope * strain_v) for slope in (40.0, 52.0, 65.0)]
    refused(lambda: fits.fit_cable_stretch(passes, TOOL), "scatters by 12.5 from pass to pass")


def test_gauges_that_are_named_wrong_are_refused() -> None:
    bench = Laboratory().bench
    passes = [bench.sweep_force_on_gauge(gauge_m) for gauge_m in (0.0, 0.002, 0.0045, 0.006)]
    refused(lambda: fits.fit_geometry((0.0, 0.002, 0.004, 0.006), passes, TOOL), "lies .* mm off")
    refused(lambda: fits.fit_geometry((0.006, 0.004, 0.002, 0.0), passes, TOOL), "shut no further")


def rest(volts: float = 0.82, walk_v: float = 0.0, scatter: float = 1.0, turned_deg: float = 0.0) -> RawSignals:
    """Ten seconds of an open tool."""
    n = 10_000
    noise_v = np.random.default_rng(1).standard_normal(n) * TOOL.noise.strain_sd_v * scatter
    zero = np.zeros(n)
    return RawSignals(volts + noise_v + np.linspace(0, walk_v, n), zero, (zero, zero), np.linspace(0, turned_deg, n))


@pytest.mark.parametrize(
    ("signals", "says"),
    [
        (rest(9.99), "the end of its range"),
        (rest(walk_v=0.02), "walked by .* let the amplifier warm up"),
        (rest(scatter=0.0), "scatters by 0.00 mV"),
        (rest(scatter=20.0), "a sound one by"),
        (rest(turned_deg=5.0), "The encoder turned by 5.0 degrees"),
        (rest(float("nan")), "gives no number"),
    ],
)
def test_a_tool_that_does_not_rest_is_not_tared(signals: RawSignals, says: str) -> None:
    refused(lambda: fits.fit_tare(signals, TOOL), says)


@pytest.mark.parametrize(
    "fault", [SensorFault.STRAIN_DROP_OUT, SensorFault.STRAIN_SATURATED, SensorFault.ENCODER_STUCK]
)
def test_a_cable_that_is_pulled_meanwhile_ends_it_with_the_motor_at_zero(fault: SensorFault) -> None:
    laboratory = Laboratory()
    laboratory.sensors.inject_fault_at(fault, 4_000)  # the force on the shut jaws is changed by then
    refused(laboratory.stretch, "Broken off with the motor at zero", (CalibrationError, ToolError))
    assert laboratory.board.output_v == 0.0
    assert max(output.volts for output in laboratory.board.output_changes) > 0.0


def test_two_programs_on_one_board_are_told() -> None:
    laboratory = Laboratory()
    with NidaqSource(TOOL, create_in_process_options(laboratory.board), laboratory.board.clock.now_ns):
        refused(laboratory.stretch, "Another program uses Dev1", ToolError)
    assert laboratory.board.output_v == 0.0


# --- the recordings of 2013 ------------------------------------------------------------------------------------------


def recorded_passes(recordings: list[Path], name: str) -> list[ForcePass]:
    [path] = [path for path in recordings if path.name.startswith(name)]
    return extract_recorded_force_passes(RecordingSource(path, load_tool("smart_tool_2013")))


@pytest.mark.parametrize("name", ["bladder4Hz1", "gallbladder4Hz1", "liver4Hz1"])
def test_recordings_give_the_stretch_of_the_paper(recordings: list[Path], name: str) -> None:
    [found] = fits.fit_cable_stretch(recorded_passes(recordings, name), TOOL).constants
    assert 49.0 <= found.value <= 53.0


@pytest.mark.parametrize("name", ["ureter025Hz1", "ureter4Hz1"])
def test_the_recording_whose_encoder_slips_is_refused(recordings: list[Path], name: str) -> None:
    passes = recorded_passes(recordings, name)
    refused(
        lambda: fits.fit_cable_stretch(passes, TOOL), r"2[01]\.\d deg/V, the tool file says 52.2: the encoder slips"
    )
