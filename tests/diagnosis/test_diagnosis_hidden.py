"""Effects hidden in an independent virtual turbine: found, named with place and size.

Hundreds more are run in studies/blind.
"""

import pytest
from hidden_turbine import STEP, found_in, names

pytestmark = pytest.mark.hidden

# hidden, cause, location, size (None: the virtual turbine's own unit), how much of the same kind tolerances add
HIDDEN = (
    (411, {"kind": "rna_offset", "axis": "x", "offset_m": 1.2}, "RNA centre of mass", "along the nacelle's x", 1.2,
     0.1),
    (412, {"kind": "rna_mass", "mass_kg": 2.5e4, **STEP}, "nacelle mass", "nacelle", 2.5e4, 0.0),
    (413, {"kind": "leg_stiffness", "leg": "C", "bay": 3, "factor": 0.6, **STEP}, "leg stiffness lost",
     "leg C, bay 3", -0.4, 0.0),
    (414, {"kind": "scour", "leg": "B", "depth_m": 3.0, **STEP}, "scour", "leg B", 3.0, 0.0),
    (415, {"kind": "wetted_length", "gain": 1.8}, "wetted length", "all members", 1.8, 0.0),
    (416, {"kind": "steel_temperature", "per_kelvin": -1.44e-3}, "temperature of the steel", "above the water", 4.0,
     0.0),
    (417, {"kind": "soil_softening", "per_unit": 0.4}, "soil softens with amplitude", "all legs", None, 0.0),
    (418, {"kind": "sensor_gain", "channel": "T66-x", "factor": 1.25}, "sensor gain", "T66-x", 0.25, 0.01),
    (419, {"kind": "sensor_rotation", "channel": "TP-C-x", "angle_deg": 14.0}, "sensor rotation", "TP-C about z", 14.0,
     1.0),
    (420, {"kind": "sensor_gain", "channel": "TP-A-x", "factor": -1.0}, "sensor polarity", "TP-A-x", -2.0, 0.0),
    (421, {"kind": "sensor_swap", "channel": "T66-x", "other": "T66-y", "swapped": 1.0}, "swapped channels",
     "T66-x and T66-y", 1.0, 0.0),
    (422, {"kind": "low_pass", "level": "TP", "time_constant_s": 0.02}, "low-pass filter", "all of TP", 20.0, 0.0),
    (423, {"kind": "tp_mass", "mass_kg": 6e4, **STEP}, "transition-piece mass", "column", 6e4, 0.0),
    (424, {"kind": "tower_mass", "bottom_m": 42.0, "top_m": 66.0, "mass_kg": 2e4, **STEP}, "tower mass", "42 to 66 m",
     2e4, 0.0),
    (425, {"kind": "icing", "mass_kg": 1.2e4, **STEP}, "icing", "rotor", 1.2e4, 0.0),
)
# one of the structure and one of a sensor, without those that take longest
QUICK = (411, 418)


# each is wanted in 95 of 100: neither of two comes up once in 400 times, fewer than eleven of thirteen once in 41
@pytest.mark.parametrize(("seeds", "least"), [
    pytest.param(QUICK, 1, id="quick"),
    pytest.param([case[0] for case in HIDDEN if case[0] not in QUICK], 11, marks=pytest.mark.long, id="others"),
])
def test_hidden_effects_are_named_with_place_and_size(turbine, seeds, least):
    right, found_here = 0, []
    for seed, hidden, cause, location, size, tolerance in (case for case in HIDDEN if case[0] in seeds):
        found = found_in(turbine, seed, hidden)
        first = found.findings[0] if found.findings else None
        found_here.append((cause, location, found.verdict, first and (first.cause, first.location, first.size)))
        if first is None or (cause, location) not in names(first):
            continue
        right += 1
        if size is not None and (first.cause, first.location) == (cause, location):
            assert first.size == pytest.approx(size, abs=3 * first.size_std + 3 * tolerance + 1e-9), found_here[-1]
    assert right >= least, found_here


