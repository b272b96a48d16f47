"""What sensors say of one another: gains that change, rigid parts, headings, references of setups, rotor lines."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy import signal

import probupdate
from probupdate.campaign.blocks import Block, block_files, read_block
from probupdate.campaign.checking import check
from probupdate.campaign.findings import channel_findings, mounting_findings, rate_findings
from probupdate.campaign.gain_steps import gain_step_findings, gain_steps, parts_of_block
from probupdate.campaign.heading import Sway, block_sway, heading_findings, heading_offset
from probupdate.campaign.mounting import TURNED, Suspicion
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.rigid_bodies import campaign_gains, natural_groups, rigid_candidates, wrong_gains
from probupdate.campaign.rotor_lines import RateRatio, line_scores, rate_ratio
from probupdate.campaign.samples import channel_table
from probupdate.modal.modes import Sensor
from probupdate.virtual.simulation import simulate

FRAME = Path(__file__).parents[2].parent / "shared" / "data" / "weimar_frame"
RATE = 20.0


def unit(rng, n) -> np.ndarray:
    d = rng.standard_normal((n, 3))
    return d / np.linalg.norm(d, axis=1)[:, None]


def modal_record(rng, shape: np.ndarray, n: int, noise=0.02, frequency=(0.9, 1.1, 1.7, 2.9, 3.3)) -> np.ndarray:
    """(n, n_channel) motion of some lightly damped modes under noise; noise of every channel a share of its own."""
    y = np.zeros((n, len(shape)))
    for j in range(shape.shape[1]):
        w = 2 * np.pi * frequency[j]
        pole = np.exp((-0.015 + 1j * np.sqrt(1 - 0.015**2)) * w / RATE)
        q = signal.lfilter([1.0], np.poly([pole, pole.conj()]).real, rng.standard_normal(n + 2000))[2000:]
        y += np.outer(q / q.std(), shape[:, j])
    return y + noise * y.std(axis=0) * rng.standard_normal(y.shape)


def written(folder: Path, sensors, data: np.ndarray, minutes=10.0) -> Path:
    (folder / "acceleration").mkdir(parents=True)
    lines = [f'name = "{folder.name}"\nsampling_rate_hz = {RATE}\nblock_minutes = {minutes}\n']
    for s in sensors:
        lines.append(f'[[sensor]]\nchannel = "{s.channel}"\nlevel = "any"\n'
                     f'position_m = {list(map(float, s.position_m))}\n'
                     f'direction = {list(map(float, s.direction))}\nquantity = "acceleration"\nunit = "m/s2"\n')
    (folder / "campaign.toml").write_text("".join(lines))
    with h5py.File(folder / "acceleration" / "0.h5", "w") as file:
        dataset = file.create_dataset("data", data=np.asarray(data, np.float32))
        dataset.attrs["start"], dataset.attrs["sampling_rate_hz"] = "2021-05-04T10:00:00Z", RATE
    return folder


# Gains that change ------------------------------------------------------------------------------------------------


def oblique(seed: int, n_channel=8, n=24000):
    rng = np.random.default_rng(seed)
    sensors = tuple(Sensor(channel=f"c{k}", level="", position_m=p, direction=d) for k, (p, d) in enumerate(
        zip(rng.uniform(-5, 5, (n_channel, 3)), unit(rng, n_channel), strict=True)))
    return sensors, modal_record(rng, rng.standard_normal((n_channel, 3)), n), rng


def steps_of(sensors, data):
    pieces = parts_of_block("a", data, RATE, sensors, np.ones(len(sensors), bool), 12, 128)
    return gain_steps(pieces, sensors, 0.9)


def test_a_gain_that_changes_by_a_tenth_is_found_by_any_sensors_and_sound_ones_are_silent(validation):
    """Oblique sensors at drawn places, 20 minutes of three modes: 20 sound records, a change by 10 % in 20 others."""
    row = validation(what="gain changed by 10 % half-way, eight oblique sensors, 20 drawn records each way",
                     reference="what was planted; sound records")
    alarms, right = 0, 0
    for seed in range(7100, 7120):
        sensors, data, rng = oblique(seed)
        found, use = steps_of(sensors, data)
        assert "gains of 8 of 8 channels followed" in use
        alarms += len(found)
        c, gain, part = int(rng.integers(8)), float(rng.choice([0.9, 1.1])), int(rng.integers(4, 9))
        data[part * 2000:, c] *= gain
        found, _ = steps_of(sensors, data)
        right += (len(found) == 1 and found[0].channel == f"c{c}" and abs(found[0].size - gain) < 3 * found[0].std
                  and found[0].since == f"a + {part * 100} s")
    row.count(right, 20, least=18, of="right, within 3 stated standard deviations")
    row.count(20 - alarms, 20, least=19, of="sound ones silent")


def test_a_turned_sign_and_a_logger_half_way_are_one_finding_each(validation):
    row = validation(what="sign and scale turned half-way; three channels of a logger", reference="-2.0; 1.15")
    sensors, data, _ = oblique(7201)
    turned = data.copy()
    turned[12000:, 3] *= -2.0
    (one,), _ = steps_of(sensors, turned)
    assert one.channel == "c3" and one.since == "a + 600 s"
    row.error(one.size + 2.0, below=0.1, of="sign")
    # three channels at one place have one logger
    together = tuple(replace(s, position_m=sensors[0].position_m) if k < 3 else s for k, s in enumerate(sensors))
    data[12000:, :3] *= 1.15
    (one,), _ = steps_of(together, data)
    assert one.channel == "c0, c1, c2"
    row.error((one.size - 1.15) / one.std, below=3, of="logger, in stated standard deviations")
    assert "look at their logger" in one.message


def test_two_channels_are_alternatives_of_one_another():
    sensors, data, _ = oblique(7301, n_channel=2)
    data = data[:, :1] * [1.0, 0.7] + 0.02 * np.random.default_rng(1).standard_normal(data.shape)
    data[12000:, 1] *= 1.2
    (one,), _ = steps_of(sensors, data)
    assert {one.channel, *one.alternatives} == {"c0", "c1"} and "by the inverse instead" in one.message


def test_two_gains_that_change_by_the_inverse_of_one_another_may_be_an_exchange():
    def said(*steps):
        changes = [(c, at, size, 0.03, ()) for c, at, size in steps]
        found = gain_step_findings(changes, list("abcde"), ["x2", "x4", "y1"])
        return {f.channel: next((w for w in ("exchanged", "structure") if w in f.message), "") for f in found}

    assert said((0, 1, 1.9), (1, 1, 0.53)) == {"x2": "exchanged", "x4": "exchanged"}
    assert said((0, 1, 1.9), (1, 1, 0.7)) == {"x2": "structure", "x4": "structure"}
    # at another time, or with one of two, it is none; nor does a structure turn a sign
    assert said((0, 0, 1.9), (1, 4, 0.53), (2, 4, -1.0)) == {"x2": "structure", "x4": "structure", "y1": ""}
    assert said((0, 1, 1.9), (1, 1, 0.53), (2, 1, 0.53)) == {"x2": "structure", "x4, y1": "structure"}


@pytest.mark.parametrize("spring", [0, 1])
def test_a_gain_that_a_loosened_spring_gives_is_not_left_out(spring):
    """A chain of eight masses, three modes of it; one of its lowest springs has 0.3 of its stiffness from half-way."""
    def record(rng, k):
        bare = np.eye(8) - np.eye(8, k=-1)
        value, vector = np.linalg.eigh(bare.T @ np.diag(k) @ bare)
        root = np.sqrt(value[:3])
        return modal_record(rng, vector[:, :3] / root, 12000, frequency=0.9 * root / 0.1845)

    rng, k = np.random.default_rng(7401), np.ones(8)
    whole = record(rng, k)
    k[spring] = 0.3
    sensors = [Sensor(channel=f"x{i}", position_m=(0.0, 0.0, 3.0 * i), level="", direction=(1.0, 0.0, 0.0))
               for i in range(8)]
    found, _ = steps_of(sensors, np.vstack([whole, record(rng, k)]))
    assert found and all("structure may have changed" in f.message and "leave" not in f.message for f in found)


def test_files_back_to_back_show_a_wrong_clock_and_gaps_do_not():
    def said(seconds, starts):
        files = tuple(SimpleNamespace(start=pd.Timestamp("2021-05-04") + pd.Timedelta(seconds=a),
                                      n_sample=round(n * RATE)) for a, n in zip(starts, seconds, strict=True))
        found, _ = rate_findings(SimpleNamespace(sampling_rate_hz=RATE, files=files, block_minutes=9.0),
                                 RateRatio(ratio=np.nan, std=np.nan, rows=0))
        return found

    # of a logger that runs at 22 Hz and says 20, its starts to the second
    (one,) = said([660] * 6, [600, 1200, 1801, 2400, 2999, 3600])
    assert "1.1 times the samples" in one and "22 Hz" in one
    assert not said([600] * 6, np.arange(6) * 600.0)
    # a block of nine minutes in each ten is a pause; of eight and a half it may be either
    assert not said([540] * 6, np.arange(6) * 600.0) and said([510] * 6, np.arange(6) * 600.0)
    rng = np.random.default_rng(7501)
    alarms = 0
    for _ in range(300):
        seconds = rng.uniform(300, 1200, 7)
        alarms += bool(said(seconds, np.cumsum([0.0, *(seconds + rng.uniform(20, 300, 7))[:-1]])))
    # a chance of 1 % makes more than this in one of a thousand tests; it is 0.2 %
    assert alarms <= 9


@pytest.fixture(scope="module")
def three_hours(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensors") / "campaign"
    simulate(folder, days=0.125, seed=951)
    return folder


def test_check_says_what_changed_half_way_and_levels_need_no_names(three_hours, tmp_path, validation):
    row = validation(what="gain of T66-x changed by 10 %, virtual turbine, levels without names: nothing else found",
                     reference="1.1", unit="stated standard deviations")
    folder = tmp_path / "campaign"
    shutil.copytree(three_hours, folder)
    clean = check(read_campaign(folder))
    assert clean.measured == () and not [f for f in clean.findings if f.startswith("suspect")]
    assert any("gains of 18 of 18 channels followed" in u and u.endswith("only against a model") for u in clean.uses)
    assert any(u.startswith("rigid by position and record: TP-A-x") for u in clean.uses)
    text = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text(
        "\n".join('level = "somewhere"' if line.startswith("level") else line for line in text.split("\n")))
    place = read_campaign(folder).channels.index("T66-x")
    paths = sorted((folder / "acceleration").glob("*.h5"))
    for path in paths[len(paths) // 2:]:
        with h5py.File(path, "r+") as file:
            file["data"][:, place] = 1.1 * file["data"][:, place]
    result = check(read_campaign(folder))
    (one,) = result.measured
    assert one.name == "gain change" and one.channel == "T66-x"
    row.error((one.size - 1.1) / one.std, below=3)
    assert [f for f in result.findings if f.startswith("suspect")] == [one.message]
    content = result.write(tmp_path / "check.json").read_text()
    assert '"name": "gain change"' in content


# Rigid parts ------------------------------------------------------------------------------------------------------


def platform(seed: int, n_place=4, n_each=3, bends=0.0):
    """Oblique sensors on a rigid platform above a single one: what six motions and an own bending make of 40 shapes."""
    rng = np.random.default_rng(seed)
    place = np.repeat(rng.uniform(-3, 3, (n_place, 2)), n_each, axis=0)
    position = np.column_stack([place, np.full(len(place), 20.0)])
    direction = unit(rng, len(place))
    sensors = [Sensor(channel=f"p{k}", level="any", position_m=p, direction=d) for k, (p, d) in enumerate(
        zip(position, direction, strict=True))]
    motion = rng.standard_normal((40, 6))
    moved = motion[:, None, :3] + np.cross(motion[:, None, 3:] / 3, position - position.mean(axis=0))
    moved = moved + bends * rng.standard_normal((40, n_place, 3)).repeat(n_each, axis=1)
    samples = np.einsum("skd,kd->sk", moved, direction)
    samples *= 1 + 0.005 * rng.standard_normal(samples.shape[1])
    return sensors, samples + 0.005 * rng.standard_normal(samples.shape)


def test_parts_come_from_positions():
    sensors, _ = platform(1)
    leg = Sensor(channel="leg", level="any", position_m=[0, 0, 5.0], direction=[1, 0, 0])
    assert rigid_candidates([leg, *sensors]) == [tuple(range(1, 13))]
    deck = [Sensor(channel=str(k), level="", position_m=[10.0 * (k // 2), 3.0 * (k % 2), 0], direction=[0, 0, 1])
            for k in range(8)]
    assert rigid_candidates(deck) == [tuple(range(8)), (0, 1), (2, 3), (4, 5), (6, 7)]


def test_channels_are_compared_with_those_at_their_height():
    """A tower's six heights under one name move from 1 to 50; at one height a channel that moves ten times as much as
    the two beside it is suspect, whatever their levels are called."""
    tower = [Sensor(channel=f"T{k}", level="tower", position_m=[0, 0, 15.0 * k], direction=[1, 0, 0]) for k in range(6)]
    deck = [Sensor(channel=f"D{k}", level=f"leg {k}", position_m=[10.0 * k, 0, -20.0], direction=[1, 0, 0])
            for k in range(3)]
    size = np.array([1, 2, 4, 10, 25, 50, 10, 1, 1.2])
    data = np.random.default_rng(2).standard_normal((5000, len(size))) * size
    block = Block(start=pd.Timestamp("2021-01-01T00:00Z"), minutes=10.0, sampling_rate_hz=10.0, data=data,
                  missing=np.zeros(len(size)), impossible=np.zeros(len(size), int),
                  repeated=np.zeros(len(size)), filled=np.zeros(len(size)))
    sensors = [*tower, *deck]
    table = channel_table(block, tuple(s.channel for s in sensors)).assign(id="one")
    found = [sentence for sentence in channel_findings(table, sensors) if "beside it" in sentence]
    assert len(found) == 1 and found[0].startswith("suspect: D0 moves")


def test_a_logger_s_common_gain_is_found_on_a_rigid_part_and_nothing_on_one_that_bends(validation):
    row = validation(what="a logger's gain of 0.7 on a rigid platform, oblique, 20 drawn; none of one that bends",
                     reference="0.7; sound ones")
    alarms, right = 0, 0
    for seed in range(7400, 7420):
        sensors, samples = platform(seed)
        groups = natural_groups(sensors, range(len(sensors)))
        alarms += len(wrong_gains(samples, sensors, groups)[0])
        k = seed % 4
        samples[:, 3 * k: 3 * k + 3] *= 0.7
        found, share = wrong_gains(samples, sensors, groups)
        right += (len(found) == 1 and found[0].members == (3 * k, 3 * k + 1, 3 * k + 2)
                  and abs(found[0].gain - 0.7) < 4 * found[0].std and share < 0.006)
        # what bends is not rigid: nothing is said of it
        sensors, bent = platform(seed, bends=0.5)
        bent[:, 3 * k: 3 * k + 3] *= 0.7
        assert wrong_gains(bent, sensors, groups)[0] == []
    row.count(right, 20, least=19, of="right, within 4 stated standard deviations")
    row.count(20 - alarms, 20, least=20, of="sound ones silent")


def test_one_oblique_sensor_reversed_and_too_large_is_measured():
    sensors, samples = platform(7501)
    samples[:, 4] *= -2.0
    density = np.einsum("si,sj->sij", samples, samples)[None].astype(complex)
    (one,), use = campaign_gains(density, sensors, ())
    assert one.channel == "p4" and one.size == pytest.approx(-2.0, abs=4 * one.std) and one.std < 0.2
    assert use.startswith("rigid by position")
    # what another sentence names is left to it
    assert campaign_gains(density, sensors, ("suspect: p4 looks flipped",))[0] == []


# The nacelle's heading --------------------------------------------------------------------------------------------


def sways(seed: int, n=12, damping=(0.06, 0.015), follows=True, spread=90.0) -> list[Sway]:
    rng = np.random.default_rng(seed)
    frequency = np.arange(0.15, 0.6, 1 / 1800)
    found = []
    for k in range(n):
        heading = float(rng.uniform(0, spread))
        response = [1 / (0.32**2 - frequency**2 + 2j * z * 0.32 * frequency) for z in damping]
        fa, ss = (a * h * (rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency)))
                  for a, h in zip((1.0, 0.25), response, strict=True))
        # the nacelle's axis counter-clockwise from x, which looks north
        angle = np.radians(-heading if follows else 25.0)
        motion = np.column_stack([np.cos(angle) * fa - np.sin(angle) * ss, np.sin(angle) * fa + np.cos(angle) * ss])
        found.append(Sway(id=str(k), heading_deg=heading, frequency_hz=frequency, motion=motion))
    return found


def stated(found: list[Sway], off: float) -> list[Sway]:
    return [replace(s, heading_deg=s.heading_deg + off) for s in found]


def test_a_wrong_heading_is_measured_and_ninety_degrees_do_not_pass(validation):
    row = validation(what="nacelle heading off by 90, 25, -40 deg, 10 drawn campaigns, modulo 180",
                     reference="what was planted", why="half a degree at least", unit="stated standard deviations")
    for seed in range(7600, 7610):
        true = sways(seed)
        found, use = heading_findings(heading_offset(true, 0.0, 0.32))
        assert found == [] and "agrees with the planes of bending" in use
        for off in (90.0, 25.0, -40.0):
            answer = heading_offset(stated(true, off), 0.0, 0.32)
            (one,), _ = heading_findings(answer)
            # true less stated, modulo 180
            error = (answer.offset_deg + off + 90) % 180 - 90
            row.error(error / np.hypot(answer.std_deg, 0.5), below=4)
            assert one.unit == "deg" and "check its zero" in one.message
        # the axis that x looks along is taken off
        assert abs(heading_offset(stated(true, 30.0), 30.0, 0.32).offset_deg) < 4


def test_where_planes_do_not_follow_or_damping_is_equal_it_is_said():
    still = heading_offset(sways(7701, follows=False, spread=300.0), 0.0, 0.32)
    assert np.isnan(still.offset_deg) and "do not follow the nacelle" in still.why
    alike = sways(7702, damping=(0.02, 0.02))
    assert "0 is not known from 90 deg" in heading_offset(alike, 0.0, 0.32).why
    either = heading_offset(stated(alike, 30.0), 0.0, 0.32)
    assert either.either and "(or 90 more)" in heading_findings(either)[0][0].message
    assert "5 needed" in heading_offset(alike[:3], 0.0, 0.32).why
    reverse = heading_offset([replace(s, heading_deg=-s.heading_deg) for s in sways(7703, spread=300.0)], 0.0, 0.32)
    assert reverse.backwards and "other way round" in heading_findings(reverse)[0][0].message


def test_oblique_sensors_give_the_horizontal_motion():
    """Three oblique sensors at the top instead of x, y and a vertical one: the same Fourier coefficients."""
    rng = np.random.default_rng(7801)
    direction = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    true = rng.standard_normal((12000, 3))
    base = Sensor(channel="base", level="", position_m=[0, 0, 0], direction=[1, 0, 0])
    across = Sensor(channel="across", level="", position_m=[1, 0, 0], direction=[1, 0, 0])

    def of(directions):
        sensors = [base, across] + [Sensor(channel=str(k), level="", position_m=[0, 0, 50.0], direction=d)
                                    for k, d in enumerate(directions)]
        data = np.column_stack([np.zeros((12000, 2)), true @ np.array(directions).T])
        block = Block(start=pd.Timestamp("2021-01-01T00:00Z"), minutes=10.0, sampling_rate_hz=RATE, data=data,
                      missing=np.zeros(5), impossible=np.zeros(5, int), repeated=np.zeros(5), filled=np.zeros(5))
        return block_sway(block, sensors, np.ones(5, bool),
                          {"nacelle_heading_deg": 10.0, "rotor_speed_rpm": 9.0})

    assert of(direction).motion == pytest.approx(of(np.eye(3)).motion, rel=1e-3, abs=1e-2)


# References of setups ---------------------------------------------------------------------------------------------


def roving(folder: Path, seed: int, change=None) -> list[Path]:
    """Six setups of a frame of two rigid storeys: two references at the top, three oblique rovers at a corner."""
    rng = np.random.default_rng(seed)
    corner = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]], float)
    # x, y and torsion of each storey in five modes
    modes = np.array([[[1, 0.1, 0], [0.6, 0.05, 0]], [[-0.1, 1, 0.1], [0, 0.55, 0.05]], [[0.1, 0, 1], [0.1, 0, 0.6]],
                      [[0.8, -0.6, 0.2], [-1, 0.7, -0.3]], [[0.5, 0.8, 0.6], [-0.6, -0.9, -0.8]]])
    rig = [(1, 3), (1, 2), (1, 1), (0, 0), (0, 1), (0, 2)]
    paths = []
    for k, (storey, at) in enumerate(rig):
        places = [(*corner[0], 6.0)] * 2 + [(*corner[at], 6.0 if storey else 3.0)] * 3
        direction = np.vstack([[1, 0, 0], [0, 1, 0], unit(rng, 3)])
        names = ["ref-x", "ref-y", *(f"s{k}-{c}" for c in "abc")]
        sensors = [Sensor(channel=n, level="", position_m=p, direction=d)
                   for n, p, d in zip(names, places, direction, strict=True)]
        floor = [0, 0, *([0 if storey else 1] * 3)]
        shape = np.array([[m[f][0] * d[0] - m[f][2] * p[1] * d[0] + m[f][1] * d[1] + m[f][2] * p[0] * d[1]
                           for m in modes] for f, p, d in zip(floor, places, direction, strict=True)])
        data = modal_record(rng, shape, 12000, noise=0.01)
        for channel, gain in (change(k) if change else {}).items():
            data[:, names.index(channel)] *= gain
        paths.append(written(folder / f"s{k}", sensors, data))
    return paths


def test_setups_of_sound_references_are_silent(tmp_path):
    for seed in (7901, 7902, 7903):
        result = probupdate.check_setups(roving(tmp_path / str(seed), seed))
        assert result.findings == () and result.references == ("ref-x", "ref-y") and len(result.peaks_hz) >= 4


@pytest.mark.parametrize(("seed", "setups", "channel", "gain"), [
    (7911, (2,), "ref-x", -2.0), (7912, (4,), "ref-y", 0.5), (7913, (0, 3), "ref-x", -2.0),
])
def test_a_reference_wrong_in_some_setups_is_found_and_measured(tmp_path, seed, setups, channel, gain, validation):
    row = validation(what="references of six drawn setups wrong in one or two", reference="what was planted",
                     unit="stated standard deviations")
    result = probupdate.check_setups(roving(tmp_path, seed, lambda k: {channel: gain} if k in setups else {}))
    (one,) = result.findings
    assert channel in (one.channel, *one.alternatives) and one.since == ", ".join(f"s{k}" for k in setups)
    row.error((one.size - (gain if one.channel == channel else 1 / gain)) / one.std, below=4)
    assert one.std < 0.1 * abs(one.size) and "campaign.toml" in one.message


def test_a_gain_that_all_references_share_in_one_setup_is_told_by_a_rigid_part(tmp_path):
    paths = roving(tmp_path, 7921, lambda k: {"ref-x": 1.4, "ref-y": 1.4} if k == 1 else {})
    said = " ".join(f.message for f in probupdate.check_setups(paths).findings)
    assert "all references of that setup by 1.4" in said or "all references of that setup by 1.39" in said, said


def test_references_wrong_in_all_setups_are_told_by_a_rigid_part_only(tmp_path):
    paths = roving(tmp_path, 7921, lambda k: {"ref-x": -2.0, "ref-y": -2.0})
    (one,) = probupdate.check_setups(paths).findings
    assert one.channel == "ref-x, ref-y" and one.size == pytest.approx(-2.0, abs=4 * one.std) and one.std < 0.1
    assert "scale and direction are wrong" in one.message
    # rovers of the lower storey share nothing rigid with the references
    lower = probupdate.check_setups(paths[3:])
    assert lower.findings == () and any(
        "ref-x, ref-y that is wrong in all setups alike, or common in one to all that a mode moves, cannot be" in u
        for u in lower.uses)


@pytest.mark.skipif(not FRAME.exists(), reason="the measured frame's records are not beside the project")
def test_the_measured_frame_s_references_read_minus_two_times(tmp_path, validation):
    """Fifteen measured setups as they lie, references with a stated scale and direction that are both wrong; and with
    one setup's reference multiplied by -0.5 besides."""
    row = validation(what="references of the measured frame as they lie; one setup's ref-y times -0.5",
                     reference="-2.00; -0.5")
    paths = sorted(FRAME.glob("s[01]?"))
    (one,) = probupdate.check_setups(paths).findings
    assert one.name == "reference" and one.channel == "ref-x, ref-y" and one.alternatives == ()
    row.error(one.size + 2.0, below=0.02, of="as they lie")
    assert one.std < 0.05
    shutil.copytree(paths[6], tmp_path / "s07", copy_function=shutil.copyfile)
    (tmp_path / "s07" / "acceleration").chmod(0o755)
    for path in (tmp_path / "s07" / "acceleration").glob("*.h5"):
        path.chmod(0o644)
        with h5py.File(path, "r+") as file:
            place = read_campaign(FRAME / "s07").channels.index("ref-y")
            file["data"][:, place] = -0.5 * file["data"][:, place]
    found = probupdate.check_setups([*paths[:6], tmp_path / "s07", *paths[7:]]).findings
    assert [f.channel for f in found] == ["ref-y", "ref-x, ref-y"] and found[0].since == "s07"
    row.error((found[0].size + 0.5) / found[0].std, below=4, of="stated standard deviations, one setup")


