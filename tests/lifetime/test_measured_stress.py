"""Stresses from measured motion: slow bending read through tilt, loads learnt and left alone, files of the command."""

import copy
import json
import shutil
from dataclasses import replace

import h5py
import numpy as np
import opensees_builder
import pandas as pd
import pytest

from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.lifetime.conditions import Conditions
from probupdate.lifetime.fatigue import fatigue_model
from probupdate.lifetime.gauges import Gauges, read_gauges
from probupdate.lifetime.load_estimate import loaded_structure, smoother, used_lines, wind_cases
from probupdate.lifetime.measured_stress import record_moments
from probupdate.lifetime.spectral import ORDERS
from probupdate.reporting import built_section
from probupdate.reporting.values import Run
from probupdate.structure.description_file import parse_description
from probupdate.structure.load import load_model
from probupdate.structure.turbine_frame import build_frame
from probupdate.updating.posterior_file import Posterior, read_posterior, write_posterior
from tests.lifetime.test_fatigue_export import toml
from tests.lifetime.test_stress import CONDITIONS, UPDATED, _toml
from tests.small_turbine import SENSORS, small_turbine

RATE, MINUTES = 5.0, 20
GRAVITY = 9.81
# thrust in N: slow beside the first mode of 0.9 Hz, so that the structure follows it statically
AMPLITUDE, SLOW_HZ = 2e5, 1 / 75
HUB_M, WELD_M, RADIUS_M, WALL_M = 52.0, 12.0, 2.5, 0.03


def hand_stress(force):
    """Bending stress in MPa at the tower's foot, statically determinate: force times lever over the section modulus."""
    inner = RADIUS_M - WALL_M
    second = np.pi / 4 * (RADIUS_M**4 - inner**4)
    return 1e-6 * force * (HUB_M - WELD_M) * RADIUS_M / second


@pytest.fixture(scope="module")
def tilted(opensees_module):
    """(n_channel,) displacement along each channel, and tilt as it reads it, of 1 N at the hub along x, by OpenSees."""
    raw = small_turbine()
    description = parse_description(raw, "small")
    frame = build_frame(description)
    ops = opensees_module
    values = description.values | {p["name"]: p["initial"] for p in raw["parameter"]}
    opensees_builder.build(ops, frame, values)
    hub = int(np.argmin(np.linalg.norm(frame.node_m - [-4.0, 0.0, HUB_M], axis=1)))
    opensees_builder.static(ops, hub, np.array([1.0, 0, 0, 0, 0, 0]))
    moved, tilt = [], []
    for _, _, place, direction in SENSORS:
        node = int(np.argmin(np.linalg.norm(frame.node_m - place, axis=1)))
        motion, d = np.array(ops.nodeDisp(node)), np.array(direction)
        moved.append(motion[:3] @ d)
        tilt.append(motion[3:] @ np.array([-d[1], d[0], 0.0]))
    return np.array(moved), np.array(tilt)


def slow_record(tilted, n, rng, noise=2e-6):
    """Readings (n, n_channel) and thrust (n,) of a slow sine."""
    t = np.arange(n) / RATE
    omega = 2 * np.pi * SLOW_HZ
    force = AMPLITUDE * np.sin(omega * t)
    moved, tilt = tilted
    # acceleration, less what gravity has along the tilted axis
    reading = -(omega**2 * moved + GRAVITY * tilt) * force[:, None]
    return reading + noise * rng.standard_normal(reading.shape), force


