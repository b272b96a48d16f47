"""Each pole and the criterion that removed it; close pairs by their plane; harmonics by the rotor speed."""

from dataclasses import replace

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.identification import classification as rules
from probupdate.identification.classification import ClassifierSettings, PoleStack
from probupdate.identification.reference import ReferenceModes, turn_reference
from probupdate.identification.tracking import JudgedPoles, choose
from probupdate.modal.modes import mac

SETTINGS = ClassifierSettings()
NO_BANDS = np.zeros((0, 2))


def poles(frequency, damping, shape, order=20) -> PoleStack:
    frequency = np.array(frequency, float)
    return PoleStack(order=np.broadcast_to(order, frequency.shape), frequency_hz=frequency,
                     damping_ratio=np.array(damping, float), shape=np.array(shape, complex))


def judged(found: PoleStack, reference, bands=NO_BANDS, centre=None, stability=None, settings=SETTINGS):
    like = rules.comparison(found, reference, None if stability is None else np.array(stability))
    verdict = rules.block_criteria(found, like, reference, settings)
    block = JudgedPoles(id="0", poles=found, comparison=like, verdict=verdict, bands=bands, reference=reference)
    return choose(block, reference.frequency_hz if centre is None else np.array(centre), settings), like


def test_the_modes_themselves_are_kept_each_in_its_place(jacket, reference):
    order = [4, 2, 0, 3, 1]
    choice, _ = judged(
        poles(jacket.frequency_hz[order], jacket.damping_ratio[order], jacket.shape[:, order]), reference)
    assert list(choice.pole) == [order.index(j) for j in range(5)]
    assert set(choice.criterion) == {"kept"}
    assert np.all(choice.independence[[0, 2]] > 0.99)
    assert np.isnan(choice.independence[1])


@pytest.mark.parametrize("angle", [0, 20, 45, 70, 90, 135])
def test_a_pair_is_known_at_any_angle_in_its_plane_where_single_mac_loses_it(jacket, reference, pairs_turned, angle):
    found = poles(jacket.frequency_hz, jacket.damping_ratio, pairs_turned(jacket.shape, angle))
    choice, like = judged(found, reference)
    assert set(choice.criterion) == {"kept"} and sorted(choice.pole) == [0, 1, 2, 3, 4]
    paper = rules.paper_criteria(found, like, NO_BANDS, SETTINGS)
    lost = np.cos(np.radians(angle)) ** 2 < 0.78 and np.sin(np.radians(angle)) ** 2 < 0.78
    assert (paper[[0, 1, 3, 4]] == "mac").all() == lost
    assert paper[2] == "kept"


def test_poles_of_a_pair_are_named_by_direction(jacket, reference, pairs_turned):
    """Turned by 90 degrees the first pole of each pair moves side-side: names follow the direction, not the order."""
    found = poles(jacket.frequency_hz, jacket.damping_ratio, pairs_turned(jacket.shape, 90))
    choice, _ = judged(found, reference)
    assert list(choice.pole) == [1, 0, 2, 4, 3]


def test_fore_aft_turns_with_the_nacelle(jacket, reference, pairs_turned, sensor_list):
    found = poles(jacket.frequency_hz, jacket.damping_ratio, pairs_turned(jacket.shape, 65))
    assert list(judged(found, reference)[0].pole) == [1, 0, 2, 4, 3]
    assert list(judged(found, turn_reference(reference, sensor_list, 65))[0].pole) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("flip", [(1, 1), (1, -1), (-1, 1)])
def test_turning_does_not_depend_on_signs_or_order(jacket, reference, pairs_turned, sensor_list, flip):
    shape = np.array(jacket.shape)
    shape[:, [0, 1]] *= flip
    here = replace(reference, shape=shape, pairs=((1, 0), (3, 4)))
    expected = pairs_turned(jacket.shape, 30)
    assert np.diag(mac(turn_reference(here, sensor_list, 30).shape, expected)) == pytest.approx(np.ones(5), abs=1e-3)


def test_turning_leaves_pairs_of_other_names(jacket, sensor_list):
    other = ReferenceModes(labels=("V1", "T1"), frequency_hz=[1, 1.01], shape=jacket.shape[:, :2], pairs=((0, 1),))
    assert (turn_reference(other, sensor_list, 40).shape == other.shape).all()


