"""Universal files (UFF): modes as dataset 55, records as dataset 58, places of nodes as 15 or 2411, through `pyuff`.

A channel is a node and a direction. Where sensors are given, with their places, components at a node are projected on
their directions, so that oblique ones are as good as others; where none are, channels are called by node and axis, such
as '12:+x'. Modes are written with six digits and without standard deviations, as the format has no more. Units are SI.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from probupdate.campaign.stated import LENGTHS, ChannelStatement
from probupdate.campaign.uff_axes import NODES, SYSTEMS, UNITS, Geometry, geometry, number_of, whole_of
from probupdate.errors import InputError, parsing
from probupdate.io.files import input_file, written_whole
from probupdate.modal.modes import ModalData, ModalSet, Sensor
from probupdate.runtime.arrays import frozen_array

# read whole, with three copies in memory
LARGEST = 2**30
# how far a node may be from the sensor it is taken for, and how far the lines of a file may be from one rate
SAME_PLACE_M, SAME_RATE = 1e-3, 1e-4
AXES = {1: "+x", 2: "+y", 3: "+z", -1: "-x", -2: "-y", -3: "-z"}
# rotations about them
ROTATIONS = (4, 5, 6, -4, -5, -6)
# datasets 58 that are records in time, and the code of each quantity
RECORD, TIME = 1, 17
QUANTITIES = {"displacement": 8, "velocity": 11, "acceleration": 12}
# what else an ordinate may be; 0 and 1 (unknown, general) say nothing
OTHER_QUANTITIES = {2: "stress", 3: "strain", 5: "a temperature", 6: "a heat flux", 9: "a reaction force",
                    13: "an excitation force", 15: "a pressure", 16: "a mass", 17: "time", 18: "a frequency",
                    19: "a rotational speed", 20: "an order"}
SET_LINE, CHANNEL_LINE = "set ", "channel "
# analyses of dataset 55 that hold modes
NORMAL, COMPLEX = 2, (3, 7)


@dataclass(frozen=True, eq=False, kw_only=True)
class UffRecords:
    """Records of one file on one clock: data (n_sample, n_channel) float64, `names` from the files' first lines or ''
    where they have none, `places` such as '12:+x', rate_hz and first_s, where the abscissa begins; stated: the
    quantity, unit and direction that the file gives each."""

    names: tuple[str, ...]
    places: tuple[str, ...]
    stated: tuple[ChannelStatement, ...]
    rate_hz: float
    first_s: float
    data: np.ndarray


def _pyuff(where: Path) -> ModuleType:
    try:
        return import_module("pyuff")
    except ImportError:
        raise InputError(
            str(where), "universal files need the package pyuff, which is not installed", "pip install probupdate[uff]"
        ) from None


def _read_datasets(path: str | Path) -> tuple[Path, list[dict]]:
    """Every dataset that pyuff reads."""
    path = input_file(path, "check the path", largest=LARGEST)
    pyuff = _pyuff(path)
    said = str(path), "cannot be read as a universal file", "write it again, as ASCII or binary UFF"
    with parsing(*said), warnings.catch_warnings():
        # what numpy warns of while text becomes numbers is not a number
        warnings.simplefilter("error")
        file = pyuff.UFF(str(path))
        kinds = [int(k) for k in file.get_set_types()]
        wanted = [k for k, kind in enumerate(kinds) if kind in (55, 58, *NODES, *SYSTEMS, UNITS)]
        found = [file.read_sets(k) for k in wanted]
        found = [d if isinstance(d, dict) else {} for d in found]
    return path, [d for d in found if d]


def _text(value) -> str:
    text = " ".join(str(value or "").split())
    return "" if text.upper() == "NONE" else text


# Modes --------------------------------------------------------------------------------------------------------------


def read_uff_modes(path: str | Path, sensors: Sequence[Sensor] | None = None) -> ModalData:
    """Modes of datasets 55 (normal modes and complex eigenvalues): one set a load case, its name as `write_uff_modes`
    leaves it, else the case's number. sensors: channels in that order, found by the places of the file's nodes; None:
    every component of every node that moves. Standard deviations are NaN. Raises InputError naming the file."""
    path, found = _read_datasets(path)
    modes = [d for d in found if d.get("type") == 55 and d.get("analysis_type") in (NORMAL, *COMPLEX)]
    if not modes:
        raise InputError(
            str(path),
            "holds no modes (dataset 55 of normal modes or complex eigenvalues)",
            "export the modes as dataset 55",
        )
    placed = geometry(path, found)
    rows = [_mode(d, placed, f"{path}, mode {k + 1}") for k, d in enumerate(modes)]
    nodes = sorted({node for row in rows for node in row["motion"]})
    if sensors is None:
        named, project = _components(nodes, rows)
    else:
        named, project = _project_on_sensors(path, placed.places, sensors)
    cases: dict[int, list[dict]] = {}
    for row in rows:
        cases.setdefault(row["case"], []).append(row)
    count = max(max(row["mode"] for row in own) for own in cases.values())
    if count > 10_000:
        raise InputError(str(path), f"numbers a mode {count}", "number them from 1 without gaps")
    sets, ids = [], []
    for case, own in cases.items():
        numbers = [row["mode"] for row in own]
        if len(set(numbers)) < len(numbers) or min(numbers) < 1:
            raise InputError(
                f"{path}, load case {case}", "mode numbers are not 1, 2, 3, ... once each", "number them so"
            )
        frequency, damping = np.full(count, np.nan), np.full(count, np.nan)
        shape = np.full((len(named), count), np.nan, complex)
        for row in own:
            j = row["mode"] - 1
            frequency[j], damping[j], shape[:, j] = row["hz"], row["damping"], project(row["motion"])
        ids.append(own[0]["set"] or str(case))
        sets.append(
            ModalSet(
                id=ids[-1],
                frequency_hz=frequency,
                damping_ratio=damping,
                shape=shape,
                frequency_std_hz=np.full(count, np.nan),
                shape_std=np.full(shape.shape, np.nan),
            )
        )
    if len(set(ids)) < len(ids):
        raise InputError(str(path), "two load cases have one name", "give each its own in line 4")
    return ModalData(channels=named, sets=tuple(sets))


def _mode(d: Mapping, placed: Geometry, where: str) -> dict:
    """One dataset 55: hz, damping ratio, case, mode, set's name, motion node -> (3,) complex in the file's axes."""
    if d["analysis_type"] == NORMAL:
        hz = number_of(d["freq"], where, "frequency")
        damping = number_of(d["modal_damp_vis"], where, "damping")
        if not 0 <= damping < 1:
            raise InputError(where, f"its viscous damping ratio is {damping:g}", "give a share of critical, below 1")
        # what is zero was not given
        damping = damping or np.nan
    else:
        pole = complex(*(number_of(part(d["eig"]), where, "eigenvalue") for part in (np.real, np.imag)))
        hz, damping = abs(pole) / (2 * np.pi), -pole.real / abs(pole) if pole else 0.0
    if not 0 < hz < 1e6:
        raise InputError(where, f"its frequency is {hz:g} Hz", "give eigenvalues in rad/s, frequencies in Hz")
    numbers, parts = np.atleast_1d(d.get("node_nums", ())), [np.atleast_1d(d.get(f"r{k}", ())) for k in (1, 2, 3)]
    if any(part.shape != numbers.shape for part in parts) or not numbers.size:
        raise InputError(where, "has not three components at every node", "export translations x, y, z")
    motion = np.array(parts, complex).T
    if not np.all(np.isfinite(motion)):
        raise InputError(where, "has components that are not numbers", "write it again")
    line = _text(d.get("id4"))
    return {
        "hz": hz,
        "damping": damping,
        "case": whole_of(d["load_case"], where, "load case"),
        "mode": whole_of(d["mode_n"], where, "mode number"),
        "set": line.removeprefix(SET_LINE) if line.startswith(SET_LINE) else "",
        "motion": {node: row @ placed.axes_at(node) for node, row in zip(
            (whole_of(n, where, "node") for n in numbers), motion, strict=True)},
    }


def _components(nodes: Sequence[int], rows: Sequence[Mapping]):
    """Channels 'node:+axis' of what moves in some mode, and a mode's values there."""
    chosen = [(n, k) for n in nodes for k in range(3) if any(n in r["motion"] and r["motion"][n][k] != 0 for r in rows)]

    def project(motion: Mapping[int, np.ndarray]) -> np.ndarray:
        return np.array([motion[n][k] if n in motion else np.nan for n, k in chosen], complex)

    return tuple(f"{n}:{AXES[k + 1]}" for n, k in chosen), project


