"""Whole diagnoses of a model made of matrices: what is hidden is named, what is not there is not."""

import json
from dataclasses import replace

import numpy as np
import pytest

import probupdate
from probupdate.diagnosis import wording
from probupdate.diagnosis.crosstalk import crosstalk_effects
from probupdate.diagnosis.departures import numbers_of_modes
from probupdate.diagnosis.diagnose import NOT_SETTLED, beside_the_last, examine, finding, refit
from probupdate.diagnosis.evidence import only_promised, ranked, rival_of, sizes_std
from probupdate.diagnosis.expected import all_departures, local_at
from probupdate.diagnosis.field import effect_fingerprints, observed
from probupdate.diagnosis.fitting import fit, linearised
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.search import search
from probupdate.diagnosis.setting import Named, settle
from probupdate.effects.catalogue import measurement_effects
from probupdate.errors import InputError
from probupdate.estimators.ensemble import SamplerSettings
from probupdate.modes import Sensor

# a chain of one segment: same seed, same numbers, converged or not
QUICK = SamplerSettings(seed=7, target_ess=50, max_steps=200)


@pytest.fixture(scope="module")
def prepared(frame_file):
    return prepare(frame_file, groups={"lower storeys": {"k1": 0.1, "k2": 0.1}})


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_hidden_nothing_named(prepared, record, seed):
    found = probupdate.diagnose(prepared, record(seed), seed=seed)
    assert found.verdict == "none" and not found.findings and found.p_value > 0.05
    assert any(x.cause == "sensor gain" and np.isfinite(x.limit) for x in found.limits)


def test_a_storey_that_loosens_half_way_is_named_with_its_size_and_time(prepared, record):
    found = probupdate.diagnose(prepared, record(4, storey=2, factor=0.9, from_block=20), sampler=False)
    assert found.verdict == "named"
    (one,) = found.findings
    assert (one.cause, one.location, one.course) == ("parameter", "k3", "step")
    # k3 itself is drawn with 2 % about 1
    assert one.size == pytest.approx(-0.1, abs=0.006 + 3 * one.size_std)
    assert one.course_start.startswith("2020-01-06")


def test_a_wrong_gain_is_named_with_its_channel(prepared, record):
    found = probupdate.diagnose(prepared, record(5, gain=("y4", 1.12)), sampler=False)
    assert found.verdict == "named" and [f.kind for f in found.findings] == ["measurement"]
    (one,) = found.findings
    assert (one.cause, one.location) == ("sensor gain", "y4")
    # the tolerance of 1 % and the floor of 1 % of a shape's largest component on each of four shapes
    assert one.size == pytest.approx(0.12, abs=3 * one.size_std) and one.size_std < 0.03


@pytest.mark.parametrize("channels", [slice(None, None, -1), slice(2, None)], ids=["the other way round", "two fewer"])
def test_a_record_s_channels_need_not_be_those_of_the_model(prepared, record, channels):
    data = record(5, gain=("y4", 1.12))
    sets = tuple(replace(s, shape=s.shape[channels], shape_std=s.shape_std[channels]) for s in data.sets)
    found = probupdate.diagnose(prepared, replace(data, channels=data.channels[channels], sets=sets), sampler=False)
    (one,) = found.findings
    assert (found.verdict, one.cause, one.location) == ("named", "sensor gain", "y4")
    assert one.size == pytest.approx(0.12, abs=3 * one.size_std)


def test_mass_of_a_storey_that_is_in_no_catalogue_is_not_named(prepared, record):
    found = probupdate.diagnose(prepared, record(6, mass=(4, 1.6)), sampler=False)
    assert found.verdict in ("unexplained", "none", "ambiguous")


