"""The check of a campaign, with a model also of its channels: which sign, exchange or order of them makes the measured
shapes its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from probupdate.campaign.blocks import block_starts
from probupdate.campaign.checking import CampaignCheck
from probupdate.campaign.checking import check as check_campaign
from probupdate.campaign.reading import Campaign, read_campaign
from probupdate.campaign.usable import LACKING
from probupdate.errors import InputError, names_files
from probupdate.identification.identify import SSISettings, identify
from probupdate.identification.settings import IdentificationSettings
from probupdate.modal.channel_mistakes import (
    ChannelMistake,
    ComputedModes,
    channel_mistake,
    shape_agreement,
    signed_comac,
)
from probupdate.modal.matching import with_stated_gravity
from probupdate.modal.modes import ModalData
from probupdate.runtime.progress import Progress, silent
from probupdate.updating.joint_set import joint_set
from probupdate.verbs.identifying import TOO_FEW, implausible_places, reference_at, sensors_of, ssi_settings
from probupdate.verbs.models import GivenModel, ModelAt, has_geometry
from probupdate.verbs.sought import SoughtModes

# blocks that are identified at most, evenly spread; share of them that has a mode whose shape is judged
MOST_BLOCKS, PERSISTENT = 24, 0.5
# signed coordinate MAC from which a channel moves the other way, and share of the blocks in which it does
OPPOSITE = 0.8
# mean of 1 - MAC from which shapes are said to be far from the model's
FAR_LOSS = 0.05
# modes of the model beyond the measured ones that are searched
SEARCH = 10


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelFinding:
    """finding: what is wrong with channels, '' for nothing; use: what was compared, in a sentence; modes: of a
    model whose shapes are those measured, by frequencies and readings."""

    finding: str
    use: str
    modes: tuple[np.ndarray, np.ndarray] | None = None


@names_files("campaign")
def check(
    campaign: str | Path, model: GivenModel | None = None, *, parameters: str | Path | None = None,
    progress: Progress = silent,
) -> CampaignCheck:
    """What a campaign holds, what is wrong with it, what can be done with it. With a model also signs, axes and order
    of the channels, by the shapes of some blocks."""
    opened = read_campaign(campaign)
    if model is None:
        return check_campaign(opened, progress=progress).with_finding("; ".join(implausible_places(opened.sensors)))
    held = check_against_model(opened, model, parameters=parameters, progress=progress)
    found = check_campaign(opened, modes=held.modes, progress=progress)
    return found.with_finding(held.finding, held.use)


def check_against_model(
    campaign: Campaign, model: GivenModel, *, parameters: str | Path | None = None, progress: Progress = silent
) -> ModelFinding:
    """Some blocks are identified without standard deviations, their shapes taken together, and each block asked again.
    Raises InputError where the model has not the campaign's channels."""
    sought = reference_at([campaign], model, where=campaign.path, parameters=parameters)
    held = 0 if sought.modes is None else int(np.sum(2 * sought.modes.frequency_hz < campaign.sampling_rate_hz))
    if sought.modes is not None and 0 < held < len(sought.modes.frequency_hz):
        # what the records cannot hold need not be there to hold the others against it
        sought = reference_at([campaign], model, where=campaign.path, parameters=parameters, lowest=held)
    chosen, said, _ = ssi_settings([campaign], model, IdentificationSettings(), sought.modes)
    held = _shapes_against(campaign, model, parameters, sought, chosen, progress)
    suspected = [text for text in (*sought.notes, *said) if text.startswith(("suspect", TOO_FEW, LACKING))]
    return replace(held, finding="; ".join(filter(None, [*suspected, held.finding])))


