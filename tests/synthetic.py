"""Random robots and their features, made by Pinocchio's own frame Jacobians; trajectories.

Shared by the tests of the model and of the estimation. Features come from
``pin.computeFrameJacobian`` on a model that is built here, never from the package's prediction of
features, so that the two can be held against each other.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64, Int
from skin2urdf.estimation.problem.blocks import feature_blocks
from skin2urdf.estimation.problem.cost import Cost, Priors
from skin2urdf.estimation.problem.state import State, Step
from skin2urdf.estimation.trajectory.state import MotionState
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.model.specific_force import specific_forces
from skin2urdf.signals.filters import filtered, first_derivative, low_pass, second_derivative
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.signals.trajectory import Trajectory
from skin2urdf.structure.records import KinematicTree


def rigid_transforms(rng: np.random.Generator, n: int, size: float = 0.3) -> F64:
    """(n, 4, 4) uniformly random orientations at origins of about ``size`` [m]."""
    T = np.tile(np.eye(4), (n, 1, 1))
    if n:
        T[:, :3, :3] = Rotation.random(n, random_state=rng).as_matrix()
        T[:, :3, 3] = size * rng.standard_normal((n, 3))
    return T


def serial_tree(n_joints: int, prismatic: tuple[int, ...] = ()) -> KinematicTree:
    """A chain with one SU on every segment."""
    return KinematicTree(
        tuple(f"joint{i}" for i in range(n_joints)),
        np.arange(-1, n_joints - 1),
        tuple("prismatic" if i in prismatic else "revolute" for i in range(n_joints)),
        tuple(f"su{i}" for i in range(n_joints)),
        np.arange(n_joints),
    )


def random_tree(
    rng: np.random.Generator, n_joints: int, n_sus: int, prismatic: float = 0.3
) -> KinematicTree:
    """A branching tree; the first SU sits on the base, the second on the last segment."""
    parent = np.array([rng.integers(max(-1, i - 2), i) for i in range(n_joints)], dtype=np.int64)
    su_joint = rng.integers(-1, n_joints, n_sus)
    su_joint[:2] = [-1, n_joints - 1][:n_sus]
    return KinematicTree(
        tuple(f"joint{i}" for i in range(n_joints)),
        parent,
        tuple("prismatic" if p else "revolute" for p in rng.random(n_joints) < prismatic),
        tuple(f"su{i}" for i in range(n_sus)),
        su_joint,
    )


def random_state(
    rng: np.random.Generator, tree: KinematicTree, n_logs: int = 1, intrinsics: float = 1.0
) -> State:
    """Random placements, gravity directions and sensors.

    Args:
        rng: source of randomness.
        tree: the structure.
        n_logs: number G of gravity directions; the first is z.
        intrinsics: size of bias and shape errors; 1 stands for 0.3 m/s^2 and 2 %.
    """
    up = rng.standard_normal((n_logs, 3))
    up[0] = 0.0, 0.0, 1.0
    return State(
        rigid_transforms(rng, tree.n_joints),
        rigid_transforms(rng, tree.n_sus, 0.1),
        up / np.linalg.norm(up, axis=1, keepdims=True),
        0.3 * intrinsics * rng.standard_normal((tree.n_sus, 3)),
        0.02 * intrinsics * rng.standard_normal((tree.n_sus, 6)),
    )


def random_step(rng: np.random.Generator, cost: Cost, size: float = 0.1) -> Step:
    """A random step of the shape of a cost's coordinates; shape errors a tenth of the rest."""
    zero = cost.zero_step()
    step = zero.like(size * rng.standard_normal(zero.flat().size))
    step.sus[:, 9:] *= 0.1
    return step


def pinocchio_model(tree: KinematicTree, state: State) -> tuple[pin.Model, list[int]]:
    """Pinocchio model with SUs as frames, and the frames' indices."""
    model = pin.Model()
    for name, parent, kind, T in zip(
        tree.joint_names, tree.parent, tree.joint_types, state.T_parent_joint, strict=True
    ):
        joint = pin.JointModelPZ() if kind == "prismatic" else pin.JointModelRZ()
        model.addJoint(int(parent) + 1, joint, pin.SE3(T), name)
    frames = [
        model.addFrame(pin.Frame(name, int(j) + 1, pin.SE3(T), pin.FrameType.OP_FRAME))
        for name, j, T in zip(tree.su_names, tree.su_joint, state.T_joint_su, strict=True)
    ]
    return model, frames


