"""Tubes of every group of members, with parameters, tolerances, water, growth and hidden effects applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from probupdate.errors import InputError
from probupdate.virtual import beam
from probupdate.virtual.effects import ALL, HiddenEffects
from probupdate.virtual.truth import Truth
from probupdate.virtual.turbine_file import TurbineFile


@dataclass(frozen=True, kw_only=True)
class Materials:
    """`hidden` are the effects of the moment; members name the leg, bay or face they belong to."""

    file: TurbineFile
    p: Mapping[str, float]
    truth: Truth
    hidden: HiddenEffects

    @cached_property
    def site(self) -> dict[str, float]:
        f = self.file
        return {
            "water_level": f.number("site", "water_level_m"), "water": f.number("site", "water_density_kgpm3"),
            "mudline": f.number("site", "mudline_m"), "low": f.number("corrosion", "bottom_m"),
            "high": f.number("corrosion", "top_m"), "growth_top": f.number("hydrodynamics", "growth_top_m"),
            "growth": f.number("hydrodynamics", "growth_density_kgpm3"),
            "added": f.number("hydrodynamics", "added_mass_coefficient"),
            "modulus": f.number("steel", "youngs_modulus_pa"), "nu": f.number("steel", "poisson_ratio"),
            "density": f.number("steel", "density_kgpm3"),
        }

    @cached_property
    def level_rise_m(self) -> float:
        """How far the water stands above the drawing's level."""
        return self.hidden.total("wetted_length")

    @cached_property
    def warmer(self) -> float:
        """Factor on Young's modulus of steel in the air."""
        return 1.0 + self.hidden.total("steel_temperature")

    def mudline(self, leg: str = "") -> float:
        """Level of the ground, at a leg where that is scoured by itself."""
        return self.site["mudline"] - self.p["sc"] - (self.hidden.total("scour", leg=leg) if leg else 0.0)

    def tube(
        self, group: str, diameter_m: float, thickness_m: float, z_m: float, *, half_m: float = 0.0,
        leg: str = "", stiffness: float = 1.0, flooded: float = 0.0, carried: float = 0.0,
    ) -> beam.Tube:
        """A tube around the level z_m, over half_m up and down; `flooded` the share of its inside that is water."""
        site, p, t = self.site, self.p, self.truth.tolerances
        wall = {"leg": t.leg_wall, "brace": t.brace_wall, "pile": t.pile_wall, "tower": t.tower_wall}.get(group, 1.0)
        factor = {"leg": "k_j", "brace": "k_j", "pile": "k_p", "tower": "k_t"}.get(group, "k_TP")
        if group in ("leg", "brace"):
            diameter_m *= p["D_l" if group == "leg" else "D_b"]
            thickness_m *= p["t_l" if group == "leg" else "t_b"]
        thickness_m *= wall
        if group in ("leg", "brace"):
            if site["low"] < z_m < site["high"]:
                diameter_m, thickness_m = diameter_m - 2 * p["corr"], thickness_m - p["corr"]
            lost = self._leg_thickness("corrosion", z_m, leg)
            if lost:
                diameter_m, thickness_m = diameter_m - 2 * lost, thickness_m - lost
        if not 0 < thickness_m < diameter_m / 2:
            raise InputError(str(self.file.path), f"a {group} at z = {z_m:.1f} m has a wall of {thickness_m:.4f} m",
                             "correct its section, or the parameters and effects that act on it")
        # per metre under water: what moves with the tube, growth, water inside
        grown = p["mg"] if z_m < site["growth_top"] else 0.0
        grown += self._leg_thickness("marine_growth", z_m, leg)
        outer = diameter_m + 2 * grown
        water_kgpm = p["a_m"] * site["added"] * site["water"] * np.pi / 4 * outer**2
        growth = site["growth"] * np.pi / 4 * (outer**2 - diameter_m**2)
        inside = flooded * site["water"] * np.pi / 4 * (diameter_m - 2 * thickness_m) ** 2
        added = 0.0
        in_water = self.mudline(leg) < z_m
        if in_water and z_m < site["water_level"]:
            added = water_kgpm
            carried += growth
        if flooded and z_m < site["water_level"]:
            carried += inside
        if self.level_rise_m:
            # only the change, so that no rise leaves every number as it was
            share = self._wet(z_m, half_m, self.level_rise_m) - self._wet(z_m, half_m, 0.0)
            added += share * water_kgpm * in_water
            carried += share * inside
        if self.warmer != 1.0 and z_m > site["water_level"]:
            stiffness *= self.warmer
        return beam.Tube(
            diameter_m=diameter_m, thickness_m=thickness_m,
            youngs_modulus_pa=site["modulus"] * p[factor] * stiffness, poisson_ratio=site["nu"],
            density_kgpm3=site["density"], carried_kgpm=carried, added_kgpm=added,
        )

    def _wet(self, z_m: float, half_m: float, rise_m: float) -> float:
        """Share of a length that is below the water."""
        level = self.site["water_level"] + rise_m
        if half_m <= 0:
            return float(z_m < level)
        return float(np.clip((level - z_m + half_m) / (2 * half_m), 0.0, 1.0))

    def _leg_thickness(self, kind: str, z_m: float, leg: str) -> float:
        """Thickness at a level: an effect of one leg leaves braces alone, one of all legs takes them along."""
        if not self.hidden.effects:
            return 0.0
        return sum(size for e, size in self.hidden.acting_in_band(kind, z_m) if e["leg"] == ALL or e["leg"] == leg)

    def section(self, group: str, entry: Mapping, **kwargs):
        """section(position, half height) -> Tube."""
        def tube(x, half_m=0.0):
            return self.tube(group, entry["diameter_m"], entry["thickness_m"], x[2], half_m=half_m, **kwargs)

        return tube
