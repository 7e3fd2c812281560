"""Names that a KUKA controller accepts, made from whatever a user or a file is called (KRL.md, "Files")."""

import re
import unicodedata
from collections.abc import Iterable
from pathlib import PurePath

LONGEST = 24  # characters of a program name, KRL.md
FALLBACK = "GRIND"

# Words of the language and modules of the controller: a program of that name would hide them or not compile.
RESERVED = frozenset(
    """
    AND ANIN ANOUT B_AND B_EXOR B_NOT B_OR BOOL BRAKE CASE CAST_FROM CAST_TO CCLOSE CHANNEL CHAR CIRC CIRC_REL
    CONFIRM CONST CONTINUE COPEN COVER CREAD CWRITE DECL DEF DEFAULT DEFDAT DEFFCT DELAY DIGIN DISTANCE DO ELSE END
    ENDDAT ENDFCT ENDFOR ENDIF ENDLOOP ENDSPLINE ENDSWITCH ENDWHILE ENUM EXIT EXOR EXT EXTFCT FALSE FOLD FOR FRAME
    GLOBAL GOTO HALT IF IMPORT INT INTERRUPT IS LIN LIN_REL LOOP MAXIMUM MINIMUM NOT OFF ON OR PRIO PTP PTP_REL
    PTP_SPLINE PUBLIC PULSE REAL REPEAT RESUME RETURN SCIRC SEC SIGNAL SLIN SPL SPLINE SPTP STRUC SWIRC SWITCH SYN
    THEN TIME_BLOCK TO TRIGGER TRUE UNTIL WAIT WHEN WHILE WITH AXIS E6AXIS E6POS POS STATE_T
    BAS BAS_DAT CELL CONFIG IR_STOPM SPS MSG_DEMO P00 NEW_SERV FLT_SERV H50 H70 PERCEPT MASREF_USER USER_GRP
    CON AUX COM1 COM2 COM3 COM4 LPT1 LPT2 NUL PRN
    """.split()
)


def sanitise(text: str, longest: int = LONGEST) -> str:
    """A program name from any text: capitals A-Z, digits and `_`, a letter first, at most `longest` characters.

    A suffix such as .stl goes; letters with accents lose them; every other character becomes `_`. The same text
    always gives the same name, and nothing but one word can come out.
    """
    stem = text.replace("\\", "/").rsplit("/", 1)[-1]
    stem = re.sub(r"\.(stl|src|dat|toml|csv)$", "", stem, flags=re.IGNORECASE)
    plain = unicodedata.normalize("NFKD", stem.replace("ß", "ss")).encode("ascii", "ignore").decode()
    name = re.sub(r"[^A-Z0-9]+", "_", plain.upper()).strip("_")
    if name and name[0].isdigit():
        name = "P" + name
    name = name[:longest].strip("_") or FALLBACK
    if name in RESERVED:
        name = f"{name[: longest - 2]}_P"
    return name


def is_legal(name: str) -> bool:
    """True for a name the controller takes: letters, digits, `_`, `$`, no digit first, 24 characters, no keyword."""
    return bool(re.fullmatch(r"[A-Za-z_$][A-Za-z0-9_$]{0,23}", name)) and name.upper() not in RESERVED


def program_names(text: str, passes: int, parts: Iterable[int] = (), taken: Iterable[str] = ()) -> tuple[str, list[list[str]]]:
    """Main name and, pass by pass, the names of its sub-programs: NAME, [[NAME_01], [NAME_02_A, NAME_02_B], ..].

    `parts` (passes,) is into how many files each pass is split (default 1); `taken` are names already in the one flat
    name space of the controller (compared without case): a number is appended to NAME until nothing collides.
    """
    pieces = list(parts) or [1] * passes
    digits = max(2, len(str(passes)))
    most = max(pieces, default=1)
    room = LONGEST - (1 + digits) - (1 + len(_letters(most - 1)) if most > 1 else 0)
    used = {PurePath(t).name.rsplit(".", 1)[0].upper() for t in taken}
    base = sanitise(text, room)
    for attempt in range(1, 10_000):
        suffix = "" if attempt == 1 else f"_V{attempt}"
        stem = base[: room - len(suffix)].rstrip("_") + suffix
        subs = [
            [f"{stem}_{i + 1:0{digits}d}" + (f"_{_letters(k)}" if n > 1 else "") for k in range(n)] for i, n in enumerate(pieces)
        ]
        if not used & {stem, *(name for names in subs for name in names)}:
            return stem, subs
    raise AssertionError("ten thousand programs of one name")


def _letters(k: int) -> str:
    return chr(ord("A") + k) if k < 26 else _letters(k // 26 - 1) + chr(ord("A") + k % 26)
