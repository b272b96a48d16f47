import pytest
from command_cases import write_building

from probupdate.cli import main


@pytest.fixture
def building(tmp_path):
    """Paths of model.npz, parameters.toml and modes.json of the small building, by name, with `folder`."""
    return write_building(tmp_path) | {"folder": tmp_path}


@pytest.fixture
def refused(capsys):
    """Runs a command that must end with exit code 2 and one line on stderr, which is returned."""

    def run(*arguments) -> str:
        try:
            code = main([str(a) for a in arguments])
        except SystemExit as end:
            code = end.code
        said = capsys.readouterr()
        assert code == 2, said.err
        # work of more than two seconds may have told of its progress, indented, before it met the mistake
        lines = [line for line in said.err.splitlines() if not line.startswith("  ")]
        assert len(lines) == 1, said.err
        assert lines[0].startswith("probupdate")
        return lines[0]

    return run


@pytest.fixture(scope="session")
def estimated(tmp_path_factory):
    """Folder with the building, update.json, posterior.nc of a chain of one segment and compare.json."""
    folder = tmp_path_factory.mktemp("building")
    paths = write_building(folder)
    problem = ["--model", paths["model"], "--modes", paths["modes"]]
    update, posterior = str(folder / "update.json"), str(folder / "posterior.nc")
    assert main(["update", *problem, "--out", update]) == 0
    assert main(["sample", *problem, "--out", posterior, "--ess", "100", "--max-steps", "400"]) == 0
    assert main(["compare", update, posterior, "--model", paths["model"], "--out", str(folder / "compare.json")]) == 0
    return folder