@pytest.fixture(scope="module")
def case(tmp_path_factory, tilted):
    """A run directory, a campaign of two blocks and fatigue.toml of the small turbine."""
    folder = tmp_path_factory.mktemp("stresses")
    raw = small_turbine()
    for p in raw["parameter"]:
        p["update"] = p["name"] in UPDATED[:3]
    (folder / "run").mkdir()
    (folder / "run" / "model.toml").write_text(toml(raw))
    conditions = copy.deepcopy(CONDITIONS)
    # walls for which ranges count 1.19 times as much: no stress is that much larger
    conditions["curve"]["T"]["reference_thickness_m"] = WALL_M / 2
    (folder / "fatigue.toml").write_text(_toml(conditions))
    model = load_model(folder / "run" / "model.toml")
    rng = np.random.default_rng(1)
    width = len(model.parameters)
    theta = model.parameters.initial * (1 + 1e-3 * rng.standard_normal((4, 100, width)))
    write_posterior(Posterior(
        names=model.parameters.names, theta=theta, log_likelihood=np.zeros((4, 100)), log_posterior=np.zeros((4, 100)),
        prior=theta[0, :10], response_labels=("f",), measured=np.ones(1), std=np.ones(1), predicted=np.ones((2, 1)),
        frequency_hz=np.ones((2, 1)), mode_labels=("FA1",), r_hat=np.ones(width), ess=np.full(width, 400.0),
        converged=True, verdict="made up", fingerprint="none"), folder / "run" / "posterior.nc")
    campaign = folder / "campaign"
    (campaign / "acceleration").mkdir(parents=True)
    lines = [f'name = "slow"\nsampling_rate_hz = {RATE}\nblock_minutes = {MINUTES}\n']
    lines += [f'[[sensor]]\nchannel = "{c}"\nlevel = "{level}"\nposition_m = {place}\ndirection = {d}\n'
              'quantity = "acceleration"\nunit = "m/s2"\n' for c, level, place, d in SENSORS]
    (campaign / "campaign.toml").write_text("".join(lines))
    n = int(RATE * 60 * MINUTES)
    reading, force = slow_record(tilted, 2 * n, rng)
    with h5py.File(campaign / "acceleration" / "a.h5", "w") as file:
        file["data"] = reading.astype(np.float32)
        file["data"].attrs.update({"start": "2024-03-01T00:00:00Z", "sampling_rate_hz": RATE})
    return folder, force


@pytest.fixture(scope="module")
def written(case):
    folder, _ = case
    out = folder / "out"
    assert main(["stresses", str(folder / "campaign"), "--run", str(folder / "run"), "--fatigue",
                 str(folder / "fatigue.toml"), "--draws", "2", "--worst", "40", "--out", str(out)]) == 0
    return out


def test_slow_bending_is_that_of_statics(case, written, validation):
    _, force = case
    spots = pd.read_csv(written / "hot_spots.csv").set_index("hot_spot")
    history = pd.read_csv(next(iter(written.glob("history_*.csv"))))
    column = next(c for c in history if c.startswith("hot_spot") and spots.loc[int(c.split("_")[2]), "side"] == "weld")
    expected = np.abs(hand_stress(AMPLITUDE))
    found = np.sqrt(2) * history[column].std()
    # eight places round the weld: the worst one is the place along the thrust
    validation(what="stress at the tower's foot from nine accelerometers, a slow thrust of 75 s",
               reference="force times arm by hand; readings by OpenSees' rotations",
               why="scatter of the sensors' noise, and the window's ends").error(abs(found / expected - 1), below=0.03)


def gauge_table(folder, written, factor=1.0, shift="0s", noise=0.02):
    """Of the weld's places along the thrust, as a gauge reads them there at 4 Hz: the force's statics and noise."""
    spots = pd.read_csv(written / "hot_spots.csv")
    own = spots[(spots["side"] == "weld") & spots["place"].isin([1, 5])].sort_values("place")["hot_spot"].tolist()
    n = int(4 * 60 * 2 * MINUTES)
    t = np.arange(n) / 4
    stress = factor * hand_stress(AMPLITUDE) * np.sin(2 * np.pi * SLOW_HZ * t)
    rng = np.random.default_rng(9)
    time = pd.Timestamp("2024-03-01T00:00:00Z") + pd.Timedelta(shift) + pd.to_timedelta(t, unit="s")
    table = pd.DataFrame({"time": time.strftime("%Y-%m-%dT%H:%M:%S.%f%z")})
    for k, spot in enumerate(own):
        table[f"hot_spot_{spot}_mpa"] = (1, -1)[k] * stress + noise * rng.standard_normal(n) + 40.0
    table.to_csv(folder / "gauges.csv", index=False)
    return own


