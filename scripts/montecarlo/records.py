"""What is repeated and what one recording comes to, as lines of JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

BLOCKS = (
    "joint axis, direction", "joint axis, offset", "SU position", "SU orientation",
    "bias", "scale", "cross-axis", "latency",
)  # fmt: skip
"""Blocks of parameters, in the order of the table."""


@dataclass(frozen=True)
class Case:
    """One recording.

    Attributes:
        robot: name in robots/.
        grade: sensor grade.
        excite: one DoF after the other, or all at once.
        poses: number of poses.
        seed: seed of the recording.
    """

    robot: str
    grade: str
    excite: str
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
class Run:
    """One line of the output.

    Attributes:
        case: what was recorded.
        blocks: by name, see :data:`BLOCKS`; empty where the calibration failed.
        cost_per_dof: chi-squared per degree of freedom.
        failure: why there are no blocks.
        code: digest of the package that ran.
    """

    case: Case
    blocks: Mapping[str, Block]
    cost_per_dof: float = 0.0
    failure: str = ""
    code: str = ""

    def to_json(self) -> str:
        """One line of JSON."""
        return json.dumps({"key": self.case.key, **asdict(self)}, allow_nan=False)

    @classmethod
    def from_json(cls, line: str) -> Run:
        """A run from its line.

        Raises:
            ValueError: the line is not a whole run.
        """
        try:
            content = json.loads(line)
            del content["key"]
            content["case"] = Case(**content["case"])
            blocks = content["blocks"].items()
            content["blocks"] = {
                name: Block(**{**block, "observable": tuple(block["observable"])})
                for name, block in blocks
            }
            return cls(**content)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"not a run: {error}") from error
