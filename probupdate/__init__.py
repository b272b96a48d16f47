"""Finite-element model updating of offshore wind jackets: deterministic update and posterior from one problem.

The steps of the command line are functions here: simulate, convert, check, identify, select, regress, update, sample,
compare, report, demo, modes, export, farm. They are loaded when first used, so that importing the package stays light.
"""

__version__ = "0.1.0"

_STEPS = ("check", "check_setups", "compare", "convert", "diagnose", "export", "figures", "identify", "identify_setups",
          "identify_shard", "inform", "model_modes", "open_model", "regress", "report", "sample", "select", "sets", "simulate", "update")

__all__ = ["__version__", "demo", "farm", "modes", *_STEPS]


def __getattr__(name: str):
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
