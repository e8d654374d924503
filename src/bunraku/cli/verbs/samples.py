"""`bunraku samples`: the sample characters as files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.checks import check_folder
from bunraku.cli.evaluate.report import wrote
from bunraku.cli.progress import stages
from bunraku.errors import OptionError

__all__ = ["Samples"]


@dataclass(frozen=True)
class Samples:
    """Write the sample characters, which are made by code, as GLB files.

    Example: bunraku samples person mushroom -o characters
    """

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Which ones; all of them by default."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path(".")
    """Folder to write to, made when it is not there."""
    list: bool = False
    """Only print the names."""

    def run(self) -> None:
        from bunraku.synthetic.samples import sample_character, sample_names

        known = tuple(sample_names())
        for name in self.names:
            if name not in known:
                raise OptionError(f"there is no sample '{name}'; there are {', '.join(known)}")
        if self.list:
            print("\n".join(known))
            return
        check_folder(self.output)

        from bunraku.io import save_character

        written = []
        with stages() as report:
            names = self.names or known
            for number, name in enumerate(names):
                report("samples", number / len(names))
                written.append(self.output / f"{name}.glb")
                save_character(sample_character(name), written[-1])
            report("samples", 1.0)
        for path in written:
            wrote(path)
