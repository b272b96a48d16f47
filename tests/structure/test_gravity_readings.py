"""What accelerometers read of gravity as their place tilts: closed form, differences, forms of model, statements."""

import json
from dataclasses import replace

import numpy as np
import pytest
from small_turbine import small_turbine

from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, ModalSet, Sensor, read_modes, write_modes
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.description_file import parse_description
from probupdate.structure.load import load_model, turbine_model
from probupdate.structure.reduced import reduce_basis
from probupdate.updating.problem import build_problem
from tests.subdyn_text import STEEL, subdyn

G = 9.80665
LENGTH, HZ, ROOT = 100.0, 0.32, 1.8751040687119611
# phi'(L) L / phi(L) of a clamped beam's first mode
TIP_SLOPE = ROOT * (np.sinh(ROOT) + np.sin(ROOT) - (np.cosh(ROOT) + np.cos(ROOT)) / (np.sinh(ROOT) + np.sin(ROOT)) * (
    np.cosh(ROOT) - np.cos(ROOT))) / (np.cosh(ROOT) - np.cos(ROOT) - (np.cosh(ROOT) + np.cos(ROOT)) / (
        np.sinh(ROOT) + np.sin(ROOT)) * (np.sinh(ROOT) - np.sin(ROOT)))


def beam_arrays(n=40, unit=1.0):
    """A clamped upright beam that bends along x and along y, slightly stiffer along y: rows u_x, theta_y, u_y, theta_x,
    u_z of each node; lengths in metres over `unit`."""
    h, mass = LENGTH / n, 1000.0
    stiffness = mass * (2 * np.pi * HZ) ** 2 * LENGTH**4 / ROOT**4
    bend = stiffness / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                                        [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]])
    inert = mass * h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                                       [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]])
    size = 5 * (n + 1)
    K, M = np.zeros((size, size)), np.zeros((size, size))
    # the right-hand rule: along y the beam turns about x the other way round
    for first, factor, turn in ((0, 1.0, 1.0), (2, 1.2, -1.0)):
        sign = np.outer([1, turn, 1, turn], [1, turn, 1, turn])
        for k in range(n):
            rows = 5 * k + np.array([first, first + 1, first + 5, first + 6])
            K[np.ix_(rows, rows)] += factor * bend * sign
            M[np.ix_(rows, rows)] += inert * sign
    for k in range(n):
        rows = np.array([5 * k + 4, 5 * k + 9])
        K[np.ix_(rows, rows)] += 1e4 * stiffness / h**3 * np.array([[1, -1], [-1, 1]])
        M[np.ix_(rows, rows)] += mass * h / 6 * np.array([[2, 1], [1, 2]])
    K, M = K[5:, 5:], M[5:, 5:]
    scale = np.tile([1 / unit, 1.0, 1 / unit, 1.0, 1 / unit], n)
    return {
        "K0": 0.5 * K / np.outer(scale, scale), "M0": M / np.outer(scale, scale),
        "K_EI": 0.5 * K / np.outer(scale, scale),
        "node_position_m": np.column_stack([np.zeros((n, 2)), h * np.arange(1, n + 1)]),
        "dof_node": np.repeat(np.arange(n), 5), "dof_direction": np.tile([0, 4, 1, 3, 2], n),
    }


EI = Parameters((Parameter(name="EI", unit="-", initial=1.0, std=0.1, lower=0.2, upper=3.0),))


def beam_model(folder, arrays, **channels):
    path = folder / "model.npz"
    np.savez(path, **(arrays | channels))
    return load_model(path, parameters=EI)


@pytest.fixture
def arrays():
    return beam_arrays()


def ratios(model, n_mode=2, theta=(1.0,)):
    """Readings over motions, and circular frequencies squared."""
    theta = np.array(theta)
    read = model.solve(theta, n_mode)
    plain = model.with_gravity(dict.fromkeys(model.channels, False)).solve(theta, n_mode)
    return read.shape / np.where(np.abs(plain.shape) > 1e-9, plain.shape, np.nan), (2 * np.pi * read.frequency_hz) ** 2


