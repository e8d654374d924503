"""Learned apparel on one clip, beside what skinning alone gives: clips with the truth, measures, and rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count as counting
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.apparel.body import UnifiedBody, eq4_transforms
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.learned.features import Frame
from bunraku.apparel.learned.network import DisplacementNetwork, past_of_states
from bunraku.apparel.learned.player import ApparelPlayer, network_inputs
from bunraku.apparel.physics.clothed_from_file import clothed_from_file
from bunraku.apparel.physics.rig import apparel_rig
from bunraku.apparel.physics.simulate import simulate
from bunraku.core.animation import RigAnimation
from bunraku.core.character import Character
from bunraku.core.geometry.graph import unique_edges
from bunraku.core.motion import posed_points
from bunraku.core.skinning import skin
from bunraku_lab.datasets.apparel import ApparelData
from bunraku_lab.datasets.apparel.build import body_animation, record
from bunraku_lab.datasets.apparel.checks import BodyVolume, PushOut, deep_inside
from bunraku_lab.datasets.apparel.plan import character_split


def point_distance(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """PMD, the mean Euclidean distance of vertices from the truth in each frame [m], shapes (N, V, 3) -> (N,)."""
    return np.asarray(np.linalg.norm(points - truth, axis=-1).mean(axis=-1))


def edge_score(points: np.ndarray, rest: np.ndarray, edges: np.ndarray) -> float:
    """ELS, 1 less the mean change of an edge's length over its length at rest (Liao et al. 2022).

    Args:
        points: In N frames [m], shape (N, V, 3).
        rest: In the rest pose [m], shape (V, 3).
        edges: Pairs of vertices, shape (E, 2).
    """
    before = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=-1)
    real = before > 1e-5
    edges, before = edges[real], before[real]
    if not len(edges):
        return 1.0
    now = np.linalg.norm(points[:, edges[:, 0]] - points[:, edges[:, 1]], axis=-1)
    return float(1 - np.abs(now / before - 1).mean())


RATE = 30.0
MADE = 900_000  # seed from which characters are made that no data set has
MOST = 600  # apparel vertices that distances are taken of


@dataclass(frozen=True, eq=False)
class TrueClip:
    """A clip at 30 frames a second whose apparel is known.

    Args:
        name: Of the character.
        motion: Of the motion.
        clothed: The character, with its file's mask and stiffness.
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
        loose: Vertices that leave their joints, shape (M,).
        offsets: By how much [m], shape (N, M, 3).
    """

    name: str
    motion: str
    clothed: ClothedCharacter
    transforms: np.ndarray
    loose: np.ndarray
    offsets: np.ndarray

    @property
    def affine(self) -> np.ndarray:
        """Affine transforms of the joints, shape (N, 22, 3, 4)."""
        return eq4_transforms(self.transforms, self.clothed.joints)

    def sample(self) -> np.ndarray:
        """Apparel vertices, evenly taken where they are many, shape (S,)."""
        found = np.flatnonzero(self.clothed.apparel)
        return found if len(found) <= MOST else found[np.linspace(0, len(found) - 1, MOST).astype(np.int64)]

    def carried(self, vertices: np.ndarray) -> np.ndarray:
        """Vertices as the joints alone take them [m], shape (N, S, 3)."""
        return np.asarray(skin(self.clothed.rest[vertices], self.clothed.weights[vertices], self.affine))

    def truth(self, vertices: np.ndarray) -> np.ndarray:
        """Where vertices are [m], shape (N, S, 3)."""
        index = np.full(len(self.clothed.rest), -1)
        index[self.loose] = np.arange(len(self.loose))
        rows = index[vertices]
        moved = np.array(self.carried(vertices))
        moved[:, rows >= 0] += self.offsets[:, rows[rows >= 0]].astype(np.float32)
        return moved

    def edges(self) -> np.ndarray:
        """Edges between apparel vertices, shape (E, 2)."""
        found = unique_edges(np.asarray(self.clothed.faces, np.int64), len(self.clothed.rest))
        return found[self.clothed.apparel[found].all(axis=1)]


def data_clips(data: ApparelData, most: int | None = None, seconds: float = 6.0) -> Iterator[TrueClip]:
    """Clips of a data set, characters in turn; those under `seconds` are passed over, longer ones are cut.

    Args:
        data: Of one split.
        most: How many at the most.
        seconds: Length [s].
    """
    from bunraku_lab.training.apparel.displacement import truly_clothed

    rows: dict[str, list[int]] = {}
    for number, clip in enumerate(data.clips):
        if clip.frames >= seconds * RATE:
            rows.setdefault(clip.character, []).append(number)
    order = [number for turn in range(max(map(len, rows.values()), default=0)) for number in
             (own[turn] for own in rows.values() if turn < len(own))]  # fmt: skip
    for number in order[:most]:
        clip = data.clips[number]
        character, shard = data.character(clip), data.shard(clip.shard)
        span = clip.first, clip.first + round(seconds * RATE)
        yield TrueClip(
            clip.character, clip.motion, truly_clothed(character), shard.frames("transforms", *span), character.loose,
            shard.frames("offsets", *span),
        )  # fmt: skip


def file_clips(character: Character, motions: Sequence[str], seconds: float = 6.0) -> list[TrueClip]:
    """A character's file simulated in motions made by code.

    Args:
        character: An MMD model or a VRM avatar.
        motions: Kinds of `stock_motion`.
        seconds: Length of each [s].
    """
    from bunraku_lab.synthetic.stock_motions import stock_motion

    body = UnifiedBody.of(character)
    return [_simulated(character, body, kind, body_animation(body, stock_motion(kind, seconds, RATE)))
            for kind in motions]  # fmt: skip


def made_clips(count: int, seconds: float = 6.0) -> Iterator[TrueClip]:
    """Clips that need no data: wardrobe characters that are not trained on, simulated in motions made by code.

    Args:
        count: How many, each of another character.
        seconds: Length of each [s].
    """
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    seeds = (seed for seed in counting(MADE) if character_split(f"wardrobe_{seed:06d}") == "test")
    for number, seed in enumerate(islice(seeds, count)):
        kind = ("walk", "dance")[number % 2]
        yield from file_clips(wardrobe_character(seed), (kind,), seconds)


def long_clip(seed: int, motion: Path, seconds: float = 60.0) -> TrueClip:
    """A wardrobe character in a motion that is played forth and back for so long.

    Args:
        seed: Of the character.
        motion: A clip that `bunraku data motions` wrote.
        seconds: Length [s].
    """
    from bunraku.core.motion import resample
    from bunraku_lab.datasets.motions.clips import load_clip
    from bunraku_lab.synthetic.wardrobe import wardrobe_character

    character = wardrobe_character(seed)
    body = UnifiedBody.of(character)
    reference = resample(load_clip(motion), RATE)
    moved = body_animation(body, reference.take(slice(0, round(10 * RATE))))
    count, frames = len(moved), round(seconds * RATE)
    course = np.concatenate([np.arange(count), np.arange(count - 2, 0, -1)])
    rows = np.tile(course, frames // len(course) + 1)[:frames]
    whole = RigAnimation(character, moved.rotations[rows], moved.translations[rows], RATE)
    return _simulated(character, body, Path(motion).stem, whole)


def _simulated(character: Character, body: UnifiedBody, name: str, animation: RigAnimation) -> TrueClip:
    recording = record(body, [simulate(animation, apparel_rig(character)).animation])
    clothed = clothed_from_file(character, body)
    offsets = PushOut(clothed)(recording.transforms, recording.loose, recording.offsets)
    return TrueClip(character.name, name, clothed, recording.transforms, recording.loose, offsets)


STRIDE = 10  # frames from one whose edges and insides are measured to the next
DEEPEST = 300  # vertices whose insides are measured


def clip_row(clip: TrueClip, network: DisplacementNetwork, *, nodes: int = 256, slow: bool = True) -> dict[str, Any]:
    """Errors of a clip that begins from the rest pose [m], mean over its frames, and scores.

    Args:
        clip: The clip.
        network: The network.
        nodes: Most nodes.
        slow: Whether insides are computed too.
    """
    chosen = clip.sample()
    truth, rigid = clip.truth(chosen), clip.carried(chosen)
    clothed = clip.clothed
    nearest = np.linalg.norm(clothed.rest[chosen][:, None] - clothed.joints[None], axis=-1).argmin(axis=1)
    near = np.asarray(posed_points(clip.affine[:, nearest], clothed.rest[chosen]))
    row: dict[str, Any] = {
        "name": clip.name, "motion": clip.motion, "vertices": len(clothed.rest),
        "apparel": float(clothed.apparel.mean()),
        "rigid": float(point_distance(rigid, truth).mean()), "nearest_joint": float(point_distance(near, truth).mean()),
    }  # fmt: skip
    variants = {"head": {"safe": False, "recurrent": False}, "learned": {"safe": False}, "safe": {}}
    if network.recurrent is None or network.recurrent.world:
        variants.pop("head")
    vertices = np.flatnonzero(clothed.apparel)
    index = np.full(len(clothed.rest), -1)
    index[vertices] = np.arange(len(vertices))
    edges, rest = index[clip.edges()], clothed.rest[vertices]
    few = slice(0, None, STRIDE)
    true_all = replace(clip, transforms=clip.transforms[few], offsets=clip.offsets[few]).truth(vertices)
    row["els_truth"] = edge_score(true_all, rest, edges)
    shown = {"truth": true_all, "rigid": replace(clip, transforms=clip.transforms[few]).carried(vertices)}
    for name, how in variants.items():
        player = ApparelPlayer(clothed, network, nodes=nodes, **how)
        moved = player.clip(clip.transforms)
        errors = point_distance(moved[:, index[chosen]], truth)
        row[name] = float(errors.mean())
        row[f"{name}_2s"] = float(errors[:60].mean())
        row[f"{name}_els"] = edge_score(moved[few], rest, edges)
        shown[name] = moved[few]
    if slow:
        row |= insides(clip, vertices, few, shown)
    return row


def insides(clip: TrueClip, vertices: np.ndarray, few: slice, shown: dict[str, np.ndarray]) -> dict[str, float]:
    """Share of the apparel deeper than 1 cm in the body, of what is not there at rest.

    Args:
        clip: The clip.
        vertices: Of the apparel, shape (A,).
        few: The frames that are looked at.
        shown: By name, where these vertices are in these frames [m], each of shape (F, A, 3).
    """
    clothed = clip.clothed
    volume = BodyVolume.of_mesh(clothed.rest, clothed.faces, clothed.weights, clothed.apparel, clip.name)
    some = np.linspace(0, len(vertices) - 1, min(DEEPEST, len(vertices))).astype(np.int64)
    some = some[~deep_inside(volume, volume.rest, clothed.rest[vertices[some]])]
    if not len(some):
        return {}
    bodies = volume.posed(clip.affine[few])
    out = dict.fromkeys(shown, 0.0)
    for frame, body in enumerate(bodies):
        points = np.concatenate([moved[frame, some] for moved in shown.values()])
        deep = deep_inside(volume, body, points).reshape(len(shown), len(some)).mean(axis=1)
        for name, share in zip(shown, deep, strict=True):
            out[name] += float(share) / len(bodies)
    return {f"inside_{name}": value for name, value in out.items()}


FADE = 0.9  # share of a known difference from the head that a frame leaves without a recurrent part


class KnownPlayer(ApparelPlayer):
    """A player that goes on from three frames with known apparel."""

    known: np.ndarray | None = None

    def know(self, states: np.ndarray, transforms: np.ndarray) -> None:
        """Go through three frames with known apparel, and go on from there; `start` comes before it.

        Args:
            states: Displacements of the nodes in the frames of their joints, over the size, shape (3, M, 3).
            transforms: `[R | t]` of the joints in these frames, shape (3, 22, 3, 4).
        """
        assert self.features is not None
        kept = []
        for state, pose in zip(states, transforms, strict=True):
            frame = self.features.advance(np.asarray(pose, np.float32))
            anchor = self.folded.anchor(*network_inputs(frame))
            kept.append((state.astype(np.float32), anchor, *self._carried_by(frame, pose)))
        self.known = kept[-1][0] - kept[-1][1]
        if self.recurrent is not None:
            self.past = past_of_states(self.recurrent, *(np.stack(column) for column in zip(*kept, strict=True)))

    def start(self, transforms: np.ndarray) -> None:
        """As of `ApparelPlayer`."""
        self.known = None
        super().start(transforms)

    def _moved(self, frame: Frame, transforms: np.ndarray) -> np.ndarray:
        moved = super()._moved(frame, transforms)
        if self.recurrent is not None or self.known is None:
            return moved
        self.known = FADE * self.known
        return np.asarray(moved + self.known)


def drift_row(clip: TrueClip, network: DisplacementNetwork, nodes: int = 256) -> dict[str, float]:
    """Errors of a long clip from rest [m]: in its second second and in its last one."""
    chosen = clip.sample()
    truth = clip.truth(chosen)
    player = ApparelPlayer(clip.clothed, network, nodes=nodes)
    player.start(clip.transforms[0])
    rows = np.searchsorted(player.carrier.vertices, chosen)
    errors = [float(np.linalg.norm(player.advance(pose)[rows] - truth[frame], axis=-1).mean())
              for frame, pose in enumerate(clip.transforms)]  # fmt: skip
    rigid = point_distance(clip.carried(chosen), truth)
    return {
        "second": float(np.mean(errors[30:60])), "last": float(np.mean(errors[-30:])), "all": float(np.mean(errors)),
        "rigid": float(rigid.mean()),
        "rigid_second": float(rigid[30:60].mean()), "rigid_last": float(rigid[-30:].mean()),
    }  # fmt: skip
