"""Setups with common references, merged: standard deviations against finite differences, shapes against a known
structure."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import probupdate
from probupdate.campaign.reading import read_campaign
from probupdate.errors import InputError
from probupdate.identification.identify import SSISettings, identify
from probupdate.identification.roving import Setup, merge_setups
from probupdate.identification.setups import identify_setups
from probupdate.modal.modes import CovarianceFactors, ModalData, ModalSet, mac, plane_mac, read_modes, unit_largest

# references at one leg and the highest tower level; three setups share out the other fourteen channels
REFERENCES = [0, 1, 16, 17]
ROVING = [[2, 3, 4, 14, 15], [5, 6, 7, 12, 13], [8, 9, 10, 11]]


def nan(*shape):
    return np.full(shape, np.nan)


def made_set(shape, frequency, rng, size=1e-3, n_column=6, id="a") -> ModalSet:
    """A set with drawn errors and standard deviations of that size."""
    n_channel, n_mode = shape.shape
    shape = unit_largest(shape * np.exp(1j * rng.uniform(0, 0.3, n_mode)) + size * rng.standard_normal(shape.shape))
    d_shape = size * (rng.standard_normal((n_channel, n_mode, n_column)) + 1j * rng.standard_normal((1, n_mode, 1)))
    return ModalSet(
        id=id, frequency_hz=frequency * (1 + size * rng.standard_normal(n_mode)), damping_ratio=np.full(n_mode, 0.01),
        shape=shape, frequency_std_hz=nan(n_mode), shape_std=nan(n_channel, n_mode),
        covariance_factors=CovarianceFactors(ln_frequency=size * rng.standard_normal((n_mode, n_column)),
                                             damping_ratio=size * rng.standard_normal((n_mode, n_column)),
                                             shape=d_shape),
    )


def made_setups(
    jacket, sensor_list, frequency, labels=("FA1", "SS1", "T1", "FA2", "SS2"), n_block=2, seed=0,
    references=tuple(REFERENCES), roving=tuple(ROVING),
):
    rng = np.random.default_rng(seed)
    setups = []
    for number, own in enumerate(roving):
        rows = [*own[:2], *references, *own[2:]]
        sensors = tuple(sensor_list[k] for k in rows)
        sets = tuple(made_set(jacket.shape[rows], frequency, rng, id=str(b)) for b in range(n_block))
        data = ModalData(channels=tuple(s.channel for s in sensors), sets=sets, labels=labels)
        setups.append(Setup(name=f"setup{number}", sensors=sensors, data=data))
    return setups


def moved(setups, column: int, step: float):
    """Every quantity of every block moved by `step` times one column of its own block; the column counts through."""
    result, first = [], 0
    for setup in setups:
        sets = []
        for s in setup.data.sets:
            d = s.covariance_factors
            if first <= column < first + d.n_column:
                k = column - first
                s = replace(
                    s, frequency_hz=s.frequency_hz * np.exp(step * d.ln_frequency[:, k]),
                    damping_ratio=s.damping_ratio + step * d.damping_ratio[:, k],
                    shape=s.shape + step * d.shape[:, :, k],
                )
            first += d.n_column
            sets.append(s)
        result.append(replace(setup, data=replace(setup.data, sets=tuple(sets))))
    return result


@pytest.mark.parametrize("apart", [0.05, 0.0005], ids=["resolved", "pairs as planes"])
def test_deviations_of_the_merged_set_are_finite_differences(jacket, sensor_list, apart, validation):
    checked = validation(what="covariance factors of merged setups, pairs resolved and not", reference="differences",
                         why="rounding; weights of shapes are taken as constant, of the largest")
    frequency = np.array([0.32, 0.32 * (1 + apart), 1.3, 1.93, 1.93 * (1 + apart)])
    setups = made_setups(jacket, sensor_list, frequency)
    merged = merge_setups(setups).data.sets[0].covariance_factors
    assert merged.n_column == 36
    for column in (0, 8, 17, 35):
        ends = [merge_setups(moved(setups, column, step)).data.sets[0] for step in (1e-3, -1e-3)]
        f, zeta, shape = ((a - b) / 2e-3 for a, b in (
            (np.log(ends[0].frequency_hz), np.log(ends[1].frequency_hz)),
            (ends[0].damping_ratio, ends[1].damping_ratio), (ends[0].shape, ends[1].shape)))
        # what is left out: shapes' weights, too, move a little with the shapes, which matters by the misfit (0.1 %)
        checked.error(merged.ln_frequency[:, column] - f, below=1e-9, of="f, damping")
        checked.error(merged.damping_ratio[:, column] - zeta, below=1e-9, of="f, damping")
        checked.error((merged.shape[:, :, column] - shape) / np.abs(shape).max(), below=5e-3, of="shapes")


def test_channels_modes_and_statistics_of_the_merge(jacket, sensor_list, tmp_path):
    setups = made_setups(jacket, sensor_list, jacket.frequency_hz)
    result = merge_setups(setups)
    s = result.data.sets[0]
    assert len(result.data.channels) == 18 and result.references == tuple(sensor_list[k].channel for k in REFERENCES)
    assert [x.channel for x in result.sensors] == list(result.data.channels)
    place = [x.channel for x in sensor_list]
    truth = jacket.shape[[place.index(c) for c in result.data.channels]]
    assert np.diag(mac(s.shape, truth)).min() > 0.9999
    assert "18 channels, 5 modes" in result.summary and "disagree" not in result.summary
    files = result.write(tmp_path / "modes.json")
    assert [f.name for f in files] == ["modes.json", "modes.deviations.h5", "modes.setups.csv"]
    assert read_modes(files[0]).sets[0].shape_std == pytest.approx(s.shape_std)
    # one setup measured another state: said, and the standard deviation covers the difference
    odd = setups[2].data.sets
    odd = tuple(replace(x, frequency_hz=x.frequency_hz * 1.05) for x in odd)
    other = merge_setups([*setups[:2], replace(setups[2], data=replace(setups[2].data, sets=odd))])
    assert "the setups' frequencies disagree" in other.summary
    assert np.all(other.data.sets[0].frequency_std_hz > 3 * s.frequency_std_hz)


def test_numbers_are_matched_by_frequency_and_references(jacket, sensor_list):
    setups = made_setups(jacket, sensor_list, jacket.frequency_hz, labels=("1", "2", "3", "4", "5"))
    # the second setup did not see mode 1, so that its numbers are one off
    data = setups[1].data
    less = tuple(replace(s, **{key: value[..., 1:] for key, value in {
        "frequency_hz": s.frequency_hz, "damping_ratio": s.damping_ratio, "shape": s.shape, "shape_std": s.shape_std,
        "frequency_std_hz": s.frequency_std_hz, "damping_ratio_std": s.damping_ratio_std}.items()},
        covariance_factors=CovarianceFactors(ln_frequency=s.covariance_factors.ln_frequency[1:],
                                             damping_ratio=s.covariance_factors.damping_ratio[1:],
                                             shape=s.covariance_factors.shape[:, 1:])) for s in data.sets)
    setups[1] = replace(setups[1], data=replace(data, sets=less, labels=("1", "2", "3", "4")))
    result = merge_setups(setups)
    assert result.data.labels == ("1", "2", "3", "4", "5")
    s = result.data.sets[0]
    assert s.frequency_hz == pytest.approx(jacket.frequency_hz, rel=5e-3)
    # its channels are left out of mode 1 only, and this is said
    own = [result.data.channels.index(sensor_list[k].channel) for k in ROVING[1]]
    assert np.isnan(s.shape[own, 0]).all() and np.isfinite(s.shape[:, 1:]).all()
    assert np.isfinite(np.delete(s.shape[:, 0], own)).all()
    assert "1: 0.3158 Hz" in result.summary and "not found in setup1" in result.summary
    # two modes of one shape at two references are two, by their frequency
    few = [replace(x, sensors=x.sensors[:3], data=ModalData(
        channels=x.data.channels[:3], labels=x.data.labels, sets=tuple(replace(
            s, shape=s.shape[:3], shape_std=s.shape_std[:3],
            covariance_factors=replace(s.covariance_factors, shape=s.covariance_factors.shape[:3]))
                                                                       for s in x.data.sets)))
        for x in made_setups(jacket, sensor_list, jacket.frequency_hz, labels=("1", "2", "3", "4", "5"),
                             roving=([2, 3], [5, 6], [8, 9]))]
    assert merge_setups(few).data.n_mode == 5


def test_a_mode_that_moves_no_reference_keeps_its_frequency_only(jacket, sensor_list):
    """Sensors on the tower's axis do not see torsion."""
    setups = made_setups(jacket, sensor_list, jacket.frequency_hz, references=(12, 13, 16, 17),
                         roving=([0, 1, 2, 14, 15], [3, 4, 5, 6, 7], [8, 9, 10, 11]))
    result = merge_setups(setups)
    s = result.data.sets[0]
    assert np.isfinite(s.frequency_hz).all() and np.isnan(s.shape[:, 2]).all()
    assert np.isfinite(s.shape[:, [0, 1, 3, 4]]).all()
    assert "the references hardly move in it" in result.summary


