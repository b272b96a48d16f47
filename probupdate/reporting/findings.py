"""What the verdict weighs: everything of a run that speaks against using its numbers as they are, with what to do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from probupdate.diagnosis.wording import (
    channel_response_actions,
    is_explained,
    name_of,
    prior_shift_words,
    surprising_shifts,
    verdict_words,
    words_of_findings,
)
from probupdate.reporting.diagnosis_tables import typeset
from probupdate.reporting.elements import count, decimal, full_sentence, number
from probupdate.reporting.identifiability import BOUND, identifiabilities
from probupdate.reporting.states import changes_within, is_diagnosed, selected_state_words, step_words
from probupdate.reporting.updating_sections import scheme_name, too_close
from probupdate.reporting.values import Run
from probupdate.updating.posterior_file import Posterior
from probupdate.updating.update_file import UpdateRecord, fit_sentence, is_uninformative, misses, stated_error_words

LEVELS = ("warning", "caution", "good")
# computed over measured frequency beyond which a pair made by shape is questioned
FAR_OFF = 1.6
# share of evaluations answered by the full model from which the reduced basis did not serve
MANY_FALLBACKS = 0.2
# chance of shifts from the prior as large as these, all parameters together, below which they are no chance
NO_CHANCE = 0.01
# standardised shift of one parameter beyond which it is said without a diagnosis; a prior is rarely better known
FAR_SHIFT = 2.0


# what is wrong with an update of sets before and after a change, which the answer has said already
# how one state of several is updated
ONE_STATE = ("Update each state by itself: `probupdate select MODES --before TIME --out before.json`, or "
             "`--since TIME`, keeps its sets.")
NEITHER_STATE = "update and posterior describe neither state"


def check_priors(names: Sequence[str]) -> str:
    who = f"the prior{'s' * (len(names) != 1)} of {', '.join(names)}" if names else "all priors"
    return (f"Check {who} against drawings and site data; where they hold, inspect what these parameters stand for: "
            "either the structure has changed there, or they absorb an error of the model.")


@dataclass(frozen=True, kw_only=True)
class Finding:
    """`short` completes "do not rely on the parameters: "; `text` is the full sentence, `action` what to do
    about it."""

    level: str
    short: str
    text: str
    action: str = ""


def findings(run: Run) -> tuple[Finding, ...]:
    """The worst first, otherwise in the order in which they matter."""
    found = [Finding(level="warning", short="parts of this run do not belong together", text=text,
                     action="Run the steps again in one directory.") for text in run.warnings]
    for part in (_step_findings, _diagnosis_findings, _fit_findings, _sampler_findings, _shift_findings,
                 _update_findings):
        found += part(run)
    return tuple(sorted(found, key=lambda f: LEVELS.index(f.level)))


def worst_level(found: tuple[Finding, ...]) -> str:
    return found[0].level if found else "good"


def _fit_findings(run: Run) -> list[Finding]:
    update = run.update
    if update is None:
        return []
    if misses(update):
        return _misfit_findings(run, update)
    if is_uninformative(update):
        return [Finding(level="warning", short="the fit is no test of the model",
                        text=full_sentence(fit_sentence(update)), action="Find what is wrong with model "
                        "or data (`probupdate diagnose`) before a parameter is used.")]
    if too_close(update):
        assumed = update.settings.get("weights", "").startswith("frequencies: CoV")
        action = ("Update with the standard deviations of the identification (--weights measured) where those "
                  "assumed are wider: intervals become as narrow as the data allow." if assumed else
                  "Compare the standard deviations of the modes with their scatter between sets, and state those that "
                  "it shows where they are smaller.")
        return [Finding(level="caution", short="the stated standard deviations are too wide for these data",
                        text=full_sentence(fit_sentence(update)), action=action)]
    return []


def _misfit_findings(run: Run, update: UpdateRecord) -> list[Finding]:
    """What is to be done about it is said with the findings of a diagnosis where these explain it."""
    if is_diagnosed(run):
        # the mean of two states fits no model
        return [] if changes_within(run) else [
            Finding(level="warning", short="the model does not fit without what was found",
                    text=full_sentence(fit_sentence(update, diagnosed=True)))]
    # one that names findings, but none in these sets, has not said what their misfit is
    asked = run.diagnosis is not None and not is_explained(run.diagnosis)
    its = "more of its" if stated_error_words(update) else "its"
    state = "If it does not fit with the findings in it either, state" if (run.diagnosis or {}).get(
        "extended_model") else "State" if asked else "Find what the model lacks (`probupdate diagnose`), or state"
    return [Finding(level="warning", short="the model does not fit", text=full_sentence(fit_sentence(update)),
                    action=f"{state} {its} error: by other models of this structure (--alternatives), or with "
                    "--discrepancy, and update again.")]


def _sampler_findings(run: Run) -> list[Finding]:
    posterior = run.posterior
    if posterior is None:
        return []
    found = []
    if not posterior.converged:
        found.append(Finding(level="warning", short="the sampler did not converge", text=posterior.verdict,
                             action="Run `probupdate sample` again with more --max-steps: it goes on where it "
                             "stopped."))
    evaluated, fallback = evaluations(posterior)
    if fallback > MANY_FALLBACKS * evaluated:
        found.append(Finding(
            level="warning", short="the reduced basis does not cover the posterior",
            text=f"{count(fallback)} of {count(evaluated)} evaluations fell outside the reduced basis and were "
            "answered by the full model: exact, but the basis does not cover where the chain went."))
    return found


def evaluations(posterior: Posterior) -> tuple[int, int]:
    """How many of the chain, and how many of these the full model answered."""
    return int(posterior.record.get("evaluated", 0)), int(posterior.record.get("fallback", 0))


def _diagnosis_findings(run: Run) -> list[Finding]:
    content = run.diagnosis
    if content is None or content["verdict"] == "none" or (run.included and content["verdict"] == "named"):
        return []
    named = "; ".join(words_of_findings(content))
    if content["verdict"] == "named" and run.update is not None and changes_within(run):
        whose = "update" if run.posterior is None else "update and posterior"
        return [Finding(level="warning", short=NEITHER_STATE, action=_state_advice(content),
                        text=f"Parameters and predictions of this run's {whose}: they are of the sets before and after "
                        "the change together, so they describe neither state.")]
    actions = [] if run.included else extension_advice(content)
    actions += [full_sentence(one) for one in channel_response_actions(content)]
    of_sensors = content["verdict"] == "named" and all(f["kind"] == "measurement" for f in content["findings"])
    if not actions:
        actions.append("Correct the sensor, and update again on the sets that `diagnose` corrected "
                       "(diagnosis.modes.json)."
                       if of_sensors else
                       "Find what is missing in the model before the parameters are read as properties of the "
                       "structure: the section on the diagnosis shows where model and measurement part.")
    return [Finding(level="warning", short="a sensor's fault is in the sets of this update" if of_sensors else
                    "the diagnosis found what the model does not describe",
                    text=typeset(f"{_parted_words(content)}{f' Found: {named}.' if named else ''}"),
                    action=" ".join(actions))]


def _parted_words(content: Mapping) -> str:
    """The verdict, as one on what not to rely on: where all is named that is the model without it."""
    words = verdict_words(content)
    of_model = content["verdict"] == "named" and content["parameters"]
    return f"Numbers of the model without what was found: {words[0].lower()}{words[1:]}" if of_model else words


def _state_advice(content: Mapping) -> str:
    """How the state after a change is updated alone."""
    extension = content.get("extension") or {}
    mean = (extension.get("files") or {}).get("mean")
    if not mean:
        return ONE_STATE
    model = content.get("extended_model") or "MODEL"
    return ("Update and sample the state after the change alone, with what was found in the model: `probupdate update "
            f"--model {model} --modes {mean}`, and `sample` likewise.")


def _step_findings(run: Run) -> list[Finding]:
    """Frequencies that step between the sets of an update, where no diagnosis was made or none that explains them."""
    if selected := selected_state_words(run):
        return [Finding(level="caution", short="the sets selected are of one state of two",
                        text=full_sentence(selected))]
    words = step_words(run)
    if not words or (run.diagnosis is not None and run.diagnosis["verdict"] != "unexplained"):
        return []
    action = ("Run `probupdate diagnose` with this model and these sets: it looks for what changed, and has the "
              "parameters before and after." if run.diagnosis is None else ONE_STATE)
    return [Finding(level="warning",
                    short="frequencies step between the sets, so that their mean describes neither state",
                    text=full_sentence(words), action=action)]


def checks(content: Mapping) -> list[str]:
    """How each finding is confirmed on site."""
    return [full_sentence(f"confirm {name_of(f)}: {f['check']}") for f in content["findings"] if f.get("check")]


def extension_advice(content: Mapping, start: str = "Update again") -> list[str]:
    """With which model and modes to go on: those of the diagnosis, as far as it has written them."""
    model = content.get("extended_model")
    mean = ((content.get("extension") or {}).get("files") or {}).get("mean")
    if not model:
        return [f"{start} on {mean}, the mean of the modes in the blocks in which the findings act."] if mean else []
    of = f", and the modes that belong to it, {mean}" if mean else ""
    return [f"{start} with {model}, which has the findings in it{of}."]


def _shift_findings(run: Run) -> list[Finding]:
    """Parameters far from their priors: said by the diagnosis against what these data make likely, else by the update
    against the prior alone."""
    if run.diagnosis is not None and run.diagnosis.get("parameters"):
        return _diagnosed_shift_findings(run.diagnosis)
    if run.update is None:
        return []
    far = [s for s in identifiabilities(run.update, run.posterior) if abs(s.shift) > FAR_SHIFT]
    if not far:
        return []
    words = ", ".join(f"{s.name} {'+' if s.shift > 0 else ''}{decimal(s.shift, 1)}" for s in far)
    return [Finding(level="caution", short=f"{', '.join(s.name for s in far)} far from the prior",
                    text=f"Standardised shifts from the prior beyond ±{FAR_SHIFT:g}: {words} prior standard "
                    "deviations.",
                    action=f"{check_priors([s.name for s in far])} `probupdate diagnose` tests which.")]


def _diagnosed_shift_findings(content: Mapping) -> list[Finding]:
    shifts_of = (content["details"].get("residuals") or {}).get("prior_shift") or {}
    # by state; the last is after the findings are included
    chances: Sequence[float | None] = shifts_of.get("p_together") or (None,)
    p = chances[-1]
    # what the findings explain is said with them
    names = [name for name, still in surprising_shifts(content).items() if still]
    if not names and not (p is not None and p < NO_CHANCE):
        return []
    shifts = [full_sentence(t) for t in prior_shift_words(content)]
    together = "" if p is None else f" All parameters together: p = {number(p, 2)}."
    who = ", ".join(names) or "the parameters together"
    return [Finding(level="caution", short=f"{who} far from the prior",
                    text=typeset(" ".join(shifts)) + together, action=check_priors(names))]


def _update_findings(run: Run) -> list[Finding]:
    update = run.update
    if update is None:
        return []
    found = [Finding(level="warning", short=f"{label} may be another mode", text=text,
                     action=f"Compare the shapes of {label} in the section on the modes.")
             for label, text in _weak_partners(update)]
    held = [(p.name, value, s.words) for p, value, s in
            zip(update.parameters, update.map_theta, identifiabilities(update, run.posterior), strict=True)
            if s.kind == BOUND]
    if held:
        where = ", ".join(f"{name} {words} of {number(value)}" for name, value, words in held)
        names = ", ".join(name for name, *_ in held)
        found.append(Finding(
            level="caution", short=f"{names} at a bound",
            text=f"At the most probable parameters (MAP): {where}. The bound sets such a value, not the data.",
            action=f"See whether the bounds of {names} are right or the model lacks something."))
    if update.other_maxima:
        found.append(Finding(
            level="warning", short="other parameters explain the data as well",
            text="The posterior has more than one maximum: the most probable parameters are not the only ones that "
            "explain the data."))
    for s in update.schemes:
        if s.key == "prior" and not s.converged:
            found.append(Finding(level="warning", short="the update did not converge",
                                 text=f"The update with {scheme_name(s)} did not converge: {s.status}.",
                                 action="Update again with --method levenberg-marquardt or more --iterations."))
    return found


def _weak_partners(update: UpdateRecord) -> list[tuple[str, str]]:
    """Modes whose computed partner is alike in shape but hardly the same mode by its frequency."""
    ratio = update.initial_hz / update.measured_hz
    far = np.flatnonzero(np.isfinite(ratio) & ((ratio > FAR_OFF) | (ratio < 1 / FAR_OFF)))
    return [
        (update.labels[j],
         f"{update.labels[j]}, measured at {decimal(update.measured_hz[j], 3)} Hz, was paired by shape "
         f"with a computed mode at {decimal(update.initial_hz[j], 3)} Hz: see whether these are the same mode before "
         "trusting the update.")
        for j in far
    ]
