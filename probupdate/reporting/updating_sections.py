"""Sections on the model: update, posterior, comparison of the two."""

from __future__ import annotations

import numpy as np

from probupdate.estimators.posterior_file import Posterior
from probupdate.estimators.update_file import SchemeRecord, UpdateRecord, fit_sentence
from probupdate.reporting import figures, paper_tables
from probupdate.reporting.elements import (
    Column,
    Items,
    Notice,
    Picture,
    Section,
    Table,
    Text,
    fixed,
    number,
    percent,
    plural,
)
from probupdate.reporting.style import MAP, PRIOR_UPDATE, STEP_UPDATE, TRUTH
from probupdate.reporting.values import ComparisonRow, Run

# posterior over prior deviation: below the first a parameter is well informed, above the second it keeps its prior
STRONG, INFORMED = 0.5, 0.9
SCHEME_WORDS = {
    "step": "step penalty (Eq. 7 as printed)",
    "prior": "prior penalty (anchored)",
}
STATE_WORDS = {"step": "step penalty", "prior": "prior penalty", "map": "MAP"}
SOIL_NOTE = (
    "py, tz and qw stretch the displacement axis of the API curves: a spring's initial stiffness is proportional to "
    "1/factor, so a factor below one means a stiffer soil. The pile-head stiffnesses are what can be judged."
)


def scheme_name(scheme: SchemeRecord) -> str:
    return SCHEME_WORDS.get(scheme.key, scheme.name)


def fits(update: UpdateRecord) -> bool:
    """Whether the misfit at the maximum is one that a true model would show: within three deviations of chi-square."""
    return update.map_misfit <= update.n_effective + 3 * np.sqrt(2 * update.n_effective)


def update_section(run: Run) -> Section:
    update = run.update
    if update is None:
        return Section(anchor="update", title="Update",
                       items=(Notice(level="missing", text="update.json, so there is no update to show."),))
    items: list[object] = []
    for scheme in update.schemes:
        level = "good" if scheme.converged else "warning"
        steps = plural(len(scheme.theta) - 1, "iteration")
        text = f"{scheme_name(scheme)}: {scheme.status} ({steps}, alpha {scheme.alpha:g})."
        items.append(Notice(level=level, text=text[0].upper() + text[1:]))
    fit = fit_sentence(update)
    items.append(Notice(level="good" if fits(update) else "warning", text=f"{fit[0].upper()}{fit[1:]}."))
    if update.left_out:
        items.append(Items(title="Left out of the update", statements=tuple(f"{t}." for t in update.left_out)))
    pile = _pile_head_table(run)
    items += [_frequency_table(run), _parameter_table(run), _mac_table(run), *([pile] if pile else [])]
    items.append(
        Picture(
            svg=figures.svg_text(
                figures.update_history(
                    {scheme_name(s): s.objective for s in update.schemes if s.objective},
                    {scheme_name(s): s.theta for s in update.schemes},
                    update.parameters.names, update.parameters.initial,
                    {scheme_name(s): s.distance_to_map for s in update.schemes},
                ), "history"),
            caption="The iterations of both readings of Eq. 7. The printed one penalises the step from the previous "
            "iterate: the parameters' term of J, the distance from the prior mean, may keep growing as it forgets the "
            "prior. The anchored one ends at the maximum of the posterior (MAP). Distance to the MAP: in posterior "
            "deviations, root mean square over the parameters.",
        )
    )
    if run.jacket:
        items.append(_sensitivity_table(run))
    return Section(anchor="update", title="Update", items=tuple(items),
                   lead=f"The sensitivity-based update on set {update.set_id}, in both readings of Eq. 7.")


def _paper_modes(labels) -> list[int | None]:
    return [paper_tables.MODES.index(label) if label in paper_tables.MODES else None for label in labels]


def _configurations(run: Run) -> list[tuple[str, np.ndarray, np.ndarray, str]]:
    """(name, frequencies, MAC, row of the paper's tables) of the initial model and of every scheme's end."""
    update = run.update
    rows = [("initial model", update.initial_hz, update.initial_mac, "as-built")]
    for s in update.schemes:
        rows.append((f"updated, {scheme_name(s)}", s.frequency_hz, s.mac, "updated"))
    return rows


