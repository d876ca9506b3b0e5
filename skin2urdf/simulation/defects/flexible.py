"""A robot with all that gives way, and how it moves when its motors do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from skin2urdf.arrays import F64, Int
from skin2urdf.simulation.defects.records import Flexibility, Hinge, Moved, Ripple
from skin2urdf.simulation.defects.two_masses import STEP, Springs, swing
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.skins import PlacedSu
from skin2urdf.simulation.trajectory import JointMotion


def move_flexibly(
    mechanism: Mechanism, sus: Sequence[PlacedSu], motor: JointMotion, flexibility: Flexibility
) -> Moved:
    """Move a robot by its motors.

    Args:
        mechanism: the robot, rigid.
        sus: its SUs.
        motor: what the encoders of its D joints see, times the gears' reduction.
        flexibility: what gives way.

    Returns:
        What really moves.
    """
    drive = _rippled(motor, flexibility.ripples)
    hinges = sorted(flexibility.hinges, key=lambda hinge: hinge.joint)
    if flexibility.is_rigid:
        return Moved(mechanism, drive, tuple(sus), np.arange(mechanism.n_joints), motor)
    bending, rows = with_hinges(mechanism, hinges)
    n = bending.n_joints
    others = np.setdiff1d(np.arange(n), rows)
    stiffness, ratio, play = np.empty((3, n))
    stiffness[rows], ratio[rows] = flexibility.stiffness, flexibility.damping
    play[rows], play[others] = flexibility.play, 0.0
    stiffness[others] = [h.stiffness for h in hinges for _ in h.axes]
    ratio[others] = [h.damping for h in hinges for _ in h.axes]
    position = np.zeros((len(drive.time), n))
    position[:, rows] = drive.position
    inertia = _inertia(bending.model, position[0])
    soft = np.isfinite(stiffness)
    damping = np.zeros(n)
    damping[soft] = 2.0 * ratio[soft] * np.sqrt(stiffness[soft] * inertia[soft])
    springs = Springs(stiffness, damping, play)
    swung = swing(bending.model, springs, JointMotion(drive.time, position))
    moved_sus = tuple(_carried(su, hinges, rows) for su in sus)
    return Moved(bending, swung.motion, moved_sus, rows, motor, swung.torque[:, rows])


def with_hinges(mechanism: Mechanism, hinges: Sequence[Hinge]) -> tuple[Mechanism, Int]:
    """A robot whose bodies bend.

    Args:
        mechanism: the robot with D joints.
        hinges: where its bodies bend, in the order of their joints and at most one for each.

    Returns:
        The robot with a joint for every axis of a hinge, which sits where the hinge is straight,
        and (D,) its joints that are the robot's own. The axes of joint ``d`` follow it directly.
    """
    import pinocchio as pin

    old = mechanism.model
    of = {hinge.joint: hinge for hinge in hinges}
    model = pin.Model()
    model.gravity = old.gravity
    # Where the children of a body hang, and where their placements count from.
    ends: list[tuple[int, Any]] = []
    names: list[str] = []
    rows: list[int] = []
    parents: list[int] = []

    def add(parent: int, kind: Any, placement: Any, name: str) -> int:
        names.append(name)
        parents.append(parent - 1)
        return int(model.addJoint(parent, kind, placement, name))

    def bend(joint: int, body: Any, name: str) -> None:
        """Give a body its inertia, in two where it bends, and note where its children hang."""
        hinge = of.get(joint_of[joint])
        if hinge is None:
            model.appendBodyToJoint(joint, body, pin.SE3.Identity())
            ends.append((joint, pin.SE3.Identity()))
            return
        near, far = (
            pin.Inertia(share * body.mass, body.lever, share * body.inertia)
            for share in (1.0 - hinge.beyond, hinge.beyond)
        )
        model.appendBodyToJoint(joint, near, pin.SE3.Identity())
        placement = pin.SE3(np.eye(3), np.array(hinge.point))
        back = placement.inverse()
        last = joint
        for i, axis in enumerate(hinge.axes):
            kind = pin.JointModelRevoluteUnaligned(np.array(axis))
            last = add(last, kind, placement, f"{name} bends {i}")
            placement = pin.SE3.Identity()
        model.appendBodyToJoint(last, far, back)
        ends.append((last, back))

    joint_of = {0: -1}
    bend(0, old.inertias[0], "base")
    for d, axis in enumerate(_axes(mechanism)):
        last, back = ends[mechanism.parent[d] + 1]
        linear = mechanism.prismatic[d]
        kind = pin.JointModelPrismaticUnaligned if linear else pin.JointModelRevoluteUnaligned
        name = mechanism.joint_names[d]
        joint = add(last, kind(axis), back * old.jointPlacements[d + 1], name)
        rows.append(joint - 1)
        joint_of[joint] = d
        bend(joint, old.inertias[d + 1], name)
    n = len(names)
    own = np.array(rows, dtype=np.int64)
    prismatic = np.zeros(n, dtype=np.bool_)
    prismatic[own] = mechanism.prismatic
    lower, upper, speed = np.full(n, -np.inf), np.full(n, np.inf), np.full(n, np.inf)
    lower[own], upper[own], speed[own] = (
        mechanism.lower,
        mechanism.upper,
        mechanism.speed_limit,
    )
    links = list(names)
    for d, row in enumerate(rows):
        links[row] = mechanism.link_names[d]
    bending = replace(
        mechanism,
        model=model,
        joint_names=tuple(names),
        parent=np.array(parents),
        prismatic=prismatic,
        lower=lower,
        upper=upper,
        speed_limit=speed,
        link_names=tuple(links),
    )
    return bending, own


def _axes(mechanism: Mechanism) -> F64:
    """(D, 3) axis of every joint in its own frame."""
    import pinocchio as pin

    model = mechanism.model
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axes = np.empty((mechanism.n_joints, 3))
    for d in range(mechanism.n_joints):
        # Of a single joint the Jacobian is a vector.
        jacobian = pin.getJointJacobian(model, data, d + 1, pin.LOCAL)
        twist = jacobian.reshape(6, mechanism.n_joints)[:, d]
        axes[d] = twist[:3] if mechanism.prismatic[d] else twist[3:]
    return axes


def _inertia(model: Any, x: F64) -> F64:
    """(n,) inertia that each coordinate carries, the others held [kg m^2 or kg]."""
    import pinocchio as pin

    data = model.createData()
    pin.crba(model, data, x)
    return np.array(np.diag(data.M))


def _carried(su: PlacedSu, hinges: Sequence[Hinge], rows: Int) -> PlacedSu:
    """An SU on the part of its body that carries it."""
    joint = int(rows[su.joint]) if su.joint >= 0 else -1
    hinge = next((h for h in hinges if h.joint == su.joint), None)
    if hinge is None or not hinge.carries(su.T_joint_su[:3, 3]):
        return replace(su, joint=joint)
    T = np.array(su.T_joint_su)
    T[:3, 3] -= hinge.point
    return replace(su, joint=joint + len(hinge.axes), T_joint_su=T)


def _rippled(motor: JointMotion, ripples: Sequence[Ripple]) -> JointMotion:
    """The motion at the gears' output, on a grid that resolves what their teeth do."""
    if not ripples:
        return motor
    time = np.arange(int(motor.time[-1] / STEP + 1e-9) + 1, dtype=np.float64) * STEP
    position, _, _ = motor.at(time)
    out = position.copy()
    for ripple in ripples:
        own = position[:, ripple.joint]
        out[:, ripple.joint] += ripple.amplitude * np.sin(ripple.per_turn * own + ripple.phase)
    return JointMotion(time, out)
