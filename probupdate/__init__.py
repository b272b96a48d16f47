"""Finite-element model updating of wind turbines and other structures: update and posterior from one problem.

The steps of the command line are functions here: simulate, convert, check, identify, select, regress, update, sample,
compare, report, demo, template, matrices, modes, explore, export, stresses,
farm; beside them stand the settings that they take. All are loaded
when first used, so that importing the package stays light.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # type checkers and editors see the functions themselves, not what `__getattr__` may return
    from probupdate.demonstration import demo
    from probupdate.farms import farm
    from probupdate.identification.settings import IdentificationSettings
    from probupdate.updating.discrepancy import LikelihoodSettings
    from probupdate.updating.settings import SamplerSettings, UpdateSettings
    from probupdate.verbs.checking import check
    from probupdate.verbs.comparing_runs import compare_runs
    from probupdate.verbs.estimating import compare, inform, sample, sets, update
    from probupdate.verbs.exploring import explore
    from probupdate.verbs.finishing import diagnose, export, figures, report
    from probupdate.verbs.identifying import identify, identify_setups, identify_shard, regress, select
    from probupdate.verbs.lifetime_steps import stresses
    from probupdate.verbs.models import model_modes, open_model
    from probupdate.verbs.models import model_modes as modes
    from probupdate.verbs.program_matrices import matrices
    from probupdate.verbs.records import check_setups, convert
    from probupdate.verbs.templates import template
    from probupdate.virtual.simulation import simulate

__version__ = "0.1.0"

__all__ = [
    "IdentificationSettings", "LikelihoodSettings", "SamplerSettings", "UpdateSettings", "__version__", "check",
    "check_setups", "compare", "compare_runs", "convert", "demo", "diagnose", "explore", "export", "farm", "figures",
    "identify", "identify_setups", "identify_shard", "inform", "matrices", "model_modes", "modes", "open_model",
    "regress", "report", "sample", "select", "sets", "simulate", "stresses", "template", "update",
]
# where those are that do not go by their name in `verbs`: module, name there
_ELSEWHERE = {
    "IdentificationSettings": ("identification.settings", "IdentificationSettings"),
    "LikelihoodSettings": ("updating.discrepancy", "LikelihoodSettings"),
    "SamplerSettings": ("updating.settings", "SamplerSettings"),
    "UpdateSettings": ("updating.settings", "UpdateSettings"),
    "demo": ("demonstration", "demo"), "farm": ("farms", "farm"), "modes": ("verbs", "model_modes"),
}


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'probupdate' has no attribute '{name}'")
    from importlib import import_module

    module, there = _ELSEWHERE.get(name, ("verbs", name))
    return getattr(import_module(f"probupdate.{module}"), there)


def __dir__():
    return sorted(__all__)
