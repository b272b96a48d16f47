"""Times of sources: rows that are missing, other rates than stated, times rounded and jittering."""

import numpy as np
import pandas as pd
import pytest
from source_table import COLUMNS, RATE, START, noise, records, stamps, table

from probupdate.campaign.converting import convert
from probupdate.errors import InputError


def test_gaps_become_nan_or_another_file_and_are_told(job):
    raw, campaign = job('files = "*.csv"\ntime = "when"\nfill_seconds = 30' + COLUMNS)
    data, time = noise(), stamps()
    keep = np.r_[0:1000, 1050:3000, 4000:6000]  # five seconds, then a hundred
    table(data[keep], [t.isoformat() for t in time[keep]]).to_csv(raw / "r.csv", index=False)
    result = convert(raw, campaign)
    first, second = records(campaign)
    assert first[0] == START and len(first[1]) == 3000 and np.isnan(first[1][1000:1050]).all()
    assert np.array_equal(first[1][1050:3000], data[1050:3000].astype(np.float32))
    assert second[0] == time[4000] and np.array_equal(second[1], data[4000:].astype(np.float32))
    assert "50 missing rows filled" in result.summary and "1 gap longer than 30 s" in result.summary


def test_times_rounded_to_the_second_are_counted_between(job):
    """Ten rows a second, the first second begun late: rows keep their true place within a sample."""
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    data, time = noise()[4:], stamps()[4:]
    table(data, [t.floor("s").isoformat() for t in time]).to_csv(raw / "r.csv", index=False)
    result = convert(raw, campaign)
    ((start, found),) = records(campaign)
    assert abs((start - time[0]).total_seconds()) <= 1 / RATE and len(found) == len(data)
    assert "rounded to 1 s" in result.summary


def test_a_clock_that_runs_a_little_off_is_followed_and_told(job):
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    n = 20000
    time = START + pd.to_timedelta(np.arange(n) * 0.1 * (1 + 1e-4), unit="s")
    table(noise(n), [t.isoformat() for t in time]).to_csv(raw / "r.csv", index=False)
    result = convert(raw, campaign)
    at = 0
    for start, data in records(campaign):
        # every file's first row within a sample of its own time
        assert abs((start - time[at]).total_seconds()) < 0.1 + 1e-9
        at += len(data)
    assert at == n and "drift by one sample 2 times" in result.summary


@pytest.mark.parametrize("rate", [9.995, 10.005, 10.03])
@pytest.mark.parametrize("stamp", ["s", "ms"])
def test_a_rate_that_is_not_the_stated_one_is_named_with_its_remedy(job, rate, stamp):
    """Nothing is missing: rows, rate and span decide, fast or slow, whatever the stamps are rounded to."""
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    time = (START + pd.to_timedelta(np.arange(12000) / rate, unit="s")).floor(stamp)
    table(noise(12000), [t.isoformat() for t in time]).to_csv(raw / "r.csv", index=False)
    with pytest.raises(InputError, match=rf"come at {rate}.*Hz|write sampling_rate_hz = {rate}"):
        convert(raw, campaign)


def test_stamps_that_jitter_lose_no_row(job):
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    away = np.random.default_rng(3).normal(0, 0.018, 12000)
    time = START + pd.to_timedelta(np.maximum.accumulate(np.arange(12000) / 10 + np.clip(away, -0.09, 0.09)), unit="s")
    data = noise(12000)
    table(data, [t.isoformat() for t in time]).to_csv(raw / "r.csv", index=False)
    assert "steps are uneven" in convert(raw, campaign).summary
    ((_, found),) = records(campaign)
    assert np.array_equal(found, data.astype(np.float32))