# the virtual turbine moves the sensor on a mesh of its own; gains of the level's channels are what it looks like
@pytest.mark.long
@pytest.mark.parametrize(("seed", "level", "height_m", "location"), [
    (461, "tower 2/3", -4.0, "T66"),
    (462, "tower 2/3", 3.0, "T66"),
    (463, "tower top", -4.0, "T90"),
    (464, "tower bottom", 5.0, "T18"),
    (465, "TP", -4.0, "all of TP"),
])
def test_a_sensor_at_another_height_is_named_with_its_height(turbine, seed, level, height_m, location, validation):
    row = validation(what="a level's sensors 3 to 5 m from where they are said to be in the virtual turbine: named "
                          "first or in its set; their height", reference="what was hidden", unit="standard deviations",
                     why="one in 370 is farther off")
    found = found_in(turbine, seed, {"kind": "sensor_height", "level": level, "height_m": height_m})
    first = found.findings[0]
    row.count(("sensor at another height", location) in names(first), 1, 1, "named", case=found.findings)
    if first.cause == "sensor at another height":
        row.error((first.size - height_m) / first.size_std, 3.0, "height", case=first)


# the virtual turbine's soil softens by an exponential of the amplitude over 0.01 m/s2, which the record's column shows
# with a scatter of a tenth; the waves' height shows a part of that
@pytest.mark.parametrize(("seed", "per_unit"), [
    (1016150850, 0.312),
    pytest.param(1133849408, 0.0978, marks=pytest.mark.long),
])
def test_soil_that_softens_is_one_finding_of_its_size(turbine, seed, per_unit, validation):
    row = validation(what="soil that softens with amplitude in the virtual turbine, by another law than a straight "
                          "line of a column that scatters by a tenth: one finding; the slope",
                     reference="what was hidden", unit="standard deviations", why="one in 370 is farther off")
    found = found_in(turbine, seed, {"kind": "soil_softening", "per_unit": per_unit})
    first = found.findings[0]
    alone = [(f.cause, f.location) for f in found.findings] == [("soil softens with amplitude", "all legs")]
    row.count(alone, 1, 1, "one finding", case=found.findings)
    row.error((first.size + per_unit / 0.01) / first.size_std, 3.0, "slope", case=first)


WET = {"kind": "wetted_length", "gain": 1.8}
LATE = {"kind": "clock_offset", "level": "tower top", "offset_s": 0.03}
GAIN = {"kind": "sensor_gain", "channel": "T90-y", "factor": 0.85, **STEP}
SOFT = {"kind": "brace_stiffness", "bay": 2, "face": "DA", "factor": 0.0842}
EXCHANGED = {"kind": "sensor_swap", "channel": "T90-x", "other": "T90-y", "swapped": 1.0}
MASS = {"kind": "rna_mass", "mass_kg": 2.5e4, **STEP}


@pytest.mark.parametrize(("seed", "hidden", "wanted", "extend"), [
    pytest.param(431, (GAIN, WET), {("sensor gain", "T90-y"), ("wetted length", "all members")}, True,
                 marks=pytest.mark.long),
    pytest.param(432, (LATE, MASS), {("clock offset", "T90"), ("nacelle mass", "nacelle")}, False,
                 marks=pytest.mark.long),
    # what is left of the brace is soft enough to move by itself beside second bending; the next bay's does so too
    pytest.param(1512362688, (SOFT, EXCHANGED), {("brace stiffness lost", "face DA, bay 2"),
                                                 ("swapped channels", "T90-x and T90-y")}, False,
                 marks=pytest.mark.long),
])
def test_two_effects_at_once_are_both_named(turbine, seed, hidden, wanted, extend, validation):
    row = validation(what="two effects at once in the virtual turbine (long), a clock offset and the nacelle's mass, a "
                          "gain and wetted length, a brace that lost 92 % and exchanged channels: causes and places in "
                          "the findings", reference="what was hidden")
    found = found_in(turbine, seed, *hidden, extend=extend)
    found_here = set().union(*(names(f) for f in found.findings))
    row.count(len(wanted & found_here), len(wanted), len(wanted), case=(found.verdict, found_here))


@pytest.mark.long
def test_a_crosstalk_is_told_from_what_it_looks_like(turbine, validation):
    """No row is searched for it; what stands out is grout that cracked. TP-B and TP-C move alike in y."""
    row = validation(what="a share of 0.4 of TP-B-y in T66-x (long): the pair in the set; size in its standard "
                          "deviations, its standard deviation",
                     reference="what was hidden; TP-C moves alike")
    hidden = {"kind": "crosstalk", "channel": "T66-x", "other": "TP-B-y", "share": 0.4}
    found = found_in(turbine, 452, hidden)
    (one,) = found.findings
    row.count(("crosstalk", "TP-B-y into T66-x") in names(one), 1, 1, "in the set", case=(found.verdict, one))
    assert {cause for cause, _ in names(one)} == {"crosstalk"}
    row.error((one.size - 0.4) / one.size_std, 3, "size")
    row.error(one.size_std, 0.1, "its standard deviation")
