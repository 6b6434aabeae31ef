"""The one error that a user can cause and a user can mend."""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError
    from pydantic_core import ErrorDetails


class InputError(ValueError):
    """Input that cannot be used.

    The message is one line that says what was given, what is allowed and what to do.
    Settings are named as in Python, `bins`, which the command line writes as --bins; it prints the
    message and ends with exit code 2.

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
        return one_line(str(self.args[0]))


def one_line(text: str) -> str:
    """Text of a message without what a terminal would take for a command, and not too long."""
    words = "".join(letter if letter.isprintable() else " " for letter in text)
    return words if len(words) <= 4000 else f"{words[:2000]} ... {words[-2000:]}"


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
        advice = closest_choice(name, known)
        raise InputError(f"unknown {what} {name!r}: {advice}")


@contextmanager
def as_input_error(file: str = "", advice: str = "") -> Iterator[None]:
    """Turn pydantic's errors into one `InputError`."""
    from pydantic import ValidationError

    try:
        yield
    except ValidationError as error:
        if not file:
            raise InputError("; ".join(field_errors(error))) from None
        fault = min(error.errors(), key=_order)
        where = f" at {_field(fault)}" if fault["loc"] else ""
        words = _words(fault, error.title) + (advice and f"; {advice}")
        raise InputError(f"{file} cannot be used{where}: {words}") from None


def _order(fault: "ErrorDetails") -> int:
    """Rank of a fault, 0 first: a wrong number of a file's schema explains all others."""
    if _field(fault) in ("schema", "schema_version"):
        return 0
    # A wrong name explains the missing field that it was meant for
    return 1 if fault["type"] == "extra_forbidden" else 2


def field_errors(
    error: "ValidationError", name: "Callable[[ErrorDetails], str] | None" = None
) -> list[str]:
    """One text for each bad field of pydantic's error, with its value."""
    name = name or _assignment
    return [
        name(fault) + _words(fault, error.title)
        for fault in error.errors()
        if fault["type"] != "default_factory_not_called"  # follows from another bad field
    ]


def _field(fault: "ErrorDetails") -> str:
    return ".".join(map(str, fault["loc"]))


def _assignment(fault: "ErrorDetails") -> str:
    """A field with its value, but for a table, whose faults name their own fields."""
    if not fault["loc"]:
        return ""
    if isinstance(fault["input"], dict):
        return f"{_field(fault)}: "
    try:
        text = " ".join(repr(fault["input"]).split())
    except ValueError:  # Python writes no number of more than 4300 digits
        text = "a number of too many digits"
    text = text if len(text) <= 120 else f"{text[:120]} ..."
    return f"{_field(fault)} = {text}: "


_ADVICE = {
    "missing": "it is missing: give one",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "give a whole number"),
    "int_parsing_size": "give a whole number of fewer digits",
    **dict.fromkeys(("float_type", "float_parsing"), "give a number"),
    "finite_number": "give a finite number",
    **dict.fromkeys(("bool_type", "bool_parsing"), "give true or false"),
    "string_type": "give a text",
    "greater_than": "give more than {gt}",
    "greater_than_equal": "give {ge} or more",
    "less_than": "give less than {lt}",
    "less_than_equal": "give {le} or less",
    "too_short": "give {min_length} or more of them",
    "too_long": "give {max_length} of them at most",
    **dict.fromkeys(("list_type", "tuple_type"), "give a list"),
    **dict.fromkeys(("dict_type", "model_attributes_type"), "give a table of settings"),
    "model_type": "give a table of settings, or {class_name}",
    "none_required": "leave it out",
}
"""Advice on an error of pydantic, by its type."""


def _words(fault: "ErrorDetails", model: str) -> str:
    """Advice on a fault of a model, or the message of an error that its own check raised."""
    from pydantic import BaseModel

    facts = fault.get("ctx", {})
    error = facts.get("error")
    if isinstance(error, InputError):
        return str(error)
    if fault["type"] == "extra_forbidden":
        names = _field_names(model, BaseModel) if len(fault["loc"]) == 1 else []
        advice = closest_choice(str(fault["loc"][-1]), names) if names else "leave it out"
        return f"there is no such setting: {advice}"
    if fault["type"] == "literal_error":
        names = re.findall(r"'([^']*)'", facts["expected"])
        if isinstance(fault["input"], str) and get_close_matches(fault["input"].lower(), names):
            return closest_choice(fault["input"], names)
        return f"give {facts['expected']}"
    if advice := _ADVICE.get(fault["type"], ""):
        return advice.format_map(
            {name: f"{fact:g}" if isinstance(fact, float) else fact for name, fact in facts.items()}
        )
    return f"{fault['msg'][0].lower()}{fault['msg'][1:]}".removeprefix("value error, ")


def _field_names(title: str, kind: type["BaseModel"]) -> list[str]:
    """Fields of the model of that name, among the subclasses of a kind."""
    for model in kind.__subclasses__():
        if model.__name__ == title:
            return [field.alias or name for name, field in model.model_fields.items()]
        if names := _field_names(title, model):
            return names
    return []
