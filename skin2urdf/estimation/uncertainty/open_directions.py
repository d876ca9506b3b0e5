"""Ways in which branches of a robot may sit relative to each other that a log does not tell.

Two branches that share nothing but a joint may be slid along its axis, and turned about it where it
is vertical: no reading changes. What is open follows from rank alone. First every joint is moved
together with all that lies beyond it, by a twist of its placement: the directions in which this
changes no reading are exact for finite motions too, and easily told. Then every axis is moved
alone: that is open where a joint hardly moved. What the null space of the joints' information holds
beside these comes last. Motions of a whole limb are no news (nothing but gravity connects limbs),
nor is what moves an SU along its own open directions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.cost import NormalEquations
from skin2urdf.estimation.problem.state import JOINT_COORDINATES, N_JOINT, N_PLACEMENT, State
from skin2urdf.estimation.uncertainty.bounds import ON_BASE, limbs_of
from skin2urdf.estimation.uncertainty.displacements import Displacements
from skin2urdf.geometry.se3 import adjoint, exp, inverse
from skin2urdf.model.records import OpenDirection
from skin2urdf.structure.records import KinematicTree

ALIKE = 0.1
"""Part of a motion that may remain beside others for it to count as one of them."""
_CONFIGURATIONS = 8
_TURNS, _SLIDES = np.pi, 0.3
"""Half the range of these configurations [rad], [m]."""
_TINY = 1e-9
_ABSORBED = {"revolute": [0, 1, 3, 4], "prismatic": [3, 4]}
"""Parts of a twist that a joint's coordinates hold; along and about the axis it moves the rest."""


def open_directions(
    tree: KinematicTree,
    state: State,
    q: F64,
    equations: NormalEquations,
    null: F64,
    lean: F64,
    free: Sequence[F64],
    *,
    least: float,
    arm: float,
) -> tuple[OpenDirection, ...]:
    """Independent open directions between the branches of each limb.

    Of two branches that may move relative to each other the one with fewer SUs does.

    Args:
        tree: the structure.
        state: the estimate.
        q: (P, D) joint positions of the poses it rests on [rad or m].
        equations: information at the estimate.
        null: (k, J) directions of the joints' coordinates that count as open.
        lean: (U, 15, C) how SUs follow the joint coordinates ``equations.columns``.
        free: per SU (k, 6) orthonormal directions (linear, angular times ``arm``) that are open.
        least: information [1/m^2 or 1/rad^2] below which a direction counts as open.
        arm: length that angles are weighed by [m].
    """
    span = np.where(tree.prismatic, _SLIDES, _TURNS)
    far = span * np.random.default_rng(0).uniform(-1.0, 1.0, (_CONFIGURATIONS, tree.n_joints))
    moves = Displacements.of(tree, state, far, arm)
    into_joint, into_su = (adjoint(inverse(T)) for T in (state.T_parent_joint, state.T_joint_su))
    beyond = tuple(np.flatnonzero(column) for column in tree.activity().T)
    known = _Known(tree, equations, least, into_joint, into_su, beyond)
    simple = [*_of_branches(known), *_of_axes(known, q)]
    limbs = limbs_of(tree)
    found: list[OpenDirection] = []
    for limb in np.unique(limbs[limbs != ON_BASE]):
        on = np.flatnonzero(limbs == limb)
        seen = _Limb(moves, on, [free[int(u)] for u in on])
        found += [direction for direction in simple if seen.is_news(direction)]
        basis = _within(tree, null, int(limb))
        left = [_followed(tree, equations, v, lean, on) for v in basis]
        news = seen.news_of(left) @ basis
        found += [_followed(tree, equations, v, lean, on) for v in news]
    return tuple(found)


