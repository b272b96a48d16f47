"""Where the estimators part: verdicts, distances and words on posteriors whose answers are known."""

import json
import re
from dataclasses import fields, replace

import numpy as np
import pytest
from updating_records import PARAMETERS, gaussian_draws, posterior_of, record

from probupdate.errors import InputError
from probupdate.model.parameters import Parameters
from probupdate.updating.comparison import compare, read_comparison
from probupdate.updating.identifiability import identifiability
from probupdate.updating.update_file import ComponentsRecord


@pytest.fixture(scope="module")
def update():
    return record()


@pytest.fixture(scope="module")
def comparison(update):
    return compare(update, posterior_of(update, gaussian_draws(update)))


def row_of(comparison, name):
    return comparison.rows[comparison.names.index(name)]


def drawn(update, mean, std, n=20_000, correlation=0.0, seed=3):
    """Normal draws of all three parameters, the first two correlated, as a posterior."""
    covariance = np.diag(np.square(std))
    covariance[0, 1] = covariance[1, 0] = correlation * std[0] * std[1]
    return posterior_of(update, np.random.default_rng(seed).multivariate_normal(mean, covariance, n))


# numbers


def test_each_row_repeats_its_sources(update, comparison):
    draws = posterior_of(update, gaussian_draws(update)).draws
    for k, row in enumerate(comparison.rows):
        parameter = PARAMETERS.items[k]
        mean, std = draws[:, k].mean(), draws[:, k].std(ddof=1)
        assert (row.name, row.unit, row.initial) == (parameter.name, parameter.unit, parameter.initial)
        assert row.prior_std == pytest.approx(parameter.distribution.std())
        assert row.prior_mean == pytest.approx(parameter.distribution.mean())
        assert (row.mean, row.std, row.cov) == pytest.approx((mean, std, std / abs(mean)))
        assert (row.low, row.high) == pytest.approx(tuple(np.quantile(draws[:, k], [0.05, 0.95])))
        assert row.median == pytest.approx(np.median(draws[:, k]))
        ends = update.scheme("step").theta[-1, k], update.scheme("prior").theta[-1, k], update.map_theta[k]
        assert (row.step, row.anchored, row.map) == pytest.approx(ends)
        distances = (row.step_distance, row.anchored_distance, row.map_distance)
        assert distances == pytest.approx(tuple((end - mean) / std for end in ends), abs=1e-12)
        assert row.contraction == pytest.approx(std / parameter.distribution.std())
        assert row.resolution == pytest.approx(update.map_resolution[k])
        assert row.nine_mean == pytest.approx(update.sets.theta_map[:, k].mean())
        assert row.nine_cov == pytest.approx(update.sets.cov[k])
        assert row.total_cov == pytest.approx(update.sets.total_std[k] / abs(update.sets.theta_map[:, k].mean()))
    assert comparison.correlation == pytest.approx(np.corrcoef(draws.T))


def test_on_a_linear_problem_the_routes_meet(comparison):
    # the MAP of a Gaussian is its mean, within four standard errors of the draws; the bound of b is standard deviations
    # away
    for name in "ac":
        row = row_of(comparison, name)
        assert abs(row.map_distance) < 4 / np.sqrt(30_000) + 0.01
        assert abs(row.anchored - row.map) < 1e-4 * row.std
    assert any("anchored update ends" in note for note in comparison.notes)


# verdicts


@pytest.mark.parametrize(
    ("contraction", "verdict"),
    [(0.05, "strongly identified"), (0.47, "strongly identified"), (0.53, "weakly identified"),
     (0.87, "weakly identified"), (0.93, "keeps its prior"), (1.0, "keeps its prior")],
)
def test_verdict_by_the_share_of_the_priors_width(update, contraction, verdict):
    widths = PARAMETERS.std * [contraction, 0.3, 1.0]
    found = compare(update, drawn(update, update.map_theta, widths))
    assert row_of(found, "a").identified == verdict


