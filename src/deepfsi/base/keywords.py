"""Keywords of the functions that users call: named in editors, and mistakes are answered."""

import inspect
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar, get_args

from deepfsi.base.errors import InputError, closest_choice

_P = ParamSpec("_P")
_R = TypeVar("_R")


OF_METHODS = ("self", "cls")
"""Parameters of methods that nobody gives."""


def plain_keywords(
    where: Callable[[str], str | None] = lambda name: None,
) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Decorator that names every keyword of a function, and refuses others with the closest one.

    Keywords that are declared as ``**fields: Unpack[Fields]``, `Fields` a `TypedDict`, stand in
    `help` and in the signature by their names; an editor has them from the declaration itself.
    """

    def decorate(call: Callable[_P, _R]) -> Callable[_P, _R]:
        signature = _with_names(inspect.signature(call))
        named = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
        parameters = signature.parameters.items()
        names = [name for name, one in parameters if one.kind in named and name not in OF_METHODS]
        title = call.__qualname__.removesuffix(".__init__")

        @wraps(call)
        def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            for name in kwargs:
                if name not in names:
                    advice = where(name) or closest_choice(name, names)
                    raise InputError(f"{title} has no keyword {name!r}: {advice}")
            return call(*args, **kwargs)

        wrapper.__signature__ = signature  # type: ignore[attr-defined]
        return wrapper

    return decorate


def _with_names(signature: inspect.Signature) -> inspect.Signature:
    """A signature with the keys of its unpacked dictionary in place of the dictionary."""
    parameters = []
    for one in signature.parameters.values():
        if one.kind is not inspect.Parameter.VAR_KEYWORD:
            parameters.append(one)
            continue
        [fields] = get_args(one.annotation)
        parameters += [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=..., annotation=kind)
            for name, kind in fields.__annotations__.items()
        ]
    return signature.replace(parameters=parameters)
