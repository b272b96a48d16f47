"""Sections on the measurement: what was measured, identification, selection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from probupdate.identification.classification import POLE_WORDS
from probupdate.identification.counterparts import unmatched_sentences
from probupdate.identification.summary import harmonics_removed
from probupdate.modal.matching import close_clusters
from probupdate.modal.modes import ModalData, plane_mac
from probupdate.reporting import figures, paper_tables
from probupdate.reporting.elements import (
    MISSING,
    Column,
    Element,
    Items,
    Notice,
    Picture,
    Section,
    Table,
    decimal,
    full_sentence,
    percent,
)
from probupdate.reporting.identification_pictures import (
    block_of,
    mode_drawings,
    pole_drawings,
    rotor_lines,
    stabilisation_drawing,
)
from probupdate.reporting.style import HALF_IN
from probupdate.reporting.values import CampaignValues, Run, mode_labels

# the cut-in and rated wind speed and the rated rotor speed of the paper's turbine, drawn for orientation
CUT_IN_MPS, RATED_MPS = 4.0, 12.0
# the selection asks in this order, and a block counts at the first it fails
STATES_ORDER = ("idling", "below rated", "rated", "mixed")
CRITERIA_ORDER = (
    "no data", "no SCADA", "yawing", "pitching", "not idling", "modes not identified", "planes not perpendicular",
)


def measured_section(run: Run) -> Section:
    items: list[Element] = []
    campaign = run.campaign
    wire = run.model.wire if run.model else None
    if campaign is None:
        items.append(Notice(level="missing", text="a campaign directory, so sensors' records and SCADA are not shown."))
        if run.modes is not None:
            items.append(_modal_facts(run.modes))
        return Section(anchor="measured", title="What was measured", items=tuple(items),
                       lead="Identified modes were given; the records behind them were not.")
    items.append(
        Table(
            caption="The campaign", columns=(Column(name="what", number=False), Column(name="value", number=False)),
            rows=campaign.facts,
        )
    )
    items.append(
        Picture(
            svg=figures.svg_text(figures.sensor_layout(wire, campaign.sensors), "sensors"),
            caption=f"The {len(campaign.sensors)} channels on the structure: a dot for each sensor, an arrow for each "
            "measured direction, in the model's axes.",
        )
    )
    items.append(_sensor_table(campaign))
    items += _scada(campaign, run.jacket)
    if campaign.findings:
        items.append(Items(title="Found on reading the records", statements=campaign.findings))
    return Section(anchor="measured", title="What was measured", items=tuple(items),
                   lead="Sensors, records and SCADA, before anything was computed from them.")


def _modal_facts(modes: ModalData) -> Table:
    counts = [int(np.isfinite(s.frequency_hz).sum()) for s in modes.sets]
    rows = (("channels", str(len(modes.channels))), ("modal sets", str(len(modes.sets))),
            ("modes per set", f"{min(counts)} to {max(counts)}" if min(counts) < max(counts) else str(counts[0])))
    return Table(caption="Modal data", rows=rows,
                 columns=(Column(name="what", number=False), Column(name="value", number=False)))


def _sensor_table(campaign: CampaignValues) -> Table:
    rows = []
    for level in dict.fromkeys(s.level for s in campaign.sensors):
        here = [s for s in campaign.sensors if s.level == level]
        points = {tuple(s.position_m) for s in here}
        heights = sorted({decimal(float(s.position_m[2]), 1) for s in here}, key=lambda t: float(t.replace("−", "-")))
        quantity = sorted({f"{s.quantity} [{s.unit.replace('s2', 's²')}]" for s in here})
        names = ", ".join(s.channel for s in here)
        rows.append((level, " and ".join(heights), str(len(points)), str(len(here)), ", ".join(quantity), names))
    columns = (Column(name="level", number=False), Column(name="z", unit="m"), Column(name="positions"),
               Column(name="channels"), Column(name="quantity", number=False), Column(name="names", number=False))
    return Table(caption="Sensors by level", columns=columns, rows=tuple(rows))


def _scada(campaign: CampaignValues, jacket: bool) -> list[Element]:
    scada = campaign.scada
    if scada is None or "wind_speed_mps" not in scada:
        return [Notice(level="missing", text="SCADA with a wind speed, so conditions over time are not shown.")]
    state = scada["state"].astype(str) if "state" in scada else pd.Series("unknown", index=scada.index)
    figure = figures.wind_and_state(scada["time"].to_numpy(), scada["wind_speed_mps"].to_numpy(float), list(state),
                                    cut_in_mps=CUT_IN_MPS if jacket else None,
                                    rated_mps=RATED_MPS if jacket else None)
    share = state.value_counts(normalize=True)
    words = ", ".join(f"{name} {percent(float(share[name]), 0)} %" for name in share.index)
    rule = f" {campaign.state_rule}" if campaign.state_rule else ""
    if (state == "unknown").all():
        return [Picture(svg=figures.svg_text(figure, "wind"), caption="Wind speed.")]
    return [Picture(svg=figures.svg_text(figure, "wind"),
                    caption=f"Wind speed and turbine state{', as Fig. 4 of the paper' if jacket else ''} ({words} of "
                    f"the time).{rule}")]


def identification_section(run: Run) -> Section:
    items: list[Element] = []
    if run.poles is None:
        items.append(Notice(level="missing", text="the table of poles (modes.poles.csv), so no poles are shown."))
    else:
        items += _pole_pictures(run, run.poles)
    if run.modes is None:
        items.append(Notice(level="missing", text="modes.json, so there are no frequencies to show."))
    else:
        if run.modes.choice is not None:
            items.append(Items(title="Modes picked by hand", statements=tuple(
                map(full_sentence, run.modes.choice.sentences))))
        items += frequency_tables(run, run.modes)
        items += _judged_pictures(run, run.modes)
        said = harmonics_removed(str(s.environment.get("harmonics", "")) for s in run.modes.sets)
        if said:
            items.append(Items(title="The rotor's harmonics", statements=tuple(map(full_sentence, said))))
        odd = unmatched_sentences(run.modes)
        if odd:
            items.append(Items(title="What does not match the model", statements=tuple(map(full_sentence, odd))))
    return Section(anchor="identified", title="Identification", items=tuple(items),
                   lead="Poles of every block, and the modes of the structure among them.")


def _pole_pictures(run: Run, poles: pd.DataFrame) -> list[Element]:
    criterion = poles["criterion"].astype(str).to_numpy()
    labels = list(run.modes.labels) if run.modes else []
    pictures: list[Element] = [
        Picture(svg=figures.svg_text(d.figure, d.name), caption=d.caption, width="half")
        for d in pole_drawings(poles, labels, rotor_lines(run.campaign.scada if run.campaign else None), HALF_IN)
    ]
    counts = pd.Series(criterion).value_counts()
    rows = tuple((name, POLE_WORDS.get(name, ""), str(int(n)), percent(n / len(poles))) for name, n in counts.items())
    pictures.append(
        Table(caption="Poles kept and removed, by criterion", rows=rows, width="half",
              columns=(Column(name="criterion", number=False), Column(name="the pole", number=False),
                       Column(name="poles"), Column(name="share", unit="%")))
    )
    return pictures


def _judged_pictures(run: Run, modes: ModalData) -> list[Element]:
    """What lets a reader judge the modes: the block that the update starts from, maps, phases, conditions."""
    chosen = run.nine.set().id if run.nine is not None else None
    known = {s.id for s in modes.sets}
    if chosen is not None and chosen in known:
        modes = replace(modes, reference_set=chosen)
    block = block_of(run.folder / "modes.json", modes)
    shown = [] if block is None or block.poles is None else [stabilisation_drawing(block, modes)]
    narrow = ("auto_mac", "mac_over_sets")
    return [
        Picture(svg=figures.svg_text(d.figure, d.name), caption=d.caption, width="half" if d.name in narrow else "full")
        for d in [*shown, *mode_drawings(modes)]
    ]


def block_states(modes: ModalData) -> np.ndarray:
    """(n_set,) of str: the turbine's state in each, empty where it is not stated."""
    return np.array([str(s.environment.get("state", "")) for s in modes.sets], dtype=object)


