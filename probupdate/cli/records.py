"""Commands from records to modes."""

from __future__ import annotations

import argparse
import os

from probupdate.cli.options import AddCommand, add_model_option, add_worker_option, positive
from probupdate.cli.terminal import answer, say
from probupdate.errors import InputError
from probupdate.runtime.progress import Progress


def run_convert(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    if a.describe:
        if a.sources or not a.out or a.to != "campaign":
            raise InputError("--describe", "names the records itself, and writes one file", "give --describe RAW --out "
                             "campaign.toml")
        result = probupdate.convert(a.describe, a.out, to="description")
        answer(a, result, *([result.files] if a.json else []))
        return
    if not a.sources or not a.out:
        raise InputError("convert", "SOURCES or OUT is missing", "give both, or --describe RAW --out campaign.toml")
    result = probupdate.convert(
        a.sources, a.out, to=a.to, description=a.description, sensors=a.sensors, progress=progress)
    answer(a, result, *([result.files] if a.json else []))


def run_check(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    several = len(a.campaign) > 1
    if several and a.out:
        raise InputError("--out", "takes one campaign", "check each setup with --out, and all of them without")
    results = [probupdate.check(campaign, a.model, parameters=a.parameters, progress=progress)
               for campaign in a.campaign]
    if not several:
        if a.out:
            results[0].write(a.out)
        answer(a, results[0], *([[a.out]] if a.out and a.json else []))
        return
    between = probupdate.check_setups(a.campaign, progress=progress)
    if a.json:
        summaries = {str(c): r.summary.splitlines() for c, r in zip(a.campaign, results, strict=True)}
        answer(a, between, campaigns=summaries)
        return
    for result in results:
        say(result.summary)
    say(f"between {len(a.campaign)} setups:")
    answer(a, between)


def run_identify(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate
    from probupdate.identification.settings import IdentificationSettings
    from probupdate.runtime.executors import executor

    if a.choice and (a.shard or len(a.campaign) > 1):
        raise InputError("--choice", "is of the poles of one campaign", "identify that campaign alone, without --shard")
    if a.shard and len(a.campaign) > 1:
        raise InputError("--shard", "shares out the blocks of one campaign", "identify setups without it, with --jobs")
    settings = IdentificationSettings(
        order=a.order, block_rows=a.block_rows, rate_hz=a.rate, harmonics=a.harmonics)
    with executor(a.jobs or os.cpu_count() or 1, a.scheduler) as runs:
        options = {"settings": settings, "store": f"{a.out}.blocks", "jobs": runs, "progress": progress,
                   "parameters": a.parameters, "lowest": a.lowest}
        if a.shard:
            answer(a, probupdate.identify_shard(a.campaign[0], a.shard, a.model, **options))
            return
        if len(a.campaign) == 1:
            result = probupdate.identify(a.campaign[0], a.model, choice=a.choice, **options)
        else:
            result = probupdate.identify_setups(a.campaign, a.model, **options)
        answer(a, result, result.write(a.out))


def run_explore(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate
    from probupdate.identification.settings import IdentificationSettings

    settings = IdentificationSettings(order=a.order, block_rows=a.block_rows, rate_hz=a.rate)
    result = probupdate.explore(a.source, a.out, campaign=a.campaign, model=a.model, parameters=a.parameters,
                                block=a.block, settings=settings, progress=progress)
    answer(a, result, *([[result.path]] if a.json else []))


def run_select(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.select(
        a.modes, scada=a.scada, criteria=a.criteria, preset=a.preset, std_from=a.std_from,
        rated_power_kw=a.rated_power, count=a.count, since=a.since, before=a.before)
    answer(a, result, result.write(a.out))


def run_regress(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    chosen = {"covariates": tuple(a.covariates)} if a.covariates else {}
    result = probupdate.regress(a.modes, state=a.state, **chosen)
    written = [result.write(a.out)]
    if a.figures:
        from probupdate.reporting.figures_regression import write_regression_figures

        written += write_regression_figures(result, a.figures)
    answer(a, result, written)


def run_figures(a: argparse.Namespace, progress: Progress) -> None:
    import probupdate

    result = probupdate.figures(a.modes, a.out, campaign=a.campaign, block=a.block, kind=a.format,
                                progress=progress)
    answer(a, result, *([result.files] if a.json else []))


def add_commands(verb: AddCommand) -> None:
    """Their arguments and options; `verb` makes the parser of a command."""
    _add_records(verb)
    _add_poles(verb)
    _add_modes(verb)


def _add_records(verb: AddCommand) -> None:
    p = verb("convert", run_convert, "records of other programs (CSV, Parquet, .mat, .npy, .npz, UFF, "
             "TDMS, MDF, miniSEED, SAC, WAV) into a campaign; modes and poles of other programs into a "
             "modes.json; both to universal files")
    p.add_argument("sources", metavar="SOURCES", nargs="?", help="folder of the files to convert; with --to modes a "
                   "table of modes or poles (.csv, .npz, .mat, .uff) or a folder of them, with --to uff a "
                   "modes.json or a campaign")
    p.add_argument("out", metavar="OUT", nargs="?", default=argparse.SUPPRESS, help="campaign directory with "
                   "campaign.toml and convert.toml (an interrupted conversion goes on where it stopped); "
                   "with --to modes.json, .uff, or a folder of them")
    p.add_argument("--to", choices=("campaign", "modes", "uff"), default="campaign", help="records of a campaign "
                   "(default); modes: a modes.json; uff: a universal file")
    p.add_argument("--describe", metavar="RAW", help="write --out campaign.toml, and convert.toml beside it, to fill "
                   "in, from what the files of RAW say: channels, units, rate, start")
    p.add_argument("--out", help="with --describe: campaign.toml")
    p.add_argument("--description", help="convert.toml (default: the campaign's); with --to modes a poles.toml")
    p.add_argument("--sensors", metavar="CAMPAIGN", help="its campaign.toml says where the channels of modes are")

    p = verb("check", run_check, "what a campaign holds, what is wrong with it, what can be done with it")
    p.add_argument("campaign", metavar="CAMPAIGN", nargs="+", help="directory with campaign.toml and acceleration/; "
                   "several: setups of one structure, whose references are compared too")
    add_model_option(p, required=False, without="; then signs, axes and order of the channels are checked against it")
    p.add_argument("--out", help="write the findings as JSON too")


def _add_poles(verb: AddCommand) -> None:
    p = verb("identify", run_identify, "modes of every block by SSI-cov, and every pole with why it was kept or not")
    p.add_argument("campaign", metavar="CAMPAIGN", nargs="+", help="a campaign's folder; several: setups of one "
                   "structure with sensors in common, merged into one set")
    add_model_option(p, required=False, without="; without, poles that come back are numbered")
    p.add_argument("--lowest", type=positive(int, "modes"), help="look for the model's lowest so many modes, whatever "
                   "they are (default: first and second bending and torsion of a tower)")
    p.add_argument("--out", required=True, help="modes.json; the poles go beside it, and each block's as it is found "
                   "(OUT.blocks): a run that was stopped goes on there")
    add_worker_option(p, "processes (default: one a core; at most one for 40 blocks, as starting one takes as long as "
                      "those); the modes do not depend on it")
    p.add_argument("--shard", metavar="I/N", help="only the I-th of N shares of the blocks, as one job of an array "
                   "does: all jobs write into one OUT.blocks; given again when all blocks are there, their standard "
                   "deviations; then without --shard, which writes OUT")
    p.add_argument("--order", type=positive(int, "order"),
                   help="model order (default: proposed from the record and printed; "
                   "the paper's 20 with a model of members whose modes lie below 2.5 Hz)")
    p.add_argument("--block-rows", type=positive(int, "block rows"),
                   help="block rows of the Toeplitz matrix (default: as with --order; the paper's are 30)")
    p.add_argument("--rate", type=positive(float, "Hz"), help="sampling rate after decimation in Hz (default: as "
                   "with --order; the paper's is 5)")
    p.add_argument("--choice", metavar="FILE", help="poles picked by hand in a page of `explore`: they are the modes "
                   "then; order, block rows and rate are the choice's")
    p.add_argument("--harmonics", choices=("keep", "remove"), default="keep", help="keep them (default), or remove: "
                   "take the rotor's multiples out of records in which its angle can be followed; each block says what "
                   "was done")

    p = verb("explore", run_explore, "a page with stabilisation diagrams, shapes and MAC, on which modes are picked or "
             "rejected by hand; its choice is for `identify --choice`")
    p.add_argument("source", metavar="CAMPAIGN|RUN", help="a campaign's folder, of which one block is identified, or "
                   "the directory of a run or its modes.json, whose stored poles are shown")
    p.add_argument("--out", required=True, help="page, HTML; it needs no network and no other file")
    p.add_argument("--campaign", help="of a run, where it does not lie there: places of the sensors, records")
    add_model_option(p, required=False, without="; then its lines are drawn with the shapes")
    p.add_argument("--block", help="id of the block that the page opens with (default: the reference set's, or the "
                   "first that can be used)")
    p.add_argument("--order", type=positive(int, "order"), help="of a campaign: model order (default: proposed)")
    p.add_argument("--block-rows", type=positive(int, "block rows"), help="of a campaign: block rows")
    p.add_argument("--rate", type=positive(float, "Hz"), help="of a campaign: sampling rate after decimation in Hz")


def _add_modes(verb: AddCommand) -> None:
    p = verb("select", run_select, "the sets an update may trust (Table 1), and the most consistent one")
    p.add_argument("modes", metavar="MODES", help="modes.json of `identify`")
    p.add_argument("--scada", help="scada.csv (default: the environment kept in MODES)")
    p.add_argument("--preset", choices=("turbine", "structure"), default="turbine", help="criteria: Table 1 "
                   "(default), or without those of rotor and nacelle, only that the modes are identified")
    p.add_argument("--criteria", help="TOML file with thresholds of Table 1, such as "
                   "pitch_range_deg = 2.0 (docs/howto/select.md)")
    p.add_argument("--std-from", choices=("campaign", "identification"), default="campaign",
                   help="where the standard deviations of kept sets come from: scatter over all blocks, as the paper "
                   "(default), or what identification states of each")
    # its former name
    p.add_argument("--deviations", dest="std_from", choices=("campaign", "identification"),
                   default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    p.add_argument("--rated-power", type=positive(float, "kW"), metavar="KW",
                   help="the turbine's, for turbine states from --scada (default: the highest power in it)")
    p.add_argument("--count", type=positive(int, "sets"), default=9, help="how many sets to keep (default 9)")
    p.add_argument("--since", metavar="TIME", help="only sets that begin then or later (UTC, ISO 8601)")
    p.add_argument("--before", metavar="TIME", help="only sets that begin earlier: of one state, say, before a step")
    p.add_argument("--out", required=True, help="modes file of the selected sets, nine.json in a run directory")

    p = verb("regress", run_regress, "how frequencies and damping follow wind, rotor, temperature, water and amplitude")
    p.add_argument("modes", metavar="MODES", help="modes.json of a campaign")
    p.add_argument("--covariates", nargs="+", metavar="NAME", help="keys of the sets' environment (default: wind "
                   "speed, rotor speed, air temperature, water level, rms)")
    p.add_argument("--state", help="blocks of that turbine state only, such as idling")
    p.add_argument("--out", required=True, help="table as CSV")
    p.add_argument("--figures", metavar="FOLDER", help="write pictures of the residuals over time and covariates")

    p = verb("figures", run_figures, "figures as files: of a run's report with its tables, or of an identification")
    p.add_argument("modes", metavar="MODES|RUN", help="modes.json (poles and blocks are taken from beside it), or the "
                   "directory of a run: every figure of its report, its tables as CSV")
    p.add_argument("--campaign", help="its folder, for wind, turbine states and rotor speed")
    p.add_argument("--block", help="id of the block whose stabilisation is drawn (default: the reference set's)")
    p.add_argument("--format", choices=("png", "svg", "pdf"), default="png", help="of the files (png)")
    p.add_argument("--out", required=True, help="folder to write into")
