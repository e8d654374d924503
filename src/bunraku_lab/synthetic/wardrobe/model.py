"""A wardrobe character while it is made: parts with weights and materials, bones, rigid bodies and joints, on MMD's
standard skeleton with its Japanese names and the inverse kinematics of the legs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bunraku.core.avatars import MMD_METRE, MmdBody, MmdBone, MmdIk, MmdIkLink, MmdJoint
from bunraku.core.character import Character
from bunraku.core.geometry.surface import vertex_normals
from bunraku.files import LIGHT, MmdFile, MmdMaterial, mmd_character, pmx_bytes, read_pmx_file
from bunraku_lab.synthetic.figures import Figure, J

_MIRROR = np.array([1.0, 1, -1])
_STEPS = 1024
"""Weights are multiples of 1 / 1024, so that they add up to 1 exactly in the file's 32-bit numbers."""


@dataclass(eq=False)
class Part:
    """A surface with weights and one material.

    Args:
        points: Shape (V, 3).
        faces: Shape (F, 3).
        bones: Bones of each vertex, shape (V, M).
        shares: Their shares, shape (V, M).
        material: Name of its material, or of that of each face, shape (F,).
        smooth: Whether its corners are round; otherwise each face has normals of its own.
        kind: What it is: "body" for the person and close clothes, or the piece that hangs ("skirt", "hair", ...).
    """

    points: np.ndarray
    faces: np.ndarray
    bones: np.ndarray
    shares: np.ndarray
    material: str | np.ndarray
    smooth: bool = True
    kind: str = "body"


