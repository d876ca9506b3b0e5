"""The reference of a plan: what a controller makes of a trajectory from a file."""

from __future__ import annotations

import numpy as np

from skin2urdf.arrays import F64, Bool
from skin2urdf.errors import UsageError
from skin2urdf.planning.trajectory import JointTrajectory
from skin2urdf.simulation.mechanism import Mechanism
from skin2urdf.simulation.motion import Reference
from skin2urdf.simulation.trajectory import GRID, JointMotion, Phase

_STILL = 1e-6
"""Speed below which a joint rests [rad/s or m/s]."""
_SHORTEST_REST = 0.25
"""Shortest time at rest that makes a pose [s]: that which a calibration asks for."""
_BEYOND = 1e-6
"""How far positions may be beyond limits, which files round [rad or m]."""


def follow_plan(mechanism: Mechanism, plan: JointTrajectory) -> Reference:
    """The reference that follows a trajectory; joints that it does not name rest near zero.

    Args:
        mechanism: the robot.
        plan: the trajectory. It begins at its first point, which robots are moved to before.

    Raises:
        UsageError: the robot lacks one of its joints, or may not go where it leads.
    """
    unknown = [name for name in plan.joint_names if name not in mechanism.joint_names]
    if unknown:
        raise UsageError(
            f"the plan moves {', '.join(unknown[:6])}, which this robot does not have",
            f"its joints are {', '.join(mechanism.joint_names)}",
        )
    n = int(np.floor((plan.duration - plan.time[0]) / GRID)) + 2
    time = np.arange(n, dtype=np.float64) * GRID
    q, qd, _, _ = plan.at(plan.time[0] + time)
    columns = [mechanism.joint_names.index(name) for name in plan.joint_names]
    still = np.clip(0.0, mechanism.lower, mechanism.upper)
    position = np.tile(still, (n, 1))
    position[:, columns] = q
    outside = (position < mechanism.lower - _BEYOND) | (position > mechanism.upper + _BEYOND)
    if outside.any():
        names = [mechanism.joint_names[d] for d in np.flatnonzero(outside.any(axis=0))]
        raise UsageError(
            f"the plan leads {', '.join(names)} beyond the limits of this robot",
            "plan with the limits of the robot that is simulated",
        )
    resting = np.asarray((np.abs(qd) < _STILL).all(axis=1))
    phases = _phases(time, resting)
    poses = _poses(position, phases)
    return Reference(JointMotion(time, position), phases, poses)


def _phases(time: F64, resting: Bool) -> tuple[Phase, ...]:
    """Rests and moves in turn."""
    edges = np.flatnonzero(np.diff(resting)) + 1
    phases: list[Phase] = []
    pose = 0
    for first, last in zip([0, *edges], [*edges, len(time) - 1], strict=True):
        begin, end = float(time[first]), float(time[last])
        if resting[first] and end - begin >= _SHORTEST_REST:
            phases.append(Phase("rest", begin, end, pose=pose))
            pose += 1
        else:
            phases.append(Phase("move", begin, end))
    return tuple(phases)


def _poses(position: F64, phases: tuple[Phase, ...]) -> F64:
    """(P, D) where it rests, each place once."""
    rests = [position[round(p.start / GRID)] for p in phases if p.kind == "rest"]
    places: list[F64] = []
    for here in rests:
        if not any(np.allclose(here, there, atol=1e-6) for there in places):
            places.append(here)
    return np.reshape(places, (-1, position.shape[1]))
