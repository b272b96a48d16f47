"""Steps from records to modal sets: identify, select, regress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from probupdate.campaign.checking import suspected_clocks, suspected_time
from probupdate.campaign.reading import Campaign, read_campaign
from probupdate.campaign.scada import StateRule, read_scada
from probupdate.campaign.usable import lacking_notes, left_out_notes
from probupdate.errors import InputError, names_files
from probupdate.identification.block_poles import block_references
from probupdate.identification.criteria import TURBINE, preset_criteria, read_criteria
from probupdate.identification.hand_picked import opened_choice
from probupdate.identification.identify import Identification, ShardOfBlocks, SSISettings
from probupdate.identification.identify import identify as identify_campaign
from probupdate.identification.identify import identify_shard as identify_campaign_shard
from probupdate.identification.proposal import SAME_PEAK, propose
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.regression import COVARIATES, ModalRegression, regress_modes
from probupdate.identification.roving import MergedModes
from probupdate.identification.selection import CAMPAIGN, Selection, sets_between
from probupdate.identification.selection import select as select_sets
from probupdate.identification.settings import IdentificationSettings
from probupdate.identification.setups import identify_setups as identify_campaigns
from probupdate.modal.conditions import of_turbine
from probupdate.modal.labels import NEUTRAL
from probupdate.modal.labels import TURBINE as TURBINE_LABELS
from probupdate.modal.matching import PAIR_GAP, with_stated_gravity
from probupdate.modal.mode_choice import ModeChoice
from probupdate.modal.modes import ModalData, Sensor, read_modes
from probupdate.runtime.executors import Executor, Shard
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.affine import AffineModel
from probupdate.structure.matrices import channel_places
from probupdate.structure.own_modes import model_doubts
from probupdate.structure.plausible_size import implausible_extent, other_unit_words
from probupdate.structure.subdyn_model import turns_nacelle
from probupdate.verbs.models import (
    GivenModel,
    channels_of_model,
    has_geometry,
    model_path,
    open_model,
    refuse_other_value,
)
from probupdate.verbs.records import setup_names
from probupdate.verbs.sought import SoughtModes, reference_modes

# what the steps below are given where nothing is stated
GIVEN = IdentificationSettings()
# fewest parts of a block that give standard deviations: known to 40 % then
LEAST_PARTS = 4
# cosine of the angle between directions that are one: sensors are mounted to a few degrees
ALONG = 0.98
# share of a model's size, and metres at least, from which a sensor sits elsewhere than the node that is read
ELSEWHERE, LEAST_M = 0.05, 1.0
# the paper's sampling rate after decimation
PAPER_HZ = 5.0
# model's frequencies over the record's where units of stiffness and mass do not belong together, and how near that is
OTHER_UNITS = {
    1000**0.5: "mass in t beside N and m, which ask for kg", 1000**-0.5: "mass in kg beside kN and m, which ask for t",
    1000.0: "moduli in N/m2 beside mm", 0.001: "moduli in N/mm2 beside m"}
NEAR_FACTOR = 0.35
# periods of a mode of 1 % damping in which its damping ratio is at best known to its own size, 1 / sqrt(2 pi zeta n)
# (Au 2014, Uncertainty law in ambient modal identification): its frequency then to its half-power bandwidth
FEW_PERIODS = 16
TOO_FEW = "too few periods"
SETTING_WORDS = {"order": "order", "block_rows": "block rows", "target_rate_hz": "rate"}


@names_files("campaign")
def identify(
    campaign: str | Path,
    model: GivenModel | None = None,
    *,
    parameters: str | Path | None = None,
    lowest: int | None = None,
    settings: IdentificationSettings = GIVEN,
    choice: str | Path | ModeChoice | None = None,
    store: str | Path | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> Identification:
    """Modes of every block by SSI-cov, found in the campaign's own poles; then named by the model's modes at its
    sensors, the global ones or, for structures of other kinds, its `lowest`; others, and all without a model, have
    numbers.

    settings: what of order, block rows and sampling rate is not given is as in the paper with a turbine's model, and
    without one proposed from the record, which the summary says. choice: poles picked by hand in a page of `explore`:
    they are the modes then, and its settings those that are not given.
    store: folder in which the blocks' poles are kept, so that a killed run goes on (the command line keeps them beside
    its --out); jobs: processes, or an executor (`probupdate.runtime.executors`). A script that asks for several
    processes needs `if __name__ == "__main__"`.
    """
    opened = read_campaign(campaign)
    sought = reference_at([opened], model, where=campaign, parameters=parameters, lowest=lowest)
    if choice is None:
        chosen, said, peaks = ssi_settings([opened], model, settings, sought.modes)
    else:
        chosen, said, peaks = _choice_settings(choice, settings), [], ()
    found = identify_campaign(opened, sought.modes, others=sought.others, settings=chosen, choice=choice, store=store,
                              jobs=jobs, progress=progress)
    said = [*sought.lowest_note(found.data.records), *sought.notes, *said, *unexplained_peaks(peaks, found.data),
            *left_out_notes(opened.left_out),
            *suspected_time(opened), *suspected_clocks(opened)]
    return replace(found, notes=(*said, *found.notes), summary="\n".join([found.summary, *said]))


@names_files("campaign")
def identify_shard(
    campaign: str | Path,
    shard: str | Shard,
    model: GivenModel | None = None,
    *,
    parameters: str | Path | None = None,
    lowest: int | None = None,
    store: str | Path,
    settings: IdentificationSettings = GIVEN,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> ShardOfBlocks:
    """The share of a campaign's blocks that one job of an array computes ('3/8'), into the store that all share. Run
    again when all blocks have poles, it adds their standard deviations; then `identify` with that store has nothing
    left to compute but the modes. model, parameters, lowest: for the settings of identification only, as there."""
    opened = read_campaign(campaign)
    sought = reference_at([opened], model, where=campaign, parameters=parameters, lowest=lowest)
    chosen, *_ = ssi_settings([opened], model, settings, sought.modes)
    share = shard if isinstance(shard, Shard) else Shard.parse(shard)
    return identify_campaign_shard(opened, share, settings=chosen, store=store, jobs=jobs, progress=progress)


def identify_setups(
    campaigns: Sequence[str | Path],
    model: GivenModel | None = None,
    *,
    parameters: str | Path | None = None,
    lowest: int | None = None,
    settings: IdentificationSettings = GIVEN,
    store: str | Path | None = None,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> MergedModes:
    """Several setups of one structure, a campaign folder each, with some channels in common (named alike, at one
    place): its modes out of all setups' poles, each setup's part of them merged into one set of all channels. Options
    as of `identify`.

    store: folder below which each setup keeps its blocks, under its campaign folder's name.
    """
    paths = [Path(c) for c in campaigns]
    names = setup_names(paths)
    opened = [read_campaign(path) for path in paths]
    sought = reference_at(opened, model, where=paths[0], parameters=parameters, lowest=lowest)
    chosen, said, peaks = ssi_settings(opened, model, settings, sought.modes)
    channels = () if model is None else tuple(s.channel for s in sensors_of(opened))
    merged = identify_campaigns(opened, names, reference=sought.modes, others=sought.others, channels=channels,
                                settings=chosen, store=store, jobs=jobs, progress=progress)
    own = [f"{name}: {text}" for name, one in zip(names, opened, strict=True)
           for text in (*left_out_notes(one.left_out), *suspected_time(one), *suspected_clocks(one))]
    return replace(merged, summary="\n".join([merged.summary, *sought.lowest_note(merged.data.records),
                                                         *sought.notes, *said,
                                                         *unexplained_peaks(peaks, merged.data), *own]))


def ssi_settings(
    campaigns: Sequence[Campaign], model: GivenModel | None, stated: IdentificationSettings,
    reference: ReferenceModes | None = None,
) -> tuple[SSISettings, list[str], tuple[float, ...]]:
    """What is given; the rest as the paper, where the model has members, the paper's rate holds the modes that are
    looked for and the records hold that rate, or as the record proposes; what is to be said of that; and the peaks, in
    Hz, that were proposed for. Raises InputError where the rate holds not all modes of `reference`, which are looked
    for."""
    refuse_other_value("settings", stated, IdentificationSettings)
    given = {"order": stated.order, "block_rows": stated.block_rows, "target_rate_hz": stated.rate_hz}
    given = {name: value for name, value in given.items() if value is not None}
    said, units, peaks = [], "", ()
    highest = 0.0 if reference is None else float(np.max(reference.frequency_hz))
    recorded = min(c.sampling_rate_hz for c in campaigns)
    few = _few_periods_note(min(c.block_minutes for c in campaigns), reference)
    said += [f"{TOO_FEW}: {'; '.join(few)}"] if few else []
    if len(given) == 3 or has_geometry(model) and 2 * highest < PAPER_HZ <= recorded:
        chosen = {"target_rate_hz": PAPER_HZ} | given
    else:
        try:
            found = propose(campaigns, rate_hz=stated.rate_hz, block_rows=stated.block_rows, up_to_hz=highest)
        except InputError as error:
            raise InputError(error.where, f"{error.problem}; {few[0]}", few[1]) if few else error from None
        found = replace(found, **given)
        chosen = {"order": found.order, "block_rows": found.block_rows, "target_rate_hz": found.target_rate_hz}
        stated_words = " and ".join(words for name, words in SETTING_WORDS.items() if name in given)
        said.append(found.sentence + (f"; {stated_words} as stated" if given else ""))
        peaks = found.usual_hz
        units = "" if reference is None else _unit_question(reference, found.peaks_hz[0])
        said += [f"suspect: {units}"] if units else []
    settings = replace(SSISettings(harmonics=stated.harmonics), **chosen)
    _refuse_slow(settings.target_rate_hz, highest, recorded, units)
    for n_channel in sorted({len(c.sensors) for c in campaigns}):
        few = block_references(n_channel, settings.of_blocks)
        if few is not None:
            said.append(f"{n_channel} channels: the past of {few} combinations of them is used, as that of all would "
                        "take more memory than is allowed; every channel has its shape")
    # a part must be longer than the lags
    parts = int(min(c.block_minutes for c in campaigns) * 60 * settings.target_rate_hz) // (2 * settings.block_rows + 1)
    if parts < settings.sub_records:
        kept = parts if parts >= LEAST_PARTS else 0
        said.append(f"blocks of {campaigns[0].block_minutes:g} min are short: standard deviations "
                    + (f"from {kept} parts of each" if kept else "cannot be estimated, longer blocks would have them"))
        settings = replace(settings, sub_records=kept)
    return settings, said, peaks


def unexplained_peaks(peaks_hz: Sequence[float], data: ModalData) -> list[str]:
    """A sentence where peaks of most blocks' spectra that the settings were proposed for have no mode near them."""
    known = np.concatenate([s.frequency_hz[s.measured] for s in data.sets]) if data.sets else np.empty(0)
    alone = [f for f in peaks_hz if not np.any(np.abs(np.log(known / f)) < SAME_PEAK)]
    if not alone:
        return []
    ratios = [np.log(known / f) for f in alone]
    # of two modes as near as a close pair's the weaker singular value peaks where their spectra cross
    crossing = [bool(np.any((x > 0) & (x < PAIR_GAP)) and np.any((x < 0) & (x > -PAIR_GAP))) for x in ratios]
    said = []
    for between, what in ((False, "a weak mode, or what excites the structure"),
                          (True, "a weak mode, or where the spectra of the two modes beside it cross")):
        own = [f for f, x in zip(alone, crossing, strict=True) if x is between]
        if own:
            said.append(f"no mode was found at the spectrum's peak{'s' * (len(own) > 1)} at "
                        f"{', '.join(f'{f:.3g}' for f in own)} Hz: {what}; look at its shape with `probupdate explore`")
    return said


