"""`bunraku merge`: clips of one character from several files in one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from bunraku.cli.output.alone import alone
from bunraku.cli.output.checks import check_different, check_input, check_output
from bunraku.cli.output.ledger import check_free, note_written
from bunraku.cli.output.outputs import OutputOption, wrote
from bunraku.core.request.limits import FPS
from bunraku.errors import OptionError

__all__ = ["Merge"]


@dataclass(frozen=True)
class Merge:
    """Join the clips of one character from several files in one GLB.

    The first file is written as it is, with the clips of the others behind its own, onto the bones of the same names.

    Example: bunraku merge idle.glb walk.glb attack.glb -o knight.glb
    """

    files: tyro.conf.Positional[tuple[Path, ...]]
    """Two GLB, glTF or VRM files of one character and more."""
    output: OutputOption = ()
    """GLB to write. May be given more than once. Default: FIRST-merged.glb in this folder."""
    end_to_start: bool = False
    """Write all clips in a row as one, each going on where the one before ends."""
    fps: float = 30.0
    """Frames a second of that one, 1 to 240."""
    overwrite: bool = False
    """Replace files that are there already and that Bunraku did not write."""

    def run(self) -> None:
        FPS.check(self.fps, "--fps")
        if len(self.files) < 2 and not self.end_to_start:
            raise OptionError("name two files at the least, whose clips come into one")
        if not self.files:
            raise OptionError("name the files whose clips come into one")
        for path in self.files:
            check_input(path)
        outputs = self.output or (Path(f"{self.files[0].stem}-merged.glb"),)
        with alone(outputs):
            for path in outputs:
                check_output(path, (".glb",), self.files)
            check_different(outputs)
            check_free(outputs, self.overwrite)

            from bunraku.io.merge import merge

            written: list[Path] = []
            try:
                for path in outputs:
                    written.append(merge(self.files, path, end_to_start=self.end_to_start, fps=self.fps))
            finally:  # what is whole stays
                for path in written:
                    wrote(path)
                note_written(written)
