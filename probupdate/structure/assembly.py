"""From a frame to K(theta) and M(theta) as sums of few constant matrices, and to a model of its modes.

K and M stand over free degrees of freedom only: ties and supports are worked in by a constant transformation
u = T q, so that both are positive definite. What no updated parameter touches is summed at build time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.errors import InputError
from probupdate.structure import beam as beams
from probupdate.structure.affine import WeightedSum
from probupdate.structure.coefficient import (
    Coefficient,
    Coefficients,
    Factor,
    TermCollector,
    Values,
    build_coefficients,
    parameter,
)
from probupdate.structure.frame import Beam, Body, Frame, Hinge, LineMass, Prestress, tube_property

# (degrees of freedom (k,) of the frame's nodes, matrix (k, k), coefficient)
Contribution = tuple[np.ndarray, np.ndarray, Coefficient]
THEORIES = ("bernoulli-euler", "timoshenko")
# terms that are transformed in one product: two thousand of effects at once take 200 MB meanwhile
TERMS_AT_ONCE = 128


def node_dofs(*nodes: int) -> np.ndarray:
    """(6 n_node,) rows of the nodes' three translations and three rotations, one node after the other."""
    return np.concatenate([6 * node + np.arange(6) for node in nodes])


@dataclass(frozen=True)
class Shear:
    """phi of a tube of given length, as far as it is counted: the whole of it (Timoshenko) or nothing, and the shares
    of the parameters `extra`; picklable."""

    tube: beams.Tube
    length_m: float
    poisson_ratio: float
    whole: bool
    extra: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.tube.names, *self.extra)

    def __call__(self, values: Values):
        share = float(self.whole) + sum(values[name] for name in self.extra)
        return share * self.tube.shear_flexibility(values, self.length_m, self.poisson_ratio)


def _shear(beam: Beam, length_m: float, theory: str) -> Shear | None:
    """None where the beam does not give way in shear."""
    whole = theory == "timoshenko"
    if not whole and not beam.shear:
        return None
    return Shear(beam.tube, round(length_m, 9), beam.poisson_ratio, whole, beam.shear)


@dataclass(frozen=True)
class ShearPower:
    """phi^power / (1 + phi)^order; picklable."""

    shear: Shear
    power: int
    order: int

    def __call__(self, values: Values):
        phi = self.shear(values)
        return phi**self.power / (1 + phi) ** self.order

    def coefficient(self) -> Coefficient:
        return Coefficient(1.0, (Factor(key=("shear", self), names=self.shear.names, function=self),))


@dataclass(frozen=True, eq=False, kw_only=True)
class HingeSoftening:
    """What a connection takes from a beam's stiffness; picklable.

    In bending, with EI' = E I / (1 + phi) and the flexibility c, static condensation of the rotation behind the hinge
    takes EI'^2 c / (1 + c EI' (4 + phi) / L) phi^power times the outer product of two rows of the stiffness matrix.
    Along the beam (power None) a spring in series takes (EA)^2 c / L / (1 + c EA / L).
    """

    beam: Beam
    hinge: Hinge
    length_m: float
    shear: Shear | None
    power: int | None

    @property
    def names(self) -> tuple[str, ...]:
        modulus = self.beam.stiffness * self.beam.bending * self.beam.axial
        inside = (name for factor in modulus.factors for name in factor.names)
        hinge = self.hinge
        return tuple(sorted({*inside, *self.beam.tube.names, *self.beam.shear, *hinge.bending, *hinge.slip}))

    def __call__(self, values: Values):
        return self._slip(values) if self.power is None else self._bending_stiffness(values, self.power)

    def _slip(self, values: Values):
        beam = self.beam
        modulus = beam.youngs_modulus_pa * (beam.stiffness * beam.axial).value(values)
        stiffness = modulus * beam.tube.area(values)
        flexibility = 1e-9 * sum(values[name] for name in self.hinge.slip)
        return stiffness**2 * flexibility / self.length_m / (1 + flexibility * stiffness / self.length_m)

    def _bending_stiffness(self, values: Values, power: int):
        beam, phi = self.beam, 0.0 if self.shear is None else self.shear(values)
        modulus = beam.youngs_modulus_pa * (beam.stiffness * beam.bending).value(values)
        bending = modulus * beam.tube.second_moment(values) / (1 + phi)
        flexibility = 1e-9 * sum(values[name] for name in self.hinge.bending)
        return bending**2 * flexibility * phi**power / (1 + flexibility * bending * (4 + phi) / self.length_m)


