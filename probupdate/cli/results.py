"""Commands on what is wrong, on many turbines, and to hand results on."""

from __future__ import annotations

import argparse
from pathlib import Path

from probupdate.cli.options import MODEL_HELP, AddCommand, add_seed_option, add_worker_option, modes_option, positive
from probupdate.cli.terminal import answer
from probupdate.errors import ProbupdateError
from probupdate.runtime.progress import Progress


def run_diagnose(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate
    from probupdate.runtime.executors import executor

    with executor(a.jobs, a.scheduler) as runs:
        result = probupdate.diagnose(
            a.model, a.modes, campaign=a.campaign, parameters=a.parameters, seed=a.seed, out=a.out, groups=a.groups,
            only=a.only, shapes=a.shapes, frequency_std=a.frequency_std, shape_std=a.shape_std, extend=not a.no_extend,
            without=a.without, discrepancy=a.discrepancy, jobs=runs, progress=progress)
    answer(a, result, result.write(a.out), verdict=result.verdict)


def run_export(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.export(
        a.run, a.out, model=a.model, parameters=a.parameters, to=a.to, draws=a.draws,
        superelement_modes=a.superelement_modes, accept=a.accept, seed=a.seed, fatigue=a.fatigue, progress=progress)
    answer(a, result, **result.content())


def run_stresses(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate
    from probupdate.io.files import refuse_filled
    from probupdate.lifetime.gauges import GaugeFiles

    refuse_filled(Path(a.out))
    result = probupdate.stresses(
        a.campaign, a.run, a.fatigue, model=a.model, without=a.without,
        gauges=GaugeFiles(held_out=a.gauges, joined=a.with_gauges),
        draws=a.draws, worst=a.worst, accept=a.accept, seed=a.seed, progress=progress)
    answer(a, result, result.write(a.out))


def run_farm(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate
    from probupdate.runtime.executors import executor

    with executor(a.jobs, a.scheduler) as runs:
        result = probupdate.farm(a.description, a.out, shard=a.shard, jobs=runs, progress=progress)
    answer(a, result, [], failed=len(result.failed))
    if result.failed:
        raise ProbupdateError(f"{len(result.failed)} of {len(result.rows)} turbine-months failed, each with its reason "
                              "above and in farm.csv; the others are done: correct what is said, then run it again")
    if result.joint is not None and result.joint.run and result.joint.failed:
        raise ProbupdateError(f"the turbines are done, their joint inference failed: {result.joint.failed}")


def run_report(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.report(a.run, a.out, campaign=a.campaign, model=a.model, parameters=a.parameters, jobs=a.jobs,
                               progress=progress)
    answer(a, result, *([[result.path]] if a.json else []))


def add_commands(verb: AddCommand) -> None:
    """Their arguments and options; `verb` makes the parser of a command."""
    p = verb("diagnose", run_diagnose,
             "what the simulation or the measurement gets wrong: cause, place, size, and what would go undetected")
    p.add_argument("--model", help=MODEL_HELP + "; without one: the data alone")
    p.add_argument("--parameters", help="parameters.toml of a model made of matrices")
    modes_option(p, "modes.json of `identify`: a set a block")
    p.add_argument("--campaign", help="campaign directory: where the sensors are; its raw records are tested too")
    p.add_argument("--without", nargs="+", metavar="CHANNEL",
                   help="channels that are not looked at, as they are known to be wrong")
    p.add_argument("--shapes", choices=("all", "none"), default="all", help="none: frequencies alone (all)")
    for kind, of in (("frequency", "each frequency"), ("shape", "a shape's largest component")):
        p.add_argument(f"--{kind}-std", type=positive(float, "share"), metavar="SHARE",
                       help=f"standard deviation where modes.json states none, as a share of {of}; with eight sets or "
                       "more their scatter is used")
    p.add_argument("--groups", help="TOML file of named groups of a model's parameters, [name] parameter = change")
    p.add_argument("--discrepancy", type=positive(float, "share"), metavar="SHARE",
                   help="what the model may miss of every frequency, shapes in proportion (0.003); larger where "
                   "members are known less well than their parameters say")
    p.add_argument("--no-extend", action="store_true",
                   help="leave out the gain on held-out blocks, the model and data with the findings in them, and of "
                   "an unknown cause the elementary parts that it may be like and what a larger --discrepancy "
                   "explains; modes that the model lacks are looked into all the same, as the verdict hangs on them")
    # of scripts that left the chain out, which diagnose does not sample any more
    p.add_argument("--no-sampler", action="store_true", help=argparse.SUPPRESS)
    add_worker_option(p, "processes for records and hypotheses (1); the numbers do not depend on it", 1)
    p.add_argument("--out", required=True, help="diagnosis.json; files with the findings in them go beside it")
    add_seed_option(p)

    p = verb("export", run_export, "what a lifetime-extension analysis takes: draws, joint distribution, models, "
             "superelements, modes; each file read back and checked")
    p.add_argument("run", metavar="RUN", help="directory with model.toml (or model.npz) and posterior.nc")
    p.add_argument("--to", choices=("lifetime",), default="lifetime", help="what the files are for (lifetime)")
    p.add_argument("out", metavar="OUT", help="folder to write, new or empty")
    _add_model_elsewhere(p)
    p.add_argument("--draws", type=positive(int, "draws"), default=100, help="how many equally weighted draws (100)")
    p.add_argument("--superelement-modes", type=positive(int, "reduced modes"), default=10,
                   help="Craig-Bampton modes (10)")
    p.add_argument("--fatigue", metavar="FILE", help="fatigue.toml with sea and wind states, details, S-N curves and "
                   "uncertainties: also damage-equivalent stress ranges, model factors, reliability")
    p.add_argument("--accept", action="store_true", help="export a run that did not converge or whose diagnosis is "
                   "unexplained; every file says so")
    add_seed_option(p)

    _add_stresses(verb)
    p = verb("farm", run_farm, "many turbines and months, each through the steps that farm.toml names; resumable")
    p.add_argument("description", metavar="FARM",
                   help="farm.toml: turbines, their models and folders of campaigns, steps")
    add_worker_option(p, "turbine-months side by side (1), a process each; the results do not depend on it", 1)
    p.add_argument("--shard", metavar="I/N", help="only the I-th of N shares of the turbine-months, as one job of an "
                   "array does: all jobs write into one OUT")
    p.add_argument("--out", required=True, help="directory to write; a run that was stopped goes on where it stopped")

    p = verb("report", run_report, "one self-contained page of a run directory")
    p.add_argument("run", metavar="RUN", help="directory that the steps wrote into; what is missing there is left out")
    p.add_argument("--campaign", help="directory of the records and SCADA (default: campaign/ in RUN)")
    _add_model_elsewhere(p)
    p.add_argument("--out", required=True, help="the page, report.html")
    p.add_argument("--jobs", type=positive(int, "jobs"), default=1, help="processes (1); the page is the same")


def _add_model_elsewhere(p: argparse.ArgumentParser) -> None:
    p.add_argument("--model", help=MODEL_HELP + " (default: model.toml or model.npz in RUN)")
    p.add_argument("--parameters", help="parameters.toml of a model made of matrices")


def _add_stresses(verb: AddCommand) -> None:
    p = verb("stresses", run_stresses, "stress histories, damage-equivalent ranges and damage at hot spots from a "
             "measured campaign, through a run's model and posterior")
    p.add_argument("campaign", metavar="CAMPAIGN", help="directory with campaign.toml and the records")
    p.add_argument("--run", required=True, help="directory with model.toml, posterior.nc and modes.json")
    p.add_argument("--model", help="model.toml, or the TOML of a SubDyn model (default: model.toml in RUN)")
    p.add_argument("--fatigue", required=True, metavar="FILE", help="fatigue.toml with details, S-N curves and the "
                   "loads from which the estimate begins")
    p.add_argument("--without", nargs="+", metavar="CHANNEL", help="channels that are not to be used")
    p.add_argument("--gauges", metavar="CSV", help="stresses by strain gauges (time, hot_spot_N_mpa), held against the "
                   "estimate, in which they take no part")
    p.add_argument("--with-gauges", metavar="CSV", help="gauges, in the same form, that join the accelerations in the "
                   "estimate")
    p.add_argument("--draws", type=positive(int, "draws"), default=8,
                   help="draws that carry the posterior's uncertainty (8)")
    p.add_argument("--worst", type=positive(int, "hot spots"), default=6,
                   help="hot spots whose history is written and counted by rainflow (6)")
    p.add_argument("--accept", action="store_true", help="use a run that did not converge, whose diagnosis is "
                   "unexplained, or channels that it found wrong; stresses.json says so")
    p.add_argument("--out", required=True, help="folder to write, new or empty")
    add_seed_option(p)
