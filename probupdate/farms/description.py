"""farm.toml: which turbines with which models and months of records, and what is done with each month."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from probupdate.errors import InputError
from probupdate.io.files import read_toml, resolve_path
from probupdate.io.schema import Length, Range, refuse_unknown, table_as
from probupdate.structure.load import REFERENCE_STATES
from probupdate.updating.joint_inference import DEFAULT as JOINT

# in the order of the work
STEPS = ("identify", "select", "update", "sample", "compare", "diagnose", "report")
# a step -> what it takes of others
NEEDS = {"select": ("identify",), "update": ("identify",), "sample": ("identify",), "compare": ("update", "sample"),
         "diagnose": ("identify",), "report": ("identify",)}
# words for months of which three letters or more may stand in a folder's name, English and German
MONTHS = (
    ("january", "januar"), ("february", "februar"), ("march", "maerz"), ("april",), ("may", "mai"), ("june", "juni"),
    ("july", "juli"), ("august",), ("september",), ("october", "oktober"), ("november",), ("december", "dezember"))
# names become folders
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,63}")
CAMPAIGN = "campaign.toml"
REMEDY = "see docs/howto/farm.md"


@dataclass(frozen=True, kw_only=True)
class IdentifyTable:
    """[identify]: as the options of `probupdate identify`."""

    lowest: Annotated[int, Range(1, 1000)] | None = None
    order: Annotated[int, Range(2, 500)] | None = None
    block_rows: Annotated[int, Range(2, 5000)] | None = None
    rate_hz: Annotated[float, Range(0, 1e5, above=True)] | None = None
    harmonics: Literal["keep", "remove"] = "keep"


@dataclass(frozen=True, kw_only=True)
class SelectTable:
    """[select]: as the options of `probupdate select`."""

    preset: Literal["turbine", "structure"] = "turbine"
    std_from: Literal["campaign", "identification"] = "campaign"
    count: Annotated[int, Range(1, 1e6)] = 9
    rated_power_kw: Annotated[float, Range(0, 1e6, above=True)] | None = None


@dataclass(frozen=True, kw_only=True)
class UpdateTable:
    """[update]: of `probupdate update` and `sample` alike, so that both ask the same."""

    weights: Literal["measured", "covariance", "paper"] = "measured"
    frequencies: Literal["hz", "log"] = "hz"
    shapes: Literal["plane", "components", "mac", "none"] = "plane"


@dataclass(frozen=True, kw_only=True)
class SampleTable:
    """[sample]: effective draws of the worst parameter, ensembles."""

    ess: Annotated[int, Range(1, 1e6)] = 1000
    ensembles: Annotated[int, Range(1, 64)] = 4


@dataclass(frozen=True, kw_only=True)
class DiagnoseTable:
    """[diagnose]: records: the raw records are tested too; extend: the gain on held-out blocks and the extended
    model."""

    records: bool = True
    extend: bool = True


@dataclass(frozen=True, kw_only=True)
class JointTable:
    """[joint]: one inference for all turbines after their own. common: parameters that are one number for all; varying:
    those drawn from a population; the others are a turbine's own. spread: scale of the hyper-prior of the scatter;
    odd_share: of turbines that are unlike the others a priori; odd_wide: how far; in prior standard deviations."""

    common: tuple[str, ...] = ()
    varying: tuple[str, ...] = ()
    spread: Annotated[float, Range(0, 100, above=True)] = JOINT.spread
    odd_share: Annotated[float, Range(0, 0.5)] = JOINT.odd_share
    odd_wide: Annotated[float, Range(0, 100, above=True)] = JOINT.odd_wide


TABLES = {"identify": IdentifyTable, "select": SelectTable, "update": UpdateTable, "sample": SampleTable,
          "diagnose": DiagnoseTable}


@dataclass(frozen=True, kw_only=True)
class Options:
    """What each step is asked, by the file's tables of the steps' names."""

    identify: IdentifyTable = field(default_factory=IdentifyTable)
    select: SelectTable = field(default_factory=SelectTable)
    update: UpdateTable = field(default_factory=UpdateTable)
    sample: SampleTable = field(default_factory=SampleTable)
    diagnose: DiagnoseTable = field(default_factory=DiagnoseTable)


@dataclass(frozen=True, kw_only=True)
class TurbineTable:
    """[[turbine]]: campaigns: folders of its months below farm.toml's, by a pattern such as 'T12/2019-*', in the order
    of their names; model: its own, else the farm's."""

    name: Annotated[str, Length(1)]
    campaigns: Annotated[str, Length(1)]
    model: Annotated[str, Length(1)] | None = None


