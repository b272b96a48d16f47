"""Other structures: a building at 100 Hz and a bridge at 200 Hz without a model, named modes of any kind with one."""

import h5py
import numpy as np
import pytest
from scipy import signal

import probupdate
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.identification.identify import SSISettings, identify
from probupdate.identification.proposal import propose, spectral_peaks
from probupdate.modal.modes import mac, plane_mac


def response(mass, stiffness, damping_ratio, rate_hz, n, seed, quantity="acceleration"):
    """Motion of every degree of freedom under white forces, by the modes' exact discrete recursion at ten times the
    rate; frequencies and shapes. mass, stiffness (n_dof, n_dof)."""
    root = np.linalg.cholesky(np.linalg.inv(mass))
    value, vector = np.linalg.eigh(root.T @ stiffness @ root)
    omega, shape = np.sqrt(value), root @ vector
    rng, fine, lead = np.random.default_rng(seed), 4, 4000
    step = 1 / (fine * rate_hz)
    total = np.zeros(((n + lead) * fine, len(mass)))
    force = rng.standard_normal(total.shape) @ np.linalg.cholesky(mass) @ shape
    for j, w in enumerate(omega):
        decay, turn = np.exp(-damping_ratio * w * step), w * np.sqrt(1 - damping_ratio**2) * step
        a = [1, -2 * decay * np.cos(turn), decay**2]
        total += np.outer(signal.lfilter([step**2], a, force[:, j]), shape[:, j])
    total = np.gradient(total, step, axis=0)
    if quantity == "acceleration":
        total = np.gradient(total, step, axis=0)
    record = signal.decimate(total, fine, axis=0, ftype="fir")[lead:]
    record += 0.02 * record.std() * rng.standard_normal(record.shape)
    return record / record.std(), omega / (2 * np.pi), shape


def shear_building():
    """Eight storeys, two directions of slightly different stiffness: pairs of close modes; 16 channels."""
    storeys = np.diag(np.full(8, 2.0)) - np.diag(np.ones(7), 1) - np.diag(np.ones(7), -1)
    storeys[-1, -1] = 1
    stiffness = np.kron(np.diag([1.0, 1.06]), storeys) * (2 * np.pi * 5.0) ** 2
    return np.eye(16), stiffness, [(axis, 0.0, 0.0, 3.0 * (k + 1)) for axis in "xy" for k in range(8)]


def bridge_deck():
    """A simply supported deck: seven vertical channels along 70 m, velocities."""
    n, length = 7, 80.0
    x = length * np.arange(1, n + 1) / (n + 1)
    k = np.arange(1, n + 1)
    basis = np.sin(np.pi * np.outer(x, k) / length)
    omega = 2 * np.pi * 2.4 * k**2 / 1.0
    inverse = np.linalg.inv(basis)
    return np.eye(n), inverse.T @ np.diag(omega**2) @ inverse, [("z", float(a), 0.0, 8.0) for a in x]