def _frequency_table(run: Run) -> Table:
    update, jacket = run.update, run.jacket
    where = _paper_modes(update.labels)
    rows = []
    for j, label in enumerate(update.labels):
        row = [label, fixed(update.measured_hz[j], 4)]
        for _, frequency, _, _ in _configurations(run):
            error = frequency[j] / update.measured_hz[j] - 1
            row += [fixed(frequency[j], 4), percent(error, 1, sign=True)]
        if jacket:
            k = where[j]
            row += [fixed(paper_tables.FREQUENCY_HZ[name][k], 2) if k is not None else ""
                    for name in ("measured", "as-built", "updated")]
        rows.append(tuple(row))
    columns = [Column(name="mode", number=False), Column(name="measured", unit="Hz")]
    for name, *_ in _configurations(run):
        columns += [Column(name=name, unit="Hz"), Column(name="error", unit="%")]
    if jacket:
        columns += [Column(name=f"paper: {name}", unit="Hz", paper=True)
                    for name in ("measured", "as-built", "updated")]
    return Table(caption="Frequencies, measured and computed" + (" (Table 3)" if jacket else ""),
                 columns=tuple(columns), rows=tuple(rows))


def _mac_table(run: Run) -> Table:
    update, jacket = run.update, run.jacket
    where = _paper_modes(update.labels)
    rows = []
    for j, label in enumerate(update.labels):
        row = [label] + [fixed(m[j], 3) for _, _, m, _ in _configurations(run)]
        if jacket:
            k = where[j]
            row += [fixed(paper_tables.MAC[name][k], 2) if k is not None else "" for name in ("as-built", "updated")]
        rows.append(tuple(row))
    columns = [Column(name="mode", number=False), *[Column(name=name) for name, *_ in _configurations(run)]]
    if jacket:
        columns += [Column(name=f"paper: {name}", paper=True) for name in ("as-built", "updated")]
    pairs = [" and ".join(update.labels[j] for j in g) for g in update.pairs]
    note = f"{'; '.join(pairs)}: compared after the computed pair was turned within its plane." if pairs else ""
    return Table(caption="MAC, measured against computed" + (" (Table 4)" if jacket else ""),
                 columns=tuple(columns), rows=tuple(rows), note=note, width="half")


def _ratio(value: float, initial: float) -> str:
    return fixed(value / initial, 3) if initial else ""


def _parameter_table(run: Run) -> Table:
    update, jacket = run.update, run.jacket
    relative = not np.all(update.parameters.initial == 0)
    rows = []
    for k, p in enumerate(update.parameters):
        words = paper_tables.UPDATED[p.name][0] if jacket and p.name in paper_tables.UPDATED else p.description
        row = [p.name, words, p.unit or "-", number(p.initial), number(p.std)]
        for s in update.schemes:
            value = float(s.theta[-1, k])
            row.append(number(value) + (" *" if s.at_bound[k] else ""))
            if relative:
                row.append(_ratio(value, p.initial))
        if jacket:
            known = paper_tables.UPDATED.get(p.name)
            row += [number(known[3]), fixed(known[4], 2)] if known else ["", ""]
        rows.append(tuple(row))
    columns = [Column(name="parameter", number=False), Column(name="meaning", number=False),
               Column(name="unit", number=False), Column(name="initial"), Column(name="prior deviation")]
    for s in update.schemes:
        columns.append(Column(name=scheme_name(s)))
        if relative:
            columns.append(Column(name="over initial"))
    if jacket:
        columns += [Column(name="paper: updated", paper=True), Column(name="over initial", paper=True)]
    note = SOIL_NOTE if jacket else ""
    if any(s.at_bound.any() for s in update.schemes):
        note = f"* held at a bound of its prior. {note}".strip()
    if jacket:
        note += " The paper prints k_TP as 3.41e-1 and as 0.36; its text says a reduction of 64 %."
    return Table(caption="Updated parameters" + (" (Table 5)" if jacket else ""), columns=tuple(columns),
                 rows=tuple(rows), note=note)


