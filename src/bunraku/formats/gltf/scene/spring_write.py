"""Springs in a glTF document: the extension VRMC_springBone of VRM 1.0, and the same as plain extras for programs that
read no extensions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bunraku.core.vrm_model import VrmModel

__all__ = ["SPRINGS", "add_spring_extras", "add_springs"]

SPRINGS = "VRMC_springBone"


def add_springs(tree: dict[str, Any], avatar: VrmModel, nodes: Sequence[int]) -> None:
    """Add an avatar's springs as `VRMC_springBone`.

    Args:
        tree: The document.
        avatar: Its springs and colliders, by bones.
        nodes: Node of each bone.
    """
    if avatar.springs:
        tree.setdefault("extensions", {})[SPRINGS] = {"specVersion": "1.0", **_springs(avatar, nodes)}


def add_spring_extras(tree: dict[str, Any], avatar: VrmModel, nodes: Sequence[int]) -> None:
    """Add an avatar's springs to the document's extras, as `springs`, in the form of `VRMC_springBone`. Arguments are
    those of `add_springs`.
    """
    if avatar.springs:
        extras = tree.get("extras")
        tree["extras"] = {**(extras if isinstance(extras, dict) else {}), "springs": _springs(avatar, nodes)}


def _springs(avatar: VrmModel, nodes: Sequence[int]) -> dict[str, Any]:
    colliders = []
    for collider in avatar.colliders:
        body: dict[str, Any] = {"offset": _numbers(collider.offset), "radius": round(collider.radius, 6)}
        if collider.tail is not None:
            body["tail"] = _numbers(collider.tail)
        colliders.append({"node": nodes[collider.node], "shape": {collider.shape: body}})
    springs = []
    for spring in avatar.springs:
        joints = [
            {
                "node": nodes[joint.node],
                "hitRadius": round(joint.radius, 6),
                "stiffness": round(joint.stiffness, 6),
                "gravityPower": round(joint.gravity, 6),
                "gravityDir": _numbers(joint.gravity_direction),
                "dragForce": round(joint.drag, 6),
            }
            for joint in spring.joints
        ]
        entry: dict[str, Any] = {"name": spring.name, "joints": joints}
        if spring.groups:
            entry["colliderGroups"] = list(spring.groups)
        springs.append(entry)
    out: dict[str, Any] = {"springs": springs}
    if colliders:
        out["colliders"] = colliders
        out["colliderGroups"] = [{"name": "body", "colliders": list(group)} for group in avatar.groups]
    return out


def _numbers(values: np.ndarray) -> list[float]:
    return [round(float(value), 6) for value in values]
