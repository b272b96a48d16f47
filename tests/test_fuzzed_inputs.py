"""Inputs of every kind with another value, key, row or array: done, or refused in one line; never a traceback."""

import pytest
from fuzz import cases, fuzz

SEED, NUMBER = 1, 130


def test_inputs_are_right_before_they_are_mutated(tmp_path):
    assert [case.arguments[0] for case in cases(tmp_path) if case.run() != 0] == []


@pytest.mark.parametrize("seed", (SEED,))
def test_mutated_inputs_are_done_or_refused_in_one_line(tmp_path, seed):
    found = [f"{case.arguments[0]}, {case.file.name}, mutation {k}: {said}"
             for case, k, said in fuzz(tmp_path, seed, range(NUMBER))]
    assert not found, "\n".join(found[:3])
