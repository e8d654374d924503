"""Chains of apparel: how files say that they swing, and chains laid over the shape alone against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bunraku.apparel.chains.body_collisions import CHAIN_REPAIRS
from bunraku.apparel.chains.chain_rig import LaidChains, with_chains
from bunraku.apparel.chains.cloth_repairs import DressedChains
from bunraku.apparel.chains.from_bones import bone_chains
from bunraku.apparel.chains.from_shape import shape_chains
from bunraku.apparel.chains.moving import steady_simulation
from bunraku.apparel.clothed import GRAVITY
from bunraku.apparel.physics.clothed_from_file import NEWTON_METRE, bending_limits, body_springs
from bunraku.apparel.physics.rig import apparel_rig
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku_lab.evaluation.apparel.clips import RATE, TrueClip, edge_score, insides, point_distance

__all__ = ["FileChain", "chain_parameters_from_file", "chain_row", "chain_summary", "chained_clip", "chains_from_file"]

LOCKED = np.radians(1.0)
"""A joint that turns less far counts as locked [rad]."""
NARROWEST, WIDEST = np.radians(0.2), 1.4  # limits of a link of chains that are laid over a shape [rad]


@dataclass(frozen=True)
class FileChain:
    """A chain.

    Args:
        file: Of the character.
        kind: One of `chain.KINDS`.
        links: How many of its bones physics move.
        length: Over the height.
        limits: How far each link turns against the one above [rad].
        stiffness: Median over its links of the spring over the moment of the weight that hangs on it, 0 for none.
        damping: Mean share of the velocity that is lost in a second.
        mass: Of its first link [kg].
        bones: Those of its links that physics move, shape (links,).
    """

    file: str
    kind: str
    links: int
    length: float
    limits: tuple[float, ...]
    stiffness: float
    damping: float
    mass: float
    bones: tuple[int, ...] = ()

    @property
    def limit(self) -> float:
        """The median limit of the links that turn at all [rad]; 0 where none does."""
        free = [limit for limit in self.limits if limit > LOCKED]
        return float(np.median(free)) if free else 0.0

    @property
    def locked(self) -> bool:
        """Whether the first link does not turn."""
        return self.limits[0] <= LOCKED


def chains_from_file(character: Character) -> list[FileChain]:
    """The chains of a character whose file has physics; none where it has none, or its rig is not a person's."""
    rig = apparel_rig(character)
    if rig is None or character.rig is None:
        return []
    limits, springs = bending_limits(rig, character.rig.parents), body_springs(rig) * NEWTON_METRE
    body_of: dict[int, int] = {}
    for number, body in enumerate(rig.bodies):
        if body.dynamic and body.bone >= 0:
            body_of.setdefault(body.bone, number)
    out = []
    for chain in bone_chains(character):
        rows = [place for place, bone in enumerate(chain.bones) if int(bone) in body_of]
        if not rows:
            continue
        own = [body_of[int(chain.bones[place])] for place in rows]
        bodies = [rig.bodies[number] for number in own]
        mass = np.array([max(body.mass, 1e-4) for body in bodies])
        places = np.array([body.position for body in bodies])
        ratios = [
            float(springs[number] / max(GRAVITY * (mass[link:] @ np.linalg.norm(
                places[link:] - chain.points[rows[link]], axis=1)), 1e-6))
            for link, number in enumerate(own)
        ]  # fmt: skip
        out.append(
            FileChain(
                character.name, chain.kind, len(own), chain.length / character.height,
                tuple(float(limits[number]) for number in own), float(np.median(ratios)),
                float(np.mean([body.linear_damping for body in bodies])), float(mass[0]),
                tuple(int(chain.bones[place]) for place in rows),
            )
        )  # fmt: skip
    return out


def chain_parameters_from_file(laid: LaidChains, character: Character) -> LaidChains:
    """Laid chains that swing by what the file says of those that hold the same vertices there."""
    rig, told = character.rig, chains_from_file(character)
    if rig is None or not told:
        return laid
    owner = np.full(len(rig.names), len(told))
    for number, one in enumerate(told):
        owner[list(one.bones)] = number
    held = np.zeros((len(laid.vertices), len(told) + 1))  # by each chain of the file
    for bones, shares in zip(rig.indices[laid.vertices].T, rig.weights[laid.vertices].T, strict=True):
        np.add.at(held, (np.arange(len(held)), owner[bones]), shares)
    facts = np.array([(sum(one.limits), one.stiffness, one.damping, one.mass) for one in told])
    chains = []
    for chain in laid.chains:
        own = (laid.shares * np.isin(laid.links + JOINT_COUNT, chain.bones)).sum(axis=1)
        count = (own @ held)[:-1]
        if count.sum() > 0:
            whole, stiffness, damping, mass = count @ facts / count.sum()
            limit = float(np.clip(whole / len(chain), NARROWEST, WIDEST))
            swing = replace(chain.parameters, limit=limit, stiffness=stiffness, damping=damping, mass=max(mass, 1e-3))
            chain = replace(chain, parameters=swing)
        chains.append(chain)
    return replace(laid, chains=tuple(chains))


