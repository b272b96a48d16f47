#!/usr/bin/env bash
# op3-framework 1.0.0, pisa_pile_stiffness_6x6: the stiffness is that of a rigid pile.
# Expected: pile-head stiffness of a steel tube in the PISA springs, with the bending of the tube.
# Seen: the function takes neither wall thickness nor E. Its K_hh and K_rr are those of the same springs with an infinitely
#   stiff pile (to 0.2 %). A tube of 8 m x 80 mm, 32 m deep in clay (G 20 to 80 MPa) with its bending is softer 2.7 times
#   (K_hh) and 10 times (K_rr); in sand, 64 m deep, 3.4 and 47 times.
# Consequence: as the SSI file of a monopile the first frequency is that of a tower on a much stiffer foundation, and an
#   update puts the difference into soil or tower.
# probupdate: computes the pile as a beam on its springs. To check in an SSI file: whether the pile's EI was in it.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.3.5 PyYAML==6.0.3 pandas==2.3.3 scipy==1.17.1
"$work/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps op3-framework==1.0.0
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from op3.standards.pisa import SoilState, pisa_coeffs, pisa_pile_stiffness_6x6


def beam_on_springs(diameter, length, wall, soil, modulus, n=400):
    """Head stiffness (2, 2) of horizontal force and moment: cubic beam elements, springs by two Gauss points each."""
    EI = modulus * np.pi / 64 * (diameter**4 - (diameter - 2 * wall) ** 4)
    h, kind = length / n, soil[0].soil_type
    depths, moduli = [s.depth_m for s in soil], [s.G_Pa for s in soil]
    K = np.zeros((2 * n + 2, 2 * n + 2))
    bending = EI / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                                    [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]])
    for i in range(n):
        k = bending.copy()
        for x in 0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3):
            z = (i + x) * h
            G = np.interp(z, depths, moduli)
            lateral = max(pisa_coeffs("lateral_p", kind, z_over_D=z / diameter)["k"], 0) * G
            moment = max(pisa_coeffs("moment_m", kind, z_over_D=z / diameter)["k"], 0) * G * diameter**2
            shape = np.array([1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2)])
            slope = np.array([6 * (x**2 - x) / h, 1 - 4 * x + 3 * x**2, 6 * (x - x**2) / h, 3 * x**2 - 2 * x])
            k += h / 2 * (lateral * np.outer(shape, shape) + moment * np.outer(slope, slope))
        K[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += k
    G = np.interp(length, depths, moduli)
    K[-2, -2] += max(pisa_coeffs("base_shear", kind, L_over_D=length / diameter)["k"], 0) * G * diameter
    K[-1, -1] += max(pisa_coeffs("base_moment", kind, L_over_D=length / diameter)["k"], 0) * G * diameter**3
    return K[:2, :2] - K[:2, 2:] @ np.linalg.solve(K[2:, 2:], K[2:, :2])


for kind, strength, length, least in (("clay", 100e3, 32.0, (2.3, 8.0)), ("sand", 36.0, 64.0, (3.0, 35.0))):
    soil = [SoilState(0.0, 20e6, strength, kind), SoilState(length, 80e6, strength, kind)]
    seen = np.diag(pisa_pile_stiffness_6x6(8.0, length, soil))[[0, 4]]
    steel = seen / np.diag(beam_on_springs(8.0, length, 0.08, soil, 210e9))
    rigid = seen / np.diag(beam_on_springs(8.0, length, 0.08, soil, 210e14))
    print(f"{kind}, {length} m: K_hh, K_rr over those of the steel tube {steel.round(2)}, of a rigid pile {rigid.round(4)}")
    assert np.all(np.abs(rigid - 1) < 0.01)
    assert np.all(steel > least)
PYTHON
cd "$work"
venv/bin/python run.py
