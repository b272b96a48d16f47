"""Universal files: modes and records there and back, what pyuff writes itself, mistakes in one line."""

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from probupdate.campaign import uff_file
from probupdate.campaign.converting import convert
from probupdate.campaign.reading import read_campaign
from probupdate.campaign.uff_file import read_uff_modes, read_uff_records, write_uff_modes, write_uff_records
from probupdate.errors import InputError
from probupdate.modal.modes import ModalData, ModalSet, Sensor

pyuff = pytest.importorskip("pyuff", reason="pyuff is not installed (pip install probupdate[uff])")


def sensors():
    """Two at one place, an oblique one, one that looks down."""
    turned = np.array([np.cos(0.4), np.sin(0.4), 0.0])
    return tuple(
        Sensor(
            channel=name,
            level="T",
            position_m=np.array(place, float),
            direction=np.array(way, float),
            quantity="acceleration",
            unit="m/s2",
        )
        for name, place, way in (
            ("T-x", [0, 0, 80], [1, 0, 0]),
            ("T-y", [0, 0, 80], [0, 1, 0]),
            ("P-r", [5, 5, 15], turned),
            ("P-z", [5, -5, 15], [0, 0, -1]),
        )
    )


def modes(n_set=2, n_mode=3):
    rng = np.random.default_rng(1)
    sets = []
    for k in range(n_set):
        shape = rng.standard_normal((4, n_mode)) + 1j * rng.standard_normal((4, n_mode))
        sets.append(
            ModalSet(
                id=f"2020-06-0{k + 1}T10:00Z",
                frequency_hz=0.3 * np.arange(1, n_mode + 1) + 0.01 * k,
                damping_ratio=np.full(n_mode, 0.012),
                shape=shape,
                frequency_std_hz=np.full(n_mode, np.nan),
                shape_std=np.full(shape.shape, np.nan),
            )
        )
    return ModalData(channels=tuple(s.channel for s in sensors()), sets=tuple(sets))


def test_modes_come_back_to_the_digits_of_the_format(tmp_path, validation):
    row = validation(what="modes to a universal file (55) and back", reference="what was written", why="six digits")
    data = modes()
    _, notes = write_uff_modes(data, sensors(), tmp_path / "modes.uff")
    back = read_uff_modes(tmp_path / "modes.uff", sensors())
    assert back.channels == data.channels and [s.id for s in back.sets] == [s.id for s in data.sets]
    for a, b in zip(data.sets, back.sets, strict=True):
        row.error(b.frequency_hz / a.frequency_hz - 1, below=2e-5, of="frequencies")
        row.error(b.damping_ratio / a.damping_ratio - 1, below=1e-4, of="damping")
        row.error((b.shape - a.shape) / (1 + np.abs(a.shape)), below=1e-5, of="shapes")
        assert np.all(np.isnan(b.frequency_std_hz))
    assert any("standard deviations" in n for n in notes)


def test_without_sensors_channels_are_nodes_and_axes(tmp_path):
    write_uff_modes(modes(1), sensors(), tmp_path / "modes.uff")
    back = read_uff_modes(tmp_path / "modes.uff")
    assert back.channels == ("1:+x", "1:+y", "2:+x", "2:+y", "3:+z")
    np.testing.assert_allclose(back.sets[0].shape[4], -modes(1).sets[0].shape[3], rtol=1e-5)


def test_a_mode_that_was_not_measured_is_left_out_and_said(tmp_path):
    data = modes(1)
    one = data.sets[0]
    f = np.array(one.frequency_hz)
    f[1] = np.nan
    data = ModalData(
        channels=data.channels,
        sets=(
            ModalSet(
                id="a",
                frequency_hz=f,
                damping_ratio=one.damping_ratio,
                shape=one.shape,
                frequency_std_hz=one.frequency_std_hz,
                shape_std=one.shape_std,
            ),
        ),
    )
    _, notes = write_uff_modes(data, sensors(), tmp_path / "m.uff")
    assert "mode 2: not measured" in notes[0]
    back = read_uff_modes(tmp_path / "m.uff", sensors()).sets[0]
    assert np.isnan(back.frequency_hz[1]) and np.isfinite(back.frequency_hz[[0, 2]]).all()


