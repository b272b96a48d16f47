"""Stresses at a monopile's welds against statics by hand: the template's turbine, whose pile and tower taper."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp

import probupdate
from probupdate.lifetime.conditions import Conditions
from probupdate.lifetime.fatigue import fatigue_model
from probupdate.structure.assembly import transformation
from probupdate.structure.description_file import read_description
from tests.lifetime.test_stress import CONDITIONS

HUB_M, SLOW_HZ = 144.0 + 5.6, 1e-4
# level, diameter and wall of the template's stations
WELDS = {("monopile", -30.0): (10.0, 0.060), ("monopile", -5.0): (9.6, 0.058), ("tower", 58.0): (9.0, 0.036)}


def section_modulus(diameter, wall):
    return np.pi / 32 * (diameter**4 - (diameter - 2 * wall) ** 4) / diameter


@pytest.fixture(scope="module")
def described(tmp_path_factory):
    folder = tmp_path_factory.mktemp("monopile") / "own"
    probupdate.template("monopile", folder)
    return read_description(folder / "model.toml")


def welded(description, *, softened, factor=1.0, **mesh):
    """The template with welds at its stations, at a frequency at which all follows statically."""
    raw = copy.deepcopy(CONDITIONS) | {"direction": [{"heading_deg": 0.0, "share": 1.0}]}
    del raw["joint"]
    raw["girth"] = [{"part": part, "z_m": z, "factor": factor, "curve": "T"} for part, z in WELDS]
    own = description.mesh.model_copy(update={"geometric_stiffness": softened} | mesh)
    return fatigue_model(description.model_copy(update={"mesh": own}), "monopile", Conditions.model_validate(raw))


def bending(whole):
    """(n_weld,) MPa of 1 N at the hub."""
    one = replace(whole.models[0], frequency_hz=np.array([SLOW_HZ, 1.0]))
    return np.linalg.norm(one.transfer(one.parameters.initial, {}, 0, wind=True)[:, 1:, 0], axis=1)


@pytest.mark.parametrize("elements", [1, 6])
def test_slow_thrust_bends_a_tapered_pile_as_a_lever(described, elements, validation):
    """Elements have the section of their middle: with it the mudline's stress was 1 to 5 % too high."""
    whole = welded(described, softened=False,
                   elements_per_member=described.mesh.elements_per_member | {"pile": elements, "tower": elements})
    expected = [1e-6 * (HUB_M - z) / section_modulus(*size) for (_, z), size in WELDS.items()]
    validation(what="stress at a monopile's mudline, at its next station and in the tower under slow thrust",
               reference="force times arm by hand, over the weld's own section modulus",
               why="a frequency above zero").error(bending(whole) / expected - 1, below=1e-5)


def test_below_the_mudline_steel_bends_as_a_beam_in_its_soil(described, validation):
    """Most under slow thrust some metres down: soil at the end of an element is in the element's end forces."""
    levels = [-34.5, -39.0, -48.0, -57.0, -66.0]
    raw = copy.deepcopy(CONDITIONS) | {"direction": [{"heading_deg": 0.0, "share": 1.0}]}
    del raw["joint"]
    raw["girth"] = [{"part": "monopile", "z_m": z, "factor": 1.0, "curve": "T"} for z in levels]
    mesh = described.mesh.model_copy(update={"geometric_stiffness": False, "theory": "bernoulli-euler",
                                             "elements_per_member": described.mesh.elements_per_member | {"pile": 30}})
    own = described.model_copy(update={"mesh": mesh})
    found = bending(fatigue_model(own, "monopile", Conditions.model_validate(raw)))
    soil, depth_m, diameter = described.soil, 45.0, 10.0

    def wall(depth):
        return 0.060 - 0.005 * depth / depth_m

    def per_metre(depth):
        strength = soil.undrained_shear_strength_pa
        strength = strength.at_mudline + strength.gradient_per_m * depth
        wedge = 3 * strength + soil.submerged_unit_weight_npm3 * depth + soil.matlock_j * strength * depth / diameter
        # the first point of API's p-y curve, 0.23 p_u at 0.1 y_c
        return 2.3 * diameter * np.minimum(wedge, 9 * strength) / (2.5 * soil.strain_50 * diameter)

    def rigidity(depth):
        return described.steel.youngs_modulus_pa * 0.5 * diameter * section_modulus(diameter, wall(depth))

    def bent(x, y):
        """Deflection, slope, moment and shear force over the pile's length, of a moment of one at the mudline."""
        depth, head = depth_m * x, rigidity(0.0)
        return np.array([y[1], y[2] * head / rigidity(depth), y[3], -per_metre(depth) * depth_m**4 / head * y[0]])

    arm, x = HUB_M + 30, np.linspace(0, 1, 200)
    own = solve_bvp(bent, lambda top, tip: np.array([top[2] - 1, top[3] - depth_m / arm, tip[2], tip[3]]), x,
                    np.zeros((4, len(x))), tol=1e-8)
    assert own.success
    depth = -30.0 - np.array(levels)
    expected = 1e-6 * arm * np.abs(own.sol(depth / depth_m)[2]) / section_modulus(diameter, wall(depth))
    validation(what="stress in a monopile 4 to 36 m below the mudline under slow thrust",
               reference="own beam in API's clay as a boundary value problem (scipy)",
               why="walls of elements are those of their middle").error(found / expected - 1, below=5e-3)


