"""Every reader of the package with a whole file of its kind; a test holds the table against the functions in the
code."""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
from program_files import HERE, SHAPE, Made, calculix, elastodyn, module_of, pole_tables, punch, subdyn, uff

import probupdate

PACKAGE = Path(probupdate.__file__).parent
for folder in ("updating", "reporting", "campaign"):
    sys.path.append(str(HERE.parent / folder))
sys.path.append(str(HERE.parent))

TOML = 'name = "{0}"\nunit = "-"\ninitial = 1.0\ncov = 0.1\nlower = 0.1\nupper = 5.0\n'


def update_record():
    from updating_records import record

    return record()


def modes(folder: Path) -> Made:
    from probupdate.modal.modes import CovarianceFactors, ModalData, ModalSet, read_modes, write_modes

    rng = np.random.default_rng(1)
    sets = [ModalSet(id=f"2019-06-03T0{k}:00Z", frequency_hz=np.array([0.3, 0.31, 1.2]),
                     shape=rng.standard_normal((4, 3)), damping_ratio=np.full(3, 0.01),
                     frequency_std_hz=np.full(3, 0.001), shape_std=np.full((4, 3), 0.02),
                     environment={"wind_speed_mps": 5.0, "state": "idling"},
                     covariance_factors=CovarianceFactors(ln_frequency=np.ones((3, 5)), damping_ratio=np.ones((3, 5)),
                                                          shape=np.ones((4, 3, 5), complex)))
            for k in range(3)]
    data = ModalData(channels=("a", "b", "c", "d"), sets=tuple(sets), labels=("FA1", "SS1", "T1"),
                     reference_set=sets[0].id)
    write_modes(data, folder / "modes.json")
    return [folder / "modes.json", folder / "modes.deviations.h5"], lambda: read_modes(folder / "modes.json")


def update(folder: Path) -> Made:
    from probupdate.updating.update_file import read_update

    path = update_record().write(folder / "update.json")
    return [path], lambda: read_update(path).summary


def baseline(folder: Path) -> Made:
    from updating_cases import LINEAR_HZ, linear_data, linear_model

    from probupdate.updating.baseline_file import read_baseline
    from probupdate.updating.problem import Weights
    from probupdate.updating.runs import deterministic_update

    record = deterministic_update(linear_model(), linear_data(LINEAR_HZ),
                                  weights=Weights(shapes="none", discrepancy=0.01))
    path = record.write(folder / "update.json")
    return [path], lambda: read_baseline(path).resolved_words()


def posterior(folder: Path) -> Made:
    from updating_records import gaussian_draws, posterior_of

    from probupdate.updating.posterior_file import read_posterior, write_posterior

    found = update_record()
    path = write_posterior(posterior_of(found, gaussian_draws(found, n=400)), folder / "posterior.nc")
    return [path], lambda: read_posterior(path).summary


def comparison(folder: Path) -> Made:
    from updating_records import gaussian_draws, posterior_of

    from probupdate.updating.comparison import compare, read_comparison

    found = update_record()
    path = compare(found, posterior_of(found, gaussian_draws(found, n=4000))).write(folder / "compare.json")
    return [path], lambda: read_comparison(path).summary


def information(folder: Path) -> Made:
    from updating_cases import LINEAR_HZ, LINEAR_PARAMETERS, SLOPE, linear_data, linear_model

    from probupdate.updating.information import information, read_information, write_information
    from probupdate.updating.problem import Weights, build_problem

    problem = build_problem(linear_model(LINEAR_PARAMETERS, SLOPE), linear_data(LINEAR_HZ, cov=0.01),
                            weights=Weights(shapes="none"))
    path = write_information(information(problem), folder / "information.json")
    return [path], lambda: read_information(path).summary


