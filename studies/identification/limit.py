"""Scatter of identified modes over the smallest that any unbiased estimate can have, on drawn structures.

    python studies/identification/limit.py OUT [--seeds 101 110] [--records 16] [--peers PYTHON]

The bound is Cramer and Rao's for Whittle's likelihood of the record's spectral matrix (all modes at once, their forces'
spectral matrix, complete shapes and every channel's noise unknown); for a single mode alone it becomes Au's uncertainty
law. Records are white noise through each mode's oscillator (scipy's zero-order hold, no equation of the package), the
forces of the modes correlated, noise of another size in each channel. The package runs as a user would run it;
`--peers` names a Python with pyOMA2 and koma, which get the same records, and the truth to pick by.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg, optimize, signal

RATE_HZ, START = 10.0, "2024-05-01T00:00:00Z"
# a record whose pole lies farther than this from the mode, in half-power half-widths, does not have it
FAR = 3.0
# of peers: thinned out by two, block rows, highest order (Kvaale's choice) and the order at which poles are picked
BLOCK_ROWS, HIGHEST, PICKED = 30, 60, 20


@dataclass(frozen=True, eq=False, kw_only=True)
class Drawn:
    """frequency_hz, damping_ratio (n_mode,), shape (n_channel, n_mode), force (n_mode, n_mode) spectral matrix of the
    modes' forces per Hz of one side, noise (n_channel,) its spectral density; pair: the two close modes."""

    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    force: np.ndarray
    noise: np.ndarray
    minutes: float
    pair: tuple[int, int]


def draw(seed: int) -> Drawn:
    """3 to 6 modes between 0.3 and 2.2 Hz at least 12 % apart, but for one pair 0.3 to 10 % apart."""
    rng = np.random.default_rng([57, seed])
    n_mode = int(rng.integers(3, 6))
    while True:
        f = np.sort(np.exp(rng.uniform(np.log(0.3), np.log(2.0), n_mode)))
        if np.all(np.diff(np.log(f)) > 0.12):
            break
    at = int(rng.integers(0, n_mode))
    apart = np.exp(rng.uniform(np.log(0.003), np.log(0.10)))
    f = np.insert(f, at + 1, f[at] * (1 + apart))
    n_mode += 1
    n_channel = int(rng.integers(3, 13))
    zeta = np.exp(rng.uniform(np.log(0.003), np.log(0.05)) + 0.3 * rng.standard_normal(n_mode))
    shape = rng.standard_normal((n_channel, n_mode))
    if n_channel >= n_mode:
        shape = 0.3 * shape + np.linalg.qr(shape)[0] * np.sqrt(n_channel)
    shape /= np.abs(shape).max(axis=0)
    mixed = (np.eye(n_mode) + 0.2 * rng.standard_normal((n_mode, n_mode))) * np.exp(0.5 * rng.standard_normal(n_mode))
    force = mixed.T @ mixed
    variance = np.pi * f / 2 / (2 * zeta) * np.diag(force)  # of a modal acceleration under a force white on one side
    noise = (0.03 * np.exp(rng.uniform(0, np.log(5)))) ** 2 * (shape**2 @ variance).mean() / (RATE_HZ / 2)
    return Drawn(frequency_hz=f, damping_ratio=np.clip(zeta, 0.003, 0.05), shape=shape, force=force,
                 noise=noise * np.exp(0.6 * rng.standard_normal(n_channel)),
                 minutes=float(rng.choice([10, 20, 30])), pair=(at, at + 1))