def pinocchio_jacobians(tree: KinematicTree, state: State, q: F64) -> tuple[F64, F64, F64]:
    """LOCAL frame Jacobians of all SUs at positions q (P, D), straight from Pinocchio.

    Returns:
        R_base_su (P, U, 3, 3), w (P, U, D, 3) and v (P, U, D, 3), zero outside an SU's chain.
    """
    model, frames = pinocchio_model(tree, state)
    data = model.createData()
    shape = (len(q), tree.n_sus)
    R = np.zeros((*shape, 3, 3))
    w, v = np.zeros((*shape, q.shape[1], 3)), np.zeros((*shape, q.shape[1], 3))
    for p, position in enumerate(q):
        pin.framesForwardKinematics(model, data, position)
        for u, frame in enumerate(frames):
            J = pin.computeFrameJacobian(model, data, position, frame, pin.LOCAL)
            R[p, u] = data.oMf[frame].rotation
            v[p, u], w[p, u] = J[:3].T, J[3:].T
    return R, w, v


def exact_coefficients(tree: KinematicTree, state: State, q: F64, log: Int) -> F64:
    """(P, U, 1 + 2 D, 3) what the SUs measure around poses q (P, D) of logs (P,), without noise."""
    R, w, v = pinocchio_jacobians(tree, state, q)
    f0 = np.einsum("puij,pi->puj", R, state.up[log] * GRAVITY)[:, :, None]
    ideal = np.concatenate([f0, np.cross(f0, w), v], axis=2)
    read = np.einsum("uij,pumj->pumi", state.sensor_matrix(), ideal)
    read[:, :, 0] += state.bias
    return read


def random_features(
    rng: np.random.Generator,
    tree: KinematicTree,
    state: State,
    n_poses: int,
    noise: float = 0.0,
    shuffle: bool = True,
) -> Features:
    """Features of a robot in random poses, with full random information matrices.

    Args:
        rng: source of randomness.
        tree: the structure.
        state: the truth; poses are spread evenly over its logs.
        n_poses: number of poses P.
        noise: standard deviation of a sample [m/s^2]; weights are for 0.05 where it is 0.
        shuffle: list SUs and DoFs in another order than the tree does.
    """
    D, U = tree.n_joints, tree.n_sus
    q = rng.uniform(-2.0, 2.0, (n_poses, D)) * np.where(tree.prismatic, 0.2, 1.0)
    log = np.arange(n_poses) % len(state.up)
    n = 1 + 2 * D
    # Regressors of 10 n samples each: 1, dq of about 0.1 rad, qdd of about 5 rad/s^2.
    X = rng.standard_normal((n_poses, U, 10 * n, n))
    X[..., 0] = 1.0
    X[..., 1 : 1 + D] *= 0.1
    X[..., 1 + D :] *= 5.0
    information = np.swapaxes(X, -1, -2) @ X
    root = np.linalg.cholesky(information)
    error = noise * rng.standard_normal((n_poses, U, n, 3))
    coefficients = exact_coefficients(tree, state, q, log)
    coefficients = coefficients + np.linalg.solve(np.swapaxes(root, -1, -2), error)
    dof = rng.permutation(D) if shuffle else np.arange(D)
    su = rng.permutation(U) if shuffle else np.arange(U)
    rows = np.concatenate([[0], 1 + dof, 1 + D + dof])
    return Features(
        su_names=tuple(tree.su_names[u] for u in su),
        dof_names=tuple(tree.joint_names[d] for d in dof),
        q=q[:, dof],
        log=log,
        coefficients=coefficients[:, su][:, :, rows],
        information=Information.of(information[:, su][:, :, rows][..., rows]),
        noise=np.full((n_poses, U, 3), noise or 0.05),
        latency=np.zeros(U),
        latency_sd=np.zeros(U),
        moves=StaticMoves(np.zeros(0), np.zeros(0), np.zeros((0, U, 3))),
    )


def random_cost(
    rng: np.random.Generator,
    tree: KinematicTree,
    state: State,
    n_poses: int,
    noise: float = 0.0,
    priors: Priors | None = None,
) -> Cost:
    """The cost of :func:`random_features`; offsets have no prior unless one is given."""
    features = random_features(rng, tree, state, n_poses, noise)
    priors = priors or Priors(gravity=GRAVITY, position=np.inf)
    return Cost(tree, feature_blocks(features, tree), priors)


