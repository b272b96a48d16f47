"""Effects by a second route: the rows of Table 2, edited files, removed members, explicit springs, sums by hand."""

import copy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from effects_turbine import entry, model, plain, with_effects
from scipy import linalg, sparse
from small_turbine import small_turbine

from probupdate.structure import beam as beam_elements
from probupdate.structure.assembly import assemble, axial_forces
from probupdate.structure.coefficient import Coefficient
from probupdate.structure.description_file import parse_description
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.frame import Beam, Body, Frame, Hinge, NodeSpring, Prestress, Support
from probupdate.structure.turbine_frame import build_frame

N_MODE = 8
LEGS = ("A", "B", "C", "D")


def frequencies(turbine, *theta):
    values = np.array(theta) if theta else turbine.parameters.initial
    return turbine.solve(values, N_MODE).frequency_hz


@cache
def bare():
    """Frequencies without effects."""
    return frequencies(plain())


def each_leg(kind, settings=None, on=None, bounds=(0.0, 9.0)):
    return [entry(f"{kind}_{leg}", kind, {"leg": leg} | (on or {}), settings, bounds) for leg in LEGS]


@pytest.mark.parametrize(
    ("entries", "value", "row"),
    [
        ([entry("e", "scour", bounds=(0.0, 4.0))], 1.0, {"sc": 1.7}),
        (each_leg("scour", bounds=(0.0, 4.0)), 1.0, {"sc": 1.7}),
        (each_leg("soil", {"curve": "py"}, bounds=(0.1, 9.0)), 4.0, {"py": 0.25}),
        (each_leg("soil", {"curve": "tz"}, bounds=(0.1, 9.0)), 2.0, {"tz": 0.5}),
        (each_leg("soil", {"curve": "qw"}, bounds=(0.1, 9.0)), 0.5, {"qw": 2.0}),
        ([entry("e", "soil", None, {"curve": "all"}, (0.1, 9.0))], 4.0, {"py": 0.25, "tz": 0.25, "qw": 0.25}),
        ([entry("e", "growth", bounds=(0.0, 0.3))], 0.05, {"mg": 0.11}),
        ([entry(g, "growth", {"group": g}, bounds=(0.0, 0.3)) for g in ("leg", "brace", "pile")], 0.05, {"mg": 0.11}),
        ([entry("e", "added_mass", bounds=(0.0, 3.0))], 1.5, {"a_m": 1.5}),
        ([entry("e", "joint", bounds=(0.0, 3.0))], 0.2, {"LJF": 0.2}),
        (each_leg("joint"), 0.2, {"LJF": 0.2}),
        ([entry(m, "joint", None, {"motion": m}, (0.0, 3.0)) for m in ("axial", "in plane", "out of plane")], 0.2,
         {"LJF": 0.2}),
        ([entry(f, "joint", {"face": f}, bounds=(0.0, 3.0)) for f in ("AB", "BC", "CD", "AD")], 0.2, {"LJF": 0.2}),
        ([entry("e", "stiffness", {"group": "tower"}, bounds=(0.1, 2.0))], 0.7, {"k_t": 0.7}),
        ([entry(g, "stiffness", {"group": g}, bounds=(0.1, 2.0)) for g in ("column", "strut", "tie")], 0.7,
         {"k_TP": 0.7}),
        ([entry(m, "stiffness", {"group": "pile"}, {"motion": m}, (0.1, 2.0)) for m in ("axial", "bending")], 0.7,
         {"k_p": 0.7}),
        ([entry(g, "stiffness", {"group": g}, bounds=(0.1, 2.0)) for g in ("leg", "brace")]
         + [entry("joints", "joint", bounds=(0.1, 2.0))], 0.7, {"k_j": 0.7}),
        ([entry("e", "temperature", {"group": g}, {"relative_per_degc": -1e-2}, (-90.0, 90.0)) | {"name": g}
          for g in ("leg", "brace")], 30.0, {"k_j": 0.7}),
        ([entry("e", "mass", {"body": "hub"}, bounds=(0.0, 2e4))], 5000.0, {"m_h": 65000.0}),
        ([entry("e", "corrosion", {"level_m": [-3.0, 4.0]} | g, bounds=(0.0, 0.01)) | {"name": g["group"]}
          for g in ({"group": "leg"}, {"group": "brace"})], 0.001, {"corr": 0.003}),
    ],
)
def test_effects_everywhere_are_the_rows_of_table_2(entries, value, row, validation):
    checked = validation(what="effects on all legs, faces, groups, motions", reference="the row of Table 2",
                         why="eigensolver")
    turbine = model(with_effects(entries))
    assert turbine.parameters.names == tuple(e["name"] for e in entries)
    expected = frequencies(plain(**row))
    checked.error(frequencies(turbine, *[value] * len(entries)) / expected - 1, below=1e-9)
    # and the value matters: a route that does nothing would agree with another that does nothing
    assert np.abs(bare() / expected - 1).max() > 1e-4


