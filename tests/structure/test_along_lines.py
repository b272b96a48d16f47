"""Sensors of a model that is known at its nodes alone: where they may be instead, and what they read there."""

import numpy as np
import pytest

from probupdate.effects.places import with_places
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.matrices import channel_places, load_matrices

# a mast of four nodes of which the lowest stands still, a strut beside it that ends at its second node
NODES = np.array([[0.0, 0, 0], [0, 0, 4], [0, 0, 9], [0, 0, 12], [3, 0, 0]])
LINES = np.array([[0, 1], [2, 1], [2, 3], [4, 1], [1, 1]])
AXES = np.eye(3)


def truss(tmp_path, line=LINES, **more):
    """Nodes 1 to 4 move along x and y; x and y are measured at node 1, x at node 2."""
    n = 8
    stiffness = np.diag(np.arange(1.0, n + 1))
    for number, (a, b) in enumerate(LINES[:4]):
        for axis in range(2):
            ends = np.array([2 * (node - 1) + axis for node in (a, b) if node])
            signs = np.array([1.0, -1.0])[: len(ends)]
            stiffness[np.ix_(ends, ends)] += (10 + number + 3 * axis) * np.outer(signs, signs)
    arrays = {"K0": stiffness, "M0": np.eye(n), "K_k": np.diag(np.arange(1.0, n + 1)),
              "channel": np.array(["ax", "ay", "bx"]), "channel_dof": np.array([0, 1, 2]), "node_position_m": NODES,
              "dof_node": np.repeat([1, 2, 3, 4], 2), "dof_direction": np.tile([0, 1], 4), "line": line} | more
    np.savez(tmp_path / "model.npz", **{k: v for k, v in arrays.items() if v is not None})
    return load_matrices(tmp_path / "model.npz", Parameters((Parameter(name="k", unit="-", initial=1.0, std=0.1),)))


def test_rows_go_along_the_lines_of_the_model_and_towards_nothing_that_stands_still(tmp_path):
    model = truss(tmp_path)
    _, together = with_places(model, channel_places(model), alone=False)
    of_place = [(e.location, e.lower, e.upper, e.odds) for e in together]
    # the mast's foot does not move: its readings would be a gain's
    node = ", moved towards the node at"
    assert of_place == [(f"a{node} (0, 0, 12) m", 0.0, 8.0, 0.5), (f"a{node} (3, 0, 0) m", 0.0, 5.0, 0.5),
                        (f"bx{node} (0, 0, 12) m", -5.0, 3.0, 1.0)]
    _, each = with_places(model, channel_places(model), alone=True)
    assert {e.location.split(",")[0] for e in each} == {"a", "ax", "ay", "bx"}
    assert sum(e.odds for e in each if e.location[0] == "a") == pytest.approx(1.0)
    assert len({e.adds.name for e in each}) == len(each) == 7


def test_without_lines_the_stiffness_says_which_nodes_are_joined(tmp_path):
    """As long as it is one of elements: condensed matrices join everything."""
    drawn, plain = truss(tmp_path), truss(tmp_path, line=None)
    rows = [{(e.location, e.lower, e.upper) for e in with_places(m, channel_places(m), alone=False)[1]}
            for m in (drawn, plain)]
    assert rows[0] == rows[1]
    n = 40
    dense = truss(tmp_path, line=None, K0=np.eye(n) + np.ones((n, n)), M0=np.eye(n), K_k=np.eye(n),
                  node_position_m=np.arange(3.0 * n).reshape(n, 3) ** 1.1, dof_node=np.arange(n),
                  dof_direction=np.zeros(n, int))
    assert with_places(dense, channel_places(dense), alone=False) == (dense, ())


def test_what_reads_two_nodes_at_once_is_at_neither(tmp_path):
    mixed = truss(tmp_path, channel_dof=None, channel_row=np.eye(8)[:3] + 0.1 * np.eye(8)[2:5])
    there = [Sensor(channel="ax", level="", position_m=NODES[1], direction=AXES[0])]
    assert with_places(mixed, there, alone=True) == (mixed, ())


def test_channels_read_the_motion_of_where_they_are(tmp_path, validation):
    """At a node its own, between two a straight line's; derivatives with what the model had and with the way."""
    row = validation(what="sensors of matrices moved along lines of nodes: shapes at a node and between two; "
                          "derivative with the place", reference="the nodes' own motion; central differences",
                     unit="-")
    own = truss(tmp_path)
    model, effects = with_places(own, channel_places(own), alone=False)
    names = model.parameters.names
    row.equal(model.solve(model.parameters.initial, 4).frequency_hz.tolist(),
              own.solve(own.parameters.initial, 4).frequency_hz.tolist(), "frequencies")
    value, phi = own.solve_full(own.parameters.initial, 4)
    node = {k: phi[2 * (k - 1) : 2 * k] for k in (1, 2, 3, 4)}
    up, strut, down = (names.index(e.adds.name) for e in effects)
    for column, at, channels, there in ((up, 5.0, [0, 1], node[2]), (up, 6.5, [0, 1], 0.5 * (node[2] + node[3])),
                                        (strut, 1.0, [0, 1], 0.8 * node[1] + 0.2 * node[4]),
                                        (down, -5.0, [2], node[1][:1]), (down, 3.0, [2], node[3][:1])):
        theta = np.array(model.parameters.initial)
        theta[column] = at
        read = model.solve(theta, 4).shape
        row.error(float(np.abs(read[channels] - there).max()), 1e-12, "place", case=(names[column], at))
        others = np.setdiff1d(np.arange(3), channels)
        row.error(float(np.abs(read[others] - own.solve(own.parameters.initial, 4).shape[others]).max()), 1e-12,
                  "place", case="others")
    theta = np.array(model.parameters.initial)
    theta[[up, down]] = 2.0, -1.0
    slope = model.solve(theta, 4, derivatives=True).shape_derivative
    for column in (up, strut, down):
        step = np.zeros(len(theta))
        step[column] = 1e-3
        low, high = (model.solve(theta + s * step, 4).shape for s in (0, 1))
        row.error(float(np.abs(slope[:, :, column] - (high - low) / 1e-3).max()), 1e-9, "slope", case=names[column])
