"""Modes at the greatest likelihood of a record's spectra: against Cramer and Rao's bound, an independent likelihood,
and what must leave a mode as SSI-cov has it."""

import numpy as np
from scipy import optimize, signal

from probupdate.identification.order_average import ModePoles
from probupdate.identification.refinement import groups, refine_modes
from probupdate.identification.spectral_likelihood import Spectrum, Start, fit
from probupdate.modal.modes import CovarianceFactors, mac, plane_mac

RATE = 5.0
SHAPE = np.array([[1.0, 0.3], [0.8, -0.6], [0.5, 1.0], [0.2, -0.8], [0.1, 0.4]])


def response(line, f, zeta):
    return -(line**2) / (f**2 - line**2 + 2j * zeta * f * line)


def complex_normal(rng, *size):
    return (rng.standard_normal(size) + 1j * rng.standard_normal(size)) / np.sqrt(2)


def spectrum(rng, f, zeta, shape, *, seconds, noise, slope=0.0):
    """Lines drawn from the model itself."""
    line = np.arange(1, int(2.2 * seconds)) / seconds
    forced = response(line[:, None], f, zeta) * complex_normal(rng, len(line), len(f)) * line[:, None] ** (slope / 2)
    value = forced @ shape.T + np.sqrt(noise) * complex_normal(rng, len(line), len(shape))
    return Spectrum(line_hz=line, value=value, seconds=seconds)


def record(rng, f, zeta, shape, *, seconds=1800.0, noise=0.1, swell=0.0):
    """Accelerations (n_sample, n_channel) by scipy's oscillators under white forces, at four times the rate; swell:
    relative size by which the forces grow and fade within five minutes."""
    n = int(seconds * RATE)
    low, motion = signal.firwin(81, 0.9 * RATE / 2, fs=4 * RATE), np.empty((n, len(f)))
    grows = np.exp(swell * np.sin(2 * np.pi * np.arange(4 * n + 2000) / (300 * 4 * RATE)))
    for j, (w, z) in enumerate(zip(2 * np.pi * np.array(f), zeta, strict=True)):
        b, a, _ = signal.cont2discrete(([1.0, 0, 0], [1.0, 2 * z * w, w * w]), 1 / (4 * RATE), method="zoh")
        force = grows * rng.standard_normal(4 * n + 2000)
        motion[:, j] = np.convolve(signal.lfilter(b.ravel(), a, force), low, "same")[2000::4]
    y = motion @ shape.T
    y += noise * y.std() * rng.standard_normal(y.shape)
    return y - y.mean(axis=0)


def begun(f, zeta, shape, std=0.02):
    """Modes as SSI-cov might have them, with the standard deviations it states."""
    ones = np.zeros((len(f), 30))
    ones[:, 0] = 1
    return ModePoles(frequency_hz=np.array(f), damping_ratio=np.array(zeta), shape=shape.astype(complex),
                     factors=CovarianceFactors(ln_frequency=ones * 0.1 * std, damping_ratio=ones * std * 0.2,
                                               shape=np.zeros((*shape.shape, 30), complex)))


