"""What an identification from half an hour makes of true modes: scatter of poles and shapes, with its own estimate.

The modes' state matrix diag(lambda) gets a random full matrix G; its eigenvalues and eigenvectors are what is
identified. A close pair turns into itself by G_12 / (lambda_1 - lambda_2), without a rule of its own, and far modes
hardly mix. Each shape also gets scatter channel by channel. Sizes were measured on the 18 undisturbed half hours of
one virtual day through SSI-cov, as a multiple of the asymptotic sqrt(zeta / (2 pi f T)) of ln f.
"""

from __future__ import annotations

import numpy as np

from probupdate.modal.modes import CovarianceFactors

# by family of columns FA1, SS1, T1, FA2, SS2
SCATTER = {"FA1": 1.6, "SS1": 1.6, "T1": 1.6, "FA2": 3.2, "SS2": 3.2}
CHANNEL_SCATTER = {"FA1": 0.0012, "SS1": 0.0012, "T1": 0.004, "FA2": 0.0018, "SS2": 0.0018}
N_COLUMN = 20  # parts of a record from which an identification estimates its standard deviations


def ln_frequency_std(frequency_hz: np.ndarray, damping_ratio: np.ndarray, duration_s: float, labels) -> np.ndarray:
    """(n_mode,) standard deviation of ln f of modes far from others."""
    factor = np.array([SCATTER[label] for label in labels])
    return factor * np.sqrt(damping_ratio / (2 * np.pi * frequency_hz * duration_s))


def _gaussian(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Complex, real and imaginary part of standard deviation one."""
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def identified_modes(
    frequency_hz: np.ndarray, damping_ratio: np.ndarray, shape: np.ndarray, labels: tuple[str, ...],
    duration_s: float, rng: np.random.Generator, *, scale: float = 1.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, CovarianceFactors]:
    """Frequencies, damping ratios (n_mode,), shapes (n_channel, n_mode) with largest component 1, and their estimated
    covariance factors, from true ones (shape of any scaling). scale 0: no scatter, and standard deviations of zero."""
    n_mode, omega = len(frequency_hz), 2 * np.pi * frequency_hz
    pole = omega * (-damping_ratio + 1j * np.sqrt(1 - damping_ratio**2))
    std = scale * omega * ln_frequency_std(frequency_hz, damping_ratio, duration_s, labels)
    size = np.sqrt(np.outer(std, std))
    own = scale * np.array([CHANNEL_SCATTER[label] for label in labels])
    shape = shape / np.abs(shape).max(axis=0)
    value, mixed = np.linalg.eig(np.diag(pole) + size * _gaussian(rng, n_mode, n_mode))
    order = _order_vectors(mixed)
    value, mixed = value[order], mixed[:, order]
    found = shape @ mixed
    found = found / np.abs(found).max(axis=0) + own * _gaussian(rng, *shape.shape)
    covariance_factors = _covariance_factors(value, found, size, own, rng)
    largest = np.argmax(np.abs(found), axis=0)
    found = found / found[largest, np.arange(n_mode)]
    return np.abs(value) / (2 * np.pi), -np.real(value) / np.abs(value), found, covariance_factors


def _order_vectors(mixed: np.ndarray) -> np.ndarray:
    """Eigenvectors (n, n) put in the order of the modes they are made of; their sets are disjoint."""
    share, order = np.abs(mixed) ** 2, np.full(len(mixed), -1)
    for _ in range(len(mixed)):
        mode, vector = np.unravel_index(np.argmax(share), share.shape)
        order[mode] = vector
        share[mode], share[:, vector] = -1, -1
    return order


def _covariance_factors(pole: np.ndarray, shape: np.ndarray, size: np.ndarray, own: np.ndarray,
                        rng) -> CovarianceFactors:
    """First order, a column per part of the record: as many draws of G and of channel scatter, over their root."""
    n_channel, n_mode = shape.shape
    g = size[:, :, None] * _gaussian(rng, n_mode, n_mode, N_COLUMN) / np.sqrt(N_COLUMN)
    moved = np.einsum("iik->ik", g)
    ln_frequency = (pole.conj()[:, None] * moved).real / np.abs(pole)[:, None] ** 2
    damping = -np.real(pole) / np.abs(pole)
    ratio = -moved.real / np.abs(pole)[:, None] - damping[:, None] * ln_frequency
    gap = pole[None, :] - pole[:, None]
    np.fill_diagonal(gap, 1.0)
    turned = g / gap[:, :, None]
    turned[np.arange(n_mode), np.arange(n_mode)] = 0.0
    change = np.einsum("cj,jik->cik", shape, turned)
    change += own[:, None] * _gaussian(rng, n_channel, n_mode, N_COLUMN) / np.sqrt(N_COLUMN)
    largest = np.argmax(np.abs(shape), axis=0)
    column = np.arange(n_mode)
    at = shape[largest, column]
    # in the scaling of a largest component of 1, which has no standard deviation
    change = (change - shape[:, :, None] * (change[largest, column] / at[:, None])) / at[:, None]
    return CovarianceFactors(ln_frequency=ln_frequency, damping_ratio=ratio, shape=change)