def test_setups_that_do_not_fit_are_refused(jacket, sensor_list):
    setups = made_setups(jacket, sensor_list, jacket.frequency_hz)
    with pytest.raises(InputError, match="1 cannot be merged"):
        merge_setups(setups[:1])
    wrong = list(setups[1].sensors)
    wrong[3] = replace(wrong[3], position_m=wrong[3].position_m + np.array([0, 0, 2.0]))
    with pytest.raises(InputError, match=r"sits elsewhere in another setup \(2 m away"):
        merge_setups([setups[0], replace(setups[1], sensors=tuple(wrong))])
    names = tuple(f"{c}'" for c in setups[1].data.channels)
    apart = replace(setups[1], data=replace(setups[1].data, channels=names))
    with pytest.raises(InputError, match="have no channel in common"):
        merge_setups([setups[0], apart])
    bare = tuple(replace(s, covariance_factors=None) for s in setups[1].data.sets)
    with pytest.raises(InputError, match="setup1: a block has no standard deviations"):
        merge_setups([setups[0], replace(setups[1], data=replace(setups[1].data, sets=bare))])


def setup_campaign(folder, sensors, record, *, block_minutes):
    """A campaign of one setup at 5 Hz, written and read."""
    (folder / "acceleration").mkdir(parents=True)
    lines = [f'name = "Setup"\nsampling_rate_hz = 5.0\nblock_minutes = {block_minutes}\n']
    lines += [f'[[sensor]]\nchannel = "{s.channel}"\nlevel = "{s.level}"\nposition_m = {s.position_m.tolist()}\n'
              f'direction = {s.direction.tolist()}\nunit = "m/s2"\n' for s in sensors]
    (folder / "campaign.toml").write_text("".join(lines))
    with h5py.File(folder / "acceleration" / "0.h5", "w") as file:
        data = file.create_dataset("data", data=record)
        data.attrs["start"], data.attrs["sampling_rate_hz"] = "2020-01-01T00:00:00Z", 5.0
    return read_campaign(folder)


