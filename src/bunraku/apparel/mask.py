"""Which vertices of a character are apparel, by an artist's mask or by the physics of its file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bunraku.core.arrays import read_npy
from bunraku.core.avatars import MmdModel, VrmModel, mmd_model, vrm_model
from bunraku.core.character import Character
from bunraku.core.files import read_bounded
from bunraku.errors import FormatError
from bunraku.files import read_gltf, read_ply

SUFFIXES = (".apparel.npy", ".apparel.txt", ".apparel.ply", ".apparel.glb")


def artist_mask(character: Character) -> np.ndarray | None:
    """The mask beside a character's file, shape (V,), bool; None for none. Errors as of `read_artist_mask`."""
    path = artist_mask_file(character)
    return None if path is None else read_artist_mask(path, character)


def artist_mask_file(character: Character) -> Path | None:
    """The file of such a mask: of `gene.pmx` the first of `gene.apparel.npy`, `.txt`, `.ply` and `.glb` that exists."""
    return file_beside(character, SUFFIXES)


def file_beside(character: Character, suffixes: Sequence[str]) -> Path | None:
    """The first file with a character's own name and one of some suffixes beside its file; None for none."""
    source = character.source
    path = getattr(source, "path", None) or getattr(getattr(source, "document", None), "path", None)
    if not isinstance(path, Path):
        return None
    beside = (path.with_name(f"{path.stem}{suffix}") for suffix in suffixes)
    return next((file for file in beside if file.is_file() and file != path), None)


def read_artist_mask(path: str | Path, character: Character) -> np.ndarray:
    """A mask from a file, shape (V,), bool. FormatError if the file is broken, of another kind, or belongs to another
    mesh.

    Args:
        path: NPY with a number for each vertex, apparel above a half; text with the index of an apparel vertex in each
            line, counted from 0; or a PLY or GLB of the same mesh, in any order, whose vertices are painted red where
            they are apparel.
        character: Its character.
    """
    path = Path(path)
    count, suffix = len(character.vertices), path.suffix.lower()
    if suffix in (".ply", ".glb"):
        return _painted(path, character)
    data = read_bounded(path)
    if suffix == ".npy":
        values = read_npy(path, data)
        if values.shape != (count,):
            problem = f"the mask has shape {values.shape}, but the character has {count:,} vertices"
            raise FormatError(path, f"{problem}; make it for this mesh")
        return np.asarray(values > 0.5)
    if suffix != ".txt":
        raise FormatError(path, "a mask of apparel is an .npy, a .txt, or a painted .ply or .glb; save one of these")
    try:
        numbers = np.array([int(line) for line in data.decode("utf-8-sig").split()], np.int64)
    except (UnicodeDecodeError, ValueError, OverflowError):
        problem = "this is not a list of vertex numbers; write the number of one apparel vertex in each line"
        raise FormatError(path, problem) from None
    if numbers.size and not 0 <= numbers.min() <= numbers.max() < count:
        problem = f"it names a vertex that the character does not have (0 to {count - 1:,})"
        raise FormatError(path, f"{problem}; make it for this mesh")
    out = np.zeros(count, bool)
    out[numbers] = True
    return out


def _painted(path: Path, character: Character) -> np.ndarray:
    """Vertices of a character that lie where another mesh is red."""
    from scipy.spatial import cKDTree

    painted = (read_ply if path.suffix.lower() == ".ply" else read_gltf)(path, read_bounded(path))
    if painted.colors is None:
        raise FormatError(path, "its vertices have no colours; paint apparel red")
    distance, nearest = cKDTree(painted.vertices).query(character.vertices[character.surface])
    if distance.max() > 1e-3 * float(np.ptp(character.vertices[character.surface], axis=0).max()):
        raise FormatError(
            path,
            "its vertices are not where the character's are; paint the same mesh in the same pose, +Y up and facing +Z",
        )
    red, green, blue = painted.colors.astype(int).T
    out = np.zeros(len(character.vertices), bool)
    out[character.surface] = ((red > 100) & (red > 2 * green) & (red > 2 * blue))[nearest]
    return out


APPAREL_SHARE = 0.5  # weight on moved joints from which on a vertex is apparel; defines the masks of the data set, too


def apparel_mask(character: Character, model: MmdModel | VrmModel | None = None) -> np.ndarray | None:
    """Vertices whose weight on joints that physics move exceeds a half, or the mask beside the file (`artist_mask`),
    shape (V,), bool; None where neither is there. `model` is what its file says, where that is known already.
    FormatError if the nodes of its file, or the mask beside it, are broken.
    """
    drawn = artist_mask(character)
    if drawn is not None:
        return drawn
    moved = moved_joints(character, model)
    if moved is None or character.rig is None:
        return None
    return np.asarray((character.rig.weights * moved[character.rig.indices]).sum(axis=1) > APPAREL_SHARE)


def moved_joints(character: Character, model: MmdModel | VrmModel | None = None) -> np.ndarray | None:
    """Joints with dynamic bodies or on springs, and all below, (J,), bool; None where the file has no physics."""
    rig = character.rig
    model = model or mmd_model(character) or vrm_model(character)
    if model is None or rig is None:
        return None
    out = np.zeros(len(rig.names), bool)
    if isinstance(model, MmdModel):
        out[[body.bone for body in model.bodies if body.dynamic and body.bone >= 0]] = True
    else:
        index = {node: joint for joint, node in enumerate(character.source.skins.nodes)}
        out[[index[joint.node] for spring in model.springs for joint in spring.joints if joint.node in index]] = True
    while True:  # once for each level of the tree at the most
        grown = out | np.where(rig.parents >= 0, out[rig.parents], False)
        if (grown == out).all():
            return out
        out = grown
