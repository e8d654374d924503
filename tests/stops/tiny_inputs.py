"""Inputs with which commands that may run for long take seconds."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

ACTIONS = {"walk": "a person walks forward", "dance": "a person dances", "kick": "a person kicks"}


def make_clips(folder: Path) -> None:
    """Two generated clips, one.npz and two.npz."""
    from bunraku import generate

    for name, line in (("one", "a person walks"), ("two", "a person waves")):
        generate(line, seconds=1, candidates=1).save(folder / f"{name}.npz")


def make_characters(folder: Path) -> None:
    """A folder of two rigged characters."""
    from bunraku.io import save_character
    from bunraku_lab.synthetic.samples import make_sample

    (folder / "characters").mkdir()
    for name in ("person", "dancer"):
        save_character(make_sample(name, 0.5, rigged=True), folder / "characters" / f"{name}.glb", rig=True)


def make_motions(folder: Path) -> None:
    """Clips as `bunraku data motions` writes them, to train on and to validate with."""
    from bunraku_lab.datasets.motions.clips import write_clip, write_index
    from bunraku_lab.evaluation.transfer.stock_motions import stock_motion

    out, index = folder / "motions", {}
    out.mkdir()
    for kind, text in ACTIONS.items():
        for number, split in enumerate(("train", "train", "val")):
            name = f"{kind}_{number}"
            motion = stock_motion(kind, 4.2 + 0.5 * number, 20.0)
            write_clip(out / f"{name}.npz", motion)
            stretch = {"start": 0, "stop": len(motion), "texts": [text]}
            index[name] = {"texts": [text], "split": split, "frames": len(motion), "stretches": [stretch],
                           "licence": "CC0"}  # fmt: skip
    write_index(out, index)


def make_archive(folder: Path) -> None:
    """A motion archive as `bunraku data motions` reads it: bodies that bend, in its packed form."""
    from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
    from bunraku.body.reference import reference_body

    body, random, lengths = reference_body(), np.random.default_rng(0), [30, 24, 40, 36]
    planes = []
    for frames in lengths:
        turns = np.sin(np.linspace(0, 3, frames))[:, None, None] * random.normal(0, 0.2, (1, JOINT_COUNT, 3))
        half = np.linalg.norm(turns, axis=-1, keepdims=True) / 2
        quaternions = np.concatenate([np.cos(half), turns * np.sinc(half / np.pi) / 2], axis=-1)
        whole = np.round(quaternions.reshape(frames, -1) * 8192).astype(np.int32)
        deltas = np.diff(whole, axis=0, prepend=0).astype("<i2")
        planes.append(np.ascontiguousarray(deltas.T)[..., None].view(np.uint8).transpose(2, 0, 1))
    out, names = folder / "archive", [f"cmu_{10 + number}_01" for number in range(len(lengths))]
    out.mkdir()
    np.savez(
        out / "motions.npz", dq=np.concatenate(planes, axis=2),
        root=(np.zeros((sum(lengths), 3)) + [0, body.joints[0, 1], 0]).astype(np.float32),
        offsets=np.tile(body.skeleton.offsets, (len(lengths), 1, 1)), rest=body.joints, off=np.cumsum([0, *lengths]),
        names=np.array(names), joints=np.array(JOINT_NAMES), parents=np.array(JOINT_PARENTS),
    )  # fmt: skip
    facts = {"texts": ["a person bends"], "source": "here", "licence": "CC0", "flags": []}
    (out / "motions.json").write_text(json.dumps({"fps": 20, "clips": dict.fromkeys(names, facts)}))


def make_weights(folder: Path) -> None:
    """The shipped denoiser, for what learns on top of it."""
    from bunraku.nn.checkpoints import shipped_checkpoint

    (folder / "weights").mkdir()
    shutil.copy(shipped_checkpoint("diffusion"), folder / "weights" / "diffusion.safetensors")


def make_pairs(folder: Path) -> None:
    """Sentences in two languages, the same made-up words in each of five files."""
    (folder / "pairs").mkdir()
    lines = [f"{name} danced in the room {number}.\tdie wup {name} {number}" for name in "AB" for number in range(12)]
    lines += [f"{name} likes tea {number}.\tdie tok {name} {number}" for name in "AB" for number in range(12)]
    for name in ("deu", "fra", "spa", "jpn", "cmn"):
        (folder / "pairs" / f"{name}.txt").write_text("\n".join(lines) + "\n")


MADE: dict[str, Callable[[Path], None]] = {
    "clips": make_clips, "characters": make_characters, "motions": make_motions, "archive": make_archive,
    "weights": make_weights, "pairs": make_pairs, "cache": lambda folder: None, "apparel": lambda folder: None,
    "bank": lambda folder: None,
}  # fmt: skip
"""What commands need, by name; the last ones are made of the others by commands."""
