"""The diagnosis by data alone: nothing hidden, sensors, environmental and operational conditions, a structure that
changes; records of another kind than the code's (two shear chains; the virtual turbine with tolerances)."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import linalg

import probupdate
from probupdate.campaign.sensor_findings import SensorFinding
from probupdate.cli import main
from probupdate.diagnosis.campaign_tests import _measured_row, rate_finding, with_true_rate
from probupdate.diagnosis.empirical_search import (
    SPREAD_LOG,
    SPREAD_SHAPE,
    log_change_of_structure,
    log_common_change,
    make_contrasts,
    outliers,
    score,
)
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.time_profiles import TimeProfile, step_profile
from probupdate.diagnosis.without_model import diagnose_without_model
from probupdate.effects.catalogue import Effect
from probupdate.errors import InputError
from probupdate.io.files import sha256
from probupdate.modal.modes import ModalData, ModalSet, write_modes
from probupdate.runtime.arrays import frozen_array
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


def test_a_block_gone_wrong_stands_apart_and_noise_does_not(validation):
    row = validation(what="without a model, 4000 series of 24 and 48 blocks of noise: share of blocks that stand apart",
                     reference="none", why="6 standard deviations that 24 blocks state to a fifth")
    rng = np.random.default_rng(5)
    of_noise = [rng.standard_normal((4000, n)) * rng.uniform(0.5, 2, (4000, 1)) for n in (24, 48)]
    for series in of_noise:
        row.error(outliers(series, np.ones_like(series)).mean(), below=3e-4, of=f"{series.shape[1]} blocks")
    stepped = of_noise[1] + 100.0 * (np.arange(48) >= 20)
    assert outliers(stepped, np.ones_like(stepped)).mean() < 3e-4
    wrong = of_noise[1].copy()
    wrong[:, [0, 12, 13, 30]] += 100.0
    assert outliers(wrong, np.ones_like(wrong))[:, [0, 12, 13, 30]].all()


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
    assert any("a model would be needed" in note for note in found.notes)


def test_a_gain_that_changes_is_named_with_its_channel(validation):
    row = validation(what="without a model, a gain that changes by 8 %: verdict, kind, cause, channel; size in its "
                          "standard deviations, its standard deviation", reference="what was hidden")
    found = diagnose_without_model(*turbine(23, {"kind": "sensor_gain", "channel": "T90-x", "factor": 1.08, **STEP}))
    (one,) = found.findings
    row.equal((found.verdict, one.kind, one.cause, one.location), ("named", "measurement", "sensor gain", "T90-x"),
              "name")
    row.error((one.size - 0.08) / one.size_std, 4, "size")
    row.error(one.size_std, 0.01, "its standard deviation")


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
    with pytest.raises(InputError, match="no model"):
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


def test_same_seed_same_answer(record):
    first, again = (diagnose_without_model(record(4, level=0.02), seed=3).content() for _ in range(2))
    assert first == again


def test_scores_are_those_of_plain_generalised_least_squares(validation):
    """No slow error, equal weights: the score of a step is the difference of two means over its standard deviation."""
    row = validation(what="without a model, equal weights, 500 series: size of a step, mean noise, scatter of z",
                     reference="difference of two means; one; one",
                     why="rounding; slow errors taken for noise make z smaller")
    rng = np.random.default_rng(1)
    y = rng.standard_normal((500, 1, 60))
    time_profiles = [step_profile(60, 20)]
    contrasts = make_contrasts(np.ones((1, 60)), np.ones((60, 1)), time_profiles, np.arange(60.0))
    found = score(contrasts, y, [[0]])
    plain = y[:, 0, 20:].mean(axis=1) - y[:, 0, :20].mean(axis=1)
    row.error(found.size[:, 0, 0] - plain, 1e-12, "size")
    # noise by differences is right on average; slow errors taken for noise make scores smaller, never larger
    row.error(found.noise.mean() - 1, 0.05, "noise")
    row.between(found.z.std(), 0.85, 1.1, "z")


def test_evidence_of_a_change_is_that_of_dense_normal_densities(validation):
    """Offset with a flat prior, changes of ln f and real parts with their own; blocks of other weight, one missing."""
    row = validation(what="without a model, ln Bayes factor of a change of the structure along a step, one mode at "
                          "two channels", reference="dense normal densities, the offset's prior 1e3 of the noise's",
                     why="a flat offset")
    rng, n = np.random.default_rng(3), 12
    covariance = np.diag([2e-3, 4e-3, 3e-3, 5e-3, 5e-3]) ** 2
    covariance[1, 2] = covariance[2, 1] = 0.4 * 4e-3 * 3e-3
    weight = np.where(np.arange(n) == 4, 0.0, rng.uniform(0.5, 2, n))
    step = step_profile(n, 7)
    y = rng.standard_normal((n, 5)) @ np.linalg.cholesky(covariance).T + step.value[:, None] * [0.004, 0.0, 0.01, 0, 0]
    noise = Noise(covariance=(covariance,), precision=(np.linalg.inv(covariance),), weight=(weight,))
    found = log_change_of_structure((y,), noise, np.ones((n, 1)), [step], [1])
    seen = weight > 0

    def density(spread_log, spread_shape):
        spread = np.diag([spread_log, spread_shape, spread_shape, 0.0, 0.0]) ** 2
        one, h = np.ones(seen.sum()), step.value[seen]
        total = np.kron(np.diag(1 / weight[seen]), covariance) + np.kron(np.outer(one, one), 1e6 * covariance)
        total = total + np.kron(np.outer(h, h), spread)
        values = y[seen].ravel()
        return -0.5 * (values @ np.linalg.solve(total, values) + np.linalg.slogdet(total)[1])

    nothing = density(0, 0)
    each = [density(a, b) - nothing for a in SPREAD_LOG for b in SPREAD_SHAPE]
    row.error(found - (np.logaddexp.reduce(each) - np.log(len(each))), below=1e-3)


@pytest.mark.parametrize("k", [1, 2])
def test_evidence_of_a_common_change_is_that_of_dense_normal_densities(k, validation):
    """A mode and a mode or a pair, of which all frequencies move by one share along a step; numbers of shapes are with
    the frequencies' noise but do not move."""
    row = validation(what="without a model, ln Bayes factor of one share by which all frequencies move along a step",
                     reference="dense normal densities, the offset's prior 1e3 of the noise's", why="a flat offset")
    rng, n = np.random.default_rng([3, k]), 12
    n_log = (1, 1 if k == 1 else 3)
    covariance = [np.diag([2e-3] * m) ** 2 + 1e-6 for m in n_log]
    if k == 2:
        covariance[1] = np.diag([2e-3, 3e-3, 1e-3]) ** 2
        covariance[1][0, 1] = covariance[1][1, 0] = 2e-6
    unit = [np.array([1.0, 1.0, 0.0])[:m] for m in n_log]
    step = step_profile(n, 7)
    y = [rng.standard_normal((n, m)) @ np.linalg.cholesky(c).T + step.value[:, None] * 3e-3 * u
         for m, c, u in zip(n_log, covariance, unit, strict=True)]
    noise = Noise(covariance=tuple(covariance), precision=tuple(map(np.linalg.inv, covariance)),
                  weight=(np.ones(n), np.ones(n)))
    found = log_common_change(y, noise, np.ones((n, 1)), [step], [1, k])
    together, values, along = linalg.block_diag(*covariance), np.hstack(y).ravel(), np.concatenate(unit)

    def density(spread):
        total = np.kron(np.eye(n), together) + np.kron(np.ones((n, n)), 1e6 * together)
        total = total + spread**2 * np.kron(np.outer(step.value, step.value), np.outer(along, along))
        return -0.5 * (values @ np.linalg.solve(total, values) + np.linalg.slogdet(total)[1])

    nothing = density(0)
    each = [density(a) - nothing for a in SPREAD_LOG]
    row.error(found - (np.logaddexp.reduce(each) - np.log(len(each))), below=1e-3, case=k)


