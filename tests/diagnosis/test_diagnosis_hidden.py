"""Effects hidden in an independent virtual turbine: found, and named with their place and size.

The turbine has other elements, mesh, soil law and joints than the model, parameters from the prior and tolerances of
its own. Twenty-four half hours of three days; hundreds of such cases are run in studies/blind.
"""

import pytest

import probupdate
from probupdate.diagnosis.prepare import prepare
from probupdate.structure.load import reference_model
from probupdate.virtual.modal_blocks import simulate_modes

pytestmark = pytest.mark.hidden
HALF_WAY_H = 36.0


@pytest.fixture(scope="module")
def prepared():
    return prepare(reference_model("updated"))


def found_in(prepared, seed, *effects):
    run = simulate_modes(truth={"parameters_from": "prior", "effect": list(effects)}, seed=seed, days=3.0, n_block=24)
    return probupdate.diagnose(prepared, run.data, seed=1)


def names(finding):
    """Every cause and place that the finding may mean."""
    return {(finding.cause, finding.location), *((a.cause, a.location) for a in finding.alternatives)}


@pytest.mark.parametrize("seed", [41, 42])
def test_nothing_hidden_in_the_turbine_nothing_named(prepared, seed):
    found = found_in(prepared, seed)
    assert found.verdict == "none" and not found.findings
    # scour of all legs is excluded only above some depth, and that is said
    assert any(x.cause == "scour" for x in found.limits)


HIDDEN = (
    (43, {"kind": "sensor_gain", "channel": "T66-x", "factor": 1.25}, "sensor gain", "T66-x", 0.25, 0.02),
    (44, {"kind": "sensor_rotation", "channel": "TP-C-x", "angle_deg": 14.0}, "sensor rotation", "TP-C about z", 14.0,
     1.0),
    (45, {"kind": "sensor_gain", "channel": "TP-A-x", "factor": -1.0}, "sensor polarity", "TP-A-x", -2.0, 0.0),
    (46, {"kind": "sensor_swap", "channel": "T66-x", "other": "T66-y", "swapped": 1.0}, "swapped channels",
     "T66-x and T66-y", 1.0, 0.0),
    (47, {"kind": "wetted_length", "gain": 2.0}, "wetted length", "all members", 2.0, 0.0),
    (48, {"kind": "rna_mass", "mass_kg": 2e4, "course": "step", "at_hour": HALF_WAY_H}, "nacelle mass", "nacelle", 2e4,
     0.0),
)


def test_hidden_effects_are_named_with_place_and_size_and_none_is_taken_for_another(prepared):
    right = 0
    for seed, hidden, cause, location, size, tolerance in HIDDEN:
        found = found_in(prepared, seed, hidden)
        assert found.verdict != "none", f"{cause}, {location} is not seen"
        if found.verdict == "unexplained":
            continue
        first = found.findings[0]
        assert (cause, location) in names(first), f"{cause}, {location} is taken for {first.cause}, {first.location}"
        right += 1
        if (first.cause, first.location) == (cause, location):
            # the turbine's own tolerance of the same kind beside the stated deviation
            assert first.size == pytest.approx(size, abs=3 * first.size_std + 2 * tolerance + 1e-9)
    # of six, each wanted in 95 of 100, fewer than four would come up once in 450 times; records of 24 half hours tell
    # their noise less well than those of 48 in the blind study
    assert right >= 4
