"""The denoiser (section 3.2 of TapMo) at inference, its checkpoint, and its changes for few steps."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_PARENTS
from bunraku.core.body.reference import capped
from bunraku.core.geometry.rotations import matrix_from_6d
from bunraku.core.nn.checkpoints import config_of, fitting_config, load_checkpoint, read_config
from bunraku.core.nn.layers import (
    Condition,
    DecoderLayer,
    Memory,
    Rotary,
    Weights,
    brought,
    decoded,
    hidden_by,
    padded,
    rotary_positions,
    silu,
    through,
    waves,
)
from bunraku.errors import WeightsError
from bunraku.generation.features import FEATURE_SIZE, ROOT_SIZE

TRAINING_STEPS = 1000  # of noise, from the clean motion on; a sampler visits some of them

_RETIRED = ("architecture", "convolution")
"""Fields of older checkpoints; what they switched on had weights of its own, by which it is refused."""


@dataclass(frozen=True)
class DenoiserConfig:
    """All that builds a denoiser; a checkpoint carries it."""

    width: int = 256  # size of a token, d
    layers: int = 8  # decoder layers
    heads: int = 4  # attention heads
    feedforward: int = 1024  # inner size of the feed-forward blocks
    frames: int = 196  # longest motion in one pass
    frames_per_token: int = 4  # frames that share a token
    features: int = FEATURE_SIZE  # numbers a frame, D
    handles: int = HANDLE_COUNT  # mesh handles, K
    mesh_features: int = 448  # size of f_phi
    text_encoder: str = "all-MiniLM-L6-v2"  # name of the text encoder that it was trained with
    # text_size, pooled_size: sizes of its tokens and of its sentence vector
    text_size: int = 384
    pooled_size: int = 384
    fps: float = 20.0  # frames a second [1/s]
    adaptation_mesh: bool = False  # whether the adaptation's linear layer sees the mesh token beside the hidden state
    # output of that layer: "root", offsets in the root's frame as in the paper; or "joints", how far the joint between
    # each handle and its parent should be moved, which gives `joint_offsets`
    adaptation_frame: str = "root"
    examples: int = 0  # captured examples, retrieved for the sentence, that motion tokens attend to; 0 for none


def denoiser_config(data: Mapping[str, object]) -> DenoiserConfig:
    """The config of a checkpoint, also one with fields that are no longer in use.

    Raises:
        OptionError: As of `config_of`.
    """
    return config_of(DenoiserConfig, {name: value for name, value in data.items() if name not in _RETIRED})


PRESETS: dict[str, DenoiserConfig] = {
    "small": DenoiserConfig(),
    "paper": DenoiserConfig(width=512, feedforward=1024, frames_per_token=1),
}

EXAMPLE_TOKENS = 2
"""Motion tokens whose frames share one token of an example: examples need less detail, and attention costs half."""


@dataclass(frozen=True, eq=False)
class RetrievedExamples:
    """Captured motions that show what each sentence of a batch says."""

    values: np.ndarray  # network units, zero behind an example's end, shape (B, R, N, D)
    lengths: np.ndarray  # real frames, 0 without an example, shape (B, R)
    pooled: np.ndarray  # the vector of each example's own sentence, shape (B, R, P)

    def rows(self, rows: np.ndarray) -> RetrievedExamples:
        """These rows of the batch, in their order."""
        return RetrievedExamples(self.values[rows], self.lengths[rows], self.pooled[rows])


FEW_STEPS_KIND = "few-steps"
_MARK = "motion_out.weight"


def fingerprint(state: Mapping[str, np.ndarray]) -> str:
    """Identifies weights of a denoiser, by their last layer in half precision."""
    last_layer = state.get(_MARK)
    return "" if last_layer is None else hashlib.sha256(last_layer.astype(np.float16).tobytes()).hexdigest()[:32]


@dataclass(frozen=True, eq=False)
class FewSteps:
    """Changes to a denoiser's weights, and the steps that they are for."""

    of: str  # `fingerprint` of the teacher
    visited: tuple[int, ...]  # diffusion steps, falling
    guidance: float  # scale of the teacher's guidance by sentences, which the changes hold
    changes: Mapping[str, tuple[np.ndarray, np.ndarray]]  # up (O, R) and down (R, I) by the name of the matrix (O, I)

    def fits(self, state: Mapping[str, np.ndarray]) -> bool:
        """Whether these are the teacher's weights."""
        return self.of == fingerprint(state)

    def on(self, state: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """The teacher's weights, each changed when it is read, so that they are never all in memory twice.

        Raises:
            ValueError: A change is of no matrix of theirs.
        """
        for name, (up, down) in self.changes.items():
            matrix = state.get(name)
            if matrix is None or up.ndim != 2 or down.ndim != 2 or matrix.shape != (len(up), down.shape[1]):
                raise ValueError(f"'{name}' is not a matrix of the denoiser with this change's size")
        return _Changed(state, self.changes)


class _Changed(Mapping[str, np.ndarray]):
    def __init__(self, state: Mapping[str, np.ndarray], changes: Mapping[str, tuple[np.ndarray, np.ndarray]]):
        self._state, self._changes = state, changes

    def __getitem__(self, name: str) -> np.ndarray:
        matrix, change = self._state[name], self._changes.get(name)
        if change is None:
            return matrix
        up, down = change
        changed: np.ndarray = up.astype(np.float32) @ down.astype(np.float32)
        changed += matrix
        return changed

    def __iter__(self) -> Iterator[str]:
        return iter(self._state)

    def __len__(self) -> int:
        return len(self._state)


def load_few_steps(path: str | Path) -> FewSteps:
    """Read the result of `bunraku train few-steps`.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or names no steps.
    """
    state, config = load_checkpoint(path, FEW_STEPS_KIND, half=True)
    visited: Any = config.get("visited")
    steps = visited if isinstance(visited, list) else []
    valid = all(isinstance(step, int) and 0 <= step < TRAINING_STEPS for step in steps)
    if not steps or not valid or any(a <= b for a, b in zip(steps, steps[1:], strict=False)):
        raise WeightsError(f"{path}: it names no falling diffusion steps; distil the denoiser again")
    names = sorted({name.rpartition(".")[0] for name in state})
    try:
        changes = {name: (state[f"{name}.up"], state[f"{name}.down"]) for name in names}
        return FewSteps(str(config["of"]), tuple(steps), float(config["guidance"]), changes)
    except (KeyError, TypeError, ValueError) as error:
        raise WeightsError(
            f"{path}: a change of the weights is not whole ({error}); distil the denoiser again"
        ) from error


KIND = "diffusion"


class Denoiser:
    """Predicts x0 and the adaptation from a noisy motion, the step, a sentence and a mesh feature.

    Motion enters and leaves in network units (see `FeatureStatistics`); the statistics travel with the weights, as do
    notes on the training. `visited` are the few steps that the weights were distilled for, falling; empty for others.

    Raises:
        ValueError: The weights have other sizes than the config.
    """

    def __init__(
        self, config: DenoiserConfig, weights: Weights, notes: Mapping[str, object] | None = None,
        visited: tuple[int, ...] = (),
    ):  # fmt: skip
        self.config, self.visited = config, visited
        self.notes: Mapping[str, object] = notes or {}
        width, patch = config.width, config.frames_per_token
        if config.heads < 1 or width % (2 * config.heads) or patch < 1:
            raise ValueError(f"{width} channels cannot be shared by {config.heads} heads, or {patch} frames by a token")
        self.mean, self.std = weights.array("mean", config.features), weights.array("std", config.features)
        # optimisers keep their state by the order of the weights, so a run that was stopped needs them in this one
        self.motion_in = weights.linear("motion_in", config.features * patch, width)
        self.text_in = weights.linear("text_in", config.text_size, width)
        self.mesh_in = weights.linear("mesh_in", config.mesh_features, width)
        self.pooled_in = weights.linear("pooled_in", config.pooled_size, width)
        self.null_text, self.null_pooled, self.null_mesh = (
            weights.array(name, width) for name in ("null_text", "null_pooled", "null_mesh")
        )
        step_in = weights.perceptron("step_in.0 step_in.2", width, width, width)
        self.step_in = step_in.first, silu, step_in.second
        self.steer = weights.linear("steer", width, 9 * width)
        shown = config.examples > 0
        self.layers = [
            DecoderLayer(width, config.heads, config.feedforward, part, shown, shown and index % 2 == 1)
            for index, part in enumerate(weights.part(f"layers.{number}") for number in range(config.layers))
        ]
        self.final = weights.linear("final", width, 2 * width)
        self.motion_out = weights.linear("motion_out", width, config.features * patch)
        seen = width * (2 if config.adaptation_mesh else 1)
        self.adaptation_out = weights.linear("adaptation_out", seen, config.handles * 3 * patch)
        self.steer_more = None
        if config.examples:
            self.steer_more = weights.linear("steer_more", width, 3 * width)
            frames = config.features * patch * EXAMPLE_TOKENS
            self.example_in = weights.linear("example_in", frames, width)
            self.example_sentence_in = weights.linear("example_sentence_in", config.pooled_size, width)
            self.null_example = weights.array("null_example", width)

    @property
    def knows_meshes(self) -> bool:
        """Whether training saw mesh features; else the mesh token must stay the learned null token."""
        return bool(self.notes.get("characters"))

    def condition(
        self, text: np.ndarray | None, text_mask: np.ndarray | None, pooled: np.ndarray | None, mesh: np.ndarray | None,
        keep_text: np.ndarray, keep_mesh: np.ndarray, examples: RetrievedExamples | None = None,
    ) -> Condition:  # fmt: skip
        """What the layers read beside the motion, which does not depend on the step.

        Args:
            text: Text tokens, shape (B, L, C); None for none.
            text_mask: True where real, shape (B, L).
            pooled: Sentence vectors, shape (B, P).
            mesh: Mesh features f_phi, shape (B, 448); None for no mesh in particular.
            keep_text: False where the sentence is dropped for classifier-free guidance, shape (B,).
            keep_mesh: False where the mesh feature is unknown, shape (B,).
            examples: Captured examples of the sentences, dropped with them; None for none.
        """
        batch, width = len(keep_text), self.config.width
        token = self._mesh_token(mesh, keep_mesh)
        memory = [token[:, None], np.broadcast_to(self.null_text, (batch, 1, width))]
        mask = [np.ones((batch, 1), bool), ~keep_text[:, None]]
        if text is not None and text_mask is not None:
            memory.append(self.text_in(text))
            mask.append(text_mask & keep_text[:, None])
        tokens = np.concatenate(memory, axis=1)
        memories = [Memory(*layer.memory(tokens)) for layer in self.layers]
        example_memories: list[Memory | None] = [None] * len(self.layers)
        hidden = None
        if self.config.examples:
            keys, values, real = self._example_tokens(examples, keep_text)
            hidden = hidden_by(real)
            rotary = self._example_rotary(keys.shape[1])
            example_memories = [layer.example_memory(keys, values, rotary) for layer in self.layers]
        return Condition(
            memories, hidden_by(np.concatenate(mask, axis=1)), self._sentence(pooled, keep_text), token,
            example_memories, hidden,
        )  # fmt: skip

    def _mesh_token(self, mesh: np.ndarray | None, keep: np.ndarray) -> np.ndarray:
        null = np.broadcast_to(self.null_mesh, (len(keep), len(self.null_mesh)))
        return null if mesh is None else np.where(keep[:, None], self.mesh_in(mesh), null)

    def _sentence(self, pooled: np.ndarray | None, keep: np.ndarray) -> np.ndarray:
        null = np.broadcast_to(self.null_pooled, (len(keep), len(self.null_pooled)))
        if pooled is None:
            return null
        return np.where(keep[:, None], self.pooled_in(pooled * np.float32(self.config.pooled_size**0.5)), null)

    def _example_tokens(
        self, examples: RetrievedExamples | None, keep: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Keys, values and mask of the examples' tokens; token 0 is the learned null example, which is always there."""
        batch, width = len(keep), self.config.width
        null, always = np.broadcast_to(self.null_example, (batch, 1, width)), np.ones((batch, 1), bool)
        if examples is None:
            return null, null, always
        size = self.config.frames_per_token * EXAMPLE_TOKENS
        count, frames = examples.values.shape[1:3]
        tokens = -(-frames // size)
        real = np.arange(tokens * size) < examples.lengths[..., None]
        filled = padded(examples.values, tokens * size)
        filled *= real[..., None]
        values = self.example_in(filled.reshape(batch, count, tokens, -1))
        sentence = self.example_sentence_in(examples.pooled * np.float32(self.config.pooled_size**0.5))
        keys = values + sentence[:, :, None]
        mask = real.reshape(batch, count * tokens, size).any(-1) & keep[:, None]
        return (
            np.concatenate([null, keys.reshape(batch, -1, width)], axis=1),
            np.concatenate([null, values.reshape(batch, -1, width)], axis=1),
            np.concatenate([always, mask], axis=1),
        )

    def _example_rotary(self, tokens: int) -> Rotary:
        """Rotary positions of the examples' tokens, each example from its own start; the null example is there, too."""
        times = EXAMPLE_TOKENS * np.arange((tokens - 1) // self.config.examples)
        positions = np.concatenate([[0], np.tile(times, self.config.examples)])[:tokens]
        return rotary_positions(positions, self.config.width // self.config.heads)

    def __call__(
        self, x: np.ndarray, step: int | np.ndarray, lengths: np.ndarray, condition: Condition, adapts: bool = True
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Clean motion x0 (B, N, D) in network units and the adaptation of local translations (B, N, K, 3) [m].

        Args:
            x: Noisy motion in network units, shape (B, N, D).
            step: Diffusion step in 0..999, or that of each row, shape (B,), float32.
            lengths: Frames that are real in each row, shape (B,).
            condition: Result of `condition`.
            adapts: Whether the adaptation is wanted.
        """
        batch, frames, features = x.shape
        h = self.hidden(x, step, lengths, condition)
        motion = self.motion_out(h).reshape(batch, -1, features)[:, :frames]
        if not adapts:
            return motion, None
        if self.config.adaptation_mesh:
            token = np.broadcast_to(condition.mesh[:, None], (batch, h.shape[1], condition.mesh.shape[1]))
            h = np.concatenate([h, token], axis=-1)
        said = self.adaptation_out(h).reshape(batch, -1, self.config.handles, 3)[:, :frames]
        if self.config.adaptation_frame == "joints":
            said = capped_offsets(said, motion * self.std + self.mean)
        return motion, said

    def _tokens(self, x: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The input of each token, zero behind a motion's end (B, T, d), and which are real (B, T) or None for all."""
        batch, frames, features = x.shape
        patch = self.config.frames_per_token
        tokens = -(-frames // patch)
        filled = padded(x, tokens * patch)
        full = bool((lengths >= frames).all())
        real = np.arange(tokens * patch) < lengths[:, None]
        if not full:
            filled *= real[..., None]
        entered = self.motion_in(filled.reshape(batch, tokens, patch * features))
        return entered, None if full else real.reshape(batch, tokens, patch).max(-1)

    def _step(self, step: int | np.ndarray) -> np.ndarray:
        """The diffusion step as the layers see it, shape (1, d)."""
        steps = np.array([step], np.float32) if np.isscalar(step) else cast(np.ndarray, step)
        return through(self.step_in, waves(steps, self.config.width))

    def hidden(self, x: np.ndarray, step: int | np.ndarray, lengths: np.ndarray, condition: Condition) -> np.ndarray:
        """The last hidden states, which both heads read, shape (B, T, d) for T tokens; arguments as of `__call__`."""
        h, real = self._tokens(x, lengths)
        vector = silu(self._step(step) + condition.sentence)
        width = self.config.width
        steer = self.steer(vector).reshape(len(x), 9, width)
        if self.steer_more is not None:
            steer = np.concatenate([steer, self.steer_more(vector).reshape(len(x), -1, width)], axis=1)
        return decoded(self.layers, h, steer, self.final(vector), real, condition)


def joint_offsets(moves: np.ndarray, features: np.ndarray) -> np.ndarray:
    """The adaptation that moves joints: delta_k = delta_p + (R_p - R_k) d_k for a handle k and its parent p, shape (B,
    N, K, 3).

    It is what `attach_joints` does to the translations when the joint of k is held d_k farther off. It rotates with the
    body and fades where nothing bends, so one d_k serves all poses.

    Args:
        moves: d, how far each joint is moved [m], shape (B, N, K, 3).
        features: Motion features, whose local rotations count, shape (B, N, 271).
    """
    local = features[..., ROOT_SIZE:].reshape(*features.shape[:2], -1, 9)
    still = np.broadcast_to(np.eye(3, dtype=features.dtype), (*features.shape[:2], 1, 3, 3))
    rotations = np.concatenate([still, matrix_from_6d(local[..., 3:])], axis=2)
    parents = list(HANDLE_PARENTS[1:])
    shifts = ((rotations[:, :, parents] - rotations[:, :, 1:]) @ moves[:, :, 1:, :, None])[..., 0]
    offsets = [np.zeros_like(shifts[:, :, 0])]
    for handle, parent in enumerate(parents, start=1):
        offsets.append(offsets[parent] + shifts[:, :, handle - 1])
    return np.stack(offsets, axis=2)


def capped_offsets(moves: np.ndarray, features: np.ndarray) -> np.ndarray:
    """`joint_offsets`, cut to what people allow."""
    if not isinstance(moves, np.ndarray):
        return brought(capped_offsets, moves, features)
    return capped(joint_offsets(moves, features), soft=False)


def load_denoiser(path: str | Path) -> Denoiser:
    """Read a denoiser, ready for sampling.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return _built(path, *load_checkpoint(path, KIND, half=True))


def load_denoiser_of_few_steps(path: str | Path, few: str | Path) -> Denoiser | None:
    """Read a denoiser with the changes of `bunraku train few-steps`; None where the changes are another denoiser's.
    Errors as of `load_denoiser`.
    """
    changes = load_few_steps(few)
    state, config = load_checkpoint(path, KIND, half=True)
    if not changes.fits(state):
        return None
    try:
        changed = changes.on(state)
    except ValueError as error:
        raise WeightsError(f"{few}: {error}; distil the denoiser again") from error
    return _built(path, changed, config, changes.visited)


def _built(
    path: str | Path, state: Mapping[str, np.ndarray], config: dict[str, object], visited: tuple[int, ...] = ()
) -> Denoiser:
    notes = config.pop("notes", None) or {}
    with fitting_config(path):
        weights = Weights(state)
        model = Denoiser(denoiser_config(config), weights, notes if isinstance(notes, dict) else {}, visited)
        weights.done()
    return model


def text_encoder_name(path: str | Path) -> str:
    """Name of the text encoder that a denoiser was trained with. Errors as of `load_denoiser`."""
    return str(read_config(Path(path), KIND).get("text_encoder", DenoiserConfig.text_encoder))
