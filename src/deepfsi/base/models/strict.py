"""Bases of the models of settings and of what files hold, and the types of their fields."""

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)

from deepfsi.base import Message, as_input_error, seconds

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)


class StrictModel(BaseModel):
    """Model that is never changed once it is made, and knows no other fields than its own."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class _InOneLine(ModelMetaclass):
    """Makes models, or raises `InputError`: pydantic's own error has several lines."""

    def __call__(cls, *args: Any, **fields: Any) -> Any:
        with as_input_error():
            return super().__call__(*args, **fields)


class UserModel(StrictModel, metaclass=_InOneLine):
    """Model of what a user writes in Python."""


Seconds = Annotated[float, BeforeValidator(seconds)]
"""Seconds, 0 or more, of a number or of a text with a unit."""


Count = Annotated[int, Field(ge=1)]
"""Number of things of which there is one at least."""

WholeNumber = Annotated[int, Field(ge=0)]
"""Number of things of which there may be none, or the place of one among others."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""Number above 0."""

Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""Number, 0 or more."""

Share = Annotated[float, Field(ge=0, le=1)]
"""Part of a whole, 0 to 1."""


def _as_message(text: Any, read: ValidatorFunctionWrapHandler) -> Any:
    """A message as it is: pydantic would copy its text alone."""
    return text if isinstance(text, Message) else read(text)


MessageText = Annotated[str, WrapValidator(_as_message)]
"""Text of a message, which may name settings."""
