"""The first section (the verdict) and the last (provenance)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from probupdate.diagnosis import wording
from probupdate.io.result_table import plural
from probupdate.modal.modes import ModalData, set_words
from probupdate.model.parameters import Parameter
from probupdate.reporting import figures
from probupdate.reporting.diagnosis_tables import changed_parameters, typeset, typeset_with_stop
from probupdate.reporting.elements import (
    MISSING,
    Column,
    Element,
    Items,
    Notice,
    Picture,
    Section,
    Table,
    Tile,
    Tiles,
    count,
    decimal,
    full_sentence,
    number,
    percent,
)
from probupdate.reporting.findings import (
    MANY_FALLBACKS,
    NEITHER_STATE,
    Finding,
    checks,
    evaluations,
    findings,
    worst_level,
)
from probupdate.reporting.identifiability import (
    BOUND,
    DIAGNOSED,
    KNOWN,
    PARTLY,
    PRIOR,
    contraction,
    estimate,
    identifiabilities,
    names_of,
)
from probupdate.reporting.measurement_sections import count_passing_blocks
from probupdate.reporting.modes_section import MODE_NAMES
from probupdate.reporting.posterior_sections import marks, truth_sentence
from probupdate.reporting.states import NINETY, USE_THIS, changes_within, is_diagnosed, state_table, step_words
from probupdate.reporting.updating_sections import fit_level, meaning, scheme_name
from probupdate.reporting.values import Run
from probupdate.updating.identifiability import BLIND, STRONG
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.update_file import SETS, UpdateRecord, is_uninformative, misses

# a gain in standard deviation below this is not worth a sentence
LEAST_GAIN = 0.05
NOT_DIAGNOSED = "Run `probupdate diagnose`: what model or measurement get wrong has not been looked for in this run."


def verdict_section(run: Run) -> Section:
    found = findings(run)
    cautions = [f.text for f in found] + _caveats(run)
    items: list[Element] = [*_parameters_to_use(run, found), *_findings_list(run)]
    actions = _actions(run, found)
    if actions:
        items.append(Items(title="What to do", statements=actions, width="half"))
    if cautions:
        items.append(Items(title="What not to rely on", statements=tuple(cautions), level=worst_level(found),
                           width="half"))
    if run.diagnosis is not None and run.diagnosis["findings"]:
        items.append(_findings_picture(run.diagnosis, (run.truth or {}).get("effects", ())))
    elif run.update is not None:
        items.append(_errors_picture(run.update, run.posterior))
    shown = len(items)
    if run.update is not None:
        items += [_frequency_table(run.update, run.posterior), _parameter_table(run, run.update)]
    items.append(Tiles(items=tuple(_tiles(run))))
    if run.update is not None:
        if run.diagnosis is not None and run.diagnosis["findings"]:
            items.append(_errors_picture(run.update, run.posterior))
        items.append(_shifts_picture(run, run.update))
    remarks = notable_facts(run)
    if remarks:
        items.append(Items(title="What to keep in mind", statements=tuple(remarks)))
    if run.missing:
        elsewhere = " If records or model lie elsewhere: probupdate report --campaign, --model." if (
            run.campaign is None or run.model is None) else ""
        items.append(Notice(level="missing", text="; ".join(run.missing) + "." + elsewhere))
    level = worst_level(found) if run.update is not None or found else "plain"
    # a run without an update has little more to show: nothing of it is folded
    return Section(anchor="verdict", title="Verdict", items=tuple(items), lead=_lead(run),
                   headline=_headline(run, found), level=level, shown=shown if run.update is not None else len(items))


def conclusion(run: Run) -> list[str]:
    """The first screen in lines: the answer, what is known of the parameters, those to use with their intervals."""
    found, update = findings(run), run.update
    said = [_headline(run, found), *([lead] if (lead := _lead(run)) else [])]
    if update is None:
        return said
    for table in _parameters_to_use(run, found):
        if isinstance(table, Table):
            rows = _plain_rows(run, update)
            if changes_within(run):
                rows = [tuple(column.name for column in table.columns), *table.rows]
            said.append(f"{table.caption}:")
            said += [f"  {'  '.join(cell for cell in row if cell != MISSING)}" for row in rows]
    if run.paper is not None:
        after = {p.name: value for p, value in zip(run.paper.parameters, run.paper.map_theta, strict=True)}
        named = [p.name for p in _informed_parameters(run, update) if p.name in after]
        if named:
            said.append("for comparison, the model as built with the paper's weights: "
                        + ", ".join(f"{name} {number(after[name])}" for name in named))
    return said


def _plain_rows(run: Run, update: UpdateRecord) -> list[Sequence[str]]:
    after, known = estimate(update, run.posterior), (run.truth or {}).get("parameters") or {}
    rows: list[Sequence[str]] = []
    used = [p.name for p in _informed_parameters(run, update)]
    for k, p in enumerate(update.parameters):
        if p.name in used:
            interval = MISSING if after.low is None or after.high is None else (
                f"90 % {number(after.low[k])} to {number(after.high[k])}")
            truth = f"(truth {number(known[p.name])})" if p.name in known else MISSING
            rows.append((f"{p.name:<8}", f"{number(after.theta[k]):>8}", p.unit if p.unit != "-" else MISSING, interval,
                         truth))
    return rows


def _informed_parameters(run: Run, update: UpdateRecord) -> list[Parameter]:
    """Parameters of which the data say something, and no bound decides."""
    found = identifiabilities(update, run.posterior)
    return [p for p, s in zip(update.parameters, found, strict=True) if s.kind in (KNOWN, PARTLY, DIAGNOSED)
            or p.name in _sizes_by_change(run)]


def _sizes_by_change(run: Run) -> dict[str, float]:
    """Parameters that findings became -> the size found: the change within the record, which is their prior here,
    identifies them."""
    added = ((run.diagnosis or {}).get("extension") or {}).get("added", ()) if run.included else ()
    return {one["parameter"]: one["size"] for one in added
            if one["as"] == "parameter" and one["time_profile"] in ("step", "ramp")}


def _parameters_to_use(run: Run, found: tuple[Finding, ...]) -> list[Element]:
    """The parameters with their intervals; of a structure that changed within its record those of each state, and of a
    diagnosis alone those of its own fit."""
    update, changes = run.update, changes_within(run)
    if run.diagnosis is not None and changes and run.diagnosis["parameters"]:
        return [state_table(run.diagnosis, changes)]
    if update is None:
        rows = (run.diagnosis or {}).get("parameters") or ()
        return [_diagnosed_parameters(rows)] if rows else []
    used = [p.name for p in _informed_parameters(run, update)]
    if not used:
        return [Notice(level="plain", text="The data identify none of the parameters.")]
    after, known = estimate(update, run.posterior), (run.truth or {}).get("parameters") or {}
    rows = []
    for k, (p, s) in enumerate(zip(update.parameters, identifiabilities(update, run.posterior), strict=True)):
        if p.name not in used:
            continue
        name = p.name if p.unit in ("", "-") else figures.unit_label(p.name, p.unit)
        # the prior of one that is known by its change is the size found: what it was before
        before = p.initial - _sizes_by_change(run).get(p.name, 0.0)
        row = [f"{name}: {meaning(p, run.jacket).split(';')[0]}".removesuffix(": "), number(before),
               number(after.theta[k])]
        if after.low is not None and after.high is not None:
            row.append(f"{number(after.low[k])} to {number(after.high[k])}")
        row += [percent(after.theta[k] / before - 1, 0, sign=True) if abs(before) > 1e-9 else MISSING,
                "by its change" if s.kind == DIAGNOSED or p.name in _sizes_by_change(run) else s.words.split(" ")[0]]
        rows.append((*row, *([number(known.get(p.name))] if known else [])))
    columns = [Column(name="parameter", number=False), Column(name="before"), Column(name="updated")]
    columns += [Column(name="90 % interval")] if after.low is not None else []
    columns += [Column(name="change", unit="%"), Column(name="identified", number=False)]
    columns += [Column(name="truth")] if known else []
    left = [p.name for p in update.parameters if p.name not in used]
    note = (f"Not to be read as measured: {', '.join(left)} (the data say little of them, or a bound "
            "holds).") if left else ""
    alone = f"results of {set_words(update.set_id)}"
    of_sets = update.settings.get(SETS, "").split(";")[0] or alone
    note = " ".join(filter(None, [full_sentence(of_sets), note, USE_THIS]))
    caption = "Parameters to use, with their intervals"
    if found and found[0].level == "warning":
        caption = ("Parameters of two states together, valid for neither" if step_words(run)
                   else "Parameters, provisional")
    return [Table(caption=caption,
                  columns=tuple(columns), rows=tuple(rows), note=note, width="half")]


def _diagnosed_parameters(parameters: Sequence[Mapping]) -> Table:
    """The model's own parameters at the best fit of a diagnosis, with the findings where there are any."""
    rows = []
    for p in parameters:
        value, std = (p.get(f"{key}_after", p.get(key)) for key in ("value", "std"))
        interval = MISSING if value is None or std is None else (
            f"{number(value - NINETY * std)} to {number(value + NINETY * std)}")
        change = value / p["prior"] - 1 if value is not None and p["prior"] else None
        rows.append((figures.unit_label(p["name"], p["unit"]), f"{number(p['prior'])} ± {number(p['prior_std'])}",
                     number(value), interval, percent(change, 0, sign=True)))
    return Table(caption="Parameters at the best fit", rows=tuple(rows), columns=(
        Column(name="parameter", unit="[unit]", number=False), Column(name="prior ± standard deviation"),
        Column(name="fitted"), Column(name="90 % interval"), Column(name="change", unit="%")),
        note="A change that the model's own parameters describe is here, and among the findings only what these do not "
             "describe.")


