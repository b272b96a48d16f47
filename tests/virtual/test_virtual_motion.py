"""Loads, modal response and the plan of operation: against other integrators, spectra and plain counting."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import welch

from probupdate.errors import InputError
from probupdate.structure.load import reference_model
from probupdate.virtual import excitation, losses, operation, response
from probupdate.virtual.scada import scada_table
from probupdate.virtual.truth import parse_truth
from probupdate.virtual.turbine_file import read_turbine

RATE = 25.0
LEGS = np.array([[3.0, 3.0], [-3.0, 3.0], [-3.0, -3.0], [3.0, -3.0]])


def plan_of(n_slot=144, seed=0, **given):
    return operation.make_plan(n_slot, given, np.random.default_rng(seed))


def test_recursion_is_exact_for_linear_forces(validation):
    """Against the matrix exponential of the oscillator with a linearly growing force, step by step."""
    row = validation(what="modal response of the virtual turbine", reference="exact solution for linear forces",
                     why="rounding")
    rng = np.random.default_rng(4)
    frequency, damping = np.array([0.31, 2.0, 6.0]), np.array([0.01, 0.02, 0.3])
    force = rng.standard_normal((41, 3))
    q, v = rng.standard_normal((2, 3))
    got, last_q, last_v = response.modal_response(frequency, damping, force, RATE, q, v)
    for m in range(3):
        w = 2 * np.pi * frequency[m]
        # state q, v, f, df/dt
        a = np.array([[0, 1, 0, 0], [-(w**2), -2 * damping[m] * w, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
        step = expm(a / RATE)
        x = np.array([q[m], v[m]])
        for k in range(40):
            state = np.r_[x, force[k, m], (force[k + 1, m] - force[k, m]) * RATE]
            exact = (a @ state)[1]
            row.error((got[k, m] - exact) / max(1.0, abs(exact)), below=1e-9)
            x = (step @ state)[:2]
        assert [last_q[-1, m], last_v[m]] == pytest.approx(x, rel=1e-9)


def test_cutting_a_record_changes_nothing():
    rng = np.random.default_rng(5)
    frequency, damping = np.array([0.31, 2.0]), np.array([0.01, 0.02])
    force = rng.standard_normal((201, 2))
    whole, q, v = response.modal_response(frequency, damping, force, RATE, np.zeros(2), np.zeros(2))
    first, q1, v1 = response.modal_response(frequency, damping, force[:78], RATE, np.zeros(2), np.zeros(2))
    second, q2, v2 = response.modal_response(frequency, damping, force[77:], RATE, q1[-1], v1)
    assert np.allclose(np.vstack([first, second]), whole, rtol=0, atol=1e-12)
    assert np.allclose([q2[-1], v2], [q[-1], v])


def test_response_to_white_noise_has_the_theory_s_size(validation):
    """sigma_a^2 = pi f S / (4 zeta) (1 + 4 zeta^2) + S's own share; S one-sided in 1/Hz, here through q'."""
    row = validation(what="response to white noise", reference="theory's variance", why="length of the record")
    n, f, zeta = 2_000_000, 1.0, 0.02
    force = np.random.default_rng(6).standard_normal((n, 1))
    spectrum = 2 / RATE
    state = response.modal_response(np.array([f]), np.array([zeta]), force, RATE, np.zeros(1), np.zeros(1))[0][:, 0]
    frequency, density = welch(state, RATE, nperseg=4096)
    near = (frequency > 0.8) & (frequency < 1.2)
    exact = spectrum * (frequency / f) ** 4 / ((1 - (frequency / f) ** 2) ** 2 + (2 * zeta * frequency / f) ** 2)
    power, expected = density[near].sum(), exact[near].sum()
    # narrow-band power over n/RATE s has standard deviation 1/sqrt(2 pi f zeta T) = 1 %; linear force between samples
    # takes sinc^4(f/RATE) = 1 % off the spectrum
    row.error(power / (expected * np.sinc(f / RATE) ** 4) - 1, below=0.04)


def test_spectra_are_those_that_were_asked_for():
    # sea: 16 int S df = Hs^2, peak at Tp
    f = np.linspace(0, 2, 8001)
    sea = excitation.jonswap(f, 2.0, 6.0)
    assert 4 * np.sqrt(np.trapezoid(sea, f)) == pytest.approx(2.0, rel=1e-3)
    assert f[np.argmax(sea)] == pytest.approx(1 / 6, abs=f[1])
    # wind without admittance: the integral over all frequencies is the variance
    f = np.logspace(-6, 3, 200_000)
    wind = excitation.kaimal(f, 10.0, area_m2=0.0)
    assert np.trapezoid(wind, f) == pytest.approx(operation.turbulence_std(10.0) ** 2, rel=5e-3)
    slope = np.diff(np.log(wind))[-1] / np.diff(np.log(f))[-1]
    assert slope == pytest.approx(-5 / 3, abs=1e-3)


def test_pieces_join_to_a_stationary_signal_of_that_spectrum():
    plan = plan_of(36, seed=1)
    calm = 10.0 * np.ones(36)
    object.__setattr__(plan, "wind_mps", calm)
    wind, _ = excitation.random_loads(plan, LEGS, 7, 0.0, int(6 * 3600 * RATE), RATE)
    f, density = welch(wind[:, 0], RATE, nperseg=2048)
    inside = (f > 0.05) & (f < 5)
    ratio = density[inside] / excitation.kaimal(f[inside], 10.0)
    # 526 half-overlapping segments: about 5 % on each line, 0.3 % on the mean of 400
    assert ratio.mean() == pytest.approx(1, abs=0.02)
    assert ratio.std() < 0.12
    # no beat with the pieces: variance by position within the ten minutes
    high = np.diff(wind[:, 0])
    by_position = high[: 36 * 15000 - 15000].reshape(-1, 20, 750).var(axis=(0, 2))
    assert np.ptp(by_position) / by_position.mean() < 0.12


def test_an_hour_made_alone_joins_its_neighbour():
    plan = plan_of(36, seed=2)
    whole = excitation.make_loads(plan, LEGS, 4, 11, 3000.0, int(1200 * RATE), RATE)
    part = excitation.make_loads(plan, LEGS, 4, 11, 3600.0, int(600 * RATE), RATE)
    cut = int(600 * RATE)
    for name in ("rna", "wave", "background"):
        a, b = getattr(whole, name)[cut:], getattr(part, name)
        assert np.allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(a).max()), name


def test_harmonics_follow_the_rotor():
    plan = plan_of(36, seed=13, maintenance_hours=[], wind_speed_mean_mps=14.0)
    slot = int(np.flatnonzero((plan.state[1:-1] == operation.RATED) & (plan.state[:-2] == operation.RATED))[0]) + 1
    time = 600.0 * slot + np.arange(int(600 * RATE)) / RATE
    loads = excitation.harmonic_loads(plan, time, np.ones(len(time)))
    f, density = welch(loads[:, 0], RATE, nperseg=4096)
    rpm = np.interp(time, plan.grid_s, plan.rotor_rpm).mean()
    assert f[np.argmax(density)] == pytest.approx(3 * rpm / 60, abs=2 * f[1])
    # the phase does not jump where the plan's grid steps
    assert np.abs(np.diff(loads[:, 0])).max() < 2 * np.pi * 6 * 0.25 / RATE * 4e4


def test_plan_is_consistent():
    for seed in range(5):
        plan = plan_of(seed=seed)
        idle = plan.state == operation.IDLING
        rpm = plan.rotor_rpm.reshape(-1, operation.PER_SLOT).mean(axis=1)
        power = plan.power_kw.reshape(-1, operation.PER_SLOT).mean(axis=1)
        settled = idle & np.r_[True, idle[:-1]]
        assert np.all(rpm[settled] <= 1.0) and np.all(power[settled] <= 0)
        ran = ~idle & np.r_[False, ~idle[:-1]]
        assert np.all(rpm[ran] > 5) and np.all(rpm[ran] < 16)
        assert np.all(plan.wind_mps[plan.state == operation.RATED] >= operation.RATED_MPS)
        assert np.all(plan.wind_mps[~idle] > operation.CUT_IN_MPS - 0.31)
        assert np.all(np.abs(plan.rotor_turns[-1] - np.trapezoid(plan.rotor_rpm, plan.grid_s) / 60) < 1e-6)
        # yaw is locked in maintenance, and a heading changes only within a yaw event
        steps = np.flatnonzero(np.diff(plan.heading_deg)) + 1
        assert not np.any(plan.maintenance[(steps - 1) // operation.PER_SLOT] & plan.maintenance[
            np.minimum(steps // operation.PER_SLOT, 143)])
        yaws = [e for e in plan.events if e.kind == "yaw"]
        assert len(yaws) >= len(steps)
        assert plan.quiet_blocks().sum() >= 14


def test_scada_statistics_are_those_of_the_plan():
    plan = plan_of(seed=1)
    table = scada_table(plan, np.datetime64("2019-06-01T00:00:00"), np.random.default_rng(0))
    assert list(table["time"][:2]) == ["2019-06-01T00:00:00Z", "2019-06-01T00:10:00Z"]
    assert len(table) == 144
    for name in ("wind_speed_mps", "power_kw", "rotor_speed_rpm", "pitch_deg"):
        assert np.all(table[f"{name}_min"] <= table[name] + 1e-3)
        assert np.all(table[f"{name}_max"] >= table[name] - 1e-3)
        # none scatters by more than half its range
        half = (table[f"{name}_max"] - table[f"{name}_min"]) / 2
        assert np.all(table[f"{name}_std"] <= half + 1e-3) and table[f"{name}_std"].max() > 0.05 * half.max() > 0
    assert table["nacelle_heading_deg"].between(0, 360).all() and table["wind_direction_deg"].between(0, 360).all()
    moving = table["yaw_rate_degps_max"] > 0
    touched = {int(t // 600) for e in plan.events if e.kind == "yaw"
               for t in np.arange(e.start_s, e.start_s + e.duration_s, 10.0)}
    assert set(np.flatnonzero(moving)) == touched
    tests = {int(e.start_s // 600) for e in plan.events if e.kind == "pitch"}
    assert all(table["pitch_deg_std"][k] > 0.5 for k in tests)
    quiet = np.repeat(plan.quiet_blocks(), 3)
    settled = quiet & np.r_[False, quiet[:-1]]
    assert np.all(table["pitch_deg_std"][settled] < 0.5)


def test_gaps_stay_within_the_campaign_and_spare_the_long_stop():
    for seed in range(20):
        plan = plan_of(seed=seed)
        gaps = losses.draw_gaps(plan, ("a", "b"), {}, np.random.default_rng(seed))
        assert all(g.start_s >= 0 and g.start_s + g.duration_s <= 86400 + 1e-6 for g in gaps)
        (hour,) = [int(g.start_s // 3600) for g in gaps if g.kind == losses.MISSING_HOUR]
        assert not plan.maintenance[6 * hour : 6 * hour + 6].any()


def test_a_stop_that_ends_before_it_begins_is_named():
    with pytest.raises(InputError, match="maintenance_hours"):
        plan_of(maintenance_hours=[[3, 1]])


@pytest.mark.parametrize("given", [{"maintenance_hours": [3, 5]}, {"wind_speed_mean_mps": 80}])
def test_mistakes_in_operation_are_named(given):
    file = read_turbine(reference_model("updated"))
    with pytest.raises(InputError, match=next(iter(given))):
        parse_truth({"operation": given}, file)


def test_a_missing_hour_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="missing_hours"):
        losses.draw_gaps(plan_of(36), ("a",), {"missing_hours": [7]}, np.random.default_rng(0))
