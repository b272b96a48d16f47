"""`export --to lifetime`: every file is there, holds what it says, and a run that does not stand is refused."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse, stats

import probupdate
from probupdate.cli import main
from probupdate.diagnosis.wording import structural_changes
from probupdate.errors import InputError
from probupdate.io.subdyn_file import read_subdyn
from probupdate.lifetime.draws import equal_draws, joint_of
from probupdate.lifetime.export import ExportSettings, RunResults, export_lifetime, read_table
from probupdate.lifetime.model_files import with_initial
from probupdate.lifetime.superelement import frequencies, read_extptfm, superelement
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.structure.load import load_model
from probupdate.structure.subdyn_model import assembled_file
from probupdate.structure.subdyn_values import apply_values
from probupdate.updating.posterior_file import Posterior, write_posterior
from tests.subdyn_text import FRAME_GROUPS, FRAME_SENSORS, STEEL, subdyn

TOML = f"""name = "a frame"
[subdyn]
file = "structure.dat"
{FRAME_GROUPS}"""
ACTS = {"k": ("stiffness", "legs", "-", 1.0), "rho": ("density", "brace", "-", 1.0),
        "t": ("thickness", "legs", "-", 1.0), "loss": ("wall_loss", "brace", "m", 0.002),
        "m": ("mass", "top", "-", 1.0), "dm": ("added_mass", "deck", "kg", 300.0),
        "soil": ("soil_lateral", "soil", "-", 1.0)}


@pytest.fixture
def run(tmp_path):
    """A run directory with a small frame's model and a made-up posterior."""
    (tmp_path / "soil.txt").write_text("1e8 Kxx\n1e8 Kyy\n2e8 Kzz\n1e9 Ktxtx\n1e9 Ktyty\n1e8 Ktztz\n")
    (tmp_path / "structure.dat").write_text(subdyn(
        ["0 0 0", "4 0 0", "4 0 8", "0 0 8"], ["1 4 1 1 1c 0", "2 3 1 1 1c 0", "1 3 1 1 1c 0", "4 3 2 2 1c 0"],
        ["1 0 0 0 0 0 0 soil.txt", "2 1 1 1 1 1 1"], interface=[3, 4], div=2,
        circular=[f"1 {STEEL} 0.5 0.02", f"2 {STEEL} 0.3 0.01"], mass=["4 2e3 1e3 9e3 1e3 0 0 0 0.4 0 0"]))
    text = TOML
    for name, (acts, on, unit, value) in ACTS.items():
        text += f'[[parameter]]\nname = "{name}"\nacts = "{acts}"\non = "{on}"\nunit = "{unit}"\ninitial = {value}\n'
        text += f"cov = 0.1\nlower = {0.2 * value}\nupper = {5 * value}\n"
    (tmp_path / "model.toml").write_text(text + FRAME_SENSORS)
    return tmp_path


def posterior(model, *, converged=True, n=400) -> Posterior:
    rng = np.random.default_rng(3)
    width = len(model.parameters)
    root = np.linalg.cholesky(0.5 * np.eye(width) + 0.5)
    theta = model.parameters.initial * np.exp(0.05 * rng.standard_normal((4, n, width)) @ root.T)
    return Posterior(
        names=model.parameters.names, theta=theta, log_likelihood=np.zeros((4, n)), log_posterior=np.zeros((4, n)),
        prior=theta[0, :10], response_labels=("f",), measured=np.ones(1), std=np.ones(1), predicted=np.ones((2, 1)),
        frequency_hz=np.ones((2, 1)), mode_labels=("FA1",), r_hat=np.ones(width), ess=np.full(width, 400.0),
        converged=converged, verdict="made up", fingerprint="none",
    )


def exported(run, out="out", accept=False, **found):
    model = load_model(run / "model.toml")
    results = RunResults(posterior=posterior(model), model=model, path=run / "model.toml", **found)
    return export_lifetime(results, run / out, ExportSettings(n_draw=3, n_mode=4, accept=accept))