def views(folder: Path) -> Made:
    from probupdate.updating.predictive import LeaveOneOut
    from probupdate.updating.set_views_file import ModeScatter, SetsRow, SetViews, read_views

    row = {f: 1.0 for f in SetsRow.__dataclass_fields__} | {"name": "k", "unit": "-", "sentence": "it varies",
                                                           "tau_relative": True}
    mode = {f: 0.01 for f in ModeScatter.__dataclass_fields__} | {"label": "FA1", "n_set": 3}
    score = {name: np.zeros(3) for name in ("pooled", "population")}
    path = SetViews(
        ids=("a", "b", "c"), rows=(SetsRow(**row),), modes=(ModeScatter(**mode),), converged=True, verdict="converged",
        scores=LeaveOneOut(ids=("a", "b", "c"), score=score, pareto_k=np.zeros(3), refitted=np.zeros(3, bool)),
        linear_share=np.ones(3), correlation=None, notes=("a note",), advice="take (d)", settings={"seed": "1"},
    ).write(folder / "sets.json")
    return [path], lambda: read_views(path).verdict


def diagnosis(folder: Path) -> Made:
    from probupdate.diagnosis.results import read_diagnosis
    from probupdate.reporting.diagnosis_section import diagnosis_section

    report = module_of("reporting", "conftest")
    path = folder / "diagnosis.json"
    path.write_text(json.dumps(report.made_up_diagnosis(report.made_up_sensors())))
    assert callable(diagnosis_section)
    return [path], lambda: read_diagnosis(path)


def choice(folder: Path) -> Made:
    from probupdate.modal.mode_choice import read_choice

    pole = {"block": "2026-01-01T00:00Z", "order": 20, "index": 3, "frequency_hz": 1.66, "damping_ratio": 0.01}
    path = folder / "choice.json"
    path.write_text(json.dumps({
        "format": 1, "channels": ["a [acceleration, m/s2]"], "blocks": [{
            "id": "2026-01-01T00:00Z", "poles_hash": "0a" * 16, "records": ["b0.h5, 12000 samples"]}],
        "settings": {"order": 20, "block_rows": 20, "target_rate_hz": 20.0, "spread": 16, "sub_records": 30,
                     "harmonics": "keep"},
        "picked": [pole], "rejected": [pole | {"index": 4, "reason": "machine"}]}))
    return [path], lambda: read_choice(path)


def criteria(folder: Path) -> Made:
    from probupdate.identification.criteria import read_criteria

    path = folder / "criteria.toml"
    path.write_text('pitch_range_deg = 2.0\nyaw_rate_degps = 0.1\nstates = ["idling"]\nleast_angle_deg = 80.0\n')
    return [path], lambda: read_criteria(path)


def campaign_files(folder: Path) -> list[Path]:
    text = 'name = "June"\nsampling_rate_hz = 5.0\nblock_minutes = 10\nwater_depth_m = 30.0\nleave_out = []\n'
    for k, axis in enumerate("xyz"):
        text += (f'[[sensor]]\nchannel = "T-{axis}"\nlevel = "T"\nposition_m = [0.0, 0.0, 80.0]\n'
                 f'direction = {np.eye(3)[k].tolist()}\nquantity = "acceleration"\nunit = "m/s2"\n')
    (folder / "campaign.toml").write_text(text)
    (folder / "acceleration").mkdir(exist_ok=True)
    rng = np.random.default_rng(3)
    for name, chunks in (("a", None), ("b", (500, 3))):
        with h5py.File(folder / "acceleration" / f"{name}.h5", "w") as file:
            data = file.create_dataset("data", data=rng.standard_normal((3000, 3)).astype(np.float32), chunks=chunks,
                                       compression=chunks and "gzip")
            data.attrs["start"], data.attrs["sampling_rate_hz"] = f"2020-01-01T0{'ab'.index(name)}:00:00Z", 5.0
    (folder / "scada.csv").write_text("time,wind_speed_mps,power_kw,nacelle_heading_deg\n" + "".join(
        f"2020-01-01T00:{10 * k:02d}:00Z,{5 + k},{100 * k},{10.5 * k}\n" for k in range(6)))
    return [folder / "campaign.toml", folder / "acceleration" / "a.h5", folder / "acceleration" / "b.h5",
            folder / "scada.csv"]


