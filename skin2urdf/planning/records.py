"""What a plan is made of, and what it is made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from skin2urdf.arrays import F64, Bool, Record
from skin2urdf.errors import check_ranges, check_setting
from skin2urdf.planning.trajectory import JointTrajectory

PhaseKind = Literal["rest", "move", "structural", "pattern"]


@dataclass(frozen=True, eq=False)
class Limits(Record):
    """What D joints may do.

    Attributes:
        joint_names: the joints.
        prismatic: (D,) True where a joint slides.
        lower: (D,) positions [rad or m]; -inf where there is no limit.
        upper: (D,) likewise, inf.
        velocity: (D,) largest speeds [rad/s or m/s].
        acceleration: (D,) largest accelerations [rad/s^2 or m/s^2].
        jerk: (D,) largest jerks [rad/s^3 or m/s^3].
        notes: what was assumed, in words.
    """

    joint_names: tuple[str, ...]
    prismatic: Bool
    lower: F64
    upper: F64
    velocity: F64
    acceleration: F64
    jerk: F64
    notes: tuple[str, ...] = ()

    @property
    def n_joints(self) -> int:
        """Number of joints D."""
        return len(self.joint_names)


@dataclass(frozen=True)
class PlanSettings:
    """Choices of a plan.

    Attributes:
        minutes: how long it takes.
        seed: random candidates are drawn from it.
        share: part of all limits but those of positions that the motion uses.
        full_scale: largest reading of the accelerometers [m/s^2].
        rest: time at rest in a pose before a pattern [s].
        settle: time at rest after a pattern, and after a structural move [s].
        least_pattern: shortest pattern [s].
        ramp: duration of either flank of a pattern's window [s]. Steep flanks take what limits of
            acceleration leave for the tones: in two minutes, flanks of 0.4, 0.8 and 1.2 s give a
            panda 0.041, 0.037 and 0.036 mm, and long ones leave little of short patterns.
        band: lowest and highest frequency of patterns [Hz]. Encoder noise grows with the band of
            what is compared, lever arms want accelerations: of six bands between 0.5 and 4.5 Hz
            this gives a panda the smallest deviations.
        candidates: random poses that the best are chosen from.
        half_range: poses lie within this of the middle of a range [rad, m].
    """

    minutes: float = 3.0
    seed: int = 0
    share: float = 1.0
    full_scale: float = 2 * 9.81
    rest: float = 0.8
    settle: float = 0.5
    least_pattern: float = 4.0
    ramp: float = 0.8
    band: tuple[float, float] = (0.6, 2.6)
    candidates: int = 200
    half_range: tuple[float, float] = (2.62, 0.3)

    def __post_init__(self) -> None:
        check_ranges(
            self, {"minutes": (1e-3, 24 * 60), "share": (1e-3, 1.0), "seed": (0, float("inf"))}
        )
        # In other units on the command line.
        reaches = 10.0 < self.full_scale < 1e4
        check_setting("full_scale", "must reach beyond gravity, as that of 2 g does", reaches)


@dataclass(frozen=True)
class Phase:
    """What the robot does for some time.

    Attributes:
        kind: rest, move between poses, structural move of one joint, or pattern around a pose.
        start: first instant [s].
        end: last instant [s].
        joint: the joint that moves alone; -1 where none or several do.
        pose: index of the pose it is in; -1 in moves.
    """

    kind: PhaseKind
    start: float
    end: float
    joint: int = -1
    pose: int = -1


@dataclass(frozen=True, eq=False)
class Plan(Record):
    """A motion to record.

    Attributes:
        trajectory: the motion.
        phases: what it does when, without gaps.
        poses: (P, D) poses with patterns, in the order visited [rad or m].
        limits: what it holds.
        checked: number of pairs of bodies that were kept apart all along; None where the bodies'
            shapes are not known.
        notes: what was assumed and left out, in words.
    """

    trajectory: JointTrajectory
    phases: tuple[Phase, ...]
    poses: F64
    limits: Limits
    checked: int | None
    notes: tuple[str, ...]
