"""A mode that an identification holds for two, before and after a change of a sensor or the structure, is one."""

from dataclasses import replace

import numpy as np
import pytest

import probupdate
from probupdate.diagnosis.prepare import prepare
from probupdate.modal.joined_modes import join_modes, separate_modes
from probupdate.modal.modes import ModalData, ModeRecord
from tests.diagnosis.conftest import CHANNELS

NAMES = ("X1", "Y1", "X2", "Y2")


@pytest.fixture(scope="module")
def prepared(frame_file):
    return prepare(frame_file)


def split(data: ModalData, at: int, modes=(0, 1, 2, 3), labels=NAMES) -> ModalData:
    """As an identification that follows shapes has it: after set `at` these modes have numbers of their own."""
    sets, n = [], data.n_mode
    for k, s in enumerate(data.sets):
        columns = list(range(n)) + [-1] * len(modes)
        if k >= at:
            for place, j in enumerate(modes):
                columns[j], columns[n + place] = -1, j
        sets.append(s.of_modes(columns))
    numbers = tuple(str(n + 1 + place) for place in range(len(modes)))
    records = tuple(ModeRecord(label=label, match="none" if label.isdigit() else "alike")
                    for label in (*labels, *numbers))
    return replace(data, sets=tuple(sets), labels=(*labels, *numbers), records=records)


def reversed_from(data: ModalData, channel: str, at: int) -> ModalData:
    sets = []
    for k, s in enumerate(data.sets):
        shape = np.array(s.shape)
        shape[CHANNELS.index(channel)] *= -1.0 if k >= at else 1.0
        sets.append(replace(s, shape=shape))
    return replace(data, sets=tuple(sets))


def test_a_channel_that_is_reversed_amid_the_record_is_named_where_its_modes_have_new_numbers(
    prepared, record, validation
):
    """It had been *none* at p = 1: modes with numbers are not compared with the model, and the sets with them alone
    were left out."""
    row = validation(what="a channel reversed from set 22 of 40 on, all four modes of the later sets with numbers of "
                          "their own: verdict, cause, place, time", reference="what was hidden")
    data = split(reversed_from(record(3), "y5", 22), 22)
    found = probupdate.diagnose(prepared, data, extend=False)
    (finding,) = found.findings
    row.equal((found.verdict, finding.cause, finding.location, finding.time_profile, finding.time_profile_start),
              ("named", "sensor polarity", "y5", "step", data.sets[22].id))
    said = f"from {data.sets[22].id} on 5, 6, 7, 8 instead of X1, Y1, X2, Y2 with another shape near"
    assert any(note.startswith(said) for note in found.notes)
    corrected, _ = join_modes(data)
    assert corrected.labels == NAMES and all(s.measured.all() for s in corrected.sets)


def test_a_storey_that_loosens_is_named_where_its_modes_have_new_numbers(prepared, record, validation):
    row = validation(what="a storey at 0.7 of its stiffness from set 20 on, two modes of the later sets with numbers "
                          "of their own: cause; size in its standard deviations", reference="what was hidden")
    data = split(record(4, storey=1, factor=0.7, from_block=20), 20, modes=(0, 1))
    found = probupdate.diagnose(prepared, data, extend=False)
    (finding,) = found.findings
    row.equal((found.verdict, finding.location, finding.time_profile), ("named", "k2", "step"), "cause")
    row.error((finding.size + 0.3) / finding.size_std, 3, "size")


def test_modes_that_come_and_go_or_have_names_or_are_elsewhere_stay_two(record):
    data = record(5)
    whole = split(data, 20)
    assert join_modes(whole)[0].labels == NAMES and len(join_modes(whole)[1]) == 1
    # of a pair now one is found and now the other, by their names
    named = replace(whole, labels=(*NAMES, "X3", "Y3", "X4", "Y4"))
    assert join_modes(named) == (named, [])
    rng = np.random.default_rng(1)
    coming = [s.of_modes([0, -1] if rng.random() < 0.5 else [-1, 0]) for s in data.sets]
    for sets in (coming, [s.of_modes([0, -1] if k < 20 else [-1, 2]) for k, s in enumerate(data.sets)]):
        two = ModalData(channels=data.channels, sets=tuple(sets), labels=("1", "2"))
        assert join_modes(two) == (two, [])
    late = replace(data, sets=split(data, 6, (0, 1)).sets[:8], labels=(), records=())
    assert join_modes(late)[0].n_mode == 4
    few = replace(data, sets=tuple(s.of_modes([0, -1] if k < 3 else [-1, 0]) for k, s in enumerate(data.sets[:6])),
                  labels=())
    assert join_modes(few) == (few, [])


