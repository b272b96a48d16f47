"""Commands from modes to parameters."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from probupdate.cli.options import (
    AddCommand,
    add_every_mode_option,
    add_modes_options,
    add_seed_option,
    add_worker_option,
    alpha_option,
    fixed_values,
    positive,
    weights_option,
)
from probupdate.cli.terminal import answer
from probupdate.errors import InputError
from probupdate.runtime.progress import Progress


def mode_options(a: argparse.Namespace) -> dict[str, Any]:
    """What every step on modes is given beside its own options."""
    from probupdate.updating.discrepancy import LikelihoodSettings

    return {"parameters": a.parameters, "likelihood": LikelihoodSettings(
        modes=tuple(a.only) if a.only else None, fix=fixed_values(a.fix),
        weights=weights_option(a), frequencies=a.frequencies, shapes=a.shapes, discrepancy=a.discrepancy,
        tolerances=a.tolerances, baseline=tuple(getattr(a, "baseline", ())),
        common=tuple(a.common) if hasattr(a, "baseline") else (),
        alternatives=tuple(a.alternatives))}


def run_update(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate
    from probupdate.runtime.executors import executor
    from probupdate.updating.settings import UpdateSettings

    settings = UpdateSettings(alpha=a.alpha, method=a.method, iterations=a.iterations)
    with executor(a.jobs, a.scheduler) as runs:
        result = probupdate.update(
            a.model, a.modes, set_id=a.set, **mode_options(a), every_mode=a.every_mode, settings=settings, jobs=runs,
            progress=progress)
    result.write(a.out)
    answer(a, result, [a.out], first=False)
    refuse_suspected(a, result.set_id, result.suspected)


def refuse_suspected(a: argparse.Namespace, set_id: str, suspected: str) -> None:
    """What was written stands, for whoever wants to see it; but there is a mistake in what was given."""
    if suspected:
        from probupdate.modal.modes import set_words

        raise InputError(f"{a.modes}, {set_words(set_id)}", f"shapes are not the model's; {suspected}",
                         f"{a.out} holds the result of the data as they stand")


def run_sample(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate
    from probupdate.runtime.executors import executor
    from probupdate.updating.settings import SamplerSettings

    settings = SamplerSettings(seed=a.seed, target_ess=a.ess, max_steps=a.max_steps, ensembles=a.ensembles)
    with executor(a.jobs, a.scheduler) as runs:
        result = probupdate.sample(
            a.model, a.modes, a.out, set_id=a.set, **mode_options(a), every_mode=a.every_mode, settings=settings,
            jobs=runs, progress=progress)
    answer(a, result, [a.out], first=False)
    refuse_suspected(a, str(result.record.get("set_id", "")), str(result.record.get("suspected", "")))


def run_compare(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    # a file beside a directory is a mistake that `compare` names
    if not (Path(a.update).is_file() or Path(a.posterior).is_file()) and (
            Path(a.update).is_dir() or Path(a.posterior).is_dir()):
        between = probupdate.compare_runs(a.update, a.posterior)
        answer(a, between, [between.write(a.out)], first=False)
        return
    result = probupdate.compare(a.update, a.posterior, model=a.model, parameters=a.parameters)
    result.write(a.out)
    answer(a, result, [a.out], first=False)


def run_sets(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.sets(
        a.model, a.modes, **mode_options(a), common=tuple(a.common), correlated=a.correlated, spread=a.spread,
        seed=a.seed,
        progress=progress)
    result.write(a.out)
    answer(a, result, [a.out], first=False)


def run_inform(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.inform(
        a.model, a.modes, set_id=a.set, **mode_options(a), every=a.every, at=a.at, posterior=a.posterior, seed=a.seed,
        progress=progress)
    result.write(a.out)
    answer(a, result, [a.out], first=False)


def baseline_option(p: argparse.ArgumentParser) -> None:
    p.add_argument("--baseline", nargs="+", metavar="RUN", default=(),
                   help="runs of other states of this structure (directory, update.json or posterior.nc): what they "
                   "showed of the model's error is known here")
    p.add_argument("--common", nargs="+", metavar="NAME", default=(),
                   help="parameters that are the same number in the baseline's states, such as a mass; the others are "
                   "each state's own")


def add_commands(verb: AddCommand) -> None:
    """Their arguments and options; `verb` makes the parser of a command."""
    p = verb("update", run_update, "the sensitivity-based Tikhonov update in both readings, for every set")
    add_modes_options(p)
    add_every_mode_option(p)
    baseline_option(p)
    p.add_argument("--alpha", type=alpha_option, default=1.0,
                   help="regularisation coefficient of Eq. 6 (1), or the rule that chooses it: l-curve, discrepancy, "
                   "evidence")
    p.add_argument("--method", choices=("gauss-newton", "levenberg-marquardt"), default="gauss-newton",
                   help="how the anchored reading is solved (gauss-newton)")
    p.add_argument("--iterations", type=positive(int, "iterations"), default=50, help="at most so many steps (50)")
    add_worker_option(p, "processes for the updates of the sets (1); the numbers do not depend on it", 1)
    p.add_argument("--out", required=True, help="update.json")

    p = verb("sample", run_sample, "the posterior of the same problem by emcee; resumes where it was stopped")
    add_modes_options(p)
    add_every_mode_option(p)
    baseline_option(p)
    p.add_argument("--ess", type=positive(int, "draws"), default=1000,
                   help="effective draws of the worst parameter (1000)")
    add_worker_option(p, "processes for the ensembles (1); the numbers do not depend on it", 1)
    p.add_argument("--ensembles", type=positive(int, "ensembles"), default=4,
                   help="independent ensembles, judged together (4)")
    p.add_argument("--max-steps", type=positive(int, "steps"), default=20000,
                   help="give up, and say so, after these (20000)")
    p.add_argument("--out", required=True, help="posterior.nc; the chain is kept beside it")
    add_seed_option(p)

    p = verb("compare", run_compare, "where update and posterior differ, and why; or two runs")
    p.add_argument("update", metavar="UPDATE|RUN", help="update.json of `update`, or the directory of a run")
    p.add_argument("posterior", metavar="POSTERIOR|RUN",
                   help="posterior.nc of `sample`, of the same model, set and weights, or the directory of another run")
    p.add_argument("--model", help="for its derived quantities over the posterior, such as a pile's head stiffness")
    p.add_argument("--parameters", help="parameters.toml of a model made of matrices")
    p.add_argument("--out", required=True, help="compare.json; of two runs .json or .csv")

    p = verb("sets", run_sets, "all sets in four views: scatter, pooled, one posterior, a population with its scatter")
    add_modes_options(p, one=False)
    p.add_argument("--common", nargs="+", metavar="NAME", default=(),
                   help="parameters that are one number in all sets, such as a mass; the others vary between sets")
    p.add_argument("--correlated", action="store_true", help="let parameters vary together between sets")
    p.add_argument("--spread", type=positive(float, "deviations"), default=0.25,
                   help="scale of the hyper-prior of a parameter's "
                   "scatter between sets, in its prior standard deviations (0.25)")
    p.add_argument("--out", required=True, help="sets.json")
    add_seed_option(p)

    p = verb("inform", run_inform, "which parameters the data inform, which compensate one another, which to update")
    add_modes_options(p)
    p.add_argument("--every", action="store_true", help="all rows of a model.toml, those with update = false too")
    p.add_argument("--at", choices=("initial", "map"), default="initial", help="where slopes are taken: the initial "
                   "parameters (default) or the maximum of the posterior; over a wide prior they differ")
    p.add_argument("--posterior", help="posterior.nc: adds what was sampled")
    p.add_argument("--out", required=True, help="information.json")
    add_seed_option(p)