def frequency_tables(run: Run, modes: ModalData) -> list[Element]:
    labels = mode_labels(modes)
    picture = _frequencies_by_block(run, modes, labels)
    return [frequency_table(modes, labels, run.jacket), *([picture] if picture else [])]


def frequency_table(modes: ModalData, labels: tuple[str, ...], jacket: bool) -> Table:
    """A row for each mode, over all sets and over those of each turbine state."""
    groups, several = _sets_by_state(modes), len(modes.sets) > 1
    rows, marked = [], set()
    for j, label in enumerate(labels):
        for name, inside in groups:
            if name == "all" and several:
                marked.add(len(rows))
            printed = decimal(paper_tables.FREQUENCY_COV.get(label), 3) if name == "all" else ""
            rows.append((label, *([name] if several else []), *_frequency_cells(modes, j, inside),
                         *([printed] if jacket else [])))
    columns = [Column(name="mode", number=False)]
    if several:
        columns += [Column(name="state", number=False), Column(name="blocks"),
                    Column(name="found in", unit="% of blocks"), Column(name="mean f", unit="Hz")]
    else:
        columns += [Column(name="f", unit="Hz")]
    columns += [Column(name="CoV of f", unit="-"), Column(name="median damping", unit="%")]
    if jacket:
        columns.append(Column(name="CoV, paper", unit="-", paper=True))
    note = (
        "The paper's CoVs are over a month, idling and operating together." if jacket
        else ("" if several else "CoV from the standard deviations that came with the modes.")
    )
    return Table(caption="Identified frequencies" + (" by turbine state" if len(groups) > 1 else ""),
                 columns=tuple(columns), rows=tuple(rows), note=note, marked=frozenset(marked), width="half")