def _hinge_stiffness(beam: Beam, hinge: Hinge, length: float, matrices: Mapping[str, np.ndarray], theory: str):
    """Local matrices with their coefficients; the mass keeps the shapes of the unbroken beam, which the hinge changes
    inside this one element only."""
    counted = _shear(beam, length, theory)
    parts: list[tuple[int | None, np.ndarray]] = [(None, matrices["axial"])] if hinge.slip else []
    if hinge.bending:
        rotations = np.array([4, 5]) + 6 * hinge.end
        plain, shear = matrices["bending"][rotations], matrices["shear"][rotations]
        parts.append((0, plain.T @ plain))
        if counted is not None:
            parts += [(1, plain.T @ shear + shear.T @ plain), (2, shear.T @ shear)]
    for power, matrix in parts:
        function = HingeSoftening(beam=beam, hinge=hinge, length_m=length, shear=counted, power=power)
        key = ("hinge", beam.part, beam.start, beam.end, power)
        yield matrix, Coefficient(-1.0, (Factor(key=key, names=function.names, function=function),))


def _shear_series(beam: Beam, length_m: float, theory: str, order: int) -> list[Coefficient]:
    """Coefficients of the powers of phi: one of value 1 without shear, else order + 1."""
    shear = _shear(beam, length_m, theory)
    if shear is None:
        return [Coefficient()]
    return [ShearPower(shear, k, order).coefficient() for k in range(order + 1)]


def beam_stiffness(beam: Beam, start: np.ndarray, end: np.ndarray, theory: str) -> Iterator[Contribution]:
    """A beam and its springs; GJ = E I / (1 + nu) for a tube."""
    length = float(np.linalg.norm(end - start))
    dofs, frame_axes = node_dofs(beam.start, beam.end), beams.axes(start, end)
    matrices = beams.stiffness_matrices(length)
    modulus = beam.stiffness * beam.youngs_modulus_pa
    area, second_moment = tube_property(beam.tube, "area"), tube_property(beam.tube, "second_moment")
    yield dofs, beams.to_global(matrices["axial"], frame_axes), modulus * beam.axial * area
    bending = modulus * beam.bending * second_moment
    yield dofs, beams.to_global(matrices["torsion"], frame_axes), bending * (1 / (1 + beam.poisson_ratio))
    for shear, key in zip(_shear_series(beam, length, theory, 1), ("bending", "shear"), strict=False):
        yield dofs, beams.to_global(matrices[key], frame_axes), bending * shear
    if beam.hinge is not None:
        for matrix, coefficient in _hinge_stiffness(beam, beam.hinge, length, matrices, theory):
            yield dofs, beams.to_global(matrix, frame_axes), coefficient
    if beam.springs is not None:
        yield from _moments(dofs, beams.to_global(beams.transverse_moments(length), frame_axes), beam.springs.lateral)
        yield from _moments(dofs, beams.to_global(beams.axial_moments(length), frame_axes), beam.springs.axial)
        if beam.springs.torsional:
            around = beams.to_global(beams.torsional_moments(length), frame_axes)
            yield from _moments(dofs, around, beam.springs.torsional)


def _moments(dofs, matrices: np.ndarray, coefficients: Sequence[Coefficient]) -> Iterator[Contribution]:
    for matrix, coefficient in zip(matrices, coefficients, strict=True):
        yield dofs, matrix, coefficient