def test_gauges_held_out_are_beside_the_estimate(case, written, tmp_path, capsys):
    folder, _ = case
    own = gauge_table(tmp_path, written)
    assert main(["stresses", str(folder / "campaign"), "--run", str(folder / "run"), "--fatigue",
                 str(folder / "fatigue.toml"), "--draws", "1", "--worst", "2", "--gauges",
                 str(tmp_path / "gauges.csv"), "--out", str(tmp_path / "out")]) == 0
    assert f"gauge at hot spot {own[0]}: estimated over measured range" in capsys.readouterr().out
    table = pd.read_csv(tmp_path / "out" / "gauges.csv", comment="#")
    assert sorted(set(table["hot_spot"])) == sorted(own) and len(table) == 4
    assert table["std_over_measured"].to_numpy() == pytest.approx(np.ones(4), abs=0.04)
    assert table["del_m5_over_measured"].to_numpy() == pytest.approx(np.ones(4), abs=0.06)
    # the sign of thrust is the readings': what pulls one side presses the other
    assert np.abs(table["correlation"]).min() > 0.99
    assert (tmp_path / "out" / "stress_over_gauges.png").stat().st_size > 10_000


def weld_error(folder, campaign, out, *options):
    """RMS error, of the true stress' RMS, of the history at a place of the weld along the thrust, and which it is."""
    assert main(["stresses", str(campaign), "--run", str(folder / "run"), "--fatigue", str(folder / "fatigue.toml"),
                 "--draws", "1", "--worst", "40", "--out", str(out), *map(str, options)]) == 0
    spots = pd.read_csv(out / "hot_spots.csv").set_index("hot_spot")
    history = pd.read_csv(next(iter(out.glob("history_*.csv"))))
    column = next(c for c in history if c.startswith("hot_spot") and spots.loc[int(c.split("_")[2]), "side"] == "weld")
    place = spots.loc[int(column.split("_")[2]), "place"]
    # thrust along x stretches the side that it comes from
    true = -np.cos(np.radians(45 * (place - 1))) * hand_stress(AMPLITUDE) * np.sin(
        2 * np.pi * SLOW_HZ * history["time_s"])
    return np.sqrt(np.mean((history[column] - true) ** 2) / np.mean(true**2)), place


def test_a_gauge_in_the_estimate_makes_a_held_out_spot_better(case, written, tilted, tmp_path, validation):
    folder, _ = case
    noisy = tmp_path / "campaign"
    shutil.copytree(folder / "campaign", noisy)
    reading, _ = slow_record(tilted, 2 * int(RATE * 60 * MINUTES), np.random.default_rng(3), noise=0.1)
    with h5py.File(noisy / "acceleration" / "a.h5", "r+") as file:
        file["data"][...] = reading.astype(np.float32)
    own = gauge_table(tmp_path, written)
    # a gauge 45 degrees off the thrust, as statics have it; the places along it are held out
    table, spots = pd.read_csv(tmp_path / "gauges.csv"), pd.read_csv(written / "hot_spots.csv")
    beside = spots.loc[(spots["side"] == "weld") & (spots["place"] == 2), "hot_spot"].iloc[0]
    table[f"hot_spot_{beside}_mpa"] = -table[f"hot_spot_{own[0]}_mpa"] / np.sqrt(2)
    table[["time", f"hot_spot_{beside}_mpa"]].to_csv(tmp_path / "one.csv", index=False)
    without, first = weld_error(folder, noisy, tmp_path / "without")
    joined, second = weld_error(folder, noisy, tmp_path / "with", "--with-gauges", tmp_path / "one.csv")
    assert 2 not in (first, second)
    validation(what="stress at a weld from noisy accelerometers and one strain gauge 45 degrees beside it",
               reference="force times arm by hand; readings by OpenSees' rotations",
               why="share that the model may miss of a gauge").error(joined, below=0.1)
    assert without > 0.2
    notes = json.loads((tmp_path / "with" / "stresses.json").read_text())["notes"]
    assert any(f"take part in the estimate: hot spots {beside}" in note for note in notes)