def test_a_fit_that_does_not_settle_is_unexplained_and_costs_nothing_found(prepared, record, monkeypatch):
    from probupdate.diagnosis import diagnose as module
    from probupdate.errors import ConvergenceError

    whole = module.fit

    def unsettled(setting, theta, named=(), **how):
        if named and not how:
            raise ConvergenceError("did not settle", theta)
        return whole(setting, theta, named, **how)

    monkeypatch.setattr(module, "fit", unsettled)
    found = module.diagnose(prepared, record(5, gain=("y4", 1.12)))
    assert found.verdict == "unexplained" and found.details["nearest"] == ["sensor gain, y4"]
    assert any("did not settle" in note for note in found.notes)


def test_a_fit_that_runs_out_of_steps_is_unexplained_and_not_an_error(prepared, record, monkeypatch):
    from probupdate.diagnosis import fitting

    monkeypatch.setattr(fitting, "MOST_STEPS", 1)
    outcome = examine(prepared, record(5, gain=("y4", 1.12)))
    assert not outcome.fitted.settled and outcome.fitted.steps == 1
    assert outcome.diagnosis.verdict == "unexplained" and not outcome.diagnosis.findings
    assert NOT_SETTLED in outcome.diagnosis.notes


def test_a_size_at_the_end_of_what_its_row_allows_is_said(prepared, record):
    found = probupdate.diagnose(prepared, record(5, storey=2, factor=0.08), sampler=False)
    (note,) = [note for note in found.notes if "stands at an end" in note]
    assert note.startswith("the size of parameter, k3") and "-0.8 to 1" in note


@pytest.mark.parametrize(("channel", "factor"), [("y4", 0.1), ("y4", 0.5), ("y4", 2.0), ("x5", 3.0), ("y2", 9.81)])
def test_a_gain_that_is_grossly_wrong_is_named_and_not_taken_for_a_reversed_channel(prepared, record, channel, factor):
    found = probupdate.diagnose(prepared, record(7, gain=(channel, factor)), sampler=False)
    assert found.verdict == "named"
    (one,) = found.findings
    assert (one.cause, one.location) == ("sensor gain", channel)
    assert one.size == pytest.approx(factor - 1, abs=3 * one.size_std)
    # a tenth of a fingerprint is not known; beyond that a gain is known well
    assert one.size_std < 0.15 * abs(factor - 1)
    (known,) = found.extension["joint"]["findings"]
    assert known["identified"] and known["share_of_prior_std"] < 0.1


@pytest.mark.parametrize("factor", [0.5, 2.0, 9.81])
def test_a_fit_ends_where_it_ends_from_wherever_it_starts(prepared, record, factor):
    setting, theta = settle(prepared, record(7, gain=("y2", factor)))
    (gain,) = [e for e in setting.effects if (e.cause, e.location) == ("sensor gain", "y2")]
    constant = next(c for c in setting.courses if c.kind == "constant")
    for share in (0.6, 1.0, 1.5):
        fitted = fit(setting, theta, (Named(effect=gain, course=constant, size=share * (factor - 1)),))
        (std,) = sizes_std(setting, fitted)
        assert fitted.settled and fitted.named[0].size == pytest.approx(factor - 1, abs=1.5 * std)


@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 9.81])
def test_a_gain_that_is_there_already_changes_by_its_size_and_not_on_top_of_itself(prepared, record, factor):
    """Against departures of modes that are measured with a little more of it, and with another channel's on top."""
    setting, theta = settle(prepared, record(1))
    local, _ = local_at(setting.field, theta, (), ())
    own, other = (next(e for e in setting.effects if (e.cause, e.location) == ("sensor gain", c)) for c in ("y2", "x3"))
    seen, h = [(own, factor - 1)], 1e-4
    for axes, reference in zip(setting.field.axes, setting.field.references(local, 0.0), strict=True):
        k = len(reference.tensor)
        value, turn = np.linalg.eigh(reference.tensor)

        def departs(effects, reference=reference, axes=axes, value=value, turn=turn):
            measured = observed(reference, effects).shape @ turn
            return numbers_of_modes(np.exp(value)[None], measured[None], axes)[0][0]

        none = np.zeros((k, k, 0)), np.zeros((*reference.shape.shape, 0))
        prints = effect_fingerprints([own, other], (), reference, *none, axes, seen)
        for column, more in enumerate((lambda d: [(own, factor - 1 + d)], lambda d: [*seen, (other, d)])):
            plain = (departs(more(h)) - departs(more(-h))) / (2 * h)
            np.testing.assert_allclose(prints[:, column], plain, atol=1e-5 * np.abs(plain).max() + 1e-9)


