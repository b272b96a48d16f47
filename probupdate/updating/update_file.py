"""update.json: both readings of the deterministic update, the posterior's maximum beside them, every set's update."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError, parsing
from probupdate.io.files import read_json_table, write_json
from probupdate.io.json_rows import from_table
from probupdate.io.result_table import OWN_UNIT, table_of
from probupdate.io.schema import BoolArray
from probupdate.modal.frequency_pairs import common_factor_words
from probupdate.model.parameters import Parameters
from probupdate.updating import components
from probupdate.updating.baseline import LearntError
from probupdate.updating.identifiability import gaussian_width, identifiability
from probupdate.updating.settings import CONSTANTS

if TYPE_CHECKING:
    import pandas as pd

FORMAT = 1
BLIND_RESOLUTION = CONSTANTS.blind_resolution
SHARP, BLUNT, COMMON_FACTOR = CONSTANTS.sharp, CONSTANTS.blunt, CONSTANTS.common_factor
ACCUSED, FAR = CONSTANTS.accused, CONSTANTS.far
SCHEME_NAMES = {"step": "sensitivity-based update, penalty on the step (Eq. 7 as the paper prints it)",
                "prior": "sensitivity-based update, penalty on the distance from the prior (anchored)"}


# the setting that names measured modes which were taken though they look unlike the model's
UNLIKE = "modes unlike the model's"
# the one that says which sets the numbers are of, and which are left out
SETS = "sets"
# that frequencies step between them
STEP = "step between the sets"
# and what to do then
STATES_ADVICE = ("`probupdate diagnose` of all sets looks for what changed; `probupdate select MODES --before TIME "
                 "--out before.json`, or `--since TIME`, keeps the sets of one state")
# what of earlier states is used, and how much of the model's error all states resolve
BASELINE = "baseline"


@dataclass(frozen=True, eq=False, kw_only=True)
class SchemeRecord:
    """One reading of Eq. 7: theta (n_iteration + 1, n_param); objective: term -> (n_iteration + 1,);
    distance_to_map (n_iteration + 1,), the Mahalanobis distance over sqrt(n_param) in the Laplace posterior;
    frequency_hz, mac (n_mode,) at the end in the data's order, NaN where a mode is not used."""

    key: str
    name: str
    theta: np.ndarray
    objective: Mapping[str, np.ndarray]
    distance_to_map: np.ndarray
    share: np.ndarray
    frequency_hz: np.ndarray
    mac: np.ndarray
    at_bound: BoolArray
    converged: bool
    status: str
    alpha: float

    @property
    def closest_iteration(self) -> int:
        """Where the scheme passes closest to the maximum of the posterior."""
        return int(np.argmin(self.distance_to_map))


@dataclass(frozen=True, eq=False, kw_only=True)
class ScatterRecord:
    """Updates of all sets; see nine_sets.SetScatter."""

    ids: tuple[str, ...]
    theta_map: np.ndarray
    theta_step: np.ndarray
    iterations: int
    variance: np.ndarray
    resolution: np.ndarray
    derived: Mapping[str, np.ndarray]
    failed: tuple[str, ...]
    cov: np.ndarray
    total_std: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class AlphaRecord:
    """The anchored update over alpha; see alpha.AlphaPath."""

    alpha: np.ndarray
    theta: np.ndarray
    misfit: np.ndarray
    penalty: np.ndarray
    log_evidence: np.ndarray
    chosen: Mapping[str, float]
    remarks: Mapping[str, str]


@dataclass(frozen=True, eq=False, kw_only=True)
class ComponentsRecord:
    """What the variance of the parameters' estimate is made of, std (n_component, n_param), and what to measure next,
    gain (n_measure, n_param); misfit_share (n_group,): of the misfit at the maximum by group of responses. See
    components.VarianceComponents."""

    names: tuple[str, ...]
    std: np.ndarray
    source_names: tuple[str, ...]
    source_std: np.ndarray
    measures: tuple[str, ...]
    gain: np.ndarray
    responses: tuple[str, ...]
    chi_square: np.ndarray
    expected: np.ndarray

    def outlying_responses(self) -> tuple[str, ...]:
        """Responses whose chi-square is far beyond what is expected of them, the worst first."""
        beyond = (self.chi_square - self.expected) / np.sqrt(2 * np.maximum(self.expected, 1.0))
        return tuple(self.responses[k] for k in np.argsort(-beyond) if beyond[k] > ACCUSED)


