"""Which joint of one URDF is which of another: by name, else by order in the tree and geometry.

A vendor's file may call the joints otherwise than the log does. Angle and distance of the axes of
consecutive joints do not depend on where base and frames are; whole limbs are then laid onto each
other, which tells a left arm from its mirror image on the right. Limbs that are built alike go by
how alike their joints are called.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import SequenceMatcher

import numpy as np
from scipy.optimize import linear_sum_assignment

from skin2urdf.arrays import F64
from skin2urdf.geometry import se3
from skin2urdf.geometry.so3 import skew
from skin2urdf.urdf.kinematics import kinematics
from skin2urdf.urdf.loading import Robot

_ANGLE, _DISTANCE = 0.1, 0.03
"""Differences of one unit of misfit [rad], [m]: far above errors of a calibration, and far below
what tells most joints of a robot from each other."""
_SKIPPED = 1.0
"""Misfit of a joint of the other robot that is passed over, such as one that the log locks."""
_NAMES = 0.02
"""Misfit of names that have nothing in common: a tie-break between limbs that are built alike, such
as two legs, and as much as 0.8 deg between axes."""
_BEAM = 12
"""Alternatives that are followed for each branch; a mirrored pair of branches makes two."""
_CONFIGURATIONS = 6
_HOPELESS = 1e6

Match = tuple[float, dict[str, str]]


def matched_joints(est: Robot, true: Robot) -> dict[str, str]:
    """The joints of ``true`` that those of ``est`` are.

    Joints of one name are the same. Where the estimate has others, they go to joints of the same
    type and in the same order along each limb, those whose axes lie most alike.

    Args:
        est: a robot.
        true: another one that should be the same, perhaps with more joints.

    Returns:
        Names in ``true`` by names in ``est``; joints without a counterpart are missing.
    """
    named = {name: name for name in est.joint_types if name in true.joint_types}
    if len(named) == len(est.joint_types):
        return named
    search = _Search(est, true, named)
    roots = [name for name in est.joint_types if len(est.chain_of_joint(name)) == 1]
    targets = list(true.joint_types)
    best: dict[tuple[int, int], Match] = {}
    cost = np.full((len(roots), len(targets)), _HOPELESS)
    for i, root in enumerate(roots):
        for k, target in enumerate(targets):
            found = [
                (price + search.misfit(pairs), pairs) for price, pairs in search.below(root, target)
            ]
            if found:
                best[i, k] = min(found, key=lambda each: each[0])
                cost[i, k] = best[i, k][0]
    result = dict(named)
    rows, columns = linear_sum_assignment(cost)
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        taken = set(result.values())
        pairs = best.get((row, column), (0.0, {}))[1]
        result |= {e: t for e, t in pairs.items() if e not in result and t not in taken}
    return result


def fit_axes(axes_est: F64, axes_true: F64, revolute: Sequence[bool]) -> F64:
    """(4, 4) rigid transform that lays the axes of one robot onto those of another.

    Directions are fitted first, then the places of the revolute axes, each in closed form.

    Args:
        axes_est: (N, D, 6) columns of the Jacobian in the base frame, see
            :func:`skin2urdf.urdf.kinematics.kinematics`.
        axes_true: (N, D, 6) of the same joints of the other robot.
        revolute: D, whether a joint turns.
    """
    turns = np.asarray(revolute, bool)
    est, true = (
        np.where(turns[:, None], axes[..., 3:], axes[..., :3]) for axes in (axes_est, axes_true)
    )
    H = np.einsum("ndi,ndj->ij", est, true)
    lines_est, lines_true = axes_est[:, turns], axes_true[:, turns]
    if np.linalg.svd(H, compute_uv=False)[1] < 1e-3 * est.shape[0] * est.shape[1]:
        # Parallel axes: only where they lie shows a turn about them.
        feet = [np.cross(a[..., 3:], a[..., :3]) for a in (lines_est, lines_true)]
        offsets = [f - f.mean(axis=1, keepdims=True) for f in feet]
        H = H + np.einsum("ndi,ndj->ij", *offsets)
    U, _, Vt = np.linalg.svd(H)
    R = Vt.T @ np.diag([1.0, 1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    X = np.eye(4)
    X[:3, :3] = R
    if turns.any():
        A = -skew(lines_true[..., 3:].reshape(-1, 3))
        b = (lines_true[..., :3] - lines_est[..., :3] @ R.T).reshape(-1, 3)
        X[:3, 3] = np.linalg.lstsq(A.reshape(-1, 3), b.reshape(-1), rcond=1e-9)[0]
    return X


class _Search:
    """Candidates for matches of branches, with what they cost."""

    def __init__(self, est: Robot, true: Robot, named: Mapping[str, str]) -> None:
        self._est, self._true, self._named = est, true, named
        self._axes = [_axes_at_zero(robot) for robot in (est, true)]
        rng = np.random.default_rng(0)
        self._positions = rng.uniform(-1.0, 1.0, (_CONFIGURATIONS, len(est.joint_types)))
        self._children = {
            name: [c for c in est.joint_types if est.chain_of_joint(c)[-2:-1] == (name,)]
            for name in est.joint_types
        }
        self._known: dict[tuple[str, str], list[Match]] = {}

    def below(self, joint: str, target: str) -> list[Match]:
        """Ways to match ``joint`` with ``target`` and all beyond, the best first."""
        if (joint, target) not in self._known:
            self._known[joint, target] = self._below(joint, target)
        return self._known[joint, target]

    def _below(self, joint: str, target: str) -> list[Match]:
        if self._est.joint_types[joint] != self._true.joint_types[target]:
            return []
        if self._named.get(joint, target) != target:
            return []
        if joint not in self._named and target in self._named.values():
            return []
        alike = SequenceMatcher(None, joint.lower(), target.lower()).ratio()
        ways: list[Match] = [(_NAMES * (1.0 - alike), {joint: target})]
        children = self._children[joint]
        for n, child in enumerate(children):
            options = []
            for next_ in self._true.joint_types:
                chain = self._true.chain_of_joint(next_)
                if target not in chain[:-1]:
                    continue
                skipped = len(chain) - 2 - chain.index(target)
                step = _SKIPPED * skipped + self._difference((joint, child), (target, next_))
                options += [(step + cost, pairs) for cost, pairs in self.below(child, next_)]
            ways = sorted(
                (
                    (cost + more, pairs | others)
                    for cost, pairs in ways
                    for more, others in options
                    if self._apart(pairs, children[:n], others[child])
                ),
                key=lambda each: each[0],
            )[:_BEAM]
        return ways

    def _apart(self, pairs: Mapping[str, str], siblings: Sequence[str], target: str) -> bool:
        """Whether a joint of the other robot lies on no branch that a sibling has taken."""
        chain = self._true.chain_of_joint(target)
        taken = [pairs[sibling] for sibling in siblings]
        return not any(t in chain or target in self._true.chain_of_joint(t) for t in taken)

    def _difference(self, ours: tuple[str, str], theirs: tuple[str, str]) -> float:
        """How unlike two pairs of consecutive axes lie."""
        a, b = (
            _relation(axes, pair) for axes, pair in zip(self._axes, (ours, theirs), strict=True)
        )
        return float(np.sum(((a - b) / (_ANGLE, _DISTANCE)) ** 2))

    def misfit(self, pairs: Mapping[str, str]) -> float:
        """How far apart the axes of matched joints are once their limb is laid onto the other."""
        names = list(pairs)
        columns = [list(self._est.joint_types).index(name) for name in names]
        q = self._positions[:, columns]
        _, est = kinematics(self._est, (), names, q)
        _, true = kinematics(self._true, (), [pairs[name] for name in names], q)
        turns = [self._est.joint_types[name] == "revolute" for name in names]
        moved = est @ se3.adjoint(fit_axes(est, true, turns)).T
        part = np.where(turns, 1.0, 0.0)[:, None]
        angles = np.where(part > 0, (moved - true)[..., 3:], (moved - true)[..., :3]) / _ANGLE
        shifts = part * (moved - true)[..., :3] / _DISTANCE
        return float((np.sum(angles**2) + np.sum(shifts**2)) / len(q))


def _axes_at_zero(robot: Robot) -> dict[str, F64]:
    """(6,) axes of all joints, all at position 0, by name."""
    names = list(robot.joint_types)
    _, axes = kinematics(robot, (), names, np.zeros((1, len(names))))
    return dict(zip(names, axes[0], strict=True))


def _relation(axes: Mapping[str, F64], pair: tuple[str, str]) -> F64:
    """(2,) angle between two axes [rad] and the distance of their lines [m]; 0 for what slides."""
    (v, w), (v2, w2) = ((axes[name][:3], axes[name][3:]) for name in pair)
    turning = [bool(np.any(direction)) for direction in (w, w2)]
    a, b = (w if turning[0] else v), (w2 if turning[1] else v2)
    cross = np.cross(a, b)
    angle = float(np.arctan2(np.linalg.norm(cross), a @ b))
    if not all(turning):
        return np.array([angle, 0.0])
    feet = np.cross(w2, v2) - np.cross(w, v)
    sine = float(np.linalg.norm(cross))
    if sine < 1e-3:
        return np.array([angle, float(np.linalg.norm(feet - (feet @ w) * w))])
    return np.array([angle, abs(float(feet @ cross)) / sine])
