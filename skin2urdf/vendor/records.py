"""The result of a calibration on a given model, and what may deviate in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.calibration.result import GOOD_FIT, Quality, Source, SuSource
from skin2urdf.calibration.settings import CalibrationSettings
from skin2urdf.estimation.trajectory.blueprint import N_MOUNT, Blueprint, turn_axes
from skin2urdf.estimation.trajectory.motion_estimate import MotionEstimate
from skin2urdf.estimation.uncertainty.observability import Observability
from skin2urdf.faults import Fault
from skin2urdf.notes import Noted
from skin2urdf.signals.records import JointClock, SuClock
from skin2urdf.structure.records import KinematicTree
from skin2urdf.vendor.leftover import Leftover
from skin2urdf.vendor.matching import Chassis

What = Literal["none", "zeros", "all"]

SIGNIFICANT = 4.0
"""Deviation over its standard deviation from which it is named: of the few hundred numbers of a
robot, chance exceeds it in one of a hundred robots."""


TURNED = 0.1
"""Angle between the base's z axis and the vertical from which a mount is no level one [rad]: five
times what tables and floors are off."""


@dataclass(frozen=True)
class Correction:
    """What of a model may deviate from the robot, as standard deviations.

    Attributes:
        what: nothing, the zeros of the encoders, or all placements.
        length: of a placement's position, each axis, and of a sliding joint's zero [m].
        angle: of its direction, each axis [rad].
        zero: of an encoder's zero [rad].
    """

    what: What = "none"
    length: float = 1e-3
    angle: float = float(np.deg2rad(0.1))
    zero: float = 5e-3

    def deviations(self, chassis: Chassis) -> F64:
        """(D, 6) standard deviations of each joint's placement [m, rad]."""
        out = np.zeros((chassis.n_joints, 6))
        if self.what == "all":
            out[:, :3], out[:, 3:] = self.length, self.angle
        if self.what != "none":
            for j, kind in enumerate(chassis.joint_types):
                slides = kind == "prismatic"
                at, size = (2, self.length) if slides else (5, self.zero)
                out[j, at] = np.hypot(out[j, at], size)
        return out


