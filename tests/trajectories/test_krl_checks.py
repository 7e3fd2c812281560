"""Every mutation of a freshly written program is refused, and the refusal names the file and the line."""

import re
from pathlib import Path

import numpy as np
import pytest

from robots.errors import BadInput
from tests.support.krl_example import ROBOT, example
from trajectories.krl.checks import check_program

SUB, MAIN, DATA = "BLADE_1_01.src", "BLADE_1.src", "BLADE_1_01.dat"


@pytest.fixture(scope="module")
def fresh() -> dict[str, dict[str, bytes]]:
    from trajectories.krl.writer import program_files

    return {kind: program_files(example(kind)) for kind in ("axis", "cartesian", "lin")}


def lines_of(files: dict[str, bytes], name: str) -> list[str]:
    return files[name].decode().split("\r\n")


def find(lines: list[str], pattern: str, nth: int = 0) -> int:
    """Index of the nth line that matches."""
    return [i for i, line in enumerate(lines) if re.search(pattern, line)][nth]


def replaced(pattern: str, old: str, new: str, nth: int = 0):
    def change(lines: list[str]) -> int:
        i = find(lines, pattern, nth)
        changed = re.sub(old, new, lines[i], count=1)
        assert changed != lines[i], "the mutation changes nothing"
        lines[i] = changed
        return i + 1

    return change


def inserted(pattern: str, text: str, nth: int = 0, after: bool = True):
    def change(lines: list[str]) -> int:
        i = find(lines, pattern, nth) + after
        lines.insert(i, text)
        return i + 1

    return change


def removed(pattern: str, nth: int = 0, named: int = 0):
    """Remove a line; the refusal names the line at `named` from where it stood."""

    def change(lines: list[str]) -> int:
        i = find(lines, pattern, nth)
        del lines[i]
        return i + 1 + named

    return change


def swapped(lines: list[str]) -> int:
    i = find(lines, r"^\$IPO_MODE")
    bas = find(lines, "BAS \\(#INITMOV")
    lines.insert(bas, lines.pop(i))
    return bas + 1


def first_point_off(lines: list[str]) -> int:
    i = find(lines, "^  SPTP", 3)
    start = find(lines, "^PTP_SPLINE")
    lines[start + 1] = lines[i]
    return start + 2


def many_points(lines: list[str]) -> int:
    i = find(lines, "^LIN ", 2)
    lines[i:i] = [lines[i]] * 2000
    points = find(lines, "^(PTP|LIN) ", 2000)
    return points + 1


