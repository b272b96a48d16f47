"""Tables of the blind study from its lines: rates with exact binomial intervals, and who is taken for whom."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

import numpy as np
from scipy import stats

# a cause is named from this probability
SURE = 0.95
# a limit is the size found nine times of ten
POWER = float(stats.norm.ppf(0.9))
# the simulator's size is per unit of its own amplitude, the catalogue's per m/s2
OWN_UNIT = ("soil softens with amplitude",)


def interval(hits: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper & Pearson 1934."""
    tail = (1 - level) / 2
    low = stats.beta.ppf(tail, hits, n - hits + 1) if hits else 0.0
    high = stats.beta.ppf(1 - tail, hits + 1, n - hits) if hits < n else 1.0
    return float(low), float(high)


def rate(name: str, hits: int, n: int) -> str:
    if not n:
        return f"| {name} | - | no case | |"
    low, high = interval(hits, n)
    return f"| {name} | {hits} of {n} | {100 * hits / n:.1f} % | {100 * low:.1f} to {100 * high:.1f} % |"


def is_named(finding: dict, effect: dict) -> bool:
    return finding["cause"] == effect["cause"] and finding["location"] == effect["location"]


def rightly_named(line: dict) -> bool:
    """Whether every finding of a record was hidden in it: a second one that is not there is a wrong name too."""
    return bool(line["findings"]) and all(any(is_named(f, e) for e in line["effects"]) for f in line["findings"])


def in_set(finding: dict, effect: dict) -> bool:
    """Named, or among the alternatives that an ambiguous finding lists."""
    return is_named(finding, effect) or any(
        cause == effect["cause"] and where == effect["location"] for cause, where in finding["alternatives"])


def profile_of(effect: dict, stated: dict[str, float]) -> str | None:
    """The row of the stated limits that the effect belongs to."""
    head = f"{effect['cause']} | {effect['location']} | "
    if effect["time_profile"] != "own":
        return head + effect["time_profile"] if head + effect["time_profile"] in stated else None
    return next((key for key in stated if key.startswith(head)), None)


def above_limit(line: dict, effect: dict) -> bool:
    """Whether the diagnosis of this very record states that it would find an effect of this size."""
    if "limits" not in line:
        # lines that keep the answer for the hundreds of limits
        return effect["above_stated_limit"]
    key = profile_of(effect, line["limits"])
    limit = line["limits"].get(key) if key else None
    return limit is not None and np.isfinite(limit) and abs(effect["size"]) >= abs(limit)


def stated_power(line: dict, effect: dict) -> float | None:
    """With what probability the diagnosis of this very record states that it finds an effect of this size: its score
    is normal about the threshold and POWER at the limit; None where sizes cannot be compared."""
    if "limits" not in line or effect["cause"] in OWN_UNIT:
        return None
    limit = line["limits"].get(profile_of(effect, line["limits"]) or "")
    if limit is None:
        return None
    expected = abs(effect["size"] / limit) * (line["threshold"] + POWER)
    return float(stats.norm.cdf(expected - line["threshold"]))


def distinguishable(effect: dict) -> bool | None:
    """Whether the effect can be told from its nearest alternative as surely as a name asks for; None: not known."""
    return None if effect.get("apart") is None else bool(effect["apart"] >= np.log(SURE / (1 - SURE)))


def own_name(line: dict, held=in_set) -> bool:
    """Whether a hidden crosstalk was found as that one; nothing else of the family has a name."""
    hidden = line["hidden"][0]
    if hidden["kind"] != "crosstalk" or len(line["findings"]) != 1:
        return False
    return held(line["findings"][0], {"cause": "crosstalk", "location": f"{hidden['other']} into {hidden['channel']}"})


