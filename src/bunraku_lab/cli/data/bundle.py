"""`bunraku data bundle`: the motion data in one small file, to train with on another machine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from bunraku.cli.output.checks import check_input, check_output, check_source
from bunraku.cli.output.progress import stages

__all__ = ["DataBundle"]


@dataclass(frozen=True)
class DataBundle:
    """Pack the clips that training reads, their sentences and the mesh features into one file for another machine.

    `bunraku train diffusion --data` takes the file in the place of the folder, and the mesh features from it. Clips for
    tests stay behind.

    Example: bunraku data bundle --data data/motions --mesh-bank data/mesh_bank.npz -o bundle.safetensors
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """File to write, .safetensors."""
    data: Path = Path("runs/data/motions")
    """Folder that `bunraku data motions` wrote."""
    mesh_bank: Path | None = None
    """NPZ that `bunraku data mesh-bank` wrote."""
    people: Literal["skeleton", "handles"] = "skeleton"
    """How people's clips are kept: as 22 joints, 40 bytes a frame and some 0.6 cm off; or as all handles, 100 bytes a
    frame and a millimetre.
    """

    def run(self) -> None:
        check_source(self.data, "name the folder that 'bunraku data motions' wrote")
        if self.mesh_bank is not None:
            check_input(self.mesh_bank)
        check_output(self.output, [".safetensors"])
        from bunraku_lab.datasets.motions.bundle import write_bundle

        with stages() as report:
            facts = write_bundle(
                self.data,
                self.output,
                self.mesh_bank,
                self.people,
                progress=lambda done, total: report("clips", done / total),
            )
        print(
            f"wrote {facts.clips} clips, {facts.frames / 72_000:.1f} hours, to {self.output}: "
            f"{facts.bytes / 2**20:.1f} MiB; handles are off by {facts.error * 100:.2f} cm on average, 99 of 100 by "
            f"less than {facts.largest * 100:.2f} cm"
        )
