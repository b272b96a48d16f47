"""Every command on a drawn case, as its user would type it: exit codes, last lines, and what was found."""

from __future__ import annotations

import contextlib
import io
import json
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from drawn.cases import Case, Scene, scene, write_modes
from drawn.records import write_campaign

DIAGNOSE = "diagnose"
FEW_SETS = 3
FEW_DRAWS = ("--ess", "40", "--max-steps", "60", "--ensembles", "2")


def run(words: list[str]) -> dict:
    """One command in this process: its exit code, the last line that it wrote on either stream, processor time."""
    from probupdate.cli import main

    out, err = io.StringIO(), io.StringIO()
    begun = time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
        except Exception:
            # what reaches here a terminal shows as a traceback
            code, last = 1, traceback.format_exc().strip().splitlines()
            err.write("\n" + " | ".join([*[x.strip() for x in last if "File" in x][-2:], last[-1]]))
    said = (err.getvalue() if code else out.getvalue() or err.getvalue()).strip().splitlines()
    return {"command": words[0], "code": code, "last": said[-1] if said else "", "cpu_s": round(
        time.process_time() - begun, 2)}


def from_records(s: Scene, model: list[str], folder: Path) -> list[list[str]]:
    """From CSV files to modes.json."""
    campaign = str(folder / "campaign")
    lowest = [] if s.drawn.is_turbine else ["--lowest", str(s.drawn.n_mode)]
    return [["convert", str(folder / "raw"), campaign], ["check", campaign],
            ["identify", campaign, *model, *lowest, "--jobs", "1", "--out", str(folder / "modes.json")]]


def steps(model: list[str], folder: Path, *, extend: bool) -> list[list[str]]:
    """From modes.json in `folder` to an export, in a user's order; `model`: arguments that name it."""
    name, data = model[1], ["--modes", str(folder / "modes.json")]

    def at(file):
        return str(folder / file)

    return [
        ["modes", name, "--count", "6", "--out", at("own.json")],
        ["select", at("modes.json"), "--out", at("nine.json")],
        ["figures", at("modes.json"), "--format", "svg", "--out", at("figures")],
        ["inform", *model, *data, "--out", at("information.json")],
        ["update", *model, *data, "--out", at("update.json")],
        ["sample", *model, *data, *FEW_DRAWS, "--out", at("posterior.nc")],
        ["compare", at("update.json"), at("posterior.nc"), *model, "--out", at("compare.json")],
        ["sets", *model, "--modes", at("few.json"), "--out", at("sets.json")],
        [DIAGNOSE, *model, *data, "--out", at("diagnosis.json"), *([] if extend else ["--no-extend"])],
        ["report", str(folder), *model, "--out", at("report.html")],
        ["export", str(folder), "--to", "lifetime", at("lifetime"), "--draws", "3", "--accept"],
    ]


def run_case(case: Case, folder: Path, *, only: tuple[str, ...] = (), extend: bool = True, raw: bool = False,
             after_each: Callable[[dict], None] = lambda line: None) -> dict:
    """A line of results: what every command said, and what the diagnosis found beside what is hidden. `only`: these
    commands; `raw`: from accelerations instead of modal sets; `after_each`: is given the line so far, before the first
    command and after each."""
    begun = time.process_time()
    s = scene(case)
    model = s.drawn.write(folder)
    before = []
    if raw:
        write_campaign(s, folder)
        before = from_records(s, model, folder)
    else:
        write_modes(s, folder / "modes.json")
    line = {"id": case.id + ("-raw" if raw else ""), "kind": case.kind, "class": case.hidden_class, "seed": case.seed,
            "title": s.drawn.title, "hidden": hidden_row(s), "truth_s": round(time.process_time() - begun, 1)}
    after = [w for w in steps(model, folder, extend=extend) if not only or w[0] in only]
    if not only and s.blocks[0].columns:
        after.append(["regress", str(folder / "modes.json"), "--out", str(folder / "regression.csv")])
    line["commands"] = []
    for words in (*before, *after):
        after_each(line | {"running": words[0]})
        if words[0] == "sets":
            _write_few(folder)
        line["commands"].append(run(words))
    return line | judged(s, folder / "diagnosis.json")


def _write_few(folder: Path) -> None:
    """Each set of those that `sets` updates takes as long as all of them together."""
    content = json.loads((folder / "modes.json").read_text(encoding="utf-8"))
    few = content | {"sets": content["sets"][:FEW_SETS]}
    (folder / "few.json").write_text(json.dumps(few), encoding="utf-8")


def hidden_row(s: Scene) -> dict | None:
    h = s.hidden
    if h is None:
        return None
    return {"name": h.name, "class": h.kind, "right": sorted(map(list, h.right)), "profile": h.profile,
            "size": h.size if h.size == h.size else None}


def judged(s: Scene, path: Path) -> dict:
    """silent; unexplained; right: the first finding is what is hidden; in the set: another finding or an alternative
    of one; ambiguous: none of several; wrong: another name. `limit`: the least of it that the diagnosis says it finds
    in such a record."""
    if not path.is_file():
        return {"verdict": None, "judged": "no diagnosis"}
    content = json.loads(path.read_text(encoding="utf-8"))
    findings = content["findings"]
    right = s.hidden.right if s.hidden else frozenset()
    named = [(f["cause"], f["location"]) for f in findings]
    others = [(a["cause"], a["location"]) for f in findings for a in f["alternatives"]]
    limits = [abs(x["size"]) for x in content["detectable_sizes"] if (x["cause"], x["location"]) in right
              and x["time_profile"] == s.hidden.profile and x["size"] is not None]
    if content["verdict"] == "none":
        word = "silent"
    elif content["verdict"] == "unexplained" or not findings:
        word = "unexplained"
    elif named[0] in right:
        word = "right"
    else:
        word = "in the set" if right & {*named, *others} else "wrong" if content["verdict"] == "named" else "ambiguous"
    return {"verdict": content["verdict"], "judged": word, "p": content["p_value"],
            "limit": min(limits) if limits else None,
            "findings": [{"cause": f["cause"], "location": f["location"], "profile": f["time_profile"],
                          "size": f["size"], "std": f["size_std"], "probability": f["posterior_probability"],
                          "alternatives": [[a["cause"], a["location"], a["posterior_probability"]]
                                           for a in f["alternatives"][:4]]} for f in findings[:4]]}
