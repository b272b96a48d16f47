"""ElastoDyn's platform and yaw are used; what is not used is said; the documents list every key."""

import re
from pathlib import Path

import numpy as np
import pytest

import probupdate
from probupdate.errors import InputError
from probupdate.io.elastodyn_file import NACELLE, PLATFORM, read_elastodyn
from probupdate.io.elastodyn_keys import UNUSED, UNUSED_COLUMNS, WITHOUT_EFFECT
from probupdate.modal.modes import Sensor
from probupdate.structure.load import load_model
from tests.io.test_elastodyn_file import MAIN, TOWER, write
from tests.subdyn_text import subdyn

PAGE = Path(__file__).resolve().parents[2] / "docs" / "formats" / "openfast.md"
PLATFORM_LINES = """666000.0 PtfmMass - kg
0.5 PtfmCMxt - m
-0.25 PtfmCMyt - m
16.15 PtfmCMzt - m
6.0e6 PtfmRIner - kg m2
7.0e6 PtfmPIner - kg m2
1.02e7 PtfmYIner - kg m2
"""
LEGS = ((5.0, 5.0), (-5.0, 5.0), (-5.0, -5.0), (5.0, -5.0))


def jacket(folder, *, rows=(), interface=(5,), tops=False):
    """Four legs to one joint at z = 20.15, or (`tops`) to four joints at z = 18."""
    feet = [f"{2 * x} {2 * y} -30" for x, y in LEGS]
    if tops:
        joints, members = feet + [f"{x} {y} 18" for x, y in LEGS], [f"{k} {k + 4} 1 1 1c 0" for k in (1, 2, 3, 4)]
        members += [f"{k} {5 + (k - 4) % 4} 1 1 1c 0" for k in (5, 6, 7, 8)]
    else:
        joints, members = [*feet, "0 0 20.15"], [f"{k} 5 1 1 1c 0" for k in (1, 2, 3, 4)]
    (folder / "jacket.dat").write_text(subdyn(joints, members, [f"{k} 1 1 1 1 1 1" for k in (1, 2, 3, 4)],
                                              interface=interface, circular=["1 2.1e11 8.08e10 7850 1.2 0.04"],
                                              mass=rows))


def model(folder, joint=5, elements=8):
    stands = "" if joint is None else f"joint = {joint}\n"
    path = folder / "model.toml"
    path.write_text(f'[subdyn]\nfile = "jacket.dat"\n[tower]\nelastodyn = "ElastoDyn.dat"\n{stands}'
                    f"elements = {elements}\n"
                    "youngs_modulus_pa = 2.1e11\nshear_modulus_pa = 8.08e10\ndensity_kgpm3 = 8500.0\n")
    return probupdate.model_modes(path, 8)


def test_the_platform_is_a_mass_at_the_interface(tmp_path, validation):
    row = validation(what="ElastoDyn's PtfmMass, inertia and centre at SubDyn's interface: eight frequencies",
                     reference="the same as a row of SubDyn's masses", why="eigensolver")
    write(tmp_path)
    jacket(tmp_path)
    bare = model(tmp_path).frequency_hz
    # the centre counts from mean sea level, the row's offset from its joint
    jacket(tmp_path, rows=["5 666000 6.0e6 7.0e6 1.02e7 0 0 0 0.5 -0.25 -4.0"])
    expected = model(tmp_path).frequency_hz
    jacket(tmp_path)
    write(tmp_path, main=MAIN + PLATFORM_LINES)
    found = model(tmp_path)
    row.error(found.frequency_hz / expected - 1, below=1e-9)
    assert np.abs(bare / expected - 1).max() > 0.1
    assert any("PtfmMass 666000 kg" in note and "joint 5" in note for note in found.notes)


def test_a_mass_in_both_files_is_pointed_at(tmp_path):
    write(tmp_path, main=MAIN + PLATFORM_LINES)
    jacket(tmp_path, rows=["5 666000 6.0e6 7.0e6 1.02e7"])
    assert any("not the same one" in note for note in model(tmp_path).notes)


def test_products_of_inertia_are_the_tensors_own(tmp_path):
    more = "1.0e5 PtfmXYIner - kg m2\n2.0e5 PtfmYZIner - kg m2\n3.0e5 PtfmXZIner - kg m2\n"
    platform = read_elastodyn(write(tmp_path, main=MAIN + PLATFORM_LINES + more)).platform
    np.testing.assert_array_equal(platform.inertia_kgm2,
                                  [[6.0e6, 1e5, 3e5], [1e5, 7.0e6, 2e5], [3e5, 2e5, 1.02e7]])


