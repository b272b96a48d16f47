"""Figures of an identification as files and as plain functions: what is drawn is what was found."""

import numpy as np
import pandas as pd
import pytest

from probupdate.errors import InputError
from probupdate.identification import classification
from probupdate.identification.block_poles import BlockPoles
from probupdate.identification.block_store import write_block_poles
from probupdate.identification.ssi import Poles
from probupdate.modal.modes import ModalData, ModalSet, write_modes
from probupdate.reporting import figures
from probupdate.reporting.identification_pictures import (
    block_of,
    drawings,
    pole_drawings,
    rotor_lines,
    stabilisation_drawing,
    write_figures,
)
from probupdate.reporting.measurement_sections import POLE_WORDS, frequency_table

LABELS = ("FA1", "SS1", "T1")
TRUE = np.array([0.32, 0.33, 1.3])


def made_set(k: int, rng) -> ModalSet:
    frequency = TRUE * (1 + 0.002 * rng.standard_normal(3))
    shape = np.eye(4)[:, :3] + 0.05 * (rng.standard_normal((4, 3)) + 1j * rng.standard_normal((4, 3)))
    if k == 2:
        frequency[2], shape[:, 2] = np.nan, np.nan
    return ModalSet(id=f"2019-06-03T{10 + k}:00Z", frequency_hz=frequency, shape=shape, damping_ratio=np.full(3, 0.01),
                    frequency_std_hz=0.002 * TRUE, shape_std=np.full((4, 3), 0.05),
                    environment={"wind_speed_mps": 5.0 + k, "state": "idling", "rms_mps2": 0.01 * (k + 1),
                                 "rotor_speed_rpm_min": 8.0, "rotor_speed_rpm_max": 9.0})


@pytest.fixture
def modes() -> ModalData:
    rng = np.random.default_rng(0)
    return ModalData(channels=tuple("abcd"), sets=tuple(made_set(k, rng) for k in range(5)), labels=LABELS)


@pytest.fixture
def block(modes) -> BlockPoles:
    """Three orders: modes at each, and one stray at the highest."""
    def order(n, stray=()):
        f = np.concatenate([TRUE, stray])
        return Poles(order=n, frequency_hz=f, damping_ratio=np.full(len(f), 0.01), shape=np.eye(4, len(f)) + 0j)

    line = np.linspace(0, 2.5, 257)
    return BlockPoles(
        id=modes.sets[1].id, start=pd.Timestamp(modes.sets[1].id), minutes=30.0, quantity="acceleration", excluded="",
        notes=(), rms=0.02, poles=order(20), others=(order(18), order(22, [2.1])), line_hz=line,
        spectrum=1e-4 / (1 + line**2),
    )


@pytest.fixture
def poles(modes) -> pd.DataFrame:
    rows = [{"time": pd.Timestamp(s.id).tz_localize(None), "frequency_hz": f, "mac": 0.95, "mode": label,
             "criterion": "kept", "paper_criterion": "kept"}
            for s in modes.sets for f, label in zip(s.frequency_hz, LABELS, strict=True) if np.isfinite(f)]
    return pd.DataFrame([*rows, rows[0] | {"frequency_hz": 0.45, "criterion": "harmonic"}])


def test_every_figure_becomes_a_file_with_its_caption(modes, block, poles, tmp_path):
    write_modes(modes, tmp_path / "modes.json")
    store = tmp_path / "modes.json.blocks"
    store.mkdir()
    write_block_poles(store / "20190603T110000Z.poles.npz", block, [])
    scada = pd.DataFrame({"time": pd.date_range("2019-06-03T10:00", periods=6, freq="h"), "state": "idling",
                          "wind_speed_mps": np.arange(6.0), "rotor_speed_rpm": [0, 5, 9, 9, 9, np.nan]})
    files = write_figures(tmp_path / "modes.json", tmp_path / "png", modes=modes, poles=poles, scada=scada,
                          block_id=block.id)
    names = [f.stem for f in files[:-1]]
    assert names == ["fig4_wind_and_state", "fig5_all_poles", "fig6_mac", "fig7_complexity", "poles_classified",
                     "stabilisation", "auto_mac", "argand", "mac_over_sets", "mpc_map", "conditions"]
    assert all(f.stat().st_size > 5000 for f in files[:-1])
    captions = files[-1].read_text().splitlines()
    assert [c.split(":")[0] for c in captions] == [f.name for f in files[:-1]]
    one = ModalData(channels=modes.channels, sets=modes.sets[:1], labels=LABELS)
    few = write_figures(tmp_path / "modes.json", tmp_path / "svg", modes=modes, poles=None, kind="svg")
    pair = [write_figures(tmp_path / "modes.json", tmp_path / name, modes=one, poles=None, kind="svg") for name in "ab"]
    assert [f.read_bytes() for f in pair[0]] == [f.read_bytes() for f in pair[1]]
    text = next(f for f in few if f.stem == "conditions").read_text()
    assert "wind [m/s]" in text and "motion, rms [m/s²]" in text and "rotor [rpm]" not in text
    with pytest.raises(InputError, match="'gif' is not a kind of file"):
        write_figures(tmp_path / "modes.json", tmp_path / "gif", modes=modes, poles=None, kind="gif")
    with pytest.raises(InputError, match="block 2019-06-03T12:00Z: is not kept in"):
        block_of(tmp_path / "modes.json", modes, "2019-06-03T12:00Z")
    assert block_of(tmp_path / "elsewhere.json", modes) is None


