"""Joints that yield: what links do beyond what encoders before the gear say.

A joint k of stiffness K_k leaves its link at ``q = theta - tau / K`` where theta is the motor's
position. The torque is linear in the masses, centres of mass and inertias pi of the links beyond
the joint: ``tau_k = Y_k(q, q', q'') pi`` (Atkeson, An and Hollerbach 1986; Pinocchio's joint torque
regressor), so that the deflection is linear in ``pi / K_k``, of which every joint has its own. Many
of them show in no motion; those that show, largest first, span a basis in which few numbers say all
that the joints' deflections can be.

A gear's damping makes its deflection late: ``K e + d e' = -tau``, which to first order is one
number more per joint, ``e = -tau / K - (d / K) e'``.

A base that gives way turns about its three axes by the moments that the robot puts on it, which are
linear in the same masses. Where it turns about a point that is off the base's frame by h, this
shifts by ``e x h``, which is six numbers more: by how much the turn about one axis shifts along
another.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, frozen
from skin2urdf.estimation.problem.state import State
from skin2urdf.estimation.trajectory.skeleton import N_HINGES, Skeleton, shift, turn
from skin2urdf.estimation.trajectory.unseen import Unseen
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.signals.filters import filtered, first_derivative
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree

_N_INERTIAL = 10
_SHOWS = 1e-3
"""Least share of a joint's largest deflection that a direction is kept for: of milliradians,
microradians, less than encoders and sensors tell."""
_AT_ONCE = 2000
"""Samples whose regressors are held at a time."""


@dataclass(frozen=True, eq=False)
class Elasticity(Unseen):
    """Deflections of the joints, as motions that encoders do not see, per unit of S numbers.

    Attributes:
        driver: (S,) the joint or hinge whose deflection makes a number's motion: its own where the
            number is the time by which it lags behind its torque [s], damping over stiffness;
            another one's where it is the lever by which that one shifts it [m]; -1 where inertial
            parameters make it.
        basis: (S, M, 10 D) the inertial parameters over stiffness that it stands for, in the order
            of Pinocchio's regressors, per torque about the joint's own axis (M = 1) or about the
            three axes of the base (M = 3).
    """

    driver: Int
    basis: F64

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "driver", frozen(self.driver, np.int64))
        object.__setattr__(self, "basis", frozen(self.basis))

    @property
    def damping(self) -> Bool:
        """(S,) True for times by which deflections lag."""
        return np.asarray(self.driver == self.joint)

    @property
    def lever(self) -> Bool:
        """(S,) True for levers by which turns of the base shift it."""
        return np.asarray((self.driver >= 0) & (self.driver != self.joint))


def elasticity(
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    state: State,
    gravity: float,
    *,
    joints: bool = True,
    base: bool = False,
) -> Elasticity:
    """The deflections that the motion of the logs can make, as encoders have that motion.

    Args:
        tree: the structure.
        logs: trajectories.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
        joints: whether joints yield.
        base: whether the base does.
    """
    D = tree.n_joints
    turns = [turn(tree, axis) for axis in range(3)]
    # A joint turns by the torque about its axis; a base about any axis by the torques about all.
    groups = [[k] for k in range(D) if joints] + [turns] * base
    width = _N_INERTIAL * D
    size = _inertial_sizes(state)
    square = [np.zeros((len(rows) * width, len(rows) * width)) for rows in groups]
    count = 0
    for g, log in enumerate(logs):
        for Y, _ in _regressors(tree, state, g, gravity, log, base):
            scaled = Y * size
            for total, rows in zip(square, groups, strict=True):
                flat = scaled[:, rows].reshape(len(Y), -1)
                total += flat.T @ flat
            count += len(Y)
    moved: list[int] = []
    basis = []
    for total, rows in zip(square, groups, strict=True):
        lam, V = np.linalg.eigh(total / count)
        if lam[-1] <= 0:
            continue
        shows = np.flatnonzero(lam > _SHOWS**2 * lam[-1])[::-1]
        directions = np.zeros((len(shows), 3, width))
        found = (V[:, shows] / np.sqrt(lam[-1])).T.reshape(len(shows), len(rows), width)
        directions[:, : len(rows)] = found * size
        for number in rows:
            moved += [number] * len(shows)
            basis.append(directions)
    # Damping is one number more for each that yields; without a deflection it does nothing.
    late = sorted(set(moved))
    levers = [(shift(tree, i), turns[j]) for i in range(3) for j in range(3) if i != j and base]
    driver = [*[-1] * len(moved), *late, *(j for _, j in levers)]
    joint = [*moved, *late, *(i for i, _ in levers)]
    of_all = np.zeros((len(joint), 3, width))
    of_all[: len(moved)] = np.concatenate(basis) if basis else of_all[: len(moved)]
    what = np.array(joint, dtype=np.int64), np.array(driver, dtype=np.int64), of_all
    return _along(tree, logs, state, gravity, what, logs)


def followed(
    found: Elasticity,
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    state: State,
    gravity: float,
    x: F64,
) -> Elasticity:
    """The same deflections along the motion of the links, which is what torques go with.

    Args:
        found: deflections along some motion, by which the links' is known.
        tree: the structure.
        logs: trajectories as the encoders have them.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
        x: (S,) what the joints yield.
    """
    moved = [found.moved(log, g, x) for g, log in enumerate(logs)]
    what = (found.joint, found.driver, found.basis)
    return _along(tree, logs, state, gravity, what, moved)


def _along(
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    state: State,
    gravity: float,
    what: tuple[Int, Int, F64],
    moved: Sequence[Trajectory],
) -> Elasticity:
    """Deflections (joints, drivers and basis given) along the motion of the links."""
    joint, driver, basis = what
    D = tree.n_joints
    base = bool((joint >= D).any())
    turns = [turn(tree, axis) for axis in range(3)]
    out = []
    for g, (log, motion) in enumerate(zip(logs, moved, strict=True)):
        deflections = np.zeros((len(log.q), len(joint)))
        for Y, at in _regressors(tree, state, g, gravity, motion, base):
            for k in np.unique(joint[driver < 0]):
                which = (driver < 0) & (joint == k)
                rows = [k] if k < D else turns
                for m, row in enumerate(rows):
                    deflections[at, which] -= Y[:, row] @ basis[which, m].T
        # Above the low-pass, accelerations are noise, and more so with every differentiation.
        deflections = filtered(deflections, log.taps)
        found = np.zeros((len(log.q), D + N_HINGES))
        found[:, : motion.q.shape[1]] = motion.q
        found[:, :D] -= log.q
        rates = first_derivative(found, log.rate)
        for s in np.flatnonzero(driver >= 0):
            k, by = int(joint[s]), int(driver[s])
            if k == by:
                deflections[:, s] = -rates[:, k]
            else:
                # The part of e x h along axis k that comes of the turn about axis `by`.
                sign = 1.0 if (k - D + 1) % 3 == (by - D) % 3 else -1.0
                deflections[:, s] = sign * found[:, by]
        out.append(deflections)
    return Elasticity(joint, tuple(out), driver, basis)


def _regressors(
    tree: KinematicTree, state: State, g: int, gravity: float, log: Trajectory, base: bool
) -> Iterator[tuple[F64, slice]]:
    """Torques (n, R, 10 D) per inertial parameter of the joints, and of the base's hinges."""
    import pinocchio as pin

    D = tree.n_joints
    skeleton = Skeleton(tree, D + np.arange(N_HINGES if base else 0))
    numbers, first = skeleton.numbers, len(skeleton.hinges)
    built = PinocchioTree(skeleton.tree)
    built.write_joints(skeleton.placements(state.T_parent_joint))
    model = built.model
    model.gravity.linear = -gravity * state.up[g]
    data = model.createData()
    still = np.zeros((len(log.q), D + first - log.q.shape[1]))
    q, qd, qdd = (
        np.ascontiguousarray(np.hstack([x, still])[:, numbers]) for x in (log.q, log.qd, log.qdd)
    )
    for begin in range(0, len(q), _AT_ONCE):
        at = slice(begin, min(begin + _AT_ONCE, len(q)))
        Y = np.empty((at.stop - begin, D + first, _N_INERTIAL * D))
        for i in range(len(Y)):
            n = begin + i
            all_of_it = pin.computeJointTorqueRegressor(model, data, q[n], qd[n], qdd[n])
            # What hinges carry themselves stands still, so its parameters are left out.
            Y[i, numbers] = all_of_it[:, _N_INERTIAL * first :]
        yield Y, at


def _inertial_sizes(state: State) -> F64:
    """(10 D,) sizes of mass, first and second moments that belong to each other, per unit mass.

    Lengths are those of the robot's links.
    """
    arms = np.concatenate([state.T_parent_joint[:, :3, 3], state.T_joint_su[:, :3, 3]])
    arm = float(np.sqrt((arms**2).sum(axis=1).mean())) or 1.0
    return np.tile([1.0, *[arm] * 3, *[arm**2] * 6], len(state.T_parent_joint))
