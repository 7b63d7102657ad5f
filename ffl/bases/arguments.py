"""Arguments of a basis as a file gives them, checked against the types that its signature states."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from numbers import Integral, Real
from typing import Any

from ffl.errors import InputError

MOST_PARAMETERS = 5000  # of one basis; an update costs N n^2


def _whole(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _root(value: Any) -> bool:
    if isinstance(value, (list, tuple)):
        return len(value) == 2 and all(map(_number, value))
    return _number(value) or isinstance(value, complex)


def _each(holds: Callable[[Any], bool]) -> Callable[[Any], bool]:
    def check(value: Any) -> bool:
        several = not isinstance(value, (str, bytes, Mapping)) and hasattr(value, "__iter__")
        return several and all(holds(item) for item in value)

    return check


# By the annotation's text; a basis of one's own may state others, which are then its own to check.
KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "bool": (lambda value: isinstance(value, bool), "true or false"),
    "int": (_whole, "a whole number"),
    "float": (_number, "a number"),
    "list[int] | None": (_each(_whole), "a list of whole numbers"),
    "Sequence[float]": (_each(_number), "a list of numbers"),
    "Sequence[str]": (_each(lambda value: isinstance(value, str)), "a list of names"),
    "Sequence[complex] | ComplexArray": (_each(_root), "a list of reals or of [re, im] pairs"),
}


def check_arguments(basis: Callable[..., Any], arguments: Mapping[str, Any], where: str) -> None:
    """Raises `InputError` naming `where`.key where a value is not of the type its parameter states."""
    parameters = inspect.signature(basis).parameters
    for key, value in arguments.items():
        holds, wanted = KINDS.get(str(parameters[key].annotation), (None, ""))
        if holds is not None and not holds(value):
            raise InputError(f"{where}.{key} = {repr(value)[:60]}: give {wanted}")


def check_size(n: int, what: str) -> None:
    """Raises `InputError` where a basis would have more than `MOST_PARAMETERS`; before it is built."""
    if n > MOST_PARAMETERS:
        raise InputError(f"{what} gives {n} parameters; at most {MOST_PARAMETERS} can be learned")
