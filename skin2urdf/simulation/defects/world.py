"""The place where the robot stands."""

from __future__ import annotations

from dataclasses import dataclass

from skin2urdf.simulation.defects.records import Defect


@dataclass(frozen=True)
class LocalGravity(Defect):
    """Gravity as it is there, not as everybody takes it.

    Attributes:
        size: of gravity [m/s^2]; from 9.764 to 9.834 on the ground of the Earth.
    """

    size: float = 9.781

    def gravity(self, gravity: float) -> float:
        """The place's own."""
        return self.size
