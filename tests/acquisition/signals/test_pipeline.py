"""From raw blocks to calibrated, segmented samples: what the estimator, the limiter and the charts are given."""

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2
from simulation import SIGNALS, cut, joined, raw_block, simulate_raw, with_signals

from acquisition.drivers.source import RawBlock
from acquisition.recordings.recording import RecordingSource
from acquisition.sample_block import SAMPLE_DTYPE, SampleBlock, SampleFlag
from acquisition.signals.calibration import compute_sensor_signals_from_jaws
from acquisition.signals.pipeline import ConditioningPipeline
from config.load import load_grasp_protocol, load_tool
from config.schema import ConditioningSettings, Tool

TOOL = load_tool("simulated")
UNSENSED = load_tool("nidaq")
RIG = load_tool("smart_tool_2013")
JAW_SIGNALS = ("jaw_force_n", "jaw_displacement_m", "newton_per_volt", "metre_per_volt")
FILTERED = ("jaw_force_filtered_n", "jaw_displacement_filtered_m")
REST_V = 0.8125  # exact in binary: its mean over any number of samples has no rounding


def process(tool: Tool, blocks: Iterable[RawBlock]) -> np.ndarray:
    pipeline = ConditioningPipeline(tool, ConditioningSettings())
    return np.concatenate([pipeline.process(block).samples for block in blocks])


def by_fives(raw: RawBlock) -> list[RawBlock]:
    """As a board gives them."""
    return cut(raw, range(0, len(raw), 5))


def assert_same(samples: np.ndarray, others: np.ndarray, but: str = "") -> None:
    for name in SAMPLE_DTYPE.names:
        if name != but:
            np.testing.assert_array_equal(samples[name], others[name], err_msg=name)


def flagged(samples: np.ndarray, flag: SampleFlag) -> np.ndarray:
    return samples["flags"] & flag != 0