def _sets_by_state(modes: ModalData) -> list[tuple[str, np.ndarray]]:
    """"all", then every turbine state that is known, with which sets (n_set,) are of it; of one set "all" alone."""
    states = block_states(modes)
    if len(states) == 1:
        return [("all", np.ones(1, bool))]
    order = [*STATES_ORDER, *sorted(set(states) - set(STATES_ORDER))]
    known = [name for name in order if name and np.any(states == name)]
    return [("all", np.ones(len(states), bool)), *((name, states == name) for name in known if known != ["unknown"])]


def _frequency_cells(modes: ModalData, j: int, inside: np.ndarray) -> list[str]:
    """Of mode j in the sets `inside`: frequency (how often found, the share and the mean where there are several sets),
    its CoV and its damping ratio."""
    f = np.array([s.frequency_hz[j] for s in modes.sets])[inside]
    d = np.array([s.damping_ratio[j] for s in modes.sets])[inside]
    f, d = f[np.isfinite(f)], d[np.isfinite(d)]
    cov = np.nan
    if len(f) > 1:
        cov = float(np.std(f, ddof=1) / np.mean(f))
    elif len(f) == 1:
        cov = float(modes.sets[0].frequency_std_hz[j] / f[0])
    if len(modes.sets) > 1:
        share = len(f) / max(int(inside.sum()), 1)
        cells = [str(len(f)), percent(share, 0), decimal(float(np.mean(f)) if len(f) else np.nan, 4)]
    else:
        cells = [decimal(f[0] if len(f) else np.nan, 3)]
    return [*cells, decimal(cov, 4), percent(float(np.median(d)) if len(d) else np.nan, 2)]


def _frequencies_by_block(run: Run, modes: ModalData, labels: tuple[str, ...]) -> Picture | None:
    """Frequencies over time; None of a single set, or where the sets' ids are not times."""
    if len(modes.sets) < 2:
        return None
    time = pd.to_datetime([s.id for s in modes.sets], errors="coerce", utc=True)
    if time.isna().any():
        return None
    frequency = np.array([s.frequency_hz for s in modes.sets])
    chosen = {s.id for s in run.nine.sets} if run.nine else set()
    selected = np.array([s.id in chosen for s in modes.sets])
    figure = figures.frequencies_by_block(time.tz_convert(None).to_numpy(), frequency, labels, selected,
                                          truth_frequencies(run, labels))
    return Picture(svg=figures.svg_text(figure, "blocks"),
                   caption="Identified frequency of each mode by block; filled: the blocks that were "
                   "selected" + ("; dashed: the virtual turbine's own frequency." if run.truth else "."))


def selection_section(run: Run) -> Section:
    items: list[Element] = []
    if run.selection is None:
        items.append(Notice(level="missing", text="selection.csv, so the reasons of the selection are not shown."))
    else:
        items += _selection_reasons(run, run.selection)
    if run.nine is not None and len(run.nine.sets) > 1:
        items += _set_elements(run, run.nine)
    return Section(anchor="selected", title="Selection", items=tuple(items),
                   lead="The blocks that an update may use, and why the others were left out.")


def _selection_reasons(run: Run, selection: pd.DataFrame) -> list[Element]:
    reason = selection["criterion"].astype(object).fillna("").astype(str)
    found = [n for n in dict.fromkeys(reason) if n]
    names = [n for n in CRITERIA_ORDER if n in found] + [n for n in found if n not in CRITERIA_ORDER]
    excluded = [int((reason == n).sum()) for n in names]
    items: list[Element] = [
        Picture(
            svg=figures.svg_text(figures.selection_steps(names, excluded, len(selection)), "selection"),
            caption="Blocks that each criterion removed, in this order (a block counts at the first it fails).",
        )
    ]
    if run.jacket:
        items.append(_criteria_table(run, selection, dict(zip(names, excluded, strict=True))))
    return items


