"""Hidden effects: nothing at amount zero, the right sign and place at one, physics by a second route."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas
import pytest

from probupdate.errors import InputError
from probupdate.virtual import dynamics, effects, frame, modal_blocks, simulation, truth, turbine_file

AS_BUILT = turbine_file.reference_file().with_name("as_built.toml")

# kind, place, size; what it does to the lowest global frequencies: -1 lowers, +1 raises, 0 leaves them
EXAMPLES = (
    ("brace_stiffness", {"bay": 2, "face": "BC"}, 0.3, -1),
    ("single_brace", {"bay": 2, "face": "BC", "brace": 1}, 0.3, -1),
    ("joint_stiffness", {"bay": 2, "face": "BC", "leg": "C", "end": "top"}, 0.1, -1),
    ("leg_stiffness", {"leg": "A", "bay": 3}, 0.7, -1),
    ("grout_flexibility", {"leg": "A"}, 10.0, -1),
    ("tp_flexibility", {"leg": "all"}, 5.0, -1),
    ("tp_stiffness", {"part": "strut"}, 0.5, -1),
    ("flange_flexibility", {"station": 2}, 5.0, -1),
    ("tower_stiffness", {"bottom_m": 40.0, "top_m": 60.0}, 0.8, -1),
    ("tower_mass", {"bottom_m": 40.0, "top_m": 60.0}, 2e4, -1),
    ("tp_mass", {}, 3e4, -1),
    ("scour", {"leg": "all"}, 2.0, -1),
    ("soil_stiffness", {"leg": "D", "direction": "all"}, 0.5, -1),
    ("marine_growth", {"leg": "all"}, 0.1, -1),
    ("brace_flooding", {"bay": 1, "face": "AB"}, 1.0, -1),
    ("leg_water", {"leg": "all"}, -1.0, 1),
    ("corrosion", {"leg": "all"}, 0.003, -1),
    ("rna_mass", {}, 1e4, -1),
    ("rna_offset", {"axis": "z"}, 0.5, -1),
    ("rna_inertia", {"axis": "z"}, 4e6, -1),
    ("blade_coupling", {"frequency_hz": 0.7}, 2e4, -1),
    ("wetted_length", {}, 1.0, -1),
    ("steel_temperature", {}, -0.01, -1),
    ("soil_softening", {}, 0.2, -1),
    ("icing", {}, 5e3, -1),
    ("p_delta", {}, 1.0, -1),
    ("tuned_mass", {"z_m": 60.0, "direction_deg": 30.0, "frequency_hz": 1.0}, 5e3, 0),
    ("cable", {"leg": "A", "z_m": 13.0, "tower_z_m": 60.0}, 2e7, 1),
    ("fender", {"leg": "A", "z_m": 0.0, "direction_deg": 0.0}, 2e7, 1),
    ("second_structure", {"leg": "B", "z_m": 8.0, "frequency_hz": 1.5}, 2e4, 0),
    ("odd_mass", {"bay": 3, "face": "AB"}, 2e4, -1),
)


def entry(kind, place, size):
    return {"kind": kind, **place, effects.EFFECTS[kind].size: size}


@pytest.fixture(scope="module")
def file():
    return turbine_file.read_turbine(AS_BUILT)


def solved(file, *entries, amount=None, heading=20.0):
    given = replace(truth.parse_truth({"effect": list(entries)}, file), tolerance_scale=0.0)
    drawn = truth.draw_truth(given, file, np.random.default_rng(1), dynamics.N_MODE)
    structure = frame.build_structure(file, drawn, amount)
    return dynamics.heading_modes(structure, drawn.damping_ratio, heading)


@pytest.fixture(scope="module")
def plain(file):
    return solved(file)


def test_the_former_name_of_the_time_profile_is_read(file):
    former = {"kind": "rna_mass", "mass_kg": 3000.0, "course": "step", "at_hour": 30.0}
    given = [truth.parse_truth({"effect": [one]}, file).effects for one in (
        former, {"time_profile" if key == "course" else key: value for key, value in former.items()})]
    assert given[0] == given[1] and given[0][0]["time_profile"] == "step"
    with pytest.raises(InputError, match="time_profile: 'stp' is unknown"):
        truth.parse_truth({"effect": [former | {"course": "stp"}]}, file)


def test_every_structural_kind_has_an_example():
    structural = {name for name, kind in effects.EFFECTS.items() if kind.acts != "measurement"}
    assert {example[0] for example in EXAMPLES} == structural


@pytest.mark.parametrize(("kind", "place", "size", "sign"), EXAMPLES, ids=[e[0] for e in EXAMPLES])
def test_effects_act_the_right_way_and_vanish(file, plain, kind, place, size, sign, validation):
    row = validation(what="hidden effects, 31 kinds: one mode more of two of them, two of one; largest change of a "
                          "frequency of the others; these at amount zero, frequencies and shapes",
                     reference="what was put in; the structure without them", why="eigensolver")
    entries = entry(kind, place, size)
    now = solved(file, entries)
    if kind in ("blade_coupling", "tuned_mass", "second_structure"):
        # a mode more for each spring: all others lie between those of the structure with the mass fixed and with it
        # gone
        more = 2 if kind == "second_structure" else 1
        row.equal(np.count_nonzero(now.frequency_hz < 2.5), np.count_nonzero(plain.frequency_hz < 2.5) + more,
                  "more modes")
        return
    change = now.frequency_hz[:5] / plain.frequency_hz[:5] - 1
    row.least(sign * change[np.argmax(np.abs(change))], 2e-5, "largest change")
    # nothing that softens or adds mass raises any frequency (Rayleigh), and the other way about; a mass that moves may
    assert kind == "rna_offset" or np.all(sign * change > -1e-9)
    gone = solved(file, entries, amount=[0.0])
    row.error(gone.frequency_hz / plain.frequency_hz - 1, 1e-9, "frequencies")
    row.error((gone.observed_shape - plain.observed_shape) / np.abs(plain.observed_shape).max(), 1e-7, "shapes")


def apart(shape, other):
    """Largest difference of shapes but for their signs, of the largest component."""
    sign = np.where(np.sum(shape * other, axis=0) < 0, -1, 1)
    return np.abs(shape * sign - other).max() / np.abs(other).max()


def moved(file, level, up):
    """The drawing with a level's sensors there."""
    return replace(file, sensors=tuple(replace(s, position_m=s.position_m + up) if s.level == level else s
                                       for s in file.sensors))