@pytest.mark.parametrize(
    ("entries", "value", "change"),
    [
        ([entry("e", "flooding", {"group": "leg"}, bounds=(-1.0, 0.0))], -1.0,
         lambda raw: raw["jacket"].update(flooded=False)),
        ([entry("e", "mass", {"body": "nacelle"}, bounds=(0.0, 1e5))], 7e3,
         lambda raw: raw["rna"][0].update(mass_kg=97e3)),
        ([entry("e", "mass", {"group": "tower"}, bounds=(0.0, 1e5))], 38e2,
         lambda raw: raw["tower"].update(secondary_steel_kgpm=200.0)),
        ([entry("e", "mass", {"body": "hub"}, {"inertia_per_kg_m2": [1.0, 100.0, 100.0]}, (0.0, 1e5))], 5e3,
         lambda raw: (raw["rna"][1].update(inertia_kgm2=[5.5e4, 6.5e6, 6.5e6]), _row(raw, "m_h", 65e3))),
        ([entry("e", "inertia", {"body": "hub"}, {"axis": "z"}, (-1e6, 1e7))], 3e6,
         lambda raw: raw["rna"][1].update(inertia_kgm2=[5e4, 6e6, 9e6])),
        ([entry("e", "centre_of_mass", {"body": "hub"}, {"axis": "x"}, (-2.0, 2.0))], -0.8,
         lambda raw: raw["rna"][1].update(offset_m=[-4.8, 0.0, 2.0])),
        ([entry(a, "centre_of_mass", None, {"axis": a}, (-2.0, 2.0)) for a in "xyz"], 0.6,
         lambda raw: (raw["rna"][0].update(offset_m=[2.1, 0.6, 2.1]), raw["rna"][1].update(offset_m=[-3.4, 0.6, 2.6]))),
        ([entry("e", "weight", None, None, (0.0, 2.0))], 1.0,
         lambda raw: raw["mesh"].update(geometric_stiffness=True)),
        ([entry("e", "temperature", None, {"relative_per_degc": -1e-2}, (-90.0, 90.0))], 20.0,
         lambda raw: raw["steel"].update(youngs_modulus_pa=0.8 * 2.1e11)),
    ],
)
def test_effects_are_what_a_hand_would_edit(entries, value, change, validation):
    """With the nacelle turned, so that its axes are not the structure's."""
    checked = validation(what="masses, inertias, centre of mass, flooding, weight, temperature, nacelle turned",
                         reference="the file edited by hand", why="eigensolver")
    turbine, raw = model(with_effects(entries), turn_deg=40.0), _plain_raw()
    change(raw)
    expected, before = frequencies(model(raw, turn_deg=40.0)), bare()
    checked.error(frequencies(turbine, *[value] * len(entries)) / expected - 1, below=1e-9)
    assert np.abs(before / expected - 1).max() > 1e-5


