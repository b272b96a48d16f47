"""The stated nacelle heading against the planes in which the turbine sways.

While the turbine runs, the thrust's turbulence pushes the first bending fore-aft and the rotor damps it there several
times as much as side-side. So the two principal planes of the response about the first pair turn with the nacelle, and
the one of the wider peak is fore-aft. Idling, neither is sure: waves decide, and the damping is much the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from probupdate.campaign.blocks import Block
from probupdate.campaign.gaps import zero_filled
from probupdate.campaign.mounting import LOWEST_HZ, is_upright
from probupdate.campaign.quantity import TO_ACCELERATION
from probupdate.campaign.sensor_findings import SIGMA, SensorFinding
from probupdate.modal.modes import Sensor
from probupdate.modal.sensor_places import sensors_by_height

# blocks whose rotor turns faster (rpm) and whose heading moves less (deg) are used, and so many are needed
SLOWEST_RPM, MOST_TURNED_DEG, FEWEST_BLOCKS = 4.0, 5.0, 5
# highest frequency kept of a block (Hz), and the band about the first pair
HIGHEST_HZ, BAND = 1.5, (0.8, 1.25)
# bins of the band over which planes are sought, and of those by which widths are compared
PLANE_BINS, WIDTH_BINS = 12, 30
# planes follow the nacelle if their directions agree so well (1: all alike), better than without the nacelle by so much
FOLLOWING, BETTER = 0.6, 0.1
# mounting, yaw vane and a wind that is not along the nacelle leave so much open (deg, one standard deviation)
LEAST_STD_DEG = 2.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Sway:
    """The top's horizontal acceleration in one block: heading_deg (compass), frequency_hz (n_line,), motion (n_line, 2)
    its Fourier coefficients along x and y."""

    id: str
    heading_deg: float
    frequency_hz: np.ndarray
    motion: np.ndarray


@dataclass(frozen=True, kw_only=True)
class HeadingOffset:
    """offset_deg: true heading less the stated one, -90 to 90 (which way along the axis is not known), std_deg its
    standard deviation; NaN where nothing could be estimated, and `why` says why. follows: how well the planes agree in
    the nacelle's frame, 0 to 1. wider: mean logarithm of fore-aft's width over side-side's and its standard deviation,
    after the offset. backwards: the planes follow the heading counted the other way round. either: fore-aft is not
    known from side-side, so that offset_deg (-45 to 45) may be 90 degrees more."""

    offset_deg: float
    std_deg: float
    blocks: int
    follows: float = float("nan")
    wider: tuple[float, float] = (float("nan"), float("nan"))
    backwards: bool = False
    either: bool = False
    why: str = ""


def block_sway(block: Block, sensors: Sequence[Sensor], usable: np.ndarray, conditions: Mapping) -> Sway | None:
    """What one block gives; None where the rotor stands, the nacelle turned, SCADA lacks either, or the structure is no
    tower. Sensors of the highest level that has two horizontal directions, oblique ones too."""
    heading = conditions.get("nacelle_heading_deg", np.nan)
    rpm = conditions.get("rotor_speed_rpm", np.nan)
    turned = conditions.get("nacelle_heading_deg_range", 0.0)
    if not (np.isfinite(heading) and rpm > SLOWEST_RPM and turned < MOST_TURNED_DEG and is_upright(tuple(sensors))):
        return None
    chosen = _top(sensors, usable)
    if chosen is None:
        return None
    rows, back = chosen
    data = block.data[:, rows]
    spectrum = fft.rfft(zero_filled(data) * np.hanning(len(data))[:, None], axis=0)
    frequency = fft.rfftfreq(len(data), 1 / block.sampling_rate_hz)
    kept = (frequency > LOWEST_HZ) & (frequency < HIGHEST_HZ)
    times = np.array([TO_ACCELERATION[sensors[i].quantity] for i in rows])
    motion = spectrum[kept] * (2j * np.pi * frequency[kept][:, None]) ** times @ back.T
    return Sway(id=block.id, heading_deg=float(heading), frequency_hz=frequency[kept].astype(np.float32),
                motion=motion.astype(np.complex64))


def _top(sensors: Sequence[Sensor], usable: np.ndarray) -> tuple[list[int], np.ndarray] | None:
    """Channels of the highest place that see both horizontal directions, and the matrix (2, n) that gives them."""
    for level in reversed(sensors_by_height(sensors)):
        rows = [i for i in level if usable[i]]
        flat = [i for i in rows if abs(sensors[i].direction[2]) < 0.05]
        # level sensors know nothing of the vertical; oblique ones need all three directions
        for some, n in ((flat, 2), (rows, 3)):
            plane = np.array([sensors[i].direction[:n] for i in some]).reshape(-1, n)
            if len(some) >= n and np.linalg.svd(plane, compute_uv=False)[-1] > 0.3:
                return some, np.linalg.pinv(plane)[:2]
    return None


def heading_offset(sways: Sequence[Sway], x_axis_heading_deg: float, lowest_hz: float) -> HeadingOffset:
    """The offset that makes the planes of all blocks principal: of the spectral matrix in the nacelle's frame, bin by
    bin about the first pair, the direction of the doubled difference angle, squared so that the larger plane may be
    either; then the plane of the wider peak is fore-aft. Standard deviations by leaving out blocks. Nothing is
    estimated where fewer than five blocks run, and where the planes do not agree in the nacelle's frame or agree as
    well without it. Where neither plane's peak is wider beyond four standard deviations an offset may be 90 degrees
    more, and none of 0 is estimated."""
    n = len(sways)
    nothing = {"offset_deg": float("nan"), "std_deg": float("nan"), "blocks": n}
    if n < FEWEST_BLOCKS:
        return HeadingOffset(**nothing, why=f"{n} blocks with a turning rotor and a steady heading, {FEWEST_BLOCKS} "
                             "needed")
    # counter-clockwise from x
    angle = np.radians([x_axis_heading_deg - s.heading_deg for s in sways])
    still = np.array([_plane(_band(s, lowest_hz)) for s in sways])
    follows = {sign: _agreement(still * np.exp(-4j * sign * angle)) for sign in (1, 0, -1)}
    best = max(follows[1], follows[-1])
    if best < FOLLOWING:
        return HeadingOffset(**nothing, follows=best, why="the planes of the first bending do not follow the nacelle")
    sign = -1 if follows[-1] > follows[1] + BETTER and follows[-1] > follows[0] + BETTER else 1
    turned = still * np.exp(-4j * sign * angle)
    offset, std = _mean_angle(turned)
    first = _widths(sways, sign * angle + offset, lowest_hz)
    spread = float(np.degrees(std))
    either = abs(first[0]) < SIGMA * first[1]
    if first[0] < 0 and not either:
        offset += np.pi / 2
        first = (-first[0], first[1])
    # a compass runs clockwise; an axis has no sense
    value = (float(-np.degrees(offset)) + 90.0) % 180.0 - 90.0
    if either and abs(value) < SIGMA * np.hypot(spread, LEAST_STD_DEG):
        return HeadingOffset(**nothing, follows=follows[sign], wider=first, why="neither plane of the first bending is "
                             "damped more than the other, so that 0 is not known from 90 deg")
    if follows[0] > follows[sign] - BETTER and abs(value) > SIGMA * np.hypot(spread, LEAST_STD_DEG):
        return HeadingOffset(**nothing, follows=follows[sign], wider=first, why="the nacelle hardly turned: planes "
                             f"{abs(value):.0f} deg off may be the structure's own")
    return HeadingOffset(offset_deg=value, std_deg=spread, blocks=n, follows=follows[sign], wider=first,
                         backwards=sign < 0, either=either)


def heading_findings(found: HeadingOffset) -> tuple[list[SensorFinding], str | None]:
    """The offset as a finding, where it is beyond four standard deviations (2 degrees of what no record shows among
    them), and a sentence on what was or was not found."""
    if not np.isfinite(found.offset_deg):
        return [], f"the nacelle's heading against the planes of bending: not identified, {found.why}"
    text = f"{found.offset_deg:+.1f} +- {found.std_deg:.1f} deg{' (or 90 more)' if found.either else ''}"
    wrong = abs(found.offset_deg) > SIGMA * np.hypot(found.std_deg, LEAST_STD_DEG)
    if not wrong and not found.backwards:
        return [], (f"the nacelle's stated heading agrees with the planes of bending within {text} ({found.blocks} "
                    "running blocks; 180 deg is not excluded)")
    what = "is counted the other way round than a compass, and " if found.backwards else ""
    return [SensorFinding(
        name="nacelle heading", channel="nacelle_heading_deg", size=found.offset_deg, std=found.std_deg, unit="deg",
        message=f"suspect: the nacelle's stated heading {what}{'is off' if wrong else 'agrees else'}: fore-aft lies "
        f"{text} from it by the planes of bending of {found.blocks} running blocks (180 deg is not excluded): check "
        "its zero, x_axis_heading_deg and the sensors' directions on site")], None


def _band(sway: Sway, lowest_hz: float) -> np.ndarray:
    low, high = (lowest_hz * b for b in BAND)
    return sway.motion[(sway.frequency_hz > low) & (sway.frequency_hz < high)].astype(complex)


def _bin_values(values: np.ndarray, n_bin: int) -> np.ndarray:
    n_bin = min(n_bin, len(values))
    return np.array([part.sum() for part in np.array_split(values, n_bin)])


def _plane(motion: np.ndarray) -> complex:
    """Weighted mean over bins of exp(4 i angle of the principal axis) about x; weight the square of anisotropy."""
    x, y = motion.T
    a = _bin_values(0.5 * (np.abs(x) ** 2 - np.abs(y) ** 2), PLANE_BINS)
    c = _bin_values((x.conj() * y).real, PLANE_BINS)
    total = float(np.sum(np.abs(motion) ** 2)) / 2
    return complex(np.sum(((a + 1j * c) / total) ** 2)) if total > 0 else 0j


def _agreement(values: np.ndarray) -> float:
    return float(np.abs(values.sum()) / max(float(np.abs(values).sum()), 1e-300))


def _mean_angle(values: np.ndarray) -> tuple[float, float]:
    total, n = values.sum(), len(values)
    apart = np.angle((total - values) / total) / 4
    return float(np.angle(total)) / 4, float(np.sqrt((n - 1) / n * np.sum((apart - apart.mean()) ** 2)))


def _widths(sways: Sequence[Sway], angle: np.ndarray, lowest_hz: float) -> tuple[float, float]:
    """Mean over the blocks, and its standard deviation, of the logarithm of the equivalent width (square of the sum
    over the sum of squares) of the spectrum along `angle`, over that across it."""
    found = []
    for sway, a in zip(sways, angle, strict=True):
        x, y = _band(sway, lowest_hz).T
        power = [_bin_values(np.abs(v) ** 2, WIDTH_BINS) for v in (np.cos(a) * x + np.sin(a) * y,
                                                                   np.cos(a) * y - np.sin(a) * x)]
        width = [float(p.sum() ** 2 / np.sum(p**2)) for p in power]
        found.append(np.log(width[0] / width[1]))
    return float(np.mean(found)), float(np.std(found, ddof=1) / np.sqrt(len(found)))
