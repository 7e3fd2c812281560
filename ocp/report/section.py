"""What a report is made of: a headline and sections; what stands in a section draws itself on the page and on paper.

This module imports nothing that draws: a command's last line needs a headline and no pictures.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from markupsafe import Markup


@dataclass(frozen=True)
class Headline:
    """The first thing to read: whether all is well (`good`; `doubtful`: but for what the sentence says), that in a few words, one
    sentence or two, and facts as (question, answer)."""

    good: bool
    verdict: str
    sentence: str
    facts: tuple[tuple[str, str], ...] = ()
    doubtful: bool = False

    @property
    def tone(self) -> str:
        """The class of its box: safe, doubtful or unsafe."""
        return "unsafe" if not self.good else "doubtful" if self.doubtful else "safe"

    @property
    def mark(self) -> str:
        """The sign before it."""
        return "✓" if self.tone == "safe" else "!"


class Part(Protocol):
    """What may stand in a section. These verbs are all that the kit asks of it; ocp/report/parts.py has the usual ones, a
    command may bring its own."""

    def on_page(self) -> "Markup":
        """Itself as HTML without style attributes; whatever came from a user is escaped."""

    def on_paper(self) -> dict[str, Any]:
        """Itself as data for paper.typ: what it `is` there (paragraph, points, facts, table, plot, panels), and that one's
        words and pictures."""


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it, in order; a string is a paragraph.

    `style` and `script` are what the parts need of CSS and JavaScript beside the page's own: files' texts, never a user's words.
    """

    title: str
    parts: tuple[Part | str, ...]
    style: str = ""
    script: str = ""