SPTP = r"^  SPTP"
MUTATIONS = {
    # name: (kind, file, change, part of the message)
    "missing brace": ("axis", SUB, replaced(SPTP, r"\}$", "", 4), "brace missing"),
    "missing opening brace": ("axis", SUB, replaced(SPTP, r"\{", "", 4), "expected '{'"),
    "SPTP in SPLINE": ("axis", SUB, replaced("^PTP_SPLINE", "PTP_SPLINE", "SPLINE"), None),
    "SPL in PTP_SPLINE": ("cartesian", SUB, replaced("^SPLINE", "SPLINE", "PTP_SPLINE"), None),
    "LIN in a block": ("axis", SUB, replaced(SPTP, "SPTP", "LIN", 5), "LIN may not stand in the PTP_SPLINE"),
    "assignment in a block": ("axis", SUB, inserted(SPTP, "  $VEL.CP=0.1", 3), "only points"),
    "logic in a block": ("axis", SUB, inserted(SPTP, "  IF $IN[1] THEN", 3), "run time"),
    "call in a block": ("axis", SUB, inserted(SPTP, "  BLADE_1 ( )", 3), "only points"),
    "open time block": ("axis", SUB, removed("TIME_BLOCK END"), "is open"),
    "time block without start": ("axis", SUB, removed("TIME_BLOCK START"), "expected TIME_BLOCK START"),
    "no time block": ("axis", SUB, None, "has no TIME_BLOCK"),
    "two time blocks": ("axis", SUB, inserted("TIME_BLOCK PART", "  TIME_BLOCK START", 2), "second TIME_BLOCK START"),
    "two ends": ("axis", SUB, inserted("TIME_BLOCK END", "  TIME_BLOCK END=1.00000"), None),
    "time block outside": ("axis", SUB, inserted("^PTP ", "TIME_BLOCK START"), "outside a spline block"),
    "parts do not add up": ("axis", SUB, replaced("TIME_BLOCK PART", r"PART=0", "PART=1", 2), "add up"),
    "end does not fit": ("axis", SUB, replaced("TIME_BLOCK END", r"END=\d", "END=7"), "add up"),
    "part of zero": ("axis", SUB, replaced("TIME_BLOCK PART", r"=.*", "=0.00000", 2), "above 0"),
    "part without a point": ("axis", SUB, inserted("TIME_BLOCK PART", "  TIME_BLOCK PART=0.02000", 2), "expected a point"),
    "point without a part": ("axis", SUB, removed("TIME_BLOCK PART", 3), "expected TIME_BLOCK PART"),
    "unknown time block": ("axis", SUB, replaced("TIME_BLOCK START", "START", "BEGIN"), "is not one of"),
    "nested block": ("axis", SUB, inserted(SPTP, "PTP_SPLINE", 3), "inside the block"),
    "block not closed": ("axis", SUB, removed("^ENDSPLINE"), None),
    "ENDSPLINE alone": ("axis", SUB, inserted("^PTP ", "ENDSPLINE"), "without a block"),
    "non-ASCII": ("axis", SUB, inserted("^PTP ", "; Schaufel Ä"), "ASCII"),
    "tabulator": ("axis", SUB, replaced(SPTP, "  SPTP", "\tSPTP", 2), "ASCII"),
    "module and file differ": ("axis", SUB, replaced("^DEF ", "BLADE_1_01", "BLADE_1_02"), "another name"),
    "DEFDAT and file differ": ("axis", DATA, replaced("^DEFDAT", "BLADE_1_01", "BLADE_9"), "another name"),
    "DEFDAT in .src": ("axis", SUB, replaced("^DEF ", r"DEF BLADE_1_01\( \)", "DEFDAT BLADE_1_01"), None),
    "incomplete position": ("axis", SUB, replaced(SPTP, r",A6 [^}]*", "", 6), "A6 is missing"),
    "incomplete pose": ("cartesian", SUB, replaced("^  SPL ", r",C [^,]*", "", 2), "C is missing"),
    "pose without status": ("cartesian", SUB, replaced("^  SPL ", r",S \d+", "", 2), "S is missing"),
    "a seventh axis": ("axis", SUB, replaced(SPTP, r"\}", ",E1 0.0}", 2), "E1 does not belong"),
    "component twice": ("axis", SUB, replaced(SPTP, "A2", "A1", 2), "given twice"),
    "first motion not PTP": ("axis", SUB, removed("^PTP "), "the first motion must be a PTP"),
    "first motion to a pose": ("lin", SUB, replaced("^PTP ", r"\{.*\}", "{X 1,Y 2,Z 3,A 4,B 5,C 6}"), "all six axes"),
    "statement after END": ("axis", SUB, inserted("^END$", "HALT"), "after END"),
    "missing END": ("axis", SUB, removed("^END$", named=-1), "without END"),
    "missing ENDDAT": ("axis", DATA, removed("^ENDDAT$", named=-1), "without ENDDAT"),
    "END in .dat": ("axis", DATA, replaced("^ENDDAT", "ENDDAT", "END"), "expected ENDDAT"),
    "exponent": ("axis", SUB, replaced(SPTP, r"A6 [^}]*", "A6 1.5E1", 2), "exponent"),
    "decimal comma": ("axis", SUB, replaced(SPTP, r"A1 (\d+)\.", r"A1 \1,", 2), "decimal comma"),
    "decimal comma in time": ("axis", SUB, replaced("TIME_BLOCK PART", r"0\.", "0,", 2), "too much"),
    "negative zero": ("axis", SUB, replaced(SPTP, r"A6 [^}]*", "A6 -0.00000", 2), "negative zero"),
    "unknown statement": ("axis", SUB, inserted("^PTP ", "SPTPP {A1 0}"), None),
    "unknown letters": ("axis", SUB, inserted("^PTP ", "?!"), "is not KRL"),
    "injected assignment": ("axis", SUB, inserted("^PTP ", "$OV_PRO=100"), "may not be assigned"),
    "speed out of range": ("axis", SUB, replaced(r"^\$VEL_AXIS\[3\]", "=.*", "=500"), "at most 100"),
    "declaration late": ("axis", SUB, inserted("^PTP ", "DECL INT I"), "declarations come first"),
    "declared twice": ("axis", DATA, inserted("DECL INT", "INT Success"), "declared in line"),
    "statement in .dat": ("axis", DATA, inserted("DECL INT", "$OV_PRO=100"), "only declarations"),
    "axis beyond its limit": ("axis", SUB, replaced(SPTP, r"A5 [^,]*", "A5 126.00000", 5), "axis 5 at 126.000"),
    "axis below its limit": ("axis", SUB, replaced(SPTP, r"A5 [^,]*", "A5 -126.00000", 5), "axis 5 at -126.000"),
    "one axis fast at first": ("axis", SUB, replaced(r"^\$VEL_AXIS\[2\]", "=.*", "=31"), "$VEL_AXIS[2] = 31 is above 30 %"),
    "path too fast": ("lin", SUB, replaced(r"^\$VEL\.CP", "=.*", "=3.1"), "$VEL.CP must be a number above 0 and at most 3"),
    "path too sudden": ("lin", SUB, replaced(r"^\$ACC\.CP", "=.*", "=10.1"), "at most 10"),
    "turns too fast": ("lin", SUB, replaced(r"^\$VEL\.ORI1", "=.*", "=401"), "at most 400"),
    "turns too suddenly": ("lin", SUB, replaced(r"^\$ACC\.ORI2", "=.*", "=1001"), "at most 1000"),
    "no such tool": ("axis", SUB, replaced(r"^\$ACT_TOOL", "=.*", "=129"), "from 1 to 128"),
    "no such base": ("axis", SUB, replaced(r"^\$ACT_BASE", "=.*", "=0"), "from 1 to 128"),
    "no such advance": ("lin", SUB, replaced(r"^\$ADVANCE", "=.*", "=6"), "from 1 to 5"),
    "load below nothing": ("axis", SUB, replaced(r"^\$LOAD", r"J \{X [^,]*", "J {X -1.0"), "negative mass or inertia"),
    "out of reach": ("lin", SUB, replaced("^LIN ", r"\{X [^,]*", "{X 99999.0", 2), "which reaches"),
    "a stop before a change of speed": ("lin", SUB, replaced("^LIN ", " C_VEL", "", 2), "does not blend into this one"),
    "status wrong": ("cartesian", SUB, replaced("^  SPL ", r",S \d", ",S 2"), None),
    "status jumps": ("cartesian", SUB, replaced("^  SPL ", r",S \d", ",S 2", 3), "S changes"),
    "turn wrong": ("cartesian", SUB, replaced("^  SPL ", r",T \d+", ",T 0"), "T is 0"),
    "status no number": ("cartesian", SUB, replaced("^  SPL ", r",S \d", ",S 9", 3), "0 to 7"),
    "too many points": ("lin", SUB, many_points, "more than 2000 points"),
    "unknown program": ("axis", MAIN, replaced("^BLADE_1_01", "_01", "_07"), "is called and is not in"),
    "calls itself": ("axis", MAIN, replaced("^BLADE_1_01", "_01", ""), "calls itself"),
    "frames before BAS": ("axis", SUB, swapped, "would set it back"),
    "no frames": ("axis", SUB, removed(r"^\$BASE"), None),
    "no BAS": ("axis", SUB, removed(r"BAS \(#INITMOV"), None),
    "other BAS": ("axis", SUB, replaced(r"BAS \(#INITMOV", "#INITMOV,0", "#TOOL,3"), "only BAS"),
    "poses in the base frame": ("cartesian", SUB, replaced(r"^\$IPO_MODE", "#TCP", "#BASE"), None),
    "no speed": ("cartesian", SUB, None, "the robot moves before $VEL.CP was set"),
    "block begins elsewhere": ("axis", SUB, first_point_off, "off where the robot stands"),
    "no header": ("axis", SUB, removed("^&ACCESS"), "&ACCESS"),
    "late header": ("axis", SUB, inserted("^PTP ", "&REL 2"), "header lines come first"),
    "loop": ("axis", SUB, inserted("^PTP ", "LOOP"), "run time"),
    "circle": ("axis", SUB, inserted("^PTP ", "CIRC {X 0},{X 1}"), "not supported"),
    "named position": ("axis", SUB, replaced("^PTP ", r"\{.*\}", "XHOME"), "expected '{'"),
    "second DEF": ("axis", SUB, inserted("^PTP ", "DEF OTHER( )"), "second DEF"),
    "line too long": ("axis", SUB, inserted("^PTP ", "; " + "x" * 200), "characters"),
    "parameters": ("axis", SUB, replaced("^DEF ", r"\( \)", "(I :IN)"), "expected ')'"),
}
# Where the line of the refusal is not the line that was changed: a pattern of the line that is named instead.
NAMED_ELSEWHERE = {
    "SPTP in SPLINE": SPTP,
    "SPL in PTP_SPLINE": "^  SPL ",
    "open time block": "^ENDSPLINE",
    "no time block": "^PTP_SPLINE",
    "parts do not add up": "TIME_BLOCK END",
    "block not closed": r"^\$TOOL:2",
    "first motion not PTP": SPTP,
    "time block without start": SPTP + ":1",
    "point without a part": None,
    "no frames": "^PTP ",
    "no BAS": r"^\$TOOL",
    "no speed": "^SPLINE",
    "no header": "^&REL",
    "calls itself": "^",
    "DEFDAT in .src": "^END$",
    "one axis fast at first": "^PTP ",
    "a stop before a change of speed": "^LIN :3",
}