@pytest.mark.skipif(not FRAME.exists(), reason="the measured frame's records are not beside the project")
@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.long)])
def test_gains_of_the_measured_frame_do_not_change(every):
    for path in sorted(FRAME.glob("s[01]?"))[::every]:
        campaign = read_campaign(path)
        assert not [f for f in check(campaign).measured if f.name == "gain change"], path.name


# Rotor lines ------------------------------------------------------------------------------------------------------


def ratio_of_lines(folder: Path) -> RateRatio:
    campaign = read_campaign(folder)
    return rate_ratio([own for start, files in block_files(campaign).items()
                       for own in line_scores(read_block(campaign, start, files), campaign.scada)])


def test_rotor_lines_against_scada_can_be_asked_alone(three_hours, tmp_path, validation):
    row = validation(what="rotor lines at a true rate of 25.6 Hz, one channel dead; at 25 Hz",
                     reference="1 / 1.024; 1", unit="stated standard deviations")
    found = ratio_of_lines(three_hours)
    assert found.rows > 5
    row.error((found.ratio - 1) / found.std, below=4)
    folder = tmp_path / "fast"
    shutil.copytree(three_hours, folder)
    for path in (folder / "acceleration").glob("*.h5"):
        with h5py.File(path, "r+") as file:
            # the records of a logger at 25.6 Hz, said to be at 25: lines lie lower; one channel never recorded
            data = np.nan_to_num(file["data"][:])
            time = np.minimum(np.arange(len(data)) / 1.024, len(data) - 1)
            new = np.column_stack([np.interp(time, np.arange(len(data)), c) for c in data.T])
            new[:, 3] = np.nan
            file["data"][...] = new
    wrong = ratio_of_lines(folder)
    row.error((wrong.ratio * 1.024 - 1) / wrong.std, below=4)


