"""The training set of the Mesh Handle Predictor: rigged characters, as network meshes with their rigs' truth.

The characters come from the archive that `shared/data/README.md` of the project's data describes, or from any folder of GLB
files with skins. Each becomes one npz in a cache folder.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from bunraku.bodies.bone_names import handle_of_joints, left_axis, limb_parents
from bunraku.bodies.layout import HANDLE_NAMES, JOINT_PARENTS
from bunraku.bodies.reference import reference_body, reference_shapes
from bunraku.character import Character
from bunraku.errors import BunrakuError, CharacterError, FormatError
from bunraku.geometry.rotations import matrix_y
from bunraku.geometry.simplify import network_mesh
from bunraku.handles.training_data import TrainingCharacter, handle_target

__all__ = ["HELD_OUT", "build_characters", "load_characters", "reference_characters", "training_character"]

_log = logging.getLogger(__name__)

HELD_OUT: tuple[str, ...] = (
    "kaykit/Rogue_Hooded",
    "quaternius/animals_pack/Bull", "quaternius/animals_pack/ShibaInu",
    "quaternius/cute_fish_pack/Betta", "quaternius/cute_fish_pack/Puffer", "quaternius/cute_fish_pack/Tuna",
    "quaternius/cyberpunk_pack/Enemy_2Legs", "quaternius/dinosaurs_pack/Velociraptor",
    "quaternius/easy_enemies_pack/Rat", "quaternius/easy_enemies_pack/Spider",
    "quaternius/fish_pack/Manta_ray", "quaternius/mech_pack/Stan",
    "quaternius/modular_men/King", "quaternius/modular_men/Suit",
    "quaternius/modular_women/Formal", "quaternius/modular_women/Witch",
    "quaternius/platformer_game_pack/Bee", "quaternius/platformer_game_pack/Character",
    "quaternius/platformer_game_pack/Character_Gun", "quaternius/platformer_game_pack/Character_HumanoidRig",
    "quaternius/platformer_game_pack/Crab", "quaternius/platformer_game_pack/Enemy", "quaternius/platformer_game_pack/Skull",
    "quaternius/single_knight_pack/KnightCharacter",
    "quaternius2019/Dragon", "quaternius2019/Female_Dress", "quaternius2019/Goblin", "quaternius2019/Horse",
    "quaternius2019/Smooth_Female_Dress",
    "valid/Black_F_1_Busi",
)  # fmt: skip
"""Characters that no training sees: one or two of most packs, and two packs whole (platformer_game_pack, single_knight_pack)."""

# Rigs whose bones have no names, or wrong ones: the turn about +Y that makes them face +Z [degrees], and the part of each bone.
# Sides follow from where the bone stands.
_PET = "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.003:head Bone.014:shoulder Bone.015:elbow Bone.016:wrist Bone.017:shoulder " \
    "Bone.018:elbow Bone.019:wrist Bone.004:tail Bone.005:tail Bone.006:tail_tip Bone.007:tail_tip Bone.008:hip Bone.009:knee " \
    "Bone.010:ankle Bone.011:hip Bone.012:knee Bone.013:ankle"  # fmt: skip
_BY_HAND: dict[str, tuple[float, str]] = {
    "quaternius2019/Cat": (-90, _PET),
    "quaternius2019/Dog": (-90, _PET),
    "quaternius2019/Wolf": (-90, _PET),
    "quaternius2019/Chick": (-90, "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.009:head Bone.003:hip Bone.004:knee Bone.005:ankle Bone.006:hip "
                             "Bone.007:knee Bone.008:ankle"),
    "quaternius2019/bird": (0, "Bone:pelvis Bone.001:spine3 Bone.002:head Bone.003:pelvis Bone.004:tail Bone.005:tail_tip Bone.006:wing "
                            "Bone.007:wing Bone.008:wing Bone.009:wing"),
    "quaternius2019/Eagle": (180, "Bone:pelvis Bone.001:spine2 Bone.002:neck Bone.003:head Bone.007:wing Bone.008:wing Bone.009:wing Bone.010:wing "
                             "Bone.011:wing Bone.012:wing Bone.013:wing Bone.014:wing Bone.015:wing Bone.004:tail Bone.005:tail Bone.006:tail_tip "
                             "Bone.016:hip Bone.017:knee Bone.018:ankle Bone.019:foot Bone.020:hip Bone.021:knee Bone.022:ankle Bone.023:foot"),
    "quaternius2019/Fish": (0, "Bone:pelvis Bone.001:head Bone.002:tail Bone.003:shoulder Bone.004:elbow Bone.005:shoulder Bone.006:elbow"),
    "quaternius2019/Whale": (0, "Bone:pelvis Bone.002:spine2 Bone.009:head Bone.005:shoulder Bone.006:elbow Bone.007:shoulder Bone.008:elbow "
                             "Bone.003:tail Bone.004:tail_tip"),
    "quaternius2019/Red_Fox": (180, "Bone:pelvis Bone.001:spine3 Bone.002:head Bone.003:tail Bone.010:tail_tip Bone.004:hip Bone.005:knee "
                               "Bone.006:ankle Bone.007:hip Bone.008:knee Bone.009:ankle Bone.011:shoulder Bone.012:elbow Bone.013:wrist "
                               "Bone.014:shoulder Bone.015:elbow Bone.016:wrist"),
    "quaternius2019/Piranha": (0, "Bone:pelvis Bone.001:spine2 Bone.002:spine3 Bone.003:head Bone.004:face Bone.007:shoulder Bone.008:shoulder "
                               "Bone.005:tail Bone.006:tail_tip"),
    "quaternius2019/Skeleton": (0, "Hips:pelvis Torso:spine2 Neck:neck Head:head L.UpperLeg:hip L.DownLeg:knee R.UpperLeg:hip R.DownLeg:knee "
                                "L.UpperLeg.001:shoulder L.DownLeg.001:elbow R.UpperLeg.001:shoulder R.DownLeg.001:elbow"),
    "quaternius2019/Bat": (0, "Bone:face"),
    "quaternius2019/Dragon": (0, "Bone:face"),
}  # fmt: skip


def _facing(name: str, names: tuple[str, ...], positions: np.ndarray) -> np.ndarray:
    """The quarter turn about +Y after which the character faces +Z, shape (3, 3)."""
    if name in _BY_HAND:
        return np.asarray(matrix_y(np.array(np.radians(_BY_HAND[name][0]))))
    left = left_axis(names, positions)
    if left is None or left[0] > 0.5:  # a stride or a twist is not a turn
        return np.eye(3)
    quarter = np.round(np.arctan2(left[2], left[0]) / (np.pi / 2))
    return np.asarray(matrix_y(np.array(quarter * np.pi / 2)))


def _by_hand(name: str, names: tuple[str, ...], positions: np.ndarray, handles: np.ndarray) -> np.ndarray:
    if name not in _BY_HAND:
        return handles
    parts = dict(entry.rsplit(":", 1) for entry in _BY_HAND[name][1].split())
    handles = handles.copy()
    middle = (positions[:, 0].max() + positions[:, 0].min()) / 2
    for joint, bone in enumerate(names):
        part = parts.get(bone)
        if part:
            side = "left_" if positions[joint, 0] > middle else "right_"
            handles[joint] = HANDLE_NAMES.index(part if part in HANDLE_NAMES else side + part)
    return handles


def training_character(character: Character, name: str, mesh_vertices: int = 2400) -> TrainingCharacter:
    """A rigged character as the predictor trains on it.

    Args:
        character: With a rig.
        name: Its name in the archive; some rigs are known by it.
        mesh_vertices: Most vertices of the network mesh.

    Raises:
        CharacterError: No rig, or a mesh without a surface.
    """
    rig = character.rig
    if rig is None:
        raise CharacterError(f"{name}: there is no rig in this file; only rigged characters can be trained on")
    turn = _facing(name, rig.names, rig.positions)
    vertices = character.vertices @ turn.T.astype(np.float32)
    joints = rig.positions @ turn.T
    dense = rig.dense_weights()
    mesh = network_mesh(vertices, character.faces, mesh_vertices)
    weights = np.maximum(mesh.pull(dense), 0)
    total = weights.sum(axis=1, keepdims=True)
    weights = np.where(total > 1e-6, weights / np.maximum(total, 1e-6), 1 / weights.shape[1]).astype(np.float32)
    mass = (weights * mesh.areas[:, None]).sum(axis=0)
    handles = _by_hand(name, rig.names, joints, handle_of_joints(rig.names, rig.parents, joints, mass))
    joints = (joints - mesh.center) / mesh.scale
    return TrainingCharacter(
        name=name, vertices=mesh.vertices, normals=mesh.normals, areas=mesh.areas, edges=mesh.edges, weights=weights, joints=joints,
        parents=limb_parents(handles, rig.parents, joints), handles=handles, target=handle_target(weights, handles),
        root=_root(mesh.vertices, joints, rig.parents, handles, mass), height=float(np.ptp(mesh.vertices[:, 1])),
    )  # fmt: skip


def _root(vertices: np.ndarray, joints: np.ndarray, parents: np.ndarray, handles: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """The root joint b_1 of Eq. 4: the pelvis joints that move something, or the pelvis, or the rig's root."""
    for choice in ((handles == 0) & (mass > 0), handles == 0, parents < 0):
        if choice.any():
            place = joints[choice].mean(axis=0)
            return np.asarray(np.clip(place, vertices.min(axis=0), vertices.max(axis=0)), np.float32)
    return np.zeros(3, np.float32)


