"""posterior.nc: the chain as an ArviZ file, and the two diagnostics taken from ArviZ. No other module imports it."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from probupdate.errors import InputError, parsing
from probupdate.io.files import write_bytes, written_whole
from probupdate.io.hdf5_file import refuse_unsafe
from probupdate.io.result_table import table_of
from probupdate.io.schema import validate
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.baseline import LearntError

if TYPE_CHECKING:
    import pandas as pd

# draws kept in the file, over all walkers: far more than any effective size wanted, and megabytes only
MAX_DRAWS = 100_000
# 2 has a hash of its content; 3 has ensembles as chains
FORMAT = 3
# of the sets that draws are of together, the first's and the last's id
ENDS = "first and last set"
ARRAYS = ("theta", "log_likelihood", "log_posterior", "prior", "measured", "std", "predicted", "frequency_hz")
GROUPS = ("posterior", "sample_stats", "log_likelihood", "prior", "observed_data")


def effective_size(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """theta (n_step, n_walker, n_param) -> rank-normalised split R-hat and bulk effective size (n_param,), walkers
    taken as chains (Vehtari et al. 2021). Of walkers that never moved: infinite and zero."""
    import arviz

    chains = np.ascontiguousarray(theta.transpose(2, 1, 0))
    r_hat, ess = np.full(len(chains), np.inf), np.zeros(len(chains))
    for k in np.flatnonzero(np.ptp(chains, axis=2).any(axis=1)):
        r_hat[k], ess[k] = float(arviz.rhat(chains[k])), float(arviz.ess(chains[k]))
    return r_hat, ess


def tail_size(theta: np.ndarray) -> np.ndarray:
    """Effective size (n_param,) of the 5 and 95 % quantiles, the lesser of both; zero of walkers that never moved."""
    import arviz

    chains = np.ascontiguousarray(theta.transpose(2, 1, 0))
    size = np.zeros(len(chains))
    for k in np.flatnonzero(np.ptp(chains, axis=2).any(axis=1)):
        size[k] = min(float(arviz.ess(chains[k], method="quantile", prob=share)) for share in (0.05, 0.95))
    return size


@dataclass(frozen=True, eq=False, kw_only=True)
class Posterior:
    """What posterior.nc holds, by name.

    theta (n_walker, n_step, n_param) after burn-in, perhaps thinned; log_likelihood (n_walker, n_step) of all
    responses together; prior (n_draw, n_param) draws; measured, predicted: responses (n_response,) and at some draws
    (n_predicted, n_response); frequency_hz (n_predicted, n_used) of the matched modes there. Text and numbers on how
    it came about are in `record`. model_error: what these data, and baselines, say of it.
    """

    names: tuple[str, ...]
    theta: np.ndarray
    log_likelihood: np.ndarray
    log_posterior: np.ndarray
    prior: np.ndarray
    response_labels: tuple[str, ...]
    measured: np.ndarray
    std: np.ndarray
    predicted: np.ndarray
    frequency_hz: np.ndarray
    mode_labels: tuple[str, ...]
    r_hat: np.ndarray
    ess: np.ndarray
    converged: bool
    verdict: str
    fingerprint: str
    record: Mapping[str, Any] = field(default_factory=dict)
    model_error: LearntError | None = None

    @property
    def draws(self) -> np.ndarray:
        """(n_draw, n_param)."""
        return self.theta.reshape(-1, self.theta.shape[2])

    @property
    def first_set(self) -> str:
        """Id of the first of the sets that the draws are of, or of the one."""
        return str(self.record[ENDS][0] if ENDS in self.record else self.record.get("set_id", ""))

    @property
    def sets(self) -> str:
        """Which sets the draws are of, in words: "9 of 9 sets, 2026-03-04T06:00Z to 2026-03-04T08:40Z"."""
        named = str(self.record.get("set_id", "sets that posterior.nc does not name"))
        return ", ".join([named, *([" to ".join(self.record[ENDS])] if ENDS in self.record else [])])

    def to_frame(self, *, draws: bool = False) -> pd.DataFrame:
        """A row a parameter: moments, quantiles, convergence, in the parameter's unit; with `draws` a row a draw."""
        if draws:
            return table_of([dict(zip(self.names, row, strict=True)) for row in self.draws.tolist()], self.names)
        theta = self.draws
        low, middle, high = np.quantile(theta, [0.05, 0.5, 0.95], axis=0)
        return table_of([
            {"name": name, "mean": theta[:, k].mean(), "std": theta[:, k].std(ddof=1), "q05": low[k],
             "median": middle[k], "q95": high[k], "r_hat": self.r_hat[k], "ess": self.ess[k]}
            for k, name in enumerate(self.names)
        ], units=dict.fromkeys(("mean", "std", "q05", "median", "q95"), "of the parameter"))

    @property
    def summary(self) -> str:
        lines = [self.verdict]
        draws = self.draws
        width = max(map(len, self.names))
        for k, name in enumerate(self.names):
            low, high = np.quantile(draws[:, k], [0.05, 0.95])
            lines.append(f"  {name:<{width}}  {draws[:, k].mean():>10.4g} +- {draws[:, k].std(ddof=1):<9.3g} "
                         f"90 % {low:.4g} to {high:.4g}")
        evaluated, fallback = self.record.get("evaluated", 0), self.record.get("fallback", 0)
        lines.append(f"{evaluated} evaluations, {fallback} of them by the full model; "
                     f"acceptance {self.record.get('acceptance', float('nan')):.2f}")
        lines += [str(text) for text in self.record.get("statements", ())]
        lines += [str(note) for note in self.record.get("notes", ())]
        return "\n".join(lines)