def steel_mass(beam: Beam, start: np.ndarray, end: np.ndarray, theory: str) -> Iterator[Contribution]:
    """The tube itself: translation, rotary inertia, spin about its axis (rho J = 2 rho I)."""
    length = float(np.linalg.norm(end - start))
    dofs, frame_axes = node_dofs(beam.start, beam.end), beams.axes(start, end)
    area = tube_property(beam.tube, "area") * beam.density_kgpm3
    second_moment = tube_property(beam.tube, "second_moment") * beam.density_kgpm3
    series = _shear_series(beam, length, theory, 2)
    yield dofs, beams.to_global(beams.axial_mass(length), frame_axes), area
    yield dofs, beams.to_global(beams.torsional_mass(length), frame_axes), second_moment * 2.0
    for k, shear in enumerate(series):
        yield dofs, beams.to_global(beams.transverse_mass(length)[k], frame_axes), area * shear
        yield dofs, beams.to_global(beams.rotary_mass(length)[k], frame_axes), second_moment * shear


def carried_mass(
    beam: Beam, carried: Sequence[LineMass], start: np.ndarray, end: np.ndarray, theory: str
) -> Iterator[Contribution]:
    """Water, growth and secondary steel. Partly covered beams take Bernoulli-Euler shapes in both theories."""
    length = float(np.linalg.norm(end - start))
    dofs, frame_axes = node_dofs(beam.start, beam.end), beams.axes(start, end)
    for mass in carried:
        if mass.moments is not None:
            across = beams.to_global(beams.transverse_moments(length), frame_axes)
            yield from _moments(dofs, across, mass.moments)
            if not mass.transverse_only:
                along = beams.to_global(beams.axial_moments(length), frame_axes)
                yield from _moments(dofs, along, mass.moments[:3])
            continue
        for k, shear in enumerate(_shear_series(beam, length, theory, 2)):
            matrix = beams.to_global(beams.transverse_mass(length)[k], frame_axes)
            yield dofs, matrix, mass.per_metre * shear
        if not mass.transverse_only:
            yield dofs, beams.to_global(beams.axial_mass(length), frame_axes), mass.per_metre


def _stiffness(frame: Frame, theory: str) -> Iterator[Contribution]:
    for beam in frame.beams:
        yield from beam_stiffness(beam, frame.node_m[beam.start], frame.node_m[beam.end], theory)
    for spring in frame.springs:
        yield node_dofs(spring.node), np.outer(spring.direction, spring.direction), spring.stiffness
    # released motions are numbered behind the nodes', see `transformation`
    row = 6 * len(frame.node_m)
    for tie in frame.ties:
        for coefficient in tie.stiffness:
            yield np.array([row]), np.ones((1, 1)), coefficient
            row += 1


def _mass(frame: Frame, theory: str, *, dry: bool = False) -> Iterator[Contribution]:
    """All masses, or with `dry` only those that weigh."""
    for beam in frame.beams:
        start, end = frame.node_m[beam.start], frame.node_m[beam.end]
        yield from steel_mass(beam, start, end, theory)
        carried = tuple(mass for mass in beam.carried if mass.dry) if dry else beam.carried
        yield from carried_mass(beam, carried, start, end, theory)
    for body in frame.bodies:
        yield from body_mass(body)


def body_mass(body: Body) -> Iterator[Contribution]:
    """A body whose centre lies at d = sum_i p_i n_i from its node: u + r x d moves it, a polynomial in the p_i."""
    dofs = node_dofs(body.node)
    yield dofs, np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), body.mass
    for coefficient, tensor in ((Coefficient(), body.inertia_kgm2), *body.spin):
        yield dofs, linalg.block_diag(np.zeros((3, 3)), tensor), coefficient
    arms = [(parameter(name), rigid_motion(direction)[:3, 3:]) for name, direction in body.shift]
    for k, (by, arm) in enumerate(arms):
        yield dofs, np.block([[np.zeros((3, 3)), arm], [arm.T, np.zeros((3, 3))]]), body.mass * by
        for other, second in arms[k:]:
            product = arm.T @ second
            turning = product if second is arm else product + product.T
            yield dofs, linalg.block_diag(np.zeros((3, 3)), turning), body.mass * by * other


