"""Jobs and trainings of single settings, as the command line has them, for tests of many of them.

`noise` is here the noise of the training, and the camera's where that is no stand-in for photons.
Light law and rails are the paper's unless others, or a camera, are given.
"""

from typing import Any

from deepfsi import learn as learned
from deepfsi.jobs.job import Job, sorted_settings

OF_LEARN = ("counts", "matrix", "device", "report", "checkpoint", "callback")


def sorted_of(**settings: Any) -> dict[str, Any]:
    """Fields of a job of single settings."""
    if "camera" not in settings:
        settings = {"light": "column", "rails": "dual", **settings}
    noise = settings.pop("train_noise", settings.get("noise"))
    if noise == settings.get("noise") and noise in ("ml_gauss", "poisson"):
        del settings["noise"]
    fields = sorted_settings(settings)
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
