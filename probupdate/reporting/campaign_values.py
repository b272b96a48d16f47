"""A campaign directory and the truth of a virtual one, as far as the page shows them; no record is read, only heads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import block_starts
from probupdate.campaign.reading import Campaign, read_campaign
from probupdate.campaign.scada import StateRule, row_states, with_rated_power
from probupdate.errors import InputError
from probupdate.io.files import read_json_table, sha256
from probupdate.io.result_table import plural
from probupdate.modal.modes import ModalData
from probupdate.reporting.values import CampaignValues


def campaign_values(folder: Path, check: Path | None = None) -> CampaignValues:
    """Sensors, coverage and SCADA of a campaign directory; `check`: what `probupdate check` wrote, if it was run."""
    campaign = read_campaign(folder)
    facts = [("name", campaign.name), *_coverage(campaign)]
    facts.append((
        "channels", f"{len(campaign.sensors)} at {campaign.sampling_rate_hz:g} Hz, in blocks of "
        f"{campaign.block_minutes:g} minutes"))
    if campaign.water_depth_m is not None:
        facts.append(("water depth", f"{campaign.water_depth_m:g} m"))
    if campaign.left_out:
        facts.append(("channels left out", ", ".join(campaign.left_out)))
    scada, rule = None, ""
    if campaign.scada is not None:
        scada, rule = scada_values(campaign, campaign.scada)
        facts.append(("SCADA", f"{len(scada)} intervals, {campaign.scada.shape[1]} columns"))
    return CampaignValues(
        name=campaign.name, sensors=campaign.sensors, sampling_rate_hz=campaign.sampling_rate_hz,
        block_minutes=campaign.block_minutes, water_depth_m=campaign.water_depth_m, facts=tuple(facts),
        findings=() if check is None else _findings(check, campaign), scada=scada, state_rule=rule,
    )


def _findings(path: Path, campaign: Campaign) -> tuple[str, ...]:
    """What `probupdate check` found; refused where it was another campaign that was checked."""
    again = "write it again with `probupdate check`, or remove it"
    try:
        content = read_json_table(path, again)
        findings = tuple(str(text) for text in content["findings"])
        checked = str(content.get("campaign", campaign.name))
        channels = [str(row["channel"]) for row in content.get("channels", ())]
        blocks = [str(row["id"]) for row in content.get("blocks", ())]
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(str(path), f"cannot be read ({error})", again) from None
    if checked != campaign.name:
        raise InputError(str(path), f"is of the campaign '{checked}', not of '{campaign.name}'", again)
    if channels and channels != list(campaign.channels):
        odd = [c for c in channels if c not in campaign.channels] or [c for c in campaign.channels if c not in channels]
        raise InputError(str(path), "is of a campaign with other channels" + (f" ({odd[0]})" if odd else ""), again)
    starts = {f"{start:%Y-%m-%dT%H:%M:%SZ}"[:16] for start in block_starts(campaign)}
    if blocks and not starts & {b[:16] for b in blocks}:
        raise InputError(str(path), f"is of other records: {blocks[0]} is not a block of this campaign", again)
    if content.get("campaign_toml_sha256", held := sha256(campaign.path / "campaign.toml")) != held:
        return ("campaign.toml was changed after this check: run `probupdate check` again", *findings)
    return findings


def _coverage(campaign: Campaign) -> list[tuple[str, str]]:
    """First and last sample and how many hours the files hold, an overlap counted once."""
    files = campaign.files
    ends = [f.start + pd.Timedelta(seconds=f.n_sample / campaign.sampling_rate_hz) for f in files]
    held, reached = pd.Timedelta(0), files[0].start
    for file, end in zip(files, ends, strict=True):
        held += max(end - max(file.start, reached), pd.Timedelta(0))
        reached = max(reached, end)
    span = reached - files[0].start
    hour = pd.Timedelta(hours=1)
    return [
        ("recorded", f"{files[0].start:%Y-%m-%d %H:%M} to {reached:%Y-%m-%d %H:%M} UTC"),
        ("records", f"{held / hour:.1f} of {span / hour:.1f} hours in {plural(len(files), 'file')}"),
    ]


def scada_values(campaign: Campaign, scada: pd.DataFrame) -> tuple[pd.DataFrame, str]:
    """SCADA with a column `time` (UTC, no zone) and, where the power was recorded, `state`; and the rule in words."""
    rule = with_rated_power(StateRule(rated_power_kw=campaign.rated_power_kw), scada)
    table = scada.reset_index()
    table["time"] = table["time"].dt.tz_localize(None)
    if rule.rated_power_kw is None:
        return table, "The power was not recorded, so the states are not known."
    table["state"] = row_states(scada, rule)
    source = "the highest power recorded" if campaign.rated_power_kw is None else "the rated power"
    words = (
        f"States by power: idling up to {100 * rule.idling_share:g} % and rated from {100 * rule.rated_share:g} % of "
        f"{source} ({rule.rated_power_kw:.0f} kW)."
    )
    return table, words


def truth_values(path: Path, modes: ModalData | None, added: Mapping[str, str] | None = None) -> Mapping:
    """What is known of a virtual turbine: `parameters` by name, with those that an extended model has for a hidden
    factor (`added`: their names and places), and `idling_hz`, its own frequencies by label at the
    nacelle heading nearest to that of the modes' reference set (fore-aft is where the nacelle looks)."""
    from probupdate.virtual.effects import hidden_words
    from probupdate.virtual.truth import read_truth_modes
    from probupdate.virtual.turbine_file import read_toml

    sets, content = read_truth_modes(path), read_toml(path, "truth file")
    heading = np.nan if modes is None else float(modes.set().environment.get("nacelle_heading_deg", np.nan))
    turn = [abs((s.heading_deg - heading + 180) % 360 - 180) if np.isfinite(heading) else 0.0 for s in sets]
    near = sets[int(np.argmin(turn))]
    hidden = [(hidden_words(e), e.get("factor")) for e in content.get("effect", ())]
    factors = {name: factor for name, place in (added or {}).items() for words, factor in hidden
               if factor is not None and f", {place}: " in words}
    return {
        "parameters": {**content.get("parameters", {}), **factors},
        "effects": tuple(words for words, _ in hidden),
        "idling_hz": {label: float(f) for label, f in zip(near.labels, near.frequency_hz, strict=True)},
        "heading_deg": near.heading_deg,
    }
