"""Axes and SU orientations at position zero: what the closed-form starts produce.

All directions are given in one frame, the base frame with the robot at position zero, so a chain's
rotation is a product of exponentials: R_base_segment = Rot(k_1, q_1) ... Rot(k_n, q_n).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.estimation.problem.blocks import FeatureBlocks
from skin2urdf.estimation.problem.cost import Priors
from skin2urdf.estimation.problem.state import State
from skin2urdf.geometry.se3 import inverse, placement
from skin2urdf.geometry.so3 import axis_rotation, cross, frame_with_z, skew, wahba
from skin2urdf.structure.records import KinematicTree

ROUGH_BIAS = 0.3
"""Error [m/s^2] a static reading may have before bias and scale are known; weighs the starts."""


@dataclass(frozen=True, eq=False)
class Orientations:
    """Joint axes and SU orientations at position zero, in the base frame.

    Attributes:
        axes: (D, 3) unit joint axes.
        R_base_su: (U, 3, 3) SU orientations.
        up: (G, 3) unit vectors opposite to gravity, per log; the first is z.
        information: (U, 3, 3) on the turns of each SU about the base axes, per pose [1/rad^2].
        handed: (U,) chi-squared that speaks for right-handed SUs; negative where a mirror image of
            the readings fits better, 0 where all of them lie in a plane.
        left: (U,) chi-squared that the better of both images leaves.
    """

    axes: F64
    R_base_su: F64
    up: F64
    information: F64
    handed: F64
    left: F64

    def state(self, tree: KinematicTree) -> State:
        """A state with these orientations and every origin in the base's origin."""
        world = placement(frame_with_z(self.axes), np.zeros((tree.n_joints, 3)))
        base = np.eye(4)
        T_parent_joint = np.array(
            [inverse(world[j] if j >= 0 else base) @ world[i] for i, j in enumerate(tree.parent)]
        ).reshape(-1, 4, 4)
        sus = placement(self.R_base_su, np.zeros((tree.n_sus, 3)))
        T_joint_su = np.array(
            [
                inverse(world[j] if j >= 0 else base) @ T
                for T, j in zip(sus, tree.su_joint, strict=True)
            ]
        ).reshape(-1, 4, 4)
        U = tree.n_sus
        return State(T_parent_joint, T_joint_su, self.up, np.zeros((U, 3)), np.zeros((U, 6)))


def su_orientation(
    blocks: FeatureBlocks, su: int, axes: F64, prismatic: Bool, up: F64, priors: Priors
) -> tuple[F64, F64, float, float]:
    """Orientation of one SU at position zero, given the axes of its chain.

    Wahba's problem over all poses: static gravity, its change with every revolute DoF, and the
    push of every prismatic one.

    Args:
        blocks: the features.
        su: which SU.
        axes: (n, 3) axes of the SU's chain at position zero, base frame.
        prismatic: (n,) True for prismatic joints.
        up: (G, 3) up vectors per log.
        priors: gravity's magnitude.

    Returns:
        R_base_su (3, 3), the information (3, 3) on its turns about the base axes [1/rad^2], per
        pose, the chi-squared that a mirror image of the readings would have more, and what the
        better of both images has.
    """
    n, L = len(axes), blocks.chains.joint.shape[1]
    chain = blocks.chains.joint[su, :n]
    ok = np.isfinite(blocks.noise[:, su]).all(axis=1)
    q = blocks.q[ok][:, chain]
    variance = (blocks.noise[ok, su] ** 2).mean(axis=1)
    gravity = up[blocks.log[ok]] * priors.gravity
    body = [blocks.coefficients[ok, su, 0]]
    R = np.broadcast_to(np.eye(3), (len(q), 3, 3))
    turned_axes = []
    for i in range(n):
        turned_axes.append(R @ axes[i])
        if not prismatic[i]:
            R = R @ axis_rotation(axes[i], q[:, i])
    Rt = np.swapaxes(R, -1, -2)
    f0 = (Rt @ gravity[..., None])[..., 0]
    reference = [f0]
    weights = [1 / (variance * blocks.variance[ok, su, 0] + ROUGH_BIAS**2)]
    for i in range(n):
        w = (Rt @ turned_axes[i][..., None])[..., 0]
        row = 1 + L + i if prismatic[i] else 1 + i
        rough = ROUGH_BIAS / priors.gravity if prismatic[i] else ROUGH_BIAS
        reference.append(w if prismatic[i] else cross(f0, w))
        body.append(blocks.coefficients[ok, su, row])
        weights.append(1 / (variance * blocks.variance[ok, su, row] + rough**2))
    known, weight = np.concatenate(reference), np.concatenate(weights)
    seen = np.concatenate(body)
    R_ref_body, singular = wahba(seen, known, weight)
    S = skew(known)
    information = np.einsum("n,nji,njk->ik", weight, S, S) / max(1, len(q))
    # The last singular value counts for one of the two images, and against the other.
    fit = np.einsum("n,ni,ij,nj->", weight, known, R_ref_body, seen)
    handed = float(4 * (fit - singular[0] - singular[1]))
    square = float(np.einsum("n,ni->", weight, known**2 + seen**2))
    left = max(0.0, square - 2 * fit + min(handed, 0.0))
    return R_ref_body, information, handed, left


def with_all_sus(
    tree: KinematicTree, blocks: FeatureBlocks, axes: F64, up: F64, priors: Priors
) -> Orientations:
    """Orientations of all SUs for given joint axes (D, 3)."""
    prismatic = tree.prismatic
    found = [
        su_orientation(blocks, u, axes[list(c)], prismatic[list(c)], up, priors)
        for u, c in enumerate(tree.chain(int(j)) for j in tree.su_joint)
    ]
    R, information, handed, left = (np.array(part) for part in zip(*found, strict=True))
    return Orientations(axes, R, up, information, handed, left)


def axes_at_zero(tree: KinematicTree, state: State) -> F64:
    """(D, 3) unit joint axes of a state with the robot at position zero, in the base frame."""
    R = np.empty((tree.n_joints, 3, 3))
    for j, parent in enumerate(tree.parent):
        own = state.T_parent_joint[j, :3, :3]
        R[j] = R[parent] @ own if parent >= 0 else own
    return R[:, :, 2]
