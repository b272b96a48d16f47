"""Records that are not whole: what is missing costs what it must and no more, and is said."""

from dataclasses import replace

import numpy as np
import pytest

import probupdate
from probupdate.diagnosis.blocks import gather, with_derived
from probupdate.diagnosis.mode_numbers import numbers_of_modes
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import diagnosis_problem
from probupdate.diagnosis.without_model import diagnose_without_model
from probupdate.errors import InputError


@pytest.fixture(scope="module")
def prepared(frame_file):
    return prepare(frame_file)


def without(data, lost):
    """The record with `lost` (n_set, n_channel) bool not measured."""
    return replace(data, sets=tuple(
        replace(s, shape=np.where(gone[:, None], np.nan, s.shape)) for s, gone in zip(data.sets, lost, strict=True)))


def test_a_channel_that_ends_early_takes_no_set_with_it(prepared, record, validation):
    """A step in the last third, where a channel of no interest is missing."""
    row = validation(what="a channel missing from two thirds on, a storey that loosens three quarters on: verdict, "
                          "cause, place, time profile", reference="what was hidden")
    data = record(4, storey=2, factor=0.9, from_block=30)
    lost = np.zeros((len(data.sets), len(data.channels)), bool)
    lost[26:, data.channels.index("y1")] = True
    found = probupdate.diagnose(prepared, without(data, lost), extend=False)
    (one,) = found.findings
    row.equal((found.verdict, one.cause, one.location, one.time_profile), ("named", "parameter", "k3", "step"))
    assert any("y1 (there in" in note for note in found.notes)


def test_numbers_missing_here_and_there_take_their_blocks_and_it_is_said(record):
    data = record(5)
    lost = np.zeros((len(data.sets), len(data.channels)), bool)
    for k, block in enumerate(range(0, len(data.sets), 4)):
        lost[block, k % len(data.channels)] = True
    blocks = gather(without(data, lost))
    assert blocks.channels == data.channels
    assert any(f"{int(lost.any(axis=1).sum())} of {len(data.sets)} blocks left out" in note for note in blocks.notes)


def test_channels_are_left_out_as_long_as_more_numbers_are_kept(record, validation):
    """Against all subsets of three channels that are missing in parts."""
    row = validation(what="numbers kept where three channels are missing at random in 5, 30, 60 % of the sets",
                     reference="most of all subsets of these channels")
    data, rng = record(6), np.random.default_rng(2)
    n_set, n_channel = len(data.sets), len(data.channels)
    for share in (0.05, 0.3, 0.6):
        lost = np.zeros((n_set, n_channel), bool)
        lost[:, :3] = rng.random((n_set, 3)) < share
        kept = gather(without(data, lost)).channels
        found_here = {subset: np.sum(~lost[:, list(subset)].any(axis=1)) * len(subset)
                      for bits in range(8)
                      for subset in [tuple(k for k in range(n_channel) if k > 2 or bits >> k & 1)]}
        row.equal(found_here[tuple(data.channels.index(c) for c in kept)], max(found_here.values()), case=share)


def test_a_close_pair_of_which_each_set_has_one_is_refused(prepared, record):
    """As where sets list their modes by frequency and some miss one."""
    def alternate(k, s):
        f, shape = np.array(s.frequency_hz), np.array(s.shape)
        f[1] = 1.03 * f[0]
        f[k % 2], shape[:, k % 2] = np.nan, np.nan
        return replace(s, frequency_hz=f, shape=shape)

    whole = record(seed=1)
    data = replace(whole, sets=tuple(alternate(k, s) for k, s in enumerate(whole.sets)))
    with pytest.raises(InputError, match="close and in no set together"):
        diagnosis_problem(prepared, data)


def test_copies_are_refused(prepared, record):
    data = record(7)
    copies = replace(data, sets=tuple(replace(s, frequency_hz=data.sets[0].frequency_hz) for s in data.sets))
    with pytest.raises(InputError, match="copied, computed or rounded"):
        probupdate.diagnose(prepared, copies, extend=False)


def test_frequencies_alone_are_diagnosed_and_said(prepared, record):
    data = record(7)
    alone = replace(data, sets=tuple(replace(s, shape=np.full_like(s.shape, np.nan)) for s in data.sets))
    found = probupdate.diagnose(prepared, alone, extend=False)
    assert any("frequencies alone, paired with the model's" in note for note in found.notes)
    without_one = diagnose_without_model(alone).notes
    assert any("frequencies alone" in note and "model's in" not in note for note in without_one)
    assert all(f.kind != "measurement" or f.cause == "sampling rate" for f in found.findings)


