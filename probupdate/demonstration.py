"""The whole job on a virtual campaign, step by step into one directory; finished steps are not repeated."""

from __future__ import annotations

import hashlib
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from probupdate import __version__, verbs
from probupdate.diagnosis.wording import words_of_findings
from probupdate.errors import InputError
from probupdate.io.files import is_empty_folder, read_json, read_text, write_bytes, write_json, write_text
from probupdate.io.result_table import table_of
from probupdate.modal.modes import read_modes
from probupdate.reporting import report_with_conclusion
from probupdate.runtime.executors import Executor, background_process, executor
from probupdate.runtime.progress import Progress, silent
from probupdate.structure.load import reference_model
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.settings import SamplerSettings
from probupdate.verbs.estimating import Case
from probupdate.virtual.effects import hidden_words
from probupdate.virtual.simulation import n_slots

if TYPE_CHECKING:
    import pandas as pd

# the virtual turbine stands in the updated state; the model that is updated starts from the as-built one
TRUTH_STATE, START_STATE = "updated", "as_built"
PAPER_LIKELIHOOD = LikelihoodSettings(weights="paper")
# hidden unless the caller says otherwise: one effect of the structure, one of a sensor
HIDDEN = """\
# hidden in the demonstration's virtual turbine; as `probupdate simulate --truth` reads it
[[effect]]
kind = "leg_stiffness"
leg = "B"
bay = 4
factor = 0.75
time_profile = "step"
at_hour = {half:g}

[[effect]]
kind = "sensor_gain"
channel = "TP-C-y"
factor = 1.15
"""
# two ensembles of 200 steps give twice as many effective draws, and both must agree
TARGET_ESS, ENSEMBLES = 400, 2


@dataclass(frozen=True, kw_only=True)
class Demonstration:
    """folder holds campaign/, modes.json, nine.json, paper.json, diagnosis.json, update.json, posterior.nc,
    compare.json and report.html (`files`, those with results)."""

    folder: Path
    seconds: float
    files: tuple[Path, ...]
    summary: str

    def to_frame(self) -> pd.DataFrame:
        """One row: the folder and how long it took."""
        return table_of([{"folder": str(self.folder), "duration_s": self.seconds}])


def demo(
    out: str | Path,
    *,
    seed: int = 1,
    days: float = 1.0,
    hide: str | Path = "default",
    jobs: int = 1,
    progress: Progress = silent,
    say: Callable[[str], None] = lambda text: None,
) -> Demonstration:
    """Simulate, identify, select, diagnose, update and sample with the findings in the model, compare, report. `say` is
    called with what each step found.

    The virtual turbine is built by a formulation of its own (finer mesh, other element and soil law, drawn
    tolerances), in the reference turbine's updated state, and measured; the model starts as built. `hide`: a truth.toml
    of effects that the model does not have, "none", or "default", one of the structure from half of the record on
    (HIDDEN) and one of a sensor; what it was is said after the diagnosis. The model with the findings in it is updated
    and sampled with default weights; the paper's update, of the model as built with the paper's weights, is beside it.
    jobs: with two or more hours, blocks and sections of the report are shared out, the paper's update runs beside the
    diagnosis and the update beside the sampler, with the same bytes; a script needs `if __name__ == "__main__"` then.
    """
    out = Path(out)
    hidden = hidden_text(hide, days)
    # before anything is written
    SamplerSettings(seed=seed)
    n_slots(days)
    begun = time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    state = RunState(out, {"seed": seed, "days": days, "hidden": hashlib.sha256(hidden.encode()).hexdigest(),
                         "version": __version__})
    campaign, model = out / "campaign", out / "model.toml"
    write_bytes(model, reference_model(START_STATE).read_bytes())
    modes, nine, diagnosis = out / "modes.json", out / "nine.json", out / "diagnosis.json"
    files = {"paper": out / "paper.json", "update": out / "update.json", "posterior": out / "posterior.nc",
             "compare": out / "compare.json"}
    steps = _Steps(state, say)
    with executor(jobs) as runs:
        _measure(steps, out, hidden, seed=seed, days=days, jobs=runs if jobs > 1 else 1, progress=progress, say=say)
        # the diagnosis is asked of all blocks, with the model as it was before any update
        steps.side_by_side({
            "paper": (_paper, model, nine, files["paper"]),
            "diagnose": (_diagnose, model, modes, campaign, diagnosis, seed, hidden, runs),
        }, jobs, progress)
        extended, data = _with_findings(diagnosis, model, nine)
        state.updates(extended)
        finished = state.done("update") and state.done("sample")
        likelihood = LikelihoodSettings() if finished else stated_likelihood(extended, data, progress)
        steps.side_by_side({
            "update": (_update, extended, data, files["update"], likelihood),
            "sample": (_sample, extended, data, files["posterior"], likelihood, seed, runs),
        }, jobs, progress)
        with steps.run_step("compare", again=True):
            compared = verbs.compare(files["update"], files["posterior"], model=extended)
            compared.write(files["compare"])
            say(compared.summary)
        with steps.run_step("report", again=True):
            page, conclusion = report_with_conclusion(out, out / "report.html", jobs=runs, progress=progress)
    seconds = time.monotonic() - begun
    summary = "\n".join(["", *conclusion, f"{seconds:.0f} s; open {page}"])
    written = page, modes, nine, diagnosis, *files.values()
    return Demonstration(folder=out, seconds=seconds, files=written, summary=summary)


