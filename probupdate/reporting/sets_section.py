"""Sections on all sets in four views, and on what the data say of each parameter; read from sets.json and
information.json of the run, absent where these are."""

from __future__ import annotations

import numpy as np

from probupdate.reporting import paper_tables
from probupdate.reporting.elements import (
    Column,
    Element,
    Items,
    Notice,
    Section,
    Table,
    Text,
    decimal,
    full_sentence,
    number,
    percent,
)
from probupdate.reporting.values import Run
from probupdate.updating.information import METRIC_WORDS, Information, read_information, recommendation
from probupdate.updating.set_views_file import SetViews, read_views, tau_interval


def sets_section(run: Run) -> Section | None:
    path = run.folder / "sets.json"
    if not path.exists():
        return None
    views = read_views(path)
    items: list[Element] = [Notice(level="good" if views.converged else "warning", text=f"Population {views.verdict}.")]
    items += [_views_table(views), Text(paragraphs=(views.advice,)), _score_table(views)]
    if views.modes:
        items.append(_modes_table(views))
    notes = tuple(full_sentence(n, [r.name for r in views.rows]) for n in views.notes)
    items.append(Items(title="Notes on all sets", statements=notes))
    return Section(anchor="sets", title="All sets", items=tuple(items),
                   lead=f"{len(views.ids)} sets read in four ways: what each says, and which is for what.")


def _views_table(views: SetViews) -> Table:
    columns = (
        Column(name="parameter", number=False), Column(name="prior CoV", unit="-"),
        Column(name="(a) updates: mean"), Column(name="CoV", unit="-"), Column(name="resolution", unit="-"),
        Column(name="(b) pooled: mean"), Column(name="CoV", unit="-"), Column(name="(c) one for all: mean"),
        Column(name="CoV", unit="-"), Column(name="(d) population: middle"), Column(name="CoV of the middle", unit="-"),
        Column(name="scatter between sets"), Column(name="5–95 %"),
        Column(name="CoV of a new set", unit="-"), Column(name="the sets say", number=False),
    )
    rows = []
    for r in views.rows:
        interval = tau_interval(r)
        rows.append((
            r.name, decimal(r.prior_cov, 2), number(r.scatter_mean), decimal(r.scatter_cov, 3), decimal(r.resolution,
                                                                                                        2),
            number(r.pooled_mean), decimal(r.pooled_cov, 3), number(r.joint_mean), decimal(r.joint_cov,
                                                                                           3), number(r.mean),
            decimal(r.mean_cov, 3), decimal(r.tau, 3), interval, decimal(r.population_cov, 3),
            full_sentence(r.sentence, (r.name,)) if np.isfinite(r.tau) else "",
        ))
    absolute = ", ".join(r.name for r in views.rows if not r.tau_relative)
    absolute = absolute and f", but of {absolute} a standard deviation in the parameter's unit"
    return Table(caption="The same sets in four views", columns=columns, rows=tuple(rows),
                 note=f"Weights: {views.settings['weights']}. Scatter between sets: median, a CoV"
                 f"{absolute}; its hyper-prior is {views.settings['hyper-prior of tau']}.")


def _score_table(views: SetViews) -> Table:
    names = tuple(views.scores.score)
    rows = [
        (id, *(decimal(float(views.scores.score[name][j]), 1) for name in names), decimal(views.scores.pareto_k[j], 2),
         "yes" if views.scores.refitted[j] else "no", decimal(views.linear_share[j], 2))
        for j, id in enumerate(views.ids)
    ]
    rows.append(("sum", *(decimal(float(np.sum(views.scores.score[name])), 1) for name in names), "", "", ""))
    columns = (Column(name="set left out", number=False), *(Column(name=name) for name in names),
               Column(name="Pareto k", unit="-"), Column(name="refitted", number=False),
               Column(name="confirmed by the full model", unit="-"))
    return Table(caption="ln p of each set's data given the others", columns=columns, rows=tuple(rows), width="half",
                 note="Each set alone: from the prior. Refitted: sampled again without the set, as weights failed.")


