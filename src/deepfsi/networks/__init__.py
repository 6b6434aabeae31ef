"""Networks that read counts, and what their answers mean."""

from deepfsi.networks.classifiers import (
    CLASSIFIER_TYPES,
    Classifier,
    Mlp,
    Replicas,
    Sizes,
    Vit,
    restore_network,
)
from deepfsi.networks.custom import Given, OwnClassifier, make_custom, rebuilt, seeded
from deepfsi.networks.temperatures import stop_temperatures, temperatures_at
from deepfsi.networks.values import Values, check_classes

__all__ = [
    "CLASSIFIER_TYPES",
    "Classifier",
    "Given",
    "Mlp",
    "OwnClassifier",
    "Replicas",
    "Sizes",
    "Values",
    "Vit",
    "check_classes",
    "make_custom",
    "rebuilt",
    "restore_network",
    "seeded",
    "stop_temperatures",
    "temperatures_at",
]
