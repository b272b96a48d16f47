"""What an error says to do is done, word for word where it gives a line or an option: the command then runs."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from command_cases import (
    PLACES,
    TRUTH,
    campaign_text,
    matrices,
    modes_table,
    true_modes,
    write_building,
    write_campaign,
)

from probupdate.cli import main

RATE, N = 10.0, 1200
LINE = re.compile(r'([a-z_]+) = ("(?:\\.|[^"\\])*"|\[[^\]]*\]|[-\d.]+)')
OPTION = re.compile(r"(--[a-z-]+)(?: ([a-z]+|[\d.]+)\b)?")


def stated(path: Path, text: str) -> None:
    """The first `key = value` of a remedy put into a TOML file, in place of the key's line if it has one."""
    key, value = LINE.search(text).groups()
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith(f"{key} =")]
    path.write_text("\n".join([f"{key} = {value}", *lines]) + "\n", encoding="utf-8")


def into(name: str, *, behind: str = "") -> Callable:
    """Follow a remedy by its line in file `name` of the campaign; behind: the words before the line that is meant."""
    def follow(folder: Path, words: list[str], text: str) -> list[str]:
        stated(folder / "camp" / name, text.partition(behind)[2] if behind else text)
        return words
    return follow


def option(wanted: str, *given: str) -> Callable:
    """Follow a remedy by an option that it names, with the value it gives, else `given`."""
    def follow(folder: Path, words: list[str], text: str) -> list[str]:
        value = {name: said for name, said in OPTION.findall(text)}[wanted]
        words = words[: words.index(wanted)] + words[words.index(wanted) + 2:] if wanted in words else words
        return [*words, wanted, *(given or ((value,) if value else ()))]
    return follow


def by_options(*names: str) -> Callable:
    """Follow a remedy that asks for several options at once."""
    def follow(folder: Path, words: list[str], text: str) -> list[str]:
        assert [n for n in names if n not in text] == []
        return [*words, *(w for n, value in zip(names, ("10", "20", "20"), strict=True) for w in (n, value))]
    return follow


def without(name: str) -> Callable:
    """Follow a remedy that leaves an option out."""
    return lambda folder, words, text: words[: words.index(name)] + words[words.index(name) + 2:]


def by(change: Callable[[Path, str], None]) -> Callable:
    """Follow a remedy by hand: change(folder, text)."""
    def follow(folder: Path, words: list[str], text: str) -> list[str]:
        change(folder, text)
        return words
    return follow


# Records to convert -------------------------------------------------------------------------------------------------


def samples(n: int = N) -> np.ndarray:
    return 0.01 * np.random.default_rng(1).standard_normal((n, len(PLACES)))


def frame(n: int = N, start: str = "2026-06-01T00:00:00", **more) -> pd.DataFrame:
    time = pd.date_range(start, periods=n, freq="100ms").strftime("%Y-%m-%dT%H:%M:%S.%f")
    return pd.DataFrame({"time": time, **dict(zip(PLACES, samples(n).T, strict=True)), **more})


def record(write: Callable[[Path], None], convert: str, *, campaign: tuple[str, str] | None = None) -> Callable:
    """Arrange raw files and their description; the command that converts them."""
    def arrange(folder: Path) -> list[str]:
        (folder / "raw").mkdir()
        (folder / "camp").mkdir()
        text = campaign_text(**({"rate": campaign} if campaign else {}))
        (folder / "camp" / "campaign.toml").write_text(text)
        columns = "" if "[columns]" in convert else "[columns]\n" + "".join(f'"{c}" = "{c}"\n' for c in PLACES)
        (folder / "camp" / "convert.toml").write_text(f"{convert}\n{columns}")
        write(folder / "raw")
        return ["convert", str(folder / "raw"), str(folder / "camp")]
    return arrange


def table(text: Callable[[pd.DataFrame], str], encoding: str = "utf-8", **more) -> Callable:
    return lambda raw: (raw / "a.csv").write_text(text(frame(**more)), encoding=encoding) and None


def csv(made: pd.DataFrame) -> str:
    return made.to_csv(index=False)


TIMED = 'files = "*.csv"\ntime = "time"\ntime_unit = "iso"\n'
UTC = TIMED + 'zone = "UTC"\n'
NUMBERED = 'files = "*.n*"\nstart = "2026-06-01T00:00:00Z"\n[columns]\n' + "".join(
    f'"{c}" = {k + 1}\n' for k, c in enumerate(PLACES))


