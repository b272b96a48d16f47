"""The diagnosis by data alone: nothing hidden, sensors, environmental and operational conditions, a structure that
changes; records of another kind than the code's (two shear chains; the virtual turbine with tolerances)."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import probupdate
from probupdate.campaign.sensor_findings import SensorFinding
from probupdate.cli import main
from probupdate.diagnosis.campaign_tests import finding_row, rate_finding, with_true_rate
from probupdate.diagnosis.engine.evidence import (
    SCALES,
    SLOW_LENGTH,
    SLOW_RATIO,
    profile_information,
    scale_mean,
    sequential_information,
)
from probupdate.diagnosis.engine.once import Once
from probupdate.diagnosis.time_profiles import step_profile
from probupdate.diagnosis.without_model import diagnose_without_model
from probupdate.effects.catalogue import Effect
from probupdate.errors import InputError
from probupdate.io.files import sha256
from probupdate.modal.modes import ModalData, ModalSet, write_modes
from probupdate.virtual.modal_blocks import simulate_modes


def turbine(seed, *effects, **options):
    truth = {"parameters_from": "prior", **({"effect": list(effects)} if effects else {})}
    made = simulate_modes(truth=truth, seed=seed, days=30.0, n_block=40, **options)
    return made.data, made.sensors


STEP = {"time_profile": "step", "at_hour": 330.0}


def test_nothing_changes_in_the_frame_and_nothing_is_said(record, validation):
    """Six records at a level of 3 %: three alarms would come by chance in five of ten thousand tries."""
    row = validation(what="without a model, six frames with nothing hidden: silent", reference="none",
                     why="a level of 3 %")
    answers = [diagnose_without_model(record(seed)) for seed in range(1, 7)]
    row.count(sum(a.verdict == "none" for a in answers), 6, 4)
    found = next(a for a in answers if a.verdict == "none")
    assert not found.findings and found.p_value > 0.03
    assert any(x.cause == "step of frequency" and 0 < x.size < 1 for x in found.detectable_sizes)
    assert any("model" in note for note in found.notes)


@pytest.mark.parametrize("seed", [21, pytest.param(22, marks=pytest.mark.long)])
def test_nothing_hidden_in_the_turbine_nothing_named(seed, validation):
    row = validation(what="without a model, a turbine with nothing hidden: silent", reference="none")
    found = diagnose_without_model(*turbine(seed))
    row.count(found.verdict == "none" and not found.findings, 1, 1, case=found.verdict)


def test_a_level_is_where_sensors_are_whatever_its_name():
    """A campaign calls all heights of its tower one level, which is no rigid body."""
    data, sensors = turbine(21)
    heights = {s.position_m[2] for s in sensors if s.channel[0] == "T" and s.channel[1].isdigit()}
    assert len(heights) == 3
    together = tuple(replace(s, level="tower" if s.position_m[2] in heights else s.level) for s in sensors)
    found = diagnose_without_model(data, together)
    assert found.verdict == "none" and not found.findings


def test_frequencies_that_follow_the_tide_are_the_surroundings(record, validation):
    row = validation(what="without a model, frequencies that follow the tide: verdict, kind, cause, time profile",
                     reference="what was hidden")
    found = diagnose_without_model(record(4, level=0.02))
    (one,) = found.findings
    row.equal((found.verdict, one.kind, one.cause, one.time_profile),
              ("named", "environmental", "wetted length", "water_level_m"))
    assert one.size < 0


def test_two_columns_that_say_the_same_are_ambiguous(record):
    data = record(4, level=0.02)
    rng = np.random.default_rng(0)
    sets = tuple(replace(s, environment={**s.environment, "ballast_t": 30 * s.environment["water_level_m"]
                                         + 0.1 * rng.standard_normal()}) for s in data.sets)
    found = diagnose_without_model(replace(data, sets=sets))
    (one,) = found.findings
    assert found.verdict == "ambiguous"
    assert {one.cause, one.alternatives[0].cause} == {"wetted length", "frequencies follow ballast_t"}
    assert "water_level_m" in found.splits[0] and "ballast_t" in found.splits[0]


def test_a_storey_that_loosens_is_unexplained_with_its_time_and_modes(record, validation):
    row = validation(what="without a model, a storey that loosens by a tenth: verdict, time profile, day; change of "
                          "all modes",
                     reference="a step of frequencies that day; Rayleigh's quotient, between nothing and -2.5 %",
                     unit="%")
    found = diagnose_without_model(record(5, storey=2, factor=0.9, from_block=20))
    assert not found.findings
    (change,) = found.details["changes"]
    row.equal((found.verdict, change["time_profile"], change["since"][:10]), ("unexplained", "step", "2020-01-06"),
              "step")
    moved = {m["mode"]: m["change_percent"] for m in change["frequencies"]}
    # a tenth of one of five storeys: by Rayleigh's quotient between nothing and 2.5 % of a frequency
    row.between(moved["all modes"], -2.6, -0.3, "change")
    assert any("a model is needed" in note for note in found.notes)


def test_a_gain_that_changes_is_named_with_its_channel(validation):
    row = validation(what="without a model, a gain that changes by 8 %: verdict, kind, cause, channel; size in its "
                          "standard deviations, its standard deviation", reference="what was hidden")
    found = diagnose_without_model(*turbine(23, {"kind": "sensor_gain", "channel": "T90-x", "factor": 1.08, **STEP}))
    (one,) = found.findings
    row.equal((found.verdict, one.kind, one.cause, one.location), ("named", "measurement", "sensor gain", "T90-x"),
              "name")
    row.error((one.size - 0.08) / one.size_std, 4, "size")
    row.error(one.size_std, 0.01, "its standard deviation")


def test_a_mode_found_only_after_a_gain_changed_says_nothing_of_it(record, validation):
    row = validation(what="without a model, a gain that changes by 8 % half-way, one of the modes found from then on "
                          "only: verdict, cause, channel, block; size in its standard deviations",
                     reference="what was hidden")
    data = record(11)
    sets = list(data.sets)
    for k, s in enumerate(sets):
        f, shape = np.array(s.frequency_hz), np.array(s.shape)
        if k < 20:
            f[3], shape[:, 3] = np.nan, np.nan
        else:
            shape[2] *= 1.08
        sets[k] = replace(s, frequency_hz=f, shape=shape)
    found = diagnose_without_model(replace(data, sets=tuple(sets)))
    (one,) = found.findings
    row.equal((found.verdict, one.cause, one.location, one.time_profile_start),
              ("named", "sensor gain", data.channels[2], sets[20].id), "name")
    row.error((one.size - 0.08) / one.size_std, 4, "size")


@pytest.mark.parametrize("channel", ["TP-B-y", "T90-y"])
def test_a_channel_reversed_half_way_is_named_with_its_time(channel, validation):
    """Over the whole record it has no mean, and at the tower's top the pairs' axes turn with it."""
    row = validation(what="without a model, a channel reversed half-way, on the transition piece and at the top "
                          "(rates in `studies/blind`): verdict, cause, channel, size, block",
                     reference="what was hidden")
    data, sensors = turbine(27, {"kind": "sensor_gain", "channel": channel, "factor": -1.0, "time_profile": "step",
                                 "at_hour": 360.0})
    found = diagnose_without_model(data, sensors)
    (one,) = found.findings
    first = next(s.id for s in data.sets if pd.Timestamp(s.id) >= pd.Timestamp(data.sets[0].id[:8] + "01T00:00:00Z")
                 + pd.Timedelta(hours=360))
    row.equal((found.verdict, one.cause, one.location, one.size, one.time_profile_start),
              ("named", "sensor polarity", channel, -2.0, first))


def test_constant_gain_on_a_rigid_level_is_named(validation):
    row = validation(what="without a model, a gain wrong by a fifth on a rigid level: verdict, cause, channel, time "
                          "profile; size in its standard deviations", reference="what was hidden")
    found = diagnose_without_model(*turbine(24, {"kind": "sensor_gain", "channel": "TP-B-y", "factor": 0.8}))
    (one,) = found.findings
    row.equal((found.verdict, one.cause, one.location, one.time_profile),
              ("named", "sensor gain", "TP-B-y", "constant"), "name")
    row.error((one.size + 0.2) / one.size_std, 4, "size")


def crosstalk(shape, frequency_hz, size):
    """y5 is heard in x3, which is in no catalogue."""
    seen = np.array(shape, complex)
    seen[4] += size * shape[9]
    return seen, 0.0


CROSSTALK = Effect(kind="measurement", cause="crosstalk", location="y5 into x3", unit="-", tolerance=0.0,
                   prior_scale=0.1,
                   observe=crosstalk, step_of_size=1e-3, time_profiles=("constant", "step"))


@pytest.fixture
def with_crosstalk(record):
    """From the middle of the record on."""
    data = record(6)
    return replace(data, sets=tuple(s if k < 18 else replace(s, shape=crosstalk(s.shape, 0.0, 0.12)[0])
                                    for k, s in enumerate(data.sets)))


def test_an_effect_of_ones_own_needs_a_function_and_a_row(with_crosstalk, validation):
    row = validation(what="without a model, a crosstalk by a row of one's own, and without it: verdict, cause, "
                          "channels; size in its standard deviations beyond 0.003",
                     reference="what was hidden; *unexplained*")
    found = diagnose_without_model(with_crosstalk, effects=[CROSSTALK])
    (one,) = found.findings
    row.equal((found.verdict, one.cause, one.location), ("named", "crosstalk", "y5 into x3"), "name")
    row.error(np.maximum(0, abs(one.size - 0.12) - 0.003) / one.size_std, 4, "size")
    # without the row there is no name for it
    row.equal(diagnose_without_model(with_crosstalk).verdict, "unexplained", "name")


def test_a_row_of_a_parameter_that_the_model_lacks_is_refused(frame_file, with_crosstalk):
    row = Effect(kind="structural", cause="softer", location="storey", unit="-", tolerance=0.0, prior_scale=0.1,
                 parts=(("no such parameter", 1.0),), time_profiles=("constant",))
    with pytest.raises(InputError, match="names a parameter 'no such parameter' that the model lacks"):
        probupdate.diagnose(frame_file, with_crosstalk, effects=[row], extend=False)


def test_the_same_row_beside_a_model(frame_file, with_crosstalk):
    found = probupdate.diagnose(frame_file, with_crosstalk, effects=[CROSSTALK], extend=False)
    assert (found.findings[0].cause, found.findings[0].location) == ("crosstalk", "y5 into x3")
    assert found.findings[0].size == pytest.approx(0.12, abs=4 * found.findings[0].size_std)


def test_the_command_takes_modes_alone(record, tmp_path, capsys):
    write_modes(record(1), tmp_path / "modes.json")
    assert main(["diagnose", "--modes", str(tmp_path / "modes.json"), "--out", str(tmp_path / "d.json")]) == 0
    content = json.loads((tmp_path / "d.json").read_text())
    assert content["verdict"] == "none" and content["adequacy_p"] is None and content["detectable_sizes"]
    assert content["inputs"] == {"model": {}, "modes": {"modes.json": sha256(tmp_path / "modes.json")}}
    with pytest.raises(InputError, match="without a model"):
        probupdate.diagnose(None, record(1), groups={"a": {"k1": 0.1}})


def test_a_search_that_goes_back_does_not_say_so(record, monkeypatch):
    """It takes up smaller hypotheses again, and had counted 1, 2, 3, 3, 2 of 4."""
    found, said = diagnose_without_model(record(1)), []

    def searching(*_, progress, **__):
        for done in (1, 3, 2):
            progress("diagnosing", done, 4)
        progress("another step", 0, 4)
        return found

    monkeypatch.setattr("probupdate.diagnosis.run.diagnose_files", searching)
    probupdate.diagnose(None, record(1), progress=lambda *step: said.append(step))
    assert said == [("diagnosing", 1, 4), ("diagnosing", 3, 4), ("diagnosing", 3, 4), ("another step", 0, 4)]


def test_the_same_record_has_the_same_answer(record):
    first, again = (diagnose_without_model(record(4, level=0.02)).content() for _ in range(2))
    assert first == again


def dense(x, weight, hours, nuisance, extra=None):
    """ln density of one number under each slow error of the grid, by dense matrices, and the prior of each."""
    n, p = nuisance.shape
    grid = [(0.0, 1.0), *((r, length) for r in SLOW_RATIO for length in SLOW_LENGTH)]
    prior = np.array([0.5, *[0.5 / (len(grid) - 1)] * (len(grid) - 1)])
    span, apart = hours[-1] - hours[0], np.abs(hours[:, None] - hours)
    result = []
    for ratio, length in grid:
        V = np.diag(1 / weight) + ratio / weight.mean() * np.exp(-apart / (length * span))
        V = V if extra is None else V + extra
        inside = nuisance.T @ np.linalg.solve(V, nuisance)
        rest = x - nuisance @ np.linalg.solve(inside, nuisance.T @ np.linalg.solve(V, x))
        square = rest @ np.linalg.solve(V, rest) + 1e-12
        result.append(-0.5 * (np.linalg.slogdet(V)[1] + np.linalg.slogdet(inside)[1] + (n - p + 1) * np.log(square)))
    return np.logaddexp.reduce(np.array(result) + np.log(prior))


def drawn(seed, n=14):
    rng = np.random.default_rng(seed)
    hours = np.cumsum(rng.uniform(0.5, 2.0, n))
    return rng, hours, rng.uniform(0.5, 2, n), np.column_stack([np.ones(n), np.cos(hours)])


def test_evidence_of_an_amount_is_that_of_dense_densities(validation):
    """Blocks of other weight and distance, an offset and a harmonic, slow errors of every kind."""
    row = validation(what="without a model, ln Bayes factor of an amount of each scale along a step", why="rounding",
                     reference="Student's t by dense matrices, averaged over slow errors")
    rng, hours, weight, nuisance = drawn(3)
    n, step = len(hours), step_profile(len(hours), 8).value
    x = rng.standard_normal(n) + 2.0 * step
    found = profile_information(x[:, None], weight[:, None], np.array([1e-12]), hours, nuisance, step[None])
    nothing = dense(x, weight, hours, nuisance)
    expected = [dense(x, weight, hours, nuisance, s**2 * np.outer(step, step)) - nothing for s in SCALES]
    row.error(found.log_moved()[:, 0, 0] - expected, 1e-6, case="amounts")
    # one size that is given: the density of what is left without it
    given = dense(x - 1.5 * step, weight, hours, nuisance) - nothing
    row.error(found.log_of_size(np.array([1.5]), 0, 1.0) - given, 1e-6, case="size")


def test_numbers_in_sequence_have_the_density_of_the_whole():
    """Each is explained by those before it: a mixture of numbers that are explained already adds nothing new."""
    rng, hours, weight, nuisance = drawn(4, 30)
    step = step_profile(30, 12).value
    common = np.cumsum(rng.standard_normal(30))
    x = np.column_stack([common, common + 0.1 * rng.standard_normal(30)])
    alone = profile_information(x, np.ones_like(x), np.full(2, 1e-8), hours, nuisance, step[None])
    chain = sequential_information(x, np.ones_like(x), np.full(2, 1e-8), hours, nuisance, step[None])
    np.testing.assert_allclose(chain.log_moved()[:, 0], alone.log_moved()[:, 0], atol=1e-9)
    mixed = x @ [[1.0, 3.0], [0.0, 1.0]]
    again = sequential_information(mixed, np.ones_like(x), np.full(2, 1e-8), hours, nuisance, step[None])
    np.testing.assert_allclose(again.log_moved(), chain.log_moved(), atol=1e-6)


def test_a_column_that_steps_hides_no_step():
    """Where a column and a step are one and the same neither is distinguishable from the other."""
    step = (np.arange(60) >= 20).astype(float)
    found = profile_information(np.zeros((60, 1)), np.ones((60, 1)), np.ones(1), np.arange(60.0),
                                np.column_stack([np.ones(60), step - 0.5]), step[None])
    assert not found.usable.any()


@pytest.mark.parametrize("memory", [0.0, 0.7, 0.9])
def test_a_slow_error_is_no_step(memory, validation):
    """A first-order autoregression of three times the noise: a step outweighs nothing ten times in one of ten at most
    (Markov's inequality); in one of forty here."""
    row = validation(what="without a model, a slow error of three times the noise, 200 series of 30 blocks: share of "
                          "steps at odds of 10", reference="none")
    rng, n = np.random.default_rng(2), 30
    slow = np.zeros((n, 200))
    slow[0] = rng.standard_normal(200) / np.sqrt(1 - memory**2)
    for k in range(1, n):
        slow[k] = memory * slow[k - 1] + rng.standard_normal(200)
    steps = np.array([step_profile(n, at).value for at in range(4, n - 3)])
    x = slow + 0.3 * rng.standard_normal((n, 200))
    found = scale_mean(profile_information(x, np.ones_like(x), np.full(200, 1e-9), np.arange(n) * 1.0, np.ones((n, 1)),
                                           steps).log_moved())
    odds = np.logaddexp.reduce(found, axis=1) - np.log(len(steps))
    row.error(np.mean(odds > np.log(10)), 0.025, case=memory)


def test_evidence_of_what_is_measured_once_is_that_of_dense_densities(validation):
    """Score, information, and densities as they are, with a wider scatter and of other numbers."""
    row = validation(what="without a model, numbers that are measured once: ln density, score, information, chi-square",
                     why="rounding", reference="normal density by dense matrices")
    rng = np.random.default_rng(8)
    y, std, U, F = (rng.standard_normal(9), rng.uniform(0.5, 2, 9), 3 * rng.standard_normal((9, 4)),
                    rng.uniform(size=(9, 2)))
    once, extra = Once(numbers=y, std=std, unknowns=U), rng.uniform(0, 3, 9)
    V = U @ U.T + np.diag(std**2)
    wider = stats.multivariate_normal.logpdf(y, cov=V + np.diag(extra**2)) - stats.multivariate_normal.logpdf(y, cov=V)
    score, information = once.scores(F)
    row.error(once.log_density - 4.5 * np.log(2 * np.pi) - stats.multivariate_normal.logpdf(y, cov=V), 1e-9, "density")
    row.error(once.log_wider(extra) - wider, 1e-9, "density")
    row.error(score - F.T @ np.linalg.solve(V, y), 1e-9, "score")
    row.error(information - F.T @ np.linalg.solve(V, F), 1e-9, "information")
    row.error(once.misfits(F) - np.sum(F * np.linalg.solve(V, F), axis=0), 1e-9, "chi-square")


def test_a_clock_told_wrong_by_the_rotor_is_a_finding_and_taken_out():
    row = {"kind": "measurement", "cause": "sampling rate", "channels": [], "statement": "", "suspected": True,
           "size": -0.03, "size_std": 0.003}
    finding = rate_finding([row])
    assert (finding.kind, finding.cause) == ("measurement", "sampling rate") and finding.z > 9
    assert rate_finding([{**row, "suspected": False}]) is None
    one = ModalSet(id="a", frequency_hz=[1.0], shape=np.ones((2, 1)), damping_ratio=[0.01],
                   frequency_std_hz=[0.1], shape_std=np.full((2, 1), 0.1))
    mended = with_true_rate(ModalData(channels=("a", "b"), sets=(one,)), finding)
    assert mended.sets[0].frequency_hz[0] == pytest.approx(0.97)


def test_what_sensors_say_of_one_another_is_a_row_with_size_and_time():
    found = SensorFinding(name="gain change", channel="TP-A-x, TP-A-y", size=1.1, std=0.01, since="2026-01-01T06:00Z",
                          message="TP-A changed")
    row = finding_row(found, ("TP-A-x", "TP-A-y", "TP-B-x"))
    assert (row["cause"], row["channels"], row["since"]) == ("sensor gain", ["TP-A-x", "TP-A-y"], found.since)
    assert row["size"] == pytest.approx(0.1) and row["size_std"] == 0.01 and row["suspected"]