def test_normal_modes_as_other_programs_write_them(tmp_path):
    path = tmp_path / "real.uff"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file = pyuff.UFF(str(path))
        for j, f in enumerate((2.5, 7.25)):
            file.write_sets(
                pyuff.prepare_55(
                    id1="NONE",
                    id2="NONE",
                    id3="NONE",
                    id4="NONE",
                    id5="NONE",
                    model_type=1,
                    analysis_type=2,
                    data_ch=2,
                    spec_data_type=8,
                    data_type=2,
                    n_data_per_node=3,
                    r1=np.array([1.0, 0.5]),
                    r2=np.array([0.0, 0.25]),
                    r3=np.zeros(2),
                    load_case=1,
                    mode_n=j + 1,
                    freq=f,
                    modal_m=1.0,
                    modal_damp_vis=0.02,
                    modal_damp_his=0.0,
                    node_nums=np.array([11, 12]),
                ),
                mode="add" if j else "overwrite",
            )
    back = read_uff_modes(path)
    assert back.channels == ("11:+x", "12:+x", "12:+y")
    np.testing.assert_allclose(back.sets[0].frequency_hz, [2.5, 7.25])
    np.testing.assert_allclose(back.sets[0].damping_ratio, 0.02)
    np.testing.assert_allclose(back.sets[0].shape[:, 0], [1.0, 0.5, 0.25])
    with pytest.raises(InputError, match="no node coordinates"):
        read_uff_modes(path, sensors())


def records(folder: Path, n=400, rate=5.0):
    chosen = (sensors()[0], sensors()[1], sensors()[3])
    data = np.random.default_rng(2).standard_normal((n, 3))
    write_uff_records(data, rate, chosen, folder / "r_20200601_100000.uff", start="2020-06-01T10:00:00Z")
    return chosen, data


CAMPAIGN = 'name = "June"\nsampling_rate_hz = {rate}\nblock_minutes = 1\n'


def campaign(folder: Path, chosen, rate=5.0, described='time = "abscissa"\ntime_unit = "s"\n'):
    text = CAMPAIGN.format(rate=rate)
    for s in chosen:
        text += (
            f'[[sensor]]\nchannel = "{s.channel}"\nlevel = "T"\nposition_m = {s.position_m.tolist()}\n'
            f'direction = {s.direction.tolist()}\nquantity = "acceleration"\nunit = "m/s2"\n'
        )
    folder.mkdir()
    (folder / "campaign.toml").write_text(text)
    (folder / "convert.toml").write_text(
        f'files = "*.uff"\n{described}zone = "UTC"\nstart_format = "%Y%m%d_%H%M%S"\n'
        "start_pattern = '(\\d{8}_\\d{6})'\n"
    )
    return folder


def test_records_come_back_through_convert(tmp_path, validation):
    row = validation(what="records to a universal file (58) and back through `convert`", reference="what was written")
    (tmp_path / "raw").mkdir()
    chosen, data = records(tmp_path / "raw")
    found = read_uff_records(next((tmp_path / "raw").iterdir()))
    assert found.names == ("T-x", "T-y", "P-z") and found.places == ("1:+x", "1:+y", "2:-z")
    assert found.rate_hz == pytest.approx(5.0)
    row.error(found.data / data - 1, below=1e-10)
    folder = campaign(tmp_path / "campaign", chosen)
    assert convert(tmp_path / "raw", folder).samples == len(data)
    opened = read_campaign(folder)
    assert str(opened.files[0].start).startswith("2020-06-01 10:00:00")