RATE, CUTOFF = 125.0, 6.0
"""Samples per second of :func:`sampled_trajectory`, and the edge of its low-pass [Hz]."""


def sampled_trajectory(
    q: F64, readings: F64, rates: F64 | None = None, still_below: float = 0.0
) -> Trajectory:
    """The trajectory of a log of whole samples at ``RATE``.

    Args:
        q: (N, D) positions as encoders report them [rad or m].
        readings: (N, U, 3) what accelerometers read [m/s^2].
        rates: (N, U, 3) what gyroscopes read [rad/s]; None without any.
        still_below: joints that move slower count as still [rad/s or m/s].
    """
    taps = low_pass(CUTOFF, RATE)
    smooth = filtered(q, taps)
    velocity = first_derivative(smooth, RATE)
    kept = np.arange(len(taps), len(q) - len(taps), 6)
    whole = np.ones((len(kept), readings.shape[1]), dtype=bool)
    return Trajectory(
        log=0,
        rate=RATE,
        taps=taps,
        q=smooth,
        qd=velocity,
        qdd=second_derivative(smooth, RATE),
        readings=filtered(filtered(readings, taps), taps),
        kept=kept,
        valid=whole,
        moving=np.abs(velocity[kept]) >= still_below,
        shaken=(np.abs(velocity[kept]) >= still_below).astype(np.float64),
        independence=0.5,
        rates=None if rates is None else filtered(filtered(rates, taps), taps),
        turning=None if rates is None else whole,
        positions=q,
    )


def readings_along(tree: KinematicTree, truth: State, q: F64) -> F64:
    """(N, U, 3) noiseless readings of SUs along positions (N, D) at ``RATE`` [m/s^2].

    Args:
        tree: the structure.
        truth: placements and sensors; gravity is along the base's z axis.
        q: positions of its joints [rad or m].
    """
    qd, qdd = np.gradient(q, 1 / RATE, axis=0), np.zeros_like(q)
    qdd[1:-1] = (q[2:] - 2 * q[1:-1] + q[:-2]) * RATE**2
    ideal = specific_forces(truth.model(tree), q, qd, qdd, np.array([0.0, 0.0, 9.81]))
    return np.asarray(np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias)


def reading_errors(found: State, truth: State, tree: KinematicTree) -> float:
    """Root mean square error of what SUs of two joints read along another motion [m/s^2]."""
    q = np.random.default_rng(9).uniform(-1, 1, (40, 2))
    qd, qdd = 2 * q[::-1], 10 * q[:, ::-1]
    ours, true = (
        specific_forces(s.model(tree), q, qd, qdd, 9.81 * truth.up[0]) for s in (found, truth)
    )
    return float(np.sqrt(((ours - true) ** 2).mean()))


def stays(at: F64, stay: int, move: int) -> F64:
    """(N, D) stays of so many samples in places (P, D), smooth moves of so many in between."""
    s = np.linspace(0, 1, move)[:, None]
    s = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
    parts = [np.tile(at[0], (stay, 1))]
    for a, b in pairwise(at):
        parts += [a + s * (b - a), np.tile(b, (stay, 1))]
    return np.concatenate(parts)


def error_along_another_motion(tree: KinematicTree, found: State, truth: State) -> float:
    """Root mean square error of what sensors read along a motion that no log has [m/s^2].

    Args:
        tree: the structure.
        found: placements and sensors.
        truth: the true ones.
    """
    q = np.random.default_rng(9).uniform(-1, 1, (40, tree.n_joints))
    qd, qdd = 2 * q[::-1], 10 * q[:, ::-1]

    def read(state: State) -> F64:
        felt = specific_forces(state.model(tree), q, qd, qdd, 9.81 * state.up[0])
        return np.asarray(np.einsum("uij,kuj->kui", state.sensor_matrix(), felt) + state.bias)

    return float(np.sqrt(((read(found) - read(truth)) ** 2).mean()))


def motion_state(placements: State, unseen: F64, gravity: float = 9.81) -> MotionState:
    """One log of sensors that are on time and have no low-pass of their own."""
    U = len(placements.T_joint_su)
    return MotionState(
        placements=placements,
        gravity=gravity,
        front=np.zeros((U, 2)),
        clock=np.zeros((1, U, 2)),
        knots=(np.zeros((0, U, 3)),),
        unseen=unseen,
        gyro=np.zeros((U, 0)),
    )
