"""Stresses from measured motion against a simulation by another program: `python run.py OC4_FOLDER OUT [--blocks N]`.

Records of 18 accelerometers and the true stresses come of OpenSees' matrices (truth.py); the model is the SubDyn file of
the same jacket, its parameters drawn about their prior's centre. True ranges are counted by the package `rainflow`. Beside
ours stands the habit of scaling by one mode: double-integrated acceleration at the top times the first modes' stress.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import rainflow
import truth

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oc4"))
import case

from probupdate.campaign.reading import read_campaign
from probupdate.io.subdyn_file import read_subdyn
from probupdate.lifetime.conditions import read_conditions
from probupdate.lifetime.damping import StateDamping
from probupdate.lifetime.details import weights
from probupdate.lifetime.fatigue import fatigue_model_of
from probupdate.lifetime.measured_stress import StressSettings, measured_stresses
from probupdate.lifetime.stress_files import StressResult
from probupdate.virtual.campaign_files import write_acceleration, write_campaign_toml

RATE, MINUTES, NOISE = 10.0, 30, 2e-5
# wind, turbulence, thrust for 1 m/s, significant height, period: others than those of fatigue.toml
SEAS = ((5.0, 0.15, 4e4, 0.7, 5.0), (8.5, 0.14, 9e4, 1.2, 6.0), (11.0, 0.12, 7e4, 1.8, 6.8), (16.0, 0.12, 5e4, 2.9, 8.0),
        (21.0, 0.11, 3.5e4, 4.0, 9.2), (3.0, 0.2, 0.4e4, 0.6, 5.0))
SLOPES = (3.0, 5.0)


def equivalent(record: np.ndarray) -> np.ndarray:
    """(2,) constant range at one cycle a second that does the damage of a history's ten-minute pieces."""
    piece = round(600 * RATE)
    cycles = [np.array([(r, n) for r, n in rainflow.count_cycles(record[a : a + piece])]) for a in
              range(0, len(record) - piece + 1, piece)]
    total = [np.mean([np.sum(c[:, 1] * c[:, 0] ** m) / 600 for c in cycles]) for m in SLOPES]
    return np.array([t ** (1 / m) for t, m in zip(total, SLOPES, strict=True)])


def drawn_campaign(folder: Path, world: truth.World, sensors, blocks: int, rng) -> tuple[list[np.ndarray], list[float]]:
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
    return stresses, rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--blocks", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    a = parser.parse_args()
    a.out.mkdir(parents=True)
    model, _ = case.write_models(a.source, a.out)
    fatigue = Path(case.__file__).with_name("fatigue.toml")
    conditions = read_conditions(fatigue)
    one = conditions.direction[0].model_copy(update={"heading_deg": 0.0, "share": 1.0})
    fm = fatigue_model_of(model, conditions.model_copy(update={"direction": (one,)}))
    places = [(int(c.split("-")[1]), "xy".index(c.split("-")[2])) for c in fm.models[0].model.channels]
    world = truth.world(a.source, places, [(d.place_m, d.along, d.crown, d.saddle, d.end) for d in fm.details])
    from dataclasses import replace
    sensors = tuple(replace(s, gravity=True) for s in case.sensors(read_subdyn(a.out / case.INPUT)))
    rng = np.random.default_rng(a.seed)
    true, _ = drawn_campaign(a.out / "campaign", world, sensors, a.blocks, rng)
    draws = fm.parameters.initial * (1 + 0.01 * rng.standard_normal((200, len(fm.parameters.initial))))
    ratios = StateDamping.alike({"FA1": 0.01, "SS1": 0.01, "FA2": 0.01, "SS2": 0.01})
    begun = time.process_time()
    found = measured_stresses(
        read_campaign(a.out / "campaign"), model, fatigue, draws, ratios, felt=dict.fromkeys((s.channel for s in sensors), True),
        settings=StressSettings(n_draw=6, n_worst=6))
    cpu = time.process_time() - begun
    print(StressResult(found=found).summary)
    at, w = weights(found.spots)
    # worst spot of each side, and those of most damage
    damage = np.mean([b.damage_per_hour for b in found.blocks], axis=0)
    seen, chosen = set(), []
    for k in np.argsort(-damage):
        key = (found.spots[k].detail, found.spots[k].side)
        if key not in seen:
            seen.add(key)
            chosen.append(int(k))
    rows = []
    for b, stress in zip(found.blocks, true, strict=True):
        for k in chosen:
            history = stress[:, 3 * at[k] : 3 * at[k] + 3].astype(float) @ w[k]
            real = equivalent(history)
            rows.append({"block": b.id, "spot": k, "part": found.details[at[k]].part, "at": found.details[at[k]].at,
                         "level_m": found.details[at[k]].level_m, "resolved": b.resolved[k], "true_m3": real[0],
                         "true_m5": real[1], "m3": b.equivalent_mpa[0, k], "m5": b.equivalent_mpa[1, k],
                         "observable": found.observable[k]})
    table = pd.DataFrame(rows)
    table.to_csv(a.out / "compared.csv", index=False)
    summary = {"blocks": a.blocks, "cpu_s": cpu, "counted": {h.id: h.rainflow_over_spectrum.tolist() for h in found.histories}}
    for name, own in [("all", table), *table.groupby("at"), *[(f"observable {x}", t) for x, t in table.groupby("observable")]]:
        for m in (3, 5):
            ratio = own[f"m{m}"] / own[f"true_m{m}"]
            summary[f"{name} m{m}"] = {"n": len(own), "median": round(float(ratio.median()), 4),
                                       "median_abs": round(float(np.median(np.abs(ratio - 1))), 4),
                                       "p05": round(float(ratio.quantile(0.05)), 4), "p95": round(float(ratio.quantile(0.95)), 4)}
    print(json.dumps(summary, indent=1))
    (a.out / "summary.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
