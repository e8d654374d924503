"""A walk, a dance and kicks made by code: of any length, the same on every machine.

They ask of apparel what people ask of it (strides, rotations, sudden legs), at speeds that people reach.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import HandleMotion, SkeletalMotion, Skeleton
from bunraku.errors import OptionError
from bunraku.generation.features import body_handle_motion

STOCK_MOTIONS = ("walk", "dance", "kick")
_J = {name: index for index, name in enumerate(JOINT_NAMES)}
_SIDES = (("left", 1.0), ("right", -1.0))
_X, _Y, _Z = np.eye(3)


def stock_motion(kind: str, seconds: float = 6.0, fps: float = 30.0) -> HandleMotion:
    """A motion of the reference body.

    Args:
        kind: "walk" (1.2 m/s), "dance" (sways, bends, a spin every six seconds) or "kick" (legs in turn).
        seconds: Its length [s].
        fps: Frames a second [1/s].

    Raises:
        OptionError: There is no such motion.
    """
    makers = {"walk": _walk, "dance": _dance, "kick": _kick}
    if kind not in makers:
        raise OptionError(f"there is no motion '{kind}' made by code; choose {', '.join(makers)}")
    times = np.arange(max(2, round(seconds * fps))) / fps
    rotations = np.tile(np.eye(3), (len(times), JOINT_COUNT, 1, 1))
    path = makers[kind](times, rotations)
    body = reference_body()
    offsets = body.joints - np.where(np.array(JOINT_PARENTS)[:, None] >= 0, body.joints[JOINT_PARENTS,], 0)
    skeleton = Skeleton(JOINT_NAMES, np.array(JOINT_PARENTS), offsets)
    posed = SkeletalMotion(skeleton, rotations, path, fps).world()[1]
    lowest = posed[:, [_J[f"{side}_{part}"] for side in ("left", "right") for part in ("ankle", "foot")], 1].min(axis=1)
    path[:, 1] -= gaussian_filter1d(lowest - lowest.min(), 0.05 * fps, mode="nearest")
    return body_handle_motion(SkeletalMotion(skeleton, rotations, path, fps))


def _turn(axis: np.ndarray, angles: np.ndarray | float) -> np.ndarray:
    return np.asarray(matrix_from_axis_angle(np.multiply.outer(np.asarray(angles, float), axis)))


def _arms(rotations: np.ndarray, low: np.ndarray, swing: np.ndarray, bend: float) -> None:
    """Arms that hang, 0 the T-pose."""
    for column, (side, sign) in enumerate(_SIDES):
        rotations[:, _J[f"{side}_shoulder"]] = _turn(_X, -swing[:, column]) @ _turn(_Z, -sign * low[:, column])
        rotations[:, _J[f"{side}_elbow"]] = _turn(_Y, -sign * bend)


def _legs(rotations: np.ndarray, hips: np.ndarray, knees: np.ndarray) -> None:
    """Thighs forwards and knees bent [rad], shapes (N, 2), left first; feet stay level."""
    for column, (side, _) in enumerate(_SIDES):
        rotations[:, _J[f"{side}_hip"]] = _turn(_X, -hips[:, column])
        rotations[:, _J[f"{side}_knee"]] = _turn(_X, knees[:, column])
        rotations[:, _J[f"{side}_ankle"]] = _turn(_X, 0.7 * (hips[:, column] - knees[:, column]))


def _walk(times: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    phase = np.stack([2 * np.pi * times / 1.1, 2 * np.pi * times / 1.1 + np.pi], axis=1)
    _legs(rotations, 0.05 + 0.42 * np.sin(phase), 0.15 + 0.5 * np.maximum(0, np.cos(phase)) ** 2)
    _arms(rotations, np.full_like(phase, 1.25), -0.35 * np.sin(phase), 0.35)
    rotations[:, 0] = _turn(_Y, -0.08 * np.sin(phase[:, 0])) @ _turn(_Z, 0.04 * np.cos(phase[:, 0]))
    rotations[:, _J["spine2"]] = _turn(_Y, 0.14 * np.sin(phase[:, 0]))
    return np.stack([0.02 * np.sin(phase[:, 0]), np.full(len(times), 1.0), 1.2 * times], axis=1)


def _dance(times: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    beat = 2 * np.pi * times  # 120 a minute, two to a bar
    spin = np.clip((times % 6.0 - 4.0) / 1.2, 0, 1)
    spin = 2 * np.pi * (spin * spin * (3 - 2 * spin))
    both = np.stack([beat, beat + np.pi], axis=1)
    _legs(
        rotations,
        0.3 + 0.25 * np.sin(both) - 0.12 * np.cos(2 * both),
        0.6 + 0.4 * np.sin(both) - 0.2 * np.cos(2 * both),
    )
    _arms(rotations, 0.3 + 0.9 * np.sin(both / 2), 0.6 + 0.5 * np.sin(both / 2 + 1), 0.9)
    rotations[:, 0] = _turn(_Y, spin + 0.5 * np.sin(beat / 2)) @ _turn(_Z, 0.12 * np.sin(beat))
    rotations[:, _J["spine1"]] = _turn(_Z, -0.2 * np.sin(beat))
    rotations[:, _J["spine3"]] = _turn(_X, 0.15 * np.sin(beat / 2))
    rotations[:, _J["head"]] = _turn(_Z, 0.2 * np.sin(beat / 2))
    return np.stack([0.12 * np.sin(beat), np.full(len(times), 1.0), 0.15 * np.sin(beat / 4)], axis=1)


def _kick(times: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    moment = times % 2.0
    left = (times // 2.0).astype(int) % 2 == 0

    def bump(centre: float, width: float) -> np.ndarray:
        return np.asarray(np.exp(-(((moment - centre) / width) ** 2)))

    kicks = np.stack([left, ~left], axis=1)
    hip = -0.35 * bump(0.45, 0.14) + 1.55 * bump(0.85, 0.2)
    knee = 1.0 * bump(0.6, 0.15) + 0.35 * bump(1.15, 0.2)
    _legs(rotations, np.where(kicks, hip[:, None], 0.12), np.where(kicks, 0.1 + knee[:, None], 0.25))
    _arms(rotations, np.full(kicks.shape, 1.0), np.where(kicks, -0.5, 0.6) * bump(0.85, 0.3)[:, None] + 0.5, 1.3)
    sign = np.where(left, 1.0, -1.0)
    rotations[:, 0] = _turn(_Y, -0.25 * sign * bump(0.85, 0.3)) @ _turn(_X, -0.15 * bump(0.85, 0.25))
    rotations[:, _J["spine2"]] = _turn(_X, 0.2 * bump(0.85, 0.25))
    return np.stack([np.zeros(len(times)), np.full(len(times), 1.0), 0.08 * bump(0.85, 0.25)], axis=1)