def _findings_list(run: Run) -> list[Items]:
    content = run.diagnosis
    if content is None:
        return []
    said = []
    for f in content["findings"]:
        gain = wording.gain_words(f)
        said.append(typeset_with_stop(wording.finding_words(f, content)
                                      + (f"; held-out blocks: {gain}" if gain else "")))
    said += [typeset_with_stop(s) for s in wording.free_form_words(content)]
    if not said:
        said.append(wording.verdict_words(content))
    return [Items(title="What was found", statements=tuple(said), width="half")]


def _actions(run: Run, found: tuple[Finding, ...]) -> tuple[str, ...]:
    content = run.diagnosis
    confirm = checks(content) if content is not None else []
    actions = list(dict.fromkeys([*confirm, *(f.action for f in found if f.action), *_next_measurement(run)]))
    if run.update is not None and not found:
        actions.insert(0, "Use the parameters with their intervals; no check of this run speaks against it."
                       if content is not None else NOT_DIAGNOSED)
    return tuple(actions)


def _caveats(run: Run) -> list[str]:
    if run.update is None:
        return []
    kept = names_of(identifiabilities(run.update, run.posterior), PRIOR)
    kept = [name for name in kept if name not in _sizes_by_change(run)]
    return [f"{', '.join(kept)}: not identified by these data, which leave nearly all of the prior's standard "
            "deviation."] if kept else []


