"""Bases of the models of settings and of what files hold, and the types of their fields."""

import json
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, dataclass_transform, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    WrapValidator,
)

from deepfsi.base.errors import as_input_error
from deepfsi.base.quantities import seconds

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)


class StrictModel(BaseModel):
    """Model that is frozen and refuses unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)


def of_kinds(
    core: Iterable[type[StrictModel]], find: Callable[[Any], type[StrictModel] | None]
) -> WrapValidator:
    """Validator of a field whose `kind` names a model of the core, or of another package."""
    kinds = {get_args(model.model_fields["kind"].annotation)[0]: model for model in core}

    def validate(value: Any, handler: Any, info: ValidationInfo) -> Any:
        if not isinstance(value, Mapping):
            return value
        model = kinds.get(value.get("kind")) or find(value.get("kind"))
        if model is None:
            return handler(value)
        # A wrapped validator gets lists of JSON, which strict models take from JSON alone
        as_json = info.mode == "json"
        return model.model_validate_json(json.dumps(value)) if as_json else model(**value)

    return WrapValidator(validate)


@dataclass_transform(kw_only_default=True, field_specifiers=(Field,))
class _InOneLine(ModelMetaclass):
    """Makes models, or raises `InputError`: pydantic's own error has several lines."""

    if not TYPE_CHECKING:  # editors complete the fields of a model, which this would hide

        def __call__(cls, **fields: Any) -> Any:
            with as_input_error():
                return super().__call__(**fields)


class UserModel(StrictModel, metaclass=_InOneLine):
    """Model of what a user writes in Python."""

    model_config = ConfigDict(defer_build=False)  # its signature is shown before its first use


Seconds = Annotated[float, BeforeValidator(seconds)]
"""Seconds, 0 or more, of a number or of a text with a unit."""


Count = Annotated[int, Field(ge=1)]
"""Number of things, 1 or more."""

WholeNumber = Annotated[int, Field(ge=0)]
"""Number of things or index in a list, 0 or more."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""Number above 0."""

Amount = Annotated[float, Field(ge=0, allow_inf_nan=False)]
"""Number, 0 or more."""

Share = Annotated[float, Field(ge=0, le=1)]
"""Part of a whole, 0 to 1."""
