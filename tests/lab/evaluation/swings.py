"""Motions of one handle each, and an encoder of the sentences that name them."""

import numpy as np
import torch

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion
from bunraku.core.nn.layers import unit
from bunraku.language.encoders import TextBatch

PARTS = {
    "left_elbow": "waves", "right_knee": "kicks", "spine1": "bows", "head": "nods", "left_hip": "steps",
    "right_elbow": "points",
}  # fmt: skip


class WordEncoder:
    """A small text encoder: each word is a random vector of its own."""

    name, token_size, pooled_size = "words", 8, 8

    def encode(self, sentences):
        rows = [
            [
                torch.randn(8, generator=torch.Generator().manual_seed(sum(map(ord, word)))).numpy()
                for word in text.split()
            ]
            for text in sentences
        ]
        length = max(map(len, rows))
        tokens, mask = np.zeros((len(rows), length, 8), np.float32), np.zeros((len(rows), length), bool)
        for index, row in enumerate(rows):
            tokens[index, : len(row)], mask[index, : len(row)] = row, True
        return TextBatch(tokens, mask, unit(tokens.sum(1)))


def swing(part, frames=60, height=0.9):
    """A handle that turns to and fro about its z axis, the root standing still."""
    vectors = np.zeros((frames, HANDLE_COUNT, 3))
    vectors[:, HANDLE_NAMES.index(part), 2] = height * np.sin(np.arange(frames) / 3)
    still = np.zeros((frames, 3))
    return HandleMotion(
        np.zeros((frames, HANDLE_COUNT, 3)), matrix_from_axis_angle(vectors), still, matrix_from_axis_angle(still)
    )
