"""A diagnosis in an engineer's words, from what diagnosis.json holds: terminal and report say the same."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from statistics import NormalDist

from probupdate.effects.catalogue import OWN_PARAMETER

# causes whose size is a share of something, stated in per cent
SHARES = (
    "brace stiffness lost", "joints loosened", "leg stiffness lost", "soil stiffness", "lateral soil stiffness",
    "axial soil stiffness", "tower stiffness", "leg not flooded", "flooded braces", "sensor gain", "sampling rate",
    "soil softens with amplitude", "crosstalk", "stiffness with temperature", "blade coupling",
)
# changes within the record
CHANGES = ("step", "ramp")
# causes that are there or not: a limit of their size says nothing but that they would be seen
DISCRETE = {"swapped channels": "exchanged", "sensor polarity": "reversed"}
# large units of elementary parts
SCALED = {"N/m": (1e-6, "MN/m"), "kg": (1e-3, "t")}
PROFILE_WORDS = {
    "constant": "all through the record", "ramp": "growing over the record (size at its end)",
    "time_of_day": "with the time of day (amplitude)",
    "water_level_m": "with the water level", "air_temperature_c": "with the air temperature",
    "wind_speed_mps": "with the wind speed", "thrust_share": "with the rotor's thrust",
    "rms_mps2": "with the vibration's amplitude", "wave_height_m": "with the wave height",
    "power_kw": "with the power", "frost_degc": "with frost", "rotor_speed_rpm": "with the rotor's speed",
}
# the chance that a record with right priors has a parameter shifted so far that it is said
# and less than this, in prior standard deviations, is not worth a word
CHANCE_OF_SHIFT, LEAST_SHIFT = 0.1, 0.5
# chance alone makes as much so seldom that "nothing" asks for a word more
SELDOM = 0.01
# prior probability from which a finding has no competing hypotheses to speak of
ALONE = 0.999
# what stands before the commands that estimate with the findings
WITH_FINDINGS = "to estimate with the findings"
NOT_SETTLED = "the fit did not converge: the residuals are too large for the model to follow"
# standard deviations from which a mode is said to show what a sensor does to it
SHOWN = 2.0


def amount(value: float | None, std: float | None, unit: str, cause: str) -> str:
    """A size with its standard deviation: "-36 +- 2 %", "1.2 +- 0.1 m"."""
    if value is None:
        return "of unknown size"
    per = f" {unit.removeprefix('-').strip()}".rstrip()
    if cause in SHARES and unit.startswith("-"):
        value, std, per = 100 * value, None if std is None else 100 * std, f" %{per}"
    if not std:
        return f"{value:+.3g}{per}"
    digits = max(0, 1 - math.floor(math.log10(std)))
    if abs(value) >= 1e5:
        return f"{value:+.3g} +- {std:.2g}{per}"
    return f"{value:+.{digits}f} +- {std:.{digits}f}{per}"


def time_profile_words(time_profile: str, since: str = "") -> str:
    if time_profile == "step":
        return f"from {since} on" if since else "from some block on"
    return PROFILE_WORDS.get(time_profile, f"with {time_profile}")


def column_words(column: str) -> str:
    """"water level" of "water_level_m"."""
    return column.rsplit("_", 1)[0].replace("_", " ")


def name_of(row: Mapping) -> str:
    """"sensor gain, TP-C-y"; "parameter k_1" of the model's own."""
    if row["cause"] == OWN_PARAMETER:
        return f"parameter {row['location']}"
    return f"{row['cause']}, {row['location']}" if row.get("location") else str(row["cause"])


def finding_words(finding: Mapping, content: Mapping) -> str:
    """"sensor gain, TP-C-y: +12.0 +- 0.9 %, all through the record", a finding of this diagnosis.json."""
    profile = time_profile_words(finding.get("time_profile", "constant"), finding.get("since", ""))
    return f"{name_of(finding)}: {size_words(finding, content)}, {profile}"


def nearest_words(content: Mapping) -> str:
    """What was found where it is not enough: its words of `Diagnosis.left_unexplained`; "" where there is nothing."""
    nearest = content["details"].get("nearest")
    if not nearest:
        return ""
    # a change of one of the members that a parameter scales looks like some of its change, and leaves a rest
    single = any(text.startswith("parameter ") for text in nearest)
    return (f"nearest in the catalogue, but not enough (what it states is not established): {'; '.join(nearest)}"
            f"{'. Where a parameter scales several members, give each one of its own: one may have changed' * single}")


