"""Bodies that bend under their load: links, and the base below the robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skin2urdf.arrays import F64
from skin2urdf.simulation.defects.records import Defect, Flexibility, Hinge
from skin2urdf.simulation.mechanism import Mechanism


@dataclass(frozen=True)
class LinkFlex(Defect):
    """Links that bend in their middle, across the way to the next joint.

    Attributes:
        stiffness: about each of the two axes across the link [N m/rad].
        damping: damping ratio, with the inertia beyond.
    """

    stiffness: float = 50_000.0
    damping: float = 0.02

    def loosen(
        self, flexibility: Flexibility, mechanism: Mechanism, rng: np.random.Generator
    ) -> Flexibility:
        """A hinge in every link between two joints that are apart."""
        hinges = []
        for d in range(mechanism.n_joints):
            children = np.flatnonzero(mechanism.parent == d)
            origins = [mechanism.model.jointPlacements[int(c) + 1].translation for c in children]
            if not origins:
                continue
            middle = 0.5 * np.mean(origins, axis=0)
            # Two joints in one point have no link between them that could bend.
            if np.linalg.norm(middle) < 0.01:
                continue
            hinges.append(Hinge(d, middle, _across(middle), self.stiffness, self.damping, 0.5))
        return replace(flexibility, hinges=(*flexibility.hinges, *hinges))


@dataclass(frozen=True)
class YieldingBase(Defect):
    """A stand that tilts under the moment of the robot's weight and swings when it moves.

    Attributes:
        stiffness: about each of two axes across the vertical axis of the base [N m/rad].
        damping: damping ratio, with the inertia of the robot.
        depth: how far below the base's frame it gives way [m].
    """

    stiffness: float = 50_000.0
    damping: float = 0.05
    depth: float = 0.3

    def loosen(
        self, flexibility: Flexibility, mechanism: Mechanism, rng: np.random.Generator
    ) -> Flexibility:
        """A hinge below the base."""
        point = np.array([0.0, 0.0, -self.depth])
        hinge = Hinge(-1, point, np.eye(3)[:2], self.stiffness, self.damping, 1.0)
        return replace(flexibility, hinges=(hinge, *flexibility.hinges))


def _across(direction: F64) -> F64:
    """(2, 3) unit vectors perpendicular to a direction (3,) and to each other."""
    _, _, Vt = np.linalg.svd(direction[None])
    return np.asarray(Vt[1:])
