"""One turbine's month through the farm's steps: what is finished is kept, what went wrong is one line on the disk."""

from __future__ import annotations

import hashlib
import shutil
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from probupdate import __version__, verbs
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError, ProbupdateError, plain
from probupdate.farms.description import STEPS, Farm, Month, Options
from probupdate.farms.records import changed_records, keep, read_kept, record_table
from probupdate.identification.block_store import OtherBlocks, forget_changed
from probupdate.identification.settings import IdentificationSettings
from probupdate.io.files import read_json_table, write_json, write_text
from probupdate.io.outputs import companion_files
from probupdate.io.schema import checked_table
from probupdate.modal.joined_modes import highest_frequency_hz
from probupdate.modal.modes import read_modes
from probupdate.reporting import report as write_report
from probupdate.structure.load import load_model, model_sensors
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.settings import SamplerSettings

if TYPE_CHECKING:
    from probupdate.diagnosis.prepare import Prepared
    from probupdate.identification.identify import Identification
    from probupdate.modal.modes import Sensor

STATE, TRACE = "month.json", "failure.txt"
FORMAT = 1
# step -> what of `month_sources` it depends on beside what `identify` does; step -> the steps whose results it takes
DEPENDS = {
    "identify": ("records", "campaign", "scada", "model", "version", "options of identify"),
    "select": ("options of select",),
    "update": ("options of update", "selected"),
    "sample": ("options of update", "options of sample", "selected", "seed"),
    "compare": (), "diagnose": ("options of diagnose", "seed"), "report": (),
}
FOLLOWS: Mapping[str, tuple[str, ...]] = {
    "identify": (), "select": ("identify",), "update": ("identify", "select"), "sample": ("identify", "select"),
    "compare": ("update", "sample"), "diagnose": ("identify",),
    "report": ("identify", "select", "update", "sample", "compare", "diagnose"),
}
WRITES = {"identify": "modes.json", "select": "nine.json", "update": "update.json", "sample": "posterior.nc",
          "compare": "compare.json", "diagnose": "diagnosis.json", "report": "report.html"}
ANEW = "delete it: the month's finished steps are done again"


# where `identify` keeps a month's blocks
STORE = "modes.json.blocks"


@dataclass(frozen=True, kw_only=True)
class MonthState:
    """month.json. made_of: what the steps' results depend on, by name; finished: step -> seconds; failed: the step that
    went wrong, and why, '' where none did."""

    format: int
    made_of: Mapping[str, str]
    finished: Mapping[str, float]
    failed_step: str = ""
    failed: str = ""


def read_state(folder: Path) -> MonthState | None:
    """What is known of a month; None before its first step. Raises InputError where month.json is none."""
    path = folder / STATE
    if not path.exists():
        return None
    found = read_json_table(path, ANEW)
    checked_table(MonthState, found, path, ANEW)
    if found["format"] != FORMAT:
        raise InputError(str(path), f"has format {found['format']}, this version reads {FORMAT}", ANEW)
    return MonthState(**{name: found[name] for name in MonthState.__dataclass_fields__ if name in found})


def is_done(state: MonthState | None, farm: Farm, made_of: Mapping[str, str]) -> bool:
    return state is not None and not state.failed and len(still_finished(state, farm, made_of)) == len(farm.steps)


def month_sources(month: Month, farm: Farm, records: Mapping[str, Mapping[str, str]] | None = None) -> dict[str, str]:
    """What a month's results depend on: records, the other files of campaign and model by content, the options of every
    step, whether sets are selected, the seed, the version. records: `record_table`; None: it is made."""
    table = record_table(month.campaign / "acceleration", {}) if records is None else records
    contents = sorted((name, each["content"]) for name, each in table.items())
    files = {"campaign": month.campaign / "campaign.toml", "scada": month.campaign / "scada.csv"}
    return {
        "records": _hash([repr(contents).encode()]),
        **{name: _hash([p.read_bytes()] if p.is_file() else []) for name, p in files.items()},
        "model": model_hash(verbs.model_path(month.model)),
        **{f"options of {name}": _hash([repr(table).encode()]) for name, table in asdict(farm.options).items()},
        "selected": str("select" in farm.steps), "seed": str(farm.seed), "version": __version__,
    }


