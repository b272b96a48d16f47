"""Which poles are modes of the structure, and which criterion removed each of the others.

Two classifiers stand side by side. `paper_criteria`: MAC above 0.80 to a mode of the model, then complexity near the
P-frequencies. `block_criteria` and `assigned`: shapes of close pairs against the plane of the model's pair, harmonics
by the rotor speed, and one cluster of frequencies per pair over the campaign.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from probupdate.identification.reference import ReferenceModes
from probupdate.identification.ssi import Poles
from probupdate.modes import frozen_array, mac, modal_phase_collinearity, pair_by_mac, subspace_mac

KEPT, SHAPE, DAMPING, FREQUENCY, HARMONIC, COMPLEXITY, CLUSTER, DUPLICATE = (
    "kept", "mac", "damping", "frequency", "harmonic", "complexity", "cluster", "duplicate",
)
# of several poles of one mode similarity (stability + 0.1)^2 / (damping + 1 %) decides, damping below 0.5 % counted as
# that: no structure has less, and a pole of noise may have any
STABILITY_FLOOR, DAMPING_FLOOR, LEAST_DAMPING = 0.1, 0.01, 0.005


@dataclass(frozen=True, kw_only=True)
class ClassifierSettings:
    """Thresholds; the result holds those it was made with.

    mac: of a single mode, and in the paper's classifier. plane_mac: S2MAC of a pole to its pair's plane. damping:
    open interval of the ratio; above its end lie poles of waves and turbulence. frequency_window: pole over model
    frequency, wide because a design model may be 30 % off. harmonics: multiples of the rotor speed; a pole within
    harmonic_tolerance of the range a multiple swept is a harmonic if it lies outside its mode's window or cluster, or
    inside with damping below harmonic_damping. cluster: half-width of a mode's frequencies over the campaign.
    collinearity: least MPC of a single mode; weak ones (torsion in an idling half hour) have 0.6 to 0.8 by noise
    alone, and pairs are not asked. paper_collinearity: the same near P-frequencies in the paper's classifier.
    least_independence: of the two poles of a pair, 1 - MAC in the plane; below it they are one direction twice.
    """

    mac: float = 0.80
    plane_mac: float = 0.90
    damping: tuple[float, float] = (0.0, 0.12)
    frequency_window: tuple[float, float] = (0.65, 1.5)
    harmonics: tuple[int, ...] = (1, 3, 6, 9)
    harmonic_tolerance: float = 0.02
    harmonic_damping: float = 0.003
    cluster: float = 0.08
    collinearity: float = 0.50
    paper_collinearity: float = 0.80
    least_independence: float = 0.25


@dataclass(frozen=True, eq=False, kw_only=True)
class Likeness:
    """Poles held against the model. best_mac, best_mode (n_pole,): to any single mode; similarity (n_pole, n_group):
    S2MAC to a pair's plane, MAC to a single mode; mpc (n_pole,); stability (n_pole,) over model orders, from `ssi`.
    """

    best_mac: np.ndarray
    best_mode: np.ndarray
    similarity: np.ndarray
    mpc: np.ndarray
    stability: np.ndarray

    @property
    def group(self) -> np.ndarray:
        """(n_pole,) the group each pole is most like."""
        return np.argmax(self.similarity, axis=1)

    def score(self, damping_ratio: np.ndarray) -> np.ndarray:
        """(n_pole,) how much speaks for each pole within its group: alike, stable over the orders, lightly damped.

        A mode's double beside it, from noise or waves, comes and goes with the order and has more damping.
        """
        similar = np.max(self.similarity, axis=1)
        damping = np.maximum(damping_ratio, LEAST_DAMPING) + DAMPING_FLOOR
        return similar * (self.stability + STABILITY_FLOOR) ** 2 / damping


def likeness(poles: Poles, reference: ReferenceModes, stability: np.ndarray) -> Likeness:
    single = mac(poles.shape, reference.shape)
    columns = [
        subspace_mac(poles.shape, reference.shape[:, list(g)]) if len(g) > 1 else single[:, g[0]]
        for g in reference.groups
    ]
    return Likeness(
        best_mac=frozen_array(single.max(axis=1)), best_mode=frozen_array(single.argmax(axis=1), int),
        similarity=frozen_array(np.column_stack(columns)), mpc=frozen_array(modal_phase_collinearity(poles.shape)),
        stability=frozen_array(stability),
    )


def rotor_bands(conditions: Mapping[str, float | str], settings: ClassifierSettings) -> np.ndarray:
    """(n_harmonic, 2) frequencies in Hz that the multiples of the rotor speed swept in a block; empty without SCADA."""
    low, high = conditions.get("rotor_speed_rpm_min"), conditions.get("rotor_speed_rpm_max")
    if low is None or high is None or not np.isfinite([low, high]).all():
        return np.zeros((0, 2))
    range_hz = np.array([low * (1 - settings.harmonic_tolerance), high * (1 + settings.harmonic_tolerance)]) / 60
    return np.array(settings.harmonics)[:, None] * range_hz


def within(frequency_hz: np.ndarray, bands: np.ndarray) -> np.ndarray:
    """(n,) bool: in any of the bands (n_band, 2)."""
    return np.any((frequency_hz[:, None] >= bands[:, 0]) & (frequency_hz[:, None] <= bands[:, 1]), axis=1)


def paper_criteria(poles: Poles, found: Likeness, bands: np.ndarray, settings: ClassifierSettings) -> np.ndarray:
    """(n_pole,) the paper's classifier: 'mac' below 0.80 to every mode; 'complexity' near a P-frequency with an
    imaginary part too large; else 'kept'.

    The complexity is the MPC: with s the share of the imaginary part in |phi|^2 after rotation, MPC = (1 - 2 s)^2.
    Without a rotor speed every complex pole counts as near.
    """
    near = within(poles.frequency_hz, bands) if len(bands) else np.ones(len(poles.frequency_hz), bool)
    verdict = np.full(len(poles.frequency_hz), KEPT, dtype=object)
    verdict[near & (found.mpc < settings.paper_collinearity)] = COMPLEXITY
    verdict[~(found.best_mac > settings.mac)] = SHAPE
    return verdict


def block_criteria(
    poles: Poles, found: Likeness, reference: ReferenceModes, settings: ClassifierSettings
) -> np.ndarray:
    """(n_pole,) what can be said of a pole from its own block: 'mac', 'damping', 'frequency', 'complexity', 'kept'."""
    group = found.group
    paired = np.array([len(g) > 1 for g in reference.groups])[group]
    similar = found.similarity[np.arange(len(group)), group]
    ratio = poles.frequency_hz / np.array([reference.group_hz(g) for g in reference.groups])[group]
    verdict = np.full(len(group), KEPT, dtype=object)
    # asked in this order: the first that fails gives its name, so the last written is the first asked
    verdict[~paired & (found.mpc < settings.collinearity)] = COMPLEXITY
    verdict[(ratio < settings.frequency_window[0]) | (ratio > settings.frequency_window[1])] = FREQUENCY
    verdict[(poles.damping_ratio <= settings.damping[0]) | (poles.damping_ratio >= settings.damping[1])] = DAMPING
    verdict[~(similar >= np.where(paired, settings.plane_mac, settings.mac))] = SHAPE
    return verdict


def cluster_centre(frequency_hz: np.ndarray, weight: np.ndarray, bandwidth: float = 0.02) -> float:
    """The frequency around which most weight lies: the peak of a Gaussian density of ln f; NaN without any."""
    if not np.sum(weight) > 0:
        return np.nan
    x = np.log(frequency_hz)
    density = np.exp(-0.5 * ((x[:, None] - x) / bandwidth) ** 2) @ weight
    peak = x[np.argmax(density)]
    near = np.exp(-0.5 * ((x - peak) / bandwidth) ** 2) * weight
    return float(np.exp(np.sum(near * x) / np.sum(near)))


@dataclass(frozen=True, eq=False, kw_only=True)
class Assignment:
    """criterion (n_pole,) of each pole; pole (n_mode,) the pole of each reference mode, -1 where there is none;
    independence (n_group,): 1 - MAC in the plane between a pair's two poles, NaN where they are not both there."""

    criterion: np.ndarray
    pole: np.ndarray
    independence: np.ndarray