def test_every_file_is_there_with_its_hash_and_the_verdict(run):
    done = exported(run)
    manifest = json.loads((done.folder / "manifest.json").read_text())
    on_disk = {p.relative_to(done.folder).as_posix() for p in done.folder.rglob("*") if p.is_file()}
    assert set(manifest["files"]) == on_disk - {"manifest.json"}
    for name, entry in manifest["files"].items():
        raw = (done.folder / name).read_bytes()
        assert hashlib.sha256(raw).hexdigest() == entry["sha256"] and entry["units"]
        if name.endswith(".npz"):
            with np.load(done.folder / name) as held:
                assert "converged" in str(held["remark"])
        else:
            assert b"sampler: converged; diagnosis: not made" in raw, name
    assert any("fatigue" in text for text in manifest["left_out"])


def test_models_hold_every_parameter_of_their_draw(run, validation):
    checked = validation(what="SubDyn file at a draw, seven kinds of parameters", reference="the model at that draw",
                         why="two assemblies of one text")
    done = exported(run)
    model = load_model(run / "model.toml")
    table = read_table(done.folder / "draws.csv")
    theta = np.column_stack([table[name] for name in model.parameters.names])
    np.testing.assert_array_equal(theta, done.draws)
    modes = read_table(done.folder / "modes.csv")
    for k, row in enumerate(theta, 1):
        written = load_model(done.folder / "models" / f"{k:03d}" / "subdyn_at_draw.dat")
        expected = model.solve(row, 10).frequency_hz
        checked.error(written.solve(np.zeros(0), 10).frequency_hz / expected - 1, below=1e-9, of="draws")
        np.testing.assert_allclose([f for d, f in zip(modes["draw"], modes["frequency_hz"], strict=True) if d == k],
                                   expected)
    # values far from the initial ones are put in too
    far = dict(zip(model.parameters.names, model.parameters.initial * [2, 3, 0.5, 2, 3, 4, 0.3], strict=True))
    file, above = apply_values(run / "model.toml", far)
    frame, K, M = assembled_file(file)
    value = sparse.linalg.eigsh(K, k=5, M=M, sigma=0.0, return_eigenvectors=False)
    own = model.solve(np.array(list(far.values())), 5).frequency_hz
    checked.error(np.sort(np.sqrt(value)) / (2 * np.pi) / own - 1, below=1e-8, of="far values")
    assert above == ()


def test_a_mass_along_members_is_a_raised_density_and_said(run, validation):
    """SubDyn's densities turn with the section, a line_mass does not."""
    row = validation(what="line_mass as a raised density in a SubDyn file: frequencies", reference="the run's model",
                     why="rotary inertia of slender tubes")
    text = (run / "model.toml").read_text()
    (run / "model.toml").write_text(text.replace('acts = "density"\non = "brace"\nunit = "-"\ninitial = 1.0',
                                                 'acts = "line_mass"\non = "brace"\nunit = "kg/m"\ninitial = 20.0')
                                    .replace("lower = 0.2\nupper = 5.0", "lower = 0.2\nupper = 50.0"))
    done, model = exported(run), load_model(run / "model.toml")
    assert any("rho as a mass without rotary inertia" in t and "differ by up to" in t for t in done.left_out)
    for k, theta in enumerate(done.draws, 1):
        file = done.folder / "models" / f"{k:03d}" / "subdyn_at_draw.dat"
        row.error(load_model(file).solve(np.zeros(0), 6).frequency_hz / model.solve(theta, 6).frequency_hz - 1, 1e-3)
    assert (done.folder / "superelements" / "001.guyan.npz").is_file()


@pytest.mark.parametrize("options", [{"diagnosis": "unexplained"}, {"converged": False}])
def test_a_run_that_does_not_stand_needs_accept_and_says_so_in_every_file(run, options):
    model = load_model(run / "model.toml")
    drawn = posterior(model, converged=options.get("converged", True))
    results = RunResults(posterior=drawn, model=model, path=run / "model.toml", diagnosis=options.get("diagnosis"))
    settings = ExportSettings(n_draw=2, n_mode=2)
    with pytest.raises(InputError, match="--accept"):
        export_lifetime(results, run / "out", settings)
    done = export_lifetime(results, run / "out", replace(settings, accept=True))
    for path in (p for p in done.folder.rglob("*") if p.is_file()):
        if path.suffix == ".npz":
            with np.load(path) as held:
                assert "ACCEPTED ALTHOUGH" in str(held["remark"])
        else:
            assert "ACCEPTED ALTHOUGH" in path.read_text(), path


