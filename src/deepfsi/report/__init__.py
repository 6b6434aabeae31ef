"""Pages and figures of what was measured, which need matplotlib and jinja2."""

from deepfsi.report.accuracy import (
    ReadoutTest,
    accuracy_axes,
    accuracy_figure,
    marker_key,
    readouts_figure,
)
from deepfsi.report.comparison_page import (
    comparison_lines,
    leader_differences,
    scenes_text,
    write_report,
)
from deepfsi.report.masks import (
    BAR_LABEL,
    brightest_masks,
    design_figure,
    looks_figure,
    mask_axes,
    peak_value,
    signed,
)
from deepfsi.report.pictures import pictures_figure, rail_light_figure
from deepfsi.report.rendering import LAW_TERMS, english_list, flat, render
from deepfsi.report.series import noises, series_axes
from deepfsi.report.verdict import verdict_of

__all__ = [
    "BAR_LABEL",
    "LAW_TERMS",
    "ReadoutTest",
    "accuracy_axes",
    "accuracy_figure",
    "brightest_masks",
    "comparison_lines",
    "design_figure",
    "english_list",
    "flat",
    "leader_differences",
    "looks_figure",
    "marker_key",
    "mask_axes",
    "noises",
    "peak_value",
    "pictures_figure",
    "rail_light_figure",
    "readouts_figure",
    "render",
    "scenes_text",
    "series_axes",
    "signed",
    "verdict_of",
    "write_report",
]
