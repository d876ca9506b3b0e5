"""Whether an SU sits on the base or on a first joint that turns about the vertical.

That joint turns no gravity. An SU on it feels its lever arm alone, in accelerations that slow moves
keep small, and one on a base that gives way feels the same joint move. So the arm is regressed from
all samples, with the deviation that separate moves show, and held against what else the SU feels
that follows the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.trajectory.problem import MotionProblem
from skin2urdf.geometry.so3 import skew
from skin2urdf.notes import Note
from skin2urdf.structure.records import KinematicTree

_VERTICAL = 0.05
"""Sine of the angle to gravity up to which an axis counts as vertical."""
NEAREST = 0.01
"""Lever arm [m] of an SU on a segment at the least: the width of its case, so that one whose case
covers the axis is left aside."""
_SIGNIFICANT = 4.0
"""Standard deviations from which an arm is none of chance."""
_STRETCH = 4.0
"""Length of stretches [s] whose errors count as independent, and of which every other one is
predicted from the rest: longer than most moves."""
_FEWEST = 8
"""Stretches from which their scatter tells a deviation."""


@dataclass(frozen=True)
class Arm:
    """The lever arm of an SU about a vertical axis, as all samples show it.

    Attributes:
        su: the SU.
        joint: the first joint, which is vertical.
        on_joint: whether the tree has it on that joint, rather than on the base.
        reach: distance from the axis [m] up to which the SU may sit on the joint.
        shown: whether the samples show where it sits.
    """

    su: str
    joint: str
    on_joint: bool
    reach: float
    shown: bool


def notes_on_vertical_joints(
    tree: KinematicTree, state: State, along: MotionEstimate | None
) -> tuple[Note, ...]:
    """SUs on the base that may sit on a vertical first joint, and the other way round.

    Args:
        tree: the structure.
        state: the estimate.
        along: the fit of all samples; None where there is none, and nothing tells how far from
            the axis SUs may sit.
    """
    if along is None:
        on_base = [n for n, j in zip(tree.su_names, tree.su_joint, strict=True) if j < 0]
        joints = [tree.joint_names[j] for j in _vertical(tree, state)] if len(on_base) > 1 else []
        return tuple(Note("vertical axis", tuple(on_base), (j,), detail="inactive") for j in joints)
    several = int((tree.su_joint < 0).sum()) > 1
    groups: dict[tuple[str, bool, bool], list[Arm]] = {}
    for arm in arms(along.problem, along.state):
        # Of several on the base one may always sit on the axis itself.
        if not arm.shown or (several and not arm.on_joint):
            groups.setdefault((arm.joint, arm.on_joint, arm.shown), []).append(arm)
    return tuple(map(_note, groups.values()))


def _note(doubtful: Sequence[Arm]) -> Note:
    """One note on SUs of which the same is in doubt."""
    first = doubtful[0]
    return Note(
        "vertical axis", tuple(arm.su for arm in doubtful), (first.joint,),
        detail="active" if first.on_joint else "inactive",
        size=max(arm.reach for arm in doubtful),
    )  # fmt: skip


def _vertical(tree: KinematicTree, state: State) -> list[int]:
    """First joints that turn about the vertical in all logs."""
    return [
        j
        for j in np.flatnonzero((tree.parent < 0) & ~tree.prismatic).tolist()
        if np.linalg.norm(np.cross(state.up, state.T_parent_joint[j, :3, 2]), axis=1).max()
        < _VERTICAL
    ]


def may_sit_on_the_base(
    problem: MotionProblem, state: State, within: float = np.inf
) -> tuple[str, ...]:
    """SUs on a vertical first joint whose arms do not show that they sit there.

    Args:
        problem: the logs and the structure.
        state: the estimate.
        within: distance from the axis that they may not be beyond [m].
    """
    found = arms(problem, state)
    return tuple(a.su for a in found if a.on_joint and not a.shown and a.reach < within)


def arms(problem: MotionProblem, state: State) -> tuple[Arm, ...]:
    """The arms of SUs that sit on the base, or on a first joint that is vertical in all logs.

    Args:
        problem: the logs and the structure.
        state: the estimate.

    Returns:
        Those of SUs without a gyroscope, which would tell; none of SUs without samples.
    """
    tree = problem.tree
    pairs = [
        (u, j)
        for j in _vertical(tree, state)
        for u in np.flatnonzero((tree.su_joint < 0) | (tree.su_joint == j)).tolist()
    ]
    found = [_arm(problem, u, j) for u, j in pairs]
    return tuple(arm for arm in found if arm is not None)


def _arm(problem: MotionProblem, u: int, j: int) -> Arm | None:
    """The arm of SU u about the axis of joint j."""
    logs, tree = problem.logs, problem.tree
    if any(log.turning is not None and log.turning[:, u].any() for log in logs):
        return None
    columns, left, functions, stretch = [], [], [], []
    begun = 0
    for log in logs:
        use = log.valid[:, u]
        at = log.kept[use]
        if not use.any():
            continue
        y = log.readings[at, u]
        up = y.mean(axis=0) / np.linalg.norm(y.mean(axis=0))
        across = np.eye(3) - np.outer(up, up)
        turn = np.einsum("n,ij->nij", log.qdd[at, j], skew(up))
        pull = np.einsum("n,ij->nij", log.qd[at, j] ** 2, across)
        columns.append(_centred((turn - pull) @ np.linalg.svd(across)[0][:, :2]))
        left.append(_centred(y @ across))
        functions.append(_centred(_positions(log.q[at], tree.prismatic)))
        part = ((log.time[use] - log.time[0]) // _STRETCH).astype(np.int64)
        stretch.append(begun + part)
        begun += int(part.max()) + 1
    if not left or len(np.unique(np.concatenate(stretch))) < _FEWEST:
        return None
    A, y, F, part = map(np.concatenate, (columns, left, functions, stretch))
    if not A.any():
        return None
    p, sd = _with_deviation(A, y, part)
    on_joint = bool(tree.su_joint[u] == j)
    length = float(np.linalg.norm(p))
    reach = length + _SIGNIFICANT * sd
    if on_joint:
        explained, rest = _foretold(A.reshape(-1, 2), y.reshape(-1, 1), np.repeat(part, 3))
        beside, _ = _foretold(F, rest.reshape(y.shape), part)
        # So near the axis hardly any case fits on a segment, and a base that shakes does as much.
        shown = length > _SIGNIFICANT * sd and explained > beside and reach >= NEAREST
    else:
        shown = reach < NEAREST
    return Arm(tree.su_names[u], tree.joint_names[j], on_joint, reach, shown)


def _positions(q: F64, prismatic: Bool) -> F64:
    """(n, F) functions of the joints' positions that a base leans with."""
    turns = [q[:, [j]] if slides else np.stack([np.sin(q[:, j]), np.cos(q[:, j])], axis=1)
             for j, slides in enumerate(prismatic)]  # fmt: skip
    return np.hstack(turns)


