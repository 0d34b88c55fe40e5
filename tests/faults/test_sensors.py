"""Broken sensors at every moment of a grasp: the motor is at zero in time, and no wrong tissue is named."""

from itertools import product

import pytest
from faulty import AT, CYCLE, LEAD_IN, PROTOCOL, TOOL, Bench, Moment

from acquisition.safety_state_machine import Safety
from acquisition.simulation import faults
from acquisition.simulation.faults import SensorFault
from config.errors import RefusedError

FLOOR = 15
LOST = {
    SensorFault.STRAIN_STUCK: "stuck",
    SensorFault.STRAIN_SATURATED: "saturated|jumped",
    SensorFault.STRAIN_DROP_OUT: "jumped|stuck|below its rest",
    SensorFault.STRAIN_JUMP: "jumped|below its rest",
    SensorFault.STRAIN_NAN: "gives no number",
    SensorFault.ENCODER_JUMP: "encoder jumped",
}


@pytest.mark.parametrize("moment", [Moment.RAMP, Moment.HOLD, Moment.RELEASE])
@pytest.mark.parametrize("fault", LOST, ids=str)
def test_a_lost_signal_brings_the_motor_to_zero_within_15_ms_of_its_first_sample(fault, moment, reactions):
    for tissue, offset in product(("liver", "bladder"), range(TOOL.board.block_samples)):
        bench = Bench(tissue).play(until=AT[moment])
        assert bench.board.output_v > 0
        bench.sensors.inject_fault_at(fault, AT[moment] + offset)
        bench.play()
        [ended] = bench.ended
        assert any(word in ended.why for word in LOST[fault].split("|")), ended.why
        assert bench.acquisition.safety is Safety.FAULTED
        took = bench.zero_at - bench.sensors.fault_sample
        reactions.add(fault, moment, took, FLOOR)
        assert 0 < took <= FLOOR
        assert {*bench.labels} <= {tissue, "undecided", "unknown", "no_answer"}


@pytest.mark.parametrize("moment", [Moment.RAMP, Moment.HOLD, Moment.RELEASE])
def test_noise_is_told_from_force_within_15_ms_in_nine_of_ten_cases(moment, reactions):
    """By chance the first samples may look like sound ones."""
    took = []
    for seed in range(30):
        bench = Bench("bladder", sensor_seed=seed).play(until=AT[moment])
        bench.sensors.inject_fault_at(SensorFault.STRAIN_NOISE, AT[moment] + seed % TOOL.board.block_samples)
        bench.play()
        [ended] = bench.ended
        assert ended.end.value == "failed"
        took.append(bench.zero_at - bench.sensors.fault_sample)
        reactions.add(SensorFault.STRAIN_NOISE, moment, took[-1], 30)
        assert {*bench.labels} <= {"bladder", "undecided", "unknown", "no_answer"}
    assert sum(each <= FLOOR for each in took) >= 0.9 * len(took)
    assert max(took) <= 30


@pytest.mark.parametrize("fault", [SensorFault.ENCODER_STUCK, SensorFault.ENCODER_REVERSED], ids=str)
def test_an_encoder_that_breaks_at_rest_ends_the_run_as_soon_as_the_jaws_move(fault, reactions):
    """Nothing tells a still encoder from still jaws before the force changes by 0.3 N under it."""
    for tissue in ("liver", "bladder"):
        bench = Bench(tissue).play(until=AT[Moment.LEAD_IN])
        bench.sensors.inject_fault(fault)
        bench.play()
        [ended] = bench.ended
        assert "encoder" in ended.why
        took = bench.zero_at - LEAD_IN
        reactions.add(fault, "from the command on", took, 150)
        assert took <= 150
        assert {*bench.labels} <= {tissue, "undecided", "unknown", "no_answer"}


@pytest.mark.parametrize("fault", [SensorFault.ENCODER_STUCK, SensorFault.ENCODER_REVERSED], ids=str)
@pytest.mark.parametrize("moment", [Moment.RAMP, Moment.HOLD, Moment.RELEASE])
def test_an_encoder_that_breaks_in_a_grasp_names_nothing_wrong_and_ends_the_run_by_the_next(fault, moment, reactions):
    for tissue in ("liver", "bladder"):
        bench = Bench(tissue).play(until=AT[moment])
        bench.sensors.inject_fault(fault)
        bench.play()
        [ended] = bench.ended
        assert "encoder" in ended.why
        took = bench.zero_at - bench.sensors.fault_sample
        reactions.add(fault, moment, took, CYCLE + 100)
        assert took <= CYCLE + 100
        assert {*bench.labels} <= {tissue, "undecided", "unknown", "no_answer"}


