"""A model at every nacelle angle on one small basis: modes and exact derivatives in milliseconds.

The mass terms of rotor and nacelle are polynomials of second degree in the cosine and sine of the nacelle's angle, so
that five angles give them at any other exactly. The basis holds modes from all over the prior, of every effect and
angle, and the first-order change of the wanted modes with every parameter; how far it may be trusted is measured on
points that took no part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from probupdate.diagnosis.part_places import PartKey
from probupdate.errors import ConvergenceError
from probupdate.model.interface import Wireframe
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.moved_channels import MovedChannels, rows_moved
from probupdate.structure.projected_terms import Expansion, ProjectedTerms
from probupdate.structure.readings import FeltGravity, channel_readings, reading_slopes

# angles that determine a trigonometric polynomial of second degree
TURNS_DEG = tuple(72.0 * k for k in range(5))
# models at single parameter values that are kept
N_KNOWN = 6
# modes of the mean over all angles from which the lowest ones at an angle are made
N_CORE = 80
# angles at which derivatives are taken at once
PLACES = 18
# eigenvalues nearer to each other (relative): what turns their shapes into each other is given no more than they would
# have at this distance, as no first-order change holds there
EQUAL = 1e-3
# standard deviation of ln f of a mass on a spring about the frequency it is given; how near that (in
# (f / f_own)^2) no first-order change holds, as the two modes share their shapes
TUNING_STD, NEAR_TUNING = 0.06, 0.05


@dataclass(frozen=True, eq=False, kw_only=True)
class Slopes:
    """Derivatives with n parameters: for stiffness and mass the terms by harmonics of the nacelle's angle, and their
    weights (n, n_term); of those that move channels their number among the n and what they do to the rows (n_row, r);
    of those that change what readings hold of gravity their number and the change (n_channel,); of masses and
    frequencies of tuned masses their number among the n, the mass, and which of both it is."""

    terms: tuple[tuple[tuple[ProjectedTerms, ...], np.ndarray], ...]
    rows: tuple[tuple[int, np.ndarray], ...]
    felt: tuple[tuple[int, np.ndarray], ...] = ()
    tuned: tuple[tuple[int, TunedMass, bool], ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class SmallModes:
    """Modes of the basis at one point: frequency_hz (n,), vectors (r, n) of unit modal mass, and these on the core
    modes (n_core, n) that they were made from; `n_search`: how many of them are looked through, if not as many as of
    the model."""

    frequency_hz: np.ndarray
    vectors: np.ndarray
    on_core: np.ndarray
    n_search: int | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Attachment:
    """A part put on the basis: the rows F (n, r) of what one `unit` of its parameter adds, F^T F, to stiffness or
    mass, and its prior; `where`: words for its place and direction. A thousand parts are two megabytes as rows, and
    hundreds as matrices. A mass with a frequency in its key hangs on springs with which it has that frequency, along
    each of its rows."""

    key: PartKey
    where: str = ""
    unit: str = ""
    std: float = 1.0
    lower: float = -np.inf
    upper: float = np.inf
    stiffness: np.ndarray | None = None
    mass: np.ndarray | None = None

    @property
    def tuned_hz(self) -> float | None:
        return self.key.tuned_hz

    def to_tuned_mass(self, column: int, tuning: int) -> TunedMass:
        """The mass on springs whose mass and tuning are these parameters. Raises ValueError where it is none."""
        if self.mass is None or self.tuned_hz is None:
            raise ValueError(f"{self.key.parameter} is no mass on springs")
        return TunedMass(column=column, tuning=tuning, rows=self.mass, hz=self.tuned_hz)


@dataclass(frozen=True, eq=False, kw_only=True)
class TunedMass:
    """A mass on springs, one along each of its unit rows F (n, r): `column` its mass among the model's parameters,
    `tuning` what is added to ln of its frequency `hz`."""

    column: int
    tuning: int
    rows: np.ndarray
    hz: float

    def square(self, theta: np.ndarray) -> float:
        """Its circular frequency squared."""
        return float((2 * np.pi * self.hz) ** 2 * np.exp(2 * theta[self.tuning]))

    def relative(self, own: slice, n: int) -> np.ndarray:
        """(n_row, n) what stretches its springs, of a basis of n with its own motion in the columns `own`."""
        result = np.zeros((len(self.rows), n))
        result[:, : self.rows.shape[1]] = self.rows
        result[:, own] = -np.eye(len(self.rows))
        return result


@dataclass(frozen=True, eq=False, kw_only=True)
class SmallModel:
    """K and M on the basis: stiffness, mass by harmonics of the nacelle's angle, the coefficients of 1, cos a, sin a,
    cos 2a, sin 2a, or of 1 alone where nothing turns; `about`: an expansion of either's mean over all angles.

    `frequency_error` is the largest relative error found against the full model on points not used for the basis;
    at_channels (n_row, r) the channels' motion and tilt (`AffineModel.rows`), which parameters may move (`moved`), and
    `gravity` what they hold of it. `wire` is the model's picture at rest, at_nodes (3 n_node, r) the motion of its
    nodes. `bare`: the model that parts were attached to.
    """

    name: str
    parameters: Parameters
    channels: tuple[str, ...]
    coefficients: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    stiffness: tuple[ProjectedTerms, ...]
    mass: tuple[ProjectedTerms, ...]
    about: tuple[Expansion, Expansion] = field(repr=False)
    at_channels: np.ndarray
    n_search: int
    frequency_error: float
    fingerprint: str
    wire: Wireframe | None = None
    at_nodes: np.ndarray | None = field(default=None, repr=False)
    moved: tuple[MovedChannels, ...] = field(default=(), repr=False)
    gravity: FeltGravity | None = field(default=None, repr=False)
    tuned: tuple[TunedMass, ...] = field(default=(), repr=False)
    known: dict[bytes, LocalModel] = field(default_factory=dict, repr=False)
    bare: SmallModel | None = field(default=None, repr=False)

    @property
    def picture(self) -> tuple[Wireframe, np.ndarray]:
        """`wire` and `at_nodes`. Raises ValueError where the model has none."""
        if self.wire is None or self.at_nodes is None:
            raise ValueError(f"{self.name} has no picture: its nodes have no places")
        return self.wire, self.at_nodes

    @property
    def motions(self) -> np.ndarray:
        """(n_channel, r) the motion of the channels' places."""
        return self.at_channels[: len(self.channels)]

    def with_gravity(self, felt: Mapping[str, bool]) -> SmallModel:
        """As `AffineModel.with_gravity`."""
        return self if self.gravity is None else replace(
            self, gravity=self.gravity.with_gravity(felt, self.channels), known={},
            bare=None if self.bare is None else self.bare.with_gravity(felt))

    @property
    def turns(self) -> bool:
        """Whether the nacelle's angle changes anything."""
        return any(len(part.moved) for part in (*self.stiffness[1:], *self.mass[1:]))

    def evaluate(self, theta: np.ndarray) -> LocalModel:
        """The model at theta (n_param,); the last few are kept."""
        theta = np.array(theta, float)
        key = theta.tobytes()
        if key not in self.known:
            if len(self.known) >= N_KNOWN:
                self.known.pop(next(iter(self.known)))
            self.known[key] = LocalModel(small=self, theta=theta)
        return self.known[key]

    def attach_parts(self, parts: Sequence[Attachment]) -> SmallModel:
        """The model with these parts, none of them there at first, each a parameter behind its own, and behind all of
        them what is added to ln of the frequency of each tuned mass."""
        own, tuned = len(self.parameters), [k for k, part in enumerate(parts) if part.tuned_hz is not None]
        stiff = {k: part.stiffness for k, part in enumerate(parts) if part.stiffness is not None}
        heavy = {k: part.mass for k, part in enumerate(parts) if part.mass is not None and k not in tuned}
        coefficients = _WithParts(coefficients=self.coefficients, n_own=own, stiff=tuple(stiff), heavy=tuple(heavy))
        added = [Parameter(name=p.key.parameter, unit=p.unit, initial=0.0, std=p.std, lower=p.lower, upper=p.upper)
                 for p in parts]
        added += [Parameter(name=f"{parts[k].key.parameter}, tuning", unit="-", initial=0.0, std=TUNING_STD)
                  for k in tuned]
        hung = tuple(parts[k].to_tuned_mass(own + k, own + len(parts) + i) for i, k in enumerate(tuned))
        correlation = self.parameters.correlation
        if correlation is not None:
            correlation = linalg.block_diag(correlation, np.eye(len(added)))
        return replace(
            self, parameters=Parameters((*self.parameters.items, *added), correlation), coefficients=coefficients,
            stiffness=(self.stiffness[0].with_added([*stiff.values()]), *self.stiffness[1:]),
            mass=(self.mass[0].with_added([*heavy.values()]), *self.mass[1:]), tuned=(*self.tuned, *hung), known={},
            bare=self,
        )


