"""A frame with ElastoDyn's platform and turbine, yawed, against OpenSees: every body in particles on rigid links."""

import math

import numpy as np
import opensees_loader
import pytest

import probupdate
from tests.subdyn_text import subdyn

E, G, DENSITY = 2.05e11, 7.95e10, 7800.0
FEET = ((7.0, 6.0), (-8.0, 6.5), (-6.0, -7.0), (7.5, -5.5))
PLACE = [(2.2 * x, 2 * y, -38.0) for x, y in FEET] + [(x, y, 14.0) for x, y in FEET] + [(0.0, 0.0, 17.3)]
ENDS = [(k, k + 4, 1) for k in range(4)] + [(4 + k, 4 + (k + 1) % 4, 2) for k in range(4)] + [
    (8, k, 3) for k in range(4, 8)]
TUBES = {1: (1.3, 0.045), 2: (0.8, 0.03), 3: (1.6, 0.06)}
BASE_M, TOP_M, PIECES, TOWER_DENSITY = 17.3, 83.0, 40, 8500.0
STATIONS = ((0.0, 0.5, 1.0), (5600.0, 4100.0, 2900.0), (5.9e11, 3.1e11, 1.05e11), (6.4e11, 3.5e11, 1.2e11))
YAW, TILT, CONE = 37.0, -5.0, -2.5
PLATFORM_KG, PLATFORM_M = 712e3, (0.8, -0.6, 15.9)
PLATFORM = np.array([[5.1e6, 4e5, -6e5], [4e5, 6.3e6, 3e5], [-6e5, 3e5, 8.8e6]])
BLADE = ((0.0, 0.4, 1.0), (500.0, 310.0, 40.0))
KEYS = {"NumBl": 3, "TipRad": 58.0, "HubRad": 1.3, "HubCM": 0.4, "OverHang": -4.1, "ShftTilt": TILT, "NacCMxn": 1.4,
        "NacCMyn": 0.3, "NacCMzn": 1.6, "Twr2Shft": 1.7, "TowerHt": TOP_M, "TowerBsHt": BASE_M, "HubMass": 47e3,
        "HubIner": 0.0, "NacMass": 213e3, "NacYIner": 2.3e6, "YawBrMass": 4e3, "NacYaw": YAW, "PtfmMass": PLATFORM_KG}
KEYS |= {f"PtfmCM{a}t": v for a, v in zip("xyz", PLATFORM_M, strict=True)}
KEYS |= {f"Ptfm{name}Iner": PLATFORM[at] for name, at in (("R", (0, 0)), ("P", (1, 1)), ("Y", (2, 2)), ("XY", (0, 1)),
                                                          ("XZ", (0, 2)), ("YZ", (1, 2)))}
KEYS |= {f"PreCone({k})": CONE for k in (1, 2, 3)} | {f"TipMass({k})": 10.0 * k for k in (1, 2, 3)}
KEYS |= {f"BldFile({k})": '"b.dat"' for k in (1, 2, 3)} | {"TwrFile": '"t.dat"'}