def noise_shape(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(18) + 1j * rng.standard_normal(18)


def test_every_removed_pole_keeps_its_criterion(jacket, reference):
    s = jacket.shape
    found = poles(
        [0.316, 0.323, 0.318, 0.30, 0.31, 0.90, 0.352, 1.29, 1.30, 1.0],
        [0.015, 0.012, 0.050, 0.20, -0.01, 0.02, 0.015, 0.01, 0.03, 0.01],
        np.column_stack([s[:, 0], s[:, 1], s[:, 0], s[:, 0], s[:, 1], s[:, 0], s[:, 1], s[:, 2],
                         s[:, 2] * np.exp(1j * np.linspace(0, 2.2, 18)), noise_shape()]),
    )
    choice, _ = judged(found, reference, settings=replace(SETTINGS, mac=0.4))
    assert list(choice.criterion) == [
        "kept", "kept", "duplicate", "damping", "damping", "frequency", "cluster", "kept", "complexity", "mac",
    ]
    assert list(choice.pole) == [0, 1, 7, -1, -1]


def test_an_unstable_double_is_the_duplicate_even_if_less_damped(jacket, reference):
    s = jacket.shape
    found = poles([1.90, 1.93, 2.02], [0.006, 0.01, 0.012], np.column_stack([s[:, 3], s[:, 3], s[:, 4]]))
    choice, _ = judged(found, reference, stability=[0.2, 1.0, 1.0])
    assert list(choice.criterion) == ["duplicate", "kept", "kept"]


def test_two_poles_of_one_direction_are_one_mode_twice(jacket, reference):
    s = jacket.shape
    found = poles([0.316, 0.320], [0.015, 0.02], np.column_stack([s[:, 0], s[:, 0] + 0.1 * s[:, 1]]))
    choice, _ = judged(found, reference)
    assert list(choice.pole) == [0, -1, -1, -1, -1] and list(choice.criterion) == ["kept", "duplicate"]
    assert np.isnan(choice.independence[0])


def test_a_harmonic_of_the_first_mode_s_shape_falls_to_the_rotor_speed(jacket, reference):
    """A line at 3P = 0.45 Hz that bends the tower as FA1 does, nearly real and lightly damped: MAC and complexity
    pass it (the paper's own difficulty); the rotor speed does not."""
    s = jacket.shape
    found = poles([0.316, 0.323, 0.45], [0.015, 0.012, 0.002], np.column_stack([s[:, 0], s[:, 1], s[:, 0]]))
    bands = rules.rotor_bands({"rotor_speed_rpm_min": 8.8, "rotor_speed_rpm_max": 9.2}, SETTINGS)
    choice, like = judged(found, reference, bands)
    assert list(choice.criterion) == ["kept", "kept", "harmonic"]
    assert rules.paper_criteria(found, like, bands, SETTINGS)[2] == "kept"
    assert list(judged(found, reference)[0].criterion) == ["kept", "kept", "cluster"]


def test_a_line_far_from_its_mode_is_a_harmonic_only_where_the_rotor_says_so(jacket, reference):
    found = poles([0.316, 0.74], [0.015, 0.004], jacket.shape[:, [0, 0]])
    bands = rules.rotor_bands({"rotor_speed_rpm_min": 14.6, "rotor_speed_rpm_max": 14.9}, SETTINGS)
    assert judged(found, reference, bands)[0].criterion[1] == "harmonic"
    assert judged(found, reference)[0].criterion[1] == "frequency"


def test_a_mode_within_the_swept_band_is_kept_and_a_line_there_is_not(jacket, reference):
    s = jacket.shape
    bands = rules.rotor_bands({"rotor_speed_rpm_min": 6.0, "rotor_speed_rpm_max": 7.0}, SETTINGS)  # 3P 0.29-0.36 Hz
    found = poles([0.316, 0.323, 0.33], [0.015, 0.012, 0.001], np.column_stack([s[:, 0], s[:, 1], s[:, 0]]))
    choice, _ = judged(found, reference, bands)
    assert list(choice.criterion) == ["kept", "kept", "harmonic"]


def test_paper_s_complexity_criterion_asks_near_the_p_frequencies_only(jacket, reference):
    s = jacket.shape
    turning = s[:, 0] + 0.6j * s[:, 1]  # a load that rotates
    found = poles([0.45, 0.32], [0.005, 0.01], np.column_stack([turning, turning]))
    bands = rules.rotor_bands({"rotor_speed_rpm_min": 8.8, "rotor_speed_rpm_max": 9.2}, SETTINGS)
    like = rules.comparison(found, reference, np.ones(2))
    paper = rules.paper_criteria(found, like, bands, replace(SETTINGS, mac=0.6))
    assert list(paper) == ["complexity", "kept"]
    paper = rules.paper_criteria(found, like, NO_BANDS, replace(SETTINGS, mac=0.6))
    assert list(paper) == ["complexity", "complexity"]


def test_rotor_bands_cover_what_the_speed_swept():
    bands = rules.rotor_bands({"rotor_speed_rpm_min": 6.0, "rotor_speed_rpm_max": 12.0}, SETTINGS)
    assert bands[1] == pytest.approx([3 * 0.1 * 0.98, 3 * 0.2 * 1.02])
    assert rules.is_within(np.array([0.28, 0.3, 0.6, 0.63]), bands[1:2]).tolist() == [False, True, True, False]
    for missing in ({}, {"rotor_speed_rpm_min": np.nan, "rotor_speed_rpm_max": 3.0}):
        assert rules.rotor_bands(missing, SETTINGS).shape == (0, 2)


@pytest.mark.parametrize(("change", "problem"), [
    ({"labels": ("FA1", "FA1")}, "repeat"), ({"frequency_hz": [1.0, -1.0]}, "positive"),
    ({"shape": np.full((4, 2), np.nan)}, "holds NaN"), ({"pairs": ((0, 2),)}, "not there"),
    ({"pairs": ((0, 1), (1, 0))}, "share a mode"),
])
def test_reference_modes_that_make_no_sense_are_refused(change, problem):
    values = {"labels": ("FA1", "SS1"), "frequency_hz": [1.0, 1.1], "shape": np.eye(4)[:, :2], "pairs": ((0, 1),)}
    with pytest.raises(InputError, match=problem):
        ReferenceModes(**(values | change))
