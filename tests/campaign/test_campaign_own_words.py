"""What source files say of themselves against campaign.toml: converted and said, or refused; each remedy works."""

import json

import numpy as np
import pandas as pd
import pytest
import scipy.io
from peer_packages import peer

from probupdate.campaign.converting import convert
from probupdate.campaign.stated import parse_unit
from probupdate.campaign.uff_file import read_uff_modes
from probupdate.errors import InputError
from probupdate.modal.modes import Sensor

RATE, N = 20.0, 600
START = 'start = "2024-03-01T10:00:00Z"\n'


@pytest.fixture
def job(tmp_path):
    """job(described, units=, directions=) -> (raw, campaign) with two channels a and b."""

    def make(described: str, unit="m/s2", directions=((1, 0, 0), (1, 0, 0)), quantity="acceleration"):
        raw, campaign = tmp_path / "raw", tmp_path / "camp"
        raw.mkdir(exist_ok=True)
        campaign.mkdir(exist_ok=True)
        text = f'name = "x"\nsampling_rate_hz = {RATE}\nblock_minutes = 0.5\n'
        for k, direction in enumerate(directions):
            text += (f'[[sensor]]\nchannel = "{"ab"[k]}"\nlevel = "l"\nposition_m = [0.0, 0.0, {10.0 * (k + 1)}]\n'
                     f'direction = {[float(v) for v in direction]}\nquantity = "{quantity}"\nunit = "{unit}"\n')
        (campaign / "campaign.toml").write_text(text)
        (campaign / "convert.toml").write_text(described)
        return raw, campaign

    return make


def samples() -> np.ndarray:
    return np.random.default_rng(1).standard_normal((N, 2)) * 0.02


def written(campaign) -> np.ndarray:
    import h5py

    found = []
    for path in sorted((campaign / "acceleration").glob("*.h5")):
        with h5py.File(path) as file:
            found.append(file["data"][:])
    return np.concatenate(found)


UFF = 'files = "*.uff"\ntime = "abscissa"\ntime_unit = "s"\n' + START


def universal(path, data, ordinates):
    """ordinates: (unit, code of the quantity, direction) of each record."""
    file = peer("pyuff").UFF(str(path))
    for k, (unit, code, direction) in enumerate(ordinates):
        file.write_sets({
            "type": 58, "binary": 0, "id1": "ab"[k], "id2": "NONE", "id3": "NONE", "id4": "NONE", "id5": "NONE",
            "func_type": 1, "rsp_node": k + 1, "rsp_dir": direction, "ref_node": 0, "ref_dir": 0,
            "abscissa_spacing": 1, "abscissa_spec_data_type": 17, "abscissa_axis_lab": "time",
            "abscissa_axis_units_lab": "s", "ordinate_spec_data_type": code, "ordinate_axis_lab": "y",
            "ordinate_axis_units_lab": unit, "orddenom_spec_data_type": 0, "data": data[:, k],
            "x": np.arange(len(data)) / RATE}, "add" if k else "overwrite")


# Units --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("text", "quantity", "factor"), [
    ("g", "acceleration", 9.80665), ("mG", "acceleration", 9.80665e-3), ("m/s²", "acceleration", 1.0),
    ("m/s**2", "acceleration", 1.0), ("m s-2", "acceleration", 1.0), ("mm/sec^2", "acceleration", 1e-3),
    ("Gal", "acceleration", 1e-2), ("in/s^2", "acceleration", 0.0254), ("mm/s", "velocity", 1e-3),
    ("µm", "displacement", 1e-6),
])
def test_units_are_known_however_they_are_written(text, quantity, factor):
    found = parse_unit(text)
    assert found is not None and found[0] == quantity and found[1] == pytest.approx(factor)


@pytest.mark.parametrize("text", ["top", "EU", "", "acc", "1"])
def test_words_that_are_no_unit_say_nothing(text):
    assert parse_unit(text) is None


@pytest.mark.parametrize(("unit", "factor"), [("g", 9.80665), ("mm/s2", 1e-3), ("Gal", 0.01)])
def test_a_universal_files_unit_is_converted_and_said(job, unit, factor):
    raw, campaign = job(UFF)
    universal(raw / "r.uff", samples(), [(unit, 12, 1), ("m/s^2", 12, 1)])
    done = convert(raw, campaign)
    np.testing.assert_allclose(written(campaign), samples() * [factor, 1.0], rtol=1e-5)
    assert f"a: {unit} was turned into m/s2" in done.summary and "b:" not in done.summary


