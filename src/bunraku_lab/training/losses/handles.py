"""The losses of the Mesh Handle Predictor: the paper's three (Eq. 4, 13, 14 of TapMo) and four further ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from bunraku.core.motion import handle_offsets
from bunraku.core.skinning import EMPTY, PULL


def register_torch(
    source: torch.Tensor, targets: torch.Tensor, weights: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """`register` for training: differentiable in the weights, the source and the targets.

    The rotation's gradient is that of the polar factor, `U [(B - B^T) / (s_i + s_j)] V^T` with B the incoming gradient
    in the frames of U and V. It divides by sums of singular values, not by their differences as the gradient of an SVD
    does, so it is finite where singular values coincide; on a line the rotation takes no gradient.

    Args:
        source: Rest vertices [m], shape (V, 3).
        targets: Moved vertices [m], shape (N, V, 3).
        weights: Skinning weights, shape (V, K).

    Returns:
        Rotations (N, K, 3, 3), translations (N, K, 3) [m] and handles (K, 3) [m], in the type of the source.
    """
    kind = source.dtype
    source, targets, weights = source.double(), targets.double(), weights.double()
    total = weights.sum(0)
    empty = total <= EMPTY * len(source)
    shares = torch.where(
        empty, torch.full_like(weights, 1 / len(source)), weights / torch.where(empty, torch.ones_like(total), total)
    )
    means = shares.T @ source
    arms = source[:, None] - means
    spread = (arms.detach().square().sum(-1) * shares.detach()).sum(0)
    middle = source.detach().mean(0)
    moved = targets - middle
    moved_means = torch.einsum("nvi,vk->nki", moved, shares) + middle
    covariance = torch.einsum("nvi,vkj->nkij", moved, arms * (shares * ~empty)[..., None])
    covariance = covariance + (PULL * spread + (spread <= 0))[:, None, None] * torch.eye(
        3, dtype=covariance.dtype, device=covariance.device
    )
    rotations = _polar_rotation(covariance)
    return rotations.to(kind), (moved_means - means).to(kind), means.to(kind)


def _polar_rotation(matrix: torch.Tensor) -> torch.Tensor:
    """The nearest rotation to each 3x3 matrix, shape [..., 3, 3], with a gradient that stays finite."""

    class Polar(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Any, value: torch.Tensor) -> torch.Tensor:
            u, s, vt = torch.linalg.svd(value)
            sign = torch.sign(torch.linalg.det(u) * torch.linalg.det(vt))
            flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], -1)
            u, s = u * flip[..., None, :], s * flip
            ctx.save_for_backward(u, s, vt)
            return u @ vt

        @staticmethod
        def backward(ctx: Any, *gradients: Any) -> torch.Tensor:
            u, s, vt = ctx.saved_tensors
            b = u.mT @ gradients[0] @ vt.mT
            sums = s[..., :, None] + s[..., None, :]
            safe = sums > 1e-6 * s[..., :1, None]
            inner = torch.where(safe, (b - b.mT) / torch.where(safe, sums, torch.ones_like(sums)), torch.zeros_like(b))
            return u @ inner @ vt

    result: torch.Tensor = Polar.apply(matrix)  # type: ignore[no-untyped-call]
    return result


@dataclass(frozen=True)
class LossConfig:
    """Weights of the losses (Eq. 5; A.2 of TapMo for the first three).

    Args:
        root: nu_r of Eq. 5.
        root_unit: Eq. 4 is a squared distance in units of the character's extent, so small that nu_r alone leaves it
            without effect; this factor brings it to the size of the others.
        pose: nu_p of Eq. 5.
        pose_unit: Eq. 14 sums over vertices; `pose_loss` is a mean, and this factor stands for the sum's size.
        skinning: Weight of Eq. 13, 1 in the paper, where it is the main signal; here the semantic loss is.
        skinning_pairs: Vertex pairs drawn for Eq. 13.
        apart: Divergence at which pairs of different parts count as apart enough (see `skinning_loss`).
        semantic: Weight of the cross-entropy with the handles that bone names give.
        sparsity: Weight of the share outside the four largest weights.
        mirror: Weight of left-right consistency, which is also consistency between two sets of anchors.
        mirror_rate: Share of the meshes on which it is computed.
        smoothness: Weight of the differences along edges; 0 after an ablation (`docs/history.md`).
        feature: Weight of the change of f_phi against the network that a run starts from.
        feature_rate: Share of the meshes on which it is computed.
    """

    root: float = 0.1
    root_unit: float = 200.0
    pose: float = 1.0
    pose_unit: float = 150.0
    skinning: float = 0.1
    skinning_pairs: int = 2000
    apart: float = 3.0
    semantic: float = 1.0
    sparsity: float = 0.5
    mirror: float = 0.3
    mirror_rate: float = 0.25
    smoothness: float = 0.0
    feature: float = 0.0
    feature_rate: float = 0.5


def feature_loss(features: torch.Tensor, before: torch.Tensor) -> torch.Tensor:
    """How far the mesh deformation feature is from another network's, squared, over the size of that, shapes (448,)."""
    return ((features - before) ** 2).sum() / (before**2).sum().clamp_min(1e-9)


