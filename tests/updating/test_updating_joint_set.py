"""All comparable sets as one: what it is the mean of, how certain, and which sets are not in it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, sparse
from updating_cases import (
    CHAIN_TRUTH,
    CHANNELS,
    LINEAR_HZ,
    chain_model,
    linear_data,
    linear_model,
    measured_chain,
    modal_set,
    turned,
)

from probupdate import LikelihoodSettings, update
from probupdate.errors import InputError
from probupdate.modal.modes import CovarianceFactors, ModalData, ModalSet, mac
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel
from probupdate.updating.joint_set import joint_set
from probupdate.updating.problem import Weights, build_problem


def frequency_sets(values, std, **more) -> ModalData:
    """Sets of two modes at some channels with frequencies (n_set, 2)."""
    shape = np.array([[1.0, -0.6], [0.5, 1.0], [0.2, 0.9]])
    each = tuple(replace(modal_set(f, shape, id=f"set {k}", std=np.full(2, std)), **more)
                 for k, f in enumerate(np.asarray(values, float)))
    return ModalData(channels=("a", "b", "c"), sets=each)


def test_mean_of_noisy_sets_is_as_certain_as_it_states(validation):
    rng, off = np.random.default_rng(5), []
    for _ in range(300):
        data = frequency_sets([1.0, 3.0] + 0.01 * rng.standard_normal((6, 2)), 0.01)
        one = joint_set(data).data.set()
        off.append((one.frequency_hz - [1.0, 3.0]) / one.frequency_std_hz)
    # 600 standard normal numbers: their root mean square is 1 +- 0.03, less where scatter is counted that is none
    row = validation(what="Standard deviation of the mean of six sets", reference="600 draws",
                     why="standard error of 0.03, less where scatter is counted that is none")
    row.between(float(np.sqrt(np.mean(np.square(off)))), 0.85, 1.05)


def test_scatter_beyond_what_sets_state_is_in_the_mean():
    rng = np.random.default_rng(1)
    values = np.array([1.0, 3.0]) + 0.05 * rng.standard_normal((12, 2))
    joint = joint_set(frequency_sets(values, 0.001))
    # twelve values of scatter s: the mean is known to s / sqrt(12)
    assert joint.data.set().frequency_std_hz == pytest.approx(np.std(values, axis=0, ddof=1) / np.sqrt(12), rel=0.02)
    assert any(note.startswith("frequencies scatter over these sets more") for note in joint.notes)


def test_shapes_of_any_scale_phase_and_turn_give_their_mean():
    rng, sets = np.random.default_rng(2), []
    exact = measured_chain().set()
    for k in range(5):
        shape = exact.shape
        for pair in ((0, 1), (2, 3)):
            shape = turned(shape, pair, rng.uniform(0, 6))
        sets.append(replace(exact, id=f"{k}", shape=shape * rng.uniform(0.2, 4.0) * np.exp(1j * rng.uniform(0, 6))))
    found = joint_set(ModalData(channels=CHANNELS, sets=tuple(sets))).data.set()
    for pair in ([0, 1], [2, 3]):
        plane = np.linalg.qr(np.real(exact.shape[:, pair]))[0]
        inside = plane.T @ np.real(found.shape[:, pair])
        assert np.allclose(plane @ inside, np.real(found.shape[:, pair]), atol=1e-9)
    assert abs(mac(found.shape[:, [0]], found.shape[:, [1]])[0, 0]) < 0.2


def test_joint_covariance_of_equal_sets_is_one_over_their_number():
    data, rng = frequency_sets([[1.0, 3.0]] * 9, np.nan), np.random.default_rng(3)
    factors = CovarianceFactors(ln_frequency=0.01 * rng.standard_normal((2, 7)),
                                damping_ratio=0.1 * rng.standard_normal((2, 7)),
                                shape=0.01 * rng.standard_normal((3, 2, 7)))
    data = replace(data, sets=tuple(replace(s, covariance_factors=factors) for s in data.sets))
    found = joint_set(data, covariance=True).data.set().covariance_factors.load()
    assert found.ln_frequency @ found.ln_frequency.T == pytest.approx(
        factors.ln_frequency @ factors.ln_frequency.T / 9, rel=1e-6)


def test_conditions_that_some_sets_do_not_know_are_means_of_the_others():
    """Null in modes.json, as `identify` writes where one of a pair was not measured; it ended in a traceback."""
    data = frequency_sets(np.tile([1.0, 3.0], (4, 1)), 0.01)
    known = ({"state": "idling", "a": None, "b": 0.5}, {"state": "idling", "a": None, "b": None},
             {"state": "idling", "a": None, "b": 1.0}, {"state": "idling"})
    data = replace(data, sets=tuple(replace(s, environment=e) for s, e in zip(data.sets, known, strict=True)))
    assert dict(joint_set(data).data.set().environment) == {"state": "idling", "b": 0.75}


@pytest.mark.parametrize(("environment", "words"), (
    ({"state": "rated"}, "1 sets are in other conditions than state idling"),
    ({"state": "idling", "nacelle_angle_deg": 90.0}, "in 1 sets the nacelle's heading differs from 0 deg"),
))
def test_sets_in_other_conditions_are_left_out_and_said(environment, words):
    data = frequency_sets([[1.0, 3.0]] * 4 + [[1.2, 3.3]], 0.01,
                          environment={"state": "idling", "nacelle_angle_deg": 0.0})
    other = replace(data.sets[4], environment={"nacelle_angle_deg": 0.0} | environment)
    joint = joint_set(replace(data, sets=(*data.sets[:4], other)))
    assert joint.ids == tuple(f"set {k}" for k in range(4))
    assert joint.data.set().frequency_hz == pytest.approx([1.0, 3.0])
    assert any(note.startswith(words) for note in joint.notes)


def test_sets_that_agree_to_the_last_digit_share_its_rounding():
    values = np.round(np.array([1.23, 3.04]) + 0.0005 * np.random.default_rng(3).standard_normal((9, 2)), 2)
    # uniform over half a hundredth to both sides, however many sets there are
    assert joint_set(frequency_sets(values, np.nan)).data.set().frequency_std_hz == pytest.approx(0.01 / np.sqrt(12))


def test_an_outlying_set_is_left_out_and_said():
    values = np.array([1.0, 3.0]) + 0.003 * np.random.default_rng(4).standard_normal((8, 2))
    values[5, 0] = 1.2
    joint = joint_set(frequency_sets(values, 0.003))
    assert "set 5" not in joint.ids and len(joint.ids) == 7
    assert any("set 5 is an outlier" in note for note in joint.notes)


def test_maximum_is_that_of_all_sets_likelihoods_together(validation):
    model, weights, rng = linear_model(), Weights(shapes="none"), np.random.default_rng(8)
    data = linear_data(LINEAR_HZ * (1 + 0.02 * rng.standard_normal((6, len(LINEAR_HZ)))), cov=0.02)
    problems = [build_problem(model, data, set_id=s.id, weights=weights) for s in data.sets]

    def against(theta):
        return -float(sum(p.log_likelihood(theta)[0] for p in problems) + model.parameters.log_density(theta))

    found = optimize.minimize(against, model.parameters.initial, method="Nelder-Mead",
                              options={"xatol": 1e-7, "fatol": 1e-10, "maxiter": 20_000}).x
    record = update(model, data, likelihood=LikelihoodSettings(weights=weights, discrepancy=0.0))
    apart = np.abs(record.map_theta - found) / np.sqrt(np.diag(record.map_covariance))
    # sets scatter as they state, so that weights are nearly the stated ones
    row = validation(what="Maximum of the posterior of six sets as one", unit="posterior standard deviations",
                     reference="simplex search on the product of the sets' likelihoods",
                     why="weights by the scatter differ from the stated ones by chance")
    row.error(float(apart.max()), 0.2)


def test_update_says_of_how_many_sets_it_is_and_one_is_a_choice():
    sets = tuple(replace(measured_chain(noise=0.004, seed=k).set(), id=f"b{k}") for k in range(4))
    data = ModalData(channels=CHANNELS, sets=sets)
    record = update(chain_model(), data)
    assert record.set_id == "4 of 4 sets"
    assert record.summary.splitlines()[0].startswith("results of 4 of 4 sets together")
    off = np.abs(record.map_theta - CHAIN_TRUTH) / np.sqrt(np.diag(record.map_covariance))
    assert off.max() < 3.5
    alone = update(chain_model(), data, set_id="b2")
    assert alone.set_id == "b2" and alone.summary.startswith("results of set b2 alone, one of 4")
    with pytest.raises(InputError, match="there is none of that id"):
        update(chain_model(), data, set_id="b9")


def test_a_mode_that_is_measured_is_not_to_be_measured_next():
    """The third and fourth mode are in the file, and the first two are compared alone."""
    data = replace(measured_chain(noise=0.004, seed=1), labels=("1", "2", "3", "4"))
    alone = LikelihoodSettings(modes=("1", "2"))
    said, free = (update(chain_model(), d, likelihood=taken).components.measures
                  for d, taken in ((data, alone), (data.of_modes([0, 1]), LikelihoodSettings())))

    def near(measures) -> bool:
        named = [float(x) for m in measures for x in re.findall("the model's mode at ([0-9.]+) Hz", m)]
        return any(abs(x / f - 1) < 0.1 for x in named for f in data.set().frequency_hz[2:])

    # without the others in the file the third is what to measure
    assert near(free) and not near(said)


@pytest.mark.parametrize(("share", "named"), [(1.0, ["1.5"]), (0.05, [])])
def test_a_mode_that_the_sensors_hardly_see_is_not_to_be_measured_next(share, named):
    """Four masses by themselves, the third of which moves its channel by that share of its own motion."""
    square = (2 * np.pi * np.array([1.0, 1.2, 1.5, 1.8])) ** 2
    first, last = (sparse.csc_array(np.diag(square * one)) for one in ([1, 1, 0, 0], [0, 0, 1, 1]))
    model = AffineModel(
        name="masses", parameters=Parameters((Parameter(name="a", unit="-", initial=1.0, std=0.1),
                                              Parameter(name="b", unit="-", initial=1.0, std=0.1))),
        channels=("1", "2", "3", "4"), stiffness=(first, last), mass=(sparse.csc_array(np.eye(4)),),
        coefficients=lambda theta: (theta, np.ones_like(theta[..., :1])),
        channel_matrix=sparse.csr_array(np.diag([1.0, 1.0, share, 1.0])), hash_key=f"masses {share}")
    data = ModalData(channels=model.channels, labels=("1", "2"), sets=(
        ModalSet(id="0", frequency_hz=np.array([1.0, 1.2]), damping_ratio=np.full(2, 0.01), shape=np.eye(4)[:, :2],
                 frequency_std_hz=np.full(2, 0.001), shape_std=np.full((4, 2), 0.01)),))
    measures = update(model, data, likelihood=LikelihoodSettings(shapes="none")).components.measures
    assert sorted(x for m in measures for x in re.findall("the model's mode at ([0-9.]+) Hz", m)) == named


def test_a_parameter_about_zero_has_no_cov_over_sets():
    from probupdate.updating.set_wise_updates import SetScatter

    one = np.ones((3, len(CHAIN_TRUTH)))
    theta = one * [1.0, 1.0, 1.0, 0.001] + 0.02 * np.arange(-1, 2)[:, None]
    scatter = SetScatter(ids=("a", "b", "c"), theta_map=theta, theta_step=theta, iterations=1, variance=one,
                         resolution=one, derived={}, failed=(), parameters=chain_model().parameters)
    assert scatter.cov[:3] == pytest.approx(0.02) and np.isnan(scatter.cov[3])


def test_scatter_stands_where_no_set_states_a_standard_deviation():
    values = np.array([1.0, 3.0]) + 0.01 * np.random.default_rng(9).standard_normal((10, 2))
    joint = joint_set(frequency_sets(values, np.nan))
    assert joint.data.set().frequency_std_hz == pytest.approx(np.std(values, axis=0, ddof=1) / np.sqrt(10))
    assert any("by the sets' scatter, as not every set states them" in note for note in joint.notes)
    few = joint_set(frequency_sets(values[:3], np.nan))
    assert np.isnan(few.data.set().frequency_std_hz).all()


def test_a_mode_that_one_set_lacks_is_the_others_mean():
    values = np.array([[1.0, 3.0], [1.02, 3.0], [1.04, np.nan]])
    data = frequency_sets(values, 0.02)
    lacking = replace(data.sets[2], frequency_std_hz=[0.02, np.nan])
    one = joint_set(replace(data, sets=(*data.sets[:2], lacking))).data.set()
    assert one.frequency_hz == pytest.approx([1.02, 3.0])
    assert one.frequency_std_hz == pytest.approx([0.02 / np.sqrt(3), 0.02 / np.sqrt(2)])
