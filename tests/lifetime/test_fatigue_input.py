"""What a fatigue.toml may say, and what its states take: bounds with their reason, spots of one place, damping by
state, slow wind."""

import copy

import numpy as np
import pytest
from gaussian_record import gaussian_record

from probupdate.errors import InputError
from probupdate.lifetime.conditions import Conditions, jonswap, kaimal, read_conditions, rotor_admittance
from probupdate.lifetime.damping import StateDamping
from probupdate.lifetime.efthymiou import Geometry, cross, tee
from probupdate.lifetime.fatigue import fatigue_model
from probupdate.lifetime.spectral import rainflow
from tests.lifetime.test_stress import CONDITIONS, _toml, turbine

OTHER_STATE = {**CONDITIONS["state"][1], "share": 0.45}


def changed(**tables):
    raw = copy.deepcopy(CONDITIONS)
    raw.update(tables)
    return raw


SITE = {"water_density_kgpm3": 1025.0, "gravity_mps2": 9.81, "mudline_m": -50.0, "water_level_m": 0.0, "growth_m": 0.0,
        "hub_offset_m": [-5.0, 0.0, 2.4]}


@pytest.mark.parametrize("tables, words", [
    ({"curve": {"T": {**CONDITIONS["curve"]["T"], "log10_a1": 11.764 + 18}}}, "ranges in MPa"),
    ({"curve": {"T": {**CONDITIONS["curve"]["T"], "reference_thickness_m": 32.0}}}, "wall in metres"),
    ({"state": [{**CONDITIONS["state"][0], "turbulence": 12.0}, CONDITIONS["state"][1]]}, "not per cent"),
    ({"state": [{**CONDITIONS["state"][0], "hs_m": 55.0}, CONDITIONS["state"][1]]}, "wave height in metres"),
    ({"life": {"age_years": 31.0, "years": 30, "reference_cycles": 1e7}}, "above years"),
    ({"direction": [{"heading_deg": 0.0, "share": 0.7}, {"heading_deg": 360.0, "share": 0.3}]}, "heading of direction"),
    ({"state": [CONDITIONS["state"][0], OTHER_STATE, OTHER_STATE]}, "'rated' is that of state"),
    ({"wind": {**CONDITIONS["wind"], "rotor_diameter_m": 126000.0}}, "length in metres"),
    ({"state": [CONDITIONS["state"][0], OTHER_STATE, {**OTHER_STATE, "name": "Rated "}]}, "'Rated ' is that of state"),
    ({"state": [{**CONDITIONS["state"][0], "tp_s": 0.09}, CONDITIONS["state"][1]]}, "not the peak frequency"),
    ({"curve": {"T": {**CONDITIONS["curve"]["T"], "log10_a1": 11.764 - 2.515}}}, "one in ksi"),
    ({"curve": {"T": {**CONDITIONS["curve"]["T"], "log10_a2": 17.0}}}, "both slopes of one curve"),
    ({"inspection": {"age_years": 9.0, "detectable_share": 0.5}}, "above the age"),
    ({"target": {"annual_index": 5e-4}}, "not a probability"),
    ({"damping": {"ratio": 1.0}}, "not per cent"),
    ({"site": {**SITE, "water_density_kgpm3": 1.025}}, "sea water has 1025"),
    ({"site": {**SITE, "gravity_mps2": 9810.0}}, "9.81 on this planet"),
    ({"site": {**SITE, "growth_m": 100.0}}, "thickness in metres"),
    ({"site": {**SITE, "hub_offset_m": [-5000.0, 0.0, 2400.0]}}, "hub_offset_m"),
    ({"life": {"age": 5.0, "years": 30, "reference_cycles": 1e7}}, "life.age: is not a key of this file; did you mean"),
    ({"inspection": {"age": 4.0, "detectable_share": 0.5}}, "did you mean 'age_years'"),
    ({"target": {"index": 3.3}}, "did you mean 'annual_index'"),
    ({"wind": {**CONDITIONS["wind"], "air_density_kgpm3": 1.225e-3}}, "of air about 1.2"),
    ({"wind": {**CONDITIONS["wind"], "rotor_diameter_m": 0.09}}, "length in metres"),
    ({"life": {**CONDITIONS["life"], "reference_cycles": 7.0}}, "such as 1e7"),
    ({"uncertainty": {**CONDITIONS["uncertainty"], "x_load": {"median": 95.0, "cov": 0.1}}}, "near 1, not per cent"),
])
def test_numbers_of_another_unit_are_refused_with_their_key(tmp_path, tables, words):
    (tmp_path / "fatigue.toml").write_text(_toml(changed(**tables)))
    with pytest.raises(InputError, match=words) as error:
        read_conditions(tmp_path / "fatigue.toml")
    assert "fatigue.toml: " in str(error.value)