def test_a_single_mode_scatters_as_the_bound(validation):
    """Au's uncertainty laws (2017, Operational modal analysis, 15) with the band's factors; here the band is as wide as
    they go, so that their limit remains: var ln f = zeta / (2 pi N), var ln zeta = 1 / (2 pi zeta N), N cycles."""
    row = validation(what="modes at the greatest likelihood of 120 spectra: scatter over the bound, stated over "
                     "scatter, bias of damping", reference="Au's uncertainty laws; spectra drawn with numpy",
                     why="0.9 to 1.25 and three standard errors of 6.5 %")
    rng, f, zeta, seconds = np.random.default_rng(5), np.array([0.8]), np.array([0.02]), 1800.0
    found = []
    for _ in range(120):
        one = fit(spectrum(rng, f, zeta + 1 / (2 * np.pi * f * seconds), SHAPE[:, :1], seconds=seconds, noise=1e-3),
                  Start(n_group=1, frequency_hz=f * 1.005, damping_ratio=zeta * 1.3, shape=SHAPE[:, :1] + 0.05,
                        level=np.array([1.5])), 30, 20.0)
        assert one.converged and mac(one.shape, SHAPE[:, :1])[0, 0] > 0.9995
        found.append([np.log(one.frequency_hz[0] / 0.8), one.damping_ratio[0] / 0.02, one.ln_frequency_std[0],
                      one.damping_std[0] / 0.02, one.misfit])
    found = np.array(found)
    cycles = 0.8 * seconds
    bound = np.sqrt([0.02 / (2 * np.pi * cycles), 1 / (2 * np.pi * 0.02 * cycles)])
    scatter = found[:, :2].std(axis=0, ddof=1)
    row.between(scatter / bound, 0.8, 1.4, of="scatter")
    row.between(np.median(found[:, 2:4], axis=0) / scatter, 0.75, 1.25, of="stated")
    row.error(found[:, 1].mean() - 1, below=0.03, of="bias")
    assert 0.9 < np.median(found[:, 4]) < 1.1


def test_the_likelihood_of_every_line_has_the_same_maximum(validation):
    """An independent likelihood, line by line and without priors, minimised by Nelder and Mead; its second differences
    give the standard deviations once more."""
    row = validation(what="f, damping and their standard deviations at the greatest likelihood",
                     reference="likelihood of every line, minimised by differences, its second differences",
                     why="bins of a quarter of a half-width; priors", unit="")
    rng, f, zeta, seconds = np.random.default_rng(8), 0.7, 0.02, 3600.0
    drawn = spectrum(rng, np.array([f]), np.array([zeta]), SHAPE[:, :1], seconds=seconds, noise=0.3)
    one = fit(drawn, Start(n_group=1, frequency_hz=np.array([f]), damping_ratio=np.array([zeta]), shape=SHAPE[:, :1],
                           level=np.ones(1)), 30, 20.0)
    unit = SHAPE[:, 0] / (SHAPE[:, 0] @ SHAPE[:, 0])
    inside = (drawn.line_hz > 0.6 * f) & (drawn.line_hz < f * (1 + 20 * (zeta + 1 / (2 * np.pi * f * seconds))))
    line, power = drawn.line_hz[inside], np.abs(drawn.value[inside] @ unit) ** 2
    size = 1 / (SHAPE[:, 0] @ SHAPE[:, 0])

    def half_deviance(x):
        model = np.exp(x[2]) * np.abs(response(line, f * (1 + zeta * x[0]), zeta * np.exp(x[1]))) ** 2 * (
            line / f) ** x[3] + np.exp(x[4]) * size
        return np.sum(np.log(model) + power / model)

    best = optimize.minimize(half_deviance, [0, 0, 0, 0, np.log(0.3)], method="Nelder-Mead",
                             options={"maxiter": 6000, "maxfev": 6000, "xatol": 1e-6, "fatol": 1e-8}).x
    step = 0.02
    curvature = np.array([[sum(a * b * half_deviance(best + step * (a * np.eye(5)[i] + b * np.eye(5)[j]))
                               for a in (-1, 1) for b in (-1, 1)) / (4 * step**2) for j in range(5)] for i in range(5)])
    std = np.sqrt(np.diag(np.linalg.inv(curvature)))[:2]
    there = np.array([(one.frequency_hz[0] / f - 1) / zeta,
                      np.log((one.damping_ratio[0] + 1 / (2 * np.pi * f * seconds)) / zeta) + std[1] ** 2])
    row.error((there - best[:2]) / std, below=0.25, of="values, in standard deviations")
    mine = np.array([one.ln_frequency_std[0], one.damping_std[0]]) / zeta
    row.error(mine / std - 1, below=0.15, of="standard deviations")


