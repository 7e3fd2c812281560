"""Parser of KRL .src and .dat files, with a grammar of its own: it shares no code with what writes programs.

Strict, it takes the plain subset that KRL.md allows and refuses everything else with file and line. Tolerant, for
programs taught years ago, it also takes inline-form data (FDAT, PDAT, LDAT), waits, outputs and triggers; branches and
loops are refused, because then the text does not say which path the robot takes.
"""

from pathlib import Path

from robots.bounds import MEGABYTE, read_whole
from robots.errors import BadInput, shown
from trajectories.krl import syntax
from trajectories.krl.lexer import LONGEST_TOKEN, TokenLine

BRANCHES = frozenset(
    "IF ELSE ENDIF FOR ENDFOR WHILE ENDWHILE LOOP ENDLOOP REPEAT UNTIL SWITCH CASE DEFAULT ENDSWITCH GOTO EXIT RETURN".split()
)
HARMLESS = frozenset("WAIT HALT CONTINUE PULSE TRIGGER ANOUT ANIN SIGNAL CONFIRM RESUME BRAKE STRUC ENUM IMPORT".split())
REFUSED_MOTIONS = frozenset("CIRC SCIRC PTP_REL LIN_REL CIRC_REL SPTP_REL SLIN_REL SPL_REL SCIRC_REL ASYPTP".split())
MOST_PROGRAM_BYTES = 5 * MEGABYTE  # some 50 000 points; a controller's memory holds fewer
LONGEST_LINE = 10_000  # characters; editors of controllers show some hundred
LARGEST_NUMBER = 2.0**31  # an INT of the controller; as millimetres or seconds far beyond everything
DEEPEST = 5  # aggregates in each other; $LOAD and FDAT have two
APPROXIMATIONS = frozenset("C_PTP C_DIS C_VEL C_ORI C_SPL".split())


def read_module(path: Path, strict: bool = True) -> syntax.Module:
    """The statements of one .src or .dat file.

    Raises BadInput, which names file and line: not KRL, or not the part of KRL that is allowed; a file that is absent.
    """
    path = Path(path)
    data = read_whole(path, MOST_PROGRAM_BYTES, "a KRL file").removeprefix(b"\xef\xbb\xbf")  # editors put it before text
    return parse_text(data.decode("ascii" if data.isascii() else "latin-1"), path, strict)


def parse_text(text: str, path: Path, strict: bool = True) -> syntax.Module:
    """The statements of a file's text; `path` is for messages and for the module's identity."""
    statements: list[syntax.Statement] = []
    ended = False
    for number, raw in enumerate(text.split("\n"), start=1):
        line = raw.rstrip("\r")
        if not line.strip():
            continue
        if len(line) > LONGEST_LINE:
            raise BadInput(
                f"{path.name}, line {number}: {len(line)} characters, the limit is {LONGEST_LINE}; this is no KRL program"
            )
        if ended and strict and not line.strip().startswith(";"):
            raise BadInput(f"{path.name}, line {number}: '{shown(line.strip())}' stands after END; nothing may follow it")
        if ended:
            break  # local sub-programs of an old file are not the program
        statement = _statement(line, path.name, number, strict)
        statements.append(statement)
        ended = isinstance(statement, syntax.Ending)
    kinds = [s for s in statements if isinstance(s, syntax.Definition)]
    last = len(text.rstrip().split("\n"))
    if not kinds:
        raise BadInput(f"{path.name}, line 1: no DEF or DEFDAT; this is no KRL program")
    if len(kinds) > 1:
        raise BadInput(f"{path.name}, line {kinds[1].line}: a second {kinds[1].kind}; one program a file, and is END missing?")
    wanted = "ENDDAT" if kinds[0].kind == "DEFDAT" else "END"
    if not ended:
        raise BadInput(f"{path.name}, line {last}: the file ends without {wanted}; it is cut off")
    ending = statements[-1]
    if isinstance(ending, syntax.Ending) and ending.kind != wanted:
        raise BadInput(f"{path.name}, line {ending.line}: {ending.kind} ends a {kinds[0].kind}; expected {wanted}")
    return syntax.Module(path, tuple(statements))