def still_finished(known: MonthState | None, farm: Farm, now: Mapping[str, str]) -> dict[str, float]:
    """Steps that were finished of what is now, with their seconds; one that follows a step to be done again is too."""
    kept: dict[str, float] = {}
    if known is None:
        return kept
    differ = {name for name in {*known.made_of, *now} if known.made_of.get(name) != now.get(name)}
    again: set[str] = set()
    for step in farm.steps:
        stale = differ & {*DEPENDS["identify"], *DEPENDS[step]} or again & set(FOLLOWS[step])
        if stale or step not in known.finished:
            again.add(step)
        else:
            kept[step] = known.finished[step]
    return kept


def model_hash(model: Path) -> str:
    """Of the model's file and all that is read with it."""
    return _hash(p.read_bytes() for p in sorted(set(companion_files(model))) if p.is_file())


def _hash(contents: Iterable[bytes]) -> str:
    found = hashlib.sha256()
    for content in contents:
        found.update(hashlib.sha256(content).digest())
    return found.hexdigest()


def run_month(month: Month, farm: Farm, out: Path) -> MonthState:
    """The steps of a month that are not finished, into its folder of `out`. Never raises for what is wrong with this
    month: that is in the state that is returned and kept."""
    folder = out / month.folder
    step = "the state kept"
    finished: dict[str, float] = {}
    now: dict[str, str] = {}
    try:
        kept = read_kept(folder)
        records = record_table(month.campaign / "acceleration", kept)
        now = month_sources(month, farm, records)
        known = read_state(folder)
        finished = still_finished(known, farm, now)
        if "identify" not in finished and known is not None:
            _make_way(month, folder / STORE, farm, known.made_of, now, changed_records(kept, records))
        keep(folder, records)
        for step in farm.steps:
            if step in finished:
                continue
            begun = time.monotonic()
            # what it or a later step wrote of something else is not taken for this one's
            for later in (s for s in STEPS[STEPS.index(step):] if s not in finished):
                (folder / WRITES[later]).unlink(missing_ok=True)
            _RUN[step](month, folder, farm.options, farm.seed)
            finished[step] = round(time.monotonic() - begun, 3)
            write_state(folder, MonthState(format=FORMAT, made_of=now, finished=finished))
    except (ProbupdateError, OSError, MemoryError) as error:
        return _failure(folder, now, finished, step, _words(error))
    except Exception as error:
        # a defect in one month must not end the others; its trace is kept for whoever corrects it
        write_text(folder / TRACE, traceback.format_exc())
        last = str(error).strip().splitlines() or ["no words"]
        return _failure(folder, now, finished, step, f"a defect of the program ({type(error).__name__}: {last[0]}); "
                        f"its trace is in {month.folder.as_posix()}/{TRACE}")
    (folder / TRACE).unlink(missing_ok=True)
    return MonthState(format=FORMAT, made_of=now, finished=finished)


def _make_way(
    month: Month, store: Path, farm: Farm, before: Mapping[str, str], now: Mapping[str, str], changed: set[str]
) -> None:
    """Of the poles kept, those of other records; all where the campaign or the rotor's speed were others."""
    whole = {"campaign"} | ({"scada"} if farm.options.identify.harmonics == "remove" else set())
    if any(before.get(name) != now[name] for name in whole):
        shutil.rmtree(store, ignore_errors=True)
    elif store.is_dir():
        forget_changed(store, read_campaign(month.campaign).files, changed)


def ended_month(month: Month, farm: Farm, out: Path) -> MonthState:
    """The state of a month whose process was ended from outside, alone with it."""
    known = read_state(out / month.folder)
    finished = {} if known is None else dict(known.finished)
    step = next((s for s in farm.steps if s not in finished), farm.steps[-1])
    return _failure(out / month.folder, {} if known is None else dict(known.made_of), finished, step,
                    "its process was ended from outside (out of memory?); run again with fewer jobs, or more memory")


def _failure(folder: Path, now: Mapping[str, str], finished: Mapping[str, float], step: str, text: str) -> MonthState:
    state = MonthState(format=FORMAT, made_of=now, finished=finished, failed_step=step, failed=plain(text)[:2000])
    write_state(folder, state)
    return state


