"""Small glTF files made byte by byte, and made-up handles and motions for them."""

import json
import struct

import numpy as np

from bunraku.core.character import Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion

_CODES = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (0, 2) for z in (-1, 1)], np.float32)
CUBE_FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
    [1, 5, 7], [1, 7, 3],
])  # fmt: skip


class Maker:
    """Collects accessors in one binary chunk."""

    def __init__(self):
        self.binary = b""
        self.accessors, self.views = [], []

    def cube(self, kind=np.uint8, attributes=None):
        """A primitive of the cube."""
        attributes = attributes or {"POSITION": self.add(CUBE)}
        return {"attributes": attributes, "indices": self.add(CUBE_FACES.reshape(-1).astype(kind))}

    def view(self, data, **extra):
        self.views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **extra})
        self.binary += data + bytes(-len(data) % 4)
        return len(self.views) - 1

    def add(self, values, bounds=False, **extra):
        values = np.ascontiguousarray(values)
        values = values.reshape(len(values), -1)
        entry = {
            "bufferView": self.view(values.tobytes()),
            "componentType": _CODES[values.dtype.name],
            "count": len(values),
            "type": _KINDS[values.shape[1]],
        }
        if bounds:
            entry.update(min=values.min(axis=0).tolist(), max=values.max(axis=0).tolist())
        self.accessors.append({**entry, **extra})
        return len(self.accessors) - 1

    def tree(self, **parts):
        tree = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "accessors": self.accessors,
            "bufferViews": self.views,
            **parts,
        }
        tree["buffers"] = [{"byteLength": len(self.binary)}]
        return tree

    def glb(self, **parts):
        return glb_bytes(self.tree(**parts), self.binary)


def glb_bytes(tree, binary):
    """A GLB file of a tree and a binary chunk."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def cube_glb(node=None, mesh=None, **primitive):
    """A GLB of one cube, placed by a node."""
    maker = Maker()
    entry = {
        "attributes": {"POSITION": maker.add(CUBE, bounds=True)},
        "indices": maker.add(CUBE_FACES.reshape(-1).astype(np.uint16)),
        **primitive,
    }
    return maker.glb(nodes=[{"mesh": 0, **(node or {})}], meshes=[{"primitives": [entry], **(mesh or {})}])


def png(color=(255, 0, 0), size=4):
    """A PNG whose left half has a colour and whose right half is white."""
    import io

    from PIL import Image

    pixels = np.full((size, size, 3), 255, np.uint8)
    pixels[:, : size // 2] = color
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def textured_glb(extra=None):
    """A GLB with what real ones have: texture, UVs, normals, extras, two meshes of which one is instanced, a sheared
    skin and a clip.
    """
    maker = Maker()
    uv = np.random.default_rng(0).random((8, 2)).astype(np.float32)
    normals = (CUBE - [0, 1, 0]) / np.sqrt(3)
    skinned = {
        "POSITION": maker.add(CUBE, bounds=True),
        "NORMAL": maker.add(normals.astype(np.float32)),
        "TEXCOORD_0": maker.add(uv),
        "JOINTS_0": maker.add(np.tile([0, 1, 0, 0], (8, 1)).astype(np.uint8)),
        "WEIGHTS_0": maker.add(np.c_[1 - CUBE[:, 1] / 2, CUBE[:, 1] / 2, 0 * CUBE[:, :2]].astype(np.float32)),
    }
    plain = {
        "POSITION": maker.add((0.3 * CUBE).astype(np.float32), bounds=True),
        "TEXCOORD_0": maker.add(uv),
        "COLOR_0": maker.add(np.full((8, 4), 128, np.uint8), normalized=True),
    }
    indices = maker.add(CUBE_FACES.reshape(-1).astype(np.uint16))
    bind = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    bind[1, 3, 1] = -1  # column-major: the second joint is bound at height 1
    clip = {"channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}]}
    keys = maker.add(np.array([0, 1], np.float32), bounds=True)
    clip["samplers"] = [
        {
            "input": keys,
            "output": maker.add(np.array([[0, 0, 0, 1], [1, 0, 0, 0]], np.float32)),
            "interpolation": "LINEAR",
        }
    ]
    return maker.glb(
        scenes=[{"nodes": [0, 1], "name": "stage"}],
        nodes=[
            {"mesh": 0, "skin": 0, "name": "body", "extras": {"part": "body"}},
            {"name": "hip", "children": [2], "translation": [0, 0.2, 0]},
            {"name": "spine", "children": [3, 4], "translation": [0, 1, 0], "rotation": [0.1736482, 0, 0, 0.9848078]},
            {"mesh": 1, "name": "hat", "translation": [0, 1.5, 0], "scale": [1, 2, 1]},
            {"mesh": 1, "name": "mirrored hat", "translation": [2, 1.5, 0], "scale": [-1, 1, 1]},
        ],
        meshes=[
            {
                "name": "body",
                "primitives": [{"attributes": skinned, "indices": indices, "material": 0}],
                "extras": {"maker": "us"},
            },
            {"name": "hat", "primitives": [{"attributes": plain, "indices": indices, "material": 1}]},
        ],
        skins=[{"joints": [1, 2], "inverseBindMatrices": maker.add(bind.reshape(2, 16))}],
        animations=[clip],
        materials=[
            {
                "name": "cloth",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.1},
                "extras": {"price": 3},
            },
            {"name": "felt", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.2, 0.1, 1]}, "doubleSided": True},
        ],
        textures=[{"source": 0, "sampler": 0}],
        samplers=[{"wrapS": 33071}],
        images=[{"bufferView": maker.view(png()), "mimeType": "image/png", "name": "pattern"}],
        **(extra or {}),
    )


def made_up_handles(character, count=30, seed=0, sharpness=60.0):
    """Smooth weights: a softmax of the distances to some of the vertices."""
    rng = np.random.default_rng(seed)
    positions = character.vertices[
        rng.choice(len(character.vertices), count, replace=len(character.vertices) < count)
    ] + 0.01 * character.height * rng.normal(size=(count, 3))
    distances = np.linalg.norm(character.vertices[:, None] - positions, axis=-1) / character.height
    logits = -sharpness * distances
    weights = np.exp(logits - logits.max(axis=1, keepdims=True))
    return Handles(positions, weights / weights.sum(axis=1, keepdims=True))


def made_up_motion(character, frames=24, count=30, seed=0, fps=20.0):
    """A motion in which most handles move, handle 5 keeps still and the root turns far round."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, frames)[:, None, None]
    translations = 0.05 * character.height * rng.normal(size=(1, count, 3)) * np.sin(6 * t)
    rotations = 0.7 * rng.normal(size=(1, count, 3)) * np.sin(5 * t + rng.normal(size=(1, count, 1)))
    for still in (0, 5):
        if still < count:
            translations[:, still] = rotations[:, still] = 0
    root = matrix_from_axis_angle(t[:, 0] * [1.0, 7, 2])
    return HandleMotion(
        translations, matrix_from_axis_angle(rotations), character.height * t[:, 0] * [1, 0.2, 0.5], root, fps
    )
