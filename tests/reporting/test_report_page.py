"""The page: self-contained, complete, escaped, the same for the same run, honest about what is missing."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import re
from dataclasses import fields, replace
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import pytest

from probupdate.model.parameters import Parameters
from probupdate.reporting import compose, figures
from probupdate.reporting.elements import Column, Table, decimal, full_sentence, number, percent, plain_text
from probupdate.reporting.page import csv_text

SECTIONS = ("verdict", "measured", "identified", "selected", "diagnosis", "update", "posterior", "comparison", "modes",
            "provenance")
VOID = {"meta", "input", "br", "img", "link", "hr", "col", "source", "area", "base", "wbr"}


class Reader(HTMLParser):
    """Collects ids, references and unbalanced tags."""

    def __init__(self):
        super().__init__()
        self.ids, self.references, self.open, self.wrong = [], [], [], []

    def handle_starttag(self, tag, attributes):
        self.handle_startendtag(tag, attributes)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        for key, value in attributes:
            if key == "id":
                self.ids.append(value)
            if key in ("src", "href", "xlink:href", "action", "data", "srcset"):
                self.references.append(value)

    def handle_endtag(self, tag):
        if tag in VOID:
            return
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def read(html: str) -> Reader:
    reader = Reader()
    reader.feed(html)
    reader.close()
    return reader


@pytest.fixture(scope="module")
def page(full_run):
    return compose(full_run)


def test_nothing_is_fetched_from_anywhere(page):
    reader = read(page)
    for reference in reader.references:
        assert reference.startswith(("#", "data:")), reference
    assert not re.search(r"@import|url\(\s*['\"]?(?!#|data:)", page)
    assert not re.search(r"fetch\(|XMLHttpRequest|WebSocket|importScripts", page)
    # the addresses that remain are names of XML vocabularies
    for address in re.findall(r"https?://[^\s\"'<>]+", page):
        assert address.startswith(("http://www.w3.org/",)), address


def test_the_policy_allows_nothing_from_outside_and_no_script_but_the_pages_own(page):
    policies = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', page)
    assert (len(policies) == 1
            and page.index("Content-Security-Policy") < min(map(page.index, ("<style", "<script", "<title"))))
    policy = {words[0]: words[1:] for words in (part.split() for part in policies[0].split(";"))}
    # what is not named falls back on the first, but for these two, which do not
    assert policy["default-src"] == policy["base-uri"] == policy["form-action"] == ["'none'"]
    assert policy["style-src"] == ["'unsafe-inline'"] and policy["img-src"] == ["data:"]
    scripts = re.findall(r"<script([^>]*)>(.*?)</script>", page, re.DOTALL)
    assert {kind for kind, _ in scripts} == {"", ' type="application/json"'}
    (own,) = (text for kind, text in scripts if not kind)
    assert policy["script-src"] == [f"'sha256-{base64.b64encode(hashlib.sha256(own.encode()).digest()).decode()}'"]
    # such a policy stops what stands in attributes too: none of it may be needed
    assert not re.search(r"<[^>]*\son[a-z]+\s*=|javascript:", re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL))
    assert len(policy) == 6


def test_every_section_is_there_in_order_and_the_document_is_well_formed(page):
    reader = read(page)
    assert [i for i in reader.ids if i in SECTIONS] == list(SECTIONS)
    assert not reader.wrong and not reader.open
    assert len(reader.ids) == len(set(reader.ids)), "two elements share an id"
    anchors = set(reader.ids)
    assert all(r[1:] in anchors for r in reader.references if r.startswith("#"))


def test_page_is_the_same_for_the_same_run(full_run, unfigured):
    """The text around the drawings; the drawings are asked in test_report_figures."""
    assert compose(full_run) == compose(full_run)


def test_page_is_the_same_in_two_processes(full_run):
    few = replace(full_run, **dict.fromkeys(("campaign", "modes", "poles", "nine", "model", "posterior", "diagnosis")))
    assert compose(few, jobs=2) == compose(few)


def test_size_is_bounded(page):
    assert len(page.encode()) < 5e6


def test_names_from_files_are_escaped(full_run, unfigured):
    evil = "<script>alert(1)</script>&$a_b$"
    items = (replace(full_run.update.parameters.items[0], name=evil), *full_run.update.parameters.items[1:])
    update = replace(full_run.update, parameters=Parameters(items))
    rows = (replace(full_run.comparison.rows[0], name=evil, sentence=evil), *full_run.comparison.rows[1:])
    run = replace(full_run, title=evil, update=update, jacket=False,
                  comparison=replace(full_run.comparison, rows=rows), provenance=((evil, evil),), missing=(evil,))
    html = compose(run)
    assert "alert(1)</script>" not in html
    assert html.count("<script") == 2, "the viewer's data and the viewer, nothing else"
    assert not read(html).wrong


@pytest.mark.parametrize("part", ["campaign", "modes", "poles", "selection", "nine", "model", "update", "posterior",
                                  "comparison", "truth"])
def test_page_without_a_part_says_so_and_stands(full_run, undrawn, monkeypatch, part):
    if part not in ("update", "posterior", "nine"):
        # these take most of the time and see nothing of the other parts
        for name in ("corner", "marginals", "traces_and_ranks", "update_history", "correlation_map"):
            monkeypatch.setattr(figures, name, lambda *args, **more: None)
    words = {"campaign": ["Not there", " a campaign"][1], "poles": "table of poles", "selection": "selection.csv",
             "model": "a model with geometry", "update": "update.json", "posterior": "posterior.nc",
             "comparison": "compare.json", "modes": "modes.json"}
    html = compose(replace(full_run, **{part: None}))
    reader = read(html)
    assert [i for i in reader.ids if i in SECTIONS] == list(SECTIONS) and not reader.wrong
    if part in words:
        assert words[part].strip() in html


def test_page_of_hardly_anything_stands(full_run, unfigured):
    empty = {f.name: None for f in fields(full_run) if f.name not in
             ("folder", "title", "missing", "provenance", "warnings", "jacket", "modes")}
    html = compose(replace(full_run, **empty, jacket=False))
    assert "48 modal sets" in html and not read(html).wrong


def test_paper_columns_stand_only_beside_the_jacket(full_run, page, unfigured):
    assert "Table 5" in page and "0.0696" in page and "class=\"number paper\"" in page
    plain = compose(replace(full_run, jacket=False))
    assert "class=\"number paper\"" not in plain and "0.0696" not in plain and "Table 5" not in plain


def test_conditions_that_no_set_states_have_no_column(full_run, page, unfigured):
    heading = {"nacelle_heading_deg": 30.0}
    sets = tuple(replace(s, environment=dict(s.environment) | heading) for s in full_run.nine.sets)
    stated = compose(replace(full_run, nine=replace(full_run.nine, sets=sets)))
    assert "nacelle heading" in stated and "nacelle heading" not in page


def test_soil_factors_are_explained_where_they_are_shown(page):
    assert "1/factor" in page and "k_xy" in page and "k_z" in page


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.123456, "0.123"), (1.44e5, "144\u202f000"), (9.996, "10.0"), (0.0004, "4.00 × 10⁻⁴"),
     (99999.0, "100\u202f000"), (-2.5, "−2.50"), (-1.234e8, "−1.23 × 10⁸"), (999.6, "1\u202f000"),
     (123.4, "123"), (np.nan, "–"), (0.0, "0"), (12345.0, "12\u202f300"), (-2847.0, "−2\u202f850")],
)
def test_numbers_are_shown_with_sensible_digits(value, text):
    assert number(value) == text


@pytest.mark.parametrize(("text", "names", "said"), [
    ("k_t and k_j compensate", (), "k_t and k_j compensate."), ("the data tell little", (), "The data tell little."),
    ("py scatters", ("py",), "py scatters."), ("py scatters", (), "Py scatters."), ("LJF is told.", (), "LJF is told."),
    ("is it so?", (), "Is it so?"), ("9 of 9 agree", (), "9 of 9 agree."), ("tz: known", ("tz",), "tz: known."),
])
def test_names_keep_their_letters_at_the_start_of_a_sentence(text, names, said):
    assert full_sentence(text, names) == said


def test_every_table_can_be_taken_along_and_every_figure_be_read_out(page):
    tables = page.count("<table>")
    links = re.findall(r'href="data:text/csv;charset=utf-8,([^"]+)"', page)
    assert len(links) == tables > 10
    for link in links:
        rows = list(csv.reader(io.StringIO(unquote(link).removeprefix("\ufeff"))))
        assert len(rows) > 1 and len({len(r) for r in rows}) == 1
    figures_there = re.findall(r"<figure[^>]*>(<svg[^>]*>)", page)
    assert len(figures_there) > 10
    assert all(re.search(r'role="img" aria-label="[^"]{20,}"', tag) for tag in figures_there)


@pytest.mark.parametrize("value", [-2.5, 1.44e5, 4e-4, -1.234e8, 9.996])
def test_a_number_out_of_a_table_is_the_number(value):
    assert float(plain_text(number(value))) == pytest.approx(value, rel=5e-3)


def test_a_table_for_a_spreadsheet_holds_no_formula():
    """Cells from files that a spreadsheet would run stay text; signed numbers and dashes do not become text."""
    table = Table(caption="t", columns=(Column(name="a", unit="Hz"), Column(name="b")), rows=(
        ("=1+1", "−1.5"), ("@x", "+0.3"), ('+cmd|"a,b"', "–")))
    rows = list(csv.reader(io.StringIO(csv_text(table))))
    assert rows == [["a [Hz]", "b"], ["'=1+1", "-1.5"], ["'@x", "+0.3"], ['\'+cmd|"a,b"', ""]]


def test_percent_and_fixed():
    assert percent(0.01234, 1, sign=True) == "+1.2" and percent(-0.00001, 1, sign=True) == "0.0"
    assert decimal(-0.0001, 2) == "0.00" and decimal(-1.5, 1) == "−1.5"


def test_a_table_refuses_rows_of_another_width():
    with pytest.raises(ValueError, match="2 cells for 1 columns"):
        Table(caption="t", columns=(Column(name="a"),), rows=(("1", "2"),))
