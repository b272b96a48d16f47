"""Structures from a millimetre to a hundred kilometres: labels, places, lengths and readers know no metre."""

import numpy as np
import pytest

import probupdate
from probupdate.errors import InputError
from probupdate.modal.labels import mode_character
from probupdate.modal.modes import Sensor
from probupdate.structure.load import load_model
from tests.subdyn_text import subdyn

CLAMPED = "1 1 1 1 1 1 1"
SCALES = [1e-5, 1.0, 1e3]


@pytest.mark.parametrize("scale", SCALES)
def test_a_subdyn_structure_scaled_has_its_frequencies_scaled(tmp_path, scale):
    def modes(scale):
        joints = [(0, 0, 0), (4, 0, 0), (0, 1, 20), (4, 1, 20), (4, 1, 20.5)]
        text = subdyn([" ".join(repr(x * scale) for x in j) for j in joints],
                      ["1 3 1 1 1c 0", "2 4 1 1 1c 0", "3 4 1 1 1c 0", "4 5 1 1 1c 0"],
                      [CLAMPED, "2 1 1 1 1 1 1"], fem=3, div=2,
                      circular=[f"1 2.1e11 8.1e10 7850 {0.8 * scale!r} {0.02 * scale!r}"])
        path = tmp_path / "frame.dat"
        path.write_text(text)
        return probupdate.model_modes(path, 6)

    own, other = modes(scale), modes(1.0)
    # f goes with c / L
    np.testing.assert_allclose(own.frequency_hz * scale, other.frequency_hz, rtol=1e-9)
    assert own.labels == other.labels


@pytest.mark.parametrize("scale", SCALES)
def test_labels_of_what_sensors_see_do_not_depend_on_the_extent(scale):
    places = [(x, y, z) for z in (5.0, 12.0) for x, y in ((3.0, 0.0), (-3.0, 0.0), (0.0, 3.0))]
    sensors = [Sensor(channel=f"{k}{axis}", level="", position_m=scale * np.array(p), direction=np.eye(3)[a])
               for k, p in enumerate(places) for a, axis in enumerate("xy")]
    along = np.array([[1.0, 0.0] for _ in places]).ravel()
    turn = np.array([[-y, x] for x, y, _ in places]).ravel() / 3
    height = np.repeat([p[2] / 12 for p in places], 2)
    shape = np.column_stack([along * height, np.roll(along, 1) * height, turn * height])
    assert mode_character(shape, sensors).labels == ("FA1", "SS1", "T1")


@pytest.mark.parametrize(("scale", "beside", "fits"), [(1e-3, 0.5e-3, True), (1e-3, 5e-3, False), (1e3, 500.0, True),
                                                      (1e3, 5000.0, False)])
def test_a_sensor_is_near_a_beam_by_the_structures_own_size(tmp_path, scale, beside, fits):
    (tmp_path / "pile.dat").write_text(subdyn(
        ["0 0 0", f"0 0 {50 * scale!r}"], ["1 2 1 1 1c 0"], [CLAMPED],
        circular=[f"1 2.1e11 8.1e10 7850 {2 * scale!r} {0.05 * scale!r}"]))
    sensor = Sensor(channel="A", level="", position_m=np.array([scale + beside, 0.0, 30 * scale]),
                    direction=np.array([1.0, 0.0, 0.0]))
    if fits:
        assert load_model(tmp_path / "pile.dat", sensors=(sensor,)).channels == ("A",)
    else:
        with pytest.raises(InputError, match="from any beam"):
            load_model(tmp_path / "pile.dat", sensors=(sensor,))


@pytest.mark.parametrize("extent", [1e-3, 1.0, 1e5])
def test_exchanged_matrices_are_found_by_the_extent(tmp_path, extent):
    # a chain of twenty masses along a bar of steel: lowest frequency c / 4L
    n = 20
    stiffness = 2.1e11 * n / extent * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    stiffness[-1, -1] /= 2
    mass = 7850 * extent / n * np.diag([*np.ones(n - 1), 0.5])
    more = {"channel": ["tip"], "channel_dof": [n - 1], "K_a": stiffness, "dof_node": np.arange(n),
            "dof_direction": np.full(n, 2), "node_position_m": np.column_stack(
                [np.zeros((n, 2)), extent / n * np.arange(1, n + 1)])}
    (tmp_path / "parameters.toml").write_text('[[parameter]]\nname = "a"\nunit = "-"\ninitial = 0.0\nstd = 0.1\n'
                                              'lower = -0.5\nupper = 0.5\nprior = "normal"\n')
    np.savez(tmp_path / "model.npz", K0=stiffness, M0=mass, **more)
    found = probupdate.model_modes(tmp_path / "model.npz", 1).frequency_hz[0]
    assert found == pytest.approx(np.sqrt(2.1e11 / 7850) / (4 * extent), rel=1e-3)
    if extent > 1:
        # of so slow a structure both readings are one
        return
    np.savez(tmp_path / "model.npz", K0=mass, M0=stiffness, **more | {"K_a": mass})
    with pytest.raises(InputError, match="exchanged"):
        probupdate.model_modes(tmp_path / "model.npz", 1)
