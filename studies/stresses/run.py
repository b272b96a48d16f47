"""Stresses from measured motion against a simulation by another program.

Records of 18 accelerometers and the true stresses come of OpenSees' matrices (truth.py); the model is the SubDyn
file of the same jacket, its parameters drawn about their prior's centre. True ranges are counted by the package
`rainflow`. Beside ours stands the habit of scaling by one mode: double-integrated acceleration at the top times the
first modes' stress.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import rainflow
import truth

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oc4"))
import case

from probupdate.campaign.blocks import block_files, read_block
from probupdate.campaign.reading import read_campaign
from probupdate.io.subdyn_file import read_subdyn
from probupdate.lifetime.conditions import read_conditions
from probupdate.lifetime.damping import StateDamping
from probupdate.lifetime.details import weights
from probupdate.lifetime.fatigue import fatigue_model_of
from probupdate.lifetime.gauges import GaugeFiles
from probupdate.lifetime.measured_stress import StressSettings, measured_stresses
from probupdate.lifetime.stress_files import StressResult
from probupdate.virtual.campaign_files import write_acceleration, write_campaign_toml

RATE, MINUTES, NOISE = 10.0, 30, 2e-5
# wind, turbulence, thrust for 1 m/s, significant height, period: others than those of fatigue.toml
SEAS = ((5.0, 0.15, 4e4, 0.7, 5.0), (8.5, 0.14, 9e4, 1.2, 6.0), (11.0, 0.12, 7e4, 1.8, 6.8),
        (16.0, 0.12, 5e4, 2.9, 8.0), (21.0, 0.11, 3.5e4, 4.0, 9.2), (3.0, 0.2, 0.4e4, 0.6, 5.0))
SLOPES = (3.0, 5.0)


def counted(record: np.ndarray) -> list[np.ndarray]:
    """Ranges and counts (n, 2) of each ten minutes of a history."""
    piece = round(600 * RATE)
    return [np.array([(r, n) for r, n in rainflow.count_cycles(record[a : a + piece])])
            for a in range(0, len(record) - piece + 1, piece)]


def equivalent(cycles: list[np.ndarray]) -> np.ndarray:
    """(2,) constant ranges at one cycle a second that do the damage."""
    total = [np.mean([np.sum(c[:, 1] * c[:, 0] ** m) / 600 for c in cycles]) for m in SLOPES]
    return np.array([t ** (1 / m) for t, m in zip(total, SLOPES, strict=True)])


def drawn_campaign(folder: Path, world: truth.World, sensors, blocks: int, rng) -> list[np.ndarray]:
    """A campaign directory; the true nominal stresses of each block."""
    (folder / "acceleration").mkdir(parents=True)
    write_campaign_toml(folder, name="OC4 by OpenSees", sensors=sensors, rate_hz=RATE, block_minutes=MINUTES,
                        water_depth_m=50.0)
    rows, stresses = ["time,wind_speed_mps,power_kw,nacelle_heading_deg"], []
    for k in range(blocks):
        wind, turbulence, thrust, hs, tp = SEAS[k % len(SEAS)]
        angle = float(rng.uniform(-180, 180))
        wind *= float(rng.uniform(0.9, 1.1))
        data, stress = world.record(truth.Sea(wind, turbulence, thrust, hs, tp, np.radians(angle)), 60 * MINUTES, RATE,
                                    NOISE, rng)
        start = case.START + np.timedelta64(MINUTES * k, "m")
        write_acceleration(folder / "acceleration" / f"{k:03d}.h5", data, start, RATE)
        stresses.append(stress.astype(np.float32))
        power = 0.0 if wind < 4 else min(5000.0, 5000 * (wind / 11.4) ** 3)
        rows += [f"{start + np.timedelta64(10 * j, 'm')}Z,{wind:.2f},{power:.0f},{-angle % 360:.1f}" for j in range(3)]
    (folder / "scada.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return stresses


def write_gauges(path: Path, stresses: list[np.ndarray], fm, spots, rng) -> Path:
    """Of the true stresses at hot spots, as strain gauges of 0.05 MPa noise read them at the accelerometers' rate."""
    at, w = weights(fm.spots)
    true = np.vstack(stresses)
    n = len(true)
    table = {"time": pd.Timestamp(case.START, tz="UTC") + pd.to_timedelta(np.arange(n) / RATE, unit="s")}
    for k in spots:
        stress = true[:, 3 * at[k] : 3 * at[k] + 3].astype(float) @ w[k]
        table[f"hot_spot_{k + 1}_mpa"] = (stress + 0.05 * rng.standard_normal(n)).round(4)
    pd.DataFrame(table).to_csv(path, index=False, date_format="%Y-%m-%dT%H:%M:%S.%f%z")
    return path


def by_one_mode(data: np.ndarray, modes: tuple[np.ndarray, np.ndarray], top: tuple[int, int]) -> np.ndarray:
    """(n, n_stress) the habit: acceleration of the top between 0.2 and 0.5 Hz, integrated twice, times the stress of
    the first mode of each axis over its motion there. modes: motion (n_channel, 2) and stress (n_stress, 2)."""
    line = np.fft.rfftfreq(len(data), 1 / RATE)
    band = (line > 0.2) & (line < 0.5)
    lines = np.where(band[:, None], np.fft.rfft(data[:, top], axis=0), 0.0)
    lines[band] /= -((2 * np.pi * line[band, None]) ** 2)
    moved = np.fft.irfft(lines, len(data), axis=0)
    # each mode by what both axes of the top move
    motion, stress = modes
    return moved @ np.linalg.inv(motion[list(top)]).T @ stress.T