@dataclass(frozen=True, eq=False, kw_only=True)
class UpdateRecord:
    """What update.json holds; mode arrays (n_mode,) are in the data's order with NaN for modes not used.

    computed_mode: number of the model's mode at the initial parameters, from 1, 0 for none. n_effective: responses less
    fitted scales, the chi-square a true model would have. suspected: channels whose exchange or sign would explain why
    the shapes are not the model's, empty where none would. derived: quantity -> {"initial", "step", "prior", "map"}.
    map_gradient: the largest that the bounds leave at the maximum, per posterior standard deviation. identified_std_hz:
    measured_std_hz without what the model itself may miss. model_error: what these data, and baselines, say of it.
    """

    model: str
    fingerprint: str
    parameters: Parameters
    set_id: str
    labels: tuple[str, ...]
    measured_hz: np.ndarray
    measured_std_hz: np.ndarray
    initial_hz: np.ndarray
    initial_mac: np.ndarray
    initial_misfit: float
    computed_mode: np.ndarray
    schemes: tuple[SchemeRecord, ...]
    pairs: tuple[tuple[int, ...], ...]
    left_out: tuple[str, ...]
    map_theta: np.ndarray
    map_covariance: np.ndarray
    map_resolution: np.ndarray
    map_at_bound: BoolArray
    map_misfit: float
    map_hz: np.ndarray
    map_mac: np.ndarray
    n_response: int
    n_effective: int
    other_maxima: tuple[float, ...]
    derived: Mapping[str, Mapping[str, float]]
    sets: ScatterRecord | None
    settings: Mapping[str, str] = field(default_factory=dict)
    map_gradient: float = float("nan")
    alpha_path: AlphaRecord | None = None
    components: ComponentsRecord | None = None
    suspected: str = ""
    identified_std_hz: np.ndarray | None = None
    model_error: LearntError | None = None

    def scheme(self, key: str) -> SchemeRecord:
        return next(s for s in self.schemes if s.key == key)

    def to_frame(self) -> pd.DataFrame:
        """A row a parameter, in its `unit`: initial value and prior, the ends of both readings of Eq. 7, the maximum of
        the posterior with its Laplace standard deviation."""
        ends = {s.key: s.theta[-1] for s in self.schemes}
        std = np.sqrt(np.diag(self.map_covariance))
        return table_of([
            {"name": p.name, "unit": p.unit, "initial": p.initial, "prior_std": p.std,
             **{key: theta[k] for key, theta in ends.items()}, "map": self.map_theta[k], "map_std": std[k],
             "resolution": self.map_resolution[k], "at_bound": bool(self.map_at_bound[k])}
            for k, p in enumerate(self.parameters)
        ], units=dict.fromkeys(("initial", "prior_std", *ends, "map", "map_std"), OWN_UNIT))

    @property
    def summary(self) -> str:
        return summary(self)

    def write(self, path: str | Path) -> Path:
        return write_update(self, path)


