"""fatigue.toml: sea and wind states, loads, details with their stress factors, S-N curves and uncertainties, all the
user's.

Nothing here has a hidden value but the target (annual reliability index 3.3); studies/lifetime/fatigue.toml is an
example.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import AfterValidator, Field, Strict, ValidationError
from pydantic_core import PydanticCustomError

from probupdate.errors import InputError
from probupdate.io.files import read_toml
from probupdate.lifetime.spectral import Curve
from probupdate.structure.schema import RANGES, Positive, Table, suggest

Real = Annotated[float, Strict()]


def bounded(least: float, most: float, what: str, *, or_zero: bool = False) -> Any:
    """A number within what physics, practice or its unit leave, or 0 where that leaves something out; `what` it is is
    the remedy where it is not."""
    def check(value: float) -> float:
        if not (least <= value <= most or (or_zero and value == 0)):
            raise PydanticCustomError("bounded", "is outside {range}, the plausible range", {
                "range": f"{least:g} to {most:g}{', and not 0' * or_zero}", "what": what})
        return value

    return AfterValidator(check)


def range_of_unit(key: str) -> Any:
    """Of a number of a model.toml, bounded as there."""
    return bounded(*RANGES[key])


# log10 of the cycles at a range of 100 MPa: those of DNV-RP-C203 lie between 4.5 (W3, free corrosion) and 8
LEAST_LOG_N, MOST_LOG_N = 4.0, 11.0
# log10 of the cycles where two slopes meet: 6 or 7 in DNV-RP-C203, 6.7 and 8 in EN 1993-1-9
LEAST_LOG_KNEE, MOST_LOG_KNEE = 5.0, 9.0
# height over length beyond which a single wave breaks in deep water (Michell); a sea state lies below 1/15
BREAKING = 0.142
# standard deviation of thrust over 0.5 rho A V^2: 0.02 to 0.3 of operating turbines, a tenth of it idling; of one in kN
# 1e-3 of these
LEAST_THRUST, MOST_THRUST = 5e-4, 3.0
# between cut-in and cut-out, wide; drag of standing blades edge-on and flat, and of what is between them
TURNING_MPS, MOST_IDLING = (1.5, 40.0), 0.4
# rotors' diameter over their height above the water; blades end above it, at 2
LEAST_ROTOR, MOST_ROTOR = 0.2, 3.0
METRES = "a length in metres"
Offset = Annotated[Real, bounded(-100.0, 100.0, METRES)]
STRESS_FACTOR = "a stress concentration factor"
SHARE = "a share, not per cent"
# annual, of a detail with large consequence of failure and moderate cost of safety; the default, and said
TARGET = 3.3


class Water(Table):
    inertia_coefficient: Annotated[Real, bounded(0.3, 4.0, "a C_M, of a cylinder 1 to 2")]
    drag_coefficient: Annotated[Real, bounded(0.1, 4.0, "a C_D, of a cylinder 0.6 to 1.2", or_zero=True)]


class Wind(Table):
    air_density_kgpm3: Annotated[Real, bounded(0.5, 2.0, "a density in kg/m3, of air about 1.2")]
    rotor_diameter_m: Annotated[Real, bounded(1.0, 400.0, METRES)]
    # Kaimal's L of the longitudinal component: 8.1 Lambda_1 = 340.2 m above 60 m (IEC 61400-1)
    integral_length_m: Annotated[Real, bounded(40.0, 1500.0, METRES)]


class Damping(Table):
    """Of critical, of every mode that modes.json does not state."""

    ratio: Annotated[Real, bounded(5e-4, 0.2, "a share of critical damping, not per cent")]


class Life(Table):
    age_years: Annotated[Real, bounded(0.01, 200.0, "an age in years", or_zero=True)]
    years: Annotated[int, Strict(), Field(ge=1, le=200)]
    reference_cycles: Annotated[Real, bounded(1e4, 1e10, "cycles of equivalent ranges, such as 1e7")]


class Direction(Table):
    """Where wind and waves go, counter-clockwise from the model's x axis."""

    heading_deg: Annotated[Real, bounded(-360.0, 360.0, "an angle in degrees")]
    share: Annotated[Real, bounded(1e-9, 1.0, SHARE)]


