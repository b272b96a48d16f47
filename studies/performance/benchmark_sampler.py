"""What an effective draw costs, beside bare emcee with differential-evolution moves started in the posterior.

Processor time of the whole of `sample`'s work (maximum, basis, proposal, weighted draws, chain, evidence) over the
effective size of the worst parameter; of emcee, with the moves of its own advice, the time of the chain alone, on the
same model. Cases: two parameters; a thin ridge of two; ten of the reference turbine with the paper's weights, and with
a tenth of them (sharp); one set of a chain of masses and 48 sets together.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time

import emcee
import numpy as np
from scipy import sparse

from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.affine import AffineModel
from probupdate.structure.functions import FunctionModel
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.joint_set import joint_set
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.posterior_file import effective_size
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.runs import approach, sample_posterior
from probupdate.updating.settings import SamplerSettings

COV = (0.015, 0.015, 0.017, 0.017, 0.017)
N_MASS, N_MODE, N_SET = 6, 4, 48
# steps of the bare chain beyond its first fifth, which is left out
BARE_STEPS = {"two parameters": 4000, "ridge": 4000, "ten parameters": 1500, "sharp": 1500, "one set": 2000}


def of_set(frequency, shape, frequency_std, shape_std=np.nan, id="one") -> ModalSet:
    return ModalSet(id=id, frequency_hz=frequency, shape=shape, damping_ratio=np.full(len(frequency), np.nan),
                    frequency_std_hz=frequency_std, shape_std=np.broadcast_to(shape_std, shape.shape))


def turbine(seed: int, share: float):
    """Five modes of the updated turbine, frequencies off by `share` of the paper's deviations."""
    truth, model = (load_model(reference_model(state)) for state in ("updated", "as_built"))
    solution = truth.solve(truth.parameters.initial, len(COV))
    rng = np.random.default_rng(seed)
    shape = solution.shape / np.max(np.abs(solution.shape), axis=0)
    shape = shape + share * 0.15 * rng.standard_normal(shape.shape)
    frequency = solution.frequency_hz * (1 + share * np.array(COV) * rng.standard_normal(len(COV)))
    one = of_set(frequency, shape, np.full(len(COV), np.nan))
    return model, ModalData(channels=truth.channels, sets=(one,)), Weights(
        frequency_cov=tuple(share * c for c in COV), shape_std=False)


def two(sigma: float, second: float):
    """Springs in series, known together to `sigma`, and a frequency of the first of them to `second`."""
    parameters = Parameters(tuple(Parameter(name=name, unit="-", initial=1.0, std=0.5, lower=0.05, upper=6.0)
                                  for name in "ab"))
    shape = np.linalg.qr(np.random.default_rng(5).standard_normal((6, 6)))[0]

    def function(theta):
        a, b = theta
        return np.concatenate([[np.sqrt(2 / (1 / a + 1 / b)), 20.0 * np.sqrt(a)], 100.0 * 1.5 ** np.arange(4)]), shape

    model = FunctionModel(name="two springs", parameters=parameters, channels=tuple(f"c{k}" for k in range(6)),
                          function=function, version="1")
    frequency = np.array([1.0, 20.0])
    one = of_set(frequency, shape[:, :2], frequency * np.array([sigma, second]))
    return model, ModalData(channels=model.channels, sets=(one,)), Weights(shapes="none")


def masses(seed: int, n_set: int):
    """Sets of a chain of masses on springs, three parameters."""
    springs = [np.zeros((N_MASS, N_MASS)) for _ in range(2)]
    for k in range(N_MASS):
        ends = [j for j in (k - 1, k) if j >= 0]
        springs[k >= N_MASS // 2][np.ix_(ends, ends)] += 400.0 * (np.array([[1.0, -1.0], [-1.0, 1.0]])[-len(ends) :,
                                                                                                       -len(ends) :])
    parameters = Parameters(tuple(Parameter(name=name, unit="-", initial=1.0, std=0.2, lower=0.2, upper=3.0)
                                  for name in ("below", "above", "mass")))
    channels = tuple(f"x{k}" for k in range(N_MASS))
    model = AffineModel(name="masses", parameters=parameters, channels=channels, hash_key="masses",
                        stiffness=tuple(sparse.csc_array(k) for k in springs), mass=(sparse.csc_array(np.eye(N_MASS)),),
                        coefficients=lambda theta: (theta[..., :2], theta[..., 2:]),
                        channel_matrix=sparse.csr_array(np.eye(N_MASS)))
    rng = np.random.default_rng(seed)
    solution = model.solve(np.array([0.9, 1.1, 1.05]), N_MODE)
    shape = solution.shape / np.abs(solution.shape).max(axis=0)
    sets = tuple(of_set(solution.frequency_hz * (1 + 3e-3 * rng.standard_normal(N_MODE)),
                        shape + 0.02 * rng.standard_normal(shape.shape), 3e-3 * solution.frequency_hz, 0.02, f"set {k}")
                 for k in range(n_set))
    return model, ModalData(channels=channels, sets=sets), Weights()


