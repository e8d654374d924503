"""How the chains of a character swing by what its file says: limits, springs, damping and mass of their links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bunraku.apparel.clothed import FREE, GRAVITY
from bunraku.body.layout import JOINT_COUNT
from bunraku.core.character import Character
from bunraku.physics.chains.from_bones import bone_chains
from bunraku.physics.chains.laid import LaidChains
from bunraku.physics.from_file import apparel_rig
from bunraku.physics.told.bending import NEWTON_METRE, bending_limits, body_springs

__all__ = ["FACTS", "ToldChain", "kind_priors", "prior_errors", "told_chains", "told_manners", "told_table"]

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
class ToldChain:
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


def told_chains(character: Character) -> list[ToldChain]:
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
            ToldChain(
                character.name, chain.kind, len(own), chain.length / character.height,
                tuple(float(limits[number]) for number in own), float(np.median(ratios)),
                float(np.mean([body.linear_damping for body in bodies])), float(mass[0]),
                tuple(int(chain.bones[place]) for place in rows),
            )
        )  # fmt: skip
    return out


def told_manners(laid: LaidChains, character: Character) -> LaidChains:
    """Chains laid over a shape that swing by what the file says of those that hold the same vertices there: as far in
    all, by links of their own, with its springs, damping and mass.

    Args:
        laid: Over the character's mesh.
        character: With a rig and physics.
    """
    rig, told = character.rig, told_chains(character)
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


def _facts(chain: ToldChain) -> tuple[float, ...]:
    whole = np.degrees(min(sum(chain.limits), FREE))
    return (chain.links, 100 * chain.length, float(np.degrees(chain.limit)), float(whole), chain.stiffness,
            chain.damping, chain.mass)  # fmt: skip


def _weights(chains: Sequence[ToldChain]) -> np.ndarray:
    """All characters count alike, however many chains they have, shape (C,)."""
    counts: dict[str, int] = {}
    for chain in chains:
        counts[chain.file] = counts.get(chain.file, 0) + 1
    return np.array([1 / counts[chain.file] for chain in chains])


def _quantiles(values: np.ndarray, weights: np.ndarray, shares: Sequence[float]) -> np.ndarray:
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order]) / weights.sum()
    return np.asarray(values[order][np.minimum(np.searchsorted(total, shares), len(values) - 1)])


def told_table(groups: Mapping[str, Sequence[ToldChain]]) -> str:
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


def _is_locked(chain: ToldChain) -> bool:
    return chain.locked


def _is_springless(chain: ToldChain) -> bool:
    return chain.stiffness <= 0


def _targets(chain: ToldChain) -> np.ndarray:
    """What is guessed of a chain: log2 of its limit [rad], of its stiffness, and of what damping leaves."""
    return np.log2([max(chain.limit, LOCKED), max(chain.stiffness, 0.01), max(1 - chain.damping, 1e-3)])


def kind_priors(chains: Sequence[ToldChain]) -> dict[str, np.ndarray]:
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


def prior_errors(chains: Sequence[ToldChain]) -> dict[str, np.ndarray]:
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


def _ridge(chains: Sequence[ToldChain], left: np.ndarray, others: Sequence[ToldChain]) -> np.ndarray:
    """What a ridge regression on length and links says of what a guess leaves, shape (C, 3)."""

    def inputs(some: Sequence[ToldChain]) -> np.ndarray:
        return np.array([[1.0, np.log2(one.length + 0.01), one.links] for one in some])

    x, weights = inputs(chains), _weights(chains)
    mean, std = np.average(x, axis=0, weights=weights), x.std(axis=0) + 1e-9
    mean[0], std[0] = 0.0, 1.0
    x = (x - mean) / std
    square = x.T @ (x * weights[:, None]) + 0.5 * np.diag([0.0, 1.0, 1.0])
    line = np.linalg.solve(square, x.T @ (left * weights[:, None]))
    return np.asarray((inputs(others) - mean) / std @ line)
