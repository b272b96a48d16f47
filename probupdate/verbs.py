"""The steps of the command line as functions: each reads files, returns one frozen result that can write itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.campaign.between_setups import SetupComparison, compare_setups
from probupdate.campaign.checking import CampaignCheck
from probupdate.campaign.checking import check as check_campaign
from probupdate.campaign.converting import Conversion
from probupdate.campaign.converting import convert as convert_files
from probupdate.campaign.reading import Campaign, read_campaign
from probupdate.campaign.scada import StateRule, read_scada, row_states
from probupdate.comparison import Comparison
from probupdate.comparison import compare as compare_results
from probupdate.effects.tolerances import SensorUncertainty, TurbineUncertainty
from probupdate.errors import InputError, names_files
from probupdate.estimators.discrepancy import state_model_error, stated_weights
from probupdate.estimators.posterior_file import Posterior, read_posterior, write_posterior
from probupdate.estimators.update_file import UNLIKE, UpdateRecord, read_update
from probupdate.executors import Executor, Shard
from probupdate.files import read_bytes
from probupdate.identification.block_poles import block_references
from probupdate.identification.criteria import TURBINE, preset_criteria, read_criteria
from probupdate.identification.identify import Identification, ShardOfBlocks, SSISettings
from probupdate.identification.identify import identify as identify_campaign
from probupdate.identification.identify import identify_shard as identify_campaign_shard
from probupdate.identification.proposal import propose
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.regression import COVARIATES, ModalRegression, regress_modes
from probupdate.identification.roving import Merged
from probupdate.identification.selection import CAMPAIGN, Selection
from probupdate.identification.selection import select as select_sets
from probupdate.identification.setups import identify_setups as identify_campaigns
from probupdate.mode_labels import close_pairs, mode_character
from probupdate.modes import ModalData, ModalSet, Sensor, mac, read_modes
from probupdate.problem import Weights, build_problem
from probupdate.progress import Progress, silent
from probupdate.reporting import report as write_report
from probupdate.reporting.run_files import PARTS, run_places
from probupdate.result_table import files_table
from probupdate.structure.load import REFERENCE_STATES, load_model, nacelle_angle_deg, reference_model
from probupdate.structure.own_modes import OwnModes, own_modes
from probupdate.structure.subdyn_model import is_subdyn, subdyn_sensors, turns_nacelle
from probupdate.virtual.simulation import simulate

if TYPE_CHECKING:
    import pandas as pd

    from probupdate.campaign.universal import Translation
    from probupdate.diagnosis.results import Diagnosis
    from probupdate.estimators.set_views_file import SetViews
    from probupdate.information import Information
    from probupdate.lifetime.export import Export
    from probupdate.model import Model

__all__ = ["check", "check_setups", "compare", "convert", "export", "figures", "identify", "identify_setups", "identify_shard",
           "inform", "model_modes", "open_model", "regress", "report", "sample", "select", "sets", "simulate", "update"]

# global modes looked for: first and second bending pairs and the torsion between them (the paper's first five)
MODES_OF_INTEREST = ("FA1", "SS1", "T1", "FA2", "SS2")
# computed modes searched for them
SEARCH = 24
# least motion of the sensors, beside the largest of a family of modes, of one that is the structure's and no member's
LOCAL = 0.03
# fewest parts of a block that give standard deviations: known to 40 % then
LEAST_PARTS = 4
# the paper's sampling rate after decimation
PAPER_HZ = 5.0


def model_path(model: str | Path) -> Path:
    """A file, or one of 'design', 'as_built', 'updated' for the reference turbine."""
    return reference_model(str(model)) if str(model) in REFERENCE_STATES else Path(model)


def open_model(
    model, parameters: str | Path | None = None, sensors: tuple[Sensor, ...] | None = None, *,
    nacelle_angle_deg: float = 0.0,
) -> Model:
    """A path, a name of the reference turbine's states, or a model already made (such as a FunctionModel)."""
    if not isinstance(model, str | Path):
        return model
    return load_model(model_path(model), parameters=parameters, sensors=sensors, nacelle_angle_deg=nacelle_angle_deg)


