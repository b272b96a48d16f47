"""Where the nacelle looks: rotor and nacelle turned about the vertical on a structure that is alike in x and y."""

from types import SimpleNamespace

import numpy as np
import pytest
from small_turbine import POINT, small_turbine

from probupdate.campaign.reading import WrittenCampaign
from probupdate.errors import InputError
from probupdate.identification.environment import fore_aft_deg
from probupdate.structure.description_file import parse_description
from probupdate.structure.load import nacelle_angle_deg, turbine_model, turn_to
from probupdate.structure.turbine_frame import build_frame

N_MODE = 8


def turbine(angle, **rna):
    raw = small_turbine()
    for body in raw["rna"]:
        body.update(rna)
    return turbine_model(parse_description(raw, "m"), where="m", turn_deg=angle)


def solve(model):
    theta = np.array([POINT[name] for name in model.parameters.names])
    return model.solve(theta, N_MODE)


@pytest.mark.parametrize("angle", [90.0, 180.0, -35.0])
def test_the_nacelle_turns_the_modes_of_a_square_jacket(angle, validation):
    """Four-fold symmetry makes the jacket alike in all horizontal directions: at any angle the frequencies stay, and
    the tower's motion turns along."""
    row = validation(what="a square jacket's frequencies with the nacelle turned", reference="those before",
                     why="eigensolver")
    before, after = solve(turbine(0.0)), solve(turbine(angle))
    row.error(after.frequency_hz / before.frequency_hz - 1, below=1e-7)
    channels = list(turbine(0.0).channels)
    x, y = ([channels.index(f"T{z}-{d}") for z in (30, 50)] for d in "xy")
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    for k in range(N_MODE):
        turned = np.concatenate([c * before.shape[x, k] - s * before.shape[y, k],
                                 s * before.shape[x, k] + c * before.shape[y, k]])
        found = np.concatenate([after.shape[x, k], after.shape[y, k]])
        if np.linalg.norm(turned) > 0.05 * np.linalg.norm(before.shape[:, k]):
            assert abs(turned @ found) == pytest.approx(np.linalg.norm(turned) * np.linalg.norm(found), rel=1e-5)


def test_a_nacelle_centred_and_alike_about_the_vertical_may_look_anywhere():
    """What turns is the bodies' offsets and inertia, nothing else."""
    same = dict(offset_m=[0.0, 0.0, 2.0], inertia_kgm2=[5e5, 5e5, 9e5])
    np.testing.assert_allclose(
        solve(turbine(35.0, **same)).frequency_hz, solve(turbine(0.0, **same)).frequency_hz, rtol=1e-9
    )


def test_models_at_different_angles_are_told_apart():
    prints = [turbine(angle).fingerprint() for angle in (0.0, 35.0)]
    assert prints[0] != prints[1]


@pytest.mark.parametrize("rotor", ["-x", "+y"])
def test_the_rotor_stands_where_the_compass_says(rotor):
    """Whichever way the file draws it: in east and north, a nacelle of heading 245 looks to the west-south-west."""
    raw = small_turbine()
    for body in raw["rna"]:
        x, y, z = body["offset_m"]
        body["offset_m"] = [x, y, z] if rotor == "-x" else [y, -x, z]
    description, x_axis, heading = parse_description(raw, "m"), 20.0, 245.0
    campaign = SimpleNamespace(x_axis_heading_deg=x_axis)
    angle = fore_aft_deg({"nacelle_heading_deg": heading}, campaign)
    frame = build_frame(description, turn_to(description, angle))
    hub = frame.node_m[frame.nacelle[[entry.name for entry in description.rna].index("hub")]]
    axes = np.array([[np.sin(np.radians(a)), np.cos(np.radians(a))] for a in (x_axis, x_axis - 90.0)])
    east_north = hub[:2] @ axes
    toward = np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading))])
    np.testing.assert_allclose(east_north / np.linalg.norm(east_north), toward, atol=1e-9)
    # where no compass is stated, heading 0 is the file's own way, as of wind along x
    default = SimpleNamespace(x_axis_heading_deg=WrittenCampaign.x_axis_heading_deg)
    still = fore_aft_deg({"nacelle_heading_deg": 0.0}, default)
    assert turn_to(description, still) == pytest.approx(0.0 if rotor == "-x" else 90.0)


def test_the_angle_of_a_set_is_wrapped_and_nonsense_is_named():
    assert nacelle_angle_deg({"nacelle_angle_deg": -295.0}, "m") == pytest.approx(65.0)
    assert nacelle_angle_deg({}, "m") is None
    with pytest.raises(InputError, match=r"set 3, environment\.nacelle_angle_deg: 'north' is not an angle"):
        nacelle_angle_deg({"nacelle_angle_deg": "north"}, "modes.json, set 3")
