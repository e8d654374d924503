"""What a look after sampling sees: hands in the body, and contacts that slide in turns. As a Markdown table.

    python benchmarks/look.py [--data data/motions] [--seconds 6] [--candidates 3]

Sentences are those of benchmarks/playback.txt for hands, and eight of circles and turns for contacts, each fitted to
the reference body with all stages, and without the one that is asked about. Captured clips, drawn by lot, are measured
the same way where their folder is given.

Hands: share of the frames in which a point of a hand is deeper than 1 cm in the body without its arms, by the
generalised winding number (Jacobson et al. 2013) of the posed surface, which no stage uses.
Contacts: feet whose lowest point is within 3 cm of the ground in a frame and the next, and no faster than 1 m/s; share
of them that slide more than 3 cm in a tenth of a second, and share that is more than 3 cm from where its contact began.
"""

from __future__ import annotations

import argparse
import functools
from pathlib import Path
from typing import Any, NamedTuple

import igl
import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.generation.generate import generate_motions
from bunraku.language.parse import parse
from bunraku.retarget.fit import Stages, fit_motion
from bunraku_lab.datasets.motions.clips import load_clip, load_index

TURNS = (
    "a person walks in a circle", "walks in a circle to the right", "he walks around in a circle again and again",
    "a person turns around", "makes a half turn to the left", "walks forward, then turns around", "a person turns left",
    "the person turns to the right twice",
)  # fmt: skip

DEEP = 0.01
"""How deep a point of a hand in the body is seen [m]."""
SOLE_HEIGHT = 0.03
"""Height of a sole's lowest point with which it is on the ground [m]."""
FAST = 1.0
"""Speed along the ground with which a foot is swung [m/s]."""
SLID = 0.03
"""Way that is seen [m]."""
MOMENT = 0.1
"""Time in which it is [s]."""
SOLE = 0.02
"""How much higher than the lowest a point of a sole may be to be where the foot stands [m]."""


@functools.cache
def _trunk_and_hands() -> tuple[np.ndarray, np.ndarray]:
    """Faces of the reference body without its arms, and some vertices of both hands."""
    body = reference_body()

    def moved_by(*ends: str) -> np.ndarray:
        chosen = [name.endswith(ends) for name in HANDLE_NAMES]
        return np.asarray(body.handle_weights[:, chosen].sum(axis=1))

    arms = moved_by("collar", "shoulder", "elbow", "wrist", "fingers")
    faces = body.character().faces
    return faces[(arms[faces] < 0.5).all(axis=1)], np.flatnonzero(moved_by("wrist", "fingers") > 0.8)[::20]


def hands_in_body(motion: HandleMotion, every: int = 2) -> np.ndarray:
    """Whether a hand is more than 1 cm deep in the body without its arms, in every second frame, shape (N / 2,), bool:
    by the generalised winding number of the posed surface (Jacobson et al. 2013).
    """
    body = reference_body()
    faces, hands = _trunk_and_hands()
    transforms = motion.transforms(body.handles.positions)
    found = []
    for frame in range(0, len(motion), every):
        posed = skin(body.vertices, body.handle_weights, transforms[frame : frame + 1])[0].astype(np.float64)
        points = posed[hands]
        inside = igl.fast_winding_number(posed, faces.astype(np.int64), points) > 0.5
        deep = 0.0
        if inside.any():
            deep = float(igl.point_mesh_squared_distance(points[inside], posed, faces.astype(np.int64))[0].max()) ** 0.5
        found.append(deep > DEEP)
    return np.array(found)


class Slides(NamedTuple):
    """Contacts, counted for each foot and each frame in which it stays on the ground to the next.

    Args:
        fast: How many slide more than 3 cm in a tenth of a second.
        far: How many are more than 3 cm from where their contact began.
        contacts: All of them.
    """

    fast: int
    far: int
    contacts: int


