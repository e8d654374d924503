"""Make the pictures of learned apparel: `python tools/make_apparel_pictures.py [--files gene.pmx uka.pmx]`.

A character of the wardrobe in a long skirt with long hair, of which only the mesh is kept, dances as a sentence says:
`docs/pictures/apparel-learned-frames.png` and, moving, `apparel-learned.webp`. With `--files`, avatars with physics in
a dance made by code, simulated above and learned below: `apparel-files.png`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import bunraku
from bunraku.apparel.body import UnifiedBody
from bunraku.pipelines.apparel import dressed
from bunraku.pipelines.requests import Apparel
from bunraku.render import contact_sheet, render_frames, save_preview
from bunraku_lab.datasets.apparel.build import body_animation
from bunraku_lab.synthetic.stock_motions import stock_motion
from bunraku_lab.synthetic.wardrobe import wardrobe_character

OUT = Path(__file__).parents[1] / "docs/pictures"
SEED, PROMPT, SECONDS = 801, "a person dances and turns around", 4.0
MOMENTS = (15, 40, 65, 90, 115)  # frames of the files' dance


def dance() -> None:
    """The generated dance on a mesh without a rig, as a sheet and as a moving picture."""
    character = replace(wardrobe_character(SEED), name="a mesh in a long skirt, with long hair", rig=None, source=None)
    moved = bunraku.animate(character, PROMPT, seconds=SECONDS, seed=1, apparel="learn")
    save_preview(moved, OUT / "apparel-learned-frames.png", size=(180, 260), frames=10, columns=5)
    save_preview(moved, OUT / "apparel-learned.webp", size=(240, 320), fps=10)


def beside(files: list[Path]) -> None:
    """Avatars in a dance: simulated above, learned below."""
    pictures, labels = [], []
    for path in files:
        character = bunraku.load_character(path)
        body = UnifiedBody.of(character)
        animation = body_animation(body, stock_motion("dance", 4.0, 30.0))
        for how in ("simulate", "learn"):
            moved = dressed(animation, Apparel(how))
            shown = moved.vertices(list(MOMENTS))
            pictures += list(render_frames(np.asarray(shown), character.faces, character.colors, size=(180, 260)))
            labels += [f"{path.stem}, {how}d" if how == "simulate" else f"{path.stem}, learned"] * len(MOMENTS)
    contact_sheet(pictures, labels, OUT / "apparel-files.png", columns=len(MOMENTS))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=Path, nargs="*", default=[])
    arguments = parser.parse_args()
    dance()
    if arguments.files:
        beside(arguments.files)
