"""The verdict: what the first lines say is what the numbers are, and nothing that forbids their use is buried."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from probupdate.model.parameters import Parameter, Parameters
from probupdate.reporting.diagnosis_section import diagnosis_section
from probupdate.reporting.elements import Items, Table
from probupdate.reporting.figures_diagnosis import sizes_found
from probupdate.reporting.findings import findings
from probupdate.reporting.identifiability import (
    BOUND,
    KNOWN,
    PARTLY,
    PRIOR,
    contraction,
    estimate,
    identifiabilities,
    names_of,
)
from probupdate.reporting.overview_sections import conclusion, notable_facts, verdict_section
from probupdate.reporting.posterior_sections import choose_pairs, comparison_section
from probupdate.reporting.updating_sections import update_section


def alarms(section) -> Items:
    """What not to rely on, which the first screen has."""
    return next(i for i in section.items[: section.shown] if getattr(i, "title", "") == "What not to rely on")


@pytest.fixture
def run(full_run, unfigured):
    return full_run


@pytest.fixture
def sound(run):
    """A run that nothing speaks against: fits as it should, nothing found, no parameter shifted."""
    diagnosis = dict(run.diagnosis, verdict="none", findings=[], parameters=[], details={})
    return replace(run, diagnosis=diagnosis, update=replace(run.update, map_misfit=float(run.update.n_effective)))


@pytest.mark.parametrize("change", [0.95, 1.0])
def test_selected_sets_that_are_all_before_a_step_are_said_to_be(sound, change):
    chosen = {s.id for s in sound.nine.sets}
    last = max(k for k, s in enumerate(sound.modes.sets) if s.id in chosen)
    sets = tuple(replace(s, frequency_hz=s.frequency_hz * (change if k > last else 1.0))
                 for k, s in enumerate(sound.modes.sets))
    stepped = replace(sound, modes=replace(sound.modes, sets=sets))
    words = [f.text for f in findings(stepped) if f.short == "the sets selected are of one state of two"]
    assert len(words) == (change != 1.0) and all("of the state before" in text for text in words)
    assert "one state of two" in verdict_section(stepped).headline or change == 1.0


def test_a_finding_is_included_before_more_error_is_stated(run):
    update = replace(run.update, map_misfit=6.25 * run.update.n_effective)
    diagnosis = dict(run.diagnosis, verdict="ambiguous", extended_model="diagnosis.model.toml")
    section = verdict_section(replace(run, update=update, diagnosis=diagnosis))
    actions = next(i for i in section.items if getattr(i, "title", "") == "What to do").statements
    included, stated = (next(k for k, text in enumerate(actions) if word in text) for word in (
        "diagnosis.model.toml", "--discrepancy"))
    assert included < stated and actions[stated].startswith("If it does not fit with the findings in it either")


def test_the_table_says_which_of_several_values_to_quote(sound):
    assert "quote this table's" in to_use(sound).note


def alarming(run) -> list[str]:
    return [f.text for f in findings(run) if f.level == "warning"]


def tables(section) -> dict[str, Table]:
    return {i.caption: i for i in section.items if isinstance(i, Table)}


def to_use(run) -> Table:
    """The parameters with their intervals, which open the first screen."""
    table = verdict_section(run).items[0]
    assert isinstance(table, Table) and table.caption.startswith("Parameters")
    return table


@pytest.fixture
def taken_in(run):
    """The same with an update of the mean of blocks, in which both findings are."""
    added = [{"cause": "joints loosened", "location": "face AB, bay 2", "as": "parameter", "parameter": "LJF",
              "time_profile": "step", "size": -0.3},
             {"cause": "sensor gain", "location": "TP-B-x", "as": "correction of the modal sets"}]
    extension = {"added": added, "files": {"mean": "diagnosis.mean.json"}}
    diagnosis = dict(run.diagnosis, extended_model="diagnosis.model.toml", extension=extension)
    return replace(run, diagnosis=diagnosis, mean=run.nine,
                   update=replace(run.update, map_misfit=float(run.update.n_effective)))


def test_findings_in_the_updated_model_forbid_nothing(taken_in):
    section = verdict_section(taken_in)
    assert taken_in.included and not alarming(taken_in)
    assert section.headline.startswith("Faults identified: joints loosened, face AB, bay 2: −62.0 ± 4.0 %")
    assert "the model with the findings in it fits all 5 measured modes" in section.headline
    actions = next(i for i in section.items if getattr(i, "title", "") == "What to do").statements
    assert "Confirm joints loosened, face AB, bay 2: inspect the weld toes." in actions
    assert not any("pdate again" in text for text in actions)
    # of the update of the model without them it is said
    assert any("disagree" in text for text in alarming(replace(taken_in, mean=None)))


def test_the_parameters_open_the_first_screen_with_their_intervals(taken_in):
    # k_j as wide as its prior
    theta = np.array(taken_in.posterior.theta)
    theta[..., 0] = 1 + 0.05 * np.random.default_rng(4).standard_normal(theta.shape[:2])
    taken_in = replace(taken_in, posterior=replace(taken_in.posterior, theta=theta))
    table = to_use(taken_in)
    assert table.caption == "Parameters to use, with their intervals"
    names = [c.name for c in table.columns]
    low, high = np.percentile(taken_in.posterior.draws[:, 2], [5, 95])
    row = next(r for r in table.rows if r[0].startswith("k_TP"))
    assert row[names.index("90 % interval")] == f"{low:.3f} to {high:.3f}"
    # a finding's size is known from the change, though the mean after it adds nothing
    finding = next(r for r in table.rows if r[0].startswith("LJF"))
    assert finding[names.index("identified")] == "by its change" and finding[names.index("before")] == "1.30"
    assert "k_j" in table.note and not any(r[0].startswith("k_j") for r in table.rows)
    assert to_use(replace(taken_in, mean=None)).caption == "Parameters, provisional"


def test_the_parameters_say_of_which_sets_they_are(taken_in):
    update = replace(taken_in.update, settings={**taken_in.update.settings, "sets": "these are of 20 of 32 sets; more"})
    (table,) = (i for i in verdict_section(replace(taken_in, update=update)).items
                if isinstance(i, Table) and i.caption.startswith("Parameters"))
    assert table.note.startswith("These are of 20 of 32 sets.")


def test_the_screen_says_what_the_page_says(taken_in):
    said = conclusion(taken_in)
    section = verdict_section(taken_in)
    assert said[0] == section.headline and said[1] == section.lead
    names = [row[0].replace(":", "").split()[0] for row in to_use(taken_in).rows]
    assert [line.split()[0] for line in said[3:]] == names


def test_a_sensor_s_fault_alone_does_not_blame_the_model(sound):
    one = {"kind": "measurement", "cause": "sensor gain", "location": "TP-A-x", "size": 0.08, "size_std": 0.001,
           "unit": "-", "posterior_probability": 0.999, "time_profile": "constant", "alternatives": [], "gain": {}}
    named = replace(sound, diagnosis=dict(sound.diagnosis, verdict="named", findings=[one], extended_model=None))
    (said,) = (f for f in findings(named) if f.level == "warning")
    assert "sensor's fault" in said.short and "diagnosis.modes.json" in said.action and "model" not in said.short


def test_how_many_modes_were_compared_stands_with_the_error(sound):
    hz = np.array(sound.update.initial_hz)
    hz[2] = np.nan
    words = verdict_section(replace(sound, update=replace(sound.update, initial_hz=hz))).headline
    assert "fits 4 of 5 measured modes, the others not compared, within" in words


def test_a_storey_that_its_own_parameter_describes_is_said(run):
    """Of a model whose parameters describe what changed nothing else is found: that is no green page."""
    storey = {"name": "k3", "unit": "N/m", "prior": 1e6, "prior_std": 3e5, "value": 7e5, "std": 1e4,
              "prior_shift": -1.0, "value_after": 7e5, "std_after": 1e4, "prior_shift_after": -1.0}
    content = dict(run.diagnosis, verdict="none", findings=[], parameters=[storey], details={})
    alone = replace(run, diagnosis=content, update=None, posterior=None, comparison=None)
    assert "k3 −30.0 ± 1.0 %" in verdict_section(alone).headline
    assert to_use(alone).rows[0][2:] == ("700\u202f000", "684\u202f000 to 716\u202f000", "−30")
    section = diagnosis_section(alone)
    assert section.level == "plain" and "k3 −30.0 ± 1.0 %" in section.headline
    unmoved = dict(content, parameters=[storey | {"value_after": 9.9e5, "prior_shift_after": -0.03}])
    assert diagnosis_section(replace(alone, diagnosis=unmoved)).level == "good"


@pytest.fixture
def two_states(sound):
    """An update of all sets together, of which one of the model's own parameters changed at noon."""
    finding = {"kind": "structural", "cause": "parameter", "location": "k_t", "size": -0.3, "size_std": 0.03,
               "unit": "-", "posterior_probability": 1.0, "time_profile": "step", "since": "2019-06-03T12:00Z",
               "z": -20.0, "alternatives": [], "gain": {}, "check": "inspect what k_t stands for"}
    k_t, k_j = ({"name": name, "unit": "-", "prior": 1.0, "prior_std": 0.2, "value": value, "std": 0.02,
                 "prior_shift": 1.0, "value_after": value, "std_after": 0.02, "prior_shift_after": 1.0}
                for name, value in (("k_t", 1.2), ("k_j", 1.05)))
    content = dict(sound.diagnosis, verdict="named", findings=[finding], parameters=[k_t, k_j], extended_model=None,
                   extension={"files": {"mean": "diagnosis.mean.json"}, "added": []})
    return replace(sound, diagnosis=content, update=replace(sound.update, set_id="48 of 48 sets"))