def test_an_effect_that_can_be_on_the_other_side_only_is_no_rival(prepared, record):
    outcome = examine(prepared, record(5, gain=("y4", 1.12)))
    setting = outcome.setting
    (j,) = [j for j, e in enumerate(setting.effects) if (e.cause, e.location) == ("sensor gain", "y4")]
    (candidate,) = [k for k, (i, c) in enumerate(setting.which) if i == j and setting.courses[c].kind == "constant"]
    assert refit(setting, outcome.null, outcome.first, candidate).size == pytest.approx(0.12, abs=0.05)
    lossy = replace(setting.effects[j], upper=0.0)
    only = replace(setting, effects=(*setting.effects[:j], lossy, *setting.effects[j + 1 :]))
    assert refit(only, outcome.null, outcome.first, candidate) is None


def test_a_first_choice_that_the_second_finding_makes_worse_gives_way(prepared, record):
    """Two effects; the first search's second best is put where the best was, as if it had looked better alone."""
    outcome = examine(prepared, record(4, storey=2, factor=0.9, from_block=20, gain=("y4", 1.12)))
    setting, first = outcome.setting, outcome.first
    assert {f.location for f in outcome.diagnosis.findings} == {"k3", "y4"}

    def chosen(base, found, location):
        (j,) = [j for j, e in enumerate(setting.effects) if e.location == location and e.cause in (
            "parameter", "sensor gain")]
        rows = np.flatnonzero(setting.which[:, 0] == j)
        return refit(setting, base, found, int(rows[np.argmax(found.statistic[rows])]))

    wrong, right = chosen(outcome.null, first, "k4"), chosen(outcome.null, first, "k3")
    second = search(setting, wrong.fitted, seed=1)
    gain = chosen(wrong.fitted, second, "y4")
    findings = [finding(setting, first, [wrong, right]), finding(setting, second, [gain])]
    fitted, rivals, findings = beside_the_last(
        setting, gain.fitted, [first, second], [[wrong, right], [gain]], findings)
    assert [f.location for f in findings] == ["k3", "y4"] and [n.effect.location for n in fitted.named] == ["k3", "y4"]
    assert rivals[0][0].candidate == right.candidate
    assert findings[0].size == pytest.approx(-0.1, abs=0.03)
    # what stays is not touched
    again, _, same = beside_the_last(setting, fitted, [first, second], rivals, findings)
    assert again is fitted and [f.location for f in same] == ["k3", "y4"]


def test_same_seed_same_numbers_and_a_file_as_agreed(prepared, record, tmp_path):
    data = record(4, storey=2, factor=0.9, from_block=20)
    first, again = (probupdate.diagnose(prepared, data, seed=7, sampler=QUICK).content() for _ in range(2))
    assert first == again
    (path,) = probupdate.diagnose(prepared, data, seed=7, sampler=QUICK).write(tmp_path / "diagnosis.json")
    content = json.loads(path.read_text())
    assert content["verdict"] in ("named", "ambiguous", "unexplained", "none")
    for one in content["findings"]:
        assert {"kind", "cause", "location", "size", "size_std", "unit", "posterior_probability", "alternatives",
                "gain"} <= set(one)  # fmt: skip


def test_a_handful_of_sets_is_refused(prepared, record):
    data = record(1)
    turning = [replace(s, environment={**s.environment, "nacelle_heading_deg_range": 9.0}) for s in data.sets[5:9]]
    few = type(data)(channels=data.channels, sets=(*data.sets[:5], *turning))
    with pytest.raises(InputError, match="5 usable sets of 9; in 4 the nacelle turned"):
        probupdate.diagnose(prepared, few)


