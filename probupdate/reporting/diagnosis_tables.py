"""What a diagnosis says of the gain of its findings and of the extended model, and tables of diagnosis.json as they
are."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from probupdate.diagnosis import wording
from probupdate.reporting.elements import MISSING, Column, Element, Items, Notice, Table, decimal, number, percent
from probupdate.updating.identifiability import STRONG


def typeset_with_stop(text: str) -> str:
    """Closed with a full stop; begins as it is written, for names have small letters too."""
    return typeset(text if text.endswith(".") else f"{text}.")


def typeset(text: str) -> str:
    """True plus-minus and minus signs."""
    return re.sub(r"(?<![\w)])-(?=[\d.])", "−", text.replace("+-", "±"))


def changed_parameters(content: Mapping) -> list[str]:
    """"k3 −30 ± 1 %" of the model's own parameters that the record identifies and whose 90 % interval leaves out the
    prior's centre, by an amount worth a word."""
    said = []
    for p in content["parameters"]:
        value, std, shift = (p.get(f"{key}_after", p.get(key)) for key in ("value", "std", "prior_shift"))
        if None in (value, std, shift) or std > STRONG * p["prior_std"] or abs(shift) < wording.LEAST_SHIFT:
            continue
        if abs(value - p["prior"]) > wording.SURPRISING * std:
            size = wording.amount((value - p["prior"]) / (abs(p["prior"]) or 1.0), std / (abs(p["prior"]) or 1.0),
                                  "-" if p["prior"] else p["unit"], wording.SHARES[0] if p["prior"] else "")
            said.append(typeset(f"{p['name']} {size}"))
    return said


def gain_items(findings: Sequence[Mapping]) -> list[Element]:
    gained = [(k, f, f["gain"]) for k, f in enumerate(findings, start=1) if f.get("gain")]
    if not gained:
        return []
    items: list[Element] = [Items(title="Predictive gain on held-out blocks", statements=tuple(
        typeset_with_stop(f"{wording.name_of(f)}: {wording.gain_words(f)}") for _, f, _ in gained))]
    measured = [(str(k), _measure_words(key), *(_measure(key, g[f"{key}_{side}"]) for side in ("before", "after")))
                for k, _, g in gained for key in _paired_measures(g)]
    if measured:
        items.append(Table(caption="Prediction of held-out blocks", rows=tuple(measured), width="half", columns=(
            Column(name="finding"), Column(name="measure", number=False), Column(name="before"),
            Column(name="with it"))))
    sensors = [(str(k), str(r["level"]), percent(r["rms_error_before"], 2), percent(r["rms_error_after"], 2))
               for k, _, g in gained for r in g.get("heldout_sensors", ())]
    if sensors:
        items.append(Table(caption="Prediction at held-out sensors", rows=tuple(sensors), width="half", columns=(
            Column(name="finding"), Column(name="level held out", number=False),
            Column(name="rms error before", unit="% of largest"), Column(name="with it", unit="% of largest"))))
    return items + _fatigue(gained)


def _paired_measures(gain: Mapping) -> list[str]:
    """Measures that a gain holds before and after."""
    return [key.removesuffix("_before") for key in gain if key.endswith("_before")
            and isinstance(gain.get(f"{key.removesuffix('_before')}_after"), int | float)]


def _measure_words(key: str) -> str:
    words = key.replace("_", " ").replace("rms", "root mean square of").replace("max", "largest")
    return words.replace("mac", "MAC").replace("crps", "CRPS of") + (
        " [%]" if "frequency_error" in key else " [-]")


def _measure(key: str, value: float) -> str:
    if "frequency_error" in key:
        return percent(value, 2)
    # MACs differ in their last digits
    return decimal(value, 4) if key.endswith("mac") else number(value)


