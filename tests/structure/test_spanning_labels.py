"""Names of modes of what spans: bending up and down, to the side, torsion and motion along a horizontal axis."""

import numpy as np
import pytest
from drawn.matrices import Assembly
from drawn.plans import building as drawn_building
from drawn.skeleton import Member, Skeleton, Steel

from probupdate import modes
from probupdate.modal.labels import NEUTRAL, sensed_character
from probupdate.modal.modes import Sensor

# a box girder: EI about the horizontal and the vertical, GJ, EA, mass and polar inertia of a metre
LENGTH_M, EI, EI_SIDE, GJ, EA, MASS, POLAR = 40.0, 8e9, 3e10, 4e9, 2e10, 4e3, 3e4
PARAMETER = '[[parameter]]\nname = "E"\nunit = "-"\ninitial = 1.0\nstd = 0.1\nlower = 0.5\nupper = 2.0\n'


def labels_of(folder, K, M, places, node, direction, *, count, metre=1.0, rows=(0,)):
    """metre: how many units of length of the matrices one is, with energy in as many units of a joule."""
    size = np.where(np.asarray(direction) < 3, metre, 1.0)
    unit = metre * np.outer(1 / size, 1 / size)
    np.savez(folder / "model.npz", K0=0 * K, K_E=K * unit, M0=M * unit, channel=[f"c{r}" for r in rows],
             channel_dof=list(rows), node_position_m=places, dof_node=node, dof_direction=direction,
             line=[[0, 1]])
    (folder / "parameters.toml").write_text(PARAMETER, encoding="utf-8")
    return modes(folder / "model.npz", count)


