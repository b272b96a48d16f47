"""Which poles are modes of the structure, and which criterion removed each of the others.

Two classifiers stand side by side. `paper_criteria`: MAC above 0.80 to a mode of the model, then complexity near the
P-frequencies. `block_criteria` here and `tracking.track` after it: against the modes that the campaign's own poles show
(`physical`), shapes of close pairs against the plane of the pair, harmonics by the rotor speed, standard deviations,
agreement of the model orders, and frequencies followed over the campaign.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.campaign.scada import turning_range
from probupdate.errors import InputError
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.settings import CONSTANTS
from probupdate.identification.ssi import Poles
from probupdate.modal.modes import mac, modal_phase_collinearity
from probupdate.runtime.arrays import frozen_array

# what became of a pole; in this order the first that applies gives its name
KEPT, SHAPE, DAMPING, FREQUENCY, COMPLEXITY, UNCERTAIN = (
    "kept", "mac", "damping", "frequency", "complexity", "uncertain",
)
HARMONIC, CLUSTER, DUPLICATE, UNSTABLE, OTHER_ORDER = (
    "harmonic", "cluster", "duplicate", "unstable", "other order",
)
# by no criterion, but by hand
REJECTED = "rejected"
# criterion of modes.poles.csv -> what it says of a pole
POLE_WORDS = {
    "kept": "was taken for a mode", "harmonic": "follows the rotor's speed", "damping": "is damped too strongly or not",
    "duplicate": "is second best for its mode", "mac": "has the shape of no mode",
    "cluster": "lies far from its mode's other poles", "complexity": "has a shape far from real",
    "frequency": "lies too far from its mode of the model",
    "other order": "stands for a mode that a pole of another order was taken for",
    "unstable": "stands for a mode, with too few orders beside it", "uncertain": "has too large a standard deviation",
    "rejected": "was rejected by hand",
}
STABILITY_FLOOR, DAMPING_FLOOR, LEAST_DAMPING = (
    CONSTANTS.stability_floor, CONSTANTS.damping_floor, CONSTANTS.least_damping,
)
TWIN_FREQUENCY, TWIN_MAC = CONSTANTS.twin_frequency, CONSTANTS.twin_mac
# times the Cramer-Rao bound that a mode's frequency scatters at most
STEADY = 4.0
RANGE_MARGIN = CONSTANTS.range_margin


@dataclass(frozen=True, kw_only=True)
class ClassifierSettings:
    """Thresholds; the result holds those it was made with.

    mac: of a single mode, and in the paper's classifier. weak_mac: of a single mode that lies where the campaign has
    it (a torsion hardly excited in half an hour has 0.6 to 0.8 by noise alone). plane_mac: S2MAC of a pole to its
    pair's plane. damping: open interval of the ratio; above its end lie poles of waves and turbulence.
    frequency_window: pole over model frequency, wide because a design model may be 30 % off. harmonics: multiples of
    the rotor speed; a pole within harmonic_tolerance of the range a multiple swept is a harmonic if it lies further
    than harmonic_window from its mode's frequency, or nearer with damping below harmonic_damping: the line of a rotor
    whose speed wanders by 1 % shows 0.4 to 1.5 % of damping, as much as a structure. cluster: half-width about a
    mode's frequency as followed over the campaign. least_share: of the model orders that must have the mode in a
    block. collinearity: least MPC of a single mode; pairs are not asked. paper_collinearity: the same near
    P-frequencies in the paper's classifier. least_independence: of the two poles of a pair, 1 - MAC in the plane;
    below it they are one direction twice. frequency_std, damping_std: largest standard deviations of ln f and of the
    damping ratio, asked where standard deviations are known.
    """

    mac: float = 0.80
    weak_mac: float = 0.60
    plane_mac: float = 0.90
    damping: tuple[float, float] = (0.0, 0.12)
    frequency_window: tuple[float, float] = (0.65, 1.5)
    harmonics: tuple[int, ...] = (1, 3, 6, 9)
    harmonic_tolerance: float = 0.02
    harmonic_damping: float = 0.003
    harmonic_window: float = 0.02
    cluster: float = 0.05
    least_share: float = 0.25
    collinearity: float = 0.50
    paper_collinearity: float = 0.80
    least_independence: float = 0.25
    frequency_std: float = 0.03
    damping_std: float = 0.03

    def __post_init__(self):
        shares = ("mac", "weak_mac", "plane_mac", "least_share", "collinearity", "paper_collinearity",
                  "least_independence")
        for name in shares:
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"classifier, {name}", f"{getattr(self, name)} is not in 0 to 1", "give a share")
        widths = ("harmonic_tolerance", "harmonic_damping", "harmonic_window", "cluster", "frequency_std",
                  "damping_std")
        for name in widths:
            if not getattr(self, name) > 0:
                raise InputError(f"classifier, {name}", f"{getattr(self, name)} is not positive", "give one above zero")
        for name in ("damping", "frequency_window"):
            low, high = getattr(self, name)
            if not low < high:
                raise InputError(f"classifier, {name}", f"[{low}, {high}] is empty", "give the lower end first")


@dataclass(frozen=True, eq=False, kw_only=True)
class PoleStack:
    """Poles of several model orders of one block side by side: order (n_pole,), frequency_hz, damping_ratio
    (n_pole,), shape (n_channel, n_pole) complex, not scaled."""

    order: np.ndarray
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray

    @property
    def orders(self) -> np.ndarray:
        """(n_order,) ascending, those that have a pole."""
        return np.unique(self.order)


def stack_poles(poles: Sequence[Poles] | Poles) -> PoleStack:
    """Poles of one order or of several, stacked in the order given."""
    several = (poles,) if isinstance(poles, Poles) else tuple(poles)
    return PoleStack(
        order=frozen_array(np.repeat([p.order for p in several], [len(p.frequency_hz) for p in several]), int),
        frequency_hz=frozen_array(np.concatenate([p.frequency_hz for p in several])),
        damping_ratio=frozen_array(np.concatenate([p.damping_ratio for p in several])),
        shape=frozen_array(np.concatenate([p.shape for p in several], axis=1), complex),
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class PoleComparison:
    """Poles held against modes. best_mac, best_mode (n_pole,): to any single mode; similarity (n_pole, n_group):
    S2MAC to a pair's plane, MAC to a single mode, 0 outside a mode's range where that is known; mpc (n_pole,);
    stability (n_pole,): share of the other orders in which a pole has a twin, 1 where there is one order only; group
    (n_pole,): the one each pole is most like, where ranges are known by shape and nearness in frequency.
    """

    best_mac: np.ndarray
    best_mode: np.ndarray
    similarity: np.ndarray
    mpc: np.ndarray
    stability: np.ndarray
    group: np.ndarray

    def score(self, damping_ratio: np.ndarray) -> np.ndarray:
        """(n_pole,) how much speaks for each pole within its group: alike, stable over the orders, lightly damped.

        A mode's double beside it, from noise or waves, comes and goes with the order and has more damping.
        """
        similar = np.max(self.similarity, axis=1, initial=0)
        damping = np.maximum(damping_ratio, LEAST_DAMPING) + DAMPING_FLOOR
        return similar * (self.stability + STABILITY_FLOOR) ** 2 / damping


def comparison(poles: PoleStack, reference: ReferenceModes, stability: np.ndarray | None = None) -> PoleComparison:
    """`stability` (n_pole,) as given, else from the stack's own orders."""
    single = mac(poles.shape, reference.shape)
    similarity = np.column_stack([
        _plane_similarity(poles.shape, reference.shape[:, list(g)]) if len(g) > 1 else single[:, list(g)].ravel()
        for g in reference.groups
    ])
    nearness = 1.0
    if reference.range_hz is not None:
        away = _range_distance(poles.frequency_hz, reference.range_hz, reference.groups)
        similarity = np.where(away <= RANGE_MARGIN, similarity, 0.0)
        # with few channels several modes have one shape: then the nearest in frequency
        nearness = np.exp(-0.5 * (away / RANGE_MARGIN) ** 2)
    if stability is None:
        stability = _stability(poles, similarity, np.array([len(g) > 1 for g in reference.groups]))
    return PoleComparison(
        best_mac=frozen_array(single.max(axis=1)), best_mode=frozen_array(single.argmax(axis=1), int),
        similarity=frozen_array(similarity), mpc=frozen_array(modal_phase_collinearity(poles.shape)),
        stability=frozen_array(stability), group=frozen_array(np.argmax(similarity * nearness, axis=1), int),
    )


