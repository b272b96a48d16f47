"""Numbers that decide what updating finds and says.

`CONSTANTS` is the one value of all that decide something; modules take theirs from it under a name of their own. What
is a matter of speed or of files alone stays where it is used. docs/reference/settings.md is made of these rows.
"""

from __future__ import annotations

from dataclasses import dataclass

from probupdate.errors import InputError
from probupdate.runtime.settings import refuse_other_types, setting


@dataclass(frozen=True, kw_only=True)
class UpdateSettings:
    """How Eq. 7 is run."""

    alpha: float | str = setting(
        1.0, "-", "regularisation coefficient of Eq. 6, or the rule that chooses it: 'l-curve', "
        "'discrepancy', 'evidence'", "1: a maximum of the posterior")
    method: str = setting("gauss-newton", "-", "solves the anchored reading: 'gauss-newton' or 'levenberg-marquardt'")
    iterations: int = setting(50, "-", "at most so many iterations")

    def __post_init__(self):
        refuse_other_types(self)
        if self.iterations < 0:
            raise InputError("iterations", f"{self.iterations} is negative", "give 0 or more")


@dataclass(frozen=True, kw_only=True)
class SamplerSettings:
    """How long the chain goes on, and from where. Walkers of one ensemble depend on one another: only independent
    ensembles, each with its own start and random numbers, show that they agree."""

    seed: int = setting(1, "-", "of the random numbers: same seed, same numbers")
    walkers_per_parameter: int = setting(2, "-", "walkers over parameters; never fewer than two of each and two, "
        "nor than twelve")
    target_ess: int = setting(1000, "draws", "effective size of the worst parameter at which the chain ends")
    max_steps: int = setting(20000, "steps", "the run gives up after these, and says so")
    ensembles: int = setting(4, "-", "independent ensembles, judged together")

    def __post_init__(self):
        refuse_other_types(self)
        for name, least in (("seed", 0), ("walkers_per_parameter", 1), ("target_ess", 1), ("max_steps", 5),
                            ("ensembles", 1)):
            if getattr(self, name) < least:
                raise InputError(name, f"{getattr(self, name)} is below {least}", f"give {least} or more")