@pytest.mark.parametrize(("unit", "code"), [("N", 13), ("mm/s", 11), ("mm", 8), ("N", 0), ("deg", 1)])
def test_another_quantity_is_refused_and_can_be_overruled(job, unit, code):
    raw, campaign = job(UFF)
    universal(raw / "r.uff", samples(), [("m/s^2", 12, 1), (unit, code, 1)])
    with pytest.raises(InputError, match=r'r\.uff, b: states.*campaign.toml says acceleration.*overrule'):
        convert(raw, campaign)
    job(UFF + 'overrule = ["quantity"]\n')
    convert(raw, campaign)
    np.testing.assert_allclose(written(campaign), samples(), rtol=1e-5)


def test_the_unit_of_the_file_as_a_whole_counts_where_records_name_none(job):
    raw, campaign = job(UFF)
    universal(raw / "r.uff", samples(), [("NONE", 12, 1), ("m/s^2", 12, 1)])
    pyuff = peer("pyuff")
    pyuff.UFF(str(raw / "r.uff")).write_sets(
        pyuff.prepare_164(units_code=5, units_description="mm", temp_mode=1, length=1e3, force=1e3, temp=1.0,
                          temp_offset=0.0), "add")
    assert "a: mm/s2 was turned into m/s2" in convert(raw, campaign).summary
    np.testing.assert_allclose(written(campaign), samples() * [1e-3, 1.0], rtol=1e-5)


def test_a_reversed_direction_is_turned_and_another_refused(job):
    raw, campaign = job(UFF)
    universal(raw / "r.uff", samples(), [("m/s^2", 12, -1), ("m/s^2", 12, 1)])
    assert "a: its sign was reversed" in convert(raw, campaign).summary
    np.testing.assert_allclose(written(campaign), samples() * [-1, 1], rtol=1e-5)
    (raw / "r.uff").unlink()
    universal(raw / "s.uff", samples(), [("m/s^2", 12, 2), ("m/s^2", 12, 1)])
    with pytest.raises(InputError, match=r"a: points along \+y, campaign.toml says \+x"):
        convert(raw, campaign)
    raw, campaign = job(UFF, directions=((0, 1, 0), (1, 0, 0)))
    convert(raw, campaign)


def test_rotations_are_no_translations(job):
    raw, campaign = job(UFF)
    universal(raw / "r.uff", samples(), [("m/s^2", 12, 4), ("m/s^2", 12, 1)])
    with pytest.raises(InputError, match=r"a: states rotation .acceleration about \+x"):
        convert(raw, campaign)


TABLE = 'files = "*.csv"\n' + START


def test_units_behind_a_columns_name_and_a_factor_that_agrees(job):
    raw, campaign = job(TABLE + '[columns]\na = "acc [g]"\nb = "b (top)"\n')
    pd.DataFrame(samples(), columns=["acc [g]", "b (top)"]).to_csv(raw / "r.csv", index=False)
    assert "a: g was turned into m/s2" in convert(raw, campaign).summary
    np.testing.assert_allclose(written(campaign), samples() * [9.80665, 1.0], rtol=1e-5)


def test_a_column_is_found_without_the_unit_behind_its_name(job):
    raw, campaign = job(TABLE)
    pd.DataFrame(samples(), columns=["a [g]", "b"]).to_csv(raw / "r.csv", index=False)
    assert "a: g was turned into m/s2" in convert(raw, campaign).summary
    np.testing.assert_allclose(written(campaign), samples() * [9.80665, 1.0], rtol=1e-5)


@pytest.mark.parametrize(("factor", "works"), [(9.81, True), (10.2, True), (1.0, False), (1e3, False)])
def test_a_factor_beside_a_stated_unit_must_hold_it(job, factor, works):
    raw, campaign = job(TABLE + f'[columns]\na = "acc [g]"\n[factor]\na = {factor}\n')
    pd.DataFrame(samples(), columns=["acc [g]", "b"]).to_csv(raw / "r.csv", index=False)
    if not works:
        with pytest.raises(InputError, match=r"a: states g, which takes a factor of 9\.80665"):
            convert(raw, campaign)
        return
    convert(raw, campaign)
    np.testing.assert_allclose(written(campaign)[:, 0], samples()[:, 0] * factor, rtol=1e-5)


