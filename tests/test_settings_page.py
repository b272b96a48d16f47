"""The site's tables of settings hold every value, and every one of them says what it does."""

import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = runpy.run_path(str(ROOT / "docs" / "settings_page.py"))


def test_the_page_has_a_row_for_every_field():
    page = SCRIPT["page"]()
    for settings in (SCRIPT["GIVEN"] | SCRIPT["CONSTANTS"]).values():
        for name in type(settings).__dataclass_fields__:
            assert f"| `{name}` | " in page, name
    assert "<!-- settings -->" in (ROOT / "docs" / "reference" / "settings.md").read_text(encoding="utf-8")


def test_every_field_states_its_unit_and_effect():
    for settings in (SCRIPT["GIVEN"] | SCRIPT["CONSTANTS"]).values():
        found = {row["name"]: row for row in SCRIPT["rows"](settings)}
        assert set(found) == set(type(settings).__dataclass_fields__)
        assert all(row["unit"] and row["effect"] for row in found.values())
