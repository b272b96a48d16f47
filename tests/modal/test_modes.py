"""modes.json round trip and mode-shape criteria against their definitions."""

import dataclasses
import functools
import json
import pickle

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.io.files import write_json, write_json_rows
from probupdate.modal import covariance_file
from probupdate.modal.modes import (
    CovarianceFactors,
    ModalData,
    ModalSet,
    ModeRecord,
    StoredFactors,
    criteria_within_plane,
    mac,
    modal_phase_collinearity,
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


@pytest.mark.parametrize("motionless", [np.zeros(8), np.r_[np.full(4, np.nan), np.zeros(4)]])
def test_a_shape_without_motion_at_the_sensors_has_no_mac_with_a_plane(motionless):
    shape = np.column_stack([motionless, np.arange(8.0)])
    value = subspace_mac(shape, np.column_stack([np.ones(8), np.arange(8.0)]))
    assert np.isnan(value[0]) and value[1] == pytest.approx(1.0)


def test_phase_collinearity_is_one_for_a_rotated_real_shape_and_zero_for_a_circle():
    real = RNG.standard_normal((9, 1))
    assert modal_phase_collinearity(real * np.exp(0.4j)) == pytest.approx([1.0])
    circle = np.exp(2j * np.pi * np.arange(8) / 8)[:, None]
    assert modal_phase_collinearity(circle) == pytest.approx([0.0], abs=1e-12)


def test_rotate_to_real_undoes_a_phase():
    real = RNG.standard_normal((9, 2))
    real /= real[np.argmax(np.abs(real), axis=0), [0, 1]]
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
    )
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


def test_a_condition_that_was_not_known_is_written_again(tmp_path):
    """It is null in the file and None after that, at which the second writing had ended in a traceback."""
    data = sample_data()
    one = dataclasses.replace(data.sets[0], environment={"independence_X1_Y1": np.nan, "state": "idling", "t": 2.0})
    write_modes(dataclasses.replace(data, sets=(one,), reference_set=None), tmp_path / "a.json")
    write_modes(read_modes(tmp_path / "a.json"), tmp_path / "b.json")
    for name in ("a.json", "b.json"):
        (known,) = json.loads((tmp_path / name).read_text())["sets"]
        assert known["environment"] == {"independence_X1_Y1": None, "state": "idling", "t": 2.0}


def test_frequencies_alone_need_no_shapes(tmp_path):
    data = read_modes(write(tmp_path, {"channels": [], "sets": [{"id": "1", "frequency_hz": [1.0, 2.5]}]}))
    assert data.sets[0].shape.shape == (0, 2) and data.sets[0].frequency_hz.tolist() == [1.0, 2.5]


