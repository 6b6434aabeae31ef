"""The one error that a user can cause and a user can mend."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

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


class Message(str):
    r"""Text that names settings: in Python as `bins`, on the command line as --bins.

    Parameters
    ----------
    template : str
        Text with a field, in braces, for each setting and each value. A setting may have a value
        after a colon: ``{light:free-dwell}`` is ``light="free-dwell"``, or ``--light free-dwell``.
        Without settings and values the template is the text.
    setting : str or tuple of str
        Settings it names, as Python does. If there is one, ``{setting}`` is that one, too.
    values
        Values of the other fields. Settings that a message or an error among them names are named
        in the same way.

    Examples
    --------
    >>> text = Message("{given} bins leave it: give fewer {bins}", setting="bins", given=64)
    >>> print(text, text.write(lambda name, value: f"--{name}"), sep="\n")
    64 bins leave it: give fewer `bins`
    64 bins leave it: give fewer --bins
    """

    template: str
    settings: tuple[str, ...]
    values: dict[str, Any]

    def __new__(
        cls, template: str, /, *, setting: str | tuple[str, ...] = (), **values: Any
    ) -> "Message":
        """Write the text as Python names settings."""
        settings = (setting,) if isinstance(setting, str) else setting
        self = super().__new__(cls, _written(template, settings, values, _in_python))
        self.template = template
        self.settings = settings
        self.values = values
        return self

    def write(self, name: Callable[[str, str], str]) -> str:
        """Text with settings as a function names them, of a setting and the value it is to have."""
        return _written(self.template, self.settings, self.values, name)


class _Setting:
    def __init__(self, setting: str, name: Callable[[str, str], str]) -> None:
        self.setting = setting
        self.name = name

    def __format__(self, value: str) -> str:
        return self.name(self.setting, value)


def _in_python(setting: str, value: str) -> str:
    if not value:
        return f"`{setting}`"
    return f"`{setting}={value}`" if value.isdecimal() else f'`{setting}="{value}"`'


def _written(
    template: str,
    settings: tuple[str, ...],
    values: Mapping[str, Any],
    name: Callable[[str, str], str],
) -> str:
    if not settings and not values:
        return template
    fields: dict[str, Any] = {setting: _Setting(setting, name) for setting in settings}
    if len(settings) == 1:
        fields["setting"] = fields[settings[0]]
    for field, value in values.items():
        message = value.message if isinstance(value, InputError) else value
        fields[field] = message.write(name) if isinstance(message, Message) else value
    return template.format_map(fields)


class InputError(ValueError):
    """Input that cannot be used.

    The message is one line that says what was given, what is allowed and what to do.
    The command line prints it and ends with exit code 2.

    Parameters
    ----------
    template : str
        The message, or its template, as of `Message`.
    setting, values
        Of the template.

    Examples
    --------
    >>> import deepfsi
    >>> try:
    ...     deepfsi.load_dataset("mnits")
    ... except deepfsi.InputError as error:
    ...     print(str(error).partition(" Known")[0])
    unknown data set 'mnits': did you mean 'mnist'?
    """

    def __init__(
        self, template: str = "", /, *, setting: str | tuple[str, ...] = (), **values: Any
    ) -> None:
        filled = Message(template, setting=setting, **values) if setting or values else template
        super().__init__(filled)

    @property
    def message(self) -> str:
        """The message, a `Message` if it names settings."""
        return self.args[0]

    def __str__(self) -> str:
        """The message, without what a terminal would take for a command."""
        return one_line(self.message)


def one_line(text: str) -> str:
    """Text of a message without what a terminal would take for a command, and not too long."""
    words = "".join(letter if letter.isprintable() else " " for letter in text)
    if len(words) <= LONGEST_MESSAGE:
        return words
    return f"{words[: LONGEST_MESSAGE // 2]} ... {words[-LONGEST_MESSAGE // 2 :]}"


def join_messages(messages: Iterable[str]) -> Message:
    """Messages in one line, which name settings as each of them does."""
    values = {f"message_{number}": message for number, message in enumerate(messages)}
    return Message("; ".join(f"{{{field}}}" for field in values), **values)


def closest_choice(name: str, allowed: Iterable[str]) -> str:
    """Say what to write instead of an unknown name, as the end of an error message.

    Parameters
    ----------
    name : str
        Unknown.
    allowed : iterable of str
        Names that there are.
    """
    allowed = list(allowed)
    by_lower_case = {known.lower(): known for known in allowed}
    matches = get_close_matches(name.lower(), by_lower_case, n=1)
    names = ", ".join(allowed)
    if not matches:
        return f"give one of {names}"
    return f"did you mean '{by_lower_case[matches[0]]}'? Known: {names}"


def check_choice(what: str, name: str, known: Iterable[str]) -> None:
    """Raise `InputError` with the closest known name unless a name is known.

    Parameters
    ----------
    what : str
        Kind of thing that the name is of, in a message.
    name : str
    known : iterable of str
        Names that there are.
    """
    if name not in (known := list(known)):
        advice = closest_choice(name, known)
        raise InputError("unknown {what} {name!r}: {advice}", what=what, name=name, advice=advice)


def other_version(content: str | bytes, schema: int, again: str = "make it again") -> str:
    """Say that an older or a newer package wrote a file, as its JSON has it, and what to do.

    Parameters
    ----------
    content : str or bytes
        JSON of the file. Where it says nothing of a version the answer is empty.
    schema : int
        Number of the file's schema in this version.
    again : str
        What to do with a file that is too old.
    """
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
            raise InputError(join_messages(field_errors(error))) from None
        fault = error.errors()[0]
        raise InputError(
            "{file} cannot be used{at}: {words}{end}",
            file=file,
            at=f" at {_field(fault)}" if fault["loc"] else "",
            words=_words(fault),
            end=advice and f"; {advice}",
        ) from None


def field_errors(error: "ValidationError") -> list[str]:
    """Every bad field of pydantic's error, with what was given."""
    return [
        Message("{field}{words}", field=_given(fault), words=_words(fault))
        for fault in error.errors()
        if fault["type"] != "default_factory_not_called"  # what follows from a bad field
    ]


def _field(fault: "ErrorDetails") -> str:
    return ".".join(map(str, fault["loc"]))


def _given(fault: "ErrorDetails") -> str:
    """A field with its value; that of a table is left out, as its faults name their own fields."""
    if not fault["loc"]:
        return ""
    if isinstance(fault["input"], dict):
        return f"{_field(fault)}: "
    text = " ".join(repr(fault["input"]).split())
    text = text if len(text) <= LONGEST_GIVEN else f"{text[:LONGEST_GIVEN]} ..."
    return f"{_field(fault)} = {text}: "


def _words(fault: "ErrorDetails") -> str:
    """Words of pydantic, or the message of an error that a model's own check raised."""
    error = fault.get("ctx", {}).get("error")
    if isinstance(error, InputError):
        return error.message
    return f"{fault['msg'][0].lower()}{fault['msg'][1:]}".removeprefix("value error, ")
