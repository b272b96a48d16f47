"""The first section (the verdict) and the last (provenance)."""

from __future__ import annotations

import numpy as np

from probupdate.comparison import BLIND, STRONG
from probupdate.estimators.update_file import UpdateRecord, fit_sentence
from probupdate.reporting import figures
from probupdate.reporting.elements import (
    Column,
    Items,
    Notice,
    Picture,
    Section,
    Table,
    Tile,
    Tiles,
    fixed,
    number,
    plural,
)
from probupdate.reporting.posterior_sections import marks
from probupdate.reporting.updating_sections import fits, scheme_name
from probupdate.reporting.values import Run

# computed over measured frequency beyond which a pair made by shape is doubted
FAR_OFF = 1.6


def verdict_section(run: Run) -> Section:
    items: list[object] = [Tiles(items=tuple(_tiles(run)))]
    if run.update is not None:
        used = np.isfinite(run.update.initial_hz)
        computed = {"initial model": run.update.initial_hz[used]}
        computed |= {f"updated, {scheme_name(s)}": s.frequency_hz[used] for s in run.update.schemes}
        labels = [label for label, here in zip(run.update.labels, used, strict=True) if here]
        items.append(
            Picture(
                svg=figures.svg_text(
                    figures.frequency_errors(labels, run.update.measured_hz[used], computed), "errors"),
                caption="How far each computed frequency is from the measured one, before and after the update.",
            )
        )
        draws = run.posterior.draws if run.posterior is not None else None
        items.append(
            Picture(
                svg=figures.svg_text(figures.departures(run.update.parameters.items, draws, marks(run)), "departures"),
                caption="Where each parameter went. A posterior as wide as the grey bar has learned nothing from the "
                "data; estimates far from the posterior's middle are not to be trusted. MAP: the most probable "
                "parameters.",
            )
        )
    doubts = uncertain(run)
    if doubts:
        items.append(Items(title="What to keep in mind", statements=tuple(doubts)))
    if run.missing:
        items.append(Notice(level="missing", text="; ".join(run.missing) + "."))
    return Section(anchor="verdict", title="Verdict", items=tuple(items), lead=_sentence(run))


def _worst(measured: np.ndarray, computed: np.ndarray) -> float:
    return float(np.nanmax(np.abs(computed / measured - 1)))


def _sentence(run: Run) -> str:
    if run.update is None:
        return "The model has not been updated in this run."
    before = _worst(run.update.measured_hz, run.update.initial_hz)
    after = _worst(run.update.measured_hz, run.update.map_hz)
    words = (
        f"The largest frequency error falls from {100 * before:.1f} % with the initial model to {100 * after:.1f} % at "
        "the most probable parameters."
    )
    if run.posterior is not None:
        ratio = contraction(run)
        strong = [n for n, r in zip(run.update.parameters.names, ratio, strict=True) if r < STRONG]
        kept = [n for n, r in zip(run.update.parameters.names, ratio, strict=True) if r > BLIND]
        words += f" Of {plural(len(ratio), 'parameter')} the data inform {len(strong)} strongly"
        words += f" ({', '.join(strong)})" if strong else ""
        words += f"; {len(kept)} keep their prior" + (f" ({', '.join(kept)})." if kept else ".")
    return words


def contraction(run: Run) -> np.ndarray:
    prior = np.array([p.distribution.std() for p in run.update.parameters])
    return np.std(run.posterior.draws, axis=0, ddof=1) / prior


