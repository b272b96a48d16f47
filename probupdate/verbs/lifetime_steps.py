"""Steps from a run and its records to the lifetime: stresses of a measured campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from probupdate.campaign.reading import read_campaign
from probupdate.campaign.usable import left_out_notes
from probupdate.errors import InputError, names_files
from probupdate.modal.modes import ModalData, read_modes
from probupdate.reporting.run_files import run_places
from probupdate.runtime.progress import Progress, silent
from probupdate.verbs.finished_run import finished_run
from probupdate.verbs.models import parts_elsewhere

if TYPE_CHECKING:
    import pandas as pd

    from probupdate.lifetime.damping import StateDamping
    from probupdate.lifetime.gauges import GaugeFiles
    from probupdate.lifetime.stress_files import StressResult


@dataclass(frozen=True, eq=False, kw_only=True)
class StressStep:
    """Stresses with their figures."""

    result: StressResult

    @property
    def summary(self) -> str:
        return self.result.summary

    def to_frame(self) -> pd.DataFrame:
        """A row a hot spot, the most damaged first."""
        return self.result.to_frame()

    def write(self, out: str | Path) -> list[Path]:
        """Tables, histories and figures into a folder, new or empty. Raises InputError where it holds something."""
        from probupdate.reporting.figures_stress import stress_figures
        from probupdate.reporting.style import save_figure

        written, gauges = self.result.write(out), self.result.gauge_history()
        for name, figure, _ in stress_figures(
            self.result.spots(), self.result.blocks(), self.result.histories(),
            None if gauges is None else (self.result.found.gauges.block, gauges)):
            path = Path(out) / f"{name}.png"
            save_figure(figure, path)
            written.append(path)
        return written


@names_files("campaign", "run")
def stresses(
    campaign: str | Path, run: str | Path, fatigue: str | Path, *, without: Sequence[str] | None = None,
    gauges: str | Path | GaugeFiles | None = None, draws: int = 8, worst: int = 6, accept: bool = False, seed: int = 1,
    progress: Progress = silent, **elsewhere: str | Path | None,
) -> StressStep:
    """Stress histories, damage-equivalent ranges and damage at every hot spot of fatigue.toml, of what a campaign
    measured, through the model of a run at its posterior.

    without: channels not to be used; gauges: a CSV of stresses that strain gauges measured (`time`, hot_spot_N_mpa),
    which take no part in the estimate and are held against it, or `lifetime.gauges.GaugeFiles`, which names one of
    gauges that join the accelerations too; draws: of the posterior, for its uncertainty; worst: hot
    spots whose history is written and counted by rainflow. A run that did not converge, whose diagnosis is unexplained
    or found the structure to change, or a channel that is used to be wrong, needs `accept`. elsewhere: `model`,
    `parameters`, where these lie, if not in the run's directory, as of `report`.
    Raises InputError where the run lacks model or posterior, or no channel of the campaign is in the model.
    """
    from probupdate.diagnosis.faulty_channels import faulty_channels
    from probupdate.lifetime.export import RunStatus, refuse_without_members
    from probupdate.lifetime.gauges import GaugeFiles
    from probupdate.lifetime.measured_stress import StressSettings, measured_stresses
    from probupdate.lifetime.stress_files import StressResult

    folder = Path(run)
    given = parts_elsewhere(**elsewhere)
    # before it sends anybody to sample that model
    if "model" in (there := run_places(folder, given)):
        refuse_without_members(there["model"])
    finished = finished_run(folder, given)
    places, posterior, diagnosis = finished.places, finished.posterior, finished.diagnosis
    records = read_campaign(campaign)
    if unknown := [c for c in without or () if c not in records.channels]:
        raise InputError("--without", f"'{unknown[0]}' is not a channel of {campaign}",
                         f"choose from {', '.join(records.channels)}")
    modes = read_modes(places["modes.json"]) if "modes.json" in places else None
    status = RunStatus(converged=bool(posterior.converged), sampler=posterior.verdict,
                       diagnosis=diagnosis["verdict"] if diagnosis else None, changes=finished.changes,
                       sets=posterior.sets,
                       faults=_faults_used(faulty_channels(diagnosis or {}, records.sensors, modes.channels if modes
                                                           else ()), set(records.channels) - set(without or ())))
    if status.refused and not accept:
        raise InputError(str(folder), f"this run is not fit to be used: {status.refused}",
                         f"{status.remedy}; --accept uses it with that said")
    settings = StressSettings(n_draw=draws, n_worst=worst, seed=seed, since=finished.since)
    found = measured_stresses(
        records, places["model"], Path(fatigue), posterior.draws, _measured_damping(modes), names=posterior.names,
        without=tuple(without or ()), settings=settings,
        gauges=gauges if isinstance(gauges, GaugeFiles) else GaugeFiles(held_out=gauges), progress=progress)
    found = replace(found, left_out=(*finished.notes, *left_out_notes(records.left_out), *found.left_out))
    return StressStep(result=StressResult(found=found, remark=status.remark))


def _faults_used(faults: Mapping[str, tuple[str, ...]], used: Set[str]) -> dict[str, tuple[str, ...]]:
    """Those of channels that are used, as `RunStatus` has them."""
    return {words: () if used <= set(channels) else tuple(c for c in channels if c in used)
            for words, channels in faults.items() if used & set(channels)}


def _measured_damping(modes: ModalData | None) -> StateDamping:
    """Measured ratios, mean of all sets and of those of each state; none where no modes lie in the run."""
    from probupdate.lifetime.damping import STATES_OF, StateDamping, geometric_means

    if modes is None or modes.labels is None:
        return StateDamping.alike({})
    of = {kind: geometric_means(modes, states) for kind, states in STATES_OF.items()}
    every = geometric_means(modes)
    if not any(of.values()):
        return StateDamping.alike(every)
    return StateDamping(idling=of["idling"] or every, operating=of["operating"] or of["idling"], rotor=False)
