"""Several clips in one GLB, and one long clip written stretch by stretch."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Collection, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
from bunraku.core.files import check_output_folder, read_bounded
from bunraku.core.geometry.rotations import continuous, quaternion_slerp
from bunraku.core.motion import checked_fps
from bunraku.errors import FormatError, OptionError
from bunraku.files.gltf.carry import carry_clips, image_type
from bunraku.files.gltf.document import Document, GltfBuilder
from bunraku.files.gltf.nodes import read_nodes, read_skins
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.write import build_document, finish_document, joint_tracks
from bunraku.files.gltf.write_rig import RigDocument, bone_tracks, placed, with_still

SAME_BONES = 1e-3
"""Bones that rest this near are the same, over the skeleton's extent: float32's rounding stays far below it."""


def merge_documents(paths: Sequence[Path], path: Path, *, only: Collection[str] | None = None) -> Path:
    """Write the first of several GLB, glTF or VRM files of one character with the clips of all others, or `only` some
    of them by name, after its own, onto the nodes of the same names; it may be written over one of them. FormatError if
    a file is broken or holds no clip, or is of another character.
    """
    base, *others = [open_document(file, read_bounded(file)) for file in paths]
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
    """A builder with all of a document, for more to be added; images that were files are embedded."""
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


def _same_nodes(base: Document, other: Document) -> dict[int, int]:
    """Node of one document for each animated node of another, by names from the root, or by names that occur once.
    FormatError if one has no counterpart, or rests elsewhere.
    """
    ours, theirs = _lines(base), _lines(other)
    by_line = {line: node for node, line in reversed(list(enumerate(ours)))}
    short = [line[-1] for line in ours]
    out: dict[int, int] = {}
    for clip in other.items("animations"):
        for channel in other.objects(clip, "channels"):
            target = channel.get("target")
            node = target.get("node") if isinstance(target, dict) else None
            if type(node) is not int or not 0 <= node < len(theirs) or node in out:
                continue
            line = theirs[node]
            same = by_line.get(line)
            if same is None and short.count(line[-1]) == 1:
                same = short.index(line[-1])
            if same is None:
                raise _another(other.path, f"its clip moves '{line[-1][:60]}', which {base.path.name} lacks")
            out[node] = same
    _check_rest(base, other, out)
    return out


def _another(path: Path, why: str) -> FormatError:
    return FormatError(path, f"{why}: it is of another character; put its motion on this one with `bunraku transfer`")


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
        positions: dict[int, np.ndarray] = {}
        for matrices, slots in zip(skins.inverse, skins.slots, strict=True):
            rests = np.linalg.pinv(matrices)[:, :3, 3]
            positions |= {skins.nodes[joint]: rest for joint, rest in zip(slots.tolist(), rests, strict=False)}
        places.append(positions)
    pairs = [(places[0][nodes[node]], rest) for node, rest in places[1].items() if nodes.get(node) in places[0]]
    if len(pairs) < 2:
        return
    ours, theirs = (np.array(points) for points in zip(*pairs, strict=True))
    ours, theirs = ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
    if np.abs(ours - theirs).max() > SAME_BONES * max(float(np.ptp(ours, axis=0).max()), 1e-9):
        raise _another(other.path, f"its bones have the names of those of {base.path.name} and rest elsewhere")


STILL = 1e-6
"""A track that moves less, over the extent of all or as a quaternion, is one key. It is some roundings of float32."""


class Tracks:
    """Translations and rotations of J joints in a temporary file, resampled as they come.

    Args:
        file: An empty file, open for reading and writing.
        joints: How many.
        have, want: Frames a second of what comes and of what is kept [1/s].
    """

    def __init__(self, file: BinaryIO, joints: int, have: float, want: float):
        self.file, self.joints, self.step = file, joints, have / want
        self.frames = 0
        self._seen = 0  # frames that came, the last of them is `_last`
        self._last = np.zeros((0, joints, 7))
        self._low, self._high = np.full((joints, 7), np.inf), np.full((joints, 7), -np.inf)

    def add(self, translations: np.ndarray, rotations: np.ndarray) -> None:
        """Add the next frames: translations in the frame of the parent [m], shape (N, J, 3), and rotations, quaternions
        xyzw, shape (N, J, 4).
        """
        rows = np.concatenate([self._last, np.concatenate([translations, rotations], axis=-1)])
        first = self._seen - len(self._last)
        self._seen = first + len(rows)
        rows[..., 3:] = continuous(rows[..., 3:])
        self._last = rows[-1:]
        stop = int((self._seen - 1) / self.step + 1e-6) + 1
        at = np.minimum(np.arange(self.frames, stop) * self.step, self._seen - 1) - first
        if not len(at):
            return
        low = np.minimum(at.astype(np.int64), max(len(rows) - 2, 0))
        high = np.minimum(low + 1, len(rows) - 1)
        share = at - low
        out = np.empty((len(at), self.joints, 7), "<f4")
        out[..., :3] = rows[low, :, :3] * (1 - share[:, None, None]) + rows[high, :, :3] * share[:, None, None]
        out[..., 3:] = quaternion_slerp(rows[low, :, 3:], rows[high, :, 3:], np.repeat(share[:, None], self.joints, 1))
        self._low, self._high = np.minimum(self._low, out.min(axis=0)), np.maximum(self._high, out.max(axis=0))
        self.frames = stop
        self.file.write(out.tobytes())

    def write(self, builder: GltfBuilder, nodes: list[int], name: str, fps: float) -> None:
        """Add the clip to a document with the nodes of the joints; its keys, `fps` a second, are read when that is
        written.
        """
        self.file.flush()
        every = builder.array((np.arange(self.frames) / fps).astype(np.float32)[:, None], bounds=True)
        once = builder.array(np.zeros((1, 1), np.float32), bounds=True)
        size = max(float(np.abs([self._low[:, :3], self._high[:, :3]]).max(initial=0)), 1e-9)
        clip: dict[str, Any] = {"name": name, "channels": [], "samplers": []}
        moved = self._high - self._low
        for joint, node in enumerate(nodes):
            for path, part, limit in (("translation", slice(0, 3), STILL * size), ("rotation", slice(3, 7), STILL)):
                moves = bool((moved[joint, part] > limit).any()) or (joint == 0 and path == "translation")
                width = part.stop - part.start
                keys = builder.later(self.frames if moves else 1, width, partial(self._column, joint, part))
                builder.channel(clip, node, path, every if moves else once, keys)
        builder.add("animations", clip)

    def _column(self, joint: int, part: slice, rows: int) -> bytes:
        stored = np.memmap(self.file, "<f4", "r", shape=(self.frames, self.joints, 7))
        return np.ascontiguousarray(stored[:rows, joint, part]).tobytes()


def write_stretches(
    stretches: Iterable[AnimatedCharacter], path: str | Path, *, fps: float | None = None, name: str | None = None
) -> Path:
    """Write stretches of one character, of handles or of bones as `Animator.stretches` gives them, as one clip of a
    GLB, with keys at the motion's or another rate and the file's or another name. The first frame of each after the
    first is the last of the one before, and is written once. Such a file does not hold the handle motion bit for bit,
    which `bunraku edit` and `--after` read. FormatError if the file cannot be written; OptionError if there is no
    stretch, `fps` is out of range, or vertices move on their own.
    """
    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise FormatError(path, "a clip of this length goes into a GLB; end the name in .glb")
    check_output_folder(path)
    coming = (with_still(some) if isinstance(some, Animation) else some for some in stretches)
    first = next(coming, None)
    if first is None:
        raise OptionError("there is nothing to write; give at least one stretch")
    rate, label = checked_fps(fps, first.fps), str(name) if name else path.stem
    with tempfile.TemporaryFile(dir=path.parent) as file:
        if isinstance(first, Animation):
            builder, nodes = build_document(first.character, first.handles, path)
            rig: RigDocument | None = None
        elif isinstance(first, RigAnimation):
            rig = RigDocument.of(first.character)
            builder, nodes = rig.builder, rig.nodes
            for node in nodes:
                placed(builder.tree["nodes"][node])  # one that is animated may have no matrix
        else:
            raise OptionError("vertices that move on their own go into clips of one pass; leave out --apparel")
        tracks = Tracks(file, len(nodes), first.fps, rate)
        stretch: AnimatedCharacter | None = first
        while stretch is not None:
            start = 0 if stretch is first else 1
            if isinstance(stretch, RigAnimation) and rig is not None:
                translations, rotations = bone_tracks(rig.local(stretch))
            else:
                translations, rotations = joint_tracks(stretch.handles.positions, stretch.motion)
            tracks.add(translations[start:], rotations[start:])
            stretch = next(coming, None)
        tracks.write(builder, nodes, label, rate)
        if rig is not None and rig.source is not None:
            listed = rig.source.document.items("nodes")
            carry_clips(rig.source.document, builder, {node: node for node in range(len(listed))})
        return finish_document(builder, path)
