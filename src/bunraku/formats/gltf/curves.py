"""The channels of a glTF clip, and where nodes are at any moment of it."""

from __future__ import annotations

import numpy as np

from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.scene.nodes import NodeTree
from bunraku.geometry.rotations import matrix_from_quaternion, quaternion_slerp

__all__ = ["MAX_SECONDS", "Curves", "clip_curves", "node_worlds"]

MAX_SECONDS = 600.0
"""Longest clip that is played [s]."""

MAX_KEYS = 50_000_000  # of all channels of a clip: channels may share their keys, and take memory each
MAX_WORLDS = 20_000_000  # transforms of all nodes that joints hang on, in all frames: 2.6 GB

Curves = dict[tuple[int, str], tuple[np.ndarray, np.ndarray, str]]

_DEFAULTS = {"translation": [0.0, 0, 0], "rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1]}


def clip_curves(document: Document, animation: dict[str, object]) -> Curves:
    """Times (M,), values (M, C) or (M, 3, C), and interpolation of each animated (node, property)."""
    samplers = document.objects(animation, "samplers")
    curves, total, last = {}, 0, max(len(document.items("nodes")) - 1, 0)
    for channel in document.objects(animation, "channels"):
        target = channel.get("target")
        if not isinstance(target, dict) or target.get("path") not in tuple(_DEFAULTS) or "node" not in target:
            continue  # morph targets and what extensions add
        node, kind = document.integer(target, "node", high=last), target["path"]
        index = document.integer(channel, "sampler")
        if index >= len(samplers):
            document.fail(
                "an animation channel names a sampler that does not exist; the file is broken, export it again"
            )
        how = samplers[index].get("interpolation", "LINEAR")
        times = document.accessor(samplers[index].get("input"), ("SCALAR",))[:, 0].astype(float)
        values = document.accessor(
            samplers[index].get("output"), ("VEC4",) if kind == "rotation" else ("VEC3",)
        ).astype(float)
        keys = 3 if how == "CUBICSPLINE" else 1
        total += len(values)
        if total > MAX_KEYS:
            document.fail(f"its clip has more than {MAX_KEYS:,} keys; cut it")
        if (
            not len(times)
            or len(values) != keys * len(times)
            or (np.diff(times) <= 0).any()
            or not np.isfinite(values).all()
            or not np.isfinite(times).all()
        ):
            document.fail("an animation channel has keys that do not fit together; the file is broken, export it again")
        curves[node, kind] = (times, values.reshape(len(times), 3, -1) if keys == 3 else values, str(how))
    return curves


def _sample(times: np.ndarray, values: np.ndarray, how: str, kind: str, moments: np.ndarray) -> np.ndarray:
    """Values of a curve at moments [s], held before the first key and after the last, shape (N, C)."""
    before = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 1)
    after = np.minimum(before + 1, len(times) - 1)
    step = times[after] - times[before]
    share = np.clip((moments - times[before]) / np.where(step > 0, step, 1), 0, 1)
    if how == "STEP":
        return values[before]
    if how == "CUBICSPLINE":
        s, d = share[:, None], step[:, None]
        start, end = values[before], values[after]  # each key: in-tangent, value, out-tangent
        out = (2 * s**3 - 3 * s**2 + 1) * start[:, 1] + d * (s**3 - 2 * s**2 + s) * start[:, 2]
        return out + (3 * s**2 - 2 * s**3) * end[:, 1] + d * (s**3 - s**2) * end[:, 0]
    if kind == "rotation":
        return quaternion_slerp(values[before], values[after], share)
    return values[before] + (values[after] - values[before]) * share[:, None]


def node_worlds(
    document: Document, tree: NodeTree, curves: Curves, moments: np.ndarray, chosen: list[int]
) -> np.ndarray:
    """World transforms of the chosen nodes at each moment, shape (N, J, 4, 4)."""
    nodes = document.items("nodes")
    moving = {node for node, _ in curves}
    known: dict[int, np.ndarray] = {}

    def world(node: int) -> np.ndarray:
        chain = []
        while node >= 0 and node not in known:
            chain.append(node)
            node = int(tree.parents[node])
        if (len(known) + len(chain)) * len(moments) > MAX_WORLDS:
            document.fail(
                f"its clip moves {len(known) + len(chain)} nodes in {len(moments)} frames, which are too many; cut it"
            )
        for link in reversed(chain):
            above = int(tree.parents[link])
            if link not in moving:  # its default place, carried along by what is above it
                rest = tree.local[link]
                known[link] = known[above] @ rest if above >= 0 else np.broadcast_to(rest, (len(moments), 4, 4))
            else:
                local = _local(document, nodes[link], link, curves, moments)
                known[link] = known[above] @ local if above >= 0 else _front(document) @ local
        return known[chain[0]] if chain else known[node]

    return np.stack([world(node) for node in chosen], axis=1)


def _front(document: Document) -> np.ndarray:
    """What turns a VRM 0.x avatar, which looks along -Z, as reading its character does."""
    extensions = document.tree.get("extensions")
    return np.diag([-1.0, 1, -1, 1]) if isinstance(extensions, dict) and "VRM" in extensions else np.eye(4)


def _local(document: Document, node: dict[str, object], index: int, curves: Curves, moments: np.ndarray) -> np.ndarray:
    parts = {}
    for kind, default in _DEFAULTS.items():
        if (index, kind) in curves:
            times, values, how = curves[index, kind]
            parts[kind] = _sample(times, values, how, kind, moments)
        else:
            parts[kind] = np.broadcast_to(document.numbers(node, kind, default), (len(moments), len(default)))
    local = np.zeros((len(moments), 4, 4))
    local[:, :3, :3] = matrix_from_quaternion(parts["rotation"]) * parts["scale"][:, None, :]
    local[:, :3, 3], local[:, 3, 3] = parts["translation"], 1
    return local
