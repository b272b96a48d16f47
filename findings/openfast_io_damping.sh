#!/usr/bin/env bash
# openfast_io 5.0.0, read_SubDyn and write_SubDyn: of the damping ratios of retained modes the first stands for all.
# Expected: "0.5 2.0 5.0  JDampings" with three modes, which SubDyn reads as one ratio a mode, comes back as three numbers.
# Seen: 0.5 is read and written; the new file damps every mode with 0.5 %. No warning. (With commas between the numbers
#   the writer raises.)
# Consequence: a deck that has gone through openfast_io, as in optimisation and control tool chains, has other damping of
#   the members' own modes than the one that was tuned: ten times less at the third here.
# probupdate: reads the list mode by mode. To check: compare the line of both files.
set -eu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check openfast_io==5.0.0 numpy==2.3.5
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cat > "$work/monopile.dat" <<'DECK'
----------- SubDyn MultiMember Support Structure Input File ------------
a monopile
-------------------------- SIMULATION CONTROL  ---------------------------------
False        Echo
"DEFAULT"    SDdeltaT
3            IntMethod
True         SttcSolve
-------------------- FEA and CRAIG-BAMPTON PARAMETERS---------------------------
3            FEMMod
4            NDiv
3            Nmodes
0.5 2.0 5.0  JDampings
0            GuyanDampMod
0.0, 0.0     RayleighDamp
6            GuyanDampSize
0 0 0 0 0 0
0 0 0 0 0 0
0 0 0 0 0 0
0 0 0 0 0 0
0 0 0 0 0 0
0 0 0 0 0 0
------- INITIAL RIGID-BODY POSITION -------
RBSurge RBSway RBHeave RBRoll RBPitch RBYaw
(m) (m) (m) (deg) (deg) (deg)
0 0 0 0 0 0
---- STRUCTURE JOINTS ---
2            NJoints
JointID JointXss JointYss JointZss JointType JointDirX JointDirY JointDirZ JointStiff
(-) (m) (m) (m) (-) (-) (-) (-) (Nm/rad)
1 0.0 0.0 -20.0 1 0 0 0 0
2 0.0 0.0 10.0 1 0 0 0 0
------------------- BASE REACTION JOINTS ---------------------
1            NReact
RJointID RctTDXss RctTDYss RctTDZss RctRDXss RctRDYss RctRDZss SSIfile
(-) (flag) (flag) (flag) (flag) (flag) (flag) (string)
1 1 1 1 1 1 1 ""
------- INTERFACE JOINTS ---------
1            NInterf
IJointID TPID ItfTDXss ItfTDYss ItfTDZss ItfRDXss ItfRDYss ItfRDZss
(-) (-) (flag) (flag) (flag) (flag) (flag) (flag)
2 1 1 1 1 1 1 1
----------------------------------- MEMBERS --------------------------------------
1            NMembers
MemberID MJointID1 MJointID2 MPropSetID1 MPropSetID2 MType MSpin/COSMID
(-) (-) (-) (-) (-) (-) (deg/-)
1 1 2 1 1 1c 0.0
------------------ CIRCULAR BEAM CROSS-SECTION PROPERTIES -----------------------------
1            NPropSetsCyl
PropSetID YoungE ShearG MatDens XsecD XsecT
(-) (N/m2) (N/m2) (kg/m3) (m) (m)
1 2.1e11 8.1e10 7850.0 6.0 0.06
------------------ RECTANGULAR BEAM CROSS-SECTION PROPERTIES -----------------------------
0            NPropSetsRec
PropSetID YoungE ShearG MatDens XsecSa XsecSb XsecT
(-) (N/m2) (N/m2) (kg/m3) (m) (m) (m)
----------------- ARBITRARY BEAM CROSS-SECTION PROPERTIES -----------------------------
0            NXPropSets
PropSetID YoungE ShearG MatDens XsecA XsecAsx XsecAsy XsecJxx XsecJyy XsecJ0 XsecJt
(-) (N/m2) (N/m2) (kg/m3) (m2) (m2) (m2) (m4) (m4) (m4) (m4)
-------------------------- CABLE PROPERTIES  -------------------------------------
0            NCablePropSets
PropSetID EA MatDens T0
(-) (N) (kg/m) (N)
----------------------- RIGID LINK PROPERTIES ------------------------------------
0            NRigidPropSets
PropSetID MatDens
(-) (kg/m)
----------------------- SPRING ELEMENT PROPERTIES ------------------------------------
0            NSpringPropSets
PropSetID k11
(-) (N/m)
---------------------- MEMBER COSINE MATRICES COSM(i,j) ------------------------
0            NCOSMs
COSMID COSM11 COSM12 COSM13 COSM21 COSM22 COSM23 COSM31 COSM32 COSM33
(-) (-) (-) (-) (-) (-) (-) (-) (-) (-)
------------------------ JOINT ADDITIONAL CONCENTRATED MASSES--------------------------
0            NCmass
CMJointID JMass JMXX JMYY JMZZ JMXY JMXZ JMYZ MCGX MCGY MCGZ
(-) (kg) (kg*m^2) (kg*m^2) (kg*m^2) (kg*m^2) (kg*m^2) (kg*m^2) (m) (m) (m)
---------------------------- OUTPUT: SUMMARY & OUTFILE ------------------------------
True         SumPrint
0            OutCBModes
0            OutFEMModes
False        OutCOSM
False        OutAll
1            OutSwtch
True         TabDelim
1            OutDec
"ES11.4e2"   OutFmt
"A11"        OutSFmt
------------------------- MEMBER OUTPUT LIST ------------------------------------------
0            NMOutputs
MemberID NOutCnt NodeCnt
(-) (-) (-)
------------------------- SDOutList ------
END of output channels
DECK
cat > "$work/run.py" <<'PYTHON'
from openfast_io.FAST_reader import InputReader_OpenFAST
from openfast_io.FAST_writer import InputWriter_OpenFAST

reader, writer = InputReader_OpenFAST(), InputWriter_OpenFAST()
reader.read_SubDyn("monopile.dat")
writer.fst_vt, writer.FAST_namingOut, writer.FAST_runDirectory = reader.fst_vt, "new", "."
writer.write_SubDyn()


def damping(path):
    with open(path) as file:
        line = next(row for row in file if "JDampings" in row)
    return [float(word) for word in line.split("JDampings")[0].split()]


before, after = damping("monopile.dat"), damping("new_SubDyn.dat")
print("modes", reader.fst_vt["SubDyn"]["Nmodes"], "damping before", before, "read", reader.fst_vt["SubDyn"]["JDampings"],
      "after", after, "%")
assert reader.fst_vt["SubDyn"]["Nmodes"] == 3 and before == [0.5, 2.0, 5.0]
assert reader.fst_vt["SubDyn"]["JDampings"] == 0.5 and after == [0.5]
PYTHON
cd "$work"
venv/bin/python run.py
