"""The steps of the command line as functions: each reads files, returns one frozen result that can write itself."""

from probupdate.verbs.checking import check
from probupdate.verbs.comparing_runs import compare_runs
from probupdate.verbs.estimating import compare, inform, sample, sets, unmatched, update
from probupdate.verbs.exploring import explore
from probupdate.verbs.finishing import diagnose, export, figures, report
from probupdate.verbs.identifying import identify, identify_setups, identify_shard, regress, select
from probupdate.verbs.lifetime_steps import stresses
from probupdate.verbs.models import model_modes, model_path, open_model
from probupdate.verbs.program_matrices import matrices
from probupdate.verbs.records import check_setups, convert
from probupdate.verbs.sought import modes_of_interest
from probupdate.verbs.templates import template
from probupdate.virtual.simulation import simulate

__all__ = [
    "check",
    "check_setups",
    "checking",
    "compare",
    "compare_runs",
    "comparing_runs",
    "convert",
    "diagnose",
    "estimating",
    "explore",
    "exploring",
    "export",
    "figures",
    "finishing",
    "identify",
    "identify_setups",
    "identify_shard",
    "identifying",
    "inform",
    "lifetime_steps",
    "matrices",
    "model_modes",
    "model_path",
    "models",
    "modes_of_interest",
    "open_model",
    "program_matrices",
    "records",
    "regress",
    "report",
    "sample",
    "select",
    "sets",
    "simulate",
    "sought",
    "stresses",
    "template",
    "templates",
    "unmatched",
    "update",
]
