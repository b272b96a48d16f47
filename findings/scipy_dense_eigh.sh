#!/usr/bin/env bash
# scipy 1.17.1, linalg.eigh(K, M): the first frequency of a finely meshed beam is wrong in the third or fourth digit.
# Expected: a dense solution is at least as accurate as an iterative one; 1000 Bernoulli-Euler elements of a cantilever
#   give the closed-form frequency to far better than 1e-6.
# Seen (error of the first frequency): driver gvd -0.04 %, driver gvx +0.48 %; shift and invert (eigsh, sigma=0) 2e-6.
#   With 50 elements all are below 1e-7, so refining the mesh makes the answer worse. No warning, no error.
# Reason: the largest eigenvalue grows with n^4, and the dense route is accurate relative to that one.
# Consequence: a "mesh convergence study" ends in rounding; 0.5 % is several standard deviations of a measured frequency.
# probupdate: large matrices go through shift and invert, and each mode is checked by its residual and refined. To check:
#   how the frequencies of a model from elsewhere were solved for.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check scipy==1.17.1 numpy==2.3.5
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from scipy.linalg import eigh
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import eigsh

LENGTH, EI, MASS = 100.0, 1e11, 5000.0
EXACT = 1.8751040687**2 * np.sqrt(EI / MASS / LENGTH**4)


def cantilever(n):
    h = LENGTH / n
    k = EI / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                              [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]])
    m = MASS * h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                                   [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]])
    K, M = np.zeros((2, 2 * n + 2, 2 * n + 2))
    for i in range(n):
        dof = slice(2 * i, 2 * i + 4)
        K[dof, dof] += k
        M[dof, dof] += m
    return K[2:, 2:], M[2:, 2:]


def errors(n):
    K, M = cantilever(n)
    lowest = (eigh(K, M, eigvals_only=True, driver="gvd")[0],
              eigh(K, M, eigvals_only=True, driver="gvx", subset_by_index=[0, 1])[0],
              eigsh(csc_matrix(K), 2, csc_matrix(M), sigma=0, return_eigenvectors=False).min())
    return [np.sqrt(value) / EXACT - 1 for value in lowest]


coarse, fine = errors(50), errors(1000)
for name, error in ("50 elements", coarse), ("1000 elements", fine):
    print(f"{name}: gvd {error[0]:+.1e}, gvx {error[1]:+.1e}, shift and invert {error[2]:+.1e}")
assert np.max(np.abs(coarse)) < 1e-6
assert max(abs(fine[0]), abs(fine[1])) > 2e-4
assert abs(fine[2]) < 2e-5
PYTHON
cd "$work"
venv/bin/python run.py