def test_update_and_compare_say_the_same_by_the_same_width_and_name_where_the_widths_differ(update):
    """One scale of two widths: the Gaussian's at the MAP, the draws'."""
    own = np.sqrt(np.diag(update.map_covariance))
    alike = compare(update, drawn(update, update.map_theta, own))
    kinds = {row.name: row.identified for row in alike.rows}
    lines = update.summary.splitlines()
    assert [any(line.startswith(f"{name} ") and kind in line for line in lines) for name, kind in kinds.items()] == (
        [True] * 3)
    assert not any("as `update` has it" in note for note in alike.notes)
    wider = compare(update, drawn(update, update.map_theta, [0.7 * PARAMETERS.std[0], *own[1:]]))
    assert row_of(wider, "a").identified == "weakly identified"
    (note,) = [n for n in wider.notes if "as `update` has it" in n]
    assert note.startswith("by the Gaussian approximation at the MAP, as `update` has it, a strongly identified: ")


def test_what_the_data_do_not_inform_is_said_to_keep_its_prior(comparison):
    row = row_of(comparison, "c")
    assert row.identified == "keeps its prior" and abs(row.resolution) < 1e-6
    assert row.sentence.startswith("The data do not inform c: its posterior is ")
    assert row_of(comparison, "a").identified == "strongly identified"
    # all sets agree on what none of them knows: scatter is no uncertainty, and the notes say so
    assert row.nine_cov < 1e-6 and any("hardly scatters" in note for note in comparison.notes)


def test_the_prior_is_taken_as_its_bounds_cut_it():
    # normal(1, 1) from 0 on: standard deviation 0.794, not 1; a posterior of that width keeps its prior
    items = (replace(PARAMETERS.items[0], std=1.0, lower=0.0, upper=np.inf), *PARAMETERS.items[1:])
    update = record(parameters=Parameters(items))
    prior = update.parameters.items[0].distribution
    draws = posterior_of(update, np.column_stack([
        prior.rvs(20_000, random_state=1), *np.random.default_rng(2).normal(size=(2, 20_000)) * 0.1,
    ]))
    row = row_of(compare(update, draws), "a")
    assert row.prior_std == pytest.approx(0.794, abs=1e-3)
    assert row.contraction == pytest.approx(1.0, abs=0.02) and row.identified == "keeps its prior"


@pytest.mark.parametrize(("width", "kind"), [(1.0, "known from the diagnosis"), (0.3, "strongly identified")])
def test_a_prior_that_is_a_finding_is_said_to_be_known(width, kind):
    description = "scour: monopile; known from the diagnosis as 1.02 m from block 10 of the record on"
    assert identifiability(width, at_bound=False, unproven=False, description=description) == kind


def test_a_parameter_at_its_bound_is_pinned_in_row_sentence_and_notes():
    update = record(change=(0.05, 1.5, 0.0))
    assert update.map_at_bound.tolist() == [False, True, False]
    # mass below the bound, highest at it
    draws = gaussian_draws(record(change=(0.05, 0.3, 0.0)))
    draws[:, 1] = 2.5 - np.abs(np.random.default_rng(5).normal(size=len(draws))) * 0.1
    found = compare(update, posterior_of(update, draws))
    row = row_of(found, "b")
    assert row.flags[0] == "pinned at its upper bound at the MAP"
    assert "the density is highest at the bound while its mass lies inside" in row.sentence
    assert "pinned at a bound at the MAP: b; their results depend on those bounds" in found.notes
    assert not row_of(found, "a").flags and "b" in found.summary


def test_a_ridge_names_its_partner(update):
    found = compare(update, drawn(update, update.map_theta, PARAMETERS.std * [0.3, 0.3, 1.0], correlation=-0.97))
    for name, partner in (("a", "b"), ("b", "a")):
        assert f"absorbed by {partner}: correlation -0.97" in row_of(found, name).flags
    assert row_of(found, "c").flags == ()
    # and gives it as the reason where the top is not the middle
    std = PARAMETERS.std * [0.3, 0.3, 1.0]
    aside = np.add(update.map_theta, [0.5 * std[0], 0, 0])
    moved = compare(update, drawn(update, aside, std, correlation=-0.97))
    sentence = row_of(moved, "a").sentence
    assert "MAP and mean differ by 0.5 posterior standard deviations: the posterior is a ridge with b" in sentence


