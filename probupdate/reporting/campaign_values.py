"""A campaign directory and the truth of a virtual one, as far as the page shows them; no record is read, only heads."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.errors import InputError
from probupdate.modes import ModalData, Sensor, rotate_to_real
from probupdate.reporting.model_values import partners
from probupdate.reporting.values import CampaignValues

# shares of the rated power, taken as the highest power recorded: at or below the first the turbine idles
IDLING_SHARE, RATED_SHARE = 0.005, 0.97


def campaign_values(folder: Path) -> CampaignValues:
    """Sensors, coverage and SCADA of a campaign directory."""
    head = _toml(folder / "campaign.toml")
    try:
        sensors = tuple(Sensor(**entry) for entry in head["sensor"])
        rate, minutes = float(head["sampling_rate_hz"]), float(head["block_minutes"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(str(folder / "campaign.toml"), f"cannot be read ({error})", "run `probupdate check`") from None
    facts = [("name", str(head.get("name", folder.name)))]
    facts += _coverage(folder / "acceleration", rate, minutes)
    facts.append(("sampling rate", f"{rate:g} Hz, {len(sensors)} channels, blocks of {minutes:g} minutes"))
    if "water_depth_m" in head:
        facts.append(("water depth", f"{float(head['water_depth_m']):g} m"))
    scada, rule = None, ""
    if (folder / "scada.csv").exists():
        scada, rule = read_scada(folder / "scada.csv")
        facts.append(("SCADA", f"{len(scada)} intervals, {(scada.shape[1] - 1)} columns"))
    return CampaignValues(
        name=facts[0][1], sensors=sensors, sampling_rate_hz=rate, block_minutes=minutes, facts=tuple(facts),
        scada=scada, state_rule=rule,
    )


def _toml(path: Path) -> dict:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(str(path), "no such file", "check the run directory") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(str(path), f"not TOML ({error})", "mend the file at that place") from None


def _coverage(folder: Path, rate_hz: float, block_minutes: float) -> list[tuple[str, str]]:
    """First and last sample and how many hours the files hold, from their heads."""
    import h5py

    starts, seconds = [], []
    for path in sorted(folder.glob("*.h5")):
        with h5py.File(path, "r") as file:
            starts.append(pd.Timestamp(file["data"].attrs["start"]).tz_localize(None))
            seconds.append(file["data"].shape[0] / rate_hz)
    if not starts:
        return [("records", "no acceleration file")]
    first = min(starts)
    last = max(a + pd.Timedelta(seconds=s) for a, s in zip(starts, seconds, strict=True))
    span, held = (last - first).total_seconds() / 3600, sum(seconds) / 3600
    return [
        ("recorded", f"{first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M} UTC"),
        ("records", f"{held:.1f} of {span:.1f} hours in {len(starts)} files, up to {int(held * 60 // block_minutes)} blocks"),
    ]


def read_scada(path: Path) -> tuple[pd.DataFrame, str]:
    """SCADA with `time` (UTC, no zone) and, where the power was recorded, `state`; and the rule in words."""
    try:
        table = pd.read_csv(path)
        table["time"] = pd.to_datetime(table["time"], utc=True).dt.tz_localize(None)
    except (KeyError, ValueError) as error:
        raise InputError(str(path), f"cannot be read ({error})", "run `probupdate check`") from None
    if "power_kw" not in table:
        return table, "The power was not recorded, so the states are not known."
    power = table["power_kw"].to_numpy(float)
    rated = float(np.nanmax(power)) if np.any(np.isfinite(power)) else np.nan
    with np.errstate(invalid="ignore"):
        state = np.select([power <= IDLING_SHARE * rated, power >= RATED_SHARE * rated], ["idling", "rated"], "below rated")
    table["state"] = np.where(np.isfinite(power), state, "unknown")
    rule = (
        f"States by power: idling up to {100 * IDLING_SHARE:g} % and rated from {100 * RATED_SHARE:g} % of the highest "
        f"power recorded ({rated:.0f} kW)."
    )
    return table, rule


def truth_values(path: Path, modes: ModalData | None, pairs: tuple[tuple[int, ...], ...]) -> Mapping:
    """What is known of a virtual turbine: `parameters`, and `idling_hz`, its own frequencies under the labels of the
    identified modes at the nacelle heading nearest to that of the reference set."""
    from probupdate.virtual.truth import read_truth_modes

    raw = _toml(path)
    truth: dict = {"parameters": raw.get("parameters", {}), "seed": raw.get("seed")}
    if modes is None or not raw.get("mode_set") or not modes.labels:
        return truth
    chosen = modes.set()
    heading = float(chosen.environment.get("nacelle_heading_deg", 0.0))
    sets = read_truth_modes(path)
    near = min(sets, key=lambda s: abs((s.heading_deg - heading + 180) % 360 - 180))
    known = [j for j in range(modes.n_mode) if chosen.measured[j]]
    if near.shape.shape[0] != len(modes.channels):
        return truth
    inside = [tuple(known.index(j) for j in p) for p in pairs if all(j in known for j in p)]
    found = partners(rotate_to_real(chosen.shape[:, known]).real, chosen.frequency_hz[known], near.shape, inside)
    truth["idling_hz"] = {modes.labels[known[k]]: float(near.frequency_hz[i]) for k, i in found.items()}
    truth["heading_deg"] = near.heading_deg
    return truth
