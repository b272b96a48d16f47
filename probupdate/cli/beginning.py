"""Commands to begin with: the demonstration, a virtual campaign, a model to fill in, the modes of a model."""

from __future__ import annotations

import argparse

from probupdate.cli.options import MODEL_HELP, AddCommand, add_seed_option, positive
from probupdate.cli.terminal import answer, say
from probupdate.io.files import write_text
from probupdate.runtime.progress import Progress


def run_demo(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    done = probupdate.demo(a.out, seed=a.seed, days=a.days, hide=a.hide, jobs=a.jobs, progress=progress,
                           say=(lambda text: None) if a.json else say)
    # a reader is given the report, a script all files
    answer(a, done, done.files if a.json else ())


def run_simulate(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    answer(a, probupdate.simulate(
        a.out, model=a.model, days=a.days, truth=a.truth, seed=a.seed, jobs=a.jobs, progress=progress))


def run_template(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    done = probupdate.template(a.kind, a.out)
    answer(a, done, done.files)


def run_matrices(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.matrices(a.source, a.out, parameters=a.parameters)
    answer(a, result, result.files)


def run_modes(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.model_modes(a.model, a.count, parameters=a.parameters)
    if a.out:
        write_text(a.out, result.text() + "\n")
    answer(a, result, **result.content())


def add_commands(verb: AddCommand) -> None:
    """Their arguments and options; `verb` makes the parser of a command."""
    p = verb("demo", run_demo, "the whole job on a virtual campaign, ending with OUT/report.html")
    p.add_argument("out", metavar="OUT", help="directory to write; an interrupted demo goes on where it stopped")
    p.add_argument("--days", type=positive(float, "days"), default=1.0, help="length of the campaign (default 1)")
    p.add_argument("--hide", default="default", metavar="TRUTH",
                   help="truth.toml of effects to hide in the virtual turbine, none, or default: one of the structure, "
                        "one of a sensor")
    p.add_argument("--jobs", type=positive(int, "jobs"), default=2,
                   help="processes (default 2: steps that do not need one another side by side; about two minutes on "
                        "two idle cores; the results do not depend on it)")
    add_seed_option(p)

    p = verb("simulate", run_simulate, "a virtual turbine, measured: a campaign with its truth")
    p.add_argument("out", metavar="OUT", help="campaign directory to write")
    p.add_argument("--model", help="model.toml whose geometry is built again (default: the updated reference turbine)")
    p.add_argument("--days", type=positive(float, "days"), default=1.0, help="length of the campaign (default 1)")
    p.add_argument("--truth", help="truth.toml: parameters and effects to build in instead of drawing them")
    p.add_argument("--jobs", type=positive(int, "jobs"), default=1, help="processes (1); the files do not depend on it")
    add_seed_option(p)

    p = verb("template", run_template, "a model to fill in, that runs as it is: a turbine on a monopile or a jacket, a "
             "tower on land, matrices")
    p.add_argument("kind", metavar="KIND", help="monopile, jacket, tower (on land) or matrices")
    p.add_argument("out", metavar="OUT", help="folder for model.toml (model.npz and parameters.toml of matrices) and "
                   "campaign/campaign.toml, or a file's name for the model alone; nothing is written over")

    p = verb("matrices", run_matrices, "stiffness and mass of a finite-element program as a model: CalculiX, Abaqus, "
             "ANSYS, Nastran, MatrixMarket, Harwell-Boeing, MATLAB")
    p.add_argument("source", metavar="SOURCE", nargs="+", help="file that holds or names both matrices (.sti, .full, "
                   ".mat, .npz, .op4, .pch), or two files, stiffness first (.mtx, .rb, .op4)")
    p.add_argument("--parameters", metavar="FILE", help="groups.toml: channels by node and direction, parameters with "
                   "runs of one group scaled")
    p.add_argument("--out", required=True, help="model.npz; parameters.toml goes beside it")

    p = verb("modes", run_modes, "a model's own frequencies, labels and shapes, of every form of model")
    p.add_argument("model", metavar="MODEL", help=MODEL_HELP)
    p.add_argument("--parameters", help="parameters.toml of a model made of matrices")
    p.add_argument("--count", type=positive(int, "modes"), help="how many modes (10, or as many as there are)")
    p.add_argument("--out", help="write frequency_hz, label, channel, shape and notes to a JSON file too")
