"""Finite-element model updating of offshore wind jackets: deterministic update and posterior from one problem.

The steps of the command line are functions here: simulate, convert, check, identify, select, regress, update, sample,
compare, report, demo, modes, export, farm. They are loaded when first used, so that importing the package stays light.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # type checkers and editors see the functions themselves, not what `__getattr__` may return
    from probupdate.demonstration import demo
    from probupdate.farms import farm
    from probupdate.verbs import (
        check,
        check_setups,
        compare,
        convert,
        diagnose,
        export,
        figures,
        identify,
        identify_setups,
        identify_shard,
        inform,
        model_modes,
        open_model,
        regress,
        report,
        sample,
        select,
        sets,
        simulate,
        update,
    )
    from probupdate.verbs import model_modes as modes

__version__ = "0.1.0"

__all__ = [
    "__version__", "check", "check_setups", "compare", "convert", "demo", "diagnose", "export", "farm", "figures",
    "identify", "identify_setups", "identify_shard", "inform", "model_modes", "modes", "open_model", "regress",
    "report", "sample", "select", "sets", "simulate", "update",
]
# those that go by their name in `verbs`
_STEPS = tuple(name for name in __all__ if name not in ("__version__", "demo", "farm", "modes"))


def __getattr__(name: str) -> object:
    if name == "demo":
        from probupdate.demonstration import demo

        return demo
    if name == "farm":
        from probupdate.farms import farm

        return farm
    if name == "modes":
        from probupdate.verbs import model_modes

        return model_modes
    if name in _STEPS:
        from probupdate import verbs

        return getattr(verbs, name)
    raise AttributeError(f"module 'probupdate' has no attribute '{name}'")


def __dir__():
    return sorted(__all__)
