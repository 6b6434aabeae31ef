"""Options of the commands, made from the fields that hold them: of a camera, an exposure, a job.

A field is declared once, in its model, with its text. `with_settings` gives a command an option for
each, and hands those on that were given, as text, by the names of the fields. The models are
imported, and the options made, when a command is called or asked for its help.
"""

import functools
import inspect
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from deepfsi.base import InputError

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

Command = Callable[..., None]
"""Function of a command."""

Fields = dict[str, tuple[str, "FieldInfo"]]
"""Help panel and field of each option, by its name."""

JOB_FIELDS = ("design", "masks", "photons", "camera", "seed")
"""Fields of a job that are settings themselves."""

NO_OPTIONS = ("classifier_arguments",)
"""Fields that a recipe or Python gives."""

AXES = "; several separated by commas"

ONE_VALUE = ("camera", "hidden")
"""Options of one value where others are axes."""

FIRST = "Options"
"""Heading of the options that most need, first of all."""


def job_fields() -> Fields:
    """Help panel and field of each option of a job."""
    from deepfsi.camera import Camera
    from deepfsi.jobs import EXPOSURE_FIELDS, EXPOSURE_KINDS, Job, Training

    found: Fields = {name: (FIRST, Job.model_fields[name]) for name in JOB_FIELDS}
    found |= _named("camera", "Camera", Camera.model_fields)
    found |= {
        name: ("Exposure", EXPOSURE_KINDS[name].model_fields[name]) for name in EXPOSURE_FIELDS
    }
    return found | _named("training", "Training", Training.model_fields)


def _named(table: str, panel: str, fields: "Mapping[str, FieldInfo]") -> Fields:
    from deepfsi.jobs import SETTING_ALIASES

    names = {place: name for name, place in SETTING_ALIASES.items()}
    return {
        names.get((table, name), name): (panel, field)
        for name, field in fields.items()
        if name not in NO_OPTIONS
    }


COUNTER_EFFECTS = ("dead_time", "dead_time_model")
"""Fields of a camera that tell what its counts are corrected for."""


def laboratory_fields(*names: str) -> Fields:
    """Help panel and field of the options of a run: its camera, and fields of that; all if none."""
    from deepfsi.camera import Camera
    from deepfsi.jobs import Job

    fields = {"camera": Job.model_fields["camera"]}
    fields |= {name: Camera.model_fields[name] for name in names or Camera.model_fields}
    return {name: ("Camera", field) for name, field in fields.items()}


def with_settings(
    fields: Callable[..., Fields], *names: str, axes: bool = False, leave: Iterable[str] = ()
) -> Callable[[Command], Command]:
    """Give a command that takes `settings` an option for each of these fields but those left out.

    The names are arguments of `fields`. The command is one of the class `SettingsCommand`.
    """

    def decorate(function: Command) -> Command:
        def whole() -> Command:
            options = {name: each for name, each in fields(*names).items() if name not in leave}
            return _with_options(function, options, axes)

        @functools.wraps(function)
        def command(**given: Any) -> None:
            whole()(**given)

        command.__signature__ = inspect.Signature()  # type: ignore[attr-defined]
        command.__annotations__ = {}
        command.whole = whole  # type: ignore[attr-defined]
        return command

    return decorate


class SettingsCommand(TyperCommand):
    """A command whose options are made when they are asked for."""

    @property
    def params(self) -> Any:
        """Arguments and options."""
        if whole := getattr(self.callback, "whole", None):
            app = typer.Typer(add_completion=False, rich_markup_mode=None)
            app.command()(whole())
            made = typer.main.get_command(app)
            self._params, self.callback = made.params, made.callback
        return self._params

    @params.setter
    def params(self, params: Any) -> None:
        self._params = params

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options under their headings, in the order of those."""
        headings: dict[str, list[tuple[str, str]]] = {}
        for each in self.get_params(ctx):
            usual = "Arguments" if each.param_type_name == "argument" else FIRST
            if row := each.get_help_record(ctx):
                headings.setdefault(getattr(each, "rich_help_panel", None) or usual, []).append(row)
        for heading, rows in headings.items():
            with formatter.section(heading):
                formatter.write_dl(rows)


def _with_options(
    function: Command, options: Mapping[str, tuple[str, "FieldInfo"]], axes: bool
) -> Command:
    own = inspect.signature(function).parameters
    hints = typing.get_type_hints(function, include_extras=True)

    @functools.wraps(function)
    def command(**given: Any) -> None:
        told = {name: given.pop(name) for name in options}
        kept = {name: value for name, value in told.items() if value not in (None, False)}
        function(**given, settings=kept)

    first = [_option(name, *each, axes) for name, each in options.items() if each[0] == FIRST]
    others = [_option(name, *each, axes) for name, each in options.items() if each[0] != FIRST]
    mine = [
        each.replace(annotation=hints[name]) for name, each in own.items() if name != "settings"
    ]
    made = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in (*first, *mine, *others)]
    command.__signature__ = inspect.Signature(made)  # type: ignore[attr-defined]
    command.__annotations__ = {each.name: each.annotation for each in made}
    return command


def _option(name: str, panel: str, field: "FieldInfo", axes: bool) -> inspect.Parameter:
    flag = field.annotation is bool
    words = field.description or ""
    if axes:
        words += "" if flag or name in ONE_VALUE else AXES
    elif _has_default(panel, field):
        words += f"  [default: {_text(field.default)}]"
    option = typer.Option(f"--{name.replace('_', '-')}", help=words, rich_help_panel=panel)
    kind = bool if flag else str | None
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=False if flag else None,
        annotation=Annotated[kind, option],
    )


def _has_default(panel: str, field: "FieldInfo") -> bool:
    """True where a default holds whatever else is given, as it does not in a camera."""
    told = panel == "Camera" or field.annotation is bool or "unless given" in str(field.description)
    return not told and isinstance(field.default, str | int | float | tuple)


def _text(default: Any) -> str:
    return ",".join(map(str, default)) if isinstance(default, tuple) else f"{default}"


def values(option: str, text: Any) -> list[Any]:
    """Values of an option that is an axis, separated by commas, or `InputError`."""
    if not isinstance(text, str):
        return [text]
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise InputError(
            f"--{option} {text!r} has an empty place: give one value or more, separated by commas"
        )
    return parts
