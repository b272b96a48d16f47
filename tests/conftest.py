import pytest
from opensees_loader import load_opensees


@pytest.fixture(scope="session")
def opensees_module():
    try:
        return load_opensees()
    except (ImportError, OSError) as error:
        pytest.skip(f"OpenSees cannot be loaded: {error}")


@pytest.fixture
def ops(opensees_module):
    """OpenSees with nothing in it, before and after: it keeps one model for the whole program."""
    opensees_module.wipe()
    yield opensees_module
    opensees_module.wipe()
