"""Clocks that drift beyond the range in which delays are sought: by their size, never as a constant, sign or gain."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import signal

from probupdate.campaign.checking import check
from probupdate.campaign.findings import ComparedBlock, clock_findings, mounting_findings, runaway_clocks
from probupdate.campaign.mounting import DEAD, Suspicion
from probupdate.campaign.reading import read_campaign
from probupdate.verbs.identifying import identify

CHANNELS = ("a", "b", "c")


def blocks(ppm, n=48, seed=0):
    """Half hours: the delay of b, NaN or at a wrong period where it is beyond two seconds."""
    rng, found = np.random.default_rng(seed), []
    for k in range(n):
        late = ppm * 1e-6 * 1800 * (k + 0.5)
        seen = late if late < 2 else rng.uniform(-1, 1) if rng.random() < 0.1 else np.nan
        start = pd.Timestamp("2024-05-01T00:00Z") + k * pd.Timedelta(minutes=30)
        found.append(ComparedBlock(id=start.strftime("%H:%M"), start=start, state="unknown", suspicions=(), pieces=(),
                                   delay_s=np.array([0.0, seen, 0.001]) + 0.001 * rng.standard_normal(3),
                                   delay_std_s=np.full(3, 0.002), drift=np.zeros(3),
                                   apart=np.zeros(3, bool), lowest_hz=0.3))
    return found


@pytest.mark.parametrize("ppm", [30, 100, 150, 200, -40])
def test_a_drift_beyond_the_range_is_named_by_its_size(ppm):
    compared = blocks(ppm)
    if ppm < 0:
        compared = [c for c in compared if c.delay_s[1] > -2]
    drift, _ = runaway_clocks(compared, CHANNELS)["b"]
    assert drift / 0.0864 == pytest.approx(ppm, rel=0.02)
    (text,) = clock_findings(compared, CHANNELS)[0]
    assert text.startswith("suspect: the clock of b drifts by") and "beyond 2 s" in text


@pytest.mark.parametrize("ppm", [0, 10])
def test_what_stays_within_the_range_is_no_runaway(ppm):
    assert runaway_clocks(blocks(ppm), CHANNELS) == {}


@pytest.fixture(scope="module")
def storeys():
    """An hour of five storeys at 10 Hz, three modes under white forces, exact by sums of sinusoids; and the fourth by
    any clock."""
    rng, rate, n = np.random.default_rng(4), 10.0, 36000
    line = np.fft.rfftfreq(n, 1 / rate)
    shape = np.sin(np.outer(np.arange(1, 6) / 5, np.pi / 2 * np.array([1, 3, 5])))
    force = rng.standard_normal((3, len(line))) + 1j * rng.standard_normal((3, len(line)))
    modes = np.array([1 / (1 - (line / f) ** 2 + 0.02j * line / f) for f in (0.6, 1.7, 2.7)])
    motion = np.fft.irfft(shape @ (modes * force * (line < 4)), n)

    def record(delay_s):
        """delay_s (n,) of the fourth channel at each sample."""
        y = motion / motion.std() * 0.05
        fine = signal.resample(y[3], 8 * n)
        y[3] = np.interp(np.arange(n) / rate - delay_s, np.arange(8 * n) / (8 * rate), fine)
        return (y + 0.001 * rng.standard_normal(y.shape)).T

    return record, np.arange(n) / rate


HEAD = 'name = "Storeys"\nsampling_rate_hz = 10.0\nblock_minutes = 10\n' + "".join(
    f'[[sensor]]\nchannel = "F{k}"\nlevel = "F{k}"\nposition_m = [0.0, 0.0, {3.0 * k}]\n'
    'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n' for k in range(1, 6))


@pytest.mark.parametrize(("ppm", "constant"), [(600, 0.0), (-1500, 0.0), (0, 0.8), (60, 0.7), (0, 18.0),
                                               (0, 45.0)])
def test_check_reports_clocks_and_no_sign_or_gain(campaign_folder, storeys, ppm, constant):
    """A delay of half a period turns a sign; a drift of a period within a block leaves no coherence."""
    record, time = storeys
    folder = campaign_folder([(0, record(constant + ppm * 1e-6 * time))], head=HEAD)
    (text,) = [t for t in check(read_campaign(folder)).findings if t.startswith("suspect")]
    assert text.startswith("suspect: the clock of F4 ")
    if abs(ppm) > 100:
        assert float(text.split("(")[1].split(" ppm")[0]) == pytest.approx(ppm, rel=0.03)
    else:
        expected = 1e3 * (constant + ppm * 1e-6 * time[-1] / 2)
        assert float(text.split("is ")[1].split(" +-")[0]) == pytest.approx(expected, abs=20 if ppm else 2)


@pytest.mark.parametrize("by_s", [1.0, -0.3])
def test_a_clock_that_is_set_jumps_and_does_not_drift(campaign_folder, storeys, by_s):
    record, time = storeys
    folder = campaign_folder([(0, record(np.where(time > 1700, by_s, 0.0)))], head=HEAD)
    (text,) = [t for t in check(read_campaign(folder)).findings if t.startswith("suspect")]
    assert text.startswith("suspect: the clock of F4 ") and f"jumps by {1e3 * by_s:+.0f} ms" in text


@pytest.mark.parametrize("filter_of", [((1, 0.3), "high"), ((2, 0.4), "high"), ((1, 0.8), "low")])
def test_a_filter_of_one_channel_is_named_and_no_clock(campaign_folder, storeys, filter_of):
    (order, corner), kind = filter_of
    record, time = storeys
    data = record(0.0 * time)
    data[:, 1] = signal.lfilter(*signal.butter(order, corner, kind, fs=10.0), data[:, 1])
    folder = campaign_folder([(0, data)], head=HEAD)
    said = [t for t in check(read_campaign(folder)).findings if "F2 moves" in t or "clock of" in t]
    assert len(said) == 1 and "a filter or a mount of its own" in said[0]


LONG = HEAD.replace("block_minutes = 10", "block_minutes = 12")


@pytest.mark.parametrize(("late_s", "faster", "words"), [
    (900.0, 0.0, "F4 has nothing in common with any other channel, yet what happens stands 15 min later"),
    (0.0, 0.013, "what happens stands in it at 0.987 times"), (0.0, -0.03, "what happens stands in it at 1.030 times"),
])
def test_a_clock_far_off_and_another_rate_are_named(campaign_folder, storeys, late_s, faster, words):
    record, t = storeys
    y = record(late_s + faster * t)
    found = check(read_campaign(campaign_folder([(0, y)], head=LONG))).findings
    assert any(words in text for text in found) and not any("looks dead" in text for text in found)


def test_a_logger_of_its_own_far_off_is_one_finding_of_both_steps(campaign_folder, storeys):
    """Its channels move with one another, so that none looks dead; modes would be found twice."""
    record, _ = storeys
    y = record(0.0)
    y[:, [1, 3]] = np.roll(y[:, [1, 3]], 9000, axis=0)
    folder = campaign_folder([(0, y)], head=LONG)
    words = "suspect: F2, F4 have nothing in common with the other channels of their direction, yet what happens stands"
    assert [t[: len(words) + 7] for t in check(read_campaign(folder)).findings if "F2" in t] == [f"{words} 15 min"]
    assert any(t.startswith(words) for t in identify(folder).notes)


def test_a_sound_record_is_identified_without_a_word_on_clocks(campaign_folder, storeys):
    folder = campaign_folder([(0, storeys[0](0.0))], head=LONG)
    assert not [t for t in identify(folder).notes if "clock" in t or t.startswith("suspect")]


def test_a_channel_of_noise_fits_at_no_time_and_no_rate(campaign_folder, storeys):
    y = storeys[0](0.0)
    y[:, 3] = np.random.default_rng(8).standard_normal(len(y))
    assert any("F4 looks dead" in text for text in check(read_campaign(campaign_folder([(0, y)], head=LONG))).findings)


def test_check_ends_where_no_delay_gathers_the_few_lines_in_common(campaign_folder, storeys):
    record, time = storeys
    assert check(read_campaign(campaign_folder([(0, record(5e-3 * time))], head=HEAD))).findings


def test_a_clock_that_runs_minutes_away_is_not_dead():
    """After a delay of a segment's length, from the sixth half hour on, channels have nothing in common."""
    dead = (Suspicion(kind=DEAD, channels=("b",)),)
    compared = [replace(b, delay_s=np.array([0.0, np.nan, 0.0]), drift=np.array([0.0, 4e-3 if k < 6 else 0.0, 0.0]),
                        suspicions=dead if k >= 6 else ()) for k, b in enumerate(blocks(0.0))]
    away = runaway_clocks(compared, CHANNELS)
    assert away["b"][0] / 0.0864 == pytest.approx(4000) and mounting_findings(compared, (), away) == []
    assert "b looks dead" in mounting_findings(compared, ())[0]


def test_a_channel_that_no_block_could_compare_is_named_and_not_blamed():
    some = [replace(b, delay_s=np.r_[b.delay_s[:-1], np.nan], drift=np.r_[b.drift[:-1], np.nan]) for b in blocks(0.0)]
    channels = [f"c{k}" for k in range(len(some[0].delay_s))]
    assert runaway_clocks(some, channels) == {}
    found, use = clock_findings(some, channels)
    assert found == [] and f"(not {channels[-1]}: " in use
