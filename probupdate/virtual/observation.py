"""What the sensors of the virtual turbine make of its motion: mounting, gains, housings, loggers, and their faults."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from probupdate.errors import InputError
from probupdate.virtual.effects import HiddenEffects
from probupdate.virtual.mesh import Mesh
from probupdate.virtual.truth import Truth
from probupdate.virtual.turbine_file import TurbineFile

MOUNT_DAMPING = 0.2  # ratio of a resonating mount
LEAST_ARM_M = 0.1  # by which a sensor may stand over its part's end


def rotation(axis_angle: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of an axis times an angle in rad (Rodrigues)."""
    angle = float(np.linalg.norm(axis_angle))
    if angle == 0:
        return np.eye(3)
    x, y, z = axis_angle / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def attachments(
    mesh: Mesh, file: TurbineFile, hidden: HiddenEffects | None = None
) -> list[tuple[int, np.ndarray]]:
    """For each channel the nearest node of the part it sits on, and the arm from there to the sensor: as the drawing
    has it, or where it truly sits."""
    found = []
    for sensor, part in zip(file.sensors, file.parts, strict=True):
        if part not in mesh.part:
            raise InputError(f"{file.path}, sensor {sensor.channel}", f"part '{part}' is unknown",
                             f"choose from {', '.join(mesh.part)}")
        number = mesh.nearest(mesh.part[part], sensor.position_m)
        arm = sensor.position_m - mesh.nodes[number]
        farther = hidden.total("sensor_height", level=sensor.level) if hidden else 0.0
        if farther:
            own = np.array([mesh.nodes[n] for n in mesh.part[part]])
            low, high = own[np.argmin(own[:, 2])], own[np.argmax(own[:, 2])]
            up = (high - low) / np.linalg.norm(high - low)
            point = mesh.nodes[number] + farther * up
            if not -LEAST_ARM_M <= (point - low) @ up <= (high - low) @ up + LEAST_ARM_M:
                raise InputError(f"{file.path}, sensor {sensor.channel}",
                                 f"{farther:g} m farther up it would lie beyond {part}", "give less")
            number = mesh.nearest(mesh.part[part], point)
            arm = arm + point - mesh.nodes[number]
        found.append((number, arm))
    return found


def reading_rows(attached: list[tuple[int, np.ndarray]], direction: np.ndarray, factor: np.ndarray, n_dof: int):
    """Rows (n_channel, n_dof) csr that read factor x (u + theta x r) along a direction (n_channel, 3)."""
    rows = np.zeros((len(attached), n_dof))
    for row, (number, arm) in enumerate(attached):
        rows[row, 6 * number : 6 * number + 3] = factor[row] * direction[row]
        # d . (theta x r) = theta . (r x d)
        rows[row, 6 * number + 3 : 6 * number + 6] = factor[row] * np.cross(arm, direction[row])
    return sparse.csr_array(rows)


def tilting_rows(attached: list[tuple[int, np.ndarray]], direction: np.ndarray, factor: np.ndarray, n_dof: int):
    """Rows (n_channel, n_dof) csr that read factor x what tilt adds to a reading, in units of gravity: a sensor along
    d that turns by theta feels the support against gravity, g z, along d + theta x d, more by g z . (theta x d)."""
    up = np.array([0.0, 0.0, 1.0])
    rows = np.zeros((len(attached), n_dof))
    for row, (number, _) in enumerate(attached):
        # z . (theta x d) = theta . (d x z)
        rows[row, 6 * number + 3 : 6 * number + 6] = factor[row] * np.cross(direction[row], up)
    return sparse.csr_array(rows)


def felt_gravity(file: TurbineFile, hidden: HiddenEffects) -> np.ndarray:
    """(n_channel,) m/s2 of gravity that a channel's readings hold: all of it, or none where it is taken out of them."""
    stated = np.array([float(bool(sensor.gravity)) for sensor in file.sensors])
    wrong = min(hidden.total("sensor_gravity"), 1.0)
    return file.number("site", "gravity_mps2", positive=True) * (stated + wrong * (1 - 2 * stated))


def nominal_direction(file: TurbineFile) -> np.ndarray:
    """(n_channel, 3) unit vectors as the file states them."""
    return np.array([sensor.direction for sensor in file.sensors])


def mounted_direction(file: TurbineFile, truth: Truth, hidden: HiddenEffects) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n_channel, 3) as the channels truly look, and their gains (n_channel,)."""
    t = truth.tolerances
    gain = np.array(t.sensor_gain)
    frame = rotation(np.radians([0.0, 0.0, t.frame_rotation_deg + hidden.total("frame_rotation")]))
    position = {sensor.channel: tuple(sensor.position_m) for sensor in file.sensors}
    direction = []
    for row, sensor in enumerate(file.sensors):
        for _, factor in hidden.acting("sensor_gain", channel=sensor.channel):
            gain[row] *= factor
        looks = rotation(np.radians(t.sensor_rotation_deg[row])) @ sensor.direction
        for effect, angle in hidden.acting("sensor_rotation"):
            if position[effect["channel"]] == position[sensor.channel]:
                looks = rotation(np.radians([0.0, 0.0, angle])) @ looks
        direction.append(frame @ looks)
    return np.array(direction), gain


def channel_mixing(file: TurbineFile, hidden: HiddenEffects) -> np.ndarray | None:
    """What each channel shows of each sensor (n_channel, n_channel); None where each shows its own."""
    names = [s.channel for s in file.sensors]
    mixing = np.eye(len(names))
    for effect, share in hidden.acting("crosstalk"):
        mixing[names.index(effect["channel"]), names.index(effect["other"])] += share
    for effect, swapped in hidden.acting("sensor_swap"):
        if swapped >= 0.5:
            i, j = names.index(effect["channel"]), names.index(effect["other"])
            mixing[[i, j]] = mixing[[j, i]]
    return None if np.array_equal(mixing, np.eye(len(names))) else mixing


def frequency_response(file: TurbineFile, hidden: HiddenEffects, frequency_hz: np.ndarray) -> np.ndarray | None:
    """What clocks, filters and mounts do to each channel: (n_frequency, n_channel) complex, None where nothing."""
    if not any(hidden.acting(kind) for kind in ("clock_offset", "low_pass", "mount_resonance")):
        return None
    frequency = np.asarray(frequency_hz, float)
    response = np.ones((len(frequency), len(file.sensors)), complex)
    for column, sensor in enumerate(file.sensors):
        # a clock that is late writes an event to an earlier time
        late = hidden.total("clock_offset", level=sensor.level)
        response[:, column] *= np.exp(2j * np.pi * frequency * late)
        for _, constant in hidden.acting("low_pass", level=sensor.level):
            response[:, column] /= 1 + 2j * np.pi * frequency * constant
        for _, period in hidden.acting("mount_resonance", channel=sensor.channel):
            ratio = frequency * period
            response[:, column] /= 1 - ratio**2 + 2j * MOUNT_DAMPING * ratio
    return response


def sampling_ratio(hidden: HiddenEffects) -> float:
    """Samples truly taken for each that the logger states: above 1, every frequency reads too low."""
    return hidden.factor("sampling_rate")