@pytest.mark.parametrize("moment", [Moment.RAMP, Moment.HOLD])
def test_a_slipping_encoder_names_nothing_wrong_and_the_force_stays_under_the_lowest_limit(moment):
    for tissue in ("liver", "bladder"):
        bench = Bench(tissue, cycles=2).play(until=AT[moment])
        bench.sensors.inject_fault(SensorFault.ENCODER_SLIPS)
        bench.play()
        assert {grasp.label for grasp in bench.grasps} <= {tissue, "undecided", "unknown", "no_answer"}


@pytest.mark.parametrize("moment", list(Moment))
def test_a_spike_of_one_sample_ends_nothing(moment):
    bench = Bench("bladder", cycles=2).play(until=AT[moment])
    bench.sensors.inject_fault(SensorFault.STRAIN_SPIKE)
    bench.play()
    [ended] = bench.ended
    assert ended.end.value == "finished"
    assert {grasp.label for grasp in bench.grasps} <= {"bladder", "undecided", "unknown", "no_answer"}


@pytest.mark.parametrize("fault", [*LOST, SensorFault.STRAIN_NOISE], ids=str)
def test_a_sensor_that_breaks_before_the_grasp_keeps_the_motor_at_zero(fault):
    bench = Bench("bladder").play(until=AT[Moment.LEAD_IN])
    bench.sensors.inject_fault(fault)
    bench.play()
    [ended] = bench.ended
    assert ended.end.value == "failed"
    assert not bench.board.output_changes


@pytest.mark.parametrize("fault", [*LOST, SensorFault.STRAIN_NOISE, SensorFault.ENCODER_STUCK], ids=str)
def test_after_a_fault_nothing_moves_until_it_is_acknowledged_and_a_broken_tool_cannot_be_armed(fault):
    bench = Bench("bladder").play(until=AT[Moment.HOLD])
    bench.sensors.inject_fault(fault)
    bench.play()
    acquisition = bench.acquisition
    for refused in (acquisition.arm, lambda: acquisition.start("again", PROTOCOL, 1)):
        with pytest.raises(RefusedError, match="acknowledge it first"):
            refused()
    acquisition.stop("asked")
    acquisition.disarm()
    assert acquisition.safety is Safety.FAULTED
    acquisition.acknowledge()
    assert acquisition.safety is Safety.DISARMED
    bench.sensors.clear_fault()
    bench.rest(60)  # the jaws open
    acquisition.arm()
    bench.rest(100)
    assert acquisition.safety is Safety.ARMED


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        (SensorFault.STRAIN_STUCK, "scatters by 0.00 mV"),
        (SensorFault.STRAIN_SATURATED, "rests at 10.000 V"),
        (SensorFault.STRAIN_DROP_OUT, "rests at 0.000 V"),
        (SensorFault.STRAIN_JUMP, "rests at 0.5"),
        (SensorFault.STRAIN_NOISE, "scatters by"),
        (SensorFault.STRAIN_NAN, "no number"),
    ],
    ids=str,
)
def test_the_self_test_refuses_to_arm_a_broken_tool_and_says_why(fault, why):
    bench = Bench("bladder").play(until=50)
    bench.acquisition.disarm()
    assert bench.acquisition.safety is Safety.DISARMED
    bench.sensors.inject_fault(fault)
    bench.acquisition.arm()
    bench.rest(100)
    assert bench.acquisition.safety is Safety.TESTING
    bench.rest(150)
    assert bench.acquisition.safety is Safety.DISARMED
    assert why in bench.acquisition.why


def test_a_gage_that_rests_elsewhere_since_the_last_run_is_a_fault_until_the_tool_is_armed_anew(monkeypatch):
    """By more than a grasp may leave behind, and less than the self-test refuses: arming takes a new tare."""
    monkeypatch.setattr(faults, "JUMP_V", 0.035)
    bench = Bench("bladder", cycles=1).play().rest(100)
    acquisition = bench.acquisition
    assert acquisition.safety is Safety.ARMED
    bench.sensors.inject_fault(SensorFault.STRAIN_JUMP)
    bench.rest(40)
    assert acquisition.safety is Safety.FAULTED
    assert "off its tare" in acquisition.why
    acquisition.acknowledge()
    acquisition.arm()
    bench.rest(8)
    assert acquisition.safety is Safety.TESTING  # 50 samples are a tare
    bench.rest(200)
    assert acquisition.safety is Safety.ARMED
    acquisition.start("again", PROTOCOL, 1)
    bench.play()
    assert [ended.end.value for ended in bench.ended] == ["finished", "finished"]