def simulate(drawn: Drawn, n_record: int, seed: int) -> np.ndarray:
    """Accelerations (n_sample, n_channel) of consecutive records."""
    rng = np.random.default_rng([58, seed])
    n_mode, n_channel = len(drawn.frequency_hz), len(drawn.noise)
    # four steps of the force a sample
    over, lead = 4, round(60 * RATE_HZ)
    n = round(60 * drawn.minutes * RATE_HZ) * n_record + lead
    size = np.sqrt(RATE_HZ * over / 2)
    force = size * rng.standard_normal((n * over, n_mode)) @ np.linalg.cholesky(drawn.force).T
    motion = np.empty((n, n_mode))
    low = signal.firwin(81, 0.9 * RATE_HZ / 2, fs=RATE_HZ * over)
    for j, (w, zeta) in enumerate(zip(2 * np.pi * drawn.frequency_hz, drawn.damping_ratio, strict=True)):
        b, a, _ = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 2 * zeta * w, w**2]), 1 / (RATE_HZ * over), method="zoh")
        motion[:, j] = np.convolve(signal.lfilter(b.ravel(), a, force[:, j]), low, "same")[::over]
    motion = motion[lead:]
    noise = np.sqrt(drawn.noise * RATE_HZ / 2)
    return motion @ drawn.shape.T + noise * rng.standard_normal((len(motion), n_channel))


def bound(drawn: Drawn, highest_hz: float = 0.4 * RATE_HZ) -> tuple[np.ndarray, np.ndarray]:
    """Smallest standard deviations of ln f and of ln zeta (n_mode,) of one record."""
    f, zeta, phi = drawn.frequency_hz, drawn.damping_ratio, drawn.shape
    (n, p), seconds = phi.shape, 60 * drawn.minutes
    # lines closer than the narrowest resonance asks for, few between
    edges = np.concatenate([fj + zj * fj * np.sinh(np.linspace(-5, 5, 81)) for fj, zj in zip(f, zeta, strict=True)])
    edges = np.unique(np.concatenate([edges, np.linspace(0.05, highest_hz, 60)]))
    edges = edges[(edges > 0.05) & (edges < highest_hz)]
    line, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    information = 0.0
    upper = np.triu_indices(p)
    units = [np.zeros((p, p), complex) for _ in range(p * p)]
    for one, (a, b) in zip(units, [*zip(*upper, strict=True), *((a, b) for a, b in zip(*upper, strict=True) if a < b)],
                           strict=True):
        one[a, b] = one[b, a] = 1
    for one in units[len(upper[0]):]:
        one *= 1j * (np.triu(np.ones((p, p))) - np.tril(np.ones((p, p))))
    for x, dx in zip(line, width, strict=True):
        denominator = 1 - (f / x) ** 2 - 2j * zeta * f / x
        h = 1 / denominator
        by_f = -(h**2) * (-2 * (f / x) ** 2 - 2j * zeta * f / x)  # by ln f
        by_zeta = -(h**2) * (-2j * zeta * f / x)
        response, covariance = phi * h, np.diag(drawn.noise).astype(complex)
        covariance += response @ drawn.force @ response.conj().T
        changes = []
        for derivative in (by_f, by_zeta):
            for j in range(p):
                half = np.outer(phi[:, j] * derivative[j], (response @ drawn.force).conj()[:, j])
                changes.append(half + half.conj().T)
        changes += [response @ unit @ response.conj().T for unit in units]
        right = (drawn.force * h[:, None]) @ response.conj().T  # S H^H phi^T, (p, n)
        for j in range(p):
            for i in range(n):
                if i == np.argmax(np.abs(phi[:, j])):
                    continue
                half = np.zeros((n, n), complex)
                half[i] = right[j]
                changes.append(half + half.conj().T)
        for i in range(n):
            one = np.zeros((n, n), complex)
            one[i, i] = drawn.noise[i]
            changes.append(one)
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        flat = (root @ np.array(changes) @ root.conj().T).reshape(len(changes), -1)
        information = information + seconds * dx * (flat @ flat.conj().T).real
    scale = 1 / np.sqrt(np.diag(information))
    inverse = linalg.pinvh(information * scale * scale[:, None]) * scale * scale[:, None]
    std = np.sqrt(np.diag(inverse)[: 2 * p])
    return std[:p], std[p:]


