"""update.json: what is written is read again, and every broken file is one clear line."""

import json
import re
from dataclasses import fields, replace

import numpy as np
import pytest
from updating_cases import LINEAR_HZ
from updating_records import PARAMETERS, posterior_of, record

from probupdate.errors import InputError
from probupdate.model.parameters import Parameters
from probupdate.updating.posterior_file import read_posterior, write_posterior
from probupdate.updating.update_file import (
    ComponentsRecord,
    fit_sentence,
    is_unproven,
    read_update,
)


@pytest.fixture(scope="module")
def update():
    return record()


def same(a, b, where="record"):
    """Deep equality, NaN equal to NaN, arrays by value and type."""
    if isinstance(a, np.ndarray):
        assert isinstance(b, np.ndarray) and a.shape == b.shape and a.dtype == b.dtype, where
        assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), where
        assert not b.flags.writeable, where
    elif hasattr(a, "__dataclass_fields__"):
        assert type(a) is type(b), where
        for f in fields(a):
            same(getattr(a, f.name), getattr(b, f.name), f"{where}.{f.name}")
    elif isinstance(a, tuple):
        assert isinstance(b, tuple) and len(a) == len(b), where
        for k, (x, y) in enumerate(zip(a, b, strict=True)):
            same(x, y, f"{where}[{k}]")
    elif isinstance(a, dict):
        assert set(a) == set(b), where
        for key in a:
            same(a[key], b[key], f"{where}[{key}]")
    elif isinstance(a, float) and np.isnan(a):
        assert isinstance(b, float) and np.isnan(b), where
    else:
        assert a == b and type(a) is type(b), where


def test_everything_written_is_read_again(update, tmp_path):
    again = read_update(update.write(tmp_path / "deep" / "update.json"))
    same(update, again)
    assert again.summary == update.summary
    assert [p.name for p in tmp_path.joinpath("deep").iterdir()] == ["update.json"]


def test_modes_not_used_derived_numbers_and_no_sets_survive_too(update, tmp_path):
    bare = replace(
        update, sets=None, initial_hz=update.initial_hz * [1, np.nan, 1, 1, 1], other_maxima=(0.5, 2.25),
        derived={"k_xy": {"initial": 1.5e8, "step": float("nan"), "prior": 1.0, "map": 2.0}}, pairs=((1, 2), (3, 4)),
        settings={"weights": "α ± 1 %"},
    )
    bare.initial_hz.setflags(write=False)
    same(bare, read_update(bare.write(tmp_path / "u.json")))


@pytest.mark.parametrize(("others", "words"), [
    ((0.001,), "ended at 1 other maximum of the posterior, the nearest as probable as the best: other parameters"),
    ((0.5, 2.25), "ended at 2 other maxima of the posterior, the nearest 0.50 lower in ln p than the best"),
])
def test_other_maxima_are_said_as_probable_or_less_so(update, others, words):
    assert words in replace(update, other_maxima=others).summary


def test_infinite_bounds_and_correlation_of_parameters_survive(update, tmp_path):
    first, *others = update.parameters.items
    correlation = np.eye(len(update.parameters))
    correlation[0, 1] = correlation[1, 0] = 0.2
    parameters = Parameters((replace(first, lower=-np.inf, upper=np.inf, description="a, b"), *others), correlation,
                            held=(("q", 2.0),))
    again = read_update(replace(update, parameters=parameters).write(tmp_path / "u.json")).parameters
    assert again.items == parameters.items and again.held == parameters.held
    assert np.array_equal(again.correlation, parameters.correlation)


