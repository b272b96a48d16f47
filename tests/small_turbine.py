"""A small jacket turbine of its own for the tests of the finite-element model, with all 17 parameters updated."""

SENSORS = [
    ("TP-A-x", "leg A", [2.5, 2.5, 8.0], [1.0, 0.0, 0.0]),
    ("TP-A-y", "leg A", [2.5, 2.5, 8.0], [0.0, 1.0, 0.0]),
    ("TP-C-x", "leg C", [-2.5, -2.5, 8.0], [1.0, 0.0, 0.0]),
    ("TP-C-z", "leg C", [-2.5, -2.5, 8.0], [0.0, 0.0, 1.0]),
    ("LJ-B-y", "leg B", [-3.7, 3.7, -8.0], [0.0, 1.0, 0.0]),
    ("T30-x", "tower", [0.0, 0.0, 30.0], [1.0, 0.0, 0.0]),
    ("T30-y", "tower", [0.0, 0.0, 30.0], [0.0, 1.0, 0.0]),
    ("T50-x", "tower", [0.0, 0.0, 50.0], [1.0, 0.0, 0.0]),
    ("T50-y", "tower", [0.0, 0.0, 50.0], [0.0, 1.0, 0.0]),
]
FACTORS = ("k_j", "k_t", "k_TP", "k_p", "LJF", "D_l", "t_l", "D_b", "t_b", "a_m", "py", "tz", "qw")
# away from every kink: the seabed and the growth lie inside elements
POINT = {name: 1.0 for name in FACTORS} | {"sc": 0.7, "corr": 0.002, "mg": 0.06, "m_h": 60000.0}
RANGE = {name: (0.2, 3.0) for name in FACTORS} | {
    "D_l": (0.8, 1.2), "t_l": (0.7, 1.3), "D_b": (0.8, 1.2), "t_b": (0.7, 1.3), "sc": (0.0, 6.0), "corr": (0.0, 0.006),
    "mg": (0.0, 0.3), "m_h": (40000.0, 80000.0),
}
ORDER = ("k_j", "k_t", "k_TP", "k_p", "LJF", "D_l", "t_l", "D_b", "t_b", "sc", "corr", "mg", "a_m", "m_h", "py", "tz",
         "qw")


def small_turbine() -> dict:
    """model.toml as read: four legs, one bay, a light tower; about 350 degrees of freedom."""
    return {
        "format": 1,
        "name": "Small jacket turbine",
        "site": {"mudline_m": -20.0, "water_level_m": 0.0, "water_density_kgpm3": 1025.0, "gravity_mps2": 9.81},
        "steel": {"youngs_modulus_pa": 2.1e11, "poisson_ratio": 0.3, "density_kgpm3": 7850.0},
        "mesh": {
            "theory": "bernoulli-euler", "geometric_stiffness": False,
            "elements_per_member": {"leg": 1, "brace": 1, "pile": 6, "column": 1, "strut": 1, "tie": 1, "tower": 2},
        },
        "jacket": {
            "leg_names": ["A", "B", "C", "D"], "first_leg_angle_deg": 45.0,
            "bottom": {"z_m": -19.0, "leg_spacing_m": 10.0}, "top": {"z_m": 8.0, "leg_spacing_m": 5.0},
            "leg": {"diameter_m": 0.9, "thickness_m": 0.03}, "flooded": True,
            "bay": [{"bottom_m": -18.0, "top_m": 6.0, "brace": {"diameter_m": 0.5, "thickness_m": 0.016}}],
            "joints": {"law": "fessler"},
        },
        "hydrodynamics": {"added_mass_coefficient": 1.0, "growth_density_kgpm3": 1300.0, "growth_top_m": -2.0},
        "corrosion": {"bottom_m": -3.0, "top_m": 4.0},
        "pile": {"tip_m": -45.0, "diameter_m": 1.6, "thickness_m": 0.04, "flooded": True},
        "soil": {
            "submerged_unit_weight_npm3": 9000.0, "strain_50": 0.01, "matlock_j": 0.5,
            "undrained_shear_strength_pa": {"at_mudline": 60000.0, "gradient_per_m": 1500.0},
        },
        "transition_piece": {
            "column_bottom_m": 8.0, "column": {"diameter_m": 5.0, "thickness_m": 0.05}, "strut_top_m": 11.0,
            "strut": {"diameter_m": 1.5, "thickness_m": 0.04}, "tie": {"diameter_m": 1.0, "thickness_m": 0.03},
            "lumped_mass_kg": 20000.0,
        },
        "tower": {
            "secondary_steel_kgpm": 100.0,
            "station": [
                {"z_m": 12.0, "diameter_m": 5.0, "thickness_m": 0.03, "flange_kg": 6000.0},
                {"z_m": 50.0, "diameter_m": 3.5, "thickness_m": 0.02, "flange_kg": 3000.0},
            ],
        },
        "rna": [
            {"name": "nacelle", "mass_kg": 90000.0, "offset_m": [1.5, 0.0, 1.5], "inertia_kgm2": [2e5, 8e5, 8e5]},
            {"name": "hub", "mass_kg": 60000.0, "offset_m": [-4.0, 0.0, 2.0], "inertia_kgm2": [5e4, 6e6, 6e6]},
        ],
        "sensor": [
            {"channel": channel, "level": "any", "part": part, "position_m": position, "direction": direction}
            for channel, part, position, direction in SENSORS
        ],
        "parameter": [
            {"name": name, "unit": "-", "initial": POINT[name], "std": 0.1 * max(POINT[name], 0.01),
             "lower": RANGE[name][0], "upper": RANGE[name][1], "prior": "normal", "update": True}
            for name in ORDER
        ],
    }
