"""The section on the deterministic update: frequencies, parameters, history, scatter over the sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probupdate.io.result_table import plural
from probupdate.modal.modes import set_words
from probupdate.model.parameters import Parameter
from probupdate.reporting import figures, paper_tables
from probupdate.reporting.components_items import component_items
from probupdate.reporting.elements import (
    MISSING,
    Column,
    Element,
    Items,
    Notice,
    Picture,
    Section,
    Table,
    decimal,
    full_sentence,
    number,
    percent,
)
from probupdate.reporting.identifiability import estimate
from probupdate.reporting.states import is_diagnosed
from probupdate.reporting.style import MAP
from probupdate.reporting.values import Run
from probupdate.updating.identifiability import cov_of
from probupdate.updating.update_file import (
    ACCUSED,
    ScatterRecord,
    SchemeRecord,
    UpdateRecord,
    fit_sentence,
    is_unproven,
    stated_error_words,
)

SCHEME_WORDS = {
    "step": "step penalty (Eq. 7 as the paper prints it)",
    "prior": "prior penalty (anchored)",
}
SOIL_NOTE = (
    "py, tz and qw scale the displacement axis of the API curves: a spring's initial stiffness is proportional to "
    "1/factor, so a factor below one means a stiffer soil. The pile-head stiffnesses are what can be judged."
)


# the paper's turbine is not the one of this run: another site's soil, another drawing, its own measurement
PAPER_NOTE = "Paper: its own measured turbine, another realisation than this one; its numbers are for orientation."

SHORT_WORDS = {"step": "step penalty", "prior": "prior penalty", "map": "MAP"}


def short_name(scheme: SchemeRecord) -> str:
    return SHORT_WORDS.get(scheme.key, scheme.name)


def scheme_name(scheme: SchemeRecord) -> str:
    return SCHEME_WORDS.get(scheme.key, scheme.name)


def meaning(parameter: Parameter, jacket: bool) -> str:
    """What a parameter is, in words: the paper's beside the jacket."""
    known = jacket and parameter.name in paper_tables.UPDATED
    return paper_tables.UPDATED[parameter.name][0] if known else parameter.description


def too_close(update: UpdateRecord) -> bool:
    """Whether the fit is closer than the stated standard deviations allow: they are not this set's scatter. Of
    tolerances and an error of the model that are stated a structure may use up little."""
    least = update.n_effective - ACCUSED * np.sqrt(2 * update.n_effective)
    return not stated_error_words(update) and update.map_misfit < least


def fit_level(update: UpdateRecord) -> str:
    return "warning" if is_unproven(update) else "caution" if too_close(update) else "good"


def update_section(run: Run) -> Section:
    update = run.update
    if update is None:
        return Section(anchor="update", title="Update",
                       items=(Notice(level="missing", text="update.json, so there is no update to show."),))
    items: list[Element] = []
    for scheme in update.schemes:
        level = "good" if scheme.converged else "warning"
        steps = plural(len(scheme.theta) - 1, "iteration")
        text = f"{scheme_name(scheme)}: {scheme.status} ({steps}, alpha {scheme.alpha:g})."
        items.append(Notice(level=level, text=full_sentence(text)))
    fit = fit_sentence(update, diagnosed=is_diagnosed(run))
    items.append(Notice(level=fit_level(update), text=full_sentence(fit)))
    if update.left_out:
        items.append(Items(title="Left out of the update", statements=tuple(f"{t}." for t in update.left_out)))
    items += _tables(run, update)
    items.append(
        Picture(
            svg=figures.svg_text(
                figures.update_history(
                    {scheme_name(s): s.objective for s in update.schemes if s.objective},
                    {scheme_name(s): s.theta for s in update.schemes},
                    update.parameters.names, update.parameters.initial,
                    {scheme_name(s): s.distance_to_map for s in update.schemes},
                ), "history"),
            caption="The iterations of both readings of the paper's Eq. 7. The printed one penalises the step from the "
            "previous iterate: the parameters' term of J, the distance from the prior mean, may keep growing as it "
            "forgets the prior. The anchored one ends at the maximum of the posterior (MAP). Distance to the MAP: in "
            "posterior standard deviations, root mean square over the parameters, drawn at 0.001 where it is less.",
        )
    )
    items += component_items(update)
    items += _paths_picture(run, update)
    scatter = _scatter_table(run, update)
    items += [scatter] if scatter else []
    if run.paper_comparable:
        items.append(_sensitivity_table(update))
    return Section(anchor="update", title="Update", items=tuple(items),
                   lead=f"The sensitivity-based update on {set_words(update.set_id)}, in both readings of the "
                        "paper's Eq. 7: penalty on the step, and on the distance from the prior.")


