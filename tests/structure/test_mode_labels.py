"""Labels of a model's modes by where their kinetic energy is: rotors off the axis, tripods, units, few sensors."""

import numpy as np
import pytest

from probupdate.modal.labels import indistinguishable, number_labels
from probupdate.modal.mode_energy import energy_character
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.assembly import assemble
from probupdate.structure.beam import Tube
from probupdate.structure.coefficient import Coefficient
from probupdate.structure.description_file import parse_description
from probupdate.structure.eigen import lowest_modes
from probupdate.structure.frame import Beam, Body, Frame, Support, Tie
from probupdate.structure.functions import FunctionModel
from probupdate.structure.load import model_sensors, reference_model, turbine_model
from probupdate.structure.mode_labels import dof_places, mode_labels
from probupdate.structure.parameter_table import read_toml
from probupdate.verbs.sought import reference_modes

STEEL = {"youngs_modulus_pa": 2.1e11, "poisson_ratio": 0.3, "density_kgpm3": 7850.0}
# mass, inertia about its centre: a rotor with its nacelle
RNA_KG, RNA_KGM2 = 1.0e6, np.diag([3e8, 1.6e8, 2.6e8])


def beam(start, end, tube, part="tower"):
    return Beam(start=start, end=end, group="tower", part=part, tube=tube, **STEEL)


def tower(top_offset_m, *, feet=0, at_m=(0.0, 0.0)):
    """A tube from -30 to 140 m with a rotor at an offset from its top; clamped, or on inclined legs from 20 m aside."""
    levels = np.linspace(-30.0, 140.0, 35)
    nodes = [[0.0, 0.0, z] for z in levels]
    beams = [beam(k, k + 1, Tube(diameter_m=9.0 - 0.02 * (z + 30), thickness_m=0.06)) for k, z in
             enumerate(levels[:-1])]
    held, first = [0], 9
    if feet:
        # legs in pieces, so that nodes stand beside the axis at levels of their own
        beams, held = beams[first:], []
        for leg in range(feet):
            angle = 2 * np.pi * leg / feet + 0.2
            foot, below = np.array([20 * np.cos(angle), 20 * np.sin(angle), -30.0]), None
            for t in (0.0, 0.3 + 0.05 * leg, 0.7, 1.0):
                here = first if t == 1.0 else len(nodes)
                if t < 1.0:
                    nodes.append(list((1 - t) * foot + t * np.array(nodes[first])))
                if below is None:
                    held.append(here)
                else:
                    beams.append(beam(below, here, Tube(diameter_m=3.0, thickness_m=0.05), f"leg {leg}"))
                below = here
    hub = len(nodes)
    nodes.append([0.0, 0.0, 140.0] + np.array(top_offset_m))
    unused = [Tie(node=k, master=first) for k in range(first)] if feet else []
    return Frame(node_m=np.array(nodes) + [*at_m, 0.0], beams=tuple(beams), ties=(Tie(node=hub, master=34), *unused),
                 bodies=(Body(node=hub, mass=Coefficient(RNA_KG), inertia_kgm2=RNA_KGM2),),
                 supports=tuple(Support(node=k) for k in held))


def characters(frame, n=8, metre=1.0):
    """Frequencies and characters of a frame's modes; metre: how many units of length one is (mm-N-t: 1000)."""
    made = assemble(frame, updated=(), values={})
    K, M = (sum(terms[1:], terms[0]) for terms in (made.stiffness, made.mass))
    places = dof_places(frame.node_m * metre, made.transform)
    value, phi = lowest_modes(K, M, n, "tower")
    # a displacement of one unit is 1 / metre m, a rotation is the same number; energies are of N and m
    scale = np.where(places.direction < 3, metre, 1.0)[:, None]
    mass = M.diagonal() / scale[:, 0] ** 2
    frequency = np.sqrt(value) / (2 * np.pi)
    return frequency, energy_character(phi * scale, (M @ phi) / scale, mass, places, frequency_hz=frequency)


@pytest.mark.parametrize("offset", [(-7.0, 0.0, 4.0), (0.0, 0.0, 4.0), (-12.0, 0.0, 0.0), (-5.0, 3.0, 4.0)])
@pytest.mark.parametrize("feet", [0, 3])
def test_torsion_with_a_rotor_off_the_axis_is_torsion(offset, feet):
    _, found = characters(tower(offset, feet=feet))
    assert {"FA1", "SS1", "T1", "FA2", "SS2"} <= set(found.labels)
    k = found.labels.index("T1")
    assert found.share[k, 2] > 0.6
    assert all(share[2] < 0.4 for j, share in enumerate(found.share) if not found.labels[j].startswith("T"))