class State(Table):
    name: str
    share: Annotated[Real, bounded(1e-9, 1.0, SHARE)]
    operating: Annotated[bool, Strict()]
    hs_m: Annotated[Real, bounded(0.01, 25.0, "a significant wave height in metres; the highest measured is below 20")]
    tp_s: Annotated[Real, bounded(0.01, 30.0, "a peak period in seconds")]
    gamma: Annotated[Real, bounded(1.0, 7.0, "a peakedness, 1 to 7, of the North Sea 3.3")]
    wind_mps: Annotated[Real, bounded(0.5, 75.0, "a mean wind speed in m/s")]
    turbulence: Annotated[Real, bounded(0.02, 1.0, SHARE, or_zero=True)]
    # d thrust / d wind = rho A C_T V; of an idling turbine that of blades, nacelle and tower head
    thrust_coefficient: Annotated[Real, bounded(0.005, 2.0, "a coefficient, near 0.8 below rated wind", or_zero=True)]
    # a CSV of frequency_hz, n2phz that takes the place of thrust from turbulence
    thrust_spectrum: str | None = None


class Law(Table):
    log10_a1: Positive
    m1: Annotated[Real, bounded(1.0, 20.0, "the slope of an S-N curve, 3 to 5 of welds")]
    log10_a2: Positive
    m2: Annotated[Real, bounded(1.0, 20.0, "the slope of an S-N curve, 3 to 5 of welds")]
    # S times (t / t_ref)^k for walls above t_ref
    reference_thickness_m: Annotated[Real, bounded(0.005, 0.1, "a wall in metres, such as 0.025")]
    thickness_exponent: Annotated[Real, bounded(0.03, 1.0, "an exponent, 0 to 0.3 in standards", or_zero=True)]


class Factors(Table):
    axial_crown: Annotated[Real, bounded(0.2, 40.0, STRESS_FACTOR)]
    axial_saddle: Annotated[Real, bounded(0.2, 40.0, STRESS_FACTOR)]
    in_plane: Annotated[Real, bounded(0.2, 40.0, STRESS_FACTOR)]
    out_of_plane: Annotated[Real, bounded(0.2, 40.0, STRESS_FACTOR)]


class Efthymiou(Table):
    """Factors of both sides by Efthymiou's equations (`lifetime.efthymiou`). How a joint carries its load is the user's
    judgement: `kind`; so are the chord's length between its supports, the fixity of its ends (0.5 fixed, 1 pinned), the
    gap between two braces of a K, and the least factor (DNV-RP-C203 asks for 1.5 where nothing better is known)."""

    kind: Literal["T/Y", "X", "K"]
    chord_length_m: Annotated[Real, bounded(0.1, 300.0, METRES)]
    chord_fixity: Annotated[Real, Field(ge=0.5, le=1.0)]
    gap_m: Annotated[Real, bounded(1e-3, 10.0, METRES, or_zero=True)] | None = None
    least: Annotated[Real, bounded(0.2, 40.0, STRESS_FACTOR)]


class Sides(Table):
    """Stress factors of chord and brace side, or how to take them."""

    chord: Factors | None = None
    brace: Factors | None = None
    efthymiou: Efthymiou | None = None
    curve: str


class Joint(Sides):
    """Brace ends of a model.toml's turbine at legs or at crossings; bay, face and leg narrow them."""

    at: Literal["leg", "crossing"]
    bay: tuple[Annotated[int, Strict(), Field(ge=1)], ...] = ()
    end: Literal["all", "lower", "upper"] = "all"
    leg: tuple[str, ...] = ()


class MemberEnd(Sides):
    """Ends of a SubDyn model's members: those of group `braces` at members of group `chords` (the same group: where two
    cross); `joints` narrows them."""

    braces: str
    chords: str
    joints: tuple[Annotated[int, Strict(), Field(ge=1)], ...] = ()