def mutate(name: str, lines: list[str]) -> int:
    change = MUTATIONS[name][2]
    if name == "no time block":
        lines[:] = [line for line in lines if "TIME_BLOCK" not in line]
        return 0
    if name == "no speed":
        lines[:] = [line for line in lines if "$VEL.CP" not in line]
        return 0
    return change(lines)


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_mutated_program_is_refused_with_its_line(name, fresh, tmp_path):
    kind, file, _, message = MUTATIONS[name]
    lines = lines_of(fresh[kind], file)
    line = mutate(name, lines)
    if NAMED_ELSEWHERE.get(name):
        pattern, _, nth = NAMED_ELSEWHERE[name].partition(":")
        line = find(lines, pattern, int(nth or 0)) + 1
    for other, data in fresh[kind].items():
        (tmp_path / other).write_bytes(data)
    (tmp_path / file).write_bytes("\r\n".join(lines).encode("latin-1"))
    with pytest.raises(BadInput) as refusal:
        check_program(tmp_path / MAIN, ROBOT)
    said = str(refusal.value)
    assert said.startswith(f"{file}, line {line}: "), said
    assert message is None or message in said, said
    assert "\n" not in said


@pytest.mark.parametrize("kind", ["axis", "cartesian", "lin"])
def test_the_unmutated_program_passes(kind, fresh, tmp_path):
    for name, data in fresh[kind].items():
        (tmp_path / name).write_bytes(data)
    assert check_program(tmp_path / MAIN, ROBOT).segments


