"""What a finding is worth: blocks that took no part in the fit, predicted without it and with it.

The record is cut into contiguous folds; each is predicted from all others by the model as it is and by the model
with the effect. Reported are the gain in expected log predictive density (Gneiting & Raftery 2007; Vehtari, Gelman &
Gabry 2017), the continuous ranked probability score, errors of frequencies and MAC before and after. The effect itself
was chosen on the whole record, so that a gain is a check, not a second discovery.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from probupdate.diagnosis.diagnose import Outcome
from probupdate.diagnosis.fitting import Fit, fit
from probupdate.diagnosis.linear import Design
from probupdate.diagnosis.noise import Noise
from probupdate.diagnosis.prediction import (
    Prediction,
    carried_unknowns,
    covariance_root,
    crps,
    log_density,
    predict,
    solve_covariance,
    sum_over_blocks,
)
from probupdate.diagnosis.problem import DiagnosisProblem, IncludedEffect
from probupdate.errors import ConvergenceError
from probupdate.runtime.executors import SERIAL, Executor
from probupdate.runtime.progress import Progress, silent

# contiguous folds of the record, each predicted from the others: so many, or more where one side of a step is short
N_FOLD, MOST_FOLDS = 5, 24
# a gain of fewer of its standard errors is none
SIGNIFICANT = 2.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Contest:
    """Held-out blocks under two models with the same noise: elpd gained by the second, its standard error, the part of
    every block (n_block,), `snr` of the two predictions' difference; predictions of each fold."""

    elpd: float
    elpd_se: float
    by_block: np.ndarray
    snr: float
    before: tuple[Prediction, ...]
    after: tuple[Prediction, ...]

    @property
    def significant(self) -> bool:
        return self.elpd > SIGNIFICANT * self.elpd_se


def folds(n_block: int, n_fold: int = N_FOLD) -> np.ndarray:
    """(n_block,) number of the contiguous fold each block belongs to; all of about one length."""
    return np.arange(n_block) * min(n_fold, n_block) // n_block