@pytest.mark.parametrize(("level", "height_m", "up"), [
    ("tower 2/3", 4.0, (0, 0, 4.0)), ("tower 2/3", -3.3, (0, 0, -3.3)), ("tower top", -5.0, (0, 0, -5.0)),
])
def test_a_sensor_at_another_height_is_one_that_is_drawn_there(file, plain, level, height_m, up):
    now = solved(file, {"kind": "sensor_height", "level": level, "height_m": height_m})
    there = solved(moved(file, level, np.array(up)))
    assert now.frequency_hz[:5] == pytest.approx(plain.frequency_hz[:5], rel=1e-4)
    # a node more where the sensor is drawn
    assert apart(now.observed_shape, there.observed_shape) < 2e-4
    # what is drawn stays where it is drawn
    assert apart(now.nominal_shape, plain.nominal_shape) < 2e-4
    assert apart(now.observed_shape, plain.observed_shape) > 0.02


def test_a_sensor_goes_up_along_its_own_leg(file):
    """Down the battered leg it moves outwards too, and ends where the leg does."""
    one = {"kind": "sensor_height", "level": "TP", "height_m": -7.0}
    top, bottom = (np.array([*([0.5 * file.value("jacket", e, "leg_spacing_m")] * 2), file.value("jacket", e, "z_m")])
                   for e in ("top", "bottom"))
    along = (top - bottom) / np.linalg.norm(top - bottom)
    leg_a = replace(file, sensors=tuple(
        replace(s, position_m=s.position_m - 7.0 * along) if s.channel.startswith("TP-A") else s
        for s in file.sensors))
    rows = [s.channel.startswith("TP-A") for s in file.sensors]
    now, there = solved(file, one).observed_shape[rows], solved(leg_a).observed_shape[rows]
    assert apart(now, there) < 2e-4
    with pytest.raises(InputError, match="sensor TP-A-x: 3 m farther up it would lie beyond leg A"):
        solved(file, one | {"height_m": 3.0})


def test_a_sensor_that_is_mounted_elsewhere_within_a_record_moves_then():
    moves = {"kind": "sensor_height", "level": "tower 2/3", "height_m": -6.0, "time_profile": "step", "at_hour": 24.0}
    runs = [modal_blocks.simulate_modes(truth={"effect": some}, seed=3, days=2.0, n_block=8, scatter=0.0)
            for some in ([moves], [])]
    stepped, still = (np.abs(run.shape) for run in runs)
    later = runs[0].amount[:, 0] > 0.5
    assert 0 < later.sum() < len(later)
    assert stepped[~later] == pytest.approx(still[~later], abs=1e-3 * still.max())
    rows = [c.startswith("T66") for c in runs[0].data.channels]
    # the first pair at 60 m of 90 moves less
    assert np.all(stepped[later][:, rows, :2].max(axis=1) < 0.95 * still[later][:, rows, :2].max(axis=1))


