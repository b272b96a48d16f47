"""What a part, a place and a row of the catalogue are does not hang on the words for them."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from probupdate.diagnosis.diagnose import examine
from probupdate.diagnosis.elementary import PART_CAUSES, elementary, parts_of
from probupdate.diagnosis.free_form import free_form
from probupdate.diagnosis.part_places import words_of
from probupdate.diagnosis.prepare import Prepared
from probupdate.diagnosis.wording import channel_response_actions
from probupdate.effects.catalogue import measurement_effects
from probupdate.effects.turbine import turbine_effects
from probupdate.modal.modes import Sensor
from probupdate.structure.description_file import parse_description
from probupdate.structure.load import reference_model
from probupdate.structure.parameter_table import read_toml
from probupdate.structure.turbine_frame import build_frame


def scaled(prepared: Prepared, factor: float) -> Prepared:
    """The same modes of a structure of another size."""
    wire = prepared.small.wire
    return replace(prepared, small=replace(prepared.small, wire=replace(wire, node_m=factor * wire.node_m)))


@pytest.mark.parametrize("height_m", [0.14, 1e-3, 15.0, 1e5])
def test_parts_of_a_structure_of_any_size_read_each_otherwise(pictured_frame, height_m):
    parts = parts_of(scaled(pictured_frame, height_m / 15.0), heights=5)
    words = Counter((effect.cause, effect.location) for effect, _ in parts)
    names = Counter(effect.parameter for effect, _ in parts)
    assert max(words.values()) == max(names.values()) == 1
    assert len(parts) == len(parts_of(pictured_frame, heights=5))


def test_places_with_the_same_words_are_told_apart(pictured_frame):
    """As two nodes of one face in one bay are; the words say where each is."""
    rows = [effect for effect, _ in elementary(pictured_frame.small, lambda point: "face AB, bay 1", heights=5)]
    masses = [effect.location for effect in rows if effect.cause == PART_CAUSES[2]]
    assert len(set(masses)) == len(masses) > 1
    assert "face AB, bay 1, at (0.0, 0.0, 15.0) m" in masses
    assert len({effect.parameter for effect in rows}) == len({effect.key for effect in rows}) == len(rows)


def test_words_of_places():
    points = np.array([[0.0, 0, 0.02], [0.0, 0, 0.02], [0.0, 0, 0.12], [0.1, 0, 0.12]])
    face = iter(("leg A", "leg A", "face AB", "leg A"))
    assert words_of(points, lambda point: next(face), 0.14) == [
        "leg A, at (0.000, 0.000, 0.020) m, no. 1", "leg A, at (0.000, 0.000, 0.020) m, no. 2", "face AB",
        "leg A, at (0.100, 0.000, 0.120) m"]


@pytest.mark.parametrize("channels", [("H10 (V1)", "H10", "V1", "v1"), ("TP", "TP-x", "top-x", "top-y"),
                                      ("T", "T1", "T 1", "T-1")])
def test_a_place_of_sensors_is_not_called_as_a_channel(channels):
    sensors = [Sensor(channel=c, level="deck", position_m=np.array([0.0, 0.0, 10.0 * (k // 2)]),
                      direction=np.eye(3)[k % 2]) for k, c in enumerate(channels)]
    rows = measurement_effects(channels, sensors)
    words = Counter((row.cause, row.location) for row in rows)
    assert max(words.values()) == 1
    assert any(row.location == f"{channels[0]} and {channels[1]} about z" for row in rows)


def test_channels_to_leave_out_are_named_as_the_command_takes_them():
    """Their names are not read back from the sentence that lists them."""
    part = {"location": "TP, A, x, T90", "channels": ["TP, A, x", "T90"], "factors": [], "check": "look at its mount"}
    (action,) = channel_response_actions({"details": {"free_form": {"parts": [part]}}})
    assert action.endswith("(--without 'TP, A, x' T90)")


@pytest.mark.long
@pytest.mark.parametrize("height_m", [0.14, 1e4])
def test_what_is_found_does_not_hang_on_the_size_of_the_structure(pictured_frame, record, height_m):
    """A spring that no row has, of a structure of 15 m and of another size with the same modes."""
    data = record(11, stay=(6, 3e5))
    own, other = (examine(one, data) for one in (pictured_frame, scaled(pictured_frame, height_m / 15.0)))
    assert own.diagnosis.verdict == other.diagnosis.verdict == "unexplained"
    parts = [free_form(one, outcome, data).content["parts"]
             for one, outcome in ((pictured_frame, own), (scaled(pictured_frame, height_m / 15.0), other))]
    for a, b in zip(*parts, strict=True):
        assert (a["cause"], a["time_profile"]) == (b["cause"], b["time_profile"])
        assert b["size"] == pytest.approx(a["size"])


def described(legs: tuple[str, ...]):
    """The reference turbine with its legs named so, without the effects of its file."""
    raw = read_toml(reference_model("as_built"))
    new = dict(zip(raw["jacket"]["leg_names"], legs, strict=True))
    raw["jacket"]["leg_names"] = list(legs)
    raw["parameter"] = [p for p in raw["parameter"] if "kind" not in p]
    for sensor in raw["sensor"]:
        if sensor["part"].startswith("leg "):
            sensor["part"] = f"leg {new[sensor['part'].removeprefix('leg ')]}"
    return parse_description(raw, "model.toml")


@pytest.mark.parametrize("legs", [("A", "BC", "AB", "C"), ("A", "a", "A 1", "A-1"), ("A", "A-", "-A", "--")])
def test_faces_of_legs_of_any_names_are_told_apart(legs):
    """Legs A and BC, AB and C: two faces were "ABC", one row for both."""
    d = described(legs)
    rows = turbine_effects(d)
    faces = [row for row in rows if row.cause == "brace stiffness lost" and row.location.startswith("face ")]
    assert len(faces) == 4 * len(d.jacket.bay)
    assert len({row.adds.name for row in rows}) == len({(row.cause, row.location) for row in rows}) == len(rows)
    braces = {beam.part for beam in build_frame(d).beams if beam.group == "brace"}
    assert len(braces) == 8 * len(d.jacket.bay)


def test_faces_of_the_reference_keep_their_names():
    assert tuple(described(("A", "B", "C", "D")).jacket.faces) == ("AB", "BC", "CD", "DA")
