"""A run directory to the values the page shows. What is not there is named; what is there and broken is an error."""

from __future__ import annotations

import difflib
import hashlib
import io
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import TypeVar

import pandas as pd

from probupdate import __version__
from probupdate.diagnosis.results import read_diagnosis
from probupdate.errors import InputError, parsing
from probupdate.io.files import read_bytes, read_json_table, read_own_text, read_toml, resolve_path, sha256
from probupdate.io.schema import checked_table
from probupdate.modal.modes import ModalData, ModalSet, read_modes, set_words
from probupdate.model.interface import Model
from probupdate.model.parameters import Parameters
from probupdate.reporting.campaign_values import campaign_values, truth_values
from probupdate.reporting.model_values import compared_modes, model_values, update_set
from probupdate.reporting.paper_tables import is_the_jacket
from probupdate.reporting.values import CampaignValues, Run
from probupdate.runtime.progress import Progress
from probupdate.updating.comparison import Comparison, read_comparison
from probupdate.updating.posterior_file import Posterior, read_posterior
from probupdate.updating.update_file import SETS, UpdateRecord, read_update

T = TypeVar("T")

# key of run.json, or file of a run -> what the page says when it is not there
PARTS = {
    "campaign": "the campaign (campaign/)",
    "model": "the model (model.toml, or model.npz with parameters.toml)",
    "modes.json": "identified modes (modes.json)",
    "modes.poles.csv": "the table of poles (modes.poles.csv)",
    "selection.csv": "the reasons of the selection (selection.csv)",
    "nine.json": "selected sets (nine.json)",
    "update.json": "the update (update.json)",
    "posterior.nc": "the posterior (posterior.nc)",
    "compare.json": "the comparison (compare.json)",
    "diagnosis.json": "the diagnosis (diagnosis.json)",
}
# an update with the paper's weights, for comparison
PAPER = "paper.json"
HEAD_KEYS = ("model", "parameters", "campaign", "modes", "seed", "version", "title")
# what the demonstration notes for itself
DEMONSTRATION_KEYS = ("start", "days", "hidden", "finished")
# for the page's list of what it was made from
LARGEST_HASHED = 4 * 2**30
MODEL_FILES = ("model.toml", "model.npz")
POLE_COLUMNS = ("time", "frequency_hz", "mac", "mode", "criterion")
SELECTION_COLUMNS = ("id", "criterion")


@dataclass(frozen=True, kw_only=True)
class HeadTable:
    """run.json: where the parts lie within the run, and what made them; the demonstration adds keys of its own."""

    model: str | None = None
    parameters: str | None = None
    campaign: str | None = None
    modes: str | None = None
    seed: int | None = None
    version: str | None = None
    title: str | None = None


def read_run(folder: Path, progress: Progress, given: Mapping[str, Path] | None = None) -> Run:
    """Everything the directory holds; given: campaign, model and parameters that lie elsewhere. Raises InputError where
    it is not a directory, holds nothing of a run, or holds a file that cannot be read or does not belong to the
    others."""
    if not folder.is_dir():
        raise InputError(str(folder), "is not a directory", "give the directory that the steps wrote into")
    head, given = _head(folder), given or {}
    _refuse_absent(given)
    places = _places(folder, head) | {name: path for name, path in given.items() if name in PARTS}
    parameters = given.get("parameters") or _path_in_head(folder, head, "parameters")
    diagnosis = read_diagnosis(places["diagnosis.json"]) if "diagnosis.json" in places else None
    places, replaced = _places_with_findings(folder, places, given, diagnosis)
    missing = tuple(words for name, words in PARTS.items() if name not in places)
    if len(missing) == len(PARTS):
        raise InputError(str(folder), "holds nothing of a run", f"expected some of {', '.join(PARTS)}")
    steps = len(PARTS)

    def read(name: str, reader: Callable[[Path], T]) -> T | None:
        progress("reading the run", list(PARTS).index(name), steps)
        return reader(places[name]) if name in places else None

    check = folder / "check.json"
    campaign = read("campaign", lambda path: campaign_values(path, check if check.exists() else None))
    modes = read("modes.json", read_modes)
    nine = read("nine.json", read_modes)
    poles = read("modes.poles.csv", lambda path: read_table(path, POLE_COLUMNS, time="time"))
    selection = read("selection.csv", lambda path: read_table(path, SELECTION_COLUMNS))
    update = read("update.json", read_update)
    posterior = read("posterior.nc", read_posterior)
    comparison = read("compare.json", read_comparison)
    mean = _mean_updated_on(folder, update, diagnosis)
    data = compared_modes(mean or nine or modes, update)
    held = update.parameters if update is not None and update.parameters.held else parameters
    model = read("model", lambda path: _load_model(path, held, folder, campaign, update_set(data, update)))
    progress("reading the run", steps, steps)
    _refuse_strangers(folder, model, update, posterior, comparison)
    _refuse_other_structure(folder, model, update, diagnosis)
    truth_file = places["campaign"] / "truth.toml" if "campaign" in places else None
    names = update.parameters.names if update is not None else model.parameters.names if model is not None else ()
    added = added_parameters(diagnosis)
    paper = folder / PAPER
    return Run(
        folder=folder,
        title=_title(folder, head, places, model, campaign),
        missing=missing,
        warnings=(*_warnings(head, data, update, posterior), *_changed_inputs(places, parameters, diagnosis)),
        provenance=(*_provenance(folder, places, head, model, update, posterior),
                    *((name, "not shown: of the model without the findings") for name in replaced)),
        campaign=campaign,
        truth=(truth_values(truth_file, data, added) if truth_file is not None and truth_file.exists() else None),
        mean=mean, paper=read_update(paper) if paper.exists() else None,
        modes=modes, poles=poles, selection=selection, nine=nine,
        model=None if model is None else model_values(model, data, update),
        update=update, posterior=posterior, comparison=comparison, diagnosis=diagnosis,
        jacket=is_the_jacket(tuple(name for name in names if name not in added)),
    )