def seconds(made: pd.DataFrame) -> str:
    return csv(made.assign(time=np.arange(len(made)) / RATE))


def one_word(made: pd.DataFrame) -> str:
    lines = csv(made).splitlines()
    lines[50] = lines[50].rpartition(",")[0] + ",OVER"
    return "\n".join(lines) + "\n"


def two_that_differ(raw: Path) -> None:
    (raw / "a.csv").write_text(csv(frame()))
    (raw / "b.csv").write_text(csv(frame(start="2026-06-01T00:01:00").assign(**{"T90-x": 0.5 * samples()[:, 0]})))


def renamed(folder: Path, text: str) -> None:
    wrong = re.search(r"there is no column '([^']*)'", text)[1]
    near = re.search(r"did you mean '([^']*)'", text)[1]
    path = folder / "camp" / "convert.toml"
    path.write_text(path.read_text().replace(f'= "{wrong}"', f'= "{near}"'))


def untimed(folder: Path, text: str) -> None:
    path = folder / "camp" / "convert.toml"
    path.write_text("".join(x for x in path.read_text().splitlines(keepends=True) if not x.startswith("time")))
    stated(path, text)


RECORDS = {
    "zone": (record(table(csv), TIMED), "its time zone is not stated", into("convert.toml")),
    "start": (record(table(seconds), UTC.replace("iso", "s")), "counts from the beginning", into("convert.toml")),
    "rate of the file": (record(table(csv), UTC, campaign=("= 10.0", "= 10.5")), "campaign.toml says 10.5 Hz",
                         into("campaign.toml")),
    "separator": (record(table(lambda t: t.to_csv(index=False, sep=";")), UTC), "is one column", into("convert.toml")),
    "encoding": (record(table(lambda t: csv(t).replace("time", "time°"), "cp1252"),
                        UTC.replace('"time"', '"time°"')), "is not text in utf-8", into("convert.toml")),
    "decimal": (record(table(lambda t: t.to_csv(index=False, sep=";", decimal=",")), UTC + 'separator = ";"\n'),
                "is not a number", by(lambda f, _: stated(f / "camp/convert.toml", 'decimal = ","'))),
    "lost": (record(table(one_word), UTC), "'OVER' is not a number", into("convert.toml", behind="declare it lost: ")),
    "time_format": (record(table(lambda t: csv(t.assign(time=pd.to_datetime(t.time).dt.strftime("%d.%m.%Y %H:%M:%S.%f")
                                                        ))), UTC), "is not a time",
                    by(lambda f, text: stated(f / "camp/convert.toml", "time_format = " + re.search(
                        r'time_format, such as ("[^"]*")', text)[1]))),
    "time of day": (record(table(lambda t: csv(t.assign(time=pd.to_datetime(t.time).dt.strftime("%H:%M:%S.%f")))),
                           UTC + 'time_format = "%H:%M:%S.%f"\n'), "without its date", by(untimed)),
    "column": (record(table(lambda t: csv(t.rename(columns={"T90-x": "T90_x"}))), UTC), "there is no column 'T90-x'",
               by(renamed)),
    "orientation": (record(lambda raw: np.save(raw / "a.npy", samples().T), NUMBERED), "samples of 1200 channels",
                    by(lambda f, text: stated(f / "camp/convert.toml", text))),
    "orientation of npz": (record(lambda raw: np.savez(raw / "a.npz", y=samples().T, fs=RATE), NUMBERED),
                           "samples of 1200 channels", by(lambda f, text: stated(f / "camp/convert.toml", text))),
    "rate that a file states": (record(lambda raw: np.savez(raw / "a.npz", y=samples(), fs=25.0), NUMBERED),
                                "states 25 Hz", into("convert.toml")),
    "unit that a file states": (record(lambda raw: np.savez(raw / "a.npz", y=samples(), unit=np.array("mm")), NUMBERED),
                                "mm", into("convert.toml", behind="where the file is wrong")),
    "overlap": (record(two_that_differ, UTC), "differs from it there", into("convert.toml")),
}


# Models and modes ---------------------------------------------------------------------------------------------------


def building(verb: str, *more: str, spoil: Callable[[Path], None] = lambda folder: None, out: str = "out.json",
             modes: dict | None = None) -> Callable:
    def arrange(folder: Path) -> list[str]:
        paths = write_building(folder)
        if modes is not None:
            Path(paths["modes"]).write_text(json.dumps(modes))
        spoil(folder)
        return [verb, "--model", paths["model"], "--parameters", paths["parameters"], "--modes", paths["modes"], *more,
                "--out", str(folder / out)]
    return arrange