def transformation(frame: Frame) -> sparse.csr_array:
    """T (6 n_node + n_released, n_free): motions of all nodes, then the released motions of ties in order, from the
    free degrees of freedom q.

    A tied node follows its master as a rigid body plus its released motions; the master must not be tied itself.
    """
    n_node = len(frame.node_m)
    tied = {tie.node for tie in frame.ties}
    free = np.ones((n_node, 6), bool)
    for support in frame.supports:
        free[support.node] &= ~support.held
    free[sorted(tied)] = False
    n_own = int(free.sum())
    column = np.full((n_node, 6), -1)
    column[free] = np.arange(n_own)
    rows, columns, values = [np.flatnonzero(free)], [np.arange(n_own)], [np.ones(n_own)]

    def add(row, col, value):
        rows.append(np.atleast_1d(row))
        columns.append(np.atleast_1d(col))
        values.append(np.atleast_1d(value).astype(float))

    released = 0
    for tie in frame.ties:
        if tie.master in tied:
            raise InputError(f"node {tie.master}", "carries a tie and is tied itself", "tie both to the same master")
        rigid = rigid_motion(frame.node_m[tie.node] - frame.node_m[tie.master])
        for i, k in zip(*np.nonzero(rigid), strict=True):
            if column[tie.master, k] >= 0:
                add(6 * tie.node + i, column[tie.master, k], rigid[i, k])
        for direction in tie.released:
            add(node_dofs(tie.node), np.full(6, n_own + released), direction)
            add(6 * n_node + released, n_own + released, 1.0)
            released += 1
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    matrix = sparse.csr_array(sparse.coo_array(entries, shape=(6 * n_node + released, n_own + released)))
    matrix.eliminate_zeros()
    return matrix


def rigid_motion(arm: np.ndarray) -> np.ndarray:
    """(6, 6): motion of a point at `arm` (3,) from the node it is rigidly joined to, u + r x arm."""
    x, y, z = arm
    matrix = np.eye(6)
    matrix[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return matrix


def _collect(contributions: Iterable[Contribution], updated: Sequence[str], values: Mapping[str, float]):
    collector = TermCollector(tuple(updated), values)
    for dofs, matrix, coefficient in contributions:
        collector.add(coefficient, lambda number, d=dofs, m=matrix: (d, number * m))
    return collector


def _sum_terms(collector: TermCollector, transform: sparse.csr_array) -> list[sparse.csc_array]:
    """T^T B_t T of every term t, symmetric to the last bit."""
    entries = list(collector.keys.values())
    return [matrix for first in range(0, len(entries), TERMS_AT_ONCE)
            for matrix in _transform_terms(entries[first : first + TERMS_AT_ONCE], transform)]


def _transform_terms(terms: Sequence[Sequence[tuple]], transform: sparse.csr_array) -> Iterator[sparse.csc_array]:
    """The same of some terms, which stand below one another in one matrix: hundreds of small sparse products cost more
    than two large ones."""
    (size, n_free), n_term = transform.shape, len(terms)
    rows, columns, values = [np.empty(0, int)], [np.empty(0, int)], [np.empty(0)]
    for term, entries in enumerate(terms):
        for dofs, matrix in entries:
            rows.append(term * size + np.repeat(dofs, len(dofs)))
            columns.append(np.tile(dofs, len(dofs)))
            values.append(matrix.ravel())
    rows, columns, values = (np.concatenate(part) for part in (rows, columns, values))
    right = sparse.coo_array(_csr(values, rows, columns, (n_term * size, size)) @ transform)
    # from B_t T with rows (t, i) to its transpose per term, rows (t, j): the second product works on the other side
    term, row = np.divmod(right.row, size)
    both = sparse.coo_array(_csr(right.data, term * n_free + right.col, row, (n_term * n_free, size)) @ transform)
    term, row = np.divmod(both.row, n_free)
    mirrored = _csr(both.data, term * n_free + both.col, row, both.shape)
    total = 0.5 * (sparse.csr_array(both) + mirrored)
    total.sort_indices()
    for k in range(n_term):
        start = total.indptr[k * n_free : (k + 1) * n_free + 1]
        part = slice(start[0], start[-1])
        # the rows of a symmetric matrix are its columns. A term has more starts of columns than entries: in 32 bits
        entries = (total.data[part].copy(), total.indices[part].astype(np.int32), (start - start[0]).astype(np.int32))
        yield sparse.csc_array(entries, shape=(n_free, n_free))


def _csr(values, rows, columns, shape) -> sparse.csr_array:
    return sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=shape))


