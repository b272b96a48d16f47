#!/usr/bin/env bash
# npTDMS 1.13.0, as_dataframe: channels of unlike sampling rates stand row beside row.
# Expected: a table of an accelerometer at 100 Hz and a SCADA signal at 10 Hz either keeps the times or refuses.
# Seen: row 5 holds the accelerometer at 0.05 s beside the signal at 0.5 s; the slow channel ends in NaN after a tenth of
#   the rows. The times are in the file (wf_increment), and with time_index=True the table has them, but not by default.
# Consequence: a CSV written from this table shows the slow channel tenfold compressed; a step of the power at 0.5 s
#   appears at 0.05 s, and a record is regressed on conditions that were measured later.
# probupdate: converts records of one rate a file. To check in tables from elsewhere: columns that end in NaN at one row.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check npTDMS==1.13.0 numpy==2.3.5 pandas==2.3.3
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import io

import numpy as np
from nptdms import ChannelObject, TdmsFile, TdmsWriter

start = np.datetime64("2026-01-01T00:00:00")
file = io.BytesIO()
with TdmsWriter(file) as writer:
    writer.write_segment([
        ChannelObject("tower", "acceleration", 0.01 * np.arange(100),
                      {"wf_increment": 0.01, "wf_start_time": start, "wf_start_offset": 0.0}),
        ChannelObject("tower", "power", 0.1 * np.arange(10),
                      {"wf_increment": 0.1, "wf_start_time": start, "wf_start_offset": 0.0}),
    ])
file.seek(0)
# every value is the time at which it was measured
table = TdmsFile.read(file).as_dataframe().to_numpy()
print(f"row 5: {table[5, 0]:.2f} s beside {table[5, 1]:.2f} s; rows of the slow channel {np.isfinite(table[:, 1]).sum()}")
assert table.shape == (100, 2)
assert np.isclose(table[5, 0], 0.05) and np.isclose(table[5, 1], 0.5)
assert np.isfinite(table[:, 1]).sum() == 10
PYTHON
cd "$work"
venv/bin/python run.py
