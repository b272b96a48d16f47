"""Modes and poles of other programs: real tables of pyOMA2, text, MATLAB and universal files, followed over blocks."""

import numpy as np
import pandas as pd
import pytest
from peer_packages import peer
from scipy import linalg
from scipy.io import savemat

import probupdate
from probupdate.campaign.pole_tables import read_pole_tables
from probupdate.cli import main
from probupdate.errors import InputError
from probupdate.identification.imported_modes import modes_of_poles
from probupdate.modal.modes import mac, read_modes

RATE_HZ, MINUTES = 20.0, 2.0
STIFFNESS, MASS = np.array([9e3, 8e3, 7e3, 6e3]), np.array([10.0, 9, 8, 8])
ROWS = "block_minutes = 2.0\n[channels]\na = 1\nb = 2\nc = 3\nd = 4\n"
SHAPES = np.array([[1, 0.9, -0.3], [0.8, -0.4, 1], [0.5, -1, -0.8], [0.2, -0.6, 0.7]])
COLUMNS = ('frequency = "f"\nfrequency_unit = "Hz"\ndamping = "xi"\ndamping_unit = "%"\nblock = "block"\n'
           'block_minutes = 10.0\n[channels]\na = "a"\nb = "b"\nc = "c"\nd = "d"\n')


def frame():
    """Eigenfrequencies in Hz and shapes of a shear frame of four storeys, by scipy; its record under white noise, 1 %
    of critical in each mode, of a discretisation without error."""
    above = np.diag(STIFFNESS[1:], 1)
    stiffness = np.diag(STIFFNESS + np.append(STIFFNESS[1:], 0)) - above - above.T
    square, shape = linalg.eigh(stiffness, np.diag(MASS))
    n, omega = len(MASS), np.sqrt(square)
    damping = np.diag(MASS) @ shape @ np.diag(0.02 * omega) @ shape.T @ np.diag(MASS)
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness / MASS[:, None], -damping / MASS[:, None]]])
    step, rng = linalg.expm(system / RATE_HZ), np.random.default_rng(3)
    force = rng.standard_normal((round(6 * 60 * MINUTES * RATE_HZ), n)) / MASS
    state, record = np.zeros(2 * n), np.empty_like(force)
    for k, push in enumerate(force):
        state = step @ state
        state[n:] += push
        record[k] = (system @ state)[n:]
    return omega / (2 * np.pi), shape, record + 0.05 * record.std(axis=0) * rng.standard_normal(record.shape)


@pytest.fixture(scope="module")
def pyoma(tmp_path_factory):
    """(eigenfrequencies, shapes, folder with what pyOMA2 found in each of six blocks)."""
    algorithms, setup = peer("pyoma2.algorithms"), peer("pyoma2.setup")
    folder = tmp_path_factory.mktemp("pyoma")
    frequency, shape, record = frame()
    for k, block in enumerate(np.split(record, 6)):
        own = setup.SingleSetup(block, fs=RATE_HZ)
        ssi = algorithms.SSI(name="ssi", br=20, ordmax=24, step=2)
        own.add_algorithms(ssi)
        own.run_by_name("ssi")
        np.savez(folder / f"2020-01-01T00:{2 * k:02d}Z.npz", Fn_poles=ssi.result.Fn_poles, Xi_poles=ssi.result.Xi_poles,
                 Phi_poles=ssi.result.Phi_poles)
    return frequency, shape, folder


def converted(folder, source, described, **more):
    (folder / "poles.toml").write_text(described, encoding="utf-8")
    result = probupdate.convert(source, folder / "modes.json", to="modes", description=folder / "poles.toml", **more)
    return read_modes(folder / "modes.json"), result


def table(n_block=8, seed=0, spurious=2):
    """Unsorted poles: three modes and others at random, each block; damping in per cent."""
    rng, rows = np.random.default_rng(seed), []
    for k in range(n_block):
        own = [(f * (1 + 0.003 * rng.standard_normal()), 1 + 0.1 * rng.standard_normal(),
                *(s + 0.01 * rng.standard_normal(4))) for f, s in zip((0.8, 2.1, 3.4), SHAPES.T, strict=True)]
        own += [(rng.uniform(0.3, 5), rng.uniform(2, 9), *rng.standard_normal(4)) for _ in range(spurious)]
        rows += [(f"b{k}", *own[j]) for j in rng.permutation(len(own))]
    return pd.DataFrame(rows, columns=["block", "f", "xi", "a", "b", "c", "d"])


def written(folder, frame, name="poles.csv"):
    frame.to_csv(folder / name, index=False)
    return folder / name


