"""What a comparison found, as one HTML page and as figures. Reads files; needs no torch."""

from deepfsi.report.figures import accuracy_figure, count_figure, masks_figure, values_figure
from deepfsi.report.page import build

__all__ = ["accuracy_figure", "build", "count_figure", "masks_figure", "values_figure"]
