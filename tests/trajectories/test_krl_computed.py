"""Positions, frames, feeds and outer axes that an old program sets as it runs: read as the robot would drive, or refused."""

import numpy as np
import pytest

from robots.errors import BadInput
from trajectories.krl.interpreter import execute

FRAMES = "$TOOL={X 0,Y 0,Z 200,A 0,B 0,C 0}\n$BASE={X 1660,Y 0,Z 900,A 0,B -90,C 0}\n"
PLACES = "".join(f"DECL E6POS P{k}={{X {10 * k},Y 2,Z 3,A 4,B 5,C 6,E1 0}}\n" for k in (1, 2, 3))
PATH = "LIN P1\nLIN P2\nLIN P3\n"


def segments(folder, body, places=PLACES):
    (folder / "old.src").write_text(f"DEF old( )\n{FRAMES}{body}END\n")
    (folder / "old.dat").write_text(f"DEFDAT old\n{places}ENDDAT\n")
    return execute(folder / "old.src", strict=False).segments


def x_of(segment):
    return round(1e3 * segment.poses[0, 0, 3], 6)


def test_a_component_a_copy_and_a_known_frame_count(tmp_path):
    first, second, third = segments(tmp_path, "P2.X=12.5\nP3=P1\n$TOOL.Z=150.0\n$BASE=$NULLFRAME\n" + PATH)
    assert [x_of(s) for s in (first, second, third)] == [10.0, 12.5, 10.0]
    assert np.allclose(first.frames.tool[:3, 3], [0, 0, 0.15]) and np.array_equal(first.frames.base, np.eye(4))
    declared = PLACES + "DECL FRAME MINE={X 1,Y 2,Z 3,A 0,B 0,C 0}\n"
    assert np.allclose(segments(tmp_path, "$BASE=MINE\n" + PATH, declared)[0].frames.base[:3, 3], [1e-3, 2e-3, 3e-3])


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("P2.X=P2.X+1.0\n", r"old\.src, line 6: P2 is computed when the program runs \(old\.src, line 4\)"),
        ("P2=P1:P3\n", r"line 6: P2 is computed"),
        ("P3=P9\n", r"line 7: P3 is computed"),
        ("$BASE.X=$BASE.X+2.0\n", r"line 5: \$BASE is computed"),
        ("$BASE.A=2.0\n", r"line 5: \$BASE is computed"),
        ("$BASE=BASE_DATA[1]:P1\n", r"line 5: \$BASE is computed"),
        ("BASE_DATA[1]=P1:P2\nBAS(#BASE,1)\n", r"line 6: \$BASE is computed when the program runs \(old\.src, line 4\)"),
        ("BAS(#TOOL,1)\n$TOOL.Z=1.0\n", r"line 6: \$TOOL is computed"),
    ],
)
def test_what_only_the_controller_knows_is_refused_where_a_path_uses_it(body, words, tmp_path):
    with pytest.raises(BadInput, match=words):
        segments(tmp_path, body + PATH)
    assert len(segments(tmp_path, PATH + body)) == 3  # afterwards nothing moves by it
    literal = "P2={X 1,Y 2,Z 3,A 4,B 5,C 6}\nP3=P2\n" + FRAMES
    assert [x_of(s) for s in segments(tmp_path, body + literal + PATH)] == [10.0, 1.0, 1.0]  # numbers again


@pytest.mark.parametrize("body", ["H.A2=H.A2+1.0\n", "H=OTHER_H\n"])
def test_axes_that_only_the_controller_knows_are_refused_on_a_path_and_left_out_of_a_move(body, tmp_path):
    places = PLACES + "DECL E6AXIS H={A1 1,A2 -80,A3 90,A4 0,A5 10,A6 0}\n"
    assert np.degrees(segments(tmp_path, "H.A2=-75.0\nLIN H\n", places)[0].q[0, 1]) == pytest.approx(-75.0)
    with pytest.raises(BadInput, match=r"old\.src, line 5: H is computed when the program runs \(old\.src, line 4\)"):
        segments(tmp_path, body + "LIN H\n", places)
    assert [s.word for s in segments(tmp_path, body + "PTP H\nLIN P1\n", places)] == ["LIN"]
    assert "the position H is not in" in execute(tmp_path / "old.src", strict=False).notices[0]


@pytest.mark.parametrize(
    ("body", "speed"),
    [
        ("$VEL={CP 0.02,ORI1 200.0,ORI2 200.0}\nLIN P1\n", 0.02),
        ("BAS(#VEL_CP,0.02)\nLIN P1\n", 0.02),
        ("BAS (#CP_PARAMS, 0.02 )\nLIN P1\n", 0.02),
        ("$VEL.CP=0.5\nSLIN P1 WITH $VEL.CP=0.02\n", 0.02),
        ("SLIN P1 C_SPL WITH $ACC.CP=1.0, $VEL={ORI1 100.0, CP 0.02}\n", 0.02),
        ("SPLINE WITH $VEL.CP=0.02\nSPL P1\nSPL P2\nENDSPLINE\n", 0.02),
        ("SLIN P1 WITH $VEL=SVEL_CP(0.02, , LCPDAT1), $TOOL=STOOL2(F1), $BASE=SBASE(F1.BASE_NO)\n", 0.02),
    ],
)
def test_every_way_to_set_the_feed_is_read(body, speed, tmp_path):
    form = 'DECL FDAT F1={TOOL_NO 3,BASE_NO 4,IPO_FRAME #TCP,POINT2[] " "}\n'
    first, *_, after = segments(tmp_path, body + "LIN P3\n", PLACES + form)
    assert first.speed == speed
    if "WITH" in body:  # holds for its motion alone
        assert after.speed == (0.5 if "0.5" in body else None) and after.frames.base is not None
    if "STOOL2" in body:
        assert (first.frames.tool_no, first.frames.base_no, first.frames.external_tcp) == (3, 4, True)


def test_a_set_override_is_told(tmp_path):
    segments(tmp_path, "$VEL.CP=0.04\n$OV_PRO=50\n" + PATH)
    told = execute(tmp_path / "old.src", strict=False)
    assert told.segments[0].speed == 0.04
    assert told.notices == ("old.src, line 5: the override is set; feeds are taken as $VEL.CP has them, not slower by it",)
    segments(tmp_path, "$OV_PRO=100\n" + PATH)
    assert not execute(tmp_path / "old.src", strict=False).notices


def test_a_call_of_a_foreign_program_is_passed_over_and_of_a_missing_part_of_its_own_refused(tmp_path):
    assert len(segments(tmp_path, "CLEAN(1)\n" + PATH)) == 3
    assert "old.src, line 4: CLEAN is called and is not in" in execute(tmp_path / "old.src", strict=False).notices[0]
    with pytest.raises(BadInput, match=r"old\.src, line 7: the program OLD_02 is called and is not in .* put it beside"):
        segments(tmp_path, PATH + "OLD_02()\n")


def test_an_outer_axis_that_moves_along_the_path_is_refused(tmp_path):
    moved = PLACES.replace("C 6,E1 0}", "C 6,E1 7}", 1)
    with pytest.raises(BadInput, match=r"line 5: the outer axis E1 goes from 7 to 0 along the path"):
        segments(tmp_path, PATH, moved)
    assert len(segments(tmp_path, PATH, PLACES.replace("E1 0}", "E1 7}"))) == 3  # one that stands does not
