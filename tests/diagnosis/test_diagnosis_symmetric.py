"""A frame as stiff in x as in y, and records of few sets, of frequencies alone, of one channel: from other
equations."""

from dataclasses import replace

import numpy as np
import pytest

import probupdate
from probupdate.diagnosis.blocks import gather, pairs_of
from probupdate.diagnosis.diagnose import FARTHEST
from probupdate.diagnosis.search import SENSIBLE
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, ModalSet, write_modes
from probupdate.structure.eigen import mode_derivatives

N_STOREY, STIFFNESS, MASS = 6, 2.0e8, 1.0e5
CHANNELS = tuple(f"{axis}{i + 1}" for i in range(N_STOREY) for axis in "xy")
FREQUENCY_STD, SHAPE_STD = 1e-3, 5e-3


def chain(factor):
    """(6, 6) of one shear chain with these factors on its storeys."""
    k = STIFFNESS * np.append(np.asarray(factor, float), 0.0)
    return np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)


def frame(factor_x, factor_y):
    K = np.zeros((2 * N_STOREY, 2 * N_STOREY))
    K[::2, ::2], K[1::2, 1::2] = chain(factor_x), chain(factor_y)
    return K


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """model.npz with a stiffness for each storey and axis, x and y equal to the last digit; its parameters.toml."""
    folder, zero = tmp_path_factory.mktemp("symmetric"), np.zeros(N_STOREY)
    arrays = {"K0": frame(zero, zero), "M0": MASS * np.eye(2 * N_STOREY), "channel": np.array(CHANNELS),
              "channel_dof": np.arange(2 * N_STOREY)}
    tables = []
    for name in CHANNELS:
        one = np.eye(N_STOREY)[int(name[1]) - 1]
        arrays[f"K_k{name}"] = frame(one, zero) if name[0] == "x" else frame(zero, one)
        tables.append(
            f'[[parameter]]\nname = "k{name}"\nunit = "-"\ninitial = 1.0\nstd = 0.3\nlower = 0.05\nupper = 12.0\n'
        )
    np.savez(folder / "model.npz", **arrays)
    (folder / "parameters.toml").write_text("".join(tables))
    return folder / "model.npz"


def record(seed, *, storey_y1=1.0, n_set=24, n_mode=6, channels=range(2 * N_STOREY), shapes=True):
    """Sets of a frame whose stiffnesses scatter by 1 %, with noise as stated; modes that the channels show."""
    rng, channels = np.random.default_rng(seed), list(channels)
    scatter = 1 + 0.01 * rng.standard_normal((2, N_STOREY))
    scatter[1, 0] *= storey_y1
    value, phi = np.linalg.eigh(frame(*scatter) / MASS)
    phi = phi / np.abs(phi).max(axis=0)
    seen = [j for j in range(n_mode) if np.abs(phi[channels, j]).max() > 0.05]
    f, phi = np.sqrt(value[seen]) / (2 * np.pi), phi[np.ix_(channels, seen)]
    sets = []
    for k in range(n_set):
        noisy = phi + SHAPE_STD * rng.standard_normal(phi.shape)
        sets.append(ModalSet(
            id=str(np.datetime64("2026-01-01T00:00:00") + np.timedelta64(30 * k, "m")),
            frequency_hz=f * (1 + FREQUENCY_STD * rng.standard_normal(len(f))), damping_ratio=np.full(len(f), 0.01),
            shape=noisy.astype(complex) if shapes else np.full(phi.shape, np.nan),
            frequency_std_hz=FREQUENCY_STD * f,
            shape_std=np.full(phi.shape, SHAPE_STD if shapes else np.nan),
        ))
    return ModalData(channels=tuple(CHANNELS[k] for k in channels), sets=tuple(sets))


def found_in(model, data, **how):
    return probupdate.diagnose(model, data, parameters=model.parent / "parameters.toml", extend=False, **how)


@pytest.mark.parametrize(("seed", "n_mode"), [
    (11, 6), pytest.param(12, 12, marks=pytest.mark.long),
], ids=["half of the modes", "all modes"])
def test_a_storey_braced_one_way_is_named_on_a_model_equal_both_ways(model, seed, n_mode, validation):
    row = validation(what="six storeys equal in x and y, storey 1 in y eight times as stiff, half of its modes "
                          "(long: all): verdict, cause, place, time profile; size in its standard deviations, its "
                          "standard deviation; threshold of z", reference="what was hidden, +7")
    found = found_in(model, record(seed, storey_y1=8.0, n_mode=n_mode))
    (one,) = found.findings
    row.equal((found.verdict, one.cause, one.location, one.time_profile), ("named", "parameter", "ky1", "constant"),
              "name")
    row.error((one.size - 7) / one.size_std, 3, "size")
    row.error(one.size_std, 1.5, "its standard deviation")
    row.error(found.threshold, SENSIBLE, "threshold")
    assert set(found.inputs["model"]) == {"model.npz", "parameters.toml"} and not found.inputs["modes"]