def _project_on_sensors(path: Path, places: Mapping[int, np.ndarray], sensors: Sequence[Sensor]):
    """The sensors' channels and a mode's values there, by the node at each sensor's place."""
    if not places:
        raise InputError(
            str(path),
            "has no node coordinates (dataset 15 or 2411)",
            "export the nodes too, or read it without sensors",
        )
    numbers, at = list(places), np.array(list(places.values()))
    node = []
    for s in sensors:
        distance = np.linalg.norm(at - s.position_m, axis=1)
        if distance.min() > SAME_PLACE_M:
            raise InputError(
                f"{path}, {s.channel}",
                f"its nearest node, {numbers[int(distance.argmin())]}, is {distance.min():.3g} m away",
                "correct position_m, or the file's units (m, or those of dataset 164)",
            )
        node.append(numbers[int(distance.argmin())])

    def project(motion: Mapping[int, np.ndarray]) -> np.ndarray:
        return np.array(
            [motion[n] @ s.direction if n in motion else np.nan for n, s in zip(node, sensors, strict=True)]
        )

    return tuple(s.channel for s in sensors), project


def write_uff_modes(data: ModalData, sensors: Sequence[Sensor], path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """Datasets 15 and 55 (complex eigenvalues) of all sets, a load case each; what the format could not hold is
    listed beside the path. Raises InputError where a channel has no sensor, or two of one place cannot be distinguished
    from each other."""
    path = Path(path)
    pyuff, by_name = _pyuff(path), {s.channel: s for s in sensors}
    for channel in data.channels:
        if channel not in by_name:
            raise InputError(f"{path}, {channel}", "no sensor of the campaign has this name", "name the channels alike")
    chosen = [by_name[c] for c in data.channels]
    places, rows = _nodes(chosen)
    inverse = [np.linalg.pinv(np.array([chosen[k].direction for k in own])) for own in rows]
    for own, back in zip(rows, inverse, strict=True):
        directions = np.array([chosen[k].direction for k in own])
        if np.abs(directions @ back - np.eye(len(own))).max() > 1e-6:
            raise InputError(
                f"{path}, {chosen[own[0]].channel}",
                "and others at its place are not independent: a node has three components",
                "leave one of them out",
            )
    datasets, notes = [_node_dataset(pyuff, places)], []
    for case, one in enumerate(data.sets, 1):
        for j in range(one.frequency_hz.size):
            values = one.shape[:, j]
            if not np.isfinite(one.frequency_hz[j]) or not np.all(np.isfinite(values)):
                notes.append(f"set {one.id}, mode {j + 1}: not measured at all channels, left out")
                continue
            motion = np.array([back @ values[own] for own, back in zip(rows, inverse, strict=True)])
            zeta = one.damping_ratio[j] if np.isfinite(one.damping_ratio[j]) else 0.0
            pole = 2 * np.pi * one.frequency_hz[j] * (-zeta + 1j * np.sqrt(1 - zeta**2))
            datasets.append(
                pyuff.prepare_55(
                    id1="modes",
                    id2="NONE",
                    id3="NONE",
                    id4=f"{SET_LINE}{one.id}"[:80],
                    id5="NONE",
                    model_type=1,
                    analysis_type=COMPLEX[0],
                    data_ch=2,
                    spec_data_type=8,
                    data_type=5,
                    n_data_per_node=3,
                    r1=motion[:, 0],
                    r2=motion[:, 1],
                    r3=motion[:, 2],
                    load_case=case,
                    mode_n=j + 1,
                    eig=complex(pole),
                    modal_a=0j,
                    modal_b=0j,
                    node_nums=np.arange(1, len(places) + 1),
                )
            )
    notes.append("standard deviations, covariances and environment have no place in a universal file")
    return _write(pyuff, datasets, path), tuple(notes)


# Records ------------------------------------------------------------------------------------------------------------


def read_uff_records(path: str | Path) -> UffRecords:
    """Records in time (datasets 58) of one file, on one clock. Raises InputError naming the file where it has none, or
    they are uneven, of several rates or lengths."""
    path, found = _read_datasets(path)
    records = [d for d in found if d.get("type") == 58 and d.get("func_type") == RECORD]
    if not records:
        raise InputError(str(path), "holds no record in time (dataset 58 of function type 1)", "export time histories")
    placed = geometry(path, found)
    names, places, columns, clocks, stated = [], [], [], [], []
    for k, d in enumerate(records, 1):
        where = f"{path}, record {k}"
        if whole_of(d.get("abscissa_spacing", 0), where, "abscissa spacing") != 1:
            raise InputError(where, "is not sampled at equal time steps (uneven spacing)", "export even spacing")
        step = number_of(d.get("abscissa_inc", 0), where, "time step")
        if not 1e-9 < step < 1e9:
            raise InputError(where, f"its time step is {step:g} s", "give seconds")
        node, direction = (whole_of(d.get(key, 0), where, key) for key in ("rsp_node", "rsp_dir"))
        values = np.atleast_1d(d.get("data", ()))
        if np.iscomplexobj(values) or values.ndim != 1 or not values.size:
            raise InputError(where, "is not a row of real numbers", "export time histories")
        line = _text(d.get("id1"))
        names.append(line.removeprefix(CHANNEL_LINE))
        places.append(f"{node}:{AXES.get(direction, direction)}")
        stated.append(_ordinate_statement(d, placed, node, direction))
        columns.append(np.asarray(values, float))
        clocks.append((step, number_of(d.get("abscissa_min", 0), where, "first time"), values.size))
    step, first, size = clocks[0]
    for k, (other, start, n) in enumerate(clocks[1:], 2):
        if abs(other / step - 1) > SAME_RATE or abs(start - first) > 0.5 * step or n != size:
            raise InputError(
                f"{path}, record {k}",
                f"has {n} samples every {other:g} s from {start:g} s, the first {size} "
                f"every {step:g} s from {first:g} s",
                "write only records of equal start, rate and length into one file",
            )
    return UffRecords(
        names=tuple(names),
        places=tuple(places),
        stated=tuple(stated),
        rate_hz=1 / step,
        first_s=first,
        data=frozen_array(np.column_stack(columns)),
    )


def _ordinate_statement(d: Mapping, placed: Geometry, node: int, direction: int) -> ChannelStatement:
    """What a dataset 58 says of its ordinate; a motion without a unit's name is in the file's units of length and s."""
    code = whole_of(d.get("ordinate_spec_data_type", 0), "dataset 58", "kind of ordinate")
    quantity = next((q for q, own in QUANTITIES.items() if own == code), OTHER_QUANTITIES.get(code))
    if direction in ROTATIONS:
        quantity = f"rotation ({quantity or 'motion'} about {AXES[int(np.sign(direction)) * (abs(direction) - 3)]})"
    unit = _text(d.get("ordinate_axis_units_lab"))
    if not unit and quantity in QUANTITIES and placed.length_m is not None:
        name = next((n for n, size in LENGTHS.items() if abs(size / placed.length_m - 1) < 1e-6), None)
        unit = "" if name is None else name + {"displacement": "", "velocity": "/s", "acceleration": "/s2"}[quantity]
    along = None
    if direction in AXES:
        along = frozen_array(np.sign(direction) * placed.axes_at(node)[abs(direction) - 1])
    return ChannelStatement(quantity=quantity, unit=unit or None, direction=along)


def write_uff_records(
    data: np.ndarray, rate_hz: float, sensors: Sequence[Sensor], path: str | Path, *, start: str
) -> Path:
    """Datasets 15 and 58 of a record (n_sample, n_channel), its columns the sensors'; `start` (ISO 8601) in line 3.

    Raises InputError where a sensor does not look along an axis, or a sample is lost: the format knows neither."""
    path, data = Path(path), np.asarray(data)
    pyuff = _pyuff(path)
    places, rows = _nodes(sensors)
    datasets = [_node_dataset(pyuff, places)]
    node_of = {k: number for number, own in enumerate(rows, 1) for k in own}
    for k, s in enumerate(sensors):
        axis = int(np.argmax(np.abs(s.direction)))
        if abs(abs(s.direction[axis]) - 1) > 1e-6:
            raise InputError(
                f"{path}, {s.channel}",
                "does not look along x, y or z, as a record of a universal file does",
                "leave it out",
            )
        if not np.all(np.isfinite(data[:, k])):
            raise InputError(
                f"{path}, {s.channel}",
                f"has {int(np.sum(~np.isfinite(data[:, k])))} lost samples, which a universal file cannot mark",
                "write blocks without gaps",
            )
        datasets.append(
            {
                "type": 58,
                "binary": 0,
                "id1": f"{CHANNEL_LINE}{s.channel}"[:80],
                "id2": s.level[:80] or "NONE",
                "id3": start[:80],
                "func_type": RECORD,
                "func_id": k + 1,
                "load_case_id": 1,
                "rsp_node": node_of[k],
                "rsp_dir": (axis + 1) * (1 if s.direction[axis] > 0 else -1),
                "ref_node": 0,
                "ref_dir": 0,
                "abscissa_spacing": 1,
                "abscissa_spec_data_type": TIME,
                "abscissa_axis_lab": "time",
                "abscissa_axis_units_lab": "s",
                "ordinate_spec_data_type": QUANTITIES[s.quantity],
                "ordinate_axis_lab": s.quantity[:20],
                "ordinate_axis_units_lab": s.unit[:20],
                "orddenom_spec_data_type": 0,
                "data": np.asarray(data[:, k], float),
                "x": np.arange(len(data)) / rate_hz,
            }
        )
    return _write(pyuff, datasets, path)


def _nodes(sensors: Sequence[Sensor]) -> tuple[np.ndarray, list[list[int]]]:
    """Places (n_node, 3) of the sensors and the numbers of those at each."""
    places: list[np.ndarray] = []
    rows: list[list[int]] = []
    for k, s in enumerate(sensors):
        same = next((j for j, p in enumerate(places) if np.linalg.norm(p - s.position_m) <= SAME_PLACE_M), None)
        if same is None:
            places.append(s.position_m)
            rows.append([])
            same = -1
        rows[same].append(k)
    return np.array(places), rows


def _node_dataset(pyuff, places: np.ndarray) -> dict:
    n = len(places)
    none = np.zeros(n, int)
    return pyuff.prepare_15(
        node_nums=np.arange(1, n + 1),
        def_cs=none,
        disp_cs=none,
        color=none,
        x=places[:, 0],
        y=places[:, 1],
        z=places[:, 2],
    )


def _write(pyuff, datasets: Sequence[dict], path: Path) -> Path:
    with written_whole(path) as part:
        file = pyuff.UFF(str(part))
        for k, one in enumerate(datasets):
            file.write_sets(one, mode="add" if k else "overwrite")
    return path
