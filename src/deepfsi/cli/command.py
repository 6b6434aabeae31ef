"""Commands: a model of the settings, with what it does; its options, and how it is run.

A command is one class. Its fields are arguments and options, `run` does the work and gives an
`Outcome`. All that commands have in common is here: what `--help` says of a field, the reading of
texts, `--json`, and the checks of what is written to.
"""

import inspect
import shlex
import sys
from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import click
from pydantic import BeforeValidator, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from deepfsi.base import (
    STOPPED_EXIT_CODE,
    InputError,
    field_errors,
    join_messages,
    readable_name,
    seconds,
    time_text,
)
from deepfsi.base.models import StrictModel
from deepfsi.cli.fields import FIRST, OptionsOf, Output, Written
from deepfsi.cli.terminal import Outcome, Terminal

ONE_VALUE = ("camera", "hidden")
"""Options of one value where others are axes."""

KIND_WORDS = {int: "int", float: "number", Path: "path"}
"""Words for what is written of a type; others are text."""


class Command(StrictModel):
    """Settings of a command, and what it does.

    Its docstring has the name of the command on the first line. What follows is its help.
    """

    model_config = ConfigDict(allow_inf_nan=False)

    @abstractmethod
    def run(self, terminal: Terminal) -> Outcome:
        """Do the work.

        Parameters
        ----------
        terminal : Terminal
            Where progress is shown, and what is found before the end is said.
        """

    def explicit(self, fields: Iterable[str]) -> dict[str, Any]:
        """Those of these fields that stand on the command line, by name."""
        return {name: getattr(self, name) for name in fields if name in self.model_fields_set}


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """An argument or an option of a command.

    Parameters
    ----------
    key : str
        Name of its value.
    names : tuple of str
        As it is written: ``("--out", "-o")``; of an argument that in the usage.
    words : str
        Help.
    kind : str
        What is written: ``number``, ``time``, ``dual|single``. Empty of an option without a value.
    bounds, default : str
        Values that are allowed, and what holds where none is given; empty where there is nothing to
        say.
    heading : str
        In the help.
    required, is_argument, repeated : bool
        True if it must be given, if it has no name, if it may be given more than once.
    """

    key: str
    names: tuple[str, ...]
    words: str
    kind: str
    bounds: str = ""
    default: str = ""
    heading: str = FIRST
    required: bool = False
    is_argument: bool = False
    repeated: bool = False

    @property
    def metavar(self) -> str:
        """What is written after the name of an option."""
        return f"<{self.kind}{' …' * self.repeated}>" if self.kind else ""

    @property
    def help(self) -> str:
        """Help with bounds and default."""
        default = f"default: {self.default}" if self.default else ""
        notes = [default, self.bounds, "required" if self.required else ""]
        notes = [note for note in notes if note]
        return f"{self.words}  [{'; '.join(notes)}]" if notes else self.words

    def for_click(self) -> click.Parameter:
        """What parses it: any text, which the model reads."""
        if self.is_argument:
            return click.Argument(
                [self.key],
                required=self.required,
                nargs=-1 if self.repeated else 1,
                metavar=self.names[0],
                type=str,
            )
        return click.Option(
            [self.key, *self.names],
            is_flag=None if self.kind else True,
            multiple=self.repeated,
            required=self.required,
            metavar=self.metavar or None,
            help=self.help,
            type=str if self.kind else bool,
        )


JSON = Parameter(key="json", names=("--json",), words="print JSON and nothing else", kind="")
"""The option that every command has."""


def read_parameters(command: type[Command]) -> list[Parameter]:
    """Arguments and options of a command in the order of its help, that of JSON last of the first.

    Parameters
    ----------
    command : type of Command
    """
    first: list[Parameter] = []
    own: list[Parameter] = []
    others: list[Parameter] = []
    for name, field in command.model_fields.items():
        derived = next((each for each in field.metadata if isinstance(each, OptionsOf)), None)
        if derived is None:
            own.append(_parameter(field.alias or name, field))
            continue
        for option, (heading, of_model) in derived.fields.items():
            made = _derived(option, heading, of_model, derived.axes)
            (first if heading == FIRST else others).append(made)
    return [*first, *own, JSON, *others]


def _parameter(key: str, field: FieldInfo) -> Parameter:
    kind, bounds, several = _written(field)
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    is_argument = "argument" in extra
    unset = field.is_required() or field.default is None or field.default is False
    default = "" if unset or field.default == () else str(field.default)
    option = f"--{key.replace('_', '-')}"
    return Parameter(
        key=key,
        names=(str(extra["argument"] or key),)
        if is_argument
        else (option, "-o")
        if key == "out"
        else (option,),
        words=field.description or "",
        kind=kind,
        bounds=bounds,
        default=default,
        required=field.is_required(),
        is_argument=is_argument,
        repeated=several,
    )


def _derived(name: str, heading: str, field: FieldInfo, axes: bool) -> Parameter:
    kind, bounds, _ = _written(field)
    default = ""
    if axes:
        kind += ",…" if kind and name not in ONE_VALUE else ""
    elif _has_default(heading, field):
        value = field.default
        default = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
    return Parameter(
        key=name,
        names=(f"--{name.replace('_', '-')}",),
        words=field.description or "",
        kind=kind,
        bounds=bounds,
        default=default,
        heading=heading,
    )


def _has_default(heading: str, field: FieldInfo) -> bool:
    """True where a default holds whatever else is given, as it does not in a camera."""
    told = (
        heading == "Camera" or field.annotation is bool or "unless given" in str(field.description)
    )
    return not told and isinstance(field.default, str | int | float | tuple)