def build_characters(
    folder: str | Path, cache: str | Path, mesh_vertices: int = 2400, progress: Callable[[int, int, str], None] | None = None
) -> tuple[list[Path], dict[str, str]]:
    """Build the cache: one npz for each GLB under a folder and for each sample character. What is there already is kept, so a
    run that was cut off goes on.

    Args:
        folder: Folder of rigged GLB files, searched through.
        cache: Where the npz files go, in the same sub-folders.
        mesh_vertices: Most vertices of a network mesh.
        progress: Called with the number done, the number of all, and the name.

    Returns:
        The npz files, and what failed with its reason.

    Raises:
        FormatError: There is no GLB under the folder.
    """
    from bunraku.formats import load_character
    from bunraku.samples import sample_character, sample_names

    folder, cache = Path(folder), Path(cache)
    files = sorted(folder.rglob("*.glb"))
    if not files:
        raise FormatError(folder, "there are no GLB files here; unpack the character archive and give its folder")
    makers: dict[str, Callable[[], Character]] = {}
    for file in files:
        makers[file.relative_to(folder).with_suffix("").as_posix()] = partial(load_character, file)
    for sample in sample_names():
        makers[f"samples/{sample}"] = partial(sample_character, sample, rigged=True)
    done, failed = [], {}
    for number, (name, make) in enumerate(makers.items()):
        target = cache / f"{name}.npz"
        if progress:
            progress(number, len(makers), name)
        if not target.is_file():
            try:
                built = training_character(make(), name, mesh_vertices)
            except BunrakuError as error:
                failed[name] = str(error)
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
    """The cached characters for training, and those held out.

    Raises:
        FormatError: The cache is empty or damaged.
    """
    files = sorted(Path(cache).rglob("*.npz"))
    if not files:
        raise FormatError(cache, "no cached characters here; run `bunraku data characters` first")
    characters = [TrainingCharacter.load(file) for file in files]
    held = set(HELD_OUT)
    return [c for c in characters if c.name not in held], [c for c in characters if c.name in held]


def reference_characters(mesh_vertices: int = 2400) -> list[TrainingCharacter]:
    """The reference body in all its shapes, with the canonical handle weights as the target."""
    out = []
    for shape in reference_shapes():
        body = reference_body(shape)
        mesh = network_mesh(body.vertices, body.faces, mesh_vertices)
        joints = (np.asarray(body.joints, np.float64) - mesh.center) / mesh.scale
        character = TrainingCharacter(
            name=f"reference/{shape}", vertices=mesh.vertices, normals=mesh.normals, areas=mesh.areas, edges=mesh.edges,
            weights=mesh.pull(body.joint_weights), joints=joints, parents=np.array(JOINT_PARENTS), handles=np.arange(len(joints)),
            target=mesh.pull(body.handle_weights), root=joints[0].astype(np.float32), height=float(np.ptp(mesh.vertices[:, 1])),
        )  # fmt: skip
        out.append(character)
    return out