def _plain_raw():
    raw = with_effects([])
    next(row for row in raw["parameter"] if row["name"] == "k_t")["update"] = True
    return raw


def _row(raw, name, value):
    next(row for row in raw["parameter"] if row["name"] == name)["initial"] = value


def test_the_water_level_is_that_of_a_file_with_other_water(validation):
    """Growth ends two metres below the still water: it stays, and the file's does so down to there. A fine mesh for
    all, so that the file's own cut at the water changes nothing."""
    row = validation(what="water level: change of frequencies", reference="a file with other water",
                     why="mesh, of the largest change")
    mesh = {"leg": 8, "brace": 4}
    raw = with_effects([entry("water", "water_level", bounds=(-3.0, 3.0))])
    raw["mesh"]["elements_per_member"] |= mesh
    turbine = model(raw)
    still = frequencies(turbine)
    for rise in (-1.9, 0.8, 2.4):
        other = _plain_raw()
        other["mesh"]["elements_per_member"] |= mesh
        other["site"]["water_level_m"] = rise
        change = frequencies(model(other)) / still - 1
        assert np.abs(change).max() > 1e-4
        row.error((frequencies(turbine, rise) / still - 1 - change) / np.abs(change).max(), below=0.02)


def test_the_water_level_by_hand(validation):
    """Mass that moves along with the whole structure sideways and upwards, per metre of rise, from the members that
    pass the water."""
    checked = validation(what="water level: mass it adds", reference="members that pass the water, by hand",
                         why="differences")
    description = parse_description(with_effects([entry("water", "water_level", bounds=(-2.5, 2.5))]), "m")
    frame = build_frame(description)
    assembled = assemble(frame, updated=("water",), values=description.values)
    values = description.values
    for level in (-1.3, 0.9):
        h = 1e-3
        rise = [assembled.coefficients(np.array([level + s * h]))[1] for s in (1, -1)]
        weights = (rise[0] - rise[1]) / (2 * h)
        for direction in (0, 2):
            motion = np.zeros((len(frame.node_m), 6))
            motion[:, direction] = 1.0
            q = np.linalg.lstsq(assembled.transform.toarray(), motion.ravel(), rcond=None)[0]
            found = sum(w * (q @ (matrix @ q)) for w, matrix in zip(weights, assembled.mass, strict=True))
            expected = 0.0
            for b in frame.beams:
                span = frame.node_m[b.end] - frame.node_m[b.start]
                low, high = sorted((frame.node_m[b.start][2], frame.node_m[b.end][2]))
                if low < level < high and b.group in ("leg", "brace"):
                    outer, inner = b.tube.outer(values), b.tube.inner(values)
                    along = span / np.linalg.norm(span)
                    per_metre = 1025.0 * np.pi / 4 * outer**2 * (1 - along[direction] ** 2)
                    per_metre += 1025.0 * np.pi / 4 * inner**2 if b.group == "leg" else 0.0
                    expected += per_metre / abs(along[2])
            checked.error(found / expected - 1, below=1e-6)


def test_a_brace_without_stiffness_is_one_that_is_not_there(validation):
    """Term by term: K of the frame at zero equals K of the frame without those beams. The whole brace would fold, so
    its axial and its bending stiffness are taken one after the other."""
    entries = [entry(m, "stiffness", {"part": "brace CB-1"}, {"motion": m}, (0.1, 2.0)) for m in ("axial", "bending")]
    description = parse_description(with_effects(entries), "m")
    frame = build_frame(description)
    with_brace = assemble(frame, updated=("axial", "bending"), values=description.values)
    gone = replace(frame, beams=tuple(b for b in frame.beams if b.part != "brace CB-1"))
    without = assemble(gone, updated=(), values=description.values)

    def stiffness(*theta):
        weights, _ = with_brace.coefficients(np.array(theta, float))
        return sum(w * term for w, term in zip(weights, with_brace.stiffness, strict=True))

    scale = abs(without.stiffness[0]).max()
    validation(what="brace at zero stiffness", reference="K without the brace, of its largest entry",
               why="rounding").error(abs(stiffness(0, 0) - without.stiffness[0]).max() / scale, below=1e-14)
    # the two motions make up the whole brace and nothing else
    both = stiffness(1, 0) + stiffness(0, 1) - stiffness(0, 0)
    assert abs(both - stiffness(1, 1)).max() < 1e-14 * scale
    assert abs(stiffness(1, 1) - stiffness(0, 0)).max() > 1e-6 * scale


