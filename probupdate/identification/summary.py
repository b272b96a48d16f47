"""What an identification says of itself in lines: blocks, modes, turbine states, lines of the rotor."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import CONTRADICTION, COUNTED_AS_LOST, PART
from probupdate.campaign.reading import Campaign
from probupdate.campaign.scada import StateRule
from probupdate.identification.block_poles import BRIDGED, STAY, TAKEN_OUT, BlockPoles, common_quantity
from probupdate.identification.chosen_poles import StoredBlock
from probupdate.identification.free_decay import SAID
from probupdate.io.result_table import plural
from probupdate.modal.labels import TURBINE, family
from probupdate.modal.modes import ModalData


def summarise(
    every: Sequence[StoredBlock], data: ModalData, poles: pd.DataFrame, campaign: Campaign, rule: StateRule
) -> str:
    """Line by line: what was identified, of which blocks, and what was not looked for."""
    found, used = [one.block for one in every], [one for one in every if one.usable]
    lines = [f"{len(used)} of {len(found)} blocks identified, {len(poles)} poles"]
    other = Counter(s.quantity for s in campaign.sensors if s.quantity != common_quantity(campaign.sensors))
    lines += [f"{plural(n, 'channel')} of {name} converted to acceleration" for name, n in other.items()]
    reasons = Counter(next((word for word in ("gap", PART) if one.excluded.startswith(word)), one.excluded)
                      for one in found if one.excluded)
    if reasons:
        lines.append("left out: " + ", ".join(f"{n} for {name}" for name, n in reasons.items()))
    lines += _sample_notes(found, campaign.channels)
    damaged = [b.id for b in found if any(COUNTED_AS_LOST in note for note in b.notes)]
    if damaged:
        lines.append(f"samples that no sensor measures, {COUNTED_AS_LOST}, in {len(damaged)} of {len(found)} blocks, "
                     f"first {damaged[0]}: `probupdate check` names the channels")
    lines += [_mode_text(label, np.array([s.frequency_hz[j] for s in data.sets]))
              for j, label in enumerate(data.labels)]
    of_turbine = any(family(label) == TURBINE[0] for label in data.labels)
    lines += _scada_notes(data, campaign, rule, of_turbine)
    lines += harmonics_removed(note for block in found for note in block.notes)
    lines += _count_notes(found, (SAID, BRIDGED, CONTRADICTION))
    lined = int((poles["criterion"] == "harmonic").sum()) if "criterion" in poles else 0
    if lined:
        lines.append(f"{plural(lined, 'pole')} at multiples of the rotor's speed: counted as its lines")
    if not of_turbine and (campaign.scada is None or "rotor_speed_rpm" not in campaign.scada):
        lacks = "SCADA" if campaign.scada is None else "rotor_speed_rpm in SCADA"
        lines.append(f"no {lacks}: lines of a rotating machine were not looked for, and may be among the modes")
    elif campaign.scada is None or "rotor_speed_rpm" not in campaign.scada:
        lines.append("no rotor speed in SCADA: harmonics were not looked for, and may be among the modes")
    lines += campaign.scada.attrs.get("notes", []) if campaign.scada is not None else []
    return "\n".join(lines)


def _count_notes(blocks: Sequence[BlockPoles], notes: tuple[str, ...]) -> list[str]:
    """In how many blocks each note stands, where in any."""
    count = {note: sum(note in block.notes for block in blocks) for note in notes}
    return [f"in {n} of {len(blocks)} blocks: {note}" for note, n in count.items() if n]


def _sample_notes(blocks: Sequence[BlockPoles], channels: tuple[str, ...]) -> list[str]:
    """What was not measured of each channel, in the blocks that were used, and what was done about it."""
    used = [b.unmeasured for b in blocks if not b.excluded]
    if not used or not np.any(share := np.mean(used, axis=0)):
        return []
    words = []
    for what, of_kind in zip(("lost", "repeats", "on straight lines drawn over gaps"), share, strict=True):
        some = [f"{name} {100 * x:.2g} %" for name, x in zip(channels, of_kind, strict=True) if x > 0]
        if len(some) == len(channels) > 1 and np.ptp(of_kind) < 1e-3 * of_kind.max():
            some = [f"all channels {100 * of_kind[0]:.2g} %"]
        if some:
            words.append(f"{what}: {', '.join(some)}")
    return [f"samples that were not measured ({'; '.join(words)}): covariances are of the pairs that were, and "
            "standard deviations grow by what is missing"]


def _mode_text(label: str, frequency_hz: np.ndarray) -> str:
    f = frequency_hz[np.isfinite(frequency_hz)]
    text = (f"mean {np.mean(f):.4f} Hz, CoV {np.std(f, ddof=1) / np.mean(f):.4f}" if len(f) > 1
            else f"{f[0]:.4f} Hz" if len(f) else "not identified")
    return f"{label}: in {plural(len(f), 'block')}, {text}"


def of_likelihood(names: Sequence[str], taken: np.ndarray, found: np.ndarray) -> list[str]:
    """How many modes have values of greatest likelihood (`refinement`), and which seldom have; both (n_block, n_mode)
    bool."""
    if not taken.any():
        return []
    seldom = [name for name, n, of in zip(names, taken.sum(axis=0), found.sum(axis=0), strict=True)
              if name and 2 * n < of]
    said = (f"maximum-likelihood estimates of frequency, damping and shape for {taken.sum()} of {found.sum()} modes "
            "found in single blocks")
    if taken.sum() < found.sum():
        said += ", those of SSI-cov for the others"
    if seldom:
        said += (f", among them most of {', '.join(seldom)}, whose spectra hold more than these modes under a smooth "
                 "force (lines, tails of other modes), or too little")
    return [said]


def _scada_notes(data: ModalData, campaign: Campaign, rule: StateRule, of_turbine: bool) -> list[str]:
    """Turbine states, rated power and what fore-aft is."""
    lines = []
    states = Counter(str(s.environment["state"]) for s in data.sets)
    if of_turbine or set(states) - {"unknown"}:
        lines.append("states: " + ", ".join(f"{n} {name}" for name, n in states.most_common()))
    if rule.rated_power_kw is not None and campaign.rated_power_kw is None:
        lines.append(f"rated power taken as the highest recorded, {rule.rated_power_kw:.0f} kW"
                     if rule.rated_power_kw > 0 else "no power was recorded: the turbine produced none")
    if campaign.scada is not None and "nacelle_heading_deg" in campaign.scada:
        axis = f"{campaign.x_axis_heading_deg:g} deg of the compass"
        lines.append(f"fore-aft is where the nacelle looks; the model's x axis lies at {axis}")
    elif of_turbine:
        lines.append("no nacelle heading in SCADA: fore-aft is the model's x axis")
    return lines


def harmonics_removed(notes: Iterable[str]) -> list[str]:
    """What --harmonics remove did, by the blocks' notes: which multiples were taken out in how many blocks, and why
    they stayed in others."""
    taken, stayed, used = Counter(), Counter(), 0
    for note in notes:
        if note.startswith(TAKEN_OUT):
            used += 1
            taken.update(note.removeprefix(TAKEN_OUT).split(", "))
        elif note.startswith(STAY):
            # numbers differ from block to block, the reason does not
            stayed[re.sub(r"[:(].*", "", note.removeprefix(STAY)).strip()] += 1
    if not taken and not stayed:
        return []
    lines = [f"harmonics taken out in {used} of {used + sum(stayed.values())} blocks"
             + (": " + ", ".join(f"{name} in {n}" for name, n in sorted(taken.items())) if taken else "")]
    return [*lines, *(f"harmonics stay in {n} blocks: {reason}" for reason, n in stayed.most_common())]