class Site(Table):
    """What a SubDyn file does not say: the water, and where thrust acts. growth_m: marine growth, on the diameter that
    waves see; hub_joint: None for the top of the model's [tower]."""

    water_density_kgpm3: Annotated[Real, range_of_unit("site.water_density_kgpm3")]
    gravity_mps2: Annotated[Real, range_of_unit("site.gravity_mps2")]
    mudline_m: Annotated[Real, bounded(-1000.0, 1000.0, METRES)]
    water_level_m: Annotated[Real, bounded(-1000.0, 1000.0, METRES)]
    growth_m: Annotated[Real, bounded(1e-3, 1.0, "a thickness in metres, of marine growth 0.05 to 0.2", or_zero=True)]
    hub_joint: Annotated[int, Strict(), Field(ge=1)] | None = None
    hub_offset_m: tuple[Offset, Offset, Offset]


class Girth(Table):
    """A weld round a member at a level, nominal stress times one factor."""

    part: str
    z_m: Annotated[Real, bounded(-1000.0, 1000.0, METRES)]
    factor: Annotated[Real, bounded(0.5, 8.0, "a factor on nominal stress, 1 to 3 of girth welds")]
    curve: str


class Lognormal(Table):
    median: Annotated[Real, bounded(0.2, 5.0, "a factor near 1, not per cent")]
    cov: Annotated[Real, bounded(5e-3, 1.0, SHARE, or_zero=True)]


class Uncertainty(Table):
    x_load: Lognormal
    x_scf: Lognormal
    miner: Lognormal
    log10_a_std: Annotated[Real, bounded(0.01, 1.0, "a standard deviation of log10 N, 0.2 in standards", or_zero=True)]


class Inspection(Table):
    """An inspection that found no crack: at that age Miner's sum was below `detectable_share` of what it is at
    failure, where a crack would have been seen."""

    age_years: Annotated[Real, bounded(0.01, 200.0, "an age in years")]
    detectable_share: Annotated[Real, bounded(1e-3, 1.0, SHARE)]


class Target(Table):
    annual_index: Annotated[Real, bounded(1.0, 8.0, "an index, not a probability: 3.3 is 5e-4 a year")] = TARGET


class Conditions(Table):
    """A fatigue.toml, checked. Lengths in m, stresses in MPa, angles in degrees, shares add up to 1 over a year."""

    format: Literal[1]
    water: Water
    wind: Wind
    damping: Damping
    life: Life
    direction: Annotated[tuple[Direction, ...], Field(min_length=1)]
    state: Annotated[tuple[State, ...], Field(min_length=1)]
    curve: dict[str, Law]
    joint: tuple[Joint, ...] = ()
    member_end: tuple[MemberEnd, ...] = ()
    girth: tuple[Girth, ...] = ()
    site: Site | None = None
    uncertainty: Uncertainty
    target: Target = Target()
    inspection: Inspection | None = None

    def law(self, name: str) -> Curve:
        own = self.curve[name]
        return Curve(log10_a1=own.log10_a1, m1=own.m1, log10_a2=own.log10_a2, m2=own.m2)


def read_conditions(path: str | Path) -> Conditions:
    """fatigue.toml, checked; raises InputError with the file, the first wrong key and what to do."""
    path = Path(path)
    try:
        conditions = Conditions.model_validate(read_toml(path))
    except ValidationError as error:
        # a key that is misspelt is missing too
        first = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
        key = "".join(f"[{s + 1}]" if isinstance(s, int) else f".{s}" for s in first["loc"]).removeprefix(".")
        wanted = first["msg"].lower().replace("input should", "it must").replace("a valid boolean", "true or false")
        problem, remedy = {
            "missing": ("is missing", "add it; the file that `probupdate template` writes has every key"),
            "extra_forbidden": ("is not a key of this file",
                                suggest(str(first["loc"][-1]), _table_of(first["loc"]).model_fields)),
            "bounded": (f"{first['input']!r} {first['msg']}", f"give {first.get('ctx', {}).get('what')}"),
        }.get(first["type"], (f"{first['input']!r} is wrong: {wanted}", "correct it"))
        raise InputError(f"{path}: {key}", problem, remedy) from None
    for key, problem, remedy in _mistakes(conditions, path):
        raise InputError(f"{path}: {key}", problem, remedy)
    return conditions