LOW = [
    (("water", "inertia_coefficient"), (1e-3, 0.1)), (("water", "drag_coefficient"), (1e-3, 0.1)),
    (("damping", "ratio"), (1e-3, 0.01, 100)), (("wind", "integral_length_m"), (1e-3, 0.1, 10)),
    (("state", 0, "hs_m"), (1e-3,)), (("state", 1, "wind_mps"), (1e-3, 0.1, 10)),
    (("state", 0, "turbulence"), (1e-3, 0.1, 100)), (("state", 0, "thrust_coefficient"), (1e-3, 0.01, 10)),
    (("curve", "T", "reference_thickness_m"), (1e-3, 0.1, 10, 1e3)), (("curve", "T", "thickness_exponent"), (0.1, 10)),
    (("girth", 0, "factor"), (1e-3, 0.1, 10)), (("uncertainty", "x_load", "median"), (0.1, 10)),
    (("uncertainty", "miner", "cov"), (0.01, 100)), (("uncertainty", "log10_a_std"), (0.01, 10)),
    (("joint", 0, "chord", "axial_saddle"), (0.01, 100)),
]


@pytest.mark.parametrize(("place", "factor"), [(place, f) for place, factors in LOW for f in factors])
def test_numbers_off_by_powers_of_ten_are_refused_with_their_key(tmp_path, place, factor):
    raw = copy.deepcopy(CONDITIONS)
    table = raw
    for step in place[:-1]:
        table = table[step]
    table[place[-1]] *= factor
    (tmp_path / "fatigue.toml").write_text(_toml(raw))
    with pytest.raises(InputError, match=str(place[-1])) as error:
        read_conditions(tmp_path / "fatigue.toml")
    assert "; give " in str(error.value)


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_rotor_of_another_turbine_is_refused(factor):
    raw = changed(wind={**CONDITIONS["wind"], "rotor_diameter_m": min(factor * 90.0, 400.0)})
    with pytest.raises(InputError, match="wind.rotor_diameter_m: .* times the structure's height above the water"):
        fatigue_model(turbine(), "small", Conditions.model_validate(raw))


def test_two_welds_of_one_place_are_two_spots():
    """Inner and outer toe, with factors of 1.8 and 1."""
    girth = [{"part": "tower", "z_m": 12.0, "factor": f, "curve": "T"} for f in (1.8, 1.0)]
    model = fatigue_model(turbine(), "small", Conditions.model_validate(changed(girth=girth)))
    welds = [k for k, s in enumerate(model.spots) if s.side.startswith("weld")]
    keys = {(model.details[model.spots[k].detail].name, model.spots[k].side, model.spots[k].place) for k in welds}
    assert len(keys) == len(welds)
    ranges = model.solve(model.parameters.initial).equivalent_mpa(5.0)[welds]
    half = len(welds) // 2
    np.testing.assert_allclose(ranges[:half], 1.8 * ranges[half:], rtol=1e-9)


def joint(beta, gamma, alpha):
    return Geometry(chord_diameter_m=1.0, chord_wall_m=0.5 / gamma, chord_length_m=alpha / 2, brace_diameter_m=beta,
                    brace_wall_m=0.4 / gamma, angle_deg=60.0)


@pytest.mark.parametrize("beta, gamma, alpha", [(0.6, 15.0, 6.0), (0.4, 20.0, 8.0)])
def test_short_chords_with_fixed_ends_take_the_table_s_first_factor(beta, gamma, alpha, validation):
    """F1 = 1 - (0.83 b - 0.56 b^2 - 0.02) g^0.23 exp(-0.21 g^-1.16 a^2.5) by hand, saddles alone."""
    f1 = 1 - (0.83 * beta - 0.56 * beta**2 - 0.02) * gamma**0.23 * np.exp(-0.21 * gamma**-1.16 * alpha**2.5)
    f2 = 1 - (1.43 * beta - 0.97 * beta**2 - 0.03) * gamma**0.04 * np.exp(-0.71 * gamma**-1.38 * alpha**2.5)
    row = validation(what="short chord with fixed ends and with pinned ones: saddle factors of X joints",
                     reference="F1 and F2 of DNV-RP-C203, table B-1, by hand", why="rounding")
    long = joint(beta, gamma, 14.0)
    for fixity, factor in ((0.5, f1), (0.7, f2)):
        short_side, long_side = cross(joint(beta, gamma, alpha), fixity)[0], cross(long, fixity)[0]
        row.error(short_side.axial_saddle / long_side.axial_saddle / factor - 1, below=1e-12)
    assert tee(joint(beta, gamma, alpha), 0.5)[0].axial_saddle == pytest.approx(f1 * tee(long, 0.5)[0].axial_saddle)


