"""Annual damage of the worst ten hot spots of drawn turbines, beside another program's stresses in time, counted by
the package `rainflow`.

K and M are OpenSees' (tubes by the model's beam theory, finer mesh, lumped mass and soil: `tests/drawn`); their modes,
with the rotor's dashpot between them, are integrated in time under wave loads of Airy and Morison and quasi-steady
thrust, both drawn from the spectra that fatigue.toml states; what higher modes carry follows statically. Ten-minute
pieces are counted one by one, and so are half hours. Common to both are the drawn turbine, the spectra, and each hot
spot's factors.

    pip install rainflow
    python studies/lifetime/time_domain.py OUT [--cases 40] [--first SEED] [--minutes 25]

Finished cases are kept in OUT; the same command continues.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import linalg, sparse

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "stresses"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
import truth
from drawn import jackets, monopiles
from drawn.opensees_frame import Build
from drawn.skeleton import State

from probupdate.lifetime.conditions import Conditions
from probupdate.lifetime.details import weights
from probupdate.lifetime.fatigue import FatigueModel, fatigue_model
from probupdate.structure.description_file import parse_description

GRAVITY, WATER, INERTIA, AIR = 9.81, 1025.0, 2.0, 1.225
YEAR_S, TEN_MINUTES_S = 365.25 * 86400, 600.0
RATE, PERIOD_S, RUN_IN_S, N_MODE, WORST, HIGHEST_HZ, WAVES_TO_HZ = 10.0, 2400.0, 600.0, 16, 10, 3.0, 0.6
HALF_HOUR = round((PERIOD_S - RUN_IN_S) / TEN_MINUTES_S)  # pieces of ten minutes
KINDS = ("narrow", "broad", "two peaks", "low frequency")
BATCH, BATCHES = 32, 3
# on shear areas where a model neglects shear: the shortest pieces are a few centimetres long
NO_SHEAR = 1e7
GAUSS, GAUSS_WEIGHT = 0.5 + np.sqrt(0.15) * np.array([-1.0, 0.0, 1.0]), np.array([5, 8, 5]) / 18
CURVES = {"one slope": dict(log10_a1=11.855, m1=3.0, log10_a2=11.855, m2=3.0),
          "two slopes": dict(log10_a1=11.764, m1=3.0, log10_a2=15.606, m2=5.0),
          "steep": dict(log10_a1=15.117, m1=4.0, log10_a2=17.146, m2=5.0)}


def drawn_states(kind: str, rng) -> list[dict]:
    """States of a fatigue.toml whose stresses are narrow in band, broad, with two peaks, or slow."""
    def state(name, share, operating, hs, tp, gamma, wind, turbulence, thrust):
        return dict(name=name, share=share, operating=operating, hs_m=hs, tp_s=tp, gamma=gamma, wind_mps=wind,
                    turbulence=turbulence, thrust_coefficient=thrust)

    u = rng.uniform
    if kind == "narrow":
        # waves near the first modes, standing rotor
        return [state("idle", 1.0, False, u(0.6, 1.5), u(3.2, 4.5), u(1, 3), u(2, 4), 0.1, 0.03)]
    if kind == "broad":
        return [state("rated", 0.9, True, u(1, 2), u(5, 7), u(1, 2), u(9, 14), u(0.1, 0.16), u(0.5, 0.8)),
                state("storm", 0.1, False, u(4, 6), u(8, 11), u(1, 2.5), u(22, 30), 0.12, 0.06)]
    if kind == "two peaks":
        return [state("swell", 1.0, False, u(1.5, 3), u(12, 16), u(4, 7), u(15, 25), u(0.1, 0.15), u(0.1, 0.2))]
    return [state("gusts", 1.0, True, u(0.3, 0.8), u(4, 6), u(1, 2), u(7, 11), u(0.14, 0.2), u(0.7, 0.85))]


def drawn_case(seed: int) -> tuple[dict, dict, str, str]:
    """model.toml and fatigue.toml of a case as dictionaries, its kind of spectrum and of S-N curve."""
    rng = np.random.default_rng([seed, 65])
    on = (jackets, monopiles)[seed % 2]
    raw = on.draw(rng, small=True)
    kind, law = KINDS[seed // 2 % 4], list(CURVES)[int(rng.integers(3))]
    weld = dict(factor=1.0, curve="law")
    girths = [dict(part="tower", z_m=s["z_m"], **weld) for s in raw["tower"]["station"][:2]]
    joints = [dict(at="leg", curve="law", chord=dict(axial_crown=2.0, axial_saddle=4.0, in_plane=2.5,
                                                     out_of_plane=3.5))]
    if on is monopiles:
        girths.append(dict(part="monopile", z_m=raw["monopile"]["station"][2]["z_m"], **weld))
    conditions = dict(
        format=1, water=dict(inertia_coefficient=INERTIA, drag_coefficient=0.0),
        wind=dict(air_density_kgpm3=AIR, rotor_diameter_m=float(rng.uniform(110, 160)), integral_length_m=340.2),
        damping=dict(ratio=float(rng.uniform(0.006, 0.02))),
        life=dict(age_years=1.0, years=25, reference_cycles=1e7), direction=[dict(heading_deg=0.0, share=1.0)],
        state=drawn_states(kind, rng),
        curve=dict(law=CURVES[law] | dict(reference_thickness_m=0.025, thickness_exponent=0.2)),
        joint=joints if on is jackets else [], girth=girths,
        uncertainty=dict(x_load=dict(median=1.0, cov=0.1), x_scf=dict(median=1.0, cov=0.1),
                         miner=dict(median=1.0, cov=0.3), log10_a_std=0.2))
    return raw, conditions, kind, law


# the other program ---------------------------------------------------------------------------------------------------


class Recorded(Build):
    """What `truth` asks of a model in OpenSees."""

    def __init__(self, skeleton, in_shear: float):
        super().__init__(skeleton, in_shear)
        self.place = self.at
        self.pieces = {k: (a, b, dict(e=m.steel.E, g=m.steel.G, area=area, second=second, torsion=2 * second,
                                      shear=shear))
                       for k, (a, b, m, shear) in self.of_member.items()
                       for area, second in [_section(m.diameter, m.wall)]}
        self.outer = {k: m.diameter for k, (_, _, m, _) in self.of_member.items()}


def _section(diameter: float, wall: float) -> tuple[float, float]:
    inner = diameter - 2 * wall
    return np.pi / 4 * (diameter**2 - inner**2), np.pi / 64 * (diameter**4 - inner**4)


@dataclass(frozen=True)
class Truth:
    """N_MODE frequencies (rad/s) and what thrust and points of waves do: modal loads hub (m,), wave (m, 3 n_point);
    stresses of ten spots by modes (10, m), static by thrust (10,) and by points (10, 3 n_point)."""

    omega: np.ndarray
    hub: np.ndarray
    wave: np.ndarray
    of_modes: np.ndarray
    of_hub: np.ndarray
    of_waves: np.ndarray
    middle: np.ndarray
    along: np.ndarray
    volume: np.ndarray


def truth_of(raw: dict, model: FatigueModel, spots: np.ndarray) -> Truth:
    on = monopiles if "monopile" in raw else jackets
    theta = {p["name"]: p["initial"] for p in raw["parameter"]}
    b = Recorded(on.skeleton(raw, theta, State(), fine=2), NO_SHEAR if raw["mesh"]["theory"] != "timoshenko" else 1.0)
    tops = {b.tag[lead] for lead, _ in b.s.rigid}
    s = truth.equations(b, tops)
    value, phi = linalg.eigh(s.stiffness, s.mass + 1e-9 * np.max(s.mass) * np.eye(len(s.mass)),
                             subset_by_index=(0, N_MODE - 1))
    at, w = weights(model.spots)
    rows, own = [], []
    for k in spots:
        d = model.details[at[k]]
        number, stress = truth.nominal(s, d.place_m, d.along, d.crown, d.saddle, d.end)
        if d.part == "tower":
            stress = stress * _of_level(b.of_member[number][2], raw["tower"]["station"], d.level_m)[:, None]
        own.append((number, model.spots[k].thickness_effect * w[k] @ stress))
        rows.append(own[-1][1] @ truth.end_forces(s, number))
    rows = np.array(rows)
    flexible = linalg.cho_solve(linalg.cho_factor(s.stiffness), rows.T).T
    hub = s.rows(b.tag["rna hub"])[0]
    middle, along, volume, blocks, less = [], [], [], [], []
    wet = ("pile",) if on is monopiles else ("leg", "brace")
    for number, (a, c, m, _) in b.of_member.items():
        start, end = b.place[a], b.place[c]
        length = float(np.linalg.norm(end - start))
        x = (end - start) / length
        shares = _wet(start[2], end[2], raw["site"]["mudline_m"]) if m.tags["group"] in wet else (0.0, 0.0)
        for xi, share in zip(shares[0] + (shares[1] - shares[0]) * GAUSS, (shares[1] - shares[0]) * GAUSS_WEIGHT,
                             strict=True) if shares[1] > shares[0] else ():
            nodal = _work(xi, length, x)
            middle.append(start + xi * (end - start))
            along.append(x)
            volume.append(share * length * np.pi / 4 * m.diameter**2)
            blocks.append(np.vstack([s.rows(a), s.rows(c)]).T @ nodal)
            # the load on the spot's own element is no force of its end
            less.append([stress @ nodal if number == mine else np.zeros(3) for mine, stress in own])
    spread = sparse.csr_array(np.hstack(blocks))
    return Truth(omega=np.sqrt(value), hub=phi.T @ hub, wave=phi.T @ spread, of_modes=rows @ phi,
                 of_hub=flexible @ hub, of_waves=flexible @ spread - np.array(less).transpose(1, 0, 2).reshape(
                     len(spots), -1), middle=np.array(middle), along=np.array(along), volume=np.array(volume))


def _wet(low: float, high: float, mudline: float) -> tuple[float, float]:
    """Shares of a piece's length between mudline and still water."""
    if abs(high - low) < 1e-9:
        return (0.0, float(mudline < low < 0.0))
    a, b = sorted(np.clip(((mudline - low) / (high - low), -low / (high - low)), 0.0, 1.0))
    return a, b


