"""The command line: parses, calls, prints. Heavy imports happen in the command that needs them."""

import contextlib
import io
import os
import sys
from collections.abc import Callable
from typing import Annotated, NoReturn

import typer

import deepfsi
from deepfsi.base import STOPPED_EXIT_CODE, InputError, one_line, require_torch, say_stopped
from deepfsi.cli import (
    acquisitions,
    calibrations,
    camera,
    classify,
    collection,
    common,
    data,
    dmd,
    live,
    record,
    scan,
    table_pictures,
    transits,
)
from deepfsi.cli.deploy import export, plan
from deepfsi.cli.designs import design, evaluate, page, show, stop
from deepfsi.cli.groups import Group
from deepfsi.cli.mask import mask
from deepfsi.cli.predict import predict
from deepfsi.cli.readouts import readouts
from deepfsi.cli.settings import SettingsCommand
from deepfsi.cli.studies import compare, report, reproduce, sweep

app = typer.Typer(
    name="deepfsi",
    cls=Group,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    invoke_without_command=True,
    help="Design the masks of a photon-limited single-pixel camera with the network that reads "
    "them.\n\nStart with: deepfsi compare",
)


@app.callback()
def _start(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="print the version and stop")] = False,
) -> None:
    if version:
        print(f"deepfsi {deepfsi.__version__}")
        raise typer.Exit
    common.help_if_bare(context)


_HEADINGS: dict[str, tuple[Callable[..., None], ...]] = {
    "Design": (design, readouts, show, page, evaluate, predict, stop, export, mask),
    "Study": (compare, plan, sweep, reproduce, report),
}
for _heading, _commands in _HEADINGS.items():
    for _command in _commands:
        app.command(cls=SettingsCommand, rich_help_panel=_heading)(_command)
app.add_typer(collection.app, name="designs", rich_help_panel="Design")
app.add_typer(dmd.dmd, name="dmd", rich_help_panel="Camera")
app.add_typer(camera.camera, name="camera", rich_help_panel="Camera")
app.add_typer(data.app, name="data", rich_help_panel="Data")

_OF_CAMERA: dict[str, dict[str, Callable[..., None]]] = {
    "Describe the camera": {"describe": camera.camera_describe},
    "Record a run": {
        "prepare": acquisitions.camera_prepare,
        "simulate": camera.camera_simulate,
        "record": record.camera_record,
        "live": live.camera_live,
        "import": acquisitions.camera_import,
    },
    "Read a run": {
        "inspect": camera.camera_inspect,
        "count": camera.camera_count,
        "classify": classify.camera_classify,
        "image": camera.camera_image,
        "picture": table_pictures.camera_picture,
        "scan": scan.camera_scan,
        "transits": transits.camera_transits,
    },
    "Calibrate the camera": {
        "spots": calibrations.camera_spots,
        "calibrate": calibrations.camera_calibrate,
        "check": calibrations.camera_check,
    },
}
for _heading, _named in _OF_CAMERA.items():
    for _name, _command in _named.items():
        camera.camera.command(_name, cls=SettingsCommand, rich_help_panel=_heading)(_command)


def main() -> NoReturn:
    """Entry point: 0 done, 1 a check failed, 2 bad input, 130 or 143 stopped."""
    # Figures are files here: a notebook's backend, or settings of a user's own, would break them
    os.environ |= {"MPLBACKEND": "agg", "MATPLOTLIBRC": os.devnull}
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a console may lack a letter of a name
    try:
        _check_here()
        with require_torch():
            code = app(standalone_mode=False)
    except typer.Exit as stop:
        code = stop.exit_code
    except (KeyboardInterrupt, typer.Abort):
        code = STOPPED_EXIT_CODE
    except InputError as error:
        _fail(one_line(common.as_options(error.message)))
    except typer.TyperException as error:
        said = getattr(error, "format_message", error.__str__)()
        context = getattr(error, "ctx", None)  # of an error in the words of the command
        _fail(f"{said.rstrip('.')}; see `{context.command_path} --help`" if context else said)
    except ValueError as error:
        if not isinstance(error.__cause__, KeyboardInterrupt):  # what pydantic makes of Ctrl-C
            raise
        code = STOPPED_EXIT_CODE
    except OSError as error:
        _fail(f"{error.filename or 'cannot write the output'}: {error.strerror or error}")
    if code == STOPPED_EXIT_CODE:
        say_stopped()
    sys.exit(code if isinstance(code, int) else 0)


def _check_here() -> None:
    """Raise `InputError` in a folder that was removed, in which libraries end the process."""
    try:
        os.getcwd()
    except FileNotFoundError:
        raise InputError("the current folder is no longer there: go to another one") from None


def _fail(message: str) -> NoReturn:
    with contextlib.suppress(OSError):  # a full disk takes no message
        print(f"deepfsi: {' '.join(message.split())}", file=sys.stderr, flush=True)
    sys.exit(2)