def test_a_close_pair_is_found_together_and_its_plane_is_sharp():
    """One per cent apart at one and a half per cent damping, begun from shapes turned in and out of their plane."""
    rng, f, zeta, seconds = np.random.default_rng(3), np.array([0.8, 0.808]), np.array([0.015, 0.012]), 3600.0
    assert groups(f, zeta, np.arange(2)) == [[0, 1]]
    wrong = SHAPE @ np.array([[1.0, 0.4], [-0.4, 1.0]]) + 0.02 * rng.standard_normal(SHAPE.shape)
    errors, start = [], Start(n_group=2, frequency_hz=f * [0.999, 1.001], damping_ratio=zeta * [1.2, 0.9], shape=wrong,
                              level=np.ones(2))
    for _ in range(12):
        one = fit(spectrum(rng, f, zeta, SHAPE, seconds=seconds, noise=1e-3), start, 30, 20.0)
        assert one.converged
        errors.append(np.log(one.frequency_hz / f) / one.ln_frequency_std)
        assert plane_mac(one.shape, SHAPE) > 0.9999 > plane_mac(wrong, SHAPE)
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_a_force_that_falls_with_frequency_moves_nothing():
    rng, f, zeta = np.random.default_rng(4), np.array([0.6, 1.1]), np.array([0.02, 0.02])
    poles, found = begun(f, zeta, SHAPE), []
    for _ in range(15):
        drawn = spectrum(rng, f, zeta, SHAPE, seconds=1800.0, noise=1e-3, slope=-4.0)
        one = fit(drawn, Start(n_group=1, frequency_hz=f, damping_ratio=zeta, shape=poles.shape.real,
                               level=np.array([8.0, 0.7])), 30, 20.0)
        found.append(np.log(one.frequency_hz[0] / f[0]) / one.ln_frequency_std[0])
    assert abs(np.mean(found)) < 3 / np.sqrt(15)


def test_forces_that_grow_and_fade_widen_what_is_stated():
    """The parts of a record scatter more than its information says; what is stated follows."""
    rng, f, zeta = np.random.default_rng(6), [0.8, 1.6], [0.01, 0.01]
    stated = {}
    for swell in (0.0, 1.2):
        taken = []
        for _ in range(20):
            poles, by_likelihood = refine_modes(record(rng, f, zeta, SHAPE, swell=swell), RATE, begun(f, zeta, SHAPE),
                                                highest_hz=2.25)
            taken += list(np.linalg.norm(poles.factors.ln_frequency, axis=1)[by_likelihood])
        assert len(taken) >= 20
        stated[swell] = np.median(taken)
    assert stated[1.2] > 1.15 * stated[0.0]


def sea_record(rng, f, zeta, shape, seconds=1800.0):
    """Accelerations under forces that fall by the eighth power of frequency onto a white floor, of two modes from one
    source, which drives a mode above the band too."""
    n, fs = int(seconds * RATE), 4 * RATE
    low, motion = signal.firwin(81, 0.9 * RATE / 2, fs=fs), []
    source, far = rng.standard_normal(4 * n + 2000), [3.1]
    for j, (one, z) in enumerate(zip([*f, *far], [*zeta, 0.01], strict=True)):
        w = 2 * np.pi * one
        b, a, _ = signal.cont2discrete(([1.0, 0, 0], [1.0, 2 * z * w, w * w]), 1 / fs, method="zoh")
        sea = signal.butter(4, 0.55 * one, fs=fs, output="sos")
        force = source if j == len(f) else rng.standard_normal(len(source)) + 12 * signal.sosfilt(
            sea, source if j % 2 == 0 else rng.standard_normal(len(source)))
        motion.append(np.convolve(signal.lfilter(b.ravel(), a, force), low, "same")[2000::4])
    y = np.array(motion).T @ np.column_stack([shape, [0.5, 0.1, -0.6, 0.4, 0.9]]).T
    y += 0.02 * y.std() * rng.standard_normal(y.shape)
    return y - y.mean(axis=0)