def summary(record: UpdateRecord) -> str:
    """A dozen lines for a terminal."""
    lines = []
    if misses(record):
        lines.append("MISFIT BEYOND CHANCE: the model at its best does not explain these modes, and its parameters are "
                     "not to be trusted")
    elif is_uninformative(record):
        lines.append("NOT TESTED: standard deviations this wide let any model fit, and its parameters are not to be "
                     "trusted")
    if STEP in record.settings:
        lines.append(f"TWO STATES: {record.settings[STEP]}. {STATES_ADVICE}")
    if record.suspected:
        lines.append(f"SUSPECT: the measured shapes are not this model's, and {record.suspected}")
    lines += [record.settings[key] for key in (SETS, BASELINE) if key in record.settings]
    lines += [f"{key}: {record.settings[key]}" for key in ("gravity", "held") if key in record.settings]
    for key in ("step", "prior"):
        s = record.scheme(key)
        ended = f"{len(s.theta) - 1} iterations"
        misfit = f"responses' misfit {s.objective['responses'][0]:.4g} -> {s.objective['responses'][-1]:.4g}"
        closest = f"closest to the MAP at iteration {s.closest_iteration}"
        lines.append(f"{s.name}: {ended}, converged, {misfit}; {closest}" if s.converged else
                     f"{s.name}: did NOT converge in {ended}, so that it gives no estimate; {closest}")
    used = np.isfinite(record.initial_hz)
    error = np.nanmax(np.abs(record.initial_hz[used] / record.measured_hz[used] - 1))
    after = np.nanmax(np.abs(record.map_hz[used] / record.measured_hz[used] - 1))
    lines.append(f"worst frequency error of {int(used.sum())} modes: {100 * error:.1f} % before, "
                 f"{100 * after:.1f} % at the MAP")
    lines += _parameter_lines(record)
    if np.isfinite(record.map_gradient):
        lines.append(f"projected gradient of ln p at the MAP: {record.map_gradient:.1e} per posterior standard "
                     "deviation")
    lines.append(fit_sentence(record))
    lines += _next_measurements(record)
    lines += _alphas(record)
    for name, values in record.derived.items():
        lines.append(f"{name}: {values['initial']:.3g} -> {values['map']:.3g} N/m at the MAP")
    if UNLIKE in record.settings:
        lines.append(f"taken although unlike the model's: {record.settings[UNLIKE]}")
    lines += [f"left out: {text}" for text in record.left_out]
    if record.other_maxima:
        nearest = record.other_maxima[0]
        found = "1 other maximum" if len(record.other_maxima) == 1 else f"{len(record.other_maxima)} other maxima"
        how = ("as probable as the best: other parameters explain the data as well" if nearest < 0.05 else
               f"{nearest:.2f} lower in ln p than the best")
        lines.append(f"the search also ended at {found} of the posterior, the nearest {how}")
    if record.sets is not None:
        lines += [f"no update: {text}" for text in record.sets.failed]
    return "\n".join(lines)


def _parameter_lines(record: UpdateRecord) -> list[str]:
    """A table with a row a parameter at the MAP, by the Gaussian approximation there, and what its columns are.

    For independent Gaussian parameters width^2 = 1 - resolution. Where it is more, another parameter can do the same.
    """
    std, width = np.sqrt(np.diag(record.map_covariance)), gaussian_width(record.map_covariance, record.parameters)
    kinds, sources = gaussian_kinds(record), _variance_sources(record)
    over_sets = None if record.sets is None else np.std(record.sets.theta_map, axis=0, ddof=1)
    rows = [("", "before", "at the MAP", "+-", "prior +-", "width", "R", "sets +-")]
    rows += [(p.name if p.unit in ("", "-") else f"{p.name} [{p.unit}]", f"{p.initial:.4g}",
              f"{record.map_theta[k]:.4g}", f"{std[k]:.2g}", f"{p.std:.2g}", f"{width[k]:.2f}",
              f"{record.map_resolution[k]:.2f}", "" if over_sets is None else f"{over_sets[k]:.2g}")
             for k, p in enumerate(record.parameters)]
    last = len(rows[0]) - (over_sets is None)
    wide = [max(len(row[k]) for row in rows) for k in range(last)]
    behind = ["identifiability" + ("" if record.components is None else "; variance from"),
              *(f"{kinds[p.name]}{sources[k]}" for k, p in enumerate(record.parameters))]
    lines = [f"{row[0]:<{wide[0]}}  {'  '.join(f'{row[k]:>{wide[k]}}' for k in range(1, last))}  {text}"
             for row, text in zip(rows, behind, strict=True)]
    words = ("+-: one standard deviation, by the Gaussian approximation at the MAP; width: that over the prior's; R: "
             "share of the MAP that the data determine (resolution)")
    if over_sets is not None:
        words += f"; sets: over {len(record.sets.ids)} sets, each updated by itself"
    return [*lines, words]


def gaussian_kinds(record: UpdateRecord) -> dict[str, str]:
    """Parameter -> what the data say of it by the Gaussian approximation at the MAP."""
    width = gaussian_width(record.map_covariance, record.parameters)
    return {p.name: identifiability(w, at_bound=bool(b), unproven=is_unproven(record), description=p.description)
            for p, w, b in zip(record.parameters, width, record.map_at_bound, strict=True)}


