"""The report: one self-contained page of a run directory, and its figures for use alone."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from probupdate.io.files import write_text
from probupdate.runtime.executors import Executor, executor, iterate_completed
from probupdate.runtime.progress import Progress, silent

if TYPE_CHECKING:
    from probupdate.reporting.elements import Section
    from probupdate.reporting.values import Run

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "elements", "explore", "figures_regression", "figures_stress", "identification_pictures", "page", "report",
    "report_figures", "report_with_conclusion", "run_files", "style",
]

# the page's sections in their order -> the module of each
SECTIONS = {
    "verdict_section": "overview_sections", "measured_section": "measurement_sections",
    "identification_section": "measurement_sections", "selection_section": "measurement_sections",
    "diagnosis_section": "diagnosis_section", "update_section": "updating_sections",
    "posterior_section": "posterior_sections", "comparison_section": "posterior_sections",
    "modes_section": "modes_section", "stress_section": "stress_section", "paper_section": "updating_sections",
    "sets_section": "sets_section", "information_section": "sets_section", "provenance_section": "overview_sections",
}
# three quarters of a page's time: begun first, and worth a process each
SLOW = ("diagnosis_section", "posterior_section", "identification_section")


def report(
    run: str | Path, out: str | Path, *, campaign: str | Path | None = None, model: str | Path | None = None,
    parameters: str | Path | None = None, jobs: int | Executor = 1, progress: Progress = silent,
) -> Path:
    """Read the run directory `run` and write the page to `out`; returns the path written. campaign, model, parameters:
    where the records, the model and its table of parameters lie, if not in the directory under their usual names.

    Whatever the directory lacks is left out and named on the page; a file that is there but cannot be read raises
    InputError, as does a directory that holds nothing of a run. jobs: processes, or an executor, for the sections; the
    page is the same on any.
    """
    given = {"campaign": campaign, "model": model, "parameters": parameters}
    known = {name: Path(path) for name, path in given.items() if path is not None}
    return report_with_conclusion(run, out, known, jobs=jobs, progress=progress)[0]


def report_with_conclusion(
    run: str | Path, out: str | Path, given: Mapping[str, Path] | None = None, *, jobs: int | Executor = 1,
    progress: Progress = silent,
) -> tuple[Path, list[str]]:
    """The path of the page, and what its first screen says, in lines."""
    from probupdate.reporting.run_files import read_run

    with executor(jobs) as runs:
        # they import while the files are read
        runs.prepare(len(SLOW), "probupdate.reporting.run_files", "probupdate.reporting.figures")
        values = read_run(Path(run), progress, given)
        page = write_text(Path(out), compose(values, jobs=runs, progress=progress))
    from probupdate.reporting.overview_sections import conclusion

    return page, conclusion(values)


def compose(run: Run, *, jobs: int | Executor = 1, progress: Progress = silent) -> str:
    """The page of a run's values as HTML text."""
    from probupdate.reporting.page import render

    # a diagnosis needs no update: its page does not go section by section through what was never meant to be there
    diagnosed_only = run.diagnosis is not None and run.update is None and run.posterior is None
    progress("report", 0, len(SECTIONS))
    built: dict[str, Section | None] = {}
    order = [*SLOW, *(name for name in SECTIONS if name not in SLOW)]
    for name, section in iterate_completed(_build_section, [(name, run) for name in order], jobs=jobs, least=1):
        built[name] = section
        progress("report", len(built), len(SECTIONS))
    # those on sets, information and diagnosis are there where their files are
    sections = [section for section in map(built.__getitem__, SECTIONS)
                if section is not None and not (diagnosed_only and _is_empty(section))]
    footer = "Written by probupdate. This page needs no network and no other file."
    return render(sections, title=run.title, subtitle=_subtitle(run), footer=footer)


def _build_section(name: str, run: Run) -> tuple[str, Section | None]:
    return name, built_section(name, run)


def built_section(name: str, run: Run) -> Section | None:
    """The section of a name of SECTIONS, None where its files are not there."""
    return getattr(import_module(f"probupdate.reporting.{SECTIONS[name]}"), name)(run)


def _is_empty(section: Section) -> bool:
    return all(getattr(item, "level", "") == "missing" for item in section.items)


def _subtitle(run: Run) -> str:
    from probupdate.io.result_table import plural

    parts = []
    if run.campaign is not None:
        parts.append(f"{len(run.campaign.sensors)} channels at {run.campaign.sampling_rate_hz:g} Hz")
    if run.modes is not None:
        parts.append(plural(len(run.modes.sets), "modal set"))
    if run.update is not None:
        parts.append(plural(len(run.update.parameters), "parameter"))
    if run.truth is not None:
        parts.append("virtual campaign, truth known")
    return " · ".join(parts)
