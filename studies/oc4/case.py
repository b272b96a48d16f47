"""The files of the OC4 case: two model TOMLs beside the SubDyn file, and a campaign measured on the second theory."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from second_theory import SecondTheory

from probupdate.io.subdyn_file import SubDynFile, read_subdyn
from probupdate.modal.modes import Sensor
from probupdate.virtual.campaign_files import write_acceleration, write_campaign_toml
from probupdate.virtual.response import modal_response

INPUT, SOIL = "owt_soil_eb.dat", "OC4_Jacket_SD_SSI.txt"
PILES = (61, 62, 63, 64)
# joints with a sensor along x and one along y: two levels of the jacket, the transition piece, the tower
LEVELS = {"mid": (10, 20), "low": (25, 33), "TP": (24, 32), "tower": (112, 124, 135)}
TRUE = {"k_tower": 1.06, "k_braces": 0.97, "soil": 1.25}
HIDDEN_PILE, HIDDEN = 63, 0.5
RATE_HZ, DAMPING, N_MODE = 25.0, 0.01, 20
START = np.datetime64("2024-03-01T00:00:00")
FACES = {f"bay{bay}_{face}": range(37 + 16 * (bay - 1) + 4 * k, 41 + 16 * (bay - 1) + 4 * k)
         for bay in (1, 2, 3, 4) for k, face in enumerate(("px", "mx", "py", "my"))}


def parameter(name: str, acts: str, on: str, std: float, lower: float = 0.1, upper: float = 3.0) -> str:
    return (f'\n[[parameter]]\nname = "{name}"\nacts = "{acts}"\non = "{on}"\nunit = "-"\ninitial = 1.0\nstd = {std}\n'
            f"lower = {lower}\nupper = {upper}\n")


def sensors(file: SubDynFile) -> tuple[Sensor, ...]:
    place = {joint.id: joint.position_m for joint in file.joints}
    return tuple(
        # the second theory gives motions
        Sensor(channel=f"{level}-{joint}-{axis}", level=level, position_m=place[joint], direction=np.eye(3)[k],
               gravity=False)
        for level, joints in LEVELS.items() for joint in joints for k, axis in enumerate("xy")
    )


def write_models(source: Path, folder: Path) -> tuple[Path, Path]:
    """model.toml to be updated and causes.toml to be diagnosed with, beside copies of the SubDyn files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (INPUT, SOIL):
        shutil.copyfile(source / name, folder / name)
    file = read_subdyn(folder / INPUT)
    tower = [m.id for m in file.members if m.kind == "arbitrary"]
    head = f'name = "OC4 jacket with tower"\n\n[subdyn]\nfile = "{INPUT}"\nnacelle = [135]\n'
    groups = {"tower": f"members = {tower}", "legs": "property_sets = [2, 3]", "braces": "property_sets = [1]",
              "piles": f"reactions = {list(PILES)}", "rna": "masses = [135]"}
    channels = "".join(
        f'\n[[sensor]]\nchannel = "{s.channel}"\nlevel = "{s.level}"\njoint = {s.channel.split("-")[1]}\n'
        f"direction = {s.direction.tolist()}\n" for s in sensors(file))

    def text(groups, parameters):
        return head + "".join(f"\n[group.{k}]\n{v}\n" for k, v in groups.items()) + "".join(parameters) + channels

    common = [parameter("k_tower", "stiffness", "tower", 0.1), parameter("k_legs", "stiffness", "legs", 0.05),
              parameter("m_rna", "mass", "rna", 0.03), parameter("soil", "soil", "piles", 0.4)]
    model = folder / "model.toml"
    model.write_text(text(groups, [*common, parameter("k_braces", "stiffness", "braces", 0.05)]), encoding="utf-8")
    own = {f"pile_{pile}": f"reactions = [{pile}]" for pile in PILES}
    own |= {name: f"members = {list(members)}" for name, members in FACES.items()}
    causes = folder / "causes.toml"
    rows = [parameter(f"soil_{pile}", "soil", f"pile_{pile}", 0.05) for pile in PILES]
    rows += [parameter(f"brace_{name}", "stiffness", name, 0.05) for name in FACES]
    causes.write_text(text(groups | own, [*common, *rows]), encoding="utf-8")
    return model, causes


def truth(file: SubDynFile, *, hidden: bool = True) -> SecondTheory:
    factor = {m.id: TRUE["k_tower"] for m in file.members if m.kind == "arbitrary"}
    factor |= {m.id: TRUE["k_braces"] for m in file.members if m.kind == "circular" and 1 in m.sets}
    soil = {pile: TRUE["soil"] * (HIDDEN if hidden and pile == HIDDEN_PILE else 1.0) for pile in PILES}
    return SecondTheory(file, stiffness=factor, soil=soil)


def seen(theory: SecondTheory, places: tuple[Sensor, ...], n: int = N_MODE) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) and shapes (n_channel, n) at the sensors."""
    frequency, shape = theory.modes(n)
    rows = [s.direction @ shape[:3, theory.joint[int(s.channel.split("-")[1])]] for s in places]
    return frequency, np.array(rows)


def write_campaign(folder: Path, theory: SecondTheory, places: tuple[Sensor, ...], *, hours: int, seed: int) -> None:
    """Acceleration under white noise on every mode (its share: what the tower's top and the TP move) and sensor
    noise."""
    frequency, shape = seen(theory, places)
    rng = np.random.default_rng(seed)
    (folder / "acceleration").mkdir(parents=True, exist_ok=True)
    write_campaign_toml(folder, name="OC4 by a second theory", sensors=places, rate_hz=RATE_HZ, block_minutes=30,
                        water_depth_m=50.0)
    shifted = [k for k, s in enumerate(places) if s.level in ("TP", "tower")]
    q = v = np.zeros(len(frequency))
    n = int(3600 * RATE_HZ)
    for hour in range(hours):
        load = rng.standard_normal((n + 1, len(shifted))) * 4e3
        force = load @ shape[shifted]
        modal, moved, v = modal_response(frequency, np.full(len(frequency), DAMPING), force, RATE_HZ, q, v)
        q = moved[-1]
        data = modal @ shape.T
        data += 1e-2 * data.std(axis=0) * rng.standard_normal(data.shape)
        start = START + np.timedelta64(hour, "h")
        write_acceleration(folder / "acceleration" / f"{hour:03d}.h5", data, start, RATE_HZ)
