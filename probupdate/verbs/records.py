"""Steps on records: setups beside one another, convert."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from probupdate.campaign.between_setups import SetupComparison, compare_setups
from probupdate.campaign.converting import Conversion
from probupdate.campaign.converting import convert as convert_files
from probupdate.campaign.reading import campaign_toml, read_campaign, read_head
from probupdate.errors import InputError
from probupdate.runtime.progress import Progress, silent

if TYPE_CHECKING:
    from probupdate.campaign.universal import Translation
    from probupdate.identification.imported_modes import ImportedModes


def check_setups(campaigns: Sequence[str | Path], *, progress: Progress = silent) -> SetupComparison:
    """Setups of one structure, a campaign folder each, with some channels in common: gains of references that differ
    between setups, or are wrong in all. What each holds alone is `check`'s."""
    paths = [Path(c) for c in campaigns]
    return compare_setups([read_campaign(path) for path in paths], setup_names(paths), progress=progress)


def setup_names(paths: Sequence[Path]) -> list[str]:
    """The folders' own names. Raises InputError where one is given twice, or two are named alike."""
    folders = [path.resolve() for path in paths]
    for k, folder in enumerate(folders):
        if folder in folders[:k]:
            raise InputError(str(paths[k]), "is given twice; setups are campaigns in folders of their own",
                             "give each folder once")
        alike = next((paths[i] for i in range(k) if folders[i].name == folder.name), None)
        if alike is not None:
            raise InputError(str(paths[k]), f"has the name of {alike}, and setups are called by their folders' names",
                             f"rename one of them, such as `mv {paths[k]} {paths[k]}-{k + 1}`")
    return [folder.name for folder in folders]


def convert(
    sources: str | Path, out: str | Path, *, to: str = "campaign", description: str | Path | None = None,
    sensors: str | Path | None = None, progress: Progress = silent,
) -> Conversion | Translation | ImportedModes:
    """Records of other programs (tables, arrays, UFF, files of loggers) into a campaign's layout, as its convert.toml
    says.

    to 'modes': modes and poles of other programs into a modes.json, followed over their blocks as `description`, a
    poles.toml, says (`campaign.pole_tables`); a universal file's modes (dataset 55) without one by their numbers.
    'uff': a modes.json into a universal file, or a campaign's blocks into a folder of them (dataset 58). `sensors`:
    the campaign, or campaign.toml, that says where the channels of a modes.json are. 'description': campaign.toml
    (`out`) and convert.toml beside it, to fill in, from what the files say."""
    if to == "description":
        from probupdate.campaign.describing import describe_records

        return describe_records(sources, out)
    if to == "campaign":
        return convert_files(sources, out, description=description, progress=progress)
    if to not in ("modes", "uff"):
        raise InputError("to", f"'{to}' is unknown", "choose from campaign, description, modes, uff")
    from probupdate.campaign import universal

    if to == "modes":
        if description is None and Path(sources).suffix.lower() in (".uff", ".unv"):
            return universal.modes_from_universal(sources, out, sensors=sensors)
        return _follow_sources(sources, out, description, sensors)
    if Path(sources).is_dir():
        return universal.records_to_universal(sources, out, progress=progress)
    if sensors is None:
        raise InputError(str(sources), "does not say where its channels are", "name the campaign (--sensors)")
    return universal.modes_to_universal(sources, out, sensors=sensors)


def _follow_sources(
    sources: str | Path, out: str | Path, description: str | Path | None, sensors: str | Path | None
) -> ImportedModes:
    from probupdate.campaign.pole_tables import read_pole_tables
    from probupdate.identification.imported_modes import modes_of_poles

    if Path(sources).is_dir() and Path(out).resolve().is_relative_to(Path(sources).resolve()):
        raise InputError(str(out), "lies among the tables that are read", "name a file elsewhere")
    head = None if sensors is None else read_head(campaign_toml(sensors))
    return modes_of_poles(read_pole_tables(sources, description=description, head=head)).write(out)