def test_the_record_holds_what_the_parts_computed(update):
    printed, anchored = update.scheme("step"), update.scheme("prior")
    for scheme in (printed, anchored):
        assert scheme.theta[0] == pytest.approx(PARAMETERS.initial)
        assert len(scheme.distance_to_map) == len(scheme.theta) == len(scheme.share) + 1
        assert set(scheme.objective) == {"responses", "parameters", "total"}
        total = scheme.objective["responses"] + scheme.objective["parameters"]
        assert scheme.objective["total"] == pytest.approx(total)
        d = scheme.theta[-1] - update.map_theta
        assert scheme.distance_to_map[-1] == pytest.approx(np.sqrt(d @ np.linalg.inv(update.map_covariance) @ d / 3))
    assert anchored.distance_to_map[-1] < 1e-6 < printed.distance_to_map[-1]
    assert printed.closest_iteration == np.argmin(printed.distance_to_map)
    assert update.computed_mode.tolist() == [1, 2, 3, 4, 5]
    assert update.measured_std_hz == pytest.approx(0.01 * LINEAR_HZ)
    assert update.sets is not None and update.sets.ids == ("set 0", "set 1", "set 2")


@pytest.mark.parametrize(("misfit", "fits"), [(40.0, True), (67.0, True), (68.0, False), (400.0, False)])
def test_a_misfit_beyond_three_deviations_of_chi_square_is_said(update, misfit, fits):
    # 40 + 3 sqrt(80) = 66.8 would be the limit for 40; here for 40.1 by the number of responses
    sentence = fit_sentence(replace(update, map_misfit=misfit, n_effective=40))
    limit = 40 + 3 * np.sqrt(80)
    assert ("fits the data within" in sentence) == (misfit <= limit)
    assert fits or f"{np.sqrt(misfit / 40):.1f} times the stated standard deviations" in sentence
    assert fits or "no parameter counts as strongly identified" in sentence


def test_sharp_deviations_that_fit_leave_the_models_error_out(update):
    fine = replace(update, map_misfit=40.0, n_effective=40)
    assert "--discrepancy" not in fit_sentence(fine)
    sharp = replace(fine, measured_std_hz=0.001 * LINEAR_HZ)
    assert "fits the data within" in fit_sentence(sharp) and "--discrepancy" in fit_sentence(sharp)


def test_deviations_that_let_any_model_fit_are_no_test_of_it(update):
    """All frequencies 1.41 times the measured ones, as where each stiffness is in K0 and in its K_<name> too: the model
    discrepancy that was estimated from the misfit took it in, and it was said to fit."""
    fine = replace(update, map_misfit=40.0, n_effective=40)
    for cov, tested in ((0.04, True), (0.14, False)):
        wide = replace(fine, measured_std_hz=cov * LINEAR_HZ, map_hz=np.sqrt(2) * LINEAR_HZ)
        sentence = fit_sentence(wide)
        assert ("41 % off" in sentence) == tested and "fits the data" not in sentence
        assert (f"{100 * cov:.2g} % of the frequencies" in sentence) == (not tested)
        assert ("NOT TESTED" in wide.summary) == (not tested)
        assert ("1.41 times the measured ones" in sentence) == (not tested)
        assert is_unproven(wide) == (not tested)
    alone = replace(fine, measured_std_hz=0.14 * LINEAR_HZ, map_hz=LINEAR_HZ * np.linspace(0.8, 1.3, len(LINEAR_HZ)))
    assert "times the measured ones" not in fit_sentence(alone)
    # what misses the data by one factor says so too
    far = replace(fine, map_misfit=4000.0, map_hz=1.2 * fine.measured_hz)
    assert "1.2 times the measured ones" in fit_sentence(far)


@pytest.mark.parametrize(("off", "std", "words"), [
    (1.009, 0.003, "3.0 of its measurement's"), (1.136, 0.07, "14 % off"), (1.002, 0.003, ""), (0.986, 0.003, "4.7 of"),
])
def test_the_model_is_not_said_to_fit_beside_a_frequency_far_off(update, off, std, words):
    """A discrepancy learnt from the misfit makes any chi-square what is expected, or less where shapes fit closely."""
    hz = np.array(update.measured_hz) * [1.0, off + 1e-6 * (off > 1), 1.0, 1.0, 1.0]
    record = replace(update, map_misfit=40.0, n_effective=40, map_hz=hz, measured_std_hz=0.01 * LINEAR_HZ,
                     identified_std_hz=std * LINEAR_HZ)
    sentence = fit_sentence(record)
    assert ("fits the data" in sentence) == (not words) and words in sentence
    closely = fit_sentence(replace(record, map_misfit=5.0))
    assert ("times closer" in closely) == (not words) and words in closely


