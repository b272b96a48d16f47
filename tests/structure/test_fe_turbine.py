"""The turbine's matrices as a whole: sums, scaling, masses, symmetry, channels, fingerprint, parameters."""

import copy

import numpy as np
import pytest
from scipy import linalg
from small_turbine import small_turbine

from probupdate.runtime.executors import iterate_completed
from probupdate.structure.assembly import assemble
from probupdate.structure.beam import Tube
from probupdate.structure.channels import attach
from probupdate.structure.description import NEUTRAL
from probupdate.structure.description_file import parse_description
from probupdate.structure.jacket_frame import leg_point
from probupdate.structure.load import turbine_model
from probupdate.structure.turbine_frame import build_frame

STIFFNESS_NAMES = ("k_j", "k_t", "k_TP", "k_p")
SOIL_NAMES = ("py", "tz", "qw")


def model(raw):
    return turbine_model(parse_description(raw, "model.toml"), where="model.toml")


@pytest.fixture(scope="module")
def small():
    return model(small_turbine())


def test_all_seventeen_parameters_act(small):
    assert set(small.parameters.names) == set(NEUTRAL)
    slope = small.solve(small.parameters.initial, 10, derivatives=True).frequency_derivative
    relative = np.abs(slope * small.parameters.std) / small.solve(small.parameters.initial, 10).frequency_hz[:, None]
    assert np.all(relative.max(axis=0) > 1e-6)


def test_stiffness_sum_rule(small, validation):
    """Joint stiffness goes with k_j, so K is homogeneous of degree one in k_j, k_t, k_TP, k_p, 1/py, 1/tz, 1/qw."""
    row = validation(what="all stiffnesses together double", reference="sum rule",
                     why="rounding")
    solution = small.solve(small.parameters.initial, 10, derivatives=True)
    logarithmic = solution.frequency_derivative * small.parameters.initial / solution.frequency_hz[:, None]
    names = small.parameters.names
    total = sum(logarithmic[:, names.index(name)] for name in STIFFNESS_NAMES)
    total = total - sum(logarithmic[:, names.index(name)] for name in SOIL_NAMES)
    row.error(total - 0.5, below=1e-9)


def scaled(raw, paths, factor):
    raw = copy.deepcopy(raw)
    for path in paths:
        table = raw
        *steps, last = path.split(".")
        for step in steps:
            table = table[int(step)] if step.isdigit() else table[step]
        value = table[last]
        table[last] = [factor * v for v in value] if isinstance(value, list) else factor * value
    return raw


MASSES = (
    "steel.density_kgpm3", "site.water_density_kgpm3", "hydrodynamics.growth_density_kgpm3",
    "tower.secondary_steel_kgpm", "tower.station.0.flange_kg", "tower.station.1.flange_kg",
    "transition_piece.lumped_mass_kg", "rna.0.mass_kg", "rna.1.mass_kg", "rna.0.inertia_kgm2", "rna.1.inertia_kgm2",
)
FORCES = ("steel.youngs_modulus_pa", "soil.submerged_unit_weight_npm3",
          "soil.undrained_shear_strength_pa.at_mudline", "soil.undrained_shear_strength_pa.gradient_per_m")


def of_motion(found):
    """The model at sensors that do not feel gravity."""
    return found.with_gravity(dict.fromkeys(found.channels, False))


def test_mass_sum_rule(raw, small, validation):
    """All densities, masses and inertias doubled: every frequency falls by the root of two, shapes likewise."""
    row = validation(what="all masses together double", reference="sum rule", why="rounding")
    heavy = scaled(raw, MASSES, 2.0)
    entry = next(p for p in heavy["parameter"] if p["name"] == "m_h")
    entry |= {"initial": 120000.0, "upper": 160000.0}
    heavy_model = model(heavy)
    light, doubled = (of_motion(m).solve(m.parameters.initial, 8) for m in (small, heavy_model))
    row.error(doubled.frequency_hz * np.sqrt(2) / light.frequency_hz - 1, below=1e-9)
    assert np.abs(doubled.shape) * np.sqrt(2) == pytest.approx(np.abs(light.shape), rel=1e-6, abs=1e-9)


def test_all_moduli_and_strengths_scale_the_frequencies(raw, small):
    stiff = model(scaled(raw, FORCES, 2.25))
    frequency = stiff.solve(stiff.parameters.initial, 8).frequency_hz
    assert frequency == pytest.approx(1.5 * small.solve(small.parameters.initial, 8).frequency_hz, rel=1e-9)