def _alphas(record: UpdateRecord) -> list[str]:
    path = record.alpha_path
    if path is None:
        return []
    found = [f"{rule} {value:.2g}" for rule, value in path.chosen.items() if np.isfinite(value)]
    lines = [f"alpha by rule: {', '.join(found)}"] if found else []
    return lines + [f"no alpha by {rule}: {remark}" for rule, remark in path.remarks.items()]


def misses(record: UpdateRecord) -> bool:
    """Whether the misfit at the maximum is beyond what the stated covariance allows by chance."""
    return record.map_misfit > beyond_chance(record.n_effective)


def is_uninformative(record: UpdateRecord) -> bool:
    """Whether the standard deviations that were stated, or estimated from the misfit, are so wide that a fit within
    them says nothing."""
    return _usual_cov(record) >= BLUNT


def is_unproven(record: UpdateRecord) -> bool:
    """Whether the fit at the maximum says nothing for the parameters."""
    return misses(record) or is_uninformative(record)


def _usual_cov(record: UpdateRecord) -> float:
    return float(np.nanmedian(record.measured_std_hz / record.measured_hz))


def _common_factor_words(record: UpdateRecord) -> str:
    """What to say where the model at its best has all frequencies off by one factor."""
    words = common_factor_words(np.log(record.map_hz / record.measured_hz), COMMON_FACTOR)
    return f"; {words}" if words else ""


def beyond_chance(n_effective: int) -> float:
    """The chi-square from which a misfit is none of chance."""
    return n_effective + ACCUSED * np.sqrt(2 * n_effective)


def stated_error_words(record: UpdateRecord) -> tuple[str, ...]:
    """What is stated of the model's own error and of its sensors', by the components of the estimates' variance."""
    parts = record.components
    if parts is None:
        return ()
    return tuple(name for name, std in zip(parts.names, parts.std, strict=True)
                 if name not in (components.IDENTIFICATION, components.PRIOR) and np.any(std > 0))


def fit_sentence(record: UpdateRecord, *, diagnosed: bool = False) -> str:
    """Whether the model at its best fits the data within the stated standard deviations. diagnosed: a misfit is what
    the findings of a diagnosis explain, and that this model lacks."""
    stated = ", ".join(stated_error_words(record))
    ratio = record.map_misfit / record.n_effective
    text = f"chi-square at the MAP {record.map_misfit:.4g} for {record.n_effective} effective responses"
    cov = _usual_cov(record)
    if not misses(record) and is_uninformative(record):
        whose = f" with what is stated of the model ({stated})" if stated else ""
        return (f"{text}: no test of the model, as standard deviations of {100 * cov:.2g} % of the frequencies (median)"
                f"{whose} fit any model; no parameter counts as strongly identified until what is wrong with model or "
                f"data is found, or smaller ones are stated{_common_factor_words(record)}")
    if misses(record):
        accused = () if record.components is None else record.components.outlying_responses()
        where = f", most of all {', '.join(accused[:3])}" if accused else ""
        remedy = ("until the model's error is stated: --discrepancy auto (the default) or a share, or compare shapes "
                  "with --shapes mac" if not stated else f"as the stated error ({stated}) does not explain it: find "
                  "what the model lacks (probupdate diagnose), or state a larger --discrepancy")
        remedy = "as the model lacks what the diagnosis found" if diagnosed else (
            f"{remedy}{_common_factor_words(record)}")
        return (f"{text}: the model misses the data by {np.sqrt(ratio):.1f} times the stated standard deviations"
                f"{where}; no parameter counts as strongly identified {remedy}")
    apart = conspicuous_frequencies(record)
    # many components of shapes that fit hide no frequency that does not
    if not apart and record.map_misfit < record.n_effective - ACCUSED * np.sqrt(2 * record.n_effective):
        closer = (f"{text}: the fit is {1 / np.sqrt(max(ratio, 1e-12)):.1f} times closer than the stated standard "
                  "deviations expect")
        if stated:
            return (f"{closer}, as this structure uses up little of what is stated of the model's error ({stated}); "
                    "posterior widths hold all of it")
        return (f"{closer}; they are too wide for these data or their errors go together, and posterior widths "
                "are too wide with them")
    if record.suspected:
        # a mistaken channel that parameters took in leaves no misfit
        return f"{text}: within the stated standard deviations, which is no proof while the shapes are suspect"
    if apart:
        return (f"{text}: no more than chance with what is stated and learnt of the model's own error"
                f"{f' ({stated})' if stated else ''}, without which {apart}; posterior widths hold that error"
                f"{'' if diagnosed else '; whether a sensor or a change makes it, `probupdate diagnose` tells'}")
    text = (f"{text}: the model fits the data within the stated standard deviations, {100 * cov:.2g} % of the "
            "frequencies (median)")
    if stated:
        return f"{text}; posterior widths include the stated error of the model ({stated})"
    if cov >= SHARP:
        return text
    return (f"{text}; an error of the model itself that parameters took in does not show in the fit, and posterior "
            "widths leave it out unless it is stated (--discrepancy and a share)")


