"""Packages that are only compared with, or that one file format needs: a test without its package is skipped with the
reason, unless PROBUPDATE_PEERS=required, as in .ci/run, where a package that went missing must not pass for agreement.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from types import ModuleType
from typing import NoReturn

import numpy as np
import pytest
from opensees_loader import load_opensees


def peer(module: str) -> ModuleType:
    """The module; some switch numpy's warnings off for good when they are imported, which is undone."""
    with np.errstate():
        return _there(module.partition(".")[0], lambda: importlib.import_module(module))


def opensees() -> ModuleType:
    return _there("OpenSees", load_opensees)


def _there(name: str, load: Callable[[], ModuleType]) -> ModuleType:
    try:
        return load()
    except (ImportError, OSError) as error:
        skip(f"{name}, to compare with, cannot be loaded: {error}")


def skip(reason: str) -> NoReturn:
    """Leave the test out, with the reason; a failure where everything is required to be there."""
    if os.environ.get("PROBUPDATE_PEERS") == "required":
        pytest.fail(reason)
    pytest.skip(reason)
