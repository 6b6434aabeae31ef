"""Commands: a model of the settings, with what it does; its options, and how it is run.

A command is one class: its fields are arguments and options, `run` gives an `Outcome`. Here is what
all have in common: `--help`, the reading of texts, `--json`, and checks of what is written to.
"""

import inspect
import re
import shlex
from abc import abstractmethod
from collections.abc import Iterable
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import click
from pydantic import BeforeValidator, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from deepfsi.base.errors import InputError, as_input_error, field_errors
from deepfsi.base.interrupts import STOPPED_EXIT_CODE
from deepfsi.base.models import StrictModel
from deepfsi.base.quantities import seconds
from deepfsi.camera.camera import Camera
from deepfsi.cli.fields import JOB_OPTIONS, OptionsOf, Output, height_width
from deepfsi.cli.terminal import Outcome, Terminal

FORMS: dict[Any, str] = {
    seconds: "time",
    height_width: "HEIGHTxWIDTH",
    int: "int",
    float: "number",
    Path: "path",
}
"""Form of a value in the help, by the function that reads it or by its type; else text."""


class Command(StrictModel):
    """Settings of a command, and what it does; its docstring is its help, after the summary."""

    model_config = ConfigDict(allow_inf_nan=False)

    @abstractmethod
    def run(self, terminal: Terminal) -> Outcome:
        """Do the work."""

    def explicit(self, fields: Iterable[str]) -> dict[str, Any]:
        """Values of the named fields that stand on the command line."""
        return {name: getattr(self, name) for name in fields if name in self.model_fields_set}


class _Argument(click.Argument):
    """A value without a name, which has a line in the help."""

    words = ""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str]:
        return self.make_metavar(ctx), self.words