def test_channels_are_left_out_of_shapes_and_covariances_alone():
    data = sample_data()
    one, n_mode = data.sets[0], data.n_mode
    factors = CovarianceFactors(ln_frequency=RNG.standard_normal((n_mode, 5)), damping_ratio=np.zeros((n_mode, 5)),
                                shape=RNG.standard_normal((4, n_mode, 5)))
    for kept in (factors, StoredFactors(read=lambda: factors)):
        whole = dataclasses.replace(data, sets=(dataclasses.replace(one, covariance_factors=kept),))
        (left,) = (less := whole.without_channels(["b", "c"])).sets
        assert less.channels == ("a", "d") and less.labels == data.labels
        assert np.array_equal(left.shape, one.shape[[0, 3]], equal_nan=True)
        assert np.array_equal(left.frequency_hz, one.frequency_hz, equal_nan=True)
        assert np.array_equal(left.covariance_factors.load().shape, factors.shape[[0, 3]])
        assert np.array_equal(left.covariance_factors.ln_frequency, factors.ln_frequency)
    with pytest.raises(InputError, match="channel x.*there is none.*a, b, c, d"):
        data.without_channels(["x"])
    with pytest.raises(InputError, match="all of them"):
        data.without_channels(data.channels)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda c: c.update(channels=["a"]), "shape_re"),
        (lambda c: c["sets"][0].pop("shape_re"), r'of frequencies alone write "channels": \[\]'),
        (lambda c: c["sets"][0].pop("frequency_hz"), "'frequency_hz' is missing"),
        (lambda c: c.update(channels=["a", "a"]), "twice"),
        (lambda c: c.update(sets=[]), "no set"),
        (lambda c: c.update(sets={}), "sets: is not a list"),
        (lambda c: c.pop("channels"), "channels: is missing"),
        (lambda c: c.update(channel=c.pop("channels")), "unknown key 'channel'; did you mean 'channels'"),
        (lambda c: c["sets"][0].update(shape_std=[[-0.01] * len(c["channels"])]), "shape_std: .* negative"),
        (lambda c: c.update(chanels=["a"]), "did you mean 'channels'"),
        (lambda c: c["sets"][0].update(frequency_hz=[-1.0]), "not positive"),
        (lambda c: c["sets"][0].update(frequency_hz=[1e300]), "not a measurement"),
        (lambda c: c["sets"][0].update(frequency_hz=["x"]), "numbers"),
        (lambda c: c["sets"][0].update(frequency_std=[0.1]), "did you mean 'frequency_std_hz'"),
        (lambda c: c["sets"][0].update(frequency_std_hz=[-0.1]), "negative"),
        (lambda c: c["sets"][0].update(frequency_std_hz=[1e-9]),
         r"set 1, frequency_std_hz: 1e-09 Hz of 1 Hz is smaller than the accuracy of any .* placeholder\?"),
        (lambda c: c["sets"][0].update(damping_ratio=[0.9]), r"set .*, damping_ratio: 0.9 .* are these per cent\?"),
        (lambda c: c["sets"][0].update(damping_ratio=[1.2]), "fractions, 0.01 for 1 %"),
        (lambda c: c["sets"][0].update(environment={"air_temperature_c": 288.2}),
         "air_temperature_c: a median of 288.2 .* kelvin"),
        (lambda c: c["sets"][0].update(shape_re=[[0.0, None]]), "set 1, shape_re: the shape of mode 1 is zero at"),
        (lambda c: c["sets"][0].update(environment={"air_temperature_c": "10,5"}),
         "set 1, environment, air_temperature_c: '10,5' is not a number; write it with a point"),
        (lambda c: c["sets"][0].update(environment={"nacelle_angle_deg": "west"}), "'west' is not a number"),
        (lambda c: c["sets"][0].update(environment={"Air_temperature_c": 10.0}),
         "set 1, environment: unknown key 'Air_temperature_c'; did you mean 'air_temperature_c'"),
        (lambda c: c["sets"].append(dict(c["sets"][0], id="2", environment={"wind_speed_ms": 3.0})),
         "set 2, .*'wind_speed_ms'; did you mean 'wind_speed_mps'"),
        (lambda c: c["sets"].append(dict(c["sets"][0])), "share one id"),
        (lambda c: c.update(labels=["a", "b"]), "labels"),
        (lambda c: c.update(labels=["X1", "X1"]), "labels: X1 stands for 2 modes; give every mode a name of its own"),
        (lambda c: c.update(reference_set="zz"), "reference_set"),
    ],
)
def test_each_mistake_is_named(tmp_path, change, word):
    content = minimal()
    change(content)
    with pytest.raises(InputError, match=word):
        read_modes(write(tmp_path, content))


def test_conditions_of_other_tools_are_left_to_them(tmp_path):
    its = {"water_temperature_c": 5.0, "air_temperature_c_note": "of the mast", "crew": "B", "temperature": "warm"}
    content = minimal()
    content["sets"][0]["environment"] = its
    assert dict(read_modes(write(tmp_path, content)).sets[0].environment) == its


def test_a_file_that_is_no_json_or_not_there(tmp_path):
    with pytest.raises(InputError, match="not JSON"):
        read_modes(write(tmp_path, "{"))
    with pytest.raises(InputError, match="no such file"):
        read_modes(tmp_path / "none.json")


# Standard deviations
# ---------------------------------------------------------------------------------------------------------


def data_with_factors(ids=("2019-06-03T10:00Z", "a/b")):
    """Two modes, the second not measured in the second set; numbers that float32 holds exactly."""
    sets = []
    for k, name in enumerate(ids):
        columns = RNG.integers(-8, 8, (2, 5)) / 64
        shape = (RNG.integers(-8, 8, (3, 2, 5)) + 1j * RNG.integers(-8, 8, (3, 2, 5))) / 64
        frequency = np.array([0.32, 1.9 if k == 0 else np.nan])
        if k:
            columns[1], shape[:, 1] = np.nan, np.nan
        sets.append(ModalSet(
            id=name, frequency_hz=frequency, shape=complex_shape(3, 2), damping_ratio=np.array([0.01, 0.02]),
            frequency_std_hz=np.full(2, np.nan), shape_std=np.full((3, 2), np.nan),
            covariance_factors=CovarianceFactors(ln_frequency=columns, damping_ratio=columns / 4, shape=shape),
        ))
    return ModalData(channels=("a", "b", "c"), sets=tuple(sets))


