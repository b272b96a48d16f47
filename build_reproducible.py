"""The build backend: setuptools' own, with archives that are the same bytes wherever and whenever they are built.

With SOURCE_DATE_EPOCH set, a source distribution has that time, one owner and plain permissions in every entry, in the
order of names; a wheel has setuptools' reproducible head and plain permissions.
"""

import gzip
import io
import os
import tarfile
from pathlib import Path

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403  the other hooks are setuptools' own


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    with _plain_permissions():
        return build_meta.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory, config_settings=None):
    with _plain_permissions():
        name = build_meta.build_sdist(sdist_directory, config_settings)
    if "SOURCE_DATE_EPOCH" in os.environ:
        _repack(Path(sdist_directory) / name, int(os.environ["SOURCE_DATE_EPOCH"]))
    return name


class _plain_permissions:  # noqa: N801  a context
    def __enter__(self):
        self.before = os.umask(0o022)

    def __exit__(self, *error):
        os.umask(self.before)


def _repack(path: Path, second: int) -> None:
    with tarfile.open(path) as archive:
        held = sorted(((m, archive.extractfile(m).read() if m.isfile() else b"") for m in archive.getmembers()),
                      key=lambda entry: entry[0].name)  # fmt: skip
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for old, content in held:
            entry = tarfile.TarInfo(old.name)
            entry.type, entry.size, entry.mtime = old.type, len(content), second
            entry.mode = 0o755 if old.isdir() else 0o644
            archive.addfile(entry, io.BytesIO(content))
    path.write_bytes(gzip.compress(packed.getvalue(), 9, mtime=second))