@dataclass(frozen=True, eq=False, kw_only=True)
class AssembledFrame:
    """K(theta) = sum_t c_t K_t over the free degrees of freedom, M likewise; `transform` T gives u = T q.

    The first term of each may have the constant coefficient 1. A term's coefficients come from `coefficients`; `keys`
    say of stiffness and mass what each term varies with.
    """

    stiffness: tuple[sparse.csc_array, ...]
    mass: tuple[sparse.csc_array, ...]
    coefficients: Coefficients
    transform: sparse.csr_array
    keys: tuple[tuple[tuple, ...], tuple[tuple, ...]]


def assemble(
    frame: Frame,
    *,
    updated: tuple[str, ...],
    values: Mapping[str, float],
    theory: str = "bernoulli-euler",
    gravity_mps2: float | None = None,
) -> AssembledFrame:
    """Sum a frame into terms for the parameters `updated`; the others stay at `values` (all parameters by name).

    With gravity_mps2 the geometric stiffness of every beam under the weight of steel and lumped masses at `values` is
    added as a constant; see `axial_forces`. So is that of the frame's own prestress, times its coefficients.

    On the as-built reference turbine it takes 1.5 % off the first two frequencies and 0.1 to 0.3 % off the next ten.
    """
    if theory not in THEORIES:
        raise InputError("mesh.theory", f"'{theory}' is unknown", f"choose from {', '.join(THEORIES)}")
    parts = (_add_prestress(frame, values, theory, gravity_mps2), _mass(frame, theory))
    return _assemble(frame, parts, transformation(frame), tuple(updated), values)


def supporting_frame(
    frame: Frame, kept: np.ndarray, *, updated: tuple[str, ...], values: Mapping[str, float], theory: str,
    gravity_mps2: float | None,
) -> AssembledFrame:
    """As `assemble`, of what acts between the nodes `kept` (n_node,) alone; `transform` (6 n_node, n): the motions of
    all nodes, zero for the others. Member forces of prestress are those of the whole frame."""
    transform = transformation(frame)
    released = [bool(kept[tie.node]) for tie in frame.ties for _ in tie.released]
    inside = np.concatenate([np.repeat(kept, 6), np.array(released, bool)])
    transform = sparse.diags_array(inside.astype(float)) @ transform
    columns = np.flatnonzero(abs(transform).sum(axis=0) > 0)
    transform = sparse.csr_array(transform)[:, columns]
    parts = (_add_prestress(frame, values, theory, gravity_mps2), _mass(frame, theory))
    return _assemble(frame, ((part for part in own if inside[part[0]].all()) for own in parts), transform, updated,
                      values)


def supporting_matrices(
    frame: Frame, values: Mapping[str, float], kept: np.ndarray, *, theory: str, gravity_mps2: float | None
) -> tuple[sparse.csc_array, sparse.csc_array, sparse.csr_array]:
    """K, M (n, n) of `supporting_frame` at parameter values (all by name), and its motions."""
    found = supporting_frame(frame, kept, updated=(), values=values, theory=theory, gravity_mps2=gravity_mps2)
    return found.stiffness[0], found.mass[0], found.transform


def _assemble(frame: Frame, contributions, transform, updated: tuple[str, ...], values) -> AssembledFrame:
    collected = tuple(_collect(own, updated, values) for own in contributions)
    fixed = {name: value for name, value in values.items() if name not in updated}
    stiffness, mass = (tuple(_sum_terms(own, transform)) for own in collected)
    return AssembledFrame(stiffness=stiffness, mass=mass, transform=transform[: 6 * len(frame.node_m)],
                          coefficients=build_coefficients(*collected, tuple(updated), fixed),
                          keys=(tuple(collected[0].keys), tuple(collected[1].keys)))


def sum_contributions(
    contributions: Iterable[Contribution], updated: Sequence[str], values: Mapping[str, float], transform
) -> dict[tuple, sparse.csc_array]:
    """Terms of these alone, by what each varies with."""
    collected = _collect(contributions, updated, values)
    return dict(zip(collected.keys, _sum_terms(collected, transform), strict=True))