def same_blocks(folder: Path, convert: Callable[[Path], None]) -> None:
    """Asserts that `campaign_files` have the same blocks once their records are of another form; those without a
    channel, too, and those that begin within the form's own pieces."""
    from probupdate.campaign.blocks import blocks
    from probupdate.campaign.reading import read_campaign

    before = list(blocks(read_campaign(folder)))
    convert(folder)
    after = list(blocks(read_campaign(folder)))
    assert len(before) == len(after) == 2
    for one, two in zip(before, after, strict=True):
        assert one.start == two.start and np.array_equal(one.data, two.data) and one.notes == two.notes
    path = folder / "campaign.toml"
    path.write_text(path.read_text().replace("leave_out = []", 'leave_out = ["T-y"]'))
    for one, two in zip(before, blocks(read_campaign(folder)), strict=True):
        assert np.array_equal(one.data[:, [0, 2]], two.data)


def campaign(folder: Path) -> Made:
    from probupdate.campaign.blocks import blocks
    from probupdate.campaign.reading import read_campaign

    paths = campaign_files(folder)
    return paths, lambda: [b.data.sum() for _, b in zip(range(20), blocks(read_campaign(folder)), strict=False)]


def parquet_campaign(folder: Path) -> Made:
    import pytest

    pytest.importorskip("pyarrow", reason="pyarrow is not installed (pip install probupdate[parquet])")
    _, read = campaign(folder)
    module_of("campaign", "test_campaign_parquet").as_parquet(folder)
    return sorted((folder / "acceleration").glob("*.parquet")), read


def zarr_campaign(folder: Path) -> Made:
    import pytest

    pytest.importorskip("zarr", reason="zarr is not installed (pip install probupdate[zarr])")
    _, read = campaign(folder)
    module_of("campaign", "test_campaign_zarr").as_zarr(folder)
    return sorted((folder / "acceleration").glob("*.zarr/zarr.json")), read


def head(folder: Path) -> Made:
    from probupdate.campaign.reading import read_head

    path = campaign_files(folder)[0]
    return [path], lambda: read_head(path)


def scada(folder: Path) -> Made:
    from probupdate.campaign.scada import StateRule, block_conditions, read_scada

    path = campaign_files(folder)[3]
    start = pd.Timestamp("2020-01-01T00:00Z")
    return [path], lambda: block_conditions(read_scada(path), start, 60.0, StateRule(rated_power_kw=500.0))


def convert_description(folder: Path) -> Made:
    from probupdate.campaign.description import read_descriptions

    path = folder / "convert.toml"
    path.write_text('files = "*.csv"\ntime = "t"\ntime_unit = "s"\nstart_pattern = "_(\\\\d{8})"\n'
                    'start_format = "%Y%m%d"\n'
                    'zone = "UTC"\nlost = [-999.0]\nfill_seconds = 5\n[columns]\na = "A"\n[factor]\na = 2.0\n'
                    .replace('start_pattern = "_(\\\\d{8})"\n', "start_pattern = '_(\\d{8})'\n"))
    return [path], lambda: read_descriptions(path, ("a", "b"))


