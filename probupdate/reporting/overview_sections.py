"""The first section (the verdict) and the last (provenance)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from probupdate.diagnosis import wording
from probupdate.io.result_table import plural
from probupdate.modal.modes import ModalData
from probupdate.reporting import figures
from probupdate.reporting.elements import (
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
    fixed,
    full_sentence,
    number,
    percent,
)
from probupdate.reporting.findings import MANY_FALLBACKS, Finding, evaluations, findings, worst
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
from probupdate.reporting.measurement_sections import passing
from probupdate.reporting.modes_section import MODE_NAMES
from probupdate.reporting.posterior_sections import marks, truth_sentence
from probupdate.reporting.updating_sections import fit_level, meaning, scheme_name
from probupdate.reporting.values import Run
from probupdate.updating.identifiability import BLIND, STRONG
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.update_file import UpdateRecord, blunt, misses

# a gain in standard deviation below this is not worth a sentence
LEAST_GAIN = 0.05


def verdict_section(run: Run) -> Section:
    found = findings(run)
    cautions = [f.text for f in found] + _not_to_be_read(run)
    items: list[Element] = []
    actions = tuple(dict.fromkeys(f.action for f in found if f.action)) + tuple(_next_measurement(run))
    if run.update is not None and not found:
        actions = ("Use the parameters with their intervals; no check of this run speaks against it.", *actions)
    if actions:
        items.append(Items(title="What to do", statements=actions, width="half"))
    if cautions:
        items.append(Items(title="What not to rely on", statements=tuple(cautions), level=worst(found), width="half"))
    if run.diagnosis is not None and run.diagnosis["findings"]:
        items.append(_found_picture(run.diagnosis, (run.truth or {}).get("effects", ())))
    if run.update is not None:
        items.append(_errors_picture(run.update, run.posterior))
    shown = len(items)
    if run.update is not None:
        items += [_before_and_after(run.update, run.posterior), _known_table(run, run.update)]
    items.append(Tiles(items=tuple(_tiles(run))))
    if run.update is not None:
        items.append(_shifts_picture(run, run.update))
    remarks = remarkable(run)
    if remarks:
        items.append(Items(title="What to keep in mind", statements=tuple(remarks)))
    if run.missing:
        elsewhere = " If records or model lie elsewhere: probupdate report --campaign, --model." if (
            run.campaign is None or run.model is None) else ""
        items.append(Notice(level="missing", text="; ".join(run.missing) + "." + elsewhere))
    level = worst(found) if run.update is not None or found else "plain"
    # a run without an update has little more to show: nothing of it is folded
    return Section(anchor="verdict", title="Verdict", items=tuple(items), lead=_lead(run),
                   headline=_headline(run, found), level=level, shown=shown if run.update is not None else len(items))


def _not_to_be_read(run: Run) -> list[str]:
    if run.update is None:
        return []
    kept = names_of(identifiabilities(run.update, run.posterior), PRIOR)
    return [f"{', '.join(kept)}: the data say nothing of {'it' if len(kept) == 1 else 'them'}; what stands there is "
            "the prior."] if kept else []


def _next_measurement(run: Run) -> list[str]:
    if run.update is None or run.update.components is None or not run.update.components.measures:
        return []
    parts, names = run.update.components, run.update.parameters.names
    gain = parts.gain[0]
    best = [k for k in np.argsort(-gain)[:3] if gain[k] >= LEAST_GAIN]
    gains = ", ".join(f"{names[k]} by {percent(gain[k], 0)} %" for k in best)
    return [f"If a parameter must be known better: {parts.measures[0]} (narrows {gains})."] if best else []


def _worst(measured: np.ndarray, computed: np.ndarray) -> float:
    error = np.abs(computed / measured - 1)
    return float(np.nanmax(error)) if np.any(np.isfinite(error)) else float("nan")


def _headline(run: Run, found: tuple[Finding, ...]) -> str:
    """Whether the model fits now, whether the sampler converged, and what speaks against the parameters."""
    update, posterior = run.update, run.posterior
    if update is None:
        done = [words for words, part in (("Modes were identified", run.modes), ("diagnosed", run.diagnosis))
                if part is not None]
        start = f"{' and '.join(done).capitalize()}; no" if done else "No"
        return f"{start} model has been updated in this run."
    which = f"the measurement of {update.set_id}" if update.set_id else "the measurement"
    before = percent(_worst(update.measured_hz, update.initial_hz))
    after = percent(_worst(update.measured_hz, estimate(update, posterior).frequency_hz))
    if misses(update):
        ratio = fixed(float(np.sqrt(update.map_misfit / update.n_effective)), 1)
        words = (f"The updated model does not fit {which}: it misses it by {ratio} times the stated standard "
                 f"deviations, the worst frequency by {after} % ({before} % before).")
    elif blunt(update):
        words = (f"The updated model was not tested by {which}: standard deviations this wide let any fit, the worst "
                 f"frequency is off by {after} % ({before} % before).")
    else:
        words = f"The updated model fits {which}: every frequency within {after} % ({before} % before)."
    if posterior is None:
        words += " No posterior was sampled."
    else:
        words += " The sampler converged." if posterior.converged else \
            " The sampler did NOT converge: its posterior is provisional."
    if not found:
        return f"{words} No check speaks against the parameters."
    reasons = "; ".join(f.short for f in found if f.level == found[0].level)
    start = "Do not rely on the parameters yet" if found[0].level == "warning" else "Use the parameters with care"
    return f"{words} {start}: {reasons}."


def _listed(names: list[str]) -> str:
    return f" ({', '.join(names)})" if names else ""


def _keep(names: list[str]) -> str:
    return "keeps" if len(names) == 1 else "keep"


def _lead(run: Run) -> str:
    if run.update is None:
        return ""
    found = identifiabilities(run.update, run.posterior)
    known, partly, kept, bound = (names_of(found, kind) for kind in (KNOWN, PARTLY, PRIOR, BOUND))
    words = (
        f"Of {plural(len(found), 'parameter')} the data identify {len(known)} strongly{_listed(known)} and "
        f"{len(partly)} weakly{_listed(partly)}; {len(kept)} {_keep(kept)} the prior{_listed(kept)}"
    )
    words += f"; {len(bound)} {'is' if len(bound) == 1 else 'are'} pinned at a bound{_listed(bound)}." if bound else "."
    truth = truth_sentence(run)
    return f"{words} {truth}" if truth else words


def _tiles(run: Run) -> list[Tile]:
    tiles, update, posterior = [], run.update, run.posterior
    if update is not None:
        chosen = estimate(update, posterior)
        after = _worst(update.measured_hz, chosen.frequency_hz)
        first = int(np.nanargmax(np.abs(update.initial_hz / update.measured_hz - 1)))
        tiles.append(Tile(
            label="largest frequency error", level="good" if after < 0.02 else "warning",
            value=f"{percent(_worst(update.measured_hz, update.initial_hz))} → {percent(after)} %",
            detail=f"worst mode at first: {update.labels[first]}, measured {update.measured_hz[first]:.3f} Hz, "
            f"computed {update.initial_hz[first]:.3f} → {chosen.frequency_hz[first]:.3f} Hz ({chosen.name})"))
        tiles.append(_fit_tile(update))
        tiles.append(_parameter_tile(update, posterior))
        tiles.append(_update_tile(update))
    if posterior is not None:
        tiles.append(Tile(
            label="posterior (emcee)", level="good" if posterior.converged else "warning",
            value="converged" if posterior.converged else "NOT converged",
            detail=f"at least {count(float(np.min(posterior.ess)))} effective draws, R-hat at most "
            f"{fixed(float(np.max(posterior.r_hat)), 3)}"))
    if run.modes is not None:
        tiles.append(_sets_tile(run, run.modes))
    return tiles


def _parameter_tile(update: UpdateRecord, posterior: Posterior | None) -> Tile:
    found = identifiabilities(update, posterior)
    size = {kind: len(names_of(found, kind)) for kind in (KNOWN, PARTLY, PRIOR, BOUND)}
    detail = f"strongly identified; {size[PARTLY]} weakly, {size[PRIOR]} keep the prior"
    if size[BOUND]:
        detail += f", {size[BOUND]} pinned at a bound ({', '.join(names_of(found, BOUND))})"
    return Tile(label="parameters", value=f"{size[KNOWN]} of {len(found)}", detail=detail,
                level="warning" if size[BOUND] else "plain")


def _update_tile(update: UpdateRecord) -> Tile:
    settled = [s for s in update.schemes if s.converged]
    detail = "; ".join(f"{scheme_name(s)}: {'settled' if s.converged else 'NOT settled'} after "
                       f"{plural(len(s.theta) - 1, 'iteration')}" for s in update.schemes)
    return Tile(label="deterministic updates", value=f"{len(settled)} of {len(update.schemes)} settled", detail=detail,
                level="good" if len(settled) == len(update.schemes) else
                "plain" if any(s.key == "prior" for s in settled) else "warning")


def _sets_tile(run: Run, modes: ModalData) -> Tile:
    blocks = len(modes.sets)
    identified = sum(bool(s.measured.any()) for s in modes.sets)
    selected = len(run.nine.sets) if run.nine is not None else None
    detail = f"{plural(blocks, 'set')} of {modes.n_mode} modes at {len(modes.channels)} channels"
    if run.selection is not None:
        passed = passing(run.selection)
        detail = f"modes found in {identified} of {blocks} blocks, {passed} pass every criterion"
    value = f"{selected} of {blocks}" if selected is not None else str(blocks)
    return Tile(label="sets used" if selected is not None else "modal sets", value=value, detail=detail)


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


def _before_and_after(update: UpdateRecord, posterior: Posterior | None) -> Table:
    after = estimate(update, posterior)
    rows = []
    for j, label in enumerate(update.labels):
        row = [label, fixed(update.measured_hz[j], 3)]
        for hz in (update.initial_hz[j], after.frequency_hz[j]):
            row += [fixed(hz, 3), percent(hz / update.measured_hz[j] - 1, 1, sign=True)]
        rows.append(tuple(row))
    columns = (Column(name="mode", number=False), Column(name="measured", unit="Hz"), Column(name="before", unit="Hz"),
               Column(name="error", unit="%"), Column(name="after", unit="Hz"), Column(name="error", unit="%"))
    words = "most probable parameters (MAP)" if posterior is None else "median of what the posterior predicts"
    return Table(caption="Frequencies before and after", columns=columns, rows=tuple(rows), width="half",
                 note=f"Before: the initial model; after: {words}. {mode_words(update.labels)}".strip())


def _known_table(run: Run, update: UpdateRecord) -> Table:
    posterior = run.posterior
    found, after = identifiabilities(update, posterior), estimate(update, posterior)
    rows = []
    for k, (p, s) in enumerate(zip(update.parameters, found, strict=True)):
        row = [figures.unit_label(p.name, p.unit), meaning(p, run.jacket), s.words, number(p.initial),
               number(after.theta[k])]
        if after.low is not None and after.high is not None:
            row.append(f"{number(after.low[k])} to {number(after.high[k])}")
        rows.append((*row, fixed(s.width, 2), ("+" if s.shift > 0.005 else "") + fixed(s.shift, 1)))
    columns = [Column(name="parameter", unit="[unit]", number=False), Column(name="meaning", number=False),
               Column(name="the data say", number=False), Column(name="before"), Column(name="after")]
    columns += [Column(name="90 % interval")] if after.low is not None else []
    columns += [Column(name="width over prior", unit="-"), Column(name="standardised shift", unit="-")]
    if posterior is not None:
        note = ("After: posterior median, with the interval of the same posterior (5 to 95 %). Width over prior: "
                "posterior over prior standard deviation.")
    else:
        note = ("After: the most probable value (MAP). Width over prior: standard deviation of the Gaussian "
                "approximation at the MAP over the prior's, as nothing was sampled.")
    note += (f" Strongly identified: below {STRONG}; keeps its prior: above {BLIND}. At a bound the bound decides. "
             "Standardised shift: of the value after, in standard deviations of the prior.")
    return Table(caption="What is known of each parameter", columns=tuple(columns), rows=tuple(rows),
                 note=note, marked=frozenset(k for k, s in enumerate(found) if s.kind == BOUND))


def _found_picture(diagnosis: Mapping, hidden: Sequence[str]) -> Picture:
    beside = ", beside what was hidden in this virtual campaign" if hidden else ""
    extended = diagnosis.get("extended_model")
    return Picture(
        svg=figures.svg_text(figures.sizes_found(diagnosis["findings"], hidden), "found"), width="half",
        caption=f"What the diagnosis found{beside}: sizes with their 90 % intervals, as changes from the model as it "
        "is (a factor of 0.75 is −25 %)." + (f" The extended model, {extended}, has them in it." if extended else ""),
        alt=" ".join([f"Found: {'; '.join(wording.found_words(diagnosis))}.",
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
    printed = [_worst(update.measured_hz, s.frequency_hz) for s in update.schemes if s.key == "step"]
    if printed and printed[0] < _worst(update.measured_hz, after.frequency_hz):
        caption += (f" Eq. 7 as printed comes closer (within {percent(printed[0])} %) than the recommended "
                    f"{after.name}: "
                    "it penalises only the step, so that with every iteration it forgets more of the prior and follows "
                    "errors of measurement and model too. A closer fit is no better estimate; it is not recommended.")
    return Picture(svg=figures.svg_text(errors, "errors"), caption=caption, width="half",
                   alt="Error of each mode's frequency in per cent of the measured one, by state of the model: "
                   f"initial within {percent(_worst(update.measured_hz, update.initial_hz))} %, {after.name} within "
                   f"{percent(_worst(update.measured_hz, after.frequency_hz))} %.")


def _shifts_picture(run: Run, update: UpdateRecord) -> Picture:
    draws = run.posterior.draws if run.posterior is not None else None
    shifts = figures.parameter_shifts(update.parameters.items, draws, marks(run, update))
    return Picture(svg=figures.svg_text(shifts, "parameter_shifts"),
                   caption="Where each parameter went. A posterior as wide as the grey bar has learned nothing from "
                   "the data; estimates far from the posterior's middle are not to be relied on. MAP: the most "
                   "probable parameters.")


def remarkable(run: Run) -> list[str]:
    """What a reader should know though it forbids nothing."""
    said: list[str] = []
    update, posterior = run.update, run.posterior
    if update is not None:
        for s in update.schemes:
            if s.key != "prior" and not s.converged:
                said.append(f"The update with {scheme_name(s)} did not settle: {s.status}. It penalises the step, not "
                            "the distance from the prior, so that parameters the data do not inform keep drifting.")
            held = [n for n, b in zip(update.parameters.names, s.at_bound, strict=True) if b]
            if held:
                said.append(f"Held at a bound by the update with {scheme_name(s)}: {', '.join(held)}.")
        said += [f"Left out: {t}." for t in update.left_out]
    if posterior is not None and update is not None:
        said += _known_together(update, posterior)
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


def _known_together(update: UpdateRecord, posterior: Posterior) -> list[str]:
    names = update.parameters.names
    if len(names) < 2 or np.any(contraction(update, posterior) == 0):
        return []
    correlation = np.corrcoef(posterior.draws.T)
    close = [f"{names[i]} and {names[j]} ({fixed(correlation[i, j], 2)})" for i in range(len(names))
             for j in range(i) if abs(correlation[i, j]) > 0.9]
    return [f"Known only together (posterior correlation beyond 0.9): {', '.join(close)}."] if close else []


def provenance_section(run: Run) -> Section:
    columns = (Column(name="what", number=False), Column(name="value", number=False))
    items: list[Element] = [Table(caption="Versions, settings and hashes", columns=columns, rows=run.provenance)]
    if run.missing:
        items.append(Items(title="Not found in this run", statements=run.missing))
    return Section(anchor="provenance", title="Provenance", items=tuple(items),
                   lead="What is needed to get these numbers again.")
