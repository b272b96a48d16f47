"""What the commands read, and their words."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
sys.path[:0] = [str(REPOSITORY), *(str(REPOSITORY / "tests" / name) for name in ("commands", "farms"))]
from command_cases import modes_table, write_building  # noqa: E402
from farm_cases import write_farm  # noqa: E402

RATE_HZ, SECONDS = 20.0, 480
# enough blocks for two processes
MANY = 84
# the command that takes minutes; those that are not tried; those that read nothing of other commands; those that are
# tried less often
LONG = "demo"
UNTRIED = ("matrices",)
OF_INPUTS = ("convert", "check", "modes", "select", "update")
SELDOM = ("sample", "sets", "report", "farm", "stresses", "simulate, 2 processes", "identify, 2 processes")


def inputs(folder: Path, *, of_steps: bool = True) -> None:
    """All that the commands read; without what other commands write where `of_steps` says so."""
    folder.mkdir(parents=True)
    write_building(folder)
    (folder / "nine.json").write_text(json.dumps(modes_table(n_set=9)))
    rng = np.random.default_rng(3)
    size = int(30 * MANY * RATE_HZ)
    motion = np.zeros((size, 3))
    for k in range(3):
        noise, w, decay = rng.standard_normal(size), 0.25 + 0.35 * k, 0.995
        for t in range(2, size):
            motion[t, k] = 2 * decay * np.cos(w) * motion[t - 1, k] - decay**2 * motion[t - 2, k] + noise[t]
    data = motion @ rng.standard_normal((3, 4)) + 0.1 * rng.standard_normal((size, 4))
    head = f'name = "b"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = 1\n' + "".join(
        f'[[sensor]]\nchannel = "c{k}"\nlevel = "l{k}"\nposition_m = [0.0, 0.0, {3.0 * k + 3}]\n'
        "direction = [1.0, 0.0, 0.0]\n" for k in range(4))
    few = data[: int(SECONDS * RATE_HZ)]
    for name, held, text in (("campaign", few, head), ("many", data, head.replace("minutes = 1", "minutes = 0.5")),
                             ("empty", None, head)):
        (folder / name).mkdir()
        (folder / name / "campaign.toml").write_text(text)
        if held is not None:
            (folder / name / "acceleration").mkdir()
            with h5py.File(folder / name / "acceleration" / "a.h5", "w") as file:
                made = file.create_dataset("data", data=held.astype(np.float32))
                made.attrs["start"], made.attrs["sampling_rate_hz"] = "2024-01-01T00:00:00Z", RATE_HZ
    (folder / "raw").mkdir()
    for k in range(4):
        np.save(folder / "raw" / f"2024010{k + 1}_000000.npy", few[k * len(few) // 4 : (k + 1) * len(few) // 4])
    (folder / "convert.toml").write_text(
        'files = "*.npy"\nstart_pattern = \'(\\d{8}_\\d{6})\'\nstart_format = "%Y%m%d_%H%M%S"\nzone = "UTC"\n')
    (folder / "run").mkdir()
    for name in ("model.npz", "parameters.toml", "nine.json"):
        shutil.copy(folder / name, folder / "run" / name)
    shutil.copy(folder / "nine.json", folder / "run" / "modes.json")
    if of_steps:
        steps(folder)


def steps(folder: Path) -> None:
    """What commands read that other commands write; enough sets for a regression."""
    write_farm(folder / "farm")
    of_stresses(folder / "stresses")
    rows = modes_table(n_set=30)
    for k, one in enumerate(rows["sets"]):
        one["id"] = f"2026-06-{k + 1:02d}T00:00Z"
    (folder / "thirty.json").write_text(json.dumps(rows))
    problem = ["--model", str(folder / "model.npz"), "--modes", str(folder / "nine.json")]
    sampled = ["--ess", "100", "--max-steps", "400", "--out", str(folder / "run" / "posterior.nc")]
    for words in (["update", *problem, "--out", str(folder / "run" / "update.json")], ["sample", *problem, *sampled],
                  ["identify", str(folder / "campaign"), "--jobs", "1",
                   "--out", str(folder / "identified" / "modes.json")]):
        subprocess.run(command(words), check=True, capture_output=True)


def of_stresses(folder: Path) -> None:
    """A run of the small turbine with a made-up posterior, noise as its campaign, and fatigue.toml."""
    from probupdate.structure.load import load_model
    from probupdate.updating.posterior_file import Posterior, write_posterior
    from tests.lifetime.test_fatigue_export import toml
    from tests.lifetime.test_stress import CONDITIONS, UPDATED, _toml
    from tests.small_turbine import SENSORS, small_turbine

    raw, run, rng = small_turbine(), folder / "run", np.random.default_rng(5)
    for p in raw["parameter"]:
        p["update"] = p["name"] in UPDATED[:3]
    run.mkdir(parents=True)
    (run / "model.toml").write_text(toml(raw))
    (folder / "fatigue.toml").write_text(_toml(CONDITIONS))
    model, one = load_model(run / "model.toml"), np.ones(1)
    theta = model.parameters.initial * (1 + 1e-3 * rng.standard_normal((4, 100, len(model.parameters))))
    write_posterior(Posterior(
        names=model.parameters.names, theta=theta, log_likelihood=np.zeros((4, 100)), log_posterior=np.zeros((4, 100)),
        prior=theta[0, :10], response_labels=("f",), measured=one, std=one, predicted=np.ones((2, 1)),
        frequency_hz=np.ones((2, 1)), mode_labels=("FA1",), r_hat=np.ones(theta.shape[2]),
        ess=np.full(theta.shape[2], 400.0), converged=True, verdict="made up", fingerprint="none"),
        run / "posterior.nc")
    (folder / "campaign" / "acceleration").mkdir(parents=True)
    (folder / "campaign" / "campaign.toml").write_text(
        'name = "n"\nsampling_rate_hz = 5.0\nblock_minutes = 20\n' + "".join(
            f'[[sensor]]\nchannel = "{c}"\nlevel = "{level}"\nposition_m = {place}\ndirection = {d}\n'
            for c, level, place, d in SENSORS))
    with h5py.File(folder / "campaign" / "acceleration" / "a.h5", "w") as file:
        file["data"] = 1e-3 * rng.standard_normal((12000, len(SENSORS))).astype(np.float32)
        file["data"].attrs.update({"start": "2024-03-01T00:00:00Z", "sampling_rate_hz": 5.0})


def commands(i: Path, o: Path) -> dict[str, list[str]]:
    """Command -> its words, with inputs in `i` and results in `o`: every verb that writes."""
    problem = ["--model", f"{i}/model.npz", "--modes", f"{i}/nine.json"]
    return {
        "simulate": ["simulate", f"{o}/campaign", "--days", "0.03", "--seed", "3"],
        "convert": ["convert", f"{i}/raw", f"{o}/campaign", "--description", f"{i}/convert.toml"],
        "check": ["check", f"{i}/campaign", "--out", f"{o}/check.json"],
        "identify": ["identify", f"{i}/campaign", "--jobs", "1", "--out", f"{o}/modes.json"],
        "explore": ["explore", f"{i}/campaign", "--out", f"{o}/poles.html"],
        "modes": ["modes", f"{i}/model.npz", "--out", f"{o}/own.json"],
        "select": ["select", f"{i}/nine.json", "--out", f"{o}/selected.json"],
        "regress": ["regress", f"{i}/thirty.json", "--covariates", "water_level_m", "--out", f"{o}/regression.csv"],
        "update": ["update", *problem, "--out", f"{o}/update.json"],
        "sample": ["sample", *problem, "--ess", "100", "--max-steps", "400", "--out", f"{o}/posterior.nc"],
        "compare": ["compare", f"{i}/run/update.json", f"{i}/run/posterior.nc", "--out", f"{o}/compare.json"],
        "sets": ["sets", *problem, "--out", f"{o}/sets.json"],
        "template": ["template", "matrices", f"{o}/template"],
        "inform": ["inform", *problem, "--out", f"{o}/information.json"],
        "diagnose": ["diagnose", *problem, "--no-extend", "--out", f"{o}/diagnosis.json"],
        "figures": ["figures", f"{i}/identified/modes.json", "--out", f"{o}/figures"],
        "export": ["export", f"{i}/run", "--to", "lifetime", f"{o}/lifetime", "--draws", "5", "--accept"],
        "farm": ["farm", f"{i}/farm/farm.toml", "--out", f"{o}/farm"],
        "stresses": ["stresses", f"{i}/stresses/campaign", "--run", f"{i}/stresses/run", "--fatigue",
                     f"{i}/stresses/fatigue.toml", "--draws", "2", "--worst", "1", "--out", f"{o}/stresses"],
        "report": ["report", f"{i}/run", "--out", f"{o}/report.html"],
        "simulate, 2 processes": ["simulate", f"{o}/campaign", "--days", "0.1", "--seed", "4", "--jobs", "2"],
        "identify, 2 processes": ["identify", f"{i}/many", "--jobs", "2", "--out", f"{o}/modes.json"],
        "demo": ["demo", f"{o}/demo", "--days", "0.2", "--hide", "none"],
    }


# inputs one by one, for those commands whose words name them or what they lie in
LOST = ("nine.json", "model.npz", "parameters.toml", "convert.toml", "campaign/campaign.toml",
        "campaign/acceleration/a.h5", "raw/20240102_000000.npy", "run/posterior.nc", "run/update.json", "run/model.npz",
        "thirty.json", "identified/modes.json")
READ_BESIDE = {"parameters.toml": "model.npz"}


def command(words: list[str]) -> list[str]:
    return [sys.executable, "-m", "probupdate", *words]
