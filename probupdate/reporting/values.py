"""A run directory as values: what `run_files` reads and the sections show; None for what was not there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from probupdate.estimators.posterior_file import Posterior
from probupdate.estimators.update_file import UpdateRecord
from probupdate.model import Model, Wireframe
from probupdate.modes import ModalData, Sensor
from probupdate.reporting.viewer import ShapedModes


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """A parameter in the comparison; numbers are NaN where they were not computed."""

    name: str
    unit: str
    prior_mean: float
    prior_std: float
    step: float
    anchored: float
    map: float
    mean: float
    median: float
    std: float
    low: float
    high: float
    step_distance: float
    anchored_distance: float
    map_distance: float
    contraction: float
    nine_mean: float = float("nan")
    nine_cov: float = float("nan")
    resolution: float = float("nan")
    identified: str = ""
    flags: tuple[str, ...] = ()
    sentence: str = ""


@dataclass(frozen=True, kw_only=True)
class ComparisonValues:
    rows: tuple[ComparisonRow, ...]
    summary: tuple[str, ...] = ()
    derived: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


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
    """The model and its modes at the initial and at the updated parameters (none without geometry); `labels` of the
    modes drawn, `pairs` of them that only their plane tells apart."""

    model: Model
    wire: Wireframe | None
    labels: tuple[str, ...]
    pairs: tuple[tuple[int, ...], ...]
    states: Mapping[str, ShapedModes]


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A run directory read; None for what was not there, `missing` says so in words. `warnings`: what does not fit
    together. `truth`: see campaign_values.truth_values. `jacket`: the paper's numbers may stand beside ours."""

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
    comparison: ComparisonValues | None = None
    warnings: tuple[str, ...] = ()
    jacket: bool = False
