#!/usr/bin/env bash
# pyOMA_2 1.4.3: importing its algorithms switches numpy's warnings off for the whole program.
# Expected: an import changes nothing for others; 1/0 and 0/0 of arrays warn.
# Seen: after `import pyoma2.algorithms` numpy.geterr() has divide and invalid at 'ignore'; dividing by zero is silent.
# Consequence: NaN and infinite numbers in the user's own code, or another package's, go unnoticed.
# probupdate: changes no global state; its tests import pyOMA2 within numpy.errstate, which puts the settings back.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check pyOMA_2==1.4.3
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import warnings

import numpy as np


def warned():
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        np.zeros(2) / np.zeros(2)
    return len(seen)


before, first = np.geterr(), warned()
import pyoma2.algorithms  # noqa: E402, F401

print(f"before {before['divide']}, {before['invalid']}; after {np.geterr()['divide']}, {np.geterr()['invalid']}")
assert first == 1 and warned() == 0
PYTHON
cd "$work"
venv/bin/python run.py 2>/dev/null