def test_volts_need_a_factor(job):
    text = TABLE + '[columns]\na = "acc [mV]"\n'
    raw, campaign = job(text)
    pd.DataFrame(samples(), columns=["acc [mV]", "b"]).to_csv(raw / "r.csv", index=False)
    with pytest.raises(InputError, match=r"a: is in mV.*m/s2 per mV under \[factor\]"):
        convert(raw, campaign)
    job(text + "[factor]\na = 0.098\n")
    convert(raw, campaign)
    np.testing.assert_allclose(written(campaign)[:, 0], samples()[:, 0] * 0.098, rtol=1e-5)


def test_units_of_parquet_fields_and_of_matlab_texts(job):
    raw, campaign = job('files = "*.parquet"\n' + START)
    arrow, data = peer("pyarrow"), samples()
    from pyarrow import parquet

    fields = [arrow.field("a", arrow.float64(), metadata={"unit": "mm/s2"}), arrow.field("b", arrow.float64())]
    parquet.write_table(arrow.table([data[:, 0], data[:, 1]], arrow.schema(fields)), raw / "r.parquet")
    assert "a: mm/s2 was turned" in convert(raw, campaign).summary
    (raw / "r.parquet").unlink()
    scipy.io.savemat(raw / "r.mat", {"acc": data, "units": "g"})
    job('files = "*.mat"\n' + START)
    assert "b: g was turned" in convert(raw, campaign).summary


def test_each_of_several_structures_states_its_own_unit(job):
    raw, campaign = job('files = "*.mat"\n' + START + '[columns]\na = "ch(1).y"\nb = "ch(2).y"\n')
    data, channels = samples(), np.zeros((1, 2), dtype=[("y", object), ("unit", object)])
    channels[0, 0], channels[0, 1] = (data[:, :1], "g"), (data[:, 1:], "mm/s^2")
    scipy.io.savemat(raw / "r.mat", {"ch": channels})
    summary = convert(raw, campaign).summary
    assert "a: g was turned" in summary and "b: mm/s^2 was turned" in summary


@pytest.mark.parametrize("kind", ["npz", "mat", "struct", "csv", "parquet"])
def test_another_rate_in_the_file_is_refused_in_each_format(job, kind):
    data = samples()
    described = {"npz": "*.npz", "mat": "*.mat", "struct": "*.mat", "csv": "*.csv", "parquet": "*.parquet"}[kind]
    text = f'files = "{described}"\n' + START + ('data = "rec.acc"\n' if kind == "struct" else "") + (
        "skip_rows = 1\n" if kind == "csv" else "")
    raw, campaign = job(text)
    if kind == "npz":
        np.savez(raw / "r.npz", acc=data, fs=100.0)
    elif kind == "mat":
        scipy.io.savemat(raw / "r.mat", {"acc": data, "dt": 0.01})
    elif kind == "struct":
        scipy.io.savemat(raw / "r.mat", {"rec": {"acc": data, "Fs": 100.0}})
    elif kind == "csv":
        table = pd.DataFrame(data, columns=["a", "b"]).to_csv(index=False)
        (raw / "r.csv").write_text("Sampling rate: 0.1 kHz\n" + table)
    else:
        arrow = peer("pyarrow")
        from pyarrow import parquet

        table = arrow.table({"a": data[:, 0], "b": data[:, 1]}).replace_schema_metadata({"sampling_rate_hz": "100"})
        parquet.write_table(table, raw / "r.parquet")
    with pytest.raises(InputError, match="states 100 Hz, campaign.toml says 20 Hz"):
        convert(raw, campaign)
    job('overrule = ["rate"]\n' + text)
    assert convert(raw, campaign).samples == N


# Orientation and structures -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("header", [True, False])
def test_a_table_with_a_row_a_channel_is_refused(job, header):
    raw, campaign = job(f'files = "*.csv"\nheader = {str(header).lower()}\n{START}[columns]\na = 1\nb = 2\n')
    np.savetxt(raw / "r.csv", samples().T, delimiter=",")
    with pytest.raises(InputError, match=r"has [12] samples? of 600 channels.*a row a sample"):
        convert(raw, campaign)


