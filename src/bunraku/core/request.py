"""What all requests share: arguments of public functions checked against their annotations, limits of numbers, a JSON
form that is read strictly, and constraints with a kind.
"""

from __future__ import annotations

import functools
import inspect
import json
import math
import numbers
import re
import types
from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
from dataclasses import MISSING, dataclass, fields, is_dataclass
from numbers import Real
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NoReturn,
    ParamSpec,
    Self,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

from bunraku.errors import OptionError

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the share of it that is done, 0 to 1."""


@dataclass(frozen=True)
class Limit:
    """The range of a number: its name in messages, the least and the largest value."""

    name: str
    low: float
    high: float

    def check(self, value: float | None, name: str = "") -> None:
        """Raise OptionError, under another name if one is given, unless this is a finite number in the range; None
        stands for a default and passes.
        """
        if value is not None and not isinstance(value, Real):
            raise OptionError(f"{name or self.name} must be a number, not {_shown(value)}")
        if value is not None and not (math.isfinite(value) and self.low <= value <= self.high):
            raise OptionError(f"{name or self.name} must be from {self.low:g} to {self.high:g}, not {value:g}")


@dataclass(frozen=True)
class Length:
    """How many letters a text may have, or entries a list."""

    most: int
    least: int = 0

    def check(self, value: Sized | None, name: str) -> None:
        """Raise OptionError unless a text or a list of this name has so many; None passes."""
        noun = "characters" if isinstance(value, str) else "entries"
        if value is not None and len(value) > self.most:
            raise OptionError(f"{name} has more than {self.most} {noun}, {len(value):,}; leave some out")
        if value is not None and len(value) < self.least:
            raise OptionError(f"{name} has less than {self.least} {noun}; say more")


def check_all(values: Iterable[tuple[Limit, float | None]], dashes: str = "") -> None:
    """`Limit.check` of several numbers; `dashes` stand before their names in messages."""
    for limit, value in values:
        limit.check(value, f"{dashes}{limit.name}")


SECONDS = Limit("seconds", 0.5, 120.0)
"""Length of a clip that is generated in one pass [s]; longer ones are generated in stretches."""
WHOLE = Limit("seconds", SECONDS.low, 36_000)
"""Length of a clip, and of each of its parts [s]."""
USUAL = 6.0  # length of what goes on, such as walking, where none is asked for [s]
MOMENT = Limit("time", 0, WHOLE.high)
"""A time in a clip [s]."""
PLACE = Limit("a point", -1e6, 1e6)
"""A coordinate [m]; farther from the origin a float32 is coarser than 6 cm."""
FPS = Limit("frames a second", 1, 240)
"""Rate of a clip, a file or a video [1/s]."""
SEED = Limit("seed", 0, 2**63 - 1)
STEPS = Limit("steps", 1, 1000)
"""Steps of the sampler."""
GUIDANCE = Limit("guidance", 0, 20)
"""Scale of classifier-free guidance."""
CANDIDATES = Limit("candidates", 1, 16)
"""Motions that are drawn for one result."""
TAKES = Limit("takes", 1, 100)
"""Takes of one sentence in one run."""
STIFFNESS = Limit("stiffness", 0.001, 1000)
"""Factor on the stiffness of apparel."""
GRAVITY = Limit("gravity", 0, 10)
"""Factor on the gravity of simulated apparel."""


Kind = TypeVar("Kind")
MOST_ENTRIES = 1000
"""Entries of a list."""
MOST_LETTERS = 10_000
"""Letters of a text."""
MOST_BYTES = 4 << 20
"""Bytes of a JSON text."""
MOST_VALUES = 400_000
"""Values of a JSON text; each takes some 60 to 100 bytes of memory once it is parsed."""
DEEPEST = 16
"""Depth of nested lists and objects."""
_STRING = re.compile(rb'"(?:[^"\\]++|\\.)*+"?', re.DOTALL)
_SIGNS = bytes(sorted({*range(256)}.difference(b"[]{}")))
_COUNTS = {2: "two", 3: "three", 4: "four"}


def read_json(data: bytes, name: str, most: int = MOST_BYTES) -> Any:
    """The value of an untrusted JSON text in UTF-8 of a name for messages. Its size in memory is bounded before it is
    parsed. OptionError if it is not JSON, too large, or nested too deeply.
    """
    if len(data) > most:
        raise OptionError(f"{name} has more than {most >> 20} MiB of JSON; leave out what is not needed")
    bare = _STRING.sub(b'""', data)
    if sum(bare.count(sign) for sign in (b",", b":", b"[", b"{")) > MOST_VALUES:
        raise OptionError(f"{name} has more than {MOST_VALUES:,} values; leave out what is not needed")
    brackets = bare.translate(None, _SIGNS)
    for _ in range(DEEPEST):
        brackets = brackets.replace(b"[]", b"").replace(b"{}", b"")
    if brackets:
        raise OptionError(f"{name} is not JSON, or is nested more than {DEEPEST} deep; write it again")
    try:
        return parse_json(data)
    except (ValueError, RecursionError):
        raise OptionError(f"{name} is not JSON; write it again") from None


def parse_json(data: bytes) -> Any:
    """The value of a JSON text in UTF-8, its texts `storable`; ValueError or RecursionError where it is none."""
    found = json.loads(data.decode("utf-8-sig"), parse_constant=_no_constant)
    return storable(found) if b"\\ud" in data or b"\\uD" in data else found


def storable(value: Any) -> Any:
    """The same with U+FFFD in place of lone surrogates, which JSON and file names may hold, and which no file and no
    page takes; texts within lists and objects too.
    """
    if isinstance(value, str):
        return value if value.isascii() else value.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    if isinstance(value, dict):
        return {storable(name): storable(each) for name, each in value.items()}
    return type(value)(map(storable, value)) if isinstance(value, list | tuple) else value


def _no_constant(name: str) -> NoReturn:
    """Refuse NaN and Infinity, which Python's parser of JSON accepts."""
    raise ValueError(f"{name} is not JSON")


