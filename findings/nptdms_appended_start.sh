#!/usr/bin/env bash
# npTDMS 1.13.0, properties of a channel: of a file that was appended to, the last start stands for all samples.
# Expected: a file to which a logger appended an hour later gives two starts, or says that it holds two recordings.
# Seen: one channel of 200 samples that starts an hour late; `time_track(absolute_time=True)` puts the first recording
#   there too, without the gap.
# Consequence: the first recording is dated wrongly, the second follows it without a break.
# probupdate: refuses a file that states several starts. To check elsewhere: one file per recording.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check npTDMS==1.13.0 numpy==2.3.5
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/run.py" <<'PYTHON'
import numpy as np
from nptdms import ChannelObject, TdmsFile, TdmsWriter

start = np.datetime64("2026-01-01T00:00:00")
for mode, hour in (("w", 0), ("a", 1)):
    own = {"wf_start_time": start + np.timedelta64(hour, "h"), "wf_start_offset": 0.0, "wf_increment": 0.1}
    with TdmsWriter("r.tdms", mode=mode) as writer:
        writer.write_segment([ChannelObject("g", "a", np.arange(100.0), own)])
channel = TdmsFile.read("r.tdms")["g"]["a"]
time = channel.time_track(absolute_time=True)
print(f"{len(channel)} samples from {time[0]} to {time[-1]}; written were 100 from {start} and 100 an hour later")
assert len(channel) == 200
assert time[0] == start + np.timedelta64(1, "h")
assert (time[-1] - time[0]) / np.timedelta64(1, "s") < 20
PYTHON
cd "$work"
venv/bin/python run.py
