"""One drawn record through pyOMA2 and through probupdate, and pyOMA2's poles through `convert --to modes`.

A frame of five storeys that moves in x and y (close pairs, 1.5 % apart), ten accelerometers, eight blocks of ten
minutes under white noise, 1 % of critical damping, 5 % sensor noise. Eigenvalues are scipy's; the record is exact for
the force held over each sample. pyOMA2 is given the true frequencies to pick at, probupdate nothing.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import h5py
import numpy as np
from scipy import linalg, signal

import probupdate
from probupdate.modal.modes import ModalData, read_modes

RATE_HZ, MINUTES, N_BLOCK, DAMPING, NOISE, SEED = 20.0, 10.0, 8, 0.01, 0.05, 7
N_STOREY, N_MODE, MASS_KG, START = 5, 6, 1000.0, "2024-05-01T00:00:00Z"
CHANNELS = [f"{axis}{storey}" for storey in range(1, N_STOREY + 1) for axis in "xy"]
ORDER, BLOCK_ROWS, STEP = 40, 30, 2


def structure() -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (rad/s)^2 and shapes of unit modal mass (10, 10)."""
    stiffness = np.zeros((10, 10))
    for axis, one in enumerate((2.0e6, 2.06e6)):
        k = np.append(np.full(N_STOREY, one), 0.0)
        stiffness[axis::2, axis::2] = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    return linalg.eigh(stiffness, MASS_KG * np.eye(10))


def record(square: np.ndarray, shape: np.ndarray, n_block: int) -> np.ndarray:
    """Accelerations (n_sample, 10) under white noise held over each step."""
    rng, omega = np.random.default_rng(SEED), np.sqrt(square)
    n = round(60 * MINUTES * RATE_HZ) * n_block
    force = rng.standard_normal((n, 10)) @ shape
    motion = np.empty((n, 10))
    for j, w in enumerate(omega):
        oscillator = ([1.0, 0.0, 0.0], [1.0, 2 * DAMPING * w, w**2])
        b, a, _ = signal.cont2discrete(oscillator, 1 / RATE_HZ, method="zoh")
        motion[:, j] = signal.lfilter(b.ravel(), a, force[:, j])
    clean = motion @ shape.T
    return clean + NOISE * clean.std(axis=0) * rng.standard_normal(clean.shape)


def write_campaign(folder: Path, data: np.ndarray) -> Path:
    (folder / "acceleration").mkdir(parents=True, exist_ok=True)
    sensors = "".join(
        f'[[sensor]]\nchannel = "{c}"\nlevel = "{c[1]}"\nposition_m = [0.0, 0.0, {3.0 * int(c[1])}]\n'
        f'direction = {[1.0, 0.0, 0.0] if c[0] == "x" else [0.0, 1.0, 0.0]}\nquantity = "acceleration"\nunit = "m/s2"\n'
        for c in CHANNELS)
    (folder / "campaign.toml").write_text(
        f'name = "frame"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = {MINUTES}\n{sensors}', encoding="utf-8")
    with h5py.File(folder / "acceleration" / "one.h5", "w") as file:
        held = file.create_dataset("data", data=data.astype(np.float32))
        held.attrs["start"], held.attrs["sampling_rate_hz"] = START, RATE_HZ
    return folder


