"""The two ways in which a command can say no."""


class BadInput(Exception):
    """What was handed in cannot be used; the message is one sentence that names file, place, value and remedy.

    Commands print it and exit with code 2.
    """


class Infeasible(Exception):
    """The input is sound but no safe result exists; the message names pass, waypoint, constraint and amount.

    Commands print it and exit with code 1.
    """
