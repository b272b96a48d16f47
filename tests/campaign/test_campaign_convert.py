"""Every format gives the samples that were put in, at their times; what would have to be guessed is refused."""

import io
import json
import os
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import scipy.io
from damage import damaged
from peer_packages import peer
from source_table import COLUMNS, RATE, START, noise, records, stamps, table

from probupdate.campaign import converting, table_sources
from probupdate.campaign.blocks import blocks
from probupdate.campaign.converting import convert
from probupdate.campaign.mat_v5 import refuse_damaged
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.sources import open_source
from probupdate.errors import InputError


def write_csv(raw, data):
    text = table(data, [t.isoformat() for t in stamps(len(data))])
    text.to_csv(raw / "r.csv", index=False)
    return 'files = "*.csv"\ntime = "when"' + COLUMNS


def write_german_csv(raw, data):
    local = stamps(len(data)).tz_convert("Europe/Berlin").tz_localize(None)
    text = table(data, [t.isoformat() for t in local])
    head = "logger 7\nsecond line\n"
    (raw / "r.csv").write_text(head + text.to_csv(index=False, sep=";", decimal=","))
    return ('files = "*.csv"\ntime = "when"\nzone = "Europe/Berlin"\nseparator = ";"\ndecimal = ","\nskip_rows = 2'
            + COLUMNS)


def write_headless_csv(raw, data):
    (raw / "r_20190603_120000.txt").write_text("\n".join(f"{k} {a!r} {b!r}" for k, (a, b) in enumerate(data.tolist())))
    return ('files = "*.txt"\nstart_pattern = \'r_(\\d{8}_\\d{6})\'\nstart_format = "%Y%m%d_%H%M%S"\nzone = "+02:00"\n'
            'separator = " "\nheader = false\n[columns]\n"a-x" = 2\n"a-y" = 3\n')


def write_parquet(raw, data):
    peer("pyarrow")
    table(data, stamps(len(data))).to_parquet(raw / "r.parquet")
    return 'files = "*.parquet"\ntime = "when"' + COLUMNS


def write_v5(raw, data):
    scipy.io.savemat(raw / "r.mat", {"acc": data, "t": np.arange(len(data)) / RATE, "note": "text"})
    return 'files = "*.mat"\ntime = "t"\ntime_unit = "s"\nstart = "2019-06-03T10:00:00Z"\ndata = "acc"\n'


def write_v5_packed(raw, data):
    scipy.io.savemat(raw / "r.mat", {"acc": data, "t": np.arange(len(data)) / RATE}, do_compression=True)
    return 'files = "*.mat"\ntime = "t"\ntime_unit = "s"\nstart = "2019-06-03T10:00:00Z"\ndata = "acc"\n'


def write_v4(raw, data):
    scipy.io.savemat(raw / "r.mat", {"acc": data, "t": np.arange(len(data)) / RATE}, format="4")
    return 'files = "*.mat"\ntime = "t"\ntime_unit = "s"\nstart = "2019-06-03T10:00:00Z"\ndata = "acc"\n'


