"""Loop of a design of several looks, for a computer at a camera without torch."""

from dataclasses import replace

import numpy as np

from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Mlp
from deepfsi.design.exposure.looks import LARGEST_SCORE, LooksExposure
from deepfsi.design.stopping import StoppingRule
from deepfsi.errors import InputError
from deepfsi.hardware.live.networks import About, Layer, Loop
from deepfsi.hardware.recording.live_settings import StopRule


def loop_of(design: Design) -> Loop:
    """Loop of a design, or `InputError` where it is of one look or its classifier is no `Mlp`."""
    exposure, classifier = looks_of(design), design.classifier
    if not isinstance(classifier, Mlp):
        raise InputError(
            f"a loop with a {type(classifier).__name__} classifier is not possible: learn the "
            "design with the package's own, an Mlp"
        )
    about = About(
        looks=exposure.looks,
        masks=design.masks,
        rails=2 if len(design.rails) == 2 else 1,
        detectors=design.detection.count,
        each_rail=exposure.dwells.each_rail,
        readout=design.detection.readout,
        classes=design.classes,
        largest_score=LARGEST_SCORE,
        shortest=exposure.shortest,
        rule=rule_of(design),
    )
    mean, std = (each.detach().cpu().float().numpy() for each in (design.mean, design.std))
    return Loop(about, mean, std, _layers(classifier), _layers(exposure.network))


def looks_of(design: Design) -> LooksExposure:
    """Exposure of a design of several looks, or `InputError` where it is of one."""
    if not isinstance(design.exposure, LooksExposure):
        raise InputError("this design has one look: learn one of several with `looks`")
    return design.exposure


def with_rule(design: Design, rule: StoppingRule) -> Design:
    """The design with a rule of when an exposure stops, or `InputError` if it is of one look."""
    looks_of(design)
    held = StopRule(temperatures=rule.temperatures, threshold=rule.threshold)
    return replace(design, info={**design.info, "stopping": held.model_dump(mode="json")})


def rule_of(design: Design) -> StopRule | None:
    """Stop rule that a design holds, if it holds one."""
    held = design.info.get("stopping")
    return None if held is None else StopRule.model_validate(held)


def _layers(network: Mlp) -> tuple[Layer, ...]:
    """Weights and biases of a network's layers."""
    return tuple(
        (np.ascontiguousarray(weight.T, np.float32), bias.astype(np.float32))
        for weight, bias in network.arrays
    )