def test_what_fits_with_suspect_shapes_is_not_said_to_fit(update):
    fine = replace(update, map_misfit=38.0, n_effective=40)
    assert "fits the data" in fit_sentence(fine)
    suspect = replace(fine, suspected="exchanging F1 and F2 explains more")
    assert "SUSPECT" in suspect.summary and "fits the data" not in suspect.summary
    assert "no proof" in fit_sentence(suspect)
    # what misses the data is said as before
    assert "misses the data" in fit_sentence(replace(suspect, map_misfit=400.0))


def test_advice_does_not_ask_for_what_is_stated(update):
    fine = replace(update, map_misfit=40.0, n_effective=40, measured_std_hz=0.001 * LINEAR_HZ)
    n = len(update.parameters)
    parts = ComponentsRecord(
        names=("identification", "model discrepancy", "sensors", "prior"),
        std=np.outer([0.1, 0.0, 0.2, 0.1], np.ones(n)), source_names=(), source_std=np.zeros((0, n)), measures=(),
        gain=np.zeros((0, n)), responses=(), chi_square=np.zeros(0), expected=np.zeros(0))
    stated = replace(fine, components=parts)
    assert fit_sentence(stated).endswith("posterior widths include the stated error of the model (sensors)")
    far = fit_sentence(replace(stated, map_misfit=400.0))
    assert "the stated error (sensors) does not explain it" in far and "auto" not in far
    assert "--discrepancy auto" in fit_sentence(replace(fine, map_misfit=400.0))
    none = replace(parts, std=np.outer([0.1, 0.0, 0.0, 0.1], np.ones(n)))
    assert fit_sentence(replace(fine, components=none)) == fit_sentence(fine)


def test_a_reading_that_did_not_converge_gives_no_misfit(update):
    printed = replace(update.scheme("step"), converged=False)
    record = replace(update, schemes=(printed, update.scheme("prior")))
    line = next(text for text in record.summary.splitlines() if text.startswith(printed.name))
    assert "gives no estimate" in line and "misfit" not in line
    settled = replace(record, schemes=(replace(printed, converged=True), update.scheme("prior")))
    assert "misfit" in next(text for text in settled.summary.splitlines() if text.startswith(printed.name))


# broken files


def one_line(path):
    with pytest.raises(InputError) as error:
        read_update(path)
    text = str(error.value)
    assert "\n" not in text and str(path) in text
    return text


def test_no_file_and_files_of_other_kinds_are_one_line(tmp_path):
    assert "no such file" in one_line(tmp_path / "missing.json")
    path = tmp_path / "u.json"
    for content in (b"", b"{", b"[]", b"3", b"null", b'"text"', b"{}", b"\xff\xfe\x00", b'{"format": 99}'):
        path.write_bytes(content)
        one_line(path)
    path.write_text('{"format": 99}')
    assert "another version" in one_line(path)


def test_a_file_without_one_of_its_keys_is_one_line(update, tmp_path):
    path = update.write(tmp_path / "u.json")
    content = json.loads(path.read_text())
    for key in content:
        path.write_text(json.dumps({k: v for k, v in content.items() if k != key}))
        assert f"'{key}'" in one_line(path) or key == "format"