def _shapes_against(
    campaign: Campaign, model: GivenModel, parameters: str | Path | None, sought: SoughtModes, chosen: SSISettings,
    progress: Progress,
) -> ModelFinding:
    try:
        found = identify(_first_blocks(campaign), sought.modes, others=sought.others,
                         settings=replace(chosen, sub_records=0), progress=progress)
    except InputError as error:
        return ModelFinding(
            finding="", use=f"not compared with the model, as no modes were identified: {error.problem}")
    data = _persistent(found.data)
    joint = joint_set(data)
    one = joint.data.set()
    at = ModelAt(model, parameters, str(campaign.path), data.felt,
                 sensors=sensors_of([campaign]) if has_geometry(model) else None)
    opened = with_stated_gravity(at(one), data.felt)
    rows = [opened.channels.index(c) for c in data.channels]
    solved = opened.solve(opened.parameters.initial, min(data.n_mode + SEARCH, opened.n_available))
    shape = ComputedModes(shape=solved.shape[rows], frequency_hz=solved.frequency_hz)
    agreement, n_mode = shape_agreement(one, shape), int(np.sum(one.measured))
    use = (f"shapes of {n_mode} modes in {len(joint.ids)} blocks compared with the model's: mean MAC {agreement:.2f}")
    blocks = [s for s in data.sets if s.id in joint.ids]
    likely = channel_mistake(one, data.channels, [shape])
    if likely is None:
        # channels that move too little to change a MAC
        each = np.array([signed_comac(s, shape) < -OPPOSITE / 2 for s in blocks])
        opposite = [c for c, r, share in zip(data.channels, signed_comac(one, shape), each.mean(axis=0), strict=True)
                    if r < -OPPOSITE and share >= OPPOSITE]
        if 0 < len(opposite) <= len(data.channels) // 3:
            return ModelFinding(use=use, finding=(
                f"against the model: {', '.join(opposite)} moves the other way than the model's modes, in "
                f"{int(round(each[:, data.channels.index(opposite[0])].sum()))} of {len(blocks)} blocks; "
                + _reversed_remedy(opposite[0])))
    if likely is None:
        if 1 - agreement <= FAR_LOSS:
            return ModelFinding(finding="", use=use, modes=_compared_modes(campaign, data, shape, one.frequency_hz))
        return ModelFinding(use=use, finding=(
            f"shapes are not the model's (mean MAC {agreement:.2f} of {n_mode} modes), and no reversal or exchange of "
            "channels explains it: check that the model is of this structure, its sensors' places and directions, or "
            "ask `probupdate diagnose`"))
    alike = [channel_mistake(s, data.channels, [shape]) for s in blocks]
    votes = sum(a is not None and likely.candidates[0] in a.candidates for a in alike)
    return ModelFinding(use=use, finding=(f"against the model: {likely.sentence}; {votes} of {len(joint.ids)} blocks "
                                          f"show it by themselves; {_remedy(likely)}"))


def _compared_modes(
    campaign: Campaign, data: ModalData, modes: ComputedModes, measured_hz: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """The model's among those measured; None where it has not all of the campaign's channels."""
    if data.channels != campaign.channels:
        return None
    held = (modes.frequency_hz > 0) & (modes.frequency_hz < 1.1 * np.nanmax(measured_hz))
    return modes.frequency_hz[held], modes.shape[:, held]


def _remedy(likely: ChannelMistake) -> str:
    """What to change of a campaign; where the modes were written already see `ChannelMistake.remedy`."""
    first = likely.candidates[0]
    if len(first) == 1:
        return _reversed_remedy(first[0])
    if len(first) == 2:
        return (f"check the cables of {' and '.join(first)}; if they are exchanged, swap their two [[sensor]] tables "
                "in campaign.toml, which are in the order of the columns")
    return "check the order of [[sensor]] in campaign.toml against the columns of the records"


def _reversed_remedy(channel: str) -> str:
    return (f"look at {channel}, and if it is mounted the other way reverse its direction in campaign.toml and where "
            "the model reads it (its [[sensor]] in model.toml; of a model of matrices channel_sign, or its row of "
            "channel_row times -1)")


def _first_blocks(campaign: Campaign) -> Campaign:
    """The campaign with so few of its files that they hold about MOST_BLOCKS blocks."""
    n_file = len(campaign.files)
    kept = max(1, min(n_file, int(np.ceil(n_file * MOST_BLOCKS / max(len(block_starts(campaign)), 1)))))
    return replace(campaign, files=tuple(campaign.files[k] for k in np.linspace(0, n_file - 1, kept).astype(int)))


def _persistent(data: ModalData) -> ModalData:
    """The modes that stand in most blocks, in the blocks that have one of them."""
    share = np.mean([s.measured for s in data.sets], axis=0)
    kept = data.of_modes(np.flatnonzero(share >= min(PERSISTENT, share.max())).tolist())
    return replace(kept, sets=tuple(s for s in kept.sets if s.measured.any()), reference_set=None)