def test_a_released_joint_is_a_tie_without_springs():
    turbine = model(with_effects([entry("e", "joint", {"leg": "A", "part": "brace AB-1"}, None, (0.0, 2.0))]))
    description = parse_description(_plain_raw(), "m")
    frame = build_frame(description)
    assembled = assemble(frame, updated=(), values=description.values)
    corner = next(t for t in frame.ties if len(t.released) and _ends(frame, t, "brace AB-1") and
                  frame.node_m[t.node][0] > 0)
    loose = replace(frame, ties=tuple(replace(t, stiffness=(Coefficient(0.0),) * 3) if t is corner else t
                                      for t in frame.ties))
    assembled = assemble(loose, updated=(), values=description.values)
    value, _ = lowest_modes(assembled.stiffness[0], assembled.mass[0], N_MODE)
    assert frequencies(turbine, 0.0) == pytest.approx(np.sqrt(value) / (2 * np.pi), rel=1e-9)


def _ends(frame, tie, part):
    return any(tie.node in (b.start, b.end) for b in frame.beams if b.part == part)


E, NU, RHO = 2.1e11, 0.3, 7850.0
TUBE = beam_elements.Tube(diameter_m=5.0, thickness_m=0.04)


def cantilever(number, length=60.0, **kwargs):
    """A clamped tower with a mass at its top; hinge in its first element."""
    nodes = np.linspace(0, length, number + 1)[:, None] * np.array([0.0, 0.0, 1.0])
    tower = [Beam(start=k, end=k + 1, group="tower", part="tower", tube=TUBE, youngs_modulus_pa=E, poisson_ratio=NU,
                  density_kgpm3=RHO) for k in range(number)]
    tower[0] = replace(tower[0], **kwargs)
    return Frame(node_m=nodes, beams=tuple(tower), supports=(Support(node=0),),
                 bodies=(Body(node=number, mass=Coefficient(3e5)),))


def modes(frame, n_mode, values, theory="bernoulli-euler"):
    assembled = assemble(frame, updated=(), values=values, theory=theory)
    value, _ = lowest_modes(assembled.stiffness[0], assembled.mass[0], n_mode)
    return np.sqrt(value) / (2 * np.pi)


@pytest.mark.parametrize("theory", ["bernoulli-euler", "timoshenko"])
@pytest.mark.parametrize("flexibility", [0.01, 0.3, 5.0])
def test_a_hinge_is_a_rotational_spring_between_two_nodes(theory, flexibility, validation):
    """Against the same tower whose foot is a node of its own, held by springs that are degrees of freedom."""
    checked = validation(what="hinge, both theories: first pair, second pair, without mass",
                         reference="a rotational spring between two nodes", why="rotation behind the hinge, rounding")
    number = 12
    hinge = cantilever(number, hinge=Hinge(end=0, bending=("c",)))
    found = modes(hinge, 4, {"c": flexibility}, theory)
    plain_frame = cantilever(number)
    spring = Coefficient(1e9 / flexibility)
    held = Support(node=0, held=np.array([True, True, True, False, False, True]))
    turning = tuple(NodeSpring(node=0, direction=np.eye(6)[k], stiffness=spring) for k in (3, 4))
    explicit = replace(plain_frame, supports=(held,), springs=turning)
    # what is left is the rotation behind the hinge in the mass of one element of twelve; it falls with the mesh
    error = np.abs(found / modes(explicit, 4, {}, theory) - 1)
    checked.error(error[:2], below=1e-4, of="first")
    checked.error(error[2:], below=1e-3, of="second")
    weightless = [replace(f, beams=tuple(replace(b, density_kgpm3=1e-6) for b in f.beams)) for f in (hinge, explicit)]
    stiffness = [modes(f, 2, {"c": flexibility}, theory) for f in weightless]
    checked.error(stiffness[0] / stiffness[1] - 1, below=1e-9, of="statically")
    assert np.all(found[:2] < modes(plain_frame, 2, {}, theory) * (1 - 1e-3))


