"""Models given as matrices or as a function: reading, mistakes, the pedestrian bridge."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from drawn import structures
from scipy import sparse

import probupdate
from probupdate.errors import InputError
from probupdate.io.files import archive_arrays
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameter, Parameters
from probupdate.structure.functions import FunctionModel
from probupdate.structure.load import load_model, model_files
from probupdate.structure.matrices import load_matrices
from probupdate.structure.parameter_table import read_parameters

REPOSITORY = Path(__file__).resolve().parents[2]
BRIDGE = REPOSITORY.parent / "shared" / "data" / "footbridge"
TABLE = """
[[parameter]]
name = "k"
unit = "-"
initial = 0.1
std = 0.2
lower = -0.5
upper = 1.0
[[parameter]]
name = "m"
unit = "-"
initial = 0.0
std = 0.1
"""


def chain(n=6):
    line = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    first, last = np.zeros((n, n)), np.zeros((n, n))
    first[0, 0], last[-1, -1] = 1.0, 2.0
    return {
        "K0": 100.0 * line, "M0": np.eye(n), "K_k": 100.0 * first, "M_m": last,
        "channel": np.array(["a", "b"]), "channel_dof": np.array([0, n - 1]),
    }


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "parameters.toml").write_text(TABLE)
    return tmp_path


def save(folder, **changes):
    content = {key: value for key, value in (chain() | changes).items() if value is not None}
    np.savez(folder / "model.npz", **content)
    return folder / "model.npz"


def test_matrices_by_hand(folder):
    model = load_model(save(folder))
    theta = np.array([0.3, 0.2])
    content = chain()
    K, M = content["K0"] + 0.3 * content["K_k"], content["M0"] + 0.2 * content["M_m"]
    value = np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)[:3]
    assert (2 * np.pi * model.solve(theta, 3).frequency_hz) ** 2 == pytest.approx(value, rel=1e-10)
    assert model.channels == ("a", "b")
    assert model.parameters.initial == pytest.approx([0.1, 0.0])


@pytest.mark.parametrize("beside", ['name = "jacket"\n[subdyn]\nfile = "a.dat"\n', 'format = 1\n[site]\n',
                                    '[matrices]\nfile = "other.npz"\n'])
def test_another_forms_model_beside_an_archive_is_no_table_of_its_parameters(folder, beside):
    path = save(folder)
    (folder / "model.toml").write_text(beside)
    assert load_model(path).parameters.names == ("k", "m")
    assert model_files(path) == (path, folder / "parameters.toml")
    (folder / "parameters.toml").unlink()
    with pytest.raises(InputError, match="not known .model.toml is a model itself"):
        load_model(path)
    # its own table has its name, and may have a mistake
    (folder / "model.toml").write_text(TABLE.replace("std", "sdt"))
    with pytest.raises(InputError, match="sdt"):
        load_model(path)


def test_sparse_and_dense_files_are_one_model(folder):
    from scipy import sparse

    dense = load_model(save(folder))
    content = chain()
    parts = {}
    for key in ("K0", "M0", "K_k", "M_m"):
        matrix = sparse.csr_array(content[key])
        parts |= {key: None, f"{key}_data": matrix.data, f"{key}_indices": matrix.indices,
                  f"{key}_indptr": matrix.indptr}
    theta = np.array([0.3, 0.2])
    found = load_model(save(folder, **parts)).solve(theta, 3)
    assert found.frequency_hz == pytest.approx(dense.solve(theta, 3).frequency_hz, rel=1e-12)


def test_signs_and_picture(folder):
    model = load_model(save(
        folder, channel_sign=np.array([1, -1]), node_position_m=np.arange(6)[:, None] * [[1.0, 0, 0]],
        dof_node=np.arange(6), dof_direction=np.full(6, 2),
    ))
    theta = model.parameters.initial
    solution, wire = model.solve(theta, 2), model.wireframe(theta, 2)
    assert wire.displacement.shape == (6, 3, 2)
    assert np.abs(wire.displacement[:, :2]).max() == 0
    assert solution.shape[0] == pytest.approx(wire.displacement[0, 2])
    assert solution.shape[1] == pytest.approx(-wire.displacement[5, 2])


@pytest.mark.parametrize("form", ["dense", "csr"])
def test_an_oblique_sensor_reads_a_combination(folder, form, validation):
    """A channel at 30 degrees between two degrees of freedom, against its components rotated by hand."""
    row = validation(what="an oblique sensor on a model of matrices", reference="components rotated by hand",
                     why="rounding")
    from scipy import sparse

    c, s = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    rows = np.zeros((2, 6))
    rows[0, [0, 3]], rows[1, 5] = (c, s), -1.0
    parts = {"channel_dof": None, "channel_row": rows}
    if form == "csr":
        csr = sparse.csr_array(rows)
        parts = {"channel_dof": None, "channel_row_data": csr.data, "channel_row_indices": csr.indices,
                 "channel_row_indptr": csr.indptr}
    model = load_model(save(folder, **parts))
    _, phi = model.solve_full(model.parameters.initial, 3)
    shape = model.solve(model.parameters.initial, 3).shape
    by_hand = np.array([c * phi[0] + s * phi[3], -phi[5]])
    row.error((shape - by_hand) / np.abs(by_hand).max(), below=1e-12)


def eye(n=6):
    return np.eye(n)


SKEW = chain()["K0"].copy()
SKEW[0, 3] = 4.0
NAN = chain()["K0"].copy()
NAN[2, 2] = np.nan


@pytest.mark.parametrize(
    ("changes", "key", "problem"),
    [
        ({"K0": None}, "K0", "is missing"),
        ({"M0": None}, "M0", "is missing"),
        ({"K0": SKEW}, "K0", "is not symmetric (largest difference 4)"),
        ({"K0": NAN}, "K0", "NaN or infinite"),
        ({"K0": np.ones((6, 5))}, "K0", "has shape (6, 5)"),
        ({"K0": np.ones(6)}, "K0", "has shape (6,)"),
        ({"M0": eye(5)}, "M0", "has shape (5, 5)"),
        ({"M0": np.diag([1.0, 1, 1, 1, -0.2, 1])}, "M0", "row 4 has a negative mass (-0.2)"),
        ({"K0": np.zeros((0, 0))}, "K0", "is empty"),
        ({"K_k": np.zeros((6, 6))}, "K_k", "is zero: the parameter 'k' has no effect"),
        ({"K0": eye(), "M0": 1e4 * chain()["K0"], "K_k": chain()["M_m"], "M_m": chain()["K_k"]}, "K0",
         "are K0 and M0 exchanged"),
        ({"K_k": None}, "K_k", "neither this matrix nor its M_"),
        ({"K_other": eye()}, "K_other", "no parameter is named 'other'"),
        ({"channel": np.array(["a", "a"])}, "channel", "'a' is listed twice"),
        ({"channel_dof": np.array([0, 6])}, "channel_dof", "row 6 is outside 0..5"),
        ({"channel_dof": np.array([0])}, "channel_dof", "of shape (1,)"),
        ({"channel_row": np.ones((2, 6))}, "channel_row", "stands beside channel_dof"),
        ({"channel_dof": None, "channel_row": np.ones((2, 5))}, "channel_row", "has shape (2, 5)"),
        ({"channel_dof": None, "channel_row": np.eye(2, 6) * [[1.0], [0.0]]}, "channel_row", "reads no degree"),
        ({"channel_dof": None, "channel_row_data": np.ones(2)}, "channel_row_indices", "is missing"),
        ({"channel_dof": np.array([0.0, 1.0])}, "channel_dof", "whole numbers"),
        ({"channel": None}, "channel", "is missing"),
        ({"channel_sign": np.array([1, 2])}, "channel_sign", "not a +1 or -1"),
        ({"node_position_m": np.zeros((6, 3))}, "dof_node", "is missing"),
        ({"node_position_m": np.zeros((6, 3)), "dof_node": np.arange(6), "dof_direction": np.zeros(6, int)},
         "node_position_m", "has all 6 nodes at one place"),
        ({"node_position_m": np.zeros((6, 2)), "dof_node": np.zeros(6, int), "dof_direction": np.zeros(6, int)},
         "node_position_m", "has shape (6, 2)"),
        ({"node_position_m": np.zeros((6, 3)), "dof_node": np.zeros(5, int), "dof_direction": np.zeros(6, int)},
         "dof_node", "one number for each of the 6 rows of K0"),
        ({"node_position_m": np.zeros((6, 3)), "dof_node": np.zeros(6, int), "dof_direction": np.full(6, 9)},
         "dof_direction", "9 is none"),
        ({"K0": None, "K0_data": np.ones(2), "K0_indices": np.array([0, 9]), "K0_indptr": np.array([0, 1, 2])},
         "K0", "_indices do not fit"),
        ({"M0": None, "M0_data": np.ones(2), "M0_indices": np.array([0, 1]), "M0_indptr": np.array([0, 1, 2])},
         "M0", "has 2 rows, K0 has 6"),
    ],
)
def test_mistakes_name_file_and_key(folder, changes, key, problem):
    path = save(folder, **changes)
    with pytest.raises(InputError) as caught:
        load_model(path)
    text = str(caught.value)
    assert text.startswith(f"{path}, {key}: ") and "\n" not in text
    assert problem in text


@pytest.mark.parametrize("sparsely", [False, True])
def test_two_parameters_of_one_effect_are_refused(folder, sparsely):
    """Of the same stiffness, unless a mass distinguishes them; springs in parallel of other stiffness are two."""
    (folder / "parameters.toml").write_text(TABLE.replace('"m"', '"other"'))
    own = chain()["K_k"]
    csr = sparse.csr_array(own)
    same = {"K_other": own} if not sparsely else {
        "K_other_data": csr.data, "K_other_indices": csr.indices, "K_other_indptr": csr.indptr}
    with pytest.raises(InputError, match=r"K_other: is the matrix of 'k' too: no measurement distinguishes 'k' from"):
        load_model(save(folder, M_m=None, **same))
    assert load_model(save(folder, M_m=None, M_other=chain()["M_m"], **same))
    assert load_model(save(folder, M_m=None, K_other=0.5 * own))


def test_two_channels_may_read_one_degree_of_freedom(folder):
    """Two sensors at one place."""
    assert load_model(save(folder, channel_dof=np.array([5, 5]))).channels == ("a", "b")


def test_indefinite_matrices_name_the_values(folder):
    model = load_model(save(folder, K0=chain()["K0"] - 60 * np.eye(6)))
    with pytest.raises(InputError, match=r"at k=0\.1, m=0: the stiffness matrix is not positive definite"):
        model.solve(model.parameters.initial, 2)


def test_files_that_hold_no_matrices(folder):
    broken = folder / "broken.npz"
    broken.write_bytes(b"nothing")
    (folder / "broken.toml").write_text(TABLE)
    with pytest.raises(InputError, match=r"broken\.npz: not a plain \.npz archive"):
        load_model(broken)
    with pytest.raises(InputError, match=r"gone\.npz: no such file"):
        load_model(folder / "gone.npz")
    np.savez(folder / "model.npz", **(chain() | {"K0": np.array([{}], dtype=object)}))
    with pytest.raises(InputError, match=r"model\.npz, K0\.npy: holds objects"):
        load_model(folder / "model.npz")


def test_parameters_given_as_the_model_are_no_model(folder):
    save(folder)
    with pytest.raises(InputError, match="states parameters and no model; give the model that they are of"):
        load_model(folder / "parameters.toml")


def test_a_folder_is_asked_about_the_model_in_it(folder):
    save(folder)
    with pytest.raises(InputError, match=r"is a directory, not a model's file; did you mean '.*model\.npz'\?"):
        load_model(folder)
    (folder / "model.npz").rename(folder / "bridge.npz")
    with pytest.raises(InputError, match=r"did you mean '.*bridge\.npz'\?"):
        load_model(folder)
    (folder / "model.toml").write_text("")
    with pytest.raises(InputError, match=r"did you mean '.*model\.toml'\?"):
        load_model(folder)
    for path in folder.glob("[bm]*"):
        path.unlink()
    with pytest.raises(InputError, match="is a directory, not a model's file; a model is a model.toml"):
        load_model(folder)


def test_parameters_must_be_known(tmp_path):
    path = save(tmp_path)
    with pytest.raises(InputError, match=r"its parameters are not known; write parameters\.toml beside it"):
        load_model(path)
    (tmp_path / "own.toml").write_text(TABLE)
    assert load_model(path, parameters=tmp_path / "own.toml").parameters.names == ("k", "m")


def test_matrices_named_in_a_model_file(folder):
    save(folder)
    file = folder / "bridge.toml"
    file.write_text('name = "bridge"\n[matrices]\nfile = "model.npz"\n' + TABLE)
    model = load_model(file)
    assert model.name == "bridge" and model.parameters.names == ("k", "m")
    for text, problem in (
        ('[matrices]\nfile = "../model.npz"\n', "leaves the folder"),
        ('[matrices]\nfile = 3\n', "not a table with the one key 'file'"),
        ('[matrices]\nfile = "model.npz"\n[site]\n', "is not a key of a model of matrices"),
        ('[matrices]\nfile = "model.npz"\n', "parameter: there is none"),
    ):
        file.write_text(text + (TABLE if "none" not in problem else ""))
        with pytest.raises(InputError, match=problem):
            load_model(file)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('name = "k"', 'nam = "k"', r"unknown key 'nam'; did you mean 'name'"),
        ("initial = 0.1\n", "", "'initial' is missing"),
        ("std = 0.2", 'std = "0.2"', "std: '0.2' is not a number"),
        ("std = 0.2", "std = 0.2\ncov = 0.1", "needs exactly one of 'cov' and 'std'"),
        ("std = 0.1", "cov = 0.1", "'cov' is undefined for an initial value of zero"),
        ("std = 0.2", "std = -0.2", "standard deviation -0.2 is not positive"),
        ("upper = 1.0", "upper = -1.0", "are empty"),
        ("initial = 0.1", "initial = 7.0", "is outside"),
        ('name = "m"', 'name = "k"', "k listed twice"),
        ("[[parameter]]", "[[parameters]]", "unknown key 'parameters'"),
    ],
)
def test_mistakes_in_a_parameter_table(tmp_path, old, new, problem):
    path = tmp_path / "parameters.toml"
    path.write_text(TABLE.replace(old, new))
    with pytest.raises(InputError, match=problem):
        read_parameters(path)


def test_correlation_table(tmp_path):
    path = tmp_path / "parameters.toml"
    path.write_text(TABLE + "[correlation.k]\nm = 0.4\n")
    assert read_parameters(path).correlation == pytest.approx(np.array([[1, 0.4], [0.4, 1]]))
    path.write_text(TABLE + "[correlation.k]\nq = 0.4\n")
    with pytest.raises(InputError, match="'q' is not an updated parameter"):
        read_parameters(path)


def test_a_correlation_that_is_stated_twice_is_one_value(tmp_path):
    path = tmp_path / "parameters.toml"
    path.write_text(TABLE + "[correlation.k]\nm = 0.4\n[correlation.m]\nk = 0.4\n")
    assert read_parameters(path).correlation[0, 1] == 0.4
    for second, problem in (("[correlation.m]\nk = 0.3\n", r"is 0.3, and \[correlation.k\] says 0.4"),
                            ("[correlation.m]\nm = 0.5\n", "is 0.5, and a parameter correlates with itself by 1")):
        path.write_text(TABLE + "[correlation.k]\nm = 0.4\n" + second)
        with pytest.raises(InputError, match=problem):
            read_parameters(path)


@pytest.mark.parametrize("changed", ["K0", "M0", "K_k", "M_m", "channel", "channel_dof"])
def test_fingerprint_changes_with_every_array(folder, changed):
    base = load_model(save(folder)).fingerprint()
    assert load_model(save(folder)).fingerprint() == base
    value = chain()[changed]
    other = np.array(["a", "c"]) if changed == "channel" else value[::-1] if changed == "channel_dof" else value * 1.01
    assert load_model(save(folder, **{changed: other})).fingerprint() != base


@pytest.mark.skipif(not BRIDGE.exists(), reason="the pedestrian bridge's data are not beside the repository")
def test_pedestrian_bridge_loads_solves_and_differentiates(validation):
    row = validation(what="footbridge's matrices: derivatives add up; one of them",
                     reference="half the frequency; differences", why="eigensolver; differences")
    parameters = read_parameters(REPOSITORY / "studies" / "footbridge" / "parameters.toml")
    model = load_matrices(BRIDGE / "model.npz", parameters)
    assert model.n_dof == 946 and len(model.channels) == 58 and len(parameters) == 17
    theta = parameters.initial
    solution = model.solve(theta, 8, derivatives=True)
    measured = json.loads((BRIDGE / "modes.json").read_text())["sets"][0]["frequency_hz"]
    # the design model is within a fifth of every measured frequency
    for frequency in measured:
        assert np.abs(solution.frequency_hz / frequency - 1).min() < 0.2
    # K0 is the sum of the 17 substructures: the derivatives add up to half the frequency
    row.error(2 * solution.frequency_derivative.sum(axis=1) / solution.frequency_hz - 1, below=1e-7, of="sum")
    k, h = parameters.index("Conc6"), 1e-3
    step = h * np.eye(17)[k]
    plus, minus = (model.solve(theta + sign * step, 8).frequency_hz for sign in (1, -1))
    difference = (plus - minus) / (2 * h)
    row.error((solution.frequency_derivative[:, k] - difference) / (np.abs(difference) + 0.01), below=1e-4, of="one")


def pendulums(theta):
    """Two springs in a row: closed form of a model that is a function."""
    k = np.array([[1 + theta[0], -theta[0]], [-theta[0], theta[0] + theta[1]]])
    value, shape = np.linalg.eigh(k)
    return np.sqrt(value) / (2 * np.pi), shape


def function_model(**kwargs):
    items = (Parameter(name="a", unit="-", initial=1.0, std=0.2, lower=0.1, upper=3.0),
             Parameter(name="b", unit="-", initial=2.0, std=0.2, lower=0.1, upper=2.0))
    return FunctionModel(**({"name": "springs", "parameters": Parameters(items), "channels": ("x", "y"),
                             "function": pendulums, "version": "1"} | kwargs))


def test_function_as_a_model():
    model = function_model()
    theta = np.array([1.2, 1.1])
    solution = model.solve(theta, 2, derivatives=True)
    assert solution.frequency_hz == pytest.approx(pendulums(theta)[0])
    for k, direction in enumerate(([[1, -1], [-1, 1]], [[0, 0], [0, 1]])):
        _, phi = pendulums(theta)
        exact = np.einsum("ij,ik,kj->j", phi, np.array(direction, float), phi)
        assert solution.frequency_derivative[:, k] * 8 * np.pi**2 * solution.frequency_hz == pytest.approx(
            exact, rel=1e-6)
    # at the bound of b the difference is one-sided and stays inside
    assert np.all(np.isfinite(model.solve(model.parameters.initial, 2, derivatives=True).frequency_derivative))
    many = model.solve_many(np.array([[1.0, 2.0], [1.2, 1.1]]), 2)
    assert many.frequency_hz[1] == pytest.approx(solution.frequency_hz)
    assert model.fingerprint() != function_model(version="2").fingerprint()
    assert model.wireframe(theta) is None


@pytest.mark.parametrize(
    ("function", "problem"),
    [(lambda theta: (np.ones(3), np.ones((3, 3))), "frequencies (3,) and shapes (3, 3)"),
     (lambda theta: (np.ones(1), np.ones((2, 1))), "give at least 2 modes at 2 channels"),
     (lambda theta: (np.array([1.0, np.nan]), np.ones((2, 2))), "not finite")],
)
def test_functions_that_answer_wrongly(function, problem):
    with pytest.raises(InputError) as caught:
        function_model(function=function).solve(np.array([1.0, 1.0]), 2)
    assert str(caught.value).startswith("springs: ") and problem in str(caught.value)


def csr_model(folder, **changed):
    """model.npz with K0 in CSR parts of which some are changed."""
    content = chain()
    K0 = sparse.csr_array(content.pop("K0"))
    parts = {"K0_data": K0.data, "K0_indices": K0.indices, "K0_indptr": K0.indptr} | changed
    np.savez(folder / "model.npz", **(content | parts))
    (folder / "model.toml").write_text(TABLE)
    return folder / "model.npz"


@pytest.mark.parametrize("name, change", [
    ("indptr", lambda a: np.where(np.arange(len(a)) == 2, 1, a)),  # falls
    ("indptr", lambda a: np.where(np.arange(len(a)) == len(a) - 1, a[-1] + 10, a)),  # beyond the entries
    ("indptr", lambda a: a - 1),
    ("indptr", lambda a: np.where(np.arange(len(a)) == 1, 2**40, a)),
    ("indptr", lambda a: a[:, None]),
    ("indptr", lambda a: a.astype(float)),
    ("indices", lambda a: np.where(np.arange(len(a)) == 1, 99, a)),
    ("indices", lambda a: np.where(np.arange(len(a)) == 1, -1, a)),
    ("indices", lambda a: a[:-1]),
    ("data", lambda a: a[:, None]),
    ("data", lambda a: a[:-1]),
    ("data", lambda a: np.where(np.arange(len(a)) == 1, np.nan, a)),
])
def test_csr_parts_that_do_not_fit_never_reach_scipy(tmp_path, name, change):
    K0 = sparse.csr_array(chain()["K0"])
    load_model(csr_model(tmp_path))
    with pytest.raises(InputError, match=r"model\.npz, K0"):
        load_model(csr_model(tmp_path, **{f"K0_{name}": change(getattr(K0, name))}))


def test_an_archive_that_unpacks_to_more_than_memory_is_refused(tmp_path):
    path = csr_model(tmp_path)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("K_k2.npy", "w") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (2**20,)})
        stream.write(bytes(2**23))
    assert path.stat().st_size < 20_000
    with pytest.raises(InputError, match=r"model\.npz: holds 8 MB unpacked, more than 4 MB"):
        archive_arrays(path, "is not a model", "write it again", largest=2**22)


def test_an_array_of_which_the_head_promises_more_than_there_is(tmp_path):
    path = csr_model(tmp_path)
    with zipfile.ZipFile(path, "a") as archive, archive.open("K_k2.npy", "w") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**9,)})
    with pytest.raises(InputError, match=r"K_k2\.npy: holds objects, or another number of values"):
        load_model(path)


def test_parameters_of_a_later_format_are_refused(tmp_path):
    path = tmp_path / "parameters.toml"
    path.write_text('format = 99\n[[parameter]]\nname = "a"\nunit = "-"\ninitial = 1.0\nstd = 0.1\n')
    with pytest.raises(InputError, match=r"parameters\.toml, format: is 99; this version reads 1"):
        read_parameters(path)


HELD = TABLE.replace('std = 0.2\n', 'std = 0.2\nupdate = false\n', 1)


def test_a_parameter_that_is_held_stays_at_its_value(folder):
    """K_k and M_m by hand: the held one is part of K0."""
    free = load_model(save(folder))
    (folder / "parameters.toml").write_text(HELD)
    held = load_model(save(folder))
    assert held.parameters.names == ("m",)
    for m in (0.0, 0.3):
        expected, found = free.solve(np.array([0.1, m]), 3), held.solve(np.array([m]), 3)
        np.testing.assert_allclose(found.frequency_hz, expected.frequency_hz, rtol=1e-12)


def test_a_matrix_without_parameter_says_how_to_hold_it(folder):
    (folder / "parameters.toml").write_text(TABLE.replace('name = "k"', 'name = "m2"'))
    with pytest.raises(InputError, match="update = false holds it"):
        load_model(save(folder, M_m2=chain()["M_m"] + np.diag([1.0, 0, 0, 0, 0, 0])))


def test_a_drawn_jacket_with_y_upwards_is_asked_about_and_the_remedy_holds(tmp_path):
    structures.draw("matrices jacket", 6, designed=True).write(tmp_path)
    upright = dict(np.load(tmp_path / "model.npz"))
    lying = upright | {"node_position_m": upright["node_position_m"][:, [1, 2, 0]],
                       "dof_direction": np.array([2, 0, 1, 5, 3, 4])[upright["dof_direction"]]}
    mended = lying | {"node_position_m": lying["node_position_m"][:, [2, 0, 1]],
                      "dof_direction": np.array([1, 2, 0, 4, 5, 3])[lying["dof_direction"]]}
    asked = {}
    for name, arrays in (("upright", upright), ("lying", lying), ("mended", mended)):
        np.savez(tmp_path / "model.npz", **arrays)
        found = probupdate.modes(tmp_path / "model.npz", count=4)
        asked[name] = (found.labels[:2], any("is y upwards" in note for note in found.notes))
    assert asked["upright"] == asked["mended"] == (("X1", "Y1"), False) and asked["lying"][1]


def columns(bays, width):
    """A frame of two columns of bays of 4 m whose feet are held by springs, z upwards: rows x, y, z of each node."""
    n = 2 * bays + 2
    place = np.array([[x, 0.0, 4.0 * k] for k in range(bays + 1) for x in (0.0, width)])
    rods = [(k, k + 2) for k in range(n - 2)] + [(k, k + 1) for k in range(2, n, 2)] + [
        (k, k + 3) for k in range(0, n - 2, 2)]
    K = np.zeros((3 * n, 3 * n))
    for a, b in rods:
        along = (place[b] - place[a]) / np.linalg.norm(place[b] - place[a])
        # a tenth of a rod's stiffness across it, so that the plane frame stands
        K += np.kron(np.outer(np.eye(n)[a] - np.eye(n)[b], np.eye(n)[a] - np.eye(n)[b]),
                     1e7 * (np.outer(along, along) + 0.1 * np.eye(3)))
    K[range(6), range(6)] += 1e9
    return {"K_k": K, "K0": 0 * K, "M0": 500 * np.eye(3 * n), "node_position_m": place,
            "dof_node": np.repeat(range(n), 3), "dof_direction": np.tile(range(3), n), "channel": ["a", "b", "c"],
            "channel_dof": [3 * n - 12, 3 * n - 6, 3 * n - 5]}


@pytest.mark.parametrize("upright", [True, False], ids=["z upwards", "y upwards"])
@pytest.mark.parametrize(("bays", "width"), [(3, 3.0), (6, 9.0)])
def test_update_and_diagnose_ask_whether_y_is_upwards(tmp_path, bays, width, upright):
    path, arrays = tmp_path / "model.npz", columns(bays, width)
    (tmp_path / "parameters.toml").write_text(
        '[[parameter]]\nname = "k"\nunit = "-"\ninitial = 1.0\nstd = 0.1\nlower = 0.5\nupper = 1.5\n')
    if not upright:
        arrays |= {"node_position_m": arrays["node_position_m"][:, [1, 2, 0]],
                   "dof_direction": np.array([2, 0, 1])[arrays["dof_direction"]]}
    np.savez(path, **arrays)
    model = load_model(path)
    own = model.solve(model.parameters.initial, 3)
    sets = [ModalSet(id=f"2026-01-{day:02d}T00:00Z", damping_ratio=np.full(3, 0.01), shape=own.shape,
                     frequency_hz=own.frequency_hz * (1 + 1e-3 * np.sin(7 * day + np.arange(3))),
                     frequency_std_hz=1e-3 * own.frequency_hz, shape_std=np.full(own.shape.shape, 0.01))
            for day in (1, 2, 3)]
    data = ModalData(channels=model.channels, sets=tuple(sets))
    assert ("is y upwards" in probupdate.update(path, data).settings["gravity"]) == (not upright)
    notes = probupdate.diagnose(path, data, extend=False).notes
    assert any("is y upwards" in note for note in notes) == (not upright)