def test_parameters_of_a_structure_that_changed_are_those_of_each_state(two_states):
    table = to_use(two_states)
    assert [c.name for c in table.columns][2:4] == ["until 2019-06-03T12:00Z", "from 2019-06-03T12:00Z on"]
    assert table.rows[0][2:] == ("1.20 (1.17 to 1.23)", "0.900 (0.841 to 0.959)", "−25")
    assert table.rows[1][2:] == ("1.05 (1.02 to 1.08)", "the same", "–")
    section = verdict_section(two_states)
    assert "parameter k_t: from 1.2 to 0.9 (−25.0 ± 2.5 %), from 2019-06-03T12:00Z on; " in section.headline
    assert "valid for neither state" in section.headline and not section.lead and "fits" not in section.headline
    actions = next(i for i in section.items if getattr(i, "title", "") == "What to do").statements
    assert any("--modes diagnosis.mean.json" in text for text in actions)
    assert any("from 2019-06-03T12:00Z on" in line for line in conclusion(two_states))


def section_words(section) -> str:
    said = [section.headline, section.lead]
    for item in section.items:
        said += getattr(item, "statements", ()) or [getattr(item, "text", "")]
    return " ".join(said)


def test_what_a_diagnosis_explains_is_no_misfit_that_is_still_to_be_found(two_states):
    """The update of two states fits nothing: the page is of the model with what was found."""
    missing = replace(two_states, update=replace(two_states.update, map_misfit=6.25 * two_states.update.n_effective))
    verdict = verdict_section(missing)
    assert "residuals with the findings included are within what chance allows (p = 0.3); " in verdict.headline
    assert "Do not rely" not in verdict.headline and "does not fit" not in verdict.headline
    assert not any("disagree" in text for text in alarms(verdict).statements)
    assert "`probupdate diagnose`" not in section_words(verdict)
    lacks = "as the model lacks what the diagnosis found"
    assert lacks in section_words(update_section(missing))
    # a rest that chance does not make, or a change that is in none of the update's sets, explains no misfit
    unexplained = dict(missing.diagnosis, adequacy_p=0.001)
    assert "the model does not fit" in verdict_section(replace(missing, diagnosis=unexplained)).headline
    before = replace(missing, update=replace(missing.update, set_id="2019-06-03T01:30Z"))
    assert "the model does not fit" in verdict_section(before).headline
    assert lacks not in section_words(update_section(before))


