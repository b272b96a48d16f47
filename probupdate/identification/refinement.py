"""A block's modes at the greatest likelihood of its spectra, begun from SSI-cov (`spectral_likelihood`).

Single modes and groups of close ones alike. What the likelihood does not bear stays as SSI-cov has it: a group beyond
three modes, a search that does not end, an estimate outside its own band, and spectra that the model does not fit, such
as a machine's line or a force far from white beside the mode.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from probupdate.identification.order_average import ModePoles
from probupdate.identification.settings import CONSTANTS
from probupdate.identification.spectral_likelihood import GroupFit, Spectrum, Start, fit
from probupdate.identification.uncertainty import scaled_change
from probupdate.modal.modes import CovarianceFactors, unit_largest
from probupdate.runtime.arrays import frozen_array

OVERLAP, MISFIT, SAME = CONSTANTS.overlap, CONSTANTS.largest_misfit, CONSTANTS.same_mode_std
# modes of one group, and with their neighbours: S has their square of elements
LARGEST, TOGETHER = 3, 5
# half-power half-widths of a band that says all of a mode where the model of its force holds so far, and of one that
# says most of it whatever the force is like farther off; standard deviations of their difference that chance exceeds
# once in twenty times
WIDE, NARROW, APART = 20.0, 4.0, 2.0
# power of the frequency that a record's spectra have over those of accelerations
POWER = {"acceleration": 0, "velocity": -1, "displacement": -2}


def refine_modes(
    data: np.ndarray, rate_hz: float, poles: ModePoles, *, highest_hz: float, quantity: str = "acceleration",
    fixed: np.ndarray | None = None,
) -> tuple[ModePoles, np.ndarray]:
    """The modes with what the spectra of their record say of them, and which were replaced (n_mode,) bool.

    data (n_sample, n_channel) at rate_hz, without its mean, its spectra as they were measured up to highest_hz; fixed
    (n_mode,) bool: modes that stay. The real part of a replaced shape is the likelihood's, its imaginary part SSI-cov's
    outside the group's plane.
    """
    taken = np.zeros(len(poles.frequency_hz), bool)
    parts, power = poles.factors.n_column, POWER.get(quantity)
    known = np.isfinite(poles.frequency_hz) & (poles.damping_ratio > 0) & (poles.frequency_hz < highest_hz)
    if power is None or parts < 2 or not known.any():
        return poles, taken
    spectrum = _spectrum(data, rate_hz, highest_hz, power)
    real = poles.shape.real
    level = np.array([spectrum.force_level(f, z, shape) if one else np.nan for one, f, z, shape in zip(
        known, poles.frequency_hz, poles.damping_ratio, real.T, strict=True)])
    known &= np.nan_to_num(level) > 0
    found = []
    for group in groups(poles.frequency_hz, poles.damping_ratio, np.flatnonzero(known)):
        if len(group) > min(LARGEST, len(real)) or (fixed is not None and fixed[group].any()):
            continue

        def fit_in(half_widths: float, group: list[int] = group) -> GroupFit | None:
            place = np.array([*group, *_neighbours(poles.frequency_hz, group, known, half_widths)])
            one = fit(spectrum, Start(
                n_group=len(group), frequency_hz=poles.frequency_hz[place], damping_ratio=poles.damping_ratio[place],
                shape=real[:, place], level=level[place]), parts, half_widths)
            return one if one is not None and _may_replace(one, poles, group) else None

        # what the wide band refuses has more than another colour of its force: lines, tails, a channel that lags
        if (wide := fit_in(WIDE)) is not None:
            narrow = fit_in(NARROW)
            found.append((group, wide if narrow is None or _agree(narrow, wide) else narrow))
            taken[group] = True
    return _replace_modes(poles, found), frozen_array(taken, bool)


def _spectrum(data: np.ndarray, rate_hz: float, highest_hz: float, power: int) -> Spectrum:
    """Of accelerations: velocities and displacements take factors of the frequency."""
    n = len(data)
    line = fft.rfftfreq(n, 1 / rate_hz)
    inside = slice(1, int(np.searchsorted(line, highest_hz)))
    value = fft.rfft(np.ascontiguousarray(data.T), axis=1).T[inside] * np.sqrt(2 / (n * rate_hz))
    if power:
        value = value * line[inside, None] ** (-power)
    return Spectrum(line_hz=line[inside], value=value, seconds=n / rate_hz)


def groups(frequency_hz: np.ndarray, damping_ratio: np.ndarray, modes: np.ndarray) -> list[list[int]]:
    """Modes whose bands of `OVERLAP` half-power half-widths meet are of one group."""
    found: list[list[int]] = []
    half = OVERLAP * damping_ratio * frequency_hz
    for k in modes[np.argsort(frequency_hz[modes])]:
        if found and frequency_hz[k] - frequency_hz[found[-1][-1]] < half[k] + half[found[-1][-1]]:
            found[-1].append(int(k))
        else:
            found.append([int(k)])
    return found


def _neighbours(frequency_hz: np.ndarray, group: list[int], known: np.ndarray, half_widths: float) -> list[int]:
    """Modes whose tails stand beside a group's: in the narrow band those of the next below and the next above."""
    away = np.log(frequency_hz / np.exp(np.log(frequency_hz[group]).mean()))
    others = [k for k in np.argsort(np.abs(away)) if known[k] and k not in group]
    if half_widths == WIDE:
        return others[: TOGETHER - len(group)]
    return [*[k for k in others if away[k] < 0][:1], *[k for k in others if away[k] > 0][:1]]