@pytest.mark.parametrize("kind", ["mat", "mat73", "npy", "npz", "npz_fortran"])
def test_a_row_a_channel_is_refused_until_it_is_stated(job, kind):
    import h5py

    data = samples().T
    text = f'files = "*.{kind[:3]}"\n' + START
    raw, campaign = job(text)
    if kind == "mat":
        scipy.io.savemat(raw / "r.mat", {"y": data})
    elif kind == "mat73":
        with h5py.File(raw / "r.mat", "w", userblock_size=512) as file:
            file["y"] = data.T
    elif kind == "npy":
        np.save(raw / "r.npy", data)
    else:
        np.savez(raw / "r.npz", y=np.asfortranarray(data) if "fortran" in kind else np.ascontiguousarray(data))
    with pytest.raises(InputError, match=r"has 2 rows and 600 columns.*channels in rows"):
        convert(raw, campaign)
    job(text + 'orientation = "channels in columns"\n')
    with pytest.raises(InputError, match="2 samples of 600 channels as stated"):
        convert(raw, campaign)
    job(text + 'orientation = "channels in rows"\n')
    assert convert(raw, campaign).samples == N
    np.testing.assert_allclose(written(campaign), samples(), rtol=1e-5)


@pytest.mark.parametrize("packed", [True, False])
def test_fields_of_matlab_structures_are_read(job, packed):
    raw, campaign = job('files = "*.mat"\n' + START + '[columns]\na = "rec.ch(1).y"\nb = "rec.ch(2).y"\n')
    data = samples()
    channels = np.array([(data[:, 0], "one"), (data[:, 1], "two")], dtype=[("y", object), ("name", object)])
    scipy.io.savemat(raw / "r.mat", {"rec": {"ch": channels, "fs": RATE}}, do_compression=packed)
    assert convert(raw, campaign).samples == N
    np.testing.assert_allclose(written(campaign), data, rtol=1e-5)


def test_what_a_matlab_file_holds_is_named(job):
    raw, campaign = job('files = "*.mat"\n' + START)
    cells = np.array(["x", 1.0], dtype=object)
    scipy.io.savemat(raw / "r.mat", {"names": cells, "s": {"y": samples(), "z": samples()}})
    with pytest.raises(InputError, match=r"there is no variable 'a'.*known are s\.y, s\.z"):
        convert(raw, campaign)
    scipy.io.savemat(raw / "r.mat", {"cells": np.array([np.zeros(3), "text"], dtype=object)})
    with pytest.raises(InputError, match=r"holds no array of numbers; it holds cells \(of another kind\)"):
        convert(raw, campaign)


# Tables -------------------------------------------------------------------------------------------------------------


def toa5(path, unit="m/s2", value='"NAN"'):
    rows = ['"TOA5","st","CR6","1","os","prog","1","T"', '"TIMESTAMP","RECORD","acc","b"', f'"TS","RN","{unit}",""',
            '"","","Smp","Smp"']
    for k, (a, b) in enumerate(samples()):
        time = pd.Timestamp("2024-03-01T10:00:00") + pd.Timedelta(seconds=k / RATE)
        rows.append(f'"{time.isoformat(sep=" ", timespec="milliseconds")}",{k},{value if k == 70 else a},{b}')
    path.write_text("\n".join(rows) + "\n")


@pytest.mark.parametrize(("head", "column"), [("skip_rows = 4\nheader = false\n", "3"), ("", '"acc"')])
def test_a_campbell_table_is_read_with_its_units_and_lost_words(job, head, column):
    raw, campaign = job(f'files = "*.dat"\ntime = 1\nzone = "UTC"\n{head}[columns]\na = {column}\nb = 4\n')
    toa5(raw / "r.dat", unit="g")
    done = convert(raw, campaign)
    assert "a: g was turned" in done.summary and "1 value lost" in done.summary
    found = written(campaign)
    assert np.isnan(found[70, 0]) and np.isfinite(np.delete(found[:, 0], 70)).all()
    np.testing.assert_allclose(found[71:, 0], 9.80665 * samples()[71:, 0], rtol=1e-4)


