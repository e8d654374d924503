"""The code that makes the sample characters which `bunraku.files.samples` ships.

Each sample stands on y = 0, faces +Z and has its left side at +X; people are in T-pose. Vertices are doubled along the
seams between colours, as in most files from artists: welded, every part is closed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.core.character import Character
from bunraku.core.files import atomic_write
from bunraku.errors import OptionError
from bunraku.files import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, GltfBuilder, linear_from_srgb, sample_names
from bunraku.render.stage import build_surface

__all__ = ["make_sample", "write_sample"]


def make_sample(name: str, detail: float = 1.0, *, rigged: bool = False) -> Character:
    """A sample character, the same on every call.

    Args:
        name: One of `bunraku.files.samples.sample_names`.
        detail: Factor on the number of vertices, 0.3 to 4; 1 gives 3,000 to 9,000 and is what is shipped.
        rigged: Give it its skeleton and skin weights (Hips, Spine, LeftArm, Tail1); without it `rig` is None.

    Returns:
        The character: closed parts, wound outward, with one colour a face, faces of one colour together.

    Raises:
        OptionError: The name is unknown or the detail out of range.
    """
    if name not in sample_names():
        raise OptionError(f"there is no sample character named {name!r}; choose one of {', '.join(sample_names())}")
    if not 0.3 <= detail <= 4:
        raise OptionError(f"the detail of a sample character must be between 0.3 and 4, not {detail}")
    from bunraku_lab.synthetic.samples import creatures, people

    build = {
        "person": people.build_person, "dancer": people.build_dancer, "robot": people.build_robot,
        "dog": creatures.build_dog, "dragon": creatures.build_dragon, "mushroom": creatures.build_mushroom,
    }  # fmt: skip
    return build[name](detail, rigged)


def write_sample(name: str, path: Path) -> Path:
    """Write a sample character as GLB with smooth normals and one material per colour.

    All primitives share their vertices, so that a reader finds the vertices of `make_sample` in their order. Normals
    are 16-bit integers (KHR_mesh_quantization), which keeps the six files below 1.5 MB.

    Raises:
        OptionError: The name is unknown.
        FormatError: The file cannot be written.
    """
    character = make_sample(name)
    assert character.colors is not None
    builder = GltfBuilder({"asset": {"version": "2.0", "generator": "bunraku"}, "scene": 0, "scenes": [{"nodes": [0]}]})
    builder.tree["extensionsUsed"] = builder.tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    builder.add("nodes", {"name": name, "mesh": 0})
    normals = np.round(32767 * _normals(character)).astype("<i2")
    attributes = {
        "POSITION": builder.array(character.vertices, ARRAY_BUFFER, bounds=True),
        "NORMAL": builder.array(normals, ARRAY_BUFFER, normalized=True),
    }
    primitives = []
    tints = character.colors[character.faces[:, 0]]
    starts = np.flatnonzero(np.r_[True, (tints[1:] != tints[:-1]).any(axis=1)])
    for start, stop in zip(starts, [*starts[1:], len(tints)], strict=True):
        linear = linear_from_srgb(tints[start] / 255.0)
        material = {
            "name": "#{:02x}{:02x}{:02x}".format(*tints[start]),
            "doubleSided": True,
            "pbrMetallicRoughness": {
                "baseColorFactor": [*linear.tolist(), 1], "metallicFactor": 0, "roughnessFactor": 0.9,
            },
        }  # fmt: skip
        indices = character.faces[start:stop].reshape(-1, 1).astype("<u2")
        primitives.append({
            "attributes": attributes, "indices": builder.array(indices, ELEMENT_ARRAY_BUFFER),
            "material": builder.add("materials", material),
        })  # fmt: skip
    builder.add("meshes", {"name": name, "primitives": primitives})
    with atomic_write(path) as file:
        builder.write(file)
    return path


def _normals(character: Character) -> np.ndarray:
    """Unit normals of the vertices, shape (V, 3), smooth across the seams between colours but not across creases.

    A vertex within one colour on a crease has one normal for both sides: splitting it would change the mesh.
    """
    surface = build_surface(character.vertices, character.faces, character.colors)
    points, normals = surface.pose(character.vertices)
    corners = points[surface.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    weighted = normals[surface.triangles] * areas[:, None, None]
    summed = np.zeros((len(character.vertices), 3))
    np.add.at(summed, character.faces, weighted)
    unit: np.ndarray = summed / np.linalg.norm(summed, axis=1, keepdims=True)
    return unit