def test_roving_records_give_the_whole_shape(jacket, reference, sensor_list, tmp_path, validation):
    """Records of three setups, ten minutes twice each: all eighteen channels within their standard deviations."""
    row = validation(what="roving records of three setups: planes and MAC; frequencies in stated standard deviations",
                     reference="truth")
    setups = []
    for number, own in enumerate(ROVING):
        rows = [*REFERENCES, *own]
        campaign = setup_campaign(tmp_path / f"setup{number}", [sensor_list[k] for k in rows],
                                  jacket.record(6000, seed=40 + number)[:, rows], block_minutes=10)
        found = identify(campaign, replace(reference, shape=reference.shape[rows]),
                         settings=SSISettings(order=14, block_rows=20, spread=6, sub_records=20))
        setups.append(Setup(name=f"setup{number}", sensors=campaign.sensors, data=found.data))
    s = merge_setups(setups).data.sets[0]
    place = [x.channel for x in sensor_list]
    channels = merge_setups(setups).data.channels
    truth = jacket.shape[[place.index(c) for c in channels]]
    for pair in ([0, 1], [3, 4]):
        row.least(plane_mac(s.shape[:, pair], truth[:, pair]), above=0.98, of="shapes")
    row.least(mac(s.shape[:, [2]], truth[:, [2]])[0, 0], above=0.98, of="shapes")
    error = (s.frequency_hz / jacket.frequency_hz - 1) / (s.frequency_std_hz / s.frequency_hz)
    row.error(error, below=4, of="frequencies")
    # torsion, which no neighbour turns: every component within its own standard deviations, the largest sets the scale
    scaled = truth[:, 2] / truth[np.argmax(np.abs(s.shape[:, 2])), 2]
    ratio = np.abs(s.shape[:, 2].real - scaled) / np.maximum(s.shape_std[:, 2], 1e-3)
    assert np.mean(ratio < 2) > 0.8 and ratio.max() < 6


KNOWN_HZ = (1.2284, 1.4358, 2.1000, 4.0175, 4.7704, 6.6822, 7.6158, 9.6653, 12.166, 12.598)
FRAME = Path(__file__).parents[2].parent / "shared" / "data" / "weimar_frame"


def ten_modes(setups, **options):
    settings = probupdate.IdentificationSettings(**options)
    merged = probupdate.identify_setups([FRAME / f"s{k:02d}" for k in setups], settings=settings)
    found = merged.data.sets[0].frequency_hz
    return merged, [float(found[np.argmin(np.abs(found - f))] / f - 1) for f in KNOWN_HZ]


@pytest.mark.skipif(not FRAME.exists(), reason="the measured frame's records are not beside the project")
def test_a_measured_frame_in_five_roving_setups_shows_its_ten_modes(validation):
    """A laboratory frame, lasers and accelerometers; ten modes known from an independent identification of all setups.
    One setup's frequencies scatter by 0.1 % or so, five by half of it."""
    row = validation(what="a measured frame, five of its fifteen roving setups, settings proposed from the record",
                     reference="ten modes of an independent identification of all setups",
                     why="half the scatter of single setups")
    merged, error = ten_modes((1, 4, 7, 10, 13))
    assert "settings proposed from the record" in merged.summary
    row.error(error, below=2e-3)
    assert np.all(np.isfinite(merged.data.sets[0].frequency_std_hz)) and len(merged.data.channels) == 17


