"""What a controller would not drive, or would drive otherwise than planned, is refused by both readers with file and line.

Every change is made to a program of two passes as ocp.plan writes it; the product's reader (`trajectories.krl`) and the virtual
controller's own (`ocp.simulate.twin`) are asked apart. A change that both let pass stands in HARMLESS with the reason."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from ocp.simulate.twin.controller import drive
from ocp.simulate.twin.krl_text import read_program
from robots.errors import BadInput, Infeasible
from tests.support.krl_example import ROBOT, example
from trajectories.krl.checks import check_program
from trajectories.krl.dialect import KRL
from trajectories.krl.writer import program_files

MAIN, SUB, DATA = "BLADE_1.src", "BLADE_1_01.src", "BLADE_1_01.dat"
SECOND = "BLADE_1_02.src"
Files = dict[str, bytes]
Change = Callable[[Files], None]


def put(file: str, old: str, new: str, nth: int = 0) -> Change:
    """Replace the nth place where the pattern `old` stands."""

    def change(files: Files) -> None:
        text = files[file].decode("latin-1")
        found = list(re.finditer(old, text, re.MULTILINE))
        assert len(found) > nth, f"{old} does not stand in {file}"
        start, end = found[nth].span()
        files[file] = (text[:start] + found[nth].expand(new) + text[end:]).encode("latin-1")
        assert files[file] != text.encode("latin-1")

    return change


def both(*changes: Change) -> Change:
    def change(files: Files) -> None:
        for one in changes:
            one(files)

    return change


def cut(file: str, share: float) -> Change:
    def change(files: Files) -> None:
        files[file] = files[file][: int(share * len(files[file]))]

    return change


def without(file: str) -> Change:
    return lambda files: files.pop(file) and None


def longer(factor: float) -> Change:
    """The times of all blocks times a factor; the parts still sum to the end."""

    def times(block: re.Match[str]) -> str:
        parts = [round(factor * float(text), 5) for text in re.findall(r"PART=([\d.]+)", block[0])]
        new = iter([*parts, sum(parts)])
        return re.sub(r"(PART|END)=[\d.]+", lambda m: f"{m[1]}={next(new):.5f}", block[0])

    def change(files: Files) -> None:
        files[SUB] = re.sub(r"TIME_BLOCK START(.*\r\n)*?ENDSPLINE", times, files[SUB].decode()).encode()

    return change


def backwards(text: str) -> str:
    """The points of the second block from its last to its first."""
    block = re.findall(r"PTP_SPLINE\r\n(?:.*\r\n)*?ENDSPLINE\r\n", text)[1]
    points = re.findall(POINT, block, re.MULTILINE)
    return text.replace(block, re.sub(POINT, lambda _: points.pop(), block, flags=re.MULTILINE))


DETOUR = "PTP {A1 20,A2 -76,A3 104,A4 10,A5 -40,A6 20}"
POINT, PART, END = r"^  SPTP \{.*\}\r\n", r"^  TIME_BLOCK PART=[\d.]+\r\n", r"^  TIME_BLOCK END=[\d.]+"
MUTATIONS: dict[str, Change] = {
    # times
    "END three times shorter than the axes can": longer(1 / 6),
    "END alone shorter": put(SUB, END, "  TIME_BLOCK END=0.10000"),
    "END longer than the parts": put(SUB, r"^  TIME_BLOCK END=", "  TIME_BLOCK END=9"),
    "END of a thousand million seconds": both(put(SUB, END, "  TIME_BLOCK END=1000000000.0")),
    "a part of that length and its END": both(
        put(SUB, PART, "  TIME_BLOCK PART=1000000000.0\r\n"), put(SUB, END, "  TIME_BLOCK END=1000000000.0")
    ),
    "END negative": put(SUB, r"END=", "END=-"),
    "END nothing": put(SUB, END, "  TIME_BLOCK END=0.0"),
    "END with an exponent beyond numbers": put(SUB, END, "  TIME_BLOCK END=1E999"),
    "START missing": put(SUB, r"^  TIME_BLOCK START\r\n", ""),
    "START twice": put(SUB, r"^  TIME_BLOCK START\r\n", "  TIME_BLOCK START\r\n  TIME_BLOCK START\r\n"),
    "END missing": put(SUB, END + "\r\n", ""),
    "a part missing": put(SUB, PART, "", 3),
    "a part negative": put(SUB, r"PART=", "PART=-", 3),
    "a point missing": put(SUB, POINT, "", 5),
    "two points exchanged with their parts lost": put(SUB, f"({POINT})({PART})({POINT})", r"\3\2\1", 2),
    # where a block begins
    "first point 3 deg off": put(SUB, r"(PTP_SPLINE\r\n  SPTP \{A1 )(-?\d)", r"\g<1>9\2", 1),
    "axes 1 and 2 exchanged in a block's first point": put(
        SUB, r"(PTP_SPLINE\r\n  SPTP \{)A1 ([-\d.]+),A2 ([-\d.]+)", r"\1A1 \3,A2 \2", 1
    ),
    "a whole block missing": put(SUB, r"; engage\r\n(.*\r\n)*?ENDSPLINE\r\n", ""),
    "a detour by PTP": put(SUB, r"^; contact", DETOUR),
    "a detour by PTP and back": put(
        SUB,
        r"^; contact\r\n((?:.*\r\n)*?)(PTP_SPLINE\r\n  S(PTP \{.*\}))",
        r"\1PTP {A1 20,A2 -76,A3 104,A4 10,A5 -40,A6 20}\r\n\3\r\n\2",
    ),
    "lost decimal point": put(SUB, r"(SPTP \{A1 \d+)\.", r"\1", 4),
    "lost decimal point of the first motion": put(SUB, r"(^PTP \{A1 \d+)\.", r"\1"),
    "an axis beyond its limit": put(SUB, r"A2 [-\d.]+", "A2 40.00000", 8),
    # standing still, calling, branching
    "HALT inside a block": put(SUB, POINT, "  HALT\r\n", 6),
    "HALT between engage and contact": put(SUB, "^; contact", "HALT"),
    "WAIT between engage and contact": put(SUB, "^; contact", "WAIT SEC 5.0"),
    "WAIT FOR between engage and contact": put(SUB, "^; contact", r"WAIT FOR $IN[1]"),
    "WAIT FOR TRUE": put(SUB, "^; contact", "WAIT FOR TRUE"),
    "an interrupt that calls": put(SUB, r"IR_STOPM \( \)", "BLADE_1_02 ( )"),
    "another interrupt": put(SUB, "INTERRUPT ON 3", "INTERRUPT DECL 4 WHEN $IN[1]==TRUE DO BLADE_1_02 ( )\r\n    INTERRUPT ON 4"),
    "the interrupt on another signal": put(SUB, "STOPMESS", "IN[7]"),
    "a trigger": put(SUB, "^; contact", "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[1]=TRUE"),
    "an output": put(SUB, "^; contact", "$OUT[1]=TRUE"),
    "a loop": put(SUB, "^; contact", "LOOP"),
    "a jump": put(SUB, "^; contact", "GOTO HERE"),
    "RETURN in the middle": put(SUB, "^; contact", "RETURN"),
    "a relative motion": put(SUB, "^; contact", "PTP_REL {A1 5}"),
    "an asynchronous motion": put(SUB, "^; contact", "ASYPTP {E1 5}"),
    "a call of itself": put(SUB, "^; contact", "BLADE_1_01 ( )"),
    "programs that call each other": both(put(SUB, "^; contact", "BLADE_1_02 ( )"), put(SECOND, "^; contact", "BLADE_1_01 ( )")),
    "a call of what is not there": put(MAIN, r"BLADE_1_02 \( \)", "BLADE_1_07 ( )"),
    # load, frames, speeds
    "$LOAD lost": put(SUB, r"^\$LOAD=.*\r\n", ""),
    "$LOAD of nonsense": put(SUB, r"^\$LOAD=.*", r"$LOAD=HEAVY"),
    "$LOAD with a word in it": put(SUB, r"\{M 25.000", "{M HEAVY"),
    "$LOAD negative": put(SUB, r"\{M 25", "{M -25"),
    "$LOAD without inertia": put(SUB, r",J \{[^}]*\}", ""),
    "$TOOL lost": put(SUB, r"^\$TOOL=.*\r\n", ""),
    "$BASE lost": put(SUB, r"^\$BASE=.*\r\n", ""),
    "$TOOL incomplete": put(SUB, r"(^\$TOOL=\{X [\d.]+),Y [\d.]+", r"\1"),
    "$IPO_MODE of nonsense": put(SUB, "#TCP", "#TPC"),
    "$VEL_AXIS above 100": put(SUB, r"(\$VEL_AXIS\[3\]=)10\b", r"\g<1>101"),
    "$VEL_AXIS nothing": put(SUB, r"(\$VEL_AXIS\[3\]=)10\b", r"\g<1>0"),
    "$VEL_AXIS of a word": put(SUB, r"(\$VEL_AXIS\[3\]=)10\b", r"\g<1>FULL"),
    "$VEL_AXIS of a seventh axis": put(SUB, r"\$VEL_AXIS\[3\]", r"$VEL_AXIS[7]"),
    "$ACC_AXIS above 100": put(SUB, r"(\$ACC_AXIS\[3\]=)30\b", r"\g<1>300"),
    "$OV_PRO": put(SUB, "^; contact", r"$OV_PRO=100"),
    "$ACT_BASE": put(SUB, "^; contact", r"$ACT_BASE=4"),
    "a speed lost": put(SUB, r"^\$VEL_AXIS\[3\]=10\r\n", ""),
    "an acceleration lost": put(SUB, r"^\$ACC_AXIS\[6\]=30\r\n", ""),
    "speeds before the first motion lost": put(SUB, r"^(\$VEL_AXIS\[\d\]=10\r\n)+", ""),
    "the first motion fast": put(SUB, r"(\$VEL_AXIS\[1\]=)10\b", r"\g<1>100"),
    "speeds before a timed block lost": put(SUB, r"^(\$VEL_AXIS\[\d\]=100\r\n)+", ""),
    "a timed block bounded by one axis": put(SUB, r"(\$ACC_AXIS\[2\]=)100\b", r"\g<1>60"),
    "$IPO_MODE of one block": put(SUB, "#TCP", "#BASE", 1),
    "$TOOL of one block": put(SUB, r"(^\$TOOL=\{X )", r"\g<1>1", 1),
    "$BASE of one file": lambda files: files.update({SUB: files[SUB].replace(b"$BASE={X 1550", b"$BASE={X 1551")}),
    "$LOAD of one block": put(SUB, r"(J \{X )", r"\g<1>9", 1),
    "$LOAD turned": put(SUB, r"A 0\.0,B 0\.0", "A 0.0,B 90.0"),
    "start-up again on the way": put(SUB, "^; contact", "BAS (#INITMOV,0 )"),
    "a call with an argument": put(MAIN, r"BLADE_1_01 \( \)", "BLADE_1_01 (1)"),
    "the interrupt not switched on": put(SUB, r"^ *INTERRUPT ON 3\r\n", ""),
    "the interrupt not declared": put(SUB, r"^ *GLOBAL INTERRUPT.*\r\n", ""),
    # files
    ".dat missing": without(DATA),
    ".dat cut": cut(DATA, 0.6),
    ".dat empty": cut(DATA, 0.0),
    ".dat of another program": put(DATA, "DEFDAT BLADE_1_01", "DEFDAT BLADE_1_02"),
    ".dat of the main program missing": without("BLADE_1.dat"),
    ".src cut": cut(SUB, 0.6),
    ".src cut inside a number": put(SUB, r"(?s)(A4 [-\d]+)\.(?!.*A4).*", r"\1"),
    ".src empty": cut(SUB, 0.0),
    ".src missing": without(SECOND),
    ".src of another program": lambda files: files.update({SUB: files[SECOND]}),
    "END of the file missing": put(SUB, r"^END\r\n\Z", ""),
    "no &ACCESS": put(SUB, r"^&ACCESS.*\r\n", ""),
    "DEF for all": put(SUB, "^DEF ", "GLOBAL DEF "),
    "text after END": put(SUB, r"^END\r\n\Z", "END\r\nPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\r\n"),
    "a second DEF": put(SUB, "^; contact", "END\r\nDEF OTHER( )"),
    # characters
    "NUL": put(SUB, "^; contact", "; con\0tact"),
    "LF alone": put(SUB, "; contact\r\n", "; contact\n"),
    "CR alone before a statement": put(SUB, "; contact", "; contact\rHALT"),
    "LF alone before a statement": put(SUB, "; contact", "; contact\n$OV_PRO=100"),
    "form feed in a comment": put(SUB, "; contact", "; contact\fPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"),
    "vertical tab in a comment": put(SUB, "; contact", "; contact\vPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"),
    "file separator in a comment": put(SUB, "; contact", "; contact\x1cPTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"),
    "next line (latin-1) in a comment": put(SUB, "; contact", "; contact\x85PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"),
    "a tabulator": put(SUB, "^  SPTP", "\tSPTP", 4),
    "no ASCII": put(SUB, "; contact", "; Schaufel \xc4"),
    "a byte order mark": put(SUB, r"\A", "\xef\xbb\xbf"),
    "decimal comma": put(SUB, r"(A3 \d+)\.", r"\1,", 4),
    "an exponent": put(SUB, r"A3 [\d.]+", "A3 1.0E999", 4),
    "two decimal points": put(SUB, r"(A3 \d+)\.", r"\1..", 4),
    "a number of 400 digits": put(SUB, r"A3 [\d.]+", "A3 " + "9" * 400, 4),
    "not a number": put(SUB, r"A3 [\d.]+", "A3 NAN", 4),
    "a brace lost": put(SUB, r"\}\r\n", "\r\n", 9),
    "an axis lost": put(SUB, r",A6 [-\d.]+", "", 5),
    "an axis twice": put(SUB, r"A6 ", "A5 ", 5),
    "an axis too many": put(SUB, r"(A6 [-\d.]+)\}", r"\1,E1 10.0}", 5),
    "status of axes": put(SUB, r"(A6 [-\d.]+)\}", r"\1,S 2,T 2}", 5),
    # blocks
    "a point approximated": put(SUB, r"(^  SPTP \{.*\})", r"\1 C_SPL", 3),
    "a block's end approximated": put(SUB, "^ENDSPLINE", "ENDSPLINE C_SPL"),
    "the first motion approximated": put(SUB, r"(^PTP \{.*\})", r"\1 C_PTP"),
    "a block with a speed of its own": put(SUB, "^PTP_SPLINE", r"PTP_SPLINE WITH $VEL_AXIS[1]=5"),
    "a block driven backwards": lambda files: files.update({SUB: backwards(files[SUB].decode()).encode()}),
    "ENDSPLINE lost": put(SUB, r"^ENDSPLINE\r\n", ""),
    "ENDSPLINE twice": put(SUB, r"^ENDSPLINE\r\n", "ENDSPLINE\r\nENDSPLINE\r\n"),
    "SPLINE for PTP_SPLINE": put(SUB, "^PTP_SPLINE", "SPLINE"),
    "a block in a block": put(SUB, POINT, "PTP_SPLINE\r\n", 4),
    "a speed in a block": put(SUB, POINT, "  $VEL.CP=0.1\r\n", 4),
    "first motion missing": put(SUB, r"^PTP \{.*\r\n", ""),
    "first motion to a pose": put(SUB, r"^PTP \{.*\}", "PTP {X 1500,Y 0,Z 900,A 0,B 90,C 0,S 2,T 2}"),
    "no start-up": put(SUB, r"^ *BAS \(.*\r\n", ""),
    "start-up of another kind": put(SUB, "#INITMOV,0", "#TOOL,3"),
    "nothing called": both(put(MAIN, r"BLADE_1_01 \( \)\r\n", ""), put(MAIN, r"BLADE_1_02 \( \)\r\n", "")),
}
SPL = r"^  SPL \{.*\}\r\n"  # the first block of poses leads in, the second grinds


def lost(file: str, pattern: str) -> Change:
    """Every place where the pattern stands taken out."""

    def change(files: Files) -> None:
        text = re.sub(pattern, "", files[file].decode(), flags=re.MULTILINE).encode()
        assert text != files[file]
        files[file] = text

    return change


def untimed(text: str) -> str:
    """Blocks of poses without their times, as programs were written before."""
    return re.sub(
        r"^SPLINE\r\n(?:.*\r\n)*?ENDSPLINE", lambda m: re.sub(r"  TIME_BLOCK.*\r\n", "", m[0]), text, flags=re.MULTILINE
    )


PATH = ("$VEL.CP", "$ACC.CP", "$VEL.ORI1", "$VEL.ORI2", "$ACC.ORI1", "$ACC.ORI2")
AXIAL = "SPTP {A1 20,A2 -76,A3 104,A4 10,A5 -40,A6 20}"
ON_POSES: dict[str, Change] = {
    # times
    "END three times shorter than the axes can": longer(1 / 6),
    "END alone shorter": put(SUB, END, "  TIME_BLOCK END=0.10000", 2),
    "END longer than the parts": put(SUB, r"^  TIME_BLOCK END=", "  TIME_BLOCK END=9", 2),
    "END nothing": put(SUB, END, "  TIME_BLOCK END=0.0", 2),
    "START missing": put(SUB, r"^  TIME_BLOCK START\r\n", "", 2),
    "START twice": put(SUB, r"^  TIME_BLOCK START\r\n", "  TIME_BLOCK START\r\n  TIME_BLOCK START\r\n", 2),
    "END missing": put(SUB, END + "\r\n", "", 2),
    "a part missing": put(SUB, f"({SPL})({PART})", r"\1", 30),
    "a part negative": put(SUB, f"({SPL}  TIME_BLOCK PART=)", r"\1-", 30),
    "a point missing": put(SUB, SPL, "", 30),
    "two points exchanged with their parts lost": put(SUB, f"({SPL})({PART})({SPL})", r"\3\2\1", 9),
    "no times at all": lambda files: files.update({SUB: untimed(files[SUB].decode()).encode()}),
    # where a block begins, and what its points are
    "first pose far off": put(SUB, r"(^SPLINE\r\n  SPL \{X -?)(\d)", r"\g<1>9\2", 1),
    "first pose 10 mm off": put(SUB, r"(^SPLINE\r\n  SPL \{X -?)(\d)", r"\g<1>1\2", 1),
    "a whole block missing": put(SUB, r"; engage\r\n(.*\r\n)*?ENDSPLINE\r\n", ""),
    "the block after begins elsewhere": put(SUB, r"(^PTP_SPLINE\r\n  SPTP \{A1 )(-?\d)", r"\g<1>9\2", 0),
    "a lost decimal point": put(SUB, r"(^  SPL \{X -?\d+)\.", r"\1", 12),
    "a pose out of reach": put(SUB, r"(^  SPL \{X )-?[\d.]+", r"\g<1>9000.0000", 12),
    "SPTP among SPL": put(SUB, "^  SPL ", "  SPTP ", 12),
    "axes among poses": put(SUB, r"^  SPL \{.*\}", "  " + AXIAL, 12),
    "axes called SPL": put(SUB, r"^  SPL \{.*\}", "  SPL" + AXIAL[4:], 12),
    "SPL among SPTP": put(SUB, "^  SPTP ", "  SPL ", 5),
    "SLIN among SPL": put(SUB, "^  SPL ", "  SLIN ", 12),
    "PTP_SPLINE for SPLINE": put(SUB, "^SPLINE", "PTP_SPLINE", 1),
    "SPLINE for PTP_SPLINE": put(SUB, "^PTP_SPLINE", "SPLINE"),
    "an angle lost": put(SUB, r"(^  SPL \{.*),C [-\d.]+", r"\1", 12),
    "an axis in a pose": put(SUB, r"(^  SPL \{X)", r"  SPL {A1 3.0,X", 12),
    "a pose approximated": put(SUB, r"(^  SPL \{.*\})", r"\1 C_SPL", 12),
    "HALT inside a block": put(SUB, SPL, "  HALT\r\n", 12),
    "a speed in a block": put(SUB, SPL, "  $VEL.CP=0.1\r\n", 12),
    "a detour by PTP": put(SUB, r"^; contact", DETOUR),
    "a detour by LIN": put(SUB, r"^; contact", "LIN {X 10,Y 200,Z -600,A 90,B 0,C 100,S 6,T 18}"),
    # what bounds the path
    **{f"{name} not set": lost(SUB, rf"^{re.escape(name)}=.*\r\n") for name in PATH},
    **{f"{name} below the block's": put(SUB, rf"({re.escape(name)}=)[\d.]+", r"\g<1>0.005", 1) for name in PATH},
    "$VEL.CP of a plane": put(SUB, r"(\$VEL\.CP=)", r"\g<1>200", 1),
    "axes held back": put(SUB, r"(\$ACC_AXIS\[2\]=)100\b", r"\g<1>60"),
    "$IPO_MODE of one block": put(SUB, "#TCP", "#BASE", 2),
    "$BASE of one block": put(SUB, r"(^\$BASE=\{X )", r"\g<1>1", 2),
}
ON_LINES: dict[str, Change] = {
    "a wait in a chain": put(SUB, r"(C_VEL\r\n)", r"\1WAIT SEC 1.0\r\n", 5),
    "frames in a chain": put(SUB, r"(^\$TOOL=.*\r\n)((?:.*\r\n)*?LIN.*C_VEL\r\n)", r"\1\2\1", 2),
    "the advance in a chain": put(SUB, r"(C_VEL\r\n)", r"\1$ADVANCE=1\r\n", 5),
    "an acceleration in a chain": put(SUB, r"(C_VEL\r\n)", r"\1$ACC.CP=1.0\r\n", 5),
    "a PTP in a chain": put(SUB, r"(C_VEL\r\n)", rf"\1{DETOUR}\r\n", 5),
    "a chain that blends into another kind": put(SUB, r"(^LIN \{.*\})\r\n; contact", r"\1 C_VEL\r\nHALT"),
    "a chain that blends into nothing": put(SUB, r"(^LIN \{.*\})\r\nEND", r"\1 C_VEL\r\nEND"),
    "a motion that does not blend": put(SUB, r"C_VEL\r\n", "\r\n", 5),
    "no advance": put(SUB, r"\$ADVANCE=3", r"$ADVANCE=0", 1),
    **{f"{name} not set": lost(SUB, rf"^{re.escape(name)}=.*\r\n") for name in PATH},
    "$VEL.CP of a plane": put(SUB, r"(\$VEL\.CP=)", r"\g<1>200", 4),
    "$VEL.CP negative": put(SUB, r"(\$VEL\.CP=)", r"\g<1>-", 4),
    "a pose out of reach": put(SUB, r"(^LIN \{X )-?[\d.]+", r"\g<1>9000.0000", 5),
}
HARMLESS: dict[str, Change] = {
    # comments and remarks do not move; more blanks are no other statement
    "a comment that looks like a statement": put(SUB, "^; contact", "; PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}"),
    "a comment behind a point": put(SUB, r"(^  SPTP \{.*\})", r"\1 ; HALT", 3),
    "another comment line in the header": put(SUB, "^&COMMENT [^\r]*", "&COMMENT $OV_PRO=100"),
    "blanks": put(SUB, "^  SPTP", "      SPTP", 3),
    # names and words without case, axes by their names
    "a call in small letters": put(MAIN, r"BLADE_1_01 \( \)", "blade_1_01 ( ) ; HALT"),
    "a block in small letters": put(SUB, "^PTP_SPLINE", "ptp_spline"),
    "axes in another order": put(SUB, r"\{A1 ([-\d.]+),A2 ([-\d.]+)", r"{A2 \2,A1 \1", 6),
    # nothing is approximated and no logic runs ahead: the advance is not used
    "another advance": put(SUB, "^; contact", r"$ADVANCE=5"),
    # nobody asks for the name
    "a declaration": put(DATA, "^ENDDAT", r"DECL AXIS P1={A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\r\nENDDAT"),
    # a last printed digit is a tenth of what the emitted curve may miss the plan by
    "a last digit of an axis": put(SUB, r"(A6 [-\d.]*?)(\d)(\})", r"\g<1>5\3", 6),
}


TABLES = {"axis": MUTATIONS, "cartesian": ON_POSES, "lin": ON_LINES}


@pytest.fixture(scope="module")
def fresh() -> dict[str, Files]:
    return {kind: program_files(example(kind, 2)) for kind in TABLES}


def changed(fresh: Files, change: Change, folder: Path) -> Path:
    files = dict(fresh)
    change(files)
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


def driven(folder: Path) -> object:
    return drive(read_program(folder / MAIN, planned=True), ROBOT)


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, table in TABLES.items() for name in table])
def test_both_readers_refuse(kind, name, fresh, tmp_path):
    folder = changed(fresh[kind], TABLES[kind][name], tmp_path)
    for reader in (lambda: check_program(folder / MAIN, ROBOT), lambda: driven(folder)):
        with pytest.raises((BadInput, Infeasible)) as refusal:
            reader()
        said = str(refusal.value)
        assert "\n" not in said and len(said) < 400, said
        assert re.search(r"BLADE_1(_0\d)?\.(src|dat)", said) or name == "nothing called", said


@pytest.mark.parametrize("kind", TABLES)
def test_the_program_as_written_passes_both(kind, fresh, tmp_path):
    folder = changed(fresh[kind], lambda files: None, tmp_path)
    assert check_program(folder / MAIN, ROBOT).segments
    driven(folder)


@pytest.mark.parametrize("name", HARMLESS)
def test_what_changes_no_motion_passes(name, fresh, tmp_path):
    folder = changed(fresh["axis"], HARMLESS[name], tmp_path)
    assert check_program(folder / MAIN, ROBOT).segments
    driven(folder)


def test_a_comment_in_a_chain_of_lines_passes(fresh, tmp_path):
    folder = changed(fresh["lin"], put(SUB, r"(C_VEL\r\n)", r"\1; $TOOL lies\r\n", 5), tmp_path)
    assert check_program(folder / MAIN, ROBOT).segments
    driven(folder)


def test_foreign_programs_of_poses_without_times_go_on_to_be_read_and_driven(fresh, tmp_path):
    """As old.src of a new plan, and on the virtual cell: neither asks of others what it asks of a plan."""
    folder = changed(fresh["cartesian"], both(ON_POSES["no times at all"]), tmp_path)
    blocks = [s for s in KRL.read(folder / MAIN).segments if s.word == "SPLINE" and s.file == SUB]
    assert len(blocks) == 3 and all(s.times is None and s.speed > 0 for s in blocks)
    track = drive(read_program(folder / MAIN), ROBOT)
    places = {motion.file: motion for motion in read_program(folder / MAIN).motions if motion.kind == "SPLINE"}
    assert set(places) == {SUB, SECOND} and places[SUB].times is None and track.duration > 5.0
