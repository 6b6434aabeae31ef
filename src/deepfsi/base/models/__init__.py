"""Bases of models of settings and of what files hold, with pydantic."""

from deepfsi.base.models.strict import Seconds, StrictModel, UserModel

__all__ = [
    "Seconds",
    "StrictModel",
    "UserModel",
]
