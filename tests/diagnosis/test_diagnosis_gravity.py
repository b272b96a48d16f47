"""What is stated of gravity in the readings, right or wrong, of matrices whose rotations say what it does."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import probupdate
from probupdate.diagnosis import stated_gravity
from probupdate.diagnosis.prepare import prepare
from probupdate.effects.gravity import CAUSE, gravity_effects
from probupdate.modal.modes import ModalData, ModalSet, Sensor
from tests.structure.test_gravity_readings import beam_arrays

CHANNELS = tuple(f"{axis}{node}" for node in (9, 19, 29, 39) for axis in "xy")
PARAMETERS = """[[parameter]]
name = "EI"
unit = "-"
initial = 1.0
std = 0.05
lower = 0.2
upper = 3.0
"""


@pytest.fixture(scope="module")
def beam(tmp_path_factory):
    """A clamped beam of 100 m at 0.32 Hz with accelerometers at four heights."""
    folder = tmp_path_factory.mktemp("beam")
    dof = [5 * node + {"x": 0, "y": 2}[axis] for node in (9, 19, 29, 39) for axis in "xy"]
    np.savez(folder / "model.npz", **beam_arrays(), channel=list(CHANNELS), channel_dof=dof)
    (folder / "parameters.toml").write_text(PARAMETERS)
    return prepare(folder / "model.npz")


def record(beam, *, feel, stated, seed=1, n_set=40):
    """Sets of the first two pairs as channels read them that feel gravity or not (`feel`: all, or one by one),
    scattered by 0.1 % and 0.3 %."""
    rng = np.random.default_rng(seed)
    # motion and rotation of the channels' places from the basis; what is read of them is put together here
    local = beam.small.evaluate(np.array(beam.small.parameters.initial))
    modes = local.solve(0.0, 4)
    seen = local.at_channels @ modes.vectors[:, :4]
    n, square = len(CHANNELS), (2 * np.pi * modes.frequency_hz[:4]) ** 2
    shape = seen[:n] + 9.80665 / square * seen[n:] * np.broadcast_to(feel, n)[:, None]
    shape = shape / np.abs(shape).max(axis=0)
    sets = []
    for k in range(n_set):
        f = modes.frequency_hz[:4] * (1 + 1e-3 * rng.standard_normal(4))
        sets.append(ModalSet(id=f"2019-06-01T{k // 2:02d}:{30 * (k % 2):02d}Z", frequency_hz=f,
                             damping_ratio=np.full(4, 0.01), shape=shape + 3e-3 * rng.standard_normal(shape.shape),
                             frequency_std_hz=1e-3 * f, shape_std=np.full(shape.shape, 3e-3)))
    return ModalData(channels=CHANNELS, sets=tuple(sets), gravity=(stated,) * n)


@pytest.mark.parametrize(("feel", "stated"), [(True, True), (False, False), (True, False), (False, True)])
def test_a_wrong_statement_is_found_and_a_right_one_is_none(beam, feel, stated):
    # discrepancy: a beam whose model is this one misses nothing
    found = probupdate.diagnose(replace(beam, discrepancy=3e-4), record(beam, feel=feel, stated=stated), seed=1,
                                extend=False)
    if feel == stated:
        assert found.verdict == "none", found.findings
        return
    first = found.findings[0]
    assert (found.verdict, first.kind, first.cause, first.location) == (
        "named", "measurement", CAUSE, "all horizontal channels")
    assert first.size == pytest.approx(1.0, abs=3 * first.size_std)
    assert f"gravity = {'true' if feel else 'false'}" in first.check or len(found.findings) == 1


@pytest.mark.parametrize(("place", "stated"), [(0, True), (1, False), (2, True)])
def test_one_sensor_of_which_gravity_is_wrongly_stated_is_named(beam, place, stated):
    feel = np.full(len(CHANNELS), stated)
    feel[2 * place : 2 * place + 2] = not stated
    found = probupdate.diagnose(replace(beam, discrepancy=3e-4), record(beam, feel=feel, stated=stated), seed=1,
                                extend=False)
    first = found.findings[0]
    assert (found.verdict, first.cause, len(found.findings)) == ("named", CAUSE, 1), found.findings
    assert all(name in first.location for name in CHANNELS[2 * place : 2 * place + 2])
    assert first.size == pytest.approx(1.0, abs=3 * first.size_std)


def test_rows_are_by_what_is_stated():
    both = gravity_effects((("a", True), ("b", False)))
    assert [e.location for e in both] == ["horizontal channels that are stated with it",
                                          "horizontal channels that are stated without it"]
    one = gravity_effects((("a", False), ("b", False)))
    assert [(e.location, e.adds.settings["channels"]) for e in one] == [("all horizontal channels", ("a", "b"))]
    assert gravity_effects(()) == ()
    sensors = [Sensor(channel=c, level="", position_m=(0, 0, z), direction=(1, 0, 0)) for c, z in (("a", 5), ("b", 9))]
    assert [e.location for e in gravity_effects((("a", True), ("b", True)), sensors)] == [
        "all horizontal channels", "a", "b"]



def test_what_is_not_explained_is_no_sign_of_gravity(beam, monkeypatch):
    """Beside a lost brace, "gravity: +2.11 +- 0.88, probability 0.89" stood before the cause: residuals of twice their
    standard deviations move an estimate by as much."""
    doubtful, data = replace(beam, discrepancy=3e-3), record(beam, feel=True, stated=False)
    (first,) = probupdate.diagnose(doubtful, data, seed=1, extend=False).findings
    assert (first.cause, first.prior_probability) == (CAUSE, 0.5) and first.z < 2 * 2.33
    monkeypatch.setattr(stated_gravity, "residual_of", lambda fitted, n: SimpleNamespace(
        means=(np.full(8, 2.0), np.eye(8))))
    assert not probupdate.diagnose(doubtful, data, seed=1, extend=False).findings