def test_gauges_of_another_day_are_no_input(case, written, tmp_path, capsys):
    folder, _ = case
    gauge_table(tmp_path, written, shift="3D")
    assert main(["stresses", str(folder / "campaign"), "--run", str(folder / "run"), "--fatigue",
                 str(folder / "fatigue.toml"), "--draws", "1", "--with-gauges", str(tmp_path / "gauges.csv"), "--out",
                 str(tmp_path / "out")]) == 2
    assert "no gauge recorded a whole block" in capsys.readouterr().err


@pytest.mark.parametrize("text, said", [
    ("time,hot_spot_1_mpa\n2024-03-01T00:00:00Z,1\n2024-03-01T00:00:00Z,2\n", "do not rise"),
    ("time,hot_spot_1_mpa,strain\n2024-03-01T00:00:00Z,1,2\n", "has the column strain"),
    ("time\n2024-03-01T00:00:00Z\n", "has no column of times or none of a gauge"),
    ("time,hot_spot_99999_mpa\n2024-03-01T00:00:00Z,1\n", "there are"),
    ("time,hot_spot_1_mpa\nyesterday,1\n", "times or stresses that are none"),
    # strain as a share, and kPa
    ("time,hot_spot_1_mpa\n2024-03-01T00:00:00Z,1e-5\n2024-03-01T00:00:01Z,2e-5\n", "times Young's modulus"),
    ("time,hot_spot_1_mpa\n2024-03-01T00:00:00Z,1e3\n2024-03-01T00:00:01Z,2e3\n", "kPa over 1000"),
])
def test_a_table_that_is_none_of_gauges_is_refused(tmp_path, text, said):
    (tmp_path / "gauges.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_gauges(tmp_path / "gauges.csv", 8)


def test_a_gap_of_a_gauge_is_not_bridged():
    t = np.arange(0, 1200, 0.25)
    stress = np.sin(t)[:, None] * np.ones(2)
    stress[1000:1200, 1] = np.nan
    one = Gauges(time_s=t + pd.Timestamp("2024-03-01T00:00:00Z").timestamp(), spots=np.arange(2), stress_mpa=stress)
    over = one.at_times(pd.Timestamp("2024-03-01T00:00:00Z"), np.arange(0, 1199, 0.2))
    assert np.isfinite(over[:, 0]).all() and np.isnan(over[:, 1]).all()
    assert np.isnan(one.at_times(pd.Timestamp("2024-03-02T00:00:00Z"), np.arange(0, 1199, 0.2))).all()


def test_every_hot_spot_has_its_interval_and_what_is_resolved(written):
    spots = pd.read_csv(written / "hot_spots.csv")
    # x_scf of fatigue.toml, 10 % of a range, is a factor of 1.6 and more on damage of m = 3 between the quantiles
    assert np.all(spots["p95"] > 1.6 * spots["p05"])
    assert np.all(spots["resolved"].between(0, 1))
    assert np.array_equal(spots["observable"], spots["resolved"] >= 0.9) and spots["observable"].nunique() == 2


def test_states_that_were_not_measured_are_said(written):
    kept = json.loads((written / "stresses.json").read_text())
    assert list(kept["measured_states"]) == ["storm"] and kept["blocks"] == 2
    assert any("slower than ten minutes" in note for note in kept["notes"])


def test_blocks_without_wind_are_said_to_stand_for_a_state(written):
    notes = json.loads((written / "stresses.json").read_text())["notes"]
    assert any("no wind speed is known of 2 blocks" in note and "'storm'" in note for note in notes)


def test_a_cycle_of_one_size_does_the_damage_of_that_size(written, validation):
    """A Gaussian of the same spectrum has ranges of all sizes: of m = 5 it does 3.3 times the damage."""
    spots = pd.read_csv(written / "hot_spots.csv").sort_values("hot_spot")
    weld = int(np.flatnonzero((spots["side"] == "weld") & (spots["place"] == 1))[0])
    row = validation(what="equivalent range of a slow thrust of one size at the tower's foot, m = 3 and 5",
                     reference="twice the amplitude of statics by hand, times the cycles a second to 1 / m",
                     why="scatter of the sensors' noise, and the window's ends")
    with np.load(written / "all_blocks.npz") as blocks:
        for k, m in enumerate((3, 5)):
            expected = 2 * abs(hand_stress(AMPLITUDE)) * SLOW_HZ ** (1 / m)
            row.error(blocks["equivalent_mpa"][:, k, weld] / expected - 1, below=0.04)


def test_slow_lines_count_what_ten_minute_records_close():
    """As in `fatigue`: of a cycle as slow as the record 0.92 of its variance."""
    rng = np.random.default_rng(11)
    _, f = used_lines(int(RATE * 600), RATE)
    lines = drawn(rng, 3, len(f)) / f
    lines[:, -1] = 0
    found = record_moments(f, lines)[:, 0]
    share = 1 - 0.08 / (600 * f)
    assert share[0] == pytest.approx(0.92, rel=1e-12)
    expected = [np.sum(f**k * share * np.abs(lines[1]) ** 2) * f[0] for k in ORDERS]
    assert found[:, 1, 1] == pytest.approx(np.array(expected), rel=1e-5)


def test_a_run_with_stresses_shows_them_in_its_report(written, tmp_path):
    shutil.copytree(written, tmp_path / "stresses")
    run = Run(folder=tmp_path, title="small", missing=(), provenance=())
    section = built_section("stress_section", run)
    spots = pd.read_csv(written / "hot_spots.csv")
    assert section.items[0].rows[0][0] == str(spots["hot_spot"].iloc[0])
    pictures = [item for item in section.items if item.kind == "picture"]
    # of wind and heading nothing was recorded
    assert len(pictures) == 2 and all("]</text>" in p.svg or "[a]" in p.svg or "[MPa]" in p.svg for p in pictures)
    (tmp_path / "stresses" / "hot_spots.csv").write_text("hot_spot\n1\n")
    with pytest.raises(InputError, match="has no column 'member'"):
        built_section("stress_section", run)


def test_a_run_without_stresses_has_no_section_of_them(tmp_path):
    assert built_section("stress_section", Run(folder=tmp_path, title="small", missing=(), provenance=())) is None


def test_figures_are_drawn_of_what_there_is(written):
    assert {p.name for p in written.glob("*.png")} == {"stress_history.png", "life.png"}


@pytest.mark.parametrize(("change", "words"), [
    (["--without", "T99-x"], "'T99-x' is not a channel"),
    (["--out", "."], "holds something already"),
], ids=["channel", "folder"])
def test_mistakes_are_named_before_the_work(case, capsys, monkeypatch, change, words):
    folder, _ = case
    monkeypatch.chdir(folder)
    given = ["stresses", "campaign", "--run", "run", "--fatigue", "fatigue.toml", "--out", "new", *change]
    assert main(given) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(("elsewhere", "words"), [([], "or name it (--model)"),
                                                  (["--model", "run/model.toml"], "'T99-x' is not a channel")])
def test_the_model_may_lie_outside_the_run(case, capsys, tmp_path, monkeypatch, elsewhere, words):
    """What is refused after the model is found says that it is."""
    folder, _ = case
    monkeypatch.chdir(folder)
    shutil.copy(folder / "run" / "posterior.nc", tmp_path)
    assert main(["stresses", "campaign", "--run", str(tmp_path), "--fatigue", "fatigue.toml", "--out", "new",
                 "--without", "T99-x", *elsewhere]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("step", [["stresses", "campaign", "--out", "new", "--run"],
                                  ["export", "--to", "lifetime", "--draws", "2"]])
def test_matrices_are_refused_before_a_posterior_is_asked_for(case, capsys, tmp_path, monkeypatch, step):
    folder, _ = case
    monkeypatch.chdir(folder)
    (tmp_path / "model.npz").write_bytes(b"")
    assert main([*step, str(tmp_path), *["new"][: step[0] == "export"], "--fatigue", "fatigue.toml"]) == 2
    words = capsys.readouterr().err
    assert "has no members" in words and "probupdate sample" not in words


def test_channels_that_are_not_the_models_are_an_error(case, capsys, tmp_path):
    folder, _ = case
    other = tmp_path / "campaign"
    other.mkdir()
    text = (folder / "campaign" / "campaign.toml").read_text().replace('channel = "', 'channel = "other-')
    (other / "campaign.toml").write_text(text)
    (other / "acceleration").mkdir()
    shutil.copy(folder / "campaign" / "acceleration" / "a.h5", other / "acceleration")
    assert main(["stresses", str(other), "--run", str(folder / "run"), "--fatigue", str(folder / "fatigue.toml"),
                 "--out", str(tmp_path / "o")]) == 2
    assert "is one of the model's" in capsys.readouterr().err


def test_a_channel_along_another_direction_is_refused(case, capsys, tmp_path):
    folder, _ = case
    other = tmp_path / "campaign"
    shutil.copytree(folder / "campaign", other)
    text = (other / "campaign.toml").read_text()
    (other / "campaign.toml").write_text(text.replace("direction = [1.0, 0.0, 0.0]", "direction = [-1.0, 0.0, 0.0]", 1))
    assert main(["stresses", str(other), "--run", str(folder / "run"), "--fatigue", str(folder / "fatigue.toml"),
                 "--out", str(tmp_path / "o")]) == 2
    assert "state the sensor's direction alike in both" in capsys.readouterr().err


@pytest.fixture(scope="module")
def reduced():
    """The small turbine under its storm, reduced to what wind and waves make of it."""
    raw = copy.deepcopy(CONDITIONS)
    raw["direction"] = [{"heading_deg": 0.0, "share": 1.0}]
    source = small_turbine()
    for p in source["parameter"]:
        p["update"] = p["name"] in UPDATED[:3]
    model = fatigue_model(parse_description(source, "small"), "small", Conditions.model_validate(raw)).models[0]
    return model.reduce([model.parameters.initial], both_ways=True)


@pytest.fixture(scope="module")
def structure(reduced):
    """At the lines of a block."""
    _, f = used_lines(int(RATE * 60 * MINUTES), RATE)
    return loaded_structure(reduced, reduced.parameters.initial, {}, wind_cases(reduced, 0, f), f,
                            np.zeros(len(SENSORS), int), 6)


def test_stresses_are_those_of_all_modes_and_of_waves_at_every_line(structure, reduced, validation):
    state = reduced.conditions.model_copy(update={"state": reduced.conditions.state[:1]})
    plain = replace(reduced, frequency_hz=structure.frequency_hz, conditions=state)
    m, wet = plain.modes_at(reduced.parameters.initial, {}), structure.frequency_hz <= 0.6
    hubs = [m.U.T @ (plain.basis.T @ hub) for hub in (plain.hub, plain.across)]
    waves = [model.cases[0] for model in (plain, plain.rotate_loads())]
    expected = [m.stress(hub[:, None] / m.plain) for hub in hubs]
    expected += [m.stress((m.U.T @ c.load) / m.plain[:, wet]) - m.scale * c.own for c in waves]
    error = []
    for name, full in zip(("thrust along the wind", "thrust across the wind", "waves along the wind",
                           "waves across the wind"), expected, strict=True):
        load = np.zeros((len(structure.names), len(structure.frequency_hz)), complex)
        load[structure.names.index(name)] = 1.0
        left = structure.stress(load)[:, : full.shape[1]] - full
        error.append(np.max(np.abs(left)) / np.max(np.abs(full)))
    validation(what="stresses of unit loads: shapes for the modes above 12 Hz, waves between nodes",
               reference="all modes, waves at every line", why="single precision, splines").error(error, below=3e-4)


def drawn(rng, *size):
    return (rng.standard_normal(size) + 1j * rng.standard_normal(size)) / np.sqrt(2)


def test_loads_given_readings_are_those_of_the_dense_gaussian(structure):
    rng = np.random.default_rng(2)
    n = len(structure.frequency_hz)
    H = structure.read(np.arange(n))
    p = np.sqrt(structure.stated) * drawn(rng, len(structure.stated), n)
    y = np.einsum("lci,il->lc", H, p) + 1e-5 * drawn(rng, n, H.shape[1])
    one = smoother(structure, y[:, :, None] * np.conj(y[:, None, :]), np.arange(H.shape[1]))
    found = one.estimate(y)
    for k in (3, 200, 1500):
        D, N = np.diag(one.load[:, k]), np.diag(one.noise[k])
        S = H[k] @ D @ H[k].conj().T + N
        # scaled, as entries differ by many orders of magnitude
        root = np.diag(1 / np.sqrt(np.real(np.diag(S))))
        expected = D @ H[k].conj().T @ root @ np.linalg.solve(root @ S @ root, root @ y[k])
        std = np.sqrt(one.load[:, k])
        np.testing.assert_allclose(found[:, k] / std, expected / std, atol=1e-6)


@pytest.mark.parametrize("times", [1e2, 1e4, 1e6])
def test_a_mode_that_shakes_far_more_than_stated_is_in_the_stress(structure, times):
    """Forces of many times the stated density stayed noise: a second bending mode was not in the history."""
    rng = np.random.default_rng(4)
    n, mode = len(structure.frequency_hz), structure.names.index("mode 4")
    of_mode = float(np.sqrt(structure.modes.value[3]) / (2 * np.pi))
    H = structure.read(np.arange(n))
    density = np.array(structure.stated)
    density[mode] *= times
    p = np.sqrt(density) * drawn(rng, len(density), n)
    y = np.einsum("lci,il->lc", H, p)
    noise = 1e-2 * np.sqrt(np.mean(np.abs(y) ** 2))
    y = y + noise * drawn(rng, *y.shape)
    one = smoother(structure, y[:, :, None] * np.conj(y[:, None, :]), np.arange(H.shape[1]))
    near = np.abs(structure.frequency_hz / of_mode - 1) < 0.03
    found, true = (structure.stress(load)[:, near] for load in (one.estimate(y), p))
    worst = np.argmax(np.sum(np.abs(true) ** 2, axis=1))
    left = np.sum(np.abs(found[worst] - true[worst]) ** 2) / np.sum(np.abs(true[worst]) ** 2)
    assert left < 0.05


def test_a_load_that_no_sensor_sees_keeps_its_stated_density(structure):
    rng = np.random.default_rng(3)
    n = len(structure.frequency_hz)
    along = [k for k, (c, *_) in enumerate(SENSORS) if c.endswith("-x") and c.startswith("T50")]
    H = structure.read(np.arange(n))[:, along]
    y = np.einsum("lci,il->lc", H, np.sqrt(structure.stated) * drawn(rng, len(structure.stated), n))
    one = smoother(structure, y[:, :, None] * np.conj(y[:, None, :]), np.array(along))
    across = structure.names.index("thrust across the wind")
    slow = structure.frequency_hz < 0.05
    share = one.load[across, slow] / structure.stated[across, slow]
    assert np.median(share) == pytest.approx(1.0, abs=0.2)
    left = np.real(one.unresolved_covariance(np.flatnonzero(slow)))[:, across, across] / one.load[across, slow]
    assert np.median(left) > 0.95


def diagnosis_json(folder, *findings):
    """As `diagnose` writes it, with these findings: (cause, location, size)."""
    content = {"format": 2, "verdict": "named", "p_value": 1e-6, "detectable_sizes": [], "parameters": [], "notes": [],
               "details": {}, "findings": [
                   {"kind": "measurement", "cause": cause, "location": location, "size": size, "size_std": 0.01,
                    "unit": "-", "posterior_probability": 1.0, "alternatives": []}
                   for cause, location, size in findings]}
    (folder / "diagnosis.json").write_text(json.dumps(content))


@pytest.fixture
def diagnosed(case, tmp_path):
    """`stresses` of the campaign on a run with these findings, with these options."""
    folder, _ = case
    shutil.copytree(folder / "run", tmp_path / "run")

    def called(findings, *options):
        diagnosis_json(tmp_path / "run", *findings)
        return main(["stresses", str(folder / "campaign"), "--run", str(tmp_path / "run"), "--fatigue",
                     str(folder / "fatigue.toml"), "--draws", "1", "--worst", "1", "--out", str(tmp_path / "out"),
                     *options])
    return called


@pytest.mark.parametrize("cause, location, named", [
    ("sensor gain", "{0}", "{0}"), ("sensor polarity", "{0}", "{0}"),
    ("swapped channels", "{0} and {1}", "{0} {1}"), ("crosstalk", "{1} into {0}", "{0}"),
    ("sensor rotation", "TP-A about z", "{0} {1}"), ("clock offset", "T30", "T30-x T30-y"),
    ("sampling rate", "all channels", ""),
])
def test_a_channel_that_the_diagnosis_found_wrong_is_refused(diagnosed, capsys, cause, location, named):
    first, second = SENSORS[0][0], SENSORS[1][0]
    where = location.format(first, second)
    assert diagnosed([(cause, where, 0.12)]) == 2
    said = capsys.readouterr().err
    assert f"{cause}, {where}" in said and "--accept" in said and "campaign.toml" in said
    left = f"(--without {named.format(first, second)})"
    assert left in said if named else "--without" not in said


def test_a_wrong_channel_left_out_is_none(diagnosed, tmp_path):
    assert diagnosed([("sensor gain", SENSORS[0][0], 0.12)], "--without", SENSORS[0][0]) == 0
    assert "ACCEPTED" not in json.loads((tmp_path / "out" / "stresses.json").read_text())["verdict"]


def test_a_wrong_channel_that_is_accepted_is_said(diagnosed, tmp_path, capsys):
    assert diagnosed([("sensor gain", SENSORS[0][0], 0.12)], "--accept") == 0
    said = f"sensor gain, {SENSORS[0][0]}: +12"
    assert said in json.loads((tmp_path / "out" / "stresses.json").read_text())["verdict"]
    assert said in capsys.readouterr().out


# the state of the structure, and the loads that are stated -----------------------------------------------------------


@pytest.fixture
def changed(case, tmp_path, capsys):
    """What `stresses` says of a run whose structure changed between its two blocks, with draws of this set."""
    folder, _ = case
    run = tmp_path / "run"
    shutil.copytree(folder / "run", run)
    diagnosis_json(run, ("leg stiffness lost", "leg A, bay 1", -0.3))
    content = json.loads((run / "diagnosis.json").read_text())
    content["findings"][0] |= {"kind": "structural", "time_profile": "step", "since": "2024-03-01T00:20Z"}
    (run / "diagnosis.json").write_text(json.dumps(content))

    def called(set_id):
        draws = replace(read_posterior(run / "posterior.nc"), record={"set_id": set_id})
        write_posterior(draws, run / "diagnosis.posterior.nc")
        code = main(["stresses", str(folder / "campaign"), "--run", str(run), "--fatigue",
                     str(folder / "fatigue.toml"), "--draws", "1", "--worst", "1", "--out", str(tmp_path / "out")])
        return code, "".join(capsys.readouterr())
    return called


def test_stresses_of_the_state_after_are_of_its_blocks(changed, tmp_path):
    code, said = changed("2024-03-01T00:20Z")
    assert code == 0 and "1 block before 2024-03-01T00:20Z, when the structure changed" in said
    assert json.loads((tmp_path / "out" / "stresses.json").read_text())["blocks"] == 1


def test_stresses_of_the_state_before_are_refused(changed):
    code, said = changed("2024-03-01T00:00Z")
    assert code == 2 and "must be of the state after alone: these are of 2024-03-01T00:00Z" in said


@pytest.mark.parametrize("turbulence", [0.024, 0.12])
def test_stated_loads_that_make_far_less_than_the_measured_damage_are_said(case, tmp_path, capsys, turbulence):
    folder, _ = case
    text = (folder / "fatigue.toml").read_text()
    (tmp_path / "fatigue.toml").write_text(text.replace("turbulence = 0.12", f"turbulence = {turbulence}")
                                           .replace("hs_m = 4.0", f"hs_m = {4 * turbulence / 0.12}"))
    assert main(["stresses", str(folder / "campaign"), "--run", str(folder / "run"), "--fatigue",
                 str(tmp_path / "fatigue.toml"), "--draws", "1", "--worst", "1", "--out", str(tmp_path / "out")]) == 0
    worst = pd.read_csv(tmp_path / "out" / "hot_spots.csv").iloc[0]
    apart = worst["damage_per_year"] / worst["stated_damage_per_year"]
    assert ("loads are missing there" in capsys.readouterr().out) == (not 0.1 < apart < 10)
    assert apart > 10 or turbulence == 0.12
