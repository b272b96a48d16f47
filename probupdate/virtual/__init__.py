"""The virtual turbine and its measurement campaigns, independent of the model that is updated.

`simulation.simulate` writes a campaign, `truth.read_truth_modes` reads its true modes; `modal_blocks.simulate_modes`
gives the modal sets of many half hours without the vibration. In both: the heading (it turns the masses at the tower
top), aerodynamic damping, drawn tolerances, and whatever `[[effect]]` of truth.toml hides (`effects.EFFECTS`), over
time. In the vibration also: turbulence, waves, rotor harmonics, yaw and pitch events, losses. Unless an effect says
so, nothing follows water level, temperature or amplitude, and weight softens nothing. Sensors feel gravity as
they tilt, unless model.toml states that it is taken out of their readings. Never in it: off-diagonal damping, so that
modes are real but for what loggers make of them.
"""

# what other rooms and users import; the other modules are this room's own
__all__ = ["effects", "modal_blocks", "simulation", "truth", "turbine_file"]