def test_a_misfit_beside_a_fault_that_was_found_is_that_of_the_model_without_it(run):
    missing = replace(run, update=replace(run.update, map_misfit=6.25 * run.update.n_effective))
    verdict = verdict_section(missing)
    assert "the updated model, without what was found, does not fit" in verdict.headline
    assert "within what chance allows (p = 0.3)" in verdict.headline
    assert "`probupdate diagnose`" not in section_words(verdict) and "diagnosis.model.toml" in section_words(verdict)
    assert "probupdate diagnose" in section_words(verdict_section(replace(missing, diagnosis=None)))
    # one that leaves it unexplained is not to be run again either
    unknown = replace(missing, diagnosis=dict(run.diagnosis, verdict="unexplained", findings=[]))
    assert "`probupdate diagnose`" not in section_words(verdict_section(unknown))


def test_what_comes_nearest_to_an_unexplained_record_stands_in_the_headline(run):
    details = dict(run.diagnosis["details"], nearest=[
        "parameter s2: from 1.06 to 0.744, from noon on, probability 1.00"])
    unknown = replace(run, diagnosis=dict(run.diagnosis, verdict="unexplained", findings=[], details=details))
    assert verdict_section(unknown).headline.startswith(
        "Cause unknown; nearest comes parameter s2: from 1.06 to 0.744, from noon on, which is not established")


