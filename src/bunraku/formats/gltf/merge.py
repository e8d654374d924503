"""Clips of one character from several glTF files in one: the first file as it is, with the clips of the others."""

from __future__ import annotations

import copy
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np

from bunraku.errors import FormatError
from bunraku.formats.files import check_input, read_bounded
from bunraku.formats.gltf.builder import GltfBuilder
from bunraku.formats.gltf.carry import image_type
from bunraku.formats.gltf.carry_clips import carry_clips
from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.container.open import open_document
from bunraku.formats.gltf.rig_clip import placed
from bunraku.formats.gltf.scene.nodes import read_nodes, read_skins
from bunraku.formats.gltf.write import finish_document

__all__ = ["SAME", "merge_documents", "whole_document"]

SAME = 1e-3
"""Of a skeleton's extent: bones that rest as near as this are the same ones."""


def merge_documents(paths: Sequence[Path], path: Path, *, only: Collection[str] | None = None) -> Path:
    """Write the first file with the clips of all others behind its own, onto the nodes of the same names.

    Args:
        paths: GLB, glTF or VRM files of one character, at least one.
        path: The file to write, which may be one of them.
        only: Names of the clips that are taken of the others; all where None.

    Raises:
        FormatError: A file is broken or holds no clip, or is of another character.
    """
    base, *others = [_opened(some) for some in paths]
    builder = whole_document(base)
    for document in others:
        if not document.items("animations"):
            raise FormatError(document.path, "it holds no clip to merge; make one with `bunraku animate`")
        nodes = _same_nodes(base, document)
        for clip in document.items("animations"):
            for channel in document.objects(clip, "channels"):
                node = nodes.get((channel.get("target") or {}).get("node", -1))
                if node is not None:
                    placed(builder.tree["nodes"][node])  # one that is animated may have no matrix
        carry_clips(document, builder, nodes, document.path.stem, only)
    return finish_document(builder, path)


def whole_document(document: Document) -> GltfBuilder:
    """What holds all of a document, to which more is added; images that were files are embedded.

    Raises:
        FormatError: A buffer view is broken.
    """
    tree = copy.deepcopy(document.tree)
    accessors = tree.get("accessors")
    builder = GltfBuilder(tree)
    for number, view in enumerate(document.items("bufferViews")):
        kept = {key: value for key, value in view.items() if key not in ("buffer", "byteOffset", "byteLength")}
        index = builder.view(document.view(number))
        builder.tree["bufferViews"][index].update(kept)
    if accessors:
        tree["accessors"] = accessors
    for number, data in document.images.items():
        if data is not None:
            image = {key: value for key, value in tree["images"][number].items() if key != "uri"}
            mime = image_type(data[:16]) or image.get("mimeType") or "image/png"
            tree["images"][number] = {**image, "mimeType": mime, "bufferView": builder.view(data)}
    return builder


def _opened(path: Path) -> Document:
    check_input(path)
    return open_document(path, read_bounded(path))


def _same_nodes(base: Document, other: Document) -> dict[int, int]:
    """Node of the one document for each animated node of the other, by names from the root, or names that are there
    once.

    Raises:
        FormatError: One has no counterpart, or rests elsewhere.
    """
    own, theirs = _lines(base), _lines(other)
    by_line = {line: node for node, line in reversed(list(enumerate(own)))}
    short = [line[-1] for line in own]
    out: dict[int, int] = {}
    for clip in other.items("animations"):
        for channel in other.objects(clip, "channels"):
            target = channel.get("target")
            node = target.get("node") if isinstance(target, dict) else None
            if type(node) is not int or not 0 <= node < len(theirs) or node in out:
                continue
            line = theirs[node]
            found = by_line.get(line)
            if found is None and short.count(line[-1]) == 1:
                found = short.index(line[-1])
            if found is None:
                raise FormatError(
                    other.path,
                    f"its clip moves '{line[-1][:60]}', which {base.path.name} has not: it is of another character; "
                    "put its motion on this one with `bunraku transfer`",
                )
            out[node] = found
    _check_rest(base, other, out)
    return out


def _lines(document: Document) -> list[tuple[str, ...]]:
    """The names from the root down to each node."""
    tree, nodes = read_nodes(document), document.items("nodes")
    out: list[tuple[str, ...]] = [()] * len(nodes)
    for node in tree.order:
        above = int(tree.parents[node])
        out[node] = (*(out[above] if above >= 0 else ()), str(nodes[node].get("name") or f"node {node}"))
    return out


def _check_rest(base: Document, other: Document, nodes: dict[int, int]) -> None:
    """Raise FormatError where both have skins, and joints of the same names were bound elsewhere."""
    places = []
    for document in (base, other):
        tree = read_nodes(document)
        skins = read_skins(document, tree)
        found: dict[int, np.ndarray] = {}
        for matrices, slots in zip(skins.inverse, skins.slots, strict=True):
            rests = np.linalg.pinv(matrices)[:, :3, 3]
            found |= {skins.nodes[joint]: rest for joint, rest in zip(slots.tolist(), rests, strict=False)}
        places.append(found)
    pairs = [(places[0][nodes[node]], rest) for node, rest in places[1].items() if nodes.get(node) in places[0]]
    if len(pairs) < 2:
        return
    own, theirs = (np.array(some) for some in zip(*pairs, strict=True))
    own, theirs = own - own.mean(axis=0), theirs - theirs.mean(axis=0)
    if np.abs(own - theirs).max() > SAME * max(float(np.ptp(own, axis=0).max()), 1e-9):
        raise FormatError(
            other.path,
            f"its bones have the names of those of {base.path.name} and rest elsewhere: it is of another character; "
            "put its motion on this one with `bunraku transfer`",
        )
