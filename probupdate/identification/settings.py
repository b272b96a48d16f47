"""Numbers that decide what identification finds.

`CONSTANTS` is the one value of all that decide something; modules take theirs from it under a name of their own. What
is a matter of speed or of files alone stays where it is used. docs/reference/settings.md is made of these rows.
"""

from __future__ import annotations

from dataclasses import dataclass

from probupdate.runtime.settings import setting


@dataclass(frozen=True, kw_only=True)
class IdentificationSettings:
    """What a user may state of SSI-cov; None: as the paper where a turbine's model is given (order 20, 30 block rows,
    5 Hz), else as the record proposes."""

    order: int | None = setting(None, "-", "model order", "paper: 20")
    block_rows: int | None = setting(
        None, "-", "block rows of the Toeplitz matrix", "30: two periods of 0.3 Hz at 5 Hz")
    rate_hz: float | None = setting(None, "Hz", "sampling rate after decimation", "paper: 5")
    harmonics: str = setting(
        "keep", "-", "the rotor's harmonics stay in the record ('keep') or are taken out ('remove')")


@dataclass(frozen=True, kw_only=True)
class IdentificationConstants:
    """Thresholds of classification, clustering, tracking, harmonics, merging and regression."""

    stability_floor: float = setting(
        0.1, "-", "added to a pole's stability before its square weighs the pole within its mode")
    damping_floor: float = setting(0.01, "-", "added to the damping ratio that a pole's weight is divided by")
    least_damping: float = setting(
        0.005, "-", "lower damping ratios weigh as this one", "no structure has less; a pole of noise may have any")
    twin_frequency: float = setting(
        0.01, "ln f", "poles of several orders of a block this close in frequency may be one mode")
    twin_mac: float = setting(0.90, "-", "and with this MAC (of a pair: S2MAC to its plane) at least")
    same_estimate: float = setting(
        3.0, "std", "a mode's pole at another order is averaged with the chosen one if they differ by less than this",
        "standard deviations of the difference")
    overlap: float = setting(
        2.0, "-", "modes whose bands of so many half-power half-widths meet are fitted to the spectra together")
    largest_misfit: float = setting(
        1.6, "-", "spectra whose errors' mean square is larger leave the mode as SSI-cov has it",
        "1 where the model holds")
    same_mode_std: float = setting(
        5.0, "std", "a mode stays as SSI-cov has it where its spectra would move it farther",
        "and by more than its band, or 70 % of its damping")
    range_margin: float = setting(
        0.05, "ln f", "a pole farther outside the range of a mode's poles over the campaign is none of it")
    model_mac: float = setting(0.15, "-", "standard deviation of 1 - MAC that a poor model may miss")
    model_frequency: float = setting(
        0.20, "ln f", "standard deviation of ln f that a poor model may miss", "a design model may be 30 % off")
    sure_frequency: float = setting(
        0.02, "ln f", "standard deviation of ln f that a good model misses", "an updated model is within 2 %")
    wrong_mac: float = setting(
        0.5, "-", "standard deviation of 1 - MAC where channels are exchanged, reversed or turned")
    all_near: float = setting(
        0.05, "ln f", "where all modes that are looked for have one this near, and shapes say otherwise, frequencies "
        "name them", "by chance once in a hundred for four modes 30 % apart")
    no_mac: float = setting(0.35, "-", "a mode less alike than this at its own frequency is rather none of the model's")
    own_shape: float = setting(1.0, "-", "weight of a mode's own MAC, beside its plane's, in which of a pair is which")
    least_size: float = setting(0.02, "-", "a mode that moves the sensors little is less likely by this factor at most")
    frame_s: float = setting(40.0, "s", "length of the frames of the rotor's spectrogram")
    hop_s: float = setting(10.0, "s", "distance of these frames")
    speed_step: float = setting(0.02, "-", "relative step of the rotor speed between frames that costs one unit")
    smooth_s: tuple[float, ...] = setting(
        (25.0, 45.0, 70.0), "s", "lengths over which a demodulated line is smoothed; the best is taken",
        "a rotor's speed wanders within 20 to 60 s")
    least_gain: float = setting(
        5.0, "-", "power at the rotor's angle over that of decoys from which the angle is believed",
        "by chance once in 30 000")
    decoys_hz: tuple[float, ...] = setting(
        (-0.013, -0.009, -0.005, 0.005, 0.009, 0.013), "Hz", "decoys turn this much faster or slower at the harmonic",
        "beyond the resolution of half an hour")
    least_rpm: float = setting(3.0, "rpm", "slower rotors have no harmonics that are looked for")
    near_frequency: float = setting(
        0.015, "ln f", "candidates of several blocks this close in frequency may be one mode")
    near_mac: float = setting(0.80, "-", "and with this MAC at least")
    largest_spread: float = setting(
        0.15, "ln f", "a mode's frequency moves by less between its 10 % and 90 % quantiles",
        "waves and lines move by more")
    largest_jump: float = setting(0.01, "ln f",
                                  "and by less from block to block, or by four times the Cramer-Rao bound")
    same_mode: float = setting(
        0.10, "ln f", "clusters of one direction or plane that are closer may be one mode that moved or turned")
    double: float = setting(0.25, "ln f",
                            "within this about a strong mode, poles of noise and waves may have its shape")
    plane_share: float = setting(
        0.12, "-", "a cluster spans a plane if its second direction has this share of the squared shapes")
    in_plane: float = setting(0.85, "-", "least MAC of what lies in the plane")
    apart_mac: float = setting(0.5, "-", "two poles of one order that are less alike are two modes")
    close: float = setting(
        0.02, "ln f", "single modes that are closer, or within their half-power bandwidths, are compared as a plane")
    follows: float = setting(
        0.9, "-", "share of a cluster's members on the rotor's multiples from which it is a line of the rotor")
    by_chance: float = setting(0.7, "-", "unless its frequency lies there in more than this share of all blocks")
    wave_width: float = setting(0.15, "ln f", "nearer to the peak of the waves, a pole may be of waves")
    wave_damping: float = setting(0.025, "-", "if its damping ratio is this at least",
                                  "no idling structure has as much")
    core: float = setting(
        0.5, "-", "neighbours of a candidate that begins or continues a cluster, as a share of what makes a mode")
    pass_share: float = setting(
        0.9, "-", "the anti-aliasing filter passes up to this share of the new Nyquist frequency")
    stop_db: float = setting(70.0, "dB", "and stops by this much from its mirror image above")
    proposal_parts: int = setting(16, "-", "parts of a block whose spectra are averaged for the proposed rate")
    stands_out: float = setting(
        6.0, "std", "a peak of that spectrum stands out by so many standard deviations of its logarithm")
    least_log: float = setting(1.1, "ln", "and by this at least", "a factor of three")
    steady: float = setting(
        1.15, "-", "a peak is a machine's line if the mean square of its power, over the squared mean, is smaller",
        "2 for a random motion, 1 for a steady one")
    rate: float = setting(2.5, "-", "proposed rate over the highest frequency that stands out")
    periods: float = setting(2.0, "-", "periods of the lowest one that the lags cover")
    least_known: float = setting(0.5, "-", "a covariate known in a smaller share of the blocks is left out")
    collinear: float = setting(
        10.0, "-", "variance inflation from which two covariates are not distinguishable", "usual rule of thumb")
    outlier: float = setting(
        5.0, "std", "standardised innovations beyond this are left out", "one of a million by chance")
    spare_rows: int = setting(8, "-", "blocks that a fit needs beyond its coefficients")
    same_frequency: float = setting(0.04, "-", "without a model, modes of two setups this close in frequency are one")
    same_mac: float = setting(0.80, "-", "if their MAC at the references is this at least")
    least_setups: float = setting(1 / 3, "-", "share of the setups, and two, that must have a mode")
    largest_condition: float = setting(
        30.0, "-", "condition number above which references do not distinguish the modes of a pair")
    largest_std: float = setting(
        0.25, "-", "relative standard deviation of the references' motion above which they give no scale")
    least_p_value: float = setting(
        0.01, "-", "setups whose frequencies agree with a smaller p-value are of different structures")
    least_singular: float = setting(
        1e-7, "-", "singular values below this share of the largest are rounding", "double precision")
    small_singular: float = setting(1e-5, "-", "where any lie below this share")
    split_singular: float = setting(1e-3, "-", "those below this one are found by themselves")
    track_grid: float = setting(0.0025, "ln f", "grid on which a mode's frequency is followed")
    vote_width: float = setting(0.01, "ln f", "width of a pole's vote for a place")
    vote_floor: float = setting(
        0.05, "-", "what a block without a vote for a place is worth beside one with all of them")
    move_cost: float = setting(
        100.0, "1/ln f", "cost of moving; a move of 1 % asks for a third of a block's full support")
    least_clear: float = setting(0.2, "-",
                                 "share of votes clear of the rotor's multiples from which these are left out")
    nearness: float = setting(0.03, "ln f", "tracks of a pair farther apart name its poles by frequency too")
    least_gap: float = setting(
        1e3, "-", "squared singular values closer than so many times their rounding have no derivative")


CONSTANTS = IdentificationConstants()