def kept_rows(n, kind):
    """Rows of a radio: lost in bursts of three seconds, one in twenty at random, or each seventh."""
    rng, keep = np.random.default_rng(5), np.ones(n, bool)
    if kind == "bursts":
        keep[(rng.integers(0, n - 30, n // 300)[:, None] + np.arange(30)).ravel()] = False
    else:
        keep &= rng.random(n) > 0.05 if kind == "random" else np.arange(n) % 7 != 3
    return keep


@pytest.mark.parametrize("kind", ["bursts", "random", "each seventh"])
@pytest.mark.parametrize("stamp", ["s", "ms", "jitter"])
def test_rows_stay_in_their_place_where_others_are_missing(job, stamp, kind):
    """Rows of a second that lacks some have no place, and are lost with them; up to a second off they had remained."""
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    data, time, keep = noise(9000), stamps(9000), kept_rows(9000, kind)
    away = np.random.default_rng(3).uniform(-0.02, 0.02, 9000) if stamp == "jitter" else np.zeros(9000)
    table(data[keep], [t.isoformat() for t in (time + pd.to_timedelta(away, unit="s")).floor(
        "ms" if stamp == "jitter" else stamp)[keep]]).to_csv(raw / "r.csv", index=False)
    try:
        said = convert(raw, campaign).summary
    except InputError as error:
        # each seventh row of whole seconds: as another clock's
        assert (stamp, kind) == ("s", "each seventh") and "8.57" in str(error)
        return
    ((start, found),) = records(campaign)
    first = round((start - time[0]).total_seconds() * RATE)
    # a first or last second that lacks rows may as well begin late or end early
    there = np.flatnonzero(np.isfinite(found[:, 0]))[10:-10]
    assert np.array_equal(found[there], data[there + first].astype(np.float32)), said
    assert len(there) >= {"bursts": 0.85, "random": 0.55}.get(kind, 0.99) * keep.sum() and "missing rows" in said


@pytest.mark.parametrize(("rate", "stamp"), [(9.95, "s"), (10.03, "s"), (9.75, "ms"), (10.03, "ms")])
def test_a_rate_is_named_between_rows_that_are_missing(job, rate, stamp):
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    keep = kept_rows(12000, "bursts")
    time = (START + pd.to_timedelta(np.arange(12000) / rate, unit="s")).floor(stamp)[keep]
    table(noise(12000)[keep], [t.isoformat() for t in time]).to_csv(raw / "r.csv", index=False)
    with pytest.raises(InputError, match=f"{rate} Hz between those that are missing.*rate_hz = {rate}"):
        convert(raw, campaign)


def test_times_rounded_to_most_of_a_sample_are_regular(job):
    """As 64 Hz by hundredths of a second: steps of one and two, no row missing."""
    raw, campaign = job('files = "*.csv"\ntime = "when"\ntime_unit = "s"\nstart = "2024-05-01T00:00Z"' + COLUMNS)
    data = noise(3000)
    table(data, np.floor(np.arange(3000) / 10 / 0.064 + 1e-9) * 0.064).to_csv(raw / "r.csv", index=False)
    assert "times are rounded to 0.064 s" in convert(raw, campaign).summary
    assert np.array_equal(np.concatenate([d for _, d in records(campaign)]), data.astype(np.float32))


def test_files_that_each_count_from_their_beginning_are_told_how(job):
    text = 'files = "*.csv"\ntime = "when"\ntime_unit = "s"\n{}' + COLUMNS
    raw, campaign = job(text.format('start = "2024-05-01T00:00Z"'))
    for k in (0, 1):
        table(noise(600, k), np.arange(600) / RATE).to_csv(raw / f"r_20240501_00{k}000.csv", index=False)
    with pytest.raises(InputError, match="where each file counts from its own beginning, take that from its name by"):
        convert(raw, campaign)
    (campaign / "acceleration/converted.json").unlink()
    for path in (campaign / "acceleration").glob("*.h5"):
        path.unlink()
    (campaign / "convert.toml").write_text(text.format(
        "start_pattern = 'r_(\\d{8}_\\d{6})'\nstart_format = \"%Y%m%d_%H%M%S\"\nzone = \"UTC\""))
    convert(raw, campaign)
    assert [start.minute for start, _ in records(campaign)] == [0, 10]


def test_rows_that_stand_twice_are_one(job):
    """As after an upload that was repeated; a file had begun at each."""
    raw, campaign = job('files = "*.csv"\ntime = "when"' + COLUMNS)
    data, rows = noise(6000), np.sort(np.append(np.arange(6000), np.random.default_rng(2).integers(0, 6000, 300)))
    table(data[rows], [t.isoformat() for t in stamps(6000)[rows]]).to_csv(raw / "r.csv", index=False)
    assert "300 rows stand twice" in convert(raw, campaign).summary
    ((_, found),) = records(campaign)
    assert np.array_equal(found, data.astype(np.float32))