# words


def test_estimates_that_agree_are_said_to_agree(comparison):
    assert row_of(comparison, "a").sentence == "All estimates of a agree within 0.25 posterior standard deviations."


@pytest.mark.parametrize("worst", [0, 1, 2])
def test_the_notes_name_the_parameter_that_eq_7_leaves_farthest(update, worst):
    std = np.sqrt(np.diag(update.map_covariance))
    printed = update.scheme("step")
    theta = np.tile(update.map_theta, (3, 1))
    theta[-1] += std * [0.1, -0.1, 0.1]
    theta[-1, worst] -= 3 * std[worst]
    changed = replace(printed, theta=theta, distance_to_map=np.array([2.0, 0.5, 1.7]), share=np.ones(2))
    update = replace(update, schemes=(changed, update.scheme("prior")))
    found = compare(update, drawn(update, update.map_theta, std))
    name = PARAMETERS.names[worst]
    (note,) = [n for n in found.notes if n.startswith("Eq. 7 as printed")]
    assert "at iteration 1 (0.50 posterior standard deviations a parameter) and ends 1.70 away" in note
    assert f"farthest is {name}, " in note
    expected = abs(theta[-1, worst] - update.map_theta[worst]) / row_of(found, name).std
    assert note.endswith(f"{expected:.2f}")
    assert f"ends {expected:.1f} posterior standard deviations from the MAP: it penalises the step, and after 2" in (
        row_of(found, name).sentence
    )
    assert "penalises the step" not in row_of(found, PARAMETERS.names[worst - 1]).sentence


def test_a_skewed_posterior_is_the_reason_where_it_is_one(update):
    draws = gaussian_draws(update)
    std = draws[:, 0].std()
    draws[:, 0] = update.map_theta[0] + std * np.random.default_rng(4).gamma(1.5, 1.0, len(draws))
    row = row_of(compare(update, posterior_of(update, draws)), "a")
    assert row.skewness == pytest.approx(2 / np.sqrt(1.5), rel=0.1)
    assert "the posterior is skewed (+1.6)" in row.sentence or "the posterior is skewed (+1.7)" in row.sentence


def test_a_chain_that_did_not_converge_comes_first_in_the_notes(update):
    posterior = posterior_of(update, gaussian_draws(update), converged=False, verdict="NOT converged: R-hat 1.4 of b")
    found = compare(update, posterior)
    assert found.notes[0] == "NOT converged: R-hat 1.4 of b" and not found.converged


# files and mistakes


def test_everything_written_is_read_again(update, tmp_path):
    found = compare(
        replace(update, sets=None, derived={"k_xy": {"initial": 1.0, "map": float("nan")}}),
        posterior_of(update, gaussian_draws(update)), derived={"k_xy": lambda t: t[0], "zero": lambda t: 0.0},
    )
    again = read_comparison(found.write(tmp_path / "deep" / "compare.json"))
    for f in fields(found):
        a, b = getattr(found, f.name), getattr(again, f.name)
        if f.name == "correlation":
            assert np.array_equal(a, b)
        elif f.name == "rows":
            for x, y in zip(a, b, strict=True):
                for g in fields(x):
                    p, q = getattr(x, g.name), getattr(y, g.name)
                    assert p == q or (np.isnan(p) and np.isnan(q)), g.name
        elif f.name == "derived":
            assert {k: set(v) for k, v in a.items()} == {k: set(v) for k, v in b.items()}
            for k in a:
                for state in a[k]:
                    assert b[k][state] == pytest.approx(a[k][state], nan_ok=True)
        else:
            assert a == b, f.name
    assert np.isnan(again.rows[0].nine_cov)
    assert again.summary == found.summary