def _table_of(place: tuple) -> type[Table]:
    """The table that a key lies in."""
    table: type[Table] = Conditions
    for part in place[:-1]:
        if isinstance(part, int) or part not in table.model_fields:
            continue
        outer = table.model_fields[part].annotation
        inner = [t for t in (outer, *get_args(outer), *(a for t in get_args(outer) for a in get_args(t)))
                 if isinstance(t, type) and issubclass(t, Table)]
        table = inner[0] if inner else table
    return table


def _mistakes(c: Conditions, path: Path) -> Iterator[tuple[str, str, str]]:
    for key, items in (("direction", c.direction), ("state", c.state)):
        total = sum(item.share for item in items)
        if abs(total - 1) > 1e-6:
            yield f"{key}.share", f"they add up to {total:g}, not 1", f"give every {key} its share of a year"
    yield from _check_life_and_states(c)
    if not c.joint and not c.member_end and not c.girth:
        yield (
            "joint",
            "there is no [[joint]], no [[member_end]] and no [[girth]]",
            "name at least one detail with its stress factors",
        )
    if c.site is not None and c.site.mudline_m >= c.site.water_level_m:
        yield "site.mudline_m", f"{c.site.mudline_m:g} is not below the water level", "give heights in the model's z"
    for kind, items in (("joint", c.joint), ("member_end", c.member_end), ("girth", c.girth)):
        for k, item in enumerate(items):
            if item.curve not in c.curve:
                yield (
                    f"{kind}[{k + 1}].curve",
                    f"'{item.curve}' is not a [curve] of the file",
                    suggest(item.curve, c.curve),
                )
            if not isinstance(item, Girth):
                yield from _factor_mistakes(f"{kind}[{k + 1}]", item)
    yield from _check_curves(c)
    for k, state in enumerate(c.state):
        if state.thrust_spectrum is not None and not _is_file_below(path, state.thrust_spectrum):
            yield (
                f"state[{k + 1}].thrust_spectrum",
                f"'{state.thrust_spectrum}' is not a file beside this one",
                "put it there",
            )


def _check_life_and_states(c: Conditions) -> Iterator[tuple[str, str, str]]:
    if c.life.age_years > c.life.years:
        yield ("life.age_years", f"{c.life.age_years:g} is above years = {c.life.years}",
               "let years reach beyond the age")
    if c.inspection is not None and c.inspection.age_years > c.life.age_years:
        yield ("inspection.age_years", f"{c.inspection.age_years:g} is above the age",
               "give the age when it was inspected")
    names = [s.name.strip().casefold() for s in c.state]
    for k, name in enumerate(names):
        if name in names[:k]:
            yield (f"state[{k + 1}].name", f"'{c.state[k].name}' is that of state[{names.index(name) + 1}] too",
                   "tell them apart")
    for k, s in enumerate(c.state):
        if s.operating and not TURNING_MPS[0] <= s.wind_mps <= TURNING_MPS[1]:
            yield (f"state[{k + 1}].wind_mps", "{:g} is outside {:g} to {:g}, in which turbines operate".format(
                s.wind_mps, *TURNING_MPS), "give a mean wind speed in m/s, or operating = false")
        if not s.operating and s.thrust_coefficient > MOST_IDLING:
            yield (f"state[{k + 1}].thrust_coefficient", f"{s.thrust_coefficient:g} is above {MOST_IDLING:g}, and the "
                   "rotor does not turn", "give that of blades, nacelle and tower head on the rotor's area, near 0.05")
        length = 9.81 * s.tp_s**2 / (2 * np.pi)
        if s.hs_m > BREAKING * length:
            yield (f"state[{k + 1}].tp_s", f"waves of {s.hs_m:g} m break at a peak period of {s.tp_s:g} s, at which "
                   f"they are {length:.2g} m long", "give the peak period in seconds, not the peak frequency")
    for k, d in enumerate(c.direction):
        same = [i for i, e in enumerate(c.direction[:k]) if (d.heading_deg - e.heading_deg) % 360 == 0]
        if same:
            yield (f"direction[{k + 1}].heading_deg",
                   f"{d.heading_deg:g} is the heading of direction[{same[0] + 1}] too",
                   "add their shares up in one table")