def sensors(
    force_n: np.ndarray, displacement_m: np.ndarray, rest_v: float = REST_V, rest_deg: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Strain voltage and encoder angle of a noiseless tool whose jaws do this."""
    pairs = [
        compute_sensor_signals_from_jaws(TOOL, force, displacement)
        for force, displacement in zip(force_n, displacement_m, strict=True)
    ]
    strain_v, encoder_deg = np.array(pairs).T
    return strain_v + rest_v, encoder_deg + rest_deg


def grasp_truth(
    rest: int = 300, closing: int = 125, held: int = 500, lag: int = 5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Command, jaw force and displacement of a plain grasp; the jaws answer some samples after the command."""
    share = np.concatenate(
        [np.zeros(rest), np.linspace(0, 1, closing), np.ones(held), np.linspace(1, 0, closing), np.zeros(rest)]
    )
    answer = np.roll(share, lag)
    return 2.0 * share, 1.55 * answer, 0.004 * np.sqrt(answer)


# --- what comes out is what the jaws do -------------------------------------------------------------------------------


@settings(max_examples=20)
@given(rest_v=st.floats(0.771, 0.869), rest_deg=st.floats(-1000, 1000))
def test_whatever_the_rest_voltage_and_angle_force_and_displacement_are_those_of_the_jaws(
    rest_v: float, rest_deg: float
) -> None:
    command_v, force_n, displacement_m = grasp_truth()
    strain_v, encoder_deg = sensors(force_n, displacement_m, rest_v, rest_deg)
    samples = process(TOOL, [raw_block(strain_v, encoder_deg, command_v)])
    np.testing.assert_allclose(samples["jaw_force_n"], force_n, rtol=0, atol=1e-10)
    np.testing.assert_allclose(samples["jaw_displacement_m"], displacement_m, rtol=0, atol=1e-12)
    assert not flagged(samples, SampleFlag.INVALID | SampleFlag.SATURATED).any()


def test_what_people_look_at_follows_22_ms_late_and_reaches_the_same_plateau() -> None:
    command_v, force_n, displacement_m = grasp_truth()
    samples = process(TOOL, [raw_block(*sensors(force_n, displacement_m), command_v)])
    half = [int(np.argmax(samples[name] > 0.775)) for name in ("jaw_force_n", "jaw_force_filtered_n")]
    assert half[1] - half[0] == pytest.approx(1e3 * math.sqrt(2) / (2 * math.pi * 10), abs=2)  # on a ramp; ± a sample
    assert samples["jaw_force_filtered_n"][900] == pytest.approx(1.55, abs=1e-6)
    assert samples["jaw_displacement_filtered_m"][900] == pytest.approx(0.004, abs=1e-9)


def test_raw_signals_ticks_and_gaps_are_passed_on_as_they_are() -> None:
    raw = joined(simulate_raw("liver"))
    pipeline = ConditioningPipeline(TOOL, ConditioningSettings())
    blocks: list[SampleBlock] = []
    for block in cut(raw, [100, 400]):
        late = replace(block, first_tick=block.first_tick + 7 * len(blocks), lost_samples=7 * bool(blocks))
        blocks.append(pipeline.process(late))
    samples = np.concatenate([block.samples for block in blocks])
    for name in SIGNALS:
        np.testing.assert_array_equal(samples[name], raw.signals[name])
    assert [block.lost_samples for block in blocks] == [0, 7, 7]
    assert [block.sequence for block in blocks] == [1, 2, 3]
    np.testing.assert_array_equal(np.diff(samples["tick"]), np.where(np.isin(np.arange(1, len(raw)), [100, 400]), 8, 1))


@pytest.mark.parametrize("tissue", ["liver", "bladder"])
def test_tissue_displacement_counts_from_the_first_touch(tissue: str) -> None:
    raw = joined(simulate_raw(tissue, cycles=2))
    samples = process(TOOL, by_fives(raw))
    held = samples["contact_tick"] >= 0
    assert np.isfinite(samples["tissue_displacement_m"][held]).all()
    assert np.isnan(samples["tissue_displacement_m"][~held]).all()
    for grasp in (1, 2):
        of_grasp = samples[held & (samples["grasp"] == grasp)]
        touch = of_grasp["contact_tick"][0]
        assert raw.signals["touch_1_v"][touch] > 2.5 >= raw.signals["touch_1_v"][touch - 1]
        expected = of_grasp["jaw_displacement_m"] - samples["jaw_displacement_m"][touch]
        np.testing.assert_allclose(of_grasp["tissue_displacement_m"], expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("silent", ["touch_1_v", "touch_2_v"])
def test_either_of_the_two_touch_sensors_tells_contact(silent: str) -> None:
    raw = joined(simulate_raw("liver"))
    one_sided = with_signals(raw, **{silent: np.zeros(len(raw))})
    assert_same(process(TOOL, by_fives(raw)), process(TOOL, by_fives(one_sided)), but=silent)


def test_the_encoder_is_zeroed_anew_for_each_grasp() -> None:
    command_v, force_n, displacement_m = grasp_truth()
    rests_deg = (0.0, 40.0, -70.0)
    pieces = [raw_block(*sensors(force_n, displacement_m, rest_deg=rest), command_v) for rest in rests_deg]
    samples = process(TOOL, [joined(pieces)])
    for i in range(3):
        held = slice(i * len(command_v) + 310, (i + 1) * len(command_v) - 310)
        np.testing.assert_allclose(samples["jaw_displacement_m"][held], displacement_m[310:-310], rtol=0, atol=1e-12)


def test_contact_in_the_first_samples_of_a_grasp_counts_from_the_new_zero_of_the_encoder() -> None:
    command_v, force_n, displacement_m = grasp_truth(closing=60, lag=0)
    touched = np.maximum(displacement_m, 1e-6)  # the jaws already lie on the tissue: force from the first sample on
    pieces = [raw_block(*sensors(force_n, touched, rest_deg=rest), command_v) for rest in (0.0, 30.0)]
    samples = process(UNSENSED, by_fives(joined(pieces)))
    peaks_m = [np.nanmax(samples["tissue_displacement_m"][samples["grasp"] == grasp]) for grasp in (1, 2)]
    assert peaks_m[1] == pytest.approx(peaks_m[0], rel=1e-6)


# --- the tare ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rest", [10, 300])
def test_the_force_at_rest_is_zero_even_where_the_rest_is_short(rest: int) -> None:
    command_v, force_n, displacement_m = grasp_truth(rest=rest)
    strain_v, encoder_deg = sensors(force_n, displacement_m, rest_v=0.84)
    samples = process(TOOL, by_fives(raw_block(strain_v, encoder_deg, command_v)))
    np.testing.assert_allclose(samples["jaw_force_n"], force_n, rtol=0, atol=1e-10)


def test_force_during_a_grasp_is_not_taken_for_rest() -> None:
    command_v, force_n, displacement_m = grasp_truth(rest=20)
    raw = raw_block(*sensors(np.minimum(force_n, 0.2), displacement_m), command_v)  # 0.03 V: well within tolerance
    assert process(TOOL, [raw])["jaw_force_n"][400] == pytest.approx(0.2, abs=1e-10)


@pytest.mark.parametrize("rest_v", [0.82 + 0.051, 0.82 - 0.051, 1.5, 0.0])
def test_a_rest_voltage_out_of_tolerance_is_not_tared_away(rest_v: float) -> None:
    pipeline = ConditioningPipeline(TOOL, ConditioningSettings())
    samples = pipeline.process(raw_block(np.full(300, rest_v))).samples
    assert not pipeline.tare.measured
    assert pipeline.tare.rest_v == TOOL.calibration.rest_offset_v
    # the force that the tool file's own rest voltage leaves: at least 50 mV times 6 N/V, never hidden
    assert abs(samples["jaw_force_n"][-1]) > 0.3
    assert math.copysign(1, samples["jaw_force_n"][-1]) == math.copysign(1, rest_v - 0.82)


def test_implausible_samples_among_the_rest_do_not_shift_the_tare() -> None:
    strain_v = np.full(200, REST_V)
    strain_v[::10] = 3.0
    samples = process(TOOL, by_fives(raw_block(strain_v)))
    assert abs(samples["jaw_force_n"][-1]) < 1e-12


def test_noise_at_rest_leaves_no_more_than_the_mean_of_200_samples_does() -> None:
    errors_n = []
    for seed in range(20):
        noise_v = 0.002 * np.random.default_rng(seed).standard_normal(1000)
        samples = process(TOOL, by_fives(raw_block(REST_V + noise_v)))
        errors_n.append(samples["jaw_force_n"][200:].mean())
    # the difference of two means, of 200 and 800 samples, by 6.18 N/V at rest
    expected_n = 0.002 * 6.18 * math.sqrt(1 / 200 + 1 / 800)
    low, high = np.sqrt(chi2.ppf([1e-6, 1 - 1e-6], 20) / 20)  # missed by a right tare twice in a million
    assert low < math.sqrt(np.mean(np.square(errors_n))) / expected_n < high


def test_a_new_run_tares_anew_what_drifted_since() -> None:
    pipeline = ConditioningPipeline(TOOL, ConditioningSettings())
    pipeline.process(raw_block(np.full(400, 0.82)))
    drifted = pipeline.process(raw_block(np.full(400, 0.85))).samples
    tared = pipeline.process(replace(raw_block(np.full(400, 0.85)), run="next")).samples
    assert drifted["jaw_force_n"][-1] > 0.18  # 30 mV at 6.2 N/V
    assert abs(tared["jaw_force_n"][-1]) < 1e-12


# --- flags ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("strain_v", "saturated"), [(9.999, True), (-9.999, True), (9.9, False), (math.nan, True)])
def test_a_strain_gage_at_the_end_of_its_range_is_flagged(strain_v: float, saturated: bool) -> None:
    signal = np.full(300, REST_V)
    signal[250] = strain_v
    np.testing.assert_array_equal(
        flagged(process(TOOL, [raw_block(signal)]), SampleFlag.SATURATED), (np.arange(300) == 250) & saturated
    )


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_no_jaw_signal_is_nan_unless_its_sample_is_flagged_invalid(seed: int) -> None:
    samples = process(TOOL, [wild(seed)])
    invalid = flagged(samples, SampleFlag.INVALID)
    for name in JAW_SIGNALS:
        np.testing.assert_array_equal(np.isnan(samples[name]), invalid)
    assert 0 < invalid.sum() < len(samples)


@settings(max_examples=30)
@given(st.integers(0, 10_000))
def test_a_filtered_signal_is_nan_exactly_where_its_own_flag_says_so(seed: int) -> None:
    samples = process(TOOL, [wild(seed)])
    for name in FILTERED:
        np.testing.assert_array_equal(np.isnan(samples[name]), flagged(samples, SampleFlag.FILTERED_INVALID))


def wild(seed: int) -> RawBlock:
    """A grasp by an encoder that jumps about now and then."""
    rng = np.random.default_rng(seed)
    command_v, force_n, displacement_m = grasp_truth()
    strain_v, encoder_deg = sensors(force_n, displacement_m)
    for at in rng.integers(0, len(command_v), 4):
        encoder_deg[at : at + rng.integers(1, 50)] += rng.uniform(-150, 150)
    encoder_deg[700:720] = -400.0
    return raw_block(strain_v, encoder_deg, command_v)


# --- blocks -----------------------------------------------------------------------------------------------------------

NOISY = joined(simulate_raw("gallbladder", "trapezoid_4hz", seed=3, cycles=2))
LARGEST_BLOCK = 100  # what a recording gives, and the most that a tool file may ask of a board
CUTS = st.one_of(
    st.lists(st.integers(1, len(NOISY) - 1), max_size=40),
    st.integers(1, LARGEST_BLOCK).map(lambda size: list(range(0, len(NOISY), size))),
).map(lambda cuts: [*cuts, *range(0, len(NOISY), LARGEST_BLOCK)])


@settings(max_examples=12)
@given(CUTS)
def test_how_samples_are_cut_into_blocks_does_not_matter(cuts: list[int]) -> None:
    assert_same(process(TOOL, by_fives(NOISY)), process(TOOL, cut(NOISY, cuts)))


@pytest.mark.parametrize("tool", [TOOL, UNSENSED], ids=lambda tool: tool.name)
@settings(max_examples=12)
@given(cuts=CUTS)
def test_once_tared_how_samples_are_cut_into_blocks_does_not_matter(tool: Tool, cuts: list[int]) -> None:
    quiet = with_signals(NOISY, strain_v=np.where(np.arange(len(NOISY)) < 520, REST_V, NOISY.signals["strain_v"]))
    assert_same(process(tool, by_fives(quiet)), process(tool, cut(quiet, cuts)))


def test_a_contact_in_the_block_in_which_the_last_grasp_ends_is_its_own() -> None:
    waveform = load_grasp_protocol("trapezoid_4hz").waveform.model_copy(update={"rest_s": 0.03})
    hasty = load_grasp_protocol("trapezoid_4hz").model_copy(update={"waveform": waveform})
    raw = joined(simulate_raw("liver", hasty, cycles=3))
    quiet = with_signals(raw, strain_v=np.where(np.arange(len(raw)) < 520, REST_V, raw.signals["strain_v"]))
    assert_same(process(TOOL, by_fives(quiet)), process(TOOL, cut(quiet, range(0, len(raw), LARGEST_BLOCK))))


# --- the real tool ----------------------------------------------------------------------------------------------------


@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("liver4Hz1", SampleFlag.JAWS_CLOSED),
        ("bladder4Hz1", SampleFlag.JAWS_CLOSED),
        ("ureter4Hz1", SampleFlag.ENCODER_SLIPS),
    ],
)
def test_on_the_real_tool_every_grasp_shows_shut_jaws_or_an_encoder_that_slips(
    recordings: list[Path], name: str, found: SampleFlag
) -> None:
    path = next(path for path in recordings if path.name.startswith(name))
    with RecordingSource(path, RIG) as recording:
        samples = process(RIG, iter(recording.read_block, None))
    grasps = range(1, samples["grasp"].max() + 1)
    seen = {
        flag: sum(flagged(samples[samples["grasp"] == grasp], flag).any() for grasp in grasps)
        for flag in (SampleFlag.JAWS_CLOSED, SampleFlag.ENCODER_SLIPS)
    }
    assert seen == {SampleFlag.JAWS_CLOSED: 0, SampleFlag.ENCODER_SLIPS: 0, found: 19}
