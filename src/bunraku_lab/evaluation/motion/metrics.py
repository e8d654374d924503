"""Measures of generated motion: those of Guo et al. 2022 (section 4.1 of TapMo), Handle-FID, and seams."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bunraku.core.body.reference import reference_body
from bunraku.core.motion import HandleMotion, posed_points
from bunraku.errors import OptionError


@dataclass(frozen=True)
class Interval:
    """A mean over runs with half the width of its 95 % interval."""

    mean: float
    half: float


def t_quantile(degrees: int) -> float:
    """The 97.5 % quantile of Student's t."""
    from scipy.stats import t

    return float(t.ppf(0.975, degrees))


def interval(values: Sequence[float]) -> Interval:
    """Mean and 95 % interval of independent runs (Student's t); 0 wide for one run."""
    found = np.asarray(values, float)
    if len(found) < 2:
        return Interval(float(found.mean()), 0.0)
    half = t_quantile(len(found) - 1) * float(found.std(ddof=1)) / math.sqrt(len(found))
    return Interval(float(found.mean()), half)


def r_precision(motions: np.ndarray, candidates: np.ndarray) -> tuple[float, float, float]:
    """Top-1, top-2 and top-3 R-Precision: how often a motion's own sentence is among the nearest of its candidates.

    Args:
        motions: Shape (B, E).
        candidates: Vectors of each motion's sentences, its own first, shape (B, C, E).

    Returns:
        Shares. A draw counts as lost, so that an extractor that says the same of everything finds nothing.
    """
    distance = np.linalg.norm(np.asarray(candidates, float) - np.asarray(motions, float)[:, None], axis=-1)
    rank = (distance[:, 1:] <= distance[:, :1]).sum(1)
    return float((rank < 1).mean()), float((rank < 2).mean()), float((rank < 3).mean())


def multimodal_distance(motions: np.ndarray, sentences: np.ndarray) -> float:
    """MM-Dist: mean distance of a motion from its own sentence, both of shape (B, E)."""
    return float(np.linalg.norm(np.asarray(motions, float) - np.asarray(sentences, float), axis=-1).mean())


def frechet_distance(
    mean_a: np.ndarray, covariance_a: np.ndarray, mean_b: np.ndarray, covariance_b: np.ndarray
) -> float:
    """Squared Frechet distance of two Gaussians (Dowson & Landau 1982): |m_a - m_b|^2 + tr(A + B - 2 (A B)^(1/2)).

    The trace of the root is the sum of the singular values of A^(1/2) B^(1/2), also of singular covariances.

    Args:
        mean_a: Shape (E,).
        covariance_a: Symmetric, no negative eigenvalue, shape (E, E).
        mean_b: Shape (E,).
        covariance_b: Shape (E, E).
    """
    roots = []
    for covariance in (covariance_a, covariance_b):
        values, vectors = np.linalg.eigh(np.atleast_2d(np.asarray(covariance, float)))
        roots.append((vectors * np.sqrt(np.clip(values, 0, None))) @ vectors.T)
    shared = np.linalg.svd(roots[0] @ roots[1], compute_uv=False).sum()
    gap = np.square(np.asarray(mean_a, float) - np.asarray(mean_b, float)).sum()
    return float(
        max(gap + np.trace(np.atleast_2d(covariance_a)) + np.trace(np.atleast_2d(covariance_b)) - 2 * shared, 0.0)
    )


def fid(a: np.ndarray, b: np.ndarray) -> float:
    """Frechet distance of the Gaussians fitted to two sets of vectors, shapes (A, E) and (B, E).

    Raises:
        OptionError: A set has fewer than 2 vectors.
    """
    if len(a) < 2 or len(b) < 2:
        raise OptionError("FID needs at least 2 motions on either side")
    a, b = np.asarray(a, float), np.asarray(b, float)
    return frechet_distance(a.mean(0), np.cov(a, rowvar=False), b.mean(0), np.cov(b, rowvar=False))


def diversity(vectors: np.ndarray, random: np.random.Generator, pairs: int = 300) -> float:
    """Mean distance of motions drawn in two lists without repetition (Guo et al. 2022), shape (B, E)."""
    count = min(pairs, len(vectors) // 2)
    if count < 1:
        raise OptionError("Diversity needs at least 2 motions")
    drawn = random.permutation(len(vectors))[: 2 * count]
    return float(np.linalg.norm(vectors[drawn[:count]] - vectors[drawn[count:]], axis=-1).mean())


def multimodality(vectors: np.ndarray, random: np.random.Generator, pairs: int = 10) -> float:
    """MModality: mean distance of motions that were made from the same sentence.

    Args:
        vectors: S sentences with M motions each, shape (S, M, E).
        random: Draws the pairs.
        pairs: Pairs of a sentence, at most M / 2.
    """
    count = min(pairs, vectors.shape[1] // 2)
    if count < 1:
        raise OptionError("MModality needs at least 2 motions of each sentence")
    total = 0.0
    for rows in vectors:
        drawn = random.permutation(len(rows))[: 2 * count]
        total += float(np.linalg.norm(rows[drawn[:count]] - rows[drawn[count:]], axis=-1).mean())
    return total / len(vectors)


BODIES = ("tall", "toddler")
EVERY = 4  # frames; neighbours say the same


NEAR = 10  # frames


@dataclass(frozen=True)
class SeamReport:
    """Largest over median, see the module.

    Args:
        displacement: Of the step between frames, near seams.
        displacement_elsewhere: The same away from seams.
        jump: Of the change of the step, near seams.
        jump_elsewhere: The same away from seams.
    """

    displacement: float
    displacement_elsewhere: float
    jump: float
    jump_elsewhere: float


def posed_positions(motion: HandleMotion, positions: np.ndarray | None = None) -> np.ndarray:
    """World positions of the handles [m], shape (N, K, 3), at given rest positions (K, 3) or the reference body's."""
    rest = np.asarray(reference_body().handles.positions if positions is None else positions, float)
    transforms = motion.transforms(rest).astype(float)
    return np.asarray(posed_points(transforms, rest))


def measure_seams(motion: HandleMotion, seams: Sequence[int], positions: np.ndarray | None = None) -> SeamReport:
    """Measure the seams of a motion.

    Args:
        motion: N frames, at least 3.
        seams: Frames at which another window or prompt takes over.
        positions: Rest positions of the handles [m], shape (K, 3); the reference body's by default.
    """
    posed = posed_positions(motion, positions)
    found: list[float] = []
    for order in (1, 2):
        rate = np.linalg.norm(np.diff(posed, n=order, axis=0), axis=-1).mean(axis=1)
        near = np.zeros(len(rate), bool)
        for seam in seams:
            near[max(seam - NEAR, 0) : seam + NEAR] = True
        middle = max(float(np.median(rate)), 1e-9)
        found += [float(rate[part].max(initial=0)) / middle for part in (near, ~near)]
    return SeamReport(*found)