def test_one_leg_after_the_other_is_all_legs(file):
    """A place 'all' is what four single places are, whatever the kind."""
    for kind, size in (("scour", 1.0), ("grout_flexibility", 5.0), ("leg_water", -1.0)):
        every = solved(file, entry(kind, {"leg": "all"}, size))
        single = solved(file, *(entry(kind, {"leg": leg}, size) for leg in "ABCD"))
        assert single.frequency_hz == pytest.approx(every.frequency_hz, rel=1e-9), kind


def test_effects_are_the_parameters_where_there_are_some(file, validation):
    """Two routes to one structure: scour, marine growth and rotor mass as Table 2 has them, and as effects."""
    checked = validation(what="hidden growth and soil of all legs, scour (1.6 m)", reference="the parameter for it",
                         why="eigensolver; scour: the mesh is not cut at its ground")

    def with_parameter(**parameters):
        given = replace(truth.parse_truth({"parameters": parameters}, file), tolerance_scale=0.0)
        drawn = truth.draw_truth(given, file, np.random.default_rng(1), dynamics.N_MODE)
        return dynamics.heading_modes(frame.build_structure(file, drawn), drawn.damping_ratio, 20.0)

    growth = solved(file, entry("marine_growth", {"leg": "all", "top_m": -2.0}, 0.1))
    checked.error(growth.frequency_hz[:5] / with_parameter(mg=0.1).frequency_hz[:5] - 1, below=1e-9, of="exact")
    # the mesh of the parameter is cut at the hole's ground, the effect's is not: half an element's soil at most
    scour = solved(file, entry("scour", {"leg": "all"}, 1.6))
    checked.error(scour.frequency_hz[:5] / with_parameter(sc=1.6).frequency_hz[:5] - 1, below=2e-3, of="scour")
    half = solved(file, entry("soil_stiffness", {"leg": "all", "direction": "all"}, 0.5))
    soft = with_parameter(py=2.0, tz=2.0, qw=2.0)
    checked.error(half.frequency_hz[:5] / soft.frequency_hz[:5] - 1, below=1e-9, of="exact")


def test_the_rising_water_s_mass_is_that_of_the_length_it_wets(file, validation):
    """Added mass across a vertical-ish leg: counted by hand from diameter and length; inside water likewise."""
    row = validation(what="mass of the length that rising water wets, beyond the legs' own and over the braces': "
                          "across; up, where a fifth of the legs' added mass counts", reference="counted by hand")
    def mass(**how):
        given = replace(truth.parse_truth({"effect": [{"kind": "wetted_length", "gain": 0.8}]}, file),
                        tolerance_scale=0.0)
        drawn = truth.draw_truth(given, file, np.random.default_rng(1), dynamics.N_MODE)
        return frame.build_structure(file, drawn, **how)

    dry, wet = mass(amount=[0.0]), mass(amount=[1.0])
    gained = (wet.mass - dry.mass).diagonal()[: 6 * len(dry.node_m)].reshape(-1, 6)[:, :3].sum(axis=0)
    jacket = file.raw["jacket"]
    slope = (jacket["bottom"]["leg_spacing_m"] - jacket["top"]["leg_spacing_m"]) / np.sqrt(2) / 49.0
    d, t = jacket["leg"]["diameter_m"], jacket["leg"]["thickness_m"]
    length = 4 * 0.8 * np.sqrt(1 + slope**2)
    inside = 1025 * np.pi / 4 * (d - 2 * t) ** 2 * length
    outside = 1025 * np.pi / 4 * d**2 * length
    # braces of the bay at the surface: eight half braces of 0.8 m rise each
    bay = jacket["bay"][2]
    side = jacket["bottom"]["leg_spacing_m"] + (0.0 + 36) / 49 * (7.0 - 20.0)
    per_rise = np.sqrt((side / 10.0) ** 2 + 1)
    braces = 8 * 0.8 * per_rise * 1025 * np.pi / 4 * bay["brace"]["diameter_m"] ** 2
    # horizontally, legs take nearly all of their added mass along, braces of two faces and two half ones less
    row.between((gained[0] - inside - outside) / braces, 0, 1, "across")
    row.between((gained[2] - inside) / (0.2 * outside + braces), 0, 1, "up")


def test_weight_softens_as_a_cantilever_with_a_mass_on_top(file, plain):
    """A mass on a cantilever of length L loses the share 6/5 N / (k L) = 1.2 g / (L omega^2) of its stiffness; the
    tower's 72 m on a foot that moves and turns, and its own weight, are within a factor of two of that."""
    now = solved(file, entry("p_delta", {}, 1.0))
    loss = 1 - (now.frequency_hz[0] / plain.frequency_hz[0]) ** 2
    omega2 = (2 * np.pi * plain.frequency_hz[0]) ** 2
    assert 0.5 < loss / (1.2 * 9.81 / (72.0 * omega2)) < 2.0