def _pile_head_table(run: Run) -> Table | None:
    derived = run.update.derived
    if not derived:
        return None
    rows = []
    for name, states in derived.items():
        reference = states.get("initial")
        for state, value in states.items():
            row = [name, STATE_WORDS.get(state, state), number(value / 1e3)]
            row.append(fixed(value / reference, 2) if reference else "")
            if run.jacket:
                key = {"initial": "as-built"}.get(state, "updated")
                printed = paper_tables.PILE_HEAD_NPM.get(key, {}).get(name)
                as_built = paper_tables.PILE_HEAD_NPM["as-built"].get(name)
                row += [number(printed / 1e3, 2), fixed(printed / as_built, 2)] if printed else ["", ""]
            rows.append(tuple(row))
    columns = [Column(name="quantity", number=False), Column(name="state", number=False),
               Column(name="value", unit="kN/m"), Column(name="over initial")]
    if run.jacket:
        columns += [Column(name="paper", unit="kN/m", paper=True), Column(name="over as-built", paper=True)]
    note = (
        "Stiffness of one pile's head, lateral (head's rotation held) and axial. The paper's ratios 4.7 and 6.0 are "
        "over its design state (2.8e5 and 1.0e6 kN/m)." if run.jacket else ""
    )
    return Table(caption="Pile-head stiffness" + (" (Table 6)" if run.jacket else ""), columns=tuple(columns),
                 rows=tuple(rows), note=note, width="half")


def _sensitivity_table(run: Run) -> Table:
    words = ("negligible", "low", "medium", "high")
    rows = []
    for name, (uncertainty, cov, sensitivity) in paper_tables.SENSITIVITY.items():
        here = name in run.update.parameters.names
        ours = ""
        if here:
            p = run.update.parameters.items[run.update.parameters.index(name)]
            ours = fixed(p.std / p.initial, 2) if p.initial else number(p.std)
        rows.append((name, "yes" if here else "no", ours, words[uncertainty], fixed(cov, 2) if cov else "",
                     words[sensitivity]))
    columns = (Column(name="parameter", number=False), Column(name="updated here", number=False),
               Column(name="prior CoV here", unit="-"), Column(name="uncertainty", number=False, paper=True),
               Column(name="CoV", unit="-", paper=True), Column(name="sensitivity", number=False, paper=True))
    return Table(caption="Parameters, their uncertainty and sensitivity in the paper (Table 2)", columns=columns,
                 rows=tuple(rows))


# Posterior ----------------------------------------------------------------------------------------------------------


def marks(run: Run) -> list[figures.Mark]:
    update = run.update
    found = [figures.Mark(name="MAP", theta=update.map_theta, role=MAP)]
    roles = (("prior", "update, prior penalty", PRIOR_UPDATE), ("step", "update, step penalty", STEP_UPDATE))
    for key, name, role in roles:
        found += [figures.Mark(name=name, theta=s.theta[-1], role=role) for s in update.schemes if s.key == key]
    known = (run.truth or {}).get("parameters")
    if known:
        theta = np.array([float(known.get(n, np.nan)) for n in update.parameters.names])
        if np.any(np.isfinite(theta)):
            found.append(figures.Mark(name="drawn for the virtual turbine", theta=theta, role=TRUTH))
    return found