def count_passing_blocks(selection: pd.DataFrame) -> int:
    """Blocks that no criterion took away."""
    return int((selection["criterion"].astype(object).fillna("") == "").sum())


def _criteria_table(run: Run, selection: pd.DataFrame, excluded: dict[str, int]) -> Table:
    """Table 1 beside how many blocks each of its criteria took here."""
    here = (("yawing", "pitching"), ("not idling",), ("modes not identified",), ("planes not perpendicular",))
    rows = [(assumption, criterion, str(sum(excluded.get(name, 0) for name in names)))
            for (assumption, criterion), names in zip(paper_tables.SELECTION, here, strict=True)]
    left = count_passing_blocks(selection)
    kept = f"{len(run.nine.sets)} of {left}" if run.nine is not None else str(left)
    rows.append(("selected sets", f"{paper_tables.SELECTED_SETS} in the paper", f"{kept} that pass"))
    columns = (Column(name="assumption", number=False, paper=True), Column(name="criterion", number=False, paper=True),
               Column(name="blocks left out here"))
    return Table(caption="The paper's criteria (Table 1)", columns=columns, rows=tuple(rows),
                 note="Blocks without data are not counted here.")


# what a set was measured in, where any states it: key, name, unit, digits
SET_CONDITIONS = (("wind_speed_mps", "wind", "m/s", 1), ("nacelle_heading_deg", "nacelle heading", "deg", 0))


def _set_elements(run: Run, nine: ModalData) -> list[Element]:
    labels = mode_labels(nine)
    truth = truth_frequencies(run, labels)
    rows, marked = [], set()
    reference = nine.set()
    clusters = close_clusters(reference.frequency_hz)
    recorded = [one for one in SET_CONDITIONS if any(s.environment.get(one[0]) is not None for s in nine.sets)]
    blank = [""] * (1 + len(recorded))
    for k, s in enumerate(nine.sets):
        similar = _similarities(s.shape, reference.shape, clusters)
        if s.id == reference.id:
            marked.add(k)
        row = [s.id + (" (reference)" if s.id == reference.id else "")]
        row += [decimal(f, 4) for f in s.frequency_hz]
        row.append(decimal(min(similar), 3) if similar else MISSING)
        row += [decimal(_numeric(s.environment.get(key)), digits) for key, _, _, digits in recorded]
        rows.append(tuple(row))
    frequency = np.array([s.frequency_hz for s in nine.sets])
    with np.errstate(invalid="ignore"):
        mean = [float(np.mean(c[np.isfinite(c)])) if np.any(np.isfinite(c)) else np.nan for c in frequency.T]
        cov = [float(np.std(c[np.isfinite(c)], ddof=1) / np.mean(c[np.isfinite(c)])) if np.isfinite(c).sum() > 1
               else np.nan for c in frequency.T]
    rows.append(("mean", *[decimal(m, 4) for m in mean], *blank))
    rows.append(("CoV [-]", *[decimal(c, 4) for c in cov], *blank))
    if truth is not None:
        rows.append(("truth of the virtual turbine", *[decimal(t, 4) for t in truth], *blank))
        error = [percent(m / t - 1, 2, sign=True) for m, t in zip(mean, truth, strict=True)]
        rows.append(("mean minus truth [%]", *error, *blank))
    columns = (Column(name="set", number=False), *[Column(name=label, unit="Hz") for label in labels],
               Column(name="least MAC to the reference", unit="-"),
               *[Column(name=name, unit=unit) for _, name, unit, _ in recorded])
    note = (
        "Least MAC over the modes; of a close pair, that of the planes: within its plane any two directions may come "
        "out of a block."
    )
    return [Table(caption=f"The {len(nine.sets)} selected sets", columns=columns, rows=tuple(rows), note=note,
                  marked=frozenset(marked))]


def _similarities(shape: np.ndarray, reference: np.ndarray, clusters: list[tuple[int, ...]]) -> list[float]:
    """MAC of every single mode and of every close pair's plane, as far as both sets have them."""
    found = []
    for cluster in clusters:
        a, b = shape[:, list(cluster)], reference[:, list(cluster)]
        if np.sum(np.all(np.isfinite(a), axis=1) & np.all(np.isfinite(b), axis=1)) > len(cluster):
            found.append(plane_mac(a, b))
    return found


def _numeric(value: object) -> float:
    return float(value) if isinstance(value, (int, float, np.number)) else float("nan")


def truth_frequencies(run: Run, labels: tuple[str, ...]) -> list[float] | None:
    """The virtual turbine's own frequencies in the idling state under these labels, where the truth is known."""
    known = (run.truth or {}).get("idling_hz")
    return [float(known.get(label, np.nan)) for label in labels] if known else None
