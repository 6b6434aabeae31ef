"""Commands that are not yet written as settings."""

from collections.abc import Callable

import typer

from deepfsi.cli import (
    acquisitions,
    calibrations,
    camera,
    classify,
    dmd,
    live,
    record,
    scan,
    table_pictures,
    transits,
)
from deepfsi.cli.readouts import readouts
from deepfsi.cli.settings import SettingsCommand

old = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

for _command in (readouts,):
    old.command(cls=SettingsCommand)(_command)
old.add_typer(dmd.dmd, name="dmd")
old.add_typer(camera.camera, name="camera")

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
