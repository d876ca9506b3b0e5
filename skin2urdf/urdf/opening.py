"""An estimate moved along its open directions to where it fits the truth best.

Branches that a log does not connect may sit anywhere along those directions. One amplitude for each
is fitted together with the transforms of all limbs that it moves; what remains counts. Finite
motions are followed exactly, so that a branch may be half a turn about a vertical axis away.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.errors import UsageError
from skin2urdf.geometry import se3
from skin2urdf.geometry.se3 import inverse
from skin2urdf.model.records import OpenDirection
from skin2urdf.urdf.alignment import ARM, displace, projector, starts
from skin2urdf.urdf.descent import descended
from skin2urdf.urdf.kinematics import kinematics, placements
from skin2urdf.urdf.loading import Robot

NEWS = 0.01
"""Part of a motion along an open direction that must remain beside motions of the base.

A direction that the compared configurations hardly tell from these would take a huge amplitude.
"""
_SCALE = np.array([1.0, 1.0, 1.0, ARM, ARM, ARM])
_TURN = 2.0 * np.pi / 3.0
"""Turns to start from, either way: any angle is within a sixth of a full turn of one of three."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What an estimate is held against.

    Attributes:
        names: U SUs.
        T_true_su: (N, U, 4, 4) their true poses at N configurations.
        free: U arrays (k, 6) of directions, see :func:`skin2urdf.urdf.alignment.align`.
        joints: D joints.
        positions: (N, D) their positions.
    """

    names: Sequence[str]
    T_true_su: F64
    free: Sequence[F64]
    joints: Sequence[str]
    positions: F64

    def at(self, configurations: slice) -> Sight:
        """Some of the configurations only."""
        some = configurations
        return replace(self, T_true_su=self.T_true_su[some], positions=self.positions[some])

    def of(self, on: Bool) -> Sight:
        """Some of the SUs (U,) only."""
        rows = np.flatnonzero(on)
        names, free = [self.names[int(u)] for u in rows], [self.free[int(u)] for u in rows]
        return replace(self, names=names, T_true_su=self.T_true_su[:, rows], free=free)


def held_by(robot: Robot, directions: Sequence[OpenDirection]) -> list[OpenDirection]:
    """Open directions of the joints and SUs that a robot has.

    Raises:
        UsageError: a direction moves a joint that the robot does not have.
    """
    for name in (name for direction in directions for name in direction.joints):
        if name not in robot.joint_types:
            raise UsageError(
                f"an open direction moves joint {name!r}, which {robot.path} does not have",
                "take the directions and the URDF from the same calibration",
            )
    return [
        replace(each, sus={name: xi for name, xi in each.sus.items() if name in robot.links})
        for each in directions
    ]


def moved_by(robot: Robot, directions: Sequence[OpenDirection], sus: Sequence[str]) -> Bool:
    """(K, U) which SUs each of K open directions moves."""
    chains = [set(robot.chain(su)) for su in sus]
    moved = [
        [su in each.sus or not chain.isdisjoint(each.joints)
         for su, chain in zip(sus, chains, strict=True)]
        for each in directions
    ]  # fmt: skip
    return np.array(moved, dtype=bool).reshape(-1, len(sus))


def closest(
    robot: Robot,
    directions: Sequence[OpenDirection],
    sight: Sight,
    groups: Sequence[str],
    anchors: Bool,
) -> Robot:
    """The robot moved along open directions to where it fits best.

    Args:
        robot: the estimate.
        directions: K open directions of its joints and SUs.
        sight: U SUs.
        groups: name of the group that each SU is aligned with.
        anchors: (U,) the SUs to fit by.
    """
    moved = moved_by(robot, directions, sight.names)
    for together in _moved_together(moved & anchors, groups):
        here = np.array([each in together for each in groups])
        mine = (moved & here & anchors).any(axis=1)
        # What anchors hardly tell from motions of the base may move others by metres.
        on = here & (anchors | moved[mine].any(axis=0))
        some = [each for each, is_mine in zip(directions, mine, strict=True) if is_mine]
        limb = [together.index(each) for each, is_on in zip(groups, on, strict=True) if is_on]
        robot = _fitted(robot, some, _Limbs(sight.of(on), np.array(limb)))
    return robot


def _moved_together(moved: Bool, groups: Sequence[str]) -> list[list[str]]:
    """Names of groups that open directions move, those that one of these moves in one list.

    Args:
        moved: (K, U) the SUs that each direction moves.
        groups: U names.
    """
    found: list[list[str]] = []
    for sus in moved:
        mine = list(dict.fromkeys(each for each, on in zip(groups, sus, strict=True) if on))
        apart = [each for each in found if set(each).isdisjoint(mine)]
        joined = [name for each in found if each not in apart for name in each]
        found = [*apart, list(dict.fromkeys([*joined, *mine]))] if mine else found
    return found


@dataclass(frozen=True, eq=False)
class _Limbs:
    """SUs of G limbs, each of which is laid onto the truth by a transform of its own.

    Attributes:
        sight: the SUs that limbs are aligned by, and their true poses.
        limb: (U,) number of each SU's limb.
    """

    sight: Sight
    limb: Int

    def __len__(self) -> int:
        return int(self.limb.max()) + 1


def _fitted(robot: Robot, directions: Sequence[OpenDirection], limbs: _Limbs) -> Robot:
    """The robot moved along open directions to where its SUs fit best.

    Args:
        robot: the estimate.
        directions: those that move SUs of these limbs.
        limbs: the SUs.
    """
    best, least = _descended(robot, directions, limbs)
    for direction in directions:
        if len(direction.joints) > 1 or direction.sus or not _turns(direction):
            continue  # only a branch that turns as a whole may be far away
        starts = [_moved(best, [direction], [angle]) for angle in (_TURN, -_TURN)]
        for start in starts:
            other, cost = _descended(start, directions, limbs)
            if cost < least:
                best, least = other, cost
    return best


def _turns(direction: OpenDirection) -> bool:
    """Whether a direction turns what it moves, rather than sliding it."""
    return any(
        np.linalg.norm(xi[3:]) > np.linalg.norm(xi[:3]) / 10 for xi in direction.joints.values()
    )


def _descended(
    robot: Robot, directions: Sequence[OpenDirection], limbs: _Limbs
) -> tuple[Robot, float]:
    """The best of where Gauss-Newton leads from the limbs' first transforms; see :func:`_from`."""
    sight = limbs.sight
    P = np.stack([projector(rows) for rows in sight.free])
    moves = moved_by(robot, directions, sight.names).any(axis=0)
    T, _ = _motions(robot, directions, sight)
    begun = []
    for g in range(len(limbs)):
        mine = limbs.limb == g
        still = mine & ~moves if (mine & ~moves).any() else mine
        begun.append(starts(T[:, still], sight.T_true_su[:, still], P[still]))
    most = max(map(len, begun))
    ways = [np.stack([own[min(way, len(own) - 1)] for own in begun]) for way in range(most)]
    found = [_from(X, robot, directions, limbs, P) for X in ways]
    return min(found, key=lambda each: each[1])


