"""Which body hangs on which, and who collides with whom."""

import numpy as np
from bodies import body, joint

from bunraku.core.mmd_model import MmdBody
from bunraku.physics.collision import MOST_CLASSES, collision_bits
from bunraku.physics.forest import apparel_forest

PARENTS = np.array([-1, 0, 1, 2, 0])


def hung(bodies, joints):
    forest = apparel_forest(tuple(bodies), tuple(joints), PARENTS)
    return {link.body: (link.parent, link.bone) for link in forest.links}, forest


def test_the_shortest_way_from_a_bone_and_loops():
    bodies = [body("root", 0, [0, 2, 0], 0), *(body(f"b{n}", n, [0, 2 - n, 0]) for n in (1, 2, 3))]
    joints = [joint(2, 1, [0, 1, 0]), joint(0, 1, [0, 2, 0]), joint(2, 3, [0, 0, 0]), joint(0, 3, [1, 0, 0])]
    links, forest = hung(bodies, joints)
    assert links == {1: (-1, 0), 2: (1, -1), 3: (-1, 0)}
    assert [link.turned for link in forest.links if link.body == 2] == [True]  # it is A of its joint
    assert [(loop.a, loop.b) for loop in forest.loops] == [(2, 3)]
    positions = [link.body for link in forest.links]
    assert positions.index(1) < positions.index(2)  # each after what it hangs on


def test_joints_that_let_go_are_the_last_choice():
    bodies = [body("root", 0, [0, 2, 0], 0), *(body(f"b{n}", n, [0, 2 - n, 0]) for n in (1, 2, 3))]
    loose = {"lower": np.ones(3), "upper": -np.ones(3) * [1, 1, 0] + [0, 0, 2]}
    joints = [joint(0, 1, [0, 2, 0]), joint(0, 3, [0, 0, 0], **loose), joint(1, 2, [0, 1, 0]), joint(2, 3, [0, 0, 0])]
    links, forest = hung(bodies, joints)
    assert links[3] == (2, -1) and len(forest.loops) == 1


def test_two_joints_of_one_pair_are_one():
    bodies = [body("root", 0, [0, 2, 0], 0), body("b", 1, [0, 1, 0])]
    _, forest = hung(bodies, [joint(0, 1, [0, 2, 0]), joint(1, 0, [0, 2, 0])])
    assert [turned for _, turned in forest.links[0].more] == [True] and not forest.loops


def test_bodies_without_a_hold_hang_on_their_bones():
    links, forest = hung(
        [body("a", 2, [0, 1, 0]), body("b", 3, [0, 0, 0]), body("free", -1, [5, 5, 5])], [joint(0, 1, [0, 0.5, 0])]
    )
    assert links == {0: (-1, 1), 1: (0, -1), 2: (-1, -1)} and "hang on no body" in forest.notes[0]


def test_bodies_that_follow_a_moved_bone_are_carried():
    bodies = [
        body("root", 0, [0, 2, 0], 0),
        body("b", 1, [0, 1, 0]),
        body("on it", 3, [0, 0, 0], 0),
        body("c", 4, [0, 0, 1]),
    ]
    links, forest = hung(bodies, [joint(0, 1, [0, 2, 0]), joint(2, 3, [0, 0, 0])])
    assert forest.carried == {2: 1} and links == {1: (-1, 0), 3: (1, -1)}


def test_bits_are_the_rule_of_both_masks():
    rng = np.random.default_rng(0)
    bodies: list[MmdBody] = []
    for _ in range(24):
        bodies.append(
            body("b", 0, [0, 0, 0], int(rng.integers(2)), group=int(rng.integers(4)), mask=int(rng.integers(16)))
        )
    moving = [one.dynamic for one in bodies]
    bits, lost = collision_bits(bodies, moving)
    assert lost == 0
    for a, (kind_a, with_a) in zip(bodies, bits, strict=True):
        for b, (kind_b, with_b) in zip(bodies, bits, strict=True):
            wanted = (a.dynamic or b.dynamic) and a.mask >> b.group & 1 and b.mask >> a.group & 1
            assert bool(kind_a & with_b or kind_b & with_a) == bool(wanted)


def test_too_many_kinds_are_counted():
    bodies = [body("b", 0, [0, 0, 0], group=0, mask=2 * n + 1) for n in range(MOST_CLASSES + 5)]
    assert collision_bits(bodies, [True] * len(bodies))[1] == 5
