"""The tree with hinges in it where a body bends: what a base that gives way adds to a robot.

A base that gives way turns a little about its three axes and shifts along them under its load. That
is a chain of six joints between the ground and the robot, which no encoder has: their placements
are fixed, and their motion comes from what is unseen. All formulas that hold for a tree of joints
hold for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from skin2urdf.arrays import F64, Bool, Int, frozen
from skin2urdf.estimation.problem.state import identifiable
from skin2urdf.model.records import KinematicModel
from skin2urdf.structure.records import JointType, KinematicTree

N_HINGES = 6
"""Shifts along, and turns about, the axes of the base."""


def shift(tree: KinematicTree, axis: int) -> int:
    """Number of the base's shift along an axis, behind the joints of the tree."""
    return tree.n_joints + axis


def turn(tree: KinematicTree, axis: int) -> int:
    """Number of the base's turn about an axis, behind the joints of the tree."""
    return tree.n_joints + 3 + axis


def joints_on_hinges(tree: KinematicTree) -> Bool:
    """(D, 4) coordinates tx, ty, rx, ry of joints that readings show if the base moves.

    Where the first limb is relative to the base's frame is a choice. Where the others are is not:
    by their distance from the first they load the base more or less, and feel more of its swing.
    """
    free = np.array(identifiable(tree, 1).joints)
    slides = tree.prismatic
    # Limbs on what only slides are as unconnected as limbs on the base.
    first = [
        j for j in range(tree.n_joints) if not slides[j] and slides[list(tree.chain(j)[:-1])].all()
    ]
    free[first[1:], :2] = True
    return free


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of D joints and the hinges below it.

    What moves is numbered: joints as in the tree, behind them the six hinges of the base, whether
    they are there or not.

    Attributes:
        robot: the tree without hinges.
        hinges: (H,) numbers of those that are there, in ascending order.
    """

    robot: KinematicTree
    hinges: Int

    def __post_init__(self) -> None:
        object.__setattr__(self, "hinges", frozen(np.unique(self.hinges), np.int64))

    @classmethod
    def of(cls, robot: KinematicTree, moved: Sequence[int] | Int) -> Skeleton:
        """A skeleton in which all can move that is numbered."""
        numbers = np.asarray(moved, dtype=np.int64)
        return cls(robot, numbers[numbers >= robot.n_joints])

    @cached_property
    def numbers(self) -> Int:
        """(H + D,) numbers of the joints of the tree with hinges, which has these first."""
        return np.concatenate([self.hinges, np.arange(self.robot.n_joints)])

    @cached_property
    def tree(self) -> KinematicTree:
        """The tree with the hinges in it."""
        robot, H = self.robot, len(self.hinges)
        if not H:
            return robot
        kinds: tuple[JointType, ...] = tuple(
            "prismatic" if h < robot.n_joints + 3 else "revolute" for h in self.hinges
        )
        return replace(
            robot,
            joint_names=(
                *(f"base hinge {h - robot.n_joints}" for h in self.hinges),
                *robot.joint_names,
            ),
            # What stood on the ground stands on the last hinge.
            parent=np.concatenate([np.arange(H) - 1, robot.parent + H]),
            joint_types=(*kinds, *robot.joint_types),
            su_joint=robot.su_joint + H,
        )

    def placements(self, T_parent_joint: F64) -> F64:
        """(H + D, 4, 4) placements of the tree with hinges from those (D, 4, 4) of the robot."""
        H = len(self.hinges)
        if not H:
            return T_parent_joint
        axes = (self.hinges - self.robot.n_joints) % 3
        # z of the frame in which a hinge is placed is the base's axis x, y or z.
        frames = [np.eye(4), *(_placed_along(int(axis)) for axis in axes)]
        hinges = [before.T @ after for before, after in pairwise(frames)]
        T = np.concatenate([hinges, T_parent_joint])
        roots = H + np.flatnonzero(self.robot.parent < 0)
        T[roots] = frames[-1].T @ T[roots]
        return T

    def model(self, T_parent_joint: F64, T_joint_su: F64) -> KinematicModel:
        """The robot on its hinges, from the placements (D, 4, 4) and (U, 4, 4) of the robot."""
        if len(self.hinges):
            T_joint_su = self.su_placements(T_joint_su)
        return KinematicModel(self.tree, self.placements(T_parent_joint), T_joint_su)

    def su_placements(self, T_joint_su: F64) -> F64:
        """(U, 4, 4) placements of SUs; those on the base stand on its last hinge."""
        resting = self.robot.su_joint < 0
        if not len(self.hinges) or not resting.any():
            return T_joint_su
        T = np.array(T_joint_su)
        last = _placed_along(int(self.hinges[-1] - self.robot.n_joints) % 3)
        T[resting] = last.T @ T[resting]
        return T


def _placed_along(axis: int) -> F64:
    """(4, 4) placement whose z axis is axis x, y or z of the frame it is in."""
    T = np.eye(4)
    T[:3, :3] = np.roll(np.eye(3), 2 - axis, axis=1)
    return frozen(T)
