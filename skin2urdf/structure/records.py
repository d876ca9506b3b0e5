"""The kinematic tree: which joint hangs on which, and which SU sits on which segment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from skin2urdf.arrays import Bool, Int, Record
from skin2urdf.notes import Note

JointType = Literal["revolute", "prismatic"]


@dataclass(frozen=True, eq=False)
class KinematicTree(Record):
    """A rooted tree of single-DoF joints; segment j is what joint j carries.

    Joints are in topological order: ``parent[j] < j``. Index -1 is the reference segment (RS).

    Attributes:
        joint_names: D joint names as in the log.
        parent: (D,) index of the joint before each joint, -1 for the RS.
        joint_types: D joint types.
        su_names: U SU names.
        su_joint: (U,) index of the last joint before each SU; -1 for an SU on the RS.
        notes: repairs and omissions.
    """

    joint_names: tuple[str, ...]
    parent: Int
    joint_types: tuple[JointType, ...]
    su_names: tuple[str, ...]
    su_joint: Int
    notes: tuple[Note, ...] = field(default=())

    @property
    def n_joints(self) -> int:
        """Number of joints D."""
        return len(self.joint_names)

    @property
    def n_sus(self) -> int:
        """Number of SUs U."""
        return len(self.su_names)

    def chain(self, joint: int) -> tuple[int, ...]:
        """Joints from the RS to ``joint``, both ends included; empty for -1."""
        path: list[int] = []
        while joint >= 0:
            path.append(joint)
            joint = int(self.parent[joint])
        return tuple(reversed(path))

    @property
    def depth_first(self) -> Int:
        """(D,) joints in an order in which those that one carries follow it in a row.

        Pinocchio's algorithms for inertias and for derivatives of torques ask for that.
        """
        chains = [self.chain(joint) for joint in range(self.n_joints)]
        return np.array(sorted(range(self.n_joints), key=chains.__getitem__), dtype=np.int64)

    def is_like(self, other: KinematicTree) -> bool:
        """Whether both have the same joints before the same SUs, in the same order."""
        return self.chains() == other.chains()

    def chains(self) -> dict[str, list[str]]:
        """Names of the joints before each SU, from the RS outwards, by the SU's name."""
        return {
            name: [self.joint_names[j] for j in self.chain(int(joint))]
            for name, joint in zip(self.su_names, self.su_joint, strict=True)
        }

    def activity(self) -> Bool:
        """(U, D) activity matrix this tree produces (paper II-B.1)."""
        active = np.zeros((self.n_sus, self.n_joints), dtype=bool)
        for u, joint in enumerate(self.su_joint):
            active[u, list(self.chain(int(joint)))] = True
        return active

    @property
    def prismatic(self) -> Bool:
        """(D,) True where a joint is prismatic."""
        return np.array([t == "prismatic" for t in self.joint_types], dtype=bool)
