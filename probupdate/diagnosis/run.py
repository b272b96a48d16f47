"""A diagnosis from files: which of the four ways is meant, and where the extended model goes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from probupdate.diagnosis.catalogue import Effect
from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.gain import gains
from probupdate.diagnosis.prepare import Prepared, prepare
from probupdate.diagnosis.residuals import residuals
from probupdate.diagnosis.results import Diagnosis
from probupdate.diagnosis.splitting import splits
from probupdate.diagnosis.turbine_effects import TurbineEffect
from probupdate.errors import InputError
from probupdate.modes import ModalData, Sensor
from probupdate.progress import Progress, silent
from probupdate.structure.parameter_table import read_parameters, read_toml


def diagnose_files(
    model: Path | Prepared | None,
    data: ModalData,
    *,
    sensors: tuple[Sensor, ...] | None = None,
    parameters: str | Path | None = None,
    groups: str | Path | Mapping[str, Mapping[str, float]] | None = None,
    effects: Sequence[Effect] = (),
    rows: Sequence[TurbineEffect] = (),
    extend: bool = True,
    seed: int = 1,
    out: str | Path | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """`model`: a file, or one made ready by `prepare` for many records. `groups`: name -> {parameter: change}, or a
    TOML file of them. `effects`, `rows`: a user's own; see `prepare`. `extend`: measure what each finding gains on
    held-out blocks and write the extended model beside `out`, diagnosis.json's place.
    """
    if isinstance(groups, str | Path):
        groups = _read_groups(groups)
    if isinstance(model, Prepared):
        return _whole(model, data, seed, progress, extend=extend)
    if model is None:
        raise InputError("diagnose", "no model is given", "give --model")
    if not isinstance(model, Path):
        raise InputError("diagnose", "a model that is a Python function has no matrices to put effects into",
                         "export its matrices as model.npz")  # fmt: skip
    own = read_parameters(parameters) if parameters else None
    placed = sensors if model.suffix == ".toml" else None
    prepared = prepare(model, parameters=own, sensors=placed, groups=groups, effects=effects, rows=rows,
                       progress=progress)  # fmt: skip
    return _whole(prepared, data, seed, progress, extend=extend)


def _whole(prepared: Prepared, data: ModalData, seed: int, progress: Progress, *, extend: bool) -> Diagnosis:
    """The diagnosis with what remains before and after its findings, for the report."""
    outcome = examine(prepared, data, seed=seed, progress=progress)
    found = outcome.diagnosis
    if extend and found.findings:
        found = _with_gains(found, gains(prepared, outcome, progress=progress))
    return replace(found, splits=found.splits or splits(outcome),
                   details={**found.details, "residuals": residuals(outcome, prepared.sensors)})  # fmt: skip


def _with_gains(found: Diagnosis, told: Sequence[dict]) -> Diagnosis:
    findings = tuple(replace(f, gain=gain) for f, gain in zip(found.findings, told, strict=True))
    notes = tuple(f"{f.cause}, {f.location}: {f.gain['statement']}; the verdict stands on the whole record alone"
                  for f in findings if not f.gain["significant"])  # fmt: skip
    return replace(found, findings=findings, notes=(*found.notes, *notes))


def _read_groups(path: str | Path) -> dict[str, dict[str, float]]:
    table = read_toml(path)
    for name, parts in table.items():
        numbers = isinstance(parts, dict) and parts and all(
            isinstance(v, int | float) and not isinstance(v, bool) for v in parts.values())
        if not numbers:
            raise InputError(f"{path}: {name}", "is no table of parameters with their change", "write [name] k_1 = 0.1")
    return table
