"""A chain on disk: whole segments, beside a head that says which problem and settings they belong to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import emcee
import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import archive, read_json_table, write_arrays, write_json

FORMAT = 2
# what a user calls the parts of a problem whose hashes may differ
WORDS = {"prior": "the prior or bounds", "model": "the model", "measured modes": "the measured modes or the set",
         "weights": "the weights or what is compared", "pairing": "the pairing of modes",
         "reduction": "the reduced basis's settings"}


@dataclass(frozen=True, eq=False, kw_only=True)
class Segment:
    """Some steps of one ensemble: theta (n_step, n_walker, n_param), log_posterior (n_step, n_walker), and emcee's
    state after them; accepted share of the moves, parameter vectors evaluated, and those by the full model."""

    theta: np.ndarray
    log_posterior: np.ndarray
    state: emcee.State
    accepted: float
    evaluated: int
    fallback: int


class ChainStore:
    """Segments as npz files in a folder. Opening it claims the folder: raises InputError where another chain is there,
    naming every part of the problem and every setting that differs."""

    def __init__(self, folder: Path, parts: Mapping[str, str], settings: Mapping[str, Any]):
        self._folder, self._n_ensemble = folder, int(settings["ensembles"])
        head = {"format": FORMAT, "problem": dict(parts), "settings": dict(settings)}
        path = folder / "chain.json"
        if path.exists():
            found = _read_head(path)
            if found != head:
                raise InputError(
                    str(folder), f"holds a chain of another run: {'; '.join(_differences(found, head))}",
                    "give another --out, or delete that folder to start again",
                )
        else:
            write_json(path, head)

    def _path(self, number: int, ensemble: int) -> Path:
        return self._folder / (f"segment-{number:05d}.npz" if ensemble == 0 else f"segment-{number:05d}-{ensemble}.npz")

    def append(self, segment: Segment, number: int, ensemble: int) -> None:
        kind, keys, position, has_gauss, cached = segment.state.random_state
        content = {
            "theta": segment.theta, "log_posterior": segment.log_posterior, "coords": segment.state.coords,
            "log_prob": segment.state.log_prob, "keys": keys,
            "numbers": np.array([position, has_gauss, segment.evaluated, segment.fallback]),
            "cached": np.array([cached, segment.accepted]),
        }
        if kind != "MT19937":
            raise InputError("random state", f"generator {kind} is not the one expected", "use emcee 3.1")
        write_arrays(self._path(number, ensemble), content)

    def read(self) -> list[list[Segment]]:
        """Rounds that all ensembles have finished, each with a segment per ensemble."""
        rounds = []
        while all(self._path(len(rounds), k).exists() for k in range(self._n_ensemble)):
            rounds.append([self.read_one(len(rounds), k) for k in range(self._n_ensemble)])
        return rounds

    def read_one(self, number: int, ensemble: int) -> Segment | None:
        """None where it was not written."""
        path = self._path(number, ensemble)
        if not path.exists():
            return None
        return _read_segment(path)


def _differences(found: dict, head: dict) -> list[str]:
    """A phrase for everything that differs between two heads."""
    if found.get("format") != head["format"]:
        return ["it was written by another version (format differs)"]
    old, new = (found.get("problem") or {}), head["problem"]
    # a model's hash covers its parameters: where these differ, they say it
    changed = [k for k in new if old.get(k) != new[k]]
    if "prior" in changed and "model" in changed:
        changed.remove("model")
    phrases = [f"{WORDS.get(k, k)} differ{'s' if k == 'model' else ''}" for k in changed]
    old, new = (found.get("settings") or {}), head["settings"]
    for key, value in new.items():
        if old.get(key) != value:
            phrases.append(f"{key} is {_text(value)} here and {_text(old.get(key))} there")
    return phrases or ["its head differs"]


def _text(value) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _read_head(path: Path) -> dict:
    found = read_json_table(path, "delete the chain's folder to start again")
    for key in ("problem", "settings"):
        if not isinstance(found.get(key), dict):
            raise InputError(str(path), f"has no table '{key}'", "delete the chain's folder to start again")
    return found


def _read_segment(path: Path) -> Segment:
    again = "delete it and those after it: the run goes on from the one before"
    with archive(path, "is not a segment of a chain", again) as content:
        position, has_gauss, evaluated, fallback = (int(x) for x in content["numbers"])
        cached, accepted = (float(x) for x in content["cached"])
        state = emcee.State(
            content["coords"], log_prob=content["log_prob"],
            random_state=("MT19937", content["keys"], position, has_gauss, cached),
        )
        return Segment(
            theta=content["theta"], log_posterior=content["log_posterior"], state=state, accepted=accepted,
            evaluated=evaluated, fallback=fallback,
        )