def first_modes(fm, channels) -> tuple[np.ndarray, np.ndarray]:
    model = fm.models[0].reduce([fm.parameters.initial])
    m = model.modes_at(fm.parameters.initial, {})
    rows = model.model.channel_rows(fm.parameters.initial)[: len(channels)] @ model.basis @ m.U[:, :2]
    return rows, (m.RK - m.RM * np.r_[m.value[:2], m.value[2:]])[:, :2]


def summarised(table: pd.DataFrame) -> dict:
    groups = [("all", table), *((str(name), own) for name, own in table.groupby("at")),
              *((f"observable {name}", own) for name, own in table.groupby("observable"))]
    found = {}
    for name, own in groups:
        for m in (3, 5):
            for prefix in ("", "mode_"):
                ratio = own[f"{prefix}m{m}"] / own[f"true_m{m}"]
                found[f"{prefix}{name} m{m}"] = {
                    "n": len(own), "median": float(ratio.median()), "median_abs": float((ratio - 1).abs().median()),
                    "p05": float(ratio.quantile(0.05)), "p95": float(ratio.quantile(0.95))}
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared/reference/oc4")
    parser.add_argument("--blocks", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--gauges", choices=("held_out", "joined"), help="strain gauges at places 1 and 3 of leg welds")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    model, _ = case.write_models(a.data, a.out)
    fatigue = Path(case.__file__).with_name("fatigue.toml")
    conditions = read_conditions(fatigue)
    one = conditions.direction[0].model_copy(update={"heading_deg": 0.0, "share": 1.0})
    fm = fatigue_model_of(model, conditions.model_copy(update={"direction": (one,)}))
    channels = fm.models[0].model.channels
    places = [(int(c.split("-")[1]), "xy".index(c.split("-")[2])) for c in channels]
    world = truth.world(a.data, places, [(d.place_m, d.along, d.crown, d.saddle, d.end) for d in fm.details])
    sensors = tuple(replace(s, gravity=True) for s in case.sensors(read_subdyn(a.out / case.INPUT)))
    rng = np.random.default_rng(a.seed)
    true = drawn_campaign(a.out / "campaign", world, sensors, a.blocks, rng)
    draws = fm.parameters.initial * (1 + 0.01 * rng.standard_normal((200, len(fm.parameters.initial))))
    gauges = GaugeFiles()
    if a.gauges:
        welds = [k for k, s in enumerate(fm.spots) if s.side == "weld" and s.place in (1, 3)]
        gauges = GaugeFiles(**{a.gauges: write_gauges(a.out / "gauges.csv", true, fm, welds, rng)})
    begun = time.process_time()
    campaign = read_campaign(a.out / "campaign")
    found = measured_stresses(campaign, model, fatigue, draws,
                              StateDamping.alike(dict.fromkeys(("FA1", "SS1", "FA2", "SS2"), 0.01)),
                              settings=StressSettings(n_draw=6, n_worst=6), gauges=gauges)
    seconds = time.process_time() - begun
    print(StressResult(found=found).summary)
    at, w = weights(found.spots)
    seen: dict[tuple[int, str], int] = {}
    for k in np.argsort(-np.mean([b.damage_per_hour for b in found.blocks], axis=0)):
        seen.setdefault((found.spots[k].detail, found.spots[k].side), int(k))
    modes, top = first_modes(fm, channels), (channels.index("tower-135-x"), channels.index("tower-135-y"))
    rows = []
    for number, (b, stress) in enumerate(zip(found.blocks, true, strict=True)):
        data = read_block(campaign, *list(block_files(campaign).items())[number]).data
        habit = by_one_mode(data, modes, top)
        for k in seen.values():
            columns = slice(3 * at[k], 3 * at[k] + 3)
            cycles = counted(stress[:, columns].astype(float) @ w[k])
            real, scaled = equivalent(cycles), equivalent(counted(habit[:, columns] @ w[k]))
            law, thick = conditions.law(found.spots[k].curve), found.spots[k].thickness_effect
            hour = 6 * np.mean([np.sum(c[:, 1] / law.cycles(thick * c[:, 0])) for c in cycles])
            rows.append({
                "block": b.id, "state": b.state, "spot": k, "at": found.details[at[k]].at, "resolved": b.resolved[k],
                "observable": bool(found.observable[k]), "true_m3": real[0], "true_m5": real[1],
                "m3": b.equivalent_mpa[0, k], "m5": b.equivalent_mpa[1, k], "mode_m3": scaled[0], "mode_m5": scaled[1],
                "true_damage_per_hour": hour})
    table = pd.DataFrame(rows)
    table.to_csv(a.out / "compared.csv", index=False)
    _, quantile, measured = found.per_year()
    mean = table.groupby(["spot", "state"])["true_damage_per_hour"].mean().unstack()
    year = 24 * 365.25 * sum(share * mean[name] for name, share in measured.items())
    inside = (quantile[0, year.index] <= year) & (year <= quantile[2, year.index])
    summary = {"blocks": a.blocks, "hot_spots": len(found.spots), "processor_seconds": seconds,
               "sides_compared": len(seen), "annual_damage_inside_90": float(inside.mean()),
               "rainflow_over_spectrum": {h.id: h.rainflow_over_spectrum.tolist() for h in found.histories},
               **summarised(table)}
    text = json.dumps(summary, indent=1)
    print(text)
    (a.out / "summary.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
