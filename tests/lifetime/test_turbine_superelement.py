"""Superelements of turbines described by model.toml: with the tower put on again they are the whole turbine."""

import copy

import numpy as np
import pytest
from scipy.linalg import eigh

from probupdate.lifetime.export import ExportSettings, RunResults, export_lifetime
from probupdate.lifetime.superelement import frequencies, read_extptfm, reduce_model
from probupdate.structure.assembly import assemble, supporting_matrices
from probupdate.structure.description_file import parse_description, read_description
from probupdate.structure.load import load_model
from probupdate.structure.substructure import turbine_substructures
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
