"""The denoiser of Shape-aware Motion Diffusion (section 3.2 of TapMo): its layers, the network that predicts the clean
motion (Eq. 2), the noise of its training, and its files, whole or the adaptation's last layer alone.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from bunraku.core.body.layout import HANDLE_PARENTS
from bunraku.core.body.reference import LOOSE_ON_PEOPLE
from bunraku.core.geometry.rotations import matrix_from_6d
from bunraku.core.nn.layers import Condition, Weights
from bunraku.errors import WeightsError
from bunraku.generation import denoiser as runtime
from bunraku.generation import sampler
from bunraku.generation.denoiser import KIND, DenoiserConfig, denoiser_config
from bunraku.generation.features import ROOT_SIZE
from bunraku_lab.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku_lab.nn.differentiable import OPERATIONS, Array, Trainable, arrays_of


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


def normal_noise(value: Tensor, deviation: float) -> Tensor:
    """The tensor, filled with normal noise; on the meta device it stays, since filling it loads torch's compiler."""
    return value if value.is_meta else nn.init.normal_(value, std=deviation)


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


def _array(value: Tensor | None) -> Any:
    return None if value is None else Array(value)


class Denoiser(Trainable):
    """`bunraku.generation.denoiser.Denoiser` as it learns (Eq. 2): tensors where that has arrays, and its own step for
    each row of a batch.
    """

    kind, shape, network = KIND, DenoiserConfig, runtime.Denoiser
    fixed = frozenset({"mean", "std"})
    mean: Tensor
    std: Tensor

    def __init__(self, config: DenoiserConfig):
        super().__init__(config)
        self.notes: dict[str, Any] = {}  # of the checkpoint it came from

    def begin(self) -> None:
        """Branches begin small and gates open, heads and the attention to examples at 0."""
        nn.init.ones_(self.std)
        small = {"motion_out": 0.02}
        small |= dict.fromkeys(("self_out", "cross_out", "narrow"), 0.02 / math.sqrt(2 * self.config.layers))
        for name, value in self.named_parameters():
            *_, layer, last = ("", *name.split("."))
            if name.startswith("null_"):
                normal_noise(value, 0.02)
            elif layer in small and last == "weight":
                normal_noise(value, small[layer])
            elif layer in small or layer in ("final", "adaptation_out") or ".examples.out." in name:
                nn.init.zeros_(value)
            elif layer in ("steer", "steer_more") and last == "weight":
                value.mul_(0.1)
            elif layer in ("steer", "steer_more"):
                value.zero_().view(-1, 3, self.config.width)[:, 2] = 1

    def running(self) -> runtime.Denoiser:
        """As `Trainable.running`, with the notes."""
        return runtime.Denoiser(self.config, Weights(arrays_of(self)), dict(self.notes))

    @property
    def knows_meshes(self) -> bool:
        """Whether training saw mesh features; else the mesh token must stay the learned null token."""
        return bool(self.notes.get("characters"))

    def condition(
        self, text: Tensor | None, text_mask: Tensor | None, pooled: Tensor | None, mesh: Tensor | None,
        keep_text: Tensor, keep_mesh: Tensor, examples: RetrievedExamples | None = None,
    ) -> Condition:  # fmt: skip
        """What the layers read beside the motion, as `Array`s; arguments as of the runtime's."""
        shown = None
        if examples is not None:
            shown = runtime.RetrievedExamples(*map(_array, (examples.values, examples.lengths, examples.pooled)))
        parts = map(_array, (text, text_mask, pooled, mesh, keep_text, keep_mesh))
        return cast(Condition, self.learning().condition(*parts, shown))

    def forward(self, x: Tensor, step: Tensor, lengths: Tensor, condition: Condition) -> tuple[Tensor, Tensor]:
        """Clean motion and adaptation [TapMo 2].

        Args:
            x: Noisy motion in network units, shape (B, N, D).
            step: Diffusion step in 0..999, shape (B,).
            lengths: Frames that are real in each row, shape (B,).
            condition: What `condition` returned.

        Returns:
            x0 (B, N, D) in network units and the adaptation of local translations (B, N, K, 3) [m].
        """
        motion, offsets = self.learning()(*map(_array, (x, step.float(), lengths)), condition)
        return motion.tensor, offsets.tensor

    def hidden(self, x: Tensor, step: Tensor, lengths: Tensor, condition: Condition) -> Tensor:
        """The last hidden states, which both heads read, shape (B, T, d) for T tokens; arguments as in `forward`."""
        return cast(Tensor, self.learning().hidden(*map(_array, (x, step.float(), lengths)), condition).tensor)


OPERATIONS[runtime.capped_offsets] = lambda moves, features: capped_on_people(
    joint_offsets(moves, features.detach().float())
)


def running_examples(found: RetrievedExamples) -> runtime.RetrievedExamples:
    """Captured examples as arrays."""
    return runtime.RetrievedExamples(*(part.cpu().numpy() for part in (found.values, found.lengths, found.pooled)))


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
