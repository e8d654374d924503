"""What the archive of clothes lacks, made by code: hats, ears, spiky hair, capes, wings, tails, bags, armour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES, JOINT_COUNT, JOINT_NAMES
from bunraku.core.geometry.curves import smooth_step
from bunraku.core.geometry.graph import mean_operator, unique_edges
from bunraku.core.geometry.rotations import matrix_from_axis_angle, rotation_between
from bunraku.core.geometry.surface import vertex_normals
from bunraku_lab.synthetic.dressed.garments import BodyShape, Piece, Wardrobe, joined
from bunraku_lab.synthetic.makehuman import BODY_VERTICES
from bunraku_lab.synthetic.surfaces import sheet_faces

_J = {name: joint for joint, name in enumerate(JOINT_NAMES)}
_H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
# Modelled by eye: radius over the head's, and height over the head's, from the brim to the top.
_HATS = {
    "wizard": [(1.9, -0.03), (1.03, 0.0), (0.62, 0.5), (0.3, 0.95), (0.02, 1.5)],
    "top hat": [(1.5, 0.02), (1.04, 0.0), (1.0, 0.45), (1.04, 0.8), (0.02, 0.82)],
    "sun hat": [(2.2, -0.08), (1.04, 0.02), (0.98, 0.2), (0.6, 0.38), (0.02, 0.42)],
    "beanie": [(1.08, -0.15), (1.1, 0.0), (1.0, 0.2), (0.6, 0.38), (0.02, 0.44)],
    "crown": [(1.04, 0.0), (1.07, 0.12), (1.15, 0.3)],
    "cone": [(1.04, 0.0), (0.5, 0.45), (0.02, 0.9)],
}


def _rigid(points: np.ndarray, faces: np.ndarray, joint: str, handle: str) -> Piece:
    joints, handles = np.zeros((len(points), JOINT_COUNT)), np.zeros((len(points), HANDLE_COUNT))
    joints[:, _J[joint]], handles[:, _H[handle]] = 1, 1
    return Piece(points, faces, joints, handles)


def tube(centers: np.ndarray, radii: np.ndarray, sides: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """A tube along a curve, shape (N, 3); ends stay open where their radius is not small."""
    along = np.gradient(centers, axis=0)
    angle = np.arange(sides) * 2 * np.pi / sides
    rings = np.stack([np.cos(angle), np.zeros(sides), -np.sin(angle)], axis=1)
    up = np.array([0, 1.0, 0])
    points = [
        center + radius * rings @ rotation_between(up, step).T
        for center, radius, step in zip(centers, radii, along, strict=True)
    ]
    return np.concatenate(points), sheet_faces(len(centers), sides, wrap=True)[:, ::-1]


def box(center: np.ndarray, size: Sequence[float] | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return center + corners * np.asarray(size), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _skull(wardrobe: Wardrobe, figure: BodyShape) -> tuple[np.ndarray, np.ndarray]:
    """Centre and half extents of the head [m]."""
    head = figure.vertices[wardrobe.body.groups["body"]][
        wardrobe.body.joint_weights[wardrobe.body.groups["body"], _J["head"]] > 0.95
    ]
    low, high = head.min(axis=0), head.max(axis=0)
    return (low + high) / 2, (high - low) / 2


def hat(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """A hat turned on a lathe: wizard's, top, sun, beanie, crown or cone."""
    center, half = _skull(wardrobe, figure)
    profile = np.array(_HATS[str(rng.choice(sorted(_HATS)))])
    profile[:, 1] *= rng.uniform(0.7, 1.3)
    ring = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    fat = 1.05 * rng.uniform(1, 1.15)
    local = np.stack([profile[:, :1] * np.cos(ring) * half[0] * fat, np.broadcast_to(2 * half[1] * profile[:, 1:],
    (len(profile), 20)),
                      -profile[:, :1] * np.sin(ring) * half[2] * fat], axis=-1).reshape(-1, 3)  # fmt: skip
    tilt = np.asarray(matrix_from_axis_angle(rng.normal(0, 0.12, 3)))
    brow = center + half * np.array([0, rng.uniform(0.35, 0.6), -0.1])
    return _rigid(local @ tilt.T + brow, sheet_faces(len(profile), 20, wrap=True)[:, ::-1], "head", "head_top")