def to_json(thing: object) -> Any:
    """A dataclass as a JSON object with a key for each field; arrays and tuples become lists. OptionError if a value
    has no such form.
    """
    if is_dataclass(thing) and not isinstance(thing, type):
        return {field.name: to_json(getattr(thing, field.name)) for field in fields(thing)}
    if type(thing).__name__ == "ndarray":
        return cast("Any", thing).tolist()
    if isinstance(thing, tuple | list):
        return [to_json(entry) for entry in thing]
    if isinstance(thing, dict):
        return {str(name): to_json(entry) for name, entry in thing.items()}
    if thing is None or isinstance(thing, bool | int | float | str):
        return thing
    raise OptionError(f"{type(thing).__name__} has no form in JSON; save it as a file and name that")


def from_json(kind: type[Kind], data: object, name: str = "") -> Kind:
    """The dataclass of what `json.loads` gave, under a name for messages. Its fields are numbers, `Annotated` with a
    `Limit` perhaps, texts, arrays, tuples of these, other dataclasses, or unions. OptionError if a key is unknown or
    missing; a value is of another type, not finite, or too large; or the class refuses the values.
    """
    name = name or kind.__name__.lower()
    if not isinstance(data, dict):
        raise OptionError(f"{name} must be an object, not {_shown(data)}")
    hints = get_type_hints(kind, include_extras=True)
    by_name = {field.name: field for field in fields(cast(Any, kind)) if field.init}
    for key in data:
        if key not in by_name:
            raise OptionError(f"{name} has no '{str(key)[:40]}'; it has {', '.join(by_name)}")
    for key, field in by_name.items():
        if key not in data and field.default is MISSING and field.default_factory is MISSING:
            raise OptionError(f"{name} needs '{key}'")
    return kind(**{key: _value(hints[key], value, key) for key, value in data.items()})


def _value(hint: Any, value: Any, name: str) -> Any:
    """A JSON value as a field's type wants it."""
    if hint in (object, Any):  # read by a class of its own
        return value
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        found = _value(inner[0], value, name)
        for limit in inner[1:]:
            limit.check(found, name)
        return found
    if origin in (Union, types.UnionType):
        if value is None and type(None) in inner:
            return None
        return _value(next(inner_kind for inner_kind in inner if inner_kind is not type(None)), value, name)
    if origin is Literal:
        if value not in inner or isinstance(value, bool):
            raise OptionError(f"{name} is one of {', '.join(map(str, inner))}, not {_shown(value)}")
        return value
    if origin in (tuple, list):
        found = _tuple((inner[0], ...) if origin is list else inner, value, name)
        return list(found) if origin is list else found
    if origin is dict:
        if not isinstance(value, dict):
            raise OptionError(f"{name} must be an object, not {_shown(value)}")
        return {key: _value(inner[1], each, name) for key, each in value.items()}
    if getattr(hint, "__name__", "") == "ndarray":
        return _array(value, name)
    if is_dataclass(hint):
        return from_json(cast(type, hint), value, name)
    return _plain(hint, value, name)