def loads_of(frame: Frame, gravity_mps2: float | None) -> tuple[Prestress, ...]:
    """The own weight, unless gravity is None, and the frame's loads."""
    own_weight = () if gravity_mps2 is None else (Prestress(coefficient=Coefficient(), gravity_mps2=gravity_mps2),)
    return (*own_weight, *frame.prestress)


def _add_prestress(
    frame: Frame, values: Mapping[str, float], theory: str, gravity_mps2: float | None
) -> list[Contribution]:
    """All stiffnesses, with the geometric ones under the loads."""
    loads, found = loads_of(frame, gravity_mps2), list(_stiffness(frame, theory))
    if loads:
        forces = axial_forces(frame, values, theory, loads)
        found += geometric_stiffness(frame, forces, [load.coefficient for load in loads])
    return found


def geometric_stiffness(
    frame: Frame, forces: np.ndarray, coefficients: Sequence[Coefficient]
) -> Iterator[Contribution]:
    """Of axial forces (n_beam, n_load) in N, tension positive, under loads with these coefficients."""
    for beam, own in zip(frame.beams, forces, strict=True):
        start, end = frame.node_m[beam.start], frame.node_m[beam.end]
        matrix = beams.geometric_stiffness(float(np.linalg.norm(end - start)))
        turned = beams.to_global(matrix, beams.axes(start, end))
        for coefficient, force in zip(coefficients, own, strict=True):
            yield node_dofs(beam.start, beam.end), turned, coefficient * float(force)


def axial_forces(
    frame: Frame, values: Mapping[str, float], theory: str, loads: Sequence[Prestress]
) -> np.ndarray:
    """(n_beam, n_load) mean axial forces in N, tension positive, under the dry weight or a node's load, at the
    parameter `values`: that they would change the forces is left out.

    Water, growth and buoyancy are left out: submerged steel is weighed as in air, about an eighth too much, while
    the tower and what stands on it, which decide the first modes, have their own weight.
    """
    return axial_forces_under(frame, values, theory,
                              transformation(frame).T @ nodal_forces(frame, values, theory, loads))


def nodal_forces(
    frame: Frame, values: Mapping[str, float], theory: str, loads: Sequence[Prestress]
) -> np.ndarray:
    """(6 n_node + n_released, n_load) forces in N on the nodes."""
    force = np.zeros((6 * len(frame.node_m) + sum(len(tie.released) for tie in frame.ties), len(loads)))
    for k, load in enumerate(loads):
        if load.node is not None:
            force[6 * load.node : 6 * load.node + 3, k] = load.force_n
        if load.gravity_mps2:
            fall = np.tile([0.0, 0.0, -load.gravity_mps2, 0.0, 0.0, 0.0], len(frame.node_m))
            for dofs, matrix, coefficient in _mass(frame, theory, dry=True):
                force[dofs, k] += float(coefficient.value(values)) * (matrix @ fall[dofs])
    return force


def axial_forces_under(
    frame: Frame, values: Mapping[str, float], theory: str, loads: np.ndarray
) -> np.ndarray:
    """(n_beam, n_load) axial forces under `loads` (n_free, n_load) on the free degrees of freedom."""
    transform = transformation(frame)
    (K,) = sum_contributions(_stiffness(frame, theory), (), values, transform).values()
    return _forces_of_motions(frame, values, transform @ sparse_linalg.splu(sparse.csc_matrix(K)).solve(loads))


def _forces_of_motions(frame: Frame, values: Mapping[str, float], u: np.ndarray) -> np.ndarray:
    """(n_beam, n) axial forces of nodes that are moved by u (6 n_node and more, n)."""
    forces, area = [], {}
    for beam in frame.beams:
        span = frame.node_m[beam.end] - frame.node_m[beam.start]
        length = np.linalg.norm(span)
        elongation = (span / length) @ (u[6 * beam.end : 6 * beam.end + 3] - u[6 * beam.start : 6 * beam.start + 3])
        modulus = beam.youngs_modulus_pa * float((beam.stiffness * beam.axial).value(values))
        if id(beam.tube) not in area:
            area[id(beam.tube)] = float(beam.tube.area(values))
        forces.append(modulus * area[id(beam.tube)] * elongation / length)
    return np.array(forces)