def put(files: dict[str, bytes], folder: Path) -> Path:
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder / MAIN


def test_line_feeds_alone_are_refused(fresh, tmp_path):
    source = put(fresh["axis"], tmp_path)
    data = fresh["axis"][SUB]
    cut = data.index(b"\r\n", 500)
    (tmp_path / SUB).write_bytes(data[:cut] + data[cut + 1 :])
    with pytest.raises(BadInput, match=rf"{SUB}, line {data[:cut].count(b'%s' % bytes([10])) + 1}: .*LF alone"):
        check_program(source)


def test_a_file_that_is_cut_off_is_refused(fresh, tmp_path):
    source = put(fresh["axis"], tmp_path)
    (tmp_path / SUB).write_bytes(fresh["axis"][SUB][:-40])
    with pytest.raises(BadInput, match=rf"{SUB}, line \d+: .*cut off"):
        check_program(source)


def test_a_missing_dat_is_refused(fresh, tmp_path):
    source = put(fresh["axis"], tmp_path)
    (tmp_path / DATA).unlink()
    with pytest.raises(BadInput, match=rf"{DATA}: the file is missing"):
        check_program(source)


def test_a_missing_src_is_refused(fresh, tmp_path):
    source = put(fresh["axis"], tmp_path)
    (tmp_path / SUB).unlink()
    with pytest.raises(BadInput, match=rf"{SUB}: the file is missing"):
        check_program(source)