def nearest_change(content: Mapping) -> str:
    """The first of what was found where it is not enough, without its probability; "" where there is nothing."""
    nearest = content["details"].get("nearest") or ("",)
    return nearest[0].split(", probability ")[0]


def size_words(finding: Mapping, content: Mapping) -> str:
    """"+12.0 +- 0.9 %"; of the model's own parameters the values before and after, "from 1.29 to 0.91 (-29 +- 3 %)"."""
    size, std, unit = finding["size"], finding.get("size_std"), finding["unit"]
    change = DISCRETE.get(finding["cause"]) or amount(size, std, unit, finding["cause"])
    before = value_before_change(finding, content)
    if before is None or size is None:
        return change
    if before and finding["location"] in _parameters_with_scale(content):
        change = amount(size / abs(before), None if std is None else std / abs(before), "-", SHARES[0])
    per = f" {unit}" if unit not in ("", "-") else ""
    return f"from {before:.3g} to {before + size:.3g}{per} ({change})"


def value_before_change(finding: Mapping, content: Mapping) -> float | None:
    """Of one of the model's own parameters that changed within the record, its value before: as fitted, and with what
    it had changed already. None of other findings."""
    if finding["cause"] != OWN_PARAMETER or finding.get("time_profile") not in CHANGES:
        return None
    fitted = next((p for p in content.get("parameters", ()) if p["name"] == finding["location"]), {})
    value = fitted.get("value_after", fitted.get("value"))
    earlier = [f["size"] for f in content["findings"] if f["cause"] == OWN_PARAMETER and f.get("time_profile") == "step"
               and f["location"] == finding["location"] and f.get("since", "") < finding.get("since", "")]
    return None if value is None or None in earlier else value + sum(earlier)


def _parameters_with_scale(content: Mapping) -> set[str]:
    """Names of those whose change is stated as a share: not of one that is itself a change, with a prior mean of zero.
    """
    return {p["name"] for p in content.get("parameters", ()) if p.get("prior") != 0}


def structural_changes(content: Mapping) -> list[Mapping]:
    """Findings with which the structure itself changed within the record."""
    return [f for f in content.get("findings", ()) if f["kind"] == "structural" and f.get("time_profile") in CHANGES]


def words_of_findings(content: Mapping) -> list[str]:
    """Findings, or the elementary parts of an unknown cause, a line each; empty where there are none."""
    return [finding_words(f, content) for f in content["findings"]] or [
        f"no row, but something like {_with_article(name_of(part))}" for part in _parts(content) if part["elementary"]]


def channel_response_actions(content: Mapping) -> list[str]:
    """What to do about channels with a frequency response of their own; empty where there are none."""
    return [f"{part['location']}: {_channel_response_action(part)}" for part in channel_response_parts(content)]


def channel_response_parts(content: Mapping) -> list[Mapping]:
    """Rows of channels with a frequency response of their own."""
    return [part for part in _parts(content) if "factors" in part]


def _parts(content: Mapping) -> Sequence[Mapping]:
    return content.get("details", {}).get("free_form", {}).get("parts", ())


def part_words(part: Mapping) -> str:
    """"a spring to ground, leg A, z = 2.0 m, along 45 deg: 20 +- 3 MN/m, from ... on; it moves FA1/SS1 by +1.2 %"."""
    if "factors" in part:
        return _channel_response_words(part)
    scale, unit = SCALED.get(part["unit"], (1.0, part["unit"]))
    std = part.get("size_std")
    size = amount(part["size"] * scale, None if std is None else std * scale, unit, part["cause"])
    moved = ", ".join(f"{m['mode']} by {m['frequency_percent']:+.2g} %" for m in part.get("modes", ())[:3])
    words = f"{name_of(part)}: {size}, {time_profile_words(part['time_profile'], part.get('since', ''))}"
    if "frequency_hz" in part:
        words += f", by itself at {part['frequency_hz']:.3g} ± {part['frequency_std_hz']:.1g} Hz"
    if "has_mode" in part:
        own = part["has_mode"]
        words += (f"; it has mode {own['label']} at {own['frequency_hz']:.4g} Hz (computed "
                  f"{own['computed_hz']:.4g} Hz, MAC {own['mac']:.2f})")
    words += f"; it moves {moved}" if moved else ""
    others = [f"{name_of(a)} ({a['posterior_probability']:.2g})" for a in part.get("alternatives", ())]
    return words + (f"; or {', or '.join(others)}" if others else "")


