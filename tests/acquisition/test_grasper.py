"""The simulated grasper, against the physics that it claims to simulate."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.stats import chi2
from simulation import SIGNALS, drive, joined, simulate_raw

from acquisition.calibration import to_jaw
from acquisition.simulation.grasper import SimulatedGrasper, squeeze
from config.errors import ConfigurationError
from config.load import load_library, load_tool
from config.schema import Tool

TOOL = load_tool("simulated")
LIBRARY = load_library("porcine")
TISSUES = list(LIBRARY.tissues)
COUNT_DEG = 360 / (500 * 4 * 19)
LONG = 1000  # samples: 55 times the drive's and the cable's lag together


def grasper(tissue: str = "liver", seed: int = 0, tool: Tool = TOOL) -> SimulatedGrasper:
    return SimulatedGrasper(tool, LIBRARY, tissue, seed)


def exact(**changes: float) -> Tool:
    """A tool without spread between specimens."""
    return TOOL.model_copy(update={"simulation": TOOL.simulation.model_copy(update={"spread_scale": 0.0, **changes})})


# --- sensors ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tissue", TISSUES)
def test_at_zero_command_nothing_moves_and_only_the_strain_gage_is_noisy(tissue: str) -> None:
    raw = drive(grasper(tissue), np.zeros(20_000))
    assert not raw.encoder_deg.any()
    assert not raw.touch_1_v.any()
    assert not raw.touch_2_v.any()
    # 2 mV and the rounding to 0.161 mV; the SD of 20,000 samples is good to 0.5 %, so 2.5 % is five of its own
    assert raw.strain_v.std() == pytest.approx(math.hypot(0.002, 0.000161 / math.sqrt(12)), rel=0.025)
    # the rest voltages of the recordings lie between 0.80 and 0.84 V
    assert abs(raw.strain_v.mean() - 0.82) < 0.025


def test_sensors_read_in_whole_steps() -> None:
    raw = joined(simulate_raw("liver"))
    for signal, step in ((raw.strain_v, 0.000161), (raw.encoder_deg, COUNT_DEG)):
        np.testing.assert_allclose(signal / step, np.round(signal / step), rtol=0, atol=1e-6)
        assert len(np.unique(np.round(signal / step))) > 100


@pytest.mark.parametrize("tissue", TISSUES)
def test_calibration_of_what_the_sensors_read_gives_back_the_jaws_force_and_displacement(tissue: str) -> None:
    held = grasper(tissue)
    rest_v = drive(held, np.zeros(5000)).strain_v.mean()
    raw = drive(held, np.full(3 * LONG, 2.0))
    jaw = to_jaw(TOOL, raw.strain_v[LONG:] - rest_v, raw.encoder_deg[LONG:])
    newton_per_volt, metre_per_volt = jaw.newton_per_volt.mean(), jaw.metre_per_volt.mean()
    # means of 5000 and 2000 samples: five SD of the mean's noise; the encoder reads half a count low on average
    noise_v = 5 * 0.002 * math.sqrt(1 / 5000 + 1 / 2000)
    assert jaw.force_n.mean() == pytest.approx(held.force_n, abs=noise_v * newton_per_volt)
    assert jaw.displacement_m.mean() == pytest.approx(held.jaw_m, abs=noise_v * abs(metre_per_volt) + 1.2e-6)


def test_both_touch_sensors_tell_while_tissue_is_held() -> None:
    raw = joined(simulate_raw("gallbladder", cycles=2))
    np.testing.assert_array_equal(raw.touch_1_v, raw.touch_2_v)
    assert set(raw.touch_1_v) == {0.0, 5.0}
    touches = np.flatnonzero(np.diff(raw.touch_1_v) > 0)
    jaw_m = to_jaw(TOOL, raw.strain_v - raw.strain_v[:400].mean(), raw.encoder_deg).displacement_m
    # free travel of 0.5 mm, read with 12 µm of noise; before it the jaws have not reached the tissue
    assert len(touches) == 2
    np.testing.assert_allclose(jaw_m[touches + 1], 0.0005, rtol=0, atol=5 * 12e-6 + 60e-6)


# --- force and displacement -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tissue", TISSUES)
@pytest.mark.parametrize(("command_v", "force_n"), [(0.5, 0.8), (2.0, 1.55), (2.9, 2.0)])
def test_after_the_lag_the_jaws_press_as_the_paper_says_and_tissue_gives_way_as_eq_7_at_rest(
    tissue: str, command_v: float, force_n: float
) -> None:
    held = grasper(tissue, seed=5)
    drive(held, np.full(3 * LONG, command_v))
    specimen = held.specimen
    # 3 s are over 160 lags; a bladder creeps home with d / (alpha beta exp(beta x)), at most 2 ms here
    assert held.force_n == pytest.approx(force_n, rel=1e-9)
    assert held.x_m == pytest.approx(math.log1p(force_n / specimen.alpha_n) / specimen.beta_per_m, rel=1e-6)


def test_force_rises_with_the_drives_and_the_cables_lag() -> None:
    """Two first-order lags in a row behind a step; the cable's begins where the jaws touch, here after one sample."""
    lags = TOOL.simulation
    held = grasper("liver", tool=exact(free_travel_m=1e-9))
    force_n = []
    for _ in range(60):
        held.step(2.0)
        force_n.append(held.force_n)

    def rise(_: float, state: np.ndarray) -> list[float]:
        return [(1.55 - state[0]) / lags.drive_lag_s, (state[0] - state[1]) / lags.contact_lag_s]

    # a sample's force answers the drive at the sample's end: on average half a sample early, good to 0.7 % of the step
    time_s = (np.arange(1, 61) + 0.5) / 1000
    begin = [-1.55 * math.expm1(-0.001 / lags.drive_lag_s), 0.0]
    solution = solve_ivp(rise, (0.001, 0.061), begin, t_eval=time_s, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(force_n, solution.y[1], rtol=0, atol=0.011)


@pytest.mark.parametrize("tissue", TISSUES)
def test_the_tissue_moves_as_the_differential_equation_says(tissue: str) -> None:
    """Eq. (7) under the force that the grasper applied, integrated by SciPy's stiff solver."""
    held = grasper(tissue, seed=2)
    force_n, x_m = [], []
    for command_v in [*np.linspace(0, 2, 126)[1:], *np.full(400, 2.0)]:
        held.step(float(command_v))
        if held.in_contact:
            force_n.append(held.force_n)
            x_m.append(held.x_m)
    specimen = held.specimen
    time_s = np.arange(len(force_n)) / 1000

    def motion(t: float, state: np.ndarray) -> list[float]:
        x, v = state
        elastic_n = specimen.alpha_n * math.expm1(specimen.beta_per_m * x)
        return [v, (np.interp(t, time_s, force_n) - specimen.damping_kg_per_s * v - elastic_n) / specimen.mass_kg]

    solution = solve_ivp(
        motion, (0, time_s[-1]), [x_m[0], 0.0], method="LSODA", t_eval=time_s, rtol=1e-9, atol=1e-13, max_step=1e-3
    )
    np.testing.assert_allclose(x_m, solution.y[0], rtol=0, atol=1e-8)  # a hundredth of an encoder count


@settings(max_examples=30)
@given(
    tissue=st.sampled_from(TISSUES),
    spread=st.tuples(*[st.floats(-3, 3)] * 3),
    begin_n=st.floats(0, 2.5),
    end_n=st.floats(0, 2.5),
    v_m_per_s=st.floats(-0.05, 0.05),
)
def test_one_step_of_any_specimen_is_the_differential_equations(
    tissue: str, spread: tuple[float, float, float], begin_n: float, end_n: float, v_m_per_s: float
) -> None:
    profile, sd = LIBRARY.tissues[tissue], LIBRARY.spread
    alpha_n = profile.alpha_n * math.exp(spread[0] * sd.log_alpha)
    beta_per_m = profile.beta_per_m * math.exp(spread[1] * sd.log_beta)
    damping = profile.damping_kg_per_s * math.exp(spread[2] * sd.log_damping)
    mass_kg, x_m = 0.005, math.log1p(begin_n / alpha_n) / beta_per_m

    def motion(t: float, state: np.ndarray) -> list[float]:
        force_n = begin_n + (end_n - begin_n) * t / 1e-3
        return [state[1], (force_n - damping * state[1] - alpha_n * math.expm1(beta_per_m * state[0])) / mass_kg]

    exactly = solve_ivp(motion, (0, 1e-3), [x_m, v_m_per_s], method="DOP853", rtol=1e-11, atol=1e-15).y[:, -1]
    stepped = squeeze(x_m, v_m_per_s, begin_n, end_n, 1e-3, alpha_n, beta_per_m, damping, mass_kg)
    # a specimen three spreads off in all three is stiff: d / m reaches 1600 1/s; a tenth of an encoder count is 0.1 µm
    assert stepped[0] == pytest.approx(exactly[0], abs=1e-7)
    assert stepped[1] == pytest.approx(exactly[1], abs=1e-4)


def test_a_lump_that_the_jaws_overpower_ends_as_shut_jaws_that_take_any_force() -> None:
    soft = {"bladder": LIBRARY.tissues["bladder"].model_copy(update={"thickness_m": 0.004})}
    held = SimulatedGrasper(exact(), LIBRARY.model_copy(update={"tissues": soft}), "bladder", 0)
    drive(held, np.full(LONG, 2.0))
    assert held.x_m == pytest.approx(0.98 * 0.004)
    assert held.force_n == pytest.approx(1.55, rel=1e-9)


@pytest.mark.parametrize("tissue", TISSUES)
def test_after_a_grasp_the_jaws_let_go_and_come_back_to_rest(tissue: str) -> None:
    held = grasper(tissue)
    raw = drive(held, [*np.full(500, 2.0), *np.zeros(500)])
    assert raw.touch_1_v[499] == 5.0
    assert raw.touch_1_v[-1] == 0.0
    assert held.force_n == 0.0
    assert held.jaw_m < 1e-6  # 0.5 s are ten times the opening's time constant: 5e-5 of at most 8 mm


@pytest.mark.parametrize("tissue", TISSUES)
def test_opening_jaws_touch_the_tissue_until_the_spring_has_brought_them_back_to_it(tissue: str) -> None:
    held = grasper(tissue)
    drive(held, np.full(500, 2.0))
    closed_m, lags = held.jaw_m, TOOL.simulation
    touch_v = drive(held, np.zeros(500)).touch_1_v
    # the drive lets go at 0.02 N; then the jaws' opening decays; while it lets go they follow it a little
    let_go_s = lags.drive_lag_s * math.log(1.55 / 0.02)
    opened_m = held_displacement_m(held, 0.02) + lags.free_travel_m
    longest_s = let_go_s + lags.opening_time_s * math.log(closed_m / lags.free_travel_m)
    shortest_s = let_go_s + lags.opening_time_s * math.log(opened_m / lags.free_travel_m)
    assert shortest_s - 0.002 < np.count_nonzero(touch_v) / 1000 < longest_s + 0.002


def held_displacement_m(held: SimulatedGrasper, force_n: float) -> float:
    return math.log1p(force_n / held.specimen.alpha_n) / held.specimen.beta_per_m


# --- specimens --------------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_samples_and_another_seed_others() -> None:
    one, same, other = (joined(simulate_raw("liver", seed=seed, cycles=2)) for seed in (7, 7, 8))
    for name in SIGNALS:
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name))
    assert (one.strain_v != other.strain_v).mean() > 0.9
    assert (one.encoder_deg != other.encoder_deg).any()