def test_a_second_step_and_a_growing_loss_are_states_too(two_states):
    (first,) = two_states.diagnosis["findings"]
    second = dict(first, size=-0.1, since="2019-06-03T18:00Z")

    def rows(*findings):
        return to_use(replace(two_states, diagnosis=dict(two_states.diagnosis, findings=list(findings))))

    table = rows(second, first)
    assert [c.name for c in table.columns][3:5] == ["from 2019-06-03T12:00Z to 2019-06-03T18:00Z",
                                                    "from 2019-06-03T18:00Z on"]
    assert table.rows[0][3] == "0.900" and table.rows[0][4].startswith("0.800 (")
    grown = rows(dict(first, time_profile="ramp", since=""))
    assert [c.name for c in grown.columns][2:4] == ["at the beginning", "at the end"]
    assert grown.rows[0][3].startswith("0.900 (")


@pytest.mark.parametrize("chosen", ["2019-06-03T01:30Z", "9 of 9 sets"])
def test_sets_of_one_state_have_parameters_of_their_own(two_states, chosen):
    """One set, or the nine that were selected, all before the change."""
    run = replace(two_states, update=replace(two_states.update, set_id=chosen))
    assert to_use(run).columns[2].name == "updated" and "neither state" not in verdict_section(run).headline


def test_frequencies_that_step_between_the_sets_forbid_their_mean(sound):
    update = replace(sound.update, set_id="48 of 48 sets", settings={"step between the sets": "frequencies step at x"})
    stepping = replace(sound, diagnosis=None, update=update)
    assert to_use(stepping).caption == "Parameters of two states together, valid for neither"
    section = verdict_section(stepping)
    assert section.level == "warning" and "neither state" in section.headline
    assert any("probupdate diagnose" in f.action for f in findings(stepping))
    # a diagnosis that finds nothing beyond what is normal has explained it
    assert "neither" not in verdict_section(replace(stepping, diagnosis=sound.diagnosis)).headline


def test_the_headline_says_of_which_estimate_its_error_is(sound):
    words = verdict_section(sound).headline
    assert "at the posterior median, " in words and "% at the MAP (" in words
    assert "% at the MAP (" in verdict_section(replace(sound, posterior=None)).headline


def test_a_model_that_fits_is_said_to_fit_with_its_worst_frequency(sound):
    section = verdict_section(sound)
    after = 100 * np.nanmax(np.abs(np.median(sound.posterior.frequency_hz, axis=0) / sound.update.measured_hz - 1))
    assert f"the updated model fits all 5 measured modes within {after:.1f} %" in section.headline
    assert "The sampler converged." in section.lead
    # py, far above its prior, is said; without it nothing is left to say
    theta = np.array(sound.posterior.theta)
    theta[..., :] = sound.update.parameters.initial + 0.3 * sound.update.parameters.std * np.random.default_rng(
        1).standard_normal(theta.shape)
    section = verdict_section(replace(sound, posterior=replace(sound.posterior, theta=theta)))
    assert section.level == "good" and section.headline.endswith("No check speaks against the parameters.")


