"""The steps of the command line as functions: each reads files, returns one frozen result that can write itself.

A step's module is loaded when it is first asked for: no command waits for what another one uses.
"""

from importlib import import_module

__all__ = [
    "checking",
    "comparing_runs",
    "estimating",
    "exploring",
    "finishing",
    "identifying",
    "lifetime_steps",
    "models",
    "program_matrices",
    "records",
    "sought",
    "templates",
]
_STEPS = {
    "verbs.checking": ("check",),
    "verbs.comparing_runs": ("compare_runs",),
    "verbs.estimating": ("compare", "inform", "sample", "sets", "unmatched_sentences", "update"),
    "verbs.exploring": ("explore",),
    "verbs.finishing": ("diagnose", "export", "figures", "report"),
    "verbs.identifying": ("identify", "identify_setups", "identify_shard", "regress", "select"),
    "verbs.lifetime_steps": ("stresses",),
    "verbs.models": ("model_modes", "model_path", "open_model"),
    "verbs.program_matrices": ("matrices",),
    "verbs.records": ("check_setups", "convert"),
    "verbs.templates": ("template",),
    "virtual.simulation": ("simulate",),
}
_MODULE = {name: module for module, names in _STEPS.items() for name in names}


def __getattr__(name: str) -> object:
    if name in __all__:
        return import_module(f"probupdate.verbs.{name}")
    if name not in _MODULE:
        raise AttributeError(f"module 'probupdate.verbs' has no attribute '{name}'")
    return getattr(import_module(f"probupdate.{_MODULE[name]}"), name)
