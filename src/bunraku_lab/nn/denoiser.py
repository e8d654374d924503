"""The denoiser of Shape-aware Motion Diffusion (section 3.2 of TapMo): its layers, the network that predicts the clean
motion (Eq. 2), the noise of its training, and its files, whole or the adaptation's last layer alone.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from bunraku.core.body.layout import HANDLE_PARENTS
from bunraku.core.body.reference import LOOSE_ON_PEOPLE
from bunraku.core.geometry.rotations import matrix_from_6d
from bunraku.errors import WeightsError
from bunraku.generation import sampler
from bunraku.generation.denoiser import EXAMPLE_TOKENS, KIND, DenoiserConfig, denoiser_config
from bunraku.generation.features import ROOT_SIZE
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint


def capped_on_people(residual: Tensor) -> Tensor:
    """Residuals of people in torch, shape [..., 3]; differentiable."""
    length = residual.square().sum(-1, keepdim=True).add(1e-18).sqrt()
    return residual * (LOOSE_ON_PEOPLE / length).clamp(max=1)


def alphas_cumprod() -> Tensor:
    """Share of signal power left after each step, shape (1000,), float64, falling."""
    return torch.from_numpy(sampler.alphas_cumprod())


def add_noise(clean: Tensor, noise: Tensor, step: Tensor, curve: Tensor) -> Tensor:
    """x_t = sqrt(abar_t) x_0 + sqrt(1 - abar_t) noise, shapes (B, N, D) and (B,) for the step."""
    share = curve.to(clean.device)[step].view(-1, *[1] * (clean.ndim - 1))
    return share.sqrt().to(clean.dtype) * clean + (1 - share).sqrt().to(clean.dtype) * noise


Rotary = tuple[Tensor, Tensor]


@dataclass(frozen=True, eq=False)
class RetrievedExamples:
    """Captured motions that show what each sentence of a batch says.

    Args:
        values: Network units, zero behind an example's end, shape (B, R, N, D).
        lengths: Real frames, 0 where there is no example, shape (B, R).
        pooled: The vector of each example's own sentence, shape (B, R, P).
    """

    values: Tensor
    lengths: Tensor
    pooled: Tensor

    def rows(self, rows: Tensor) -> RetrievedExamples:
        """Some rows of the batch, in the order that is given."""
        return RetrievedExamples(self.values[rows], self.lengths[rows], self.pooled[rows])

    def to(self, device: torch.device | str) -> RetrievedExamples:
        """The same on a device."""
        return RetrievedExamples(self.values.to(device), self.lengths.to(device), self.pooled.to(device))


def rotary_positions(tokens: Tensor, size: int) -> Rotary:
    """Cosines and sines of rotary positions (Su et al. 2021) at these times, shape (T,) -> (T, size / 2) each."""
    rates = 1000.0 ** (-torch.arange(0, size, 2, device=tokens.device) / size)
    angle = tokens[:, None] * rates
    return angle.cos(), angle.sin()


def normal_noise(value: Tensor, deviation: float) -> Tensor:
    """The tensor, filled with normal noise; on the meta device it stays, since filling it loads torch's compiler."""
    return value if value.is_meta else nn.init.normal_(value, std=deviation)


def _rotate(value: Tensor, rotary: Rotary) -> Tensor:
    first, second = value.chunk(2, dim=-1)
    cos, sin = rotary[0].to(value.dtype), rotary[1].to(value.dtype)
    return torch.cat([first * cos - second * sin, first * sin + second * cos], dim=-1)


def _heads(value: Tensor, heads: int, parts: int = 1) -> tuple[Tensor, ...]:
    """Queries, keys or values of each head, shape (B, H, T, d/H), from as many side by side, shape (B, T, parts d)."""
    return value.unflatten(-1, (parts, heads, -1)).permute(2, 0, 3, 1, 4).unbind()


def _attend(query: Tensor, key: Tensor, value: Tensor, mask: Tensor | None) -> Tensor:
    """Attention, shapes (B, H, T, d/H). On a CPU torch's fused backward takes most of a training step (1.7 s against
    0.6 s for 64 clips with plain products), so training there writes the products out.
    """
    if not (torch.is_grad_enabled() and query.device.type == "cpu"):
        return F.scaled_dot_product_attention(query, key, value, attn_mask=mask)
    scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
    if mask is not None:
        scores = scores.masked_fill(~mask, -1e4)
    return torch.softmax(scores, dim=-1, dtype=scores.dtype) @ value


def _without_effect(linear: nn.Linear) -> nn.Linear:
    nn.init.zeros_(linear.weight)
    nn.init.zeros_(linear.bias)
    return linear


