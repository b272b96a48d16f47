"""The virtual turbine and its measurement campaigns, independent of the model that is updated.

`simulation.simulate` writes a campaign, `truth.read_truth_modes` reads its true modes. In the vibration: the heading
(it turns the masses at the tower top), aerodynamic damping, turbulence, waves, rotor harmonics, yaw and pitch events,
sensor errors and losses. Not in it: stiffness or mass that follows water level, temperature or amplitude; blades;
softening by weight; gravity in tilting sensors; off-diagonal damping, so that modes are real.
"""