def write_v5_days(raw, data):
    # a day number of this size is exact to 0.1 ms only
    day = 719529 + (stamps(len(data)) - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(days=1)
    scipy.io.savemat(raw / "r.mat", {"east": data[:, 0], "north": data[:, 1][None], "day": np.asarray(day)})
    return 'files = "*.mat"\ntime = "day"\ntime_unit = "matlab"\nzone = "UTC"' + COLUMNS


def write_v73(raw, data):
    with h5py.File(raw / "r.mat", "w", userblock_size=512) as file:
        file["acc"] = data.T  # as MATLAB lays (n, 2) on disk
        file["sec"] = (np.arange(len(data)) / RATE)[None]
    return 'files = "*.mat"\ntime = "sec"\ntime_unit = "s"\nstart = "2019-06-03T10:00:00+00:00"\ndata = "acc"\n'


def write_npy(raw, data):
    np.save(raw / "r.npy", np.column_stack([np.zeros(len(data)), data[:, 1], data[:, 0]]))
    return 'files = "*.npy"\nstart = "2019-06-03T10:00:00Z"\n[columns]\n"a-x" = 3\n"a-y" = 2\n'


def write_npz(raw, data):
    seconds = (stamps(len(data)) - pd.Timestamp(0, tz="UTC")).total_seconds().to_numpy()
    np.savez_compressed(raw / "r.npz", east=data[:, 0], north=data[:, 1], when=seconds * 1000)
    return 'files = "*.npz"\ntime = "when"\ntime_unit = "ms"\nzone = "UTC"' + COLUMNS


WRITERS = (write_csv, write_german_csv, write_headless_csv, write_parquet, write_v4, write_v5, write_v5_packed,
           write_v5_days, write_v73, write_npy, write_npz)


@pytest.mark.parametrize("write", WRITERS, ids=lambda w: w.__name__[6:])
def test_every_format_gives_what_was_put_in(job, write, monkeypatch, validation):
    # pieces of 999 rows, so that what is carried from piece to piece is looked at
    row = validation(what="eleven formats converted: start, records as float32", reference="what was put in",
                     why="MATLAB's day numbers hold 0.1 ms")
    monkeypatch.setattr("probupdate.campaign.sources.PIECE", 999)
    data = noise()
    raw, campaign = job("")
    job(write(raw, data))
    result = convert(raw, campaign)
    ((start, found),) = records(campaign)
    # MATLAB's day numbers hold 0.1 ms
    row.error((start - START).total_seconds(), below=1e-4, of="start, s")
    row.equal(found, data.astype(np.float32), of="records")
    assert result.samples == 6000 and "1 file written" in result.summary
    (block,) = blocks(read_campaign(campaign))
    assert block.excluded == "" and block.data[:, 0] == pytest.approx(data[:, 0], rel=1e-6)


@pytest.mark.parametrize("write", WRITERS, ids=lambda w: w.__name__[6:])
def test_a_damaged_file_is_read_or_named(job, write):
    """Never another error, nor the end of the process; every warning is an error here (pyproject.toml)."""
    raw, campaign = job("")
    job(write(raw, noise(300)))
    (path,) = raw.iterdir()
    whole, rng, refused = path.read_bytes(), np.random.default_rng(3), 0
    for number in range(60):
        path.write_bytes(damaged(whole, rng, number))
        try:
            convert(raw, campaign)
        except InputError as error:
            assert path.name in str(error)
            refused += 1
        shutil.rmtree(campaign / "acceleration", ignore_errors=True)
    # a file cut off is hardly ever whole
    assert refused >= 10


def test_a_type_of_values_that_mat_v5_has_not_is_refused_before_scipy_looks_it_up(job):
    raw, campaign = job("")
    job(write_v5(raw, noise(300)))
    content = bytearray((raw / "r.mat").read_bytes())
    values = content.index(noise(300)[:, 0].tobytes()) - 8
    assert content[values] == 9  # miDOUBLE
    content[values] = 200
    (raw / "r.mat").write_bytes(content)
    with pytest.raises(InputError, match=f"damaged at byte {values}"):
        convert(raw, campaign)
    # an array that ends before it says of what class it is
    job(write_v5(raw, noise(300)))
    whole = (raw / "r.mat").read_bytes()
    (raw / "r.mat").write_bytes(whole + struct.pack("<IIII", 14, 8, 6, 0))
    with pytest.raises(InputError, match=f"damaged at byte {len(whole) + 8}"):
        convert(raw, campaign)


def test_files_of_matlab_are_not_taken_for_damaged():
    """Those that scipy keeps for its own tests: written by MATLAB 5 to 9.4 on six systems, and a few spoilt ones."""
    spoilt = {"corrupted_zlib_checksum.mat", "corrupted_zlib_data.mat", "malformed1.mat"}
    files = sorted((Path(scipy.io.__file__).parent / "matlab" / "tests" / "data").glob("*.mat"))
    refused = set()
    for path in files:
        try:
            refuse_damaged(path)
        except InputError:
            refused.add(path.name)
    # the locked scipy brings them
    assert len(files) > 80 and refused - {p.name for p in files if h5py.is_hdf5(p)} == spoilt


def test_what_else_a_mat_file_holds_does_not_matter(job):
    raw, campaign = job("")
    job(write_v5(raw, noise(300)))
    scipy.io.savemat(raw / "r.mat", {"acc": noise(300), "t": np.arange(300) / RATE, "cube": np.zeros((2, 2, 2)),
                                     "poles": np.array([1j, 2.0])})
    assert convert(raw, campaign).samples == 300


@pytest.mark.parametrize("write", [write_v5, write_npy, write_csv])
def test_counts_of_a_converter_are_no_acceleration_until_a_factor_says_so(job, write):
    raw, campaign = job("")
    text = write(raw, np.round(1000 * noise(600)))
    job(text)
    with pytest.raises(InputError, match="whole numbers"):
        convert(raw, campaign)
    job(text + '[factor]\n"a-x" = 0.001\n"a-y" = 0.001\n')
    convert(raw, campaign)
    assert records(campaign)[0][1].std() == pytest.approx(1.0, abs=0.1)


def test_values_beyond_single_precision_are_lost_and_told(job):
    raw, campaign = job("")
    data = noise(300)
    data[7, 0], data[9, 1] = 1e300, np.inf
    job(write_npy(raw, data))
    assert "2 values lost" in convert(raw, campaign).summary
    ((_, found),) = records(campaign)
    assert np.isnan(found[7, 0]) and np.isnan(found[9, 1]) and np.isnan(found).sum() == 2


@pytest.mark.parametrize("second", [1e12, -1e300])
def test_times_of_no_century_are_refused(job, second):
    raw, campaign = job("")
    job(write_v5(raw, noise(300)))
    scipy.io.savemat(raw / "r.mat", {"acc": noise(300), "t": np.append(np.arange(299) / RATE, second)})
    with pytest.raises(InputError, match=r"r\.mat, time: row 300 .*plausible date"):
        convert(raw, campaign)


@pytest.mark.parametrize(("line", "short"), [
    ("2019-06-03T10:00:00.300Z,1.0", True), ("2019-06-03T10:00:00.300Z,,", False), ("", False),
])
def test_a_row_with_too_few_cells_is_named_and_an_empty_cell_is_a_gap(job, line, short):
    """The row had become NaN at its end without a word of its line."""
    raw, campaign = job('files = "*.csv"\ntime = "when"\nskip_rows = 1' + COLUMNS)
    good = [f"{t:%Y-%m-%dT%H:%M:%S.%f}Z,1.0,2.0" for t in stamps(6)]
    # a blank line is not a row
    (raw / "a.csv").write_text("\n".join(["a logger", "when,east,north", *good[:3], "", line, *good[4:]]) + "\n")
    if short:
        with pytest.raises(InputError, match=r"a\.csv, line 7: has 2 cells of 3; complete it with empty cells"):
            convert(raw, campaign)
    else:
        assert convert(raw, campaign).samples >= 5


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-16"])
@pytest.mark.parametrize(("last", "kept"), [
    ("0,123456;NaN", True), ("0,123456;-0,012345", True), ("0,123456;-0,0", False), ("0,123456;-0,", False),
    ("0,123456;-", False),
    ("0,123456;", False), ("0,12", False), ("0", False), ('"0,1', False),
])
def test_a_last_line_cut_off_is_left_out_and_said(job, encoding, last, kept):
    raw, campaign = job('files = "*.csv"\nstart = "2019-06-03T10:00:00Z"\nseparator = ";"\ndecimal = ","\n'
                        f'encoding = "{encoding}"\n[columns]\n"a-x" = "läng"\n"a-y" = "quer"\n')
    rows = [f"{a:.6f};{b:.6f}".replace(".", ",") for a, b in noise(40)]
    (raw / "r.csv").write_bytes("\r\n".join(["läng;quer", *rows, last]).encode(encoding))
    done = convert(raw, campaign)
    ((_, data),) = records(campaign)
    assert len(data) == 40 + kept and np.isnan(data).sum() == ("NaN" in last)
    assert ("its last line has no end and is cut off" in done.summary) is not kept, done.summary


def test_where_decimals_vary_a_last_line_without_end_is_said(job):
    raw, campaign = job('files = "*.csv"\nstart = "2019-06-03T10:00:00Z"' + COLUMNS)
    (raw / "r.csv").write_text("east,north\n" + "\n".join(f"{(7 * k) % 30 + 0.5},{k * k / 4}" for k in range(30)))
    done = convert(raw, campaign)
    assert done.samples == 30 and "its last line has no end, and was taken as whole" in done.summary


def test_lost_markers_factors_and_text_cells(job):
    raw, campaign = job('files = "*.csv"\ntime = "when"\nlost = [-999.0]' + COLUMNS + '[factor]\n"a-y" = -2.0\n')
    data = noise()
    data[5, 0] = data[7, 1] = -999.0
    table(data, [t.isoformat() for t in stamps()]).to_csv(raw / "r.csv", index=False)
    assert "2 values lost" in convert(raw, campaign).summary
    ((_, found),) = records(campaign)
    assert np.isnan(found[5, 0]) and np.isnan(found[7, 1]) and found[8, 1] == np.float32(-2 * data[8, 1])


MISTAKES = [
    ("zone", {"zone": None}, "its time zone is not stated"),
    ("irregular", {"jitter": 0.05}, "irregular"),
    ("another rate", {"step": "39.0625ms"}, "come at 25.6 Hz without a gap, campaign.toml says 10 Hz"),
    ("slower", {"step": "1s"}, "rows come every 1 s, campaign.toml says 0.1"),
    ("backward", {"swap": True}, "row 31 is earlier than the one before"),
    ("autumn", {"start": "2019-10-27T02:30", "zone": "Europe/Berlin"}, "is not a single moment in that zone"),
    ("text", {"cell": "broken"}, "column east, row 43: 'broken' is not a number"),
]


@pytest.mark.parametrize(("change", "problem"), [m[1:] for m in MISTAKES], ids=[m[0] for m in MISTAKES])
def test_what_would_have_to_be_guessed_is_refused(job, change, problem):
    zone = change.get("zone", "UTC")
    raw, campaign = job('files = "*.csv"\ntime = "when"' + (f'\nzone = "{zone}"' if zone else "") + COLUMNS)
    start = pd.Timestamp(change.get("start", "2019-06-03T10:00"))
    time = pd.date_range(start, periods=2000, freq=change.get("step", "100ms"))
    if "jitter" in change:
        time = time + pd.to_timedelta(np.random.default_rng(1).uniform(0, 0.099, 2000), unit="s")
    text = [t.isoformat() for t in time]
    if "swap" in change:
        text[29], text[30] = text[30], text[29]
    rows = table(noise(2000), text).astype({"east": object})
    if "cell" in change:
        rows.loc[42, "east"] = change["cell"]
    rows.to_csv(raw / "r.csv", index=False)
    with pytest.raises(InputError) as error:
        convert(raw, campaign)
    assert problem in str(error.value) and not list((campaign / "acceleration").glob("*.h5"))


@pytest.mark.parametrize(("unit", "per_second"), [("ms", 1e3), ("us", 1e6), ("s", 1.0)])
def test_times_in_another_unit_than_stated_name_it(job, unit, per_second):
    stated = "s" if unit != "s" else "ms"
    raw, campaign = job(
        f'files = "*.csv"\ntime = "when"\ntime_unit = "{stated}"\nstart = "2019-06-03T10:00Z"' + COLUMNS)
    table(noise(2000), np.arange(2000) / 10 * per_second).to_csv(raw / "r.csv", index=False)
    with pytest.raises(InputError, match=f'write time_unit = "{unit}" in convert.toml'):
        convert(raw, campaign)


DESCRIPTIONS = [
    ('files = "../*.csv"\ntime = "when"', "leaves the folder"), ('files = "/etc/*"\ntime = "w"', "leaves the folder"),
    ('files = "*.csv"', "does not state the time"), ('time = "when"', "'files' is missing"),
    ('files = "*.csv"\ntime = "when"\nzone = "Mars/Base"', "'Mars/Base' is not a time zone"),
    ('files = "*.csv"\ntme = "when"', "unknown key 'tme'; did you mean 'time'"),
    ('files = "*.csv"\ntime = "when"\ntime_unit = "h"', "'h' is unknown"),
    ('files = "*.csv"\ntime = "when"\n[columns]\n"b-x" = 1', "'b-x' is not a channel"),
    ('files = "*.csv"\ntime = "when"\n[columns]\n"a-x" = 1\n"a-y" = 1', "a-x and a-y are the same column"),
    ('files = "*.csv"\ntime = "when"\n[columns]\n"a-x" = "west"\n"a-y" = "north"', "there is no column 'west'"),
    ('files = "*.doc"\ntime = "when"', "holds no file that matches"),
    ('files = "*.csv"\nstart_pattern = "x"', "has 0 groups"),
]


@pytest.mark.parametrize(("text", "problem"), DESCRIPTIONS, ids=[d[1] for d in DESCRIPTIONS])
def test_mistakes_of_the_description_have_their_line(job, text, problem):
    raw, campaign = job(text)
    write_csv(raw, noise(200))
    with pytest.raises(InputError) as error:
        convert(raw, campaign)
    assert problem in str(error.value)


def test_nothing_is_executed_and_no_link_leads_out(job, tmp_path):
    raw, campaign = job('files = "*.npy"\nstart = "2019-06-03T10:00:00Z"\n')

    # an array of objects as numpy lays it down, whose one object would make a folder if it were ever loaded
    head, body = io.BytesIO(), f"cos\nmkdir\n(V{tmp_path / 'sprung'}\ntR.".encode()
    np.lib.format.write_array_header_1_0(head, {"descr": "|O", "fortran_order": False, "shape": (1,)})
    trap = head.getvalue() + body
    (raw / "r.npy").write_bytes(trap)
    with pytest.raises(InputError, match="is not an array of numbers"):
        convert(raw, campaign)
    with zipfile.ZipFile(raw / "r.npz", "w") as file:
        file.writestr("data.npy", trap)
    job('files = "*.npz"\nstart = "2019-06-03T10:00:00Z"\n')
    with pytest.raises(InputError, match=r"holds no array of numbers; it holds data \(object"):
        convert(raw, campaign)
    assert not (tmp_path / "sprung").exists()
    np.save(tmp_path / "outside.npy", noise(100))
    (raw / "r.npy").unlink()
    (raw / "link.npy").symlink_to(tmp_path / "outside.npy")
    job('files = "*.npy"\nstart = "2019-06-03T10:00:00Z"\n')
    with pytest.raises(InputError, match="leads out of the folder"):
        convert(raw, campaign)


def test_what_matches_and_is_no_file_is_asked_about(job, tmp_path):
    """A record behind a disk that is not there is not left out in silence; a folder of that name is none."""
    raw, campaign = job('files = "*.npy"\nstart_pattern = \'(\\d+)\'\nstart_format = "%Y%m%d%H%M%S"\nzone = "UTC"\n')
    np.save(raw / "20190603100000.npy", noise())
    (raw / "20190603110000.npy").mkdir()
    odd = raw / "20190603120000.npy"
    for make, words in ((lambda: odd.symlink_to(tmp_path / "none"), "no such file"),
                        (lambda: os.mkfifo(odd), "is a pipe"), (lambda: odd.symlink_to(odd), "cannot be read")):
        make()
        with pytest.raises(InputError, match=f"{odd.name}.*{words}"):
            convert(raw, campaign)
        odd.unlink()
    assert len(convert(raw, campaign).files) == 1


def test_the_record_of_conversions_is_in_one_order(job):
    raw, campaign = job('files = "*.npy"\nstart_pattern = \'(\\d+)\'\nstart_format = "%Y%m%d%H%M%S"\nzone = "UTC"\n')
    for hour in (11, 10):
        np.save(raw / f"20190603{hour}0000.npy", noise(seed=hour))
        convert(raw, campaign)
    kept = json.loads((campaign / "acceleration" / "converted.json").read_text())
    assert list(kept) == ["20190603100000.npy", "20190603110000.npy"]


def test_a_source_that_changes_while_it_is_converted_is_named(job, monkeypatch):
    raw, campaign = job('files = "*.npy"\nstart = "2019-06-03T10:00:00Z"\n')
    np.save(raw / "r.npy", noise(seed=1))
    np.save(campaign / "other.npy", noise(seed=2))
    monkeypatch.setattr(converting, "open_source", lambda path, *given, **more: (
        os.replace(campaign / "other.npy", path), open_source(path, *given, **more))[1])
    with pytest.raises(InputError, match=r"r\.npy: changed while it was converted"):
        convert(raw, campaign)
    assert not list((campaign / "acceleration").glob("*.h5"))


@pytest.mark.parametrize("again", ["corrected", "other factor"])
def test_what_an_unfinished_conversion_left_is_not_read_beside_the_next(job, monkeypatch, again):
    monkeypatch.setattr(converting, "FILE_S", 60.0)
    monkeypatch.setattr(table_sources, "PIECE", 1000)
    described = 'files = "*.csv"\ntime = "when"' + COLUMNS
    raw, campaign = job(described)
    data = noise()
    rows = table(data, [t.isoformat() for t in stamps()])
    rows.assign(east=rows["east"].astype(object).where(rows.index != 5500, "oops")).to_csv(raw / "r.csv", index=False)
    with pytest.raises(InputError, match="oops"):
        convert(raw, campaign)
    assert len(records(campaign)) > 2
    rows.to_csv(raw / "r.csv", index=False)
    if again == "other factor":
        job(described + '[factor]\n"a-x" = 1.0\n"a-y" = 1.0\n')
    found = convert(raw, campaign)
    assert "of an unfinished conversion removed" in found.notes[0]
    kept = np.concatenate([part for _, part in records(campaign)])
    assert kept.shape == data.shape and np.allclose(kept, data, atol=1e-6)


def test_broken_files_are_named(job):
    raw, campaign = job('files = "r.*"\nstart = "2019-06-03T10:00:00Z"\n')
    for name, content in (("r.npy", b"none"), ("r.npz", b"none"), ("r.mat", b"none" * 100), ("r.xyz", b""),
                          ("r.mat", b"\x89HDF\r\n\x1a\n" + bytes(600))):
        for old in raw.iterdir():
            old.unlink()
        (raw / name).write_bytes(content)
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            convert(raw, campaign)


def test_a_table_in_another_encoding_says_which_is_read(job):
    raw, campaign = job('files = "*.csv"\nstart = "2019-06-03T10:00:00Z"\n')
    (raw / "r.csv").write_bytes("höhe,east\n1,2\n".encode("latin-1"))
    with pytest.raises(InputError, match=r'r\.csv: is not text in utf-8.*encoding = "cp1252"'):
        convert(raw, campaign)


def test_a_second_run_keeps_what_is_done_and_refuses_what_changed(job):
    raw, campaign = job('files = "*.npy"\nstart_pattern = \'(\\d+)\'\nstart_format = "%Y%m%d%H%M%S"\nzone = "UTC"\n')
    for hour in (10, 11, 12):
        np.save(raw / f"20190603{hour}0000.npy", noise(seed=hour))
    # stopped within the third
    (raw / "20190603120000.npy").write_bytes(b"cut off")
    with pytest.raises(InputError, match="20190603120000"):
        convert(raw, campaign)
    assert len(records(campaign)) == 2
    before = {p: p.stat().st_mtime_ns for p in (campaign / "acceleration").glob("*.h5")}
    np.save(raw / "20190603120000.npy", noise(seed=12))
    result = convert(raw, campaign)
    assert len(result.files) == 1 and len(result.kept) == 2
    assert all(p.stat().st_mtime_ns == t for p, t in before.items())
    assert [len(d) for _, d in records(campaign)] == [6000] * 3
    # a copied source has other times and the same content
    os.utime(raw / "20190603100000.npy", (1e9, 1e9))
    assert len(convert(raw, campaign).kept) == 3
    np.save(raw / "20190603110000.npy", noise(seed=99))
    with pytest.raises(InputError, match="no longer what was converted"):
        convert(raw, campaign)


def test_long_sources_are_cut_into_hours_that_follow_on(job):
    raw, campaign = job('files = "*.npy"\nstart = "2019-06-03T10:00:00Z"\n')
    data = noise(90000)
    np.save(raw / "r.npy", data)
    convert(raw, campaign)
    found = records(campaign)
    assert [len(d) for _, d in found] == [36000, 36000, 18000]
    assert [(s - START).total_seconds() for s, _ in found] == [0, 3600, 7200]
    assert np.array_equal(np.concatenate([d for _, d in found]), data.astype(np.float32))


@pytest.mark.parametrize("overrule", ["", 'overrule = ["overlap"]\n'])
def test_sources_that_overlap_and_differ_are_refused(job, overrule):
    raw, campaign = job('files = "*.npy"\nstart_pattern = \'(\\d+)\'\nstart_format = "%Y%m%d%H%M%S"\nzone = "UTC"\n'
                        + overrule)
    np.save(raw / "20190603100000.npy", noise())
    np.save(raw / "20190603100900.npy", noise())
    if overrule:
        assert "overlap by 600 samples, where the one that starts first is used" in convert(raw, campaign).summary
        return
    with pytest.raises(InputError, match=r"100900\.npy: overlaps 20190603100000\.npy by 600 samples"):
        convert(raw, campaign)


def test_a_missing_pyarrow_is_named(job, monkeypatch):
    raw, campaign = job('files = "*.parquet"\ntime = "when"')
    (raw / "r.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"pip install probupdate\[parquet\]"):
        convert(raw, campaign)


def test_memory_of_a_large_source_stays_small(job, tmp_path):
    """64 MB of float64 in a compressed archive, converted by a program whose memory is looked at."""
    raw, campaign = job('files = "*.npz"\nstart = "2019-06-03T10:00:00Z"\ndata = "acc"\n')
    n_row, chunk = 4_000_000, np.zeros((250_000, 2))
    with zipfile.ZipFile(raw / "r.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive, archive.open(
            "acc.npy", "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (n_row, 2)})
        for _ in range(n_row // len(chunk)):
            member.write(chunk.tobytes())
    code = ("import sys, resource, h5py\nfrom probupdate.campaign.converting import convert\n"
            "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
            "before = peak()\nconvert(sys.argv[1], sys.argv[2])\nprint(peak() - before)\n")
    done = subprocess.run([sys.executable, "-c", code, str(raw), str(campaign)], capture_output=True, text=True,
                          check=True)
    assert int(done.stdout) < 40 * 1024  # kB


# Names of channels kept with the samples ----------------------------------------------------------------------------


@pytest.mark.parametrize(("old", "new", "words"), [
    ('channel = "a-y"', 'channel = "roof"', "column 2 is 'a-y', campaign.toml calls it 'roof'"),
    ("a-x", "a-y", "tables were put in another order; order them a-x, a-y"),
])
def test_channels_renamed_or_reordered_after_conversion_are_refused(job, head, old, new, words):
    raw, campaign = job("")
    (campaign / "convert.toml").write_text(write_csv(raw, noise()))
    convert(raw, campaign)
    assert read_campaign(campaign).channels == ("a-x", "a-y")
    changed = head.replace(old, new) if old != "a-x" else (
        head.replace("a-x", "?").replace("a-y", "a-x").replace("?", "a-y"))
    (campaign / "campaign.toml").write_text(changed)
    with pytest.raises(InputError, match=words):
        read_campaign(campaign)


def test_files_without_names_of_channels_stay_readable_and_names_that_are_none_are_refused(
    campaign_folder, signal, write_file
):
    folder = campaign_folder([(0, signal(6000))])
    assert read_campaign(folder).channels == ("a-x", "a-y")
    write_file(folder, "1.h5", START, signal(10), attributes={"channels": "a-x and a-y"})
    with pytest.raises(InputError, match="attribute channels: is not a JSON list of names"):
        read_campaign(folder)
    write_file(folder, "1.h5", START, signal(10), attributes={"channels": '["a-x"]'})
    with pytest.raises(InputError, match="names 1 channels, campaign.toml lists 2"):
        read_campaign(folder)


@pytest.mark.parametrize("zone", ["", 'zone = "UTC"\n'])
def test_seconds_without_a_start_ask_for_the_start(job, zone):
    raw, campaign = job(f'files = "*.csv"\ntime = "when"\ntime_unit = "s"\n{zone}{COLUMNS}')
    table(noise(), np.arange(6000) / RATE).to_csv(raw / "r.csv", index=False)
    with pytest.raises(InputError, match=r"counts from the beginning of the record.*; add start to .*convert\.toml"):
        convert(raw, campaign)


def test_columns_that_are_not_found_say_why(job):
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    text = table(noise(), [t.isoformat() for t in stamps()])
    text.to_csv(raw / "r.csv", index=False, sep=";")
    with pytest.raises(InputError, match="the whole line 'when;east;north;other' is one column.*separator = \";\""):
        convert(raw, campaign)
    text.to_csv(raw / "r.csv", index=False)
    (campaign / "convert.toml").write_text('files = "*.csv"\ntime = "whem"' + COLUMNS)
    said = "there is no column 'whem'; correct time in convert.toml; did you mean 'when'"
    with pytest.raises(InputError, match=said):
        convert(raw, campaign)


@pytest.mark.parametrize(("columns", "kind", "said"), [
    ("", "csv", r"no column 'a-x'; correct channel of its \[\[sensor\]\] in campaign\.toml, or name its column in"),
    ("", "npz", r"no variable 'a-x'; correct channel of its \[\[sensor\]\] in campaign\.toml, or name its column in"),
    ('\n[columns]\n"a-x" = "West"', "csv", r"'West'; correct \[columns\] in convert\.toml; did you mean 'west'\?"),
])
def test_a_missing_column_is_corrected_where_it_is_named(job, columns, kind, said):
    """By campaign.toml, where convert.toml gives the channel no other name."""
    raw, campaign = job(f'files = "*.{kind}"\nstart = "2026-06-01T00:00:00Z"{columns}')
    if kind == "csv":
        pd.DataFrame(noise(), columns=["west [m/s2]", "a-y"]).to_csv(raw / "r.csv", index=False)
    else:
        np.savez(raw / "r.npz", **{"west": noise()[:, 0], "a-y": noise()[:, 1]})
    with pytest.raises(InputError, match=said):
        convert(raw, campaign)


@pytest.mark.parametrize("kind", ["csv", "parquet", "npz", "matrix"])
def test_columns_that_no_sensor_reads_are_said_in_one_line(job, kind):
    columns = '\n[columns]\n"a-x" = 1\n"a-y" = 3' if kind == "matrix" else '\n[columns]\n"a-x" = "east"'
    ending = "npz" if kind == "matrix" else kind
    if kind == "parquet":
        pytest.importorskip("pyarrow", reason="the extra `parquet` is not installed")
    raw, campaign = job(f'files = "*.{ending}"\nstart_pattern = "r(\\\\d+)"\nstart_format = "%Y%m%d%H"\n'
                        f'zone = "UTC"{columns}')
    data = np.random.default_rng(1).standard_normal((6000, 3))
    for hour in (10, 12):
        path = raw / f"r20260601{hour}.{ending}"
        frame = pd.DataFrame(data, columns=["east", "b-x [mg]", "a-y"])
        if kind == "matrix":
            np.savez(path, y=data, fs=RATE)
        elif kind == "npz":
            np.savez(path, **{name: frame[name] for name in frame}, fs=RATE)
        else:
            getattr(frame, f"to_{kind}")(path, index=False)
    name = "y 2" if kind == "matrix" else "b-x [mg]"
    said = f"columns not used, as no [[sensor]] of campaign.toml has them: {name} (2 files)"
    assert [n for n in convert(raw, campaign).notes if "not used" in n] == [said]


def test_a_conversion_of_all_columns_names_none(job):
    raw, campaign = job('files = "*.csv"\ntime = "when"\n[columns]\n"a-x" = "east"')
    table = pd.DataFrame(np.random.default_rng(1).standard_normal((6000, 2)), columns=["east", "a-y [m/s2]"])
    table.assign(when=[t.isoformat() for t in stamps()]).to_csv(raw / "r.csv", index=False)
    assert not any("not used" in n for n in convert(raw, campaign).notes)


def test_what_was_done_to_many_files_alike_is_said_once(job):
    raw, campaign = job('files = "*.csv"\ntime = "when"\n[columns]\n"a-x" = "east [g]"\n"a-y" = "north [m/s2]"')
    for hour in range(4):
        data = noise(seed=hour)
        times = [t.isoformat() for t in stamps(start=START + pd.Timedelta(hours=hour))]
        pd.DataFrame({"when": times, "east [g]": data[:, 0], "north [m/s2]": data[:, 1]}).to_csv(
            raw / f"r{hour}.csv", index=False)
    (said,) = [note for note in convert(raw, campaign).notes if "g was turned into m/s2" in note]
    assert said.startswith("4 files (r0.csv to r3.csv): ")


def test_files_and_notes_are_in_order_of_time(job):
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    data = np.where(np.arange(600)[:, None] == 5, np.nan, noise(600))
    for name, start in (("01.07.2019", "2019-07-01T10:00:00Z"), ("03.06.2019", "2019-06-03T10:00:00Z")):
        table(data, [t.isoformat() for t in stamps(600, pd.Timestamp(start))]).to_csv(raw / f"{name}.csv", index=False)
    found = convert(raw, campaign)
    assert [p.name[:8] for p in found.files] == ["20190603", "20190701"]
    assert [note[:10] for note in found.notes if "lost (NaN)" in note] == ["03.06.2019", "01.07.2019"]
