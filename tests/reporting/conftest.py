"""A made-up run with every part, as values: the sections are tested without computing anything."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from probupdate.modal.modes import ModalData, ModalSet, Sensor
from probupdate.model.interface import Wireframe
from probupdate.model.parameters import Parameter, Parameters
from probupdate.reporting import figures
from probupdate.reporting.values import (
    CampaignValues,
    ModelValues,
    Run,
)
from probupdate.reporting.viewer import ShapedModes
from probupdate.updating.comparison import Comparison, ComparisonRow
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.update_file import SchemeRecord, UpdateRecord

LABELS = ("FA1", "SS1", "T1", "FA2", "SS2")
TRUE_HZ = np.array([0.320, 0.322, 1.29, 1.94, 2.00])
NAMES = ("k_j", "k_t", "k_TP", "k_p", "a_m", "m_h", "py", "tz", "qw", "LJF")
COV = (0.05, 0.25, 0.25, 0.10, 0.5, 0.02, 1.0, 1.0, 1.0, 0.5)
N_BLOCK = 48


def made_up_sensors() -> tuple[Sensor, ...]:
    sensors = []
    for leg, x, y in (("A", 4, 4), ("B", -4, 4), ("C", -4, -4), ("D", 4, -4)):
        for axis, direction in zip("xyz", np.eye(3), strict=True):
            sensors.append(Sensor(channel=f"TP-{leg}-{axis}", level="TP", position_m=(x, y, 13.0), direction=direction))
    for level, z in (("tower bottom", 18.0), ("tower two thirds", 66.0), ("tower top", 90.0)):
        for axis, direction in zip("xy", np.eye(3)[:2], strict=True):
            sensors.append(Sensor(channel=f"{level}-{axis}", level=level, position_m=(0, 0, z), direction=direction))
    return tuple(sensors)


def displacement(place: np.ndarray) -> np.ndarray:
    """(n, 3) -> (n, 3, 5): bending pairs and torsion of a column fixed at z = -38."""
    z = (place[:, 2] + 38) / 128
    first, second = z**2, z**2 * (3 - 3.6 * z)
    shape = np.zeros((len(place), 3, 5))
    shape[:, 0, 0], shape[:, 1, 1], shape[:, 0, 3], shape[:, 1, 4] = first, first, second, second
    shape[:, 0, 2], shape[:, 1, 2] = -place[:, 1] * z / 10, place[:, 0] * z / 10
    return shape


def made_up_wire() -> Wireframe:
    levels = np.array([-68.0, -38, -20, -4, 13])
    half = np.array([9.0, 9.0, 7.0, 5.5, 4.0])
    nodes, lines, groups = [], [], []
    for z, h in zip(levels, half, strict=True):
        nodes += [(h, h, z), (-h, h, z), (-h, -h, z), (h, -h, z)]
    for k in range(len(levels) - 1):
        for leg in range(4):
            lines.append((4 * k + leg, 4 * k + 4 + leg))
            groups.append("pile" if k == 0 else "leg")
            if k:
                lines += [(4 * k + leg, 4 * k + 4 + (leg + 1) % 4), (4 * k + (leg + 1) % 4, 4 * k + 4 + leg)]
                groups += ["brace", "brace"]
    start = len(nodes)
    nodes += [(0.0, 0.0, z) for z in (16.0, 30, 45, 60, 75, 90)]
    for leg in range(4):
        lines.append((16 + leg, start))
        groups.append("strut")
    lines += [(start + k, start + k + 1) for k in range(5)]
    groups += ["tower"] * 5
    return Wireframe(node_m=np.array(nodes), line=np.array(lines), line_group=tuple(groups))


def made_up_modes(rng: np.random.Generator, sensors) -> ModalData:
    place, way = np.array([s.position_m for s in sensors]), np.array([s.direction for s in sensors])
    exact = np.einsum("cd,cdm->cm", way, displacement(place))
    sets = []
    start = pd.Timestamp("2019-06-03T00:00Z")
    for k in range(N_BLOCK):
        frequency = TRUE_HZ * (1 + 0.008 * rng.standard_normal(5))
        if k % 5 == 0:
            frequency[2] = np.nan
        shape = exact * (1 + 0.02 * rng.standard_normal(exact.shape)) + 0.01j * rng.standard_normal(exact.shape)
        sets.append(
            ModalSet(
                id=(start + pd.Timedelta(minutes=30 * k)).strftime("%Y-%m-%dT%H:%MZ"),
                frequency_hz=frequency, shape=shape,
                damping_ratio=np.abs(0.011 + 0.003 * rng.standard_normal(5)), frequency_std_hz=0.008 * TRUE_HZ,
                shape_std=np.full(exact.shape, 0.05),
                environment={"state": ("idling", "below rated", "rated")[(k // 16) % 3], "wind_speed_mps": 3.0 + k / 4},
            )
        )
    return ModalData(channels=tuple(s.channel for s in sensors), sets=tuple(sets), labels=LABELS,
                     reference_set=sets[3].id)


def made_up_poles(rng: np.random.Generator, modes: ModalData) -> pd.DataFrame:
    rows = []
    for s in modes.sets:
        time = pd.Timestamp(s.id).tz_convert(None)
        for label, f in zip(LABELS, s.frequency_hz, strict=True):
            if np.isfinite(f):
                rows.append((time, f, 0.011, 0.99, 0.97, label, "kept", "kept"))
        for f in rng.uniform(0.1, 2.5, 6):
            rows.append((time, f, 0.04, 0.6, 0.3, "", "mac", "mac"))
        if s.environment["state"] != "idling":
            rows.append((time, 0.6 + 0.05 * rng.standard_normal(), 0.001, 0.999, 0.95, "FA1", "harmonic", "kept"))
    names = ["time", "frequency_hz", "damping_ratio", "mpc", "mac", "mode", "criterion", "paper_criterion"]
    return pd.DataFrame(rows, columns=names)


def made_up_scada(rng: np.random.Generator) -> pd.DataFrame:
    n = 144
    wind = 8 + 5 * np.sin(np.arange(n) / 25) + rng.standard_normal(n)
    state = np.where(wind < 4, "idling", np.where(wind > 12, "rated", "below rated"))
    return pd.DataFrame({
        "time": pd.date_range("2019-06-03", periods=n, freq="10min"), "wind_speed_mps": np.maximum(wind, 0.2),
        "rotor_speed_rpm": np.where(state == "idling", 0.4, np.clip(wind, 6, 14.8)), "state": state,
    })


def made_up_run(*, names: tuple[str, ...] = NAMES, title: str = "Made-up turbine") -> Run:
    rng = np.random.default_rng(5)
    sensors, wire = made_up_sensors(), made_up_wire()
    modes = made_up_modes(rng, sensors)
    idling = [s for s in modes.sets if s.environment["state"] == "idling"][:9]
    nine = ModalData(channels=modes.channels, sets=tuple(idling), labels=LABELS, reference_set=idling[3].id)
    items = tuple(
        Parameter(name=n, unit="kg" if n == "m_h" else "-", initial=1.44e5 if n == "m_h" else 1.0,
                  std=c * (1.44e5 if n == "m_h" else 1.0), lower=1.2e5 if n == "m_h" else 0.02,
                  upper=1.7e5 if n == "m_h" else 4.0)
        for n, c in zip(names, COV, strict=True)
    )
    parameters = Parameters(items)
    end = np.array([0.995, 1.83, 0.35, 1.02, 0.85, 1.47e5, 0.14, 0.08, 0.66, 1.02])
    schemes = []
    for key, factor in (("step", 1.0), ("prior", 0.9)):
        steps = np.arange(8)
        share = (1 - np.exp(-steps))[:, None] * factor
        theta = parameters.initial + share * (end - parameters.initial)
        responses = 220 * np.exp(-1.4 * steps) + 1.2
        prior = np.sum(((theta - parameters.initial) / parameters.std) ** 2, axis=1)
        schemes.append(SchemeRecord(
            key=key, name=key, theta=theta, objective={"responses": responses, "parameters": prior,
                                                       "total": responses + prior},
            frequency_hz=TRUE_HZ * (1 + 0.01 * factor * np.array([0.3, 0.5, np.nan, -0.9, 0.4])),
            mac=np.array([0.97, 0.98, np.nan, 0.99, 0.99]),
            at_bound=np.array([False] * 7 + [key == "step"] + [False] * 2),
            converged=key == "prior", status="steps became small" if key == "prior" else "ended after 7 iterations",
            alpha=1.0, distance_to_map=4 * np.exp(-steps) + 0.01, share=np.ones(7)))
    prior_std = np.array([p.distribution.std() for p in items])
    shrink = np.array([0.98, 0.5, 0.3, 0.99, 0.6, 0.97, 0.12, 0.1, 0.97, 0.95])
    mix = np.eye(10)
    mix[1, 2] = mix[2, 1] = -0.7
    mix[6, 7] = mix[7, 6] = -0.55
    z = rng.standard_normal((4000, 10)) @ np.linalg.cholesky(mix).T
    draws = np.clip(end + 0.5 * z * shrink * prior_std, parameters.lower + 1e-6, parameters.upper - 1e-6)
    hz = schemes[1].frequency_hz
    update = UpdateRecord(
        model="reference", fingerprint="3f2a", parameters=parameters, set_id=nine.set().id, labels=LABELS,
        measured_hz=nine.set().frequency_hz, measured_std_hz=0.016 * TRUE_HZ,
        initial_hz=np.array([0.308, 0.311, 1.20, 1.57, 1.65]), initial_mac=np.array([0.96, 0.98, 0.9, 0.97, 0.98]),
        initial_misfit=220.0, computed_mode=np.array([1.0, 2, 3, 4, 5]), schemes=tuple(schemes),
        pairs=((0, 1), (3, 4)), left_out=("T1 was not identified in this set",), map_theta=end * 1.01,
        map_covariance=np.diag((0.1 * parameters.std) ** 2), map_resolution=np.full(10, 0.6),
        map_at_bound=np.zeros(10, bool), map_misfit=70.0, map_hz=hz, map_mac=schemes[1].mac, n_response=72,
        n_effective=68, other_maxima=(), sets=None, settings={"weights": "measured"},
        derived={"k_xy": {"initial": 4.0e8, "step": 1.4e9, "prior": 1.3e9, "map": 1.3e9},
                 "k_z": {"initial": 1.15e9, "step": 6.0e9, "prior": 5.8e9, "map": 5.8e9}},
    )
    theta = draws.reshape(8, 500, 10)
    log_posterior = rng.standard_normal((8, 500))
    posterior = Posterior(
        names=parameters.names, theta=theta, log_likelihood=log_posterior, log_posterior=log_posterior,
        prior=parameters.draw(rng, 400), response_labels=tuple(f"f {label}" for label in LABELS),
        measured=TRUE_HZ, std=0.016 * TRUE_HZ, predicted=TRUE_HZ * (1 + 0.006 * rng.standard_normal((300, 5))),
        frequency_hz=TRUE_HZ * (1 + 0.006 * rng.standard_normal((300, 5))), mode_labels=LABELS,
        r_hat=np.full(10, 1.003), ess=np.full(10, 1250.0), converged=True, fingerprint="3f2a",
        verdict="Converged: R-hat below 1.01, 62 autocorrelation times.",
        record={"evaluated": 120000, "fallback": 12, "seed": 1, "notes": []},
    )
    mean, std = draws.mean(0), draws.std(0, ddof=1)
    rows = tuple(
        ComparisonRow(
            name=p.name, unit=p.unit, initial=p.initial, cov=std[k] / mean[k], skewness=0.1, total_cov=0.05, flags=(),
            prior_mean=p.initial, prior_std=p.std, step=schemes[0].theta[-1, k],
            anchored=schemes[1].theta[-1, k], map=end[k], mean=mean[k], std=std[k],
            median=float(np.median(draws[:, k])),
            low=float(np.percentile(draws[:, k], 5)), high=float(np.percentile(draws[:, k], 95)),
            step_distance=(schemes[0].theta[-1, k] - mean[k]) / std[k],
            anchored_distance=(schemes[1].theta[-1, k] - mean[k]) / std[k], map_distance=(end[k] - mean[k]) / std[k],
            contraction=std[k] / prior_std[k], nine_mean=end[k], nine_cov=0.04, resolution=0.5, identified="weakly",
            sentence=f"{p.name} is about the same by every route.")
        for k, p in enumerate(items)
    )
    place = np.array([s.position_m for s in sensors])
    way = np.array([s.direction for s in sensors])
    at_sensors = np.einsum("cd,cdm->cm", way, displacement(place))
    node_motion = displacement(wire.node_m)
    turned = node_motion.copy()
    turned[:, :, 0] = node_motion[:, :, 0] + 0.6 * node_motion[:, :, 1]
    states = {
        "initial": ShapedModes(frequency_hz=update.initial_hz, shape=at_sensors * 0.3, displacement=node_motion * 0.3),
        "updated": ShapedModes(frequency_hz=schemes[1].frequency_hz, shape=at_sensors, displacement=node_motion * 1.05),
    }
    return Run(
        folder=Path("run"), title=title, missing=("the truth of a virtual campaign (truth.toml)",),
        provenance=(("probupdate", "0.1.0"), ("seed", "1"), ("fingerprint of the problem", "3f2a")),
        campaign=CampaignValues(
            name="June", sensors=sensors, sampling_rate_hz=25.0, block_minutes=30, water_depth_m=38.0,
            facts=(("name", "June"),
                   ("recorded", "2019-06-03 00:00 to 2019-06-04 00:00 UTC"), ("sampling rate", "25 Hz"),
                   ("water depth", "38 m")), findings=("one hour is missing",), scada=made_up_scada(rng)),
        modes=modes, poles=made_up_poles(rng, modes), nine=nine,
        selection=pd.DataFrame({"id": [s.id for s in modes.sets], "criterion": [
            "" if s.environment["state"] == "idling" else ("not idling" if k % 3 else "yawing")
            for k, s in enumerate(modes.sets)]}),
        model=ModelValues(model=None, wire=wire, labels=LABELS, pairs=((0, 1), (3, 4)), states=states),
        update=update, posterior=posterior, jacket=True, diagnosis=made_up_diagnosis(sensors),
        comparison=Comparison(
            names=parameters.names, rows=rows, correlation=np.corrcoef(draws.T), notes=("they agree",), converged=True,
            derived={"k_xy": update.derived["k_xy"] | {"mean": 1.3e9, "cov": 0.2}}),
    )


def made_up_diagnosis(sensors, *, verdict: str = "named") -> dict:
    """As diagnosis.json has it: a step, a wrong gain, three covariates."""
    rng = np.random.default_rng(9)
    channels = [s.channel for s in sensors]
    hours = [0.5 * k for k in range(N_BLOCK)]
    names = ["FA1/SS1 along 0 deg", "FA1/SS1 along 90 deg", "FA1/SS1 coupling", "T1"]

    def numbers(n, scale=1.0):
        return [float(f"{x:.3g}") for x in scale * rng.standard_normal(n)]

    def pair(n):
        return [numbers(n, 2.0), numbers(n, 0.5)]

    def line(k, n, **more):
        return {"name": names[k], "percent": pair(n), "expected_percent": [0.6] * n, **more}

    findings = [
        {"kind": "structural", "cause": "joints loosened", "location": "face AB, bay 2", "size": -0.62,
         "size_std": 0.04, "unit": "-", "posterior_probability": 0.81, "time_profile": "step",
         "since": "2019-06-03T12:00Z",
         "z": -14.2, "check": "inspect the weld toes", "alternatives": [
             {"cause": "brace stiffness lost", "location": "face AB, bay 2", "posterior_probability": 0.19}],
         "gain": {"heldout_elpd": 41.2, "heldout_elpd_se": 6.0, "max_frequency_error_before": 0.021,
                  "max_frequency_error_after": 0.003}},
        {"kind": "measurement", "cause": "sensor gain", "location": channels[3], "size": 0.1, "size_std": 0.012,
         "unit": "-", "posterior_probability": 1.0, "time_profile": "constant", "since": "", "z": 8.0,
         "check": "calibrate the channel", "alternatives": [], "gain": {}},
    ]
    entries = [
        {"kind": kind, "cause": cause, "location": place, "time_profile": time_profile, "size": entry, "unit": unit,
         "share_left": 0.3, "z": 0.5}
        for kind, cause, place, time_profile, entry, unit in (
            ("structural", "scour", "all legs", "constant", 1.8, "m"), ("structural", "scour", "all legs", "step",
                                                                        0.05, "m"),
            ("structural", "nacelle mass", "nacelle", "constant", 9.1e3, "kg"),
            ("structural", "leg stiffness lost", "leg A, bay 1", "constant", None, "-"),
            ("environmental", "wetted length", "all members", "water_level_m", 0.5, "m per m"),
            ("measurement", "sensor gain", channels[0], "constant", 0.067, "-"),
            ("measurement", "swapped channels", "a and b", "constant", 0.01, "-"))
    ]
    shown = {
        "states": ["before", "after"], "n_block": N_BLOCK,
        "modes": [{"mode": n, "percent": [1.2, 0.1], "expected_percent": [0.3, 0.3], "z": [4.0, 0.3]} for n in names],
        "channels": [{"mode": m, "part": part, "channels": channels, "percent": pair(len(channels)),
                      "z": pair(len(channels))} for m in LABELS for part in ("in phase", "out of phase")],
        "bands": [{k: {"directions": 169, "within_50": 0.5, "within_50_expected": [0.43, 0.57], "within_90": 0.89,
                       "within_90_expected": [0.85, 0.94]} | ({"p": 0.4} if k == "means" else {})
                   for k in ("means", "blocks")}] * 2,
        "time": {"start": "2019-06-03T00:00Z", "hours": hours, "blocks_a_point": 1.0, "by_chance": 4.4,
                 "series": [line(k, N_BLOCK, moved_z=None) for k in range(4)],
                 "sizes": [{"cause": "joints loosened", "location": "face AB, bay 2", "unit": "-", "hours": hours,
                            "size": numbers(N_BLOCK), "size_std": [0.1] * N_BLOCK, "time_profile": [0.0] * N_BLOCK,
                            "time_profile_name": "step", "against": None, "against_unit": None}]},
        "covariates": [{"column": c, "unit": u, "centre": [0.1 * k for k in range(8)], "blocks": [6] * 8,
                        "series": [line(k, 8, slope_z=[5.0 - k, 0.4], slope_percent=[0.1, 0.0]) for k in range(4)]}
                       for c, u in (("water_level_m", "m"), ("air_temperature_c", "degC"), ("rms_mps2", "m/s2"))],
        "prior_shift": {"parameters": [{"name": n, "prior_shift": [2.4, 0.3], "expected": [0.9, 0.9]}
                                       for n in NAMES[:3]],
                        "p_together": [0.002, 0.6]},
        "sensors": [{"channel": s.channel, "level": s.level, "position_m": [float(x) for x in s.position_m],
                     "direction": [float(x) for x in s.direction]} for s in sensors],
        "measurement": [{"cause": "clock offset", "time_profile": "constant", "location": "all of TP", "z": 0.7,
                         "size": 0.27,
                         "size_std": 0.36, "unit": "ms", "tolerance": 0.1, "tried": 8}],
    }
    named = verdict in ("named", "ambiguous")
    return {
        "verdict": verdict, "p_value": 2e-7 if verdict != "none" else 0.4, "findings": findings if named else [],
        "extended_model": "diagnosis.model.toml" if named else None, "threshold": 4.1, "adequacy_p": 0.3,
        "splits": ["telling joints from braces asks |z| of 23"] if verdict == "ambiguous" else [],
            "detectable_sizes": entries,
        "parameters": [{"name": n, "unit": "-", "prior": 1.0, "prior_std": 0.2, "value": 1.5, "std": 0.1,
                        "prior_shift": 2.4, "value_after": 1.05, "std_after": 0.1, "prior_shift_after": 0.3}
                       for n in NAMES[:3]],
        "notes": ["4 blocks left out in which the nacelle turned"],
        "details": {"residuals": shown, "nearest": ["scour, leg A"] if verdict == "unexplained" else []},
    }


@pytest.fixture(scope="session")
def full_run() -> Run:
    return made_up_run()


@pytest.fixture
def undrawn(monkeypatch):
    """Figures are built but not written out: what is tested is the page around them."""
    monkeypatch.setattr(figures, "svg_text", lambda figure, prefix: f'<svg id="{prefix}"></svg>')


@pytest.fixture
def unfigured(monkeypatch, undrawn):
    """No figure is built at all: what is tested are words and tables."""
    for name in set(figures.__all__) - {"Mark", "svg_text", "unit_label"}:
        monkeypatch.setattr(figures, name, lambda *args, **more: None)


@pytest.fixture(scope="session")
def diagnosis_of(full_run):
    """diagnosis_of(verdict): content of a diagnosis.json."""
    return lambda verdict: made_up_diagnosis(full_run.campaign.sensors, verdict=verdict)