def test_poles_of_pyoma_become_the_frames_modes(pyoma, tmp_path, validation):
    row = validation(what="poles of all orders of pyOMA2 1.4.3, followed over six blocks",
                     reference="eigenvalues of the frame (scipy) whose record was drawn",
                     why="four standard errors of six blocks of two minutes; shapes: noise of 5 %")
    frequency, shape, folder = pyoma
    data, result = converted(tmp_path, folder, ROWS)
    assert data.channels == ("a", "b", "c", "d") and data.n_mode == 4 and len(data.sets) == 6
    found = np.array([s.frequency_hz for s in data.sets])
    std = np.array([s.frequency_std_hz for s in data.sets])
    row.error((found.mean(axis=0) - frequency) / (std[0] / np.sqrt(6)), below=4.0, of="frequencies, standard errors")
    np.testing.assert_allclose(std, np.tile(found.std(axis=0, ddof=1), (6, 1)))
    row.error(1 - np.array([np.diag(mac(s.shape, shape)) for s in data.sets]), below=0.02, of="1 - MAC")
    assert any("scatter over the blocks" in note for note in result.notes)


def test_every_pole_is_counted_once(pyoma, tmp_path):
    frequency, _, folder = pyoma
    _, result = converted(tmp_path, folder, ROWS)
    count = sum(int(np.isfinite(np.load(path)["Fn_poles"]).sum()) for path in folder.glob("*.npz"))
    poles = pd.read_csv(tmp_path / "modes.poles.csv")
    assert len(poles) == count and (poles.criterion == "kept").sum() == 24
    dropped = sum(int(note.split()[1]) for note in result.notes if note.startswith("dropped"))
    assert dropped + 24 == count


def test_one_table_in_three_forms_gives_the_same_modes(tmp_path):
    """As it is; circular frequencies and amplitudes with phases; fields of a MATLAB structure a block."""
    made = table()
    plain, _ = converted(tmp_path, written(tmp_path, made), COLUMNS)
    phases = {f"p{c}": np.where(made[c] < 0, 180.0, 0) for c in "abcd"}
    polar = made.assign(f=2 * np.pi * made.f, xi=made.xi / 100, **phases)
    polar[list("abcd")] = polar[list("abcd")].abs()
    turned, _ = converted(tmp_path, written(tmp_path, polar, "polar.csv"), (
        'frequency = "f"\nfrequency_unit = "rad/s"\ndamping = "xi"\ndamping_unit = "ratio"\nblock = "block"\n'
        'block_minutes = 10.0\ncomponents = "amplitude and phase"\nphase_unit = "deg"\n[channels]\n'
        + "".join(f'{c} = ["{c}", "p{c}"]\n' for c in "abcd")))
    blocks = tmp_path / "mat"
    blocks.mkdir()
    for name, own in made.groupby("block", sort=False):
        savemat(blocks / f"{name}.mat", {"modal": {"f": own.f.to_numpy(), "xi": own.xi.to_numpy(),
                                                   "phi": own[list("abcd")].to_numpy().T}})
    fields, _ = converted(tmp_path, blocks, 'frequency = "modal.f"\nfrequency_unit = "Hz"\ndamping = "modal.xi"\n'
                          'damping_unit = "%"\nshape = "modal.phi"\n' + ROWS.replace("2.0", "10.0"))
    for other in (turned, fields):
        assert [s.id for s in other.sets] == [s.id for s in plain.sets]
        for a, b in zip(plain.sets, other.sets, strict=True):
            for key in ("frequency_hz", "damping_ratio", "frequency_std_hz", "shape", "shape_std"):
                np.testing.assert_allclose(getattr(b, key), getattr(a, key), rtol=1e-9, atol=1e-12, err_msg=key)


def test_a_column_is_one_mode_however_rows_are_mixed(tmp_path):
    data, _ = converted(tmp_path, written(tmp_path, table()), COLUMNS)
    assert data.n_mode == 3
    for s in data.sets:
        assert np.all(np.abs(s.frequency_hz / (0.8, 2.1, 3.4) - 1) < 0.02)
        assert np.all(np.diag(mac(s.shape, SHAPES)) > 0.99)


def test_a_mode_that_a_block_lacks_is_null_there(tmp_path):
    made = table()
    made = made[~((made.block == "b3") & (made.f.between(2.0, 2.2)))]
    data, _ = converted(tmp_path, written(tmp_path, made), COLUMNS)
    assert np.isnan(data.sets[3].frequency_hz[1]) and np.isfinite(data.sets[4].frequency_hz[1])


def test_one_block_gets_no_standard_deviations(tmp_path):
    data, result = converted(tmp_path, written(tmp_path, table(1, spurious=0)), COLUMNS)
    assert np.isnan(data.sets[0].frequency_std_hz).all() and np.isnan(data.sets[0].shape_std).all()
    assert any("none are made up" in note for note in result.notes)