@dataclass(frozen=True, eq=False)
class _Seen:
    """A robot X (G, 4, 4) from the truth's base, with motions as :func:`_motions`, and D.

    The latter, D (U, 4, 4), are displacements along SUs' free directions that fit best.
    """

    X: F64
    robot: Robot
    T: F64
    along: F64
    D: F64


def _from(
    X: F64, robot: Robot, directions: Sequence[OpenDirection], limbs: _Limbs, P: F64
) -> tuple[Robot, float]:
    """Gauss-Newton over limbs' transforms and the amplitudes, SUs displaced where they may be.

    Returns:
        The best robot and its sum of squares.
    """
    sight, limb, n_base = limbs.sight, limbs.limb, 6 * len(limbs)

    def seen(X: F64, robot: Robot) -> _Seen:
        T, along = _motions(robot, directions, sight)
        return _Seen(X, robot, T, along, displace(X[limb] @ T, sight.T_true_su, P))

    def left(here: _Seen) -> F64:
        T = here.X[limb] @ here.T @ here.D
        return np.asarray(se3.log(inverse(T) @ sight.T_true_su) * _SCALE)

    def linear(here: _Seen, _: F64) -> tuple[F64, Callable[[F64], _Seen]]:
        back = inverse(here.D)
        of_base = np.zeros((*here.T.shape[:2], 6, n_base))
        for u, g in enumerate(limb):
            of_base[:, u, :, 6 * g : 6 * g + 6] = se3.adjoint(inverse(here.T[:, u] @ here.D[u]))
        A = np.concatenate([of_base, se3.adjoint(back) @ here.along], axis=-1)
        A = _SCALE[:, None] * A
        A = (A - P @ A.mean(axis=0)).reshape(-1, n_base + len(directions))
        kept = _kept(A, n_base)

        def moved(some: F64) -> _Seen:
            step = np.zeros(A.shape[1])
            step[kept] = some
            robot = _moved(here.robot, directions, step[n_base:].tolist())
            return seen(here.X @ se3.exp(step[:n_base].reshape(-1, 6)), robot)

        return A[:, kept], moved

    best, cost = descended(seen(X, robot), left, linear)
    return best.robot, cost


def _motions(robot: Robot, directions: Sequence[OpenDirection], sight: Sight) -> tuple[F64, F64]:
    """(N, U, 4, 4) SU poses, and (N, U, 6, K) their twists along directions in their own frames."""
    T, _ = kinematics(robot, sight.names, sight.joints, sight.positions)
    names = sorted({name for direction in directions for name in direction.joints})
    placed = placements(robot, names, sight.joints, sight.positions)
    along = np.zeros((*T.shape[:2], 6, len(directions)))
    for u, su in enumerate(sight.names):
        chain = set(robot.chain(su))
        for i, name in enumerate(names):
            if name in chain:
                xi = [d.joints.get(name, np.zeros(6)) for d in directions]
                along[:, u] += se3.adjoint(inverse(T[:, u]) @ placed[:, i]) @ np.array(xi).T
        along[:, u] += np.array([d.sus.get(su, np.zeros(6)) for d in directions]).T
    return T, along


def _kept(A: F64, n_base: int) -> Int:
    """Columns of (n, n_base + K) to fit: the bases', and what open directions add to them."""
    base, rest = A[:, :n_base], A[:, n_base:]
    left = rest - base @ np.linalg.lstsq(base, rest, rcond=1e-10)[0]
    news = np.linalg.norm(left, axis=0) > NEWS * np.linalg.norm(rest, axis=0)
    return np.concatenate([np.arange(n_base), n_base + np.flatnonzero(news)])


def _moved(robot: Robot, directions: Sequence[OpenDirection], amplitudes: Sequence[float]) -> Robot:
    """The robot moved along directions."""

    def total(parts: Sequence[Mapping[str, F64]]) -> dict[str, F64]:
        out: dict[str, F64] = {}
        for amplitude, part in zip(amplitudes, parts, strict=True):
            for name, xi in part.items():
                out[name] = out.get(name, np.zeros(6)) + amplitude * xi
        return out

    return robot.displaced(
        total([d.joints for d in directions]), total([d.sus for d in directions])
    )