def test_models_of_matrices_go_out_with_their_parameters(tmp_path):
    rng = np.random.default_rng(2)
    root = rng.standard_normal((12, 12))
    np.savez(tmp_path / "model.npz", K0=root @ root.T + 50 * np.eye(12), M0=np.eye(12), K_a=np.diag(np.arange(12.0)),
             channel=np.array(["x", "y"]), channel_dof=np.array([0, 1]))
    (tmp_path / "parameters.toml").write_text('[[parameter]]\nname = "a"\ninitial = 1.0\nstd = 0.1\n')
    model = load_model(tmp_path / "model.npz")
    results = RunResults(posterior=posterior(model), model=model, path=tmp_path / "model.npz")
    done = export_lifetime(results, tmp_path / "out", ExportSettings(n_draw=2))
    again = load_model(done.folder / "models" / "001" / "model.npz")
    assert again.parameters.initial[0] == done.draws[0, 0]
    assert read_table(done.folder / "modes.csv")["label"][0] == "mode 1"
    assert any("superelements" in text for text in done.left_out)


def test_a_tower_goes_out_as_toml_beside_the_substructure(run):
    text = (run / "model.toml").read_text()
    tower = """[tower]
joint = 4
top_m = 30.0
elements = 4
fraction = [0.0, 1.0]
mass_kgpm = [900.0, 600.0]
stiffness_fa_nm2 = [3e9, 1e9]
stiffness_ss_nm2 = [3e9, 1e9]
youngs_modulus_pa = 2.1e11
shear_modulus_pa = 8.08e10
density_kgpm3 = 7850.0
[rotor_nacelle]
mass_kg = 3000.0
centre_m = [0.5, 0.0, 0.5]
inertia_kgm2 = [1e4, 1e4, 1e4, 0.0, 0.0, 0.0]
"""
    own = ('[[parameter]]\nname = "k_t"\nacts = "stiffness"\non = "tower"\nunit = "-"\n'
           'initial = 1.0\ncov = 0.1\nlower = 0.2\n')
    (run / "model.toml").write_text(text.replace("[group.legs]", tower + "[group.legs]", 1) + own)
    done = exported(run)
    assert any("k_t in models" in t for t in done.left_out)
    model = load_model(run / "model.toml")
    again = load_model(done.folder / "models" / "001" / "model.toml")
    np.testing.assert_allclose(again.solve(again.parameters.initial, 4).frequency_hz,
                               model.solve(done.draws[0], 4).frequency_hz, rtol=1e-12)
    # the superelement ends where the tower stands, with the substructure's parameters in it
    substructure = read_subdyn(done.folder / "models" / "001" / "subdyn_at_draw.dat")
    assert substructure.masses[0].values[0] == pytest.approx(2e3 * done.draws[0, list(ACTS).index("m")])
    assert (done.folder / "superelements" / "001.cb.dat").exists()


def test_files_in_neighbouring_folders_stay_neighbours(run):
    # as OpenFAST's models are laid out: the input in one folder, soil in another, the TOML above both
    (run / "sd").mkdir()
    (run / "ssi").mkdir()
    (run / "soil.txt").rename(run / "ssi" / "soil.txt")
    text = (run / "structure.dat").read_text().replace("soil.txt", '"../ssi/soil.txt"')
    (run / "sd" / "structure.dat").write_text(text)
    (run / "structure.dat").unlink()
    model = run / "model.toml"
    model.write_text(model.read_text().replace('file = "structure.dat"', 'file = "sd/structure.dat"'))
    done = exported(run)
    held = done.folder / "models" / "001"
    assert {p.relative_to(held).as_posix() for p in held.rglob("*") if p.is_file()} == {
        "sd/subdyn_at_draw.dat", "ssi/soil_1.txt"}
    with pytest.raises(InputError, match="leaves the folder"):
        load_model(run / "sd" / "structure.dat")


def test_a_named_cause_is_said_to_be_outside_the_draws(run):
    done = exported(run, diagnosis="named", findings=("parameter soil_63",))
    assert "parameter soil_63: not in these draws" in (done.folder / "draws.csv").read_text()