def _channel_response_words(part: Mapping) -> str:
    """"frequency response of its own, TP-A-y, all through the record: T1 factor 1.16 +- 0.02, phase -9.8 +- 0.6 deg,
    ...", modes that do not show it left out."""
    shown = [f"{m['mode']} factor {m['factor']:.2f} ± {m['factor_std']:.2f}, phase {m['phase_deg']:+.1f} ± "
             f"{m['phase_std_deg']:.1f} deg" for m in part["factors"]
             if abs(m["factor"] - 1) > SHOWN * m["factor_std"] or abs(m["phase_deg"]) > SHOWN * m["phase_std_deg"]]
    seen = f": {', '.join(shown)}" if shown else ""
    when = time_profile_words(part["time_profile"], part.get("since", ""))
    return f"{name_of(part)}, {when}{seen}; {_channel_response_action(part)}"


def _channel_response_action(part: Mapping) -> str:
    return f"{part['check']}, and diagnose again without it (--without {shlex.join(part['channels'])})"


def _with_article(words: str) -> str:
    return f"{'an' if words[0] in 'aeiou' else 'a'} {words}"


def free_form_words(content: Mapping) -> list[str]:
    """What elementary parts say of an unknown cause, and whether they predict better."""
    found = content.get("details", {}).get("free_form")
    if not found:
        return []
    said = [f"something like {_with_article(part_words(part))}" if part["elementary"] else f"with {part_words(part)}"
            for part in found["parts"]]
    if any(part["elementary"] for part in found["parts"]):
        said.append(
            "no row of the catalogue is like that; it says where and in which modes the unknown acts, not what it is"
        )
    gain = gain_words(found)
    if gain:
        said.append(f"gain on held-out blocks: {gain}")
    if not found["complete"]:
        said.append("the residuals beside it are still larger than chance allows")
    return said


def nearest_part_words(found: Mapping) -> str:
    """Of elementary parts that predict no better: which come nearest, and that they are not the cause."""
    parts = " and ".join(name_of(part) for part in found["parts"] if part["elementary"])
    return ("no elementary part (a spring, a mass, a mass on springs, a channel's own response) predicts held-out sets "
            f"better than the model as it is; nearest comes {_with_article(parts)}; gain on held-out blocks: "
            f"{gain_words(found)}")


def larger_error_words(error: Mapping[str, float], content: Mapping) -> str:
    """Of a record that is unexplained, what explains it (`content`) if the model is known no better than this."""
    found = "; ".join(finding_words(f, content) for f in content["findings"]) or "nothing beyond that"
    return (f"if the model were known no better than {error_words(error)} (--discrepancy {error['frequency']:g}), the "
            f"record would be explained ({content['verdict']}): {found}; what no row describes passes for the model's "
            "error then, so state it only where that is all it can be")


def probability_words(p: float | None) -> str:
    if p is None:
        return "p unknown"
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"


def verdict_words(content: Mapping) -> str:
    """One sentence: what was found, or not, and what it means."""
    verdict, findings = content["verdict"], content["findings"]
    p = probability_words(content.get("p_value"))
    with_model = bool(content.get("parameters"))
    parted = "Model and measurement disagree" if with_model else "The record deviates from normal variation"
    if verdict == "none" and content.get("p_value") is not None and content["p_value"] < SELDOM:
        out = ("levels do not move as those of a rigid, symmetric structure, which no one sensor explains and a sound "
               "structure may do" if content["details"].get("constant_shapes_unexplained") else
               "what stands out is within them, or no cause is more probable than chance")
        return (f"Nothing was found beyond tolerances, though chance alone seldom differs as much ({p}): {out} (see "
                "the notes); effects below the minimum detectable sizes would not be seen.")
    if verdict == "none":
        return (f"Nothing was found beyond tolerances and chance ({p}); effects below the minimum detectable sizes "
                "would not be seen.")
    lacking = any("has_mode" in part for part in _parts(content))
    if verdict == "unexplained" and lacking and (content.get("p_value") or 0.0) >= SELDOM:
        return (f"The modes that the model has agree with it ({p}), but it lacks one that is in most sets, and no "
                "listed cause has it: numbers from an update of this model carry an unknown error.")
    if verdict == "unexplained" and NOT_SETTLED in content.get("notes", ()):
        return (f"Model and measurement disagree ({p}) where the fit ended, but it did not converge: a better one may "
                "explain all of it; see what misfit `probupdate update` leaves.")
    if verdict == "unexplained":
        rest = "and not all of it has a listed cause" if findings else "and no listed cause explains it"
        meaning = ": numbers from an update of this model carry an unknown error" if with_model else ""
        least = min((p for p in (content.get("p_value"), content.get("adequacy_p")) if p is not None), default=0.0)
        if least >= SELDOM:
            return (f"By scores and residuals alone this record may be chance ({p}), by the notes it is not, "
                    f"{rest}{meaning}.")
        return f"{parted} beyond tolerances and chance ({p}), {rest}{meaning}."
    count = {1: "one effect", 2: "two effects", 3: "three effects"}.get(len(findings), f"{len(findings)} effects")
    limit = _model_error_words(content)
    if verdict == "ambiguous":
        return f"{parted} ({p}) by {count}; for what, several causes look alike{limit}."
    each = "each " if len(findings) > 1 else ""
    return f"{parted} ({p}) by {count}, {each}with a posterior probability of 0.95 or more{limit}."