def _choice_settings(choice: str | Path | ModeChoice, stated: IdentificationSettings) -> SSISettings:
    """The settings that a choice was made with. Raises InputError where others are stated."""
    opened, where = opened_choice(choice)
    made, low = opened.settings, min(pole.order for pole in (*opened.picked, *opened.rejected))
    for name, value, own in (("order", stated.order, made.order), ("block rows", stated.block_rows, made.block_rows),
                             ("rate", stated.rate_hz, made.target_rate_hz),
                             ("harmonics", stated.harmonics if stated.harmonics != GIVEN.harmonics else None,
                              made.harmonics)):
        if value is not None and value != own:
            raise InputError(where, f"was made with {name} {own}, and {value} is stated",
                             "leave the option out, or choose again in a page that `probupdate explore` writes with it")
    # poles of low orders can be picked too
    return SSISettings(**asdict(made), below=max(SSISettings.below, made.order - low))


def families_of(campaigns: Sequence[Campaign], model: GivenModel | None) -> tuple[str, ...]:
    """What bending is called: fore-aft and side-side of a turbine, by its model or by what was recorded of it."""
    recorded = any(c.scada is not None and of_turbine(c.scada.columns) for c in campaigns)
    if recorded:
        return TURBINE_LABELS
    path = model_path(model) if has_geometry(model) else None
    return TURBINE_LABELS if path is not None and (not path.is_file() or turns_nacelle(path)) else NEUTRAL