@pytest.mark.parametrize(("share", "mixed", "one"), [(0.89, 0.1, True), (1.3, 0.1, True), (0.89, 1.5, False),
                                                   (0.5, 0.0, False)])
def test_a_mode_may_move_the_farther_the_more_its_shape_stays(record, share, mixed, one):
    """An eighth of the frequency with the shape nearly the same is one mode that changed, half of it is another."""
    data, sets = record(9), []
    for k, s in enumerate(data.sets):
        shape = s.shape[:, 0] + mixed * np.linalg.norm(s.shape[:, 0]) / np.linalg.norm(s.shape[:, 2]) * s.shape[:, 2]
        moved = replace(s, frequency_hz=[share * s.frequency_hz[0], *s.frequency_hz[1:]],
                        shape=np.column_stack([shape, s.shape[:, 1:]]))
        sets.append(s.of_modes([0, -1]) if k < 20 else moved.of_modes([-1, 0]))
    joined, notes = join_modes(ModalData(channels=data.channels, sets=tuple(sets), labels=("X1", "2")))
    assert (joined.n_mode == 1) is one and len(notes) == one
    assert not one or f"Hz, {100 * (share - 1):+.2g} %): taken as the same mode" in notes[0]


@pytest.mark.parametrize(("shares", "doubted"), [((0.9, 1.09), True), ((0.9, 0.93), False), ((0.9, 1.01), False)])
def test_modes_that_one_change_moves_both_ways_are_doubted(record, shares, doubted):
    data, sets = record(9), []
    for k, s in enumerate(data.sets):
        moved = replace(s, frequency_hz=s.frequency_hz * np.array([*shares, *[1.0] * (len(s.frequency_hz) - 2)]))
        sets.append((s if k < 20 else moved).of_modes([0, 1, -1, -1] if k < 20 else [-1, -1, 0, 1]))
    joined, notes = join_modes(ModalData(channels=data.channels, sets=tuple(sets), labels=("1", "2", "3", "4")))
    assert joined.n_mode == 2 and ("some rise and some fall" in " ".join(notes)) is doubted


def test_the_later_one_has_the_name_and_a_stray_pole_before_in_sets_of_any_order(record):
    data = record(6)
    sets = [s.of_modes([0, -1] if k < 12 else [-1, 0]) for k, s in enumerate(data.sets)]
    sets[3] = data.sets[3].of_modes([0, 1])
    made = ModalData(channels=data.channels, sets=tuple(sets[::-1]), labels=("2", "X1"))
    one, notes = join_modes(made)
    assert one.labels == ("X1",)
    assert notes[0].startswith(f"from {data.sets[12].id} on X1 instead of 2 with another shape near")
    assert [s.frequency_hz[0] for s in one.sets] == [s.frequency_hz[0] for s in data.sets[::-1]]
    assert join_modes(replace(made, labels=()))[0].n_mode == 1


def test_a_mode_that_the_model_lacks_is_said(prepared, record):
    """A tuned mass that is there all through the record adds one, and the verdict was *none* without a word."""
    data = record(8)
    extra = [s.of_modes([0, 1, 2, 3, 0]) for s in data.sets]
    extra = [replace(s, frequency_hz=[*s.frequency_hz[:4], 0.8 * s.frequency_hz[3]]) for s in extra]
    records = tuple(ModeRecord(label=label, match=match, found=40, blocks=40, frequency_hz=float(f)) for label, match, f
                    in zip((*NAMES, "5"), (*["alike"] * 4, "none"), extra[0].frequency_hz, strict=True))
    whole = ModalData(channels=data.channels, sets=tuple(extra), labels=(*NAMES, "5"), records=records)
    said = (f"mode 5 at {records[4].frequency_hz:.4g} Hz, in 40 of 40 sets, has no counterpart in the model and is "
            "not compared")
    found = probupdate.diagnose(prepared, whole, extend=False)
    assert found.verdict == "none" and found.notes[0].startswith(said)
    rare = replace(whole, records=(*records[:4], replace(records[4], found=10)))
    notes = probupdate.diagnose(prepared, rare, extend=False).notes
    assert not any("no counterpart in the model" in note for note in notes)