@dataclass(eq=False)
class _Limb:
    """The motions of a limb's SUs that are accounted for already.

    Attributes:
        moves: motions of all SUs.
        on: (n,) the limb's SUs.
        free: per SU of the limb (k, 6) orthonormal directions.
    """

    moves: Displacements
    on: Int
    free: Sequence[F64]
    _known: F64 = field(init=False)

    def __post_init__(self) -> None:
        base = np.moveaxis(self.moves.by_base, -1, 0)
        _, values, Vt = np.linalg.svd(self._flat(base), full_matrices=False)
        self._known = Vt[values > 1e-6 * values.max(initial=1e-300)]

    def _flat(self, motion: F64) -> F64:
        """(k, N) motions (k, C, U, 6) of this limb without the SUs' own open directions."""
        motion = motion[:, :, self.on]
        mean = motion.mean(axis=1)
        own = np.stack([mean[:, i] @ rows.T @ rows for i, rows in enumerate(self.free)], axis=1)
        return np.asarray((motion - own[:, None]).reshape(len(motion), -1))

    def _beside(self, motion: F64) -> F64:
        """What is left of motions (k, N) beside the known ones."""
        return np.asarray(motion - (motion @ self._known.T) @ self._known)

    def is_news(self, direction: OpenDirection) -> bool:
        """Whether a direction is independent of those that are known; it is from now on."""
        motion = self.moves.along(direction)[None]
        size = float(np.linalg.norm(motion[:, :, self.on]))
        rest = self._beside(self._flat(motion))
        length = float(np.linalg.norm(rest))
        if length <= ALIKE * size:
            return False
        self._known = np.concatenate([self._known, self._beside(rest) / length])
        return True

    def news_of(self, directions: Sequence[OpenDirection]) -> F64:
        """(m, k) weights of k directions in those m combinations that are independent of the known.

        They are orthogonal to the combinations that are known.
        """
        if not directions:
            return np.zeros((0, 0))
        motion = np.stack([self.moves.along(direction) for direction in directions])
        rest = self._beside(self._flat(motion))
        weights, values, _ = np.linalg.svd(rest, full_matrices=False)
        whole = weights.T @ motion[:, :, self.on].reshape(len(motion), -1)
        size = np.linalg.norm(whole, axis=1)
        return np.asarray(weights.T[(values > ALIKE * size) & (values > _TINY)])


def _of_branches(known: _Known) -> Iterator[OpenDirection]:
    """Joints moved with all that lies beyond, the least of it first."""
    for j in sorted(range(known.tree.n_joints), key=lambda j: len(known.beyond[j])):
        values, V = np.linalg.eigh(known.information(j, np.zeros((6, 6))))
        for xi in _slides_and_turns(V[:, values < known.least].T):
            yield OpenDirection({known.tree.joint_names[j]: xi}, {})


def _of_axes(known: _Known, q: F64) -> Iterator[OpenDirection]:
    """Axes moved alone: what they carry stays where it is at the mean of the poses q (P, D)."""
    tree = known.tree
    for j, name in enumerate(tree.joint_names):
        turn = np.zeros(6)
        turn[2 if tree.prismatic[j] else 5] = -q[:, j].mean()
        back = adjoint(exp(turn))
        held = _ABSORBED[tree.joint_types[j]]
        values, V = np.linalg.eigh(known.information(j, back)[np.ix_(held, held)])
        rows = np.zeros((int((values < known.least).sum()), 6))
        rows[:, held] = V[:, values < known.least].T
        for xi in _slides_and_turns(rows):
            joints = {tree.joint_names[k]: -known.into_joint[k] @ back @ xi
                      for k in np.flatnonzero(tree.parent == j)}  # fmt: skip
            sus = {tree.su_names[u]: -known.into_su[u] @ back @ xi
                   for u in np.flatnonzero(tree.su_joint == j)}  # fmt: skip
            yield OpenDirection({name: xi, **joints}, sus)


