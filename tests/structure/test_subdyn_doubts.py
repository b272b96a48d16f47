"""What a SubDyn file says and hardly a structure has is said with its line; what is meant so is not."""

import pytest

from probupdate.cli import main
from tests.subdyn_text import STEEL, subdyn

HELD = ["1 1 1 1 1 1 1", "2 1 1 1 1 1 1"]
LEG, BRACE = "1.2 0.05", "0.6 0.02"
JOINTS = ["0 0 0", "10 0 0", "0 0 20", "10 0 20"]
MEMBERS = ["1 3 1 1 1c", "2 4 1 1 1c", "3 4 2 2 1c", "1 4 2 2 1c"]


def notes(folder, capsys, joints=(), members=MEMBERS, leg=STEEL, size=LEG, **sets):
    """Those of a portal frame with a diagonal, by `probupdate modes`."""
    path = folder / "frame.dat"
    path.write_text(subdyn([*JOINTS, *joints], members, HELD, circular=[f"1 {leg} {size}", f"2 {STEEL} {BRACE}"],
                           fem=3, div=2, **sets))
    assert main(["modes", str(path), "--count", "3"]) == 0
    return [line for line in capsys.readouterr().out.splitlines() if "frame.dat, line" in line]


@pytest.mark.parametrize(("changed", "line", "problem"), [
    ({"leg": "2.1e11 8.08e13 7850"}, 56, "make Poisson's ratio -1, "),
    ({"leg": "2.1e11 8.08e9 7850"}, 56, "make Poisson's ratio 12, "),
    ({"leg": "2.1e11 8.08e10 7850", "size": "1200 50"}, 56, "the section of member 1 is 1200 m wide"),
    ({"leg": "2.1e11 8.08e10 7.85"}, 56, "MatDens 7.85 is little for a stiffness of 2.1e+11"),
    ({"members": [*MEMBERS, "4 3 2 2 1c"]}, 52, "member 5 joins the joints of member 3 (line 50) again"),
    ({"mass": ["4 2e4 0 0 0 0 0 0 0 0 0"] * 2}, 87, "the concentrated mass of joint 4 in line 86 is listed again"),
    # a joint drawn twice; one that hangs on a leg without an end of it there; one inside a beam listed whole and halved
    ({"joints": ["0 0 20.001"], "members": ["1 5 1 1 1c", *MEMBERS[1:]]}, 32, "joint 3 stands within member 1"),
    ({"joints": ["0.1 0 10"], "members": [*MEMBERS, "5 2 2 2 1c"]}, 34,
     "joint 5 stands within member 1 (line 49), 0.1 m from"),
    ({"joints": ["5 0 20"], "members": [*MEMBERS, "3 5 2 2 1c", "5 4 2 2 1c"]}, 34, "joint 5 stands within member 3"),
])
def test_an_odd_row_is_said_with_its_line(changed: dict, line: int, problem: str, tmp_path, capsys):
    said = notes(tmp_path, capsys, **changed)
    assert len(said) == 1
    assert f"frame.dat, line {line}" in said[0] and problem in said[0]


def soil_notes(folder, capsys, *terms):
    """What `modes` ends with and says of a frame on soil whose file has these terms beside its diagonal."""
    diagonal = ("5e8 Kxx", "5e8 Kyy", "2e9 Kzz", "1e10 Ktxtx", "1e10 Ktyty", "1e9 Ktztz")
    (folder / "soil.txt").write_text("\n".join((*diagonal, *terms)))
    path = folder / "frame.dat"
    path.write_text(subdyn(JOINTS, MEMBERS, [f'{j} 0 0 0 0 0 0 "soil.txt"' for j in (1, 2)],
                           circular=[f"1 {STEEL} {LEG}", f"2 {STEEL} {BRACE}"]))
    code, said = main(["modes", str(path), "--count", "3"]), capsys.readouterr()
    return code, [line for line in (said.out + said.err).splitlines() if "soil.txt" in line]


@pytest.mark.parametrize(("terms", "words"), [
    (["-2e9 Kxty", "2e9 Kytx"], ""), (["2e9 Kxty", "2e9 Kytx"], "Kxty is above zero"),
    (["-2e9 Kxty", "-2e9 Kytx"], "Kytx is below zero"),
])
def test_soil_that_turns_against_a_push_is_said(terms: list, words: str, tmp_path, capsys):
    code, said = soil_notes(tmp_path, capsys, *terms)
    assert code == 0
    assert [words in line for line in said] == ([True] if words else [])


@pytest.mark.parametrize("terms", [["-3e9 Kxty"], ["-1e5 Mxx"]])
def test_soil_below_zero_for_some_motion_is_refused(terms: list, tmp_path, capsys):
    code, said = soil_notes(tmp_path, capsys, *terms)
    assert code == 2
    assert "below zero for some motion" in said[0]


@pytest.mark.parametrize("changed", [
    {}, {"leg": "2.1e11 7e10 0"},
    # a leg in pieces shorter than it is thick, a brace that ends on it by a stub and by a rigid link, a joint of spring
    {"joints": ["0 0 20.1", "0 0 20.2"], "members": [*MEMBERS, "3 5 1 1 1c", "5 6 1 1 1c"]},
    {"joints": ["0.3 0 20.2", "5 0 25"], "members": [*MEMBERS, "3 5 2 2 1c", "5 6 2 2 1c"]},
    {"joints": ["0.5 0 20", "5 0 25"], "members": [*MEMBERS, "3 5 1 1 3", "5 6 2 2 1c"], "rigid": ["1 0"]},
    {"joints": ["0 0 20"], "members": ["1 5 1 1 1c", *MEMBERS[1:], "5 3 1 1 5"],
     "spring": ["1 1e9 0 0 0 0 0 1e9 0 0 0 0 1e9 0 0 0 1e9 0 0 1e9 0 1e9"]},
])
def test_what_a_structure_may_have_is_not_said(changed: dict, tmp_path, capsys):
    assert notes(tmp_path, capsys, **changed) == []


@pytest.mark.parametrize(("key", "value", "problem"), [
    ("shear_modulus_pa", "8.08e9", "tower.shear_modulus_pa: makes Poisson's ratio 12 with youngs_modulus_pa"),
    ("density_kgpm3", "7.85", "7.85 is outside 500 to 25000"),
])
def test_a_tower_of_no_material_is_refused(key: str, value: str, problem: str, tmp_path, capsys):
    notes(tmp_path, capsys)
    tower = {"youngs_modulus_pa": "2.1e11", "shear_modulus_pa": "8.08e10", "density_kgpm3": "7850.0"} | {key: value}
    path = tmp_path / "model.toml"
    path.write_text("[subdyn]\nfile = \"frame.dat\"\n[tower]\njoint = 4\ntop_m = 80.0\nelements = 4\n"
                    "fraction = [0.0, 1.0]\n"
                    "mass_kgpm = [3e3, 2e3]\nstiffness_fa_nm2 = [6e10, 3e10]\nstiffness_ss_nm2 = [6e10, 3e10]\n"
                    + "".join(f"{k} = {v}\n" for k, v in tower.items())
                    + "[rotor_nacelle]\nmass_kg = 2e5\ncentre_m = [0.0, 0.0, 2.0]\n"
                      "inertia_kgm2 = [1e6, 1e6, 1e6, 0.0, 0.0, 0.0]\n")
    assert main(["modes", str(path)]) == 2
    assert problem in capsys.readouterr().err