STRIDE = 10  # frames from one whose edges are measured to the next


def chained_clip(clip: TrueClip, told: Character | None = None) -> tuple[np.ndarray, int]:
    """All vertices of a clip [m], shape (N, V, 3), and how many bodies flew away in what is shown.

    Args:
        clip: The clip.
        told: Its character, where chains swing by its file's limits, springs, damping and masses.
    """
    clothed = clip.clothed
    transforms = np.tile(np.eye(4), (JOINT_COUNT, 1, 1))
    transforms[:, :3, 3] = clothed.joints
    rig = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, *top_influences(clothed.weights, 4))
    character = Character(clip.name, clothed.rest, clothed.faces, rig)
    body = RigAnimation.of_world(character, clip.transforms[..., :3], clip.transforms[..., 3], RATE)
    laid = shape_chains(clothed)
    if told is not None:
        laid = chain_parameters_from_file(laid, told)
    made = with_chains(character, laid, np.arange(JOINT_COUNT))
    if not made.chains:
        return body.vertices(), 0
    found = steady_simulation(made.on(body), made.rig(tied=False))
    moved, dressed = found.animation, DressedChains(made, clothed, np.arange(JOINT_COUNT), rig)
    for repair in CHAIN_REPAIRS:
        moved = repair(moved, dressed)
    return moved.vertices(), sum(one.frame >= 0 for one in found.report.recoveries)


def chain_row(clip: TrueClip, told: Character | None = None) -> dict[str, Any]:
    """Mean errors of a clip from rest [m], of chains and of parent-rigid skinning, ELS of both and of the truth, and
    fly-aways, and the shares of all three that are deep in the body.

    Args:
        clip: The clip.
        told: Its character, where the error of chains with its file's parameters is wanted too.
    """
    clothed, chosen, few = clip.clothed, clip.sample(), slice(0, None, STRIDE)
    truth = clip.truth(chosen)
    moved, lost = chained_clip(clip)
    vertices = np.flatnonzero(clothed.apparel)
    index = np.full(len(clothed.rest), -1)
    index[vertices] = np.arange(len(vertices))
    edges, rest = index[clip.edges()], clothed.rest[vertices]
    shown = {
        "rigid": clip.carried(vertices)[few], "chains": moved[few][:, vertices], "truth": clip.truth(vertices)[few],
    }  # fmt: skip
    more = {}
    if told is not None:
        own, flown = chained_clip(clip, told)
        more = {"told": float(point_distance(own[:, chosen], truth).mean()), "told_lost": flown}
    return insides(clip, vertices, few, shown) | more | {
        "name": clip.name, "motion": clip.motion,
        "rigid": float(point_distance(clip.carried(chosen), truth).mean()),
        "chains": float(point_distance(moved[:, chosen], truth).mean()),
        "chains_els": edge_score(moved[few][:, vertices], rest, edges),
        "els_truth": edge_score(clip.truth(vertices)[few], rest, edges),
        "lost": lost,
    }  # fmt: skip


def chain_summary(rows: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """Error over that of rigid apparel (mean, and median of clips), ELS less the truth's, and clips with fly-aways."""
    if not rows:
        return {}
    ratios = [row["chains"] / max(row["rigid"], 1e-9) for row in rows]
    return {
        "chains_over_rigid": float(sum(row["chains"] for row in rows) / max(sum(row["rigid"] for row in rows), 1e-9)),
        "chains_mean_ratio": float(np.mean(ratios)),
        "chains_median_ratio": float(np.median(ratios)),
        "chains_worst_ratio": float(max(ratios)),
        "chains_els_minus_truth": float(np.mean([row["chains_els"] - row["els_truth"] for row in rows])),
        "chains_fly_aways": float(sum(row["lost"] > 0 for row in rows)),
        "chains_clips": float(len(rows)),
        "chains_inside_over_rigid": _inside(rows, "chains") / max(_inside(rows, "rigid"), 1e-9),
        "chains_inside_over_truth": _inside(rows, "chains") / max(_inside(rows, "truth"), 1e-9),
    }


def _inside(rows: Sequence[dict[str, Any]], which: str) -> float:
    return float(sum(row.get(f"inside_{which}", 0.0) for row in rows))