def summary(lines: list[dict]) -> str:
    failed = [x for x in lines if "failed" in x]
    lines = [x for x in lines if "failed" not in x]
    by = {family: [x for x in lines if x["family"] == family] for family in dict.fromkeys(x["family"] for x in lines)}
    out = ["| what | cases | rate | 95 % interval |", "|---|---|---|---|"]
    null = by.get("null", [])
    out.append(rate("false alarms on nulls", sum(x["verdict"] != "none" for x in null), len(null)))
    month = by.get("month", [])
    out.append(rate("false alarms on months of 400 sets in all states", sum(x["verdict"] != "none" for x in month),
                    len(month)))
    single = by.get("single", [])
    seen = [x for x in single if above_limit(x, x["effects"][0])]
    found = [x for x in single if x["verdict"] != "none"]
    sure = [x for x in found if x["verdict"] == "named"]
    out.append(rate("singles above the stated limit detected", sum(x["verdict"] != "none" for x in seen), len(seen)))
    first = {x["id"] for x in found if x["findings"] and is_named(x["findings"][0], x["effects"][0])}
    held = {x["id"] for x in found if x["findings"] and in_set(x["findings"][0], x["effects"][0])}
    out.append(rate("detected singles: right cause and place first", len(first), len(found)))
    out.append(rate("detected singles: in the named set", len(held), len(found)))
    # distinguishable.py has been there
    for words, ids in (("that can be distinguished from the nearest alternative",
                        {x["id"] for x in found if distinguishable(x["effects"][0])}),
                       ("that cannot", {x["id"] for x in found if distinguishable(x["effects"][0]) is False})):
        out.append(rate(f"detected singles {words}: right first", len(first & ids), len(ids)))
        out.append(rate(f"detected singles {words}: in the named set", len(held & ids), len(ids)))
    out.append(rate("verdict 'named' and all findings right", sum(map(rightly_named, sure)), len(sure)))
    sized = [(x["findings"][0], x["effects"][0]) for x in found if x["findings"]
             and x["effects"][0]["cause"] not in OWN_UNIT and is_named(x["findings"][0], x["effects"][0])
             and x["findings"][0]["size_std"] > 0]
    out.append(rate("size within its 90 % interval",
                    sum(abs(abs(f["size"]) - abs(e["size"])) < 1.645 * f["size_std"] for f, e in sized), len(sized)))
    outside = by.get("outside", [])
    out.append(rate("outside the rows that are searched: no wrong name",
                    sum(x["verdict"] != "named" or own_name(x, is_named) for x in outside), len(outside)))
    own = [x for x in outside if own_name(x)]
    out.append(rate("  of these called what they are (crosstalk)", len(own),
                    sum(x["hidden"][0]["kind"] == "crosstalk" for x in outside)))
    out.append(rate("  the same without the adequacy test", sum(not x["taken_in"] for x in outside), len(outside)))
    pair = by.get("pair", [])
    both = [x for x in pair if all(any(in_set(f, e) for f in x["findings"]) for e in x["effects"])]
    out.append(rate("pairs: both in the named sets", len(both), len(pair)))
    seen = [x["id"] for x in pair if all(above_limit(x, e) for e in x["effects"])]
    out.append(rate("pairs above both limits: both in the named sets",
                    sum(x["id"] in seen for x in both), len(seen)))
    powers = {x["id"]: [stated_power(x, e) for e in x["effects"]] for x in pair}
    known = {name: float(np.prod(own)) for name, own in powers.items() if None not in own}
    expected = f"{sum(known.values()):.1f} expected of these"
    out.append(rate(f"pairs whose limits are stated, {expected}: both in the named sets",
                    sum(x["id"] in known for x in both), len(known)))
    twin = [x for x in by.get("twin", []) if x["verdict"] != "none"]
    within = [x for x in twin if any(in_set(f, x["effects"][0]) for f in x["findings"])]
    out.append(rate("detected twins: the true one in the set", len(within), len(twin)))
    out.append(rate("detected twins: ambiguous, unexplained or the true one", sum(
        x["verdict"] != "named" or rightly_named(x) for x in twin), len(twin)))
    several = [x for x in pair if x["verdict"] == "named"]
    out.append(rate("pairs: verdict 'named' and all findings right", sum(map(rightly_named, several)), len(several)))
    below = by.get("below", [])
    out.append(rate("below the limit: none, or the right name", sum(
        x["verdict"] == "none" or any(in_set(f, x["effects"][0]) for f in x["findings"]) for x in below), len(below)))
    out += ["", f"{len(lines)} cases, {len(failed)} failed; CPU a case: median "
                f"{np.median([x['cpu_s'] for x in lines]) if lines else np.nan:.1f} s"]
    out += [f"- {x['id']}: {x['failed']}" for x in failed]
    return "\n".join(out)


def confusion(lines: list[dict]) -> str:
    """Rows: what was hidden; columns: what was said first, and how often."""
    table: dict[str, Counter] = {}
    for x in lines:
        if "failed" in x:
            continue
        hidden = x["effects"][0]["cause"] if x["effects"] else x["hidden"][0]["kind"] if x["hidden"] else "nothing"
        said = x["verdict"]
        if x["findings"]:
            f = x["findings"][0]
            place = "" if not x["effects"] or f["location"] == x["effects"][0]["location"] else " (elsewhere)"
            said = f"{x['verdict']}: {f['cause']}{place}"
        table.setdefault(f"{x['family']}: {hidden}", Counter())[said] += 1
    rows = [f"| {hidden} | {', '.join(f'{said} {n}' for said, n in count.most_common())} |"
            for hidden, count in sorted(table.items())]
    return "\n".join(["| hidden | said |", "|---|---|", *rows])


def typical_limits(lines: list[dict]) -> dict[str, float]:
    """Median of the limits that nulls state, rows that are out of reach in half of them left out."""
    rows: dict[str, list[float]] = {}
    nulls = [x for x in lines if x["family"] == "null" and "failed" not in x]
    for x in nulls:
        for key, value in x["limits"].items():
            rows.setdefault(key, []).append(abs(value) if value is not None else np.inf)
    middle = {key: float(np.median(values)) for key, values in rows.items()}
    return {key: value for key, value in sorted(middle.items()) if np.isfinite(value)}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path, help="directory of `run.py`, or a file of its lines")
    parser.add_argument("--ablation", default="")
    parser.add_argument("--limits", action="store_true", help="write limits.json from the nulls of this run")
    a = parser.parse_args()
    path = a.out if a.out.is_file() else a.out / f"cases{'-' + a.ablation if a.ablation else ''}.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    print(summary(lines), confusion(lines), sep="\n\n")
    if a.limits:
        Path(__file__).with_name("limits.json").write_text(json.dumps(typical_limits(lines), indent=1) + "\n")


if __name__ == "__main__":
    main()
