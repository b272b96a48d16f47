"""Options that several commands have, and what their values may be."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from probupdate.errors import InputError

MODEL_HELP = ("model.toml, a SubDyn .dat, or model.npz with --parameters; "
              "'design', 'as_built', 'updated' name the reference turbine")
# makes the parser of a command: its name, the function that runs it, what it does
AddCommand = Callable[[str, Callable, str], argparse.ArgumentParser]


def weights_option(a: argparse.Namespace) -> str | tuple[float, ...]:
    """'paper', 'measured', or the frequencies' CoVs, one number a mode."""
    return tuple(a.frequency_cov) if a.frequency_cov else a.weights


# the largest value of an option: beyond it lies a slip of the pen, or a job that no memory or lifetime holds
LARGEST = {
    "days": 3660, "jobs": 4096, "modes": 100_000, "order": 500, "block rows": 5000, "Hz": 100_000, "kW": 1_000_000,
    "sets": 1_000_000, "iterations": 100_000, "draws": 1_000_000, "ensembles": 64, "steps": 10_000_000, "CoV": 10.0,
    "deviations": 100.0, "reduced modes": 1000,
}
LARGEST_SEED = 2**63 - 1


def positive(kind: type, what: str = "") -> Callable[[str], float]:
    def convert(text: str):
        value = kind(text)
        if not value > 0:
            raise argparse.ArgumentTypeError(f"{text} is not above zero")
        if value > LARGEST.get(what, float("inf")):
            raise argparse.ArgumentTypeError(f"{text} {what} are more than {LARGEST[what]:g}, the most there can be")
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
        share = 0.0 if float(text) == 0 else positive(float)(text)
    except (ValueError, argparse.ArgumentTypeError):
        raise argparse.ArgumentTypeError(f"{text} is neither a share of zero or more nor auto") from None
    if share >= 1:
        raise argparse.ArgumentTypeError(f"{text} is 100 % of the frequency or more; write {share / 100:g} "
                                         f"for {share:g} %")
    return share


def add_seed_option(p: argparse.ArgumentParser) -> None:
    """The option of whatever draws numbers."""
    p.add_argument("--seed", type=seed_option, default=1, help="same seed, same numbers (default 1)")


def add_worker_option(p: argparse.ArgumentParser, text: str, default: int | None = None) -> None:
    """Where independent tasks run; `text` says of what, `default` how many processes."""
    where = p.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=positive(int, "jobs"), default=default, help=text)
    where.add_argument("--scheduler", metavar="ADDRESS", help="the workers of that Dask cluster instead, such as "
                       "tcp://10.0.0.1:8786; they must see the same paths (needs `pip install probupdate[dask]`)")


def add_model_option(p: argparse.ArgumentParser, required: bool = True, without: str = "") -> None:
    """A model of any form; `without`: what to say of it where it may be left out."""
    p.add_argument("--model", required=required, help=MODEL_HELP + without)
    p.add_argument("--parameters", help="parameters.toml of a model made of matrices")


def add_modes_options(p: argparse.ArgumentParser, one: bool = True) -> None:
    """Model, modes and what is compared of them; `one`: of one set."""
    add_model_option(p)
    modes_option(p, "modes.json; nine.json from `select`")
    p.add_argument("--fix", type=fixed_parameter, nargs="+", metavar="NAME=VALUE", action="extend",
                   help="hold parameters at these values, such as k_p=1.0, and update the others")
    if one:
        p.add_argument("--set", help="id of one set that the numbers are of (default: all comparable sets "
                       "together); `update` still repeats for every set, whose scatter `report`, `compare` "
                       "and `export` use")
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
    p.add_argument("--alternatives", nargs="+", metavar="MODEL", default=(),
                   help="other models of the same structure, such as one with flexible joints, shear or another soil "
                   "law: the truth may lie anywhere between, which is marginalised too")


class ModesAction(argparse.Action):
    """The modes' file, and labels of modes behind it or in a further --modes."""

    def __call__(self, parser, namespace, values, option_string=None):
        for value in map(str, values if isinstance(values, list) else [values]):
            if getattr(namespace, self.dest) is None and (Path(value).suffix or Path(value).exists()):
                setattr(namespace, self.dest, value)
            else:
                namespace.only = [*(namespace.only or ()), *(label for label in value.split(",") if label)]


def modes_option(p: argparse.ArgumentParser, text: str) -> None:
    """--modes FILE LABELS, or --modes FILE --modes LABELS."""
    p.add_argument("--modes", action=ModesAction, nargs="+", required=True, metavar=("FILE", "LABEL"), help=text + "; "
                   "labels behind it, such as FA1,SS1, take these modes alone")
    p.set_defaults(only=None)


def fixed_parameter(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not (name and equals and math.isfinite(number)):
        raise argparse.ArgumentTypeError(f"{text} is no NAME=VALUE with a number, such as k_p=1.0")
    return name.strip(), number


def fixed_values(pairs: list[tuple[str, float]] | None) -> dict[str, float] | None:
    """Of --fix, by name. Raises InputError for a name with two values."""
    for name, value in pairs or ():
        if any(other != value for again, other in pairs or () if again == name):
            raise InputError(f"--fix {name}", "is given two values", "give one")
    return dict(pairs) if pairs else None


def add_every_mode_option(p: argparse.ArgumentParser) -> None:
    """The option that takes modes beyond those of interest."""
    p.add_argument("--every-mode", action="store_true", help="take modes beyond those of interest too, where "
                   "identification found them alike to the model's")