def test_nothing_is_found_on_a_model_equal_both_ways(model, validation):
    row = validation(what="the same frame with nothing hidden, ten records (of 60 more by hand 59): threshold of z; "
                          "silent", reference="none", why="of alarms in 5 % three come up with a probability of 0.012")
    found = [found_in(model, record(seed)) for seed in range(21, 31)]
    row.error([f.threshold for f in found], SENSIBLE, "threshold")
    # of alarms in 5 % of records, three or more of ten have a probability of 0.012
    row.count(sum(f.verdict == "none" for f in found), 10, 8, "silent")


def test_a_fit_bent_far_from_its_priors_names_nothing(model):
    """Six sensors one way, one mode far above its place: no cause but a storey does it, and no fit gets there."""
    found = found_in(model, record(1, storey_y1=8.0, n_mode=12, channels=range(1, 12, 2)))
    shifted = max(abs(p["prior_shift_after"]) for p in found.parameters)
    right = [(f.cause, f.location) for f in found.findings] == [("parameter", "ky1")]
    assert right or (found.verdict == "unexplained" and not found.findings)
    assert right or shifted > FARTHEST


@pytest.mark.parametrize("n_mode", [4, 6])
def test_one_way_sensors_see_what_is_one_way(model, n_mode, validation):
    """The computed mate is across all sensors, the measured one not there."""
    row = validation(what="sensors along the storey's change, and across it: cause and place; verdict",
                     reference="what was hidden; none")
    found = found_in(model, record(3, storey_y1=8.0, n_mode=n_mode, channels=range(1, 12, 2)))
    row.equal([(f.cause, f.location) for f in found.findings], [("parameter", "ky1")])
    row.equal(found_in(model, record(4, storey_y1=8.0, channels=range(0, 12, 2))).verdict, "none")


def test_a_mode_whose_mate_was_not_measured(model, validation):
    """Both ways are seen, one mode of the first pair was not identified in any set."""
    row = validation(what="a pair of which one mode was not identified, a storey and nothing hidden: cause and place; "
                          "verdict", reference="what was hidden; none")
    data = record(5)
    row.equal(found_in(model, data.of_modes([0, 2, 3, 4, 5])).verdict, "none")
    data = record(6, storey_y1=8.0).of_modes([1, 2, 3, 4, 5])
    row.equal([(f.cause, f.location) for f in found_in(model, data).findings], [("parameter", "ky1")])


def before_and_after(seed, **how):
    before, after = record(seed, n_set=1, **how), record(seed, n_set=1, storey_y1=8.0, **how)
    return replace(after, sets=(replace(before.sets[0], id="2025-01-01T00:00:00"), *after.sets))


def test_a_reference_and_a_present_state(model, validation):
    row = validation(what="a reference and a present state: cause, place, time profile", reference="what was hidden")
    found = found_in(model, before_and_after(7))
    row.equal([(f.cause, f.location, f.time_profile) for f in found.findings], [("parameter", "ky1", "step")])
    assert any("2 sets show too little scatter" in note for note in found.notes)


def test_two_equal_states_are_silent(model):
    data = record(8, n_set=2)
    assert (
        found_in(model, data).verdict == "none" and found_in(model, replace(data, sets=data.sets[:1])).verdict == "none"
    )


@pytest.fixture(scope="module")
def frequencies_of_two_states(model):
    return found_in(model, before_and_after(9, shapes=False))


def test_frequencies_before_and_after(model, frequencies_of_two_states, validation):
    """Either of two equal modes may be the one that moved: x and y are equally probable."""
    row = validation(what="frequencies alone of two states of a frame equal in x and y, a storey of y and nothing "
                          "hidden: cause, time profile, places; verdict",
                     reference="what was hidden, along x or y; none")
    found = frequencies_of_two_states
    (one,) = found.findings
    places = {one.location, *(a.location for a in one.alternatives)}
    row.equal((found.verdict, one.cause, one.time_profile, places), ("ambiguous", "parameter", "step", {"kx1", "ky1"}))
    assert 0.4 < one.posterior_probability < 0.6
    assert any("frequencies alone" in note for note in found.notes)
    row.equal(found_in(model, record(9, n_set=2, shapes=False)).verdict, "none")


def test_one_channel_of_many_sets_and_of_two(model, validation):
    row = validation(what="one channel, two states with a storey and many sets with nothing hidden: cause and time "
                          "profile; verdict", reference="what was hidden; none")
    row.equal(found_in(model, record(10, channels=[11])).verdict, "none")
    found = found_in(model, before_and_after(10, channels=[11]))
    row.equal([(f.cause, f.time_profile) for f in found.findings], [("parameter", "step")])


def test_few_sets_without_deviations_are_refused(model):
    data = record(2, n_set=3)
    silent = tuple(replace(s, frequency_std_hz=np.full(s.frequency_hz.shape, np.nan)) for s in data.sets)
    with pytest.raises(InputError, match="3 usable sets of 3.*frequency_std_hz"):
        found_in(model, replace(data, sets=silent))


