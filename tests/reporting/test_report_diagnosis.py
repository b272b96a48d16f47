"""The section of a diagnosis: every verdict in words to act on, every part shown or left out, wrong files refused."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from probupdate.diagnosis import results, wording
from probupdate.errors import InputError
from probupdate.reporting.diagnosis_section import chosen_sizes, diagnosis_section
from probupdate.reporting.figures_diagnosis import size_text
from probupdate.reporting.findings import findings
from probupdate.reporting.page import render
from probupdate.reporting.run_files import read_run
from probupdate.runtime.progress import silent


def section_text(run) -> str:
    return render([diagnosis_section(run)], title=run.title)


@pytest.mark.parametrize(("verdict", "words"), [
    ("named", ("2 faults identified", "joints loosened, face AB, bay 2: inspect the weld toes.", "−62.0 ± 4.0 %",
               "diagnosis.model", "log score better by 41.2 ± 6.0")),
    ("ambiguous", ("Several causes are possible", "telling joints from braces", "0.19")),
    ("unexplained", ("no listed cause explains", "Do not read the updated parameters", "scour, leg A")),
    ("none",
     ("Nothing beyond tolerances was found", "below the minimum detectable sizes", "1 candidate would not be seen",
              "1 exchanged or reversed channel tested for: each would be seen.")),
])
def test_every_verdict_says_what_to_do(full_run, diagnosis_of, unfigured, verdict, words):
    text = section_text(replace(full_run, diagnosis=diagnosis_of(verdict)))
    for word in words:
        assert word in text, word
    assert ("Prediction of held-out blocks" in text) == (verdict in ("named", "ambiguous"))


def test_what_was_pushed_and_what_hid_something_is_said(full_run, unfigured):
    text = section_text(full_run)
    assert ("k_j is shifted from its prior by +2.4 prior standard deviations where ±0.9 is expected, and by +0.3 with"
            in text)
    assert "4 blocks left out in which the nacelle turned." in text


def test_what_is_left_along_a_covariate_is_an_alarm(full_run, diagnosis_of, unfigured):
    content = diagnosis_of("named")
    content["details"]["residuals"]["covariates"][0]["series"][2]["slope_z"][1] = -6.1
    text = section_text(replace(full_run, diagnosis=content))
    assert "FA1/SS1 coupling follows the water level by more than chance (z = −6.1)." in text
    assert "by more than chance" not in section_text(full_run)


def test_the_verdict_of_the_page_mentions_a_finding_before_its_numbers(full_run, diagnosis_of):
    assert any("joints loosened" in f.text for f in findings(full_run))
    assert not any("disagree" in f.text for f in findings(replace(full_run, diagnosis=diagnosis_of("none"))))


def test_nothing_found_is_no_matter_of_chance_where_chance_seldom_makes_as_much(diagnosis_of):
    none = diagnosis_of("none")
    assert "beyond tolerances and chance (p = 0.4)" in wording.verdict_words(none | {"p_value": 0.4})
    seldom = wording.verdict_words(none | {"p_value": 0.00075})
    assert "chance alone seldom differs as much (p = 0.00075)" in seldom and "tolerances and chance" not in seldom


def test_what_is_unexplained_by_its_notes_is_not_said_to_be_beyond_chance(diagnosis_of):
    unexplained = diagnosis_of("unexplained")
    plain = wording.verdict_words(unexplained | {"p_value": 0.02, "adequacy_p": 0.005})
    assert "beyond tolerances and chance (p = 0.02)" in plain
    noted = wording.verdict_words(unexplained | {"p_value": 0.77, "adequacy_p": 0.4})
    assert "may be chance (p = 0.77), by the notes it is not" in noted and "beyond" not in noted


def test_a_fit_that_did_not_converge_is_no_disagreement_beyond_chance(diagnosis_of):
    said = wording.verdict_words(diagnosis_of("unexplained") | {"p_value": 1e-60, "notes": [wording.NOT_SETTLED]})
    assert "a better one may explain all of it" in said and "beyond" not in said


def test_what_to_do_names_the_extended_model_and_its_modes(full_run, diagnosis_of):
    content = diagnosis_of("named") | {"extended_model": "diagnosis.model.toml"}
    extension = {"added": [], "files": {"mean": "diagnosis.mean.json"}}
    run = replace(full_run, diagnosis=content | {"extension": extension})
    action = next(f.action for f in findings(run) if f.short.startswith("the diagnosis found"))
    assert action == ("Update again with diagnosis.model.toml, which has the findings in it, and the modes that belong "
                      "to it, diagnosis.mean.json.")


def test_a_diagnosis_without_a_model_has_no_residuals_and_stands(full_run, diagnosis_of, unfigured):
    content = diagnosis_of("named")
    content |= {"parameters": [], "detectable_sizes": [], "adequacy_p": None,
                "details": {"measurement": [{"test": "clock of T90", "p": 0.3, "wrong": False}],
                            "changes": [{"time_profile": "step", "since": "2020-01-05T00:00Z", "frequencies": [
                                {"mode": "T1", "change_percent": -0.79, "std_percent": 0.04, "z": -20.0}]}]}}
    text = section_text(replace(full_run, diagnosis=content, model=None))
    assert "Tests of the raw records" in text and "clock of T90" in text and "no" in text
    assert "What changed from 2020-01-05T00:00Z on: frequencies" in text and "−0.790" in text
    assert "What is wrong in the record" in text and "The record deviates" in text
    assert diagnosis_section(replace(full_run, diagnosis=None)) is None


def test_an_extension_is_shown_whatever_it_holds(full_run, diagnosis_of, unfigured):
    content = diagnosis_of("named") | {"extension": {
        "identifiable": True, "width": 0.31, "mean_of_blocks": 20,
        "parameters": [{"name": "joint_AB_2", "mean": 0.4, "std": 0.03}],
        "remarks": ["k_t moves back to its prior"], "more": {"chi_square": 12.0}}}
    text = section_text(replace(full_run, diagnosis=content))
    for word in ("The extended model", "yes", "joint_AB_2", "k_t moves back to its prior.", "chi square",
                 ">20<"):
        assert word in text


def test_findings_included_stand_with_what_became_of_them_and_how_to_go_on(full_run, diagnosis_of, unfigured):
    """In the field's words, not by the keys of the file."""
    command = "probupdate sample --model m"
    extension = {
        "added": [{"cause": "joints loosened", "location": "face AB, bay 2", "size": -0.587, "size_std": 0.04,
                   "unit": "-", "time_profile": "step", "as": "parameter", "parameter": "joint_AB_2"}],
        "mean_of_blocks": 15, "joint": {"findings": [], "too_alike": []}, "commands": [command],
        "statements": ["its size is identified", f"{wording.WITH_FINDINGS}: {command}"]}
    run = replace(full_run, diagnosis=diagnosis_of("named") | {"extension": extension})
    text = section_text(run)
    for word in ("Findings included in the model", "joints loosened, face AB, bay 2", "−0.587 ± 0.0400",
                 "parameter joint_AB_2", "Its size is identified", ">15<", command):
        assert word.lower() in text.lower(), word
    assert text.count(command) == 1


