from pathlib import Path

import pytest
from peer_packages import opensees
from validation import Collector, Row, properties

# what takes minutes and is of numbers, not of the language's version: .ci/run asks the default Python only
NUMBERS = {"calibration", "campaign", "diagnosis", "drawn", "farms", "identification", "lifetime", "peers", "readers",
           "reporting", "structure", "updating", "virtual"}
# of these what is about files, processes and other packages
ASKED_OF_ALL = {"test_campaign_convert", "test_campaign_parquet", "test_campaign_reading", "test_campaign_zarr",
                "test_effects_files", "test_identification_executors", "test_identification_resume",
                "test_report_run", "test_uff_file", "test_updating_files", "test_virtual_blind"}
# and what reads the text of code and documents, runs whole jobs, or kills many processes
NOT_OF_THE_VERSION = {"test_layering", "test_documents", "test_types", "test_settings_page", "test_tutorials",
                      "test_commands_chain", "test_commands_faults", "test_commands_own_case", "test_oc4_job"}


# before the markers choose
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        of_numbers = item.path.parent.name in NUMBERS and item.path.stem not in ASKED_OF_ALL
        if of_numbers or item.path.stem in NOT_OF_THE_VERSION:
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


def pytest_addoption(parser):
    parser.addoption("--validation", metavar="FILE",
                     help="write what tests measured for the tables (tests/validation.py)")


def pytest_configure(config):
    path = config.getoption("--validation")
    # processes of xdist report to the one that gathers
    if path and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Collector(Path(path)))


@pytest.fixture
def validation(request):
    """validation(what=, reference=, why=, unit=) -> a row of validation_rows.md; its `error(error, below)` and
    others assert and keep."""
    rows = []

    def row(**words: str) -> Row:
        rows.append(Row(**words))
        return rows[-1]

    yield row
    assert rows and all(one.quantities for one in rows), "a row without anything measured"
    request.node.user_properties.extend(properties(rows))
