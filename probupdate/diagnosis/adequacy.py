"""The test of the rest: is what the fit leaves more than noise, in directions that some effect could take or in
the frequencies as such?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from probupdate.diagnosis.fitting import Fit
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.problem import DiagnosisProblem
from probupdate.diagnosis.residual_state import residual_of
from probupdate.diagnosis.search import Search

# the pattern of the noise is known to about a tenth of a variance (few columns, states that differ: 0.89 to 1.12 in
# records whose noise was known), which sums of many squares see though no single score does
PATTERN = 1.05
# directions of the catalogue's span that are tested for a residual, by their share of the largest
SPAN = 1e-2
# of frequencies their tolerances and the fit leave fewer directions, and each of them is tested
FREE = 1e-6
FREQUENCIES = "frequencies"
# standard deviations from which a mode's mean frequency is said to be off, beside a residual that is not explained
OFF = 3.0


def adequacy(
    problem: DiagnosisProblem, fitted: Fit, found: Search, drawn: np.ndarray
) -> tuple[float, dict[str, float]]:
    """p of what remains. In the directions that the catalogue spans: constants together, and each time profile along
    the record; the smallest of them against its own bootstrap distribution. And in the mean frequencies, which what no
    row of the catalogue does moves too: the smaller of both, twice. With it each part's own p. `drawn`: scores (n_draw,
    n_candidate) of drawn records at that fit (`drawn_scores`)."""
    free, all_of_them = _frequencies(problem, fitted, found), _spanned(problem, fitted, found, drawn)
    if all_of_them is None:
        return free, {FREQUENCIES: free}
    p, parts = all_of_them
    return min(1.0, 2 * min(p, free)), {**parts, FREQUENCIES: free}


def _spanned(
    problem: DiagnosisProblem, fitted: Fit, found: Search, drawn: np.ndarray
) -> tuple[float, dict[str, float]] | None:
    """None where so few effects are listed that the directions of what is left are theirs alone."""
    design = fitted.design
    names, rare = [], []
    # crosstalks may have been taken up after the search
    usable = _spanning(problem, design)[: len(found.which)]
    for c, time_profile in enumerate(problem.time_profiles):
        rows = np.flatnonzero((found.which[:, 1] == c) & usable)
        if len(rows) < 5:
            continue
        white = _whitening(design, rows)
        z = np.vstack([found.u[None, rows], drawn[:, rows]]) @ white
        z[0] /= PATTERN * found.heavier if time_profile.kind == "constant" else found.heavier * np.maximum(
            1.0, design.scatter(fitted.centred, c, found.which[rows, 0], white))
        names.append(f"{time_profile.name} {time_profile.at}".strip())
        rare.append(stats.chi2.logsf(np.sum(z**2, axis=1), z.shape[1]))
    if not rare:
        return None
    # the rarest over the time profiles, of the record and of every drawn one alike: by ranks among the drawn ones, a
    # record above all of them along any one time profile would be rarer than each of these can be
    rarest = np.min(rare, axis=0)
    p = float((1 + np.sum(rarest[1:] <= rarest[0])) / (len(drawn) + 1))
    return p, {name: float(np.exp(values[0])) for name, values in zip(names, rare, strict=True)}


def _frequencies(problem: DiagnosisProblem, fitted: Fit, found: Search) -> float:
    """p of the mean frequencies together (of a pair: its tensor's three numbers), beyond all that is normal: no shape,
    whose noise is known less well, takes part."""
    design = fitted.design
    own = [1 if axes.shape[1] == 1 else 3 for axes in problem.predictor.axes]
    first, n_effect = np.concatenate([[0], np.cumsum(own)]), len(problem.effects)
    signatures = []
    for q, made in enumerate(design.effect):
        unit = np.zeros((*made.shape[:2], first[-1]))
        unit[:, np.arange(own[q]), np.arange(first[q], first[q + 1])] = 1.0
        signatures.append(np.concatenate([made, unit], axis=2))
    measured = [k for q, n in enumerate(own) if design.noise.weight[q].any() for k in range(first[q], first[q] + n)]
    constant = next(c for c in design.time_profiles if c.kind == "constant")
    which = np.array([(n_effect + k, 0) for k in measured])
    moved = replace(design, effect=tuple(signatures), time_profiles=(constant,), which=which)
    rows = np.flatnonzero(moved.share_left > FREE)
    if not len(rows):
        return 1.0
    z = moved.scores(fitted.centred)[rows] / (PATTERN * found.heavier) @ _whitening(moved, rows, FREE)
    return float(stats.chi2.sf(z @ z, len(z)))


def frequencies_off(problem: DiagnosisProblem, fitted: Fit) -> list[str]:
    """What to say of the modes whose mean frequency the fit leaves off."""
    left, off = residual_of(fitted, len(problem.updated)), []
    for q, axes in enumerate(problem.predictor.axes):
        value, std = left.along(q, left.mean_share(q))
        # of a pair the third number turns its two axes
        worst = max(range(1 if axes.shape[1] == 1 else 2), key=lambda k: abs(value[k]) / std[k])
        if abs(value[worst]) > OFF * std[worst]:
            off.append(f"{problem.blocks.group_name(q)} {100 * value[worst]:+.2f} % (expected within "
                       f"{100 * std[worst]:.2g} %)")
    return [f"measured frequencies are off what the fit explains: {', '.join(off)}"] if off else []


def span_left(problem: DiagnosisProblem, fitted: Fit, time_profile: int) -> tuple[float, int]:
    """Sum of squares of what remains in the directions the catalogue spans with one time profile, and their number:
    zero and one where unknowns can follow all of them."""
    design = fitted.design
    rows = np.flatnonzero((problem.which[:, 1] == time_profile) & _spanning(problem, design))
    if not len(rows):
        return 0.0, 1
    z = design.scores(fitted.centred)[rows] @ _whitening(design, rows)
    return float(z @ z), len(z)


def _spanning(problem: DiagnosisProblem, design: Design) -> np.ndarray:
    """(n_candidate,) bool: what spans the directions of the rest; exchanged cables of any two sensors would span
    every shape."""
    return (design.share_left > 1e-3) & np.array([not problem.effects[j].discrete for j, _ in design.which])


def _whitening(design: Design, rows: np.ndarray, least: float = SPAN) -> np.ndarray:
    """(n_row, n_direction): u of these candidates -> independent standard normal numbers when nothing is wrong."""
    value, turn = np.linalg.eigh(design.score_correlation(rows))
    kept = value > least * value[-1]
    return turn[:, kept] / np.sqrt(value[kept]) / np.sqrt(design.information[rows])[:, None]
