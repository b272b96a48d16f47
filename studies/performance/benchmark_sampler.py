"""Effective draws a second of the worst of ten parameters, against emcee's stretch move alone, in one run.

The problem is the demonstration's kind: the reference turbine as built, modes of its updated state with noise, the
paper's weights. Both chains start from the same draws and ask the same reduced model; preparation is told apart.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time

import emcee
import numpy as np

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.ensemble import SamplerSettings, sample
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.posterior_file import effective_size
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.runs import approach

COV = (0.015, 0.015, 0.017, 0.017, 0.017)


def turbine_problem(seed: int, share: float):
    """Five modes of the updated turbine, frequencies off by `share` of the weights' deviations."""
    truth, model = (load_model(reference_model(state)) for state in ("updated", "as_built"))
    solution = truth.solve(truth.parameters.initial, len(COV))
    rng = np.random.default_rng(seed)
    shape = solution.shape / np.max(np.abs(solution.shape), axis=0)
    shape = shape + share * 0.15 * rng.standard_normal(shape.shape)
    frequency = solution.frequency_hz * (1 + share * np.array(COV) * rng.standard_normal(len(COV)))
    unknown = np.full(len(COV), np.nan)
    one = ModalSet(id="one", frequency_hz=frequency, shape=shape, damping_ratio=unknown, frequency_std_hz=unknown,
                   shape_std=np.full(shape.shape, np.nan))
    weights = Weights(frequency_cov=tuple(share * c for c in COV), shape_std=False)
    return build_problem(model, ModalData(channels=truth.channels, sets=(one,)), weights=weights)


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ess", type=int, default=1000, help="effective draws wanted of the worst parameter (1000)")
    parser.add_argument("--share", type=float, default=1.0, help="deviations over the paper's (1); less is sharper")
    parser.add_argument("--plain-steps", type=int, default=1000, help="steps of the stretch move (1000)")
    parser.add_argument("--seed", type=int, default=1)
    a = parser.parse_args()
    problem = turbine_problem(a.seed, a.share)
    begun = time.process_time()
    laplace = maximum_a_posteriori(problem, [problem.parameters.initial])
    prepared = approach(problem, laplace, a.seed)
    say(f"preparation (maximum, outline, reduced basis, surfaces): {time.process_time() - begun:.1f} s of processor")
    surfaces = "no surfaces" if prepared.emulator is None else f"surfaces' error in ln p {prepared.emulator.error:.2f}"
    say(f"share of the Gaussian approximation {prepared.notes['approximation']:.2f}, {surfaces}")
    rates = {}
    # surfaces are made only where the outline serves badly
    with_surfaces = [] if prepared.emulator is None else [("all moves", prepared.emulator)]
    for name, emulator in [*with_surfaces, ("without surfaces", None)]:
        with tempfile.TemporaryDirectory() as folder:
            begun = time.process_time()
            chain = sample(prepared.problem, prepared.surrogate, folder, SamplerSettings(seed=a.seed, target_ess=a.ess),
                           emulator=emulator)
            seconds = time.process_time() - begun
        rates[name] = chain.ess.min() / seconds
        say(f"{name}: {chain.verdict} {seconds:.1f} s, worst effective size {chain.ess.min():.0f}: {rates[name]:.1f} a "
            f"second, {chain.ess.min() / chain.evaluated:.4f} an evaluation")
    n_walker = 4 * len(problem.parameters)
    start = prepared.surrogate.draw(n_walker, np.random.default_rng(a.seed))
    sampler = emcee.EnsembleSampler(
        n_walker, len(problem.parameters), lambda theta: prepared.problem.log_posterior(theta)[0], vectorize=True,
    )
    state = emcee.State(start, random_state=np.random.RandomState(a.seed).get_state())
    begun = time.process_time()
    sampler.run_mcmc(state, a.plain_steps)
    seconds = time.process_time() - begun
    _, ess = effective_size(sampler.get_chain()[a.plain_steps // 5 :])
    rates["stretch"] = ess.min() / seconds
    say(f"emcee's stretch move, {n_walker} walkers, {a.plain_steps} steps: {seconds:.1f} s, worst effective size "
        f"{ess.min():.0f}: {rates['stretch']:.1f} a second, {ess.min() / (a.plain_steps * n_walker):.4f} an evaluation")
    for name in list(rates)[:-1]:
        say(f"{name} over stretch: {rates[name] / rates['stretch']:.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
