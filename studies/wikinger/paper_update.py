"""The paper's tables beside ours that need no campaign: states, parameters, the update of Table 3's frequencies, and
how far the paper's own update lies from its own prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from probupdate import verbs
from probupdate.modal.labels import mode_character
from probupdate.modal.modes import ModalData, ModalSet, Sensor
from probupdate.reporting import paper_tables as paper
from probupdate.structure.description_file import read_description
from probupdate.structure.load import load_model, reference_model
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.information import METRIC_WORDS, Information, recommendation
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.predictive import PredictiveCheck, predictive_check
from probupdate.updating.problem import Weights, build_problem
from probupdate.updating.tikhonov import update
from probupdate.updating.update_file import UpdateRecord

STATES = {"design": "design", "as-built": "as_built", "updated": "updated"}
COV = tuple(paper.FREQUENCY_COV[name] for name in paper.MODES)
ON_FREQUENCIES = Weights(frequency_cov=COV, shape_std=False, shapes="none")


@dataclass(frozen=True, eq=False)
class State:
    """frequency_hz (4,), shape (n_channel, 4) of FA1, SS1, FA2, SS2; pile_head: name -> N/m."""

    frequency_hz: np.ndarray
    shape: np.ndarray
    pile_head: dict[str, float]


def state(name: str, theta: np.ndarray | None = None) -> State:
    """The reference turbine in one of its states, or that file at other parameters."""
    path = reference_model(STATES[name])
    model, description = load_model(path), read_description(path)
    theta = model.parameters.initial if theta is None else theta
    solution = model.solve(theta, 10)
    sensors = tuple(Sensor(channel=s.channel, level=s.level, position_m=s.position_m, direction=s.direction)
                    for s in description.sensor)
    labels = mode_character(solution.shape, sensors).labels
    order = [labels.index(m) for m in paper.MODES]
    heads = {key: float(compute(theta)) for key, compute in model.derived.items()}
    return State(solution.frequency_hz[order], solution.shape[:, order], heads)


def table_3_as_modes() -> ModalData:
    """Table 3's measured frequencies; shapes, which the paper does not print, of the updated state: they pair modes."""
    model, shape = load_model(reference_model("updated")), state("updated").shape
    frequency = np.array(paper.FREQUENCY_HZ["measured"])
    # printed as 0.32 both: in the model's order, half a printed digit apart
    frequency = frequency + np.array([-0.001, 0.001, 0.0, 0.0])
    measured = ModalSet(
        id="Table 3", frequency_hz=frequency, shape=shape / np.max(np.abs(shape), axis=0),
        damping_ratio=np.full(4, np.nan), frequency_std_hz=np.array(COV) * frequency,
        shape_std=np.full(shape.shape, np.nan),
    )
    return ModalData(channels=model.channels, sets=(measured,), labels=paper.MODES)


def printed_iterations(number: int) -> np.ndarray:
    """The parameters after each of the first iterations of Eq. 7 as printed, (number + 1, 10)."""
    problem = build_problem(load_model(reference_model("as_built")), table_3_as_modes(), weights=ON_FREQUENCIES)
    return update(problem, penalty="step", max_iteration=number).theta


def update_of_table_3() -> UpdateRecord:
    """Both readings of Eq. 7 and the MAP, from the as-built model, on frequencies alone."""
    return verbs.update("as_built", table_3_as_modes(),
                        likelihood=LikelihoodSettings(weights="paper", shapes="none"))


def table_2() -> Information:
    """All 17 rows at the design state, with the paper's weights."""
    return verbs.inform("design", table_3_as_modes(), likelihood=LikelihoodSettings(weights="paper"), every=True)


def predictive_of_table_3() -> PredictiveCheck:
    """Whether the as-built model with its prior expects Table 3's frequencies."""
    problem = build_problem(load_model(reference_model("as_built")), table_3_as_modes(), weights=ON_FREQUENCIES)
    return predictive_check(problem, maximum_a_posteriori(problem, [problem.parameters.initial]))


@dataclass(frozen=True)
class Suspicion:
    """z of every parameter of Table 5 under the prior of Table 2: normal, lognormal, and the standard normal scores of
    normal priors cut at zero, which a positive parameter's is, and at this package's bounds; sums of squares and their
    p-values as chi-square of ten."""

    names: tuple[str, ...]
    normal: tuple[float, ...]
    lognormal: tuple[float, ...]
    cut_at_zero: tuple[float, ...]
    cut_at_bounds: tuple[float, ...]

    @property
    def sums(self) -> tuple[float, ...]:
        return tuple(float(np.sum(np.square(z))) for z in
                     (self.normal, self.lognormal, self.cut_at_zero, self.cut_at_bounds))

    @property
    def p_values(self) -> tuple[float, ...]:
        return tuple(float(stats.chi2.sf(total, len(self.names))) for total in self.sums)


