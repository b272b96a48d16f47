"""Modes without a model, from made-up poles: what moves with the rotor is no mode; what was taken out is said."""

import numpy as np
import pandas as pd
import pytest

from probupdate.identification.block_poles import STAY, TAKEN_OUT, BlockPoles
from probupdate.identification.classification import ClassifierSettings
from probupdate.identification.identify import harmonics_removed
from probupdate.identification.ssi import Poles
from probupdate.identification.unlabelled import only, unlabelled_modes

MODES_HZ, N_BLOCK = (0.33, 1.25, 1.9), 30


def block(k: int, frequency, rng) -> BlockPoles:
    """Poles at these frequencies in five model orders, shapes unit vectors of twelve channels with a little noise."""
    def order(n):
        f = np.array(frequency) * (1 + 1e-3 * rng.standard_normal(len(frequency)))
        shape = np.eye(12)[:, : len(frequency)] + 0.02 * rng.standard_normal((12, len(frequency)))
        return Poles(order=n, frequency_hz=f, damping_ratio=np.full(len(f), 0.01), shape=shape.astype(complex))

    start = pd.Timestamp("2020-01-01T00:00Z") + pd.Timedelta(minutes=30 * k)
    return BlockPoles(id=f"b{k}", start=start, minutes=30.0, quantity="acceleration", excluded="", notes=(),
                      rms=0.01, poles=order(20), others=tuple(order(n) for n in (14, 16, 18, 22)),
                      line_hz=np.zeros(1), spectrum=np.zeros(1))  # fmt: skip


def record(speeds_rpm, seed=1):
    """Blocks with three modes and a line at 3P of each block's speed, and the bands that 1P, 3P swept."""
    rng = np.random.default_rng(seed)
    blocks = [block(k, (*MODES_HZ, 3 * rpm / 60), rng) for k, rpm in enumerate(speeds_rpm)]
    return blocks, swept(blocks, speeds_rpm)


def swept(blocks, speeds_rpm):
    bands = {b.id: np.outer([1, 3], [0.98 * rpm / 60, 1.02 * rpm / 60])
             for b, rpm in zip(blocks, speeds_rpm, strict=True)}  # fmt: skip
    return lambda b: bands[b.id]


def test_a_line_that_moves_with_the_rotor_is_left_out_and_said():
    # each speed holds in a third of the blocks, enough for its line to pass for a mode
    blocks, bands_of = record(np.tile([8.0, 10.0, 12.0], N_BLOCK // 3))
    blind, _ = unlabelled_modes(blocks, classifier=ClassifierSettings())
    assert len(blind.labels) == 6
    modes, said = unlabelled_modes(blocks, classifier=ClassifierSettings(), bands_of=bands_of)
    assert modes.frequency_hz == pytest.approx(MODES_HZ, rel=2e-3) and modes.labels == ("1", "2", "3")
    assert [t.split()[0] for t in said] == ["0.400", "0.500", "0.600"]
    assert all("moves with the rotor's speed" in t for t in said)


def test_a_mode_that_the_rotor_crosses_now_and_then_stays():
    # 3P passes 0.33 Hz at 6.6 rpm in a third of the blocks
    speeds = np.where(np.arange(N_BLOCK) % 3 == 0, 6.6, 12.0)
    rng = np.random.default_rng(5)
    blocks = [block(k, MODES_HZ, rng) for k in range(N_BLOCK)]
    modes, said = unlabelled_modes(blocks, classifier=ClassifierSettings(), bands_of=swept(blocks, speeds))
    assert modes.frequency_hz == pytest.approx(MODES_HZ, rel=2e-3) and said == ()


def test_at_a_constant_speed_a_line_is_kept_and_doubted():
    blocks, bands_of = record(np.full(N_BLOCK, 12.0))
    modes, said = unlabelled_modes(blocks, classifier=ClassifierSettings(), bands_of=bands_of)
    assert len(modes.labels) == 4
    (sentence,) = said
    assert sentence.startswith("0.600 Hz") and "may be its line" in sentence


def test_modes_left_after_a_choice_are_numbered_anew():
    blocks, _ = record(np.full(N_BLOCK, 12.0))
    modes, said = unlabelled_modes(blocks, classifier=ClassifierSettings())
    assert said == ()
    fewer = only(modes, np.array([0, 2]))
    assert fewer.labels == ("1", "2") and fewer.frequency_hz == pytest.approx(modes.frequency_hz[[0, 2]])


def test_what_became_of_harmonics_is_counted():
    notes = [f"{TAKEN_OUT}3P, 6P"] * 3 + [f"{TAKEN_OUT}3P"]
    notes += [f"{STAY}the rotor stood or idled: {rpm} rpm" for rpm in (0.3, 1)]
    assert harmonics_removed([*notes, "gaps of up to 1 s interpolated"]) == [
        "harmonics taken out in 4 of 6 blocks: 3P in 4, 6P in 3",
        "harmonics stay in 2 blocks: the rotor stood or idled"]  # fmt: skip
    assert harmonics_removed(["gaps"]) == []