def test_without_a_joint_the_tower_stands_on_all_interface_joints(tmp_path):
    write(tmp_path, main=MAIN + PLATFORM_LINES)
    jacket(tmp_path, tops=True, interface=(5, 6, 7, 8))
    found = model(tmp_path, joint=None)
    # the same by hand: a ninth joint, massless rigid links, the mass in SubDyn's own table
    write(tmp_path)
    joints = [f"{2 * x} {2 * y} -30" for x, y in LEGS] + [f"{x} {y} 18" for x, y in LEGS] + ["0 0 20.15"]
    members = [f"{k} {k + 4} 1 1 1c 0" for k in (1, 2, 3, 4)]
    members += [f"{k} {5 + (k - 4) % 4} 1 1 1c 0" for k in (5, 6, 7, 8)]
    members += [f"9 {k} 3 3 3 -1" for k in (5, 6, 7, 8)]
    (tmp_path / "jacket.dat").write_text(subdyn(
        joints, members, [f"{k} 1 1 1 1 1 1" for k in (1, 2, 3, 4)], interface=(9,), rigid=["3 0.0"],
        circular=["1 2.1e11 8.08e10 7850 1.2 0.04"], mass=["9 666000 6.0e6 7.0e6 1.02e7 0 0 0 0.5 -0.25 -4.0"]))
    np.testing.assert_allclose(found.frequency_hz, model(tmp_path, joint=9).frequency_hz, rtol=1e-9)


def test_without_a_joint_or_an_interface_the_tower_has_no_place(tmp_path):
    write(tmp_path)
    jacket(tmp_path, interface=())
    with pytest.raises(InputError, match="no interface joints"):
        model(tmp_path, joint=None)


def test_the_nacelle_looks_where_nacyaw_says(tmp_path):
    straight = read_elastodyn(write(tmp_path))
    turned = read_elastodyn(write(tmp_path, main=MAIN + "90.0 NacYaw - deg\n"))
    assert turned.yaw_deg == 90.0
    x, y, z = straight.rotor_nacelle.centre_m
    np.testing.assert_allclose(turned.rotor_nacelle.centre_m, [-y, x, z], atol=1e-12)
    xx, yy = straight.rotor_nacelle.inertia_kgm2[[0, 1], [0, 1]]
    np.testing.assert_allclose(turned.rotor_nacelle.inertia_kgm2[[0, 1], [0, 1]], [yy, xx], rtol=1e-12)
    # on a structure alike in x and y the modes turn with it, their frequencies stay
    jacket(tmp_path)
    round_tower = TOWER.replace("6.1e11", "6.0e11").replace("1.1e11", "1.0e11")
    write(tmp_path, tower=round_tower)
    one = model(tmp_path)
    write(tmp_path, tower=round_tower, main=MAIN + "90 NacYaw - deg\n")
    two = model(tmp_path)
    np.testing.assert_allclose(two.frequency_hz, one.frequency_hz, rtol=1e-9)
    assert one.labels[:2] != two.labels[:2] and any("NacYaw turns" in note for note in two.notes)


def test_a_stated_heading_counts_from_x_of_an_upwind_rotor_too(tmp_path):
    """OpenFAST's x points downwind: as the file is, the nacelle looks along -x."""
    jacket(tmp_path)
    write(tmp_path)
    model(tmp_path)
    sensors = [Sensor(channel=f"y{x}", level="tower", position_m=[x, 0, 60], direction=[0, 1, 0]) for x in (-1, 1)]
    own, there, back = (load_model(tmp_path / "model.toml", sensors=sensors, nacelle_angle_deg=a).solve(np.zeros(0), 6)
                        for a in (None, 180.0, 0.0))
    np.testing.assert_allclose(there.shape, own.shape, atol=1e-12)
    np.testing.assert_allclose(back.frequency_hz, own.frequency_hz, rtol=1e-9)
    # turned round, what moved more moves less
    np.testing.assert_allclose(np.abs(back.shape[::-1]), np.abs(own.shape), atol=1e-9)
    assert np.abs(np.abs(back.shape) - np.abs(own.shape)).max() > 1e-6


def test_the_towers_concentrated_masses_are_where_the_file_has_them(tmp_path):
    """Beside the same masses as a short thick piece of the tower."""
    jacket(tmp_path)
    point = "--- CONCENTRATED ---\n2 NTwCMass - number\nHtFract TwCMass\n(-) (kg)\n0.42 60000\n1.0 0.0\n"
    # 60 t on 1 % of 67.45 m, and as little again where it begins and ends
    bump = "".join(f"{f} {4160 + extra} 3.9e11 4.0e11\n" for f, extra in (
        (0.4149, 0), (0.4151, 88955), (0.4249, 88955), (0.4251, 0)))
    found = {}
    for name, tower in (("bare", TOWER), ("point", TOWER + point), ("piece", TOWER.replace(
            "2 NTwInpSt", "6 NTwInpSt").replace("1.0 3000.0", bump + "1.0 3000.0"))):
        write(tmp_path, tower=tower.replace("6.0e11 6.1e11", "3.9e11 4.0e11").replace("1.0e11 1.1e11", "3.9e11 4.0e11"))
        found[name] = model(tmp_path, elements=60).frequency_hz[:6]
    np.testing.assert_allclose(found["point"], found["piece"], rtol=2e-3)
    assert np.abs(found["point"] / found["bare"] - 1).max() > 0.05
    write(tmp_path, tower=TOWER + point.replace("0.42", "1.42"))
    with pytest.raises(InputError, match="not between 0 and 1"):
        read_elastodyn(tmp_path / "ElastoDyn.dat")


