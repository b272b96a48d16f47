"""The OC4 jacket with tower by another theory and other code than the model that is updated.

From a SubDyn file's tables: Timoshenko tubes with Cowper's shear area, lumped mass, a finer mesh, rigid links and soil
assembled here. Nothing of `probupdate.structure` is used; what is hidden is put into the members' moduli.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh, splu

from probupdate.io.subdyn_file import SubDynFile
from probupdate.virtual import beam

PIECES = {"circular": 6, "arbitrary": 3}


def arm(d: np.ndarray) -> np.ndarray:
    """(6, 6): the motion of a point at d from what it is rigidly fixed to."""
    motion = np.eye(6)
    motion[:3, 3:] = [[0, d[2], -d[1]], [-d[2], 0, d[0]], [d[1], -d[0], 0]]
    return motion


def tube_of(file: SubDynFile, member, factor: float) -> beam.Tube:
    """A tube with the area and second moment of the section (a tower's too)."""
    e, g, density, *sizes = file.set_of(member).values
    if member.kind == "circular":
        diameter, wall = sizes
    else:
        area, second = sizes[0], sizes[3]
        outer = np.sqrt(2 * second / area + area / (2 * np.pi))
        inner = np.sqrt(2 * second / area - area / (2 * np.pi))
        diameter, wall = 2 * outer, outer - inner
    return beam.Tube(diameter_m=diameter, thickness_m=wall, youngs_modulus_pa=e * factor, poisson_ratio=e / (2 * g) - 1,
                     density_kgpm3=density)


class SecondTheory:
    """`stiffness`: member id -> factor on its moduli; `soil`: reaction joint -> factor on its soil stiffness.

    modes(n) gives frequencies (n,) in Hz and shapes (6, n_joint, n) of all joints, unit modal mass.
    """

    def __init__(self, file: SubDynFile, *, stiffness: Mapping[int, float] | None = None,
                 soil: Mapping[int, float] | None = None):
        self.joint = {joint.id: k for k, joint in enumerate(file.joints)}
        place = [np.array(joint.position_m) for joint in file.joints]
        links, parts = [], []
        for member in file.members:
            one, two = (self.joint[j] for j in member.joints)
            if member.kind == "rigid":
                links.append((one, two))
                continue
            n = PIECES[member.kind]
            nodes = [one, *range(len(place), len(place) + n - 1), two]
            start, end = place[one], place[two]
            place += [start + (end - start) * k / n for k in range(1, n)]
            tube = tube_of(file, member, (stiffness or {}).get(member.id, 1.0))
            parts += [(a, b, tube) for a, b in zip(nodes[:-1], nodes[1:], strict=True)]
        size = 6 * len(place)
        K, M = sparse.lil_array((size, size)), sparse.lil_array((size, size))
        for a, b, tube in parts:
            axes, length = beam.local_axes(place[a], place[b])
            dofs = np.r_[6 * a : 6 * a + 6, 6 * b : 6 * b + 6]
            K[np.ix_(dofs, dofs)] += beam.to_global(beam.local_stiffness(tube, length), axes)
            half = beam.lumped_mass(tube, length, axes)
            for node in (a, b):
                own = slice(6 * node, 6 * node + 6)
                M[own, own] += half
        for row in file.masses:
            node, (m, xx, yy, zz, xy, xz, yz, *offset) = self.joint[row.id], row.values
            body = np.zeros((6, 6))
            body[:3, :3], body[3:, 3:] = m * np.eye(3), [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
            motion = arm(np.array(offset))
            M[6 * node : 6 * node + 6, 6 * node : 6 * node + 6] += motion.T @ body @ motion
        for reaction in file.reactions:
            if reaction.ssi is not None:
                own = slice(6 * self.joint[reaction.joint], 6 * self.joint[reaction.joint] + 6)
                K[own, own] += (soil or {}).get(reaction.joint, 1.0) * file.soil[reaction.ssi].stiffness
        # every node of a rigid assembly follows the one it was first linked to
        leader = list(range(len(place)))
        for one, two in links:
            a, b = leader[one], leader[two]
            leader = [a if x == b else x for x in leader]
        masters = sorted(set(leader))
        column = {node: k for k, node in enumerate(masters)}
        T = sparse.lil_array((size, 6 * len(masters)))
        for node, lead in enumerate(leader):
            T[6 * node : 6 * node + 6, 6 * column[lead] : 6 * column[lead] + 6] = arm(place[node] - place[lead])
        T = sparse.csr_array(T)
        held = [6 * column[leader[self.joint[r.joint]]] + k for r in file.reactions for k in range(6) if r.fixed[k]]
        free = np.setdiff1d(np.arange(T.shape[1]), held)
        self.to_joints = T[: 6 * len(file.joints)][:, free]
        T = T[:, free]
        self.K, self.M = sparse.csc_array(T.T @ K.tocsr() @ T), sparse.csc_array(T.T @ M.tocsr() @ T)

    def modes(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        factor = splu(sparse.csc_matrix(self.K))
        inverse = sparse.linalg.LinearOperator(self.K.shape, factor.solve, dtype=float)
        value, shape = eigsh(self.K, k=n, M=self.M, sigma=0.0, OPinv=inverse, v0=np.cos(np.arange(self.K.shape[0])))
        order = np.argsort(value)
        value, shape = value[order], shape[:, order]
        shape = shape / np.sqrt(np.einsum("ij,ij->j", shape, self.M @ shape))
        return np.sqrt(value) / (2 * np.pi), (self.to_joints @ shape).reshape(-1, 6, n).transpose(1, 0, 2)
