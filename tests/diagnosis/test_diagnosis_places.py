"""Models of matrices: where their sensors are, with the rows of the catalogue that need it, and the temperature."""

from dataclasses import replace

import numpy as np
import pytest

from probupdate.diagnosis.diagnose import diagnose, examine
from probupdate.diagnosis.extension import extend, mean_set
from probupdate.diagnosis.prepare import prepare
from probupdate.diagnosis.problem import diagnosis_problem
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, Sensor
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.load import load_model
from probupdate.structure.matrices import channel_places, load_matrices
from probupdate.structure.parameter_table import read_parameters
from tests.diagnosis.conftest import CHANNELS, HEIGHT, N_STOREY


@pytest.fixture(scope="module")
def sensors():
    return tuple(Sensor(channel=f"{axis}{storey}", level=f"storey {storey}", position_m=(0.0, 0.0, 3.0 * storey),
                        direction=np.eye(3)["xy".index(axis)]) for storey in range(1, N_STOREY + 1) for axis in "xy")


def test_sensors_of_a_model_of_matrices_have_the_places_that_are_stated(frame_file, record, sensors, validation):
    """A turned housing, a late clock and a wrong gain of one logger, which places alone make rows of."""
    row = validation(what="sensors of a model of matrices, with places: a housing turned by 14 degrees, a clock late "
                          "by 8 ms, a logger's gain of 1.25: cause; size in its standard deviations",
                     reference="what was hidden")
    prepared = prepare(frame_file, sensors=sensors)
    rows = [CHANNELS.index("x3"), CHANNELS.index("y3")]
    c, s = np.cos(np.radians(14.0)), np.sin(np.radians(14.0))

    def turned(shape, frequency_hz):
        shape[rows] = np.array([[c, s], [-s, c]]) @ shape[rows]

    def late(shape, frequency_hz):
        shape[rows] *= np.exp(2j * np.pi * frequency_hz * 8e-3)

    def scaled(shape, frequency_hz):
        shape[rows] *= 1.25

    for change, cause, size in ((turned, "sensor rotation", 14.0), (late, "clock offset", 8.0),
                                (scaled, "sensor gain", 0.25)):
        sets = []
        for one in record(3).sets:
            shape = np.array(one.shape)
            change(shape, one.frequency_hz)
            sets.append(replace(one, shape=shape))
        found = diagnose(prepared, ModalData(channels=CHANNELS, sets=tuple(sets)))
        assert found.verdict in ("named", "ambiguous"), (cause, found.verdict, found.notes)
        (finding,) = found.findings
        row.equal((finding.cause, finding.location[:9]), (cause, "x3 and y3"), "cause, place")
        row.error((finding.size - size) / finding.size_std, 3, "size", case=cause)


@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_a_late_clock_is_no_gain_beside_it(frame_file, record, sensors, validation, damping):
    """What is late by t has exp(lambda t) of a mode's shape: of damping nothing, and as much as structures have, which
    had been a gain of the same logger, named at 1.00."""
    row = validation(what="three records each with a clock late by 12 ms from set 20 on, of modes of no damping and of "
                          "2 %: those in which it alone is found, size in its standard deviations",
                     reference="exp(lambda t) of the shapes", why="one alarm in thirty is allowed")
    prepared, rows, alone = prepare(frame_file, sensors=sensors), [CHANNELS.index("x3"), CHANNELS.index("y3")], 0
    for seed in range(3, 6):
        sets = []
        for k, one in enumerate(record(seed).sets):
            shape = np.array(one.shape)
            if k >= 20:
                shape[rows] *= np.exp(2 * np.pi * one.frequency_hz * (1j - damping) * 12e-3)
            sets.append(replace(one, shape=shape))
        found = diagnose(prepared, ModalData(channels=CHANNELS, sets=tuple(sets)), seed=seed)
        first = found.findings[0]
        assert (first.cause, first.location[:9]) == ("clock offset", "x3 and y3")
        row.error((first.size - 12.0) / first.size_std, 3, "size", case=seed)
        alone += len(found.findings) == 1
    row.count(alone, total=3, least=2, of="alone")


