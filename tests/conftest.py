import pytest
from opensees_loader import load_opensees

# what takes minutes and is of numbers, not of the language's version: .ci/run asks the default Python only
NUMBERS = {
    "test_calibration_chain", "test_campaign_defects", "test_diagnosis_fingerprints", "test_diagnosis_linear",
    "test_diagnosis_noise", "test_diagnosis_without_model", "test_effects_derivatives", "test_identification_campaign",
    "test_identification_uncertainty", "test_identification_virtual", "test_report_figures",
    "test_report_identification", "test_updating_emulator", "test_updating_ensemble", "test_updating_nine_sets",
    "test_updating_tikhonov", "test_virtual_campaign", "test_virtual_effects", "test_virtual_modal",
    "test_virtual_structure",
}  # fmt: skip


# before the markers choose
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.stem in NUMBERS:
            item.add_marker(pytest.mark.numbers)


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
