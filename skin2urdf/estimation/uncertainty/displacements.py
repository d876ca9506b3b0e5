"""How SUs move when placements of a robot move: the same at every scale, poses and bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.estimation.problem.state import State
from skin2urdf.geometry.se3 import adjoint, inverse, placement
from skin2urdf.model.kinematics import PinocchioTree
from skin2urdf.model.prediction import Chains, joint_twists, su_kinematics, zero_frames
from skin2urdf.model.records import OpenDirection
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class Displacements:
    """Motions of all SUs at C configurations, to first order.

    Results are seen in the SU's own frame: linear part [m] first, angular part [rad] times an arm.

    Attributes:
        tree: the structure.
        chains: chains of its SUs, L joints at most.
        by_joint: (C, U, L, 6, 6) per twist (linear, angular) of a joint's placement on the chain,
            in that placement's frame; zero where padded.
        by_base: (C, U, 6, 6) per motion of the whole base frame.
        scale: (6,) 1 for lengths, the arm for angles.
    """

    tree: KinematicTree
    chains: Chains
    by_joint: F64
    by_base: F64
    scale: F64

    @staticmethod
    def of(tree: KinematicTree, state: State, q: F64, arm: float) -> Displacements:
        """Displacements of a robot at configurations q (C, D) [rad or m].

        Args:
            tree: the structure.
            state: its placements.
            q: the configurations.
            arm: what angles are multiplied by [m].
        """
        chains = Chains.of(tree)
        pinocchio = PinocchioTree(tree)
        pinocchio.write_joints(state.T_parent_joint)
        R, p = pinocchio.joint_frames(q)
        up = np.tile([0.0, 0.0, 1.0], (len(q), 1))
        kin = su_kinematics(chains, tree.su_joint, R, p, state.T_joint_su, up)
        basis = np.tile(np.eye(6), (tree.n_joints, 1, 1))
        twists = joint_twists(chains, kin, *zero_frames(R, p, q, tree.prismatic), basis)
        scale = np.repeat([1.0, arm], 3)
        base = adjoint(inverse(placement(kin.R, kin.p)))
        return Displacements(tree, chains, twists * scale[:, None], base * scale[:, None], scale)

    def along(self, direction: OpenDirection) -> F64:
        """(C, U, 6) motions of the SUs along an open direction."""
        tree, chains = self.tree, self.chains
        joints = np.zeros((tree.n_joints, 6))
        for name, xi in direction.joints.items():
            joints[tree.joint_names.index(name)] = xi
        own = np.zeros((tree.n_sus, 6))
        for name, xi in direction.sus.items():
            own[tree.su_names.index(name)] = xi
        moved = joints[chains.joint] * chains.present[..., None]
        return np.asarray(np.einsum("culij,ulj->cui", self.by_joint, moved) + own * self.scale)
