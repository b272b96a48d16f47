"""One exchange of channels, or one reversed, that makes measured shapes the model's: found, and nothing where all is
right."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from updating_cases import CHAIN_TRUTH, CHANNELS, chain_model, measured_chain

from probupdate.modal.channel_mistakes import ComputedModes, channel_mistake
from probupdate.modal.modes import ModalData

MODEL = chain_model()


def changed(data: ModalData, i: int, j: int) -> ModalData:
    """Channels i and j exchanged, or i reversed where they are one."""
    shape = np.array(data.sets[0].shape)
    if i == j:
        shape[i] *= -1
    else:
        shape[[i, j]] = shape[[j, i]]
    return replace(data, sets=(replace(data.sets[0], shape=shape),))


def found(data: ModalData, theta=MODEL.parameters.initial):
    rows = [MODEL.channels.index(c) for c in data.channels]
    solved = MODEL.solve(theta, 8)
    return channel_mistake(data.sets[0], data.channels, [
        ComputedModes(shape=solved.shape[rows], frequency_hz=solved.frequency_hz)])


@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_said_of_channels_that_are_right(seed):
    assert found(measured_chain(noise=0.004, seed=seed)) is None
    assert found(measured_chain(CHAIN_TRUTH * 1.5, noise=0.01, seed=seed)) is None


def test_every_exchange_and_reversal_that_shows_is_found_or_not_named(validation):
    row = validation(what="every exchange and reversal of ten channels of a two-way chain: named, and rightly",
                     reference="what was done")
    data, named, hidden = measured_chain(noise=0.003, seed=2), 0, []
    for i, j in [*((k, k) for k in range(len(CHANNELS))), *combinations(range(len(CHANNELS)), 2)]:
        mistake, wanted = found(changed(data, i, j)), tuple(dict.fromkeys((CHANNELS[i], CHANNELS[j])))
        if mistake is None:
            hidden.append(wanted)
            continue
        named += 1
        assert wanted in mistake.candidates, (wanted, mistake)
        assert mistake.mac_after > max(0.97, mistake.mac_before)
    # neighbours of one direction move nearly alike: their exchange is no misfit
    row.count(named, 55, least=40)
    assert all(len(w) == 2 and w[0][0] == w[1][0] for w in hidden) or len(hidden) < 16, hidden


def test_a_model_far_off_does_not_hide_a_reversed_channel(validation):
    """Two models whose shapes agree by a MAC of 0.86 and 0.85 only once the channel is put right."""
    row = validation(what="each of ten channels reversed, model's stiffness off by factors of 2 to 3, MAC 0.65 to 0.85",
                     reference="what was done")
    right, wrong = 0, 0
    for theta in ([1, 0.35, 1, 0.03], [1.5, 0.5, 1, 0.05]):
        data = measured_chain(noise=0.003, seed=1, n_mode=6)
        assert found(data, theta) is None
        for i, channel in enumerate(CHANNELS):
            mistake = found(changed(data, i, i), theta)
            right += mistake is not None and mistake.candidates == ((channel,),)
            wrong += mistake is not None and (channel,) not in mistake.candidates
    row.count(right, 20, least=18)
    assert wrong == 0


def test_shapes_of_another_structure_are_not_explained():
    rng = np.random.default_rng(1)
    data = measured_chain()
    other = replace(data.sets[0], shape=rng.standard_normal(data.sets[0].shape.shape))
    assert found(replace(data, sets=(other,))) is None


def test_channels_in_another_order_are_put_in_the_order_that_fits(validation):
    row = validation(what="order of ten channels drawn at random: the names in the order in which they fit",
                     reference="what was done")
    right = 0
    for seed in range(20):
        data = measured_chain(noise=0.003, seed=seed)
        order = np.random.default_rng(seed).permutation(len(CHANNELS))
        shape = data.sets[0].shape[order]
        mistake = found(replace(data, sets=(replace(data.sets[0], shape=shape),)))
        right += mistake is not None and mistake.candidates[0] == tuple(CHANNELS[k] for k in order)
    row.count(right, 20, least=18)
