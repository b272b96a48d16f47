"""Maximum likelihood of a group of close modes on the spectra of a record, in a band about them.

The lines of a record's Fourier transform are independent complex Gaussian vectors (Whittle 1953) of covariance
E = A H S H^H A^T + s W W^T: responses H of oscillators under forces of spectral matrix S, seen through the shapes A,
and noise s. Frequencies, damping, shapes, S and s are found by Fisher scoring, all at once, from the modes of another
method. Au (2011, 2012), Fast Bayesian FFT method for ambient modal identification, is the same likelihood for the group
alone; here neighbouring modes stand beside it in S with their tails, so that a wide band can be taken. Matrices are of
the size of the modes taken together, not of the channels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import fft

# bins of lines an e-fold of the distance from the resonance, beyond a half-power half-width
BINS = 4.0
# lowest and highest frequency of a band over the group's
BELOW, ABOVE = 0.6, 1.5
# standard deviations of what the spectra may say little of: elements of S's root over those at the modes' resonances,
# the power of the frequency by which S changes (the tail of a wind sea falls with the fifth: Hasselmann 1973), ln noise
FORCE_STD, SLOPE_STD, NOISE_STD = 1.0, 5.0, 1.5
STEPS, TRIES, ENOUGH, LONGEST = 15, 6, 0.02, 0.7


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectrum:
    """Fourier transform of a record whose mean is out: line_hz (n_line,), value (n_line, n_channel), its square the
    density of one side; seconds: its length."""

    line_hz: np.ndarray
    value: np.ndarray
    seconds: float

    def force_level(self, frequency_hz: float, damping_ratio: float, shape: np.ndarray) -> float:
        """Spectral density of a mode's force, from the lines at its resonance alone."""
        near = np.abs(self.line_hz - frequency_hz) <= max(1.5 * damping_ratio * frequency_hz, 2 / self.seconds)
        power = np.abs(self.value[near] @ (shape / (shape @ shape))) ** 2
        return float(power.mean() / np.mean(np.abs(responses(self.line_hz[near], frequency_hz, damping_ratio)) ** 2))


def responses(line_hz: np.ndarray, frequency_hz: np.ndarray, damping_ratio: np.ndarray) -> np.ndarray:
    """Acceleration of oscillators over their force: (n_line,), or (n_line, n_mode) for a column of lines."""
    ratio = frequency_hz / line_hz
    return 1 / (1 - ratio**2 - 2j * damping_ratio * ratio)


@dataclass(frozen=True, eq=False, kw_only=True)
class Start:
    """frequency_hz, damping_ratio (n_mode,), shape (n_channel, n_mode) real, force level (n_mode,): of the group's
    n_group modes first, then of its neighbours, which stay as they are."""

    n_group: int
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    level: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class GroupFit:
    """frequency_hz, damping_ratio (n_group,), shape (n_channel, n_group); their standard deviations by the information
    (of ln f, of damping); misfit: mean square of the whitened spectra's errors, 1 where the model holds; converged.

    ln_frequency, damping (n_group, n_part), shape_change (n_channel, n_group, n_part): what the parts of the record add
    to the estimate, scaled as covariance factors are.
    """

    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    ln_frequency_std: np.ndarray
    damping_std: np.ndarray
    misfit: float
    converged: bool
    ln_frequency: np.ndarray
    damping: np.ndarray
    shape_change: np.ndarray


