"""Commands: a model of the settings, with what it does; its options, and how it is run.

A command is one class. Its fields are arguments and options, `run` does the work and gives an
`Outcome`. All that commands have in common is here: what `--help` says of a field, the reading of
texts, `--json`, and the checks of what is written to.
"""

import inspect
import shlex
import sys
from abc import abstractmethod
from collections.abc import Iterable
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import click
from pydantic import BeforeValidator, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from deepfsi.base.errors import InputError, field_errors
from deepfsi.base.files import readable_name
from deepfsi.base.interrupts import STOPPED_EXIT_CODE
from deepfsi.base.models import StrictModel
from deepfsi.base.quantities import seconds
from deepfsi.camera.camera import Camera
from deepfsi.cli.fields import FIRST, OptionsOf, Output, height_width, job_options
from deepfsi.cli.terminal import Outcome, Terminal, as_options, option_name

FORMS: dict[Any, str] = {
    seconds: "time",
    height_width: "HEIGHTxWIDTH",
    int: "int",
    float: "number",
    Path: "path",
}
"""Form of a value by the function that reads it, or by its type; others are text."""


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


class _Argument(click.Argument):
    """A value without a name, whose help stands under a heading."""

    heading = "Arguments"
    words = ""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str]:
        return self.make_metavar(ctx), self.words


class _Option(click.Option):
    """An option whose help stands under a heading."""

    heading = FIRST


class ClickCommand(click.Command):
    """A command as `click` runs it."""

    def __init__(self, command: type[Command], name: str, summary: str) -> None:
        self.command = command
        params: list[click.Parameter] = []
        for field_name, field in command.model_fields.items():
            source = _metadata(field, OptionsOf)
            if source is None:
                params.append(_parameter(field.alias or field_name, field, field.is_required()))
                continue
            for key, (heading, of_model) in source.fields.items():
                axis = source.axes and key not in ("camera", "hidden")
                params.append(_parameter(key, of_model, False, heading=heading, axis=axis))
        params.append(_Option(["--json"], is_flag=True, help="print JSON and nothing else"))
        _, _, rest = inspect.cleandoc(command.__doc__ or "").partition("\n\n")
        super().__init__(name, params=params, help=f"{summary}\n\n{rest}")

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write arguments and options under their headings."""
        headings: dict[str, list[tuple[str, str]]] = {_Argument.heading: [], FIRST: []}
        for each in self.get_params(ctx):
            if record := each.get_help_record(ctx):
                headings.setdefault(getattr(each, "heading", FIRST), []).append(record)
        for heading, rows in headings.items():
            if rows:
                with formatter.section(heading):
                    formatter.write_dl(rows)

    def invoke(self, ctx: click.Context) -> None:
        """Run the command; an error names settings as options."""
        try:
            self._run(ctx)
        except InputError as error:
            raise InputError(self._with_options(str(error))) from error

    def _with_options(self, text: str) -> str:
        """A text with its settings as options, which are listed only where it may have some."""
        others = job_options().fields.keys() | Camera.model_fields.keys() if "`" in text else ()
        return as_options(text, {*others, *(each.name or "" for each in self.params)})

    def _run(self, ctx: click.Context) -> None:
        """Read the settings, check what is written to, run, and print what was found."""
        given = {
            name: value for name, value in ctx.params.items() if value not in (None, False, ())
        }
        as_json = given.pop("json", False)
        settings = self._read(given)
        for name, field in self.command.model_fields.items():
            output = _metadata(field, Output)
            path = getattr(settings, name)
            if output is not None and path is not None:
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

    def _read(self, given: dict[str, Any]) -> Command:
        """Settings of texts, or `InputError` that names every option that cannot be read."""
        for name, field in self.command.model_fields.items():
            if source := _metadata(field, OptionsOf):
                given[name] = {key: given.pop(key) for key in source.fields if key in given}
        names = {each.name: each.opts[0] for each in self.params}

        def name_of(fault: ErrorDetails) -> str:
            error = fault.get("ctx", {}).get("error")
            if isinstance(error, InputError):  # which says all
                return ""
            name = names[str(fault["loc"][0])]
            return f"{name}: " if error else f"{name} {shlex.quote(str(fault['input']))}: "

        try:
            return self.command.model_validate(given)
        except ValidationError as error:
            raise InputError("; ".join(field_errors(error, name_of))) from None


def _metadata(field: FieldInfo, kind: type) -> Any:
    """What is declared of a field in a class of its own, if anything."""
    return next((each for each in field.metadata if isinstance(each, kind)), None)


def _parameter(
    key: str, field: FieldInfo, required: bool, *, heading: str = FIRST, axis: bool = False
) -> click.Parameter:
    """Parser of the text of a field, which the model reads; what its help says."""
    form, several = _form(field.annotation, tuple(field.metadata))
    if axis and form:
        form = f"{form},…"
    words = str(field.description)
    extra = field.json_schema_extra
    if isinstance(extra, dict) and "argument" in extra:
        metavar = str(extra["argument"] or key.upper())
        argument = _Argument(
            [key], required=required, nargs=-1 if several else 1, metavar=metavar, type=str
        )
        argument.words = words
        return argument
    default = field.default
    if isinstance(default, tuple):
        default = ",".join(map(str, default))
    known = isinstance(default, str | int | float | Path) and not isinstance(default, bool)
    if known and default != "" and not axis and heading != "Camera":
        words = f"{words}  [default: {default}]"
    option = _Option(
        [key, option_name(key), *(["-o"] if key == "out" else [])],
        is_flag=None if form else True,
        multiple=several,
        required=required,
        metavar=f"<{form}{' …' * several}>" if form else None,
        help=words,
        type=str if form else bool,
    )
    option.heading = heading
    return option


def _form(annotation: Any, metadata: tuple[Any, ...]) -> tuple[str, bool]:
    """Form of a value, empty of a flag: ``number``, ``dual|single``; and if it may be repeated."""
    parts = get_args(annotation)
    kind = get_origin(annotation)
    if kind is Annotated:
        return _form(parts[0], (*metadata, *parts[1:]))
    if kind in (Union, UnionType):
        return _form(next(each for each in parts if each is not NoneType), metadata)
    fields = [each.metadata if isinstance(each, FieldInfo) else [each] for each in metadata]
    readers = [each.func for group in fields for each in group if isinstance(each, BeforeValidator)]
    for reader in readers:
        if reader in FORMS:
            return FORMS[reader], False
    if kind is Literal:
        return "|".join(map(str, parts)), False
    if kind in (tuple, list):
        item, _ = _form(parts[0], ())
        return (f"{item},…", False) if readers else (item, True)
    return ("" if annotation is bool else FORMS.get(annotation, "text")), False