def _next_measurement(run: Run) -> list[str]:
    if run.update is None or run.update.components is None or not run.update.components.measures:
        return []
    parts, names = run.update.components, run.update.parameters.names
    gain = parts.gain[0]
    best = [k for k in np.argsort(-gain)[:3] if gain[k] >= LEAST_GAIN]
    gains = ", ".join(f"{names[k]} by {percent(gain[k], 0)} %" for k in best)
    return [f"If a parameter must be known better: {parts.measures[0]} (narrows {gains})."] if best else []


def _worst_error(measured: np.ndarray, computed: np.ndarray) -> float:
    error = np.abs(computed / measured - 1)
    return float(np.nanmax(error)) if np.any(np.isfinite(error)) else float("nan")


def compared_words(update: UpdateRecord) -> str:
    """How many of the measured modes an error of frequencies is of."""
    n, of = (int(np.isfinite(hz).sum()) for hz in (update.initial_hz, update.measured_hz))
    return f"all {of} measured modes" if n == of else f"{n} of {of} measured modes, the others not compared,"


def _diagnosed_words(run: Run) -> str:
    """What is wrong, as the beginning of a sentence; empty where it was not asked."""
    content = run.diagnosis
    if content is None:
        return ""
    named = "; ".join(typeset(wording.finding_words(f, content)) for f in content["findings"])
    several = len(content["findings"]) > 1
    if content["verdict"] == "none":
        changes = ", ".join(changed_parameters(content))
        # another estimate than the update's, which may stand beside it
        whose = " by the diagnosis" if run.update is not None else ""
        return f"Nothing beyond changes of the model's own parameters was found ({changes}{whose})" if changes else (
            "Nothing beyond tolerances was found")
    if content["verdict"] == "unexplained":
        nearest = wording.nearest_change(content)
        return (f"Cause unknown{f', beside {named}' if named else ''}"
                f"{f'; nearest comes {typeset(nearest)}, which is not established' if nearest else ''}")
    start = "Several causes are possible" if content["verdict"] == "ambiguous" else (
        f"{'Faults' if several else 'Fault'} identified")
    return f"{start}: {named}"