def _with_findings(diagnosis: Path, model: Path, nine: Path) -> tuple[Path, Path]:
    """Model and modes to update: with the findings in both, or as they were where nothing was included."""
    content = read_json(diagnosis, "delete it, and run the demonstration again")
    files = (content.get("extension") or {}).get("files") or {}
    return (diagnosis.with_name(files["model"]) if files.get("model") else model,
            diagnosis.with_name(files["mean"]) if files.get("mean") else nine)


def _measure(
    steps: _Steps, out: Path, hidden: str, *, seed: int, days: float, jobs: int | Executor, progress: Progress,
    say: Callable[[str], None],
) -> None:
    """The virtual turbine's records, the modes in them, and the sets that an update may trust."""
    campaign, modes = out / "campaign", out / "modes.json"
    with steps.run_step("simulate") as wanted:
        if wanted:
            truth = write_text(out / "hidden.toml", hidden) if hidden else None
            simulated = verbs.simulate(
                campaign, model=TRUTH_STATE, days=days, seed=seed, truth=truth, jobs=jobs, progress=progress
            )
            # what was hidden is said after the diagnosis
            say("\n".join(line for line in simulated.summary.splitlines() if "hidden" not in line))
    with steps.run_step("identify") as wanted:
        if wanted:
            found = verbs.identify(campaign, out / "model.toml", store=out / "modes.json.blocks", jobs=jobs,
                                   progress=progress)
            found.write(modes)
            say(found.summary)
    with steps.run_step("select") as wanted:
        if wanted:
            chosen = verbs.select(modes, scada=campaign / "scada.csv")
            chosen.write(out / "nine.json")
            say(chosen.summary)


def hidden_text(hide: str | Path, days: float) -> str:
    """The text of a truth.toml, empty where nothing is hidden."""
    if hide == "none":
        return ""
    if hide == "default":
        return HIDDEN.format(half=12 * days)
    path = Path(hide)
    if not path.is_file():
        raise InputError(str(path), "is not a file", "give a truth.toml to --hide, or none, or default")
    return read_text(path, "write it as `simulate` writes truth.toml")


def hidden_and_found_words(hidden: str, diagnosis) -> str:
    """What the campaign held, beside what was found without that knowledge."""
    effects = [hidden_words(e) for e in tomllib.loads(hidden).get("effect", ())]
    if not effects:
        return "hidden in this campaign: nothing"
    found = words_of_findings(diagnosis.content()) or ["nothing with a name"]
    return "\n".join(["hidden in this campaign:", *(f"  {e}" for e in effects), "found by the diagnosis:",
                      *(f"  {f}" for f in found)])


def _paper(model: Path, nine: Path, out: Path, progress: Progress = silent) -> str:
    """The paper's update is of one set, the most consistent one."""
    updated = verbs.update(model, nine, likelihood=PAPER_LIKELIHOOD, set_id=read_modes(nine).set().id,
                           progress=progress)
    updated.write(out)
    return updated.summary


def stated_likelihood(model: Path, modes: Path, progress: Progress) -> LikelihoodSettings:
    """With plain numbers for what is not known of the model, the same for update and sampler."""
    return LikelihoodSettings(weights=Case.prepare(model, modes, LikelihoodSettings(), progress=progress).weights)


def _update(
    model: Path, modes: Path, out: Path, likelihood: LikelihoodSettings, progress: Progress = silent
) -> str:
    updated = verbs.update(model, modes, likelihood=likelihood, progress=progress)
    updated.write(out)
    return updated.summary


def _sample(
    model: Path, modes: Path, out: Path, likelihood: LikelihoodSettings, seed: int, runs: Executor,
    progress: Progress = silent,
) -> str:
    settings = SamplerSettings(seed=seed, target_ess=TARGET_ESS, ensembles=ENSEMBLES)
    return verbs.sample(model, modes, out, likelihood=likelihood, settings=settings, jobs=runs,
                        progress=progress).summary


def _diagnose(
    model: Path, modes: Path, campaign: Path, out: Path, seed: int, hidden: str, runs: Executor,
    progress: Progress = silent,
) -> str:
    diagnosis = verbs.diagnose(model, modes, campaign=campaign, seed=seed, out=out, jobs=runs, progress=progress)
    diagnosis.write(out)
    return f"{diagnosis.summary}\n{hidden_and_found_words(hidden, diagnosis)}"