def test_groups_are_those_close_in_the_record_or_in_the_model():
    data = record(1, storey_y1=8.0)
    names = tuple(f"mode {j + 1}" for j in range(data.n_mode))
    assert all(len(g) == 1 for g in gather(data).groups)
    equal = dict(zip(names, (1.7, 1.7, 5.0, 5.0, 8.0, 8.0), strict=True))
    assert gather(data, expected_hz=equal).groups == ((0, 1), (2, 3), (4, 5))
    left = gather(data, expected_hz={n: f for n, f in equal.items() if n != "mode 6"})
    assert left.groups == ((0, 1), (2, 3), (4,)) and any("mode 6 left out" in note for note in left.notes)


def test_a_run_is_cut_at_its_longest_link():
    apart = np.abs(np.subtract.outer([0.0, 0.01, 0.05, 0.06], [0.0, 0.01, 0.05, 0.06]))
    assert sorted(pairs_of((0, 1, 2, 3), apart, ("a", "b", "c", "d"))) == [(0, 1), (2, 3)]


def test_frequencies_alone_through_update_and_report(model, frequencies_of_two_states, tmp_path):
    data = before_and_after(9, shapes=False)
    for name in ("model.npz", "parameters.toml"):
        (tmp_path / name).write_bytes((model.parent / name).read_bytes())
    (tmp_path / "run.json").write_text('{"parameters": "parameters.toml"}')
    write_modes(data, tmp_path / "modes.json")
    options = {"parameters": tmp_path / "parameters.toml"}
    record = probupdate.update(tmp_path / "model.npz", tmp_path / "modes.json", set_id=data.sets[0].id,
                               likelihood=probupdate.LikelihoodSettings(shapes="none"), **options)
    measured = data.sets[0].frequency_hz
    assert record.map_hz == pytest.approx(measured, rel=5 * FREQUENCY_STD)
    assert any("paired by frequency alone" in text for text in record.left_out)
    # without channels too, as the format has it
    bare = tuple(replace(s, shape=s.shape[:0], shape_std=s.shape_std[:0]) for s in data.sets)
    write_modes(replace(data, channels=(), sets=bare), tmp_path / "bare.json")
    again = probupdate.update(tmp_path / "model.npz", tmp_path / "bare.json", set_id=bare[0].id,
                              likelihood=probupdate.LikelihoodSettings(shapes="none"), **options)
    assert np.allclose(again.map_theta, record.map_theta, rtol=1e-9)
    with pytest.raises(InputError, match="--shapes none"):
        probupdate.update(tmp_path / "model.npz", tmp_path / "modes.json", **options)
    frequencies_of_two_states.write(tmp_path / "diagnosis.json")
    page = probupdate.report(tmp_path, tmp_path / "report.html")
    assert "frequencies alone" in page.path.read_text()


def test_derivatives_of_equal_modes_are_finite_and_right_across_them():
    """Two equal chains: what is across both modes is that of one chain by finite differences."""
    K, M, factor = frame(np.ones(N_STOREY), np.ones(N_STOREY)), MASS * np.eye(2 * N_STOREY), np.eye(N_STOREY)[2]
    value, phi = np.linalg.eigh(K / MASS)
    phi = phi / np.sqrt(MASS)
    dK = frame(factor, factor)
    d_value, d_phi = mode_derivatives(K, M, value, phi[:, :4], np.stack([dK @ phi[:, :4]], 2), np.zeros((12, 4, 1)), ())
    step = 1e-5
    up, down = (np.linalg.eigvalsh(frame(1 + s * factor, 1 + s * factor) / MASS)[:4] for s in (step, -step))
    assert d_value[:, 0] == pytest.approx((up - down) / (2 * step), rel=1e-6)
    assert np.all(np.isfinite(d_phi)) and np.abs(d_phi).max() < 10 * np.abs(phi).max()


def test_derivatives_of_a_mode_whose_equal_one_was_not_asked_for_are_those_beside_it(validation):
    """Three modes of two equal chains: the third one's equations have many solutions, of which one was taken, with a
    warning of scipy's."""
    row = validation(what="derivatives of the third mode of two equal chains, of three modes asked for",
                     reference="of four, without the turn into the fourth", why="rounding times condition")
    K, M, factor = frame(np.ones(N_STOREY), np.ones(N_STOREY)), MASS * np.eye(2 * N_STOREY), np.eye(N_STOREY)[2]
    value, phi = np.linalg.eigh(K / MASS)
    phi, dK = phi / np.sqrt(MASS), frame(factor, factor)
    three, four = (mode_derivatives(K, M, value[:n], phi[:, :n], np.stack([dK @ phi[:, :n]], 2),
                                    np.zeros((2 * N_STOREY, n, 1)), ()) for n in (3, 4))
    row.error(three[0] / four[0][:3] - 1, 1e-12, "eigenvalues")
    row.error((three[1] - four[1][:, :3]) / np.abs(four[1]).max(), 1e-9, "shapes")