def _statement(text: str, file: str, number: int, strict: bool) -> syntax.Statement:
    stripped = text.strip()
    if stripped.startswith("&"):
        return syntax.Header(number, stripped)
    if stripped.startswith(";"):
        return syntax.Remark(number, stripped[1:])
    line = TokenLine(file, number, text)
    first = line.peek()
    word = first.text.upper()
    if first.kind != "name":
        raise line.error(f"'{shown(stripped)}' is no statement")
    if word in ("DEF", "DEFDAT"):
        return _definition(line)
    if word in ("END", "ENDDAT"):
        line.take()
        line.finish()
        return syntax.Ending(number, word)
    if word in syntax.MOTIONS:
        return _motion(line, strict)
    if word in syntax.BLOCKS and line.peek(1).text != "=":
        return _block_start(line, strict)
    if word == "ENDSPLINE":
        line.take()
        if not strict:
            _approximation(line)
        line.finish()
        return syntax.BlockEnd(number)
    if word == "TIME_BLOCK":
        return _time_block(line)
    if word in ("INTERRUPT", "GLOBAL") and "INTERRUPT" in (word, line.peek(1).text.upper()):
        return syntax.Interrupt(number, line.rest())
    if word in BRANCHES:
        raise line.error(f"{word} decides at run time which way the program goes; only straight programs can be read")
    if word in REFUSED_MOTIONS:
        raise line.error(f"{word} is not supported; use PTP, LIN, SPTP, SLIN or SPL")
    if word in ("HALT", "WAIT") and strict:
        return _pause(line)
    if word in HARMLESS and not strict:
        return syntax.Other(number, line.rest())
    return _declaration_or_plain(line, strict)


def _definition(line: TokenLine) -> syntax.Definition:
    kind = line.take().text.upper()
    name = line.expect_name(f"a name after {kind}")
    if kind == "DEF":
        line.expect("(")
        line.expect(")", "; programs with parameters cannot be started")
    else:
        line.accept("PUBLIC")
    line.finish()
    return syntax.Definition(line.number, kind, name)


def _block_start(line: TokenLine, strict: bool) -> syntax.BlockStart:
    kind = line.take().text.upper()
    clause = "" if strict else _clause(line)
    line.finish()
    return syntax.BlockStart(line.number, kind, clause)


def _motion(line: TokenLine, strict: bool) -> syntax.MotionStatement:
    kind = line.take().text.upper()
    target: syntax.Value
    if line.peek().text == "{":
        target = _aggregate(line)
    elif not strict:
        target = syntax.Word(line.expect_name(f"a position after {kind}").upper())
        if line.accept("["):
            target = syntax.Word(f"{target.text}[{line.take().text}]")
            line.expect("]")
        if line.peek().text == ":":
            raise line.error("a position made of two by the geometric operator ':' cannot be read")
    else:
        raise line.error(f"expected '{{' after {kind} and found '{line.peek().text or 'the end of the line'}'")
    approximation = _approximation(line)
    clause = "" if strict else _clause(line)
    line.finish()
    return syntax.MotionStatement(line.number, kind, target, approximation, clause)


def _clause(line: TokenLine) -> str:
    """What stands behind WITH, to the end of the line; empty without."""
    return line.rest() if line.accept("WITH") else ""


def _approximation(line: TokenLine) -> str:
    found = ""
    while line.peek().text.upper() in APPROXIMATIONS:
        found = found or line.peek().text.upper()
        line.take()
    return found


def _time_block(line: TokenLine) -> syntax.TimeBlock:
    line.take()
    what = line.expect_name("START, PART or END after TIME_BLOCK").upper()
    if what not in ("START", "PART", "END"):
        raise line.error(f"TIME_BLOCK {what} is not one of START, PART, END")
    value = None
    if what != "START":
        line.expect("=")
        value = _number(line)
    line.finish()
    return syntax.TimeBlock(line.number, what, value)


def _pause(line: TokenLine) -> syntax.PauseStatement:
    """HALT, WAIT SEC with a literal, or WAIT FOR $IN[n]: what a measuring program stands still by."""
    halt = line.take().text.upper() == "HALT"
    seconds = _number(line) if not halt and line.accept("SEC") else None
    number = None
    if not halt and seconds is None:
        for part in ("FOR", "$IN", "["):
            line.expect(part)
        number = _number(line)
        line.expect("]")
    line.finish()
    return syntax.PauseStatement(line.number, seconds, number)