def _tables(run: Run, update: UpdateRecord) -> list[Element]:
    """Frequencies, parameters, MAC and what follows from the parameters."""
    pile, paper = _pile_head_table(run, update), run.paper_comparable
    return [_frequency_table(update, paper), _parameter_table(update, run.jacket, paper), _mac_table(update, paper),
            *([pile] if pile else [])]


def paper_section(run: Run) -> Section | None:
    """An update with the paper's weights beside the run's own."""
    paper, update = run.paper, run.update
    if paper is None:
        return None
    alone = replace(run, update=paper, paper=None, posterior=None, comparison=None)
    items: list[Element] = [] if update is None else [_paper_comparison_table(run, paper, update)]
    items.append(Notice(level="plain", text=full_sentence(fit_sentence(paper))))
    items += _tables(alone, paper)
    scatter = _scatter_table(alone, paper)
    items += [scatter] if scatter else []
    if run.jacket:
        items.append(_sensitivity_table(paper))
    return Section(anchor="paper", title="Comparison: the paper's weights", items=tuple(items), lead=(
        "The model without any finding, updated on one set with the paper's weights: constant standard deviations, "
        "wider than this measurement's own, and nothing stated of the model's error. For comparison; the parameters to "
        "use are those of the first section."))


def _paper_comparison_table(run: Run, paper: UpdateRecord, update: UpdateRecord) -> Table:
    after = estimate(update, run.posterior)
    std, known = np.sqrt(np.diag(paper.map_covariance)), (run.truth or {}).get("parameters") or {}
    rows = []
    for k, p in enumerate(update.parameters):
        low, high = (after.low[k], after.high[k]) if after.low is not None and after.high is not None else (None, None)
        theirs = MISSING
        if p.name in paper.parameters.names:
            j = paper.parameters.index(p.name)
            theirs = f"{number(paper.map_theta[j])} ± {number(std[j], 2)}"
        row = [p.name, p.unit or "-", theirs, number(after.theta[k]), f"{number(low)} to {number(high)}"]
        rows.append((*row, *([number(known.get(p.name))] if known else [])))
    columns = [Column(name="parameter", number=False), Column(name="unit", number=False),
               Column(name="paper's weights: MAP with Laplace's standard deviation"),
               Column(name=f"this run: {after.name}"), Column(name="this run: 90 % interval")]
    columns += [Column(name="truth")] if known else []
    return Table(caption="Parameters with the paper's weights and in this run", columns=tuple(columns),
                 rows=tuple(rows))


def _paths_picture(run: Run, update: UpdateRecord) -> list[Picture]:
    """Both ways to regularise, over iterations and over alpha, where the printed scheme goes farthest from the MAP."""
    path = update.alpha_path
    if path is None or len(update.parameters) < 2:
        return []
    printed = update.scheme("step")
    apart = np.max(np.abs(printed.theta - update.map_theta), axis=0) / np.sqrt(np.diag(update.map_covariance))
    far = [int(k) for k in np.argsort(apart)[::-1][:4]]
    pairs = [(far[k], far[k + 1]) for k in range(0, len(far) - 1, 2)]
    draws = None if run.posterior is None else run.posterior.draws
    figure = figures.estimate_paths(
        update.parameters.items, pairs, draws, printed.theta, printed.closest_iteration, path.alpha, path.theta,
        figures.Mark(name="MAP", theta=update.map_theta, role=MAP),
    )
    rules = [f"{rule} {value:.2g}" for rule, value in path.chosen.items() if np.isfinite(value)]
    rules += [f"none by {rule}, as {remark}" for rule, remark in path.remarks.items()]
    return [Picture(
        svg=figures.svg_text(figure, "paths"),
        caption="Paths to the estimates, for the parameters that Eq. 7 as printed takes farthest from the MAP: its "
        "iterations, and the anchored update over alpha. Many iterations act like a small alpha. alpha by rule: "
        f"{'; '.join(rules)}.",
    )]


