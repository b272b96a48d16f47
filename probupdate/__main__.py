"""The program's start: a signal is answered in one line while everything else is still being loaded, and not at all
once the work is done. `python -m probupdate` and the command `probupdate` begin here."""

import os
import signal
import sys
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130


def main() -> int:
    """The exit code of the command line."""
    ready()
    from probupdate.cli import main as command_line

    code = command_line()
    for number in (signal.SIGTERM, signal.SIGINT):
        # there is nothing left to end, and the exit code is the work's
        signal.signal(number, signal.SIG_IGN)
    return code


def ready() -> None:
    """From here on a signal is answered, in one line."""
    for number in (signal.SIGTERM, signal.SIGINT):
        # a run in the background is started with Ctrl-C ignored
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)


def _end(number: int, frame: FrameType | None) -> NoReturn:
    # nothing has been begun that would have to be put away
    os.write(2, b"probupdate: interrupted before anything was done\n")
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
