"""A campaign on disk through identification: modes within their scatter, nothing breaks where one is absent."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.identification.environment import fore_aft_deg
from probupdate.identification.identify import SSISettings, identify
from probupdate.identification.reference import ReferenceModes
from probupdate.modal.modes import mac, plane_mac, read_modes, unit_largest

IDLING = {"power_kw": -20.0, "rotor_speed_rpm": 0.3, "rotor_speed_rpm_min": 0.2, "rotor_speed_rpm_max": 0.5,
          "nacelle_heading_deg": 0.0, "wind_speed_mps": 3.0}
RUNNING = IDLING | {"power_kw": 2500.0, "rotor_speed_rpm": 9.0, "rotor_speed_rpm_min": 8.9, "rotor_speed_rpm_max": 9.1}


def scatter(jacket, times: float = 5.0) -> np.ndarray:
    """Relative: `times` the Cramer-Rao bound of half an hour; pairs this close have some twice the bound."""
    return times * np.sqrt(jacket.damping_ratio / (4 * np.pi * jacket.frequency_hz * 1800))


def test_modes_come_out_within_their_scatter(jacket, reference, write_campaign, validation):
    row = validation(what="error over stated standard deviation, four half hours, five modes: median of f, damping",
                     reference="0.67 of normal errors", why="all but one of a thousand such samples")
    campaign = read_campaign(write_campaign([jacket.record(9000, seed=k) for k in range(4)]))
    result = identify(campaign, reference)
    assert result.data.labels == reference.labels
    for s in result.data.sets:
        assert s.measured.all()
        assert np.all(np.abs(s.frequency_hz / jacket.frequency_hz - 1) < scatter(jacket, 8))
        assert plane_mac(s.shape[:, [0, 1]], jacket.shape[:, [0, 1]]) > 0.99
        assert plane_mac(s.shape[:, [3, 4]], jacket.shape[:, [3, 4]]) > 0.99
        assert mac(s.shape[:, [2]], jacket.shape[:, [2]])[0, 0] > 0.98
    # standard deviations of single blocks against their errors: the median of |error / standard deviation| over 4
    # blocks and 5 modes is
    # 0.67 for normal errors, and 0.25 to 1.2 in all but one of a thousand such samples
    error = np.array([(s.frequency_hz - jacket.frequency_hz) / s.frequency_std_hz for s in result.data.sets])
    damping = np.array([(s.damping_ratio - jacket.damping_ratio) / s.damping_ratio_std for s in result.data.sets])
    row.between(np.median(np.abs(error)), 0.25, 1.2, of="f")
    row.between(np.median(np.abs(damping)), 0.25, 1.2, of="damping")
    assert all(np.isfinite(s.shape_std).all() and s.covariance_factors.n_column == 30 for s in result.data.sets)
    assert [s.environment["rms_mps2"] for s in result.data.sets] == pytest.approx(
        [np.sqrt(np.mean(np.var(jacket.record(9000, seed=k).astype(np.float32), axis=0))) for k in range(4)], rel=1e-6)
    assert "no nacelle heading in SCADA" in result.summary and "no rotor speed in SCADA" in result.summary


def test_a_design_model_that_is_far_off_still_names_the_modes(jacket, reference, write_campaign):
    """Frequencies 10 to 25 % too low and shapes bent: the planes are told all the same."""
    campaign = read_campaign(write_campaign([jacket.record(9000, seed=k) for k in range(3)]))
    height = np.array([s.position_m[2] for s in campaign.sensors])
    rough = ReferenceModes(
        labels=reference.labels, frequency_hz=jacket.frequency_hz * [0.93, 0.93, 0.9, 0.78, 0.77],
        shape=jacket.shape * (0.8 + 0.2 * height / 90)[:, None], pairs=reference.pairs,
    )
    for s in identify(campaign, rough).data.sets:
        assert np.all(np.abs(s.frequency_hz / jacket.frequency_hz - 1) < scatter(jacket, 8))


def test_a_mode_that_is_not_excited_is_nan_and_the_rest_stays(jacket, reference, write_campaign):
    quiet = replace(jacket, strength=np.array([1.0, 0.8, 0.0, 0.3, 0.25]))
    result = identify(read_campaign(write_campaign([quiet.record(9000, seed=k) for k in range(2)])), reference)
    for s in result.data.sets:
        assert s.measured.tolist() == [True, True, False, True, True]
        assert np.isnan(s.shape[:, 2]).all()


def test_blocks_that_cannot_be_used_stay_with_their_reason(jacket, reference, write_campaign, tmp_path):
    records = [jacket.record(9000, seed=k) for k in range(3)]
    records[1][100:8000] = np.nan
    records[2][:, 4] = 0.125
    result = identify(read_campaign(write_campaign(records)), reference)
    good, gap, flat = result.data.sets
    assert good.measured.all() and not gap.measured.any() and not flat.measured.any()
    assert gap.environment["excluded"] == "gaps: only 12 % of the samples were measured in all channels"
    assert flat.environment["excluded"] == "no signal in TP-B-y"
    assert "1 of 3 blocks identified" in result.summary
    assert any("gaps: only 12 %" in note for note in result.notes)
    files = result.write(tmp_path / "modes.json")
    assert [f.name for f in files] == ["modes.json", "modes.deviations.h5", "modes.poles.csv"]
    again = read_modes(files[0])
    assert again.sets[0].covariance_factors.ln_frequency == pytest.approx(good.covariance_factors.ln_frequency,
                                                                          rel=1e-6)
    assert again.sets[1].covariance_factors is None
    assert again.sets[1].environment["excluded"] == gap.environment["excluded"]
    assert again.sets[0].frequency_hz == pytest.approx(good.frequency_hz)
    table = pd.read_csv(files[-1])
    expected = ["time", "frequency_hz", "damping_ratio", "mpc", "mac", "mode", "criterion", "paper_criterion"]
    assert set(expected) <= set(table)
    assert (table["criterion"] == "kept").sum() == 5 and set(table["time"]) == {"2019-06-03T10:00:00Z"}


def test_no_usable_block_is_an_error(reference, write_campaign):
    campaign = read_campaign(write_campaign([np.full((9000, 18), np.nan)]))
    with pytest.raises(InputError, match=r"none of 1 blocks can be used; the first: gaps: only 0 % of the samples"):
        identify(campaign, reference)


def test_the_rotor_s_line_is_removed_where_scada_tells_its_speed(jacket, reference, write_campaign, scada_rows):
    """3P at 0.45 Hz, in phase with FA1's shape, with as much motion as the mode."""
    t = np.arange(9000) / 5
    line = np.outer(np.cos(2 * np.pi * 0.45 * t), jacket.shape[:, 0])
    records = [jacket.record(9000, seed=0), jacket.record(9000, seed=1) + line]
    campaign = read_campaign(write_campaign(records, scada_rows([IDLING, RUNNING])))
    # what reading a column found of it is said here too
    campaign.scada.attrs["notes"] = ("suspect: pitch_deg in SCADA is in radians; the column is not used",)
    result = identify(campaign, reference)
    assert "suspect: pitch_deg in SCADA is in radians; the column is not used" in result.summary.splitlines()
    states = [s.environment["state"] for s in result.data.sets]
    assert states == ["idling", "rated"]  # the highest power recorded stands for the rated one, as the summary says
    assert "rated power taken as the highest recorded, 2500 kW" in result.summary
    poles = result.poles
    near = poles[(poles["time"] == poles["time"].max()) & (abs(poles["frequency_hz"] - 0.45) < 0.005)]
    assert len(near) and set(near["criterion"]) <= {"harmonic", "damping", "mac"}
    assert "harmonic" in set(near["criterion"]) or (near["damping_ratio"] <= 0).any()
    best = near.loc[near["mac"].idxmax()]
    assert best["mac"] > 0.95 and best["paper_criterion"] == "kept"  # MAC and complexity pass it
    for s in result.data.sets:
        assert np.all(np.abs(s.frequency_hz / jacket.frequency_hz - 1) < scatter(jacket, 8))