def _paper_modes(labels: tuple[str, ...]) -> list[int | None]:
    return [paper_tables.MODES.index(label) if label in paper_tables.MODES else None for label in labels]


def _configurations(update: UpdateRecord) -> list[tuple[str, np.ndarray, np.ndarray, str]]:
    """(name, frequencies, MAC, row of the paper's tables) of the initial model and of every scheme's end."""
    rows = [("initial model", update.initial_hz, update.initial_mac, "as-built")]
    for s in update.schemes:
        rows.append((short_name(s), s.frequency_hz, s.mac, "updated"))
    rows.append(("MAP", update.map_hz, update.map_mac, "updated"))
    return rows


def _frequency_table(update: UpdateRecord, jacket: bool) -> Table:
    where = _paper_modes(update.labels)
    rows = []
    for j, label in enumerate(update.labels):
        row = [label, decimal(update.measured_hz[j], 4)]
        for _, frequency, _, _ in _configurations(update):
            error = frequency[j] / update.measured_hz[j] - 1
            row += [decimal(frequency[j], 4), percent(error, 1, sign=True)]
        if jacket:
            k = where[j]
            row += [decimal(paper_tables.FREQUENCY_HZ[name][k], 2) if k is not None else ""
                    for name in ("measured", "as-built", "updated")]
        rows.append(tuple(row))
    columns = [Column(name="mode", number=False), Column(name="measured", unit="Hz")]
    for name, *_ in _configurations(update):
        columns += [Column(name=name, unit="Hz"), Column(name="error", unit="%")]
    if jacket:
        columns += [Column(name=f"paper: {name}", unit="Hz", paper=True)
                    for name in ("measured", "as-built", "updated")]
    return Table(caption="Frequencies, measured and computed" + (" (Table 3)" if jacket else ""),
                 columns=tuple(columns), rows=tuple(rows), note=PAPER_NOTE if jacket else "")


def _mac_table(update: UpdateRecord, jacket: bool) -> Table:
    where = _paper_modes(update.labels)
    rows = []
    for j, label in enumerate(update.labels):
        row = [label] + [decimal(m[j], 3) for _, _, m, _ in _configurations(update)]
        if jacket:
            k = where[j]
            row += [decimal(paper_tables.MAC[name][k], 2) if k is not None else "" for name in ("as-built", "updated")]
        rows.append(tuple(row))
    columns = [Column(name="mode", number=False)]
    columns += [Column(name=name, unit="-") for name, *_ in _configurations(update)]
    if jacket:
        columns += [Column(name=f"paper: {name}", unit="-", paper=True) for name in ("as-built", "updated")]
    pairs = [" and ".join(update.labels[j] for j in g) for g in update.pairs]
    note = f"{'; '.join(pairs)}: compared after the computed pair was turned within its plane." if pairs else ""
    note = f"{note} {PAPER_NOTE}".strip() if jacket else note
    return Table(caption="MAC, measured against computed" + (" (Table 4)" if jacket else ""),
                 columns=tuple(columns), rows=tuple(rows), note=note, width="half")


def _ratio(value: float, initial: float) -> str:
    return decimal(value / initial, 3) if initial else ""


