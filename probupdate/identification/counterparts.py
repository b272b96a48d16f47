"""Which mode of the model each of the campaign's modes may be, how alike the two are, and what has none on either side.

The modes are found before; here they are named, once for the campaign. Every block says how alike its shapes are to the
model's, turned to where the nacelle looked; a pair of modes is compared by its plane. Similarity of shape and nearness
in frequency count as they scatter between a structure and a poor model of it, so that a torsion of MAC 0.65 at its
frequency still has its name, and says that the model's is another.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from probupdate.identification.classification import ClassifierSettings
from probupdate.identification.reference import ReferenceModes
from probupdate.identification.settings import CONSTANTS
from probupdate.modal.labels import moves_little
from probupdate.modal.modes import ModalData, ModalSet, ModelMode, ModeRecord, mac, subspace_mac

MODEL_MAC, MODEL_FREQUENCY, NO_MAC = CONSTANTS.model_mac, CONSTANTS.model_frequency, CONSTANTS.no_mac
OWN_SHAPE = CONSTANTS.own_shape
SURE_FREQUENCY, WRONG_MAC, ALL_NEAR = CONSTANTS.sure_frequency, CONSTANTS.wrong_mac, CONSTANTS.all_near
# of fewer modes all may be near others by chance
FEWEST_SOUGHT = 4
LEAST_SIZE = CONSTANTS.least_size
# so many modes of the model that were not asked for are said one by one; probability from which a mode looks like one
MOST_SINGLE, LIKELY = 2, 0.5
# blocks that are compared at most, evenly over those that have the mode
MOST_BLOCKS = 200


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelComparison:
    """Means over blocks: plane, own (n_mode, n_model) S2MAC to the plane of a measured or of the model's pair, the
    larger (of single modes their MAC), and MAC; plane_std their scatter; ratio, ratio_std (n_mode, n_model) of measured
    over the model's frequency."""

    plane: np.ndarray
    plane_std: np.ndarray
    own: np.ndarray
    ratio: np.ndarray
    ratio_std: np.ndarray

    def select(self, rows: Sequence[int]) -> ModelComparison:
        """Those modes' rows; what -1 stands for is nobody's."""
        rows = list(rows)
        return ModelComparison(plane=self.plane[rows], plane_std=self.plane_std[rows], own=self.own[rows],
                               ratio=self.ratio[rows], ratio_std=self.ratio_std[rows])


def model_comparison(
    sets: Sequence[ModalSet], pairs: Sequence[tuple[int, int]], turned_to: Sequence[ReferenceModes]
) -> ModelComparison:
    """sets: the campaign's, a column a mode; turned_to: the model's modes as each block's nacelle has them."""
    n_mode, n_model = sets[0].frequency_hz.size, len(turned_to[0].labels)
    mate = {i: j for pair in pairs for i, j in (pair, pair[::-1])}
    plane, plane_std, own, ratio, ratio_std = (np.full((n_mode, n_model), np.nan) for _ in range(5))
    for j in range(n_mode):
        there = [k for k, s in enumerate(sets) if s.measured[j]]
        if not there:
            continue
        count = min(len(there), MOST_BLOCKS)
        some = [there[int(k)] for k in np.linspace(0, len(there) - 1, count)]
        values, single = [], []
        for k in some:
            shape, here = sets[k].shape, turned_to[k]
            model = here.shape
            single.append(mac(shape[:, [j]], model)[0])
            both = j in mate and sets[k].measured[mate[j]]
            value = subspace_mac(model, shape[:, [j, mate[j]]]) if both else single[-1]
            for pair in here.pairs:
                # of two modes of the model that turn into each other their plane
                value[list(pair)] = np.maximum(value[list(pair)], subspace_mac(shape[:, j], model[:, list(pair)])[0])
            values.append(value)
        plane[j], own[j] = np.mean(values, axis=0), np.mean(single, axis=0)
        plane_std[j] = np.std(values, axis=0, ddof=1) if len(values) > 1 else np.nan
        f = np.array([sets[k].frequency_hz[j] for k in there])
        ratio[j] = f.mean() / turned_to[0].frequency_hz
        ratio_std[j] = f.std(ddof=1) / turned_to[0].frequency_hz if len(f) > 1 else np.nan
    return ModelComparison(plane=plane, plane_std=plane_std, own=own, ratio=ratio, ratio_std=ratio_std)


