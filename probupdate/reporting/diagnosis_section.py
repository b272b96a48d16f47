"""The section on what the simulation or the measurement gets wrong, from diagnosis.json of the run; absent without."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from statistics import NormalDist

from probupdate.diagnosis import wording
from probupdate.effects.catalogue import OWN_PARAMETER
from probupdate.io.result_table import plural
from probupdate.reporting import figures
from probupdate.reporting.diagnosis_tables import (
    changed_parameters,
    extension_items,
    gain_items,
    plain_table,
    row_table,
    typeset,
    typeset_with_stop,
)
from probupdate.reporting.elements import (
    Column,
    Element,
    Items,
    Notice,
    Picture,
    Section,
    Table,
    Text,
    Tile,
    Tiles,
    decimal,
    number,
    percent,
)
from probupdate.reporting.figures_diagnosis import row_of
from probupdate.reporting.findings import extension_advice
from probupdate.reporting.values import Run

HEADLINES = {
    "named": "Fault identified", "ambiguous": "Several causes are possible",
    "unexplained": "Cause unknown: unexplained", "none": "Nothing beyond tolerances was found",
}
KINDS = ("structural", "environmental", "measurement")
# limits drawn in all, and at least so many places of a cause before another cause gets its second
MOST_SIZES = 30

def diagnosis_section(run: Run) -> Section | None:
    content = run.diagnosis
    if content is None:
        return None
    shown = content["details"].get("residuals")
    items: list[Element] = [_tiles(content), *_actions(content, run.included)]
    if content["notes"]:
        items.append(Items(title="Notes", statements=tuple(map(typeset_with_stop, content["notes"]))))
    hidden = (run.truth or {}).get("effects")
    if hidden:
        items.insert(0, _table_of_hidden_and_found(hidden, wording.words_of_findings(content)))
    if content["findings"]:
        items.append(_findings_table(content))
        items.append(_picture(
            figures.causes(content["findings"]), "causes", "Probability of the cause of each finding (filled) and "
            "of its competing hypotheses (hatched), by their evidence."))
    items += _changes(content["details"].get("changes"))
    items += gain_items(content["findings"])
    items += extension_items(content.get("extension"), included=run.included and run.posterior is not None)
    if shown:
        items += _remaining_elements(content, shown)
    items += _prior_shifts(content, shown)
    items += _measurement(content, shown)
    items += _detectable_sizes(content)
    level = "warning" if content["verdict"] != "none" else "plain" if changed_parameters(content) else "good"
    title = "What is wrong" if content["parameters"] else "What is wrong in the record"
    return Section(anchor="diagnosis", title=title, items=tuple(items),
                   headline=_headline(content), level=level, lead=wording.verdict_words(content))


def _headline(content: Mapping) -> str:
    if content["verdict"] == "unexplained" and content["findings"]:
        return "Fault identified, and residuals of unknown cause"
    if content["verdict"] == "none" and (changed := changed_parameters(content)):
        return f"No fault beyond changes of the model's own parameters: {', '.join(changed)}"
    if content["verdict"] == "named" and len(content["findings"]) > 1:
        return f"{len(content['findings'])} faults identified"
    return HEADLINES[content["verdict"]]


def _picture(figure, name: str, caption: str, width: str = "full") -> Picture:
    return Picture(svg=figures.svg_text(figure, name), caption=caption, width=width)


def _tiles(content: Mapping) -> Tiles:
    findings = content["findings"]
    adequacy = content.get("adequacy_p")
    shown = [
        Tile(label="verdict", value=content["verdict"], level="good" if content["verdict"] == "none" else "warning",
             detail=plural(len(findings), "finding")),
        Tile(label="chance of a record like this with nothing wrong",
             value=wording.probability_words(content["p_value"]),
             detail="of the whole search, its largest score against a bootstrap"
             + (f"; {words}" if (words := wording.threshold_words(content)) else "")),
    ]
    if adequacy is not None:
        shown.append(Tile(label="is the rest explained?", value=wording.probability_words(adequacy),
                          level="warning" if adequacy < 0.01 else "good", detail=wording.adequacy_words(content)))
    return Tiles(items=tuple(shown))


def _actions(content: Mapping, included: bool) -> list[Element]:
    """What to do next: the check of each finding, what would split an ambiguity, where to look otherwise."""
    statements = []
    for f in content["findings"]:
        check = f.get("check")
        if check:
            statements.append(f"{wording.name_of(f)}: {check}.")
    statements += [typeset_with_stop(s) for s in content.get("splits", ())]
    nearest = wording.nearest_words(content)
    if content["verdict"] == "unexplained" and content["parameters"]:
        missing = ("they were fitted to a channel that is wrong" if wording.channel_response_actions(content) else
                   "find what is missing in the model first")
        statements.append(f"Do not read the updated parameters as properties of the structure: {missing}. The maps "
                          "below show where model and measurement part.")
    if content["verdict"] == "unexplained" and nearest:
        statements.append(typeset_with_stop(nearest))
    statements += [typeset_with_stop(s) for s in wording.free_form_words(content)]
    if included:
        statements.append("Update and posterior of this run have the findings in them.")
    elif content.get("extended_model"):
        statements += extension_advice(content, "Update and sample again")
    if content["verdict"] == "none":
        statements.append("No fault is to be looked for. Effects below the minimum detectable sizes, listed "
                          "further down, may be present.")
    return [Items(title="What to do", statements=tuple(statements))] if statements else []


def _table_of_hidden_and_found(hidden: Sequence[str], found: Sequence[str]) -> Table:
    rows = [(h, typeset(f)) for h, f in zip_longest(hidden, found, fillvalue="-")]
    return Table(caption="Hidden in this virtual campaign, and found by the diagnosis",
                 columns=(Column(name="hidden", number=False), Column(name="found", number=False)), rows=tuple(rows),
                 note="Each in its own order. Sizes of findings are changes from the neutral value: a factor of 0.75 "
                      "is −25 %.")


def _findings_table(content: Mapping) -> Table:
    rows = tuple(
        (str(k), f["kind"], wording.name_of(f),
         typeset(wording.size_words(f, content)),
         wording.time_profile_words(f.get("time_profile", "constant"), f.get("since", "")), decimal(f.get("z"), 1),
         decimal(f["posterior_probability"], 2), number(wording.prior_probability(f), 2), wording.alternatives_words(f))
        for k, f in enumerate(content["findings"], start=1)
    )
    columns = (Column(name="no."), Column(name="kind", number=False), Column(name="cause, place", number=False),
               Column(name="size with standard "
                           "deviation"), Column(name="time profile", number=False), Column(name="z", unit="-"),
               Column(name="posterior probability", unit="-"), Column(name="prior probability", unit="-"),
               Column(name="or else", number=False))
    return Table(caption="Findings, in the order in which they were included", columns=columns, rows=rows,
                 note="A size is what goes beyond the drawing or data sheet; its standard deviation counts "
                      "tolerances, what else is normal and the model's own error. z: the score at which it was found, "
                      "in standard deviations of the noise alone, which is why it may be much larger than size over "
                      "standard deviation. Both probabilities are among its competing hypotheses, the prior one by "
                      "the catalogue's odds; there is none where nothing was about as probable in its place.")


def _changes(changes: object) -> list[Element]:
    """What changed along the record, where no model was there to say what it means: a table a change."""
    items: list[Element] = []
    for change in changes if isinstance(changes, list) else ():
        words = wording.time_profile_words(str(change.get("time_profile", "")), str(change.get("since", "")))
        for key, value in change.items():
            if isinstance(value, list) and value:
                items += row_table(f"What changed {words}: {key.replace('_', ' ')}", value)
    return items


# What remains -------------------------------------------------------------------------------------------------------


def _remaining_elements(content: Mapping, shown: Mapping) -> list[Element]:
    states = shown["states"]
    both = len(states) > 1
    then = " before and after the findings are included" if both else ""
    items: list[Element] = [Text(paragraphs=(
        f"Residuals of the measurement after the best update of the model,{then or ' which found nothing'}. Bands "
        "and standard deviations hold noise, tolerances and model discrepancy, less what the fit itself absorbed.",
    ))]
    items.append(_picture(figures.mode_residuals(shown["modes"], states), "moderest",
                          "Frequencies: measured less model on average. Bars hold 90 % when nothing is wrong. A close "
                          "pair has two fixed axes and the coupling between them, as its modes turn in their plane."))
    if any(row["channels"] for row in shown["channels"]):
        items.append(_picture(figures.residual_map(shown["channels"], states), "restmap",
                              "Shapes, mode by channel: colour in standard deviations of normal variation, numbers "
                              "(from two of them) in per cent of the shape's largest component. A row of one colour is "
                              "a sensor; a column, the structure."))
    if shown.get("sensors"):
        items.append(_picture(figures.residual_layout(shown["sensors"], shown["channels"], states), "restplace",
                              "The same at the sensors' places, each level from above: a channel's arrow has the "
                              "colour of the mode of its largest residual."))
    since = [f["since"] for f in content["findings"] if f.get("since")]
    time = shown["time"]
    items.append(_picture(
        figures.calendar(time, states, since), "calendar",
        "Along the record, about the mean of each: white before, blue after; grey: 90 % of points when nothing is "
        f"wrong. Shapes: the components that move most; of as many, chance alone gives |z| = {time['by_chance']:.1f} "
        "once in twenty records." + (" Dashed: where a finding begins." if since else "")))
    if shown["covariates"]:
        explained = [f.get("time_profile", "") for f in content["findings"]]
        items.append(_picture(
            figures.against_covariates(shown["covariates"], states, explained), "covariates",
            "Against what was measured beside them, in bins of equally many blocks: of each the mode that follows it "
            "most. Grey: 90 % of points when nothing is wrong."))
        items += _slopes(shown["covariates"], states)
    items.append(_bands_table(shown["bands"], states))
    return items


def _slopes(tables: Sequence[Mapping], states: Sequence[str]) -> list[Element]:
    names = [s["name"] for s in tables[0]["series"]]
    columns = (Column(name="slope of f, z", number=False),
               *(Column(name=wording.column_words(t["column"]), unit="-") for t in tables))
    rows = tuple(
        (name, *(" → ".join(decimal(z, 1) for z in t["series"][i]["slope_z"]) for t in tables))
        for i, name in enumerate(names)
    )
    chance = NormalDist().inv_cdf(1 - 0.025 / (len(names) * len(tables)))
    left = [(t["column"], s["name"], s["slope_z"][-1]) for t in tables for s in t["series"]
            if abs(s["slope_z"][-1] or 0.0) > chance]
    note = f"Of as many, chance alone gives |z| = {chance:.1f} once in twenty records."
    if len(states) > 1:
        note = f"Before → after the findings are included. {note}"
    items: list[Element] = [Table(caption="Does a frequency follow the environmental and operational conditions?",
                                 columns=columns, rows=rows,
                                 note=note, marked=frozenset(names.index(n) for _, n, _ in left))]
    if left:
        statements = tuple(f"{name} follows the {wording.column_words(column)} by more than chance "
                           f"(z = {decimal(z, 1)})."
                           for column, name, z in left)
        items.append(Items(title="Residuals without an identified cause", level="warning", statements=statements))
    return items


def _bands_table(bands: Sequence[Mapping], states: Sequence[str]) -> Table:
    rows = []
    for state, stated in zip(states, bands, strict=True):
        for key, words in (("means", "means over the record"), ("blocks", "single blocks about their mean")):
            b = stated[key]
            if not b["directions"]:
                # one block has no scatter about its mean
                continue
            cells = [f"{percent(b[f'within_{n}'], 0)} ({' to '.join(percent(e, 0) for e in b[f'within_{n}_expected'])})"
                     for n in (50, 90)]
            rows.append((state if len(states) > 1 else "best update", words, str(b["directions"]), *cells,
                         number(b["p"], 2) if "p" in b else ""))
    columns = (Column(name="", number=False), Column(name="of", number=False), Column(name="directions"),
               Column(name="within 50 % bands (expected)", unit="%"),
               Column(name="within 90 % bands (expected)", unit="%"), Column(name="p of all", unit="-"))
    return Table(caption="Coverage of the prediction bands", columns=columns, rows=tuple(rows),
                 note="Along independent directions of the full predictive covariance. More than expected: the bands "
                 "are wider than this record needs, as model form is allowed for; fewer: some residual is unexplained.")


def _prior_shifts(content: Mapping, shown: Mapping | None) -> list[Element]:
    items: list[Element] = []
    if shown:
        stated = shown["prior_shift"]
        if stated["parameters"]:
            together = " → ".join(number(p, 2) for p in stated["p_together"])
            items.append(_picture(
                figures.prior_shifts(stated["parameters"], shown["states"]), "prior_shift",
                "Standardised shift of each parameter from its prior, and how far these data shift it with 90 % "
                "probability "
                f"when its prior is right (grey). All together: p = {together}."))
    sentences = wording.prior_shift_words(content)
    if sentences:
        items.append(Items(title="Parameters far from their priors", level="warning",
                           statements=tuple(map(typeset_with_stop, sentences))))
    return items


def _measurement(content: Mapping, shown: Mapping | None) -> list[Element]:
    items: list[Element] = []
    rows = (shown or {}).get("measurement") or ()
    if rows:
        columns = (Column(name="test", number=False), Column(name="time profile", number=False),
                   Column(name="places tried"), Column(name="largest score at", number=False),
                   Column(name="z", unit="-"),
                   Column(name="size that fits best"), Column(name="tolerance"))
        table = tuple(
            (r["cause"], r["time_profile"], str(r["tried"]), r["location"], decimal(r["z"], 1),
             typeset(wording.amount(r["size"], r["size_std"], r["unit"], r["cause"])),
             wording.amount(r["tolerance"], None, r["unit"].split(" per ")[0], r["cause"]).lstrip("+"))
            for r in rows
        )
        threshold = content.get("threshold")
        note = "At the best update of the model as it is, before any finding is included"
        items.append(Table(caption="The measurement's own tests", columns=columns, rows=table,
                           note=note + (f"; |z| up to {threshold:.1f} is chance." if threshold else ".")))
    stated = content["details"].get("measurement")
    if isinstance(stated, list) and stated:
        said = [r for r in stated if isinstance(r, Mapping) and isinstance(r.get("statement"), str)]
        for suspected, title in ((True, "Suspected in the raw records"), (False, "Raw records without a fault")):
            here = tuple(typeset_with_stop(r["statement"]) for r in said if r.get("suspected", True) is suspected)
            if here:
                items.append(Items(title=title, statements=here, level="warning" if suspected else "plain"))
        items += row_table("Tests of the raw records", [r for r in stated if r not in said])
    elif isinstance(stated, Mapping):
        items += plain_table("Tests of the raw records", stated)
    return items


# Limits -------------------------------------------------------------------------------------------------------------


def chosen_sizes(entries: Sequence[Mapping], most: int = MOST_SIZES) -> list[Mapping]:
    """Of every kind the causes at the places of their least limits, then second places and so on; grouped by cause."""
    found = []
    per_kind = max(1, most // len(KINDS))
    for kind in KINDS:
        by_cause: dict[str, list[Mapping]] = {}
        for x in entries:
            if x["kind"] == kind and x.get("size"):
                by_cause.setdefault(x["cause"], []).append(x)
        for rows in by_cause.values():
            rows.sort(key=lambda x: abs(x["size"]))
        turn, taken = 0, []
        while len(taken) < per_kind and any(len(rows) > turn for rows in by_cause.values()):
            taken += [rows[turn] for rows in by_cause.values() if len(rows) > turn]
            turn += 1
        order = list(by_cause)
        found += sorted(taken[:per_kind], key=lambda x: (order.index(x["cause"]), abs(x["size"])))
    return found


def _detectable_sizes(content: Mapping) -> list[Element]:
    entries = content["detectable_sizes"]
    discrete = [x for x in entries if x["cause"] in wording.DISCRETE and x["time_profile"] == "constant"]
    static = [x for x in entries if x["time_profile"] == "constant" and x["cause"] not in wording.DISCRETE]
    along = [x for x in entries if x["time_profile"] not in ("constant", "step", "ramp")]
    reached = chosen_sizes([*static, *along])
    if not reached:
        return [Notice(level="plain", text="No candidate would be detected, even at its largest possible size.")]
    steps = {row_of(x): x["size"] for x in entries if x["time_profile"] == "step" and x.get("size")}
    count = sum(bool(x.get("size")) for x in entries)
    return [_picture(
        figures.detectable_sizes(reached, steps), "detectable_sizes",
        "The minimum detectable size: found in nine of ten records like this one, all through the record or "
        "with its covariate; diamonds: as a step within the record. Each cause at its best places; all "
        f"{count} are in diagnosis.json."), *_undetectable_notices(static), *_exchanges(discrete)]


def _undetectable_notices(static: Sequence[Mapping]) -> list[Notice]:
    """Candidates that no size they can have would show; the model's own parameters are estimated, not sought."""
    names = sorted({wording.name_of(x) for x in static if not x.get("size") and x["cause"] != OWN_PARAMETER})
    if not names:
        return []
    return [Notice(level="plain", text=(
        f"{plural(len(names), 'candidate')} would not be seen as a constant at any size they can have, among "
        f"them {'; '.join(names[:6])}."))]


def _exchanges(discrete: Sequence[Mapping]) -> list[Notice]:
    if not discrete:
        return []
    hidden = [wording.name_of(x) for x in discrete if not x.get("size")]
    text = f"{plural(len(discrete), 'exchanged or reversed channel')} tested for"
    rest = f"; {len(hidden)} would not be seen, among them {'; '.join(hidden[:6])}." if hidden else \
        ": each would be seen."
    return [Notice(level="plain", text=text + rest)]
