"""People, put together of body, head, clothes and things."""

from __future__ import annotations

from bunraku_lab.synthetic.families.human_body import build_body
from bunraku_lab.synthetic.families.human_dress import build_clothes, build_items
from bunraku_lab.synthetic.families.human_frame import draw_human
from bunraku_lab.synthetic.families.human_head import build_head
from bunraku_lab.synthetic.families.model import Model

__all__ = ["humanoid"]


def humanoid(m: Model) -> None:
    """A person, a robot or an animal that stands as a person does."""
    kind = m.pick("realistic", "stylised", "chibi", "robot", "brute", weights=(0.29, 0.26, 0.25, 0.13, 0.07))
    if kind == "robot":
        if m.chance(0.75):
            m.restyle(mode="pieces", exponent=m.pick(2.0, 4.0, 8.0, 20.0), cap=m.u(0.25, 0.9), faces=None)
        if m.chance(0.6):
            m.restyle(soft=0.0)
    elif kind == "realistic" and m.chance(0.6):
        m.restyle(mode=m.pick("clay", "regions"), exponent=2.0)
    h = draw_human(m, kind)
    build_body(m, h)
    build_head(m, h)
    build_clothes(m, h)
    build_items(m, h)