def _headline(run: Run, found: tuple[Finding, ...]) -> str:
    """The answer: what is wrong, whether the model fits with it, and whether the parameters may be used."""
    update = run.update
    start = _diagnosed_words(run)
    if start and run.diagnosis is not None and wording.is_explained(run.diagnosis) and not run.included:
        start += f"; {typeset(wording.adequacy_words(run.diagnosis))}"
    if update is None:
        if start:
            return f"{start}. The model has not been updated in this run."
        done = "Modes were identified; no" if run.modes is not None else "No"
        return f"{done} model has been updated in this run."
    before = percent(_worst_error(update.measured_hz, update.initial_hz))
    after = _error_after_update(update, run.posterior)
    its = f"the model {'with the finding' + ('s' if len(run.diagnosis['findings']) > 1 else '') + ' in it'}" if (
        run.diagnosis is not None and run.included) else "the updated model"
    if changes_within(run):
        its = "the update of this run is" if run.posterior is None else "update and posterior of this run are"
        words = (f"{its} of the sets before and after that together, valid for neither state; the table has "
                 "the parameters of each")
    elif misses(update):
        its += ", without what was found," if is_diagnosed(run) else ""
        ratio = decimal(float(np.sqrt(update.map_misfit / update.n_effective)), 1)
        words = (f"{its} does not fit: it misses the measurement by {ratio} times the stated standard deviations, the "
                 f"worst frequency of {compared_words(update)} by {after} ({before} % before)")
    elif is_uninformative(update):
        words = (f"{its} was not tested: standard deviations this wide let any fit, the worst frequency of "
                 f"{compared_words(update)} is off by {after} ({before} % before)")
    else:
        words = f"{its} fits {compared_words(update)} within {after} ({before} % before)"
    sentence = full_sentence(f"{start}; {words}" if start else words)
    if run.posterior is None:
        sentence += " No posterior was sampled."
    if not found:
        return sentence + (" No check speaks against the parameters." if run.diagnosis is not None
                           else " What model or measurement get wrong has not been looked for.")
    reasons = "; ".join(f.short for f in found if f.level == found[0].level and f.short != NEITHER_STATE)
    if not reasons:
        return sentence
    start = "Do not rely on the parameters yet" if found[0].level == "warning" else "Use the parameters with care"
    return f"{sentence} {start}: {reasons}."


def _error_after_update(update: UpdateRecord, posterior: Posterior | None) -> str:
    """The worst frequency error after the update and of which estimate it is: as `update` has it, and of the posterior
    where that was sampled."""
    chosen, at_map = estimate(update, posterior), percent(_worst_error(update.measured_hz, update.map_hz))
    after = percent(_worst_error(update.measured_hz, chosen.frequency_hz))
    other = f", {at_map} % at the MAP" if posterior is not None and at_map != after else ""
    return f"{after} % at the {chosen.name}{other}"


def _join_names(names: list[str]) -> str:
    return f" ({', '.join(names)})" if names else ""


def _keep(names: list[str]) -> str:
    return "keeps" if len(names) == 1 else "keep"


def _lead(run: Run) -> str:
    if run.update is None or changes_within(run):
        return ""
    found = identifiabilities(run.update, run.posterior)
    known, partly, kept, bound = (names_of(found, kind) for kind in (KNOWN, PARTLY, PRIOR, BOUND))
    changed = [*names_of(found, DIAGNOSED), *(name for name in kept if name in _sizes_by_change(run))]
    kept = [name for name in kept if name not in changed]
    words = (
        f"Of {plural(len(found), 'parameter')} the data identify {len(known)} strongly{_join_names(known)} and "
        f"{len(partly)} weakly{_join_names(partly)}; {len(kept)} {_keep(kept)} the prior{_join_names(kept)}"
    )
    words += f"; of {', '.join(changed)} the diagnosis gives the size, by a change within the record" if changed else ""
    words += f"; {len(bound)} {'is' if len(bound) == 1 else 'are'} at a bound{_join_names(bound)}." if bound else "."
    converged = "" if run.posterior is None else " The sampler converged." if run.posterior.converged else (
        " The sampler did not converge.")
    truth = truth_sentence(run)
    return f"{words}{converged} {truth}" if truth else f"{words}{converged}"