def source(suffix: str):
    def make(folder: Path) -> Made:
        from probupdate.campaign.description import read_descriptions
        from probupdate.campaign.sources import open_source

        table = np.random.default_rng(2).standard_normal((500, 3))
        table[:, 0] = np.arange(500) / 5
        path = folder / f"raw{suffix}"
        described = 'files = "*"\ntime = "t"\ntime_unit = "s"\nstart = "2020-01-01T00:00Z"\n'
        if suffix == ".csv":
            path.write_text("t,a,b\n" + "".join(",".join(f"{x:.5g}" for x in row) + "\n" for row in table))
        elif suffix == ".npz":
            np.savez(path, t=table[:, 0], a=table[:, 1], b=table[:, 2])
        elif suffix == ".npy":
            np.save(path, table[:, 1:])
            described = described.replace('time = "t"\ntime_unit = "s"\n', "")
        elif suffix == ".parquet":
            import pandas as pd

            pd.DataFrame(table, columns=list("tab")).to_parquet(path)
        elif suffix == ".uff":
            from probupdate.campaign.uff_file import write_uff_records
            from probupdate.modal.modes import Sensor

            two = [Sensor(channel=c, level="l", position_m=np.zeros(3) + k, direction=np.eye(3)[k])
                   for k, c in enumerate("ab")]
            write_uff_records(table[:, 1:], 5.0, two, path, start="2020-01-01T00:00Z")
            described = described.replace('time = "t"', 'time = "abscissa"')
        elif suffix == ".sac":
            head = np.full(158, -12345, "<i4")
            head[[0, 5]] = np.array([0.2, 0.0], "<f4").view("<i4")
            head[[70, 71, 72, 73, 74, 75, 76, 79, 85, 105]] = 2020, 1, 0, 0, 0, 0, 6, 500, 1, 1
            path.write_bytes(head.tobytes() + table[:, 1].astype("<f4").tobytes())
            described = 'files = "*"\ntime = "file"\n[columns]\na = 1\n'
        elif suffix == ".wav":
            from scipy.io import wavfile

            wavfile.write(path, 5, table[:, 1:].astype("<f4"))
            described = described.replace('time = "t"\ntime_unit = "s"\n', "") + "[columns]\na = 1\nb = 2\n"
        elif suffix == "struct.mat":
            from scipy.io import savemat

            savemat(path, {"rec": {"t": table[:, :1], "y": table[:, 1:], "fs": 5.0, "units": "g"}})
            described = described.replace('time = "t"', 'time = "rec.t"') + 'data = "rec.y"\n'
        elif suffix == "5.mat":
            from scipy.io import savemat

            savemat(path, {"t": table[:, :1], "a": table[:, 1:2], "b": table[:, 2:]})
        else:
            with h5py.File(path, "w") as file:
                for k, name in enumerate("tab"):
                    file[name] = table[:, k][None]
        (folder / "convert.toml").write_text(described)
        description = read_descriptions(folder / "convert.toml", ("a",) if suffix == ".sac" else ("a", "b"))[0]
        return [path], lambda: sum(len(data) for _, data in open_source(path, description, rate_hz=5.0)[1])

    return make


def turbine(folder: Path) -> Path:
    path = folder / "model.toml"
    path.write_bytes((PACKAGE / "reference" / "updated.toml").read_bytes())
    return path


def model_description(folder: Path) -> Made:
    from probupdate.structure.description_file import read_description

    path = turbine(folder)
    return [path], lambda: read_description(path)


def turbine_model(folder: Path) -> Made:
    from probupdate.structure.load import load_model

    path = turbine(folder)
    return [path], lambda: load_model(path)


def parameters(folder: Path) -> Made:
    from probupdate.structure.parameter_table import read_parameters

    path = folder / "parameters.toml"
    path.write_text("".join("[[parameter]]\n" + TOML.format(n) for n in "km") + "[correlation.k]\nm = 0.5\n")
    return [path], lambda: read_parameters(path)


def matrices(folder: Path) -> Made:
    from scipy import sparse

    from probupdate.structure.load import load_model

    K = 1e4 * sparse.csr_array(np.diag(np.full(6, 2.0)) - np.diag(np.ones(5), 1) - np.diag(np.ones(5), -1))
    np.savez(folder / "model.npz", K0=np.zeros((6, 6)), M0=np.eye(6), K_k_data=K.data, K_k_indices=K.indices,
             K_k_indptr=K.indptr, M_m=np.eye(6), channel=np.array(list("abc")), channel_dof=np.arange(3),
             channel_sign=np.ones(3), node_position_m=np.eye(6, 3), dof_node=np.arange(6),
             dof_direction=np.zeros(6, int), line=np.array([[0, 1]]))
    (folder / "model.toml").write_text("".join("[[parameter]]\n" + TOML.format(n) for n in "km"))
    return [folder / "model.npz", folder / "model.toml"], lambda: load_model(folder / "model.npz")