def conspicuous_frequencies(record: UpdateRecord) -> str:
    """The frequencies that the model misses by more than their measurement's own standard deviations or a share of
    themselves allow, and shapes and frequencies whose chi-square stands out; empty where none does."""
    found = []
    gap = np.abs(record.map_hz - record.measured_hz)
    own = record.measured_std_hz if record.identified_std_hz is None else record.identified_std_hz
    for label, g, f, std in zip(record.labels, gap, record.measured_hz, own, strict=True):
        if np.isfinite(g) and (g > ACCUSED * std or g > FAR * f):
            by = f", {g / std:.1f} of its measurement's standard deviations" if std > 0 else ""
            found.append((g / f, f"{label} is {100 * g / f:.2g} % off{by}"))
    listed = [text for _, text in sorted(found, reverse=True)[:3]]
    accused = () if record.components is None else record.components.outlying_responses()
    return "; ".join([*listed, *(f"the misfit of the {name} exceeds what is stated" for name in accused[:2]
                                 if not any(name.endswith(f" {text.split(' is ')[0]}") for text in listed))])


def _variance_sources(record: UpdateRecord) -> list[str]:
    """Per parameter which parts its variance comes from, the largest first, none below a tenth."""
    parts = record.components
    if parts is None:
        return [""] * len(record.parameters)
    share = parts.std**2 / np.sum(parts.std**2, axis=0)
    named = [[f"{parts.names[j]} {100 * share[j, k]:.0f} %" for j in np.argsort(-share[:, k])[:3] if share[j, k] >= 0.1]
             for k in range(len(record.parameters))]
    return [f"; {', '.join(names)}" for names in named]


def _next_measurements(record: UpdateRecord) -> list[str]:
    parts, lines = record.components, []
    if parts is None:
        return []
    for what, gain in list(zip(parts.measures, parts.gain, strict=True))[:3]:
        best = [k for k in np.argsort(-gain)[:3] if gain[k] >= 0.02]
        gains = ", ".join(f"{record.parameters.names[k]} -{100 * gain[k]:.0f} %" for k in best)
        lines.append(f"what to measure next: {what} (standard deviation of {gains})")
    return lines


def _plain(value):
    if isinstance(value, np.ndarray):
        if value.dtype == bool:
            return value.tolist()
        return _nulls(value.tolist())
    if isinstance(value, Mapping):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return _nulls(value.item())
    return _nulls(value)


