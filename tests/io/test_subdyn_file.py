"""SubDyn input files are read in every layout, mistakes name file and line, and writing loses nothing."""

from pathlib import Path

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.io.ssi_file import PLACES, read_ssi, scaled_ssi, write_ssi
from probupdate.io.subdyn_file import read_subdyn, write_subdyn
from tests.subdyn_text import STEEL, subdyn

OC4 = Path(__file__).resolve().parents[3] / "shared" / "reference" / "oc4"
needs_oc4 = pytest.mark.skipif(not OC4.exists(), reason="the OC4 input files of ../shared/reference/oc4 are not here")


def write(folder, text, soil="5.0E+08\tKxx ! lateral\n! a comment\nKyy 6.0D8\n1e9 Kzz\n2e3 Mxx\n"):
    (folder / "soil.txt").write_text(soil)
    path = folder / "structure.dat"
    path.write_text(text)
    return path


def cantilever(layout="v5", **more):
    kind = "1 -1" if layout == "v4.0" else "1c 0"
    options = {"reactions": ["1 0 0 0 1 1 1 \"soil.txt\" ! held against turning"], "interface": [2],
               "circular": [f"7 {STEEL} 1.0 0.02 extra words"]} | more
    return subdyn(["0 0 0", "0 0 10"], [f"1 2 7 7 {kind}"], layout=layout, **options)


