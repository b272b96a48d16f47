"""The first section (the verdict) and the last (provenance)."""

from __future__ import annotations

import numpy as np

from probupdate.comparison import BLIND, STRONG
from probupdate.diagnosis.wording import finding_words, verdict_words
from probupdate.estimators.update_file import UpdateRecord, fit_sentence
from probupdate.reporting import figures
from probupdate.reporting.diagnosis_tables import typeset
from probupdate.reporting.elements import (
    Column,
    Items,
    Notice,
    Picture,
    Section,
    Table,
    Tile,
    Tiles,
    count,
    fixed,
    number,
    percent,
    plural,
    sentence,
)
from probupdate.reporting.posterior_sections import marks, truth_sentence
from probupdate.reporting.standing import BOUND, KNOWN, PARTLY, PRIOR, contraction, names_of, standings
from probupdate.reporting.updating_sections import fits, scheme_name
from probupdate.reporting.values import Run

# computed over measured frequency beyond which a pair made by shape is doubted
FAR_OFF = 1.6
# share of evaluations answered by the full model from which the reduced basis did not serve
MANY_FALLBACKS = 0.2


def verdict_section(run: Run) -> Section:
    items: list[object] = []
    alarms = alarming(run)
    if alarms:
        items.append(Items(title="Before these numbers are used", statements=tuple(alarms), level="warning"))
    if run.update is not None:
        items += [_before_and_after(run.update), _known_table(run)]
    items.append(Tiles(items=tuple(_tiles(run))))
    if run.update is not None:
        items += _pictures(run)
    remarks = remarkable(run)
    if remarks:
        items.append(Items(title="What to keep in mind", statements=tuple(remarks)))
    if run.missing:
        items.append(Notice(level="missing", text="; ".join(run.missing) + "."))
    headline, level = _headline(run)
    return Section(anchor="verdict", title="Verdict", items=tuple(items), lead=_lead(run), headline=headline,
                   level=level)


def _worst(measured: np.ndarray, computed: np.ndarray) -> float:
    error = np.abs(computed / measured - 1)
    return float(np.nanmax(error)) if np.any(np.isfinite(error)) else float("nan")


def _headline(run: Run) -> tuple[str, str]:
    """Whether the model fits now and whether the sampler is to be believed, in one or two sentences."""
    update, posterior = run.update, run.posterior
    if update is None:
        done = [words for words, part in (("Modes were identified", run.modes), ("diagnosed", run.diagnosis))
                if part is not None]  # fmt: skip
        found = f"{' and '.join(done).capitalize()}; no" if done else "No"
        return f"{found} model has been updated in this run.", "plain"
    before = percent(_worst(update.measured_hz, update.initial_hz))
    after = percent(_worst(update.measured_hz, update.map_hz))
    good = fits(update)
    if good:
        words = f"The updated model fits the measurement: every frequency within {after} % ({before} % before)."
    else:
        ratio = fixed(float(np.sqrt(update.map_misfit / update.n_effective)), 1)
        words = (f"The updated model does not fit the measurement: it misses it by {ratio} times the stated "
                 f"deviations, the worst frequency by {after} % ({before} % before).")
    if posterior is None:
        return f"{words} No posterior was sampled.", "good" if good else "warning"
    if posterior.converged:
        return f"{words} The sampler converged.", "good" if good else "warning"
    return f"{words} The sampler did NOT converge: its posterior is provisional.", "warning"


def _listed(names: list[str]) -> str:
    return f" ({', '.join(names)})" if names else ""


def _keep(names: list[str]) -> str:
    return "keeps" if len(names) == 1 else "keep"


def _lead(run: Run) -> str:
    if run.update is None:
        return ""
    found = standings(run.update, run.posterior)
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
        after = _worst(update.measured_hz, update.map_hz)
        worst = int(np.nanargmax(np.abs(update.initial_hz / update.measured_hz - 1)))
        tiles.append(Tile(
            label="largest frequency error", level="good" if after < 0.02 else "warning",
            value=f"{percent(_worst(update.measured_hz, update.initial_hz))} → {percent(after)} %",
            detail=f"worst mode at first: {update.labels[worst]}, measured {update.measured_hz[worst]:.3f} Hz, "
            f"computed {update.initial_hz[worst]:.3f} → {update.map_hz[worst]:.3f} Hz"))
        tiles.append(_fit_tile(update))
        tiles.append(_parameter_tile(run))
        tiles.append(_update_tile(update))
    if posterior is not None:
        tiles.append(Tile(
            label="posterior (emcee)", level="good" if posterior.converged else "warning",
            value="converged" if posterior.converged else "NOT converged",
            detail=f"at least {count(float(np.min(posterior.ess)))} effective draws, R-hat at most "
            f"{fixed(float(np.max(posterior.r_hat)), 3)}"))
    if run.modes is not None:
        tiles.append(_sets_tile(run))
    return tiles


def _parameter_tile(run: Run) -> Tile:
    found = standings(run.update, run.posterior)
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