def _tiles(run: Run) -> list[Tile]:
    tiles, update, posterior = [], run.update, run.posterior
    if update is not None:
        chosen = estimate(update, posterior)
        after = _worst_error(update.measured_hz, chosen.frequency_hz)
        first = int(np.nanargmax(np.abs(update.initial_hz / update.measured_hz - 1)))
        tiles.append(Tile(
            label="largest frequency error", level="good" if after < 0.02 else "warning",
            value=f"{percent(_worst_error(update.measured_hz, update.initial_hz))} → {percent(after)} %",
            detail=f"worst mode at first: {update.labels[first]}, measured {update.measured_hz[first]:.3f} Hz, "
            f"computed {update.initial_hz[first]:.3f} → {chosen.frequency_hz[first]:.3f} Hz ({chosen.name})"))
        tiles.append(_fit_tile(update))
        tiles.append(_parameter_tile(update, posterior, _sizes_by_change(run)))
        tiles.append(_update_tile(update))
    if posterior is not None:
        tiles.append(Tile(
            label="posterior (emcee)", level="good" if posterior.converged else "warning",
            value="converged" if posterior.converged else "did not converge",
            detail=f"at least {count(float(np.min(posterior.ess)))} effective draws, R-hat at most "
            f"{decimal(float(np.max(posterior.r_hat)), 3)}"))
    if run.modes is not None:
        tiles.append(_sets_tile(run, run.modes))
    return tiles


def _parameter_tile(update: UpdateRecord, posterior: Posterior | None, by_change: Collection[str]) -> Tile:
    found = identifiabilities(update, posterior)
    size = {kind: len(names_of(found, kind)) for kind in (KNOWN, PARTLY, PRIOR, BOUND)}
    changed = sum(name in by_change for name in names_of(found, PRIOR))
    size[PRIOR], changed = size[PRIOR] - changed, changed + len(names_of(found, DIAGNOSED))
    detail = f"strongly identified; {size[PARTLY]} weakly, {size[PRIOR]} keep the prior"
    detail += f", {changed} by a change in the record" if changed else ""
    if size[BOUND]:
        detail += f", {size[BOUND]} pinned at a bound ({', '.join(names_of(found, BOUND))})"
    return Tile(label="parameters", value=f"{size[KNOWN]} of {len(found)}", detail=detail,
                level="warning" if size[BOUND] else "plain")


def _update_tile(update: UpdateRecord) -> Tile:
    settled = [s for s in update.schemes if s.converged]
    detail = "; ".join(f"{scheme_name(s)}: {'converged' if s.converged else 'did not converge'} after "
                       f"{plural(len(s.theta) - 1, 'iteration')}" for s in update.schemes)
    return Tile(label="deterministic updates", value=f"{len(settled)} of {len(update.schemes)} converged",
                detail=detail, level="good" if len(settled) == len(update.schemes) else
                "plain" if any(s.key == "prior" for s in settled) else "warning")


def _sets_tile(run: Run, modes: ModalData) -> Tile:
    blocks = len(modes.sets)
    identified = sum(bool(s.measured.any()) for s in modes.sets)
    selected = len(run.nine.sets) if run.nine is not None else None
    detail = f"{plural(blocks, 'set')} of {modes.n_mode} modes at {len(modes.channels)} channels"
    if run.selection is not None:
        passed = count_passing_blocks(run.selection)
        detail = f"modes found in {identified} of {blocks} blocks, {passed} pass every criterion"
    if run.update is not None and run.update.set_id not in {s.id for s in modes.sets}:
        # of all sets together, or of a mean that the diagnosis made: none of those selected
        detail += f"; the update is of {run.update.set_id}"
    value = f"{selected} of {blocks}" if selected is not None else str(blocks)
    return Tile(label="sets selected" if selected is not None else "modal sets", value=value, detail=detail)


def _fit_tile(update: UpdateRecord) -> Tile:
    """Misfit in standard deviations per response: 1 is what a true model with right standard deviations would have."""
    ratio = float(np.sqrt(update.map_misfit / update.n_effective))
    return Tile(label="misfit at the most probable parameters", level=fit_level(update),
                value=f"{number(ratio, 2)} standard deviations",
                detail=f"root mean square over {update.n_effective} effective responses; a true model with right "
                "standard deviations has 1")


