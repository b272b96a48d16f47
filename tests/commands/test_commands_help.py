"""--help: each command has an example that is taken as it is typed, and a word for each of its arguments."""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys

import pytest

from probupdate.cli import EXAMPLES, GROUPS, build_parser
from probupdate.cli.parser import parse_arguments

(VERBS,) = (a.choices for a in build_parser()._actions if a.dest == "verb")


@pytest.mark.parametrize("verb", VERBS)
def test_a_command_says_what_each_argument_is_and_shows_how_it_is_typed(verb):
    words = shlex.split(EXAMPLES[verb])
    assert words[0] == verb and build_parser().parse_args(words).verb == verb
    assert f"probupdate {EXAMPLES[verb]}" in " ".join(VERBS[verb].format_help().split())
    for action in VERBS[verb]._actions:
        assert action.help, action.dest
        if action.default in (None, False, (), argparse.SUPPRESS):
            continue
        said = "default" in action.help or action.default in action.help if isinstance(action.default, str) \
            else f"{action.default:g}" in action.help
        assert said or action.dest == "help", f"{action.dest}: default {action.default} is not said"


def test_commands_stand_in_groups_each_once():
    text = build_parser().format_help()
    assert sorted(v for group in GROUPS.values() for v in group) == sorted(VERBS)
    for title, verbs in GROUPS.items():
        part = text.split(f"{title}:")[1].split("\n\n")[0]
        assert [line.split()[0] for line in part.splitlines() if line[:3].strip()] == list(verbs)
    assert max(map(len, text.splitlines())) <= 90


def test_help_asks_for_nothing_heavy():
    """What takes seconds to load is loaded by the command that needs it."""
    code = ("import sys, probupdate.cli as c; c.build_parser().format_help(); "
            "print([m for m in ('scipy', 'pandas', 'matplotlib', 'arviz', 'h5py', 'emcee') if m in sys.modules])")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_an_unknown_option_is_the_commands_own_error(capsys):
    with pytest.raises(SystemExit, match="2"):
        parse_arguments([*shlex.split(EXAMPLES["update"]), "--alpa", "3"])
    said = capsys.readouterr().err
    assert said == "probupdate update: unknown: --alpa 3; did you mean --alpha?; see probupdate update --help\n"


def test_a_misspelt_required_option_is_suggested(capsys):
    with pytest.raises(SystemExit, match="2"):
        parse_arguments(shlex.split(EXAMPLES["update"].replace("--model", "--modle")))
    assert "required: --model; did you mean --model?; see" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "said"), [
    ("regress modes.json --on wind --out r.csv", "nothing is called --on, it takes MODES and options"),
    ("export --posterior p.nc --out folder",
     "write OUT without --out; nothing is called --posterior, it takes RUN OUT"),
])
def test_an_option_like_none_is_not_taken_for_another(words, said, capsys):
    with pytest.raises(SystemExit, match="2"):
        parse_arguments(words.split())
    assert said in (text := capsys.readouterr().err) and "did you mean" not in text
