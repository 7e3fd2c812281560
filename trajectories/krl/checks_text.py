"""Refusals that need only the files: pairs, names, line ends, characters, the way numbers are printed."""

import re
from pathlib import Path

from robots.errors import BadInput
from trajectories.krl.names import LONGEST, is_legal

EXPONENT = re.compile(r"(?<![\w.$])\d+\.?\d*[eE][+-]?\d+")
NEGATIVE_ZERO = re.compile(r"-\s*0+(?:\.0*)?(?![\d.])")
LONG_LINE = 140  # characters, what the controller's editor takes (M)


def program_files_of(folder: Path) -> list[Path]:
    """Every .src and .dat of a folder, sorted."""
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in (".src", ".dat"))


def check_files(folder: Path) -> None:
    """Refuse (BadInput) file names and pairs that a controller does not take, and every fault of the plain text."""
    files = program_files_of(folder)
    seen: dict[str, Path] = {}
    for path in files:
        if not is_legal(path.stem):
            raise BadInput(
                f"{path.name}, line 1: '{path.stem}' is no program name; letters, digits and _, not a digit first, at most "
                f"{LONGEST} characters (it has {len(path.stem)}), no word of the language"
            )
        twin = seen.setdefault(path.name.upper(), path)
        if twin is not path:
            raise BadInput(f"{path.name}, line 1: {twin.name} has the same name on the controller, which ignores case")
    for path in files:
        other = ".DAT" if path.suffix.lower() == ".src" else ".SRC"
        if f"{path.stem}{other}".upper() not in seen:
            raise BadInput(f"{path.stem}{other.lower()}: the file is missing beside {path.name}; a program is a pair")
        check_text(path)


def check_text(path: Path) -> None:
    """Refuse (BadInput, with the line) what is not ASCII with CRLF, or a number in a form the controller misreads."""
    data = path.read_bytes()
    if not data.endswith(b"\r\n"):
        last = len(data.split(b"\n"))
        raise BadInput(f"{path.name}, line {last}: the last line does not end with CR LF; the file is cut off")
    for number, raw in enumerate(data.split(b"\n")[:-1], start=1):
        where = f"{path.name}, line {number}"
        if not raw.endswith(b"\r"):
            raise BadInput(f"{where}: the line ends with LF alone; a controller file ends its lines with CR LF")
        body = raw[:-1]
        if any(b > 126 or b < 32 for b in body):
            raise BadInput(f"{where}: a character outside printable ASCII; write A-Z, digits and signs only")
        text = body.decode("ascii")
        if len(text) > LONG_LINE:
            raise BadInput(f"{where}: {len(text)} characters, and a line takes {LONG_LINE}")
        code = re.sub(r'"[^"]*"', "", text).split(";", 1)[0]
        if code.startswith("&"):
            continue
        if found := EXPONENT.search(code):
            raise BadInput(f"{where}: the number {found.group()} has an exponent; write it with decimals")
        if found := NEGATIVE_ZERO.search(code):
            raise BadInput(f"{where}: {found.group()} is a negative zero; write 0 without a sign")
