"""The section on mode shapes: in three dimensions, or channel by channel where the model has no geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probupdate.modal.modes import rotate_to_real
from probupdate.model.interface import Wireframe
from probupdate.reporting import figures
from probupdate.reporting.elements import Notice, Picture, Section, Viewer
from probupdate.reporting.model_values import compared_modes, update_set
from probupdate.reporting.values import ModelValues, Run
from probupdate.reporting.viewer import align, viewer_data

MODE_NAMES = {
    "FA1": "first fore-aft bending", "SS1": "first side-side bending", "T1": "first torsion",
    "FA2": "second fore-aft bending", "SS2": "second side-side bending",
    "X1": "first bending along x", "Y1": "first bending along y",
    "X2": "second bending along x", "Y2": "second bending along y",
    "H1": "first lateral bending", "V1": "first vertical bending", "A1": "first motion along the structure",
    "H2": "second lateral bending", "V2": "second vertical bending",
}


def modes_section(run: Run) -> Section:
    title, model = "Modes in three dimensions", run.model
    if model is not None and model.wire is None and (shown := _shapes_by_channel(run, model)) is not None:
        return Section(anchor="modes", title="Mode shapes", items=(shown,), lead="The model came without geometry, so "
                       "its shapes are shown channel by channel.")
    if model is None or model.wire is None:
        text = "a model with geometry, so the modes cannot be drawn."
        return Section(anchor="modes", title=title, items=(Notice(level="missing", text=text),))
    data, measured = _viewer_values(run, model, model.wire)
    handling = "Drag turns, after a click the wheel zooms, shift-drag moves; arrow keys and space work too."
    caption = (
        f"{handling} Circles: the motion measured at the sensors. Each computed shape is scaled to the measured one; "
        "where two modes form a close pair the computed pair is turned within its plane onto the measured "
        "pair, as the update does."
        if measured
        else handling
    )
    still = Picture(svg=figures.svg_text(figures.mode_shapes(model.wire, *_viewer_arrays(data)), "shapes"),
                    caption="The same at the largest displacement: grey at rest"
                    + (", blue updated, dashed initial" if run.update is not None else ", dashed as computed")
                    + ("; circles: measured at the sensors." if measured else "."))
    return Section(anchor="modes", title=title, items=(Viewer(data=data, caption=caption), still),
                   lead=f"The global modes {_caption(measured, run.update is not None)}"
                   + (" (the paper's Fig. 3)." if run.jacket else "."))


def _viewer_values(run: Run, model: ModelValues, wire: Wireframe) -> tuple[dict, bool]:
    """The viewer's values, and whether measured shapes are among them: where every sensor's place is known."""
    sensors = run.campaign.sensors if run.campaign else ()
    modes = compared_modes(run.compared, run.update)
    chosen = update_set(modes, run.update)
    measured_hz, measured_shape, states = None, None, model.states
    if modes is not None and chosen is not None:
        measured_hz = chosen.frequency_hz
        rows = [modes.channels.index(s.channel) for s in sensors if s.channel in modes.channels]
        if sensors and len(rows) == len(sensors):
            measured_shape = chosen.shape[rows]
            # computed shapes come in the channels' order of the modes, measured ones are wanted in that of the sensors
            states = {name: replace(state, shape=state.shape[rows]) for name, state in model.states.items()}
    data = viewer_data(
        wire, model.labels, states, measured_hz=measured_hz, measured_shape=measured_shape,
        sensors=sensors if measured_shape is not None else (), pairs=model.pairs,
        names=MODE_NAMES, planes=_planes(run, wire),
    )
    return data, measured_shape is not None


def _caption(measured: bool, updated: bool) -> str:
    """What is drawn: measured shapes need to know where the channels are, updated ones an update."""
    computed = "as first computed and after the update" if updated else "as computed with the initial parameters"
    if measured:
        return f"as measured, {computed}" if updated else f"as measured and {computed}"
    return (f"{computed}; the measured shapes are not drawn: they need modes.json in the folder, and the sensors' "
            "places of a campaign or a model.toml")


def _shapes_by_channel(run: Run, model: ModelValues) -> Picture | None:
    data = compared_modes(run.nine or run.modes, run.update)
    chosen = update_set(data, run.update)
    if data is None or chosen is None or not chosen.measured.any():
        return None
    measured = np.real(rotate_to_real(chosen.shape))
    size = np.nanmax(np.abs(measured), axis=0, where=np.isfinite(measured), initial=1e-300)
    paired = {j for pair in model.pairs for j in pair}
    groups = [*model.pairs, *((j,) for j in range(data.n_mode) if j not in paired)]
    computed = {}
    for name, modes in model.states.items():
        known = np.isfinite(modes.frequency_hz)
        turn = align(measured, modes.shape, groups)
        turned = np.nan_to_num(modes.shape) @ np.where(known[:, None] & known, turn, 0)
        computed[name] = np.where(known, turned, np.nan) / size
    figure = figures.shapes_by_channel(model.labels, measured / size, chosen.shape_std / size, computed)
    listed = ", ".join(f"{k} {name}" for k, name in enumerate(data.channels, start=1))
    return Picture(svg=figures.svg_text(figure, "channels"), caption=(
        "Every computed shape is scaled to the measured one, a close pair turned within its plane; the largest "
        f"measured component is 1. Channels: {listed}."))


def _viewer_arrays(data: dict) -> tuple[list[str], dict, np.ndarray, np.ndarray | None]:
    """The viewer's values as arrays for the still picture: titles, states, sensors' places and motions in metres."""
    modes, scale = data["modes"], data["scale"]
    nodes = len(data["nodes"])
    states = {}
    for key in ("initial", "updated"):
        shapes = [m["variants"].get(key, {}).get("shape") for m in modes]
        if any(s is not None for s in shapes):
            states[key] = scale * np.stack([np.full((nodes, 3), np.nan) if s is None else s for s in shapes], axis=-1)
    points = np.array(data["sensors"]).reshape(-1, 3)
    measured = None
    if len(points) and all("measured" in m["variants"] for m in modes):
        rows = [[[np.nan] * 3 if d is None else d for d in m["variants"]["measured"]["shape"]] for m in modes]
        measured = scale * np.moveaxis(np.array(rows, float), 0, -1)
    titles = []
    for m in modes:
        known = [m["variants"][k]["hz"] for k in ("updated", "initial", "measured") if k in m["variants"]]
        hz = next((h for h in known if h is not None), None)
        titles.append(m["label"] + (f"\n{hz:.3f} Hz" if hz is not None else ""))
    return titles, states, points, measured


def _planes(run: Run, wire: Wireframe) -> tuple[tuple[float, str, str], ...]:
    if not run.jacket:
        return ()
    low = float(wire.node_m[:, 2].min())
    planes = [(0.0, "sea level", "rgba(86,180,233,0.10)")]
    depth = run.campaign.water_depth_m if run.campaign else None
    if depth is not None and -depth > low:
        planes.append((-depth, "mudline", "rgba(160,130,90,0.14)"))
    return tuple(planes)