def rows(*columns):
    return "".join(" ".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


def write(folder):
    (folder / "ed.dat").write_text("--- ED ---\n" + "".join(f"{v} {k} - x\n" for k, v in KEYS.items()))
    (folder / "t.dat").write_text("--- T ---\n3 NTwInpSt - n\n1 AdjTwMa - f\n1 AdjFASt - f\n1 AdjSSSt - f\n--- D ---\n"
                                  "HtFract TMassDen TwFAStif TwSSStif\n(-) (-) (-) (-)\n" + rows(*STATIONS))
    (folder / "b.dat").write_text("--- B ---\n3 NBlInpSt - n\n1 AdjBlMs - f\nBlFract StrcTwst BMassDen\n(-) (-) (-)\n"
                                  + rows(BLADE[0], (5, 5, 5), BLADE[1]))
    (folder / "jacket.dat").write_text(subdyn(
        [" ".join(map(str, at)) for at in PLACE], [f"{a + 1} {b + 1} {k} {k} 1c 0" for a, b, k in ENDS],
        [f"{k} 1 1 1 1 1 1" for k in (1, 2, 3, 4)], interface=(9,), div=6,
        circular=[f"{k} {E} {G} {DENSITY} {d} {t}" for k, (d, t) in TUBES.items()]))
    (folder / "m.toml").write_text(
        f'[subdyn]\nfile = "jacket.dat"\n[tower]\nelastodyn = "ed.dat"\njoint = 9\nelements = {PIECES}\n'
        f"youngs_modulus_pa = {E}\nshear_modulus_pa = {G}\ndensity_kgpm3 = {TOWER_DENSITY}\n")
    return folder / "m.toml"


class Peer:
    """Nodes 0 to 8 are the joints'; a particle is a node of its own on a rigid link."""

    def __init__(self, ops):
        self.ops, self.at, self.count = ops, [], 0
        ops.wipe()
        ops.model("basic", "-ndm", 3, "-ndf", 6)

    def node(self, at):
        self.at.append(np.asarray(at, float))
        self.ops.node(len(self.at) - 1, *map(float, at))
        return len(self.at) - 1

    def beam(self, a, b, area, along_z, along_y, torsion, mass, across):
        self.count += 1
        self.ops.geomTransf("Linear", self.count, *map(float, across))
        self.ops.element("elasticBeamColumn", self.count, a, b, area, E, G, torsion, along_z, along_y, self.count,
                         "-mass", mass, "-cMass")

    def particle(self, on, at, kg, spin=0.0):
        node = self.node(at)
        self.ops.rigidLink("beam", on, node)
        self.ops.mass(node, *[float(kg)] * 3, 1e-6, 1e-6, float(spin) + 1e-6)


def structure(peer):
    for at in PLACE:
        peer.node(at)
    for k in range(4):
        peer.ops.fix(k, *[1] * 6)
    for a, b, kind in ENDS:
        d, t = TUBES[kind]
        area, second = math.pi * t * (d - t), math.pi / 64 * (d**4 - (d - 2 * t) ** 4)
        way = peer.at[b] - peer.at[a]
        across = np.cross(way, np.eye(3)[np.argmin(np.abs(way))])
        nodes = [a, *(peer.node(peer.at[a] + way * k / 6) for k in range(1, 6)), b]
        for one, two in zip(nodes[:-1], nodes[1:], strict=True):
            peer.beam(one, two, area, second, second, 2 * second, DENSITY * area, across)
    top = 8
    for k in range(PIECES):
        below, top = top, peer.node((0, 0, BASE_M + (TOP_M - BASE_M) * (k + 1) / PIECES))
        mass, fa, ss = (float(np.interp((k + 0.5) / PIECES, STATIONS[0], column)) for column in STATIONS[1:])
        peer.beam(below, top, mass / TOWER_DENSITY, fa / E, ss / E, (fa + ss) / E, mass, (1, 0, 0))
    return top


def bodies(peer, top):
    size, axes = np.linalg.eigh(PLATFORM)
    for k in range(3):
        reach = math.sqrt(3 * (size.sum() / 2 - size[k]) / PLATFORM_KG)
        for side in (reach, -reach):
            peer.particle(8, PLATFORM_M + side * axes[:, k], PLATFORM_KG / 6)
    yaw, tilt, cone = (math.radians(a) for a in (YAW, TILT, CONE))
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    shaft, up = np.array([math.cos(tilt), 0, math.sin(tilt)]), np.array([-math.sin(tilt), 0, math.cos(tilt)])
    apex = np.array([0, 0, 1.7]) - 4.1 * shaft
    around_yaw = 2.3e6 - 213e3 * (1.4**2 + 0.3**2)
    places = [((0, 0, 0), 4e3, around_yaw), ((1.4, 0.3, 1.6), 213e3, 0.0), (apex + 0.4 * shaft, 47e3, 0.0)]
    share = (np.arange(100) + 0.5) / 100
    for blade in range(3):
        angle = 2 * math.pi * blade / 3
        along = math.cos(cone) * (math.cos(angle) * up + math.sin(angle) * np.array([0, 1, 0])) + math.sin(
            cone) * shaft
        places += [(apex + (1.3 + 56.7 * s) * along, 0.567 * np.interp(s, *BLADE), 0.0) for s in share]
        places.append((apex + 58.0 * along, 10.0 * (blade + 1), 0.0))
    for at, kg, spin in places:
        peer.particle(top, np.array([0, 0, TOP_M]) + turn @ at, kg, spin)


def test_a_yawed_turbine_on_its_platform_is_that_of_particles(tmp_path, validation):
    row = validation(what="a frame with ElastoDyn's platform (products of inertia, off the axis) and turbine (yaw, "
                          "tilt, cone): five frequencies", reference="OpenSees, bodies as particles on rigid links",
                     why="it leaves rotary inertia out")
    try:
        ops = opensees_loader.load_opensees()
    except (ImportError, OSError) as error:
        pytest.skip(f"OpenSees cannot be loaded: {error}")
    own = probupdate.model_modes(write(tmp_path), 5).frequency_hz
    peer = Peer(ops)
    bodies(peer, structure(peer))
    ops.constraints("Transformation")
    ops.numberer("RCM")
    ops.system("UmfPack")
    theirs = np.sqrt(ops.eigen("-genBandArpack", 5)) / (2 * np.pi)
    ops.wipe()
    row.error(own / theirs - 1, below=6e-4)
