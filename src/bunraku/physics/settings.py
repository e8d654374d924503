"""The numbers of the simulation that no file holds."""

from __future__ import annotations

from dataclasses import dataclass

from bunraku.core.mmd_model import MMD_METRE
from bunraku.errors import OptionError

__all__ = ["PhysicsSettings"]


@dataclass(frozen=True)
class PhysicsSettings:
    """How a character's bodies become a world, and what counts as flying away.

    Args:
        gravity: Downwards [m/s^2]; MMD's 98 units a second squared by default.
        step: Longest time step [s].
        air: The largest rate at which bodies lose speed against the air [1/s]. What a file asks for beyond that is
            friction in the joints.
        most_rate: The largest rate at which bodies lose speed at all [1/s].
        least_ratio: Damping of every joint, as a share of the critical one, is at least this.
        fastest: Springs swing at most this fast [rad/s].
        loop_time: Time in which a joint that closes a loop pulls its bodies together [s].
        limbs: Whether the body's mesh is a collider, bone by bone (`limbs`), for all apparel; None for apparel that no
            collider of the file meets.
        nearby: Apparel collides with those limbs that are nearer than this at rest [m].
        most_speed: A body that moves faster against its anchor has flown away [m/s].
        most_turn: Joints turn at most this fast [rad/s].
        patience: A body that would turn faster for longer than this has flown away [s].
        cut: A bone that is faster than this has jumped, and takes its apparel with it [m/s].

    Raises:
        OptionError: A value is negative or no number, or the time step is not from 0.1 to 20 ms.
    """

    gravity: float = 98 * MMD_METRE
    step: float = 1 / 240
    air: float = 1.5
    most_rate: float = 30.0
    least_ratio: float = 0.15
    fastest: float = 75.0
    loop_time: float = 0.02
    limbs: bool | None = None
    nearby: float = 0.12
    most_speed: float = 30.0
    most_turn: float = 100.0
    patience: float = 0.1
    cut: float = 25.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is not None and not (0 <= value < float("inf")):
                raise OptionError(f"the physics setting '{name}' must be a number of 0 or more, not {value}")
        if not 1e-4 <= self.step <= 0.02:
            raise OptionError(f"the time step of physics must be from 0.0001 to 0.02 s, not {self.step:g}")