# where `inform` takes slopes
PLACES = {"initial": "the initial parameters", "map": "the maximum of the posterior"}


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """The model as it stood while a set was measured: a turbine's rotor and nacelle look where they did then."""

    model: object
    parameters: str | Path | None
    where: str

    def angle_deg(self, modal_set: ModalSet) -> float:
        """0 for models that cannot be turned."""
        return nacelle_angle_deg(modal_set.environment, f"{self.where}, set {modal_set.id}") if self.turns else 0.0

    @cached_property
    def turns(self) -> bool:
        if not _has_geometry(self.model):
            return False
        path = model_path(self.model)
        return not path.is_file() or not is_subdyn(path) or turns_nacelle(path)

    def __call__(self, modal_set: ModalSet) -> Model:
        angle = self.angle_deg(modal_set)
        if angle not in self._opened:
            opened = open_model(self.model, self.parameters, nacelle_angle_deg=angle)
            self._opened[angle] = self.with_uncertainty(opened, angle)
        return self._opened[angle]

    def with_uncertainty(self, opened: Model, angle_deg: float) -> Model:
        """The model with the sources of its error: a turbine's tolerances, and sensors' where there is no more to know."""
        if getattr(opened, "uncertainty", self) is not None:
            return opened
        path = model_path(self.model) if isinstance(self.model, str | Path) else None
        if path is not None and path.is_file() and is_subdyn(path):
            # its TOML states no tolerances of the structure
            known = SensorUncertainty(model=opened, sensors=subdyn_sensors(path))
        elif self.turns:
            known = TurbineUncertainty.of(model_path(self.model), opened, None, angle_deg)
        else:
            known = SensorUncertainty(model=opened)
        return replace(opened, uncertainty=known)

    @cached_property
    def _opened(self) -> dict[float, Model]:
        return {}

    def setting(self, modal_set: ModalSet) -> dict[str, str]:
        """What to say of it beside a result."""
        if not self.turns:
            return {}
        text = f"{self.angle_deg(modal_set):g} deg counter-clockwise of the model's x axis"
        if "nacelle_angle_deg" not in modal_set.environment:
            text = "as in the model: the set does not state where it looked"
        return {"nacelle": text}


@names_files("campaign")
def check(campaign: str | Path, *, progress: Progress = silent) -> CampaignCheck:
    """What a campaign holds, what is wrong with it, what can be done with it."""
    return check_campaign(read_campaign(campaign), progress=progress)


def check_setups(campaigns: Sequence[str | Path], *, progress: Progress = silent) -> SetupComparison:
    """Setups of one structure, a campaign folder each, with some channels in common: gains of references that differ
    between setups, or are wrong in all. What each holds alone is `check`'s."""
    paths = [Path(c) for c in campaigns]
    return compare_setups([read_campaign(path) for path in paths], setup_names(paths), progress=progress)


def setup_names(paths: Sequence[Path]) -> list[str]:
    """The folders' own names. Raises InputError where two are alike."""
    names = [path.resolve().name for path in paths]
    if len(set(names)) < len(names):
        raise InputError("setups", "two campaign folders have one name", "name each folder by its setup")
    return names


def convert(
    sources: str | Path, out: str | Path, *, to: str = "campaign", description: str | Path | None = None,
    sensors: str | Path | None = None, progress: Progress = silent,
) -> Conversion | Translation:  # fmt: skip
    """Records of other programs (CSV, Parquet, MATLAB, NumPy, UFF) into a campaign's layout, as its convert.toml says.

    to 'modes': a universal file's modes (dataset 55) into a modes.json; to 'uff': a modes.json into a universal file, or
    a campaign's blocks into a folder of them (dataset 58). `sensors`: the campaign, or campaign.toml, that says where the
    channels of a modes.json are."""
    if to == "campaign":
        return convert_files(sources, out, description=description, progress=progress)
    if to not in ("modes", "uff"):
        raise InputError("to", f"'{to}' is unknown", "choose from campaign, modes, uff")
    from probupdate.campaign.universal import modes_from_universal, modes_to_universal, records_to_universal

    if to == "modes":
        return modes_from_universal(sources, out, sensors=sensors)
    if Path(sources).is_dir():
        return records_to_universal(sources, out, progress=progress)
    if sensors is None:
        raise InputError(str(sources), "does not say where its channels are", "name the campaign (--sensors)")
    return modes_to_universal(sources, out, sensors=sensors)


@names_files("model")
def model_modes(model, count: int = 10, *, parameters: str | Path | None = None) -> OwnModes:
    """A model's own frequencies, labels and shapes; the command `modes`. `model`: a file in any form, a model, or a
    function theta -> (frequency_hz, shape) with `parameters`."""
    return own_modes(model_path(model) if isinstance(model, str | Path) else model, count, parameters=parameters)


def modes_of_interest(model: Model, sensors: tuple[Sensor, ...], lowest: int | None = None) -> ReferenceModes:
    """The model's first and second bending modes and its torsion, as seen by the sensors; or its `lowest` modes,
    whatever they are."""
    return _model_modes(model, sensors, lowest)[0]