def read(folder):
    parts = []
    for path in sorted((Path(folder) / "acceleration").iterdir()):
        with h5py.File(path) as data:
            parts.append(data["data"][:])
    return parts


def test_time_series_follow_the_time_profiles(tmp_path, validation):
    """The same seed with and without effects: equal before a step, the effect itself after it."""
    checked = validation(what="gain and clock in time series: gain; residual motion",
                         reference="the same seed without them", why="the logger's own noise")
    operation = "[operation]\nmaintenance_hours = [[0, 2]]\nmissing_hours = []\n"
    (tmp_path / "none.toml").write_text(operation)
    (tmp_path / "some.toml").write_text(
        operation
        + '[[effect]]\nkind = "sensor_gain"\nchannel = "T90-x"\nfactor = 0.8\ntime_profile = "step"\nat_hour = 0.5\n'
        + '[[effect]]\nkind = "clock_offset"\nlevel = "tower 2/3"\noffset_s = 0.08\n'
        + 'time_profile = "step"\nat_hour = 0.5\n'
        + '[[effect]]\nkind = "heading_offset"\nangle_deg = 15.0\n'
        + '[[effect]]\nkind = "soil_stiffness"\nleg = "all"\ndirection = "all"\nfactor = 0.3\n'
        + 'time_profile = "step"\nat_hour = 1.0\n'
    )
    out = {}
    for name in ("none", "some"):
        out[name] = simulation.simulate(tmp_path / name, model=AS_BUILT, days=0.0834, truth=tmp_path / f"{name}.toml",
                                        seed=9)
    plain, hidden = read(out["none"].path), read(out["some"].path)
    names = [s.channel for s in turbine_file.read_turbine(AS_BUILT).sensors]
    half = 45000
    before = [np.nan_to_num(part[0][: half - 100]) for part in (plain, hidden)]
    assert np.abs(before[0] - before[1]).max() < 1e-6
    x = names.index("T90-x")
    record = truth.read_toml(out["some"].truth_path, "truth file")
    offset = record["drawn"]["offset_mps2"][x]
    n = min(len(plain[0]), len(hidden[0]))
    a, b = (part[0][half + 100 : n, x] - offset for part in (plain, hidden))
    ok = np.isfinite(a) & np.isfinite(b)
    # the noise is the logger's own and is not scaled: 1e-4 against 5e-3
    checked.error(np.polyfit(a[ok], b[ok], 1)[0] - 0.8, below=0.005, of="gain")
    # a late clock writes an event two samples earlier
    row = names.index("T66-y")
    late, early = hidden[0][half + 100 : n - 10, row], plain[0][half + 102 : n - 8, row]
    ok = np.isfinite(late) & np.isfinite(early)
    checked.error(np.std(late[ok] - early[ok]) / np.std(early[ok]), below=0.1, of="motion")
    entries = [pandas.read_csv(o.path / "scada.csv")["nacelle_heading_deg"] for o in out.values()]
    assert np.mod(entries[1] - entries[0], 360).to_numpy() == pytest.approx(np.full(len(entries[0]), 15.0), abs=0.11)
    # the hour after the soil gave way
    assert len(record["condition"]) == 3
    assert record["mode_set_end"][0]["frequency_hz"][3] < 0.97 * record["mode_set"][0]["frequency_hz"][3]
    assert np.nanmax(np.abs(plain[1][:1000] - hidden[1][:1000])) > 1e-4
    back = simulation.simulate(tmp_path / "back", model=AS_BUILT, days=0.0834, truth=out["some"].truth_path, seed=9)
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(read(back.path), hidden, strict=True))


def test_a_fast_sampler_reads_low_frequencies(tmp_path):
    operation = "[operation]\nmaintenance_hours = [[0, 1]]\nmissing_hours = []\n"
    (tmp_path / "given.toml").write_text(operation + '[[effect]]\nkind = "sampling_rate"\nratio = 1.05\n')
    (tmp_path / "none.toml").write_text(operation)
    data = {}
    for name in ("given", "none"):
        out = simulation.simulate(tmp_path / name, model=AS_BUILT, days=0.042, truth=tmp_path / f"{name}.toml", seed=2)
        data[name] = read(out.path)[0][:, -2].astype(float)
    # the same motion, stretched: sample k is the other's sample k / 1.05
    n = 20000
    stretched = np.interp(np.arange(n) / 1.05, np.arange(n), np.nan_to_num(data["none"][:n]))
    ok = np.isfinite(data["given"][:n])
    difference = data["given"][:n][ok] - stretched[ok]
    assert np.std(difference) < 0.1 * np.std(stretched)
