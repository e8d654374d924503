import math

import torch

from bunraku.body.layout import HANDLE_NAMES
from bunraku_lab.training.losses.spring_loss import LIMB_SPRINGS, spring_loss, springs_present


def test_the_springs_are_those_of_arms_and_legs():
    names = {(HANDLE_NAMES[a], HANDLE_NAMES[b]) for a, b in LIMB_SPRINGS}
    assert len(names) == 12 and ("left_hip", "left_knee") in names and ("right_wrist", "right_fingers") in names
    assert not any("spine" in a or "head" in b for a, b in names)


def test_spring_loss_by_hand():
    """Eq. 7 for one spring of rest length 0.5 that is 0.6 long in frame 1 and 0.55 in frame 2, sigma 0.1."""
    second = LIMB_SPRINGS[0][1]
    rest, positions = torch.zeros(1, 30, 3), torch.zeros(1, 2, 30, 3)
    rest[0, second, 1] = 0.5
    positions[0, 0, second, 1], positions[0, 1, second, 0] = 0.6, 0.55
    springs = torch.zeros(1, 12, dtype=torch.bool)
    springs[0, 0] = True
    want = math.exp(-0.6) * (0.1**2 + 0.05**2) + 0.1**2 + 0.05**2
    assert math.isclose(float(spring_loss(positions, rest, springs, 0.1)), want, rel_tol=1e-4)
    assert float(spring_loss(positions, rest, torch.zeros_like(springs), 0.1)) == 0  # absent handles have no springs
    turned = rest[:, None] @ torch.tensor([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + 3
    assert float(spring_loss(turned, rest, springs)) < 1e-10  # rigid motion


def test_a_spring_needs_both_ends():
    present = torch.ones(30, dtype=torch.bool)
    roles = torch.arange(30)
    present[HANDLE_NAMES.index("left_knee")] = False
    roles[HANDLE_NAMES.index("right_wrist")] = HANDLE_NAMES.index("right_ankle")  # plays another part
    kept = {LIMB_SPRINGS[i] for i in torch.nonzero(springs_present(present, roles)).flatten().tolist()}
    gone = {(HANDLE_NAMES[a], HANDLE_NAMES[b]) for a, b in set(LIMB_SPRINGS) - kept}
    assert gone == {
        ("left_hip", "left_knee"),
        ("left_knee", "left_ankle"),
        ("right_elbow", "right_wrist"),
        ("right_wrist", "right_fingers"),
    }