def _of_level(member, stations, z: float) -> np.ndarray:
    """(3,) of nominal stresses: section of the piece's middle over that of the weld's level."""
    D, t = (float(np.interp(z, [s["z_m"] for s in stations], [s[k] for s in stations]))
            for k in ("diameter_m", "thickness_m"))
    (A, I), (A0, I0) = _section(D, t), _section(member.diameter, member.wall)
    bending = (D / I) / (member.diameter / I0)
    return np.array([A0 / A, bending, bending])


def _work(xi: float, length: float, x: np.ndarray) -> np.ndarray:
    """(12, 3) forces and moments at a beam's ends that do the work of a force at xi (cubic shapes)."""
    across = np.eye(3) - np.outer(x, x)
    spin = np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])
    n = (1 - 3 * xi**2 + 2 * xi**3, length * xi * (1 - xi) ** 2, 3 * xi**2 - 2 * xi**3, length * xi**2 * (xi - 1))
    line = np.outer(x, x)
    return np.vstack([n[0] * across + (1 - xi) * line, n[1] * spin, n[2] * across + xi * line, n[3] * spin])


# loads and time ------------------------------------------------------------------------------------------------------


def wave_number(omega: np.ndarray, depth: float) -> np.ndarray:
    low, high = np.zeros_like(omega), omega**2 / GRAVITY + 10 * omega / np.sqrt(GRAVITY * depth)
    for _ in range(80):
        k = 0.5 * (low + high)
        over = GRAVITY * k * np.tanh(k * depth) > omega**2
        low, high = np.where(over, low, k), np.where(over, k, high)
    return k