def test_blocks_shorter_than_a_row_of_scada_are_looked_at(three_hours):
    campaign = read_campaign(three_hours)
    files = block_files(replace(campaign, block_minutes=5.0))
    short = replace(campaign, block_minutes=5.0)
    scores = [line_scores(read_block(short, start, touching), campaign.scada) for start, touching in files.items()]
    assert sum(map(len, scores)) > 8 and max(map(len, scores)) == 1


@pytest.mark.parametrize(("gain", "said"), [(1.0, False), (9.80665, True), (1 / 9.80665, True)])
def test_a_soft_tower_on_a_stiff_jacket_is_no_wrong_unit(tmp_path, gain, said):
    """At 10 m a line from -9 to 65 m would have 0.19, a clamped cantilever's curve 0.08: it moves 0.06."""
    rng, levels = np.random.default_rng(3), [(-9.0, 0.02), (10.0, 0.06 * gain), (65.0, 0.7), (82.0, 1.0)]
    shape = np.kron([[size] for _, size in levels], np.eye(2))
    sensors = [Sensor(channel=f"z{z:.0f}{axis}", position_m=(0.0, 0.0, z), level="any",
                      direction=tuple(float(axis == k) for k in "xyz")) for z, _ in levels for axis in "xy"]
    folder = written(tmp_path / "c", sensors, modal_record(rng, shape, 24000, frequency=(0.3, 0.31)))
    head = (folder / "campaign.toml").read_text()
    for z, _ in levels:
        head = head.replace('level = "any"', f'level = "{z:.0f} m"', 2)
    (folder / "campaign.toml").write_text(head)
    found = check(read_campaign(folder)).findings
    assert any("levels around them suggest: wrong unit" in f for f in found) == said, found


@pytest.mark.parametrize(("blocks", "structure"), [((6, 7), True), ((3, 5), False), (range(8), False)])
def test_a_suspicion_that_begins_within_the_record_may_be_the_structure_s(blocks, structure):
    one = Suspicion(kind=TURNED, channels=("z1",), size=-60.0)
    compared = [SimpleNamespace(id=f"b{k}", suspicions=(one,) if k in blocks else ()) for k in range(8)]
    (said,) = mounting_findings(compared, ())
    assert said.startswith("suspect: z1 looks turned") and ("structure may have changed" in said) == structure
