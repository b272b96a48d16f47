"""OpenSees for tests and studies that compare with it; its wheel needs shared libraries that are not always there."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
from pathlib import Path
from types import ModuleType

# libraries in the order in which they need one another; a wheel that bundles none relies on the system's
BUNDLED = ("libquadmath.so.0", "libgfortran.so.4", "libgfortran.so.5", "libblas.so.3", "liblapack.so.3")


def load_opensees() -> ModuleType:
    """`openseespy.opensees`. Raises ImportError or OSError with the reason where it cannot be had."""
    platform = importlib.util.find_spec("openseespylinux")
    if platform is not None:
        libraries = Path(platform.origin).parent / "lib"
        for name in BUNDLED:
            if (libraries / name).is_file():
                ctypes.CDLL(str(libraries / name), mode=ctypes.RTLD_GLOBAL)
    try:
        return importlib.import_module("openseespy.opensees")
    except RuntimeError as error:
        # openseespy hides why its compiled part could not be imported
        raise ImportError(str(error.__context__ or error)) from error
