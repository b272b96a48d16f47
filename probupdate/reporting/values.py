"""A run directory as values: what `run_files` reads and the sections show; None for what was not there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from probupdate.modal.modes import ModalData, Sensor
from probupdate.model.interface import Model, Wireframe
from probupdate.reporting.viewer import ShapedModes
from probupdate.updating.comparison import Comparison
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.update_file import UpdateRecord


def mode_labels(modes: ModalData) -> tuple[str, ...]:
    """Their own, or numbers where they were not named."""
    return modes.labels or tuple(f"mode {k + 1}" for k in range(modes.n_mode))


@dataclass(frozen=True, eq=False, kw_only=True)
class CampaignValues:
    """scada has a `time` column (UTC, no zone) and a `state` column where the power was recorded."""

    name: str
    sensors: tuple[Sensor, ...]
    sampling_rate_hz: float
    block_minutes: float
    water_depth_m: float | None
    facts: tuple[tuple[str, str], ...]
    findings: tuple[str, ...] = ()
    scada: pd.DataFrame | None = None
    state_rule: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelValues:
    """The model and its modes at the initial and at the updated parameters; `wire` is None without geometry, `labels`
    are those of the modes drawn, `pairs` modes of which only the plane is identified by the data."""

    model: Model
    wire: Wireframe | None
    labels: tuple[str, ...]
    pairs: tuple[tuple[int, ...], ...]
    states: Mapping[str, ShapedModes]


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A run directory read; None for what was not there, `missing` says so in words. `warnings`: what does not fit
    together. `truth`: see campaign_values.truth_values. `diagnosis`: content of diagnosis.json. `mean`: the mean of
    blocks of the diagnosis, where the update is of it. `paper`: an update with the paper's weights, for comparison.
    `jacket`: the paper's numbers may stand beside ours."""

    folder: Path
    title: str
    missing: tuple[str, ...]
    provenance: tuple[tuple[str, str], ...]
    campaign: CampaignValues | None = None
    truth: Mapping | None = None
    modes: ModalData | None = None
    poles: pd.DataFrame | None = None
    selection: pd.DataFrame | None = None
    nine: ModalData | None = None
    model: ModelValues | None = None
    update: UpdateRecord | None = None
    posterior: Posterior | None = None
    comparison: Comparison | None = None
    diagnosis: Mapping | None = None
    mean: ModalData | None = None
    paper: UpdateRecord | None = None
    warnings: tuple[str, ...] = ()
    jacket: bool = False

    @property
    def compared(self) -> ModalData | None:
        """The sets that the update is of, or that one would take."""
        return self.mean or self.nine or self.modes

    @property
    def paper_comparable(self) -> bool:
        """Whether the paper's numbers stand beside the update's: where an update with the paper's weights is there,
        they stand beside that."""
        return self.jacket and self.paper is None

    @property
    def included(self) -> bool:
        """Whether the updated model and its data have all findings of the diagnosis in them."""
        if self.diagnosis is None or self.update is None or not self.diagnosis["findings"]:
            return False
        added = (self.diagnosis.get("extension") or {}).get("added", ())
        named = [one["parameter"] for one in added if one["as"] == "parameter"]
        return bool(added) and self.mean is not None and set(named) <= set(self.update.parameters.names)
