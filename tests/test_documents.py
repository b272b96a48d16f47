"""The project's papers say what is there: commands, options, files, keys, tests and links exist, the example runs."""

import ast
import csv
import dataclasses
import json
import pydoc
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from validation import MARK, Row, properties, written

import probupdate
from probupdate.campaign.reading import UNITS, WrittenCampaign, WrittenSensor
from probupdate.campaign.scada import COLUMNS
from probupdate.campaign.sensor_findings import SensorFinding
from probupdate.cli import build_parser
from probupdate.diagnosis.results import DetectableSizeTable, DiagnosisTable, FindingTable
from probupdate.lifetime.conditions import Conditions
from probupdate.modal.modes import read_modes
from probupdate.reporting.run_files import HEAD_KEYS, PARTS
from probupdate.structure.description import Description as TurbineDescription
from probupdate.structure.description_file import nested_tables
from probupdate.structure.effect_kinds import EffectKeys
from probupdate.structure.load import REFERENCE_STATES, reference_model
from probupdate.structure.parameter_table import KEYS, parameter_from_table
from probupdate.structure.subdyn_model import ACTS, SubDynDescription
from probupdate.updating.comparison import Comparison, ComparisonRow
from probupdate.updating.discrepancy import default_likelihood
from probupdate.updating.information import Information
from probupdate.updating.joint_file import FarmJoint
from probupdate.updating.problem import build_problem
from probupdate.updating.set_views_file import SetViews
from probupdate.updating.update_file import AlphaRecord, ComponentsRecord, ScatterRecord, SchemeRecord, UpdateRecord
from probupdate.virtual.effects import COVARIATES, EFFECTS, TIME_PROFILES

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from studies.command import STUDIES as RUN_ALIKE  # noqa: E402
from studies.command import main as study_command  # noqa: E402
from studies.performance import history  # noqa: E402

ROWS = "tests/validation_rows.md"
PAPERS = ("README.md", "DESIGN.md", "VALIDATION.md", "CHANGELOG.md", ROWS)
PAGES = tuple(sorted(p.relative_to(ROOT).as_posix() for p in ROOT.glob("docs/**/*.md")))
# pages whose commands name files that only a reader has
TYPED = ("README.md", *PAGES)
CAMPAIGN, MODES, MODEL, RUN = (f"docs/formats/{name}.md" for name in ("campaign", "modes", "model", "run_directory"))
PYTHON, OWN_EFFECT = "docs/howto/python.md", "docs/howto/own_effect.md"
STUDIES = tuple(sorted(p.relative_to(ROOT).as_posix() for p in ROOT.glob("studies/*/RESULTS.md")))
NOT_YET = ()


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(name: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text(name), re.DOTALL)


def commands(names) -> list[list[str]]:
    lines = [line for name in names for block in blocks(name, "sh") for line in block.splitlines()]
    return [line.split("#")[0].split()[1:] for line in lines if line.startswith("probupdate ")]


def parsers() -> dict:
    (verbs,) = (a for a in build_parser()._actions if a.dest == "verb")
    return verbs.choices


def test_every_command_of_the_pages_is_taken_as_it_is_typed():
    # a page without commands would pass the loop
    assert len(commands(["README.md"])) >= 7
    typed = commands(TYPED)
    for words in typed:
        if words != ["--help"]:
            build_parser().parse_args(words)
    assert {words[0] for words in typed} >= set(parsers()) - {"regress", "inform", "sets"}


def test_the_pages_name_every_command_and_the_absent_ones_are_absent():
    whole = "".join(map(text, TYPED))
    assert all(re.search(rf"`(probupdate )?{verb}\b", whole) for verb in parsers())
    for verb in NOT_YET:
        assert verb not in parsers() and f"`{verb}`" in text("README.md")
    for verb in parsers():
        assert callable(getattr(probupdate, verb))


def test_options_named_in_the_pages_exist():
    known = {option for parser in parsers().values() for option in parser._option_string_actions}
    # a study's own options stand on its row
    ours = re.sub(r"```sh\n.*?```", "", "".join(text(n) for n in TYPED if "studies" not in n),
                  flags=re.DOTALL)
    named = set(re.findall(r"`(--[a-z-]+)", ours))
    assert named and named <= known, named - known


def test_targets_of_make_exist():
    targets = set(re.findall(r"^([a-z]+):", text("Makefile"), re.MULTILINE))
    named = set(re.findall(r"make ([a-z]+)\b", "".join(blocks("README.md", "sh"))))
    assert named == {"demo", "test"} <= targets


