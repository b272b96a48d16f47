"""Every study by one command: `python -m studies.NAME --out DIR [--quick]`, options of its script behind `--`.

The scripts of a study stay as they are; this table says which are run, in which order, with which arguments. What they
print goes to the terminal and into DIR/printed.txt; DIR/study.json says commit, seed, machine and time of the run.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
OUT = "{out}"


@dataclass(frozen=True, kw_only=True)
class Study:
    """question: what it answers; runs: scripts with their arguments, in order; quick: the same in minutes, empty where
    there is no short form; seeds: where the numbers begin; takes: how long, on two cores; data: files that are not part
    of the repository."""

    question: str
    runs: tuple[tuple[str, ...], ...]
    quick: tuple[tuple[str, ...], ...] = ()
    seeds: str
    takes: str
    data: str = ""


STUDIES = {
    "anchors": Study(
        question="Do posteriors agree with quadrature and with a published example?",
        runs=(("frame.py",),), quick=(("frame.py",),), seeds="1", takes="minutes"),
    "blind": Study(
        question="How often is a hidden effect detected and named rightly, and how often is there a false alarm?",
        runs=(("run.py", OUT), ("tables.py", OUT), ("signatures.py",)),
        quick=(("run.py", OUT, "--families", "null", "--most", "2"), ("signatures.py", "--each", "1")),
        seeds="the number of the case", takes="hours"),
    "calibration": Study(
        question="Do 90 % credible intervals contain the truth in 90 %?",
        runs=(("run.py", OUT, "--case", "own-paper-normal", "--case", "turbine-record-normal"), ("tables.py", OUT)),
        quick=(("run.py", OUT, "--case", "own-paper-normal", "--replicates", "2"),),
        seeds="the number of the replicate", takes="hours"),
    "discovery": Study(
        question="Are three faults in one month found, and what does knowing them gain?",
        runs=(("run.py", OUT),), seeds="7", takes="minutes"),
    "drawn": Study(
        question="Do all commands work on structures that nobody drew by hand, and what does the diagnosis name there?",
        runs=(("run.py", OUT),), quick=(("run.py", OUT, "--kinds", "matrices truss", "--classes", "null", "structural",
                                         "--most", "1"),),
        seeds="the number of the case", takes="hours"),
    "farm": Study(
        question="How many turbine-months an hour, and what does a year of 70 turbines take?",
        runs=(("run.py", OUT), ("joint.py", OUT), ("joint_cost.py", OUT),
              ("faults.py", f"{OUT}/faults")),
        quick=(("run.py", OUT, "--days", "0.2", "--turbines", "2", "--workers", "1"),
               ("joint.py", OUT, "--farms", "4")),
        seeds="1 to 4, of drawn farms 0 to 199", takes="half an hour"),
    "faults": Study(
        question="What is lost where the machine fails while a command writes?",
        runs=(("faults.py", OUT, "48213"), ("fuzz_inputs.py", OUT, "48213", "600")),
        quick=(("faults.py", OUT, "48213", "select"),), seeds="48213",
        takes="an hour"),
    "footbridge": Study(
        question="Does a measured bridge, given as matrices, come out as published?",
        runs=(("run.py", OUT),), seeds="1", takes="three minutes", data="shared/data/footbridge beside the repository"),
    "iasc_asce": Study(
        question="Which braces of the IASC-ASCE benchmark frame does the diagnosis name?",
        runs=(("run.py", OUT),), quick=(("run.py", OUT, "--quick"),), seeds="1 to 20", takes="hours"),
    "identification": Study(
        question="How well are modes found, beside the paper's classifier, and how near to the bound of their scatter?",
        runs=(("run.py", OUT, "--days", "1"), ("limit.py", f"{OUT}/limit")),
        quick=(("run.py", OUT, "--days", "0.1"),
               ("limit.py", f"{OUT}/limit", "--seeds", "101", "101", "--records", "4")),
        seeds="1, 3; 101 to 110", takes="minutes"),
    "lifetime": Study(
        question="From a posterior to remaining life: is its uncertainty calibrated?",
        runs=(("calibration.py", OUT), ("time_domain.py", f"{OUT}/time")),
        quick=(("calibration.py", OUT, "--turbines", "1", "--minutes", "2"),),
        seeds="the number of the turbine", takes="25 minutes a case at most",
        data="`pip install rainflow` for time_domain.py"),
    "measured_frame": Study(
        question="Is the braced storey of a measured frame named from a uniform model, and what stands in the way?",
        runs=(("run.py", OUT),), quick=(("run.py", OUT, "--discrepancy", "1"),), seeds="1", takes="three minutes",
        data="shared/data/weimar_frame beside the repository"),
    "month": Study(
        question="What do a month's records cost, killed and resumed, and the blocks of a year?",
        runs=(("run.py", OUT, "--days", "30"), ("year.py", f"{OUT}/year", "--blocks", "500", "1500", "4500")),
        quick=(("run.py", OUT, "--days", "0.2"), ("year.py", f"{OUT}/year", "--blocks", "30", "60")), seeds="7, 1",
        takes="25 minutes"),
    "oc4": Study(
        question="Does the whole job work on an OpenFAST model, measured on another theory?",
        runs=(("run.py", OUT),), quick=(("run.py", OUT, "--hours", "6"),), seeds="1, 2", takes="minutes",
        data="shared/reference/oc4 beside the repository"),
    "oc4_jacket": Study(
        question="What does the diagnosis name on the OC4 jacket solved by OpenSees, its SubDyn file as the model?",
        runs=(("run.py", OUT),), quick=(("run.py", OUT, "--quick"),), seeds="the number of the case",
        takes="half an hour", data="shared/reference/oc4 beside the repository"),
    "other_worlds": Study(
        question="What does the diagnosis say of structures drawn at random, by equations that are not the package's?",
        runs=(("run.py", OUT),), quick=(("run.py", OUT, "--quick"),), seeds="the number of the record",
        takes="half an hour"),
    "peers": Study(
        question="Are modes and standard deviations those of pyOMA2 1.4.3, on one drawn record?",
        runs=(("run.py", OUT),), quick=(("run.py", OUT, "--blocks", "2"),), seeds="7", takes="minutes"),
    "performance": Study(
        question="How fast are modes, identification, diagnosis and sampling?",
        runs=(("benchmark_modal.py",), ("benchmark_identification.py",), ("benchmark_data_first.py",),
              ("benchmark_diagnosis.py",), ("benchmark_sampler.py",), ("benchmark_report.py", f"{OUT}/demo"),
              ("benchmark_executors.py", f"{OUT}/demo"), ("benchmark_memory.py", f"{OUT}/demo")),
        quick=(("benchmark_identification.py",),), seeds="1, 3", takes="minutes"),
    "reference_turbine": Study(
        question="How near do the reference turbine's files come to the paper's Tables 3, 4 and 6?",
        runs=(("compare.py",),), quick=(("compare.py",),), seeds="-", takes="15 seconds"),
    "sensors": Study(
        question="Which faults of sensors does `check` find without a model?",
        runs=(("measure_rates.py",),), quick=(("measure_rates.py", "--days", "1"),), seeds="931 on",
        takes="minutes"),
    "stresses": Study(
        question="Are stresses from 18 accelerometers those of the structure, where another program solves it?",
        runs=(("run.py", OUT),), seeds="1", takes="ten minutes",
        data="shared/reference/oc4 beside the repository; `pip install rainflow`"),
    "supply_chain": Study(
        question="Which packages come with probupdate, of which age and licence?",
        runs=(("licences.py", OUT),), quick=(("licences.py", OUT),), seeds="-", takes="seconds",
        data="the wheels of requirements.lock, downloaded into DIR"),
    "wikinger": Study(
        question="How do the paper's Tables 1 to 7 and Figs. 3 to 7 come out?",
        runs=(("run.py", OUT),), quick=(("run.py", OUT, "--days", "0.5"),), seeds="1",
        takes="7 minutes of processor time"),
}


def provenance(name: str, study: Study, runs, seconds: float) -> dict:
    """What a page of results has to state: commit, seed, machine, time."""
    found = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=HERE, capture_output=True, text=True)
    return {
        "study": name, "commit": found.stdout.strip() or "unknown", "seeds": study.seeds,
        "runs": [list(run) for run in runs], "seconds": round(seconds, 1),
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count(),
    }


def main(name: str, arguments: list[str] | None = None) -> int:
    study = STUDIES[name]
    parser = argparse.ArgumentParser(
        prog=f"python -m studies.{name}", formatter_class=argparse.RawDescriptionHelpFormatter,
        description=f"{study.question}\n\n" + "\n".join(f"runs {' '.join(run)}" for run in study.runs),
        epilog=f"Takes {study.takes}; seeds {study.seeds}."
        + (f" Needs {study.data}." if study.data else "")
        + f" What it is and what came out: studies/{name}/.")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    parser.add_argument("--quick", action="store_true", help="a short form: that it runs, not its numbers")
    parser.add_argument("more", nargs="*", metavar="-- OPTION", help="options of the study's first script")
    a = parser.parse_args(arguments)
    if a.quick and not study.quick:
        parser.error(f"{name} has no short form; leave --quick out")
    out = a.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    runs = [list(run) for run in (study.quick if a.quick else study.runs)]
    runs[0] += a.more
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")]),
                                "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    begun = time.monotonic()
    with open(out / "printed.txt", "w", encoding="utf-8") as printed:
        for script, *options in runs:
            words = [sys.executable, str(HERE / name / script), *(x.replace(OUT, str(out)) for x in options)]
            with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment) as job:
                for line in job.stdout:
                    sys.stdout.write(line)
                    sys.stdout.flush()
                    printed.write(line)
            if job.returncode:
                sys.stderr.write(f"studies.{name}: {script} ended with exit code {job.returncode}\n")
                return job.returncode
    content = provenance(name, study, runs, time.monotonic() - begun)
    (out / "study.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return 0
