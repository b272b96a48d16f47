"""Many channels: identified from fewer references within the memory allowed, or refused with the bytes."""

import tracemalloc

import numpy as np
import pytest
from scipy import signal

from probupdate.errors import InputError
from probupdate.identification.block_poles import BlockSettings, block_references
from probupdate.identification.record import identify_record, memory_bytes, references_within
from probupdate.modal.modes import mac

OPTIONS = {"block_rows": 12, "highest_order": 18, "sub_records": 8}


def record(n_channel: int, n_sample: int = 6000):
    """Three modes at 0.2, 0.31, 0.55 of the rate's half, with their shapes (n_channel, 3)."""
    rng = np.random.default_rng(2)
    motion = np.stack([signal.lfilter([1], [1, -2 * 0.985 * np.cos(w), 0.985**2], rng.standard_normal(n_sample))
                       for w in (0.63, 0.97, 1.73)])
    shape = np.stack([np.sin((k + 0.5) * np.pi * np.linspace(0.05, 1, n_channel)) for k in range(3)], axis=1)
    return (shape @ motion).T + 0.3 * rng.standard_normal((n_sample, n_channel)), shape


def test_fewer_references_give_the_same_modes(validation):
    row = validation(what="five combinations of 40 channels as references", reference="all of them")
    data, shape = record(40)
    whole = identify_record(data, 2.0, order=8, block_rows=12, spread=4, sub_records=8)
    few = identify_record(data, 2.0, order=8, block_rows=12, spread=4, sub_records=8, limited=5)
    for f in np.array([0.63, 0.97, 1.73]) / np.pi:
        k, j = (int(np.argmin(np.abs(x.poles.frequency_hz - f))) for x in (whole, few))
        row.error(few.poles.frequency_hz[j] / whole.poles.frequency_hz[k] - 1, below=3e-3, of="f")
        row.least(max(mac(few.poles.shape[:, [j]], shape)[0]), above=0.999, of="MAC")
        std = [np.linalg.norm(x.factors(np.array([i])).ln_frequency) for x, i in ((whole, k), (few, j))]
        row.error(std[1] / std[0] - 1, below=0.35, of="standard deviation")


def test_the_bytes_stated_are_those_taken(validation):
    row = validation(what="bytes taken over those that an identification states", reference="1, the record aside")
    data, _ = record(60)
    for limited in (None, 8):
        tracemalloc.start()
        identify_record(data, 2.0, order=12, block_rows=20, spread=6, sub_records=20, limited=limited)
        taken = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        stated = memory_bytes(60, limited or 60, block_rows=20, highest_order=18, sub_records=20)
        # the record itself is transformed in parts beside it
        row.least(taken / stated, above=0.4, of="all")
        row.error(max(taken - 12 * data.nbytes, 0) / stated, below=1, of="without the record")


def test_references_fit_the_budget_and_few_channels_keep_all():
    assert references_within(18, block_rows=30, highest_order=36, sub_records=30) is None
    few = references_within(60, budget=50e6, **OPTIONS)
    assert few is None or memory_bytes(60, few, **OPTIONS) <= 50e6
    few = references_within(60, budget=1e7, **OPTIONS)
    assert 4 <= few < 60 and memory_bytes(60, few, **OPTIONS) <= 1e7
    assert block_references(500, BlockSettings()) >= 4


def test_what_does_not_fit_is_refused_with_its_bytes():
    with pytest.raises(InputError,
                       match=r"2000 channels .* would take 2\.\d GB of memory with 4 references, .* with all"):
        block_references(2000, BlockSettings())
