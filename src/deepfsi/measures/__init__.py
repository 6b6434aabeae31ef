"""What answers are measured by: one table, and the results of tests made with it (no torch)."""

from deepfsi.measures.answers import MOST_DRAWS, Answers, ClassAnswers, ValueAnswers
from deepfsi.measures.lines import (
    details_text,
    error_text,
    results_lines,
    score_text,
    worst_text,
)
from deepfsi.measures.reliability import (
    calibration_error,
    chance_error,
    confidence_error,
    confidence_groups,
)
from deepfsi.measures.results import Estimates, Result, ResultList, lit_masks, lit_text
from deepfsi.measures.table import MEASURES, MainMeasure, Measure, main_measure

__all__ = [
    "MEASURES",
    "MOST_DRAWS",
    "Answers",
    "ClassAnswers",
    "Estimates",
    "MainMeasure",
    "Measure",
    "Result",
    "ResultList",
    "ValueAnswers",
    "calibration_error",
    "chance_error",
    "confidence_error",
    "confidence_groups",
    "details_text",
    "error_text",
    "lit_masks",
    "lit_text",
    "main_measure",
    "results_lines",
    "score_text",
    "worst_text",
]
