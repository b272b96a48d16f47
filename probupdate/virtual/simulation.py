"""`simulate`: a virtual turbine, measured as the paper's was; every hour depends on the seed and its number only."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import is_empty_folder, read_text, write_table, write_text
from probupdate.io.result_table import table_of
from probupdate.modal.labels import mode_character
from probupdate.modal.modes import Sensor
from probupdate.runtime.executors import Executor, iterate_completed
from probupdate.runtime.progress import Progress, silent
from probupdate.virtual import campaign_files, losses, operation
from probupdate.virtual.dynamics import N_MODE, HeadingModes
from probupdate.virtual.effects import refuse_late
from probupdate.virtual.hours import RATE_HZ, Turbine, hour_of_data, make_turbine
from probupdate.virtual.observation import rotation
from probupdate.virtual.scada import scada_table
from probupdate.virtual.truth import GivenTruth, draw_truth, read_truth
from probupdate.virtual.turbine_file import TurbineFile, read_turbine, reference_file

if TYPE_CHECKING:
    import pandas
    import pandas as pd

BLOCK_MINUTES = 30
START = np.datetime64("2019-06-01T00:00:00")
# hours that a process is given at a time
PART = 6
REFERENCE_STATES = ("design", "as_built", "updated")
# ten years of ten-minute rows fit in memory, and nobody waits for more
LONGEST_DAYS = 3660.0


@dataclass(frozen=True, eq=False, kw_only=True)
class VirtualCampaign:
    """A written campaign: where it is, how much of it there is, and what is true of its turbine at the prevailing
    heading. `quiet_blocks`: half hours that are idling without yaw or pitch event and without a missing hour."""

    path: Path
    truth_path: Path
    n_file: int
    hours: float
    quiet_blocks: int
    blocks: int
    state_share: dict[str, float]
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    seed: int

    def to_frame(self) -> pd.DataFrame:
        """A row a true mode at the prevailing heading."""
        return table_of([{"mode": k, "frequency_hz": f, "damping_ratio": z} for k, (f, z) in
                         enumerate(zip(self.frequency_hz, self.damping_ratio, strict=True), 1)])

    @property
    def summary(self) -> str:
        shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in self.state_share.items())
        lowest = ", ".join(f"{f:.3f}" for f in self.frequency_hz[:5])
        return (
            f"virtual campaign in {self.path}: {self.hours:g} h in {self.n_file} files, {shares}\n"
            f"  {self.quiet_blocks} of {self.blocks} half-hour blocks idle without yawing or pitching\n"
            f"  true frequencies (lowest five) {lowest} Hz; what was drawn is in {self.truth_path.name}, "
            f"seed {self.seed}"
        )


def simulate(
    out: str | Path,
    *,
    model: str | Path | None = None,
    days: float = 1.0,
    truth: str | Path | None = None,
    seed: int,
    jobs: int | Executor = 1,
    progress: Progress = silent,
) -> VirtualCampaign:
    """Write a campaign of `days` into the folder `out`: campaign.toml, scada.csv, acceleration/*.h5, truth.toml.

    model: a model.toml with a geometry, or "design", "as_built", "updated" for the reference turbine (None:
    updated). truth: a truth.toml that gives parameters, their source, tolerances' scale, operation and effects;
    None builds the model's initial values with drawn tolerances. The same seed gives the same bytes. A run that
    was interrupted is taken up where it stopped if everything else is equal; another campaign in `out` is refused.
    jobs: processes that share the hours, or an executor; the bytes are the same on any.
    """
    recipe = _recipe(model, days, truth, seed)
    drawn = _draw(recipe)
    turbine, plan = drawn.turbine, drawn.turbine.plan
    missing = {int(g.start_s // 3600) for g in drawn.gaps if g.kind == losses.MISSING_HOUR}
    quiet = plan.quiet_blocks()
    for hour in missing:
        quiet[2 * hour : 2 * hour + 2] = False

    folder = Path(out)
    _write_head(folder, recipe, drawn, quiet)
    hours = [hour for hour in range(-(-recipe.n_slot // 6)) if hour not in missing]
    _write_missing(folder, recipe, drawn, hours, jobs, progress)
    count = Counter(plan.state.tolist())
    prevailing = turbine.modes(_prevailing_direction(plan))
    return VirtualCampaign(
        path=folder, truth_path=folder / "truth.toml", n_file=len(hours), hours=recipe.n_slot / 6,
        quiet_blocks=int(quiet.sum()), blocks=len(quiet),
        state_share={name: count[k] / recipe.n_slot for k, name in enumerate(operation.STATES)},
        frequency_hz=prevailing.frequency_hz, damping_ratio=prevailing.damping_ratio["idling"], seed=recipe.seed,
    )


@dataclass(frozen=True, kw_only=True)
class _Recipe:
    """What a virtual turbine follows from: enough for another process to make the same one."""

    model: str
    truth: str | None
    n_slot: int
    seed: int

    def stream(self, number: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed, spawn_key=(0,)).spawn(4)[number]


def _recipe(model: str | Path | None, days: float, truth: str | Path | None, seed: int) -> _Recipe:
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError("seed", f"{seed!r} is not a whole number from 0", "give one, such as 1")
    n_slot = n_slots(days)
    model = reference_file() if model is None else model
    if str(model) in REFERENCE_STATES:
        model = reference_file().with_name(f"{model}.toml")
    return _Recipe(model=str(model), truth=None if truth is None else str(truth), n_slot=n_slot, seed=int(seed))


def n_slots(days: float) -> int:
    """The ten minutes of a campaign. Raises InputError where there are too many or no half hour."""
    if days > LONGEST_DAYS:
        raise InputError("days", f"{days:g} is more than {LONGEST_DAYS:g}", "give less; a month is 30")
    n_slot = round(days * 144) if np.isfinite(days) else 0
    if n_slot < operation.SLOTS_PER_BLOCK:
        raise InputError("days", f"{days} is shorter than one block of 30 minutes", "give at least 0.021")
    return n_slot


@dataclass(frozen=True, eq=False, kw_only=True)
class _DrawnTurbine:
    given: GivenTruth
    turbine: Turbine
    gaps: tuple[losses.Gap, ...]
    channels: tuple[str, ...]


def _draw(recipe: _Recipe) -> _DrawnTurbine:
    file = read_turbine(recipe.model)
    given = read_truth(recipe.truth, file)
    drawn = draw_truth(given, file, np.random.default_rng(recipe.stream(0)), N_MODE)
    refuse_late(drawn.effects, recipe.n_slot / 6, "truth" if recipe.truth is None else recipe.truth)
    plan = operation.make_plan(recipe.n_slot, given.operation, np.random.default_rng(recipe.stream(1)))
    channels = tuple(s.channel for s in file.sensors)
    gaps = losses.draw_gaps(plan, channels, given.operation, np.random.default_rng(recipe.stream(2)))
    turbine = make_turbine(file, drawn, plan, recipe.seed)
    return _DrawnTurbine(given=given, turbine=turbine, gaps=gaps, channels=channels)


def _write_head(folder: Path, recipe: _Recipe, drawn: _DrawnTurbine, quiet: np.ndarray) -> None:
    """What a campaign's folder holds beside its records: truth.toml, by which it is claimed, campaign.toml,
    scada.csv."""
    turbine, file = drawn.turbine, drawn.turbine.file
    text = "# What is true of this virtual campaign, and everything that was drawn for it.\n"
    text += campaign_files.toml_text(_record(turbine, drawn.given, drawn.gaps, quiet))
    _claim(folder, text)
    campaign_files.write_campaign_toml(
        folder, name=f"Virtual campaign on '{file.value('name')}'", sensors=file.sensors, rate_hz=RATE_HZ,
        block_minutes=BLOCK_MINUTES, water_depth_m=-file.number("site", "mudline_m"),
    )
    table = reported_heading(scada_table(turbine.plan, START, np.random.default_rng(recipe.stream(3))), turbine)
    lost_rows = {int(g.start_s // 600) for g in drawn.gaps if g.kind == losses.LOST_ROW}
    write_table(folder / "scada.csv", table.drop(index=sorted(lost_rows)), float_format=None)


def _write_missing(
    folder: Path, recipe: _Recipe, drawn: _DrawnTurbine, hours: list[int], jobs: int | Executor, progress: Progress
) -> None:
    """The files of those hours that no earlier run has written."""
    todo = [hour for hour in hours if not _hour_path(folder, hour).exists()]
    done = len(hours) - len(todo)
    progress("simulating hours", done, len(hours))
    if jobs == 1:
        for hour in todo:
            done += _write_hours(drawn, folder, (hour,))
            progress("simulating hours", done, len(hours))
        return
    parts = [(recipe, folder, tuple(todo[k : k + PART])) for k in range(0, len(todo), PART)]
    for written in iterate_completed(_write_part, parts, jobs=jobs, least=1):
        done += written
        progress("simulating hours", done, len(hours))


def _hour_path(folder: Path, hour: int) -> Path:
    start = START + np.timedelta64(3600 * hour, "s")
    return folder / "acceleration" / f"{str(start).replace(':', '').replace('-', '')}Z.h5"


def _write_hours(drawn: _DrawnTurbine, folder: Path, hours: tuple[int, ...]) -> int:
    """The files of these hours; returns how many."""
    for hour in hours:
        data = hour_of_data(drawn.turbine, drawn.gaps, drawn.channels, hour)
        campaign_files.write_acceleration(
            _hour_path(folder, hour), data, START + np.timedelta64(3600 * hour, "s"), RATE_HZ, drawn.channels)
    return len(hours)


# a process is given one part of the hours after the other: its turbine is made once
_drawn_once = lru_cache(maxsize=1)(_draw)


def _write_part(recipe: _Recipe, folder: Path, hours: tuple[int, ...]) -> int:
    return _write_hours(_drawn_once(recipe), folder, hours)


def _prevailing_direction(plan: operation.Plan, *, idling_only: bool = False) -> float:
    chosen = plan.heading_deg[plan.running <= 0.5] if idling_only else plan.heading_deg
    return Counter((chosen if len(chosen) else plan.heading_deg).tolist()).most_common(1)[0][0]


def nacelle_labels(modes: HeadingModes, sensors: tuple[Sensor, ...]) -> tuple[str, ...]:
    """FA1, SS1, T1, ... of modes, fore-aft being where the nacelle looks: the sensors are turned into its axes."""
    back = rotation(np.array([0.0, 0.0, np.radians(modes.heading_deg)]))
    turned = tuple(replace(s, position_m=back @ s.position_m, direction=back @ s.direction) for s in sensors)
    return mode_character(modes.nominal_shape, turned).labels


def _claim(folder: Path, truth_text: str) -> None:
    """Take an empty folder, or one that holds this very campaign."""
    path = folder / "truth.toml"
    if folder.exists() and not folder.is_dir():
        raise InputError(str(folder), "is a file", "name a folder")
    same = path.is_file() and read_text(path) == truth_text
    if not same and not is_empty_folder(folder):
        raise InputError(str(folder), "already holds something else", "name a new folder or empty this one")
    write_text(path, truth_text)
    (folder / "acceleration").mkdir(exist_ok=True)


def _round_values(array, digits: int = 8) -> list:
    return np.round(np.asarray(array, float), digits).tolist()


def reported_heading(table: pandas.DataFrame, turbine: Turbine) -> pandas.DataFrame:
    """SCADA's nacelle heading with the error that is hidden in it."""
    off = np.array([turbine.hidden(number).total("heading_offset") for number in range(len(turbine.amount))])
    if off.any():
        heading = table["nacelle_heading_deg"].to_numpy() + off[turbine.condition]
        table["nacelle_heading_deg"] = np.mod(heading.round(1), 360)
    return table


def _mode_set(file: TurbineFile, modes: HeadingModes) -> dict:
    return {
        "heading_deg": modes.heading_deg,
        "labels": list(nacelle_labels(modes, file.sensors)),
        "frequency_hz": _round_values(modes.frequency_hz),
        "damping_ratio_idling": _round_values(modes.damping_ratio["idling"], 6),
        "damping_ratio_operating": _round_values(modes.damping_ratio["operating"], 6),
        "shape": _round_values(modes.nominal_shape.T),
    }


def _record(turbine: Turbine, given, gaps, quiet) -> dict:
    """The content of truth.toml; it can be given back as a truth file. Modes are those of the campaign's start and,
    where effects vary, of its end; `condition` says from when on which amounts of the effects hold."""
    file, truth, plan, seed = turbine.file, turbine.truth, turbine.plan, turbine.seed
    structure, ends = turbine.structure(0), int(turbine.condition[-1])
    starts = np.flatnonzero(np.diff(turbine.condition, prepend=-1))
    varies = len(turbine.amount) > 1
    t = asdict(truth.tolerances)
    headings = sorted(set(plan.heading_deg.tolist()))
    times = START + (operation.GRID_S * np.arange(len(plan.heading_deg))).astype("timedelta64[s]")
    key = np.where(plan.running > 0.5, 1, 0)
    cuts = [0, *(np.flatnonzero((np.diff(plan.heading_deg) != 0) | (np.diff(key) != 0)) + 1), len(key)]
    idle = turbine.modes(_prevailing_direction(plan, idling_only=True))
    record = {
        "format": 1,
        "name": str(file.value("name")),
        "model": {"sha256": hashlib.sha256(file.path.read_bytes()).hexdigest()},
        "seed": int(seed),
        "parameters_from": given.parameters_from,
        "parameters": {k: float(v) for k, v in truth.parameters.items()},
        "tolerances": {"scale": given.tolerance_scale},
        "operation": dict(given.operation),
        "drawn": {k: _round_values(v) for k, v in t.items()} | {
            "damping_ratio_without_air": _round_values(truth.damping_ratio),
            "noise_std_mps2": _round_values(truth.noise_std_mps2), "offset_mps2": _round_values(truth.offset_mps2),
        },
        "summary": {
            "start": f"{START}Z", "hours": plan.n_slot / 6, "sampling_rate_hz": RATE_HZ,
            "quiet_blocks": int(quiet.sum()),
            "heading_convention": "deg clockwise from above, 0: the rotor looks along -x; SCADA has it modulo 360",
            "total_mass_kg": float(round(structure.mass.diagonal()[0::6].sum())),
        },
        # the modes of the structure (not of single members) at the heading it mostly had while idling
        "idling_hz": {
            label: float(round(f, 8)) for label, f in zip(
                nacelle_labels(idle, file.sensors), idle.frequency_hz, strict=True) if not label.startswith("L")
        },
        "effect": [dict(e) for e in truth.effects],
        "mode_set": [_mode_set(file, turbine.modes(h, 0)) for h in headings],
        "mode_set_end": [_mode_set(file, turbine.modes(h, ends)) for h in headings] if varies else [],
        "condition": [
            {"start": f"{START + np.timedelta64(int(600 * k), 's')}Z",
             "amount": _round_values(turbine.amount[turbine.condition[k]])}
            for k in starts
        ] if varies else [],
        "state": [
            {"start": f"{times[a]}Z", "heading_deg": float(plan.heading_deg[a]),
             "rotor": ("idling", "operating")[key[a]]}
            for a in cuts[:-1]
        ],
        "event": [asdict(e) | {"time": f"{START + np.timedelta64(int(e.start_s), 's')}Z"} for e in plan.events],
        "gap": [asdict(g) for g in gaps],
    }
    return {k: v for k, v in record.items() if not (isinstance(v, list) and not v)}
