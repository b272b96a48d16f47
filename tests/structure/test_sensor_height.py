"""Sensors at another height as a parameter: the model reads its channels where they would really sit."""

from dataclasses import replace

import numpy as np
import pytest
from effects_turbine import entry, model, plain, sample, with_effects
from small_turbine import small_turbine

from probupdate.effects.turbine import turbine_effects
from probupdate.errors import InputError
from probupdate.structure.description import described_sensors
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.extend import extended_model
from probupdate.structure.load import load_model, reference_model
from probupdate.structure.reduced import reduce_basis

N_MODE = 5
STATE = reference_model("as_built")
# metres along the members; the column goes on below the tower's foot, where the file's part ends
UP = {"tower": np.array([0.0, 0.0, 1.0])}
MOVES = (("T66", 4.1), ("T90", -10.0), ("T18", 5.5), ("TP-A", -1.0), ("all of TP", -6.1))


def of_the_leg(d, leg):
    """Upwards along a leg, from the file's corners."""
    corner = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])[d.jacket.leg_names.index(leg)]
    ends = [np.array([*(0.5 * end.leg_spacing_m * corner), end.z_m]) for end in (d.jacket.bottom, d.jacket.top)]
    return (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])


@pytest.fixture(scope="module")
def description():
    return read_description(STATE)


@pytest.fixture(scope="module")
def heights(description):
    return {e.location: e for e in turbine_effects(description) if e.cause == "sensor at another height"}


@pytest.fixture(scope="module")
def extended(heights):
    return extended_model(STATE, [e.adds for e in heights.values()])


def really_moved(description, channels, along_m):
    """The model whose file says where the sensors sit."""
    parts = {s.channel: s.part for s in description.sensor}
    sensors = []
    for s in described_sensors(description):
        part = parts[s.channel]
        up = UP[part] if part in UP else of_the_leg(description, part.removeprefix("leg "))
        at = s.position_m + along_m * up if s.channel in channels else s.position_m
        sensors.append(replace(s, position_m=at))
    return load_model(STATE, sensors=sensors)


def same_signs(shape, like):
    return shape * np.where(np.sum(shape * like, axis=0) < 0, -1, 1)


def test_a_moved_sensor_reads_what_one_reads_that_sits_there(description, heights, extended, validation):
    row = validation(what="channels read farther along their member, tower and legs: shapes; their slope with the "
                          "height", reference="sensors really moved; fourth-order differences of these, 1 cm apart",
                     why="rounding, of the largest component")
    names, start = extended.parameters.names, np.array(extended.parameters.initial)
    for location, along_m in MOVES:
        added = heights[location].adds
        channels = added.settings["channels"]
        theta = start.copy()
        theta[names.index(added.name)] = along_m
        found = extended.solve(theta, N_MODE, derivatives=True)
        moved = {h: really_moved(description, channels, along_m + 0.01 * h) for h in (-2, -1, 0, 1, 2)}
        shape = {h: same_signs(m.solve(m.parameters.initial, N_MODE).shape, found.shape) for h, m in moved.items()}
        size = np.abs(found.shape).max()
        row.error((found.shape - shape[0]) / size, 1e-9, "shapes", case=(location, along_m))
        inside = along_m - 0.02 > heights[location].lower
        if inside:
            slope = (8 * (shape[1] - shape[-1]) - (shape[2] - shape[-2])) / (12 * 0.01)
            row.error((found.shape_derivative[:, :, names.index(added.name)] - slope) / size, 1e-7, "slope",
                      case=(location, along_m))
        # another height is another height for the sensor alone
        before = extended.solve(start, N_MODE)
        assert np.array_equal(found.frequency_hz, before.frequency_hz)
        others = [k for k, c in enumerate(extended.channels) if c not in channels]
        assert found.shape[others] == pytest.approx(before.shape[others], abs=1e-12 * size)


def test_below_the_tower_s_foot_goes_the_column_on(description, heights, extended):
    """The line through a sensor is that of its members, whatever they are called: one on the column reads the same."""
    assert heights["T18"].lower == -5.0
    added = heights["T18"].adds
    theta = np.array(extended.parameters.initial)
    theta[extended.parameters.names.index(added.name)] = -3.0
    raw = [replace(s, channel=f"column {s.channel}", position_m=s.position_m - [0, 0, 3.0])
           for s in described_sensors(description) if s.channel in added.settings["channels"]]
    there = load_model(STATE, sensors=raw)
    rows = [extended.channels.index(c) for c in added.settings["channels"]]
    found, expected = extended.solve(theta, N_MODE).shape[rows], there.solve(there.parameters.initial, N_MODE).shape
    assert np.abs(found) == pytest.approx(np.abs(expected), rel=1e-9)