def test_keys_of_the_campaign_are_those_that_are_read():
    table = tomllib.loads(next(b for b in blocks(CAMPAIGN, "toml") if "[[sensor]]" in b))
    for keys, kind in ((table, WrittenCampaign), (table["sensor"][0], WrittenSensor)):
        assert set(keys) == {f.name for f in dataclasses.fields(kind)}
    for columns in (COLUMNS, *UNITS.values()):
        for name in columns:
            assert name in text(CAMPAIGN) or name == "m/s^2"


def test_the_subdyn_example_is_a_description():
    (block,) = (b for b in blocks(MODEL, "toml") if "[subdyn]" in b)
    described = SubDynDescription.model_validate(tomllib.loads(block))
    assert described.parameter[0].acts in ACTS
    assert all(re.search(rf"\b{act}\b", block) for act in ACTS)


def test_the_parameter_is_one():
    (block,) = (b for b in blocks(MODEL, "toml") if 'name = "py"' in b)
    (table,) = tomllib.loads(block)["parameter"]
    assert set(table) <= set(KEYS)
    assert parameter_from_table(table, "model.md").std == 1.0


def test_the_modal_sets_are_read(tmp_path):
    (block,) = blocks(MODES, "json")
    path = tmp_path / "modes.json"
    path.write_text(json.dumps(json.loads(block)))
    data = read_modes(path)
    assert data.n_mode == 2 and data.set().environment["nacelle_angle_deg"] == 65.0


def test_files_of_a_run_and_keys_of_its_head_are_named():
    page = text(RUN)
    for name in PARTS:
        assert f"run/{name}" in page, name
    for key in set(HEAD_KEYS) - {"seed", "version"}:
        assert f"`{key}`" in page, key


def test_the_python_example_runs_and_its_posterior_is_that_of_quadrature(tmp_path, monkeypatch, capsys, validation):
    row = validation(what="posterior of the Python page's example, two parameters: means, variances",
                     reference="quadrature over a grid", unit="standard errors")
    code = blocks(PYTHON, "python")[0]
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "example"}
    exec(compile(code, PYTHON, "exec"), names)
    assert re.search(r"^lower .*strongly identified$", capsys.readouterr().out, re.MULTILINE)
    posterior = names["posterior"]
    # a grid over eight deviations: for a smooth density that ends within it the plain sum is exact to rounding
    centre, std = names["updated"].map_theta, np.sqrt(np.diag(names["updated"].map_covariance))
    steps = np.linspace(-8, 8, 61)
    theta = centre + std * np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    weights = default_likelihood(names["model"], names["data"])
    weight = build_problem(names["model"], names["data"], weights=weights).log_posterior(theta)[0]
    weight = np.exp(weight - weight.max())
    weight /= weight.sum()
    mean = weight @ theta
    variance = weight @ (theta - mean) ** 2
    draws = posterior.draws
    error = np.sqrt(variance / posterior.ess)
    row.error((draws.mean(axis=0) - mean) / error, below=4, of="means")
    # a normal's variance of n draws is known to sqrt(2 / n) of itself
    row.error((draws.var(axis=0) / variance - 1) / np.sqrt(2 / posterior.ess), below=4, of="variances")


def test_floors_of_the_design_are_those_of_the_layering_test():
    from test_layering import FLOOR

    stated = {}
    for line in text("DESIGN.md").splitlines():
        if found := re.match(r"\| ([\d.]+) \| ([^|]+) \|", line):
            stated |= {name: float(found[1]) for name in re.findall(r"`(\w+)`", found[2])}
    assert stated == FLOOR


def test_every_row_of_the_validation_names_what_checks_it():
    rows = [line for line in text(ROWS).splitlines() if re.match(r"\| (?!what )", line)]
    assert len(rows) > 200
    for row in rows:
        cells = re.split(r"(?<!\\)\|", row.strip("|"))
        assert len(cells) == 5 and re.search(r"`(tests|studies)/[\w/.:]+`", cells[-1]), row


