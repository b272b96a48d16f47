"""Writes docs/reference/settings.md from the values themselves: python docs/settings_page.py."""

from __future__ import annotations

import textwrap
from pathlib import Path

from probupdate.identification.settings import IdentificationConstants, IdentificationSettings
from probupdate.runtime.settings import rows
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.settings import SamplerSettings, UpdateSettings, UpdatingConstants

PAGE = Path(__file__).parent / "reference" / "settings.md"
HEAD = """# Settings

Every number and word that decides something in identification and updating, as it stands in the program; this page is
written from the values themselves by `python docs/settings_page.py`. What a step is given comes first: a value that a
script makes, as `probupdate.SamplerSettings(seed=3)`, and gives to the step, and that the command makes of its options.
Constants are read when a module is loaded and are no options. A value without a source is this program's own choice.
Thresholds of the classifiers that a script may change are `ClassifierSettings` and `PersistenceSettings` in
[identification](identification.md).
"""
GIVEN = {
    "What is compared": LikelihoodSettings(), "The update": UpdateSettings(), "The sampler": SamplerSettings(),
    "Identification": IdentificationSettings(),
}
CONSTANTS = {"Constants of identification": IdentificationConstants(), "Constants of updating": UpdatingConstants()}


def _table(settings: object) -> list[str]:
    lines = ["| name | value | unit | effect | source |", "|---|---|---|---|---|"]
    return lines + [f"| `{r['name']}` | {_text(r['value'])} | {r['unit']} | {r['effect']} | {r['source']} |"
                    for r in rows(settings)]


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ", ".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for title, settings in (GIVEN | CONSTANTS).items():
        where = type(settings)
        about = f"`{where.__module__}.{where.__name__}`: {' '.join((where.__doc__ or '').split())}"
        parts += [f"## {title}", textwrap.fill(about, 120, break_on_hyphens=False), "\n".join(_table(settings))]
    return "\n\n".join(part.strip() for part in parts) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
