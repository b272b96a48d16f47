"""Gains that change along the records: each channel against what all the others predict of it.

At every frequency a channel is predicted from the others by the regression of the whole campaign (Wiener filter). By
how much it follows that prediction, piece by piece, is its gain against its own mean: neither the level of vibration
nor positions or directions matter, only that motion is seen by more channels than it has parts. A change common to all
channels is not seen, nor one of a channel that the others do not predict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from probupdate.campaign.mounting import LOWEST_HZ, RIGID_UP_TO
from probupdate.campaign.rigid_bodies import groups_at_one_place
from probupdate.campaign.sensor_findings import OR_STRUCTURE, SIGMA, SensorFinding
from probupdate.campaign.spectra import (
    MOST_FREQUENCIES,
    SEGMENT_S,
    CrossSpectra,
    mean_products,
    per_hz,
    segment_lines,
    to_acceleration,
)
from probupdate.evidence.gains import ALIKE
from probupdate.modal.modes import Sensor

# fewest pieces in all, and on each side of a change; a piece is a block, or part of one where there are few
FEWEST_PIECES, FEWEST_BESIDE = 12, 4
# frequencies and bytes kept of a campaign's pieces
MOST_LINES, MOST_BYTES = 128, 96 * 2**20
# relative noise that every channel is given in the regression: no prediction rests on smaller differences
RIDGE = 1e-3
# a channel is judged where the others predict this share of it at some frequencies
PREDICTED = 0.3
# each frequency is a mean over dozens of segments: so much is beyond chance by far, and a turn makes it at one peak
TURNED = 3.0
MOST_STEPS, MOST_TRIED = 8, 4
# candidates whose residuals (sum of squared standard scores) are this close explain the records as well
AS_WELL = 9.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Piece:
    """Cross-spectra of one piece of the records: frequency_hz (n_line,), density (n_line, n_channel, n_channel) complex
    accelerations as in CrossSpectra, NaN for channels that were not whole; `id` says where it begins."""

    id: str
    frequency_hz: np.ndarray
    density: np.ndarray


def whole_piece(name: str, spectra: CrossSpectra, usable: np.ndarray, most_lines: int) -> Piece:
    """A block's own cross-spectra (of its usable channels), thinned to `most_lines`."""
    kept = np.flatnonzero(spectra.frequency_hz >= LOWEST_HZ)[:most_lines]
    density = np.full((len(kept), len(usable), len(usable)), np.nan, np.complex64)
    density[np.ix_(np.arange(len(kept)), usable, usable)] = spectra.density[kept]
    return Piece(id=name, frequency_hz=spectra.frequency_hz[kept], density=density)


