"""The command line: each verb reads files, calls the Python function of the same name and writes files."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import signal
import sys
import tempfile
import textwrap
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NoReturn

from probupdate import __version__
from probupdate.errors import InputError, ProbupdateError, plain
from probupdate.files import write_text
from probupdate.outputs import refuse_overwriting
from probupdate.progress import Progress

MODEL_HELP = "model.toml, a SubDyn .dat, or model.npz with --parameters; 'design', 'as_built', 'updated' name the reference turbine"


@contextlib.contextmanager
def terminal_progress() -> Iterator[Progress]:
    """A bar per task on a terminal; elsewhere a line every ten seconds, so that a log shows life too."""
    if not sys.stderr.isatty():
        last: dict[str, float] = {}

        def line(what: str, done: int, total: int) -> None:
            now = time.monotonic()
            started = last.setdefault(what, now)
            if now - started >= 10:
                last[what] = now
                sys.stderr.write(f"  {what}: {done} of {total}\n")
                sys.stderr.flush()

        yield line
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (TextColumn("  {task.description:<34}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, int] = {}

        def bar(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done, total=total)

        yield bar


def say(text: str) -> None:
    """Results go to standard output, progress and errors to standard error."""
    if sys.stdout is None:
        return
    # names out of files may hold what a terminal obeys, or what its encoding has not
    text = plain(text.rstrip("\n"), keep="\n\t") + "\n"
    encoding = sys.stdout.encoding or "utf-8"
    sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
    sys.stdout.flush()


def complain(text: str) -> None:
    """One line on standard error, if that is still there."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        sys.stderr.write(plain(text) + "\n")
        sys.stderr.flush()


class Interrupted(KeyboardInterrupt):
    """Raised for a signal. Python gives up the exit code where a KeyboardInterrupt itself has passed through an `exec`,
    as where dataclasses are made, even if it is caught after that."""


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """SIGTERM ends a run as Ctrl-C does: temporary files are removed, processes ended. Where Ctrl-C is ignored, as in the
    background, it stays so."""

    def end(number: int, frame: object) -> NoReturn:
        raise Interrupted

    before = {}
    try:
        for number in (signal.SIGTERM, signal.SIGINT):
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, end)
    except ValueError:
        # not in the main thread: whoever runs this there answers for signals
        yield
        return
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def one_thread() -> None:
    """Of linear algebra, here and in the processes started: the same bits wherever a task runs, whatever is left after
    an interruption. Read when numpy is first imported."""
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")


def tell(a: argparse.Namespace, result, files: Sequence = (), *, first: bool = True, **more) -> None:
    """What a step found: the lines of its summary and the files it wrote (first, or behind it), or with --json one
    object with its table and `more` keys."""
    if a.json:
        from probupdate.result_table import json_object

        say(json_object(a.verb, result.summary, result.to_frame(), files, **more))
        return
    written = [f"wrote {path}" for path in files]
    say("\n".join([*written, result.summary] if first else [result.summary, *written]))


# One function a verb: arguments in, files out, a few lines said. ---------------------------------------------------


