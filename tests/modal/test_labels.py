"""Labels of global modes on motions whose family is known."""

import numpy as np
import pytest

from probupdate.modal.labels import NEUTRAL, close_pairs, is_bending, label_across, mode_character
from probupdate.modal.modes import Sensor


@pytest.fixture
def sensors():
    made = []
    for leg, (sx, sy) in zip("ABCD", [(1, 1), (-1, 1), (-1, -1), (1, -1)], strict=True):
        for axis, d in zip("xyz", np.eye(3), strict=True):
            made.append(Sensor(channel=f"TP-{leg}-{axis}", level="TP", position_m=[3 * sx, 3 * sy, 13], direction=d))
    for z in (18, 66, 90):
        for axis, d in zip("xy", np.eye(3)[:2], strict=True):
            made.append(Sensor(channel=f"T{z}-{axis}", level=f"{z}", position_m=[0, 0, z], direction=d))
    return tuple(made)


def motion(sensors, ux=0.0, uy=0.0, rz=0.0, top=1.0):
    out = []
    for s in sensors:
        x, y, z = s.position_m
        u = np.array([ux - rz * y, uy + rz * x, 0.0]) * (top if z > 13 else 1.0)
        out.append(u @ s.direction)
    return np.array(out)


def test_families_and_numbers(sensors):
    shape = np.column_stack([
        motion(sensors, ux=1), motion(sensors, uy=1), motion(sensors, rz=0.3),
        motion(sensors, ux=1, top=-0.4), motion(sensors, uy=1, top=-0.4),
    ])
    character = mode_character(shape, sensors)
    assert character.labels == ("FA1", "SS1", "T1", "FA2", "SS2")
    assert np.allclose(character.share.sum(axis=1) + character.local, 1)
    assert np.all(character.local < 1e-12)


def test_mode_of_single_legs_is_local(sensors):
    breathing = np.array([s.direction[:2] @ np.sign(s.position_m[:2]) if s.position_m[2] == 13 else 0 for s in sensors])
    character = mode_character(np.column_stack([motion(sensors, ux=1), breathing]), sensors)
    assert character.labels == ("FA1", "L1")
    assert character.local[1] == pytest.approx(1.0)


def test_pitch_of_the_level_belongs_to_fore_aft(sensors):
    pitch = np.array([s.direction[2] * -s.position_m[0] + s.direction[0] * 0.5 for s in sensors])
    assert mode_character(pitch[:, None], sensors).share[0] == pytest.approx([1, 0, 0], abs=1e-12)


def test_rotated_pair_keeps_its_shares(sensors):
    turned = motion(sensors, ux=np.cos(0.3), uy=np.sin(0.3))
    assert mode_character(turned[:, None], sensors).share[0] == pytest.approx(
        [np.cos(0.3) ** 2, np.sin(0.3) ** 2, 0], abs=1e-12
    )


def test_close_pairs_are_named_by_family_and_number():
    labels = ("FA1", "SS1", "T1", "FA2", "SS2")
    assert close_pairs(np.array([0.32, 0.322, 1.2, 1.9, 2.0]), labels) == ((0, 1), (3, 4))
    assert close_pairs(np.array([0.32, 0.40, 1.2, 1.9, 2.0]), labels) == ((3, 4),)


def test_a_structure_without_a_nacelle_has_neutral_names(sensors):
    shape = np.column_stack([motion(sensors, ux=1), motion(sensors, uy=1), motion(sensors, rz=0.3)])
    labels = mode_character(shape, sensors, families=NEUTRAL).labels
    assert labels == ("X1", "Y1", "T1")
    # they pair as a turbine's do
    assert close_pairs(np.array([0.32, 0.322, 1.2]), labels) == ((0, 1),)
    assert [label_across(x) for x in ("Y12", "FA1", "T1", "mode 1")] == ["X12", "SS1", None, None]
    assert is_bending("X1") and not is_bending("L1")
