"""Models at the draws of an export: what the data moved of a tolerance is in them, not in the parameters alone."""

import copy
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from probupdate.effects.tolerances import TurbineUncertainty
from probupdate.lifetime import fatigue_files
from probupdate.lifetime.export import ExportSettings, RunResults, export_lifetime, read_table
from probupdate.lifetime.fatigue import fatigue_model_of
from probupdate.lifetime.fatigue_files import FatigueInput
from probupdate.modal.labels import mode_character
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.structure.extend import extended_model
from probupdate.structure.load import load_model, model_sensors
from probupdate.updating.laplace import maximum_a_posteriori
from probupdate.updating.problem import Weights, build_problem
from tests.lifetime.test_fatigue_export import posterior, toml
from tests.lifetime.test_stress import CONDITIONS, _toml
from tests.small_turbine import small_turbine

HIGH, N_DRAW, STD = 4, 12, 0.002


@pytest.fixture(scope="module")
def softened(tmp_path_factory):
    """A turbine whose soil has 0.7 of the stiffness that the model states, which is no parameter of it: the export of
    its posterior, the measured frequencies, the run and its problem."""
    folder = tmp_path_factory.mktemp("softened")
    raw = copy.deepcopy(small_turbine())
    for p in raw["parameter"]:
        p["update"] = p["name"] in ("k_j", "k_t", "m_h")
    (folder / "model.toml").write_text(toml(raw))
    model = load_model(folder / "model.toml")
    described = TurbineUncertainty.from_description(folder / "model.toml", model, None, None)
    soil = next(r.effect for r in described.tolerances if r.effect.name == "tolerance_law_py")
    true = extended_model(folder / "model.toml", [replace(soil, initial=0.7)])
    solution = true.solve(true.parameters.initial, HIGH)
    labels = mode_character(solution.shape, model_sensors(folder / "model.toml")).labels
    one = ModalSet(id="after", frequency_hz=solution.frequency_hz, damping_ratio=np.full(HIGH, 0.01),
                   shape=solution.shape / np.abs(solution.shape).max(axis=0),
                   frequency_std_hz=STD * solution.frequency_hz, shape_std=np.full(solution.shape.shape, 0.01))
    data = ModalData(channels=model.channels, sets=(one,), labels=tuple(labels))
    known = replace(model, uncertainty=TurbineUncertainty.from_description(folder / "model.toml", model, None, None))
    problem = build_problem(known, data, weights=Weights(tolerances=True)).with_error(model.parameters.initial)
    best = maximum_a_posteriori(problem, [model.parameters.initial])
    rng = np.random.default_rng(5)
    theta = rng.multivariate_normal(best.theta, best.covariance, size=(4, 200))
    results = RunResults(posterior=replace(posterior(model), theta=theta, fingerprint=problem.fingerprint()),
                         model=model, path=folder / "model.toml", modes=data, problem=problem)
    done = export_lifetime(results, folder / "out", ExportSettings(n_draw=N_DRAW, n_mode=4))
    return done, solution.frequency_hz, results


def frequencies_read(done):
    """(n_draw, n) of the models as they lie in the folder."""
    found = []
    for k in range(N_DRAW):
        own = load_model(done.folder / "models" / f"{k + 1:03d}" / "model.toml")
        found.append(own.solve(own.parameters.initial, HIGH).frequency_hz)
    return np.array(found)


def test_models_with_their_tolerances_have_the_measured_frequencies(softened, validation):
    done, measured, results = softened
    found = np.log(frequencies_read(done) / measured)
    error = found.mean(axis=0)
    alone = np.array([results.model.solve(theta, HIGH).frequency_hz for theta in done.draws])
    # parameters alone miss them by several times what was measured
    assert np.abs(np.log(alone / measured).mean(axis=0)).max() > 3 * STD
    scatter = np.hypot(found.std(axis=0, ddof=1) / np.sqrt(N_DRAW), STD)
    validation(what="frequencies of exported models of a turbine whose soil, no parameter, is softer by 0.7",
               reference="those that were measured", why="standard deviation of each and of the draws' mean"
               ).error(error / scatter, below=3.0)
    # and scatter no more than what was measured leaves open, of which tolerances' own scatter is many times
    assert np.all(found.std(axis=0, ddof=1) < 3 * STD)


