"""The one error that a user can cause and a user can mend."""

import json
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails

OLDEST_VERSION = "0.2.0"
"""Version of the first package whose files are read."""

MOST_SCHEMAS = 10**6
"""Numbers of a schema are below this."""

LONGEST_GIVEN = 120
"""Characters of what was given that a message repeats, at most."""

LONGEST_MESSAGE = 4000
"""Characters of a message at most; one that repeats more is cut in its middle."""


class InputError(ValueError):
    """Input that cannot be used.

    The message is one line that says what was given, what is allowed and what to do.
    The command line prints it and ends with exit code 2.

    Examples
    --------
    >>> import deepfsi
    >>> try:
    ...     deepfsi.load_dataset("mnits")
    ... except deepfsi.InputError as error:
    ...     print(str(error).partition(" Known")[0])
    unknown data set 'mnits': did you mean 'mnist'?
    """

    def __str__(self) -> str:
        """The message, without what a terminal would take for a command."""
        words = "".join(each if each.isprintable() else " " for each in super().__str__())
        if len(words) <= LONGEST_MESSAGE:
            return words
        return f"{words[: LONGEST_MESSAGE // 2]} ... {words[-LONGEST_MESSAGE // 2 :]}"


def closest_choice(name: str, allowed: Iterable[str]) -> str:
    """Say what to write instead of an unknown name, as the end of an error message."""
    allowed = list(allowed)
    by_lower_case = {known.lower(): known for known in allowed}
    matches = get_close_matches(name.lower(), by_lower_case, n=1)
    names = ", ".join(allowed)
    if not matches:
        return f"give one of {names}"
    return f"did you mean '{by_lower_case[matches[0]]}'? Known: {names}"


def check_choice(what: str, name: str, known: Iterable[str]) -> None:
    """Raise `InputError` with the closest known name unless a name is known."""
    if name not in (known := list(known)):
        raise InputError(f"unknown {what} {name!r}: {closest_choice(name, known)}")


def other_version(content: str | bytes, schema: int, again: str = "make it again") -> str:
    """Say that an older or a newer package wrote a file, as its JSON has it, and what to do."""
    from importlib.metadata import version

    try:
        facts = json.loads(content)
        written = facts.get("deepfsi") or facts.get("provenance", {}).get("deepfsi")
        number = facts.get("schema", facts.get("schema_version", schema))
    except (ValueError, AttributeError, RecursionError):
        return ""
    release = _release(written)
    who = f"deepfsi {written}" if release else "a deepfsi"
    if type(number) is not int or not 0 < number < MOST_SCHEMAS:
        number = schema
    if number != schema:
        who += f" with schema {number}"
    if (release and release < _release(OLDEST_VERSION)) or number < schema:
        return f"was written by {who}, older than the files that are read: {again}"
    if release > _release(version("deepfsi")) or number > schema:
        return f"was written by {who}, newer than this one: upgrade deepfsi"
    return ""


def _release(version: object) -> tuple[int, ...]:
    """Numbers of a version, such as 0, 2, 0; none of what is no version."""
    found = re.match(r"(\d{1,6})\.(\d{1,6})\.(\d{1,6})(?!\d)", str(version))
    return tuple(map(int, found.groups())) if found else ()


@contextmanager
def as_input_error(
    file: str = "", advice: str = "", content: str | bytes = b"", schema: int = 1
) -> Iterator[None]:
    """Turn pydantic's errors into one `InputError`.

    Parameters
    ----------
    file, advice : str
        What cannot be used, and what to do.
    content : str or bytes
        Of the file, JSON, which may say that another version wrote it.
    schema : int
        Number of the file's schema in this version.
    """
    from pydantic import ValidationError

    try:
        yield
    except ValidationError as error:
        if words := other_version(content, schema, advice or "make it again"):
            raise InputError(f"{file} {words}") from None
        if not file:
            raise InputError("; ".join(field_errors(error))) from None
        fault = error.errors()[0]
        at, end = fault["loc"] and f" at {_place(fault)}", advice and f"; {advice}"
        raise InputError(f"{file} cannot be used{at or ''}: {_words(fault)}{end}") from None


def field_errors(error: "ValidationError") -> list[str]:
    """Every bad field of pydantic's error, with what was given."""
    return [
        (f"{_place(fault)}{_given(fault)}: " if fault["loc"] else "") + _words(fault)
        for fault in error.errors()
        if fault["type"] != "default_factory_not_called"  # what follows from a bad field
    ]


def _place(fault: "ErrorDetails") -> str:
    return ".".join(map(str, fault["loc"]))


def _given(fault: "ErrorDetails") -> str:
    """Value of a field in words; none of a table, whose faults name their own fields."""
    if isinstance(fault["input"], dict):
        return ""
    text = " ".join(repr(fault["input"]).split())
    return " = " + (text if len(text) <= LONGEST_GIVEN else f"{text[:LONGEST_GIVEN]} ...")


def _words(fault: "ErrorDetails") -> str:
    return f"{fault['msg'][0].lower()}{fault['msg'][1:]}".removeprefix("value error, ")
