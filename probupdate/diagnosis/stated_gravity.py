"""Whether what is stated of gravity in all readings is right: one question of its own, beside the search for the rest.

A search through thousands of candidates asks each of them for a score that none reaches by chance; a statement that is
right or wrong is one candidate, known beforehand, with one size. Its estimate at the final fit, with all that is normal
marginalised, is compared with both: size 0, as stated, and 1, the other way.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import special, stats

from probupdate.diagnosis.adequacy import residual_of
from probupdate.diagnosis.diagnose import Outcome
from probupdate.diagnosis.engine.verdict import CHANCE, SURE
from probupdate.diagnosis.results import Alternative, Diagnosis, Finding
from probupdate.diagnosis.search import FALSE_NEXT
from probupdate.effects.gravity import ALL, CAUSE

# least share of a signature's length that is its own
LEAST_LEFT = 1e-3


def with_gravity_test(outcome: Outcome, found: Diagnosis) -> Diagnosis:
    """The diagnosis with a finding where the readings hold the other of what is stated; where the record cannot tell,
    the row's detectable size says so."""
    problem, fitted = outcome.problem, outcome.fitted
    design = fitted.design
    named = {f.key for f in found.findings}
    asked = [e.cause == CAUSE and ALL in e.location and e.key not in named for e in problem.effects]
    rows = [k for k, (j, _) in enumerate(design.which) if asked[j] and design.share_left[k] > LEAST_LEFT]
    if not rows:
        return found
    score, unexplained = design.scores(fitted.centred), _unexplained_by(outcome)
    findings = []
    for k in rows:
        effect, std = problem.effects[design.which[k][0]], float(1 / np.sqrt(design.information[k]))
        size, std = float(score[k] * std**2), unexplained * std
        # ln of the evidence of size 1 over that of size 0, both alike before
        wrong = float(special.expit((2 * size - 1) / (2 * std**2)))
        if size / std > stats.norm.isf(FALSE_NEXT) and wrong > 0.5:
            chance = Alternative(cause=CHANCE, location="", posterior_probability=1 - wrong, key=CHANCE)
            findings.append(Finding(
                kind=effect.kind, cause=effect.cause, location=effect.location, size=size, size_std=std,
                unit=effect.unit, time_profile="constant", time_profile_start="", z=size / std,
                posterior_probability=wrong, prior_probability=0.5, alternatives=(chance,), check=effect.check,
                key=effect.key))
    if findings and found.verdict == "none":
        sure = all(f.posterior_probability >= SURE for f in findings)
        found = replace(found, verdict="named" if sure else "ambiguous")
    return replace(found, findings=(*found.findings, *findings))


def _unexplained_by(outcome: Outcome) -> float:
    """How many times their standard deviations the residuals' means are, root mean square, 1 at least: what is not
    explained moves an estimate by as much (Birge 1932)."""
    value, covariance = residual_of(outcome.fitted, len(outcome.problem.updated)).means
    return max(1.0, float(np.sqrt(np.mean(value**2 / np.diag(covariance)))))
