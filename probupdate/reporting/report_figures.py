"""Every figure of a run's report as a file of its own, and every table of numbers as CSV."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from probupdate.errors import InputError
from probupdate.io.files import write_text
from probupdate.reporting import SECTIONS, built_section
from probupdate.reporting.elements import Picture, Section, Table
from probupdate.reporting.style import collected_figures, save_figure
from probupdate.reporting.values import Run
from probupdate.runtime.progress import Progress, silent

KINDS = ("png", "svg", "pdf")


def write_report_figures(run: Run, out: str | Path, kind: str = "png", progress: Progress = silent) -> list[Path]:
    """Figures by section and name, tables by section and number, and last `legend.txt` with what each shows. Raises
    InputError for another kind, a folder that is a file, or a run without any figure."""
    out = Path(out)
    if kind not in KINDS:
        raise InputError("format", f"'{kind}' is unknown", f"choose from {', '.join(KINDS)}")
    if out.exists() and not out.is_dir():
        raise InputError(str(out), "is a file", "name a folder")
    written: list[Path] = []
    legend: list[str] = []
    for number, name in enumerate(SECTIONS):
        progress("figures", number, len(SECTIONS))
        with collected_figures() as drawn:
            section = built_section(name, run)
        if section is None:
            continue
        captions = _captions(section)
        for prefix, figure in drawn:
            path = out / f"{section.anchor}_{prefix}.{kind}"
            out.mkdir(parents=True, exist_ok=True)
            save_figure(figure, path)
            written.append(path)
            legend.append(f"{path.name}: {captions.get(prefix, section.title)}")
        for k, table in enumerate(t for t in section.items if isinstance(t, Table)):
            out.mkdir(parents=True, exist_ok=True)
            written.append(write_text(out / f"{section.anchor}_table_{k + 1}.csv", _csv(table)))
            legend.append(f"{written[-1].name}: {table.caption}")
    progress("figures", len(SECTIONS), len(SECTIONS))
    if not written:
        raise InputError(str(out), "the run has nothing to draw", "run `identify`, `sample` or `diagnose` first")
    return [*written, write_text(out / "legend.txt", "\n".join(legend) + "\n")]


def _captions(section: Section) -> dict[str, str]:
    """Prefix of a picture's ids -> its caption."""
    found = {}
    for item in section.items:
        if isinstance(item, Picture):
            at = item.svg.find('id="')
            if at >= 0:
                found[item.svg[at + 4 : item.svg.index('"', at + 4)].rpartition("-")[0]] = item.caption
    return found


def _csv(table: Table) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([f"{c.name} [{c.unit}]" if c.unit else c.name for c in table.columns])
    writer.writerows(table.rows)
    return stream.getvalue()
