"""What states of a structure have shown of its model's error, carried from one run to the next.

Responses of a state are y = g(theta) + m + delta + eps with delta ~ N(0, D), one vector of a structure. Linear about
the maximum a state says w = W delta + V theta + n, n ~ N(0, 1), whatever D is (Kennedy & O'Hagan 2001). Its prior
integrates out what of theta is this state's own; rows of several states then stand below one another. The next state
has delta's posterior given them as its prior, with the same scales of D; rows in which parameters of its own occur are
responses beside the measured ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from probupdate.errors import InputError
from probupdate.model.uncertainty import marginal_root
from probupdate.runtime.arrays import frozen_array
from probupdate.updating.error_states import FREQUENCY, SHAPE, ErrorOrigins
from probupdate.updating.settings import CONSTANTS

# a frequency farther than this factor from the baseline's is another structure's, and so is a shape of less MAC
FAR, ALIKE = 1.5, CONSTANTS.settling_mac
# of a stored error, by the number of their columns
ARRAYS = ("measured", "value", "mean", "left", "centre")
TABLES = {"covariance": "names", "slope": "parameters", "spread": "parameters"}


@dataclass(frozen=True, eq=False, kw_only=True)
class Rows:
    """w = W delta + V theta + n, n ~ N(0, 1): value w (n_row,), matrix W (n_row, n_unknown), slope V (n_row,
    n_param) of the parameters of these names."""

    value: np.ndarray
    matrix: np.ndarray
    slope: np.ndarray
    parameters: tuple[str, ...]

    def stack_below(self, others: Sequence[Rows]) -> Rows:
        """All of them, in no more rows than are needed; the others' parameters are some of these."""
        n, every = self.matrix.shape[1], []
        for rows in (self, *others):
            slope = np.zeros((len(rows.value), len(self.parameters)))
            slope[:, [self.parameters.index(name) for name in rows.parameters]] = rows.slope
            every.append(np.column_stack([rows.matrix, slope, rows.value]))
        stacked = np.vstack(every)
        if len(stacked) > stacked.shape[1]:
            stacked = np.linalg.qr(stacked)[1]
        return replace(self, matrix=stacked[:, :n], slope=stacked[:, n:-1], value=stacked[:, -1])

    def place(self, start: int, n: int) -> Rows:
        """Of n unknowns, of which these are some from number `start` on."""
        matrix = np.zeros((len(self.value), n))
        matrix[:, start : start + self.matrix.shape[1]] = self.matrix
        return replace(self, matrix=matrix)

    def marginal(self, centre: np.ndarray, covariance: np.ndarray, kept: Sequence[str] = ()) -> Rows:
        """With theta ~ N(centre, covariance) integrated out, but for the parameters kept."""
        own = np.array([name in kept for name in self.parameters], bool)
        across = covariance[np.ix_(~own, own)] @ np.linalg.inv(covariance[np.ix_(own, own)])
        rest = covariance[np.ix_(~own, ~own)] - across @ covariance[np.ix_(own, ~own)]
        out = self.slope[:, ~own]
        root, _ = marginal_root(np.eye(len(self.value)), out @ np.linalg.cholesky(rest))
        return Rows(value=root @ (self.value - out @ (centre[~own] - across @ centre[own])), matrix=root @ self.matrix,
                    slope=root @ (self.slope[:, own] + out @ across),
                    parameters=tuple(name for name, there in zip(self.parameters, own, strict=True) if there))

    def split(self) -> tuple[Rows, Rows]:
        """Rows with parameters, as many as there are, and rows without, turned so that their noise stays what it is."""
        if not self.parameters:
            return replace(self, value=self.value[:0], matrix=self.matrix[:0], slope=self.slope[:0]), self
        turn = np.linalg.qr(self.slope, mode="complete")[0]
        whole = replace(self, value=turn.T @ self.value, matrix=turn.T @ self.matrix, slope=turn.T @ self.slope)
        n = len(self.parameters)
        first, rest = (replace(whole, value=whole.value[rows], matrix=whole.matrix[rows], slope=whole.slope[rows])
                       for rows in (slice(0, n), slice(n, None)))
        return first, replace(rest, slope=rest.slope[:, :0], parameters=())

    def log_evidence(self, covariance: np.ndarray) -> float:
        """ln p(w) up to a constant, delta ~ N(0, covariance)."""
        root = linalg.cholesky(np.eye(len(self.value)) + self.matrix @ covariance @ self.matrix.T, lower=True)
        white = linalg.solve_triangular(root, self.value, lower=True)
        return float(-0.5 * white @ white - np.log(np.diag(root)).sum())

    def posterior(self, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of delta given w."""
        across = self.matrix @ covariance
        inner = linalg.cho_factor(np.eye(len(self.value)) + across @ self.matrix.T, lower=True)
        return across.T @ linalg.cho_solve(inner, self.value), covariance - across.T @ linalg.cho_solve(inner, across)


@dataclass(frozen=True, eq=False, kw_only=True)
class LearntError:
    """delta of a structure after the states that a run was given, as its result file holds it.

    names: of each unknown ("frequency", mode) or ("shape", modes, component, channel); measured (n,): that frequency in
    Hz, or the component of the measured shape, whose scale the unknown has; frequencies are missed by shares of
    themselves. matrix (n_row, n), value (n_row,), slope (n_row, n_param), parameters: `Rows`, with centre (n_param,)
    and spread (n_param, n_param) of their prior. mean, covariance: of the posterior, averaged over the scales;
    left (n,): its variance over the prior's, NaN of what has none. scales: 5 and 95 % of each. data: hashes of the
    states' measured modes; tolerances: stated ones of the model are part of delta. source: the file.
    """

    model: str
    states: tuple[str, ...]
    data: tuple[str, ...]
    tolerances: bool
    names: tuple[tuple[str, ...], ...]
    measured: np.ndarray
    origins: tuple[ErrorOrigins, ...]
    matrix: np.ndarray
    value: np.ndarray
    parameters: tuple[str, ...]
    slope: np.ndarray
    centre: np.ndarray
    spread: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    left: np.ndarray
    scales: Mapping[str, tuple[float, float]]
    source: str = ""

    def to_table(self) -> dict[str, Any]:
        """As JSON has it; `source` is where that lies."""
        table = asdict(self)
        del table["source"]
        # the covariance and the rows are most of a file
        plain = {k: [[float(f"{x:.9g}") for x in row] for row in table[k].tolist()] for k in ("matrix", *TABLES)}
        left = [x if np.isfinite(x) else None for x in self.left.tolist()]
        origins = [state.to_table() for state in self.origins]
        return table | {k: table[k].tolist() for k in ARRAYS} | plain | {"left": left, "origins": origins}

    @classmethod
    def from_table(cls, table: Mapping[str, Any], source: str = "") -> LearntError:
        """Raises KeyError, TypeError or ValueError where a part lacks or does not fit."""
        n, n_param = len(table["names"]), len(table["parameters"])
        arrays = {k: np.array([np.nan if x is None else x for x in table[k]], float) for k in ARRAYS}
        arrays |= {k: np.array(table[k], float).reshape(-1, len(table[columns])) for k, columns in TABLES.items()}
        origins = tuple(ErrorOrigins.from_table(state) for state in table["origins"])
        arrays["matrix"] = np.array(table["matrix"], float).reshape(-1, sum(len(one.effect) for one in origins))
        found = cls(**{**table, **{k: frozen_array(v) for k, v in arrays.items()}, "source": source, "origins": origins,
                       "names": tuple(tuple(name) for name in table["names"]),
                       **{k: tuple(table[k]) for k in ("states", "data", "parameters")},
                       "scales": {k: tuple(v) for k, v in table["scales"].items()}})
        sizes = [found.measured.shape, found.mean.shape, found.left.shape, (len(found.covariance),)]
        of_parameters = found.centre.shape == (n_param,) == (len(found.spread),)
        kinds = {FREQUENCY: 2, SHAPE: 4}
        named = all(name and kinds.get(name[0]) == len(name) for name in found.names)
        rows = len(found.matrix) == len(found.slope) == len(found.value)
        if any(size != (n,) for size in sizes) or len(origins[-1].effect) != n or not (
                rows and named and of_parameters):
            raise ValueError("parts of the model's error do not fit one another")
        hz = [x for name, x in zip(found.names, found.measured, strict=True) if name[0] == FREQUENCY]
        numbers = (getattr(found, k) for k in (*ARRAYS, *TABLES, "matrix") if k != "left")
        if not all(np.all(np.isfinite(part)) for part in numbers) or min(hz, default=1.0) <= 0:
            raise ValueError("the model's error holds what is not a number, or a frequency that is not positive")
        return found

    def resolved_words(self) -> str:
        """How much of the error the states resolve, by frequency and by shape."""
        share: dict[str, list[float]] = {}
        for name, left in zip(self.names, self.left, strict=True):
            if np.isfinite(left):
                share.setdefault(name[1] if name[0] == FREQUENCY else f"shape of {name[1]}", []).append(1 - left)
        return ", ".join(f"{what} {100 * np.mean(each):.0f} %" for what, each in share.items())


@dataclass(frozen=True, eq=False, kw_only=True)
class Unknowns:
    """The error of one problem's responses: names and measured as of `LearntError`; unit (n,): what one of a name's
    unit does to the response; data: hash of the measured modes; tolerances as of `Weights`."""

    names: tuple[tuple[str, ...], ...]
    measured: np.ndarray
    unit: np.ndarray
    data: str
    tolerances: bool

    def rows_of(self, known: LearntError, common: Sequence[str] = ()) -> Rows:
        """What a baseline says of these, and of parameters that are the same number in both. Raises InputError where it
        is of another structure or states other things."""
        _refuse_other(self, known)
        for name in common:
            if name not in known.parameters:
                raise InputError("common", f"'{name}' is no parameter of baseline {known.source}".rstrip(),
                                 f"give some of {', '.join(known.parameters)}")
        every = Rows(value=known.value, matrix=known.matrix, slope=known.slope, parameters=known.parameters)
        return every.marginal(known.centre, known.spread, common)

    def common_frequencies(self, known: LearntError) -> list[tuple[int, int]]:
        """Numbers of each here and in the baseline."""
        before = {name: j for j, name in enumerate(known.names)}
        return [(k, before[name]) for k, name in enumerate(self.names) if name[0] == FREQUENCY and name in before]

    def common_shapes(self, known: LearntError) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Of each shape or plane that both compare: its modes, numbers (n_channel, n_component) here and there."""
        before, groups = {name: j for j, name in enumerate(known.names)}, {}
        for k, name in enumerate(self.names):
            if name[0] == SHAPE and name in before:
                groups.setdefault(name[1], {}).setdefault(name[3], []).append((k, before[name]))
        found = [(modes, np.array(list(channels.values()))) for modes, channels in groups.items()]
        return [(modes, each[..., 0], each[..., 1]) for modes, each in found if each.shape[0] >= each.shape[1]]

    def used_words(self, known: LearntError, covariance: np.ndarray) -> str:
        """What of a baseline is used, by the covariance of its last state's errors and these, in this order."""
        root, n = np.sqrt(np.diag(covariance)), len(known.names)
        alike = [f"{self.names[k][1]} {covariance[j, n + k] / (root[j] * root[n + k]):.3f}"
                 for k, j in self.common_frequencies(known)]
        return (f"baseline {known.source or known.model}: the model's error as {', '.join(known.states)} showed it; "
                f"its correlation with the one here, by how modes turned: {', '.join(alike)}")


def _refuse_other(own: Unknowns, known: LearntError) -> None:
    """Raises InputError for a baseline that says nothing of these responses, or nothing that is meant here."""
    where = f"baseline {known.source}".rstrip()
    if own.data in known.data:
        raise InputError(where, "holds these same data, which would count twice", "give a run of another state")
    if own.tolerances != known.tolerances:
        counts = "counts" if known.tolerances else "does not count"
        raise InputError(where, f"{counts} the model's stated tolerances as part of its error, unlike this run",
                         "run both with --tolerances, or both with --no-tolerances")
    common = own.common_frequencies(known)
    if not common:
        theirs, ours = ([name[1] for name in names if name[0] == FREQUENCY] for names in (known.names, own.names))
        raise InputError(where, f"is of other modes: {', '.join(theirs)}, here {', '.join(ours)}",
                         "give a run of the same structure whose modes have the same labels")
    near = "give a run of this structure in a state near this one"
    for k, j in common:
        if abs(np.log(own.measured[k] / known.measured[j])) > np.log(FAR):
            raise InputError(where, f"is of another structure: its {own.names[k][1]} lies at "
                             f"{known.measured[j]:.4g} Hz, here at {own.measured[k]:.4g} Hz", near)
    for modes, k, j in own.common_shapes(known):
        planes = np.linalg.qr(own.measured[k])[0], np.linalg.qr(known.measured[j])[0]
        mac = float(np.linalg.svd(planes[0].T @ planes[1], compute_uv=False).min() ** 2)
        if mac < ALIKE:
            raise InputError(where, f"is of another structure: the MAC of its {modes} with this one is {mac:.2f}", near)
    channels = [{name[3] for name in names if name[0] == SHAPE} for names in (own.names, known.names)]
    if channels[0] and channels[1] and not channels[0] & channels[1]:
        raise InputError(where, "has no channel in common with these data",
                         "give a run with the same names of channels")


def join_baselines(known: Sequence[LearntError], own: Unknowns, common: Sequence[str] = ()) -> Rows:
    """What several baselines say of these. Raises InputError where two hold the same state."""
    seen: dict[str, str] = {}
    for one in known:
        for data in one.data:
            if data in seen:
                raise InputError(f"baseline {one.source}", f"holds a state that {seen[data]} holds too",
                                 "a run that was given a baseline holds it already: give the last one alone")
            seen[data] = one.source or one.model
    rows, start = [], 0
    before = sum(one.matrix.shape[1] for one in known)
    for one in known:
        found = own.rows_of(one, common)
        rows.append(found.place(start, before + len(own.names)))
        start += one.matrix.shape[1]
    return rows[0].stack_below(rows[1:])