def sensors_of(campaigns: Sequence[Campaign]) -> tuple[Sensor, ...]:
    """Of all setups; of a channel that several have, the last one's."""
    return tuple({s.channel: s for c in campaigns for s in c.sensors}.values())


def reference_at(
    campaigns: Sequence[Campaign], model: GivenModel | None, *, where: str | Path,
    parameters: str | Path | None = None, lowest: int | None = None,
) -> SoughtModes:
    """The model's modes that are looked for, at all sensors, and its others; none without a model. Raises InputError
    where the model has not all channels; `where`: the campaign's path."""
    sensors = sensors_of(campaigns)
    if model is None:
        if lowest is not None:
            raise InputError("lowest", f"asks for {lowest} modes of a model, and no model is given",
                             "give --model, or leave it out")
        return SoughtModes(modes=None, others=None, notes=implausible_places(sensors))
    turbine = open_model(model, parameters, sensors if has_geometry(model) else None)
    turbine = with_stated_gravity(turbine, {s.channel: bool(s.gravity) for s in sensors})
    missing = [s.channel for s in sensors if s.channel not in turbine.channels]
    if missing:
        raise InputError(
            f"{where}: channel {missing[0]}", f"is not a channel of the model '{turbine.name}'",
            "name the model's channels as the campaign's",
        )
    far = implausible_places(sensors)
    if not has_geometry(model) and isinstance(turbine, AffineModel):
        _refuse_other_directions(str(where), turbine, sensors)
        far = _distance_statements(turbine, sensors) or far
    found = reference_modes(turbine, sensors, lowest, families_of(campaigns, model))
    computed = [one.frequency_hz for one in (found.modes, found.others) if one is not None]
    lowest_first = np.sort(np.hstack(computed))
    odd = [f"suspect: the model {turbine.name} is {text}" for text in model_doubts(turbine, lowest_first)]
    lacking = lacking_notes(channels_of_model(model, turbine), campaigns)
    return replace(found, notes=(*odd, *far, *lacking, *found.notes))


