"""Along which axis a structure's sections lie: vertical of what rises, horizontal of what spans, as a bridge does."""

from __future__ import annotations

import numpy as np

# a horizontal extent so many times the height and the width is the structure's length
LONG = 1.5
# of what spans, weight moves it vertically by at least this share of what it would move it sideways (frequencies in
# the ratio 7): less holds buildings up, whose columns are stiff along their axis however long the building is
SPANS = 0.02


def horizontal_axes(position_m: np.ndarray) -> np.ndarray | None:
    """(3, 3) unit vectors across, up and along of points (n, 3) that stretch along a horizontal line; None where they
    do not."""
    if not len(position_m):
        return None
    about = position_m - position_m.mean(axis=0)
    east, north = np.linalg.eigh(about[:, :2].T @ about[:, :2])[1][:, 1]
    # the coordinates' axis where it is one but for rounding, and the sense that is nearer to it
    along = np.where(np.abs([east, north, 0.0]) > 1e-9, [east, north, 0.0], 0.0)
    along = along / (np.linalg.norm(along) * np.sign(along[np.argmax(np.abs(along))]))
    up = np.array([0.0, 0.0, 1.0])
    axes = np.array([np.cross(up, along), up, along])
    wide, high, long = np.ptp(about @ axes.T, axis=0)
    return axes if long > LONG * max(wide, high) else None


def spans(flexibility: np.ndarray) -> bool:
    """Whether flexibilities (3,) along x, y and z are those of what spans."""
    return bool(flexibility[2] >= SPANS * max(flexibility[:2]) and flexibility[2] > 0)