def shifted(run, p: float, size: float):
    """The same with one parameter shifted by that many prior standard deviations where +-0.9 is expected."""
    changed = {"parameters": [{"name": "k_t", "prior_shift": [size], "expected": [0.9]}], "p_together": [p]}
    rows = [{"name": "k_t", "unit": "-", "prior": 1.0, "prior_std": 0.2, "value": 1.5, "std": 0.1, "prior_shift": size}]
    content = dict(run.diagnosis, parameters=rows, details={"residuals": {"states": ["best"], "prior_shift": changed}})
    return replace(run, diagnosis=content)


def test_shifts_that_right_priors_make_are_said_of_a_tenth_of_records(sound):
    rng, said, n = np.random.default_rng(4), 0, 400
    for size in rng.standard_normal((n, 11)) * 0.9:
        names = [f"k{j}" for j in range(11)]
        changed = {"parameters": [{"name": n, "prior_shift": [x], "expected": [0.9]}
                                  for n, x in zip(names, size, strict=True)], "p_together": [0.5]}
        rows = [{"name": n, "unit": "-", "prior": 1.0, "prior_std": 0.2, "value": 1.0, "std": 0.1, "prior_shift": x}
                for n, x in zip(names, size, strict=True)]
        content = dict(sound.diagnosis, parameters=rows,
                       details={"residuals": {"states": ["best"], "prior_shift": changed}})
        said += bool(shift_findings(replace(sound, diagnosis=content)))
    # 4.5 standard errors of a tenth of the records
    assert said / n == pytest.approx(0.1, abs=4.5 * np.sqrt(0.09 / n))


def shift_findings(run):
    return [f for f in findings(run) if f.short.endswith("far from the prior")]


@pytest.mark.parametrize(("p", "size", "level"), [(0.007, 3.2, "caution"), (0.2, 3.2, "caution"), (0.5, 0.3, "good")])
def test_the_verdict_has_the_colour_of_its_worst_finding(sound, p, size, level):
    """A shift that chance does not explain is in the headline, not eight sections below a green one."""
    section = verdict_section(shifted(sound, p, size))
    assert section.level == level
    assert ("k_t far from the prior" in section.headline) == (level != "good")
    asked = [f.action for f in findings(shifted(sound, p, size)) if "Check the prior" in f.action]
    assert bool(asked) == (level != "good") and all(a.startswith("Check the prior of k_t against") for a in asked)
    if level != "good":
        alarm = alarms(section)
        assert any(f"{size:+.1f}" in t for t in alarm.statements) and alarm.level == level


def test_widths_that_are_too_wide_are_not_green(sound):
    close = replace(sound, update=replace(sound.update, map_misfit=0.05 * sound.update.n_effective))
    section = verdict_section(shifted(close, 0.5, 0.1))
    assert section.level == "caution" and "too wide" in section.headline
    notices = [i for i in update_section(close).items if getattr(i, "kind", "") == "notice"]
    assert [n.level for n in notices if "too wide" in n.text] == ["caution"]


def test_standard_deviations_that_were_measured_are_not_recommended_again(sound):
    close = replace(sound.update, map_misfit=0.05 * sound.update.n_effective)

    def advice(weights: str) -> str:
        run = replace(sound, update=replace(close, settings={"weights": weights}))
        return next(f.action for f in findings(run) if "too wide" in f.short)

    assert "--weights measured" in advice("frequencies: CoV 0.015, 0.017; shape components: ...")
    assert "scatter between sets" in advice("frequencies: standard deviations of the file; shape components: ...")


def test_after_is_one_estimate_with_its_own_interval(run):
    """However skewed a posterior: the value that stands beside an interval lies in it."""
    after = estimate(run.update, run.posterior)
    assert np.all(after.low < after.theta) and np.all(after.theta < after.high)
    far = replace(run, update=replace(run.update, map_theta=run.update.parameters.lower + 1e-3))
    table = tables(verdict_section(far))["What is known of each parameter"]
    names = [c.name for c in table.columns]
    for row in table.rows:
        low, high = (float(x.replace("\u202f", "").replace("\u2212", "-")) for x in
                     row[names.index("90 % interval")].split(" to "))
        value = float(row[names.index("after")].replace("\u202f", "").replace("\u2212", "-"))
        assert low <= value <= high
    bare = estimate(run.update, None)
    assert bare.low is None and bare.name == "MAP" and np.array_equal(bare.theta, run.update.map_theta)


def errors_picture(run):
    return next(i for i in verdict_section(run).items if getattr(i, "kind", "") == "picture" and "How far" in i.caption)