def of_frequencies(data):
    """The record without channels, as `modes.json` of frequencies alone is read."""
    sets = tuple(replace(s, shape=s.shape[:0], shape_std=s.shape_std[:0], covariance_factors=None) for s in data.sets)
    return replace(data, channels=(), sets=sets)


def stated(data):
    """The record with a standard deviation of every number."""
    sets = tuple(replace(s, frequency_std_hz=1e-3 * s.frequency_hz, shape_std=np.full(s.shape.shape, 5e-3))
                 for s in data.sets)
    return replace(data, sets=sets)


def test_frequencies_alone_are_followed_without_a_model(record):
    still, lost = (of_frequencies(record(3, **how)) for how in ({}, {"storey": 2, "factor": 0.9, "from_block": 18}))
    assert probupdate.diagnose(None, still, extend=False).verdict == "none"
    found = probupdate.diagnose(None, lost, extend=False)
    assert found.verdict == "unexplained" and any("unexplained step" in note for note in found.notes)


def test_one_channel_is_followed_without_a_model(record):
    data = record(3, storey=2, factor=0.9, from_block=18)
    row = data.channels.index("y4")
    sets = tuple(replace(s, shape=s.shape[[row]], shape_std=s.shape_std[[row]], covariance_factors=None)
                 for s in data.sets)
    assert probupdate.diagnose(None, replace(data, channels=("y4",), sets=sets), extend=False).verdict == "unexplained"


@pytest.mark.parametrize("n", [1, 2, 4])
def test_few_sets_without_a_model_are_refused(record, n):
    """They would be *none* whatever changed."""
    data = stated(record(3))
    for one in (data, of_frequencies(data)):
        with pytest.raises(InputError, match=rf"{n} sets? (is|are) too few .*--model"):
            probupdate.diagnose(None, replace(one, sets=one.sets[:n]), extend=False)


def test_two_sets_of_frequencies_before_and_after(prepared, record):
    """All candidates are taken in, and nothing is left to be scored beside them."""
    data = of_frequencies(stated(record(3, storey=2, factor=0.8, from_block=18)))
    pair = replace(data, sets=(data.sets[0], data.sets[-1]))
    found = probupdate.diagnose(prepared, pair, extend=False)
    assert found.findings and not any("too high for" in note for note in found.notes)


def test_a_set_without_a_mode_and_one_without_its_deviation_are_named(prepared, record):
    data = stated(record(3))
    first, empty = data.sets[0], replace(data.sets[1], frequency_hz=np.full_like(data.sets[1].frequency_hz, np.nan))
    found = probupdate.diagnose(prepared, replace(data, sets=(first, empty)), extend=False)
    assert any(f"1 set left out without a mode: {empty.id}" in note for note in found.notes)
    end = replace(empty, environment={"excluded": "part of a recording: 8 min in it"})
    found = probupdate.diagnose(prepared, replace(data, sets=(first, end)), extend=False)
    assert any(note.startswith("1 block at the ends of recordings") for note in found.notes)
    assert not any("without a mode" in note for note in found.notes)
    zero = replace(data.sets[1], frequency_std_hz=np.zeros_like(empty.frequency_hz), covariance_factors=None)
    with pytest.raises(InputError, match=f"set {zero.id} has a frequency or shape with no standard deviation"):
        probupdate.diagnose(prepared, replace(data, sets=(first, zero)), extend=False)


def test_a_standard_deviation_of_zero_is_not_known_and_said(record):
    data = stated(record(3))
    first = data.sets[0]
    assert not any("of zero" in note for note in gather(data).notes)
    largest = np.array(first.shape_std)
    largest[np.argmax(np.abs(first.shape[:, 0])), 0] = 0.0
    # what normalises a shape has none by definition
    one = replace(data, sets=(replace(first, shape_std=largest, covariance_factors=None), *data.sets[1:]))
    assert not any("of zero" in note for note in gather(one).notes)
    zero = np.array(first.frequency_std_hz)
    zero[1] = 0.0
    one = replace(data, sets=(replace(first, frequency_std_hz=zero, covariance_factors=None), *data.sets[1:]))
    assert any(f"1 set with a standard deviation of zero ({first.id}): taken as not known" in note
               for note in gather(one).notes)


def test_channels_in_another_order_are_refused_with_the_order_that_fits(prepared, record):
    """No search for a change of the structure finds its way out of shapes of which every component is another's."""
    data = record(3)
    names = ", ".join(data.channels)
    with pytest.raises(InputError, match=f"channels in another order \\({names}\\) would explain it"):
        probupdate.diagnose(prepared, replace(data, channels=data.channels[::-1]), extend=False)