def test_tolerances_of_the_draws_are_listed_and_in_the_modes(softened):
    done, _, results = softened
    table = read_table(done.folder / "tolerances.csv")
    assert table["draw"] == list(range(1, N_DRAW + 1))
    assert set(table) == {"draw", *(s.name for s in results.problem.error_sources)}
    assert np.mean(table["tolerance_law_py"]) < -0.05
    modes = read_table(done.folder / "modes.csv")
    own = [f for d, f in zip(modes["draw"], modes["frequency_hz"], strict=True) if d == 2][:HIGH]
    np.testing.assert_allclose(own, frequencies_read(done)[1], rtol=1e-6)


def test_fatigue_of_a_draw_is_that_of_its_model(softened, tmp_path, monkeypatch, validation):
    """By the file's damping; parameters alone have other frequencies, and with them another damage."""
    for name, number in (("WORST", 3), ("PRIOR_DRAWS", 6), ("SIMULATED", 4000)):
        monkeypatch.setattr(fatigue_files, name, number)
    _, _, results = softened
    (tmp_path / "fatigue.toml").write_text(_toml(CONDITIONS))
    undamped = replace(results.modes, sets=tuple(
        replace(one, damping_ratio=np.full(HIGH, np.nan)) for one in results.modes.sets))
    laplace = maximum_a_posteriori(results.problem, [results.model.parameters.initial])
    given = FatigueInput(file=tmp_path / "fatigue.toml", problem=results.problem, laplace=laplace)
    done = export_lifetime(replace(results, modes=undamped), tmp_path / "out", ExportSettings(n_draw=4, n_mode=4),
                           fatigue=given)
    table = read_table(done.folder / "fatigue.csv")
    found = np.array([v for d, v in zip(table["draw"], table["del_m3"], strict=True) if d == 2])

    def plain(path, theta=None):
        whole = fatigue_model_of(path, given.file)
        return whole.solve(whole.parameters.initial if theta is None else theta).equivalent_mpa(3.0)

    row = validation(what="damage-equivalent ranges of an exported draw", reference="the model that is written of it",
                     why="basis, and what the file's numbers are rounded to")
    row.error(found / plain(done.folder / "models" / "002" / "model.toml") - 1, below=5e-3)
    alone = plain(results.path, done.draws[1])
    assert np.abs(found / alone - 1).max() > 0.02


def test_a_posterior_of_other_settings_takes_no_tolerances(softened, tmp_path):
    _, _, results = softened
    other = replace(results, posterior=replace(results.posterior, fingerprint="another"))
    done = export_lifetime(other, tmp_path / "out", ExportSettings(n_draw=2, n_mode=4))
    assert any("tolerances in models: as stated" in text for text in done.left_out)
    assert "tolerances.csv" not in json.loads((done.folder / "manifest.json").read_text())["files"]


def matrices_as_text(path):
    """Mass and stiffness of an ExtPtfm file: rows of numbers behind their titles, read without the package."""
    lines, found = path.read_text().splitlines(), {}
    for name in ("Mass", "Stiffness"):
        at = lines.index(f"!{name} Matrix") + 2
        n = int(lines[at - 1].split(":")[1])
        found[name] = np.array([[float(word) for word in line.split()] for line in lines[at : at + n]])
    return found["Mass"], found["Stiffness"]


@pytest.mark.parametrize("kind", ["guyan", "cb"])
def test_written_superelements_have_their_frequencies_by_scipy_alone(softened, kind):
    done, _, _ = softened
    entries = json.loads((done.folder / "manifest.json").read_text())["files"]
    own = []
    for k in (1, N_DRAW):
        name = f"superelements/{k:03d}.{kind}"
        archive = np.load(done.folder / f"{name}.npz", allow_pickle=False)
        for M, K in (matrices_as_text(done.folder / f"{name}.dat"), (archive["M"], archive["K"])):
            np.testing.assert_allclose(M, M.T, atol=1e-9 * np.abs(M).max())
            found = np.sqrt(linalg.eigh(K, M, eigvals_only=True)) / (2 * np.pi)
            stated = np.array(entries[f"{name}.dat"]["frequency_hz"])
            np.testing.assert_allclose(found[: len(stated)], stated, rtol=1e-6)
        # Craig and Bampton: at and above the structure's own
        assert np.all(archive["frequency_hz"] >= archive["full_frequency_hz"] * (1 - 1e-9))
        own.append(stated[0])
    assert abs(own[1] / own[0] - 1) > 1e-5
