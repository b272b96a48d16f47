"""The step to which numbers were rounded, as reports print them, and scales that are never zero because of it."""

from __future__ import annotations

import numpy as np

# of normally distributed numbers the standard deviation over the median absolute deviation
NORMAL_MAD = 1.4826
# of a number rounded to a step the standard deviation of its error, uniform over half a step to both sides
UNIFORM = 1 / np.sqrt(12)
# as many significant digits may be a report's; more are a computer's
MOST_DIGITS = 7
# a value lies on a grid that misses it by less than this share of the step
ON_GRID = 1e-4
# by chance all values lie on a grid so coarse with a smaller probability
CHANCE = 0.01
# grids between two powers of ten: a step is printed in ones, twos or fives, or is the resolution of a spectrum
PARTS = np.arange(1, 41)


def rounding_step(values: np.ndarray) -> float:
    """Step of the grid on which all of `values` lie, 0 where there is none; NaN counts for nothing.

    Found from the digits with which they are written, and coarser where that is no chance: steps of 0.005, or the
    resolution of the spectrum from which peaks were taken.
    """
    values = np.unique(np.abs(values[np.isfinite(values)]))
    values = values[values > 0]
    if not len(values):
        return 0.0
    printed = _printed_step(values)
    steps = {*(np.min(np.diff(values, prepend=0)) / PARTS), *(printed * PARTS)} - {0.0}
    for step in sorted(steps, reverse=True):
        # a single value says nothing of a grid but by its digits
        likely = (2 * ON_GRID if printed == 0 else printed / step) ** max(len(values) - 1, 1)
        if likely < CHANCE and len(values) > 1 and _are_all_on_grid(values, step):
            return float(max(step, printed))
    return printed


def rounding_steps(columns: np.ndarray) -> np.ndarray:
    """Step (n_column,) of each of `columns` (n_row, n_column), written alike by one program: that of all of them, but
    where a column's own is coarser by more than chance (significant digits instead of decimals). A column of few
    different values, or of one, does not show its own. Frequencies of rounded periods have these periods' step."""
    columns = np.asarray(columns, float)
    with np.errstate(divide="ignore"):
        period_step = rounding_step(1 / columns.ravel())
    whole, found = rounding_step(columns.ravel()), np.array([rounding_step(column) for column in columns.T])
    if period_step > 0 and whole == 0:
        there = np.isfinite(columns)
        return period_step * np.sum(np.where(there, columns, 0.0) ** 2, axis=0) / np.maximum(there.sum(axis=0), 1)
    digits = _significant_steps(columns, whole)
    if digits is not None:
        return digits
    different = np.array([len(np.unique(column[np.isfinite(column)])) for column in columns.T])
    with np.errstate(invalid="ignore", divide="ignore"):
        by_chance = (different < 2) | (len(found) * (whole / found) ** different >= CHANCE)
    return np.where((whole > 0) & by_chance, whole, found)


def rounding_std(values: np.ndarray) -> np.ndarray:
    """Standard deviation of the rounding of `values` (n,), or (n_column,) of columns (n_row, n_column), in their unit;
    that of double precision at least."""
    columns = np.asarray(values, float)
    columns = columns[:, None] if columns.ndim == 1 else columns
    largest = np.max(np.abs(np.where(np.isfinite(columns), columns, 0.0)), axis=0, initial=0.0)
    found = np.maximum(UNIFORM * rounding_steps(columns), np.where(largest > 0, np.spacing(largest), 0.0))
    return found if np.ndim(values) > 1 else found[0]


def robust_std(residual: np.ndarray, rounding: np.ndarray | float) -> np.ndarray:
    """Scale (n_column,) of residuals (n_row, n_column): their median absolute deviation from zero as a standard
    deviation, that of rounding (n_column,) at least: where more than half of rounded numbers are one and the same, the
    former is zero. Where it is not, it holds the rounding already. NaN counts for nothing."""
    return np.maximum(NORMAL_MAD * np.nanmedian(np.abs(residual), axis=0), rounding)


def _printed_step(values: np.ndarray) -> float:
    """The last decimal place with which any of them is written, 0 beyond seven significant digits."""
    highest = int(np.floor(np.log10(values.max())))
    for place in range(highest, highest - MOST_DIGITS, -1):
        step = float(f"1e{place}")
        if np.all(np.abs(values / step - np.round(values / step)) < 1e-9 * values / step + 1e-12):
            return step
    return 0.0


def _significant_steps(columns: np.ndarray, whole: float) -> np.ndarray | None:
    """Steps (n_column,) of columns that are written with so many significant digits, None where all of them lie on
    grids so much coarser than `whole` by chance."""
    each = [np.unique(np.abs(column[np.isfinite(column)])) for column in columns.T]
    top = np.array([values.max(initial=0.0) for values in each])
    for n in range(1, MOST_DIGITS if whole > 0 else 1):
        with np.errstate(divide="ignore"):
            steps = np.maximum(10.0 ** (np.floor(np.log10(top)) + 1 - n), whole)
        if all(_are_all_on_grid(values, step) for values, step in zip(each, steps, strict=True)):
            chance = sum(len(values) * np.log(whole / step) for values, step in zip(each, steps, strict=True))
            return steps if chance < np.log(CHANCE) else None
    return None


def _are_all_on_grid(values: np.ndarray, step: float) -> bool:
    count = values / step
    return bool(np.all(np.abs(count - np.round(count)) < ON_GRID))