@dataclass
class Costume:
    """Everything that a character is made of so far.

    Args:
        name: Its name.
        bones, bodies, joints: As in `MmdModel`; positions are in our frame.
        tails: Bones that a bone points to.
        parts: Its surfaces.
        colors: sRGB of each material from 0 to 1, shape (3,).
        words: What it wears, for people to read.
        facets: Whether each face has vertices and normals of its own, as loose low-polygon meshes have.
        seed: Of what differs from one piece of apparel to the next: springs, limits, where it begins to move.
        quiet: Whether little of the character is apparel: bands, tips and small pieces.
        fine: Factor on the number of vertices of what hangs, along each side.
        kind: Kind of the parts that are added next.
    """

    name: str
    bones: list[MmdBone] = field(default_factory=list)
    tails: dict[int, int] = field(default_factory=dict)
    parts: list[Part] = field(default_factory=list)
    bodies: list[MmdBody] = field(default_factory=list)
    joints: list[MmdJoint] = field(default_factory=list)
    colors: dict[str, np.ndarray] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)
    facets: bool = False
    seed: int = 0
    quiet: bool = False
    fine: float = 1.0
    kind: str = "body"

    def bone_index(self, name: str) -> int:
        """Index of the bone with this name.

        Raises:
            KeyError: There is none.
        """
        for index, bone in enumerate(self.bones):
            if bone.name == name:
                return index
        raise KeyError(name)

    def bone(self, bone: MmdBone, tail: int | None = None) -> int:
        """Add a bone; `tail` is the bone that it points to."""
        self.bones.append(bone)
        if tail is not None:
            self.tails[len(self.bones) - 1] = tail
        return len(self.bones) - 1

    def body(self, body: MmdBody) -> int:
        """Add a rigid body."""
        self.bodies.append(body)
        return len(self.bodies) - 1

    def collider(self, bone: int) -> int:
        """The first kinematic body of a bone, that apparel hangs on."""
        return next(index for index, body in enumerate(self.bodies) if body.bone == bone and not body.dynamic)

    def add(
        self, points: np.ndarray, faces: np.ndarray, bones: np.ndarray | int, shares: np.ndarray | int,
        material: str | np.ndarray,
    ) -> None:  # fmt: skip
        """Add a surface, less the vertices that it does not use.

        Args:
            points: Shape (V, 3).
            faces: Shape (F, 3).
            bones: Of each vertex, shape (V, M), or the one bone that all go with.
            shares: Their shares, shape (V, M), or 1.
            material: Of all faces, or of each, shape (F,).
        """
        if not len(faces):
            return
        if np.ndim(bones) == 0:
            bones, shares = np.full((len(points), 1), bones), np.ones((len(points), 1))
        if not isinstance(material, str):
            material = np.broadcast_to(material, len(faces))
        used, corners = np.unique(faces, return_inverse=True)
        bones, shares = np.asarray(bones), np.asarray(shares, float)
        self.parts.append(Part(
            np.asarray(points, float)[used], corners.reshape(-1, 3), bones[used], shares[used], material,
            not self.facets, self.kind,
        ))  # fmt: skip

    def character(self) -> Character:
        """The character: what reading the file of this model gives."""
        path = Path(f"{self.name}.pmx")
        return mmd_character(path, read_pmx_file(path, pmx_bytes(self.file())))

    def file(self) -> MmdFile:
        """What the file of this model says: one mesh, its triangles sorted by material."""
        meshes: list[tuple[np.ndarray, ...]] = []  # points, normals, faces, bones, shares and materials of the faces
        for part in self.parts:
            labels = np.broadcast_to(part.material, len(part.faces))
            if part.smooth:
                origin, faces = _split(part.faces, labels)
                normals = vertex_normals(part.points, part.faces)[origin]
            else:
                origin, faces = part.faces.reshape(-1), np.arange(part.faces.size).reshape(-1, 3)
                normals = vertex_normals(part.points[origin], faces)
            meshes.append(
                (part.points[origin], normals, faces, *_quantized(part.bones[origin], part.shares[origin]), labels)
            )
        starts = np.cumsum([0, *(len(mesh[0]) for mesh in meshes)])
        labels = np.concatenate([mesh[5] for mesh in meshes])
        names = list(dict.fromkeys(labels.tolist()))
        order = np.argsort([names.index(label) for label in labels.tolist()], kind="stable")
        triangles = np.concatenate([mesh[2] + start for mesh, start in zip(meshes, starts, strict=False)])[order]
        points, normals, bones, shares = (np.concatenate([mesh[at] for mesh in meshes]) for at in (0, 1, 3, 4))
        out = MmdFile("PMX 2.0", self.name, ", ".join(self.words))
        out.positions, out.normals = points * _MIRROR / MMD_METRE, normals * _MIRROR
        out.uvs, out.sdef = np.zeros((len(points), 2)), np.zeros((len(points), 3, 3))
        out.indices, out.weights = bones, shares
        out.deforms = np.array([0, 0, 1, 2, 2], np.uint8)[(shares > 0).sum(axis=1)]
        out.triangles = triangles[:, ::-1]
        for name in names:
            color = self.colors[name]
            diffuse = np.array([*color, 1], np.float32).astype(float)
            out.materials.append(
                MmdMaterial(name, diffuse, color * (1 - LIGHT), True, "", 3 * int((labels == name).sum()))
            )
        out.bones, out.tails, out.bodies, out.joints = self.bones, self.tails, self.bodies, self.joints
        return out


def _split(faces: np.ndarray, labels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A vertex for each material that it has: which vertex each was, shape (W,), and the faces, shape (F, 3)."""
    names, kind = np.unique(labels, return_inverse=True)
    keys, corners = np.unique(faces * len(names) + kind.reshape(-1, 1), return_inverse=True)
    return keys // len(names), corners.reshape(-1, 3)


def _quantized(bones: np.ndarray, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four largest shares of each vertex, one a bone, in whole steps, largest first; shape (V, 4) each."""
    count = len(bones)
    order = np.argsort(bones, axis=1, kind="stable")
    index, value = np.take_along_axis(bones, order, 1), np.take_along_axis(shares, order, 1).copy()
    for column in range(index.shape[1] - 1, 0, -1):  # the same bone named twice
        same = index[:, column] == index[:, column - 1]
        value[same, column - 1] += value[same, column]
        value[same, column] = 0
    order = np.argsort(-value, axis=1, kind="stable")[:, :4]
    index, value = np.take_along_axis(index, order, 1), np.take_along_axis(value, order, 1)
    value = np.where(value > 0.004, value, 0)
    steps = np.rint(value / value.sum(axis=1, keepdims=True) * _STEPS).astype(np.int64)
    steps[:, 0] += _STEPS - steps.sum(axis=1)
    full, out = np.full((count, 4), -1, np.int64), np.zeros((count, 4))
    full[:, : index.shape[1]], out[:, : index.shape[1]] = np.where(steps > 0, index, -1), steps / _STEPS
    return full, out


def bone_frame(down: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """Axes of a link of apparel, columns, shape (3, 3): Y back along the link, Z outward, X to the side.

    A positive turn about X swings its end inwards.
    """
    y = -down / max(float(np.linalg.norm(down)), 1e-9)
    x = np.cross(y, outward)
    if np.linalg.norm(x) < 1e-6:
        x = np.cross(y, [0.0, 0, 1]) if abs(y[2]) < 0.9 else np.cross(y, [1.0, 0, 0])
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], axis=1)