def posterior_section(run: Run) -> Section:
    title = "Posterior"
    posterior, update = run.posterior, run.update
    if posterior is None or update is None:
        text = "posterior.nc, so there is no posterior to show." if posterior is None else \
            "update.json, which names the parameters and priors that the posterior is drawn against."
        return Section(anchor="posterior", title=title, items=(Notice(level="missing", text=text),))
    parameters = update.parameters
    items: list[object] = [Notice(level="good" if posterior.converged else "warning", text=posterior.verdict)]
    evaluated, fallback = int(posterior.record.get("evaluated", 0)), int(posterior.record.get("fallback", 0))
    if fallback:
        items.append(Notice(
            level="warning" if fallback > 0.2 * evaluated else "plain",
            text=f"{fallback} of {evaluated} evaluations fell outside the reduced basis and were answered by the full "
            "model: exact, but slow."))
    points = marks(run)
    draws = posterior.draws
    items.append(
        Picture(svg=figures.svg_text(figures.marginals(parameters.items, draws, points), "marginals"),
                caption="Each parameter's posterior (filled), prior (dashed) and point estimates. Grey ground: outside "
                "the bounds. A posterior that lies on its prior was not informed by the data.")
    )
    correlation = np.corrcoef(draws.T) if len(parameters) > 1 else np.ones((1, 1))
    if len(parameters) > 1:
        chosen = figures.most_correlated(draws, 4)
        names = [parameters.names[k] for k in chosen]
        units = [parameters.items[k].unit for k in chosen]
        near = [figures.Mark(name=m.name, theta=np.asarray(m.theta)[chosen], role=m.role) for m in points]
        items.append(Picture(
            svg=figures.svg_text(figures.corner(names, units, draws[:, chosen], near), "corner"),
            caption="The parameters with the strongest correlations. Contours hold 39, 68 and 90 % of the draws."))
        items.append(Picture(
            svg=figures.svg_text(figures.correlation_map(parameters.names, correlation), "correlation"), width="half",
            caption="Posterior correlation of all parameters; values below 0.005 are left blank."))
    ratio = np.std(draws, axis=0, ddof=1) / np.array([p.distribution.std() for p in parameters])
    items.append(Picture(
        svg=figures.svg_text(
            figures.contraction(parameters.names, ratio, informed_below=INFORMED, strong_below=STRONG), "contraction"),
        width="half",
        caption="Posterior over prior deviation (the prior's after its cut at the bounds). Filled: strongly informed "
        f"(below {STRONG}); hatched: weakly; dotted: keeps its prior (above {INFORMED})."))
    used = [update.labels.index(label) for label in posterior.mode_labels if label in update.labels]
    if len(used) == posterior.frequency_hz.shape[1]:
        items.append(Picture(
            svg=figures.svg_text(figures.predictive_frequencies(
                posterior.mode_labels, update.measured_hz[used], update.measured_std_hz[used], posterior.frequency_hz,
            ), "predictive"),
            caption="Frequencies that the posterior predicts against the measured ones, in per cent of these."))
    items.append(_sampling_table(posterior, update))
    return Section(anchor="posterior", title=title, items=tuple(items),
                   lead="What the parameters may be, given the measurement, the prior and the model.")


def _sampling_table(posterior: Posterior, update: UpdateRecord) -> Table:
    rows = []
    for k, p in enumerate(update.parameters):
        d = posterior.draws[:, k]
        low, middle, high = np.percentile(d, [5, 50, 95])
        rows.append((
            p.name, p.unit or "-", number(float(d.mean())), number(float(d.std(ddof=1))), number(low), number(middle),
            number(high), fixed(posterior.r_hat[k], 4), fixed(posterior.ess[k], 0),
        ))
    columns = (Column(name="parameter", number=False), Column(name="unit", number=False), Column(name="mean"),
               Column(name="deviation"), Column(name="5 %"), Column(name="50 %"), Column(name="95 %"),
               Column(name="R-hat"), Column(name="effective draws"))
    return Table(caption="The posterior in numbers", columns=columns, rows=tuple(rows),
                 note=f"{len(posterior.draws)} draws.")


# Comparison -----------------------------------------------------------------------------------------------------------


def comparison_section(run: Run) -> Section:
    title = "Comparison"
    if run.comparison is None:
        return Section(anchor="comparison", title=title, items=(
            Notice(level="missing", text="compare.json, so update and posterior are not set side by side."),))
    rows = run.comparison.rows
    items: list[object] = []
    if run.comparison.summary:
        items.append(Text(paragraphs=run.comparison.summary))
    items.append(_values_table(rows))
    items.append(_distance_table(rows))
    if any(np.isfinite(r.nine_cov) for r in rows):
        items.append(_scatter_table(run))
    return Section(anchor="comparison", title=title, items=tuple(items),
                   lead="Where the deterministic updates and the posterior part, and why.")