def _model_modes(
    model: Model, sensors: tuple[Sensor, ...], lowest: int | None = None
) -> tuple[ReferenceModes, ReferenceModes | None]:
    """The modes of interest, and the others that were computed to find them."""
    solution = model.solve(model.parameters.initial, min(max(SEARCH, lowest or 0), model.n_available))
    rows = [model.channels.index(s.channel) for s in sensors]
    shape = solution.shape[rows]
    labels = _global_labels(solution.frequency_hz, shape, sensors)
    chosen = [labels.index(label) for label in MODES_OF_INTEREST if label in labels]
    if lowest is not None:
        chosen = list(range(min(lowest, len(solution.frequency_hz))))
    if not chosen:
        raise InputError(
            f"{model.name}", f"none of its lowest {SEARCH} modes is a global one at the campaign's sensors "
            f"({', '.join(labels)})", "check the sensors' positions and directions, or name how many of the "
            "lowest modes to look for (--lowest)",
        )  # fmt: skip
    seen = np.linalg.norm(shape, axis=0) > 0
    rest = [i for i in range(len(solution.frequency_hz)) if i not in chosen and seen[i]]
    return tuple(_as_reference(solution.frequency_hz, shape, labels, some) if some else None for some in (chosen, rest))


def _global_labels(frequency_hz: np.ndarray, shape: np.ndarray, sensors: tuple[Sensor, ...]) -> tuple[str, ...]:
    """Names of unit-mass shapes (n_channel, n_mode) at the sensors. A member's own mode drags the level along a little
    and would pass for a bending mode: one that moves the sensors by less than LOCAL of what the largest of its family
    does, or that has the shape of a larger one within 2 % of its frequency, is local."""
    size = np.linalg.norm(shape, axis=0)
    first = mode_character(shape, sensors).labels
    family = np.array([label.rstrip("0123456789") for label in first])
    largest = {name: size[family == name].max() for name in set(family)}
    seen = np.array([size[k] > LOCAL * largest[name] for k, name in enumerate(family)])
    near = np.abs(np.log(frequency_hz / frequency_hz[:, None])) < 0.02
    shadowed = near & (mac(shape, shape) > 0.95) & (size > size[:, None])
    own = np.flatnonzero(seen & ~shadowed.any(axis=1))
    names = dict(zip(own, mode_character(shape[:, own], sensors).labels, strict=True))
    last = sum(name.startswith("L") for name in names.values())
    for k in range(len(first)):
        if k not in names:
            last += 1
            names[k] = f"L{last}"
    return tuple(names[k] for k in range(len(first)))


def _as_reference(frequency_hz, shape, labels, chosen: list[int]) -> ReferenceModes:
    names = tuple(labels[i] for i in chosen)
    return ReferenceModes(labels=names, frequency_hz=frequency_hz[chosen], shape=shape[:, chosen],
                          pairs=close_pairs(frequency_hz[chosen], names))  # fmt: skip