def test_the_first_picture_is_what_was_found_beside_what_was_hidden(run):
    """What, where, how large, how sure; of a run in which nothing is found it is how the frequencies fit."""
    hidden = ("leg stiffness, leg B, bay 4: factor 0.75, from hour 12 on",)
    assert run.diagnosis["findings"]
    first = next(i for i in verdict_section(replace(run, truth={**(run.truth or {}), "effects": hidden})).items
                 if getattr(i, "kind", "") == "picture")
    assert first.alt.startswith("Found: ") and f"Hidden: {hidden[0]}." in first.alt
    drawn = sizes_found(run.diagnosis["findings"], hidden)
    titles = [axes.get_title(loc="left") for axes in drawn.axes]
    for title, finding in zip(titles, run.diagnosis["findings"], strict=True):
        assert finding["cause"] in title and f"probability {finding['posterior_probability']:.2f}" in title
    assert hidden[0] in drawn.get_suptitle()
    none = replace(run, diagnosis=run.diagnosis | {"findings": []})
    assert next(i for i in verdict_section(none).items if getattr(i, "kind", "") == "picture") == errors_picture(none)


def test_why_eq_7_fits_closer_is_said_at_the_figure(run):
    picture = errors_picture(run)
    printed = run.update.scheme("step")
    exact = replace(printed, frequency_hz=run.update.measured_hz)
    closer = replace(run, update=replace(run.update, schemes=tuple(
        exact if s.key == "step" else s for s in run.update.schemes)))
    words = errors_picture(closer).caption
    assert "the prior loses weight" in words and "initial within" in picture.alt


def test_a_model_that_misses_is_said_to_miss(run):
    """Misfit of 6.25 a response: 2.5 standard deviations."""
    update = replace(run.update, map_misfit=6.25 * run.update.n_effective)
    section = verdict_section(replace(run, update=update))
    assert "does not fit" in section.headline and "2.5 times the stated standard deviations" in section.headline
    assert section.level == "warning"
    assert any("2.5 times" in text for text in alarming(replace(run, update=update)))


def test_a_posterior_that_did_not_converge_is_in_the_headline_and_among_the_alarms(run):
    posterior = replace(run.posterior, converged=False, verdict="NOT converged: R-hat 1.29")
    broken = replace(run, posterior=posterior)
    section = verdict_section(broken)
    assert "the sampler did not converge" in section.headline and section.level == "warning"
    assert "The sampler did not converge." in section.lead
    first = alarms(section)
    assert isinstance(first, Items) and first.level == "warning"
    assert "NOT converged: R-hat 1.29" in first.statements


def test_without_a_posterior_or_an_update_the_headline_says_so(run):
    assert "No posterior was sampled" in verdict_section(replace(run, posterior=None)).headline
    nothing = replace(run, update=None, posterior=None, comparison=None)
    diagnosed = verdict_section(nothing)
    assert diagnosed.headline.startswith("Faults identified: joints loosened, face AB, bay 2: −62.0 ± 4.0 %")
    assert diagnosed.headline.endswith("The model has not been updated in this run.")
    bare = verdict_section(replace(nothing, diagnosis=None))
    assert bare.headline == "Modes were identified; no model has been updated in this run." and bare.lead == ""


def test_every_parameter_stands_in_one_class(run):
    found = identifiabilities(run.update, run.posterior)
    classes = [set(names_of(found, kind)) for kind in (KNOWN, PARTLY, PRIOR, BOUND)]
    assert sum(map(len, classes)) == len(set().union(*classes)) == len(run.update.parameters)
    width = contraction(run.update, run.posterior)
    for s, w in zip(found, width, strict=True):
        assert s.kind == (KNOWN if w < 0.5 else PARTLY if w <= 0.9 else PRIOR)