@pytest.mark.long
@pytest.mark.skipif(not FRAME.exists(), reason="the measured frame's records are not beside the project")
@pytest.mark.parametrize("options", [
    {}, {"rate_hz": 28.0, "order": 16}, {"rate_hz": 32.0, "order": 40}, {"rate_hz": 40.0, "order": 16},
    {"rate_hz": 64.0, "order": 60}, {"rate_hz": 20.0, "order": 60}, {"rate_hz": 20.0, "order": 16},
], ids=str)
def test_the_measured_frame_s_ten_modes_at_any_rate_and_order(options, validation):
    row = validation(what="the same, all fifteen setups, seven pairs of rate and order (long)",
                     reference="the same, what each rate passes", why="the scatter of single setups")
    _, error = ten_modes(range(1, 16), **options)
    held = np.array(KNOWN_HZ) < 0.45 * options.get("rate_hz", 64.0)
    row.error(np.array(error)[held], below=1e-3)


def test_setups_are_named_by_a_model_after_their_modes_are_found(jacket, sensor_list, tmp_path):
    """Two setups of the made jacket, a model of its shapes as a function: names, records, and one mode of the model
    that nothing shows."""
    from probupdate.identification.reference import ReferenceModes

    campaigns = []
    for number, own in enumerate(ROVING[:2]):
        rows = [*REFERENCES, *own]
        campaigns.append(setup_campaign(tmp_path / f"setup{number}", [sensor_list[k] for k in rows],
                                        jacket.record(9000, seed=60 + number)[:, rows], block_minutes=15))
    names = ("FA1", "SS1", "T1", "FA2", "SS2")
    model = ReferenceModes(labels=names, frequency_hz=jacket.frequency_hz * 0.9, shape=jacket.shape,
                           pairs=((0, 1), (3, 4)))
    heave = np.array([1.0 if s.direction[2] else 0.0 for s in sensor_list])[:, None]
    others = ReferenceModes(labels=("L1",), frequency_hz=[1.6], shape=heave)
    merged = identify_setups(campaigns, ("a", "b"), reference=model, others=others,
                             channels=tuple(s.channel for s in sensor_list),
                             settings=SSISettings(order=14, block_rows=20, spread=6, sub_records=20))
    assert merged.data.labels == names and [r.match for r in merged.data.records] == ["alike"] * 5
    s = merged.data.sets[0]
    assert np.all(np.abs(s.frequency_hz / jacket.frequency_hz - 1) < 4 * s.frequency_std_hz / s.frequency_hz)
    assert [x.label for x in merged.data.model_only] == ["L1"] and "L1 at 1.6 Hz is in no block" in merged.summary
    assert merged.data.records[0].frequency_ratio == pytest.approx(1 / 0.9, rel=0.01)


@pytest.mark.parametrize("change", [1.02, 0.97])
def test_setups_of_a_structure_that_changed_have_all_its_modes(jacket, sensor_list, tmp_path, change, validation):
    """Pairs 2 and 5 % apart: the second setup's FA1 is where the first one's SS1 is."""
    row = validation(what="two setups whose frequencies are 2 or 3 % apart: MAC and planes of all five modes; "
                          "frequencies beside the mean of both",
                     reference="the modes put in")
    campaigns = []
    for number, own in enumerate(ROVING[:2]):
        rows = [*REFERENCES, *own]
        then = replace(jacket, frequency_hz=jacket.frequency_hz * (change if number else 1.0))
        campaigns.append(setup_campaign(tmp_path / f"setup{number}", [sensor_list[k] for k in rows],
                                        then.record(18000, seed=80 + number)[:, rows], block_minutes=15))
    merged = identify_setups(campaigns, ("a", "b"), settings=SSISettings(order=14, block_rows=20, spread=6,
                                                                        sub_records=20))
    s = merged.data.sets[0]
    truth = jacket.shape[[[x.channel for x in sensor_list].index(c) for c in merged.data.channels]]
    assert f"% {'above' if change > 1 else 'below'} those of a, with equal shapes" in merged.summary
    row.error(s.frequency_hz / jacket.frequency_hz / np.sqrt(change) - 1, below=0.004, of="frequencies")
    for pair in ([0, 1], [3, 4]):
        row.least(plane_mac(s.shape[:, pair], truth[:, pair]), above=0.97, of="shapes")
    row.least(mac(s.shape[:, [2]], truth[:, [2]])[0, 0], above=0.97, of="shapes")
