"""What a file says of its channels itself (unit, quantity, direction, rate), held against campaign.toml: what can be
converted is, and said; everything else that disagrees is refused."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from probupdate.errors import InputError
from probupdate.modal.modes import Sensor

# unit -> factor to SI, by quantity, as campaign.toml writes them; g is the standard gravity
UNITS = {
    "acceleration": {"m/s2": 1.0, "m/s^2": 1.0, "cm/s2": 1e-2, "mm/s2": 1e-3, "g": 9.80665, "mg": 9.80665e-3},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "displacement": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
}
# in files of other programs also these
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "in": 0.0254, "inch": 0.0254,
           "ft": 0.3048}
GRAVITIES = {"g": 9.80665, "gn": 9.80665, "mg": 9.80665e-3, "ug": 9.80665e-6, "gal": 1e-2, "mgal": 1e-5}
OTHERS = {
    "force": ("n", "kn", "mn", "lbf"), "pressure or stress": ("pa", "kpa", "mpa", "gpa", "bar", "mbar", "psi"),
    "an angle": ("deg", "rad", "mrad", "urad"), "an angular velocity": ("deg/s", "rad/s", "rpm", "1/min"),
    "an angular acceleration": ("rad/s2", "deg/s2"), "a temperature": ("degc", "celsius", "kelvin"),
    "power": ("w", "kw", "mw"), "strain": ("strain", "ustrain", "um/m", "ue"), "a moment": ("knm", "nm/rad"),
}
# what a sensor puts out, which `factor` turns into what it measures
ELECTRICAL = ("v", "mv", "uv", "volt", "volts", "ma", "counts", "count", "digits", "digit", "bit", "bits", "lsb", "pc",
              "fullscale")
# words of programs and loggers for a number that is none
NOT_A_NUMBER = frozenset({"nan", "+nan", "-nan", "nan(ind)", "-nan(ind)", "nan(snan)", "1.#qnan", "-1.#qnan", "1.#ind",
                          "-1.#ind", "#nan"})
# cosine of the angle between two directions that are one; sensors are mounted to a few degrees
ALIKE = 0.98
# how far a factor in convert.toml may be from the one that a unit needs: the rest is the sensor's calibration
CALIBRATION = 2.0
UNIT_KEYS = ("unit", "units")
RATE_KEYS = ("fs", "sampling_rate", "sampling_rate_hz", "samplingrate", "sample_rate", "samplerate", "rate_hz",
             "sampling_frequency", "samplefrequency", "sf")
STEP_KEYS = ("dt", "delta_t", "tsample", "sample_interval", "time_step")
SAME_RATE = 1e-3
# "Sampling rate (Hz): 51.2", '# fs = 100 Hz', "SampleRate;50"
HEADING = re.compile(
    r"""[#%;"'\s]*([A-Za-z][\w -]*?)\s*(?:[(\[]\s*(?:Hz|s)\s*[)\]])?["']?\s*[=:;,\t]\s*"""
    r"""["']?(\d+(?:[.,]\d+)?)\s*(?:Hz|s|sec)?["';,\s]*$""", re.IGNORECASE)
LONGEST_HEADING = 200
BRACKETS = re.compile(r"[\[(]([^\[\]()]{1,16})[\])]\s*$")


@dataclass(frozen=True, eq=False, kw_only=True)
class ChannelStatement:
    """What a file says of one channel; None where it says nothing. direction: (3,) of length 1, in the file's axes."""

    quantity: str | None = None
    unit: str | None = None
    direction: np.ndarray | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class FileStatements:
    """What a file says of itself: of each channel, and its sampling rate. notes: what was done to its samples; unused:
    its columns that are no channel's and not time's."""

    channels: Mapping[str, ChannelStatement] = field(default_factory=dict)
    rate_hz: float | None = None
    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()


