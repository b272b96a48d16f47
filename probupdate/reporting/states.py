"""A structure that changed within its record has parameters of each state: those of the diagnosis, from state to
state."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from probupdate.diagnosis.wording import amount, is_explained, name_of, structural_changes, time_profile_words
from probupdate.effects.catalogue import OWN_PARAMETER
from probupdate.reporting import figures
from probupdate.reporting.diagnosis_tables import NINETY, typeset
from probupdate.reporting.elements import MISSING, Column, Table, number, percent
from probupdate.reporting.values import Run
from probupdate.updating.joint_set import states_words
from probupdate.updating.update_file import STEP

# which of a run's values of a parameter to quote
USE_THIS = ("Of the values that this run has of a parameter, quote this table's; the others (MAP, Eq. 7, single "
            "sets) are there to check them.")


def changes_within(run: Run) -> list[Mapping]:
    """Findings with which the structure changed within the sets of this run's update (of the diagnosis, where there is
    none), and that the updated model does not hold."""
    if run.diagnosis is None or run.included:
        return []
    changes, update = structural_changes(run.diagnosis), run.update
    return changes if update is None else [f for f in changes if _averages_over(f, update.set_id, run)]


def is_diagnosed(run: Run) -> bool:
    """Whether the updated model lacks findings that act in its update's sets, and with which nothing else is left."""
    if run.diagnosis is None or run.update is None or run.included or not is_explained(run.diagnosis):
        return False
    acting = (_acts_in(f, run.update.set_id, run) for f in run.diagnosis["findings"])
    return any(any(sets) or not sets for sets in acting)


def _averages_over(finding: Mapping, set_id: str, run: Run) -> bool:
    """Whether a set that an update is of, such as "9 of 9 sets", is of blocks before and after a change."""
    if run.modes is not None and set_id in {s.id for s in run.modes.sets}:
        return False
    acts = _acts_in(finding, set_id, run)
    return not acts or len(set(acts)) == 2


def _acts_in(finding: Mapping, set_id: str, run: Run) -> list[bool]:
    """Whether a finding acts in each of the sets that an update is of; empty where it has no onset among them."""
    ids = [s.id for s in run.modes.sets] if run.modes is not None else []
    if finding["time_profile"] != "step" or finding.get("since") not in ids:
        return []
    if set_id in ids:
        return [ids.index(set_id) >= ids.index(finding["since"])]
    # the sets that were selected, where it is of that many
    chosen = next((data for data in (run.nine, run.modes)
                   if data is not None and set_id.endswith(f" of {len(data.sets)} sets")), run.modes)
    return [ids.index(s.id) >= ids.index(finding["since"]) for s in chosen.sets if s.id in ids]


def step_words(run: Run) -> str:
    """Where the update's frequencies step between its sets, and no diagnosis says what changed."""
    return "" if run.update is None or changes_within(run) else run.update.settings.get(STEP, "")


def selected_state_words(run: Run) -> str:
    """Where frequencies step between the sets that pass every criterion, and which state those selected for the update
    are of; empty where none does, or where the update is of other sets."""
    if run.nine is None or run.modes is None or run.update is None or step_words(run) or changes_within(run):
        return ""
    chosen, set_id = [s.id for s in run.nine.sets], run.update.set_id
    if set_id not in chosen and not set_id.endswith(f" of {len(chosen)} sets"):
        return ""
    sets = run.modes.sets
    if run.selection is not None and len(run.selection) == len(sets):
        failed = run.selection["criterion"].astype(object).fillna("")
        sets = tuple(s for s, why in zip(sets, failed, strict=True) if not why)
    known = {s.id for s in sets}
    if len(sets) < 2:
        return ""
    return states_words(replace(run.modes, sets=sets, reference_set=None), [one for one in chosen if one in known])


def state_names(changes: Sequence[Mapping]) -> tuple[str, ...]:
    """The states of a record in the order of time: "until 08:10", "from 08:10 on"."""
    onsets = _onsets(changes)
    grows = any(f["time_profile"] == "ramp" for f in changes)
    if not onsets:
        return ("at the beginning", "at the end")
    last = f"from {onsets[-1]} on{', at the end' if grows else ''}"
    between = (f"from {a} to {b}" for a, b in itertools.pairwise(onsets))
    return (f"until {onsets[0]}", *between, last)


def _onsets(changes: Sequence[Mapping]) -> list[str]:
    return sorted({str(f.get("since", "")) for f in changes if f["time_profile"] == "step"})


def state_table(content: Mapping, changes: Sequence[Mapping]) -> Table:
    """The model's own parameters in every state, with 90 % intervals in the first and the last, by the
    diagnosis's fit; below them what changed beside these."""
    states = state_names(changes)
    rows = []
    for p in content["parameters"]:
        value, std = (p.get(f"{key}_after", p.get(key)) for key in ("value", "std"))
        if value is None:
            continue
        own = [f for f in changes if f["cause"] == OWN_PARAMETER and f["location"] == p["name"]]
        values = value + _changes_by_state(own, _onsets(changes), len(states))
        moves = abs(values[-1] - value) > 0
        # of the value before and of what it changed by, which the same sets hold against one another
        end = None if std is None else math.hypot(std, *(f.get("size_std") or 0.0 for f in own))
        cells = [_with_interval(values[0], std), *(number(v) for v in values[1:-1]),
                 _with_interval(values[-1], end) if moves else "the same"]
        prior = f"{number(p['prior'])} ± {number(p['prior_std'])}"
        rows.append((figures.unit_label(p["name"], p["unit"]), prior, *cells, percent(
            values[-1] / value - 1, 0, sign=True) if moves and value else MISSING))
    for f in changes:
        if f["cause"] != OWN_PARAMETER:
            size = typeset(amount(f["size"], f.get("size_std"), f["unit"], f["cause"]))
            when = time_profile_words(f["time_profile"], f.get("since", ""))
            # the column's own heading need not stand in it again
            size = size if when == states[-1] else f"{size}, {when}"
            rows.append((name_of(f), MISSING, "none", *(MISSING for _ in states[1:-1]), size, MISSING))
    return Table(
        caption="Parameters in each state, by the diagnosis", rows=tuple(rows),
        columns=(Column(name="parameter", unit="[unit]", number=False), Column(name="prior ± standard deviation"),
                 *(Column(name=name) for name in states), Column(name="change", unit="%")),
        note="In brackets 90 % intervals by the fit to all sets, after the change those of the value before and of the "
             f"change together. {USE_THIS}")


def _changes_by_state(changes: Sequence[Mapping], onsets: Sequence[str], n_state: int) -> np.ndarray:
    """(n_state,) by how much one parameter has changed in each state; NaN while it grows."""
    total = np.zeros(n_state)
    for f in changes:
        size = np.nan if f["size"] is None else f["size"]
        if f["time_profile"] == "step":
            total[onsets.index(str(f.get("since", ""))) + 1 :] += size
        else:
            total[1:-1] = np.nan
            total[-1] += size
    return total


def _with_interval(value: float, std: float | None) -> str:
    if std is None:
        return number(value)
    return f"{number(value)} ({number(value - NINETY * std)} to {number(value + NINETY * std)})"
