"""Nominal stresses at a turbine's details from waves and wind, in the frequency domain.

(K - omega^2 M + i omega C + i omega c h h^T) q = F: C has a damping ratio for every mode, c = rho A C_T V is the
operating rotor's quasi-steady damping of the hub's motion along the wind. F is Morison's load on legs and braces with
drag linearised for the sea state (Borgman 1967: sqrt(8/pi) sigma_v) under Airy waves to the still water level, or
quasi-steady thrust at the hub. Member forces are what the element's own stiffness and mass make of q, less the load on
it, divided by A and I / R. Where the model has the weight's softening q has it too: the leaning weight adds its moment.
MacCamy-Fuchs, buoyancy, run-up and rotor harmonics are not in it, nor waves above 0.6 Hz: they
are shorter than 4.3 m, where Morison's load no longer holds for a leg.

All is solved on a basis of modes and static shapes of several parameter vectors (`StressModel.reduced`); of what is
left out, `fatigue.basis_error` reports at others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.errors import InputError
from probupdate.lifetime.conditions import Conditions, State, jonswap, kaimal, line_densities, rotor_admittance
from probupdate.lifetime.damping import StateDamping
from probupdate.lifetime.details import Detail
from probupdate.lifetime.modal_stress import ModalStress, Slopes, paired_moments, times
from probupdate.lifetime.spectral import ORDERS, counted_share
from probupdate.lifetime.wave_loads import Waves, waves_on_turbine
from probupdate.modal.modes import Sensor
from probupdate.model.parameters import Parameters
from probupdate.runtime.arrays import frozen_array
from probupdate.structure.affine import STEP, AffineModel
from probupdate.structure.assembly import beam_stiffness, carried_mass, steel_mass, transformation
from probupdate.structure.coefficient import Coefficients, TermCollector, build_coefficients
from probupdate.structure.description import Description, Offshore, described_sensors
from probupdate.structure.frame import Frame
from probupdate.structure.load import turbine_model
from probupdate.structure.mode_labels import labels_of_shapes
from probupdate.structure.subdyn_frame import SubDynFrame
from probupdate.structure.subdyn_model import Coefficients as SubDynCoefficients
from probupdate.structure.turbine_frame import build_frame

# frequencies of stress. From one cycle in ten minutes: S-N practice counts records of that length, and slower wind is
# another mean, not another cycle. Relative steps where wind alone acts, where waves do, and where modes may lie, from
# 0.6 of the lowest on; there at most 0.8 of the damping ratio, where trapezoids of a resonance err by
# 2 exp(-2 pi / 0.8) = 8e-4 of its variance. Of smaller ratios than the step (4e-3) the step is halved
LOWEST_HZ, WAVES_FROM_HZ, HIGHEST_HZ = 1 / 600, 0.03, 3.0
SMOOTH, COARSE, FINE = 0.05, 0.025, 0.008
BELOW_LOWEST, OF_RATIO = 0.6, 0.8
# the shortest waves that load the structure
WAVES_TO_HZ = 0.6
N_MODE, N_WAVE = 30, 20
# energy of a snapshot, relative, that the basis may leave out
BASIS_TOLERANCE, LOAD_TOLERANCE = 1e-10, 1e-3
# modes above it follow loads without their own dynamics but for powers of (f / DYNAMIC_HZ)^2, of waves up to the first,
# of thrust up to the second: 6e-6 and 2e-4 of their share at the highest frequencies; what of the waves' loads may be
# left out
DYNAMIC_HZ, WAVE_TOLERANCE = 12.0, 1e-5
# (lowest frequency over that of a mode)^2 from which it is without mass
MASSLESS = 1e-14
LABELLED = 10
# modes whose eigenvalues differ by less than this, relative, are equal but for rounding
EQUAL = 1e-9
# of a model's terms on the basis
KEPT_BYTES = 2e8


def frequency_grid(model: AffineModel, ratio: float) -> np.ndarray:
    """(n_frequency,) Hz, for a model whose modes are damped by this ratio and more."""
    value, _ = model.solve_full(model.parameters.initial, min(N_MODE, model.n_available))
    modes = float(np.clip(BELOW_LOWEST * np.sqrt(value[0]) / (2 * np.pi), WAVES_FROM_HZ, HIGHEST_HZ / 2))
    wind, low, high = (
        np.geomspace(start, end, max(2, int(np.log(end / start) / step)), endpoint=end == HIGHEST_HZ)
        for start, end, step in ((LOWEST_HZ, WAVES_FROM_HZ, SMOOTH), (WAVES_FROM_HZ, modes, COARSE),
                                 (modes, HIGHEST_HZ, min(FINE, OF_RATIO * ratio))))
    return frozen_array(np.unique(np.concatenate([wind, low, high])))


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """A state of sea and wind on this heading: load (n_basis, n_frequency) and own (3 n_detail, n_frequency) of a metre
    of wave amplitude, elevation and thrust (n_frequency,) densities in m^2/Hz and N^2/Hz, damping_nspm c in N s/m."""

    state: State
    load: np.ndarray
    own: np.ndarray
    elevation: np.ndarray
    thrust: np.ndarray
    damping_nspm: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Response:
    """At one parameter vector: frequency_hz (n_mode,); moments (n_case, 14, n_detail, 3, 3) in MPa^2 Hz^k, k of
    `spectral.ORDERS`, of nominal axial and bending stress at crown and saddle; with derivatives change (n_param,
    n_case, 14, n_detail, 3, 3)."""

    frequency_hz: np.ndarray
    moments: np.ndarray
    change: np.ndarray | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class StressModel:
    """One heading: the turbine's model, its member forces R_K(theta) - omega^2 R_M(theta) as sums of constant matrices
    (3 n_detail, n_free), the hub's rows (n_free,) along the wind and across it, to its left. `basis` (n_free, n_basis),
    None: all degrees of freedom; labels: of the modes, where they are known for all parameters that are asked for."""

    model: AffineModel
    sensors: tuple[Sensor, ...]
    frame: Frame | SubDynFrame
    details: tuple[Detail, ...]
    heading_deg: float
    conditions: Conditions
    site: tuple[float, float, float, float]
    stiffness_rows: tuple[sparse.csr_array, ...]
    mass_rows: tuple[sparse.csr_array, ...]
    coefficients: Coefficients | SubDynCoefficients
    waves: Waves
    hub: np.ndarray
    across: np.ndarray
    frequency_hz: np.ndarray
    spectra: Mapping[str, tuple[np.ndarray, np.ndarray]]
    basis: np.ndarray | None = None
    labels: tuple[str, ...] | None = None

    @property
    def parameters(self) -> Parameters:
        return self.model.parameters

    # the basis -------------------------------------------------------------------------------------------------------

    def _slow_loads(self) -> np.ndarray:
        """(n_free, n) thrust and waves of all states on this heading."""
        every = np.geomspace(WAVES_FROM_HZ, WAVES_TO_HZ, N_WAVE)
        inertia, drag = self.point_loads(every)
        slow = [inertia, *(np.repeat(sigma, 3)[:, None] * drag for sigma in self._speeds)]
        wave = self.waves.spread @ np.hstack([part(x) for x in slow for part in (np.real, np.imag)])
        # loads of neighbouring frequencies and states are much alike
        # on the axis of the waves' phase one part of each load is zero
        norm = np.linalg.norm(wave, axis=0)
        wave = wave[:, norm > 1e-12 * norm.max(initial=0.0)]
        left, size, _ = np.linalg.svd(wave / np.linalg.norm(wave, axis=0), full_matrices=False)
        return np.column_stack([self.hub, left[:, size > LOAD_TOLERANCE * size.max(initial=0.0)]])

    def rotate_loads(self) -> StressModel:
        """Under wind and waves from the right of these, by 90 degrees; rotor and nacelle as they stand."""
        return replace(self, heading_deg=self.heading_deg + 90.0, hub=self.across, across=-self.hub)

    def reduce(self, thetas: Sequence[np.ndarray], *, both_ways: bool = False) -> StressModel:
        """On the modes and static shapes under thrust and waves at these parameter vectors; `both_ways`: also of those
        across."""
        slow = self._slow_loads()
        if both_ways:
            slow = np.hstack([slow, self.rotate_loads()._slow_loads()])
        return self._projected_on_shapes([X for theta in thetas for X in self._shapes_under(theta, slow)])

    def reduced_for_derivatives(self, theta: np.ndarray) -> StressModel:
        """For stresses and their derivatives at theta alone: on its modes, the static shapes under thrust and waves,
        and those under what the details read. An error of a derivative is a product of the errors that these two kinds
        of shapes leave (adjoint), so that the modes' own changes need not be in the basis."""
        read = sum(c * R for c, R in zip(self.coefficients(theta)[0], self.stiffness_rows, strict=True)).toarray().T
        size = np.linalg.norm(read, axis=0)
        unit = read[:, size > 0] / size[size > 0]
        return self._projected_on_shapes(self._shapes_under(theta, np.hstack([self._slow_loads(), unit])))

    def _shapes_under(self, theta: np.ndarray, slow: np.ndarray) -> list[np.ndarray]:
        """The modes at theta, and the static shapes under the loads slow (n_free, n)."""
        K, _ = self.model.matrices(theta)
        _, phi = self.model.solve_full(theta, min(N_MODE, self.model.n_available))
        factor = sparse_linalg.splu(
            sparse.csc_matrix(K), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}
        )
        return [phi, factor.solve(slow)]

    def labelled_at(self, theta: np.ndarray) -> StressModel:
        """With the names that modes have at theta (n_param,)."""
        K, M, _, _ = self._matrices_at(theta)
        value, U = self._eigen(K, M, LABELLED)
        return replace(self, labels=self._labels(theta, U, value))

    def _projected_on_shapes(self, shapes: Sequence[np.ndarray]) -> StressModel:
        X = np.hstack(shapes)
        K0 = self.model.matrices(self.parameters.initial)[0]
        X = X / np.sqrt(np.einsum("ij,ij->j", X, K0 @ X))
        value, vector = np.linalg.eigh(X.T @ (K0 @ X))
        kept = value > BASIS_TOLERANCE * value[-1]
        return replace(self, basis=frozen_array(X @ (vector[:, kept] / np.sqrt(value[kept]))))

    def select(self, details: Sequence[int]) -> StressModel:
        """With these details only."""
        rows = (3 * np.asarray(details)[:, None] + np.arange(3)).ravel()
        one = replace(
            self,
            details=tuple(self.details[k] for k in details),
            stiffness_rows=tuple(R[rows] for R in self.stiffness_rows),
            mass_rows=tuple(R[rows] for R in self.mass_rows),
            waves=replace(self.waves, of_details=self.waves.of_details[rows]),
        )
        # what was made for all details already, as far as it is of none or of these
        made = self.__dict__
        one.__dict__.update({name: made[name] for name in ("_n_dynamic", "_speeds", "_wave_loads") if name in made})
        if "cases" in made:
            one.__dict__["cases"] = tuple(replace(case, own=case.own[rows]) for case in self.cases)
        if "_terms" in made:
            K, M, RK, RM = self._terms
            one.__dict__["_terms"] = K, M, *(tuple(R[rows] for R in own) for own in (RK, RM))
        return one

    def _project(self, vectors):
        return vectors if self.basis is None else self.basis.T @ vectors

    @cached_property
    def _terms(self) -> tuple[tuple[np.ndarray, ...], ...]:
        """K_t, M_t (n_basis, n_basis), R_K,t, R_M,t (3 n_detail, n_basis), full."""
        V = np.eye(self.model.n_dof) if self.basis is None else self.basis
        square = tuple(tuple(_congruence(X, V) for X in xs) for xs in (self.model.stiffness, self.model.mass))
        return (*square, *(tuple(np.asarray(R @ V) for R in rows) for rows in (self.stiffness_rows, self.mass_rows)))

    def _matrices_at(self, theta: np.ndarray) -> tuple[np.ndarray, ...]:
        """K, M, R_K, R_M at theta, on the basis."""
        rK, rM = self.coefficients(theta)
        V = np.eye(self.model.n_dof) if self.basis is None else self.basis
        if 8 * V.shape[1] ** 2 * (len(self.model.stiffness) + len(self.model.mass)) > KEPT_BYTES:
            # a hundred parameters make hundreds of terms, on a large basis too many to keep
            square = [_symmetrise(V.T @ (X @ V)) for X in self.model.matrices(theta)]
            rows = ((rK, self.stiffness_rows), (rM, self.mass_rows))
            return (*square, *(sum(c * R for c, R in zip(r, own, strict=True)) @ V for r, own in rows))
        weight = (*self.model.coefficients(theta), rK, rM)
        return tuple(_weighted_sum(terms, c) for terms, c in zip(self._terms, weight, strict=True))

    # loads -----------------------------------------------------------------------------------------------------------

    def point_loads(self, frequency_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inertia, and drag per m/s of sigma_v, of each point (3 n_point, n_frequency) per metre of amplitude."""
        density, gravity, depth, still = self.site
        water, w = self.conditions.water, self.waves
        v = w.normal_velocity(frequency_hz, self.heading_deg, depth, gravity, still)
        inertia = density * water.inertia_coefficient * np.pi / 4 * w.diameter_m**2 * w.length_m
        drag = 0.5 * density * water.drag_coefficient * w.diameter_m * w.length_m * np.sqrt(8 / np.pi)
        shape = (-1, len(frequency_hz))
        return (
            (inertia[:, None, None] * 2j * np.pi * frequency_hz * v).reshape(shape),
            (drag[:, None, None] * v).reshape(shape),
        )

    @property
    def _wet(self) -> int:
        """How many of the frequencies have waves."""
        return int(np.searchsorted(self.frequency_hz, WAVES_TO_HZ, side="right"))

    @cached_property
    def _speeds(self) -> tuple[np.ndarray, ...]:
        """sigma_v (n_point,) in m/s of the velocity across the members, for every state."""
        _, gravity, depth, still = self.site
        f = self.frequency_hz[: self._wet]
        speed = np.sum(np.abs(self.waves.normal_velocity(f, self.heading_deg, depth, gravity, still)) ** 2, axis=1)
        return tuple(
            np.sqrt(np.trapezoid(speed * jonswap(f, s.hs_m, s.tp_s, s.gamma), f, axis=1)) for s in self.conditions.state
        )

    def densities(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Of a state's thrust (n_frequency,) in N^2/Hz and, at the frequencies of waves, its elevation in m^2/Hz."""
        f, wind = self.frequency_hz, self.conditions.wind
        elevation = jonswap(f[: self._wet], state.hs_m, state.tp_s, state.gamma)
        if state.name in self.spectra:
            return line_densities(f, *self.spectra[state.name]), elevation
        rate = self._thrust_rate(state) * rotor_admittance(f, state.wind_mps, self._rotor_area)
        return rate**2 * kaimal(f, state.wind_mps, state.turbulence, wind.integral_length_m), elevation

    @property
    def _rotor_area(self) -> float:
        return np.pi / 4 * self.conditions.wind.rotor_diameter_m**2

    def _thrust_rate(self, state: State) -> float:
        """Change of the thrust with the wind, N s/m."""
        wind = self.conditions.wind
        return wind.air_density_kgpm3 * self._rotor_area * state.thrust_coefficient * state.wind_mps

    @cached_property
    def cases(self) -> tuple[Case, ...]:
        inertia, drag = self.point_loads(self.frequency_hz[: self._wet])
        spread = np.asarray(self._project(self.waves.spread.toarray()))
        found = []
        for state, sigma in zip(self.conditions.state, self._speeds, strict=True):
            thrust, elevation = self.densities(state)
            load = inertia + np.repeat(sigma, 3)[:, None] * drag
            rate = self._thrust_rate(state) if state.operating else 0.0
            found.append(Case(state=state, load=times(spread, load), own=times(self.waves.of_details, load),
                              thrust=thrust, elevation=elevation, damping_nspm=rate))
        return tuple(found)

    # stresses --------------------------------------------------------------------------------------------------------

    def stress_scale(self, theta: np.ndarray) -> np.ndarray:
        """(3 n_detail,) MPa per N, per N m; theta real or complex."""
        values = dict(self.coefficients.fixed) | dict(zip(self.parameters.names, theta, strict=True))
        known = {}
        for detail in self.details:
            tube = detail.section
            if tube not in known:
                bending = 0.5e-6 * tube.outer(values) / tube.second_moment(values)
                known[tube] = [1e-6 / tube.area(values), bending, bending]
        return np.array([x for detail in self.details for x in known[detail.section]])

    def modes_at(
        self, theta: np.ndarray, damping: Mapping[str, float], count: int | None = None
    ) -> ModalStress:
        """The modes on the basis, all or the lowest, their damping, member forces and what a thrust of 1 N
        does, without the rotor's damping."""
        K, M, RK, RM = at = self._matrices_at(theta)
        value, U = self._eigen(K, M, count)
        labels = () if not damping else self._labels(theta, U, value) if self.labels is None else self.labels
        scale = self.stress_scale(theta)[:, None]
        one = ModalStress(
            value=value, U=U, labels=labels, ratio=np.full(len(value), self.conditions.damping.ratio),
            plain=np.zeros(0), hub=U.T @ self._project(self.hub), scale=scale, RK=scale * (RK @ U),
            RM=scale * (RM @ U), omega=2 * np.pi * self.frequency_hz, at=at)
        return one.set_damping(damping)

    def _eigen(self, K: np.ndarray, M: np.ndarray, count: int | None) -> tuple[np.ndarray, np.ndarray]:
        """All modes, or the lowest: of M before K where the number is given, as springs at joints may carry no mass."""
        try:
            if count is None and (found := linalg.eigh(K, M))[0][0] > 0:
                return found
        except linalg.LinAlgError:
            pass
        n = len(K)
        try:
            slow, U = linalg.eigh(M, K, subset_by_index=(max(n - (count or n), 0), n - 1))
        except linalg.LinAlgError:
            raise InputError(self.model.name, "its stiffness is not positive definite",
                             "check the parameters") from None
        slow, U = np.maximum(slow[::-1], MASSLESS * slow[-1]), U[:, ::-1]
        return 1 / slow, U / np.sqrt(slow)

    def solve(
        self, theta: np.ndarray, damping: Mapping[str, float] | StateDamping, *, derivatives: bool = False
    ) -> Response:
        """Moments of all cases at theta (n_param,); `damping`: label of a mode -> its ratio, else the file's. Modes and
        their damping are given as those of an idling turbine, where there is such a state."""
        theta = np.asarray(theta, float)
        known = damping if isinstance(damping, StateDamping) else StateDamping.alike(damping)
        least = min((*known.idling.values(), *known.operating.values()), default=np.inf)
        if (step := float(np.log(self.frequency_hz[-1] / self.frequency_hz[-2]))) > least:
            return self._finer(int(np.ceil(np.log2(step / least)))).solve(theta, known, derivatives=derivatives)
        first = self.modes_at(theta, {**known.operating, **known.idling}, None if derivatives else self._n_dynamic)
        rest = None if derivatives else self._static_rest(first)
        moments: list[Any] = [None] * len(self.cases)
        changes = list(moments)
        for operating in {case.state.operating: None for case in self.cases}:
            m = first.set_damping(known.for_state(operating))
            here = [k for k, case in enumerate(self.cases) if case.state.operating == operating]
            rates = [1j * m.omega * (self.cases[k].damping_nspm if known.rotor else 0.0) for k in here]
            if rest is None:
                slopes = self._slopes(theta, m)
                for k, rate in zip(here, rates, strict=True):
                    moments[k], changes[k] = self._with_change(self.cases[k], rate, m, slopes)
            else:
                for k, found in zip(here, self._case_moments(m, rest, here, rates), strict=True):
                    moments[k] = found
        return Response(
            frequency_hz=frozen_array(np.sqrt(first.value[:N_MODE]) / (2 * np.pi)), moments=frozen_array(moments),
            change=frozen_array(np.swapaxes(np.array(changes), 0, 1)) if derivatives else None)

    def _finer(self, halvings: int) -> StressModel:
        """With smaller steps where modes may lie."""
        if halvings not in self._finer_ones:
            ratio = min(FINE / OF_RATIO, self.conditions.damping.ratio) / 2**halvings
            finer = replace(self, frequency_hz=frequency_grid(self.model, ratio))
            # of no frequency
            finer.__dict__.update({name: getattr(self, name) for name in ("_terms", "_n_dynamic")})
            self._finer_ones[halvings] = finer
        return self._finer_ones[halvings]

    @cached_property
    def _finer_ones(self) -> dict[int, StressModel]:
        return {}

    @cached_property
    def _n_dynamic(self) -> int:
        """Modes below DYNAMIC_HZ at the initial parameters, at least one."""
        K, M, _, _ = self._matrices_at(self.parameters.initial)
        slow = linalg.eigh(M, K, eigvals_only=True, subset_by_value=((2 * np.pi * DYNAMIC_HZ) ** -2, np.inf))
        return max(1, len(slow))

    @cached_property
    def _wave_loads(self) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Loads of all cases as L (n_basis, r) times a (r, n) at the frequencies of waves."""
        every = np.hstack([part(case.load) for case in self.cases for part in (np.real, np.imag)])
        norm = np.linalg.norm(every, axis=0)
        left, size, _ = np.linalg.svd(every / np.where(norm > 0, norm, 1.0), full_matrices=False)
        L = left[:, size > WAVE_TOLERANCE * size.max(initial=0.0)]
        return L, tuple(times(L.T, case.load) for case in self.cases)

    def _static_rest(self, m: ModalStress) -> tuple[np.ndarray, np.ndarray]:
        """What the modes above those of m do under thrust and under each column of the waves' L, as powers of omega^2:
        stresses (3, 3 n_detail, 1 + r) and the hub's motion (3, 1 + r)."""
        K, M, RK, RM = m.at
        hub = self._project(self.hub)
        factor = linalg.cho_factor(K)
        B = np.column_stack([hub, self._wave_loads[0]])
        X = [linalg.cho_solve(factor, B) - m.U @ ((m.U.T @ B) / m.value[:, None])]
        for _ in range(2):
            X.append(linalg.cho_solve(factor, M @ X[-1]))
        none = np.zeros((len(RM), B.shape[1]))
        stress = [m.scale * (RK @ x) - y for x, y in zip(X, [none, *(m.scale * (RM @ x) for x in X)], strict=False)]
        return np.array(stress), np.array([hub @ x for x in X])

    def _case_moments(self, m: ModalStress, rest, numbers: Sequence[int], rates) -> list[np.ndarray]:
        """Moments (14, n_detail, 3, 3) of cases with the same modes."""
        wet, w2 = self._wet, m.omega**2
        by_hub, hub_by = rest[0][:, :, 0], rest[1][:, 0]
        alone = m.hub[:, None] / m.plain
        powers = np.array([np.ones_like(w2), w2, w2**2])
        thrust = m.stress(alone) + by_hub.T @ powers
        receptance = m.hub @ alone + hub_by @ powers
        closed = [1 / (1 + rate * receptance) for rate in rates]
        density = [self.cases[k].thrust * np.abs(c) ** 2 for k, c in zip(numbers, closed, strict=True)]
        from_wind = self._moments(thrust, np.array(density))
        side_by_side = np.hstack([m.RK, -m.RM, rest[0][0, :, 1:], rest[0][1, :, 1:]])
        L, shares = self._wave_loads
        load, found = m.U.T @ L, []
        for k, rate, c, wind in zip(numbers, rates, closed, from_wind, strict=True):
            case, a = self.cases[k], shares[k]
            q = times(load, a) / m.plain[:, :wet]
            z = times(side_by_side, np.vstack([q, w2[:wet] * q, a, w2[:wet] * a])) - m.scale * case.own
            moved = m.hub @ q + rest[1][0, 1:] @ a + w2[:wet] * (rest[1][1, 1:] @ a)
            z -= thrust[:, :wet] * (rate[:wet] * moved * c[:wet])
            found.append(wind + self._moments(z, case.elevation[None])[0])
        return found

    def _with_change(self, case: Case, rate, m: ModalStress, slopes: Slopes):
        """Moments of one case and their change by every parameter, by all modes."""
        p = m.solve(np.repeat(m.hub[:, None], len(m.omega), axis=1), rate)
        q = m.solve(m.U.T @ case.load, rate)
        z, w = m.stress(q) - m.scale * case.own, m.stress(p)
        moments = self._moments(z, case.elevation[None])[0] + self._moments(w, case.thrust[None])[0]
        dz, dw = (slopes.stress_changes(x, m, rate) for x in (q, p))
        dz = [d - ds[:, None] * case.own for d, ds in zip(dz, slopes.scale, strict=True)]
        return moments, [self._change(z, case.elevation, a) + self._change(w, case.thrust, b)
                         for a, b in zip(dz, dw, strict=True)]

    def transfer(
        self, theta: np.ndarray, damping: Mapping[str, float], case: int = 0, wind: bool = False
    ) -> np.ndarray:
        """(n_detail, 3, n) complex nominal stress in MPa per N of thrust at all frequencies, or per metre of wave
        amplitude at those up to WAVES_TO_HZ."""
        m, one = self.modes_at(np.asarray(theta, float), damping), self.cases[case]
        n = len(m.omega) if wind else self._wet
        load = np.repeat(m.hub[:, None], n, axis=1) if wind else m.U.T @ one.load
        q = m.solve(load, 1j * m.omega * one.damping_nspm)
        z = m.stress(q)
        return (z if wind else z - m.scale * one.own).reshape(len(self.details), 3, -1)

    def _labels(self, theta: np.ndarray, U: np.ndarray, value: np.ndarray) -> tuple[str, ...]:
        n = min(LABELLED, U.shape[1])
        V = U[:, :n] if self.basis is None else self.basis @ U[:, :n]
        return labels_of_shapes(self.model, theta, V, np.sqrt(value[:n]) / (2 * np.pi))

    def _slopes(self, theta: np.ndarray, m: ModalStress) -> Slopes:
        """d K, M, C and d R by every parameter in the modes' coordinates, held fixed. C = M Phi g Phi^T M with
        g = 2 zeta omega; its change by Phi's own, W_ij = (k_ij - lambda_j m_ij) / (lambda_j - lambda_i)."""
        (Kt, Mt, RKt, RMt), U, value, ratio = self._terms, m.U, m.value, m.ratio
        dcK, dcM = self.model.coefficient_derivatives(theta)
        stepped = theta + 1j * STEP * np.eye(theta.size)
        drK, drM = (np.imag(c) / STEP for c in self.coefficients(stepped))
        scale = m.scale[:, 0]
        dscale = np.array([np.imag(self.stress_scale(row)) / STEP for row in stepped])
        g = 2 * ratio * np.sqrt(value)
        gap = value[None, :] - value[:, None]
        # one mode, or a pair that symmetry makes equal: there the damping's change has a limit of its own
        one = np.abs(gap) <= EQUAL * value[None, :]
        gap[one] = 1.0
        K, M, C, RK, RM = [], [], [], [], []
        for k in range(theta.size):
            dK, dM = (U.T @ _weighted_sum(ts, c[:, k]) @ U for ts, c in ((Kt, dcK), (Mt, dcM)))
            change = dK - dM * value[None, :]
            W = np.where(one, -0.5 * dM, change / gap)
            dC = (
                dM * g[None, :]
                + g[:, None] * dM
                + W * g[None, :]
                + (W * g[None, :]).T
                + np.where(one, ratio / np.sqrt(value) * change, 0.0)
            )
            K.append(dK)
            M.append(dM)
            C.append(dC)
            RK.append(scale[:, None] * (_weighted_sum(RKt, drK[k]) @ U))
            RM.append(scale[:, None] * (_weighted_sum(RMt, drM[k]) @ U))
        return Slopes(K=K, M=M, C=C, RK=RK, RM=RM, scale=dscale)

    def _line_weights(self, n: int) -> np.ndarray:
        """(14, n) of f to the power of ORDERS by trapezoids, of what ten-minute records count."""
        f = self.frequency_hz[:n]
        return np.convolve(np.diff(f), [0.5, 0.5]) * counted_share(f) * f ** np.array(ORDERS)[:, None]

    def _moments(self, z: np.ndarray, density: np.ndarray) -> np.ndarray:
        """(n, 14, n_detail, 3, 3) sums of f^k Re(z_i conj z_j) times each of n densities (n, n_frequency)."""
        weights = self._line_weights(z.shape[1]) * density[:, None]
        return paired_moments(z, weights.reshape(-1, z.shape[1])).reshape(len(density), len(ORDERS), -1, 3, 3)

    def _change(self, z: np.ndarray, density: np.ndarray, change: np.ndarray) -> np.ndarray:
        """(14, n_detail, 3, 3) change of the moments with that of z."""
        weights = self._line_weights(z.shape[1]) * density
        a, b = (x.reshape(len(self.details), 3, -1) for x in (change, z))
        one = np.real(np.einsum("dif,kf,djf->kdij", a, weights, np.conj(b), optimize=True))
        return one + np.swapaxes(one, -1, -2)


def _weighted_sum(terms: Sequence[np.ndarray], weight: np.ndarray) -> np.ndarray:
    total = weight[0] * terms[0]
    for w, term in zip(weight[1:], terms[1:], strict=True):
        total += w * term
    return total


def _congruence(X, V: np.ndarray) -> np.ndarray:
    """V^T X V, by the rows of X that hold something: most terms are of few elements."""
    rows = sparse.csr_array(X)
    held = np.flatnonzero(np.diff(rows.indptr))
    return V[held].T @ (rows[held] @ V)


def _symmetrise(matrix: np.ndarray) -> np.ndarray:
    return 0.5 * (matrix + matrix.T)


def stress_model(
    description: Description,
    where: str,
    details: Sequence[Detail],
    conditions: Conditions,
    *,
    heading_deg: float,
    parameters: Parameters | None = None,
    sensors: tuple[Sensor, ...] | None = None,
    spectra: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
    frame: Frame | None = None,
) -> StressModel:
    """Of one heading of wind, waves and nacelle, on all degrees of freedom. `details` as `details.find_details` names
    them in the frame of any heading; loads are those of the members as the file's values have them. `frame`: that of
    the description at this heading, where it has been built already."""
    if not isinstance(description, Offshore):
        raise InputError(where, "fatigue is assessed for turbines at sea only, whose conditions have waves",
                         "leave the fatigue of a tower on land to another program (export without --fatigue)")
    frame = build_frame(description, heading_deg) if frame is None else frame
    model = turbine_model(
        description, where=where, parameters=parameters, sensors=sensors, turn_deg=heading_deg, frame=frame
    )
    transform = transformation(frame)
    values = description.values | {p.name: p.initial for p in model.parameters}
    details = tuple(replace(d, beam=frame.beams[d.number]) for d in details)
    updated = tuple(model.parameters.names)
    collected = _force_terms(frame, details, description.mesh.theory, updated, values)
    size = (3 * len(details), transform.shape[0])
    rows = tuple(tuple(_as_sparse(entries, size) @ transform for entries in c.keys.values()) for c in collected)
    fixed = {name: value for name, value in values.items() if name not in updated}
    return StressModel(
        model=model,
        sensors=described_sensors(description) if sensors is None else sensors,
        frame=frame,
        details=details,
        heading_deg=float(heading_deg),
        conditions=conditions,
        site=(
            description.site.water_density_kgpm3,
            description.site.gravity_mps2,
            description.site.water_level_m - description.site.mudline_m,
            description.site.water_level_m,
        ),
        stiffness_rows=rows[0],
        mass_rows=rows[1],
        coefficients=build_coefficients(*collected, updated, fixed),
        waves=waves_on_turbine(description, frame, transform, details, values),
        hub=_hub(description, frame, transform, heading_deg, 0.0),
        across=_hub(description, frame, transform, heading_deg, 90.0),
        frequency_hz=frequency_grid(model, conditions.damping.ratio),
        spectra=dict(spectra or {}),
    )


def _force_terms(
    frame: Frame, details: Sequence[Detail], theory: str, updated: tuple[str, ...], values: Mapping[str, float]
) -> tuple[TermCollector, TermCollector]:
    """What the details' elements make of displacements and of accelerations, as terms of stiffness and of mass: entries
    (three rows a detail, degrees of freedom of the element, numbers)."""
    collected = TermCollector(updated, values), TermCollector(updated, values)
    for row, detail in enumerate(details):
        b = frame.beams[detail.number]
        start, end = frame.node_m[b.start], frame.node_m[b.end]
        pick = detail.rows()
        mass = (steel_mass(b, start, end, theory), carried_mass(b, b.carried, start, end, theory))
        sources = (beam_stiffness(b, start, end, theory), (c for part in mass for c in part))
        for collector, contributions in zip(collected, sources, strict=True):
            for dofs, matrix, coefficient in contributions:
                collector.add(coefficient, lambda x, r=row, d=dofs, m=pick @ matrix: (3 * r + np.arange(3), d, x * m))
    return collected


def _as_sparse(entries, size) -> sparse.csr_array:
    rows = np.concatenate([np.repeat(r, len(d)) for r, d, _ in entries])
    columns = np.concatenate([np.tile(d, len(r)) for r, d, _ in entries])
    values = np.concatenate([m.ravel() for _, _, m in entries])
    return sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=size))


def _hub(d: Description, frame: Frame, transform, heading_deg: float, from_wind_deg: float) -> np.ndarray:
    """A force of 1 N at the hub of a nacelle on this heading, turned from the wind's way counter-clockwise, as loads on
    the free degrees of freedom."""
    offset = np.array(next(body.offset_m for body in d.rna if body.name == "hub"))
    angle = np.radians(heading_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    place = np.array([0.0, 0.0, d.tower.station[-1].z_m]) + turn @ offset
    node = int(np.argmin(np.linalg.norm(frame.node_m - place, axis=1)))
    force = np.zeros(transform.shape[0])
    way = angle + np.radians(from_wind_deg)
    force[6 * node : 6 * node + 2] = [np.cos(way), np.sin(way)]
    return frozen_array(transform.T @ force)
