"""What of ElastoDyn's files a model of the support structure does not use, with what it would do there."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence

from probupdate.io.fortran_text import logical, number, strip_quotes, words

# name (numbers in brackets left out) -> the value that does nothing, what any other one would do
UNUSED = {
    "GenIner": (0.0, "the shaft is held: the generator's inertia times GBRatio squared is left out"),
    "HubIner_Teeter": (0.0, "inertia of a teetering hub: left out"),
    "UndSling": (0.0, "the rotor of two blades hangs that far from its teeter pin: taken as 0"),
    "PBrIner": (0.0, "inertia of a pitch bearing: left out"),
    "BlPIner": (0.0, "inertia of a blade about its pitch axis: left out"),
    "TeetMod": (0.0, "the rotor is taken as rigid on its shaft"),
    "FAStTunr": (1.0, "scales ElastoDyn's own tower modes; here the tower's stiffness is TwFAStif"),
    "SSStTunr": (1.0, "scales ElastoDyn's own tower modes; here the tower's stiffness is TwSSStif"),
    **dict.fromkeys(("PtfmSurge", "PtfmSway", "PtfmHeave"), (0.0, "the structure stands where its joints are")),
    **dict.fromkeys(("PtfmRoll", "PtfmPitch"), (0.0, "the structure stands as its joints do")),
    "PtfmYaw": (0.0, "the structure is not turned; NacYaw turns rotor and nacelle"),
}
# columns of older tower files, which the model takes from a thin tube or leaves out
UNUSED_COLUMNS = {
    "TwGJStif": "torsion is that of a tube of the stated material", "TwEAStif": "axial stiffness is that of a tube of "
    "the stated material", "TwFAIner": "rotary inertia is that of a tube", "TwSSIner": "rotary inertia is that of a "
    "tube", "TwFAcgOf": "the mass lies on the tower's axis", "TwSScgOf": "the mass lies on the tower's axis",
}
# what says how ElastoDyn computes, starts, damps or writes; of blades, that are rigid here, how they bend
_NAMES = """
    Echo Method DT Gravity FlapDOF1 FlapDOF2 EdgeDOF PitchDOF TeetDOF DrTrDOF GenDOF YawDOF TwFADOF1 TwFADOF2 TwSSDOF1
    TwSSDOF2 PtfmSgDOF PtfmSwDOF PtfmHvDOF PtfmRDOF PtfmPDOF PtfmYDOF OoPDefl IPDefl BlPitch TeetDefl Azimuth RotSpeed
    TTDspFA TTDspSS Delta3 AzimB1Up ShftGagL NcIMUxn NcIMUyn NcIMUzn PtfmRefxt PtfmRefyt PtfmRefzt BldNodes TeetDmpP
    TeetDmp TeetCDmp TeetSStP TeetHStP TeetSSSp TeetHSSp YawFrctMod M_CSmax M_FCSmax M_MCSmax M_CD M_FCD M_MCD sig_v
    sig_v2 OmgCut GBoxEff GBRatio DTTorSpr DTTorDmp FurlFile TwrNodes SumPrint OutFile OutFileFmt TabDelim OutFmt TStart
    DecFact NTwGages TwrGagNd NBlGages BldGagNd OutList BldNd_BladesOut BldNd_BlOutNd TwFADmp TwSSDmp TwFAM1Sh TwFAM2Sh
    TwSSM1Sh TwSSM2Sh CalcTMode BldFlDmp BldEdDmp FlStTunr AdjFlSt AdjEdSt BldFl1Sh BldFl2Sh BldEdgSh CalcBMode
"""
WITHOUT_EFFECT = frozenset(_NAMES.split())
# the number of a blade, or of a mode's coefficient
BLADE = re.compile(r"(\(\d+\)|(?<=^bldfile)\d)$")
# a line of a value, its name and, behind a hyphen, what it means
NAME = re.compile(r"[A-Za-z]\w*(\(\d+\))?$")


def unused_keys(lines: Sequence[str], where: str, used: Collection[str]) -> Iterator[str]:
    """A sentence for each value of a file that would change stiffness or mass and is not in `used` (lowered names as
    they stand in the file), and for each name that is not known at all."""
    passive = {name.lower() for name in WITHOUT_EFFECT}
    active = {name.lower(): entry for name, entry in UNUSED.items()}
    # lines of a third blade stand in files of two, too
    used = {BLADE.sub("", name) for name in used}
    said = set()
    for at, line in enumerate(lines, 1):
        found = words(line)
        for column in set(found) & set(UNUSED_COLUMNS):
            yield f"{where}, line {at}: column {column} is not used: {UNUSED_COLUMNS[column]}"
        if len(found) < 2 or not NAME.match(found[1]) or not _is_value(found[0]) or (
                found[2:] and not found[2].startswith("-")):
            continue
        name = BLADE.sub("", found[1].lower())
        if name in used or name in passive or name in said:
            continue
        said.add(name)
        if name not in active:
            yield f"{where}, line {at}: {found[1]} ({strip_quotes(found[0])}) is not known here and not used"
            continue
        neutral, effect = active[name]
        if number(found[0]) != neutral:
            yield f"{where}, line {at}: {found[1]} ({strip_quotes(found[0])}) is not used: {effect}"


def _is_value(word: str) -> bool:
    return number(word) is not None or logical(word) is not None or word[0] in "\"'" or word.lower() == "default"
