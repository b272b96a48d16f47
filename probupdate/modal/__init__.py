"""Modes, measured or computed: `modes.json`, MAC and planes, labels, and which computed mode is which measured one."""

# what other rooms and users import; the other modules are this room's own
__all__ = ["channel_mistakes", "conditions", "frequency_pairs", "joined_modes", "labels", "long_axis", "matching",
           "mode_choice", "mode_energy", "modes", "rounding", "sensor_places"]
