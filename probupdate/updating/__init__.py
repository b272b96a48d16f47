"""Updating: one frozen problem, the estimators that solve it, and what their results say beside one another.

`responses` are what is compared, `problem` puts them together; `tikhonov`, `laplace`, `ensemble`, `importance`,
`hierarchical` and the others solve it, `runs` from data to result; `comparison` and `information` read results.
"""

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "alpha", "comparison", "components", "discrepancy", "ensemble", "evidence", "hierarchical", "identifiability",
    "information", "joint_file", "joint_inference", "joint_result", "joint_set", "joint_system", "laplace",
    "outlier_sets", "posterior_file", "predictive", "problem", "responses", "runs", "scales", "set_likelihoods",
    "set_matching", "set_views", "set_views_file", "settings", "shared_error", "tikhonov", "update_file",
]