def _plain(hint: Any, value: Any, name: str) -> Any:
    if hint is bool:
        if not isinstance(value, bool):
            raise OptionError(f"{name} must be true or false, not {_shown(value)}")
        return value
    if hint is str:
        if not isinstance(value, str):
            raise OptionError(f"{name} must be a text, not {_shown(value)}")
        if len(value) > MOST_LETTERS:
            raise OptionError(f"{name} has more than {MOST_LETTERS} characters")
        return value
    if hint in (int, float):
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise OptionError(f"{name} must be a number, not {_shown(value)}")
        if (isinstance(value, float) and not math.isfinite(value)) or abs(value) > 1e300:
            raise OptionError(f"{name} must be a number that is finite")
        if hint is int and value != int(value):
            raise OptionError(f"{name} must be a whole number, not {value:g}")
        return hint(value)
    raise TypeError(f"{name}: {hint} has no form in JSON")


def _tuple(inner: tuple[Any, ...], value: Any, name: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise OptionError(f"{name} must be a list, not {_shown(value)}")
    if len(inner) == 2 and inner[1] is Ellipsis:
        if len(value) > MOST_ENTRIES:
            raise OptionError(f"{name} has more than {MOST_ENTRIES} entries")
        return tuple(_value(inner[0], entry, name) for entry in value)
    if len(value) != len(inner):
        bare = {get_args(each)[0] if get_origin(each) is Annotated else each for each in inner}
        noun = "numbers" if bare <= {int, float} else "entries"
        raise OptionError(f"{name} must be {_COUNTS.get(len(inner), len(inner))} {noun}, not {len(value)}")
    return tuple(_value(hint, entry, name) for hint, entry in zip(inner, value, strict=True))


def _array(value: Any, name: str) -> Any:
    import numpy as np  # here, since a prompt is parsed without it

    try:
        array = np.asarray(value)
    except (ValueError, OverflowError, RecursionError):
        array = np.empty(0, object)
    if array.dtype.kind not in "if" or array.size > MOST_ENTRIES or not np.isfinite(array).all():
        raise OptionError(f"{name} must be rows of at most {MOST_ENTRIES} finite numbers, all of one length")
    return array.astype(np.float64)


def _shown(value: Any) -> str:
    text = "null" if value is None else repr(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


def option(name: str, dashes: str = "") -> str:
    """An option's name in a message: that of Python, or with `dashes` before it that of the command line."""
    return f"{dashes}{name.replace('_', '-') if dashes else name}"


class Constraint:
    """Something that a motion must meet; subclasses are frozen dataclasses."""

    kind: ClassVar[str]
    """Its name in JSON and among the options."""
    alone: ClassVar[tuple[tuple[str, ...], str]]
    """Kinds that it cannot be combined with, and why, in a sentence; "{}" in it stands for the names of options."""
    several: ClassVar[bool]
    """Whether a request may have more than one."""

    def __init_subclass__(
        cls, kind: str, alone: tuple[tuple[str, ...], str] = ((), ""), several: bool = False
    ) -> None:  # fmt: skip
        cls.kind, cls.alone, cls.several = kind, alone, several

    def check(self, others: Sequence[Constraint], dashes: str = "") -> None:
        """Raise OptionError unless it can be combined with the other constraints of a request; `dashes` stand before
        the names of options in the message.
        """
        kinds, why = self.alone
        if any(other.kind in kinds for other in others):
            raise OptionError(why.format(*(option(name, dashes) for name in (self.kind, *kinds))))
        if not self.several and sum(other.kind == self.kind for other in others) > 1:
            raise OptionError(f"{option(self.kind, dashes)} is asked for twice; leave one out")

    def to_json(self) -> dict[str, Any]:
        """Its JSON form: its kind, and a key for each field."""
        return {"kind": self.kind, **to_json(self)}

    @classmethod
    def from_json(cls, data: object) -> Self:
        """The constraint of a JSON object of this kind. OptionError if it is none."""
        if isinstance(data, dict):
            data = {key: value for key, value in data.items() if key != "kind"}
        return from_json(cls, data, f"the {cls.kind.replace('_', ' ')}")


_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")
_KINDS: dict[str, type] = {"float": numbers.Real, "int": numbers.Integral, "Mapping": Mapping, "Iterable": Iterable}
"""What annotations mean by names that are wider than the class of this name."""


def checked(function: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """The function, with an OptionError where an argument is missing, unknown or of none of the types that its
    annotation names.

    Annotations are read as text, so that types need not be imported. What stands in brackets is not looked at.
    """

    signature, known = inspect.signature(function), function.__globals__

    @functools.wraps(function)
    def call(*args: _Given.args, **kwargs: _Given.kwargs) -> _Result:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError as error:
            raise OptionError(f"{function.__name__}: {error}; it takes {', '.join(signature.parameters)}") from None
        for name, given in bound.arguments.items():
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