@dataclass(frozen=True, kw_only=True)
class UpdatingConstants:
    """Tolerances, weights and limits of the estimators, of convergence and of the verdicts."""

    least_bend: float = setting(0.1, "-", "curvature of ln misfit over ln penalty from which the L-curve has a corner")
    alpha_tolerance: float = setting(1e-3, "prior std", "each update along the path over alpha stops at smaller moves")
    close: float = setting(0.25, "posterior std", "estimates that are closer are the same for any use of them")
    same: float = setting(
        0.01, "posterior std", "anchored update and maximum farther apart than this did not reach the same point")
    high_correlation: float = setting(0.95, "-", "from this correlation on a parameter is absorbed by its partner")
    ridge: float = setting(0.7, "-", "correlation from which a ridge is offered as the reason for a difference")
    place: float = setting(0.01, "prior std", "grid of the place at which the sources of error are linearised")
    most_discrepancy: float = setting(0.2, "-", "a misfit that this share does not explain is refused")
    frequency_discrepancy: float = setting(
        1e-2, "-", "scale of the half-Cauchy hyper-prior of what the model misses of frequencies, a share of each, "
        "with what mixing of modes does to them; beside stated tolerances of the structure form_frequency_cov",
        "Gelman 2006; models of measured frames miss 0.3 to 1 %")
    shape_discrepancy: float = setting(
        1e-2, "-", "the same of shapes, a share of the largest component (form_shape_std)",
        "two independent programs: 0.1 to 0.6 %")
    shared_discrepancy: float = setting(
        0.5, "-", "share of a stated discrepancy's variance that is the same in all sets", "half, as neither is known")
    r_hat_limit: float = setting(
        1.01, "-", "nested R-hat over ensembles below which a chain has converged", "Margossian et al. 2024")
    autocorrelation_times: int = setting(
        50, "-", "length of a converged chain in integrated autocorrelation times", "emcee's advice")
    spread_ess: int = setting(
        400, "draws", "effective size of the worst standard deviation of a converged chain", "Vehtari et al. 2021")
    burn_in: float = setting(0.2, "-", "share of the chain that is left out at its start")
    trusted_k: float = setting(
        0.7, "-", "Pareto k above which importance weights are not averaged", "Vehtari et al. 2024")
    population_spread: float = setting(
        0.25, "prior std", "scale of the half-normal hyper-prior of a parameter's scatter between sets")
    lkj_eta: float = setting(2.0, "-", "exponent of the LKJ prior of the correlation between sets")
    population_r_hat_limit: float = setting(1.02, "-", "R-hat of the population below which it has converged")
    outlier_share: float = setting(0.05, "-", "share of sets that are outliers a priori")
    outlier_wide: float = setting(0.05, "ln f", "scale of the Cauchy distribution of an outlier's frequency")
    outlier_shape_wide: float = setting(
        0.3, "-", "length of what an outlier's shape, of unit length, has beside the other sets'")
    outlier_sure: float = setting(0.95, "-", "probability from which a set is left out of the population as an outlier")
    same_angle_deg: float = setting(
        10.0, "deg", "a nacelle that looks farther than this from the other sets' is not a comparable condition")
    strong: float = setting(0.5, "-", "posterior over prior standard deviation below which the data decide")
    blind: float = setting(0.9, "-", "above this one the parameter keeps its prior")
    good_k: float = setting(0.5, "-", "Pareto k below which importance sampling alone is trusted",
                            "Vehtari et al. 2024")
    most_z: float = setting(4.5, "std", "difference of two means that chance exceeds once in some ten thousand")
    least_apart: float = setting(
        0.1, "posterior std", "smaller differences of chain and importance sampling do not matter")
    uncertainty_from: tuple[float, ...] = setting(
        (0.015, 0.20, 0.75), "-", "CoV of the prior from which the uncertainty metric is 1, 2, 3",
        "Table 2 of the paper")
    sensitivity_from: tuple[float, ...] = setting(
        (0.01, 0.05, 0.25), "-", "largest d ln f / d ln theta from which the sensitivity metric is 1, 2, 3",
        "Table 2 of the paper")
    silent: float = setting(
        0.3, "std", "a prior standard deviation that moves the data by less changes nothing that matters")
    compensates: float = setting(
        0.3, "-", "posterior correlation, with less in the prior, from which parameters compensate one another")
    map_tolerance: float = setting(1e-7, "prior std", "the climb to the maximum ends at smaller steps")
    same_height: float = setting(1e-3, "ln p", "maxima closer in height are distinguished by their parameters only")
    negligible: float = setting(
        12.0, "ln p", "further maxima count if their Laplace evidence is within this of the largest")
    suspicious: float = setting(
        0.01, "-", "p-value of the predictive check below which the prior did not expect the data")
    bent: float = setting(2.0, "std", "misfit of the linearisation beyond which p-values are rough")
    search: int = setting(10, "modes", "modes beyond their number that are searched for the measured ones")
    paper_cov_first: float = setting(
        0.015, "-", "CoV of the first bending frequencies with weights 'paper'", "paper, Sec. 4")
    paper_cov_second: float = setting(0.017, "-", "CoV of the second ones", "paper, Sec. 4")
    shape_factor: float = setting(
        10.0, "-", "CoV of the largest shape component over that of its frequency", "paper, Sec. 4")
    least_shape_std: float = setting(
        0.02, "-", "least standard deviation of a shape component, a share of the largest",
        "reference components have zero")
    least_frequency_cov: float = setting(
        5e-4, "-", "least relative standard deviation of frequencies beside a covariance",
        "a few times what a mesh leaves")
    form_frequency_cov: float = setting(
        1e-3, "-", "the same of frequencies where tolerances are stated",
        "two independent programs: 0.13 % of the first pair")
    form_shape_std: float = setting(
        2.5e-3, "-", "the same of shapes where tolerances are stated", "two independent programs: 0.1 to 0.6 %")
    reduce_from: int = setting(200, "dof", "smaller models are not reduced before sampling")
    frequency_tolerance: float = setting(
        1e-5, "-", "relative frequency error of a reduced basis where the posterior lies")
    box_std: float = setting(4.0, "prior std", "half-width of the box about it")
    box_tolerance: float = setting(1e-3, "-", "relative frequency error allowed in that box")
    settling_mac: float = setting(
        0.80, "-", "an update that does not settle is put down to the data where a MAC stays lower")
    linear_share: float = setting(0.5, "-", "effective share below which linearised sets do not stand for the model")
    hyper_prior_bits: float = setting(0.1, "bit", "information about the scatter below which it is the hyper-prior's")
    recommended_share: float = setting(
        0.2, "-", "effective share in the worst set from which the population is recommended")
    update_tolerance: float = setting(
        1e-6, "prior std", "an iteration of Eq. 7 is the last when no parameter moves by more")
    rounding: float = setting(1e-9, "-", "relative noise of the objective of Eq. 6", "eigenvalues to 1e-12")
    at_bound: float = setting(1e-6, "prior std", "a parameter this close to a bound is pinned there")
    relax_below: float = setting(
        0.1, "prior std", "smaller steps are relaxed where they go to and fro", "Irons & Tuck 1969")
    least_share: float = setting(0.2, "-", "to no less than this share")
    blind_resolution: float = setting(0.1, "-", "resolution below which the data hardly inform a parameter")
    sharp: float = setting(
        0.005, "-", "CoV of frequencies below which a good fit says nothing of the model's own error",
        "studies/calibration")
    blunt: float = setting(
        0.05, "-", "CoV of frequencies from which a good fit is no test of the model", "a tenth of every stiffness")
    common_factor: float = setting(
        0.03, "-", "scatter of ln f at the maximum over measured below which all are off by one factor")
    accused: float = setting(3.0, "std", "excess of chi-square beyond which a misfit is not chance")
    far: float = setting(0.05, "-", "a frequency that the model misses by this share is named whatever is stated")


CONSTANTS = UpdatingConstants()