@pytest.mark.parametrize(("mistake", "words"), [
    ("{", "not JSON"), ("[]", "is not a JSON table"), ("{}", "has no 'verdict'"),
    (lambda c: c | {"verdict": "perhaps"}, "'perhaps' is none of named, ambiguous"),
    (lambda c: c | {"findings": [{"cause": "scour"}]}, r"has no 'findings\.0\.kind'"),
])
def test_a_wrong_file_is_one_clear_line(diagnosis_of, tmp_path, mistake, words):
    text = mistake if isinstance(mistake, str) else json.dumps(mistake(diagnosis_of("named")))
    (tmp_path / "diagnosis.json").write_text(text)
    with pytest.raises(InputError, match=words):
        read_run(tmp_path, silent)


def test_a_measured_gain_is_shown_before_and_with_the_finding(full_run, diagnosis_of, unfigured):
    content = diagnosis_of("named")
    content["findings"][0]["gain"] |= {"mac_before": 0.98, "mac_after": 0.997, "statement": "better"}
    text = section_text(replace(full_run, diagnosis=content))
    for word in ("Prediction of held-out blocks", "0.9800", "0.9970"):
        assert word in text, word


def test_raw_records_are_told_apart_by_suspicion(full_run, diagnosis_of, unfigured):
    content = diagnosis_of("none")
    content["details"]["measurement"] = [
        {"kind": "measurement", "cause": "clock offset", "channels": ["T90-x"], "statement": "T90: clock of 5 ms",
         "suspected": True},
        {"kind": "measurement", "cause": "sampling rate", "channels": [], "statement": "rotor lines agree",
         "suspected": False, "size": 0.0, "size_std": 1e-4}]
    text = section_text(replace(full_run, diagnosis=content))
    assert text.index("Suspected in the raw records") < text.index("T90: clock of 5 ms.")
    assert text.index("Raw records without a fault") < text.index("rotor lines agree.")
    # no heading with nothing below it
    assert "Tests of the raw records" not in text