def of_pyoma(data: np.ndarray, truth_hz: np.ndarray, folder: Path) -> dict:
    """Modes picked at the true frequencies in each block, standard deviations of the first; all poles into `folder`."""
    from pyoma2.algorithms import SSI
    from pyoma2.setup import SingleSetup

    folder.mkdir(exist_ok=True)
    found: dict = {"frequency": [], "damping": [], "shape": []}
    begun = time.process_time()
    for k, block in enumerate(np.split(data, len(data) // round(60 * MINUTES * RATE_HZ))):
        setup = SingleSetup(block, fs=RATE_HZ)
        setup.add_algorithms(SSI(name="ssi", br=BLOCK_ROWS, ordmax=ORDER, step=STEP))
        setup.run_by_name("ssi")
        result = setup["ssi"].result
        np.savez(folder / f"{k}.npz", Fn_poles=result.Fn_poles, Xi_poles=result.Xi_poles, Phi_poles=result.Phi_poles)
        setup.mpe("ssi", sel_freq=list(truth_hz), order_in=20)
        result = setup["ssi"].result
        for name, value in (("frequency", result.Fn), ("damping", result.Xi), ("shape", result.Phi)):
            found[name].append(np.array(value))
    found["seconds"] = time.process_time() - begun
    return found


def std_of_pyoma(block: np.ndarray, truth_hz: np.ndarray, step: int) -> tuple[np.ndarray, float]:
    """Its own standard deviations of frequencies in one block, and the processor's seconds."""
    from pyoma2.algorithms import SSI
    from pyoma2.setup import SingleSetup

    begun = time.process_time()
    setup = SingleSetup(block, fs=RATE_HZ)
    setup.add_algorithms(SSI(name="ssi", br=BLOCK_ROWS, ordmax=ORDER, step=step, calc_unc=True, nb=30))
    setup.run_by_name("ssi")
    setup.mpe("ssi", sel_freq=list(truth_hz), order_in=20)
    return np.array(setup["ssi"].result.Fn_std), time.process_time() - begun


def row(name: str, frequency, damping, shape, truth_hz, truth_shape) -> dict:
    """Errors of the mean in standard errors, scatter over the blocks, worst MAC; a block that lacks a mode counts."""
    frequency = np.array(frequency)
    mean, scatter = np.nanmean(frequency, axis=0), np.nanstd(frequency, axis=0, ddof=1)
    n = np.isfinite(frequency).sum(axis=0)
    planes = [[0, 1], [2, 3], [4, 5]]
    worst = 1.0
    for phi in shape:
        for pair in planes:
            basis = np.linalg.qr(truth_shape[:, pair])[0]
            for one in phi[:, pair].T:
                if np.isfinite(one).all():
                    worst = min(worst, float(np.sum(np.abs(basis.T @ one) ** 2) / np.vdot(one, one).real))
    return {"name": name, "found": f"{int(n.sum())} of {frequency.size}",
            "error": float(np.nanmax(np.abs(mean / truth_hz - 1))),
            "in standard errors": float(np.nanmax(np.abs(mean - truth_hz) / scatter * np.sqrt(n))),
            "scatter_hz": scatter.tolist(), "damping": float(np.nanmedian(damping)), "worst S2MAC": worst}


def nearest(data: ModalData, truth_hz: np.ndarray) -> list[int]:
    """Of each true frequency the column nearest to it."""
    mean = np.nanmean([s.frequency_hz for s in data.sets], axis=0)
    return [int(np.argmin(np.abs(mean - f))) for f in truth_hz]


def draw(scatter, stated: dict, truth_hz: np.ndarray, path: Path) -> None:
    """Stated standard deviations over the scatter of the blocks, by mode."""
    import matplotlib.pyplot as plt

    plt.rcParams |= {"svg.hashsalt": "peers", "svg.fonttype": "none"}
    fig, axes = plt.subplots(figsize=(6.4, 2.8))
    for k, (name, std) in enumerate(stated.items()):
        axes.plot(np.arange(N_MODE) + 0.12 * (k - 1), np.array(std) / scatter, "os^"[k], label=name)
    axes.axhline(1, color="k", lw=0.8)
    axes.set(yscale="log", yticks=[0.1, 0.2, 0.5, 1, 2], yticklabels=["0.1", "0.2", "0.5", "1", "2"],
             xticks=range(N_MODE), xticklabels=[f"{f:.2f} Hz" for f in truth_hz],
             ylabel="stated std / scatter\nover eight blocks")
    axes.minorticks_off()
    axes.legend(fontsize=8)
    fig.savefig(path, bbox_inches="tight", metadata={"Date": None})


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="directory to write")
    parser.add_argument("--blocks", type=int, default=N_BLOCK)
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    square, shape = structure()
    truth_hz, truth_shape = np.sqrt(square[:N_MODE]) / (2 * np.pi), shape[:, :N_MODE]
    samples = record(square, shape, a.blocks)
    campaign = write_campaign(a.out / "campaign", samples)
    begun = time.process_time()
    own = probupdate.identify(campaign).data
    seconds = time.process_time() - begun
    theirs = of_pyoma(samples, truth_hz, a.out / "poles")
    taken = nearest(own, truth_hz)
    probupdate.convert(a.out / "poles", a.out / "imported.json", to="modes", sensors=campaign)
    followed = read_modes(a.out / "imported.json")
    place = nearest(followed, truth_hz)
    rows = [
        row("pyOMA2, picked", theirs["frequency"], theirs["damping"], theirs["shape"], truth_hz, truth_shape),
        *(row(name, [s.frequency_hz[at] for s in data.sets], [s.damping_ratio[at] for s in data.sets],
              [s.shape[:, at] for s in data.sets], truth_hz, truth_shape)
          for name, data, at in (("pyOMA2, its poles followed", followed, place), ("probupdate", own, taken))),
    ]
    stated = {"probupdate": np.nanmedian([s.frequency_std_hz[taken] for s in own.sets], axis=0).tolist()}
    took = {"probupdate, with standard deviations": seconds, "pyOMA2, without": theirs["seconds"]}
    for step in (2, 1):
        std, spent = std_of_pyoma(samples[: round(60 * MINUTES * RATE_HZ)], truth_hz, step)
        stated[f"pyOMA2, step={step}"] = std.tolist()
        took[f"pyOMA2, one block with standard deviations, step={step}"] = spent
    content = {"truth_hz": truth_hz.tolist(), "rows": rows, "std_hz": stated, "processor_seconds": took,
               "modes": {"probupdate": own.n_mode, "followed": followed.n_mode}}
    (a.out / "peers.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    print(json.dumps(content, indent=1))
    draw(rows[-1]["scatter_hz"], stated, truth_hz, a.out / "peers.svg")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
