"""What the page shows of an update, a posterior and a comparison, whoever computed it: plain frozen values.

`run_files` fills them from a run directory; the sections read nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from probupdate.model import Model, Wireframe
from probupdate.modes import ModalData, Sensor
from probupdate.parameters import Parameters
from probupdate.reporting.viewer import ShapedModes


@dataclass(frozen=True, eq=False, kw_only=True)
class Scheme:
    """One reading of Eq. 7: its iterations and its end.

    theta (n_iteration + 1, n_param), objective: term -> (n_iteration + 1,), frequency_hz and mac (n_mode,) at the
    end, at_bound (n_param,) bool. `key` is "step" (as printed) or "prior" (anchored).
    """

    key: str
    name: str
    theta: np.ndarray
    objective: Mapping[str, np.ndarray]
    frequency_hz: np.ndarray
    mac: np.ndarray
    at_bound: np.ndarray
    converged: bool
    status: str
    alpha: float


@dataclass(frozen=True, eq=False, kw_only=True)
class UpdateValues:
    """modes: labels in the measured order; frequencies and MAC (n_mode,), NaN where a mode was not matched.

    pairs: positions of modes that were compared as a plane. left_out: sentences on modes that were not matched.
    """

    parameters: Parameters
    set_id: str
    labels: tuple[str, ...]
    measured_hz: np.ndarray
    measured_std_hz: np.ndarray
    initial_hz: np.ndarray
    initial_mac: np.ndarray
    schemes: tuple[Scheme, ...]
    pairs: tuple[tuple[int, ...], ...] = ()
    map_theta: np.ndarray | None = None
    computed_mode: np.ndarray | None = None
    left_out: tuple[str, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)

    def scheme(self, key: str) -> Scheme | None:
        return next((s for s in self.schemes if s.key == key), None)

    @property
    def best(self) -> Scheme:
        """The scheme whose end stands for 'the updated model': the anchored one where there is one."""
        return self.scheme("prior") or self.schemes[0]


@dataclass(frozen=True, eq=False, kw_only=True)
class PosteriorValues:
    """draws (n_draw, n_param) of all chains, thinned or not; frequency_hz (n_draw', n_mode) at some of them."""

    names: tuple[str, ...]
    draws: np.ndarray
    converged: bool
    verdict: str
    fallback: int = 0
    evaluated: int = 0
    r_hat: np.ndarray | None = None
    effective_size: np.ndarray | None = None
    frequency_hz: np.ndarray | None = None
    settings: Mapping[str, str] = field(default_factory=dict)


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
    """scada has a `time` index or column and a `state` column where the power was recorded."""

    name: str
    sensors: tuple[Sensor, ...]
    sampling_rate_hz: float
    block_minutes: float
    facts: tuple[tuple[str, str], ...]
    findings: tuple[str, ...] = ()
    scada: pd.DataFrame | None = None
    state_rule: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelValues:
    """The model at its initial and at its updated parameters; derived: name -> state -> value (pile heads)."""

    model: Model
    name: str
    wire: Wireframe | None
    states: Mapping[str, ShapedModes]
    derived: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A run directory read; None for what was not there, `missing` says so in words."""

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
    update: UpdateValues | None = None
    posterior: PosteriorValues | None = None
    comparison: ComparisonValues | None = None
    jacket: bool = False