def test_the_weight_adds_its_moment_where_it_softens(described, validation):
    """geometric_stiffness: the leaning turbine's weight bends the pile too, 6 to 8 % on top of force times arm."""
    whole, plain = (welded(described, softened=softened) for softened in (True, False))
    model = whole.models[0]
    moved = transformation(model.frame) @ np.linalg.solve(
        model.model.matrices(model.parameters.initial)[0].toarray(), model.hub)
    on_axis = np.flatnonzero(np.hypot(*model.frame.node_m[:, :2].T) < 1e-6)
    on_axis = on_axis[np.argsort(model.frame.node_m[on_axis, 2], kind="stable")]
    at = model.frame.node_m[on_axis, 2]

    def deflection(z):
        return np.interp(z, at, moved[6 * on_axis])

    # steel between stations, flanges, platform; rotor and nacelle above the tower's top, which turns
    edge = np.linspace(-30, 144, 4000)
    z, length = 0.5 * (edge[1:] + edge[:-1]), np.diff(edge)
    size = [np.where(z > 15, *(np.interp(z, [s.z_m for s in st], [getattr(s, name) for s in st])
                               for st in (described.tower.station, described.monopile.station)))
            for name in ("diameter_m", "thickness_m")]
    mass = 7850 * np.pi * (size[0] - size[1]) * size[1] * length + 300 * (z > 15) * length
    lumped = [(10, 20e3), (14, 80e3), *((s.z_m, s.flange_kg) for s in described.tower.station)]
    z, mass = np.append(z, [a for a, _ in lumped]), np.append(mass, [m for _, m in lumped])
    turn = moved[6 * on_axis[-1] + 4]
    moment = []
    for _, level in WELDS:
        above = z > level
        of_rotor = sum(b.mass_kg * (deflection(144) + turn * b.offset_m[2] - deflection(level)) for b in described.rna)
        moment.append(9.81 * (mass[above] @ (deflection(z[above]) - deflection(level)) + of_rotor))
    expected = 1 + np.array(moment) / (HUB_M - np.array([z for _, z in WELDS]))
    validation(what="the same where the turbine's weight softens it", reference="force times arm and weight times "
               "deflection by hand", why="buoyancy, growth and water in the pile, curved elements").error(
        bending(whole) / bending(plain) / expected - 1, below=0.005)


def test_stress_and_thickness_are_the_welds_own(described):
    whole, twice = (welded(described, softened=False, factor=f) for f in (1.0, 2.0))
    at = np.array([s.detail for s in whole.spots])[::8]
    law = whole.conditions.curve["T"]
    for k, (_, wall) in zip(at, WELDS.values(), strict=True):
        effect = max(1.0, wall / law.reference_thickness_m) ** law.thickness_exponent
        assert whole.spots[8 * k].thickness_effect == pytest.approx(effect, rel=1e-12)
    theta = whole.parameters.initial
    ranges = [m.reduce([]).solve(theta).equivalent_mpa(3.0) for m in (whole, twice)]
    np.testing.assert_allclose(ranges[1], 2 * ranges[0], rtol=1e-9)


def test_the_thinner_wall_is_stressed_at_a_step(described):
    """Two stations at one level: of the plates that meet there the thinner one, whichever is above."""
    def stepped(part, z, thickness):
        table = getattr(described, part)
        at = [s.z_m for s in table.station].index(z)
        own = table.station[at]
        other = own.model_copy(update={"thickness_m": thickness} | ({"flange_kg": 0.0} if part == "tower" else {}))
        return {part: table.model_copy(update={"station": (*table.station[: at + 1], other, *table.station[at + 1 :])})}

    thinner = {("monopile", -5.0): 0.050, ("tower", 58.0): 0.030}
    own = described.model_copy(update=stepped("monopile", -5.0, 0.050) | stepped("tower", 58.0, 0.030))
    turned = described.model_copy(update=stepped("monopile", -5.0, 0.070) | stepped("tower", 58.0, 0.045))
    for model, walls in ((own, thinner), (turned, {})):
        expected = [1e-6 * (HUB_M - z) / section_modulus(size[0], walls.get((part, z), size[1]))
                    for (part, z), size in WELDS.items()]
        assert bending(welded(model, softened=False)) == pytest.approx(expected, rel=1e-5)