def test_a_hinge_under_a_tip_mass_has_the_compliance_of_a_hand_calculation():
    """Light tower: 1 / k = L^3 / 3 EI + L^2 c, exactly, as stiffness is condensed exactly."""
    flexibility, length = 0.4, 60.0
    frame = cantilever(3, hinge=Hinge(end=0, bending=("c",)))
    frame = replace(frame, beams=tuple(replace(b, density_kgpm3=1e-6) for b in frame.beams))
    EI = E * TUBE.second_moment({})
    compliance = length**3 / (3 * EI) + length**2 * flexibility * 1e-9
    exact = np.sqrt(1 / (compliance * 3e5)) / (2 * np.pi)
    assert modes(frame, 2, {"c": flexibility}) == pytest.approx([exact, exact], rel=1e-7)


@pytest.mark.parametrize("end", [0, 1])
def test_a_slip_is_a_spring_in_series(end):
    flexibility, length = 7.0, 60.0
    frame = cantilever(3, hinge=Hinge(end=end, slip=("c",)))
    frame = replace(frame, beams=tuple(replace(b, density_kgpm3=1e-6) for b in frame.beams))
    compliance = length / (E * TUBE.area({})) + flexibility * 1e-9
    exact = np.sqrt(1 / (compliance * 3e5)) / (2 * np.pi)
    assembled = assemble(frame, updated=(), values={"c": flexibility})
    value, phi = lowest_modes(assembled.stiffness[0], assembled.mass[0], 3)
    motion = (assembled.transform @ phi).reshape(-1, 6, 3)
    upright = [k for k in range(3) if np.argmax(np.abs(motion[-1, :3, k])) == 2]
    assert np.sqrt(value[upright]) / (2 * np.pi) == pytest.approx([exact], rel=1e-6)


@pytest.mark.parametrize("share", [1.0, 1.5])
def test_the_share_of_shear_adds_up_to_timoshenko_s_theory(share, validation):
    """With a connection, whose condensation has shear in it."""
    checked = validation(what="flexibility in shear, one and one and a half times, with a connection",
                         reference="K and M of Timoshenko's theory, and with half of it on top, of their diagonals",
                         why="rounding")
    raw = with_effects([entry("c", "hinge", {"group": "tower"}, {"at_m": 12.0}, (0.0, 9.0)),
                        entry("s", "shear", None, {}, (0.0, 3.0))])
    raw["mesh"]["theory"] = "bernoulli-euler"
    theory = copy.deepcopy(raw)
    theory["mesh"]["theory"] = "timoshenko"
    ours, theirs = (model(r).matrices(np.array([0.4, s])) for r, s in ((raw, share), (theory, share - 1)))
    less = model(raw).matrices(np.array([0.4, share - 0.5]))
    for a, b, other in zip(ours, theirs, less, strict=True):
        size = np.sqrt(np.outer(a.diagonal(), a.diagonal()))
        checked.error((a - b).toarray() / size, below=1e-12)
        assert np.max(np.abs((other - b).toarray() / size)) > 1e-4


