"""What every model is, whatever it is made of: parameters with a prior, theta -> modes, and what is not known of it."""

# what other rooms and users import; the other modules are this room's own
__all__ = ["box_probability", "interface", "parameters", "uncertainty"]