def test_draws_of_two_states_of_a_structure_are_not_exported_in_silence(run):
    changed = {"diagnosis": "named", "findings": ("parameter soil_63",), "changes": ("parameter soil_63: -0.3",)}
    said = r"changed within .*after alone: these are of .*sample the state after.*diagnosis\.posterior\.nc.*--accept"
    with pytest.raises(InputError, match=said):
        exported(run, **changed)
    assert "ACCEPTED ALTHOUGH" in (exported(run, accept=True, **changed).folder / "draws.csv").read_text()


def test_a_change_of_the_structure_is_told_from_the_weather_and_from_sensors():
    rows = [("structural", "step"), ("structural", "ramp"), ("structural", "constant"), ("environmental", "covariate"),
            ("measurement", "step")]
    content = {"findings": [{"kind": kind, "cause": "parameter", "location": f"k_{n}", "size": -0.3, "size_std": 0.04,
                             "unit": "-", "time_profile": profile, "since": "2025-10-14T08:10Z"}
                            for n, (kind, profile) in enumerate(rows)]}
    assert [finding["location"] for finding in structural_changes(content)] == ["k_0", "k_1"]
    assert structural_changes({}) == []


def test_damping_is_that_of_the_sets(run):
    labels = load_model(run / "model.toml")
    done = exported(run, "first")
    first = read_table(done.folder / "modes.csv")["label"][0]
    sets = tuple(ModalSet(id=f"{k}", frequency_hz=np.ones(1), damping_ratio=np.array([z]), shape=np.ones((3, 1)),
                          frequency_std_hz=np.ones(1), shape_std=np.ones((3, 1)))
                 for k, z in enumerate((0.01, 0.012, 0.014)))
    data = ModalData(channels=labels.channels, sets=sets, labels=(first,))
    table = read_table(exported(run, "second", modes=data).folder / "modes.csv")
    got = [z for z, label in zip(table["damping_ratio"], table["label"], strict=True) if label == first]
    assert len(got) == 3 and all(0.008 < z < 0.018 for z in got)
    assert all(z is None for z, label in zip(table["damping_ratio"], table["label"], strict=True) if label != first)


# superelements -------------------------------------------------------------------------------------------------------


def test_a_file_without_interface_joints_is_exported_without_superelements(run):
    """It ended the export with the name of a file that the user never wrote, models/001/subdyn_at_draw.dat."""
    path = run / "structure.dat"
    text = path.read_text()
    before = "   2   N - number of them\nnames of columns\n(-) (-)\n  3 1 1 1 1 1 1 1\n  4 1 1 1 1 1 1 1\n"
    assert before in text
    path.write_text(text.replace(before, "   0   N - number of them\nnames of columns\n(-) (-)\n"))
    done = exported(run)
    assert "superelements: structure.dat has no interface joints, where they end; list them (NInterf)" in done.left_out
    assert not (done.folder / "superelements").exists() and (done.folder / "models" / "001").exists()


def test_a_superelement_with_all_modes_is_the_structure_itself(run, validation):
    checked = validation(what="superelement with all modes; with 0, 2, 6 never below",
                         reference="the structure itself; Rayleigh-Ritz from above", why="eigensolver")
    file = read_subdyn(run / "structure.dat")
    # one interface joint: with all modes nothing is lost
    alone = read_subdyn(run / "structure.dat")
    text = "\n".join(alone.lines).replace("   2   N - number of them\nnames of columns\n(-) (-)\n  3 1 1 1 1 1 1 1\n",
                                          "   1   N - number of them\nnames of columns\n(-) (-)\n")
    (run / "one.dat").write_text(text)
    one = read_subdyn(run / "one.dat")
    assert [i.joint for i in one.interfaces] == [4] and len(file.interfaces) == 2
    _, K, _ = assembled_file(one)
    most = superelement(one, n_mode=K.shape[0] - 6 - 2, compared=5)
    checked.error(most.truncation, below=1e-6)
    few = [superelement(one, n_mode=n, compared=5).truncation for n in (0, 2, 6)]
    # Rayleigh-Ritz: frequencies come down to the structure's as modes are added
    assert all(np.all(t > -1e-9) for t in few) and np.all(few[0] >= few[1] - 1e-9) and np.all(few[1] >= few[2] - 1e-9)


