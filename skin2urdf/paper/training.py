"""Training sets as the paper has them (II-C.2), from features and as features.

A training set holds, for every SU and pose, the static gravity vector and the peak of the dynamic
acceleration while one DoF after the other performs the motion pattern. Features hold the same per
unit of angular acceleration (``tau``), however the robot moved; a pattern of the paper is
then a choice of peak acceleration (eq. 12).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.geometry.units import GRAVITY
from skin2urdf.signals.information import Information
from skin2urdf.signals.records import Features, StaticMoves
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True)
class MotionPattern:
    """The sine of eq. 10 to 12 that every DoF performs.

    Attributes:
        amplitude: A, the peak angular velocity [rad/s]. The paper gives no value.
        frequency: f [Hz]. The paper gives no value.
    """

    amplitude: float = 1.0
    frequency: float = 1.0

    @property
    def peak_acceleration(self) -> float:
        """Angular acceleration at t = 0 [rad/s^2] (eq. 12)."""
        return 2.0 * np.pi * self.frequency * self.amplitude

    @property
    def time_step(self) -> float:
        """Step of the second difference, h = 1 / (1000 f) [s] (eq. 9)."""
        return 1.0 / (1000.0 * self.frequency)

    def angle(self, time: float) -> float:
        """theta_patt(t) [rad] (eq. 10)."""
        rate = 2.0 * np.pi * self.frequency
        # 1 - cos(x) written without cancellation: x is 2 pi / 1000 in the second difference.
        return float(self.amplitude / rate * 2.0 * np.sin(0.5 * rate * time) ** 2)


@dataclass(frozen=True, eq=False)
class SuTraining(Record):
    """What one SU contributes: the poses in which all of it was measured.

    Attributes:
        q: (P, N) positions of the N DoFs before the SU, theta_pose [rad].
        log: (P,) log of each pose, from 0; gravity is constant within a log.
        gravity: (P, 3) static gravity vectors in the SU's frame [g].
        acceleration: (P, K, 3) peak dynamic accelerations by the last K of those DoFs, in the SU's
            frame [g].
    """

    q: F64
    log: Int
    gravity: F64
    acceleration: F64

    @property
    def n_poses(self) -> int:
        """Number of poses P."""
        return int(self.q.shape[0])


def su_training(
    blocks: FeatureBlocks, su: int, pattern: MotionPattern, last_dofs: int, gravity: float = GRAVITY
) -> SuTraining:
    """Training data of one SU from measured features.

    Poses in which gravity or one of the needed ``tau`` was not measured are left out.

    Args:
        blocks: features restricted to the chains of the SUs.
        su: index of the SU, on a segment that moves.
        pattern: the motion pattern whose peak acceleration ``tau`` is scaled to.
        last_dofs: how many DoFs directly before the SU perform it (paper: 3).
        gravity: magnitude of gravity [m/s^2], the unit of the training set.
    """
    n, L = int(blocks.chains.length[su]), blocks.chains.joint.shape[1]
    chain = blocks.chains.joint[su, :n]
    rows = 1 + L + np.arange(max(0, n - last_dofs), n)
    needed = blocks.variance[:, su][:, np.r_[0, rows]]
    finite = np.concatenate([needed, blocks.noise[:, su]], axis=1)
    measured = np.isfinite(finite).all(axis=1)
    tau = blocks.coefficients[measured, su][:, rows]
    return SuTraining(
        q=blocks.q[measured][:, chain],
        log=blocks.log[measured],
        gravity=blocks.coefficients[measured, su, 0] / gravity,
        acceleration=tau * (pattern.peak_acceleration / gravity),
    )


def training_features(
    tree: KinematicTree,
    q: F64,
    gravity_su: F64,
    acceleration_su: F64,
    noise: float,
    pattern: MotionPattern,
    gravity: float = GRAVITY,
) -> Features:
    """A training set of the paper as features, for every method that works on features.

    The change of gravity with a DoF's position (the slopes ``s``) is no part of the paper's data
    and counts as not measured.

    Args:
        tree: names of the D DoFs and U SUs, in the order of the arrays.
        q: (P, D) poses [rad].
        gravity_su: (P, U, 3) static gravity in the SUs' frames [g].
        acceleration_su: (P, U, D, 3) peak dynamic accelerations in the SUs' frames [g].
        noise: standard deviation of every measurement [g].
        pattern: the motion pattern that was performed.
        gravity: magnitude of gravity [m/s^2].
    """
    P, U, D = len(q), tree.n_sus, tree.n_joints
    peak = pattern.peak_acceleration
    coefficients = np.zeros((P, U, 1 + 2 * D, 3))
    coefficients[:, :, 0] = gravity_su * gravity
    coefficients[:, :, 1 + D :] = acceleration_su * (gravity / peak)
    information = np.zeros((P, U, 1 + 2 * D, 1 + 2 * D))
    information[:, :, 0, 0] = 1.0
    pattern_rows = np.arange(1 + D, 1 + 2 * D)
    information[:, :, pattern_rows, pattern_rows] = peak**2
    return Features(
        su_names=tree.su_names,
        dof_names=tree.joint_names,
        q=q,
        log=np.zeros(P, np.int64),
        coefficients=coefficients,
        information=Information.of(information),
        noise=np.full((P, U, 3), noise * gravity),
        latency=np.zeros(U),
        latency_sd=np.zeros(U),
        moves=StaticMoves(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, U, 3))),
    )