def _places_with_findings(
    folder: Path, places: Mapping[str, Path], given: Mapping[str, Path], diagnosis: Mapping | None
) -> tuple[dict[str, Path], tuple[str, ...]]:
    """The places, with update, posterior, comparison and model being those with the findings in them where the first
    was made as `diagnose` states; and the names of the files that these replace."""
    with_findings = {name: folder / f"diagnosis.{name}" for name in ("update.json", "posterior.nc", "compare.json")}
    if diagnosis is None or not with_findings["update.json"].is_file():
        return dict(places), ()
    replaced = tuple(places[name].name for name in with_findings if name in places)
    found = {name: path for name, path in places.items() if name not in with_findings}
    found |= {name: path for name, path in with_findings.items() if path.is_file()}
    extended = diagnosis.get("extended_model")
    if extended and "model" not in given and (folder / extended).is_file():
        found["model"] = folder / extended
    return found, replaced


def added_parameters(diagnosis: Mapping | None) -> dict[str, str]:
    """Parameters that findings became in the extended model -> the place of each."""
    added = ((diagnosis or {}).get("extension") or {}).get("added", ())
    return {one["parameter"]: one["location"] for one in added if one["as"] == "parameter"}


def _mean_updated_on(folder: Path, update: UpdateRecord | None, diagnosis: Mapping | None) -> ModalData | None:
    """The diagnosis's mean of the blocks in which its findings act, where the update is of that."""
    name = (((diagnosis or {}).get("extension") or {}).get("files") or {}).get("mean")
    if update is None or not name:
        return None
    path = resolve_path(str(name), folder, f"{folder / 'diagnosis.json'}, extension")
    if not path.exists():
        return None
    mean = read_modes(path)
    return mean if update.set_id in {s.id for s in mean.sets} else None


def run_places(folder: Path, given: Mapping[str, Path] | None = None) -> dict[str, Path]:
    """What of a run lies where: the keys of PARTS, and `parameters` where run.json names a file of them; given: model
    and parameters that lie elsewhere."""
    if not folder.is_dir():
        raise InputError(str(folder), "is not a directory", "give the directory that the steps wrote into")
    head, given = _head(folder), given or {}
    _refuse_absent(given)
    parameters = _path_in_head(folder, head, "parameters")
    return _places(folder, head) | ({} if parameters is None else {"parameters": parameters}) | dict(given)


def refuse_unfinished(folder: Path, places: Mapping[str, Path]) -> None:
    """Raises InputError for a run that lacks a model or a posterior."""
    if (folder / "farm.json").is_file():
        months = sorted(f.parent.relative_to(folder).as_posix() for f in folder.glob("*/*/month.json"))
        raise InputError(str(folder), "is a farm's folder, not a run's",
                         f"name a month below it, such as {months[0] if months else 'TURBINE/MONTH'}")
    for name, remedy in (("model", "put model.toml or model.npz there, or name it (--model)"),
                         ("posterior.nc", "run `probupdate sample`")):
        if name not in places:
            raise InputError(str(folder), f"has no {PARTS[name].removeprefix('the ')}", remedy)