def test_a_slow_error_is_no_step(validation):
    """An Ornstein-Uhlenbeck process of twice the noise: least squares that knows noise only finds a step in most."""
    row = validation(what="without a model, a slow error of twice the noise, 300 series: share with a step at 4 "
                          "standard deviations; the same where noise alone is known", reference="no step")
    rng = np.random.default_rng(2)
    hours = np.arange(80.0)
    slow = np.linalg.cholesky(np.exp(-np.abs(hours[:, None] - hours) / 15.0) + 1e-9 * np.eye(80))
    y = rng.standard_normal((300, 1, 80)) + 2.0 * (rng.standard_normal((300, 80)) @ slow.T)[:, None]
    steps = [step_profile(80, at) for at in range(8, 73, 8)]
    found = score(make_contrasts(np.ones((1, 80)), np.ones((80, 1)), steps, hours), y, [[0]])
    white = np.abs(found.size) / np.sqrt(np.array([1 / s.at + 1 / (80 - s.at) for s in steps]))
    row.error(np.mean(np.max(np.abs(found.z[:, 0]), axis=1) > 4), 0.2, "share")
    row.least(np.mean(np.max(white[:, 0], axis=1) > 4), 0.5, "noise alone")


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


def test_a_covariate_that_steps_hides_no_step():
    """Where a column and a step are one and the same neither is distinguishable from the other."""
    column = TimeProfile(kind="covariate", value=frozen_array((np.arange(60) >= 20) - 0.5), column="state")
    nuisance = np.column_stack([np.ones(60), column.value])
    assert not make_contrasts(np.ones((1, 60)), nuisance, [step_profile(60, 20)], np.arange(60.0)).usable[0, 0]


def test_what_sensors_say_of_one_another_is_a_row_with_size_and_time():
    found = SensorFinding(name="gain change", channel="TP-A-x, TP-A-y", size=1.1, std=0.01, since="2026-01-01T06:00Z",
                          message="TP-A changed")
    row = _measured_row(found, ("TP-A-x", "TP-A-y", "TP-B-x"))
    assert (row["cause"], row["channels"], row["since"]) == ("sensor gain", ["TP-A-x", "TP-A-y"], found.since)
    assert row["size"] == pytest.approx(0.1) and row["size_std"] == 0.01 and row["suspected"]
