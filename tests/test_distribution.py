"""Wheel and source distribution: the same bytes twice, whole, and enough to run the demonstration from."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import time
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
LEFT_OUT = ("studies", ".git", ".venv", "build", "dist", "out", "*.egg-info", "__pycache__", ".pytest_cache")
pytestmark = pytest.mark.long


def built(place: Path, umask: int) -> Path:
    """A copy of the repository with both distributions in its dist/."""
    shutil.copytree(REPOSITORY, place, ignore=shutil.ignore_patterns(*LEFT_OUT))
    for path in place.rglob("*"):
        os.utime(path, (1.6e9 + 1e3 * umask,) * 2)
    (place / "dist").mkdir()
    for kind in ("wheel", "sdist"):
        subprocess.run(
            [sys.executable, "-c", f"import build_reproducible as b; b.build_{kind}('dist')"], cwd=place, check=True,
            capture_output=True, umask=umask,
            env={**os.environ, "SOURCE_DATE_EPOCH": "1700000000", "PYTHONPATH": str(place)})
    return place / "dist"


@pytest.fixture(scope="module")
def twice(tmp_path_factory):
    first = built(tmp_path_factory.mktemp("one") / "repository", 0o022)
    # an archive states its time to a second or two
    time.sleep(2.1)
    return first, built(tmp_path_factory.mktemp("two") / "other", 0o077)


def test_two_builds_are_the_same_bytes(twice):
    first, second = ({p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.iterdir()} for folder in twice)
    assert len(first) == 2 and first == second


def test_both_hold_the_package_whole(twice):
    wanted = {p.relative_to(REPOSITORY).as_posix() for p in (REPOSITORY / "probupdate").rglob("*")
              if p.is_file() and "__pycache__" not in p.parts}
    (wheel,), (source,) = (list(twice[0].glob(f"*.{end}")) for end in ("whl", "tar.gz"))
    assert wanted <= set(zipfile.ZipFile(wheel).namelist())
    with tarfile.open(source) as archive:
        names = {n.partition("/")[2] for n in archive.getnames()}
    assert wanted | {"build_reproducible.py", "pyproject.toml", "LICENSE", "README.md"} <= names


def test_the_demonstration_starts_from_the_wheel_alone(twice, tmp_path):
    """Unpacked where nothing else of the repository is; a quarter of a day until the first step is done."""
    (wheel,) = twice[0].glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    started = subprocess.Popen(
        [sys.executable, "-m", "probupdate.cli", "demo", str(tmp_path / "out"), "--days", "0.25"], cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path / "site"), "OMP_NUM_THREADS": "1"}, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True)
    said = ""
    for line in started.stdout:
        said += line
        if "[2/8]" in line:
            break
    started.terminate()
    _, words = started.communicate()
    assert "[1/8] simulate" in said and "[2/8]" in said and "Traceback" not in words, words
    assert len(list((tmp_path / "out" / "campaign" / "acceleration").glob("*.h5"))) >= 5
