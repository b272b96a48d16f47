"""What channels read of a mode: the motion of their place, and gravity through its tilt.

An accelerometer feels specific force. Along a unit vector d, at a place that moves by u and turns by theta (right-hand
rule, z up, small angles), it reads d . u'' - g theta . (z x d), in a mode of circular frequency w
-w^2 (d . u + g / w^2 theta . (z x d)): what a point g / w^2 above its own does. The mass of a velocity sensor feels the
same. A vertical channel has no term of first order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from probupdate.runtime.arrays import frozen_array

# standard gravity, where a model does not state its own
STANDARD_MPS2 = 9.80665


def rotation_reading(direction: np.ndarray) -> np.ndarray:
    """z x d (3,): what a channel along d reads of a rotation, times g / w^2."""
    return np.array([-direction[1], direction[0], 0.0])


@dataclass(frozen=True, eq=False, kw_only=True)
class FeltGravity:
    """`mps2`, the acceleration of gravity in the model's unit of length; `share` (n_channel,) of it that a channel's
    readings hold: 1, or 0 where it was taken out; `known` (n_channel,): whether the model has the rotation of the
    channel's place. `reversed_by`: numbers of parameters that make of a share what is stated the other way, at their
    value 1, each with the channels (n_channel,) it is of."""

    mps2: float
    share: np.ndarray
    known: np.ndarray
    reversed_by: tuple[tuple[int, np.ndarray], ...] = ()

    def with_gravity(self, felt: Mapping[str, bool], channels: Sequence[str]) -> FeltGravity:
        """With what is stated of some channels."""
        share = [float(felt.get(c, s)) for c, s in zip(channels, self.share, strict=True)]
        return replace(self, share=frozen_array(share))

    def evaluate(self, theta: np.ndarray) -> np.ndarray:
        """(..., n_channel) what of gravity's acceleration channels hold at theta (..., n_param)."""
        held = np.broadcast_to(self.share, (*theta.shape[:-1], len(self.share)))
        for column, own in self.reversed_by:
            held = held + theta[..., column, None] * own * (1 - 2 * self.share)
        return self.mps2 * held

    def slopes(self) -> list[tuple[int, np.ndarray]]:
        """Of `at` with each parameter it has: its number, and (n_channel,)."""
        return [(column, self.mps2 * own * (1 - 2 * self.share)) for column, own in self.reversed_by]


def channel_readings(seen: np.ndarray, value: np.ndarray, held: np.ndarray | None) -> np.ndarray:
    """(..., n_channel, n_mode) of `seen`, channels' motions and below them their tilts (..., 2 n_channel, n_mode), in
    modes of eigenvalues `value` (..., n_mode); held (..., n_channel). Without tilts (None) as it is."""
    if held is None:
        return seen
    n = held.shape[-1]
    # a motion that nothing holds, at zero, has no acceleration to be read
    inverse = np.divide(1.0, value, out=np.zeros_like(value, dtype=float), where=value > 0)
    return seen[..., :n, :] + held[..., :, None] * inverse[..., None, :] * seen[..., n:, :]


def reading_slopes(
    seen: np.ndarray, change: np.ndarray, value: np.ndarray, coupling: np.ndarray, held: np.ndarray | None,
) -> np.ndarray:
    """(n_channel, k, n_param) change of what is read of k modes as their motions and tilts `seen` (2 n_channel, k)
    change by `change` (2 n_channel, k, n_param), without the modes' rotation into each other, and what is left of
    Phi^T (dK - lambda dM) Phi between modes that are compared together by `coupling` (k, k, n_param).

    With Lambda the eigenvalues d(Phi / Lambda) = dPhi / Lambda - Phi C / (lambda_i lambda_j): the rotation of two modes
    into each other takes the reading of each along, and what their eigenvalues differ by stays finite.
    """
    if held is None:
        return change
    n = len(held)
    inverse = 1 / value
    tilt = change[n:] * inverse[None, :, None]
    tilt = tilt - np.einsum("ci,ijp->cjp", seen[n:] * inverse, coupling * inverse[None, :, None])
    return change[:n] + held[:, None, None] * tilt


def gravity_words(
    model: object, channels: Sequence[str], felt: Mapping[str, bool], lowest_hz: float, height_m: float | None
) -> str:
    """What is taken of gravity in the readings of these channels, to be said beside a result: `felt` as modal sets
    state it, the lowest frequency measured, and the model's height where it is known."""
    held, known = _channels_with_gravity(model, channels)
    words = []
    if known:
        source = "as the modal sets state" if felt else "as their quantities have it, which the modal sets do not state"
        words.append(f"in the readings of {len(held)} of {len(channels)} channels, {source}")
    lacking = lacking_words(model, channels, felt, lowest_hz, height_m)
    return "; ".join([*words, *lacking]) or "taken out of the readings, as the modal sets state"


def lacking_words(
    model: object, channels: Sequence[str], felt: Mapping[str, bool], lowest_hz: float, height_m: float | None
) -> list[str]:
    """A sentence on channels whose place has no rotation in the model, so that it reads their motion alone, and by how
    much that may be wrong."""
    _, known = _channels_with_gravity(model, channels)
    lacking = [c for c in channels if c not in known and felt.get(c, True)]
    if not lacking:
        return []
    length = tilt_length_m(lowest_hz)
    share = "" if not height_m else (f", {100 * length / height_m:.2g} % of it for a slope of one over the height of "
                                     f"{height_m:.3g} m")
    return [f"the model leaves it out at {len(lacking)} of {len(channels)} channels, where it has no rotations: a "
            f"horizontal accelerometer also reads g/w^2 = {length:.2g} m times the slope of the shape at "
            f"{lowest_hz:.3g} Hz{share}"]


def tilt_length_m(frequency_hz: float) -> float:
    """g / w^2."""
    return float(STANDARD_MPS2 / (2 * np.pi * frequency_hz) ** 2)


def _channels_with_gravity(model: object, channels: Sequence[str]) -> tuple[list[str], list[str]]:
    """Channels whose readings hold gravity, and those of which the model knows the tilt."""
    gravity: FeltGravity | None = getattr(model, "gravity", None)
    if gravity is None:
        return [], []
    number = {c: k for k, c in enumerate(getattr(model, "channels", ()))}
    known = [c for c in channels if c in number and gravity.known[number[c]]]
    return [c for c in known if gravity.share[number[c]] > 0.5], known