def test_matrices_are_symmetric_and_positive_definite(small):
    for scale in (0.0, 0.4):
        theta = small.parameters.initial + scale * small.parameters.std
        for matrix in small.matrices(theta):
            dense = matrix.toarray()
            assert np.array_equal(dense, dense.T)
            d = 1 / np.sqrt(np.diag(dense))
            assert linalg.eigvalsh(dense * np.outer(d, d))[0] > 0


def test_translation_of_the_whole_feels_the_mass_by_hand(raw, validation):
    """u^T M u of a rigid motion of all nodes along x and z, against tubes, water, growth and lumps summed by hand."""
    row = validation(what="mass of the whole turbine moved rigidly", reference="sum by hand", why="rounding")
    description = parse_description(raw, "model.toml")
    frame = build_frame(description)
    values = description.values
    assembled = assemble(frame, updated=(), values=values)
    M = assembled.mass[0].toarray()
    across, up = _mass_by_hand(frame, description, values)
    for direction, exact in ((0, across), (2, up)):
        rigid = np.zeros((len(frame.node_m), 6))
        rigid[:, direction] = 1.0
        # every joint at rest; free degrees of freedom come first, then the released motions
        q = np.linalg.lstsq(assembled.transform.toarray(), rigid.ravel(), rcond=None)[0]
        assert assembled.transform @ q == pytest.approx(rigid.ravel(), abs=1e-9)
        row.error(q @ M @ q / exact - 1, below=1e-9)


def _mass_by_hand(frame, d, values):
    across = up = 0.0
    for b in frame.beams:
        span = frame.node_m[b.end] - frame.node_m[b.start]
        length, direction = np.linalg.norm(span), span / np.linalg.norm(span)
        z = 0.5 * (frame.node_m[b.end] + frame.node_m[b.start])[2]
        low, high = sorted((frame.node_m[b.start][2], frame.node_m[b.end][2]))
        diameter, wall = b.tube.outer(values), b.tube.wall(values)
        steel = 7850.0 * np.pi * wall * (diameter - wall) * length
        carried = added = 0.0
        if b.group == "tower":
            carried = 100.0 * length
        if b.group in ("leg", "brace", "pile") and z < 0:
            # scour of 0.7 m bares the pile: growth and added mass act above the seabed
            wet = 1.0 if b.group != "pile" else np.clip((high - (-20.0 - values["sc"])) / (high - low), 0, 1)
            growth = values["mg"] if z < -2.0 else 0.0
            carried += wet * 1300.0 * np.pi * growth * (diameter + growth) * length
            added = wet * values["a_m"] * 1025.0 * np.pi / 4 * (diameter + 2 * growth) ** 2 * length
            if b.group in ("leg", "pile"):
                carried += 1025.0 * np.pi / 4 * (diameter - 2 * wall) ** 2 * length
        across += steel + carried + added * (1 - direction[0] ** 2)
        up += steel + carried + added * (1 - direction[2] ** 2)
    lumps = 20000.0 + 9000.0 + 90000.0 + values["m_h"]
    return across + lumps, up + lumps


def test_legs_stand_on_the_corners_and_braces_cross_in_the_faces(raw):
    description = parse_description(raw, "model.toml")
    frame = build_frame(description)
    corner = leg_point(description, 0, 8.0)
    assert corner == pytest.approx([2.5, 2.5, 8.0])
    assert leg_point(description, 1, -19.0) == pytest.approx([-5.0, 5.0, -19.0])
    found = attach(frame, np.array([2.5, 2.5, 8.0]), "leg A")
    assert found.gap_m == 0.0
    for part in ("brace AB-1", "brace BA-1", "pile D", "strut C", "tie B", "column", "tower"):
        assert part in frame.parts
    centre = {tuple(np.round(frame.node_m[n], 6)) for b in frame.beams if b.part == "brace AB-1"
              for n in (b.start, b.end)} & {tuple(np.round(frame.node_m[n], 6)) for b in frame.beams
                                             if b.part == "brace BA-1" for n in (b.start, b.end)}
    ((x, y, _),) = centre
    assert x == pytest.approx(0.0, abs=1e-9) and y > 0


def test_four_equal_legs_give_pairs_without_the_eccentric_rotor(raw):
    for body in raw["rna"]:
        body |= {"offset_m": [0.0, 0.0, body["offset_m"][2]], "inertia_kgm2": [1e6, 1e6, 1e6]}
    symmetric = model(raw)
    frequency = symmetric.solve(symmetric.parameters.initial, 4).frequency_hz
    assert frequency[1] / frequency[0] - 1 < 1e-9