def _range_distance(frequency_hz: np.ndarray, range_hz: np.ndarray, groups: tuple[tuple[int, ...], ...]) -> np.ndarray:
    """(n_pole, n_group) distance in ln f of each pole from the range of each group."""
    low, high = (np.log(np.array([ends(range_hz[list(g), side]) for g in groups]))
                 for side, ends in ((0, np.min), (1, np.max)))
    place = np.log(frequency_hz)[:, None]
    return np.maximum(np.maximum(low - place, place - high), 0.0)


def _plane_similarity(shape: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """(n_pole,) `modes.subspace_mac` of complete shapes, all at once: a block has some hundred poles."""
    basis, _ = np.linalg.qr(plane)
    return np.sum(np.abs(basis.conj().T @ shape) ** 2, axis=0) / np.sum(np.abs(shape) ** 2, axis=0)


def _stability(poles: PoleStack, similarity: np.ndarray, paired: np.ndarray) -> np.ndarray:
    """Share of the other orders with a twin. Two poles of a pair are alike if they lie in the pair's plane: in it
    their directions turn with the order, and a mutual MAC would call both unstable."""
    orders = poles.orders
    if len(orders) < 2:
        return np.ones(len(poles.order))
    alike = mac(poles.shape, poles.shape) >= TWIN_MAC
    for g in np.flatnonzero(paired):
        inside = similarity[:, g] >= TWIN_MAC
        alike |= inside[:, None] & inside
    alike &= np.abs(np.log(poles.frequency_hz / poles.frequency_hz[:, None])) <= TWIN_FREQUENCY
    twins = np.column_stack([alike[:, poles.order == n].any(axis=1) for n in orders])
    # its own order always holds the pole itself
    return (twins.sum(axis=1) - 1) / (len(orders) - 1)


def rotor_bands(conditions: Mapping[str, float | str], settings: ClassifierSettings) -> np.ndarray:
    """(n_harmonic, 2) frequencies in Hz that the multiples of the rotor speed swept in a block; empty without SCADA."""
    low, high = turning_range(conditions)
    if not np.isfinite([low, high]).all():
        return np.zeros((0, 2))
    range_hz = np.array([low * (1 - settings.harmonic_tolerance), high * (1 + settings.harmonic_tolerance)]) / 60
    return np.array(settings.harmonics)[:, None] * range_hz


def is_within(frequency_hz: np.ndarray, bands: np.ndarray) -> np.ndarray:
    """(n,) bool: in any of the bands (n_band, 2)."""
    return np.any((frequency_hz[:, None] >= bands[:, 0]) & (frequency_hz[:, None] <= bands[:, 1]), axis=1)


def paper_criteria(poles: PoleStack, found: PoleComparison, bands: np.ndarray,
                   settings: ClassifierSettings) -> np.ndarray:
    """(n_pole,) the paper's classifier: 'mac' below 0.80 to every mode; 'complexity' near a P-frequency with an
    imaginary part too large; else 'kept'.

    The complexity is the MPC: with s the share of the imaginary part in |phi|^2 after rotation, MPC = (1 - 2 s)^2.
    Without a rotor speed every complex pole counts as near.
    """
    near = is_within(poles.frequency_hz, bands) if len(bands) else np.ones(len(poles.frequency_hz), bool)
    verdict = np.full(len(poles.frequency_hz), KEPT, dtype=object)
    verdict[near & (found.mpc < settings.paper_collinearity)] = COMPLEXITY
    verdict[~(found.best_mac > settings.mac)] = SHAPE
    return verdict


def block_criteria(
    poles: PoleStack, found: PoleComparison, reference: ReferenceModes, settings: ClassifierSettings, *,
    uncertain: Sequence[int] = (),
) -> np.ndarray:
    """(n_pole,) what can be said of a pole from its own block: 'mac', 'damping', 'frequency', 'complexity',
    'uncertain', 'kept'.

    Single modes are asked for weak_mac only; whether less than `mac` is enough, the campaign decides. uncertain:
    numbers of the poles that `is_uncertain`.
    """
    group = found.group
    paired = np.array([len(g) > 1 for g in reference.groups])[group]
    similar = found.similarity[np.arange(len(group)), group]
    if reference.range_hz is None:
        ratio = poles.frequency_hz / np.array([reference.group_hz(g) for g in reference.groups])[group]
        elsewhere = (ratio < settings.frequency_window[0]) | (ratio > settings.frequency_window[1])
    else:
        away = _range_distance(poles.frequency_hz, reference.range_hz, reference.groups)
        elsewhere = away[np.arange(len(group)), group] > RANGE_MARGIN
    verdict = np.full(len(group), KEPT, dtype=object)
    # asked in this order: the first that fails gives its name, so the last written is the first asked
    verdict[list(uncertain)] = UNCERTAIN
    verdict[~paired & (found.mpc < settings.collinearity)] = COMPLEXITY
    verdict[elsewhere] = FREQUENCY
    verdict[(poles.damping_ratio <= settings.damping[0]) | (poles.damping_ratio >= settings.damping[1])] = DAMPING
    verdict[~(similar >= np.where(paired, settings.plane_mac, min(settings.mac, settings.weak_mac)))] = SHAPE
    return verdict


def frequency_bound(damping: float, frequency_hz: float, seconds: float) -> float:
    """Cramer-Rao bound of the standard deviation of ln f, of a mode under white forces without noise."""
    return float(np.sqrt(damping / (4 * np.pi * frequency_hz * seconds)))


def is_uncertain(frequency_hz: float, damping: float, ln_frequency_std: float, damping_std: float, seconds: float,
                 settings: ClassifierSettings) -> bool:
    """Whether a pole stands for nothing in particular: beyond the settings' limits, or its frequency is not known to
    half of its own peak's width, which a record of so many seconds would tell of a mode."""
    own = max(damping, STEADY * frequency_bound(damping, frequency_hz, seconds))
    return ln_frequency_std > min(settings.frequency_std, own) or damping_std > settings.damping_std


def is_trusted(found: PoleComparison, reference: ReferenceModes, settings: ClassifierSettings) -> np.ndarray:
    """(n_pole,) bool: alike enough to vote on where a mode lies; single modes by `mac`, pairs by `plane_mac`."""
    paired = np.array([len(g) > 1 for g in reference.groups])[found.group]
    similar = found.similarity[np.arange(len(paired)), found.group]
    return similar >= np.where(paired, settings.plane_mac, settings.mac)