def _fatigue(gained: Sequence) -> list[Element]:
    """Stress and damage ratios of the members that matter, where they were computed."""
    rows, per = [], ""
    for k, _, gain in gained:
        table = gain.get("fatigue") or {}
        per = table.get("per", per)
        for group, spots in table.items():
            if isinstance(spots, Mapping):
                rows += [(str(k), group, name.replace("_", " "), str(s["place"]), decimal(s["stress_ratio"], 2),
                          *(decimal(s[d], 2) for d in sorted(s) if d.startswith("damage_ratio")))
                         for name, s in spots.items()]
    if not rows or len({len(r) for r in rows}) > 1:
        return []
    slopes = [d for d in sorted(next(s for _, _, g in gained for spots in (g.get("fatigue") or {}).values()
                                     if isinstance(spots, Mapping) for s in spots.values()))
              if d.startswith("damage_ratio")]
    columns = (Column(name="finding"), Column(name="members", number=False), Column(name="spot", number=False),
               Column(name="place", number=False), Column(name="stress ratio", unit="-"),
               *(Column(name=f"damage ratio, {d.rsplit('_', 1)[1].replace('m', 'm = ')}", unit="-") for d in slopes))
    return [Table(caption="Fatigue with the finding over that without it", columns=columns, rows=tuple(rows),
                  note=f"Per {per}." if per else "")]


def extension_items(table: object, *, sampled: bool = False) -> list[Element]:
    """The model with the findings in it: what it says first, then what the estimators make of it side by side, then its
    numbers. `sampled`: the run has a posterior of it, whatever the diagnosis sampled itself."""
    if not isinstance(table, Mapping):
        return []
    if sampled and not (table.get("sampler") or {}).get("asked"):
        left = [s for s in table.get("statements", ()) if not s.startswith("the posterior with the findings was not")]
        table = {**table, "statements": left, "sampler": None}
    said = table.get("statements")
    title = "The extended model"
    first = [Items(title=title, statements=tuple(map(typeset_with_stop, said)))] if said else []
    updated, sampler = table.get("after"), table.get("sampler")
    estimated = _estimators_table(updated, sampler)
    # what stands in these tables or in the statements need not be listed once more
    known = {"statements"} | ({"added"} if table.get("added") else set())
    known |= {"before", "after", "joint", "mean_of_blocks"} if _parameters_by_name(updated) else set()
    rest = {k: v for k, v in table.items() if k not in known}
    if estimated and isinstance(sampler, Mapping):
        rest["sampler"] = {k: v for k, v in sampler.items() if k != "parameters"}
    return [*first, *_added_parameters(table.get("added")), *_parameter_elements(table), *estimated,
            *plain_table(title, rest)]


def _added_parameters(added: object) -> list[Element]:
    """Each finding with its size, and what it is in the extended model."""
    if not isinstance(added, Sequence) or not added:
        return []
    rows = tuple((wording.name_of(f), f["time_profile"], _value_and_std(f["size"], f.get("size_std")),
                  f.get("unit", MISSING), f"{f['as']} {f['parameter']}" if f.get("parameter") else f["as"])
                 for f in added)
    return [Table(caption="Findings included in the model", rows=rows, columns=(
        Column(name="finding", number=False), Column(name="time profile", number=False),
        Column(name="size with standard deviation"), Column(name="unit", number=False),
        Column(name="included as", number=False)))]


def _parameters_by_name(side: object) -> dict[str, Mapping]:
    return {p["name"]: p for p in side.get("parameters", ())} if isinstance(side, Mapping) else {}


def _parameter_elements(table: Mapping) -> list[Element]:
    """Every parameter in the update of the mean: of the model as it is, and with the findings in it."""
    before, after = (_parameters_by_name(table.get(side)) for side in ("before", "after"))
    if not after:
        return []
    rows = []
    for name, p in after.items():
        old = before.get(name, {})
        rows.append((name, _value_and_std(p.get("prior"), p.get("prior_std")),
                     _value_and_std(old.get("map"), old.get("std")), _value_and_std(p["map"], p["std"]),
                     number(p.get("deterministic")), decimal(old.get("prior_shift"), 2),
                     decimal(p.get("prior_shift"), 2), "yes" if p.get("at_bound") else "no"))
    columns = (Column(name="parameter", number=False), Column(name="prior"), Column(name="MAP, model as it is"),
               Column(name="MAP, with the findings"), Column(name="deterministic, with the findings"),
               Column(name="shift from the prior, as it is", unit="prior std"),
               Column(name="shift, with the findings", unit="prior std"), Column(name="at a bound", number=False))
    return [Table(caption="Parameters without and with the findings in the model", columns=columns, rows=tuple(rows),
                  note=_update_words(table))]