def _tiles(run: Run) -> list[Tile]:
    tiles = []
    if run.update is not None:
        update = run.update
        worst = int(np.nanargmax(np.abs(update.initial_hz / update.measured_hz - 1)))
        after = _worst(update.measured_hz, update.map_hz)
        tiles.append(Tile(
            label="largest frequency error", level="good" if after < 0.02 else "warning",
            value=f"{100 * _worst(update.measured_hz, update.initial_hz):.1f} → {100 * after:.1f} %",
            detail=f"worst mode at first: {update.labels[worst]}, measured {update.measured_hz[worst]:.3f} Hz, "
            f"computed {update.initial_hz[worst]:.3f} → {update.map_hz[worst]:.3f} Hz"))
        tiles.append(_fit_tile(update))
        for s in update.schemes:
            tiles.append(Tile(
                label=f"update, {scheme_name(s)}", level="good" if s.converged else "warning",
                value="converged" if s.converged else "not converged",
                detail=f"{plural(len(s.theta) - 1, 'iteration')}, "
                f"{plural(int(s.at_bound.sum()), 'parameter')} at a bound"))
    if run.posterior is not None:
        posterior = run.posterior
        detail = []
        detail.append(f"at least {fixed(float(np.min(posterior.ess)), 0)} effective draws")
        detail.append(f"R-hat at most {fixed(float(np.max(posterior.r_hat)), 4)}")
        tiles.append(Tile(label="posterior", level="good" if posterior.converged else "warning",
                          value="converged" if posterior.converged else "not converged", detail=", ".join(detail)))
    if run.modes is not None:
        blocks = len(run.modes.sets)
        identified = sum(bool(s.measured.any()) for s in run.modes.sets)
        selected = len(run.nine.sets) if run.nine is not None else None
        detail = f"{plural(blocks, 'set')} of modes"
        if run.selection is not None:
            passed = int((run.selection["criterion"].fillna("") == "").sum())
            detail = f"modes found in {identified} of {blocks} blocks, {passed} pass every criterion"
        value = f"{selected} of {blocks}" if selected is not None else str(blocks)
        tiles.append(Tile(label="sets used" if selected is not None else "modal sets", value=value, detail=detail))
    return tiles


def _fit_tile(update: UpdateRecord) -> Tile:
    """Misfit in standard deviations per response: 1 is what a true model with right deviations would have."""
    ratio = float(np.sqrt(update.map_misfit / update.n_effective))
    level = "good" if fits(update) else "warning"
    return Tile(label="misfit at the most probable parameters", level=level, value=f"{number(ratio, 2)} deviations",
                detail=f"root mean square of {update.n_effective} effective responses; 1 for a true model and right "
                "deviations")


def uncertain(run: Run) -> list[str]:
    """Statements on what does not hold or is not known: bounds, uninformed parameters, convergence, fallbacks."""
    said: list[str] = []
    said += run.warnings
    if run.update is not None:
        if not fits(run.update):
            text = fit_sentence(run.update)
            said.append(f"{text[0].upper()}{text[1:]}.")
        said += _too_close(run.update)
        said += _far_off(run.update)
        for s in run.update.schemes:
            if not s.converged:
                said.append(f"The update with {scheme_name(s)} did not converge: {s.status}.")
            held = [n for n, b in zip(run.update.parameters.names, s.at_bound, strict=True) if b]
            if held:
                said.append(f"Held at a bound by the update with {scheme_name(s)}: {', '.join(held)}.")
        said += [f"Left out: {t}." for t in run.update.left_out]
    if run.posterior is not None and run.update is not None:
        if not run.posterior.converged:
            said.append(run.posterior.verdict)
        ratio = contraction(run)
        kept = [n for n, r in zip(run.update.parameters.names, ratio, strict=True) if r > BLIND]
        if kept:
            said.append(f"Not informed by the data, so the posterior is the prior: {', '.join(kept)}.")
        if len(ratio) > 1:
            correlation = np.corrcoef(run.posterior.draws.T)
            names = run.update.parameters.names
            close = [f"{names[i]} and {names[j]} ({fixed(correlation[i, j], 2)})" for i in range(len(names))
                     for j in range(i) if abs(correlation[i, j]) > 0.9]
            if close:
                said.append(f"Known only together (posterior correlation beyond 0.9): {', '.join(close)}.")
        said += [f"{t[0].upper()}{t[1:]}." for t in run.posterior.record.get("notes", ())
                 if t not in run.update.left_out]
    if run.comparison is not None:
        far = [r.name for r in run.comparison.rows if abs(r.step_distance) > 1]
        if far:
            said.append("The update as printed ends more than one posterior deviation from the posterior mean in "
                        f"{', '.join(far)}.")
    return said


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