def test_hinges_on_the_turbine_sit_between_the_members_they_name():
    """A flange at the tower's foot bends the tower above it only; one at its top only the nacelle."""
    entries = [entry("foot", "hinge", {"group": "tower"}, {"at_m": 12.0}, (0.0, 9.0)),
               entry("top", "hinge", {"group": "tower"}, {"at_m": 50.0}, (0.0, 9.0)),
               entry("grout", "hinge", {"group": "pile"}, {"at_m": -19.0}, (0.0, 9.0))]
    frame = build_frame(parse_description(with_effects(entries), "m"))
    found = {(b.part, b.hinge.end, frame.node_m[(b.start, b.end)[b.hinge.end]][2]): b.hinge.bending
             for b in frame.beams if b.hinge is not None}
    assert found == {("tower", 0, 12.0): ("foot",), ("tower", 1, 50.0): ("top",)} | {
        (f"pile {leg}", 0, -19.0): ("grout",) for leg in LEGS
    }


def test_swinging_mass_against_its_dynamic_stiffness(validation):
    """A mass m on a spring acts like m / (1 - f^2 / f_0^2): each frequency solves the turbine with that mass."""
    checked = validation(what="swinging mass", reference="singular stiffness of the turbine with the mass's own",
                         why="of what a per mille of frequency makes")
    own, share = 0.9, 0.2
    turbine = model(with_effects([entry("e", "oscillator", {"body": "hub"}, {"axis": "x", "frequency_hz": own},
                                        (1e-4, 0.5))]))
    found = turbine.solve(np.array([share]), 4).frequency_hz
    description = parse_description(_plain_raw(), "m")
    frame = build_frame(description)
    hub = next(b.node for b in frame.bodies if b.mass.value(description.values) == 60000.0)
    assembled = assemble(frame, updated=(), values=description.values)
    across = assembled.transform[[6 * hub], :].toarray().ravel()
    K, M = assembled.stiffness[0], assembled.mass[0]
    for frequency in found[:4]:
        extra = share * 60000.0 * (1 / (1 - (frequency / own) ** 2) - 1)
        # the pencil with that mass is singular there
        residual = K - (2 * np.pi * frequency) ** 2 * (M + extra * sparse.csc_array(np.outer(across, across)))
        scale = np.sqrt(abs(K.diagonal()))
        least = np.abs(linalg.eigvalsh(residual.toarray() / np.outer(scale, scale))).min()
        moved = K - (2 * np.pi * frequency * 1.001) ** 2 * (M + extra * sparse.csc_array(np.outer(across, across)))
        checked.error(least / np.abs(linalg.eigvalsh(moved.toarray() / np.outer(scale, scale))).min(), below=1e-3)


def test_a_stiff_oscillator_is_a_mass_that_does_not_swing():
    turbine = model(with_effects([entry("e", "oscillator", {"body": "hub"}, {"axis": "x", "frequency_hz": 500.0},
                                        (1e-4, 0.5))]))
    assert frequencies(turbine, 0.3) == pytest.approx(bare(), rel=1e-5)


def test_a_pull_stiffens_a_beam_like_a_string():
    """Simply supported beam under tension T: (2 pi f)^2 m = EI (pi / L)^4 + T (pi / L)^2."""
    number, length, pull = 16, 60.0, 4e6
    frame = cantilever(number, length)
    pinned = [Support(node=0, held=np.array([1, 1, 1, 0, 0, 1], bool)),
              Support(node=number, held=np.array([1, 1, 0, 0, 0, 1], bool))]
    load = Prestress(coefficient=Coefficient(), node=number, force_n=np.array([0.0, 0.0, pull]))
    frame = replace(frame, supports=tuple(pinned), prestress=(load,))
    assert axial_forces(frame, {}, "bernoulli-euler", [load])[:, 0] == pytest.approx(np.full(number, pull), rel=1e-9)
    EI, mass = E * TUBE.second_moment({}), RHO * TUBE.area({})

    def closed(tension):
        return np.sqrt((EI * (np.pi / length) ** 4 + tension * (np.pi / length) ** 2) / mass) / (2 * np.pi)

    found, slack = modes(frame, 1, {})[0], modes(replace(frame, prestress=()), 1, {})[0]
    # rotary inertia enters both alike
    assert found / slack == pytest.approx(closed(pull) / closed(0.0), rel=1e-6)
    assert found / slack > 1.001