def run_demo(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    tell(a, probupdate.demo(a.out, seed=a.seed, days=a.days, hide=a.hide, jobs=a.jobs, progress=progress,
                            say=(lambda text: None) if a.json else say))


def run_simulate(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    tell(a, probupdate.simulate(
        a.out, model=a.model, days=a.days, truth=a.truth, seed=a.seed, jobs=a.jobs, progress=progress))


def run_modes(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.model_modes(a.model, a.count, parameters=a.parameters)
    if a.out:
        write_text(a.out, result.text() + "\n")
    tell(a, result, **result.content())


def run_export(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.export(
        a.run, a.out, to=a.to, draws=a.draws, superelement_modes=a.superelement_modes, accept=a.accept, seed=a.seed,
        fatigue=a.fatigue, progress=progress)
    tell(a, result, **result.content())


def run_check(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    several = len(a.campaign) > 1
    if several and a.out:
        raise InputError("--out", "holds one campaign's check", "check each setup with --out, and all of them without")
    results = [probupdate.check(campaign, progress=progress) for campaign in a.campaign]
    if not several:
        if a.out:
            results[0].write(a.out)
        tell(a, results[0], *([[a.out]] if a.out and a.json else []))
        return
    between = probupdate.check_setups(a.campaign, progress=progress)
    if a.json:
        summaries = {str(c): r.summary.splitlines() for c, r in zip(a.campaign, results, strict=True)}
        tell(a, between, campaigns=summaries)
        return
    for result in results:
        say(result.summary)
    say(f"between {len(a.campaign)} setups:")
    tell(a, between)


def run_convert(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.convert(
        a.sources, a.out, to=a.to, description=a.description, sensors=a.sensors, progress=progress)
    tell(a, result, *([result.files] if a.json else []))


def run_identify(a: argparse.Namespace, progress: Progress) -> None:
    one_thread()
    import probupdate

    from probupdate.executors import executor

    settings = {"order": a.order, "block_rows": a.block_rows, "rate_hz": a.rate, "harmonics": a.harmonics,
                "store": f"{a.out}.blocks", "progress": progress}  # fmt: skip
    if a.shard and len(a.campaign) > 1:
        raise InputError("--shard", "shares out the blocks of one campaign", "identify setups without it, with --jobs")
    with executor(a.jobs or os.cpu_count() or 1, a.scheduler) as runs:
        if a.shard:
            tell(a, probupdate.identify_shard(a.campaign[0], a.shard, a.model, jobs=runs, **settings))
            return
        options = {**settings, "parameters": a.parameters, "lowest": a.lowest, "jobs": runs}
        if len(a.campaign) == 1:
            result = probupdate.identify(a.campaign[0], a.model, **options)
        else:
            result = probupdate.identify_setups(a.campaign, a.model, **options)
        tell(a, result, result.write(a.out))


def run_select(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.select(
        a.modes, scada=a.scada, criteria=a.criteria, preset=a.preset, deviations=a.deviations,
        rated_power_kw=a.rated_power, count=a.count)
    tell(a, result, result.write(a.out))


def run_regress(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    chosen = {"covariates": tuple(a.covariates)} if a.covariates else {}
    result = probupdate.regress(a.modes, state=a.state, **chosen)
    tell(a, result, [result.write(a.out)])


def run_update(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.update(
        a.model, a.modes, parameters=a.parameters, set_id=a.set, weights=weights_option(a), alpha=a.alpha,
        frequencies=a.frequencies, shapes=a.shapes, method=a.method, discrepancy=a.discrepancy, tolerances=a.tolerances,
        iterations=a.iterations, every_mode=a.every_mode, progress=progress)
    result.write(a.out)
    tell(a, result, [a.out], first=False)
    refuse_suspected(a, result.set_id, result.suspected)


def refuse_suspected(a: argparse.Namespace, set_id: str, suspected: str) -> None:
    """What was written stands, for whoever wants to see it; but there is a mistake in what was given."""
    if suspected:
        raise InputError(f"{a.modes}, set {set_id}", f"shapes are not the model's; {suspected}",
                         f"{a.out} holds the result of the data as they stand")


def run_sample(a: argparse.Namespace, progress: Progress) -> None:
    one_thread()
    import probupdate
    from probupdate.executors import executor

    with executor(a.jobs, a.scheduler) as runs:
        result = probupdate.sample(
            a.model, a.modes, a.out, parameters=a.parameters, set_id=a.set, weights=weights_option(a), seed=a.seed,
            frequencies=a.frequencies, shapes=a.shapes, ensembles=a.ensembles, discrepancy=a.discrepancy,
            tolerances=a.tolerances, target_ess=a.ess, max_steps=a.max_steps, every_mode=a.every_mode, jobs=runs,
            progress=progress)
    tell(a, result, [a.out], first=False)
    refuse_suspected(a, str(result.record.get("set_id", "")), str(result.record.get("suspected", "")))


def run_compare(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.compare(a.update, a.posterior, model=a.model, parameters=a.parameters)
    result.write(a.out)
    tell(a, result, [a.out], first=False)


def run_sets(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.sets(
        a.model, a.modes, parameters=a.parameters, weights=weights_option(a), frequencies=a.frequencies,
        shapes=a.shapes, discrepancy=a.discrepancy, tolerances=a.tolerances, correlated=a.correlated, spread=a.spread,
        seed=a.seed,
        progress=progress)
    result.write(a.out)
    tell(a, result, [a.out], first=False)


def run_inform(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.inform(
        a.model, a.modes, parameters=a.parameters, set_id=a.set, weights=weights_option(a), frequencies=a.frequencies,
        shapes=a.shapes, discrepancy=a.discrepancy, tolerances=a.tolerances, every=a.every, at=a.at,
        posterior=a.posterior, seed=a.seed,
        progress=progress)
    result.write(a.out)
    tell(a, result, [a.out], first=False)


def run_diagnose(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.diagnose(
        a.model, a.modes, campaign=a.campaign, parameters=a.parameters, seed=a.seed, out=a.out, groups=a.groups,
        extend=not a.no_extend, sampler=not a.no_sampler, progress=progress)
    tell(a, result, result.write(a.out), verdict=result.verdict)


def run_farm(a: argparse.Namespace, progress: Progress) -> None:
    one_thread()
    import probupdate
    from probupdate.executors import executor

    with executor(a.jobs, a.scheduler) as runs:
        result = probupdate.farm(a.description, a.out, shard=a.shard, jobs=runs, progress=progress)
    tell(a, result, [], failed=len(result.failed))
    if result.failed:
        raise ProbupdateError(f"{len(result.failed)} of {len(result.rows)} turbine-months failed, each with its reason above "
                              "and in farm.csv; the others are done: mend what is said, then run it again")


def run_report(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.report(a.run, a.out, progress=progress)
    tell(a, result, *([[result.path]] if a.json else []))


def run_figures(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.figures(a.modes, a.out, campaign=a.campaign, block=a.block, kind=a.format)
    tell(a, result, *([result.files] if a.json else []))


def weights_option(a: argparse.Namespace) -> str | tuple[float, ...]:
    """'paper', 'measured', or the frequencies' CoVs, one number a mode."""
    return tuple(a.frequency_cov) if a.frequency_cov else a.weights


# The parser -------------------------------------------------------------------------------------------------------


# the largest value of an option: beyond it lies a slip of the pen, or a job that no memory or lifetime holds
MOST = {
    "days": 3660, "jobs": 4096, "modes": 100_000, "order": 500, "block rows": 5000, "Hz": 100_000, "kW": 1_000_000,
    "sets": 1_000_000, "iterations": 100_000, "draws": 1_000_000, "ensembles": 64, "steps": 10_000_000, "CoV": 10.0,
    "deviations": 100.0, "reduced modes": 1000,
}  # fmt: skip
LARGEST_SEED = 2**63 - 1


def positive(kind: type, what: str = "") -> Callable[[str], float]:
    def convert(text: str):
        value = kind(text)
        if not value > 0:
            raise argparse.ArgumentTypeError(f"{text} is not above zero")
        if value > MOST.get(what, float("inf")):
            raise argparse.ArgumentTypeError(f"{text} {what} are more than {MOST[what]:g}, the most there can be")
        return value

    convert.__name__ = kind.__name__
    return convert


def seed_option(text: str) -> int:
    value = int(text)
    if not 0 <= value <= LARGEST_SEED:
        raise argparse.ArgumentTypeError(f"{text} is not from 0 to {LARGEST_SEED}")
    return value


seed_option.__name__ = "int"


def alpha_option(text: str) -> float | str:
    if text in ("l-curve", "discrepancy", "evidence"):
        return text
    try:
        return positive(float)(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is neither a number nor l-curve, discrepancy, evidence") from None


def discrepancy_option(text: str) -> float | str:
    if text == "auto":
        return text
    try:
        return 0.0 if float(text) == 0 else positive(float)(text)
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(f"{text} is neither a share above zero nor auto") from None


# the commands as --help lists them, in the order in which a job needs them
GROUPS = {
    "to begin with": ("demo", "simulate", "modes"),
    "from records to modes": ("convert", "check", "identify", "select", "regress", "figures"),
    "from modes to parameters": ("update", "sample", "compare", "sets", "inform"),
    "what is wrong": ("diagnose",),
    "many turbines": ("farm",),
    "to hand on": ("report", "export"),
}


def commands_by_group(about: dict[str, str]) -> str:
    """A line or two for each command below its group; about: command -> what it does."""
    others = [verb for verb in about if not any(verb in group for group in GROUPS.values())]
    width = max(map(len, about)) + 4
    lines = []
    for title, verbs in {**GROUPS, **({"further": tuple(others)} if others else {})}.items():
        lines.append(f"{title}:")
        for verb in verbs:
            told = textwrap.wrap(about[verb], 79 - width)
            lines += [f"  {verb:<{width - 2}}{told[0]}", *(" " * width + more for more in told[1:])]
        lines.append("")
    return "\n".join([*lines, "`probupdate VERB --help` lists a command's arguments and options, with an example."])


class _Parser(argparse.ArgumentParser):
    """One line for a wrong option too; the usage stands in --help."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


# keys of --json beyond those that every command has
JSON_MORE = {
    "modes": "; frequency_hz, label, channel, shape, notes", "check": "; campaigns where there are several",
    "diagnose": "; verdict", "export": "; folder, files with SHA-256, draws, verdict, converged, diagnosis, left_out",
}  # fmt: skip
# a command of each verb as it is typed in a run directory of the names that `report` looks for
EXAMPLES = {
    "demo": "demo out",
    "simulate": "simulate run/campaign --days 1 --seed 1",
    "modes": "modes as_built --count 8",
    "convert": "convert records run/campaign",
    "check": "check run/campaign --out run/check.json",
    "identify": "identify run/campaign --model run/model.toml --out run/modes.json",
    "select": "select run/modes.json --scada run/campaign/scada.csv --out run/nine.json",
    "regress": "regress run/modes.json --state idling --out run/regression.csv",
    "update": "update --model run/model.toml --modes run/nine.json --out run/update.json",
    "sample": "sample --model run/model.toml --modes run/nine.json --out run/posterior.nc",
    "compare": "compare run/update.json run/posterior.nc --model run/model.toml --out run/compare.json",
    "sets": "sets --model run/model.toml --modes run/nine.json --out run/sets.json",
    "inform": "inform --model run/model.toml --modes run/nine.json --out run/information.json",
    "diagnose": "diagnose --model run/model.toml --modes run/modes.json --campaign run/campaign --out run/diagnosis.json",
    "figures": "figures run/modes.json --campaign run/campaign --format pdf --out run/figures",
    "export": "export run --to lifetime run-lifetime",
    "farm": "farm data/farm.toml --out farm --jobs 4",
    "report": "report run --out run/report.html",
}


def build_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="probupdate",
        description="Update a jacket's finite-element model from measured vibration, deterministically and as a\n"
        "posterior, and compare the two. Each step reads and writes files: enter at any of them.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"probupdate {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB", help="one of the commands below",
                                  parser_class=_Parser)  # fmt: skip
    about: dict[str, str] = {}

    def verb(name: str, run: Callable, text: str) -> argparse.ArgumentParser:
        about[name] = text
        added = verbs.add_parser(name, description=f"{text[0].upper()}{text[1:]}.",
                                 epilog=f"example: probupdate {EXAMPLES[name]}")
        added.set_defaults(action=run)
        added.add_argument("--json", action="store_true", help="print one JSON object instead: command, summary, files, "
                           "table (columns with units, rows)" + JSON_MORE.get(name, ""))
        return added

    def seeded(p: argparse.ArgumentParser) -> None:
        p.add_argument("--seed", type=seed_option, default=1, help="same seed, same numbers (default 1)")

    def on_workers(p: argparse.ArgumentParser, text: str, default: int | None = None) -> None:
        where = p.add_mutually_exclusive_group()
        where.add_argument("--jobs", type=positive(int, "jobs"), default=default, help=text)
        where.add_argument("--scheduler", metavar="ADDRESS", help="the workers of that Dask cluster instead, such as "
                           "tcp://10.0.0.1:8786; they must see the same paths (needs `pip install probupdate[dask]`)")

    def on_model(p: argparse.ArgumentParser, required: bool = True) -> None:
        without = "" if required else "; without, poles that come back are numbered"
        p.add_argument("--model", required=required, help=MODEL_HELP + without)
        p.add_argument("--parameters", help="parameters.toml of a model made of matrices")

    def on_modes(p: argparse.ArgumentParser, one: bool = True) -> None:
        on_model(p)
        p.add_argument("--modes", required=True, help="modes.json; nine.json from `select`")
        if one:
            p.add_argument("--set", help="id of the set to use (default: the file's reference set, or its first)")
        weights = p.add_mutually_exclusive_group()
        weights.add_argument("--weights", choices=("measured", "covariance", "paper"), default="measured",
                             help="W_Lambda from the file's standard deviations (default), from their full covariance "
                             "where the file has it, or from the paper's CoVs 0.015 / 0.017, tenfold for shapes")
        p.add_argument("--frequencies", choices=("hz", "log"), default="hz", help="as they are (default) or logarithms")
        p.add_argument("--shapes", choices=("plane", "components", "mac", "none"), default="plane",
                       help="shapes by components with close pairs as planes (default), every one by components, as "
                       "one MAC each, or not at all")
        weights.add_argument("--frequency-cov", type=positive(float, "CoV"), nargs="+", metavar="COV",
                             help="CoV of each frequency instead, tenfold for shapes")
        p.add_argument("--discrepancy", type=discrepancy_option, metavar="SHARE",
                       help="what the model may miss of every frequency, such as 0.005, and ten times that of shapes; "
                       "'auto' (default with --weights measured or covariance, else 0) takes as much as the misfit at "
                       "the maximum shows")
        p.add_argument("--tolerances", action=argparse.BooleanOptionalAction, default=None,
                       help="marginalise the tolerances of structure, soil, rotor-nacelle assembly and sensors "
                       "(default with --weights measured or covariance)")

    p = verb("demo", run_demo, "the whole job on a virtual campaign, ending with OUT/report.html")
    p.add_argument("out", metavar="OUT", help="directory to write; an interrupted demo goes on where it stopped")
    p.add_argument("--days", type=positive(float, "days"), default=1.0, help="length of the campaign (default 1)")
    p.add_argument("--hide", default="default", metavar="TRUTH",
                   help="truth.toml of effects to hide in the virtual turbine, none, or default: one of the structure, "
                        "one of a sensor")
    p.add_argument("--jobs", type=positive(int, "jobs"), default=2,
                   help="processes (default 2: the sampler beside the diagnosis)")
    seeded(p)

    p = verb("simulate", run_simulate, "a virtual turbine, measured: a campaign with its truth")
    p.add_argument("out", metavar="OUT", help="campaign directory to write")
    p.add_argument("--model", help="model.toml whose geometry is built anew (default: the updated reference turbine)")
    p.add_argument("--days", type=positive(float, "days"), default=1.0, help="length of the campaign (default 1)")
    p.add_argument("--truth", help="truth.toml: parameters and effects to build in instead of drawing them")
    p.add_argument("--jobs", type=positive(int, "jobs"), default=1, help="processes (1); the bytes do not depend on it")
    seeded(p)

    p = verb("modes", run_modes, "a model's own frequencies, labels and shapes, of every form of model")
    p.add_argument("model", metavar="MODEL", help=MODEL_HELP)
    p.add_argument("--parameters", help="parameters.toml of a model made of matrices")
    p.add_argument("--count", type=positive(int, "sets"), default=10, help="how many modes (10)")
    p.add_argument("--out", help="write frequency_hz, label, channel, shape and notes to a JSON file too")

    p = verb("convert", run_convert, "records of other programs (CSV, Parquet, .mat, .npy, .npz, UFF) into a campaign; "
             "modes and records from and to universal files")
    p.add_argument("sources", metavar="SOURCES", help="folder of the files to convert; with --to modes a .uff, with "
                   "--to uff a modes.json or a campaign")
    p.add_argument("out", metavar="OUT", help="campaign directory with campaign.toml and convert.toml (an interrupted "
                   "conversion goes on where it stopped); with --to modes.json, .uff, or a folder of them")
    p.add_argument("--to", choices=("campaign", "modes", "uff"), default="campaign", help="records of a campaign "
                   "(default); modes: a modes.json from a UFF's dataset 55; uff: a universal file")
    p.add_argument("--description", help="convert.toml (default: the campaign's)")
    p.add_argument("--sensors", metavar="CAMPAIGN", help="its campaign.toml says where the channels of modes are")

    p = verb("check", run_check, "what a campaign holds, what is wrong with it, what can be done with it")
    p.add_argument("campaign", metavar="CAMPAIGN", nargs="+", help="directory with campaign.toml and acceleration/; "
                   "several: setups of one structure, whose references are compared too")
    p.add_argument("--out", help="write the findings as JSON too")

    p = verb("identify", run_identify, "modes of every block by SSI-cov, and every pole with what became of it")
    p.add_argument("campaign", metavar="CAMPAIGN", nargs="+", help="a campaign's folder; several: setups of one "
                   "structure with sensors in common, merged into one set")
    on_model(p, required=False)
    p.add_argument("--lowest", type=positive(int, "modes"), help="look for the model's lowest so many modes, whatever they are "
                   "(default: first and second bending and torsion of a tower)")
    p.add_argument("--out", required=True, help="modes.json; the poles go beside it, and each block's as it is found "
                   "(OUT.blocks): a run that was stopped goes on there")
    on_workers(p, "processes (default: one a core; at most one for 40 blocks, as starting one takes as long as those); "
               "the modes do not depend on it")
    p.add_argument("--shard", metavar="I/N", help="only the I-th of N shares of the blocks, as one job of an array does: "
                   "all jobs write into one OUT.blocks; given again when all blocks are there, their standard deviations; "
                   "then without --shard, which writes OUT")
    p.add_argument("--order", type=positive(int, "order"), help="model order (20 with a model, as the paper)")
    p.add_argument("--block-rows", type=positive(int, "block rows"), help="block rows of the Toeplitz matrix (30 with a model)")
    p.add_argument("--rate", type=positive(float, "Hz"), help="sampling rate after decimation in Hz (5 with a model; without, "
                   "all three are proposed from the record and said)")
    p.add_argument("--harmonics", choices=("keep", "remove"), default="keep", help="keep them (default), or remove: take the rotor's multiples "
                   "out of records in which its angle can be followed; each block says what was done")

    p = verb("select", run_select, "the sets an update may trust (Table 1), and the most consistent one")
    p.add_argument("modes", metavar="MODES", help="modes.json of `identify`")
    p.add_argument("--scada", help="scada.csv (default: the environment kept in MODES)")
    p.add_argument("--preset", choices=("turbine", "structure"), default="turbine", help="what is asked: Table 1 "
                   "(default), or of another structure nothing of rotor and nacelle, only that its modes are identified")
    p.add_argument("--criteria", help="TOML file with thresholds of Table 1, such as "
                   "pitch_range_deg = 2.0 (docs/howto/select.md)")
    p.add_argument("--deviations", choices=("campaign", "identification"), default="campaign",
                   help="what kept sets carry: scatter over all blocks, as the paper (default), or what identification "
                   "states of each")
    p.add_argument("--rated-power", type=positive(float, "kW"), metavar="KW",
                   help="the turbine's, for turbine states from --scada (default: the highest power in it)")
    p.add_argument("--count", type=positive(int, "sets"), default=9, help="how many sets to keep (default 9)")
    p.add_argument("--out", required=True, help="modes file of the selected sets, nine.json in a run directory")

    p = verb("regress", run_regress, "how frequencies and damping follow wind, rotor, temperature, water and amplitude")
    p.add_argument("modes", metavar="MODES", help="modes.json of a campaign")
    p.add_argument("--covariates", nargs="+", metavar="NAME", help="keys of the sets' environment (default: wind "
                   "speed, rotor speed, air temperature, water level, rms)")
    p.add_argument("--state", help="blocks of that turbine state only, such as idling")
    p.add_argument("--out", required=True, help="table as CSV")

    def on_every_mode(p: argparse.ArgumentParser) -> None:
        p.add_argument("--every-mode", action="store_true", help="take modes beyond those of interest too, where "
                       "identification found them alike to the model's")

    p = verb("update", run_update, "the sensitivity-based Tikhonov update in both readings, for every set")
    on_modes(p)
    on_every_mode(p)
    p.add_argument("--alpha", type=alpha_option, default=1.0,
                   help="regularisation coefficient of Eq. 6 (1), or the rule that chooses it: l-curve, discrepancy, "
                   "evidence")
    p.add_argument("--method", choices=("gauss-newton", "levenberg-marquardt"), default="gauss-newton",
                   help="how the anchored reading is solved (gauss-newton)")
    p.add_argument("--iterations", type=positive(int, "iterations"), default=50, help="at most so many steps (50)")
    p.add_argument("--out", required=True, help="update.json")

    p = verb("sample", run_sample, "the posterior of the same problem by emcee; resumes where it was stopped")
    on_modes(p)
    on_every_mode(p)
    p.add_argument("--ess", type=positive(int, "draws"), default=1000, help="effective draws of the worst parameter (1000)")
    on_workers(p, "processes for the ensembles (1); the numbers do not depend on it", 1)
    p.add_argument("--ensembles", type=positive(int, "ensembles"), default=4, help="independent ensembles, judged together (4)")
    p.add_argument("--max-steps", type=positive(int, "steps"), default=20000, help="give up, and say so, after these (20000)")
    p.add_argument("--out", required=True, help="posterior.nc; the chain is kept beside it")
    seeded(p)

    p = verb("compare", run_compare, "where update and posterior part, and why")
    p.add_argument("update", metavar="UPDATE", help="update.json of `update`")
    p.add_argument("posterior", metavar="POSTERIOR", help="posterior.nc of `sample`, of the same model, set and weights")
    p.add_argument("--model", help="for its derived quantities over the posterior, such as a pile's head stiffness")
    p.add_argument("--parameters", help="parameters.toml of a model made of matrices")
    p.add_argument("--out", required=True, help="compare.json")

    p = verb("sets", run_sets, "all sets in four views: scatter, pooled, one posterior, a population with its scatter")
    on_modes(p, one=False)
    p.add_argument("--correlated", action="store_true", help="let parameters vary together between sets")
    p.add_argument("--spread", type=positive(float, "deviations"), default=0.25, 
                   help="scale of the hyper-prior of a parameter's "
                   "scatter between sets, in its prior standard deviations (0.25)")
    p.add_argument("--out", required=True, help="sets.json")
    seeded(p)

    p = verb("inform", run_inform, "which parameters the data inform, which compensate one another, which to update")
    on_modes(p)
    p.add_argument("--every", action="store_true", help="all rows of a model.toml, those with update = false too")
    p.add_argument("--at", choices=("initial", "map"), default="initial", help="where slopes are taken: the initial "
                   "parameters (default) or the maximum of the posterior; over a wide prior they differ")
    p.add_argument("--posterior", help="posterior.nc: adds what was sampled")
    p.add_argument("--out", required=True, help="information.json")
    seeded(p)

    p = verb("diagnose", run_diagnose, "what the simulation or the measurement gets wrong: cause, place, size, limits")
    p.add_argument("--model", help=MODEL_HELP + "; without one: the data alone")
    p.add_argument("--parameters", help="parameters.toml of a model made of matrices")
    p.add_argument("--modes", required=True, help="modes.json of `identify`: a set a block")
    p.add_argument("--campaign", help="campaign directory: where the sensors are; its raw records are tested too")
    p.add_argument("--groups", help="TOML file of named groups of a model's parameters, [name] parameter = change")
    p.add_argument("--no-extend", action="store_true",
                   help="leave out the gain on held-out blocks and the model and data with the findings in them")
    p.add_argument("--no-sampler", action="store_true", help="leave out the posterior with the findings by emcee "
                   "(40 s for a turbine); the command that samples it is said instead")
    p.add_argument("--out", required=True, help="diagnosis.json; files with the findings in them go beside it")
    seeded(p)

    p = verb("figures", run_figures, "an identification's figures as files: poles, stabilisation, maps, conditions")
    p.add_argument("modes", metavar="MODES", help="modes.json; poles and blocks are taken from beside it")
    p.add_argument("--campaign", help="its folder, for wind, turbine states and rotor speed")
    p.add_argument("--block", help="id of the block whose stabilisation is drawn (default: the reference set's)")
    p.add_argument("--format", choices=("png", "svg", "pdf"), default="png", help="of the files (png)")
    p.add_argument("--out", required=True, help="folder to write into")

    p = verb("export", run_export, "what a lifetime-extension analysis takes: draws, joint distribution, models, "
             "superelements, modes; each file read back and checked")
    p.add_argument("run", metavar="RUN", help="directory with model.toml (or model.npz) and posterior.nc")
    p.add_argument("--to", choices=("lifetime",), required=True, help="what the files are for")
    p.add_argument("out", metavar="OUT", help="folder to write, new or empty")
    p.add_argument("--draws", type=positive(int, "draws"), default=100, help="how many equally weighted draws (100)")
    p.add_argument("--superelement-modes", type=positive(int, "reduced modes"), default=10, help="Craig-Bampton modes (10)")
    p.add_argument("--fatigue", metavar="FILE", help="fatigue.toml with sea and wind states, details, S-N curves and "
                   "uncertainties: also damage-equivalent stress ranges, model factors, reliability")
    p.add_argument("--accept", action="store_true", help="export a run that did not converge or whose diagnosis is "
                   "unexplained; every file says so")
    seeded(p)

    p = verb("farm", run_farm, "many turbines and months, each through the steps that farm.toml names; resumable")
    p.add_argument("description", metavar="FARM", help="farm.toml: turbines, their models and folders of campaigns, steps")
    on_workers(p, "turbine-months side by side (1), a process each; the results do not depend on it", 1)
    p.add_argument("--shard", metavar="I/N", help="only the I-th of N shares of the turbine-months, as one job of an array "
                   "does: all jobs write into one OUT")
    p.add_argument("--out", required=True, help="directory to write; a run that was stopped goes on where it stopped")

    p = verb("report", run_report, "one self-contained page of a run directory")
    p.add_argument("run", metavar="RUN", help="directory that the steps wrote into; what is missing there is left out")
    p.add_argument("--out", required=True, help="the page, report.html")
    parser.epilog = commands_by_group(about)
    return parser


# verbs whose result is a directory; the others write files
WRITE_FOLDERS = ("convert", "demo", "simulate", "figures", "export", "farm")


def writes_folder(a: argparse.Namespace) -> bool:
    """Whether --out, or OUT, is a directory: of `convert` where records come out."""
    if a.verb == "convert" and a.to != "campaign":
        return a.to == "uff" and Path(a.sources).is_dir()
    return a.verb in WRITE_FOLDERS


def refuse_unwritable(out: str, *, folder: bool) -> None:
    """Before hours of work, not after them: a result that cannot be written. Directories to it are made later."""
    path = Path(out)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:
        raise InputError(out, f"is no usable name ({getattr(error, 'strerror', None) or error})",
                         "name another place") from None
    if folder and path.exists() and not path.is_dir():
        raise InputError(out, "is a file where a directory is to be written", "name a directory")
    if not folder and path.is_dir():
        raise InputError(out, "is a directory where a file is to be written", "name a file in it")
    above = next(p for p in (path, *path.parents) if p.exists())
    if above != path and not above.is_dir():
        raise InputError(out, f"cannot be written, as {above} is no directory", "name another place")
    try:
        # permissions alone do not tell: a file system may be read-only, or none
        with tempfile.TemporaryFile(dir=above if above.is_dir() else above.parent):
            pass
    except OSError as error:
        raise InputError(out, f"nothing can be written to {above} ({error.strerror})",
                         "name another place, or change its permissions") from None


def given_paths(a: argparse.Namespace) -> list[str]:
    """Every text among the arguments but --out: those that are no paths do no harm."""
    return [v for key, value in vars(a).items() if key not in ("out", "verb", "action")
            for v in (value if isinstance(value, list) else [value]) if isinstance(v, str)]


# errors of a path that a user named; others are the machine's
OF_PATHS = {errno.EISDIR, errno.ENOTDIR, errno.ENOENT, errno.EEXIST, errno.EACCES, errno.EPERM, errno.ENAMETOOLONG,
            errno.ELOOP, errno.EROFS}  # fmt: skip
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def _os_words(error: OSError) -> str:
    where = str(error.filename) if error.filename is not None else "a file or the output"
    reason = error.strerror or str(error) or type(error).__name__
    if error.errno in FULL:
        return f"{where}: {reason}; make room or name another place; what was finished is kept"
    return f"{where}: {reason}; check the path"


def _drop_output() -> None:
    """What is still buffered must not raise once more at exit."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(arguments: Sequence[str] | None = None) -> int:
    program = "probupdate"
    try:
        with ended_by_signals():
            a = build_parser().parse_args(arguments)
            program = f"probupdate {a.verb}"
            # an announcement of another package's next release, once a day and machine; it says nothing of this run
            warnings.filterwarnings("ignore", message=r"\s*ArviZ is undergoing a major refactor", category=FutureWarning)
            if a.out:
                refuse_unwritable(a.out, folder=writes_folder(a))
                refuse_overwriting(a.verb, a.out, given_paths(a))
            with terminal_progress() as progress:
                a.action(a, progress)
    except InputError as error:
        complain(f"{program}: {error}")
        return 2
    except ProbupdateError as error:
        complain(f"{program}: {error}")
        return 1
    except BrokenPipeError:
        # whoever read the output has gone
        _drop_output()
        return 1
    except KeyboardInterrupt:
        complain(f"{program}: interrupted; what was finished is kept")
        return 130
    except OSError as error:
        complain(f"{program}: {_os_words(error)}")
        _drop_output()
        return 2 if error.errno in OF_PATHS else 1
    except MemoryError:
        complain(f"{program}: out of memory; give less at a time, or a machine with more; what was finished "
                 "is kept")
        return 1
    # what is not foreseen is a defect of this program: it rises with its trace, and Python exits with 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
