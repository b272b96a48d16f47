"""An independent virtual turbine with effects hidden in it: other elements, mesh, soil law and joints than the model,
parameters from the prior and tolerances of its own; 48 half hours of a month."""

import probupdate
from probupdate.diagnosis.engine.verdict import CHANCE
from probupdate.virtual.modal_blocks import simulate_modes

STEP = {"time_profile": "step", "at_hour": 360.0}


def found_in(turbine, seed, *effects, extend=False):
    """extend: with the gain and both estimators on the extended model, which take as long as the diagnosis."""
    run = simulate_modes(truth={"parameters_from": "prior", "effect": list(effects)}, seed=seed, days=30.0, n_block=48)
    return probupdate.diagnose(turbine, run.data, seed=1, extend=extend)


def names(finding):
    """Every cause and place that the finding may mean."""
    others = {(a.cause, a.location) for a in finding.alternatives if a.cause != CHANCE}
    return {(finding.cause, finding.location), *others}
