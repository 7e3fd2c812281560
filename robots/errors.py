"""The two ways in which a command can say no."""


class BadInput(Exception):
    """What was handed in cannot be used; the message is one sentence that names file, place, value and remedy.

    Commands print it and exit with code 2.
    """


class Infeasible(Exception):
    """The input is sound but no safe result exists; the message names pass, waypoint, constraint and amount.

    Commands print it and exit with code 1.
    """


LONGEST_SHOWN = 40


def shown(value: object, most: int = LONGEST_SHOWN) -> str:
    """A value as a message echoes it: on one line, without what a terminal would obey, cut to `most` characters."""
    try:
        text = value if isinstance(value, str) else str(value)
    except ValueError:  # an integer of more digits than Python writes out
        text = f"a {type(value).__name__} too long to print"
    head = "".join(c if c.isprintable() else "?" for c in text[: most + 1])
    return head if len(text) <= most else f"{head[: most - 2]}.."
