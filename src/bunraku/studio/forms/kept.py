"""What a project says of takes that a page requested elsewhere."""

from __future__ import annotations

from typing import Any

from bunraku.core.request.json_form import from_json
from bunraku.studio.forms.changes import ChangeForm
from bunraku.studio.forms.drawing import DressForm, read_path, read_pins
from bunraku.studio.forms.script import read_script
from bunraku.studio.forms.takes import TakeForm

__all__ = ["check_asked"]


def check_asked(how: object, script: object, asked: object) -> None:
    """Whether what a project says of a take was requested by a page.

    Args:
        how: How the take was made.
        script: Its script.
        asked: What its record kept of the form.

    Raises:
        OptionError: It was not.
    """
    kept: dict[str, Any] = asked if isinstance(asked, dict) else {}
    if how == "animate":
        form = from_json(TakeForm, {**kept, "script": script})
        read_script(form.script)
        read_path(form.path or ())
        read_pins(form.pins)
    elif how == "edit":
        read_pins(from_json(ChangeForm, kept).pins)
    else:
        from_json(DressForm, {name: kept[name] for name in ("apparel", "stiffness", "gravity") if name in kept})
