"""`figures RUN`: every figure of the page is a file, every table a CSV, and one legend says what they show."""

import csv

import pytest

from probupdate.errors import InputError
from probupdate.reporting import SECTIONS, built_section
from probupdate.reporting.elements import Picture
from probupdate.reporting.report_figures import write_report_figures


@pytest.fixture(scope="module")
def written(full_run, tmp_path_factory):
    return write_report_figures(full_run, tmp_path_factory.mktemp("figures") / "out", "svg")


def test_every_picture_of_the_page_is_a_file_with_its_caption(written, full_run, unfigured):
    sections = [built_section(name, full_run) for name in SECTIONS]
    captions = [item.caption for s in sections if s is not None for item in s.items if isinstance(item, Picture)]
    drawn = [p for p in written if p.suffix == ".svg"]
    assert len(drawn) == len(captions) > 10
    legend = written[-1].read_text(encoding="utf-8")
    assert written[-1].name == "legend.txt" and all(f"{p.name}: " in legend for p in written[:-1])
    assert all(caption in legend for caption in captions)


def test_tables_are_rectangles_with_a_header(written):
    tables = [p for p in written if p.suffix == ".csv"]
    assert tables
    for path in tables:
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        assert len({len(row) for row in rows}) == 1 and len(rows) > 1, path.name


def test_an_unknown_kind_is_refused(full_run, tmp_path):
    with pytest.raises(InputError, match="choose from png, svg, pdf"):
        write_report_figures(full_run, tmp_path, "gif")
