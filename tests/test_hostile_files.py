"""Files made to lead a reader astray: out of their folder, into waiting, or to more memory than there is."""

import json
import os

import h5py
import numpy as np
import pytest

from probupdate.campaign.name_pattern import name_pattern
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.scada import read_scada
from probupdate.errors import InputError
from probupdate.io import files
from probupdate.io.hdf5_file import open_hdf5
from probupdate.modal.covariance_file import opened_factors, write_factors
from probupdate.modal.modes import CovarianceFactors, read_modes

N = 3000


@pytest.fixture
def campaign(tmp_path):
    folder = tmp_path / "campaign"
    (folder / "acceleration").mkdir(parents=True)
    text = 'name = "a"\nsampling_rate_hz = 5.0\nblock_minutes = 10\n'
    for k, axis in enumerate("xy"):
        direction = [1.0 - k, float(k), 0.0]
        text += (f'[[sensor]]\nchannel = "T-{axis}"\nlevel = "T"\n'
                 f'position_m = [0.0, 0.0, 80.0]\ndirection = {direction}\n')
    (folder / "campaign.toml").write_text(text)
    with h5py.File(folder / "acceleration" / "a.h5", "w") as file:
        attributes(file.create_dataset("data", data=np.ones((N, 2), np.float32)))
    return folder


def attributes(data):
    data.attrs["start"], data.attrs["sampling_rate_hz"] = "2020-01-01T00:00:00Z", 5.0


def rewritten(campaign):
    path = campaign / "acceleration" / "a.h5"
    path.unlink()
    return h5py.File(path, "w")


def test_a_campaign_of_its_own_files_is_read(campaign):
    assert read_campaign(campaign).files[0].n_sample == N


def test_samples_in_another_file_are_refused(campaign, tmp_path):
    (tmp_path / "secret").write_bytes(bytes(8 * N))
    with rewritten(campaign) as file:
        attributes(file.create_dataset("data", (N, 2), np.float32, external=[(str(tmp_path / "secret"), 0, 8 * N)]))
    with pytest.raises(InputError, match=r"a\.h5: .*'data' keeps its numbers in another file"):
        read_campaign(campaign)


def test_a_virtual_dataset_is_refused(campaign, tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = np.ones((N, 2), np.float32)
    layout = h5py.VirtualLayout((N, 2), np.float32)
    layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "data", (N, 2))
    with rewritten(campaign) as file:
        attributes(file.create_virtual_dataset("data", layout))
    with pytest.raises(InputError, match="put together from other files"):
        read_campaign(campaign)


