"""Make the pictures of docs/tables.md: the same sentence and character, or the same character and motion, a row for
each method.

    python tools/make_tables_pictures.py --character FILE --baselines runs/baselines
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import bunraku
from bunraku.anatomy.anatomy import Anatomy
from bunraku.apparel.learned.network import load_displacement
from bunraku.core.animation import Animation
from bunraku.core.body.joint_rotations import skeleton_from_handles
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.core.skinning import skin
from bunraku.generation.generate import generate_motion
from bunraku.render import contact_sheet, render_frames
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.baselines.pose_transfer import copied_motion, rig_by_embedding, source_motion
from bunraku_lab.evaluation.apparel.clips import made_clips
from bunraku_lab.evaluation.apparel.rivals import UNTRAINED, rival_mover, rivals_of
from bunraku_lab.evaluation.tables.measured import TRANSFER
from bunraku_lab.evaluation.tables.tapmo import NO_STAGES, transferred_motion
from bunraku_lab.nn.pose_transfer import TransferNetwork
from bunraku_lab.training.apparel.body import clothed_by_mask, tiled

OUT = Path(__file__).parents[1] / "docs/pictures"
PROMPT, SECONDS, SEED, MOMENTS, SIZE = "a person kicks with the left leg", 3.0, 3, 6, (180, 220)


def rows_of(rows: dict[str, np.ndarray], character: Character, path: Path, title: str) -> None:
    """A sheet with a row for each method, of its vertices in `MOMENTS` frames."""
    pictures, labels = [], []
    for name, vertices in rows.items():
        shown = vertices[np.linspace(0, len(vertices) - 1, MOMENTS).round().astype(int)]
        pictures += list(render_frames(shown, character.faces, character.colors, size=SIZE))
        labels += [name] * MOMENTS
    contact_sheet(pictures, labels, path, columns=MOMENTS, title=title)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--character", type=Path, required=True, help="of table 2")
    parser.add_argument("--baselines", type=Path, required=True, help="folder of the other methods' weights")
    options = parser.parse_args()
    ours = generate_motion(PROMPT, SECONDS, seed=SEED, candidates=1)

    body = reference_body()
    chosen = generate_motion(PROMPT, SECONDS, seed=SEED)
    shown = {"ours, one sample": ours, "ours, as animate chooses": chosen}
    figure = body.character()
    rows = {name: Animation(figure, body.handles, motion).vertices() for name, motion in shown.items()}
    rows_of(rows, figure, OUT / "tables-tapmo-1.png", f'TapMo, table 1: "{PROMPT}"')

    character = bunraku.load_character(options.character)
    handles = bunraku.rig(character)
    anatomy = Anatomy.of(character, handles)
    copied = copied_motion(rig_by_embedding(character.vertices, character.faces), skeleton_from_handles(ours))
    network = TransferNetwork.load(options.baselines / TRANSFER)
    rows = {"MDM-SR": copied}
    rows["MDM-SFR"] = transferred_motion(
        network, character, handles, source_motion(network, skeleton_from_handles(ours))
    )
    for name, motion, stages in (
        ("MDM-SFR, floor", ours, NO_STAGES),
        ("ours, not adapted", ours, Stages(shape=False)),
        ("ours", ours, Stages(shape=True)),
    ):
        rows[name] = Animation(character, handles, fit_motion(motion, anatomy, stages)).vertices()
    rows_of(rows, character, OUT / "tables-tapmo-2.png", f'TapMo, table 2: "{PROMPT}"')

    (clip,) = list(made_clips(2))[1:]
    clothed = clip.clothed
    frames = np.linspace(60, len(clip.transforms) - 1, MOMENTS).round().astype(int)
    short = replace(clip, transforms=clip.transforms[frames], offsets=clip.offsets[frames])
    truth = short.truth(np.arange(len(clothed.rest)))
    guessed, weights = clothed_by_mask(clothed)
    rows = {"truth": truth}
    for rival in rivals_of(options.baselines):
        if UNTRAINED not in rival.name:
            rows[rival.name] = rival_mover(clothed, rival.network)(short.affine)
    rows["our skinning"] = np.asarray(skin(clothed.rest, weights, short.affine))
    rows["ours"] = tiled(guessed, clip.transforms, load_displacement(shipped_checkpoint("apparel-guessed")), frames)
    dressed = Character(clip.name, clothed.rest, np.asarray(clothed.faces))
    rows_of(rows, dressed, OUT / "tables-mmdmc.png", "MMDMC, tables 2 and 3: from rest, the same dance")


if __name__ == "__main__":
    main()
