"""Ways in which branches of a robot may sit relative to each other that a log does not tell.

Two branches that share nothing but a joint may be slid along its axis, and turned about it where it
is vertical: no reading changes. What is open follows from rank alone, in two steps. First every
joint is moved together with all that lies beyond it, by a twist of its placement: the directions
in which this changes no reading are exact for finite motions too, and easily told. What the null
space of the joints' information holds beside these comes next. Motions of a whole limb are no news
(nothing but gravity connects limbs), nor is what moves an SU along its own open directions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.bounds import ON_BASE, limbs_of
from skin2urdf.estimation.cost import NormalEquations
from skin2urdf.estimation.displacements import Displacements
from skin2urdf.estimation.state import JOINT_COORDINATES, N_JOINT, N_PLACEMENT, State
from skin2urdf.model.records import OpenDirection
from skin2urdf.model.spatial import inverse
from skin2urdf.model.twists import adjoint
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
        equations: information at the estimate.
        null: (k, J) directions of the joints' coordinates that count as open.
        lean: (U, 15, C) how SUs follow the joint coordinates ``equations.columns``.
        free: per SU (k, 6) orthonormal directions (linear, angular times ``arm``) that are open.
        least: information [1/m^2 or 1/rad^2] below which a direction counts as open.
        arm: length that angles are weighed by [m].
    """
    span = np.where(tree.prismatic, _SLIDES, _TURNS)
    q = span * np.random.default_rng(0).uniform(-1.0, 1.0, (_CONFIGURATIONS, tree.n_joints))
    moves = Displacements.of(tree, state, q, arm)
    beyond = [np.flatnonzero(column) for column in tree.activity().T]
    rigid = [
        OpenDirection({tree.joint_names[j]: xi}, {})
        for j in sorted(range(tree.n_joints), key=lambda j: len(beyond[j]))
        for xi in _twists_of_all_beyond(tree, state, equations, j, beyond[j], least)
    ]
    limbs = limbs_of(tree)
    found: list[OpenDirection] = []
    for limb in np.unique(limbs[limbs != ON_BASE]):
        on = np.flatnonzero(limbs == limb)
        seen = _Limb(moves, on, [free[int(u)] for u in on])
        found += [direction for direction in rigid if seen.is_news(direction)]
        left = [_restricted(tree, equations, v, lean, int(limb), on) for v in null]
        found += seen.news_of(left)
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

    def news_of(self, directions: Sequence[OpenDirection]) -> list[OpenDirection]:
        """Combinations of directions that are independent of those that are known."""
        motion = [self.moves.along(direction) for direction in directions]
        size = [float(np.linalg.norm(m[:, self.on])) for m in motion]
        felt = [i for i, length in enumerate(size) if length > _TINY]
        if not felt:
            return []
        flat = np.stack([motion[i] / size[i] for i in felt])
        rest = self._beside(self._flat(flat))
        weights, values, _ = np.linalg.svd(rest, full_matrices=False)
        whole = weights.T @ flat[:, :, self.on].reshape(len(felt), -1)
        news = weights.T[values > ALIKE * np.linalg.norm(whole, axis=1)]
        return [_sum([directions[i] for i in felt], w / np.array(size)[felt]) for w in news]


def _twists_of_all_beyond(
    tree: KinematicTree, state: State, equations: NormalEquations, j: int, on: Int, least: float
) -> Iterator[F64]:
    """Twists (6,) of a joint's placement that no reading of the SUs beyond it tells.

    Slides come first and are 1 m long, turns are 1 rad large and without any slide that is open
    as well.
    """
    into_joint, into_su = (adjoint(inverse(T)) for T in (state.T_parent_joint, state.T_joint_su))
    x = np.zeros((len(equations.joint), 6))
    passed = np.zeros((tree.n_joints, 6, 6))
    for k in range(j, tree.n_joints):
        moved = np.eye(6) if k == j else into_joint[k] @ passed[tree.parent[k]]
        absorbed = _ABSORBED[tree.joint_types[k]]
        passed[k] = moved
        passed[k, absorbed] = 0.0
        held = np.where(np.isin(JOINT_COORDINATES, absorbed)[:, None], 1.0, 0.0)
        x[N_JOINT * k : N_JOINT * (k + 1)] = held * moved[list(JOINT_COORDINATES)]
    y = into_su[on] @ passed[tree.su_joint[on]]
    su = equations.su[on, :N_PLACEMENT, :N_PLACEMENT]
    both = np.swapaxes(y, 1, 2) @ equations.mixed[on, :N_PLACEMENT] @ x[equations.columns[on]]
    H = x.T @ equations.joint @ x + (np.swapaxes(y, 1, 2) @ su @ y).sum(axis=0)
    H += (both + np.swapaxes(both, 1, 2)).sum(axis=0)
    values, V = np.linalg.eigh(H)
    yield from _slides_and_turns(V[:, values < least].T)


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


def _restricted(
    tree: KinematicTree, equations: NormalEquations, v: F64, lean: F64, limb: int, on: Int
) -> OpenDirection:
    """A direction (J,) of the joint coordinates within a limb, and how its SUs follow."""
    joints = {}
    for j, name in enumerate(tree.joint_names):
        local = v[N_JOINT * j : N_JOINT * (j + 1)]
        if limb in tree.chain(j) and np.abs(local).max() > _TINY:
            joints[name] = np.zeros(6)
            joints[name][list(JOINT_COORDINATES)] = local
    sus = {tree.su_names[u]: lean[u, :N_PLACEMENT] @ v[equations.columns[u]] for u in on}
    return OpenDirection(joints, {n: xi for n, xi in sus.items() if np.abs(xi).max() > _TINY})


def _sum(directions: Sequence[OpenDirection], weights: F64) -> OpenDirection:
    """A combination of directions, its largest twist of unit size."""

    def added(parts: Sequence[tuple[float, dict[str, F64]]]) -> dict[str, F64]:
        out: dict[str, F64] = {}
        for weight, twists in parts:
            for name, xi in twists.items():
                out[name] = out.get(name, np.zeros(6)) + weight * xi
        return out

    joints = added([(w, dict(d.joints)) for w, d in zip(weights, directions, strict=True)])
    sus = added([(w, dict(d.sus)) for w, d in zip(weights, directions, strict=True)])
    size = max(float(np.abs(xi).max()) for xi in (*joints.values(), *sus.values()))
    return OpenDirection(
        {name: xi / size for name, xi in joints.items() if np.abs(xi).max() > _TINY * size},
        {name: xi / size for name, xi in sus.items() if np.abs(xi).max() > _TINY * size},
    )
