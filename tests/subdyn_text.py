"""SubDyn input files for tests, written by hand: small structures in every layout."""

from __future__ import annotations

HEAD = """----------- SubDyn input file -----------
{title}
--- SIMULATION CONTROL ---
False            Echo        - Echo input data
"DEFAULT"        SDdeltaT    - Local integration step
             3   IntMethod   - Integration method
True             SttcSolve   - Static equilibrium
--- FEA and CRAIG-BAMPTON PARAMETERS ---
             {fem}   FEMMod      - 1 or 3
             {div}   NDiv        - sub-elements
             0   Nmodes      - modes
             1   JDampings   - damping (%)
             0   GuyanDampMod - none
  0.000, 0.000   RayleighDamp - coefficients
             6   GuyanDampSize - size
"""
OUTPUT = """---- OUTPUT: SUMMARY & OUTFILE ----
True             SumPrint    - summary
0                OutCBModes  - modes
0                OutFEMModes - modes
False            OutCOSM     - cosines
False            OutAll      - all
             1   OutSwtch    - where
True             TabDelim    - tabs
             1   OutDec      - every
"ES11.4e2"       OutFmt      - format
"A11"            OutSFmt     - format
---- MEMBER OUTPUT LIST ----
             0   NMOutputs   - none
MemberID NOutCnt NodeCnt
(-) (-) (-)
---- SDOutList ----
"-ReactFXss, -ReactFYss" - a line nobody parses, with, commas
END of the file
and what stands behind it
"""
TABLES = {
    "circular": "CIRCULAR BEAM CROSS-SECTION PROPERTIES", "rectangular": "RECTANGULAR BEAM CROSS-SECTION PROPERTIES",
    "arbitrary": "ARBITRARY BEAM CROSS-SECTION PROPERTIES", "cable": "CABLE PROPERTIES",
    "rigid": "RIGID LINK PROPERTIES", "spring": "SPRING ELEMENT PROPERTIES", "cosine": "MEMBER COSINE MATRICES",
    "mass": "JOINT ADDITIONAL CONCENTRATED MASSES",
}
STEEL = "2.1e11 8.076923e10 7850"
# of a model.toml: groups of a frame of two legs on joints 1 to 4, and what is measured of it
FRAME_GROUPS = """[group.legs]
property_sets = [1]
[group.brace]
members = [3]
[group.soil]
reactions = [1]
[group.top]
masses = [4]
[group.deck]
joints = [3]
"""
FRAME_SENSORS = "".join(
    f'[[sensor]]\nchannel = "{channel}"\njoint = {joint}\ndirection = {direction}\n'
    for channel, joint, direction in (("A", 4, "[1.0, 0.0, 0.0]"), ("B", 4, "[0.0, 1.0, 0.0]"),
                                      ("C", 3, "[0.0, 1.0, 0.0]")))


def table(title: str, rows) -> str:
    rows = list(rows)
    return f"---- {title} ----\n   {len(rows)}   N - number of them\nnames of columns\n(-) (-)\n" + "".join(
        f"  {row}\n" for row in rows)


def subdyn(
    joints, members, reactions, *, interface=(), layout="v5", fem=1, div=1, title="a structure for tests", **sets
) -> str:
    """joints: 'x y z' or 'x y z type dx dy dz k'; members: 'joint joint set set type spin'; reactions: 'joint
    flags'."""
    text = HEAD.format(title=title, fem=fem, div=div) + "  0 0 0 0 0 0\n" * 6
    if layout == "v5":
        text += ("--- INITIAL RIGID-BODY POSITION ---\n"
                 "Surge Sway Heave Roll Pitch Yaw\n(m) (m)\n 0.0 0.0 0.0 0.0 0.0 0.0\n")
    full = [f"{k} {row}" if len(row.split()) > 3 else f"{k} {row} 1 0 0 0 0" for k, row in enumerate(joints, 1)]
    text += table("STRUCTURE JOINTS", full) + table("BASE REACTION JOINTS", reactions)
    piece = "1 " if layout == "v5" else ""
    text += table("INTERFACE JOINTS", [f"{j} {piece}1 1 1 1 1 1" for j in interface])
    text += table("MEMBERS", [f"{k} {row}" for k, row in enumerate(members, 1)])
    for kind, heading in TABLES.items():
        if kind == "rectangular" and layout == "v4.0":
            continue
        text += table(heading, sets.get(kind, ()))
    return text + OUTPUT