def test_values_that_do_not_fit_together_are_one_line(update, tmp_path):
    path = update.write(tmp_path / "u.json")
    good = json.loads(path.read_text())

    def broken(change):
        content = json.loads(json.dumps(good))
        change(content)
        path.write_text(json.dumps(content))
        return one_line(path)

    broken(lambda c: c.update(surplus=1))
    broken(lambda c: c.update(map_theta=c["map_theta"][:2]))
    broken(lambda c: c.update(map_covariance=[[1.0]]))
    broken(lambda c: c.update(map_theta="1 2 3"))
    broken(lambda c: c.update(measured_hz=c["measured_hz"][:3]))
    broken(lambda c: c.update(labels=c["labels"][:3]))
    broken(lambda c: c.update(schemes=c["schemes"][:1]))
    broken(lambda c: c.update(schemes=[]))
    broken(lambda c: c["schemes"][0].pop("theta"))
    broken(lambda c: c["schemes"][0].update(theta=[[1.0, 2.0]]))
    broken(lambda c: c["schemes"][1].update(distance_to_map=[0.0]))
    broken(lambda c: c["schemes"][0].update(at_bound=[True]))
    broken(lambda c: c["parameters"]["items"][0].update(std=-1.0))
    broken(lambda c: c["parameters"]["items"][0].pop("name"))
    broken(lambda c: c["parameters"].update(items=[]))
    broken(lambda c: c["sets"].pop("cov"))
    broken(lambda c: c["sets"].update(theta_map=[[1.0]]))


@pytest.mark.parametrize(("place", "key"), [
    (("parameters", "items", 0), "prior"), (("parameters", "items", 0), "description"),
    (("parameters",), "correlation"), (("schemes", 0), "alpha"), (("sets",), "derived"),
])
def test_a_part_of_an_update_without_a_key_is_named(update, tmp_path, place, key):
    path = update.write(tmp_path / "update.json")
    content = json.loads(path.read_text())
    inner = content
    for part in place:
        inner = inner[part]
    del inner[key]
    path.write_text(json.dumps(content))
    assert ".".join(str(part) for part in place) in one_line(path) and f"'{key}'" in one_line(path)


@pytest.mark.parametrize(("place", "value", "words"), [
    (("schemes", 1, "theta"), None, "schemes.1.theta"),
    (("schemes", 0, "at_bound", 0), 1, "schemes.0.at_bound"),
    (("schemes", 0, "objective"), {}, "step: objective"),
    (("map_covariance", 0, 1), True, "map_covariance"),
    (("measured_hz", 2), {}, "measured_hz"),
    (("schemes", 1, "theta", 0, 0), None, "schemes.1.theta"),
    (("map_theta", 0), None, "map_theta"),
    (("map_covariance", 0, 1), 0.5, "map_covariance"),
    (("initial_mac", 0), 1.5, "initial_mac"),
    (("measured_std_hz", 0), -0.1, "measured_std_hz"),
    (("labels",), ["a"] * 5, "labels"),
    (("labels", 1), "F\n1", "labels"),
    (("fingerprint",), "a\0b", "fingerprint"),
    (("pairs",), {}, "pairs"),
    (("left_out",), "text", "left_out"),
    (("parameters", "held"), {}, "parameters.held"),
    (("format",), True, "format"),
])
def test_a_value_of_another_kind_in_an_update_is_named(update, tmp_path, place, value, words):
    path = update.write(tmp_path / "update.json")
    content = json.loads(path.read_text())
    inner = content
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=re.escape(words)):
        read_update(path)


@pytest.mark.parametrize("names", [("k/1", "k_1", "chain"), ("draw", "E, col", "e, COL"), ("/", "_", "a/b/c")])
def test_draws_of_parameters_of_any_name_are_read_again(update, tmp_path, names):
    """NetCDF keeps slashes for groups; chain and draw are dimensions."""
    draws = np.random.default_rng(1).standard_normal((40, 3))
    found = read_posterior(write_posterior(posterior_of(update, draws, names=names), tmp_path / "posterior.nc"))
    assert found.names == names
    np.testing.assert_array_equal(found.draws, draws)
