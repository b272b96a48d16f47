"""Two loggers of one time, each with files, names and a clock of its own, in one campaign."""

import numpy as np
import pandas as pd
import pytest

from probupdate.campaign.blocks import blocks
from probupdate.campaign.checking import check
from probupdate.campaign.converting import convert
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError

RATE, SECONDS = 10.0, 1200
HEAD = 'name = "Storeys"\nsampling_rate_hz = 10.0\nblock_minutes = 10\n' + "".join(
    f'[[sensor]]\nchannel = "F{k}"\nlevel = "F{k}"\nposition_m = [0.0, 0.0, {3.0 * k}]\n'
    'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n' for k in range(1, 5))
OF_ONE = '[[logger]]\nfiles = "one*.csv"\n[logger.columns]\nF1 = "a"\nF3 = "b"\n'
OF_TWO = '[[logger]]\nfiles = "two*.csv"\nseparator = ";"\n[logger.columns]\nF2 = "a"\nF4 = "b"\n'


def motion(t_s):
    """(n, 4) four storeys at any times, sums of sinusoids of three modes with random phases."""
    rng = np.random.default_rng(3)
    shape = np.sin(np.outer(np.arange(1, 5) / 4, np.pi / 2 * np.array([1, 3, 5])))
    found = np.zeros((len(t_s), 4))
    for j, f0 in enumerate((0.5, 1.4, 2.3)):
        for f, phase in zip(f0 * (1 + 0.02 * rng.standard_normal(40)), rng.uniform(0, 2 * np.pi, 40), strict=True):
            found += np.outer(np.cos(2 * np.pi * f * t_s + phase), shape[:, j] / 6)
    return found


@pytest.fixture
def loggers(tmp_path):
    def make(*, between_s=0.0, late_s=0.0, first_s=0.0, noise=0.0, words=OF_ONE + OF_TWO):
        """Samples of the second lie between the first's, its clock is late, and it begins later."""
        raw, camp = tmp_path / "raw", tmp_path / "camp"
        raw.mkdir()
        camp.mkdir()
        t = np.arange(int(SECONDS * RATE)) / RATE
        for name, columns, sep, since in (("one", [0, 2], ",", 0.0), ("two", [1, 3], ";", first_s + between_s)):
            stamps = t[t < SECONDS - since] + since
            read = motion(stamps - (late_s if name == "two" else 0.0))[:, columns]
            read += noise * np.random.default_rng(len(columns) + columns[0]).standard_normal(read.shape)
            table = pd.DataFrame(0.1 * read, columns=["a", "b"])
            table.insert(0, "t", [x.strftime("%Y-%m-%dT%H:%M:%S.%f") for x in
                                  pd.Timestamp("2024-05-01T10:00Z") + pd.to_timedelta(stamps.round(6), unit="s")])
            table.to_csv(raw / f"{name}.csv", sep=sep, index=False)
        (camp / "campaign.toml").write_text(HEAD)
        (camp / "convert.toml").write_text(f'time = "t"\nzone = "UTC"\n{words}')
        return raw, camp

    return make


@pytest.mark.parametrize("between_s", [0.0, 0.033, 0.05])
def test_joined_samples_are_those_of_one_time(loggers, between_s):
    raw, camp = loggers(between_s=between_s)
    convert(raw, camp)
    whole = [b for b in blocks(read_campaign(camp)) if not b.excluded]
    assert len(whole) == 2
    for block in whole:
        since = (block.start - pd.Timestamp("2024-05-01T10:00Z")).total_seconds()
        right = 0.1 * motion(since + np.arange(len(block.data)) / RATE)
        there = np.isfinite(block.data)
        # splines of degree five at a quarter of the rate; eight samples at each end
        assert there.mean() > 0.996 and np.abs(block.data - right)[there].max() < 0.01 * right.std()


def test_what_one_logger_lacks_is_lost_and_said(loggers):
    raw, camp = loggers(first_s=540.0)
    convert(raw, camp)
    first, second = blocks(read_campaign(camp))
    assert "F2" in first.excluded and "F1" not in first.excluded and not second.excluded
    assert first.missing == pytest.approx([0, 0.9, 0, 0.9], abs=1e-3)


def test_a_late_logger_is_seen_by_its_clock(loggers):
    raw, camp = loggers(between_s=0.02, late_s=0.3, noise=0.05)
    convert(raw, camp)
    late = [t for t in check(read_campaign(camp)).findings if "the clock of F2, F4 is" in t]
    assert len(late) == 1 and float(late[0].split("is ")[1].split(" +-")[0]) == pytest.approx(150, abs=3)


@pytest.mark.parametrize(("words", "problem"), [
    (OF_ONE, "F2: is a column of no logger"), (OF_ONE + OF_TWO.replace("F2", "F3"), "is a column of"),
    (OF_ONE + OF_TWO.replace("two*", "*"), "is a file of two loggers"),
    ('[[logger]]\nfiles = "*.csv"\n', "does not say which channels are its own"),
    ("logger = 3\n", "is not a list of tables"), (OF_ONE + OF_TWO.replace("F2", "F7"), "'F7' is not a channel")])
def test_loggers_that_are_not_told_apart_are_refused(loggers, words, problem):
    raw, camp = loggers(words=words)
    with pytest.raises(InputError, match="convert.toml|csv") as error:
        convert(raw, camp)
    assert problem in str(error.value)
