"""What is written beside a model, and what a comparison of two URDFs finds (design section 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.structure.records import JointType

NO_LIMITS = "lower and upper are placeholders"
"""How a URDF says of a joint that its limits are nobody's."""


@dataclass(frozen=True, eq=False)
class JointLimits(Record):
    """Limits of D joints.

    Attributes:
        position: (D, 2) lower and upper position limit [rad or m].
        velocity: (D,) velocity limits [rad/s or m/s].
        soft: (D, 2) lower and upper soft limit; NaN where a joint has none.
        known: (D,) False where the position limits are placeholders.
    """

    position: F64
    velocity: F64
    soft: F64
    known: Bool


@dataclass(frozen=True)
class Remarks:
    """What is said as comments in a URDF.

    Attributes:
        head: at the top of the file.
        joints: about joints, by name.
        sus: about SUs, by name.
    """

    head: tuple[str, ...] = ()
    joints: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sus: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Spread:
    """Size of an error over many configurations.

    Attributes:
        rms: root of the mean square.
        max: largest value.
    """

    rms: float
    max: float

    @classmethod
    def of(cls, errors: F64) -> Spread:
        """Spread of errors of any shape; NaN for none."""
        if errors.size == 0:
            return cls(float("nan"), float("nan"))
        return cls(float(np.sqrt(np.mean(errors**2))), float(np.max(np.abs(errors))))

    def to_dict(self, scale: float) -> dict[str, float] | None:
        """Values times ``scale``, ready for JSON: None where there was nothing to compare."""
        if not np.isfinite(self.rms):
            return None
        return {"rms": self.rms * scale, "max": self.max * scale}


@dataclass(frozen=True)
class SuError:
    """Error of one SU's pose after alignment.

    Attributes:
        name: the SU.
        position: distance between estimated and true origin [m]; None where the log tells no
            part of it, as on the reference segment.
        orientation: angle between estimated and true frame [rad], on the reference segment
            between the gravity directions they imply; None likewise.
        n_unobservable: number of directions, of 6, that were left out because the log can not
            tell them.
    """

    name: str
    position: Spread | None
    orientation: Spread | None
    n_unobservable: int = 0


@dataclass(frozen=True)
class JointError:
    """Error of one joint's axis after alignment.

    Attributes:
        name: the joint.
        joint_type: its type in the estimate.
        angle: between estimated and true axis, sense included: 180 deg for a joint that counts
            the other way round [rad].
        distance: between the axis lines where the joint carries its SUs, None for a prismatic
            joint, whose axis has a direction only [m].
    """

    name: str
    joint_type: JointType
    angle: Spread
    distance: Spread | None


DifferenceKind = Literal["type", "chain", "extra joint", "missing joint", "missing SU"]
"""How trees differ: a joint is of another type, an SU or a joint lies beyond other joints, a joint
is in the estimate alone, or a joint or an SU in the truth alone."""


@dataclass(frozen=True)
class Difference:
    """Where an estimated tree differs from the true one.

    Attributes:
        kind: how.
        name: the joint or SU.
        words: the same for the user.
        found: its type, or the joints that move it, in the estimate.
        right: the same in the truth; of a missing joint the SUs that it moves.
    """

    kind: DifferenceKind
    name: str
    words: str
    found: tuple[str, ...] = ()
    right: tuple[str, ...] = ()

    def __str__(self) -> str:
        """In words."""
        return self.words


@dataclass(frozen=True, eq=False)
class Alignment(Record):
    """How one limb of the estimate, or all of it, was laid onto the truth.

    Attributes:
        limb: first joint of the limb; None for the whole robot.
        sus: the SUs that it carries and that count.
        anchors: those of them that it was aligned by.
        T_truth_estimate: (4, 4) the rigid transform of the base frame.
    """

    limb: str | None
    sus: tuple[str, ...]
    anchors: tuple[str, ...]
    T_truth_estimate: F64