@pytest.mark.parametrize("channels", [(), ("x4", "y4"), ("x4", "y4", "x2", "y2"), None])
def test_rad_per_second_are_refused_where_few_sensors_show_higher_modes_of_like_shape(prepared, record, channels):
    """Of frequencies alone too."""
    data = record(3)
    if channels:
        data = data.without_channels([c for c in data.channels if c not in channels])
    elif channels is not None:
        data = of_frequencies(data)
    diagnosis_problem(prepared, data)
    sets = tuple(replace(s, frequency_hz=2 * np.pi * s.frequency_hz) for s in data.sets)
    with pytest.raises(InputError, match="rad/s are 6.28 times as many"):
        diagnosis_problem(prepared, replace(data, sets=sets))


def test_frequencies_that_are_all_off_by_one_factor_are_said(prepared, record):
    data = record(3)
    half = replace(data, sets=tuple(replace(s, frequency_hz=s.frequency_hz / np.sqrt(2)) for s in data.sets))
    notes = " ".join(diagnosis_problem(prepared, half)[0].blocks.notes)
    assert "are 1.41 times the measured ones, as with stiffness over mass 2 times what it is" in notes
    assert "times the measured ones" not in " ".join(diagnosis_problem(prepared, data)[0].blocks.notes)


def with_one_more(data):
    """The record with a mode above all others."""
    def more(s):
        return replace(s, frequency_hz=np.append(s.frequency_hz, 2 * s.frequency_hz[-1]),
                       shape=np.column_stack([s.shape, s.shape[:, ::-1][:, 0]]),
                       damping_ratio=np.append(s.damping_ratio, 0.01),
                       frequency_std_hz=np.append(s.frequency_std_hz, np.nan), damping_ratio_std=None,
                       shape_std=np.column_stack([s.shape_std, s.shape_std[:, 0]]))

    return replace(data, sets=tuple(more(s) for s in data.sets))


def test_as_many_modes_as_the_matrices_have_and_no_more(prepared, record):
    """Ten degrees of freedom have ten modes, and a record of eleven is refused."""
    assert probupdate.diagnose(prepared, record(1, n_mode=8), extend=False).verdict == "none"
    with pytest.raises(InputError, match="holds 11 modes where 10"):
        probupdate.diagnose(prepared, with_one_more(record(1, n_mode=10)), extend=False)


def test_a_covariate_told_in_a_part_of_the_record_is_missed_aloud(frame_file, record):
    from probupdate.effects.catalogue import Effect

    prepared = prepare(frame_file)
    own = Effect(kind="environmental", cause="tide", location="all", unit="-", tolerance=0.0, prior_scale=0.1,
                 parts=(("k1", 1.0),), time_profiles=("water_level_m",))
    prepared = replace(prepared, effects=(*prepared.effects, own))
    data = record(8)
    for known, said in ((len(data.sets), False), (len(data.sets) // 2, True)):
        sets = tuple(s if k < known else replace(s, environment={}) for k, s in enumerate(data.sets))
        notes = diagnosis_problem(prepared, replace(data, sets=sets))[0].blocks.notes
        assert any("water_level_m is stated in" in note for note in notes) is said


@pytest.mark.parametrize("other", ["block five", "5"])
def test_an_id_that_is_no_time_among_others_is_named(record, other):
    """A number is not a year."""
    data = record(1)
    sets = list(data.sets)
    sets[4] = replace(sets[4], id=other)
    notes = " ".join(gather(replace(data, sets=tuple(sets))).notes)
    assert f"of 40 ids 1 is not a time ('{other}'; correct" in notes
    named = tuple(replace(s, id=f"block {k}") for k, s in enumerate(data.sets))
    assert "the sets' ids are not times" in " ".join(gather(replace(data, sets=named)).notes)


def test_surroundings_that_are_words_are_not_numbers(record):
    data = record(9)
    sets = tuple(replace(s, environment={"power_kw": "n/a", "wind_speed_mps": "calm"}) for s in data.sets)
    assert with_derived(gather(replace(data, sets=sets))).covariate("thrust_share") is None


def test_a_single_shape_across_its_axis_tells_nothing(validation):
    """Scaled to its axis it would be as large as one over what lies along it."""
    row = validation(what="a single shape turned from its axis: by 50 deg; beyond 60 deg",
                     reference="tangent of the angle; nothing stated", why="rounding")
    axes = np.array([[1.0], [0.0], [0.0]])
    shape = np.array([[[np.cos(a)], [np.sin(a)], [0.0]] for a in np.radians([0.0, 50.0, 70.0, 89.99])], complex)
    numbers, found_here = numbers_of_modes(np.full((4, 1), 0.3), shape, axes)
    assert found_here.tolist() == [True, True, False, False]
    row.error(numbers[1, 2] / np.tan(np.radians(50.0)) - 1, 1e-12, "50 deg")
    row.equal(numbers[2:], np.zeros_like(numbers[2:]), "beyond")
