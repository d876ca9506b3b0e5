"""What a defect is: hooks where the physics of a recording can depart from the ideal.

Every hook leaves things as they are; a defect overrides those that it is about. The simulation
calls them in the order in which nature would: gravity, what gives way between the motors and the
links, what the place of an SU does, what the sensor makes of it, how its clock stamps, and what
arrives. None of them knows any formula of the estimator.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skin2urdf.arrays import F64, Int, Record
from skin2urdf.recording.records import JointStream, SuStream
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.skins import PlacedSu
from skin2urdf.simulation.trajectory import JointMotion


@dataclass(frozen=True, eq=False)
class Hinge(Record):
    """A place where a body bends, as elastic hinges one after the other in one point.

    Attributes:
        joint: the joint whose body it is; -1 for the base.
        point: (3,) where, in the frame of that joint (of the base) [m].
        axes: (k, 3) unit axes, in the same frame.
        stiffness: of each of the k hinges [N m/rad].
        damping: damping ratio of each, with the inertia it carries at the start.
        beyond: share of the body's inertia that lies beyond, from 0 to 1.
    """

    joint: int
    point: F64
    axes: F64
    stiffness: float
    damping: float
    beyond: float

    def carries(self, point: F64) -> bool:
        """Whether a point (3,) of the body lies beyond: not on the joint's side of the hinge."""
        if self.joint < 0:
            return True
        return bool(np.dot(point - self.point, self.point) >= 0.0)


@dataclass(frozen=True)
class Ripple:
    """A periodic error of a gear: the link is ahead of what the encoder says.

    Attributes:
        joint: whose gear.
        per_turn: periods in one turn of the joint.
        amplitude: amplitude [rad].
        phase: phase where the encoder reads 0 [rad].
    """

    joint: int
    per_turn: float
    amplitude: float
    phase: float


@dataclass(frozen=True, eq=False)
class Flexibility(Record):
    """What gives way between the encoders and the links of D joints.

    Attributes:
        stiffness: (D,) of the gears, inf where rigid [N m/rad or N/m].
        damping: (D,) damping ratios of the gears, with the inertia they carry at the start.
        play: (D,) width of the gap in each gear [rad or m].
        ripples: periodic errors of gears.
        hinges: where bodies bend.
    """

    stiffness: F64
    damping: F64
    play: F64
    ripples: tuple[Ripple, ...] = ()
    hinges: tuple[Hinge, ...] = ()

    @classmethod
    def none(cls, n_joints: int) -> Flexibility:
        """Rigid gears of D joints and rigid bodies."""
        zero = np.zeros(n_joints)
        return cls(np.full(n_joints, np.inf), zero, zero)

    @property
    def is_rigid(self) -> bool:
        """Whether nothing gives way under load."""
        return bool(np.isinf(self.stiffness).all()) and not self.hinges


@dataclass(frozen=True, eq=False)
class Moved(Record):
    """What really moves, with all that bends.

    Attributes:
        mechanism: the robot with a joint for every hinge; without hinges the robot itself.
        motion: the motion of its joints.
        sus: U SUs at their places on it.
        rows: (D,) which of its joints are the robot's D joints.
        motor: the motion that the encoders of the D joints see.
        borne: (K, D) what the gears bear at the times of ``motion``, link-side [N m or N]; None
            where nothing gives way, since then nobody needed it.
    """

    mechanism: Mechanism
    motion: JointMotion
    sus: tuple[PlacedSu, ...]
    rows: Int
    motor: JointMotion
    borne: F64 | None = None

    @property
    def links(self) -> JointMotion:
        """Motion of the D joints on the side of the links."""
        if self.motion.position.shape[1] == len(self.rows):
            return self.motion
        return JointMotion(self.motion.time, self.motion.position[:, self.rows])

    def torque(self, time: F64) -> F64:
        """(N, D) what the gears bear at times (N,), link-side [N m or N]."""
        if self.borne is not None:
            from scipy.interpolate import make_interp_spline

            return np.asarray(make_interp_spline(self.motion.time, self.borne, k=3)(time))
        return self.mechanism.torques(*self.motion.at(time))


@dataclass(frozen=True, eq=False)
class Felt:
    """What one SU feels over a recording.

    Attributes:
        su: the SU's name.
        time: (N,) regular true times [s].
        force: (N, 3) specific force in the SU's frame [m/s^2].
        speed: (N,) sum of the speeds of the joints that carry it [rad/s]; metres count as radians.
    """

    su: str
    time: F64
    force: F64
    speed: F64 = field(repr=False)


@dataclass(frozen=True)
class Defect:
    """Something that is not ideal; this one is nothing."""

    def gravity(self, gravity: float) -> float:
        """Size of gravity where the robot stands [m/s^2]."""
        return gravity

    def loosen(
        self, flexibility: Flexibility, mechanism: Mechanism, rng: np.random.Generator
    ) -> Flexibility:
        """What gives way, with this defect."""
        return flexibility

    def shake(self, felt: Felt, rng: np.random.Generator) -> F64:
        """(N, 3) specific force at the SU's place [m/s^2]."""
        return felt.force

    def sense(self, felt: Felt, rng: np.random.Generator) -> F64:
        """(N, 3) what the sensor makes of it before noise, range and digits [m/s^2]."""
        return felt.force

    def clock(self, time: F64, rng: np.random.Generator) -> F64:
        """(N,) what the SU's clock shows at true times, before jitter [s]."""
        return time

    def send(self, stream: SuStream, rng: np.random.Generator) -> SuStream:
        """What arrives of an SU's stream."""
        return stream

    def publish(
        self, joints: tuple[JointStream, ...], rng: np.random.Generator
    ) -> tuple[JointStream, ...]:
        """What arrives of the joints' streams."""
        return joints
