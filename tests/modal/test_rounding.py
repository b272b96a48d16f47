"""Steps to which numbers were rounded, found from the numbers alone."""

import numpy as np
import pytest

from probupdate.modal.rounding import robust_std, rounding_std, rounding_step, rounding_steps


@pytest.mark.parametrize("step", [0.01, 0.001, 0.005, 1 / 600, 1 / 256, 1.0, 1e-4])
def test_the_step_of_rounded_numbers_is_found(step):
    rng = np.random.default_rng(3)
    for centre in np.array([32, 193, 2460]) * step:
        values = np.round(centre * (1 + 0.1 * rng.standard_normal(60)) / step) * step
        found = rounding_step(np.append(values, np.nan))
        # of too few different values no more than their last digit is known
        assert found == pytest.approx(step) or len(np.unique(values)) < 6 and 0 < found <= 2 * step


def test_numbers_of_a_computer_have_no_step():
    rng = np.random.default_rng(0)
    assert not any(rounding_step(0.32 + 0.01 * rng.standard_normal(n)) for n in (3, 5, 9, 100) for _ in range(50))
    assert rounding_step(np.array([np.nan])) == 0.0


def test_one_number_often_has_its_last_digit_as_step():
    assert rounding_step(np.full(9, 0.32)) == pytest.approx(0.01)
    assert rounding_step(np.array([0.32] * 7 + [0.45] * 2)) == pytest.approx(0.01)
    assert rounding_std(np.full(9, 0.32)) == pytest.approx(0.01 / np.sqrt(12))


def test_a_robust_scale_is_never_zero():
    values = np.array([0.32] * 7 + [0.45] * 2)
    assert robust_std(values - 0.32, rounding_std(values)) == pytest.approx(0.01 / np.sqrt(12))
    exact = np.array([np.pi / 9] * 7 + [0.45] * 2)
    assert 0 < robust_std(exact - np.pi / 9, rounding_std(exact)) < 1e-15


@pytest.mark.parametrize("step", [0.01, 0.02, 0.05])
def test_frequencies_of_rounded_periods_are_known_as_well_as_these(step):
    rng = np.random.default_rng(6)
    exact = np.array([3.1, 2.9, 0.7]) * (1 + 0.02 * rng.standard_normal((40, 3)))
    frequency = np.column_stack([1 / (np.round(exact / step) * step), np.full(40, np.nan)])
    error = np.sqrt(np.mean((frequency[:, :3] - 1 / exact) ** 2, axis=0))
    # of forty uniform errors the root mean square is known to 7 %
    assert rounding_std(frequency)[:3] == pytest.approx(error, rel=0.28)
    assert rounding_std(frequency)[3] == 0


def test_columns_share_a_step_but_for_significant_digits():
    rng = np.random.default_rng(4)
    free = np.array([1.3, 2.1, 7.9]) * (1 + 0.02 * rng.standard_normal((9, 3)))
    # a constant, and two values alone, show the others' step
    plain = np.column_stack([np.round(free / 0.005) * 0.005, np.full(9, 2.0), np.where(np.arange(9) == 3, 0.325, 0.32)])
    assert rounding_steps(plain) == pytest.approx(np.full(5, 0.005))
    three = np.array([[float(f"{x:.3g}") for x in row] for row in 10.0 ** np.arange(3) * free])
    assert rounding_steps(three) == pytest.approx([0.01, 0.1, 1.0])
    # of two digits the higher modes have two or three values each
    two = np.array([[0.32, 1.3, 2.1], [0.33, 1.3, 2.0], [0.32, 1.2, 2.1], [0.33, 1.3, np.nan]])
    assert rounding_steps(two) == pytest.approx([0.01, 0.1, 0.1])
    # what a computer wrote beside a column that is printed
    assert rounding_steps(np.column_stack([free, np.round(free[:, 0], 2)])) == pytest.approx([0, 0, 0, 0.01])
