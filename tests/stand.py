"""Readings of a robot on a stand that its weight tilts, by Pinocchio's inverse dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from synthetic import RATE, random_state, serial_tree

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.model.kinematics import to_pinocchio
from skin2urdf.signals.filters import first_derivative, second_derivative
from skin2urdf.structure.records import KinematicTree

UP = np.array([0.0, 0.0, 1.0])
DEPTH = 0.3
"""How far below the base's frame is the point that the stand turns about [m]."""
TREE = replace(serial_tree(2), su_names=("su0", "su1", "base"), su_joint=np.array([0, 1, -1]))
"""Two joints with an SU each, and one on the base."""
BODIES = [
    pin.Inertia(mass, np.array(lever), 0.02 * mass * np.eye(3))
    for mass, lever in ((20.0, (0.2, 0.1, 0.1)), (8.0, (0.3, 0.1, -0.1)))
]
"""What those joints carry."""
TRUTH = replace(random_state(np.random.default_rng(3), TREE, 1, 0.3), up=UP[None])
"""Where they are."""
_SOLVED = 3
"""Times that what gives way is taken from loads, which hardly depend on it."""


def readings_on_a_stand(
    tree: KinematicTree,
    truth: State,
    inertias: Sequence[pin.Inertia],
    q: F64,
    compliance: float,
    slides: float = 0.0,
) -> tuple[F64, F64]:
    """(N, K, 3) noiseless readings [m/s^2], and (N, 2) turns of the stand about x and y [rad].

    Args:
        tree: D revolute joints, with K SUs.
        truth: its placements and sensors.
        inertias: (D,) of what each joint carries, in its frame.
        q: (N, D) positions of its joints at the rate of the grid.
        compliance: by how much the stand turns [rad/(N m)].
        slides: by how much it shifts along x and y [m/N].
    """
    plain = to_pinocchio(truth.model(tree))
    model, below = pin.Model(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -DEPTH]))
    none = pin.SE3.Identity()
    model.addJoint(0, pin.JointModelPX(), below, "along x")
    model.addJoint(1, pin.JointModelPY(), none, "along y")
    model.addJoint(2, pin.JointModelRX(), none, "about x")
    model.addJoint(3, pin.JointModelRY(), none, "about y")
    for j, at in enumerate(plain.jointPlacements[1:]):
        parent = int(tree.parent[j])
        place = below.inverse() * at if parent < 0 else at
        model.addJoint(parent + 5, pin.JointModelRZ(), place, f"joint {j}")
    for j, inertia in enumerate(inertias):
        model.inertias[j + 5] = inertia
    frames = []
    for u, (j, T) in enumerate(zip(tree.su_joint, truth.T_joint_su, strict=True)):
        at = pin.SE3(T) if j >= 0 else below.inverse() * pin.SE3(T)
        frame = pin.Frame(f"su {u}", int(j) + 5, at, pin.FrameType.OP_FRAME)
        frames.append(model.addFrame(frame))
    data, gives = model.createData(), np.zeros((len(q), 4))
    for _ in range(_SOLVED):
        x = np.hstack([gives, q])
        motion = x, first_derivative(x, RATE), second_derivative(x, RATE)
        loads = np.array([pin.rnea(model, data, *at)[:4] for at in zip(*motion, strict=True)])
        gives = -loads * [slides, slides, compliance, compliance]
    ideal = np.empty((len(q), len(frames), 3))
    for n, at in enumerate(zip(*motion, strict=True)):
        pin.forwardKinematics(model, data, *at)
        pin.updateFramePlacements(model, data)
        for u, frame in enumerate(frames):
            a = pin.getFrameClassicalAcceleration(model, data, frame, pin.ReferenceFrame.LOCAL)
            ideal[n, u] = a.linear + data.oMf[frame].rotation.T @ (9.81 * UP)
    return np.einsum("uij,kuj->kui", truth.sensor_matrix(), ideal) + truth.bias, gives[:, 2:]