def test_guyans_stiffness_is_the_static_one_and_recovery_follows_the_interface(run, validation):
    checked = validation(what="recovery at the interface; Guyan stiffness",
                         reference="rigid motion; flexibility by a stiff tie", why="rounding, the tie")
    file = read_subdyn(run / "structure.dat")
    one = superelement(file, n_mode=3, reference_m=[2.0, 0.0, 8.0])
    frame, K, _ = assembled_file(file)
    # unit motions of the reference point: recovered joints of the interface move rigidly with it
    for joint in (3, 4):
        arm = np.array(next(j.position_m for j in file.joints if j.id == joint)) - [2.0, 0.0, 8.0]
        rigid = np.eye(6)
        rigid[:3, 3:] = [[0, arm[2], -arm[1]], [-arm[2], 0, arm[0]], [arm[1], -arm[0], 0]]
        recovered = one.recovery[one.joints.index(joint)]
        checked.error(recovered[:, :6] - rigid, below=1e-9, of="recovery")
        checked.error(recovered[:, 6:], below=1e-9, of="recovery")
    # by a stiff tie and loads instead: the flexibility of the reference point is the inverse
    rows = np.vstack([frame.reduction[frame.node_dofs(frame.node_of[j])].toarray() for j in (3, 4)])
    motion = one.recovery[[one.joints.index(j) for j in (3, 4)], :, :6].reshape(12, 6)
    gap = np.hstack([rows, -motion])
    size = K.shape[0]
    tied = np.zeros((size + 6,) * 2)
    tied[:size, :size] = K.toarray()
    tied += 1e14 * gap.T @ gap
    flexibility = np.linalg.inv(tied)[size:, size:]
    apart = np.linalg.inv(one.stiffness[:6, :6]) - flexibility
    checked.error(apart / (np.abs(flexibility) + 0.1 * flexibility.max()), below=1e-3, of="flexibility")


def test_guyans_matrices_and_inner_modes_are_subdyns_own(tmp_path):
    # KBBt, MBBt and CB_frequencies that SubDyn prints (seven digits) for two cases of OpenFAST's r-test: the OC3
    # monopile of 5MW_OC3Mnpl_Linear and SD_Rigid, a rigid link in a cantilever
    (tmp_path / "monopile.dat").write_text(subdyn(
        ["0 0 -20.0001", "0 0 -10", "0 0 0", "0 0 10"], ["1 2 1 1 1c 0", "2 3 1 1 1c 0", "3 4 1 1 1c 0"],
        ["1 1 1 1 1 1 1"], div=3, fem=3, interface=[4], circular=["1 2.1e11 8.08e10 8500 6.0 0.06"]))
    (tmp_path / "rigid.dat").write_text(subdyn(
        ["0 0 0", "0 0 10", "0 0 20", "0 0 30"], ["1 2 1 1 1c 0", "2 3 1 1 1c 0", "3 4 1 1 1c 0", "2 3 1 1 3 0"],
        ["1 1 1 1 1 1 1"], fem=3, interface=[4], circular=["1 2.1e11 8.0769e10 7850 1.0 0.05"], rigid=["1 0.0"]))
    # K and M: xx, x-ry, ryry, zz, rzrz
    expected = {
        "monopile": ([3.530365e8, -5.295565e9, 1.140047e11, 7.837619e9, 2.660317e10],
                     [1.048670e5, -4.264600e5, 2.466666e6, 9.517173e4, 8.395859e5], []),
        "rigid": ([1.627377e6, -2.441065e7, 5.434118e8, 1.566869e9, 1.363474e8],
                  [1.296044e4, -4.455060e4, 1.836456e5, 1.073803e4, 2.429479e3], [9.923489, 9.923489]),
    }
    places = ([0, 0, 4, 2, 5], [0, 4, 4, 2, 5])
    for name, (stiffness, mass, held) in expected.items():
        one = superelement(read_subdyn(tmp_path / f"{name}.dat"), n_mode=2)
        np.testing.assert_allclose(one.stiffness[places], stiffness, rtol=5e-7)
        np.testing.assert_allclose(one.mass[places], mass, rtol=5e-7)
        if held:
            np.testing.assert_allclose(np.sqrt(np.diag(one.stiffness)[6:]) / (2 * np.pi), held, rtol=5e-7)


