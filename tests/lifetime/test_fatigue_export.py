"""`export --fatigue`: every file is there, read back, and holds what its parts say; factors add up to the one model."""

import copy
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, stats

from probupdate.cli import main
from probupdate.effects.tolerances import TurbineUncertainty
from probupdate.errors import InputError
from probupdate.lifetime import fatigue_files
from probupdate.lifetime.export import ExportSettings, RunResults, export_lifetime, read_table
from probupdate.lifetime.factors import gains, tolerance_draws, variance_shares
from probupdate.lifetime.fatigue import fatigue_model
from probupdate.lifetime.fatigue_files import FatigueInput
from probupdate.modal.labels import mode_character
from probupdate.modal.modes import ModalData, ModalSet
from probupdate.model.parameters import Parameters
from probupdate.structure.description_file import read_description
from probupdate.structure.extend import extended_description
from probupdate.structure.load import load_model, model_sensors
from probupdate.updating.laplace import maximum_a_posteriori, prior_residual
from probupdate.updating.posterior_file import Posterior, write_posterior
from probupdate.updating.problem import Weights, build_problem
from tests.lifetime.test_stress import CONDITIONS, UPDATED, _toml
from tests.small_turbine import small_turbine

HIGH = 4


def toml(raw) -> str:
    """model.toml of a dictionary: plain keys and tables in lines first, lists of tables after them."""

    def value(v):
        if isinstance(v, dict):
            return "{ " + ", ".join(f"{k} = {value(x)}" for k, x in v.items()) + " }"
        if isinstance(v, list):
            return "[" + ", ".join(value(x) for x in v) + "]"
        return str(v).lower() if isinstance(v, bool) else f'"{v}"' if isinstance(v, str) else repr(v)

    many = {k: v for k, v in raw.items() if isinstance(v, list) and v and isinstance(v[0], dict)}
    lines = [f"{k} = {value(v)}" for k, v in raw.items() if k not in many]
    for key, items in many.items():
        for item in items:
            lines += [f"[[{key}]]", *(f"{k} = {value(x)}" for k, x in item.items())]
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A small turbine's folder, its model, and the one model's problem of four of its modes at its maximum."""
    folder = tmp_path_factory.mktemp("fatigue")
    raw = small_turbine()
    for p in raw["parameter"]:
        p["update"] = p["name"] in UPDATED[:3]
    (folder / "model.toml").write_text(toml(raw))
    conditions = copy.deepcopy(CONDITIONS)
    conditions["life"]["years"] = 15
    # at four years Miner's sum was below half of that at failure: eight years at least, of which five are over
    conditions["inspection"] = {"age_years": 4.0, "detectable_share": 0.5}
    (folder / "fatigue.toml").write_text(_toml(conditions))
    model = load_model(folder / "model.toml")
    solution = model.solve(model.parameters.initial * 1.02, HIGH)
    f, shape = solution.frequency_hz, solution.shape / np.abs(solution.shape).max(axis=0)
    labels = mode_character(solution.shape, model_sensors(folder / "model.toml")).labels
    sets = tuple(
        ModalSet(
            id=f"{k}",
            frequency_hz=f * (1 + 0.001 * k),
            damping_ratio=np.full(HIGH, 0.01 + 0.001 * k),
            shape=shape,
            frequency_std_hz=0.002 * f,
            shape_std=np.full(shape.shape, 0.02),
        )
        for k in range(3)
    )
    data = ModalData(channels=model.channels, sets=sets, labels=tuple(labels))
    known = replace(model, uncertainty=TurbineUncertainty.from_description(folder / "model.toml", model, None, None))
    problem = build_problem(known, data, weights=Weights(tolerances=True)).with_error(model.parameters.initial)
    return folder, model, data, problem, maximum_a_posteriori(problem, [model.parameters.initial])


def posterior(model) -> Posterior:
    rng = np.random.default_rng(3)
    theta = model.parameters.initial * np.exp(0.03 * rng.standard_normal((4, 200, len(model.parameters))))
    n = len(model.parameters)
    return Posterior(
        names=model.parameters.names,
        theta=theta,
        log_likelihood=np.zeros((4, 200)),
        log_posterior=np.zeros((4, 200)),
        prior=theta[0, :10],
        response_labels=("f",),
        measured=np.ones(1),
        std=np.ones(1),
        predicted=np.ones((2, 1)),
        frequency_hz=np.ones((2, 1)),
        mode_labels=("FA1",),
        r_hat=np.ones(n),
        ess=np.full(n, 400.0),
        converged=True,
        verdict="made up",
        fingerprint="none",
    )


@pytest.fixture(scope="module")
def done(run):
    folder, model, data, _, laplace = run
    # without tolerances, whose effect on stress takes long
    problem = build_problem(model, data, weights=Weights())
    with pytest.MonkeyPatch.context() as patch:
        # few of everything; numbers are checked elsewhere
        for name, number in (("WORST", 3), ("PRIOR_DRAWS", 6), ("SIMULATED", 4000)):
            patch.setattr(fatigue_files, name, number)
        return export_lifetime(
            RunResults(posterior=posterior(model), model=model, path=folder / "model.toml", modes=data),
            folder / "out",
            ExportSettings(n_draw=4),
            fatigue=FatigueInput(
                file=folder / "fatigue.toml",
                problem=problem,
                laplace=laplace,
                set_updates=laplace.theta * (1 + 0.01 * np.array([[-1.0], [0.0], [1.0]])),
                left_out="scour: its posterior is not there",
            ),
        )


FILES = (
    "hot_spots.csv",
    "fatigue.csv",
    "fatigue_sensitivity.csv",
    "model_factors.csv",
    "reliability.csv",
    "remaining_life.csv",
)


def test_a_weld_that_is_nowhere_is_refused_before_anything_is_written(run, tmp_path):
    """It left a folder half filled, which the next export refused."""
    folder, model, data, _, _ = run
    text = (folder / "fatigue.toml").read_text()
    curve = re.search(r"\[curve\.(\w+)\]", text)[1]
    own = tmp_path / "fatigue.toml"
    own.write_text(text + f'\n[[girth]]\npart = "tower"\nz_m = 34.56\nfactor = 1.2\ncurve = "{curve}"\n')
    results = RunResults(posterior=posterior(model), model=model, path=folder / "model.toml", modes=data)
    with pytest.raises(InputError, match=r"34\.56 m is no element's end, the nearest is at [\d.]+ m"):
        export_lifetime(results, tmp_path / "out", ExportSettings(n_draw=4), fatigue=FatigueInput(file=own))
    assert not (tmp_path / "out").exists()


def test_every_file_of_fatigue_is_in_the_manifest_with_units(done):
    manifest = json.loads((done.folder / "manifest.json").read_text())
    for name in FILES:
        entry = manifest["files"][name]
        assert entry["schema"]["items"]["required"] and entry["what"]
        assert b"sampler: converged" in (done.folder / name).read_bytes()
    answer = manifest["fatigue"]
    assert answer["basis_error"] < 0.01 and answer["target_annual_index"] == 3.3
    assert answer["form_minus_monte_carlo"] < 0.02 + 4 * answer["monte_carlo_standard_error"]
    assert not any("fatigue" in text for text in manifest["left_out"])


def test_an_inspection_without_a_crack_proves_the_years_after_it(done):
    life = read_table(done.folder / "remaining_life.csv")
    assert min(life["q05"]) >= 8.0 - 5.0 - 1e-9 and all(0 < p <= 1 for p in life["survival_to_age"])
    manifest = json.loads((done.folder / "manifest.json").read_text())
    assert "no crack was found at 4 years" in manifest["files"]["remaining_life.csv"]["what"]
    # nor does the annual index, so given, fall below the target before
    assert all(y is None or 8 - 5 <= y <= 15 for y in life["years_to_target"])


def test_one_more_measurement_leaves_what_varies_from_set_to_set(done):
    """With few draws it left nothing at all."""
    after, factors = (read_table(done.folder / f"{name}.csv") for name in ("next_measurement", "model_factors"))
    between = {int(of.split(":")[0].removeprefix("hot spot ")): v for of, v, what in zip(
        factors["of"], factors["cov_set_to_set"], factors["quantity"], strict=True) if what == "stress range"}
    for spot, now, then in zip(after["hot_spot"], after["cov_now"], after["cov_then"], strict=True):
        assert between[spot] * (1 - 1e-9) <= then <= now * (1 + 1e-9)
    assert max(between.values()) > 0


def test_a_tolerance_that_is_known_leaves_what_conditioning_on_it_leaves(run, validation):
    """By draws of parameters and tolerances together, regressed on the ones that become known."""
    row = validation(what="share of a stress' variance that a known tolerance takes off",
                     reference="regression of draws", why="20 000 draws")
    *_, problem, laplace = run
    rng, std = np.random.default_rng(5), np.array([s.std for s in problem.error_sources])
    n, m = len(laplace.theta), len(std)
    A = problem.noise_root @ np.column_stack([problem.sensitivity(laplace.theta)[1], problem.factor])
    prior = prior_residual(problem.parameters, laplace.theta)[1]
    precision = A.T @ A + linalg.block_diag(prior.T @ prior, np.eye(m))
    drawn = rng.standard_normal((20_000, n + m)) @ np.linalg.inv(np.linalg.cholesky(precision))
    slope, direct = rng.standard_normal((4, n)) / laplace.theta, 0.1 * rng.standard_normal((4, m)) / std
    y = drawn[:, :n] @ slope.T + drawn[:, n:] @ (direct * std).T
    found = dict(variance_shares(problem, laplace, slope, direct))
    assert all(share.min() >= 0 and share.max() < 1 for share in found.values())
    checked = 0
    for (group, check), own in _sources_by_check(problem).items():
        first = problem.error_sources[own[0]].description
        name = first if len(own) == 1 else f"{len(own)} tolerances of {group}, such as {first}"
        (what,) = [w for w in found if w.startswith(f"determine {name}") and check in w]
        known = drawn[:, [n + k for k in own]]
        left = y - known @ np.linalg.lstsq(known, y, rcond=None)[0]
        row.error(found[what] - (1 - left.var(axis=0) / y.var(axis=0)), below=0.03)
        checked += 1
    assert checked >= 3


def _sources_by_check(problem):
    found = {}
    for k, source in enumerate(problem.error_sources):
        found.setdefault((source.group, source.check), []).append(k)
    return found


def test_years_of_life_are_those_of_the_indices(done):
    """From reliability.csv, which FORM wrote, for what quadrature wrote; failure before the eight years that the
    inspection proved is ruled out."""
    age, proven = 5.0, 8.0
    table, life = (read_table(done.folder / f"{name}.csv") for name in ("reliability", "remaining_life"))
    compared = 0
    for row in range(len(life["case"])):
        own = [k for k in range(len(table["case"])) if (table["case"][k], table["hot_spot"][k]) == (
            life["case"][row], life["hot_spot"][row])]
        year, index, annual = (np.array([table[name][k] for k in own], float) for name in (
            "year", "cumulative_index", "annual_index"))
        survival = np.log(stats.norm.cdf(index))
        assert stats.norm.ppf(life["survival_to_age"][row]) == pytest.approx(index[year == age][0], abs=0.02)
        left = survival - survival[year == proven]
        for name, q in (("q05", 0.05), ("q50", 0.5)):
            # of what is left at the last year there may be more than that
            if left[-1] < np.log1p(-q):
                expected = np.interp(-np.log1p(-q), -left, year) - age
                assert life[name][row] == pytest.approx(expected, abs=0.3)
                compared += 1
        below = year[(annual < 3.3) & (year > proven)]
        assert life["years_to_target"][row] == (max(below[0] - 1, proven) - age if len(below) else None)
    assert compared >= 2


def test_cycles_that_are_not_counted_are_named(done):
    manifest = json.loads((done.folder / "manifest.json").read_text())
    assert any("start, stop, another mean wind" in text for text in manifest["left_out"])


def test_a_cause_without_its_posterior_is_named(done):
    manifest = json.loads((done.folder / "manifest.json").read_text())
    assert "scour: its posterior is not there" in manifest["left_out"]


def test_ratios_are_of_their_own_draw_over_the_design(done, run):
    table = {k: np.array(v) for k, v in read_table(done.folder / "fatigue.csv").items()}
    spots = read_table(done.folder / "hot_spots.csv")
    n = len(spots["hot_spot"])
    assert len(table["draw"]) == 5 * n and set(spots["side"]) == {"chord", "weld"}
    design = table["draw"] == 0
    np.testing.assert_allclose(table["ratio_m5"][design], 1.0)
    for k in range(1, 5):
        own = table["draw"] == k
        np.testing.assert_allclose(table["ratio_m3"][own], table["del_m3"][own] / table["del_m3"][design])
        np.testing.assert_allclose(
            table["damage_ratio"][own], table["damage_per_year"][own] / table["damage_per_year"][design]
        )
    # the full model, one draw, the damping that the draw was given
    modes = read_table(done.folder / "modes.csv")
    damping = {
        label: z
        for d, label, z in zip(modes["draw"], modes["label"], modes["damping_ratio"], strict=True)
        if d == 2 and z is not None
    }
    assert len(damping) >= 3
    full = fatigue_model(read_description(run[0] / "model.toml"), "model.toml", run[0] / "fatigue.toml")
    expected = full.solve(done.draws[1], damping).equivalent_mpa(5.0)
    np.testing.assert_allclose(table["del_m5"][table["draw"] == 2], expected, rtol=5e-3)


def test_factors_have_the_parts_of_the_one_model(done, run):
    table = read_table(done.folder / "model_factors.csv")
    kinds = set(table["quantity"])
    assert kinds == {"frequency", "damping ratio", "stress range"}
    parts = [f"cov_{p}" for p in ("measurement", "tolerance", "set_to_set", "model_form", "prior")]
    for k, quantity in enumerate(table["quantity"]):
        if quantity == "damping ratio":
            # 10, 11, 12 per mille in the sets, 2 % assumed
            assert table["bias"][k] == pytest.approx(0.55, abs=0.05)
            assert table["cov_set_to_set"][k] == pytest.approx(np.std(np.log([0.010, 0.011, 0.012]), ddof=1), rel=1e-6)
        if quantity == "stress range":
            # of the tower the tolerances may be no part; what is measured and what was believed before always are
            shares = [table[p][k] for p in parts]
            assert np.isfinite(shares).all() and min(shares) >= 0 and 1e-3 < max(shares) < 0.1
            assert table["cov_measurement"][k] > 1e-4 and table["cov_prior"][k] > 1e-3


def test_parts_of_a_parameter_add_up_to_its_variance(run, validation):
    row = validation(what="parts of a parameter's variance", reference="the one model's covariance", why="rounding")
    *_, problem, laplace = run
    found = gains(problem, laplace)
    own = found.parts(np.eye(len(found.theta)))
    row.error(sum(v**2 for v in own.values()) / np.diag(found.covariance) - 1, below=1e-8)


def test_tolerances_given_the_data_are_between_their_prior_and_what_is_left(run):
    _, _, _, problem, laplace = run
    thetas = np.tile(laplace.theta, (4000, 1))[:1]
    rng = np.random.default_rng(1)
    std = np.array([s.std for s in problem.error.sources])
    mean = np.array([s.mean for s in problem.error.sources])
    unit = np.array([((tolerance_draws(problem, thetas, rng)[0]) - mean) / std for _ in range(300)])
    B = problem.noise_root @ problem.factor
    expected = np.sqrt(np.diag(np.linalg.inv(np.eye(B.shape[1]) + B.T @ B)))
    # 300 draws: a standard deviation to 4 %, the worst of a hundred to four times that
    np.testing.assert_allclose(unit.std(axis=0, ddof=1), expected, rtol=0.2)
    assert np.all(expected <= 1 + 1e-9) and expected.min() < 0.9


class _Still:
    """A generator without chance."""

    def standard_normal(self, shape):
        return np.zeros(shape)


def test_the_middle_of_tolerances_is_what_the_residual_says_beyond_what_is_expected(run, validation):
    checked = validation(what="tolerances given data and parameters, their middle",
                         reference="least squares with the prior as data", why="rounding, in standard deviations")
    *_, problem, laplace = run
    # a mean of its own for every source: the prediction has it, and it must not be taken off once more
    sources = tuple(replace(s, mean=0.3 * s.std) for s in problem.error.sources)
    mean = problem.error.factor @ np.full(len(sources), 0.3)
    answer = replace(problem, error=replace(problem.error, sources=sources, mean=mean))
    thetas = np.array([laplace.theta, laplace.theta * 1.01])
    found = tolerance_draws(answer, thetas, _Still())
    root, B = answer.noise_root, answer.factor
    std = np.array([s.std for s in sources])
    for theta, row in zip(thetas, found, strict=True):
        # least squares of the residual, with the prior as further data
        left = answer.measured - answer.predict(theta)
        expected, *_ = np.linalg.lstsq(
            np.vstack([root @ B, np.eye(len(std))]), np.concatenate([root @ left, np.zeros(len(std))]), rcond=None
        )
        checked.error(row / std - 0.3 - expected, below=1e-8)


@pytest.mark.long
def test_tolerances_move_stress_as_on_all_freedoms(run, validation):
    row = validation(what="tolerances' effect on stress, two of them (long)",
                     reference="differences on all degrees of freedom")
    folder, _, _, problem, laplace = run
    description = read_description(folder / "model.toml")
    full = fatigue_model(description, "model.toml", folder / "fatigue.toml")
    few = full.select([0, 2, len(full.spots) - 1])
    given = FatigueInput(file=folder / "fatigue.toml", problem=problem, laplace=laplace)
    slope = fatigue_files.tolerance_slopes(folder / "model.toml", few, given, {})
    names = [s.name for s in problem.error.sources]
    assert slope.shape == (3, len(names))
    sensors = [k for k, s in enumerate(problem.error.sources) if s.group == "sensors"]
    assert not slope[:, sensors].any()
    chosen = ("tolerance_wall_leg", "tolerance_wall_tower")
    effects = [r.effect for r in problem.model.uncertainty.tolerances if r.effect.name in chosen]
    by_name = {p.name: p for p in problem.model.uncertainty.extended.parameters}
    direction = few.conditions.direction[0].model_copy(update={"share": 1.0})
    wide = fatigue_model(
        extended_description(folder / "model.toml", effects), "model.toml",
        few.conditions.model_copy(update={"direction": (direction,)}),
        parameters=Parameters((*few.parameters, *(by_name[e.name] for e in effects))))
    wide = wide.select(fatigue_files.matching_spots(wide, few))
    neutral = np.array([*laplace.theta, *(e.neutral for e in effects)])
    for k, effect in enumerate(effects):
        step = 0.01 * effect.std * np.eye(len(neutral))[len(laplace.theta) + k]
        up, down = (np.log(wide.solve(neutral + s * step).equivalent_mpa(5.0)) for s in (1, -1))
        exact = (up - down) / (0.02 * effect.std)
        assert np.abs(exact).max() > 1e-3
        row.error((slope[:, names.index(effect.name)] - exact) / np.abs(exact).max(), below=0.01)


def test_matrices_have_no_members_to_fatigue(run, tmp_path):
    folder = run[0]
    rng = np.random.default_rng(2)
    root = rng.standard_normal((12, 12))
    np.savez(
        tmp_path / "model.npz",
        K0=root @ root.T + 50 * np.eye(12),
        M0=np.eye(12),
        K_a=np.diag(np.arange(12.0)),
        channel=np.array(["x", "y"]),
        channel_dof=np.array([0, 1]),
    )
    (tmp_path / "parameters.toml").write_text('[[parameter]]\nname = "a"\ninitial = 1.0\nstd = 0.1\n')
    model = load_model(tmp_path / "model.npz")
    with pytest.raises(InputError, match="stresses are of members: .* export` without --fatigue"):
        export_lifetime(
            RunResults(posterior=posterior(model), model=model, path=tmp_path / "model.npz"),
            tmp_path / "out",
            ExportSettings(n_draw=2),
            fatigue=FatigueInput(file=folder / "fatigue.toml"),
        )


def test_the_command_names_the_mistake_before_it_works(run, capsys):
    folder, model = run[:2]
    write_posterior(posterior(model), folder / "posterior.nc")
    (folder / "bad.toml").write_text((folder / "fatigue.toml").read_text().replace("tp_s", "tp", 1))
    words = ["export", str(folder), "--to", "lifetime", str(folder / "never"), "--fatigue"]
    assert main([*words, str(folder / "bad.toml")]) == 2
    assert "did you mean 'tp_s'?" in capsys.readouterr().err
    assert main([*words, str(folder / "absent.toml")]) == 2
    capsys.readouterr()
    assert main([*words, str(folder / "fatigue.toml"), "--draws", "1"]) == 2
    assert "shows no scatter" in capsys.readouterr().err
    assert not (folder / "never").exists()


def test_one_draw_of_a_farm_s_month_is_refused_before_it_works(run, capsys):
    """It worked for 90 s and then said that FORM had not settled; a farm's own folder had 'no model'."""
    folder, model = run[:2]
    month = folder / "farm" / "A" / "2024-05"
    month.mkdir(parents=True)
    write_posterior(posterior(model), month / "posterior.nc")
    for file in (folder / "farm" / "farm.json", month / "month.json"):
        file.write_text("{}")
    words = ["--to", "lifetime", str(folder / "never"), "--draws", "1", "--fatigue", str(folder / "fatigue.toml")]
    assert main(["export", str(month), *words, "--model", str(folder / "model.toml")]) == 2
    assert "1 shows no scatter of the posterior" in capsys.readouterr().err
    assert main(["export", str(folder / "farm"), *words, "--model", str(folder / "model.toml")]) == 2
    assert "name a month below it, such as A/2024-05" in capsys.readouterr().err
    assert not (folder / "never").exists()
