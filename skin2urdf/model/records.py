"""A robot as placements on a kinematic tree: what the estimation finds and the URDF holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from skin2urdf.arrays import F64, Record, frozen
from skin2urdf.geometry.se3 import adjoint
from skin2urdf.structure.records import KinematicTree


@dataclass(frozen=True, eq=False)
class KinematicModel(Record):
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


@dataclass(frozen=True, eq=False)
class OpenDirection:
    """A way in which parts of a robot may sit elsewhere without any reading telling.

    Twists are (linear [m], angular [rad]) in the local frame of the placement that they move,
    ``T -> T exp(a xi)`` with one amplitude a for all; what is not named stays where it is.

    Attributes:
        joints: (6,) twists of joint placements, by joint name.
        sus: (6,) twists of SU placements, by SU name.
    """

    joints: Mapping[str, F64]
    sus: Mapping[str, F64]

    def __post_init__(self) -> None:
        for name in ("joints", "sus"):
            twists = {key: frozen(xi) for key, xi in getattr(self, name).items()}
            object.__setattr__(self, name, twists)

    def seen_from(self, T_new_old: Mapping[str, F64]) -> OpenDirection:
        """The same for joint frames that are placed differently on the same joints.

        Args:
            T_new_old: (4, 4) old frame in the new one, by joint name.
        """
        moved = {name: adjoint(T_new_old[name]) @ xi for name, xi in self.joints.items()}
        return OpenDirection(moved, self.sus)
