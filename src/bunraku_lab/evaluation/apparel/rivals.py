"""MMDMC's tables 2 to 4: the whole mesh by our modules, one by one, and by other methods."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from bunraku.anatomy.handles.predict import predict_handles
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.fitting import fitted_clothes
from bunraku.apparel.learned.network import DisplacementNetwork
from bunraku.apparel.parts import find_parts
from bunraku.core.body.layout import HANDLE_NAMES, HANDLE_PARENTS, JOINT_NAMES
from bunraku.core.character import Character
from bunraku.core.geometry.graph import unique_edges
from bunraku.core.geometry.simplify import network_mesh
from bunraku.core.skinning import skin
from bunraku.errors import WeightsError
from bunraku_lab.baselines.pose_transfer import ROOM, TransferTarget
from bunraku_lab.evaluation.apparel.clips import KnownPlayer, TrueClip, edge_score, point_distance
from bunraku_lab.nn.apparel import clip_features
from bunraku_lab.nn.blend_shapes import NbsConfig, NbsNetwork, edge_mesh
from bunraku_lab.nn.checkpoints import lab_checkpoint
from bunraku_lab.nn.pose_transfer import TransferConfig, TransferNetwork
from bunraku_lab.training.apparel.body import BodyNetwork, body_weights, clothed_by_mask, tiled
from bunraku_lab.training.apparel.refinement import RefinementNetwork, refined, seam_of

OURS, BEST, PARTS = "ours", "NBS, best skinning that there is", "SPT, floor without training"
NBS, SPT, UNTRAINED = "NBS", "SPT", "untrained"
SEEN = 1000
"""Vertices of the mesh that NBS sees, about."""


def nbs_weights(vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray, model: NbsNetwork) -> np.ndarray:
    """Skinning weights of a mesh by Neural Blend Shapes, shape (V, 22), rows sum to 1.

    Args:
        vertices: At rest [m], +Y up and facing +Z, shape (V, 3).
        faces: Shape (F, 3).
        joints: J [m], shape (22, 3).
        model: The network.

    Raises:
        CharacterError: The mesh has no surface.
    """
    mesh = network_mesh(vertices, faces, round(ROOM * SEEN))
    rest = mesh.pull(vertices)
    low, height = rest[:, 1].min(), float(np.ptp(rest[:, 1]))
    origin = np.array([joints[0, 0], low, joints[0, 2]], np.float32)
    edges = edge_mesh(mesh.faces, mesh.edges, len(rest))
    with torch.no_grad():
        full = mesh.push(model(torch.from_numpy((rest - origin) / np.float32(height)), edges).numpy())
    return np.asarray(full / full.sum(axis=1, keepdims=True))


Figures = dict[str, float]
ROUNDS = 400  # of the fit of weights
STARTS = 4
TEN = 10
STRIDE = 6
"""Of this many frames of a whole clip one is looked at."""


def whole_figures(clip: TrueClip, moved: np.ndarray, truth: np.ndarray) -> Figures:
    """PMD of all, apparel and body [cm], and ELS, of all vertices in some frames, shapes (F, V, 3)."""
    clothed, cloth = clip.clothed, clip.clothed.apparel
    edges = unique_edges(np.asarray(clothed.faces, np.int64), len(clothed.rest))
    return {
        "PMD": 100 * float(point_distance(moved, truth).mean()),
        "PMD_a": 100 * float(point_distance(moved[:, cloth], truth[:, cloth]).mean()),
        "PMD_b": 100 * float(point_distance(moved[:, ~cloth], truth[:, ~cloth]).mean()),
        "ELS": edge_score(moved, clothed.rest, edges),
    }


def best_skinning(rest: np.ndarray, truth: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """The convex weights that put vertices nearest to the truth of some frames, shape (V, J).

    The sum of squares is a quadratic of the weights, whose least on the simplex accelerated projected gradients find.

    Args:
        rest: In the rest pose [m], shape (V, 3).
        truth: In F frames [m], shape (F, V, 3).
        affine: Affine transforms of the joints, shape (F, J, 3, 4).
    """
    square = np.zeros((len(rest), affine.shape[1], affine.shape[1]))
    target = np.zeros((len(rest), affine.shape[1]))
    for pose, wanted in zip(affine.astype(np.float64), truth.astype(np.float64), strict=True):
        away = np.einsum("jac,vc->vja", pose[..., :3], rest) + pose[..., 3][None] - wanted[:, None]  # sums are 1
        square += away @ away.transpose(0, 2, 1)
    scale = np.maximum(np.trace(square, axis1=1, axis2=2), 1e-12)[:, None]
    weights = np.full(target.shape, 1 / target.shape[1])
    ahead, speed = weights, 1.0
    for _ in range(ROUNDS):
        gradient = np.einsum("vij,vj->vi", square, ahead) / scale
        moved = _on_simplex(ahead - gradient)
        faster = (1 + np.sqrt(1 + 4 * speed**2)) / 2
        ahead, weights, speed = moved + (speed - 1) / faster * (moved - weights), moved, faster
    return np.asarray(weights)


def _on_simplex(values: np.ndarray) -> np.ndarray:
    """The nearest rows that are not negative and have a sum of 1, shape (V, J)."""
    falling = -np.sort(-values, axis=1)
    over = (np.cumsum(falling, axis=1) - 1) / np.arange(1, values.shape[1] + 1)
    count = (falling > over).sum(axis=1)
    return np.maximum(values - over[np.arange(len(values)), count - 1][:, None], 0)


def part_weights(seen: np.ndarray) -> np.ndarray:
    """Weights of the joints from those that the Mesh Handle Predictor gives a clothed mesh, of which it sees nothing
    else, shape (V, 30) -> (V, 22); those of its other parts go to the joint above.
    """
    out = np.zeros((len(seen), len(JOINT_NAMES)))
    for handle in range(len(HANDLE_NAMES)):
        above = handle
        while HANDLE_NAMES[above] not in JOINT_NAMES:
            above = HANDLE_PARENTS[above]
        out[:, JOINT_NAMES.index(HANDLE_NAMES[above])] += seen[:, handle]
    return out / out.sum(axis=1, keepdims=True)


def ten_frame_spans(clip: TrueClip) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Ten frames at `STARTS` of a clip: the first, the joints' affine transforms, and all vertices [m], (10, V, 3)."""
    everything = np.arange(len(clip.clothed.rest))
    for first in np.linspace(3, len(clip.transforms) - TEN - 1, STARTS).astype(int):
        span = slice(first, first + TEN)
        short = replace(clip, transforms=clip.transforms[span], offsets=clip.offsets[span])
        yield int(first), short.affine, short.truth(everything)