WAY = {"x": [1.0, 0.0, 0.0], "y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0]}


def write(folder, record, places, rate_hz, minutes, quantity):
    unit = {"acceleration": "m/s2", "velocity": "mm/s"}[quantity]
    lines = [f'name = "Other"\nsampling_rate_hz = {rate_hz}\nblock_minutes = {minutes}\n']
    for k, (axis, x, y, z) in enumerate(places):
        lines.append(f'[[sensor]]\nchannel = "c{k}"\nlevel = "z{z}"\nposition_m = [{x}, {y}, {z}]\n'
                     f'direction = {WAY[axis]}\nquantity = "{quantity}"\nunit = "{unit}"\n')
    (folder / "acceleration").mkdir()
    (folder / "campaign.toml").write_text("".join(lines))
    with h5py.File(folder / "acceleration" / "all.h5", "w") as file:
        data = file.create_dataset("data", data=record.astype(np.float32))
        data.attrs["start"], data.attrs["sampling_rate_hz"] = "2021-05-01T00:00:00Z", rate_hz
    return read_campaign(folder)


def bound(frequency_hz, damping_ratio, seconds):
    """Relative Cramer-Rao bound of a mode's frequency from a record of that length."""
    return np.sqrt(damping_ratio / (4 * np.pi * frequency_hz * seconds))


def test_a_building_at_100_hz_without_a_model(tmp_path, validation):
    row = validation(what="a building at 100 Hz without a model: f in Cramer-Rao bounds; planes of close pairs",
                     reference="exact recursion of its modes")
    mass, stiffness, places = shear_building()
    # three blocks of five minutes
    record, frequency, shape = response(mass, stiffness, 0.01, 100.0, 90000, seed=2)
    campaign = write(tmp_path, record, places, 100.0, 5, "acceleration")
    settings = SSISettings(order=24, target_rate_hz=12.5, block_rows=24, spread=8, sub_records=20)
    result = identify(campaign, None, settings=settings)
    # up to 0.9 of the Nyquist frequency of 12.5 Hz
    inside = np.flatnonzero(frequency < 5.6)
    labels = result.data.labels
    assert labels == tuple(str(k + 1) for k in range(len(labels))) and len(labels) >= 6
    assert "no SCADA: lines of a rotating machine were not looked for" in result.summary
    for s in result.data.sets:
        for j in range(4):
            error = s.frequency_hz[j] / frequency[inside[j]] - 1
            row.error(error / bound(frequency[inside[j]], 0.01, 300), below=6, of="f")
        for pair in ([0, 1], [2, 3]):
            row.least(plane_mac(s.shape[:, pair], shape[:, inside[pair]]), above=0.97, of="planes")
        assert np.isfinite(s.frequency_std_hz[:4]).all()


def test_a_bridge_at_200_hz_in_velocities(tmp_path, validation):
    row = validation(what="a bridge at 200 Hz in velocities, without a model: f in Cramer-Rao bounds; MAC",
                     reference="exact recursion of its modes")
    mass, stiffness, places = bridge_deck()
    record, frequency, shape = response(mass, stiffness, 0.012, 200.0, 48000, seed=3, quantity="velocity")
    campaign = write(tmp_path, record, places, 200.0, 2, "velocity")
    settings = SSISettings(order=12, target_rate_hz=80.0, block_rows=24, spread=6, sub_records=12)
    result = identify(campaign, None, settings=settings)
    assert result.data.labels[:3] == ("1", "2", "3")
    for s in result.data.sets:
        assert s.environment["rms_mps"] == pytest.approx(1e-3, rel=0.2) and "rms_mps2" not in s.environment
        error = s.frequency_hz[:3] / frequency[:3] - 1
        row.error(error / bound(frequency[:3], 0.012, 120), below=6, of="frequencies")
        row.least(np.diag(mac(s.shape[:, :3], shape[:, :3])), above=0.98, of="MAC")


def test_nothing_that_comes_back_is_said(tmp_path):
    rng = np.random.default_rng(0)
    campaign = write(tmp_path, rng.standard_normal((3000, 4)), [("x", 0.0, 0.0, float(k)) for k in range(4)], 10.0, 5,
                     "acceleration")
    with pytest.raises(InputError, match="no pole is stable over the model orders and the 1 blocks"):
        identify(campaign, None, settings=SSISettings(order=8, block_rows=10, target_rate_hz=10.0, sub_records=0))


def test_without_a_model_rate_order_and_rows_are_proposed_from_the_record(tmp_path):
    """The bridge above at 200 Hz, modes from 1.2 to 58.8 Hz: the rate that holds most of them and sees the lowest; what
    is given stands; of noise alone nothing is proposed."""
    mass, stiffness, places = bridge_deck()
    record, frequency, _ = response(mass, stiffness, 0.012, 200.0, 24000, seed=3, quantity="velocity")
    campaign = write(tmp_path, record, places, 200.0, 2, "velocity")
    found = propose([campaign])
    # 60 block rows cover two periods of 1.2 Hz up to 72 Hz; what such a rate does not hold is said
    assert found.target_rate_hz == pytest.approx(200 / 3) and found.block_rows >= found.target_rate_hz / 1.25
    # one of the modes is at the very end of what the rate holds, its peak on either side
    held = frequency < 0.45 * found.target_rate_hz + 0.05
    # a peak may lie anywhere in its half-power bandwidth, and on a line 0.14 Hz wide
    for peaks, true in ((found.peaks_hz, frequency[held]), (found.above_hz, frequency[~held])):
        assert np.all(np.abs(np.array(peaks) - true) < 0.012 * true + 0.07)
    assert "peaks above, from 43.3 Hz, are left to a run with another --rate" in found.sentence
    high = propose([campaign], rate_hz=200.0)
    assert high.order == 22 and len(high.peaks_hz) == 7 and high.above_hz == ()
    low = propose([campaign], rate_hz=50.0)
    assert low.target_rate_hz == 50.0 and len(low.peaks_hz) == np.sum(frequency < 25)
    assert high.sentence.startswith("settings proposed from the record: rate 200 Hz, order 22")
    settings = probupdate.IdentificationSettings(rate_hz=80.0)
    result = probupdate.identify(tmp_path, settings=settings, store=tmp_path / "blocks")
    assert "settings proposed from the record: rate 80 Hz" in result.summary
    rng = np.random.default_rng(1)
    (tmp_path / "noise").mkdir()
    noise = write(tmp_path / "noise", rng.standard_normal((24000, 7)), places, 200.0, 2, "acceleration")
    with pytest.raises(InputError, match="no peak stands out of the spectra"):
        propose([noise])


def test_modes_far_above_the_lowest_set_the_rate_and_a_steady_line_does_not(tmp_path):
    """Half an hour at 50 Hz: a close pair at 0.33 Hz, weaker modes at 1.25 and 2.2 Hz, mains folded to 20 Hz."""
    frequency, rng, data = np.array([0.33, 0.36, 1.25, 2.2]), np.random.default_rng(0), 0.0
    for f, strength in zip(frequency, (1.0, 0.8, 0.3, 0.1), strict=True):
        pole = np.exp(2 * np.pi * f / 50.0 * (-0.01 + 1j))
        motion = signal.lfilter([1], [1, -pole], rng.standard_normal(100_000))[10_000:].real
        data = data + np.outer(strength * motion / motion.std(), rng.standard_normal(4))
    data += 0.3 * np.outer(np.sin(2 * np.pi * 20 * np.arange(90_000) / 50), rng.standard_normal(4))
    data += 0.01 * rng.standard_normal(data.shape)
    found = propose([write(tmp_path, data, [("x", 0.0, 0.0, float(k)) for k in range(4)], 50.0, 30, "acceleration")])
    assert found.target_rate_hz == pytest.approx(50 / 9)
    assert np.all(np.abs(np.array(found.peaks_hz) / frequency - 1) < 0.03)
    assert np.all(np.abs(np.array(found.lines_hz) - 20) < 0.02)
    assert "steady lines at 20 Hz, as of machines or mains, set no rate" in found.sentence


def three_modes(n, seed, rate_hz=50.0, free=False):
    """(n, 3) of modes at 1.3, 2.1 and 5 Hz, 1 % of damping, white-driven or set free, with 2 % of noise."""
    rng = np.random.default_rng(seed)
    shape, record = np.array([[1.0, 1, 1], [0.6, -0.2, -1], [0.3, -1, 0.7]]), np.zeros((n, 3))
    for j, f in enumerate((1.3, 2.1, 5.0)):
        pole = np.exp((-0.01 + 1j * np.sqrt(1 - 1e-4)) * 2 * np.pi * f / rate_hz)
        force = np.eye(1, n + 2000, 2000)[0] if free else rng.standard_normal(n + 2000)
        record += np.outer(signal.lfilter([1], [1, -pole], force)[2000:].real, shape[:, j])
    return record / record.std() + 0.02 * rng.standard_normal(record.shape)


@pytest.mark.parametrize(("channels", "minutes", "free", "quantity"), [
    (1, 5, False, "acceleration"), (2, 5, False, "velocity"), (3, 5, False, "velocity"), (3, 1, True, "acceleration"),
], ids=["one channel", "two channels", "one block", "set free"])
def test_little_is_identified_too_with_what_can_be_said(channels, minutes, free, quantity, tmp_path):
    """One block; modes by number within six bounds of their frequency (set free the bound is lower), no warning."""
    record = three_modes(minutes * 3000, seed=4, free=free)[:, :channels]
    write(tmp_path, record, [("x", 0.0, 0.0, 3.0 * (k + 1)) for k in range(channels)], 50.0, minutes, quantity)
    found = probupdate.identify(tmp_path)
    known = np.array([1.3, 2.1, 5.0])
    f = found.data.sets[0].frequency_hz
    nearest = np.array([f[np.argmin(np.abs(f - k))] for k in known])
    assert np.all(np.abs(nearest / known - 1) < 6 * bound(known, 0.01, 60 * minutes))
    assert "settings proposed from the record" in found.summary
    if minutes == 1:
        assert "are short: standard deviations from" in found.summary
    assert np.isfinite(found.data.sets[0].frequency_std_hz).all()


def test_what_is_no_motion_is_refused_in_fitting_words(tmp_path):
    write(tmp_path, three_modes(3000, 1), [("x", 0.0, 0.0, 3.0)] * 3, 50.0, 1, "acceleration")
    text = (tmp_path / "campaign.toml").read_text()
    (tmp_path / "campaign.toml").write_text(text.replace('quantity = "acceleration"', 'quantity = "strain"', 1))
    with pytest.raises(InputError, match="sensor c0: measures strain, which is not a motion of a point"):
        read_campaign(tmp_path)


@pytest.mark.parametrize("lost", [0.0, 0.003])
def test_weak_modes_below_the_flanks_of_strong_ones_set_the_rate(lost):
    """Two strong modes near 0.33 Hz, white up to 10 Hz above their resonance, and modes of 2 % of their motion at 1.25
    and 2.2 Hz, whose peaks lie below that; by modal superposition with exact recursions."""
    rng, rate, level = np.random.default_rng(3), 20.0, np.linspace(0.3, 1.0, 4)
    record = 1e-3 * rng.standard_normal((36000, 8))
    for f, motion, along, shape in ((0.33, 1.0, 1, level), (0.34, 1.0, 0, level), (1.25, 0.02, 1, np.cos(4 * level)),
                                    (2.2, 0.02, 0, np.cos(7 * level))):
        pole = np.exp(2j * np.pi * f / rate * (1j * 0.01 + 1))
        # b of an acceleration: the force less what spring and damper take
        q = signal.lfilter([1.0, -2.0, 1.0], np.poly([pole, pole.conjugate()]).real, rng.standard_normal(40000))[4000:]
        record += np.outer(motion * q / q.std(), np.concatenate([along * shape, (1 - along) * shape]))
    record[rng.random(record.shape) < lost] = np.nan
    peaks = np.array([f for f, _ in spectral_peaks(record, rate)])
    for f in (0.335, 1.25, 2.2):
        assert np.min(np.abs(np.log(peaks / f))) < 0.03
    assert peaks.min() > 0.3 and peaks.max() < 2.3


def test_an_order_far_above_the_record_s_keeps_its_modes(tmp_path):
    """Two modes of three channels at order 20, by exact discretisation, twelve blocks. Poles of noise came
    back often enough to be modes, and the standard deviation of one grew when another beside it was ruled out."""
    rng, rate = np.random.default_rng(103), 10.0
    record = np.zeros((72000, 3))
    for f, motion, shape in ((0.6, 1.0, [0.4, 0.7, 1.0]), (1.45, 0.7, [0.9, 0.5, -0.8])):
        w = 2 * np.pi * f
        a = np.array([[0, 1], [-w * w, -2 * 0.012 * w]])
        b, d = signal.ss2tf(*signal.cont2discrete((a, np.eye(2)[:, 1:], a[1:], np.ones((1, 1))), 1 / rate)[:4])
        q = signal.lfilter(b.ravel(), d, rng.standard_normal(76000))[4000:]
        record += np.outer(motion * q / q.std(), shape)
    record += 0.02 * rng.standard_normal(record.shape)
    places = [(axis, 0.0, 0.0, 5.0) for axis in "xyy"]
    write(tmp_path, record, places, rate, 10, "acceleration")
    settings = probupdate.IdentificationSettings(rate_hz=5.0, order=20, block_rows=30)
    found = np.array([s.frequency_hz for s in probupdate.identify(tmp_path, settings=settings).data.sets])
    for f in (0.6, 1.45):
        assert np.sum(np.isfinite(found) & (np.abs(np.log(found / f)) < 0.02)) == 12


@pytest.mark.parametrize(("frequency", "rate", "minutes", "more"), [
    ((0.33, 0.36, 1.25, 2.2), 12.5, 30, 2), ((0.5, 0.503, 1.1, 1.9), 10.0, 20, 0)], ids=["jacket", "tower"])
def test_a_pair_is_two_modes_at_the_settings_of_the_paper(frequency, rate, minutes, more, tmp_path):
    """At 5 Hz and order 20 each pair had become one mode: 9 % apart at 1 % of damping, 0.6 % at 1.5 %."""
    rng, damping = np.random.default_rng(7), 0.01 if more else 0.015
    shapes = np.array([[1.0, 0.02, -0.6, 0.4], [0.02, 1.0, 0.05, 0.6], [0.6, 0.0, 1.0, 0.3], [0.02, 0.6, -0.05, -1.0],
                       [0.3, 0.01, 0.7, -0.3], [0.01, 0.3, -0.04, -0.8]])[: 4 + more]
    n = round(180 * minutes * rate)
    record = 0.05 * rng.standard_normal((n, len(shapes)))
    for j, w in enumerate(2 * np.pi * np.array(frequency)):
        a = np.array([[0, 1], [-w * w, -2 * damping * w]])
        b, d = signal.ss2tf(*signal.cont2discrete((a, np.eye(2)[:, 1:], a[1:], np.ones((1, 1))), 1 / rate)[:4])
        q = signal.lfilter(b.ravel(), d, rng.standard_normal(n + 4000))[4000:]
        record += np.outer(q / q.std(), shapes[:, j])
    write(tmp_path, record, [("xy"[k % 2], 0.0, 0.0, 15.0 - 3 * (k // 2)) for k in range(len(shapes))], rate, minutes,
          "acceleration")
    sets = probupdate.identify(tmp_path, settings=probupdate.IdentificationSettings(rate_hz=5.0, order=20)).data.sets
    assert all(np.isfinite(s.frequency_hz).all() and len(s.frequency_hz) == 4 for s in sets)
    for j, f in enumerate(frequency):
        apart = np.array([s.frequency_hz[j] - f for s in sets]) / [s.frequency_std_hz[j] for s in sets]
        assert np.abs(apart).max() < 4
    assert min(plane_mac(np.real(s.shape[:, :2]), shapes[:, :2]) for s in sets) > 0.98
