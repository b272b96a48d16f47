"""Both classifiers on virtual days with their known truth: what is found, what is taken for a mode and is none.

    python studies/identification/run.py OUT [--days 2] [--seed 1] [--state updated] [--model as_built] [--windy]

simulates a campaign in OUT (or goes on with the one there), identifies it and writes OUT/table.csv and OUT/table.md.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pandas as pd

import probupdate
from probupdate.campaign.blocks import blocks
from probupdate.campaign.gaps import fill_short_gaps
from probupdate.campaign.reading import Campaign, read_campaign
from probupdate.cli.terminal import terminal_progress
from probupdate.identification import classification as rules
from probupdate.identification import tracking
from probupdate.identification.environment import fore_aft_deg
from probupdate.identification.harmonics import without_harmonics
from probupdate.identification.identify import Identification
from probupdate.identification.preprocessing import resample
from probupdate.identification.reference import turn_reference
from probupdate.identification.ssi import factorise, output_covariances, poles
from probupdate.verbs import open_model
from probupdate.verbs.sought import reference_modes
from probupdate.virtual.truth import read_truth_modes

ORDERS, BLOCK_ROWS, RATE_HZ = (20, *(n for n in range(12, 37, 2) if n != 20)), 30, 5.0
# a pole further from the mode's true frequency than this is another thing taken for it: five standard deviations of the
# weakest
FAR = 0.03
WINDY = "[operation]\nmaintenance_hours = []\nwind_speed_mean_mps = 12.0\n"
PAPER, FOLLOWED, REMOVED = "paper", "followed", "harmonics removed"


def true_modes(truth, labels, heading_deg: float, state: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and damping (n_mode,) at the nearest heading; damping NaN where the rotor did both."""
    near = min(truth, key=lambda m: abs((m.heading_deg - heading_deg + 180) % 360 - 180))
    index = [near.labels.index(label) for label in labels]
    damping = {"idling": near.damping_ratio_idling, "below rated": near.damping_ratio_operating,
               "rated": near.damping_ratio_operating}.get(state)
    return near.frequency_hz[index], np.full(len(index), np.nan) if damping is None else damping[index]


def by_paper(identification: Identification, order: int) -> dict[str, tuple[np.ndarray, np.ndarray, int]]:
    """id -> frequency, damping (n_mode,), and how many poles passed: of a mode's poles that pass, the best MAC."""
    labels, table = identification.data.labels, identification.poles
    found = {}
    for time, rows in table[table["order"] == order].groupby("time"):
        passed = rows[rows["paper_criterion"] == rules.KEPT]
        f, zeta = np.full(len(labels), np.nan), np.full(len(labels), np.nan)
        for j, label in enumerate(labels):
            mine = passed[passed["mode"] == label]
            if len(mine):
                best = mine.loc[mine["mac"].idxmax()]
                f[j], zeta[j] = best["frequency_hz"], best["damping_ratio"]
        found[time.strftime("%Y-%m-%dT%H:%MZ")] = f, zeta, len(passed)
    return found


def with_harmonics_removed(campaign: Campaign, identification: Identification, reference) -> dict[str, tuple]:
    """The same records after the rotor's multiples were taken out; id -> frequency, damping, followed."""
    settings = rules.ClassifierSettings()
    environment = {s.id: s.environment for s in identification.data.sets}
    judged, followed = [], {}
    for block in blocks(campaign):
        conditions = environment[block.id]
        if conditions.get("excluded"):
            continue
        record = resample(fill_short_gaps(block.data, len(block.data))[0], campaign.sampling_rate_hz, RATE_HZ)
        speed = [float(conditions.get(f"rotor_speed_rpm_{end}", np.nan)) for end in ("min", "max")]
        removal = without_harmonics(record, RATE_HZ, (speed[0], speed[1]))
        followed[block.id] = removal.followed
        covariance = output_covariances(removal.record, 2 * BLOCK_ROWS - 1)
        stack = rules.stack_poles(poles(factorise(covariance, BLOCK_ROWS, max(ORDERS), RATE_HZ), ORDERS))
        here = turn_reference(reference, campaign.sensors, fore_aft_deg(conditions, campaign))
        like = rules.comparison(stack, here)
        judged.append(tracking.JudgedPoles(
            id=block.id, poles=stack, comparison=like, reference=here, bands=rules.rotor_bands(conditions, settings),
            verdict=rules.block_criteria(stack, like, here, settings)))
    found = {}
    for one, choice in zip(judged, tracking.track(judged, settings).choices, strict=True):
        there = choice.pole >= 0
        f = np.where(there, one.poles.frequency_hz[choice.pole], np.nan)
        found[one.id] = f, np.where(there, one.poles.damping_ratio[choice.pole], np.nan), followed[one.id]
    return found