def variables_of(names: Sequence[str]) -> tuple[str, ...]:
    """What parameters are called in the file: by their names, but for a slash, which NetCDF keeps for groups, and the
    names of dimensions; each otherwise."""
    found: list[str] = []
    for name in names:
        own = name.replace("/", "_")
        while own in ("chain", "draw", *found) or (own != name and own in names):
            own += "_"
        found.append(own)
    return tuple(found)


def write_posterior(posterior: Posterior, path: str | Path) -> Path:
    """Write the five groups; numbers on how it came about go into the attributes of `posterior`.

    A chain of the file is an ensemble, its walkers one after another: the R-hat of walkers, which depend on each other,
    is too large (1.03 to 1.05 of chains that have converged), while walkers in a row keep their autocorrelation."""
    import xarray

    path = Path(path)
    n_walker, n_step, _ = posterior.theta.shape
    n_chain = int(posterior.record.get("ensembles", n_walker))
    n_chain = n_chain if n_walker % n_chain == 0 else n_walker
    n_draw = n_walker * n_step // n_chain
    theta, log_posterior, log_likelihood = (a.reshape(n_chain, n_draw, *a.shape[2:]) for a in (
        posterior.theta, posterior.log_posterior, posterior.log_likelihood))

    def by_name(theta: np.ndarray, dims) -> xarray.Dataset:
        named = zip(variables_of(posterior.names), posterior.names, strict=True)
        return xarray.Dataset({variable: (dims, theta[..., k], {"parameter": name})
                               for k, (variable, name) in enumerate(named)})

    chain_dims = ("chain", "draw")
    coords = {"chain": np.arange(n_chain), "draw": np.arange(n_draw)}
    groups = {
        "posterior": by_name(theta, chain_dims).assign_coords(coords),
        "sample_stats": xarray.Dataset({"lp": (chain_dims, log_posterior)}, coords=coords),
        "log_likelihood": xarray.Dataset({"response": (chain_dims, log_likelihood)}, coords=coords),
        "prior": by_name(posterior.prior[None], chain_dims).assign_coords(
            chain=[0], draw=np.arange(len(posterior.prior))),
        "observed_data": xarray.Dataset(
            {"response": ("response_label", posterior.measured), "response_std": ("response_label", posterior.std),
             "response_predicted": (("predicted", "response_label"), posterior.predicted),
             "frequency_hz_predicted": (("predicted", "mode"), posterior.frequency_hz)},
            coords={"response_label": list(posterior.response_labels), "mode": list(posterior.mode_labels)}),
    }
    if posterior.model_error is not None:
        # too long for an attribute
        groups["observed_data"]["model_error"] = json.dumps(posterior.model_error.to_table())
    head = {
        "format": FORMAT, "walkers": n_walker, "names": list(posterior.names), "converged": posterior.converged,
        "verdict": posterior.verdict, "fingerprint": posterior.fingerprint, "r_hat": posterior.r_hat.tolist(),
        "ess": posterior.ess.tolist(), "record": dict(posterior.record),
    }
    groups["posterior"].attrs = {"probupdate": json.dumps(head | {"content": _content_hash(head, posterior)})}
    # in memory: on a full disk the HDF5 library fails once more when it closes the file, and may end the process
    try:
        image = xarray.DataTree.from_dict(groups).to_netcdf(engine="h5netcdf")
    except (AttributeError, TypeError):
        # before xarray 2025 a tree is written to disk only
        return _written_to_disk(groups, path)
    return write_bytes(path, bytes(image))


def _written_to_disk(groups: Mapping, path: Path) -> Path:
    import arviz
    import xarray

    # ArviZ 1 has no such class any more and warns whoever asks for it
    with written_whole(path) as part:
        if "InferenceData" in vars(arviz):
            arviz.InferenceData(**groups).to_netcdf(str(part))
        else:
            xarray.DataTree.from_dict(groups).to_netcdf(str(part), engine="h5netcdf")
    return path


def _content_hash(head: Mapping, posterior: Posterior) -> str:
    """SHA-256 over every number and word of the file: one that was changed by hand says so."""
    hashed = json.loads(json.dumps({k: v for k, v in head.items() if k != "content"}))
    digest = hashlib.sha256(json.dumps(hashed, sort_keys=True).encode())
    for name in ARRAYS:
        array = np.asarray(getattr(posterior, name), float)
        digest.update(f"{name} {array.shape}".encode() + np.ascontiguousarray(array, "<f8").tobytes())
    digest.update(json.dumps([posterior.response_labels, posterior.mode_labels]).encode())
    if posterior.model_error is not None:
        digest.update(json.dumps(posterior.model_error.to_table()).encode())
    return digest.hexdigest()


