"""The extension VRMC_vrm of VRM 1.0: which joints of a skeleton in a T-pose are which bones of a humanoid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.character import Rig
from bunraku.skeletons.engine_names import REQUIRED, engine_names

__all__ = ["add_humanoid"]

_NAMES = dict(zip(HANDLE_NAMES, engine_names("vrm"), strict=True))
_BONES = frozenset(name for handle, name in _NAMES.items() if name != handle or handle in ("neck", "head"))
"""The bones of a humanoid among the joints that the 30 handles become; tail, wings and face are none."""
_NEEDED = frozenset(_NAMES[handle] for handle in REQUIRED)
_ARMS = (("leftUpperArm", "leftHand", 1.0), ("rightUpperArm", "rightHand", -1.0))
_ALONG = 0.9  # least cosine between an arm and the x axis in a T-pose
_META = {
    "version": "1", "authors": ["unknown"], "licenseUrl": "https://vrm.dev/licenses/1.0/",
    "avatarPermission": "onlyAuthor", "commercialUsage": "personalNonProfit", "creditNotation": "required",
    "modification": "prohibited",
}  # fmt: skip
"""What the format asks to be told of an avatar's rights, of which nothing is known here: the strictest of each."""


def add_humanoid(tree: dict[str, Any], rig: Rig, nodes: Sequence[int], title: str) -> None:
    """Make a document that of a VRM 1.0 humanoid where a rig has the names of one and rests in a T-pose.

    Args:
        tree: The document; what it has of the extension stays.
        rig: A rig whose joints are not turned at rest.
        nodes: Node of each of its joints.
        title: Name of the avatar.
    """
    place = {name: number for number, name in enumerate(rig.names)}
    extensions = tree.setdefault("extensions", {})
    if not place.keys() >= _NEEDED or {"VRM", "VRMC_vrm"} & set(extensions):
        if not extensions:
            del tree["extensions"]
        return
    for upper, hand, side in _ARMS:
        arm = rig.positions[place[hand]] - rig.positions[place[upper]]
        if side * arm[0] < _ALONG * float((arm**2).sum()) ** 0.5:
            return
    bones = {name: {"node": nodes[number]} for name, number in place.items() if name in _BONES}
    extensions["VRMC_vrm"] = {
        "specVersion": "1.0",
        "meta": {"name": title, **_META},
        "humanoid": {"humanBones": bones},
    }