@dataclass(frozen=True, eq=False)
class _Known:
    """What the readings say of placements.

    Attributes:
        tree: the structure.
        equations: information on local coordinates.
        least: information below which a direction is open.
        into_joint: (D, 6, 6) twists of the frame before each joint seen in the joint's, and
        into_su: (U, 6, 6) those of an SU's joint seen in the SU's.
        beyond: the SUs beyond each joint.
    """

    tree: KinematicTree
    equations: NormalEquations
    least: float
    into_joint: F64
    into_su: F64
    beyond: tuple[Int, ...]

    def information(self, j: int, back: F64) -> F64:
        """(6, 6) information on twists of the placement of joint j, all else carried along.

        Args:
            j: the joint.
            back: (6, 6) by what twist, seen in the frame that it carries, what it carries is moved
                back in turn.
        """
        tree, equations, on = self.tree, self.equations, self.beyond[j]
        x = np.zeros((len(equations.joint), 6))
        passed = np.zeros((tree.n_joints, 6, 6))
        for k in range(j, tree.n_joints):
            moved = np.eye(6) if k == j else self.into_joint[k] @ passed[tree.parent[k]]
            absorbed = _ABSORBED[tree.joint_types[k]]
            passed[k] = moved
            passed[k, absorbed] = 0.0
            held = np.isin(JOINT_COORDINATES, absorbed)[:, None]
            x[N_JOINT * k : N_JOINT * (k + 1)] = held * moved[list(JOINT_COORDINATES)]
            if k == j:
                passed[k] -= back
        y = self.into_su[on] @ passed[tree.su_joint[on]]
        yt = np.swapaxes(y, 1, 2)
        both = yt @ equations.mixed[on, :N_PLACEMENT] @ x[equations.columns[on]]
        own = yt @ equations.su[on, :N_PLACEMENT, :N_PLACEMENT] @ y
        return np.asarray(
            x.T @ equations.joint @ x + (own + both + np.swapaxes(both, 1, 2)).sum(axis=0)
        )


def _slides_and_turns(rows: F64) -> Iterator[F64]:
    """Twists that span orthonormal ones (k, 6): slides of 1 m, then turns of 1 rad."""
    if not len(rows):
        return
    combined, sizes, _ = np.linalg.svd(rows[:, 3:])
    rows = combined.T @ rows
    turning = np.zeros(len(rows), dtype=bool)
    turning[: len(sizes)] = sizes > ALIKE
    slides, turns = rows[~turning], rows[turning]
    yield from slides / np.linalg.norm(slides[:, :3], axis=1, keepdims=True)
    turns[:, :3] -= turns[:, :3] @ slides[:, :3].T @ slides[:, :3]
    yield from turns / np.linalg.norm(turns[:, 3:], axis=1, keepdims=True)


def _within(tree: KinematicTree, null: F64, limb: int) -> F64:
    """(m, J) orthonormal basis of the parts of directions (k, J) that concern a limb's SUs.

    These are the joints of the limb and those before it, and the logs' gravity. No reading of the
    limb tells them either. What is much shorter than the whole direction belongs to other limbs,
    and to rounding.
    """
    inside = np.ones(null.shape[1], dtype=bool)
    before = tree.chain(limb)
    for j in range(tree.n_joints):
        inside[N_JOINT * j : N_JOINT * (j + 1)] = j in before or limb in tree.chain(j)
    _, values, Vt = np.linalg.svd(null * inside, full_matrices=False)
    return np.asarray(Vt[values > ALIKE])


def _followed(
    tree: KinematicTree, equations: NormalEquations, v: F64, lean: F64, on: Int
) -> OpenDirection:
    """A direction (J,) of the joint coordinates and how SUs follow, the largest part of size 1."""
    joints = np.zeros((tree.n_joints, 6))
    joints[:, JOINT_COORDINATES] = v[: N_JOINT * tree.n_joints].reshape(-1, N_JOINT)
    sus = (lean[on, :N_PLACEMENT] @ v[equations.columns[on], None])[..., 0]
    size = max(float(np.abs(joints).max()), float(np.abs(sus).max()))

    def named(names: Sequence[str], twists: F64) -> dict[str, F64]:
        return {
            name: xi / size
            for name, xi in zip(names, twists, strict=True)
            if np.abs(xi).max() > _TINY * size
        }

    return OpenDirection(
        named(tree.joint_names, joints), named([tree.su_names[int(u)] for u in on], sus)
    )