def cases(seed: int):
    return {"two parameters": lambda: two(1e-2, 1e-2), "ridge": lambda: two(1e-3, 1.0),
            "ten parameters": lambda: turbine(seed, 1.0), "sharp": lambda: turbine(seed, 0.1),
            "one set": lambda: masses(seed, 1), f"{N_SET} sets": lambda: masses(seed, N_SET)}


def whole(make, seed: int, ess: int):
    """Seconds of processor time, effective size, and the chain's verdict, of all the work."""
    model, data, weights = make()
    begun = time.process_time()
    together = joint_set(data)
    with tempfile.TemporaryDirectory() as folder:
        found = sample_posterior(model, together.data, folder, weights=weights,
                                 settings=SamplerSettings(seed=seed, target_ess=ess))
    return time.process_time() - begun, float(np.min(found.ess)), found


def bare(make, seed: int, steps: int):
    """Seconds and effective size of emcee alone, from draws of the posterior."""
    model, data, weights = make()
    problem = build_problem(model, joint_set(data).data, weights=weights)
    prepared = approach(problem, maximum_a_posteriori(problem, [problem.parameters.initial]), seed)
    n = len(problem.parameters)
    n_walker = max(4 * n, 16)
    start = prepared.proposal.draw_inside(20 * n_walker, np.random.default_rng(seed))
    start = start[np.argsort(-prepared.problem.log_posterior(start)[0])][: 4 * n_walker : 4]
    sampler = emcee.EnsembleSampler(
        n_walker, n, lambda theta: prepared.problem.log_posterior(theta)[0], vectorize=True,
        moves=[(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)])
    state = emcee.State(start, random_state=np.random.RandomState(seed).get_state())
    begun = time.process_time()
    sampler.run_mcmc(state, steps + steps // 4, skip_initial_state_check=True)
    seconds = time.process_time() - begun
    return 0.8 * seconds, float(np.min(effective_size(sampler.get_chain()[steps // 4 :])[1]))


def say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", nargs="+", help="of these alone")
    parser.add_argument("--ess", type=int, default=1000, help="effective draws wanted of the worst parameter (1000)")
    parser.add_argument("--seed", type=int, default=1)
    a = parser.parse_args()
    known, seconds, rates = cases(a.seed), {}, {}
    # libraries are loaded, and not by the first case
    whole(lambda: two(0.1, 0.1), a.seed, 100)
    say("| case | sample | effective | emcee alone | effective | cost of a draw, ratio | verdict |")
    say("|---|---|---|---|---|---|---|")
    for name in a.case or known:
        seconds[name], size, found = whole(known[name], a.seed, a.ess)
        own, text = seconds[name] / size, "| | "
        ratio = ""
        if name in BARE_STEPS:
            alone, effective = bare(known[name], a.seed, BARE_STEPS[name])
            text, ratio = f"| {alone:.1f} s | {effective:.0f} ", f"{own * effective / alone:.2f}"
            rates[name] = alone / effective / own
        weighted = found.record["importance sampling"]
        verdict = "converged" if found.converged else "not"
        say(f"| {name} | {seconds[name]:.1f} s | {size:.0f} {text}| {ratio} | {verdict}, weights "
            f"{weighted['effective']:.0f} of {weighted['n_draw']}, k {weighted['pareto_k']:.2f} |")
    both = [seconds.get(name) for name in ("one set", f"{N_SET} sets")]
    if all(both):
        say(f"{N_SET} sets over one: {both[1] / both[0]:.2f}")
    for name, rate in rates.items():
        say(f"all of sample over emcee, {name}: {rate:.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