class _ExampleAttention(nn.Module):
    """Motion tokens attend to tokens of examples: keys say what an example is called, values what it shows."""

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.query, self.key, self.value = (nn.Linear(width, width) for _ in range(3))
        self.out = _without_effect(nn.Linear(width, width))

    def forward(self, x: Tensor, rotary: Rotary, examples: tuple[Tensor, ...]) -> Tensor:
        """x (B, T, d); keys, values (B, M, d) and mask (B, 1, 1, M) of the examples, and their rotary positions."""
        keys, values, mask, cos, sin = examples
        query, key = _heads(self.query(x), self.heads)[0], _heads(self.key(keys), self.heads)[0]
        value = _heads(self.value(values), self.heads)[0]
        mixed = _attend(_rotate(query, rotary), _rotate(key, (cos, sin)), value, mask)
        out: Tensor = self.out(mixed.transpose(1, 2).flatten(2))
        return out


class DecoderLayer(nn.Module):
    """Self-attention, cross-attention, feed-forward; each behind an adaptive norm and a gate.

    Args:
        config: Sizes.
        examples: Whether this layer attends to examples.
    """

    def __init__(self, config: DenoiserConfig, examples: bool = False):
        super().__init__()
        width = config.width
        self.heads = config.heads
        self.offset = nn.Parameter(torch.zeros(9, width))
        self.self_in, self.self_out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.cross_query, self.cross_memory, self.cross_out = (
            nn.Linear(width, width), nn.Linear(width, 2 * width), nn.Linear(width, width),
        )  # fmt: skip
        self.wide, self.narrow = nn.Linear(width, config.feedforward), nn.Linear(config.feedforward, width)
        self.offset_more = nn.Parameter(torch.zeros(3, width)) if config.examples else None
        self.examples = _ExampleAttention(width, config.heads) if examples else None

    def forward(
        self, x: Tensor, memory: Tensor, steer: Tensor, rotary: Rotary, mask: Tensor | None, memory_mask: Tensor | None,
        examples: tuple[Tensor, ...] = (),
    ) -> Tensor:  # fmt: skip
        """x (B, T, d), memory (B, M, d), steer (B, 9, or 12 with examples, d), masks (B, 1, 1, T) and (B, 1, 1,
        M), True where real.
        """
        own = (steer[:, :9] + self.offset).to(x.dtype).unsqueeze(2).unbind(1)
        more: tuple[Tensor, ...] = ()
        if self.offset_more is not None:
            more = (steer[:, 9:] + self.offset_more).to(x.dtype).unsqueeze(2).unbind(1)

        def norm(parts: tuple[Tensor, ...], index: int) -> Tensor:
            return F.layer_norm(x, x.shape[-1:]) * (1 + parts[index]) + parts[index + 1]

        query, key, value = _heads(self.self_in(norm(own, 0)), self.heads, 3)
        mixed = _attend(_rotate(query, rotary), _rotate(key, rotary), value, mask)
        x = x + own[2] * self.self_out(mixed.transpose(1, 2).flatten(2))
        (query,) = _heads(self.cross_query(norm(own, 3)), self.heads)
        key, value = _heads(self.cross_memory(memory), self.heads, 2)
        mixed = _attend(query, key, value, memory_mask)
        x = x + own[5] * self.cross_out(mixed.transpose(1, 2).flatten(2))
        if self.examples is not None and examples:
            x = x + more[2] * self.examples(norm(more, 0), rotary, examples)
        return x + own[8] * self.narrow(F.gelu(self.wide(norm(own, 6))))


def joint_offsets(moves: Tensor, features: Tensor) -> Tensor:
    """The adaptation that moves joints: delta_k = delta_p + (R_p - R_k) d_k for handle k of parent p, (B, N, K, 3).

    It is what `attach_joints` does to the translations when the joint of k is held d_k farther off. It turns with the
    body and fades where nothing bends, so one d_k serves all poses.

    Args:
        moves: d, how far each joint is moved [m], shape (B, N, K, 3).
        features: Motion features, whose local rotations count, shape (B, N, 271).
    """
    local = features[..., ROOT_SIZE:].unflatten(-1, (moves.shape[2] - 1, 9))
    still = torch.eye(3, device=moves.device).expand(*moves.shape[:2], 1, 3, 3)
    rotations = torch.cat([still, matrix_from_6d(local[..., 3:])], dim=2)
    parents = list(HANDLE_PARENTS[1:])
    own = ((rotations[:, :, parents] - rotations[:, :, 1:]) @ moves[:, :, 1:, :, None].to(rotations.dtype)).squeeze(-1)
    offsets = [torch.zeros_like(own[:, :, 0])]
    for handle, parent in enumerate(parents, start=1):
        offsets.append(offsets[parent] + own[:, :, handle - 1])
    return torch.stack(offsets, dim=2)