def pair_modes(
    like: ModelComparison, model: ReferenceModes, sought: int | None = None
) -> tuple[dict[int, int], np.ndarray]:
    """Mode -> mode of the model, one to one, and the probability (n_mode, n_model) that a mode is each; what is left to
    one is that of none. Of modes of like shape the one that moves the sensors more is the likelier, as it is the more
    likely to be seen: a member's own mode drags the level along. Where each of the first `sought` modes of the model
    (default: all) has one near its frequency and names by shapes go elsewhere, as of exchanged or reversed channels,
    frequencies name them."""
    sought = len(model.labels) if sought is None else sought
    size = np.linalg.norm(model.shape, axis=0)
    none = -0.5 * ((1 - NO_MAC) / MODEL_MAC) ** 2

    def gain(mac_std: float, frequency_std: float) -> np.ndarray:
        weight = -0.5 * ((1 - like.plane) / mac_std) ** 2 - 0.5 * (np.log(like.ratio) / frequency_std) ** 2
        weight = weight - np.log(mac_std * frequency_std / (MODEL_MAC * MODEL_FREQUENCY))
        weight = weight + OWN_SHAPE * (like.own - 1) + np.log(np.maximum(size / size.max(), LEAST_SIZE))
        return np.nan_to_num(weight - none, nan=-np.inf)

    usual = gain(MODEL_MAC, MODEL_FREQUENCY)
    partner = _assign_modes(usual)
    if not _are_all_near(partner, like, sought):
        by_frequency = gain(WRONG_MAC, SURE_FREQUENCY)
        unlike = _assign_modes(by_frequency)
        if sought >= FEWEST_SOUGHT and _are_all_near(unlike, like, sought):
            partner, usual = unlike, by_frequency
    odds = np.exp(np.minimum(usual, 500.0))
    return partner, odds / (1 + odds.sum(axis=1, keepdims=True))


def _assign_modes(gain: np.ndarray) -> dict[int, int]:
    """Mode -> mode of the model, one to one, with the largest sum of gains."""
    from scipy import optimize

    score = np.where(gain > 0, gain, 0.0)
    rows, columns = optimize.linear_sum_assignment(-score)
    return {int(j): int(i) for j, i in zip(rows, columns, strict=True) if score[j, i] > 0}


def _are_all_near(partner: dict[int, int], like: ModelComparison, sought: int) -> bool:
    """Whether each of the model's first `sought` modes has a partner near its frequency."""
    near = {i for j, i in partner.items() if abs(np.log(like.ratio[j, i])) <= ALL_NEAR}
    return near >= set(range(sought))


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchedModes:
    """The campaign's modes held against a model's: similarities, mode -> the model's mode, probability (n_mode,
    n_model) that a mode is each."""

    model: ReferenceModes
    like: ModelComparison
    partner: dict[int, int]
    probability: np.ndarray

    def select(self, columns: Sequence[int]) -> MatchedModes:
        """Of those modes, in that order; what -1 stands for is none of the model's."""
        columns = list(columns)
        return MatchedModes(model=self.model, like=self.like.select(columns),
                            partner={k: self.partner[j] for k, j in enumerate(columns) if j in self.partner},
                            probability=self.probability[columns] * (np.array(columns) >= 0)[:, None])


def match_modes(
    sets: Sequence[ModalSet], pairs: Sequence[tuple[int, int]], turned_to: Sequence[ReferenceModes],
    model: ReferenceModes, sought: int | None = None,
) -> MatchedModes:
    """The comparison and the pairs, as `pair_modes`; `turned_to`: the model's modes as each set's nacelle has them."""
    like = model_comparison(sets, pairs, turned_to)
    partner, probability = pair_modes(like, model, sought)
    return MatchedModes(model=model, like=like, partner=partner, probability=probability)