@dataclass(frozen=True, eq=False, kw_only=True)
class AxialForces:
    """`axial_forces` as a function of all parameters' values by name: what depends on `updated` ones is assembled in
    terms once. weight (n_free, n_term) under 1 m/s2, applied (n_free, n_load) at nodes."""

    frame: Frame
    loads: tuple[Prestress, ...]
    coefficients: Coefficients
    stiffness: WeightedSum
    weight: np.ndarray
    applied: np.ndarray
    transform: sparse.csr_array

    @classmethod
    def assemble(
        cls, frame: Frame, loads: Sequence[Prestress], *, updated: tuple[str, ...], values: Mapping[str, float],
        theory: str,
    ) -> AxialForces:
        transform = transformation(frame)
        stiffness, mass = _collect(_stiffness(frame, theory), updated, values), TermCollector(updated, values)
        fall = np.tile([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], len(frame.node_m))
        for dofs, matrix, coefficient in _mass(frame, theory, dry=True):
            mass.add(coefficient, lambda number, d=dofs, f=matrix @ fall[dofs]: (d, number * f))
        weight, applied = (np.zeros((transform.shape[0], n)) for n in (len(mass.keys), len(loads)))
        for k, entries in enumerate(mass.keys.values()):
            for dofs, force in entries:
                np.add.at(weight[:, k], dofs, force)
        for k, load in enumerate(loads):
            if load.node is not None:
                applied[6 * load.node : 6 * load.node + 3, k] = load.force_n
        fixed = {name: value for name, value in values.items() if name not in updated}
        return cls(
            frame=frame, loads=tuple(loads), coefficients=build_coefficients(stiffness, mass, updated, fixed),
            stiffness=WeightedSum.from_matrices(_sum_terms(stiffness, transform)), weight=transform.T @ weight,
            applied=transform.T @ applied, transform=transform)

    def __call__(self, values: Mapping[str, float]) -> np.ndarray:
        of_stiffness, of_mass = self.coefficients(np.array([values[name] for name in self.coefficients.names], float))
        gravity = np.array([load.gravity_mps2 for load in self.loads])
        force = self.applied + (self.weight @ of_mass)[:, None] * gravity
        K = sparse.csc_matrix(self.stiffness(of_stiffness))
        return _forces_of_motions(self.frame, values, self.transform @ sparse_linalg.splu(K).solve(force))


@dataclass(frozen=True, eq=False, kw_only=True)
class Softening:
    """Geometric stiffness (n, n) on motions `transform` (6 n_node, n), of the beams between the nodes `kept` (n_node,),
    as a function of all parameters' values by name."""

    forces: AxialForces
    beams: np.ndarray
    geometric: WeightedSum

    @classmethod
    def assemble(
        cls, frame: Frame, transform: sparse.csr_array, kept: np.ndarray, *, updated: tuple[str, ...],
        values: Mapping[str, float], theory: str, gravity_mps2: float | None,
    ) -> Softening | None:
        """None where no load softens it."""
        loads = loads_of(frame, gravity_mps2)
        if not loads:
            return None
        inside = {k: None for k, beam in enumerate(frame.beams) if kept[beam.start] and kept[beam.end]}
        tension = geometric_stiffness(frame, np.ones((len(frame.beams), 1)), [Coefficient()])
        terms = [[(dofs, matrix)] for k, (dofs, matrix, _) in enumerate(tension) if k in inside]
        matrices = [matrix for first in range(0, len(terms), TERMS_AT_ONCE)
                    for matrix in _transform_terms(terms[first : first + TERMS_AT_ONCE], transform)]
        return cls(forces=AxialForces.assemble(frame, loads, updated=updated, values=values, theory=theory),
                   beams=np.array(list(inside)), geometric=WeightedSum.from_matrices(matrices))

    def __call__(self, values: Mapping[str, float]) -> sparse.csc_array:
        return self.matrix(self.forces(values), values)

    def matrix(self, forces: np.ndarray, values: Mapping[str, float]) -> sparse.csc_array:
        """Of axial forces (n_beam, n_load) whose loads have their coefficients at these values."""
        share = np.array([float(load.coefficient.value(values)) for load in self.forces.loads])
        return sparse.csc_array(self.geometric(forces[self.beams] @ share))