def test_a_clamped_beam_reads_as_the_closed_form_says(tmp_path, arrays, validation):
    row = validation(what="tip of a clamped beam: reading over motion", reference="1 + 1.3765 g / (L w^2)",
                     why="forty elements")
    assert abs(TIP_SLOPE - 1.3765) < 1e-4
    model = beam_model(tmp_path, arrays, channel=["x", "y", "z"], channel_dof=[195, 197, 199])
    found, square = ratios(model)
    assert square[0] == pytest.approx((2 * np.pi * HZ) ** 2, rel=1e-6)
    row.error(found[0, 0] - (1 + TIP_SLOPE * G / (LENGTH * square[0])), below=1e-6, of="along x")
    row.error(found[1, 1] - (1 + TIP_SLOPE * G / (LENGTH * square[1])), below=1e-6, of="along y")
    assert 1.033 < found[0, 0] < 1.0335
    assert np.abs(model.solve(np.ones(1), 2).shape[2]).max() < 1e-15


def test_near_the_foot_the_share_grows_as_two_over_the_height(tmp_path, arrays):
    model = beam_model(tmp_path, arrays, channel=["low", "higher"], channel_dof=[0, 5])
    found, square = ratios(model, 1)
    z = np.array([2.5, 5.0])
    # phi = z^2 - ..., so that phi' / phi = 2 / z but for z / L
    assert (found[:, 0] - 1) * square[0] / G == pytest.approx(2 / z, rel=0.02)


def test_an_oblique_channel_reads_by_the_vector_formula(tmp_path, arrays):
    d = np.array([0.6, -0.48, 0.64])
    rows = np.zeros((1, 200))
    rows[0, [195, 197, 199]] = d
    model = beam_model(tmp_path, arrays, channel=["oblique"], channel_row=rows)
    value, phi = model.solve_full(np.ones(1), 2)
    u, theta_y, v, theta_x, w = phi[195:]
    expected = d[0] * (u + G * theta_y / value) + d[1] * (v - G * theta_x / value) + d[2] * w
    assert model.solve(np.ones(1), 2).shape[0] == pytest.approx(expected, rel=1e-12)


def test_stated_rotations_are_those_that_the_nodes_have(tmp_path, arrays):
    of_nodes = beam_model(tmp_path, arrays, channel=["x", "y", "z"], channel_dof=[195, 197, 199])
    bare = {k: v for k, v in arrays.items() if k not in ("node_position_m", "dof_node", "dof_direction")}
    stated = beam_model(tmp_path, bare, channel=["x", "y", "z"], channel_dof=[195, 197, 199],
                        channel_tilt_dof=[196, 198, -1], channel_tilt_sign=[1, -1, 1])
    rows = np.zeros((3, 200))
    rows[0, 196], rows[1, 198] = 1.0, -1.0
    combined = beam_model(tmp_path, bare, channel=["x", "y", "z"], channel_dof=[195, 197, 199], channel_tilt_row=rows)
    one = of_nodes.solve(np.ones(1), 3).shape
    for other in (stated, combined):
        assert other.solve(np.ones(1), 3).shape == pytest.approx(one, rel=1e-12, abs=1e-15)
    lacking = beam_model(tmp_path, bare, channel=["x", "y", "z"], channel_dof=[195, 197, 199])
    assert lacking.gravity is None
    assert list(of_nodes.gravity.known) == [True] * 3 and list(stated.gravity.known) == [True, True, False]


def test_matrices_in_millimetres_state_their_gravity(tmp_path):
    channels = {"channel": ["x"], "channel_dof": [195]}
    metres, _ = ratios(beam_model(tmp_path, beam_arrays(), **channels))
    other, _ = ratios(beam_model(tmp_path, beam_arrays(unit=1e-3), gravity=9806.65, **channels))
    assert other[0, 0] == pytest.approx(metres[0, 0], rel=1e-6)


@pytest.mark.parametrize(("more", "says"), [
    ({"channel_tilt_dof": [196, 400]}, "channel_tilt_dof: row 400 is outside -1..199"),
    ({"channel_tilt_dof": [196.0, 198.0]}, "channel_tilt_dof: has float64"),
    ({"channel_tilt_dof": [196, 198], "channel_tilt_sign": [1, 2]}, "channel_tilt_sign"),
    ({"channel_tilt_dof": [196, 198], "channel_tilt_row": np.zeros((2, 200))}, "stands beside channel_tilt_dof"),
    ({"channel_tilt_row": np.zeros((2, 7))}, "channel_tilt_row: has shape"),
    ({"channel_tilt_dofs": [196, 198]}, "did you mean 'channel_tilt_dof'"),
    ({"gravity": -9.81}, "gravity: .* is not an acceleration"),
    ({"gravity": [9.81, 9.81]}, "gravity: .* is not an acceleration"),
])
def test_a_mistake_in_the_channel_table_is_named(tmp_path, arrays, more, says):
    with pytest.raises(InputError, match=says):
        beam_model(tmp_path, arrays, channel=["x", "y"], channel_dof=[195, 197], **more)


