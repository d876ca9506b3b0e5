"""What is repeated and what one recording comes to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from batch.records import Record

from skin2urdf.simulation.settings import Excitation

BLOCKS = (
    "joint axis, direction", "joint axis, offset", "SU position", "SU orientation",
    "SU orientation, felt", "bias", "scale", "cross-axis", "latency",
)  # fmt: skip
"""Blocks of parameters, in the order of the table."""


@dataclass(frozen=True)
class Case:
    """One recording.

    Attributes:
        robot: name in robots/.
        grade: sensor grade.
        excite: one DoF after the other, all at once, or moves without patterns.
        poses: number of poses.
        seed: seed of the recording.
    """

    robot: str
    grade: str
    excite: Excitation
    poses: int
    seed: int

    @property
    def key(self) -> str:
        """Names the case; the same case has the same key on every machine."""
        return f"{self.group} seed{self.seed}"

    @property
    def group(self) -> str:
        """Names what it shares with its repetitions."""
        return f"{self.robot} {self.grade} {self.excite} {self.poses}poses"


@dataclass(frozen=True)
class Block:
    """Errors of one block of parameters in one recording, over their stated uncertainty.

    Attributes:
        squared: sum of the squared errors, normalised by the stated covariances.
        dimensions: number of directions they have (the expectation of ``squared``).
        inside: number of coordinates within two standard deviations.
        coordinates: number of coordinates.
        observable: squares of the errors themselves, where the stated uncertainty says that the
            quantity is observable (bias [m/s^2], scale [1], latency [s]; empty elsewhere).
    """

    squared: float
    dimensions: int
    inside: int
    coordinates: int
    observable: tuple[float, ...] = ()


@dataclass(frozen=True)
class Figures:
    """What a recording comes to.

    Attributes:
        blocks: by name, see :data:`BLOCKS`.
        cost_per_dof: chi-squared per degree of freedom.
    """

    blocks: Mapping[str, Block]
    cost_per_dof: float


Run = Record[Case, Figures]
"""One line of the output."""
