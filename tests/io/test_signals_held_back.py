"""A signal in the midst of an HDF5 file, which the library would make another error of: the file first, then the
signal."""

import os
import signal

import h5py
import numpy as np
import pytest

from probupdate.cli.process import InterruptedBySignal, ended_by_signals
from probupdate.io.hdf5_file import new_hdf5
from probupdate.runtime.signals import ENDING, hold_back_signals


@pytest.fixture(autouse=True)
def ctrl_c_is_heard():
    """A shell starts what runs in its background with Ctrl-C ignored, and so do these tests then: as from a
    terminal."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("number", ENDING)
def test_a_file_that_is_being_written_is_finished_first(tmp_path, number):
    with pytest.raises(InterruptedBySignal), ended_by_signals(), new_hdf5(tmp_path / "a.h5") as file:
        os.kill(os.getpid(), number)
        file["data"] = np.arange(3.0)
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["data"][:].tolist() == [0.0, 1.0, 2.0]
    assert not list(tmp_path.glob("*.part"))


def test_another_error_that_a_signal_became_is_the_signal_s():
    with pytest.raises(InterruptedBySignal), ended_by_signals():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        except KeyboardInterrupt:
            raise SystemError("a library's own words") from None


def test_an_error_without_a_signal_stays_what_it_is():
    with pytest.raises(ValueError, match="own"), ended_by_signals():
        raise ValueError("own")


def test_nothing_is_held_back_after_the_block():
    came = []
    before = signal.signal(signal.SIGTERM, lambda *_: came.append(1))
    try:
        with hold_back_signals():
            os.kill(os.getpid(), signal.SIGTERM)
            assert not came
        assert came == [1]
        os.kill(os.getpid(), signal.SIGTERM)
        assert came == [1, 1]
    finally:
        signal.signal(signal.SIGTERM, before)