def virtual_turbine(folder: Path) -> Made:
    from probupdate.virtual.turbine_file import read_turbine

    path = turbine(folder)
    return [path], lambda: read_turbine(path)


def truth(folder: Path) -> Made:
    from probupdate.virtual.truth import read_truth
    from probupdate.virtual.turbine_file import read_turbine

    path = folder / "truth.toml"
    name = next(iter(read_turbine(turbine(folder)).parameters))
    path.write_text(f'parameters_from = "prior"\n[parameters]\n{name} = 1.5\n[tolerances]\nscale = 0.5\n[[effect]]\n'
                    'kind = "scour"\nleg = "A"\ndepth_m = 2.0\n'
                    '[[effect]]\nkind = "sensor_gain"\nchannel = "T90-x"\nfactor = 1.2\n')
    file = read_turbine(turbine(folder))
    return [path], lambda: read_truth(path, file)


def truth_modes(folder: Path) -> Made:
    from probupdate.virtual.campaign_files import toml_text
    from probupdate.virtual.truth import read_truth_modes

    path = folder / "truth.toml"
    path.write_text(toml_text({"mode_set": [{
        "heading_deg": 10.0, "labels": ["FA1", "SS1"], "frequency_hz": [0.3, 0.31],
        "damping_ratio_idling": [0.01, 0.01], "damping_ratio_operating": [0.02, 0.02],
        "shape": [[1.0, 0.5, 0.1], [0.1, 1.0, 0.2]]}]}))
    return [path], lambda: read_truth_modes(path)


def block_poles(folder: Path) -> Made:
    from probupdate.identification.block_poles import BlockPoles
    from probupdate.identification.block_store import read_block_poles, write_block_poles
    from probupdate.identification.ssi import Poles

    poles = Poles(order=8, frequency_hz=np.array([0.3, 0.31, 1.3]), damping_ratio=np.full(3, 0.01), shape=SHAPE)
    path = folder / "b.npz"
    write_block_poles(path, BlockPoles(
        id="b", start=pd.Timestamp("2020-01-01T00:00Z"), minutes=30.0, quantity="acceleration", excluded="", notes=(),
        rms=0.01, poles=poles, others=(poles,), line_hz=np.linspace(0, 5, 40), spectrum=np.ones(40),
        unmeasured=np.zeros((3, 6))), [])
    return [path], lambda: read_block_poles(path)


def block_factors(folder: Path) -> Made:
    from probupdate.identification.block_poles import BlockFactors
    from probupdate.identification.block_store import read_block_factors, write_block_factors
    from probupdate.identification.order_average import ModePoles
    from probupdate.modal.modes import CovarianceFactors

    path = folder / "b.npz"
    factors = CovarianceFactors(ln_frequency=np.ones((2, 20)), damping_ratio=np.ones((2, 20)),
                                shape=np.ones((6, 2, 20), complex))
    write_block_factors(path, BlockFactors(
        key=((8, 0), (8, 1)), kurtosis=np.full(2, 2.0), poles=ModePoles(
            frequency_hz=np.ones(2), damping_ratio=np.full(2, 0.01), shape=np.ones((6, 2), complex), factors=factors)))
    return [path], lambda: read_block_factors(path)


def chain(folder: Path) -> Made:
    import emcee

    from probupdate.updating.chain_store import ChainStore, Segment

    def store():
        return ChainStore(folder / "chain", {"model": "abc"}, {"ensembles": 1, "seed": 1})

    state = emcee.State(np.zeros((6, 2)), log_prob=np.zeros(6), random_state=np.random.RandomState(1).get_state())
    store().append(Segment(theta=np.zeros((5, 6, 2)), log_posterior=np.zeros((5, 6)), state=state, accepted=0.3,
                           evaluated=30, fallback=0), 0, 0)
    return [folder / "chain" / "chain.json", folder / "chain" / "segment-00000.npz"], lambda: store().read()