def _modes_table(views: SetViews) -> Table:
    rows = tuple(
        (m.label, str(m.n_set), percent(m.scatter, 2), percent(m.stated, 2), percent(m.variation, 2),
         f"{percent(m.low, 2)} to {percent(m.high, 2)}", number(m.p_value, 2)) for m in views.modes
    )
    columns = (Column(name="mode", number=False), Column(name="sets"), Column(name="scatter of f", unit="%"),
               Column(name="stated by identification", unit="%"), Column(name="variation left", unit="%"),
               Column(name="90 % interval", unit="%"), Column(name="p of none"))
    return Table(caption="Noise and variation of frequencies", columns=columns, rows=rows, width="half")


def information_section(run: Run) -> Section | None:
    path = run.folder / "information.json"
    if not path.exists():
        return None
    found = read_information(path)
    items: list[Element] = [_information_table(found, run.jacket)]
    names = [r.name for r in found.rows]
    items.append(Items(title="Recommended", statements=tuple(map(full_sentence, recommendation(found)))))
    directions = tuple((decimal(d.bits, 2), decimal(d.contraction, 2), d.text) for d in found.directions)
    items.append(Table(
        caption="Directions that the data inform, in prior standard deviations", rows=directions, width="half",
        columns=(Column(name="bits"), Column(name="width left", unit="-"), Column(name="direction", number=False)),
        note=f"All parameters together: {found.total_bits:.1f} bits."))
    if found.pairs:
        items.append(Items(title="Parameters that compensate one another",
                           statements=tuple(full_sentence(p.sentence, (p.first, p.second)) for p in found.pairs)))
    if found.check is not None:
        items.append(Items(title="Did the prior expect these data?",
                           statements=tuple(full_sentence(t, names) for t in found.check.sentences)))
    return Section(anchor="information", title="Information", items=tuple(items),
                   lead="Information in the data about each parameter, and which to update.")


def _information_table(found: Information, jacket: bool) -> Table:
    columns = [
        Column(name="parameter", number=False), Column(name="value"), Column(name="prior CoV", unit="-"),
        Column(name="uncertainty", number=False), Column(name="ln f per ln parameter", unit="-"),
        Column(name="of", number=False), Column(name="sensitivity", number=False), Column(name="signal", unit="-"),
        Column(name="width left", unit="-"), Column(name="bits"), Column(name="sampled: width", unit="-"),
        Column(name="sampled: bits"), Column(name="role", number=False),
    ]
    if jacket:
        columns += [Column(name="paper: uncertainty", number=False, paper=True),
                    Column(name="paper: sensitivity", number=False, paper=True)]
    rows = []
    for r in found.rows:
        row = (r.name, number(r.value), decimal(r.cov, 3), METRIC_WORDS[r.uncertainty] if r.uncertainty >= 0 else "",
               decimal(r.slope, 3), r.slope_mode, METRIC_WORDS[r.sensitivity], decimal(r.signal, 2),
               decimal(r.contraction, 2), decimal(r.bits, 2),
               decimal(r.sampled_contraction, 2), decimal(r.sampled_bits, 2), r.role)
        if jacket:
            printed = paper_tables.SENSITIVITY.get(r.name)
            row += ("", "") if printed is None else (METRIC_WORDS[printed[0]], METRIC_WORDS[printed[2]])
        rows.append(row)
    note = "; ".join(f"{name}: {text}" for name, text in found.settings.items())
    caption = "Which parameters" + (" (Table 2)" if jacket else "")
    return Table(caption=caption, columns=tuple(columns), rows=tuple(rows),
                 note=f"Signal: standard deviations of the data moved by one prior standard deviation. Width: of the "
                      f"prior's. {note}.")
