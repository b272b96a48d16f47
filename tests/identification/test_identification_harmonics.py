"""The rotor's multiples taken out where its angle can be followed, and nothing taken out where it cannot."""

import h5py
import numpy as np
import pytest
from one_record import identify_poles
from scipy import signal

from probupdate.campaign.blocks import block_files
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.identification.block_poles import BlockSettings, identify_block
from probupdate.identification.harmonics import without_harmonics

RATE = 5.0


def rotor(seed: int, rpm: float, wander: float = 0.01, n: int = 9000) -> np.ndarray:
    """(n,) angle in rad of a rotor whose speed wanders by `wander` within 40 s."""
    rng = np.random.default_rng([seed, 1])
    decay = np.exp(-1 / (40 * RATE))
    change = signal.lfilter([np.sqrt(1 - decay**2)], [1, -decay], rng.standard_normal(n + 2000))[2000:]
    return 2 * np.pi * np.cumsum(rpm / 60 * (1 + wander * change)) / RATE


def lines(angle: np.ndarray, shape: np.ndarray, three: float, six: float) -> np.ndarray:
    """3P and 6P that bend as the third and fourth mode do, at phases of their own."""
    return three * np.outer(np.cos(3 * angle + 0.4), shape[:, 3]) + six * np.outer(np.cos(6 * angle + 1.1), shape[:, 2])


def test_lines_go_and_the_random_motion_stays(jacket, validation):
    """6P at 1.24 Hz, 4 % below torsion at 1.29 Hz and larger. What is left of the lines, with what is lost of the
    random motion, is below a tenth of their power: the angle is as good as the noise beside 3P lets it be, here 0.1 rad
    and twice that at 6P."""
    row = validation(what="rotor harmonics taken out of a record: power left, 6P beside a mode",
                     reference="the record without them", why="the angle is as good as the noise beside 3P allows")
    random = jacket.record(9000, seed=3)
    added = lines(rotor(3, 12.4), jacket.shape, 0.2, 0.2)
    found = without_harmonics(random + added, RATE, (12.0, 12.8))
    assert found.followed and set(found.removed) == {3, 6}
    wrong = found.record - random
    row.error(np.mean(wrong**2) / np.mean(added**2), below=0.1)
    speed = 60 * RATE / (2 * np.pi) * np.gradient(rotor(3, 12.4))
    smooth = np.convolve(speed, np.ones(100) / 100, mode="same")
    inside = slice(200, -200)
    assert np.std(found.speed_rpm[inside] - smooth[inside]) < 0.5 * np.std(smooth[inside])


def test_what_a_line_does_to_a_mode_s_damping_is_mostly_undone(jacket):
    """Four half hours, 6P 2.3 % below torsion and as large: the mode's mean damping ratio rises by about a third, as it
    takes in some of the line; at least half of that goes again. (A weak pole of the line may stay.)"""
    f, damping = jacket.frequency_hz[2], []
    for seed in range(10, 14):
        random = jacket.record(9000, seed=seed)
        both = random + lines(rotor(seed, 12.6), jacket.shape, 0.2, 0.2)
        rest = without_harmonics(both, RATE, (12.2, 13.0)).record
        damping.append([])
        for record in (random, both, rest):
            poles, _ = identify_poles(record, RATE, order=20, block_rows=30)
            near = np.argmin(np.where(poles.damping_ratio > 0, np.abs(poles.frequency_hz / f - 1), np.inf))
            damping[-1].append(poles.damping_ratio[near])
    clean, spoiled, mended = np.mean(damping, axis=0)
    assert spoiled > 1.15 * clean and abs(mended - clean) < 0.5 * (spoiled - clean)


@pytest.mark.parametrize("seed", range(3))
def test_without_lines_nothing_is_followed_and_nothing_changes(jacket, seed):
    record = jacket.record(9000, seed=seed)
    for speed in ((6.0, 6.8), (12.6, 13.2), (7.0, 13.0)):
        found = without_harmonics(record, RATE, speed)
        assert not found.followed and "does not predict" in found.reason
        assert (found.record == record).all() and found.removed == {} and np.isnan(found.speed_rpm).all()


def test_two_lines_that_are_no_multiples_of_one_speed_are_left(jacket):
    """A pump at 0.62 Hz and another at 1.30 Hz: the first does not predict the second."""
    t = np.arange(9000) / RATE
    other = 0.2 * np.outer(np.cos(2 * np.pi * 0.62 * t), jacket.shape[:, 3])
    other += 0.2 * np.outer(np.cos(2 * np.pi * 1.30 * t), jacket.shape[:, 2])
    assert not without_harmonics(jacket.record(9000, seed=1) + other, RATE, (12.2, 12.7)).followed


@pytest.mark.parametrize(("speed", "reason"), [
    ((np.nan, np.nan), "no rotor speed"), ((0.2, 0.6), "stood or idled"), ((45.0, 46.0), "do not both lie below"),
])
def test_where_it_cannot_be_followed_the_reason_is_said(jacket, speed, reason):
    found = without_harmonics(jacket.record(9000, seed=1), RATE, speed)
    assert not found.followed and reason in found.reason


def test_short_and_broken_records(jacket):
    assert "shorter than 400 s" in without_harmonics(jacket.record(1000, seed=1), RATE, (12.0, 13.0)).reason
    with pytest.raises(InputError, match="holds NaN"):
        without_harmonics(np.full((3000, 2), np.nan), RATE, (12.0, 13.0))


@pytest.mark.parametrize("lossy", [False, True])
def test_lines_over_gaps_are_said_where_the_record_lacks_samples(tmp_path, jacket, lossy):
    data = jacket.record(9000, seed=3) + lines(rotor(3, 12.4), jacket.shape, 0.2, 0.2)
    if lossy:
        data[4000:4015, 2] = np.nan
    (tmp_path / "acceleration").mkdir()
    text = f'name = "Gaps"\nsampling_rate_hz = {RATE}\nblock_minutes = 30\n'
    for k in range(data.shape[1]):
        text += (f'[[sensor]]\nchannel = "A{k}"\nlevel = "{k}"\nposition_m = [0.0, 0.0, {3.0 * k}]\n'
                 'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n')
    (tmp_path / "campaign.toml").write_text(text)
    with h5py.File(tmp_path / "acceleration" / "0.h5", "w") as file:
        file.create_dataset("data", data=data)
        file["data"].attrs["start"], file["data"].attrs["sampling_rate_hz"] = "2024-05-01T00:00:00Z", RATE
    campaign = read_campaign(tmp_path)
    (start, files), = block_files(campaign).items()
    found = identify_block(campaign, start, files, BlockSettings(harmonics="remove", sub_records=0), (12.0, 12.8))
    assert any(note.startswith("harmonics taken out: 3P, 6P") for note in found.notes)
    assert any("straight lines" in note for note in found.notes) == lossy
