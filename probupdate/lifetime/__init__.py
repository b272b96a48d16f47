"""From a posterior to the lifetime: draws, superelements, stresses at hot spots, fatigue, reliability."""

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "conditions", "damping", "draws", "export", "fatigue_files", "gauges", "load_estimate", "measured_stress",
    "reliability", "spectral", "stress", "stress_files", "superelement", "wave_loads",
]