def point_forces(t: Truth, f: np.ndarray, depth: float) -> np.ndarray:
    """(3 n_point, n_line) force of a metre of amplitude along x: inertia of what accelerates across the member."""
    omega, k = 2 * np.pi * f, wave_number(2 * np.pi * f, depth)
    z, kd = t.middle[:, 2:], np.minimum(k * depth, 300.0)
    up = np.minimum(k * (z + depth), 300.0)
    phase = np.exp(-1j * k * t.middle[:, :1])
    flat, rise = omega * np.cosh(up) / np.sinh(kd) * phase, 1j * omega * np.sinh(up) / np.sinh(kd) * phase
    speed = np.stack([flat, np.zeros_like(flat), rise], axis=1)
    speed -= t.along[:, :, None] * np.einsum("pi,pif->pf", t.along, speed)[:, None]
    return (WATER * INERTIA * t.volume[:, None, None] * 1j * omega * speed).reshape(-1, len(f))


def sea(f: np.ndarray, state) -> np.ndarray:
    """JONSWAP by DNV-RP-C205, m^2/Hz, to 0.6 Hz."""
    fp = 1 / state.tp_s
    b = np.exp(-0.5 * ((f / fp - 1) / np.where(f <= fp, 0.07, 0.09)) ** 2)
    found = (1 - 0.287 * np.log(state.gamma)) * 0.3125 * state.hs_m**2 * fp**4 * f**-5.0
    return np.where(f <= WAVES_TO_HZ, found * np.exp(-1.25 * (fp / f) ** 4) * state.gamma**b, 0.0)


