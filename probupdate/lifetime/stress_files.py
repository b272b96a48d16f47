"""What `stresses` writes: hot spots with their damage, blocks, histories, and what the numbers rest on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.io.files import whole_folder, write_arrays, write_json, write_table
from probupdate.io.result_table import with_units
from probupdate.lifetime.fatigue import SLOPES
from probupdate.lifetime.measured_stress import OBSERVABLE, MeasuredStress

if TYPE_CHECKING:
    import pandas as pd

CONDITION_COLUMNS = ("wind_speed_mps", "wave_height_m", "power_kw", "nacelle_heading_deg")
UNITS = {"damage_per_year": "1/a", "p05": "1/a", "p50": "1/a", "p95": "1/a", "stated_damage_per_year": "1/a",
         "damage_per_hour": "1/h", **{f"del_m{m:g}": "MPa" for m in SLOPES}}

# in damage, 1.6 (m = 5) to 2.2 times (m = 3) in stress; chosen, no standard's: a sentence hangs on it, no number
MOST_APART = 10.0


@dataclass(frozen=True, eq=False, kw_only=True)
class StressResult:
    """Stresses of a campaign's blocks, as tables and files."""

    found: MeasuredStress
    remark: str = ""

    def spots(self) -> pd.DataFrame:
        """A row a hot spot, the most damaged first: where it is, damage of a year with its 5, 50 and 95 % quantiles
        and by the stated loads of the same states, damage-equivalent ranges of all blocks together at one cycle a
        second, the share of the stress' variance that the readings resolve and whether it is enough (`observable`)."""
        import pandas as pd

        f = self.found
        mean, quantile, measured = f.per_year()
        stated = 24 * 365.25 * sum(share * f.stated_per_hour[name] for name, share in measured.items())
        ranges = {f"del_m{m:g}": np.mean([b.equivalent_mpa[k] ** m for b in f.blocks], axis=0) ** (1 / m)
                  for k, m in enumerate(SLOPES)}
        detail = [f.details[s.detail] for s in f.spots]
        table = pd.DataFrame({
            "hot_spot": np.arange(1, len(f.spots) + 1), "joint": [d.joint for d in detail],
            "member": [d.name for d in detail], "side": [s.side for s in f.spots],
            "place": [s.place for s in f.spots], "level_m": [float(d.level_m) for d in detail],
            "curve": [s.curve for s in f.spots], "damage_per_year": mean, "p05": quantile[0], "p50": quantile[1],
            "p95": quantile[2], "stated_damage_per_year": stated, **ranges, "resolved": f.resolved,
            "observable": f.observable})
        return with_units(table.sort_values("damage_per_year", ascending=False, kind="stable"), UNITS)

    def blocks(self) -> pd.DataFrame:
        """A row a block and worst hot spot."""
        import pandas as pd

        rows = []
        for b in self.found.blocks:
            known = {name: b.conditions.get(name) for name in CONDITION_COLUMNS}
            rows += [{"block": b.id, "state": b.state, **known, "channels": b.n_channel, "hot_spot": int(k) + 1,
                      **{f"del_m{m:g}": b.equivalent_mpa[j, k] for j, m in enumerate(SLOPES)},
                      "damage_per_hour": b.damage_per_hour[k], "resolved": b.resolved[k]} for k in self.found.worst]
        return with_units(pd.DataFrame(rows), UNITS)

    def histories(self) -> dict[str, pd.DataFrame]:
        """Of each block whose history was kept: time_s, and hot_spot_N_mpa of the worst hot spots."""
        import pandas as pd

        names = [f"hot_spot_{k + 1}_mpa" for k in self.found.worst]
        return {h.id: pd.DataFrame({"time_s": h.time_s, **dict(zip(names, h.stress_mpa.T, strict=True))})
                for h in self.found.histories}

    def gauge_comparison(self) -> pd.DataFrame | None:
        """A row a block and strain gauge: standard deviation and ranges of the estimate over the gauge's, correlation;
        None without gauges."""
        import pandas as pd

        return None if self.found.gauges is None else with_units(pd.DataFrame(list(self.found.gauges.rows)), {})

    def gauge_history(self) -> pd.DataFrame | None:
        """Of the first block that gauges recorded: time_s, and of each gauge hot_spot_N_mpa as it measured and
        hot_spot_N_estimated_mpa; None without gauges."""
        import pandas as pd

        g = self.found.gauges
        if g is None:
            return None
        columns = {"time_s": g.time_s}
        for k, spot in enumerate(g.spots):
            if np.isfinite(g.measured[:, k]).all():
                columns |= {f"hot_spot_{spot + 1}_mpa": g.measured[:, k],
                            f"hot_spot_{spot + 1}_estimated_mpa": g.estimated[:, k]}
        return pd.DataFrame(columns)

    def to_frame(self) -> pd.DataFrame:
        """`spots`."""
        return self.spots()

    @property
    def summary(self) -> str:
        f, table = self.found, self.spots()
        _, _, measured = f.per_year()
        first = table.iloc[0]
        seen, all_of = int(np.sum(f.observable)), len(f.spots)
        rest = "" if seen == all_of else "; of the others the loads of fatigue.toml make the rest"
        lines = [
            f"{len(f.blocks)} blocks, {all_of} hot spots, {len(f.draw_ratio)} draws of the posterior",
            f"most damage: {first['member']}, {first['side']} side, place {first['place']}: "
            f"{first['damage_per_year']:.3g} a year (90 % interval {first['p05']:.3g} to {first['p95']:.3g}); by the "
            f"loads of fatigue.toml {first['stated_damage_per_year']:.3g}",
            f"observable: {seen} of {all_of} hot spots ({100 * OBSERVABLE:g} % and more of the stress' variance "
            f"resolved by the sensors){rest}"]
        apart = first["damage_per_year"] / max(first["stated_damage_per_year"], 1e-300)
        if not 1 / MOST_APART < apart < MOST_APART:
            lines.append(f"measured damage is {apart:.2g} times that by fatigue.toml: loads are missing there, or are "
                         "not this structure's, and the life that `export` computes from them is not either")
        missing = [s.name for s in f.conditions.state if s.name not in measured]
        if missing:
            share = sum(s.share for s in f.conditions.state if s.name in missing)
            lines.append(f"not measured: {', '.join(missing)}, {100 * share:.3g} % of the year; their damage is not in "
                         "these numbers")
        gauges = self.gauge_comparison()
        if gauges is not None:
            lines += [f"gauge at hot spot {spot}: estimated over measured range "
                      f"{own['del_m5_over_measured'].median():.3f} in the median of {len(own)} blocks (m = 5), "
                      f"correlation {own['correlation'].median():.3f}" for spot, own in gauges.groupby("hot_spot")]
        if self.remark:
            lines.append(self.remark)
        return "\n".join([*lines, *(f"note: {text}" for text in f.left_out)])

    def write(self, out: str | Path) -> list[Path]:
        """hot_spots.csv, blocks.csv, all_blocks.npz, history_BLOCK.csv, gauges.csv and gauge_history.csv,
        stresses.json; the folder new or empty."""
        with whole_folder(out) as folder:
            names = [path.name for path in self._write_into(folder)]
        return [Path(out) / name for name in names]

    def _write_into(self, out: Path) -> list[Path]:
        f = self.found
        _, _, measured = f.per_year()
        written = [write_table(out / "hot_spots.csv", self.spots()), write_table(out / "blocks.csv", self.blocks())]
        written.append(write_arrays(out / "all_blocks.npz", {
            "block": np.array([b.id for b in f.blocks]), "state": np.array([b.state for b in f.blocks]),
            "slope": np.array(SLOPES), "equivalent_mpa": np.array([b.equivalent_mpa for b in f.blocks]),
            "damage_per_hour": np.array([b.damage_per_hour for b in f.blocks]),
            "resolved": np.array([b.resolved for b in f.blocks])}))
        for name, gauges in (("gauges.csv", self.gauge_comparison()), ("gauge_history.csv", self.gauge_history())):
            if gauges is not None:
                written.append(write_table(out / name, gauges))
        written += [write_table(out / history_name(block), table) for block, table in self.histories().items()]
        written.append(write_json(out / "stresses.json", {
            "format": 1, "blocks": len(f.blocks), "draws": len(f.draw_ratio), "seed": f.seed,
            "measured_states": measured, "observable_share": OBSERVABLE, "notes": list(f.left_out),
            "verdict": self.remark, "gauge_block": None if f.gauges is None else f.gauges.block,
            "rainflow_over_spectrum": {h.id: h.rainflow_over_spectrum.tolist() for h in f.histories},
            "worst": [int(k) + 1 for k in f.worst]}))
        return written


def history_name(block: str) -> str:
    """Of the file of a block's histories."""
    return "history_" + "".join(c if c.isalnum() else "-" for c in block) + ".csv"