def _nulls(value):
    if isinstance(value, list):
        return [_nulls(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def parameters_to_table(parameters: Parameters) -> dict:
    """JSON form; infinite bounds become null."""
    items = [_plain(asdict(p)) for p in parameters]
    correlation = None if parameters.correlation is None else parameters.correlation.tolist()
    return {"items": items, "correlation": correlation, "held": [list(pair) for pair in parameters.held]}


def write_update(record: UpdateRecord, path: str | Path) -> Path:
    path = Path(path)
    content: dict[str, object] = {"format": FORMAT}
    for name in record.__dataclass_fields__:
        value = getattr(record, name)
        if name == "parameters":
            content[name] = parameters_to_table(value)
        elif name == "schemes":
            content[name] = [{k: _plain(getattr(s, k)) for k in s.__dataclass_fields__} for s in value]
        elif name in ("sets", "alpha_path", "components"):
            names = () if value is None else value.__dataclass_fields__
            content[name] = {k: _plain(getattr(value, k)) for k in names} or None
        elif name == "model_error":
            content[name] = None if value is None else value.to_table()
        else:
            content[name] = _plain(value)
    return write_json(path, content)


def read_update(path: str | Path) -> UpdateRecord:
    """Read update.json; raises InputError where it is none, or its parts do not fit together."""
    again = "write it again with `probupdate update`"
    content = read_json_table(path, again, absent="write it with `probupdate update`")
    with parsing(f"{path}, model_error", "is not what the model may miss", again):
        if (error := content.get("model_error")) is not None:
            content["model_error"] = LearntError.from_table(error)
    record = from_table(UpdateRecord, content, path, again, name="update.json", file_format=FORMAT)
    if (parts := record.components) is not None:
        # of no rows JSON has no columns
        empty = {k: getattr(parts, k).reshape(0, len(record.parameters)) for k in ("source_std", "gain")
                 if not getattr(parts, k).size}
        record = replace(record, components=replace(parts, **empty))
    for what, found, wanted in _sizes(record):
        if found != wanted:
            raise InputError(f"{path}, {what}", f"is {found}, the rest of the file says {wanted}",
                             "write it again with `probupdate update`")
    if record.n_effective < 1 or not record.map_misfit >= 0 or np.any(np.diag(record.map_covariance) < 0):
        raise InputError(str(path), "has a negative misfit or variance, or no responses", again)
    used = np.isfinite(record.initial_hz)
    if not used.any() or not np.all(record.measured_hz[used] > 0) or np.any(record.measured_std_hz < 0):
        raise InputError(f"{path}, measured_hz", "holds no measured mode, or one without a positive frequency", again)
    if record.components is not None and not np.all(np.sum(record.components.std**2, axis=0) > 0):
        raise InputError(f"{path}, components", "hold a parameter without any variance", again)
    return record


def _sizes(record: UpdateRecord):
    """What must agree in size: (name, found, wanted)."""
    n_mode, n_param = len(record.labels), len(record.parameters)
    yield "schemes", tuple(s.key for s in record.schemes), tuple(SCHEME_NAMES)
    for name in ("measured_hz", "measured_std_hz", "initial_hz", "initial_mac", "computed_mode", "map_hz", "map_mac"):
        yield name, getattr(record, name).shape, (n_mode,)
    if record.identified_std_hz is not None:
        yield "identified_std_hz", record.identified_std_hz.shape, (n_mode,)
    for name in ("map_theta", "map_resolution", "map_at_bound"):
        yield name, getattr(record, name).shape, (n_param,)
    yield "map_covariance", record.map_covariance.shape, (n_param, n_param)
    for s in record.schemes:
        n = len(s.theta)
        yield f"{s.key}: objective", tuple(sorted(s.objective)), ("parameters", "responses", "total")
        found = {"theta": (s.theta, (n, n_param)), "at_bound": (s.at_bound, (n_param,)), "share": (s.share, (n - 1,)),
                 "distance_to_map": (s.distance_to_map, (n,)), "frequency_hz": (s.frequency_hz, (n_mode,)),
                 "mac": (s.mac, (n_mode,))} | {k: (v, (n,)) for k, v in s.objective.items()}
        for name, (array, wanted) in found.items():
            yield f"{s.key}: {name}", array.shape, wanted
    if record.alpha_path is not None:
        n = record.alpha_path.alpha.size
        yield "alpha_path: theta", record.alpha_path.theta.shape, (n, n_param)
        for name in ("misfit", "penalty", "log_evidence"):
            yield f"alpha_path: {name}", getattr(record.alpha_path, name).shape, (n,)
    if (parts := record.components) is not None:
        for name, rows in (("std", parts.names), ("source_std", parts.source_names), ("gain", parts.measures)):
            yield f"components: {name}", getattr(parts, name).shape, (len(rows), n_param)
        for name in ("chi_square", "expected"):
            yield f"components: {name}", getattr(parts, name).shape, (len(parts.responses),)
    if record.sets is not None:
        for name in ("theta_map", "theta_step", "variance", "resolution"):
            yield f"sets: {name}", getattr(record.sets, name).shape, (len(record.sets.ids), n_param)
        for name in ("cov", "total_std"):
            yield f"sets: {name}", getattr(record.sets, name).shape, (n_param,)