def test_standard_deviations_are_the_columns_root_sum_of_squares():
    one = data_with_factors().sets[0]
    for j in range(2):
        assert one.frequency_std_hz[j] == pytest.approx(
            one.frequency_hz[j] * np.linalg.norm(one.covariance_factors.ln_frequency[j]))
        assert one.damping_ratio_std[j] == pytest.approx(np.linalg.norm(one.covariance_factors.damping_ratio[j]))
        for c in range(3):
            assert one.shape_std[c, j] == pytest.approx(np.linalg.norm(one.covariance_factors.shape[c, j].real))


def test_a_given_standard_deviation_stays_and_without_columns_there_is_none():
    one = data_with_factors().sets[0]
    kept = dataclasses.replace(one, frequency_std_hz=np.array([0.5, np.nan]))
    assert kept.frequency_std_hz == pytest.approx([0.5, one.frequency_std_hz[1]])
    assert np.all(np.isnan(sample_data().sets[0].damping_ratio_std))
    assert sample_data().sets[0].covariance_factors is None


def test_deviations_round_trip_beside_modes_json_and_twice_the_same_bytes(tmp_path):
    data = data_with_factors(ids=("2019-06-03T10:00Z", "a/b"))
    write_modes(data, tmp_path / "m.json")
    first = (tmp_path / "m.deviations.h5").read_bytes()
    again = read_modes(tmp_path / "m.json")
    for one, two in zip(data.sets, again.sets, strict=True):
        for name in ("ln_frequency", "damping_ratio", "shape"):
            assert np.array_equal(getattr(one.covariance_factors, name), getattr(two.covariance_factors, name),
                                  equal_nan=True)
        for name in ("frequency_std_hz", "damping_ratio_std", "shape_std"):
            assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True)
    write_modes(again, tmp_path / "m.json")
    assert (tmp_path / "m.deviations.h5").read_bytes() == first


@pytest.mark.parametrize("ids", [("..", "%2F"), ("", "."), ("a/b", "a%2Fb")])
def test_any_id_is_a_group_of_its_own(tmp_path, ids):
    data = data_with_factors(ids=ids)
    write_modes(data, tmp_path / "m.json")
    for one, two in zip(data.sets, read_modes(tmp_path / "m.json").sets, strict=True):
        assert np.array_equal(one.covariance_factors.shape, two.covariance_factors.shape, equal_nan=True)


def test_mistakes_with_deviations_are_named(tmp_path):
    write_modes(data_with_factors(), tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text())
    for name, word in (("../m.deviations.h5", "not a file name"), (3, "not a file name"), ("none.h5", "does not exist"),
                       ("m.json", "not a file of covariance factors")):
        with pytest.raises(InputError, match=word):
            read_modes(write(tmp_path, content | {"deviations": name}))
    fewer = content | {"channels": ["a", "b"]}
    fewer["sets"] = [{"id": "a/b", "frequency_hz": [1.0], "shape_re": [[1.0, 0.5]]}]
    with pytest.raises(InputError, match=r"set a/b: its covariance is of \(3, 2\) channels and modes"):
        read_modes(write(tmp_path, fewer))
    with pytest.raises(InputError, match="do not belong together"):
        CovarianceFactors(ln_frequency=np.zeros((2, 4)), damping_ratio=np.zeros((2, 5)), shape=np.zeros((3, 2, 4)))
    content["sets"][0]["damping_ratio_std"] = [-1.0, None]
    with pytest.raises(InputError, match="damping_ratio_std: a standard deviation is negative"):
        read_modes(write(tmp_path, content))


