"""The project's papers say what is there: commands, options, files, keys, tests and links exist, the example runs."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import probupdate
from probupdate.campaign.reading import CAMPAIGN_KEYS, SENSOR_KEYS, UNITS
from probupdate.campaign.scada import COLUMNS
from probupdate.cli import build_parser
from probupdate.modes import read_modes
from probupdate.problem import build_problem
from probupdate.reporting.run_files import HEAD_KEYS, PARTS
from probupdate.structure.load import REFERENCE_STATES, reference_model
from probupdate.structure.parameter_table import KEYS, parameter_from_table
from probupdate.structure.subdyn_model import ACTS, SubDynDescription

ROOT = Path(__file__).resolve().parents[1]
PAPERS = ("README.md", "DESIGN.md", "VALIDATION.md", "CHANGELOG.md")
STUDIES = tuple(sorted(p.relative_to(ROOT).as_posix() for p in ROOT.glob("studies/*/README.md")))
NOT_YET = ()


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(name: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text(name), re.DOTALL)


def commands() -> list[list[str]]:
    lines = [line for block in blocks("README.md", "sh") for line in block.splitlines()]
    return [line.split("#")[0].split()[1:] for line in lines if line.startswith("probupdate ")]


def parsers() -> dict:
    (verbs,) = (a for a in build_parser()._actions if a.dest == "verb")
    return verbs.choices


def test_every_command_of_the_readme_is_taken_as_it_is_typed():
    typed = commands()
    # a page without commands would pass the loop
    assert len(typed) >= 7
    for words in typed:
        build_parser().parse_args(words)


def test_the_readme_names_every_command_and_the_absent_ones_are_absent():
    assert all(re.search(rf"`(probupdate )?{verb}\b", text("README.md")) for verb in parsers())
    for verb in NOT_YET:
        assert verb not in parsers() and f"`{verb}`" in text("README.md")
    for verb in parsers():
        assert callable(getattr(probupdate, verb))


def test_options_named_in_the_readme_exist():
    known = {option for parser in parsers().values() for option in parser._option_string_actions}
    ours = re.sub(r"```sh\n.*?```", "", text("README.md"), flags=re.DOTALL)
    named = set(re.findall(r"`(--[a-z-]+)", ours))
    assert named and named <= known, named - known


def test_targets_of_make_exist():
    targets = set(re.findall(r"^([a-z]+):", text("Makefile"), re.MULTILINE))
    named = set(re.findall(r"make ([a-z]+)\b", "".join(blocks("README.md", "sh"))))
    assert named == {"demo", "test"} <= targets


def test_keys_of_the_campaign_are_those_that_are_read():
    table = tomllib.loads(next(b for b in blocks("README.md", "toml") if "[[sensor]]" in b))
    assert set(table) == set(CAMPAIGN_KEYS) and set(table["sensor"][0]) == set(SENSOR_KEYS)
    for columns in (COLUMNS, *UNITS.values()):
        for name in columns:
            assert name in text("README.md") or name == "m/s^2"


def test_the_subdyn_example_is_a_description():
    (block,) = (b for b in blocks("README.md", "toml") if "[subdyn]" in b)
    described = SubDynDescription.model_validate(tomllib.loads(block))
    assert described.parameter[0].acts in ACTS
    assert all(re.search(rf"\b{act}\b", block) for act in ACTS)


def test_the_parameter_is_one():
    (block,) = (b for b in blocks("README.md", "toml") if "[[parameter]]" in b and "[subdyn]" not in b)
    (table,) = tomllib.loads(block)["parameter"]
    assert set(table) <= set(KEYS)
    assert parameter_from_table(table, "README").std == 1.0


def test_the_modal_sets_are_read(tmp_path):
    (block,) = blocks("README.md", "json")
    path = tmp_path / "modes.json"
    path.write_text(json.dumps(json.loads(block)))
    data = read_modes(path)
    assert data.n_mode == 2 and data.set().environment["nacelle_angle_deg"] == 65.0


def test_files_of_a_run_and_keys_of_its_head_are_named():
    readme = text("README.md")
    for name in PARTS:
        assert f"run/{name}" in readme, name
    for key in set(HEAD_KEYS) - {"seed", "version"}:
        assert f"`{key}`" in readme, key


def test_the_python_example_runs_and_its_posterior_is_that_of_quadrature(tmp_path, monkeypatch, capsys):
    (code,) = [b for b in blocks("README.md", "python") if "sample(" in b]
    monkeypatch.chdir(tmp_path)
    names: dict = {"__name__": "example"}
    exec(compile(code, "README.md", "exec"), names)
    assert re.search(r"^lower .*strongly identified$", capsys.readouterr().out, re.MULTILINE)
    posterior = names["posterior"]
    # a grid over eight deviations: for a smooth density that ends within it the plain sum is exact to rounding
    centre, std = names["updated"].map_theta, np.sqrt(np.diag(names["updated"].map_covariance))
    steps = np.linspace(-8, 8, 61)
    theta = centre + std * np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = build_problem(names["model"], names["data"]).log_posterior(theta)[0]
    weight = np.exp(weight - weight.max())
    weight /= weight.sum()
    mean = weight @ theta
    variance = weight @ (theta - mean) ** 2
    draws = posterior.draws
    error = np.sqrt(variance / posterior.ess)
    assert np.all(np.abs(draws.mean(axis=0) - mean) < 4 * error)
    # a normal's variance of n draws is known to sqrt(2 / n) of itself
    assert np.all(np.abs(draws.var(axis=0) / variance - 1) < 4 * np.sqrt(2 / posterior.ess))


def test_floors_of_the_design_are_those_of_the_layering_test():
    from test_layering import FLOOR

    stated = {}
    for line in text("DESIGN.md").splitlines():
        if found := re.match(r"\| ([\d.]+) \| ([^|]+) \|", line):
            stated |= {name: float(found[1]) for name in re.findall(r"`(\w+)`", found[2])}
    assert stated == FLOOR


def test_tests_and_studies_named_in_the_validation_exist():
    named = set(re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", text("VALIDATION.md")))
    assert len(named) > 20
    for path, function in named:
        assert (ROOT / path).is_file(), path
        if function:
            assert re.search(rf"^def {function}\(", text(path), re.MULTILINE), f"{path}::{function}"
    for path in set(re.findall(r"`(studies/[\w/.]+)`", text("VALIDATION.md"))):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize("name", PAPERS)
def test_links_lead_somewhere(name):
    for target in re.findall(r"\]\(([^)]+)\)", text(name)):
        assert (ROOT / target).exists(), target


@pytest.mark.parametrize("name", (*PAPERS, *STUDIES))
def test_papers_hold_no_machine_path_and_no_address(name):
    found = re.search(r"(?<![\w.])/(work|home|root|tmp|Users)\b|https?://|[A-Z]:\\\\", text(name))
    assert found is None, found


@pytest.mark.parametrize("name", PAPERS)
def test_no_line_of_prose_is_longer_than_the_code_s(name):
    # rows of tables cannot be broken
    assert not [line for line in text(name).splitlines() if len(line) > 125 and not line.startswith("|")]


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


def test_an_effect_of_ones_own_is_made_as_the_readme_says():
    (code,) = [b for b in blocks("README.md", "python") if "crosstalk" in b]
    made = {}
    exec(code, made)
    assert made["own"].kind == "measurement" and made["platform"].effect.parameter == made["platform"].model.name
    assert dict(made["lower"].increments) == {"k1": 1.0, "k2": 1.0}


def test_the_table_of_packages_is_that_of_the_lock():
    locked = set(re.findall(r"^([A-Za-z0-9_.-]+)==([^\s;\\]+)", text("requirements.lock"), re.MULTILINE))
    rows = re.findall(r"^\| (\S+) \| ([^|]+) \| ([^|]+) \|", text("studies/supply_chain/PACKAGES.md"), re.MULTILINE)[1:]
    listed = {(name, version) for name, versions, _ in rows for version in versions.split(", ")}
    assert listed - {("---", "---")} == locked, "run studies/supply_chain/licences.py again"
    assert all(re.fullmatch(r"(\d{4}-\d\d-\d\d|not stated|-)(, (\d{4}-\d\d-\d\d|not stated|-))*", days.strip())
               for name, _, days in rows if name != "---")  # fmt: skip