def sliding_contacts(motion: HandleMotion) -> Slides:
    """How feet on the ground slide; a foot is where its lowest part is, so rolling is no slide."""
    body = reference_body()
    transforms = motion.transforms(body.handles.positions)
    fast = far = count = 0
    for side in ("left", "right"):
        columns = [HANDLE_NAMES.index(f"{side}_{part}") for part in ("ankle", "foot")]
        foot = body.handle_weights[:, columns].sum(axis=1) > 0.9
        posed = skin(body.vertices[foot], body.handle_weights[foot], transforms)
        height = posed[..., 1]
        sole = height - height.min(axis=1, keepdims=True) < SOLE
        both = sole[1:] & sole[:-1]
        ways = (np.diff(posed[..., [0, 2]], axis=0) * both[..., None]).sum(axis=1)
        ways /= np.maximum(both.sum(axis=1), 1)[:, None]
        speed = np.linalg.norm(ways, axis=1) * motion.fps
        low = height.min(axis=1) < SOLE_HEIGHT
        down = low[1:] & low[:-1] & (speed < FAST)
        from_start = np.zeros(2)
        for frame in range(len(down)):
            from_start = from_start + ways[frame] if down[frame] else np.zeros(2)
            count += bool(down[frame])
            fast += bool(down[frame] and speed[frame] * MOMENT > SLID)
            far += bool(down[frame] and np.linalg.norm(from_start) > SLID)
    return Slides(fast, far, count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder of 'bunraku data motions', for captured clips")
    parser.add_argument("--sentences", type=Path, default=Path(__file__).with_name("playback.txt"))
    parser.add_argument("--clips", type=int, default=40)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--candidates", type=int, default=3)
    args = parser.parse_args()
    body = reference_body()
    anatomy = Anatomy.of(body.character(), body.handles)

    def motions(sentences: Any) -> list[HandleMotion]:
        found = []
        for seed, prompt in enumerate(sentences):
            script = parse(prompt, args.seconds, force=True).clauses
            made = generate_motions([script], seeds=[seed], candidates=args.candidates)[0]
            found.append(made.of_own_body())
        return found

    def hands_row(name: str, some: list[HandleMotion], stages: Stages) -> None:
        seen = np.concatenate([hands_in_body(fit_motion(one, anatomy, stages)) for one in some])
        print(f"| {name} | {100 * seen.mean():.1f} % of {len(seen)} frames |", flush=True)

    def feet_row(name: str, some: list[HandleMotion], stages: Stages) -> None:
        fast, far, count = np.sum([sliding_contacts(fit_motion(one, anatomy, stages)) for one in some], axis=0)
        print(f"| {name} | {100 * fast / count:.1f} % | {100 * far / count:.1f} % of {count} |", flush=True)

    made = motions(TURNS)
    print("| contacts in circles and turns | 3 cm in 0.1 s | 3 cm from where it began |\n| --- | --- | --- |")
    feet_row("all stages", made, Stages())
    feet_row("without feet", made, Stages(feet=False))
    clips = [] if args.data is None else _captured(args, load_index(args.data), load_clip)
    if clips:
        turning = [one for text, one in clips if "turn" in text or "circle" in text]
        feet_row(f"captured, {len(turning)} clips of turns", turning, Stages())
    print("\n| hands deeper than 1 cm in the body | |\n| --- | --- |", flush=True)
    made = motions(args.sentences.read_text(encoding="utf-8").split("\n")[:-1])
    hands_row("all stages", made, Stages())
    hands_row("without hands_clear", made, Stages(hands_clear=False))
    if clips:
        hands_row(f"captured, {len(clips)} clips", [one for _, one in clips], Stages())


def _captured(args: Any, index: Any, load: Any) -> list[tuple[str, Any]]:
    """Clips of people of validation and test, drawn by lot, at most ten seconds of each."""
    names = sorted(
        name for name, entry in index.items() if not entry.get("species") and entry.get("split") in ("val", "test")
    )
    chosen = np.random.default_rng(31).permutation(names)[: args.clips]
    found = []
    for name in chosen.tolist():
        texts = " ".join(
            index[name].get("texts") or [part["texts"][0] for part in index[name].get("stretches", [])][:1]
        )
        found.append((texts, load(args.data / f"{name}.npz").take(slice(0, 200))))
    return found


if __name__ == "__main__":
    main()
