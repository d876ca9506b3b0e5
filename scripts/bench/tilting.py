"""Recordings as they would be on a base that tilts by itself.

All that gravity and the base's turning change of what SUs feel is added by Pinocchio's kinematics
of the true robot: as if each SU's sensor were ideal for the change.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from skin2urdf.arrays import F64
from skin2urdf.geometry.so3 import frame_with_z
from skin2urdf.recording.records import Recording
from skin2urdf.signals.motion import joint_motion
from skin2urdf.signals.poses import find_rests
from skin2urdf.simulation import Simulation

_ELSEWHERE = 0.05
"""Distance of joint positions from which a rest is in another place [rad or m]."""
_APART = np.array([1.0, 1.37, 0.61])
"""Frequencies of a base that sways, over the one that it is named after."""


@dataclass(frozen=True)
class Tilting:
    """How a base tilts.

    Attributes:
        size: rms about each of two level axes [rad].
        period: of its sway [s]; None for a base that is carried on, between places.
    """

    size: float
    period: float | None = None


_Tilt = Callable[[F64], tuple[F64, F64]]
"""Turns about two axes (N, 2) at times (N,) [rad], and their second derivatives [rad/s^2]."""


def on_a_tilting_base(simulation: Simulation, how: Tilting, seed: int) -> Recording:
    """The recording with a base that tilts about two level axes through its frame.

    Args:
        simulation: of a base that stands still.
        how: it tilts.
        seed: of the tilts.
    """
    recording, truth = simulation.recording, simulation.truth
    rng = np.random.default_rng(seed)
    tilt = _carried(recording, how.size, rng) if how.period is None else _swaying(how, rng)
    model = pin.buildModelFromXML(truth.urdf)
    data = model.createData()
    joints = {joint.name: joint for joint in recording.joints}
    up = -truth.gravity_base
    level = frame_with_z(up / np.linalg.norm(up))[:, :2]
    tilted = []
    for su in recording.sus:
        turned, accelerated = (each @ level.T for each in tilt(su.time))
        by_gravity = Rotation.from_rotvec(turned).inv().apply(up) - up
        force, frame = np.array(su.specific_force), model.getFrameId(su.name)
        q = {name: np.interp(su.time, j.time, j.position) for name, j in joints.items()}
        for k in range(len(force)):
            pin.forwardKinematics(model, data, _configuration(model, q, k))
            there = pin.updateFramePlacement(model, data, frame)
            more = by_gravity[k] + np.cross(accelerated[k], there.translation)
            force[k] += there.rotation.T @ more
        tilted.append(replace(su, specific_force=force))
    return replace(recording, sus=tuple(tilted))


def _configuration(model: pin.Model, q: dict[str, F64], k: int) -> F64:
    """The configuration at a sample."""
    out = np.array(pin.neutral(model))
    for name, position in q.items():
        joint = model.joints[model.getJointId(name)]
        at = position[k]
        out[joint.idx_q : joint.idx_q + joint.nq] = (
            at if joint.nq == 1 else (np.cos(at), np.sin(at))
        )
    return out


def _carried(recording: Recording, size: float, rng: np.random.Generator) -> _Tilt:
    """Another tilt in each place; patterns come back to theirs."""
    motion = joint_motion(recording)
    time, turn, last = [-1.0], [np.zeros(2)], np.full(motion.q.shape[1], np.inf)
    for rest in find_rests(motion):
        here = motion.q[rest.begin : rest.end].mean(axis=0)
        elsewhere = np.abs(here - last).max() > _ELSEWHERE
        turn += [size * rng.standard_normal(2) if elsewhere else turn[-1]] * 2
        time += motion.grid.time[[rest.begin, rest.end - 1]].tolist()
        last = here
    path = PchipInterpolator(time, turn)
    return lambda t: (path(t), path(t, 2))


def _swaying(how: Tilting, rng: np.random.Generator) -> _Tilt:
    """Sums of three swings about each axis."""
    w = 2 * np.pi / (how.period or 1.0) * _APART
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    amplitude = how.size * np.sqrt(2 / 3)

    def tilt(t: F64) -> tuple[F64, F64]:
        swings = amplitude * np.sin(t[:, None, None] * w + phase)
        return swings.sum(axis=2), -(swings * w**2).sum(axis=2)

    return tilt