def weld_spectrum(model, state):
    """Frequencies, and the spectrum of the tower weld's stress at place 1 in one state by the model's own transfer."""
    one = model.models[0]
    spot = next(k for k, s in enumerate(model.spots) if s.side == "weld" and s.place == 1)
    weight, at = np.array(model.spots[spot].weight), model.spots[spot].detail
    thrust = np.tensordot(weight, one.transfer(one.parameters.initial, {}, state, wind=True)[at], 1)
    waves = np.tensordot(weight, one.transfer(one.parameters.initial, {}, state)[at], 1)
    f = one.frequency_hz
    c, s = model.conditions, model.conditions.state[state]
    area = np.pi / 4 * c.wind.rotor_diameter_m**2
    rate = c.wind.air_density_kgpm3 * area * s.thrust_coefficient * s.wind_mps
    force = (rate * rotor_admittance(f, s.wind_mps, area)) ** 2 * kaimal(f, s.wind_mps, s.turbulence,
                                                                         c.wind.integral_length_m)
    spectrum = np.abs(thrust) ** 2 * force
    spectrum[: len(waves)] += np.abs(waves) ** 2 * jonswap(f[: len(waves)], s.hs_m, s.tp_s, s.gamma)
    return spot, f, spectrum


def test_ten_minute_records_with_slow_wind_are_counted_alike(validation):
    """Half the variance lies below 0.03 Hz: twenty hours drawn, counted in pieces of ten minutes."""
    model = fatigue_model(turbine(), "small", Conditions.model_validate(changed(
        direction=[{"heading_deg": 0.0, "share": 1.0}], state=[{**CONDITIONS["state"][1], "share": 1.0}])))
    spot, f, spectrum = weld_spectrum(model, 0)
    assert f[0] == pytest.approx(1 / 600)
    slow = f < 0.03
    assert np.trapezoid(spectrum[slow], f[slow]) > 0.4 * np.trapezoid(spectrum, f)
    rate, n = 8.0, 4800
    record = gaussian_record(f, spectrum, rate_hz=rate, n_sample=120 * n, rng=np.random.default_rng(2))
    row = validation(what="damage-equivalent range with wind from 1/600 Hz, m = 3 and 5",
                     reference="rainflow counts of twenty hours in ten-minute pieces",
                     why="Park's fit, half cycles of a piece, twenty hours")
    found = model.solve(model.parameters.initial)
    for m in (3.0, 5.0):
        counted = sum(float(np.sum(count * size**m)) for size, count in map(rainflow, record.reshape(-1, n)))
        counted *= 365.25 * 86400 / (len(record) / rate) / model.conditions.life.reference_cycles
        row.error(found.equivalent_mpa(m)[spot] / counted ** (1 / m) - 1, below=0.06, of=f"m = {m:g}")


def test_operating_states_take_what_was_measured_under_operation():
    """Idling 1.65 %, operating 4.2 % with the rotor's in it: each state as if the file had its own ratio alone."""
    def ranges(damping, state, **coefficient):
        one = {**CONDITIONS["state"][state], "share": 1.0, **coefficient}
        model = fatigue_model(turbine(), "small", Conditions.model_validate(changed(
            direction=[{"heading_deg": 0.0, "share": 1.0}], state=[one])))
        return model.solve(model.parameters.initial, damping).equivalent_mpa(5.0)

    model = fatigue_model(turbine(), "small", Conditions.model_validate(CONDITIONS))
    labels = model.models[0].modes_at(model.parameters.initial, {"FA1": 0.01}).labels
    idling, operating = ({label: ratio for label in labels} for ratio in (0.0165, 0.042))
    both = StateDamping(idling=idling, operating=operating, rotor=False)
    np.testing.assert_allclose(ranges(both, 0), ranges(idling, 0), rtol=1e-12)
    # an idling turbine of the same loads has no rotor damping of its own
    np.testing.assert_allclose(ranges(both, 1), ranges(operating, 1, operating=False), rtol=1e-12)
    added = ranges(StateDamping(idling=idling, operating=idling, rotor=True), 1)
    still = ranges(idling, 1, operating=False)
    worst = np.argmax(still)
    assert added[worst] < still[worst]
