"""One block of a campaign to its poles: a pure function of the records and the settings; no model, no SCADA."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from probupdate.campaign.blocks import LONGEST_BREAK_S, Block, read_block
from probupdate.campaign.plausible import refuse_time
from probupdate.campaign.quantity import convert_quantity
from probupdate.campaign.reading import Campaign, RecordFile
from probupdate.errors import InputError
from probupdate.identification.free_decay import SAID, DecayRecord, decay_of
from probupdate.identification.harmonics import without_harmonics
from probupdate.identification.lost_samples import LossyRecord, WholeRecord, without_pairs
from probupdate.identification.order_average import ModePoles, averages, single_pole_key, twins
from probupdate.identification.preprocessing import PASS_SHARE, filter_reach, resample
from probupdate.identification.record import IdentifiedRecord, references_within
from probupdate.identification.refinement import refine_modes
from probupdate.identification.ssi import Poles
from probupdate.identification.steadiness import amplitude_kurtosis
from probupdate.modal.modes import Sensor
from probupdate.runtime.arrays import frozen_array

# samples after which a channel that moves has moved
FEW = 256


@dataclass(frozen=True, kw_only=True)
class BlockSettings:
    """What the poles of a block and their standard deviations depend on. order 20 and 5 Hz as the paper; 30 block rows
    of 0.2 s see two periods of a 0.3 Hz mode and more of the rest. Poles are kept of every second order up to `order` +
    `spread`. sub_records: parts of the record whose scatter gives standard deviations; 0 for none. harmonics: 'keep'
    the rotor's in the record, or 'remove' them where its angle can be followed (`harmonics.without_harmonics`)."""

    order: int = 20
    block_rows: int = 30
    target_rate_hz: float = 5.0
    spread: int = 16
    sub_records: int = 30
    harmonics: str = "keep"

    def __post_init__(self):
        if self.harmonics not in ("keep", "remove"):
            raise InputError("harmonics", f"'{self.harmonics}' is unknown", "choose keep or remove")
        for name, least in (("order", 2), ("block_rows", 2), ("spread", 0), ("sub_records", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                raise InputError(name, f"{value!r} is not a whole number from {least}", "give one")
        if self.sub_records == 1:
            raise InputError("sub_records", "one part has no scatter", "give 2 or more, such as 30, or 0 for none")
        if not 0 < self.target_rate_hz < np.inf:
            raise InputError("target rate", f"{self.target_rate_hz} Hz is not positive", "give one, such as 5")


# a block's note on the rotor's harmonics begins with one of these
TAKEN_OUT, STAY = "harmonics taken out: ", "harmonics stay: "
BRIDGED = "lines over gaps: the rotor's angle and what is taken out with it were estimated with straight lines there"


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockPoles:
    """What is kept of a block. poles: those of the chosen order; others: of the other orders, ascending; both empty
    where the block was excluded, with the reason in `excluded`.

    rms: root mean square over samples and channels of the motion about its mean, in SI units of `quantity`; line_hz
    and spectrum (n_line,): one-sided power spectral density summed over channels, at the rate of identification;
    singular (n_value, n_line): the largest singular values of the spectral matrix, in its unit; (0, 0) where they were
    not kept. unmeasured (3, n_channel): shares of samples that are lost, repeated and filled (`Block`); (3, 0) where
    not known.
    """

    id: str
    start: pd.Timestamp
    minutes: float
    quantity: str
    excluded: str
    notes: tuple[str, ...]
    rms: float
    poles: Poles | None
    others: tuple[Poles, ...]
    line_hz: np.ndarray
    spectrum: np.ndarray
    unmeasured: np.ndarray = field(default_factory=lambda: frozen_array(np.zeros((3, 0))))
    singular: np.ndarray = field(default_factory=lambda: frozen_array(np.zeros((0, 0))))

    @property
    def every_order(self) -> tuple[Poles, ...]:
        """`poles` and `others`; none of an excluded block."""
        return () if self.poles is None else (self.poles, *self.others)


# of a block whose poles and spectra are not kept in memory
WITHOUT_ARRAYS: Mapping[str, Any] = MappingProxyType({
    "poles": None, "others": (), "line_hz": frozen_array(np.zeros(0)), "spectrum": frozen_array(np.zeros(0)),
    "singular": frozen_array(np.zeros((0, 0)))})


def common_quantity(sensors: tuple[Sensor, ...]) -> str:
    """The quantity that all channels measure; acceleration where they measure several, and are converted."""
    found = {s.quantity for s in sensors}
    return found.pop() if len(found) == 1 else "acceleration"


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockFactors:
    """Some poles of a block averaged over model orders (`order_average`), with covariance factors: `key` names them by
    the chosen pole's model order and index within the order's poles; kurtosis (n_pole,) of their amplitudes
    (`steadiness`), NaN where samples are lost; by_likelihood (n_pole,) bool: those that `refinement` replaced."""

    key: tuple[tuple[int, int], ...]
    poles: ModePoles
    kurtosis: np.ndarray
    by_likelihood: np.ndarray = field(default_factory=lambda: frozen_array(np.zeros(0, bool), bool))

    @property
    def std(self) -> dict[tuple[int, int], tuple[float, float]]:
        """(model order, index) of each pole -> standard deviations of its frequency (Hz) and damping ratio."""
        of_ln, of_damping = (np.linalg.norm(f, axis=1) for f in (self.poles.factors.ln_frequency,
                                                                 self.poles.factors.damping_ratio))
        return {(order, single_pole_key(k) if k < 0 else k): (float(s * f), float(z)) for (order, k), f, s, z in zip(
            self.key, self.poles.frequency_hz, of_ln, of_damping, strict=True)}


def identify_block(
    campaign: Campaign, start: pd.Timestamp, files: tuple[RecordFile, ...], settings: BlockSettings,
    rotor_rpm: tuple[float, float] | None = None,
) -> BlockPoles:
    """Read, convert, thin out and identify one block; `files` from `block_files`, rotor_rpm the lowest and highest
    rotor speed in it by SCADA, which removing harmonics needs."""
    block, reason = usable_block(campaign, start, files)
    quantity = common_quantity(campaign.sensors)
    if reason:
        return _skipped_block(block, quantity, reason)
    variance = np.var if (block.measured == 1).all() else np.nanvar
    rms = float(np.sqrt(np.mean(variance(block.data, axis=0))))
    record, remark = _prepare_record(block, campaign, settings, rotor_rpm)
    found = _identify_record(record, block, settings, sub_records=0)
    line, spectrum = record.summed_spectrum()
    _, singular = record.singular_spectrum()
    return BlockPoles(
        id=block.id, start=block.start, minutes=block.minutes, quantity=quantity, excluded="",
        notes=(*block.notes, *remark), rms=rms, poles=found.poles,
        others=tuple(p for p in found.by_order if p.order != settings.order),
        line_hz=line, spectrum=spectrum, singular=singular,
        unmeasured=frozen_array([block.missing, block.repeated, block.filled]),
    )


def identify_factors(
    campaign: Campaign, start: pd.Timestamp, files: tuple[RecordFile, ...], settings: BlockSettings,
    rotor_rpm: tuple[float, float] | None, known: BlockPoles, keys: tuple[tuple[int, int], ...],
) -> BlockFactors:
    """The poles `keys` (model order, index) of a block whose poles are known, averaged over orders and then at the
    greatest likelihood of the block's spectra (`refinement`), with their covariance factors.

    The record is read once more: only poles that stand for modes are worth the time, and which ones do is known when
    the whole campaign is.
    """
    block, reason = usable_block(campaign, start, files)
    if reason:
        raise InputError(f"block {block.id}", f"cannot be used any more: {reason}", "do not change records meanwhile")
    record, _ = _prepare_record(block, campaign, settings, rotor_rpm)
    alike = [twins(known.every_order, *key) for key in keys]
    asked = tuple(sorted({order for some in alike for order, _ in some}))
    found = _identify_record(record, block, settings, sub_records=settings.sub_records, orders=asked)
    before, now = ({p.order: p for p in some} for some in (known.every_order, found.by_order))
    again = [[(n, _find_same_pole(before[n], k, now[n], block.id)) for n, k in some] for some in alike]
    poles = averages(found, again)
    whole = None if isinstance(record, DecayRecord) else record.whole
    by_likelihood = np.zeros(len(keys), bool)
    if whole is not None:
        thinned = settings.target_rate_hz < block.sampling_rate_hz * (1 - 1e-9)
        poles, by_likelihood = refine_modes(
            whole.data, whole.target_hz, poles, quantity=common_quantity(campaign.sensors),
            highest_hz=(PASS_SHARE if thinned else 1.0) * whole.target_hz / 2,
            fixed=np.array([k < 0 for _, k in keys]))
    return BlockFactors(key=keys, poles=poles, by_likelihood=by_likelihood, kurtosis=frozen_array(amplitude_kurtosis(
        whole.data, whole.target_hz, poles.frequency_hz, poles.damping_ratio, poles.shape)
        if whole is not None else np.full(len(keys), np.nan)))


def _find_same_pole(before: Poles, index: int, now: Poles, where: str) -> int:
    f, zeta = before.frequency_hz[index], before.damping_ratio[index]
    found = find_same_pole(now, f, zeta)
    if found is None:
        raise InputError(f"block {where}", f"a pole at {f:.4g} Hz differs when the record is read again: it was "
                         "changed meanwhile, or its channels are exact copies of one another",
                         "do not change records meanwhile, and leave out channels that copy others (leave_out in "
                         "campaign.toml)")
    return found


def find_same_pole(poles: Poles, frequency_hz: float, damping_ratio: float) -> int | None:
    """The pole of these values among those of another pass over the same record, which differ by rounding."""
    away = np.abs(poles.frequency_hz / frequency_hz - 1) + np.abs(poles.damping_ratio - damping_ratio)
    return int(np.argmin(away)) if np.min(away, initial=1.0) < 1e-4 else None


def usable_block(campaign: Campaign, start: pd.Timestamp, files: tuple[RecordFile, ...]) -> tuple[Block, str]:
    """The block in one quantity, and why it cannot be used; empty where it can."""
    block = read_block(campaign, start, files)
    refuse_time(f"{campaign.path}, block {block.id}", campaign.channels, block.data)
    if reason := block.excluded or _silent_channels(block, campaign.channels):
        return block, reason
    block = convert_quantity(block, campaign.sensors, common_quantity(campaign.sensors))
    gone = [c for c, lost in zip(campaign.channels, np.isnan(block.data[0]), strict=True)
            if lost and np.isnan(block.data[:, campaign.channels.index(c)]).all()]
    if gone:
        return block, f"gaps of more than {LONGEST_BREAK_S:g} s in {', '.join(gone)}, which no conversion bridges"
    if (block.measured == 1).all():
        return block, ""
    return block, without_pairs(np.isfinite(block.data), block.repeated, block.sampling_rate_hz)


def _prepare_record(
    block: Block, campaign: Campaign, settings: BlockSettings, rotor_rpm: tuple[float, float] | None
) -> tuple[WholeRecord | LossyRecord | DecayRecord, tuple[str, ...]]:
    """The record as it is identified, without harmonics if so asked, and what was done about them."""
    rate, target = campaign.sampling_rate_hz, settings.target_rate_hz
    whole = (block.measured == 1).all() or np.isfinite(block.data).all()
    lossy = None if whole else LossyRecord(data=block.data, rate_hz=rate, target_hz=target)
    record = WholeRecord(data=resample(block.data, rate, target), target_hz=target) if lossy is None else lossy
    if lossy is None and (decay := decay_of(record, edge=filter_reach(rate, target), order=settings.order,
                                            block_rows=settings.block_rows)):
        return decay, (SAID,)
    if settings.harmonics == "keep":
        return record, ()
    thin = record.data if lossy is None else lossy.interpolate_gaps()
    cleaned = without_harmonics(thin, target, rotor_rpm or (np.nan, np.nan))
    if not cleaned.followed:
        return record, (f"{STAY}{cleaned.reason}",)
    said = f"{TAKEN_OUT}{', '.join(f'{n}P' for n in cleaned.removed)}"
    if lossy is None:
        return WholeRecord(data=cleaned.record, target_hz=target), (said,)
    return lossy.without_part(thin - cleaned.record), (said, BRIDGED)


def _identify_record(
    record: WholeRecord | LossyRecord | DecayRecord, block: Block, settings: BlockSettings, sub_records: int,
    orders: tuple[int, ...] | None = None,
) -> IdentifiedRecord:
    n_sample = int(block.minutes * 60 * settings.target_rate_hz)
    if n_sample < 4 * settings.block_rows:
        raise InputError(f"block {block.id}", f"{n_sample} samples at {settings.target_rate_hz:g} Hz are less than "
                         f"four times {settings.block_rows} block rows", "give longer blocks or fewer block rows")
    return record.identify(
        order=settings.order if orders is None else orders[-1], block_rows=settings.block_rows, spread=settings.spread,
        sub_records=sub_records, orders=orders, limited=block_references(block.data.shape[1], settings))


def block_references(n_channel: int, settings: BlockSettings) -> int | None:
    """Of how many combinations of channels the past is taken, so that memory holds a block; None for all. The same
    with and without standard deviations, so that poles are found again."""
    return references_within(n_channel, block_rows=settings.block_rows, highest_order=settings.order + settings.spread,
                             sub_records=settings.sub_records)


def _silent_channels(block: Block, channels: tuple[str, ...]) -> str:
    # most move within a few samples
    still = [c for k, c in enumerate(channels) if _level(block.data[:FEW, k]) and _level(block.data[:, k])]
    return f"no signal in {', '.join(still)}" if still else ""


def _level(column: np.ndarray) -> bool:
    known = column[np.isfinite(column)]
    return len(known) == 0 or bool(known.min() == known.max())


def _skipped_block(block: Block, quantity: str, reason: str) -> BlockPoles:
    nothing = frozen_array(np.zeros(0))
    return BlockPoles(
        id=block.id, start=block.start, minutes=block.minutes, quantity=quantity, excluded=reason, notes=block.notes,
        rms=np.nan, poles=None, others=(), line_hz=nothing, spectrum=nothing,
        unmeasured=frozen_array([block.missing, block.repeated, block.filled]),
    )