def rows_of(campaign, identification: Identification, truth, removed) -> pd.DataFrame:
    """A row a block, mode and way: errors of frequency and damping, NaN where the mode was not found; z: the error over
    the stated standard deviation."""
    paper, labels, rows = by_paper(identification, 20), identification.data.labels, []
    for s in identification.data.sets:
        if s.environment.get("excluded"):
            continue
        state = str(s.environment.get("state"))
        true_hz, true_damping = true_modes(truth, labels, float(s.environment.get("nacelle_heading_deg", 0)), state)
        ways = {PAPER: (*paper[s.id][:2], np.nan), FOLLOWED: (s.frequency_hz, s.damping_ratio, s.frequency_std_hz),
                REMOVED: (*removed[s.id][:2], np.nan)}
        for way, (f, zeta, std) in ways.items():
            error = f / true_hz - 1
            z = (f - true_hz) / (np.full(len(labels), std) if np.isscalar(std) else std)
            for j, label in enumerate(labels):
                rows.append({"way": way, "state": state, "mode": label, "block": s.id, "error": error[j],
                             "damping_error": zeta[j] - true_damping[j], "z": z[j]})
    return pd.DataFrame(rows)


def summed(rows: pd.DataFrame) -> pd.DataFrame:
    """Per state, mode and way: found (share of blocks, within FAR), false (share of blocks, further off), bias and
    scatter of f in percent, of damping in percentage points, and the root mean square of z."""
    found = []
    for (state, mode, way), some in rows.groupby(["state", "mode", "way"], sort=False):
        error = some["error"].to_numpy()
        good = np.abs(error) <= FAR
        false = np.abs(error) > FAR
        damping = some["damping_error"].to_numpy()[good]
        z = some["z"].to_numpy()[good]
        several = good.sum() > 1
        found.append({
            "state": state, "mode": mode, "way": way, "blocks": len(some), "found": good.mean(), "false": false.mean(),
            "bias_percent": 100 * error[good].mean() if good.any() else np.nan,
            "scatter_percent": 100 * error[good].std(ddof=1) if several else np.nan,
            "damping_bias": 100 * damping.mean() if good.any() else np.nan,
            "damping_scatter": 100 * damping.std(ddof=1) if several else np.nan,
            "z_rms": float(np.sqrt(np.mean(z**2))) if len(z) and np.isfinite(z).all() else np.nan,
        })
    return pd.DataFrame(found)


def markdown(table: pd.DataFrame) -> str:
    lines = ["| state (blocks) | mode | way | found | false | f: bias, scatter % | damping: bias, scatter pp | z rms |",
             "|---|---|---|---|---|---|---|---|"]
    for r in table.itertuples():
        z = "" if np.isnan(r.z_rms) else f"{r.z_rms:.2f}"
        lines.append(f"| {r.state} ({r.blocks}) | {r.mode} | {r.way} | {r.found:.2f} | {r.false:.2f} | "
                     f"{r.bias_percent:+.2f}, {r.scatter_percent:.2f} | "
                     f"{r.damping_bias:+.2f}, {r.damping_scatter:.2f} | {z} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--days", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--state", default="updated", help="the virtual turbine's model: design, as_built, updated")
    parser.add_argument("--model", default="as_built", help="the model that poles are held against")
    parser.add_argument("--windy", action="store_true", help="12 m/s on average and no maintenance: the rotor turns")
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    folder, given = a.out / "campaign", None
    if a.windy:
        given = a.out / "windy.toml"
        given.write_text(WINDY, encoding="utf-8")
    with terminal_progress() as progress:
        probupdate.simulate(folder, model=a.state, days=a.days, seed=a.seed, truth=given, progress=progress)
        identification = probupdate.identify(folder, a.model, store=a.out / "blocks", progress=progress)
    campaign, truth = read_campaign(folder), read_truth_modes(folder / "truth.toml")
    reference = reference_modes(open_model(a.model, None, campaign.sensors), campaign.sensors).modes
    removed = with_harmonics_removed(campaign, identification, reference)
    rows = rows_of(campaign, identification, truth, removed)
    table = summed(rows)
    table.to_csv(a.out / "table.csv", index=False, float_format="%.5g", lineterminator="\n")
    (a.out / "table.md").write_text(markdown(table), encoding="utf-8")
    passed = by_paper(identification, 20)
    modes = len(identification.data.labels)
    sys.stdout.write(markdown(table))
    mean = np.mean([n for *_, n in passed.values()])
    sys.stdout.write(f"\npoles that pass the paper's classifier, a block: {mean:.1f} for {modes} modes; angle "
                     f"followed in {sum(x[2] for x in removed.values())} of {len(removed)}\n")


if __name__ == "__main__":
    main()