def thrust(f: np.ndarray, state, wind) -> np.ndarray:
    """Kaimal's turbulence through Vickery's rotor, N^2/Hz."""
    area = np.pi / 4 * wind.rotor_diameter_m**2
    c = AIR * area * state.thrust_coefficient * state.wind_mps
    x = wind.integral_length_m / state.wind_mps
    u = (state.turbulence * state.wind_mps) ** 2 * 4 * x / (1 + 6 * f * x) ** (5 / 3)
    return u * (c / (1 + (2 * f * np.sqrt(area) / state.wind_mps) ** (4 / 3))) ** 2


def stepped(t: Truth, ratio: float, c: float) -> tuple[np.ndarray, ...]:
    """X_k+1 = A X_k + B0 u_k + B1 u_k+1 of modal displacements and speeds, loads linear in between: exact."""
    m, dt = len(t.omega), 1 / RATE
    drag = np.diag(2 * ratio * t.omega) + c * np.outer(t.hub, t.hub)
    one = np.zeros((4 * m, 4 * m))
    one[:m, m : 2 * m] = np.eye(m)
    one[m : 2 * m, : 2 * m] = np.hstack([-np.diag(t.omega**2), -drag])
    one[m : 2 * m, 2 * m : 3 * m] = one[2 * m : 3 * m, 3 * m :] = np.eye(m)
    e = linalg.expm(one * dt)
    B1 = e[: 2 * m, 3 * m :] / dt
    return e[: 2 * m, : 2 * m], e[: 2 * m, 2 * m : 3 * m] - B1, B1


def simulated(t: Truth, c: Conditions, state, depth: float, batches: int, rng):
    """Yields stresses (10, n_piece, n_sample) of ten-minute pieces, MPa, after each batch; first their variances
    (10,) by the same solver's transfer functions."""
    n = round(PERIOD_S * RATE)
    f = np.fft.rfftfreq(n, 1 / RATE)
    used = slice(round(PERIOD_S / TEN_MINUTES_S), int(np.searchsorted(f, HIGHEST_HZ)) + 1)
    line, wet = f[used], int(np.searchsorted(f[used], WAVES_TO_HZ))
    force = point_forces(t, line[:wet], depth)
    modal, static = t.wave @ force, t.of_waves @ force
    densities = sea(line, state)[:wet], thrust(line, state, c.wind)
    area = np.pi / 4 * c.wind.rotor_diameter_m**2
    dash = AIR * area * state.thrust_coefficient * state.wind_mps if state.operating else 0.0
    yield _variance(t, c.damping.ratio, dash, line, (modal, static), densities)
    A, B0, B1 = stepped(t, c.damping.ratio, dash)
    m = len(t.omega)
    for _ in range(batches):
        z = rng.standard_normal((2, 2, BATCH, len(line)))
        # of lines 1 / PERIOD_S apart
        wave, gust = (np.sqrt(d / PERIOD_S / 2) * n / 2 * (x[0] + 1j * x[1])[:, : len(d)] * np.sqrt(2)
                      for d, x in zip(densities, z, strict=True))
        u, rest = np.empty((n, m, BATCH)), np.empty((n, WORST, BATCH))
        for k in range(BATCH):
            lines = np.zeros((m + WORST, len(f)), complex)
            lines[:, used] = np.concatenate([t.hub, t.of_hub])[:, None] * gust[k]
            lines[:, used.start : used.start + wet] += np.vstack([modal, static]) * wave[k]
            x = np.fft.irfft(lines, n).T
            u[:, :, k], rest[:, :, k] = x[:, :m], x[:, m:]
        X = np.zeros((2 * m, BATCH))
        stress = np.empty((n, WORST, BATCH))
        dynamic = np.hstack([t.of_modes, np.zeros((WORST, m))])
        quasi = t.of_modes / t.omega**2
        dashed = np.outer(t.of_hub - quasi @ t.hub, -dash * t.hub)
        dynamic[:, m:] += dashed
        for k in range(n):
            stress[k] = dynamic @ X + rest[k] - quasi @ u[k]
            if k + 1 < n:
                X = A @ X + B0 @ u[k] + B1 @ u[k + 1]
        first, piece = round(RUN_IN_S * RATE), round(TEN_MINUTES_S * RATE)
        yield stress[first:].transpose(1, 2, 0).reshape(WORST, -1, piece)