def write_campaign(folder: Path, drawn: Drawn, data: np.ndarray) -> Path:
    import h5py

    (folder / "acceleration").mkdir(parents=True, exist_ok=True)
    sensors = "".join(
        f'[[sensor]]\nchannel = "c{k}"\nlevel = "{k}"\nposition_m = [0.0, 0.0, {3.0 * (k + 1)}]\n'
        'direction = [1.0, 0.0, 0.0]\nquantity = "acceleration"\nunit = "m/s2"\n' for k in range(data.shape[1]))
    (folder / "campaign.toml").write_text(
        f'name = "drawn"\nsampling_rate_hz = {RATE_HZ}\nblock_minutes = {drawn.minutes}\n{sensors}', encoding="utf-8")
    with h5py.File(folder / "acceleration" / "one.h5", "w") as file:
        held = file.create_dataset("data", data=data)
        held.attrs["start"], held.attrs["sampling_rate_hz"] = START, RATE_HZ
    return folder


def likeness(drawn: Drawn, frequency_hz: np.ndarray, damping: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Distance of each true mode to each found one: frequency in widths of the resonance, damping, 1 - MAC."""
    width = drawn.damping_ratio + 0.003
    away = np.abs(frequency_hz / drawn.frequency_hz[:, None] - 1) / width[:, None]
    away = away + 2 * np.abs(np.log(np.maximum(damping, 1e-4) / drawn.damping_ratio[:, None]))
    product = np.abs(drawn.shape.T @ shape.conj()) ** 2
    return away + 2 * (1 - product / np.sum(drawn.shape**2, axis=0)[:, None] / np.sum(np.abs(shape) ** 2, axis=0))


def picked(drawn: Drawn, frequency_hz, damping, shape) -> dict:
    """Of one record, the found modes that stand for the true ones; NaN where none does."""
    n = len(drawn.frequency_hz)
    f, zeta = np.full(n, np.nan), np.full(n, np.nan)
    phi = np.full(drawn.shape.shape, np.nan + 0j)
    if len(frequency_hz):
        for j, k in zip(*optimize.linear_sum_assignment(likeness(drawn, frequency_hz, damping, shape)), strict=True):
            if abs(frequency_hz[k] / drawn.frequency_hz[j] - 1) < FAR * (drawn.damping_ratio[j] + 0.003):
                f[j], zeta[j], phi[:, j] = frequency_hz[k], damping[k], shape[:, k]
    return {"f": f, "zeta": zeta, "shape": phi}


def of_pyoma(block: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from pyoma2.algorithms import SSI
    from pyoma2.setup import SingleSetup

    setup = SingleSetup(block, fs=RATE_HZ / 2)
    setup.add_algorithms(SSI(name="ssi", br=BLOCK_ROWS, ordmax=PICKED, step=2))
    setup.run_by_name("ssi")
    result = setup["ssi"].result
    f, zeta, shape = result.Fn_poles[:, -1], result.Xi_poles[:, -1], result.Phi_poles[:, -1]
    there = np.isfinite(f)
    return f[there], zeta[there], shape[there].T


def of_koma(block: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from koma.clustering import PoleClusterer, group_clusters
    from koma.oma import covssi, find_stable_poles

    found = covssi(block, RATE_HZ / 2, BLOCK_ROWS, np.arange(2, HIGHEST + 1, 2), showinfo=False)
    value, vector, order = find_stable_poles(*found, 1, stabcrit={"freq": 0.05, "damping": 0.1, "mac": 0.1})[:3]
    grouped = PoleClusterer(value, vector, order, min_samples=10, min_cluster_size=10).postprocess(prob_threshold=0.5)
    if not len(grouped[0]):
        return np.zeros(0), np.zeros(0), np.zeros((block.shape[1], 0))
    zeta, omega, shape = group_clusters(*grouped)[:3]
    shape = np.array([np.mean(one, axis=1) if np.ndim(one) > 1 else one for one in shape]).T
    return (np.array([np.mean(w) for w in omega]) / (2 * np.pi), np.array([np.mean(z) for z in zeta]), shape)


def peers(data: Path, out: Path) -> None:
    """Run by the Python of the peers: what each finds in each record, by name."""
    held = np.load(data)
    found = {}
    for name, of in (("pyOMA2", of_pyoma), ("koma", of_koma)):
        for k, record in enumerate(held["record"]):
            block = signal.resample_poly(record, 1, 2, axis=0)
            found |= {f"{name}/{k}/{i}": value for i, value in enumerate(of(block - block.mean(axis=0)))}
    np.savez(out, **found)


def of_identify(folder: Path, drawn: Drawn) -> tuple[list[dict], int]:
    """The modes that `probupdate.identify` finds by its defaults, with their standard deviations."""
    import probupdate

    data = probupdate.identify(folder).data
    values = [np.array([getattr(s, name) for s in data.sets]) for name in (
        "frequency_hz", "damping_ratio", "frequency_std_hz", "damping_ratio_std")]
    shape = np.nanmean([s.shape for s in data.sets], axis=0)
    place = dict(zip(*optimize.linear_sum_assignment(likeness(
        drawn, np.nanmedian(values[0], axis=0), np.nanmedian(values[1], axis=0), shape)), strict=True))
    there = [place.get(j, -1) for j in range(len(drawn.frequency_hz))]
    found = []
    for k, s in enumerate(data.sets):
        f, zeta, f_std, zeta_std = (np.where(np.array(there) >= 0, v[k][there], np.nan) for v in values)
        f = np.where(np.abs(f / drawn.frequency_hz - 1) < FAR * (drawn.damping_ratio + 0.003), f, np.nan)
        found.append({"f": f, "zeta": zeta, "shape": s.shape[:, there], "f std": f_std, "zeta std": zeta_std})
    return found, data.n_mode


def of_ssi(block: np.ndarray, drawn: Drawn) -> dict:
    """SSI-cov of the package at order 20, the mean over orders, without the likelihood of the spectra; the pole of each
    mode is picked by the truth."""
    from probupdate.identification.order_average import averages, twins
    from probupdate.identification.record import identify_record

    record = identify_record(block - block.mean(axis=0), RATE_HZ / 2, order=PICKED, block_rows=BLOCK_ROWS, spread=16,
                             sub_records=30)
    own = record.poles
    _, place = optimize.linear_sum_assignment(likeness(drawn, own.frequency_hz, own.damping_ratio, own.shape))
    mean = averages(record, [twins(record.by_order, PICKED, int(k)) for k in place])
    std = [np.linalg.norm(a, axis=1) for a in (mean.factors.ln_frequency, mean.factors.damping_ratio)]
    return {"f": mean.frequency_hz, "zeta": mean.damping_ratio, "shape": mean.shape,
            "f std": std[0] * mean.frequency_hz, "zeta std": std[1]}


def rows_of(drawn: Drawn, name: str, found: list[dict], least: tuple[np.ndarray, np.ndarray]) -> list[dict]:
    """A row a mode."""
    f, zeta = (np.array([one[key] for one in found]) for key in ("f", "zeta"))
    rows, basis = [], np.linalg.qr(drawn.shape[:, drawn.pair])[0]
    for j in range(f.shape[1]):
        there = np.isfinite(f[:, j])
        row = {"method": name, "mode": j, "found": int(there.sum()), "records": len(there)}
        if there.sum() > 3:
            ln_f, rel = np.log(f[there, j] / drawn.frequency_hz[j]), zeta[there, j] / drawn.damping_ratio[j] - 1
            row |= {"f over bound": np.std(ln_f, ddof=1) / least[0][j], "zeta over bound": np.std(rel, ddof=1)
                    / least[1][j], "bias of zeta": rel.mean(), "standard error": least[1][j] / np.sqrt(there.sum())}
            if "f std" in found[0]:
                stated = [np.array([one[f"{key} std"][j] for one in found])[there] for key in ("f", "zeta")]
                row |= {"f std over scatter": np.median(stated[0] / f[there, j]) / np.std(ln_f, ddof=1),
                        "zeta std over scatter": np.median(stated[1]) / np.std(zeta[there, j], ddof=1)}
            if j in drawn.pair:
                planes = [np.linalg.qr(one["shape"][:, drawn.pair].real)[0] for one in found
                          if np.isfinite(one["shape"][:, drawn.pair]).all()]
                if planes:
                    row["1 - MAC of plane"] = float(np.median([
                        1 - np.linalg.svd(basis.T @ q, compute_uv=False)[-1] ** 2 for q in planes]))
        rows.append(row)
    return rows


def study(folder: Path, seed: int, n_record: int, python: str) -> dict:
    drawn = draw(seed)
    data, least = simulate(drawn, n_record, seed), bound(drawn)
    records = np.array(np.split(data, n_record))
    found, n_mode = of_identify(write_campaign(folder / "campaign", drawn, data), drawn)
    rows = rows_of(drawn, "probupdate", found, least)
    rows += rows_of(drawn, "SSI-cov", [of_ssi(signal.resample_poly(r, 1, 2, axis=0), drawn) for r in records], least)
    if python:
        np.savez(folder / "records.npz", record=records)
        subprocess.run([python, __file__, "--of-peers", folder / "records.npz", folder / "peers.npz"], check=True)
        with np.load(folder / "peers.npz") as held:
            for name in ("pyOMA2", "koma"):
                each = [[held[f"{name}/{k}/{i}"] for i in range(3)] for k in range(n_record)]
                rows += rows_of(drawn, name, [picked(drawn, *one) for one in each], least)
        (folder / "records.npz").unlink()
    return {"seed": seed, "minutes": drawn.minutes, "channels": len(drawn.noise), "frequency_hz": drawn.frequency_hz,
            "damping": drawn.damping_ratio, "bound": least, "modes found": n_mode, "rows": rows}


def summary(every: list[dict]) -> str:
    """Medians over modes, and quartiles of what is stated."""
    lines = []
    for name in dict.fromkeys(r["method"] for one in every for r in one["rows"]):
        rows = [r for one in every for r in one["rows"] if r["method"] == name]
        found, of = sum(r["found"] for r in rows), sum(r["records"] for r in rows)
        text = f"{name}: {100 * found / of:.0f} % found"
        for key in ("f over bound", "zeta over bound", "bias of zeta", "f std over scatter", "zeta std over scatter",
                    "1 - MAC of plane"):
            value = [r[key] for r in rows if key in r]
            if value:
                low, middle, high = np.quantile(value, [0.25, 0.5, 0.75])
                text += f"; {key} {middle:.3g} ({low:.3g} to {high:.3g})"
        lines.append(text)
    return "\n".join(lines)


def main() -> int:
    if sys.argv[1:2] == ["--of-peers"]:
        peers(Path(sys.argv[2]), Path(sys.argv[3]))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, nargs=2, default=(101, 110), metavar=("FIRST", "LAST"))
    parser.add_argument("--records", type=int, default=16)
    parser.add_argument("--peers", default="", metavar="PYTHON")
    a = parser.parse_args()
    from probupdate.cli.terminal import time_left

    every, begun, made = [], time.monotonic(), 0
    last = a.seeds[1]
    for seed in range(a.seeds[0], last + 1):
        path = a.out / f"{seed}" / "rows.json"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(study(path.parent, seed, a.records, a.peers), indent=1,
                                       default=lambda x: x.tolist() if hasattr(x, "tolist") else float(x)))
            made += 1
        every.append(json.loads(path.read_text()))
        left = time_left(time.monotonic() - begun, made, made + last - seed)
        sys.stdout.write(f"seed {seed}{left}\n{summary(every[-1:])}\n")
        sys.stdout.flush()
    sys.stdout.write(f"\nall, median and quartiles over modes\n{summary(every)}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