@pytest.mark.parametrize("layout", ["v4.0", "v4.1", "v5"])
def test_every_layout_is_told_by_what_stands_where(tmp_path, layout):
    file = read_subdyn(write(tmp_path, cantilever(layout, mass=["2 10 1 2 3", "2 5 1 2 3 .4 .5 .6 .7 .8 .9"])))
    assert file.layout == layout
    assert [j.position_m for j in file.joints] == [(0, 0, 0), (0, 0, 10)]
    assert file.members[0].kind == "circular" and file.members[0].sets == (7, 7)
    assert file.sets["circular"][0].values == (2.1e11, 8.076923e10, 7850, 1.0, 0.02)
    assert file.masses[0].values == (10, 1, 2, 3, 0, 0, 0, 0, 0, 0)
    assert file.masses[1].values == (5, 1, 2, 3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
    assert file.reactions[0].fixed == (False, False, False, True, True, True)
    soil = file.soil["soil.txt"]
    assert soil.stiffness[0, 0] == 5e8 and soil.stiffness[1, 1] == 6e8 and soil.mass[0, 0] == 2e3


def test_modes_have_damping_ratios_of_their_own(tmp_path):
    # openfast_io 5.0.0 keeps the first alone (findings/openfast_io_damping.sh)
    for row in ("0.5 2.0 5.0", "0.5, 2.0, 5.0"):
        text = cantilever().replace("             0   Nmodes", "             3   Nmodes")
        file = read_subdyn(write(tmp_path, text.replace("             1   JDampings", f"{row}   JDampings")))
        assert file.settings["JDampings"] == "0.5 2.0 5.0"


def test_older_files_have_lines_and_tables_of_their_own(tmp_path):
    text = cantilever("v4.0")
    text = text.replace("--- FEA", "False GuyanLoadCorrection - old\n--- FEA").replace(
        "             0   Nmodes", "True CBMod - old\n             0   Nmodes")
    assert read_subdyn(write(tmp_path, text)).settings["CBMod"] == "True"
    # before springs, and before cables, rigid links and joints that turn
    spring = text.index("---- SPRING")
    no_spring = text[:spring] + text[text.index("---- MEMBER COSINE") :]
    assert read_subdyn(write(tmp_path, no_spring)).layout == "v3"
    plain = no_spring[: no_spring.index("---- CABLE")] + no_spring[no_spring.index("---- MEMBER COSINE") :]
    plain = plain.replace("1 0 0 0 1 0 0 0 0", "1 0 0 0").replace("2 0 0 10 1 0 0 0 0", "2 0 0 10").replace(
        "1 1 2 7 7 1 -1", "1 1 2 7 7").replace("  2 1 1 1 1 1 1\n", "  2\n")
    oldest = read_subdyn(write(tmp_path, plain))
    assert oldest.layout == "v3" and oldest.members[0].kind == "circular" and oldest.joints[1].kind == "cantilever"


def test_headings_are_free_text_and_lines_may_end_as_on_windows(tmp_path):
    text = "\n".join("--- something" if line.startswith("---") else line for line in cantilever("v4.1").split("\n"))
    path = write(tmp_path, "")
    path.write_bytes(text.replace("\n", "\r\n").encode("latin-1"))
    assert read_subdyn(path).layout == "v4.1"


@pytest.mark.parametrize("layout", ["v4.0", "v4.1", "v5"])
def test_a_round_trip_loses_nothing(tmp_path, layout):
    file = read_subdyn(write(tmp_path, cantilever(layout)))
    out = write_subdyn(file, tmp_path / "again" / "copy.dat") if (tmp_path / "again").mkdir() is None else None
    again = read_subdyn(out)
    assert out.read_text() == (tmp_path / "structure.dat").read_text()
    assert (tmp_path / "again" / "soil.txt").read_text() == (tmp_path / "soil.txt").read_text()
    for name in ("layout", "settings", "joints", "reactions", "interfaces", "members", "sets", "masses", "cosines"):
        assert getattr(again, name) == getattr(file, name)


def test_a_scaled_soil_file_is_read_back_as_it_was_meant(tmp_path):
    file = read_subdyn(write(tmp_path, cantilever())).soil["soil.txt"]
    stiffness = np.arange(36.0).reshape(6, 6)
    stiffness = stiffness + stiffness.T + 500.0 * np.eye(6)
    again = read_ssi(write_ssi(scaled_ssi(file, stiffness, file.mass), tmp_path / "new.txt"))
    np.testing.assert_array_equal(again.stiffness, stiffness)
    np.testing.assert_array_equal(again.mass, file.mass)
    assert "! lateral" in (tmp_path / "new.txt").read_text() and len(PLACES) == 21


@pytest.mark.parametrize(
    ("old", "new", "words_of"),
    [
        ("STRUCTURE JOINTS ----\n   2 ", "STRUCTURE JOINTS ----\n   3 ", ["row 3 of 3 of the joints", "NJoints"]),
        ("STRUCTURE JOINTS ----\n   2 ", "STRUCTURE JOINTS ----\n   x ", ["line"]),
        ("2 0 0 10 1 0 0 0 0", "2 0 0 ten 1 0 0 0 0", ["line 31", "3 numbers", "'ten'"]),
        ("2 0 0 10 1 0 0 0 0", "1 0 0 10 1 0 0 0 0", ["line 31", "joint 1 stands in line 30"]),
        ("2 0 0 10 1 0 0 0 0", "2 0 0 10 5 0 0 0 0", ["line 31", "type 5", "2 universal"]),
        ("1 1 2 7 7 1c 0", "1 1 3 7 7 1c 0", ["member 1", "joint 3", "not among the joints"]),
        ("1 1 2 7 7 1c 0", "1 1 2 7 8 1c 0", ["circular property set 8"]),
        ("1 1 2 7 7 1c 0", "1 1 2 7 7 1x 0", ["type '1x'", "1c"]),
        ("1 1 2 7 7 1c 0", "1 1 2 7 7 3 0", ["rigid property set 7"]),
        ("1 0 0 0 1 1 1", "1 0 0 0 1 1", ["not a flag of joint 1"]),
        ("1 0 0 0 1 1 1", "9 0 0 0 1 1 1", ["reaction joint 9"]),
        ("1.0 0.02 extra", "1.0 0.52 extra", ["wall 0.52 is thicker than half"]),
        ("1.0 0.02 extra", "0.0 0.02 extra", ["XsecD of a circular set is 0"]),
        ("2.1e11", "-2.1e11", ["YoungE", "above zero"]),
        ("soil.txt", "none.txt", ["no SSI file 'none.txt'"]),
        ("soil.txt", "../soil.txt", ["leaves the folder"]),
        ("FEMMod", "FEMMod", []),
        ("             1   FEMMod", "             2   FEMMod", ["FEMMod 2", "3 (Timoshenko)"]),
        ("---- SPRING ELEMENT PROPERTIES ----\n   0   N - number of them\nnames of columns\n(-) (-)\n",
         "---- SPRING ----\n", ["line"]),
        # what looked like a shorter layout, without masses
        ("---- MEMBER COSINE", "\n---- MEMBER COSINE", ["neither the heading of a table", "take out blank lines"]),
        ("---- JOINT ADD", "! ours\n---- JOINT ADD", ["'! ours'", "neither the heading of a table"]),
        ("2 0 0 10 1 0 0 0 0", "2 0 0 10 4 0 0 0", ["8 numbers in a row of the joints, 4 or 9 expected"]),
    ],
)
def test_mistakes_name_file_and_line(tmp_path, old, new, words_of):
    text = cantilever()
    assert old in text
    path = write(tmp_path, text.replace(old, new, 1))
    if not words_of:
        read_subdyn(path)
        return
    with pytest.raises(InputError) as error:
        read_subdyn(path)
    assert str(path) in str(error.value) and "line" in error.value.where
    for words in words_of:
        assert words in str(error.value)


@pytest.mark.parametrize("row", ["2 1e3 1 2 3 4 5 6", "2 1e3 1 2 3 4 5 6 7 8"])
def test_a_mass_without_its_last_columns_is_refused(tmp_path, row):
    with pytest.raises(InputError, match="numbers in a row of the mass table, 5 or 11 expected"):
        read_subdyn(write(tmp_path, cantilever(mass=[row])))


@pytest.mark.parametrize("inertia", ["-1e3 9e3 1e3 0 0 0", "1e3 9e3 1e3 9e9 0 0", "0 0 0 5 0 0"])
def test_an_inertia_that_no_body_has_is_refused(tmp_path, inertia):
    with pytest.raises(InputError, match="joint 2 has a principal moment of -"):
        read_subdyn(write(tmp_path, cantilever(mass=[f"2 1e3 {inertia} 0.4 0 0"])))


def test_tables_in_another_order_than_subdyns_are_refused(tmp_path):
    text = cantilever(mass=["2 1e3 1 2 3 4 5 6 7 8 9"])
    start, middle, end = (text.index(f"---- {name}") for name in ("MEMBER COSINE", "JOINT ADD", "OUTPUT"))
    with pytest.raises(InputError, match="MASSES' stands where SubDyn reads the cosine table"):
        read_subdyn(write(tmp_path, text[:start] + text[middle:end] + text[start:middle] + text[end:]))


@pytest.mark.parametrize("cut", [1, 9, 20, 30, 40, 47, 60])
def test_a_file_that_ends_too_early_is_refused_with_what_was_expected(tmp_path, cut):
    path = write(tmp_path, "\n".join(cantilever().split("\n")[:cut]))
    with pytest.raises(InputError, match="line"):
        read_subdyn(path)


def test_a_soil_file_without_effect_is_reported(tmp_path):
    held = read_subdyn(write(tmp_path, cantilever().replace("1 0 0 0 1 1 1 \"soil", "1 1 1 1 1 1 1 \"soil")))
    assert any("has no effect" in note and "joint 1" in note for note in held.notes)
    part = read_subdyn(write(tmp_path, cantilever().replace("1 0 0 0 1 1 1 \"soil", "1 1 0 0 1 1 1 \"soil")))
    assert any("terms of 'soil.txt' in x have no effect" in note for note in part.notes)
    misspelt = read_subdyn(write(tmp_path, cantilever(), soil="1e8 Kxx\n1e8 Kyx\n"))
    assert any("'Kyx' is none of SubDyn's names" in note for note in misspelt.notes)
    assert not read_subdyn(write(tmp_path, cantilever())).notes


@pytest.mark.parametrize("soil", ["Kxx\n", "many Kxx\n", "1e8 Kxx\n2e8 Kxx\n"])
def test_mistakes_in_a_soil_file_name_it_and_the_line(tmp_path, soil):
    with pytest.raises(InputError, match=r"soil.txt, line"):
        read_subdyn(write(tmp_path, cantilever(), soil=soil))


@needs_oc4
def test_the_oc4_files_are_read_and_the_useless_soil_is_reported():
    jacket = read_subdyn(OC4 / "OC4_Jacket_SD_Input.dat")
    assert (len(jacket.joints), len(jacket.members), jacket.n_div, jacket.shear) == (64, 112, 2, True)
    assert [note for note in jacket.notes if "joint 61, 62, 63, 64 has no effect" in note]
    turbine = read_subdyn(OC4 / "owt_soil_eb.dat")
    assert turbine.layout == "v5" and len(turbine.masses) == 2 and not turbine.notes
    assert turbine.soil["OC4_Jacket_SD_SSI.txt"].stiffness[0, 4] == -1.98e9
