"""Joints that yield: what links do beyond what encoders before the gear say.

A joint k of stiffness K_k leaves its link at ``q = theta - tau / K`` where theta is the motor's
position. The torque is linear in the masses, centres of mass and inertias pi of the links beyond
the joint: ``tau_k = Y_k(q, q', q'') pi`` (Atkeson, An and Hollerbach 1986; Pinocchio's joint torque
regressor), so that the deflection is linear in ``pi / K_k``, of which every joint has its own. Many
of them show in no motion; those that show, largest first, span a basis in which few numbers say all
that the joints' deflections can be.

A gear's damping makes its deflection late: ``K e + d e' = -tau``, which to first order is one
number more per joint, ``e = -tau / K - (d / K) e'``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, frozen
from skin2urdf.estimation.problem.state import State
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
        damping: (S,) True for the time by which a deflection lags behind its torque [s]: damping
            over stiffness.
        basis: (S, 10 D) the inertial parameters over stiffness that it stands for, in the order of
            Pinocchio's regressors.
    """

    damping: Bool
    basis: F64

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "damping", frozen(self.damping, np.bool_))
        object.__setattr__(self, "basis", frozen(self.basis))


def elasticity(
    tree: KinematicTree, logs: Sequence[Trajectory], state: State, gravity: float
) -> Elasticity:
    """The deflections that the motion of the logs can make, as encoders have that motion.

    Args:
        tree: the structure.
        logs: trajectories.
        state: placements, and gravity's direction per log.
        gravity: its magnitude [m/s^2].
    """
    D = tree.n_joints
    size = _inertial_sizes(state)
    square = np.zeros((D, _N_INERTIAL * D, _N_INERTIAL * D))
    count = 0
    for g, log in enumerate(logs):
        for Y, _ in _regressors(tree, state, g, gravity, log):
            scaled = Y * size
            square += np.einsum("nki,nkj->kij", scaled, scaled, optimize=True)
            count += len(Y)
    joint, basis = [], []
    for k in range(D):
        lam, V = np.linalg.eigh(square[k] / count)
        if lam[-1] <= 0:
            continue
        shows = np.flatnonzero(lam > _SHOWS**2 * lam[-1])[::-1]
        joint += [k] * len(shows)
        basis += list((size[:, None] * V[:, shows] / np.sqrt(lam[-1])).T)
    # Damping is one number more for each joint that yields; without a deflection it does nothing.
    damped = np.unique(joint)
    directions = np.zeros((len(joint) + len(damped), _N_INERTIAL * D))
    directions[: len(joint)] = np.array(basis).reshape(-1, _N_INERTIAL * D)
    damping = np.arange(len(directions)) >= len(joint)
    joints = np.concatenate([joint, damped]).astype(np.int64)
    return _along(tree, logs, state, gravity, (joints, damping, directions), logs)


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
    what = (found.joint, found.damping, found.basis)
    return _along(tree, logs, state, gravity, what, moved)


def _along(
    tree: KinematicTree,
    logs: Sequence[Trajectory],
    state: State,
    gravity: float,
    what: tuple[Int, Bool, F64],
    moved: Sequence[Trajectory],
) -> Elasticity:
    """Deflections (joints, damping and basis given) along the motion of the links."""
    joint, damping, basis = what
    out = []
    for g, (log, motion) in enumerate(zip(logs, moved, strict=True)):
        deflections = np.empty((len(log.q), len(joint)))
        for Y, at in _regressors(tree, state, g, gravity, motion):
            for k in range(tree.n_joints):
                deflections[at, joint == k] = -(Y[:, k] @ basis[joint == k].T)
        # Above the low-pass, accelerations are noise, and more so with every differentiation.
        deflections = filtered(deflections, log.taps)
        rates = first_derivative(motion.q - log.q, log.rate)
        deflections[:, damping] = -rates[:, joint[damping]]
        out.append(deflections)
    return Elasticity(joint, tuple(out), damping, basis)


def _regressors(
    tree: KinematicTree, state: State, g: int, gravity: float, log: Trajectory
) -> Iterator[tuple[F64, slice]]:
    """Torques (n, D, 10 D) of the joints per inertial parameter, some samples at a time."""
    import pinocchio as pin

    built = PinocchioTree(tree)
    built.write_joints(state.T_parent_joint)
    model = built.model
    model.gravity.linear = -gravity * state.up[g]
    data = model.createData()
    q, qd, qdd = (np.ascontiguousarray(x) for x in (log.q, log.qd, log.qdd))
    for first in range(0, len(q), _AT_ONCE):
        at = slice(first, min(first + _AT_ONCE, len(q)))
        Y = np.empty((at.stop - first, tree.n_joints, _N_INERTIAL * tree.n_joints))
        for i in range(len(Y)):
            n = first + i
            Y[i] = pin.computeJointTorqueRegressor(model, data, q[n], qd[n], qdd[n])
        yield Y, at


def _inertial_sizes(state: State) -> F64:
    """(10 D,) sizes of mass, first and second moments that belong to each other, per unit mass.

    Lengths are those of the robot's links.
    """
    arms = np.concatenate([state.T_parent_joint[:, :3, 3], state.T_joint_su[:, :3, 3]])
    arm = float(np.sqrt((arms**2).sum(axis=1).mean())) or 1.0
    return np.tile([1.0, *[arm] * 3, *[arm**2] * 6], len(state.T_parent_joint))