def test_torsion_has_the_frequency_of_its_shaft():
    """The rotor on the axis: what is called torsion is the shaft's, GJ/L over the rotor's inertia."""
    frequency, found = characters(tower((0.0, 0.0, 4.0)))
    levels = np.linspace(-30.0, 140.0, 35)
    diameter, wall = 9.0 - 0.02 * (levels[:-1] + 30), 0.06
    polar = np.pi / 32 * (diameter**4 - (diameter - 2 * wall) ** 4)
    stiffness = 1 / np.sum(5.0 / (2.1e11 / 2.6 * polar))
    # a third of the shaft's own, as of a bar that turns linearly: half a per cent of the rotor's
    inertia = 2.6e8 + 7850.0 * np.sum(5.0 * polar) / 3
    k = found.labels.index("T1")
    assert frequency[k] == pytest.approx(np.sqrt(stiffness / inertia) / (2 * np.pi), rel=0.02)
    assert found.share[k, 2] == pytest.approx(1.0, abs=1e-6)


def test_labels_are_free_of_units_and_origin():
    _, metres = characters(tower((-7.0, 0.0, 4.0), feet=3))
    for other in (characters(tower((-7.0, 0.0, 4.0), feet=3), metre=1000.0)[1],
                  characters(tower((-7.0, 0.0, 4.0), feet=3, at_m=(500.0, -300.0)))[1]):
        assert other.labels == metres.labels
        assert other.share == pytest.approx(metres.share, abs=1e-6)


def test_shares_of_energy_add_up_to_one():
    _, found = characters(tower((-7.0, 2.0, 4.0), feet=3))
    assert found.share.sum(axis=1) + found.local == pytest.approx(1.0)


def test_a_pair_that_bends_obliquely_is_one_of_either_direction():
    share = np.array([[0.55, 0.45, 0.0], [0.53, 0.47, 0.0], [0.98, 0.0, 0.0]])
    frequency = np.array([0.3, 0.3001, 1.2])
    assert number_labels(share, 1 - share.sum(axis=1), ("FA", "SS", "T"), frequency_hz=frequency) == ("FA1", "SS1",
                                                                                                      "FA2")
    # apart, they are what they lean to
    assert number_labels(share, 1 - share.sum(axis=1), ("FA", "SS", "T"),
                         frequency_hz=np.array([0.3, 0.9, 1.2])) == ("FA1", "FA2", "FA3")


def with_sensors(levels):
    raw = read_toml(reference_model("as_built"))
    raw["sensor"] = [s for s in raw["sensor"] if s["level"] in levels]
    return turbine_model(parse_description(raw, "few sensors"), where="few sensors")


def test_names_do_not_depend_on_the_sensors():
    few, all_of_them = (with_sensors(levels) for levels in (
        ("tower 2/3", "tower top"), ("TP", "tower bottom", "tower 2/3", "tower top")))
    for model in (few, all_of_them):
        solution = model.solve(model.parameters.initial, 6)
        assert mode_labels(model, solution) == ("FA1", "SS1", "T1", "FA2", "SS2", "FA3")


def test_few_sensors_look_for_the_second_bending_and_say_what_they_mix():
    model = with_sensors(("tower 2/3", "tower top"))
    sensors = tuple(s for s in model_sensors_of(model))
    found = reference_modes(model, sensors)
    assert found.modes.labels == ("FA1", "SS1", "T1", "FA2", "SS2")
    assert any("SS1 (0.3075 Hz) and T1 (1.222 Hz)" in note and "frequency alone" in note for note in found.notes)


def model_sensors_of(model):
    known = {s.channel: s for s in model_sensors(reference_model("as_built"))}
    return [known[channel] for channel in model.channels]


def test_what_moves_no_sensor_is_said():
    shape = np.array([[1.0, 0.0, 1e-9], [0.5, 1.0, 1e-9]])
    said = indistinguishable(("FA1", "SS1", "T1"), np.array([0.3, 0.31, 1.2]), shape)
    assert said == ("T1 (1.2 Hz) moves none of the sensors",)


def test_a_function_keeps_its_labels_from_sensors(sensors_of_a_tower):
    """No nodes are known of it."""
    shape = np.array([[1.0, 0.0], [0.0, 1.0]])
    one = Parameter(name="a", unit="-", initial=1.0, std=0.1, lower=0.5, upper=2.0)
    model = FunctionModel(name="f", channels=("x", "y"), version="1", parameters=Parameters((one,)),
                          function=lambda theta: (np.array([1.0, 2.0]), shape))
    solution = model.solve(model.parameters.initial, 2)
    assert mode_labels(model, solution, sensors_of_a_tower) == ("FA1", "SS1")
    assert mode_labels(model, solution) == ("mode 1", "mode 2")


@pytest.fixture
def sensors_of_a_tower():
    return tuple(Sensor(channel=c, level="top", position_m=[0, 0, 90], direction=d) for c, d in
                 (("x", [1, 0, 0]), ("y", [0, 1, 0])))


def test_modes_of_interest_are_those_of_the_reference():
    model = with_sensors(("TP", "tower bottom", "tower 2/3", "tower top"))
    assert reference_modes(model, model_sensors_of(model)).modes.labels == ("FA1", "SS1", "T1", "FA2", "SS2")