def test_frequencies_of_fewer_modes_than_all_else_are_what_is_refused(tmp_path):
    one = {"id": "a", "frequency_hz": [1.0], "damping_ratio": [0.01, 0.01], "shape_re": [[1, 0, 0], [0, 1, 0]]}
    content = {"channels": ["a", "b", "c"], "sets": [one]}
    with pytest.raises(InputError, match="a, frequency_hz: has 1 mode, damping_ratio, shape_re 2; give every mode"):
        read_modes(write(tmp_path, content))
    one["frequency_hz"] = [1.0, 2.0]
    assert read_modes(write(tmp_path, content)).n_mode == 2
    # one list alone is at fault, or the shapes are by channel
    for key, value, word in (("damping_ratio", [0.01], r"damping_ratio: has shape \(1,\); give \(2,\)"),
                             ("shape_re", [[1, 0], [0, 1], [0, 0]], r"has shape \(3, 2\); give \(2, 3\), a row for")):
        with pytest.raises(InputError, match=word):
            read_modes(write(tmp_path, {"channels": ["a", "b", "c"], "sets": [one | {key: value}]}))
    del one["damping_ratio"]
    with pytest.raises(InputError, match="shape_re: has shape"):
        by_channel = one | {"shape_re": [[1, 0], [0, 1], [0, 0]]}
        read_modes(write(tmp_path, {"channels": ["a", "b", "c"], "sets": [by_channel]}))


def test_a_set_without_columns_reads_beside_one_that_has_them(tmp_path):
    write_modes(data_with_factors(), tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text())
    content["sets"].append(content["sets"][0] | {"id": "mine"})
    assert read_modes(write(tmp_path, content)).sets[2].covariance_factors is None


def test_columns_read_when_asked_are_those_in_memory(tmp_path):
    data, reads = data_with_factors(), []

    def read(k):
        reads.append(k)
        return data.sets[k].covariance_factors

    stored = dataclasses.replace(data, sets=tuple(
        dataclasses.replace(s, covariance_factors=StoredFactors(read=functools.partial(read, k)))
        for k, s in enumerate(data.sets)))
    write_modes(data, tmp_path / "m.json")
    write_modes(stored, tmp_path / "s.json")
    assert (tmp_path / "m.deviations.h5").read_bytes() == (tmp_path / "s.deviations.h5").read_bytes()
    # nothing is kept: once a set for its standard deviations, once for the file
    assert sorted(reads) == sorted([*range(len(data.sets))] * 2)
    one, two = (x.of_modes([1, -1]).sets[0] for x in (data, stored))
    for name in ("ln_frequency", "damping_ratio", "shape"):
        assert np.array_equal(getattr(one.covariance_factors, name), getattr(two.covariance_factors, name),
                              equal_nan=True)
        assert np.isnan(np.moveaxis(getattr(two.covariance_factors, name), -2, 0)[1]).all()


def test_modes_json_written_set_by_set_is_that_of_the_whole(tmp_path):
    """Line breaks within words, no set, a key behind the sets."""
    rows = [{"id": "a\nb", "f": [1.0, None], "e": {}}, {"id": "ä", "f": [], "e": {"x": 0.1}}]
    for some in (rows, []):
        one, two = tmp_path / "one.json", tmp_path / "two.json"
        write_json(one, {"format": 2, "labels": ["FA1"], "sets": some, "deviations": "m.h5"})
        write_json_rows(two, {"format": 2, "labels": ["FA1"]}, "sets", iter(some), {"deviations": "m.h5"})
        assert one.read_bytes() == two.read_bytes()
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json_rows(two, {}, "sets", [{"f": np.nan}], {})
    assert one.read_bytes() == two.read_bytes() and not list(tmp_path.glob("*.part"))


def test_a_dataset_of_the_sets_is_written_and_read_by_xarray(tmp_path):
    xarray = pytest.importorskip("xarray")
    data = data_with_factors()
    sets = [dataclasses.replace(s, environment={"state": "idling", "water_level_m": 0.25 * k}
                                if k else {"state": "rated"})
            for k, s in enumerate(data.sets)]
    data = dataclasses.replace(data, sets=tuple(sets), labels=("FA1", "SS1"))
    data.to_xarray().to_netcdf(tmp_path / "modes.nc", engine="h5netcdf")
    with xarray.open_dataset(tmp_path / "modes.nc", engine="h5netcdf") as found:
        assert found.sizes == {"set": len(sets), "channel": 3, "mode": 2} and found.frequency_hz.attrs["units"] == "Hz"
        for k, s in enumerate(sets):
            one = found.sel(set=s.id)
            assert np.array_equal(one.frequency_hz, s.frequency_hz, equal_nan=True)
            assert np.array_equal(one.shape_re + 1j * one.shape_im, s.shape, equal_nan=True)
            assert str(one.state.values) == s.environment["state"]
            assert np.isnan(one.water_level_m) if k == 0 else one.water_level_m == 0.25 * k
        assert found.damping_ratio_std.sel(mode="SS1").dims == ("set",)
    with pytest.raises(InputError, match="condition channel: has the name of something else"):
        dataclasses.replace(data, sets=(dataclasses.replace(sets[0], environment={"channel": 1.0}),)).to_xarray()


