"""STL files, ASCII and binary, read facet by facet; whatever is malformed is named with its place."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from robots.bounds import MEGABYTE, read_whole
from robots.errors import BadInput, shown
from robots.pose import Array

MAX_FACETS = 1_000_000  # beyond this a blade is a raw scan, and every later step would take minutes
MOST_BYTES = 300 * MEGABYTE  # a million facets as text, nine digits a number
LONGEST_WORD = 60  # characters; a double printed in full has 25
_LONG = re.compile(rf"[^\s]{{{LONGEST_WORD + 1},}}")
_HEADER, _FACET = 84, 50  # bytes of a binary STL: header with count, one facet
_FOREIGN = {
    b"PK\x03\x04": "a zip archive (3MF?)",
    b"%PDF": "a PDF",
    b"ply": "a PLY file",
    b"ISO-10303": "a STEP file",
    b"v ": "an OBJ file",
    b"\x89PNG": "a picture",
    b"glTF": "a glTF file",
}
_KEYWORDS = dict(
    zip((0, 1, 5, 6, 7, 11, 15, 19, 20), "facet normal outer loop vertex vertex vertex endloop endfacet".split(), strict=True)
)
_VERTEX_TOKENS = [8, 9, 10, 12, 13, 14, 16, 17, 18]


def read_facets(path: Path) -> tuple[Array, list[str]]:
    """Corner points of all facets in the file's own unit, and notices.

    Returns: (nf, 3, 3) corners and a list of sentences.
    Raises: BadInput naming byte, line or facet where the file is empty, cut short, no STL or not finite.
    """
    data = read_whole(path, MOST_BYTES, "the blade (STL, PLY, OBJ or STEP).")
    data = data.removeprefix(b"\xef\xbb\xbf")  # editors put it before text
    if not data:
        raise BadInput(f"{path}: is empty (0 bytes); export the blade as STL again.")
    notices: list[str] = []
    if _is_binary(data):
        corners = _read_binary(path, data, notices)
    elif _is_text(data) and re.match(rb"\s*solid\b", data[:200], re.IGNORECASE):
        corners = _read_ascii(path, data)
    else:
        corners = _read_damaged(path, data, notices)
    if not len(corners):
        raise BadInput(f"{path}: holds no facet; export the blade as STL again.")
    if len(corners) > MAX_FACETS:
        raise BadInput(f"{path}: has {len(corners)} facets, the limit is {MAX_FACETS}; export it coarser.")
    _refuse_not_finite(path, corners)
    return corners, notices


def _is_binary(data: bytes) -> bool:
    if len(data) < _HEADER:
        return False
    count = int.from_bytes(data[80:84], "little")
    return len(data) == _HEADER + _FACET * count


def _is_text(data: bytes) -> bool:
    head = data[:4096]
    return all(byte in b"\t\n\r\f" or 32 <= byte < 127 or byte >= 128 for byte in head)


def _read_binary(path: Path, data: bytes, notices: list[str]) -> Array:
    count = int.from_bytes(data[80:84], "little")
    records = np.frombuffer(data, np.uint8, count * _FACET, _HEADER).reshape(count, _FACET)
    corners = records[:, 12:48].copy().view("<f4").reshape(count, 3, 3)
    # Any bits may stand there; a signalling NaN must not reach the cast.
    return np.where(np.isnan(corners), np.float32(np.nan), corners).astype(float)


def _read_damaged(path: Path, data: bytes, notices: list[str]) -> Array:
    """A file that is neither a whole binary nor an ASCII STL: say what it is; accept bytes after the last facet."""
    for magic, what in _FOREIGN.items():
        if data.startswith(magic):
            raise BadInput(f"{path}: is {what}, not an STL file; export the blade as STL.")
    if _is_text(data) or len(data) < _HEADER:
        start = data[:20].decode("latin-1")
        raise BadInput(
            f"{path}: is no STL file: its {len(data)} bytes start with {shown(repr(start))} where an ASCII STL has 'solid' "
            f"and a binary one has 84 bytes of header; export the blade as STL."
        )
    count = int.from_bytes(data[80:84], "little")
    present = (len(data) - _HEADER) // _FACET
    if count > present:
        if count > 200 * MAX_FACETS or count > 1000 * (present + 1):
            raise BadInput(
                f"{path}: is no STL file: bytes 80 to 83 would announce {count} facets in {len(data)} bytes; "
                f"export the blade as STL."
            )
        raise BadInput(
            f"{path}: is cut short at byte {len(data)}, in facet {present + 1} of the {count} that its header "
            f"announces ({_HEADER + _FACET * count} bytes); copy or export it again."
        )
    extra = len(data) - _HEADER - _FACET * count
    notices.append(f"{path.name}: {extra} bytes after the last of {count} facets were ignored.")
    return _read_binary(path, data, notices)


def _read_ascii(path: Path, data: bytes) -> Array:
    text = data.decode("latin-1")
    count = len(re.findall(r"(?i)\bendfacet\b", text))
    if count > MAX_FACETS:
        raise BadInput(f"{path}: has {count} facets, the limit is {MAX_FACETS}; export it coarser.")
    body = re.sub(r"(?im)^[ \t]*(end)?solid\b.*$", "", text)
    if long := _LONG.search(body):
        raise BadInput(
            f"{path}, line {body.count(chr(10), 0, long.start()) + 1}: '{shown(long.group())}' has more than {LONGEST_WORD} "
            "characters, which no number has; export it again."
        )
    blocks = [_facets_of(block) for block in _blocks(body)]
    known = [block for block in blocks if block is not None]
    if len(known) == len(blocks) and known:
        return np.concatenate(known)
    _raise_at_bad_line(path, text)
    raise BadInput(f"{path}: holds no facet; export the blade as STL again.")


def _blocks(body: str) -> Iterator[str]:
    """Whole facets, ten thousand at a time: as words all of them would fill the memory."""
    start = 0
    for k, found in enumerate(re.finditer(r"(?i)\bendfacet\b", body), 1):
        if k % 10_000 == 0:
            yield body[start : found.end()]
            start = found.end()
    if rest := body[start:].strip():
        yield rest


def _facets_of(text: str) -> Array | None:
    """Corners (n, 3, 3) of whole facets; None where a word is not the one that the grammar has there."""
    tokens = np.array(text.split())
    if len(tokens) % 21:
        return None
    table = tokens.reshape(-1, 21)
    if not all((np.char.lower(table[:, column]) == word).all() for column, word in _KEYWORDS.items()):
        return None
    try:
        return np.asarray(table[:, _VERTEX_TOKENS].astype(float).reshape(-1, 3, 3))
    except ValueError:
        return None


_GRAMMAR = ["facet normal", "outer loop", "vertex", "vertex", "vertex", "endloop", "endfacet"]


def _raise_at_bad_line(path: Path, text: str) -> None:
    """Walk the lines of an ASCII STL and raise at the first one that is not what the grammar expects there."""
    state = 0
    last = 0
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        last = number
        if state == 0 and words[0].lower() in ("solid", "endsolid"):
            continue
        expected = _GRAMMAR[state].split()
        if [word.lower() for word in words[: len(expected)]] != expected:
            raise BadInput(
                f"{path}, line {number}: '{shown(line.strip(), 60)}' where '{_GRAMMAR[state]}' is expected; export it again."
            )
        wanted = 3 if expected[0] in ("facet", "vertex") else 0
        numbers = words[len(expected) :]
        if len(numbers) != wanted:
            raise BadInput(
                f"{path}, line {number}: {len(numbers)} numbers after '{_GRAMMAR[state]}', "
                f"{wanted} are expected; export it again."
            )
        for word in numbers if expected[0] == "vertex" else []:
            try:
                float(word)
            except ValueError:
                raise BadInput(f"{path}, line {number}: '{shown(word)}' is not a number; export it again.") from None
        state = (state + 1) % len(_GRAMMAR)
    if state:
        raise BadInput(f"{path}: ends at line {last} inside a facet ('{_GRAMMAR[state]}' is missing); copy it again.")


def _refuse_not_finite(path: Path, corners: Array) -> None:
    bad = ~np.isfinite(corners).all(axis=(1, 2)) | (np.abs(np.nan_to_num(corners)) > 1e9).any(axis=(1, 2))
    if bad.any():
        facet = int(np.argmax(bad))
        value = corners[facet].ravel()
        value = value[~np.isfinite(value) | (np.abs(np.nan_to_num(value)) > 1e9)][0]
        raise BadInput(
            f"{path}, facet {facet + 1}: a vertex coordinate is {value:g} ({int(bad.sum())} such facets), which is no "
            f"place on a blade; export it again."
        )
