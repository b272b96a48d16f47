"""The posterior of the model with the findings, by the sampler of `probupdate sample` in a bounded number of steps, and
where it parts from Laplace's approximation."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from probupdate.errors import ProbupdateError
from probupdate.modal.modes import ModalData
from probupdate.runtime.executors import Executor
from probupdate.runtime.progress import Progress
from probupdate.structure.affine import AffineModel
from probupdate.updating.discrepancy import default_likelihood
from probupdate.updating.ensemble import SamplerSettings
from probupdate.updating.posterior_file import Posterior, write_posterior
from probupdate.updating.runs import sample_posterior

# effective draws asked for (a mean is then known to 7 % of a standard deviation, a standard deviation to 5 %), and the
# steps after which the chain stops and says how far it came. A turbine's takes many minutes to converge: after 200
# steps (40 s) three of the reference turbine had 49 to 80 effective draws of their worst parameter, after 400 (a
# quarter more time) 63 to 82. A model of matrices has most often few parameters and rows
EFFECTIVE_DRAWS, STEPS_OF_TURBINE, STEPS_OF_MATRICES = 200, 200, 1000
# differences that are said: of the mean from the maximum in standard deviations, and of a standard deviation by its
# ratio; beyond so many standard errors of the chain in either case
APART, WIDER, ERRORS = 0.5, 1.25, 3.0
QUANTILES = (5, 50, 95)


def sampler_settings(seed: int, *, turbine: bool) -> SamplerSettings:
    """What a diagnosis asks of the sampler unless stated otherwise."""
    return SamplerSettings(seed=seed, target_ess=EFFECTIVE_DRAWS, ensembles=2,
                           max_steps=STEPS_OF_TURBINE if turbine else STEPS_OF_MATRICES)


def not_sampled(**why: str) -> dict:
    """The content without a chain: `refused` or `reason`."""
    return {"asked": "refused" in why, **why, "parameters": []}


def sample_extended(
    model: AffineModel, data: ModalData, settings: SamplerSettings, out: Path | None, runs: Executor,
    progress: Progress,
) -> dict:
    """The chain's numbers for diagnosis.json, its file written to `out`; where the sampler refuses or fails, why."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            # a chain kept beside the file would be another problem's once the record changes
            posterior = sample_posterior(model, data, Path(folder) / "chain", weights=default_likelihood(model, data),
                                         settings=settings, jobs=runs, progress=progress)
        if out is not None:
            write_posterior(posterior, out)
    except ProbupdateError as error:
        return not_sampled(refused=str(error))
    except (ValueError, ArithmeticError, OSError) as error:
        # the findings stand without it, whatever ails the chain
        return not_sampled(refused=f"{type(error).__name__}: {error}")
    return _chain_table(posterior, settings)


def _chain_table(posterior: Posterior, settings: SamplerSettings) -> dict:
    draws, record = posterior.draws, posterior.record
    quantiles = np.percentile(draws, QUANTILES, axis=0)
    return {
        "asked": True, "effective_draws_asked": settings.target_ess, "steps_at_most": settings.max_steps,
        "seed": int(settings.seed), "converged": bool(posterior.converged), "verdict": posterior.verdict,
        "draws": len(draws), "walkers": int(record["walkers"]), "steps": int(record["steps"]),
        "acceptance": float(record["acceptance"]), "laplace_check": record["statements"][0],
        "parameters": [
            {"name": name, "mean": float(draws[:, k].mean()), "std": float(draws[:, k].std(ddof=1)),
             **{f"q{q:02d}": float(quantiles[i, k]) for i, q in enumerate(QUANTILES)},
             "r_hat": float(posterior.r_hat[k]), "effective_draws": float(posterior.ess[k])}
            for k, name in enumerate(posterior.names)
        ],
    }


def sampling_command(
    model: Path, mean: Path, posterior: Path, seed: int, *, parameters: str | Path | None = None
) -> str:
    """What is typed to sample the same problem until it converges."""
    given = {"model": model, "parameters": parameters, "modes": mean, "out": posterior}
    places = " ".join(f"--{name} {shlex.quote(str(place))}" for name, place in given.items() if place is not None)
    return f"probupdate sample {places} --seed {seed}"


def sampler_statements(chain: Mapping, laplace: list[dict]) -> list[str]:
    """What the chain shows beside Laplace's approximation (`laplace`: its rows with name, map, std), in words."""
    how = (f": {chain['command']}" if chain["command"]
           else "; with a place for the files, `probupdate sample` reads them")
    if "refused" in chain:
        return [f"the sampler gave no posterior with the findings ({chain['refused']}); the findings stand without it"]
    if not chain["asked"]:
        return [f"the posterior with the findings was not sampled, as {chain['reason']}{how}"]
    said = [f"emcee with the findings: {chain['draws']} draws of {chain['walkers']} walkers, acceptance "
            f"{chain['acceptance']:.2f}; asked for {chain['effective_draws_asked']} effective draws in at most "
            f"{chain['steps_at_most']} steps. {chain['verdict']}"]
    if not chain["converged"]:
        said.append(f"the chain has not converged: take its means and intervals as provisional, and go on until it "
                    f"has{how}")
    said.append(chain["laplace_check"])
    rows = {p["name"]: p for p in laplace}
    apart = [words for p in chain["parameters"] if (words := _difference_words(p, rows[p["name"]]))]
    said += apart or ["sampler and Laplace's approximation agree: no mean differs by more than "
                      f"{APART:g} standard deviations, none of these by more than a factor of {WIDER:g}, beyond the "
                      "chain's own error"]
    return said


def _difference_words(p: Mapping, laplace: Mapping) -> str:
    """Where the chain parts from Laplace by more than its own error, by how much; else nothing."""
    effective = p["effective_draws"]
    if not (np.isfinite(effective) and effective > 1 and p["std"] > 0):
        return f"{p['name']}: not sampled, as its walkers did not move"
    shift, ratio = (p["mean"] - laplace["map"]) / p["std"], p["std"] / laplace["std"]
    words = []
    if abs(shift) > max(APART, ERRORS / np.sqrt(effective)):
        side = "above" if shift > 0 else "below"
        words.append(f"its mean {p['mean']:.4g} is {abs(shift):.1f} standard deviations {side} the "
                     f"maximum {laplace['map']:.4g}")
    if abs(np.log(ratio)) > max(np.log(WIDER), ERRORS / np.sqrt(2 * effective)):
        words.append(f"its standard deviation {p['std']:.3g} is {ratio:.2f} times Laplace's {laplace['std']:.3g}")
    return f"{p['name']}: sampled, {' and '.join(words)}" if words else ""
