"""RESULTS.md of the trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from fault_inputs import UNTRIED

BAD = ("torn", "again_differs", "parts_left", "orphans", "traceback", "more_lines", "other_exit")


def table(lines_of: list[dict], faults: Iterable[str], planned: Counter[str]) -> str:
    """RESULTS.md of the lines that runs wrote. faults: in the order of the rows; planned: trials of each command."""
    skipped = Counter(one["command"] for one in lines_of if "skipped" in one["what"])
    lines_of = [one for one in lines_of if "skipped" not in one["what"]]

    def total(chosen: list[dict], key: str) -> int:
        return sum(int(one["what"].get(key, 0)) for one in chosen)

    def distinct(key: str) -> str:
        return ", ".join(dict.fromkeys(str(one[key]) for one in lines_of))

    verbs = list(dict.fromkeys(one["command"] for one in lines_of))
    kills = total(lines_of, "kills")
    met = sum(one["what"].get("met", 0) for one in lines_of if one["what"].get("kills"))
    out = [
        "# Faults of the machine", "",
        "**Question.** What is lost where the machine fails while a command writes?", "",
        "`python -m studies.faults --out DIR [--quick]`; what is tried and how stands at the head of `faults.py`.",
        "Power cuts, network folders and systems other than Linux are not tried.", "",
        f"Written by `studies/faults/faults.py`: commit {distinct('commit')}; seed {distinct('seed')};",
        f"{distinct('date')}; {distinct('machine')}.", "",
        f"{len(lines_of)} trials over {len(verbs)} commands, {kills} kills, of which {met} met a running command "
        "(others came after its end).",
        "A file is torn if it is neither absent, nor byte for byte that of an undisturbed run, nor (for files that "
        "state",
        "when they were made or how far a command is) a whole one. After each fault the command is given again; its "
        "files",
        "are compared with those of an undisturbed run. `refused` counts the second of two writers that ended with one",
        "line because of the first.", "",
        "| fault | commands | trials | kills | met a running command | torn files | differs when given again | "
        "`*.part` left after that | orphan processes | tracebacks | more than one line | another exit code | refused |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|"]
    for fault in faults:
        mine = [one for one in lines_of if one["fault"] == fault]
        if not mine:
            continue
        cells = [len({one["command"] for one in mine}), sum(one["what"].get("tried", 1) for one in mine),
                 total(mine, "kills") or "-", total(mine, "met") if any("met" in one["what"] for one in mine) else "-",
                 *(total(mine, key) for key in BAD), total(mine, "refused") or "-"]
        out.append(f"| {fault} | " + " | ".join(map(str, cells)) + " |")
    out += ["",
            "| command | processor time undisturbed, s | trials | kills that met it | trials with a fault of ours |",
            "|---|---|---|---|---|"]
    for verb in verbs:
        mine = [one for one in lines_of if one["command"] == verb]
        bad = sum(any(one["what"].get(key) for key in BAD) for one in mine)
        met = sum(one["what"].get("met", 0) for one in mine if one["what"].get("kills"))
        out.append(f"| {verb} | {mine[-1]['processor_s']:g} | {len(mine)} | {met} | {bad} |")
    short = [f"{verb} {sum(one['command'] == verb for one in lines_of)} of {number}" for verb, number in planned.items()
             if sum(one["command"] == verb for one in lines_of) + skipped[verb] < number]
    out += ["", f"Trials that were not reached (done, of planned): {', '.join(short) or 'none'}.",
            f"Commands that are not tried: {', '.join(UNTRIED) or 'none'}."]
    out += ["",
            "## Trials with a torn file, a difference, something left, a trace, more lines or another exit code", ""]
    for one in lines_of:
        found = {key: one["what"][key] for key in BAD if one["what"].get(key)}
        if found:
            words = " ".join(str(one["what"].get("words", "")).split())[-160:].replace("`", "'").replace("|", "/")
            out.append(f"- {one['command']}, {one['fault']} {one['number']} (commit {one['commit']}): "
                       + ", ".join(f"{k} {int(v)}" for k, v in found.items()) + (f": `{words}`" if words else ""))
    if out[-1] == "":
        out.append("None.")
    return "\n".join(out) + "\n"
