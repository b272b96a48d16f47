"""Models to fill in, that run as they are: `template`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from probupdate.errors import InputError
from probupdate.io.files import read_text, write_arrays, write_text
from probupdate.io.result_table import table_of
from probupdate.modal.modes import Sensor
from probupdate.structure.load import load_model, model_sensors
from probupdate.structure.matrices import channel_places

if TYPE_CHECKING:
    import pandas as pd

KINDS = ("monopile", "jacket", "tower", "matrices")
# kinds whose fatigue is assessed
WITH_WAVES = ("monopile", "jacket")
# of the matrices' example: floors of a building on a plan, storey stiffness along x and y and in torsion
N_FLOOR, STOREY_M, PLAN_M = 5, 3.5, (12.0, 8.0)
FLOOR_KG, ALONG_X_NPM, ALONG_Y_NPM = 6.0e4, 9.0e7, 6.0e7


@dataclass(frozen=True, kw_only=True)
class Template:
    """The files that were written, the model's first."""

    kind: str
    files: tuple[Path, ...]

    @property
    def summary(self) -> str:
        model = self.files[0]
        lines = [f"{self.kind}: a model that runs as it is: 'probupdate modes {model}'; fill in your own numbers"]
        if self.files[-1].name == "campaign.toml":
            folder = self.files[-1].parent
            lines.append(f"with records in {folder}: 'probupdate identify {folder} --model {model} --out "
                         f"{model.with_name('modes.json')}'")
        return "\n".join(lines)

    def to_frame(self) -> pd.DataFrame:
        """A row a file."""
        return table_of([{"file": str(path)} for path in self.files])


def template(kind: str, out: str | Path) -> Template:
    """Write a model of a kind ('monopile', 'jacket', 'tower' or 'matrices'): into the folder `out`, with a
    campaign.toml for its sensors and, of those at sea, loads and welds for `export --fatigue`; or where `out` ends in
    .toml (.npz of matrices) as that file alone. Raises InputError for another kind, or where a file of that name is
    there already."""
    if kind not in KINDS:
        raise InputError("kind", f"'{kind}' is not a template", f"choose from {', '.join(KINDS)}; a tripod or any "
                         "other structure comes as SubDyn files (docs/tutorials/openfast.md) or as matrices of a "
                         "program ('probupdate matrices', docs/howto/matrices.md)")
    out = Path(out)
    name = "model.npz" if kind == "matrices" else "model.toml"
    alone = out.suffix.lower() in (".toml", ".npz")
    if alone and out.suffix.lower() != Path(name).suffix:
        raise InputError(str(out), f"a model of kind {kind} is not written as {out.suffix}",
                         f"name a folder, or a file that ends in {Path(name).suffix}")
    model = out if alone else out / name
    table = [model.with_name("parameters.toml")] if kind == "matrices" else []
    campaign = () if alone else (out / "campaign" / "campaign.toml",)
    fatigue = [] if alone or kind not in WITH_WAVES else [out / "fatigue.toml"]
    for path in (model, *table, *fatigue, *campaign):
        if path.exists():
            raise InputError(str(path), "already exists", "name another place")
    if kind == "matrices":
        write_arrays(model, example_matrices())
        write_text(table[0], _packaged_text("parameters.toml"))
        sensors = channel_places(load_model(model))
    else:
        write_text(model, _packaged_text(f"{kind}.toml"))
        sensors = model_sensors(model) or ()
    for path in fatigue:
        write_text(path, _packaged_text("fatigue.toml") + _packaged_text(f"details_{kind}.toml"))
    for path in campaign:
        write_text(path, campaign_text(kind, sensors))
    return Template(kind=kind, files=(model, *table, *fatigue, *campaign))


def _packaged_text(name: str) -> str:
    return read_text(Path(__file__).resolve().parents[1] / "templates" / name)


def campaign_text(kind: str, sensors: Sequence[Sensor]) -> str:
    """campaign.toml of a model's own sensors."""
    lines = [
        "# What was measured, where, in which units: the sensors are the model's, the rest is to be filled in. Records",
        "# go into acceleration/*.h5 beside this file (docs/formats/campaign.md; 'probupdate convert' writes them from",
        "# other formats), ten-minute statistics of the turbine into scada.csv.",
        f'name = "{kind}, first campaign"',
        "sampling_rate_hz = 25.0",
        "block_minutes = 30",
        "",
        "# One table a channel, in column order; position_m in the model's axes, direction a unit vector. Units: m/s2,",
        "# also cm/s2, mm/s2, g, mg; of quantity velocity m/s, cm/s, mm/s; of displacement m, cm, mm.",
    ]
    for s in sensors:
        lines += [
            "[[sensor]]",
            f'channel = "{s.channel}"',
            f'level = "{s.level or f"{s.position_m[2]:g} m"}"',
            f"position_m = {[float(x) for x in s.position_m]}",
            f"direction = {[float(x) for x in s.direction]}",
            'quantity = "acceleration"',
            'unit = "m/s2"',
        ]
    return "\n".join(lines) + "\n"


def example_matrices() -> dict[str, np.ndarray]:
    """A building of N_FLOOR rigid floors, each moving along x at its middle and along y at either end: K(theta) = K0 +
    storeys_x K_storeys_x + storeys_y K_storeys_y in N/m, M likewise in kg."""
    chain = 2.0 * np.eye(N_FLOOR) - np.eye(N_FLOOR, k=1) - np.eye(N_FLOOR, k=-1)
    chain[-1, -1] = 1.0
    width, depth = PLAN_M
    # what the three make of the floor's translation along x and y and its rotation about z
    motion = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.0, -1.0 / width, 1.0 / width]])
    # walls stand at the edges: along x at half the depth in y, along y at half the width in x
    along_x, along_y = np.diag([1.0, 0.0, depth**2 / 4]), np.diag([0.0, 1.0, width**2 / 4])
    mass = np.diag([1.0, 1.0, (width**2 + depth**2) / 12])
    n, floors = 3 * N_FLOOR, range(N_FLOOR)

    def per_floor(between: np.ndarray, one: np.ndarray) -> np.ndarray:
        return np.kron(between, motion.T @ one @ motion)

    return {
        "K0": np.zeros((n, n)), "K_storeys_x": per_floor(chain, ALONG_X_NPM * along_x),
        "K_storeys_y": per_floor(chain, ALONG_Y_NPM * along_y),
        "M0": np.zeros((n, n)), "M_floors": per_floor(np.eye(N_FLOOR), FLOOR_KG * mass),
        "channel": np.array([f"F{k + 1}-{name}" for k in floors for name in ("x", "y-left", "y-right")]),
        "channel_dof": np.arange(n),
        "node_position_m": np.array([[x, 0.0, STOREY_M * (k + 1)] for k in floors for x in (0, -width / 2, width / 2)]),
        "dof_node": np.arange(n), "dof_direction": np.tile([0, 1, 1], N_FLOOR),
        "line": np.array([[a, a + step] for a in range(n) for step in (3,) if a + step < n]
                         + [[3 * k, 3 * k + end] for k in floors for end in (1, 2)]),
    }
