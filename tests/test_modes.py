"""modes.json round trip and mode-shape criteria against their definitions."""

import json

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.modes import (
    ModalData,
    ModalSet,
    mac,
    modal_phase_collinearity,
    normalise,
    pair_by_mac,
    plane_mac,
    read_modes,
    rotate_to_real,
    subspace_mac,
    write_modes,
)

RNG = np.random.default_rng(7)


def complex_shape(n_channel=6, n_mode=3):
    return RNG.standard_normal((n_channel, n_mode)) + 1j * RNG.standard_normal((n_channel, n_mode))


def test_mac_is_one_for_any_complex_multiple_and_at_most_one_for_complex_shapes():
    a = complex_shape()
    assert np.diag(mac(a, a * (0.3 - 2j))) == pytest.approx(np.ones(3))
    assert np.all(mac(a, complex_shape()) <= 1 + 1e-12)


def test_mac_leaves_out_unmeasured_components():
    a = complex_shape(n_mode=1)
    b = a.copy()
    b[2] = np.nan
    assert mac(a, b)[0, 0] == pytest.approx(1.0)


def test_subspace_mac_is_one_for_any_turned_member_of_the_plane():
    plane = RNG.standard_normal((8, 2))
    turned = plane @ np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    assert subspace_mac(turned, plane) == pytest.approx([1.0, 1.0])
    assert plane_mac(plane, turned) == pytest.approx(1.0)
    away = np.linalg.svd(plane)[0][:, [5]]
    assert subspace_mac(away, plane) == pytest.approx([0.0], abs=1e-12)


def test_phase_collinearity_is_one_for_a_rotated_real_shape_and_zero_for_a_circle():
    real = RNG.standard_normal((9, 1))
    assert modal_phase_collinearity(real * np.exp(0.4j)) == pytest.approx([1.0])
    circle = np.exp(2j * np.pi * np.arange(8) / 8)[:, None]
    assert modal_phase_collinearity(circle) == pytest.approx([0.0], abs=1e-12)


def test_rotate_to_real_undoes_a_phase():
    real = normalise(RNG.standard_normal((9, 2)))
    assert np.allclose(rotate_to_real(real * np.exp(1.1j)), real)


def test_pairing_maximises_the_sum_and_leaves_nan_out():
    score = np.array([[0.9, 0.8, np.nan], [0.85, 0.1, np.nan]])
    assert sorted(pair_by_mac(score)) == [(0, 1), (1, 0)]


def sample_data():
    frequency = np.array([0.32, 1.9, np.nan])
    shape = complex_shape(4, 3)
    shape[:, 2] = np.nan
    shape[1, 0] = np.nan
    one = ModalSet(
        id="a", frequency_hz=frequency, shape=shape, damping_ratio=np.array([0.01, np.nan, np.nan]),
        frequency_std_hz=frequency * 0.01, shape_std=np.abs(shape.real) * 0.1, environment={"water_level_m": 0.2},
    )  # fmt: skip
    return ModalData(channels=("a", "b", "c", "d"), sets=(one,), labels=("FA1", "FA2", "T1"), reference_set="a")


def test_modes_json_round_trip(tmp_path):
    data = sample_data()
    write_modes(data, tmp_path / "modes.json")
    again = read_modes(tmp_path / "modes.json")
    assert again.channels == data.channels and again.labels == data.labels and again.reference_set == "a"
    one, two = data.sets[0], again.sets[0]
    for name in ("frequency_hz", "shape", "damping_ratio", "frequency_std_hz", "shape_std"):
        assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True), name
    assert dict(two.environment) == {"water_level_m": 0.2}
    assert "NaN" not in (tmp_path / "modes.json").read_text()


def minimal():
    return {"channels": ["a", "b"], "sets": [{"id": "1", "frequency_hz": [1.0], "shape_re": [[1.0, 0.5]]}]}


def write(tmp_path, content):
    path = tmp_path / "m.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_minimal_file_and_null_rows(tmp_path):
    content = minimal()
    content["sets"].append({"id": "2", "frequency_hz": [None], "shape_re": [None]})
    data = read_modes(write(tmp_path, content))
    assert not data.sets[1].measured[0] and np.all(np.isnan(data.sets[1].shape))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda c: c.update(channels=["a"]), "shape_re"),
        (lambda c: c.update(channels=["a", "a"]), "twice"),
        (lambda c: c.update(sets=[]), "no set"),
        (lambda c: c.update(chanels=["a"]), "did you mean 'channels'"),
        (lambda c: c["sets"][0].update(frequency_hz=[-1.0]), "not positive"),
        (lambda c: c["sets"][0].update(frequency_hz=["x"]), "numbers"),
        (lambda c: c["sets"][0].update(frequency_std=[0.1]), "did you mean 'frequency_std_hz'"),
        (lambda c: c["sets"][0].update(frequency_std_hz=[-0.1]), "negative"),
        (lambda c: c["sets"].append(dict(c["sets"][0])), "share one id"),
        (lambda c: c.update(labels=["a", "b"]), "labels"),
        (lambda c: c.update(reference_set="zz"), "reference_set"),
    ],
)
def test_each_mistake_is_named(tmp_path, change, word):
    content = minimal()
    change(content)
    with pytest.raises(InputError, match=word):
        read_modes(write(tmp_path, content))


def test_a_file_that_is_no_json_or_not_there(tmp_path):
    with pytest.raises(InputError, match="not JSON"):
        read_modes(write(tmp_path, "{"))
    with pytest.raises(InputError, match="no such file"):
        read_modes(tmp_path / "none.json")
