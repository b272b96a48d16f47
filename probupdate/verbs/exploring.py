"""The step that shows poles on a page, where modes are picked by hand: explore."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.campaign.blocks import block_starts
from probupdate.campaign.reading import Campaign, read_campaign
from probupdate.campaign.usable import remedy
from probupdate.errors import InputError, names_files
from probupdate.identification.block_store import BlockStore, start_of, stored_block, stored_ids, stored_settings
from probupdate.identification.identify import SSISettings, proposed_poles
from probupdate.identification.settings import IdentificationSettings
from probupdate.io.result_table import plural, table_of
from probupdate.modal.matching import channel_rows, with_stated_gravity
from probupdate.modal.modes import ModalData, read_modes
from probupdate.runtime.progress import Progress, silent
from probupdate.verbs.identifying import GIVEN, ssi_settings
from probupdate.verbs.models import GivenModel, has_geometry, open_model, refuse_other_value

if TYPE_CHECKING:
    import pandas as pd

    from probupdate.reporting.explore import PoleSource


@dataclass(frozen=True, kw_only=True)
class Exploration:
    """A page of poles: path, the block that it opens with, how many blocks are in it of how many; notes: what was
    assumed or is missing."""

    path: Path
    block: str
    shown: int
    blocks: int
    notes: tuple[str, ...]

    def to_frame(self) -> pd.DataFrame:
        """One row."""
        return table_of([{"file": str(self.path), "block": self.block, "shown": self.shown, "blocks": self.blocks}])

    @property
    def summary(self) -> str:
        return "\n".join([f"wrote {self.path}: {self.shown} of {plural(self.blocks, 'block')}, opens with {self.block}",
                          *self.notes])


@names_files("source")
def explore(
    source: str | Path,
    out: str | Path,
    *,
    campaign: str | Path | None = None,
    model: GivenModel | None = None,
    parameters: str | Path | None = None,
    block: str | None = None,
    settings: IdentificationSettings = GIVEN,
    progress: Progress = silent,
) -> Exploration:
    """One self-contained page of stabilisation diagrams, on which poles are picked as modes or rejected; what it saves
    is the `choice` of `identify`.

    source: a run's directory or its modes.json, whose stored poles are shown, or a campaign, of which one block (the
    first that can be used, or `block`) is identified with `settings`, or with what its record proposes. campaign: of a
    run, where it does not lie there; its sensors and records. model: its lines are drawn with the shapes. Standard
    deviations are of every pole in the block that the page opens with where the records are there, of those that stand
    for modes in others.
    """
    from probupdate.reporting.explore import write_explorer

    refuse_other_value("settings", settings, IdentificationSettings)
    source = Path(source)
    if (source / "campaign.toml").exists() or (not source.exists() and campaign is None):
        with tempfile.TemporaryDirectory() as folder:
            opened = read_campaign(source)
            found = _add_model(_identify_block(opened, Path(folder), block, settings), opened, model, parameters)
            path, shown = write_explorer(found, out, progress)
        return Exploration(path=path, block=found.first, shown=shown, blocks=len(block_starts(opened)),
                           notes=found.notes)
    if settings != GIVEN:
        raise InputError("settings", f"{source} holds poles already, with settings of their own",
                         "identify again with these, or give the campaign's folder")
    places = _run_places(source)
    at = campaign or places.get("campaign")
    opened = None if at is None else read_campaign(at)
    found = _add_model(_stored_poles(places["modes.json"], opened, block), opened, model or places.get("model"),
                        parameters or places.get("parameters"))
    path, shown = write_explorer(found, out, progress)
    return Exploration(path=path, block=found.first, shown=shown, blocks=len(found.ids), notes=found.notes)


def _run_places(source: Path) -> Mapping[str, Path]:
    from probupdate.reporting.run_files import run_places

    if source.is_file():
        return {"modes.json": source}
    places = run_places(source)
    if "modes.json" not in places:
        raise InputError(str(source), "holds neither campaign.toml nor modes.json", "give a campaign's folder, or the "
                         "directory that `identify` wrote modes.json into")
    return places


def _identify_block(campaign: Campaign, folder: Path, block: str | None, stated: IdentificationSettings) -> PoleSource:
    """The poles of one block, identified into the folder."""
    from probupdate.reporting.explore import PoleSource

    chosen, said, _ = ssi_settings([campaign], None, stated)
    store = BlockStore(folder, campaign, chosen.of_blocks)
    starts = tuple(start for start in store.starts if block is None or start == start_of(block))
    if not starts:
        raise InputError(str(campaign.path), f"has no block {block}", f"there are {store.starts[0]:%Y-%m-%dT%H:%MZ} to "
                         f"{store.starts[-1]:%Y-%m-%dT%H:%MZ}")
    reasons: list[str] = []
    while (one := store.identify_one(starts[len(reasons)])).poles is None:
        reasons.append(one.excluded)
        if len(reasons) == len(starts):
            raise InputError(str(campaign.path), f"none of {len(starts)} blocks can be used; the first: {reasons[0]}",
                             remedy(campaign))
    what = "the first that can be used" if block is None else "as asked"
    note = f"block {one.id} was identified, {what}, of {plural(len(store.starts), 'block')}"
    skipped = [f"{plural(len(reasons), 'block')} before it cannot be used; the first: {reasons[0]}"] if reasons else []
    return PoleSource(title=campaign.name, folder=folder, ids=(one.id,), first=one.id, sensors=campaign.sensors,
                      proposed=proposed_poles(one, chosen), std=store.std_of(one), notes=(note, *skipped, *said))


def _stored_poles(modes: Path, campaign: Campaign | None, block: str | None) -> PoleSource:
    """The poles that are stored beside modes.json."""
    from probupdate.reporting.explore import PoleSource
    from probupdate.reporting.run_files import POLE_COLUMNS, read_table

    folder = modes.with_name(f"{modes.name}.blocks")
    if not (folder / "store.json").is_file():
        raise InputError(str(folder), "is not there, so there are no poles to show" if not folder.exists() else
                         "holds the poles of several setups", "give the campaign's folder, or that of one setup")
    ids = stored_ids(folder)
    if not ids or (block is not None and block not in ids):
        raise InputError(str(folder), f"has no block {block} with poles" if ids else "has no block with poles",
                         f"there are {ids[0]} to {ids[-1]}" if ids else "identify again")
    data = read_modes(modes)
    first = block or (data.reference_set if data.reference_set in ids else ids[0])
    table = modes.with_name(f"{modes.stem}.poles.csv")
    std, notes = {}, []
    if campaign is None:
        notes.append("the campaign is not given: shapes are not drawn in space, and standard deviations are those of "
                     "the poles that stand for modes")
    else:
        std, said = _std_of_first(campaign, folder, data, first)
        notes += said
    return PoleSource(
        title=modes.resolve().parent.name if campaign is None else campaign.name, folder=folder, ids=ids, first=first,
        modes=data, table=read_table(table, (*POLE_COLUMNS, "order"), time="time") if table.exists() else None, std=std,
        sensors=() if campaign is None else campaign.sensors, notes=tuple(notes))


def _std_of_first(
    campaign: Campaign, folder: Path, data: ModalData, first: str
) -> tuple[dict[tuple[int, int], tuple[float, float]], list[str]]:
    """Standard deviations of all poles of the first block, from its record; none where the record is another."""
    if data.channels != campaign.channels:
        raise InputError(str(campaign.path), "has other channels than modes.json", "give the campaign that was "
                         "identified")
    store = BlockStore(folder, campaign, replace(SSISettings(), **stored_settings(folder)).of_blocks)
    one = stored_block(folder, first)
    # `first` is one of those that are stored
    assert one is not None
    if one.start not in store.starts:
        return {}, [f"the campaign has no record of block {first} any more: standard deviations are those of the poles "
                    "that stand for modes"]
    return store.std_of(one), []


def _add_model(
    found: PoleSource, campaign: Campaign | None, model: GivenModel | None, parameters: str | Path | None
) -> PoleSource:
    """With the lines of a model and its lowest modes there and at the sensors, where it has geometry and the sensors
    are known."""
    from probupdate.reporting.explore import expansion_modes

    if model is None or campaign is None:
        return found
    opened = open_model(model, parameters, campaign.sensors if has_geometry(model) else None)
    opened = with_stated_gravity(opened, {s.channel: bool(s.gravity) for s in campaign.sensors})
    theta = opened.parameters.initial
    n_mode = expansion_modes(len(campaign.sensors), opened.n_available)
    wire = opened.wireframe(theta, n_mode)
    if wire is None:
        return replace(found, notes=(*found.notes, "the model has no geometry: its lines are not drawn"))
    rows = channel_rows(opened, campaign.channels)
    return replace(found, wire=wire, at_sensors=np.real(opened.solve(theta, n_mode).shape[rows]))
