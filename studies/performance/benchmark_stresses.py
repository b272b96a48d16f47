"""Processor time and memory of `stresses`: a month of 18 channels at some 200 hot spots.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python studies/performance/benchmark_stresses.py STUDY OUT [--blocks 1440]

STUDY is what `python -m studies.stresses --out STUDY` wrote: the OC4 jacket and half hours of it by OpenSees, which are
repeated over the month under drawn headings, so that every pair of heading and state is learnt of.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import h5py
import numpy as np
import pandas as pd

from probupdate.campaign.reading import read_campaign
from probupdate.lifetime.damping import StateDamping
from probupdate.lifetime.measured_stress import MeasuredStress, measured_stresses
from probupdate.structure.load import load_model
from probupdate.virtual.campaign_files import write_acceleration

DETAILS = """[[member_end]]
braces = "braces"
chords = "legs"
joints = [5, 10, 15]
curve = "T"
efthymiou = { kind = "K", chord_length_m = 15.0, chord_fixity = 0.7, gap_m = 0.10, least = 1.5 }
[[girth]]
part = "legs"
z_m = -24.614
factor = 1.2
curve = "D"

"""
START, BLOCK_S = np.datetime64("2024-03-01T00:00:00"), 1800


def repeated(study: Path, out: Path, blocks: int, rng) -> Path:
    """A campaign directory of so many blocks."""
    (out / "acceleration").mkdir(parents=True)
    (out / "campaign.toml").write_bytes((study / "campaign.toml").read_bytes())
    files = sorted((study / "acceleration").glob("*.h5"))
    scada = pd.read_csv(study / "scada.csv").iloc[:: BLOCK_S // 600]
    rows = []
    for k in range(blocks):
        start = START + np.timedelta64(BLOCK_S * k, "s")
        with h5py.File(files[k % len(files)]) as file:
            write_acceleration(out / "acceleration" / f"{k:05d}.h5", file["data"][:], start,
                               file["data"].attrs["sampling_rate_hz"])
        own = scada.iloc[k % len(files)]
        rows.append({"time": f"{start}Z", "wind_speed_mps": own["wind_speed_mps"], "power_kw": own["power_kw"],
                     "nacelle_heading_deg": 30 * int(rng.integers(12))})
    pd.DataFrame(rows).to_csv(out / "scada.csv", index=False)
    return out


def fatigue(out: Path) -> Path:
    """fatigue.toml of studies/oc4 with fewer details."""
    text = (Path(__file__).resolve().parents[1] / "oc4" / "fatigue.toml").read_text(encoding="utf-8")
    path = out / "fatigue.toml"
    path.write_text(text[: text.index("[[member_end]]")] + DETAILS + text[text.index("[uncertainty]"):],
                    encoding="utf-8")
    return path


def timed(study: Path, out: Path, campaign: Path) -> tuple[MeasuredStress, float]:
    """Stresses of the campaign, and processor seconds from its reading on."""
    initial = load_model(study / "model.toml").parameters.initial
    draws = initial * (1 + 0.01 * np.random.default_rng(1).standard_normal((200, len(initial))))
    damping = StateDamping.alike(dict.fromkeys(("FA1", "SS1", "FA2", "SS2"), 0.01))
    begun = time.process_time()
    found = measured_stresses(read_campaign(campaign), study / "model.toml", fatigue(out), draws, damping)
    return found, time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--blocks", type=int, default=1440)
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    campaign = a.out / f"campaign_{a.blocks}"
    if not campaign.exists():
        repeated(a.study / "campaign", campaign, a.blocks, np.random.default_rng(1))
    found, seconds = timed(a.study, a.out, campaign)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    groups = len({(b.heading_deg, b.state) for b in found.blocks})
    print(f"stresses: {len(found.blocks)} half hours, {len(found.spots)} hot spots, {groups} pairs of heading and "
          f"state: {seconds:.0f} s of processor time, {memory:.0f} MB")


if __name__ == "__main__":
    main()
