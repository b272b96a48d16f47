"""The parser of all commands: their groups in --help, an example of each."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from typing import NoReturn

from probupdate import __version__
from probupdate.cli import beginning, estimates, records, results

# the commands as --help lists them, in the order in which a job needs them
GROUPS = {
    "to begin with": ("demo", "simulate", "template", "matrices", "modes"),
    "from records to modes": ("convert", "check", "identify", "explore", "select", "regress",
                              "figures"),
    "from modes to parameters": ("update", "sample", "compare", "sets", "inform"),
    "what is wrong": ("diagnose",),
    "many turbines": ("farm",),
    "to hand on": ("report", "export", "stresses"),
}


def commands_by_group(about: dict[str, str]) -> str:
    """A line or two for each command below its group; about: command -> what it does."""
    others = [verb for verb in about if not any(verb in group for group in GROUPS.values())]
    width = max(map(len, about)) + 4
    lines = []
    for title, verbs in {**GROUPS, **({"further": tuple(others)} if others else {})}.items():
        lines.append(f"{title}:")
        for verb in verbs:
            described = textwrap.wrap(about[verb], 79 - width)
            lines += [f"  {verb:<{width - 2}}{described[0]}", *(" " * width + more for more in described[1:])]
        lines.append("")
    return "\n".join([*lines, "`probupdate VERB --help` lists a command's arguments and options, with an example."])


class _Parser(argparse.ArgumentParser):
    """One line for a wrong option too; the usage stands in --help."""

    given: Sequence[str] = ()

    def parse_known_args(self, args=None, namespace=None):
        self.given = tuple(args or ())
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        known = [option for action in self._actions for option in action.option_strings]
        # what is missing is what a misspelt option most likely meant
        missing = [k for k in known if k in message.replace(",", " ").split()]
        words = [w.split("=")[0] for w in self.given if w.startswith("--")]
        unknown = [w for w in words if not any(k.startswith(w) for k in known)]
        bare = [w for w in unknown if w[2:] in {a.dest for a in self._actions if not a.option_strings}]
        near = [m for w in unknown for m in _like(w, missing) or _like(w, known)]
        places = [a.metavar or a.dest.upper() for a in self._actions if not a.option_strings]
        other = [w for w in unknown if w not in bare and not _like(w, [*missing, *known])]
        said = [*([f"write {' '.join(w[2:].upper() for w in bare)} without {' '.join(bare)}"] if bare else []),
                *([f"did you mean {' '.join(near)}?"] if near and not bare else []),
                *([f"nothing is called {' '.join(other)}, it takes {' '.join([*places, 'and options'])}"]
                  if other else [])]
        meant = "".join(f"; {text}" for text in said)
        self.exit(2, f"{self.prog}: {message}{meant}; see {self.prog} --help\n")


def _like(word: str, options: Sequence[str]) -> list[str]:
    """The option that a word most likely means, without the dashes, which all have in common."""
    found = get_close_matches(word.lstrip("-"), [option.lstrip("-") for option in options], n=1, cutoff=0.7)
    return [option for option in options if option.lstrip("-") in found]


# keys of --json beyond those that every command has
JSON_MORE = {
    "modes": "; frequency_hz, label, channel, shape, notes", "check": "; campaigns where there are several",
    "diagnose": "; verdict", "export": "; folder, files with SHA-256, draws, verdict, converged, diagnosis, left_out",
}
# a command of each verb as it is typed in a run directory of the names that `report` looks for
EXAMPLES = {
    "demo": "demo out",
    "simulate": "simulate run/campaign --days 1 --seed 1",
    "template": "template monopile run",
    "matrices": "matrices job.sti --parameters groups.toml --out run/model.npz",
    "modes": "modes as_built --count 8",
    "convert": "convert records run/campaign",
    "check": "check run/campaign --out run/check.json",
    "identify": "identify run/campaign --model run/model.toml --out run/modes.json",
    "explore": "explore run/campaign --out run/poles.html",
    "select": "select run/modes.json --scada run/campaign/scada.csv --out run/nine.json",
    "regress": "regress run/modes.json --state idling --out run/regression.csv",
    "update": "update --model run/model.toml --modes run/nine.json --out run/update.json",
    "sample": "sample --model run/model.toml --modes run/nine.json --out run/posterior.nc",
    "compare": "compare run/update.json run/posterior.nc --model run/model.toml --out run/compare.json",
    "sets": "sets --model run/model.toml --modes run/nine.json --out run/sets.json",
    "inform": "inform --model run/model.toml --modes run/nine.json --out run/information.json",
    "diagnose": "diagnose --model run/model.toml --modes run/modes.json --campaign run/campaign "
                "--out run/diagnosis.json",
    "figures": "figures run/modes.json --campaign run/campaign --format pdf --out run/figures",
    "export": "export run --to lifetime run-lifetime",
    "stresses": "stresses run/campaign --run run --fatigue fatigue.toml --out run/stresses",
    "farm": "farm data/farm.toml --out farm --jobs 4",
    "report": "report run --out run/report.html",
}


def build_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="probupdate",
        description="Update a finite-element model from measured vibration, deterministically and as a\n"
        "posterior, and compare the two. Each step reads and writes files: start at any step.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"probupdate {__version__}")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB", help="one of the commands below",
                                  parser_class=_Parser)
    about: dict[str, str] = {}

    def verb(name: str, run: Callable, text: str) -> argparse.ArgumentParser:
        about[name] = text
        added = verbs.add_parser(name, description=f"{text[0].upper()}{text[1:]}.",
                                 epilog=f"example: probupdate {EXAMPLES[name]}")
        added.set_defaults(action=run)
        added.add_argument("--json", action="store_true", help="print one JSON object instead: command, summary, "
                           "files, table (columns with units, rows)" + JSON_MORE.get(name, ""))
        return added

    for group in (beginning, records, estimates, results):
        group.add_commands(verb)
    parser.epilog = commands_by_group(about)
    return parser


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The arguments of a command. One that it does not have is the command's own error, not the program's, with what
    may have been meant."""
    parser = build_parser()
    found, unknown = parser.parse_known_args(arguments)
    if unknown:
        (verbs,) = (action.choices for action in parser._actions if action.dest == "verb")
        verb = dict(verbs or {})[found.verb]
        verb.error(f"unknown: {' '.join(unknown)}")
    if getattr(found, "only", None) and found.modes is None:
        parser.error(f"--modes {','.join(found.only)}: names no file; give modes.json first, then labels of modes")
    return found
