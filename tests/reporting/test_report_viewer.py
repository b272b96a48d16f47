"""The mode viewer's data: shapes scaled and turned onto the measured ones, sensors' motion from their channels."""

from __future__ import annotations

import json

import numpy as np
import pytest

from probupdate.modal.modes import Sensor
from probupdate.model.interface import Wireframe
from probupdate.reporting.viewer import ShapedModes, align, sensor_points, viewer_data

RNG = np.random.default_rng(11)


def column_wire(n: int = 6) -> Wireframe:
    z = np.linspace(0, 10, n)
    node = np.column_stack([0 * z, 0 * z, z])
    line = np.array([(k, k + 1) for k in range(n - 1)])
    return Wireframe(node_m=node, line=line, line_group=("tower",) * (n - 1))


def biaxial(wire: Wireframe) -> tuple[Sensor, ...]:
    return tuple(
        Sensor(channel=f"{k}{a}", level=str(k), position_m=p, direction=d)
        for k, p in enumerate(wire.node_m) for a, d in zip("xy", np.eye(3)[:2], strict=True)
    )


def turned_pair(angle: float):
    """A column's bending pair as measured, and the model's: turned by `angle` within the plane and scaled by 3."""
    wire = column_wire()
    bend = (wire.node_m[:, 2] / 10) ** 2
    moved = np.zeros((6, 3, 2))
    moved[:, 0, 0], moved[:, 1, 1] = bend, bend
    turn = 3 * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    computed = np.einsum("ndi,ij->ndj", moved, turn)
    sensors = biaxial(wire)
    return wire, sensors, moved[:, :2].reshape(12, 2), computed[:, :2].reshape(12, 2), computed


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.2, 2.8])
def test_a_close_pair_is_turned_onto_the_measured_pair(angle):
    wire, sensors, measured, computed, displacement = turned_pair(angle)
    states = {"updated": ShapedModes(frequency_hz=np.array([0.3, 0.31]), shape=computed, displacement=displacement)}
    data = viewer_data(wire, ("FA1", "SS1"), states, measured_shape=measured * np.exp(0.7j), sensors=sensors,
                       measured_hz=np.array([0.3, np.nan]), pairs=((0, 1),))
    for mode in data["modes"]:
        seen = np.array(mode["variants"]["measured"]["shape"])
        drawn = np.array(mode["variants"]["updated"]["shape"])
        assert np.abs(seen - drawn).max() < 2e-4  # four decimals are kept
        assert np.linalg.norm(drawn, axis=1).max() == pytest.approx(1, abs=1e-3)
    assert data["modes"][1]["variants"]["measured"]["hz"] is None
    assert json.loads(json.dumps(data, allow_nan=False)) == data


def test_without_a_pair_each_shape_is_only_scaled():
    _, _, measured, computed, _ = turned_pair(0.4)
    turn = align(measured, computed, [(0,), (1,)])
    assert turn[0, 1] == turn[1, 0] == 0
    # least squares by hand
    assert turn[0, 0] == pytest.approx(computed[:, 0] @ measured[:, 0] / (computed[:, 0] @ computed[:, 0]))


def test_modes_without_a_computed_partner_keep_their_measured_shape():
    wire, sensors, measured, computed, displacement = turned_pair(0.0)
    displacement = displacement.copy()
    displacement[:, :, 1] = np.nan
    states = {"initial": ShapedModes(frequency_hz=np.array([0.3, np.nan]), shape=computed, displacement=displacement)}
    data = viewer_data(wire, ("a", "b"), states, measured_shape=measured.astype(complex), sensors=sensors,
                       measured_hz=np.array([0.3, 0.4]))
    lost = data["modes"][1]["variants"]
    assert lost["initial"] == {"hz": None, "shape": None} and lost["measured"]["hz"] == 0.4


def test_motion_at_a_sensor_comes_from_its_channels_whatever_their_directions():
    vector = np.array([0.3, -0.2, 0.7])
    ways, _ = np.linalg.qr(RNG.standard_normal((3, 3)))
    sensors = tuple(Sensor(channel=str(k), level="a", position_m=(1, 2, 3), direction=w) for k, w in enumerate(ways))
    points, channels = sensor_points(sensors)
    assert points.tolist() == [[1, 2, 3]] and channels == [[0, 1, 2]]
    wire = column_wire(2)
    data = viewer_data(wire, ("m",), {}, measured_shape=(ways @ vector)[:, None].astype(complex), sensors=sensors,
                       measured_hz=np.array([1.0]))
    drawn = np.array(data["modes"][0]["variants"]["measured"]["shape"][0])
    # the sign of a measured shape is free; its largest component is drawn positive
    assert np.abs(drawn) == pytest.approx(np.abs(vector) / np.linalg.norm(vector), abs=1e-4)
    assert abs(drawn @ vector) == pytest.approx(np.linalg.norm(vector), abs=1e-3)


def test_a_sensor_that_was_not_measured_is_left_out():
    wire, sensors, measured, _, _ = turned_pair(0.2)
    measured = measured.astype(complex)
    measured[4:6] = np.nan
    data = viewer_data(wire, ("a", "b"), {}, measured_shape=measured, sensors=sensors, measured_hz=np.array([1.0, 1.1]))
    assert data["modes"][0]["variants"]["measured"]["shape"][2] is None
    assert data["modes"][0]["variants"]["measured"]["shape"][3] is not None


def test_a_bridge_is_seen_as_wide():
    wire = column_wire()
    lying = Wireframe(node_m=wire.node_m[:, [2, 0, 1]], line=wire.line, line_group=wire.line_group)
    assert viewer_data(lying, (), {})["wide"] and not viewer_data(wire, (), {})["wide"]
