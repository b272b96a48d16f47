"""Which figures an identification has, for the page and for files: Figs. 4-7 and those that judge poles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from probupdate.errors import InputError
from probupdate.identification.block_poles import BlockPoles
from probupdate.identification.block_store import stored_block
from probupdate.identification.classification import ClassifierSettings, rotor_bands
from probupdate.identification.ssi import Poles
from probupdate.io.files import write_text
from probupdate.modal.labels import TURBINE, family
from probupdate.modal.modes import ModalData, ModalSet, mac, modal_phase_collinearity
from probupdate.reporting import figures_identification as draw
from probupdate.reporting import figures_measurement as measurement
from probupdate.reporting.style import FULL_IN, GREY, INK, PALE, save_figure
from probupdate.reporting.values import mode_labels

# stable: twins at the order below within these, as commonly drawn
SAME_FREQUENCY, SAME_DAMPING, SAME_MAC = 0.01, 0.05, 0.95
# conditions frequencies are drawn against, where recorded: key of the environment -> name with unit
CONDITIONS = {
    "wind_speed_mps": "wind [m/s]", "rotor_speed_rpm": "rotor [rpm]", "power_kw": "power [kW]",
    "water_level_m": "water level [m]", "wave_height_m": "wave height [m]", "air_temperature_c": "air [°C]",
    "rms_mps2": "motion, rms [m/s²]", "rms_mps": "motion, rms [m/s]", "rms_m": "motion, rms [m]",
}
KINDS = ("png", "svg", "pdf")
UNITS = {"acceleration": "m/s²", "velocity": "m/s", "displacement": "m"}


P_FREQUENCIES = {"1P": 1, "3P": 3, "6P": 6}


@dataclass(frozen=True, eq=False, kw_only=True)
class Drawing:
    """A figure with a name for its file and what to say below it."""

    name: str
    figure: Figure
    caption: str


def rotor_lines(scada: pd.DataFrame | None) -> dict[str, float]:
    """Upper bounds of the P-frequencies in Hz, by name, from the highest rotor speed that SCADA saw."""
    if scada is None or "rotor_speed_rpm" not in scada:
        return {}
    speed = scada["rotor_speed_rpm"].to_numpy(float)
    rated = float(np.percentile(speed[np.isfinite(speed)], 99.5)) if np.isfinite(speed).any() else 0.0
    return {f"{name} {n * rated / 60:.2f}": n * rated / 60 for name, n in P_FREQUENCIES.items()} if rated > 3 else {}


def drawings(
    modes: ModalData, *, poles: pd.DataFrame | None = None, block: BlockPoles | None = None,
    scada: pd.DataFrame | None = None,
) -> Iterator[Drawing]:
    """Every figure that what is there allows. poles: modes.poles.csv; block: a stored block; scada with time and what
    was recorded, `state` given."""
    if scada is not None and "wind_speed_mps" in scada:
        state = scada["state"].astype(str) if "state" in scada else pd.Series("unknown", index=scada.index)
        yield Drawing(
            name="fig4_wind_and_state", caption="Wind speed" + (
                "." if (state == "unknown").all() else " and turbine state."),
            figure=measurement.wind_and_state(
                scada["time"].to_numpy(), scada["wind_speed_mps"].to_numpy(float), list(state)))
    if poles is not None:
        yield from pole_drawings(poles, list(modes.labels), rotor_lines(scada))
    if block is not None and block.poles is not None:
        yield stabilisation_drawing(block, modes)
    yield from mode_drawings(modes)


def pole_drawings(
    poles: pd.DataFrame, labels: list[str], lines_hz: dict[str, float], width_in: float = FULL_IN
) -> Iterator[Drawing]:
    """Figs. 5-7, the paper's classifier step by step, and the one used here; the last step is a rotor's."""
    rotor = bool(lines_hz) or not {family(one) for one in labels}.isdisjoint(TURBINE[:2])
    time, frequency = poles["time"].to_numpy(), poles["frequency_hz"].to_numpy(float)
    upper = max(2.5, 1.1 * float(np.max(frequency[poles["criterion"] == "kept"], initial=0)))
    dashed = " Dashed: upper bounds of the P-frequencies at the highest rotor speed recorded." if lines_hz else ""

    def drawing(name: str, groups: dict, marks: dict, caption: str) -> Drawing:
        figure = measurement.poles(groups, marks, harmonics_hz=lines_hz, width_in=width_in, height_in=2.9,
                                   upper_hz=upper)
        return Drawing(name=name, figure=figure, caption=caption)

    plain = (INK, "o", 5.0, True)
    yield drawing("fig5_all_poles", {"poles": (time, frequency)}, {"poles": plain},
                  f"All poles up to {upper:.3g} Hz, no post-processing.{dashed}")
    passed = np.nan_to_num(poles["mac"].to_numpy(float)) >= 0.80
    yield drawing("fig6_mac", {"MAC ≥ 0.80": (time[passed], frequency[passed])}, {"MAC ≥ 0.80": plain},
                  "Poles whose shape has a MAC of 0.80 or more with a mode of the model."
                  + (" Lines of a rotor that move the structure as its first mode does are still among them."
                     if rotor else ""))
    if rotor and "paper_criterion" in poles:
        kept = (poles["paper_criterion"] == "kept").to_numpy()
        name = "after the complexity criterion"
        yield drawing("fig7_complexity", {name: (time[kept], frequency[kept])}, {name: plain},
                      "After the complexity criterion near the P-frequencies (multiples of the rotor's speed).")
    criterion = poles["criterion"].astype(str).to_numpy()
    taken, harmonic = criterion == "kept", criterion == "harmonic"
    groups = {"removed": (time[~taken & ~harmonic], frequency[~taken & ~harmonic])}
    marks = {"removed": (PALE, "x", 7.0, True)}
    if harmonic.any():
        groups["removed as harmonic"] = (time[harmonic], frequency[harmonic])
        marks["removed as harmonic"] = (GREY, "+", 16.0, True)
    mode = poles["mode"].astype(str).to_numpy()
    for label in labels or sorted(set(mode[taken])):
        rows = taken & (mode == label)
        groups[label] = (time[rows], frequency[rows])
    yield drawing("poles_classified", groups, marks,
                  "The classifier used here: close pairs judged by their plane"
                  + (", harmonics by the rotor speed of SCADA" if rotor else "")
                  + ", each pole with the criterion that kept or removed it.")


def stabilisation_drawing(block: BlockPoles, modes: ModalData) -> Drawing:
    # a block that was left out has no poles to draw
    assert block.poles is not None
    every = sorted((block.poles, *block.others), key=lambda p: p.order)
    steady: list[str] = []
    for before, now in zip([None, *every[:-1]], every, strict=True):
        steady += steadiness(before, now)
    modal = next((s for s in modes.sets if s.id == block.id), None)
    labels = mode_labels(modes)
    chosen = {} if modal is None else dict(zip(labels, modal.frequency_hz, strict=True))
    swept = {} if modal is None else bands(modal)
    figure = draw.stabilisation(
        block.line_hz, block.spectrum, np.repeat([p.order for p in every], [len(p.frequency_hz) for p in every]),
        np.concatenate([p.frequency_hz for p in every]), steady, chosen_hz=chosen, harmonics_hz=swept,
        unit=UNITS[block.quantity])
    return Drawing(
        name="stabilisation", figure=figure,
        caption=f"Poles of every model order in block {block.id}, over the spectral density summed over channels. "
        f"Stable: within {100 * SAME_FREQUENCY:g} % in frequency, {100 * SAME_DAMPING:g} % in damping and MAC "
        f"{SAME_MAC:g} of a pole of the order below; dashed: what was taken for a mode"
        + ("; grey bands: what the rotor's multiples swept." if swept else "."))


def steadiness(before: Poles | None, now: Poles) -> list[str]:
    """How each pole of an order stands to those of the order below: keys of `figures_identification.STEADINESS`."""
    kinds = list(draw.STEADINESS)
    if before is None or not len(before.frequency_hz):
        return [kinds[2]] * len(now.frequency_hz)
    near = np.abs(before.frequency_hz / now.frequency_hz[:, None] - 1) <= SAME_FREQUENCY
    damped = np.abs(before.damping_ratio - now.damping_ratio[:, None]) <= SAME_DAMPING * np.abs(
        now.damping_ratio[:, None])
    alike = mac(now.shape, before.shape) >= SAME_MAC
    full, some = np.any(near & damped & alike, axis=1), np.any(near, axis=1)
    return [kinds[0] if a else kinds[1] if b else kinds[2] for a, b in zip(full, some, strict=True)]


def bands(modal: ModalSet) -> dict[str, tuple[float, float]]:
    """Name -> what that multiple of the rotor's speed swept in a set's block, Hz."""
    settings = ClassifierSettings()
    swept = rotor_bands(modal.environment, settings)
    # an idling rotor's multiples lie at nothing of interest
    return {f"{n}P": (float(a), float(b)) for n, (a, b) in zip(settings.harmonics, swept, strict=False) if a > 0.05}


def mode_drawings(modes: ModalData) -> Iterator[Drawing]:
    """Maps of MAC and MPC, Argand plots and frequency against conditions, from modal sets alone."""
    labels = mode_labels(modes)
    sets = [s for s in modes.sets if s.measured.any()]
    if not sets:
        return
    one = modes.set() if modes.set().measured.any() else max(sets, key=lambda s: int(s.measured.sum()))
    yield Drawing(name="auto_mac", caption=f"MAC between the modes of set {one.id}.", figure=draw.mac_map(
        mac(one.shape, one.shape), labels, labels, across="mode", up="mode"))
    note = ["not found" if not m else f"MPC {c:.2f}" for m, c in zip(
        one.measured, modal_phase_collinearity(one.shape), strict=True)]
    yield Drawing(name="argand", figure=draw.argand(labels, one.shape, note),
                  caption=f"Shapes of set {one.id} on the complex plane, a point a channel.")
    if len(sets) >= 3:
        yield from _drawings_over_sets(sets, one, labels)


def _drawings_over_sets(sets: list[ModalSet], one: ModalSet, labels: tuple[str, ...]) -> Iterator[Drawing]:
    every, modes = np.stack([s.shape for s in sets]), range(len(labels))
    similar = np.array([[_median_mac(every[:, :, i], one.shape[:, j]) for j in modes] for i in modes])
    yield Drawing(name="mac_over_sets", figure=draw.mac_map(
        similar, labels, labels, across=f"mode of set {one.id}", up="mode, median over sets"),
        caption=f"Median over all sets of the MAC to set {one.id}; close pairs turn in their plane from set to set.")
    time = pd.to_datetime([s.id for s in sets], errors="coerce", utc=True)
    if not time.isna().any():
        mpc = np.array([modal_phase_collinearity(s.shape) for s in sets])
        mpc[~np.array([s.measured for s in sets])] = np.nan
        yield Drawing(name="mpc_map", figure=draw.mpc_map(time.tz_convert(None).to_numpy(), labels, mpc),
                      caption="Modal phase collinearity of every mode in every block; hatched where it was not found.")
    known = {name: np.array([_number(s.environment.get(key)) for s in sets]) for key, name in CONDITIONS.items()}
    known = {name: v for name, v in known.items() if np.isfinite(v).sum() >= 3 and np.nanmax(v) > np.nanmin(v)}
    if known:
        frequency, std = np.array([s.frequency_hz for s in sets]), np.array([s.frequency_std_hz for s in sets])
        yield Drawing(name="conditions", figure=draw.against_conditions(labels, frequency, std, known),
                      caption="Change of each frequency from its median against the recorded conditions; bars: "
                      "identification's own standard deviations where known. Nothing is fitted here.")


def _median_mac(shapes: np.ndarray, one: np.ndarray) -> float:
    value = mac(shapes.T, one)[:, 0]
    return float(np.median(value[np.isfinite(value)])) if np.isfinite(value).any() else np.nan


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else np.nan


def block_of(modes_file: Path, modes: ModalData, block_id: str | None = None) -> BlockPoles | None:
    """The stored block of that id, else that of the reference set or the first that can be used; None where no blocks
    are kept beside modes_file. Raises InputError for an id that is not there."""
    folder = modes_file.with_name(f"{modes_file.name}.blocks")
    if block_id is not None:
        found = stored_block(folder, block_id)
        if found is None:
            raise InputError(f"block {block_id}", f"is not kept in {folder}", "name a set's id, or identify again")
        return found
    usable = [s.id for s in modes.sets if s.measured.any()]
    first = [modes.reference_set] if modes.reference_set in usable else []
    return next((b for b in (stored_block(folder, i) for i in (*first, *usable[:1])) if b is not None), None)


def write_figures(
    modes_file: str | Path, out: str | Path, *, modes: ModalData, poles: pd.DataFrame | None,
    scada: pd.DataFrame | None = None, block_id: str | None = None, kind: str = "png",
) -> list[Path]:
    """Every drawing as a file of that kind ('png', 'svg', 'pdf') in the folder `out`, and captions.txt beside them."""
    if kind not in KINDS:
        raise InputError("figures", f"'{kind}' is not a kind of file", f"choose from {', '.join(KINDS)}")
    out, captions, written = Path(out), [], []
    block = block_of(Path(modes_file), modes, block_id)
    out.mkdir(parents=True, exist_ok=True)
    for drawing in drawings(modes, poles=poles, block=block, scada=scada):
        path = out / f"{drawing.name}.{kind}"
        save_figure(drawing.figure, path)
        captions.append(f"{path.name}: {drawing.caption}")
        written.append(path)
    return [*written, write_text(out / "captions.txt", "\n".join(captions) + "\n")]