def run(folder: Path) -> Made:
    """The small files of a run's directory; the large ones have cases of their own."""
    from probupdate.reporting.run_files import read_run

    campaign_files_of = folder / "campaign"
    campaign_files_of.mkdir()
    campaign_files(campaign_files_of)
    (folder / "run.json").write_text(json.dumps({"title": "June", "seed": 7, "version": "0.1.0",
                                                 "campaign": "campaign"}))
    (folder / "check.json").write_text(json.dumps({
        "campaign": "June", "findings": ["T-x is flat"], "channels": [{"channel": f"T-{a}"} for a in "xyz"],
        "blocks": [{"id": "2020-01-01T00:00:00Z"}]}))
    (folder / "modes.poles.csv").write_text("time,frequency_hz,mac,mode,criterion\n" + "".join(
        f"2020-01-01T00:{k}0:00Z,0.3{k},0.9,FA1,kept\n" for k in range(6)))
    (folder / "selection.csv").write_text("id,criterion\na,\nb,yawing\n")
    return ([folder / n for n in ("run.json", "check.json", "modes.poles.csv", "selection.csv")],
            lambda: read_run(folder, lambda *a: None))


def started_run(folder: Path) -> Made:
    from probupdate.demonstration import RunState

    settings = {"seed": 1, "days": 1.0, "version": "0"}
    (folder / "out").mkdir(exist_ok=True)
    RunState(folder / "out", settings).finish("simulate")
    return [folder / "out" / "run.json"], lambda: RunState(folder / "out", settings)


def groups(folder: Path) -> Made:
    from probupdate.diagnosis.run import read_groups

    path = folder / "groups.toml"
    path.write_text("[legs]\nk_t = 1.0\nk_p = -0.5\n[other]\npy = 1.0\n")
    return [path], lambda: read_groups(path)


def fatigue(folder: Path) -> Made:
    from probupdate.lifetime.conditions import read_conditions

    path = folder / "fatigue.toml"
    path.write_text((HERE.parents[1] / "studies" / "lifetime" / "fatigue.toml").read_text(encoding="utf-8"))
    return [path], lambda: read_conditions(path)


def lifetime_table(folder: Path) -> Made:
    from probupdate.lifetime.tables import read_table

    path = folder / "draws.csv"
    path.write_text("# of a posterior\ndraw,k_t,name\n1,0.5,a\n2,,b\n3,1e-3,c\n")
    return [path], lambda: read_table(path)


def gauges(folder: Path) -> Made:
    from probupdate.lifetime.gauges import read_gauges

    path = folder / "gauges.csv"
    path.write_text("time,hot_spot_3_mpa\n2024-03-01T00:00:00Z,1.5\n2024-03-01T00:00:00.25Z,\n"
                    "2024-03-01T00:00:00.5Z,-2e1\n")
    return [path], lambda: read_gauges(path, 8)


def joint(folder: Path) -> Made:
    from probupdate.lifetime.draws import joint_of, read_joint

    drawn = joint_of(("a", "b"), np.random.default_rng(1).standard_normal((400, 2)) @ [[1.0, 0.5], [0.0, 1.0]])
    path = folder / "joint.json"
    path.write_text(json.dumps({
        "kind": "nataf", "parameters": list(drawn.names), "mean": drawn.mean.tolist(), "std": drawn.std.tolist(),
        "level": drawn.level.tolist(), "quantile": drawn.quantile.T.tolist(),
        "normal_correlation": drawn.correlation.tolist(), "rank_correlation": drawn.rank_correlation.tolist()}))
    return [path], lambda: read_joint(path).sample(10, np.random.default_rng(2))


