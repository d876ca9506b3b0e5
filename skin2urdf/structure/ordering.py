"""Where a tree's joints and SUs stand in what is listed in another order.

A log lists its joints and SUs in any order, and so do the features taken from it; a tree lists its
joints from the base outwards, and only those that move something. This is the only place that
translates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from skin2urdf.arrays import Int, Record
from skin2urdf.structure.records import KinematicTree


class Listed(Protocol):
    """What lists DoFs and SUs by name: features, activity."""

    @property
    def dof_names(self) -> tuple[str, ...]:
        """DoF names."""
        ...

    @property
    def su_names(self) -> tuple[str, ...]:
        """SU names."""
        ...


@dataclass(frozen=True, eq=False)
class Ordering(Record):
    """Indices of the D joints and U SUs of a tree in a list of others.

    Attributes:
        dof: (D,) index of each of the tree's joints among the listed DoFs.
        su: (U,) index of each of its SUs among the listed ones.
        n_dofs: how many DoFs are listed.
    """

    dof: Int
    su: Int
    n_dofs: int

    @staticmethod
    def of(tree: KinematicTree, listed: Listed) -> Ordering:
        """Where the joints and SUs of a tree stand in a list.

        Raises:
            ValueError: the list lacks one of them.
        """
        return Ordering(
            places_of(tree.joint_names, listed.dof_names),
            places_of(tree.su_names, listed.su_names),
            len(listed.dof_names),
        )

    @property
    def rows(self) -> Int:
        """(1 + 2 D,) rows of f0, s and tau of the tree's joints in a listed feature block."""
        zero = np.zeros(1, dtype=np.int64)
        return np.concatenate([zero, 1 + self.dof, 1 + self.n_dofs + self.dof])


def places_of(names: Sequence[str], listed: Sequence[str]) -> Int:
    """Index of each of some names in a list of names.

    Raises:
        ValueError: a name is not listed.
    """
    place = {name: i for i, name in enumerate(listed)}
    missing = [name for name in names if name not in place]
    if missing:
        raise ValueError(f"not listed: {', '.join(missing)}")
    return np.array([place[name] for name in names], dtype=np.int64)


def bare_neighbours(parent: Sequence[int] | Int, su_joint: Int) -> list[int]:
    """Joints that follow another one with no SU and no branch in between.

    Args:
        parent: (D,) the joint before each joint, -1 for the base.
        su_joint: (U,) the joint that carries each SU.
    """
    before = list(map(int, parent))
    bare = set(before) - {-1} - set(map(int, su_joint))
    return [j for j, p in enumerate(before) if p in bare and before.count(p) == 1]