@dataclass(frozen=True, kw_only=True)
class _WithParts:
    """A model's coefficients of its `n_own` parameters and, behind them, those of the parts that are `stiff` or `heavy`
    (their numbers): a value, as it goes to other processes with its model."""

    coefficients: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    n_own: int
    stiff: tuple[int, ...]
    heavy: tuple[int, ...]

    def __call__(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cK, cM = self.coefficients(theta[..., : self.n_own])
        added = theta[..., self.n_own :]
        return (np.concatenate([cK, added[..., list(self.stiff)]], -1),
                np.concatenate([cM, added[..., list(self.heavy)]], -1))


@dataclass(frozen=True, eq=False, kw_only=True)
class LocalModel:
    """The small model at one theta."""

    small: SmallModel
    theta: np.ndarray

    @cached_property
    def _tuned_masses(self) -> list[tuple[TunedMass, slice]]:
        """The tuned masses that are there, and their own degrees of freedom, behind those of the basis."""
        result, start = [], self.small.at_channels.shape[1]
        for one in self.small.tuned:
            if self.theta[one.column] > 0:
                result.append((one, slice(start, start + len(one.rows))))
                start += len(one.rows)
        return result

    @property
    def has_tuned_mass(self) -> bool:
        """Whether any tuned mass is there."""
        return bool(self._tuned_masses)

    @property
    def size(self) -> int:
        """Degrees of freedom."""
        return self._tuned_masses[-1][1].stop if self._tuned_masses else self.small.at_channels.shape[1]

    @property
    def n_search(self) -> int:
        """The lowest modes that are looked through for the measured ones: a tuned mass brings its own."""
        return self.small.n_search + self.size - self.small.at_channels.shape[1]

    @cached_property
    def _coefficients(self) -> tuple[np.ndarray, np.ndarray]:
        return self.small.coefficients(self.theta)

    def matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and mass (n, n) of the mean over all angles; not kept, as solutions need what few modes make of
        them alone."""
        small = self.small
        stiffness, mass = (about.evaluate(self.theta, parts[0], weight) for about, weight, parts in
                           zip(small.about, self._coefficients, (small.stiffness, small.mass), strict=True))
        if self._tuned_masses:
            more = self.size - len(stiffness)
            stiffness, mass = (np.pad(part, ((0, more), (0, more))) for part in (stiffness, mass))
            for one, own in self._tuned_masses:
                amount, relative = self.theta[one.column], one.relative(own, self.size)
                stiffness += amount * one.square(self.theta) * relative.T @ relative
                mass[own, own] += amount * np.eye(len(one.rows))
        return stiffness, mass

    @cached_property
    def at_channels(self) -> np.ndarray:
        """(n_row, n) motion and tilt of the channels here."""
        return self._padded_rows(rows_moved(self.small.at_channels, self.small.moved, self.theta))

    def _padded_rows(self, rows: np.ndarray) -> np.ndarray:
        """(..., n) of rows on the basis (..., r): a tuned mass by itself moves nothing."""
        more = self.size - rows.shape[-1]
        return np.concatenate([rows, np.zeros((*rows.shape[:-1], more))], axis=-1) if more else rows

    @cached_property
    def _core(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The N_CORE lowest modes of the mean over all angles (r, n), the harmonics of both matrices on them, and what
        the modes above these give way at the channels (n_row, r) when forces act on the basis."""
        if self._bare is not None:
            return self._bare._core
        value, vectors = linalg.eigh(*self.matrices())
        core, above = vectors[:, :N_CORE], vectors[:, N_CORE:]
        residual = (self.at_channels @ above / value[N_CORE:]) @ above.T
        on_basis = core[: self.small.at_channels.shape[1]]
        mean = np.diag(value[:N_CORE]), np.eye(core.shape[1])
        stiffness, mass = (np.array([still, *(part.project_between(weight[: len(part)], on_basis)
                                              for part in parts[1:])]) for still, weight, parts in
                           zip(mean, self._coefficients, (self.small.stiffness, self.small.mass), strict=True))
        return core, stiffness, mass, residual

    def solve(self, angle_deg: float = 0.0, count: int | None = None) -> SmallModes:
        """The lowest `count` modes with the nacelle at that angle (default and at most N_CORE), from those of the mean
        over all angles, which turn little (frequencies to 1e-5, shapes to 3e-4 of their largest)."""
        try:
            core, stiffness, mass, _ = self._core
            if len(stiffness) == len(mass) == 1:
                # nothing turns, and the core's modes are these
                value, vectors = np.diag(stiffness[0])[:count], np.eye(core.shape[1])[:, :count]
                return SmallModes(frequency_hz=np.sqrt(np.maximum(value, 0)) / (2 * np.pi), vectors=core[:, :count],
                                  on_core=vectors)
            wave = angle_harmonics(angle_deg)[: len(stiffness)]
            value, vectors = linalg.eigh(np.tensordot(wave, stiffness, 1), np.tensordot(wave, mass, 1),
                                         subset_by_index=None if count is None else (0, min(count, len(core.T)) - 1))
        except linalg.LinAlgError as error:
            raise ConvergenceError(f"{self.small.name}: no modes on the small basis ({error})", self.theta) from None
        return SmallModes(frequency_hz=np.sqrt(np.maximum(value, 0)) / (2 * np.pi), vectors=core @ vectors,
                          on_core=vectors)

    def modes_at(self, angle_deg: float) -> SmallModes:
        """All modes there, kept: more than once is asked how they change."""
        bare = self._bare
        if bare is not None:
            return bare.modes_at(angle_deg)
        if angle_deg not in self._solved_modes:
            self._solved_modes[angle_deg] = self.solve(angle_deg)
        return self._solved_modes[angle_deg]

    @cached_property
    def _solved_modes(self) -> dict[float, SmallModes]:
        return {}

    @cached_property
    def _bare(self) -> LocalModel | None:
        """The same without parts of which none is there."""
        bare = self.small.bare
        if bare is None or self.theta[len(bare.parameters) :].any():
            return None
        return bare.evaluate(self.theta[: len(bare.parameters)])

    @cached_property
    def paired(self) -> dict[tuple[bytes, str], tuple[tuple[np.ndarray, ...], list[tuple[int, ...]]]]:
        """Which of the modes at rest are measured ones: by a predictor's state and what its sensors do, the planes that
        were measured and the modes of each group."""
        return {}

    @cached_property
    def resting_modes(self) -> SmallModes:
        """The modes looked through, with the nacelle as in the model."""
        return self.solve(0.0, self.n_search)

    def shapes(self, modes: SmallModes, count: int) -> np.ndarray:
        """(n_channel, count) of the lowest modes."""
        value = (2 * np.pi * modes.frequency_hz[:count]) ** 2
        return channel_readings(self.at_channels @ modes.vectors[:, :count], value, self.held)

    @cached_property
    def held(self) -> np.ndarray | None:
        """(n_channel,) what of gravity the readings hold here."""
        return None if self.small.gravity is None else self.small.gravity.evaluate(self.theta)

    def slopes(self, columns: Sequence[int]) -> Slopes:
        """Derivatives with the parameters `columns`."""
        small, columns = self.small, list(columns)
        cK, cM = small.coefficients(self.theta + 1e-30j * np.eye(self.theta.size)[columns])
        rows = tuple((columns.index(m.column), m.slope(float(self.theta[m.column])))
                     for m in small.moved if m.column in columns)
        felt = () if small.gravity is None else tuple(
            (columns.index(column), slope) for column, slope in small.gravity.slopes() if column in columns)
        number = {column: k for k, column in enumerate(columns)}
        tuned = tuple((number[column], one, column == one.column) for one in small.tuned
                      for column in (one.column, one.tuning) if column in number)
        return Slopes(terms=((small.stiffness, np.imag(cK) / 1e-30), (small.mass, np.imag(cM) / 1e-30)), rows=rows,
                      felt=felt, tuned=tuned)

    def derivatives(
        self, slopes: Slopes, places: Sequence[tuple[float, SmallModes, Sequence[Sequence[int]]]]
    ) -> list[list[tuple[np.ndarray, np.ndarray]]]:
        """At every place (nacelle's angle in degrees, modes there, clusters of them, ascending) for each cluster:
        d(Phi^T K Phi - lambda Phi^T M Phi) (k, k, n_param) between its members, lambda the mean of the two, and d shape
        (n_channel, k, n_param) without their rotation into each other; for the parameters of `slopes`."""
        result = []
        # those of a month's headings together are as large as all else
        for first in range(0, len(places), PLACES):
            result += self._derivatives(slopes, places[first : first + PLACES])
        return result

    def _derivatives(self, slopes: Slopes, places) -> list[list[tuple[np.ndarray, np.ndarray]]]:
        # of what forces do to modes only this is asked: by how much they move the core's modes, and what gives way
        onto = np.concatenate([self._core[0], self._core[-1].T], axis=1)
        wanted = [modes.vectors[:, [i for own in clusters for i in own]] for _, modes, clusters in places]
        ends, together = np.cumsum([0, *(phi.shape[1] for phi in wanted)]), np.hstack(wanted)
        size = self.small.at_channels.shape[1]
        harmonics = np.repeat([angle_harmonics(angle) for angle, _, _ in places], np.diff(ends), axis=0)
        products = []
        for (still, *turning), weight in slopes.terms:
            product = still.times(weight, together[:size], onto[:size])
            for wave, part in zip(harmonics.T[1:], turning, strict=False):
                own = weight[:, : len(part)]
                rows = np.flatnonzero(np.any(own[:, part.moved], axis=1))
                if len(rows):
                    product[rows] += wave[:, None] * part.times(own[rows], together[:size], onto[:size])
            products.append(product)
        value = np.concatenate([(2 * np.pi * modes.frequency_hz[[i for own in clusters for i in own]]) ** 2
                                for _, modes, clusters in places])
        self._add_tuned(slopes, together, onto, value, *products)
        return [self._changes([product[:, start:end] for product in products], slopes, modes, clusters)
                for (_, modes, clusters), start, end in zip(places, ends, ends[1:], strict=False)]

    def _add_tuned(self, slopes: Slopes, together, onto, value, stiff: np.ndarray, heavy: np.ndarray) -> None:
        """Adds what masses and frequencies of tuned masses change: Phi^T dK Y and Phi^T dM Y (n_param, n_mode, m) of
        modes `together` with these eigenvalues, Y what they are asked `onto`. One that is not there yet is
        m / (1 - lambda / omega^2) for each mode."""
        there = {one.column: own for one, own in self._tuned_masses}
        for number, one, of_mass in slopes.tuned:
            square = one.square(self.theta)
            if one.column in there:
                own = there[one.column]
                relative = one.relative(own, self.size)
                amount = square if of_mass else 2 * square * self.theta[one.column]
                stiff[number] += amount * (relative @ together).T @ (relative @ onto)
                if of_mass:
                    heavy[number] += together[own].T @ onto[own]
            elif of_mass:
                away = 1 - value / square
                followed = away / (away**2 + NEAR_TUNING**2)
                n = one.rows.shape[1]
                heavy[number] += followed[:, None] * ((one.rows @ together[:n]).T @ (one.rows @ onto[:n]))

    def _changes(self, parts, slopes: Slopes, modes: SmallModes, clusters) -> list[tuple[np.ndarray, np.ndarray]]:
        """`derivatives` at one place from Phi^T dK and Phi^T dM on the core's modes and on what those above it give way
        at the channels (n_param, all members, n_core + n_row): modes of the core one by one, those above it all of
        them together; and from what `slopes` say of the channels' rows."""
        value = (2 * np.pi * modes.frequency_hz) ** 2
        at_channels = self.at_channels @ modes.vectors
        n_row, result, start = len(at_channels), [], 0
        given = np.concatenate([np.zeros((n_row, len(modes.on_core))), -np.eye(n_row)], axis=1)
        for members in map(list, clusters):
            own_value, onto = value[members], np.pad(modes.on_core[:, members].T, ((0, 0), (0, n_row)))
            outside = np.ones(len(value), bool)
            outside[members] = False
            dK, dM, change = [], [], []
            for j, at in enumerate(own_value):
                gap = at - value[outside]
                share = gap / (gap**2 + (EQUAL * at) ** 2)
                # what a force on the basis does to this mode at the channels, and to the members' products
                given[:, : -n_row or None] = (at_channels[:, outside] * share) @ modes.on_core[:, outside].T
                stiff, heavy = (part[:, start + j] @ np.concatenate([given, onto]).T for part in parts)
                dK.append(stiff[:, n_row:])
                dM.append(heavy[:, n_row:])
                change.append((stiff - at * heavy)[:, :n_row] - 0.5 * dM[-1] @ at_channels[:, members].T)
            start += len(members)
            mean = 0.5 * (own_value[:, None] + own_value[None, :])
            coupling = (np.stack(dK, axis=2) - mean * np.stack(dM, axis=2)).transpose(1, 2, 0)
            moved = np.stack(change, axis=2)
            for number, own in slopes.rows:
                moved[number] += own @ modes.vectors[: own.shape[1], members]
            seen = at_channels[:, members]
            read = reading_slopes(seen, moved.transpose(1, 2, 0), own_value, coupling, self.held)
            for number, own in slopes.felt:
                read[:, :, number] += own[:, None] * seen[len(own) :] / own_value
            result.append((coupling, read))
        return result


def angle_harmonics(angle_deg: float) -> np.ndarray:
    """(5,) of a second-degree polynomial in cosine and sine of an angle in degrees."""
    a = np.radians(angle_deg)
    return np.array([1.0, np.cos(a), np.sin(a), np.cos(2 * a), np.sin(2 * a)])
