"""What the model or the measurement gets wrong: the search for effects in the modes of many blocks, and its results."""

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "blocks", "diagnose", "engine", "evidence", "faulty_channels", "fitting", "free_form", "hypotheses", "linear",
    "prediction", "prepare", "residuals", "results", "run", "search", "wording",
]
