"""What builds an extractor of motions and sentences, and what all who use one agree on."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.diffusion.features import FEATURE_SIZE

__all__ = ["FARTHEST", "KIND", "LONGEST", "RADIUS", "RANKER", "SHORTEST", "ExtractorConfig"]

KIND, RANKER = "extractor", "ranker"
"""Kinds of checkpoints: who judges, and who chooses."""
LONGEST = 196
"""Frames that the ranker looks at at once; longer parts are looked at in pieces."""
SHORTEST = 8
"""Frames under which a part says nothing."""
RADIUS = 10.0
"""Length of all vectors."""
FARTHEST = 8.0
"""Standard deviations up to which a feature counts, as in training of the denoiser."""


@dataclass(frozen=True)
class ExtractorConfig:
    """All that builds an extractor; a checkpoint carries it.

    Args:
        width: Size of a token.
        layers: Transformer layers of the motion encoder.
        heads: Attention heads.
        feedforward: Inner size of the feed-forward blocks.
        embedding: Size of the common space. The covariance that FID needs has its square, so it stays small.
        frames_per_token: Frames that share a token.
        features: Numbers a frame, D.
        text_encoder: Name of the text encoder.
        text_size: Size of its tokens.
        pooled_size: Size of its sentence vector.
        dropout: Share of units left out while training.
    """

    width: int = 192
    layers: int = 3
    heads: int = 4
    feedforward: int = 384
    embedding: int = 64
    frames_per_token: int = 4
    features: int = FEATURE_SIZE
    text_encoder: str = "all-MiniLM-L6-v2"
    text_size: int = 384
    pooled_size: int = 384
    dropout: float = 0.1
