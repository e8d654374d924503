"""What builds a denoiser: its sizes, and the presets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bunraku.body.layout import HANDLE_COUNT
from bunraku.diffusion.features import FEATURE_SIZE
from bunraku.nn.checkpoints import config_of

__all__ = ["PRESETS", "TRAINING_STEPS", "DenoiserConfig", "denoiser_config"]

TRAINING_STEPS = 1000
"""Of noise, from the clean motion on; a sampler visits some of them."""

_RETIRED = ("architecture", "convolution")
"""Fields of older checkpoints; what they switched on had weights of its own, by which it is refused."""


@dataclass(frozen=True)
class DenoiserConfig:
    """All that builds a denoiser; a checkpoint carries it.

    Args:
        width: Size of a token, d.
        layers: Decoder layers.
        heads: Attention heads.
        feedforward: Inner size of the feed-forward blocks.
        frames: Longest motion in one pass.
        frames_per_token: Frames that share a token.
        features: Numbers a frame, D.
        handles: Mesh handles, K.
        mesh_features: Size of f_phi.
        text_encoder: Name of the text encoder that it was trained with.
        text_size: Size of its tokens.
        pooled_size: Size of its sentence vector.
        fps: Frames a second [1/s].
        adaptation_mesh: Whether the adaptation's linear layer sees the mesh token beside the hidden state.
        adaptation_frame: What that layer says: "root", offsets in the root's frame as in the paper; or "joints", how
            far the joint between each handle and its parent should be moved, which gives `joint_offsets`.
        examples: Captured examples, retrieved for the sentence, that motion tokens attend to; 0 for none.
    """

    width: int = 256
    layers: int = 8
    heads: int = 4
    feedforward: int = 1024
    frames: int = 196
    frames_per_token: int = 4
    features: int = FEATURE_SIZE
    handles: int = HANDLE_COUNT
    mesh_features: int = 448
    text_encoder: str = "all-MiniLM-L6-v2"
    text_size: int = 384
    pooled_size: int = 384
    fps: float = 20.0
    adaptation_mesh: bool = False
    adaptation_frame: str = "root"
    examples: int = 0


def denoiser_config(data: Mapping[str, object]) -> DenoiserConfig:
    """The config that a checkpoint carries, also one with fields that are no longer in use.

    Raises:
        OptionError: As `config_of`.
    """
    return config_of(DenoiserConfig, {name: value for name, value in data.items() if name not in _RETIRED})


PRESETS: dict[str, DenoiserConfig] = {
    "small": DenoiserConfig(),
    "paper": DenoiserConfig(width=512, feedforward=1024, frames_per_token=1),
}