def test_a_set_goes_to_another_process_and_stays_read_only():
    one = dataclasses.replace(data_with_factors().sets[0], environment={"state": "idling", "water_level_m": 0.5})
    two = pickle.loads(pickle.dumps(one))
    for name in ("frequency_hz", "frequency_std_hz", "damping_ratio_std", "shape", "shape_std"):
        assert np.array_equal(getattr(one, name), getattr(two, name), equal_nan=True)
        assert not getattr(two, name).flags.writeable
    assert dict(two.environment) == dict(one.environment)
    assert np.array_equal(one.covariance_factors.shape, two.covariance_factors.shape, equal_nan=True)
    with pytest.raises(TypeError):
        two.environment["state"] = "rated"


def test_a_plane_is_spanned_by_two_shapes_as_turned_for_the_best(validation):
    row = validation(what="how well two shapes span a plane: half of their shares and the area between them",
                     reference="half the squared sum of cosines with two directions at right angles, every half degree",
                     why="steps of half a degree")
    rng = np.random.default_rng(3)
    shape, (plane, _) = rng.standard_normal((7, 5)), np.linalg.qr(rng.standard_normal((7, 2)))
    found = criteria_within_plane(plane, shape)
    inside = plane.T @ shape / np.linalg.norm(shape, axis=0)
    angle = np.radians(np.arange(0, 360, 0.5))
    along, across = np.cos(angle)[:, None] * inside[0] + np.sin(angle)[:, None] * inside[1], \
        np.cos(angle)[:, None] * inside[1] - np.sin(angle)[:, None] * inside[0]
    best = np.max([0.5 * (along[:, :, None] + sign * across[:, None, :]) ** 2 for sign in (1, -1)], axis=(0, 1))
    row.error((found - best)[~np.eye(5, dtype=bool)], 1e-4)


def test_sets_of_a_large_file_leave_their_columns_there(tmp_path, monkeypatch):
    """The same numbers as in memory, also in another process; a file that changed since is refused."""
    write_modes(data_with_factors(), tmp_path / "m.json")
    whole = read_modes(tmp_path / "m.json")
    monkeypatch.setattr(covariance_file, "KEPT_IN_MEMORY", 0)
    data = read_modes(tmp_path / "m.json")
    for one, two in zip(whole.of_modes([1, 0]).sets, data.of_modes([1, 0]).sets, strict=True):
        assert isinstance(two.covariance_factors, StoredFactors)
        assert np.array_equal(one.frequency_std_hz, two.frequency_std_hz, equal_nan=True)
        elsewhere = pickle.loads(pickle.dumps(two.covariance_factors))
        assert np.array_equal(one.covariance_factors.shape, elsewhere.shape, equal_nan=True)
    write_modes(data_with_factors(("other",)), tmp_path / "m.json")
    with pytest.raises(InputError, match="has changed since"):
        data.sets[0].covariance_factors.load()


def test_numbered_modes_that_are_asked_for_are_compared_beside_named_ones():
    """`diagnose --modes FILE X1,9` left mode 9 out in silence."""
    one = ModalSet(id="a", frequency_hz=[1.0, 2.0, 3.0], damping_ratio=[0.01] * 3, shape=np.eye(3),
                   frequency_std_hz=[0.01] * 3, shape_std=np.full((3, 3), 0.01))
    data = ModalData(channels=("a", "b", "c"), sets=(one,), labels=("X1", "9", "10"), records=tuple(
        ModeRecord(label=label, match="alike") for label in ("X1", "9", "10")))
    assert data.compared().labels == ("X1",)
    assert data.of_labels(["X1", "9"]).compared().labels == ("X1", "9")
