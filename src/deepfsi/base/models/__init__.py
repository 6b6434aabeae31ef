"""Bases of models of settings and of what files hold, with pydantic."""

from deepfsi.base.models.strict import (
    Amount,
    Count,
    LaterFields,
    MessageText,
    Positive,
    Seconds,
    Share,
    StrictModel,
    UserModel,
    WholeNumber,
)

__all__ = [
    "Amount",
    "Count",
    "LaterFields",
    "MessageText",
    "Positive",
    "Seconds",
    "Share",
    "StrictModel",
    "UserModel",
    "WholeNumber",
]
