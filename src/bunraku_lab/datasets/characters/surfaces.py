"""Surfaces that the orientation network trains on beside the characters themselves: characters in the poses of their
own clips and dressed people in those of captured ones, with limbs fused, of blocks, on plinths.

All stand along +Y and face +Z, in units of their largest extent. What a clip lays down or turns round is left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from bunraku.errors import BunrakuError, FormatError
from bunraku.formats.files import atomic_write
from bunraku.geometry.registration import register
from bunraku.geometry.surface import face_normals, surface_points
from bunraku_lab.datasets.characters.known_rigs import facing_turn
from bunraku_lab.datasets.characters.remeshed import blocky_surface, filled_cells, fused_surface, on_plinth

__all__ = ["SurfaceBank", "build_surfaces", "clip_poses", "load_surfaces", "remade"]

POINTS = 2048
_DENSE, _FINE = 200_000, 40  # points, and the voxels up to which a third of them will do
_UPRIGHT = np.cos(np.radians(30))
"""Cosine of the largest turn of a pose against the bind pose that is still taken to face its way."""


@dataclass(frozen=True, eq=False)
class SurfaceBank:
    """S surfaces, normalised, upright, facing +Z.

    Args:
        names: The character of each, as in its archive.
        points, normals: Shape (S, M, 3), float16.
    """

    names: tuple[str, ...]
    points: np.ndarray
    normals: np.ndarray

    def __len__(self) -> int:
        return len(self.names)

    def those(self, held: frozenset[str], wanted: bool) -> SurfaceBank:
        """The surfaces of characters that are in `held`, or those that are not."""
        rows = [n for n, name in enumerate(self.names) if (name in held) == wanted]
        return SurfaceBank(tuple(self.names[n] for n in rows), self.points[rows], self.normals[rows])


def clip_poses(path: Path, name: str, rng: np.random.Generator, count: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Faces of a rigged file, and its vertices in the bind pose and in some frames of its clips, facing +Z.

    Args:
        path: The file.
        name: Its name in the archive; some rigs are known by it.
        rng: Chooses clips and frames.
        count: Poses of clips at most.

    Returns:
        Faces (F, 3) and vertices, each (V, 3) [m].

    Raises:
        BunrakuError: The file cannot be read or has no rig.
    """
    from bunraku.io import load_character
    from bunraku.io.play import load_animation

    character = load_character(path)
    if character.rig is None:
        raise FormatError(path, "there is no rig in it")
    turn = facing_turn(name, character.rig.names, character.rig.positions).T
    rest = character.vertices.astype(np.float64)
    poses, mass = [rest @ turn], np.maximum(character.areas, 1e-12)[:, None]
    clips = len(character.source.document.items("animations")) if character.source is not None else 0
    for clip in rng.permutation(clips)[:count]:
        try:
            animation = load_animation(path, int(clip), 5.0)
        except BunrakuError:
            continue
        posed = animation.vertices()[[int(rng.integers(len(animation.motion)))]].astype(np.float64)
        body = register(rest, posed, mass, (mass.T @ rest) / mass.sum())[0][0, 0]
        size = np.ptp(posed[0], axis=0).max() / np.ptp(rest, axis=0).max()
        if np.isfinite(posed).all() and 0.4 < size < 2.5 and min(body[1, 1], body[2, 2]) > _UPRIGHT:
            poses.append(posed[0] @ turn)
    return character.faces, poses


def remade(
    vertices: np.ndarray, faces: np.ndarray, rng: np.random.Generator, count: int = POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """The surface of a mesh as some program may have made it: as it is, fused, of blocks; now and then on a plinth.

    Returns:
        Points and unit normals, in units of the largest extent about the middle, shape (count, 3) each.
    """
    kind = rng.choice(3, p=[0.3, 0.5, 0.2])
    if kind == 0:
        points, normals = surface_points(vertices, faces, count)
    else:
        least, most = (28, 72) if kind == 1 else (12, 28)
        cells = int(rng.integers(least, most))
        dense = surface_points(vertices, faces, _DENSE if cells > _FINE else _DENSE // 3)[0]
        area = max(float(np.linalg.norm(face_normals(vertices, faces), axis=1).sum()) / 2, 1e-12)
        if rng.random() < 0.4:
            dense, area = on_plinth(dense, area, rng)
        cells = min(cells, max(filled_cells(dense, area), least))
        points, normals = (fused_surface if kind == 1 else blocky_surface)(dense, cells, count, rng)
    missing = count - len(points)  # a coarse grid has few voxels
    if missing > 0:
        again = rng.integers(len(points), size=missing)
        points, normals = np.concatenate([points, points[again]]), np.concatenate([normals, normals[again]])
    low, high = points.min(axis=0), points.max(axis=0)
    return (points - (low + high) / 2) / max(float((high - low).max()), 1e-12), normals


def build_surfaces(
    folder: Path,
    output: Path,
    poses: int = 5,
    forms: int = 2,
    seed: int = 0,
    progress: Callable[[int, int, str], None] | None = None,
    people: int = 0,
    person: Callable[[int], tuple[np.ndarray, list[np.ndarray]]] | None = None,
) -> SurfaceBank:
    """Make surfaces of the rigged files of a folder, and of people made by code, and write them as one NPZ.

    Args:
        folder: Searched through for GLB files, such as the unpacked character archive.
        output: The NPZ.
        poses: Frames of clips of each file at most, beside the bind pose.
        forms: How often each pose is remade.
        seed: Of all choices.
        progress: Called with the number done, of all, and the name.
        people: How many people made by code are added, each of their poses remade once.
        person: Faces and poses of the person of a number (`bunraku_lab.datasets.motions.posed_people`).

    Raises:
        FormatError: There is no rigged file.
    """
    files = sorted(file for file in folder.rglob("*.glb") if file.is_file())
    names, points, normals = [], [], []
    people = people if person is not None else 0
    for number in range(len(files) + people):
        own = number < len(files)
        name = files[number].relative_to(folder).with_suffix("").as_posix() if own else f"people/{number - len(files)}"
        if progress:
            progress(number, len(files) + people, name)
        rng = np.random.default_rng([seed, number])
        try:
            if own:
                faces, found = clip_poses(files[number], name, rng, poses)
            else:
                assert person is not None
                faces, found = person(number - len(files))
        except BunrakuError:
            continue
        for vertices in found:
            for _ in range(forms if own else 1):
                made, straight = remade(vertices, faces, rng)
                names.append(name)
                points.append(made.astype(np.float16))
                normals.append(straight.astype(np.float16))
    if not names:
        raise FormatError(folder, "there is no rigged GLB file here; give the folder of the character archive")
    bank = SurfaceBank(tuple(names), np.stack(points), np.stack(normals))
    with atomic_write(output) as out:
        np.savez_compressed(out, names=np.array(bank.names), points=bank.points, normals=bank.normals)
    return bank


def load_surfaces(path: Path) -> SurfaceBank:
    """Read what `build_surfaces` wrote.

    Raises:
        FormatError: The file is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return SurfaceBank(tuple(map(str, archive["names"])), archive["points"], archive["normals"])
    except (OSError, KeyError, ValueError, BadZipFile) as error:
        raise FormatError(path, f"no bank of surfaces ({error}); write one with `bunraku data surfaces`") from error
