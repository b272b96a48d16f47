"""Which mode of the model each measured one is: names under errors of the model, and what has no counterpart."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from probupdate import verbs
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.identification.counterparts import model_comparison, pair_modes
from probupdate.identification.identify import SSISettings, identify
from probupdate.identification.naming import with_independence
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.tracking import Choice
from probupdate.modal.modes import ModalData, ModalSet, ModelMode, ModeRecord, mac, read_modes, write_modes
from probupdate.verbs import sought


def measured(jacket, rng, turn=0.0) -> ModalSet:
    shape = jacket.shape + 0.02 * rng.standard_normal(jacket.shape.shape)
    return ModalSet(id=str(rng.integers(1 << 30)), shape=shape,
                    frequency_hz=jacket.frequency_hz * (1 + 3e-3 * rng.standard_normal(5)),
                    damping_ratio=jacket.damping_ratio, frequency_std_hz=np.full(5, np.nan),
                    shape_std=np.full(shape.shape, np.nan))


def test_names_stand_with_a_torsion_of_mac_two_thirds_and_modes_of_members_about(jacket, reference):
    rng = np.random.default_rng(1)
    sets = [measured(jacket, rng) for _ in range(8)]
    # torsion mixed with bending until its MAC is 0.65; the second bending 25 % too low; a member's own modes beside
    shape = np.array(jacket.shape)
    size = np.linalg.norm(shape, axis=0)
    shape[:, 2] += 0.73 * shape[:, 3] * size[2] / size[3]
    own = 0.05 * np.column_stack([shape[:, 3], shape[:, 4]])
    model = ReferenceModes(labels=(*reference.labels, "FA3", "SS3"), shape=np.column_stack([shape, own]),
                           frequency_hz=[0.30, 0.31, 1.2, 1.45, 1.5, 1.9, 2.0], pairs=((0, 1), (3, 4)))
    like = model_comparison(sets, ((0, 1), (3, 4)), [model] * 8)
    assert 0.6 < like.plane[2, 2] < 0.7
    partner, probability = pair_modes(like, model)
    assert partner == {j: j for j in range(5)}
    assert probability[2, 2] > 0.9 and np.all(probability.sum(axis=1) <= 1)
    # what resembles nothing of the model is none of its modes
    other = replace(model, shape=np.roll(model.shape, 5, axis=0))
    partner, probability = pair_modes(model_comparison(sets, (), [other] * 8), other)
    assert probability.sum(axis=1).min() < 0.1


def test_frequencies_name_modes_of_which_all_shapes_are_unlike(jacket, reference, validation):
    """Channels exchanged from the start: by MAC alone a mode was called one of another frequency, beside its own. With
    a poor model, whose frequencies are off too, wrong shapes are nobody's as before."""
    row = validation(what="modes whose shapes are of channels in another order, frequencies within 1 % of the model's: "
                          "those that have the right partner; with frequencies of a poor model, those that have one",
                     reference="who is whose")
    rng = np.random.default_rng(2)
    shape = rng.standard_normal((8, 6)) * np.linspace(1.0, 2.0, 6)
    f = np.array([1.0, 1.6, 1.9, 2.6, 3.3, 3.5])
    model = ReferenceModes(labels=tuple("abcdef"), shape=shape, frequency_hz=f, pairs=())
    wrong = shape[[1, 0, 3, 2, 5, 4, 7, 6]]
    right, some = 0, 0
    for off in (0.005 * rng.standard_normal(6), np.array([0.1, -0.12, 0.09, -0.1, 0.11, -0.1])):
        sets = [replace(measured(jacket, rng), frequency_hz=f * (1 + off), shape=wrong + 0j,
                        damping_ratio=np.full(6, 0.01), frequency_std_hz=np.full(6, np.nan),
                        damping_ratio_std=np.full(6, np.nan), shape_std=np.full(shape.shape, np.nan))
                for _ in range(4)]
        partner, _ = pair_modes(model_comparison(sets, (), [model] * 4), model)
        if abs(off).max() < 0.05:
            right = sum(partner.get(j) == j for j in range(6))
        else:
            some = len(partner)
    row.count(right, total=6, least=6, of="right partner")
    row.error(some, 2, "one of a poor model")
    # as it was where the shapes are right
    sets = [replace(s, shape=shape + 0j) for s in sets]
    assert pair_modes(model_comparison(sets, (), [model] * 4), model)[0] == {j: j for j in range(6)}


def test_a_mode_before_and_after_a_change_is_no_pair_with_itself(jacket, reference):
    """Both stand in one column; the angle of such a pair had been written as null, for a pair X2 X2."""
    one = measured(jacket, np.random.default_rng(3))
    choice = Choice(criterion=np.zeros(0), pole=np.arange(5), share=np.ones(5), independence=np.array([0.9, 0.8]))
    paired_modes = SimpleNamespace(groups=((0, 1), (3, 4)))
    known = with_independence(one, choice, ("FA1", "SS1", "T1", "FA2", "FA2"), paired_modes)
    assert known == {"independence_FA1_SS1": 0.9}