def test_a_subdyn_cantilever_reads_as_the_closed_form_says(tmp_path, validation):
    row = validation(what="tip of a SubDyn cantilever: reading over motion", reference="1 + 1.3765 g / (L w^2)",
                     why="rotary inertia of a slender tube")
    (tmp_path / "beam.dat").write_text(subdyn(["0 0 0", "0 0 100"], ["1 2 1 1 1c 0"], ["1 1 1 1 1 1 1"], div=30, fem=3,
                                              circular=[f"1 {STEEL} 2.0 0.02"]))
    sensors = "".join(f'[[sensor]]\nchannel = "{name}"\njoint = 2\ndirection = {d}\n{more}' for name, d, more in (
        ("x", [1.0, 0.0, 0.0], ""), ("y", [0.0, 1.0, 0.0], 'quantity = "velocity"\nunit = "m/s"\n'),
        ("off", [1.0, 0.0, 0.0], "gravity = false\n"),
        ("u", [1.0, 0.0, 0.0], 'quantity = "displacement"\nunit = "m"\n')))
    path = tmp_path / "model.toml"
    path.write_text('[subdyn]\nfile = "beam.dat"\n' + sensors)
    model = load_model(path)
    solved = model.solve(np.zeros(0), 2)
    square = (2 * np.pi * solved.frequency_hz[0]) ** 2
    # the pair is turned anyhow
    x, y, off, u = np.linalg.norm(solved.shape, axis=1)
    assert u == pytest.approx(off, rel=1e-9)
    for read in (x, y):
        row.error(read / off - (1 + TIP_SLOPE * G / (LENGTH * square)), below=2e-4)
    # a file alone has its joints' displacements
    bare = load_model(tmp_path / "beam.dat")
    assert not bare.gravity.share.any()
    assert bare.with_gravity({"J2x": True}).solve(np.zeros(0), 2).shape[bare.channels.index("J2x")] == pytest.approx(
        solved.shape[0], rel=1e-9)


@pytest.fixture(scope="module")
def turbine():
    return turbine_model(parse_description(small_turbine(), "model.toml"), where="model.toml")


def test_a_tower_s_sensors_read_the_slope_of_its_axis(turbine, validation):
    """By differences of the motion of sensors above and below: a second route to the rotation."""
    row = validation(what="sensors on a tower: gravity's part", reference="slope of the shape by differences",
                     why="third differences of a cubic")
    d = parse_description(small_turbine(), "model.toml")
    places = [(z, a) for z in (39.99, 40.0, 40.01) for a in (0, 1)]
    sensors = [Sensor(channel=f"{z}{a}", level="", position_m=[0, 0, z], direction=np.eye(3)[a]) for z, a in places]
    model = turbine_model(d, where="m", sensors=sensors)
    value, _ = model.solve_full(model.parameters.initial, 6)
    read = model.solve(model.parameters.initial, 6).shape
    plain = model.with_gravity(dict.fromkeys(model.channels, False)).solve(model.parameters.initial, 6).shape
    for a in (0, 1):
        slope = (plain[4 + a] - plain[a]) / 0.02
        row.error((read[2 + a] - plain[2 + a]) / (9.81 / value) / np.abs(slope).max() - slope / np.abs(slope).max(),
                  below=1e-5)


def shape_differences(model, theta, n_mode, k, clusters=()):
    """d shape / d theta_k by differences, modes signed, clusters turned onto those at theta by their motions."""
    at, sides = model.solve(theta, n_mode).shape, []
    step = 1e-5 * model.parameters.std[k]
    for change in (step, -step):
        shape = np.array(model.solve(theta + change * np.eye(theta.size)[k], n_mode).shape)
        shape *= np.sign(np.sum(shape * at, axis=0))
        sides.append(shape)
    return (sides[0] - sides[1]) / (2 * step)