def farm_joint(folder: Path) -> Made:
    from probupdate.updating.joint_file import (
        FarmJoint,
        MonthValue,
        NextRow,
        PopulationRow,
        TurbineRow,
        read_joint,
        write_joint,
    )

    shared = dict(parameter="k", unit="-", role="varying", tikhonov=1.0, tikhonov_std=0.1, mean=1.0, std=0.1, low=0.8,
                  high=1.2)
    scatter = dict(prior_mean=1.0, prior_std=0.2, tau=0.1, tau_low=0.0, tau_high=0.2, tau_prior=0.1, tau_relative=True,
                   inherited_mean=1.0, inherited_std=0.2, inherited_low=0.7, inherited_high=1.3)
    path = folder / "farm_joint.json"
    write_joint(FarmJoint(
        turbines=("A", "B"), odd_probability=(0.1, 0.2), population=(PopulationRow(**shared, **scatter),),
        rows=(TurbineRow(**shared, turbine="A", alone_std=0.2, odd=0.1, limit=0.3, at_bound=False),),
        months=(MonthValue(turbine="A", month="1", parameter="k", unit="-", value=1.0, std=0.1, changed=False),),
        next=(NextRow(turbine="A", measurement="x", farm_bits=0.1, turbine_bits=0.2),), settled=True, converged=True,
        corrected=True, pareto_k=0.1, effective=100.0, draws=200, verdict="converged", notes=("a",),
        settings={"common": "k"}), path)
    return [path], lambda: read_joint(path)


def extptfm(folder: Path) -> Made:
    from probupdate.lifetime.superelement import read_extptfm

    path = folder / "reduced.dat"
    rows = "".join(" ".join(str(float(a == b)) for b in range(6)) + "\n" for a in range(6))
    path.write_text("!a reduced file\n"
                    + "".join(f"!{t}\n!dimension: 6\n{rows}" for t in ("Mass", "Damping", "Stiffness")))
    return [path], lambda: read_extptfm(path)


def farm(folder: Path) -> Made:
    from probupdate.farms.description import read_farm

    campaign_files(_made(folder / "A" / "2024-05"))
    path = folder / "farm.toml"
    path.write_text('name = "North"\nmodel = "as_built"\nsteps = ["identify", "select", "update", "diagnose"]\n'
                    'seed = 2\n'
                    '[identify]\nlowest = 3\nrate_hz = 5.0\n[select]\ncount = 4\npreset = "structure"\n[update]\n'
                    'weights = "paper"\n[diagnose]\nrecords = false\n[[turbine]]\nname = "A"\ncampaigns = "A/*"\n')
    return [path], lambda: read_farm(path)


def farm_records(folder: Path) -> Made:
    from probupdate.farms.records import keep, read_kept

    keep(folder, {"a.h5": {"stamp": "12 bytes, 1, 2, ab", "content": "cd"}})
    return list(folder.iterdir()), lambda: read_kept(folder)


def farm_month(folder: Path) -> Made:
    from probupdate.farms.month import MonthState, read_state, write_state

    write_state(folder, MonthState(format=1, made_of={"model": "abc"}, finished={"identify": 1.5}, failed_step="select",
                              failed="modes: none"))
    return [folder / "month.json"], lambda: read_state(folder)


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


