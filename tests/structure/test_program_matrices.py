"""`matrices`: what programs leave in their own form is corrected, what cannot be right is refused, frequencies stay."""

import importlib.util
import shutil
import subprocess

import numpy as np
import pytest
import scipy.io
from scipy import sparse
from scipy.linalg import eigh

import probupdate
from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.modal.shape_criteria import mac
from probupdate.structure.load import load_model

N, SPRING, MASS = 8, 2.0e7, 3.0e3


def chain(factor=1.0, upper_mass=1.0):
    """A chain of springs and masses, held at one end, its upper half's springs scaled; its frequencies are known."""
    k = np.where(np.arange(N) >= N // 2, factor, 1.0) * SPRING
    after = np.append(k[1:], 0.0)
    K = np.diag(k + after) - np.diag(after[:-1], 1) - np.diag(after[:-1], -1)
    return K, np.diag(np.where(np.arange(N) >= N // 2, upper_mass, 1.0) * MASS)


def frequencies(K, M):
    return np.sqrt(eigh(K, M, eigvals_only=True)) / (2 * np.pi)


def calculix_files(folder, name, K, M, *, nodes=None):
    """What CalculiX writes: upper triangles from 1, and node and direction of each row."""
    for ending, matrix in ((".sti", K), (".mas", M)):
        own = sparse.coo_array(np.triu(matrix))
        (folder / f"{name}{ending}").write_text("".join(
            f"{i + 1} {j + 1} {v:.15e}\n" for i, j, v in zip(*own.coords, own.data, strict=True)))
    (folder / f"{name}.dof").write_text("".join(f"{n}.1\n" for n in nodes or range(2, N + 2)))
    (folder / f"{name}.inp").write_text(
        "*NODE, NSET=ALL\n" + "".join(f"{n}, {float(n - 1)}, 0., 0.\n" for n in range(1, N + 2)))


GROUPS = """[[channel]]
name = "tip"
node = 9
direction = "-x"
[[parameter]]
name = "upper"
cov = 0.1
lower = 0.2
upper = 3.0
runs = [{ file = "more.sti", value = 1.5 }, { file = "less.sti", value = 0.8 }]
"""


def test_parameters_by_differences_hold_at_other_values(tmp_path):
    for name, factor in (("job", 1.0), ("more", 1.5), ("less", 0.8)):
        calculix_files(tmp_path, name, *chain(factor))
    (tmp_path / "groups.toml").write_text(GROUPS)
    result = probupdate.matrices(tmp_path / "job.sti", tmp_path / "run" / "model.npz",
                                 parameters=tmp_path / "groups.toml")
    assert result.parameters == ("upper",) and not any("linear was not checked" in n for n in result.notes)
    model = load_model(tmp_path / "run" / "model.npz")
    for factor in (0.5, 2.2):
        found = model.solve(np.array([factor]), 4)
        np.testing.assert_allclose(found.frequency_hz, frequencies(*chain(factor))[:4], rtol=1e-9)
        # the sensor reads against x: its sign is turned in every mode alike
        assert model.channels == ("tip",) and found.shape.shape == (1, 4)


def test_a_group_that_is_not_linear_is_refused(tmp_path):
    for name, factor in (("job", 1.0), ("more", 1.5**3), ("less", 0.8**3)):
        calculix_files(tmp_path, name, *chain(factor))
    (tmp_path / "groups.toml").write_text(GROUPS)
    with pytest.raises(InputError, match="not linear in it"):
        probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")


def test_a_run_at_the_initial_value_names_the_file_that_has_it(tmp_path):
    for name, factor in (("job", 1.0), ("more", 1.5), ("less", 0.8)):
        calculix_files(tmp_path, name, *chain(factor))
    (tmp_path / "groups.toml").write_text(GROUPS.replace('"less.sti", value = 0.8', '"job.sti", value = 1.0'))
    with pytest.raises(InputError, match=r"'job.sti' is of the initial value 1, which the file on the command line"):
        probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")


def written(folder, form, K, M):
    """Files of a form, as scipy, numpy or a few lines write them."""
    def triangle(matrix):
        return sparse.coo_array(np.tril(matrix))

    if form == "market":
        scipy.io.mmwrite(folder / "K.mtx", triangle(K), symmetry="general")
        scipy.io.mmwrite(folder / "M.mtx", triangle(M), symmetry="general")
        return [folder / "K.mtx"]
    if form == "abaqus":
        for name, matrix in (("job_STIF1", K), ("job_MASS1", M)):
            own = triangle(matrix)
            (folder / f"{name}.mtx").write_text("".join(
                f"{i + 2},1,{j + 2},1,{v:.15e}\n" for i, j, v in zip(*own.coords, own.data, strict=True)))
        return [folder / "job_STIF1.mtx"]
    if form == "matlab":
        scipy.io.savemat(folder / "both.mat", {"K": K, "M": M})
        return [folder / "both.mat"]
    if form == "boeing":
        scipy.io.hb_write(folder / "stiffness.rb", sparse.csc_array(K))
        scipy.io.hb_write(folder / "mass.rb", sparse.csc_array(M))
        return [folder / "stiffness.rb", folder / "mass.rb"]
    assert form == "punch"
    lines = []
    for name, matrix in (("KAA", K), ("MAA", M)):
        lines.append(f"DMIG    {name:<8}{0:>8}{6:>8}{2:>8}{0:>8}")
        for j in range(N):
            lines.append(f"DMIG*   {name:<16}{j + 2:>16}{1:>16}")
            lines += [f"*       {i + 2:>16}{1:>16}{matrix[i, j]:>16.9E}".replace("E", "D")
                      for i in range(j, N) if matrix[i, j]]
    (folder / "both.pch").write_text("\n".join(lines) + "\n")
    return [folder / "both.pch"]


@pytest.mark.parametrize("form", ["market", "abaqus", "matlab", "boeing", "punch"])
def test_every_form_gives_the_programs_frequencies(tmp_path, form, validation):
    K, M = chain(1.3)
    result = probupdate.matrices(written(tmp_path, form, K, M), tmp_path / "out" / "model.npz")
    validation(what="matrices from files of five forms, eight springs and masses",
               reference="dense solution of the chain", why="digits in the file").error(
        np.max(np.abs(result.frequency_hz / frequencies(K, M)[: len(result.frequency_hz)] - 1)), below=1e-8)


@pytest.mark.parametrize(("factor", "said"), [(1, ""), (1000, "they are to be in m; set unit_of_length_m"),
                                             (0.001, "a thousandth of m?")])
def test_places_in_another_unit_are_asked_about(tmp_path, factor, said):
    """The frequencies are right, so that they alone show nothing."""
    calculix_files(tmp_path, "job", *chain())
    nodes = "".join(f"{n}, {factor * (n - 1.0)}, 0., 0.\n" for n in range(1, N + 2))
    (tmp_path / "job.inp").write_text(f"*NODE, NSET=ALL\n{nodes}")
    notes = probupdate.matrices(tmp_path / "job.sti", tmp_path / "out" / "model.npz").notes
    odd = [note for note in notes if note.startswith("implausible")]
    assert len(odd) == bool(said) and all(said in note for note in odd)


@pytest.mark.parametrize("form", ["deck", "npz"])
def test_places_are_written_in_metres_where_the_unit_is_stated(tmp_path, form):
    calculix_files(tmp_path, "job", *chain())
    nodes = "".join(f"{n}, {1000 * (n - 1.0)}, 0., 0.\n" for n in range(1, N + 2))
    (tmp_path / "job.inp").write_text(f"*NODE, NSET=ALL\n{nodes}")
    (tmp_path / "groups.toml").write_text("unit_of_length_m = 0.001\n")
    source, unit = tmp_path / "job.sti", tmp_path / "groups.toml"
    if form == "npz":
        probupdate.matrices(source, tmp_path / "mm" / "model.npz")
        source = tmp_path / "mm" / "model.npz"
    notes = probupdate.matrices(source, tmp_path / "m" / "model.npz", parameters=unit).notes
    assert not any(note.startswith("implausible") for note in notes)
    with np.load(tmp_path / "m" / "model.npz") as written:
        assert np.ptp(written["node_position_m"][:, 0]) == pytest.approx(N - 1)
    # matrices alone have no places to scale
    np.savez(tmp_path / "km.npz", **dict(zip("KM", chain(), strict=True)))
    with pytest.raises(InputError, match="there are no nodes' places"):
        probupdate.matrices(tmp_path / "km.npz", tmp_path / "none" / "model.npz", parameters=unit)


def test_held_rows_of_zeros_and_of_penalties_are_left_out(tmp_path):
    K, M = chain()
    grown = np.zeros((N + 2, N + 2))
    grown[:N, :N], grown[N, N] = K, 1e30
    mass = np.zeros((N + 2, N + 2))
    mass[:N, :N] = M
    np.savez(tmp_path / "km.npz", K=grown, M=mass)
    result = probupdate.matrices(tmp_path / "km.npz", tmp_path / "out" / "model.npz")
    assert result.n_row == N and sum("left out" in note for note in result.notes) == 2
    np.testing.assert_allclose(result.frequency_hz, frequencies(K, M)[: len(result.frequency_hz)], rtol=1e-9)


def test_rows_without_mass_follow_statically(tmp_path):
    K, M = chain()
    M[3, 3] = 0.0
    np.savez(tmp_path / "km.npz", K=K, M=M)
    result = probupdate.matrices(tmp_path / "km.npz", tmp_path / "out" / "model.npz")
    free = np.delete(np.arange(N), 3)
    condensed = K[np.ix_(free, free)] - np.outer(K[free, 3], K[3, free]) / K[3, 3]
    np.testing.assert_allclose(result.frequency_hz[:5], frequencies(condensed, M[np.ix_(free, free)])[:5], rtol=1e-9)
    assert any("no mass" in note for note in result.notes)


@pytest.mark.parametrize(("change", "words"), [
    (lambda K, M: (K + np.diag(np.full(N - 1, 1e5), 1), M), "is not symmetric"),
    (lambda K, M: (np.where(K[0, 0] == K, np.nan, K), M), "is not a number"),
    (lambda K, M: (K[:-1, :-1], M), "rows"),
], ids=["unsymmetric", "not a number", "sizes"])
def test_matrices_that_cannot_be_right_are_refused(tmp_path, capsys, change, words):
    K, M = change(*chain())
    np.savez(tmp_path / "km.npz", K=K, M=M)
    assert main(["matrices", str(tmp_path / "km.npz"), "--out", str(tmp_path / "model.npz")]) == 2
    assert words in capsys.readouterr().err and not (tmp_path / "model.npz").exists()


def test_frequencies_that_the_program_printed_are_held_against(tmp_path):
    K, M = chain()
    calculix_files(tmp_path, "job", K, M)
    (tmp_path / "groups.toml").write_text(f"[check]\nfrequencies_hz = {(1.1 * frequencies(K, M)[:3]).tolist()}\n")
    with pytest.raises(InputError, match="as the program printed it"):
        probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")


def test_a_channel_at_a_held_node_says_what_is_free(tmp_path):
    calculix_files(tmp_path, "job", *chain())
    (tmp_path / "groups.toml").write_text('[[channel]]\nname = "a"\nnode = 9\ndirection = "y"\n')
    with pytest.raises(InputError, match=r"no free row along y; free there: x"):
        probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")


@pytest.mark.parametrize(("node", "words"), [
    (1, "node 1 has no free row: it is held"), (999, "the model has no node 999; correct node; .* 2 to 9")])
def test_a_channel_at_no_row_tells_a_held_node_from_none(tmp_path, node, words):
    calculix_files(tmp_path, "job", *chain())
    (tmp_path / "groups.toml").write_text(f'[[channel]]\nname = "a"\nnode = {node}\ndirection = "x"\n')
    with pytest.raises(InputError, match=words):
        probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")


def test_a_live_model_of_opensees_keeps_its_frequencies(tmp_path, ops):
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for k in range(6):
        ops.node(k + 1, 0.0, 2.0 * k)
        if k:
            ops.mass(k + 1, 500.0, 500.0, 50.0)
    ops.fix(1, 1, 1, 1)
    ops.geomTransf("Linear", 1)
    for k in range(5):
        ops.element("elasticBeamColumn", k + 1, k + 1, k + 2, 0.01, 2.1e11, 8e-6, 1)
    expected = np.sqrt(np.array(ops.eigen("-fullGenLapack", 6))) / (2 * np.pi)
    result = probupdate.matrices.from_opensees(tmp_path / "model.npz", ops=ops)
    np.testing.assert_allclose(result.frequency_hz[:6], expected, rtol=1e-8)
    assert set(result.channels) <= {f"{n}-{d}" for n in range(2, 7) for d in "xz"}


def model_of_opensees(ops, path, *, soft=1.0, heavy=1.0, groups=None):
    """A plane tower whose upper elements' stiffness and all masses are scaled, and its frequencies by OpenSees."""
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for k in range(7):
        ops.node(10 * k + 10, 0.0, 2.0 * k)
        if k:
            ops.mass(10 * k + 10, 500.0 * heavy, 500.0 * heavy, 50.0 * heavy)
    ops.fix(10, 1, 1, 1)
    ops.geomTransf("Linear", 1)
    for k in range(6):
        ops.element("elasticBeamColumn", k + 1, 10 * k + 10, 10 * k + 20, 0.01, 2.1e11 * (soft if k > 2 else 1.0), 8e-6,
                    1)
    known = np.sqrt(np.array(ops.eigen("-fullGenLapack", 5))) / (2 * np.pi)
    probupdate.matrices.from_opensees(path, ops=ops, groups=groups)
    return known


def test_models_of_one_folder_share_their_parameters(tmp_path, ops):
    for name in ("base", "more"):
        model_of_opensees(ops, tmp_path / f"{name}.npz")
    assert load_model(tmp_path / "more.npz").parameters.names == ("stiffness",)


def test_parameters_that_the_package_wrote_itself_give_way(tmp_path):
    """Base and runs lie in one folder with groups.toml, and the model may be written again."""
    calculix_files(tmp_path, "job", *chain())
    calculix_files(tmp_path, "more", *chain(1.5))
    for name in ("job", "more"):
        probupdate.matrices(tmp_path / f"{name}.sti", tmp_path / f"{name}.npz")
    (tmp_path / "groups.toml").write_text(
        GROUPS[GROUPS.index("[[parameter]]"):].split("runs")[0] + 'runs = [{ file = "more.npz", value = 1.5 }]\n')
    for again in (False, True):
        result = probupdate.matrices(tmp_path / "job.npz", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")
        assert any("replaced" in note for note in result.notes) is not again
        found = load_model(tmp_path / "model.npz").solve(np.array([2.2]), 4)
        np.testing.assert_allclose(found.frequency_hz, frequencies(*chain(2.2))[:4], rtol=1e-9)
        (tmp_path / "model.npz").unlink()


def test_a_run_that_is_not_there_yet_says_how_to_make_it(tmp_path):
    calculix_files(tmp_path, "job", *chain())
    (tmp_path / "groups.toml").write_text(
        GROUPS[GROUPS.index("[[parameter]]"):].split("runs")[0] + 'runs = [{ file = "more.sti", value = 1.5 }]\n')
    with pytest.raises(InputError) as error:
        probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")
    assert "its run more.sti does not exist" in str(error.value) and "to 1.5 in the program" in error.value.remedy
    calculix_files(tmp_path, "more", *chain(1.5))
    probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")


def test_parameters_that_somebody_edited_are_not_replaced(tmp_path):
    calculix_files(tmp_path, "job", *chain())
    calculix_files(tmp_path, "more", *chain(1.5))
    probupdate.matrices(tmp_path / "job.sti", tmp_path / "job.npz")
    table = tmp_path / "parameters.toml"
    table.write_text(table.read_text().replace("cov = 0.1", "cov = 0.2"))
    (tmp_path / "groups.toml").write_text(GROUPS.replace(', { file = "less.sti", value = 0.8 }', ""))
    with pytest.raises(InputError, match="with other parameters than model.npz would have"):
        probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz", parameters=tmp_path / "groups.toml")


def mast_of_opensees(ops, path, *, plane):
    """A mast of four pieces with a mass on an arm, from a plane model with y upwards, or from one in space that is held
    in its plane."""
    ops.wipe()
    ops.model("basic", "-ndm", 2 if plane else 3, "-ndf", 3 if plane else 6)
    places = [(0.0, 10.0 * k) for k in range(5)] + [(3.0, 40.0)]
    for k, (across, up) in enumerate(places, 1):
        ops.node(k, *((across, up) if plane else (across, 0.0, up)))
        if not plane:
            ops.fix(k, 0, 1, 0, 1, 0, 1)
        if k > 1:
            ops.mass(k, *((500.0, 500.0, 50.0) if plane else (500.0, 0.0, 500.0, 0.0, 50.0, 0.0)))
    ops.fix(1, *((1, 1, 1) if plane else (1, 0, 1, 0, 1, 0)))
    ops.geomTransf("Linear", 1, *(() if plane else (0.0, 1.0, 0.0)))
    for k in range(5):
        section = (0.01, 2.1e11, 8e-5) if plane else (0.01, 2.1e11, 8e10, 1e-5, 8e-5, 8e-5)
        ops.element("elasticBeamColumn", k + 1, k + 1, k + 2, *section, 1)
    groups = path.with_name("groups.toml")
    groups.write_text("".join(f'[[channel]]\nname = "{n}{d}"\nnode = {n}\ndirection = "{d}"\n'
                              for n in (3, 5, 6) for d in "xz"))
    probupdate.matrices.from_opensees(path, ops=ops, groups=groups)
    return load_model(path)


def test_a_plane_model_of_opensees_stands_upright(tmp_path, ops):
    """Names of modes, and what accelerometers feel of gravity as their place tilts, are those of the model in space."""
    flat, space = (mast_of_opensees(ops, tmp_path / f"{plane}.npz", plane=plane) for plane in (True, False))
    found, expected = (probupdate.model_modes(tmp_path / f"{plane}.npz", 4) for plane in (True, False))
    assert found.labels == expected.labels
    assert found.labels[:2] == ("X1", "X2")
    assert all(flat.gravity.known) and all(space.gravity.known)
    read = [m.solve(m.parameters.initial, 4).shape for m in (flat, space)]
    np.testing.assert_allclose(read[0] * np.sign(read[0][2]), read[1] * np.sign(read[1][2]), rtol=1e-7, atol=1e-9)


def test_nodes_of_a_deck_in_cylindrical_coordinates_are_where_they_are(tmp_path):
    calculix_files(tmp_path, "job", *chain())
    (tmp_path / "job.inp").write_text("*NODE, SYSTEM=C\n" + "".join(
        f"{n}, 2., {15.0 * n}, {3.0 * n}\n" for n in range(1, N + 2)) + "*Transform, nset=a\n1.,0.,0.,0.,1.,0.\n")
    result = probupdate.matrices(tmp_path / "job.sti", tmp_path / "model.npz")
    place = np.load(tmp_path / "model.npz")["node_position_m"]
    np.testing.assert_allclose(place, [(2 * np.cos(np.radians(15 * n)), 2 * np.sin(np.radians(15 * n)), 3 * n)
                                       for n in range(2, N + 2)], atol=1e-12)
    assert any("job.inp, line 11: *TRANSFORM is not read" in note for note in result.notes)


def storeys_of_opensees(ops):
    """Three storeys whose floors are rigid diaphragms about nodes 101 to 103, all mass there."""
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    ops.geomTransf("Linear", 1, 1.0, 0.2, 0.1)
    corners, section = [(0.0, 0.0), (8.0, 0.0), (8.0, 5.0), (0.0, 5.0)], (0.02, 2.1e11, 8e10, 4e-4, 3e-4, 2e-4)
    for k, (x, y) in enumerate(corners, 1):
        for level in range(4):
            ops.node(10 * level + k, x, y, 3.0 * level)
            if level:
                ops.element("elasticBeamColumn", 10 * level + k, 10 * level + k - 10, 10 * level + k, *section, 1)
        ops.fix(k, *[1] * 6)
    for level in (1, 2, 3):
        ops.node(100 + level, 4.5, 2.0, 3.0 * level)
        ops.fix(100 + level, 0, 0, 1, 1, 1, 0)
        ops.mass(100 + level, 4e4, 4e4, 0.0, 0.0, 0.0, 3.2e5)
        ops.rigidDiaphragm(3, 100 + level, *[10 * level + k for k in range(1, 5)])


def test_channels_of_a_diaphragm_of_opensees_read_its_own_motion(tmp_path, ops):
    storeys_of_opensees(ops)
    ops.eigen("-fullGenLapack", 3)
    expected = np.array([[ops.nodeEigenvector(node, j, d) for j in (1, 2, 3)] for node in (101, 103) for d in (1, 2)])
    groups = tmp_path / "groups.toml"
    groups.write_text("".join(f'[[channel]]\nname = "{node}{d}"\nnode = {node}\ndirection = "{d}"\n'
                              for node in (101, 103) for d in "xy"))
    probupdate.matrices.from_opensees(tmp_path / "model.npz", ops=ops, groups=groups)
    assert np.abs(expected[3, 0]) > np.abs(expected[2, 0])
    assert probupdate.model_modes(tmp_path / "model.npz", 3).labels == ("Y1", "X1", "T1")
    model = load_model(tmp_path / "model.npz")
    shape = model.solve(model.parameters.initial, 3).shape
    assert np.diag(mac(shape, expected)) == pytest.approx(1.0)
    groups.write_text('[[channel]]\nname = "corner"\nnode = 31\ndirection = "x"\n')
    with pytest.raises(InputError, match="node 31 has no free row along x; free there: z, rx, ry"):
        probupdate.matrices.from_opensees(tmp_path / "corner.npz", ops=ops, groups=groups)


@pytest.mark.parametrize("up", [1, 2])
def test_a_frame_with_y_upwards_is_asked_about(tmp_path, ops, up):
    ops.wipe()
    ops.model("basic", "-ndm", 3, "-ndf", 6)
    section = (0.01, 2.1e11, 8e10, 1e-5, 5e-5, 5e-5)
    corners = [(0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0)]
    ops.geomTransf("Linear", 1, 1.0, 0.3, 0.2)
    for k, (a, b) in enumerate(corners, 1):
        for level in (0, 1, 2):
            ops.node(10 * level + k, *((a, 3.0 * level, b) if up == 1 else (a, b, 3.0 * level)))
            if level:
                ops.mass(10 * level + k, *[2000.0] * 3, *[100.0] * 3)
                ops.element("elasticBeamColumn", 10 * level + k, 10 * level + k - 10, 10 * level + k, *section, 1)
        ops.fix(k, *[1] * 6)
    for level in (10, 20):
        for k in range(4):
            ops.element("elasticBeamColumn", 100 + level + k, level + k + 1, level + (k + 1) % 4 + 1, *section, 1)
    asked = any("is y upwards" in note for note in
                probupdate.matrices.from_opensees(tmp_path / "model.npz", ops=ops).notes)
    assert asked is (up == 1)


def test_elements_of_opensees_are_the_models_lines(tmp_path, ops):
    model_of_opensees(ops, tmp_path / "model.npz")
    wire = load_model(tmp_path / "model.npz").wire
    ends = wire.node_m[wire.line][:, :, 2]
    # the foot is held, and has no row
    assert sorted(map(tuple, ends.tolist())) == [(2.0 * k, 2.0 * k + 2.0) for k in range(1, 6)]


def test_opensees_with_massless_nodes_says_nothing_of_failure(tmp_path, ops, capfd):
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for k in range(4):
        ops.node(k + 1, 0.0, 2.0 * k)
    ops.mass(4, 500.0, 500.0, 0.0)
    ops.fix(1, 1, 1, 1)
    ops.geomTransf("Linear", 1)
    for k in range(3):
        ops.element("elasticBeamColumn", k + 1, k + 1, k + 2, 0.01, 2.1e11, 8e-6, 1)
    result = probupdate.matrices.from_opensees(tmp_path / "model.npz", ops=ops)
    # a cantilever with a mass at its tip
    assert result.frequency_hz[0] == pytest.approx(np.sqrt(3 * 2.1e11 * 8e-6 / 6.0**3 / 500.0) / (2 * np.pi), rel=1e-9)
    assert any("no mass" in note for note in result.notes) and "failed" not in "".join(capfd.readouterr())


RUNS_OF_MODELS = """[[parameter]]
name = "top"
cov = 0.1
lower = 0.2
upper = 3.0
runs = [{ file = "top/top.npz", value = 1.5 }]
[[parameter]]
name = "mass"
cov = 0.1
lower = 0.2
upper = 3.0
runs = [{ file = "mass/mass.npz", value = 1.2 }]
"""


@pytest.mark.parametrize("named", ["in each run", "with the parameters"])
def test_runs_of_opensees_are_parameters(tmp_path, ops, named):
    channel = '[[channel]]\nname = "tip"\nnode = 70\ndirection = "-x"\n'
    (tmp_path / "channels.toml").write_text(channel)
    of_runs = tmp_path / "channels.toml" if named == "in each run" else None
    for name, factors in (("base", {}), ("top", {"soft": 1.5}), ("mass", {"heavy": 1.2})):
        model_of_opensees(ops, tmp_path / name / f"{name}.npz", groups=of_runs, **factors)
    (tmp_path / "groups.toml").write_text(RUNS_OF_MODELS if of_runs else channel + RUNS_OF_MODELS)
    out = tmp_path / "run" / "model.npz"
    assert main(["matrices", str(tmp_path / "base" / "base.npz"), "--parameters", str(tmp_path / "groups.toml"),
                 "--out", str(out)]) == 0
    model = load_model(out)
    assert model.channels == ("tip",) and model.wire is not None
    known = model_of_opensees(ops, tmp_path / "other.npz", soft=0.6, heavy=1.7)
    found = model.solve(np.array([0.6, 1.7]), 5)
    np.testing.assert_allclose(found.frequency_hz, known, rtol=1e-8)


def test_a_model_is_read_at_the_initial_values(tmp_path):
    """Not at K0 alone, which is what parameters leave of it."""
    K, M = chain()
    upper = chain(2.0)[0] - K
    np.savez(tmp_path / "model.npz", K0=K - 1.5 * upper, M0=M, K_upper=upper, channel=["tip"], channel_dof=[N - 1])
    (tmp_path / "parameters.toml").write_text(
        '[[parameter]]\nname = "upper"\nunit = "-"\ninitial = 1.5\ncov = 0.1\nlower = 0.5\nupper = 2.0\n'
        'prior = "normal"\n')
    result = probupdate.matrices(tmp_path / "model.npz", tmp_path / "out" / "model.npz")
    assert result.channels == ("tip",)
    np.testing.assert_allclose(result.frequency_hz, frequencies(K, M)[: len(result.frequency_hz)], rtol=1e-9)


CANTILEVER = """*NODE, NSET=ALL
{nodes}
*ELEMENT, TYPE=B31, ELSET=E
{elements}
*MATERIAL, NAME=S
*ELASTIC
2.1e11, 0.3
*DENSITY
7850.
*BEAM SECTION, ELSET=E, MATERIAL=S, SECTION=RECT
0.3, 0.2
0, 1, 0
*BOUNDARY
1, 1, 6
*STEP
*FREQUENCY{solver}
6
*END STEP
"""


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is not installed")
def test_calculix_itself(tmp_path, validation):
    nodes = "\n".join(f"{k + 1}, {k}., 0., 0." for k in range(11))
    elements = "\n".join(f"{k + 1}, {k + 1}, {k + 2}" for k in range(10))
    for name, solver in (("printed", ""), ("job", ", SOLVER=MATRIXSTORAGE")):
        (tmp_path / f"{name}.inp").write_text(CANTILEVER.format(nodes=nodes, elements=elements, solver=solver))
        subprocess.run(["ccx", name], cwd=tmp_path, check=False, capture_output=True, timeout=60)
    shutil.copy(tmp_path / "printed.dat", tmp_path / "job.dat")
    result = probupdate.matrices(tmp_path / "job.sti", tmp_path / "out" / "model.npz")
    assert result.n_row == 216 and len(result.printed_hz) == 6
    validation(what="matrices of CalculiX' expanded beams (M singular, 30 nodes that the deck does not have)",
               reference="frequencies that ccx prints, where installed", why="printed digits").error(
        np.max(np.abs(result.frequency_hz[:6] / result.printed_hz - 1)), below=1e-6)


@pytest.mark.skipif(importlib.util.find_spec("ansys") is None, reason="ansys-mapdl-reader is not installed")
def test_a_full_file_of_ansys_is_read_whole(tmp_path):
    from ansys.mapdl.reader import examples

    result = probupdate.matrices(examples.fullfile, tmp_path / "model.npz")
    # unmirrored, or with held rows, it is 10 kHz and more
    assert result.frequency_hz[0] == pytest.approx(1283.2, rel=1e-4)


@pytest.mark.parametrize("triangle", [False, True], ids=["both halves", "one triangle"])
@pytest.mark.parametrize("files", [1, 2])
def test_op4_as_its_own_package_writes_it(tmp_path, files, triangle):
    op4 = pytest.importorskip("pyNastran.op4.op4", reason="pyNastran is not installed")
    K, M = chain()
    written = {"KGG": (6, sparse.coo_matrix(np.triu(K) if triangle else K)), "MGG": (6, sparse.coo_matrix(M))}
    named = [["KGG", "MGG"]] if files == 1 else [["KGG"], ["MGG"]]
    for k, names in enumerate(named):
        own = {n: written[n] for n in names}
        op4.OP4().write_op4(str(tmp_path / f"{k}.op4"), own, name_order=names, is_binary=False)
    source = tmp_path / "0.op4" if files == 1 else [tmp_path / "0.op4", tmp_path / "1.op4"]
    result = probupdate.matrices(source, tmp_path / "model.npz")
    # the package writes ten digits and more
    np.testing.assert_allclose(result.frequency_hz, frequencies(K, M)[: len(result.frequency_hz)], rtol=1e-9)


def test_op4_names_alike_in_eight_letters_are_refused(tmp_path):
    op4 = pytest.importorskip("pyNastran.op4.op4", reason="pyNastran is not installed")
    own = {"STIFFNESS1": (6, sparse.coo_matrix(chain()[0])), "STIFFNESS2": (6, sparse.coo_matrix(chain()[1]))}
    op4.OP4().write_op4(str(tmp_path / "both.op4"), own, name_order=list(own), is_binary=False)
    with pytest.raises(InputError, match="several matrices named 'STIFFNES'"):
        probupdate.matrices(tmp_path / "both.op4", tmp_path / "model.npz")
