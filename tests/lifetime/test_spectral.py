"""Damage from spectral moments beside counted cycles, and beside other programs where they are installed."""

import importlib
import importlib.util

import numpy as np
import pytest
from gaussian_record import gaussian_record
from scipy.integrate import quad

from probupdate.errors import InputError
from probupdate.lifetime.spectral import (
    METHODS,
    ORDERS,
    Curve,
    counted_share,
    dirlik,
    moments,
    park,
    rainflow,
    ranges,
    tovo_benasciutti,
)

# DNV-RP-C203 (2011), T in seawater with cathodic protection
T_CURVE = Curve(log10_a1=11.764, m1=3.0, log10_a2=15.606, m2=5.0)
F = np.linspace(0.02, 3.0, 1500)


def bimodal(low=0.1, high=0.32, share=0.2):
    """MPa^2/Hz: a swell-like and a resonant peak, as a jacket's member has them."""
    return 400 * (
        np.exp(-0.5 * ((F - low) / 0.02) ** 2) + share * 4 / ((1 - (F / high) ** 2) ** 2 + (0.05 * F / high) ** 2) / 400
    )


SPECTRA = {"two peaks": bimodal(), "broad": 30 * np.exp(-F), "resonance alone": bimodal(share=50.0)}


def needs(package):
    """Skips a test where a program that is in no lock file is not installed; before its row of the tables begins."""
    return pytest.mark.skipif(importlib.util.find_spec(package) is None, reason=f"{package} is not installed")


def test_cycles_of_the_standards_example():
    # ASTM E1049-85, Fig. 6: -2 1 -3 5 -1 3 -4 4 -2
    found, count = rainflow(np.array([-2, 1, -3, 5, -1, 3, -4, 4, -2], float))
    held = {r: count[found == r].sum() for r in np.unique(found)}
    assert held == {3: 0.5, 4: 1.5, 6: 0.5, 8: 1.0, 9: 0.5}