def test_the_rate_is_the_files_own(tmp_path):
    (tmp_path / "raw").mkdir()
    chosen, _ = records(tmp_path / "raw")
    with pytest.raises(InputError, match="5 Hz"):
        convert(tmp_path / "raw", campaign(tmp_path / "campaign", chosen, rate=6.0))
    with pytest.raises(InputError, match='write time = "abscissa"'):
        convert(tmp_path / "raw", campaign(tmp_path / "other", chosen, described=""))


def test_what_the_format_cannot_hold_is_refused(tmp_path):
    one = sensors()
    with pytest.raises(InputError, match="P-r.*does not look along"):
        write_uff_records(np.zeros((10, 4)), 5.0, one, tmp_path / "r.uff", start="2020-06-01T10:00:00Z")
    lost = np.zeros((10, 2))
    lost[3, 1] = np.nan
    with pytest.raises(InputError, match="T-y.*1 lost samples"):
        write_uff_records(lost, 5.0, one[:2], tmp_path / "r.uff", start="2020-06-01T10:00:00Z")
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match="no sensor of the campaign"):
        write_uff_modes(modes(1), one[:3], tmp_path / "m.uff")


@pytest.mark.parametrize("content", [b"", b"text\n", b"    -1\n    58\n", b"    -1\n    55\nx\n    -1\n"])
def test_what_is_no_universal_file_names_it(tmp_path, content):
    (tmp_path / "bad.uff").write_bytes(content)
    for read in (read_uff_modes, read_uff_records):
        with pytest.raises(InputError, match=r"bad\.uff"):
            read(tmp_path / "bad.uff")


def test_without_the_package_it_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.uff").write_text("    -1\n")
    monkeypatch.setitem(sys.modules, "pyuff", None)
    with pytest.raises(InputError, match=r"pip install probupdate\[uff\]"):
        read_uff_records(tmp_path / "a.uff")
    assert uff_file.LARGEST == 2**30


def test_the_command_takes_modes_and_records_there_and_back(tmp_path, capsys):
    from probupdate.cli import main
    from probupdate.modal.modes import read_modes, write_modes

    (tmp_path / "raw").mkdir()
    chosen, data = records(tmp_path / "raw")
    folder = campaign(tmp_path / "campaign", chosen)
    assert main(["convert", str(tmp_path / "raw"), str(folder)]) == 0
    # 80 s of which one minute is a whole block
    assert main(["convert", str(folder), str(tmp_path / "out"), "--to", "uff"]) == 0
    (path,) = (tmp_path / "out").iterdir()
    np.testing.assert_allclose(read_uff_records(path).data, data[:300], rtol=1e-6)
    assert main(["convert", str(folder), str(tmp_path / "out"), "--to", "uff"]) == 2
    one = modes(1)
    rows = [0, 1, 3]
    one = ModalData(
        channels=tuple(one.channels[k] for k in rows),
        sets=tuple(
            ModalSet(
                id=s.id,
                frequency_hz=s.frequency_hz,
                damping_ratio=s.damping_ratio,
                shape=s.shape[rows],
                frequency_std_hz=s.frequency_std_hz,
                shape_std=s.shape_std[rows],
            )
            for s in one.sets
        ),
    )
    write_modes(one, tmp_path / "modes.json")
    assert main(["convert", str(tmp_path / "modes.json"), str(tmp_path / "m.uff"), "--to", "uff"]) == 2
    assert "--sensors" in capsys.readouterr().err
    words = ["--sensors", str(folder)]
    assert main(["convert", str(tmp_path / "modes.json"), str(tmp_path / "m.uff"), "--to", "uff", *words]) == 0
    assert main(["convert", str(tmp_path / "m.uff"), str(tmp_path / "back.json"), "--to", "modes", *words]) == 0
    assert "no standard deviations" in capsys.readouterr().out
    np.testing.assert_allclose(read_modes(tmp_path / "back.json").sets[0].shape, one.sets[0].shape, atol=1e-5)
