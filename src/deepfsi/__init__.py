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
    from deepfsi.base import InputError as InputError
    from deepfsi.camera import Camera as Camera
    from deepfsi.camera import photons_per_pixel as photons_per_pixel
    from deepfsi.datasets import Dataset as Dataset
    from deepfsi.datasets import from_arrays as from_arrays
    from deepfsi.datasets import load_dataset as load_dataset
    from deepfsi.design import Design as Design
    from deepfsi.design import load_design as load_design
    from deepfsi.evaluation import IdealObserver as IdealObserver
    from deepfsi.evaluation import evaluate as evaluate
    from deepfsi.evaluation import ideal_observer as ideal_observer
    from deepfsi.jobs import Fixed as Fixed
    from deepfsi.jobs import Job as Job
    from deepfsi.jobs import Looks as Looks
    from deepfsi.jobs import Nested as Nested
    from deepfsi.jobs import Passing as Passing
    from deepfsi.jobs import Patches as Patches
    from deepfsi.jobs import Range as Range
    from deepfsi.jobs import SharedLight as SharedLight
    from deepfsi.jobs import Training as Training
    from deepfsi.lab import classify_run as classify_run
    from deepfsi.lab import classify_table as classify_table
    from deepfsi.lab import predict as predict
    from deepfsi.measures import Result as Result
    from deepfsi.networks import Mlp as Mlp
    from deepfsi.networks import OwnClassifier as OwnClassifier
    from deepfsi.physics import Scanner as Scanner
    from deepfsi.training import design_of as design_of
    from deepfsi.training import learn as learn

if "GOMP_SPINCOUNT" not in os.environ:
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # read when torch is imported

_HOMES = {
    "Camera": "camera",
    "Dataset": "datasets",
    "Design": "design",
    "Fixed": "jobs",
    "IdealObserver": "evaluation",
    "InputError": "base.errors",
    "Job": "jobs",
    "Looks": "jobs",
    "Mlp": "networks",
    "Nested": "jobs",
    "OwnClassifier": "networks",
    "Passing": "jobs",
    "Patches": "jobs",
    "Range": "jobs",
    "Result": "measures",
    "Scanner": "physics",
    "SharedLight": "jobs",
    "Training": "jobs",
    "classify_run": "lab",
    "classify_table": "lab",
    "design_of": "training",
    "evaluate": "evaluation",
    "from_arrays": "datasets",
    "ideal_observer": "evaluation",
    "learn": "training",
    "load_dataset": "datasets",
    "load_design": "design",
    "photons_per_pixel": "camera",
    "predict": "lab",
}

__all__ = [
    "Camera",
    "Dataset",
    "Design",
    "Fixed",
    "IdealObserver",
    "InputError",
    "Job",
    "Looks",
    "Mlp",
    "Nested",
    "OwnClassifier",
    "Passing",
    "Patches",
    "Range",
    "Result",
    "Scanner",
    "SharedLight",
    "Training",
    "classify_run",
    "classify_table",
    "design_of",
    "evaluate",
    "from_arrays",
    "ideal_observer",
    "learn",
    "load_dataset",
    "load_design",
    "photons_per_pixel",
    "predict",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("deepfsi")
    if name not in _HOMES:
        raise AttributeError(f"module 'deepfsi' has no attribute {name!r}")
    from deepfsi.base import require_extras

    with require_extras():
        return getattr(importlib.import_module(f"deepfsi.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
