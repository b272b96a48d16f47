import copy

import pytest
from small_turbine import small_turbine


@pytest.fixture
def raw() -> dict:
    """The small turbine's model.toml as read, a copy of its own for every test."""
    return copy.deepcopy(small_turbine())
