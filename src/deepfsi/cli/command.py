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
from pydantic_core import ErrorDetails, PydanticUndefined

from deepfsi.base.errors import InputError, field_errors
from deepfsi.base.files import readable_name
from deepfsi.base.interrupts import STOPPED_EXIT_CODE
from deepfsi.base.models.strict import StrictModel
from deepfsi.base.quantities import seconds, time_text
from deepfsi.camera.camera import Camera
from deepfsi.cli.fields import FIRST, OptionsOf, Output, Written, job_options
from deepfsi.cli.terminal import Outcome, Terminal, as_options, option_name

ONE_VALUE = ("camera", "hidden")
"""Options of one value where others are axes."""

MOST_DIGITS = 1e10
"""Bound from which on bounds have an exponent."""

KIND_WORDS = {int: "int", float: "number", Path: "path"}
"""Words for what is written of a type; others are text."""


class Command(StrictModel):
    """Settings of a command, and what it does.

    Its docstring has the name of the command on the first line. What follows is its help.
    """

    model_config = ConfigDict(allow_inf_nan=False)

    @abstractmethod
    def run(self, terminal: Terminal) -> Outcome:
        """Do the work."""

    def explicit(self, fields: Iterable[str]) -> dict[str, Any]:
        """Those of these fields that stand on the command line, by name."""
        return {name: getattr(self, name) for name in fields if name in self.model_fields_set}

    @classmethod
    def option(cls, name: str) -> str:
        """Option of a field, or of a setting among its options: --settle of `settle_s`."""
        field = cls.model_fields.get(name)
        return option_name((field and field.alias) or name)


@dataclass(frozen=True)
class Parameter:
    """An argument or an option of a command."""

    key: str  # name of its value
    field: FieldInfo
    heading: str = FIRST
    source: OptionsOf | None = None  # of a field that stands in a model of a lower room

    @property
    def is_argument(self) -> bool:
        """True if it has no name on the command line."""
        return "argument" in self._extra

    @property
    def hidden(self) -> bool:
        """True if no help lists it."""
        return "hidden" in self._extra

    @property
    def names(self) -> tuple[str, ...]:
        """As it is written: ``("--out", "-o")``; of an argument that in the usage."""
        if self.is_argument:
            return (self._extra["argument"] or self.key,)
        option = option_name(self.key)
        return (option, "-o") if self.key == "out" else (option,)

    @property
    def kind(self) -> str:
        """Form of a value: ``number``, ``time``, ``dual|single``; empty of an option alone."""
        kind, metadata = self._value
        word = "" if kind is bool else KIND_WORDS.get(kind, "text")
        readers = _readers(metadata)
        if seconds in readers:
            word = "time"
        elif forms := [each.form for each in metadata if isinstance(each, Written)]:
            [word] = forms
        elif get_origin(kind) is Literal:
            word = "|".join(map(str, get_args(kind)))
        elif get_origin(kind) in (tuple, list):
            item, _ = next(_leaves(get_args(kind)[0]))
            word = KIND_WORDS.get(item, "text") + ",…" * bool(readers)
        axis = self.source is not None and self.source.axes and self.key not in ONE_VALUE
        return f"{word},…" if word and axis else word

    @property
    def repeated(self) -> bool:
        """True if it may be given more than once."""
        kind, metadata = self._value
        return get_origin(kind) in (tuple, list) and not _readers(metadata)

    @property
    def bounds(self) -> str:
        """Values that are allowed, in words; empty where there is nothing to say."""
        _, metadata = self._value
        text = time_text if seconds in _readers(metadata) else _number_text
        limits = {
            name: text(getattr(each, name))
            for each in metadata
            for name in ("ge", "gt", "le", "lt")
            if getattr(each, name, None) is not None
        }
        above = f"above {limits['gt']}" if "gt" in limits else ""
        below = f"below {limits['lt']}" if "lt" in limits else ""
        low = limits.get("ge", above)
        high = limits.get("le", below)
        if low and high:
            return f"{low} to {high}"
        return above or below or (f"{low} or more" if low else f"{high} or less" if high else "")

    @property
    def default(self) -> str:
        """Value that holds where none is given; empty where it depends on what else is given."""
        value = self.field.default
        words = str(self.field.description)
        if self.source is not None and (
            self.source.axes or self.heading == "Camera" or "unless given" in words
        ):
            return ""
        if value is None or value is PydanticUndefined or isinstance(value, bool):
            return ""
        between = next((each.between for each in self._value[1] if isinstance(each, Written)), ",")
        return between.join(map(str, value)) if isinstance(value, tuple) else str(value)

    @property
    def required(self) -> bool:
        """True if it must be given."""
        return self.source is None and self.field.is_required()

    @property
    def metavar(self) -> str:
        """Form of its value, as it stands after the name of an option."""
        return f"<{self.kind}{' …' * self.repeated}>" if self.kind else ""

    @property
    def help(self) -> str:
        """Help with default and bounds."""
        default = f"default: {self.default}" if self.default else ""
        notes = filter(None, [default, self.bounds, "required" if self.required else ""])
        text = "; ".join(notes)
        return f"{self.field.description}  [{text}]" if text else str(self.field.description)

    def for_click(self) -> click.Parameter:
        """Parser of it: of any text, which the model reads."""
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
            hidden=self.hidden,
            type=str if self.kind else bool,
        )

    @property
    def _extra(self) -> dict[str, Any]:
        extra = self.field.json_schema_extra
        return extra if isinstance(extra, dict) else {}

    @property
    def _value(self) -> tuple[Any, list[Any]]:
        """Type of a value, the first of several, and what is declared of it."""
        return next(_leaves(self.field.annotation, tuple(self.field.metadata)))