def _check_curves(c: Conditions) -> Iterator[tuple[str, str, str]]:
    for name, own in c.curve.items():
        if own.m2 < own.m1:
            yield (
                f"curve.{name}.m2",
                f"{own.m2} is below m1 = {own.m1}",
                "swap the slopes: the second is of small ranges",
            )
    for name, own in c.curve.items():
        for slope in (1, 2):
            log_n = getattr(own, f"log10_a{slope}") - 2 * getattr(own, f"m{slope}")
            if not LEAST_LOG_N < log_n < MOST_LOG_N:
                yield (f"curve.{name}.log10_a{slope}", f"gives 10^{log_n:.3g} cycles at a range of 100 MPa",
                       "give the curve of ranges in MPa (of one in Pa take 6 m off, to one in ksi add 0.84 m)")
        if own.m1 != own.m2:
            log_range = (own.log10_a2 - own.log10_a1) / (own.m2 - own.m1)
            knee = own.log10_a1 - own.m1 * log_range
            if not LEAST_LOG_KNEE < knee < MOST_LOG_KNEE:
                yield (f"curve.{name}.log10_a2", f"the slopes meet at 10^{knee:.3g} cycles, a range of "
                       f"{10**log_range:.3g} MPa",
                       "take both slopes of one curve; they meet at 10^6 to 10^8 in standards")


def _factor_mistakes(where: str, item: Sides) -> Iterator[tuple[str, str, str]]:
    """Of a detail whose stress factors are stated, or are Efthymiou's."""
    stated = item.chord is not None or item.brace is not None
    if stated == (item.efthymiou is not None):
        problem = "has stress factors and asks for Efthymiou's" if stated else "has stress factors of neither side"
        yield where, problem, "give chord, brace or both, or efthymiou"
    if item.efthymiou is not None and (item.efthymiou.kind == "K") == (item.efthymiou.gap_m is None):
        problem = "a K joint has a gap" if item.efthymiou.kind == "K" else "only a K joint has a gap"
        yield f"{where}.efthymiou.gap_m", problem, "state it for K, and for K alone"


def _is_file_below(path: Path, name: str) -> bool:
    folder = path.resolve().parent
    file = (folder / name).resolve()
    return file.is_relative_to(folder) and file.is_file()


def thrust_spectra(c: Conditions, path: Path) -> Mapping[str, tuple[np.ndarray, np.ndarray]]:
    """State's name -> frequency_hz (n,), one-sided density in N^2/Hz (n,) of the spectra given as files."""
    from probupdate.lifetime.tables import read_table

    found = {}
    for state in c.state:
        if state.thrust_spectrum is None:
            continue
        file = Path(path).resolve().parent / state.thrust_spectrum
        table = read_table(file)
        missing = {"frequency_hz", "n2phz"} - set(table)
        if missing:
            raise InputError(f"{file}, {sorted(missing)[0]}", "this column is missing", "give frequency_hz, n2phz")
        f, s = (np.array([np.nan if v is None else v for v in table[key]], float) for key in ("frequency_hz", "n2phz"))
        if len(f) < 2 or not np.all(np.diff(f) > 0) or not np.all(s >= 0):
            raise InputError(str(file), "its frequencies do not rise, or a density is negative or missing",
                             "correct it")
        mean = 0.5 * c.wind.air_density_kgpm3 * np.pi / 4 * c.wind.rotor_diameter_m**2 * state.wind_mps**2
        std = float(np.sqrt(np.trapezoid(s, f)))
        if not LEAST_THRUST < std / mean < MOST_THRUST:
            raise InputError(f"{file}, n2phz", f"gives a thrust that varies by {std:.3g} N (standard deviation), where "
                             f"the wind's pressure on the rotor is {mean:.3g} N", "give N^2/Hz over Hz, one-sided")
        found[state.name] = (f, s)
    return found


