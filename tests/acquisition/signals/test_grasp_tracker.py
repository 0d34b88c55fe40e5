"""Grasps, contact, shut jaws and slipping encoders, on signals whose truth is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.sample_block import SampleFlag
from acquisition.signals.grasp_tracker import GraspTracker
from config.load import load_tool
from config.schema import ContactDetection

SENSED = load_tool("simulated").contact
UNSENSED = load_tool("simulated").contact.model_copy(update={"touch_trusted": False})
RIG = load_tool("smart_tool_2013").contact
STRETCH_DEG_PER_V = 52.189  # Eq. (3)
READBACK_NOISE_V = 0.0013  # largest at rest in the recordings, but for spikes of 17 mV
LATE = 5  # samples in a row that tell a command from a spike

ROW = np.dtype([(name, "i8") for name in ("flags", "grasp", "start", "contact", "wall")] + [("zero_deg", "f8")])


def follow(detection: ContactDetection, command_v, strain_v=0.0, encoder_deg=0.0, touched=False) -> np.ndarray:
    """What the tracker says at each sample; numbers stand for constant signals."""
    tracker = GraspTracker(detection, STRETCH_DEG_PER_V)
    rows = []
    signals = np.broadcast_arrays(np.asarray(command_v, float), strain_v, encoder_deg, touched)
    for tick, (command, strain, encoder, touch) in enumerate(zip(*signals, strict=True)):
        flags = tracker.update(tick, float(command), float(strain), float(encoder), bool(touch))
        now = tracker.grasp
        rows.append((flags, now.index, now.start_tick, now.contact_tick, now.jaw_closure_tick, now.encoder_zero_deg))
    return np.array(rows, ROW)


def where(rows: np.ndarray, flag: SampleFlag) -> np.ndarray:
    return np.flatnonzero(rows["flags"] & flag)


def pulses(count: int, rest: int = 100, held: int = 200, volts: float = 2.0) -> np.ndarray:
    """Rests and steps of the command, `count` times, and a last rest."""
    return np.array(([0.0] * rest + [volts] * held) * count + [0.0] * rest)


# --- where a grasp begins and ends ------------------------------------------------------------------------------------


@given(
    rest=st.integers(10, 200),
    volts_per_second=st.floats(0.5, 32.0),  # the shipped protocols' slowest and fastest ramps
    spikes=st.lists(st.integers(2, 200), max_size=5),
    seed=st.integers(0, 1000),
)
def test_a_grasp_starts_where_the_command_leaves_zero_though_it_is_known_later(
    rest: int, volts_per_second: float, spikes: list[int], seed: int
) -> None:
    slope = volts_per_second / 1000
    command_v = np.concatenate([np.zeros(rest), slope * np.arange(1, 121)])
    command_v += np.random.default_rng(seed).uniform(-READBACK_NOISE_V, READBACK_NOISE_V, len(command_v))
    command_v[[rest - back for back in spikes if back <= rest]] = 0.017
    rows = follow(SENSED, command_v)
    in_grasp = where(rows, SampleFlag.IN_GRASP)
    start = rows["start"][-1]
    assert rows["grasp"][-1] == 1
    # up to 2 mV is noise of the read-back: the ramp is over it, noise and all, this many samples after it began
    assert rest <= start <= rest + (0.002 + READBACK_NOISE_V) / slope
    # told five samples after the command passed 20 mV
    assert in_grasp[0] <= rest + (0.020 + READBACK_NOISE_V) / slope + LATE
    assert len(in_grasp) == len(rows) - in_grasp[0]


@given(st.sets(st.integers(0, 199), max_size=40), st.integers(0, 100))
def test_spikes_of_17_mv_on_the_command_line_start_no_grasp(spikes: set[int], seed: int) -> None:
    command_v = np.random.default_rng(seed).uniform(-READBACK_NOISE_V, READBACK_NOISE_V, 200)
    command_v[list(spikes)] = 0.017
    rows = follow(SENSED, command_v)
    assert not rows["flags"].any()
    assert not rows["grasp"].any()


@given(st.integers(1, LATE), st.floats(0.03, 3.5))
def test_fewer_than_five_samples_of_command_start_no_grasp(samples: int, volts: float) -> None:
    command_v = np.zeros(200)
    command_v[50 : 50 + samples] = volts
    assert rows_have_grasp(follow(SENSED, command_v)) == (samples >= LATE)


def rows_have_grasp(rows: np.ndarray) -> bool:
    return bool(rows["grasp"][-1])


@given(st.integers(1, LATE - 1), st.integers(20, 150))
def test_a_dropout_of_the_command_shorter_than_five_samples_does_not_end_a_grasp(samples: int, at: int) -> None:
    command_v = pulses(1)
    command_v[100 + at : 100 + at + samples] = 0.0
    rows = follow(SENSED, command_v)
    assert rows["grasp"][-1] == 1
    np.testing.assert_array_equal(where(rows, SampleFlag.IN_GRASP), np.arange(100 + LATE - 1, 300 + LATE - 1))


@settings(max_examples=40)
@given(st.integers(1, 5), st.integers(LATE, 200), st.integers(LATE, 300))
def test_grasps_are_counted_and_each_ends_within_five_samples_of_zero(count: int, rest: int, held: int) -> None:
    rows = follow(SENSED, pulses(count, rest, held))
    begins = rest + (rest + held) * np.arange(count)
    expected = np.concatenate([np.arange(begin, begin + held) + LATE - 1 for begin in begins])
    np.testing.assert_array_equal(where(rows, SampleFlag.IN_GRASP), expected)
    assert rows["grasp"][-1] == count
    starts = rows["start"][where(rows, SampleFlag.IN_GRASP)]
    assert sorted(set(starts)) == list(begins)


def test_a_source_that_opens_in_the_midst_of_a_grasp_has_it_from_its_first_sample() -> None:
    rows = follow(SENSED, np.full(50, 2.0))
    assert rows["grasp"][-1] == 1
    assert rows["start"][-1] == 0


def test_the_encoder_is_zeroed_anew_where_each_grasp_starts() -> None:
    command_v = pulses(3)
    encoder_deg = np.linspace(0.0, 90.0, len(command_v))
    rows = follow(SENSED, command_v, encoder_deg=encoder_deg)
    for index in (1, 2, 3):
        of_grasp = rows[(rows["grasp"] == index) & (rows["flags"] != 0)]
        start = of_grasp["start"][0]
        assert set(of_grasp["zero_deg"]) == {encoder_deg[start]}


# --- contact ----------------------------------------------------------------------------------------------------------


@given(st.integers(120, 290))
def test_a_trusted_touch_sensor_tells_contact_to_the_sample(touch_at: int) -> None:
    command_v = pulses(1)
    rows = follow(SENSED, command_v, touched=np.arange(len(command_v)) >= touch_at)
    in_contact = where(rows, SampleFlag.CONTACT)
    np.testing.assert_array_equal(in_contact, where(rows, SampleFlag.CONTACT_SENSED))
    np.testing.assert_array_equal(in_contact, np.arange(touch_at + 1, 300 + LATE - 1))
    assert set(rows["contact"][in_contact]) == {touch_at}


@given(st.integers(100, 298))
def test_one_sample_of_touch_is_no_contact(touch_at: int) -> None:
    command_v = pulses(1)
    assert not len(where(follow(SENSED, command_v, touched=np.arange(len(command_v)) == touch_at), SampleFlag.CONTACT))


def test_touch_outside_a_grasp_is_no_contact_and_contact_ends_with_the_grasp() -> None:
    command_v = pulses(2)
    touched = np.isin(np.arange(len(command_v)) // 50, [0, 1, 4, 7])  # in the rests, and 200 to 249
    in_contact = where(follow(SENSED, command_v, touched=touched), SampleFlag.CONTACT)
    np.testing.assert_array_equal(in_contact, np.arange(201, 300 + LATE - 1))


def test_touch_sensors_that_are_not_trusted_tell_nothing() -> None:
    assert not len(where(follow(UNSENSED, pulses(2), touched=True), SampleFlag.CONTACT))


@given(free=st.integers(10, 100), newton_per_second=st.floats(1.0, 50.0), offset_v=st.floats(-0.02, 0.02))
def test_without_a_sensor_contact_is_found_between_the_first_force_and_0_04_newton(
    free: int, newton_per_second: float, offset_v: float
) -> None:
    newton_per_volt = 0.0123 / 0.002  # 2 mV are 12 mN at the jaws
    begin = 100 + free
    rise_v = newton_per_second / newton_per_volt / 1000 * np.maximum(np.arange(400) - begin, 0)
    rows = follow(UNSENSED, pulses(1), strain_v=offset_v + rise_v)  # a rest voltage that was tared a little wrong
    felt = begin + int(np.argmax(rise_v[begin:] * newton_per_volt > 0.04))
    in_contact = where(rows, SampleFlag.CONTACT)
    assert begin <= rows["contact"][in_contact[0]] <= felt
    assert not len(where(rows, SampleFlag.CONTACT_SENSED))
    assert in_contact[0] <= felt + UNSENSED.force_rise_samples


@settings(max_examples=40)
@given(st.integers(0, 10_000))
def test_strain_noise_alone_is_no_contact(seed: int) -> None:
    strain_v = 0.002 * np.random.default_rng(seed).standard_normal(600)
    assert not len(where(follow(UNSENSED, pulses(1, held=400), strain_v=strain_v), SampleFlag.CONTACT))


def test_a_single_spike_of_the_strain_gage_is_no_contact() -> None:
    strain_v = np.zeros(400)
    strain_v[200] = 1.0
    rows = follow(UNSENSED, pulses(1), strain_v=strain_v)
    spike_smoothed = np.arange(200, 208)
    assert not np.isin(where(rows, SampleFlag.CONTACT), spike_smoothed).any()
    assert not len(where(rows, SampleFlag.CONTACT))


# --- shut jaws and slipping encoders ----------------------------------------------------------------------------------


def close_on(slopes_deg_per_v: list[float], until_v: list[float], seconds: float = 0.5) -> np.ndarray:
    """What the rig says of strain that rises evenly, then holds, with the encoder at these slopes up to these volts."""
    strain_v = np.concatenate([np.zeros(150), np.linspace(0.0, until_v[-1], round(seconds * 1000))])
    strain_v = np.concatenate([strain_v, np.full(200, until_v[-1])])
    degrees = np.cumsum([0.0, *np.array(slopes_deg_per_v) * np.diff([0.0, *until_v])])
    command_v = np.where(np.arange(len(strain_v)) < 100, 0.0, 2.0)
    return follow(RIG, command_v, strain_v, np.interp(strain_v, [0.0, *until_v], degrees))


@settings(max_examples=40)
@given(
    wall_v=st.floats(0.85, 1.5),
    tissue_deg_per_v=st.floats(150.0, 600.0),
    wall_deg_per_v=st.floats(49.0, 55.0),  # fitted on the recordings
    seconds=st.floats(0.2, 1.0),
)
def test_shut_jaws_are_found_where_the_encoder_only_follows_the_cable(
    wall_v: float, tissue_deg_per_v: float, wall_deg_per_v: float, seconds: float
) -> None:
    rows = close_on([tissue_deg_per_v, wall_deg_per_v], [wall_v, 3.0], seconds)
    samples_per_v = seconds * 1000 / 3.0
    shut_at = 150 + wall_v * samples_per_v
    told = where(rows, SampleFlag.JAWS_CLOSED)
    assert len(told)
    assert not len(where(rows, SampleFlag.ENCODER_SLIPS))
    # at the next quarter of the span over which the slope is taken, on means of 8 samples (4 late); some 0.1 V of
    # tissue less than 8 deg/V over the limit could still pass for wall
    quarter = RIG.wall_span_v / 4 * samples_per_v
    early = RIG.wall_span_v * 8.2 / (tissue_deg_per_v - wall_deg_per_v) * samples_per_v
    assert shut_at - early - 1 <= rows["wall"][told[0]] <= shut_at + quarter + 10
    assert told[0] <= shut_at + 5 * quarter + 20


@settings(max_examples=40)
@given(st.floats(58.0, 600.0), st.floats(58.0, 600.0), st.floats(0.1, 2.9))
def test_tissue_that_gives_way_more_than_the_cable_is_no_wall_and_no_slip(
    first: float, second: float, bend_v: float
) -> None:
    rows = close_on([first, second], [bend_v, 3.0])
    assert len(where(rows, SampleFlag.CONTACT))
    assert not len(where(rows, SampleFlag.JAWS_CLOSED | SampleFlag.ENCODER_SLIPS))


def test_something_hard_under_little_force_is_no_wall_yet() -> None:
    assert not len(
        where(
            close_on([STRETCH_DEG_PER_V], [0.95 * RIG.wall_above_v]), SampleFlag.JAWS_CLOSED | SampleFlag.ENCODER_SLIPS
        )
    )


@settings(max_examples=20)
@given(st.floats(0.0, 30.0))
def test_an_encoder_that_lags_behind_the_cables_stretch_slips(slope_deg_per_v: float) -> None:
    rows = close_on([slope_deg_per_v], [3.0])
    slips = where(rows, SampleFlag.ENCODER_SLIPS)
    assert len(slips)
    assert not len(where(rows, SampleFlag.JAWS_CLOSED))
    np.testing.assert_array_equal(slips, np.arange(slips[0], len(rows)))


@pytest.mark.parametrize(("walk_deg", "slips"), [(-190.0, True), (160.0, True), (-140.0, False), (0.0, False)])
def test_an_encoder_that_walks_between_grasps_is_flagged_from_the_second_on(walk_deg: float, slips: bool) -> None:
    command_v = pulses(2)
    rows = follow(RIG, command_v, encoder_deg=np.where(np.arange(len(command_v)) < 350, 0.0, walk_deg))
    first, second = (rows[(rows["grasp"] == index) & (rows["flags"] & SampleFlag.IN_GRASP != 0)] for index in (1, 2))
    assert not (first["flags"] & SampleFlag.ENCODER_SLIPS).any()
    assert (second["flags"] & SampleFlag.ENCODER_SLIPS != 0).all() == slips
    assert (second["flags"] & SampleFlag.ENCODER_SLIPS).any() == slips


def test_a_wall_is_forgotten_when_the_next_grasp_begins() -> None:
    command_v = pulses(2)
    strain_v = np.zeros(len(command_v))
    strain_v[100:300] = np.linspace(0.0, 2.0, 200)
    rows = follow(RIG, command_v, strain_v, STRETCH_DEG_PER_V * strain_v)
    assert len(where(rows[:300], SampleFlag.JAWS_CLOSED))
    assert not len(where(rows[320:], SampleFlag.JAWS_CLOSED))
