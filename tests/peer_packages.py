"""Packages that are only compared with, or that one file format needs: all are in the lock file, and one that cannot be
loaded is a failure, as it must not pass for agreement.
"""

from __future__ import annotations

import importlib
from types import ModuleType

import numpy as np
from opensees_loader import load_opensees


def peer(module: str) -> ModuleType:
    """The module; some switch numpy's warnings off for good when they are imported, which is undone."""
    with np.errstate():
        return importlib.import_module(module)


def opensees() -> ModuleType:
    return load_opensees()