def mode_words(labels: tuple[str, ...]) -> str:
    """What mode labels mean, for those that have a meaning."""
    known = [f"{label} {MODE_NAMES[label]}" for label in labels if label in MODE_NAMES]
    return f"{', '.join(known)}." if known else ""


def _frequency_table(update: UpdateRecord, posterior: Posterior | None) -> Table:
    after = estimate(update, posterior)
    rows = []
    for j, label in enumerate(update.labels):
        row = [label, decimal(update.measured_hz[j], 3)]
        for hz in (update.initial_hz[j], after.frequency_hz[j]):
            row += [decimal(hz, 3), percent(hz / update.measured_hz[j] - 1, 1, sign=True)]
        rows.append(tuple(row))
    columns = (Column(name="mode", number=False), Column(name="measured", unit="Hz"), Column(name="before", unit="Hz"),
               Column(name="error", unit="%"), Column(name="after", unit="Hz"), Column(name="error", unit="%"))
    words = "most probable parameters (MAP)" if posterior is None else "median of what the posterior predicts"
    return Table(caption="Frequencies before and after", columns=columns, rows=tuple(rows), width="half",
                 note=f"Before: the initial model; after: {words}. {mode_words(update.labels)}".strip())


def _parameter_table(run: Run, update: UpdateRecord) -> Table:
    posterior = run.posterior
    found, after = identifiabilities(update, posterior), estimate(update, posterior)
    meant = any(meaning(p, run.jacket) for p in update.parameters)
    rows = []
    for k, (p, s) in enumerate(zip(update.parameters, found, strict=True)):
        row = [figures.unit_label(p.name, p.unit), *([meaning(p, run.jacket)] if meant else []), s.words,
               number(p.initial), number(after.theta[k])]
        if after.low is not None and after.high is not None:
            row.append(f"{number(after.low[k])} to {number(after.high[k])}")
        rows.append((*row, decimal(s.width, 2), ("+" if s.shift > 0.005 else "") + decimal(s.shift, 1)))
    columns = [Column(name="parameter", unit="[unit]", number=False),
               *([Column(name="meaning", number=False)] if meant else []),
               Column(name="identifiability", number=False), Column(name="before"), Column(name="after")]
    columns += [Column(name="90 % interval")] if after.low is not None else []
    columns += [Column(name="width over prior", unit="-"), Column(name="standardised shift", unit="-")]
    if posterior is not None:
        note = ("After: posterior median, with the interval of the same posterior (5 to 95 %). Width over prior: "
                "posterior over prior standard deviation.")
    else:
        note = ("After: the most probable value (MAP). Width over prior: standard deviation of the Gaussian "
                "approximation at the MAP over the prior's, as nothing was sampled.")
    note = f"{'Of all sets together, which describes neither state. ' if changes_within(run) else ''}{note}"
    note += (f" Strongly identified: below {STRONG}; keeps its prior: above {BLIND}. At a bound the bound decides. "
             "Standardised shift: of the value after, in standard deviations of the prior.")
    return Table(caption="What is known of each parameter", columns=tuple(columns), rows=tuple(rows),
                 note=note, marked=frozenset(k for k, s in enumerate(found) if s.kind == BOUND))


def _findings_picture(diagnosis: Mapping, hidden: Sequence[str]) -> Picture:
    beside = ", beside what was hidden in this virtual campaign" if hidden else ""
    extended = diagnosis.get("extended_model")
    return Picture(
        svg=figures.svg_text(figures.sizes_found(diagnosis["findings"], hidden), "found"), width="half",
        caption=f"What the diagnosis found{beside}: sizes with their 90 % intervals, as changes from the model as it "
        "is (a factor of 0.75 is −25 %)." + (f" The extended model, {extended}, has them in it." if extended else ""),
        alt=" ".join([f"Found: {'; '.join(wording.words_of_findings(diagnosis))}.",
                      *([f"Hidden: {'; '.join(hidden)}."] if hidden else [])]))