def root_loss(
    positions: torch.Tensor, weights: torch.Tensor, root: torch.Tensor, areas: torch.Tensor | None = None
) -> torch.Tensor:
    """Root Loss L_r [TapMo 4]: squared distance between the first handle and the root joint.

    Args:
        positions: Vertices, shape (V, 3).
        weights: Predicted weights, shape (V, K).
        root: Position of the rig's root joint b_1, shape (3,).
        areas: Surface of each vertex, shape (V,), against tessellation; all alike when not given, as in the paper.
    """
    share = weights[:, 0] if areas is None else weights[:, 0] * areas
    handle = (share[:, None] * positions).sum(0) / share.sum().clamp_min(1e-9)
    return (handle - root).square().sum()


def skinning_pairs(
    true: torch.Tensor, count: int, generator: torch.Generator | None = None, groups: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Random pairs of vertices that belong to one joint each (true weight over 0.9), for Eq. 13.

    Args:
        true: The rig's weights, shape (V, J).
        count: Pairs to draw.
        generator: Source of randomness.
        groups: A group for each joint, shape (J,); pairs from two joints of one group, -1 excepted, are left out,
            because bone names say that they share a handle.

    Returns:
        Vertices i and j, and gamma (+1 same joint, -1 not), each of up to `count`; half of the draws pair vertices of
        one joint, since blind draws hardly ever do.
    """
    most, joint = true.max(1)
    sure = torch.nonzero(most > 0.9)[:, 0]
    if len(sure) < 2:
        empty = torch.zeros(0, dtype=torch.long, device=true.device)
        return empty, empty, torch.zeros(0, device=true.device)
    sure = sure[torch.argsort(joint[sure], stable=True)]
    parts, sizes = torch.unique_consecutive(joint[sure], return_counts=True)
    starts = torch.cumsum(sizes, 0) - sizes
    part = torch.repeat_interleave(torch.arange(len(parts), device=true.device), sizes)
    first = torch.randint(len(sure), (count,), generator=generator, device=true.device)
    second = torch.randint(len(sure), (count,), generator=generator, device=true.device)
    within = torch.rand(count, generator=generator, device=true.device)
    same = starts[part[first]] + (within * sizes[part[first]]).long().clamp_max(sizes[part[first]] - 1)
    second = torch.where(torch.arange(count, device=true.device) % 2 == 0, same, second)
    i, j = sure[first], sure[second]
    gamma = torch.where(joint[i] == joint[j], 1.0, -1.0)
    keep = i != j
    if groups is not None:
        a, b = groups[joint[i]], groups[joint[j]]
        keep &= (gamma > 0) | (a != b) | (a < 0)
    return i[keep], j[keep], gamma[keep]


def skinning_loss(
    logits: torch.Tensor, i: torch.Tensor, j: torch.Tensor, gamma: torch.Tensor, apart: float = 3.0
) -> torch.Tensor:
    """Skinning Loss L_s [TapMo 13]: vertices of one rig part agree on their handles, vertices of two parts do not.

    The divergence of the -1 pairs has no upper bound, so that minimising Eq. 13 as written runs away; here a pair that
    is `apart` nats or more from agreement adds nothing more: `-min(KL, apart)`.

    Args:
        logits: Predicted weights before the softmax, shape (V, K).
        i, j, gamma: From `skinning_pairs`.
        apart: The bound; infinity gives Eq. 13 as it is written.
    """
    if len(i) == 0:
        return logits.sum() * 0
    log = logits.log_softmax(-1)
    divergence = (log[i].exp() * (log[i] - log[j])).sum(-1)
    return torch.where(gamma > 0, divergence, -divergence.clamp_max(apart)).mean()


def drive_local(
    positions: torch.Tensor, weights: torch.Tensor, rotations: torch.Tensor, translations: torch.Tensor,
    handles: torch.Tensor,
) -> torch.Tensor:  # fmt: skip
    """Eq. 3 without the global items, `sum_k s_k (R_k (v - h_k) + h_k + t_k)`, with the identity for handle 0.

    Args:
        positions: Rest vertices, shape (V, 3).
        weights: Skinning weights, shape (V, K).
        rotations: Of each handle in each pose, shape (N, K, 3, 3).
        translations: Of each handle in each pose, shape (N, K, 3).
        handles: Handle positions, shape (K, 3).

    Returns:
        Posed vertices, shape (N, V, 3).
    """
    eye = torch.eye(3, dtype=rotations.dtype, device=rotations.device).expand_as(rotations[:, :1])
    rotations = torch.cat([eye, rotations[:, 1:]], dim=1)
    translations = torch.cat([torch.zeros_like(translations[:, :1]), translations[:, 1:]], dim=1)
    offsets = handle_offsets(handles, translations, rotations)
    linear = torch.einsum("vk,nkij->nvij", weights, rotations)
    return torch.einsum("nvij,vj->nvi", linear, positions) + torch.einsum("vk,nki->nvi", weights, offsets)


def pose_loss(positions: torch.Tensor, posed: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """Pose Loss L_p [TapMo 14]: how far the handles are from being able to reproduce poses of the true skeleton.

    The local motion of each handle is the weighted registration of the rest mesh to the posed one (Besl & McKay 1992),
    through which the gradient flows; Eq. 3 without the global items then rebuilds the posed mesh.

    Args:
        positions: Rest vertices, shape (V, 3).
        posed: The mesh in poses in which the root joint rests, shape (N, V, 3).
        weights: Predicted weights, shape (V, K).

    Returns:
        Mean squared distance over vertices and poses.
    """
    rotations, translations, handles = register_torch(positions, posed, weights)
    return (drive_local(positions, weights, rotations, translations, handles) - posed).square().sum(-1).mean()


def semantic_loss(
    logits: torch.Tensor, target: torch.Tensor, areas: torch.Tensor, balance: float = 0.5
) -> torch.Tensor:
    """Cross-entropy between predicted weights and the handles that the bone names or the reference body give.

    Args:
        logits: Predicted weights before the softmax, shape (V, K).
        target: Share of each handle, shape (V, K); a row may sum to less than 1 where bones without a label have a
            part, and then counts for less.
        areas: Surface of each vertex, shape (V,).
        balance: 0 counts every patch of surface alike, 1 every handle alike.
    """
    mass = areas @ target
    total = mass.sum()
    if float(total) <= 1e-9:
        return logits.sum() * 0
    factor = torch.where(mass > 0, (mass.clamp_min(1e-9) / total) ** -balance, torch.zeros_like(mass))
    shares = target * areas[:, None] * factor
    return -(shares * logits.log_softmax(-1)).sum() / shares.sum()


def sparsity_loss(weights: torch.Tensor, count: int = 4) -> torch.Tensor:
    """Mean share of the weights outside each vertex's `count` largest, which viewers drop."""
    return 1 - weights.topk(min(count, weights.shape[1]), dim=-1).values.sum(-1).mean()


def smoothness_loss(weights: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
    """Mean squared difference of the weights along the edges (E, 2), the mesh's Dirichlet energy without its angles."""
    if len(edges) == 0:
        return weights.sum() * 0
    return (weights[edges[:, 0]] - weights[edges[:, 1]]).square().sum(-1).mean()


def mirror_loss(logits: torch.Tensor, mirrored: torch.Tensor, swap: torch.Tensor) -> torch.Tensor:
    """Divergence between the weights of a mesh and those of its mirror image.

    Args:
        logits: Of the mesh, shape (V, K).
        mirrored: Of the same vertices of the mirrored mesh, shape (V, K).
        swap: HANDLE_MIRROR, shape (K,).
    """
    a, b = logits.log_softmax(-1), mirrored[:, swap].log_softmax(-1)
    return 0.5 * ((a.exp() - b.exp()) * (a - b)).sum(-1).mean()