def mean_figures(rows: Sequence[Figures]) -> Figures:
    """The mean of each figure."""
    return {key: float(np.mean([one[key] for one in rows])) for key in rows[0]}


def our_ten_frames(
    clip: TrueClip, guessed: ClothedCharacter, weights: np.ndarray, network: DisplacementNetwork,
    refinement: RefinementNetwork | None,
) -> Figures:  # fmt: skip
    """The mean figures of ours over ten frames from true states.

    Args:
        clip: The clip.
        guessed: The character as our networks see it.
        weights: Of the joints by the body network, shape (V, J).
        network: Of the displacement.
        refinement: Of where body and apparel meet.
    """
    found = []
    for first, affine, truth in ten_frame_spans(clip):
        moved = np.array(skin(clip.clothed.rest, weights, affine), np.float32)
        if guessed.apparel.any():
            moved = _from_true_state(clip, guessed, network, first, moved)
            if refinement is not None:
                seam = seam_of(guessed, weights)
                moved = np.stack([refined(refinement, seam, *pair) for pair in zip(moved, affine, strict=True)])
        found.append(whole_figures(clip, moved, truth))
    return mean_figures(found)


def _from_true_state(
    clip: TrueClip, guessed: ClothedCharacter, network: DisplacementNetwork, first: int, moved: np.ndarray
) -> np.ndarray:
    """The skinned vertices with apparel as the network moves it on from the three true frames before `first`."""
    player = KnownPlayer(guessed, network, safe=False)
    player.start(clip.transforms[0])
    assert player.features is not None
    for pose in clip.transforms[: first - 3]:
        player.features.advance(pose)
    before = slice(first - 3, first)
    known = replace(clip, transforms=clip.transforms[before], offsets=clip.offsets[before])
    own = player.nodes.vertex
    away = known.truth(own) - replace(known, clothed=guessed).carried(own)
    turns = np.stack([one.turns for one in clip_features(guessed, player.nodes, clip.transforms[:first])])[-3:]
    player.know(np.einsum("nmba,nmb->nma", turns, away) / guessed.scale, known.transforms)
    for row, pose in enumerate(clip.transforms[first : first + TEN]):
        moved[row, player.carrier.vertices] = player.advance(pose)
    return moved