@cache
def _indices_above_diagonal(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the elements above the diagonal."""
    return np.triu_indices(size, 1)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Band:
    """What a group is fitted to, and what is fixed. p modes in r coordinates: as many as there are modes, where there
    are more channels (all that is known of these modes is in them), else the channels themselves.

    line, value, coordinate: lines of the band; first (n_bin,): where each bin begins; count, sample (n_bin, r, r),
    middle (n_bin, 1): lines, mean spectral matrix and frequency of each bin. basis (n_channel, r); colour (r, r): of
    the noise in coordinates. free: elements of the group's shapes that are estimated; tails (n_bin, n_neighbour):
    responses of the neighbours; noise: ln of its density at the start; wider: by what a record's end raises damping.
    """

    start: Start
    line: np.ndarray
    value: np.ndarray
    coordinate: np.ndarray
    first: np.ndarray
    count: np.ndarray
    sample: np.ndarray
    middle: np.ndarray
    basis: np.ndarray
    colour: np.ndarray
    free: tuple[np.ndarray, np.ndarray]
    tails: np.ndarray
    distance: np.ndarray
    noise: float
    wider: np.ndarray

    @property
    def below(self) -> tuple[np.ndarray, np.ndarray]:
        return _indices_above_diagonal(len(self.start.level))[::-1]


def _band(spectrum: Spectrum, start: Start, half_widths: float) -> _Band:
    m, (n, p) = start.n_group, start.shape.shape
    # covariances at lag k are seen N - k times: resonances come out wider by 1 / T
    wider = 1 / (2 * np.pi * start.frequency_hz * spectrum.seconds)
    f, zeta = start.frequency_hz, start.damping_ratio + wider
    line = _lines(spectrum.line_hz, f, zeta, m, half_widths)
    value, line = spectrum.value[line], spectrum.line_hz[line]
    basis = start.shape if n > p else np.eye(n)
    inverse = np.linalg.pinv(basis)
    coordinate = value @ inverse.T
    along = np.arcsinh((line[:, None] - f[:m]) / (zeta * f)[:m]).sum(axis=1)
    first = np.flatnonzero(np.diff(np.floor(BINS * along), prepend=-np.inf))
    count = np.diff(np.append(first, len(line))).astype(float)
    outer = coordinate[:, :, None] * coordinate[:, None, :].conj()
    sample = np.add.reduceat(outer, first, axis=0) / count[:, None, None]
    middle = (np.add.reduceat(line, first) / count)[:, None]
    if n > p:
        noise = np.sum(np.abs(value - coordinate @ basis.T) ** 2) / (len(line) * (n - p))
    else:
        near = np.abs(responses(middle, f[:m], zeta[:m])).max(axis=1)
        off = count * (near <= max(2.0, np.quantile(near, 0.3)))
        noise = 0.5 * np.linalg.eigvalsh(np.einsum("k,kij->ij", off, sample) / off.sum())[0]
    scaled = np.arange(p) if n > p else np.argmax(np.abs(start.shape), axis=0)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(m), np.arange(basis.shape[1]), indexing="ij"))
    free = row != scaled[column]
    return _Band(
        start=start, line=line, value=value, coordinate=coordinate, first=first, count=count, sample=sample,
        middle=middle, basis=basis, colour=inverse @ inverse.T, free=(row[free], column[free]),
        tails=responses(middle, f[m:], zeta[m:]), distance=np.log(middle / np.exp(np.log(f[:m]).mean())),
        noise=float(np.log(max(noise, 1e-9 * start.level.mean()))),
        wider=wider[:m])


def _lines(line_hz: np.ndarray, f: np.ndarray, zeta: np.ndarray, m: int, half_widths: float) -> np.ndarray:
    """Lines about the group, at most to the middle between it and a neighbour, where that is clear of the neighbour."""
    half, lowest, highest = zeta * f, f[:m].min(), f[:m].max()
    low = max((f - half_widths * half)[:m].min(), BELOW * lowest)
    high = min((f + half_widths * half)[:m].max(), ABOVE * highest)
    for g, width in zip(f[m:], half[m:], strict=True):
        if g > highest:
            high = min(high, max(np.sqrt(g * highest), g - 4.5 * width))
        elif g < lowest:
            low = max(low, min(np.sqrt(g * lowest), g + 4.5 * width))
    return np.flatnonzero((line_hz >= low) & (line_hz <= high))


@dataclass(frozen=True, eq=False, kw_only=True)
class _State:
    """frequency, damping (n_group,), the latter with what the record's end adds; shape (r, p); root (p, p): lower, of
    S over the roots of the levels; slope: power of the frequency by which S changes; noise: ln."""

    frequency: np.ndarray
    damping: np.ndarray
    shape: np.ndarray
    root: np.ndarray
    slope: float
    noise: float


@dataclass(frozen=True, eq=False, kw_only=True)
class _FittedBand:
    """deviance: twice the negative log-posterior; of each bin h (n_bin, p), white (n_bin, r, r): the inverse root of E,
    error: the whitened sample less the unit matrix; force in its unit; prior: standardised distances from the start of
    the elements of S and of the noise, in the order of `_Parameters`."""

    deviance: float
    h: np.ndarray
    white: np.ndarray
    error: np.ndarray
    force: np.ndarray
    prior: np.ndarray


def _fit_band(band: _Band, state: _State) -> _FittedBand | None:
    """None where E is not positive."""
    scale = np.sqrt(band.start.level)
    h = np.concatenate([responses(band.middle, state.frequency, state.damping), band.tails], axis=1)
    h *= np.exp(0.5 * state.slope * band.distance)
    root = scale[:, None] * state.root
    through, force = state.shape * h[:, None, :], root @ root.conj().T
    covariance = through @ force @ through.conj().transpose(0, 2, 1) + np.exp(state.noise) * band.colour
    try:
        lower = np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return None
    white = np.linalg.inv(lower)
    sample = white @ band.sample @ white.conj().transpose(0, 2, 1)
    log = 2 * np.log(np.einsum("kii->ki", lower).real).sum(axis=1)
    away = state.root[band.below]
    prior = np.concatenate([np.log(np.diag(state.root).real), away.real, away.imag]) / FORCE_STD
    prior = np.concatenate([prior, [state.slope / SLOPE_STD, (state.noise - band.noise) / NOISE_STD]])
    value = 2 * band.count @ (log + np.einsum("kii->k", sample).real) + prior @ prior
    return _FittedBand(deviance=float(value), h=h, white=white, error=sample - np.eye(len(band.colour)), force=force,
                       prior=prior)


def _derivatives(band: _Band, state: _State, now: _FittedBand) -> np.ndarray:
    """Whitened derivatives of E, real (n_parameter, n_bin, r, r) as `_real` has Hermitian matrices: by ln f, ln damping
    (n_group each), free elements of the shapes, root of S (ln of the diagonal, real and imaginary parts below it), its
    slope, ln noise."""
    m, ratio = band.start.n_group, state.frequency / band.middle
    own = responses(band.middle, state.frequency, state.damping) * now.h[:, :m]
    shape = now.white @ state.shape  # (n_bin, r, p)
    through = shape * now.h[:, None, :]
    # S H^H A^T and H S H^H A^T, whitened on the right
    right = now.force @ through.conj().transpose(0, 2, 1)
    forced = now.h[:, :, None] * right
    # a step of ln f counts in half-power half-widths, so that steps are of one size
    by_f = state.damping * own * (2 * ratio**2 + 2j * state.damping * ratio)
    by_zeta = own * 2j * state.damping * ratio
    row, column = band.free
    left = [shape[:, :, :m] * d[:, None, :] for d in (by_f, by_zeta)]
    left = np.concatenate([*left, now.white[:, :, row]], axis=2).transpose(2, 0, 1)
    beside = np.concatenate([right[:, :m], right[:, :m], forced[:, column]], axis=1).transpose(1, 0, 2)
    scaled = through * np.sqrt(band.start.level)
    turned = (scaled @ state.root).conj().transpose(2, 0, 1)
    scaled, (a, b) = scaled.transpose(2, 0, 1), band.below
    left = np.concatenate([left, scaled * np.diag(state.root)[:, None, None], scaled[a], 1j * scaled[a]])
    beside = np.concatenate([beside, turned, turned[b], turned[b]])
    noise = np.exp(state.noise) * now.white @ band.colour @ now.white.conj().transpose(0, 2, 1)
    half = left[:, :, :, None] * beside[:, :, None, :]
    slope = band.distance[:, :, None] * (np.eye(len(band.colour)) - noise)
    return np.concatenate([_as_real(half, twice=True), _as_real(np.stack([slope, noise]))])


def _as_real(matrix: np.ndarray, *, twice: bool = False) -> np.ndarray:
    """A Hermitian matrix as r^2 real numbers of the same norm; twice: of half of it, the sum with its adjoint."""
    r = matrix.shape[-1]
    a, b = _indices_above_diagonal(r)
    above = matrix[..., a, b] + matrix[..., b, a].conj() if twice else matrix[..., a, b]
    diagonal = np.einsum("...ii->...i", matrix).real * (2 if twice else 1)
    return np.concatenate([diagonal, np.sqrt(2) * above.real, np.sqrt(2) * above.imag], axis=-1)


def _move_state(band: _Band, state: _State, step: np.ndarray) -> _State:
    m, p = band.start.n_group, len(band.start.level)
    n_free = len(band.free[0])
    shape = state.shape.copy()
    shape[band.free] += step[2 * m: 2 * m + n_free]
    root = state.root.copy()
    root[np.diag_indices(p)] *= np.exp(np.clip(step[2 * m + n_free:][:p], -1, 1))
    real, imaginary = step[2 * m + n_free + p: -2].reshape(2, -1)
    root[band.below] += real + 1j * imaginary
    return _State(frequency=state.frequency * np.exp(step[:m] * state.damping),
                  damping=state.damping * np.exp(step[m: 2 * m]), shape=shape, root=root, slope=state.slope + step[-2],
                  noise=state.noise + float(np.clip(step[-1], -2, 2)))


def fit(spectrum: Spectrum, start: Start, parts: int, half_widths: float) -> GroupFit | None:
    """The group at the greatest likelihood in a band of so many half-power half-widths about it; None where the band is
    too short, no step leads anywhere, or a shape tells nothing (its information is singular)."""
    try:
        return _search(spectrum, start, parts, half_widths)
    except np.linalg.LinAlgError:
        return None


def _search(spectrum: Spectrum, start: Start, parts: int, half_widths: float) -> GroupFit | None:
    band = _band(spectrum, start, half_widths)
    m = start.n_group
    if len(band.first) < len(band.colour) + 4:
        return None
    state = _State(frequency=start.frequency_hz[:m], damping=start.damping_ratio[:m] + band.wider,
                   shape=np.eye(len(start.level)) if band.basis is start.shape else start.shape,
                   root=np.eye(len(start.level), dtype=complex), slope=0.0, noise=band.noise)
    now, converged = _fit_band(band, state), False
    if now is None:
        return None
    damped = 0.0
    for _ in range(STEPS):
        information, score = _information(band, now, _derivatives(band, state, now))
        for _ in range(TRIES):
            step = np.linalg.solve(information + np.diag(damped * np.diag(information)), score)
            step *= min(1.0, LONGEST / np.abs(step[: 2 * m]).max())
            there = _fit_band(band, tried := _move_state(band, state, step))
            if there is not None and there.deviance <= now.deviance:
                damped = damped / 10 if damped > 1e-3 else 0.0
                break
            damped = max(10 * damped, 0.01)
        else:
            break
        state, now, gain = tried, there, now.deviance - there.deviance
        if gain < ENOUGH and damped < 0.1:
            converged = True
            break
    return _result(band, state, now, converged, parts)


def _information(band: _Band, now: _FittedBand, derivative: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weighed = (derivative * np.sqrt(band.count)[:, None]).reshape(len(derivative), -1)
    information = weighed @ weighed.T
    score = weighed @ (_as_real(now.error) * np.sqrt(band.count)[:, None]).ravel()
    # the elements of S and the noise have a wide prior
    std = np.concatenate([np.full(len(now.prior) - 2, FORCE_STD), [SLOPE_STD, NOISE_STD]])
    at = np.arange(len(score) - len(std), len(score))
    information[at, at] += 1 / std**2
    score[at] -= now.prior / std
    return information, score


def _hermitian(real: np.ndarray, r: int) -> np.ndarray:
    """Back from `_real`."""
    a, b = _indices_above_diagonal(r)
    above = (real[..., r: r + len(a)] + 1j * real[..., r + len(a):]) / np.sqrt(2)
    matrix = np.zeros((*real.shape[:-1], r, r), complex)
    matrix[..., a, b], matrix[..., b, a] = above, above.conj()
    matrix[..., np.arange(r), np.arange(r)] = real[..., :r]
    return matrix


def _result(band: _Band, state: _State, now: _FittedBand, converged: bool, parts: int) -> GroupFit:
    m, r = band.start.n_group, len(band.colour)
    derivative = _derivatives(band, state, now)
    inverse = np.linalg.inv(_information(band, now, derivative)[0])
    row, column = band.free
    n_out = 2 * m + len(row)
    adjoint = now.white.conj().transpose(0, 2, 1)
    # estimates are quadratic forms of the lines, to first order: z^H N z
    form = adjoint @ _hermitian(np.tensordot(inverse[:n_out], derivative, axes=1), r) @ now.white
    bin_of_line = np.repeat(np.arange(len(band.first)), band.count.astype(int))
    moved = np.matmul(form[:, bin_of_line], band.coordinate[:, :, None])[..., 0]
    in_time = _InTime(len(band.line), parts)
    change = in_time.products(band.coordinate.T[None], moved.transpose(0, 2, 1)).sum(axis=1)
    in_plane = np.zeros((r, m, parts))
    in_plane[row, column] = change[2 * m:]
    shape, shape_change = band.basis @ state.shape[:, :m], np.tensordot(band.basis, in_plane, axes=1)
    if r < len(shape):
        # what the start's shapes lack: regression of what they leave on the modes' motion
        through = state.shape * now.h[:, None, :]
        motion = now.h[:, :, None] * (now.force @ through.conj().transpose(0, 2, 1)) @ adjoint @ now.white
        known = now.h[:, :, None] * now.force * now.h[:, None, :].conj()
        known -= motion @ state.shape @ known
        motion = (motion[bin_of_line] @ band.coordinate[:, :, None])[..., 0]
        second = np.einsum("k,kij->ij", band.count, known).real + (motion.T @ motion.conj()).real
        weighed = motion @ np.linalg.inv(second)[:, :m]
        outside = band.value - band.coordinate @ band.basis.T
        lacking = (outside.T @ weighed.conj()).real
        shape = shape + lacking
        outside = outside - motion[:, :m] @ lacking.T
        shape_change += in_time.products(weighed.T[None], outside.T[:, None])
    std = np.sqrt(np.diag(inverse)[: 2 * m])
    # the estimate of a decay rate is too large by its relative variance (1 / T for a single mode)
    scale = state.damping / (1 + std[m:] ** 2)
    wide = np.einsum("kij,kji->k", now.error, now.error).real
    return GroupFit(
        frequency_hz=state.frequency, damping_ratio=scale - band.wider, shape=shape,
        ln_frequency_std=std[:m] * state.damping, damping_std=std[m:] * scale,
        misfit=float(band.count @ wide / (len(wide) * r**2 - len(derivative))), converged=converged,
        ln_frequency=change[:m] * state.damping[:, None], damping=change[m: 2 * m] * scale[:, None],
        shape_change=shape_change)


class _InTime:
    """Sums over parts of the record of products of two band-limited signals, from their lines."""

    def __init__(self, n_line: int, parts: int):
        self.n_line, self.parts = n_line, parts
        self.size = fft.next_fast_len(max(2 * n_line, 8 * parts))
        self.edges = np.round(np.linspace(0, self.size, parts + 1)).astype(int)[:-1]

    def products(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Re sum conj(a) b, less the mean over parts, scaled as covariance factors: (..., n_part) of (..., n_line)."""
        one, other = fft.ifft(a, self.size, axis=-1), fft.ifft(b, self.size, axis=-1)
        sums = np.add.reduceat((one.conj() * other).real, self.edges, axis=-1) * self.size
        return (sums - sums.mean(axis=-1, keepdims=True)) * np.sqrt(self.parts / (self.parts - 1))