def test_stabilisation_tells_what_came_back(modes, block):
    drawing = stabilisation_drawing(block, modes)
    svg = figures.svg_text(drawing.figure, "s")
    for text in ("stable in f, damping and shape", "new", *LABELS, "model order [-]", "1P", "(m/s²)²/Hz"):
        assert text in svg
    assert "$" not in svg
    axes = next(a for a in drawing.figure.axes if a.get_xlabel() == "frequency [Hz]")
    drawn = {c.get_label(): c.get_offsets() for c in axes.collections if c.get_label() in figures_keys()}
    stable, new = drawn["stable in f, damping and shape"], drawn["new"]
    assert len(stable) == 6 and set(stable[:, 1]) == {20.0, 22.0}
    assert sorted(map(tuple, new)) == sorted([*((f, 18.0) for f in TRUE), (2.1, 22.0)])


def figures_keys():
    from probupdate.reporting.figures_identification import STEADINESS

    return STEADINESS


def test_pole_figures_hold_every_kept_pole(poles):
    last = list(pole_drawings(poles, list(LABELS), {"3P 0.45": 0.45}))[-1]
    legend = figures.svg_text(last.figure, "p")
    for text in ("FA1 (5)", "T1 (4)", "removed as harmonic (1)", "3P 0.45"):
        assert text in legend
    # of what has no rotor nothing is said of one
    said = [d.caption for d in pole_drawings(poles, ["V1", "H1"], {})]
    assert len(said) == 3 and not any("rotor" in text or "P-freq" in text for text in said)


def test_maps_show_their_numbers():
    value = np.array([[1.0, 0.12], [np.nan, 0.5]])
    svg = figures.svg_text(figures.mac_map(value, ["a", "b"], ["c", "d"], across="x", up="y"), "m")
    assert all(f">{t}<" in svg for t in ("1.00", "0.12", "0.50")) and "nan" not in svg.lower()


def test_rotor_lines_need_a_rotor_that_turned():
    assert rotor_lines(None) == {}
    assert rotor_lines(pd.DataFrame({"rotor_speed_rpm": [np.nan, np.nan]})) == {}
    lines = rotor_lines(pd.DataFrame({"rotor_speed_rpm": np.full(50, 9.0)}))
    assert lines == {"1P 0.15": pytest.approx(0.15), "3P 0.45": pytest.approx(0.45), "6P 0.90": pytest.approx(0.9)}


def test_nothing_identified_draws_nothing():
    empty = ModalSet(id="a", frequency_hz=[np.nan], shape=np.full((2, 1), np.nan), damping_ratio=[np.nan],
                     frequency_std_hz=[np.nan], shape_std=np.full((2, 1), np.nan))
    assert list(drawings(ModalData(channels=("a", "b"), sets=(empty,)))) == []


def test_every_criterion_of_a_pole_is_put_in_words():
    """The table of poles kept and removed leaves no cell empty."""
    names = {value for name, value in vars(classification).items() if name.isupper() and isinstance(value, str)}
    assert {"kept", "other order", "unstable"} <= names == set(POLE_WORDS)


def test_of_one_set_each_mode_stands_once_and_of_several_once_for_each_state(modes):
    one = ModalData(channels=modes.channels, sets=modes.sets[:1])
    assert [row[0] for row in frequency_table(one, LABELS, False).rows] == list(LABELS)
    assert [row[:2] for row in frequency_table(modes, LABELS, False).rows] == [
        (label, state) for label in LABELS for state in ("all", "idling")]
