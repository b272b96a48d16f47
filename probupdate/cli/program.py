"""A run of the command line: arguments in, an exit code out, a user's mistakes in one line."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

from probupdate.cli.parser import build_parser, parse_arguments
from probupdate.cli.process import ended_by_signals, limit_threads
from probupdate.cli.terminal import complain, terminal_progress
from probupdate.errors import InputError, ProbupdateError
from probupdate.io.outputs import refuse_overwriting

# verbs whose result is a directory; the others write files
WRITE_FOLDERS = ("convert", "demo", "simulate", "figures", "export", "stresses", "farm")
# what they wrote stands, and is not made again; so it is with blocks and chains
KEEPING = (*(v for v in WRITE_FOLDERS if v != "stresses"), "identify", "sample")


def writes_folder(a: argparse.Namespace) -> bool:
    """Whether --out, or OUT, is a directory: of `convert` where records come out."""
    if a.verb == "convert" and a.describe:
        return False
    if a.verb == "convert" and a.to != "campaign":
        return a.to == "uff" and bool(a.sources) and Path(a.sources).is_dir()
    if a.verb == "template":
        return Path(a.out).suffix.lower() not in (".toml", ".npz")
    return a.verb in WRITE_FOLDERS


def refuse_unwritable(out: str, *, folder: bool) -> None:
    """Before hours of work, not after them: a result that cannot be written. Directories to it are made later."""
    path = Path(out)
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:
        raise InputError(out, f"is not a usable name ({getattr(error, 'strerror', None) or error})",
                         "name another place") from None
    if folder and path.exists() and not path.is_dir():
        raise InputError(out, "is a file where a directory is to be written", "name a directory")
    if not folder and path.is_dir():
        raise InputError(out, "is a directory where a file is to be written", "name a file in it")
    above = next(p for p in (path, *path.parents) if p.exists())
    if above != path and not above.is_dir():
        raise InputError(out, f"cannot be written, as {above} is not a directory", "name another place")
    try:
        # permissions alone do not show it: a file system may be read-only, or none
        with tempfile.TemporaryFile(dir=above if above.is_dir() else above.parent):
            pass
    except OSError as error:
        raise InputError(out, f"nothing can be written to {above} ({error.strerror})",
                         "name another place, or change its permissions") from None


def argument_paths(a: argparse.Namespace) -> list[str]:
    """Every text among the arguments but --out that is none of an option's choices, as a folder may be named so
    (`convert raw campaign` with --to campaign); others that are not paths do no harm."""
    (verbs,) = (action.choices for action in build_parser()._actions if isinstance(action.choices, dict))
    chosen = {action.dest for action in verbs[a.verb]._actions if action.choices}
    return [v for key, value in vars(a).items() if key not in {"out", "verb", "action", *chosen}
            for v in (value if isinstance(value, list) else [value]) if isinstance(v, str)]


# notes on a model's files that a command repeats
MOST_NOTES = 3
# errors of a path that a user named; others are the machine's
OF_PATHS = {errno.EISDIR, errno.ENOTDIR, errno.ENOENT, errno.EEXIST, errno.EACCES, errno.EPERM, errno.ENAMETOOLONG,
            errno.ELOOP, errno.EROFS}


FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def _os_words(error: OSError, program: str) -> str:
    where = str(error.filename) if error.filename is not None else "a file or the output"
    reason = error.strerror or str(error) or type(error).__name__
    if error.errno in FULL:
        return f"{where}: {reason}; make room or name another place; {_interruption_text(program)}"
    return f"{where}: {reason}; check the path"


def _drop_output() -> None:
    """What is still buffered must not raise once more at exit."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _interruption_text(program: str) -> str:
    """Of a command whose parts stand as they are finished, and of the others."""
    return "what was finished is kept" if program.split(" ")[-1] in KEEPING else "nothing of this run is kept"


@contextlib.contextmanager
def _short_warnings(program: str) -> Iterator[None]:
    """Warnings of this program in one line, as its errors are."""
    before = warnings.showwarning

    def shown(message, category, *where, **more) -> None:
        if category is UserWarning:
            complain(f"{program}: {message}")
        else:
            before(message, category, *where, **more)

    warnings.showwarning = shown
    try:
        yield
    finally:
        warnings.showwarning = before


def _list_unused(a: argparse.Namespace) -> list[str]:
    """Of the model that a command opens, what its files hold without effect; `modes` lists all of it by itself."""
    model, run = getattr(a, "model", None), getattr(a, "run", None)
    if a.verb == "modes" or not (model or run):
        return []
    from probupdate.verbs.models import model_notes

    if not model:
        from probupdate.reporting.run_files import run_places

        model = run_places(Path(run)).get("model")
    notes = model_notes(model) if model else ()
    more = [f"{len(notes) - MOST_NOTES} more such notes: probupdate modes {model}"] if len(notes) > MOST_NOTES else []
    return [*(f"note: {note}" for note in notes[:MOST_NOTES]), *more]


def main(arguments: Sequence[str] | None = None) -> int:
    program = "probupdate"
    try:
        with ended_by_signals():
            limit_threads()
            a = parse_arguments(arguments)
            program = f"probupdate {a.verb}"
            # an announcement of another package's next release, once a day and machine; it says nothing of this run
            warnings.filterwarnings("ignore", message=r"\s*ArviZ is undergoing a major refactor",
                                    category=FutureWarning)
            if a.out:
                refuse_unwritable(a.out, folder=writes_folder(a))
                refuse_overwriting(a.verb, a.out, argument_paths(a))
            with terminal_progress() as progress, _short_warnings(program):
                for note in _list_unused(a):
                    complain(f"{program}: {note}")
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
        complain(f"{program}: interrupted; {_interruption_text(program)}")
        return 130
    except OSError as error:
        complain(f"{program}: {_os_words(error, program)}")
        _drop_output()
        return 2 if error.errno in OF_PATHS else 1
    except MemoryError:
        complain(f"{program}: out of memory; give less at a time, or a machine with more; "
                 f"{_interruption_text(program)}")
        return 1
    # what is not foreseen is a defect of this program: it rises with its trace, and Python exits with 1
    return 0
