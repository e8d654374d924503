"""Arguments of public functions, checked against what their annotations say."""

from __future__ import annotations

import functools
import inspect
import numbers
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ParamSpec, TypeVar

from bunraku.errors import OptionError

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")
_KINDS: dict[str, type] = {"float": numbers.Real, "int": numbers.Integral, "Mapping": Mapping, "Iterable": Iterable}
"""What annotations mean by names that are wider than the class of this name."""


def checked(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """The function, with an OptionError where an argument is of none of the types that its annotation names.

    Annotations are read as text, so that types need not be imported. What stands in brackets is not looked at.
    """

    @functools.wraps(function)
    def call(*args: _Given.args, **kwargs: _Given.kwargs) -> _Result:
        signature, known = _signature(function), function.__globals__
        for name, given in signature.bind(*args, **kwargs).arguments.items():
            annotation, kind = str(function.__annotations__.get(name, "object")), signature.parameters[name].kind
            values, kinds = {name: given}, _parts(annotation)
            if kind in (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL):
                values = given if isinstance(given, dict) else {f"{name}[{at}]": each for at, each in enumerate(given)}
            for label, value in values.items():
                if type(value).__name__ not in kinds and not any(_fits(part, value, known) for part in kinds):
                    shown = repr(value) if isinstance(value, str | int | float | None) else type(value).__name__
                    raise OptionError(f"{label} must be {_named(annotation)}, not {shown[:60]}")
        return function(*args, **kwargs)

    return call


@functools.cache
def _signature(function: Callable[..., object]) -> inspect.Signature:
    return inspect.signature(function)


@functools.cache
def _parts(annotation: str) -> tuple[str, ...]:
    """The names of a union, without what stands in brackets: "str | list[str] | None" is str, list and None."""
    bare, depth = "", 0
    for letter in annotation:
        depth += (letter == "[") - (letter == "]")
        bare += letter if depth == 0 and letter != "]" else ""
    return tuple(part.strip() for part in bare.split("|"))


def _named(annotation: str) -> str:
    """An annotation in words: the values of a Literal, and the names of types without what stands in brackets."""
    values = " or ".join(part for part in annotation.partition("Literal[")[2].partition("]")[0].split(", ") if part)
    return " or ".join(values if part == "Literal" else part for part in _parts(annotation))


def _fits(name: str, value: object, known: Mapping[str, Any]) -> bool:
    if name in ("object", "Any", "None"):
        return name != "None" or value is None
    if name == "Sequence":  # a text is one only where the annotation names it
        return (isinstance(value, Sequence) and not isinstance(value, str)) or getattr(value, "ndim", 0) > 0
    if name == "Literal":
        return isinstance(value, str)
    name = name.rpartition(".")[2]
    kind = _KINDS.get(name, known.get(name))
    if isinstance(kind, type):
        return isinstance(value, kind)
    return kind is not None or any(each.__name__ == name for each in type(value).__mro__)  # a name for other types
