"""Stresses of a SubDyn model: a pile in waves and thrust against statics by hand, joints, sections, mistakes."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probupdate.errors import InputError
from probupdate.lifetime.conditions import Conditions
from probupdate.lifetime.efthymiou import Geometry
from probupdate.lifetime.efthymiou import kay as k_factors
from probupdate.lifetime.fatigue import fatigue_model_of
from tests.lifetime.test_stress import CONDITIONS
from tests.subdyn_text import STEEL, subdyn

D, T, FOOT, TOP = 2.0, 0.04, -20.0, 30.0
SITE = {
    "water_density_kgpm3": 1025.0,
    "gravity_mps2": 9.81,
    "mudline_m": FOOT,
    "water_level_m": 0.0,
    "growth_m": 0.1,
    "hub_joint": 4,
    "hub_offset_m": [0.0, 0.0, 3.0],
}
PARAMETERS = (
    ("k", "stiffness", "-", 1.0, 0.1),
    ("t", "thickness", "-", 1.0, 0.1),
    ("loss", "wall_loss", "m", 0.001, 0.001),
    ("m", "mass", "-", 1.0, 0.1),
)


def pile(folder: Path) -> Path:
    """A clamped tube of three members, the middle one through the water line, a lumped mass on its top."""
    (folder / "pile.dat").write_text(
        subdyn(
            [f"0 0 {z}" for z in (FOOT, -8, 6, TOP)],
            ["1 2 1 1 1c 0", "2 3 1 1 1c 0", "3 4 1 1 1c 0"],
            ["1 1 1 1 1 1 1"],
            interface=[4],
            fem=3,
            div=2,
            circular=[f"1 {STEEL} {D} {T}"],
            mass=["4 2e5 1e6 1e6 1e6 0 0 0 0 0 3"],
        )
    )
    text = '[subdyn]\nfile = "pile.dat"\n[group.tube]\nmembers = [1, 2, 3]\n[group.top]\nmasses = [4]\n'
    for name, acts, unit, initial, std in PARAMETERS:
        text += (
            f'[[parameter]]\nname = "{name}"\nacts = "{acts}"\non = "{"top" if acts == "mass" else "tube"}"\n'
            f'unit = "{unit}"\ninitial = {initial}\nstd = {std}\nlower = {0.0 if unit == "m" else 0.5}\nupper = 2.0\n'
        )
    for z in (6, TOP):
        for axis, way in (("x", [1.0, 0.0, 0.0]), ("y", [0.0, 1.0, 0.0])):
            text += f'[[sensor]]\nchannel = "{z}-{axis}"\nlevel = "{z}"\n'
            text += f"position_m = [0.0, 0.0, {float(z)}]\ndirection = {way}\n"
    (folder / "model.toml").write_text(text)
    return folder / "model.toml"


def conditions(**change) -> Conditions:
    raw = copy.deepcopy(CONDITIONS)
    del raw["joint"]
    return Conditions.model_validate(
        raw
        | {"site": SITE, "girth": [{"part": "tube", "z_m": z, "factor": 1.0, "curve": "T"} for z in (FOOT, 6.0)]}
        | change
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return fatigue_model_of(pile(tmp_path_factory.mktemp("pile")), conditions())


def section(values=(1.0, 0.001)):
    outer = D - 2 * values[1]
    inner = outer - 2 * (T * values[0] - values[1])
    return outer, np.pi / 64 * (outer**4 - inner**4)


def test_slow_thrust_bends_the_pile_as_a_lever(whole, validation):
    row = validation(what="a SubDyn pile under slow thrust", reference="force times arm by hand",
                     why="a frequency above zero")
    one = whole.models[0]
    slow = replace(one, frequency_hz=np.array([1e-4, 2e-4]))
    z = slow.transfer(one.parameters.initial, {}, wind=True)[:, :, 0]
    outer, second = section()
    for k, level in enumerate((FOOT, 6.0)):
        arm = TOP + 3.0 - level
        # the lee side is pressed; place 1 looks along x, as the wind
        row.error(z[k, 1].real / (-1e-6 * arm * 0.5 * outer / second) - 1, below=1e-4)
        assert abs(z[k, 2]) < 1e-6 * abs(z[k, 1]) and abs(z[k, 0]) < 1e-6 * abs(z[k, 1])


def test_slow_waves_bend_the_foot_as_morisons_integral(whole, validation):
    row = validation(what="the same under slow waves, part of a member wet",
                     reference="Morison's integral by trapezoids, the pile held", why="its own motion at 0.03 Hz")
    one = whole.models[0]
    f = np.array([0.03, 0.031])
    slow = replace(one, frequency_hz=f)
    # stiff and light: what the pile's own motion adds is left out by hand
    z = slow.transfer(one.parameters.initial, {})[0, 1, 0]
    omega, depth, diameter = 2 * np.pi * f[0], -FOOT, D + 0.2
    k = omega**2 / 9.81
    for _ in range(200):
        k = omega**2 / (9.81 * np.tanh(k * depth))
    height = np.linspace(FOOT, 0.0, 20001)
    speed = omega * np.cosh(k * (height + depth)) / np.sinh(k * depth)
    inertia = 1025.0 * 2.0 * np.pi / 4 * diameter**2 * 1j * omega * speed
    sigma = np.interp(height, *_speeds(slow))
    drag = 0.5 * 1025.0 * 0.8 * diameter * np.sqrt(8 / np.pi) * sigma * speed
    moment = np.trapezoid((inertia + drag) * (height - FOOT), height)
    outer, second = section()
    by_hand = -1e-6 * moment * 0.5 * outer / second
    # above it the pile moves: a hundredth at a tenth of its first frequency
    row.error(z / by_hand - 1, below=0.05)
    assert one.waves.position_m[:, 2].max() < 0.0
    assert np.sum(one.waves.length_m) == pytest.approx(-FOOT)


def _speeds(model):
    order = np.argsort(model.waves.position_m[:, 2])
    return model.waves.position_m[order, 2], model._speeds[0][order]


def test_derivatives_are_those_of_differences(whole, validation):
    checked = validation(what="the same, d ln DEL / d theta with wall and wall loss, equal pairs of modes",
                         reference="central differences", why="their step; of each, and a tenth of the largest")
    theta = whole.parameters.initial
    small = whole.reduce([theta * 1.02, theta * 0.98])
    exact = small.solve(theta, {}, derivatives=True).equivalent_change(5.0)
    for k in range(len(theta)):
        h = 1e-3 * theta[k]
        up, down = (np.log(small.solve(theta + s * h * np.eye(len(theta))[k]).equivalent_mpa(5.0)) for s in (1, -1))
        change = (up - down) / (2 * h)
        checked.error((exact[k] - change) / (np.abs(change) + 0.1 * np.abs(change).max()), below=1e-3)


def test_wall_and_loss_are_the_sections(whole):
    tube = whole.details[0].section
    values = {"t": 1.1, "loss": 0.002}
    outer, second = section((1.1, 0.002))
    assert tube.outer(values) == pytest.approx(outer) and tube.second_moment(values) == pytest.approx(second)
    assert tube.area(values) == pytest.approx(np.pi / 4 * (outer**2 - (outer - 2 * (1.1 * T - 0.002)) ** 2))


CROSS = {"chord": {"axial_crown": 2.0, "axial_saddle": 3.0, "in_plane": 2.0, "out_of_plane": 3.0}}


def frame(folder: Path, gap=0.3) -> Path:
    """Two legs, two crossing braces in four halves, and on leg 1 a K of a half brace below and one above."""
    joints = ["0 0 0", "0 0 10", "0 0 20", "8 0 0", "8 0 10", "8 0 20", "4 0 5", "4 0 15"]
    legs = ["1 2", "2 3", "4 5", "5 6"]
    braces = ["1 7", "7 5", "4 7", "7 2", "2 8", "8 6", "5 8", "8 3"]
    (folder / "frame.dat").write_text(
        subdyn(
            joints,
            [f"{p} 1 1 1c 0" for p in legs] + [f"{p} 2 2 1c 0" for p in braces],
            ["1 1 1 1 1 1 1", "4 1 1 1 1 1 1"],
            interface=[3],
            circular=[f"1 {STEEL} 1.2 0.05", f"2 {STEEL} 0.8 0.02"],
            mass=["3 1e5 1e6 1e6 1e6 0 0 0 0 0 0"],
        )
    )
    text = '[subdyn]\nfile = "frame.dat"\n[group.legs]\nproperty_sets = [1]\n[group.braces]\nproperty_sets = [2]\n'
    text += '[group.top]\nmasses = [3]\n[[parameter]]\nname = "k"\nacts = "stiffness"\non = "legs"\n'
    text += "initial = 1.0\nstd = 0.1\nlower = 0.1\nupper = 3.0\n"
    (folder / "frame.toml").write_text(text)
    return folder / "frame.toml"


def of_frame(path: Path, *ends) -> object:
    site = SITE | {"hub_joint": 3, "hub_offset_m": [0.0, 0.0, 0.0], "mudline_m": 0.0, "water_level_m": 2.0}
    wind = CONDITIONS["wind"] | {"rotor_diameter_m": 40.0}
    ends = [{"curve": "T"} | e for e in ends]
    return fatigue_model_of(path, conditions(girth=[], site=site, wind=wind, member_end=ends))


def test_joints_are_found_with_their_chords(tmp_path):
    path = frame(tmp_path)
    found = of_frame(
        path, {"braces": "braces", "chords": "legs"} | CROSS, {"braces": "braces", "chords": "braces"} | CROSS
    )
    at_legs = [d for d in found.details if d.joint not in ("joint 7", "joint 8")]
    assert len(at_legs) == 8 and len(found.details) == 16
    # a half brace's chord at its crossing is the other brace, never its own second half
    for d in found.details:
        if d.joint in ("joint 7", "joint 8"):
            assert abs(d.along @ d.chord_along) < 0.5
    # slow thrust: each brace carries one axial force from end to end
    one = replace(found.models[0], frequency_hz=np.array([1e-4, 2e-4]))
    force = one.transfer(one.parameters.initial, {}, wind=True)[:, 0, 0]
    by_member = {}
    for d, n in zip(found.details, force, strict=True):
        by_member.setdefault(d.part, []).append(n)
    for a, b in by_member.values():
        assert a == pytest.approx(b, rel=1e-6)
    # joint 7 is loaded by nothing: what four halves pull adds up to nothing but for their shears
    four = [(n, d) for d, n in zip(found.details, force, strict=True) if d.joint == "joint 7"]
    assert len(four) == 4
    assert np.linalg.norm(sum(n * d.along_brace for n, d in four)) < 0.1 * max(abs(n) for n, _ in four)


def test_efthymiou_takes_geometry_from_the_model(tmp_path):
    path = frame(tmp_path)
    entry = {"chord_length_m": 10.0, "chord_fixity": 0.7, "least": 1.5}
    kay = {"braces": "braces", "chords": "legs", "joints": [2, 5], "efthymiou": entry | {"kind": "K", "gap_m": 0.12}}
    tee = {"braces": "braces", "chords": "legs", "joints": [1, 3, 4, 6], "efthymiou": entry | {"kind": "T/Y"}}
    found = of_frame(path, kay, tee)
    assert len(found.details) == 8 and len(found.spots) == 8 * 2 * 8
    detail = next(k for k, d in enumerate(found.details) if d.joint == "joint 2")
    angle = np.degrees(np.arctan2(4, 5))
    g = Geometry(
        chord_diameter_m=1.2,
        chord_wall_m=0.05,
        chord_length_m=10.0,
        brace_diameter_m=0.8,
        brace_wall_m=0.02,
        angle_deg=angle,
    )
    chord, _ = k_factors(g, g, 0.12)
    # thickness effect of the chord's 50 mm over 32 mm
    scale = (0.05 / 0.032) ** 0.25
    spot = next(s for s in found.spots if s.detail == detail and s.side == "chord" and s.place == 1)
    assert chord.in_plane < 1.5 < chord.axial_crown
    assert spot.thickness_effect == pytest.approx(scale)
    assert spot.weight == pytest.approx(np.array([chord.axial_crown, 1.5, 0.0]))
    assert min(s.weight[0] for s in found.spots) >= 1.5


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ({"braces": "brace", "chords": "legs"} | CROSS, r"did you mean 'braces'"),
        ({"braces": "top", "chords": "legs"} | CROSS, r"\[group.top\] is not of circular members"),
        ({"braces": "braces", "chords": "legs", "joints": [77]} | CROSS, "joint 77 is not in"),
        ({"braces": "braces", "chords": "legs", "joints": [7]} | CROSS, "chooses no brace end"),
        (
            {
                "braces": "braces",
                "chords": "legs",
                "efthymiou": {"kind": "K", "gap_m": 0.1, "chord_length_m": 10.0, "chord_fixity": 0.7, "least": 1.5},
            },
            "take kind = .T/Y",
        ),
        (
            {
                "braces": "braces",
                "chords": "legs",
                "efthymiou": {"kind": "T/Y", "chord_length_m": 40.0, "chord_fixity": 0.7, "least": 1.5},
            },
            "alpha = 66.7 is not within 4 to 40",
        ),
    ],
)
def test_mistakes_are_named(tmp_path, ends, words):
    with pytest.raises(InputError, match=words):
        of_frame(frame(tmp_path), ends)


def test_the_water_and_the_hub_are_stated(tmp_path):
    path = pile(tmp_path)
    with pytest.raises(InputError, match="site: is missing"):
        fatigue_model_of(path, conditions(site=None))
    with pytest.raises(InputError, match="hub_joint: joint 9 is not in"):
        fatigue_model_of(path, conditions(site=SITE | {"hub_joint": 9}))
    with pytest.raises(InputError, match="no .tower."):
        fatigue_model_of(path, conditions(site={k: v for k, v in SITE.items() if k != "hub_joint"}))
    with pytest.raises(InputError, match="SubDyn models have"):
        fatigue_model_of(path, conditions(joint=[{"at": "leg", "curve": "T"} | CROSS]))
    with pytest.raises(InputError, match="name them in a TOML"):
        from probupdate.lifetime.subdyn_stress import open_model

        open_model(path.with_name("pile.dat"))