def _sets_tile(run: Run) -> Tile:
    blocks = len(run.modes.sets)
    identified = sum(bool(s.measured.any()) for s in run.modes.sets)
    selected = len(run.nine.sets) if run.nine is not None else None
    detail = f"{plural(blocks, 'set')} of {run.modes.n_mode} modes at {len(run.modes.channels)} channels"
    if run.selection is not None:
        passed = int((run.selection["criterion"].fillna("") == "").sum())
        detail = f"modes found in {identified} of {blocks} blocks, {passed} pass every criterion"
    value = f"{selected} of {blocks}" if selected is not None else str(blocks)
    return Tile(label="sets used" if selected is not None else "modal sets", value=value, detail=detail)


def _fit_tile(update: UpdateRecord) -> Tile:
    """Misfit in standard deviations per response: 1 is what a true model with right deviations would have."""
    ratio = float(np.sqrt(update.map_misfit / update.n_effective))
    return Tile(label="misfit at the most probable parameters", level="good" if fits(update) else "warning",
                value=f"{number(ratio, 2)} deviations",
                detail=f"root mean square over {update.n_effective} effective responses; a true model with right "
                "deviations has 1")


def _before_and_after(update: UpdateRecord) -> Table:
    rows = []
    for j, label in enumerate(update.labels):
        row = [label, fixed(update.measured_hz[j], 3)]
        for hz in (update.initial_hz[j], update.map_hz[j]):
            row += [fixed(hz, 3), percent(hz / update.measured_hz[j] - 1, 1, sign=True)]
        rows.append(tuple(row))
    columns = (Column(name="mode", number=False), Column(name="measured", unit="Hz"), Column(name="before", unit="Hz"),
               Column(name="error", unit="%"), Column(name="after", unit="Hz"), Column(name="error", unit="%"))
    return Table(caption="Frequencies before and after", columns=columns, rows=tuple(rows), width="half",
                 note="Before: the initial model; after: at the most probable parameters (MAP).")


def _known_table(run: Run) -> Table:
    update, posterior = run.update, run.posterior
    found = standings(update, posterior)
    rows = []
    for k, (p, s) in enumerate(zip(update.parameters, found, strict=True)):
        row = [figures.unit_label(p.name, p.unit), s.words, number(p.initial), number(update.map_theta[k])]
        if posterior is not None:
            low, high = np.percentile(posterior.draws[:, k], [5, 95])
            row.append(f"{number(low)} to {number(high)}")
        rows.append((*row, fixed(s.width, 2)))
    columns = [Column(name="parameter", unit="[unit]", number=False), Column(name="the data say", number=False),
               Column(name="before"), Column(name="after")]
    columns += [Column(name="90 % interval")] if posterior is not None else []
    columns.append(Column(name="width over prior", unit="-"))
    note = "After: the most probable value (MAP). Width over prior: posterior over prior deviation"
    note += "." if posterior is not None else " of the Gaussian at the maximum, as nothing was sampled."
    note += f" Strongly identified: below {STRONG}; keeps its prior: above {BLIND}. At a bound the bound decides."
    return Table(caption="What is known of each parameter", columns=tuple(columns), rows=tuple(rows), width="half",
                 note=note, marked=frozenset(k for k, s in enumerate(found) if s.kind == BOUND))


def _pictures(run: Run) -> list[object]:
    update = run.update
    used = np.isfinite(update.initial_hz)
    computed = {"initial model": update.initial_hz[used]}
    computed |= {f"updated, {scheme_name(s)}": s.frequency_hz[used] for s in update.schemes}
    labels = [label for label, here in zip(update.labels, used, strict=True) if here]
    draws = run.posterior.draws if run.posterior is not None else None
    errors = figures.frequency_errors(labels, update.measured_hz[used], computed)
    departures = figures.departures(update.parameters.items, draws, marks(run))
    return [
        Picture(svg=figures.svg_text(errors, "errors"),
                caption="How far each computed frequency is from the measured one, before and after the update."),
        Picture(svg=figures.svg_text(departures, "departures"),
                caption="Where each parameter went. A posterior as wide as the grey bar has learned nothing from the "
                "data; estimates far from the posterior's middle are not to be trusted. MAP: the most probable "
                "parameters."),
    ]


def alarming(run: Run) -> list[str]:
    """What forbids taking the numbers as they stand: strangers together, misfit, no convergence, bounds, fallbacks."""
    said = list(run.warnings)
    update, posterior = run.update, run.posterior
    if update is not None and not fits(update):
        text = fit_sentence(update)
        said.append(sentence(text))
    if posterior is not None and not posterior.converged:
        said.append(posterior.verdict)
    if run.diagnosis is not None and run.diagnosis["verdict"] != "none":
        named = "; ".join(finding_words(f) for f in run.diagnosis["findings"])
        said.append(typeset(f"{verdict_words(run.diagnosis)}{f' Found: {named}.' if named else ''}"))
    if update is not None:
        said += _far_off(update)
        said += _pinned(run)
        if update.other_maxima:
            said.append("The posterior has more than one maximum: the most probable parameters are not the only ones "
                        "that explain the data.")
        for s in update.schemes:
            if s.key == "prior" and not s.converged:
                said.append(f"The update with {scheme_name(s)} did not settle: {s.status}.")
    if posterior is not None:
        evaluated, fallback = int(posterior.record.get("evaluated", 0)), int(posterior.record.get("fallback", 0))
        if fallback > MANY_FALLBACKS * evaluated:
            said.append(f"{count(fallback)} of {count(evaluated)} evaluations fell outside the reduced basis and "
                        "were answered by the full model: exact, but the basis does not cover where the chain went.")
    return said