def _words(error: BaseException) -> str:
    if isinstance(error, MemoryError):
        return "out of memory; run again with fewer jobs, or more memory"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def write_state(folder: Path, state: MonthState) -> None:
    """Where a month stands, into its folder; `read_state` reads it."""
    write_json(folder / STATE, asdict(state))


def chosen_sets(folder: Path) -> Path:
    """The selected sets, or all."""
    nine = folder / "nine.json"
    return nine if nine.exists() else folder / "modes.json"


def _identify(month: Month, folder: Path, options: Options, seed: int) -> None:
    asked = options.identify
    settings = IdentificationSettings(
        order=asked.order, block_rows=asked.block_rows, rate_hz=asked.rate_hz, harmonics=asked.harmonics)

    def identified() -> Identification:
        return verbs.identify(month.campaign, month.model, lowest=asked.lowest, settings=settings, store=folder / STORE)

    try:
        found = identified()
    except OtherBlocks:
        # of other options, or of records for which other settings were proposed
        shutil.rmtree(folder / STORE)
        found = identified()
    found.write(folder / "modes.json")


def _select(month: Month, folder: Path, options: Options, seed: int) -> None:
    scada, asked = month.campaign / "scada.csv", options.select
    verbs.select(
        folder / "modes.json", scada=scada if scada.exists() else None, preset=asked.preset, count=asked.count,
        std_from=asked.std_from, rated_power_kw=asked.rated_power_kw).write(folder / "nine.json")


def _update(month: Month, folder: Path, options: Options, seed: int) -> None:
    likelihood = LikelihoodSettings(**asdict(options.update))
    verbs.update(month.model, chosen_sets(folder), likelihood=likelihood).write(folder / "update.json")


def _sample(month: Month, folder: Path, options: Options, seed: int) -> None:
    asked, likelihood = options.sample, LikelihoodSettings(**asdict(options.update))
    settings = SamplerSettings(seed=seed, target_ess=asked.ess, ensembles=asked.ensembles)
    verbs.sample(month.model, chosen_sets(folder), folder / "posterior.nc", likelihood=likelihood, settings=settings)


def _compare(month: Month, folder: Path, options: Options, seed: int) -> None:
    verbs.compare(folder / "update.json", folder / "posterior.nc").write(folder / "compare.json")


def _diagnose(month: Month, folder: Path, options: Options, seed: int) -> None:
    asked, out, model = options.diagnose, folder / "diagnosis.json", verbs.model_path(month.model)
    sensors = read_campaign(month.campaign).sensors if asked.records and model.suffix == ".toml" else None
    highest_hz = highest_frequency_hz(read_modes(folder / "modes.json"))
    records = month.campaign if asked.records else None
    prepared = _prepare_model(model, sensors, highest_hz)
    verbs.diagnose(prepared, folder / "modes.json", campaign=records, seed=seed, out=out,
                   extend=asked.extend).write(out)


# the model that the last diagnosis in this process was of, with all effects in it, by what it was made of
_KEPT: dict[str, Prepared] = {}


def _prepare_model(model: Path, sensors: tuple[Sensor, ...] | None, highest_hz: float) -> Prepared:
    """What `diagnose` would make of the model first: three quarters of its time, and the same for all months of a
    turbine and all turbines of one model with the same sensors and as many modes."""
    from probupdate.diagnosis.prepare import modes_up_to, prepare

    own = None if model_sensors(model) is None else sensors
    count = modes_up_to(load_model(model, sensors=own), highest_hz)
    made = _hash([str(model).encode(), model_hash(model).encode(), repr(sensors).encode(), str(count).encode(), *(
        array.tobytes() for s in sensors or () for array in (s.position_m, s.direction))])
    if made not in _KEPT:
        _KEPT.clear()
        _KEPT[made] = prepare(model, sensors=sensors, highest_hz=highest_hz)
    return _KEPT[made]


def _report(month: Month, folder: Path, options: Options, seed: int) -> None:
    write_report(folder, folder / "report.html")


_RUN: dict[str, Callable[[Month, Path, Options, int], None]] = {
    "identify": _identify, "select": _select, "update": _update, "sample": _sample, "compare": _compare,
    "diagnose": _diagnose, "report": _report,
}