def parse_unit(text: str) -> tuple[str, float] | None:
    """(quantity, factor to SI) of a unit however it is written; factor NaN for what is not a motion, None for no
    unit."""
    plain = unicodedata.normalize("NFKC", text).strip().lower().replace("μ", "u")
    plain = re.sub(r"[\s·*^]|\*\*", "", plain).replace("sec", "s").replace("⁄", "/").replace("−", "-")
    plain = plain.strip("'\"").replace("g's", "g").replace("°", "deg")
    if text.strip()[:2] in ("Nm", "NM"):
        return "a moment", np.nan
    if plain in GRAVITIES:
        return "acceleration", GRAVITIES[plain]
    if plain in ELECTRICAL:
        return "electrical", np.nan
    other = next((name for name, units in OTHERS.items() if plain in units), None)
    if other is not None:
        return other, np.nan
    found = re.fullmatch(r"([a-z]+?)(/s/s|/s2|/\(s2\)|s-2|/s|s-1|)", plain)
    if found is None or found[1] not in LENGTHS:
        return None
    power = {"": 0, "/s": 1, "s-1": 1}.get(found[2], 2)
    return ("displacement", "velocity", "acceleration")[power], LENGTHS[found[1]]


def unit_in(name: str) -> str | None:
    """The unit in brackets at the end of a column's name, where it is one."""
    found = BRACKETS.search(name)
    # one capital is a compass direction or an axis there
    return found[1] if found and not re.fullmatch("[A-Z]", found[1].strip()) and parse_unit(found[1]) else None


def without_unit(name: str) -> str:
    """A column's name without the unit in brackets at its end."""
    return name if unit_in(name) is None else BRACKETS.sub("", name).strip()


def keyed_rate(values: Mapping[str, float]) -> float | None:
    """The rate that a file states under one of the usual names (a step in s as well)."""
    for name, value in values.items():
        key = re.split(r"[./]", name)[-1].strip().lower()
        if key in RATE_KEYS and 0 < value < np.inf:
            return float(value)
        if key in STEP_KEYS and 0 < value < np.inf:
            return 1 / float(value)
    return None


def heading_rate(lines: Sequence[str]) -> float | None:
    """The rate that lines above a table state, as "Sampling rate: 51.2 Hz" or "# fs = 100"."""
    found = (HEADING.match(line) for line in lines if len(line) <= LONGEST_HEADING)
    return keyed_rate({re.sub(r"\W+", "_", one[1].strip()): float(one[2].replace(",", ".")) for one in found if one})


def refuse_other_rate(where: str, own: FileStatements, rate_hz: float, overruled: Sequence[str]) -> None:
    """Raises InputError where a file states another rate than campaign.toml."""
    if own.rate_hz is None or "rate" in overruled or abs(own.rate_hz / rate_hz - 1) <= SAME_RATE:
        return
    raise InputError(where, f"states {own.rate_hz:g} Hz, campaign.toml says {rate_hz:g} Hz",
                     'correct the one that is wrong; where it is the file, write overrule = ["rate"] in convert.toml')


def channel_factor(
    where: str, sensor: Sensor, stated: ChannelStatement, given: float | None, overruled: Sequence[str]
) -> tuple[float, str | None]:
    """What a channel's numbers are multiplied with to be what campaign.toml says, and a sentence where the file's own
    words ask for it. given: the factor of convert.toml, None where it has none. Raises InputError where the two
    contradict each other, or a factor both."""
    where = f"{where}, {sensor.channel}"
    needed, words = 1.0, []
    unit = None if "unit" in overruled or stated.unit is None else parse_unit(stated.unit)
    quantity = stated.quantity
    if unit is not None and unit[0] != "electrical":
        if quantity in UNITS and unit[0] != quantity and "quantity" not in overruled:
            raise _disagreement(where, f"states {quantity} in {stated.unit}, which is {unit[0]}",
                                "correct the file, or name the one that is wrong", "unit")
        quantity = quantity or unit[0]
    if quantity is not None and quantity != sensor.quantity and "quantity" not in overruled:
        raise _disagreement(where, f"states {quantity}{f' ({stated.unit})' if stated.unit else ''}, campaign.toml says "
                            f"{sensor.quantity}", "correct quantity in campaign.toml, or name another column",
                            "quantity")
    if unit is not None and unit[0] == sensor.quantity:
        needed *= unit[1] / UNITS[sensor.quantity][sensor.unit]
        if abs(needed - 1) > 1e-6:
            words.append(f"{stated.unit} was turned into {sensor.unit}")
    elif unit is not None and unit[0] == "electrical" and given is None:
        raise _disagreement(where, f"is in {stated.unit}, campaign.toml says {sensor.unit}",
                            f"give {sensor.unit} per {stated.unit} under [factor] in convert.toml", "unit")
    sign = _sign(where, sensor, stated, overruled)
    if sign < 0:
        words.append("its sign was reversed, as it points against its direction in campaign.toml")
    needed *= sign
    if given is None:
        return needed, f"{sensor.channel}: {' and '.join(words)}" if words else None
    return given, _check_factor(where, sensor, stated, given, needed, unit)


