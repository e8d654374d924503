"""One clip of any length as GLB: stretches come one after the other, and their keys lie in a file until the end.

A GLB wants the keys of each joint in one piece, and stretches bring those of all joints at a time. So rows of all
joints go into a temporary file, and columns are read back one by one when the GLB is written. Memory holds one stretch
and one column.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from bunraku.core.animated import AnimatedCharacter
from bunraku.core.animation import Animation
from bunraku.core.resample import checked_fps
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError, OptionError
from bunraku.formats.files import check_output_folder
from bunraku.formats.gltf.builder import GltfBuilder
from bunraku.formats.gltf.bunraku_clip import joint_tracks
from bunraku.formats.gltf.carry_clips import carry_clips
from bunraku.formats.gltf.rig_clip import bone_tracks, placed
from bunraku.formats.gltf.write import build_document, finish_document
from bunraku.formats.gltf.write_rig import RigDocument
from bunraku.geometry.rotations import quaternion_slerp

__all__ = ["Tracks", "write_stretches"]

STILL = 1e-6
"""A track that moves less than this, over the extent of all or as a quaternion, is one key."""


class Tracks:
    """Translations and rotations of J joints, resampled as they come, in a file.

    Args:
        file: An empty file, open for reading and writing.
        joints: How many.
        have: Frames a second of what comes [1/s].
        want: Frames a second of what is kept [1/s].
    """

    def __init__(self, file: BinaryIO, joints: int, have: float, want: float):
        self.file, self.joints, self.step = file, joints, have / want
        self.frames = 0
        self._seen = 0  # frames that came, the last of them is `_last`
        self._last = np.zeros((0, joints, 7))
        self._low, self._high = np.full((joints, 7), np.inf), np.full((joints, 7), -np.inf)

    def add(self, translations: np.ndarray, rotations: np.ndarray) -> None:
        """Add the frames that come next.

        Args:
            translations: In the frame of the parent [m], shape (N, J, 3).
            rotations: Likewise, quaternions xyzw, shape (N, J, 4).
        """
        rows = np.concatenate([self._last, np.concatenate([translations, rotations], axis=-1)])
        first = self._seen - len(self._last)
        self._seen = first + len(rows)
        flips = np.where((rows[1:, :, 3:] * rows[:-1, :, 3:]).sum(axis=-1) < 0, -1.0, 1.0)
        rows[1:, :, 3:] *= np.cumprod(flips, axis=0)[..., None]
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
        """Add the clip to a document; its keys are read when that is written.

        Args:
            builder: With the nodes.
            nodes: Of each joint, length J.
            name: The clip's name.
            fps: Frames a second of what is kept [1/s].
        """
        self.file.flush()
        every = builder.array((np.arange(self.frames) / fps).astype(np.float32)[:, None], bounds=True)
        once = builder.array(np.zeros((1, 1), np.float32), bounds=True)
        size = max(float(np.abs([self._low[:, :3], self._high[:, :3]]).max(initial=0)), 1e-9)
        channels: list[object] = []
        samplers: list[object] = []
        moved = self._high - self._low
        for joint, node in enumerate(nodes):
            for path, part, limit in (("translation", slice(0, 3), STILL * size), ("rotation", slice(3, 7), STILL)):
                moves = bool((moved[joint, part] > limit).any()) or (joint == 0 and path == "translation")
                width = part.stop - part.start
                keys = builder.later(
                    self.frames if moves else 1,
                    width,
                    partial(self._column, joint, part),
                )
                channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
                samplers.append({"input": every if moves else once, "output": keys, "interpolation": "LINEAR"})
        builder.add("animations", {"name": name, "channels": channels, "samplers": samplers})

    def _column(self, joint: int, part: slice, rows: int) -> bytes:
        whole = np.memmap(self.file, "<f4", "r", shape=(self.frames, self.joints, 7))
        return np.ascontiguousarray(whole[:rows, joint, part]).tobytes()


def write_stretches(
    stretches: Iterable[AnimatedCharacter], path: str | Path, *, fps: float | None = None, name: str | None = None
) -> Path:
    """Write stretches of one character as one clip of a GLB. The first frame of each after the first is the last of the
    one before, and is written once.

    Such a file does not hold the handle motion bit for bit, which `bunraku edit` and `--after` read.

    Args:
        stretches: One after the other, as `Animator.stretches` gives them: of handles or of bones.
        path: The file, .glb.
        fps: Frames a second of the keys [1/s]; those of the motion by default.
        name: The clip's name; the file's by default.

    Raises:
        FormatError: The file cannot be written.
        OptionError: There is no stretch, `fps` is out of range, or vertices move on their own.
    """
    path = Path(path)
    if path.suffix.lower() != ".glb":
        raise FormatError(path, "a clip of this length goes into a GLB; end the name in .glb")
    check_output_folder(path)
    coming = iter(stretches)
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
        some: AnimatedCharacter | None = first
        while some is not None:
            start = 0 if some is first else 1
            if isinstance(some, RigAnimation) and rig is not None:
                translations, rotations = bone_tracks(rig.local(some))
            else:
                translations, rotations = joint_tracks(some.handles.positions, some.motion)
            tracks.add(translations[start:], rotations[start:])
            some = next(coming, None)
        tracks.write(builder, nodes, label, rate)
        if rig is not None and rig.source is not None:
            listed = rig.source.document.items("nodes")
            carry_clips(rig.source.document, builder, {node: node for node in range(len(listed))})
        return finish_document(builder, path)