def _values_table(rows: tuple[ComparisonRow, ...]) -> Table:
    columns = (Column(name="parameter", number=False), Column(name="unit", number=False), Column(name="prior mean"),
               Column(name="prior deviation"), Column(name="update, step penalty"),
               Column(name="update, prior penalty"),
               Column(name="MAP"), Column(name="posterior mean"), Column(name="posterior median"),
               Column(name="posterior deviation"), Column(name="posterior CoV", unit="-"), Column(name="5–95 %"))
    cells = []
    for r in rows:
        cov = abs(r.std / r.mean) if r.mean else float("nan")
        cells.append((r.name, r.unit or "-", number(r.prior_mean), number(r.prior_std), number(r.step),
                      number(r.anchored),
                      number(r.map), number(r.mean), number(r.median), number(r.std), number(cov, 2),
                      f"{number(r.low)} to {number(r.high)}"))
    return Table(caption="The same parameters by every route", columns=columns, rows=tuple(cells))


def _distance_table(rows: tuple[ComparisonRow, ...]) -> Table:
    columns = (Column(name="parameter", number=False), Column(name="step penalty", unit="posterior deviations"),
               Column(name="prior penalty", unit="posterior deviations"),
               Column(name="MAP", unit="posterior deviations"),
               Column(name="posterior over prior deviation"), Column(name="informed", number=False),
               Column(name="what it means", number=False))
    cells = []
    for r in rows:
        words = r.sentence or "; ".join(r.flags)
        cells.append((r.name, _signed(r.step_distance), _signed(r.anchored_distance), _signed(r.map_distance),
                      fixed(r.contraction, 2), r.identified, words))
    far = {k for k, r in enumerate(rows) if max(abs(r.step_distance), abs(r.anchored_distance)) > 1}
    return Table(caption="Distance from the posterior mean", columns=columns, rows=tuple(cells), marked=frozenset(far),
                 note="Emphasised: an update more than one posterior deviation from the posterior mean.")


def _signed(value: float) -> str:
    text = fixed(value, 2)
    return f"+{text}" if value > 0 and text != "0.00" else text


def _scatter_table(run: Run) -> Table:
    rows = []
    printed = paper_tables.SCATTER if run.jacket else {}

    def paper_cells(name: str) -> list[str]:
        if not run.jacket:
            return []
        if name not in printed:
            return ["", ""]
        mean, cov, upper = printed[name]
        return [number(mean), f"< {cov:g}" if upper else f"{cov:.2f}"]

    for r in run.comparison.rows:
        cov = abs(r.std / r.mean) if r.mean else float("nan")
        rows.append((r.name, r.unit or "-", number(r.nine_mean), number(r.nine_cov, 2), fixed(r.resolution, 2),
                     number(cov, 2), *paper_cells(r.name)))
    for name, values in run.comparison.derived.items():
        rows.append((name, "N/m", number(values.get("mean", float("nan"))),
                     number(values.get("cov", float("nan")), 2), "",
                     number(values.get("posterior_cov", float("nan")), 2), *paper_cells(name)))
    columns = [Column(name="parameter", number=False), Column(name="unit", number=False),
               Column(name="mean of the sets"), Column(name="CoV over the sets", unit="-"),
               Column(name="resolution", unit="-"), Column(name="posterior CoV", unit="-")]
    if run.jacket:
        columns += [Column(name="paper: mean", paper=True), Column(name="paper: CoV", unit="-", paper=True)]
    note = (
        "A small CoV over the sets is no small uncertainty: a parameter that the data do not inform (resolution near "
        "0) returns to its prior in every set and scatters by nothing. Resolution 1: the data alone decide."
    )
    return Table(caption="Scatter of the update over the selected sets" + (" (Table 7)" if run.jacket else ""),
                 columns=tuple(columns), rows=tuple(rows), note=note)
