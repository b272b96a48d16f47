"""One replicate's structure and measurement: a draw of the prior, a model or the virtual turbine, noise.

Three structures: "own", the model that is updated, so that only the estimators and the statement of the noise can be
wrong; "turbine", the virtual turbine (other mesh, mass and soil law, drawn tolerances of walls, soil and sensors);
"other", the same with yet another soil law, nacelle and mesh, which no choice of the package has seen (records only).
Three kinds of noise: "paper" (1.5 and 1.7 % of frequencies, tenfold of shapes, Gaussian and stated exactly),
"identified" (the scatter of half an hour's identification with its own estimate of its covariance), "record" (half an
hour of vibration, simulated and identified; virtual turbine only).
"""

from __future__ import annotations

import os
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import numpy as np

from probupdate import verbs
from probupdate.effects.tolerances import TurbineUncertainty
from probupdate.errors import InputError
from probupdate.modal.labels import mode_character
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameters
from probupdate.structure.affine import AffineModel
from probupdate.structure.load import reference_model
from probupdate.structure.reduced import reduce_basis
from probupdate.structure.reduced_model import ReducedModel, project
from probupdate.updating.discrepancy import default_likelihood
from probupdate.updating.problem import Weights
from probupdate.updating.responses import PAPER_COV_FIRST, PAPER_COV_SECOND, SHAPE_FACTOR
from probupdate.virtual import campaign_files, mesh, operation, soil
from probupdate.virtual.dynamics import N_MODE, heading_modes
from probupdate.virtual.frame import build_structure
from probupdate.virtual.hours import RATE_HZ, hour_of_data, make_turbine
from probupdate.virtual.modal_noise import identified_modes
from probupdate.virtual.simulation import nacelle_labels
from probupdate.virtual.truth import draw_truth, parse_truth
from probupdate.virtual.turbine_file import TurbineFile, read_turbine

STATE = "as_built"
LABELS = ("FA1", "SS1", "T1", "FA2", "SS2")
PRIORS = ("normal", "lognormal")
STRUCTURES = ("own", "turbine", "other")
# of "other": another clay than the virtual turbine's (stiffer near the head, softer along the pile), a nacelle two
# tolerances off its drawing, a mesh twice as coarse
OTHER_SOIL = {"STEEPNESS": 3.1, "RIGIDITY_INDEX": 140.0, "LOAD_TRANSFER": 4.6}
OTHER_NACELLE, OTHER_COARSENESS = 1.02, 2.0
# "allowed" is a record with ALLOWED of model error stated: what such models differ by at equal parameters
# "default" is a record with what `update` and `sample` take where no option is given: tolerances and discrepancy
NOISES = ("paper", "identified", "record", "allowed", "default")
RECORDED = NOISES[2:]
ALLOWED = 0.01
SEARCHED = 24  # computed modes among which those of LABELS are told
CARRIED = 7  # modes of the reduced basis: the five, the next one, and one to spare
# of the reduced basis over all of both priors: a fifth of the paper's standard deviations, a fifth of identification's
FREQUENCY_TOLERANCE = {"paper": 3e-3, "identified": 4e-4, "record": 4e-4, "allowed": 4e-4, "default": 4e-4}
# the basis holds between these quantiles of either prior
EDGE = 1e-3
BLOCK_S = 1800.0
N_SLOT = 3
MAINTENANCE = {"maintenance_hours": [[0, 24]]}  # idling at any wind


@dataclass(frozen=True, eq=False, kw_only=True)
class Bench:
    """What all replicates share: the full model and one reduced basis, both at heading 0; `frequency_hz` (5,) of the
    initial model, which the paper's standard deviations are shares of."""

    file: TurbineFile
    full: AffineModel
    reduced: ReducedModel
    frequency_hz: np.ndarray

    def with_prior(self, kind: str) -> tuple[AffineModel, ReducedModel]:
        """Both models with all priors of one kind."""
        parameters = of_kind(self.full.parameters, kind)
        full = replace(self.full, parameters=parameters)
        projected = replace(self.reduced.projected, parameters=parameters)
        return full, replace(self.reduced, full=full, projected=projected)


def of_kind(parameters: Parameters, kind: str) -> Parameters:
    return Parameters(tuple(replace(p, prior=kind) for p in parameters), parameters.correlation)


