"""Comparisons and studies as HTML pages and figures. Reads files; needs no torch."""

from deepfsi.report.accuracy import accuracy_figure, count_figure
from deepfsi.report.comparison_page import build
from deepfsi.report.masks import masks_figure, values_figure
from deepfsi.report.section import Claim, Picture, Section, Table
from deepfsi.report.study_page import write_study

__all__ = [
    "Claim",
    "Picture",
    "Section",
    "Table",
    "accuracy_figure",
    "build",
    "count_figure",
    "masks_figure",
    "values_figure",
    "write_study",
]
