"""One default for an option and for the keyword behind it, or the field of a settings value: the settings' own."""

import argparse
import dataclasses
import inspect

import pytest

import probupdate
from probupdate.cli import build_parser

(VERBS,) = (a.choices for a in build_parser()._actions if a.dest == "verb")
# option -> keyword or field, where the names differ
KEYWORDS = {"set": "set_id", "ess": "target_ess", "rate": "rate_hz", "rated_power": "rated_power_kw"}
# the command line takes one process a core
OWN = {("identify", "jobs")}


@pytest.mark.parametrize("verb", ("update", "sample", "sets", "inform", "identify", "select", "diagnose"))
def test_an_option_has_its_keywords_default(verb):
    defaults = {name: p.default for name, p in inspect.signature(getattr(probupdate, verb)).parameters.items()
                if p.default is not inspect.Parameter.empty}
    for value in [v for v in defaults.values() if dataclasses.is_dataclass(v)]:
        defaults |= {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    compared = 0
    for action in VERBS[verb]._actions:
        keyword = KEYWORDS.get(action.dest, action.dest)
        if keyword not in defaults or (verb, action.dest) in OWN:
            continue
        # a former name of an option leaves the default to the option itself
        if action.default is argparse.SUPPRESS:
            assert action.help is argparse.SUPPRESS
            continue
        compared += 1
        assert action.default == defaults[keyword], action.dest
    assert compared >= 3