def test_derivatives_hold_that_of_the_frequency(turbine, validation):
    row = validation(what="shape derivatives with gravity in the readings", reference="differences",
                     why="step of the differences")
    theta = np.array(turbine.parameters.initial)
    exact = turbine.solve(theta, 5, derivatives=True).shape_derivative
    for k in range(theta.size):
        differences = shape_differences(turbine, theta, 5, k)
        row.error((exact[:, :, k] - differences) / np.abs(differences).max(), below=2e-4)


def test_what_a_pair_s_plane_does_is_right_without_its_rotation(turbine, validation):
    """Outside the plane of the pair the derivative is that of single modes, within it but for the rotation."""
    row = validation(what="derivative of a close pair's plane of readings", reference="differences",
                     why="step of the differences")
    theta, pair = np.array(turbine.parameters.initial), [0, 1]
    exact = turbine.solve(theta, 5, derivatives=True, clusters=((0, 1),)).shape_derivative[:, pair]
    plane = np.linalg.qr(turbine.solve(theta, 5).shape[:, pair])[0]
    outside = np.eye(len(plane)) - plane @ plane.T
    for k in range(theta.size):
        differences = shape_differences(turbine, theta, 5, k)[:, pair]
        row.error(outside @ (exact[:, :, k] - differences) / np.abs(differences).max(), below=2e-4)


def test_a_reduced_basis_reads_as_the_model_does(turbine, validation):
    row = validation(what="readings on a reduced basis", reference="full model", why="the basis")
    width = 0.3 * turbine.parameters.std
    box = (turbine.parameters.initial - width, turbine.parameters.initial + width)
    reduced = reduce_basis(turbine, n_mode=5, box=box, frequency_tolerance=1e-4, n_snapshot=24, n_verify=8)
    theta = np.random.default_rng(1).uniform(*box, (6, len(width)))
    for model, whole in ((reduced, turbine), (reduced.with_gravity({"T50-x": False}),
                                              turbine.with_gravity({"T50-x": False}))):
        many, exact = model.solve_many(theta, 5), whole.solve_many(theta, 5)
        sign = np.sign(np.sum(many.shape * exact.shape, axis=1, keepdims=True))
        row.error((many.shape * sign - exact.shape) / np.abs(exact.shape).max(axis=1, keepdims=True), below=0.02)
        single = model.solve(theta[0], 5).shape
        assert np.abs(single) == pytest.approx(np.abs(many.shape[0]), rel=1e-6, abs=1e-9)


def test_the_parameter_that_reverses_a_statement_is_it(turbine):
    raw = small_turbine()
    raw["parameter"].append({"name": "wrong", "kind": "sensor_gravity", "channels": ["T50-x", "T30-y"], "unit": "-",
                             "initial": 0.0, "std": 1.0, "lower": 0.0, "upper": 1.5, "update": True})
    raw["sensor"][6]["gravity"] = False
    model = turbine_model(parse_description(raw, "model.toml"), where="model.toml")
    theta = np.array(model.parameters.initial)
    whole = theta + np.eye(theta.size)[-1]
    right = turbine.with_gravity({"T30-y": False}).solve(theta[:-1], 4)
    other = turbine.with_gravity({"T50-x": False, "T30-y": True}).solve(theta[:-1], 4)
    assert model.solve(theta, 4).shape == pytest.approx(right.shape, rel=1e-9, abs=1e-15)
    assert model.solve(whole, 4).shape == pytest.approx(other.shape, rel=1e-9, abs=1e-15)
    slope = model.solve(theta, 4, derivatives=True).shape_derivative[:, :, -1]
    assert slope == pytest.approx(other.shape - right.shape, rel=1e-7, abs=1e-12)


# statements ---------------------------------------------------------------------------------------------------------


def test_what_the_quantity_has_where_nothing_is_stated():
    place = {"channel": "a", "level": "", "position_m": [0, 0, 1], "direction": [1, 0, 0]}
    assert [Sensor(**place, quantity=q).gravity for q in ("acceleration", "velocity", "displacement")] == [
        True, True, False]
    assert Sensor(**place, gravity=False).gravity is False
    assert Sensor(**place, quantity="displacement", gravity=True).gravity is True
    with pytest.raises(InputError, match="gravity: 'no' is neither true nor false"):
        Sensor(**place, gravity="no")


