import pytest
from peer_packages import opensees

# what takes minutes and is of numbers, not of the language's version: .ci/run asks the default Python only
NUMBERS = {"calibration", "diagnosis", "identification", "structure", "updating", "virtual"}
# of these what is about files, processes and other packages
ASKED_OF_ALL = {"test_effects_files", "test_identification_resume", "test_updating_files", "test_virtual_blind"}


# before the markers choose
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.parent.name in NUMBERS and item.path.stem not in ASKED_OF_ALL:
            item.add_marker(pytest.mark.numbers)


@pytest.fixture(scope="session")
def opensees_module():
    return opensees()


@pytest.fixture
def ops(opensees_module):
    """OpenSees with nothing in it, before and after: it keeps one model for the whole program."""
    opensees_module.wipe()
    yield opensees_module
    opensees_module.wipe()