def _written(field: FieldInfo) -> tuple[str, str, bool]:
    """Kind and bounds of what is written for a field, and whether it may be given again."""
    leaves = list(_leaves(field.annotation, tuple(field.metadata)))
    kind, metadata = leaves[0]
    form = next((each.form for each in metadata if isinstance(each, Written)), "")
    readers = [each.func for each in metadata if isinstance(each, BeforeValidator)]
    if seconds in readers:
        return "time", _bounds(metadata, time_text), False
    if form:
        return form, "", False
    if get_origin(kind) is Literal:
        return "|".join(map(str, get_args(kind))), "", False
    if get_origin(kind) in (tuple, list):
        of_each, _ = next(_leaves(get_args(kind)[0]))
        word = KIND_WORDS.get(of_each, "text")
        return (f"{word},…", "", False) if readers else (word, "", True)
    if kind is bool:
        return "", "", False
    return KIND_WORDS.get(kind, "text"), _bounds(metadata, lambda number: f"{number:g}"), False


def _leaves(annotation: Any, metadata: tuple[Any, ...] = ()) -> Iterator[tuple[Any, list[Any]]]:
    """Types among which a value may be, but for None, each with what is declared of it."""
    if get_origin(annotation) is Annotated:
        base, *more = get_args(annotation)
        yield from _leaves(base, (*metadata, *more))
    elif get_origin(annotation) in (Union, UnionType):
        for each in get_args(annotation):
            if each is not NoneType:
                yield from _leaves(each, metadata)
    else:
        told = [each.metadata if isinstance(each, FieldInfo) else [each] for each in metadata]
        yield annotation, [each for group in told for each in group]


def _bounds(metadata: list[Any], text: Any) -> str:
    """Bounds of a number, in words."""
    limits = {
        name: text(getattr(each, name))
        for each in metadata
        for name in ("ge", "gt", "le", "lt")
        if getattr(each, name, None) is not None
    }
    low = limits.get("ge") or (f"above {limits['gt']}" if "gt" in limits else "")
    high = limits.get("le") or (f"below {limits['lt']}" if "lt" in limits else "")
    if low and high:
        return f"{low} to {high}"
    if low:
        return low if "gt" in limits else f"{low} or more"
    return high if "lt" in limits else f"{high} or less" if high else ""


class ClickCommand(click.Command):
    """A command as `click` runs it.

    Parameters
    ----------
    command : type of Command
    summary : str
        First sentence of its help.
    """

    def __init__(self, command: type[Command], name: str, summary: str) -> None:
        self.command = command
        self.declared = read_parameters(command)
        _, _, rest = inspect.cleandoc(command.__doc__ or "").partition("\n\n")
        super().__init__(
            name,
            params=[each.for_click() for each in self.declared],
            help=f"{summary}\n\n{rest}",
        )

    def invoke(self, ctx: click.Context) -> None:
        """Read the settings, check what is written to, run, and print what was found."""
        given = {
            name: value for name, value in ctx.params.items() if value not in (None, False, ())
        }
        as_json = given.pop("json", False)
        settings = self._read(given, ctx.command_path)
        for name, field in self.command.model_fields.items():
            for output in field.metadata:
                if isinstance(output, Output) and (path := getattr(settings, name)) is not None:
                    output.check(path, getattr(settings, "force", False))
        typed = shlex.join(["deepfsi", *map(readable_name, sys.argv[1:])])
        terminal = Terminal(as_json, typed)
        try:
            outcome = settings.run(terminal)
        except KeyboardInterrupt:  # of which `click` would make an empty line
            ctx.exit(STOPPED_EXIT_CODE)
        terminal.write(outcome, ctx.command_path.partition(" ")[2].replace(" ", "."))
        if outcome.refusal:
            raise InputError(outcome.refusal)
        if outcome.failed:
            ctx.exit(1)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write arguments and options under their headings, in the order of those."""
        headings: dict[str, list[tuple[str, str]]] = {}
        for each in self.declared:
            if each.is_argument:
                row = f"{each.names[0]} {each.metavar}", each.help
                headings.setdefault("Arguments", []).append(row)
        help_option = self.get_help_option(ctx)
        for each in self.declared:
            if not each.is_argument:
                names = ", ".join(sorted(each.names, key=len))
                row = f"{names} {each.metavar}".rstrip(), each.help
                headings.setdefault(each.heading, []).append(row)
            if each is JSON and help_option is not None:
                headings[FIRST].append(help_option.get_help_record(ctx) or ("", ""))
        for heading, rows in headings.items():
            with formatter.section(heading):
                formatter.write_dl(rows)

    def _read(self, given: dict[str, Any], path: str) -> Command:
        """Settings of texts, or `InputError` that names every option that cannot be read."""
        for name, field in self.command.model_fields.items():
            for derived in field.metadata:
                if isinstance(derived, OptionsOf):
                    given[name] = {
                        option: given.pop(option) for option in derived.fields if option in given
                    }
        names = {each.key: each.names[0] for each in self.declared}

        def name_of(fault: ErrorDetails) -> str:
            error = fault.get("ctx", {}).get("error")
            if isinstance(error, InputError):  # which says all
                return ""
            name = names[str(fault["loc"][0])]
            return f"{name}: " if error else f"{name} {shlex.quote(str(fault['input']))}: "

        try:
            return self.command.model_validate(given)
        except ValidationError as error:
            faults = join_messages(field_errors(error, name_of))
            if not any(map(name_of, error.errors())):
                raise InputError("{faults}", faults=faults) from None
            raise InputError("{faults}; see `{path} --help`", faults=faults, path=path) from None
