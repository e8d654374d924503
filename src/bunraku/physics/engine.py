"""MuJoCo, which simulates: a part of the extra `physics`, looked for before any work."""

from __future__ import annotations

from importlib.util import find_spec

from bunraku.errors import MissingExtraError

__all__ = ["check_engine"]


def check_engine(purpose: str) -> None:
    """Whether there is what simulates.

    Args:
        purpose: What asks for it, as the message begins.

    Raises:
        MissingExtraError: It is not installed.
    """
    if find_spec("mujoco") is None:
        raise MissingExtraError("mujoco-core", "physics", purpose)
