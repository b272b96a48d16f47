"""Annotations hold: `py.typed` hands them to users' type checkers, and pyright finds no mistake in the rooms of its
list."""

import json
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]


def test_the_package_says_that_it_is_typed():
    assert (ROOT / "probupdate" / "py.typed").read_bytes() == b""
    assert "py.typed" in SETTINGS["setuptools"]["package-data"]["probupdate"]


def test_the_list_of_what_is_checked_names_what_is_there():
    assert not [path for path in SETTINGS["pyright"]["include"] if not (ROOT / path).exists()]


@pytest.mark.skipif(shutil.which("pyright") is None, reason="pyright is not installed")
def test_pyright_finds_no_mistake():
    run = subprocess.run(["pyright", "--outputjson", "--pythonpath", sys.executable, "-p", str(ROOT)],
                         capture_output=True, text=True, check=False)
    found = json.loads(run.stdout)
    assert found["summary"]["filesAnalyzed"] > 140
    wrong = [f"{Path(d['file']).relative_to(ROOT)}:{d['range']['start']['line'] + 1} {d['message']}"
             for d in found["generalDiagnostics"] if d["severity"] == "error"]
    assert wrong == []
