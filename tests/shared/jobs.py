"""Jobs and trainings of single settings, as the command line has them, for tests of many of them.

`noise` is here the noise of the training, and the camera's where that is no stand-in for photons.
Light law and rails are the paper's unless others, or a camera, are given.
"""

from typing import Any

from deepfsi import Camera, Job, Training
from deepfsi import learn as learned
from deepfsi.jobs.exposures import exposure_kinds

OF_LEARN = ("counts", "matrix", "device", "report", "checkpoint", "callback")


def table_of(setting: str) -> tuple[str, str]:
    """Table of a job that holds a setting, "" for its own fields, and the setting's name there."""
    tables = {
        "camera": Camera.model_fields,
        "exposure": exposure_kinds(),
        "training": Training.model_fields,
    }
    name = "device" if setting == "dmd" else setting
    return next((table for table, fields in tables.items() if name in fields), ""), name


def sorted_of(**settings: Any) -> dict[str, Any]:
    """Fields of a job of single settings."""
    if "camera" not in settings:
        settings = {"light": "column", "rails": "dual", **settings}
    noise = settings.pop("train_noise", settings.get("noise"))
    if noise == settings.get("noise") and noise in ("ml_gauss", "poisson"):
        del settings["noise"]
    tables: dict[str, dict[str, Any]] = {"": {}, "camera": {}, "exposure": {}, "training": {}}
    for setting, value in settings.items():
        table, name = table_of(setting)
        tables[table][name] = value
    fields = tables.pop("")
    if own := tables.pop("camera"):
        fields["camera"] = Camera.load(fields.get("camera"), **own)
    fields |= {table: given for table, given in tables.items() if given}
    if noise is not None:
        fields["training"] = {**fields.get("training", {}), "noise": noise}
    return fields


def job(**settings: Any) -> Job:
    """Job of single settings."""
    return Job(**sorted_of(**settings))


def learn(data: Any, **settings: Any) -> Any:
    """Design of single settings, learned."""
    own = {name: settings.pop(name) for name in OF_LEARN if name in settings}
    return learned(data, **own, **sorted_of(**settings))