def count_folds(n_block: int, included: Sequence[IncludedEffect]) -> int:
    """Folds: none holds more than half of what lies on one side of a step, else nothing is left to show its size
    from."""
    sides = [min(n.time_profile.at, n_block - n.time_profile.at) for n in included if n.time_profile.kind == "step"]
    wanted = max([N_FOLD, *(-(-2 * n_block // max(side, 1)) for side in sides)])
    return min(wanted, MOST_FOLDS, n_block)


def with_noise(design: Design, noise: Noise) -> Design:
    """The design for prediction: another noise, no candidates."""
    return replace(design, noise=noise, time_profiles=design.time_profiles[:1], which=np.zeros((0, 2), int))


def contest(
    before: tuple[Design, Sequence[np.ndarray]], after: tuple[Design, Sequence[np.ndarray]], *,
    n_fold: int = N_FOLD,
) -> Contest:
    """Two fits, each a design and its centred residuals, on the same held-out blocks. Both are scored with the noise
    of the first, so that a different estimate of the noise counts neither for nor against an effect.

    All held-out blocks are scored together, each by its residual from a prediction that did not see it: what is not
    known of the model is common to all of them. Were it taken as new in every fold, a constant residual would count
    once for each fold, and a step would pass for a new offset. By how much a prediction without a fold differs
    from one with it is that fold's own.

    The standard error is the larger of two: that of the predictive distribution, sqrt(D^T C^-1 D) for predictions that
    differ by D, and that of batch means over successive blocks, which shows what unrest and memory of the blocks
    themselves do to the sum.
    """
    noise = before[0].noise
    n_block = len(before[0].bin_of)
    fold, every = folds(n_block, n_fold), np.arange(n_block)
    designs = [with_noise(d, noise) for d, _ in (before, after)]
    centred = [y for _, y in (before, after)]
    sides = [tuple(predict(d, y, fold == k) for k in range(fold.max() + 1))
             for d, y in zip(designs, centred, strict=True)]
    residuals = [_join_residuals(side) for side in sides]
    whole = [carried_unknowns(d, y, every) for d, y in zip(designs, centred, strict=True)]
    # what all blocks have in common, then what each fold has besides
    parts = [[(rows, covariance_root(C, d.prior_std[: len(C)])) for rows, C in ((every, shared), *own)]
             for d, (_, Q), side in zip(designs, whole, sides, strict=True)
             for shared, own in [shared_covariance(d, Q, side)]]
    densities = [log_density(d, r, own)[0] for d, r, own in zip(designs, residuals, parts, strict=True)]
    # by which predictions from the whole record differ: what varies between folds is no difference of the models
    left = [[np.where(w[:, None] > 0, a - m, 0.0) for a, m, w in
             zip(y, d.expected_residuals(mean), noise.weight, strict=True)]
            for d, y, (mean, _) in zip(designs, centred, whole, strict=True)]
    difference = [a - b for a, b in zip(*left, strict=True)]
    solution = solve_covariance(designs[0], difference, parts[0])
    gained = densities[1] - densities[0]
    variance = 0.0
    for places, root in parts[1]:
        there = sum_over_blocks(designs[1].select_blocks(places), [w[places] for w in solution.solved])
        variance += float(np.sum((root.T @ there[: len(root)]) ** 2))
    for a, covariance, weight in zip(solution.solved, noise.covariance, noise.weight, strict=True):
        measured = weight > 0
        squares = np.einsum("ni,ij,nj->n", a, covariance, a, optimize=True)
        variance += float(np.sum(squares[measured] / weight[measured]))
    se = max(np.sqrt(variance), batch_error(gained - 0.5 * solution.shares))
    return Contest(elpd=float(gained.sum()), elpd_se=float(se), by_block=gained, before=sides[0], after=sides[1],
                   snr=float(np.sqrt(max(float(solution.shares.sum()), 0.0))))


def shared_covariance(
    design: Design, Q: np.ndarray, predictions: Sequence[Prediction]
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Covariance of how all predictions differ and of how each does besides in the unknowns that are carried, such that
    a fold differs as its own prediction says and the mean over folds as the whole record does, by Q: estimates from a
    part differ from that of the whole by what the part knows less, and these differences nearly cancel. Residuals,
    which no prediction carries, have no part in them."""
    n = design.n_common
    more = [p.uncertain - Q[:n, :n] for p in predictions]
    mean = np.sum(more, axis=0) / len(more) ** 2
    # what one fold alone shows differs by more than the whole record leaves unknown
    common = Q.copy()
    common[:n, :n] -= mean
    root = covariance_root(common, design.prior_std)
    return root @ root.T, [(p.rows, own + mean) for p, own in zip(predictions, more, strict=True)]


def _join_residuals(predictions: Sequence[Prediction]) -> list[np.ndarray]:
    """Residuals of all blocks per group (n_block, n_response)."""
    order = np.argsort(np.concatenate([p.rows for p in predictions]))
    return [np.concatenate(parts)[order] for parts in zip(*(p.residual for p in predictions), strict=True)]


def batch_error(series: np.ndarray) -> float:
    """Standard error of the sum of a series in the order of time, by batches as long as the square root of its length
    (Flegal & Jones 2010): correlation within a batch is counted."""
    n = len(series)
    number = max(2, n // max(1, int(np.sqrt(n))))
    sums = np.array([part.sum() for part in np.array_split(series, number)])
    return float(np.sqrt(number * np.var(sums, ddof=1)))


def stages(problem: DiagnosisProblem, null: Fit, fitted: Fit) -> list[Fit | None]:
    """Fits with none, the first, the first two ... of the effects found; None where one does not settle."""
    between: list[Fit | None] = []
    for k in range(1, len(fitted.included)):
        try:
            one = fit(problem, fitted.theta, fitted.included[:k])
        except ConvergenceError:
            one = None
        between.append(one if one is not None and one.settled else None)
    return [null, *between, fitted] if fitted.included else [null]


def measures(problem: DiagnosisProblem, old: Fit, new: Fit, *, noise: Noise | None = None) -> dict:
    """Plain numbers of one step from `old` to `new`, as in diagnosis.json: errors of frequencies are shares (of a pair
    the larger eigenvalue of its tensor's error), largest over modes and folds of the mean over a fold, and root
    mean square over single blocks; MAC likewise."""
    n_fold = count_folds(len(problem.blocks), new.included)
    first = replace(old.design, noise=noise or old.design.noise)
    found = contest((first, old.centred), (new.design, new.centred), n_fold=n_fold)
    result = {
        "heldout_elpd": found.elpd,
        "heldout_elpd_se": found.elpd_se,
        "significant": found.significant,
        "heldout_stretches": len(found.before),
        "heldout_blocks": len(found.by_block),
    }
    sides = [_errors(problem, found.before), _errors(problem, found.after)]
    for key in sides[0]:
        if not key.startswith("_"):
            result |= {f"{key}_before": sides[0][key], f"{key}_after": sides[1][key]}
    for key in ("crps_frequency", "crps_shape"):
        saved = sides[0][f"_{key}"] - sides[1][f"_{key}"]
        result[f"{key}_saved_se"] = batch_error(saved) / len(saved)
    result["statement"] = statement(result)
    return result


def gains(outcome: Outcome, *, runs: Executor = SERIAL, progress: Progress = silent) -> tuple[dict, ...]:
    """Of every finding, added after those before it, what it gains (`measures`). On the executor `runs` findings side
    by side."""
    problem = outcome.problem
    fits = stages(problem, outcome.null, outcome.fitted)
    noise = outcome.null.design.noise
    progress("held-out blocks", 0, len(fits))
    # what their designs were asked for before is as large as all else
    lean = [None if f is None else replace(f, design=replace(f.design)) for f in fits]
    found = runs.in_order(_finding_gain, list(pairwise(lean)), shared=(problem, noise))
    progress("held-out blocks", len(fits), len(fits))
    return tuple(found)


def _finding_gain(problem: DiagnosisProblem, noise: Noise, old: Fit | None, new: Fit | None) -> dict:
    """Of one finding, from a fit without it to one with it."""
    if old is None or new is None:
        return {"statement": "gain not measured: the model with the effects up to this one alone did not converge"}
    return measures(problem, old, new, noise=noise)


def statement(gain: dict) -> str:
    """The gain in words."""
    size = f"{gain['heldout_elpd']:.1f} +- {gain['heldout_elpd_se']:.1f}"
    if gain["significant"]:
        return f"held-out blocks are predicted better: log score {size}"
    return f"no significant gain on held-out blocks: log score {size}"


def _errors(problem: DiagnosisProblem, predictions: Sequence[Prediction]) -> dict:
    """Errors of all held-out blocks under one model."""
    n_channel = len(problem.blocks.channels)
    fold_f, block_f, fold_mac, block_mac = [], [], [], []
    scores_f, scores_s = [], []
    for p in predictions:
        own_f, own_s = np.zeros((2, len(p.rows))), np.zeros((2, len(p.rows)))
        for q, (r, std, w) in enumerate(zip(p.residual, p.std, p.weight, strict=True)):
            k = len(problem.blocks.groups[q])
            n_log = 1 if k == 1 else 3
            rows = np.flatnonzero(w > 0)
            if not len(rows):
                continue
            score = crps(r[rows], std[rows])
            own_f[:, rows] += [score[:, :n_log].sum(axis=1), np.full(len(rows), n_log)]
            own_s[:, rows] += [score[:, n_log:].sum(axis=1), np.full(len(rows), score.shape[1] - n_log)]
            mean = np.average(r[rows], axis=0, weights=w[rows])[None]
            fold_f.append(_frequency_errors(mean[:, :n_log]))
            block_f.append(_frequency_errors(r[rows, :n_log]))
            fold_mac.append(_mac(mean[:, n_log:], problem.predictor.axes[q], n_channel))
            block_mac.append(_mac(r[rows, n_log:], problem.predictor.axes[q], n_channel))
        scores_f.append(own_f)
        scores_s.append(own_s)
    by_block = {"_crps_frequency": np.concatenate(scores_f, axis=1), "_crps_shape": np.concatenate(scores_s, axis=1)}
    by_block = {key: v[0] / np.maximum(v[1], 1) for key, v in by_block.items()}
    single = np.concatenate([b.ravel() for b in block_f])
    return {
        "max_frequency_error": float(max(np.max(e) for e in fold_f)),
        "rms_frequency_error": float(np.sqrt(np.mean(single**2))),
        "min_mac": float(min(np.min(m) for m in fold_mac)),
        "mean_mac": float(np.mean(np.concatenate([m.ravel() for m in block_mac]))),
        "crps_frequency": float(np.mean(by_block["_crps_frequency"])),
        "crps_shape": float(np.mean(by_block["_crps_shape"])),
        **by_block,
    }


def _frequency_errors(residual: np.ndarray) -> np.ndarray:
    """|error of ln f| (n,): of a pair the larger eigenvalue of the tensor's error, which neither frequency exceeds."""
    if residual.shape[1] == 1:
        return np.abs(residual[:, 0])
    a, b, c = residual[:, 0], residual[:, 1], residual[:, 2] / np.sqrt(2)
    return np.abs(a + b) / 2 + np.sqrt(((a - b) / 2) ** 2 + c**2)


def _mac(residual: np.ndarray, target: np.ndarray, n_channel: int) -> np.ndarray:
    """MAC (n, k) of shapes `target` (n_channel, k) and those off by `residual` (n, 2 k n_channel); NaN of frequencies
    alone."""
    k = target.shape[1]
    if not n_channel:
        return np.full((len(residual), k), np.nan)
    parts = residual.reshape(len(residual), 2, k, n_channel)
    seen = target.T + parts[:, 0] + 1j * parts[:, 1]
    product = np.abs(np.einsum("ck,nkc->nk", target, seen)) ** 2
    return product / (np.sum(target**2, axis=0) * np.sum(np.abs(seen) ** 2, axis=2))
