"""What a simulation or a measurement may get wrong, as data: the catalogue's rows, and which of them are normal."""

# what other rooms and users import; the other modules are this room's own
__all__ = ["alternatives", "catalogue", "gravity", "places", "tolerances", "turbine"]