Mover = Callable[[np.ndarray], np.ndarray]
"""Takes affine transforms of the joints (P, 22, 3, 4) to vertices [m] (P, V, 3)."""
FILES = {NBS: "nbs.safetensors", SPT: "spt.safetensors"}
"""Of each trained method, in the folder of the baselines' weights."""


@dataclass(frozen=True, eq=False)
class Rival:
    """Networks of another method."""

    name: str
    digest: str
    network: NbsNetwork | TransferNetwork


def rivals_of(folder: Path | None) -> list[Rival]:
    """Those whose weights are in a folder, and untrained ones beside them; none without a folder.

    Raises:
        WeightsError: A file is damaged.
    """
    if folder is None:
        return []
    found = []
    for name, file in FILES.items():
        path = folder / file
        if path.is_file():
            network = NbsNetwork.load(path) if name == NBS else TransferNetwork.load(path)
            found.append(Rival(name, hashlib.sha256(path.read_bytes()).hexdigest()[:16], network))
    known = {one.name for one in found}
    torch.manual_seed(0)
    if NBS in known:
        found.append(Rival(f"{NBS}, {UNTRAINED}", UNTRAINED, NbsNetwork(NbsConfig()).eval()))
    torch.manual_seed(0)
    if SPT in known:
        found.append(Rival(f"{SPT}, {UNTRAINED}", UNTRAINED, TransferNetwork(TransferConfig()).eval()))
    return found


def floor_movers(clothed: ClothedCharacter, truth: np.ndarray, affine: np.ndarray) -> dict[str, Mover]:
    """Rows that need no training: the best skinning, and SPT's predicted parts moved as the joints are.

    Args:
        clothed: The character, of which mesh and joints are used.
        truth: Its vertices in some frames [m], shape (F, V, 3).
        affine: Affine transforms of the joints in these frames, shape (F, 22, 3, 4).
    """
    seen = predict_handles(Character("clothed", clothed.rest, clothed.faces)).weights
    weights = {PARTS: part_weights(seen), BEST: best_skinning(clothed.rest, truth, affine)}
    return {name: partial(skin, clothed.rest, own) for name, own in weights.items()}


def rival_mover(clothed: ClothedCharacter, network: NbsNetwork | TransferNetwork) -> Mover:
    """What moves a character by trained networks; of it mesh and joints are used."""
    if isinstance(network, NbsNetwork):
        return partial(skin, clothed.rest, nbs_weights(clothed.rest, clothed.faces, clothed.joints, network))
    parts = predict_handles(Character("clothed", clothed.rest, clothed.faces)).weights
    target = TransferTarget.of(clothed.rest, clothed.faces, parts, clothed.joints[0], network)
    return partial(target.with_joints, joints=clothed.joints)


def mover_rows(clip: TrueClip, mover: Mover) -> tuple[Figures, Figures]:
    """Figures of a way from rest over the whole clip, and over ten frames at several places."""
    frames = np.arange(0, len(clip.transforms), STRIDE)
    short = replace(clip, transforms=clip.transforms[frames], offsets=clip.offsets[frames])
    truth = short.truth(np.arange(len(clip.clothed.rest)))
    rest = whole_figures(clip, np.asarray(mover(short.affine)), truth)
    ten = [whole_figures(clip, np.asarray(mover(affine)), truth) for _, affine, truth in ten_frame_spans(clip)]
    return rest, mean_figures(ten)


def rival_rows(clip: TrueClip, network: NbsNetwork | TransferNetwork) -> list[Figures]:
    """`mover_rows` of trained networks, as JSON can say them."""
    return list(mover_rows(clip, rival_mover(clip.clothed, network)))


