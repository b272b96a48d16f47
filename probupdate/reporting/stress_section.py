"""Section on stresses from measured motion, of what `stresses` wrote into the run's folder `stresses`."""

from __future__ import annotations

from pathlib import Path

from probupdate.io.files import read_json_table
from probupdate.lifetime.stress_files import history_name
from probupdate.reporting.elements import (
    Column,
    Element,
    Items,
    Picture,
    Section,
    Table,
    full_sentence,
    number,
    percent,
)
from probupdate.reporting.figures_stress import stress_figures
from probupdate.reporting.run_files import read_table
from probupdate.reporting.style import svg_text
from probupdate.reporting.values import Run

FOLDER = "stresses"
AGAIN = "run `probupdate stresses` again"
SPOTS = ("hot_spot", "member", "side", "damage_per_year", "p05", "p50", "p95", "stated_damage_per_year", "del_m3",
         "del_m5", "resolved", "observable")
BLOCKS = ("hot_spot", "state", "wind_speed_mps", "nacelle_heading_deg", "damage_per_hour")
# rows of the table
SHOWN = 10


def stress_section(run: Run) -> Section | None:
    folder = run.folder / FOLDER
    if not (folder / "stresses.json").exists():
        return None
    head = read_json_table(folder / "stresses.json", AGAIN)
    spots, blocks = read_table(folder / "hot_spots.csv", SPOTS), read_table(folder / "blocks.csv", BLOCKS)
    items: list[Element] = [_table(spots)]
    items += [Picture(svg=svg_text(figure, name), caption=caption) for name, figure, caption in stress_figures(
        spots, blocks, _histories(folder, head), _gauges(folder, head))]
    notes = tuple(full_sentence(str(note)) for note in head.get("notes", ()))
    items.append(Items(title="Limits of these numbers", statements=notes))
    first = spots.iloc[0]
    return Section(
        anchor="stresses", title="Stresses from the measured motion", items=tuple(items), shown=1,
        lead=f"{head.get('blocks')} blocks. Most damage: {first['member']}, {first['side']} side, "
        f"{number(first['p50'])} a year (90 % interval {number(first['p05'])} to {number(first['p95'])}); by the "
        f"stated loads {number(first['stated_damage_per_year'])}.")


def _histories(folder: Path, head) -> dict:
    names = {str(block): folder / history_name(str(block)) for block in head.get("rainflow_over_spectrum", {})}
    return {block: read_table(path, ("time_s",)) for block, path in names.items()}


def _gauges(folder: Path, head):
    path = folder / "gauge_history.csv"
    return (str(head.get("gauge_block")), read_table(path, ("time_s",))) if path.exists() else None


def _table(spots) -> Table:
    rows = tuple((str(s["hot_spot"]), str(s["member"]), str(s["side"]), number(s["p50"]), number(s["p05"]),
                  number(s["p95"]), number(s["stated_damage_per_year"]), number(s["del_m3"]), number(s["del_m5"]),
                  percent(s["resolved"])) for _, s in spots.head(SHOWN).iterrows())
    columns = (Column(name="hot spot"), Column(name="member", number=False), Column(name="side", number=False),
               Column(name="damage", unit="1/a"), Column(name="5 %", unit="1/a"), Column(name="95 %", unit="1/a"),
               Column(name="by stated loads", unit="1/a"), Column(name="equivalent range, m = 3", unit="MPa"),
               Column(name="m = 5", unit="MPa"), Column(name="resolved", unit="%"))
    return Table(caption="Hot spots of most damage", columns=columns, rows=rows,
                 note="Equivalent ranges at one cycle a second; resolved: share of the variance that the readings fix.")