def _centred(x: F64) -> F64:
    """Samples (n, ..) less their mean."""
    return np.asarray(x - x.mean(axis=0))


def _with_deviation(A: F64, y: F64, stretch: Int) -> tuple[F64, float]:
    """The arm (2,) [m], and its deviation in the direction that is known worst."""
    inverse = np.linalg.pinv(np.einsum("nia,nib->ab", A, A))
    p = inverse @ np.einsum("nia,ni->a", A, y)
    each = np.einsum("nia,ni->na", A, y - A @ p)
    scores = np.stack([np.bincount(stretch, column) for column in each.T], axis=1)
    covariance = inverse @ (scores.T @ scores) @ inverse
    return p, float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def _foretold(A: F64, y: F64, stretch: Int) -> tuple[float, F64]:
    """Sum of squares of y (n, k) that columns (n, m) foretell of stretches they are not fitted to.

    Returns:
        It, and y less what the columns explain of all stretches together.
    """
    even = stretch % 2 == 0
    explained = 0.0
    for here in (even, ~even):
        x = np.linalg.lstsq(A[~here], y[~here], rcond=None)[0]
        explained += float((y[here] ** 2).sum() - ((y[here] - A[here] @ x) ** 2).sum())
    return explained, y - A @ np.linalg.lstsq(A, y, rcond=None)[0]
