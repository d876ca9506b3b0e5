"""The tree as a Pinocchio model whose placements are written in place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.structure.records import KinematicTree

if TYPE_CHECKING:
    from skin2urdf.model.records import KinematicModel


class PinocchioTree:
    """Pinocchio model of a kinematic tree; joints turn about or slide along their z axis.

    Attributes:
        tree: the tree it was built from.
        model: the ``pinocchio.Model``; joint i + 1 of it is joint i of the tree, and frame
            ``frame_ids[u]`` is SU u. Kinematics and torques are right in any order of joints,
            Pinocchio's inertias in that of :attr:`KinematicTree.depth_first` alone.
        frame_ids: Pinocchio frame index of each SU.
    """

    def __init__(self, tree: KinematicTree) -> None:
        import pinocchio as pin

        self.tree = tree
        self.model = pin.Model()
        for name, parent, kind in zip(tree.joint_names, tree.parent, tree.joint_types, strict=True):
            joint = pin.JointModelPZ() if kind == "prismatic" else pin.JointModelRZ()
            self.model.addJoint(int(parent) + 1, joint, pin.SE3.Identity(), name)
        self.frame_ids = tuple(
            self.model.addFrame(
                pin.Frame(name, int(joint) + 1, pin.SE3.Identity(), pin.FrameType.OP_FRAME)
            )
            for name, joint in zip(tree.su_names, tree.su_joint, strict=True)
        )
        self._data = self.model.createData()
        self._forward_kinematics = pin.forwardKinematics

    def write_joints(self, T_parent_joint: F64) -> None:
        """Write joint placements (D, 4, 4) into the model in place; takes effect at once."""
        for i, T in enumerate(T_parent_joint):
            at = self.model.jointPlacements[i + 1]
            at.rotation = T[:3, :3]
            at.translation = T[:3, 3]

    def write_sus(self, T_joint_su: F64) -> None:
        """Write SU placements (U, 4, 4) into the model's frames in place."""
        for frame, T in zip(self.frame_ids, T_joint_su, strict=True):
            at = self.model.frames[frame].placement
            at.rotation = T[:3, :3]
            at.translation = T[:3, 3]

    def joint_frames(self, q: F64) -> tuple[F64, F64]:
        """Joint frames in the base frame at every pose, from Pinocchio's forward kinematics.

        Args:
            q: (P, D) joint positions.

        Returns:
            R_base_joint (P, D, 3, 3) and p_base_joint (P, D, 3) [m].
        """
        P, D = q.shape
        R, p = np.empty((P, D, 3, 3)), np.empty((P, D, 3))
        frames: Any = self._data.oMi
        for i in range(P):
            self._forward_kinematics(self.model, self._data, q[i])
            for d in range(D):
                frame = frames[d + 1]
                R[i, d] = frame.rotation
                p[i, d] = frame.translation
        return R, p


def to_pinocchio(model: KinematicModel) -> Any:
    """``pinocchio.Model`` of a finished model, SUs as operational frames."""
    built = PinocchioTree(model.tree)
    built.write_joints(model.T_parent_joint)
    built.write_sus(model.T_joint_su)
    return built.model