def test_a_word_for_lost_is_declared_as_the_error_says(job):
    text = 'files = "*.dat"\ntime = 1\nzone = "UTC"\nskip_rows = 4\nheader = false\n{}[columns]\na = 3\nb = 4\n'
    raw, campaign = job(text.format(""))
    toa5(raw / "r.dat", value='"OVER RANGE"')
    with pytest.raises(InputError, match=r'column 3, row 71: \'OVER RANGE\' is not a number.*lost = \["OVER RANGE"\]'):
        convert(raw, campaign)
    job(text.format('lost = ["OVER RANGE", -999]\n'))
    assert "1 value lost" in convert(raw, campaign).summary


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8"])
def test_dates_decimal_commas_and_encodings_are_stated(job, encoding):
    raw, campaign = job(
        f'files = "*.csv"\ntime = "Zeit"\ntime_format = "%d.%m.%Y %H:%M:%S,%f"\nzone = "Europe/Berlin"\n'
        f'separator = ";"\ndecimal = ","\nencoding = "{encoding}"\nunits_row = 2\nlost = ["---"]\n'
        '[columns]\na = "höhe"\n')
    rows = ["Zeit;höhe;b", ";mm/s²;m/s²"]
    for k, (a, b) in enumerate(samples()):
        time = pd.Timestamp("2024-03-02T10:00:00") + pd.Timedelta(seconds=k / RATE)
        value = "---" if k == 5 else f"{a:.9f}".replace(".", ",")
        rows.append(f"{time.strftime('%d.%m.%Y %H:%M:%S,%f')};{value};{f'{b:.9f}'.replace('.', ',')}")
    (raw / "r.csv").write_bytes("\n".join(rows).encode(encoding))
    done = convert(raw, campaign)
    assert done.files[0].name.startswith("20240302T090000.000Z")
    expected = samples() * [1e-3, 1.0]
    expected[5, 0] = np.nan
    np.testing.assert_allclose(written(campaign), expected, rtol=1e-4)


def test_a_date_that_is_not_iso_says_how_it_is_stated(job):
    raw, campaign = job('files = "*.csv"\ntime = "t"\nzone = "UTC"\n')
    (raw / "r.csv").write_text("t,a,b\n13.05.2024 10:00:00,1,2\n13.05.2024 10:00:01,1,2\n")
    with pytest.raises(InputError, match="time_format"):
        convert(raw, campaign)


def test_a_point_where_the_decimal_sign_is_a_comma_is_no_number(job):
    raw, campaign = job(TABLE + 'separator = ";"\ndecimal = ","\n')
    (raw / "r.csv").write_text("a;b\n1,5;2,5\n1.5;2,5\n")
    with pytest.raises(InputError, match=r"column a, row 2: '1\.5' is not a number"):
        convert(raw, campaign)


@pytest.mark.parametrize("name", ["time", None])
def test_the_index_of_a_frame_is_a_column_of_parquet(job, name):
    peer("pyarrow")
    raw, campaign = job(f'files = "*.parquet"\ntime = "{name or "index"}"\n')
    index = pd.date_range("2024-05-01T10:00:00Z", periods=N, freq="50ms", name=name)
    pd.DataFrame(samples(), columns=["a", "b"], index=index).to_parquet(raw / "r.parquet")
    done = convert(raw, campaign)
    assert done.files[0].name.startswith("20240501T100000.000Z")
    np.testing.assert_allclose(written(campaign), samples(), rtol=1e-5)


# Local axes ---------------------------------------------------------------------------------------------------------

C, S = np.cos(0.4), np.sin(0.4)