def _update_words(table: Mapping) -> str:
    """How both models fit, and which update did not settle."""
    sides = [(words, side) for words, side in (("as it is", table.get("before")), ("with the findings", table["after"]))
             if isinstance(side, Mapping)]
    misfit = " and ".join(f"{number(side['misfit'])} ({words})" for words, side in sides if "misfit" in side)
    responses, n_set = table["after"].get("effective_responses"), table.get("mean_of_blocks")
    said = [f"Misfit {misfit}" + (f" of {responses} effective responses" if responses is not None else "")
            + (f", for the mean of {n_set} sets" if n_set else "") + "."] if misfit else []
    said += [f"The deterministic update of the model {words} did not converge." for words, side in sides
             if side.get("settled") is False]
    return " ".join(said)


def _estimators_table(updated: object, sampler: object) -> list[Element]:
    """Deterministic update, maximum with Laplace's standard deviations and emcee of every parameter; nothing without a
    chain."""
    if not (isinstance(updated, Mapping) and isinstance(sampler, Mapping) and sampler.get("parameters")):
        return []
    drawn = {p["name"]: p for p in sampler["parameters"]}
    rows = []
    for p in updated.get("parameters", ()):
        d = drawn.get(p["name"], {})
        rows.append((p["name"], _value_and_std(p.get("prior"), p.get("prior_std")), number(p["deterministic"]),
                     _value_and_std(p["map"], p["std"]), _value_and_std(d.get("mean"), d.get("std")),
                     *(number(d.get(q)) for q in ("q05", "q50", "q95")), decimal(d.get("r_hat"), 3),
                     decimal(d.get("effective_draws"), 0)))
    columns = (Column(name="parameter", number=False), Column(name="prior"), Column(name="deterministic"),
               Column(name="MAP with Laplace's standard deviation"), Column(name="emcee, mean with standard deviation"),
               Column(name="5 %"), Column(name="50 %"), Column(name="95 %"), Column(name="R-hat", unit="-"),
               Column(name="effective draws"))
    how = (f"{sampler['draws']} draws, acceptance {decimal(sampler['acceptance'], 2)}; asked for "
           f"{sampler['effective_draws_asked']} effective draws in at most {sampler['steps_at_most']} steps. ")
    items: list[Element] = [Table(caption="The estimators with the findings in the model", columns=columns,
                                 rows=tuple(rows), note=typeset(how + sampler["verdict"]))]
    if not sampler["converged"]:
        items.append(Notice(level="warning", text="The chain has not converged: its means and intervals are "
                            "provisional."))
    return items


def _value_and_std(value: float | None, std: float | None) -> str:
    return MISSING if value is None else f"{number(value)} ± {number(std)}"


def plain_table(caption: str, table: object) -> list[Element]:
    """Numbers and words of a table of diagnosis.json; tables within it each on their own."""
    if not isinstance(table, Mapping) or not table:
        return []
    simple = tuple((k.replace("_", " "), _cell(v)) for k, v in table.items() if isinstance(v, str | int | float))
    items: list[Element] = []
    if simple:
        items.append(Table(caption=caption, rows=simple, width="half",
                           columns=(Column(name="what", number=False), Column(name="value", number=False))))
    for key, value in table.items():
        words = f"{caption}: {key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            items += plain_table(words, value)
        elif isinstance(value, list) and value:
            items += row_table(words, value)
    return items


def row_table(caption: str, rows: Sequence) -> list[Element]:
    if not rows:
        return []
    if all(isinstance(r, str) for r in rows):
        return [Items(title=caption, statements=tuple(map(typeset_with_stop, rows)))]
    rows = [r for r in rows if isinstance(r, Mapping)]
    keys = [k for k in dict.fromkeys(k for r in rows for k in r)
            if any(isinstance(r.get(k), str | int | float) for r in rows)]
    if not keys:
        return []
    columns = tuple(Column(name=k.replace("_", " "), number=not any(isinstance(r.get(k), str | bool) for r in rows))
                    for k in keys)
    return [Table(caption=caption, columns=columns, rows=tuple(tuple(_cell(r.get(k)) for k in keys) for r in rows))]


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return number(value)
    return value if isinstance(value, str) else MISSING