def records_of(
    sets: Sequence[ModalSet], names: Sequence[str], matched: MatchedModes | None, *, in_pair: Collection[int],
    settings: ClassifierSettings, highest_hz: float, wanted: Sequence[str],
) -> tuple[tuple[ModeRecord, ...], tuple[ModelMode, ...], list[str]]:
    """A record of each mode; and where there is a model, its modes below `highest_hz`, or `wanted`, that were not
    found, and what does not match in words."""
    records = _mode_records(sets, names, matched, in_pair, settings)
    if matched is None:
        return records, (), []
    lacking = _model_only(matched, [r.frequency_hz for r in records if r.found], highest_hz, wanted)
    return records, lacking, sentences(records, lacking, wanted)


def _mode_records(
    sets: Sequence[ModalSet], names: Sequence[str], matched: MatchedModes | None, in_pair: Collection[int],
    settings: ClassifierSettings,
) -> tuple[ModeRecord, ...]:
    """What is known of every mode of the campaign: where it was found, and what it is in the model."""
    usable = [s for s in sets if not s.environment.get("excluded")]
    records = []
    for j, name in enumerate(names):
        found = _detection_values(usable, j) | {"label": name, "pair": j in in_pair}
        if matched is not None:
            chance = matched.probability[j]
            likely = [int(k) for k in np.argsort(-chance) if chance[k] > 0.01]
            found["alternatives"] = tuple((matched.model.labels[k], float(chance[k])) for k in likely[:3])
            found |= _model_comparison(j, matched, settings.plane_mac if j in in_pair else settings.mac)
        records.append(ModeRecord(**found))
    return tuple(records)


def _detection_values(usable: Sequence[ModalSet], j: int) -> dict[str, Any]:
    """Mean, scatter and detection of mode j over the blocks that can be used."""
    here = [s for s in usable if s.measured[j]]
    states = [str(s.environment.get("state", "unknown")) for s in usable]
    f = np.array([s.frequency_hz[j] for s in here])
    zeta = np.array([s.damping_ratio[j] for s in here])
    return {
        "frequency_hz": float(f.mean()) if len(f) else np.nan,
        "frequency_std_hz": float(f.std(ddof=1)) if len(f) > 1 else np.nan,
        "damping_ratio": float(np.median(zeta)) if len(f) else np.nan, "found": len(here), "blocks": len(usable),
        "detection": {state: (int(sum(s.measured[j] for s, t in zip(usable, states, strict=True) if t == state)),
                              states.count(state)) for state in sorted(set(states))},
    }


def _model_comparison(j: int, matched: MatchedModes, limit: float) -> dict[str, Any]:
    """How mode j compares with the model's mode that it is; alike from `limit` of the MAC upwards."""
    i, like, model = matched.partner.get(j), matched.like, matched.model
    if i is None:
        return {"match": "none"}
    return {
        "match": "alike" if like.plane[j, i] >= limit else "unlike", "model_label": model.labels[i],
        "model_frequency_hz": float(model.frequency_hz[i]), "mac": float(like.plane[j, i]),
        "mac_std": float(like.plane_std[j, i]), "own_mac": float(like.own[j, i]),
        "frequency_ratio": float(like.ratio[j, i]), "frequency_ratio_std": float(like.ratio_std[j, i]),
    }


def _model_only(
    matched: MatchedModes, found_hz: Sequence[float], highest_hz: float, wanted: Sequence[str]
) -> tuple[ModelMode, ...]:
    """Modes of the model below `highest_hz` that no measured one is, and whether the excitation should show them: those
    that move the sensors as others do and lie between modes that were found, so that the band was excited."""
    model = matched.model
    little, result = moves_little(model.shape), []
    for i, (label, f) in enumerate(zip(model.labels, model.frequency_hz, strict=True)):
        if i in matched.partner.values() or (f > highest_hz and label not in wanted):
            continue
        excited = bool(len(found_hz) > 0 and min(found_hz) < f < max(found_hz) and f <= highest_hz)
        moves = not little[i]
        result.append(ModelMode(label=label, frequency_hz=float(f), expected=excited and moves,
                                hardly_seen=excited and not moves))
    return tuple(result)


