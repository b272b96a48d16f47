"""Files that steps hand on, damaged: each is read, or one error names it; never another error or a warning."""

import h5py
import numpy as np
import pandas as pd
import pytest
from damage import damaged

from probupdate.errors import InputError, parsing
from probupdate.identification.block_poles import BlockFactors, BlockPoles
from probupdate.identification.block_store import (
    read_block_factors,
    read_block_poles,
    write_block_factors,
    write_block_poles,
)
from probupdate.identification.order_average import ModePoles
from probupdate.identification.ssi import Poles
from probupdate.modal.covariance_file import opened_factors, write_factors
from probupdate.modal.modes import CovarianceFactors
from probupdate.structure.load import load_model
from probupdate.updating.posterior_file import Posterior, read_posterior, write_posterior

RNG = np.random.default_rng(4)
SHAPE = RNG.standard_normal((6, 3)) + 1j * RNG.standard_normal((6, 3))


def block_poles(folder):
    poles = Poles(order=8, frequency_hz=np.array([0.3, 0.31, 1.3]), damping_ratio=np.full(3, 0.01), shape=SHAPE)
    write_block_poles(folder / "b.npz", BlockPoles(
        id="b", start=pd.Timestamp("2020-01-01T00:00Z"), minutes=30.0, quantity="acceleration", excluded="", notes=(),
        rms=0.01, poles=poles, others=(poles,), line_hz=np.linspace(0, 5, 40), spectrum=np.ones(40)), [])
    return folder / "b.npz", read_block_poles


def block_factors(folder):
    factors = CovarianceFactors(ln_frequency=np.ones((2, 3)), damping_ratio=np.ones((2, 3)),
                                shape=np.ones((4, 2, 3), complex))
    write_block_factors(folder / "b.npz", BlockFactors(
        key=((4, 0), (4, 1)), kurtosis=np.full(2, 2.0), poles=ModePoles(
            frequency_hz=np.ones(2), damping_ratio=np.full(2, 0.01), shape=np.ones((4, 2), complex), factors=factors)))
    return folder / "b.npz", read_block_factors


def _all_factors(path):
    with opened_factors(path.with_name("modes.json"), path.name) as found:
        return {set_id: found.read(set_id) for set_id in found.groups}


def deviations(folder):
    one = CovarianceFactors(ln_frequency=np.ones((3, 20)), damping_ratio=np.ones((3, 20)),
                            shape=np.ones((6, 3, 20), complex))
    name = write_factors({"one": one, "a/b": one}, folder / "modes.json")
    return folder / name, _all_factors


def matrices(folder):
    K = np.diag(np.full(6, 2.0)) - np.diag(np.ones(5), 1) - np.diag(np.ones(5), -1)
    np.savez(folder / "model.npz", K0=0 * K, M0=np.eye(6), K_k=100 * K, channel=np.array(list("abcdef")),
             channel_dof=np.arange(6))
    (folder / "model.toml").write_text('[[parameter]]\nname = "k"\nunit = "-"\ninitial = 1.0\ncov = 0.1\n')
    return folder / "model.npz", load_model


def posterior(folder):
    draws, one = RNG.standard_normal((4, 50, 2)), np.ones(1)
    found = Posterior(
        names=("k_t", "py"), theta=draws, log_likelihood=np.zeros((4, 50)), log_posterior=np.zeros((4, 50)),
        prior=draws[0], response_labels=("f",), measured=one, std=one, predicted=np.ones((3, 1)),
        frequency_hz=np.ones((3, 1)), mode_labels=("FA1",), r_hat=np.ones(2), ess=np.ones(2), converged=True,
        verdict="converged", fingerprint="")
    return write_posterior(found, folder / "posterior.nc"), read_posterior


@pytest.mark.parametrize("make", [block_poles, block_factors, deviations, matrices, posterior])
def test_a_damaged_file_is_read_or_named(make, tmp_path):
    path, read = make(tmp_path)
    read(path)
    whole, rng, refused = path.read_bytes(), np.random.default_rng(5), 0
    for number in range(60):
        path.write_bytes(damaged(whole, rng, number, head=3000))
        try:
            read(path)
        except InputError as error:
            assert path.name in str(error) and len(str(error).splitlines()) == 1
            refused += 1
    # one cut off is hardly ever whole
    assert refused >= 10


def test_an_error_without_words_is_told_by_its_kind():
    said = r"^a\.mat: is none \(ValueError: no reason given\); save it again$"
    with pytest.raises(InputError, match=said) as error, parsing("a.mat", "is none", "save it again"):
        raise ValueError
    assert isinstance(error.value.__cause__, ValueError)


def test_a_key_that_an_earlier_version_did_not_write_is_said_to_be_missing():
    said = r"^p\.nc: lacks something \(missing: 'parameters'\); sample again$"
    with pytest.raises(InputError, match=said), parsing("p.nc", "lacks something", "sample again"):
        raise KeyError("parameters")


@pytest.mark.parametrize("kind", [NameError, AssertionError, ImportError])
def test_a_defect_of_the_program_is_not_the_files(kind):
    with pytest.raises(kind), parsing("a.mat", "is none", "save it again"):
        raise kind("ours")


def test_an_error_of_ours_keeps_its_words():
    with pytest.raises(InputError, match="mine"), parsing("a.mat", "is none", "save it again"):
        raise InputError("mine", "is wrong", "correct it")


def test_factors_of_before_checksums_are_named_with_what_writes_them_anew(tmp_path):
    path, read = deviations(tmp_path)
    with h5py.File(path, "a") as file:
        for holder in (file, *file.values()):
            del holder.attrs["checksum"]
    with pytest.raises(InputError, match="deviations.h5: has no checksum.*earlier version.*`probupdate identify`"):
        read(path)
