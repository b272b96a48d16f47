"""The page on which poles are looked at and chosen: stabilisation diagrams of stored blocks, shapes, MAC; reads no
records."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial.distance import cdist

from probupdate.errors import InputError
from probupdate.identification.block_poles import BlockPoles
from probupdate.identification.block_store import choice_head, stored_block, stored_std
from probupdate.io.files import write_text
from probupdate.io.result_table import plural
from probupdate.modal.mode_choice import FORMAT, ModeChoice
from probupdate.modal.modes import ModalData, ModalSet, Sensor, modal_phase_collinearity, rotate_to_real
from probupdate.model.interface import Wireframe
from probupdate.reporting.elements import Column, Items, Panel, Section, Table, Text, Viewer
from probupdate.reporting.figures_identification import STEADINESS
from probupdate.reporting.identification_pictures import UNITS, bands, steadiness
from probupdate.reporting.page import render
from probupdate.reporting.viewer import sensor_points
from probupdate.runtime.progress import Progress, silent

# of the blocks' values in the page; with style, script and geometry it stays below 8 MB
MOST_BYTES = 6_000_000
# numbers by which a model's nodes follow the sensors
MOST_NUMBERS = 300_000
# a model's modes that a measured shape is continued by, and singular values of these at the sensors that say nothing
EXPANSION_MODES, EXPANSION_RANK = 8, 0.1
REASONS = ("noise, no mode of the structure", "harmonic of a rotor or machine", "waves or wind",
           "double of another mode", "another order is better")


@dataclass(frozen=True, eq=False, kw_only=True)
class PoleSource:
    """What the page is made of. folder: of stored blocks; ids: of those that have poles; first: the one that it opens
    with; modes, table: modes.json with its table of poles, None without; proposed: (model order, index) -> label of the
    poles of the first block that would be modes, where there is no table; std: (model order, index) -> standard
    deviations of frequency (Hz) and damping ratio, of the first block; sensors: of the channels, () where unknown;
    wire with the displacement of modes at its nodes, and `at_sensors` (n_channel, n_mode) the same modes there."""

    title: str
    folder: Path
    ids: tuple[str, ...]
    first: str
    modes: ModalData | None = None
    table: pd.DataFrame | None = None
    proposed: Mapping[tuple[int, int], str] = field(default_factory=dict)
    std: Mapping[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    sensors: tuple[Sensor, ...] = ()
    wire: Wireframe | None = None
    at_sensors: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    @property
    def choice(self) -> ModeChoice | None:
        """What modes.json was made of, where poles were picked by hand."""
        return None if self.modes is None else self.modes.choice


def write_explorer(source: PoleSource, out: str | Path, progress: Progress = silent) -> tuple[Path, int]:
    """The page at `out`, and how many blocks are in it: all, or as many, evenly over the record, as a page holds."""
    blocks = _chosen_blocks(source, progress)
    head = choice_head(source.folder, [b["id"] for b in blocks])
    for values, own in zip(blocks, head["blocks"], strict=True):
        values["head"] = own
    channels = [words.rsplit(" [", 1)[0] for words in head["channels"]]
    data = {
        "format": FORMAT, "head": {"channels": head["channels"], "settings": head["settings"]}, "channels": channels,
        "blocks": blocks, "first": source.first, "highest_hz": round(head["settings"]["target_rate_hz"] / 2, 6),
        "steadiness": list(STEADINESS), "reasons": REASONS, "unit": blocks[0]["unit"],
    }
    viewer = None
    if source.sensors:
        viewer, matrices = _geometry(source)
        data |= matrices
    few = [] if len(blocks) == len(source.ids) else [
        f"{len(blocks)} of {len(source.ids)} blocks are in this page, evenly over the record: all would be too large a "
        "page; `--block ID` opens it with another one"]
    page = render(_sections(source, data, viewer, [*few, *source.notes]), title=source.title,
                  subtitle=f"{plural(len(channels), 'channel')}, {plural(len(blocks), 'block')}, order "
                  f"{head['settings']['order']}, {head['settings']['target_rate_hz']:g} Hz",
                  kicker="Poles and modes",
                  footer="Written by probupdate. This page needs no network and no other file.",
                  scripts=("viewer.js", "explore.js", "page.js"), styles=("page.css", "explore.css"))
    return write_text(Path(out), page), len(blocks)


def _sections(source: PoleSource, data: dict, viewer: dict | None, notes: Sequence[str]) -> list[Section]:
    settings = data["head"]["settings"]
    shown = ("Drag turns, after a click the wheel zooms; arrow keys and space work too. Circles: the sensors as they "
             "move in the mode, its complex shape turned once a period. "
             + ("The model's members follow by its own lowest modes (least squares at the sensors)." if source.wire
                else "Lines join neighbouring sensors."))
    shapes = (Viewer(data=viewer, caption=shown),) if viewer is not None else (
        Text(paragraphs=("The sensors' places are not known here, so shapes are not drawn: give --campaign.",)),)
    return [
        Section(anchor="poles", title="Stabilisation diagram", shown=1, lead="Click a pole to pick it as a mode, or "
                "move to it by tab and arrow keys: Enter picks, Delete rejects, again takes back.", items=(
                    Panel(names=("controls", "diagram", "legend", "counted", "message", "notes"), data=data),)),
        Section(anchor="choice", title="Choice", shown=2, items=(
            Panel(names=("save", "list", "mac")),
            Text(paragraphs=("The saved file is for identify: probupdate identify CAMPAIGN --choice choice.json --out "
                             "modes.json makes the picked poles the modes, follows them through the other blocks, and "
                             "keeps the choice in modes.json.",)))),
        Section(anchor="shapes", title="Shapes", shown=3, items=(
            Panel(names=("shown",)), *shapes, Panel(names=("argand",)))),
        Section(anchor="record", title="What this page was made of", shown=1 if notes else 0, items=(
            *((Items(title="Notes", statements=tuple(notes)),) if notes else ()),
            Table(caption="Settings of identification", columns=(Column(name="setting", number=False),
                                                                 Column(name="value", number=False)),
                  rows=tuple((name, f"{value:g}" if isinstance(value, float) else str(value))
                             for name, value in settings.items())))),
    ]


def _chosen_blocks(source: PoleSource, progress: Progress) -> list[dict]:
    first = _block_values(source, source.first)
    size = len(json.dumps(first))
    most = max(int(MOST_BYTES / (1.2 * size)), 1)
    others = [one for one in source.ids if one != source.first]
    if len(others) > most - 1:
        evenly = {others[k] for k in np.linspace(0, len(others) - 1, most - 1).astype(int)}
        # those in which something was chosen before are there in any case
        before = [] if source.choice is None else [b.id for b in source.choice.blocks if b.id in others]
        others = [*before, *(one for one in others if one in evenly and one not in before)]
    found = []
    for number, one in enumerate(others):
        progress("blocks of the page", number, len(others))
        values = _block_values(source, one)
        size += len(json.dumps(values))
        if size > 1.1 * MOST_BYTES:
            break
        found.append(values)
    progress("blocks of the page", len(others), len(others))
    return sorted([first, *found], key=lambda values: source.ids.index(values["id"]))


def _block_values(source: PoleSource, block_id: str) -> dict:
    """One block as explore.js reads it: a list a quantity, with an entry a pole."""
    block = stored_block(source.folder, block_id)
    if block is None or block.poles is None:
        raise InputError(f"block {block_id}", f"has no poles in {source.folder}", "name another, or identify again")
    every = sorted(block.every_order, key=lambda p: p.order)
    keys = [(p.order, k) for p in every for k in range(len(p.frequency_hz))]
    shape = rotate_to_real(np.concatenate([p.shape for p in every], axis=1))
    shape = shape / np.maximum(np.abs(shape).max(axis=0), 1e-300)
    hz, damping = (np.concatenate([getattr(p, of) for p in every]) for of in ("frequency_hz", "damping_ratio"))
    steady: list[str] = []
    for before, now in zip([None, *every[:-1]], every, strict=True):
        steady += steadiness(before, now)
    words, label = _judge_poles(source, block, keys, hz)
    listed = list(dict.fromkeys(words))
    std = source.std if block_id == source.first and source.std else stored_std(source.folder, block_id)
    modal = None if source.modes is None else next((s for s in source.modes.sets if s.id == block_id), None)
    named = _identified_modes(source, modal) if modal is not None else [
        [name, _significant(hz[keys.index(key)])] for key, name in source.proposed.items()]
    kinds = list(STEADINESS)
    return {
        "id": block_id, "unit": UNITS[block.quantity], "chosen_order": block.poles.order, "notes": list(block.notes),
        "order": [order for order, _ in keys], "index": [k for _, k in keys], "hz": [_significant(f, 12) for f in hz],
        "damping": [_significant(z, 9) for z in damping],
        "mpc": [round(float(x), 4) for x in modal_phase_collinearity(shape)],
        "steady": [kinds.index(one) for one in steady], "word": [listed.index(one) for one in words], "words": listed,
        "mode": label, "chosen": _earlier_choice(source, block_id, keys, hz),
        "hz_std": [_std_values(std, key, 0) for key in keys], "damping_std": [_std_values(std, key, 1) for key in keys],
        # a number a channel as two 16-bit integers: a thousandth of what a shape is known to
        "shape": base64.b64encode(np.rint(32767 * np.stack([shape.T.real, shape.T.imag], axis=-1)).clip(
            -32767, 32767).astype("<i2").tobytes()).decode(),
        "line_hz": float(block.line_hz[1]) if len(block.line_hz) > 1 else 1.0, "singular": bool(block.singular.size),
        "lines": _decibels(block.singular if block.singular.size else block.spectrum[None]),
        "bands": [] if modal is None else [[name, *ends] for name, ends in bands(modal).items()], "modes": named,
    }


def _decibels(density: np.ndarray) -> list[list[float | None]]:
    """Rows of spectral densities in dB, None for zero."""
    with np.errstate(divide="ignore"):
        level = np.round(10 * np.log10(density), 1)
    return [[float(v) if np.isfinite(v) else None for v in row] for row in level]


def _identified_modes(source: PoleSource, modal: ModalSet) -> list[list]:
    """Labels and frequencies of the modes of a block's set."""
    labels = source.modes.labels if source.modes is not None and source.modes.labels else [
        str(k + 1) for k in range(len(modal.frequency_hz))]
    return [[name, _significant(f)] for name, f in zip(labels, modal.frequency_hz, strict=True) if np.isfinite(f)]