def test_three_legs_too(raw):
    raw["jacket"]["leg_names"] = ["A", "B", "C"]
    raw["sensor"] = [s for s in raw["sensor"] if s["part"] == "tower"]
    for body in raw["rna"]:
        body |= {"offset_m": [0.0, 0.0, body["offset_m"][2]], "inertia_kgm2": [1e6, 1e6, 1e6]}
    tripod = model(raw)
    frequency = tripod.solve(tripod.parameters.initial, 2).frequency_hz
    assert frequency[1] / frequency[0] - 1 < 1e-9


def test_timoshenko_and_rigid_joints_move_the_frequencies_the_right_way(raw, small):
    base = small.solve(small.parameters.initial, 6).frequency_hz
    raw["mesh"]["theory"] = "timoshenko"
    soft = model(raw)
    assert np.all(soft.solve(soft.parameters.initial, 6).frequency_hz < base)
    raw["mesh"]["theory"] = "bernoulli-euler"
    raw["jacket"]["joints"]["law"] = "rigid"
    for entry in raw["parameter"]:
        entry["update"] = entry["name"] != "LJF"
    stiff = model(raw)
    assert np.all(stiff.solve(stiff.parameters.initial, 6).frequency_hz > base * (1 - 1e-12))


def test_joints_tend_to_rigid_ones(raw, small):
    raw["jacket"]["joints"]["law"] = "rigid"
    for entry in raw["parameter"]:
        entry["update"] = entry["name"] != "LJF"
    rigid = model(raw)
    limit = rigid.solve(rigid.parameters.initial, 6).frequency_hz
    theta = small.parameters.initial.copy()
    gaps = []
    for factor in (1e2, 1e4):
        theta[small.parameters.index("LJF")] = factor
        gaps.append(np.abs(small.solve(theta, 6).frequency_hz / limit - 1).max())
    # the gap falls with one over the stiffness
    assert gaps[1] < 2e-5
    assert gaps[0] / gaps[1] == pytest.approx(100, rel=0.1)


def test_gravity_softens_the_tower(raw, small):
    raw["mesh"]["geometric_stiffness"] = True
    sunk = model(raw)
    theta = small.parameters.initial
    ratio = sunk.solve(theta, 2).frequency_hz / small.solve(theta, 2).frequency_hz
    assert np.all((ratio < 0.9995) & (ratio > 0.97))


def test_parameters_do_in_the_file_what_they_do_as_updated(raw, small):
    """Diameter and wall doubled by factor or by hand: one model either way."""
    theta = small.parameters.initial.copy()
    for name, value in {"D_l": 1.1, "t_b": 0.9, "k_t": 1.3}.items():
        theta[small.parameters.index(name)] = value
    by_factor = small.solve(theta, 6).frequency_hz
    raw["jacket"]["leg"]["diameter_m"] *= 1.1
    raw["jacket"]["bay"][0]["brace"]["thickness_m"] *= 0.9
    for entry in raw["parameter"]:
        if entry["name"] == "k_t":
            entry |= {"initial": 1.3, "update": False}
    by_hand = model(raw)
    assert by_hand.solve(by_hand.parameters.initial, 6).frequency_hz == pytest.approx(by_factor, rel=1e-10)


def test_terms_that_nothing_touches_are_merged(raw, small):
    for entry in raw["parameter"]:
        entry["update"] = entry["name"] in ("k_t", "py")
    few = model(raw)
    assert len(few.stiffness) == 3 and len(few.mass) == 1
    assert few.solve(few.parameters.initial, 6).frequency_hz == pytest.approx(
        small.solve(small.parameters.initial, 6).frequency_hz, rel=1e-10)


def test_coefficients_come_alike_one_by_one_and_many_at_once(small):
    rng = np.random.default_rng(0)
    theta = small.parameters.initial + 0.3 * small.parameters.std * rng.standard_normal((2, 3, 17))
    many = small.coefficients(theta)
    for i in range(2):
        for j in range(3):
            for whole, single in zip(many, small.coefficients(theta[i, j]), strict=True):
                # powers of many numbers at once are computed by other instructions than of one, to the last digits
                np.testing.assert_allclose(whole[i, j], single, rtol=1e-14, atol=0)


