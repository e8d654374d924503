"""The settings of a training run of the denoiser."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from bunraku_lab.training.runs.settings import RunSettings

__all__ = ["SHIPPED", "TrainingConfig"]

SHIPPED = Path("shipped")
"""In place of a path: the weights that Bunraku brings."""


@dataclass(frozen=True, kw_only=True)
class TrainingConfig(RunSettings):
    """Settings of a training run.

    Args:
        data: Folder that `bunraku data motions` wrote, or the file that `bunraku data bundle` made of it.
        start: Weights to start a new run from, to go on with them on other data; "shipped" is the denoiser that Bunraku
            brings, with its sizes and units.
        rehearse: Share of people's rows that are captured examples which Bunraku brings, so that a network that goes on
            with few clips keeps what it knows.
        preset: "small" trains on a CPU, "paper" is TapMo's size.
        minutes: Stop after so many minutes of training, earlier sessions of the run included; None for no limit.
        steps: Stop after so many optimiser steps; None for no limit.
        learning_rate: Peak, after the warm-up.
        warmup: Steps of warm-up.
        decay: Share of the budget, at its end, over which the rate falls to a fiftieth.
        weight_decay: AdamW's.
        velocity_weight: Weight of the frame-difference term.
        contact_weight: Weight of the contact loss: feet that stand do not slide or lift.
        drop_text: Share of rows without their sentence, for classifier-free guidance.
        drop_mesh: Share of rows without their mesh feature.
        drop_tokens: Share of the text tokens that rows lack; the sentence's vector stays.
        drop_examples: Share of rows without the examples retrieved for them, where the network attends to examples.
        compose: Share of rows that join two clips, "a person walks and then waves".
        creatures: Share of rows that are creatures' clips, where the data have any.
        computed: Share of rows whose sentence is computed from the motion, where it says anything plain.
        borrowed: Share of people's rows that are given a creature's mesh, of those that do what no clip of that
            creature shows.
        events: Share of people's rows that are something plain to see in the numbers, such as a turn, cut out of a clip
            and described by them.
        balance: Power of the number of its clips by which an action is drawn: 1 as often as it is captured, 0 all
            actions alike.
        most_drawn: How many times as often as the median clip one is drawn at the most, so that the only one of its
            action is not learned by heart.
        ema: Decay of the averaged weights.
        mesh_bank: NPZ with `features` (C, 448), f_phi of many characters; None takes those of the bundle, where the
            data are one, else trains with the null mesh only.
        cross: Share of the people's motions that are given to any character of the banks, creatures too.
        character_bank: NPZ that `bunraku data character-bank` wrote, for the spring and the adversarial loss; None
            trains without them.
        characters: Rows a step that those losses look at.
        character_frames: Frames of each that they look at.
        spring_weight: nu_h of Eq. 9.
        adversarial_weight: nu_a of Eq. 9.
        sigma: Of the spring loss (Eq. 7).
        adaptation_mesh: Let the adaptation's linear layer see the mesh token beside the hidden state.
        examples: Captured examples that the network attends to, retrieved among `example_pack`; 0 trains without.
        example_pack: What `bunraku data examples` wrote; None takes the shipped examples.
        text_folder: Folder with CLIP, in place of the built-in text encoder.
        workers: Processes that draw rows ahead into a pool on the device; 0 draws each batch when it is due.
        pool: Rows in it, the newest. Each is learned from as often as the device is faster than the processes.
        device: "cuda", "cpu" or another of torch; None takes CUDA when it is there.
        bf16: Compute in bfloat16 where torch says it is safe and the device has it in hardware.
        save_every: Minutes between saved states.
    """

    data: Path = Path("runs/data/motions")
    out: Path = Path("runs/diffusion")
    start: Path | None = None
    rehearse: float = 0.0
    preset: str = "small"
    minutes: float | None = 60.0
    steps: int | None = None
    batch: int = 64
    learning_rate: float = 3e-4
    warmup: int = 300
    decay: float = 0.3
    weight_decay: float = 0.02
    velocity_weight: float = 2.0
    contact_weight: float = 0.02
    drop_text: float = 0.1
    drop_mesh: float = 0.2
    drop_tokens: float = 0.0
    drop_examples: float = 0.15
    compose: float = 0.12
    creatures: float = 0.25
    computed: float = 0.3
    borrowed: float = 0.1
    events: float = 0.15
    balance: float = 0.5
    most_drawn: float = math.inf
    ema: float = 0.999
    mesh_bank: Path | None = None
    cross: float = 0.1
    character_bank: Path | None = None
    characters: int = 8
    character_frames: int = 32
    spring_weight: float = 0.001
    adversarial_weight: float = 0.1
    sigma: float = 0.0
    adaptation_mesh: bool = False
    examples: int = 0
    example_pack: Path | None = None
    text_folder: Path | None = None
    workers: int = 0
    pool: int = 50_000
    device: str | None = None
    bf16: bool = True
    save_every: float = 5.0
    seed: int = 0