def test_the_thrust_pulls_one_side_and_presses_the_other(validation):
    """Equilibrium of everything above the mudline: no axial force in the tower, none in the sum of the piles, and the
    piles' couple is what their heads' moments leave of the thrust's."""
    row = validation(what="thrust of 1 N", reference="equilibrium: tower, sum and couple of the piles",
                     why="rounding; bending of the piles")
    description = parse_description(with_effects([entry("T", "thrust", bounds=(-1e6, 1e6))]), "m")
    frame = build_frame(description)
    (load,) = frame.prestress
    forces = axial_forces(frame, description.values, "bernoulli-euler", [load])[:, 0]
    tower = [k for k, b in enumerate(frame.beams) if b.group == "tower"]
    # a thrust across the tower bends it only
    row.error(forces[tower], below=1e-9, of="tower, N")
    heads = {b.part: k for k, b in enumerate(frame.beams) if b.group == "pile" and frame.node_m[b.start][2] == -19.0}
    side = {part: np.sign(frame.node_m[frame.beams[k].start][0]) for part, k in heads.items()}
    row.error(sum(forces[k] for k in heads.values()), below=1e-8, of="sum, N")
    couple = -sum(forces[k] * frame.node_m[frame.beams[k].start][0] for k in heads.values())
    # pushed along +x: piles at -x are pulled
    assert all(np.sign(forces[k]) == -side[part] for part, k in heads.items())
    arm = frame.node_m[load.node][2] + 19.0
    # what is left is carried by the bending of four slender piles
    row.error(couple / arm - 1, below=0.02, of="couple")


def test_leg_wise_slopes_add_up_to_those_of_all_legs():
    for kind, settings, bounds in (("scour", {}, (-0.3, 4.0)), ("soil", {"curve": "tz"}, (0.1, 4.0)),
                                   ("slip", {"at_m": -19.0}, (0.0, 9.0))):
        on = {"group": "pile"} if kind == "slip" else {}
        one = [entry(leg, kind, on | {"leg": leg}, settings, bounds) for leg in LEGS]
        turbine = model(with_effects([*one, entry("all", kind, on, settings, bounds)]))
        slope = turbine.solve(turbine.parameters.initial, N_MODE, derivatives=True).frequency_derivative
        assert slope[:, :4].sum(axis=1) == pytest.approx(slope[:, 4], rel=1e-9, abs=1e-12)
        assert np.all(np.abs(slope[:, 4]).max() > 1e-6)


def test_an_effect_on_one_leg_moves_that_leg():
    """Scour at leg A: under the first mode's inertia forces the pile of A gives way more than before, its neighbours'
    share grows; and the four legs' effects are rotations of one another on a jacket that is alike all round."""
    raw = with_effects([entry(leg, "scour", {"leg": leg}, bounds=(0.0, 4.0)) for leg in LEGS])
    for body in raw["rna"]:
        body |= {"offset_m": [0.0, 0.0, body["offset_m"][2]], "inertia_kgm2": [1e6, 1e6, 1e6]}
    turbine = model(raw)
    found = [frequencies(turbine, *(2.0 * np.eye(4)[k])) for k in range(4)]
    for other in found[1:]:
        assert other == pytest.approx(found[0], rel=1e-9)
    frame = build_frame(parse_description(raw, "m"))
    springs = {b.part: {f.names for c in b.springs.lateral for f in c.factors} for b in frame.beams if b.springs}
    assert all(("sc", leg) in springs[f"pile {leg}"] for leg in LEGS)
    assert all(not any(leg in names for names in springs[f"pile {other}"]) for leg in LEGS for other in LEGS
               if leg != other)


def test_small_turbine_is_left_as_it_was():
    before = copy.deepcopy(small_turbine())
    with_effects([entry("e", "scour")])
    assert small_turbine() == before