def error_words(error: Mapping[str, float]) -> str:
    """"0.3 % of a frequency and 1 % of a shape's largest component"."""
    of = {"frequency": "of a frequency", "shape": "of a shape's largest component"}
    return " and ".join(f"{100 * error[k]:.2g} % {words}" for k, words in of.items() if k in error)


def _model_error_words(content: Mapping) -> str:
    """Where what is constant would not be found beside a plausible larger error of the model: at which."""
    limit = content["details"].get("model_error")
    if not limit:
        return ""
    lost = "nothing" if len(limit["lost"]) == len(content["findings"]) else f"no {' and no '.join(limit['lost'])}"
    return (f"; this rests on a model error of {error_words(limit['taken'])}: at {error_words(limit['least'])} {lost} "
            "would be found")


def threshold_words(content: Mapping) -> str:
    """The threshold that decides whether anything is found at all, and of which search it is: those beside a finding
    have one of their own. Empty where none is stated."""
    value = content.get("threshold")
    if value is None:
        known = "threshold" in content
        return "no threshold: of these sets nothing can be distinguished from what is normal" if known else ""
    if content["details"].get("without_model"):
        return f"threshold |z| = {value:.1f} of the first look, the lower one of frequencies and sensors"
    return f"threshold |z| = {value:.1f} of the whole catalogue, before any finding is included"


def is_explained(content: Mapping) -> bool:
    """Whether findings are named, and what they leave is no more than chance makes."""
    p = content.get("adequacy_p")
    return content["verdict"] == "named" and bool(content["findings"]) and p is not None and p >= SELDOM


def adequacy_words(content: Mapping) -> str:
    p = content.get("adequacy_p")
    if p is None:
        return ""
    rest = "with the findings included" if content["findings"] else "of this model"
    if p < SELDOM:
        return f"residuals {rest} are larger than chance allows ({probability_words(p)}): something else is there"
    return f"residuals {rest} are within what chance allows ({probability_words(p)})"


def prior_probability(finding: Mapping) -> float | None:
    """That of a finding among its competing hypotheses; None where it has none, or next to none."""
    before = finding.get("prior_probability")
    return None if before is None or before > ALONE else before


def cause_probability_words(finding: Mapping) -> str:
    """"probability 0.97 among its competing hypotheses, prior probability 0.33": how much of it came from the data,
    where it has any."""
    p, before = finding.get("posterior_probability"), prior_probability(finding)
    if p is None:
        return "probability unknown"
    if before is None:
        return f"probability {p:.2f}"
    return f"probability {p:.2f} among its competing hypotheses, prior probability {before:.2g}"


def alternatives_words(finding: Mapping) -> str:
    listed = [a for a in finding.get("alternatives", ()) if (a.get("posterior_probability") or 0) > 5e-3]
    return "; ".join(f"{name_of(a)} ({a['posterior_probability']:.2f})" for a in listed[:4])


def gain_words(finding: Mapping) -> str:
    """What the extended model predicts better on held-out blocks; empty where it was not measured."""
    gain = finding.get("gain") or {}
    elpd, se = gain.get("heldout_elpd"), gain.get("heldout_elpd_se")
    if elpd is None or se is None:
        return ""
    if elpd < 2 * se:
        text = f"none that is significant (log score {elpd:+.1f} +- {se:.1f})"
    else:
        text = f"log score better by {elpd:.1f} +- {se:.1f}"
    before, after = gain.get("max_frequency_error_before"), gain.get("max_frequency_error_after")
    # sensors change no frequency
    if before is not None and after is not None and finding.get("kind") != "measurement":
        text += f", largest frequency error {100 * before:.2g} % before, {100 * after:.2g} % after"
        # a mode that is hardly known may move away while those that are well known come nearer
        text += " (larger: the log score weighs every number by how well it is known)" if after > before else ""
    return text


