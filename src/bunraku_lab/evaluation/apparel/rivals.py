"""The other methods of MMDMC's table 2: what moves all vertices of a clothed character with its joints.

Neural Blend Shapes and SPT stand there trained, where their weights are given, and untrained, which is what training
adds to; beside what their kind cannot be better than, and what they stand on (`evaluation.apparel.against`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.core.character import Character
from bunraku.core.skinning import skin
from bunraku.handles.predict import predict_handles
from bunraku_lab.baselines.neural_blend_shapes import blended_mesh
from bunraku_lab.baselines.transfer_target import TransferTarget
from bunraku_lab.evaluation.apparel.against import (
    STRIDE,
    Figures,
    best_skinning,
    mean_figures,
    part_weights,
    ten_frame_spans,
    whole_figures,
)
from bunraku_lab.evaluation.apparel.clips import TrueClip
from bunraku_lab.evaluation.apparel.names import BEST, NBS, NBS_SHAPES, PARTS, SPT, SPT_JOINTS, UNTRAINED
from bunraku_lab.nn.baselines.blend_shapes import NbsConfig, NbsNetwork, load_nbs
from bunraku_lab.nn.baselines.pose_transfer import TransferConfig, TransferNetwork, load_transfer

__all__ = ["FILES", "Mover", "Rival", "floor_movers", "mover_rows", "rival_mover", "rival_rows", "rivals_of"]

Mover = Callable[[np.ndarray], np.ndarray]
"""Takes affine transforms of the joints (P, 22, 3, 4) to vertices [m] (P, V, 3)."""
FILES = {
    NBS: "nbs.safetensors", NBS_SHAPES: "nbs-shapes.safetensors", SPT: "spt.safetensors",
    SPT_JOINTS: "spt-joints.safetensors",
}  # fmt: skip
"""Of each trained method, in the folder of the baselines' weights."""


@dataclass(frozen=True, eq=False)
class Rival:
    """Networks of another method.

    Args:
        name: Of its row.
        digest: Of its weights.
        network: Neural Blend Shapes, or a pose transfer.
    """

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
            network = load_nbs(path) if name in (NBS, NBS_SHAPES) else load_transfer(path)
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
    """What needs no training, by the names of its rows: the best skinning that there is, and SPT's predicted parts
    moved as the joints are.

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
        return blended_mesh(clothed.rest, clothed.faces, clothed.joints, network).posed
    parts = None
    if not network.config.predictor:
        parts = predict_handles(Character("clothed", clothed.rest, clothed.faces)).weights
    target = TransferTarget.of(clothed.rest, clothed.faces, parts, clothed.joints[0], network)
    return partial(target.with_joints, joints=clothed.joints)


def mover_rows(clip: TrueClip, mover: Mover) -> tuple[Figures, Figures]:
    """Figures of a way from rest over the whole clip, and over ten frames at several places.

    Args:
        clip: The clip.
        mover: The way.
    """
    frames = np.arange(0, len(clip.transforms), STRIDE)
    short = replace(clip, transforms=clip.transforms[frames], offsets=clip.offsets[frames])
    truth = short.truth(np.arange(len(clip.clothed.rest)))
    rest = whole_figures(clip, np.asarray(mover(short.affine)), truth)
    ten = [whole_figures(clip, np.asarray(mover(affine)), truth) for _, affine, truth in ten_frame_spans(clip)]
    return rest, mean_figures(ten)


def rival_rows(clip: TrueClip, network: NbsNetwork | TransferNetwork) -> list[Figures]:
    """`mover_rows` of trained networks, as JSON can say them."""
    return list(mover_rows(clip, rival_mover(clip.clothed, network)))
