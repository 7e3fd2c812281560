import re

from hypothesis import example, given
from hypothesis import strategies as st

from trajectories.krl.names import is_legal, program_names, sanitise
from trajectories.krl.values import comment_text


@given(st.text(max_size=80))
@example("x(); $OV_PRO=100 ;.stl")
@example("END.stl")
@example("ß" * 40)
@example("7\r\nPTP {A1 0}")
def test_any_text_becomes_one_word(text):
    name = sanitise(text)
    assert re.fullmatch(r"[A-Z][A-Z0-9_]{0,23}", name)
    assert is_legal(name)
    assert name == sanitise(text)


def test_known_names():
    assert sanitise("x(); $OV_PRO=100 ;.stl") == "X_OV_PRO_100"
    assert sanitise("blades/twisted.stl") == "TWISTED"
    assert sanitise("Läufer 37.STL") == "LAUFER_37"
    assert sanitise("37.stl") == "P37"
    assert sanitise("end.stl") == "END_P"
    assert sanitise("???.stl") == "GRIND"
    assert len(sanitise("a" * 100)) == 24


@given(
    st.text(max_size=40),
    st.lists(st.integers(1, 30), min_size=1, max_size=120),
    st.lists(st.sampled_from(["BLADE.src", "blade_01.SRC", "X", "grind_02_a.dat", "GRIND"]), max_size=5),
)
@example("0" * 18, [27], [])  # two letters for the 27th part
def test_names_of_a_program_are_legal_and_distinct_without_case(text, parts, taken):
    main, subs = program_names(text, len(parts), parts, taken)
    flat = [main, *(n for names in subs for n in names)]
    assert all(is_legal(n) for n in flat)
    assert len({n.upper() for n in flat}) == len(flat) == 1 + sum(parts)
    assert not {n.upper() for n in flat} & {t.rsplit(".", 1)[0].upper() for t in taken}
    assert program_names(text, len(parts), parts, taken) == (main, subs)


def test_collisions_are_resolved_in_the_same_way_every_time():
    assert program_names("Blade.stl", 2) == ("BLADE", [["BLADE_01"], ["BLADE_02"]])
    assert program_names("blade.stl", 1, (), ["BLADE.SRC"]) == ("BLADE_V2", [["BLADE_V2_01"]])
    assert program_names("blade.stl", 1, (), ["Blade_01.dat"])[0] == "BLADE_V2"
    assert program_names("blade", 2, [1, 2])[1] == [["BLADE_01"], ["BLADE_02_A", "BLADE_02_B"]]


@given(st.text(max_size=200))
def test_a_comment_stays_one_line_of_ascii_and_opens_no_fold(text):
    line = comment_text(text)
    assert re.fullmatch(r"[ -~]{0,100}", line)
    assert "FOLD" not in line.upper()


def test_illegal_names():
    for name in ("1A", "A B", "A" * 25, "PTP", "a-b", "", "Ä", "end"):
        assert not is_legal(name), name