def beam(spans=1, pieces=24):
    """K, M (6 n, 6 n) of a girder along x of equal spans, held along at its first end and against twist at each."""
    h, n = LENGTH_M / pieces, pieces + 1
    bend = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h],
                     [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h * h, -6 * h, 4 * h * h]]) / h**3
    moves = h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h],
                                [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h * h, -22 * h, 4 * h * h]])
    K, M = np.zeros((6 * n, 6 * n)), np.zeros((6 * n, 6 * n))
    for o in range(0, 6 * pieces, 6):
        for d, k, m in ((0, EA, MASS), (3, GJ, POLAR)):
            own = np.ix_([o + d, o + d + 6], [o + d, o + d + 6])
            K[own] += k / h * np.array([[1, -1], [-1, 1]])
            M[own] += m * h / 6 * np.array([[2, 1], [1, 2]])
        for stiff, a, b, sign in ((EI_SIDE, 1, 5, 1), (EI, 2, 4, -1)):
            own, s = np.ix_(*[[o + a, o + b, o + a + 6, o + b + 6]] * 2), np.array([1, sign, 1, sign])
            K[own] += stiff * bend * np.outer(s, s)
            M[own] += MASS * moves * np.outer(s, s)
    held = [0, *(6 * k * pieces // spans + d for k in range(spans + 1) for d in (1, 2, 3))]
    K[held, held] += 1e4 * K.max()
    return K, M, np.array([[k * h, 0.0, 0.0] for k in range(n)])


def closed_forms(spans):
    """Label -> frequency: of one span pinned at its ends, of two the roots sin b = 0 and tan b = tanh b as well."""
    root = {1: [np.pi, 2 * np.pi, 3 * np.pi], 2: [np.pi, 3.926602, 2 * np.pi]}[spans]
    span, made = LENGTH_M / spans, {}
    for family, stiff in (("V", EI), ("H", EI_SIDE)):
        for k, b in enumerate(root[:2], 1):
            made[f"{family}{k}"] = b**2 * np.sqrt(stiff / MASS) / (2 * np.pi * span**2)
    return made | {"T1": np.sqrt(GJ / POLAR) / (2 * span), "A1": np.sqrt(EA / MASS) / (4 * LENGTH_M)}


@pytest.mark.parametrize(("spans", "turn", "metre"), [(1, 0.0, 1.0), (2, 0.0, 1.0), (1, 0.7, 1000.0),
                                                      (2, np.pi / 2, 1.0), (2, 2.5, 1.0)])
def test_a_girder_s_modes_have_the_names_of_closed_forms(tmp_path, validation, spans, turn, metre):
    """Along x, y and between, in SI and mm-N-t, one span and two."""
    row = validation(what="names of a girder's modes, one span and two, along x, y and between: V, H, T, A and numbers",
                     reference="closed forms of bending about either axis, torsion, along the axis",
                     why="mesh, linear in twist")
    K, M, places = beam(spans)
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    T = np.kron(np.eye(2 * len(places)), R)
    found = labels_of(tmp_path, T @ K @ T.T, T @ M @ T.T, places @ R.T + [300.0, -20.0, 8.0],
                      np.repeat(np.arange(len(places)), 6), np.tile(np.arange(6), len(places)), count=12, metre=metre)
    assert not {"FA", "SS", "X", "Y", "L"} & {x.rstrip("0123456789") for x in found.labels}
    for label, exact in closed_forms(spans).items():
        row.error(found.frequency_hz[found.labels.index(label)] / exact - 1, 4e-3)


def deck(skew=0.0, dofs=(0, 1, 2, 3, 4, 5), width=4.0, pier=0.0):
    """Two girders of 40 m with cross beams and diagonals, on bearings at their ends."""
    steel, n = Steel(), 10
    place = {f"{g}.{k}": np.array([k * 4.0 + g * width * np.tan(skew), g * width, 6.0]) for g in (0, 1)
             for k in range(n + 1)}
    lines = [(f"{g}.{k}", f"{g}.{k + 1}", 0.9) for g in (0, 1) for k in range(n)]
    lines += [(f"0.{k}", f"1.{k}", 0.5) for k in range(n + 1)] + [(f"0.{k}", f"1.{k + 1}", 0.3) for k in range(n)]
    lines += [(f"0.{k + 1}", f"1.{k}", 0.3) for k in range(n)]
    held = []
    if pier:
        place |= {f"p{g}": place[f"{g}.5"] - [0, 0, pier] for g in (0, 1)}
        lines, held = [*lines, *((f"p{g}", f"{g}.5", 0.8) for g in (0, 1))], ["p0", "p1"]
    members = tuple(Member(a=a, b=b, diameter=d, wall=d / 20, steel=steel, tags={}) for a, b, d in lines)
    made = Assembly(Skeleton(place=place, members=members, held=tuple(held)), dofs, 1)
    held = [made.index[end, d] for end in ("0.0", "1.0", "0.10", "1.10") for d in dofs
            if d in (1, 2) or (d == 0 and end.endswith(".0"))]
    made.K[held, held] += 1e3 * made.K.max()
    return made


def of_assembly(folder, a, count=8, **more):
    return labels_of(folder, a.K, a.M, np.array([a.place[name] for name in a.nodes]),
                     [a.nodes.index(name) for name, _ in a.index], [d for _, d in a.index], count=count, **more)


@pytest.mark.parametrize("more", [{}, {"dofs": (2, 3, 4)}, {"pier": 8.0}])
def test_a_deck_s_modes_have_the_names_that_symmetry_gives(tmp_path, more):
    """Bending up and down moves both girders alike; torsion moves them against one another, and up and down more than
    to the side."""
    a = deck(**more)
    _, phi = a.modes(8)
    found = of_assembly(tmp_path, a)
    up, side, along = (np.array([[phi[a.index[f"{g}.{k}", d]] if (f"{g}.{k}", d) in a.index else 0 * phi[0]
                                  for k in range(11)] for g in (0, 1)]) for d in (2, 1, 0))
    for j, label in enumerate(found.labels):
        # its image in the plane between the girders is itself, or itself with the other sign
        even, odd = (np.linalg.norm([x[0, :, j] + sign * s * x[1, :, j] for x, s in ((up, 1), (along, 1), (side, -1))])
                     for sign in (1, -1))
        lifts, goes_aside, goes = (np.linalg.norm(x[..., j]) for x in (up, side, along))
        wanted = ("A" if goes > lifts else "V") if even > odd else ("T" if lifts > goes_aside else "H")
        assert label[0] == wanted, (j, label)


def test_a_skew_deck_whose_nodes_form_no_sections_is_named_too(tmp_path):
    square, skew = (of_assembly(tmp_path, deck(skew=x)) for x in (0.0, 0.5))
    assert sorted(skew.labels[:6]) == sorted(square.labels[:6]) == ["H1", "T1", "T2", "V1", "V2", "V3"]


@pytest.mark.parametrize(("rise", "sag"), [(4.0, 0.0), (0.0, 6.0), (3.0, 5.0)])
def test_an_arch_and_a_bridge_curved_in_plan_bend_and_do_not_twist(tmp_path, rise, sag):
    """One line of nodes, of which no three are on one straight line: what moves up and down is vertical bending though
    it is beside the chord."""
    x = np.linspace(-20.0, 20.0, 17)
    bow = 1 - (x / 20) ** 2
    place = {f"{k}": np.array([x[k], sag * bow[k], rise * bow[k]]) for k in range(len(x))}
    members = tuple(Member(a=f"{k}", b=f"{k + 1}", diameter=0.8, wall=0.04, steel=Steel(), tags={}) for k in range(16))
    a = Assembly(Skeleton(place=place, members=members, held=("0", "16")), (0, 1, 2, 3, 4, 5), 1)
    _, phi = a.modes(5)
    size = np.array([[np.linalg.norm([phi[a.index[f"{k}", d], j] for k in range(1, 16)]) for d in range(3)]
                     for j in range(5)])
    assert [label[0] for label in of_assembly(tmp_path, a, 5).labels] == ["AHV"[k] for k in size.argmax(axis=1)]


@pytest.mark.parametrize(("extent", "seed"), [(30.0, 3), (30.0, 8)])
def test_a_long_building_keeps_the_names_of_what_rises(tmp_path, extent, seed):
    """Two storeys high and several times as long: its columns stand."""
    plan = drawn_building(np.random.default_rng(seed), extent)
    stretch = np.array([4.0, 1.0, 1.0])
    place = {name: p * stretch for name, p in plan.skeleton.place.items()}
    a = Assembly(Skeleton(place=place, members=plan.skeleton.members, bodies=plan.skeleton.bodies,
                          held=plan.skeleton.held), plan.dofs, 1)
    wide, deep, high = np.ptp(list(place.values()), axis=0)
    assert wide > 1.5 * max(deep, high)
    assert {"X1", "Y1", "T1"} <= set(of_assembly(tmp_path, a, 6).labels)


def sensors(places, axes):
    return tuple(Sensor(channel=f"{k}{'xyz'[d]}", level="deck", position_m=p, direction=np.eye(3)[d])
                 for k, p in enumerate(places) for d in axes)


def seen(sensed, *, up=lambda x: 0 * x, side=lambda x: 0 * x, twist=lambda x: 0 * x):
    """What sensors read of a deck of 30 m whose axis is at y = 12 m, z = 5 m."""
    out = []
    for s in sensed:
        x, y, z = s.position_m
        move = np.array([0.0, side(x) - twist(x) * (z - 5.0), up(x) + twist(x) * (y - 12.0)])
        out.append(move @ s.direction)
    return np.array(out)


def half_waves(n):
    return lambda x: np.sin(n * np.pi * x / 30.0)


def test_two_lines_of_vertical_sensors_see_torsion_of_a_function():
    """No nodes are known; the origin is far from the deck."""
    both = sensors([[x, y, 5.0] for x in (5, 10, 18, 26) for y in (10.0, 14.0)], (2,))
    shape = np.column_stack([seen(both, up=half_waves(1)), seen(both, twist=half_waves(1)),
                             seen(both, up=half_waves(2))])
    found = sensed_character(np.array([2.0, 3.0, 8.0]), shape, both, NEUTRAL)
    assert found.labels == ("V1", "T1", "V2")
    assert found.share[1, 2] == pytest.approx(1.0)


def test_one_line_of_sensors_in_two_directions_sees_bending_alone():
    one = sensors([[x, 12.0, 5.0] for x in (5, 10, 18, 26)], (1, 2))
    shape = np.column_stack([seen(one, up=half_waves(1)), seen(one, side=half_waves(1)), seen(one, up=half_waves(2))])
    assert sensed_character(np.array([2.0, 3.0, 8.0]), shape, one, NEUTRAL).labels == ("V1", "H1", "V2")


def test_sensors_of_a_roof_alone_are_of_a_building():
    roof = sensors([[x, y, 9.0] for x in (0, 15, 30) for y in (10.0, 14.0)], (0, 1))
    sway = np.column_stack([[s.direction[0] for s in roof], [s.direction[1] for s in roof]])
    assert sensed_character(np.array([2.0, 3.0]), sway, roof, NEUTRAL).labels == ("X1", "Y1")


def test_one_line_of_vertical_sensors_is_said_not_to_see_torsion_apart(tmp_path):
    a = deck()
    rows = [a.index[f"0.{k}", 2] for k in (3, 5, 8)]
    said = of_assembly(tmp_path, a, rows=rows).notes
    assert any("V1" in note and "T1" in note and "frequency alone" in note for note in said), said