@pytest.mark.parametrize(("channels", "storeys", "begun", "location", "size"), [
    (("x3", "y3"), 1, 0, "x3 and y3, moved towards the node at (0, 0, 15) m", HEIGHT),
    (("x3",), -1, 15, "x3, moved towards the node at (0, 0, 15) m", -HEIGHT),
])
def test_a_sensor_that_reads_another_node_is_named_with_its_place(
    pictured_frame, record, tmp_path, validation, channels, storeys, begun, location, size
):
    """Both of a place, and one of them from a set on; gain and crosstalk of it had been named at their bounds."""
    row = validation(what="sensors of matrices at the next node, two channels throughout and one as a step: cause, "
                          "place; distance in its standard deviations; with the model that is written silent",
                     reference="what was hidden")
    rows = np.array([CHANNELS.index(c) for c in channels])
    data, sets = record(3), []
    for b, one in enumerate(data.sets):
        shape = np.array(one.shape)
        shape[rows] = shape[rows + 2 * storeys] if b >= begun else shape[rows]
        sets.append(replace(one, shape=shape))
    moved = replace(data, sets=tuple(sets))
    outcome = examine(pictured_frame, moved)
    (found,) = outcome.diagnosis.findings
    row.equal((outcome.diagnosis.verdict, found.cause, found.location), ("named", "sensor at another place", location),
              "cause, place")
    row.error((found.size - size) / found.size_std, 3, "size", case=location)
    extension = extend(pictured_frame, outcome, moved, tmp_path / "diagnosis.json")
    assert extension.content["files"]["modes"] is None
    assert extension.content["added"][0]["as"] == "another place of the sensor in the model"
    # between two storeys a straight line's; a step's size is known to a hundredth of it, which its record does not see
    share = abs(found.size) / HEIGHT
    expected = np.eye(len(CHANNELS))
    expected[rows] = (1 - share) * expected[rows] + share * expected[rows + 2 * storeys] if share <= 1 else (
        (2 - share) * expected[rows + 2 * storeys] + (share - 1) * expected[rows + 4 * storeys])
    written = load_model(tmp_path / extension.model)
    row.error(float(np.abs(written.channel_matrix.toarray() - expected).max()), 1e-12, "written rows", case=location)
    if not begun:
        row.equal(diagnose(prepare(tmp_path / extension.model), moved).verdict, "none", "written model", case=location)


def test_channels_of_matrices_stand_where_their_nodes_do(tmp_path):
    """One node's two translations, one of them the other way round, and a channel oblique to both."""
    row = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.8, 0.0]])
    np.savez(tmp_path / "model.npz", K0=np.zeros((3, 3)), M0=np.eye(3), K_a=np.diag([1.0, 2.0, 3.0]),
             channel=np.array(["A", "B", "C"]), channel_row=row, node_position_m=np.array([[0.0, 0.0, 5.0]]),
             dof_node=np.zeros(3, int), dof_direction=np.arange(3))
    parameter = Parameter(name="a", unit="-", initial=1.0, std=0.1, lower=0.5, upper=2.0)
    a, b, c = channel_places(load_matrices(tmp_path / "model.npz", Parameters((parameter,))))
    assert (a.channel, b.channel, c.channel) == ("A", "B", "C")
    assert np.array_equal(a.direction, [1, 0, 0]) and np.array_equal(b.direction, [0, -1, 0])
    np.testing.assert_allclose(c.direction, [0.6, 0.8, 0.0], atol=1e-15)
    np.testing.assert_allclose([x.position_m for x in (a, b, c)], [[0, 0, 5]] * 3, rtol=1e-14)


