"""Chains of apparel: how they swing by what files say, and chains laid over the shape alone, measured against the truth
of their file's physics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bunraku.apparel.chains.body_collisions import CHAIN_REPAIRS
from bunraku.apparel.chains.chain_rig import LaidChains, with_chains
from bunraku.apparel.chains.cloth_repairs import DressedChains
from bunraku.apparel.chains.from_bones import bone_chains
from bunraku.apparel.chains.from_shape import shape_chains
from bunraku.apparel.chains.moving import steady_simulation
from bunraku.apparel.clothed import FREE, GRAVITY
from bunraku.apparel.physics.clothed_from_file import NEWTON_METRE, bending_limits, body_springs
from bunraku.apparel.physics.rig import apparel_rig
from bunraku.core.animation import RigAnimation
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku_lab.evaluation.apparel.clips import RATE, TrueClip, edge_score, insides, point_distance

__all__ = [
    "FACTS",
    "FileChain",
    "chain_parameters_from_file",
    "chain_row",
    "chain_summary",
    "chained_clip",
    "chains_from_file",
    "file_chain_table",
    "kind_priors",
    "prior_errors",
]


LOCKED = np.radians(1.0)
"""A joint that turns less far counts as locked [rad]."""
NARROWEST, WIDEST = np.radians(0.2), 1.4  # limits of a link of chains that are laid over a shape [rad]
FACTS = (
    "links",
    "length [% of the height]",
    "limit [degrees]",
    "all links [degrees]",
    "stiffness",
    "damping",
    "mass [kg]",
)


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
    """The chains of a character whose file has physics; none where it has none, or its rig is not a person's.

    Args:
        character: With a rig.
    """
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
    """Chains laid over a shape that swing by what the file says of those that hold the same vertices there: as far in
    all, by links of their own, with its springs, damping and mass.

    Args:
        laid: Over the character's mesh.
        character: With a rig and physics.
    """
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
            manner = replace(chain.manner, limit=limit, stiffness=stiffness, damping=damping, mass=max(mass, 1e-3))
            chain = replace(chain, manner=manner)
        chains.append(chain)
    return replace(laid, chains=tuple(chains))


def _facts(chain: FileChain) -> tuple[float, ...]:
    whole = np.degrees(min(sum(chain.limits), FREE))
    return (chain.links, 100 * chain.length, float(np.degrees(chain.limit)), float(whole), chain.stiffness,
            chain.damping, chain.mass)  # fmt: skip


def _weights(chains: Sequence[FileChain]) -> np.ndarray:
    """All characters count alike, however many chains they have, shape (C,)."""
    counts: dict[str, int] = {}
    for chain in chains:
        counts[chain.file] = counts.get(chain.file, 0) + 1
    return np.array([1 / counts[chain.file] for chain in chains])


def _quantiles(values: np.ndarray, weights: np.ndarray, shares: Sequence[float]) -> np.ndarray:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order]) / weights.sum()
    return np.asarray(values[order][np.minimum(np.searchsorted(total, shares), len(values) - 1)])


def file_chain_table(groups: Mapping[str, Sequence[FileChain]]) -> str:
    """Lines for each kind of the 10th, 50th and 90th percentile of each fact in each group, all characters alike."""
    kinds = sorted({chain.kind for chains in groups.values() for chain in chains})
    lines = []
    for kind in (None, *kinds):
        some = {name: [chain for chain in chains if kind in (None, chain.kind)] for name, chains in groups.items()}
        if not all(some.values()):
            continue
        heads = (f"{name}: {len(own)} chains of {len({one.file for one in own})}" for name, own in some.items())
        lines.append(f"{kind or 'all'} ({'; '.join(heads)})")
        for column, fact in enumerate(FACTS):
            cells = []
            for own in some.values():
                values = np.array([_facts(chain)[column] for chain in own], float)
                cells.append("".join(f"{value:9.3g}" for value in _quantiles(values, _weights(own), (0.1, 0.5, 0.9))))
            lines.append(f"  {fact:<26}" + "  |".join(cells))
        for label, test in (("first link locked [%]", _is_locked), ("without springs [%]", _is_springless)):
            shares = [100 * float(_weights(own) @ [test(one) for one in own] / _weights(own).sum())
                      for own in some.values()]  # fmt: skip
            lines.append(f"  {label:<26}" + "  |".join(f"{'':9}{share:9.3g}{'':9}" for share in shares))
    return "\n".join(lines)


def _is_locked(chain: FileChain) -> bool:
    return chain.locked


def _is_springless(chain: FileChain) -> bool:
    return chain.stiffness <= 0


def _targets(chain: FileChain) -> np.ndarray:
    """What is guessed of a chain: log2 of its limit [rad], of its stiffness, and of what damping leaves."""
    return np.log2([max(chain.limit, LOCKED), max(chain.stiffness, 0.01), max(1 - chain.damping, 1e-3)])


def kind_priors(chains: Sequence[FileChain]) -> dict[str, np.ndarray]:
    """Median limit [rad], stiffness, and damping of each kind, all files alike, shape (3,) each; of all chains under
    "".

    Args:
        chains: Of files.
    """
    out = {}
    for kind in ("", *sorted({chain.kind for chain in chains})):
        own = [chain for chain in chains if kind in ("", chain.kind)]
        values, weights = np.array([_targets(chain) for chain in own]), _weights(own)
        limit, stiffness, left = (2.0 ** _quantiles(column, weights, (0.5,))[0] for column in values.T)
        out[kind] = np.array([limit, stiffness, 1 - left])
    return out


def prior_errors(chains: Sequence[FileChain]) -> dict[str, np.ndarray]:
    """How far guesses are off on files that they were not fitted to, in factors of two: mean absolute error of log2 of
    limit, stiffness, and 1 - damping, all files alike, shape (3,); by one guess for all chains, by the kind, and by the
    kind with a line over the logarithm of the length and over the number of links.

    Args:
        chains: Of several files.
    """
    errors: dict[str, list[np.ndarray]] = {"one for all": [], "by kind": [], "by kind and size": []}
    for file in sorted({chain.file for chain in chains}):
        rest, own = [one for one in chains if one.file != file], [one for one in chains if one.file == file]
        priors, true = kind_priors(rest), np.array([_targets(one) for one in own])
        guess = {
            "one for all": np.array([_logs(priors[""]) for _ in own]),
            "by kind": np.array([_logs(priors.get(one.kind, priors[""])) for one in own]),
        }
        base = np.array([_logs(priors.get(one.kind, priors[""])) for one in rest])
        guess["by kind and size"] = guess["by kind"] + _ridge(
            rest, np.array([_targets(one) for one in rest]) - base, own
        )
        for name, found in guess.items():
            errors[name].append(np.abs(found - true).mean(axis=0))
    return {name: np.mean(rows, axis=0) for name, rows in errors.items()}


def _logs(prior: np.ndarray) -> np.ndarray:
    return np.log2([prior[0], max(prior[1], 0.01), max(1 - prior[2], 1e-3)])


def _ridge(chains: Sequence[FileChain], left: np.ndarray, others: Sequence[FileChain]) -> np.ndarray:
    """What a ridge regression on length and links says of what a guess leaves, shape (C, 3)."""

    def inputs(some: Sequence[FileChain]) -> np.ndarray:
        return np.array([[1.0, np.log2(one.length + 0.01), one.links] for one in some])

    x, weights = inputs(chains), _weights(chains)
    mean, std = np.average(x, axis=0, weights=weights), x.std(axis=0) + 1e-9
    mean[0], std[0] = 0.0, 1.0
    x = (x - mean) / std
    square = x.T @ (x * weights[:, None]) + 0.5 * np.diag([0.0, 1.0, 1.0])
    line = np.linalg.solve(square, x.T @ (left * weights[:, None]))
    return np.asarray((inputs(others) - mean) / std @ line)


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
        "rigid": clip.carried(vertices)[few],
        "chains": moved[few][:, vertices],
        "truth": clip.truth(vertices)[few],
    }
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
    """Over all clips: error over that of rigid apparel, the mean and the median of the clips' own, ELS less the
    truth's, and clips in which something flew away.
    """
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
