"""The motor command over time: the paper's waveforms, and what a tool refuses to play."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.protocol_player import MAX_CYCLE_SAMPLES, ProtocolPlayer, build_cycle_command
from config.errors import GraspwatchError, RefusedError
from config.load import list_shipped_names, load_grasp_protocol, load_tool
from config.schema import CustomWaveform, GraspProtocol, SineWaveform, Tool, TrapezoidWaveform

TOOL = load_tool("simulated")
RATE_HZ = 1000.0
# the paper's motor commands, and the ramps of its three rates; held for 0.5 s, then 0.5 s of rest
RAMP_S = {"trapezoid_025hz": 1.0, "trapezoid_2hz": 0.125, "trapezoid_4hz": 0.0625}
PEAK_V = {"": 2.0, "_low": 0.5}
TRAPEZOIDS = [(rate + level, RAMP_S[rate], PEAK_V[level]) for rate in RAMP_S for level in PEAK_V]


def trapezoid(
    peak_v: float, up_s: float = 0.1, hold_s: float = 0.2, down_s: float = 0.1, rest_s: float = 0.1
) -> GraspProtocol:
    waveform = TrapezoidWaveform(
        shape="trapezoid", peak_v=peak_v, ramp_up_s=up_s, hold_s=hold_s, ramp_down_s=down_s, rest_s=rest_s
    )
    return GraspProtocol(name="mine", title="Mine", waveform=waveform)


def as_quick_as(max_command_v_per_s: float) -> Tool:
    limits = TOOL.limits.model_copy(update={"max_command_v_per_s": max_command_v_per_s})
    return TOOL.model_copy(update={"limits": limits})


@pytest.mark.parametrize("name", sorted({*list_shipped_names("protocols")} - {"by_hand"}))
def test_every_shipped_protocol_passes_the_bound_on_the_rise_and_a_faster_one_is_refused(name: str) -> None:
    fastest = np.diff(build_cycle_command(load_grasp_protocol(name), TOOL)).max() * RATE_HZ
    with pytest.raises(RefusedError, match=r"rises by .* V/s; the tool 'simulated' allows at most .* V/s\. Make"):
        build_cycle_command(load_grasp_protocol(name), as_quick_as(0.99 * fastest))


def test_a_cycle_is_as_long_as_can_be_computed_between_two_blocks() -> None:
    longest_s = MAX_CYCLE_SAMPLES / RATE_HZ
    assert len(build_cycle_command(trapezoid(1.0, hold_s=longest_s - 0.3), TOOL)) == MAX_CYCLE_SAMPLES
    with pytest.raises(RefusedError, match=r"'mine' takes 301 s; at 1000 samples a second at most 300 s can be played"):
        build_cycle_command(trapezoid(1.0, hold_s=longest_s + 0.7), TOOL)


def test_a_fall_is_never_too_fast() -> None:
    assert build_cycle_command(trapezoid(3.5, up_s=0.06, down_s=0.001), TOOL).max() == pytest.approx(3.5)


def played(player: ProtocolPlayer, block: int) -> np.ndarray:
    """Commands of a whole run, one a sample, each held for a block."""
    commands: list[float] = []
    while not player.done:
        commands += [player.next_command(block)] * block
    return np.array(commands)


def test_all_of_the_papers_protocols_are_shipped() -> None:
    assert {"sine", *(name for name, _, _ in TRAPEZOIDS)} <= set(list_shipped_names("protocols"))


@pytest.mark.parametrize(("name", "ramp_s", "peak_v"), TRAPEZOIDS)
def test_a_shipped_trapezoid_has_the_papers_ramps_peak_hold_and_rest(name: str, ramp_s: float, peak_v: float) -> None:
    command_v = build_cycle_command(load_grasp_protocol(name), TOOL)
    time_s = np.arange(len(command_v)) / RATE_HZ
    assert time_s[-1] + 1 / RATE_HZ == pytest.approx(2 * ramp_s + 0.5 + 0.5)
    grasp_s = 2 * ramp_s + 0.5
    expected = peak_v * np.clip(np.minimum(time_s, grasp_s - time_s) / ramp_s, 0.0, 1.0)
    np.testing.assert_allclose(command_v, expected, rtol=0, atol=1e-12)


def test_the_sine_is_a_force_of_2_newton_first_at_2_then_at_4_hz_for_10_s() -> None:
    command_v = build_cycle_command(load_grasp_protocol("sine"), TOOL)
    force_n = TOOL.command_to_force.to_force_n(command_v)
    assert len(command_v) == 10.5 * RATE_HZ  # with its rest
    assert not command_v[10_000:].any()
    time_s = np.arange(10_000) / RATE_HZ
    cycles = np.where(time_s < 0.5, 2 * time_s, 1 + 4 * (time_s - 0.5))
    np.testing.assert_allclose(force_n[:10_000], 2.0 * np.sin(np.pi * cycles) ** 2, rtol=0, atol=1e-12)
    tops = np.flatnonzero((force_n[1:-1] > force_n[:-2]) & (force_n[1:-1] >= force_n[2:])) + 1
    np.testing.assert_allclose(tops / RATE_HZ, [0.25, *(0.5 + 0.125 + 0.25 * np.arange(38))], rtol=0, atol=5e-4)
    np.testing.assert_allclose(force_n[tops], 2.0, rtol=0, atol=2e-4)  # a top between two samples


@given(st.data())
def test_a_custom_waveform_goes_straight_from_point_to_point(data: st.DataObject) -> None:
    steps_ms = data.draw(st.lists(st.integers(1, 300), min_size=2, max_size=8).filter(lambda steps: sum(steps) >= 20))
    times_ms = [0, *np.cumsum(steps_ms).tolist()]
    inner = st.lists(st.floats(0, 3.5), min_size=len(steps_ms) - 1, max_size=len(steps_ms) - 1)
    volts = [0.0, *data.draw(inner), 0.0]
    waveform = CustomWaveform(
        shape="custom", time_s=tuple(time / 1000 for time in times_ms), command_v=tuple(volts), rest_s=0.05
    )
    command_v = build_cycle_command(GraspProtocol(name="mine", title="Mine", waveform=waveform), as_quick_as(1e6))
    assert len(command_v) == times_ms[-1] + 50
    np.testing.assert_allclose(command_v[times_ms], volts, rtol=0, atol=1e-9)
    for k, steps in enumerate(steps_ms):
        middle = times_ms[k] + steps // 2
        share = (middle - times_ms[k]) / steps
        assert command_v[middle] == pytest.approx(volts[k] + share * (volts[k + 1] - volts[k]), abs=1e-9)
    assert not command_v[times_ms[-1] :].any()


# --- limits -----------------------------------------------------------------------------------------------------------


@given(st.floats(0.01, 20.0))
def test_a_trapezoid_is_played_up_to_the_tools_command_and_refused_beyond(peak_v: float) -> None:
    if peak_v <= 3.5:
        assert build_cycle_command(trapezoid(peak_v), TOOL).max() == pytest.approx(peak_v, rel=1e-12)
        return
    with pytest.raises(RefusedError, match=rf"asks for {peak_v:.2f} V.* allows at most 3\.50 V\. Lower its peak"):
        ProtocolPlayer(trapezoid(peak_v), TOOL, 1)


@pytest.mark.parametrize(("peak_n", "refused"), [(2.29, False), (2.31, True)])
def test_a_sine_is_refused_where_its_force_needs_too_large_a_command(peak_n: float, refused: bool) -> None:
    """3.5 V give 1.55 N + 1.5 V x 0.5 N/V = 2.3 N."""
    sine = SineWaveform(shape="sine", peak_n=peak_n, first_hz=2.0, then_hz=4.0, then_cycles=1, rest_s=0.5)
    protocol = GraspProtocol(name="mine", title="Mine", waveform=sine)
    if not refused:
        assert build_cycle_command(protocol, TOOL).max() <= 3.5
        return
    with pytest.raises(RefusedError, match=r"at most 3\.50 V"):
        build_cycle_command(protocol, TOOL)


def test_a_run_longer_than_the_tool_may_run_is_refused() -> None:
    cycles = 7200  # of 0.5 s, after 0.5 s of lead-in: half a second over the hour
    with pytest.raises(RefusedError, match=r"7200 cycles .* allows at most 3600 s\. Ask for fewer cycles"):
        ProtocolPlayer(trapezoid(1.0), TOOL, cycles)
    assert not ProtocolPlayer(trapezoid(1.0), TOOL, cycles - 1).done


def test_a_rest_of_30_000_years_is_refused_as_too_long() -> None:
    with pytest.raises(GraspwatchError):
        ProtocolPlayer(trapezoid(1.0, rest_s=1e12), TOOL, 1)


def test_a_cycle_shorter_than_a_sample_is_refused() -> None:
    with pytest.raises(GraspwatchError):
        ProtocolPlayer(trapezoid(1.0, up_s=1e-6, hold_s=0.0, down_s=1e-6, rest_s=1e-6), TOOL, 1)


# --- playing ----------------------------------------------------------------------------------------------------------


@given(cycles=st.integers(1, 4), block=st.integers(1, 100), lead_in_ms=st.integers(0, 300))
def test_a_run_is_its_lead_in_and_its_cycles_whatever_the_blocks(cycles: int, block: int, lead_in_ms: int) -> None:
    protocol = trapezoid(2.0).model_copy(update={"lead_in_s": lead_in_ms / 1000})
    command_v = played(ProtocolPlayer(protocol, TOOL, cycles), block)
    whole = np.concatenate([np.zeros(lead_in_ms), *([build_cycle_command(protocol, TOOL)] * cycles)])
    starts = np.arange(0, len(whole), block)
    np.testing.assert_array_equal(command_v, np.repeat(whole[starts], block))


def test_it_is_done_right_after_the_last_rest_and_silent_from_then_on() -> None:
    player = ProtocolPlayer(trapezoid(2.0), TOOL, 2)
    commands = []
    for _ in range(300):  # 0.5 s lead-in and twice 0.5 s, by fives
        assert not player.done
        commands.append(player.next_command(5))
    assert player.done
    assert max(commands) == 2.0
    assert [player.next_command(5) for _ in range(10)] == [0.0] * 10
