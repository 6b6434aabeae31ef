"""The paper's experiments by name: each a recipe, figures, the numbers behind them, and claims."""

from pathlib import Path

from deepfsi.base.errors import InputError, check_choice
from deepfsi_paper import compression, mlgauss, quantization
from deepfsi_paper.camera import claims as camera_study
from deepfsi_paper.experiment import Experiment
from deepfsi_paper.indian_pines import claims as indian_pines
from deepfsi_paper.mnist import accuracy, masks
from deepfsi_paper.ovit import claims as ovit
from deepfsi_paper.report.study_page import write_study

STUDIES: dict[str, tuple[Experiment, ...]] = {
    "mnist": (accuracy.EXPERIMENT, masks.EXPERIMENT),
    "compression": (compression.EXPERIMENT,),
    "mlgauss": (mlgauss.EXPERIMENT,),
    "quantization": (quantization.EXPERIMENT,),
    "indian-pines": (indian_pines.EXPERIMENT,),
    "ovit": (ovit.EXPERIMENT,),
    "ovit-images": (ovit.IMAGES,),
    "ovit-full": (ovit.FULL,),
    "hardware": (camera_study.EXPERIMENT,),
}
"""Experiments by the name under which they are reproduced, in the order of the page."""


def find(name: str) -> tuple[Experiment, ...]:
    """Experiments of that name, or `InputError`."""
    check_choice("experiment", name, STUDIES)
    return STUDIES[name]


def page(folder: Path) -> Path:
    """Write `report.html` from whatever experiments a folder holds, with its figures."""
    sections = [section for each in _every() if (section := each.section(folder))]
    if not sections:
        raise InputError(f"no experiment in {folder}: run `deepfsi reproduce mnist -o {folder}`")
    return write_study(folder, "Deep feature-specific imaging, reproduced", sections)


def _every() -> list[Experiment]:
    return [each for study in STUDIES.values() for each in study]