def test_stiffness_that_follows_the_temperature_is_named_with_its_slope(frame_file, record, validation):
    """All stiffness falls by 0.08 % a degree, by the frequencies of the frame's own equations; the mean of the sets
    that the estimators are given is that of the mean temperature. Of eighty other records one had something beside it,
    not told from chance."""
    row = validation(what="four records of stiffness that follows the temperature: size in its standard deviations, "
                          "its standard deviation per kelvin; mean frequencies; nothing beside it",
                     reference="-8e-4 per kelvin in the frame's own equations; the mean of those measured",
                     why="noise of a block is 0.1 %, one alarm in thirty is allowed")
    temperature, prepared, named = 8 + 6 * np.sin(np.arange(40) * 0.7), prepare(frame_file), 0
    for seed in range(6, 10):
        sets = tuple(replace(one, frequency_hz=one.frequency_hz * np.sqrt(1 - 8e-4 * (t - temperature.mean())),
                             environment={"air_temperature_c": float(t)})
                     for one, t in zip(record(seed).sets, temperature, strict=True))
        outcome = examine(prepared, ModalData(channels=CHANNELS, sets=sets))
        finding = outcome.diagnosis.findings[0]
        named += outcome.diagnosis.verdict == "named"
        assert (finding.kind, finding.cause, finding.time_profile) == (
            "environmental", "stiffness with temperature", "air_temperature_c")
        row.error((finding.size + 8e-4) / finding.size_std, 3, "size", case=seed)
        row.error(finding.size_std, 1.2e-4, "its standard deviation", case=seed)
        mean, _ = mean_set(outcome.problem, outcome.fitted)
        measured = np.exp(np.mean([np.log(s.frequency_hz) for s in sets], axis=0))
        row.error(mean.frequency_hz / measured - 1, 5e-4, "mean", case=seed)
    row.count(named, total=4, least=3, of="nothing beside it")


def test_motions_without_mass_are_refused(frame_file, tmp_path):
    """They had ended in a factor that could not be made."""
    with np.load(frame_file) as found:
        arrays = {name: np.array(found[name]) for name in found.files}
    arrays["M0"][0] = arrays["M0"][:, 0] = 0.0
    np.savez(tmp_path / "model.npz", **arrays)
    with pytest.raises(InputError, match="gives some motions no mass"):
        prepare(tmp_path / "model.npz", parameters=read_parameters(frame_file.with_name("model.toml")))


def test_one_set_s_shape_that_is_zero_is_refused_by_its_set(frame_file, record):
    """It had ended in a decomposition that did not converge."""
    first, *others = record(3).sets
    shape = np.array(first.shape)
    shape[:, 1] = 0.0
    with pytest.raises(InputError, match=f"set {first.id}: the shape of mode 2 is zero"):
        diagnose(prepare(frame_file), ModalData(channels=CHANNELS, sets=(replace(first, shape=shape), *others)))


def test_shapes_that_are_zero_everywhere_are_refused_by_their_mode(frame_file, record):
    """They had ended in a division by zero."""
    sets = tuple(replace(one, shape=0 * np.array(one.shape)) for one in record(3).sets)
    with pytest.raises(InputError, match="set .*mode 1 is zero at every channel"):
        diagnose(prepare(frame_file), ModalData(channels=CHANNELS, sets=sets))


@pytest.mark.parametrize(("begun", "said"), [(0, ["40 of 40"]), (39, []), (38, ["2 of 40"])])
def test_channels_that_are_one_signal_are_said(frame_file, record, begun, said):
    """In two sets at least: of two channels that differ in nothing each has its own noise."""
    data, sets = record(3), []
    for b, one in enumerate(data.sets):
        shape = np.array(one.shape)
        shape[4] = -2.5 * shape[0] if b >= begun else shape[4]
        sets.append(replace(one, shape=shape))
    found = diagnosis_problem(prepare(frame_file), replace(data, sets=tuple(sets)))[0]
    notes = [n for n in found.notes if "same numbers" in n]
    assert [n.split(" sets,")[0] for n in notes] == [f"x1 and x3 have the same numbers, but for a factor, in {n}"
                                                     for n in said]