def implausible_places(sensors: Sequence[Sensor]) -> tuple[str, ...]:
    """A sentence where sensors' places lie farther apart than structures are long."""
    extent = np.ptp([s.position_m for s in sensors], axis=0)
    said = implausible_extent(float(extent.max()), float(extent[2]))
    top = max(sensors, key=lambda s: float(np.abs(s.position_m).max())).channel
    return (f"suspect: {said}, and position_m in campaign.toml states it, as of {top}: in mm? state metres",
            ) if said else ()


def _distance_statements(model: AffineModel, sensors: Sequence[Sensor]) -> tuple[str, ...]:
    """A sentence where channels sit far from what the model of matrices reads; another origin of axes is none."""
    places = {s.channel: s.position_m for s in channel_places(model)}
    known = [s for s in sensors if s.channel in places]
    if model.wire is None or not known:
        return ()
    stated, own = (np.array(at) for at in zip(*((s.position_m, places[s.channel]) for s in known), strict=True))

    def distances(factor: float) -> np.ndarray:
        away = factor * stated - own
        return np.linalg.norm(away - np.median(away, axis=0) if len(away) > 2 else away, axis=1)

    near = max(ELSEWHERE * float(np.ptp(np.asarray(model.wire.node_m), axis=0).max()), LEAST_M)
    if scaled := other_unit_words(distances, near):
        return (f"suspect: {scaled} (position_m in campaign.toml, node_position_m of {model.name})",)
    far = [f"{s.channel} ({d:.1f} m)" for s, d in zip(known, distances(1.0), strict=True) if d > near]
    return (f"suspect: {', '.join(far)} by position_m so far from the nodes that {model.name} reads: check position_m "
            "in campaign.toml, and channel_dof or channel_row of the model",) if far else ()


def _refuse_other_directions(where: str, model: AffineModel, sensors: Sequence[Sensor]) -> None:
    """A model of matrices reads a row with a sign, whatever campaign.toml says of the channel: both must say the
    same."""
    known = {s.channel: s.direction for s in channel_places(model)}
    for sensor in sensors:
        own = known.get(sensor.channel)
        if own is None or float(own @ sensor.direction) > ALONG:
            continue
        opposite = float(own @ sensor.direction) < -ALONG
        raise InputError(
            f"{where}: channel {sensor.channel}", f"points along {sensor.direction.tolist()} in campaign.toml, and "
            f"{model.name} reads it along {own.tolist()}",
            "reverse the one that is wrong: direction in campaign.toml, or channel_sign in the model's archive (its "
            "row of channel_row times -1)"
            if opposite else "correct direction in campaign.toml, or channel_dof in the model's archive (channel_row "
            "for an oblique sensor)")


