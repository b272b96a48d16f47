"""What goes wrong, said in one line: what, the likely cause, the next step."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import PurePath
from traceback import walk_tb
from typing import Any, TypeVar, cast
from unicodedata import category

F = TypeVar("F", bound=Callable[..., Any])


# of one part of a message; a path may have some hundred characters
LONGEST = 1200


class ProbupdateError(Exception):
    """Anything this package raises on purpose. The command line turns it into exit code 1."""


class InputError(ProbupdateError):
    """A user's mistake in a file, key, channel, value or option; exit code 2.

    The message is one line and has three parts: where (file, key, channel), what is wrong with the likely
    cause, and the next step.
    """

    def __init__(self, where: str, problem: str, remedy: str):
        self.where, self.problem, self.remedy = where, problem, remedy
        super().__init__(": ".join((_to_one_line(where), f"{_to_one_line(problem)}; {_to_one_line(remedy)}")))

    def __reduce__(self):
        # so that it comes whole out of another process
        return type(self), (self.where, self.problem, self.remedy)


def _to_one_line(text: str) -> str:
    """What other packages say of a file may run over several lines; values from files may be long or hold escapes that
    a terminal obeys."""
    text = str(text)
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} [{len(text) - LONGEST} characters] {text[-LONGEST // 2:]}"
    return plain(" ".join(text.split()))


def plain(text: str, keep: str = "") -> str:
    """Text without control characters: shown as escapes, so that a terminal does not obey them. The narrow space
    between thousands is a space."""
    return "".join(c if c.isprintable() or c in keep else " " if category(c) == "Zs" else
                   c.encode("unicode_escape").decode() for c in text)


class ConvergenceError(ProbupdateError):
    """An iteration ended before it converged; `estimate` carries what it had reached, `modes` the columns of the
    measured modes whose counterpart among the model's changed on the way."""

    def __init__(self, message: str, estimate: object = None, modes: tuple[int, ...] = ()):
        self.estimate, self.modes = estimate, modes
        super().__init__(message)


@contextmanager
def of_file(path: object) -> Iterator[None]:
    """Mistakes of the values that a file holds know their own names; within, they are reported with the file's."""
    try:
        yield
    except InputError as error:
        if str(path) in error.where:
            raise
        raise InputError(f"{path}, {error.where}", error.problem, error.remedy) from None


# what a mistake of the data says it is about, rather than of a model or of an option
ABOUT_DATA = ("set", "sets", "setup", "setups", "channel", "modal", "mode", "modes", "selection", "regression",
              "covariate", "block", "record", "references", "tracking", "sub-records", "scada")
# arguments of steps that are paths, and options that have other words than their argument's name
FILES = ("campaign", "campaigns", "choice", "criteria", "description", "groups", "model", "modes", "out", "parameters",
         "posterior", "run", "scada", "source", "truth", "update")
OPTIONS = ("classifier", "diagnose", "figures", "frequency", "frequencies", "shapes", "target", "weights")


def names_files(data: str, model: str = "model") -> Callable[[F], F]:
    """Of a step that reads files: a mistake that is found in values when files are closed names the file that they came
    from, by what it says it is about. `data`, `model`: the arguments that hold the paths."""

    def decorate(function: F) -> F:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def step(*args, **kwargs):
            try:
                return function(*args, **kwargs)
            except InputError as error:
                given = {name: str(value) for name, value in signature.bind(*args, **kwargs).arguments.items()
                         if name in FILES and isinstance(value, str | PurePath)}
                about = re.split(r"[\s,:.]", error.where, maxsplit=1)[0]
                of = given.get(data if about in ABOUT_DATA else model)
                known = any(text and text in error.where for text in given.values())
                # an option is named by itself, and so is a file that the values were found to come from
                option = about in OPTIONS or (about in signature.parameters and about not in FILES)
                if of is None or known or option or "/" in error.where:
                    raise
                raise InputError(f"{of}, {error.where}", error.problem, error.remedy) from None

        return cast(F, step)

    return decorate


def _raised_by_caller(error: Exception) -> bool:
    """Whether it was raised in the package that reads, and not in the library that it calls."""
    # the first frame is that of `parsing`, the second its caller's
    packages = [str(frame.f_globals.get("__name__", "")).split(".")[0] for frame, _ in walk_tb(error.__traceback__)]
    return packages[-1] == packages[min(1, len(packages) - 1)]


@contextmanager
def parsing(where: str, problem: str, remedy: str) -> Iterator[None]:
    """Around another library's reading of a file: whatever it raises on a damaged one becomes an InputError.

    Parsers do not say what they raise, and it is of many kinds: for .mat alone zlib.error, IndexError and TypeError. So
    every kind is meant here, but for those that only a defect of a program raises, where the program is this one: SciPy
    ends on some .mat with UnboundLocalError. What stands inside is the library's call and the taking apart of what it
    gives, not a computation.
    """
    try:
        yield
    except (InputError, ImportError):
        raise
    except Exception as error:
        if isinstance(error, NameError | AssertionError) and _raised_by_caller(error):
            raise
        reason = str(error).strip() or "no reason given"
        kind = "missing" if isinstance(error, KeyError) else type(error).__name__
        raise InputError(where, f"{problem} ({kind}: {reason.splitlines()[0]})", remedy) from error