def one_set(model, felt=()):
    """The model's own modes as measured."""
    solved = model.solve(model.parameters.initial, 4)
    return ModalData(channels=model.channels, gravity=felt, sets=(ModalSet(
        id="one", frequency_hz=solved.frequency_hz, damping_ratio=np.full(4, 0.01), shape=solved.shape,
        frequency_std_hz=0.01 * solved.frequency_hz, shape_std=np.full(solved.shape.shape, 1e-3)),))


def test_the_statement_of_modes_json_is_kept_and_taken(turbine, tmp_path):
    plain = turbine.with_gravity(dict.fromkeys(turbine.channels, False))
    data = one_set(plain, (False,) * len(turbine.channels))
    write_modes(data, tmp_path / "modes.json")
    read = read_modes(tmp_path / "modes.json")
    assert read.gravity == data.gravity and read.without_channels(["T50-x"]).gravity == data.gravity[:-1]
    theta = turbine.parameters.initial
    assert build_problem(turbine, read).log_likelihood(theta) == pytest.approx(
        build_problem(plain, replace(data, gravity=())).log_likelihood(theta))
    # another statement, another problem
    prints = {build_problem(turbine, replace(data, gravity=g)).fingerprint() for g in (
        (), (True,) * len(turbine.channels), data.gravity, (False, *(True,) * (len(turbine.channels) - 1)))}
    assert len(prints) == 3


@pytest.mark.parametrize(("value", "read"), [
    (True, (True, True)), (False, (False, False)), ([True, False], (True, False)), (None, ())])
def test_modes_json_states_one_for_all_or_one_each(tmp_path, value, read):
    path = tmp_path / "modes.json"
    path.write_text(json.dumps({"channels": ["a", "b"], "gravity": value, "sets": [
        {"id": "1", "frequency_hz": [1.0], "shape_re": [[1.0, 0.5]]}]}))
    assert read_modes(path).gravity == read


@pytest.mark.parametrize("value", ["no", [True], [True, 0], 0, [True, None]])
def test_a_statement_that_is_none_is_named(tmp_path, value):
    path = tmp_path / "modes.json"
    path.write_text(json.dumps({"channels": ["a", "b"], "gravity": value, "sets": [
        {"id": "1", "frequency_hz": [1.0], "shape_re": [[1.0, 0.5]]}]}))
    with pytest.raises(InputError, match=r"modes.json, gravity: .* neither true or false"):
        read_modes(path)


@pytest.mark.parametrize("unit", [1.0, 1e-3, 0.0254], ids=["m", "mm", "inch"])
def test_gravity_that_is_not_stated_is_of_the_matrices_unit(tmp_path, unit):
    n = 40
    np.savez(tmp_path / "model.npz", **beam_arrays(n, unit), channel=["tip"], channel_dof=[5 * (n - 1)])
    (tmp_path / "parameters.toml").write_text(
        '[[parameter]]\nname = "EI"\nunit = "-"\ninitial = 1.0\nstd = 0.1\nlower = 0.2\nupper = 3.0\n')
    assert load_model(tmp_path / "model.npz").gravity.mps2 == pytest.approx(G / unit, rel=1e-3)


@pytest.mark.parametrize(("unit", "places", "gravity", "words"), [
    (1e-3, 1.0, G, r"lengths 1000 times .* set gravity = 9806.65"),
    (1e-3, 1e3, 1e3 * G, r"lengths 1 times .* in mm, divide it by 1000"),
], ids=["gravity in m", "places in mm"])
def test_gravity_of_another_unit_than_the_matrices_is_refused(tmp_path, unit, places, gravity, words):
    n = 40
    arrays = beam_arrays(n, unit)
    arrays["node_position_m"] = places * arrays["node_position_m"]
    np.savez(tmp_path / "model.npz", **arrays, channel=["tip"], channel_dof=[5 * (n - 1)], gravity=gravity)
    (tmp_path / "parameters.toml").write_text(
        '[[parameter]]\nname = "EI"\nunit = "-"\ninitial = 1.0\nstd = 0.1\nlower = 0.2\nupper = 3.0\n')
    with pytest.raises(InputError, match=words):
        load_model(tmp_path / "model.npz")