def sets_without(*keys: str, n_set: int = 3) -> dict:
    made = modes_table(n_set)
    return made | {"sets": [{k: v for k, v in s.items() if k not in keys} for s in made["sets"]]}


def bare() -> dict:
    made = modes_table()
    return made | {"sets": [s | {k: [[None] * 5] * 4 for k in ("shape_re", "shape_std")} for s in made["sets"]]}


def extra_matrix(folder: Path) -> None:
    np.savez(folder / "model.npz", **matrices(), K_top=matrices()["K_high"])


def listed(folder: Path, text: str) -> None:
    name = re.search(r"no parameter is named '(\w+)'", text)[1]
    with (folder / "parameters.toml").open("a") as file:
        file.write(f'[[parameter]]\nname = "{name}"\nunit = "-"\ninitial = 0.0\nstd = 0.1\nupdate = false\n')


def key(old: str, new: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / "parameters.toml"
        path.write_text(path.read_text().replace(old, new, 1))
    return spoil


def meant(file: str, wrongly: str = r"key '([^']*)'") -> Callable:
    """Follow 'unknown key ...; did you mean ...?', or of what else the error quotes `wrongly`."""
    def change(folder: Path, text: str) -> None:
        wrong, near = re.search(wrongly, text)[1], re.search(r"did you mean '([^']*)'", text)[1]
        path = folder / file
        path.write_text(path.read_text().replace(wrong, near))
    return by(change)


UPDATE = ("--shapes", "mac", "--iterations", "3", "--set", "2026-06-01T00:00Z")
MODELS = {
    "no shapes": (building("update", *UPDATE[2:], "--weights", "measured", modes=bare()),
                  "has no component of its shape", option("--shapes")),
    "no standard deviations": (building("update", *UPDATE, "--weights", "measured",
                                        modes=sets_without("frequency_std_hz")), "is missing or not above zero",
                               option("--weights")),
    "no factors": (building("update", *UPDATE[2:], "--weights", "covariance"), "no covariance factors",
                   option("--weights")),
    "few sets": (building("diagnose", "--no-extend", modes=sets_without("frequency_std_hz", "shape_std")),
                 "3 usable sets of 3", option("--shapes", "none", "--frequency-std", "0.004")),
    "a matrix without its parameter": (building("update", *UPDATE, spoil=extra_matrix), "no parameter is named 'top'",
                                       by(listed)),
    "slip in a key": (building("update", *UPDATE, spoil=key("initial", "inital")), "unknown key", meant(
        "parameters.toml")),
    "prior": (building("update", *UPDATE, spoil=key("std =", 'prior = "lognormal"\nstd =')), "needs a positive initial",
              by(lambda f, text: key('prior = "lognormal"', LINE.search(text)[0])(f))),
    "nothing to update": (building("update", *UPDATE, spoil=lambda f: (f / "parameters.toml").write_text(
        (f / "parameters.toml").read_text().replace("std =", "update = false\nstd ="))), "there are none to update",
        by(lambda f, text: key("update = false", LINE.search(text)[0])(f) if LINE.search(text) else key(
            "update = false", "update = true")(f))),
    "set": (building("update", *UPDATE[:4], "--set", "2026-06-01T00:01Z"), "2026-06-01T00:01Z",
            lambda f, words, text: [re.search(r"2026-06-01T00:00Z", text)[0] if w == "2026-06-01T00:01Z" else w
                                    for w in words]),
    "groups without a model": (
        lambda f: [w for w in building("diagnose", "--no-extend", modes=modes_table(9))(f) if w not in (
            "--model", str(f / "model.npz"), "--parameters", str(f / "parameters.toml"))]
        + ["--discrepancy", "0.01"], "is given without a model", without("--discrepancy")),
    "fixed": (building("update", *UPDATE, "--fix", "lowe=0.1"), "lowe", lambda f, words, text: [
        w.replace("lowe", re.search(r"did you mean '([^']*)'", text)[1]) for w in words]),
}


def of_modes(*more: str, spoil: Callable[[Path], None] = lambda folder: None) -> Callable:
    def arrange(folder: Path) -> list[str]:
        paths = write_building(folder)
        spoil(folder)
        return ["modes", paths["model"], *more]
    return arrange


def removed(name: str) -> Callable[[Path], None]:
    return lambda folder: shutil.move(folder / name, folder / f"kept-{name}")


LOOKS = {
    "count": (of_modes("--count", "900"), "modes are asked for", option("--count", "20")),
    "parameters": (of_modes(spoil=removed("parameters.toml")), "its parameters are not known",
                   by(lambda f, _: shutil.move(f / "kept-parameters.toml", f / "parameters.toml"))),
    "a folder for a model": (lambda f: [(building("update")(f), "modes")[1], str(f)], "is a directory",
                             lambda f, words, text: ["modes", re.search(r"did you mean '([^']*)'", text)[1]]),
    "ending": (lambda f: [(building("update")(f), "modes")[1], str(f / "model.npy")], "model.npy",
               lambda f, words, text: ["modes", str(f / Path(re.search(r"did you mean '([^']*)'", text)[1]).name)]),
    "count of a turbine": (lambda f: ["modes", "designe", "--count", "2"], "designe",
                           lambda f, words, text: ["modes", re.search(r"design\b", text)[0], "--count", "2"]),
}


# Campaigns ----------------------------------------------------------------------------------------------------------


def campaign(verb: str, *more: str, spoil: Callable[[Path], None] = lambda folder: None) -> Callable:
    def arrange(folder: Path) -> list[str]:
        camp = write_campaign(folder / "camp")
        spoil(camp)
        return [verb, str(camp), *(w.replace("OUT", str(folder)) for w in more)]
    return arrange


def changed(name: str, old: str, new: str) -> Callable[[Path], None]:
    def spoil(camp: Path) -> None:
        text = (camp / name).read_text()
        assert old in text
        (camp / name).write_text(text.replace(old, new))
    return spoil


CAMPAIGNS = {
    "slip in campaign.toml": (campaign("check", spoil=changed("campaign.toml", "block_minutes", "block_minute")), "key",
                              meant("camp/campaign.toml")),
    "slip in a column": (campaign("check", spoil=changed("scada.csv", "wind_speed_mps", "wind_sped_mps")), "wind_sped",
                         by(lambda f, text: changed("scada.csv", "wind_sped_mps", re.search(
                             r"did you mean '([^']*)'", text)[1])(f / "camp"))),
    "time of scada": (campaign("check", spoil=changed("scada.csv", "time,", "Time,")), "has no column 'time'",
                      by(lambda f, text: changed("scada.csv", "Time,", "time,")(f / "camp"))),
    "factor of a column": (campaign("check", spoil=lambda c: (c / "campaign.toml").write_text(
        (c / "campaign.toml").read_text() + "\n[scada.factor]\npitch_deg = 57.3\n")), "states its factor",
        by(lambda f, text: changed("campaign.toml", "pitch_deg = 57.3", "power_kw = 1.0")(f / "camp"))),
    "no rate": (campaign("identify", "--out", "OUT/modes.json"), "no peak stands out",
                by_options("--rate", "--order", "--block-rows")),
    "lowest without a model": (campaign("identify", "--lowest", "3", "--rate", "10", "--order", "20", "--out",
                                        "OUT/modes.json"), "and no model is given", without("--lowest")),
    "leave_out": (campaign("check", spoil=lambda c: (c / "campaign.toml").write_text(
        'leave_out = ["T90x"]\n' + (c / "campaign.toml").read_text())), "is not a channel",
        by(lambda f, text: changed("campaign.toml", "T90x", re.search(r"did you mean '([^']*)'", text)[1])(f / "camp")
           )),
}


def swapped(camp: Path) -> None:
    """Records that name their columns, and two tables of campaign.toml in one another's place."""
    for path in (camp / "acceleration").glob("*.h5"):
        with h5py.File(path, "r+") as file:
            file["data"].attrs["channels"] = json.dumps(list(PLACES))
    head, *tables = (camp / "campaign.toml").read_text().split("[[sensor]]")
    (camp / "campaign.toml").write_text("[[sensor]]".join([head, tables[1], tables[0], *tables[2:]]))


def ordered(folder: Path, text: str) -> None:
    path = folder / "camp" / "campaign.toml"
    head, *tables = path.read_text().split("[[sensor]]")
    wanted = re.search(r"order them (.*), or convert", text)[1].split(", ")
    path.write_text("[[sensor]]".join([head, *(next(t for t in tables if f'"{c}"' in t) for c in wanted)]))


def new_name(camp: Path) -> None:
    swapped(camp)
    swapped(camp)
    changed("campaign.toml", "T90-x", "T91-x")(camp)


def copied(folder: Path) -> list[str]:
    camp = write_campaign(folder / "camp")
    shutil.copytree(camp, folder / "later" / "camp")
    return ["check", str(camp), str(folder / "later" / "camp")]


def moved(folder: Path, words: list[str], text: str) -> list[str]:
    old, new = re.search(r"`mv (\S+) (\S+)`", text).groups()
    shutil.move(old, new)
    return [w.replace(old, new) for w in words]


CAMPAIGNS |= {
    "a folder twice": (campaign("check", "OUT/camp"), "is given twice", lambda f, words, text: words[:-1]),
    "folders of one name": (copied, "has the name of", moved),
    "order of sensors": (campaign("check", spoil=swapped), "were put in another order", by(ordered)),
    "a sensor's name": (campaign("check", spoil=new_name), "was renamed or replaced", by(lambda f, text: changed(
        "campaign.toml", "T91-x", re.search(r"name it '([^']*)' again", text)[1])(f / "camp"))),
}
MODELS |= {
    "too few without a model": (
        lambda f: [w for w in building("diagnose", "--no-extend")(f) if w not in (
            "--model", str(f / "model.npz"), "--parameters", str(f / "parameters.toml"))], "too few to tell",
        lambda f, words, text: [*words, re.search(r"--model", text)[0], str(f / "model.npz")]),
    "held beyond its bounds": (building("update", *UPDATE, "--fix", "low=9"), "low", lambda f, words, text: [
        w.replace("low=9", "low=0.1") for w in words]),
}


def with_units(made: pd.DataFrame) -> str:
    head, rest = csv(made).split("\n", 1)
    return f"{head}\n-{',m/s2' * len(PLACES)}\n{rest}"


def without_groups(folder: Path) -> list[str]:
    np.savez(folder / "given.npz", K=matrices()["K0"], M=matrices()["M0"])
    return ["matrices", str(folder / "given.npz"), "--parameters", str(folder / "none.toml"), "--out",
            str(folder / "made" / "model.npz")]


RECORDS |= {
    "line of the names": (record(table(lambda t: "Logger 3\n\n" + csv(t)), UTC), "columns' names in line 3",
                          into("convert.toml")),
    "line of the units": (record(table(with_units), UTC), "is a unit", into("convert.toml")),
}
MODELS |= {"groups that are not there": (without_groups, "no such file", without("--parameters"))}
def described_anew(folder: Path) -> list[str]:
    words = record(table(csv), UTC)(folder)
    assert main(words) == 0
    with (folder / "camp" / "convert.toml").open("r+") as file:
        text = file.read()
        file.seek(0)
        file.write("fill_seconds = 5\n" + text)
    return words


def described_later(folder: Path) -> list[str]:
    words = record(table(csv), UTC)(folder)
    (folder / "camp" / "convert.toml").unlink()
    return words


def copied_description(folder: Path, text: str) -> None:
    """That of the command named, which takes the template's place beside a campaign.toml that is there already."""
    found = re.search(r"`probupdate (convert --describe) RAW --out NEW/campaign.toml`", text)
    assert main([*found[1].split(), str(folder / "raw"), "--out", str(folder / "new" / "campaign.toml")]) == 0
    filled = (folder / "new" / "convert.toml").read_text().replace('"?"', '"UTC"')
    (folder / "camp" / "convert.toml").write_text(filled)


def forgotten(folder: Path, text: str) -> None:
    """What came of a source and its entry, as the error names them, deleted."""
    found = re.search(r"delete what came of it \((.*?) \.\.\.\) and its entry in (\S+),", text)
    for name in found[1].split(", "):
        (folder / "camp" / "acceleration" / name).unlink()
    entries = json.loads(Path(found[2]).read_text())
    left = {k: v for k, v in entries.items() if k != "files"} | {"files": {}} if "files" in entries else {}
    Path(found[2]).write_text(json.dumps(left))


def poles(unit: str, damping: float) -> Callable:
    """Poles of three modes in eight blocks; the command that makes a modes.json of them."""
    def arrange(folder: Path) -> list[str]:
        rng, (frequency, shape) = np.random.default_rng(2), TRUE_MODES
        rows = [(f"b{k}", f * (1 + 0.002 * rng.standard_normal()), damping * (1 + 0.1 * rng.standard_normal()), *s)
                for k in range(8) for f, s in zip(frequency[:3], shape.T[:3], strict=True)]
        names = [f"c{k}" for k in range(len(shape))]
        pd.DataFrame(rows, columns=["block", "f", "xi", *names]).to_csv(folder / "p.csv", index=False)
        (folder / "camp").mkdir()
        (folder / "camp" / "poles.toml").write_text(
            f'frequency = "f"\nfrequency_unit = "Hz"\ndamping = "xi"\n{unit}block = "block"\nblock_minutes = 10.0\n'
            + "[channels]\n" + "".join(f'{c} = "{c}"\n' for c in names))
        return ["convert", str(folder / "p.csv"), str(folder / "modes.json"), "--to", "modes", "--description",
                str(folder / "camp" / "poles.toml")]
    return arrange


def one_channel(camp: Path) -> None:
    (camp / "campaign.toml").write_text("[sensor]".join((camp / "campaign.toml").read_text().split("[[sensor]]")[:2]))
    for path in (camp / "acceleration").glob("*.h5"):
        with h5py.File(path, "r+") as file:
            kept, told = file["data"][:, :1], dict(file["data"].attrs)
            del file["data"]
            file.create_dataset("data", data=kept).attrs.update(told)


TRUE_MODES = true_modes(TRUTH)
ROWS_A_CHANNEL = 'files = "*.csv"\nstart = "2026-06-01T00:00:00Z"\n[columns]\n' + "".join(
    f'"{c}" = {k + 1}\n' for k, c in enumerate(PLACES))
RECORDS |= {
    "times in another unit": (record(table(lambda t: csv(t.assign(time=100.0 * np.arange(len(t))))), UTC.replace(
        "iso", "s") + 'start = "2026-06-01T00:00:00Z"\n'), "rows come every 100 s", into("convert.toml")),
    "a channel's name": (record(table(csv), UTC + "[columns]\n" + "".join(
        f'"{c.replace("T90-", "T90")}" = "{c}"\n' for c in PLACES)), "is not a channel of campaign.toml",
        meant("camp/convert.toml", r"'([^']*)' is not a channel")),
    "no description": (described_later, "convert.toml: no such file", by(copied_description)),
    "a description that changed": (described_anew, "is no longer what was converted", by(forgotten)),
    "poles in per cent": (poles('damping_unit = "ratio"\n', 1.0), "median damping ratio", into("poles.toml")),
    "poles as shares": (poles('damping_unit = "%"\n', 0.01), "median damping ratio", into("poles.toml")),
}
MODELS |= {
    "a set's channels without shapes": (building("update", *UPDATE[2:], "--shapes", "none", modes=sets_without(
        "shape_re", "shape_std")), "'shape_re' is missing", by(lambda f, _: (f / "modes.json").write_text(json.dumps(
            sets_without("shape_re", "shape_std") | {"channels": []})))),
    "damping in per cent": (building("update", *UPDATE, modes=modes_table() | {"sets": [
        s | {"damping_ratio": [1.0] * 4} for s in modes_table()["sets"]]}), "is not a plausible damping ratio",
        by(lambda f, _: (f / "modes.json").write_text(json.dumps(modes_table())))),
}
CAMPAIGNS |= {
    "blocks of no length": (
        campaign("check", spoil=changed("campaign.toml", "block_minutes = 10", "block_minutes = 0.001")),
        "are fewer than", by(lambda f, text: changed(
            "campaign.toml", "= 0.001", "= " + re.search(r"give at least ([\d.]+) minutes", text)[1])(f / "camp"))),
    "a unit of another quantity": (
        campaign("check", spoil=changed("campaign.toml", 'unit = "m/s2"', 'unit = "m/s"')), "is none of acceleration",
        by(lambda f, text: changed("campaign.toml", '"m/s"', f'"{re.search(r"use ([^,]+),", text)[1]}"')(f / "camp"))),
    "one table of a list": (campaign("check", spoil=one_channel), r"\[\[sensor\]\]",
        by(lambda f, text: changed("campaign.toml", "[sensor]", re.search(r"write (\S+) be", text)[1])(f / "camp"))),
}
CASES = RECORDS | MODELS | LOOKS | CAMPAIGNS


@pytest.mark.parametrize("name", CASES)
def test_what_an_error_says_to_do_mends_it(tmp_path, capsys, name):
    arrange, said, follow = CASES[name]
    words = arrange(tmp_path)
    assert main(words) == 2
    text = capsys.readouterr().err
    assert re.search(said, text), text
    code = main(follow(tmp_path, words, text))
    again = capsys.readouterr().err
    # noise has no modes: the next thing that is wrong is another one
    assert code == 0 or (name in ("no rate", "lowest without a model") and not re.search(said, again)), again