TRUNK, HEAD, ARMS, LEGS = 0, 1, 2, 3
"""Collision groups of the body; those of apparel are higher."""
SOLID = {"trunk": 1 << TRUNK, "head": 1 << HEAD, "arms": 1 << ARMS, "legs": 1 << LEGS}

_SIDES = (("left", "左"), ("right", "右"))
_BONE_OF = {
    "pelvis": "下半身", "spine1": "上半身", "spine2": "上半身", "spine3": "上半身2", "neck": "首", "head": "頭",
    "collar": "肩", "shoulder": "腕", "elbow": "ひじ", "wrist": "手首", "hip": "足", "knee": "ひざ", "ankle": "足首",
    "foot": "つま先",
}  # fmt: skip


def add_skeleton(costume: Costume, figure: Figure) -> None:
    """Add the standard bones and the kinematic bodies of trunk, head and limbs."""
    _bones(costume, figure)
    _colliders(costume, figure)


def _bones(costume: Costume, figure: Figure) -> None:
    hips = figure.at("pelvis")
    waist = 0.5 * (figure.at("spine1") + hips)
    heights = {
        "全ての親": np.zeros(3),
        "センター": np.array([0, 0.78 * hips[1], 0.0]),
        "グルーブ": np.array([0, 0.8 * hips[1], 0.0]),
    }
    above = -1
    for (name, position), english in zip(heights.items(), ("mother", "center", "groove"), strict=True):
        above = costume.bone(MmdBone(name, english, position, above, moves=True, tail=np.array([0, 0.05, 0.0])))
    groove = above

    def put(name: str, english: str, position: np.ndarray, parent: int, tail: np.ndarray) -> int:
        return costume.bone(MmdBone(name, english, position, parent, tail=tail - position))

    lower = put("下半身", "lower body", waist, groove, hips)
    upper = put("上半身", "upper body", waist, groove, figure.at("spine3"))
    chest = put("上半身2", "upper body2", figure.at("spine3"), upper, figure.at("neck"))
    neck = put("首", "neck", figure.at("neck"), chest, figure.at("head"))
    put("頭", "head", figure.at("head"), neck, figure.skull[0] + [0, figure.skull[1][1], 0])
    for side, mark in _SIDES:
        at = {
            part: figure.at(f"{side}_{part}")
            for part in ("collar", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot")
        }
        parent = chest
        ends = [at["shoulder"], at["elbow"], at["wrist"], at["wrist"] + 0.35 * (at["wrist"] - at["elbow"])]
        for part, english, tail in zip(
            ("collar", "shoulder", "elbow", "wrist"), ("shoulder", "arm", "elbow", "wrist"), ends, strict=True
        ):
            parent = put(mark + _BONE_OF[part], f"{english}_{side[0].upper()}", at[part], parent, tail)
        parent = lower
        toe = at["foot"] + [0, 0, 0.03]
        for part, english, tail in zip(
            ("hip", "knee", "ankle", "foot"),
            ("leg", "knee", "ankle", "toe"),
            [at["knee"], at["ankle"], at["foot"], toe],
            strict=True,
        ):
            parent = put(mark + _BONE_OF[part], f"{english}_{side[0].upper()}", at[part], parent, tail)
        _leg_ik(costume, mark, at)


def _leg_ik(costume: Costume, mark: str, at: dict[str, np.ndarray]) -> None:
    """Goals of the ankle and of the toes; the knee only bends backwards."""
    leg, knee, ankle, toe = (costume.bone_index(mark + name) for name in ("足", "ひざ", "足首", "つま先"))
    bend = [np.array([angle, 0, 0], np.float32).astype(float) for angle in (np.radians(0.5), np.pi)]
    letter = "L" if mark == "左" else "R"
    links = MmdIkLink(knee, *bend), MmdIkLink(leg)
    root = costume.bone(
        MmdBone(mark + "足ＩＫ", f"leg IK_{letter}", at["ankle"], 0, 1, moves=True, tail=np.array([0, 0, -0.08]),
        ik=MmdIk(ankle, 40, 2.0, links))
    )  # fmt: skip
    goal = MmdIk(toe, 3, 4.0, (MmdIkLink(ankle),))
    costume.bone(MmdBone(
        mark + "つま先ＩＫ", f"toe IK_{letter}", at["foot"], root, 1, moves=True, tail=np.array([0, -0.08, 0]), ik=goal,
    ))  # fmt: skip


def body_weights(costume: Costume, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bones and shares of vertices with weights on the 22 joints, shape (V, 22) each."""
    bones = np.zeros(len(J), np.int64)
    for name, joint in J.items():
        side, _, part = name.partition("_")
        mark = {"left": "左", "right": "右"}.get(side, "")
        bones[joint] = costume.bone_index(mark + _BONE_OF[part if mark else name])
    return np.tile(bones, (len(weights), 1)), weights


def capsule_of(name: str, bone: int, a: np.ndarray, b: np.ndarray, radius: float, group: int, mask: int) -> MmdBody:
    """A kinematic capsule from a to b, the middles of its ends; a ball where they are one."""
    length = float(np.linalg.norm(b - a))
    shape = "capsule" if length > 1e-4 else "sphere"
    turn = bone_frame(a - b, np.array([0, 0, 1.0])) if length > 1e-4 else np.eye(3)
    size = np.array([radius, length if shape == "capsule" else 0.0, 0.0])
    return MmdBody(name, bone, shape, size, 0.5 * (a + b), turn, 1.0, 0.5, 0.5, 0.0, 0.5, 0, group, mask)


def _colliders(costume: Costume, figure: Figure) -> None:
    everything = 0xFFFF & ~(SOLID["trunk"] | SOLID["head"] | SOLID["arms"] | SOLID["legs"])

    def put(name: str, bone: str, a: np.ndarray, b: np.ndarray, radius: float, group: int) -> None:
        costume.body(capsule_of(name, costume.bone_index(bone), a, b, radius, group, everything))

    _trunk(figure, put)
    center, half = figure.skull
    round_ = float(min(half[0], half[2], half[1]))
    slide = np.array([0, 0, max(half[2] - round_, 0)])
    put("頭", "頭", center - slide, center + slide, 0.97 * round_, HEAD)
    chin = float(figure.head[:, 1].min())
    jaw = 0.62 * float(half[0])
    put(
        "頭2", "頭", center + [0, -0.4 * half[1], 0.3 * half[2]],
        np.array([0, chin + 1.1 * jaw, center[2] + 0.35 * half[2]]), jaw, HEAD,
    )  # fmt: skip
    put("首", "首", figure.at("neck"), figure.at("head"), _girth(figure, ["neck"], "neck", "head", 60), TRUNK)
    for side, mark in _SIDES:
        shoulder, elbow, wrist = (figure.at(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist"))
        put(
            f"{mark}肩", f"{mark}肩", 0.5 * (figure.at(f"{side}_collar") + shoulder), shoulder,
            _girth(figure, [f"{side}_shoulder"], f"{side}_shoulder", f"{side}_elbow", 60), TRUNK,
        )  # fmt: skip
        put(
            f"{mark}腕", f"{mark}腕", shoulder, elbow,
            _girth(figure, [f"{side}_shoulder"], f"{side}_shoulder", f"{side}_elbow", 55), ARMS,
        )  # fmt: skip
        put(
            f"{mark}ひじ", f"{mark}ひじ", elbow, wrist,
            _girth(figure, [f"{side}_elbow"], f"{side}_elbow", f"{side}_wrist", 55), ARMS,
        )  # fmt: skip
        hand = figure.skin.points[figure.skin.weights[:, J[f"{side}_wrist"]] > 0.6].mean(axis=0)
        put(
            f"{mark}手首", f"{mark}手首", wrist, hand,
            0.9 * _girth(figure, [f"{side}_elbow"], f"{side}_elbow", f"{side}_wrist", 40), ARMS,
        )  # fmt: skip
        hip, knee, ankle = (figure.at(f"{side}_{part}") for part in ("hip", "knee", "ankle"))
        thigh = _girth(figure, [f"{side}_hip"], f"{side}_hip", f"{side}_knee", 50)
        put(f"{mark}足", f"{mark}足", hip + 0.12 * (knee - hip), knee, thigh, LEGS)
        upper = _girth(figure, [f"{side}_hip"], f"{side}_hip", f"{side}_knee", 80)
        put(f"{mark}足+", f"{mark}足", hip + 0.18 * (knee - hip), hip + 0.5 * (knee - hip), upper, LEGS)
        shin = _girth(figure, [f"{side}_knee"], f"{side}_knee", f"{side}_ankle", 60)
        put(f"{mark}ひざ", f"{mark}ひざ", knee, ankle, shin, LEGS)
        foot = figure.at(f"{side}_foot")
        put(
            f"{mark}足首", f"{mark}足首", ankle + [0, -0.3 * ankle[1], 0], foot + [0, 0.15 * ankle[1], 0],
            max(0.4 * ankle[1], 0.015), LEGS,
        )  # fmt: skip


def _girth(figure: Figure, joints: list[str], start: str, end: str, share: float) -> float:
    """Radius of a limb: this percentile of the distances of its skin from the line between two joints [m]."""
    skin = figure.skin
    shares = skin.weights[:, [J[name] for name in joints]].sum(axis=1)
    own = skin.points[shares > 0.7 * shares.max()]
    a, b = figure.at(start), figure.at(end)
    along = np.clip((own - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-9), 0, 1)
    apart = np.linalg.norm(own - a - along[:, None] * (b - a), axis=1)
    inside = apart[(along > 0.05) & (along < 0.95)]
    return max(float(np.percentile(inside if len(inside) > 4 else apart, share)), 0.012)


def _trunk(figure: Figure, put) -> None:  # type: ignore[no-untyped-def]
    """Capsules across the trunk, one above the other, as wide and deep as it is at their heights."""
    hip, waist, chest, neck = (
        figure.at("left_hip")[1], 0.5 * (figure.at("spine1") + figure.at("pelvis"))[1], figure.at("spine3")[1],
        figure.at("neck")[1],
    )  # fmt: skip
    skin = figure.skin
    limbs = [
        J[f"{side}_{part}"]
        for side in ("left", "right")
        for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot")
    ]
    points = skin.points[skin.weights[:, limbs].sum(axis=1) < 0.5]
    step = (neck - hip) / 5.2
    for number in range(5):
        height = hip + (number + 0.35) * step
        near = points[np.abs(points[:, 1] - height) < 0.35 * step]
        if len(near) < 6:
            continue
        front, back = float(np.percentile(near[:, 2], 92)), float(np.percentile(near[:, 2], 8))
        wide = float(np.percentile(np.abs(near[:, 0]), 92))
        radius = min(0.5 * (front - back), wide)
        across = np.array([max(wide - radius, 0), 0, 0])
        middle = np.array([0, height, 0.5 * (front + back)])
        bone = "下半身" if height < waist + 0.02 * figure.height else "上半身" if height < chest else "上半身2"
        put(f"{bone}{number}", bone, middle - across, middle + across, radius, TRUNK)
