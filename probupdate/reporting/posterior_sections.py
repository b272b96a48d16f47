"""Sections on the posterior and on where the update and the posterior part."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from probupdate.reporting import figures
from probupdate.reporting.elements import (
    Column,
    Element,
    Items,
    Notice,
    Picture,
    Section,
    Table,
    count,
    decimal,
    full_sentence,
    number,
)
from probupdate.reporting.findings import MANY_FALLBACKS, evaluations
from probupdate.reporting.identifiability import contraction
from probupdate.reporting.states import is_diagnosed
from probupdate.reporting.style import MAP, PRIOR_UPDATE, STEP_UPDATE, TRUTH
from probupdate.reporting.values import Run
from probupdate.updating.comparison import ComparisonRow
from probupdate.updating.identifiability import BLIND, STRONG
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.update_file import UpdateRecord, fit_sentence

# panels a side beyond which pairs can no longer be read on a page
MOST_PAIRED = 6


def marks(run: Run, update: UpdateRecord) -> list[figures.Mark]:
    found = [figures.Mark(name="MAP", theta=update.map_theta, role=MAP)]
    roles = (("prior", "update, prior penalty", PRIOR_UPDATE), ("step", "update, step penalty", STEP_UPDATE))
    for key, name, role in roles:
        # where one that did not converge happens to stand is not an estimate
        found += [figures.Mark(name=name, theta=s.theta[-1], role=role) for s in update.schemes
                  if s.key == key and (s.converged or key == "prior")]
    known = _true_parameters(run)
    if known:
        theta = np.array([float(known.get(n, np.nan)) for n in update.parameters.names])
        if np.any(np.isfinite(theta)):
            found.append(figures.Mark(name="truth", theta=theta, role=TRUTH))
    return found


def posterior_section(run: Run) -> Section:
    title = "Posterior"
    posterior, update = run.posterior, run.update
    if posterior is None or update is None:
        text = "posterior.nc, so there is no posterior to show." if posterior is None else \
            "update.json, which names the parameters and priors that the posterior is drawn against."
        return Section(anchor="posterior", title=title, items=(Notice(level="missing", text=text),))
    items: list[Element] = [Notice(level="good" if posterior.converged else "warning", text=posterior.verdict)]
    evaluated, fallback = evaluations(posterior)
    if fallback:
        items.append(Notice(
            level="warning" if fallback > MANY_FALLBACKS * evaluated else "plain",
            text=f"{count(fallback)} of {count(evaluated)} evaluations fell outside the reduced basis and were "
            "answered by the full model: exact, but slow."))
    points, ratio = marks(run, update), contraction(update, posterior)
    marginals = figures.marginals(update.parameters.items, posterior.draws, points)
    items.append(Picture(
        svg=figures.svg_text(marginals, "marginals"),
        caption="Each parameter's posterior (filled), prior (dashed) and point estimates. Grey ground: outside "
        "the bounds. A posterior that lies on its prior is not identified by the data."
        + (" Truth: what the virtual turbine was built with." if run.truth else "")))
    if len(update.parameters) > 1:
        items += _pair_pictures(update, posterior.draws, points, ratio)
    items.append(_contraction_picture(update, ratio))
    items += _predictive_picture(posterior, update)
    items += [_trace_picture(posterior, update), _sampling_table(posterior, update)]
    return Section(anchor="posterior", title=title, items=tuple(items),
                   lead="The parameters given the measurement, the prior and the model.")


def _pair_pictures(
    update: UpdateRecord, draws: np.ndarray, points: list[figures.Mark], ratio: np.ndarray
) -> list[Picture]:
    parameters = update.parameters
    chosen, words = choose_pairs(parameters.names, ratio)
    near = [figures.Mark(name=m.name, theta=np.asarray(m.theta)[chosen], role=m.role) for m in points]
    pairs = figures.corner([parameters.items[k] for k in chosen], draws[:, chosen], near)
    correlation = figures.correlation_map(parameters.names, np.corrcoef(draws.T))
    return [
        Picture(svg=figures.svg_text(pairs, "corner"),
                caption=f"{words} Contours hold 39, 68 and 90 % of the draws; dashed: the prior; marks beyond a frame "
                "are not drawn."),
        Picture(svg=figures.svg_text(correlation, "correlation"), width="half" if len(parameters) <= 12 else "full",
                caption="Posterior correlation of all parameters; values below 0.005 are left blank."),
    ]


def _contraction_picture(update: UpdateRecord, ratio: np.ndarray) -> Picture:
    figure = figures.contraction(update.parameters.names, ratio, informed_below=BLIND, strong_below=STRONG)
    return Picture(
        svg=figures.svg_text(figure, "contraction"), width="half",
        caption="Posterior over prior standard deviation (the prior's after its cut at the bounds). Filled: strongly "
        f"identified (below {STRONG}); hatched: weakly; dotted: keeps its prior (above {BLIND}). A bound, too, "
        "makes a posterior narrow.")


def _predictive_picture(posterior: Posterior, update: UpdateRecord) -> list[Picture]:
    """None of a posterior that was written without its predictions, or with those of other modes."""
    used = [update.labels.index(label) for label in posterior.mode_labels if label in update.labels]
    if len(used) != posterior.frequency_hz.shape[1]:
        return []
    figure = figures.predictive_frequencies(
        posterior.mode_labels, update.measured_hz[used], update.measured_std_hz[used], posterior.frequency_hz)
    return [Picture(
        svg=figures.svg_text(figure, "predictive"),
        caption="Frequencies that the posterior predicts against the measured ones, in per cent of these.")]


def _trace_picture(posterior: Posterior, update: UpdateRecord) -> Picture:
    parameters = update.parameters
    figure = figures.traces_and_ranks(
        parameters.names, [p.unit for p in parameters], posterior.theta, posterior.ess,
        int(posterior.record.get("thinned by", 1)))
    return Picture(
        svg=figures.svg_text(figure, "traces"),
        caption="Convergence of the chains. Traces: all walkers at every step; a drift, or a width that still "
        "changes, has not converged. Ranks: parts of the chains against all draws; lines that leave the grey band mean "
        "that the parts disagree.")


def choose_pairs(names: tuple[str, ...], ratio: np.ndarray) -> tuple[list[int], str]:
    """The parameters whose pairs are drawn, and the sentence that says which: those the data inform, the best informed
    where there are too many."""
    order = [int(k) for k in np.argsort(ratio, kind="stable")]
    informed = [k for k in order if ratio[k] <= BLIND]
    chosen = sorted((informed if len(informed) > 1 else order)[:MOST_PAIRED])
    if len(chosen) == len(names):
        return chosen, "All parameters in pairs."
    left = ", ".join(names[k] for k in range(len(names)) if k not in chosen)
    return chosen, f"The {len(chosen)} parameters that the data inform best, in pairs; not drawn: {left}."


def _sampling_table(posterior: Posterior, update: UpdateRecord) -> Table:
    rows = []
    for k, p in enumerate(update.parameters):
        d = posterior.draws[:, k]
        low, middle, high = np.percentile(d, [5, 50, 95])
        rows.append((
            p.name, p.unit or "-", number(float(d.mean())), number(float(d.std(ddof=1))), number(low), number(middle),
            number(high), decimal(posterior.r_hat[k], 3), count(float(posterior.ess[k])),
        ))
    columns = (Column(name="parameter", number=False), Column(name="unit", number=False), Column(name="mean"),
               Column(name="standard deviation"), Column(name="5 %"), Column(name="50 %"), Column(name="95 %"),
               Column(name="R-hat"), Column(name="effective draws"))
    return Table(caption="The posterior in numbers", columns=columns, rows=tuple(rows),
                 note=f"{count(len(posterior.draws))} draws kept; R-hat below 1.01 is wanted.")


def comparison_section(run: Run) -> Section:
    title = "Comparison"
    if run.comparison is None:
        return Section(anchor="comparison", title=title, items=(
            Notice(level="missing", text="compare.json, so update and posterior are not set side by side."),))
    rows = run.comparison.rows
    items: list[Element] = []
    if run.comparison.notes:
        fit = run.update is not None and is_diagnosed(run) and fit_sentence(run.update)
        notes = tuple(full_sentence(fit_sentence(run.update, diagnosed=True) if n == fit else n, run.comparison.names)
                      for n in run.comparison.notes)
        items.append(Items(title="In short", statements=notes))
    items.append(_values_table(rows))
    truth = _truth_table(run)
    items += [truth] if truth else []
    items.append(_distance_table(rows))
    return Section(anchor="comparison", title=title, items=tuple(items),
                   lead="Where the deterministic updates and the posterior differ, and why.")


def _true_parameters(run: Run) -> Mapping[str, float]:
    """What the virtual turbine was built with, by name; empty where the truth is not known."""
    return (run.truth or {}).get("parameters") or {}


def _positions_of_truth(run: Run, update: UpdateRecord) -> list[tuple[int, float]]:
    """(position, true value) of the parameters that the virtual turbine has under the same name."""
    known = _true_parameters(run)
    return [(k, float(known[n])) for k, n in enumerate(update.parameters.names) if n in known]


def _is_inside(draws: np.ndarray, value: float) -> bool:
    low, high = np.percentile(draws, [5, 95])
    return bool(low <= value <= high)


def truth_sentence(run: Run) -> str:
    update, posterior = run.update, run.posterior
    if update is None or posterior is None:
        return ""
    known = _positions_of_truth(run, update)
    if not known:
        return ""
    outside = [update.parameters.names[k] for k, v in known if not _is_inside(posterior.draws[:, k], v)]
    words = f"The truth of the virtual turbine lies within the 90 % interval of {len(known) - len(outside)} of " \
            f"{len(known)}"
    return f"{words}, outside for {', '.join(outside)}." if outside else f"{words}."


def _truth_table(run: Run) -> Table | None:
    update, posterior = run.update, run.posterior
    if update is None or posterior is None:
        return None
    known = _positions_of_truth(run, update)
    if not known:
        return None
    rows, outside = [], set()
    for k, value in known:
        p, draws = update.parameters.items[k], posterior.draws[:, k]
        if not (inside := _is_inside(draws, value)):
            outside.add(len(rows))
        low, high = np.percentile(draws, [5, 95])
        rows.append((p.name, p.unit or "-", number(value), number(p.initial),
                     number(float(np.median(draws))), f"{number(low)} to {number(high)}", "yes" if inside else "no",
                     _format_signed(float((value - np.median(draws)) / draws.std(ddof=1)))))
    columns = (Column(name="parameter", number=False), Column(name="unit", number=False), Column(name="truth"),
               Column(name="initial"), Column(name="posterior median"), Column(name="90 % interval"),
               Column(name="truth inside", number=False), Column(name="truth minus median", unit="posterior standard "
               "deviations"))
    note = "The truth is what the virtual turbine was built with, under the same names. "
    if run.jacket:
        note += (
            "m_h and a_m enter both turbines alike. k_j, k_t, k_TP, k_p and LJF multiply members that the virtual one "
            "has with other element theory and walls and joints off their drawings by a per cent or two. py, tz and qw "
            "scale another soil's curves, leg by leg drawn again, and correspond on the average of the legs only. "
        )
    others = [n for n in _true_parameters(run) if n not in update.parameters.names]
    if others:
        note += f"Known and not updated here: {', '.join(others)}. "
    note += "Tolerances, damping and sensors' gains are drawn, in no parameter, and cannot be found."
    return Table(caption="Truth beside what was found", columns=columns, rows=tuple(rows), note=note,
                 marked=frozenset(outside))


def _values_table(rows: tuple[ComparisonRow, ...]) -> Table:
    columns = (Column(name="parameter", number=False), Column(name="unit", number=False), Column(name="prior mean"),
               Column(name="prior standard deviation"), Column(name="update, step penalty"),
               Column(name="update, prior penalty"),
               Column(name="MAP"), Column(name="posterior mean"), Column(name="posterior median"),
               Column(name="posterior standard deviation"), Column(name="posterior "
               "CoV", unit="-"), Column(name="5–95 %"))
    cells = []
    for r in rows:
        cells.append((r.name, r.unit or "-", number(r.prior_mean), number(r.prior_std), number(r.step),
                      number(r.anchored), number(r.map) + ("" if r.low <= r.map <= r.high else " *"),
                      number(r.mean), number(r.median), number(r.std),
                      number(r.cov, 2), f"{number(r.low)} to {number(r.high)}"))
    return Table(caption="The same parameters by every route", columns=columns, rows=tuple(cells),
                 note="Prior mean and standard deviation are those after its cut at the bounds; 5–95 %: of the "
                      "posterior."
                 + (" * the most probable value lies outside them: a peak at the edge, not the middle."
                    if any(not r.low <= r.map <= r.high for r in rows) else ""))


def _distance_table(rows: tuple[ComparisonRow, ...]) -> Table:
    columns = (Column(name="parameter", number=False), Column(name="step penalty"), Column(name="prior penalty"),
               Column(name="MAP"),
               Column(name="posterior over prior standard deviation"), Column(name="the data", number=False),
               Column(name="why they differ", number=False))
    names = [r.name for r in rows]
    cells = []
    for r in rows:
        words = " ".join([r.sentence, *(full_sentence(flag, names) for flag in r.flags)]).strip()
        cells.append((r.name, *map(_format_signed, (r.step_distance, r.anchored_distance, r.map_distance)),
                      decimal(r.contraction, 2), r.identified, words))
    far = {k for k, r in enumerate(rows) if max(abs(r.step_distance), abs(r.anchored_distance)) > 1}
    return Table(caption="Distance from the posterior mean, in posterior standard deviations", columns=columns,
                 rows=tuple(cells), marked=frozenset(far),
                 note="Emphasised: an update more than one posterior standard deviation from the posterior mean.")


def _format_signed(value: float) -> str:
    text = decimal(value, 2)
    return f"+{text}" if value > 0 and text != "0.00" else text