def _parameter_table(update: UpdateRecord, jacket: bool, paper: bool) -> Table:
    relative = not np.all(update.parameters.initial == 0)
    meant = any(meaning(p, jacket) for p in update.parameters)
    rows = []
    for k, p in enumerate(update.parameters):
        row = [p.name, *([meaning(p, jacket)] if meant else []), p.unit or "-", number(p.initial), number(p.std)]
        for s in update.schemes:
            value = float(s.theta[-1, k])
            row.append(number(value) + (" *" if s.at_bound[k] else ""))
            if relative:
                row.append(_ratio(value, p.initial))
        if paper:
            known = paper_tables.UPDATED.get(p.name)
            row += [number(known[3]), decimal(known[4], 2)] if known else ["", ""]
        rows.append(tuple(row))
    columns = [Column(name="parameter", number=False), *([Column(name="meaning", number=False)] if meant else []),
               Column(name="unit", number=False), Column(name="initial"), Column(name="prior standard deviation")]
    for s in update.schemes:
        columns.append(Column(name=short_name(s)))
        if relative:
            columns.append(Column(name="over initial", unit="-"))
    if paper:
        columns += [Column(name="paper: updated", paper=True), Column(name="over initial", unit="-", paper=True)]
    note = SOIL_NOTE if jacket else ""
    if any(s.at_bound.any() for s in update.schemes):
        note = f"* held at a bound of its prior. {note}".strip()
    if paper:
        note += f" The paper prints k_TP as 3.41e-1 and as 0.36; its text says a reduction of 64 %. {PAPER_NOTE}"
    return Table(caption="Updated parameters" + (" (Table 5)" if paper else ""), columns=tuple(columns),
                 rows=tuple(rows), note=note)


def _pile_head_table(run: Run, update: UpdateRecord) -> Table | None:
    derived = update.derived
    if not derived:
        return None
    states = list(next(iter(derived.values())))
    drawn = run.comparison.derived if run.comparison is not None else {}
    printed = ("design", "as-built", "updated") if run.paper_comparable else ()
    rows = []
    for name, values in derived.items():
        known = [paper_tables.PILE_HEAD_NPM[state].get(name, float("nan")) for state in printed]
        start, mean = values.get("initial", float("nan")), drawn.get(name, {}).get("mean")
        ours, ratios = [number(values[s] / 1e6) for s in states], [decimal(values[s] / start, 2) for s in states]
        if drawn:
            cov = drawn.get(name, {}).get("cov")
            ours += [number(mean / 1e6) if mean else MISSING, number(cov, 2)]
            ratios += [decimal(mean / start, 2) if mean else MISSING, ""]
        rows.append((name, "MN/m", *ours, *[number(v / 1e6, 2) for v in known]))
        rows.append((f"{name} over initial", "-", *ratios, *[decimal(v / known[1], 2) for v in known]))
    columns = [Column(name="quantity", number=False), Column(name="unit", number=False)]
    columns += [Column(name=SHORT_WORDS.get(state, state)) for state in states]
    columns += [Column(name="posterior mean"), Column(name="posterior CoV", unit="-")] if drawn else []
    columns += [Column(name=f"paper: {state}", paper=True) for state in printed]
    note = (
        "Stiffness of one pile's head, lateral (head's rotation held) and axial. The paper's ratios 4.7 and 6.0 are "
        "over its design state; here they are over its as-built state, from which its update starts. "
        + PAPER_NOTE if run.paper_comparable else ""
    )
    return Table(caption="Pile-head stiffness" + (" (Table 6)" if run.paper_comparable else ""), columns=tuple(columns),
                 rows=tuple(rows), note=note, width="half")


