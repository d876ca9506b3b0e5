"""Random poses in which nothing touches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.errors import PlanError
from skin2urdf.planning.records import Limits, PlanSettings

IsFree = Callable[[F64], bool]
"""Whether nothing touches in a pose (D,)."""

_TRIES = 2000
"""Random poses that are tried before none is taken to be free."""
_EASY = 5
"""Poses drawn from the whole range before the latest one is changed joint by joint instead."""
_CLEAR = (0.05, 5e-3)
"""Room kept to limits of positions for sag and overshoot [rad, m]."""


def pose_range(limits: Limits, settings: PlanSettings, swing: F64) -> tuple[F64, F64]:
    """(D,) lowest and highest pose from which a pattern stays inside the limits.

    A missing limit stands as far from the other as the poses reach, or around 0.

    Args:
        limits: of positions.
        settings: how far poses reach.
        swing: (D,) how far patterns go to either side [rad or m].
    """
    lower, upper = limits.lower, limits.upper
    reach = np.where(limits.prismatic, settings.half_range[1], settings.half_range[0])
    bottom = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, reach))
    bottom = bottom - np.where(np.isfinite(lower), 0.0, 2.0 * reach)
    top = np.where(np.isfinite(upper), upper, bottom + 2.0 * reach)
    room = top - bottom
    clear = np.minimum(np.where(limits.prismatic, _CLEAR[1], _CLEAR[0]), 0.05 * room)
    half = np.minimum(reach, 0.5 * room - clear - swing)
    middle = 0.5 * (bottom + top)
    return middle - half, middle + half


def free_poses(
    low: F64,
    high: F64,
    number: int,
    is_free: IsFree,
    rng: np.random.Generator,
    crowded: str = "",
) -> F64:
    """Random poses in which nothing touches.

    Where nearly all poses of the whole range are free they are drawn from it. Limbs of a humanoid
    hardly ever are: the pose before is changed, one joint after the other, each by what keeps it
    free (Gibbs sampling of the free space).

    Args:
        low: (D,) lowest, and
        high: (D,) highest positions [rad or m].
        number: how many.
        is_free: tells free poses.
        rng: draws them.
        crowded: what is in the way most, for the words of the error.

    Returns:
        (number, D) poses.

    Raises:
        PlanError: none is found.
    """
    here = _first(low, high, is_free, rng, crowded)
    out = np.empty((number, len(low)))
    easy = True
    for i in range(number):
        drawn = None
        if easy:
            tries = rng.uniform(low, high, (_EASY, len(low)))
            drawn = next((q for q in tries if is_free(q)), None)
            easy = drawn is not None or i > 5 * _EASY
        if drawn is None:
            drawn = _stirred(here, low, high, is_free, rng)
        out[i] = here = drawn
    return out


def _first(low: F64, high: F64, is_free: IsFree, rng: np.random.Generator, crowded: str) -> F64:
    """A free pose: the middle of the ranges, or near zero, or one further and further from them."""
    middle, zero = 0.5 * (low + high), np.clip(0.0, low, high)
    for i in range(_TRIES):
        share = i / _TRIES
        near = (middle, zero)[i % 2]
        pose = near + share * (rng.uniform(low, high) - near)
        if is_free(pose):
            return pose
    raise PlanError(
        f"the robot touches itself, or what is around it, in all of {_TRIES} poses",
        f"check the shapes in the URDF's <collision>{crowded}, name links that may touch (--srdf), "
        "lock joints, or plan without shapes (--no-collisions)",
    )


def _stirred(pose: F64, low: F64, high: F64, is_free: IsFree, rng: np.random.Generator) -> F64:
    """The pose with every joint drawn anew, where that leaves it free."""
    pose = pose.copy()
    for joint in rng.permutation(len(pose)):
        old = pose[joint]
        pose[joint] = rng.uniform(low[joint], high[joint])
        if not is_free(pose):
            pose[joint] = old
    return pose