def _agree(narrow: GroupFit, wide: GroupFit) -> bool:
    """Whether what the lines farther off add is within chance; if not, the force is another one there. The variance of
    the difference is that of an efficient estimate and one of fewer data, the difference of theirs (Hausman 1978), and
    no less than what the parts of the record say of it."""
    for difference, infos, parts in (
        (np.log(narrow.frequency_hz / wide.frequency_hz), (narrow.ln_frequency_std, wide.ln_frequency_std),
         narrow.ln_frequency - wide.ln_frequency),
        (narrow.damping_ratio - wide.damping_ratio, (narrow.damping_std, wide.damping_std),
         narrow.damping - wide.damping),
    ):
        variance = np.maximum(infos[0] ** 2 - infos[1] ** 2, np.sum(parts**2, axis=1))
        if np.any(difference**2 > APART**2 * variance):
            return False
    return True


def _may_replace(one: GroupFit, poles: ModePoles, group: list[int]) -> bool:
    """Whether the likelihood's modes may stand for those that the search began from."""
    f, zeta = poles.frequency_hz[group], poles.damping_ratio[group]
    f_std, zeta_std = (np.linalg.norm(factor[group], axis=1) for factor in (
        poles.factors.ln_frequency, poles.factors.damping_ratio))
    moved = np.abs(np.log(one.frequency_hz / f)) > np.maximum(np.maximum(zeta, one.damping_ratio), SAME * f_std)
    changed = np.abs(one.damping_ratio - zeta) > np.maximum(0.7 * zeta, SAME * zeta_std)
    return bool(one.converged and one.misfit < MISFIT and np.all(one.damping_ratio > 0)
                and not np.any(moved | changed) and np.all(np.isfinite(one.ln_frequency_std)))


def _replace_modes(poles: ModePoles, found: list[tuple[list[int], GroupFit]]) -> ModePoles:
    """The modes of each group replaced, with their covariance factors."""
    if not found:
        return poles
    f, zeta, shape = (np.array(a) for a in (poles.frequency_hz, poles.damping_ratio, poles.shape))
    of_f, of_zeta, of_shape = (np.array(a) for a in (
        poles.factors.ln_frequency, poles.factors.damping_ratio, poles.factors.shape))
    for group, one in found:
        f[group], zeta[group] = one.frequency_hz, one.damping_ratio
        of_f[group] = _limit_information(one.ln_frequency, one.ln_frequency_std)
        of_zeta[group] = _limit_information(one.damping, one.damping_std)
        scale = one.shape[np.argmax(np.abs(one.shape), axis=0), np.arange(len(group))]
        real, moved = one.shape / scale, one.shape_change / scale[:, None]
        plane = np.linalg.qr(real)[0]
        outside = np.eye(len(real)) - plane @ plane.T
        together = real + 1j * outside @ shape[:, group].imag
        moved = moved + 1j * np.tensordot(outside, of_shape[:, group].imag, axes=1)
        of_shape[:, group] = scaled_change(together, moved)
        shape[:, group] = unit_largest(together)
    return ModePoles(frequency_hz=f, damping_ratio=zeta, shape=shape, factors=CovarianceFactors(
        ln_frequency=of_f, damping_ratio=of_zeta, shape=of_shape))


def _limit_information(change: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Factors whose standard deviations are those of the information where the record's parts scatter less: these are
    not quite independent where a mode's memory is as long as a part. Under forces that grow and fade they scatter more.
    """
    own = np.linalg.norm(change, axis=1)
    return change * np.maximum(1.0, std / np.where(own > 0, own, np.inf))[:, None]