def ears(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """Two ears or horns on the head: short or long, flat or round."""
    center, half = _skull(wardrobe, figure)
    angle, length, wide = rng.uniform(0.3, 1.0), half[1] * rng.uniform(0.5, 2.2), half[0] * rng.uniform(0.2, 0.55)
    lean, bend = rng.uniform(-0.4, 0.5), rng.uniform(-0.6, 0.6)
    t = np.linspace(0, 1, 7)[:, None]
    pieces = []
    for side in (1, -1):
        out = np.array([side * np.sin(angle), np.cos(angle), 0])
        curve = (
            center
            + half * out * 0.92
            + length * t * (out + [0, 0, -lean])
            + length * bend * t * t * np.array([side * 0.6, 0.3, 0.4])
        )
        points, faces = tube(curve, wide * np.sin(np.pi * (0.35 + 0.63 * t[:, 0])), 8)
        pieces.append(_rigid(points, faces, "head", "head_top"))
    return joined(pieces)


def spikes(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """Hair of cones, as drawn characters have it."""
    body = wardrobe.body
    normals = vertex_normals(figure.vertices, body.faces)
    center, half = _skull(wardrobe, figure)
    skin = body.groups["body"]
    offset = (figure.vertices[skin] - center) / half
    scalp = skin[
        (body.joint_weights[skin, _J["head"]] > 0.95)
        & (offset[:, 1] > 0.1 + 0.6 * offset[:, 2])
        & (np.abs(normals[skin]).sum(axis=1) > 0)
    ]
    pieces = []
    comb = rng.normal(0, 0.5, 3) + [0, 0.2, -0.4]
    long, wide = half[1] * rng.uniform(0.4, 1.1), half[0] * rng.uniform(0.2, 0.4)
    for root in rng.choice(scalp, min(int(rng.integers(20, 60)), len(scalp)), replace=False):
        direction = normals[root] + comb * rng.uniform(0.3, 1)
        direction /= np.linalg.norm(direction) + 1e-9
        t = np.linspace(-0.15, 1, 5)[:, None]
        curve = figure.vertices[root] + long * rng.uniform(0.6, 1.2) * t * direction + long * 0.2 * t * t * [0, -1, 0]
        pieces.append(_rigid(*tube(curve, wide * np.linspace(1, 0.03, 5), 6), "head", "head_top"))
    return joined(pieces)


def glasses(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """Two panes and their bridge before the eyes."""
    size = _skull(wardrobe, figure)[1][0] * rng.uniform(0.55, 0.8)
    pieces = []
    eyes = [figure.vertices[wardrobe.body.groups[f"helper-{side}-eye"]].mean(axis=0) for side in "lr"]
    forward = np.array([0, 0, 0.025])
    for eye in eyes:
        pieces.append(_rigid(*box(eye + forward, (size, size * rng.uniform(0.6, 0.9), 0.004)), "head", "face"))
    pieces.append(_rigid(*box(np.mean(eyes, axis=0) + forward, (size * 0.6, 0.006, 0.004)), "head", "face"))
    return joined(pieces)


def _back(wardrobe: Wardrobe, figure: BodyShape, heights: np.ndarray) -> np.ndarray:
    """Where the back is furthest behind at each height or above it [m], for heights from the top down."""
    body = figure.vertices[wardrobe.body.groups["body"]]
    body = body[np.abs(body[:, 0]) < 1.5 * abs(figure.joints[_J["left_hip"], 0])]
    found = [body[np.abs(body[:, 1] - height) < 0.04][:, 2].min(initial=figure.joints[9, 2]) for height in heights]
    return np.minimum.accumulate(np.array(found))


def cape(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """A cape down the back: it hangs from the chest, and its halves are the two wings."""
    shoulder, neck, floor = (
        figure.joints[_J["left_shoulder"]], figure.joints[_J["neck"]], figure.vertices[:BODY_VERTICES, 1].min(),
    )  # fmt: skip
    u, v = np.meshgrid(np.linspace(-1, 1, 25), np.linspace(0, 1, 24))
    length = (shoulder[1] - floor) * rng.uniform(0.35, 0.97)
    y = shoulder[1] + 0.6 * (neck[1] - shoulder[1]) * (1 - u**2) - v * length
    back = _back(wardrobe, figure, y[:, 12])[:, None]
    away, folds, phase = rng.uniform(0.02, 0.05), int(rng.integers(2, 6)), rng.uniform(0, 6)
    z = back - away + 0.06 * u**2 * (1 - v) - 0.15 * rng.random() * v + 0.03 * v * np.sin(folds * np.pi * u + phase)
    x = u * shoulder[0] * (rng.uniform(0.9, 1.15) + rng.uniform(0, 1.0) * v)
    piece = _rigid(np.stack([x, y, z], axis=-1).reshape(-1, 3), sheet_faces(24, 25)[:, ::-1], "spine3", "spine3")
    return Piece(piece.points, piece.faces, piece.joints, _winged(piece, smooth_step(v.reshape(-1), 0.0, 0.15)))


def _winged(piece: Piece, share: np.ndarray) -> np.ndarray:
    """Handle weights of which a share is the left wing's on the left and the right wing's on the right."""
    left = smooth_step(piece.points[:, 0], -0.08, 0.08)
    handles = piece.handles * (1 - share[:, None])
    handles[:, _H["left_wing"]] += share * left
    handles[:, _H["right_wing"]] += share * (1 - left)
    return np.asarray(handles)


def wings(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """Two wings on the upper back, flat and jagged."""
    chest, size = figure.joints[_J["spine3"]], float(np.ptp(figure.vertices[:BODY_VERTICES, 1]))
    root = np.array([0.03, chest[1] + 0.05, _back(wardrobe, figure, chest[1:2])[0] + 0.01])
    span, lift, sweep = size * rng.uniform(0.25, 0.6), rng.uniform(-0.1, 0.9), rng.uniform(0.1, 0.9)
    u, v = np.meshgrid(np.linspace(0, 1, 16), np.linspace(0, 1, 9))
    depth = (
        size
        * rng.uniform(0.12, 0.4)
        * (0.35 + u)
        * (1 + 0.3 * np.cos(u * np.pi * int(rng.integers(2, 7))))
        * (1.15 - u)
    )
    x, y, z = u * span, lift * span * np.sin(u * 2.0) - v * depth, -sweep * span * u
    right = root + np.stack([x, y, z], axis=-1).reshape(-1, 3)
    pieces = [
        _rigid(right, sheet_faces(9, 16)[:, ::-1], "spine3", "left_wing"),
        _rigid(right * [-1, 1, 1], sheet_faces(9, 16), "spine3", "right_wing"),
    ]
    return joined(pieces)


def tail(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """A tail of any length and swing."""
    pelvis, size = figure.joints[0], float(np.ptp(figure.vertices[:BODY_VERTICES, 1]))
    start = np.array([0, pelvis[1] - 0.02, _back(wardrobe, figure, pelvis[1:2])[0] + 0.03])
    t = np.linspace(0, 1, 14)
    length, pitch, curl, sway = (
        size * rng.uniform(0.25, 0.7), rng.uniform(-1.2, 0.5), rng.uniform(-0.5, 2.2), rng.normal(0, 0.5),
    )  # fmt: skip
    step = np.stack([np.sin(sway * t), np.sin(pitch + curl * t), -np.cos(pitch + curl * t)], axis=1) * length / len(t)
    radii = size * rng.uniform(0.012, 0.04) * (1 - rng.uniform(0.3, 0.95) * t)
    points, faces = tube(start + np.cumsum(step, axis=0), radii)
    piece = _rigid(points, faces, "pelvis", "tail")
    tip = smooth_step(np.repeat(t, 10), 0.4, 0.65)
    handles = piece.handles * (1 - tip[:, None])
    handles[:, _H["tail_tip"]] = tip
    return Piece(points, faces, piece.joints, handles)


def bag(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """A backpack, or a pouch at the belt."""
    size = float(np.ptp(figure.vertices[:BODY_VERTICES, 1]))
    if rng.random() < 0.6:
        extent = size * rng.uniform([0.1, 0.12, 0.05], [0.2, 0.28, 0.12])
        middle = figure.joints[_J["spine3"]] * [0, 1, 0]
        middle[2] = _back(wardrobe, figure, middle[1:2])[0] - 0.4 * extent[2]
        return _rigid(*box(middle, extent), "spine3", "spine3")
    extent, side = size * rng.uniform(0.03, 0.07, 3), rng.choice([-1, 1])
    return _rigid(*box(figure.joints[0] + [side * 1.5 * abs(figure.joints[1, 0]), 0, 0.03], extent), "pelvis", "pelvis")


def shoulder_pads(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """A dome on each shoulder, which moves with the upper arm."""
    size = float(np.ptp(figure.vertices[:BODY_VERTICES, 1])) * rng.uniform(0.04, 0.08)
    ring, rise = np.linspace(0, 2 * np.pi, 12, endpoint=False), np.linspace(0, np.pi / 2.05, 6)[:, None]
    dome = np.stack(
        [np.cos(rise) * np.cos(ring), np.broadcast_to(np.sin(rise), (6, 12)), -np.cos(rise) * np.sin(ring)], axis=-1
    ).reshape(-1, 3)
    dome = dome * size * rng.uniform(0.8, 1.3, 3)
    pieces = []
    for side, name in ((1, "left_shoulder"), (-1, "right_shoulder")):
        turn = np.asarray(matrix_from_axis_angle(np.array([0, 0, -0.6 * side])))
        pieces.append(_rigid(
            (dome @ turn.T) + figure.joints[_J[name]] + [0.2 * side * size, 0.1 * size, 0],
            sheet_faces(6, 12, wrap=True)[:, ::-1], name, name,
        ))  # fmt: skip
    return joined(pieces)


def helmet(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """A helmet or a mask: the head without its features, a little larger. Its parts stay head, face and scalp."""
    head = shell(wardrobe, figure, "body", ("head",), 0.0)
    mean = mean_operator(unique_edges(head.faces, len(head.points)), len(head.points))
    points = head.points
    for _ in range(int(rng.integers(10, 40))):
        points = mean @ points
    middle = points.mean(axis=0)
    grow = np.ptp(head.points, axis=0) / np.ptp(points, axis=0) * rng.uniform(1.02, 1.2)
    return Piece(middle + (points - middle) * grow, head.faces, head.joints, head.handles)


def shell(
    wardrobe: Wardrobe, figure: BodyShape, group: str, joints: Sequence[str], thickness: float, flare: float = 0.0
) -> Piece:
    """A part of the skin or of the tights, moved outwards: gloves, boots, armour, sleeves, trousers.

    Args:
        wardrobe, figure: The body.
        group: "body" or "helper-tights".
        joints: Joints that move the part ("left_knee", ...).
        thickness: How far out [m].
        flare: How much further the ends of arms and legs are [m].
    """
    piece = wardrobe.part(figure, group)
    weights = piece.joints
    kept = piece.cut(weights[:, [_J[name] for name in joints]].sum(axis=1) > 0.5)
    ends = kept.joints[
        :, [_J[f"{side}_{part}"] for side in ("left", "right") for part in ("knee", "ankle", "elbow", "wrist")]
    ].sum(axis=1)
    return kept.puffed(thickness + flare * ends)