def _number(line: TokenLine) -> syntax.Number:
    sign = ""
    while line.peek().text in ("+", "-"):
        sign += line.take().text
    token = line.take()
    if token.kind != "number":
        raise line.error(f"expected a number and found '{token.text or 'the end of the line'}'")
    text = sign + token.text
    if len(text) > LONGEST_TOKEN or not float(token.text) <= LARGEST_NUMBER:
        raise line.error(f"{shown(text)} is beyond {LARGEST_NUMBER:.0f}, the largest number of a program")
    return syntax.Number(float(token.text) * (-1.0 if sign.count("-") % 2 else 1.0), text)


def _aggregate(line: TokenLine, depth: int = 1) -> syntax.Aggregate:
    if depth > DEEPEST:
        raise line.error(f"braces stand more than {DEEPEST} deep in each other")
    line.expect("{")
    if line.peek().kind == "name" and line.peek(1).text == ":":  # {E6POS: X ..}
        line.take()
        line.take()
    items: list[tuple[str, syntax.Value]] = []
    while True:
        name = line.expect_name("the name of a component (or is this a decimal comma?)").upper()
        if line.accept("["):
            line.expect("]")
            name += "[]"
        if name in dict(items):
            raise line.error(f"component {name} is given twice")
        items.append((name, _value(line, depth)))
        if not line.accept(","):
            break
    line.expect("}", "; is a brace missing?")
    return syntax.Aggregate(tuple(items))


def _value(line: TokenLine, depth: int = 0) -> syntax.Value:
    token = line.peek()
    if token.text == "{":
        return _aggregate(line, depth + 1)
    if token.kind == "number" or token.text in ("-", "+"):
        return _number(line)
    if token.kind in ("enum", "string", "name", "bits"):
        return syntax.Word(line.take().text)
    raise line.error(f"expected a value and found '{token.text or 'the end of the line'}'")


def _declaration_or_plain(line: TokenLine, strict: bool) -> syntax.Statement:
    word, second = line.peek().text.upper(), line.peek(1)
    if word in ("EXT", "EXTFCT"):
        line.take()
        return syntax.Declaration(line.number, "EXT", line.rest(), None)
    if word in ("DECL", "GLOBAL", "CONST") or (second.kind == "name" and word.isidentifier()):
        return _declaration(line, strict)
    name = line.take().text
    if line.peek().text == "(":
        return _call(line, name)
    index = ""
    if line.accept("["):
        index = f"[{line.take().text}]" if line.peek().text != "]" else "[]"
        line.expect("]")
    while line.accept("."):
        index += "." + line.expect_name("a component").upper()
    if line.accept("="):
        return syntax.Assignment(line.number, name.upper() + index, _right_side(line, strict))
    raise line.error(f"'{shown(line.text.strip())}' is no statement of the KRL that may be used here")


def _right_side(line: TokenLine, strict: bool) -> syntax.Value:
    value = _value(line)
    if isinstance(value, syntax.Word) and line.accept("["):
        value = syntax.Word(f"{value.text.upper()}[{line.take().text}]")
        line.expect("]")
    if strict:
        line.finish()
    elif line.peek().kind != "end":
        value = syntax.Word(f"expression {line.rest()}")
    return value


def _declaration(line: TokenLine, strict: bool) -> syntax.Declaration:
    while line.peek().text.upper() in ("DECL", "GLOBAL", "CONST"):
        line.take()
    kind = line.expect_name("a type").upper()
    name = line.expect_name("a name after the type")
    if line.accept("["):
        name += "[" + line.rest().split("]")[0].replace(" ", "") + "]" if not strict else ""
    value = _right_side(line, strict) if line.accept("=") else None
    if strict:
        line.finish()
    return syntax.Declaration(line.number, kind, name, value)


def _call(line: TokenLine, name: str) -> syntax.Call:
    line.expect("(")
    text = line.rest()
    if not text.endswith(")"):
        raise line.error(f"the call of {name} has no closing bracket")
    return syntax.Call(line.number, name, tuple(a.strip() for a in text[:-1].split(",") if a.strip()))