def _sign(where: str, sensor: Sensor, stated: ChannelStatement, overruled: Sequence[str]) -> float:
    if stated.direction is None or "direction" in overruled:
        return 1.0
    cosine = float(stated.direction @ sensor.direction)
    if abs(cosine) < ALIKE:
        raise _disagreement(where, f"points along {_vector(stated.direction)}, campaign.toml says "
                            f"{_vector(sensor.direction)}",
                            "correct direction in campaign.toml (with axes of the model), "
                            "or name another column", "direction")
    return float(np.sign(cosine))


def _check_factor(where, sensor, stated, given, needed, unit) -> str | None:
    """The factor that a user gives is used; the file's own words must not ask for quite another one."""
    if unit is not None and unit[0] == "electrical":
        return None
    away = given / needed
    if 1 / CALIBRATION <= away <= CALIBRATION:
        return None
    if away < 0 and 1 / CALIBRATION <= -away <= CALIBRATION and stated.direction is None:
        # of its sign the file says nothing
        return None
    if unit is None and stated.direction is None:
        return None
    states = " and ".join(filter(None, [stated.unit if unit else None, f"the direction {_vector(stated.direction)}"
                                        if stated.direction is not None else None]))
    raise _disagreement(where, f"states {states}, which takes a factor of {needed:.6g} to be {sensor.unit} along "
                        f"{_vector(sensor.direction)}; convert.toml gives {given:g}",
                        "take its factor out, or write the product with the sensor's calibration", "unit")


def _vector(direction: np.ndarray) -> str:
    for k, axis in enumerate("xyz"):
        if abs(abs(direction[k]) - 1) < 1e-6:
            return f"{'+' if direction[k] > 0 else '-'}{axis}"
    return f"({', '.join(f'{v:.3g}' for v in direction)})"


def _disagreement(where: str, problem: str, remedy: str, kind: str) -> InputError:
    return InputError(where, problem, f'{remedy}; where the file is wrong, write overrule = ["{kind}"] in convert.toml')


def refuse_other_words(where: str, sensors: Sequence[Sensor], attributes: Mapping[str, object]) -> None:
    """Records of a campaign are used as they are: raises InputError where their own attributes `unit` or `quantity`
    (one text, or one for each channel) are not those of campaign.toml."""
    for key in (*UNIT_KEYS, "quantity"):
        if key not in attributes:
            continue
        values = _texts(attributes[key], len(sensors))
        if values is None:
            raise InputError(f"{where}, {key}", f"{attributes[key]!r:.80} is not text for each of {len(sensors)} "
                             "channels", "write one text, or a list of them")
        for sensor, text in zip(sensors, values, strict=True):
            if key == "quantity":
                agree, says = text == sensor.quantity, sensor.quantity
            else:
                found, says = parse_unit(text), sensor.unit
                agree = found is None or (found[0] == sensor.quantity and abs(
                    found[1] / UNITS[sensor.quantity][sensor.unit] - 1) < 1e-6)
            if not agree:
                raise InputError(f"{where}, {key}", f"{sensor.channel} is in '{text}', campaign.toml says '{says}'",
                                 "correct the one that is wrong: records are not converted where they lie")


def _texts(value: object, count: int) -> list[str] | None:
    import json

    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str) and value.lstrip().startswith("["):
        try:
            value = json.loads(value)
        except ValueError:
            return None
    if isinstance(value, str):
        return [value] * count
    many = [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in np.ravel(np.asarray(value, object))]
    good = len(many) == count and all(isinstance(v, str) for v in many)
    return many if good else None


def texts_of(value: object) -> list[str]:
    """Lines of a text or of several, as files hold them; empty for anything else."""
    if isinstance(value, str):
        return [value.strip()]
    found = np.ravel(np.asarray(value, object)) if isinstance(value, list | tuple | np.ndarray) else ()
    return [v.strip() for v in found if isinstance(v, str)]