def _few_periods_note(block_minutes: float, reference: ReferenceModes | None) -> tuple[str, ...]:
    """What is too short, and what to give; () where a block holds enough of the model's lowest mode."""
    lowest = np.inf if reference is None else float(np.min(reference.frequency_hz))
    periods = 60 * block_minutes * lowest
    if periods >= FEW_PERIODS:
        return ()
    return (f"blocks of {block_minutes:g} min hold {periods:.2g} periods of the model's lowest mode ({lowest:.3g} Hz), "
            f"and fewer than {FEW_PERIODS} of ambient vibration do not show its damping ratio",
            f"give a block_minutes of {np.ceil(FEW_PERIODS / lowest / 60):.0f} or more in campaign.toml, of recordings "
            "as long, or check the model's units")


def _unit_question(reference: ReferenceModes, lowest_hz: float) -> str:
    """What to ask of units where the model's lowest mode is so many times the record's."""
    own = float(np.min(reference.frequency_hz))
    for factor, words in OTHER_UNITS.items():
        if abs(np.log(own / lowest_hz / factor)) < NEAR_FACTOR:
            return (f"the model's lowest mode is at {own:.3g} Hz and the record's at {lowest_hz:.3g} Hz, as of "
                    f"{words}: check the units of the model's matrices")
    return ""


def _refuse_slow(rate_hz: float, highest_hz: float, recorded_hz: float, units: str) -> None:
    """A rate that does not hold the modes that are looked for; `units`: what may be wrong with the model's."""
    if rate_hz <= 2 * highest_hz:
        slow = recorded_hz <= 2 * highest_hz
        raise InputError(
            "rate_hz",
            f"a rate of {rate_hz:g} Hz shows nothing above {0.5 * rate_hz:g} Hz, and the model's highest mode looked "
            f"for is at {highest_hz:.3g} Hz",
            units or f"the record has {recorded_hz:g} Hz: look for fewer modes (--lowest)" if slow
            else f"give more than {min(2.5 * highest_hz, recorded_hz):.2g} Hz",
        )


@names_files("modes")
def select(
    modes: str | Path,
    *,
    scada: str | Path | None = None,
    criteria: str | Path | None = None,
    preset: str = TURBINE,
    std_from: str = CAMPAIGN,
    rated_power_kw: float | None = None,
    count: int = 9,
    since: str | None = None,
    before: str | None = None,
) -> Selection:
    """The sets an update may trust by the criteria of Table 1, and the most consistent one.

    preset: 'turbine' (Table 1) or 'structure', which asks nothing of rotor and nacelle. criteria: a TOML file with
    thresholds other than the preset's. rated_power_kw: of the turbine, for the states derived from `scada`; without,
    the highest power in it. std_from: see `identification.selection.select`. since, before: of the sets that begin at
    that time (UTC, ISO 8601) or later, and before that one, as of one state of two.
    """
    from probupdate.updating.joint_set import states_words
    from probupdate.updating.update_file import STATES_ADVICE

    data = sets_between(read_modes(modes), since, before)
    chosen = select_sets(
        data, read_scada(scada, rated_power_kw=rated_power_kw) if scada else None,
        count=count, std_from=std_from,
        criteria=read_criteria(criteria, preset) if criteria else preset_criteria(preset),
        state_rule=StateRule(rated_power_kw=rated_power_kw),
    )
    passed = [s for s, failed in zip(data.sets, chosen.table["criterion"], strict=True) if not failed]
    states = states_words(replace(data, sets=tuple(passed), reference_set=None), [s.id for s in chosen.data.sets])
    if not states:
        return chosen
    states = f"TWO STATES: {states}. {STATES_ADVICE}"
    return replace(chosen, notes=(states, *chosen.notes), summary=f"{states}\n{chosen.summary}")


@names_files("modes")
def regress(
    modes: str | Path, *, covariates: tuple[str, ...] = COVARIATES, state: str | None = None
) -> ModalRegression:
    """How frequency and damping of every mode follow wind, rotor speed, temperature, water level and amplitude."""
    return regress_modes(read_modes(modes), covariates=covariates, state=state)