@dataclass(frozen=True, eq=False)
class ModelCalibration:
    """SUs found on a given model.

    Attributes:
        chassis: the model, D joints.
        correction: what of it was asked to be corrected.
        blueprint: what was known of it before.
        along: what all samples say.
        left: what they leave.
        observability: what of it the logs determine; frames as in ``along``.
        instead: per SU, further joints behind which it may sit as well.
        offsets: by joint, by how much its zero is off that was found beyond what is common
            [rad or m]; ``blueprint`` has them already.
        odd: SUs that fit on no link while the others do, with what is left of their readings over
            what noise makes of it.
        sources: the logs.
        settings: choices.
        faults: what is wrong with the SUs' streams.
        left_out: SUs without usable readings.
        notes: what else was found, in words.
        seconds: time each stage took [s].
        clocks: by log, the SUs whose clock ran differently from the joints'.
        su_sources: where the SUs' readings come from, by name.
        publishers: by log, publishers of joint states whose clock is off that of most joints.
    """

    chassis: Chassis
    correction: Correction
    blueprint: Blueprint
    along: MotionEstimate
    left: Leftover
    observability: Observability
    instead: tuple[tuple[int, ...], ...]
    offsets: dict[str, float]
    odd: dict[str, float]
    sources: tuple[Source, ...]
    settings: CalibrationSettings
    faults: tuple[Fault, ...]
    left_out: tuple[str, ...]
    notes: tuple[Noted, ...]
    seconds: dict[str, float]
    clocks: tuple[tuple[SuClock, ...], ...]
    su_sources: Mapping[str, SuSource]
    publishers: tuple[tuple[JointClock, ...], ...] = ()

    @property
    def tree(self) -> KinematicTree:
        """The joints with the SUs on them."""
        return self.along.problem.tree

    @property
    def T_link_su(self) -> F64:
        """(U, 4, 4) each SU in the frame of the vendor's link that it sits on [m]."""
        at = zip(self.tree.su_joint, self.along.state.T_joint_su, strict=True)
        return np.stack([self.chassis.T_link_su(int(j), T) for j, T in at])

    @property
    def links(self) -> tuple[str, ...]:
        """The vendor's link that each SU sits on."""
        return tuple(self.chassis.link(int(j)) for j in self.tree.su_joint)

    @property
    def su_links(self) -> tuple[tuple[str, str], ...]:
        """Names of each SU's link and of the fixed joint that holds it, which the model lacks."""
        description = self.chassis.description
        taken = {*description.links, *(joint.name for joint in description.joints)}
        links = [_free(name, "_su", taken) for name in self.tree.su_names]
        return tuple((link, _free(f"{link}_mount", "", taken)) for link in links)

    @property
    def misfit(self) -> float:
        """What the model leaves of the readings over what noise makes of it; near 1 or below."""
        return self.left.mean

    @property
    def corrections(self) -> F64:
        """(D, 6) twists from the model's placements to those found [m, rad], z along the axis."""
        first = Blueprint(
            self.chassis.T_parent_joint, self.blueprint.deviations, self.blueprint.up, 0.0
        )
        return first.corrections(self.along.state)

    @property
    def correction_sd(self) -> F64:
        """(D, 6) their standard deviations; 0 of what was kept."""
        layout, D = self.along.problem.layout, self.chassis.n_joints
        variance = np.diag(self.observability.covariance.joint).clip(min=0.0)
        out = np.zeros((D, 6))
        out[:, (0, 1, 3, 4)] = variance[: 4 * D].reshape(D, 4)
        # What all share stands behind the coordinates of joints and logs, in the layout's order.
        further = variance[layout.further.start : layout.further.stop]
        out[:, (2, 5)] = further[2:].reshape(D, 2)
        return np.where(self.blueprint.deviations > 0, np.sqrt(out), 0.0)

    @property
    def compliance(self) -> tuple[F64, F64]:
        """(D,) what each joint yields per torque of its own load, and its standard deviation.

        In rad/(N m) or m/N; NaN where the readings ask for none, or nobody knows the loads.
        """
        return self.along.compliance(self.observability.covariance.joint)

    @property
    def significant(self) -> Bool:
        """(D, 6) deviations that are more than chance."""
        sd = self.correction_sd
        return np.asarray((sd > 0) & (np.abs(self.corrections) > SIGNIFICANT * sd))

    @property
    def deviates(self) -> bool:
        """Whether the specimen was found to differ from the model.

        Where the model as it is does not explain the readings, and does with what is common
        allowed for, it does, though no number of its own may differ by more than chance.
        """
        allowed = self.kept and bool(self.blueprint.deviations.any())
        return allowed or bool(self.significant.any())

    @property
    def kept(self) -> bool:
        """Whether the model's kinematics stand in the output as they were given."""
        return self.correction.what == "none"

    @property
    def tilt(self) -> float:
        """Angle between the base frame's z axis and the vertical in the first log [rad]."""
        return float(np.arccos(np.clip(self.along.state.up[0, 2], -1.0, 1.0)))

    @property
    def tilt_sd(self) -> float:
        """Its standard deviation [rad]: about a radian where the log tells nothing of it."""
        up, layout = self.along.state.up[0], self.along.problem.layout
        mount = layout.further.start + np.arange(N_MOUNT)
        C = self.observability.covariance.joint[np.ix_(mount, mount)]
        about = np.array([up[1], -up[0], 0.0])
        if np.linalg.norm(about) < TURNED:
            # Level or upside down: any turn tilts.
            return float(np.sqrt(max(np.linalg.eigvalsh(C)[-1], 0.0)))
        along = turn_axes(up).T @ (about / np.linalg.norm(about))
        return float(np.sqrt(max(along @ C @ along, 0.0)))

    @property
    def turned(self) -> bool:
        """Whether the robot is mounted otherwise than upright, as the log tells."""
        return self.tilt > max(TURNED, SIGNIFICANT * self.tilt_sd)

    @property
    def mount_open(self) -> bool:
        """Whether the mount that was taken is not upright, and an upright one may be as true."""
        return self.tilt > TURNED and not self.turned

    @property
    def to_repair(self) -> bool:
        """Whether something has to be set right before the URDF fits the robot."""
        return bool(self.odd) or any(fault.to_repair for fault in self.faults)

    @property
    def quality(self) -> Quality:
        """How far the result can be trusted."""
        good = self.misfit <= GOOD_FIT and not self.faults and not any(self.instead)
        good = good and not self.odd
        if self.kept and self.deviates:
            good = False
        # An SU on the base or on the first joint never is determined, whatever is recorded.
        beyond = [
            verdict == "determined"
            for verdict, j in zip(self.observability.su_verdict, self.tree.su_joint, strict=True)
            if j >= 0 and self.tree.parent[j] >= 0
        ]
        good = good and 2 * sum(beyond) >= len(beyond)
        return "good" if good and not self.offsets else "fair"


def _free(name: str, suffix: str, taken: set[str]) -> str:
    """The name, with a suffix and a number where it is taken; it is taken then."""
    new, n = name, 1
    while new in taken:
        new = f"{name}{suffix}" if n == 1 and suffix else f"{name}{suffix}_{n}"
        n += 1
    taken.add(new)
    return new
