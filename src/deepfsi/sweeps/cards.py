"""The card of a published design: what it is, how well it does and whose data it knows."""

import json
from importlib.resources import files
from typing import TYPE_CHECKING

from jinja2 import StrictUndefined, Template

from deepfsi.datasets import Dataset
from deepfsi.design import Design
from deepfsi.designfile import trained_on
from deepfsi.jobs import Job
from deepfsi.measures import Result

if TYPE_CHECKING:
    from deepfsi.sweeps.collection import DataTerms, DesignRecipe


def card(
    name: str,
    recipe: "DesignRecipe",
    terms: "DataTerms",
    data: Dataset,
    design: Design,
    result: Result,
    sha256: str,
    command: str,
) -> str:
    """Card of a design that was trained and tested on data.

    Parameters
    ----------
    name : str
    recipe : DesignRecipe
        What it was made of.
    terms : DataTerms
        Of the data.
    data : Dataset
    design : Design
    result : Result
        Of its test.
    sha256 : str
        Of its file, in hex.
    command : str
        Command that makes it.
    """
    template = (files(__package__) / "card.md.jinja").read_text("utf-8")
    known, info = trained_on(design.info), design.info
    return Template(template, undefined=StrictUndefined, keep_trailing_newline=True).render(
        name=name,
        recipe=recipe,
        terms=terms,
        classes=data.classes,
        camera=recipe.job.optics.describe().replace("\n", "; "),
        masks=_masks(recipe.job),
        photons=f"{result.photons:g}",
        counts=_counts(result),
        accuracy=f"{result.accuracy:.4f}",
        interval=f"[{result.low:.4f}, {result.high:.4f}]",
        balanced=f"{result.balanced:.4f} [{result.balanced_low:.4f}, {result.balanced_high:.4f}]",
        worst=f"{data.classes[result.worst]}, {result.rates[result.worst]:.3f}",
        calibration=f"{result.calibration_error:.3f}",
        result=result,
        draws="one noise draw" if result.draws == 1 else f"{result.draws} noise draws",
        data=f"{known.words if known else data.name}, {len(data.x_train)} training scenes of "
        f"{' x '.join(map(str, data.image_shape))}, sha256 of scenes and labels {data.hash}",
        preprocessing=data.preprocessing,
        command=command,
        version=info["deepfsi"],
        torch=info["torch"],
        device=info["device"],
        seconds=f"{info['seconds']:.0f}",
        settings=[f"{key} = {json.dumps(value)}" for key, value in recipe.settings.items()],
        sha256=sha256,
    )


def _masks(job: Job) -> str:
    if job.code.adaptive:
        return f"made while it looks, one for each of {job.masks} looks"
    levels = job.optics.levels
    kind = {None: "continuous", 0: "continuous", 2: "ON and OFF"}.get(levels, f"{levels} levels")
    return f"{job.masks}, {kind}"


def _counts(result: Result) -> str:
    if result.clicks:
        return f"{result.counts:.4g} clicks of {result.arriving:.4g} photons that arrive, mean"
    return f"{result.counts:.4g} of them counted in the mean"