@names_files("campaign")
def identify(
    campaign: str | Path,
    model=None,
    *,
    parameters: str | Path | None = None,
    lowest: int | None = None,
    order: int | None = None,
    block_rows: int | None = None,
    rate_hz: float | None = None,
    harmonics: str = "keep",
    store: str | Path | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Identification:
    """Modes of every block by SSI-cov, found in the campaign's own poles; then named by the model's modes at its
    sensors, the global ones or, for structures of other kinds, its `lowest`; others, and all without a model, have
    numbers.

    rate_hz: to which records are thinned out; with a turbine's model 5 Hz, as the paper, and order 20 with 30 block
    rows; without one all three are proposed from the record where they are not given, which the summary says.
    harmonics: 'remove' takes the rotor's out of records where its angle can be followed.
    store: folder in which the blocks' poles are kept, so that a killed run goes on (the command line keeps them beside
    its --out); jobs: processes, or an executor (`probupdate.executors`). A script that asks for several processes needs
    `if __name__ == "__main__"`.
    """
    opened = read_campaign(campaign)
    settings, said = _settings([opened], model, order=order, block_rows=block_rows, rate_hz=rate_hz,
                               harmonics=harmonics)  # fmt: skip
    reference, others = None, None
    if model is not None:
        reference, others = _reference(campaign, opened.sensors, model, parameters, lowest, settings.target_rate_hz)
    found = identify_campaign(opened, reference, others=others, settings=settings, store=store, jobs=jobs,
                              progress=progress)
    return replace(found, notes=(*said, *found.notes), summary="\n".join([found.summary, *said]))


@names_files("campaign")
def identify_shard(
    campaign: str | Path,
    shard: str | Shard,
    model=None,
    *,
    store: str | Path,
    order: int | None = None,
    block_rows: int | None = None,
    rate_hz: float | None = None,
    harmonics: str = "keep",
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> ShardOfBlocks:
    """The share of a campaign's blocks that one job of an array computes ('3/8'), into the store that all share. Run
    again when all blocks have poles, it adds their standard deviations; then `identify` with that store has nothing
    left to compute but the modes. model: for the settings of identification only."""
    opened = read_campaign(campaign)
    settings, _ = _settings([opened], model, order=order, block_rows=block_rows, rate_hz=rate_hz, harmonics=harmonics)
    share = shard if isinstance(shard, Shard) else Shard.of(shard)
    return identify_campaign_shard(opened, share, settings=settings, store=store, jobs=jobs, progress=progress)


def identify_setups(
    campaigns: Sequence[str | Path],
    model=None,
    *,
    parameters: str | Path | None = None,
    lowest: int | None = None,
    order: int | None = None,
    block_rows: int | None = None,
    rate_hz: float | None = None,
    harmonics: str = "keep",
    store: str | Path | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Merged:
    """Several setups of one structure, a campaign folder each, with some channels in common (named alike, at one
    place): its modes out of all setups' poles, each setup's part of them merged into one set of all channels. Options
    as of `identify`.

    store: folder below which each setup keeps its blocks, under its campaign folder's name.
    """
    paths = [Path(c) for c in campaigns]
    names = setup_names(paths)
    opened = [read_campaign(path) for path in paths]
    settings, said = _settings(opened, model, order=order, block_rows=block_rows, rate_hz=rate_hz, harmonics=harmonics)
    reference, others, channels = None, None, ()
    if model is not None:
        sensors = tuple({s.channel: s for c in opened for s in c.sensors}.values())
        channels = tuple(s.channel for s in sensors)
        reference, others = _reference(paths[0], sensors, model, parameters, lowest, settings.target_rate_hz)
    merged = identify_campaigns(opened, names, reference=reference, others=others, channels=channels,
                                settings=settings, store=store, jobs=jobs, progress=progress)
    return replace(merged, summary="\n".join([merged.summary, *said]))


def _is_turbine(model) -> bool:
    """Whether the paper's rate and order suit it: a model of members, not matrices or a callable."""
    return model is not None and (_has_geometry(model) or (isinstance(model, str | Path) and is_subdyn(model_path(model))))


def _settings(
    campaigns: Sequence[Campaign], model, *, order: int | None, block_rows: int | None, rate_hz: float | None,
    harmonics: str,
) -> tuple[SSISettings, list[str]]:
    """What is given; the rest as the paper, where the model is a turbine's, or as the record proposes; and what is to be
    said of that."""
    given = {"order": order, "block_rows": block_rows, "target_rate_hz": rate_hz}
    given = {name: value for name, value in given.items() if value is not None}
    said = []
    if _is_turbine(model) or len(given) == 3:
        chosen = {"target_rate_hz": PAPER_HZ} | given
    else:
        found = propose(campaigns, rate_hz=rate_hz, block_rows=block_rows)
        chosen = {"order": found.order, "block_rows": found.block_rows, "target_rate_hz": found.target_rate_hz} | given
        said.append(found.sentence)
    settings = SSISettings(**chosen, harmonics=harmonics)
    for n_channel in sorted({len(c.sensors) for c in campaigns}):
        few = block_references(n_channel, settings.of_blocks)
        if few is not None:
            said.append(f"{n_channel} channels: the past of {few} combinations of them is used, as that of all would take "
                        "more memory than is allowed; every channel has its shape")  # fmt: skip
    # a part must be longer than the lags
    parts = int(min(c.block_minutes for c in campaigns) * 60 * settings.target_rate_hz) // (2 * settings.block_rows + 1)
    if parts < settings.sub_records:
        kept = parts if parts >= LEAST_PARTS else 0
        said.append(f"blocks of {campaigns[0].block_minutes:g} min are short: standard deviations "
                    + (f"from {kept} parts of each" if kept else "cannot be estimated, longer blocks would have them"))
        settings = replace(settings, sub_records=kept)
    return settings, said


def _reference(campaign, sensors: tuple[Sensor, ...], model, parameters, lowest, rate_hz: float):
    turbine = open_model(model, parameters, sensors if _has_geometry(model) else None)
    missing = [s.channel for s in sensors if s.channel not in turbine.channels]
    if missing:
        raise InputError(
            f"{campaign}: channel {missing[0]}", f"is not a channel of the model {turbine.name}",
            "name the model's channels as the campaign's",
        )
    reference, others = _model_modes(turbine, sensors, lowest)
    highest = float(np.max(reference.frequency_hz))
    if rate_hz <= 2 * highest:
        raise InputError(
            "rate_hz",
            f"{rate_hz:g} Hz holds nothing above {0.5 * rate_hz:g} Hz, and the model's highest mode looked for is at "
            f"{highest:.3g} Hz",
            f"give more than {2.5 * highest:.2g} Hz",
        )
    return reference, others


def _has_geometry(model) -> bool:
    """Whether sensors can be placed on it: a model.toml with members, not matrices or a callable."""
    if not isinstance(model, str | Path):
        return False
    path = model_path(model)
    # what cannot be read is told by whoever reads it
    return not path.is_file() or path.suffix.lower() == ".dat" or (
        path.suffix == ".toml" and b"[matrices]" not in read_bytes(path))


@names_files("modes")
def select(
    modes: str | Path,
    *,
    scada: str | Path | None = None,
    criteria: str | Path | None = None,
    preset: str = TURBINE,
    deviations: str = CAMPAIGN,
    rated_power_kw: float | None = None,
    count: int = 9,
) -> Selection:
    """The sets an update may trust by the criteria of Table 1, and the most consistent one.

    preset: 'turbine' (Table 1) or 'structure', which asks nothing of rotor and nacelle. criteria: a TOML file with
    thresholds other than the preset's. rated_power_kw: of the turbine, for the states told
    from `scada`; without, the highest power in it. deviations: see `identification.selection.select`.
    """
    return select_sets(
        read_modes(modes), read_scada(scada) if scada else None, count=count, deviations=deviations,
        criteria=read_criteria(criteria, preset) if criteria else preset_criteria(preset),
        state_rule=StateRule(rated_power_kw=rated_power_kw),
    )


@names_files("modes")
def regress(
    modes: str | Path, *, covariates: tuple[str, ...] = COVARIATES, state: str | None = None
) -> ModalRegression:
    """How frequency and damping of every mode follow wind, rotor speed, temperature, water level and amplitude."""
    return regress_modes(read_modes(modes), covariates=covariates, state=state)


def _likelihood(
    weights: str | tuple[float, ...] | Weights, model: Model, data: ModalData, *, set_id: str | None,
    frequencies: str, shapes: str, discrepancy: float | str | None, tolerances: bool | None, progress: Progress,
) -> Weights:
    """What is compared and all that is stated of its error: one value, the same for every estimator that is given these
    arguments. discrepancy None: 'auto' with the measurement's own standard deviations, else none."""
    chosen = stated_weights(weights, data, frequencies=frequencies, shapes=shapes, tolerances=tolerances)
    if discrepancy is None:
        discrepancy = "auto" if isinstance(weights, str) and weights in ("measured", "covariance") else 0.0
    return state_model_error(model, data, weights=chosen, discrepancy=discrepancy, set_id=set_id, progress=progress)


def _modal_data(modes: str | Path | ModalData, set_id: str | None, every_mode: bool = False) -> ModalData:
    """Sets of which at least one mode was identified, as the others cannot be updated; of their modes those that are
    compared with a model."""
    whole = modes if isinstance(modes, ModalData) else read_modes(modes)
    data = whole.compared(every_mode)
    kept = tuple(s for s in data.sets if np.any(s.measured))
    if set_id is not None:
        data.set(set_id)
    if not kept:
        where = "modes" if whole is modes else str(modes)
        raise InputError(where, "no set has an identified mode", "check the identification")
    reference = data.reference_set if any(s.id == data.reference_set for s in kept) else None
    return replace(data, sets=kept, reference_set=reference)


def unmatched(modes: str | Path | ModalData, every_mode: bool = False) -> dict[str, tuple[str, ...]]:
    """What the identification said of modes and model that do not match: sentences on measured modes that are 'left
    out', and on those that are 'taken' although they look unlike the model's."""
    whole = modes if isinstance(modes, ModalData) else read_modes(modes)
    used = whole.compared(every_mode).labels
    left, taken = [], []
    for one in whole.records:
        place = f"{one.label} ({one.frequency_hz:.4g} Hz, in {one.found} of {one.blocks} blocks)"
        if not one.found or not one.match:
            continue
        if one.label in used and one.match == "unlike":
            taken.append(f"{place}: MAC {one.mac:.2f} with the model's {one.model_label}, which it looks unlike; a "
                         "parameter that bends that shape may be missing (probupdate diagnose)")  # fmt: skip
        elif one.label not in used and one.match == "none":
            left.append(f"{place}: no mode of the model is like it")
        elif one.label not in used:
            left.append(f"{place}: the model's {one.model_label} (MAC {one.mac:.2f}), not one of interest; "
                        "--every-mode takes those that are alike")  # fmt: skip
    left += [f"the model's {one.label} ({one.frequency_hz:.4g} Hz): in no block, although the excitation should show it"
             for one in whole.model_only if one.expected]  # fmt: skip
    return {"left out": tuple(left), "taken": tuple(taken)}


@names_files("modes")
def update(
    model,
    modes: str | Path | ModalData,
    *,
    parameters: str | Path | None = None,
    set_id: str | None = None,
    weights: str | tuple[float, ...] | Weights = "measured",
    frequencies: str = "hz",
    shapes: str = "plane",
    discrepancy: float | str | None = None,
    tolerances: bool | None = None,
    alpha: float | str = 1.0,
    method: str = "gauss-newton",
    iterations: int = 50,
    every_mode: bool = False,
    progress: Progress = silent,
) -> UpdateRecord:
    """The sensitivity-based Tikhonov update (Eq. 4-7) in both readings, the MAP, and the same for every set.

    `frequencies` ("hz", "log") and `shapes` ("plane", "components", "mac", "none") choose the responses; `alpha` is a
    number or one of "l-curve", "discrepancy", "evidence"; `method` solves the anchored reading. `tolerances` of
    structure, soil, rotor-nacelle assembly and sensors are marginalised; `discrepancy`: share of every frequency that
    the model may miss beside them, ten times that of shapes, or 'auto', as large as the misfit says. Both are on by
    default where `weights` are the measurement's own, "measured" or "covariance".
    every_mode: also modes that identification numbered, where they are alike to one of the model's.
    """
    from probupdate.estimators.updating import deterministic_update

    data = _modal_data(modes, set_id, every_mode)
    model_at, modal_set = _Surroundings(model, parameters, str(modes)), data.set(set_id)
    chosen = _likelihood(weights, model_at(modal_set), data, set_id=set_id, frequencies=frequencies, shapes=shapes,
                         discrepancy=discrepancy, tolerances=tolerances, progress=progress)  # fmt: skip
    record = deterministic_update(
        model_at(modal_set), data, set_id=set_id, alpha=alpha, iterations=iterations, method=method, weights=chosen,
        model_at=model_at, progress=progress,
    )
    said = unmatched(modes, every_mode)
    settings = record.settings | model_at.setting(modal_set)
    if said["taken"]:
        settings |= {UNLIKE: "; ".join(said["taken"])}
    return replace(record, settings=settings, left_out=(*record.left_out, *said["left out"]))


@names_files("modes")
def sample(
    model,
    modes: str | Path | ModalData,
    out: str | Path,
    *,
    parameters: str | Path | None = None,
    set_id: str | None = None,
    weights: str | tuple[float, ...] | Weights = "measured",
    frequencies: str = "hz",
    shapes: str = "plane",
    discrepancy: float | str | None = None,
    tolerances: bool | None = None,
    seed: int = 1,
    target_ess: int = 1000,
    max_steps: int = 20000,
    ensembles: int = 4,
    every_mode: bool = False,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Posterior:
    """Sample the posterior of the same problem into `out`; the chain is kept beside it (`<out>.chain/`) and goes on
    where it stopped. jobs: processes, or an executor, for the `ensembles`; the numbers are the same on any."""
    from probupdate.estimators.ensemble import SamplerSettings
    from probupdate.estimators.updating import sample_posterior

    data = _modal_data(modes, set_id, every_mode)
    out = Path(out)
    settings = SamplerSettings(seed=seed, target_ess=target_ess, max_steps=max_steps, ensembles=ensembles)
    model_at, modal_set = _Surroundings(model, parameters, str(modes)), data.set(set_id)
    chosen = _likelihood(weights, model_at(modal_set), data, set_id=set_id, frequencies=frequencies, shapes=shapes,
                         discrepancy=discrepancy, tolerances=tolerances, progress=progress)  # fmt: skip
    posterior = sample_posterior(
        model_at(modal_set), data, out.with_name(out.name + ".chain"), set_id=set_id, weights=chosen,
        settings=settings, jobs=jobs, progress=progress,
    )
    posterior = replace(posterior, record=posterior.record | model_at.setting(modal_set))
    write_posterior(posterior, out)
    return posterior


@names_files("update")
def compare(
    update: str | Path | UpdateRecord,
    posterior: str | Path | Posterior,
    *,
    model=None,
    parameters: str | Path | None = None,
) -> Comparison:
    """Where update and posterior part, and why. With a model, its derived quantities (pile-head stiffness) too."""
    record = update if isinstance(update, UpdateRecord) else read_update(update)
    drawn = posterior if isinstance(posterior, Posterior) else read_posterior(posterior)
    if model is None:
        return compare_results(record, drawn)
    opened = open_model(model, parameters)
    if opened.parameters.names != record.parameters.names:
        raise InputError(opened.name, "has other parameters than the update", "give the model that was updated")
    return compare_results(record, drawn, getattr(opened, "derived", None))


@names_files("modes")
def sets(
    model,
    modes: str | Path | ModalData,
    *,
    parameters: str | Path | None = None,
    weights: str | tuple[float, ...] | Weights = "measured",
    frequencies: str = "hz",
    shapes: str = "plane",
    discrepancy: float | str | None = None,
    tolerances: bool | None = None,
    correlated: bool = False,
    spread: float = 0.25,
    seed: int = 1,
    progress: Progress = silent,
) -> SetViews:
    """All sets of the file in four views side by side: scatter of their updates, posteriors pooled, one posterior for
    all, and a population with its scatter between sets; with scores of sets left out. See `estimators.set_views`."""
    from probupdate.estimators.set_views import view_sets

    data = _modal_data(modes, None)
    model_at = _Surroundings(model, parameters, str(modes))
    chosen = _likelihood(weights, model_at(data.set()), data, set_id=None, frequencies=frequencies, shapes=shapes,
                         discrepancy=discrepancy, tolerances=tolerances, progress=progress)  # fmt: skip
    return view_sets(
        model_at(data.set()), data, weights=chosen,
        model_at=model_at, correlated=correlated, spread=spread, seed=seed, progress=progress,
    )


@names_files("modes")
def inform(
    model,
    modes: str | Path | ModalData,
    *,
    parameters: str | Path | None = None,
    set_id: str | None = None,
    weights: str | tuple[float, ...] | Weights = "measured",
    frequencies: str = "hz",
    shapes: str = "plane",
    discrepancy: float | str | None = None,
    tolerances: bool | None = None,
    every: bool = False,
    at: str = "initial",
    posterior: str | Path | Posterior | None = None,
    seed: int = 1,
    progress: Progress = silent,
) -> Information:
    """Which parameters the data inform and how much, which compensate one another, whether the prior expected the data.

    `every`: all rows of a model.toml, those with update = false too. `posterior`: adds what was sampled. `at`: where
    slopes are taken, 'initial' (before anything is measured) or 'map' (the maximum of this set's posterior)."""
    from probupdate.estimators.predictive import predictive_check
    from probupdate.estimators.updating import find_maximum
    from probupdate.information import information
    from probupdate.structure.parameter_table import every_parameter

    if at not in PLACES:
        raise InputError("at", f"'{at}' is unknown", f"choose from {', '.join(PLACES)}")
    data = _modal_data(modes, set_id)
    model_at, modal_set = _Surroundings(model, parameters, str(modes)), data.set(set_id)
    chosen = _likelihood(weights, model_at(modal_set), data, set_id=set_id, frequencies=frequencies, shapes=shapes,
                         discrepancy=discrepancy, tolerances=tolerances, progress=progress)  # fmt: skip
    problem = build_problem(model_at(modal_set), data, set_id=set_id, weights=chosen)
    maximum = find_maximum(problem, [problem.parameters.initial])
    check = predictive_check(problem, maximum, seed=seed)
    found = dict(zip(problem.parameters.names, maximum.theta, strict=True))
    if every:
        if not model_at.turns:
            raise InputError(str(model), "has no parameters beside the updated ones", "leave --every out")
        angle = model_at.angle_deg(modal_set)
        whole = load_model(model_path(model), parameters=every_parameter(model_path(model)), nacelle_angle_deg=angle)
        problem = build_problem(model_at.with_uncertainty(whole, angle), data, set_id=set_id,
                                weights=replace(chosen, at=None))  # fmt: skip
    drawn = posterior if posterior is None or isinstance(posterior, Posterior) else read_posterior(posterior)
    whole = problem.parameters
    point = whole.initial if at == "initial" else [found.get(p.name, p.initial) for p in whole]
    return replace(information(problem, theta=point, place=PLACES[at], posterior=drawn), check=check)


@names_files("modes")
def diagnose(
    model,
    modes: str | Path | ModalData,
    *,
    campaign: str | Path | None = None,
    parameters: str | Path | None = None,
    seed: int = 1,
    progress: Progress = silent,
    **options,
) -> Diagnosis:
    """What the simulation, or the measurement, gets wrong: verdict, causes with place and size, what would not be seen.

    `model` None: measurement and surroundings only. `campaign` tells where the sensors are, and its raw records are
    tested too. `options`: see `diagnosis.run.diagnose_files` (own effects, groups of parameters).
    """
    from probupdate.diagnosis.blocks import gather
    from probupdate.diagnosis.run import diagnose_files

    data = modes if isinstance(modes, ModalData) else read_modes(modes)
    data = data if model is None else data.compared()
    # before a minute of preparation is spent on them
    gather(data, "modes" if isinstance(modes, ModalData) else str(modes))
    records = read_campaign(campaign) if campaign else None
    path = model_path(model) if isinstance(model, str | Path) else model
    return diagnose_files(path, data, campaign=records, parameters=parameters, seed=seed, progress=progress, **options)


@names_files("run", "run")
def export(
    run: str | Path, out: str | Path, *, to: str = "lifetime", draws: int = 100, superelement_modes: int = 10,
    accept: bool = False, seed: int = 1, fatigue: str | Path | None = None, progress: Progress = silent,
) -> Export:  # fmt: skip
    """What a lifetime-extension analysis takes of a run directory: draws, joint distribution, models, superelements and
    modes, each read back and checked. A run that did not converge, or whose diagnosis is unexplained, needs `accept`.

    fatigue: a fatigue.toml with sea and wind states, details, S-N curves and uncertainties; then damage-equivalent stress
    ranges of every hot spot and draw, model factors and reliability over the years are written too."""
    from probupdate.diagnosis.results import read_diagnosis
    from probupdate.lifetime.export import export_lifetime

    if to != "lifetime":
        raise InputError("to", f"'{to}' is unknown", "choose lifetime")
    folder = Path(run)
    places = run_places(folder)
    for name, remedy in (("model", "put model.toml or model.npz there"), ("posterior.nc", "run `probupdate sample`")):
        if name not in places:
            raise InputError(str(folder), f"has no {PARTS[name]}", remedy)
    parameters = places.get("parameters")
    found = read_diagnosis(places["diagnosis.json"]) if "diagnosis.json" in places else None
    causes = () if found is None else tuple(f"{f['cause']} {f['location']}".strip() for f in found["findings"])
    return export_lifetime(
        read_posterior(places["posterior.nc"]), load_model(places["model"], parameters=parameters), places["model"],
        Path(out), parameters_file=parameters, modes=read_modes(places["modes.json"]) if "modes.json" in places else None,
        diagnosis=None if found is None else found["verdict"], findings=causes, n_draw=draws, n_mode=superelement_modes, accept=accept, seed=seed, source=places, progress=progress,
        fatigue=None if fatigue is None else _fatigue_input(folder, places, Path(fatigue), found, progress),
    )  # fmt: skip


def _fatigue_input(folder: Path, places, fatigue: Path, diagnosis, progress: Progress):
    """The one model's problem at its maximum, as `sample` makes it with its default weights of nine.json, else modes.json;
    set-wise updates of update.json; and the diagnosis's extended model with its draws, where they are there."""
    from probupdate.estimators.laplace import maximum_a_posteriori
    from probupdate.estimators.update_file import read_update
    from probupdate.lifetime.conditions import read_conditions
    from probupdate.lifetime.export import refuse_without_members
    from probupdate.lifetime.fatigue_files import FatigueInput, Named
    from probupdate.structure.description import read_description

    # before minutes of work are spent on the rest
    read_conditions(fatigue)
    refuse_without_members(places["model"])
    problem, laplace = None, None
    modes = next((places[name] for name in ("nine.json", "modes.json") if name in places), None)
    if modes is not None:
        data = _modal_data(modes, None)
        model_at = _Surroundings(places["model"], places.get("parameters"), str(modes))
        model = model_at(data.set(None))
        weights = _likelihood("measured", model, data, set_id=None, frequencies="hz", shapes="plane", discrepancy=None,
                              tolerances=None, progress=progress)  # fmt: skip
        problem = build_problem(model, data, weights=weights)
        laplace = maximum_a_posteriori(problem, [model.parameters.initial, np.array(weights.at)] if weights.at is not None
                                       else [model.parameters.initial])  # fmt: skip
    updates = read_update(places["update.json"]).sets if "update.json" in places else None
    named = None
    extended = diagnosis and diagnosis.get("extended_model")
    if extended and (folder / extended).is_file() and not is_subdyn(places["model"]):
        path, drawn = folder / extended, folder / "diagnosis.posterior.nc"
        effects = {p.name: p.description for p in read_description(path).effects}
        own = {p.name for p in read_description(places["model"]).effects}
        causes = tuple((n, words or n) for n, words in effects.items() if n not in own)
        if drawn.is_file() and causes:
            posterior = read_posterior(drawn)
            named = Named(path=path, names=tuple(posterior.names), draws=posterior.draws, causes=causes)
    return FatigueInput(file=fatigue, problem=problem, laplace=laplace, named=named,
                        set_updates=None if updates is None else np.asarray(updates.theta_map))  # fmt: skip


@dataclass(frozen=True)
class Written:
    """A file that a step wrote."""

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def summary(self) -> str:
        return f"wrote {self.path}"

    def to_frame(self) -> pd.DataFrame:
        """One row."""
        return files_table(page=(self.path,))


def report(run: str | Path, out: str | Path, *, progress: Progress = silent) -> Written:
    """One self-contained page of a run directory."""
    return Written(write_report(run, out, progress=progress))


@dataclass(frozen=True)
class Figures:
    """Files of a folder of figures."""

    files: tuple[Path, ...]

    def to_frame(self) -> pd.DataFrame:
        """A row a file."""
        return files_table(figure=self.files[:-1], legend=self.files[-1:])

    @property
    def summary(self) -> str:
        return f"{len(self.files) - 1} figures in {self.files[0].parent}, what they show in {self.files[-1].name}"


@names_files("modes")
def figures(
    modes: str | Path, out: str | Path, *, campaign: str | Path | None = None, block: str | None = None,
    kind: str = "png",
) -> Figures:
    """Figures of an identification as files: Figs. 4-7, stabilisation of one block, maps of MAC and MPC, Argand plots,
    frequency against conditions. Poles and blocks are taken from beside modes.json, wind and rotor from the campaign.
    """
    from probupdate.reporting.identification_pictures import write_figures
    from probupdate.reporting.run_files import POLE_COLUMNS, read_table

    modes = Path(modes)
    table, scada = modes.with_name(f"{modes.stem}.poles.csv"), None
    if campaign is not None and (opened := read_campaign(campaign)).scada is not None:
        state = row_states(opened.scada, StateRule(rated_power_kw=opened.rated_power_kw))
        scada = opened.scada.tz_localize(None).reset_index().assign(state=state)
    return Figures(files=tuple(write_figures(
        modes, out, modes=read_modes(modes), scada=scada, block_id=block, kind=kind,
        poles=read_table(table, POLE_COLUMNS, time="time") if table.exists() else None)))