def _scatter_table(run: Run, update: UpdateRecord) -> Table | None:
    """Table 7: the update of every selected set."""
    sets = update.sets
    if sets is None:
        return None
    resolution = np.mean(sets.resolution, axis=0)
    posterior = None if run.posterior is None else run.posterior.draws
    rows = []
    for k, p in enumerate(update.parameters):
        width = MISSING
        if posterior is not None and np.mean(posterior[:, k]):
            width = number(float(np.std(posterior[:, k], ddof=1) / abs(np.mean(posterior[:, k]))), 2)
        rows.append((p.name, p.unit or "-", *_scatter(sets.theta_step[:, k], p), *_scatter(sets.theta_map[:, k], p),
                     decimal(float(resolution[k]), 2), width,
                     *(_paper_scatter(p.name, 1.0) if run.paper_comparable else ())))
    for name, values in sets.derived.items():
        drawn = run.comparison.derived.get(name, {}) if run.comparison is not None else {}
        rows.append((name, "MN/m", MISSING, MISSING, *_scatter(values / 1e6), "", number(drawn.get("cov"), 2),
                     *(_paper_scatter(name, 1e6) if run.paper_comparable else ())))
    columns = [
        Column(name="parameter", number=False), Column(name="unit", number=False),
        Column(name="step penalty: mean"), Column(name="step penalty: CoV", unit="-"), Column(name="MAP: mean"),
        Column(name="MAP: CoV", unit="-"), Column(name="resolution", unit="-"), Column(name="posterior CoV", unit="-"),
    ]
    if run.paper_comparable:
        columns += [Column(name="paper: mean", paper=True), Column(name="paper: CoV", unit="-", paper=True)]
    held = any(cell.endswith("*") for row in rows for cell in row)
    return Table(caption=f"Scatter of the update over the selected sets{' (Table 7)' if run.paper_comparable else ''}",
                 columns=tuple(columns), rows=tuple(rows), note=_scatter_note(sets, held, run.paper_comparable))


def _scatter(values: np.ndarray, parameter: Parameter | None = None) -> tuple[str, str]:
    """Mean and CoV; a star and no CoV where every set ends at the same bound."""
    mean = float(np.mean(values))
    if parameter is not None:
        near = 1e-6 * parameter.std
        if any(np.all(np.abs(values - bound) < near) for bound in (parameter.lower, parameter.upper)):
            return f"{number(mean)} *", MISSING
    std = float(np.std(values, ddof=1))
    cov = cov_of(mean, std, parameter) if parameter is not None else std / abs(mean) if mean else np.nan
    return number(mean), "< 0.0001" if cov < 5e-5 else decimal(cov, 4)


def _paper_scatter(name: str, unit: float) -> tuple[str, str]:
    """Mean, over `unit`, and CoV of the paper's Table 7; empty where it has none of that name."""
    if name not in paper_tables.SCATTER:
        return "", ""
    mean, cov, upper = paper_tables.SCATTER[name]
    return number(mean / unit), f"< {cov:g}" if upper else f"{cov:.2f}"


def _scatter_note(sets: ScatterRecord, held: bool, jacket: bool) -> str:
    note = (
        f"{len(sets.ids)} sets, each updated from the same start; the step penalty after "
        f"{plural(sets.iterations, 'iteration')}, where it passes closest to the MAP of the reference set. A small CoV "
        "over the sets is no small uncertainty: a parameter that the data do not inform (resolution near 0) returns to "
        "its prior in every set and does not scatter. Resolution 1: the data alone decide."
    )
    if held:
        note += " * at a bound in every set: it does not scatter because the bound holds it."
    if jacket:
        note += f" {PAPER_NOTE}"
    if sets.failed:
        note += f" No update: {'; '.join(sets.failed)}."
    return note


def _sensitivity_table(update: UpdateRecord) -> Table:
    words = ("negligible", "low", "medium", "high")
    rows = []
    for name, (uncertainty, cov, sensitivity) in paper_tables.SENSITIVITY.items():
        here = name in update.parameters.names
        ours = ""
        if here:
            p = update.parameters.items[update.parameters.index(name)]
            ours = decimal(p.std / p.initial, 2) if p.initial else number(p.std)
        rows.append((name, "yes" if here else "no", ours, words[uncertainty], decimal(cov, 2) if cov else "",
                     words[sensitivity]))
    columns = (Column(name="parameter", number=False), Column(name="updated here", number=False),
               Column(name="prior CoV here", unit="-"), Column(name="uncertainty", number=False, paper=True),
               Column(name="CoV", unit="-", paper=True), Column(name="sensitivity", number=False, paper=True))
    return Table(caption="Parameters, their uncertainty and sensitivity in the paper (Table 2)", columns=columns,
                 rows=tuple(rows))