def read_posterior(path: str | Path) -> Posterior:
    """Read posterior.nc; raises InputError where a group is missing or it is not one of this program."""
    import arviz

    # where something cannot be opened h5netcdf fails once more when it goes, on whoever's screen: looked through before
    path = refuse_unsafe(path, "is not a NetCDF file", "write it with `probupdate sample`", whole=True)
    with parsing(str(path), "is not a NetCDF file", "give a posterior.nc"), warnings.catch_warnings():
        # a file with unnamed dimensions is none of ours
        warnings.filterwarnings("error", message="The 'phony_dims' kwarg", category=UserWarning)
        data: Any = arviz.from_netcdf(str(path))
    # arrays are read as they are asked for, in one generation of ArviZ from a file that would else stay open
    again = "write it again with `probupdate sample`"
    with parsing(str(path), "lacks something or is damaged", again), closing(data):
        found = _from_groups(path, data)
    _refuse_sizes(path, validate(found, path, again), again)
    return found


def _refuse_sizes(path: Path, found: Posterior, again: str) -> None:
    """Parts that do not fit one another, and draws that are not numbers."""
    n_param, n_response = len(found.names), len(found.response_labels)
    if found.theta.ndim != 3 or found.theta.size == 0 or len(set(found.names)) < n_param:
        raise InputError(f"{path}, posterior", "holds no draws, or a parameter twice", again)
    if not np.all(np.isfinite(found.theta)):
        raise InputError(f"{path}, posterior", "holds draws that are not numbers", again)
    wanted = {
        "log_likelihood": found.theta.shape[:2], "log_posterior": found.theta.shape[:2], "r_hat": (n_param,),
        "ess": (n_param,), "measured": (n_response,), "std": (n_response,),
        "predicted": (len(found.predicted), n_response),
        "frequency_hz": (len(found.frequency_hz), len(found.mode_labels)), "prior": (len(found.prior), n_param),
    }
    for name, shape in wanted.items():
        if getattr(found, name).shape != shape:
            raise InputError(f"{path}, {name}", f"is {getattr(found, name).shape}, the rest of the file says {shape}",
                             again)


def _from_groups(path: Path, data) -> Posterior:
    found = {name: _group(data, name) for name in GROUPS}
    groups = {name: group for name, group in found.items() if group is not None}
    missing = [name for name in GROUPS if name not in groups]
    if missing:
        raise InputError(str(path), f"group {missing[0]} is missing", "give a posterior.nc of `probupdate sample`")
    text = groups["posterior"].attrs.get("probupdate")
    if text is None:
        raise InputError(str(path), "was not written by probupdate sample", "give the file of that step")
    head = json.loads(text)
    if isinstance(head.get("format"), int) and head["format"] > FORMAT:
        raise InputError(str(path), f"has the format {head['format']}; {FORMAT} is the newest known",
                         "read it with the version that wrote it, or sample again")
    names = tuple(head["names"])

    def columns(group) -> np.ndarray:
        return np.stack([group[name].values for name in variables_of(names)], axis=-1)

    def walkers(values: np.ndarray) -> np.ndarray:
        """(n_walker, n_step, ...) of the file's chains, which before format 3 were the walkers."""
        return values.reshape(int(head.get("walkers", len(values))), -1, *values.shape[2:])

    observed = groups["observed_data"]
    found = Posterior(
        names=names, theta=frozen_array(walkers(columns(groups["posterior"]))),
        log_likelihood=frozen_array(walkers(groups["log_likelihood"]["response"].values)),
        log_posterior=frozen_array(walkers(groups["sample_stats"]["lp"].values)),
        prior=frozen_array(columns(groups["prior"])[0]),
        response_labels=tuple(str(x) for x in observed["response_label"].values),
        measured=frozen_array(observed["response"].values), std=frozen_array(observed["response_std"].values),
        predicted=frozen_array(observed["response_predicted"].values),
        frequency_hz=frozen_array(observed["frequency_hz_predicted"].values),
        mode_labels=tuple(str(x) for x in observed["mode"].values),
        r_hat=frozen_array(head["r_hat"]), ess=frozen_array(head["ess"]), converged=head["converged"],
        verdict=head["verdict"], fingerprint=head["fingerprint"], record=head["record"],
        model_error=None if "model_error" not in observed else LearntError.from_table(
            json.loads(str(observed["model_error"].values))),
    )
    if head.get("format") != 1 and head.get("content") != _content_hash(head, found):
        raise InputError(str(path), "was changed after it was written: its content is not what its own hash says",
                         "write it again with `probupdate sample` (the chain beside it is kept), or take the file that "
                         "was written")
    return found


def _group(data, name: str):
    """A group as a dataset in both generations of ArviZ, or None."""
    try:
        group = data[name]
    except KeyError:
        return None
    # a group of a DataTree is a node, of an InferenceData the dataset itself
    return group.to_dataset() if hasattr(group, "to_dataset") else group
