"""Tables of all settings from the values themselves, for the site (hooks.py); run by itself it prints them."""

from __future__ import annotations

import sys
import textwrap

from probupdate.identification.settings import IdentificationConstants, IdentificationSettings
from probupdate.runtime.settings import rows
from probupdate.updating.discrepancy import LikelihoodSettings
from probupdate.updating.settings import SamplerSettings, UpdateSettings, UpdatingConstants

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
    """A section a value: what it is, a row a field."""
    parts = []
    for title, settings in (GIVEN | CONSTANTS).items():
        where = type(settings)
        about = f"`{where.__module__}.{where.__name__}`: {' '.join((where.__doc__ or '').split())}"
        parts += [f"## {title}", textwrap.fill(about, 120, break_on_hyphens=False), "\n".join(_table(settings))]
    return "\n\n".join(part.strip() for part in parts) + "\n"


if __name__ == "__main__":
    sys.stdout.write(page())
