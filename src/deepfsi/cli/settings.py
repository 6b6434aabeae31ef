"""Options of the commands, made from the fields that hold them: of a camera, an exposure, a job.

A field is declared once, in its model, with its text. `with_settings` gives a command an option for
each, and hands those on that were given, as text, by the names of the fields.
"""

import functools
import inspect
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Annotated, Any

import typer
from pydantic.fields import FieldInfo

from deepfsi.design.exposure import EXPOSURE_FIELDS, KINDS
from deepfsi.errors import InputError
from deepfsi.optics.camera import Camera
from deepfsi.training.job import ALIASES, Job, Training

JOB_FIELDS = ("design", "masks", "photons", "camera", "seed")
"""Fields of a job that are settings themselves."""

NO_OPTIONS = ("classifier_arguments",)
"""Fields that a recipe or Python gives."""

AXES = "; several separated by commas"


def camera_fields() -> dict[str, tuple[str, FieldInfo]]:
    """Help panel and field of each option that overrides one of a camera."""
    return _named("camera", "Camera", Camera.model_fields)


def job_fields() -> dict[str, tuple[str, FieldInfo]]:
    """Help panel and field of each option of a job."""
    found = {name: ("Options", Job.model_fields[name]) for name in JOB_FIELDS} | camera_fields()
    found |= {name: ("Exposure", KINDS[name].model_fields[name]) for name in EXPOSURE_FIELDS}
    return found | _named("training", "Training", Training.model_fields)


def _named(
    table: str, panel: str, fields: Mapping[str, FieldInfo]
) -> dict[str, tuple[str, FieldInfo]]:
    names = {place: name for name, place in ALIASES.items()}
    return {
        names.get((table, name), name): (panel, field)
        for name, field in fields.items()
        if name not in NO_OPTIONS
    }


def laboratory_fields(*names: str) -> dict[str, tuple[str, FieldInfo]]:
    """Help panel and field of the options of a run: its camera, and some fields of that."""
    fields = {"camera": Job.model_fields["camera"]} | {n: Camera.model_fields[n] for n in names}
    return {name: ("Camera", field) for name, field in fields.items()}


def with_settings(
    fields: Mapping[str, tuple[str, FieldInfo]], *, axes: bool = False, leave: Iterable[str] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command that takes `settings` an option for each field but those left out."""
    options = {name: each for name, each in fields.items() if name not in set(leave)}

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(function).parameters
        hints = typing.get_type_hints(function, include_extras=True)

        @functools.wraps(function)
        def command(**given: Any) -> None:
            told = {name: given.pop(name) for name in options}
            kept = {name: value for name, value in told.items() if value not in (None, False)}
            function(**given, settings=kept)

        made = [
            each.replace(annotation=hints[name]) for name, each in own.items() if name != "settings"
        ]
        made += [_option(name, *each, axes) for name, each in options.items()]
        made = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in made]
        command.__signature__ = inspect.Signature(made)  # type: ignore[attr-defined]
        command.__annotations__ = {each.name: each.annotation for each in made}
        return command

    return decorate


def _option(name: str, panel: str, field: FieldInfo, axes: bool) -> inspect.Parameter:
    flag = field.annotation is bool
    words = (field.description or "") + (AXES if axes and not flag and name != "camera" else "")
    option = typer.Option(f"--{name.replace('_', '-')}", help=words, rich_help_panel=panel)
    kind = bool if flag else str | None
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=False if flag else None,
        annotation=Annotated[kind, option],
    )


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