def _refuse_absent(given: Mapping[str, Path]) -> None:
    for name, path in given.items():
        if not path.exists():
            raise InputError(f"--{name}", f"'{path}' does not exist", "correct the path")


def _head(folder: Path) -> Mapping:
    path = folder / "run.json"
    if not path.exists():
        return {}
    remedy = f"write {{...}} with some of {', '.join(HEAD_KEYS)}"
    head = read_json_table(path, remedy)
    for key in head:
        if key not in HEAD_KEYS and key not in DEMONSTRATION_KEYS:
            close = difflib.get_close_matches(key, HEAD_KEYS, n=1)
            raise InputError(str(path), f"unknown key '{key}'", f"did you mean '{close[0]}'?" if close else remedy)
    checked_table(HeadTable, head, path, remedy)
    return head


def _places(folder: Path, head: Mapping) -> dict[str, Path]:
    """Part -> where it lies, for the parts that are there."""
    inside = {name: folder / name for name in PARTS if name not in ("campaign", "model")}
    inside["campaign"] = _path_in_head(folder, head, "campaign") or folder / "campaign"
    found = next((folder / name for name in MODEL_FILES if (folder / name).exists()), None)
    model = _path_in_head(folder, head, "model") or found
    if model is not None:
        inside["model"] = model
    return {name: inside[name] for name in PARTS if name in inside and inside[name].exists()}


def _path_in_head(folder: Path, head: Mapping, key: str) -> Path | None:
    """A path of run.json, relative to the run and within it."""
    if not head.get(key):
        return None
    where = f"{folder / 'run.json'}, {key}"
    resolve_path(str(head[key]), folder, where, remedy="copy it into the run directory")
    path = folder / str(head[key])
    if not path.exists():
        raise InputError(where, f"'{head[key]}' does not exist", "correct the path, or leave the key out")
    return path


def _title(
    folder: Path, head: Mapping, places: Mapping[str, Path], model: Model | None, campaign: CampaignValues | None
) -> str:
    """run.json's title, the model's name where it has one of its own, the campaign's, the directory's."""
    if head.get("title"):
        return str(head["title"])
    if model is not None and model.name != places["model"].stem:
        return model.name
    return folder.resolve().name if campaign is None else campaign.name


def read_table(path: Path, needed: tuple[str, ...], time: str | None = None) -> pd.DataFrame:
    with parsing(str(path), "not a table", "write it again, or remove it"):
        table = pd.read_csv(io.StringIO(read_own_text(path, "write it again, or remove it")))
    for column in needed:
        if column not in table:
            raise InputError(str(path), f"has no column '{column}'", "write it again, or remove it")
    if time is not None:
        try:
            table[time] = pd.to_datetime(table[time].astype(str), utc=True, format="ISO8601").dt.tz_localize(None)
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}, {time}", f"not a time ({error})", "write ISO 8601, UTC") from None
    return table


def _load_model(
    path: Path, parameters: Path | Parameters | None, folder: Path, campaign: CampaignValues | None,
    modal_set: ModalSet | None,
) -> Model:
    """The model at the campaign's sensors with the nacelle as in that set, as the steps saw it."""
    from probupdate.structure.load import load_model, nacelle_angle_deg

    if path.suffix == ".npz" or (path.suffix == ".toml" and "matrices" in read_toml(path)):
        return load_model(path, parameters=parameters)
    angle = None if modal_set is None else nacelle_angle_deg(modal_set.environment, f"{folder}, set {modal_set.id}")
    sensors = None if campaign is None else campaign.sensors
    return load_model(path, parameters=parameters, sensors=sensors, nacelle_angle_deg=angle)


def _refuse_strangers(
    folder: Path, model: Model | None, update: UpdateRecord | None, posterior: Posterior | None,
    comparison: Comparison | None,
) -> None:
    """Numbers of different parameters under one name would be read as one result."""
    named = {
        "the model": model and model.parameters.names, "update.json": update and update.parameters.names,
        "posterior.nc": posterior and posterior.names, "compare.json": comparison and comparison.names,
    }
    present = [(what, tuple(names)) for what, names in named.items() if names]
    for what, names in present[1:]:
        first, expected = present[0]
        if names != expected:
            raise InputError(str(folder), f"{what} and {first} have different parameters",
                             "run update and sample again with this model")


