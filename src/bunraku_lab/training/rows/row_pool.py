"""Rows that are kept on the device and drawn more than once, each time with other noise.

A device learns from a row in a hundredth of the time in which a processor draws one.
"""

from __future__ import annotations

import torch
from torch import Tensor

from bunraku.language.encoders import TEXT_LENGTH
from bunraku_lab.nn.diffusion.denoiser_layers import RetrievedExamples
from bunraku_lab.nn.text import TextBatch
from bunraku_lab.training.rows.drawn_rows import DrawnRows
from bunraku_lab.training.rows.mesh_bank import MeshBank
from bunraku_lab.training.rows.row_workers import MadeRows, RowWorkers
from bunraku_lab.training.runs.ahead import Ahead

__all__ = ["FedPool", "RowPool"]


class RowPool:
    """Rows on a device, the newest `size` of those that were added.

    Args:
        size: Rows that are kept.
        frames: Longest row.
        device: Where.
        meshes: The bank that rows' meshes are numbered in; None for the null mesh only.
    """

    def __init__(self, size: int, frames: int, device: torch.device, meshes: MeshBank | None = None):
        self.size, self.frames, self.device = size, frames, device
        self.meshes = None if meshes is None else meshes.features.to(device)
        self.added = 0
        self._arrays: dict[str, Tensor] = {}
        self._places: dict[int, int] = {}
        self._examples: Tensor | None = None
        self._example_lengths = torch.zeros(0, dtype=torch.long, device=device)
        self._example_vectors: Tensor | None = None

    def __len__(self) -> int:
        return min(self.added, self.size)

    def add(self, rows: MadeRows) -> None:
        """Keep rows, in the place of the oldest."""
        for number, (features, vector) in rows.examples.items():
            if number not in self._places:
                self._add_example(number, torch.from_numpy(features), torch.from_numpy(vector))
        count = len(rows.lengths)
        places = (torch.arange(self.added, self.added + count) % self.size).to(self.device)
        whole = {
            "values": (torch.from_numpy(rows.values), self.frames),
            "tokens": (torch.from_numpy(rows.tokens), TEXT_LENGTH),
        }
        for name, (part, longest) in whole.items():
            kept = self._kept(name, (longest, part.shape[2]), torch.float16)
            kept[places] = 0
            kept[places, : part.shape[1]] = part.to(self.device)
        for name in ("lengths", "text_lengths", "mesh"):
            self._kept(name, (), torch.long)[places] = torch.from_numpy(getattr(rows, name)).long().to(self.device)
        self._kept("person", (), torch.bool)[places] = torch.from_numpy(rows.person).to(self.device)
        pooled = torch.from_numpy(rows.pooled)
        self._kept("pooled", (pooled.shape[1],), torch.float32)[places] = pooled.to(self.device)
        for name in ("found", "nearest"):
            numbers = getattr(rows, name)
            at = torch.tensor([[self._places[int(number)] for number in row] for row in numbers], dtype=torch.long)
            self._kept(name, (numbers.shape[1],), torch.long)[places] = at.view(count, -1).to(self.device)
        self.added += count

    def _kept(self, name: str, shape: tuple[int, ...], kind: torch.dtype) -> Tensor:
        if name not in self._arrays:
            self._arrays[name] = torch.zeros((self.size, *shape), dtype=kind, device=self.device)
        return self._arrays[name]

    def _add_example(self, number: int, features: Tensor, vector: Tensor) -> None:
        place = len(self._places)
        if self._examples is None or self._example_vectors is None or place == len(self._examples):
            room = max(256, 2 * place)
            values = torch.zeros(room, self.frames, features.shape[1], dtype=torch.float16, device=self.device)
            lengths = torch.zeros(room, dtype=torch.long, device=self.device)
            vectors = torch.zeros(room, len(vector), device=self.device)
            if self._examples is not None and self._example_vectors is not None:
                values[:place], lengths[:place] = self._examples, self._example_lengths
                vectors[:place] = self._example_vectors
            self._examples, self._example_lengths, self._example_vectors = values, lengths, vectors
        self._examples[place, : len(features)] = features.to(self.device)
        self._example_lengths[place] = len(features)
        self._example_vectors[place] = vector.to(self.device)
        self._places[number] = place

    def draw(self, size: int, random: torch.Generator, nearest: bool = False) -> DrawnRows:
        """Some of the rows.

        Args:
            size: How many.
            random: Draws them, on the pool's device.
            nearest: With the examples that who animates finds, also those of the row's own clip.
        """
        return self.rows(torch.randint(len(self), (size,), generator=random, device=self.device), nearest)

    def rows(self, rows: Tensor, nearest: bool = False) -> DrawnRows:
        """Those in some places of the pool (B,); see `draw`."""
        arrays = self._arrays
        tokens, count = arrays["tokens"][rows].float(), arrays["text_lengths"][rows]
        mask = torch.arange(TEXT_LENGTH, device=self.device) < count[:, None]
        mesh = arrays["mesh"][rows]
        found = arrays["nearest" if nearest else "found"][rows]
        examples = None
        if found.shape[1] and self._examples is not None and self._example_vectors is not None:
            examples = RetrievedExamples(
                self._examples[found].float(), self._example_lengths[found], self._example_vectors[found]
            )
        return DrawnRows(
            arrays["values"][rows].float(),
            arrays["lengths"][rows],
            TextBatch(tokens, mask, arrays["pooled"][rows]),
            None if self.meshes is None else self.meshes[mesh.clamp(min=0)],
            mesh >= 0,
            arrays["person"][rows],
            examples,
        )


class FedPool:
    """A pool that processes fill while it is drawn from.

    Args:
        pool: Rows.
        workers: What fills it.
    """

    def __init__(self, pool: RowPool, workers: RowWorkers):
        self.pool, self.workers = pool, workers
        self._ahead = Ahead(workers, 8)

    def feed(self, least: int = 0) -> None:
        """Take what is ready, and wait until the pool has `least` rows.

        Raises:
            Exception: What a process raised.
        """
        while len(self.pool) < min(least, self.pool.size) or self._ahead.waits:
            self.pool.add(self._ahead.take())

    def close(self) -> None:
        """End the processes."""
        self._ahead.end()
        self.workers.close()
        self._ahead.join()