def test_samples_held_twice_add_and_lose_no_cycle():
    # as a converter's steps hold them; rust-fatigue 0.1.9 loses every peak (findings/rust_fatigue_plateaus.sh)
    record = np.round(8 * np.random.default_rng(3).standard_normal(400))
    for found, expected in zip(rainflow(np.repeat(record, 2)), rainflow(record), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_slopes_are_chosen_by_ranges_times_their_factor():
    # qats 5.5.0 chooses by the range alone (findings/qats_thick_plates.sh)
    m = moments(F, bimodal())
    assert ranges(m).damage(T_CURVE, 1.32) == pytest.approx(ranges(1.32**2 * m).damage(T_CURVE), rel=1e-12)


@pytest.mark.parametrize("name", list(SPECTRA))
@pytest.mark.parametrize("method", METHODS)
def test_spectral_damage_is_that_of_counted_cycles(name, method, validation):
    checked = validation(what="Park; Dirlik; Tovo and Benasciutti, three spectra",
                         reference="rainflow counting of simulated records, 33 hours",
                         why="the methods are fits, of the range and of damage with two slopes")
    spectrum = SPECTRA[name]
    rng, seconds, rate = np.random.default_rng(4), 40_000, 20.0
    counted = {3: 0.0, 5: 0.0, "two slopes": 0.0}
    repeats = 3
    for _ in range(repeats):
        stress, count = rainflow(gaussian_record(F, spectrum, rate_hz=rate, n_sample=int(seconds * rate), rng=rng))
        for m in (3, 5):
            counted[m] += np.sum(count * stress**m) / seconds / repeats
        counted["two slopes"] += np.sum(count / T_CURVE.cycles(stress)) / seconds / repeats
    one = ranges(moments(F, spectrum), method)
    # of stress ranges; the methods are fits, said to be within some per cent of damage
    for m, tolerance in ((3, 0.03), (5, 0.04)):
        checked.error((one.moment(m) / counted[m]) ** (1 / m) - 1, below=tolerance, of=f"m = {m}")
    checked.error(one.damage(T_CURVE) / counted["two slopes"] - 1, below=0.25, of="damage")


def stress_of(wind, swell, resonance, *, period=14.0, mode=0.3, ratio=0.015):
    """Frequencies from 1/600 Hz and MPa^2/Hz of slow wind, swell and a resonance with these variances (MPa^2)."""
    f = np.unique(np.r_[np.geomspace(1 / 600, 3, 800), mode * (1 + np.linspace(-0.3, 0.3, 400))])
    fp = 1 / period
    peak = 5.0 ** np.exp(-0.5 * ((f / fp - 1) / np.where(f <= fp, 0.07, 0.09)) ** 2)
    parts = ((1 + 200 * f) ** (-5 / 3) / (1 + (20 * f) ** 4), f**-5.0 * np.exp(-1.25 * (fp / f) ** 4) * peak,
             1 / ((1 - (f / mode) ** 2) ** 2 + (2 * ratio * f / mode) ** 2) / (1 + f**4))
    return f, sum(v * part / np.trapezoid(part, f) for v, part in zip((wind, swell, resonance), parts, strict=True))


def in_ten_minutes(f, spectrum, repeats=120):
    """Damage of T_CURVE a second by counting records of ten minutes one by one, and its standard error."""
    rng, found = np.random.default_rng(11), []
    for _ in range(repeats):
        pieces = gaussian_record(f, spectrum, rate_hz=10.0, n_sample=24_000, rng=rng).reshape(4, -1)
        for stress, count in map(rainflow, pieces):
            found.append(np.sum(count / T_CURVE.cycles(stress)) / 600)
    return np.mean(found), np.std(found) / np.sqrt(len(found))


@pytest.mark.parametrize("variances", [(500, 130, 350), (250, 600, 90), (400, 0, 150), (50, 700, 400)])
def test_damage_of_swell_beside_a_resonance_and_slow_wind(variances, validation):
    row = validation(what="Park, spectra of slow wind, swell and a resonance, damage of two slopes",
                     reference="rainflow counting of 480 records of ten minutes",
                     why="a fit; pieces of ten minutes lose up to 9 % by slow cycles; standard error 0.02")
    f, spectrum = stress_of(*variances)
    counted, error = in_ten_minutes(f, spectrum)
    assert error < 0.04 * counted
    row.error(park(moments(f, spectrum)).damage(T_CURVE) / counted - 1, below=0.17)


def test_shares_of_cycles_are_none_below_zero_for_any_spectrum():
    """Slopes, resonances and humps of any variance between 1/600 and 3 Hz; no range above those of a narrow band."""
    rng, f = np.random.default_rng(0), np.geomspace(1 / 600, 3, 600)
    for _ in range(400):
        spectrum = np.zeros_like(f)
        for kind in rng.integers(3, size=rng.integers(1, 5)):
            at = np.exp(rng.uniform(np.log(f[0]), np.log(f[-1])))
            ratio, width = 10 ** rng.uniform(-2.3, -0.5), rng.uniform(0.02, 1)
            part = (f ** rng.uniform(-4, 3), 1 / ((1 - (f / at) ** 2) ** 2 + (2 * ratio * f / at) ** 2),
                    np.exp(-0.5 * (np.log(f / at) / width) ** 2))[kind]
            spectrum += 10 ** rng.uniform(-6, 2) * part / np.trapezoid(part, f)
        m = moments(f, spectrum)
        one = park(m)
        assert min(map(float, one.weight)) >= 0
        for k, rayleigh in ((3, 1.329340388), (5, 3.323350970)):
            highest = np.sqrt(m[3] / m[2]) * (2 * np.sqrt(2 * m[0])) ** k * rayleigh
            assert 0 < one.moment(k) <= 1.001 * highest


def test_dirliks_moment_is_the_integral_of_his_density(validation):
    row = validation(what="moments of Dirlik's density, two slopes", reference="quadrature", why="quadrature")
    one = dirlik(moments(F, SPECTRA["two peaks"]))

    def density(s):
        return sum(
            float(w) * (np.exp(-s / c) / c if k == "e" else s / c**2 * np.exp(-0.5 * (s / c) ** 2))
            for w, c, k in zip(one.weight, map(float, one.scale), one.kind, strict=True)
        )

    row.error(quad(density, 0, np.inf)[0] - 1, below=1e-8)
    for m in (3.0, 5.0):
        integral = quad(lambda s, m=m: s**m * density(s), 0, 2000, limit=400)[0]
        row.error(one.moment(m) / (one.rate * integral) - 1, below=1e-8)
    knee = T_CURVE.knee_mpa
    assert knee == pytest.approx(83.4, abs=0.05)
    # damage of a cycle is far below what quad takes for nothing, 1.5e-8
    direct = quad(lambda s: density(s) / T_CURVE.cycles(s), 0, 2000, points=[knee], limit=400, epsabs=0)[0]
    row.error(one.damage(T_CURVE) / (one.rate * direct) - 1, below=1e-8)
    # every range a tenth larger
    more = quad(lambda s: density(s) / T_CURVE.cycles(1.1 * s), 0, 2000, points=[knee / 1.1], limit=400, epsabs=0)[0]
    row.error(one.damage(T_CURVE, 1.1) / (one.rate * more) - 1, below=1e-8)


@pytest.mark.parametrize("damping", [0.01, 0.03])
def test_ten_minute_records_lose_of_slow_cycles_what_is_stated(damping, validation):
    """Kaimal's turbulence on a rotor from 1/600 Hz, 85 % of the variance, beside a resonance at 0.3 Hz: two hundred
    hours in pieces of ten minutes. With all of the slow cycles, damage of steep curves is 7 % and more above it."""
    f = np.unique(np.concatenate([np.geomspace(1 / 600, 1.5, 1500), np.linspace(0.27, 0.33, 300)]))
    wind = (1 + 200 * f) ** (-5 / 3) / (1 + (5 * f) ** (4 / 3)) ** 2
    tower = np.where(f > 0.1, 1 / ((1 - (f / 0.3) ** 2) ** 2 + (2 * damping * f / 0.3) ** 2), 0.0)
    spectrum = 0.85 * wind / np.trapezoid(wind, f) + 0.15 * tower / np.trapezoid(tower, f)
    rate, n = 5.0, 3000
    record = gaussian_record(f, spectrum, rate_hz=rate, n_sample=1200 * n, rng=np.random.default_rng(8))
    record *= np.sqrt(np.trapezoid(spectrum, f)) / np.std(record)
    row = validation(what="damage of slow wind beside a resonance, 85 % of the variance slow, m = 3 and 5",
                     reference="rainflow counts of 200 hours in ten-minute pieces", why="Park's fit, 200 hours")
    pieces = [rainflow(piece) for piece in record.reshape(-1, n)]
    for m in (3.0, 5.0):
        counted = sum(float(np.sum(count * size**m)) for size, count in pieces) / (len(record) / rate)
        row.error(park(moments(f, spectrum * counted_share(f))).moment(m) / counted - 1, below=0.06, of=f"m = {m:g}")
    assert park(moments(f, spectrum)).moment(5.0) / counted > 1.06


def test_a_narrow_band_is_rayleighs():
    # one sine's moments: S^m has (2 sqrt 2 sigma)^m Gamma(1 + m / 2)
    m = np.array([100.0 * 0.3**k for k in ORDERS])
    for method in (park, dirlik, tovo_benasciutti):
        expected = 0.3 * (2 * np.sqrt(2) * 10) ** 3 * 1.329340388
        assert method(m).moment(3.0) == pytest.approx(expected, rel=1e-6)


def test_moments_take_complex_steps():
    m = moments(F, SPECTRA["two peaks"])
    unit = np.eye(len(m))
    for method in (park, dirlik, tovo_benasciutti):
        for k in range(len(m)):
            step = m + 1e-30j * m[k] * unit[k]
            exact = np.imag(np.log(method(step).moment(5.0))) / 1e-30
            h = 1e-5
            up, down = (np.log(method(m + s * h * m[k] * unit[k]).moment(5.0)) for s in (1, -1))
            assert exact == pytest.approx((up - down) / (2 * h), rel=1e-6, abs=1e-8)


def test_a_spectrum_of_nothing_is_refused():
    with pytest.raises(InputError, match="not all finite and positive"):
        dirlik(np.zeros(4))
    with pytest.raises(InputError, match="choose from park"):
        ranges(np.ones(4), "rain")


# other programs, where they are installed ----------------------------------------------------------------------------


@needs("rainflow")
def test_counting_is_that_of_the_rainflow_package(validation):
    theirs = importlib.import_module("rainflow")
    row = validation(what="rainflow counting of a record: cycles; sum of fourth powers",
                     reference="rainflow 3.2.0, where installed", why="rounding")
    record = gaussian_record(F, SPECTRA["two peaks"], rate_hz=10.0, n_sample=5000, rng=np.random.default_rng(2))
    found, count = rainflow(record)
    other = [(c[0], c[2]) for c in theirs.extract_cycles(record)]
    row.error(np.sum(count) / sum(c for _, c in other) - 1, 1e-12, "cycles")
    row.error(np.sum(count * found**4) / sum(c * r**4 for r, c in other) - 1, 1e-12, "fourth powers")


@needs("fatpack")
def test_ranges_are_fatpacks_but_for_what_is_left_over(validation):
    fatpack = importlib.import_module("fatpack")
    row = validation(what="rainflow counting of a long record: sum of fourth powers",
                     reference="fatpack 0.7.8, where installed",
                     why="its levels; left-over half cycles are whole ones there")
    record = gaussian_record(F, SPECTRA["two peaks"], rate_hz=10.0, n_sample=200_000, rng=np.random.default_rng(2))
    found, count = rainflow(record)
    other = fatpack.find_rainflow_ranges(record, k=2**16)
    # half cycles here, one whole cycle there; and levels of 2^-16 of the range
    row.error(np.sum(count * found**4) / np.sum(other**4.0) - 1, 5e-3)


@needs("FLife")
def test_ranges_are_flifes(validation):
    flife = importlib.import_module("FLife")
    row = validation(what="Park; Dirlik; Tovo and Benasciutti, three spectra, m = 3 and 5",
                     reference="FLife 2.3, where installed", why="rounding")
    for spectrum in SPECTRA.values():
        data, m = flife.SpectralData(input={"PSD": spectrum, "f": F}), moments(F, spectrum)
        pairs = [(flife.Dirlik, dirlik), (flife.TovoBenasciutti, tovo_benasciutti)]
        if flife.Park(data).parameters["C_r1"] > 0:
            # of a resonance alone its first share is below zero there, and none here
            pairs.append((flife.Park, park))
        for method, own in pairs:
            for k in (3.0, 5.0):
                # of amplitudes there
                row.error(2**k / method(data).get_life(C=1.0, k=k) / float(own(m).moment(k)) - 1, 1e-9)
