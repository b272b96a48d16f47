"""Every snippet of the README, the tutorials and the how-to pages runs as it stands on the page.

A page is run from top to bottom in an empty folder: a block with a title is written to that file, Python is executed in
one namespace, lines of `probupdate` go through the command line's own main. What samples is `long`; commands on records
that only a reader has are parsed (tests/test_documents.py).
"""

import json
import re
import shlex
import sys
from pathlib import Path

import pytest

from probupdate.cli import main

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))
import notebooks  # noqa: E402

BLOCK = re.compile(r'^```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.DOTALL | re.MULTILINE)
# pages that hold all their files; the first command that takes long
PAGES = {"openfast": "", "own_campaign": "sample"}
NOTEBOOKS = sorted((ROOT / "docs" / "tutorials").glob("*.ipynb"))


def blocks(page: str) -> list[tuple[str, str, str]]:
    """(language, title or "", text) of a page's fenced blocks, in order."""
    return [(b[1], b[2] or "", b[3]) for b in BLOCK.finditer((ROOT / page).read_text(encoding="utf-8"))]


def run_page(page: str, until: str = "") -> int:
    """In the current folder; ends before the command `until`. Returns how many blocks and commands were run."""
    names: dict = {"__name__": "page"}
    done = 0
    for language, title, text in blocks(page):
        if title:
            Path(title).parent.mkdir(parents=True, exist_ok=True)
            Path(title).write_text(text, encoding="utf-8")
        elif language == "python":
            exec(compile(text, page, "exec"), names)
            done += 1
        elif language == "sh":
            for line in text.splitlines():
                words = shlex.split(line, comments=True)[1:]
                if until and words[0] == until:
                    return done
                assert main(words) == 0, words
                done += 1
    return done


@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_runs_up_to_its_sampling(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_page(f"docs/tutorials/{page}.md", PAGES[page]) >= 4


def test_notebooks_hold_no_output():
    assert len(NOTEBOOKS) == 3
    for path in NOTEBOOKS:
        book = json.loads(path.read_text(encoding="utf-8"))
        assert book["nbformat"] == 4 and len({cell["id"] for cell in book["cells"]}) == len(book["cells"])
        code = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
        assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)


# of ArviZ's own figures beside a newer Matplotlib
@pytest.mark.filterwarnings("ignore:Passing a dict or None as alias_mapping")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_draws_its_figures(path, tmp_path):
    text, figures = notebooks.page(path, tmp_path)
    assert len(figures) >= 2 and all(content.startswith(b"\x89PNG") for content in figures.values())
    assert text.count("```text") >= 2 and all(f"]({name})" in text for name in figures)


@pytest.mark.long
@pytest.mark.parametrize("page", [page for page, until in PAGES.items() if until])
def test_a_tutorial_runs_to_its_end(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_page(f"docs/tutorials/{page}.md") >= 5


@pytest.mark.long
def test_the_readme_s_commands_run_on_the_files_of_the_tutorial(tmp_path, monkeypatch):
    """Own data in ten lines: the campaign, the model and the records are those of tutorials/own_campaign.md."""
    monkeypatch.chdir(tmp_path)
    run_page("docs/tutorials/own_campaign.md", "convert")
    names: dict = {}
    code = [text for language, _, text in blocks("docs/tutorials/own_campaign.md") if language == "python"]
    Path("raw/one.csv").unlink(), Path("raw").rmdir()
    for text in code[:2]:
        exec(compile(text, "own_campaign.md", "exec"), names)
    files = [(title, text) for _, title, text in blocks("docs/tutorials/own_campaign.md") if title]
    for title, text in files:
        Path(title).write_text(text, encoding="utf-8")
    (ten,) = [text for language, _, text in blocks("README.md") if language == "sh" and "convert raw" in text]
    for line in ten.splitlines():
        words = shlex.split(line, comments=True)[1:]
        assert main(words) == 0, words
    assert Path("run/report.html").stat().st_size > 1e5
