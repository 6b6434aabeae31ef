"""The one error that a user can cause and a user can mend."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

__all__ = ["InputError", "closest"]


class InputError(ValueError):
    """Something given from outside cannot be used.

    The message is one line that says what was given, what is allowed and what to do.
    The command line prints it and ends with exit code 2.
    """


def closest(name: str, allowed: Iterable[str]) -> str:
    """Say what to write instead of an unknown name, as the end of an error message.

    Parameters
    ----------
    name
        What was given.
    allowed
        The names that are known, in the order in which to list them.

    Returns
    -------
    str
        ``"did you mean 'mnist'? Known: digits, mnist"``, or the list alone where nothing is close.

    Examples
    --------
    >>> closest("MNITS", ["digits", "mnist"])
    "did you mean 'mnist'? Known: digits, mnist"
    """
    allowed = list(allowed)
    by_lower_case = {known.lower(): known for known in allowed}
    matches = get_close_matches(name.lower(), by_lower_case, n=1)
    guess = f"did you mean '{by_lower_case[matches[0]]}'? " if matches else ""
    return f"{guess}Known: {', '.join(allowed)}"
