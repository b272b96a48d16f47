"""The project's own models: a turbine of `model.toml`, a SubDyn file, matrices of any program, a function."""

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "affine", "along_lines", "assembly", "beam", "channels", "coefficient", "description", "description_file",
    "effect_kinds", "eigen", "extend", "extend_matrices", "frame", "functions", "hydrodynamics", "joints", "load",
    "matrices", "matrix_import", "mode_labels", "moved_channels", "own_modes", "parameter_table", "places",
    "plausible_size", "projected_terms", "readings", "reduced", "schema", "soil", "subdyn_frame", "subdyn_model",
    "subdyn_values", "subdyn_writing", "substructure", "tangent", "turbine_frame",
]