def test_sets_that_lack_one_mode_of_a_pair_are_said(prepared, record):
    data = record(7)
    sets = tuple(s.of_modes([0, 1, 2, 3] if k < 25 else [0, -1, 2, 3]) for k, s in enumerate(data.sets))
    found = probupdate.diagnose(prepared, replace(data, sets=sets, labels=NAMES), extend=False)
    assert any(note == f"modes X1/Y1: of 40 sets that have one of the two, 15 lack the other and inform neither "
                       f"(the last: {data.sets[-1].id})" for note in found.notes)


def mixed(data: ModalData, a: int, b: int, first: np.ndarray) -> ModalData:
    """As who follows shapes alone has it: mode a of the sets `first`, mode b of the others, in one column."""
    rest = [j for j in range(data.n_mode) if j not in (a, b)]
    sets = tuple(s.of_modes([a if one else b, *rest]) for s, one in zip(data.sets, first, strict=True))
    return replace(data, sets=sets, labels=(), records=())


def test_two_modes_in_one_column_are_separated(record):
    data = record(3)
    hz = np.array([s.frequency_hz for s in data.sets])
    # X1 and X2 are a factor of three apart
    assert np.log(hz[:, 2].min() / hz[:, 0].max()) > 0.4
    alternating = np.arange(len(data.sets)) % 3 > 0
    for first in (alternating, np.arange(len(data.sets)) < 12):
        apart, (note,) = separate_modes(mixed(data, 0, 2, first))
        assert apart.n_mode == 4
        found = np.array([s.frequency_hz for s in apart.sets])
        np.testing.assert_array_equal(found[:, 0], np.where(first, hz[:, 0], np.nan))
        np.testing.assert_array_equal(found[:, 1], np.where(first, np.nan, hz[:, 2]))
        assert apart.labels[0].startswith("mode 1 near ") and f"in {first.sum()} sets" in note


def test_a_mode_that_moves_with_all_others_is_one(record):
    data = record(3)
    slow = tuple(replace(s, frequency_hz=s.frequency_hz * (0.5 if k > 20 else 1.0)) for k, s in enumerate(data.sets))
    assert separate_modes(replace(data, sets=slow))[1] == []
    assert separate_modes(data)[0] is data


def test_a_fault_is_named_where_two_modes_stand_in_one_column(prepared, record, validation):
    """In drawn turbines such a column, held for one mode, had been *unexplained*."""
    row = validation(what="a channel reversed from set 22 of 40 on, X1 and X2 of a frame in one column by turns: "
                          "verdict, cause, place", reference="what was hidden")
    data = reversed_from(record(3), "y5", 22)
    found = probupdate.diagnose(prepared, mixed(data, 0, 2, np.arange(len(data.sets)) % 2 > 0), extend=False)
    (finding,) = found.findings
    row.equal((found.verdict, finding.cause, finding.location), ("named", "sensor polarity", "y5"))
    assert any("taken as two modes" in note for note in found.notes)


def test_two_modes_in_one_column_do_not_move_the_parameters(frame_file, record):
    data = record(3)
    whole = probupdate.update(frame_file, data)
    apart = probupdate.update(frame_file, mixed(data, 0, 2, np.arange(len(data.sets)) % 2 > 0))
    # half of the sets have each of the two modes: another mean within its own scatter
    std = np.sqrt(np.diag(apart.map_covariance))
    assert np.all(np.abs(apart.map_theta - whole.map_theta) < 2 * std)
    assert sum("taken as two modes" in words for words in apart.settings.values()) == 1
