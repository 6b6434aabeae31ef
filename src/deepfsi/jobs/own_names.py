"""A classifier and a loss as settings: a name, the import path of one's own, or an object."""

import re
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import AfterValidator, PlainSerializer, WithJsonSchema

from deepfsi.base.plugins import PATTERN, UNNAMED, path_of
from deepfsi.camera.names import MLP, VIT

if TYPE_CHECKING:
    from deepfsi.jobs.job import Job


def classifier_name(given: Any) -> str:
    """Name or import path of a classifier that is given by name, as a module or as a factory."""
    if isinstance(given, str):
        return given
    from deepfsi.design.own import describe

    return describe(given, None)[0]


def loss_name(given: Any) -> str | None:
    """Import path of a loss, `UNNAMED` of one that has none; None where none is given."""
    return given if given is None or isinstance(given, str) else path_of(given) or UNNAMED


def own_parts(job: "Job", *noises: str) -> list[str]:
    """Import paths of a user's own parts in a job and in further noises, `UNNAMED` among them."""
    own = classifier_name(job.training.classifier), loss_name(job.training.loss) or ""
    every = {job.noise, *noises, *own}
    return sorted(name for name in every if ":" in name or name == UNNAMED)


def _classifier(given: Any) -> Any:
    if not (isinstance(given, str) or callable(given)):
        raise ValueError(f"give {MLP}, or a module or factory of your own")
    name = classifier_name(given)
    if name not in (MLP, VIT, UNNAMED) and not re.fullmatch(PATTERN, name):
        raise ValueError(f"give {MLP}, or module:factory of your own")
    return given


def _loss(given: Any) -> Any:
    named = isinstance(given, str) and re.fullmatch(f"{PATTERN}|{UNNAMED}", given)
    if not (given is None or callable(given) or named):
        raise ValueError("give module:function, or a function of outputs and truth")
    return given


Classifier = Annotated[
    Any,
    AfterValidator(_classifier),
    PlainSerializer(classifier_name, return_type=str),
    WithJsonSchema({"type": "string"}),
]
"""Name of a classifier, import path of a factory of one's own, a module or a factory."""

Loss = Annotated[
    Any,
    AfterValidator(_loss),
    PlainSerializer(loss_name, return_type=str | None),
    WithJsonSchema({"type": "string"}),
]
"""Import path of a loss of one's own, or its function; None for the usual one."""