def test_the_tables_own_standard_deviations_are_kept(tmp_path):
    made = table().assign(s=0.004)
    data, result = converted(tmp_path, written(tmp_path, made), 'frequency_std = "s"\n' + COLUMNS)
    assert all(np.all(s.frequency_std_hz == 0.004) for s in data.sets)
    assert any("its own" in note for note in result.notes)


def test_modes_without_damping_are_followed(tmp_path):
    described = COLUMNS.replace('damping = "xi"\ndamping_unit = "%"\n', "")
    data, _ = converted(tmp_path, written(tmp_path, table(spurious=0)), described)
    assert data.n_mode == 3 and all(np.isnan(s.damping_ratio).all() for s in data.sets)


def test_blocks_stand_in_the_order_of_time(tmp_path):
    made = table(5)
    times = ["2020-01-02T00:00Z", "2020-01-01T00:00Z", "2020-01-03T00:00Z", "2019-12-31T23:00Z", "2020-01-01T12:00Z"]
    made["block"] = made.block.map({f"b{k}": time for k, time in enumerate(times)})
    data, _ = converted(tmp_path, written(tmp_path, made), COLUMNS)
    assert [s.id for s in data.sets] == sorted(times)


def uff_modes(path, cases, mixed):
    """Datasets 55 by pyuff, a load case each, its modes numbered in another order each time."""
    pyuff, rng = peer("pyuff"), np.random.default_rng(5)
    sets = [pyuff.prepare_15(node_nums=[1, 2], def_cs=[0, 0], disp_cs=[0, 0], color=[1, 1], x=[0.0, 0.0], y=[0.0, 0.0],
                             z=[10.0, 20.0])]
    for case in range(1, cases + 1):
        order = rng.permutation(3) if mixed else np.arange(3)
        for number, j in enumerate(order, 1):
            pole = 2 * np.pi * (0.8, 2.1, 3.4)[j] * (1 + 0.003 * rng.standard_normal()) * (-0.01 + 1j)
            r = SHAPES[:, j].reshape(2, 2).astype(complex)
            sets.append(pyuff.prepare_55(
                id1="NONE", id2="NONE", id3="NONE", id4="NONE", id5="NONE", model_type=1, analysis_type=3, data_ch=2,
                spec_data_type=8, data_type=5, n_data_per_node=3, r1=r[:, 0], r2=r[:, 1], r3=np.zeros(2, complex),
                load_case=case, mode_n=number, eig=complex(pole), modal_a=0j, modal_b=0j, node_nums=[1, 2]))
    pyuff.UFF(str(path)).write_sets(sets, mode="overwrite")
    return path


def test_modes_of_a_universal_file_are_followed(tmp_path):
    path = uff_modes(tmp_path / "modes.uff", cases=6, mixed=True)
    data, _ = converted(tmp_path, path, "block_minutes = 10.0\n")
    assert data.channels == ("1:+x", "1:+y", "2:+x", "2:+y") and [s.id for s in data.sets][:2] == ["modes 1", "modes 2"]
    assert all(np.all(np.abs(s.frequency_hz / (0.8, 2.1, 3.4) - 1) < 0.02) for s in data.sets)


# a normal mode of two nodes, as ARTeMIS' help states the records of dataset 55
BY_HAND = """    -1
    55
NONE
NONE
NONE
NONE
NONE
         1         2         2         8         2         3
         2         4         0{number:10d}
{hz:13.5E}  1.00000E+00  1.00000E-02  0.00000E+00
         1
{0:13.5E}{1:13.5E}  0.00000E+00
         2
{2:13.5E}{3:13.5E}  0.00000E+00
    -1
"""


def test_normal_modes_written_by_hand_are_read(tmp_path):
    folder = tmp_path / "uff"
    folder.mkdir()
    for k in range(4):
        (folder / f"{k}.unv").write_text("".join(
            BY_HAND.format(*SHAPES[:, j], number=n, hz=(0.8, 2.1, 3.4)[j] * (1 + 0.002 * k))
            for n, j in enumerate((2, 0, 1), 1)), encoding="ascii")
    data, _ = converted(tmp_path, folder, "block_minutes = 10.0\n")
    assert [s.id for s in data.sets] == ["0", "1", "2", "3"]
    np.testing.assert_allclose(data.sets[2].frequency_hz, np.array([0.8, 2.1, 3.4]) * 1.004, rtol=1e-5)
    np.testing.assert_allclose(data.sets[0].damping_ratio, 0.01, rtol=1e-5)


