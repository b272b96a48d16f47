"""Packages of requirements.lock, their licences by their own metadata, and what an audit of them for known weaknesses says.

    python studies/supply_chain/licences.py [pip-audit]

Writes PACKAGES.md beside this file. `pip-audit`: the path of that program; without it, or where it reaches no data base,
the table says so, with the date.
"""

from __future__ import annotations

import datetime
import json
import re
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).resolve().parent
LOCK = HERE.parents[1] / "requirements.lock"


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
    classified = [c.rpartition("::")[2].strip() for c in about.get_all("Classifier") or [] if c.startswith("License ::")]
    field = (about.get("License") or "").strip()
    text = about.get("License-Expression") or (field if 0 < len(field) < 60 and "\n" not in field else "")
    return about["Version"], text or ", ".join(classified) or field.splitlines()[0][:60] if field or text or classified else "-"


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
            told = f"not audited: {row['skip_reason']}" if "skip_reason" in row else (
                ", ".join(v["id"] for v in row["vulns"]) or "nothing known")
            said.setdefault(row["name"], []).append(told)
    skipped = all("not audited" in text for texts in said.values() for text in texts)
    return {} if skipped else {name: "; ".join(dict.fromkeys(texts)) for name, texts in said.items()}


def main() -> None:
    packages, today = locked(), datetime.datetime.now(datetime.UTC).date().isoformat()
    found = audit(sys.argv[1], packages) if len(sys.argv) > 1 else {}
    state = "answered" if found else "the data base of weaknesses was not reachable" if len(sys.argv) > 1 else "not run"
    lines = ["# Packages that are installed with probupdate", "",
             f"Made by `studies/supply_chain/licences.py` from requirements.lock and the packages' own metadata, {today}.",
             f"Audit for known weaknesses (pip-audit) on {today}: {state}.", "",
             "| package | locked | installed | licence | audit |", "|---|---|---|---|---|"]  # fmt: skip
    for name, versions in packages.items():
        installed, text = licence(name)
        lines.append(f"| {name} | {', '.join(versions)} | {installed} | {text} | {found.get(name, 'not reachable, ' + today)} |")
    (HERE / "PACKAGES.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