def test_tests_and_studies_named_in_the_validation_exist():
    named = set(re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", text(ROWS)))
    assert len(named) > 20
    for path, function in named:
        assert (ROOT / path).is_file(), path
        if function:
            assert re.search(rf"^def {function}\(", text(path), re.MULTILINE), f"{path}::{function}"
    for path in set(re.findall(r"`(studies/[\w/.]+)`", text(ROWS) + text("VALIDATION.md"))):
        assert (ROOT / path).exists(), path


def recorded_by_tests() -> dict[str, tuple[str, str]]:
    """Test -> what and reference of each that states its own row of the validation, as its source has them."""
    found = {}
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for function in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(function, ast.FunctionDef) or "validation" not in {a.arg for a in function.args.args}:
                continue
            calls = [n for n in ast.walk(function)
                     if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "validation"]
            assert len(calls) == 1, f"{function.name}: one row a test"
            words = {k.arg: ast.literal_eval(k.value) for k in calls[0].keywords}
            found[f"{path.relative_to(ROOT).as_posix()}::{function.name}"] = (words["what"], words["reference"])
    return found


def test_marked_rows_of_the_validation_are_those_that_tests_state():
    marked = {}
    for line in text(ROWS).splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("| ") and len(cells) == 5 and cells[3].endswith(MARK):
            marked[cells[4].strip("`")] = (cells[0], cells[1])
    assert len(marked) > 10 and marked == recorded_by_tests()


def test_a_row_holds_what_was_asserted_and_the_worst_of_all_cases():
    one, two = (Row(what="pile", reference="closed form", why="mesh") for _ in range(2))
    one.error([1e-7, -3e-7], below=1e-6)
    two.error(2e-7, below=1e-6)
    with pytest.raises(AssertionError, match="pile: 2e-06 is not below 1e-06"):
        Row(what="pile", reference="closed form").error(-2e-6, below=1e-6)
    measured = {"tests/a.py::b": [row for _, row in properties([one, two])]}
    page = "| what | else |\n| old | by hand | 1 | 2 | `tests/a.py::b` |\n| other | | | | `tests/a.py::bc` |"
    row = f"| pile | closed form | 1e-6: mesh | 3e-7 {MARK} | `tests/a.py::b` |"
    other = "| other | | | | `tests/a.py::bc` |"
    assert written(page, measured).splitlines()[1:] == [row, other]
    # one without a row gets it behind those of its file, or of its folder
    for new in ("tests/a.py::c", "tests/other.py::c"):
        added = written(page, {new: measured["tests/a.py::b"]}).splitlines()[3:]
        assert added == [row.replace("tests/a.py::b", new)]
    with pytest.raises(ValueError, match="c: 0 rows"):
        written(page, {"elsewhere/a.py::c": measured["tests/a.py::b"]})


def test_a_row_holds_bounds_from_below_ranges_and_counts():
    one, two = (Row(what="gains", reference="planted", unit="deg") for _ in range(2))
    for row, mac_, angle, right in ((one, 0.99, [0.4, 0.7], 19), (two, 0.985, [0.5], 20)):
        row.least(mac_, above=0.98, of="MAC")
        row.between(angle, 0.2, 1.2, of="angle")
        row.count(right, 20, least=18, of="found")
        row.equal(np.arange(3), np.arange(3), of="names")
    page = "| gains | by hand | | | `tests/a.py::b` |"
    assert written(page, {"tests/a.py::b": [row for _, row in properties([one, two])]}) == (
        "| gains | planted | at least 0.98 (MAC), 0.2 to 1.2 deg (angle), 36 of 40 at least (found), equal (names) | "
        f"0.985, 0.4 to 0.7 deg, 39 of 40, equal {MARK} | `tests/a.py::b` |")
    for wrong in (lambda: one.least(0.97, above=0.98, of="MAC"), lambda: one.between(1.3, 0.2, 1.2, of="angle"),
                  lambda: one.count(17, 20, least=18, of="found"), lambda: one.equal([1], [2], of="names"),
                  lambda: one.least(0.99, above=0.9, of="MAC")):
        with pytest.raises(AssertionError, match="gains, "):
            wrong()


def test_a_row_holds_plain_numbers():
    """Those of numpy ended a run in several processes, which send one another plain ones only."""
    row = Row(what="gains", reference="planted")
    row.error(np.array([1e-3]), below=np.float64(0.1), of="size")
    row.count(np.int64(3), np.int64(4), np.int64(2), of="found")
    ((_, kept),) = properties([row])
    numbers = [x for q in kept["quantities"].values() for x in (*q["limit"], *q["worst"])]
    assert len(numbers) == 5 and all(type(x) in (int, float) for x in numbers)


@pytest.mark.parametrize("name", (*PAPERS, *PAGES))
def test_links_lead_somewhere(name):
    for target in re.findall(r"\]\(([^)]+)\)", text(name)):
        path = target.split("#")[0]
        # pictures/ is made by docs/hooks.py
        assert not path or path.startswith("pictures/") or ((ROOT / name).parent / path).exists(), target


@pytest.mark.parametrize("name", (*PAPERS, *STUDIES, *PAGES))
def test_papers_hold_no_machine_path_and_no_address(name):
    found = re.search(r"(?<![\w.])/(work|home|root|tmp|Users)\b|https?://|[A-Z]:\\\\", text(name))
    assert found is None, found


def test_the_readme_is_short():
    assert len(text("README.md").split()) <= 450


def test_the_documents_hold_25_000_words():
    """Whatever has a letter or a digit, outside code and equations."""
    left_out, whole = r"^```.*?^```|^\$\$.*?\$\$|\$[^$\n]+\$", "\n".join(map(text, PAGES))
    prose = re.sub(left_out, "", whole, flags=re.DOTALL | re.MULTILINE)
    assert len([word for word in prose.split() if re.search(r"\w", word)]) <= 25_000


def test_the_change_log_is_read_in_two_minutes():
    assert len(text("CHANGELOG.md").splitlines()) <= 60


@pytest.mark.parametrize("name", (*PAPERS, *PAGES))
def test_no_line_of_prose_is_longer_than_the_code_s(name):
    # rows of tables and equations cannot be broken
    assert not [line for line in text(name).splitlines() if len(line) > 125 and not line.startswith(("|", "$$"))]


@pytest.mark.parametrize("name", (*PAPERS, *STUDIES, *PAGES))
def test_tables_have_a_header_and_as_many_cells_in_every_row(name):
    prose = re.sub(r"^```.*?^```", "", text(name), flags=re.DOTALL | re.MULTILINE)
    for table in re.findall(r"(?:^\|.*\n?)+", prose, re.MULTILINE):
        rows = re.sub(r"`[^`]*`|\\\|", "", table).splitlines()
        assert len(rows) > 2 and re.fullmatch(r"[|\- ]+", rows[1]), rows[0]
        assert len({row.count("|") for row in rows}) == 1, rows[0]


def test_packaged_files_are_all_shipped():
    """Whatever is not Python in the package is matched by a pattern of package-data."""
    patterns = tomllib.loads(text("pyproject.toml"))["tool"]["setuptools"]["package-data"]["probupdate"]
    package = ROOT / "probupdate"
    shipped = {path for pattern in patterns for path in package.glob(pattern)}
    other = {p for p in package.rglob("*") if p.is_file() and p.suffix not in (".py", ".pyc") and p.name[0] != "."}
    assert other and other <= shipped, other - shipped
    for state in REFERENCE_STATES:
        assert reference_model(state) in shipped


def test_the_versions_agree():
    assert f"## {probupdate.__version__} " in text("CHANGELOG.md")


def test_an_effect_of_ones_own_is_made_as_its_page_says():
    (code,) = blocks(OWN_EFFECT, "python")
    made = {}
    exec(code, made)
    assert made["own"].kind == "measurement" and dict(made["platform"].increments) == {made["platform"].adds.name: 1.0}
    assert dict(made["lower"].increments) == {"k1": 1.0, "k2": 1.0}


def test_the_table_of_packages_is_that_of_the_lock():
    locked = set(re.findall(r"^([A-Za-z0-9_.-]+)==([^\s;\\]+)", text("requirements.lock"), re.MULTILINE))
    rows = re.findall(r"^\| (\S+) \| ([^|]+) \| ([^|]+) \|", text("studies/supply_chain/RESULTS.md"), re.MULTILINE)[1:]
    listed = {(name, version) for name, versions, _ in rows for version in versions.split(", ")}
    assert listed - {("---", "---")} == locked, "run studies/supply_chain/licences.py again"
    assert all(re.fullmatch(r"(\d{4}-\d\d-\d\d|not stated|-)(, (\d{4}-\d\d-\d\d|not stated|-))*", days.strip())
               for name, _, days in rows if name != "---")


def test_every_decision_has_its_four_parts_and_its_line_in_the_index():
    pages = {p.name for p in (ROOT / "docs" / "decisions").glob("*.md")} - {"index.md"}
    listed = re.findall(r"\]\((\w+\.md)\)", text("docs/decisions/index.md"))
    assert len(listed) == len(set(listed)) <= 20 and set(listed) == pages
    for name in pages:
        page = text(f"docs/decisions/{name}")
        heads = re.findall(r"^## (.+)$", page, re.MULTILINE)
        assert heads == ["Context", "Decision", "Alternatives", "Evidence"], name
        assert len(page.split()) <= 450, f"{name} is longer than a page"
        tests = re.findall(r"`(tests/[\w/]+\.py)`", page)
        assert tests and all((ROOT / test).is_file() for test in tests), f"{name}: {tests}"


def test_equations_have_one_place_and_point_at_what_evaluates_them():
    pages = [name for name in PAGES if name.startswith("docs/theory/") and not name.endswith("index.md")]
    numbers = [n for name in pages for n in re.findall(r"^\*\*\((\w+)\)\*\*", text(name), re.MULTILINE)]
    assert len(numbers) == len(set(numbers)) and {str(k) for k in range(1, 8)} <= set(numbers)
    for name in pages:
        # an equation's own words end where the next one, or a heading, begins
        for number, words in re.findall(r"^\*\*\((\w+)\)\*\*(.*?)(?=^\$\$|^\*\*\(|^## |\Z)", text(name),
                                        re.MULTILINE | re.DOTALL):
            assert "Source:" in words, f"{name}, ({number}) has no source"
        named = set(re.findall(r"`(probupdate\.[\w.]+)`", text(name)))
        assert named, name
        for pointer in named:
            assert pydoc.locate(pointer) is not None, f"{name}: {pointer}"


def test_the_format_of_a_turbine_names_every_key():
    def names(table):
        for key, field in table.model_fields.items():
            yield key
            for inner in nested_tables(field.annotation):
                yield from names(inner)

    page = text(MODEL)
    for key in set(names(TurbineDescription)) - set(EffectKeys.model_fields):
        assert f"`{key}`" in page or re.search(rf"^{key} = ", page, re.MULTILINE), key


def test_the_format_of_loads_names_every_key():
    page = text("docs/formats/fatigue.md")
    schema = Conditions.model_json_schema()
    for key in {name for table in (schema, *schema["$defs"].values()) for name in table["properties"]}:
        assert f"`{key}`" in page or f"`{key}.<name>`" in page, key


def test_the_format_of_a_truth_names_every_kind_and_size():
    page = text("docs/formats/truth.md")
    for name, kind in EFFECTS.items():
        (row,) = (line for line in page.splitlines() if line.startswith(f"| `{name}` "))
        assert f"`{kind.size}` | {kind.unit} " in row and all(f"`{key}`" in row for key in kind.place), name
    for name in (*COVARIATES, *TIME_PROFILES):
        assert f"`{name}`" in page, name


@pytest.mark.parametrize(("title", "table"), [
    ("diagnosis.json", DiagnosisTable), ("diagnosis.json", FindingTable), ("diagnosis.json", DetectableSizeTable),
    ("update.json", UpdateRecord), ("update.json", SchemeRecord), ("update.json", ScatterRecord),
    ("update.json", AlphaRecord), ("update.json", ComponentsRecord),
    ("compare.json", Comparison), ("compare.json", ComparisonRow), ("information.json", Information),
    ("sets.json", SetViews), ("check.json", SensorFinding), ("farm_joint.json", FarmJoint),
])
def test_the_formats_of_results_name_every_key(title, table):
    (section,) = re.findall(rf"^## `{re.escape(title)}`$(.*?)^## ", text("docs/formats/results.md"),
                            re.DOTALL | re.MULTILINE)
    for key in (field.name for field in dataclasses.fields(table)):
        assert f"`{key}`" in section, key


def test_every_study_runs_by_the_same_command_and_stands_in_the_table(capsys):
    folders = {p.name for p in (ROOT / "studies").iterdir() if p.is_dir() and p.name != "__pycache__"}
    assert set(RUN_ALIKE) == folders
    page = text("docs/studies.md")
    for name, study in RUN_ALIKE.items():
        assert (ROOT / "studies" / name / "__main__.py").is_file()
        for script, *_ in (*study.runs, *study.quick):
            assert (ROOT / "studies" / name / script).is_file(), f"{name}, {script}"
        (row,) = (line for line in page.splitlines() if line.startswith(f"| [{name}]("))
        assert f"| {study.question} |" in row and row.endswith(f"| {'yes' if study.quick else 'no'} |")
        # what came out, of which commit, seeds and machine
        results = text(f"studies/{name}/RESULTS.md")
        assert f"(../studies/{name}/RESULTS.md)" in row
        for stated in (r"commits?\s[0-9a-f]{7}", r"\bseeds?:?\s", r"machine:\s|\bcores\b"):
            assert re.search(stated, results), f"{name}, {stated}"
        with pytest.raises(SystemExit) as ended:
            study_command(name, ["--help"])
        assert ended.value.code == 0 and study.question in " ".join(capsys.readouterr().out.split())


def test_the_page_of_benchmarks_is_that_of_their_table(tmp_path):
    with open(history.TABLE, encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert set(rows[0]) == set(history.COLUMNS) and all(float(row["value"]) > 0 for row in rows)
    assert text("docs/benchmarks.md") == history.page(rows), "run studies/performance/history.py"
    (tmp_path / "study.json").write_text(json.dumps(dict.fromkeys(history.COLUMNS[:5], "1")))
    (tmp_path / "printed.txt").write_text(
        "without deviations: 33 ms; 6 projected references 22 ms; plain numpy 0.08 s, ratio 2.4\n"
        "reduced basis, 1000 at once                      1700.0     20.10\n"
        "all of sample over emcee, ten parameters: 25.8\n"
        "a page of 4.3 MB: 3.6 s of it, 3.0 s of that, ratio 1.20; by the clock 3.0; pages are NOT the same\n")
    found = history.found(tmp_path)
    # a page that came out otherwise has no ratio
    assert {row["ratio"]: row["value"] for row in found} == {
        "identification": "2.4", "reduced basis": "20.10", "sampler": "25.8"}
    assert len(history.merged(history.merged(rows, found), found)) == len(rows) + 3


# left-hand words of the glossary that have no other meaning here; keys and names of code stand in backticks
PRIVATE = re.compile(
    r"\b(told|foretells?|doubts?|fingerprints?|slabs?|rivals?|gross(ly)?|likeness|pushed|as good as sure|departs?"
    r"|departures?|remainders?|surroundings|(?<![Ss]tandard )deviations?)\b"
)


@pytest.mark.parametrize("name", ("README.md", "DESIGN.md", "CHANGELOG.md", *PAGES))
def test_documents_use_the_field_s_words(name):
    prose = re.sub(r"^```.*?^```|`[^`]*`|\]\([^)]*\)|\*\*\(\w+\)\*\*", "", text(name), flags=re.DOTALL | re.MULTILINE)
    prose = re.sub(r"\s+", " ", prose)
    # a hash over a problem is called so in update.json; a robust scale
    for said in ("Its fingerprint (", "with different fingerprints", "problem's fingerprint",
                 "median absolute deviation"):
        prose = prose.replace(said, "")
    found = [prose[max(m.start() - 40, 0) : m.end() + 20] for m in PRIVATE.finditer(prose)]
    assert not found, found


def user_strings(path: Path):
    """(line, text) of every string of a module that is no docstring and has more than one word."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    documented = (ast.Module, ast.FunctionDef, ast.ClassDef)
    docstrings = {id(node.body[0].value) for node in ast.walk(tree)
                  if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            said = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            said = node.value
        else:
            continue
        if " " in said.strip():
            yield node.lineno, said


WORDED = ("*.py", *sorted(f"{p.parent.name}/*.py" for p in (ROOT / "probupdate").glob("*/__init__.py")))


@pytest.mark.parametrize("pattern", WORDED)
def test_sentences_for_users_use_the_field_s_words(pattern):
    paths = sorted((ROOT / "probupdate").glob(pattern))
    assert paths
    # of files and of spectra: no standard deviation
    found = [f"{path.name}:{line}: {said}" for path in paths for line, said in user_strings(path)
             if PRIVATE.search(said) and "median deviation" not in said and ".deviations.h5" not in said
             and not said.endswith(", deviations")]
    assert not found, found


# left-hand words as names of code; hashes called fingerprint are others
NAMES = re.compile(r"^_?(told|tells|slabs?|courses?|departures?|rivals?|likeness|outlines?|standings?|pushed|doubts?"
                   r"|stretch(es)?|remainder|surroundings|left_over|\w*(deviation|course|departure|rival)s?(_\w+)?)$")


def test_names_of_the_code_use_the_field_s_words():
    found = set()
    for path in (ROOT / "probupdate").rglob("*.py"):
        names = {name for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
                 for key in ("id", "name", "arg") if isinstance(name := node.__dict__.get(key), str)}
        found |= {f"{path.name}: {name}" for name in names if NAMES.match(name)}
    assert not found, sorted(found)
    assert NAMES.match("ln_deviation") and NAMES.match("told") and not NAMES.match("tolled")