def _refuse_other_structure(
    folder: Path, model: Model | None, update: UpdateRecord | None, diagnosis: Mapping | None
) -> None:
    """A model with findings in it has parameters more, and an update may leave some out; none in common is another
    structure."""
    its = {str(p.get("name")) for p in diagnosis["parameters"]} if diagnosis is not None else set()
    known = model.parameters.names if model is not None else update.parameters.names if update is not None else ()
    if its and known and not its & set(known):
        raise InputError(f"{folder / 'diagnosis.json'}", f"is of another structure: none of its parameters "
                         f"({', '.join(sorted(its)[:3])}, ...) is the {'model' if model is not None else 'update'}'s "
                         f"({', '.join(known[:3])}, ...)", "run `probupdate diagnose` with this model, or take it out")


def _changed_inputs(places: Mapping[str, Path], parameters: Path | None, diagnosis: Mapping | None) -> Iterator[str]:
    """What a diagnosis was made from, and lies here otherwise; files from before `inputs` do not say."""
    from probupdate.structure.load import model_files

    made = dict((diagnosis or {}).get("inputs", {}))
    if "model" in places and places["model"].name == (diagnosis or {}).get("extended_model"):
        # its own model with the findings in it
        made.pop("model", None)
    model = model_files(places["model"], parameters) if "model" in places else ()
    modes = tuple(places[name] for name in ("modes.json", "nine.json") if name in places)
    for part, paths, words, whose in (
        ("model", model, "another model or of other parameters", "structure's"),
        ("modes", modes, "other modal sets", "record's"),
    ):
        its, here = dict(made.get(part, {})), {path.name: sha256(path) for path in paths}
        # all that a model is of; of the sets all, or those that were selected
        same = set(its.values()) == set(here.values()) if part == "model" else set(its.values()) & set(here.values())
        if its and here and not same:
            yield (f"diagnosis.json is of {words} ({_hashes(its)}) than those of this run ({_hashes(here)}): its "
                   f"findings may be another {whose}.")


def _hashes(files: Mapping[str, str]) -> str:
    """Names with the beginning of their SHA-256."""
    return ", ".join(f"{name} {digest[:8]}" for name, digest in files.items())


def _warnings(
    head: Mapping, data: ModalData | None, update: UpdateRecord | None, posterior: Posterior | None
) -> Iterator[str]:
    if update is not None and posterior is not None and update.fingerprint != posterior.fingerprint:
        yield ("update.json and posterior.nc were computed from different problems (model, data, weights or prior "
               "differ): their numbers do not belong together.")
    whole = update is not None and SETS in update.settings
    if update is not None and data is not None and not whole and update.set_id not in {s.id for s in data.sets}:
        yield f"The update was made on {set_words(update.set_id)}, which is not among the modal sets of this run."
    written = head.get("version")
    if written and written != __version__:
        yield f"The run was written by version {written}, this page by version {__version__}."


def _provenance(
    folder: Path, places: Mapping[str, Path], head: Mapping, model: Model | None, update: UpdateRecord | None,
    posterior: Posterior | None,
) -> Iterator[tuple[str, str]]:
    yield "probupdate", str(head.get("version") or __version__)
    yield "Python", platform.python_version()
    for package in ("numpy", "scipy", "pandas", "h5py", "emcee", "arviz"):
        yield package, metadata.version(package)
    if head.get("seed") is not None:
        yield "seed of the run", str(head["seed"])
    held = [places["campaign"] / name for name in ("campaign.toml", "scada.csv")] if "campaign" in places else []
    for path in (*places.values(), *held):
        if path.is_file():
            digest = hashlib.sha256(read_bytes(path, largest=LARGEST_HASHED)).hexdigest()
            yield Path(os.path.relpath(path, folder)).as_posix(), f"SHA-256 {digest[:16]}"
    if model is not None:
        yield "model", model.name
    if update is not None:
        yield "hash of the update's problem", update.fingerprint[:16]
        for key, value in update.settings.items():
            yield from setting_rows(f"update: {key}", value)
    if posterior is not None:
        yield "hash of the posterior's problem", posterior.fingerprint[:16]
        for key, value in posterior.record.items():
            if key not in ("map", "notes", "likelihood"):
                yield from setting_rows(f"posterior: {key}", value)


def setting_rows(key: str, value: object) -> Iterator[tuple[str, str]]:
    """A setting in a row; a table of settings in one row each, a list with commas."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            yield from setting_rows(f"{key}, {name}", part)
    elif isinstance(value, list | tuple):
        yield key, ", ".join(text for part in value for _, text in setting_rows("", part))
    else:
        yield key, f"{value:.4g}" if isinstance(value, float) else str(value)