def test_harmonics_are_taken_out_before_where_asked(jacket, reference, write_campaign, scada_rows, tmp_path):
    """3P and 6P of a rotor whose speed wanders: gone from the poles, said block by block; changed SCADA is refused."""
    t = np.arange(9000) / 5
    angle = 2 * np.pi * np.cumsum(0.15 + 0.0005 * np.sin(2 * np.pi * t / 700)) / 5
    line = np.outer(np.cos(3 * angle), jacket.shape[:, 0]) + 0.5 * np.outer(np.cos(6 * angle + 1), jacket.shape[:, 3])
    records = [jacket.record(9000, seed=0), jacket.record(9000, seed=1) + line]
    folder = write_campaign(records, scada_rows([IDLING, RUNNING]))
    plain = identify(read_campaign(folder), reference)
    store = tmp_path / "store"
    result = identify(read_campaign(folder), reference, settings=SSISettings(harmonics="remove"), store=store)
    assert [note for note in result.notes if "harmonics" in note] == [
        "2019-06-03T10:00Z: harmonics stay: the rotor stood or idled: 0.2 rpm",
        "2019-06-03T10:30Z: harmonics taken out: 3P, 6P"]

    def lines(found) -> int:
        poles = found.poles[found.poles["time"] == found.poles["time"].max()]
        near = np.min(np.abs(poles["frequency_hz"].to_numpy()[:, None] - [0.45, 0.9]), axis=1) < 0.01
        return int((near & (poles["damping_ratio"] < 0.01)).sum())

    assert lines(plain) >= 1 and lines(result) == 0
    assert np.all(np.abs(result.data.sets[1].frequency_hz / jacket.frequency_hz - 1) < scatter(jacket, 8))
    assert np.isfinite(result.data.sets[1].frequency_std_hz).all()
    scada_rows([IDLING, RUNNING | {"rotor_speed_rpm_max": 9.4}]).to_csv(folder / "scada.csv", index=False)
    with pytest.raises(InputError, match=r"was made of other records: then rotor 8\.9 to 9\.1 rpm; now .* 9\.4 rpm"):
        identify(read_campaign(folder), reference, settings=SSISettings(harmonics="remove"), store=store)
    with pytest.raises(InputError, match="harmonics: 'cut' is unknown"):
        SSISettings(harmonics="cut")