def tilt_between(alignments: Sequence[Alignment]) -> float:
    """Largest angle between the directions that limbs take for up in the truth's base [rad].

    Gravity connects the limbs, so this is an error that aligning each of them by itself hides.
    """
    ups = np.array([alignment.T_truth_estimate[:3, 2] for alignment in alignments]).reshape(-1, 3)
    sine = np.linalg.norm(np.cross(ups[:, None], ups), axis=-1)
    return float(np.max(np.arctan2(sine, ups @ ups.T), initial=0.0))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Errors of an estimated robot that do not depend on free choices of frames.

    Attributes:
        sus: one entry per SU that counts.
        joints: one entry per joint that both robots have.
        position: SU position over all SUs and configurations [m].
        orientation: SU orientation likewise [rad].
        axis_angle: axis angles over all joints and configurations [rad].
        axis_distance: axis distances over all revolute joints and configurations [m].
        alignments: the rigid transforms, one per limb or one in all.
        tree_equal: whether every SU hangs on the same joints, of the same types, in the same order,
            and no joint that moves an SU and no expected SU is missing.
        tree_differences: where not.
        not_observable: SUs left out because the log says nothing of their pose.
        n_open: directions between branches that were left out because the log can not tell them.
        joints_left_out: joints of limbs that no observable SU aligns.
        unmatched: links of the estimate that look like SUs and that the truth does not have.
        held_joints: joints of only one of the robots, held at their neutral position.
        n_configurations: how many random configurations were compared.
        matched: joints that have other names in the truth: these by the estimate's names.
        placed: whether the truth has no SUs, so that each SU was placed on its link where it fits
            best; its errors are then those of its motion with that link.
        document: the JSON beside the estimate that told what the log leaves open; None where
            there is none, or this was told by the caller.
    """

    sus: tuple[SuError, ...]
    joints: tuple[JointError, ...]
    position: Spread
    orientation: Spread
    axis_angle: Spread
    axis_distance: Spread
    alignments: tuple[Alignment, ...]
    tree_equal: bool
    tree_differences: tuple[Difference, ...]
    not_observable: tuple[str, ...]
    n_open: int
    joints_left_out: tuple[str, ...]
    unmatched: tuple[str, ...]
    held_joints: tuple[str, ...]
    n_configurations: int
    matched: Mapping[str, str] = field(default_factory=dict)
    placed: bool = False
    document: Path | None = None

    @property
    def tilt_between_limbs(self) -> float:
        """Largest angle between the directions that limbs take for up [rad]."""
        return tilt_between(self.alignments)

    def to_dict(self) -> dict[str, Any]:
        """The comparison for a JSON file: lengths in mm, angles in deg, None for what is not."""
        degrees = float(np.rad2deg(1.0))
        return {
            "tree_equal": self.tree_equal,
            "tree_differences": [each.words for each in self.tree_differences],
            "overall": {
                "position_mm": self.position.to_dict(1e3),
                "orientation_deg": self.orientation.to_dict(degrees),
                "axis_angle_deg": self.axis_angle.to_dict(degrees),
                "axis_distance_mm": self.axis_distance.to_dict(1e3),
            },
            "sus": {
                su.name: {
                    "position_mm": su.position.to_dict(1e3) if su.position else None,
                    "orientation_deg": su.orientation.to_dict(degrees) if su.orientation else None,
                    "n_unobservable": su.n_unobservable,
                }
                for su in self.sus
            },
            "joints": {
                joint.name: {
                    "type": joint.joint_type,
                    "axis_angle_deg": joint.angle.to_dict(degrees),
                    "axis_distance_mm": joint.distance.to_dict(1e3) if joint.distance else None,
                }
                for joint in self.joints
            },
            "alignments": [
                {
                    "limb": each.limb,
                    "sus": list(each.sus),
                    "anchors": list(each.anchors),
                    "T_truth_estimate": each.T_truth_estimate.tolist(),
                }
                for each in self.alignments
            ],
            "tilt_between_limbs_deg": self.tilt_between_limbs * degrees,
            "not_observable": list(self.not_observable),
            "n_open": self.n_open,
            "joints_left_out": list(self.joints_left_out),
            "unmatched": list(self.unmatched),
            "held_joints": list(self.held_joints),
            "n_configurations": self.n_configurations,
            "matched": dict(self.matched),
            "placed": self.placed,
            "document": None if self.document is None else str(self.document),
        }