def counterpart_words(one: ModeRecord) -> str:
    """Of a measured mode that is none of the model's, whether another measured mode has the one that it looks like."""
    label, probability = next(iter(one.alternatives), ("", 0.0))
    return (f"looks like the model's {label}, which another measured mode is: the same mode before or after a change, "
            "or a second one of that shape" if probability > LIKELY else "has no counterpart in the model")


def further_modes(records: Sequence[ModeRecord]) -> list[ModeRecord]:
    """Measured modes that the model has, of which it was not asked to have a name."""
    return [one for one in records if one.match == "alike" and one.label != one.model_label and one.found]


def further_modes_left_out(records: Sequence[ModeRecord]) -> list[str]:
    """Why an update leaves these out: a sentence each, of many one for all."""
    end = "not surely the model's; --every-mode takes those that are alike"
    if len(records) > MOST_SINGLE:
        return [f"{len(records)} modes, {_list_words(records)}: {end} "
                "(frequencies and MAC in the file of the modal sets)"]
    return [f"{one.label} ({one.frequency_hz:.4g} Hz, in {one.found} of {one.blocks} blocks): the model's "
            f"{one.model_label} (MAC {one.mac:.2f}), {end}" for one in records]


def _list_words(further: Sequence[ModeRecord]) -> str:
    return (f"{', '.join(one.label for one in further)}, which are the model's "
            f"{', '.join(one.model_label for one in further)}")


def unmatched_sentences(data: ModalData) -> list[str]:
    """The same of modes that were written: of a file's records, where it has any."""
    wanted = [r.label for r in data.records if not r.label.isdigit()]
    return sentences(data.records, data.model_only, wanted)


def sentences(records: Sequence[ModeRecord], lacking: Sequence[ModelMode], wanted: Sequence[str]) -> list[str]:
    """What does not match, in words."""
    lines = []
    for one in records:
        name = f"mode {one.label}" if one.label.isdigit() else one.label
        place = f"{name} at {one.frequency_hz:.4g} Hz, in {one.found} of {one.blocks} blocks,"
        if one.match == "unlike" and one.found:
            scatter = f" +- {one.mac_std:.2f}" if np.isfinite(one.mac_std) else ""
            lines.append(
                f"{place} looks unlike the model's {one.model_label} at {one.model_frequency_hz:.4g} Hz: MAC "
                f"{one.mac:.2f}{scatter}, and nothing else of the model is nearer; kept as {name}")
        elif one.match == "none" and one.found:
            lines.append(f"{place} {counterpart_words(one)}; kept as mode {one.label}")
    further = further_modes(records)
    if len(further) > MOST_SINGLE:
        lines.append(f"{len(further)} modes, {_list_words(further)}, were not asked for; they are kept by number "
                     "(frequencies and MAC in the file)")
    else:
        lines += [f"{one.label} at {one.frequency_hz:.4g} Hz, in {one.found} of {one.blocks} blocks, looks like the "
                  f"model's {one.model_label} at {one.model_frequency_hz:.4g} Hz (MAC {one.mac:.2f}); kept as mode "
                  f"{one.label}"
                  for one in further]
    hidden = [f"{one.label} ({one.frequency_hz:.4g} Hz)" for one in lacking if one.hardly_seen]
    if hidden:
        lines.append(f"the model's {', '.join(hidden)} {'is' if len(hidden) == 1 else 'are'} in no block: the sensors "
                     "hardly see such motion")
    for expected in (True, False):
        missed = [one for one in lacking if bool(one.expected) is expected
                  and (expected or (one.label in wanted and not one.hardly_seen))]
        if missed:
            it, are = ("it", "is") if len(missed) == 1 else ("them", "are")
            why = (f"although the excitation should show {it}; a higher --order may" if expected else
                   "which the excitation may not show")
            named = (f"{missed[0].label} at {missed[0].frequency_hz:.4g} Hz" if len(missed) == 1 else
                     ", ".join(f"{one.label} ({one.frequency_hz:.4g} Hz)" for one in missed))
            lines.append(f"the model's {named} {are} in no block, {why}")
    return lines