def test_a_group_of_an_unknown_parameter_is_refused(frame_file):
    with pytest.raises(InputError, match="k9"):
        prepare(frame_file, groups={"lost": {"k9": 0.1}})


def test_rivals_are_compared_about_the_same_parameters(prepared, record):
    """What a fit's own parameters do to evidence says nothing about its effect: the same effect twice, the second
    with another evidence of its own, is as probable; and what differs is the misfit about the same point."""
    setting, theta = settle(prepared, record(4, storey=2, factor=0.9, from_block=18))
    effects = {(e.cause, e.location): j for j, e in enumerate(setting.effects)}
    step = next(k for k, c in enumerate(setting.courses) if c.kind == "step" and c.at == 18)

    def candidate(*name):
        j = effects[name]
        (k,) = np.flatnonzero((setting.which == (j, step)).all(axis=1))
        return int(k), Named(effect=setting.effects[j], course=setting.courses[step], size=-0.05)

    (k3, loose), (k4, other) = candidate("parameter", "k3"), candidate("parameter", "k4")
    fitted = fit(setting, theta, (loose,))
    own = rival_of(setting, k3, fitted)
    again = replace(own, candidate=k4, log_evidence=own.log_evidence - 15.0)
    first, second = ranked(setting, [own, again])
    assert second.log_evidence == pytest.approx(first.log_evidence, abs=1e-6)
    # a real rival stays behind by what it leaves
    worse = rival_of(setting, k4, fit(setting, theta, (other,), base=fitted))
    near = replace(worse, log_evidence=own.log_evidence - 1.0)
    assert ranked(setting, [own, near])[1].log_evidence < own.log_evidence - 10


def test_what_a_stalled_fit_only_promises_is_no_evidence(prepared, record):
    setting, theta = settle(prepared, record(4, storey=2, factor=0.9, from_block=18))
    effect = next(e for e in setting.effects if (e.cause, e.location) == ("parameter", "k3"))
    course = next(c for c in setting.courses if c.kind == "step" and c.at == 18)
    fitted = fit(setting, theta, (Named(effect=effect, course=course, size=-0.1),))
    at_rest = only_promised(setting, fitted)
    (std,) = np.sqrt(np.diag(fitted.design.unknowns_cov([fitted.design.nuisance_std.size])))
    short = (replace(fitted.named[0], size=fitted.named[0].size + 5 * std),)
    design, departures, centred = linearised(
        setting, fitted.theta, short, fitted.design.noise, all_departures(setting, fitted.theta, short))
    stalled = replace(fitted, named=short, departures=departures, design=design, centred=centred)
    # five deviations of the size, whatever the parameters make up for; a fifth for what is not linear
    assert at_rest >= 0 and only_promised(setting, stalled) - at_rest > 0.8 * 0.5 * 5**2


def test_prior_odds_stand_beside_what_the_data_told(prepared, record):
    found = probupdate.diagnose(prepared, record(5, gain=("y4", 1.12)), extend=False)
    (one,) = found.findings
    assert 0 < one.prior_probability <= 1 and found.content()["findings"][0]["prior_probability"] == one.prior_probability
    words = wording.told_words({"posterior_probability": 0.97, "prior_probability": 0.25})
    assert words == "probability 0.97 among its competing hypotheses, 0.25 before the data"


def test_a_logger_s_rate_hardly_ever_steps_and_steel_always_warms():
    rate = next(e for e in measurement_effects(["a"], [Sensor(channel="a", level="top", position_m=(0.0, 0.0, 1.0),
                direction=(1.0, 0.0, 0.0), quantity="acceleration", unit="m/s2")]) if e.cause == "sampling rate")  # fmt: skip
    assert rate.prior_odds("step") < 0.01 < rate.prior_odds("constant") < 1
    pairs = [e for e in crosstalk_effects(("a", "b", "c"))]
    assert sum(e.odds for e in pairs) == pytest.approx(1.0)
    with pytest.raises(InputError, match="prior odds"):
        replace(rate, odds=0.0)
