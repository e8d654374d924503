"""How far a motion is from the one that torch would make: the same seeds, once with the networks as `bunraku` runs them
in numpy and once with the laboratory's definitions in torch in their place, from the handles to the chosen candidate:

    python benchmarks/torch_reference.py [--seconds 4] [-o outputs/torch_reference.json]

| row | meaning |
| --- | --- |
| mean, largest | distance of the vertices of both in all frames [mm] |
| handles | largest difference of a skinning weight |
| another | whether another candidate was chosen, as it may be where two are as good: then nothing else says anything |

The sentence encoder is numpy's in both, as torch has none here; a test holds it to the published one.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

import bunraku
from bunraku.anatomy.handles import predict
from bunraku.anatomy.handles.networks import HandlePrediction
from bunraku.anatomy.handles.networks import MeshGraph as OrderedGraph
from bunraku.anatomy.handles.predict import Predictor
from bunraku.core.nn.checkpoints import load_checkpoint, shipped_checkpoint
from bunraku.generation.denoiser import RetrievedExamples, load_few_steps
from bunraku.generation.networks import Networks
from bunraku.pipelines.animator import Animator
from bunraku.pipelines.requests import Request, Sampling
from bunraku_lab.nn.denoiser import RetrievedExamples as TensorExamples
from bunraku_lab.nn.denoiser import load_denoiser
from bunraku_lab.nn.graph import MeshGraph
from bunraku_lab.nn.handles import HandlePredictor
from bunraku_lab.nn.text import Extractor, load_extractor, tensors_of

PROMPTS = (
    "walks forward, then waves with the left hand",
    "jumps twice",
    "a person sits down and stands up again",
    "turns around and runs away",
)
CHARACTERS = ("person", "dancer", "dog", "mushroom", "robot", "dragon")


def tensor(value: np.ndarray | None) -> torch.Tensor | None:
    """An array as a tensor."""
    return None if value is None else torch.from_numpy(np.ascontiguousarray(value))


@dataclass(frozen=True)
class Told:
    """What a denoiser is told, by row, before torch makes a condition of it."""

    arrays: tuple[np.ndarray | None, ...]
    examples: RetrievedExamples | None

    def rows(self, rows: slice) -> Told:
        some = tuple(None if one is None else one[rows] for one in self.arrays)
        return Told(some, None if self.examples is None else self.examples.rows(np.arange(len(self.arrays[4]))[rows]))  # type: ignore[arg-type]


class TorchDenoiser:
    """Torch's, called as numpy's is; what it is asked for beside the calls is that one's."""

    def __init__(self, running: Any):
        self.running, path = running, shipped_checkpoint("diffusion")
        self.model = load_denoiser(path)
        if running.visited:
            changes = load_few_steps(shipped_checkpoint("few-steps"))
            state = changes.on(load_checkpoint(path, "diffusion")[0])
            self.model.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in state.items()})

    def __getattr__(self, name: str) -> Any:
        return getattr(self.running, name)

    def condition(self, *arrays: Any) -> Told:
        return Told(arrays[:6], arrays[6])

    def __call__(self, x: np.ndarray, step: int, lengths: np.ndarray, told: Told, adapts: bool = True) -> Any:
        shown = told.examples
        examples = None if shown is None else TensorExamples(*map(tensor, (shown.values, shown.lengths, shown.pooled)))  # type: ignore[arg-type]
        with torch.inference_mode():
            condition = self.model.condition(*map(tensor, told.arrays), examples)  # type: ignore[arg-type]
            steps = torch.full((len(x),), step)
            motion, offsets = self.model(tensor(x), steps, torch.from_numpy(np.array(lengths)), condition)
        return motion.numpy(), offsets.numpy() if adapts else None


class TorchExtractor:
    """Torch's ranker or critic, with autograd's gradient."""

    def __init__(self, running: Any, model: Extractor):
        self.running, self.model = running, model

    def __getattr__(self, name: str) -> Any:
        return getattr(self.running, name)

    def motion(self, features: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return np.asarray(self.model.motion(tensor(features.astype(np.float32)), tensor(np.array(lengths))))

    def cosine_gradient(self, features: np.ndarray, lengths: np.ndarray, goals: np.ndarray) -> np.ndarray:
        values = torch.from_numpy(features.astype(np.float32)).requires_grad_(True)
        vectors = torch.nn.functional.normalize(self.model.motion(values, torch.from_numpy(np.array(lengths))), dim=-1)
        (vectors * torch.from_numpy(goals.astype(np.float32))).sum().backward()
        assert values.grad is not None
        return values.grad.numpy()

    def text(self, batch: Any) -> np.ndarray:
        with torch.inference_mode():
            return np.asarray(self.model.text(tensors_of(batch)))


class TorchPredictor:
    """Torch's predictor of handles, for graphs in order of degree."""

    def __init__(self, running: Any):
        self.running, self.model = running, HandlePredictor.load(shipped_checkpoint("handles"))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.running, name)

    def __call__(self, graph: OrderedGraph) -> HandlePrediction:
        dense = (torch.from_numpy(one.toarray()) for one in (graph.spread, graph.gather))
        theirs = MeshGraph(
            torch.from_numpy(graph.inputs), torch.from_numpy(graph.areas),
            tuple(torch.from_numpy(np.asarray(rank, np.int64)) for rank in graph.ranks),
            torch.arange(len(graph.inputs)), *dense, torch.from_numpy(graph.anchors),
        )  # fmt: skip
        with torch.inference_mode():
            found = self.model(theirs)
        return HandlePrediction(found.weights.numpy(), found.features.numpy())


def torch_networks() -> Networks:
    """The networks that draw, in torch."""
    ours, theirs = Networks(), Networks()
    critic = load_extractor(shipped_checkpoint("critic"), kind="ranker")
    ranker = load_extractor(shipped_checkpoint("ranker"), kind="ranker")
    held = {
        "denoiser": TorchDenoiser(ours.denoiser), "few_steps": TorchDenoiser(ours.few_steps),
        "critic": TorchExtractor(ours.critic, critic), "ranker": TorchExtractor(ours.ranker, ranker),
    }  # fmt: skip
    vars(theirs).update(held)  # where a cached property keeps what it found
    return theirs


def main() -> None:
    """Make every sentence on every character twice and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    torch.set_num_threads(1)
    ours, theirs = Animator(), Animator(Predictor(), torch_networks())
    torch_predictor, rows = TorchPredictor(predict._load(None)), []
    print("| character | sentence | mean | largest | handles | another |\n| --- | --- | ---: | ---: | ---: | --- |")
    for name in CHARACTERS:
        character = bunraku.sample_character(name)
        for seed, prompt in enumerate(PROMPTS, start=1):
            request = Request(prompt, Sampling(args.seconds, seed, candidates=3))
            one = ours(character, request)
            numpy_model, predict._model = predict._model, lambda path, changed: torch_predictor  # type: ignore[assignment]
            other = theirs(character, request)
            predict._model = numpy_model
            away = 1e3 * np.linalg.norm(one.vertices() - other.vertices(), axis=-1)
            weights = float(np.abs(one.handles.weights - other.handles.weights).max())  # type: ignore[union-attr]
            row = {"mean": float(away.mean()), "largest": float(away.max()), "handles": weights}
            rows.append({"character": name, "prompt": prompt, **row})
            another = "yes" if row["mean"] > 10 else ""
            far = f"{row['mean']:.4f} | {row['largest']:.4f}"
            print(f"| {name} | {prompt} | {far} | {weights:.1e} | {another} |", flush=True)
    if args.output:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
