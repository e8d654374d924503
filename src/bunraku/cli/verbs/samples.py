"""`bunraku samples`: the sample characters as files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from bunraku.cli.output.alone import alone
from bunraku.cli.output.checks import check_folder
from bunraku.cli.output.ledger import check_free
from bunraku.cli.output.outputs import wrote
from bunraku.errors import OptionError

__all__ = ["Samples"]


@dataclass(frozen=True)
class Samples:
    """Write the sample characters as GLB files.

    Example: bunraku samples person mushroom -o characters
    """

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Which ones; all of them by default."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path(".")
    """Folder to write to, made when it is not there."""
    overwrite: bool = False
    """Replace other files that have a sample's name."""
    list: bool = False
    """Only print the names."""

    def run(self) -> None:
        from bunraku.samples import sample_names

        known = tuple(sample_names())
        for name in self.names:
            if name not in known:
                raise OptionError(f"there is no sample '{name}'; there are {', '.join(known)}")
        if self.list:
            print("\n".join(known))
            return
        check_folder(self.output)

        outputs = {name: self.output / f"{name}.glb" for name in self.names or known}
        with alone(outputs.values()):
            self._write(outputs)

    def _write(self, outputs: dict[str, Path]) -> None:
        """Write the samples that are not there yet."""
        from bunraku.formats.files import atomic_write, read_bounded
        from bunraku.samples import sample_file

        todo = {name: read_bounded(sample_file(name)) for name in outputs}
        there = [name for name, path in outputs.items() if path.is_file() and path.read_bytes() == todo[name]]
        check_free([path for name, path in outputs.items() if name not in there], self.overwrite, ours=False)
        if there:
            print(f"{len(there)} of {len(todo)} samples are there already")
        for name, path in outputs.items():
            if name not in there:
                with atomic_write(path) as file:
                    file.write(todo[name])
                wrote(path)