def test_a_bound_outweighs_a_narrow_posterior(run):
    """tz is narrow, so it would be strongly identified; at its bound it is not said to be."""
    k = run.update.parameters.index("tz")
    assert identifiabilities(run.update, run.posterior)[k].kind == KNOWN
    theta = np.array(run.update.map_theta)
    theta[k] = run.update.parameters.lower[k]
    update = replace(run.update, map_theta=theta, map_at_bound=np.arange(10) == k)
    stand = identifiabilities(update, run.posterior)[k]
    assert stand.kind == BOUND and stand.words == "at its lower bound"
    pinned = replace(run, update=update)
    assert any("tz at its lower bound of 0.0200" in f.text for f in findings(pinned) if f.level == "caution")
    assert "tz" not in [row[0].split(":")[0] for row in to_use(pinned).rows]
    assert tables(verdict_section(pinned))["What is known of each parameter"].marked == {k}


def test_without_draws_the_width_is_that_of_the_gaussian(run):
    """The made-up covariance at the maximum is that of a tenth of each prior's standard deviation."""
    assert contraction(run.update, None) == pytest.approx(0.1)


def test_fallbacks_are_a_remark_when_few_and_an_alarm_when_many(run):
    few = [t for t in notable_facts(run) if "reduced basis" in t]
    assert few and "12 of 120\u202f000" in few[0] and not any("reduced basis" in t for t in alarming(run))
    many = replace(run.posterior, record=dict(run.posterior.record, fallback=60000))
    assert any("reduced basis" in t for t in alarming(replace(run, posterior=many)))


def test_before_and_after_stand_on_the_first_screen(run):
    rows = tables(verdict_section(run))["Frequencies before and after"].rows
    assert [r[0] for r in rows] == list(run.update.labels)
    assert rows[3][2] == "1.570" and rows[3][3] == f"{100 * (1.57 / run.update.measured_hz[3] - 1):+.1f}".replace(
        "-", "\u2212")


def test_truth_stands_beside_what_was_found_where_it_is_known(run):
    known = {n: float(v) for n, v in zip(run.update.parameters.names, run.update.map_theta, strict=True)}
    known["k_t"] = 3.9
    known["D_l"] = 1.0
    section = comparison_section(replace(run, truth={"parameters": known}))
    table = tables(section)["Truth beside what was found"]
    inside = {row[0]: row[6] for row in table.rows}
    assert inside["k_t"] == "no" and inside["py"] == "yes" and "D_l" not in inside and "D_l" in table.note
    assert table.marked == {k for k, row in enumerate(table.rows) if row[6] == "no"}
    assert "outside for" in verdict_section(replace(run, truth={"parameters": known})).lead
    assert "Truth beside what was found" not in tables(comparison_section(run))


def test_the_papers_numbers_are_marked_as_another_turbines(run):
    found = tables(update_section(run))
    for number in ("3", "4", "5", "6"):
        table = next(t for caption, t in found.items() if f"(Table {number})" in caption)
        assert "another realisation" in table.note and any(c.paper for c in table.columns)
    plain = tables(update_section(replace(run, jacket=False)))
    assert not any("another realisation" in t.note for t in plain.values())


def test_pairs_are_drawn_of_the_best_informed_and_the_others_named():
    names = tuple(f"p{k}" for k in range(17))
    ratio = np.full(17, 0.95)
    ratio[[2, 9, 5, 16, 0, 11, 7]] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    chosen, words = choose_pairs(names, ratio)
    assert chosen == [0, 2, 5, 9, 11, 16] and "p7" in words and "p9" not in words
    chosen, words = choose_pairs(names, np.linspace(0.95, 1, 17))
    assert len(chosen) == 6
    assert choose_pairs(("a", "b"), np.array([0.5, 0.5])) == ([0, 1], "All parameters in pairs.")


def test_a_parameter_that_every_set_leaves_at_its_bound_has_no_cov(run):
    from probupdate.updating.update_file import ScatterRecord

    k = run.update.parameters.index("py")
    theta = np.tile(run.update.map_theta, (9, 1)) * (1 + 0.01 * np.random.default_rng(3).standard_normal((9, 10)))
    theta[:, k] = run.update.parameters.lower[k]
    sets = ScatterRecord(
        ids=tuple(map(str, range(9))), theta_map=theta, theta_step=theta, iterations=3, variance=np.ones((9, 10)),
        resolution=np.full((9, 10), 0.5), derived={}, failed=(), cov=np.ones(10), total_std=np.ones(10))
    found = tables(update_section(replace(run, update=replace(run.update, sets=sets))))
    table = next(t for caption, t in found.items() if "(Table 7)" in caption)
    row = next(r for r in table.rows if r[0] == "py")
    assert row[4].endswith("*") and row[5] == "\u2013" and "at a bound in every set" in table.note
    assert not next(r for r in table.rows if r[0] == "k_t")[4].endswith("*")


