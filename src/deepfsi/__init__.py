"""Learn the masks of a photon-limited single-pixel camera with the network that reads them.

Implements and extends Y. Lu and A. Velten, *Deep Feature-specific Imaging*. Names are loaded when
they are first used, so that importing the package costs little.

Torch's threads wait asleep for one another (`OMP_WAIT_POLICY`), unless the environment says
otherwise: spinning they would take the processor from other programs, and from each other.
"""

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deepfsi.base.errors import InputError as InputError
    from deepfsi.camera.camera import Camera as Camera
    from deepfsi.camera.light import photons_per_pixel as photons_per_pixel
    from deepfsi.datasets.arrays import from_arrays as from_arrays
    from deepfsi.datasets.dataset import Dataset as Dataset
    from deepfsi.datasets.load import load_dataset as load_dataset
    from deepfsi.design.design import Design as Design
    from deepfsi.design.design import load_design as load_design
    from deepfsi.design.networks import Mlp as Mlp
    from deepfsi.design.networks import OwnClassifier as OwnClassifier
    from deepfsi.evaluation.accuracy import evaluate as evaluate
    from deepfsi.evaluation.ideal import ideal_observer as ideal_observer
    from deepfsi.evaluation.results import Result as Result
    from deepfsi.jobs.exposures import Fixed as Fixed
    from deepfsi.jobs.exposures import Range as Range
    from deepfsi.jobs.exposures import SharedLight as SharedLight
    from deepfsi.jobs.job import Job as Job
    from deepfsi.jobs.training import Training as Training
    from deepfsi.lab.classify import classify_run as classify_run
    from deepfsi.lab.classify import classify_table as classify_table
    from deepfsi.lab.prediction import predict as predict
    from deepfsi.physics.scanner import Scanner as Scanner
    from deepfsi.sklearn import DeepFSIClassifier as DeepFSIClassifier
    from deepfsi.training.assembly import design_of as design_of
    from deepfsi.training.learning import learn as learn

if "GOMP_SPINCOUNT" not in os.environ:
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # read when torch is imported

_HOMES = {
    "Camera": "camera.camera",
    "Dataset": "datasets.dataset",
    "DeepFSIClassifier": "sklearn",
    "Design": "design.design",
    "Fixed": "jobs.exposures",
    "InputError": "base.errors",
    "Job": "jobs.job",
    "Mlp": "design.networks",
    "OwnClassifier": "design.networks",
    "Range": "jobs.exposures",
    "Result": "evaluation.results",
    "Scanner": "physics.scanner",
    "SharedLight": "jobs.exposures",
    "Training": "jobs.training",
    "classify_run": "lab.classify",
    "classify_table": "lab.classify",
    "design_of": "training.assembly",
    "evaluate": "evaluation.accuracy",
    "from_arrays": "datasets.arrays",
    "ideal_observer": "evaluation.ideal",
    "learn": "training.learning",
    "load_dataset": "datasets.load",
    "load_design": "design.design",
    "photons_per_pixel": "camera.light",
    "predict": "lab.prediction",
}

__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("deepfsi")
    if name not in _HOMES:
        raise AttributeError(f"module 'deepfsi' has no attribute {name!r}")
    from deepfsi.base.registry import require_extras

    with require_extras():
        return getattr(importlib.import_module(f"deepfsi.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