class ClickCommand(click.Command):
    """A command as `click` runs it."""

    def __init__(self, command: type[Command], name: str, summary: str) -> None:
        self.command = command
        self.headings: dict[str, list[click.Parameter]] = {"Arguments": [], "Options": []}
        for field_name, field in command.model_fields.items():
            source = _metadata(field, OptionsOf)
            if source is None:
                parameter = _parameter(field.alias or field_name, field, field.is_required())
                named = isinstance(parameter, click.Option)
                self.headings["Options" if named else "Arguments"].append(parameter)
                continue
            for key, (heading, _, of_model) in source.fields.items():
                axis = source.axes and key not in ("camera", "hidden")
                # Without an option a setting is that of the chosen camera
                option = _parameter(key, of_model, False, axis=axis, default=heading != "Camera")
                self.headings.setdefault(heading, []).append(option)
        as_json = click.Option(["--json"], is_flag=True, help="print JSON and nothing else")
        self.headings["Options"].append(as_json)
        params = [parameter for group in self.headings.values() for parameter in group]
        words = inspect.cleandoc(command.__doc__ or "")
        super().__init__(name, params=params, help=f"{summary}\n\n{words}")

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write arguments and options under their headings."""
        for heading, group in self.headings.items():
            if rows := [row for param in group if (row := param.get_help_record(ctx))]:
                with formatter.section(heading):
                    formatter.write_dl(rows)

    def invoke(self, ctx: click.Context) -> None:
        """Run the command; an error names settings as options."""
        try:
            with as_input_error():  # of what the options make, such as a virtual camera
                self._run(ctx)
        except InputError as error:
            raise InputError(self._with_options(str(error))) from error

    def _with_options(self, text: str) -> str:
        """A text whose settings are written as options: `size` as --size."""
        settings = {*JOB_OPTIONS, *Camera.model_fields, *(param.name for param in self.params)}

        def option(named: re.Match[str]) -> str:
            setting, value = named.groups("")
            if setting not in settings:
                return named[0]
            value = value.strip('"')
            return f"{_option_name(setting)} {value}".rstrip()

        return re.sub(r'`([a-z_]+)(?:=("[^"`]*"|\d+))?`', option, text)

    def _run(self, ctx: click.Context) -> None:
        """Read the settings, check outputs, run, and print the outcome."""
        # Options that do not stand on the command line are left to the defaults of the model
        texts = {
            name: value for name, value in ctx.params.items() if value not in (None, False, ())
        }
        terminal = Terminal(texts.pop("json", False))
        settings = self._read(texts)
        for name, field in self.command.model_fields.items():
            output = _metadata(field, Output)
            path = getattr(settings, name)
            if output is not None and path is not None:
                output.check(path, getattr(settings, "force", False))
        try:
            outcome = settings.run(terminal)
        except KeyboardInterrupt:  # `click` would print an empty line
            ctx.exit(STOPPED_EXIT_CODE)
        terminal.write(outcome, ctx.command_path.partition(" ")[2].replace(" ", "."))
        if outcome.refusal:
            raise InputError(outcome.refusal)
        if outcome.failed:
            ctx.exit(1)

    def _read(self, texts: dict[str, Any]) -> Command:
        """Settings of texts; `InputError` names all options that cannot be read."""
        for name, field in self.command.model_fields.items():
            if source := _metadata(field, OptionsOf):
                texts[name] = {key: texts.pop(key) for key in source.fields if key in texts}
        names = {param.name: param.opts[0] for param in self.params}

        def name_of(fault: ErrorDetails) -> str:
            error = fault.get("ctx", {}).get("error")
            if isinstance(error, InputError):  # it names its setting
                return ""
            name = names[str(fault["loc"][0])]
            return f"{name}: " if error else f"{name} {shlex.quote(str(fault['input']))}: "

        try:
            return self.command.model_validate(texts)
        except ValidationError as error:
            raise InputError("; ".join(field_errors(error, name_of))) from None


def _option_name(setting: str) -> str:
    return f"--{setting.replace('_', '-')}"


def _metadata(field: FieldInfo, kind: type) -> Any:
    """Metadata of a field of that class, if it has any."""
    return next((entry for entry in field.metadata if isinstance(entry, kind)), None)


def _parameter(
    key: str, field: FieldInfo, required: bool, *, axis: bool = False, default: bool = True
) -> click.Parameter:
    """Argument or option of a field; its text is read by the model."""
    form, repeated = _form(field.annotation, tuple(field.metadata))
    words = str(field.description)
    extra = field.json_schema_extra
    if isinstance(extra, dict):
        metavar = str(extra["argument"] or key.upper())
        argument = _Argument([key], required=required, metavar=metavar, type=str)
        argument.words = words
        return argument
    usual = field.default
    known = isinstance(usual, str | int | float | Path) and not isinstance(usual, bool)
    if known and default and not axis:
        words = f"{words}  [default: {usual}]"
    return click.Option(
        [key, _option_name(key), *(["-o"] if key == "out" else [])],
        is_flag=None if form else True,
        multiple=repeated,
        required=required,
        metavar=f"<{form}{',…' * axis}{' …' * repeated}>" if form else None,
        help=words,
        type=str if form else bool,
    )


def _form(annotation: Any, metadata: tuple[Any, ...]) -> tuple[str, bool]:
    """Form of a value, such as ``dual|single`` (empty: a flag), and whether it may be repeated."""
    types = get_args(annotation)
    kind = get_origin(annotation)
    if kind is Annotated:
        return _form(types[0], (*metadata, *types[1:]))
    if kind in (Union, UnionType):
        return _form(types[0], metadata)  # None is last
    readers = [entry.func for entry in metadata if isinstance(entry, BeforeValidator)]
    form = next((FORMS[reader] for reader in readers if reader in FORMS), "")
    if form:
        return form, False
    if kind is Literal:
        return "|".join(map(str, types)), False
    if kind is tuple:
        item, _ = _form(types[0], ())
        return (f"{item},…", False) if readers else (item, True)
    return ("" if annotation is bool else FORMS.get(annotation, "text")), False
