"""What dressed characters wear: MakeHuman's clothes taken apart, and garments cut from the helper surfaces of its base
mesh.

A piece is worn over one body shape; its vertices have the joint and handle weights of the base vertices they are bound
to. Hair and hats move with the head and are the handle `head_top`; skirts follow pelvis and legs, blended from left to
right.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES, JOINT_COUNT
from bunraku.errors import FormatError
from bunraku.geometry.easing import smooth_step
from bunraku.geometry.graph import mesh_parts, unique_edges
from bunraku.geometry.surface import vertex_normals
from bunraku_lab.synthetic.dressed.mhclo import Clothes, fit, fit_weights, read_mhclo
from bunraku_lab.synthetic.people.makehuman import MakeHumanBody

__all__ = ["Garment", "Piece", "Wardrobe", "BodyShape", "joined", "skirt_weights"]

_LEGS = [1, 2, 4, 5, 7, 8, 10, 11]
_HEAD, _TOP = HANDLE_NAMES.index("head"), HANDLE_NAMES.index("head_top")


@dataclass(frozen=True, eq=False)
class Piece:
    """A surface with weights. Positions are those of one body in its own pose [m].

    Args:
        points: Shape (V, 3).
        faces: Shape (F, 3).
        joints: Weights of the 22 joints, shape (V, 22).
        handles: Weights of the 30 handles, shape (V, 30).
    """

    points: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    handles: np.ndarray

    def cut(self, keep: np.ndarray) -> Piece:
        """Only the faces of which all corners are kept, shape (V,) bool."""
        faces = self.faces[keep[self.faces].all(axis=1)]
        used, faces = np.unique(faces, return_inverse=True)
        return Piece(self.points[used], faces.reshape(-1, 3), self.joints[used], self.handles[used])

    def puffed(self, thickness: np.ndarray | float) -> Piece:
        """Moved outwards along the normals [m]."""
        normals = vertex_normals(self.points, self.faces)
        return Piece(self.points + normals * np.reshape(thickness, (-1, 1)), self.faces, self.joints, self.handles)


@dataclass(frozen=True, eq=False)
class BodyShape:
    """A body shape that can be dressed.

    Args:
        vertices: Of the base mesh, in its own pose [m], shape (B, 3).
        joints: Shape (22, 3).
    """

    vertices: np.ndarray
    joints: np.ndarray


def joined(pieces: list[Piece]) -> Piece:
    """Many pieces as one mesh of loose parts."""
    starts = np.cumsum([0, *(len(piece.points) for piece in pieces)])
    return Piece(
        np.concatenate([piece.points for piece in pieces]),
        np.concatenate([piece.faces + start for piece, start in zip(pieces, starts, strict=False)]),
        np.concatenate([piece.joints for piece in pieces]),
        np.concatenate([piece.handles for piece in pieces]),
    )


def skirt_weights(points: np.ndarray, joints: np.ndarray, carried: np.ndarray) -> np.ndarray:
    """Weights of a skirt as game rigs have them: the pelvis at the waist, the thighs further down, half and half in the
    middle.

    Args:
        points: Shape (V, 3).
        joints: Of the body, shape (22, 3).
        carried: Weights that hold above the hips, of joints or handles, shape (V, K).
    """
    hip, knee, ankle = (float(joints[pair, 1].mean()) for pair in ([1, 2], [4, 5], [7, 8]))
    waist, wide = float(joints[3, 1]), 1.3 * float(abs(joints[1, 0]))
    thigh = 0.9 * smooth_step(points[:, 1], hip, knee + 0.35 * (hip - knee))
    shin = 0.6 * smooth_step(points[:, 1], knee, ankle + 0.4 * (knee - ankle)) * thigh
    left = smooth_step(points[:, 0], -wide, wide)
    own = np.zeros_like(carried)
    own[:, 0] = 1 - thigh
    for column, side in ((1, left), (2, 1 - left)):
        own[:, column] = (thigh - shin) * side
        own[:, column + 3] = shin * side
    share = smooth_step(points[:, 1], waist, hip)[:, None]
    return np.asarray(share * own + (1 - share) * carried)


@dataclass(frozen=True, eq=False)
class Garment:
    """One garment of an archive file: which vertices (shape (V,) bool) it has, and whether it hangs as a skirt."""

    clothes: Clothes
    vertices: np.ndarray
    skirt: bool


class Wardrobe:
    """All pieces of a folder of MakeHuman clothes (`.mhclo`), and those that are cut from the base mesh.

    Args:
        body: The base mesh.
        folder: Folder with clothes and hair, searched through.

    Raises:
        FormatError: There are no clothes under the folder, or a file is damaged.
    """

    def __init__(self, body: MakeHumanBody, folder: str | Path):
        self.body = body
        plain = body.shape({})
        self._plain = BodyShape(plain, body.joints(plain))
        self.whole: dict[str, Garment] = {}
        self.upper: dict[str, Garment] = {}
        self.lower: dict[str, Garment] = {}
        self.shoes: dict[str, Garment] = {}
        self.hair: dict[str, Garment] = {}
        self.hats: dict[str, Garment] = {}
        files = sorted(Path(folder).rglob("*.mhclo"))
        for file in files:
            self._sort(file.stem, read_mhclo(file))
        if not (self.upper and self.lower):
            raise FormatError(
                folder,
                "there are no MakeHuman clothes (.mhclo) for the upper and the lower body here; name the unpacked "
                "folder",
            )

    def _sort(self, name: str, clothes: Clothes) -> None:
        weights = fit_weights(clothes, self.body.joint_weights)
        everything = np.ones(len(clothes), bool)
        tags = {tag.lower() for tag in clothes.tags}
        if "hats" in tags:
            self.hats[name] = Garment(clothes, everything, False)
            return
        if "shoes" in tags:
            self.shoes[name] = Garment(clothes, everything, False)
            return
        helper = np.isin(clothes.base, self.body.groups["helper-hair"]).mean()
        if weights[:, [9, 12, 13, 14, _HEAD]].sum(axis=1).mean() > 0.9 or helper > 0.5:
            self.hair[name] = Garment(clothes, everything, False)
            return
        parts = mesh_parts(unique_edges(clothes.faces, len(clothes)), len(clothes))
        size = np.bincount(parts)
        legs = np.bincount(parts, weights[:, [0, *_LEGS]].sum(axis=1)) / size
        if ((legs > 0.25) & (legs < 0.7) & (size > 500)).any():
            self.whole[name] = Garment(clothes, everything, False)
            return
        for shelf, kind in ((self.lower, legs[parts] > 0.5), (self.upper, legs[parts] <= 0.5)):
            if kind.sum() > 50:
                shelf[name] = Garment(
                    clothes, kind, _hangs(fit(clothes, self._plain.vertices), self._plain.joints, clothes.faces, kind)
                )

    def wear(self, garment: Garment, figure: BodyShape) -> Piece:
        """A garment of the archive on a body."""
        clothes, points = garment.clothes, fit(garment.clothes, figure.vertices)
        joints, handles = fit_weights(clothes, self.body.joint_weights), fit_weights(clothes, self.body.handle_weights)
        if garment.skirt:
            joints, handles = (skirt_weights(points, figure.joints, weights) for weights in (joints, handles))
        return Piece(points, clothes.faces, joints, handles).cut(garment.vertices)

    def wear_on_head(self, garment: Garment, figure: BodyShape) -> Piece:
        """Hair or a hat on a body: all of it moves with the head, as `head_top`."""
        points = fit(garment.clothes, figure.vertices)
        joints, handles = np.zeros((len(points), JOINT_COUNT)), np.zeros((len(points), HANDLE_COUNT))
        joints[:, _HEAD], handles[:, _TOP] = 1, 1
        return Piece(points, garment.clothes.faces, joints, handles)

    def part(self, figure: BodyShape, *groups: str, keep: np.ndarray | None = None) -> Piece:
        """Parts of the base mesh itself ("body", "helper-tights", "helper-l-eye", ...), or what is kept of them, shape
        (B,) bool.
        """
        wanted = np.zeros(len(figure.vertices), bool)
        for group in groups:
            wanted[self.body.groups[group]] = True
        keep = wanted if keep is None else wanted & keep
        return Piece(figure.vertices, self.body.faces, self.body.joint_weights, self.body.handle_weights).cut(keep)

    def skirt(self, figure: BodyShape, length: float, flare: float) -> Piece:
        """A skirt from the waist down.

        Args:
            figure: The body.
            length: 0 ends at the hips, 1 at the knees, 2 at the ankles.
            flare: How much wider the hem is than the helper surface, as a share of its width.
        """
        piece = self.part(figure, "helper-skirt")
        hip, knee, ankle = (float(figure.joints[pair, 1].mean()) for pair in ([1, 2], [4, 5], [7, 8]))
        hem = float(np.interp(length, [0, 1, 2], [hip, knee, ankle]))
        points = piece.points.copy()
        down = smooth_step(points[:, 1], hip + 0.1, ankle)
        points[:, [0, 2]] = figure.joints[0, [0, 2]] + (points[:, [0, 2]] - figure.joints[0, [0, 2]]) * (
            1 + flare * down[:, None]
        )
        piece = Piece(
            points,
            piece.faces,
            *(skirt_weights(points, figure.joints, weights) for weights in (piece.joints, piece.handles)),
        )
        return piece.cut(points[:, 1] >= min(hem, hip - 0.1))


def _hangs(points: np.ndarray, joints: np.ndarray, faces: np.ndarray, kind: np.ndarray) -> bool:
    """Whether a garment spans the gap between the thighs well below the crotch."""
    edges = unique_edges(faces, len(points))
    ends = points[edges[kind[edges].all(axis=1)]]
    below = ends[..., 1].mean(axis=1) < joints[1, 1] - 0.22
    return bool((below & (ends[:, 0, 0] * ends[:, 1, 0] <= 1e-9)).sum() > 4)