@pytest.mark.parametrize(("change", "words"), [
    (('"%"', '"ratio"'), r"poles.csv, damping: .*damping_unit = \"%\""),
    (('frequency_unit = "Hz"\n', ""), "frequency_unit: .*write frequency_unit"),
    (("block_minutes = 10.0\n", ""), "how long the record"),
    (('block = "block"', 'block = "blok"'), "no column 'blok'; did you mean 'block'"),
    (('d = "d"', 'd = ["c", "d"]'), "components: .*real and imaginary"),
    (('d = "d"', "d = 4"), "4 is the row of an array"),
    (('block = "block"', 'blok = "block"'), "unknown key 'blok'.*'block'"),
])
def test_what_is_not_said_is_asked_for(tmp_path, change, words):
    path = written(tmp_path, table())
    with pytest.raises(InputError, match=words):
        converted(tmp_path, path, COLUMNS.replace(*change))


@pytest.mark.parametrize(("names", "described", "words"), [
    ({"f": "f (rad/s)"}, COLUMNS.replace('"f"', '"f (rad/s)"'), r'states rad/s, poles.toml says frequency_unit = "Hz"'),
    ({"xi": "xi [-]"}, COLUMNS.replace('"xi"', '"xi [-]"'), r'states ratio, poles.toml says damping_unit = "%"'),
])
def test_a_unit_in_a_columns_name_must_agree(tmp_path, names, described, words):
    with pytest.raises(InputError, match=words):
        converted(tmp_path, written(tmp_path, table().rename(columns=names)), described)


def test_a_row_without_a_block_is_refused(tmp_path):
    made = table()
    made.loc[3, "block"] = None
    with pytest.raises(InputError, match="poles.csv, block, row 4: names no block"):
        converted(tmp_path, written(tmp_path, made), COLUMNS)


def test_ratios_that_are_called_per_cent_are_refused(tmp_path):
    made = table(spurious=0)
    with pytest.raises(InputError, match="too low for a structure"):
        converted(tmp_path, written(tmp_path, made.assign(xi=made.xi / 100)), COLUMNS)


def test_square_shapes_need_a_word(tmp_path):
    made = table(1, spurious=1)
    np.savez(tmp_path / "m.npz", f=made.f, phi=made[list("abcd")].to_numpy().T)
    described = 'frequency = "f"\nfrequency_unit = "Hz"\nshape = "phi"\n' + ROWS
    with pytest.raises(InputError, match="modes_in: .*columns"):
        converted(tmp_path, tmp_path / "m.npz", described)
    (tmp_path / "p.toml").write_text('modes_in = "columns"\n' + described, encoding="utf-8")
    assert read_pole_tables(tmp_path / "m.npz", description=tmp_path / "p.toml").channels == ("a", "b", "c", "d")


def test_a_campaign_names_the_channels_and_bounds_the_frequency(tmp_path):
    sensors = "".join(f'[[sensor]]\nchannel = "{c}"\nlevel = "L"\nposition_m = [0.0, 0.0, {k}.0]\n'
                      'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n'
                      for k, c in enumerate("abcd"))
    for rate, fits in ((20.0, True), (6.0, False)):
        (tmp_path / "campaign.toml").write_text(
            f'name = "n"\nsampling_rate_hz = {rate}\nblock_minutes = 10\n{sensors}', encoding="utf-8")
        described = COLUMNS.split("[channels]")[0].replace("block_minutes = 10.0\n", "")
        path = written(tmp_path, table(spurious=0))
        if fits:
            data, _ = converted(tmp_path, path, described, sensors=tmp_path)
            assert data.channels == ("a", "b", "c", "d") and data.sets[0].environment["block_minutes"] == 10
        else:
            with pytest.raises(InputError, match="above half the campaign's rate of 6 Hz"):
                converted(tmp_path, path, described, sensors=tmp_path)


def test_poles_that_are_incomplete_are_counted_by_reason(tmp_path):
    made = table(spurious=0)
    made.loc[0, "f"], made.loc[1, "f"], made.loc[2, "c"] = np.nan, 0.0, np.nan
    (tmp_path / "poles.toml").write_text(COLUMNS, encoding="utf-8")
    tables = read_pole_tables(written(tmp_path, made), description=tmp_path / "poles.toml")
    assert dict(tables.incomplete) == {"without a frequency": 1, "with a frequency not above zero": 1,
                                       "with a component of the shape missing": 1}
    assert sum("dropped 1" in note for note in modes_of_poles(tables).notes) == 3


@pytest.mark.parametrize("source", ["modes.poles.csv", "."])
def test_the_source_is_not_written_over(tmp_path, capsys, source):
    written(tmp_path, table(), "modes.poles.csv")
    (tmp_path / "poles.toml").write_text(COLUMNS, encoding="utf-8")
    before = (tmp_path / "modes.poles.csv").read_bytes()
    assert main(["convert", str(tmp_path / source), str(tmp_path / "modes.json"), "--to", "modes", "--description",
                 str(tmp_path / "poles.toml")]) == 2
    assert "name" in capsys.readouterr().err and (tmp_path / "modes.poles.csv").read_bytes() == before
