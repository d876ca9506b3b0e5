"""A robot as placements on a kinematic tree: what the estimation finds and the URDF holds."""

from __future__ import annotations

from dataclasses import dataclass

from skin2urdf.arrays import F64, frozen
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class KinematicModel:
    """Placements of all joints and SUs; every joint turns about (or slides along) its z axis.

    Attributes:
        tree: the structure, D joints and U SUs.
        T_parent_joint: (D, 4, 4) joint frame at position 0 in the frame of its parent joint
            (in the base frame for joints on the RS) [m].
        T_joint_su: (U, 4, 4) SU frame in the frame of its joint (base frame for SUs on the RS) [m].
    """

    tree: KinematicTree
    T_parent_joint: F64
    T_joint_su: F64

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_parent_joint", frozen(self.T_parent_joint))
        object.__setattr__(self, "T_joint_su", frozen(self.T_joint_su))