def _judge_poles(
    source: PoleSource, block: BlockPoles, keys: Sequence[tuple[int, int]], hz: np.ndarray
) -> tuple[list[str], list[str]]:
    """What identification says of each pole, and the label of the mode that it stands for; '' where nothing."""
    words, label = [""] * len(keys), [""] * len(keys)
    for key, name in (source.proposed.items() if source.table is None else ()):
        words[keys.index(key)], label[keys.index(key)] = f"identified as {name}", name
    if source.table is None:
        return words, label
    rows = source.table[source.table["time"] == block.start.tz_convert(None)]
    orders = np.array([order for order, _ in keys])
    reason = rows["reason"].fillna("") if "reason" in rows else [""] * len(rows)
    for f, order, criterion, mode, why in zip(*(rows[of] for of in ("frequency_hz", "order", "criterion", "mode")),
                                              reason, strict=True):
        near = np.where(orders == order, np.abs(hz / f - 1), np.inf)
        k = int(np.argmin(near))
        if near[k] < 1e-4:
            kept = criterion == "kept"
            words[k] = f"identified as {mode}" if kept else f"by identify: {criterion}" + (f", {why}" if why else "")
            label[k] = str(mode) if kept else ""
    return words, label


def _earlier_choice(
    source: PoleSource, block_id: str, keys: Sequence[tuple[int, int]], hz: np.ndarray
) -> list[tuple[int, str, str]]:
    """What was chosen before, where modes.json is of a choice: the pole's place, picked or rejected, the reason."""
    if source.choice is None:
        return []
    place, found = {key: k for k, key in enumerate(keys)}, []
    for what, poles in (("picked", source.choice.picked), ("rejected", source.choice.rejected)):
        for p in poles:
            k = place.get((p.order, p.index)) if p.block == block_id else None
            if k is not None and abs(hz[k] / p.frequency_hz - 1) < 1e-4:
                found.append((k, what, p.reason))
    return found


