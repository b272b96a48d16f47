"""The whole job on a virtual campaign, step by step into one directory; finished steps are not repeated."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from probupdate import __version__, verbs
from probupdate.errors import InputError
from probupdate.estimators.ensemble import SamplerSettings
from probupdate.files import holds_nothing, read_json, write_bytes, write_json
from probupdate.progress import Progress, silent
from probupdate.reporting import report as write_report
from probupdate.structure.load import reference_model

# the virtual turbine stands in the updated state; the model that is updated starts from the as-built one
TRUTH_STATE, START_STATE = "updated", "as_built"
WEIGHTS = "paper"
# the demonstration's posterior is for looking at: fewer effective draws than a report would want
TARGET_ESS = 400


@dataclass(frozen=True, kw_only=True)
class Demonstration:
    """folder holds campaign/, modes.json, nine.json, update.json, posterior.nc, compare.json, diagnosis.json and
    report.html."""

    folder: Path
    seconds: float
    summary: str


def demo(
    out: str | Path,
    *,
    seed: int = 1,
    days: float = 1.0,
    progress: Progress = silent,
    say: Callable[[str], None] = lambda text: None,
) -> Demonstration:
    """Simulate, identify, select, update, sample, diagnose, compare, report. `say` is told what each step found.

    The virtual turbine is built by a formulation of its own (finer mesh, other element and soil law, drawn
    tolerances), in the reference turbine's updated state, and measured; the model starts as built.
    """
    out = Path(out)
    # before anything is written
    SamplerSettings(seed=seed)
    begun = time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    state = _State(out, {"seed": seed, "days": days, "version": __version__})
    campaign, model = out / "campaign", out / "model.toml"
    write_bytes(model, reference_model(START_STATE).read_bytes())
    modes, nine = out / "modes.json", out / "nine.json"
    files = {"update": out / "update.json", "posterior": out / "posterior.nc", "compare": out / "compare.json"}
    steps = _Steps(state, say)
    with steps.of("simulate") as wanted:
        if wanted:
            say(verbs.simulate(campaign, model=TRUTH_STATE, days=days, seed=seed, progress=progress).summary)
    with steps.of("identify") as wanted:
        if wanted:
            found = verbs.identify(campaign, model, store=out / "modes.json.blocks", progress=progress)
            found.write(modes)
            say(found.summary)
    with steps.of("select") as wanted:
        if wanted:
            chosen = verbs.select(modes, scada=campaign / "scada.csv")
            chosen.write(nine)
            say(chosen.summary)
    with steps.of("update") as wanted:
        if wanted:
            updated = verbs.update(model, nine, weights=WEIGHTS, progress=progress)
            updated.write(files["update"])
            say(updated.summary)
    with steps.of("sample") as wanted:
        if wanted:
            drawn = verbs.sample(model, nine, files["posterior"], weights=WEIGHTS, seed=seed, target_ess=TARGET_ESS,
                                 progress=progress)  # fmt: skip
            say(drawn.summary)
    with steps.of("diagnose") as wanted:
        if wanted:
            # asked of all blocks, with the model as it was before any update: nothing is hidden in this campaign
            diagnosis = verbs.diagnose(model, modes, campaign=campaign, seed=seed, out=out / "diagnosis.json",
                                       progress=progress)  # fmt: skip
            diagnosis.write(out / "diagnosis.json")
            say(diagnosis.summary)
    with steps.of("compare", again=True):
        compared = verbs.compare(files["update"], files["posterior"], model=model)
        compared.write(files["compare"])
        say(compared.summary)
    with steps.of("report", again=True):
        page = write_report(out, out / "report.html", progress=progress)
    seconds = time.monotonic() - begun
    summary = f"{seconds:.0f} s; open {page}"
    return Demonstration(folder=out, seconds=seconds, summary=summary)


# step -> what it does, in the order of the work; the last two are done anew each time
STEPS = {
    "simulate": "a virtual turbine is measured", "identify": "modes of every half hour", "select": "sets to trust",
    "update": "the deterministic update", "sample": "the posterior", "diagnose": "what the model gets wrong",
    "compare": "update and posterior side by side", "report": "one page of it all",
}  # fmt: skip


class _Steps:
    """A heading before each step, a line with its time after it."""

    def __init__(self, state: _State, say: Callable[[str], None]):
        self._state, self._say = state, say

    @contextmanager
    def of(self, step: str, again: bool = False) -> Iterator[bool]:
        """Whether the step is still to be done; it is finished when the block ends without an error."""
        head = f"[{list(STEPS).index(step) + 1}/{len(STEPS)}] {step}"
        if not again and self._state.done(step):
            self._say(f"{head}: finished before")
            yield False
            return
        begun = time.monotonic()
        self._say(f"\n{head}: {STEPS[step]}")
        yield True
        if not again:
            self._state.finish(step)
        self._say(f"{head}: finished in {time.monotonic() - begun:.1f} s")


def _finished(path: Path) -> dict:
    found = read_json(path, "give an empty directory, or delete this one")
    if not isinstance(found, dict) or not isinstance(found.get("finished"), list):
        raise InputError(str(path), "is no demonstration's", "give an empty directory, or delete this one")
    return found


class _State:
    """Which steps are finished, in run.json; refuses a directory of another run."""

    def __init__(self, out: Path, settings: dict):
        self._path = out / "run.json"
        start = hashlib.sha256(reference_model(START_STATE).read_bytes()).hexdigest()
        self._content = {
            "title": "Virtual jacket turbine, demonstration", "model": "model.toml", "campaign": "campaign",
            "start": start, **settings, "finished": [],
        }  # fmt: skip
        if self._path.exists():
            found = _finished(self._path)
            differ = [k for k in self._content if k != "finished" and found.get(k) != self._content[k]]
            if differ:
                key = differ[0]
                raise InputError(
                    str(out), f"holds a demonstration whose {key} is {found.get(key)}, not {self._content[key]}",
                    "give an empty directory, or delete this one",
                )
            self._content["finished"] = found["finished"]
        elif not holds_nothing(out):
            raise InputError(str(out), "is not empty and holds no demonstration", "give an empty directory")
        else:
            self._write()

    def done(self, step: str) -> bool:
        return step in self._content["finished"]

    def finish(self, step: str) -> None:
        self._content["finished"].append(step)
        self._write()

    def _write(self) -> None:
        write_json(self._path, self._content)
