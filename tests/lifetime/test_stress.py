"""Stress transfer: static limits by hand, a direct solution, a record in time, derivatives by differences, the
basis."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from scipy.integrate import quad
from scipy.sparse import linalg as sparse_linalg

from probupdate.errors import InputError
from probupdate.lifetime import stress as stresses
from probupdate.lifetime.conditions import Conditions, jonswap, kaimal, read_conditions, wave_number
from probupdate.lifetime.fatigue import fatigue_model
from probupdate.lifetime.spectral import rainflow
from probupdate.structure.description_file import parse_description
from tests.small_turbine import small_turbine

CONDITIONS = {
    "format": 1,
    "water": {"inertia_coefficient": 2.0, "drag_coefficient": 0.8},
    "wind": {"air_density_kgpm3": 1.225, "rotor_diameter_m": 90.0, "integral_length_m": 340.2},
    "damping": {"ratio": 0.02},
    "life": {"age_years": 5.0, "years": 30, "reference_cycles": 1e7},
    "direction": [{"heading_deg": 0.0, "share": 0.7}, {"heading_deg": 50.0, "share": 0.3}],
    "state": [
        {
            "name": "storm",
            "share": 0.1,
            "operating": False,
            "hs_m": 4.0,
            "tp_s": 9.0,
            "gamma": 2.0,
            "wind_mps": 25.0,
            "turbulence": 0.12,
            "thrust_coefficient": 0.05,
        },
        {
            "name": "rated",
            "share": 0.9,
            "operating": True,
            "hs_m": 1.5,
            "tp_s": 6.0,
            "gamma": 1.5,
            "wind_mps": 11.0,
            "turbulence": 0.14,
            "thrust_coefficient": 0.7,
        },
    ],
    "curve": {
        "T": {
            "log10_a1": 11.764,
            "m1": 3.0,
            "log10_a2": 15.606,
            "m2": 5.0,
            "reference_thickness_m": 0.032,
            "thickness_exponent": 0.25,
        }
    },
    "joint": [
        {
            "at": "leg",
            "curve": "T",
            "chord": {"axial_crown": 2.0, "axial_saddle": 4.0, "in_plane": 2.0, "out_of_plane": 3.0},
        }
    ],
    "girth": [{"part": "tower", "z_m": 12.0, "factor": 1.0, "curve": "T"}],
    "uncertainty": {
        "x_load": {"median": 1.0, "cov": 0.1},
        "x_scf": {"median": 1.0, "cov": 0.1},
        "miner": {"median": 1.0, "cov": 0.3},
        "log10_a_std": 0.2,
    },
}
UPDATED = ("k_j", "k_t", "LJF", "t_l", "t_b", "m_h", "py")


def turbine(updated=UPDATED):
    raw = small_turbine()
    for p in raw["parameter"]:
        p["update"] = p["name"] in updated
    return parse_description(raw, "small")


def model(change=None, updated=UPDATED):
    raw = copy.deepcopy(CONDITIONS)
    if change:
        change(raw)
    return fatigue_model(turbine(updated), "small", Conditions.model_validate(raw))


@pytest.fixture(scope="module")
def whole():
    return model()


def test_thickness_is_in_damage_and_not_in_stress(whole):
    reference = 0.01
    thick = model(lambda raw: raw["curve"]["T"].update(reference_thickness_m=reference))
    welds = [k for k, s in enumerate(thick.spots) if s.side == "weld"]
    wall = thick.details[thick.spots[welds[0]].detail].section.thickness_m
    stresses_of = [m.select(welds).reduce([]).solve(m.parameters.initial) for m in (whole, thick)]
    np.testing.assert_allclose(stresses_of[1].moments, stresses_of[0].moments, rtol=1e-9)
    # DNV-RP-C203, eq. 2.4.3: every range as if it were (t / t_ref)^k times as large
    counted = stresses_of[0].damage_per_year((wall / reference) ** 0.25)
    np.testing.assert_allclose(stresses_of[1].damage_per_year(), counted, rtol=1e-6)
    assert np.all(counted > 2 * stresses_of[0].damage_per_year())


def test_spectra_have_their_variance_and_waves_their_length():
    f = np.geomspace(1e-3, 50, 200_000)
    for gamma in (1.0, 3.3):
        # A_gamma is a fit to two per cent
        assert np.trapezoid(jonswap(f, 3.0, 8.0, gamma), f) == pytest.approx(9 / 16, rel=0.02)
    assert quad(lambda x: float(kaimal(np.array([x]), 10.0, 0.1, 340.2)[0]), 0, np.inf, limit=400)[0] == pytest.approx(
        1, rel=1e-6
    )
    omega = np.array([0.1, 0.5, 2.0, 10.0])
    k = wave_number(omega, 38.0, 9.81)
    np.testing.assert_allclose(9.81 * k * np.tanh(k * 38.0), omega**2, rtol=1e-12)


def test_velocity_under_waves_is_airys(whole):
    one = whole.models[0]
    f = np.array([0.1])
    v = one.waves.normal_velocity(f, 0.0, 20.0, 9.81, 0.0)
    k = wave_number(2 * np.pi * f, 20.0, 9.81)[0]
    upright = np.abs(one.waves.along[:, 2]) > 0.95
    x, z = one.waves.position_m[upright][:, 0], one.waves.position_m[upright][:, 2]
    along = one.waves.along[upright]
    flat = 0.2 * np.pi * np.cosh(k * (z + 20)) / np.sinh(k * 20) * np.exp(-1j * k * x)
    rise = 0.2j * np.pi * np.sinh(k * (z + 20)) / np.sinh(k * 20) * np.exp(-1j * k * x)
    u = np.stack([flat, 0 * flat, rise], axis=1)
    u = u - along * np.sum(along * u, axis=1)[:, None]
    np.testing.assert_allclose(v[upright][:, :, 0], u, rtol=1e-9, atol=1e-12)


def test_slow_thrust_bends_the_tower_as_a_lever(whole, validation):
    # a force at the hub far below the first mode: moment by arm at the tower's foot, wherever the crown lies
    one = whole.models[0]
    slow = stresses.replace(one, frequency_hz=np.array([1e-4, 2e-4]))
    girth = len(one.details) - 1
    z = slow.transfer(one.parameters.initial, {}, wind=True)[girth, :, 0]
    # the weld's own section, not that of its element's middle
    tube = one.details[girth].section
    assert tube.diameter_m == 5.0 and one.details[girth].beam.tube.diameter_m < 5.0
    arm, depth = 50.0 + 2.0 - 12.0, 0.5 * tube.outer({})
    validation(what="stress at the tower's foot under slow thrust", reference="force times arm by hand",
               why="a frequency above zero").error(
        z[1].real / (-1e-6 * arm * depth / tube.second_moment({})) - 1, below=1e-4)
    assert abs(z[2]) < 1e-4 * abs(z[1]) and abs(z[0]) < 1e-6 * abs(z[1])
    # the wind blows along x: the lee side is pressed
    assert z[1].real < 0


def test_slow_waves_load_the_piles_by_their_sum(whole):
    # forces at the points and on the degrees of freedom do the same work in a rigid motion along x
    one = whole.models[0]
    x = np.zeros((len(one.frame.node_m), 6))
    x[:, 0] = 1.0
    inertia, _ = one.point_loads(np.array([0.05]))
    n_tied = {tie.node for tie in one.frame.ties}
    transform = stresses.transformation(one.frame)
    free = sparse_linalg.lsqr(
        transform, np.concatenate([x.ravel(), np.zeros(transform.shape[0] - x.size)]), atol=1e-14, btol=1e-14
    )[0]
    assert (
        n_tied
        and np.abs(transform @ free - np.concatenate([x.ravel(), np.zeros(transform.shape[0] - x.size)])).max() < 1e-6
    )
    assert free @ (one.waves.spread @ inertia)[:, 0] == pytest.approx(inertia.reshape(-1, 3)[:, 0].sum(), rel=1e-6)


def test_modes_and_a_direct_solution_agree(whole, validation):
    checked = validation(what="stress transfer by modes, waves and wind", reference="one linear system a frequency",
                         why="rounding; of each, and 1 % of the largest")
    one = whole.models[1]
    theta = one.parameters.initial * np.array([1.1, 0.9, 1.2, 1.0, 1.05, 1.0, 0.8])
    K, M = (X.toarray() for X in one.model.matrices(theta))
    value, phi = stresses.linalg.eigh(K, M)
    # a pair shares the geometric mean of what its names have
    names = one.modes_at(theta, {"FA1": 0.02}).labels[:2]
    labels = {names[0]: 0.1, names[1]: 0.025}
    ratio = np.full(len(value), 0.02)
    ratio[:2] = 0.05
    C = M @ phi * (2 * ratio * np.sqrt(value)) @ phi.T @ M
    rK, rM = one.coefficients(theta)
    scale = one.stress_scale(theta)[:, None]
    picked = [5, 40, 90, 130, one._wet - 1]
    for wind in (False, True):
        z = one.transfer(theta, labels, case=1, wind=wind).reshape(scale.size, -1)
        case = one.cases[1]
        for j in picked:
            w = 2 * np.pi * one.frequency_hz[j]
            load = one.hub if wind else case.load[:, j]
            A = K - w**2 * M + 1j * w * C + 1j * w * case.damping_nspm * np.outer(one.hub, one.hub)
            q = np.linalg.solve(A, load)
            force = sum(c * R for c, R in zip(rK, one.stiffness_rows, strict=True)) @ q
            force = force - w**2 * (sum(c * R for c, R in zip(rM, one.mass_rows, strict=True)) @ q)
            direct = scale[:, 0] * (force - (0 if wind else case.own[:, j]))
            checked.error((z[:, j] - direct) / (np.abs(direct) + 0.01 * np.abs(direct).max()), below=1e-6)


def test_a_brace_carries_one_force_from_leg_to_crossing():
    # slow thrust loads no brace between its ends
    found = model(
        lambda raw: raw.update(
            joint=[
                {
                    "at": at,
                    "curve": "T",
                    "chord": {"axial_crown": 1.0, "axial_saddle": 1.0, "in_plane": 1.0, "out_of_plane": 1.0},
                }
                for at in ("leg", "crossing")
            ]
        )
    )
    one = stresses.replace(found.models[0], frequency_hz=np.array([1e-4, 2e-4]))
    theta = one.parameters.initial
    force = one.transfer(theta, {}, wind=True)[:, 0, 0] / one.stress_scale(theta)[::3]
    halves = {}
    for k, d in enumerate(one.details):
        if d.at != "girth":
            halves.setdefault((d.part, d.upper if d.at == "leg" else d.end == 0), []).append(force[k])
    assert len(halves) == 16 and all(len(v) == 2 for v in halves.values())
    for a, b in halves.values():
        assert a == pytest.approx(b, rel=1e-5, abs=1e-6 * np.abs(force).max())


def test_derivatives_are_those_of_differences(whole, validation):
    checked = validation(what="d ln DEL / d theta, seven parameters", reference="central differences, of the largest",
                         why="high modes' damping, which the values leave out")
    rng = np.random.default_rng(3)
    thetas = whole.parameters.initial * (1 + 0.05 * rng.standard_normal((3, len(UPDATED))))
    small, theta = whole.reduce(thetas), thetas[0]
    damping = {"FA1": 0.03, "SS1": 0.012}
    exact = [small.solve(theta, damping, derivatives=True).equivalent_change(m) for m in (3.0, 5.0)]
    # where symmetry leaves hardly any stress the differences are those of how high modes are damped
    stressed = small.solve(theta, damping).equivalent_mpa(5.0)
    stressed = stressed > 0.02 * stressed.max()
    for k in range(len(theta)):
        h = 1e-4 * theta[k]
        up, down = (small.solve(theta + s * h * np.eye(len(theta))[k], damping) for s in (1, -1))
        for m, own in zip((3.0, 5.0), exact, strict=True):
            change = (np.log(up.equivalent_mpa(m)) - np.log(down.equivalent_mpa(m))) / (2 * h)
            checked.error(((own[k] - change) / (np.abs(change) + np.abs(change).max()))[stressed], below=1e-3)
    with pytest.raises(ValueError, match="without derivatives"):
        whole.solve(theta).equivalent_change(3.0)


def test_the_basis_answers_what_it_has_not_seen(whole, validation):
    row = validation(what="ranges on the basis", reference="all degrees of freedom, unseen parameters")
    rng = np.random.default_rng(4)
    thetas = whole.parameters.initial * (1 + 0.1 * rng.standard_normal((10, len(UPDATED))))
    small = whole.reduce(thetas[:8])
    assert small.models[0].basis.shape[1] < whole.models[0].model.n_dof
    for theta in thetas[8:]:
        row.error(small.solve(theta).equivalent_mpa(5.0) / whole.solve(theta).equivalent_mpa(5.0) - 1, below=5e-3)


def test_the_basis_about_one_point_has_the_change_of_stress_there(whole, validation):
    """A direction in which all parameters change at once."""
    row = validation(what="d ln DEL on a basis about one point", reference="differences on all degrees of freedom")
    few = whole.select([0, len(whole.spots) // 2, len(whole.spots) - 1])
    theta = whole.parameters.initial * 1.03
    way = 0.1 * theta * np.random.default_rng(5).standard_normal(len(theta))
    up, down = (np.log(few.solve(theta + s * 1e-3 * way).equivalent_mpa(5.0)) for s in (1, -1))
    found = way @ few.reduced_for_derivatives(theta).solve(theta, derivatives=True).equivalent_change(5.0)
    change = (up - down) / 2e-3
    row.error((found - change) / np.abs(change).max(), below=1e-4)


def test_a_slow_modes_resonance_is_resolved(validation):
    """A first mode below 0.2 Hz with 1 and 0.3 % of damping, under thrust: the stress' variance on a line every 1e-3 of
    the frequency."""
    row = validation(what="variance of stress with a first mode at 0.15 Hz, 1 and 0.3 % damping, thrust",
                     reference="trapezoids of 1e-3 of the frequency", why="trapezoids of a resonance; low steps")
    raw = small_turbine()
    for body, mass in zip(raw["rna"], (1.2e6, 7e5), strict=True):
        body["mass_kg"] = mass
    for p in raw["parameter"]:
        p["update"] = p["name"] == "k_t"
        p["initial"] = {"m_h": 7e5, "k_t": 0.5}.get(p["name"], p["initial"])
        p["upper"] = max(p["upper"], 1.2 * p["initial"])
    conditions = copy.deepcopy(CONDITIONS) | {"damping": {"ratio": 0.01}, "direction": [
        {"heading_deg": 0.0, "share": 1.0}], "state": [{**CONDITIONS["state"][0], "share": 1.0, "hs_m": 0.01}]}
    one = fatigue_model(parse_description(raw, "slow"), "slow", Conditions.model_validate(conditions)).models[0]
    theta, girth = one.parameters.initial, 0
    one = one.select([len(one.details) - 1]).reduce([theta])
    assert 0.1 < one.solve(theta, {}).frequency_hz[0] < 0.18
    fine = stresses.replace(one, frequency_hz=np.geomspace(1 / 600, 3.0, int(np.log(1800) / 1e-3)))
    names = one.modes_at(theta, {"FA1": 0.01}).labels
    for damping in ({}, dict.fromkeys(names, 0.003)):
        z = fine.transfer(theta, damping, wind=True)[girth, 1]
        exact = np.trapezoid(np.abs(z) ** 2 * fine.cases[0].thrust, fine.frequency_hz)
        row.error(one.solve(theta, damping).moments[0, 0, girth, 1, 1] / exact - 1, below=0.01)


def test_static_rest_of_high_modes_and_all_modes_agree(whole, validation):
    row = validation(what="ranges with modes above 12 Hz as static shapes, m = 3 and 5",
                     reference="all modes one by one", why="powers of (f / 12 Hz)^2, damping of high modes")
    one = whole.models[0]
    whole = replace(whole, models=(one,), conditions=one.conditions.model_copy(update={"direction": (
        one.conditions.direction[0].model_copy(update={"share": 1.0}),)}))
    theta = whole.parameters.initial * 1.03
    some, every = whole.solve(theta), whole.solve(theta, derivatives=True)
    for m in (3.0, 5.0):
        row.error(some.equivalent_mpa(m) / every.equivalent_mpa(m) - 1, below=1e-3)


def test_counted_cycles_of_a_record_in_time_give_the_spectral_range(whole, validation):
    checked = validation(what="range from the thrust's spectrum, m = 3 and 5",
                         reference="a record integrated in time, counted",
                         why="four hours of a mode at 0.5 Hz with 2 %, Park's fit")
    # thrust alone on the idling turbine, integrated in time mode by mode with exact steps, counted
    one = whole.models[0]
    f = one.frequency_hz
    theta = one.parameters.initial
    m = one.modes_at(theta, {})
    hz = np.sqrt(m.value) / (2 * np.pi)
    keep = hz < 40.0
    rate, seconds = 25.0, 4 * 3600
    n = int(rate * seconds)
    thrust = one.cases[0].thrust
    from gaussian_record import gaussian_record

    force = gaussian_record(f, thrust, rate_hz=rate, n_sample=n, rng=np.random.default_rng(1))
    RK, RM = m.RK.reshape(-1, 3, len(hz)), m.RM.reshape(-1, 3, len(hz))
    spot = int(np.argmax([s.detail == len(one.details) - 1 for s in whole.spots]))
    weight, at = whole.spots[spot].weight, whole.spots[spot].detail
    from scipy.signal import lfilter

    stress = np.zeros(n)
    dt = 1 / rate
    for k in np.flatnonzero(keep):
        w, zeta = 2 * np.pi * hz[k], m.ratio[k]
        # q'' + 2 zeta w q' + w^2 q = p, trapezoidal force (Newmark's average acceleration: periods stretched by (w
        # dt)^2 / 12)
        a0 = 4 / dt**2 + 4 * zeta * w / dt + w**2
        p = force * m.hub[k]
        q = lfilter(
            np.array([1.0, 2.0, 1.0]) / a0,
            np.array([1.0, (2 * w**2 - 8 / dt**2) / a0, (4 / dt**2 - 4 * zeta * w / dt + w**2) / a0]),
            p,
        )
        acceleration = p - 2 * zeta * w * np.gradient(q, dt) - w**2 * q
        stress += (weight @ RK[at, :, k]) * q + (weight @ RM[at, :, k]) * acceleration
    rest = ~keep
    stress += force * np.sum((weight @ RK[at][:, rest]) * m.hub[rest] / m.value[rest])
    cycles, count = rainflow(stress[int(600 * rate) :])
    span = seconds - 600
    only = model(lambda raw: [s.update(hs_m=0.05) for s in raw["state"]])
    spectral = only.models[0].solve(theta, {})
    tensor = spectral.moments[0, :, at]
    from probupdate.lifetime.spectral import park

    own = park(np.einsum("i,kij,j->k", weight, tensor, weight))
    for power in (3, 5):
        counted = (np.sum(count * cycles**power) / span) ** (1 / power)
        # four hours of a mode at 0.5 Hz with 2 %: standard error of the range about 3 %, Park's fit 3 %
        checked.error(float(own.moment(power)) ** (1 / power) / counted - 1, below=0.08)


def test_a_users_spectrum_takes_the_place_of_turbulence(tmp_path):
    text = _toml(CONDITIONS).replace('name = "rated"', 'name = "rated"\nthrust_spectrum = "thrust.csv"')
    (tmp_path / "fatigue.toml").write_text(text)
    with pytest.raises(InputError, match=r"thrust_spectrum.*not a file beside"):
        read_conditions(tmp_path / "fatigue.toml")
    (tmp_path / "thrust.csv").write_text("frequency_hz,n2phz\n0.01,1e3\n0.1,1e3\n0.2,0\n")
    with pytest.raises(InputError, match=r"n2phz.*give N\^2/Hz"):
        fatigue_model(turbine(), "small", tmp_path / "fatigue.toml")
    (tmp_path / "thrust.csv").write_text("frequency_hz,n2phz\n0.01,1e9\n0.1,1e9\n0.2,0\n")
    found = fatigue_model(turbine(), "small", tmp_path / "fatigue.toml")
    one = found.models[0]
    at = np.searchsorted(one.frequency_hz, [0.05, 0.15, 0.5])
    expected = np.interp(one.frequency_hz[at], [0.01, 0.1, 0.2], [1e9, 1e9, 0])
    # means over steps of at most a fortieth, where slopes do not change
    np.testing.assert_allclose(one.cases[1].thrust[at], expected, rtol=1e-3)


@pytest.mark.parametrize("peak_hz", [0.0503, 0.1117, 0.2001])
def test_a_rotors_line_between_two_frequencies_keeps_its_variance(tmp_path, peak_hz):
    """A peak of a thousandth of a hertz, as a rotor of constant speed makes, on slow thrust."""
    (tmp_path / "fatigue.toml").write_text(
        _toml(CONDITIONS).replace('name = "rated"', 'name = "rated"\nthrust_spectrum = "thrust.csv"'))
    rows = [(0.002, 1e11), (0.04, 1e8), (peak_hz - 5e-4, 1e7), (peak_hz, 1e12), (peak_hz + 5e-4, 1e7), (2.0, 0.0)]
    (tmp_path / "thrust.csv").write_text("frequency_hz,n2phz\n" + "".join(f"{f},{s}\n" for f, s in rows))
    one = fatigue_model(turbine(), "small", tmp_path / "fatigue.toml").models[0]
    f, stated = one.frequency_hz, np.array(rows)
    for power in (0, 2):
        fine = np.linspace(f[0], 2.0, 400_000)
        variance = np.trapezoid(fine**power * np.interp(fine, *stated.T, left=0), fine)
        np.testing.assert_allclose(np.trapezoid(f**power * one.cases[1].thrust, f), variance, rtol=2e-3)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("share = 0.7", "share = 0.6", "direction.share: they add up to 0.9"),
        ('curve = "T"', 'curve = "F"', "is not a .curve. of the file"),
        ("drag_coefficient", "drag", "water.drag: is not a key of this file"),
        ("drag_coefficient = 0.8", "", "drag_coefficient: is missing"),
        ("m2 = 5.0", "m2 = 2.0", "swap the slopes"),
        ('at = "leg"', 'at = "leg"\nbay = [7]', "chooses no brace end"),
        ("z_m = 12.0", "z_m = 14.5", "choose the level of an element's end"),
        ('part = "tower"', 'part = "towr"', "did you mean 'tower'"),
        ("hs_m = 4.0", 'hs_m = "four"', "hs_m"),
    ],
)
def test_mistakes_name_file_and_key(tmp_path, old, new, words):
    text = _toml(CONDITIONS)
    assert old in text
    (tmp_path / "fatigue.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words) as error:
        fatigue_model(turbine(), "small", tmp_path / "fatigue.toml")
    assert "fatigue.toml" in str(error.value)


def _toml(raw) -> str:
    """The dictionary as TOML: tables, lists of tables, tables in lines."""

    def value(v):
        if isinstance(v, dict):
            return "{ " + ", ".join(f"{k} = {value(x)}" for k, x in v.items()) + " }"
        return str(v).lower() if isinstance(v, bool) else f'"{v}"' if isinstance(v, str) else repr(v)

    lines = [f"{k} = {value(v)}" for k, v in raw.items() if not isinstance(v, dict | list)]
    for key, v in raw.items():
        if isinstance(v, list):
            for item in v:
                lines += [f"[[{key}]]", *(f"{k} = {value(x)}" for k, x in item.items())]
        elif isinstance(v, dict):
            nested = {k: x for k, x in v.items() if isinstance(x, dict)} if key == "curve" else {}
            for name, table in nested.items():
                lines += [f"[{key}.{name}]", *(f"{k} = {value(x)}" for k, x in table.items())]
            if not nested:
                lines += [f"[{key}]", *(f"{k} = {value(x)}" for k, x in v.items())]
    return "\n".join(lines) + "\n"


def test_sparse_and_dense_rows_are_one(whole):
    one = whole.models[0]
    few = whole.select([3, 11, len(whole.spots) - 1])
    np.testing.assert_allclose(
        few.solve(one.parameters.initial).equivalent_mpa(3.0),
        whole.solve(one.parameters.initial).equivalent_mpa(3.0)[[3, 11, -1]],
        rtol=1e-10,
    )
    assert sparse.issparse(few.models[0].stiffness_rows[0])