def make_bench(folder: Path, noise: str, theory: str = "timoshenko", seed: int = 0) -> Bench:
    """The reference turbine as built, its members of that theory; the basis covers both priors and is kept in
    `folder`."""
    own = folder / f"{theory}.toml"
    text = reference_model(STATE).read_text(encoding="utf-8")
    own.write_text(text.replace('theory = "timoshenko"', f'theory = "{theory}"'), encoding="utf-8")
    full = verbs.open_model(own)
    full = replace(full, uncertainty=TurbineUncertainty.from_description(own, full, None, None))
    file = read_turbine(reference_model(STATE))
    ends = np.array([[p.distribution.ppf([EDGE, 1 - EDGE]) for p in of_kind(full.parameters, kind)]
                     for kind in PRIORS])
    box = ends[:, :, 0].min(axis=0), ends[:, :, 1].max(axis=0)
    rng = np.random.default_rng([seed, 7])
    points = np.clip(np.vstack([of_kind(full.parameters, kind).draw(rng, 200) for kind in PRIORS]), *box)
    tolerance = FREQUENCY_TOLERANCE[noise]
    path = folder / f"basis.{theory}.{tolerance:g}.{seed}.npz"
    if not path.exists():
        found = reduce_basis(full, n_mode=CARRIED, box=box, points=points, seed=seed, frequency_tolerance=tolerance)
        family = np.empty(found.basis.shape[1], int)
        for number, block in enumerate(found.blocks):
            family[block.rows] = number
        part = path.with_suffix(f".{os.getpid()}.npz")
        np.savez(part, basis=found.basis, family=family, box=box)
        part.replace(path)
    with np.load(path) as kept:
        reduced = project(full, kept["basis"], kept["family"], kept["box"], CARRIED, tolerance).with_shares(points)
    # proposals reach a little beyond the box, where prior and posterior have next to nothing: the basis answers there
    # too, as thousands of full solutions would cost more than all else
    reduced = replace(reduced, lower=full.parameters.lower, upper=full.parameters.upper)
    return Bench(file=file, full=full, reduced=reduced, frequency_hz=own_modes(full, file, full.parameters.initial)[0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """Data of one structure: as many sets as asked for, and how they are to be weighed."""

    data: ModalData
    weights: Weights


def measure(
    bench: Bench, theta: np.ndarray, structure: str, noise: str, rng: np.random.Generator, n_set: int, folder: Path
) -> Measured:
    """Raises InputError where the structure lacks one of the five modes, or none is identified."""
    if noise in RECORDED:
        with other_structure() if structure == "other" else nullcontext():
            data = _recorded(bench, theta, rng, folder, OTHER_NACELLE if structure == "other" else 1.0)
        if noise == "default":
            weights = default_weights(bench.full, data)
        else:
            weights = Weights(covariance=True, discrepancy=ALLOWED if noise == "allowed" else 0.0)
        return Measured(data=data, weights=weights)
    modes = own_modes if structure == "own" else turbine_modes
    frequency, damping, shape = modes(bench.full, bench.file, theta, rng)
    channels = tuple(s.channel for s in bench.file.sensors)
    if noise == "paper":
        sets, weights = [_paper_set(bench, frequency, shape, rng, k) for k in range(n_set)], Weights()
    else:
        sets = [_identified_set(frequency, damping, shape, rng, k) for k in range(n_set)]
        weights = Weights(covariance=True)
    return Measured(data=ModalData(channels=channels, sets=tuple(sets), labels=LABELS), weights=weights)


def own_modes(full: AffineModel, file: TurbineFile, theta: np.ndarray, rng=None):
    """frequency_hz, damping_ratio (5,), shape (n_channel, 5) of the updated model; 1.3 % of damping and the air's."""
    solution = full.solve(theta, SEARCHED)
    shape = solution.shape[[full.channels.index(s.channel) for s in file.sensors]]
    chosen = _of_labels(mode_character(shape, file.sensors).labels)
    return solution.frequency_hz[chosen], np.full(len(chosen), 0.013), shape[:, chosen]


def turbine_modes(full: AffineModel, file: TurbineFile, theta: np.ndarray, rng: np.random.Generator):
    """The same of the virtual turbine with these parameters, its tolerances drawn, as its sensors are mounted."""
    truth = _truth(full, file, theta, rng)
    modes = heading_modes(build_structure(file, truth, ()), truth.damping_ratio, 0.0)
    chosen = _of_labels(nacelle_labels(modes, file.sensors))
    return modes.frequency_hz[chosen], modes.damping_ratio["idling"][chosen], modes.observed_shape[:, chosen]


def _truth(full: AffineModel, file: TurbineFile, theta: np.ndarray, rng: np.random.Generator):
    given = parse_truth({"parameters": dict(zip(full.parameters.names, map(float, theta), strict=True))}, file)
    return draw_truth(given, file, rng, N_MODE)


def _of_labels(labels: tuple[str, ...]) -> list[int]:
    missing = [label for label in LABELS if label not in labels]
    if missing:
        raise InputError("structure", f"has no {missing[0]}", "draw another")
    return [labels.index(label) for label in LABELS]


def _paper_set(bench: Bench, frequency, shape, rng, number: int) -> ModalSet:
    # shares of the initial model's frequencies: standard deviations that told of the truth would be data themselves
    cov = np.array([PAPER_COV_FIRST if label in ("FA1", "SS1") else PAPER_COV_SECOND for label in LABELS])
    std = cov * bench.frequency_hz
    shape = shape / np.abs(shape).max(axis=0)
    shape_std = np.broadcast_to(SHAPE_FACTOR * cov, shape.shape)
    return ModalSet(
        id=f"{number}", frequency_hz=frequency + std * rng.standard_normal(len(std)),
        damping_ratio=np.full(len(std), 0.013), shape=shape + shape_std * rng.standard_normal(shape.shape),
        frequency_std_hz=std, shape_std=shape_std, environment={},
    )


def _identified_set(frequency, damping, shape, rng, number: int) -> ModalSet:
    f, zeta, phi, covariance_factors = identified_modes(frequency, damping, shape.astype(complex), LABELS, BLOCK_S, rng)
    return ModalSet(id=f"{number}", frequency_hz=f, damping_ratio=zeta, shape=phi,
                    covariance_factors=covariance_factors, environment={},
                    frequency_std_hz=np.full(len(f), np.nan), shape_std=np.full(phi.shape, np.nan))


def default_weights(full: AffineModel, data: ModalData) -> Weights:
    """What `update` and `sample` take where no option is given."""
    return default_likelihood(full, data)


@contextmanager
def other_structure():
    """The virtual turbine's laws replaced, for one record."""
    longest = {group: OTHER_COARSENESS * length for group, length in mesh.LONGEST_M.items()}
    with ExitStack() as stack:
        for name, value in OTHER_SOIL.items():
            stack.enter_context(mock.patch.object(soil, name, value))
        stack.enter_context(mock.patch.object(mesh, "LONGEST_M", longest))
        yield


def _recorded(bench: Bench, theta, rng: np.random.Generator, folder: Path, nacelle: float) -> ModalData:
    """Half an hour of an idling turbine that looks along the model's axis, through `identify`."""
    truth = _truth(bench.full, bench.file, theta, rng)
    mass = truth.tolerances.nacelle_mass * nacelle
    truth = replace(truth, tolerances=replace(truth.tolerances, nacelle_mass=mass))
    plan = operation.make_plan(N_SLOT, MAINTENANCE, rng)
    plan = replace(plan, heading_deg=np.zeros_like(plan.heading_deg), events=())
    channels = tuple(s.channel for s in bench.file.sensors)
    data = hour_of_data(make_turbine(bench.file, truth, plan, int(rng.integers(2**31))), (), channels, 0)
    (folder / "acceleration").mkdir(parents=True)
    depth = -bench.file.number("site", "mudline_m")
    campaign_files.write_campaign_toml(folder, name="half an hour", sensors=bench.file.sensors, rate_hz=RATE_HZ,
                                       block_minutes=30, water_depth_m=depth)
    campaign_files.write_acceleration(folder / "acceleration" / "one.h5", data, np.datetime64("2019-06-01T00:00:00"),
                                      RATE_HZ)
    return verbs.identify(folder, STATE).data.compared()
