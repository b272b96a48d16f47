"""The data of the mode viewer: a wireframe with the measured, initial and updated shape of every mode."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.modal.modes import Sensor, rotate_to_real
from probupdate.modal.sensor_places import sensors_by_place
from probupdate.model.interface import Wireframe

STATE_NAMES = {"measured": "measured", "initial": "initial model", "updated": "updated model"}


@dataclass(frozen=True, eq=False, kw_only=True)
class ShapedModes:
    """Modes of one state of the model, in the measured modes' order: frequency_hz (n_mode,), shape at the sensors
    (n_channel, n_mode) and displacement of the wireframe's nodes (n_node, 3, n_mode); NaN where there is none."""

    frequency_hz: np.ndarray
    shape: np.ndarray
    displacement: np.ndarray


def align(measured: np.ndarray, computed: np.ndarray, groups: Sequence[tuple[int, ...]]) -> np.ndarray:
    """T (n_mode, n_mode) such that computed @ T lies closest to the real measured shapes, mode by mode or, for
    modes grouped as a close pair, within their plane. Both (n_channel, n_mode); identity where nothing is measured."""
    turn = np.eye(measured.shape[1])
    for group in groups:
        columns = list(group)
        ok = np.all(np.isfinite(measured[:, columns]), axis=1) & np.all(np.isfinite(computed[:, columns]), axis=1)
        if ok.sum() < len(columns):
            continue
        solved, *_ = np.linalg.lstsq(computed[np.ix_(ok, columns)], measured[np.ix_(ok, columns)], rcond=None)
        if np.all(np.isfinite(solved)) and np.linalg.matrix_rank(solved) == len(columns):
            turn[np.ix_(columns, columns)] = solved
    return turn


def sensor_points(sensors: Sequence[Sensor]) -> tuple[np.ndarray, list[list[int]]]:
    """Positions (n_point, 3) where there are sensors and the channels at each."""
    places = sensors_by_place(sensors)
    return np.array([sensors[there[0]].position_m for there in places]).reshape(-1, 3), places


def viewer_data(
    wire: Wireframe,
    labels: Sequence[str],
    states: Mapping[str, ShapedModes],
    *,
    measured_hz: np.ndarray | None = None,
    measured_shape: np.ndarray | None = None,
    sensors: Sequence[Sensor] = (),
    pairs: Sequence[tuple[int, ...]] = (),
    names: Mapping[str, str] | None = None,
    planes: Sequence[tuple[float, str, str]] = (),
) -> dict:
    """JSON-ready values for viewer.js.

    states: "initial" and "updated" -> ShapedModes; measured_shape (n_channel, n_mode) complex, rows in the
    sensors' order; planes: (z_m, name, colour). Every state is scaled to the measured shape at the sensors (the
    model's own shapes scaled to one largest displacement), so that what differs between them is the shape.
    """
    real = None if measured_shape is None else np.real(rotate_to_real(measured_shape))
    drawn = _rotate_shapes(states, real, len(labels), pairs)
    points, channels = sensor_points(sensors)
    modes = []
    for j, label in enumerate(labels):
        moved = None if real is None else _points_displacement(real[:, j], sensors, channels)
        hz = {key: state.frequency_hz[j] for key, state in states.items()}
        if measured_hz is not None:
            hz["measured"] = measured_hz[j]
        variants = _variants({key: d[:, :, j] for key, d in drawn.items()}, moved, hz)
        modes.append({"label": label, "name": (names or {}).get(label, ""), "variants": variants})
    extent = np.ptp(wire.node_m, axis=0)
    wide = bool(extent[2] < 0.5 * extent[:2].max())
    present = [k for k in ("measured", "initial", "updated") if any(k in m["variants"] for m in modes)]
    return {
        "nodes": [_round_list(p, 3) for p in wire.node_m],
        "lines": [[int(i), int(j)] for i, j in wire.line],
        "groups": list(wire.line_group),
        "sensors": [_round_list(p, 3) for p in points],
        "states": [{"key": k, "name": STATE_NAMES[k]} for k in present],
        "modes": modes,
        "scale": round(float(0.12 * extent.max()), 4),
        "wide": wide,
        "planes": [{"z": z, "name": name, "color": color} for z, name, color in planes],
    }


def _rotate_shapes(
    states: Mapping[str, ShapedModes], measured: np.ndarray | None, n_mode: int, pairs: Sequence[tuple[int, ...]]
) -> dict[str, np.ndarray]:
    """Displacements (n_node, 3, n_mode) of every state, turned onto the real measured shapes where there are any."""
    paired = {j for group in pairs for j in group}
    groups = [tuple(g) for g in pairs] + [(j,) for j in range(n_mode) if j not in paired]
    drawn = {}
    for key, modes in states.items():
        usable = np.all(np.isfinite(modes.displacement), axis=(0, 1))
        turn = np.eye(n_mode) if measured is None else align(measured, modes.shape, groups)
        turn = np.where(usable[:, None] & usable[None, :], turn, 0.0)
        turned = np.einsum("ndi,ij->ndj", np.nan_to_num(modes.displacement), turn)
        drawn[key] = np.where(usable, turned, np.nan)
    return drawn


def _variants(
    drawn: Mapping[str, np.ndarray], moved: list[tuple[float, ...] | None] | None, hz: Mapping[str, float]
) -> dict[str, dict]:
    """One mode as measured (motion at every sensor point, or None) and in every state (n_node, 3), with its frequency;
    all over the largest displacement of any, so that they are drawn in one scale."""
    size = max((_largest(d) for d in drawn.values()), default=0.0)
    size = max(size, max((_largest(np.array(d)) for d in moved or () if d is not None), default=0.0)) or 1.0
    variants: dict[str, dict] = {}
    if moved is not None:
        shape = [None if d is None else _round_list(np.array(d) / size) for d in moved]
        variants["measured"] = {"hz": _hz_or_none(hz.get("measured")), "shape": shape}
    for key, d in drawn.items():
        variants[key] = {"hz": _hz_or_none(hz[key]),
                         "shape": [_round_list(row) for row in d / size] if np.all(np.isfinite(d)) else None}
    return variants


def _hz_or_none(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 5)


def _largest(rows: np.ndarray) -> float:
    lengths = np.linalg.norm(np.nan_to_num(np.atleast_2d(rows)), axis=1)
    return float(lengths.max()) if lengths.size else 0.0


def _round_list(values: Iterable[float], decimals: int = 4) -> list[float]:
    return [round(float(v), decimals) for v in values]


def _points_displacement(
    shape: np.ndarray, sensors: Sequence[Sensor], channels: list[list[int]]
) -> list[tuple[float, ...] | None]:
    """Displacement vector at every sensor point from the channels there; None where no channel was measured."""
    moved: list[tuple[float, ...] | None] = []
    for rows in channels:
        rows = [k for k in rows if np.isfinite(shape[k])]
        if not rows:
            moved.append(None)
            continue
        ways = np.array([sensors[k].direction for k in rows])
        # least squares of least norm: a direction without a channel stays at rest
        vector, *_ = np.linalg.lstsq(ways, shape[rows], rcond=None)
        moved.append(tuple(vector))
    return moved