def test_a_single_parameter_and_a_short_chain_make_a_page(full_run, undrawn):
    """What a first try looks like: one parameter, a handful of steps."""
    from probupdate.reporting import compose

    run = full_run
    one = Parameters((Parameter(name="k", unit="-", initial=1.0, std=0.2),))
    update = replace(
        run.update, parameters=one, map_theta=np.array([1.1]), map_covariance=np.eye(1) * 0.01,
        map_resolution=np.array([0.5]), map_at_bound=np.array([False]), derived={},
        schemes=tuple(replace(s, theta=s.theta[:, 1:2], at_bound=np.array([False])) for s in run.update.schemes))
    posterior = replace(
        run.posterior, names=("k",), theta=1.1 + 0.1 * np.random.default_rng(1).standard_normal((8, 5, 1)),
        prior=np.ones((10, 1)), r_hat=np.ones(1), ess=np.full(1, 9.0))
    html = compose(replace(run, update=update, posterior=posterior, comparison=None, jacket=False))
    assert "Of 1 parameter the data identify" in html


@pytest.mark.parametrize(("std", "stated"), [(5.0, ("5.00",)), (6.0, ("6.00", "5.00"))])
def test_components_stand_with_what_to_measure_next(full_run, monkeypatch, std, stated):
    """Shares by hand: 3 and 4 of a total of 5 are 36 and 64 %; a component of nothing is not drawn. Averaged over the
    sizes of the model's error the standard deviation is another."""
    from probupdate.reporting import figures
    from probupdate.updating.update_file import ComponentsRecord

    n = len(full_run.update.parameters)
    gain = np.zeros((2, n))
    gain[0, :3] = [0.25, 0.1, 0.001]
    parts = ComponentsRecord(
        names=("identification", "model discrepancy", "prior"), source_names=(), source_std=np.zeros((0, n)),
        std=np.array([[3.0] * n, [0.0] * n, [4.0] * n]), measures=("sensor at T66", "longer record"), gain=gain,
        responses=("frequency of FA1", "shape of T1"), chi_square=np.array([30.0, 15.0]),
        expected=np.array([1.0, 17.0]))
    drawn = {}
    draw = figures.variance_shares
    monkeypatch.setattr(figures, "variance_shares", lambda *a: drawn.update(given=a) or draw(*a))
    with_parts = replace(full_run, update=replace(full_run.update, components=parts,
                                                       map_covariance=std**2 * np.eye(n)))
    section = update_section(with_parts)
    found = tables(section)
    row = found["Components of each parameter's variance"].rows[0]
    assert row[2:] == (*stated, "36", "0", "64")
    assert list(drawn["given"][1]) == ["identification", "prior"] and np.allclose(drawn["given"][2].sum(axis=0), 1)
    assert found["What to measure next"].rows[0][:4] == ("sensor at T66", "25", "10", "\u2013")
    assert found["Fit of each response at the MAP"].marked == {0}
    assert any("frequency of FA1" in t for i in section.items if isinstance(i, Items) for t in i.statements)
    words = [t for i in verdict_section(with_parts).items if isinstance(i, Items) for t in i.statements]
    assert any("sensor at T66 (narrows k_j by 25 %, k_t by 10 %)" in t for t in words)


def test_a_size_by_the_diagnosis_says_so_beside_an_update(sound):
    """The table beside it has the update's own estimate of the same parameter."""
    changed = {"name": "k_t", "unit": "-", "prior": 1.0, "prior_std": 0.2, "value": 1.38, "std": 0.1,
               "prior_shift": 1.9, "value_after": 1.38, "std_after": 0.1, "prior_shift_after": 1.9}
    run = replace(sound, diagnosis=dict(sound.diagnosis, verdict="none", findings=[], parameters=[changed]))
    size = "(k_t +38 ± 10 %"
    assert f"{size} by the diagnosis)" in verdict_section(run).headline
    alone = replace(run, update=None, posterior=None, comparison=None)
    assert f"{size})" in verdict_section(alone).headline