@pytest.mark.parametrize("form", ["points", "matrix", "cylinder", "in another"])
def test_components_in_local_axes_are_turned_into_the_files(tmp_path, form):
    pyuff = peer("pyuff")
    path = tmp_path / "m.uff"
    local = np.array([[C, S, 0], [-S, C, 0], [0, 0, 1.0]])
    place = np.array([5 * C, 5 * S, 20.0])
    if form == "matrix":
        system = pyuff.prepare_2420(Part_UID=1, Part_Name="p", CS_sys_labels=[3], CS_types=[0], CS_colors=[1],
                                    CS_names=["c"], CS_matrices=[np.vstack([local, np.zeros(3)])])
    else:
        if form == "points":
            numbers, kinds, others, x_points = [3], [0], [0], [local[0]]
        elif form == "cylinder":
            numbers, kinds, others, x_points = [3], [1], [0], [np.array([1.0, 0, 0])]
        else:
            half = np.array([np.cos(0.2), np.sin(0.2), 0])
            numbers, kinds, others, x_points = [2, 3], [0, 0], [0, 2], [half, half]
        n = len(numbers)
        system = pyuff.prepare_18(cs_num=numbers, cs_type=kinds, ref_cs_num=others, color=[1] * n, method=[1] * n,
                                  cs_name=["c"] * n, ref_o=np.zeros((n, 3)), x_point=np.array(x_points),
                                  xz_point=np.tile([0.0, 0, 1], (n, 1)))
    nodes = pyuff.prepare_15(node_nums=np.array([1, 2]), def_cs=np.zeros(2, int), disp_cs=np.array([0, 3]),
                             color=np.zeros(2, int), x=np.array([0.0, place[0]]), y=np.array([0.0, place[1]]),
                             z=np.array([10.0, 20.0]))
    truth = np.array([[0.4, 0.1, 0.0], [1.0, -0.3, 0.2]])
    mode = pyuff.prepare_55(
        id1="modes", id2="NONE", id3="NONE", id4="NONE", id5="NONE", model_type=1, analysis_type=2, data_ch=2,
        spec_data_type=8, data_type=2, n_data_per_node=3, r1=np.array([truth[0, 0], local[0] @ truth[1]]),
        r2=np.array([truth[0, 1], local[1] @ truth[1]]), r3=np.array([truth[0, 2], local[2] @ truth[1]]), load_case=1,
        mode_n=1, freq=1.0, modal_m=1.0, modal_damp_vis=0.01, modal_damp_his=0.0, node_nums=np.array([1, 2]))
    file = pyuff.UFF(str(path))
    for k, one in enumerate((system, nodes, mode)):
        file.write_sets(one, "add" if k else "overwrite")
    sensors = [Sensor(channel=f"{node}{axis}", level="l", position_m=at, direction=np.eye(3)[k])
               for node, at in ((1, np.array([0, 0, 10.0])), (2, place)) for k, axis in enumerate("xyz")]
    shape = read_uff_modes(path, sensors).sets[0].shape[:, 0]
    # the format keeps five digits
    np.testing.assert_allclose(shape, truth.ravel(), atol=3e-5)


def test_a_system_that_is_not_there_is_refused(tmp_path):
    pyuff = peer("pyuff")
    nodes = pyuff.prepare_15(node_nums=np.array([1, 2]), def_cs=np.zeros(2, int), disp_cs=np.array([0, 3]),
                             color=np.zeros(2, int), x=np.zeros(2), y=np.zeros(2), z=np.array([1.0, 2.0]))
    mode = pyuff.prepare_55(
        id1="modes", id2="NONE", id3="NONE", id4="NONE", id5="NONE", model_type=1, analysis_type=2, data_ch=2,
        spec_data_type=8, data_type=2, n_data_per_node=3, r1=np.ones(2), r2=np.ones(2), r3=np.ones(2), load_case=1,
        mode_n=1, freq=1.0, modal_m=1.0, modal_damp_vis=0.01, modal_damp_his=0.0, node_nums=np.array([1, 2]))
    file = pyuff.UFF(str(tmp_path / "m.uff"))
    for k, one in enumerate((nodes, mode)):
        file.write_sets(one, "add" if k else "overwrite")
    with pytest.raises(InputError, match="coordinate system 3, which the file does not define"):
        read_uff_modes(tmp_path / "m.uff")


# Records of a campaign ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("words", [{"unit": "g"}, {"units": json.dumps(["m/s2", "mm/s2"])}, {"quantity": "velocity"}])
def test_records_that_state_other_units_are_refused(campaign_folder, write_file, head, words):
    from probupdate.campaign.reading import read_campaign

    folder = campaign_folder([], head=head.replace('"g"', '"m/s2"'))
    write_file(folder, "0.h5", "2019-06-03T10:00Z", np.zeros((6000, 2)), attributes=words)
    with pytest.raises(InputError, match=r"0\.h5, (units?|quantity): a-[xy] is in '.*campaign.toml says"):
        read_campaign(folder)


def test_records_that_state_the_same_units_are_read(campaign_folder, write_file, head):
    from probupdate.campaign.reading import read_campaign

    folder = campaign_folder([], head=head)
    write_file(folder, "0.h5", "2019-06-03T10:00Z", np.zeros((6000, 2)), attributes={
        "unit": json.dumps(["m/s²", "g"]), "quantity": "acceleration"})
    assert len(read_campaign(folder).files) == 1
