"""The text of the three model files: as_built.toml with fitted dimensions, and the other two states made from it."""

from __future__ import annotations

import re
from collections.abc import Mapping

from probupdate.reporting.paper_tables import UPDATED

HEAD = {
    "design": (
        "Reference jacket turbine, design",
        "The reference jacket turbine as designed: conditions averaged over 25 years, so with scour, growth and\n"
        "# corrosion (initial values of sc, mg, corr); otherwise as_built.toml.",
    ),
    "as_built": ("Reference jacket turbine, as built", "The reference jacket turbine one year after installation."),
    "updated": (
        "Reference jacket turbine, updated",
        "The reference jacket turbine after updating: as_built.toml with the values of the paper's Table 5 as initial\n"
        "# ones. Each std is that of as_built.toml's prior in absolute terms, so that the file can be updated again.",
    ),
}


def _number(value: float) -> str:
    return f"{value:.10g}" if float(value) % 1 or abs(value) >= 1e7 else f"{value:.1f}"


def tube_text(tube: Mapping[str, float]) -> str:
    return f"{{ diameter_m = {_number(tube['diameter_m'])}, thickness_m = {_number(tube['thickness_m'])} }}"


def replaced(text: str, pattern: str, new: str, count: int = 1) -> str:
    """`text` with every match of `pattern` replaced; refuses another number of matches than `count`."""
    text, found = re.subn(pattern, lambda match: match.expand(new), text, flags=re.MULTILINE)
    if found != count:
        raise ValueError(f"{pattern} matched {found} times, not {count}")
    return text


def as_built_text(text: str, raw: Mapping) -> str:
    """as_built.toml with the dimensions of `raw` in place of its own; comments and all other numbers stay."""
    jacket, pile, tp = raw["jacket"], raw["pile"], raw["transition_piece"]
    for end in ("bottom", "top"):
        spacing = _number(jacket[end]["leg_spacing_m"])
        text = replaced(text, rf"^({end} = \{{ z_m = \S+ leg_spacing_m = )[\d.]+", rf"\g<1>{spacing}")
    for name, table in (("leg", jacket["leg"]), ("column", tp["column"]), ("strut", tp["strut"]), ("tie", tp["tie"])):
        text = replaced(text, rf"^{name} = \{{ diameter_m[^}}]*\}}", f"{name} = {tube_text(table)}")
    bays = "".join(
        f"[[jacket.bay]]\nbottom_m = {_number(bay['bottom_m'])}\ntop_m = {_number(bay['top_m'])}\n"
        f"brace = {tube_text(bay['brace'])}\n" for bay in jacket["bay"]
    )
    text = replaced(text, r"(?:^\[\[jacket\.bay\]\]\n(?:\w.*\n)+)+", bays)
    text = replaced(text, r"(^\[pile\]\n.*\ndiameter_m = ).*\nthickness_m = .*$",
                    rf"\g<1>{_number(pile['diameter_m'])}\nthickness_m = {_number(pile['thickness_m'])}")
    strength = raw["soil"]["undrained_shear_strength_pa"]
    text = replaced(text, r"(at_mudline = )[\d.]+(, gradient_per_m = )[\d.]+",
                    rf"\g<1>{_number(strength['at_mudline'])}\g<2>{_number(strength['gradient_per_m'])}")
    text = replaced(text, r"(^lumped_mass_kg = )[\d.]+", rf"\g<1>{_number(tp['lumped_mass_kg'])}")
    for station in raw["tower"]["station"]:
        text = replaced(text, rf"(^\[\[tower\.station\]\]\nz_m = {_number(station['z_m'])}\n).*\n.*\n",
                        rf"\g<1>diameter_m = {_number(station['diameter_m'])}\n"
                        rf"thickness_m = {_number(station['thickness_m'])}\n")
    inertia = next(body["inertia_kgm2"] for body in raw["rna"] if body["name"] == "hub")
    text = replaced(text, r'(^name = "hub"[^[]*\n(?:.*\n){2}inertia_kgm2 = ).*$',
                    rf"\g<1>[{', '.join(f'{x:.2e}'.replace('e+0', 'e') for x in inertia)}]")
    half = _number(jacket["top"]["leg_spacing_m"] / 2)
    text = replaced(text, r"^position_m = \[(-?)[1-9][\d.]*, (-?)[\d.]+, 13\.0\]",
                    rf"position_m = [\g<1>{half}, \g<2>{half}, 13.0]", count=12)
    groups = ", ".join(f"{name} = {n}" for name, n in raw["mesh"]["elements_per_member"].items())
    return replaced(text, r"^elements_per_member = .*$", f"elements_per_member = {{ {groups} }}")


def state_text(as_built: str, state: str, values: Mapping[str, float]) -> str:
    """The file of a state: as_built.toml with other initial values; a relative standard deviation becomes the absolute
    one."""
    name, head = HEAD[state]
    start = as_built.index("Lengths in m")
    text = f"# {head}\n# {as_built[start:]}"
    text = replaced(text, r'^name = "Reference .*"$', f'name = "{name}"')
    for parameter, value in values.items():
        block = re.search(rf'^name = "{parameter}"\n(?:(?!\[\[).*\n)*', text, flags=re.MULTILINE).group()
        before = float(re.search(r"^initial = (.*)$", block, flags=re.MULTILINE).group(1))
        new = replaced(block, r"^initial = .*$", f"initial = {value:.10g}" if value % 1 else f"initial = {value:.1f}")
        cov = re.search(r"^cov = (.*)$", block, flags=re.MULTILINE)
        if cov:
            new = replaced(new, r"^cov = .*$", f"std = {_number(float(cov.group(1)) * before)}")
        text = text.replace(block, new)
    return text


def table_5() -> dict[str, float]:
    return {name: row[3] for name, row in UPDATED.items()}