class Denoiser(nn.Module):
    """Predicts x0 and the adaptation from a noisy motion, the step, a sentence and a mesh feature (Eq. 2).

    Motion enters and leaves in network units (`FeatureStatistics`), which travel with the weights as buffers.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: DenoiserConfig):
        super().__init__()
        self.config = config
        self.notes: dict[str, Any] = {}  # of the checkpoint it came from
        width, patch = config.width, config.frames_per_token
        self.motion_in = nn.Linear(config.features * patch, width)
        self.text_in = nn.Linear(config.text_size, width)
        self.mesh_in = nn.Linear(config.mesh_features, width)
        self.pooled_in = nn.Linear(config.pooled_size, width)
        self.null_text = nn.Parameter(normal_noise(torch.empty(width), 0.02))
        self.null_pooled = nn.Parameter(normal_noise(torch.empty(width), 0.02))
        self.null_mesh = nn.Parameter(normal_noise(torch.empty(width), 0.02))
        self.step_in = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.steer = nn.Linear(width, 9 * width)
        # of two neighbouring layers the second looks at retrieved examples
        self.layers = nn.ModuleList(
            DecoderLayer(config, examples=config.examples > 0 and index % 2 == 1) for index in range(config.layers)
        )
        self.final = nn.Linear(width, 2 * width)
        self.motion_out = nn.Linear(width, config.features * patch)
        self.adaptation_out = nn.Linear(width * (2 if config.adaptation_mesh else 1), config.handles * 3 * patch)
        self.register_buffer("mean", torch.zeros(config.features))
        self.register_buffer("std", torch.ones(config.features))
        for layer in self.layers:
            for name in ("self_out", "cross_out", "narrow"):
                linear = getattr(layer, name)
                normal_noise(linear.weight, 0.02 / math.sqrt(2 * config.layers))
                nn.init.zeros_(linear.bias)
        _open_gates(self.steer)
        self.steer_more = nn.Linear(width, 3 * width) if config.examples else None
        if self.steer_more is not None:
            _open_gates(self.steer_more)
        if config.examples:
            self.example_in = nn.Linear(config.features * patch * EXAMPLE_TOKENS, width)
            self.example_sentence_in = nn.Linear(config.pooled_size, width)
            self.null_example = nn.Parameter(normal_noise(torch.empty(width), 0.02))
        for linear in (self.final, self.adaptation_out):
            nn.init.zeros_(linear.weight)
            nn.init.zeros_(linear.bias)
        normal_noise(self.motion_out.weight, 0.02)
        nn.init.zeros_(self.motion_out.bias)

    @property
    def knows_meshes(self) -> bool:
        """Whether training saw mesh features; else the mesh token must stay the learned null token."""
        return bool(self.notes.get("characters"))

    def condition(
        self, text: Tensor | None, text_mask: Tensor | None, pooled: Tensor | None, mesh: Tensor | None,
        keep_text: Tensor, keep_mesh: Tensor, examples: RetrievedExamples | None = None,
    ) -> tuple[Tensor, ...]:  # fmt: skip
        """Memory tokens and the pooled vector, which do not depend on the step.

        Args:
            text: Text tokens, shape (B, L, C); None for none.
            text_mask: True where real, shape (B, L).
            pooled: Sentence vectors, shape (B, P).
            mesh: Mesh features f_phi, shape (B, 448); None where no bank of characters is at hand.
            keep_text: False where the sentence is dropped for classifier-free guidance, shape (B,).
            keep_mesh: False where the mesh feature is unknown, shape (B,).
            examples: Captured examples of the sentences; they are dropped with them. None for none.

        Returns:
            Memory (B, 1 + 1 + L, d), its mask (B, 1, 1, 2 + L), pooled (B, d). Token 0 is the mesh, token 1 the learned
            null sentence, which stands only where the sentence is dropped. A network that attends to examples adds
            their keys and values, (B, 1 + M, d), and their mask (B, 1, 1, 1 + M).
        """
        batch, device = len(keep_text), keep_text.device
        null_mesh = self.null_mesh.expand(batch, -1)
        token = (
            null_mesh
            if mesh is None
            else torch.where(keep_mesh[:, None], self.mesh_in(mesh).to(null_mesh.dtype), null_mesh)
        )
        memory = [token[:, None], self.null_text.expand(batch, 1, -1)]
        mask = [torch.ones(batch, 1, dtype=torch.bool, device=device), ~keep_text[:, None]]
        sentence = self.null_pooled.expand(batch, -1)
        if text is not None and text_mask is not None and pooled is not None:
            memory.append(self.text_in(text))
            mask.append(text_mask & keep_text[:, None])
            scaled = self.pooled_in(pooled * math.sqrt(self.config.pooled_size))
            sentence = torch.where(keep_text[:, None], scaled.to(sentence.dtype), sentence)
        condition = (
            torch.cat([part.to(memory[-1].dtype) for part in memory], dim=1),
            torch.cat(mask, dim=1)[:, None, None],
            sentence,
        )
        return condition if not self.config.examples else condition + self._example_tokens(examples, keep_text)

    def _example_tokens(self, examples: RetrievedExamples | None, keep: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Keys, values and mask of the examples' tokens; token 0 is the learned null example, which is always there."""
        null = self.null_example.expand(len(keep), 1, -1)
        always = torch.ones(len(keep), 1, dtype=torch.bool, device=keep.device)
        if examples is None:
            return null, null, always[:, None, None]
        size = self.config.frames_per_token * EXAMPLE_TOKENS
        tokens = -(-examples.values.shape[2] // size)
        frames = F.pad(examples.values, (0, 0, 0, tokens * size - examples.values.shape[2]))
        real = torch.arange(tokens * size, device=keep.device) < examples.lengths[..., None]
        values = self.example_in((frames * real[..., None].to(frames.dtype)).unflatten(2, (tokens, size)).flatten(3))
        sentence = self.example_sentence_in(examples.pooled * math.sqrt(self.config.pooled_size))
        keys = values + sentence[:, :, None].to(values.dtype)
        mask = real.unflatten(2, (tokens, size)).any(-1).flatten(1) & keep[:, None]
        null = null.to(values.dtype)
        return (
            torch.cat([null, keys.flatten(1, 2)], dim=1),
            torch.cat([null, values.flatten(1, 2)], dim=1),
            torch.cat([always, mask], dim=1)[:, None, None],
        )

    def _example_rotary(self, tokens: int, size: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """Rotary positions of the examples' tokens, each example from its own start; the null example stands there."""
        own = EXAMPLE_TOKENS * torch.arange((tokens - 1) // self.config.examples, device=device)
        return rotary_positions(torch.cat([own.new_zeros(1), own.repeat(self.config.examples)])[:tokens], size)

    def forward(self, x: Tensor, step: Tensor, lengths: Tensor, condition: tuple[Tensor, ...]) -> tuple[Tensor, Tensor]:
        """Clean motion and adaptation [TapMo 2].

        Args:
            x: Noisy motion in network units, shape (B, N, D).
            step: Diffusion step in 0..999, shape (B,).
            lengths: Frames that are real in each row, shape (B,).
            condition: What `condition` returned.

        Returns:
            x0 (B, N, D) in network units and the adaptation of local translations (B, N, K, 3) [m].
        """
        batch, frames, _ = x.shape
        h = self.hidden(x, step, lengths, condition)
        motion = self.motion_out(h).reshape(batch, -1, self.config.features)[:, :frames]
        said = self.adaptation_out(self.adaptation_input(h, condition)).reshape(batch, -1, self.config.handles, 3)[
            :, :frames
        ]
        if self.config.adaptation_frame == "joints":
            said = capped_on_people(joint_offsets(said, motion.detach().float() * self.std + self.mean))
        return motion, said

    def adaptation_input(self, hidden: Tensor, condition: tuple[Tensor, ...]) -> Tensor:
        """What the adaptation's layer sees: last hidden states (B, T, d), with the mesh token if the config says so."""
        if not self.config.adaptation_mesh:
            return hidden
        return torch.cat([hidden, condition[0][:, :1].to(hidden.dtype).expand(-1, hidden.shape[1], -1)], dim=-1)

    def hidden(self, x: Tensor, step: Tensor, lengths: Tensor, condition: tuple[Tensor, ...]) -> Tensor:
        """The last hidden states, which both heads read, shape (B, T, d) for T tokens; arguments as in `forward`."""
        batch, frames, _ = x.shape
        patch = self.config.frames_per_token
        tokens = -(-frames // patch)
        real = torch.arange(tokens * patch, device=x.device) < lengths[:, None]
        x = F.pad(x, (0, 0, 0, tokens * patch - frames)) * real[..., None].to(x.dtype)
        mask = real.view(batch, tokens, patch).any(-1)[:, None, None] if bool((lengths < frames).any()) else None
        memory, memory_mask, sentence, *found = condition
        half = self.config.width // 2
        rates = torch.exp(-math.log(10_000.0) * torch.arange(half, device=x.device) / half)
        angle = step[:, None].float() * rates
        vector = self.step_in(torch.cat([angle.cos(), angle.sin()], dim=-1)) + sentence
        vector = F.silu(vector)
        steer = self.steer(vector).unflatten(-1, (9, -1))
        if self.steer_more is not None:
            steer = torch.cat([steer, self.steer_more(vector).unflatten(-1, (-1, self.config.width))], dim=1)
        h = self.motion_in(x.reshape(batch, tokens, patch * self.config.features))
        size = self.config.width // self.config.heads
        rotary = rotary_positions(torch.arange(tokens, device=x.device), size)
        if found:
            found += self._example_rotary(found[0].shape[1], size, x.device)
        for layer in self.layers:
            h = layer(h, memory, steer, rotary, mask, memory_mask, tuple(found))
        scale, shift = self.final(vector)[:, None].chunk(2, dim=-1)
        return F.layer_norm(h, h.shape[-1:]) * (1 + scale) + shift


@torch.no_grad()
def _open_gates(steer: nn.Linear) -> None:
    """Scales and shifts start near zero and gates open: the residual branches themselves start small."""
    steer.weight.mul_(0.1)
    steer.bias.zero_()
    steer.bias.view(-1, 3, steer.in_features)[:, 2] = 1


def save_denoiser(
    path: str | Path, model: Denoiser, notes: Mapping[str, object] | None = None, half: bool = True
) -> Path:
    """Write a denoiser with its config; `notes` (data, steps, time) go into the config's "notes"."""
    return save_checkpoint(path, model.state_dict(), asdict(model.config) | {"notes": notes or {}}, KIND, half=half)


def load_denoiser(path: str | Path, device: str | torch.device = "cpu") -> Denoiser:
    """Read a denoiser, ready for sampling.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its config and weights disagree.
    """
    state, config = load_checkpoint(path, KIND)
    notes = config.pop("notes", None)
    try:
        built = denoiser_config(config)
        with torch.device("meta"):
            model = Denoiser(built)
        model.load_state_dict(state, assign=True)
        model.notes = dict(notes or {})
    except Exception as error:
        raise WeightsError(
            f"{path}: the config and the weights of this denoiser disagree ({str(error).splitlines()[0]}); train it "
            "again"
        ) from error
    return model.to(device).eval().requires_grad_(False)


ADAPTER_KIND = "adaptation"
LAYER = "adaptation_out."


def frozen_digest(model: Denoiser) -> str:
    """What tells the weights of a denoiser but for its adaptation's last layer from others."""
    found = hashlib.sha256()
    for name, value in sorted(model.state_dict().items()):
        if not name.startswith(LAYER):
            found.update(name.encode() + value.detach().cpu().half().contiguous().numpy().tobytes())
    return found.hexdigest()


def save_adapter(path: str | Path, model: Denoiser, notes: Mapping[str, object]) -> Path:
    """Write the last layer of a denoiser's adaptation, and which denoiser it is of."""
    layer = {name: value for name, value in model.state_dict().items() if name.startswith(LAYER)}
    shape = {"adaptation_mesh": model.config.adaptation_mesh, "adaptation_frame": model.config.adaptation_frame}
    return save_checkpoint(
        path, layer, {**shape, "of": frozen_digest(model), "notes": dict(notes)}, ADAPTER_KIND, half=True
    )


def adapted_denoiser(adapter: str | Path, denoiser: str | Path, out: str | Path) -> Path:
    """Write a denoiser with the adaptation of a file.

    Args:
        adapter: What `save_adapter` wrote.
        denoiser: The weights that it was trained on.
        out: Where to write.

    Raises:
        WeightsError: A file is missing or damaged, or the adaptation belongs to other weights.
    """
    layer, said = load_checkpoint(adapter, ADAPTER_KIND)
    model = load_denoiser(denoiser)
    if said.get("of") != frozen_digest(model):
        raise WeightsError(
            f"{adapter}: this adaptation was trained on other weights than {denoiser}; train it on them with `bunraku "
            "train adaptation`"
        )
    shape = {name: said[name] for name in ("adaptation_mesh", "adaptation_frame")}
    built = Denoiser(replace(model.config, **shape))
    try:
        built.load_state_dict({**model.state_dict(), **{name: torch.as_tensor(value) for name, value in layer.items()}})
    except RuntimeError as error:
        raise WeightsError(f"{adapter}: its layer does not fit {denoiser}; train it again") from error
    return save_denoiser(out, built, {**model.notes, "adaptation": said.get("notes", {})})
