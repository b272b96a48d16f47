"""Universal files out of a campaign and a modes.json, and modes.json out of a universal file (campaign.uff_file)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.campaign.blocks import blocks
from probupdate.campaign.reading import campaign_toml, read_campaign, read_head
from probupdate.campaign.uff_file import read_uff_modes, write_uff_modes, write_uff_records
from probupdate.errors import InputError
from probupdate.io.result_table import files_table
from probupdate.modal.modes import Sensor, read_modes, write_modes
from probupdate.runtime.progress import Progress, silent

if TYPE_CHECKING:
    import pandas as pd

SI = {"acceleration": "m/s2", "velocity": "m/s", "displacement": "m"}


@dataclass(frozen=True, kw_only=True)
class Translation:
    """files written, in order; notes: what the other format could not hold, one sentence each."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]

    def to_frame(self) -> pd.DataFrame:
        """A row a file."""
        return files_table(written=self.files)

    @property
    def summary(self) -> str:
        shown = [f"{len(self.files)} files in {self.files[0].parent}"] if len(self.files) > 1 else map(str, self.files)
        return "\n".join([f"wrote {text}" for text in shown] + [f"  {note}" for note in self.notes])


def sensors_of(place: str | Path) -> tuple[Sensor, ...]:
    """Those of a campaign's folder, or of a campaign.toml."""
    return read_head(campaign_toml(place)).sensors


def modes_from_universal(source: str | Path, out: str | Path, *, sensors: str | Path | None = None) -> Translation:
    """modes.json from datasets 55; `sensors`: the campaign whose channels they are, by the places of the nodes."""
    source, out = Path(source), Path(out)
    data = read_uff_modes(source, None if sensors is None else sensors_of(sensors))
    write_modes(data, out)
    notes = ["it has no standard deviations: state frequencies' CoVs where it is compared (--frequency-cov)"]
    if len(data.sets) > 1:
        notes.append("a column holds the modes of one number; with --description poles.toml they are followed instead")
    return Translation(files=(out,), notes=tuple(notes))


def modes_to_universal(source: str | Path, out: str | Path, *, sensors: str | Path) -> Translation:
    """Datasets 15 and 55 from modes.json, nodes where the sensors are."""
    path, notes = write_uff_modes(read_modes(source), sensors_of(sensors), Path(out))
    return Translation(files=(path,), notes=notes)


def records_to_universal(source: str | Path, out: str | Path, *, progress: Progress = silent) -> Translation:
    """A file of datasets 58 a block of a campaign, in SI units; blocks with lost samples are left out and said.

    Raises InputError where nothing is left, where the folder holds a file of the name already, or as
    `campaign.uff_file.write_uff_records` does."""
    campaign, folder = read_campaign(source), Path(out)
    chosen = tuple(replace(s, unit=SI[s.quantity]) for s in campaign.sensors)
    files, notes, total = [], [], sum(f.n_sample for f in campaign.files)
    done = 0
    for block in blocks(campaign):
        progress("writing universal files", done, total)
        done += len(block.data)
        lost = int(np.sum(~np.isfinite(block.data)))
        if lost:
            notes.append(f"block {block.id}: {lost} samples are lost, left out")
            continue
        path = folder / f"{block.id.replace(':', '').replace('-', '')}.uff"
        if path.exists():
            raise InputError(str(path), "already exists", "name a new folder")
        files.append(write_uff_records(block.data, block.sampling_rate_hz, chosen, path, start=block.start.isoformat()))
    progress("writing universal files", total, total)
    if not files:
        raise InputError(str(source), "has no block without lost samples", "see `probupdate check`")
    return Translation(files=tuple(files), notes=tuple(notes))