def _timed_step(step: Callable[..., str], *arguments) -> tuple[str, float]:
    """What a step says, and its seconds."""
    begun = time.monotonic()
    return step(*arguments), time.monotonic() - begun


# step -> what it does, in the order of the work; the last two are done again each time
STEPS = {
    "simulate": "a virtual turbine is measured", "identify": "modes of every half hour", "select": "sets to trust",
    "paper": "the model as built with the paper's weights, for comparison",
    "diagnose": "what is wrong in model or measurement",
    "update": "deterministic update of the model with the findings", "sample": "its posterior",
    "compare": "both estimators side by side", "report": "one page of it all",
}


class _Steps:
    """A heading before each step, a line with its time after it; what is said comes in the order of STEPS."""

    def __init__(self, state: RunState, say: Callable[[str], None]):
        self._state, self._say = state, say

    @contextmanager
    def run_step(self, step: str, again: bool = False) -> Iterator[bool]:
        """Whether the step is still to be done; it is finished when the block ends without an error."""
        if not again and self._state.done(step):
            self._say(f"{_head(step)}: finished before")
            yield False
            return
        begun = time.monotonic()
        self._say(f"\n{_head(step)}: {STEPS[step]}")
        yield True
        if not again:
            self._state.finish(step)
        self._say(f"{_head(step)}: finished in {time.monotonic() - begun:.1f} s")

    def side_by_side(self, work: Mapping[str, tuple], jobs: int, progress: Progress) -> None:
        """Steps that do not need one another, name -> (function, *arguments): with two jobs the last here, the others
        in a process beside it; what they say follows when all have ended."""
        *first, last = work
        others = [step for step in first if not self._state.done(step)]
        if jobs < 2 or not others or self._state.done(last):
            for step, task in work.items():
                with self.run_step(step) as wanted:
                    if wanted:
                        self._say(_timed_step(*task, progress)[0])
            return
        for step in first:
            if step not in others:
                self._say(f"{_head(step)}: finished before")
        self._say(f"\n{', '.join(map(_head, [*others, last]))}: side by side")
        ended: dict[str, tuple[str, float]] = {}

        def end(step: str, result: tuple[str, float]) -> None:
            ended[step] = result
            self._state.finish(step)

        with background_process(*((_timed_step, *work[step]) for step in others)) as waiting:

            def watching(what: str, done: int, total: int) -> None:
                for step, future in zip(others, waiting, strict=True):
                    if step not in ended and future.done():
                        end(step, future.result())
                progress(what, done, total)

            end(last, _timed_step(*work[last], watching))
            for step, future in zip(others, waiting, strict=True):
                if step not in ended:
                    end(step, future.result())
        for step in [*others, last]:
            text, seconds = ended[step]
            self._say(f"\n{_head(step)}: {STEPS[step]}\n{text}\n{_head(step)}: finished in {seconds:.1f} s")


def _head(step: str) -> str:
    return f"[{list(STEPS).index(step) + 1}/{len(STEPS)}] {step}"


def _read_if_finished(path: Path) -> dict:
    found = read_json(path, "give an empty directory, or delete this one")
    if not isinstance(found, dict) or not isinstance(found.get("finished"), list):
        raise InputError(str(path), "is no demonstration's", "give an empty directory, or delete this one")
    return found


class RunState:
    """Which steps are finished, in run.json; refuses a directory of another run."""

    def __init__(self, out: Path, settings: dict):
        self._path = out / "run.json"
        start = hashlib.sha256(reference_model(START_STATE).read_bytes()).hexdigest()
        self._content = {
            "title": "Virtual jacket turbine, demonstration", "model": "model.toml", "campaign": "campaign",
            "start": start, **settings, "finished": [],
        }
        if self._path.exists():
            found = _read_if_finished(self._path)
            differ = [k for k in self._content if k not in ("finished", "model") and found.get(k) != self._content[k]]
            if differ:
                key = differ[0]
                what = ("in which something else is hidden" if key == "hidden" else
                        f"whose {key} is {found.get(key)}, not {self._content[key]}")
                raise InputError(str(out), f"holds a demonstration {what}",
                                 "give an empty directory, or delete this one")
            self._content |= {key: found[key] for key in ("finished", "model") if key in found}
        elif not is_empty_folder(out):
            raise InputError(str(out), "is not empty and holds no demonstration", "give an empty directory")
        else:
            self._write()

    def updates(self, model: Path) -> None:
        """The model that the report is of."""
        self._content["model"] = model.name
        self._write()

    def done(self, step: str) -> bool:
        return step in self._content["finished"]

    def finish(self, step: str) -> None:
        finished = {step, *self._content["finished"]}
        self._content["finished"] = [name for name in STEPS if name in finished]
        self._write()

    def _write(self) -> None:
        write_json(self._path, self._content)
