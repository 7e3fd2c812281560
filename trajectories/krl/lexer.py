"""KRL lines as tokens."""

import re
from dataclasses import dataclass

from robots.errors import BadInput, shown

LONGEST_TOKEN = 40  # characters: names have at most 24, numbers fewer; strings and comments are no names
LONGEST_STRING = 1000

TOKEN = re.compile(
    r"""\s*(?:
    (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
  | (?P<bits>'[BHbh][0-9A-Fa-f]+')
  | (?P<string>"[^"]*")
  | (?P<enum>\#[A-Za-z_]\w*)
  | (?P<name>[A-Za-z_$][\w$]*)
  | (?P<op>==|<>|<=|>=|[{}\[\](),:=<>+\-*/.])
  )""",
    re.VERBOSE | re.ASCII,
)


@dataclass(frozen=True)
class Token:
    """One token: `kind` number, bits, string, enum, name or op; names keep their letters as written."""

    kind: str
    text: str


class TokenLine:
    """The tokens of one line, taken from the left; errors name file and line.

    The one object of the reader with a state: the position in the line.
    """

    def __init__(self, file: str, number: int, text: str) -> None:
        self.file, self.number, self.text = file, number, text
        self.tokens = self._tokens(_without_comment(text))
        self.position = 0

    def _tokens(self, text: str) -> list[Token]:
        found, position = [], 0
        text = text.rstrip()
        while position < len(text):
            match = TOKEN.match(text, position)
            if match is None:
                raise self.error(f"'{shown(text[position:].strip(), 20)}' is not KRL")
            kind = match.lastgroup or ""
            token = Token(kind, match.group(kind))
            if len(token.text) > (LONGEST_STRING if kind == "string" else LONGEST_TOKEN):
                raise self.error(
                    f"'{shown(token.text)}' has {len(token.text)} characters; no {kind} of the language is that long"
                )
            found.append(token)
            position = match.end()
        return found

    def error(self, message: str) -> BadInput:
        """The refusal that names this line."""
        return BadInput(f"{self.file}, line {self.number}: {message}")

    def peek(self, ahead: int = 0) -> Token:
        """The next token, or an empty one at the end of the line."""
        i = self.position + ahead
        return self.tokens[i] if i < len(self.tokens) else Token("end", "")

    def take(self) -> Token:
        """The next token, which is consumed."""
        token = self.peek()
        self.position += 1
        return token

    def accept(self, text: str) -> bool:
        """Consume the next token if it is `text`, without regard to case."""
        if self.peek().text.upper() == text:
            self.position += 1
            return True
        return False

    def expect(self, text: str, why: str = "") -> None:
        """Consume `text`, or refuse the line."""
        if not self.accept(text):
            got = self.peek().text or "the end of the line"
            raise self.error(f"expected '{text}' and found '{got}'{why}")

    def expect_name(self, what: str) -> str:
        """Consume a name, or refuse the line."""
        token = self.take()
        if token.kind != "name":
            raise self.error(f"expected {what} and found '{token.text or 'the end of the line'}'")
        return token.text

    def finish(self) -> None:
        """Refuse the line if something is left."""
        if self.position < len(self.tokens):
            raise self.error(f"'{shown(self.peek().text)}' is too much in this line")

    def rest(self) -> str:
        """The remaining tokens as text, consumed."""
        left = self.tokens[self.position :]
        self.position = len(self.tokens)
        return " ".join(t.text for t in left)


def _without_comment(text: str) -> str:
    quoted = False
    for i, c in enumerate(text):
        quoted ^= c == '"'
        if c == ";" and not quoted:
            return text[:i]
    return text