def assigned(
    poles: Poles, found: Likeness, verdict: np.ndarray, centre_hz: np.ndarray, bands: np.ndarray,
    reference: ReferenceModes, settings: ClassifierSettings,
) -> Assignment:
    """Harmonics and strays removed, then one pole per mode; centre_hz (n_group,) from `cluster_centre`.

    The two poles of a pair are named by their direction in the plane of the model's pair. Where the pair is not
    resolved the single shapes are any two of that plane: only the plane is data then.
    """
    criterion, chosen = verdict.copy(), np.full(len(reference.labels), -1)
    independence = np.full(len(reference.groups), np.nan)
    swept, score = within(poles.frequency_hz, bands), found.score(poles.damping_ratio)
    criterion[swept & (verdict == FREQUENCY)] = HARMONIC
    for g, group in enumerate(reference.groups):
        mine = np.flatnonzero((verdict == KEPT) & (found.group == g))
        stray = ~(np.abs(poles.frequency_hz[mine] / centre_hz[g] - 1) <= settings.cluster)
        line = poles.damping_ratio[mine] < settings.harmonic_damping
        criterion[mine[stray]] = CLUSTER
        criterion[mine[swept[mine] & (stray | line)]] = HARMONIC
        left = mine[criterion[mine] == KEPT]
        taken, independence[g] = _taken(left, poles, score, reference.shape[:, list(group)], settings)
        criterion[np.setdiff1d(left, list(taken.values()))] = DUPLICATE
        for member, pole in taken.items():
            chosen[group[member]] = pole
    return Assignment(criterion=criterion, pole=chosen, independence=independence)


def _taken(left, poles: Poles, score, shape, settings: ClassifierSettings) -> tuple[dict[int, int], float]:
    """Member of the group -> pole, from the poles `left` (indices); and the independence of a pair's two poles.

    A single mode takes the best score; a pair the two with the largest product of scores and independence.
    """
    if not len(left):
        return {}, np.nan
    score = score[left]
    if shape.shape[1] == 1:
        return {0: int(left[np.argmax(score)])}, np.nan
    # coordinates in the plane of the model's pair
    basis, triangle = np.linalg.qr(shape)
    inside = basis.T @ poles.shape[:, left]
    apart = 1 - mac(inside, inside)
    together = np.outer(score, score) * np.where(apart >= settings.least_independence, apart, 0)
    toward = mac(inside, triangle)
    if not np.any(together > 0):
        best = int(np.argmax(score))
        return {int(np.argmax(toward[best])): int(left[best])}, np.nan
    i, j = np.unravel_index(np.argmax(together), together.shape)
    two = np.array([i, j])
    return {member: int(left[two[k]]) for k, member in pair_by_mac(toward[two])}, float(apart[i, j])