def test_what_does_not_match_is_kept_and_said(jacket, reference, write_campaign):
    """A model that lacks the torsion, has one mode that nothing excites, and is found with its modes in another order:
    the same modes and numbers for every model."""
    campaign = read_campaign(write_campaign([jacket.record(9000, seed=k) for k in range(3)]))
    settings = SSISettings(sub_records=0)
    right = identify(campaign, reference, settings=settings)
    assert [r.match for r in right.data.records] == ["alike"] * 5
    assert all(r.detection == {"unknown": (3, 3)} for r in right.data.records)
    lacking = reference.select([0, 1, 3, 4])
    heave = np.array([1.0 if s.direction[2] else 0.0 for s in campaign.sensors])[:, None]
    others = ReferenceModes(labels=("L1",), frequency_hz=[1.6], shape=heave)
    found = identify(campaign, lacking, others=others, settings=settings)
    assert found.data.labels == ("FA1", "SS1", "FA2", "SS2", "5")
    torsion = found.data.records[4]
    assert torsion.match == "none" and torsion.frequency_hz == pytest.approx(1.29, rel=3e-3)
    assert "5 at 1.29 Hz, in 3 of 3 blocks, has no counterpart in the model" in found.summary
    (absent,) = found.data.model_only
    assert absent == ModelMode(label="L1", frequency_hz=1.6, expected=True)
    assert "the model's L1 at 1.6 Hz is in no block, although the excitation should show it" in found.summary
    # at the mode's nodes the same sensors hardly see it
    far = replace(others, shape=0.1 * np.median(np.linalg.norm(lacking.shape, axis=0)) * heave / np.linalg.norm(heave))
    seldom = identify(campaign, lacking, others=far, settings=settings)
    assert seldom.data.model_only == (ModelMode(label="L1", frequency_hz=1.6, expected=False, hardly_seen=True),)
    assert "the model's L1 (1.6 Hz) is in no block: the sensors hardly see" in seldom.summary
    assert "excitation should" not in seldom.summary
    # a model changes names only
    for label in lacking.labels:
        a, b = (one.data.labels.index(label) for one in (found, right))
        assert [s.frequency_hz[a] for s in found.data.sets] == [s.frequency_hz[b] for s in right.data.sets]
    wrong = replace(reference, shape=reference.shape + 0.6 * reference.shape[:, [3, 4, 0, 1, 2]])
    bad = identify(campaign, wrong, settings=settings)
    assert {"unlike"} <= {r.match for r in bad.data.records}
    assert np.array_equal(np.sort([s.frequency_hz for s in bad.data.sets])[:, :5],
                          np.sort([s.frequency_hz for s in right.data.sets]))
    assert "looks unlike the model's" in bad.summary


def records() -> tuple[ModeRecord, ...]:
    known = {"frequency_hz": 1.0, "found": 3, "blocks": 4, "mac": 0.9, "detection": {"idling": (3, 4)}}
    return (ModeRecord(label="FA1", match="alike", model_label="FA1", **known),
            ModeRecord(label="T1", match="unlike", model_label="T1", **known | {"mac": 0.65}),
            ModeRecord(label="3", match="none", **known | {"mac": np.nan}),
            ModeRecord(label="4", match="alike", model_label="FA3", alternatives=(("FA3", 0.9),), **known))


def data_of(records) -> ModalData:
    one = ModalSet(id="a", frequency_hz=[1.0, 2.0, 3.0, 4.0], damping_ratio=np.full(4, 0.01), shape=np.eye(5)[:, :4],
                   frequency_std_hz=np.full(4, np.nan), shape_std=np.full((5, 4), np.nan))
    return ModalData(channels=tuple("abcde"), sets=(one,), labels=("FA1", "T1", "3", "4"), records=records,
                     model_only=(ModelMode(label="SS1", frequency_hz=0.3, expected=True),))


def test_records_are_written_read_and_chosen_by(tmp_path):
    data = data_of(records())
    write_modes(data, tmp_path / "modes.json")
    again = read_modes(tmp_path / "modes.json")
    assert repr(again.records) == repr(data.records) and again.model_only == data.model_only
    assert again.compared().labels == ("FA1", "T1") and again.compared(True).labels == ("FA1", "T1", "4")
    assert again.compared().set().frequency_hz.tolist() == [1.0, 2.0]
    said = verbs.unmatched_sentences(tmp_path / "modes.json")
    assert [text.split()[0] for text in said["taken"]] == ["T1"] and "MAC 0.65" in said["taken"][0]
    assert len(said["left out"]) == 3 and "has no counterpart in the model" in said["left out"][0]
    assert "--every-mode" in said["left out"][1] and "the model's SS1 (0.3 Hz)" in said["left out"][2]
    # without records all modes are compared, as in files of users' own
    plain = replace(data, records=(), model_only=())
    assert plain.compared() is plain and verbs.unmatched_sentences(plain) == {"left out": (), "taken": ()}