def test_the_extptfm_file_is_what_the_archive_holds(run, validation):
    row = validation(what="ExtPtfm file", reference="the archive's matrices")
    done = exported(run)
    folder = done.folder / "superelements"
    read = read_extptfm(folder / "001.cb.dat")
    with np.load(folder / "001.cb.npz") as held:
        row.equal(read["Mass"], held["M"])
        row.equal(read["Stiffness"], held["K"])
        row.equal(read["Damping"], held["C"])
        # JDampings of the file: 1 % of critical in every mode
        np.testing.assert_allclose(np.diag(held["C"])[6:], 0.02 * np.sqrt(np.diag(held["K"])[6:]))
        assert held["recovery"].shape == (4, 6, 10)
        np.testing.assert_allclose(frequencies(held["K"], held["M"])[: len(held["frequency_hz"])], held["frequency_hz"])
    (folder / "broken.dat").write_text((folder / "001.cb.dat").read_text().replace("!Damping", "!Dampin"))
    with pytest.raises(InputError, match="Damping"):
        read_extptfm(folder / "broken.dat")


# draws ---------------------------------------------------------------------------------------------------------------


def test_the_joint_distribution_has_the_draws_marginals_and_dependence(validation):
    row = validation(what="Nataf joint distribution sampled again", reference="20 000 draws with known dependence",
                     why="four standard errors")
    rng = np.random.default_rng(5)
    z = rng.multivariate_normal([0, 0], [[1, -0.7], [-0.7, 1]], size=20000)
    draws = np.column_stack([np.exp(0.4 * z[:, 0]), stats.norm.cdf(z[:, 1]) ** 2])
    joint = joint_of(("a", "b"), draws)
    # 20000 draws: a correlation's standard error is (1 - r^2) / sqrt(n) = 0.004
    row.error(joint.correlation[0, 1] + 0.7, below=0.015, of="correlation")
    again = joint.sample(20000, rng)
    for k in range(2):
        row.least(stats.ks_2samp(again[:, k], draws[:, k]).pvalue, above=1e-3, of="p of the marginals")
    row.error(stats.spearmanr(again).statistic - stats.spearmanr(draws).statistic, below=0.02, of="rank correlation")