# case -> (maker, the functions of the package that it covers)
CASES: dict[str, tuple[Callable[[Path], Made], tuple[str, ...]]] = {
    "modes": (modes, ("modal.modes_file.read_modes", "io.files.read_json", "io.files.read_text",
                      "io.files.read_bytes")),
    "update": (update, ("updating.update_file.read_update", "io.files.read_json_table")),
    "baseline": (baseline, ("updating.baseline_file.read_baseline",)),
    "posterior": (posterior, ("updating.posterior_file.read_posterior",)),
    "comparison": (comparison, ("updating.comparison.read_comparison",)),
    "information": (information, ("updating.information.read_information",)),
    "views": (views, ("updating.set_views_file.read_views",)),
    "diagnosis": (diagnosis, ("diagnosis.results.read_diagnosis",)),
    "criteria": (criteria, ("identification.criteria.read_criteria", "io.files.read_toml")),
    "campaign": (campaign, ("campaign.reading.read_campaign", "campaign.blocks.read_block")),
    "parquet": (parquet_campaign, ("campaign.reading.read_campaign", "campaign.blocks.read_block")),
    "zarr": (zarr_campaign, ("campaign.reading.read_campaign", "campaign.blocks.read_block")),
    "head": (head, ("campaign.reading.read_head",)),
    "scada": (scada, ("campaign.scada.read_scada",)),
    "convert": (convert_description, ("campaign.description.read_descriptions",)),
    "csv": (source(".csv"), ("campaign.table_sources.read_csv", "campaign.sources.opened")),
    "npz": (source(".npz"), ("campaign.array_sources.read_npz",)),
    "npy": (source(".npy"), ("campaign.array_sources.read_npy",)),
    "parquet_table": (source(".parquet"), ("campaign.table_sources.read_parquet",)),
    "mat_struct": (source("struct.mat"), ("campaign.array_sources.read_mat",)),
    "uff_source": (source(".uff"), ("campaign.sources.read_uff",)),
    "sac": (source(".sac"), ("campaign.sources.opened",)),
    "wav": (source(".wav"), ("campaign.sources.opened",)),
    "mat5": (source("5.mat"), ("campaign.array_sources.read_mat",)),
    "mat73": (source("73.mat"), ("campaign.array_sources.read_mat",)),
    "model": (model_description, ("structure.description_file.read_description",)),
    "turbine_model": (turbine_model, ("structure.load.load_model",)),
    "parameters": (parameters, ("structure.parameter_table.read_parameters",)),
    "matrices": (matrices, ("structure.matrices.load_matrices", "structure.matrices.read_archive")),
    "calculix": (calculix, ("io.program_matrices.read_program_matrices",)),
    "punch": (punch, ("io.program_matrices.read_program_matrices",)),
    "subdyn": (subdyn, ("io.subdyn_file.read_subdyn", "io.ssi_file.read_ssi", "io.fortran_text.read_lines",
                        "structure.subdyn_model.read_description")),
    "elastodyn": (elastodyn, ("io.elastodyn_file.read_elastodyn",)),
    "uff_modes": (uff("modes"), ("campaign.uff_file.read_uff_modes",)),
    "uff_records": (uff("records"), ("campaign.uff_file.read_uff_records",)),
    "poles_csv": (pole_tables(".csv"), ("campaign.pole_tables.read_pole_tables",)),
    "poles_npz": (pole_tables(".npz"), ("campaign.pole_tables.read_pole_tables",)),
    "poles_mat": (pole_tables(".mat"), ("campaign.pole_tables.read_pole_tables",)),
    "virtual": (virtual_turbine, ("virtual.turbine_file.read_turbine", "virtual.turbine_file.read_toml")),
    "choice": (choice, ("modal.mode_choice.read_choice",)),
    "truth": (truth, ("virtual.truth.read_truth", "virtual.effects.read_effect")),
    "truth_modes": (truth_modes, ("virtual.truth.read_truth_modes",)),
    "block_poles": (block_poles, ("identification.block_store.read_block_poles",)),
    "block_deviations": (block_factors, ("identification.block_store.read_block_factors",)),
    "chain": (chain, ("updating.chain_store.ChainStore",)),
    "run": (run, ("reporting.run_files.read_run", "reporting.run_files.read_table")),
    "started_run": (started_run, ("demonstration.RunState",)),
    "fatigue": (fatigue, ("lifetime.conditions.read_conditions",)),
    "lifetime_table": (lifetime_table, ("lifetime.tables.read_table", "io.files.read_own_text")),
    "gauges": (gauges, ("lifetime.gauges.read_gauges",)),
    "joint": (joint, ("lifetime.draws.read_joint",)),
    "farm_joint": (farm_joint, ("updating.joint_file.read_joint",)),
    "extptfm": (extptfm, ("lifetime.superelement.read_extptfm",)),
    "farm": (farm, ("farms.description.read_farm",)),
    "farm_month": (farm_month, ("farms.month.read_state",)),
    "farm_records": (farm_records, ("farms.records.read_kept",)),
    "groups": (groups, ("diagnosis.run.read_groups",)),
}


def readers_in_the_code() -> set[str]:
    """Public functions named read_* or load_* anywhere in the package, by module and name."""
    found = set()
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith(("read_", "load_")):
                found.add(f"{module}.{node.name}")
    return found


