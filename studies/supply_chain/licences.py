"""Packages of requirements.lock, their licences by their own metadata, the dates of their wheels, and what an audit of
them for known weaknesses says.

    pip download --no-deps --require-hashes -r requirements.lock -d WHEELS
    python studies/supply_chain/licences.py WHEELS [pip-audit]

Writes WHEELS/RESULTS.md, of which the one beside this file is a copy. A wheel's date is that of its newest member;
where its builder writes the same date into all, none is stated. `pip-audit`: the path of that program; without it, or
where it reaches no data base, the table says so.
"""

from __future__ import annotations

import datetime
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).resolve().parent
LOCK = HERE.parents[1] / "requirements.lock"
# the least that an archive can hold, and what flit and hatchling write whatever the day
CONSTANT = {"1980-01-01", "2016-01-01", "2020-02-02"}


def locked() -> dict[str, list[str]]:
    """Name -> versions; more than one where they depend on Python's."""
    found: dict[str, list[str]] = {}
    for name, version in re.findall(r"^([A-Za-z0-9_.-]+)==([^\s;\\]+)", LOCK.read_text(encoding="utf-8"), re.MULTILINE):
        found.setdefault(name, []).append(version)
    return found


def licence(name: str) -> tuple[str, str]:
    """(installed version, licence) of a package; the licence's short name where its text stands in the field."""
    try:
        about = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        return "not installed here", "-"
    classified = [c.rpartition("::")[2].strip() for c in about.get_all("Classifier") or []
                  if c.startswith("License ::")]
    field = (about.get("License") or "").strip()
    text = about.get("License-Expression") or (field if 0 < len(field) < 60 and "\n" not in field else "")
    said = text or ", ".join(classified) or field.splitlines()[0][:60] if field or text or classified else "-"
    return about["Version"], said


def dates(folder: Path) -> dict[tuple[str, str], str]:
    """(name, version) -> date of the wheel."""
    found = {}
    for path in folder.glob("*.whl"):
        with zipfile.ZipFile(path) as wheel:
            day = "{:04d}-{:02d}-{:02d}".format(*max(m.date_time for m in wheel.infolist())[:3])
        name, version = path.name.split("-")[:2]
        found[re.sub("[-_.]+", "-", name).lower(), version] = "not stated" if day in CONSTANT else day
    return found


def audit(program: str, packages: dict[str, list[str]]) -> dict[str, str]:
    """Name -> what the audit says of all its versions; empty where no data base is reached."""
    said: dict[str, list[str]] = {}
    for turn in range(max(map(len, packages.values()))):
        chosen = {name: versions[turn] for name, versions in packages.items() if len(versions) > turn}
        with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
            file.write("".join(f"{n}=={v}\n" for n, v in chosen.items()))
            file.flush()
            done = subprocess.run([program, "--no-deps", "--disable-pip", "-f", "json", "-r", file.name],
                                  capture_output=True, text=True)
        try:
            rows = json.loads(done.stdout)["dependencies"]
        except (ValueError, KeyError):
            return {}
        for row in rows:
            notes = f"not audited: {row['skip_reason']}" if "skip_reason" in row else (
                ", ".join(v["id"] for v in row["vulns"]) or "nothing known")
            said.setdefault(row["name"], []).append(notes)
    skipped = all("not audited" in text for texts in said.values() for text in texts)
    return {} if skipped else {name: "; ".join(dict.fromkeys(texts)) for name, texts in said.items()}


def main() -> None:
    packages, today = locked(), datetime.datetime.now(datetime.UTC).date().isoformat()
    dated = dates(Path(sys.argv[1]))
    found = audit(sys.argv[2], packages) if len(sys.argv) > 2 else {}
    state = "answered" if found else "no data base of weaknesses was reachable" if len(sys.argv) > 2 else "not run"
    lines = ["# Packages that are installed with probupdate", "",
             "Made by `studies/supply_chain/licences.py` from requirements.lock, the packages' own metadata and their "
             "wheels,",
             f"{today}. Audit for known weaknesses (pip-audit) on {today}: {state}.",
             "The dates say how old each is; a wheel of another Python was not downloaded (-).", "",
             "| package | locked | date of the wheel | installed | licence | audit |", "|---|---|---|---|---|---|"]
    for name, versions in packages.items():
        installed, text = licence(name)
        days = ", ".join(dated.get((re.sub("[-_.]+", "-", name).lower(), version), "-") for version in versions)
        lines.append(f"| {name} | {', '.join(versions)} | {days} | {installed} | {text} | "
                     f"{found.get(name, 'not reachable')} |")
    (Path(sys.argv[1]) / "RESULTS.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