def parts_of_block(
    name: str, data: np.ndarray, rate_hz: float, sensors: Sequence[Sensor], usable: np.ndarray, n_part: int,
    most_lines: int,
) -> list[Piece]:
    """The same of each of n_part parts of a block's data (n_sample, n_channel); segments as short as leaves three in a
    part. Empty where parts would be shorter than that allows."""
    part = len(data) // n_part
    length = 2 * (min(round(min(SEGMENT_S, MOST_FREQUENCIES / (0.4 * rate_hz)) * rate_hz), part // 2) // 2)
    if length < 64:
        return []
    frequency = fft.rfftfreq(length, 1 / rate_hz)
    kept = np.flatnonzero((frequency >= LOWEST_HZ) & (frequency <= 0.4 * rate_hz))[:most_lines]
    factor = to_acceleration(sensors, frequency[kept])[:, usable]
    found = []
    for k in range(n_part):
        lines = [own * factor for own in segment_lines(data[k * part: (k + 1) * part][:, usable], length, kept)]
        if not lines:
            continue
        density = np.full((len(kept), len(usable), len(usable)), np.nan, np.complex64)
        density[np.ix_(np.arange(len(kept)), usable, usable)] = mean_products(lines) * per_hz(length, rate_hz)
        seconds = k * part / rate_hz
        found.append(Piece(id=f"{name} + {seconds:.0f} s" if k else name, frequency_hz=frequency[kept],
                           density=density))
    return found


def number_of_lines(n_channel: int, n_piece: int) -> int:
    return int(np.clip(MOST_BYTES / (8 * max(n_piece, 1) * n_channel**2), 8, MOST_LINES))


@dataclass(frozen=True, kw_only=True)
class _Step:
    """A step of one series: `at` the first piece after it, difference of the means after and before, its standard
    deviation by the scatter about both (neighbours alike allowed for)."""

    at: int
    size: float
    std: float

    @property
    def score(self) -> float:
        return self.size / float(np.hypot(self.std, ALIKE))


# channel, first piece after it, factor, its standard deviation, channels that may have changed instead
_Change = tuple[int, int, float, float, tuple[int, ...]]


def gain_steps(
    pieces: Sequence[Piece], sensors: Sequence[Sensor], lowest_hz: float
) -> tuple[list[SensorFinding], str | None]:
    """Changes of gain along the records, and a sentence on what would have been seen (None: nothing could be judged).

    A change counts beyond four standard deviations of it, in which are the scatter of the series about both means and
    1 % that sound sensors and shapes may change by: 4 % is the least that is reported. The channel is the one whose
    change, undone, leaves least of all channels' changes; where another leaves as little it is an alternative. Channels
    that change together by one factor are one finding: their logger's. A change that lasts from a piece to another is
    found as two.
    """
    prepared = _scaled_densities(pieces, lowest_hz)
    if prepared is None:
        return [], None
    ids, density, known = prepared
    steps: list[_Change] = []
    place = groups_at_one_place([sensors[k] for k in known], range(len(known)))
    series, weight = _gains(density)
    able = np.all(np.isfinite(series), axis=0)
    judged = [int(c) for c in np.flatnonzero(able)]
    if not judged:
        return [], None
    least = 100 * SIGMA * np.hypot([_step(series[:, c], weight[:, c]).std for c in judged], ALIKE)
    while len(steps) < MOST_STEPS:
        every = {c: _step(series[:, c], weight[:, c]) for c in judged}
        order = sorted(every, key=lambda c: -abs(every[c].score))
        reversed_at = _reversal(density)
        if abs(every[order[0]].score) <= SIGMA and reversed_at is None:
            break
        tried = []
        if reversed_at is not None:
            c, at, factor = reversed_at
            tried = [_remove_steps(density, series, weight, (c,), at, factor)]
        for c in order[:MOST_TRIED] if not tried else ():
            if abs(every[c].score) > 0.5 * SIGMA:
                tried.append(_remove_steps(density, series, weight, (c,), every[c].at))
                # those of one place may have one logger
                tried += [_remove_steps(density, series, weight, g, every[c].at) for g in place
                          if c in g and able[list(g)].all() and not any(t[1] == g for t in tried)]
        tried = [t for t in tried if abs(t[3] - 1) > SIGMA * t[4]]
        if not tried:
            break
        # several channels are taken for one only where they leave clearly less
        tried.sort(key=lambda t: t[0] + AS_WELL * (len(t[1]) > 1))
        left, members, at, factor, std, density, series = tried[0]
        alternatives = tuple(known[t[1][0]] for t in tried[1:] if t[0] < left + AS_WELL and len(t[1]) == 1
                             and t[1][0] not in members)
        steps += [(known[c], at, factor, std, alternatives) for c in members]
    found = gain_step_findings(steps, ids, [s.channel for s in sensors])
    return found, (f"gains of {int(able.sum())} of {len(sensors)} channels followed over the record: a change shows "
                   f"from {least.min():.0f} % on"
                   f"{f', of the worst from {least.max():.0f} %' if least.max() > 1.5 * least.min() else ''}; "
                   "a gain wrong all along shows only against a model")


def parts_of_campaign(
    pieces: Sequence[Piece], lowest_hz: float, n_part: int = 4
) -> tuple[np.ndarray, np.ndarray] | None:
    """Mean cross-spectra (n_part, n_line, n, n) of parts of the campaign, every piece and line with one vote, and the
    channels (n,) that they hold; None where there are too few pieces."""
    prepared = _scaled_densities(pieces, lowest_hz)
    if prepared is None:
        return None
    _, density, known = prepared
    return np.array([part.mean(axis=0) for part in np.array_split(density, n_part)]), known


def _scaled_densities(
    pieces: Sequence[Piece], lowest_hz: float
) -> tuple[list[str], np.ndarray, np.ndarray] | None:
    """(ids, density (n_piece, n_line, n, n) scaled, channels): pieces of one length, whole in the channels that most
    pieces have; None where too few remain."""
    if len(pieces) < FEWEST_PIECES:
        return None
    usual = max({len(p.frequency_hz) for p in pieces}, key=lambda n: sum(len(p.frequency_hz) == n for p in pieces))
    pieces = [p for p in pieces if len(p.frequency_hz) == usual]
    power = np.array([np.einsum("fii->i", p.density).real for p in pieces])
    whole = np.isfinite(power) & (power > 0)
    known = np.flatnonzero(whole.mean(axis=0) > 0.8)
    pieces = [p for p, w in zip(pieces, whole[:, known], strict=True) if w.all()]
    frequency = pieces[0].frequency_hz if pieces else np.zeros(0)
    lines = (frequency > 0.5 * lowest_hz) & (frequency < RIGID_UP_TO * lowest_hz)
    if len(pieces) < FEWEST_PIECES or len(known) < 2 or lines.sum() < 4:
        return None
    density = np.array([p.density[lines][:, known][:, :, known] for p in pieces], complex)
    # every piece and frequency has one vote, whatever the weather was
    power = np.einsum("bfii->bfi", density).real
    power = np.exp(np.log(np.maximum(power, 1e-300)).mean(axis=2))
    return [p.id for p in pieces], density / power[:, :, None, None], known


def _regress_on_others(mean: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every channel by all others at one line, regressed on the mean (n, n): its own power (n,), and in every piece of
    density (n_piece, n, n) what it has in common with its prediction and the prediction's power (n_piece, n)."""
    own = np.real(mean.diagonal())
    scale = np.sqrt(np.maximum(own, 1e-300))
    inverse = np.linalg.inv(mean / np.outer(scale, scale) + RIDGE * np.eye(len(own)))
    # x_c = sum_j a_cj x_j, with density[i, j] the mean of conj(x_i) x_j
    a = -(inverse / inverse.diagonal()[:, None]).conj()
    np.fill_diagonal(a, 0)
    a = a / scale[None, :] * scale[:, None]
    product = a.conj() @ density
    return own, np.einsum("bcc->bc", product).real, np.einsum("bcj,cj->bc", product, a).real


def _gains(density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n_piece, n) gain of every channel over its mean, NaN where it is not predicted; and its weight, mean 1: one over
    the variance that what its piece leaves unexplained gives the gain (calm pieces are noise) and the typical one, as
    no piece is without error."""
    mean = density.mean(axis=0)
    n_line, n = mean.shape[:2]
    top, bottom, noise = np.zeros((3, len(density), n))
    best = np.zeros(n)
    for q in range(n_line):
        own, together, predicted = _regress_on_others(mean[q], density[:, q])
        left = np.einsum("bcc->bc", density[:, q]).real - 2 * together + predicted
        usual = left.mean(axis=0)
        best = np.maximum(best, 1 - usual / own)
        # with the regression as it is the gain of least squares: weighted by what is left unexplained
        weight = 1 / np.maximum(usual, RIDGE * own)
        top += weight * together
        bottom += weight * predicted
        noise += weight**2 * np.maximum(left, 0) * np.maximum(predicted, 0)
    gain = top / np.where(bottom > 0, bottom, 1.0)
    middle = gain.mean(axis=0)
    good = (best > PREDICTED) & (np.abs(middle) > 0.05)
    variance = noise / np.maximum(bottom, 1e-300) ** 2
    weight = 1 / (np.median(variance, axis=0) + variance + 1e-300)
    return np.where(good, gain / np.where(good, middle, 1.0), np.nan), weight / weight.mean(axis=0)


def _step(series: np.ndarray, weight: np.ndarray, at: int | None = None) -> _Step:
    """The step that leaves least of a series (n_piece,) with weights, or that at a given place, relative to the mean
    before it. Each side's mean is as uncertain as its own scatter says, or that of both where it is larger."""
    n = len(series)
    places = np.arange(FEWEST_BESIDE, n - FEWEST_BESIDE + 1) if at is None else np.array([at])
    total, moment = np.cumsum(weight), np.cumsum(weight * series)
    first, second = total[places - 1], total[-1] - total[places - 1]
    before, after = moment[places - 1] / first, (moment[-1] - moment[places - 1]) / second
    k = int(np.argmax(first * second * (after - before) ** 2))
    at = int(places[k])
    left = np.concatenate([series[:at] - before[k], series[at:] - after[k]]) * np.sqrt(weight)
    variance = float(left @ left) / (n - 2)
    # what lasts from piece to piece makes means less certain: an autoregression of the first order
    alike = float(left[1:] @ left[:-1]) / max(float(left @ left), 1e-300)
    alike = min(max(alike, 0.0), 0.9)
    spread = 0.0
    for own, weights in ((left[:at], weight[:at]), (left[at:], weight[at:])):
        m = len(own)
        # known as well as its number allows (the variance of Student's t)
        scatter = max(variance, float(own @ own) / (m - 3))
        spread += scatter / float(weights.sum())
    std = np.sqrt(spread * (1 + alike) / (1 - alike))
    base = before[k] if abs(before[k]) > 0.05 else 1.0
    return _Step(at=at, size=float((after[k] - before[k]) / abs(base)), std=float(std / abs(base)))


def _reversal(density: np.ndarray) -> tuple[int, int, float] | None:
    """(channel, piece, factor) from which on a channel goes against what it did: with the sign turned there the
    regression on the others leaves less of it, by TURNED in the logarithms over all frequencies, than without, its size
    evened out in both cases. Changes without a turn show in the series; a turn half-way leaves no regression to make a
    series by."""
    n_piece, n = len(density), density.shape[2]
    places = np.arange(FEWEST_BESIDE, n_piece - FEWEST_BESIDE + 1)
    mean = density.mean(axis=0)
    own = np.einsum("bfii->bfi", density).real
    power = (own / np.maximum(own.mean(axis=0), 1e-300)).mean(axis=1)
    before = np.cumsum(power, axis=0)[places - 1] / places[:, None]
    after = (power.sum(axis=0) - np.cumsum(power, axis=0)[places - 1]) / (n_piece - places)[:, None]
    size = np.sqrt(np.maximum(after, 1e-300) / np.maximum(before, 1e-300))
    left = np.zeros((2, len(places), n))
    for q in range(len(mean)):
        scale = np.sqrt(np.maximum(mean[q].diagonal().real, 1e-300))
        scaled = density[:, q] / np.outer(scale, scale)
        total = scaled.sum(axis=0)
        first = np.cumsum(scaled, axis=0)[places - 1]
        for c in range(n):
            others = np.delete(np.arange(n), c)
            inverse = np.linalg.inv(total[np.ix_(others, others)] / n_piece + RIDGE * np.eye(n - 1))
            even = (total[None] - first) / size[:, c, None, None]
            whole = (first[:, c, c] + even[:, c, c] / size[:, c]).real / n_piece
            for k, sign in enumerate((1.0, -1.0)):
                y = (first[:, others, c] + sign * even[:, others, c]) / n_piece
                share = np.sum(y.conj() * (y @ inverse.T), axis=1).real / np.maximum(whole, 1e-300)
                left[k, :, c] += np.log(np.maximum(1 - share, RIDGE))
    gained = left[0].min(axis=0) - left[1].min(axis=0)
    c = int(np.argmax(gained))
    k = int(np.argmin(left[1, :, c]))
    return (c, int(places[k]), -float(size[k, c])) if gained[c] > TURNED else None


def _remove_steps(
    density: np.ndarray, series: np.ndarray, weight: np.ndarray, members: tuple[int, ...], at: int, start: float = 1.0
):
    """(what is left of all channels' steps, members, at, factor, its standard deviation, density, series) with the gain
    of some channels taken back from piece `at` on by the factor that leaves their own series without a step there."""
    factor, more, now = 1.0, start, density
    for _ in range(8):
        if more != 1:
            factor *= more
            now = now.copy()
            for c in members:
                now[at:, :, c, :] /= more
                now[at:, :, :, c] /= more
            series, _ = _gains(now)
        size = float(np.mean([_step(series[:, c], weight[:, c], at).size for c in members]))
        if not abs(size) >= 0.05 * ALIKE or abs(1 + size) < 0.02:
            break
        more = 1 + size
    known = np.flatnonzero(np.isfinite(series).all(axis=0))
    scores = [_step(series[:, j], weight[:, j]).score for j in known]
    spread = [_step(series[:, c], weight[:, c], at).std for c in members]
    std = float(np.mean(spread)) if np.isfinite(spread).all() else np.inf
    left, error = float(np.sum(np.square(scores))), float(np.hypot(std, ALIKE) * abs(factor))
    return left, members, at, factor, error, now, series


def gain_step_findings(steps: Sequence[_Change], ids: Sequence[str], channels: Sequence[str]) -> list[SensorFinding]:
    """Steps at one place by one factor are one finding: those of channels with something in common."""
    found: list[SensorFinding] = []
    left = list(steps)
    while left:
        c, at, factor, std, alternatives = left[0]
        inverse = [channels[s[0]] for s in steps if abs(s[1] - at) <= 1 and s[0] != c
                   and abs(s[2] * factor - 1) < 3 * np.hypot(s[3] * factor, std * s[2])]
        group = [s for s in left if abs(s[1] - at) <= 1 and abs(s[2] - factor) < 2 * np.hypot(s[3], std)
                 and (s[0] != c or s is left[0])]
        left = [s for s in left if s not in group]
        names = [channels[k] for k in sorted(s[0] for s in group)]
        shared = [channels[r] for r in alternatives if all(r in s[4] for s in group)]
        others = tuple(r for r in shared if r not in names)
        size = float(np.mean([s[2] for s in group]))
        error = float(np.sqrt(np.mean([s[3] ** 2 for s in group])))
        who = ", ".join(names)
        common, exchanged = len(names) > 1, len(inverse) == 1 == len(names)
        # neither a sign nor an exchange is the structure's; any other gain alone cannot tell
        of_sensor = exchanged or size < 0
        message = (f"suspect: the gain of {who} changes {'together ' if common else ''}to {size:.3g} +- {error:.2g} "
                   f"times what it was, from {ids[at]} on"
                   + (f"; it may be {', '.join(others)} by the inverse instead" if others else "")
                   + (f"; that of {inverse[0]} by the inverse, as if the two were exchanged" if exchanged else "")
                   + f": look at {'their logger' if common else 'its cable, amplifier and range'} at that time"
                   + (", or leave it out (leave_out in campaign.toml)" if of_sensor else f"; {OR_STRUCTURE}"))
        one = SensorFinding(name="gain change", channel=who, size=size, std=error, since=ids[at], alternatives=others,
                            message=message)
        found.append(one if size > 0 else replace(one, message=message.replace("the gain of", "the sign or gain of")))
    return found
