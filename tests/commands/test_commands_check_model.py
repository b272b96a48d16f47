"""Signs and order of a campaign's channels held against a model, by records of a building that were simulated."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_cases import CHANNELS, FLOORS, TRUTH, matrices, storey_matrix, write_building
from scipy import linalg, signal

import probupdate
from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.structure.load import load_model, model_sensors, reference_model

RATE_HZ, SECONDS, N_BLOCK = 25.0, 600, 4
GROUPS = (range(0, 7), range(7, 14), range(14, 20))


def records() -> np.ndarray:
    """Accelerations (n_sample, n_channel) of the building under white noise at every floor, mode by mode."""
    rng = np.random.default_rng(6)
    k = matrices()["K0"] + sum(t * storey_matrix(g) for t, g in zip(TRUTH, GROUPS, strict=True))
    square, phi = linalg.eigh(k, matrices()["M0"])
    n = int(RATE_HZ * SECONDS * N_BLOCK)
    force, found = rng.standard_normal((n, len(phi))), np.zeros((n, len(CHANNELS)))
    for j in range(6):
        system = ([1.0, 0.0, 0.0], [1.0, 0.02 * np.sqrt(square[j]), square[j]])
        b, a, _ = signal.cont2discrete(system, 1 / RATE_HZ, method="bilinear")
        found += np.outer(signal.lfilter(b.ravel(), a, force @ phi[:, j]), phi[FLOORS, j])
    return 0.01 * (found / found.std() + 0.05 * rng.standard_normal(found.shape))


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    folder = tmp_path_factory.mktemp("building")
    write_building(folder)
    np.save(folder / "records.npy", records())
    return folder


def campaign(building: Path, name: str, change=lambda data: data, directions=(1, 1, 1, 1, 1)) -> Path:
    folder = building / name
    (folder / "acceleration").mkdir(parents=True)
    text = f'name = "{name}"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = 10\n'
    for channel, floor, sign in zip(CHANNELS, FLOORS, directions, strict=True):
        text += (f'[[sensor]]\nchannel = "{channel}"\nlevel = "{channel}"\nposition_m = [0.0, 0.0, {3.0 * floor + 3}]\n'
                 f'direction = [{float(sign)}, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n')
    (folder / "campaign.toml").write_text(text)
    with h5py.File(folder / "acceleration" / "one.h5", "w") as file:
        held = file.create_dataset("data", data=change(np.load(building / "records.npy")).astype(np.float32))
        held.attrs["start"], held.attrs["sampling_rate_hz"] = "2026-06-01T00:00:00Z", RATE_HZ
    return folder


def reversed_channel(number):
    return lambda data: data * np.where(np.arange(len(CHANNELS)) == number, -1, 1)


def against(folder: Path, model: Path, capsys) -> list[str]:
    assert main(["check", str(folder), "--model", str(model)]) == 0
    return [line for line in capsys.readouterr().out.splitlines() if "the model" in line]


def test_channels_as_the_model_has_them_are_not_suspected(building, capsys):
    (line,) = against(campaign(building, "right"), building / "model.npz", capsys)
    assert line.startswith("note: shapes of") and float(line.split()[-1]) > 0.95


@pytest.mark.parametrize("number", (0, 3))
def test_a_reversed_channel_is_named(building, capsys, number):
    folder = campaign(building, f"reversed {number}", reversed_channel(number))
    first, _ = against(folder, building / "model.npz", capsys)
    assert f"channel {CHANNELS[number]} with the opposite sign would explain it" in first
    assert "4 of 4 blocks show it by themselves" in first


def test_a_reversed_channel_is_named_beside_a_model_that_is_far_off(building, capsys):
    """Storeys 8 to 14 of the model half as stiff: the shapes agree by 0.88 at best."""
    softer = matrices()["K0"] - 0.45 * storey_matrix(GROUPS[1])
    folder = campaign(building, "reversed beside another", reversed_channel(3))
    first, _ = against(folder, placed(building, "softer", K0=softer), capsys)
    assert f"channel {CHANNELS[3]} with the opposite sign would explain it" in first and "would be 0.88" in first


def test_a_model_of_three_times_the_frequencies_has_the_same_shapes(building, capsys):
    stiffer = placed(building, "stiffer", K0=9 * matrices()["K0"])
    said = against(campaign(building, "beside a stiffer one"), stiffer, capsys)
    assert not any("found:" in line for line in said) and float(said[-1].split()[-1]) > 0.9, said


def test_exchanged_channels_are_named(building, capsys):
    folder = campaign(building, "exchanged", lambda data: data[:, [0, 3, 2, 1, 4]])
    first, _ = against(folder, building / "model.npz", capsys)
    assert f"channels {CHANNELS[1]} and {CHANNELS[3]} exchanged would explain it" in first


def test_exchanged_channels_that_only_turning_modes_show_are_named(tmp_path, capsys):
    """Both edges of a deck of twelve sections: eight bending modes move them alike, the one that turns it is so few of
    all that their mean MAC is high."""
    n, places = 12, (2, 4, 6, 8)
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    k, m = 200.0 * linalg.block_diag(chain, 20.0 * chain), np.eye(2 * n)
    rows = np.zeros((2 * len(places), 2 * n))
    for i, place in enumerate(places):
        rows[2 * i, place] = rows[2 * i + 1, place] = 1.0
        rows[2 * i, n + place], rows[2 * i + 1, n + place] = 1.0, -1.0
    names = [f"{place}{side}" for place in places for side in "LR"]
    np.savez(tmp_path / "model.npz", K0=k, M0=m, channel=names, channel_row=rows, K_k=0.5 * k)
    (tmp_path / "parameters.toml").write_text('[[parameter]]\nname = "k"\ninitial = 0.0\nstd = 0.1\n')
    square, phi = linalg.eigh(k, m)
    rng, size = np.random.default_rng(7), int(RATE_HZ * SECONDS * N_BLOCK)
    data = np.zeros((size, len(names)))
    for j in range(9):
        system = ([1.0, 0.0, 0.0], [1.0, 0.02 * np.sqrt(square[j]), square[j]])
        b, a, _ = signal.cont2discrete(system, 1 / RATE_HZ, method="bilinear")
        data += np.outer(signal.lfilter(b.ravel(), a, rng.standard_normal(size)), rows @ phi[:, j])
    data = 0.01 * (data / data.std() + 0.02 * rng.standard_normal(data.shape))
    for exchanged in (False, True):
        folder = tmp_path / f"camp {exchanged}"
        (folder / "acceleration").mkdir(parents=True)
        text = f'name = "deck"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = 10\n'
        for name in names:
            text += (f'[[sensor]]\nchannel = "{name}"\nlevel = "{name}"\ndirection = [0.0, 0.0, 1.0]\n'
                     f'position_m = [{float(name[:-1])}, {1.0 if name[-1] == "L" else -1.0}, 5.0]\n'
                     'quantity = "acceleration"\nunit = "m/s2"\n')
        (folder / "campaign.toml").write_text(text)
        with h5py.File(folder / "acceleration" / "one.h5", "w") as file:
            order = [1, 0, *range(2, 8)] if exchanged else list(range(8))
            held = file.create_dataset("data", data=data[:, order].astype(np.float32))
            held.attrs["start"], held.attrs["sampling_rate_hz"] = "2026-06-01T00:00:00Z", RATE_HZ
        said = against(folder, tmp_path / "model.npz", capsys)
        assert any("channels 2L and 2R exchanged would explain it" in line for line in said) == exchanged, said


def test_the_remedy_for_a_reversed_channel_works(building, capsys):
    """direction in campaign.toml and channel_sign of the model, as the finding says."""
    sign = np.where(np.arange(len(CHANNELS)) == 3, -1, 1)
    np.savez(building / "turned.npz", **matrices(), channel_sign=sign)
    (building / "turned.toml").write_text((building / "parameters.toml").read_text())
    folder = campaign(building, "corrected", reversed_channel(3), directions=sign)
    (line,) = against(folder, building / "turned.npz", capsys)
    assert line.startswith("note: shapes of") and float(line.split()[-1]) > 0.95


def placed(building, name, **changes) -> Path:
    """A model that knows where its nodes are."""
    floors = np.arange(len(matrices()["M0"]))
    places = np.column_stack([0 * floors, 0 * floors, 3.0 * floors + 3])
    content = matrices() | {"node_position_m": places, "dof_node": floors, "dof_direction": 0 * floors} | changes
    if "channel_row" in changes:
        del content["channel_dof"]
    np.savez(building / f"{name}.npz", **content)
    (building / f"{name}.toml").write_text((building / "parameters.toml").read_text())
    return building / f"{name}.npz"


@pytest.mark.parametrize("row", ["one node", "between two nodes"])
def test_a_sign_changed_in_one_place_of_two_is_refused(building, capsys, row):
    """The row of channel_row times -1, and direction in campaign.toml as it was; or the other way round."""
    rows = np.zeros((len(CHANNELS), len(matrices()["M0"])))
    rows[np.arange(len(CHANNELS)), FLOORS] = 1.0
    if row == "between two nodes":
        rows[3, FLOORS[3]], rows[3, FLOORS[3] + 1] = 0.6, 0.4
    turned = rows * np.where(np.arange(len(CHANNELS)) == 3, -1, 1)[:, None]
    sign = (1, 1, 1, -1, 1)
    half = ((placed(building, f"rows {row}", channel_row=turned), (1, 1, 1, 1, 1)),
            (placed(building, f"plain {row}", channel_row=rows), sign))
    for k, (model, directions) in enumerate(half):
        folder = campaign(building, f"half {row} {k}", reversed_channel(3), directions=directions)
        assert main(["check", str(folder), "--model", str(model)]) == 2
        assert "row of channel_row times -1" in capsys.readouterr().err
    both = campaign(building, f"both {row}", reversed_channel(3), directions=sign)
    (line,) = against(both, half[0][0], capsys)
    assert line.startswith("note: shapes of") and float(line.split()[-1]) > 0.95


def test_a_sensor_far_from_the_node_that_is_read_is_said(building, capsys):
    model = placed(building, "places")
    assert not any("position_m" in line for line in against(campaign(building, "there"), model, capsys))
    for name, sensors in (("elsewhere", ("F14",)), ("another origin", CHANNELS)):
        folder = campaign(building, name)
        head = folder / "campaign.toml"
        # from the top down: the next one's place is another's new one
        for floor, channel in reversed(list(zip(FLOORS, CHANNELS, strict=True))):
            if channel in sensors:
                head.write_text(head.read_text().replace(f"0.0, {3.0 * floor + 3}]", f"0.0, {3.0 * floor + 12}]"))
        said = [line for line in against(folder, model, capsys) if "position_m" in line]
        assert len(said) == (name == "elsewhere") and all("F14 (9.0 m)" in line for line in said)


@pytest.mark.parametrize(("factor", "code", "words"), [(1e-3, 2, "mass in t beside N and m"),
                                                       (1e3, 0, "mass in kg beside kN and m")])
def test_masses_in_another_unit_are_asked_about(building, capsys, factor, code, words):
    model = placed(building, f"mass {factor}", M0=factor * matrices()["M0"])
    folder = campaign(building, f"units {factor}")
    assert main(["identify", str(folder), "--model", str(model), "--out", str(folder / "m.json")]) == code
    out = capsys.readouterr()
    assert words in (out.err if code else out.out)


def test_a_model_without_the_channels_is_refused(building, capsys):
    np.savez(building / "other.npz", **matrices() | {"channel": np.array(["a", "b", "c", "d", "e"])})
    (building / "other.toml").write_text((building / "parameters.toml").read_text())
    assert main(["check", str(campaign(building, "strange")), "--model", str(building / "other.npz")]) == 2
    assert "channel F05: is not a channel of the model" in capsys.readouterr().err


@pytest.mark.parametrize("model", [[], ["--model", "model.npz", "--no-extend"]], ids=["without a model", "of a model"])
def test_a_diagnosis_leaves_out_what_campaign_toml_does(building, capsys, monkeypatch, model):
    """Of modes that were identified before: as without the channel, and it says so."""
    monkeypatch.chdir(building)
    folder = campaign(building, f"left out {len(model)}")
    command = ["diagnose", *model, "--modes", "modes.json", "--campaign", str(folder)]
    head = (folder / "campaign.toml").read_text()
    (folder / "campaign.toml").write_text('leave_out = ["F14"]\n' + head)
    found = []
    for more in ([], ["--without", "F14"]):
        assert main([*command, *more, "--out", "left.json"]) == 0
        text = capsys.readouterr().out
        assert ("note: F14 left out, as campaign.toml says" in text) == (not more)
        found.append(json.loads(Path("left.json").read_text()))
        assert not any("F14" in x["location"] for x in found[-1]["detectable_sizes"])
    (folder / "campaign.toml").write_text(head)
    assert main([*command, "--out", "left.json"]) == 0
    whole = json.loads(Path("left.json").read_text())
    assert any("F14" in x["location"] for x in whole["detectable_sizes"])
    for key in ("verdict", "threshold", "adequacy_p", "findings", "detectable_sizes"):
        assert found[0][key] == found[1][key]


def test_identify_says_which_channels_it_leaves_out(building, capsys):
    folder = campaign(building, "identified without")
    (folder / "campaign.toml").write_text('leave_out = ["F14"]\n' + (folder / "campaign.toml").read_text())
    out = folder / "modes.json"
    assert main(["identify", str(folder), "--out", str(out)]) == 0
    assert "F14 left out, as campaign.toml says" in capsys.readouterr().out
    assert json.loads(out.read_text())["channels"] == [c for c in CHANNELS if c != "F14"]


def scaled(folder: Path, factor: float, own: dict[str, float] | None = None) -> Path:
    """The campaign with all its places times a factor, those of some channels times another."""
    head, text = folder / "campaign.toml", (folder / "campaign.toml").read_text()
    for floor, channel in reversed(list(zip(FLOORS, CHANNELS, strict=True))):
        text = text.replace(f"0.0, {3.0 * floor + 3}]", f"0.0, {(own or {}).get(channel, factor) * (3 * floor + 3)}]")
    head.write_text(text)
    return folder


@pytest.mark.parametrize(("factor", "words"), [
    (1000, "1000 times the model's: in mm? state metres"), (100, "100 times the model's: in cm? state metres"),
    (10, "10 times the model's: in dm? state metres"), (1 / 0.3048, "3.281 times the model's: in feet? state metres"),
    (0.3048, "0.3048 times the model's: is the model in feet?"),
    (0.001, "0.001 times the model's: is the model in mm?"),
])
def test_places_in_another_unit_are_one_question(building, factor, words):
    folder = scaled(campaign(building, f"places times {factor:.4g}"), factor)
    asked = [x for x in probupdate.check(folder, placed(building, "places")).findings if "places are" in x]
    assert len(asked) == 1 and f"places are {words}" in asked[0] and "F14 (" not in asked[0]


def test_one_place_that_is_no_multiple_changes_no_question(building):
    folder = scaled(campaign(building, "one of its own"), 1000, {"F14": 1100})
    assert any("places are 1000 times" in x for x in probupdate.check(folder, placed(building, "places")).findings)


def test_places_scaled_by_no_unit_are_channels_elsewhere(building):
    folder = scaled(campaign(building, "twice as high"), 2.0)
    (said,) = [x for x in probupdate.check(folder, placed(building, "places")).findings if "position_m" in x]
    assert "times the model's" not in said and "F20 (" in said


@pytest.mark.parametrize("model", [False, True], ids=["without a model", "of a model without places"])
def test_sensors_farther_apart_than_structures_are_asked_about(building, model):
    given = [building / "model.npz"] if model else []
    folder = campaign(building, f"extent {model}")
    assert not any("in mm?" in x for x in probupdate.check(folder, *given).findings)
    assert any("an extent of 4.5e+04 m is more than structures have, and" in x and "in mm? state metres" in x
               for x in probupdate.check(scaled(folder, 1000), *given).findings)


def test_places_in_mm_on_a_model_with_members_are_one_question():
    sensors = tuple(replace(s, position_m=1000 * s.position_m) for s in model_sensors(reference_model("design")))
    with pytest.raises(InputError, match="places are 1000 times the model's: in mm"):
        load_model(reference_model("design"), sensors=sensors)


def test_channels_of_the_model_that_campaign_toml_lacks_are_said(building, capsys, monkeypatch):
    """By check, identify and diagnose; not of a channel that it has and leaves out."""
    monkeypatch.chdir(building)
    folder = campaign(building, "four of five")
    text = (folder / "campaign.toml").read_text()
    commands = (["check", str(folder), "--model", "model.npz"],
                ["identify", str(folder), "--model", "model.npz", "--out", "four.json"],
                ["diagnose", "--model", "model.npz", "--modes", "four.json", "--campaign", str(folder), "--no-extend",
                 "--out", "lacking.json"])
    shorter = text[: text.rindex("[[sensor]]")]
    with h5py.File(folder / "acceleration" / "one.h5", "r+") as file:
        held = {"data": file["data"][:], **file["data"].attrs}
        del file["data"]
        file.create_dataset("data", data=held.pop("data")[:, :-1]).attrs.update(held)
    (folder / "campaign.toml").write_text(shorter)
    for command in commands:
        assert main(command) == 0
        assert capsys.readouterr().out.count(f"the campaign has no {CHANNELS[-1]}, of 5 channels of the model") == 1
    left = campaign(building, "five, one left out")
    (left / "campaign.toml").write_text(f'leave_out = ["{CHANNELS[-1]}"]\n{text}')
    assert main(["identify", str(left), "--model", "model.npz", "--out", "left_four.json"]) == 0
    assert "the campaign has no" not in capsys.readouterr().out