def _pinned(run: Run) -> list[str]:
    update = run.update
    held = [(p.name, value, s.words) for p, value, s in
            zip(update.parameters, update.map_theta, standings(update, run.posterior), strict=True) if s.kind == BOUND]
    if not held:
        return []
    where = ", ".join(f"{name} {words} of {number(value)}" for name, value, words in held)
    return [f"Pinned at the most probable parameters: {where}. A value at a bound is the bound's, not the data's: see "
            "whether the bound is right or the model lacks something."]


def remarkable(run: Run) -> list[str]:
    """What a reader should know though it forbids nothing."""
    said: list[str] = []
    update, posterior = run.update, run.posterior
    if update is not None:
        said += _too_close(update)
        for s in update.schemes:
            if s.key != "prior" and not s.converged:
                said.append(f"The update with {scheme_name(s)} did not settle: {s.status}. It penalises the step, not "
                            "the distance from the prior, so that parameters the data do not inform keep drifting.")
            held = [n for n, b in zip(update.parameters.names, s.at_bound, strict=True) if b]
            if held:
                said.append(f"Held at a bound by the update with {scheme_name(s)}: {', '.join(held)}.")
        said += [f"Left out: {t}." for t in update.left_out]
    if posterior is not None and update is not None:
        kept = names_of(standings(update, posterior), PRIOR)
        if kept:
            said.append(f"Not informed by the data, so the posterior is the prior: {', '.join(kept)}.")
        said += _known_together(run)
        evaluated, fallback = int(posterior.record.get("evaluated", 0)), int(posterior.record.get("fallback", 0))
        if 0 < fallback <= MANY_FALLBACKS * evaluated:
            share = number(100 * fallback / evaluated, 2)
            said.append(f"{count(fallback)} of {count(evaluated)} evaluations ({share} %) fell outside "
                        "the reduced basis and were answered by the full model: exact, but slow.")
        said += [sentence(t, update.parameters.names) for t in posterior.record.get("notes", ())
                 if t not in update.left_out]  # fmt: skip
    if run.comparison is not None:
        far = [r.name for r in run.comparison.rows if abs(r.step_distance) > 1]
        if far:
            said.append("The update as printed ends more than one posterior deviation from the posterior mean in "
                        f"{', '.join(far)}.")
    return said


def _known_together(run: Run) -> list[str]:
    names = run.update.parameters.names
    if len(names) < 2 or np.any(contraction(run.update, run.posterior) == 0):
        return []
    correlation = np.corrcoef(run.posterior.draws.T)
    close = [f"{names[i]} and {names[j]} ({fixed(correlation[i, j], 2)})" for i in range(len(names))
             for j in range(i) if abs(correlation[i, j]) > 0.9]
    return [f"Known only together (posterior correlation beyond 0.9): {', '.join(close)}."] if close else []


def _too_close(update: UpdateRecord) -> list[str]:
    """A fit closer than the deviations allow: they are not this set's scatter."""
    n = update.n_effective
    if update.map_misfit >= n - 3 * np.sqrt(2 * n):
        return []
    ratio = np.sqrt(n / max(update.map_misfit, 1e-9))
    return [
        f"The model fits the data {number(ratio, 2)} times closer than the stated deviations: they are larger than "
        "this set's own scatter (as those of a whole month are), and the posterior is as wide as they say."
    ]


def _far_off(update: UpdateRecord) -> list[str]:
    """Modes whose computed partner is alike in shape but hardly the same mode by its frequency."""
    ratio = update.initial_hz / update.measured_hz
    far = np.flatnonzero(np.isfinite(ratio) & ((ratio > FAR_OFF) | (ratio < 1 / FAR_OFF)))
    return [
        f"{update.labels[j]}, measured at {fixed(update.measured_hz[j], 3)} Hz, was paired by shape with a computed "
        f"mode at {fixed(update.initial_hz[j], 3)} Hz: see whether these are the same mode before trusting the update."
        for j in far
    ]


def provenance_section(run: Run) -> Section:
    columns = (Column(name="what", number=False), Column(name="value", number=False))
    items: list[object] = [Table(caption="Versions, settings and fingerprints", columns=columns, rows=run.provenance)]
    if run.missing:
        items.append(Items(title="Not found in this run", statements=run.missing))
    return Section(anchor="provenance", title="Provenance", items=tuple(items),
                   lead="What is needed to get these numbers again.")