def test_modes_keep_their_names_as_the_nacelle_turns(jacket, reference, write_campaign, scada_rows):
    """Second pair, 4.5 % apart: at heading 65 deg (clockwise from -x) FA2 moves along -65 deg with its frequency."""
    records = [jacket.record(9000, seed=0), jacket.record(9000, seed=1, turn_deg=-65)]
    scada = scada_rows([IDLING, IDLING | {"nacelle_heading_deg": 65.0}])
    campaign = read_campaign(write_campaign(records, scada))
    assert fore_aft_deg({"nacelle_heading_deg": 65.0}, campaign) == 115 and fore_aft_deg({}, campaign) == 0
    for s in identify(campaign, reference).data.sets:
        assert np.all(np.abs(s.frequency_hz / jacket.frequency_hz - 1)[2:] < scatter(jacket, 6)[2:])


def test_a_velocity_among_accelerations_is_converted(jacket, reference, write_campaign, validation):
    """One channel integrated by hand: the modes are those of the campaign of accelerations, within the flanks of the
    conversion's band (2 Hz at 5 Hz: the second pair lies in them)."""
    row = validation(what="a velocity among accelerations, converted: f in standard deviations of half an hour, shape",
                     reference="the campaign of accelerations", why="the band leaves noise out")
    record = jacket.record(9000, seed=0)
    plain = identify(read_campaign(write_campaign([record])), reference).data.sets[0]
    line = np.fft.rfftfreq(9000, 1 / 5)
    spectrum = np.fft.rfft(record[:, 3])
    spectrum[1:] /= 2j * np.pi * line[1:]
    mixed = record.copy()
    mixed[:, 3] = np.fft.irfft(np.where(line > 0.04, spectrum, 0), 9000)
    campaign = read_campaign(write_campaign([mixed], quantity="velocity"))
    result = identify(campaign, reference)
    assert "1 channel of velocity converted to acceleration" in result.summary
    assert any("TP-B-x converted to acceleration" in note for note in result.notes)
    converted = result.data.sets[0]
    # one record, two estimates: what the band leaves out moves them by less than three standard deviations of half an
    # hour
    row.error((converted.frequency_hz / plain.frequency_hz - 1)[:3] / scatter(jacket, 1)[:3], below=3, of="f")
    row.error(converted.shape[3, :3] - plain.shape[3, :3], below=0.05, of="shape")


def test_a_reference_at_other_channels_is_refused(jacket, reference, write_campaign):
    campaign = read_campaign(write_campaign([jacket.record(9000, seed=0)]))
    with pytest.raises(InputError, match="have 17 channels, the campaign 18"):
        identify(campaign, replace(reference, shape=reference.shape[:17]))


@pytest.mark.parametrize(("change", "problem"), [
    ({"order": 1}, "order: 1 is not a whole number from 2"), ({"block_rows": 2.5}, "block_rows: 2.5 is not a whole"),
    ({"spread": -2}, "spread: -2"), ({"target_rate_hz": 0.0}, "target rate: 0.0 Hz is not positive"),
])
def test_settings_that_make_no_sense_are_refused(change, problem):
    with pytest.raises(InputError, match=problem):
        SSISettings(**change)


def test_shapes_lie_along_the_real_axis_with_largest_part_one():
    shape = (np.array([[1.0, -2.0, 0.5]]).T + 0.02j) * np.exp(1.1j)
    scaled = unit_largest(shape)
    assert scaled.real.max() == pytest.approx(1) and abs(scaled.imag).max() < 0.02
    assert mac(scaled, shape)[0, 0] == pytest.approx(1)


def test_progress_is_told(jacket, reference, write_campaign):
    reports = []
    campaign = read_campaign(write_campaign([jacket.record(9000, seed=0)]))
    identify(campaign, reference, progress=lambda *a: reports.append(a))
    assert reports[:2] == [("identifying blocks", 0, 1), ("identifying blocks", 1, 1)]
    assert ("classifying modes", 1, 1) in reports and reports[-1] == ("standard deviations of modes", 1, 1)
