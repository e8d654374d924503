"""What every constraint on a motion has in common: a kind, a check of what it goes together with, and a JSON form."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Self

from bunraku.core.request.json_form import from_json, to_json
from bunraku.errors import OptionError

__all__ = ["Constraint", "option"]


def option(name: str, dashes: str = "") -> str:
    """An option's name in a message: of Python, or of the command line where `dashes` stand before it."""
    return f"{dashes}{name.replace('_', '-') if dashes else name}"


class Constraint:
    """Something that a motion must meet; subclasses are frozen dataclasses."""

    kind: ClassVar[str] = ""
    """Its name in a JSON form, and what options call it."""
    alone: ClassVar[tuple[tuple[str, ...], str]] = ((), "")
    """Kinds that it does not go with, and the sentence that says why; "{}" in it stands for the names of options."""
    several: ClassVar[bool] = False
    """Whether a request may have more than one."""

    def check(self, others: Sequence[Constraint], dashes: str = "") -> None:
        """Whether it goes together with other constraints.

        Args:
            others: All of a request, this one included.
            dashes: What stands before the names of options in messages.

        Raises:
            OptionError: It does not.
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
        """The constraint of a JSON form, its kind already looked at.

        Raises:
            OptionError: It is none.
        """
        if isinstance(data, dict):
            data = {key: value for key, value in data.items() if key != "kind"}
        return from_json(cls, data, f"the {cls.kind.replace('_', ' ')}")