def _std_values(std: Mapping[tuple[int, int], tuple[float, float]], key: tuple[int, int], which: int) -> float | None:
    value = std.get(key, (np.nan, np.nan))[which]
    return _significant(value, 3) if np.isfinite(value) else None


def _significant(value: float, digits: int = 6) -> float:
    return float(f"{value:.{digits}g}")


def _geometry(source: PoleSource) -> tuple[dict, dict]:
    """What viewer.js draws before a mode is shown, and the matrices (n_row, n_channel) by which the sensors' points and
    the lines' nodes, three rows each, follow a shape."""
    points, places = sensor_points(source.sensors)
    at_points = np.zeros((3 * len(points), len(source.sensors)))
    for number, rows in enumerate(places):
        ways = np.array([source.sensors[k].direction for k in rows])
        at_points[3 * number : 3 * number + 3, rows] = np.linalg.pinv(ways, rcond=1e-6)
    wire, at_sensors = source.wire, source.at_sensors
    if (wire is not None and wire.displacement is not None and at_sensors is not None
            and 3 * len(wire.node_m) * len(source.sensors) <= MOST_NUMBERS):
        nodes, lines, groups = wire.node_m, wire.line, list(wire.line_group)
        at_nodes = wire.displacement.reshape(-1, at_sensors.shape[1]) @ np.linalg.pinv(at_sensors, rcond=EXPANSION_RANK)
    else:
        nodes, lines, at_nodes = points, neighbours(points), at_points
        groups = [""] * len(lines)
    extent = np.ptp(nodes, axis=0)
    return {
        "nodes": np.round(nodes, 3).tolist(), "lines": np.asarray(lines, int).tolist(), "groups": groups,
        "sensors": np.round(points, 3).tolist(), "states": [{"key": "measured", "name": "measured"}],
        "modes": [{"label": "", "name": "", "variants": {}}], "scale": round(0.12 * float(extent.max()) or 1.0, 4),
        "wide": bool(extent[2] < 0.5 * extent[:2].max()), "planes": [],
    }, {"node_matrix": np.round(at_nodes, 4).tolist(), "point_matrix": np.round(at_points, 4).tolist()}


def neighbours(points: np.ndarray) -> np.ndarray:
    """(n_point - 1, 2) numbers of points that the shortest lines join which connect all."""
    tree = csgraph.minimum_spanning_tree(sparse.csr_array(cdist(points, points))).tocoo()
    return np.column_stack([tree.row, tree.col])


def expansion_modes(n_channel: int, available: int) -> int:
    """How many of a model's modes measured shapes are continued by."""
    return max(1, min(EXPANSION_MODES, n_channel, available))