def test_derived_quantities_have_the_mean_and_cov_of_the_draws(update):
    draws = gaussian_draws(update)
    found = compare(update, posterior_of(update, draws), derived={"k": lambda theta: 5.0 * theta[0]})
    # of some two hundred draws
    error = 5 * draws[:, 0].std() / np.sqrt(200)
    assert found.derived["k"]["mean"] == pytest.approx(5 * draws[:, 0].mean(), abs=4 * error)
    assert found.derived["k"]["cov"] == pytest.approx(draws[:, 0].std() / draws[:, 0].mean(), rel=0.25)


def test_a_posterior_of_another_problem_is_refused(update):
    draws = gaussian_draws(update)
    with pytest.raises(InputError, match="does not fit the update: it is of the same set, and of another model of"):
        compare(update, posterior_of(update, draws, fingerprint="other"))
    with pytest.raises(InputError, match="it is of other parameters: a, b, d; the update of a, b, c"):
        compare(update, posterior_of(update, draws, fingerprint="other", names=("a", "b", "d")))


@pytest.mark.parametrize(("record", "words"), [
    ({"set_id": "9 of 9 sets", "weights": "own"}, "it is of 9 of 9 sets, the update of set {update.set_id}"),
    ({"model": "job"}, "it is of model job, the update of model {update.model}"),
    ({"weights": "paper"}, "it is of weights 'paper', the update of weights '"),
], ids=["set", "model", "weights"])
def test_what_another_posterior_is_of_is_named(update, record, words):
    other = posterior_of(update, gaussian_draws(update), fingerprint="other", record=record)
    with pytest.raises(InputError, match=re.escape(words.format(update=update))):
        compare(update, other)


def test_broken_files_are_one_line(comparison, tmp_path):
    path = comparison.write(tmp_path / "compare.json")
    good = json.loads(path.read_text())
    broken = [b"", b"{", b"[]", b"3", b"null", b"\xff\xfe\x00", b'{"format": 99}', b"{}"]
    for change in (
        {"rows": [{"name": "a"}]}, {"rows": 3}, {"correlation": [[1.0], [1.0, 2.0]]}, {"names": None},
        {"derived": [1]}, {"rows": [good["rows"][0] | {"surplus": 1}]}, {"names": ["a"]}, {"correlation": [[1.0]]},
    ):
        broken.append(json.dumps(good | change).encode())
    broken += [json.dumps({k: v for k, v in good.items() if k != key}).encode() for key in good]
    for content in broken:
        path.write_bytes(content)
        with pytest.raises(InputError) as error:
            read_comparison(path)
        assert "\n" not in str(error.value) and str(path) in str(error.value), content
    with pytest.raises(InputError, match="no such file"):
        read_comparison(tmp_path / "none.json")


def test_draws_narrower_than_the_tolerances_alone_make_them_are_not_taken_at_their_word(update):
    """A tolerance of the soil's law is a factor on its stiffness, as py is: linear about the MAP it no longer is."""
    own = np.sqrt(np.diag(update.map_covariance))
    alone = np.array([0.8, 0.1, 0.0])[None] * own
    parts = ComponentsRecord(names=("soil",), std=alone, source_names=("law",), source_std=alone, measures=(),
                             gain=np.zeros((0, 3)), responses=(), chi_square=np.zeros(0), expected=np.zeros(0))
    with_sources = replace(update, components=parts)
    for share, narrow in ((1.0, False), (0.9, False), (0.6, True)):
        found = compare(with_sources, drawn(update, update.map_theta, [share * own[0], *own[1:]]))
        said = [note for note in found.notes if note.startswith("TOO NARROW: the draws of a ")]
        assert bool(said) == narrow == ("too narrow: see the notes" in row_of(found, "a").flags)
    assert f"leave {alone[0, 0]:.2g} open" in said[0] and f"take the {own[0]:.2g} of" in said[0]
    alike = compare(update, drawn(update, update.map_theta, own))
    assert row_of(found, "a").identified == row_of(alike, "a").identified