def test_a_link_into_another_file_is_refused(campaign, tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        attributes(file.create_dataset("data", data=np.ones((N, 2), np.float32)))
    with rewritten(campaign) as file:
        file["data"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "data")
    with pytest.raises(InputError, match="link 'data' leads to another file"):
        read_campaign(campaign)


def test_samples_that_were_never_written_are_refused(campaign):
    with rewritten(campaign) as file:
        attributes(file.create_dataset("data", (10**9, 2), np.float32, chunks=(1000, 2)))
    assert (campaign / "acceleration" / "a.h5").stat().st_size < 20_000
    with pytest.raises(InputError, match="declares 1000000000 samples, but holds only 0 of 1000000 chunks"):
        read_campaign(campaign)


def test_a_chunk_too_large_to_unpack_is_refused(campaign):
    with rewritten(campaign) as file:
        attributes(file.create_dataset("data", (10**8, 2), np.float32, chunks=(10**8, 2), compression="gzip"))
    with pytest.raises(InputError, match="has chunks of 762 MB"):
        read_campaign(campaign)


@pytest.mark.parametrize("name", ["scada.csv", "campaign.toml", "acceleration/a.h5", "acceleration"])
def test_links_out_of_a_campaign_are_refused(campaign, tmp_path, name):
    (campaign / "scada.csv").write_text("time\n2020-01-01T00:00Z\n")
    outside = tmp_path / "outside"
    (campaign / name).rename(outside)
    (campaign / name).symlink_to(outside)
    with pytest.raises(InputError, match="leads out of .* by a link"):
        read_campaign(campaign)


def test_deviations_behind_a_link_are_refused(tmp_path):
    one = CovarianceFactors(ln_frequency=np.ones((1, 4)), damping_ratio=np.ones((1, 4)), shape=np.ones((2, 1, 4)))
    (tmp_path / "in").mkdir()
    name = write_factors({"a": one}, tmp_path / "modes.json")
    (tmp_path / "in" / name).symlink_to(tmp_path / name)
    with opened_factors(tmp_path / "modes.json", name) as found:
        assert set(found.groups) == {"a"}
    with pytest.raises(InputError, match="leads out of"), opened_factors(tmp_path / "in" / "modes.json", name):
        pass
    with pytest.raises(InputError, match="does not exist"), opened_factors(tmp_path / "modes.json", "a\0b"):
        pass


@pytest.mark.parametrize("read", [read_modes, read_scada, files.read_toml, files.read_bytes])
def test_no_reader_waits_at_a_pipe_or_device(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    for path, kind in ((tmp_path / "pipe", "a pipe"), ("/dev/zero", "a device"), (tmp_path, "a directory")):
        with pytest.raises(InputError, match=f"is {kind}, not a file"):
            read(path)
    for path in ("x" * 300, "a\0b", tmp_path / "none"):
        with pytest.raises(InputError):
            read(path)


def test_a_link_to_itself_is_one_line(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "a")
    with pytest.raises(InputError, match="cannot be read"):
        files.read_json(tmp_path / "a")


@pytest.mark.parametrize("text, words", [
    ("[" * 70 + "]" * 70, "nested deeper than 64"), ("[" * 200_000, "nested deeper than 64"),
    ("[1e999]", "number 1e999 overflows"), ("[" + "9" * 30 + "]", "beyond 64 bit"), ('["\\ud800"]', "surrogates"),
    ("[" + "9" * 10_000 + "]", "beyond 64 bit"), ("[Infinity]", "Infinity is not valid JSON"), ('{"a": 1, "a": 2}',
     "twice"),
    ("[1", "not JSON"), ("", "not JSON"),
])
def test_json_within_limits(tmp_path, text, words):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError, match=words):
        files.read_json(tmp_path / "a.json")


def test_json_at_its_limits_is_read(tmp_path):
    content = {"low": -(2**63), "high": 2**63 - 1, "big": 1e308, "text": "\U0001f600",
               "deep": json.loads("[" * 60 + "]" * 60)}
    (tmp_path / "a.json").write_text(json.dumps(content))
    assert files.read_json(tmp_path / "a.json") == content


@pytest.mark.parametrize("text", ["a = " + "[" * 70 + "]" * 70, "a = " + "[" * 5000, "a = 1e999", "a = " + "9" * 30])
def test_toml_within_limits(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError, match="not TOML"):
        files.read_toml(tmp_path / "a.toml")


@pytest.mark.parametrize("text", ["(a+)+$", "(a|a)*b", "((?:a*)*)x", r"(\d+)*", "(a)\\1", "(?=a)(b)", "(?:x?)+(y)",
                                  ".*.*.*.*(a)", "(a", "a", "(a)(b)", "(" + "a" * 300 + ")", "(a{1,3}){1,90}",
                                  "(" + "(?:a?){9}" * 9 + ")"])
def test_patterns_that_may_take_for_ever_are_refused(text):
    with pytest.raises(InputError, match="convert"):
        name_pattern(text, "convert.toml")


@pytest.mark.parametrize("text, name", [
    (r"_(\d{8}_\d{6})\.csv$", "a_20200101_120000.csv"), (r".*-(\d+)\.mat", "rec-1577.mat"),
    (r"(?:day|night)_(\d{4}-\d\d-\d\d)", "day_2020-01-01"), (r"(?P<t>[\d()+*]+)", "((2020))"),
])
def test_patterns_of_file_names_are_taken(text, name):
    assert name_pattern(text, "convert.toml").search(name)[1]


def test_the_worst_pattern_taken_ends():
    """About a second: its steps grow as the third power of the name's length, which is bounded."""
    assert name_pattern(".*.*.*(b)", "convert.toml").search("a" * 255) is None


def test_a_file_that_ends_or_holds_the_library_is_one_line(tmp_path, monkeypatch):
    """The child is told to fall ill, as no damage does so in every version of the library."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["data"] = 1.0
    from probupdate.io import hdf5_file, hdf5_probe

    for program, words in (("import os; input(); os._exit(139)", "ends on it"),
                           ("input()\nwhile True: pass", "is not done with it after 1 s")):
        (tmp_path / "child.py").write_text(program)
        probe = hdf5_file._Probe()
        with monkeypatch.context() as patch:
            patch.setattr(hdf5_probe, "__file__", str(tmp_path / "child.py"))
            patch.setattr(hdf5_file, "SECONDS", 1)
            patch.setattr(hdf5_file, "_probe", probe)
            with pytest.raises(InputError, match=words), open_hdf5(path, "is not a file", "copy it again"):
                pass
    with open_hdf5(path, "is not a file", "copy it again") as file:
        assert file["data"][()] == 1.0


def test_a_file_of_very_many_small_objects_is_sound(tmp_path, monkeypatch):
    """A year of modal sets has more of them than can be looked at within the time that one may take."""
    from probupdate.io import hdf5_file

    with h5py.File(tmp_path / "a.h5", "w", libver="latest") as file:
        for k in range(12_000):
            file.create_group(str(k)).attrs["id"] = k
    monkeypatch.setattr(hdf5_file, "SECONDS", 1)
    with open_hdf5(tmp_path / "a.h5", "is not a file", "copy it again") as file:
        assert len(file) == 12_000


def test_an_archive_that_was_sound_is_looked_at_anew_when_it_changes(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, K=np.eye(2))
    assert files.archive_arrays(path, "is none", "copy it again")["K"].shape == (2, 2)
    np.savez(path, K=np.array([{}]))
    with pytest.raises(InputError, match="objects"):
        files.archive_arrays(path, "is none", "copy it again")