@pytest.mark.parametrize(("change", "compared"), [
    ({}, True), ({"mac": 0.8}, False), ({"frequency_ratio": 1.3}, False), ({"found": 2}, False),
    ({"pair": True}, False),
    ({"alternatives": (("FA3", 0.6), ("SS3", 0.4))}, False), ({"alternatives": (("SS3", 0.99),)}, False),
    ({"model_label": "L3", "alternatives": (("L3", 0.99),)}, False)])
def test_a_numbered_mode_that_is_surely_the_models_is_compared(change, compared):
    *first, further = records()
    sure = {"alternatives": (("FA3", 0.99),), "frequency_ratio": 0.95, "mac": 0.95} | change
    data = data_of((*first, replace(further, **sure)))
    assert ("4" in data.compared(sure=True).labels) == compared and "4" not in data.compared().labels
    assert any(text.startswith("4 (") for text in verbs.unmatched_sentences(data)["left out"]) != compared


def test_many_further_modes_are_one_line_and_a_double_is_no_stranger():
    first, _, none, alike = records()
    many = tuple(replace(alike, label=str(k), model_label=f"M{k}") for k in (2, 3, 4))
    data = replace(data_of((first, *many)), labels=("FA1", "2", "3", "4"), model_only=())
    (line,) = verbs.unmatched_sentences(data)["left out"]
    assert line.startswith("3 modes, 2, 3, 4, which are the model's M2, M3, M4: not surely the model's; --every-mode")
    double = replace(none, alternatives=(("FA1", 0.99),))
    data = replace(data, records=(first, *many[:1], double, *many[2:]))
    line, *_ = verbs.unmatched_sentences(data)["left out"]
    assert "looks like the model's FA1, which another measured mode is" in line


@pytest.mark.parametrize(("old", "new", "word"), [
    ('"format": 2', '"format": 3', "has the format 3; 2 is the newest known"),
    ('"format": 2', '"format": "x"', "format: 'x' is not a number"),
    ('"match": "alike"', '"match": 1', "mode_records 1, match: 1 is not text"),
    ('"found": 3', '"fuond": 3', "unknown key 'fuond'"),
    ('"expected": true', '"other": true', "model_only 1: 'expected' is missing; .* label, frequency_hz, expected"),
])
def test_damaged_records_are_named(tmp_path, old, new, word):
    write_modes(data_of(records()), tmp_path / "modes.json")
    text = (tmp_path / "modes.json").read_text()
    assert old in text
    (tmp_path / "modes.json").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=word):
        read_modes(tmp_path / "modes.json")


def test_a_member_s_own_mode_is_no_bending_mode_of_the_tower(jacket, sensor_list):
    """As with a brace gone soft: a mode at 0.6 Hz that drags the level along, and the shadow of a bending mode."""
    shape = np.column_stack([jacket.shape, 0.01 * jacket.shape[:, 4], 0.1 * jacket.shape[:, 3]])
    frequency = np.append(jacket.frequency_hz, [0.6, jacket.frequency_hz[3] * 0.99])
    rising = np.argsort(frequency)
    labels = sought.sensed_labels(frequency[rising], shape[:, rising], sensor_list)
    assert dict(zip(rising.tolist(), labels, strict=True)) == {
        0: "FA1", 1: "SS1", 2: "T1", 3: "FA2", 4: "SS2", 5: "L1", 6: "L2"}
    assert mac(shape[:, [6]], shape[:, [3]])[0, 0] == pytest.approx(1)


def test_the_lowest_modes_that_most_blocks_show_are_proposed():
    """A bridge's V1 and A1 were asked for; the sensors do not move in the model's third mode, at 3 Hz."""
    wanted = ReferenceModes(labels=("V1", "A1"), frequency_hz=[1.0, 5.0], shape=np.eye(4)[:, :2])
    others = ReferenceModes(labels=("L1", "T1", "V2"), frequency_hz=[2.0, 4.0, 6.0], shape=np.eye(4)[:, 1:])
    asked = sought.SoughtModes(modes=wanted, others=others, computed_hz=np.arange(1.0, 7.0))

    def found(*modes):
        return [ModeRecord(label=label, match="alike", model_label=own, model_frequency_hz=f, found=n, blocks=36)
                for label, own, f, n in modes]

    records = found(("V1", "V1", 1.0, 36), ("A1", "A1", 5.0, 36), ("3", "L1", 2.0, 30), ("4", "T1", 4.0, 36))
    (note,) = asked.lowest_note(records)
    assert note == "`--lowest 5` looks for all of the model's modes up to A1 at 5 Hz, which most blocks show"
    # T1 in few blocks: up to the mode below it; L1 in few: what was asked for is all
    (note,) = asked.lowest_note([*records[:3], *found(("4", "T1", 4.0, 9))])
    assert note.startswith("`--lowest 2` looks for") and "up to L1 at 2 Hz" in note
    assert not asked.lowest_note([*records[:2], *found(("3", "L1", 2.0, 9)), records[3]])
    assert not replace(asked, computed_hz=None).lowest_note(records)