@dataclass(frozen=True, kw_only=True)
class FarmTable:
    name: Annotated[str, Length(1)]
    steps: tuple[Literal["identify", "select", "update", "sample", "compare", "diagnose", "report"], ...] = (
        "identify", "select", "update", "diagnose")
    model: Annotated[str, Length(1)] | None = None
    seed: Annotated[int, Range(0, 2**63 - 1)] = 1


@dataclass(frozen=True, kw_only=True)
class Month:
    """One turbine's month: where its records and its model are, and where its results go, relative to the farm's."""

    turbine: str
    month: str
    campaign: Path
    model: str

    @property
    def folder(self) -> Path:
        return Path(self.turbine) / self.month


@dataclass(frozen=True, kw_only=True)
class Farm:
    """months: turbine by turbine as the file has them, a turbine's in the order of time. left_out: turbine, folder
    that its pattern finds, why that is not a campaign."""

    name: str
    steps: tuple[str, ...]
    seed: int
    options: Options
    months: tuple[Month, ...]
    left_out: tuple[tuple[str, str, str], ...] = ()
    joint: JointTable | None = None


def read_farm(path: str | Path) -> Farm:
    """A farm.toml with the folders that its patterns find. Raises InputError naming turbine and key: unknown keys, a
    step without what it needs, folders outside the file's own, names that are no folder's, no month at all."""
    path = Path(path)
    content = read_toml(path, REMEDY)
    refuse_unknown(content, [*FarmTable.__dataclass_fields__, "turbine", "joint", *TABLES], str(path))
    head = table_as(FarmTable, {k: v for k, v in content.items() if k in FarmTable.__dataclass_fields__}, str(path))
    options = Options(**{name: table_as(kind, content[name], f"{path}, [{name}]") for name, kind in TABLES.items()
                         if name in content})
    given = content.get("turbine")
    if not isinstance(given, list) or not given:
        raise InputError(str(path), "has no [[turbine]]", "add one table per turbine, with name and campaigns")
    turbines = [table_as(TurbineTable, one, f"{path}, turbine {k}") for k, one in enumerate(given, 1)]
    _refuse_twice([t.name.casefold() for t in turbines], str(path), "turbine")
    months = tuple(month for turbine in turbines for month in _months(path, turbine, head.model))
    steps = _steps(head.steps, content, path)
    return Farm(name=head.name, steps=steps, seed=head.seed, options=options, months=months,
                joint=_joint(content, steps, len(turbines), path),
                left_out=tuple(left for turbine in turbines for left in _excluded_folders(path, turbine)))


def _steps(given: tuple[str, ...], content: Mapping, path: Path) -> tuple[str, ...]:
    _refuse_twice(given, f"{path}, steps", "step")
    for step in given:
        for needed in NEEDS.get(step, ()):
            if needed not in given:
                raise InputError(f"{path}, steps", f"'{step}' needs '{needed}'", "add it")
    if "identify" not in given:
        raise InputError(f"{path}, steps", "'identify' is missing, which the others begin with", "add it")
    for name in TABLES:
        if name in content and name not in given and not (name == "update" and "sample" in given):
            raise InputError(f"{path}, [{name}]", "is a table of a step that is not among steps", "add it there")
    return tuple(step for step in STEPS if step in given)


def _joint(content: Mapping, steps: tuple[str, ...], n_turbine: int, path: Path) -> JointTable | None:
    if "joint" not in content:
        return None
    found, where = table_as(JointTable, content["joint"], f"{path}, [joint]"), f"{path}, [joint]"
    if not (found.common or found.varying):
        raise InputError(where, "names no parameter that turbines have in common",
                         "list parameters of the model as common or varying")
    twice = [name for name in found.common if name in found.varying]
    if twice:
        raise InputError(where, f"{', '.join(twice)} stands under common and under varying", "list it once")
    for needed in ("select", "update"):
        if needed not in steps:
            raise InputError(f"{path}, steps", f"[joint] needs '{needed}'", "add it")
    if n_turbine < 2:
        raise InputError(where, "needs several turbines, and the farm has one",
                         "add [[turbine]] tables, or leave it out")
    return found


