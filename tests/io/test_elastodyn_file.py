"""ElastoDyn files: the tower's properties with their factors, rotor and nacelle as one rigid body, mistakes by line."""

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.io.elastodyn_file import read_elastodyn

MAIN = """------- ELASTODYN INPUT FILE -------
--- TURBINE CONFIGURATION ---
3 NumBl - blades
61.0 TipRad - m
1.0 HubRad - m
{cone} PreCone(1) - deg
{cone} PreCone(2) - deg
{cone} PreCone(3) - deg
0.0 HubCM - m
-5.0 OverHang - m
{tilt} ShftTilt - deg
1.5 NacCMxn - m
0.0 NacCMyn - m
1.75 NacCMzn - m
2.0 Twr2Shft - m
87.6 TowerHt - m
{base} TowerBsHt - m
56000.0 HubMass - kg
1.2e5 HubIner - kg m2
240000.0 NacMass - kg
2.6e6 NacYIner - kg m2
0.0 YawBrMass - kg
"blade.dat" BldFile(1) - blade
"blade.dat" BldFile(2) - blade
"blade.dat" BldFile(3) - blade
"tower.dat" TwrFile - tower
"""
TOWER = """------- TOWER -------
2 NTwInpSt - stations
{mass} AdjTwMa - factor
1.0 AdjFASt - factor
1.0 AdjSSSt - factor
--- DISTRIBUTED ---
HtFract TMassDen TwFAStif TwSSStif
(-) (kg/m) (Nm^2) (Nm^2)
0.0 5000.0 6.0e11 6.1e11
1.0 3000.0 1.0e11 1.1e11
"""
BLADE = """------- BLADE -------
2 NBlInpSt - stations
1.0 AdjBlMs - factor
BlFract StrcTwst BMassDen FlpStff EdgStff
(-) (deg) (kg/m) (Nm^2) (Nm^2)
0.0 10.0 300.0 1e9 1e9
1.0 0.0 300.0 1e9 1e9
"""


def write(folder, *, cone=0.0, tilt=0.0, base=20.15, mass=1.0, tower=TOWER, main=MAIN):
    (folder / "tower.dat").write_text(tower.format(mass=mass))
    (folder / "blade.dat").write_text(BLADE)
    path = folder / "ElastoDyn.dat"
    path.write_text(main.format(cone=cone, tilt=tilt, base=base))
    return path


def test_the_tower_has_the_files_columns_with_its_factors(tmp_path):
    tower = read_elastodyn(write(tmp_path, mass=1.1)).tower
    assert (tower.base_m, tower.top_m) == (20.15, 87.6)
    np.testing.assert_allclose(tower.mass_kgpm, [5500, 3300])
    np.testing.assert_allclose(tower.stiffness_ss_nm2, [6.1e11, 1.1e11])


def test_rotor_and_nacelle_are_the_body_by_hand(tmp_path, validation):
    row = validation(what="rotor and nacelle of ElastoDyn", reference="body by hand", why="rounding")
    body = read_elastodyn(write(tmp_path)).rotor_nacelle
    rotor = 56000 + 3 * 300 * 60
    assert body.mass_kg == pytest.approx(240000 + rotor)
    centre = np.array([240000 * 1.5 - 5 * rotor, 0, 240000 * 1.75 + 2 * rotor]) / body.mass_kg
    np.testing.assert_allclose(body.centre_m, centre, atol=1e-9)
    # a blade from 1 to 61 m; the rotor's own inertia about its shaft, half of it about either other axis
    blades = 3 * 300 * (61**3 - 1) / 3
    d = np.array([[1.5, 0, 1.75], [-5.0, 0, 2.0]]) - centre
    m = np.array([240000, rotor])
    offset = (m * (d**2).sum(1)).sum() * np.eye(3) - np.einsum("i,ij,ik->jk", m, d, d)
    own = np.diag([blades + 1.2e5, blades / 2, blades / 2 + 2.6e6 - 240000 * 1.5**2])
    exact = own + offset
    row.error((body.inertia_kgm2 - exact) / np.maximum(np.abs(exact), 1e6), below=1e-9)


def test_tilt_and_cone_move_the_rotor_as_elastodyn_says(tmp_path):
    # hub height = TowerHt + Twr2Shft + OverHang sin(ShftTilt); an upwind cone takes the blades away from the tower
    straight, tilted, coned = (read_elastodyn(write(tmp_path, **k)).rotor_nacelle
                               for k in ({}, {"tilt": -5.0}, {"cone": -2.5}))
    rotor = 56000 + 54000
    assert tilted.centre_m[2] - straight.centre_m[2] == pytest.approx(
        5 * np.sin(np.radians(5)) * rotor / straight.mass_kg, rel=1e-9)
    assert coned.centre_m[0] - straight.centre_m[0] == pytest.approx(
        -31 * np.sin(np.radians(2.5)) * 54000 / straight.mass_kg, rel=1e-9)


@pytest.mark.parametrize(
    ("options", "words_of"),
    [
        ({"main": MAIN.replace("NacMass", "NacMas")}, ["NacMass is missing"]),
        ({"main": MAIN.replace("56000.0 HubMass", "heavy HubMass")}, ["line 18", "'heavy'"]),
        ({"main": MAIN.replace('"tower.dat"', '"none.dat"')}, ["none.dat"]),
        ({"main": MAIN.replace('"tower.dat"', '"../tower.dat"')}, ["leaves"]),
        ({"base": 90.0}, ["not above TowerBsHt"]),
        ({"tower": TOWER.replace("2 NTwInpSt", "3 NTwInpSt")}, ["tower.dat, line 11", "row 3 of 3"]),
        ({"tower": TOWER.replace("1.0 3000.0", "0.9 3000.0")}, ["does not rise from 0 to 1"]),
    ],
)
def test_mistakes_name_the_file(tmp_path, options, words_of):
    with pytest.raises(InputError) as error:
        read_elastodyn(write(tmp_path, **options))
    for words in words_of:
        assert words in str(error.value)
