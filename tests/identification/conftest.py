"""A structure whose poles are known exactly, its records and campaigns of them.

Every mode is a complex coordinate q(t+1) = mu q(t) + w(t) with white w, and y = Re(shape q) + noise: an exact linear
system of order 2 n_mode (Eq. 1), with no discretisation between its poles and the samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import h5py
import numpy as np
import pandas as pd
import pytest
from scipy import signal

from probupdate.identification.reference import ReferenceModes
from probupdate.modal.modes import Sensor

RATE = 5.0
LABELS = ("FA1", "SS1", "T1", "FA2", "SS2")


def sensors() -> tuple[Sensor, ...]:
    """Eighteen channels as on the jacket: four legs with three directions, three tower levels with two."""
    found = []
    for leg, x, y in (("A", 3, 3), ("B", -3, 3), ("C", -3, -3), ("D", 3, -3)):
        for axis, direction in zip("xyz", np.eye(3), strict=True):
            found.append(Sensor(channel=f"TP-{leg}-{axis}", level="TP", position_m=(x, y, 13), direction=direction))
    for z in (18, 66, 90):
        for axis, direction in zip("xy", np.eye(3)[:2], strict=True):
            found.append(Sensor(channel=f"T{z}-{axis}", level=f"T{z}", position_m=(0, 0, z), direction=direction))
    return tuple(found)


def shapes() -> np.ndarray:
    """(18, 5): two bending pairs and a torsion of a column on the sea bed, largest component 1."""
    place = np.array([s.position_m for s in sensors()])
    way = np.array([s.direction for s in sensors()])
    z = (place[:, 2] + 38) / 128
    first, second = z**2, 3 * z**2 * (1 - 1.25 * z)
    pitch = 0.02
    columns = [
        way[:, 0] * first - way[:, 2] * place[:, 0] * pitch, way[:, 1] * first + way[:, 2] * place[:, 1] * pitch,
        (way[:, 1] * place[:, 0] - way[:, 0] * place[:, 1]) * z,
        way[:, 0] * second - way[:, 2] * place[:, 0] * pitch, way[:, 1] * second + way[:, 2] * place[:, 1] * pitch,
    ]
    table = np.column_stack(columns)
    return table / np.abs(table).max(axis=0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Structure:
    frequency_hz: np.ndarray
    damping_ratio: np.ndarray
    shape: np.ndarray
    strength: np.ndarray
    noise: float

    def eigenvalue(self, rate: float = RATE) -> np.ndarray:
        omega = 2 * np.pi * self.frequency_hz
        return np.exp((-self.damping_ratio + 1j * np.sqrt(1 - self.damping_ratio**2)) * omega / rate)

    def record(self, n: int, seed: int, rate: float = RATE, turn_deg: float = 0.0) -> np.ndarray:
        """(n, 18); turn_deg turns the directions of both bending pairs counter-clockwise."""
        rng = np.random.default_rng(seed)
        lead = 2000
        white = rng.standard_normal((n + lead, len(self.strength), 2)) @ np.array([1, 1j]) / np.sqrt(2)
        mu, shape = self.eigenvalue(rate), turned_pairs(self.shape, turn_deg)
        y = np.zeros((n, shape.shape[0]))
        for j, (value, strength) in enumerate(zip(mu, self.strength, strict=True)):
            scale = strength * np.sqrt(2 * (1 - abs(value) ** 2))  # so that Re q has the variance strength^2
            q = signal.lfilter([1.0], [1.0, -value], scale * white[:, j])[lead:]
            y += np.outer(q.real, shape[:, j])
        return y + self.noise * rng.standard_normal(y.shape)


def turned_pairs(shape: np.ndarray, turn_deg: float) -> np.ndarray:
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    turned = np.array(shape)
    for i, j in ((0, 1), (3, 4)):
        turned[:, i], turned[:, j] = c * shape[:, i] + s * shape[:, j], c * shape[:, j] - s * shape[:, i]
    return turned


@pytest.fixture(scope="session")
def jacket() -> Structure:
    return Structure(
        frequency_hz=np.array([0.316, 0.323, 1.29, 1.93, 2.02]),
        damping_ratio=np.array([0.015, 0.012, 0.01, 0.01, 0.012]),
        shape=shapes(), strength=np.array([1.0, 0.8, 0.15, 0.3, 0.25]), noise=0.01,
    )


@pytest.fixture(scope="session")
def reference(jacket) -> ReferenceModes:
    return ReferenceModes(labels=LABELS, frequency_hz=jacket.frequency_hz, shape=jacket.shape, pairs=((0, 1), (3, 4)))


@pytest.fixture(scope="session")
def pairs_turned():
    return turned_pairs


@pytest.fixture(scope="session")
def sensor_list() -> tuple[Sensor, ...]:
    return sensors()


@pytest.fixture
def write_campaign(tmp_path):
    """write_campaign(records, scada=None): a campaign at 5 Hz, one file a half hour from 2019-06-03T10:00Z."""

    def write(records, scada: pd.DataFrame | None = None, quantity: str = "acceleration"):
        unit = {"acceleration": "m/s2", "velocity": "m/s"}
        lines = [f'name = "Made"\nsampling_rate_hz = {RATE}\nblock_minutes = 30\n']
        for k, s in enumerate(sensors()):
            kind = quantity if k == 3 else "acceleration"
            lines.append(
                f'[[sensor]]\nchannel = "{s.channel}"\nlevel = "{s.level}"\nposition_m = {s.position_m.tolist()}\n'
                f'direction = {s.direction.tolist()}\nquantity = "{kind}"\nunit = "{unit[kind]}"\n'
            )
        (tmp_path / "campaign.toml").write_text("".join(lines))
        (tmp_path / "acceleration").mkdir(exist_ok=True)
        for k, record in enumerate(records):
            start = pd.Timestamp("2019-06-03T10:00Z") + pd.Timedelta(minutes=30 * k)
            with h5py.File(tmp_path / "acceleration" / f"{k:03d}.h5", "w") as file:
                dataset = file.create_dataset("data", data=np.asarray(record, np.float32))
                dataset.attrs["start"] = start.isoformat()
                dataset.attrs["sampling_rate_hz"] = RATE
        if scada is not None:
            scada.to_csv(tmp_path / "scada.csv", index=False)
        return tmp_path

    return write


@pytest.fixture
def scada_rows():
    """scada_rows(blocks): a dict of columns per block -> three equal rows each."""

    def rows(conditions) -> pd.DataFrame:
        table = pd.DataFrame([row for row in conditions for _ in range(3)])
        table.insert(0, "time", pd.date_range("2019-06-03T10:00Z", periods=len(table), freq="10min").astype(str))
        return table

    return rows