def test_coefficient_derivatives_are_those_of_differences(small):
    theta, h = small.parameters.initial, 1e-6
    steps = small.coefficient_derivatives(theta)
    for k, std in enumerate(small.parameters.std):
        moved = np.zeros(17)
        moved[k] = h * std
        plus, minus = small.coefficients(theta + moved), small.coefficients(theta - moved)
        for exact, up, down in zip(steps, plus, minus, strict=True):
            difference = (up - down) / (2 * h * std)
            scale = np.abs(up).max(initial=1e-300, where=np.abs(difference) > 0)
            assert exact[:, k] == pytest.approx(difference, rel=1e-6, abs=1e-9 * scale / std)


def test_channels_read_the_motion_of_the_nearest_point(raw):
    """A sensor off the axis sees rotation times arm; one inside an element the shape between its nodes."""
    description = parse_description(raw, "model.toml")
    found = of_motion(model(raw))
    theta = found.parameters.initial
    _, phi = found.solve_full(theta, 3)
    node = found.wire_matrix @ phi
    position = found.wire.node_m
    top = int(np.flatnonzero(np.all(np.abs(position - [0, 0, 50.0]) < 1e-9, axis=1))[0])
    assert found.solve(theta, 3).shape[7:9] == pytest.approx(node[3 * top : 3 * top + 2], rel=1e-9)
    raw["sensor"][7]["position_m"] = [0.0, 1.7, 50.0]
    off = of_motion(model(raw)).solve(theta, 3).shape[7]
    raw["sensor"][7]["position_m"] = [0.0, -1.7, 50.0]
    other = of_motion(model(raw)).solve(theta, 3).shape[7]
    assert 0.5 * (off + other) == pytest.approx(node[3 * top], rel=1e-8, abs=1e-12)
    assert description.sensor[7].position_m[2] == 50.0


@pytest.mark.parametrize(
    "path",
    ["steel.density_kgpm3", "jacket.leg.thickness_m", "pile.tip_m", "soil.matlock_j", "rna.1.mass_kg",
     "hydrodynamics.growth_density_kgpm3", "corrosion.top_m", "sensor.0.direction", "tower.station.1.diameter_m"],
)
def test_fingerprint_changes_with_any_input(raw, small, path):
    base = model(raw).fingerprint()
    assert base == small.fingerprint()
    assert model(scaled(raw, [path], 1.0001)).fingerprint() != base


def test_fingerprint_changes_with_priors_names_and_layout(raw, small):
    base, seen = small.fingerprint(), set()
    for change in (
        lambda r: r["parameter"][0].update(std=0.2), lambda r: r["parameter"][0].update(upper=2.5),
        lambda r: r["parameter"][0].update(update=False), lambda r: r["sensor"].reverse(),
        lambda r: r.update(correlation={"k_j": {"k_t": 0.3}}), lambda r: r["mesh"].update(theory="timoshenko"),
        lambda r: r["mesh"]["elements_per_member"].update(pile=7), lambda r: r["jacket"]["joints"].update(law="rigid"),
    ):
        other = copy.deepcopy(raw)
        change(other)
        if other["jacket"]["joints"]["law"] == "rigid":
            other["parameter"][4]["update"] = False
        seen.add(model(other).fingerprint())
    assert len(seen) == 8 and base not in seen


def test_same_file_same_numbers_and_pools_may_take_the_model(raw, small):
    # there and back again, as pools take it
    again, _ = iterate_completed(copy.copy, [(model(raw),)] * 2, jobs=2, least=1)
    theta = small.parameters.initial
    assert np.array_equal(again.solve(theta, 6).frequency_hz, small.solve(theta, 6).frequency_hz)
    assert np.array_equal(again.solve(theta, 6).shape, small.solve(theta, 6).shape)
    assert again.fingerprint() == small.fingerprint()
    assert again.derived["k_z"](theta) == small.derived["k_z"](theta)


def test_wireframe_has_every_member_by_group(small):
    wire = small.wireframe(small.parameters.initial, 4)
    assert set(wire.line_group) == {"leg", "brace", "pile", "column", "strut", "tie", "tower", "rna"}
    assert len(wire.line) == len(wire.line_group)
    assert wire.displacement.shape == (len(wire.node_m), 3, 4)
    # the first two modes sway the tower's top most
    for mode in (0, 1):
        assert wire.node_m[np.argmax(np.linalg.norm(wire.displacement[:, :, mode], axis=1)), 2] >= 50.0


def test_a_tube_without_parameters_ignores_their_values():
    tube = Tube(diameter_m=1.0, thickness_m=0.02)
    assert tube.area({"D_l": 2.0}) == tube.area({})
