"""Superelements of turbines described by model.toml: with the tower put on again they are the whole turbine."""

import copy

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

import probupdate
from probupdate.lifetime.export import ExportSettings, RunResults, export_lifetime
from probupdate.lifetime.superelement import frequencies, read_extptfm, reduce_model
from probupdate.structure.assembly import assemble, supporting_matrices
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.load import load_model
from probupdate.structure.substructure import split, turbine_substructures
from probupdate.structure.turbine_frame import build_frame
from tests.lifetime.test_export import posterior
from tests.lifetime.test_fatigue_export import toml
from tests.small_turbine import small_turbine


@pytest.mark.parametrize("scour", [0.0, 2.0])
def test_a_turbines_superelement_with_its_tower_is_the_turbine(scour, validation):
    row = validation(what="Craig-Bampton superelement of a turbine below its tower, tower added: six frequencies",
                     reference="the whole turbine", why="truncation")
    raw = copy.deepcopy(small_turbine())
    next(p for p in raw["parameter"] if p["name"] == "sc")["initial"] = scour
    d = parse_description(raw, "model.toml")
    frame = build_frame(d)
    gravity = d.site.gravity_mps2 if d.mesh.geometric_stiffness else None
    whole = assemble(frame, updated=(), values=d.values, theory=d.mesh.theory, gravity_mps2=gravity)
    K, M = (sum(terms).toarray() for terms in (whole.stiffness, whole.mass))
    expected = np.sqrt(1 / eigh(M, K, eigvals_only=True)[::-1][:6]) / (2 * np.pi)
    # the tower by what is left of the whole, on the degrees of freedom of its own nodes and its foot
    below = turbine_substructures(d, ())({})
    kept = np.isin(np.arange(len(frame.node_m)) + 1, below.joints)
    own = supporting_matrices(frame, d.values, kept, theory=d.mesh.theory, gravity_mps2=gravity)
    columns = np.array([np.flatnonzero(abs(whole.transform[:, [c]]).toarray().ravel() > 0)[0]
                        for c in range(whole.transform.shape[1])])
    inside = np.flatnonzero(kept[columns // 6])
    rest_K, rest_M = K.copy(), M.copy()
    rest_K[np.ix_(inside, inside)] -= own[0].toarray()
    rest_M[np.ix_(inside, inside)] -= own[1].toarray()
    one = reduce_model(below, n_mode=25)
    foot = np.flatnonzero(np.all(frame.node_m == below.reference_m, axis=1))[0]
    at_foot = np.flatnonzero(columns // 6 == foot)
    above = np.flatnonzero(~kept[columns // 6])
    n = len(one.mass)
    place = np.concatenate([at_foot, above])
    total = []
    for matrix, rest in ((one.stiffness, rest_K), (one.mass, rest_M)):
        joined = np.zeros((n + len(above),) * 2)
        joined[:n, :n] = matrix
        at = np.ix_(np.r_[0:6, n : n + len(above)], np.r_[0:6, n : n + len(above)])
        joined[at] += rest[np.ix_(place, place)]
        total.append(joined)
    # nothing of the rest is anywhere else
    outside = np.setdiff1d(np.arange(len(K)), place)
    assert np.abs(rest_K[outside]).max() < 1e-9 * np.abs(K).max()
    found = np.sqrt(1 / eigh(total[1], total[0], eigvals_only=True)[::-1][:6]) / (2 * np.pi)
    row.error(found / expected - 1, below=1e-3)
    assert one.truncation.min() > -1e-9 and one.truncation[:2].max() < 1e-3


def test_the_export_of_a_turbine_has_superelements_of_every_draw(tmp_path):
    raw = copy.deepcopy(small_turbine())
    for p in raw["parameter"]:
        p["update"] = p["name"] in ("k_j", "py", "m_h")
    (tmp_path / "model.toml").write_text(toml(raw))
    model = load_model(tmp_path / "model.toml")
    results = RunResults(posterior=posterior(model), model=model, path=tmp_path / "model.toml")
    done = export_lifetime(results, tmp_path / "out", ExportSettings(n_draw=2, n_mode=6))
    assert not any("superelements" in text for text in done.left_out) and 0 <= done.truncation < 0.05
    assert any("substructure.dat" in text and "HydroDyn" in text for text in done.left_out)
    assert all((done.folder / "models" / k / "substructure.dat").is_file() for k in ("001", "002"))
    for k in (1, 2):
        read = read_extptfm(done.folder / "superelements" / f"{k:03d}.cb.dat")
        drawn = read_description(done.folder / "models" / f"{k:03d}" / "model.toml")
        own = reduce_model(turbine_substructures(drawn, ())({}), n_mode=6)
        np.testing.assert_allclose(frequencies(read["Stiffness"], read["Mass"])[:6], own.frequency_hz, rtol=1e-6)
    # the draws differ in the jacket's stiffness, and so do they
    guyan = [read_extptfm(done.folder / "superelements" / f"00{k}.guyan.dat")["Stiffness"][0, 0] for k in (1, 2)]
    assert abs(guyan[0] / guyan[1] - 1) > 1e-4


def beam_on_soil(d, bending, softer, level_m):
    """(2, 2) stiffness of the template's monopile with its transition piece against surge and pitch at a level: a beam
    in API's clay, integrated from its free tip upwards, its modulus times `bending`, p-y divided by `softer`."""
    stations, connection, piece = d.monopile.station, d.transition_piece.bottom_m, d.transition_piece
    soil, deep = d.soil, d.site.mudline_m

    def slopes(z, y):
        size = [np.interp(z, [s.z_m for s in stations], [getattr(s, name) for s in stations])
                for name in ("diameter_m", "thickness_m")]
        outer, wall = size if z < connection else (piece.tube.diameter_m, piece.tube.thickness_m)
        rigidity = (bending if z < connection else 1.0) * d.steel.youngs_modulus_pa * np.pi / 64 * (
            outer**4 - (outer - 2 * wall) ** 4)
        strength = soil.undrained_shear_strength_pa
        strength = strength.at_mudline + strength.gradient_per_m * (deep - z)
        wedge = 3 * strength + (soil.submerged_unit_weight_npm3 + soil.matlock_j * strength / outer) * (deep - z)
        # the first point of API's p-y curve, 0.23 p_u at 0.1 y_c
        held = 2.3 * np.minimum(wedge, 9 * strength) / (2.5 * soil.strain_50) / softer if z < deep else 0.0
        y = y.reshape(4, 2)
        return np.array([y[1], y[2] * 1e9 / rigidity, y[3], -held * y[0] / 1e9]).ravel()

    y = np.vstack([np.eye(2), np.zeros((2, 2))])
    edges = sorted({*(s.z_m for s in stations), connection, level_m})
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        run = solve_ivp(slopes, (low, high - 1e-9), y.ravel(), rtol=1e-10, atol=1e-12)
        y = run.y[:, -1].reshape(4, 2)
        if high == connection:
            y[1] += y[2] * 1e9 / piece.flange.bending_stiffness_nmprad
    return 1e9 * np.array([-y[3], y[2]]) @ np.linalg.inv(y[:2])


def test_a_monopiles_superelements_have_the_stiffness_of_a_beam_in_its_soil(tmp_path, validation):
    probupdate.template("monopile", tmp_path / "own")
    path = tmp_path / "own" / "model.toml"
    text = path.read_text().replace('theory = "timoshenko"', 'theory = "bernoulli-euler"')
    text = text.replace("geometric_stiffness = true", "geometric_stiffness = false").replace("pile = 6", "pile = 20")
    path.write_text(text)
    model = load_model(path)
    results = RunResults(posterior=posterior(model), model=model, path=path)
    done = export_lifetime(results, tmp_path / "out", ExportSettings(n_draw=2, n_mode=6))
    row = validation(what="Guyan superelement of two draws of a monopile with transition piece: surge and pitch",
                     reference="own beam in API's clay, integrated upwards (scipy)", why="tapered elements")
    names, draws = model.parameters.names, done.draws
    assert {"k_p", "py"} <= set(names) and abs(draws[0, names.index("py")] / draws[1, names.index("py")] - 1) > 0.01
    d = read_description(path)
    for k, draw in enumerate(draws):
        value = dict(zip(names, draw, strict=True))
        expected = beam_on_soil(d, value["k_p"], value["py"], 15.0)
        read = read_extptfm(done.folder / "superelements" / f"{k + 1:03d}.guyan.dat")["Stiffness"]
        row.error(read[np.ix_([0, 4], [0, 4])] / expected - 1, below=2e-3)


def test_softening_by_terms_is_that_of_a_frame_assembled_at_the_values(tmp_path):
    """The weight's, which follows masses and stiffnesses; also where a parameter adds to it."""
    probupdate.template("monopile", tmp_path / "own")
    path = tmp_path / "own" / "model.toml"
    path.write_text(path.read_text() + '\n[[parameter]]\nname = "w"\nkind = "weight"\nunit = "-"\ninitial = 0.5\n'
                    'std = 0.1\nupdate = true\n')
    d = read_description(path)
    names, frame = ("k_p", "k_t", "m_h", "py", "w"), build_frame(d)
    at, (above, _) = turbine_substructures(d, names), split(frame, d.name)
    assert d.mesh.geometric_stiffness
    for factor in (1.0, 0.8, 1.3):
        values = {name: factor * d.values[name] for name in names}
        expected = supporting_matrices(frame, d.values | values, ~above, theory=d.mesh.theory,
                                       gravity_mps2=d.gravity_mps2)
        found = at(values)
        for own, other in ((found.stiffness, expected[0]), (found.mass, expected[1])):
            assert abs(own - other).max() < 1e-12 * abs(other).max()
    without = supporting_matrices(frame, d.values | values, ~above, theory=d.mesh.theory, gravity_mps2=None)[0]
    assert abs(found.stiffness - without).max() > 1e-6 * abs(without).max()
