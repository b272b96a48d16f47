"""How fast modes are to be had: reduced basis, full solution, plain scipy, OpenSees. One run prints every ratio.

    OMP_NUM_THREADS=1 python studies/performance/benchmark_modal.py
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse import linalg as sparse_linalg

from probupdate.structure.description_file import read_description
from probupdate.structure.load import load_model, reference_model
from probupdate.structure.reduced import reduce_basis
from probupdate.structure.turbine_frame import build_frame

N_MODE = 6
# a posterior of ten well separated measurements: what six frequencies known to 0.5 % leave of the prior
FREQUENCY_COV = 0.005
BATCH = 1000


def likely_points(model, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, n_param): draws of the linearised posterior inside the bounds."""
    parameters = model.parameters
    solution = model.solve(parameters.initial, N_MODE, derivatives=True)
    slope = solution.frequency_derivative / solution.frequency_hz[:, None] / FREQUENCY_COV
    covariance = np.linalg.inv(slope.T @ slope + np.linalg.inv(parameters.covariance))
    kept = np.empty((0, len(parameters)))
    while len(kept) < n:
        draws = rng.multivariate_normal(parameters.initial, covariance, size=4 * n)
        kept = np.vstack([kept, draws[parameters.inside(draws)]])
    return kept[:n]


def seconds(work: Callable[[int], object], repeat: int) -> float:
    """The least processor time of `repeat`: what else the machine does only adds. `work` is given the number of the
    repetition, so that it asks for another parameter vector each time: models remember their last answers."""
    times = []
    for k in range(repeat):
        start = time.process_time()
        work(k)
        times.append(time.process_time() - start)
    return min(times)


def opensees_seconds(repeat: int) -> tuple[float, int] | str:
    """Time of one eigenvalue analysis of the same frame and its number of equations, or why there is none."""
    sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
    import opensees_builder
    from opensees_loader import load_opensees

    try:
        ops = load_opensees()
    except (ImportError, OSError) as error:
        return str(error)
    description = read_description(reference_model("as_built"))
    opensees_builder.build(ops, build_frame(description), description.values, water=True)

    def analyse():
        ops.wipeAnalysis()
        opensees_builder.frequencies(ops, N_MODE)

    taken = seconds(lambda k: analyse(), repeat)
    # rigid arms and held ground nodes of springs carry no equations of their own
    size = 6 * len(ops.getNodeTags()) - 6 * len(ops.getFixedNodes())
    ops.wipe()
    return taken, size


def main() -> None:
    rng = np.random.default_rng(0)
    model = load_model(reference_model("as_built"))
    points = likely_points(model, 5 * BATCH, rng)
    start = time.process_time()
    reduced = reduce_basis(
        model, n_mode=N_MODE, box=(points.min(axis=0), points.max(axis=0)), frequency_tolerance=1e-5, points=points
    )
    building = time.process_time() - start
    rows = points[rng.permutation(len(points))[:BATCH]]

    rates = {}
    rates["reduced basis, 1000 at once"] = BATCH / seconds(
        lambda k: reduced.solve_many(points[k::len(points) // BATCH][:BATCH], N_MODE), len(points) // BATCH)
    rates["full model"] = 1 / seconds(lambda k: model.solve(rows[k], N_MODE), 10)
    rates["full model with derivatives"] = 1 / seconds(lambda k: model.solve(rows[20 + k], N_MODE, derivatives=True), 5)
    K, M = (sparse.csc_matrix(a) for a in model.matrices(rows[0]))
    rates["scipy.sparse.linalg.eigsh, same matrices"] = 1 / seconds(
        lambda k: sparse_linalg.eigsh(K, N_MODE, M, sigma=0.0), 10
    )
    peer = opensees_seconds(3)

    r = reduced.report
    print(f"{model.name}: {model.n_dof} degrees of freedom, {len(model.parameters)} parameters, {N_MODE} modes, "
          f"{len(model.channels)} channels")
    blocks = ", ".join(str(len(block.rows)) for block in reduced.blocks)
    print(f"reduced basis: {r.size} vectors in blocks of {blocks}, built in {building:.1f} s; on {r.n_verify} unseen "
          f"points frequencies within {r.max_frequency_error:.1e} ({r.max_box_error:.1e} all over its box), MAC at "
          f"least {r.min_mac:.6f}")
    if isinstance(peer, str):
        print(f"OpenSees: not measured ({peer})")
    else:
        rates[f"OpenSees, {peer[1]} equations, one analysis"] = 1 / peer[0]
    slowest = rates["full model"]
    print(f"{'':45s}{'a second':>10s}{'ratio':>10s}")
    for name, rate in rates.items():
        print(f"{name:45s}{rate:10.1f}{rate / slowest:10.2f}")


if __name__ == "__main__":
    main()
