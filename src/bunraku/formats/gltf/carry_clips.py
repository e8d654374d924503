"""Carry the clips of one glTF document over to another: their keys as they are, their channels onto the same nodes."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from bunraku.errors import FormatError
from bunraku.formats.gltf.builder import GltfBuilder
from bunraku.formats.gltf.container.document import Document

__all__ = ["carry_clips", "free_name"]

_OUTPUTS = {"translation": ("VEC3",), "rotation": ("VEC4",), "scale": ("VEC3",), "weights": ("SCALAR",)}


def free_name(name: str, taken: Iterable[str]) -> str:
    """The name, with a number behind it where it is taken."""
    known, number, out = set(taken), 1, name
    while out in known:
        number += 1
        out = f"{name}-{number}"
    return out


def carry_clips(
    document: Document,
    builder: GltfBuilder,
    nodes: Mapping[int, int],
    unnamed: str | None = None,
    only: Collection[str] | None = None,
) -> list[str]:
    """Add all clips of a document to those that are being written; names that are taken get a number.

    Args:
        document: That has the clips.
        builder: Of the document that gets them.
        nodes: Its node for each node of `document`; channels of others are left out, as are those that the file has
            wrong.
        unnamed: The name of clips that have none; None leaves them without.
        only: Names of those that are carried; all where None.

    Returns:
        The names of what was added; a clip without a channel is not.
    """
    known = [str(clip.get("name")) for clip in builder.tree.get("animations", [])]
    added: list[str] = []
    carried: dict[tuple[int, tuple[str, ...]], int] = {}

    def keys(index: int, kinds: tuple[str, ...]) -> int:
        if (index, kinds) not in carried:
            values = document.accessor(index, kinds, raw=True)
            extra = {"normalized": True} if document.item("accessors", index).get("normalized") else {}
            carried[index, kinds] = builder.array(values, bounds=kinds == ("SCALAR",), **extra)
        return carried[index, kinds]

    for clip in document.items("animations"):
        if only is not None and clip.get("name") not in only:
            continue
        samplers: list[object] = []
        channels: list[object] = []
        for channel in document.objects(clip, "channels"):
            target = channel.get("target")
            path = target.get("path") if isinstance(target, dict) else None
            node = nodes.get(target.get("node", -1)) if isinstance(target, dict) else None
            listed = document.objects(clip, "samplers")
            number = channel.get("sampler")
            if path not in _OUTPUTS or node is None or type(number) is not int or not 0 <= number < len(listed):
                continue
            old = listed[number]
            try:
                sampler = {"input": keys(old["input"], ("SCALAR",)), "output": keys(old["output"], _OUTPUTS[path])}
            except (FormatError, KeyError):
                continue
            if old.get("interpolation") in ("STEP", "CUBICSPLINE", "LINEAR"):
                sampler["interpolation"] = old["interpolation"]
            channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
            samplers.append(sampler)
        if channels:
            given = clip.get("name") or unnamed
            name = free_name(str(given), known) if given else ""
            known.append(name)
            added.append(name)
            kept = {"extras": clip["extras"]} if isinstance(clip.get("extras"), dict) else {}
            named = {"name": name} if name else {}
            builder.add("animations", {**named, **kept, "channels": channels, "samplers": samplers})
    return added