def suspicion(use_ratio: bool = False) -> Suspicion:
    """The paper's update against its own prior. use_ratio: k_TP by its printed ratio 0.36 and not its value 0.341."""
    names, normal, lognormal, zero, bounds = [], [], [], [], []
    known = {p.name: p for p in load_model(reference_model("as_built")).parameters}
    for name, (_, _, initial, updated, ratio) in paper.UPDATED.items():
        cov = paper.SENSITIVITY[name][1]
        relative = ratio if use_ratio else updated / initial
        names.append(name)
        normal.append((relative - 1) / cov)
        log_std = np.sqrt(np.log(0.5 + np.sqrt(0.25 + cov**2)))
        lognormal.append(np.log(relative) / log_std)
        low, high = (known[name].lower / known[name].initial, known[name].upper / known[name].initial)
        for scores, (a, b) in ((zero, (0.0, np.inf)), (bounds, (low, high))):
            prior = stats.truncnorm((a - 1) / cov, (b - 1) / cov, loc=1.0, scale=cov)
            scores.append(stats.norm.ppf(prior.cdf(relative)))
    return Suspicion(tuple(names), *(tuple(map(float, z)) for z in (normal, lognormal, zero, bounds)))


# Tables as markdown ---------------------------------------------------------------------------------------------------


def rows(head: list[str], body: list[list[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in body)])


def text_of_table_2(found: Information) -> str:
    body = []
    for r in found.rows:
        uncertainty, cov, sensitivity = paper.SENSITIVITY[r.name]
        remark = []
        if r.uncertainty >= 0 and r.uncertainty != uncertainty:
            remark.append(f"uncertainty: ours {METRIC_WORDS[r.uncertainty]}")
        if r.sensitivity != sensitivity:
            remark.append(f"sensitivity: ours {METRIC_WORDS[r.sensitivity]}")
        body.append([r.name, f"{r.cov:.3g}", str(r.uncertainty), str(uncertainty), "" if cov is None else f"{cov:g}",
                     f"{r.slope:.3f} ({r.slope_mode})", str(r.sensitivity), str(sensitivity), f"{r.signal:.2f}",
                     f"{r.contraction:.2f}", r.role, "; ".join(remark)])
    head = ["parameter", "CoV", "u", "paper u", "paper CoV", "largest slope", "s", "paper s", "signal", "width", "role",
            "remark"]
    other = sum(1 for r in found.rows if r.sensitivity != paper.SENSITIVITY[r.name][2])
    return rows(head, body) + (
        f"\n\nu, s: metrics 0 to 3, {found.settings['uncertainty metric']}; {found.settings['sensitivity metric']}. "
        f"{other} of {len(found.rows)} sensitivities differ from the paper's, and no thresholds make them the same: "
        "the paper has m_h high and the jacket low where their slopes are about equal. Recommended by information: "
        + "; ".join(recommendation(found)) + ".")


def text_of_suspicion() -> str:
    found, ratio = suspicion(), suspicion(use_ratio=True)
    columns = (found.normal, found.lognormal, found.cut_at_zero, found.cut_at_bounds)
    body = [[n, *(f"{z:+.2f}" for z in zs)] for n, *zs in zip(found.names, *columns, strict=True)]
    for words, one in (("sum of squares", found), ("with k_TP by its ratio 0.36", ratio)):
        body.append([words, *(f"{s:.1f} (p = {p:.2g})" for s, p in zip(one.sums, one.p_values, strict=True))])
    return rows(["Table 5 under Table 2", "z, normal prior", "z, lognormal prior", "score, normal cut at zero",
                 "score, normal cut at our bounds"], body)


def text_of_eq_7(record: UpdateRecord) -> str:
    """Iteration by iteration: where the printed scheme stands, and how far from Table 5."""
    printed = record.scheme("step")
    names = record.parameters.names
    table_5 = np.array([paper.UPDATED[n][3] for n in names])
    std = record.parameters.std
    body = []
    model = load_model(reference_model("as_built"))
    for k, theta in enumerate(printed.theta[:13]):
        f = model.solve(theta, 5).frequency_hz[[0, 1, 3, 4]]
        error = np.max(np.abs(f / record.measured_hz - 1))
        z = (theta - record.parameters.initial) / std
        apart = np.sqrt(np.mean(((theta - table_5) / std) ** 2))
        at = dict(zip(names, theta, strict=True))
        body.append([str(k), f"{100 * error:.2f}", f"{z @ z:.1f}", f"{printed.distance_to_map[k]:.2f}",
                     *(f"{at[n]:.3g}" for n in ("k_t", "k_TP", "py", "tz", "qw")), f"{apart:.2f}"])
    head = ["iteration", "largest frequency error, %", "sum z²", "to the MAP, posterior dev.", "k_t", "k_TP", "py",
            "tz", "qw", "to Table 5, prior dev. (rms)"]
    return rows(head, body)
