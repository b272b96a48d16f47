"""The packaged reference turbine against Tables 3, 4 and 6 of the paper, in its three states."""

import numpy as np
import pytest

from probupdate.modal.labels import mode_character
from probupdate.modal.modes import Sensor, mac
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.load import load_model, reference_model, turbine_model
from probupdate.structure.parameter_table import read_toml

MODES = ("FA1", "SS1", "FA2", "SS2")
STATES = ("design", "as_built", "updated")
# as printed, Hz and N/m
TABLE_3 = {
    "design": (0.30, 0.30, 1.37, 1.40),
    "as_built": (0.31, 0.31, 1.57, 1.63),
    "updated": (0.32, 0.32, 1.94, 2.00),
}
TABLE_4_AS_BUILT = (0.97, 0.99, 0.98, 0.99)
TABLE_5 = {
    "k_j": 0.995, "k_t": 1.83, "k_TP": 0.341, "k_p": 1.02, "a_m": 0.84, "m_h": 1.47e5, "py": 0.133, "tz": 0.0696,
    "qw": 0.662, "LJF": 1.02,
}
TABLE_6 = {"design": (2.8e8, 1.0e9), "as_built": (4.4e8, 1.3e9), "updated": (1.3e9, 6.0e9)}
N_MODE = 8


def sensors_of(description):
    return tuple(Sensor(channel=s.channel, level=s.level, position_m=s.position_m, direction=s.direction)
                 for s in description.sensor)


class State:
    """One state solved at its initial values, modes by their names."""

    def __init__(self, model, description):
        self.model, self.description = model, description
        self.theta = np.array([p.initial for p in model.parameters])
        self.put(self.theta)

    def put(self, theta):
        solution = self.model.solve(theta, N_MODE)
        labels = mode_character(solution.shape, sensors_of(self.description)).labels
        self.frequency = dict(zip(labels, solution.frequency_hz, strict=True))
        self.shape = {label: solution.shape[:, k] for k, label in enumerate(labels)}
        self.pile_head = tuple(self.model.derived[name](theta) for name in ("k_xy", "k_z"))
        return self


@pytest.fixture(scope="module")
def states():
    return {name: State(load_model(reference_model(name)), read_description(reference_model(name)))
            for name in STATES}


@pytest.mark.parametrize("name", STATES)
def test_frequencies_are_those_of_table_3(states, name, validation):
    row = validation(what="FA1, SS1, FA2, SS2 in three states", reference="Table 3",
                     why="two printed decimals alone stand for 0.017")
    found = [states[name].frequency[mode] for mode in MODES]
    # the table prints two decimals: 0.30 alone stands for +-1.7 %
    row.error(np.array(found) / TABLE_3[name] - 1, below=0.02)


@pytest.mark.parametrize("name", STATES)
def test_pile_heads_are_those_of_table_6(states, name, validation):
    row = validation(what="pile-head stiffness in three states", reference="Table 6",
                     why="see what cannot be met together")
    row.error(np.array(states[name].pile_head) / TABLE_6[name] - 1, below=0.15)


@pytest.mark.parametrize("name", STATES)
def test_modes_come_in_the_papers_order_and_no_brace_mode_is_near(states, name):
    f = states[name].frequency
    assert list(f)[:5] == ["FA1", "SS1", "T1", "FA2", "SS2"]
    assert 1.1 < f["T1"] < 1.4
    # the paper's range of interest ends at 2.5 Hz, the Nyquist frequency of its decimated signals
    assert min(value for label, value in f.items() if label.startswith("L")) > 2.4
    assert list(f.values())[5] > 1.15 * f["SS2"]


def test_table_5_put_into_the_as_built_model_gives_the_updated_row(states, validation):
    row = validation(what="Table 5 put into the as-built model", reference="Tables 3 and 6, updated",
                     why="as the two rows above")
    model = states["as_built"].model
    assert set(model.parameters.names) == set(TABLE_5)
    there = State(model, states["as_built"].description)
    there.put(np.array([TABLE_5[name] for name in model.parameters.names]))
    row.error(np.array([there.frequency[mode] for mode in MODES]) / TABLE_3["updated"] - 1, below=0.02, of="frequency")
    row.error(np.array(there.pile_head) / TABLE_6["updated"] - 1, below=0.15, of="pile head")
    # and updated.toml is that model; its matrices are summed in another order
    in_file = [states["updated"].frequency[mode] for mode in MODES]
    assert [there.frequency[mode] for mode in MODES] == pytest.approx(in_file, rel=1e-9)
    assert there.pile_head == pytest.approx(states["updated"].pile_head, rel=1e-9)


def test_as_built_shapes_part_from_the_updated_ones_as_in_table_4(states, validation):
    """The updated model's shapes stand in for the measured ones, to which its MAC is 0.96 to 0.99 in the paper.

    The design row (0.85 and 0.93 for the second pair) is not met: nothing that sets design and as-built apart moves
    the shapes so far; studies/reference_turbine/RESULTS.md has the figures.
    """
    row = validation(what="MAC of the as-built with the updated state", reference="Table 4, as built",
                     why="what noise adds in the paper")
    ours = [float(mac(states["as_built"].shape[m][:, None], states["updated"].shape[m][:, None])[0, 0]) for m in MODES]
    # the printed values carry what noise and the real shapes add, up to 0.04 in the updated row
    row.error(np.array(ours) - TABLE_4_AS_BUILT, below=0.04)
    assert max(ours) < 0.9999


def test_the_states_are_one_structure(states):
    """They differ in the initial values of parameters only; an updated state keeps the as-built prior's width."""
    as_built = states["as_built"].description
    for name in ("design", "updated"):
        other = states[name].description
        left, right = (d.model_dump(exclude={"name", "parameter"}) for d in (as_built, other))
        assert left == right
        changed = {a.name for a, b in zip(as_built.parameter, other.parameter, strict=True) if a.initial != b.initial}
        assert changed == ({"sc", "mg", "corr"} if name == "design" else set(TABLE_5))
        for a, b in zip(as_built.parameter, other.parameter, strict=True):
            assert (a.name, a.update, a.lower, a.upper, a.prior) == (b.name, b.update, b.lower, b.upper, b.prior)
    assert states["updated"].model.parameters.std == pytest.approx(states["as_built"].model.parameters.std, rel=1e-12)


def test_the_files_mesh_is_fine_enough(states, validation):
    """Against a mesh twice as fine."""
    row = validation(what="mesh, first five modes, three states", reference="mesh twice as fine",
                     why="a fifteenth of the paper's CoV of f")
    for name in STATES:
        raw = read_toml(reference_model(name))
        mesh = raw["mesh"]["elements_per_member"]
        raw["mesh"]["elements_per_member"] = {group: 2 * number for group, number in mesh.items()}
        fine = State(turbine_model(parse_description(raw, name), where=name), states[name].description)
        for mode in ("FA1", "SS1", "T1", "FA2", "SS2"):
            row.error(states[name].frequency[mode] / fine.frequency[mode] - 1, below=1e-3)