def _variance(t: Truth, ratio: float, dash: float, line, waves, densities) -> np.ndarray:
    w = 2 * np.pi * line
    plain = t.omega[:, None] ** 2 - w**2 + 2j * ratio * t.omega[:, None] * w
    total = np.zeros(WORST)
    modal, static = waves
    for P, S, d in ((modal, static, densities[0]), (t.hub[:, None], t.of_hub[:, None], densities[1])):
        n = len(d)
        alone = t.hub[:, None] / plain[:, :n]
        q = P / plain[:, :n]
        v = 1j * w[:n] * (t.hub @ q) / (1 + 1j * w[:n] * dash * (t.hub @ alone))
        q = q - dash * v * alone
        slow = (P - dash * t.hub[:, None] * v) / t.omega[:, None] ** 2
        z = S + t.of_modes @ (q - slow) - dash * np.outer(t.of_hub, v)
        total += np.sum(np.abs(z) ** 2 * d, axis=1) / PERIOD_S
    return total


def by_package(record: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ranges and counts of a record's cycles by the package `rainflow`."""
    import rainflow

    return tuple(np.array(rainflow.count_cycles(record)).T)


def counted(stress: np.ndarray, law, count) -> np.ndarray:
    """(n_piece,) Miner's sum of ten-minute pieces (n_piece, n_sample)."""
    knee = 10 ** ((law.log10_a2 - law.log10_a1) / (law.m2 - law.m1)) if law.m1 != law.m2 else 0.0
    found = []
    for piece in stress:
        # of a series of turning points the same cycles are found, sooner
        turn = np.flatnonzero(np.diff(np.sign(np.diff(piece))) != 0) + 1
        size, number = count(piece[np.r_[0, turn, len(piece) - 1]])
        log = np.log10(size)
        log_n = np.where(size <= knee, law.log10_a2 - law.m2 * log, law.log10_a1 - law.m1 * log)
        found.append(np.sum(number * 10**-log_n))
    return np.array(found)


def mean_damage(stress: np.ndarray, law, variance: float, count) -> tuple[float, float]:
    """Of a ten-minute piece, and its standard error: regressed on moments whose expectations are known (a Gaussian
    stress of this variance), which takes off most of the scatter."""
    D = counted(stress, law, count)
    x = stress / np.sqrt(variance)
    control = np.array([np.mean(x**p, axis=1) - e for p, e in ((2, 1.0), (4, 3.0), (6, 15.0))])
    design = np.vstack([np.ones(len(D)), control]).T
    solved, *_ = np.linalg.lstsq(design, D, rcond=None)
    left = D - design @ solved
    s2 = left @ left / (len(D) - 4)
    return float(solved[0]), float(np.sqrt(s2 * np.linalg.inv(design.T @ design)[0, 0]))


def run(seed: int, batches: int = BATCHES, count=by_package) -> dict:
    """A case: annual damage of the worst ten spots by the product and counted, with the standard error."""
    raw, stated, kind, law_name = drawn_case(seed)
    conditions = Conditions.model_validate(stated)
    model = fatigue_model(parse_description(raw, raw["name"]), raw["name"], conditions)
    initial = model.parameters.initial
    begun = time.process_time()
    found = model.reduce([initial]).solve(initial)
    annual = found.damage_per_year()
    ours = time.process_time() - begun
    spots = np.argsort(-annual)[:WORST]
    t = truth_of(raw, model, spots)
    law, thick = conditions.curve["law"], np.array([model.spots[k].thickness_effect for k in spots])
    rng = np.random.default_rng([seed, 66])
    # (mean or standard error, of ten minutes or half an hour, spot)
    total, spread, moved = np.zeros((2, 2, WORST)), [], []
    for state in conditions.state:
        pieces = simulated(t, conditions, state, -raw["site"]["mudline_m"], batches, rng)
        variance = next(pieces)
        stress = np.concatenate(list(pieces), axis=1)
        spread.append(np.mean(stress**2, axis=(1, 2)) / variance)
        moved.append(thick**2 * found.moments[0, len(moved), 0, spots] / variance)
        for k in range(WORST):
            for j, n in enumerate((1, HALF_HOUR)):
                mean, std = mean_damage(stress[k].reshape(-1, n * stress.shape[2]), law, variance[k], count)
                a_year = state.share * YEAR_S / (n * TEN_MINUTES_S)
                total[0, j, k] += a_year * mean
                total[1, j, k] = np.hypot(total[1, j, k], a_year * std)
    # irregularity of the worst spot's stress in its worst state
    m = found.moments[0, :, :, spots[0]]
    return dict(seed=seed, turbine=raw["name"], kind=kind, curve=law_name, spots=spots.tolist(),
                at=[model.details[model.spots[k].detail].name for k in spots], damage=annual[spots].tolist(),
                counted=total[0, 0].tolist(), error=total[1, 0].tolist(), half_hours=total[0, 1].tolist(),
                half_hours_error=total[1, 1].tolist(), variance_in_time=np.min(spread).item(),
                variance_ratio=np.array(moved).tolist(),
                irregularity=(m[:, 2] / np.sqrt(m[:, 0] * m[:, 3])).tolist(), frequency_hz=[
                    found.responses[0].frequency_hz[0], t.omega[0] / 2 / np.pi], seconds=[
                        ours, time.process_time() - begun - ours])


def table(rows: list[dict]) -> str:
    lines = ["| kind | cases | within 10 % | median of ours over counted | 5 % | 95 % | standard error |",
             "|---|---|---|---|---|---|---|"]
    for kind in (*KINDS, "all"):
        own = [r for r in rows if kind in (r["kind"], "all")]
        if not own:
            continue
        ratio = np.array([np.array(r["damage"]) / r["counted"] for r in own])
        error = np.array([np.array(r["error"]) / r["counted"] for r in own])
        low, middle, high = np.quantile(ratio, (0.05, 0.5, 0.95))
        lines.append(f"| {kind} | {len(own)} | {np.sum(np.abs(ratio - 1) < 0.1)} of {ratio.size} | {middle:.3f} | "
                     f"{low:.3f} | {high:.3f} | {np.median(error):.3f} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--minutes", type=float, default=25.0)
    a = parser.parse_args()
    a.out.mkdir(parents=True, exist_ok=True)
    until, rows = time.monotonic() + 60 * a.minutes, []
    for seed in range(a.first, a.first + a.cases):
        file = a.out / f"case_{seed:02d}.json"
        if not file.exists():
            if time.monotonic() > until:
                break
            file.write_text(json.dumps(run(seed), indent=1), encoding="utf-8")
        rows.append(json.loads(file.read_text(encoding="utf-8")))
        r = rows[-1]
        ratio = np.array(r["damage"]) / r["counted"]
        sys.stdout.write(f"{seed:2d} {r['kind']:14s} {r['curve']:11s} {ratio.min():.3f} to {ratio.max():.3f} (+-"
                         f"{max(np.array(r['error']) / r['counted']):.3f}) {r['turbine']}\n")
        sys.stdout.flush()
    sys.stdout.write(table(rows) + "\n")


if __name__ == "__main__":
    main()