def test_a_grasps_specimen_depends_on_seed_and_count_but_not_on_how_long_the_rest_was() -> None:
    def specimens(rest: int) -> list[float]:
        held, found = grasper(seed=4), []
        for _ in range(3):
            drive(held, [*np.zeros(rest), *np.full(100, 2.0), *np.zeros(400)])
            found.append(held.specimen.alpha_n)
        return found

    assert specimens(1) == specimens(333)
    assert len(set(specimens(1))) == 3


def test_closing_again_before_letting_go_holds_the_same_specimen() -> None:
    held = grasper("bladder")
    drive(held, np.full(300, 2.0))
    first = held.specimen
    drive(held, [*np.zeros(60), *np.full(300, 2.0)])
    assert held.specimen == first
    drive(held, [*np.zeros(600), *np.full(300, 2.0)])
    assert held.specimen != first


def test_what_is_to_be_held_is_found_by_the_next_grasp_not_by_this_one() -> None:
    held = grasper("liver")
    drive(held, np.full(300, 2.0))
    held.hold("bladder")
    drive(held, np.full(100, 1.0))
    assert held.specimen.tissue == "liver"
    drive(held, [*np.zeros(500), *np.full(100, 2.0)])
    assert held.specimen.tissue == "bladder"


@pytest.mark.parametrize("tissue", ["liver", "bladder"])
def test_specimens_scatter_about_the_profile_as_the_library_says(tissue: str) -> None:
    """200 grasps; bounds that a right simulation misses once in a million (two-sided)."""
    held, profile = grasper(tissue, seed=11), LIBRARY.tissues[tissue]
    logs = []
    for _ in range(200):
        held.step(1.0)
        specimen = held.specimen
        drive(held, np.zeros(150))  # the jaws open
        logs.append([
            math.log(specimen.alpha_n / profile.alpha_n),
            math.log(specimen.beta_per_m / profile.beta_per_m),
            math.log(specimen.damping_kg_per_s / profile.damping_kg_per_s),
        ])  # fmt: skip
    sd = np.array([0.25, 0.10, 0.30])  # PHYSICS: SD of log alpha, log beta, log d
    n = len(logs)
    low, high = np.sqrt(chi2.ppf([0.5e-6, 1 - 0.5e-6], n - 1) / (n - 1))
    found = np.std(logs, axis=0, ddof=1) / sd
    assert ((low < found) & (found < high)).all()
    assert (np.abs(np.mean(logs, axis=0)) < 4.9 * sd / math.sqrt(n)).all()
    correlation = np.corrcoef(np.transpose(logs))[np.triu_indices(3, 1)]
    assert (np.abs(correlation) < 4.9 / math.sqrt(n)).all()


def test_without_spread_every_specimen_is_the_profile() -> None:
    held = grasper("gallbladder", seed=3, tool=exact())
    for _ in range(3):
        drive(held, [*np.full(50, 2.0), *np.zeros(400)])
        profile = LIBRARY.tissues["gallbladder"]
        specimen = held.specimen
        assert (specimen.alpha_n, specimen.beta_per_m) == (profile.alpha_n, profile.beta_per_m)
        assert specimen.damping_kg_per_s == profile.damping_kg_per_s


def test_a_tool_without_mechanics_cannot_be_simulated() -> None:
    with pytest.raises(ConfigurationError, match=r"'nidaq' has no \[simulation\] table"):
        grasper(tool=load_tool("nidaq"))