def _months(path: Path, turbine: TurbineTable, model: str | None) -> Iterator[Month]:
    where = f"{path}, turbine {turbine.name}"
    _refuse_name(turbine.name, where)
    chosen = turbine.model or model
    if chosen is None:
        raise InputError(where, "has no model, and the farm has none", "add model = ...")
    root = path.parent.resolve()
    if chosen not in REFERENCE_STATES:
        chosen = str(resolve_path(chosen, root, f"{where}, model", remedy="put it below farm.toml's folder"))
    folders = list(_folders(root, turbine.campaigns, where))
    found = sorted((f for f in folders if (f / CAMPAIGN).is_file()), key=lambda folder: natural_order(folder.name))
    if not found:
        others = "; ".join(f"{f.name}: {_folder_error(f)}" for f in folders[:3])
        raise InputError(f"{where}, campaigns", f"'{turbine.campaigns}' finds no folder with a campaign.toml"
                         f"{f' ({others})' if others else ''}",
                         "write the pattern relative to farm.toml, such as 'T12/2019-*'")
    _refuse_twice([folder.name.casefold() for folder in found], where, "month")
    for folder in found:
        _refuse_name(folder.name, where)
        yield Month(turbine=turbine.name, month=folder.name, campaign=folder, model=chosen)


def natural_order(name: str) -> list[str | int]:
    """By which names are sorted as they are read: 2019-9 before 2019-10, and Oct 2019 as 2019-10."""
    words, year = re.findall(r"[A-Za-z]{3,}", name), re.search(r"(?<!\d)\d{4}(?!\d)", name)
    month = next((k for word in words for k, names in enumerate(MONTHS, 1) if any(
        one.startswith(word.lower()) for one in names)), None)
    if month and year:
        name = f"{year[0]}-{month} {name}"
    return [int(part) if k % 2 else part for k, part in enumerate(re.split(r"(\d+)", name))]


def _excluded_folders(path: Path, turbine: TurbineTable) -> Iterator[tuple[str, str, str]]:
    root = path.parent.resolve()
    folders = _folders(root, turbine.campaigns, turbine.name)
    for folder in sorted(folders, key=lambda folder: natural_order(folder.name)):
        if not (folder / CAMPAIGN).is_file():
            yield turbine.name, folder.name, _folder_error(folder)


def _folder_error(folder: Path) -> str:
    close = difflib.get_close_matches(CAMPAIGN, [p.name for p in folder.iterdir() if p.name != CAMPAIGN], n=1,
                                      cutoff=0.7)
    if (folder / CAMPAIGN).exists():
        return "its campaign.toml is no file"
    there = [p.name for p in folder.iterdir() if p.name.casefold() == CAMPAIGN] or close
    return f"has no campaign.toml; rename {there[0]} if that is it" if there else "has no campaign.toml"


def _folders(root: Path, pattern: str, where: str) -> Iterator[Path]:
    if pattern.startswith(("/", "\\")) or ".." in re.split(r"[/\\]", pattern) or "**" in pattern or "\0" in pattern:
        raise InputError(f"{where}, campaigns", f"'{pattern:.200}' is not a pattern of folders below farm.toml's",
                         "write it relative to farm.toml, without '..' and '**'")
    try:
        found = list(root.glob(pattern))
    except (ValueError, NotImplementedError, OSError) as error:
        raise InputError(f"{where}, campaigns", f"'{pattern:.200}' is not a pattern ({error})", REMEDY) from None
    for folder in found:
        if folder.is_dir():
            if not folder.resolve().is_relative_to(root):
                raise InputError(where, f"{folder.name} leads out of farm.toml's folder by a link", "copy it there")
            yield folder


def _refuse_name(name: str, where: str) -> None:
    if not NAME.fullmatch(name) or name.endswith((".", " ")):
        raise InputError(where, f"'{name:.80}' becomes a folder's name and cannot",
                         "use letters, digits, space and . _ + -, a letter or digit first, at most 64")


def _refuse_twice(names: list[str] | tuple[str, ...], where: str, what: str) -> None:
    twice = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if twice is not None:
        raise InputError(where, f"{what} '{twice}' stands twice", f"give each {what} a name of its own")
