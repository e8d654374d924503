"""Make the picture of learned apparel: `python tools/make_apparel_pictures.py --motions data/motions`.

A character of the wardrobe in a long skirt with long hair, of which only the mesh is kept, gets handles, a dancer's
jump, and apparel that a network finds and moves: `docs/pictures/apparel-learned.png`.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

from bunraku.cli import main
from bunraku.datasets.motions.clips import load_clip
from bunraku.io import save_character
from bunraku.synthetic.wardrobe import wardrobe_character

OUT = Path(__file__).parents[1] / "docs/pictures/apparel-learned.png"
SEED, MOTION = 450, "cmu_05_08"


def picture(motions: Path) -> None:
    """The picture, and the animation beside it in a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        mesh, motion = Path(folder) / "bare.glb", Path(folder) / "jump.npz"
        save_character(replace(wardrobe_character(SEED), rig=None, source=None), mesh)
        load_clip(motions / f"{MOTION}.npz").save(motion)
        words = ["transfer", str(mesh), str(motion), "--apparel", "learn", "-o", str(Path(folder) / "out.glb")]
        main([*words, "--preview", str(OUT), "--overwrite"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motions", type=Path, default=Path("data/motions"))
    picture(parser.parse_args().motions)
