"""What would distinguish the causes that an ambiguous finding leaves: how alike they are, and where they differ."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from scipy import linalg

from probupdate.diagnosis.diagnose import Outcome
from probupdate.diagnosis.engine.verdict import SURE
from probupdate.diagnosis.fitting import error_scale
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.mode_numbers import labels_of
from probupdate.diagnosis.problem import DiagnosisProblem
from probupdate.diagnosis.results import Finding
from probupdate.diagnosis.search import model_error_dispersion

# alternatives less probable than this are not looked into; at most so many
PROBABLE, MOST = 0.02, 3
# two causes whose scores correlate by rho are distinguished in 95 % of records from |z| = this times sqrt(2 / (1 -
# rho))
QUANTILE = 1.6448536269514722
# so many responses are named in which two causes differ most
N_PLACE = 2


def splits(outcome: Outcome) -> tuple[str, ...]:
    """A sentence for every pair of a finding that is not sure and one of its alternatives."""
    problem, design = outcome.problem, outcome.null.design
    sentences = []
    for finding in outcome.diagnosis.findings:
        if finding.posterior_probability >= SURE:
            continue
        best = _candidate(problem, finding, finding.key)
        for other in finding.alternatives[:MOST]:
            competitor = _candidate(problem, finding, other.key)
            if best is not None and competitor is not None and other.posterior_probability > PROBABLE:
                sentences.append(_sentence(problem, design, finding, best, competitor))
    return tuple(sentences)


def _candidate(problem: DiagnosisProblem, finding: Finding, key: Hashable) -> int | None:
    """The candidate of that row of the catalogue whose time profile is the finding's, or nearest to it; None if it has
    none."""
    ids = problem.blocks.ids
    start = ids.index(finding.time_profile_start) if finding.time_profile_start in ids else 0
    found = [
        (abs(problem.time_profiles[c].at - start), k) for k, (j, c) in enumerate(problem.which)
        if problem.effects[j].key == key
        and problem.time_profiles[c].name == finding.time_profile
    ]
    return min(found)[1] if found else None


def distinguishing_z(score_correlation: float, error: float = 0.0) -> float:
    """|z| from which two causes whose scores correlate by `score_correlation` are distinguished in 95 % of records,
    their signatures known but for a share `error` (`model_error_dispersion`); inf where no |z| is enough."""
    by_noise = QUANTILE * np.sqrt(2 / max(1 - score_correlation, 1e-6))
    left = 1 + by_noise**2 * (1 - model_error_dispersion(1.0, error))
    return float(by_noise / np.sqrt(left)) if left > 0 else np.inf


def _sentence(problem: DiagnosisProblem, design: Design, finding: Finding, best: int, competitor: int) -> str:
    score_correlation = float(np.abs(design.score_correlation([best, competitor])[0, 1]))
    first, second = (problem.effects[problem.which[k, 0]] for k in (best, competitor))
    error = error_scale(first)
    needed = distinguishing_z(score_correlation, error)
    text = (f"{first.name} and {second.name} have a score correlation of {score_correlation:.2f} after "
            "tolerances and normal variation are allowed for: ")
    if score_correlation > 0.999:
        return text + f"no record of these modes and channels distinguishes them; {_checks(first, second)}"
    places = " and ".join(places_of_difference(problem, design, best, competitor))
    if not np.isfinite(needed):
        return text + (f"with signatures known to {error:.0%} no length of record distinguishes them; they differ most "
                       f"in {places}; {_checks(first, second)}")
    if needed <= abs(finding.z):
        return text + (f"records of this length distinguish small ones (from |z| of {needed:.0f} on, here it is "
                       f"{abs(finding.z):.0f}), but at their full size both explain this one about as well: a longer "
                       f"record helps little; they differ most in {places}; {_checks(first, second)}")
    text += f"distinguishing them needs |z| of {needed:.0f}, here it is {abs(finding.z):.0f}; "
    if finding.time_profile != "constant":
        times = (needed / abs(finding.z)) ** 2
        text += f"about {times:.{0 if times > 3 else 1}f} times as many blocks would do, or "
    return text + f"they differ most in {places}; {_checks(first, second)}"


def _checks(first, second) -> str:
    checks = [f"{e.name}: {e.check}" for e in (first, second) if e.check]
    return "on site, " + "; ".join(checks) if checks else "neither names a check on site"


def places_of_difference(problem: DiagnosisProblem, design: Design, best: int, competitor: int) -> list[str]:
    """The responses in which two causes of the same strength differ most, in standard deviations, after what is normal
    has taken its part."""
    blocks = problem.blocks
    time_profile = problem.time_profiles[problem.which[best, 1]]
    j, i = (int(problem.which[k, 0]) for k in (best, competitor))
    prints, noise, columns, names = [], [], [], []
    for q, group in enumerate(blocks.groups):
        weight = design.noise.weight[q]
        share = np.bincount(design.bin_of, weight, design.n_bin) / max(weight.sum(), 1e-12)
        prints.append(np.einsum("g,gmk->mk", share, design.effect[q][:, :, [j, i]]))
        columns.append(np.einsum("g,gmk->mk", share, design.nuisance[q]) * design.nuisance_std)
        own = design.noise.covariance[q] / max(weight.sum(), 1e-12)
        # what runs along the record is free of every offset
        noise.append(own + np.diag(design.discrepancy_std[q] ** 2) if time_profile.kind == "constant" else own)
        names += labels_of(blocks.group_name(q), len(group), blocks.channels)
    prints, noise, columns = np.concatenate(prints), linalg.block_diag(*noise), np.concatenate(columns)
    precision = np.linalg.inv(noise)
    if time_profile.kind == "constant":
        inner = np.eye(columns.shape[1]) + columns.T @ precision @ columns
        precision = precision - precision @ columns @ np.linalg.solve(inner, columns.T @ precision)
    first, second = prints.T
    amount = (first @ precision @ second) / (second @ precision @ second)
    # the share of each response in what separates the two
    apart = first - amount * second
    checks = np.abs(apart * (precision @ apart))
    return [names[k] for k in np.argsort(-checks)[:N_PLACE]]