def test_equal_draws_are_the_posteriors_own_and_follow_the_seed():
    draws = np.arange(50.0)[:, None]
    one, two = (equal_draws(draws, 20, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert len(set(one.ravel())) == 20
    with pytest.raises(InputError, match="51 are asked for"):
        equal_draws(draws, 51, np.random.default_rng(1))


def test_initial_values_are_replaced_in_their_own_tables_only():
    text = ('[[parameter]]\nname = "a"\ninitial = 2.0 # as drawn\ncov = 0.1\n\n'
            '[[parameter]]\nname = "b"\ninitial = 3\nstd = 1\n')
    new = with_initial(text, {"a": 4.0}, "model.toml")
    assert "initial = 4.0 # as drawn\nstd = 0.2" in new and "initial = 3\nstd = 1" in new
    with pytest.raises(InputError, match="no .*table of c"):
        with_initial(text, {"c": 1.0}, "model.toml")


# the command ---------------------------------------------------------------------------------------------------------


def test_the_command_exports_a_run_directory(run, capsys):
    model = load_model(run / "model.toml")
    write_posterior(posterior(model), run / "posterior.nc")
    words = ["export", str(run), "--to", "lifetime", str(run / "out"), "--draws", "2", "--superelement-modes", "3"]
    assert main([*words, "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["draws"] == 2 and "draws.csv" in answer["files"]
    assert answer["verdict"].startswith("sampler: converged")
    assert main(words) == 2
    assert "holds something already" in capsys.readouterr().err
    assert main(["export", str(run), "--to", "lifetime", str(run / "many"), "--draws", "100000"]) == 2
    (run / "posterior.nc").unlink()
    assert main(["export", str(run), "--to", "lifetime", str(run / "no")]) == 2
    assert "posterior.nc" in capsys.readouterr().err


def test_the_command_takes_a_model_that_lies_elsewhere(tmp_path, capsys):
    """As `report` does: the model beside the run's directory, its parameters under a name of their own."""
    rng = np.random.default_rng(2)
    root = rng.standard_normal((12, 12))
    (apart := tmp_path / "bridge").mkdir()
    np.savez(apart / "span.npz", K0=root @ root.T + 50 * np.eye(12), M0=np.eye(12), K_a=np.diag(np.arange(12.0)),
             channel=np.array(["x", "y"]), channel_dof=np.array([0, 1]))
    (apart / "values.toml").write_text('[[parameter]]\nname = "a"\ninitial = 1.0\nstd = 0.1\n')
    (folder := tmp_path / "run").mkdir()
    model = load_model(apart / "span.npz", parameters=apart / "values.toml")
    write_posterior(posterior(model), folder / "posterior.nc")
    words = ["export", str(folder), "--to", "lifetime", str(tmp_path / "out"), "--draws", "2"]
    assert main(words) == 2
    assert "has no model" in (said := capsys.readouterr().err) and "--model" in said
    there = ["--model", str(apart / "span.npz"), "--parameters", str(apart / "values.toml")]
    assert main([*words, *there]) == 0
    draw = read_table(tmp_path / "out" / "draws.csv")["a"][0]
    assert load_model(tmp_path / "out" / "models" / "001" / "model.npz").parameters.initial[0] == draw
    assert main([*words[:-2], "--model", str(apart / "none.npz")]) == 2
    assert "--model: '" in (said := capsys.readouterr().err) and "does not exist" in said


# which state of the structure draws are of ---------------------------------------------------------------------------


def diagnosed(run):
    """The structure changed at 12:00Z."""
    finding = {"kind": "structural", "cause": "joints loosened", "location": "brace", "size": -0.62, "size_std": 0.04,
               "unit": "-", "posterior_probability": 0.97, "time_profile": "step", "since": "2019-06-03T12:00Z",
               "z": -14.2, "check": "inspect the weld toes", "alternatives": [], "gain": {}}
    content = {"verdict": "named", "p_value": 2e-7, "findings": [finding], "extended_model": "diagnosis.model.toml",
               "threshold": 4.1, "adequacy_p": 0.3, "splits": [], "detectable_sizes": [], "parameters": [], "notes": [],
               "details": {}}
    (run / "diagnosis.json").write_text(json.dumps(content))


def sampled(run, name, first, last=None):
    """A posterior of the run's model, of one set or from the first to the last."""
    record = {"set_id": first} if last is None else {"set_id": "9 of 9 sets", "first and last set": [first, last]}
    write_posterior(replace(posterior(load_model(run / "model.toml")), record=record), run / name)


@pytest.mark.parametrize("ends", [("2019-06-03T08:00Z", "2019-06-03T16:00Z"), ("2019-06-03T08:00Z", None)])
def test_draws_that_are_not_of_the_state_after_are_refused(run, ends):
    diagnosed(run)
    sampled(run, "posterior.nc", *ends)
    with pytest.raises(InputError, match="changed within the records"):
        probupdate.export(run, run / "out", draws=2)


def test_draws_of_sets_after_the_change_are_exported(run):
    diagnosed(run)
    sampled(run, "posterior.nc", "2019-06-03T12:00Z", "2019-06-03T16:00Z")
    assert not probupdate.export(run, run / "out", draws=2).status.refused


@pytest.mark.parametrize("beside", [False, True])
def test_what_diagnose_states_to_sample_of_the_state_after_is_exported(run, beside):
    """Also where a posterior of both states lies beside it; with the model that holds the findings."""
    diagnosed(run)
    if beside:
        sampled(run, "posterior.nc", "2019-06-03T08:00Z", "2019-06-03T16:00Z")
    sampled(run, "diagnosis.posterior.nc", "2019-06-03T14:00Z")
    (run / "diagnosis.model.toml").write_text((run / "model.toml").read_text().replace("a frame", "with a loose joint"))
    done = probupdate.export(run, run / "out", draws=2)
    assert not done.status.refused and done.status.sets == "2019-06-03T14:00Z"
    assert json.loads((run / "out" / "manifest.json").read_text())["model"] == "with a loose joint"
