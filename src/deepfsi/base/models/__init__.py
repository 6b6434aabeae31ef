"""Bases of models of settings and of what files hold, with pydantic."""

from deepfsi.base.models.strict import MessageText, Seconds, StrictModel, UserModel

__all__ = [
    "MessageText",
    "Seconds",
    "StrictModel",
    "UserModel",
]