def _number_text(number: float) -> str:
    """A bound: 4096, 0.3, 1e15."""
    exact = float(number).is_integer() and abs(number) < MOST_DIGITS
    return str(int(number)) if exact else f"{number:g}".replace("e+", "e")


def _readers(metadata: list[Any]) -> list[Any]:
    """Functions that read a value of a text."""
    return [each.func for each in metadata if isinstance(each, BeforeValidator)]


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
        groups = [each.metadata if isinstance(each, FieldInfo) else [each] for each in metadata]
        yield annotation, [each for group in groups for each in group]


JSON = Parameter(
    "json", FieldInfo(annotation=bool, default=False, description="print JSON and nothing else")
)
"""The option that every command has."""


def read_parameters(command: type[Command]) -> list[Parameter]:
    """Arguments and options of a command in the order of its help."""
    first: list[Parameter] = []
    own: list[Parameter] = []
    others: list[Parameter] = []
    for name, field in command.model_fields.items():
        source = next((each for each in field.metadata if isinstance(each, OptionsOf)), None)
        if source is None:
            own.append(Parameter(field.alias or name, field))
            continue
        for option, (heading, of_model) in source.fields.items():
            made = Parameter(option, of_model, heading, source)
            (first if heading == FIRST else others).append(made)
    return [*first, *own, JSON, *others]


class ClickCommand(click.Command):
    """A command as `click` runs it."""

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
        """Run the command; an error names settings as options."""
        try:
            self._run(ctx)
        except InputError as error:
            raise InputError(self._with_options(error.message)) from error

    def _with_options(self, text: str) -> str:
        """A text with its settings as options, which are listed only where it may have some."""
        others = job_options().fields.keys() | Camera.model_fields.keys() if "`" in text else ()
        return as_options(text, {*others, *(each.key for each in self.declared)})

    def _run(self, ctx: click.Context) -> None:
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
        terminal = Terminal(as_json, typed, self._with_options)
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
            if not (each.is_argument or each.hidden):
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
            faults = "; ".join(field_errors(error, name_of))
            more = f"; see `{path} --help`" if any(map(name_of, error.errors())) else ""
            raise InputError(f"{faults}{more}") from None