def test_forces_of_several_colours_move_modes_by_no_more_than_is_stated():
    """Where the wide band would be off by more, the narrow one is taken. One band of 20 half-widths has damping 1.6 and
    more stated standard deviations off; both refuse the lowest mode, which the source of the force drives most."""
    rng, f, zeta = np.random.default_rng(1), np.array([0.8, 1.0, 1.6]), np.array([0.012, 0.015, 0.012])
    shape, of_f, of_zeta = np.column_stack([SHAPE, [0.5, -0.2, 0.7, 1.0, -0.4]]), [], []
    for _ in range(40):
        poles, by_likelihood = refine_modes(sea_record(rng, f, zeta, shape), RATE, begun(f, zeta, shape),
                                            highest_hz=2.25)
        off = np.log(poles.frequency_hz / f) / np.linalg.norm(poles.factors.ln_frequency, axis=1)
        of_f.extend(off[by_likelihood])
        off = (poles.damping_ratio - zeta) / np.linalg.norm(poles.factors.damping_ratio, axis=1)
        of_zeta.extend(off[by_likelihood])
    # some 78 numbers: their root mean square is known to 8 %
    for pull in (of_f, of_zeta):
        assert len(pull) > 60 and 0.8 < np.sqrt(np.mean(np.square(pull))) < 1.5


def test_a_machine_s_line_leaves_the_mode_as_it_was():
    rng, f, zeta = np.random.default_rng(7), [0.8, 1.6], [0.01, 0.01]
    y, poles = record(rng, f, zeta, SHAPE), begun(f, zeta, SHAPE)
    line = y.std() * np.outer(np.cos(2 * np.pi * 0.81 * np.arange(len(y)) / RATE), [1.0, 0.2, -0.5, 0.3, 0.6])
    clean, with_line = (refine_modes(one, RATE, poles, highest_hz=2.25) for one in (y, y + line))
    assert clean[1].tolist() == [True, True] and with_line[1].tolist() == [False, True]
    assert with_line[0].frequency_hz[0] == 0.8 and with_line[0].frequency_hz[1] != 1.6


def test_displacements_and_fixed_modes():
    """Displacements of the same motion give the same modes; a mode that was picked by hand stays."""
    rng, f, zeta = np.random.default_rng(9), [0.8, 1.6], [0.01, 0.01]
    y, poles = record(rng, f, zeta, SHAPE, noise=0.01), begun(f, zeta, SHAPE)
    line = np.fft.rfftfreq(len(y), 1 / RATE)
    line[0] = np.inf
    moved = np.fft.irfft(np.fft.rfft(y, axis=0) / -(2 * np.pi * line[:, None]) ** 2, len(y), axis=0)
    one, other = (refine_modes(a, RATE, poles, highest_hz=2.25, quantity=q)[0]
                  for a, q in ((y, "acceleration"), (moved, "displacement")))
    np.testing.assert_allclose(other.frequency_hz, one.frequency_hz, rtol=1e-6)
    np.testing.assert_allclose(other.damping_ratio, one.damping_ratio, rtol=1e-4)
    kept, which = refine_modes(y, RATE, poles, highest_hz=2.25, fixed=np.array([True, False]))
    assert which.tolist() == [False, True] and kept.damping_ratio[0] == 0.01


def test_a_shape_that_tells_nothing_leaves_the_group_as_it_is():
    shape = np.array([[1.0, 0.0], [0.5, 0.0]])
    drawn = spectrum(np.random.default_rng(2), np.array([1.0, 1.03]), np.full(2, 0.01), shape, seconds=600.0, noise=0.1)
    start = Start(n_group=2, frequency_hz=np.array([1.0, 1.03]), damping_ratio=np.full(2, 0.01), shape=shape,
                  level=np.ones(2))
    assert fit(drawn, start, 20, 20.0) is None
