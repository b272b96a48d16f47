"""The page of settings is what the values are, and every one of them says what it does."""

import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SCRIPT = runpy.run_path(str(ROOT / "docs" / "settings_page.py"))


def test_the_page_is_that_of_the_values():
    assert SCRIPT["PAGE"].read_text(encoding="utf-8") == SCRIPT["page"](), "run python docs/settings_page.py"


def test_every_field_states_its_unit_and_effect():
    for settings in (SCRIPT["GIVEN"] | SCRIPT["CONSTANTS"]).values():
        found = {row["name"]: row for row in SCRIPT["rows"](settings)}
        assert set(found) == set(type(settings).__dataclass_fields__)
        assert all(row["unit"] and row["effect"] for row in found.values())