def test_which_sensors_have_a_row_and_how_far_it_goes(description, heights):
    assert set(heights) == {"TP-A", "TP-B", "TP-C", "TP-D", "T18", "T66", "T90", "all of TP"}
    # to the member's end, or ten metres
    assert [(heights[k].lower, heights[k].upper) for k in ("T66", "T90", "all of TP")] == [
        (-10.0, 10.0), (-10.0, 0.0), (-10.0, 0.0)]
    # a tie lies level: along it is no height
    d = parse_description(small_turbine(), "m")
    own = described_sensors(d)
    level = [replace(s, channel=f"tie-{axis}", level="tie", position_m=np.array([1.25, 1.25, 8.0]))
             for s, axis in zip(own[:2], "xy", strict=True)]
    rows = turbine_effects(d, sensors=[*own, *level])
    found = {e.location for e in rows if e.cause == "sensor at another height"}
    assert found == {"TP-A", "TP-C", "LJ-B-y", "T30", "T50", "all of any"}
    assert ("sensor_height" in {e.adds.kind for e in turbine_effects(d, sensors=level)}) is False


def test_a_fixed_height_is_a_sensor_that_sits_there(validation):
    row = validation(what="a height that is fixed in the file, and two of one channel", reference="an updated one at "
                     "that value; their sum", why="rounding, of the largest component")
    def at(**fixed):
        raw = with_effects([sample("height")])
        raw["parameter"][-1] |= fixed
        return raw

    updated = model(at())
    expected = updated.solve(np.array([2.7]), N_MODE).shape
    raw = at(update=False, initial=2.7)
    found = plain(raw).solve(np.array([1.0]), N_MODE).shape
    row.error((same_signs(found, expected) - expected) / np.abs(expected).max(), 1e-9, case="fixed")
    raw["parameter"][-1]["initial"] = 1.5
    raw["parameter"].append(sample("height") | {"name": "another", "lower": -4.0, "upper": 4.0})
    found = model(raw).solve(np.array([1.0, 1.2]), N_MODE).shape
    row.error((same_signs(found, expected) - expected) / np.abs(expected).max(), 1e-9, case="both")


@pytest.mark.parametrize(("changed", "said"), [
    ({"channels": ["T30-x", "T31-x"]}, None),
    ({"channels": ["T31-x"]}, "none of its channels is among the sensors"),
    ({"lower": -30.0}, "takes T30-x off its member"),
    ({"channels": None}, "is missing for the kind 'sensor_height'"),
])
def test_heights_that_no_sensor_can_have_are_refused(changed, said):
    one = entry("height", "sensor_height", None, {"channels": ["T30-x", "T30-y"]}, (-6.0, 6.0)) | changed
    raw = with_effects([{k: v for k, v in one.items() if v is not None}])
    if said is None:
        model(raw)
        return
    with pytest.raises(InputError, match=said):
        model(raw)


def test_a_reduced_basis_moves_sensors_too(validation):
    checked = validation(what="reduced basis with a sensor's height: shapes, of the largest", reference="full model",
                         why="the basis")
    raw = with_effects([sample("height"), sample("scour_B")])
    for row in raw["parameter"]:
        row["update"] = row["name"] in ("k_t", "height", "scour_B")
    turbine = model(raw)
    box = (np.array([0.8, -6.0, -0.5]), np.array([1.2, 6.0, 3.0]))
    reduced = reduce_basis(turbine, n_mode=5, box=box, frequency_tolerance=1e-4, n_snapshot=32, n_verify=16)
    theta = box[0] + np.random.default_rng(0).random((12, 3)) * (box[1] - box[0])
    fast = reduced.solve_many(theta, 5)
    assert not fast.fallback.any()
    for row, shape in zip(theta, fast.shape, strict=True):
        exact = turbine.solve(row, 5, derivatives=True)
        one = reduced.solve(row, 5, derivatives=True)
        size = np.abs(exact.shape).max()
        for own in (shape, one.shape):
            checked.error((np.abs(own) - np.abs(exact.shape)) / size, 1e-2)
        assert np.abs(one.shape) == pytest.approx(np.abs(shape), abs=1e-6 * size)
