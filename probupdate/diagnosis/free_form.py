"""What no row of the catalogue explains, as elementary parts: a spring to ground or between two points, a mass.

The parts are added to the model on its small basis and found by the same search as everything else, one of each
kind at the prior odds of one row of the catalogue. They say where and in which modes the unknown acts, not what it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import linalg

from probupdate.diagnosis.diagnose import Outcome, examine
from probupdate.diagnosis.evidence import sizes_std
from probupdate.diagnosis.expected import departures_at
from probupdate.diagnosis.fitting import Fit, design_at
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.problem import DiagnosisProblem
from probupdate.diagnosis.small_model import Attachment, SmallModel
from probupdate.effects.catalogue import Effect
from probupdate.errors import ConvergenceError
from probupdate.modal.modes import ModalData
from probupdate.model.interface import Wireframe
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.description import Description
from probupdate.structure.places import place_of

# points of the structure where a part may sit, and horizontal directions of a spring
N_POINT, N_DIRECTION = 48, 4
# prior standard deviation of a spring over the static stiffness of its points, of a mass over the least modal mass
# there; its upper bound in these
SHARE, MOST = 0.1, 100.0
# parts of each kind that the search is given: those that score highest beside the model as it is; scored so many at
# once
N_KEPT, CHUNK = 40, 160
# parts at once
MOST_PARTS = 2
# points nearer to one another than this share of the structure's extent are one
SAME_PLACE = 0.012
# wire groups that are no place to attach anything: soil is the catalogue's, the rotor turns
NOT_THERE = ("pile", "rna")
# a mode is acted on where its ln f moves by so many standard deviations of a block's
ACTS = 1.0
PART_CAUSES = ("spring to ground", "spring between two points", "added mass at a point")


@dataclass(frozen=True, eq=False, kw_only=True)
class FreeForm:
    """The model with elementary parts, fitted: `outcome` of the search with them, `prepared` with them, `content` plain
    numbers for diagnosis.json."""

    prepared: Prepared
    outcome: Outcome
    content: dict


def points(wire: Wireframe, most: int = N_POINT) -> np.ndarray:
    """Numbers of the nodes (n,) where parts may sit: where members meet or end, then those farthest from all others."""
    def joined(barred: bool) -> set[int]:
        return {int(k) for line, group in zip(wire.line, wire.line_group, strict=True)
                if (group in NOT_THERE) == barred for k in line}

    barred = joined(True)
    used = np.array(sorted(joined(False))) if len(wire.line) else np.arange(len(wire.node_m))
    extent = float(np.max(np.ptp(wire.node_m[used], axis=0)))
    clusters: list[list[int]] = []
    for k in used:
        near = [c for c in clusters if np.linalg.norm(wire.node_m[c[0]] - wire.node_m[k]) < SAME_PLACE * extent]
        near[0].append(int(k)) if near else clusters.append([int(k)])
    member = {k: number for number, c in enumerate(clusters) for k in c}
    ends = np.zeros(len(clusters), int)
    for line in wire.line:
        a, b = (member.get(int(k)) for k in line)
        # a line within a cluster is an eccentricity or a joint
        for one in {a, b} if a != b else ():
            if one is not None:
                ends[one] += 1
    chief = np.array([next((k for k in c if k not in barred), c[0]) for c in clusters])
    place = wire.node_m[chief]
    chosen = [int(i) for i in np.flatnonzero((ends >= 3) | (ends == 1))]
    chosen = chosen or [int(np.argmax(place[:, 2]))]
    away = np.min(np.linalg.norm(place[:, None] - place[chosen][None], axis=2), axis=1)
    if len(chosen) > most:
        chosen = farthest(place, chosen, most)
    while len(chosen) < min(most, len(clusters)):
        new = int(np.argmax(away))
        if away[new] < 2 * SAME_PLACE * extent:
            break
        chosen.append(new)
        away = np.minimum(away, np.linalg.norm(place - place[new], axis=1))
    return np.sort(chief[chosen])


def farthest(place: np.ndarray, among: Sequence[int], count: int) -> list[int]:
    """`count` of the rows `among` of place (n, 3), each the one farthest from those before it."""
    result = [max(among, key=lambda i: place[i, 2])]
    while len(result) < min(count, len(among)):
        away = np.min(np.linalg.norm(place[list(among)][:, None] - place[result][None], axis=2), axis=1)
        result.append(among[int(np.argmax(away))])
    return result


def directions(n: int = N_DIRECTION) -> list[tuple[str, np.ndarray]]:
    angle = np.arange(n) * 180.0 / n
    level = [(f"along {a:g} deg", np.array([np.cos(np.radians(a)), np.sin(np.radians(a)), 0.0])) for a in angle]
    return [*level, ("vertical", np.array([0.0, 0.0, 1.0]))]


def elementary(small: SmallModel, place: Callable[[np.ndarray], str]) -> list[tuple[Effect, Attachment]]:
    """Every part that may be added: its row and where it acts on the small basis. `place`: point (3,) -> words."""
    wire, at_nodes = small.picture
    nodes = points(wire)
    K, M = (wave[0] for wave in (small.at(small.parameters.initial).stiffness, small.at(small.parameters.initial).mass))
    _, shape = linalg.eigh(K, M, subset_by_index=(0, small.n_search - 1))
    flexibility = linalg.cho_factor(K)
    rows = {int(k): at_nodes[3 * k : 3 * k + 3] for k in nodes}
    result = []

    def spring(cause: str, words: str, b: np.ndarray) -> None:
        gives_way = float(b @ linalg.cho_solve(flexibility, b))
        # a point that the model holds, or knows no motion of that way
        if not gives_way > 0:
            return
        stiffness = 1 / gives_way
        result.append(_part(cause, words, "N/m", SHARE * stiffness, Attachment(stiffness=np.outer(b, b))))

    for k in nodes:
        there = place(wire.node_m[k])
        for words, d in directions():
            spring(PART_CAUSES[0], f"{there}, {words}", d @ rows[int(k)])
        own = rows[int(k)]
        moved = float(np.max(np.sum((own @ shape) ** 2, axis=0)))
        if not moved > 0:
            continue
        modal_mass = 1 / moved
        result.append(_part(PART_CAUSES[2], there, "kg", SHARE * modal_mass, Attachment(mass=own.T @ own)))
    lined = {frozenset(map(int, line)) for line in wire.line}
    for a, b in combinations(map(int, nodes), 2):
        way = wire.node_m[b] - wire.node_m[a]
        if frozenset((a, b)) not in lined:
            spring(PART_CAUSES[1], f"{place(wire.node_m[a])} and {place(wire.node_m[b])}",
                   way / np.linalg.norm(way) @ (rows[b] - rows[a]))
    number = Counter(effect.cause for effect, _ in result)
    return [(replace(effect, odds=1 / number[effect.cause]), attachment) for effect, attachment in result]


def _part(cause: str, location: str, unit: str, std: float, attachment: Attachment) -> tuple[Effect, Attachment]:
    name = f"{cause}: {location}"
    effect = Effect(kind="structural", cause=cause, location=location, unit=unit, tolerance=0.0, slab=std,
                    lower=0.0, upper=MOST * std, parameter=name, courses=("constant", "step"),
                    check="look there for what the model does not have")
    return effect, replace(attachment, name=name, unit=unit, std=std, lower=0.0, upper=MOST * std)


def most_telling(problem: DiagnosisProblem, fitted: Fit, rows: Sequence[tuple[Effect, Attachment]]) -> list[int]:
    """Numbers of the rows that explain most beside a fit, N_KEPT of each kind: scored by chunks, as all of them at
    once take gigabytes."""
    courses = [c for c, course in enumerate(problem.courses) if course.kind in ("constant", "step")]
    best = np.zeros(len(rows))
    for start in range(0, len(rows), CHUNK):
        part = rows[start : start + CHUNK]
        small = problem.predictor.small.attached([attachment for _, attachment in part])
        which = np.array([(j, c) for j in range(len(part)) for c in courses])
        wider = replace(problem, predictor=replace(problem.predictor, small=small), effects=tuple(e for e, _ in part),
                        which=which)
        theta = np.concatenate([fitted.theta, np.zeros(len(part))])
        design = design_at(wider, theta, (), fitted.design.noise)
        u, v = design.scores(fitted.centred), design.information
        z = np.where(design.share_left > 1e-3, u / np.sqrt(np.maximum(v, 1e-300)), 0.0)
        best[start : start + len(part)] = z.reshape(len(part), -1).max(axis=1)
    order = np.argsort(-best, kind="stable")
    return sorted(int(k) for cause in PART_CAUSES
                  for k in [k for k in order if rows[k][0].cause == cause][:N_KEPT])


def with_parts(prepared: Prepared, rows: Sequence[tuple[Effect, Attachment]]) -> Prepared:
    """The model with these parts as further effects."""
    small = prepared.small.attached([attachment for _, attachment in rows])
    return replace(prepared, small=small, effects=(*prepared.effects, *(effect for effect, _ in rows)))


def place_words(point: np.ndarray, description: Description | None) -> str:
    """Where a point is: by leg, face and bay where the structure is described, else by its coordinates."""
    included = place_of(description, point) if description is not None else ""
    return included or f"({point[0]:.1f}, {point[1]:.1f}, {point[2]:.1f}) m"


def free_form(
    prepared: Prepared, known: Outcome, data: ModalData, *, seed: int = 1, progress: Progress = silent
) -> FreeForm | None:
    """The same search with elementary parts in the catalogue; None where the model has no picture to place them in, or
    where none of them is taken in. `known`: what the catalogue made of the record."""
    if prepared.small.wire is None:
        return None
    rows = elementary(prepared.small, lambda point: place_words(point, prepared.description))
    wider = with_parts(prepared, [rows[k] for k in most_telling(known.problem, known.null, rows)])
    try:
        outcome = examine(wider, data, most=MOST_PARTS, seed=seed, progress=progress)
    except ConvergenceError:
        return None
    if not any(n.effect.cause in PART_CAUSES for n in outcome.fitted.included):
        return None
    return FreeForm(prepared=wider, outcome=outcome, content=_content(outcome))


def _content(outcome: Outcome) -> dict:
    problem, fitted = outcome.problem, outcome.fitted
    std = sizes_std(problem, fitted)
    rows = []
    for number, (n, own) in enumerate(zip(fitted.included, std, strict=True)):
        step = n.course.kind == "step"
        rows.append({
            "cause": n.effect.cause, "location": n.effect.location, "size": n.size, "size_std": own,
            "unit": n.effect.unit + n.course.unit, "course": n.course.name,
            "since": problem.blocks.ids[n.course.at] if step else "", "elementary": n.effect.cause in PART_CAUSES,
            "modes": modes_moved(outcome, number),
        })
    return {"parts": rows, "complete": outcome.diagnosis.verdict != "unexplained",
            "adequacy_p": outcome.diagnosis.adequacy_p}


def modes_moved(outcome: Outcome, number: int) -> list[dict]:
    """By how much an effect of the fit moves each group of modes (mean ln f in per cent, where it acts), the largest
    first, of those that move by more than a block scatters."""
    problem, fitted = outcome.problem, outcome.fitted
    n = fitted.included[number]
    if not n.exact:
        return []
    others = [x for k, x in enumerate(fitted.included) if k != number and x.exact]
    with_it, without = (departures_at(problem, fitted.theta, included) for included in ([*others, n], others))
    acting = np.flatnonzero(n.course.value > 0.5)
    rows = []
    for q, (a, b) in enumerate(zip(with_it, without, strict=True)):
        k = len(problem.blocks.groups[q])
        there = [i for i in acting if fitted.design.noise.weight[q][i] > 0]
        if not there:
            continue
        change = float(np.mean((b - a)[there][:, :k]))
        std = float(np.sqrt(np.mean(np.diag(fitted.design.noise.covariance[q])[:k])))
        if abs(change) > ACTS * std:
            rows.append({"mode": problem.blocks.group_name(q), "frequency_percent": 100 * change})
    return sorted(rows, key=lambda r: -abs(r["frequency_percent"]))