def _errors_picture(update: UpdateRecord, posterior: Posterior | None) -> Picture:
    after = estimate(update, posterior)
    used = np.isfinite(update.initial_hz)
    computed = {"initial model": update.initial_hz[used]}
    computed |= {f"updated, {scheme_name(s)}": s.frequency_hz[used] for s in update.schemes}
    if posterior is not None:
        computed[after.name] = after.frequency_hz[used]
    labels = [label for label, here in zip(update.labels, used, strict=True) if here]
    errors = figures.frequency_errors(labels, update.measured_hz[used], computed)
    caption = "How far each computed frequency is from the measured one, before and after the update."
    printed = [_worst_error(update.measured_hz, s.frequency_hz) for s in update.schemes if s.key == "step"]
    if printed and printed[0] < _worst_error(update.measured_hz, after.frequency_hz):
        caption += (f" The update by Eq. 7 as printed comes closer (within {percent(printed[0])} %) than the "
                    f"recommended {after.name}: it penalises only the step from the previous iterate, so that the "
                    "prior loses weight with every iteration and errors of measurement and model are fitted as well. A "
                    "closer fit is not a better estimate; it is not recommended.")
    return Picture(svg=figures.svg_text(errors, "errors"), caption=caption, width="half",
                   alt="Error of each mode's frequency in per cent of the measured one, by state of the model: "
                   f"initial within {percent(_worst_error(update.measured_hz, update.initial_hz))} %, {after.name} "
                   f"within {percent(_worst_error(update.measured_hz, after.frequency_hz))} %.")


def _shifts_picture(run: Run, update: UpdateRecord) -> Picture:
    draws = run.posterior.draws if run.posterior is not None else None
    shifts = figures.parameter_shifts(update.parameters.items, draws, marks(run, update))
    return Picture(svg=figures.svg_text(shifts, "parameter_shifts"),
                   caption="Shift of each parameter. A posterior as wide as the grey bar is not identified by "
                   "the data; estimates far from the posterior's middle are not to be relied on. MAP: the most "
                   "probable parameters.")


def notable_facts(run: Run) -> list[str]:
    """What a reader should know though it forbids nothing."""
    said: list[str] = []
    update, posterior = run.update, run.posterior
    if update is not None:
        for s in update.schemes:
            if s.key != "prior" and not s.converged:
                said.append(f"The update with {scheme_name(s)} did not converge: {s.status}. It penalises the step, "
                            "not the distance from the prior, so that parameters the data do not inform keep drifting.")
            held = [n for n, b in zip(update.parameters.names, s.at_bound, strict=True) if b]
            if held:
                said.append(f"Held at a bound by the update with {scheme_name(s)}: {', '.join(held)}.")
        said += [f"Left out: {t}." for t in update.left_out]
    if posterior is not None and update is not None:
        said += _compensating_pairs(update, posterior)
        evaluated, fallback = evaluations(posterior)
        if 0 < fallback <= MANY_FALLBACKS * evaluated:
            share = number(100 * fallback / evaluated, 2)
            said.append(f"{count(fallback)} of {count(evaluated)} evaluations ({share} %) fell outside "
                        "the reduced basis and were answered by the full model: exact, but slow.")
        said += [full_sentence(t, update.parameters.names) for t in posterior.record.get("notes", ())
                 if t not in update.left_out]
    if run.comparison is not None:
        far = [r.name for r in run.comparison.rows if abs(r.step_distance) > 1]
        if far:
            said.append("The update as printed ends more than one posterior standard deviation from the posterior "
                        "mean in "
                        f"{', '.join(far)}.")
    return said


def _compensating_pairs(update: UpdateRecord, posterior: Posterior) -> list[str]:
    names = update.parameters.names
    if len(names) < 2 or np.any(contraction(update, posterior) == 0):
        return []
    correlation = np.corrcoef(posterior.draws.T)
    close = [f"{names[i]} and {names[j]} ({decimal(correlation[i, j], 2)})" for i in range(len(names))
             for j in range(i) if abs(correlation[i, j]) > 0.9]
    return [f"Known only together (posterior correlation beyond 0.9): {', '.join(close)}."] if close else []


def provenance_section(run: Run) -> Section:
    columns = (Column(name="what", number=False), Column(name="value", number=False))
    items: list[Element] = [Table(caption="Versions, settings and hashes", columns=columns, rows=run.provenance)]
    if run.missing:
        items.append(Items(title="Not found in this run", statements=run.missing))
    return Section(anchor="provenance", title="Provenance", items=tuple(items),
                   lead="What is needed to get these numbers again.")
