"""The report: one self-contained page of a run directory, and its figures for use alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from probupdate.io.files import write_text
from probupdate.runtime.progress import Progress, silent

if TYPE_CHECKING:
    from probupdate.reporting.elements import Section
    from probupdate.reporting.values import Run

# what other rooms and users import; the other modules are this room's own
__all__ = ["elements", "identification_pictures", "page", "report", "run_files", "style"]


def report(
    run: str | Path, out: str | Path, *, campaign: str | Path | None = None, model: str | Path | None = None,
    parameters: str | Path | None = None, progress: Progress = silent,
) -> Path:  # fmt: skip
    """Read the run directory `run` and write the page to `out`; returns the path written. campaign, model, parameters:
    where the records, the model and its table of parameters lie, if not in the directory under their usual names.

    Whatever the directory lacks is left out and named on the page; a file that is there but cannot be read raises
    InputError, as does a directory that holds nothing of a run.
    """
    from probupdate.reporting.run_files import read_run

    given = {"campaign": campaign, "model": model, "parameters": parameters}
    contents = read_run(Path(run), progress, {name: Path(path) for name, path in given.items() if path is not None})
    out = Path(out)
    return write_text(out, compose(contents, progress))


def compose(run: Run, progress: Progress = silent) -> str:
    """The page of a run's values as HTML text."""
    from probupdate.reporting import diagnosis_section as diagnosis
    from probupdate.reporting import measurement_sections as measurement
    from probupdate.reporting import modes_section as modes
    from probupdate.reporting import overview_sections as overview
    from probupdate.reporting import posterior_sections as posterior
    from probupdate.reporting import sets_section as sets
    from probupdate.reporting import updating_sections as updating
    from probupdate.reporting.page import render

    builders = (
        overview.verdict_section, measurement.measured_section, measurement.identification_section,
        measurement.selection_section, modes.modes_section, updating.update_section, posterior.posterior_section,
        posterior.comparison_section, sets.sets_section, sets.information_section, diagnosis.diagnosis_section,
        overview.provenance_section,
    )
    # a diagnosis needs no update: its page does not go section by section through what was never meant to be there
    diagnosed_only = run.diagnosis is not None and run.update is None and run.posterior is None
    sections = []
    for done, build in enumerate(builders):
        progress("report", done, len(builders))
        # those on sets, information and diagnosis are there where their files are
        section = build(run)
        if section is not None and not (diagnosed_only and _hollow(section)):
            sections.append(section)
    progress("report", len(builders), len(builders))
    footer = "Written by probupdate. This page needs no network and no other file."
    return render(sections, title=run.title, subtitle=_subtitle(run), footer=footer)


def _hollow(section: Section) -> bool:
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