def test_limits_drawn_are_of_every_kind_and_cause_first():
    rows = [{"kind": kind, "cause": f"{kind} {c}", "location": str(k), "time_profile": "constant", "size": 1.0 + k + c,
             "unit": "m"} for kind in ("structural", "measurement") for c in range(3) for k in range(9)]
    rows.append({**rows[0], "cause": "beyond reach", "size": None})
    chosen = chosen_sizes(rows, most=12)
    assert len(chosen) == 8 and {x["cause"] for x in chosen} == {x["cause"] for x in rows[:-1]}
    for cause in {x["cause"] for x in chosen}:
        best = min(x["size"] for x in rows if x["cause"] == cause and x["size"])
        assert best in [x["size"] for x in chosen if x["cause"] == cause]


@pytest.mark.parametrize(("value", "std", "unit", "cause", "text"), [
    (-0.364, 0.019, "-", "lateral soil stiffness", "-36.4 +- 1.9 %"), (1.234, 0.1, "m", "scour", "+1.23 +- 0.10 m"),
    (0.101, 0.013, "-", "sensor gain", "+10.1 +- 1.3 %"), (1.0, 0.0, "-", "swapped channels", "+1"),
    (2.87e6, 4e5, "kg m2", "RNA inertia", "+2.87e+06 +- 4e+05 kg m2"),
    (0.21, 0.02, "-", "parameter", "+0.210 +- 0.020"),
    (0.098, 0.01, "- per m", "soil softens with amplitude", "+9.8 +- 1.0 % per m"),
    (None, None, "m", "scour", "of unknown size"),
])
def test_sizes_are_told_with_their_deviation_and_unit(value, std, unit, cause, text):
    assert wording.amount(value, std, unit, cause) == text


def test_a_gain_within_two_errors_is_said_to_be_none():
    gain = {"heldout_elpd": 3.0, "heldout_elpd_se": 2.0}
    assert wording.gain_words({"gain": gain}).startswith("none that is significant")
    assert wording.gain_words({"gain": gain | {"heldout_elpd": 9.0}}).startswith("log score better by 9.0")
    assert wording.gain_words({"gain": {}}) == ""


def test_limits_have_their_unit():
    assert size_text({"size": -0.56, "unit": "-", "cause": "brace stiffness lost"}) == "56 %"
    assert size_text({"size": 42000.0, "unit": "kg", "cause": "nacelle mass"}) == "42\u202f000 kg"
    assert size_text({"size": 1.3, "unit": "-", "cause": "parameter"}) == "1.3"


def test_a_file_with_former_keys_is_read(diagnosis_of, tmp_path):
    """As before `format`: course, limits with limit, pushed."""
    former = {new: old for old, new in results.FORMER_KEYS.items() if old != "limit"}

    def with_former(value):
        if isinstance(value, dict):
            return {former.get(k, k): with_former(v) for k, v in value.items()}
        return [with_former(v) for v in value] if isinstance(value, list) else value

    content = json.loads(json.dumps(diagnosis_of("named"))) | {"format": results.FORMAT}
    old = with_former({k: v for k, v in content.items() if k != "format"})
    old["limits"] = [{"limit" if k == "size" else k: v for k, v in x.items()} for x in old["limits"]]
    (tmp_path / "old.json").write_text(json.dumps(old))
    assert "course" in old["findings"][0] and "limit" in old["limits"][0]
    (tmp_path / "new.json").write_text(json.dumps(content))
    again = results.read_diagnosis(tmp_path / "old.json") | {"format": results.FORMAT}
    assert again == results.read_diagnosis(tmp_path / "new.json")