def refuse_other_rotor(c: Conditions, height_m: float, where: str) -> None:
    """Raises InputError where a rotor cannot be that of a structure of this height above the water."""
    ratio = c.wind.rotor_diameter_m / height_m
    if not LEAST_ROTOR <= ratio <= MOST_ROTOR:
        raise InputError(f"{where}: wind.rotor_diameter_m", f"{c.wind.rotor_diameter_m:g} is {ratio:.2g} times the "
                         f"structure's height above the water, {height_m:.3g} m; {LEAST_ROTOR:g} to {MOST_ROTOR:g} is "
                         "plausible", "give the rotor's diameter in metres")


def line_densities(frequency_hz: np.ndarray, at_hz: np.ndarray, density: np.ndarray) -> np.ndarray:
    """(n,) on frequency_hz (n,) of a density stated at at_hz, straight between and zero outside: means weighted by the
    lines' triangles, so that trapezoids have its variance, also that of a peak between two lines."""
    f = np.asarray(frequency_hz, float)
    ends = np.unique(np.concatenate([f, at_hz]))
    ends = ends[(ends >= f[0]) & (ends <= f[-1])]
    # Simpson's rule is exact on pieces where both are straight
    x = np.array([ends[:-1], 0.5 * (ends[:-1] + ends[1:]), ends[1:]])
    inside = (x[1] > at_hz[0]) & (x[1] < at_hz[-1])
    line = np.searchsorted(f, x[1]) - 1
    later = (x - f[line]) / np.diff(f)[line]
    piece = np.array([[1.0], [4.0], [1.0]]) / 6 * np.diff(ends) * inside * np.interp(x, at_hz, density)
    shares = (1 - later, later)
    total = sum(np.bincount(line + k, np.sum(piece * share, axis=0), len(f)) for k, share in enumerate(shares))
    return total / np.convolve(np.diff(f), [0.5, 0.5])


def jonswap(frequency_hz: np.ndarray, hs_m: float, tp_s: float, gamma: float) -> np.ndarray:
    """(n,) m^2/Hz, one-sided, of surface elevation: DNV-RP-C205, 3.5.5, scaled so that its own integral over 0 to
    infinity is hs_m^2 / 16 (A_gamma = 1 - 0.287 ln gamma)."""
    f, fp = np.asarray(frequency_hz, float), 1 / tp_s
    width = np.where(f <= fp, 0.07, 0.09)
    peak = gamma ** np.exp(-0.5 * ((f - fp) / (width * fp)) ** 2)
    return (1 - 0.287 * np.log(gamma)) * 5 / 16 * hs_m**2 * fp**4 / f**5 * np.exp(-1.25 * (fp / f) ** 4) * peak


def kaimal(frequency_hz: np.ndarray, wind_mps: float, turbulence: float, length_m: float) -> np.ndarray:
    """(n,) (m/s)^2/Hz, one-sided, of longitudinal turbulence: IEC 61400-1; std turbulence * wind_mps."""
    x = length_m / wind_mps
    return (turbulence * wind_mps) ** 2 * 4 * x / (1 + 6 * np.asarray(frequency_hz, float) * x) ** (5 / 3)


def rotor_admittance(frequency_hz: np.ndarray, wind_mps: float, area_m2: float) -> np.ndarray:
    """(n,) chi: share of turbulence that acts on the whole rotor, Vickery's 1 / (1 + (2 f sqrt(A) / V)^(4/3))."""
    return 1 / (1 + (2 * np.asarray(frequency_hz, float) * np.sqrt(area_m2) / wind_mps) ** (4 / 3))


def wave_number(angular: np.ndarray, depth_m: float, gravity: float) -> np.ndarray:
    """(n,) k in 1/m of omega^2 = g k tanh(k d), by Newton's method to rounding."""
    w2 = np.asarray(angular, float) ** 2
    k = np.maximum(w2 / gravity, np.sqrt(w2 / (gravity * depth_m)))
    for _ in range(50):
        t = np.tanh(k * depth_m)
        step = (gravity * k * t - w2) / (gravity * (t + k * depth_m * (1 - t**2)))
        k = k - step
        if np.all(np.abs(step) <= 1e-13 * k):
            break
    return k