@pytest.mark.parametrize(("old", "new", "said"), [
    ("240000.0 NacMass", "-1.0 NacMass", "NacMass is -1"),
    ("2.6e6 NacYIner", "1e5 NacYIner", "below the 540000 kg m2"),
])
def test_masses_of_no_body_are_refused(tmp_path, old, new, said):
    with pytest.raises(InputError, match=said):
        read_elastodyn(write(tmp_path, main=MAIN.replace(old, new)))


@pytest.mark.parametrize(("line", "said"), [
    ("534.116 GenIner - kg m2", "GenIner (534.116) is not used: the shaft is held"),
    ("1.2 FAStTunr(1) - factor", "FAStTunr(1) (1.2) is not used"),
    ("3.0 PtfmHeave - m", "PtfmHeave (3.0) is not used"),
    ("17.0 NewMass - kg", "NewMass (17.0) is not known here and not used"),
    ("17.0 NewMass", "NewMass (17.0) is not known here and not used"),
    ("False SomeFlag - later than this reader", "SomeFlag (False) is not known here and not used"),
])
def test_a_key_that_is_not_used_is_said_with_its_effect(tmp_path, line, said):
    notes = read_elastodyn(write(tmp_path, main=f"{MAIN}{line}\n")).notes
    assert len(notes) == 1 and said in notes[0] and "ElastoDyn.dat, line" in notes[0]


def test_keys_without_effect_and_neutral_values_are_not_said(tmp_path):
    more = "0.0 GenIner - kg m2\nTrue TwFADOF1 - flag\n9.8 Gravity - m/s2\n12.1 RotSpeed - rpm\nFalse Furling - flag\n"
    assert read_elastodyn(write(tmp_path, main=MAIN + more)).notes == ()


@pytest.mark.parametrize("old", ["(", ""], ids=["BldFile(3)", "BldFile3"])
def test_a_third_blades_lines_in_a_file_of_two_are_not_said(tmp_path, old):
    tips = "".join(f"1.0 TipMass({k}) - kg\n" for k in (1, 2, 3))
    main = MAIN.replace("3 NumBl", "2 NumBl") if old else MAIN.replace("3 NumBl", "2 NumBl").replace(
        "BldFile(1)", "BldFile1").replace("BldFile(2)", "BldFile2").replace("BldFile(3)", "BldFile3")
    assert read_elastodyn(write(tmp_path, main=main + tips)).notes == ()


def test_columns_of_older_tower_files_are_said(tmp_path):
    tower = TOWER.replace("TwSSStif\n", "TwSSStif TwGJStif\n").replace("6.1e11", "6.1e11 4e11").replace(
        "1.1e11", "1.1e11 8e10")
    (note,) = read_elastodyn(write(tmp_path, tower=tower)).notes
    assert "TwGJStif is not used" in note and "tower.dat" in note


def test_a_heading_with_a_keys_name_is_no_key(tmp_path):
    """Every file as OpenFAST's own tools write it has the heading FURLING above the key."""
    heading = "---------------------- FURLING ------------------------\n"
    assert read_elastodyn(write(tmp_path, main=f"{MAIN}{heading}False Furling - flag\n")).notes == ()


@pytest.mark.parametrize(("overhang", "yaw", "looks"), [(-5.0, 0.0, 180.0), (5.0, 0.0, 0.0), (-5.0, 30.0, 210.0)])
def test_an_upwind_rotor_looks_against_x(tmp_path, overhang, yaw, looks):
    """ElastoDyn's x axis points downwind."""
    main = re.sub(r"\S+ OverHang", f"{overhang} OverHang", MAIN) + f"{yaw} NacYaw - deg\n"
    assert read_elastodyn(write(tmp_path, main=main)).looks_deg == looks


def test_a_furling_turbine_is_refused(tmp_path):
    with pytest.raises(InputError, match="FurlFile, which is not read"):
        read_elastodyn(write(tmp_path, main=MAIN + "True Furling - flag\n"))


def test_the_documents_list_every_key():
    page = PAGE.read_text(encoding="utf-8")
    missing = [name for name in (*NACELLE, *PLATFORM, *UNUSED, *UNUSED_COLUMNS, *WITHOUT_EFFECT, "NacYaw", "Furling")
               if f"`{name}`" not in page]
    assert not missing
