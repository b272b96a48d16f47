"""What a diagnosis says of the gain of its findings and of the extended model, and tables of diagnosis.json as they
are."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from probupdate.diagnosis import wording
from probupdate.reporting.elements import MISSING, Column, Element, Items, Table, decimal, number, percent
from probupdate.updating.identifiability import STRONG

# half of a 90 % interval in standard deviations
NINETY = 1.645


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
        if abs(value - p["prior"]) > NINETY * std:
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
    return items


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


def extension_items(table: object, *, included: bool = False) -> list[Element]:
    """The model with the findings in it: what it says first, then what became of each finding, then its numbers.
    `included`: the run has estimates with the findings, so that no command for them is said."""
    if not isinstance(table, Mapping):
        return []
    said = [s for s in table.get("statements", ()) if not (included and s.startswith(wording.WITH_FINDINGS))]
    title = "The extended model"
    first = [Items(title=title, statements=tuple(map(typeset_with_stop, said)))] if said else []
    # what stands in a table or in the statements need not be listed once more
    known = {"statements", "commands", "joint"} | ({"added"} if table.get("added") else set())
    return [*first, *_added_parameters(table.get("added")),
            *plain_table(title, {k: v for k, v in table.items() if k not in known})]


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
