#!/usr/bin/env bash
# asammdf 8.8.28, MDF.get: samples that the file marks as invalid are left out.
# Expected: a channel of 100 samples, one of them marked as invalid, gives 100 with the mark.
# Seen: 99 samples by default; the neighbour on the same raster gives 100, so rows no longer belong together.
# Consequence: two channels put side by side by row are one sample apart after the first lost one.
# probupdate: asks for all samples and sets marked ones to NaN. To do elsewhere: ignore_invalidation_bits=True.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check asammdf==8.8.28
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from asammdf import MDF, Signal

time, invalid = np.arange(100) / 10, np.zeros(100, bool)
invalid[5] = True
with MDF(version="4.10") as file:
    file.append([Signal(np.arange(100.0), time, name="whole"),
                 Signal(np.arange(100.0), time, name="marked", invalidation_bits=invalid)])
    file.save("r.mf4")
with MDF("r.mf4") as file:
    whole, marked = (file.get(name).samples for name in ("whole", "marked"))
    every = file.get("marked", ignore_invalidation_bits=True).samples
print(f"whole {len(whole)} samples, marked {len(marked)}, with ignore_invalidation_bits {len(every)}; row 5: "
      f"{whole[5]:g} beside {marked[5]:g}")
assert (len(whole), len(marked), len(every)) == (100, 99, 100)
assert whole[5] == 5 and marked[5] == 6
PYTHON
cd "$work"
venv/bin/python run.py
