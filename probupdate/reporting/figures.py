"""The figures, usable alone: every function takes plain arrays and returns a matplotlib Figure."""

from probupdate.reporting.figures_diagnosis import (
    against_covariates,
    calendar,
    causes,
    detectable_sizes,
    mode_residuals,
    prior_shifts,
    residual_layout,
    residual_map,
    sizes_found,
)
from probupdate.reporting.figures_identification import against_conditions, argand, mac_map, mpc_map, stabilisation
from probupdate.reporting.figures_measurement import (
    frequencies_by_block,
    mode_shapes,
    poles,
    selection_steps,
    sensor_layout,
    shapes_by_channel,
    wind_and_state,
)
from probupdate.reporting.figures_posterior import (
    contraction,
    corner,
    correlation_map,
    marginals,
    predictive_frequencies,
    traces_and_ranks,
)
from probupdate.reporting.figures_updating import (
    Mark,
    estimate_paths,
    frequency_errors,
    parameter_shifts,
    unit_label,
    update_history,
    variance_shares,
)
from probupdate.reporting.style import svg_text

__all__ = [
    "Mark", "against_conditions", "against_covariates", "argand", "calendar", "causes", "contraction", "corner",
    "correlation_map", "parameter_shifts", "detectable_sizes", "estimate_paths", "frequencies_by_block",
           "frequency_errors",
    "mac_map", "marginals", "mode_residuals", "mode_shapes", "mpc_map", "poles", "predictive_frequencies",
    "prior_shifts", "residual_layout", "residual_map", "selection_steps", "sensor_layout", "shapes_by_channel",
    "sizes_found", "stabilisation", "svg_text", "traces_and_ranks", "unit_label", "update_history",
    "variance_shares", "wind_and_state",
]