MOST = 2000  # vertices that distances are taken of


def mask_scores(clip: TrueClip, masks: Path | None = None) -> dict[str, float]:
    """Intersection over union of the mask that is found."""
    clothed = clip.clothed
    mask = find_parts(clothed.rest, clothed.faces, checkpoint=masks).mask
    return {"iou": float((mask & clothed.apparel).sum() / max((mask | clothed.apparel).sum(), 1))}


def module_row(
    clip: TrueClip, network: DisplacementNetwork, masks: Path | None = None, body: Path | None = None,
    refinement: RefinementNetwork | None = None,
) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:  # fmt: skip
    """Tables 2 and 3 for a clip, from rest: the body module alone, with apparel that is found, with the joint
    refinement, and with the file's mask, but not its stiffness; and what needs no training
    (`evaluation.apparel.rivals`). Body and apparel are skinned by predicted weights, and nothing of the file but its
    joints is used where it does not say so. Then table 2 over ten frames from true states.
    """
    true = clip.clothed
    guessed, weights = clothed_by_mask(true, masks, body)
    given = fitted_clothes(true.rest, true.faces, true.joints, weights, true.apparel)
    frames = np.arange(0, len(clip.transforms), STRIDE)
    short = replace(clip, transforms=clip.transforms[frames], offsets=clip.offsets[frames])
    truth = short.truth(np.arange(len(true.rest)))
    bare = np.asarray(skin(true.rest, weights, short.affine))
    rows = {"body module": whole_figures(clip, bare, truth)}
    tens: dict[str, Figures] = {}
    for name, mover in floor_movers(true, truth, short.affine).items():
        rows[name], tens[name] = mover_rows(clip, mover)
    for clothed, name in ((guessed, ""), (given, ", true mask")):
        moved = tiled(clothed, clip.transforms, network, frames)
        rows[f"body + apparel{name}"] = whole_figures(clip, moved, truth)
        if refinement is not None:
            seam = seam_of(clothed, weights)
            merged = np.stack([refined(refinement, seam, *pair) for pair in zip(moved, short.affine, strict=True)])
            rows[f"with joint refinement{name}"] = whole_figures(clip, merged, truth)
    return rows, {**tens, OURS: our_ten_frames(clip, guessed, weights, network, refinement)}


def body_table(clips: Sequence[TrueClip], bodies: Sequence[Path]) -> dict[str, dict[str, float]]:
    """Table 4: body networks by what they do with geodesic distances; apparel follows the joints in the truth.

    Args:
        clips: What is measured on.
        bodies: Checkpoints; the shipped one when empty.
    """
    paths = list(bodies)
    if not paths:
        try:
            paths = [lab_checkpoint("apparel-body")]
        except WeightsError:
            return {}
    out: dict[str, dict[str, float]] = {}
    for path in paths:
        rows = []
        for clip in {clip.name: clip for clip in clips}.values():
            rows.append(_body_row(clip, path))
        out[BodyNetwork.load(path).config.geodesics] = {
            key: float(np.mean([row[key] for row in rows])) for key in rows[0]
        }
    return out


def _body_row(clip: TrueClip, path: Path) -> dict[str, float]:
    clothed = clip.clothed
    few = slice(0, None, 3 * STRIDE)
    short = replace(clip, transforms=clip.transforms[few], offsets=clip.offsets[few])
    chosen = np.linspace(0, len(clothed.rest) - 1, min(MOST, len(clothed.rest))).astype(np.int64)
    weights = body_weights(clothed.rest, clothed.faces, clothed.joints, path)
    everything = np.arange(len(clothed.rest))
    truth, moved = short.carried(everything), np.array(skin(clothed.rest, weights, short.affine))
    cloth = clothed.apparel[chosen]
    edges = unique_edges(np.asarray(clothed.faces, np.int64), len(clothed.rest))
    gap = np.linalg.norm(moved[:, chosen] - truth[:, chosen], axis=-1).mean(axis=0)
    return {
        "PMD": 100 * float(gap.mean()), "PMD_a": 100 * float(gap[cloth].mean()),
        "PMD_b": 100 * float(gap[~cloth].mean()),
        "ELS": edge_score(moved, clothed.rest, edges),
    }  # fmt: skip