def test_a_name_of_25_characters_is_refused(fresh, tmp_path):
    source = put(fresh["axis"], tmp_path)
    name = "A" * 25
    for suffix in (".src", ".dat"):
        text = fresh["axis"]["BLADE_1" + suffix].replace(b"BLADE_1(", name.encode() + b"(").replace(b"BLADE_1\r", name.encode())
        (tmp_path / (name + suffix)).write_bytes(text)
    with pytest.raises(BadInput, match=rf"{name}\.dat, line 1: .*at most 24 characters \(it has 25\)"):
        check_program(source)


def test_two_files_whose_names_differ_in_case_alone_are_refused(fresh, tmp_path):
    source = put(fresh["axis"], tmp_path)
    twin = tmp_path / SUB.lower()
    if twin.exists():
        pytest.skip("this file system ignores case itself")
    twin.write_bytes(fresh["axis"][SUB])
    with pytest.raises(BadInput, match="ignores case"):
        check_program(source)


def test_poses_on_an_absolutely_accurate_controller_are_refused(fresh, tmp_path):
    with pytest.raises(BadInput, match=rf"{SUB}, line \d+: .*compensate twice"):
        check_program(put(fresh["cartesian"], tmp_path), absolute_accuracy=True)


def test_a_program_that_moves_nothing_is_refused(fresh, tmp_path):
    source = put(fresh["axis"], tmp_path)
    lines = [line for line in lines_of(fresh["axis"], MAIN) if not line.startswith("BLADE_1_01")]
    source.write_bytes("\r\n".join(lines).encode())
    with pytest.raises(BadInput, match="moves nothing"):
        check_program(source)


def test_random_damage_is_refused_or_changes_nothing_that_moves(fresh, tmp_path):
    """One random byte of the sub-program is changed: never an exception of another kind, never a silent difference."""
    source = put(fresh["axis"], tmp_path)
    intact = check_program(source, ROBOT).segments
    rng = np.random.default_rng(1)
    data = fresh["axis"][SUB]
    accepted = 0
    for _ in range(60):
        at = int(rng.integers(len(data)))
        (tmp_path / SUB).write_bytes(data[:at] + bytes([int(rng.integers(32, 127))]) + data[at + 1 :])
        try:
            after = check_program(source, ROBOT).segments
        except BadInput:
            continue
        accepted += 1
        assert len(after) == len(intact)
        for a, b in zip(after, intact, strict=True):
            # a digit of one axis may have become another digit: that is a legal program
            assert a.kind == b.kind and a.q.shape == b.q.shape and np.count_nonzero(a.q != b.q) <= 1
    assert accepted < 60