def _expected_shifts(content: Mapping) -> dict[str, list[float]]:
    """Standard deviations of shifts when the priors are right: before and, where there are findings, with them."""
    shown = content.get("details", {}).get("residuals", {}).get("prior_shift", {}).get("parameters", ())
    return {row["name"]: [x or 1.0 for x in row["expected"] or [1.0]] for row in shown}


def surprising_shifts(content: Mapping) -> dict[str, bool]:
    """Parameters shifted from their priors farther than any is in nine of ten records when all priors are right
    -> whether they still are with the findings included."""
    parameters = content.get("parameters", ())
    expected = _expected_shifts(content)
    limit = NormalDist().inv_cdf(1 - CHANCE_OF_SHIFT / (2 * max(len(parameters), 1)))
    found = {}
    for p in parameters:
        shifts = [p.get("prior_shift"), *([p.get("prior_shift_after")] if content["findings"] else [])]
        spreads = expected.get(p["name"], [1.0])
        # the same spread in both states where a file has one alone
        far = [x is not None and abs(x) >= max(limit * spreads[min(k, len(spreads) - 1)], LEAST_SHIFT)
               for k, x in enumerate(shifts)]
        if any(far):
            found[p["name"]] = far[-1] or shifts[-1] is None
    return found


def prior_shift_words(content: Mapping) -> list[str]:
    """The surprising shifts, and what became of each with the findings included."""
    expected, surprising = _expected_shifts(content), surprising_shifts(content)
    sentences = []
    for p in content.get("parameters", ()):
        if p["name"] not in surprising or p.get("prior_shift") is None:
            continue
        before, after = p["prior_shift"], p.get("prior_shift_after")
        text = (f"{p['name']} is shifted from its prior by {before:+.1f} prior standard deviations where "
                f"+-{expected.get(p['name'], [1.0])[0]:.1f} is expected")
        if content["findings"] and after is not None:
            text += f", and by {after:+.1f} with the findings included"
        sentences.append(text)
    if sentences and not content["findings"]:
        sentences.append("no effect of the catalogue explains the record better than these values do: either their "
                         "priors are too narrow, or they absorb what no row of it describes")
    return sentences


def best_detectable(content: Mapping, count: int) -> list[Mapping]:
    """Constant effects seen best, each cause at the place of its least limit: those of which what is normal hides
    least."""
    best: dict[str, Mapping] = {}
    for x in content.get("detectable_sizes", ()):
        known = x.get("size") is not None and x.get("share_left") is not None and x.get("time_profile") == "constant"
        known = known and x["cause"] not in DISCRETE
        if known and (x["cause"] not in best or abs(x["size"]) < abs(best[x["cause"]]["size"])):
            best[x["cause"]] = x
    return sorted(best.values(), key=lambda x: (-x["share_left"], x["cause"]))[:count]


def detectable_words(entry: Mapping, content: Mapping) -> str:
    """What of a cause is detected nine times in ten where it is so throughout, and from which size on where it begins
    within the record: what is normal hides much less of a change."""
    fitted = {p["name"]: p.get("value_after", p.get("value")) for p in content.get("parameters", ())}

    def size(row: Mapping) -> str:
        own = row["cause"] == OWN_PARAMETER and row["location"] in _parameters_with_scale(content)
        value = fitted.get(row["location"]) if own else None
        if value:
            share = amount(abs(row["size"] / value), None, "-", SHARES[0])
            return f"{share} of {value:.3g} {row['unit'].removeprefix('-')}".strip().lstrip("+")
        return amount(abs(row["size"]), None, row["unit"], row["cause"]).lstrip("+")

    begun = [size(x) for x in content.get("detectable_sizes", ()) if x["time_profile"] == "step"
             and name_of(x) == name_of(entry) and x.get("size") is not None]
    profile = time_profile_words(entry["time_profile"])
    later = f", {begun[0]} where it begins within the record" if begun else ""
    return f"{name_of(entry)}: {size(entry)} or more {profile}{later}, with 90 % probability of detection"
