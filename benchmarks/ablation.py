"""What each loss and each kind of variation of the Mesh Handle Predictor's training is worth.

    python benchmarks/ablation.py --cache data/characters [--epochs 4] [--every 3] [--only NAME ...] [--out
    runs/ablation]

Every row is a short training from the same random weights, with the same number of steps and one thing changed,
validated on the held-out characters as they are and in other rest poses. A run that was cut off goes on; rows that are
done are kept.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from bunraku.core.body.layout import HANDLE_MIRROR
from bunraku_lab.datasets.characters.build import load_characters, reference_characters
from bunraku_lab.datasets.characters.training_character import AugmentConfig, TrainingCharacter
from bunraku_lab.nn.graph import mesh_graph
from bunraku_lab.nn.handles import HandlePredictor
from bunraku_lab.training.handles import HandleTrainConfig, HandleTrainer, MeshAugmentation, validate_handles
from bunraku_lab.training.losses.handles import LossConfig

LOSS = LossConfig(smoothness=0.1)  # every loss that was ever tried is on
NONE = MeshAugmentation(slide_rate=0, coarse_rate=0, hole_rate=0, split_rate=0, noise=0, normal_noise=0)
VARIANTS: dict[str, dict[str, object]] = {
    "all": {"loss": LOSS},
    "the paper's three losses alone": {
        "loss": replace(LOSS, skinning=1.0, root=0.1, semantic=0.0, sparsity=0.0, mirror=0.0, smoothness=0.0)
    },
    "without skinning (Eq. 13)": {"loss": replace(LOSS, skinning=0.0)},
    "without root (Eq. 4)": {"loss": replace(LOSS, root=0.0)},
    "without pose (Eq. 14)": {"loss": replace(LOSS, pose=0.0)},
    "without sparsity": {"loss": replace(LOSS, sparsity=0.0)},
    "without mirror": {"loss": replace(LOSS, mirror=0.0)},
    "without smoothness": {"loss": replace(LOSS, smoothness=0.0)},
    "without other rest poses": {"loss": LOSS, "augment": AugmentConfig(rest_rate=0.0)},
    "without augmentation": {"loss": LOSS, "mesh_augmentation": NONE},
}
COLUMNS = (
    "held_accuracy",
    "held_purity",
    "held_root",
    "held_pose",
    "held_outside",
    "varied_accuracy",
    "varied_purity",
    "varied_pose",
    "sides",
    "rough",
)


@torch.no_grad()
def consistency(path: Path, held_out: list[TrainingCharacter]) -> dict[str, float]:
    """What the mirror and the smoothness loss are for: L1 difference between the weights of a mesh and those of its
    mirror image, and between those of neighbouring vertices, means over the held-out characters.
    """
    model = HandlePredictor.load(path).eval()
    sides, rough = [], []
    for character in held_out:
        graph = mesh_graph(
            character.vertices, character.normals, character.edges, character.areas, model.config.anchors
        )
        plain, mirrored = model(graph).weights, model(graph.mirrored()).weights[:, list(HANDLE_MIRROR)]
        first, second = torch.from_numpy(character.edges).T
        sides.append(float((plain - mirrored).abs().sum(1).mean()))
        rough.append(float((plain[first] - plain[second]).abs().sum(1).mean()))
    return {"sides": float(np.mean(sides)), "rough": float(np.mean(rough))}


def folder(name: str, args: argparse.Namespace) -> Path:
    """Where a variant is trained."""
    return Path(args.out) / name.replace(" ", "-").replace("'", "").replace("(", "").replace(")", "")


def run(name: str, args: argparse.Namespace) -> dict[str, float]:
    """Train one variant and validate it."""
    out = folder(name, args)
    config = HandleTrainConfig(
        cache=args.cache, out=out, minutes=0, epochs=args.epochs, bf16=args.bf16, **VARIANTS[name]
    )
    characters, held_out = load_characters(args.cache)
    characters = characters[:: args.every]
    trainer = HandleTrainer(config, characters, held_out, reference_characters(config.predictor.mesh_vertices))
    trainer.resume()
    out.mkdir(parents=True, exist_ok=True)
    while trainer.epoch < args.epochs:
        trainer.train_epoch()
        trainer.save({})
    found = validate_handles(trainer.average, held_out)
    varied = validate_handles(trainer.average, held_out, varied=True)
    return {f"held_{key}": value for key, value in found.items()} | {
        f"varied_{key}": value for key, value in varied.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder that `bunraku data characters` wrote")
    parser.add_argument("--out", type=Path, default=Path("runs/ablation"))
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--every", type=int, default=3, help="train on every n-th character")
    parser.add_argument(
        "--bf16", action="store_true", help="bfloat16 products, several times faster on processors that have them"
    )
    parser.add_argument("--only", nargs="*", choices=list(VARIANTS), help="these rows alone")
    args = parser.parse_args()
    torch.set_num_threads(1)
    path = args.out / "rows.json"
    rows: dict[str, dict[str, float]] = json.loads(path.read_text()) if path.is_file() else {}
    for name in args.only or VARIANTS:
        if name not in rows:
            rows[name] = run(name, args)
        if "sides" not in rows[name]:
            rows[name] |= consistency(folder(name, args) / "handles.safetensors", load_characters(args.cache)[1])
            path.write_text(json.dumps(rows, indent=1))
            print(name, {key: float(np.round(value, 4)) for key, value in rows[name].items()}, flush=True)
    print(f"| {args.epochs} epochs | " + " | ".join(COLUMNS) + " |\n" + "| --- " * (len(COLUMNS) + 1) + "|")
    for name, row in rows.items():
        print(f"| {name} | " + " | ".join(f"{100 * row[key]:.2f} %" for key in COLUMNS) + " |")


if __name__ == "__main__":
    main()
